//! How far an image is from its reference.
//!
//! MAE01 and relMSE are over linear values; PSNR, SSIM and FLIP over display values, [`srgb_encode`] of the values
//! clamped to [0, 1]. FLIP sees them in 8 bits, as its implementation (NVIDIA's, by the crate `nv-flip`) takes them.

mod defects;
mod halves;
mod seams;

pub use defects::{Defects, defects};
pub use halves::{ReferenceNoise, compare_halves, mean_reference, reference_noise, relmse};
pub use seams::seam_energy;

use crate::image::png::srgb_encode;
use crate::image::{Image, Rgb};
use crate::{Error, Result};
use rayon::prelude::*;

/// The definitions, for `--help`.
pub const FORMULAS: &str = "\
Of an image a against its reference r, over all pixels and the three linear channels:
  mae01   mean |clamp(a,0,1) - clamp(r,0,1)|
  relmse  mean (a-r)^2 / (r^2 + 0.01)
Of the display values s(x) = sRGB(clamp(x,0,1)):
  psnr    10 log10(1 / mean (s(a)-s(r))^2) in dB; null where the two are equal
  ssim    mean over pixels of (2 ma mr + C1)(2 car + C2) / ((ma^2 + mr^2 + C1)(va + vr + C2)) with ma, mr, va, vr, car the
          means, variances and covariance of the luma Y = 0.2126 R + 0.7152 G + 0.0722 B in a Gaussian window of 11x11
          pixels, sigma 1.5, C1 = 0.01^2, C2 = 0.03^2; at the border (and in images under 11 pixels) the window is cut
          off and its weights are scaled to sum 1
  flip    mean of the FLIP error map (LDR, 67.02 pixels per degree, 8-bit display values)
'surface' is each figure over the pixels whose first hit is neither light nor nothing, where the images say which: depth
channel Z > 0 and albedo.R + albedo.G + albedo.B > 0 (lights have albedo 0), from the reference if it has these channels,
else from the image. ssim and flip are computed on the whole image and their maps averaged over those pixels.
With a second reference (--second), independent of the first, r is the mean of the two, but
  relmse  mean (a-r1) (a-r2) / (r^2 + 0.01), to which the noise of r1 and r2 adds nothing but its square
  noise   that of r: half the mae01 of r1 against r2, and a quarter of mean (r1-r2)^2 / (r^2 + 0.01)
With --seams N, of the error e = clamp(a,0,1) - clamp(r,0,1), in which the content's own edges cancel:
  seam_energy  mean |e(p) - e(q)| over horizontal and vertical neighbours p, q in two chunks of NxN pixels (pairs that
               straddle a multiple of N), by its mean over all other neighbours: 1 = no seams; null where e is flat
With --defects, Y being the linear luma and m the largest of the 3x3 medians of Y(r) at the 3x3 pixels about a pixel:
  fireflies    pixels with Y(a) > 10 max(m, Y(r), 0.01)
  black        pixels with R, G and B of a below 0.00015 (0 as 8-bit display values) where Y(r) > 0.01
  non_finite   pixels with a value that is not finite; where there are any, the other figures are null";

/// FLIP's default viewing condition: 0.7 m from a 0.7 m wide 3840-pixel monitor.
pub const FLIP_PIXELS_PER_DEGREE: f32 = nv_flip::DEFAULT_PIXELS_PER_DEGREE;

const RELMSE_EPSILON: f64 = 0.01;
const LUMA: [f64; 3] = [0.2126, 0.7152, 0.0722];
const SSIM_RADIUS: usize = 5;
const SSIM_SIGMA: f64 = 1.5;
const SSIM_C1: f64 = 0.01 * 0.01;
const SSIM_C2: f64 = 0.03 * 0.03;

/// The figures over one set of pixels; see [`FORMULAS`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Figures {
    /// Pixels counted.
    pub pixels: u64,
    /// Mean absolute error of linear values clamped to [0, 1].
    pub mae01: f64,
    /// Mean relative squared error of linear values.
    pub relmse: f64,
    /// Peak signal to noise ratio of display values in dB; infinite (JSON: null) where they are equal.
    pub psnr: f64,
    /// Structural similarity of the luma, 1 for equal images.
    pub ssim: f64,
    /// Mean FLIP error, 0 (equal) to 1.
    pub flip: f64,
}

/// The figures of an image against its reference.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Comparison {
    /// Over all pixels.
    pub all: Figures,
    /// Over surface pixels; absent where the images do not tell them or there are none.
    pub surface: Option<Figures>,
}

/// Compares the channels `R`, `G`, `B` of an image and its reference.
pub fn compare(image: &Image, reference: &Image) -> Result<Comparison> {
    compare_channels(image, "", reference, "")
}

