//! Shapes.

use super::material::Materials;
use super::meshes;
use super::object::Object;
use super::xml::Element;
use crate::Result;
use crate::scene::camera::without_negative_zeros;
use crate::scene::validate::{SHEAR_TOLERANCE, check_radiance};
use crate::scene::{Geometry, Material, Shape, Texture};
use glam::{DMat3, DMat4, DVec3};
use std::sync::Arc;

/// A surface, and how its u and v differ from those of the file.
struct Surface {
    geometry: Geometry,
    texture: fn(Texture) -> Texture,
}

/// The shapes that an element stands for: one, six for a cube, none where it is passed over. `name` serves where it has no id.
pub fn shapes(element: Element, name: String, materials: &Materials) -> Result<Vec<Shape>> {
    let kinds = ["sphere", "rectangle", "disk", "cube", "obj", "ply"];
    let Some(mut object) = Object::new(element, &kinds)? else { return Ok(Vec::new()) };
    let radiance = object.take_one_nested("emitter")?.map(emitter).transpose()?.flatten();
    let material = materials.of(&mut object, radiance.is_some())?;
    let surfaces = match object.kind() {
        "sphere" => sphere(&mut object, material.texture.is_some())?.into_iter().collect(),
        "cube" => cube(&mut object)?,
        "obj" | "ply" => vec![mesh(&mut object, radiance.is_some())?],
        _ => flat(&mut object)?.into_iter().collect(),
    };
    object.finish()?;
    let name = element.attribute("id")?.unwrap_or(name);
    let single = surfaces.len() == 1;
    let build = |(i, surface): (usize, Surface)| {
        let name = if single { name.clone() } else { format!("{name}-{}", i + 1) };
        let shape = surface.shape(name, &material, radiance.unwrap_or(DVec3::ZERO));
        shape.validate().map_err(|error| element.error(format!("{}: {error}", element.words())))?;
        Ok(shape)
    };
    surfaces.into_iter().enumerate().map(build).collect()
}

impl Surface {
    fn shape(self, name: String, material: &Material, radiance: DVec3) -> Shape {
        let mut material = material.clone();
        material.texture = material.texture.map(self.texture);
        material.shape(name, self.geometry, radiance)
    }
}

fn emitter(element: Element) -> Result<Option<DVec3>> {
    let Some(mut object) = Object::new(element, &["area"])? else { return Ok(None) };
    let radiance = object.color("radiance", check_radiance)?;
    object.finish()?;
    match radiance {
        Some(radiance) => Ok(Some(radiance)),
        None => Err(element.error(format!("{} lacks <rgb name=\"radiance\">", element.words()))),
    }
}

fn sphere(object: &mut Object, textured: bool) -> Result<Option<Surface>> {
    let element = object.element;
    let center = object.point("center")?.unwrap_or(DVec3::ZERO);
    let radius = object.float("radius")?.unwrap_or(1.0);
    let to_world = object.transform("to_world")?.unwrap_or(DMat4::IDENTITY);
    let inward = object.boolean("flip_normals")? == Some(true);
    let axes = DMat3::from_mat4(to_world);
    let scale = axes.x_axis.length();
    let gram = axes.transpose() * axes * (1.0 / (scale * scale));
    let straight = (axes * (1.0 / scale)).abs_diff_eq(DMat3::IDENTITY, SHEAR_TOLERANCE);
    let refused = if !gram.abs_diff_eq(DMat3::IDENTITY, SHEAR_TOLERANCE) {
        "to_world of a sphere must scale all axes alike: ellipsoids are not supported"
    } else if axes.determinant() < 0.0 {
        "to_world of a sphere mirrors it, which turns it inside out: not supported"
    } else if textured && !straight {
        "to_world rotates a sphere with a texture: not supported"
    } else {
        let geometry = Geometry::Sphere { center: to_world.transform_point3(center), radius: scale * radius, inward };
        return Ok(Some(Surface { geometry, texture: |texture| texture }));
    };
    element.unsupported(refused)?;
    Ok(None)
}

/// The matrix of a rectangle, disk or cube.
fn affine(object: &mut Object) -> Result<DMat4> {
    let to_world = without_negative_zeros(object.transform("to_world")?.unwrap_or(DMat4::IDENTITY));
    let determinant = DMat3::from_mat4(to_world).determinant();
    if determinant == 0.0 || !determinant.is_finite() {
        let kind = object.kind();
        return Err(object.element.error(format!("to_world of a {kind} is singular or overflows; scale no axis to 0")));
    }
    Ok(to_world)
}

