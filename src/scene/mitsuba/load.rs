//! From elements to a [`Scene`].

use super::Options;
use super::object::Object;
use super::transform::swap_camera_convention;
use super::xml::{self, Element, Source};
use crate::scene::math::sin_cos_degrees;
use crate::scene::validate::{SHEAR_TOLERANCE, check_albedo, check_radiance};
use crate::scene::{Camera, Checker, Geometry, Loaded, Scene, Shape};
use crate::{Error, Result};
use glam::{DMat3, DMat4, DVec2, DVec3};
use std::collections::{BTreeMap, BTreeSet};

const TOP_LEVEL: &str = "default, integrator, sensor, bsdf, shape";
/// Mitsuba's film size where the file gives none.
const DEFAULT_FILM: (u32, u32) = (768, 576);
/// Mitsuba's reflectance where the file gives none.
const DEFAULT_REFLECTANCE: f64 = 0.5;

/// A diffuse material: its reflectance and, where it has two, the checkerboard.
#[derive(Clone, Copy)]
struct Material {
    albedo: DVec3,
    checker: Option<Checker>,
}

/// Materials by id.
type Materials = BTreeMap<String, Material>;

pub fn load(text: &str, file: &str, options: &Options) -> Result<Loaded> {
    let document = xml::parse(text, file)?;
    let mut source = Source { file, document: &document, parameters: BTreeMap::new() };
    let parameters = parameters(&source, options)?;
    source.parameters = parameters;
    let root = Element::root(&source);
    check_root(root)?;

    let materials = materials(root)?;
    let (mut sensor, mut bounces, mut shapes) = (None, None, Vec::new());
    for element in root.children()? {
        match element.tag() {
            // Read above.
            "default" | "bsdf" => {}
            "shape" => {
                let name = format!("shape-{}", shapes.len() + 1);
                shapes.push(shape(element, name, &materials)?);
            }
            "sensor" if sensor.is_none() => sensor = Some(self::sensor(element, options)?),
            "integrator" if bounces.is_none() => bounces = Some(integrator(element)?),
            "sensor" | "integrator" => {
                return Err(element.error(format!("a second <{}>; limpid renders with one", element.tag())));
            }
            _ => {
                return Err(element.error(format!("{} is not supported; supported: {TOP_LEVEL}", element.words())));
            }
        }
    }
    let (camera, spp) = sensor.ok_or_else(|| root.error("the scene has no <sensor>; add one of type perspective"))?;
    let scene = Scene { camera, shapes };
    scene.validate()?;
    Ok(Loaded { scene, spp, bounces: bounces.flatten() })
}

/// The file's `<default>` values, replaced by those from outside.
fn parameters(source: &Source, options: &Options) -> Result<BTreeMap<String, String>> {
    let mut parameters = BTreeMap::new();
    for element in Element::root(source).children()?.iter().filter(|element| element.tag() == "default") {
        element.only_attributes(&["name", "value"])?;
        element.no_children()?;
        let name = element.required("name")?;
        if name.is_empty() || !name.chars().all(|c| c.is_alphanumeric() || "_-".contains(c)) {
            return Err(element.error(format!("'{name}' is no parameter name; use letters, digits, _ and -")));
        }
        let value = options.parameters.get(&name).cloned().map_or_else(|| element.required("value"), Ok)?;
        if parameters.insert(name, value).is_some() {
            return Err(element.error(format!("{} is given twice", element.words())));
        }
    }
    match options.parameters.keys().find(|name| !parameters.contains_key(*name)) {
        None => Ok(parameters),
        Some(name) => {
            let names: Vec<_> = parameters.keys().map(String::as_str).collect();
            let names = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            Err(Error::input(format!("{}: no parameter '{name}'; the file defines: {names}", source.file)))
        }
    }
}

fn check_root(root: Element) -> Result<()> {
    if root.tag() != "scene" {
        return Err(root.error(format!("{} is no Mitsuba scene; the root must be <scene>", root.words())));
    }
    root.only_attributes(&["version"])?;
    let version = root.required("version")?;
    if !["2.", "3."].iter().any(|known| version.starts_with(known)) {
        return Err(root.error(format!("scene version \"{version}\" is not supported; supported: 3.x (and 2.x)")));
    }
    let mut ids = BTreeSet::new();
    for element in root.descendants().filter(|element| element.tag() != "ref") {
        if let Some(id) = element.attribute("id")?
            && !ids.insert(id)
        {
            return Err(element.error(format!("the id of {} is given twice", element.words())));
        }
    }
    Ok(())
}

/// Every material of the file that has an id, nested ones included.
fn materials(root: Element) -> Result<Materials> {
    let mut materials = Materials::new();
    for element in root.descendants().filter(|element| element.tag() == "bsdf") {
        let material = bsdf(element)?;
        if let Some(id) = element.attribute("id")? {
            materials.insert(id, material);
        }
    }
    Ok(materials)
}

