//! Emitters without a surface.

use super::object::Object;
use super::xml::Element;
use crate::Result;
use crate::scene::validate::{SHEAR_TOLERANCE, check_radiance};
use crate::scene::{DeltaKind, DeltaLight, Environment, EnvironmentMap, Falloff, Scene};
use glam::{DMat3, DMat4, DVec3};

/// Adds a light or the environment to the scene; nothing where it is passed over.
pub fn emitter(element: Element, scene: &mut Scene) -> Result<()> {
    let Some(mut object) = Object::new(element, &["point", "spot", "directional", "constant", "envmap"])? else {
        return Ok(());
    };
    let environment = match object.kind() {
        "point" | "spot" | "directional" => {
            let name = format!("{}-{}", object.kind(), scene.delta_lights.len() + 1);
            let name = element.attribute("id")?.unwrap_or(name);
            let light = delta(&mut object, name)?;
            light.validate().map_err(|error| element.error(error))?;
            scene.delta_lights.push(light);
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

fn delta(object: &mut Object, name: String) -> Result<DeltaLight> {
    let element = object.element;
    let to_world = object.transform("to_world")?;
    let beside = |what: &str| element.error(format!("{what} beside to_world; give one of them"));
    let matrix = to_world.unwrap_or(DMat4::IDENTITY);
    let axis = || {
        let axis = matrix.z_axis.truncate().try_normalize();
        axis.ok_or_else(|| element.error("to_world leaves the light no direction; scale no axis to 0"))
    };
    let mut color = "intensity";
    let kind = match object.kind() {
        "point" => match object.point("position")? {
            Some(_) if to_world.is_some() => return Err(beside("position")),
            position => DeltaKind::Point { position: position.unwrap_or(matrix.w_axis.truncate()) },
        },
        "spot" => {
            let cutoff_degrees = object.float("cutoff_angle")?.unwrap_or(20.0);
            let beam_degrees = object.float("beam_width")?.unwrap_or(0.75 * cutoff_degrees);
            let position = matrix.w_axis.truncate();
            DeltaKind::Spot { position, direction: axis()?, beam_degrees, cutoff_degrees, falloff: Falloff::Linear }
        }
        _ => {
            color = "irradiance";
            let direction = match object.vector("direction")? {
                Some(_) if to_world.is_some() => return Err(beside("direction")),
                Some(direction) => direction
                    .try_normalize()
                    .ok_or_else(|| element.error("direction has no length; give where the light goes"))?,
                None => axis()?,
            };
            DeltaKind::Directional { direction }
        }
    };
    let intensity = object.color(color, check_radiance)?.unwrap_or(DVec3::ONE);
    Ok(DeltaLight { name, intensity, kind })
}

fn map(object: &mut Object) -> Result<EnvironmentMap> {
    let element = object.element;
    let file = object.filename()?;
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
