//! Max pooling over 2x2 windows, stride 2; an odd last row or column is dropped.

use crate::net::tensor::Tensor;

/// The shape of the output.
pub fn output_shape([n, c, h, w]: [usize; 4]) -> [usize; 4] {
    [n, c, h / 2, w / 2]
}

/// The index, into `input.data`, of the element that a window selects: the first maximum in row-major order, or the
/// last NaN, as in PyTorch.
fn selected(input: &Tensor<f64>, n: usize, c: usize, y: usize, x: usize) -> usize {
    let mut best = input.index(n, c, 2 * y, 2 * x);
    for (dy, dx) in [(0, 1), (1, 0), (1, 1)] {
        let candidate = input.index(n, c, 2 * y + dy, 2 * x + dx);
        if input.data[candidate] > input.data[best] || input.data[candidate].is_nan() {
            best = candidate;
        }
    }
    best
}

/// For each output element in order, the index of the input element that it takes.
fn selection(input: &Tensor<f64>) -> Vec<usize> {
    let [batch, channels, height, width] = output_shape(input.shape);
    let mut all = Vec::with_capacity(batch * channels * height * width);
    for n in 0..batch {
        for c in 0..channels {
            for y in 0..height {
                all.extend((0..width).map(|x| selected(input, n, c, y, x)));
            }
        }
    }
    all
}

/// The maximum of every window: (N, C, H, W) to (N, C, H/2, W/2).
pub fn reference(input: &Tensor<f64>) -> Tensor<f64> {
    Tensor::new(output_shape(input.shape), selection(input).into_iter().map(|i| input.data[i]).collect())
}

/// The gradient with respect to `input`: each window's gradient goes whole to its first maximum in row-major order;
/// everything else, a dropped odd row or column too, gets zero.
pub fn reference_backward(input: &Tensor<f64>, output_gradient: &Tensor<f64>) -> Tensor<f64> {
    assert_eq!(output_gradient.shape, output_shape(input.shape));
    let mut gradient = Tensor::zeros(input.shape);
    for (i, &dy) in selection(input).into_iter().zip(&output_gradient.data) {
        gradient.data[i] = dy;
    }
    gradient
}
