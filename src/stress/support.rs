//! Scenes, renders and statistics that the cases share.

use super::Checks;
use crate::bench::error::Technique;
use crate::gpu::Gpu;
use crate::image::Image;
use crate::metrics::different_values;
use crate::render::{Estimator, Renderer, Sampler, Settings};
use crate::scene::{Camera, DeltaKind, Geometry, Material, Mesh, Scene, Shape, family};
use crate::{Error, Result};
use glam::{DMat4, DQuat, DVec3};
use std::sync::Arc;

/// Every way to render.
pub fn techniques() -> impl Iterator<Item = (Estimator, Sampler)> {
    Technique::all().map(|technique| (technique.estimator, technique.sampler))
}

/// How far a mean may be from what is expected, in standard errors: a false alarm once in 150,000 for a normal variable.
pub const SIGMAS: f64 = 4.5;

/// Settings with these values and the others at their defaults.
#[must_use]
pub fn settings(spp: u32, bounces: u32, (estimator, sampler): (Estimator, Sampler)) -> Settings {
    Settings { spp, bounces, estimator, sampler, ..Settings::default() }
}

/// Renders all samples. An error where a sample was dropped or a channel is not finite.
pub fn render(gpu: &Gpu, scene: &Scene, settings: &Settings) -> Result<Image> {
    let mut renderer = Renderer::new(gpu, scene, settings)?;
    renderer.finish()?;
    let image = renderer.image()?;
    let invalid = renderer.stats()?.invalid;
    if invalid > 0 {
        return Err(Error::Gpu(format!("{invalid} samples were not finite or negative")));
    }
    match image.channels.iter().find(|(_, plane)| plane.iter().any(|v| !v.is_finite())) {
        Some((name, _)) => Err(Error::Gpu(format!("channel {name} is not finite"))),
        None => Ok(image),
    }
}

/// A sphere seen from outside, grey.
#[must_use]
pub fn sphere(center: [f64; 3], radius: f64, albedo: f64, radiance: f64) -> Shape {
    let geometry = Geometry::Sphere { center: center.into(), radius, inward: false };
    Material::diffuse(DVec3::splat(albedo)).shape("sphere".into(), geometry, DVec3::splat(radiance))
}

/// A sphere about the origin seen from inside.
#[must_use]
pub fn cavity(radius: f64, albedo: f64, radiance: f64) -> Shape {
    let geometry = Geometry::Sphere { center: DVec3::ZERO, radius, inward: true };
    Shape { geometry, ..sphere([0.0; 3], radius, albedo, radiance) }
}

/// A rectangle, grey; its front is on the side of `half_u` x `half_v`.
#[must_use]
pub fn rectangle(center: DVec3, half_u: DVec3, half_v: DVec3, albedo: f64, radiance: f64) -> Shape {
    Shape { geometry: Geometry::Rectangle { center, half_u, half_v }, ..sphere([0.0; 3], 1.0, albedo, radiance) }
}

/// A mesh of one grey.
#[must_use]
pub fn mesh_of(mesh: Mesh, albedo: f64, radiance: f64) -> Shape {
    Shape { geometry: Geometry::Mesh(Arc::new(mesh)), ..sphere([0.0; 3], 1.0, albedo, radiance) }
}

/// The six inner faces of the box [-1,1]^3.
#[must_use]
pub fn closed_box(albedo: f64, radiance: f64) -> Vec<Shape> {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    // (outward, u, v) with u x v = -outward
    [(x, z, y), (-x, y, z), (y, x, z), (-y, z, x), (z, y, x), (-z, x, y)]
        .map(|(out, u, v)| rectangle(out, u, v, albedo, radiance))
        .to_vec()
}

/// A camera at `from` that looks at `to`.
#[must_use]
pub fn look(from: DVec3, to: DVec3, fov: f64, width: u32, height: u32) -> Camera {
    let back = (from - to).normalize();
    let up = if back.y.abs() > 0.9 { DVec3::X } else { DVec3::Y };
    let right = up.cross(back).normalize();
    let to_world =
        DMat4::from_cols(right.extend(0.0), back.cross(right).extend(0.0), back.extend(0.0), from.extend(1.0));
    Camera { to_world, fov_x_degrees: fov, width, height, lens: None }
}

