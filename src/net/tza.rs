//! TZA 2.0, Open Image Denoise's files of weights: tensors by name, without metadata.
//!
//! Little endian: `u16` 0x41D7, `u8` major 2, `u8` minor, `u64` offset of the table. The table: `u32` count, then for each
//! tensor `u16` length and name, `u8` number of dimensions, each a `u32`, as many letters of the layout (`oihw` or `x`), a
//! letter of the type (`f`: fp32, `h`: fp16), `u64` offset of the data, which is aligned to 64 bytes.

use super::architecture::TensorSpec;
use super::weights::{ARCHITECTURE, Weights};
use crate::{Error, Result};
use half::f16;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use std::collections::{BTreeMap, HashMap};

const MAGIC: u16 = 0x41d7;
const VERSION: [u8; 2] = [2, 0];
const ALIGNMENT: usize = 64;

/// What is wrong with a file, without its name.
type Parsed<T> = std::result::Result<T, String>;

/// A place in the bytes of a file.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, count: usize, what: &str) -> Parsed<&'a [u8]> {
        let part = self.at.checked_add(count).and_then(|end| self.bytes.get(self.at..end));
        let part = part.ok_or_else(|| format!("{what} at byte {} goes past the end", self.at))?;
        self.at += count;
        Ok(part)
    }

    fn number<const N: usize>(&mut self, what: &str) -> Parsed<u64> {
        let mut wide = [0; 8];
        wide[..N].copy_from_slice(self.take(N, what)?);
        Ok(u64::from_le_bytes(wide))
    }
}

/// One tensor, in fp32.
struct Tensor {
    shape: Vec<usize>,
    /// Little endian.
    data: Vec<u8>,
}

/// One row of the table and the data that it names; `left` bytes are the most that it may have.
fn read_tensor(table: &mut Cursor, left: &mut usize) -> Parsed<(String, Tensor)> {
    let length = table.number::<2>("a tensor's name")? as usize;
    let name = std::str::from_utf8(table.take(length, "a tensor's name")?).map_err(|_| "a tensor's name is no text")?;
    let dimensions = table.number::<1>("a number of dimensions")? as usize;
    let shape: Vec<usize> =
        (0..dimensions).map(|_| Ok(table.number::<4>("a shape")? as usize)).collect::<Parsed<_>>()?;
    let layout = table.take(dimensions, "a layout")?;
    if !matches!(layout, b"x" | b"oihw") {
        let layout = String::from_utf8_lossy(layout);
        return Err(format!("tensor `{name}`: layout `{layout}`; limpid reads `oihw` and `x`"));
    }
    let (bytes_each, half) = match table.take(1, "a type")? {
        b"f" => (4, false),
        b"h" => (2, true),
        other => {
            let letter = other.escape_ascii();
            return Err(format!("tensor `{name}`: type `{letter}`; limpid reads `f` (fp32) and `h` (fp16)"));
        }
    };
    let at = usize::try_from(table.number::<8>("an offset")?).unwrap_or(usize::MAX);
    let bytes = shape.iter().try_fold(bytes_each, |count: usize, side| count.checked_mul(*side));
    // Also keeps a small file, whose tensors share their bytes, from becoming a large one.
    let bytes = bytes.filter(|bytes| bytes <= left).ok_or("its tensors are larger than the file")?;
    *left -= bytes;
    let data = Cursor { bytes: table.bytes, at }.take(bytes, &format!("tensor `{name}`"))?;
    let data = if half {
        let single = |pair: &[u8; 2]| f16::from_le_bytes(*pair).to_f32().to_le_bytes();
        data.as_chunks().0.iter().flat_map(single).collect()
    } else {
        data.to_vec()
    };
    Ok((name.to_owned(), Tensor { shape, data }))
}