/// Compares the channels with these prefixes (see [`Image::rgb`]), e.g. `noisy` of an image with none of its reference.
pub fn compare_channels(image: &Image, prefix: &str, reference: &Image, ref_prefix: &str) -> Result<Comparison> {
    let mask = mask_of(image, reference)?;
    evaluate(image.rgb(prefix)?, reference.rgb(ref_prefix)?, image.width, image.height, mask.as_deref())
}

/// An error, about `what`, where two images differ in size.
pub fn same_size(what: &str, image: &Image, reference: &Image) -> Result<()> {
    let [a, r] = [image, reference].map(|image| (image.width, image.height));
    if a == r {
        return Ok(());
    }
    Err(Error::input(format!(
        "{what} has {}x{} pixels, its reference {}x{}; they must be of one size",
        a.0, a.1, r.0, r.1
    )))
}

/// The surface pixels, as the reference tells them, else the image.
fn mask_of(image: &Image, reference: &Image) -> Result<Option<Vec<bool>>> {
    same_size("the image", image, reference)?;
    match surface_mask(reference)? {
        Some(mask) => Ok(Some(mask)),
        None => surface_mask(image),
    }
}

/// How many values of two planes of one size differ in their bits.
#[must_use]
pub fn different_values(a: &[f32], b: &[f32]) -> usize {
    a.iter().zip(b).filter(|(a, b)| a.to_bits() != b.to_bits()).count()
}

/// The pixels whose first hit is a surface that is no light: `Z > 0` and a positive sum of `albedo`. None where the
/// image lacks these channels. A black surface that is no light counts as light.
pub fn surface_mask(image: &Image) -> Result<Option<Vec<bool>>> {
    if !image.channels.contains_key("Z") || !image.has_rgb("albedo") {
        return Ok(None);
    }
    let (z, [r, g, b]) = (image.channel("Z")?, image.rgb("albedo")?);
    Ok(Some((0..z.len()).map(|i| z[i] > 0.0 && r[i] + g[i] + b[i] > 0.0).collect()))
}

/// Compares linear planes of `width * height` values, over all pixels and over those where `surface` is true.
pub fn evaluate(a: Rgb, r: Rgb, width: u32, height: u32, surface: Option<&[bool]>) -> Result<Comparison> {
    check("image", a, width, height)?;
    check("reference", r, width, height)?;
    let count = width as usize * height as usize;
    if let Some(mask) = surface.filter(|mask| mask.len() != count) {
        return Err(Error::input(format!("the surface mask has {} values; {count} are needed", mask.len())));
    }
    comparison(&Maps::new(a, r, width, height), surface)
}

fn comparison(maps: &Maps, surface: Option<&[bool]>) -> Result<Comparison> {
    let all = maps.mean(|_| true).ok_or_else(|| Error::input("an image without pixels has no figures"))?;
    Ok(Comparison { all, surface: surface.and_then(|mask| maps.mean(|i| mask[i])) })
}

const CHANNELS: [&str; 3] = ["red", "green", "blue"];

fn check_lengths(what: &str, planes: Rgb, width: u32, height: u32) -> Result<()> {
    crate::image::check_size(width, height)?;
    for (plane, name) in planes.into_iter().zip(CHANNELS) {
        if plane.len() != width as usize * height as usize {
            return Err(Error::input(format!(
                "the {what} has {} {name} values; {width}x{height} pixels need {}",
                plane.len(),
                width as usize * height as usize
            )));
        }
    }
    Ok(())
}

fn check(what: &str, planes: Rgb, width: u32, height: u32) -> Result<()> {
    check_lengths(what, planes, width, height)?;
    for (plane, name) in planes.into_iter().zip(CHANNELS) {
        if let Some(i) = plane.iter().position(|v| !v.is_finite()) {
            let (x, y) = (i % width as usize, i / width as usize);
            return Err(Error::input(format!(
                "the {what} is {} at pixel ({x}, {y}), channel {name}; figures need finite values",
                plane[i]
            )));
        }
    }
    Ok(())
}

/// Per pixel, the terms that the figures average; over three channels where there are three.
struct Maps {
    absolute: Vec<f64>,
    relative: Vec<f64>,
    display: Vec<f64>,
    ssim: Vec<f64>,
    flip: Vec<f32>,
}

impl Maps {
    fn new(a: Rgb, r: Rgb, width: u32, height: u32) -> Self {
        let [a_display, r_display] = [a, r].map(display);
        let [a_flip, r_flip] = [&a_display, &r_display].map(|rgb| flip_image(rgb, width, height));
        let flip = nv_flip::flip(r_flip, a_flip, FLIP_PIXELS_PER_DEGREE).to_vec();
        Self {
            absolute: per_pixel(a, r, |a, r| (a.clamp(0.0, 1.0) - r.clamp(0.0, 1.0)).abs()),
            relative: per_pixel(a, r, |a, r| (a - r) * (a - r) / (r * r + RELMSE_EPSILON)),
            display: per_pixel(planes(&a_display), planes(&r_display), |a, r| (a - r) * (a - r)),
            ssim: ssim(&luma(&a_display), &luma(&r_display), width as usize),
            flip,
        }
    }

