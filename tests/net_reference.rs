//! The references against PyTorch in float64, and their gradients against central differences.

#[path = "common/compare.rs"]
mod compare;
#[path = "common/goldens.rs"]
mod goldens;

use compare::{close, relative_l2, require, tensors_close};
use limpid::net::architecture::{Architecture, Op, Row};
use limpid::net::base::Widths;
use limpid::net::layer::{Case, Kind, Pattern, cases};
use limpid::net::reference::{backward, forward};
use limpid::net::tensor::{Tensor, uniform};
use limpid::train::adam::{Adam, ReferenceState};
use limpid::train::loss::Loss;
use limpid::train::reference as training;
use std::collections::{BTreeMap, BTreeSet};

/// Both sides compute in float64 from equal numbers; only the order of their sums differs.
const PYTORCH_RTOL: f64 = 1e-6;
/// For values that cancel to nearly nothing: those compared here are of the order 1e-6 and larger.
const PYTORCH_ATOL: f64 = 1e-12;

#[track_caller]
fn pytorch(what: &str, actual: &[f64], expected: &[f64]) {
    require(what, close(actual, expected, PYTORCH_ATOL, PYTORCH_RTOL));
}

#[test]
fn layers_match_pytorch() {
    let goldens = goldens::read("layers");
    let names: BTreeSet<&str> = goldens.keys().map(|key| key.split('/').next().unwrap()).collect();
    let table: BTreeMap<String, Case> = cases().into_iter().map(|case| (case.name.clone(), case)).collect();
    for &kind in Kind::ALL {
        let count = names.iter().filter(|name| name.starts_with(kind.name())).count();
        assert!(count >= 3, "{} goldens of {}", count, kind.name());
    }
    for name in names {
        let case = table.get(name).unwrap_or_else(|| panic!("{name} is not in the case table"));
        let golden = |part: &str| &goldens[&format!("{name}/{part}")];
        let (data, to_f64) = (case.data(), |values: &[f32]| values.iter().map(|&v| v.into()).collect::<Vec<f64>>());
        // The same inputs, bit for bit.
        let mut drawn = vec![("output_gradient", &data.output_gradient.data)];
        drawn.extend(["input0", "input1"].into_iter().zip(data.inputs.iter().map(|t| &t.data)));
        if case.kind == Kind::Conv2d {
            drawn.extend([("weight", &data.weight.data), ("bias", &data.bias)]);
        }
        for (part, values) in drawn {
            assert_eq!(&to_f64(values), golden(part), "{name}/{part}");
        }
        let gradients = case.reference_backward(&data);
        pytorch(name, &case.reference(&data).data, golden("output"));
        for (i, gradient) in gradients.inputs.iter().enumerate() {
            pytorch(name, &gradient.data, golden(&format!("input{i}.gradient")));
        }
        if case.kind == Kind::Conv2d {
            pytorch(name, &gradients.weight.data, golden("weight.gradient"));
            pytorch(name, &gradients.bias, golden("bias.gradient"));
        }
    }
}

/// The goldens' parameters in double precision.
fn golden_parameters(architecture: &Architecture) -> Vec<f64> {
    goldens::parameters(architecture).into_iter().map(f64::from).collect()
}

fn drawn(shape: [usize; 4], name: &str) -> Tensor<f64> {
    goldens::drawn(shape, name).to_f64()
}

/// A made-up network of three convolutions with one skip: 2 channels in, 2 out.
fn tiny() -> Architecture {
    const CONV: fn(usize, usize) -> Op = |cin, cout| Op::Conv { cin, cout, slope: Some(0.1) };
    let rows: &[Row] = &[
        ("input", Op::Input { channels: 2 }, &[]),
        ("enc", CONV(2, 3), &["input"]),
        ("pool", Op::MaxPool, &["enc"]),
        ("middle", CONV(3, 4), &["pool"]),
        ("upsample", Op::Upsample, &["middle"]),
        ("concat", Op::Concat, &["upsample", "enc"]),
        ("out", Op::Conv { cin: 7, cout: 2, slope: None }, &["concat"]),
    ];
    Architecture::from_rows("tiny", rows).unwrap()
}

