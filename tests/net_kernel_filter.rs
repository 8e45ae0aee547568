//! The layers of a kernel-predicting network: by hand, against central differences, and their kernels against the reference.

mod common;

use common::compare::{close, require, tensors_close, within};
use common::{goldens, gpu};
use limpid::gpu::{Gpu, Recorder};
use limpid::net::device::{Channels, DeviceTensor, Shape};
use limpid::net::kernel::{demodulate as demodulate_kernel, kernel_filter as filter_kernel};
use limpid::net::layer::{demodulate, kernel_filter, masked_pool2d, pu};
use limpid::net::tensor::Tensor;
use limpid::train::kernel::kernel_filter as gradient_kernel;

/// Uniform in [0, 1), the last channel 1 but for the last two rows and three columns; what lies there is 0.
fn pixels([n, h, w]: [usize; 3], name: &str) -> Tensor<f32> {
    let mut pixels = goldens::drawn([n, 4, h, w], name).map(f32::abs);
    for i in 0..pixels.len() {
        let (channel, y, x) = (i / (h * w) % 4, i / w % h, i % w);
        let inside = (y + 2 < h || h < 4) && (x + 3 < w || w < 6);
        pixels.data[i] = if !inside {
            0.0
        } else if channel == 3 {
            1.0
        } else {
            pixels.data[i]
        };
    }
    pixels
}

/// Of a filter of `[n, h, w]` pixels: logits within `range`, noisy pixels, the coarser level, the gradient of the result.
struct Case {
    logits: Tensor<f32>,
    fine: Tensor<f32>,
    coarse: Option<Tensor<f32>>,
    dy: Tensor<f32>,
}

impl Case {
    fn new([n, h, w]: [usize; 3], coarse: bool, range: f32) -> Self {
        let name = format!("kernel_filter/{n}/{h}/{w}/{coarse}");
        let logits = [n, kernel_filter::logits(coarse), h, w];
        let mut dy = goldens::drawn([n, 4, h, w], &format!("{name}/dy"));
        (0..dy.len()).filter(|i| i / (h * w) % 4 == 3).collect::<Vec<_>>().into_iter().for_each(|i| dy.data[i] = 0.0);
        Self {
            logits: goldens::drawn(logits, &format!("{name}/logits")).map(|v| range * v),
            fine: pixels([n, h, w], &format!("{name}/fine")),
            coarse: coarse.then(|| pixels([n, h / 2, w / 2], &format!("{name}/coarse"))),
            dy,
        }
    }

    fn reference(&self) -> Tensor<f64> {
        let coarse = self.coarse.as_ref().map(Tensor::to_f64);
        kernel_filter::reference(&self.logits.to_f64(), &self.fine.to_f64(), coarse.as_ref())
    }

    fn gradients(&self) -> kernel_filter::Gradients {
        let coarse = self.coarse.as_ref().map(Tensor::to_f64);
        let (logits, fine, dy) = (self.logits.to_f64(), self.fine.to_f64(), self.dy.to_f64());
        kernel_filter::reference_backward(&logits, &fine, coarse.as_ref(), &dy)
    }
}

fn upload(gpu: &Gpu, tensor: &Tensor<f32>) -> DeviceTensor {
    let device = empty(gpu, tensor.shape);
    device.upload(gpu, &tensor.data).unwrap();
    device
}

/// A tensor of NaN.
fn empty(gpu: &Gpu, [n, c, h, w]: [usize; 4]) -> DeviceTensor {
    let shape = Shape { n: n as u32, h: h as u32, w: w as u32, c: Channels::new(c as u32) };
    let tensor = DeviceTensor::new(gpu, "test", shape).unwrap();
    gpu.upload(&tensor.slice, &vec![f32::NAN; tensor.slice.bytes() as usize / 4]).unwrap();
    tensor
}

