//! The filter of a kernel-predicting network (Bako et al. 2017, Vogels et al. 2018): every pixel is a weighted mean of 5x5 noisy
//! pixels and, but at the coarsest level, of 3x3 filtered ones of the next coarser level. The weights are the softmax of the
//! network's logits over those that lie inside the picture: no result is beyond what it is made of. Those of the coarser level are
//! multiplied with a quadratic B-spline of their distance first, so that equal logits interpolate: a network does not see which of
//! the four pixels below a coarser one it works on.

use super::demodulate::each_pixel;
use crate::net::tensor::Tensor;

/// Noisy pixels.
pub const FINE_TAPS: usize = 25;
/// Filtered pixels of the next coarser level.
pub const COARSE_TAPS: usize = 9;

/// Channels of the logits: the noisy pixels row by row, then the coarser ones.
#[must_use]
pub const fn logits(coarse: bool) -> usize {
    if coarse { FINE_TAPS + COARSE_TAPS } else { FINE_TAPS }
}

/// Gradients of the filter.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// With respect to the logits.
    pub logits: Tensor<f64>,
    /// With respect to the coarser level, where there is one; zero in the channel that tells what is inside.
    pub coarse: Option<Tensor<f64>>,
}

/// A pixel that is filtered.
#[derive(Clone, Copy)]
struct Tap {
    /// Number of its logit.
    logit: usize,
    coarse: bool,
    row: usize,
    column: usize,
    /// What the exponential of the logit is multiplied with.
    factor: f64,
}

/// The quadratic B-spline of the way from the middle of pixel `x` to that of the coarser pixel `to`, in coarser pixels.
fn spline(x: usize, to: usize) -> f64 {
    let distance = ((x as f64 + 0.5) / 2.0 - (to as f64 + 0.5)).abs();
    if distance < 0.5 { 0.75 - distance * distance } else { 0.5 * (1.5 - distance).powi(2) }
}

/// The taps of a pixel that lie inside.
fn taps(fine: &Tensor<f64>, coarse: Option<&Tensor<f64>>, [n, y, x]: [usize; 3]) -> Vec<Tap> {
    let around = |image: &Tensor<f64>, [y, x]: [usize; 2], reach: i64| {
        let [_, _, height, width] = image.shape;
        let side = 2 * reach + 1;
        let inside = |j: i64| {
            let (row, column) = (y as i64 + j / side - reach, x as i64 + j % side - reach);
            let within = (0..height as i64).contains(&row) && (0..width as i64).contains(&column);
            let place = (row as usize, column as usize);
            (within && image.at(n, 3, place.0, place.1) != 0.0).then_some((j as usize, place))
        };
        (0..side * side).filter_map(inside).collect::<Vec<_>>()
    };
    let near = around(fine, [y, x], 2).into_iter();
    let near = near.map(|(logit, (row, column))| Tap { logit, coarse: false, row, column, factor: 1.0 });
    let far = coarse.map_or(Vec::new(), |coarse| around(coarse, [y / 2, x / 2], 1)).into_iter();
    let far = far.map(|(j, (row, column))| {
        let factor = spline(y, row) * spline(x, column);
        Tap { logit: FINE_TAPS + j, coarse: true, row, column, factor }
    });
    near.chain(far).collect()
}

/// The weights of [`taps`].
fn softmax(logits: &Tensor<f64>, taps: &[Tap], [n, y, x]: [usize; 3]) -> Vec<f64> {
    let value = |tap: &Tap| logits.at(n, tap.logit, y, x);
    let most = taps.iter().map(value).fold(f64::NEG_INFINITY, f64::max);
    let powers: Vec<f64> = taps.iter().map(|tap| tap.factor * (value(tap) - most).exp()).collect();
    let sum: f64 = powers.iter().sum();
    powers.into_iter().map(|p| p / sum).collect()
}

/// Logits (N, 25 or 34, H, W), noisy pixels (N, 4, H, W) and the coarser level (N, 4, H/2, W/2) to (N, 4, H, W); the last of the
/// four channels is 1 inside the picture. A pixel that nothing inside is near is 0.
pub fn reference(logits: &Tensor<f64>, fine: &Tensor<f64>, coarse: Option<&Tensor<f64>>) -> Tensor<f64> {
    let [batch, channels, height, width] = logits.shape;
    assert_eq!(channels, self::logits(coarse.is_some()));
    assert_eq!(fine.shape, [batch, 4, height, width]);
    let mut output = Tensor::zeros(fine.shape);
    each_pixel([batch, height, width], |n, y, x| {
        let taps = taps(fine, coarse, [n, y, x]);
        let weights = softmax(logits, &taps, [n, y, x]);
        for c in 0..3 {
            let value = |tap: &Tap| match coarse {
                Some(coarse) if tap.coarse => coarse.at(n, c, tap.row, tap.column),
                _ => fine.at(n, c, tap.row, tap.column),
            };
            let i = output.index(n, c, y, x);
            output.data[i] = taps.iter().zip(&weights).map(|(tap, w)| w * value(tap)).sum();
        }
        let i = output.index(n, 3, y, x);
        output.data[i] = if taps.is_empty() { 0.0 } else { 1.0 };
    });
    output
}

/// The gradients with respect to the logits and the coarser level; nothing before the noisy pixels has parameters.
pub fn reference_backward(
    logits: &Tensor<f64>,
    fine: &Tensor<f64>,
    coarse: Option<&Tensor<f64>>,
    dy: &Tensor<f64>,
) -> Gradients {
    let output = reference(logits, fine, coarse);
    let [batch, _, height, width] = logits.shape;
    let mut to_logits = Tensor::zeros(logits.shape);
    let mut to_coarse = coarse.map(|coarse| Tensor::zeros(coarse.shape));
    each_pixel([batch, height, width], |n, y, x| {
        let taps = taps(fine, coarse, [n, y, x]);
        let weights = softmax(logits, &taps, [n, y, x]);
        for (&Tap { logit, coarse: far, row, column, .. }, w) in taps.iter().zip(&weights) {
            let from = coarse.filter(|_| far).unwrap_or(fine);
            let slope = |c| dy.at(n, c, y, x) * (from.at(n, c, row, column) - output.at(n, c, y, x));
            let i = to_logits.index(n, logit, y, x);
            to_logits.data[i] = w * (0..3).map(slope).sum::<f64>();
            if let Some(to_coarse) = to_coarse.as_mut().filter(|_| far) {
                for c in 0..3 {
                    let i = to_coarse.index(n, c, row, column);
                    to_coarse.data[i] += w * dy.at(n, c, y, x);
                }
            }
        }
    });
    Gradients { logits: to_logits, coarse: to_coarse }
}
