//! Every kernel of every layer and family against the layer's reference, forward and backward, on the case table.

mod common;

use common::compare::{tensors_within, within};
use common::{gpu, padding_is_zero, precision};
use limpid::gpu::{Gpu, hazard};
use limpid::net::device::{Channels, DeviceTensor, Shape};
use limpid::net::kernel::{Family, concat, conv2d, leaky_relu, max_pool2d, upsample2d};
use limpid::net::layer::conv2d::{reference_bias_gradient, rounding_bound};
use limpid::net::layer::{Case, Data, Kind, Pattern, cases};
use limpid::net::tensor::Tensor;
use limpid::train::kernel::conv2d as conv_grad;
use limpid::train::kernel::elementwise;

/// NaN wherever a kernel may write, so that an element left out is found.
fn poisoned(gpu: &Gpu, shape: Shape) -> DeviceTensor {
    let tensor = DeviceTensor::new(gpu, "poisoned", shape).unwrap();
    gpu.upload(&tensor.slice, &vec![f32::NAN; shape.bytes() as usize / 4]).unwrap();
    tensor
}

fn shape_of([n, c, h, w]: [usize; 4], channels: Option<Channels>) -> Shape {
    Shape { n: n as u32, h: h as u32, w: w as u32, c: channels.unwrap_or(Channels::new(c as u32)) }
}

fn upload(gpu: &Gpu, tensor: &Tensor<f32>, channels: Option<Channels>) -> DeviceTensor {
    let device = DeviceTensor::new(gpu, "operand", shape_of(tensor.shape, channels)).unwrap();
    device.upload(gpu, &tensor.data).unwrap();
    device
}

fn download(gpu: &Gpu, tensor: &DeviceTensor) -> Tensor<f32> {
    let s = tensor.shape;
    let shape = [s.n, s.c.count(), s.h, s.w].map(|v| v as usize);
    Tensor::new(shape, tensor.download(gpu).unwrap())
}

/// Runs what `record` adds, checked for races.
fn run(gpu: &Gpu, record: impl FnOnce(&mut limpid::gpu::Recorder)) {
    let mut rec = gpu.recorder();
    record(&mut rec);
    let mut commands = rec.finish().unwrap();
    hazard::check(commands.events()).unwrap();
    commands.run().unwrap();
}

/// A convolution's operands on the device. `segments` splits the input channels in two, as after a concatenation.
struct Conv {
    layer: conv2d::Layer,
    x: DeviceTensor,
    dy: DeviceTensor,
    weight: limpid::gpu::Buffer,
    bias: limpid::gpu::Buffer,
}

fn conv(gpu: &Gpu, case: &Case, data: &Data, input: Channels) -> Conv {
    let floats = |name: &str, values: &[f32]| {
        let buffer = gpu.buffer(name, values.len() as u64 * 4 + 256).unwrap();
        gpu.upload(&buffer.all(), values).unwrap();
        buffer
    };
    Conv {
        layer: conv2d::Layer { input, cout: case.cout as u32 },
        x: upload(gpu, &data.inputs[0], Some(input)),
        dy: upload(gpu, &data.output_gradient, None),
        weight: floats("weight", &data.weight.data),
        bias: floats("bias", &data.bias),
    }
}

fn check_conv(gpu: &Gpu, family: Family, case: &Case, input: Channels) -> Result<(), String> {
    let given = case.data();
    let c = conv(gpu, case, &given, input);
    let data = precision::operands(family, &given);
    let bounds = case.bounds(&data);
    let packed = |transposed| {
        let buffer = gpu.buffer("packed", c.layer.packed_bytes(family, transposed)).unwrap().all();
        run(gpu, |rec| conv2d::pack(gpu, rec, family, c.layer, &c.weight.all(), &buffer, transposed).unwrap());
        buffer
    };
    let y = poisoned(gpu, shape_of(case.output_shape(), None));
    let (weight, bias) = (packed(false), c.bias.all());
    run(gpu, |rec| {
        conv2d::record(gpu, rec, family, &conv2d::Pass { x: &c.x, weight: &weight, bias: &bias, y: &y, slope: 1.0 })
            .unwrap();
    });
    tensors_within(&download(gpu, &y), &case.reference(&data), &bounds.output).map_err(|e| format!("forward: {e}"))?;
    padding_is_zero(gpu, &y).unwrap_or_else(|e| panic!("{}: {e}", case.name));

    let expected = case.reference_backward(&data);
    let dx = poisoned(gpu, c.x.shape);
    let (weight, bias) = (packed(true), gpu.buffer("zero", 1024 + 256).unwrap().all());
    run(gpu, |rec| {
        conv2d::record(gpu, rec, family, &conv2d::Pass { x: &c.dy, weight: &weight, bias: &bias, y: &dx, slope: 1.0 })
            .unwrap();
    });
    tensors_within(&download(gpu, &dx), &expected.inputs[0], &bounds.gradients.inputs[0])
        .map_err(|e| format!("dx: {e}"))?;
    padding_is_zero(gpu, &dx).unwrap_or_else(|e| panic!("{}: {e}", case.name));

    let scratch = conv_grad::Scratch::new(gpu, family, &[(c.layer, c.x.shape)]).unwrap();
    let dw = gpu.buffer("dw", data.weight.data.len() as u64 * 4).unwrap();
    let db = gpu.buffer("db", data.bias.len() as u64 * 4 + 256).unwrap();
    run(gpu, |rec| {
        conv_grad::weight_grad(gpu, rec, c.layer, &scratch, &c.x, &c.dy, &dw.all()).unwrap();
        conv_grad::bias_grad(gpu, rec, c.layer, &scratch, &c.dy, &db.all()).unwrap();
    });
    let values: Vec<f32> = gpu.download(&dw.all()).unwrap();
    let values = &values[..data.weight.data.len()];
    within(values, &expected.weight.data, &bounds.gradients.weight.data).map_err(|e| format!("dw: {e}"))?;
    let values: Vec<f32> = gpu.download(&db.all()).unwrap();
    let values = &values[..data.bias.len()];
    // No matrix product: all families read the gradient as it is.
    let dy = given.output_gradient.to_f64();
    let pixels = case.batch * case.height * case.width;
    let exact = case.pattern != Pattern::Random && case.pattern != Pattern::OneHotWeight;
    let bound = |sum: f64| if exact { 0.0 } else { rounding_bound(pixels, sum) };
    let bounds: Vec<f64> = reference_bias_gradient(&dy.map(f64::abs)).into_iter().map(bound).collect();
    within(values, &reference_bias_gradient(&dy), &bounds).map_err(|e| format!("db: {e}"))
}

