//! Whole training steps on the device against the reference steps in f64.

mod common;

use common::compare::{close, l2_close, relative_l2, require, same_bits, within};
use common::networks::{forward, small_base, small_kpn, tiny, weights, wide};
use common::precision::{self, f32_families, families, gradient_limit, network_limit};
use common::{goldens, gpu};
use limpid::gpu::{Gpu, hazard};
use limpid::net::architecture::Architecture;
use limpid::net::device::{Channels, DeviceTensor, Shape};
use limpid::net::kernel::{Family, conv2d, max_pool2d};
use limpid::net::layer::conv2d::{reference_bias_gradient, reference_weight_gradient, rounding_bound};
use limpid::net::plan::{Fusion, Memory};
use limpid::net::tensor::Tensor;
use limpid::net::weights::Weights;
use limpid::net::{layer, reference};
use limpid::train::adam::{Adam, ReferenceState};
use limpid::train::kernel::{conv2d as conv_grad, elementwise};
use limpid::train::loss::Loss;
use limpid::train::reference as training;
use limpid::train::step::Step;

/// Half of the spacing of f32 at 1.
const ROUNDING: f64 = 1.0 / (1 << 24) as f64;

/// A batch: the network's input and target.
struct Batch {
    input: Tensor<f32>,
    target: Tensor<f32>,
}

fn batch(architecture: &Architecture, [n, h, w]: [usize; 3], name: &str) -> Batch {
    Batch {
        input: goldens::network_input(architecture, [n, h, w], &format!("{name}/input")),
        target: goldens::drawn([n, architecture.output_channels(), h, w], &format!("{name}/target")),
    }
}

fn step_for(gpu: &Gpu, family: Family, weights: &Weights, batch: &Batch, minimise: (Adam, Loss)) -> Step {
    let [n, _, h, w] = batch.input.shape.map(|size| size as u32);
    let step = Step::new(gpu, family, weights, (n, h, w), minimise.0, minimise.1).unwrap();
    hazard::check(step.commands().events()).unwrap();
    step
}

/// Takes a step with `batch`; the loss before it.
fn take(gpu: &Gpu, step: &mut Step, batch: &Batch, adam: &Adam) -> f64 {
    step.input().upload(gpu, &batch.input.data).unwrap();
    step.target().upload(gpu, &batch.target.data).unwrap();
    step.run(adam.learning_rate).unwrap().0
}

fn to_f64(values: &[f32]) -> Vec<f64> {
    values.iter().copied().map(f64::from).collect()
}

/// Values, loss and gradient of the step just taken, whose parameters were `parameters`, against the reference.
///
/// Every value is held to what the output is elsewhere. The gradient jumps where an activation changes its sign or a pooling its
/// winner, so it is compared with the reference's at the values that the device computed.
/// The loss is a mean of absolute values, so it differs by no more than the mean, and so the root mean square, of the
/// outputs' errors: what the forward pass is held to, and the rounding of its own sums.
fn require_gradient(
    gpu: &Gpu,
    step: &Step,
    parameters: &[f32],
    batch: &Batch,
    (minimised, loss): (Loss, f64),
    gradient: &[f32],
) {
    let (family, architecture) = (step.parameters.family(), step.parameters.architecture());
    let parameters = to_f64(parameters);
    let expected = reference::forward(architecture, &parameters, &batch.input.to_f64());
    let mut values = Vec::new();
    for ((node, expected), value) in architecture.nodes().iter().zip(&expected).zip(&step.plan().values) {
        let actual = Tensor::new(expected.shape, value.download(gpu).unwrap());
        require(&node.name, l2_close(&actual.data, &expected.data, network_limit(family)));
        values.push(actual.to_f64());
    }
    let (output, target) = (expected.last().unwrap(), batch.target.to_f64());
    let root_mean_square = (output.data.iter().map(|v| v * v).sum::<f64>() / output.len() as f64).sqrt();
    let expected = minimised.reference(output, &target);
    require("loss", close(&[loss], &[expected], network_limit(family) * root_mean_square, 32.0 * ROUNDING));
    let output_gradient = minimised.reference_backward(values.last().unwrap(), &target);
    let operand = |t: &Tensor<f64>| precision::operand_f64(family, t);
    let expected = reference::backward_with(architecture, &parameters, &values, &output_gradient, &operand).parameters;
    for spec in architecture.tensors() {
        let limit = gradient_limit(family, architecture);
        require(&spec.name, l2_close(&gradient[spec.range.clone()], &expected[spec.range], limit));
    }
}

