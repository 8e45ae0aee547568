//! Materials: the metallic-roughness model in limpid's terms.
//!
//! - Metallic above 1/2: a conductor that reflects its base colour at every angle, rough with alpha = roughness², a mirror where that is under
//!   1e-3.
//! - Transmission above 1/2: a smooth dielectric of its index of refraction that lets its base colour pass.
//! - Else, up to a roughness of 0.1: plastic of its index of refraction; rougher, diffuse.

use super::Notes;
use crate::scene::validate::{check_albedo, check_radiance};
use crate::scene::{Bitmap, Bsdf, Filter, MIN_ROUGHNESS, Material, Picture, Texture, Wrap};
use crate::{Error, Result};
use glam::{DMat2, DVec2, DVec3};
use gltf::image::Format;
use gltf::texture::WrappingMode;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

/// The roughness up to which what is no metal is coated.
const COATED: f32 = 0.1;

/// A surface's material, what it emits, and the set of texture coordinates that it needs.
pub struct Surface {
    pub material: Material,
    pub radiance: DVec3,
    pub uv_set: u32,
}

/// An image and the bits of the colour that multiplies it.
type PictureKey = (usize, [u32; 3]);

/// All materials of a file; each picture is taken out once per colour that multiplies it.
pub struct Materials<'a> {
    notes: &'a Notes<'a>,
    images: &'a [gltf::image::Data],
    pictures: RefCell<BTreeMap<PictureKey, Arc<Picture>>>,
}

impl<'a> Materials<'a> {
    pub fn new(notes: &'a Notes<'a>, images: &'a [gltf::image::Data]) -> Self {
        Self { notes, images, pictures: RefCell::default() }
    }

    pub fn of(&self, material: &gltf::Material) -> Result<Surface> {
        let name = material.name().map_or_else(
            || material.index().map_or("the default material".to_owned(), |i| format!("material {i}")),
            |name| format!("material '{name}'"),
        );
        self.refuse(material, &name)?;
        let pbr = material.pbr_metallic_roughness();
        let [r, g, b, _] = pbr.base_color_factor();
        let color = DVec3::from_array([r, g, b].map(f64::from));
        let fail = |error: Error| self.notes.error(format!("{name}: {error}"));
        check_albedo(color).map_err(fail)?;
        let info = pbr.base_color_texture();
        let uv_set = info.as_ref().map_or(0, |info| {
            info.texture_transform().and_then(|transform| transform.tex_coord()).unwrap_or(info.tex_coord())
        });
        let texture = info.map(|info| self.bitmap(&info, [r, g, b], &name)).transpose()?;
        let strength = f64::from(material.emissive_strength().unwrap_or(1.0));
        let radiance = DVec3::from_array(material.emissive_factor().map(f64::from)) * strength;
        check_radiance(radiance).map_err(fail)?;
        let ior = f64::from(material.ior().unwrap_or(1.5));
        let (metallic, roughness) = (pbr.metallic_factor(), pbr.roughness_factor());
        let transmission = material.transmission().map_or(0.0, |t| t.transmission_factor());
        let mut albedo = color;
        let bsdf = if metallic > 0.5 {
            let alpha = f64::from(roughness).powi(2).min(1.0);
            let roughness = (alpha >= MIN_ROUGHNESS).then_some(alpha);
            Bsdf::Conductor { eta: DVec3::ZERO, k: DVec3::ONE, roughness }
        } else if transmission > 0.5 {
            albedo = DVec3::ONE;
            Bsdf::Dielectric { ior, transmittance: color }
        } else if roughness <= COATED {
            Bsdf::Plastic { ior, specular: DVec3::ONE, nonlinear: false }
        } else {
            Bsdf::Diffuse
        };
        bsdf.validate().map_err(fail)?;
        let two_sided = material.double_sided() && !bsdf.transmits();
        let texture = if bsdf.transmits() { None } else { texture };
        if texture.is_some() {
            // As with Mitsuba's files: the picture has the colour.
            albedo = DVec3::ONE;
        }
        Ok(Surface { material: Material { albedo, texture, bsdf, two_sided }, radiance, uv_set })
    }

