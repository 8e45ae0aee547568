//! TZA files: what is written is read, the bytes are those of the format, and nothing that is damaged panics.

use limpid::Error;
use limpid::net::architecture::Architecture;
use limpid::net::base::Widths;
use limpid::net::tza::{self, Precision};
use limpid::net::weights::Weights;
use proptest::prelude::*;

fn weights(widths: Widths) -> Weights {
    Weights::glorot(&Architecture::base(&widths).unwrap(), 7)
}

fn small() -> Weights {
    weights(Widths::from_array([16; 11]))
}

/// A tensor of a file that the tests write themselves: name, layout, type, shape, data.
struct Entry {
    name: String,
    layout: &'static [u8],
    dtype: u8,
    shape: Vec<u32>,
    data: Vec<u8>,
}

/// A file of these tensors, from the format's description: the table first, the data not aligned.
fn file(entries: &[Entry]) -> Vec<u8> {
    let table_bytes = entries.iter().map(|e| 2 + e.name.len() + 1 + 4 * e.shape.len() + e.layout.len() + 1 + 8);
    let mut data_at = 12 + 4 + table_bytes.sum::<usize>();
    let mut bytes = vec![0xd7, 0x41, 2, 0];
    bytes.extend(12u64.to_le_bytes());
    bytes.extend((entries.len() as u32).to_le_bytes());
    for e in entries {
        bytes.extend((e.name.len() as u16).to_le_bytes());
        bytes.extend(e.name.as_bytes());
        bytes.push(e.shape.len() as u8);
        e.shape.iter().for_each(|side| bytes.extend(side.to_le_bytes()));
        bytes.extend(e.layout);
        bytes.push(e.dtype);
        bytes.extend((data_at as u64).to_le_bytes());
        data_at += e.data.len();
    }
    entries.iter().for_each(|e| bytes.extend(&e.data));
    bytes
}

/// The tensors of weights, each value as `bytes_of` writes it.
fn entries(weights: &Weights, dtype: u8, bytes_of: impl Fn(f32) -> Vec<u8>) -> Vec<Entry> {
    let entry = |spec: limpid::net::architecture::TensorSpec| Entry {
        layout: if spec.shape.len() == 4 { b"oihw" } else { b"x" },
        dtype,
        shape: spec.shape.iter().map(|side| *side as u32).collect(),
        data: weights.parameters[spec.range].iter().flat_map(|v| bytes_of(*v)).collect(),
        name: spec.name,
    };
    weights.architecture.tensors().into_iter().map(entry).collect()
}

fn single(value: f32) -> Vec<u8> {
    value.to_le_bytes().to_vec()
}

/// The message of the input error that these bytes give.
#[track_caller]
fn message(bytes: &[u8]) -> String {
    match tza::from_bytes(bytes, "w.tza") {
        Err(Error::Input(message)) => {
            assert!(message.starts_with("w.tza: ") && message.lines().count() == 1, "{message}");
            message
        }
        other => panic!("not an input error: {other:?}"),
    }
}

#[test]
fn what_is_written_is_read_to_the_same_bits() {
    for widths in [Widths::default(), Widths::open_image_denoise(), Widths::from_array([16; 11])] {
        let mut weights = weights(widths);
        weights.parameters[5] = -0.0;
        weights.parameters[6] = f32::MIN_POSITIVE / 2.0;
        let bytes = tza::to_bytes(&weights, Precision::Single).unwrap();
        let read = tza::from_bytes(&bytes, "w.tza").unwrap();
        assert_eq!(read.architecture, weights.architecture);
        let bits = |weights: &Weights| weights.parameters.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert!(bits(&read) == bits(&weights));
        assert!(tza::to_bytes(&read, Precision::Single).unwrap() == bytes);
    }
}

