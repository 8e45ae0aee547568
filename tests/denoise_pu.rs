//! Frames as `base` reads them: transfer `pu`, albedo and world-space normals, against a plain host computation.

mod common;

use common::compare::{close, l2_close, require, same_bits, within};
use common::networks::linear;
use common::{by_pixel, gpu};
use limpid::denoise::{Axes, Crop, Denoiser, Frame, FrameStats, Guides, Inputs, Preparation, Transfer, record_input};
use limpid::gpu::{Gpu, Slice, hazard};
use limpid::net::architecture::{Architecture, Op, Row};
use limpid::net::base::Widths;
use limpid::net::reference;
use limpid::net::tensor::{Tensor, seed_of, uniform};
use limpid::net::weights::Weights;
use limpid::render::{Renderer, Settings};
use limpid::scene::family;
use limpid::{push_block, shaders};

push_block! {
    /// Push constants of `transfer_probe.comp`.
    pub struct ProbePush for shaders::transfer_probe { count: u32, exposure: f32 }
}

/// Spacing of f32 at 1.
const ULP: f64 = 1.0 / (1 << 23) as f64;

/// Open Image Denoise's curve before it is divided by its value at 65504.
fn curve(x: f64) -> f64 {
    match x {
        x if x <= 1.57945760e-6 => 1.41283765e3 * x,
        x if x <= 3.22087631e-2 => 1.64593172 * x.powf(4.31384981e-1) - 2.94139609e-3,
        _ => 1.92653254e-1 * (x + 6.26026094e-3).ln() + 9.98620152e-1,
    }
}

/// Exposed radiance in the network's space; what is no positive number is 0, and 1e30 the most.
fn to_network(radiance: f32, exposure: f64) -> f64 {
    let x = exposure * f64::from(radiance);
    if x > 0.0 { curve(x.min(1e30)) / curve(65504.0) } else { 0.0 }
}

/// What f32 may make of `curve(x)`. Vulkan's `pow(x, c)` is `exp2(c * log2(x))`: the logarithm, exact to 3 ULP, the product and
/// the constant's rounding (1 ULP) shift the exponent, exp2 adds 3 + 2|exponent| ULP. `log` has 3 ULP, or 2^-21 where its
/// argument is 0.5 to 2, and its argument two roundings. Then at most 6 roundings of products, sums, the quotient and
/// constants. At the joints, which differ by 1.4e-8, either side may be taken.
fn curve_bound(x: f64) -> f64 {
    let t = curve(x);
    if x < 1.57e-6 {
        return 6.0 * ULP * t;
    }
    let transcendental = if x < 3.23e-2 {
        let exponent = 0.4314 * x.log2().abs();
        (t + 2.95e-3) * (4.0 * exponent * std::f64::consts::LN_2 + 3.0 + 2.0 * exponent) * ULP
    } else {
        0.1927 * (4.0 + 1.0 + 3.0 * (x + 6.26e-3).ln().abs()) * ULP
    };
    transcendental + 6.0 * ULP * (t.abs() + 1.0).min(t + 1.0 * f64::from(u8::from(x > 3.2e-2)) + 2.95e-3) + 1.5e-8
}

/// The relative error of exposed radiance that went there and back: the curve's error and three more roundings, divided by
/// its slope, and the inverse's own functions, of the same precision.
fn round_trip_bound(x: f64) -> f64 {
    let there =
        curve_bound(x) + 3.0 * ULP * (curve(x).abs() + 1.0).min(curve(x) + 2.95e-3 + f64::from(u8::from(x > 3.2e-2)));
    if x < 1.57e-6 {
        return there / curve(x) + 4.0 * ULP;
    }
    if x < 3.23e-2 {
        let exponent = x.log2().abs();
        let own = (4.0 * exponent * std::f64::consts::LN_2 + 3.0 + 2.0 * exponent) * ULP;
        return there / (0.4314 * (curve(x) + 2.94e-3)) + own + 4.0 * ULP;
    }
    let argument = (x + 6.26e-3).ln().abs();
    (1.0 + 6.27e-3 / x) * (there / 0.19265 + (3.0 + 2.0 * argument + 2.0 * argument) * ULP) + 4.0 * ULP
}

