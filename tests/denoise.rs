//! Frame to network input to frame: against a plain host computation, for odd sizes and for values that no frame should
//! have.

mod common;

use common::compare::{close, l2_close, require, same_bits, within};
use common::networks::linear;
use common::{by_pixel, gpu};
use limpid::denoise::{self, Crop, Denoiser, FrameStats, Guides, Inputs, Preparation, Transfer, record_input};
use limpid::gpu::{Gpu, Slice, hazard};
use limpid::net::architecture::{Architecture, Op, Row};
use limpid::net::device::groups;
use limpid::net::reference;
use limpid::net::tensor::{Tensor, seed_of, uniform};
use limpid::net::weights::Weights;
use limpid::train::data::TargetPush;
use limpid::{push_block, shaders};

push_block! {
    /// Push constants of `transfer_probe.comp`.
    pub struct ProbePush for shaders::transfer_probe { count: u32, exposure: f32 }
}

/// What `seed` is trained with.
const PREPARATION: Preparation = Preparation { inputs: Inputs::NormalScreenDepth, transfer: Transfer::Log1p };

/// Where the exposure puts the geometric mean of a frame's luminance. Weights are trained with it.
const KEY: f64 = 0.5;
/// Spacing of f32 at 1.
const ULP: f64 = 1.0 / (1 << 23) as f64;

/// A picture as the renderer leaves it.
struct Frame {
    width: usize,
    height: usize,
    /// r, g, b, exact.
    radiance: Vec<[f32; 4]>,
    /// Normal x, y, depth, hit.
    screen: Vec<[f32; 4]>,
}

impl Frame {
    /// Radiance over four decades, normals in the unit disc, depths of 1 to 5; every fifth pixel exact.
    fn random(width: usize, height: usize) -> Self {
        let stream = seed_of(&format!("frame {width}x{height}"));
        let u = |i: usize, k: u64| uniform(stream, i as u64 * 8 + k);
        let radiance = |i| {
            let level = |k| 10f64.powf(4.0 * u(i, k) - 3.0) as f32;
            [level(0), level(1), level(2), if i % 5 == 0 { 1.0 } else { 0.0 }]
        };
        let screen = |i| {
            let (r, angle) = (u(i, 3).sqrt(), std::f64::consts::TAU * u(i, 4));
            [(r * angle.cos()) as f32, (r * angle.sin()) as f32, (1.0 + 4.0 * u(i, 5)) as f32, 1.0]
        };
        let count = width * height;
        Self { width, height, radiance: (0..count).map(radiance).collect(), screen: (0..count).map(screen).collect() }
    }

    /// The same radiance everywhere, nothing exact.
    fn constant(width: usize, height: usize, radiance: f32) -> Self {
        let mut frame = Self::random(width, height);
        frame.radiance.fill([radiance, radiance, radiance, 0.0]);
        frame
    }

