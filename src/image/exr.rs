//! OpenEXR: one part, flat, channels with dotted names, 32-bit floats.

mod header;

use super::Image;
use super::file::{self, WriteSeek};
use crate::{Error, Result};
use exr::block::lines::LineRefMut;
use exr::error::Error as ExrError;
use exr::image::write::samples::{SamplesWriter, WritableSamples};
use exr::image::{AnyChannel, AnyChannels, Blocks, Encoding, FlatSamples, Layer};
use exr::math::RoundingMode;
use exr::meta::MetaData;
use exr::meta::attribute::{AttributeValue, LevelMode, LineOrder, SampleType, Text};
use exr::meta::header::{Header, LayerAttributes, standard_names};
use exr::prelude::{Compression, ReadChannels, ReadLayers, Vec2, WritableImage};
use header::SortedHeader;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Cursor, ErrorKind, Read, Seek};
use std::path::Path;

const MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];
/// Attribute names are at most this long in bytes.
const MAX_NAME_BYTES: usize = 255;

/// Writes an image as one-part EXR, losslessly compressed, whole or not at all. Equal images give equal bytes.
///
/// Attributes become text, but numbers that an `int` or a `float` holds exactly as they are printed become those.
pub fn write(image: &Image, path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    file::write_atomically(path, |out| match encode_to(image, out) {
        Err(Error::Input(cause)) => Err(Error::input(format!("{}: {cause}", path.display()))),
        Err(Error::Io { source, .. }) => Err(Error::io(path, source)),
        other => other,
    })
}

/// The bytes of [`write()`].
pub fn encode(image: &Image) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    encode_to(image, &mut bytes)?;
    Ok(bytes.into_inner())
}

/// Writes the bytes of [`write()`] piece by piece, the planes where they are: images may be larger than half the memory.
fn encode_to(image: &Image, out: &mut dyn WriteSeek) -> Result<()> {
    image.check()?;
    let size = Vec2(image.width as usize, image.height as usize);
    let channels = image.channels.iter().map(|(name, plane)| {
        check_name("channel", name)?;
        Ok(AnyChannel::new(text(name), Plane { width: size.0, values: plane }))
    });
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let mut attributes = LayerAttributes::default();
    for (name, value) in &image.attributes {
        check_name("attribute", name)?;
        if standard_names::ALL.contains(&name.as_bytes()) {
            return Err(Error::input(format!("the attribute name '{name}' is OpenEXR's own; choose another")));
        }
        attributes.other.insert(text(name), attribute(value));
    }
    let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(channels.collect::<Result<_>>()?));
    let mut out = SortedHeader::new(out);
    exr::image::Image::from_layer(layer).write().to_buffered(&mut out).map_err(|error| match error {
        ExrError::Io(error) => Error::io("the file", error),
        error => Error::input(format!("cannot be encoded as EXR: {error}")),
    })?;
    out.finish().map_err(|error| Error::io("the file", error))
}

/// A plane that stays where it is while it is written.
#[derive(Clone, Copy)]
struct Plane<'a> {
    width: usize,
    values: &'a [f32],
}

impl<'a> WritableSamples<'_> for Plane<'a> {
    type Writer = Plane<'a>;

    fn sample_type(&self) -> SampleType {
        SampleType::F32
    }

    fn infer_level_modes(&self) -> (LevelMode, RoundingMode) {
        (LevelMode::Singular, RoundingMode::Down)
    }

    fn create_samples_writer(&self, _: &Header) -> Self::Writer {
        *self
    }
}

impl SamplesWriter for Plane<'_> {
    fn extract_line(&self, line: LineRefMut<'_>) {
        let begin = line.location.position.y() * self.width + line.location.position.x();
        let values = &self.values[begin..begin + line.location.sample_count];
        line.write_samples_from_slice(values).expect("the line has room for its samples");
    }
}

