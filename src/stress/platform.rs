//! What drivers do: limits of loops and of time, repetition, other devices, lost memory.

use super::support::*;
use super::welch::{block_means, welch};
use super::{Case, Checks, Outcome};
use crate::gpu::{DeviceOptions, Gpu, list_devices};
use crate::image::Image;
use crate::render::{Estimator, Renderer, Sampler, Settings, loop_limit};
use crate::{Error, Result};

pub(super) const CASES: &[Case] = &[
    Case {
        number: "T33",
        name: "limit of loops",
        claim: "the number of loop iterations after which the driver stops silently is found, and no dispatch asks for more",
        run: loops,
    },
    Case {
        number: "T34",
        name: "length of dispatches",
        claim: "no dispatch of a render takes longer than 0.5 s, whatever the size and the samples (the first, with the driver's compilation, aside)",
        run: dispatches,
    },
    Case {
        number: "T35",
        name: "same bits again",
        claim: "two runs have the same bits, and another seed has others",
        run: again,
    },
    Case {
        number: "T36",
        name: "another device",
        claim: "a second device shows the same first hits and, by Welch's test on blocks, the same picture",
        run: another_device,
    },
    Case {
        number: "T37",
        name: "no memory",
        claim: "memory that the device does not have is an error that ends with exit code 1, after which the device works on and checkpoints are whole (a lost device cannot be made to order)",
        run: no_memory,
    },
];

fn loops(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let limit = loop_limit(gpu)?;
    checks.at_least("iterations", f64::from(limit), 1000.0, "the probe");
    checks.at_most("iterations ", f64::from(limit), 100_000.0, "the probe");
    if gpu.info().name.contains("llvmpipe") {
        checks.at_most("iterations of llvmpipe", f64::from(limit), 65_535.0, "has its budget been lifted?");
    }
    // 64 samples of 1,025 rays each take more iterations than llvmpipe has, even where it unrolls the loops over shapes: in one
    // dispatch the last of them would be lost.
    let camera = look(glam::DVec3::ZERO, glam::DVec3::NEG_Z, 60.0, 8, 8);
    let scene = crate::scene::Scene::new(camera, closed_box(0.5, 1.0));
    let (spp, bounces) = (64, Settings::MAX_BOUNCES);
    let settings = Settings { aa: true, ..settings(spp, bounces, (Estimator::Cosine, Sampler::Pcg)) };
    let image = render(gpu, &scene, &settings)?;
    // Sums of 0.5^k end at 2 exactly.
    let wrong = channel(&image, "R").into_iter().filter(|v| *v != 2.0).count();
    checks.none("pixels that lost samples", wrong, format_args!("{spp} samples, {bounces} reflections"));
    Ok(checks.outcome())
}

/// Desktop drivers end what takes 2 s; half a second leaves room for a device that is busy.
const MAX_DISPATCH_MS: f64 = 500.0;

fn dispatches(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for (size, spp, aa) in [(512, 64, true), (32, 16_384, false)] {
        let settings = Settings { spp, aa, ..Settings::default() };
        let mut renderer = Renderer::new(gpu, &cornell(size), &settings)?;
        renderer.advance()?;
        let mut longest = longest_dispatch(&mut renderer)?;
        // What else runs on the machine can only lengthen a dispatch: the better of two runs counts.
        if longest > MAX_DISPATCH_MS {
            longest = longest.min(longest_dispatch(&mut renderer)?);
        }
        checks.at_most(
            "longest dispatch, ms",
            longest,
            MAX_DISPATCH_MS,
            format_args!("{size}x{size}, {spp} samples, aa {aa}"),
        );
    }
    Ok(checks.outcome())
}

/// Of up to 12 dispatches, milliseconds.
fn longest_dispatch(renderer: &mut Renderer) -> Result<f64> {
    let mut longest = 0.0f64;
    for _ in 0..12 {
        let step = renderer.advance()?;
        longest = longest.max(step.device_ms);
        if step.done() {
            renderer.restart();
        }
    }
    Ok(longest)
}

fn again(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    const BITS: &str = "values with other bits";
    let mut renderer = Renderer::new(gpu, &cornell(48), &Settings::default())?;
    let mut run = |seed: u32| {
        renderer.set_seed(seed);
        renderer.finish()?;
        renderer.image()
    };
    let first = run(0)?;
    let other = run(1)?;
    checks.none(BITS, different_bits(&first, &run(0)?), "the same renderer");
    checks.none(BITS, different_bits(&first, &render(gpu, &cornell(48), &Settings::default())?), "another renderer");
    let changed = first.channels["R"].iter().zip(&other.channels["R"]).filter(|(a, b)| a != b).count();
    checks.at_least("pixels that another seed changes", changed as f64, 0.5 * 48.0 * 48.0, "seed 1");
    Ok(checks.outcome())
}

