//! One whole training step in f64: the oracle of the device's step.

use super::adam::{Adam, ReferenceState};
use super::loss::Loss;
use crate::net::architecture::Architecture;
use crate::net::reference::{backward, forward};
use crate::net::tensor::Tensor;

/// The loss and its gradient with respect to the flat parameter vector, which stays as it is.
///
/// `input` (N, Cin, H, W), `target` (N, Cout, H, W).
pub fn gradient(
    (architecture, loss): (&Architecture, Loss),
    parameters: &[f64],
    input: &Tensor<f64>,
    target: &Tensor<f64>,
) -> (f64, Vec<f64>) {
    let values = forward(architecture, parameters, input);
    let output = &values[values.len() - 1];
    let output_gradient = loss.reference_backward(output, target);
    (loss.reference(output, target), backward(architecture, parameters, &values, &output_gradient).parameters)
}

/// One step of training: the loss before it, `parameters` and `state` after it.
pub fn step(
    (architecture, loss): (&Architecture, Loss),
    adam: &Adam,
    state: &mut ReferenceState,
    parameters: &mut [f64],
    input: &Tensor<f64>,
    target: &Tensor<f64>,
) -> f64 {
    let (loss, gradient) = gradient((architecture, loss), parameters, input, target);
    adam.reference(state, parameters, &gradient);
    loss
}
