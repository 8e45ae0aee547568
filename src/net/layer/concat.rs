//! Concatenation of two tensors along the channels.

use crate::net::tensor::Tensor;

/// The shape of the output; panics where anything but the channels differs.
pub fn output_shape(first: [usize; 4], second: [usize; 4]) -> [usize; 4] {
    let [n, c, h, w] = first;
    assert_eq!([n, h, w], [second[0], second[2], second[3]], "concat of {first:?} and {second:?}");
    [n, c + second[1], h, w]
}

/// The channels of `first`, then those of `second`: PyTorch's `cat([first, second], dim=1)`.
pub fn reference(first: &Tensor<f64>, second: &Tensor<f64>) -> Tensor<f64> {
    let shape = output_shape(first.shape, second.shape);
    let mut data = Vec::with_capacity(shape.iter().product());
    for n in 0..shape[0] {
        (0..first.shape[1]).for_each(|c| data.extend_from_slice(first.plane(n, c)));
        (0..second.shape[1]).for_each(|c| data.extend_from_slice(second.plane(n, c)));
    }
    Tensor::new(shape, data)
}

/// The gradients with respect to both inputs: the output gradient, split after `first_channels` channels.
pub fn reference_backward(output_gradient: &Tensor<f64>, first_channels: usize) -> (Tensor<f64>, Tensor<f64>) {
    let [batch, channels, height, width] = output_gradient.shape;
    let part = |from: usize, to: usize| {
        let planes = (0..batch).flat_map(|n| (from..to).flat_map(move |c| output_gradient.plane(n, c)));
        Tensor::new([batch, to - from, height, width], planes.copied().collect())
    };
    (part(0, first_channels), part(first_channels, channels))
}
