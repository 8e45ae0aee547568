//! A reference in two halves with noise of their own.

use super::{Comparison, Maps, RELMSE_EPSILON, check, comparison, mask_of, per_pixel, same_size};
use crate::Result;
use crate::image::{Image, Rgb};
use rayon::prelude::*;

/// The noise that a reference of two halves still has.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ReferenceNoise {
    /// As MAE01.
    pub mae01: f64,
    /// As relMSE.
    pub relmse: f64,
}

/// Compares the channels `prefix` of an image with two independent references: with their mean, but relMSE is the mean
/// product of the differences to each, to which their noise adds nothing.
pub fn compare_halves(image: &Image, prefix: &str, halves: [&Image; 2]) -> Result<Comparison> {
    let mean = mean_reference(halves)?;
    let mask = mask_of(image, &mean)?;
    let (a, r) = (image.rgb(prefix)?, mean.rgb("")?);
    check("image", a, image.width, image.height)?;
    let mut maps = Maps::new(a, r, image.width, image.height);
    maps.relative = products(a, [halves[0].rgb("")?, halves[1].rgb("")?], r);
    comparison(&maps, mask.as_deref())
}

/// relMSE of planes against two independent references: the mean product of the differences to each.
///
/// # Panics
/// Where the planes differ in length.
#[must_use]
pub fn relmse(a: Rgb, halves: [Rgb; 2]) -> f64 {
    let [first, second] = halves;
    assert!((0..3).all(|c| [first[c].len(), second[c].len(), a[c].len()] == [a[0].len(); 3]));
    let mean: [Vec<f32>; 3] = [0, 1, 2].map(|c| mean_plane(first[c], second[c]));
    let terms = products(a, halves, [&mean[0], &mean[1], &mean[2]]);
    terms.iter().sum::<f64>() / terms.len() as f64
}

fn mean_plane(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| ((f64::from(*a) + f64::from(*b)) / 2.0) as f32).collect()
}

/// The first of two references, with the mean of both in `R`, `G`, `B`.
pub fn mean_reference([first, second]: [&Image; 2]) -> Result<Image> {
    let [a, b] = checked([first, second])?;
    let mut image = first.clone();
    image.set_rgb("", [0, 1, 2].map(|c| mean_plane(a[c], b[c])));
    Ok(image)
}

/// What the noise of two references leaves in their mean.
pub fn reference_noise(halves: [&Image; 2]) -> Result<ReferenceNoise> {
    let [a, b] = checked(halves)?;
    let mean = |term: fn(f64, f64) -> f64| {
        let map = per_pixel(a, b, term);
        map.iter().sum::<f64>() / map.len() as f64
    };
    Ok(ReferenceNoise {
        mae01: mean(|a, b| (a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).abs()) / 2.0,
        relmse: mean(|a, b| (a - b).powi(2) / (((a + b) / 2.0).powi(2) + RELMSE_EPSILON)) / 4.0,
    })
}

fn checked<'a>([first, second]: [&'a Image; 2]) -> Result<[Rgb<'a>; 2]> {
    same_size("the second reference", second, first)?;
    check("reference", first.rgb("")?, first.width, first.height)?;
    check("second reference", second.rgb("")?, first.width, first.height)?;
    Ok([first.rgb("")?, second.rgb("")?])
}

/// The product of the relative differences to two references, per pixel.
fn products(a: Rgb, [first, second]: [Rgb; 2], mean: Rgb) -> Vec<f64> {
    let term = |c: usize, i: usize| {
        let [a, r1, r2, r] = [a, first, second, mean].map(|rgb| f64::from(rgb[c][i]));
        (a - r1) * (a - r2) / (r * r + RELMSE_EPSILON)
    };
    (0..a[0].len()).into_par_iter().map(|i| (0..3).map(|c| term(c, i)).sum::<f64>() / 3.0).collect()
}