    /// Misses, and numbers that no renderer should give; none of these pixels is exact.
    fn damaged(mut self) -> Self {
        let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 1e30, 1e-30, f32::MAX, 0.0];
        for (i, value) in bad.into_iter().enumerate() {
            let at = (i * 37 + 3) % self.radiance.len();
            self.radiance[at] = [value, 0.5, value, 0.0];
            self.screen[at] = [value, 0.5, 2.0, 1.0];
            self.screen[(at + 1) % self.radiance.len()] = [0.5, value, value, 1.0];
        }
        self.screen[0] = [0.0; 4];
        self
    }

    fn upload(&self, gpu: &Gpu) -> [Slice; 2] {
        [("radiance", &self.radiance), ("screen", &self.screen)].map(|(name, pixels)| {
            let buffer = gpu.buffer(name, pixels.len() as u64 * 16).unwrap();
            gpu.upload(&buffer.all(), pixels).unwrap();
            buffer.slice(0, pixels.len() as u64 * 16)
        })
    }

    /// Pixels with radiance that is not finite or negative, or with a normal or a depth that is not finite.
    fn bad_pixels(&self) -> u64 {
        let bad = |(radiance, screen): &(&[f32; 4], &[f32; 4])| {
            radiance[..3].iter().any(|v| !v.is_finite() || *v < 0.0) || screen[..3].iter().any(|v| !v.is_finite())
        };
        self.radiance.iter().zip(&self.screen).filter(bad).count() as u64
    }

    fn size(&self) -> (u32, u32) {
        (self.width as u32, self.height as u32)
    }

    /// Exposure and 1 / depth: the key over the geometric mean, over blocks of 16x16 pixels, of their mean luminance, blocks
    /// that are dark left out; and the largest depth.
    fn stats(&self) -> (f64, f64) {
        let mut logs = Vec::new();
        for y0 in (0..self.height).step_by(16) {
            for x0 in (0..self.width).step_by(16) {
                let rows = y0..(y0 + 16).min(self.height);
                let pixels = rows.flat_map(|y| (x0..(x0 + 16).min(self.width)).map(move |x| y * self.width + x));
                let values: Vec<f64> = pixels
                    .map(|at| {
                        let [r, g, b, _] = self.radiance[at].map(f64::from);
                        let luminance = 0.212671 * r + 0.715160 * g + 0.072169 * b;
                        if luminance > 0.0 && luminance < 1e30 { luminance } else { 0.0 }
                    })
                    .collect();
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                if mean > 1e-8 {
                    logs.push(mean.log2());
                }
            }
        }
        let exposure = if logs.is_empty() { 1.0 } else { KEY / (logs.iter().sum::<f64>() / logs.len() as f64).exp2() };
        let usable = self.screen.iter().map(|s| f64::from(s[2])).filter(|d| *d > 0.0 && *d < 1e30);
        let depth = usable.fold(0.0, f64::max);
        (exposure, if depth > 0.0 { 1.0 / depth } else { 1.0 })
    }
}

/// `ln(1 + exposure * radiance)`, what is no positive number taken for 0, capped at an exposed 1e30.
fn to_network(radiance: f32, exposure: f64) -> f64 {
    let x = exposure * f64::from(radiance);
    if x > 0.0 { x.min(1e30).ln_1p() } else { 0.0 }
}

/// What f32 may make of it, for Vulkan's precision of `log` (3 ULP, or 2^-21 where its argument is 0.5 to 2): the roundings
/// of `x` and `1 + x` shift the logarithm by half an ULP of 1 each. Below 1/64 there is a series instead: the term of x^5 is
/// left out, and the exposure, the last difference and the last product round.
fn to_network_bound(t: f64) -> f64 {
    let x = t.exp_m1();
    if x < 0.999 / 64.0 { x * (x.powi(4) / 5.0 + 2.0 * ULP) } else { 4.0 * ULP + ULP + 3.0 * ULP * t }
}

/// The relative error of radiance that went there and back: what the logarithm lost, stretched by the exponential, whose
/// own precision is 3 + 2|t| ULP; a difference and a quotient (2.5 ULP). Below 1/64 again a series.
fn round_trip_bound(x: f64) -> f64 {
    let t = x.ln_1p();
    if x < 0.999 / 64.0 {
        return x.powi(4) / 2.0 + 6.0 * ULP;
    }
    (1.0 + x) / x * (to_network_bound(t) + (3.0 + 2.0 * t) * ULP) + 4.0 * ULP
}

/// The eight values of one pixel of the network's input and what each may be off.
fn input_pixel(radiance: [f32; 4], normal: [f32; 2], depth: f32, (exposure, scale): (f64, f64)) -> [(f64, f64); 8] {
    let color = |c: usize| {
        let t = to_network(radiance[c], exposure);
        (t, to_network_bound(t))
    };
    let normal = normal.map(|n| if n.is_nan() { 0.0 } else { f64::from(n.clamp(-1.0, 1.0)) });
    let depth = if depth > 0.0 && depth < 1e30 { (f64::from(depth) * scale).min(1.0) } else { 1.0 };
    [color(0), color(1), color(2), (normal[0], 0.0), (normal[1], 0.0), (depth, ULP), (0.0, 0.0), (0.0, 0.0)]
}