#[test]
fn pu_has_golden_values() {
    let gpu = gpu();
    // Computed apart, in double precision.
    let golden = [
        (0.0, 0.0),
        (1e-7, 4.5064880594610334e-05),
        (1e-5, 0.0027197000704771955),
        (1e-3, 0.02573055210939588),
        (0.18, 0.2152534227003501),
        (1.0, 0.3189105232590007),
        (100.0, 0.6015188617131051),
        (65504.0, 1.0),
        (1e6, 1.1674909871130446),
        (f32::NAN, 0.0),
        (-1.0, 0.0),
        (f32::NEG_INFINITY, 0.0),
    ];
    let (radiance, expected): (Vec<f32>, Vec<f64>) = golden.into_iter().unzip();
    let (there, back) = probe(&gpu, Transfer::Pu, &radiance, 1.0);
    let bound: Vec<f64> = radiance.iter().map(|r| curve_bound(f64::from(r.max(0.0))) / 3.1).collect();
    require("there", within(&there, &expected, &bound));
    require("back", within(&back[9..], &[0.0; 3], &[0.0; 3]));
    let (there, back) = probe(&gpu, Transfer::Pu, &[f32::INFINITY, f32::MAX], 1.0);
    assert!(there.iter().chain(&back).all(|v| v.is_finite()), "{there:?} {back:?}");
    assert_eq!(there[0], there[1]);
}

/// The transfer of values and back.
fn probe(gpu: &Gpu, transfer: Transfer, radiance: &[f32], exposure: f32) -> (Vec<f32>, Vec<f32>) {
    let count = radiance.len() as u64;
    let [from, there, back] = ["from", "there", "back"].map(|name| gpu.buffer(name, count * 4).unwrap());
    gpu.upload(&from.all(), radiance).unwrap();
    let spec = shaders::transfer_probe::Spec { transfer: transfer.id() };
    let kernel = gpu.kernel::<shaders::transfer_probe::Shader>(&spec).unwrap();
    let bind = shaders::transfer_probe::Bind { radiance: from.all(), there: there.all(), back: back.all() };
    let mut rec = gpu.recorder();
    rec.dispatch(&kernel, &bind, &ProbePush { count: count as u32, exposure }, [count.div_ceil(64) as u32, 1, 1]);
    rec.finish().unwrap().run().unwrap();
    let read = |buffer: &limpid::gpu::Buffer| -> Vec<f32> {
        let values: Vec<f32> = gpu.download(&buffer.all()).unwrap();
        values[..radiance.len()].to_vec()
    };
    (read(&there), read(&back))
}

#[test]
fn pu_and_its_inverse_are_precise() {
    let gpu = gpu();
    // 1e-8 to 6e4 in equal ratios: all three parts of the curve.
    let count = 4096;
    let radiance: Vec<f32> =
        (0..count).map(|i| (1e-8 * (6e12f64).powf(f64::from(i) / f64::from(count - 1))) as f32).collect();
    for exposure in [1.0f32, 0.18, 37.5, 1e-3] {
        let exposed = |r: &f32| f64::from(*r) * f64::from(exposure);
        let (there, back) = probe(&gpu, Transfer::Pu, &radiance, exposure);
        let expected: Vec<f64> = radiance.iter().map(|r| to_network(*r, exposure.into())).collect();
        // The exposed radiance rounds too: half an ULP of it, where the curve's slope times x is at most the curve's value.
        let bound: Vec<f64> = radiance.iter().map(|r| (curve_bound(exposed(r)) + ULP * 0.2) / 3.1).collect();
        require(&format!("there, exposure {exposure}"), within(&there, &expected, &bound));
        let bound: Vec<f64> =
            radiance.iter().map(|r| f64::from(*r) * (round_trip_bound(exposed(r)) + 2.0 * ULP)).collect();
        require(&format!("back, exposure {exposure}"), within(&back, &radiance, &bound));
        let worst = back.iter().zip(&radiance).map(|(a, r)| ((a - r) / r).abs()).fold(0.0, f32::max);
        println!("round trip at exposure {exposure}: worst relative error {worst:e}");
    }
}

/// A picture as the renderer leaves it.
struct Picture {
    width: usize,
    height: usize,
    /// r, g, b, exact.
    radiance: Vec<[f32; 4]>,
    albedo: Vec<[f32; 4]>,
    normal: Vec<[f32; 4]>,
}

