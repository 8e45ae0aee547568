//! Lights without a surface: points, and what surrounds the scene.

use super::material::Picture;
use super::validate::{SHEAR_TOLERANCE, check_point, check_radiance};
use crate::{Error, Result};
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// A point that emits alike in all directions, as Mitsuba's `point`.
#[derive(Clone, Debug, PartialEq)]
pub struct PointLight {
    /// Name for messages.
    pub name: String,
    /// Where it is, world space.
    pub position: DVec3,
    /// Radiant intensity, linear RGB, power per unit solid angle.
    pub intensity: DVec3,
}

/// What a ray meets that leaves the scene.
#[derive(Clone, Debug, PartialEq)]
pub enum Environment {
    /// The same radiance from everywhere, linear RGB, as Mitsuba's `constant`.
    Constant(DVec3),
    /// A picture of all directions.
    Map(EnvironmentMap),
}

/// Radiance by direction, as Mitsuba's `envmap`. In the map's own space y is up; columns are centred at the longitudes
/// (x + 1/2) / width of a turn, from -z over +x, rows at the angles y / (height - 1) of half a turn from +y; between
/// them radiance is bilinear.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentMap {
    /// Linear radiance.
    pub picture: Arc<Picture>,
    /// Multiplies it.
    pub scale: f64,
    /// From the map's space to the world: a rotation or a reflection.
    pub to_world: DMat3,
}

impl PointLight {
    /// Refuses what cannot be rendered.
    pub fn validate(&self) -> Result<()> {
        check_point("position", self.position)?;
        check_radiance(self.intensity)
    }
}

impl Environment {
    /// Refuses what cannot be rendered.
    pub fn validate(&self) -> Result<()> {
        match self {
            Self::Constant(radiance) => check_radiance(*radiance),
            Self::Map(map) => map.validate(),
        }
    }

    /// The largest radiance of any direction.
    #[must_use]
    pub fn max_radiance(&self) -> f64 {
        match self {
            Self::Constant(radiance) => radiance.max_element(),
            Self::Map(map) => map.scale * map.picture.texels.iter().flatten().fold(0.0f64, |m, &v| m.max(f64::from(v))),
        }
    }
}

impl EnvironmentMap {
    fn validate(&self) -> Result<()> {
        let picture = &self.picture;
        if picture.width < 2 || picture.height < 3 {
            return Err(Error::input(format!(
                "{}: {}x{} texels; an environment map needs at least 2x3",
                picture.path.display(),
                picture.width,
                picture.height
            )));
        }
        let gram = self.to_world.transpose() * self.to_world;
        if !gram.abs_diff_eq(DMat3::IDENTITY, SHEAR_TOLERANCE) {
            return Err(Error::input("to_world of an environment map must be a rotation (no scale or shear)"));
        }
        check_radiance(DVec3::splat(self.scale))?;
        picture.check(check_radiance)?;
        check_radiance(DVec3::splat(Environment::Map(self.clone()).max_radiance()))
    }
}
