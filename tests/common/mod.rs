//! What the tests share.
#![allow(dead_code)]

pub mod compare;
pub mod goldens;
pub mod networks;
pub mod precision;

use limpid::gpu::{DeviceOptions, Gpu};
use limpid::net::device::DeviceTensor;
use std::sync::OnceLock;

/// The device of a test: opened once a process, under the validation layer. Dropping it fails the test where the test
/// caused a validation message.
pub struct TestGpu(Gpu);

/// The device of a test. No device is a failure, never a skip.
pub fn gpu() -> TestGpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    let open = || Gpu::new(&DeviceOptions { validation: true, ..DeviceOptions::default() });
    TestGpu(GPU.get_or_init(|| open().unwrap_or_else(|e| panic!("{e}"))).clone())
}

impl std::ops::Deref for TestGpu {
    type Target = Gpu;
    fn deref(&self) -> &Gpu {
        &self.0
    }
}

impl Drop for TestGpu {
    fn drop(&mut self) {
        let messages = self.0.drain_validation();
        assert!(messages.is_empty() || std::thread::panicking(), "validation: {messages:#?}");
    }
}

/// Places that only pad must be zero: the next layer reads them.
pub fn padding_is_zero(gpu: &Gpu, tensor: &DeviceTensor) -> Result<(), String> {
    let (c, width) = (tensor.shape.c, tensor.shape.w as usize);
    let used: Vec<u32> = (0..c.count()).map(|i| c.place(i)).collect();
    let floats: Vec<f32> = gpu.download(&tensor.slice).unwrap();
    let place = |i: usize| (i / 4 / width) as u32 % c.texels() * 4 + i as u32 % 4;
    let stray = (0..floats.len()).find(|i| floats[*i] != 0.0 && !used.contains(&place(*i)));
    stray.map_or(Ok(()), |i| Err(format!("padding channel {} holds {}", place(i), floats[i])))
}

/// Floats of `[row][planes][width]` texels as `[row][width][planes]`: pixel after pixel.
pub fn by_pixel(floats: &[f32], width: usize, planes: usize) -> Vec<f32> {
    let texel = |row: usize, x: usize, plane: usize| &floats[((row * planes + plane) * width + x) * 4..][..4];
    let rows = floats.len() / (width * planes * 4);
    (0..rows * width * planes)
        .flat_map(|i| texel(i / (width * planes), i / planes % width, i % planes))
        .copied()
        .collect()
}
