//! How surfaces scatter light: reflection models and textures.

use super::validate::{MAX_REPEATS, check_albedo};
use super::{Geometry, Shape};
use crate::{Error, Result};
use glam::{DMat2, DVec2, DVec3, Vec2Swizzles};
use std::path::PathBuf;
use std::sync::Arc;

/// The range of an index of refraction, of the inside over that of the outside.
pub const IOR_RANGE: std::ops::RangeInclusive<f64> = 0.1..=10.0;
/// The least roughness of a rough conductor: below it the lobe is narrower than f32 resolves.
pub const MIN_ROUGHNESS: f64 = 1e-3;
/// The largest eta and k of a conductor.
const MAX_CONDUCTOR: f64 = 100.0;

/// How a surface scatters light, as the plugins of Mitsuba 3 of the same names. [`Shape::albedo`] is the colour that the user
/// sees first; what else there is stands here. All but `Dielectric` reflect on their front only.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Bsdf {
    /// Lambertian; the albedo is the reflectance.
    #[default]
    Diffuse,
    /// A metal with the complex index of refraction `eta + i k`; the albedo scales its Fresnel reflectance.
    Conductor {
        /// Real part, linear RGB.
        eta: DVec3,
        /// Imaginary part, linear RGB.
        k: DVec3,
        /// Alpha of a GGX distribution of visible normals (Trowbridge and Reitz 1975, Walter et al. 2007); none is a mirror.
        roughness: Option<f64>,
    },
    /// A smooth surface between two transparent media; the albedo scales what it reflects.
    Dielectric {
        /// Index of refraction behind the normal over that before it.
        ior: f64,
        /// Scales what passes, linear RGB.
        transmittance: DVec3,
    },
    /// A diffuse base, whose reflectance is the albedo, under a smooth dielectric coating.
    Plastic {
        /// Index of refraction of the coating over that of the outside.
        ior: f64,
        /// Scales what the coating reflects, linear RGB.
        specular: DVec3,
        /// Whether colours saturate by repeated reflection inside the coating.
        nonlinear: bool,
    },
}

impl Bsdf {
    /// Refuses what cannot be rendered: indices of refraction, roughness and colours out of range.
    pub fn validate(&self) -> Result<()> {
        match *self {
            Self::Diffuse => Ok(()),
            Self::Conductor { eta, k, roughness } => {
                for (name, value) in [("eta", eta), ("k", k)] {
                    if !value.to_array().iter().all(|v| (0.0..=MAX_CONDUCTOR).contains(v)) {
                        return Err(Error::input(format!(
                            "conductor: {name} is {:?}; each part must lie in [0, {MAX_CONDUCTOR}]",
                            value.to_array()
                        )));
                    }
                }
                match roughness {
                    Some(alpha) if !(MIN_ROUGHNESS..=1.0).contains(&alpha) => Err(Error::input(format!(
                        "rough conductor: alpha is {alpha}; it must lie in [{MIN_ROUGHNESS}, 1] (a conductor is smooth)"
                    ))),
                    _ => Ok(()),
                }
            }
            Self::Dielectric { ior, transmittance: color } | Self::Plastic { ior, specular: color, .. } => {
                if !IOR_RANGE.contains(&ior) {
                    return Err(Error::input(format!(
                        "the index of refraction inside over that outside is {ior}; it must lie in {IOR_RANGE:?}"
                    )));
                }
                check_albedo(color)
            }
        }
    }

    /// Whether both sides of the surface scatter by themselves.
    #[must_use]
    pub fn transmits(&self) -> bool {
        matches!(self, Self::Dielectric { .. })
    }
}

/// What a surface is made of: all of a [`Shape`] but where it is and what it emits.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// See [`Shape::albedo`].
    pub albedo: DVec3,
    /// See [`Shape::texture`].
    pub texture: Option<Texture>,
    /// See [`Shape::bsdf`].
    pub bsdf: Bsdf,
    /// See [`Shape::two_sided`].
    pub two_sided: bool,
}

impl Material {
    /// One-sided and Lambertian, of one colour.
    #[must_use]
    pub fn diffuse(albedo: DVec3) -> Self {
        Self { albedo, texture: None, bsdf: Bsdf::Diffuse, two_sided: false }
    }

    /// A shape of it.
    #[must_use]
    pub fn shape(self, name: String, geometry: Geometry, radiance: DVec3) -> Shape {
        let Self { albedo, texture, bsdf, two_sided } = self;
        Shape { name, geometry, albedo, texture, bsdf, two_sided, radiance }
    }
}

/// A reflectance that varies over the surface parameters (u, v). On a rectangle u and v run from 0 to 1 along `half_u` and `half_v`;
/// on a sphere u is the longitude about z from x, as part of a turn, and v the angle from z as part of half a turn. On a disk u is the distance
/// from the centre as part of the radius, and v the angle from `half_u` toward `half_v` as part of a turn. A mesh has its own u and v.
#[derive(Clone, Debug, PartialEq)]
pub enum Texture {
    /// Two colours, of which [`Shape::albedo`] is the first.
    Checker(Checker),
    /// A picture, which replaces [`Shape::albedo`].
    Bitmap(Bitmap),
}

