//! The reconstruction, given what no renderer should give, with the weights that limpid is shipped with.

use super::{Case, Checks, Outcome};
use crate::Result;
use crate::denoise::{
    Denoiser, Guides, Inputs, Kernels, Plane, Preparation, TiledDenoiser, Tiling, embedded_names, weights_of,
};
use crate::gpu::Gpu;
use crate::metrics::different_values;
use crate::net::architecture::Op;
use crate::net::kernel::Family;
use crate::net::reference;
use crate::net::tensor::{Tensor, seed_of, uniform};
use crate::net::weights::Weights;
use std::path::Path;

pub(super) const CASES: &[Case] = &[
    Case {
        number: "N1",
        name: "constant pictures",
        claim: "pictures of nothing but 0, 1e-8, 6.5e4, 1e30, a denormal, a negative number, NaN or an infinity reconstruct finite; what had to be repaired is counted, and NaN and negative pictures give the bits of a black one",
        run: constant_pictures,
    },
    Case {
        number: "N2",
        name: "bad pixels",
        claim: "some pixels of each kind in a picture reconstruct finite and are counted, exact ones too, whole or in tiles",
        run: bad_pixels,
    },
    Case {
        number: "N3",
        name: "bad guides",
        claim: "normals, depths and albedos that are NaN, infinite or huge leave the reconstruction finite and are counted, and NaN is as good as no guide",
        run: bad_guides,
    },
    Case {
        number: "N4",
        name: "beyond f16 in fp32",
        claim: "with values of 8e6 to 1e12 times their size inside the network, beyond 65504 at the bottleneck, kernels in fp32 give the same bits",
        run: large_values,
    },
    Case {
        number: "N5",
        name: "beyond f16 in halves",
        claim: "with such values kernels that round to f16 keep the reconstruction finite",
        run: overflowing_halves,
    },
];

const SIZE: (u32, u32) = (64, 48);
const PIXELS: usize = 64 * 48;
const BAD: [f32; 4] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0];
const UNREADABLE: &str = "values that are not finite or negative";
const MISCOUNTED: &str = "repaired pixels miscounted";

/// A picture as a renderer gives it: radiance over four decades, nothing exact, and guides within their ranges.
#[derive(Clone)]
struct Picture {
    /// Radiance first; see [`Inputs::planes`].
    planes: Vec<Vec<[f32; 4]>>,
}

impl Picture {
    fn random(inputs: Inputs) -> Self {
        let stream = seed_of("stress picture");
        let u = |plane: usize, i: usize, k: usize| uniform(stream, ((plane * PIXELS + i) * 4 + k) as u64);
        let value = |plane: usize, i: usize, k: usize| match (plane, inputs, k) {
            (_, _, 3) => 0.0,
            (0, ..) => 10f64.powf(4.0 * u(plane, i, k) - 3.0),
            // Depth, albedo.
            (1, Inputs::NormalScreenDepth, 2) => 1.0 + 4.0 * u(plane, i, k),
            (1, Inputs::AlbedoNormal, _) => u(plane, i, k),
            _ => 1.1 * u(plane, i, k) - 0.55,
        };
        let pixel = |plane, i| std::array::from_fn(|k| value(plane, i, k) as f32);
        let planes = (0..inputs.planes().len()).map(|plane| (0..PIXELS).map(|i| pixel(plane, i)).collect());
        Self { planes: planes.collect() }
    }

    fn constant(inputs: Inputs, radiance: f32) -> Self {
        let mut picture = Self::random(inputs);
        picture.planes[0].fill([radiance, radiance, radiance, 0.0]);
        picture
    }
}

/// A network made ready for pictures of [`SIZE`].
struct Network {
    gpu: Gpu,
    inputs: Inputs,
    denoiser: Denoiser,
}

impl Network {
    fn new(gpu: &Gpu, weights: &Weights, kernels: Kernels) -> Result<Self> {
        let inputs = Preparation::of_weights(weights, "weights")?.inputs;
        Ok(Self { gpu: gpu.clone(), inputs, denoiser: Denoiser::with_kernels(gpu, weights, kernels, SIZE)? })
    }

    /// The planes r, g, b, one after another.
    fn run(&self, picture: &Picture) -> Result<Vec<f32>> {
        let upload = |plane: &Vec<[f32; 4]>| {
            let buffer = self.gpu.buffer("plane", PIXELS as u64 * 16)?;
            let slice = buffer.slice(0, PIXELS as u64 * 16);
            self.gpu.upload(&slice, plane)?;
            Ok(slice)
        };
        let slices = picture.planes.iter().map(upload).collect::<Result<Vec<_>>>()?;
        Ok(self.denoiser.run(&slices[0], &Guides::of_planes(self.inputs, &slices[1..]))?.0.concat())
    }