/// The input of a crop, eight values a pixel, and what each may be off: a part of the frame cut out, zeros past its end,
/// mirrored in x, then in y, then transposed.
fn expected_input(frame: &Frame, crop: Crop, stats: (f64, f64)) -> (Vec<f64>, Vec<f64>) {
    let (width, height) = (crop.width as usize, crop.height as usize);
    // Radiance, normal and depth.
    type Pixel = ([f32; 4], [f32; 2], f32);
    let mut pixels: Vec<Option<Pixel>> = Vec::new();
    for y in crop.y as usize..crop.y as usize + height {
        for x in crop.x as usize..crop.x as usize + width {
            let at = y * frame.width + x;
            let inside = x < frame.width && y < frame.height;
            let pixel =
                |at: usize| (frame.radiance[at], [frame.screen[at][0], frame.screen[at][1]], frame.screen[at][2]);
            pixels.push(inside.then(|| pixel(at)));
        }
    }
    if crop.orientation & 1 != 0 {
        pixels.chunks_mut(width).for_each(<[_]>::reverse);
        pixels.iter_mut().flatten().for_each(|(_, n, _)| n[0] = -n[0]);
    }
    if crop.orientation & 2 != 0 {
        pixels = pixels.chunks(width).rev().flatten().copied().collect();
        pixels.iter_mut().flatten().for_each(|(_, n, _)| n[1] = -n[1]);
    }
    if crop.orientation & 4 != 0 {
        assert_eq!(width, height);
        pixels = (0..width * height).map(|i| pixels[i % width * width + i / width]).collect();
        // Right becomes down, and up becomes left.
        pixels.iter_mut().flatten().for_each(|(_, n, _)| *n = [-n[1], -n[0]]);
    }
    let values = pixels.into_iter().flat_map(|pixel| match pixel {
        Some((radiance, normal, depth)) => input_pixel(radiance, normal, depth, stats),
        None => [(0.0, 0.0); 8],
    });
    values.unzip()
}

fn stats_on_device(gpu: &Gpu, (exposure, scale): (f32, f32)) -> Slice {
    let buffer = gpu.buffer("stats", 16).unwrap();
    gpu.upload(&buffer.all(), &[exposure, scale, 0.0, 0.0]).unwrap();
    buffer.slice(0, 16)
}

/// The device's input of a crop, from memory that held NaN.
fn input_on_device(gpu: &Gpu, frame: &Frame, crop: Crop, stats: (f32, f32)) -> Vec<f32> {
    let [radiance, screen] = frame.upload(gpu);
    let bytes = u64::from(crop.width) * u64::from(crop.height) * 32;
    let out = gpu.buffer("input", bytes).unwrap().slice(0, bytes);
    gpu.upload(&out, &vec![f32::NAN; bytes as usize / 4]).unwrap();
    let stats = stats_on_device(gpu, stats);
    let guides = Guides::NormalScreenDepth { screen };
    let frame = denoise::Frame { radiance: &radiance, guides: &guides, stats: &stats, size: frame.size() };
    let mut rec = gpu.recorder();
    record_input(gpu, &mut rec, Transfer::Log1p, &frame, crop, &out).unwrap();
    rec.finish().unwrap().run().unwrap();
    by_pixel(&gpu.download::<f32>(&out).unwrap(), crop.width as usize, 2)
}

