//! What the tests share.
#![allow(dead_code)]

pub mod compare;
pub mod goldens;
pub mod networks;

use limpid::gpu::{DeviceOptions, Gpu};
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
