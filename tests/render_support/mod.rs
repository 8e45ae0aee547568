//! What the render tests share: the device, and the stress suite's scenes and statistics.
#![allow(dead_code, unused_imports)]

use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use limpid::gpu::{DeviceOptions, Gpu};
use limpid::image::Image;
use limpid::render::{Renderer, Settings};
use limpid::scene::Scene;
pub use limpid::stress::support::{
    SIGMAS, cavity, cornell, different_bits, disk, look, mean_error, rectangle, settings, sphere, surface, techniques,
};

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

/// Renders all samples; none may be dropped and every channel must be finite.
pub fn render(gpu: &Gpu, scene: &Scene, settings: &Settings) -> Image {
    limpid::stress::support::render(gpu, scene, settings).expect("render")
}

/// Mean of the surfaces' green over 16 seeds, and its standard error.
pub fn mean_of_seeds(gpu: &Gpu, scene: &Scene, settings: &Settings) -> (f64, f64) {
    let mut renderer = Renderer::new(gpu, scene, settings).expect("renderer");
    let mean = |seed| {
        renderer.set_seed(seed);
        renderer.finish().expect("render");
        mean_error(&surface(&renderer.image().expect("image"), "G")).0
    };
    mean_error(&(1..=16).map(mean).collect::<Vec<_>>())
}

pub fn assert_same_bits(a: &Image, b: &Image, what: &str) {
    assert_eq!((a.width, a.height), (b.width, b.height), "{what}: sizes");
    assert_eq!(a.channels.keys().collect::<Vec<_>>(), b.channels.keys().collect::<Vec<_>>(), "{what}: channels");
    assert_eq!(different_bits(a, b), 0, "{what}: values with other bits");
}