/// Adam on the device against Adam in f64 with the device's own gradients, step by step.
///
/// Every step of the update is a handful of roundings: `m` and `v` (3 each, of sums of terms of one order), a root, two
/// products, a quotient: 16 of them relative to the learning rate, which bounds the quotient but for bias correction
/// (at most sqrt(1 - b2^t) / (1 - b1^t) * sqrt(t) < 3 in three steps). And the new parameter's own rounding.
struct AdamOracle {
    adam: Adam,
    state: ReferenceState,
    parameters: Vec<f64>,
    bound: Vec<f64>,
}

impl AdamOracle {
    fn new(adam: Adam, weights: &Weights) -> Self {
        let state = ReferenceState::new(&weights.architecture.parameter_scales());
        Self { adam, state, parameters: weights.to_f64(), bound: vec![0.0; weights.parameters.len()] }
    }

    fn require_step(&mut self, gradient: &[f32], parameters: &[f32]) {
        self.adam.reference(&mut self.state, &mut self.parameters, &to_f64(gradient));
        for ((bound, p), scale) in self.bound.iter_mut().zip(&self.parameters).zip(&self.state.scales) {
            *bound += ROUNDING * (p.abs() + 3.0 * 16.0 * scale * self.adam.learning_rate);
        }
        let what = format!("parameters after step {}", self.state.step);
        require(&what, within(parameters, &self.parameters, &self.bound));
    }
}

fn three_steps(architecture: &Architecture, size: [usize; 3]) {
    let (gpu, weights, adam) = (gpu(), weights(architecture), Adam::default());
    for (family, minimised) in families(gpu.info()).into_iter().flat_map(|f| Loss::ALL.map(|loss| (f, loss))) {
        let mut oracle = AdamOracle::new(adam, &weights);
        let mut parameters = weights.parameters.clone();
        let batches = [0, 1, 2].map(|i| batch(architecture, size, &format!("steps/{i}")));
        let mut step = step_for(&gpu, family, &weights, &batches[0], (adam, minimised));
        for batch in &batches {
            let loss = take(&gpu, &mut step, batch, &adam);
            let gradient = step.gradient().unwrap();
            require_gradient(&gpu, &step, &parameters, batch, (minimised, loss), &gradient);
            parameters = step.parameters.get().unwrap();
            oracle.require_step(&gradient, &parameters);
        }
        assert_eq!(step.steps_done(), 3);
    }
}

#[test]
fn steps_of_a_tiny_network_equal_the_reference() {
    three_steps(&tiny(), [3, 6, 10]);
    // Several workgroups of the loss, some cut off.
    three_steps(&tiny(), [2, 18, 36]);
}

#[test]
fn steps_of_seed_equal_the_reference() {
    three_steps(&Architecture::seed(), [2, 32, 32]);
}

/// Slope 0; pooled values with two users; a skip that is the network's input.
#[test]
fn steps_of_base_equal_the_reference() {
    three_steps(&small_base(), [2, 32, 16]);
}

/// Filters of five levels, of a picture that ends before the crop does.
#[test]
fn steps_of_kpn_equal_the_reference() {
    three_steps(&small_kpn(), [2, 32, 16]);
}

