//! The Winograd convolution against the convolution's reference, on the case table: operands whole, joined, with an upsampled
//! part, and the input gradient.

mod common;

use common::compare::tensors_within;
use common::{gpu, padding_is_zero};
use limpid::gpu::{Gpu, hazard};
use limpid::net::device::{Channels, DeviceTensor, Shape};
use limpid::net::kernel::winograd::{self, Pass};
use limpid::net::kernel::{Family, conv2d::Layer};
use limpid::net::layer::{Case, Kind, cases, concat, conv2d, upsample2d, winograd::bound};
use limpid::net::tensor::{Tensor, seed_of};

fn upload(gpu: &Gpu, tensor: &Tensor<f32>, channels: Channels) -> DeviceTensor {
    let [n, _, h, w] = tensor.shape.map(|v| v as u32);
    let device = DeviceTensor::new(gpu, "operand", Shape { n, h, w, c: channels }).unwrap();
    device.upload(gpu, &tensor.data).unwrap();
    device
}

/// What is convolved, and how it lies on the device.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Operand {
    /// One tensor.
    Whole,
    /// One tensor of two segments, as a concatenation leaves it.
    Joined,
    /// Half of the channels from a tensor of half the size, upsampled.
    Upsampled,
    /// The gradient of the output, with transposed weights: the input gradient, of two segments.
    Gradient,
}

const OPERANDS: [Operand; 4] = [Operand::Whole, Operand::Joined, Operand::Upsampled, Operand::Gradient];

/// OIHW weights of the convolution that is the input gradient: transposed, the taps turned.
fn transposed(weight: &Tensor<f64>) -> Tensor<f64> {
    let [cout, cin, ..] = weight.shape;
    let data = (0..cin * cout * 9).map(|i| weight.at(i / 9 % cout, i / 9 / cout, 2 - i / 3 % 3, 2 - i % 3)).collect();
    Tensor::new([cin, cout, 3, 3], data)
}

/// Convolves on the device and compares with the reference; none where the case has no such operand.
fn check(gpu: &Gpu, family: Family, case: &Case, operand: Operand) -> Option<Result<(), String>> {
    let data = case.data();
    let (whole, half) = (&data.inputs[0], case.cin / 2);
    let [n, _, h, w] = whole.shape;
    let even = h.is_multiple_of(2) && w.is_multiple_of(2);
    if (operand != Operand::Whole && half == 0) || (operand == Operand::Upsampled && !even) {
        return None;
    }
    let one = |c: usize| Channels::new(c as u32);
    let two = Channels { first: half as u32, second: (case.cin - half) as u32 };
    let input = if operand == Operand::Whole { one(case.cin) } else { two };
    let layer = Layer { input, cout: case.cout as u32 };
    let low = Tensor::uniform([n, half, h / 2, w / 2], seed_of(&case.name));
    let rest = channels(whole, half, case.cin);
    let mut weight = data.weight.to_f64();
    let mut bias = data.bias.clone();
    let (low, x, from, to) = match operand {
        Operand::Whole | Operand::Joined => {
            (None, whole.to_f64(), upload(gpu, whole, input), Channels::new(case.cout as u32))
        }
        Operand::Upsampled => {
            let x = concat::reference(&upsample2d::reference(&low.to_f64()), &rest.to_f64());
            (Some(upload(gpu, &low, one(half))), x, upload(gpu, &rest, one(case.cin - half)), one(case.cout))
        }
        Operand::Gradient => {
            weight = transposed(&weight);
            bias = vec![0.0; case.cin];
            let dy = &data.output_gradient;
            (None, dy.to_f64(), upload(gpu, dy, one(case.cout)), two)
        }
    };
    let bias_f64: Vec<f64> = bias.iter().map(|b| f64::from(*b)).collect();
    let expected = conv2d::reference(&x, &weight, &bias_f64);

    let floats = |name: &str, values: &[f32]| {
        let buffer = gpu.buffer(name, values.len() as u64 * 4 + 256).unwrap();
        gpu.upload(&buffer.all(), values).unwrap();
        buffer.all()
    };
    let is_gradient = operand == Operand::Gradient;
    let (oihw, bias_device) = (floats("weight", &data.weight.data), floats("bias", &bias));
    let packed = gpu.buffer("transformed", winograd::weights_bytes(family, layer, is_gradient)).unwrap().all();
    let y = DeviceTensor::new(gpu, "y", Shape { n: n as u32, h: h as u32, w: w as u32, c: to }).unwrap();
    gpu.upload(&y.slice, &vec![f32::NAN; y.shape.bytes() as usize / 4]).unwrap();
    let pass = Pass { low: low.as_ref(), x: &from, weight: &packed, bias: &bias_device, y: &y, slope: 1.0 };
    let mut rec = gpu.recorder();
    winograd::transform_weights(gpu, &mut rec, family, layer, &oihw, &packed, is_gradient).unwrap();
    winograd::record(gpu, &mut rec, family, &pass).unwrap();
    let mut commands = rec.finish().unwrap();
    hazard::check(commands.events()).unwrap();
    commands.run().unwrap();
    let actual = Tensor::new(expected.shape, y.download(gpu).unwrap());
    let within = tensors_within(&actual, &expected, &bound(&x, &weight, &bias_f64));
    Some(within.and_then(|()| padding_is_zero(gpu, &y)))
}

/// The channels of a tensor from `from` to `to`.
fn channels(t: &Tensor<f32>, from: usize, to: usize) -> Tensor<f32> {
    let [n, _, h, w] = t.shape;
    let data = (0..n).flat_map(|i| (from..to).flat_map(move |c| t.plane(i, c).to_vec())).collect();
    Tensor::new([n, to - from, h, w], data)
}

#[test]
fn winograd_kernels_equal_the_reference() {
    let gpu = gpu();
    let families: Vec<_> = Family::all(gpu.info()).into_iter().filter(|f| matches!(f, Family::Cpu { .. })).collect();
    if families.is_empty() {
        println!("NOT RUN: the device has no family with Winograd kernels");
    }
    let mut failures = Vec::new();
    let mut checked = [0; OPERANDS.len()];
    for family in families {
        for case in cases().iter().filter(|c| c.kind == Kind::Conv2d) {
            for (count, operand) in checked.iter_mut().zip(OPERANDS) {
                let Some(result) = check(&gpu, family, case, operand) else { continue };
                *count += 1;
                if let Err(e) = result {
                    failures.push(format!("{}, {operand:?}: {e}", case.name));
                }
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    if gpu.info().is_cpu && gpu.info().subgroup_size >= 8 {
        assert!(checked.iter().all(|c| *c >= 3), "{checked:?} rows of {OPERANDS:?}");
    }
}
