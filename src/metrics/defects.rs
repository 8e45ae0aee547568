//! Single pixels that anyone sees.

use super::{check_lengths, luma_of};
use crate::Result;
use crate::image::Rgb;
use rayon::prelude::*;

/// How many times as bright as anything near it in the reference a firefly is.
const FIREFLY: f64 = 10.0;
/// Below this luma nothing counts as bright.
const DIM: f64 = 0.01;
/// Display values below this linear one are 0 in 8 bits.
const BLACK: f64 = 0.5 / 255.0 / 12.92;

/// Pixels that are wrong in themselves; see [`super::FORMULAS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Defects {
    /// Far brighter than anything about them in the reference.
    pub fireflies: u64,
    /// Black where the reference is not.
    pub black: u64,
    /// With a value that is not finite.
    pub non_finite: u64,
}

/// Counts the defects of planes of `width * height` values, which need not be finite; the reference's must.
pub fn defects(a: Rgb, r: Rgb, width: u32, height: u32) -> Result<Defects> {
    check_lengths("image", a, width, height)?;
    super::check("reference", r, width, height)?;
    let luma = |rgb: Rgb, i: usize| luma_of([0, 1, 2].map(|c| f64::from(rgb[c][i])));
    let (columns, rows) = (width as usize, height as usize);
    let reference: Vec<f64> = (0..a[0].len()).map(|i| luma(r, i)).collect();
    let median: Vec<f64> = (0..a[0].len())
        .into_par_iter()
        .map(|i| {
            let mut values: Vec<f64> = about(i, columns, rows).map(|j| reference[j]).collect();
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        })
        .collect();
    let kind = |i: usize| {
        let value = luma(a, i);
        let brightest = about(i, columns, rows).map(|j| median[j]).fold(reference[i].max(DIM), f64::max);
        [
            value.is_finite() && value > FIREFLY * brightest,
            (0..3).all(|c| f64::from(a[c][i]) < BLACK) && reference[i] > DIM,
            (0..3).any(|c| !a[c][i].is_finite()),
        ]
    };
    let count = |which: usize| (0..a[0].len()).into_par_iter().filter(|&i| kind(i)[which]).count() as u64;
    Ok(Defects { fireflies: count(0), black: count(1), non_finite: count(2) })
}

/// The pixels of the image among the 3x3 about pixel `i`.
fn about(i: usize, columns: usize, rows: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (i % columns, i / columns);
    let near = |at: usize, size: usize| at.saturating_sub(1)..(at + 2).min(size);
    near(y, rows).flat_map(move |v| near(x, columns).map(move |u| v * columns + u))
}