/// The whole trajectory against the reference's, which never sees the device. Adam divides by the gradient's size and so
/// multiplies the error of a gradient near zero; an epsilon far above the gradients makes the step proportional to them, and
/// a large rate makes it stand out from the rounding of the parameters. Three steps of gradients within 1e-5: 3e-5. For f32:
/// errors of f16 tip signs of the loss's gradient, which `steps_of_*` tell apart.
#[test]
fn three_steps_follow_the_reference() {
    let adam = Adam { learning_rate: 0.2, epsilon: 1.0, ..Adam::default() };
    let (gpu, architecture) = (gpu(), tiny());
    let weights = weights(&architecture);
    let batches = [0, 1, 2].map(|i| batch(&architecture, [2, 16, 16], &format!("trajectory/{i}")));
    for family in f32_families(gpu.info()) {
        let mut step = step_for(&gpu, family, &weights, &batches[0], (adam, Loss::Mae));
        let mut state = ReferenceState::new(&architecture.parameter_scales());
        let mut expected = weights.to_f64();
        for batch in &batches {
            take(&gpu, &mut step, batch, &adam);
            let (input, target) = (batch.input.to_f64(), batch.target.to_f64());
            training::step((&architecture, Loss::Mae), &adam, &mut state, &mut expected, &input, &target);
            let start = weights.to_f64();
            let change = |values: &[f64]| values.iter().zip(&start).map(|(v, s)| v - s).collect::<Vec<_>>();
            let actual = to_f64(&step.parameters.get().unwrap());
            require(family.name(), l2_close(&change(&actual), &change(&expected), 3e-5));
        }
        let moments = step.moments().unwrap();
        assert_eq!(moments.step, 3);
        require("mean", l2_close(&moments.mean, &state.mean, 3e-5));
        require("mean square", l2_close(&moments.mean_square, &state.mean_square, 6e-5));
    }
}

/// The slope of the device's loss along the gradient of each tensor is the gradient's length. The finite step costs what it
/// costs the reference; the loss is exact to 1e-5 of the outputs' root mean square (see `require_gradient`), twice. For f32: with weights in f16 the loss
/// is a staircase whose steps are larger than this one.
#[test]
fn gradients_match_central_differences_of_the_loss() {
    const H: f64 = 0.01;
    let (gpu, architecture, adam) = (gpu(), tiny(), Adam::default());
    let weights = weights(&architecture);
    let batch = batch(&architecture, [2, 8, 8], "differences");
    let (input, target) = (batch.input.to_f64(), batch.target.to_f64());
    let values = reference::forward(&architecture, &weights.to_f64(), &input);
    let output = &values.last().unwrap().data;
    let noise = 1e-5 * (output.iter().map(|v| v * v).sum::<f64>() / output.len() as f64).sqrt() / H;
    for family in f32_families(gpu.info()) {
        let mut step = step_for(&gpu, family, &weights, &batch, (adam, Loss::Mae));
        take(&gpu, &mut step, &batch, &adam);
        let gradient = to_f64(&step.gradient().unwrap());
        for spec in architecture.tensors() {
            let part = &gradient[spec.range.clone()];
            let length = part.iter().map(|g| g * g).sum::<f64>().sqrt();
            let moved = |h: f64| {
                let mut parameters = weights.parameters.clone();
                parameters[spec.range.clone()].iter_mut().zip(part).for_each(|(p, g)| *p += (h * g / length) as f32);
                parameters
            };
            let mut on_device = |h: f64| {
                step.parameters.set(&moved(h)).unwrap();
                take(&gpu, &mut step, &batch, &adam)
            };
            let slope = (on_device(H) - on_device(-H)) / (2.0 * H);
            let reference =
                |h: f64| training::gradient((&architecture, Loss::Mae), &to_f64(&moved(h)), &input, &target).0;
            let finite_step = ((reference(H) - reference(-H)) / (2.0 * H) - length).abs();
            let what = format!("{} {}", family.name(), spec.name);
            // A tolerance near the slope itself would show nothing.
            assert!(finite_step + noise < 0.1 * length, "{what}: {finite_step} and {noise} of {length}");
            require(&what, close(&[slope], &[length], finite_step + noise, 0.0));
        }
    }
}