#[test]
fn the_transfer_and_its_inverse_are_precise() {
    let gpu = gpu();
    // 1e-6 to 6e4 in equal ratios.
    let count = 4096;
    let radiance: Vec<f32> =
        (0..count).map(|i| (1e-6 * (6e10f64).powf(i as f64 / (count - 1) as f64)) as f32).collect();
    let [from, there, back] = ["from", "there", "back"].map(|n| gpu.buffer(n, count * 4).unwrap());
    gpu.upload(&from.all(), &radiance).unwrap();
    let kernel = gpu.kernel::<shaders::transfer_probe::Shader>(&Default::default()).unwrap();
    for exposure in [1.0f32, 0.18, 37.5, 1e-3] {
        let bind = shaders::transfer_probe::Bind { radiance: from.all(), there: there.all(), back: back.all() };
        let mut rec = gpu.recorder();
        rec.dispatch(&kernel, &bind, &ProbePush { count: count as u32, exposure }, [count as u32 / 64, 1, 1]);
        rec.finish().unwrap().run().unwrap();
        let expected: Vec<f64> = radiance.iter().map(|r| to_network(*r, exposure.into())).collect();
        let bound: Vec<f64> = expected.iter().map(|t| to_network_bound(*t)).collect();
        let actual: Vec<f32> = gpu.download(&there.all()).unwrap();
        require(&format!("there, exposure {exposure}"), within(&actual, &expected, &bound));
        let error = |r: &f32| f64::from(*r) * round_trip_bound(f64::from(*r) * f64::from(exposure));
        let bound: Vec<f64> = radiance.iter().map(error).collect();
        let actual: Vec<f32> = gpu.download(&back.all()).unwrap();
        require(&format!("back, exposure {exposure}"), within(&actual, &radiance, &bound));
        let worst = actual.iter().zip(&radiance).map(|(a, r)| ((a - r) / r).abs()).fold(0.0, f32::max);
        println!("round trip at exposure {exposure}: worst relative error {worst:e}");
    }
}

/// One bin, several, more than one round of joining (256), and more than two (65,536).
#[test]
fn exposure_and_depth_of_a_frame() {
    let gpu = gpu();
    for (width, height) in [(1, 1), (1, 7), (33, 47), (300, 280), (1, 16 * 65_536 + 16)] {
        for damaged in [false, true] {
            let frame = Frame::random(width, height);
            let frame = if damaged { frame.damaged() } else { frame };
            let [radiance, screen] = frame.upload(&gpu);
            let out = gpu.buffer("stats", 16).unwrap().slice(0, 16);
            let stats = FrameStats::new(&gpu, Transfer::Log1p, width as u32, height as u32).unwrap();
            let mut rec = gpu.recorder();
            stats.record(&mut rec, &radiance, &Guides::NormalScreenDepth { screen }, &out).unwrap();
            let mut commands = rec.finish().unwrap();
            hazard::check(commands.events()).unwrap();
            commands.run().unwrap();
            let actual: Vec<f32> = gpu.download(&out).unwrap();
            let (exposure, scale) = frame.stats();
            // 256 additions a bin and 256 a round of joining, each half an ULP (of the sum of logarithms, which is at most
            // the largest of them, 100, times their number); log2 and exp2 as Vulkan has them at such arguments.
            let largest = exposure.log2().abs().max(16.0);
            let rounds = if width * height > 65_536 { 3.0 } else { 1.0 };
            let exponent =
                (128.0 * ULP + rounds * 128.0 * largest * ULP + 3.0 * largest * ULP) * std::f64::consts::LN_2;
            let rtol = exponent + (3.0 + 2.0 * largest) * ULP + 2.0 * ULP;
            let what = format!("{width}x{height}, damaged {damaged}");
            assert!(rtol < 3e-3, "{what}: {rtol} would pass anything");
            require(&format!("{what}: exposure"), close(&actual[..1], &[exposure], 0.0, rtol));
            require(&format!("{what}: depth"), close(&actual[1..2], &[scale], 0.0, 3.0 * ULP));
            assert_eq!(FrameStats::repaired(std::array::from_fn(|i| actual[i])), frame.bad_pixels(), "{what}");
        }
    }
}

#[test]
fn frames_without_light_or_depth_have_neutral_stats() {
    let gpu = gpu();
    let mut frame = Frame::constant(20, 20, 0.0);
    frame.screen.fill([0.0; 4]);
    for (value, repaired) in [(0.0, 0.0), (f32::NAN, 400.0), (f32::INFINITY, 400.0), (-1.0, 400.0), (1e-30, 0.0)] {
        frame.radiance.fill([value, value, value, 0.0]);
        let [radiance, screen] = frame.upload(&gpu);
        let out = gpu.buffer("stats", 16).unwrap().slice(0, 16);
        let (mut rec, guides) = (gpu.recorder(), Guides::NormalScreenDepth { screen });
        let stats = FrameStats::new(&gpu, Transfer::Log1p, 20, 20).unwrap();
        stats.record(&mut rec, &radiance, &guides, &out).unwrap();
        rec.finish().unwrap().run().unwrap();
        assert_eq!(gpu.download::<f32>(&out).unwrap(), [1.0, 1.0, repaired, 0.0]);
    }
}

