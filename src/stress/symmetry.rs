//! What must change nothing, or only by a power of two: bit by bit.

use super::support::*;
use super::{Case, Checks, Outcome};
use crate::denoise::{Axes, Denoiser, Guides, Kernels, Plane, TiledDenoiser, Tiling, embedded_weights};
use crate::gpu::Gpu;
use crate::image::Image;
use crate::metrics::different_values;
use crate::render::{Estimator, Renderer, Sampler, Settings};
use crate::{Error, Result};
use glam::DVec3;

const BITS: &str = "values with other bits";

pub(super) const CASES: &[Case] = &[
    Case {
        number: "T9",
        name: "brighter by 2^k",
        claim: "radiance times 2^k gives the picture times 2^k, bit for bit",
        run: brighter,
    },
    Case {
        number: "T10",
        name: "larger by 2^k",
        claim: "lengths times 2^k give the same picture, and depths times 2^k, bit for bit",
        run: larger,
    },
    Case {
        number: "T11",
        name: "order of shapes",
        claim: "the order of the shapes in a scene changes no bit",
        run: order,
    },
    Case {
        number: "T12",
        name: "permuted colours",
        claim: "permuted colour channels give the permuted picture, bit for bit",
        run: colours,
    },
    Case {
        number: "T13",
        name: "interrupted",
        claim: "a render cut anywhere into parts, each resumed from the last one's checkpoint, has the bits of a whole one (parts rendered apart and merged do not exist yet)",
        run: interrupted,
    },
    Case {
        number: "T14",
        name: "chunks",
        claim: "dispatches of 1 to 64 samples, over all rows or bands of them, give the same bits",
        run: chunks,
    },
    Case {
        number: "T15",
        name: "tiles",
        claim: "a frame reconstructed in tiles has the bits of the frame reconstructed whole",
        run: tiles,
    },
];

fn base(gpu: &Gpu) -> Result<Image> {
    render(gpu, &cornell(48), &Settings::default())
}

fn map_channels(image: &Image, names: &[&str], f: impl Fn(f32) -> f32) -> Image {
    let mut image = image.clone();
    for name in names {
        if let Some(plane) = image.channels.get_mut(*name) {
            plane.iter_mut().for_each(|v| *v = f(*v));
        }
    }
    image
}

fn brighter(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let base = base(gpu)?;
    for power in [-40, 3, 60] {
        let mut scene = cornell(48);
        scene.shapes.iter_mut().for_each(|s| s.radiance *= f64::powi(2.0, power));
        let expected = map_channels(&base, &["R", "G", "B"], |v| v * f32::powi(2.0, power));
        let image = render(gpu, &scene, &Settings::default())?;
        checks.none(BITS, different_bits(&expected, &image), format_args!("2^{power}"));
    }
    Ok(checks.outcome())
}

fn larger(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let base = base(gpu)?;
    for power in [-20, 10, 20] {
        let scene = placed(cornell(48), f64::powi(2.0, power), DVec3::ZERO);
        let expected = map_channels(&base, &["Z"], |v| v * f32::powi(2.0, power));
        let image = render(gpu, &scene, &Settings::default())?;
        checks.none(BITS, different_bits(&expected, &image), format_args!("2^{power}"));
    }
    Ok(checks.outcome())
}

fn order(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    // Not square: on the diagonals of a square frame the edges between walls are ties.
    let mut scene = cornell(48);
    scene.camera.height = 37;
    let base = render(gpu, &scene, &Settings::default())?;
    scene.shapes.reverse();
    checks.none(BITS, different_bits(&base, &render(gpu, &scene, &Settings::default())?), "reversed");
    scene.shapes.rotate_left(3);
    checks.none(BITS, different_bits(&base, &render(gpu, &scene, &Settings::default())?), "rotated");
    Ok(checks.outcome())
}

fn colours(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let base = base(gpu)?;
    let mut turned = cornell(48);
    for shape in &mut turned.shapes {
        shape.albedo = DVec3::new(shape.albedo.y, shape.albedo.z, shape.albedo.x);
    }
    let image = render(gpu, &turned, &Settings::default())?;
    for (from, to) in [("G", "R"), ("B", "G"), ("R", "B")] {
        let different = different_values(&base.channels[from], &image.channels[to]);
        checks.none(BITS, different, format_args!("{from} became {to}"));
    }
    Ok(checks.outcome())
}

/// 160 samples with their variance where there is one.
fn with_variance(sampler: Sampler, aa: bool) -> Settings {
    Settings { spp: 160, sampler, aa, variance: true, ..Settings::default() }
}