fn network_matches_pytorch(architecture: &Architecture, [batch, height, width]: [usize; 3]) {
    let goldens = goldens::read("networks");
    let case = goldens::network_case(architecture, [batch, height, width]);
    let golden = |part: &str| &goldens[&format!("{case}/{part}")][..];
    let what = |part: &str| format!("{case}/{part}");
    let parameters = golden_parameters(architecture);
    let input = goldens::network_input(architecture, [batch, height, width], &what("input")).to_f64();
    let values = forward(architecture, &parameters, &input);
    let output = values.last().unwrap();
    pytorch(&what("output"), &output.data, golden("output"));
    let target = drawn(output.shape, &what("target"));
    pytorch(&what("loss"), &[Loss::Mae.reference(output, &target)], golden("loss"));
    let gradients = backward(architecture, &parameters, &values, &Loss::Mae.reference_backward(output, &target));
    let mut parts: Vec<(String, &[f64])> =
        architecture.tensors().into_iter().map(|spec| (spec.name, &gradients.parameters[spec.range])).collect();
    parts.push(("input".into(), &gradients.values[0].data));
    for (name, gradient) in parts {
        let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        pytorch(&what(&name), &[norm], golden(&format!("{name}.norm")));
        let count = gradient.len();
        let ends = if count <= 128 { gradient.to_vec() } else { [&gradient[..32], &gradient[count - 32..]].concat() };
        // The sums cancel: absolute errors are of the order of the whole gradient's elements.
        let atol = PYTORCH_RTOL * norm / (count as f64).sqrt();
        require(&what(&name), close(&ends, golden(&format!("{name}.ends")), atol, PYTORCH_RTOL));
    }
}

#[test]
fn networks_match_pytorch() {
    network_matches_pytorch(&Architecture::seed(), [1, 32, 32]);
    network_matches_pytorch(&Architecture::seed(), [2, 64, 32]);
    network_matches_pytorch(&tiny(), [3, 6, 4]);
    // Their widths are those of `make_goldens.py`.
    let widths = Widths::from_array([16, 32, 16, 32, 48, 48, 32, 16, 48, 48, 16]);
    for architecture in [Architecture::base(&widths).unwrap(), Architecture::kpn(&widths).unwrap()] {
        network_matches_pytorch(&architecture, [1, 32, 32]);
        network_matches_pytorch(&architecture, [2, 48, 16]);
    }
}

#[test]
fn three_steps_match_pytorch_adam() {
    let goldens = goldens::read("networks");
    // The epsilon of `make_goldens.py`.
    let (architecture, adam) = (tiny(), Adam { epsilon: 1e-7, ..Adam::default() });
    let mut parameters = golden_parameters(&architecture);
    let mut state = ReferenceState::new(&architecture.parameter_scales());
    for step in 0..3 {
        let input = drawn([2, 2, 6, 4], &format!("adam/{step}/input"));
        let target = drawn([2, 2, 6, 4], &format!("adam/{step}/target"));
        let before = parameters.clone();
        let loss = training::step((&architecture, Loss::Mae), &adam, &mut state, &mut parameters, &input, &target);
        pytorch("loss", &[loss], &goldens["adam/losses"][step..=step]);
        let expected = &goldens[&format!("adam/{step}/parameters")];
        pytorch("parameters", &parameters, expected);
        // The parameters hardly move: the steps themselves must match too.
        let change = |after: &[f64]| after.iter().zip(&before).map(|(a, b)| a - b).collect::<Vec<_>>();
        let error = relative_l2(&change(&parameters), &change(expected)).unwrap();
        assert!(error < PYTORCH_RTOL, "step {step}: {error:e}");
    }
    assert_eq!(state.step, 3);
}