impl Picture {
    fn random(width: usize, height: usize) -> Self {
        let stream = seed_of(&format!("picture {width}x{height}"));
        let u = |i: usize, k: u64| uniform(stream, i as u64 * 16 + k);
        let radiance = |i| [0, 1, 2, 3].map(|k| if k < 3 { 10f64.powf(4.0 * u(i, k) - 3.0) as f32 } else { 0.0 });
        let albedo = |i| [3, 4, 5, 6].map(|k| u(i, k) as f32);
        let normal = |i| {
            let (z, angle) = (2.0 * u(i, 7) - 1.0, std::f64::consts::TAU * u(i, 8));
            let r = (1.0 - z * z).sqrt();
            [(r * angle.cos()) as f32, (r * angle.sin()) as f32, z as f32, 0.5]
        };
        let count = width * height;
        Self {
            width,
            height,
            radiance: (0..count).map(radiance).collect(),
            albedo: (0..count).map(albedo).collect(),
            normal: (0..count).map(normal).collect(),
        }
    }

    /// Numbers that no renderer should give.
    fn damaged(mut self) -> Self {
        let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.5, 1e30, 2.5, f32::MAX, 0.0];
        for (i, value) in bad.into_iter().enumerate() {
            let at = (i * 37 + 3) % self.radiance.len();
            self.radiance[at] = [value, 0.5, value, 0.0];
            self.albedo[at] = [0.5, value, value, 0.0];
            self.normal[at] = [value, 0.5, value, 0.0];
        }
        self
    }

    fn upload(&self, gpu: &Gpu) -> (Slice, Guides) {
        let [radiance, albedo, normal_world] = [&self.radiance, &self.albedo, &self.normal].map(|pixels| {
            let buffer = gpu.buffer("plane", pixels.len() as u64 * 16).unwrap();
            gpu.upload(&buffer.all(), pixels).unwrap();
            buffer.slice(0, pixels.len() as u64 * 16)
        });
        (radiance, Guides::AlbedoNormal { albedo, normal_world, axes: axes() })
    }

    fn size(&self) -> (u32, u32) {
        (self.width as u32, self.height as u32)
    }

    /// Pixels with radiance that is not finite or negative, or with an albedo or a normal that is not finite.
    fn bad_pixels(&self) -> f64 {
        let finite = |pixel: &[f32; 4]| pixel[..3].iter().all(|v| v.is_finite());
        let bad = |at: &usize| {
            self.radiance[*at][..3].iter().any(|v| !v.is_finite() || *v < 0.0)
                || !finite(&self.albedo[*at])
                || !finite(&self.normal[*at])
        };
        (0..self.radiance.len()).filter(bad).count() as f64
    }

    /// The exposure: 0.18 over the geometric mean, over bins of an even share of at most 16x16 pixels, of their mean
    /// luminance, dark bins left out. What is not positive counts as 0, a pixel of 1e30 and more too.
    fn exposure(&self) -> f64 {
        let edges = |size: usize| -> Vec<usize> {
            let bins = size.div_ceil(16);
            (0..=bins).map(|i| i * size / bins).collect()
        };
        let mut logs = Vec::new();
        for rows in edges(self.height).windows(2) {
            for columns in edges(self.width).windows(2) {
                let places = (rows[0]..rows[1]).flat_map(|y| (columns[0]..columns[1]).map(move |x| y * self.width + x));
                let values: Vec<f64> = places
                    .map(|at| {
                        let [r, g, b, _] = self.radiance[at].map(|v| if v > 0.0 { f64::from(v) } else { 0.0 });
                        let luminance = 0.212671 * r + 0.715160 * g + 0.072169 * b;
                        if luminance < 1e30 { luminance } else { 0.0 }
                    })
                    .collect();
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                if mean > 1e-8 {
                    logs.push(mean.log2());
                }
            }
        }
        if logs.is_empty() { 1.0 } else { 0.18 / (logs.iter().sum::<f64>() / logs.len() as f64).exp2() }
    }

    /// The input of the whole picture padded to `side` x `side`, NCHW, in double precision.
    fn input(&self, side: usize, exposure: f64) -> Tensor<f64> {
        let mut input = Tensor::zeros([1, 9, side, side]);
        for at in 0..self.radiance.len() {
            for (c, (value, _)) in pixel(self, at, exposure).into_iter().enumerate() {
                let to = input.index(0, c, at / self.width, at % self.width);
                input.data[to] = value;
            }
        }
        input
    }
}

/// A camera that looks nowhere along the world's axes.
fn axes() -> Axes {
    Axes { right: [0.8, 0.0, 0.6], up: [0.36, 0.8, -0.48] }
}

