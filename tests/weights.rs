//! Weights files: what is saved is loaded, and nothing else is.

use limpid::Error;
use limpid::net::architecture::{Architecture, Op, Row};
use limpid::net::reference;
use limpid::net::tensor::Tensor;
use limpid::net::weights::Weights;
use proptest::prelude::*;
use safetensors::{Dtype, tensor::TensorView};
use std::collections::HashMap;

const INPUT: Row = ("input", Op::Input { channels: 2 }, &[]);

fn small() -> Architecture {
    let conv = |cin, cout| Op::Conv { cin, cout, slope: Some(0.1) };
    Architecture::from_rows("small", &[INPUT, ("a", conv(2, 3), &["input"]), ("b", conv(3, 1), &["a"])]).unwrap()
}

/// A file with these tensors; the values are `f(name)` throughout.
fn file(tensors: &[(&str, Dtype, &[usize])], metadata: &[(&str, &str)], f: impl Fn(&str) -> f32) -> Vec<u8> {
    let data: Vec<Vec<u8>> = tensors
        .iter()
        .map(|(name, dtype, shape)| {
            let count = shape.iter().product::<usize>();
            if *dtype == Dtype::F32 {
                f(name).to_le_bytes().repeat(count)
            } else {
                vec![0; count * dtype.bitsize() / 8]
            }
        })
        .collect();
    let views = tensors
        .iter()
        .zip(&data)
        .map(|((name, dtype, shape), data)| (*name, TensorView::new(*dtype, shape.to_vec(), data).expect("sizes fit")));
    let metadata: HashMap<String, String> = metadata.iter().map(|(k, v)| (k.to_string(), v.to_string())).collect();
    safetensors::serialize(views, Some(metadata)).expect("a file")
}

/// The tensors of `small`.
const RIGHT: [(&str, Dtype, &[usize]); 4] = [
    ("a.weight", Dtype::F32, &[3, 2, 3, 3]),
    ("a.bias", Dtype::F32, &[3]),
    ("b.weight", Dtype::F32, &[1, 3, 3, 3]),
    ("b.bias", Dtype::F32, &[1]),
];
const NAMED: [(&str, &str); 1] = [("architecture", "small")];

/// The message of the input error that these bytes give.
#[track_caller]
fn message(bytes: &[u8]) -> String {
    match Weights::from_bytes(bytes, "w.safetensors", Some(&small())) {
        Err(Error::Input(message)) => message,
        other => panic!("not an input error: {other:?}"),
    }
}

#[track_caller]
fn says(message: &str, parts: &[&str]) {
    parts.iter().for_each(|part| assert!(message.contains(part), "`{message}` does not say `{part}`"));
}

#[test]
fn a_right_file_of_another_writer_loads() {
    let bytes = file(&RIGHT, &NAMED, |name| name.len() as f32);
    let weights = Weights::from_bytes(&bytes, "w", Some(&small())).unwrap();
    assert!(weights.tensor("a.bias").unwrap().iter().all(|&v| v == 6.0));
    assert!(weights.tensor("b.weight").unwrap().iter().all(|&v| v == 8.0));
    assert_eq!(weights.tensor("c.weight"), None);
}

#[test]
fn saved_weights_load_to_the_same_bits() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("w.safetensors");
    let mut weights = Weights::glorot(&Architecture::seed(), 3);
    weights.metadata.insert("losses".into(), "0.5 0.25 \"quoted\" \u{e9}".into());
    weights.metadata.insert("commit".into(), "abc".into());
    weights.save(&path).unwrap();
    assert_eq!(Weights::load(&path).unwrap(), weights);
    assert_eq!(Weights::load_as(&path, &Architecture::seed()).unwrap(), weights);
    assert_eq!(std::fs::read(&path).unwrap(), weights.to_bytes());
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1, "a temporary file stayed");
    // Overwriting is as atomic.
    let other = Weights::glorot(&Architecture::seed(), 4);
    other.save(&path).unwrap();
    assert_eq!(Weights::load(&path).unwrap(), other);
}

#[cfg(unix)]
#[test]
fn a_saved_file_is_as_readable_as_any_other() {
    use std::os::unix::fs::PermissionsExt;
    let directory = tempfile::tempdir().unwrap();
    let (ours, plain) = (directory.path().join("w.safetensors"), directory.path().join("plain"));
    Weights::glorot(&small(), 0).save(&ours).unwrap();
    std::fs::write(&plain, "").unwrap();
    let mode = |path| std::fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&ours), mode(&plain));
}