/// Fresh, or continued from what a checkpoint holds: the same bits.
#[test]
fn equal_runs_and_resumed_runs_give_equal_bits() {
    let (gpu, architecture, adam) = (gpu(), tiny(), Adam::default());
    let weights = weights(&architecture);
    let batches = [0, 1, 2, 3].map(|i| batch(&architecture, [2, 16, 16], &format!("bits/{i}")));
    for family in families(gpu.info()) {
        let fresh = |weights: &Weights| step_for(&gpu, family, weights, &batches[0], (adam, Loss::Mae));
        let (mut first, mut second) = (fresh(&weights), fresh(&weights));
        let mut resumed = None;
        for (i, batch) in batches.iter().enumerate() {
            if i == 2 {
                let mut step = fresh(&first.weights(&architecture).unwrap());
                step.set_moments(&first.moments().unwrap()).unwrap();
                assert_eq!(step.moments().unwrap(), first.moments().unwrap());
                resumed = Some(step);
            }
            let loss = take(&gpu, &mut first, batch, &adam);
            let parameters = first.parameters.get().unwrap();
            for other in [Some(&mut second), resumed.as_mut()].into_iter().flatten() {
                assert_eq!(take(&gpu, other, batch, &adam).to_bits(), loss.to_bits());
                require(family.name(), same_bits(&other.parameters.get().unwrap(), &parameters));
                require(family.name(), same_bits(&other.gradient().unwrap(), &first.gradient().unwrap()));
                assert_eq!(other.moments().unwrap(), first.moments().unwrap());
            }
        }
        let moved = relative_l2(&first.parameters.get().unwrap(), &weights.parameters).unwrap();
        assert!(moved > 1e-3, "the parameters hardly moved: {moved}");
    }
}

/// A run with batches of several sizes is one of steps of one size each, which hand parameters and moments on.
#[test]
fn sizes_share_parameters_and_moments() {
    let gpu = gpu();
    let architecture = tiny();
    let weights = weights(&architecture);
    let adam = Adam { learning_rate: 1e-2, ..Adam::default() };
    let batches = [[2, 8, 8], [1, 16, 12]].map(|size| batch(&architecture, size, "sizes"));
    let size = |batch: &Batch| {
        let [n, _, h, w] = batch.input.shape.map(|size| size as u32);
        (n, h, w)
    };
    for family in families(gpu.info()) {
        let sizes = [size(&batches[0]), size(&batches[1])];
        let mut all = Step::with_sizes(&gpu, family, &weights, &sizes, adam, Loss::Mae).unwrap();
        let mut one = step_for(&gpu, family, &weights, &batches[0], (adam, Loss::Mae));
        for i in [0, 1, 1, 0] {
            let mut next = step_for(&gpu, family, &one.weights(&architecture).unwrap(), &batches[i], (adam, Loss::Mae));
            next.set_moments(&one.moments().unwrap()).unwrap();
            one = next;
            let expected = take(&gpu, &mut one, &batches[i], &adam);
            all.input_of(i).upload(&gpu, &batches[i].input.data).unwrap();
            all.target_of(i).upload(&gpu, &batches[i].target.data).unwrap();
            let (loss, _) = all.run_size(i, adam.learning_rate).unwrap();
            assert_eq!(loss.to_bits(), expected.to_bits());
            require(family.name(), same_bits(&all.gradient().unwrap(), &one.gradient().unwrap()));
            require(family.name(), same_bits(&all.parameters.get().unwrap(), &one.parameters.get().unwrap()));
            assert_eq!(all.moments().unwrap(), one.moments().unwrap());
        }
    }
}