fn bsdf(element: Element) -> Result<Material> {
    let mut object = Object::new(element, &["diffuse"])?;
    let reflectance = object.color("reflectance", check_albedo)?;
    let texture = object.take_one_nested("texture")?;
    object.finish()?;
    match texture {
        Some(texture) if reflectance.is_some() => {
            Err(texture.error(format!("{} has a reflectance beside its texture", element.words())))
        }
        Some(texture) => checkerboard(texture),
        None => Ok(Material { albedo: reflectance.unwrap_or(DVec3::splat(DEFAULT_REFLECTANCE)), checker: None }),
    }
}

/// Mitsuba's defaults are 0.4 and 0.2, one repeat.
fn checkerboard(element: Element) -> Result<Material> {
    if element.required("name")? != "reflectance" {
        return Err(element.error(format!("{} must be named reflectance", element.words())));
    }
    let mut object = Object::new(element, &["checkerboard"])?;
    let albedo = object.color("color0", check_albedo)?.unwrap_or(DVec3::splat(0.4));
    let second = object.color("color1", check_albedo)?.unwrap_or(DVec3::splat(0.2));
    let to_uv = object.transform("to_uv")?.unwrap_or(DMat4::IDENTITY);
    object.finish()?;
    let off_diagonal = [to_uv.x_axis.y, to_uv.y_axis.x, to_uv.x_axis.z, to_uv.y_axis.z, to_uv.z_axis.x, to_uv.z_axis.y];
    if off_diagonal.iter().any(|v| *v != 0.0) {
        return Err(element.error("to_uv of a checkerboard may scale and translate; rotations are not supported"));
    }
    let repeats = DVec2::new(to_uv.x_axis.x, to_uv.y_axis.y);
    let checker = Checker { albedo: second, repeats, offset: to_uv.w_axis.truncate().truncate() };
    checker.validate().map_err(|error| element.error(error))?;
    Ok(Material { albedo, checker: Some(checker) })
}

fn emitter(element: Element) -> Result<DVec3> {
    let mut object = Object::new(element, &["area"])?;
    let radiance = object.color("radiance", check_radiance)?;
    object.finish()?;
    radiance.ok_or_else(|| element.error(format!("{} lacks <rgb name=\"radiance\">", element.words())))
}

fn shape(element: Element, name: String, materials: &Materials) -> Result<Shape> {
    let mut object = Object::new(element, &["sphere", "rectangle"])?;
    let mut used = Vec::new();
    for nested in object.take_nested("bsdf") {
        used.push(bsdf(nested)?);
    }
    for reference in object.take_nested("ref") {
        reference.only_attributes(&["id", "name"])?;
        reference.no_children()?;
        let id = reference.required("id")?;
        let material = materials.get(&id).copied();
        used.push(material.ok_or_else(|| reference.error(format!("no bsdf has the id '{id}'")))?);
    }
    if used.len() > 1 {
        return Err(element.error(format!("{} has {} materials; it can have one", element.words(), used.len())));
    }
    let material = used.pop().unwrap_or(Material { albedo: DVec3::splat(DEFAULT_REFLECTANCE), checker: None });
    let textured = material.checker.is_some();
    let radiance = object.take_one_nested("emitter")?.map(emitter).transpose()?;
    let (geometry, swapped) =
        if object.kind() == "sphere" { (sphere(&mut object, textured)?, false) } else { rectangle(&mut object)? };
    object.finish()?;
    let shape = Shape {
        name: element.attribute("id")?.unwrap_or(name),
        geometry,
        albedo: material.albedo,
        checker: material.checker.map(|checker| if swapped { checker.swapped() } else { checker }),
        radiance: radiance.unwrap_or(DVec3::ZERO),
    };
    shape.validate().map_err(|error| element.error(format!("{}: {error}", element.words())))?;
    Ok(shape)
}

fn sphere(object: &mut Object, textured: bool) -> Result<Geometry> {
    let element = object.element;
    let center = object.point("center")?.unwrap_or(DVec3::ZERO);
    let radius = object.float("radius")?.unwrap_or(1.0);
    let to_world = object.transform("to_world")?.unwrap_or(DMat4::IDENTITY);
    let inward = object.boolean("flip_normals")? == Some(true);
    let axes = DMat3::from_mat4(to_world);
    let scale = axes.x_axis.length();
    let gram = axes.transpose() * axes * (1.0 / (scale * scale));
    if !gram.abs_diff_eq(DMat3::IDENTITY, SHEAR_TOLERANCE) {
        return Err(element.error("to_world of a sphere must scale all axes alike: ellipsoids are not supported"));
    }
    if axes.determinant() < 0.0 {
        return Err(element.error("to_world of a sphere mirrors it, which turns it inside out: not supported"));
    }
    let straight = (axes * (1.0 / scale)).abs_diff_eq(DMat3::IDENTITY, SHEAR_TOLERANCE);
    if textured && !straight {
        return Err(element.error("to_world rotates a sphere with a checkerboard: not supported"));
    }
    Ok(Geometry::Sphere { center: to_world.transform_point3(center), radius: scale * radius, inward })
}