fn interrupted(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let directory = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), e))?;
    let path = directory.path().join("render.checkpoint");
    for (sampler, aa) in [(Sampler::Pcg, false), (Sampler::Sobol, true)] {
        let settings = with_variance(sampler, aa);
        let whole = render(gpu, &cornell(40), &settings)?;
        // Dispatches that each part makes before it is cut, and their samples: the cuts are at no multiple of 64.
        for parts in [&[(5, 9)][..], &[(1, 1), (2, 33), (3, 7)]] {
            let at = format!("{sampler}, aa {aa}, parts {parts:?}");
            let mut last: Option<Image> = None;
            for &(dispatches, chunk) in parts {
                let mut part = Renderer::new(gpu, &cornell(40), &settings)?;
                if let Some(last) = &last {
                    part.restore(&path)?;
                    checks.none(
                        BITS,
                        different_bits(last, &part.image()?),
                        format_args!("{at}, right after the restore"),
                    );
                }
                part.limit_chunk(chunk);
                for _ in 0..dispatches {
                    part.advance()?;
                }
                part.checkpoint(&path)?;
                last = Some(part.image()?);
            }
            let mut rest = Renderer::new(gpu, &cornell(40), &settings)?;
            rest.restore(&path)?;
            checks.holds("parts that were not cut short", rest.samples_done() < settings.spp, &at);
            rest.finish()?;
            checks.none(BITS, different_bits(&whole, &rest.image()?), &at);
        }
    }
    Ok(checks.outcome())
}

fn chunks(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for (estimator, sampler) in [(Estimator::Nee, Sampler::Sobol), (Estimator::Cosine, Sampler::Pcg)] {
        for aa in [false, true] {
            let settings = Settings { estimator, ..with_variance(sampler, aa) };
            let whole = render(gpu, &cornell(40), &settings)?;
            for chunk in [1, 7, 33] {
                let mut renderer = Renderer::new(gpu, &cornell(40), &settings)?;
                renderer.limit_chunk(chunk);
                renderer.finish()?;
                let different = different_bits(&whole, &renderer.image()?);
                checks.none(BITS, different, format_args!("{estimator}+{sampler}, aa {aa}, chunks of {chunk}"));
            }
        }
    }
    // So many pixels that 64 samples of all of them exceed what a dispatch may take: bands of rows, until the renderer has
    // learned that the device is fast enough.
    let settings = Settings { spp: 64, bounces: 1, ..Settings::default() };
    let mut banded = Renderer::new(gpu, &cornell(256), &settings)?;
    banded.finish()?;
    let bands = f64::from(banded.stats()?.dispatches);
    let mut whole = Renderer::new(gpu, &cornell(256), &settings)?;
    whole.limit_chunk(2);
    whole.finish()?;
    if gpu.info().is_cpu {
        checks.at_least("bands of rows", bands, 2.0, "256x256");
    }
    checks.none(BITS, different_bits(&banded.image()?, &whole.image()?), format_args!("{bands} bands of rows"));
    Ok(checks.outcome())
}

/// A frame wider than the exact overlap of `seed`, so that tiles see a part of it.
fn tiles(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let mut scene = cornell(480);
    scene.camera.height = 40;
    let mut renderer = Renderer::new(gpu, &scene, &settings(4, 4, (Estimator::Nee, Sampler::Sobol)))?;
    renderer.finish()?;
    let weights = embedded_weights()?;
    let outputs = renderer.outputs()?;
    let kernels = Kernels::best(gpu.info());
    let denoiser = Denoiser::with_kernels(gpu, &weights, kernels, (480, 40))?;
    let inputs = denoiser.preparation().inputs;
    let guides = Guides::of(&outputs, inputs, Axes::default());
    let whole = denoiser.run(&outputs.radiance, &guides)?.0.concat();
    drop(denoiser);
    let slices = std::iter::once(&outputs.radiance).chain(guides.planes());
    let planes = slices.map(|slice| gpu.download::<[f32; 4]>(slice)).collect::<Result<Vec<_>>>()?;
    let pixels: Vec<Box<dyn Fn(usize) -> [f32; 4] + '_>> =
        planes.iter().map(|plane| Box::new(move |i: usize| plane[i]) as Box<dyn Fn(usize) -> [f32; 4]>).collect();
    let frame: Vec<Plane> = pixels.iter().map(|plane| &**plane as Plane).collect();
    let rules = kernels.tile_rules(&weights.architecture);
    let tiling = Tiling::cores((480, 40), 32, &rules);
    let count = tiling.count();
    let cut = TiledDenoiser::new(gpu, &weights, kernels, tiling)?.run(&frame, |_| ())?.0.concat();
    checks.at_least("tiles", f64::from(count), 2.0, "480x40");
    let different = different_values(&whole, &cut);
    checks.none(BITS, different, format_args!("{count} tiles"));
    Ok(checks.outcome())
}