/// The nine values of one pixel that is not turned, and what each may be off.
fn pixel(picture: &Picture, at: usize, exposure: f64) -> [(f64, f64); 9] {
    let sane = |v: f32, low: f32| if v.is_nan() { 0.0 } else { f64::from(v.clamp(low, 1.0)) };
    std::array::from_fn(|c| match c {
        0..3 => {
            let radiance = picture.radiance[at][c];
            let x = (exposure * f64::from(radiance.max(0.0))).min(1e30);
            (to_network(radiance, exposure), (curve_bound(x) + ULP * 0.2) / 3.1)
        }
        3..6 => (sane(picture.albedo[at][c - 3], 0.0), 0.0),
        _ => (0.5 * sane(picture.normal[at][c - 6], -1.0) + 0.5, 0.5 * ULP),
    })
}

/// The device's input of a crop, twelve values a pixel, from memory that held NaN.
fn input_on_device(gpu: &Gpu, picture: &Picture, crop: Crop, exposure: f32) -> Vec<f32> {
    let (radiance, guides) = picture.upload(gpu);
    let bytes = u64::from(crop.width) * u64::from(crop.height) * 48;
    let out = gpu.buffer("input", bytes).unwrap().slice(0, bytes);
    gpu.upload(&out, &vec![f32::NAN; bytes as usize / 4]).unwrap();
    let stats = gpu.buffer("stats", 16).unwrap().slice(0, 16);
    gpu.upload(&stats, &[exposure, 1.0, 0.0, 0.0]).unwrap();
    let frame = Frame { radiance: &radiance, guides: &guides, stats: &stats, size: picture.size() };
    let mut rec = gpu.recorder();
    record_input(gpu, &mut rec, Transfer::Pu, &frame, crop, &out).unwrap();
    rec.finish().unwrap().run().unwrap();
    by_pixel(&gpu.download::<f32>(&out).unwrap(), crop.width as usize, 3)
}

/// Whatever the pixels hold; zeros past the picture's end in all channels, those of normals too.
#[test]
fn the_input_and_its_padding() {
    let gpu = gpu();
    for picture in [Picture::random(21, 13), Picture::random(21, 13).damaged()] {
        let crop = Crop { x: 0, y: 0, width: 32, height: 16, orientation: 0 };
        let actual = input_on_device(&gpu, &picture, crop, 0.37);
        let (mut expected, mut bound) = (Vec::new(), Vec::new());
        for at in 0..32 * 16 {
            let (x, y) = (at % 32, at / 32);
            let inside = x < 21 && y < 13;
            let values = if inside { pixel(&picture, y * 21 + x, 0.37f32.into()) } else { [(0.0, 0.0); 9] };
            for (value, error) in values.into_iter().chain([(0.0, 0.0); 3]) {
                expected.push(value);
                bound.push(error);
            }
        }
        require("input", within(&actual, &expected, &bound));
    }
}

/// However a crop is turned: radiance and albedo move, and normals are those of the mirrored scene before the same camera, that
/// is with the in-plane components of the screen-space normal, which `seed`'s input turns, and their own depth component.
#[test]
fn normals_turn_as_if_the_scene_were_mirrored() {
    let (gpu, size) = (gpu(), 12usize);
    let mut picture = Picture::random(size, size);
    picture.normal[5] = [0.0; 4];
    let (right, up) = (axes().right.map(f64::from), axes().up.map(f64::from));
    let forward =
        [up[1] * right[2] - up[2] * right[1], up[2] * right[0] - up[0] * right[2], up[0] * right[1] - up[1] * right[0]];
    let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let screen = |n: [f64; 3]| [dot(n, right), dot(n, up), dot(n, forward)];
    let crop = |orientation| Crop { x: 0, y: 0, width: size as u32, height: size as u32, orientation };
    let plain = input_on_device(&gpu, &picture, crop(0), 1.0);
    let normal = |input: &[f32], at: usize| -> [f64; 3] {
        std::array::from_fn(|c| 2.0 * f64::from(input[at * 12 + 6 + c]) - 1.0)
    };
    for orientation in 0..8u32 {
        let turned = input_on_device(&gpu, &picture, crop(orientation), 1.0);
        for at in 0..size * size {
            // Where the pixel was: transposed, then mirrored.
            let (mut x, mut y) = (at % size, at / size);
            if orientation & 4 != 0 {
                (x, y) = (y, x);
            }
            if orientation & 1 != 0 {
                x = size - 1 - x;
            }
            if orientation & 2 != 0 {
                y = size - 1 - y;
            }
            let from = y * size + x;
            let what = format!("orientation {orientation}, pixel {at}");
            require(&what, same_bits(&turned[at * 12..at * 12 + 6], &plain[from * 12..from * 12 + 6]));
            let [mut a, mut b, c] = screen(normal(&plain, from));
            if orientation & 1 != 0 {
                a = -a;
            }
            if orientation & 2 != 0 {
                b = -b;
            }
            if orientation & 4 != 0 {
                (a, b) = (-b, -a);
            }
            // The axes round to f32 (their products to 2 ULP), sums of three, two products: 16 ULP of 1 are plenty, and
            // a component taken for another would be off by far more.
            require(&what, close(&screen(normal(&turned, at)), &[a, b, c], 16.0 * ULP, 0.0));
        }
    }
}

