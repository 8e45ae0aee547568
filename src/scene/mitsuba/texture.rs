//! Textures.

use super::object::Object;
use super::xml::Element;
use crate::Result;
use crate::scene::validate::check_albedo;
use crate::scene::{Bitmap, Checker, Filter, Texture, Wrap};
use glam::{DMat2, DMat4, DVec2, DVec3};
use std::collections::BTreeMap;

/// A texture with the albedo that goes with it.
type Textured = (DVec3, Texture);

/// Textures by id.
pub struct Textures(BTreeMap<String, Textured>);

/// A texture that a material names; no value where it is passed over.
pub struct Named<'a> {
    pub element: Element<'a>,
    pub value: Option<Textured>,
}

impl Textures {
    pub fn new() -> Self {
        Self(BTreeMap::new())
    }

    pub fn insert(&mut self, id: String, texture: Textured) {
        self.0.insert(id, texture);
    }

    /// The texture of this name that is nested in an object or referred to by it.
    pub fn take<'a>(&self, object: &mut Object<'a>, name: &str) -> Result<Option<Named<'a>>> {
        if let Some(element) = object.take_one_nested("texture")? {
            if element.required("name")? != name {
                return Err(element.error(format!("{} must be named {name}", element.words())));
            }
            return Ok(Some(Named { element, value: bitmap_or_checkerboard(element)? }));
        }
        let Some((element, id)) = object.references()?.into_iter().next() else { return Ok(None) };
        if element.required("name")? != name {
            return Err(element.error(format!("{} must be named {name}", element.words())));
        }
        let value = self.0.get(&id).cloned();
        let value = value.ok_or_else(|| element.error(format!("no texture has the id '{id}'")))?;
        Ok(Some(Named { element, value: Some(value) }))
    }
}

/// None where it is passed over.
pub fn bitmap_or_checkerboard(element: Element) -> Result<Option<Textured>> {
    let Some(mut object) = Object::new(element, &["bitmap", "checkerboard"])? else { return Ok(None) };
    let textured = if object.kind() == "bitmap" { bitmap(&mut object)? } else { checkerboard(&mut object)? };
    object.finish()?;
    if let Some((_, texture)) = &textured {
        texture.validate().map_err(|error| element.error(error))?;
    }
    Ok(textured)
}

/// Mitsuba's defaults are 0.4 and 0.2, one repeat.
fn checkerboard(object: &mut Object) -> Result<Option<Textured>> {
    let albedo = object.color("color0", check_albedo)?.unwrap_or(DVec3::splat(0.4));
    let second = object.color("color1", check_albedo)?.unwrap_or(DVec3::splat(0.2));
    let to_uv = object.transform("to_uv")?.unwrap_or(DMat4::IDENTITY);
    let off_diagonal = [to_uv.x_axis.y, to_uv.y_axis.x, to_uv.x_axis.z, to_uv.y_axis.z, to_uv.z_axis.x, to_uv.z_axis.y];
    if off_diagonal.iter().any(|v| *v != 0.0) {
        object.element.unsupported("to_uv of a checkerboard may scale and translate; rotations are not supported")?;
        return Ok(None);
    }
    let repeats = DVec2::new(to_uv.x_axis.x, to_uv.y_axis.y);
    let checker = Checker { albedo: second, repeats, offset: to_uv.w_axis.truncate().truncate() };
    Ok(Some((albedo, Texture::Checker(checker))))
}

fn bitmap(object: &mut Object) -> Result<Option<Textured>> {
    let element = object.element;
    let file = object.filename()?;
    let raw = object.boolean("raw")? == Some(true);
    let to_uv = object.transform("to_uv")?.unwrap_or(DMat4::IDENTITY);
    let filter = choice(object, "filter_type", &[("bilinear", Filter::Bilinear), ("nearest", Filter::Nearest)])?;
    let wraps = [("repeat", Wrap::Repeat), ("mirror", Wrap::Mirror), ("clamp", Wrap::Clamp)];
    let wrap = choice(object, "wrap_mode", &wraps)?;
    // How Mitsuba stores it.
    ["format", "accel"].into_iter().for_each(|name| object.pass_over(name));
    let picture = element.source.picture(&file, raw).map_err(|error| element.error(error))?;
    let column = |v: glam::DVec4| v.truncate().truncate();
    let matrix = DMat2::from_cols(column(to_uv.x_axis), column(to_uv.y_axis));
    let bitmap = Bitmap { picture, matrix, offset: column(to_uv.w_axis), wrap, filter };
    // White, so that what looks at the albedo alone does not take the surface for black.
    Ok(Some((DVec3::ONE, Texture::Bitmap(bitmap))))
}

/// One of several words, the first of which is the default.
fn choice<T: Copy>(object: &mut Object, name: &'static str, words: &[(&str, T)]) -> Result<T> {
    let given = object.string(name)?.unwrap_or(words[0].0.to_owned());
    let known = words.iter().find(|(word, _)| *word == given);
    known.map(|(_, value)| *value).ok_or_else(|| {
        let known: Vec<_> = words.iter().map(|(word, _)| *word).collect();
        object.element.error(format!("{name} \"{given}\" is not known; known: {}", known.join(", ")))
    })
}
