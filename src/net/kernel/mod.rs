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

/// A family by its name: as a device runs it, or why the device does not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Offer {
    /// [`Family::name`].
    pub name: &'static str,
    /// The family, or the reason.
    pub family: Result<Family, String>,
}

type Fit = fn(&DeviceInfo) -> Result<Family, String>;

/// All families, the fastest first; the last runs everywhere.
const FAMILIES: [(&str, Fit); 2] = [("cpu", Family::cpu), ("portable", |_| Ok(Family::Portable))];

impl Family {
    fn cpu(info: &DeviceInfo) -> Result<Self, String> {
        match info.subgroup_size {
            _ if !info.is_cpu => Err("it is for drivers that run on the CPU".to_owned()),
            _ if !info.subgroup_shuffle => Err("the device has no subgroup shuffle".to_owned()),
            lanes @ (8 | 16) => Ok(Self::Cpu { lanes }),
            lanes => Err(format!("it needs subgroups of 8 or 16 invocations, the device's have {lanes}")),
        }
    }

    /// Every family, the fastest first, as a device runs it or not.
    #[must_use]
    pub fn offers(info: &DeviceInfo) -> Vec<Offer> {
        FAMILIES.iter().map(|(name, fit)| Offer { name, family: fit(info) }).collect()
    }

    /// The fastest family that a device's facts allow; [`crate::kernels::choose`] also checks that it computes right.
    #[must_use]
    pub fn choose(info: &DeviceInfo) -> Self {
        Self::offers(info).into_iter().find_map(|offer| offer.family.ok()).unwrap_or(Self::Portable)
    }

    /// The families that a device can run, `portable` first.
    #[must_use]
    pub fn all(info: &DeviceInfo) -> Vec<Self> {
        Self::offers(info).into_iter().rev().filter_map(|offer| offer.family.ok()).collect()
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
