//! What a scene must fulfil before anything is rendered.

use super::{Camera, Environment, Geometry, Lens, Scene, Shape, Texture};
pub use crate::image::{MAX_PIXELS, MAX_SIDE, check_size};
use crate::{Error, Result};
use glam::{DMat3, DVec3};

/// The largest coordinate or length, scene units: its square stays finite in f32.
pub const MAX_LENGTH: f64 = 1e15;
/// The smallest radius or half edge, scene units: its square stays a normal number in f32.
pub const MIN_LENGTH: f64 = 1e-15;
/// The largest radiance: sums over millions of samples stay finite in f32.
pub const MAX_RADIANCE: f64 = 1e30;
/// The most repeats of a checkerboard: its cells stay wider than the roundings of u and v in f32.
pub const MAX_REPEATS: f64 = 1e4;
/// How far a rectangle's corner may be from 90 degrees (cosine), and a camera's axes from orthonormal.
pub const SHEAR_TOLERANCE: f64 = 1e-6;

impl Scene {
    /// Refuses what cannot be rendered: sizes out of range, non-finite or huge numbers, a camera that is not rigid,
    /// spheres without a radius, degenerate or sheared rectangles, albedo outside [0, 1], negative radiance. A scene
    /// without shapes is fine (and black).
    pub fn validate(&self) -> Result<()> {
        self.camera.validate()?;
        self.shapes.iter().enumerate().try_for_each(|(i, shape)| {
            shape.validate().map_err(|error| Error::input(format!("shape {} '{}': {error}", i + 1, shape.name)))
        })?;
        self.delta_lights.iter().try_for_each(|light| {
            light.validate().map_err(|error| Error::input(format!("light '{}': {error}", light.name)))
        })?;
        self.environment.as_ref().map_or(Ok(()), Environment::validate)
    }
}

impl Camera {
    /// Refuses a camera that cannot make an image; see [`Scene::validate`].
    pub fn validate(&self) -> Result<()> {
        check_size(self.width, self.height)?;
        if !(self.fov_x_degrees > 0.0 && self.fov_x_degrees < 180.0) {
            return Err(Error::input(format!(
                "camera: field of view {} degrees; it must lie between 0 and 180, both excluded",
                self.fov_x_degrees
            )));
        }
        if let Some(Lens { aperture_radius, focus_distance }) = self.lens {
            for (what, length) in [("aperture radius", aperture_radius), ("focus distance", focus_distance)] {
                if !(MIN_LENGTH..=MAX_LENGTH).contains(&length) {
                    return Err(Error::input(format!(
                        "camera: {what} {length}; it must be positive, {MIN_LENGTH:e} to {MAX_LENGTH:e}"
                    )));
                }
            }
        }
        let m = &self.to_world;
        check_point("camera: position", m.w_axis.truncate())?;
        let axes = DMat3::from_mat4(*m);
        let gram = axes.transpose() * axes;
        let rigid = gram.abs_diff_eq(DMat3::IDENTITY, SHEAR_TOLERANCE) && axes.determinant() > 0.0;
        if !rigid || m.row(3).to_array() != [0.0, 0.0, 0.0, 1.0] {
            return Err(Error::input(
                "camera: to_world must be rotation and translation only (no scale, shear or mirror)",
            ));
        }
        Ok(())
    }
}

impl Shape {
    /// Refuses a shape that cannot be rendered; see [`Scene::validate`].
    pub fn validate(&self) -> Result<()> {
        match self.geometry {
            Geometry::Mesh(ref mesh) => {
                mesh.validate()?;
                if self.texture.is_some() && mesh.uvs.is_empty() {
                    return Err(Error::input("a texture on a mesh without texture coordinates"));
                }
                if self.radiance != DVec3::ZERO && !mesh.normals.is_empty() {
                    return Err(Error::input("a mesh that emits must be flat, without vertex normals"));
                }
            }
            Geometry::Sphere { center, radius, .. } => {
                check_point("center", center)?;
                if !(MIN_LENGTH..=MAX_LENGTH).contains(&radius) {
                    return Err(Error::input(format!(
                        "radius {radius}; it must be positive, {MIN_LENGTH:e} to {MAX_LENGTH:e}"
                    )));
                }
            }
            Geometry::Rectangle { center, half_u, half_v } => check_plane("rectangle", center, [half_u, half_v])?,
            Geometry::Disk { center, half_u, half_v } => check_plane("disk", center, [half_u, half_v])?,
        }
        check_albedo(self.albedo)?;
        self.texture.as_ref().map_or(Ok(()), Texture::validate)?;
        self.bsdf.validate()?;
        check_radiance(self.radiance)
    }
}

fn check_plane(what: &str, center: DVec3, edges: [DVec3; 2]) -> Result<()> {
    check_point("center", center)?;
    for edge in edges {
        check_point("edge", edge)?;
        if edge.length() < MIN_LENGTH {
            return Err(Error::input(format!("degenerate {what}: an edge is {edge}; it must be longer than 0")));
        }
    }
    let cosine = edges[0].normalize().dot(edges[1].normalize());
    if cosine.abs() > SHEAR_TOLERANCE {
        return Err(Error::input(format!(
            "sheared {what}: the cosine between its edges is {cosine:e}; they must be perpendicular"
        )));
    }
    Ok(())
}

/// Refuses reflectance outside [0, 1]: more would make energy.
pub(super) fn check_albedo(albedo: DVec3) -> Result<()> {
    let albedo = albedo.to_array();
    if albedo.iter().all(|a| (0.0..=1.0).contains(a)) {
        return Ok(());
    }
    Err(Error::input(format!("reflectance {albedo:?}; each part must lie in [0, 1]")))
}

/// Refuses negative, non-finite or absurd radiance.
pub(super) fn check_radiance(radiance: DVec3) -> Result<()> {
    let radiance = radiance.to_array();
    if radiance.iter().all(|r| (0.0..=MAX_RADIANCE).contains(r)) {
        return Ok(());
    }
    Err(Error::input(format!("radiance {radiance:?}; each part must lie in [0, {MAX_RADIANCE:e}]")))
}

pub(super) fn check_point(what: &str, p: DVec3) -> Result<()> {
    if p.to_array().iter().all(|c| c.abs() <= MAX_LENGTH) {
        return Ok(());
    }
    Err(Error::input(format!("{what} {:?}; each part must be finite and at most {MAX_LENGTH:e}", p.to_array())))
}