    /// Runs a picture of which `bad` pixels need repair.
    fn check(&self, checks: &mut Checks, picture: &Picture, bad: usize, at: &str) -> Result<Vec<f32>> {
        let result = self.run(picture)?;
        checks.none(UNREADABLE, unreadable(&result), at);
        checks.count(MISCOUNTED, self.denoiser.repaired()?, bad as u64, at);
        Ok(result)
    }
}

fn unreadable(values: &[f32]) -> usize {
    values.iter().filter(|v| !(v.is_finite() && **v >= 0.0)).count()
}

/// All weights that limpid was shipped with, by name.
fn shipped() -> Result<Vec<(&'static str, Weights)>> {
    embedded_names().map(|name| Ok((name, weights_of(Path::new(name))?))).collect()
}

fn constant_pictures(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for (name, weights) in shipped()? {
        let network = Network::new(gpu, &weights, Kernels::best(gpu.info()))?;
        let picture = |radiance| Picture::constant(network.inputs, radiance);
        let black = network.check(&mut checks, &picture(0.0), 0, &format!("{name}, 0"))?;
        for radiance in [1e-8, 6.5e4, 1e30, 1e-41, f32::MAX] {
            network.check(&mut checks, &picture(radiance), 0, &format!("{name}, {radiance:e}"))?;
        }
        for radiance in BAD {
            let at = format!("{name}, {radiance}");
            let result = network.check(&mut checks, &picture(radiance), PIXELS, &at)?;
            if radiance != f32::INFINITY {
                checks.none("values unlike those of a black picture", different_values(&result, &black), &at);
            }
        }
    }
    Ok(checks.outcome())
}

fn bad_pixels(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for (name, weights) in shipped()? {
        let kernels = Kernels::best(gpu.info());
        let network = Network::new(gpu, &weights, kernels)?;
        let mut picture = Picture::random(network.inputs);
        network.check(&mut checks, &picture, 0, &format!("{name}, a good picture"))?;
        // -0, denormals and the largest number are as good as any.
        for (i, good) in [-0.0, 1e-41, 1e30, f32::MAX, 0.0].into_iter().enumerate() {
            picture.planes[0][31 * i] = [good, 0.5, good, 0.0];
        }
        network.check(&mut checks, &picture, 0, &format!("{name}, good pixels"))?;
        // In one channel or in all; every other one is called exact.
        let mut bad = 0;
        for (i, value) in BAD.into_iter().cycle().take(40).enumerate() {
            let exact = f32::from(u8::from(i % 2 == 0));
            picture.planes[0][200 + 67 * i] =
                if i < 20 { [0.5, value, 0.5, exact] } else { [value, value, value, exact] };
            bad += 1;
        }
        let at = format!("{name}, {bad} bad pixels");
        let whole = network.check(&mut checks, &picture, bad, &at)?;
        let planes: Vec<_> = picture.planes.iter().map(|plane| move |i: usize| plane[i]).collect();
        let frame: Vec<Plane> = planes.iter().map(|plane| plane as Plane).collect();
        let rules = kernels.tile_rules(&weights.architecture);
        let tiling = Tiling::overlapping(SIZE, 32, (0, false), &rules);
        checks.at_least("tiles", f64::from(tiling.count()), 2.0, &at);
        let mut tiled = TiledDenoiser::new(gpu, &weights, kernels, tiling)?;
        let cut = tiled.run(&frame, |_| ())?.0.concat();
        checks.none(UNREADABLE, unreadable(&cut), format_args!("{at}, tiled"));
        checks.count(MISCOUNTED, tiled.repaired()?, bad as u64, format_args!("{at}, tiled"));
        // Tiles that do not overlap are another picture: else nothing was cut.
        checks.at_least("values that tiles change", different_values(&whole, &cut) as f64, 1.0, &at);
    }
    Ok(checks.outcome())
}

