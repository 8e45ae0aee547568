//! The loss: mean absolute error.

use crate::net::tensor::Tensor;

/// The mean over all N * C * H * W elements of `|output - target|`.
pub fn reference(output: &Tensor<f64>, target: &Tensor<f64>) -> f64 {
    assert_eq!(output.shape, target.shape);
    let sum: f64 = output.data.iter().zip(&target.data).map(|(o, t)| (o - t).abs()).sum();
    sum / output.len() as f64
}

/// Its gradient with respect to the output: `sign(output - target) / (N * C * H * W)`, with `sign(0) = 0`.
pub fn reference_backward(output: &Tensor<f64>, target: &Tensor<f64>) -> Tensor<f64> {
    assert_eq!(output.shape, target.shape);
    let count = output.len() as f64;
    let gradient = |(o, t): (&f64, &f64)| if o == t { 0.0 } else { (o - t).signum() / count };
    Tensor::new(output.shape, output.data.iter().zip(&target.data).map(gradient).collect())
}
