//! Lights without a surface: points, directions, and what surrounds the scene.

use super::material::Picture;
use super::validate::{SHEAR_TOLERANCE, check_point, check_radiance};
use crate::{Error, Result};
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// A light that no ray meets: it comes from one point or one direction.
#[derive(Clone, Debug, PartialEq)]
pub struct DeltaLight {
    /// Name for messages.
    pub name: String,
    /// Radiant intensity, linear RGB, power per unit solid angle; of [`DeltaKind::Directional`] the irradiance of a surface that faces it.
    pub intensity: DVec3,
    /// Where it is and where it shines.
    pub kind: DeltaKind,
}

/// Where a light without a surface is and where it shines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DeltaKind {
    /// In all directions alike, as Mitsuba's `point`.
    Point {
        /// World space.
        position: DVec3,
    },
    /// In a cone, as Mitsuba's `spot`.
    Spot {
        /// World space.
        position: DVec3,
        /// The cone's axis, away from the light, unit length.
        direction: DVec3,
        /// Angle from the axis up to which it has its full intensity.
        beam_degrees: f64,
        /// Angle from the axis beyond which it has none, above `beam_degrees` and under 180.
        cutoff_degrees: f64,
        /// What lies between the two.
        falloff: Falloff,
    },
    /// From far away, as Mitsuba's `directional`.
    Directional {
        /// Where its light goes, unit length.
        direction: DVec3,
    },
}

/// How a spot light fades between its two angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Falloff {
    /// Linearly in the angle, as in Mitsuba.
    Linear,
    /// By the square of what is linear in the cosine, as in glTF (`KHR_lights_punctual`).
    Squared,
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

impl DeltaLight {
    /// Refuses what cannot be rendered.
    pub fn validate(&self) -> Result<()> {
        let (DeltaKind::Spot { direction, .. } | DeltaKind::Directional { direction }) = self.kind else {
            return self.check_position();
        };
        if (direction.length() - 1.0).abs() > SHEAR_TOLERANCE || !direction.is_finite() {
            return Err(Error::input(format!("direction {direction}; it must have length 1")));
        }
        if let DeltaKind::Spot { beam_degrees, cutoff_degrees, .. } = self.kind
            && !(0.0 <= beam_degrees && beam_degrees < cutoff_degrees && cutoff_degrees < 180.0)
        {
            return Err(Error::input(format!(
                "spot light: beam of {beam_degrees} and cutoff of {cutoff_degrees} degrees; the beam must be narrower than the \
                 cutoff, and that under 180"
            )));
        }
        self.check_position()
    }

    /// Where it is; none at infinity.
    #[must_use]
    pub fn position(&self) -> Option<DVec3> {
        match self.kind {
            DeltaKind::Point { position } | DeltaKind::Spot { position, .. } => Some(position),
            DeltaKind::Directional { .. } => None,
        }
    }

    fn check_position(&self) -> Result<()> {
        self.position().map_or(Ok(()), |position| check_point("position", position))?;
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
            Self::Map(map) => map.max_radiance(),
        }
    }
}

impl EnvironmentMap {
    fn max_radiance(&self) -> f64 {
        self.scale * self.picture.texels.iter().flatten().fold(0.0f64, |m, &v| m.max(f64::from(v)))
    }

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
        check_radiance(DVec3::splat(self.max_radiance()))
    }
}