fn bad_guides(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for (name, weights) in shipped()? {
        let network = Network::new(gpu, &weights, Kernels::best(gpu.info()))?;
        let good = Picture::random(network.inputs);
        for plane in 1..good.planes.len() {
            for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, f32::MAX, -1e30, 1e-41] {
                let bad = if value.is_finite() { 0 } else { PIXELS };
                let at = format!("{name}, plane {plane} all {value}");
                let mut all = good.clone();
                all.planes[plane].fill([value; 4]);
                let result = network.check(&mut checks, &all, bad, &at)?;
                if value.is_nan() {
                    all.planes[plane].fill([0.0; 4]);
                    let none = network.run(&all)?;
                    checks.none(
                        "values unlike those of a picture without the guide",
                        different_values(&result, &none),
                        &at,
                    );
                }
                let mut some = good.clone();
                (0..24).for_each(|i| some.planes[plane][5 + 101 * i][i % 3] = value);
                let bad = if value.is_finite() { 0 } else { 24 };
                network.check(&mut checks, &some, bad, &format!("{name}, plane {plane}, 24 pixels {value}"))?;
            }
        }
    }
    Ok(checks.outcome())
}

/// Weights of the same function, but every value between the first convolution and the linear ones is `factor` times as large. For a
/// power of two f32 computes the same bits, as long as nothing overflows.
fn amplified(weights: &Weights, factor: f32) -> Weights {
    let mut weights = weights.clone();
    let nodes = weights.architecture.nodes().to_vec();
    // By how much each channel of each node is larger.
    let mut scales: Vec<Vec<f32>> = Vec::new();
    for node in &nodes {
        let from = |i: usize| scales[node.inputs[i]].clone();
        let scale = match node.op {
            Op::Input { channels } => vec![1.0; channels],
            Op::MaxPool | Op::Upsample => from(0),
            Op::Concat => [from(0), from(1)].concat(),
            Op::Demodulate | Op::MaskedPool | Op::KernelFilter | Op::Modulate => vec![1.0; node.channels],
            Op::Conv { cin, cout, slope } => {
                let out = if slope.is_none() { 1.0 } else { factor };
                if let Some(range) = &node.parameters {
                    let weight = weights.parameters[range.weight.clone()].iter_mut().enumerate();
                    let from = from(0);
                    weight.for_each(|(i, v)| *v *= out / from[i / 9 % cin]);
                    weights.parameters[range.bias.clone()].iter_mut().for_each(|v| *v *= out);
                }
                vec![out; cout]
            }
        };
        scales.push(scale);
    }
    weights
}

/// The largest value of the coarsest level, for an input of halves, in f64.
fn bottleneck(weights: &Weights) -> f64 {
    let side = weights.architecture.alignment();
    let input = Tensor::zeros([1, weights.architecture.input_channels(), side, side]).map(|_: f64| 0.5);
    let values = reference::forward(&weights.architecture, &weights.to_f64(), &input);
    let coarsest = values.iter().map(|value| value.shape[3]).min().unwrap_or(0);
    let level = values.iter().filter(|value| value.shape[3] == coarsest);
    level.flat_map(|value| &value.data).fold(0.0, |most, v| most.max(v.abs()))
}

/// 2^23 to 2^40: far beyond f16, and within f32 with its products.
const FACTORS: [f32; 3] = [8_388_608.0, 1_073_741_824.0, 1_099_511_627_776.0];

fn large_values(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for (name, weights) in shipped()? {
        let strongest = bottleneck(&amplified(&weights, FACTORS[0]));
        checks.at_least("largest value at the bottleneck", strongest, 65_504.0, name);
        for family in Family::all(gpu.info()).into_iter().filter(|family| !matches!(family, Family::Coop(_))) {
            let run = |weights: &Weights| {
                let network = Network::new(gpu, weights, Kernels::of(family))?;
                network.run(&Picture::random(network.inputs))
            };
            let plain = run(&weights)?;
            for factor in FACTORS {
                let at = format!("{name}, {}, times {factor:e}", family.name());
                checks.none(
                    "values with other bits",
                    different_values(&run(&amplified(&weights, factor))?, &plain),
                    at,
                );
            }
        }
    }
    Ok(checks.outcome())
}

fn overflowing_halves(gpu: &Gpu) -> Result<Outcome> {
    let Some(family) = Family::all(gpu.info()).into_iter().find(|family| matches!(family, Family::Coop(_))) else {
        return Ok(Outcome::not_run("the device has no kernels that round to f16"));
    };
    let mut checks = Checks::default();
    for (name, weights) in shipped()? {
        let strongest = bottleneck(&amplified(&weights, FACTORS[0]));
        checks.at_least("largest value at the bottleneck", strongest, 65_504.0, name);
        for factor in FACTORS {
            let network = Network::new(gpu, &amplified(&weights, factor), Kernels::of(family))?;
            let at = format!("{name}, times {factor:e}");
            network.check(&mut checks, &Picture::random(network.inputs), 0, &at)?;
            network.check(&mut checks, &Picture::constant(network.inputs, 1e30), 0, &at)?;
        }
    }
    Ok(checks.outcome())
}
