//! The loss: mean absolute error, of pixels alone or of means over squares of pixels as well.

use crate::named::named;
use crate::net::tensor::Tensor;
use serde::{Deserialize, Serialize};

/// What training minimises.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Loss {
    /// The mean absolute error, the paper's loss.
    #[default]
    Mae,
    /// The mean over the scales 1, 2, 4, 8 and 16 of the mean absolute error of pictures reduced by as much. An error that
    /// neighbours share, which is seen as mottles, weighs up to five times as much as noise does.
    Multiscale,
}

named!(Loss, "loss", Mae = "mae", Multiscale = "multiscale");

impl Loss {
    /// Scales, each with squares of twice the side of the last; the first has pixels.
    #[must_use]
    pub const fn scales(self) -> u32 {
        match self {
            Self::Mae => 1,
            Self::Multiscale => 5,
        }
    }

    /// The loss of two tensors `[n, c, h, w]`: the mean over the scales `s` of the sum of `|sum of output - target|` over
    /// squares of `2^s` pixels, those at the edges cut off, divided by `n * c * h * w`.
    pub fn reference(self, output: &Tensor<f64>, target: &Tensor<f64>) -> f64 {
        let errors = differences(output, target);
        let sums: f64 = (0..self.scales()).flat_map(|s| square_sums(&errors, s).data).map(f64::abs).sum();
        sums / (f64::from(self.scales()) * output.len() as f64)
    }

    /// Its gradient with respect to the output, with `sign(0) = 0`.
    pub fn reference_backward(self, output: &Tensor<f64>, target: &Tensor<f64>) -> Tensor<f64> {
        let errors = differences(output, target);
        let [_, _, h, w] = errors.shape;
        let mut gradient = Tensor::new(errors.shape, vec![0.0; errors.len()]);
        for s in 0..self.scales() {
            let sums = square_sums(&errors, s);
            let [_, _, rows, columns] = sums.shape;
            for (i, g) in gradient.data.iter_mut().enumerate() {
                let (plane, y, x) = (i / (h * w), i / w % h, i % w);
                let sum = sums.data[(plane * rows + (y >> s)) * columns + (x >> s)];
                *g += if sum == 0.0 { 0.0 } else { sum.signum() };
            }
        }
        let count = f64::from(self.scales()) * errors.len() as f64;
        gradient.data.iter_mut().for_each(|g| *g /= count);
        gradient
    }
}

fn differences(output: &Tensor<f64>, target: &Tensor<f64>) -> Tensor<f64> {
    assert_eq!(output.shape, target.shape);
    Tensor::new(output.shape, output.data.iter().zip(&target.data).map(|(o, t)| o - t).collect())
}

/// Sums over squares of `2^scale` pixels, those at the edges cut off.
fn square_sums(values: &Tensor<f64>, scale: u32) -> Tensor<f64> {
    let [n, c, h, w] = values.shape;
    let (rows, columns) = (h.div_ceil(1 << scale), w.div_ceil(1 << scale));
    let mut sums = Tensor::new([n, c, rows, columns], vec![0.0; n * c * rows * columns]);
    for (i, v) in values.data.iter().enumerate() {
        let (plane, y, x) = (i / (h * w), i / w % h, i % w);
        sums.data[(plane * rows + (y >> scale)) * columns + (x >> scale)] += v;
    }
    sums
}
