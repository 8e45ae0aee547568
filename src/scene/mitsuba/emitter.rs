//! Emitters without a surface.

use super::object::Object;
use super::xml::Element;
use crate::Result;
use crate::scene::validate::{SHEAR_TOLERANCE, check_radiance};
use crate::scene::{Environment, EnvironmentMap, PointLight, Scene};
use glam::{DMat3, DMat4, DVec3};

/// Adds a point light or the environment to the scene; nothing where it is passed over.
pub fn emitter(element: Element, scene: &mut Scene) -> Result<()> {
    let Some(mut object) = Object::new(element, &["point", "constant", "envmap"])? else { return Ok(()) };
    let environment = match object.kind() {
        "point" => {
            let name = element.attribute("id")?.unwrap_or(format!("point-{}", scene.points.len() + 1));
            scene.points.push(point(&mut object, name)?);
            None
        }
        "constant" => Some(Environment::Constant(object.color("radiance", check_radiance)?.unwrap_or(DVec3::ONE))),
        _ => Some(Environment::Map(map(&mut object)?)),
    };
    object.finish()?;
    if environment.is_some() && scene.environment.is_some() {
        return Err(element.error("a second environment; a scene has one constant or envmap emitter at most"));
    }
    if let Some(environment) = environment {
        environment.validate().map_err(|error| element.error(error))?;
        scene.environment = Some(environment);
    }
    Ok(())
}

fn point(object: &mut Object, name: String) -> Result<PointLight> {
    let element = object.element;
    let (position, to_world) = (object.point("position")?, object.transform("to_world")?);
    let position = match (position, to_world) {
        (Some(_), Some(_)) => return Err(element.error("position beside to_world; give one of them")),
        (Some(position), None) => position,
        (None, to_world) => to_world.unwrap_or(DMat4::IDENTITY).w_axis.truncate(),
    };
    let intensity = object.color("intensity", check_radiance)?.unwrap_or(DVec3::ONE);
    let light = PointLight { name, position, intensity };
    light.validate().map_err(|error| element.error(error))?;
    Ok(light)
}

fn map(object: &mut Object) -> Result<EnvironmentMap> {
    let element = object.element;
    let file = object.string("filename")?;
    let file = file.ok_or_else(|| element.error(format!("{} lacks <string name=\"filename\">", element.words())))?;
    let scale = object.float("scale")?.unwrap_or(1.0);
    // Another way to draw the same directions.
    object.pass_over("mis_compensation");
    let axes = DMat3::from_mat4(object.transform("to_world")?.unwrap_or(DMat4::IDENTITY));
    // Directions only: a scale that is the same in all of them makes no difference.
    let to_world = axes * (1.0 / axes.x_axis.length());
    if !(to_world.transpose() * to_world).abs_diff_eq(DMat3::IDENTITY, SHEAR_TOLERANCE) {
        return Err(element.error("to_world of an envmap must be a rotation (no shear, the same scale along all axes)"));
    }
    let picture = element.source.picture(&file, false).map_err(|error| element.error(error))?;
    Ok(EnvironmentMap { picture, scale, to_world })
}
