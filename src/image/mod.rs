//! Images with named channels, EXR and PNG files.

pub mod exr;
pub mod file;
pub mod png;

use crate::{Error, Result};
use std::collections::BTreeMap;

/// A 32-bit float image: named planes of `width * height` values, row by row from the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Planes by channel name, e.g. `R`, `noisy.G`, `N.X`, `Z`.
    pub channels: BTreeMap<String, Vec<f32>>,
    /// Text attributes written to and read from the EXR header (numbers in decimal).
    pub attributes: BTreeMap<String, String>,
}

/// The largest image width or height in pixels.
pub const MAX_SIDE: u32 = 16_384;
/// The largest number of pixels of an image.
pub const MAX_PIXELS: u64 = 1 << 28;

/// Checks an image size: both sides 1 to [`MAX_SIDE`], at most [`MAX_PIXELS`] in all.
pub fn check_size(width: u32, height: u32) -> Result<()> {
    let allowed = format!("1 to {MAX_SIDE} a side and at most {MAX_PIXELS} pixels in all");
    if width == 0 || height == 0 {
        return Err(Error::input(format!("image size {width}x{height}: no pixels; allowed: {allowed}")));
    }
    if width > MAX_SIDE || height > MAX_SIDE || u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(Error::input(format!("image size {width}x{height} is too large; allowed: {allowed}")));
    }
    Ok(())
}

/// Three planes: red, green, blue.
pub type Rgb<'a> = [&'a [f32]; 3];

impl Image {
    /// An image without channels.
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, ..Self::default() }
    }

    /// Pixels in a plane.
    pub fn pixel_count(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// A channel, `width * height` values.
    pub fn channel(&self, name: &str) -> Result<&[f32]> {
        let plane = self.channels.get(name).ok_or_else(|| {
            let names: Vec<_> = self.channels.keys().map(String::as_str).collect();
            Error::input(format!("the image has no channel '{name}'; it has: {}", names.join(", ")))
        })?;
        self.check_plane(name, plane)?;
        Ok(plane)
    }

    /// The channels `prefix.R`, `prefix.G`, `prefix.B`, or `R`, `G`, `B` where the prefix is empty.
    pub fn rgb(&self, prefix: &str) -> Result<Rgb<'_>> {
        let [r, g, b] = self.rgb_names(prefix);
        Ok([self.channel(&r)?, self.channel(&g)?, self.channel(&b)?])
    }

    /// Whether [`Image::rgb`] finds all three channels.
    pub fn has_rgb(&self, prefix: &str) -> bool {
        self.rgb_names(prefix).iter().all(|name| self.channels.contains_key(name))
    }

    /// Sets the channels that [`Image::rgb`] finds.
    pub fn set_rgb(&mut self, prefix: &str, planes: [Vec<f32>; 3]) {
        self.channels.extend(self.rgb_names(prefix).into_iter().zip(planes));
    }

    /// Gives the channels that [`Image::rgb`] finds another prefix, in place of those that have it.
    pub fn move_rgb(&mut self, from: &str, to: &str) -> Result<()> {
        self.rgb(from)?;
        for (from, to) in self.rgb_names(from).iter().zip(self.rgb_names(to)) {
            if let Some(plane) = self.channels.remove(from) {
                self.channels.insert(to, plane);
            }
        }
        Ok(())
    }

    /// Refuses an image without pixels or channels, and planes of another size.
    pub fn check(&self) -> Result<()> {
        if self.pixel_count() == 0 || self.channels.is_empty() {
            return Err(Error::input(format!(
                "an image of {}x{} pixels and {} channels cannot be written",
                self.width,
                self.height,
                self.channels.len()
            )));
        }
        self.channels.iter().try_for_each(|(name, plane)| self.check_plane(name, plane))
    }

    fn check_plane(&self, name: &str, plane: &[f32]) -> Result<()> {
        if plane.len() == self.pixel_count() {
            return Ok(());
        }
        Err(Error::input(format!(
            "channel '{name}' has {} values; {}x{} pixels need {}",
            plane.len(),
            self.width,
            self.height,
            self.pixel_count()
        )))
    }

    fn rgb_names(&self, prefix: &str) -> [String; 3] {
        ["R", "G", "B"].map(|c| if prefix.is_empty() { c.to_owned() } else { format!("{prefix}.{c}") })
    }
}