/// Field by field, as Open Image Denoise reads it.
#[test]
fn the_bytes_are_those_of_the_format() {
    let weights = small();
    let bytes = tza::to_bytes(&weights, Precision::Single).unwrap();
    let number = |at: usize, count: usize| bytes[at..at + count].iter().rev().fold(0u64, |n, b| n << 8 | u64::from(*b));
    assert_eq!(bytes[..4], [0xd7, 0x41, 2, 0]);
    let mut at = number(4, 8) as usize;
    assert_eq!(at % 64, 0);
    let specs = weights.architecture.tensors();
    assert_eq!(number(at, 4), specs.len() as u64);
    at += 4;
    for spec in specs {
        let length = number(at, 2) as usize;
        assert_eq!(&bytes[at + 2..at + 2 + length], spec.name.as_bytes());
        at += 2 + length;
        let dimensions = number(at, 1) as usize;
        at += 1;
        let shape: Vec<usize> = (0..dimensions).map(|i| number(at + 4 * i, 4) as usize).collect();
        assert_eq!(shape, spec.shape, "{}", spec.name);
        at += 4 * dimensions;
        let layout: &[u8] = if dimensions == 4 { b"oihw" } else { b"x" };
        assert_eq!(&bytes[at..at + dimensions], layout, "{}", spec.name);
        assert_eq!(bytes[at + dimensions], b'f');
        let data = number(at + dimensions + 1, 8) as usize;
        assert_eq!(data % 64, 0, "{}", spec.name);
        let first = weights.parameters[spec.range.start].to_le_bytes();
        assert_eq!(bytes[data..data + 4], first, "{}", spec.name);
        at += dimensions + 9;
    }
    assert_eq!(at, bytes.len());
}

#[test]
fn a_file_of_another_writer_loads_and_half_precision_is_widened() {
    let weights = small();
    let read = tza::from_bytes(&file(&entries(&weights, b'f', single)), "w.tza").unwrap();
    assert!(read.parameters == weights.parameters);
    // 1.5, -2^-24 (the smallest subnormal), 65504 (the largest), 0.333251953125.
    let halves: [(u16, f32); 4] =
        [(0x3e00, 1.5), (0x8001, -(2f32.powi(-24))), (0x7bff, 65504.0), (0x3555, 0.333_251_95)];
    for (bits, expected) in halves {
        let bytes = file(&entries(&weights, b'h', |_| bits.to_le_bytes().to_vec()));
        let read = tza::from_bytes(&bytes, "w.tza").unwrap();
        assert!(read.parameters.iter().all(|v| *v == expected), "{bits:x}");
    }
}

/// Rounded to nearest, ties to even: at most half of fp16's spacing off, and what fp16 holds keeps its value.
#[test]
fn half_precision_is_the_nearest() {
    let mut weights = small();
    // 2049 lies between 2048 and 2050; 2051 between 2050 and 2052; 2^-25 between 0 and 2^-24.
    let pairs: [(f32, f32); 6] = [
        (2049.0, 2048.0),
        (2051.0, 2052.0),
        (65519.0, 65504.0),
        (2f32.powi(-25), 0.0),
        (-0.0, -0.0),
        (0.1, 0.099975586),
    ];
    pairs.iter().enumerate().for_each(|(i, (value, _))| weights.parameters[i] = *value);
    let bytes = tza::to_bytes(&weights, Precision::Half).unwrap();
    let read = tza::from_bytes(&bytes, "w.tza").unwrap();
    pairs
        .iter()
        .enumerate()
        .for_each(|(i, (_, half))| assert_eq!(read.parameters[i].to_bits(), half.to_bits(), "{half}"));
    for (half, value) in read.parameters.iter().zip(&weights.parameters).skip(pairs.len()) {
        assert!((half - value).abs() <= value.abs() / 2048.0 + 2f32.powi(-25), "{half} for {value}");
    }
    assert!(tza::to_bytes(&read, Precision::Half).unwrap() == bytes);
    weights.parameters[3] = 65520.0;
    let error = tza::to_bytes(&weights, Precision::Half).unwrap_err().to_string();
    assert!(error.contains("`enc_conv0.weight`: 65520 at index 3"), "{error}");
}

