//! Leaky ReLU: `y = x` where `x > 0`, `slope * x` elsewhere.

use crate::net::tensor::Tensor;

/// The activation of every element; any shape.
pub fn reference(input: &Tensor<f64>, slope: f64) -> Tensor<f64> {
    input.map(|x| if x > 0.0 { x } else { slope * x })
}

/// The gradient with respect to the input, from the stored `output` (the input is not kept).
///
/// The derivative is 1 where `output > 0` and `slope` elsewhere, at zero too (PyTorch's convention). The sign of the
/// output is the sign of the input for every `slope >= 0`; with `slope = 0` (ReLU) both are "not positive".
pub fn reference_backward(output: &Tensor<f64>, output_gradient: &Tensor<f64>, slope: f64) -> Tensor<f64> {
    assert_eq!(output.shape, output_gradient.shape);
    let data = output.data.iter().zip(&output_gradient.data);
    Tensor::new(output.shape, data.map(|(&y, &dy)| if y > 0.0 { dy } else { slope * dy }).collect())
}
