//! Which device a command runs on.

use limpid::gpu::{DeviceOptions, Gpu};
use limpid::{Error, Result};

/// The flags of every command that computes.
#[derive(Clone, Debug, clap::Args)]
pub struct DeviceArgs {
    /// Vulkan device: its number in `limpid devices` or a part of its name [default: the most capable one]
    #[arg(long, value_name = "NAME|N")]
    pub device: Option<String>,
    /// Run under the Khronos validation layer; any message from it fails the command
    #[arg(long)]
    pub validation: bool,
}

impl DeviceArgs {
    /// Opens the device.
    pub fn open(&self) -> Result<Gpu> {
        Gpu::new(&DeviceOptions { select: self.device.clone(), validation: self.validation })
    }

    /// Fails where the validation layer had something to say.
    pub fn check(&self, gpu: &Gpu) -> Result<()> {
        let messages = gpu.drain_validation();
        match messages.first() {
            None => Ok(()),
            Some(first) => Err(Error::Gpu(format!("{} validation messages, the first: {first}", messages.len()))),
        }
    }
}
