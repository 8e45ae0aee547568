//! The network's layers on the device: one file a layer, each records its dispatches.

pub mod concat;
pub mod conv2d;
pub mod coop;
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
    /// Cooperative matrices: operands of convolutions in f16, sums in f32.
    Coop(coop::Matrices),
}

impl Family {
    /// The names of all families.
    pub const NAMES: [&str; 3] = ["portable", "cpu", "coop"];

    /// The family for a device.
    #[must_use]
    pub fn choose(info: &DeviceInfo) -> Self {
        let lanes = info.subgroup_size;
        if info.is_cpu && info.subgroup_shuffle && (lanes == 8 || lanes == 16) {
            return Self::Cpu { lanes };
        }
        match coop::Matrices::of(info) {
            Some(matrices) if !info.is_cpu && !info.emulates_matrices => Self::Coop(matrices),
            _ => Self::Portable,
        }
    }

    /// The families that a device can run.
    #[must_use]
    pub fn all(info: &DeviceInfo) -> Vec<Self> {
        let mut all = vec![Self::Portable];
        all.extend(Some(Self::choose(info)).filter(|family| matches!(family, Self::Cpu { .. })));
        all.extend(coop::Matrices::of(info).map(Self::Coop));
        all
    }

    /// Output channels that lie side by side in packed weights and in partial sums of their gradients.
    #[must_use]
    pub const fn lanes(self) -> u32 {
        match self {
            Self::Portable | Self::Coop(_) => 4,
            Self::Cpu { lanes } => lanes,
        }
    }

    /// Name, as in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Cpu { .. } => "cpu",
            Self::Coop(_) => "coop",
        }
    }
}
