//! Seams between chunks.

use crate::image::Rgb;
use crate::{Error, Result};

/// Seam energy of planes of `width` columns: how much the error `clamp(a,0,1) - clamp(r,0,1)` changes from a pixel to the
/// next where these lie in two chunks of `chunk` x `chunk` pixels, against the mean change elsewhere; see [`super::FORMULAS`]. Infinite where it changes nowhere
/// else, not a number where it changes nowhere at all.
///
/// An error where no chunk ends in the image, or every pixel is one.
pub fn seam_energy(a: Rgb, r: Rgb, width: u32, chunk: u32) -> Result<f64> {
    let height = (a[0].len() / width.max(1) as usize) as u32;
    super::check("image", a, width, height)?;
    super::check("reference", r, width, height)?;
    if chunk < 2 || chunk >= width.max(height) {
        let most = width.max(height).saturating_sub(1);
        return Err(Error::input(format!(
            "--seams {chunk}: no two chunks meet in {width}x{height} pixels; from 2 to {most} would do"
        )));
    }
    let (mut across, mut within) = (Mean::default(), Mean::default());
    for (a, r) in a.into_iter().zip(r) {
        let clamp = |v: &f32| f64::from(*v).clamp(0.0, 1.0);
        let error: Vec<f64> = a.iter().zip(r).map(|(a, r)| clamp(a) - clamp(r)).collect();
        for (i, here) in error.iter().enumerate() {
            let (x, y) = (i as u32 % width, i as u32 / width);
            for (at, size, next) in [(x, width, 1), (y, height, width as usize)] {
                if at + 1 < size {
                    let mean = if (at + 1).is_multiple_of(chunk) { &mut across } else { &mut within };
                    mean.add((here - error[i + next]).abs());
                }
            }
        }
    }
    Ok(across.value() / within.value())
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    fn value(&self) -> f64 {
        self.sum / self.count as f64
    }
}
