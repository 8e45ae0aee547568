//! Weights: safetensors files, their validation, and the initial weights of training.

use super::architecture::{Architecture, NAMES, Op, TensorSpec};
use super::base::Widths;
use super::tensor::{hash, seed_of, uniform};
use crate::image::file::write_bytes;
use crate::{Error, Result};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::Path;

/// The metadata key of the architecture's name; every weights file has it.
pub const ARCHITECTURE: &str = "architecture";

/// A larger file is no weights file: it is refused unread.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// The parameters of a network, and what is known of their making.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// The network.
    pub architecture: Architecture,
    /// The flat parameter vector of [`Architecture::tensors`], all finite.
    pub parameters: Vec<f32>,
    /// Strings kept in the file (inputs, transfer, training command, commit, losses ...), without the architecture's name.
    pub metadata: BTreeMap<String, String>,
}

impl Weights {
    /// Glorot-uniform weights and zero biases: element `i` of a tensor is `limit * (2 * uniform(s, i) - 1)` with
    /// `limit = sqrt(6 / (9 * (Cin + Cout)))` and `s = hash(seed, seed_of(NAME))`. Always the same for a seed.
    pub fn glorot(architecture: &Architecture, seed: u64) -> Self {
        Self::uniform(architecture, seed, |cin, cout, _| 6.0 / (cin + cout) as f64)
    }

    /// What training begins with: He-uniform weights, which keep the size of the activations from layer to layer (He et al.
    /// 2015): the limit is `sqrt(6 / (9 * Cin * (1 + slope^2)))`, in linear layers `sqrt(3 / (9 * Cin))`. Smaller ones let the
    /// deep layers of `base` go silent. All of it in the units of [`Architecture::parameter_scales`].
    #[must_use]
    pub fn initial(architecture: &Architecture, seed: u64) -> Self {
        let mut weights = Self::uniform(architecture, seed, |cin, _, slope| match slope {
            Some(slope) => 6.0 / (cin as f64 * (1.0 + f64::from(slope).powi(2))),
            None => 3.0 / cin as f64,
        });
        for (parameter, scale) in weights.parameters.iter_mut().zip(architecture.parameter_scales()) {
            *parameter *= scale;
        }
        weights
    }

    /// Uniform weights; nine times the square of their limit is `square(Cin, Cout, slope)`.
    fn uniform(architecture: &Architecture, seed: u64, square: impl Fn(usize, usize, Option<f32>) -> f64) -> Self {
        let mut parameters = vec![0.0; architecture.parameter_count()];
        for node in architecture.nodes() {
            if let (Op::Conv { cin, cout, slope }, Some(of)) = (node.op, &node.parameters) {
                let limit = (square(cin, cout, slope) / 9.0).sqrt();
                let stream = hash(seed, seed_of(&format!("{}.weight", node.name)));
                for (i, value) in parameters[of.weight.clone()].iter_mut().enumerate() {
                    *value = (limit * (2.0 * uniform(stream, i as u64) - 1.0)) as f32;
                }
            }
        }
        Self { architecture: architecture.clone(), parameters, metadata: BTreeMap::new() }
    }

    /// The weights in a safetensors file, of whichever architecture its metadata names.
    pub fn load(path: &Path) -> Result<Self> {
        Self::from_bytes(&read(path)?, &path.display().to_string(), None)
    }

    /// The weights in a safetensors file, which must be of this architecture.
    pub fn load_as(path: &Path, architecture: &Architecture) -> Result<Self> {
        Self::from_bytes(&read(path)?, &path.display().to_string(), Some(architecture))
    }

    /// The weights in the bytes of a safetensors file; `file` names it in errors. Where `expected` is given, the file must
    /// be of that architecture.
    pub fn from_bytes(bytes: &[u8], file: &str, expected: Option<&Architecture>) -> Result<Self> {
        let broken = |e| {
            Error::input(format!("{file}: not a whole safetensors file ({e}, {} bytes): copy it again", bytes.len()))
        };
        let tensors = SafeTensors::deserialize(bytes).map_err(broken)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(broken)?;
        let mut metadata: BTreeMap<_, _> = header.metadata().clone().unwrap_or_default().into_iter().collect();
        let architecture = choose(metadata.remove(ARCHITECTURE), &tensors, file, expected)?;
        let specs = architecture.tensors();
        if let Some(extra) = extra(&tensors, &specs) {
            let view = tensors.tensor(extra).map_err(broken)?;
            return Err(Error::input(format!(
                "{file}: tensor `{extra}`: expected none, for `{}` has no such tensor, found {}",
                architecture.name(),
                described(view.dtype(), view.shape())
            )));
        }
        let mut parameters = Vec::with_capacity(architecture.parameter_count());
        for spec in &specs {
            let wanted = described(Dtype::F32, &spec.shape);
            let Ok(view) = tensors.tensor(&spec.name) else {
                return Err(Error::input(format!("{file}: tensor `{}`: expected {wanted}, found none", spec.name)));
            };
            read_tensor(&view, spec, &mut parameters).map_err(|found| {
                Error::input(format!("{file}: tensor `{}`: expected {wanted}, found {found}", spec.name))
            })?;
        }
        Ok(Self { architecture, parameters, metadata })
    }

