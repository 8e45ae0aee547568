//! Nearest-neighbour upsampling by 2 in both directions.

use crate::net::tensor::Tensor;

/// The shape of the output.
pub fn output_shape([n, c, h, w]: [usize; 4]) -> [usize; 4] {
    [n, c, 2 * h, 2 * w]
}

/// Every element four times: (N, C, H, W) to (N, C, 2H, 2W).
pub fn reference(input: &Tensor<f64>) -> Tensor<f64> {
    let [batch, channels, height, width] = output_shape(input.shape);
    let mut output = Tensor::zeros([batch, channels, height, width]);
    for n in 0..batch {
        for c in 0..channels {
            for y in 0..height {
                for x in 0..width {
                    let i = output.index(n, c, y, x);
                    output.data[i] = input.at(n, c, y / 2, x / 2);
                }
            }
        }
    }
    output
}

/// The gradient with respect to the input: the sum over the four copies of each element.
pub fn reference_backward(output_gradient: &Tensor<f64>) -> Tensor<f64> {
    let [batch, channels, height, width] = output_gradient.shape;
    assert!(height % 2 == 0 && width % 2 == 0, "an upsampled tensor has even sizes, not {:?}", output_gradient.shape);
    let mut gradient = Tensor::zeros([batch, channels, height / 2, width / 2]);
    for n in 0..batch {
        for c in 0..channels {
            for y in 0..height {
                for x in 0..width {
                    let i = gradient.index(n, c, y / 2, x / 2);
                    gradient.data[i] += output_gradient.at(n, c, y, x);
                }
            }
        }
    }
    gradient
}
