//! Materials.

use super::media::{medium, medium_names, metal, metal_names};
use super::object::Object;
use super::texture::{Textures, bitmap_or_checkerboard};
use super::xml::{Element, Source};
use crate::Result;
use crate::scene::validate::check_albedo;
use crate::scene::{Bsdf, Material};
use glam::DVec3;
use std::collections::BTreeMap;

/// Mitsuba's reflectance where the file gives none.
const DEFAULT_REFLECTANCE: f64 = 0.5;
const KINDS: [&str; 6] = ["diffuse", "conductor", "roughconductor", "dielectric", "plastic", "twosided"];

/// What a surface is made of where the file does not say.
fn default_material() -> Material {
    Material::diffuse(DVec3::splat(DEFAULT_REFLECTANCE))
}

/// What shapes may refer to, by id.
pub struct Materials {
    materials: BTreeMap<String, Material>,
    textures: Textures,
}

impl Materials {
    /// Every texture and material that has an id, nested ones included.
    pub fn read(sources: &[Source]) -> Result<Self> {
        let elements: Vec<Element> = sources.iter().flat_map(|source| Element::root(source).descendants()).collect();
        let mut all = Self { materials: BTreeMap::new(), textures: Textures::new() };
        for element in elements.iter().filter(|element| element.tag() == "texture") {
            if let Some(id) = element.attribute("id")?
                && let Some(texture) = bitmap_or_checkerboard(*element)?
            {
                all.textures.insert(id, texture);
            }
        }
        for element in elements.into_iter().filter(|element| element.tag() == "bsdf") {
            let material = all.bsdf(element)?;
            if let Some(id) = element.attribute("id")? {
                all.materials.insert(id, material);
            }
        }
        Ok(all)
    }

    /// The material of a shape: nested, by reference, or Mitsuba's default, which is black for what emits.
    pub fn of(&self, object: &mut Object, emits: bool) -> Result<Material> {
        let element = object.element;
        let mut used = self.used(object, |id| format!("no bsdf has the id '{id}'"))?;
        if used.len() > 1 {
            return Err(element.error(format!("{} has {} materials; it can have one", element.words(), used.len())));
        }
        Ok(used.pop().unwrap_or_else(|| if emits { Material::diffuse(DVec3::ZERO) } else { default_material() }))
    }

    /// The bsdfs that are nested in an object or that it refers to; `missing` says what is wrong with an id that is not known.
    fn used(&self, object: &mut Object, missing: impl Fn(&str) -> String) -> Result<Vec<Material>> {
        let nested = object.take_nested("bsdf").into_iter().map(|nested| self.bsdf(nested));
        let mut used = nested.collect::<Result<Vec<_>>>()?;
        for (reference, id) in object.references()? {
            let material = self.materials.get(&id).cloned();
            used.push(material.ok_or_else(|| reference.error(missing(&id)))?);
        }
        Ok(used)
    }

    fn bsdf(&self, element: Element) -> Result<Material> {
        let Some(mut object) = Object::new(element, &KINDS)? else { return self.inner(element) };
        let material = match object.kind() {
            "diffuse" => self.textured(&mut object, "reflectance", default_material())?,
            "conductor" | "roughconductor" => self.conductor(&mut object)?,
            "dielectric" => dielectric(&mut object)?,
            "plastic" => self.plastic(&mut object)?,
            _ => self.two_sided(&mut object)?,
        };
        object.finish()?;
        material.bsdf.validate().map_err(|error| element.error(error))?;
        Ok(material)
    }

    /// What stands for a material that is passed over: the one inside it, if there is one, else the default.
    fn inner(&self, element: Element) -> Result<Material> {
        match element.children()?.into_iter().find(|child| child.tag() == "bsdf") {
            Some(nested) => self.bsdf(nested),
            None => Ok(default_material()),
        }
    }

    /// A material whose albedo is the colour or texture of this name, if there is one.
    fn textured(&self, object: &mut Object, name: &'static str, plain: Material) -> Result<Material> {
        let element = object.element;
        let color = object.color(name, check_albedo)?;
        let texture = self.textures.take(object, name)?;
        if let (Some(texture), true) = (texture.as_ref(), color.is_some()) {
            return Err(texture.element.error(format!("{} has a {name} beside its texture", element.words())));
        }
        Ok(match texture.and_then(|texture| texture.value) {
            Some((albedo, texture)) => Material { albedo, texture: Some(texture), ..plain },
            None => Material { albedo: color.unwrap_or(plain.albedo), ..plain },
        })
    }

