//! Images with named channels, EXR and PNG files.

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
