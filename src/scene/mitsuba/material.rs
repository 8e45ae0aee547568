//! Materials and textures.

use super::object::Object;
use super::xml::{Element, Source};
use crate::Result;
use crate::scene::Checker;
use crate::scene::validate::check_albedo;
use glam::{DMat4, DVec2, DVec3};
use std::collections::BTreeMap;

/// Mitsuba's reflectance where the file gives none.
const DEFAULT_REFLECTANCE: f64 = 0.5;

/// A diffuse material: its reflectance and, where it has two, the checkerboard.
#[derive(Clone, Copy)]
pub struct Material {
    pub albedo: DVec3,
    pub checker: Option<Checker>,
}

impl Default for Material {
    fn default() -> Self {
        Self { albedo: DVec3::splat(DEFAULT_REFLECTANCE), checker: None }
    }
}

/// Materials by id.
pub type Materials = BTreeMap<String, Material>;

/// Every material that has an id, nested ones included.
pub fn materials(sources: &[Source]) -> Result<Materials> {
    let mut materials = Materials::new();
    for element in sources.iter().flat_map(|source| Element::root(source).descendants()) {
        if element.tag() == "bsdf" {
            let material = bsdf(element)?;
            if let Some(id) = element.attribute("id")? {
                materials.insert(id, material);
            }
        }
    }
    Ok(materials)
}

/// The material of a shape: nested, by reference, or Mitsuba's default, which is black for what emits.
pub fn material(object: &mut Object, materials: &Materials, emits: bool) -> Result<Material> {
    let element = object.element;
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
    let default = if emits { Material { albedo: DVec3::ZERO, checker: None } } else { Material::default() };
    Ok(used.pop().unwrap_or(default))
}

fn bsdf(element: Element) -> Result<Material> {
    let Some(mut object) = Object::new(element, &["diffuse"])? else { return inner(element) };
    let reflectance = object.color("reflectance", check_albedo)?;
    let texture = object.take_one_nested("texture")?;
    object.finish()?;
    let plain = reflectance.map_or_else(Material::default, |albedo| Material { albedo, checker: None });
    match texture {
        Some(texture) if reflectance.is_some() => {
            Err(texture.error(format!("{} has a reflectance beside its texture", element.words())))
        }
        Some(texture) => Ok(checkerboard(texture)?.unwrap_or(plain)),
        None => Ok(plain),
    }
}

/// What stands for a material that is passed over: the one inside it, if there is one, else the default.
fn inner(element: Element) -> Result<Material> {
    match element.children()?.into_iter().find(|child| child.tag() == "bsdf") {
        Some(nested) => bsdf(nested),
        None => Ok(Material::default()),
    }
}

/// Mitsuba's defaults are 0.4 and 0.2, one repeat.
fn checkerboard(element: Element) -> Result<Option<Material>> {
    if element.required("name")? != "reflectance" {
        return Err(element.error(format!("{} must be named reflectance", element.words())));
    }
    let Some(mut object) = Object::new(element, &["checkerboard"])? else { return Ok(None) };
    let albedo = object.color("color0", check_albedo)?.unwrap_or(DVec3::splat(0.4));
    let second = object.color("color1", check_albedo)?.unwrap_or(DVec3::splat(0.2));
    let to_uv = object.transform("to_uv")?.unwrap_or(DMat4::IDENTITY);
    object.finish()?;
    let off_diagonal = [to_uv.x_axis.y, to_uv.y_axis.x, to_uv.x_axis.z, to_uv.y_axis.z, to_uv.z_axis.x, to_uv.z_axis.y];
    if off_diagonal.iter().any(|v| *v != 0.0) {
        element.unsupported("to_uv of a checkerboard may scale and translate; rotations are not supported")?;
        return Ok(None);
    }
    let repeats = DVec2::new(to_uv.x_axis.x, to_uv.y_axis.y);
    let checker = Checker { albedo: second, repeats, offset: to_uv.w_axis.truncate().truncate() };
    checker.validate().map_err(|error| element.error(error))?;
    Ok(Some(Material { albedo, checker: Some(checker) }))
}