/// A rectangle, and whether its u and v are those of the file, swapped.
fn rectangle(object: &mut Object) -> Result<(Geometry, bool)> {
    let element = object.element;
    let to_world = object.transform("to_world")?.unwrap_or(DMat4::IDENTITY);
    let to_world = crate::scene::camera::without_negative_zeros(to_world);
    let flip = object.boolean("flip_normals")? == Some(true);
    let determinant = DMat3::from_mat4(to_world).determinant();
    if determinant == 0.0 || !determinant.is_finite() {
        return Err(element.error("to_world of a rectangle is singular or overflows; scale no axis to 0"));
    }
    let [center, half_u, half_v] = [to_world.w_axis, to_world.x_axis, to_world.y_axis].map(|v| v.truncate());
    // The normal is the image of +z; where the matrix mirrors, that is -(u x v).
    let swapped = flip != (determinant < 0.0);
    let (half_u, half_v) = if swapped { (half_v, half_u) } else { (half_u, half_v) };
    Ok((Geometry::Rectangle { center, half_u, half_v }, swapped))
}

/// The camera and the samples per pixel.
fn sensor(element: Element, options: &Options) -> Result<(Camera, Option<u32>)> {
    let mut object = Object::new(element, &["perspective"])?;
    let to_world = object.transform("to_world")?.unwrap_or(DMat4::IDENTITY);
    let fov = object.float("fov")?.ok_or_else(|| element.error("the sensor lacks <float name=\"fov\">"))?;
    let axis = object.string("fov_axis")?.unwrap_or("x".to_owned());
    ["near_clip", "far_clip"].into_iter().for_each(|name| object.pass_over(name));
    let film = object.take_one_nested("film")?.map(film).transpose()?.unwrap_or(DEFAULT_FILM);
    let spp = object.take_one_nested("sampler")?.map(sampler).transpose()?.flatten();
    object.finish()?;

    let (width, height) = options.size.unwrap_or(film);
    crate::scene::validate::check_size(width, height).map_err(|error| element.error(error))?;
    if !(fov > 0.0 && fov < 180.0) {
        return Err(element.error(format!("field of view {fov} degrees; it must lie between 0 and 180")));
    }
    let fov_x_degrees = horizontal_fov(fov, &axis, f64::from(width) / f64::from(height)).ok_or_else(|| {
        element.error(format!("fov_axis \"{axis}\" is not supported; supported: x, y, diagonal, smaller, larger"))
    })?;
    let camera = Camera { to_world: swap_camera_convention(to_world), fov_x_degrees, width, height };
    camera.validate().map_err(|error| element.error(error))?;
    Ok((camera, spp))
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
    let mut object = Object::new(element, &["hdrfilm"])?;
    let width = object.count("width")?.unwrap_or(DEFAULT_FILM.0);
    let height = object.count("height")?.unwrap_or(DEFAULT_FILM.1);
    ["file_format", "pixel_format", "component_format"].into_iter().for_each(|name| object.pass_over(name));
    if let Some(filter) = object.take_one_nested("rfilter")? {
        Object::new(filter, &["box"])?.finish()?;
    }
    object.finish()?;
    Ok((width, height))
}

fn sampler(element: Element) -> Result<Option<u32>> {
    let mut object = Object::new(element, &["independent", "stratified", "multijitter", "orthogonal", "ldsampler"])?;
    let spp = object.count("sample_count")?;
    object.pass_over("seed");
    object.finish()?;
    Ok(spp)
}

/// The bounce limit, where the file states one.
fn integrator(element: Element) -> Result<Option<u32>> {
    let mut object = Object::new(element, &["path"])?;
    let depth = object.integer("max_depth")?;
    object.pass_over("rr_depth");
    if object.boolean("hide_emitters")? == Some(true) {
        return Err(element.error("hide_emitters is not supported: limpid shows its lights"));
    }
    object.finish()?;
    match depth {
        None => Ok(None),
        Some(depth) => match u32::try_from(depth) {
            Ok(depth @ 1..) => Ok(Some(depth - 1)),
            _ => Err(element.error(format!("max_depth is {depth}; limpid needs a limit of at least 1 (1 + bounces)"))),
        },
    }
}
