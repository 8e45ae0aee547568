//! What a kernel family's convolutions make of their operands, and how near to f64 that leaves a whole network.
#![allow(dead_code)]

use half::f16;
use limpid::gpu::DeviceInfo;
use limpid::net::architecture::Architecture;
use limpid::net::kernel::Family;
use limpid::net::layer::Data;
use limpid::net::tensor::Tensor;

/// The operand that a convolution multiplies: the nearest f16 within its range for cooperative matrices, whose products are
/// then exact in f32 and whose sums are held to the bounds of f32.
pub fn operand(family: Family, tensor: &Tensor<f32>) -> Tensor<f32> {
    let nearest = |v: f32| f16::from_f32(v.clamp(f16::MIN.to_f32(), f16::MAX.to_f32())).to_f32();
    match family {
        Family::Portable | Family::Cpu { .. } => tensor.clone(),
        Family::Coop(_) => Tensor::new(tensor.shape, tensor.data.iter().copied().map(nearest).collect()),
    }
}

/// The operands of a case's convolutions, forward and backward; the bias is none.
pub fn operands(family: Family, data: &Data) -> Data {
    Data {
        inputs: data.inputs.iter().map(|t| operand(family, t)).collect(),
        weight: operand(family, &data.weight),
        bias: data.bias.clone(),
        output_gradient: operand(family, &data.output_gradient),
    }
}

/// Relative L2 error that a whole network's output may have: what is asked of f32 and of f16 operands.
pub fn network_limit(family: Family) -> f64 {
    match family {
        Family::Portable | Family::Cpu { .. } => 1e-5,
        Family::Coop(_) => 2e-3,
    }
}

/// The same in f64.
pub fn operand_f64(family: Family, tensor: &Tensor<f64>) -> Tensor<f64> {
    match family {
        Family::Portable | Family::Cpu { .. } => tensor.clone(),
        Family::Coop(_) => tensor.map(|v| f16::from_f64(v).to_f64()),
    }
}

/// Relative L2 error of the gradient of any of a network's tensors, against a reference that rounds values and weights as the
/// kernels do.
///
/// f32: 1e-5. With f16 operands each convolution on the way rounds the gradient, by 2^-10 / sqrt(12) of its size at most in
/// the root mean square, and the roundings of different layers are independent.
pub fn gradient_limit(family: Family, architecture: &Architecture) -> f64 {
    let convolutions = architecture.nodes().iter().filter(|n| n.parameters.is_some()).count();
    match family {
        Family::Portable | Family::Cpu { .. } => 1e-5,
        Family::Coop(_) => (convolutions as f64 / 12.0).sqrt() / 1024.0,
    }
}

/// The families of `families` that compute in f32 throughout.
pub fn f32_families(info: &DeviceInfo) -> Vec<Family> {
    families(info).into_iter().filter(|f| !matches!(f, Family::Coop(_))).collect()
}

/// The device's families; says which of the others no test runs.
pub fn families(info: &DeviceInfo) -> Vec<Family> {
    let all = Family::all(info);
    for name in Family::NAMES {
        if !all.iter().any(|f| f.name() == name) {
            println!("NOT RUN: {} has no kernels `{name}`", info.name);
        }
    }
    all
}
