//! The camera, its film and its sampler.

use super::Options;
use super::object::Object;
use super::transform::swap_camera_convention;
use super::xml::Element;
use crate::Result;
use crate::scene::math::sin_cos_degrees;
use crate::scene::validate::check_size;
use crate::scene::{Camera, Lens};
use glam::DMat4;

/// Mitsuba's film size where the file gives none.
const DEFAULT_FILM: (u32, u32) = (768, 576);

/// The camera and the samples per pixel; none where it is passed over.
pub fn sensor(element: Element, options: &Options) -> Result<Option<(Camera, Option<u32>)>> {
    let Some(mut object) = Object::new(element, &["perspective", "thinlens"])? else { return Ok(None) };
    let to_world = object.transform("to_world")?.unwrap_or(DMat4::IDENTITY);
    let fov = object.float("fov")?.ok_or_else(|| element.error("the sensor lacks <float name=\"fov\">"))?;
    let axis = object.string("fov_axis")?.unwrap_or("x".to_owned());
    let lens = (object.kind() == "thinlens").then(|| lens(&mut object)).transpose()?;
    ["near_clip", "far_clip"].into_iter().for_each(|name| object.pass_over(name));
    let film = object.take_one_nested("film")?.map(film).transpose()?.unwrap_or(DEFAULT_FILM);
    let spp = object.take_one_nested("sampler")?.map(sampler).transpose()?.flatten();
    object.finish()?;

    let (width, height) = options.size.unwrap_or(film);
    check_size(width, height).map_err(|error| element.error(error))?;
    if !(fov > 0.0 && fov < 180.0) {
        return Err(element.error(format!("field of view {fov} degrees; it must lie between 0 and 180")));
    }
    let fov_x_degrees = horizontal_fov(fov, &axis, f64::from(width) / f64::from(height)).ok_or_else(|| {
        element.error(format!("fov_axis \"{axis}\" is not supported; supported: x, y, diagonal, smaller, larger"))
    })?;
    let camera = Camera { to_world: swap_camera_convention(to_world), fov_x_degrees, width, height, lens };
    camera.validate().map_err(|error| element.error(error))?;
    Ok(Some((camera, spp)))
}

fn lens(object: &mut Object) -> Result<Lens> {
    let element = object.element;
    let required = |name: &str, length: Option<f64>| {
        length.ok_or_else(|| element.error(format!("the sensor lacks <float name=\"{name}\">")))
    };
    let (radius, distance) = (object.float("aperture_radius")?, object.float("focus_distance")?);
    let aperture_radius = required("aperture_radius", radius)?;
    Ok(Lens { aperture_radius, focus_distance: required("focus_distance", distance)? })
}

/// The horizontal field of view in degrees from one along another axis; `aspect` is width over height.
fn horizontal_fov(degrees: f64, axis: &str, aspect: f64) -> Option<f64> {
    // Scales the tangent of the half angle.
    let scaled = |factor: f64| {
        let (sin, cos) = sin_cos_degrees(0.5 * degrees);
        2.0 * (sin / cos * factor).atan().to_degrees()
    };
    match axis {
        "x" => Some(degrees),
        "y" => Some(scaled(aspect)),
        "diagonal" => Some(scaled(aspect / aspect.hypot(1.0))),
        "smaller" => horizontal_fov(degrees, if aspect > 1.0 { "y" } else { "x" }, aspect),
        "larger" => horizontal_fov(degrees, if aspect > 1.0 { "x" } else { "y" }, aspect),
        _ => None,
    }
}

fn film(element: Element) -> Result<(u32, u32)> {
    let Some(mut object) = Object::new(element, &["hdrfilm"])? else { return Ok(DEFAULT_FILM) };
    let width = object.count("width")?.unwrap_or(DEFAULT_FILM.0);
    let height = object.count("height")?.unwrap_or(DEFAULT_FILM.1);
    ["file_format", "pixel_format", "component_format"].into_iter().for_each(|name| object.pass_over(name));
    if let Some(filter) = object.take_one_nested("rfilter")?
        && let Some(filter) = Object::new(filter, &["box"])?
    {
        filter.finish()?;
    }
    object.finish()?;
    Ok((width, height))
}

fn sampler(element: Element) -> Result<Option<u32>> {
    let kinds = ["independent", "stratified", "multijitter", "orthogonal", "ldsampler"];
    let Some(mut object) = Object::new(element, &kinds)? else { return Ok(None) };
    let spp = object.count("sample_count")?;
    object.pass_over("seed");
    object.finish()?;
    Ok(spp)
}