#[test]
fn what_does_not_fit_is_named() {
    let weights = small();
    let changed = |change: &dyn Fn(&mut Vec<Entry>)| {
        let mut list = entries(&weights, b'f', single);
        change(&mut list);
        message(&file(&list))
    };
    let find = |list: &[Entry], name: &str| list.iter().position(|e| e.name == name).unwrap();
    let says = |message: &str, parts: &[&str]| {
        parts.iter().for_each(|part| assert!(message.contains(part), "`{message}` does not say `{part}`"));
    };
    let text = changed(&|list| {
        // A skip of other width.
        let at = find(list, "dec_conv3a.weight");
        list[at].shape[1] = 48;
        list[at].data.resize(16 * 48 * 9 * 4, 0);
    });
    says(&text, &["`dec_conv3a.weight`", "expected F32 [16, 32, 3, 3]", "found F32 [16, 48, 3, 3]"]);
    says(&changed(&|list| drop(list.remove(0))), &["`enc_conv0.weight`", "none"]);
    says(&changed(&|list| drop(list.remove(1))), &["`enc_conv0.bias`", "none"]);
    says(&changed(&|list| list[0].name = "enc_conv1.weight".into()), &["two tensors", "`enc_conv1.weight`"]);
    says(&changed(&|list| list[0].name = "enc_conv1b.weight".into()), &["larger network", "`base`"]);
    says(&changed(&|list| list[0].name = "smell.weight".into()), &["`enc_conv0.weight`"]);
    says(&changed(&|list| list[0].layout = b"ohwi"), &["layout `ohwi`", "`oihw`"]);
    says(&changed(&|list| list[1].dtype = b'b'), &["type `b`", "`h` (fp16)"]);
    says(&changed(&|list| list[1].data[..4].copy_from_slice(&f32::NAN.to_le_bytes())), &["`enc_conv0.bias`", "finite"]);
    let text = changed(&|list| {
        let (bias, weight) = (find(list, "dec_conv1b.bias"), find(list, "dec_conv1b.weight"));
        (list[weight].shape[0], list[bias].shape[0]) = (20, 20);
        list[weight].data.resize(20 * 16 * 9 * 4, 0);
        list[bias].data.resize(20 * 4, 0);
    });
    says(&text, &["`dec_conv1b` has 20", "multiples of 16"]);
    let text = changed(&|list| {
        // For radiance alone.
        list[0].shape[1] = 3;
        list[0].data.truncate(16 * 3 * 9 * 4);
    });
    says(&text, &["`enc_conv0.weight`", "expected F32 [16, 9, 3, 3]", "found F32 [16, 3, 3, 3]"]);
    says(&message(b""), &["does not begin as a TZA file"]);
    says(&message(b"\x89PNG\r\n\x1a\n0123456789"), &["does not begin as a TZA file"]);
    let mut bytes = tza::to_bytes(&weights, Precision::Single).unwrap();
    bytes[2] = 1;
    says(&message(&bytes), &["version 1"]);
    bytes[2] = 2;
    bytes[4..12].fill(0xff);
    says(&message(&bytes), &["the table", "past the end"]);
    let error = tza::to_bytes(&Weights::glorot(&Architecture::seed(), 0), Precision::Single).unwrap_err().to_string();
    says(&error, &["`seed`", "`base`"]);
}

#[test]
fn every_truncation_is_an_input_error() {
    // The table lies at the end here, and at the beginning in the other.
    let (ours, other) = (tza::to_bytes(&small(), Precision::Single).unwrap(), file(&entries(&small(), b'f', single)));
    for bytes in [&ours, &other] {
        let lengths = (0..2000).chain((2000..bytes.len()).step_by(997)).chain(bytes.len() - 900..bytes.len());
        lengths.for_each(|length| drop(message(&bytes[..length])));
    }
}

/// A small file whose tensors all name the same bytes must not become a large one.
#[test]
fn tensors_that_share_their_bytes_are_refused() {
    let mut list = entries(&small(), b'f', single);
    list.extend((0..200).map(|i| Entry {
        name: format!("copy{i}.bias"),
        layout: b"x",
        dtype: b'f',
        shape: vec![10_000],
        data: vec![],
    }));
    assert!(message(&file(&list)).contains("larger than the file"));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever happens to a file, it loads to finite weights or gives an input error.
    #[test]
    fn a_damaged_file_never_panics(
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
        in_table in any::<bool>(),
    ) {
        let mut bytes = file(&entries(&small(), b'f', single));
        for (index, value) in flips {
            let i = index.index(if in_table { 1100 } else { bytes.len() });
            bytes[i] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        match tza::from_bytes(&bytes, "w.tza") {
            Ok(weights) => prop_assert!(weights.parameters.iter().all(|v| v.is_finite())),
            Err(Error::Input(message)) => prop_assert!(message.starts_with("w.tza: ")),
            Err(other) => prop_assert!(false, "{}", other),
        }
    }
}