/// Whether the edges of a shape are perpendicular; what is sheared is not supported.
fn straight(object: &Object, edges: &[DVec3]) -> Result<bool> {
    let cosine = |a: DVec3, b: DVec3| a.normalize().dot(b.normalize());
    let pairs = edges.iter().enumerate().flat_map(|(i, a)| edges[..i].iter().map(move |b| cosine(*a, *b).abs()));
    let worst = pairs.fold(0.0, f64::max);
    if worst > SHEAR_TOLERANCE {
        let kind = object.kind();
        object.element.unsupported(format!(
            "sheared {kind}: the cosine between its edges is {worst:e}; they must be perpendicular"
        ))?;
    }
    Ok(worst <= SHEAR_TOLERANCE)
}

/// A rectangle or a disk.
fn flat(object: &mut Object) -> Result<Option<Surface>> {
    let to_world = affine(object)?;
    let flip = object.boolean("flip_normals")? == Some(true);
    let [center, half_u, half_v] = [to_world.w_axis, to_world.x_axis, to_world.y_axis].map(|v| v.truncate());
    if !straight(object, &[half_u, half_v])? {
        return Ok(None);
    }
    // The normal is the image of +z; where the matrix mirrors, that is -(u x v).
    let turned = flip != (DMat3::from_mat4(to_world).determinant() < 0.0);
    Ok(Some(match (object.kind() == "disk", turned) {
        (true, false) => Surface { geometry: Geometry::Disk { center, half_u, half_v }, texture: |t| t },
        (true, true) => {
            Surface { geometry: Geometry::Disk { center, half_u, half_v: -half_v }, texture: Texture::mirrored }
        }
        (false, false) => Surface { geometry: Geometry::Rectangle { center, half_u, half_v }, texture: |t| t },
        (false, true) => Surface {
            geometry: Geometry::Rectangle { center, half_u: half_v, half_v: half_u },
            texture: Texture::swapped,
        },
    }))
}

/// The faces of Mitsuba's cube [-1, 1]³: normal, and the directions of u and v, for which `u x v` is the normal reversed.
const CUBE: [[DVec3; 3]; 6] = [
    [DVec3::NEG_Y, DVec3::Z, DVec3::X],
    [DVec3::Y, DVec3::NEG_X, DVec3::NEG_Z],
    [DVec3::X, DVec3::Y, DVec3::NEG_Z],
    [DVec3::Z, DVec3::Y, DVec3::X],
    [DVec3::NEG_X, DVec3::Y, DVec3::Z],
    [DVec3::NEG_Z, DVec3::NEG_Y, DVec3::X],
];

/// Six rectangles whose normals point outward, unless flipped; none where it is passed over.
fn cube(object: &mut Object) -> Result<Vec<Surface>> {
    let to_world = affine(object)?;
    let flip = object.boolean("flip_normals")? == Some(true);
    if !straight(object, &[to_world.x_axis, to_world.y_axis, to_world.z_axis].map(|v| v.truncate()))? {
        return Ok(Vec::new());
    }
    // Mirrored, u x v is the normal; its normals stay outward.
    let swapped = flip == (DMat3::from_mat4(to_world).determinant() < 0.0);
    let face = |[normal, u, v]: [DVec3; 3]| {
        let center = to_world.transform_point3(normal);
        let [half_u, half_v] = [u, v].map(|v| to_world.transform_vector3(v) + DVec3::ZERO);
        if swapped {
            let geometry = Geometry::Rectangle { center, half_u: half_v, half_v: half_u };
            Surface { geometry, texture: Texture::swapped }
        } else {
            Surface { geometry: Geometry::Rectangle { center, half_u, half_v }, texture: |texture| texture }
        }
    };
    Ok(CUBE.into_iter().map(face).collect())
}

/// A mesh from a file, in world space.
fn mesh(object: &mut Object, emits: bool) -> Result<Surface> {
    let element = object.element;
    let file = object.filename()?;
    let to_world = affine(object)?;
    let flat = object.boolean("face_normals")? == Some(true);
    let flip = object.boolean("flip_normals")? == Some(true);
    // Mitsuba's defaults.
    let flip_v = object.boolean("flip_tex_coords")?.unwrap_or(object.kind() == "obj");
    let mut mesh =
        meshes::read(&element.source.folder.join(file), object.kind()).map_err(|error| element.error(error))?;
    if flat {
        mesh.normals.clear();
    }
    mesh.transform(to_world);
    if flip_v {
        mesh.uvs.iter_mut().for_each(|uv| uv.y = 1.0 - uv.y);
    }
    if mesh.is_sound() {
        let dropped = mesh.drop_degenerate();
        if dropped > 0 {
            element.note(format!("{}: {dropped} triangles have no area", element.words()));
        }
        if mesh.normals.is_empty() && !flat && !emits {
            mesh.smooth();
        }
    }
    if flip {
        mesh.flip();
    }
    if emits && !flat {
        let needed = "a mesh that emits must be flat: add <boolean name=\"face_normals\" value=\"true\"/>";
        element.unsupported(format!("{}: {needed}", element.words()))?;
        mesh.normals.clear();
    }
    Ok(Surface { geometry: Geometry::Mesh(Arc::new(mesh)), texture: |texture| texture })
}
