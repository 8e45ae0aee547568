//! 8-bit sRGB pictures of linear radiance.

use super::{Rgb, file};
use crate::{Error, Result};
use ::image::codecs::png::PngEncoder;
use ::image::{ExtendedColorType, ImageEncoder};
use std::path::Path;

/// Pixels between the two halves of a comparison.
pub const SEPARATOR_WIDTH: u32 = 4;
const SEPARATOR_GREY: u8 = 255;

/// The sRGB transfer function: linear light to display value, both in [0, 1]; input outside is clamped, NaN gives 0.
pub fn srgb_encode(linear: f32) -> f32 {
    let v = if linear.is_nan() { 0.0 } else { linear.clamp(0.0, 1.0) };
    // In f64, so that 1 gives 1.
    let v = f64::from(v);
    let display = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    display as f32
}

/// The other way: display value to linear light (IEC 61966-2-1).
pub fn srgb_decode(display: f32) -> f32 {
    if display <= 0.04045 { display / 12.92 } else { ((display + 0.055) / 1.055).powf(2.4) }
}

/// Linear planes as interleaved 8-bit sRGB, three bytes a pixel. `exposure_ev` scales light by `2^exposure_ev`.
pub fn to_srgb8(rgb: Rgb, exposure_ev: f32) -> Vec<u8> {
    let scale = exposure_ev.exp2();
    let byte = |linear: f32| (srgb_encode(linear * scale) * 255.0 + 0.5) as u8;
    let [r, g, b] = rgb;
    r.iter().zip(g).zip(b).flat_map(|((&r, &g), &b)| [byte(r), byte(g), byte(b)]).collect()
}

/// Writes linear planes of `width * height` values as sRGB PNG, whole or not at all.
pub fn write(path: impl AsRef<Path>, width: u32, height: u32, rgb: Rgb, exposure_ev: f32) -> Result<()> {
    check(width, height, &rgb)?;
    encode(path.as_ref(), width, height, &to_srgb8(rgb, exposure_ev))
}

/// Writes two pictures of the same size side by side, with a white line of [`SEPARATOR_WIDTH`] between them.
pub fn write_compare(
    path: impl AsRef<Path>,
    width: u32,
    height: u32,
    [left, right]: [Rgb; 2],
    exposure_ev: f32,
) -> Result<()> {
    check(width, height, &left)?;
    check(width, height, &right)?;
    let [left, right] = [left, right].map(|rgb| to_srgb8(rgb, exposure_ev));
    let row = 3 * width as usize;
    let separator = [SEPARATOR_GREY; 3 * SEPARATOR_WIDTH as usize];
    let rows = left.chunks(row).zip(right.chunks(row));
    let bytes: Vec<u8> = rows.flat_map(|(left, right)| [left, &separator, right].concat()).collect();
    encode(path.as_ref(), 2 * width + SEPARATOR_WIDTH, height, &bytes)
}

fn check(width: u32, height: u32, rgb: &Rgb) -> Result<()> {
    super::check_size(width, height)?;
    let count = width as usize * height as usize;
    match rgb.iter().find(|plane| plane.len() != count) {
        None => Ok(()),
        Some(plane) => Err(Error::input(format!(
            "a picture of {width}x{height} pixels needs {count} values a channel; one has {}",
            plane.len()
        ))),
    }
}

fn encode(path: &Path, width: u32, height: u32, bytes: &[u8]) -> Result<()> {
    file::write_atomically(path, |out| {
        PngEncoder::new(out).write_image(bytes, width, height, ExtendedColorType::Rgb8).map_err(|error| match error {
            ::image::ImageError::IoError(error) => Error::io(path, error),
            other => Error::input(format!("{}: cannot be encoded as PNG: {other}", path.display())),
        })
    })
}
