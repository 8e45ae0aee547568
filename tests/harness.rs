//! The comparators first: fed with known defects, they must fail.

#[path = "common/compare.rs"]
mod compare;

use compare::{close, different, l2_close, relative_l2, same_bits, tensors_close, tensors_within, within};
use limpid::net::layer::{Case, Kind, Pattern, cases};
use limpid::net::tensor::Tensor;

/// A 1x1x5x5 image.
fn image() -> Tensor<f32> {
    Tensor::uniform([1, 1, 5, 5], 7)
}

/// All comparators of values, each allowed an error of 1e-3.
fn all(actual: &Tensor<f32>, expected: &Tensor<f32>) -> Vec<(&'static str, compare::Outcome)> {
    let bound = expected.map(|_| 1e-3);
    vec![
        ("close", close(&actual.data, &expected.data, 1e-3, 0.0)),
        ("close, relative", close(&actual.data, &expected.data, 1e-5, 1e-3)),
        ("within", within(&actual.data, &expected.data, &bound.data)),
        ("tensors_close", tensors_close(actual, expected, 1e-3, 0.0)),
        ("tensors_within", tensors_within(actual, expected, &bound)),
        ("same_bits", same_bits(&actual.data, &expected.data)),
        ("l2_close", l2_close(&actual.data, &expected.data, 1e-3)),
    ]
}

fn all_pass(actual: &Tensor<f32>, expected: &Tensor<f32>) {
    all(actual, expected).into_iter().for_each(|(name, outcome)| assert!(outcome.is_ok(), "{name}: {outcome:?}"));
}

fn all_fail(actual: &Tensor<f32>, expected: &Tensor<f32>) {
    all(actual, expected).into_iter().for_each(|(name, outcome)| assert!(outcome.is_err(), "{name} passed"));
}

#[test]
fn equal_images_pass() {
    all_pass(&image(), &image());
}

#[test]
fn one_wrong_element_fails() {
    for i in 0..25 {
        let mut wrong = image();
        wrong.data[i] += 0.01;
        all_fail(&wrong, &image());
    }
}

#[test]
fn nan_and_infinity_fail_on_either_side_and_on_both() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for i in [0, 12, 24] {
            let mut wrong = image();
            wrong.data[i] = bad;
            all_fail(&wrong, &image());
            all_fail(&image(), &wrong);
            all_fail(&wrong, &wrong);
        }
    }
}

#[test]
fn a_nan_or_infinite_bound_fails() {
    for bad in [f64::NAN, f64::INFINITY] {
        let (values, mut bound) = (image(), [1e-3; 25]);
        bound[3] = bad;
        assert!(within(&values.data, &values.data, &bound).is_err());
    }
    assert!(close(&image().data, &image().data, f64::NAN, 0.0).is_err());
    assert!(l2_close(&image().data, &image().data, f64::NAN).is_err());
}

#[test]
fn a_transposed_image_fails() {
    let mut transposed = image();
    for y in 0..5 {
        for x in 0..5 {
            let i = transposed.index(0, 0, y, x);
            transposed.data[i] = image().at(0, 0, x, y);
        }
    }
    all_fail(&transposed, &image());
}

#[test]
fn another_shape_of_the_same_data_fails() {
    let flat = Tensor::new([1, 1, 1, 25], image().data);
    assert!(tensors_close(&flat, &image(), 1e-3, 0.0).is_err());
    assert!(tensors_within(&flat, &image(), &image().map(|_| 1e-3)).is_err());
    assert!(tensors_within(&image(), &image(), &flat.map(|_| 1e-3)).is_err());
}

#[test]
fn another_length_fails() {
    let short = Tensor::new([1, 1, 4, 5], image().data[..20].to_vec());
    all_fail(&short, &image());
    all_fail(&image(), &short);
    assert!(within(&image().data, &image().data, &[1e-3; 24]).is_err());
}

#[test]
fn nothing_at_all_fails() {
    let nothing = Tensor::<f32>::zeros([0, 1, 5, 5]);
    all_fail(&nothing, &nothing);
    assert!(different(&nothing.data, &nothing.data, 0.0).is_err());
}

#[test]
fn a_negative_zero_has_other_bits() {
    assert!(same_bits(&[-0.0], &[0.0]).is_err());
    assert!(close(&[-0.0f32], &[0.0f32], 0.0, 0.0).is_ok());
}

#[test]
fn the_same_buffer_twice_is_not_different() {
    let other = Tensor::<f32>::uniform([1, 1, 5, 5], 8);
    assert!(different(&image().data, &image().data, 1e-6).is_err());
    assert!(different(&image().data, &other.data, 1e-6).is_ok());
    let mut nan = image();
    nan.data[0] = f32::NAN;
    assert!(different(&nan.data, &image().data, 1e-6).is_err(), "NaN is no difference that one may ask for");
}

#[test]
fn relative_l2_is_what_it_says() {
    assert_eq!(relative_l2(&[3.0, 5.0], &[3.0, 4.0]), Ok(0.2));
    assert!(relative_l2(&[1.0, 1.0], &[0.0, 0.0]).is_err());
}

/// The f32 sums of a convolution, in the order of its definition or the reverse.
fn conv2d_in_f32(case: &Case, reverse: bool) -> Tensor<f32> {
    let (data, mut output) = (case.data(), Tensor::<f32>::zeros(case.output_shape()));
    let (input, weight) = (&data.inputs[0], &data.weight);
    for i in 0..output.len() {
        let (x, y) = (i % case.width, i / case.width % case.height);
        let (o, n) = (i / (case.width * case.height) % case.cout, i / (case.width * case.height * case.cout));
        let mut sum = data.bias[o];
        for k in 0..case.cin * 9 {
            let k = if reverse { case.cin * 9 - 1 - k } else { k };
            let (c, ky, kx) = (k / 9, k % 9 / 3, k % 3);
            if (1..=case.height).contains(&(y + ky)) && (1..=case.width).contains(&(x + kx)) {
                sum += weight.at(o, c, ky, kx) * input.at(n, c, y + ky - 1, x + kx - 1);
            }
        }
        output.data[i] = sum;
    }
    output
}

/// The bound that device kernels are held to leaves room for f32 in any order, and for little else.
#[test]
fn the_convolution_bound_admits_f32_and_no_defect() {
    for case in cases().iter().filter(|c| c.kind == Kind::Conv2d && c.macs() < 4_000_000) {
        let (data, reference) = (case.data(), case.reference(&case.data()));
        let bound = case.bounds(&data).output;
        for reverse in [false, true] {
            let result = conv2d_in_f32(case, reverse);
            compare::require(&case.name, tensors_within(&result, &reference, &bound));
        }
        if case.pattern == Pattern::Random {
            let wrong = reference.map(|v| v * 1.0001);
            assert!(tensors_within(&wrong, &reference, &bound).is_err(), "{}: a scaled result passed", case.name);
        }
    }
}
