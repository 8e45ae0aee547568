//! Which device a command runs on.

use super::progress::line;
use limpid::gpu::{DeviceOptions, Gpu};
use limpid::kernels::check::Purpose;
use limpid::kernels::{Choice, choose};
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
        let (select, validation) = (self.device.clone(), self.validation);
        Gpu::new(&DeviceOptions { select, validation, ..DeviceOptions::default() })
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

/// The flag of every command that runs the network.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct KernelArgs {
    /// The network's kernels: a name that `limpid devices` shows for the device [default: the fastest that pass their
    /// self-check]
    #[arg(long, value_name = "NAME")]
    pub kernels: Option<String>,
}

impl KernelArgs {
    /// Chooses, and says where faster kernels fail.
    pub fn choose(&self, gpu: &Gpu, purpose: Purpose) -> Result<Choice> {
        let choice = choose(gpu, self.kernels.as_deref(), purpose)?;
        choice.warnings().iter().for_each(|warning| line(&format!("warning: {warning}")));
        Ok(choice)
    }
}