fn read(bytes: &[u8]) -> Parsed<BTreeMap<String, Tensor>> {
    let mut cursor = Cursor { bytes, at: 0 };
    if cursor.number::<2>("the magic number") != Ok(u64::from(MAGIC)) {
        return Err("it does not begin as a TZA file does".into());
    }
    let major = cursor.number::<1>("the version")?;
    if major != u64::from(VERSION[0]) {
        return Err(format!("version {major}; limpid reads version {}", VERSION[0]));
    }
    cursor.number::<1>("the version")?;
    let table = cursor.number::<8>("the table's offset")?;
    cursor.at = usize::try_from(table).unwrap_or(usize::MAX);
    let count = cursor.number::<4>("the table")?;
    let (mut tensors, mut left) = (BTreeMap::new(), bytes.len());
    for _ in 0..count {
        let (name, tensor) = read_tensor(&mut cursor, &mut left)?;
        if tensors.contains_key(&name) {
            return Err(format!("two tensors are named `{name}`"));
        }
        tensors.insert(name, tensor);
    }
    Ok(tensors)
}

/// The weights in the bytes of a TZA file, which must be of the architecture `base`, of any widths; `file` names it in errors.
/// Their metadata are empty: the format has none.
pub fn from_bytes(bytes: &[u8], file: &str) -> Result<Weights> {
    let tensors = read(bytes).map_err(|e| Error::input(format!("{file}: no whole TZA file: {e}")))?;
    if tensors.contains_key("enc_conv1b.weight") {
        return Err(Error::input(format!(
            "{file}: weights of Open Image Denoise's larger network (`enc_conv1b`): limpid has the smaller one, `base`"
        )));
    }
    let error = |e: safetensors::SafeTensorError| Error::input(format!("{file}: {e}"));
    let views = tensors.iter().map(|(name, tensor)| {
        Ok((name, TensorView::new(Dtype::F32, tensor.shape.clone(), &tensor.data).map_err(error)?))
    });
    let views: Vec<_> = views.collect::<Result<_>>()?;
    let metadata = HashMap::from([(ARCHITECTURE.to_owned(), "base".to_owned())]);
    Weights::from_bytes(&safetensors::serialize(views, Some(metadata)).map_err(error)?, file, None)
}

/// The numbers of a TZA file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// fp16, which Open Image Denoise 2 asks for; the nearest to each weight.
    Half,
    /// fp32, which keeps all bits and which Open Image Denoise 1 reads.
    Single,
}

/// The bytes of a TZA file: the same for the same weights. The metadata stay behind.
pub fn to_bytes(weights: &Weights, precision: Precision) -> Result<Vec<u8>> {
    let name = weights.architecture.name();
    if name != "base" {
        return Err(Error::input(format!("weights of `{name}`: Open Image Denoise has no such network, only `base`")));
    }
    let pad = |bytes: &mut Vec<u8>| bytes.resize(bytes.len().next_multiple_of(ALIGNMENT), 0);
    let mut bytes = MAGIC.to_le_bytes().to_vec();
    bytes.extend(VERSION);
    let table_at = bytes.len();
    bytes.extend(0u64.to_le_bytes());
    let specs = weights.architecture.tensors();
    let mut table = (specs.len() as u32).to_le_bytes().to_vec();
    for TensorSpec { name, shape, range } in specs {
        pad(&mut bytes);
        table.extend((name.len() as u16).to_le_bytes());
        table.extend(name.as_bytes());
        table.push(shape.len() as u8);
        table.extend(shape.iter().flat_map(|side| (*side as u32).to_le_bytes()));
        table.extend(if shape.len() == 4 { &b"oihw"[..] } else { b"x" });
        let values = &weights.parameters[range];
        table.push(if precision == Precision::Half { b'h' } else { b'f' });
        table.extend((bytes.len() as u64).to_le_bytes());
        match precision {
            Precision::Single => bytes.extend(values.iter().flat_map(|value| value.to_le_bytes())),
            Precision::Half => {
                let halves = values.iter().map(|value| f16::from_f32(*value));
                if let Some(i) = halves.clone().position(|half| !half.is_finite()) {
                    return Err(Error::input(format!(
                        "tensor `{name}`: {} at index {i} is too large for fp16",
                        values[i]
                    )));
                }
                bytes.extend(halves.flat_map(f16::to_le_bytes));
            }
        }
    }
    pad(&mut bytes);
    let offset = bytes.len() as u64;
    bytes[table_at..table_at + 8].copy_from_slice(&offset.to_le_bytes());
    bytes.extend(table);
    Ok(bytes)
}