#[test]
fn the_bytes_are_a_file_that_the_crate_reads() {
    let weights = Weights::glorot(&small(), 3);
    let bytes = weights.to_bytes();
    let read = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    assert_eq!(read.len(), 4);
    for spec in small().tensors() {
        let view = read.tensor(&spec.name).unwrap();
        assert_eq!((view.dtype(), view.shape()), (Dtype::F32, &spec.shape[..]));
        let values: Vec<u8> = weights.parameters[spec.range].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(view.data(), values);
    }
    assert_eq!(bytes, weights.clone().to_bytes());
}

/// Weights of a tensor with zero biases, uniform to `limit`: five standard errors of the mean (variance 1/3) and of the mean
/// square (variance 4/45) of a uniform variable.
fn require_uniform(name: &str, values: &[f32], limit: f64) {
    let moment = |power: i32| values.iter().map(|&v| (f64::from(v) / limit).powi(power)).sum::<f64>();
    let count = values.len() as f64;
    assert!(moment(1).abs() / count < 5.0 * (1.0 / 3.0 / count).sqrt(), "{name}");
    assert!((moment(2) / count - 1.0 / 3.0).abs() < 5.0 * (4.0 / 45.0 / count).sqrt(), "{name}");
    assert!(values.iter().all(|&v| f64::from(v).abs() <= limit * (1.0 + 1e-7)), "{name}");
}

#[test]
fn random_weights_are_uniform_within_their_limit_and_differ_by_seed_and_tensor() {
    type Make = fn(&Architecture, u64) -> Weights;
    let glorot = |cin: usize, cout: usize, _: bool| 6.0 / (cin + cout) as f64;
    let he = |cin: usize, _: usize, last: bool| if last { 3.0 } else { 6.0 / (1.0 + 0.1f64.powi(2)) } / cin as f64;
    let seed = Architecture::seed();
    for (make, square) in [
        (Weights::glorot as Make, &glorot as &dyn Fn(usize, usize, bool) -> f64),
        (Weights::initial as Make, &he as &dyn Fn(usize, usize, bool) -> f64),
    ] {
        let weights = make(&seed, 1);
        assert_eq!(weights, make(&seed, 1));
        for spec in seed.tensors() {
            let values = &weights.parameters[spec.range.clone()];
            let [cout, cin, ..] = spec.shape[..] else {
                assert!(values.iter().all(|&v| v == 0.0), "{}", spec.name);
                continue;
            };
            require_uniform(&spec.name, values, (square(cin, cout, spec.name == "out_conv.weight") / 9.0).sqrt());
            assert_ne!(values, &make(&seed, 2).parameters[spec.range], "{}", spec.name);
        }
        // Tensors of one shape have their own streams.
        let scale = |name: &str| weights.tensor(name).unwrap()[..8].to_vec();
        assert_ne!(scale("dec_conv2b.weight"), scale("enc_conv1b.weight"));
    }
}

/// A `base` whose every parameter is divided by its scale is the same function of radiance in units four times as large:
/// powers of two, so to the bit.
#[test]
fn parameter_scales_of_base_count_radiance_in_larger_units() {
    let architecture = Architecture::named("base:16,32,16,32,48,48,32,16,48,48,16").unwrap();
    let scales: Vec<f64> = architecture.parameter_scales().iter().copied().map(f64::from).collect();
    let parameters = Weights::glorot(&architecture, 5).to_f64();
    let unscaled: Vec<f64> = parameters.iter().zip(&scales).map(|(p, s)| p / s).collect();
    let input = Tensor::<f32>::uniform([1, 9, 16, 32], 3).to_f64();
    let mut larger = input.clone();
    larger.data[..3 * 16 * 32].iter_mut().for_each(|v| *v *= 4.0);
    let output = reference::forward(&architecture, &parameters, &input).pop().unwrap();
    let expected = reference::forward(&architecture, &unscaled, &larger).pop().unwrap();
    assert_eq!(output.data.iter().map(|v| v * 4.0).collect::<Vec<_>>(), expected.data);
    assert_eq!(Architecture::seed().parameter_scales(), vec![1.0; Architecture::seed().parameter_count()]);
}

#[test]
fn a_missing_tensor_is_named() {
    for (missing, (name, _, shape)) in RIGHT.into_iter().enumerate() {
        let left: Vec<_> = RIGHT.iter().copied().enumerate().filter(|(i, _)| *i != missing).map(|(_, t)| t).collect();
        let text = message(&file(&left, &NAMED, |_| 1.0));
        says(&text, &["w.safetensors", name, &format!("expected F32 {shape:?}"), "found none"]);
    }
}

