//! The Winograd convolution against the convolution's reference, on the case table: operands whole, in two parts, and with
//! the first part upsampled.

mod common;

use common::compare::tensors_within;
use common::{gpu, padding_is_zero};
use limpid::gpu::{Gpu, hazard};
use limpid::net::device::{Channels, DeviceTensor, Shape};
use limpid::net::kernel::winograd::{self, Operand, Pass};
use limpid::net::kernel::{Family, conv2d::Layer};
use limpid::net::layer::{Case, Kind, cases, concat, conv2d, upsample2d, winograd::bound};
use limpid::net::tensor::{Tensor, seed_of};

fn upload(gpu: &Gpu, tensor: &Tensor<f32>, channels: Channels) -> DeviceTensor {
    let [n, _, h, w] = tensor.shape.map(|v| v as u32);
    let device = DeviceTensor::new(gpu, "operand", Shape { n, h, w, c: channels }).unwrap();
    device.upload(gpu, &tensor.data).unwrap();
    device
}

/// Convolves `parts` (the first upsampled where told) on the device and compares with the reference.
fn check(gpu: &Gpu, family: Family, case: &Case, parts: &[Tensor<f32>], upsampled: bool) -> Result<(), String> {
    let data = case.data();
    let f64s = |t: &Tensor<f32>| t.to_f64();
    let first = if upsampled { upsample2d::reference(&f64s(&parts[0])) } else { f64s(&parts[0]) };
    let (x, input) = match parts {
        [_] => (first, Channels::new(case.cin as u32)),
        [a, b] => {
            (concat::reference(&first, &f64s(b)), Channels { first: a.shape[1] as u32, second: b.shape[1] as u32 })
        }
        _ => unreachable!("one part or two"),
    };
    let (weight, bias) = (data.weight.to_f64(), data.bias.iter().map(|b| f64::from(*b)).collect::<Vec<_>>());
    let expected = conv2d::reference(&x, &weight, &bias);

    let floats = |name: &str, values: &[f32]| {
        let buffer = gpu.buffer(name, values.len() as u64 * 4 + 256).unwrap();
        gpu.upload(&buffer.all(), values).unwrap();
        buffer.all()
    };
    let layer = Layer { input, cout: case.cout as u32 };
    let tensors: Vec<_> = parts.iter().map(|p| upload(gpu, p, Channels::new(p.shape[1] as u32))).collect();
    let operands: Vec<_> =
        tensors.iter().enumerate().map(|(i, x)| Operand { x, upsampled: upsampled && i == 0 }).collect();
    let (oihw, bias_device) = (floats("weight", &data.weight.data), floats("bias", &data.bias));
    let transformed = gpu.buffer("transformed", winograd::weights_bytes(family, layer, false)).unwrap().all();
    let [n, c, h, w] = case.output_shape().map(|v| v as u32);
    let y = DeviceTensor::new(gpu, "y", Shape { n, h, w, c: Channels::new(c) }).unwrap();
    gpu.upload(&y.slice, &vec![f32::NAN; y.shape.bytes() as usize / 4]).unwrap();
    let pass = Pass { operands: &operands, weight: &transformed, bias: &bias_device, y: &y, slope: 1.0 };
    let mut rec = gpu.recorder();
    winograd::transform_weights(gpu, &mut rec, family, layer, &oihw, &transformed, false).unwrap();
    winograd::record(gpu, &mut rec, family, &pass).unwrap();
    let mut commands = rec.finish().unwrap();
    hazard::check(commands.events()).unwrap();
    commands.run().unwrap();
    let actual = Tensor::new(case.output_shape(), y.download(gpu).unwrap());
    tensors_within(&actual, &expected, &bound(&x, &weight, &bias))?;
    padding_is_zero(gpu, &y)
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
    let mut checked = [0; 3];
    for family in families {
        for case in cases().iter().filter(|c| c.kind == Kind::Conv2d) {
            let whole = case.data().inputs[0].clone();
            let half = case.cin / 2;
            let [n, _, h, w] = whole.shape;
            let mut inputs = vec![(vec![whole.clone()], false)];
            if half > 0 {
                inputs.push((vec![channels(&whole, 0, half), channels(&whole, half, case.cin)], false));
                if h.is_multiple_of(2) && w.is_multiple_of(2) {
                    let low = Tensor::uniform([n, half, h / 2, w / 2], seed_of(&case.name));
                    inputs.push((vec![low, channels(&whole, half, case.cin)], true));
                }
            }
            for (parts, upsampled) in inputs {
                checked[if upsampled { 2 } else { parts.len() - 1 }] += 1;
                if let Err(e) = check(&gpu, family, case, &parts, upsampled) {
                    failures.push(format!("{} in {} parts, upsampled: {upsampled}: {e}", case.name, parts.len()));
                }
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    if gpu.info().is_cpu && gpu.info().subgroup_size >= 8 {
        assert!(checked.iter().all(|c| *c >= 3), "{checked:?} rows whole, in parts, upsampled");
    }
}