#[test]
fn the_input_of_every_orientation() {
    let gpu = gpu();
    let stats = (0.37f32, 0.21f32);
    for frame in [Frame::random(40, 33), Frame::random(40, 33).damaged()] {
        for orientation in 0..8 {
            for (x, y, size) in [(0, 0, 16), (5, 9, 23), (39, 32, 1)] {
                let crop = Crop { x, y, width: size, height: size, orientation };
                let (expected, bound) = expected_input(&frame, crop, (stats.0.into(), stats.1.into()));
                let actual = input_on_device(&gpu, &frame, crop, stats);
                require(&format!("{crop:?}"), within(&actual, &expected, &bound));
            }
        }
    }
}

/// Crops that are not square, and that reach past the frame's right and lower end: zeros there, in every channel.
#[test]
fn past_the_frame_is_zero() {
    let gpu = gpu();
    let (stats, frame) = ((0.37f32, 0.21f32), Frame::random(13, 21));
    for orientation in 0..4 {
        let crop = Crop { x: 0, y: 0, width: 64, height: 32, orientation };
        let (expected, bound) = expected_input(&frame, crop, (stats.0.into(), stats.1.into()));
        assert!(bound.iter().filter(|b| **b > 0.0).count() == 13 * 21 * 4, "the host's padding has a tolerance");
        require(&format!("{crop:?}"), within(&input_on_device(&gpu, &frame, crop, stats), &expected, &bound));
    }
}

/// 4.2 million pixels, 135 MiB of input: more than a storage binding. Black but for the last rows.
#[test]
fn the_input_of_a_frame_larger_than_a_storage_binding() {
    let gpu = gpu();
    let (width, height) = (2048u64, 2056u64);
    if gpu.info().is_cpu {
        assert!(width * height * 32 > gpu.info().max_storage_range, "the test shows nothing");
    }
    let last = Frame::random(width as usize, 2);
    let plane = |name: &str, rows: &[[f32; 4]]| {
        let buffer = gpu.buffer(name, width * height * 16).unwrap();
        gpu.upload(&buffer.slice(width * (height - 2) * 16, width * 32), rows).unwrap();
        buffer.all()
    };
    let (radiance, screen) = (plane("radiance", &last.radiance), plane("screen", &last.screen));
    let out = gpu.buffer("input", width * height * 32).unwrap();
    let stats = stats_on_device(&gpu, (0.37, 0.21));
    let crop = Crop { x: 0, y: 0, width: width as u32, height: height as u32, orientation: 0 };
    let mut rec = gpu.recorder();
    let guides = Guides::NormalScreenDepth { screen };
    let size = (crop.width, crop.height);
    let frame = denoise::Frame { radiance: &radiance, guides: &guides, stats: &stats, size };
    record_input(&gpu, &mut rec, Transfer::Log1p, &frame, crop, &out.all()).unwrap();
    rec.finish().unwrap().run().unwrap();
    let actual: Vec<f32> = gpu.download(&out.slice(width * (height - 2) * 32, width * 64)).unwrap();
    let actual = by_pixel(&actual, width as usize, 2);
    let (expected, bound) = expected_input(&last, Crop { height: 2, ..crop }, (0.37f32.into(), 0.21f32.into()));
    require("the last rows", within(&actual, &expected, &bound));
    let first: Vec<f32> = gpu.download(&out.slice(0, width * 32)).unwrap();
    let first = by_pixel(&first, width as usize, 2);
    // No radiance, no normal, no depth: a miss.
    assert!(first.chunks(8).all(|p| p == [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]), "{:?}", &first[..64]);
}