    fn plastic(&self, object: &mut Object) -> Result<Material> {
        let ior = relative_ior(object, "polypropylene")?;
        let specular = object.color("specular_reflectance", check_albedo)?.unwrap_or(DVec3::ONE);
        let nonlinear = object.boolean("nonlinear")? == Some(true);
        let bsdf = Bsdf::Plastic { ior, specular, nonlinear };
        self.textured(object, "diffuse_reflectance", Material { bsdf, ..default_material() })
    }

    fn conductor(&self, object: &mut Object) -> Result<Material> {
        let (eta, k) = optical_constants(object)?;
        let roughness = if object.kind() == "roughconductor" { roughness(object)? } else { None };
        let bsdf = Bsdf::Conductor { eta, k, roughness };
        self.textured(object, "specular_reflectance", Material { bsdf, ..Material::diffuse(DVec3::ONE) })
    }

    fn two_sided(&self, object: &mut Object) -> Result<Material> {
        let element = object.element;
        let inside = self.used(object, |id| format!("no bsdf before this one has the id '{id}'; move it up"))?;
        if inside.len() > 1 {
            element.unsupported("a twosided bsdf with two materials is not supported; give it one for both sides")?;
        }
        let Some(material) = inside.into_iter().next() else {
            return Err(element.error(format!("{} lacks the bsdf that both sides shall have", element.words())));
        };
        if material.bsdf.transmits() {
            return Err(element.error("a twosided bsdf cannot hold a dielectric, which has two sides of its own"));
        }
        Ok(Material { two_sided: true, ..material })
    }
}

/// Real and imaginary part of a metal's index of refraction.
fn optical_constants(object: &mut Object) -> Result<(DVec3, DVec3)> {
    let element = object.element;
    let name = object.string("material")?;
    let number = |v: DVec3| if v.is_finite() { Ok(()) } else { Err(crate::Error::input("not finite")) };
    let (eta, k) = (object.color("eta", number)?, object.color("k", number)?);
    match name.as_deref() {
        None | Some("none") => Ok((eta.unwrap_or(DVec3::ZERO), k.unwrap_or(DVec3::ONE))),
        Some(_) if eta.is_some() || k.is_some() => {
            Err(element.error(format!("{} has a material beside eta or k", element.words())))
        }
        Some(name) => metal(name).ok_or_else(|| {
            element
                .error(format!("material \"{name}\" is not known; known: none, {}; or give eta and k", metal_names()))
        }),
    }
}

fn roughness(object: &mut Object) -> Result<Option<f64>> {
    let element = object.element;
    let distribution = object.string("distribution")?.unwrap_or("beckmann".to_owned());
    if !distribution.eq_ignore_ascii_case("ggx") {
        element.unsupported(format!(
            "distribution \"{distribution}\" (Mitsuba's default is beckmann) is not supported; supported: ggx"
        ))?;
    }
    // Another way to draw the same distribution.
    object.pass_over("sample_visible");
    Ok(Some(object.float("alpha")?.unwrap_or(0.1)))
}

fn dielectric(object: &mut Object) -> Result<Material> {
    let ior = relative_ior(object, "bk7")?;
    let albedo = object.color("specular_reflectance", check_albedo)?.unwrap_or(DVec3::ONE);
    let transmittance = object.color("specular_transmittance", check_albedo)?.unwrap_or(DVec3::ONE);
    Ok(Material { albedo, bsdf: Bsdf::Dielectric { ior, transmittance }, ..default_material() })
}

/// `int_ior` over `ext_ior`, numbers or names.
fn relative_ior(object: &mut Object, inside: &str) -> Result<f64> {
    let mut ior = |name: &'static str, default: &str| -> Result<f64> {
        let element = object.element;
        if object.is_number(name) {
            return Ok(object.float(name)?.unwrap_or_default());
        }
        let given = object.string(name)?.unwrap_or(default.to_owned());
        medium(&given).ok_or_else(|| {
            element.error(format!("{name} \"{given}\" is not known; known: {}; or give a number", medium_names()))
        })
    };
    let (inside, outside) = (ior("int_ior", inside)?, ior("ext_ior", "air")?);
    Ok(inside / outside)
}