#[test]
fn an_extra_tensor_is_named() {
    let mut tensors = RIGHT.to_vec();
    tensors.push(("c.weight", Dtype::F32, &[4, 1, 3, 3]));
    says(&message(&file(&tensors, &NAMED, |_| 1.0)), &["w.safetensors", "`c.weight`", "expected none", "[4, 1, 3, 3]"]);
}

#[test]
fn a_mis_shaped_tensor_is_named() {
    for shape in [&[2, 3, 3, 3][..], &[3, 2, 9], &[54], &[3, 2, 5, 5], &[0, 2, 3, 3]] {
        let mut tensors = RIGHT;
        tensors[0].2 = shape;
        let text = message(&file(&tensors, &NAMED, |_| 1.0));
        says(&text, &["w.safetensors", "`a.weight`", "expected F32 [3, 2, 3, 3]", &format!("found F32 {shape:?}")]);
    }
}

#[test]
fn a_tensor_of_another_type_is_named() {
    for dtype in [Dtype::F16, Dtype::BF16, Dtype::F64, Dtype::I32] {
        let mut tensors = RIGHT;
        tensors[1].1 = dtype;
        let text = message(&file(&tensors, &NAMED, |_| 1.0));
        says(&text, &["w.safetensors", "`a.bias`", "expected F32 [3]", &format!("found {dtype:?} [3]")]);
    }
}

#[test]
fn a_value_that_is_not_finite_is_named() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let text = message(&file(&RIGHT, &NAMED, |name| if name == "b.bias" { bad } else { 1.0 }));
        says(&text, &["w.safetensors", "`b.bias`", "expected F32 [1]", "at index 0", "finite"]);
    }
}

#[test]
fn another_architecture_is_named() {
    says(&message(&file(&RIGHT, &[("architecture", "base")], |_| 1.0)), &["w.safetensors", "expected small", "`base`"]);
    says(&message(&file(&RIGHT, &[], |_| 1.0)), &["w.safetensors", "architecture", "small"]);
    // Without an expectation, any known one will do, and `small` is not known.
    let error = Weights::from_bytes(&file(&RIGHT, &NAMED, |_| 1.0), "w", None).unwrap_err();
    says(&error.to_string(), &["expected seed", "`small`"]);
}

#[test]
fn truncated_and_foreign_files_are_input_errors() {
    let bytes = Weights::glorot(&small(), 3).to_bytes();
    for length in 0..bytes.len() {
        says(&message(&bytes[..length]), &["w.safetensors"]);
    }
    let mut longer = bytes.clone();
    longer.push(0);
    says(&message(&longer), &["w.safetensors"]);
    says(&message(b"\x89PNG\r\n\x1a\n0123456789"), &["w.safetensors", "not a whole safetensors file"]);
    says(&message(&[0xff; 64]), &["w.safetensors"]);
}

#[test]
fn files_that_cannot_be_read_or_written_are_named() {
    let directory = tempfile::tempdir().unwrap();
    let missing = directory.path().join("none/w.safetensors");
    let error = Weights::load(&missing).unwrap_err();
    assert!(error.to_string().contains("none/w.safetensors") && error.exit_code() == 2, "{error}");
    assert!(Weights::load(directory.path()).is_err());
    let error = Weights::glorot(&small(), 0).save(&missing).unwrap_err();
    assert!(error.to_string().contains("none/w.safetensors"), "{error}");
    // A directory stands where the file should go: nothing half-written stays.
    assert!(Weights::glorot(&small(), 0).save(directory.path()).is_err());
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever happens to a file, it loads to finite weights or gives an input error.
    #[test]
    fn a_damaged_file_never_panics(
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
        in_header in any::<bool>(),
    ) {
        let mut bytes = Weights::glorot(&small(), 3).to_bytes();
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().expect("8 bytes")) as usize;
        for (index, value) in flips {
            let i = index.index(if in_header { header } else { bytes.len() });
            bytes[i] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        match Weights::from_bytes(&bytes, "w.safetensors", Some(&small())) {
            Ok(weights) => {
                prop_assert_eq!(weights.parameters.len(), small().parameter_count());
                prop_assert!(weights.parameters.iter().all(|v| v.is_finite()));
            }
            Err(Error::Input(message)) => prop_assert!(message.contains("w.safetensors")),
            Err(other) => prop_assert!(false, "{}", other),
        }
    }
}
