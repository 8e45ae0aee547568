//! Whole networks on the device, as the tests run them.
#![allow(dead_code)]

use super::goldens;
use limpid::gpu::{Gpu, hazard};
use limpid::net::architecture::{Architecture, Op, Row};
use limpid::net::base::Widths;
use limpid::net::kernel::Family;
use limpid::net::parameters::Parameters;
use limpid::net::plan::{Fusion, Memory, Plan};
use limpid::net::tensor::Tensor;
use limpid::net::weights::Weights;

/// A convolution with the activation that all but last layers have.
pub const fn conv(cin: usize, cout: usize) -> Op {
    Op::Conv { cin, cout, slope: Some(0.1) }
}

/// A last layer.
pub const fn linear(cin: usize, cout: usize) -> Op {
    Op::Conv { cin, cout, slope: None }
}

/// One pooling, one skip, channel counts that are no multiple of 4, a concatenation of unequal parts, a layer of equal
/// widths: 4 channels in, 3 out.
pub fn tiny() -> Architecture {
    let rows: &[Row] = &[
        ("input", Op::Input { channels: 4 }, &[]),
        ("enc", conv(4, 6), &["input"]),
        ("pool", Op::MaxPool, &["enc"]),
        ("middle", conv(6, 9), &["pool"]),
        ("second", conv(9, 9), &["middle"]),
        ("upsample", Op::Upsample, &["second"]),
        ("concat", Op::Concat, &["upsample", "enc"]),
        ("out", linear(15, 3), &["concat"]),
    ];
    Architecture::from_rows("tiny", rows).expect("the rows fit")
}

const SMALL: Widths = Widths::from_array([16, 32, 16, 32, 48, 48, 32, 16, 48, 48, 16]);

/// `kpn` of the widths of [`small_base`].
pub fn small_kpn() -> Architecture {
    Architecture::kpn(&SMALL).expect("the widths are right")
}

/// `base` of widths that are small, mostly differ, and at some layers suffice for the kernels of wide ones: after an upsampled
/// value joined to a pooled one (dec_conv4a) and to the network's input (dec_conv1a).
pub fn small_base() -> Architecture {
    Architecture::base(&SMALL).expect("the widths are right")
}

/// 60 channels at full size, joined to 120, then `tail`: at large sizes its tensors exceed a storage binding.
fn joined(name: &str, tail: &[Row]) -> Architecture {
    let head: &[Row] = &[
        ("input", Op::Input { channels: 3 }, &[]),
        ("enc", conv(3, 60), &["input"]),
        ("pool", Op::MaxPool, &["enc"]),
        ("upsample", Op::Upsample, &["pool"]),
        ("concat", Op::Concat, &["upsample", "enc"]),
    ];
    Architecture::from_rows(name, &[head, tail].concat()).expect("the rows fit")
}

/// The join and a last layer.
pub fn wide() -> Architecture {
    joined("wide", &[("out", linear(120, 3), &["concat"])])
}

/// The join, and a layer of 120 channels in and 60 out before the last one, for the kernels of wide layers.
pub fn deep() -> Architecture {
    joined("deep", &[("middle", conv(120, 60), &["concat"]), ("out", linear(60, 3), &["middle"])])
}

/// The goldens' weights of an architecture.
pub fn weights(architecture: &Architecture) -> Weights {
    Weights {
        architecture: architecture.clone(),
        parameters: goldens::parameters(architecture),
        metadata: Default::default(),
    }
}

/// A network's output (N, Cout, H, W), computed on the device from values that were all NaN before; the recorded plan is
/// checked for races.
pub fn forward(
    gpu: &Gpu,
    weights: &Weights,
    family: Family,
    (memory, fusion): (Memory, Fusion),
    input: &Tensor<f32>,
) -> Tensor<f32> {
    let [n, _, h, w] = input.shape;
    let size = (n as u32, h as u32, w as u32);
    let plan = Plan::new(gpu, &weights.architecture, family, size, memory, fusion).unwrap();
    let parameters = Parameters::new(gpu, family, weights, false).unwrap();
    let mut rec = gpu.recorder();
    plan.record(&mut rec, &parameters).unwrap();
    let mut commands = rec.finish().unwrap();
    hazard::check(commands.events()).unwrap();
    for value in &plan.values {
        gpu.upload(&value.slice, &vec![f32::NAN; value.slice.bytes() as usize / 4]).unwrap();
    }
    plan.input().upload(gpu, &input.data).unwrap();
    commands.run().unwrap();
    Tensor::new([n, weights.architecture.output_channels(), h, w], plan.output().download(gpu).unwrap())
}

/// Rows `y..y + height` and columns `x..x + width` of every plane.
pub fn cut<T: Copy + Default>(image: &Tensor<T>, [y, x, height, width]: [usize; 4]) -> Tensor<T> {
    let [batch, channels, ..] = image.shape;
    let mut part = Tensor::zeros([batch, channels, height, width]);
    for n in 0..batch {
        for c in 0..channels {
            for row in 0..height {
                let (from, to) = (image.index(n, c, y + row, x), part.index(n, c, row, 0));
                part.data[to..to + width].copy_from_slice(&image.data[from..from + width]);
            }
        }
    }
    part
}
