//! The rows of the self-check on the device.

use super::check::{Part, Row};
use crate::Result;
use crate::gpu::{Gpu, Recorder, Slice};
use crate::net::device::{Channels, DeviceTensor, Shape};
use crate::net::kernel::{Family, conv2d, winograd};
use crate::net::tensor::Tensor;
use crate::train::kernel::conv2d as conv_grad;

/// Results begin as NaN, so that what a kernel leaves out is found.
fn poison(gpu: &Gpu, slice: &Slice) -> Result<()> {
    gpu.upload(slice, &vec![f32::NAN; slice.bytes() as usize / 4])
}

fn shape([n, c, h, w]: [usize; 4], channels: Option<Channels>) -> Shape {
    Shape { n: n as u32, h: h as u32, w: w as u32, c: channels.unwrap_or(Channels::new(c as u32)) }
}

fn upload(gpu: &Gpu, tensor: &Tensor) -> Result<DeviceTensor> {
    let device = DeviceTensor::new(gpu, "checked operand", shape(tensor.shape, None))?;
    device.upload(gpu, &tensor.data)?;
    Ok(device)
}

fn result(gpu: &Gpu, of: [usize; 4]) -> Result<DeviceTensor> {
    let device = DeviceTensor::new(gpu, "checked result", shape(of, None))?;
    poison(gpu, &device.slice)?;
    Ok(device)
}

fn floats(gpu: &Gpu, values: &[f32], count: usize) -> Result<Slice> {
    let buffer = gpu.buffer("checked parameters", count.max(values.len()) as u64 * 4)?;
    gpu.upload(&buffer.all(), values)?;
    Ok(buffer.all())
}

fn run_now(gpu: &Gpu, record: impl FnOnce(&mut Recorder) -> Result<()>) -> Result<()> {
    let mut rec = gpu.recorder();
    record(&mut rec)?;
    rec.finish()?.run().map(drop)
}

/// Computes a row with a family's kernels: the output, or the gradient that it is about.
pub(super) fn run(gpu: &Gpu, family: Family, row: &Row) -> Result<Tensor> {
    match row.part {
        Part::Forward | Part::InputGradient => convolution(gpu, family, row),
        Part::Winograd | Part::WinogradUpsampled => by_winograd(gpu, family, row),
        Part::WeightGradient => weight_gradient(gpu, family, row),
    }
}

fn layer(row: &Row) -> conv2d::Layer {
    let channels = |i: usize| row.data.inputs[i].shape[1] as u32;
    let input = match row.part {
        Part::WinogradUpsampled => Channels { first: channels(0), second: channels(1) },
        _ => Channels::new(channels(0)),
    };
    conv2d::Layer { input, cout: row.case.cout as u32 }
}

/// The input gradient is the convolution of the output's gradient with transposed weights.
fn convolution(gpu: &Gpu, family: Family, row: &Row) -> Result<Tensor> {
    let (data, layer) = (&row.data, layer(row));
    let transposed = row.part == Part::InputGradient;
    let (from, to) = if transposed {
        (&data.output_gradient, data.inputs[0].shape)
    } else {
        (&data.inputs[0], row.case.output_shape())
    };
    let (x, y) = (upload(gpu, from)?, result(gpu, to)?);
    let oihw = floats(gpu, &data.weight.data, 0)?;
    let bias = floats(gpu, if transposed { &[] } else { &data.bias }, to[1].next_multiple_of(64))?;
    let packed = gpu.buffer("checked weights", layer.packed_bytes(family, transposed))?.all();
    run_now(gpu, |rec| {
        conv2d::pack(gpu, rec, family, layer, &oihw, &packed, transposed)?;
        let pass = conv2d::Pass { x: &x, weight: &packed, bias: &bias, y: &y, slope: 1.0 };
        conv2d::record(gpu, rec, family, &pass)
    })?;
    Ok(Tensor::new(to, y.download(gpu)?))
}

fn by_winograd(gpu: &Gpu, family: Family, row: &Row) -> Result<Tensor> {
    let (data, layer) = (&row.data, layer(row));
    let tensors = data.inputs.iter().map(|part| upload(gpu, part)).collect::<Result<Vec<_>>>()?;
    let (low, x) = match &tensors[..] {
        [low, x] => (Some(low), x),
        all => (None, &all[0]),
    };
    let y = result(gpu, row.case.output_shape())?;
    let oihw = floats(gpu, &data.weight.data, 0)?;
    let bias = floats(gpu, &data.bias, row.case.cout.next_multiple_of(64))?;
    let weight = gpu.buffer("checked weights", winograd::weights_bytes(family, layer, false))?.all();
    run_now(gpu, |rec| {
        winograd::transform_weights(gpu, rec, family, layer, &oihw, &weight, false)?;
        let pass = winograd::Pass { low, x, weight: &weight, bias: &bias, y: &y, slope: 1.0 };
        winograd::record(gpu, rec, family, &pass)
    })?;
    Ok(Tensor::new(row.case.output_shape(), y.download(gpu)?))
}

fn weight_gradient(gpu: &Gpu, family: Family, row: &Row) -> Result<Tensor> {
    let (data, layer) = (&row.data, layer(row));
    let (x, dy) = (upload(gpu, &data.inputs[0])?, upload(gpu, &data.output_gradient)?);
    let scratch = conv_grad::Scratch::new(gpu, family, &[(layer, x.shape)])?;
    let dw = gpu.buffer("checked gradient", data.weight.len() as u64 * 4)?;
    poison(gpu, &dw.all())?;
    run_now(gpu, |rec| conv_grad::weight_grad(gpu, rec, layer, &scratch, &x, &dy, &dw.all()))?;
    let values: Vec<f32> = gpu.download(&dw.all())?;
    Ok(Tensor::new(data.weight.shape, values[..data.weight.len()].to_vec()))
}
