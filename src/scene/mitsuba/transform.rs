//! `<transform>`: its operations, each applied after those before it.

use super::xml::Element;
use crate::Result;
use crate::scene::camera::look_at_matrix;
use crate::scene::math::sin_cos_degrees;
use glam::{DMat3, DMat4, DVec3, DVec4};

/// How far the length of a rotation's axis may be from 1: what three printed digits leave.
const AXIS_TOLERANCE: f64 = 1e-3;

/// The composed matrix of a `<transform>`: the first operation acts first.
pub fn transform(element: Element) -> Result<DMat4> {
    element.only_attributes(&["name"])?;
    let mut matrix = DMat4::IDENTITY;
    for child in element.children()? {
        child.no_children()?;
        matrix = operation(child)? * matrix;
    }
    Ok(matrix)
}

fn operation(element: Element) -> Result<DMat4> {
    let vector_attributes = ["x", "y", "z", "value"];
    match element.tag() {
        "translate" => {
            element.only_attributes(&vector_attributes)?;
            Ok(DMat4::from_translation(vector(element, 0.0)?))
        }
        "scale" => {
            element.only_attributes(&vector_attributes)?;
            Ok(DMat4::from_scale(vector(element, 1.0)?))
        }
        "rotate" => {
            element.only_attributes(&["x", "y", "z", "value", "angle"])?;
            let angle = element.number("angle")?;
            let angle = angle.ok_or_else(|| element.error("<rotate> lacks the attribute 'angle' (degrees)"))?;
            let axis = vector(element, 0.0)?;
            if (axis.length() - 1.0).abs() > AXIS_TOLERANCE {
                return Err(element.error(format!(
                    "<rotate> has an axis of length {}; it must be 1, e.g. y=\"1\" (Mitsuba shears with others)",
                    axis.length()
                )));
            }
            let axis = axis.normalize();
            Ok(DMat4::from_mat3(rotation(axis, angle)))
        }
        "lookat" => {
            element.only_attributes(&["origin", "target", "up"])?;
            let [origin, target, up] = ["origin", "target", "up"].map(|name| triple(element, name));
            let matrix = look_at_matrix(origin?, target?, up?).map_err(|error| element.error(error))?;
            Ok(swap_camera_convention(matrix))
        }
        "matrix" => {
            element.only_attributes(&["value"])?;
            let numbers = element.numbers("value")?.unwrap_or_default();
            let numbers: [f64; 16] = numbers.try_into().map_err(|numbers: Vec<f64>| {
                element.error(format!("<matrix> has {} numbers; it needs 16, row by row", numbers.len()))
            })?;
            let matrix = DMat4::from_cols_array(&numbers).transpose();
            if matrix.row(3) != DVec4::W {
                return Err(element.error("<matrix>: the last row must be 0 0 0 1"));
            }
            Ok(matrix)
        }
        tag => Err(element.error(format!(
            "<{tag}> in a transform is not supported; supported: lookat, rotate, translate, scale, matrix"
        ))),
    }
}

/// Between Mitsuba's camera (x left, y up, view +z) and limpid's (x right, y up, view -z), either way.
pub fn swap_camera_convention(to_world: DMat4) -> DMat4 {
    let m = DMat4::from_cols(-to_world.x_axis, to_world.y_axis, -to_world.z_axis, to_world.w_axis);
    crate::scene::camera::without_negative_zeros(m)
}

/// Rotation about a unit axis; quarter turns about x, y and z are exact.
fn rotation(axis: DVec3, degrees: f64) -> DMat3 {
    let (sin, cos) = sin_cos_degrees(degrees);
    let column = |e: DVec3| e * cos + axis.cross(e) * sin + axis * (axis.dot(e) * (1.0 - cos));
    DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z))
}

/// A vector from `x`, `y`, `z` (each `default` where it is missing) or from `value` with one or three numbers.
pub fn vector(element: Element, default: f64) -> Result<DVec3> {
    let [x, y, z] = ["x", "y", "z"].map(|name| element.number(name));
    let parts = [x?, y?, z?];
    match element.numbers("value")? {
        None => Ok(DVec3::from_array(parts.map(|part| part.unwrap_or(default)))),
        Some(_) if parts.iter().any(Option::is_some) => {
            Err(element.error(format!("{} has both 'value' and x, y, z", element.words())))
        }
        Some(numbers) => match numbers[..] {
            [all] => Ok(DVec3::splat(all)),
            [x, y, z] => Ok(DVec3::new(x, y, z)),
            _ => Err(element.error(format!("{} has {} numbers; it needs 1 or 3", element.words(), numbers.len()))),
        },
    }
}

/// Three numbers in one attribute.
fn triple(element: Element, name: &str) -> Result<DVec3> {
    element.required(name)?;
    let numbers = element.numbers(name)?.unwrap_or_default();
    match numbers[..] {
        [x, y, z] => Ok(DVec3::new(x, y, z)),
        _ => Err(element.error(format!("{}: {name} has {} numbers; it needs 3", element.words(), numbers.len()))),
    }
}
