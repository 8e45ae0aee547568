//! Checkpoints: parameters, Adam's moments and the run's state in one safetensors file.

use super::loss_scale::State;
use super::run::RunState;
use super::step::Moments;
use crate::image::file::write_bytes;
use crate::net::weights::Weights;
use crate::{Error, Result};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use std::collections::HashMap;
use std::path::Path;

const STATE: &str = "limpid.train";
/// The loss scale, where the kernels have one.
const LOSS_SCALE: &str = "limpid.loss_scale";
const PARTS: [&str; 3] = ["parameters", "mean", "mean_square"];

/// Writes a checkpoint; the file is replaced at once or not at all.
pub fn save(path: &Path, state: &RunState, weights: &Weights, moments: &Moments) -> Result<()> {
    let parts = [&weights.parameters, &moments.mean, &moments.mean_square];
    let mut views = Vec::new();
    for (name, values) in PARTS.into_iter().zip(parts) {
        let view = TensorView::new(Dtype::F32, vec![values.len()], bytemuck::cast_slice(values));
        views.push((name, view.map_err(|e| Error::input(format!("{}: {e}", path.display())))?));
    }
    let bad = |e: serde_json::Error| Error::input(format!("{}: {e}", path.display()));
    let mut metadata = HashMap::from([(STATE.to_owned(), serde_json::to_string(state).map_err(bad)?)]);
    if let Some(scale) = moments.loss_scale {
        metadata.insert(LOSS_SCALE.to_owned(), serde_json::to_string(&scale).map_err(bad)?);
    }
    let bytes =
        safetensors::serialize(views, Some(metadata)).map_err(|e| Error::input(format!("{}: {e}", path.display())))?;
    write_bytes(path, &bytes)
}

/// Reads a checkpoint: the run's state, the parameters, the moments.
pub fn load(path: &Path) -> Result<(RunState, Vec<f32>, Moments)> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    let bad = |what: String| Error::input(format!("{}: no checkpoint of limpid ({what})", path.display()));
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| bad(e.to_string()))?;
    let tensors = SafeTensors::deserialize(&bytes).map_err(|e| bad(e.to_string()))?;
    let text = |key| header.metadata().as_ref().and_then(|m| m.get(key));
    let json = text(STATE).ok_or_else(|| bad("it has no state".into()))?;
    let loss_scale: Option<State> =
        text(LOSS_SCALE).map(|json| serde_json::from_str(json).map_err(|e| bad(e.to_string()))).transpose()?;
    let state: RunState = serde_json::from_str(json).map_err(|e| bad(e.to_string()))?;
    if loss_scale.is_some_and(|s| !s.is_valid()) {
        return Err(bad(format!("`{LOSS_SCALE}` is no power of two from 1")));
    }
    let count = crate::net::architecture::Architecture::named(&state.architecture)?.parameter_count();
    let mut parts = Vec::new();
    for name in PARTS {
        let view = tensors.tensor(name).map_err(|e| bad(e.to_string()))?;
        if view.dtype() != Dtype::F32 || view.shape() != [count] {
            return Err(bad(format!("`{name}`: expected {count} f32, found {:?} {:?}", view.shape(), view.dtype())));
        }
        let values: Vec<f32> = bytemuck::pod_collect_to_vec(view.data());
        if values.iter().any(|v| !v.is_finite()) {
            return Err(bad(format!("`{name}` is not finite")));
        }
        parts.push(values);
    }
    let [parameters, mean, mean_square]: [Vec<f32>; 3] = parts.try_into().expect("three parts");
    Ok((state.clone(), parameters, Moments { step: state.step, mean, mean_square, loss_scale }))
}