/// Reads a one-part flat EXR of any sample type and lossless or lossy compression; all channels as f32 (a `uint`
/// beyond 2^24 is rounded). Numeric and text attributes are kept as text.
pub fn read(path: impl AsRef<Path>) -> Result<Image> {
    let path = path.as_ref();
    let file = File::open(path).map_err(|error| Error::io(path, error))?;
    if file.metadata().is_ok_and(|metadata| metadata.is_dir()) {
        return Err(Error::input(format!("{}: is a directory; name an EXR file", path.display())));
    }
    decode(BufReader::new(file)).map_err(|error| match error {
        ExrError::Io(error) => Error::io(path, error),
        ExrError::Invalid(cause) => Error::input(format!("{}: truncated or damaged EXR: {cause}", path.display())),
        ExrError::NotSupported(cause) => Error::input(format!("{}: {cause}", path.display())),
        ExrError::Aborted => Error::input(format!("{}: reading was aborted", path.display())),
    })
}

fn decode(mut source: impl Read + Seek) -> std::result::Result<Image, ExrError> {
    let unsupported = |cause: String| Err(ExrError::NotSupported(cause.into()));
    let mut magic = [0; 4];
    match source.read_exact(&mut magic) {
        Err(error) if error.kind() != ErrorKind::UnexpectedEof => return Err(error.into()),
        Ok(()) if magic == MAGIC => {}
        _ => return unsupported("not an OpenEXR file".into()),
    }
    source.rewind()?;
    let meta = MetaData::read_from_buffered(&mut source, false)?;
    let [header] = &meta.headers[..] else {
        return unsupported(format!("an EXR of {} parts; limpid reads one-part files", meta.headers.len()));
    };
    if let Some(cause) = refusal(header) {
        return unsupported(cause);
    }
    let (width, height) = (header.layer_size.0 as u32, header.layer_size.1 as u32);
    source.rewind()?;
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(source)?;
    let layer = image.layer_data;
    let channels = layer.channel_data.list.into_iter().map(|channel| {
        let plane = match channel.sample_data {
            FlatSamples::F32(plane) => plane,
            FlatSamples::F16(plane) => plane.into_iter().map(f32::from).collect(),
            FlatSamples::U32(plane) => plane.into_iter().map(|value| value as f32).collect(),
        };
        (string(&channel.name), plane)
    });
    let channels: BTreeMap<_, _> = channels.collect();
    let attributes = attributes(&layer.attributes);
    Ok(Image { width, height, channels, attributes })
}

/// Why a part cannot be read.
fn refusal(header: &Header) -> Option<String> {
    let Vec2(width, height) = header.layer_size;
    let size = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
    if header.deep {
        return Some("a deep EXR; limpid reads flat ones".into());
    }
    if let Some(channel) = header.channels.list.iter().find(|channel| channel.sampling != Vec2(1, 1)) {
        return Some(format!("channel '{}' is subsampled; limpid reads full resolution", string(&channel.name)));
    }
    super::check_size(size(width), size(height)).err().map(|error| error.to_string())
}

fn attributes(layer: &LayerAttributes) -> BTreeMap<String, String> {
    let others = layer.other.iter().filter_map(|(name, value)| {
        let value = match value {
            AttributeValue::Text(value) => string(value),
            AttributeValue::I32(value) => value.to_string(),
            AttributeValue::F32(value) => value.to_string(),
            AttributeValue::F64(value) => value.to_string(),
            _ => return None,
        };
        Some((string(name), value))
    });
    others.collect()
}

/// The attribute that prints as `value`.
fn attribute(value: &str) -> AttributeValue {
    match (value.parse::<i32>(), value.parse::<f32>()) {
        (Ok(number), _) if number.to_string() == value => AttributeValue::I32(number),
        (_, Ok(number)) if number.is_finite() && number.to_string() == value => AttributeValue::F32(number),
        _ => AttributeValue::Text(text(value)),
    }
}

fn check_name(kind: &str, name: &str) -> Result<()> {
    if name.is_empty() || name.len() > MAX_NAME_BYTES || name.contains('\0') {
        return Err(Error::input(format!("the {kind} name '{name}' must have 1 to {MAX_NAME_BYTES} bytes, none 0")));
    }
    Ok(())
}

fn text(value: &str) -> Text {
    Text::from_slice_unchecked(value.as_bytes())
}

fn string(text: &Text) -> String {
    String::from_utf8_lossy(text.as_slice()).into_owned()
}