/// The canonical frame at another size.
#[must_use]
pub fn cornell(size: u32) -> Scene {
    let mut scene = family::canonical();
    (scene.camera.width, scene.camera.height) = (size, size);
    scene
}

/// The scene with every length times `scale`, then moved by `shift`; lights without a surface keep the light that they throw on it.
#[must_use]
pub fn placed(mut scene: Scene, scale: f64, shift: DVec3) -> Scene {
    let m = &mut scene.camera.to_world;
    *m = DMat4::from_cols(m.x_axis, m.y_axis, m.z_axis, (m.w_axis.truncate() * scale + shift).extend(1.0));
    for light in &mut scene.delta_lights {
        if let DeltaKind::Point { position } | DeltaKind::Spot { position, .. } = &mut light.kind {
            *position = *position * scale + shift;
            light.intensity *= scale * scale;
        }
    }
    for shape in &mut scene.shapes {
        match &mut shape.geometry {
            Geometry::Sphere { center, radius, .. } => {
                *center = *center * scale + shift;
                *radius *= scale;
            }
            Geometry::Rectangle { center, half_u, half_v } | Geometry::Disk { center, half_u, half_v } => {
                *center = *center * scale + shift;
                *half_u *= scale;
                *half_v *= scale;
            }
            Geometry::Mesh(mesh) => Arc::make_mut(mesh).transform(DMat4::from_scale_rotation_translation(
                DVec3::splat(scale),
                DQuat::IDENTITY,
                shift,
            )),
        }
    }
    scene
}

/// A disk of one grey.
#[must_use]
pub fn disk(center: DVec3, half_u: DVec3, half_v: DVec3, albedo: f64, radiance: f64) -> Shape {
    Shape { geometry: Geometry::Disk { center, half_u, half_v }, ..sphere([0.0; 3], 1.0, albedo, radiance) }
}

/// Mean and standard error of independent values.
#[must_use]
pub fn mean_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// A channel in f64.
#[must_use]
pub fn channel(image: &Image, name: &str) -> Vec<f64> {
    image.channels[name].iter().map(|&v| f64::from(v)).collect()
}

/// Values of a channel where the first hit reflects.
#[must_use]
pub fn surface(image: &Image, channel: &str) -> Vec<f64> {
    let albedo = |i: usize| ["albedo.R", "albedo.G", "albedo.B"].iter().any(|c| image.channels[*c][i] > 0.0);
    image.channels[channel].iter().enumerate().filter(|(i, _)| albedo(*i)).map(|(_, &v)| f64::from(v)).collect()
}

/// Values whose bits differ, over all channels; all of them where sizes or channels differ.
#[must_use]
pub fn different_bits(a: &Image, b: &Image) -> usize {
    let names = |image: &Image| image.channels.keys().cloned().collect::<Vec<_>>();
    if (a.width, a.height) != (b.width, b.height) || names(a) != names(b) {
        return a.channels.len().max(1) * a.pixel_count().max(b.pixel_count());
    }
    a.channels.iter().map(|(name, plane)| different_values(plane, &b.channels[name])).sum()
}

/// The mean of `values` must be `expected` within [`SIGMAS`] standard errors and a relative `bias` that is known; an error of
/// over `precision` times what is expected would prove nothing.
pub fn check_mean(
    checks: &mut Checks,
    values: &[f64],
    expected: f64,
    (bias, precision): (f64, f64),
    at: &impl std::fmt::Display,
) {
    let (mean, error) = mean_error(values);
    checks.at_most("standard error over the expected mean", error / expected, precision, at);
    let allowed = SIGMAS * error + bias * expected;
    // 0 by 0 where every value is right and there is no noise.
    let off = if mean == expected { 0.0 } else { (mean - expected).abs() / allowed };
    checks.at_most(
        "difference of means over what noise and offsets allow",
        off,
        1.0,
        format_args!("{at}: {mean} +- {error}, expected {expected}"),
    );
}