fn another_device(gpu: &Gpu) -> Result<Outcome> {
    let this = gpu.info().index;
    let Some(other) = list_devices()?.into_iter().find(|d| d.index != this && d.unusable.is_empty()) else {
        return Ok(Outcome::not_run("there is no second usable Vulkan device"));
    };
    let options = DeviceOptions { select: Some(other.index.to_string()), ..DeviceOptions::default() };
    let other = Gpu::new(&options)?;
    let mut checks = Checks::default();
    let at = other.info().name.clone();
    let first = |gpu| render(gpu, &cornell(96), &Settings { spp: 1, ..Settings::default() });
    let (a, b) = (first(gpu)?, first(&other)?);
    checks.none("first hits of another surface away from edges", other_surfaces(&a, &b), &at);
    let means = |gpu, seed| {
        let settings = Settings { spp: 16, ..Settings::default() };
        block_means(&mut Renderer::new(gpu, &cornell(96), &settings)?, 16, seed)
    };
    welch(&means(gpu, 0)?, &means(&other, 100)?, 1.0).check(&mut checks, &at);
    Ok(checks.outcome())
}

/// Pixels whose first hit has another albedo or normal than on the other device, and all of whose neighbours have their own.
fn other_surfaces(a: &Image, b: &Image) -> usize {
    let names = ["albedo.R", "albedo.G", "albedo.B", "N.X", "N.Y", "N.Z"];
    let width = a.width as usize;
    let near = |x: &Image, y: &Image, i: usize, j: usize| {
        names.iter().all(|name| (x.channels[*name][i] - y.channels[*name][j]).abs() < 0.2)
    };
    let inner = (0..a.pixel_count()).filter(|i| {
        let (x, y) = (i % width, i / width);
        let flat = |j: usize| near(a, a, *i, j);
        x > 0
            && y > 0
            && x + 1 < width
            && y + 1 < a.height as usize
            && [i - 1, i + 1, i - width, i + width].into_iter().all(flat)
    });
    inner.filter(|&i| !near(a, b, i, i)).count()
}

fn no_memory(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let before = render(gpu, &cornell(24), &Settings::default())?;
    let directory = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), e))?;
    let path = directory.path().join("render.checkpoint");
    let mut renderer = Renderer::new(gpu, &cornell(24), &Settings::default())?;
    renderer.limit_chunk(4);
    renderer.advance()?;
    renderer.checkpoint(&path)?;
    let bytes = std::fs::read(&path).map_err(|e| Error::io(&path, e))?;
    for size in [1u64 << 46, 1 << 60] {
        let refused = gpu.buffer("far too much", size).err();
        let clean = refused.as_ref().is_some_and(|error| error.exit_code() == 1);
        checks.holds("failures that are no clean error", clean, format_args!("{size} bytes: {refused:?}"));
    }
    // A checkpoint that cannot be written leaves the one that is there.
    let nowhere = path.join("below a file");
    checks.holds("checkpoints written where none can be", renderer.checkpoint(&nowhere).is_err(), "below a file");
    checks.holds("checkpoints that changed", std::fs::read(&path).is_ok_and(|now| now == bytes), "after failures");
    // What a crash may leave: a part of a file. Refused, and the renderer is as it was.
    let cuts = (0..32).map(|i| i * bytes.len() / 32);
    let accepted = cuts.filter(|&end| renderer.restore_bytes(&bytes[..end]).is_ok()).count();
    checks.none("cut checkpoints accepted", accepted, "32 cuts");
    let flipped = |i: usize| {
        let mut flipped = bytes.clone();
        flipped[i * bytes.len() / 32] ^= 1;
        flipped
    };
    let accepted = (0..32).filter(|&i| renderer.restore_bytes(&flipped(i)).is_ok()).count();
    checks.none("damaged checkpoints accepted", accepted, "32 flipped bits");
    renderer.restore(&path)?;
    renderer.finish()?;
    checks.none("values with other bits", different_bits(&before, &renderer.image()?), "after failures");
    Ok(checks.outcome())
}