    /// The SHA-256 of [`Self::to_bytes`], in hexadecimal.
    #[must_use]
    pub fn sha256(&self) -> String {
        Sha256::digest(self.to_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// The bytes of a safetensors file: the same for the same weights. (The crate writes metadata in the random order of
    /// a hash map.)
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut metadata = self.metadata.clone();
        metadata.insert(ARCHITECTURE.to_owned(), self.architecture.name().to_owned());
        let mut header = serde_json::Map::new();
        header.insert("__metadata__".into(), serde_json::json!(metadata));
        for TensorSpec { name, shape, range } in self.architecture.tensors() {
            let offsets = [range.start * size_of::<f32>(), range.end * size_of::<f32>()];
            header.insert(name, serde_json::json!({ "dtype": "F32", "shape": shape, "data_offsets": offsets }));
        }
        let mut header = serde_json::Value::Object(header).to_string().into_bytes();
        header.resize(header.len().next_multiple_of(8), b' ');
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend(header);
        bytes.extend(self.parameters.iter().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    /// Writes a safetensors file, whole or not at all.
    pub fn save(&self, path: &Path) -> Result<()> {
        write_bytes(path, &self.to_bytes())
    }

    /// One tensor's values, by its key.
    pub fn tensor(&self, name: &str) -> Option<&[f32]> {
        let spec = self.architecture.tensors().into_iter().find(|spec| spec.name == name)?;
        Some(&self.parameters[spec.range])
    }

    /// The parameters in double precision, for the references.
    pub fn to_f64(&self) -> Vec<f64> {
        self.parameters.iter().copied().map(f64::from).collect()
    }
}

/// The bytes of a weights file; none that is too large for one is read.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    let bytes = std::fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
    if bytes > MAX_FILE_BYTES {
        return Err(Error::input(format!("{}: {bytes} bytes are too many for a weights file", path.display())));
    }
    std::fs::read(path).map_err(|e| Error::io(path, e))
}

/// The architecture that the file names, checked against the expected one. The widths of `base` and `kpn` are their tensors'.
fn choose(
    found: Option<String>,
    tensors: &SafeTensors,
    file: &str,
    expected: Option<&Architecture>,
) -> Result<Architecture> {
    let wanted = expected.map_or_else(|| NAMES.join(" or "), |a| a.name().to_owned());
    let Some(found) = found else {
        return Err(Error::input(format!(
            "{file}: its metadata have no `{ARCHITECTURE}` (expected {wanted}): was it written by `limpid train`?"
        )));
    };
    match expected {
        Some(architecture) if architecture.name() == found => Ok(architecture.clone()),
        None if found == "base" || found == "kpn" => {
            let shape = |name: &str| tensors.tensor(&format!("{name}.weight")).ok().map(|view| view.shape().to_vec());
            let channels_out = |name: &str| shape(name).filter(|shape| shape.len() == 4).map(|shape| shape[0]);
            let build = if found == "base" { Architecture::base } else { Architecture::kpn };
            let architecture = Widths::read(channels_out).and_then(|widths| build(&widths));
            architecture.map_err(|e| Error::input(format!("{file}: {e}")))
        }
        None if NAMES.contains(&found.as_str()) => Architecture::named(&found),
        _ => Err(Error::input(format!("{file}: architecture: expected {wanted}, found `{found}`"))),
    }
}

/// The first (by name) tensor of the file that the architecture does not have.
fn extra<'a>(tensors: &'a SafeTensors, specs: &[TensorSpec]) -> Option<&'a str> {
    tensors.names().into_iter().filter(|name| specs.iter().all(|spec| spec.name != *name)).min()
}

fn described(dtype: Dtype, shape: &[usize]) -> String {
    format!("{dtype:?} {shape:?}")
}

/// Appends a tensor's values; the error says what was found instead.
fn read_tensor(view: &TensorView, spec: &TensorSpec, parameters: &mut Vec<f32>) -> std::result::Result<(), String> {
    if view.dtype() != Dtype::F32 || view.shape() != spec.shape {
        return Err(described(view.dtype(), view.shape()));
    }
    for (i, bytes) in view.data().as_chunks::<4>().0.iter().enumerate() {
        let value = f32::from_le_bytes(*bytes);
        if !value.is_finite() {
            return Err(format!("{value} at index {i} (all must be finite)"));
        }
        parameters.push(value);
    }
    Ok(())
}
