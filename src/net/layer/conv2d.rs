//! 3x3 convolution, stride 1, zero padding 1, OIHW weights, with bias (a cross-correlation, as in PyTorch).

use crate::net::tensor::Tensor;
use rayon::prelude::*;

/// The gradients of a convolution.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients<T = f64> {
    /// With respect to the input, (N, Cin, H, W).
    pub input: Tensor<T>,
    /// With respect to the weights, (Cout, Cin, 3, 3).
    pub weight: Tensor<T>,
    /// With respect to the bias, (Cout).
    pub bias: Vec<T>,
}

/// The shape of the output; panics where the weights are not (Cout, Cin, 3, 3).
pub fn output_shape([n, c, h, w]: [usize; 4], weight: [usize; 4]) -> [usize; 4] {
    assert_eq!(weight[1..], [c, 3, 3], "weights {weight:?} on an input of {c} channels");
    [n, weight[0], h, w]
}

/// `sum[y][x] += factor * plane[y + ky - 1][x + kx - 1]`, zero outside the plane.
fn add_shifted(sum: &mut [f64], plane: &[f64], [height, width]: [usize; 2], [ky, kx]: [usize; 2], factor: f64) {
    for y in 0..height {
        let Some(source_y) = (y + ky).checked_sub(1).filter(|&s| s < height) else { continue };
        let source = &plane[source_y * width..][..width];
        let target = &mut sum[y * width..][..width];
        let (target, source) = match kx {
            0 => (&mut target[1..], &source[..width - 1]),
            1 => (target, source),
            _ => (&mut target[..width - 1], &source[1..]),
        };
        target.iter_mut().zip(source).for_each(|(t, s)| *t += factor * s);
    }
}

/// The sum of `gradient[y][x] * plane[y + ky - 1][x + kx - 1]`, zero outside the plane.
fn dot_shifted(gradient: &[f64], plane: &[f64], [height, width]: [usize; 2], [ky, kx]: [usize; 2]) -> f64 {
    let mut sum = 0.0;
    for y in 0..height {
        let Some(source_y) = (y + ky).checked_sub(1).filter(|&s| s < height) else { continue };
        let source = &plane[source_y * width..][..width];
        let target = &gradient[y * width..][..width];
        let (target, source) = match kx {
            0 => (&target[1..], &source[..width - 1]),
            1 => (target, source),
            _ => (&target[..width - 1], &source[1..]),
        };
        sum += target.iter().zip(source).map(|(t, s)| t * s).sum::<f64>();
    }
    sum
}

/// `y[n][o][y][x] = bias[o] + sum over i, ky, kx of weight[o][i][ky][kx] * x[n][i][y + ky - 1][x + kx - 1]`.
///
/// `input` (N, Cin, H, W), `weight` (Cout, Cin, 3, 3), `bias` (Cout), result (N, Cout, H, W).
pub fn reference(input: &Tensor<f64>, weight: &Tensor<f64>, bias: &[f64]) -> Tensor<f64> {
    let shape = output_shape(input.shape, weight.shape);
    let [_, cout, height, width] = shape;
    assert_eq!(bias.len(), cout);
    let mut output = Tensor::zeros(shape);
    if output.is_empty() {
        return output;
    }
    output.data.par_chunks_mut(height * width).enumerate().for_each(|(plane, sum)| {
        let (n, o) = (plane / cout, plane % cout);
        sum.fill(bias[o]);
        for i in 0..input.shape[1] {
            for (ky, kx) in taps() {
                add_shifted(sum, input.plane(n, i), [height, width], [ky, kx], weight.at(o, i, ky, kx));
            }
        }
    });
    output
}

/// The nine (ky, kx), row by row.
fn taps() -> impl Iterator<Item = (usize, usize)> {
    (0..9).map(|tap| (tap / 3, tap % 3))
}

/// All gradients, from the gradient with respect to the output (N, Cout, H, W).
pub fn reference_backward(input: &Tensor<f64>, weight: &Tensor<f64>, output_gradient: &Tensor<f64>) -> Gradients {
    assert_eq!(output_gradient.shape, output_shape(input.shape, weight.shape));
    Gradients {
        input: reference_input_gradient(weight, output_gradient),
        weight: reference_weight_gradient(input, output_gradient),
        bias: reference_bias_gradient(output_gradient),
    }
}