/// Input and target are one picture: the target of what the input shows is the input's color, however it is turned.
#[test]
fn targets_turn_with_their_inputs() {
    let (gpu, frame) = (gpu(), Frame::random(40, 33).damaged());
    let kernel = gpu.kernel::<shaders::network_target::Shader>(&Default::default()).unwrap();
    let [radiance, _] = frame.upload(&gpu);
    for orientation in 0..8 {
        let (x0, y0, size) = (5, 9, 23);
        let crop = Crop { x: x0, y: y0, width: size, height: size, orientation };
        let input = input_on_device(&gpu, &frame, crop, (0.37, 0.21));
        let bytes = u64::from(size * size) * 16;
        let y = gpu.buffer("target", bytes).unwrap().slice(0, bytes);
        let push = TargetPush {
            count: size * size,
            width: 40,
            crop_width: size as i32,
            crop_height: size as i32,
            x0: x0 as i32,
            y0: y0 as i32,
            orientation,
        };
        let stats = stats_on_device(&gpu, (0.37, 0.21));
        let bind = shaders::network_target::Bind { radiance: radiance.clone(), stats, y: y.clone() };
        let mut rec = gpu.recorder();
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(size * size)));
        rec.finish().unwrap().run().unwrap();
        let target: Vec<f32> = gpu.download(&y).unwrap();
        let expected: Vec<f32> = input.chunks(8).flat_map(|p| [p[0], p[1], p[2], 0.0]).collect();
        require(&format!("orientation {orientation}"), same_bits(&target, &expected));
    }
}

/// A tilted plane: its screen normal follows from how its depth changes to the right and down. That must hold however the
/// picture is turned, so that a network sees no surface that cannot be.
#[test]
fn normals_turn_with_the_picture() {
    let gpu = gpu();
    // Nearer to the right and, less so, further up: the normal, which faces the camera, leans to the left and down.
    let (dx, dy, size) = (-0.02f32, 0.01f32, 12);
    let mut frame = Frame::random(size, size);
    for (i, s) in frame.screen.iter_mut().enumerate() {
        *s = [dx * 8.0, -dy * 8.0, 3.0 + dx * (i % size) as f32 + dy * (i / size) as f32, 1.0];
    }
    for orientation in 0..8 {
        let crop = Crop { x: 0, y: 0, width: size as u32, height: size as u32, orientation };
        let input = input_on_device(&gpu, &frame, crop, (1.0, 0.25));
        let at = |x: usize, y: usize, channel: usize| f64::from(input[(y * size + x) * 8 + channel]);
        for (x, y) in [(0, 0), (4, 7), (size - 2, size - 2)] {
            let (right, down) = ((at(x + 1, y, 5) - at(x, y, 5)) * 4.0, (at(x, y + 1, 5) - at(x, y, 5)) * 4.0);
            // Differences of depths of about 3, quartered: four roundings.
            require(
                &format!("orientation {orientation} at {x}, {y}"),
                close(&[at(x, y, 3), at(x, y, 4)], &[8.0 * right, -8.0 * down], 8.0 * 4.0 * 4.0 * ULP, 0.0),
            );
        }
    }
}

/// The weights with the metadata that training gives them.
fn prepared(mut weights: Weights) -> Weights {
    weights.metadata.extend(PREPARATION.metadata());
    weights
}

/// A network of `seed`'s grid that gives back r, g and b.
fn identity() -> Weights {
    const NAMES: [[&str; 2]; 5] = [["p1", "u1"], ["p2", "u2"], ["p3", "u3"], ["p4", "u4"], ["p5", "u5"]];
    let mut rows: Vec<Row> = vec![("input", Op::Input { channels: 6 }, &[])];
    let pools: [&[&str]; 5] = [&["input"], &["p1"], &["p2"], &["p3"], &["p4"]];
    let ups: [&[&str]; 5] = [&["u2"], &["u3"], &["u4"], &["u5"], &["p5"]];
    rows.extend(NAMES.iter().zip(pools).map(|([pool, _], from)| (*pool, Op::MaxPool, from)));
    rows.extend(NAMES.iter().zip(ups).rev().map(|([_, up], from)| (*up, Op::Upsample, from)));
    rows.push(("concat", Op::Concat, &["u1", "input"]));
    rows.push(("out", linear(12, 3), &["concat"]));
    let architecture = Architecture::from_rows("identity", &rows).unwrap();
    assert_eq!(architecture.alignment(), 32);
    let mut weights = prepared(Weights::glorot(&architecture, 0));
    weights.parameters.fill(0.0);
    for c in 0..3 {
        weights.parameters[(c * 12 + 6 + c) * 9 + 4] = 1.0;
    }
    weights
}