fn run(gpu: &Gpu, record: impl FnOnce(&mut Recorder)) {
    let mut rec = gpu.recorder();
    record(&mut rec);
    let mut commands = rec.finish().unwrap();
    limpid::gpu::hazard::check(commands.events()).unwrap();
    commands.run().unwrap();
}

/// The result, and the gradients with respect to logits and coarser level, on the device.
fn on_device(gpu: &Gpu, case: &Case) -> (Vec<f32>, Vec<f32>, Option<Vec<f32>>) {
    let [logits, fine, dy] = [&case.logits, &case.fine, &case.dy].map(|t| upload(gpu, t));
    let coarse = case.coarse.as_ref().map(|t| upload(gpu, t));
    let operands = filter_kernel::Operands { logits: &logits, fine: &fine, coarse: coarse.as_ref() };
    let [y, d_logits] = [case.fine.shape, case.logits.shape].map(|shape| empty(gpu, shape));
    let d_coarse = case.coarse.as_ref().map(|t| empty(gpu, t.shape));
    let kept = gpu.buffer("kept", y.slice.bytes()).unwrap().all();
    run(gpu, |rec| {
        filter_kernel::record(gpu, rec, operands, &y).unwrap();
        gradient_kernel::logits(gpu, rec, operands, &dy, &kept, &d_logits).unwrap();
        if let (Some(coarse), Some(d_coarse)) = (&coarse, &d_coarse) {
            gradient_kernel::coarse(gpu, rec, &logits, coarse, &kept, d_coarse).unwrap();
        }
    });
    require("padding", common::padding_is_zero(gpu, &d_logits));
    let read = |tensor: &DeviceTensor| tensor.download(gpu).unwrap();
    (read(&y), read(&d_logits), d_coarse.as_ref().map(read))
}

const SIZES: [[usize; 3]; 6] = [[1, 1, 1], [1, 2, 2], [2, 6, 10], [1, 26, 4], [3, 8, 14], [1, 38, 70]];

/// Logits within 4 of 0, so that no exponent is over 8: exp, of 3 + 2 * 8 units, and the sums of 34 lose less than 60 units of
/// 2^-24 in weights and result; twice, for the norm.
const BOUND: f64 = 120.0 / 16_777_216.0;

#[test]
fn filters_equal_the_reference() {
    let gpu = gpu();
    for (size, coarse) in SIZES.into_iter().flat_map(|size| [(size, false), (size, true)]) {
        if coarse && size[1] % 2 == 1 {
            continue;
        }
        let case = Case::new(size, coarse, 4.0);
        let (y, d_logits, d_coarse) = on_device(&gpu, &case);
        let (expected, gradients) = (case.reference(), case.gradients());
        let what = format!("{size:?}, coarse {coarse}");
        require(&what, close(&y, &expected.data, BOUND, 0.0));
        // Three products of numbers within 1; up to 36 pixels read one of the coarser level.
        require(&format!("{what}, logits"), close(&d_logits, &gradients.logits.data, 3.0 * BOUND, 0.0));
        if let (Some(actual), Some(expected)) = (d_coarse, gradients.coarse) {
            require(&format!("{what}, coarse"), close(&actual, &expected.data, 36.0 * BOUND, 0.0));
        }
    }
}

