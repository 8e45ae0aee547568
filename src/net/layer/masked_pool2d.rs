//! 2x2 mean, with stride 2, of those pixels that lie inside the picture.

use super::demodulate::each_pixel;
use crate::net::tensor::Tensor;

/// Demodulated pixels (N, 4, H, W), the last channel 1 inside and 0 past the end, to (N, 4, H/2, W/2), inside where any of the four is.
pub fn reference(input: &Tensor<f64>) -> Tensor<f64> {
    let [batch, channels, height, width] = input.shape;
    assert_eq!(channels, 4, "r, g, b and whether the pixel is inside");
    let mut output = Tensor::zeros([batch, 4, height / 2, width / 2]);
    each_pixel([batch, height / 2, width / 2], |n, y, x| {
        let four = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(dy, dx)| (2 * y + dy, 2 * x + dx));
        let inside: f64 = four.iter().map(|&(y, x)| input.at(n, 3, y, x)).sum();
        for c in 0..3 {
            let sum: f64 = four.iter().map(|&(y, x)| input.at(n, c, y, x) * input.at(n, 3, y, x)).sum();
            let i = output.index(n, c, y, x);
            output.data[i] = sum / inside.max(1.0);
        }
        let i = output.index(n, 3, y, x);
        output.data[i] = inside.min(1.0);
    });
    output
}