/// dgrad: `dx[n][i][y][x] = sum over o, ky, kx of weight[o][i][ky][kx] * dy[n][o][y - ky + 1][x - kx + 1]`.
pub fn reference_input_gradient(weight: &Tensor<f64>, output_gradient: &Tensor<f64>) -> Tensor<f64> {
    let [batch, cout, height, width] = output_gradient.shape;
    assert_eq!(weight.shape[0], cout);
    let cin = weight.shape[1];
    let mut gradient = Tensor::zeros([batch, cin, height, width]);
    if gradient.is_empty() {
        return gradient;
    }
    gradient.data.par_chunks_mut(height * width).enumerate().for_each(|(plane, sum)| {
        let (n, i) = (plane / cin, plane % cin);
        for o in 0..cout {
            for (ky, kx) in taps() {
                let (shift, factor) = ([2 - ky, 2 - kx], weight.at(o, i, ky, kx));
                add_shifted(sum, output_gradient.plane(n, o), [height, width], shift, factor);
            }
        }
    });
    gradient
}

/// wgrad: `dw[o][i][ky][kx] = sum over n, y, x of dy[n][o][y][x] * x[n][i][y + ky - 1][x + kx - 1]`.
pub fn reference_weight_gradient(input: &Tensor<f64>, output_gradient: &Tensor<f64>) -> Tensor<f64> {
    let [batch, cout, height, width] = output_gradient.shape;
    let cin = input.shape[1];
    let mut gradient = Tensor::zeros([cout, cin, 3, 3]);
    gradient.data.par_chunks_mut(9).enumerate().for_each(|(pair, sums)| {
        let (o, i) = (pair / cin, pair % cin);
        for (sum, (ky, kx)) in sums.iter_mut().zip(taps()) {
            let image = |n| dot_shifted(output_gradient.plane(n, o), input.plane(n, i), [height, width], [ky, kx]);
            *sum = (0..batch).map(image).sum();
        }
    });
    gradient
}

/// `db[o] = sum over n, y, x of dy[n][o][y][x]`.
pub fn reference_bias_gradient(output_gradient: &Tensor<f64>) -> Vec<f64> {
    let [batch, cout, ..] = output_gradient.shape;
    (0..cout).map(|o| (0..batch).flat_map(|n| output_gradient.plane(n, o)).sum()).collect()
}

/// What f32 arithmetic may add to a sum of `terms` products whose absolute values sum to `magnitude`:
/// `2 * sqrt(terms) * 2^-24 * magnitude`, for any order of summation.
///
/// Each of the `terms` roundings has a relative size of at most 2^-24 and no common sign, so that they add up like a
/// random walk; the factor 2 covers the rounding of the products.
pub fn rounding_bound(terms: usize, magnitude: f64) -> f64 {
    2.0 * (terms as f64).sqrt() * f64::powi(2.0, -24) * magnitude
}

/// The elementwise [`rounding_bound`] of [`fn@reference`] in f32: `Cin * 9 + 1` terms.
pub fn forward_bound(input: &Tensor<f64>, weight: &Tensor<f64>, bias: &[f64]) -> Tensor<f64> {
    let bias: Vec<f64> = bias.iter().map(|b| b.abs()).collect();
    let terms = 9 * input.shape[1] + 1;
    reference(&input.map(f64::abs), &weight.map(f64::abs), &bias).map(|sum| rounding_bound(terms, sum))
}

/// The elementwise [`rounding_bound`]s of [`fn@reference_backward`] in f32: `Cout * 9` terms for the input gradient,
/// `N * H * W` for those of weights and bias.
pub fn backward_bounds(input: &Tensor<f64>, weight: &Tensor<f64>, output_gradient: &Tensor<f64>) -> Gradients {
    let [batch, cout, height, width] = output_gradient.shape;
    let pixels = batch * height * width;
    let sums = reference_backward(&input.map(f64::abs), &weight.map(f64::abs), &output_gradient.map(f64::abs));
    Gradients {
        input: sums.input.map(|sum| rounding_bound(9 * cout, sum)),
        weight: sums.weight.map(|sum| rounding_bound(pixels, sum)),
        bias: sums.bias.into_iter().map(|sum| rounding_bound(pixels, sum)).collect(),
    }
}