/// Sums over 885,000 pixels: one invocation that made them all would pass 65,535 iterations, after which CPU drivers end
/// every loop without a word.
#[test]
fn long_sums_of_weight_and_bias_gradients() {
    let gpu = gpu();
    let (n, channels, size) = (24, 4, 192);
    let strips = n * size / 12;
    assert!(strips * size > 70_000, "{} iterations are no test", strips * size);
    let shape = Shape { n: n as u32, h: size as u32, w: size as u32, c: Channels::new(channels as u32) };
    let operand = |name: &str| {
        let values = goldens::drawn([n, channels, size, size], name);
        let tensor = DeviceTensor::new(&gpu, name, shape).unwrap();
        tensor.upload(&gpu, &values.data).unwrap();
        (values.to_f64(), tensor)
    };
    let ((x, device_x), (dy, device_dy)) = (operand("long/x"), operand("long/dy"));
    let bias = reference_bias_gradient(&dy);
    let bound = |sum: &f64| rounding_bound(n * size * size, *sum);
    let bias_bound: Vec<f64> = reference_bias_gradient(&dy.map(f64::abs)).iter().map(bound).collect();
    for family in families(gpu.info()) {
        let [x, dy] = [&x, &dy].map(|t| precision::operand_f64(family, t));
        let weight = reference_weight_gradient(&x, &dy);
        let sums = reference_weight_gradient(&x.map(f64::abs), &dy.map(f64::abs));
        let weight_bound: Vec<f64> = sums.data.iter().map(bound).collect();
        let layer = conv2d::Layer { input: shape.c, cout: channels as u32 };
        let scratch = conv_grad::Scratch::new(&gpu, family, &[(layer, shape)]).unwrap();
        let dw = gpu.buffer("dw", weight.len() as u64 * 4).unwrap();
        let db = gpu.buffer("db", 256).unwrap();
        let mut rec = gpu.recorder();
        conv_grad::weight_grad(&gpu, &mut rec, layer, &scratch, &device_x, &device_dy, &dw.all()).unwrap();
        conv_grad::bias_grad(&gpu, &mut rec, layer, &scratch, &device_dy, &db.all()).unwrap();
        let mut commands = rec.finish().unwrap();
        hazard::check(commands.events()).unwrap();
        commands.run().unwrap();
        let values: Vec<f32> = gpu.download(&dw.all()).unwrap();
        require(family.name(), within(&values[..weight.len()], &weight.data, &weight_bound));
        let values: Vec<f32> = gpu.download(&db.all()).unwrap();
        require(family.name(), within(&values[..channels], &bias, &bias_bound));
    }
}

/// Gradients of 135 MiB and more: every kernel of the backward pass must cut its work into storage bindings.
#[test]
fn gradients_larger_than_a_storage_binding() {
    let (gpu, architecture, adam) = (gpu(), wide(), Adam::default());
    let (weights, batch) = (weights(&architecture), batch(&architecture, [4, 384, 384], "wide"));
    if gpu.info().is_cpu {
        assert!(4 * 384 * 384 * 60 * 4 > gpu.info().max_storage_range, "the test shows nothing");
    }
    let mut step = step_for(&gpu, Family::choose(gpu.info()), &weights, &batch, (adam, Loss::Mae));
    let loss = take(&gpu, &mut step, &batch, &adam);
    require_gradient(&gpu, &step, &weights.parameters, &batch, (Loss::Mae, loss), &step.gradient().unwrap());
}

/// Pooling, and the gradient of upsampling, write a quarter of what they read: 135 MiB of 540. Zeros but for the first rows
/// and the last ones, which the second storage binding gets.
#[test]
fn quarters_larger_than_a_storage_binding() {
    let gpu = gpu();
    let (height, width, channels) = (2056, 256, 64);
    let small = Shape { n: 1, h: height, w: width, c: Channels::new(channels) };
    let large = Shape { h: 2 * height, w: 2 * width, ..small };
    if gpu.info().is_cpu {
        assert!(small.bytes() > gpu.info().max_storage_range, "the test shows nothing");
    }
    let (from, to) =
        (DeviceTensor::new(&gpu, "large", large).unwrap(), DeviceTensor::new(&gpu, "small", small).unwrap());
    let row = u64::from(width * channels * 4);
    // Integers: their sums are exact. Rows 2y and 2y + 1 of the large one, [row][plane][column] of 4 channels.
    let rows = |y: u32| -> Vec<f32> {
        (0..4 * width * channels)
            .map(|i| (limpid::net::tensor::hash(y.into(), i.into()) % 2000) as f32 - 1000.0)
            .collect()
    };
    let places = [0, 7, height - 8, height - 1];
    for y in places {
        gpu.upload(&from.slice.slice(u64::from(y) * 4 * row, 4 * row), &rows(y)).unwrap();
    }
    let four = |values: &[f32], x: u32, c: u32| {
        [(0, 0), (0, 1), (1, 0), (1, 1)]
            .map(|(r, k)| values[(((r * channels / 4 + c / 4) * 2 * width + 2 * x + k) * 4 + c % 4) as usize])
    };
    type Join = fn([f32; 4]) -> f32;
    let sum: Join = |v| v.iter().sum();
    let largest: Join = |v| v.into_iter().fold(f32::MIN, f32::max);
    for (what, join) in [("max_pool2d", largest), ("gradient of upsample2d", sum)] {
        let mut rec = gpu.recorder();
        match what {
            "max_pool2d" => max_pool2d::record(&gpu, &mut rec, &from, &to).unwrap(),
            _ => elementwise::upsample2d(&gpu, &mut rec, &from, &to).unwrap(),
        }
        rec.finish().unwrap().run().unwrap();
        for y in places {
            let values = rows(y);
            let expected: Vec<f32> =
                (0..width * channels).map(|i| join(four(&values, i / 4 % width, i / 4 / width * 4 + i % 4))).collect();
            let actual: Vec<f32> = gpu.download(&to.slice.slice(u64::from(y) * row, row)).unwrap();
            require(&format!("{what}, row {y}"), close(&actual, &expected, 0.0, 0.0));
        }
    }
}

