//! The network's layers on the device: one file a layer, each records its dispatches.

pub mod concat;
pub mod conv2d;
pub mod leaky_relu;
pub mod max_pool2d;
pub mod upsample2d;
pub mod winograd;

use crate::gpu::DeviceInfo;

/// A set of kernels for a kind of device. All pass the same tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Family {
    /// Core Vulkan 1.3 only.
    Portable,
    /// CPU drivers: texel loads and subgroup shuffles, lanes are output channels.
    Cpu {
        /// Subgroup size, 8 or 16.
        lanes: u32,
    },
}

impl Family {
    /// The family for a device.
    #[must_use]
    pub fn choose(info: &DeviceInfo) -> Self {
        let lanes = info.subgroup_size;
        if info.is_cpu && info.subgroup_shuffle && (lanes == 8 || lanes == 16) {
            Self::Cpu { lanes }
        } else {
            Self::Portable
        }
    }

    /// The families that a device can run.
    #[must_use]
    pub fn all(info: &DeviceInfo) -> Vec<Self> {
        match Self::choose(info) {
            Self::Portable => vec![Self::Portable],
            cpu @ Self::Cpu { .. } => vec![Self::Portable, cpu],
        }
    }

    /// Output channels that lie side by side in packed weights.
    #[must_use]
    pub const fn lanes(self) -> u32 {
        match self {
            Self::Portable => 4,
            Self::Cpu { lanes } => lanes,
        }
    }

    /// Name, as in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Cpu { .. } => "cpu",
        }
    }
}
