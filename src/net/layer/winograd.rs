//! What rounding may do to a 3x3 convolution by Winograd's F(4x4, 3x3), interpolation points 0, 1, -1, 2, -2.

use super::conv2d;
use crate::net::tensor::Tensor;

/// Absolute values of the rows of B^T, G and A^T.
const INPUT: [[f64; 6]; 6] = [
    [4.0, 0.0, 5.0, 0.0, 1.0, 0.0],
    [0.0, 4.0, 4.0, 1.0, 1.0, 0.0],
    [0.0, 4.0, 4.0, 1.0, 1.0, 0.0],
    [0.0, 2.0, 1.0, 2.0, 1.0, 0.0],
    [0.0, 2.0, 1.0, 2.0, 1.0, 0.0],
    [0.0, 4.0, 0.0, 5.0, 0.0, 1.0],
];
const WEIGHT: [[f64; 3]; 6] = [
    [0.25, 0.0, 0.0],
    [1.0 / 6.0, 1.0 / 6.0, 1.0 / 6.0],
    [1.0 / 6.0, 1.0 / 6.0, 1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
    [0.0, 0.0, 1.0],
];
const OUTPUT: [[f64; 6]; 4] = [
    [1.0, 1.0, 1.0, 1.0, 1.0, 0.0],
    [0.0, 1.0, 1.0, 2.0, 2.0, 0.0],
    [0.0, 1.0, 1.0, 4.0, 4.0, 0.0],
    [0.0, 1.0, 1.0, 8.0, 8.0, 1.0],
];
/// Roundings on the way of a product outside the sum over channels: 3 of each pass of the two input transforms, 3 of each of
/// the weights', 5 of each of the output's, the bias.
const TRANSFORM_ROUNDINGS: usize = 23;

/// `rows x d x rows^T` of an `N x N` matrix.
fn both<const N: usize, const M: usize>(rows: &[[f64; N]; M], d: [[f64; N]; N]) -> [[f64; M]; M] {
    let mut out = [[0.0; M]; M];
    for (i, out) in out.iter_mut().enumerate() {
        for (j, out) in out.iter_mut().enumerate() {
            for a in 0..N {
                *out += rows[i][a] * (0..N).map(|b| d[a][b] * rows[j][b]).sum::<f64>();
            }
        }
    }
    out
}

/// How far a Winograd convolution in f32 may be from [`conv2d::reference`], element by element: the rounding of a sum of as many terms as there are roundings on a product's
/// way, whose magnitude is that of the transforms and products of absolute values.
pub fn bound(x: &Tensor<f64>, weight: &Tensor<f64>, bias: &[f64]) -> Tensor<f64> {
    let [batch, cin, height, width] = x.shape;
    let cout = weight.shape[0];
    let mut out = Tensor::zeros([batch, cout, height, width]);
    let weights: Vec<[[f64; 6]; 6]> = (0..cout * cin)
        .map(|pair| {
            both(
                &WEIGHT,
                std::array::from_fn(|a| std::array::from_fn(|b| weight.at(pair / cin, pair % cin, a, b).abs())),
            )
        })
        .collect();
    for n in 0..batch {
        for (y0, x0) in (0..height).step_by(4).flat_map(|y| (0..width).step_by(4).map(move |x| (y, x))) {
            let at = |c: usize, a: usize, b: usize| match ((y0 + a).checked_sub(1), (x0 + b).checked_sub(1)) {
                (Some(y), Some(px)) if y < height && px < width => x.at(n, c, y, px).abs(),
                _ => 0.0,
            };
            let patches: Vec<_> =
                (0..cin).map(|c| both(&INPUT, std::array::from_fn(|a| std::array::from_fn(|b| at(c, a, b))))).collect();
            for o in 0..cout {
                let product =
                    |a: usize, b: usize| (0..cin).map(|c| weights[o * cin + c][a][b] * patches[c][a][b]).sum::<f64>();
                let tile = both(&OUTPUT, std::array::from_fn(|a| std::array::from_fn(|b| product(a, b))));
                for y in y0..(y0 + 4).min(height) {
                    for px in x0..(x0 + 4).min(width) {
                        let magnitude = tile[y - y0][px - x0] + bias[o].abs();
                        let index = out.index(n, o, y, px);
                        out.data[index] = conv2d::rounding_bound(cin + TRANSFORM_ROUNDINGS, magnitude);
                    }
                }
            }
        }
    }
    out
}