/// Ties of the pooling and activations of exactly 0 take the sides that the definitions say.
#[test]
fn ties_and_zeros_take_the_stated_sides() {
    let (gpu, architecture, adam) = (gpu(), tiny(), Adam::default());
    // Small integers everywhere: all sums are exact, and many are equal or 0.
    let integers = |values: &mut [f32], range: f32| values.iter_mut().for_each(|v| *v = (*v * range).round());
    let mut weights = weights(&architecture);
    integers(&mut weights.parameters, 3.0);
    // A slope of 0.1 makes values inexact; their ties stay ties, for equal sums round equally.
    let mut batch = batch(&architecture, [2, 8, 8], "ties");
    integers(&mut batch.input.data, 1.5);
    let values = reference::forward(&architecture, &weights.to_f64(), &batch.input.to_f64());
    let enc = &values[1];
    let zeros = enc.data.iter().filter(|v| **v == 0.0).count();
    let pooled = &layer::max_pool2d::reference(enc);
    let ties = (0..pooled.len())
        .filter(|i| {
            let (x, y) = (i % pooled.shape[3], i / pooled.shape[3] % pooled.shape[2]);
            let (c, n) = (i / pooled.plane(0, 0).len() % enc.shape[1], i / pooled.plane(0, 0).len() / enc.shape[1]);
            let window = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(dy, dx)| enc.at(n, c, 2 * y + dy, 2 * x + dx));
            window.iter().filter(|v| **v == pooled.data[*i]).count() > 1
        })
        .count();
    assert!(zeros > 20 && ties > 20, "{zeros} zeros, {ties} ties");
    for family in families(gpu.info()) {
        let mut step = step_for(&gpu, family, &weights, &batch, (adam, Loss::Mae));
        let loss = take(&gpu, &mut step, &batch, &adam);
        require_gradient(&gpu, &step, &weights.parameters, &batch, (Loss::Mae, loss), &step.gradient().unwrap());
    }
}

/// The sign of an error of exactly 0 is 0: nothing is left to learn.
#[test]
fn a_perfect_output_has_no_gradient() {
    let (gpu, architecture, adam) = (gpu(), tiny(), Adam::default());
    let weights = weights(&architecture);
    let mut batch = batch(&architecture, [2, 8, 8], "perfect");
    for family in families(gpu.info()) {
        batch.target = forward(&gpu, &weights, family, (Memory::Kept, Fusion::Activation), &batch.input);
        let mut step = step_for(&gpu, family, &weights, &batch, (adam, Loss::Mae));
        assert_eq!(take(&gpu, &mut step, &batch, &adam), 0.0);
        assert!(step.gradient().unwrap().iter().all(|g| *g == 0.0));
        require(family.name(), same_bits(&step.parameters.get().unwrap(), &weights.parameters));
    }
}
