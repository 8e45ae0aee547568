//! Radiance without the texture of the surface, from the input of a network and back to its space.
//!
//! The input's channels are radiance in the transfer `pu`, albedo and normal, three each. Demodulated pixels have four: radiance
//! r, g, b, divided by albedo plus [`OFFSET`], and 1 inside the picture, 0 past its end. What has no albedo, an emitter or the sky, is divided
//! by 1: as bright as it is, no weight small enough would keep it from its neighbours if it were made brighter.

use super::pu;
use crate::net::tensor::Tensor;
use crate::shared_constants::DEMODULATION;

/// What is added to albedo.
pub const OFFSET: f64 = 1.0 / DEMODULATION as f64;

/// `pu⁻¹(radiance) / texture`: (N, 9, H, W) to (N, 4, H, W). A pixel whose nine channels are 0 lies past the picture's end.
pub fn reference(input: &Tensor<f64>) -> Tensor<f64> {
    let [batch, channels, height, width] = input.shape;
    assert_eq!(channels, 9, "radiance, albedo and normal");
    let mut output = Tensor::zeros([batch, 4, height, width]);
    each_pixel([batch, height, width], |n, y, x| {
        if (0..9).any(|c| input.at(n, c, y, x) != 0.0) {
            for c in 0..3 {
                let i = output.index(n, c, y, x);
                output.data[i] = pu::inverse(input.at(n, c, y, x)) / texture(input, [n, y, x])[c];
            }
            let i = output.index(n, 3, y, x);
            output.data[i] = 1.0;
        }
    });
    output
}

/// `pu(radiance * texture)`: demodulated (N, 4, H, W) and the network's input (N, 9, H, W) to (N, 3, H, W).
pub fn modulate_reference(radiance: &Tensor<f64>, input: &Tensor<f64>) -> Tensor<f64> {
    modulated(radiance, input, |x, factor| pu::forward(x * factor))
}

/// The gradient of [`modulate_reference`] with respect to the radiance; nothing before the input has parameters.
pub fn modulate_reference_backward(radiance: &Tensor<f64>, input: &Tensor<f64>, dy: &Tensor<f64>) -> Tensor<f64> {
    let slopes = modulated(radiance, input, |x, factor| pu::derivative(x * factor) * factor);
    let mut gradient = Tensor::zeros(radiance.shape);
    each_pixel([radiance.shape[0], radiance.shape[2], radiance.shape[3]], |n, y, x| {
        for c in 0..3 {
            let i = gradient.index(n, c, y, x);
            gradient.data[i] = dy.at(n, c, y, x) * slopes.at(n, c, y, x);
        }
    });
    gradient
}

/// What radiance is divided by: albedo + [`OFFSET`], or 1 where there is no albedo.
fn texture(input: &Tensor<f64>, [n, y, x]: [usize; 3]) -> [f64; 3] {
    let albedo = [3, 4, 5].map(|c| input.at(n, c, y, x));
    if albedo == [0.0; 3] { [1.0; 3] } else { albedo.map(|a| a + OFFSET) }
}

/// `f(radiance, texture)` of the three channels.
fn modulated(radiance: &Tensor<f64>, input: &Tensor<f64>, f: impl Fn(f64, f64) -> f64) -> Tensor<f64> {
    let [batch, _, height, width] = radiance.shape;
    assert_eq!(input.shape, [batch, 9, height, width]);
    let mut output = Tensor::zeros([batch, 3, height, width]);
    each_pixel([batch, height, width], |n, y, x| {
        for c in 0..3 {
            let i = output.index(n, c, y, x);
            output.data[i] = f(radiance.at(n, c, y, x), texture(input, [n, y, x])[c]);
        }
    });
    output
}

/// Runs `f(n, y, x)` for every pixel.
pub(super) fn each_pixel([batch, height, width]: [usize; 3], mut f: impl FnMut(usize, usize, usize)) {
    for n in 0..batch {
        for y in 0..height {
            (0..width).for_each(|x| f(n, y, x));
        }
    }
}