/// Equal logits make plain means, cut off at the edge and at the picture's end; one large logit takes one pixel.
#[test]
fn filters_by_hand() {
    let [h, w] = [6usize, 8];
    let mut fine = Tensor::zeros([1, 4, h, w]).map(|_: f64| 1.0);
    for y in 0..h {
        for x in 0..w {
            let inside = x < 6;
            let (value, mask) = (fine.index(0, 0, y, x), fine.index(0, 3, y, x));
            fine.data[value] = if inside { (y * w + x) as f64 } else { 1e9 };
            fine.data[mask] = f64::from(u8::from(inside));
        }
    }
    let coarse = Tensor::zeros([1, 4, 3, 4]).map(|_: f64| 1.0);
    let mut logits = Tensor::zeros([1, 25, h, w]);
    let mean = kernel_filter::reference(&logits, &fine, None);
    // Rows 0 to 2, columns 0 to 2; then rows 3 to 5, columns 3 to 5: beyond them nothing is inside.
    assert!((mean.at(0, 0, 0, 0) - 9.0).abs() < 1e-12 && (mean.at(0, 0, 5, 5) - 36.0).abs() < 1e-12);
    assert!((mean.at(0, 0, 2, 2) - 18.0).abs() < 1e-12, "all 25");
    assert_eq!(mean.at(0, 3, 0, 7), 1.0, "column 5 is near");
    let right = 2 * 5 + 3;
    let at = logits.index(0, right, 2, 2);
    logits.data[at] = 50.0;
    assert!((kernel_filter::reference(&logits, &fine, None).at(0, 0, 2, 2) - 19.0).abs() < 1e-9);
    let logits = Tensor::zeros([1, 34, h, w]);
    let both = kernel_filter::reference(&logits, &fine, Some(&coarse));
    // The spline's nine weights add up to 1; at a corner (22 + 1) / 32 of them is left in both directions.
    assert!((both.at(0, 0, 2, 2) - (25.0 * 18.0 + 1.0) / 26.0).abs() < 1e-9);
    let left = (23.0f64 / 32.0).powi(2);
    assert!((both.at(0, 0, 0, 0) - (9.0 * 9.0 + left) / (9.0 + left)).abs() < 1e-9);
}

/// With equal logits the coarser level is interpolated: what rises evenly there rises evenly here, in both directions.
#[test]
fn equal_logits_interpolate_the_coarser_level() {
    let [h, w] = [16usize, 20];
    let mut logits = Tensor::<f64>::zeros([1, 34, h, w]);
    let noisy = 25 * h * w;
    logits.data[..noisy].fill(-200.0);
    let mut fine = Tensor::zeros([1, 4, h, w]);
    let mut coarse = Tensor::zeros([1, 4, h / 2, w / 2]);
    for (tensor, scale) in [(&mut fine, 1.0), (&mut coarse, 2.0)] {
        let [_, _, h, w] = tensor.shape;
        for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
            let (red, mask) = (tensor.index(0, 0, y, x), tensor.index(0, 3, y, x));
            tensor.data[red] = scale * (3.0 * (x as f64 + 0.5) + 5.0 * (y as f64 + 0.5));
            tensor.data[mask] = 1.0;
        }
    }
    let y = kernel_filter::reference(&logits, &fine, Some(&coarse));
    let inner = (2..h - 2).flat_map(|row| (2..w - 2).map(move |column| (row, column)));
    for (row, column) in inner {
        let expected = fine.at(0, 0, row, column);
        assert!((y.at(0, 0, row, column) - expected).abs() < 1e-9, "{row}, {column}");
    }
}

#[test]
fn a_pixel_that_nothing_is_near_is_zero() {
    let gpu = gpu();
    let mut case = Case::new([1, 8, 14], true, 4.0);
    case.fine.data.fill(0.0);
    case.coarse.as_mut().unwrap().data.fill(0.0);
    let (y, d_logits, d_coarse) = on_device(&gpu, &case);
    assert!([y, d_logits, d_coarse.unwrap()].concat().iter().all(|v| *v == 0.0));
    assert!(case.reference().data.iter().all(|v| *v == 0.0));
}

