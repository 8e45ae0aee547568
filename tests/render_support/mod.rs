//! What the render tests share: the device, scenes, means with their standard errors.
#![allow(dead_code)]

use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use glam::{DMat4, DVec3};
use limpid::gpu::{DeviceOptions, Gpu};
use limpid::image::Image;
use limpid::render::{Renderer, Settings};
use limpid::scene::{Camera, Geometry, Scene, Shape};

/// The device, one test at a time; a validation message fails the test that caused it.
pub struct Device {
    gpu: Gpu,
    _turn: MutexGuard<'static, ()>,
}

impl std::ops::Deref for Device {
    type Target = Gpu;
    fn deref(&self) -> &Gpu {
        &self.gpu
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        let messages = self.gpu.drain_validation();
        if !std::thread::panicking() {
            assert!(messages.is_empty(), "validation: {messages:?}");
        }
    }
}

pub fn device() -> Device {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    static TURN: Mutex<()> = Mutex::new(());
    let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let gpu = GPU.get_or_init(|| {
        Gpu::new(&DeviceOptions { validation: true, ..DeviceOptions::default() }).expect("a Vulkan device")
    });
    Device { gpu: gpu.clone(), _turn: turn }
}

pub fn render(gpu: &Gpu, scene: &Scene, settings: &Settings) -> Image {
    let mut renderer = Renderer::new(gpu, scene, settings).expect("renderer");
    renderer.finish().expect("render");
    let image = renderer.image().expect("image");
    assert_eq!(renderer.stats().expect("stats").invalid, 0);
    for (name, plane) in &image.channels {
        assert!(plane.iter().all(|x| x.is_finite()), "{name} is not finite");
    }
    image
}

pub fn sphere(center: [f64; 3], radius: f64, albedo: f64, radiance: f64) -> Shape {
    Shape {
        name: "sphere".into(),
        geometry: Geometry::Sphere { center: center.into(), radius, inward: false },
        albedo: DVec3::splat(albedo),
        checker: None,
        radiance: DVec3::splat(radiance),
    }
}

pub fn cavity(radius: f64, albedo: f64, radiance: f64) -> Shape {
    let geometry = Geometry::Sphere { center: DVec3::ZERO, radius, inward: true };
    Shape { geometry, ..sphere([0.0; 3], radius, albedo, radiance) }
}

pub fn rectangle(center: DVec3, half_u: DVec3, half_v: DVec3, albedo: f64, radiance: f64) -> Shape {
    Shape { geometry: Geometry::Rectangle { center, half_u, half_v }, ..sphere([0.0; 3], 1.0, albedo, radiance) }
}

pub fn disk(center: DVec3, half_u: DVec3, half_v: DVec3, albedo: f64, radiance: f64) -> Shape {
    Shape { geometry: Geometry::Disk { center, half_u, half_v }, ..sphere([0.0; 3], 1.0, albedo, radiance) }
}

/// The six inner faces of the box [-1,1]^3.
pub fn closed_box(albedo: f64, radiance: f64) -> Vec<Shape> {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    // (outward, u, v) with u x v = -outward
    [(x, z, y), (-x, y, z), (y, x, z), (-y, z, x), (z, y, x), (-z, x, y)]
        .map(|(out, u, v)| rectangle(out, u, v, albedo, radiance))
        .to_vec()
}

pub fn look(from: DVec3, to: DVec3, fov: f64, width: u32, height: u32) -> Camera {
    let back = (from - to).normalize();
    let up = if back.y.abs() > 0.9 { DVec3::X } else { DVec3::Y };
    let right = up.cross(back).normalize();
    let to_world =
        DMat4::from_cols(right.extend(0.0), back.cross(right).extend(0.0), back.extend(0.0), from.extend(1.0));
    Camera { to_world, fov_x_degrees: fov, width, height }
}

/// The canonical frame at another size.
pub fn cornell(size: u32) -> Scene {
    let mut scene = limpid::scene::family::canonical();
    scene.camera.width = size;
    scene.camera.height = size;
    scene
}

/// Mean and standard error of independent values.
pub fn mean_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// Values of a channel where the first hit reflects.
pub fn surface(image: &Image, channel: &str) -> Vec<f64> {
    let albedo = |i: usize| ["albedo.R", "albedo.G", "albedo.B"].iter().any(|c| image.channels[*c][i] > 0.0);
    image.channels[channel].iter().enumerate().filter(|(i, _)| albedo(*i)).map(|(_, &v)| f64::from(v)).collect()
}

pub fn assert_same_bits(a: &Image, b: &Image, what: &str) {
    assert_eq!((a.width, a.height), (b.width, b.height), "{what}: sizes");
    assert_eq!(a.channels.keys().collect::<Vec<_>>(), b.channels.keys().collect::<Vec<_>>(), "{what}: channels");
    for (name, plane) in &a.channels {
        let different = plane.iter().zip(&b.channels[name]).filter(|(x, y)| x.to_bits() != y.to_bits()).count();
        assert_eq!(different, 0, "{what}: {different} of {} values of {name} differ", plane.len());
    }
}