/// The renderer's own buffers: world normals turned by the camera's axes agree with the screen-space normals turned for `seed`.
#[test]
fn world_and_screen_normals_of_a_render_turn_alike() {
    let gpu = gpu();
    let mut scene = family::spheres(7);
    (scene.camera.width, scene.camera.height) = (16, 16);
    let axes = Axes::of(&scene.camera);
    let mut renderer = Renderer::new(&gpu, &scene, &Settings { spp: 1, ..Settings::default() }).unwrap();
    renderer.finish().unwrap();
    let outputs = renderer.outputs().unwrap();
    let stats = gpu.buffer("stats", 16).unwrap().slice(0, 16);
    gpu.upload(&stats, &[1.0f32, 1.0, 0.0, 0.0]).unwrap();
    let input = |inputs: Inputs, crop: Crop| -> Vec<f32> {
        let guides = Guides::of(&outputs, inputs, axes);
        let bytes = 256 * 16 * inputs.channels().div_ceil(4) as u64;
        let out = gpu.buffer("input", bytes).unwrap().slice(0, bytes);
        let frame = Frame { radiance: &outputs.radiance, guides: &guides, stats: &stats, size: (16, 16) };
        let mut rec = gpu.recorder();
        record_input(&gpu, &mut rec, Transfer::Pu, &frame, crop, &out).unwrap();
        rec.finish().unwrap().run().unwrap();
        by_pixel(&gpu.download::<f32>(&out).unwrap(), 16, inputs.channels().div_ceil(4))
    };
    let dot = |n: &[f64], axis: [f32; 3]| n.iter().zip(axis).map(|(n, a)| n * f64::from(a)).sum::<f64>();
    for orientation in 0..8 {
        let crop = Crop { x: 0, y: 0, width: 16, height: 16, orientation };
        let (screen, world) = (input(Inputs::NormalScreenDepth, crop), input(Inputs::AlbedoNormal, crop));
        for at in 0..256 {
            let n: Vec<f64> = world[at * 12 + 6..at * 12 + 9].iter().map(|v| 2.0 * f64::from(*v) - 1.0).collect();
            let expected = &screen[at * 8 + 3..at * 8 + 5];
            let actual = [dot(&n, axes.right), dot(&n, axes.up)];
            require(&format!("orientation {orientation}, pixel {at}"), close(&actual, expected, 32.0 * ULP, 0.0));
        }
    }
}

/// The exposure of frames whose sides are no multiples of 16, where even bins differ from a grid of 16 pixels.
#[test]
fn the_exposure_is_that_of_even_bins() {
    let gpu = gpu();
    for (width, height) in [(1, 1), (1, 7), (17, 16), (33, 47), (300, 281)] {
        for damaged in [false, true] {
            let picture = Picture::random(width, height);
            let picture = if damaged { picture.damaged() } else { picture };
            let (radiance, guides) = picture.upload(&gpu);
            let out = gpu.buffer("stats", 16).unwrap().slice(0, 16);
            let mut rec = gpu.recorder();
            let stats = FrameStats::new(&gpu, Transfer::Pu, width as u32, height as u32).unwrap();
            stats.record(&mut rec, &radiance, &guides, &out).unwrap();
            let mut commands = rec.finish().unwrap();
            hazard::check(commands.events()).unwrap();
            commands.run().unwrap();
            let actual: Vec<f32> = gpu.download(&out).unwrap();
            // As for `log1p`: 256 additions a bin, and as many in a round of joining, of logarithms of at most 100.
            let largest = picture.exposure().log2().abs().max(16.0);
            let rounds = if width * height > 65_536 { 3.0 } else { 1.0 };
            let exponent = (128.0 + 3.0 * largest + rounds * 128.0 * largest) * ULP * std::f64::consts::LN_2;
            let rtol = exponent + (5.0 + 2.0 * largest) * ULP;
            let what = format!("{width}x{height}, damaged {damaged}");
            assert!(rtol < 3e-3, "{what}: {rtol} would pass anything");
            require(&what, close(&actual, &[picture.exposure(), 1.0, picture.bad_pixels(), 0.0], 0.0, rtol));
        }
    }
}