fn reconstruct(gpu: &Gpu, weights: &Weights, frame: &Frame) -> [Vec<f32>; 3] {
    let (width, height) = frame.size();
    let denoiser = Denoiser::new(gpu, weights, width, height).unwrap();
    let [radiance, screen] = frame.upload(gpu);
    let guides = Guides::NormalScreenDepth { screen };
    hazard::check(denoiser.record(&radiance, &guides).unwrap().events()).unwrap();
    let (planes, _) = denoiser.run(&radiance, &guides).unwrap();
    assert!(planes.iter().all(|p| p.len() == frame.radiance.len()));
    planes
}

const SIZES: [(usize, usize); 6] = [(1, 1), (1, 7), (7, 1), (33, 47), (64, 32), (31, 65)];

/// With a network that changes nothing, radiance comes back to its place, as precisely as the transfer allows; and what is
/// exact with all its bits.
#[test]
fn an_identity_reconstructs_the_frame() {
    let (gpu, identity) = (gpu(), identity());
    for (width, height) in SIZES {
        let frame = Frame::random(width, height);
        let (exposure, _) = frame.stats();
        let planes = reconstruct(&gpu, &identity, &frame);
        for (c, plane) in planes.iter().enumerate() {
            let expected: Vec<f32> = frame.radiance.iter().map(|p| p[c]).collect();
            // The device's exposure may differ by 1e-4 from the host's, which moves the bound by as little.
            let error = |p: &[f32; 4]| {
                let radiance = f64::from(p[c]);
                if p[3] > 0.5 { 0.0 } else { 1.001 * radiance * round_trip_bound(radiance * exposure) }
            };
            let bound: Vec<f64> = frame.radiance.iter().map(error).collect();
            require(&format!("{width}x{height}, channel {c}"), within(plane, &expected, &bound));
        }
    }
}

/// `seed` with random weights against the whole way in f64. In the network's space, negative results cut off as the output
/// does: 1e-5 for the network and as much for each transfer.
#[test]
fn the_whole_way_matches_the_reference() {
    let (gpu, weights) = (gpu(), prepared(Weights::glorot(&Architecture::seed(), 3)));
    let frame = Frame::random(33, 47);
    let stats = frame.stats();
    let crop = Crop { x: 0, y: 0, width: 64, height: 64, orientation: 0 };
    let (pixels, _) = expected_input(&frame, crop, stats);
    let input = (0..6 * 64 * 64).map(|i| pixels[i % 4096 * 8 + i / 4096]).collect();
    let output = reference::forward(&weights.architecture, &weights.to_f64(), &Tensor::new([1, 6, 64, 64], input));
    let planes = reconstruct(&gpu, &weights, &frame);
    let (mut actual, mut expected) = (Vec::new(), Vec::new());
    for (c, plane) in planes.iter().enumerate() {
        for (i, p) in frame.radiance.iter().enumerate().filter(|(_, p)| p[3] < 0.5) {
            assert!(p[3] == 0.0);
            actual.push(to_network(plane[i], stats.0));
            expected.push(output.last().unwrap().at(0, c, i / 33, i % 33).max(0.0));
        }
    }
    assert!(expected.iter().filter(|t| **t > 0.0).count() > expected.len() / 10, "nearly all cut off");
    require("output", l2_close(&actual, &expected, 3e-5));
}

#[test]
fn exact_pixels_keep_their_bits() {
    let (gpu, weights) = (gpu(), prepared(Weights::glorot(&Architecture::seed(), 3)));
    for (width, height) in SIZES {
        let mut frame = Frame::random(width, height);
        for pixel in frame.radiance.iter_mut().step_by(5) {
            // No value is special where the renderer says that it is exact.
            *pixel = [12.345_679, 0.0, 1.0e-12, 1.0];
        }
        let planes = reconstruct(&gpu, &weights, &frame);
        let exact = |i: &usize| frame.radiance[*i][3] == 1.0;
        for (c, plane) in planes.iter().enumerate() {
            assert!(plane.iter().all(|v| v.is_finite()), "{width}x{height}");
            let at: Vec<usize> = (0..plane.len()).filter(exact).collect();
            let kept: Vec<f32> = at.iter().map(|&i| plane[i]).collect();
            let given: Vec<f32> = at.iter().map(|&i| frame.radiance[i][c]).collect();
            require(&format!("{width}x{height}, channel {c}"), same_bits(&kept, &given));
            let changed = (0..plane.len()).filter(|i| !exact(i) && plane[*i] != frame.radiance[*i][c]).count();
            assert_eq!(changed, plane.len() - at.len(), "{width}x{height}: noise left as it was");
        }
    }
}