    /// What of a material limpid does not have.
    fn refuse(&self, material: &gltf::Material, name: &str) -> Result<()> {
        let pbr = material.pbr_metallic_roughness();
        let transmits = material.transmission().is_some_and(|t| t.transmission_factor() > 0.5);
        for (has, what) in [
            (material.alpha_mode() != gltf::material::AlphaMode::Opaque, "transparency (alphaMode)"),
            (material.normal_texture().is_some(), "a normal texture"),
            (pbr.metallic_roughness_texture().is_some(), "a metallic-roughness texture"),
            (material.emissive_texture().is_some(), "an emissive texture"),
            (transmits && pbr.base_color_texture().is_some(), "a base colour texture on what transmits"),
        ] {
            if has {
                self.notes.unsupported(format!("{name}: {what} is not supported"))?;
            }
        }
        Ok(())
    }

    fn bitmap(&self, info: &gltf::texture::Info, factor: [f32; 3], name: &str) -> Result<Texture> {
        let sampler = info.texture().sampler();
        if sampler.wrap_s() != sampler.wrap_t() {
            self.notes
                .unsupported(format!("{name}: a texture that wraps otherwise along u than along v is not supported"))?;
        }
        let wrap = match sampler.wrap_s() {
            WrappingMode::Repeat => Wrap::Repeat,
            WrappingMode::MirroredRepeat => Wrap::Mirror,
            WrappingMode::ClampToEdge => Wrap::Clamp,
        };
        let nearest = sampler.mag_filter() == Some(gltf::texture::MagFilter::Nearest);
        let filter = if nearest { Filter::Nearest } else { Filter::Bilinear };
        let (mut matrix, mut offset) = (DMat2::IDENTITY, DVec2::ZERO);
        if let Some(transform) = info.texture_transform() {
            let scale = DVec2::from_array(transform.scale().map(f64::from));
            matrix = DMat2::from_angle(f64::from(transform.rotation())) * DMat2::from_diagonal(scale);
            offset = DVec2::from_array(transform.offset().map(f64::from));
        }
        let picture = self.picture(info.texture().source().index(), factor)?;
        let texture = Texture::Bitmap(Bitmap { picture, matrix, offset, wrap, filter });
        texture.validate().map_err(|error| self.notes.error(format!("{name}: {error}")))?;
        Ok(texture)
    }

    /// An image in linear RGB times the base colour's factor.
    fn picture(&self, index: usize, factor: [f32; 3]) -> Result<Arc<Picture>> {
        let key = (index, factor.map(f32::to_bits));
        if let Some(picture) = self.pictures.borrow().get(&key) {
            return Ok(picture.clone());
        }
        let data = self.images.get(index).ok_or_else(|| self.notes.error(format!("there is no image {index}")))?;
        let texels = texels(data, factor).ok_or_else(|| {
            self.notes
                .error(format!("image {index}: {:?} is not supported, only integers of 8 or 16 bits", data.format))
        })?;
        let path = PathBuf::from(format!("{}#image-{index}", self.notes.file.display()));
        let picture =
            Arc::new(Picture { path, has_file: false, raw: false, width: data.width, height: data.height, texels });
        self.pictures.borrow_mut().insert(key, picture.clone());
        Ok(picture)
    }
}

fn texels(data: &gltf::image::Data, factor: [f32; 3]) -> Option<Vec<[f32; 3]>> {
    let (channels, wide) = match data.format {
        Format::R8 => (1, false),
        Format::R8G8 => (2, false),
        Format::R8G8B8 => (3, false),
        Format::R8G8B8A8 => (4, false),
        Format::R16 => (1, true),
        Format::R16G16 => (2, true),
        Format::R16G16B16 => (3, true),
        Format::R16G16B16A16 => (4, true),
        Format::R32G32B32FLOAT | Format::R32G32B32A32FLOAT => return None,
    };
    let values: Vec<f32> = if wide {
        data.pixels.as_chunks().0.iter().map(|&v| f32::from(u16::from_ne_bytes(v)) / 65535.0).collect()
    } else {
        data.pixels.iter().map(|&v| f32::from(v) / 255.0).collect()
    };
    // Grey, with or without alpha, counts for all three colours.
    let color = |texel: &[f32]| if channels < 3 { [texel[0]; 3] } else { [texel[0], texel[1], texel[2]] };
    let linear = |texel: &[f32]| {
        let color = color(texel).map(crate::image::png::srgb_decode);
        std::array::from_fn(|k| color[k] * factor[k])
    };
    Some(values.chunks_exact(channels).map(linear).collect())
}