    /// The figures over the pixels for which `counts` holds; None where there are none.
    fn mean(&self, counts: impl Fn(usize) -> bool) -> Option<Figures> {
        let pixels: Vec<usize> = (0..self.absolute.len()).filter(|&i| counts(i)).collect();
        let mean = |term: &dyn Fn(usize) -> f64| pixels.iter().map(|&i| term(i)).sum::<f64>() / pixels.len() as f64;
        (!pixels.is_empty()).then(|| Figures {
            pixels: pixels.len() as u64,
            mae01: mean(&|i| self.absolute[i]),
            relmse: mean(&|i| self.relative[i]),
            psnr: -10.0 * mean(&|i| self.display[i]).log10(),
            ssim: mean(&|i| self.ssim[i]),
            flip: mean(&|i| f64::from(self.flip[i])),
        })
    }
}

/// The mean of a term over the three channels, per pixel.
fn per_pixel(a: Rgb, r: Rgb, term: fn(f64, f64) -> f64) -> Vec<f64> {
    let channels = |i: usize| (0..3).map(move |c| term(f64::from(a[c][i]), f64::from(r[c][i])));
    (0..a[0].len()).into_par_iter().map(|i| channels(i).sum::<f64>() / 3.0).collect()
}

/// Display values of linear ones.
fn display(rgb: Rgb) -> [Vec<f32>; 3] {
    rgb.map(|plane| plane.par_iter().map(|&v| srgb_encode(v)).collect())
}

fn planes(display: &[Vec<f32>; 3]) -> Rgb<'_> {
    display.each_ref().map(Vec::as_slice)
}

fn flip_image([r, g, b]: &[Vec<f32>; 3], width: u32, height: u32) -> nv_flip::FlipImageRgb8 {
    let bytes = (0..r.len()).flat_map(|i| [r[i], g[i], b[i]].map(|v| (v * 255.0 + 0.5) as u8));
    nv_flip::FlipImageRgb8::with_data(width, height, &bytes.collect::<Vec<u8>>())
}

fn luma(display: &[Vec<f32>; 3]) -> Vec<f64> {
    (0..display[0].len()).map(|i| luma_of([0, 1, 2].map(|c| f64::from(display[c][i])))).collect()
}

fn luma_of(rgb: [f64; 3]) -> f64 {
    (0..3).map(|c| LUMA[c] * rgb[c]).sum()
}

/// The map of the structural similarity.
fn ssim(a: &[f64], r: &[f64], width: usize) -> Vec<f64> {
    let product = |x: &[f64], y: &[f64]| -> Vec<f64> { x.iter().zip(y).map(|(x, y)| x * y).collect() };
    let [ma, mr, maa, mrr, mar] =
        [a.to_vec(), r.to_vec(), product(a, a), product(r, r), product(a, r)].map(|plane| blur(&plane, width));
    let term = |i: usize| {
        let (va, vr, car) = (maa[i] - ma[i] * ma[i], mrr[i] - mr[i] * mr[i], mar[i] - ma[i] * mr[i]);
        (2.0 * ma[i] * mr[i] + SSIM_C1) * (2.0 * car + SSIM_C2)
            / ((ma[i] * ma[i] + mr[i] * mr[i] + SSIM_C1) * (va + vr + SSIM_C2))
    };
    (0..a.len()).map(term).collect()
}

/// Gaussian means in windows of 2 * [`SSIM_RADIUS`] + 1, cut off at the border with weights scaled to sum 1.
fn blur(plane: &[f64], width: usize) -> Vec<f64> {
    let height = plane.len() / width;
    let rows = |at: usize| (at / width * width, at % width, width, 1);
    let columns = |at: usize| (at % width, at / width, height, width);
    let across: Vec<f64> = (0..plane.len()).into_par_iter().map(|i| window(plane, rows(i))).collect();
    (0..plane.len()).into_par_iter().map(|i| window(&across, columns(i))).collect()
}

/// The Gaussian mean about element `at` of the line of `length` elements that begins at `start` with this `stride`.
fn window(plane: &[f64], (start, at, length, stride): (usize, usize, usize, usize)) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for i in at.saturating_sub(SSIM_RADIUS)..(at + SSIM_RADIUS + 1).min(length) {
        let weight = GAUSSIAN[i.abs_diff(at)];
        sum += weight * plane[start + i * stride];
        weights += weight;
    }
    sum / weights
}

/// exp(-d^2 / (2 sigma^2)) for distances 0 to [`SSIM_RADIUS`].
static GAUSSIAN: std::sync::LazyLock<[f64; SSIM_RADIUS + 1]> =
    std::sync::LazyLock::new(|| std::array::from_fn(|d| (-((d * d) as f64) / (2.0 * SSIM_SIGMA * SSIM_SIGMA)).exp()));
