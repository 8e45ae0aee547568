//! The golden files, and the inputs and parameters that belong to them.
#![allow(dead_code)]

use limpid::net::architecture::Architecture;
use limpid::net::tensor::{Tensor, seed_of, uniform};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use std::collections::BTreeMap;
use std::path::Path;

/// A golden file, `layers` or `networks`: its tensors in double precision.
pub fn read(stem: &str) -> BTreeMap<String, Vec<f64>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(format!("{stem}.safetensors"));
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let file = SafeTensors::deserialize(&bytes).expect("a whole file");
    let values = |view: TensorView| match view.dtype() {
        Dtype::F64 => view.data().as_chunks::<8>().0.iter().map(|&b| f64::from_le_bytes(b)).collect(),
        Dtype::F32 => view.data().as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b).into()).collect(),
        other => panic!("{other:?} in {}", path.display()),
    };
    file.tensors().into_iter().map(|(name, view)| (name, values(view))).collect()
}

/// The flat parameter vector of the goldens' networks: weights uniform within Glorot's limit, biases within 0.1.
pub fn parameters(architecture: &Architecture) -> Vec<f32> {
    let mut parameters = vec![0.0; architecture.parameter_count()];
    for spec in architecture.tensors() {
        let limit = match spec.shape[..] {
            [cout, cin, ..] => (6.0 / (9 * (cin + cout)) as f64).sqrt(),
            _ => 0.1,
        };
        let stream = seed_of(&format!("golden/{}", spec.name));
        for (i, value) in parameters[spec.range].iter_mut().enumerate() {
            *value = (limit * (2.0 * uniform(stream, i as u64) - 1.0)) as f32;
        }
    }
    parameters
}

/// The tensor that a golden draws under that name.
pub fn drawn(shape: [usize; 4], name: &str) -> Tensor<f32> {
    Tensor::uniform(shape, seed_of(name))
}

/// The input of a network, drawn under that name. For `kpn` nothing is negative, as no albedo is, and the last rows and columns lie past
/// the picture's end.
pub fn network_input(architecture: &Architecture, [batch, height, width]: [usize; 3], name: &str) -> Tensor<f32> {
    let mut input = drawn([batch, architecture.input_channels(), height, width], name);
    if architecture.name() == "kpn" {
        for (i, value) in input.data.iter_mut().enumerate() {
            let (y, x) = (i / width % height, i % width);
            *value = if y + 5 >= height || x + 3 >= width { 0.0 } else { value.abs() };
        }
    }
    input
}

/// The stem of a network's golden keys: `STEM/input` and `STEM/target` name its drawn tensors, `STEM/output` its output.
pub fn network_case(architecture: &Architecture, [batch, height, width]: [usize; 3]) -> String {
    format!("{}_n{batch}_h{height}_w{width}", architecture.name())
}