fn check_elementwise(gpu: &Gpu, case: &Case) -> Result<(), String> {
    let data = case.data();
    let bounds = case.bounds(&data);
    let inputs: Vec<_> = data.inputs.iter().map(|t| upload(gpu, t, None)).collect();
    let channels = (case.kind == Kind::Concat)
        .then(|| Channels { first: inputs[0].shape.c.first, second: inputs[1].shape.c.first });
    let y = poisoned(gpu, shape_of(case.output_shape(), channels));
    let dy = upload(gpu, &data.output_gradient, channels);
    let dx: Vec<_> = inputs.iter().map(|x| poisoned(gpu, x.shape)).collect();
    let x = &inputs[0];
    run(gpu, |rec| match case.kind {
        Kind::Conv2d => unreachable!("has weights"),
        Kind::LeakyRelu => {
            leaky_relu::record(gpu, rec, x, &y, case.slope).unwrap();
            elementwise::leaky_relu(gpu, rec, &y, &dy, &dx[0], case.slope).unwrap();
        }
        Kind::MaxPool2d => {
            max_pool2d::record(gpu, rec, x, &y).unwrap();
            elementwise::max_pool2d(gpu, rec, x, &dy, &dx[0]).unwrap();
        }
        Kind::Upsample2d => {
            upsample2d::record(gpu, rec, x, &y).unwrap();
            elementwise::upsample2d(gpu, rec, &dy, &dx[0]).unwrap();
        }
        Kind::Concat => {
            concat::record(gpu, rec, x, &inputs[1], &y).unwrap();
            elementwise::concat(gpu, rec, &dy, &dx[0], false).unwrap();
            elementwise::concat(gpu, rec, &dy, &dx[1], true).unwrap();
        }
    });
    tensors_within(&download(gpu, &y), &case.reference(&data), &bounds.output).map_err(|e| format!("forward: {e}"))?;
    let expected = case.reference_backward(&data);
    for (i, dx) in dx.iter().enumerate() {
        let actual = download(gpu, dx);
        tensors_within(&actual, &expected.inputs[i], &bounds.gradients.inputs[i]).map_err(|e| format!("d{i}: {e}"))?;
    }
    Ok(())
}

fn check_all(kind: Kind) {
    let gpu = gpu();
    let (mut failures, families) = (Vec::new(), precision::families(gpu.info()));
    for case in cases().iter().filter(|c| c.kind == kind) {
        if kind == Kind::Conv2d {
            for &family in &families {
                // Also as the operand of a concatenation, in two segments of odd length.
                let whole = Channels::new(case.cin as u32);
                let first = case.cin as u32 / 2;
                let split = Channels { first, second: case.cin as u32 - first };
                for input in [whole, split].into_iter().take(if first > 0 { 2 } else { 1 }) {
                    if let Err(e) = check_conv(&gpu, family, case, input) {
                        failures.push(format!("{} {} {input:?}: {e}", case.name, family.name()));
                    }
                }
            }
        } else if let Err(e) = check_elementwise(&gpu, case) {
            failures.push(format!("{}: {e}", case.name));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn conv2d_kernels_equal_the_reference() {
    check_all(Kind::Conv2d);
}

#[test]
fn leaky_relu_kernels_equal_the_reference() {
    check_all(Kind::LeakyRelu);
}

#[test]
fn max_pool2d_kernels_equal_the_reference() {
    check_all(Kind::MaxPool2d);
}

#[test]
fn upsample2d_kernels_equal_the_reference() {
    check_all(Kind::Upsample2d);
}

#[test]
fn concat_kernels_equal_the_reference() {
    check_all(Kind::Concat);
}

#[test]
fn every_kind_of_layer_has_a_test() {
    for kind in Kind::ALL {
        match kind {
            Kind::Conv2d | Kind::LeakyRelu | Kind::MaxPool2d | Kind::Upsample2d | Kind::Concat => {}
        }
    }
}