/// Radiance of 1e30 and of 0, logits of thousands, the largest of which lie past the end: results stay between the least and the
/// largest of what they are made of.
#[test]
fn extreme_values_stay_within_what_is_filtered() {
    let gpu = gpu();
    let mut case = Case::new([1, 38, 70], true, 5000.0);
    let area = 38 * 70;
    for (i, value) in case.fine.data.iter_mut().enumerate().filter(|(i, _)| i / area < 3) {
        *value = match i % 7 {
            0 => 0.0,
            1 => *value * 1e30,
            _ => *value,
        };
    }
    // Column 70 - 3 and beyond lie past the end.
    for (i, value) in case.logits.data.iter_mut().enumerate().filter(|(i, _)| i % 70 >= 65) {
        *value += if i / area % 5 == 4 { 1e6 } else { 0.0 };
    }
    let (y, d_logits, d_coarse) = on_device(&gpu, &case);
    let expected = case.reference();
    let relative: Vec<f64> = expected.data.iter().map(|v| 1e-2 * v.abs() + 1e-6).collect();
    require("results", within(&y, &expected.data, &relative));
    assert!(y.iter().all(|v| (0.0..=1e30).contains(v)));
    assert!([d_logits, d_coarse.unwrap()].concat().iter().all(|v| v.is_finite()));
}