/// Whatever a frame holds, the result is finite and not negative.
#[test]
fn extreme_frames_stay_finite() {
    let gpu = gpu();
    let finite = |what: &str, weights: &Weights, frame: &Frame| {
        let planes = reconstruct(&gpu, weights, frame);
        let bad = planes.iter().flatten().find(|v| !v.is_finite() || **v < 0.0);
        assert!(bad.is_none(), "{what}: {bad:?}");
        planes
    };
    let (identity, seed) = (identity(), prepared(Weights::glorot(&Architecture::seed(), 3)));
    for radiance in [0.0, 1e-30, 1e-9, 1e-3, 1.0, 6e4, 1e20, 1e30, f32::MAX] {
        let frame = Frame::constant(33, 17, radiance);
        finite(&format!("seed, {radiance:e}"), &seed, &frame);
        let planes = finite(&format!("identity, {radiance:e}"), &identity, &frame);
        if radiance < 1e30 {
            // Exposed to the key, but for what is too dark for that.
            let x = if radiance < 1e-8 { f64::from(radiance) } else { KEY };
            let tolerance = 1.001 * round_trip_bound(x);
            let expected = vec![radiance; 33 * 17];
            for plane in &planes {
                require(&format!("identity, {radiance:e}"), close(plane, &expected, 0.0, tolerance));
            }
        }
    }
    for (width, height) in [(1, 1), (1, 7), (33, 47)] {
        let frame = Frame::random(width, height).damaged();
        finite(&format!("damaged {width}x{height}"), &seed, &frame);
    }
    let mut frame = Frame::random(33, 47);
    frame.radiance.fill([f32::NAN; 4]);
    frame.screen.fill([f32::NAN; 4]);
    finite("all NaN", &seed, &frame);
}

#[test]
fn a_frame_gives_equal_bits_every_time() {
    let (gpu, weights) = (gpu(), prepared(Weights::glorot(&Architecture::seed(), 3)));
    let frame = Frame::random(33, 47);
    let first = reconstruct(&gpu, &weights, &frame).concat();
    // The second runs in memory that the first left.
    require("again", same_bits(&reconstruct(&gpu, &weights, &frame).concat(), &first));
}

#[test]
fn weights_for_other_inputs_or_transfers_are_refused() {
    let gpu = gpu();
    let weights = prepared(Weights::glorot(&Architecture::seed(), 0));
    assert_eq!(Preparation::of_weights(&weights, "w.safetensors").unwrap(), PREPARATION);
    let refused = |key: &str, wrong: Option<&str>, parts: &[&str]| {
        let mut weights = weights.clone();
        match wrong {
            Some(wrong) => weights.metadata.insert(key.into(), wrong.into()),
            None => weights.metadata.remove(key),
        };
        let message = Preparation::of_weights(&weights, "w.safetensors").unwrap_err().to_string();
        for part in parts.iter().copied().chain(["w.safetensors", key, wrong.unwrap_or("none")]) {
            assert!(message.contains(part), "{message}");
        }
        assert!(Denoiser::new(&gpu, &weights, 8, 8).is_err());
    };
    for wrong in [Some("something else"), Some(""), None] {
        refused(Inputs::KEY, wrong, &Inputs::ALL.map(Inputs::name));
        refused(Transfer::KEY, wrong, &Transfer::ALL.map(Transfer::name));
    }
    refused(Inputs::KEY, Some(Inputs::AlbedoNormal.name()), &["9 channels", "`seed` reads 6"]);
}
