//! The network's layers on the device: one file a layer, each records its dispatches.

pub mod concat;
pub mod conv2d;
pub mod coop;
pub mod demodulate;
pub mod kernel_filter;
pub mod leaky_relu;
pub mod max_pool2d;
pub mod upsample2d;
pub mod winograd;

use super::tensor::Tensor;
use crate::gpu::DeviceInfo;
use half::f16;

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
const FAMILIES: [(&str, Fit); 3] =
    [("cpu", Family::cpu), ("coop", Family::coop), ("portable", |_| Ok(Family::Portable))];

impl Family {
    /// The names of all families, the fastest first.
    pub const NAMES: [&str; 3] = [FAMILIES[0].0, FAMILIES[1].0, FAMILIES[2].0];

    fn cpu(info: &DeviceInfo) -> Result<Self, String> {
        match info.subgroup_size {
            _ if !info.is_cpu => Err("it is for drivers that run on the CPU".to_owned()),
            _ if !info.subgroup_shuffle => Err("the device has no subgroup shuffle".to_owned()),
            lanes @ (8 | 16) => Ok(Self::Cpu { lanes }),
            lanes => Err(format!("it needs subgroups of 8 or 16 invocations, the device's have {lanes}")),
        }
    }

    fn coop(info: &DeviceInfo) -> Result<Self, String> {
        let none =
            || "the device has no cooperative matrices of f16 with sums in f32 that the kernels can use".to_owned();
        coop::Matrices::of(info).map(Self::Coop).ok_or_else(none)
    }

    /// Whether a device that runs the family gains by it: not where cooperative matrices are emulated.
    fn by_default(self, info: &DeviceInfo) -> bool {
        !matches!(self, Self::Coop(_)) || (!info.is_cpu && !info.emulates_matrices)
    }

    /// Every family, the fastest first, as a device runs it or not.
    #[must_use]
    pub fn offers(info: &DeviceInfo) -> Vec<Offer> {
        FAMILIES.iter().map(|(name, fit)| Offer { name, family: fit(info) }).collect()
    }

    /// The fastest family that a device's facts allow; [`crate::kernels::choose`] also checks that it computes right.
    #[must_use]
    pub fn choose(info: &DeviceInfo) -> Self {
        Self::candidates(info).into_iter().next().unwrap_or(Self::Portable)
    }

    /// The families to choose from where none is asked for, the fastest first.
    #[must_use]
    pub fn candidates(info: &DeviceInfo) -> Vec<Self> {
        let families = Self::offers(info).into_iter().filter_map(|offer| offer.family.ok());
        families.filter(|family| family.by_default(info)).collect()
    }

    /// The families that a device can run, `portable` first.
    #[must_use]
    pub fn all(info: &DeviceInfo) -> Vec<Self> {
        Self::offers(info).into_iter().rev().filter_map(|offer| offer.family.ok()).collect()
    }

    /// A convolution's operand as the kernels multiply it: the nearest f16 within its range for cooperative matrices.
    #[must_use]
    pub fn operand(self, values: &Tensor) -> Tensor {
        let nearest = |v: f32| f16::from_f32(v.clamp(f16::MIN.to_f32(), f16::MAX.to_f32())).to_f32();
        match self {
            Self::Portable | Self::Cpu { .. } => values.clone(),
            Self::Coop(_) => Tensor::new(values.shape, values.data.iter().copied().map(nearest).collect()),
        }
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