/// The weights with the metadata that training gives them.
fn prepared(mut weights: Weights) -> Weights {
    weights.metadata.extend(Preparation::OPEN_IMAGE_DENOISE.metadata());
    weights
}

fn reconstruct(gpu: &Gpu, weights: &Weights, picture: &Picture) -> [Vec<f32>; 3] {
    let (width, height) = picture.size();
    let denoiser = Denoiser::new(gpu, weights, width, height).unwrap();
    let (radiance, guides) = picture.upload(gpu);
    hazard::check(denoiser.record(&radiance, &guides).unwrap().events()).unwrap();
    denoiser.run(&radiance, &guides).unwrap().0
}

/// With a network that gives back r, g and b, radiance comes back as precisely as the transfer allows.
#[test]
fn an_identity_reconstructs_the_frame() {
    let gpu = gpu();
    let rows: &[Row] = &[("input", Op::Input { channels: 9 }, &[]), ("out", linear(9, 3), &["input"])];
    let mut identity = prepared(Weights::glorot(&Architecture::from_rows("identity", rows).unwrap(), 0));
    identity.parameters.fill(0.0);
    (0..3).for_each(|c| identity.parameters[(c * 9 + c) * 9 + 4] = 1.0);
    for (width, height) in [(1, 1), (7, 3), (33, 47)] {
        let picture = Picture::random(width, height);
        let exposure = picture.exposure();
        for (c, plane) in reconstruct(&gpu, &identity, &picture).iter().enumerate() {
            let expected: Vec<f64> = picture.radiance.iter().map(|p| f64::from(p[c])).collect();
            // The device's exposure may differ by 1e-4 from the host's, which moves the bound by as little.
            let bound: Vec<f64> =
                expected.iter().map(|r| 1.001 * r * (round_trip_bound(r * exposure) + 2.0 * ULP)).collect();
            require(&format!("{width}x{height}, channel {c}"), within(plane, &expected, &bound));
        }
        let finite = reconstruct(&gpu, &identity, &Picture::random(width, height).damaged());
        assert!(finite.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
    }
}

/// `base` with random weights against the whole way in f64. In the network's space, negative results cut off as the output
/// does: 1e-5 for the network and as much for each transfer.
#[test]
fn the_whole_way_matches_the_reference() {
    let gpu = gpu();
    let base = Architecture::base(&Widths::default()).unwrap();
    let weights = prepared(Weights::glorot(&base, 5));
    let picture = Picture::random(33, 47);
    let exposure = picture.exposure();
    let output = reference::forward(&base, &weights.to_f64(), &picture.input(48, exposure)).pop().unwrap();
    let (mut actual, mut expected) = (Vec::new(), Vec::new());
    for (c, plane) in reconstruct(&gpu, &weights, &picture).iter().enumerate() {
        for (i, radiance) in plane.iter().enumerate() {
            actual.push(to_network(*radiance, exposure));
            expected.push(output.at(0, c, i / 33, i % 33).max(0.0));
        }
    }
    assert!(expected.iter().filter(|t| **t > 0.0).count() > expected.len() / 10, "nearly all cut off");
    require("output", l2_close(&actual, &expected, 3e-5));
}

#[test]
fn guides_of_other_inputs_are_refused() {
    let gpu = gpu();
    let weights = prepared(Weights::glorot(&Architecture::base(&Widths::default()).unwrap(), 5));
    let (radiance, guides) = Picture::random(8, 8).upload(&gpu);
    let screen = guides.planes()[0].clone();
    let denoiser = Denoiser::new(&gpu, &weights, 8, 8).unwrap();
    let error = denoiser.record(&radiance, &Guides::NormalScreenDepth { screen }).err().expect("refused").to_string();
    assert!(error.contains("radiance,albedo,normal") && error.contains("normal_screen"), "{error}");
}