impl Texture {
    /// The same where u and v change places.
    #[must_use]
    pub fn swapped(self) -> Self {
        match self {
            Self::Checker(checker) => Self::Checker(checker.swapped()),
            Self::Bitmap(bitmap) => Self::Bitmap(bitmap.after(DMat2::from_cols(DVec2::Y, DVec2::X), DVec2::ZERO)),
        }
    }

    /// The same where v runs the other way.
    #[must_use]
    pub fn mirrored(self) -> Self {
        match self {
            Self::Checker(checker) => Self::Checker(checker.mirrored()),
            Self::Bitmap(bitmap) => Self::Bitmap(bitmap.after(DMat2::from_diagonal(DVec2::new(1.0, -1.0)), DVec2::Y)),
        }
    }

    /// Refuses what cannot be rendered.
    pub fn validate(&self) -> Result<()> {
        match self {
            Self::Checker(checker) => checker.validate(),
            Self::Bitmap(bitmap) => bitmap.validate(),
        }
    }
}

/// A checkerboard, as Mitsuba's `checkerboard` texture: the cell of (u, v) follows from `uv = repeats * (u, v) + offset`; where both or
/// neither of the fractions of uv are above 1/2 lies the first reflectance, elsewhere the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checker {
    /// The second reflectance, linear RGB, each in [0, 1]; [`Shape::albedo`] is the first.
    pub albedo: DVec3,
    /// Pairs of cells along u and v.
    pub repeats: DVec2,
    /// Shift of the cells, in pairs.
    pub offset: DVec2,
}

impl Checker {
    /// The same cells where u and v change places.
    #[must_use]
    pub fn swapped(self) -> Self {
        Self { repeats: self.repeats.yx(), offset: self.offset.yx(), ..self }
    }

    /// The same cells where v runs the other way.
    #[must_use]
    pub fn mirrored(self) -> Self {
        let DVec2 { x, y } = self.repeats;
        Self { repeats: DVec2::new(x, -y), offset: self.offset + DVec2::new(0.0, y), ..self }
    }

    fn validate(self) -> Result<()> {
        check_albedo(self.albedo)?;
        check_uv("checkerboard", &[self.repeats.to_array(), self.offset.to_array()].concat())
    }
}

/// How a picture goes on beyond its edges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// It begins again.
    #[default]
    Repeat,
    /// It begins again, every second time the other way round.
    Mirror,
    /// Its edge goes on.
    Clamp,
}

/// What lies between the centres of its texels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// Straight lines.
    #[default]
    Bilinear,
    /// The nearest texel.
    Nearest,
}

/// A picture on a surface, as Mitsuba's `bitmap` texture. (0, 0) is the upper left corner of its first texel, (1, 1) the lower right one of its last.
#[derive(Clone, Debug, PartialEq)]
pub struct Bitmap {
    /// The texels.
    pub picture: Arc<Picture>,
    /// From (u, v) to the picture's coordinates: `matrix * (u, v) + offset`.
    pub matrix: DMat2,
    /// See `matrix`.
    pub offset: DVec2,
    /// Beyond the edges.
    pub wrap: Wrap,
    /// Between the texels.
    pub filter: Filter,
}

/// Texels in linear RGB, row by row from the top, and the file that they came from.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Where it was read from.
    pub path: PathBuf,
    /// Whether that is a file that holds it as it is; else it came out of a larger one.
    pub has_file: bool,
    /// Whether the file's numbers were taken as they are (Mitsuba's `raw`) rather than as sRGB.
    pub raw: bool,
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// `width * height` of them.
    pub texels: Vec<[f32; 3]>,
}

impl Bitmap {
    /// The same picture where (u, v) are changed first: `matrix * (u, v) + offset` takes their place.
    #[must_use]
    fn after(self, matrix: DMat2, offset: DVec2) -> Self {
        Self { offset: self.matrix * offset + self.offset, matrix: self.matrix * matrix, ..self }
    }

    fn validate(&self) -> Result<()> {
        check_uv("bitmap", &[&self.matrix.to_cols_array()[..], &self.offset.to_array()].concat())?;
        self.picture.check(check_albedo)
    }
}

impl Picture {
    /// The mean of the texels.
    #[must_use]
    pub fn mean(&self) -> DVec3 {
        let sum: DVec3 = self.texels.iter().map(|texel| DVec3::from_array(texel.map(f64::from))).sum();
        sum / self.texels.len() as f64
    }

    /// Checks size and texels; an error names the file.
    pub(super) fn check(&self, check: fn(DVec3) -> Result<()>) -> Result<()> {
        let fail = |cause: String| Err(Error::input(format!("{}: {cause}", self.path.display())));
        if self.width == 0 || self.height == 0 || self.texels.len() != self.width as usize * self.height as usize {
            return fail(format!("{} texels for {}x{}", self.texels.len(), self.width, self.height));
        }
        for (i, texel) in self.texels.iter().enumerate() {
            if let Err(error) = check(DVec3::from_array(texel.map(f64::from))) {
                let (x, y) = (i % self.width as usize, i / self.width as usize);
                return fail(format!("texel ({x}, {y}): {error}"));
            }
        }
        Ok(())
    }
}

fn check_uv(what: &str, numbers: &[f64]) -> Result<()> {
    if numbers.iter().all(|v| v.abs() <= MAX_REPEATS) {
        return Ok(());
    }
    Err(Error::input(format!("{what}: to_uv scales and shifts by {numbers:?}; at most {MAX_REPEATS:e} each")))
}
