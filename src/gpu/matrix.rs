//! Cooperative matrices: what a device offers of `VK_KHR_cooperative_matrix`.

use super::instance::Instance;
use ash::{khr, vk};

/// The size of a matrix product that a subgroup makes together, (M, K) by (K, N).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
pub struct MatrixShape {
    /// Rows of the result.
    pub m: u32,
    /// Columns of the result.
    pub n: u32,
    /// Columns of the first and rows of the second operand.
    pub k: u32,
}

impl std::fmt::Display for MatrixShape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}x{}", self.m, self.n, self.k)
    }
}

/// What the matrices of f16 with sums in f32 need besides the extension: its feature, arithmetic in f16, Vulkan's memory model.
fn features(instance: &ash::Instance, device: vk::PhysicalDevice) -> bool {
    let mut v12 = vk::PhysicalDeviceVulkan12Features::default();
    let mut matrix = vk::PhysicalDeviceCooperativeMatrixFeaturesKHR::default();
    let mut all = vk::PhysicalDeviceFeatures2::default().push_next(&mut v12).push_next(&mut matrix);
    // SAFETY: `device` came from this instance and has the extension; the chain lives until the call returns.
    unsafe { instance.get_physical_device_features2(device, &mut all) };
    [matrix.cooperative_matrix, v12.shader_float16, v12.vulkan_memory_model].iter().all(|f| *f == vk::TRUE)
}

/// The shapes of f16 matrices with sums in f32, scope of a subgroup, without saturation; none where the device lacks anything
/// that they need.
pub(super) fn shapes(instance: &Instance, device: vk::PhysicalDevice) -> Vec<MatrixShape> {
    // SAFETY: `device` came from this instance.
    let extensions = unsafe { instance.raw.enumerate_device_extension_properties(device) }.unwrap_or_default();
    let name = khr::cooperative_matrix::NAME;
    if !extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(name)) || !features(&instance.raw, device) {
        return Vec::new();
    }
    let loader = khr::cooperative_matrix::Instance::new(&instance.entry, &instance.raw);
    // SAFETY: `device` came from this instance and has the extension.
    let rows = unsafe { loader.get_physical_device_cooperative_matrix_properties(device) }.unwrap_or_default();
    let (half, single) = (vk::ComponentTypeKHR::FLOAT16, vk::ComponentTypeKHR::FLOAT32);
    let fits = |r: &&vk::CooperativeMatrixPropertiesKHR<'_>| {
        [r.a_type, r.b_type] == [half; 2]
            && [r.c_type, r.result_type] == [single; 2]
            && r.scope == vk::ScopeKHR::SUBGROUP
            && r.saturating_accumulation == vk::FALSE
    };
    rows.iter().filter(fits).map(|r| MatrixShape { m: r.m_size, n: r.n_size, k: r.k_size }).collect()
}

/// Whether a GPU's driver computes the matrices without units for them, slower than plain arithmetic: AMD's own driver before
/// RDNA 3, which brought both the units and the mixed-sign dot product, and Intel before Xe2, whose matrices have 16 columns.
pub(super) fn emulated(
    shapes: &[MatrixShape],
    driver: vk::DriverId,
    v13: &vk::PhysicalDeviceVulkan13Properties<'_>,
) -> bool {
    match driver {
        vk::DriverId::AMD_PROPRIETARY | vk::DriverId::AMD_OPEN_SOURCE => {
            v13.integer_dot_product4x8_bit_packed_mixed_signedness_accelerated == vk::FALSE
        }
        vk::DriverId::INTEL_PROPRIETARY_WINDOWS | vk::DriverId::INTEL_OPEN_SOURCE_MESA => {
            !shapes.is_empty() && shapes.iter().all(|shape| shape.n < 16)
        }
        _ => false,
    }
}