/// `f` is smooth about 0 but for rounding: its slope by central differences, error of order `h²` and `1e-16 / h`.
fn slope(f: impl Fn(f64) -> f64) -> f64 {
    let h = 1e-5;
    (f(h) - f(-h)) / (2.0 * h)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `values` moved by `h` along `direction`.
fn moved(values: &[f64], direction: &[f64], h: f64) -> Vec<f64> {
    values.iter().zip(direction).map(|(v, d)| v + h * d).collect()
}

/// Every gradient of every layer, in three directions and element by element, on its small random rows.
#[test]
fn layer_gradients_match_central_differences() {
    let mut checked = BTreeMap::new();
    for case in cases() {
        let data = case.data();
        let elements = data.inputs.iter().map(Tensor::len).sum::<usize>() + data.weight.len();
        if case.pattern != Pattern::Random || elements > 600 {
            continue;
        }
        *checked.entry(case.kind).or_insert(0) += 1;
        let (dy, gradients) = (data.output_gradient.to_f64(), case.reference_backward(&data));
        let flat_gradient = [
            gradients.inputs.iter().flat_map(|g| g.data.clone()).collect::<Vec<_>>(),
            gradients.weight.data.clone(),
            gradients.bias.clone(),
        ]
        .concat();
        for (i, &gradient) in flat_gradient.iter().enumerate() {
            let f = |h: f64| dot(&reference_in_f64(&case, i, h).data, &dy.data);
            let difference = slope(f);
            // Linear in each element but for kinks, which no element of these rows is near.
            require(&format!("{} {i}", case.name), close(&[gradient], &[difference], 1e-8, 1e-7));
        }
    }
    Kind::ALL.iter().for_each(|kind| assert!(checked[kind] >= 2, "{} rows of {}", checked[kind], kind.name()));
}

/// The output of a case with `h` added to element `i` of its inputs, weights and biases in that order.
fn reference_in_f64(case: &Case, i: usize, h: f64) -> Tensor<f64> {
    use limpid::net::layer::{concat, conv2d, leaky_relu, max_pool2d, upsample2d};
    let data = case.data();
    let mut parts: Vec<Tensor<f64>> = data.inputs.iter().map(Tensor::to_f64).collect();
    parts.push(data.weight.to_f64());
    parts.push(Tensor::new([1, 1, 1, data.bias.len()], data.bias.iter().map(|&b| b.into()).collect()));
    let mut left = i;
    for part in &mut parts {
        if left < part.len() {
            part.data[left] += h;
            break;
        }
        left -= part.len();
    }
    match case.kind {
        Kind::Conv2d => conv2d::reference(&parts[0], &parts[1], &parts[2].data),
        Kind::LeakyRelu => leaky_relu::reference(&parts[0], case.slope.into()),
        Kind::MaxPool2d => max_pool2d::reference(&parts[0]),
        Kind::Upsample2d => upsample2d::reference(&parts[0]),
        Kind::Concat => concat::reference(&parts[0], &parts[1]),
    }
}

#[test]
fn network_gradients_match_central_differences() {
    let architecture = tiny();
    let parameters = golden_parameters(&architecture);
    let (input, target) = (drawn([2, 2, 6, 4], "differences/input"), drawn([2, 2, 6, 4], "differences/target"));
    for loss in Loss::ALL {
        let (_, gradient) = training::gradient((&architecture, loss), &parameters, &input, &target);
        let loss_at = |parameters: &[f64], input: &Tensor<f64>| {
            loss.reference(forward(&architecture, parameters, input).last().unwrap(), &target)
        };
        assert_eq!(
            loss_at(&parameters, &input),
            training::gradient((&architecture, loss), &parameters, &input, &target).0
        );
        let differences: Vec<f64> = (0..parameters.len())
            .map(|i| {
                let unit: Vec<f64> = (0..parameters.len()).map(|j| f64::from(u8::from(i == j))).collect();
                slope(|h| loss_at(&moved(&parameters, &unit, h), &input))
            })
            .collect();
        require("parameters", close(&gradient, &differences, 1e-9, 1e-6));
        let values = forward(&architecture, &parameters, &input);
        let output_gradient = loss.reference_backward(values.last().unwrap(), &target);
        let input_gradient = &backward(&architecture, &parameters, &values, &output_gradient).values[0];
        let differences = (0..input.len())
            .map(|i| {
                let unit: Vec<f64> = (0..input.len()).map(|j| f64::from(u8::from(i == j))).collect();
                slope(|h| loss_at(&parameters, &Tensor::new(input.shape, moved(&input.data, &unit, h))))
            })
            .collect();
        let differences = Tensor::new(input.shape, differences);
        require("input", tensors_close(input_gradient, &differences, 1e-9, 1e-6));
    }
}

#[test]
fn losses_and_their_gradients_by_hand() {
    let output = Tensor::new([1, 1, 2, 2], vec![1.0, -2.0, 0.5, 0.0]);
    let target = Tensor::new([1, 1, 2, 2], vec![0.0, 0.0, 0.5, 4.0]);
    assert_eq!(Loss::Mae.reference(&output, &target), 7.0 / 4.0);
    assert_eq!(Loss::Mae.reference_backward(&output, &target).data, [0.25, -0.25, 0.0, -0.25]);
    // The four errors, 1, -2, 0 and -4, make -5 at the other four scales.
    assert_eq!(Loss::Multiscale.reference(&output, &target), (7.0 + 4.0 * 5.0) / 20.0);
    assert_eq!(Loss::Multiscale.reference_backward(&output, &target).data, [-0.15, -0.25, -0.2, -0.25]);
    // Squares that the edge cuts: 2 pixels of 1 to the left, 1 of -3 to the right at scale 1.
    let output = Tensor::new([1, 1, 1, 3], vec![1.0, 1.0, -3.0]);
    let target = Tensor::new([1, 1, 1, 3], vec![0.0; 3]);
    assert_eq!(Loss::Multiscale.reference(&output, &target), (5.0 + 5.0 + 3.0 * 1.0) / 15.0);
}

#[test]
fn a_first_maximum_takes_the_gradient() {
    use limpid::net::layer::max_pool2d;
    let input = Tensor::new([1, 1, 2, 5], vec![1.0, 1.0, 0.0, 2.0, 9.0, 1.0, 1.0, 2.0, 2.0, 9.0]);
    assert_eq!(max_pool2d::reference(&input).data, [1.0, 2.0]);
    let gradient = max_pool2d::reference_backward(&input, &Tensor::new([1, 1, 1, 2], vec![5.0, 7.0]));
    assert_eq!(gradient.data, [5.0, 0.0, 0.0, 7.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
}

/// The part of `image` that begins at (top, left), of the size of `height` x `width`.
fn crop(image: &Tensor<f64>, [top, left, height, width]: [usize; 4]) -> Tensor<f64> {
    let [batch, channels, ..] = image.shape;
    let mut part = Tensor::zeros([batch, channels, height, width]);
    for i in 0..part.len() {
        let (x, y, plane) = (i % width, i / width % height, i / (width * height));
        part.data[i] = image.at(plane / channels, plane % channels, top + y, left + x);
    }
    part
}

/// With the overlap that the architecture states, the core of a tile has the bits of the whole frame; with one step of the
/// grid less it has not.
#[test]
fn the_tile_overlap_is_exact() {
    // Two pools deep, so that the overlap spans several steps of the grid.
    let conv = |cin, cout| Op::Conv { cin, cout, slope: Some(0.1) };
    let rows: &[Row] = &[
        ("input", Op::Input { channels: 1 }, &[]),
        ("a", conv(1, 2), &["input"]),
        ("pool1", Op::MaxPool, &["a"]),
        ("b", conv(2, 2), &["pool1"]),
        ("pool2", Op::MaxPool, &["b"]),
        ("c", conv(2, 2), &["pool2"]),
        ("up2", Op::Upsample, &["c"]),
        ("d", conv(2, 2), &["up2"]),
        ("up1", Op::Upsample, &["d"]),
        ("cat", Op::Concat, &["up1", "a"]),
        ("out", conv(4, 1), &["cat"]),
    ];
    let architecture = Architecture::from_rows("deep", rows).unwrap();
    let (core, overlap, grid) = (8, architecture.tile_overlap(), architecture.alignment());
    assert_eq!(grid, 4);
    // Weights without cancelling, so that whatever a tile lacks shows.
    let parameters: Vec<f64> = (0..architecture.parameter_count() as u64).map(|i| 0.1 + uniform(1, i)).collect();
    let size = core + 4 * overlap;
    let (mut exact, mut short) = (0, 0);
    // Several images: in some of them max pooling selects the elements that reach farthest.
    for seed in 0..8 {
        let image = Tensor::uniform([1, 1, size, size], seed).to_f64();
        let start = 2 * overlap;
        let whole = crop(forward(&architecture, &parameters, &image).last().unwrap(), [start, start, core, core]);
        let tiled = |overlap: usize| {
            let tile = crop(&image, [start - overlap, start - overlap, core + 2 * overlap, core + 2 * overlap]);
            crop(forward(&architecture, &parameters, &tile).last().unwrap(), [overlap, overlap, core, core])
        };
        exact += usize::from(tiled(overlap) == whole);
        short += usize::from(tiled(overlap - grid) == whole);
    }
    assert_eq!(exact, 8, "with an overlap of {overlap}");
    assert!(short < 8, "an overlap of {} would do", overlap - grid);
}