fn slope(f: impl Fn(f64) -> f64) -> f64 {
    let h = 1e-5;
    (f(h) - f(-h)) / (2.0 * h)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn moved(tensor: &Tensor<f64>, i: usize, h: f64) -> Tensor<f64> {
    let mut tensor = tensor.clone();
    tensor.data[i] += h;
    tensor
}

#[test]
fn gradients_match_central_differences() {
    for coarse in [false, true] {
        let case = Case::new([2, 4, 6], coarse, 2.0);
        let (logits, fine, dy) = (case.logits.to_f64(), case.fine.to_f64(), case.dy.to_f64());
        let low = case.coarse.as_ref().map(Tensor::to_f64);
        let gradients = case.gradients();
        let of = |logits: &Tensor<f64>, low: Option<&Tensor<f64>>| {
            dot(&kernel_filter::reference(logits, &fine, low).data, &dy.data)
        };
        let differences = (0..logits.len()).map(|i| slope(|h| of(&moved(&logits, i, h), low.as_ref()))).collect();
        require("logits", tensors_close(&gradients.logits, &Tensor::new(logits.shape, differences), 1e-8, 1e-7));
        if let (Some(low), Some(gradient)) = (&low, &gradients.coarse) {
            let colors = 3 * low.shape[2] * low.shape[3];
            let color = |i: usize| i % (colors / 3 * 4) < colors;
            let differences = (0..low.len())
                .map(|i| if color(i) { slope(|h| of(&logits, Some(&moved(low, i, h)))) } else { 0.0 })
                .collect();
            require("coarse", tensors_close(gradient, &Tensor::new(low.shape, differences), 1e-8, 1e-7));
        }
    }
    let radiance =
        Tensor::new([1, 4, 2, 2], (0..16).map(|i| [3e-6, 0.004, 0.5, 90.0][i % 4] * f64::from(i as u32 + 1)).collect());
    let input = network_input([1, 2, 2]).to_f64();
    let dy = goldens::drawn([1, 3, 2, 2], "modulate/dy").to_f64();
    let of = |x: &Tensor<f64>| dot(&demodulate::modulate_reference(x, &input).data, &dy.data);
    for (i, gradient) in demodulate::modulate_reference_backward(&radiance, &input, &dy).data.iter().enumerate() {
        // A step in proportion to the value: the curve is steep near 0.
        let h = 1e-5 * radiance.data[i];
        let difference = (of(&moved(&radiance, i, h)) - of(&moved(&radiance, i, -h))) / (2.0 * h);
        require(&format!("radiance {i}"), close(&[*gradient], &[difference], 1e-8, 1e-6));
    }
}

/// A network's input: radiance from 0 to far beyond 1 in its space, albedo some of which is 0, the last row and column past the end.
fn network_input([n, h, w]: [usize; 3]) -> Tensor<f32> {
    let mut input = goldens::drawn([n, 9, h, w], "demodulate/input").map(f32::abs);
    for i in 0..input.len() {
        let (c, y, x) = (i / (h * w) % 9, i / w % h, i % w);
        let dark = (3..6).contains(&c) && (x % 3 == 1 || (x % 3 == 2 && c == 4));
        let past = h > 2 && (y + 1 == h || x + 1 == w);
        input.data[i] *= if dark || past { 0.0 } else { 1.0 };
    }
    input
}

#[test]
fn demodulation_equals_the_reference_and_is_undone() {
    let gpu = gpu();
    for size in [[1, 2, 2], [2, 6, 10], [1, 38, 70]] {
        let [n, h, w] = size;
        let input = network_input(size);
        let x = upload(&gpu, &input);
        let [radiance, back, gradient] = [4, 3, 4].map(|c| empty(&gpu, [n, c, h, w]));
        let pooled = empty(&gpu, [n, 4, h / 2, w / 2]);
        let dy = goldens::drawn([n, 3, h, w], "demodulate/dy");
        let device_dy = upload(&gpu, &dy);
        run(&gpu, |rec| {
            demodulate_kernel::record(&gpu, rec, &x, &radiance).unwrap();
            demodulate_kernel::record_pool(&gpu, rec, &radiance, &pooled).unwrap();
            demodulate_kernel::record_modulate(&gpu, rec, &radiance, &x, &back).unwrap();
            gradient_kernel::modulate(&gpu, rec, (&radiance, &x), &device_dy, &gradient).unwrap();
        });
        let what = format!("{size:?}");
        let expected = demodulate::reference(&input.to_f64());
        // pu is 0.19 ln x / 3.1 of bright x: its inverse multiplies the rounding of 1 by 16, and a power or an exponential by 20.
        let radiance = radiance.download(&gpu).unwrap();
        require(&what, close(&radiance, &expected.data, 1e-9, 2e-5));
        require(&what, close(&pooled.download(&gpu).unwrap(), &masked_pool2d::reference(&expected).data, 1e-9, 2e-5));
        let inside = |i: usize| expected.at(i / (3 * h * w), 3, i / w % h, i % w) != 0.0;
        let back = back.download(&gpu).unwrap();
        for (i, (&from, &to)) in input.data.iter().zip(&back).enumerate().filter(|(i, _)| *i < 3 * h * w && inside(*i))
        {
            assert!((from - to).abs() < 3e-6, "{what} {i}: {from} and {to}");
        }
        let radiance = Tensor::new([n, 4, h, w], radiance).to_f64();
        let expected = demodulate::modulate_reference_backward(&radiance, &input.to_f64(), &dy.to_f64());
        require(&what, close(&gradient.download(&gpu).unwrap(), &expected.data, 1e-6, 2e-5));
    }
}

#[test]
fn masked_means_by_hand() {
    let mut pixels = Tensor::zeros([1, 4, 2, 4]);
    pixels.data[..8].copy_from_slice(&[1.0, 3.0, 8.0, 0.0, 5.0, 7.0, 0.0, 0.0]);
    pixels.data[24..].copy_from_slice(&[1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0]);
    let pooled = masked_pool2d::reference(&pixels);
    assert_eq!((pooled.at(0, 0, 0, 0), pooled.at(0, 0, 0, 1)), (4.0, 8.0), "four, and the one that is inside");
    assert_eq!((pooled.at(0, 3, 0, 0), pooled.at(0, 3, 0, 1)), (1.0, 1.0));
    assert_eq!(masked_pool2d::reference(&Tensor::zeros([1, 4, 2, 2])).data, [0.0; 4]);
}

#[test]
fn pu_is_undone_and_has_its_slope() {
    for exponent in -9..=9 {
        let x = 1.37 * 10f64.powi(exponent);
        assert!((pu::inverse(pu::forward(x)) / x - 1.0).abs() < 1e-7, "{x}");
        let h = 1e-5 * x;
        let difference = (pu::forward(x + h) - pu::forward(x - h)) / (2.0 * h);
        assert!((pu::derivative(x) / difference - 1.0).abs() < 1e-6, "{x}");
    }
    assert_eq!((pu::forward(0.0), pu::inverse(-1.0)), (0.0, 0.0));
}
