//! Tiles with an overlap of the user's choice: what their windows see, and how their results are joined.

mod common;

use common::compare::{require, same_bits, within};
use common::gpu;
use common::networks::{conv, linear};
use limpid::denoise::{Inputs, Kernels, Overlapping, Plane, Preparation, Rect, Task, Tile, TiledDenoiser, Tiling};
use limpid::gpu::Gpu;
use limpid::net::architecture::{Architecture, Op, Row};
use limpid::net::plan::TileRules;
use limpid::net::tensor::uniform;
use limpid::net::weights::Weights;

/// Two poolings.
fn small() -> Weights {
    let rows: &[Row] = &[
        ("input", Op::Input { channels: 6 }, &[]),
        ("a", conv(6, 16), &["input"]),
        ("pool1", Op::MaxPool, &["a"]),
        ("pool2", Op::MaxPool, &["pool1"]),
        ("b", conv(16, 16), &["pool2"]),
        ("up2", Op::Upsample, &["b"]),
        ("up1", Op::Upsample, &["up2"]),
        ("cat", Op::Concat, &["up1", "a"]),
        ("out", linear(32, 3), &["cat"]),
    ];
    let architecture = Architecture::from_rows("small", rows).unwrap();
    let mut weights = Weights::glorot(&architecture, 3);
    for layer in architecture.tensors().iter().filter(|t| t.name.ends_with(".bias")) {
        // So that zeros beyond a window are not what a layer makes of them.
        weights.parameters[layer.range.clone()].fill(0.3);
    }
    weights.metadata.extend(Preparation::of_architecture(&architecture).unwrap().metadata());
    weights
}

/// Radiance and depth of 1 everywhere, so that every part of a frame has its exposure and depth scale; normals at random, every fifth pixel
/// exact.
#[derive(Clone)]
struct Frame {
    size: (u32, u32),
    normals: Vec<[f32; 2]>,
    exact: Vec<bool>,
}

impl Frame {
    fn random((width, height): (u32, u32)) -> Self {
        let normal = |i: u64| [0, 1].map(|k| (2.0 * uniform(5, i * 2 + k) - 1.0) as f32);
        let count = u64::from(width) * u64::from(height);
        let exact = (0..count).map(|i| i.is_multiple_of(5)).collect();
        Self { size: (width, height), normals: (0..count).map(normal).collect(), exact }
    }

    fn part(&self, part: Rect) -> Self {
        let at = |i: u32| (part.y + i / part.width) * self.size.0 + part.x + i % part.width;
        let places: Vec<usize> = (0..part.pixels() as u32).map(|i| at(i) as usize).collect();
        let normals = places.iter().map(|&i| self.normals[i]).collect();
        Self { size: (part.width, part.height), normals, exact: places.iter().map(|&i| self.exact[i]).collect() }
    }

    /// The result and (exposure, 1 / depth).
    fn run(&self, gpu: &Gpu, weights: &Weights, tiling: Tiling) -> (Vec<f32>, [f32; 2]) {
        assert_eq!(tiling.size(), self.size);
        let mut denoiser = TiledDenoiser::new(gpu, weights, Kernels::best(gpu.info()), tiling).unwrap();
        let screen = |i: usize| [self.normals[i][0], self.normals[i][1], 1.0, 0.0];
        let radiance = |i: usize| [1.0, 1.0, 1.0, f32::from(u8::from(self.exact[i]))];
        let planes: [Plane; 2] = [&radiance, &screen];
        let (result, _) = denoiser.run(&planes, |_| ()).unwrap();
        (result.concat(), denoiser.stats().unwrap())
    }
}

fn rules(gpu: &Gpu, weights: &Weights) -> TileRules {
    Kernels::best(gpu.info()).tile_rules(&weights.architecture)
}

const RULES: [TileRules; 3] = [
    TileRules { alignment: 32, step: 32, overlap: 128 },
    TileRules { alignment: 4, step: 8, overlap: 16 },
    TileRules { alignment: 1, step: 1, overlap: 4 },
];

/// The share of core `low..high` in the pixels about `x`, half pixels at both ends: a count, not a difference of ends.
fn weight_by_count(x: i64, reach: i64, core: std::ops::Range<i64>) -> f64 {
    let halves = (x - reach..=x + reach).map(|j| {
        let half = if j.abs_diff(x) == reach as u64 { 1 } else { 2 };
        if core.contains(&j) { half } else { 0 }
    });
    halves.sum::<u32>() as f64 / (4 * reach) as f64
}

/// The weight of a tile at a pixel; cores at a frame's ends go on beyond them.
fn expected_weight(tile: &Tile, (x, y): (u32, u32), reach: u32, padded: (u32, u32)) -> f64 {
    let axis = |at: u32, begin: u32, length: u32, padded: u32| {
        let low = if begin == 0 { i64::MIN } else { begin.into() };
        let high = if begin + length == padded { i64::MAX } else { (begin + length).into() };
        weight_by_count(at.into(), reach.into(), low..high)
    };
    axis(x, tile.core.x, tile.core.width, padded.0) * axis(y, tile.core.y, tile.core.height, padded.1)
}

#[test]
fn chunks_lie_on_their_grid() {
    let tiling = Tiling::overlapping((768, 768), 128, (0, false), &RULES[0]);
    assert_eq!((tiling.count(), tiling.window(), tiling.core()), (36, (128, 128), (128, 128)));
    for (i, tile) in tiling.tiles().enumerate() {
        let (x, y) = (i as u32 % 6 * 128, i as u32 / 6 * 128);
        let chunk = Rect { x, y, width: 128, height: 128 };
        assert_eq!((tile.window, tile.core), (chunk, chunk));
    }
    assert!(!tiling.is_exact() && !tiling.blend());
    assert_eq!((tiling.overlap(), tiling.exact_overlap()), (0, 128));
}

/// Each pixel in one core; windows of one size that hold what they must and stay in the padded frame; with blending, weights that
/// sum to 1.
#[test]
fn windows_and_weights_of_any_overlap() {
    for rules in &RULES {
        for (width, height) in [(1, 1), (31, 33), (333, 221), (300, 40)] {
            for (core, overlap) in [(1, 0), (1, 5), (2, 7), (3, 1), (4, 200), (2, u32::MAX / 4)] {
                for blend in [false, true] {
                    let core = core * rules.step;
                    if overlap > 0 || !blend {
                        let tiling = Tiling::overlapping((width, height), core, (overlap, blend), rules);
                        check(&tiling, (core, overlap), rules);
                    }
                }
            }
        }
    }
}

fn check(tiling: &Tiling, (core, overlap): (u32, u32), rules: &TileRules) {
    let (width, height) = tiling.size();
    let padded = [width, height].map(|size| size.next_multiple_of(rules.alignment));
    let exact = overlap >= rules.overlap && !tiling.blend();
    assert_eq!(tiling.is_exact(), exact || tiling.count() == 1, "{tiling:?}");
    let mut sums = vec![0.0; (width * height) as usize];
    let mut cores = vec![0; (width * height) as usize];
    for tile in tiling.tiles() {
        let what = format!("{tiling:?}: {tile:?}");
        let within = |inner: Rect, outer: Rect| {
            inner.x >= outer.x
                && inner.y >= outer.y
                && inner.x + inner.width <= outer.x + outer.width
                && inner.y + inner.height <= outer.y + outer.height
        };
        assert!(within(tile.window, Rect { x: 0, y: 0, width: padded[0], height: padded[1] }), "{what}");
        assert_eq!((tile.window.width, tile.window.height), tiling.window());
        assert!(exact || tiling.count() == 1 || (tile.core.x % core, tile.core.y % core) == (0, 0), "{what}");
        let c = tile.core.within((width, height));
        let (x, y) = (c.x.saturating_sub(overlap), c.y.saturating_sub(overlap));
        let end = |at: u32, length: u32, padded: u32| (at + length).saturating_add(overlap).min(padded);
        let (right, bottom) = (end(c.x, c.width, width), end(c.y, c.height, height));
        assert!(within(Rect { x, y, width: right - x, height: bottom - y }, tile.window), "{what}");
        for y in c.y..c.y + c.height {
            (c.x..c.x + c.width).for_each(|x| cores[(y * width + x) as usize] += 1);
        }
        if tiling.blend() {
            let (part, [columns, rows]) = tiling.weights(&tile);
            assert!(within(part, tile.window.within((width, height))), "{what}: {part:?}");
            for (y, row) in (part.y..).zip(&rows) {
                (part.x..).zip(&columns).for_each(|(x, column)| sums[(y * width + x) as usize] += row * column);
            }
        }
    }
    assert!(cores.iter().all(|count| *count == 1), "{tiling:?}");
    if tiling.blend() {
        // Up to about 400 x 400 shares of a few roundings each, sum 1.
        assert!(sums.iter().all(|sum: &f64| (sum - 1.0).abs() < 1e-12), "{tiling:?}");
    }
}

/// A window sees the pixels up to the overlap, and none beyond those that the grid adds.
#[test]
fn tiles_see_what_the_overlap_says() {
    let (gpu, weights) = (gpu(), small());
    let rules = rules(&gpu, &weights);
    let core = rules.step.max(8);
    let frame = Frame::random((4 * core + 3, core));
    for overlap in [0, 1, 3] {
        let tiling = Tiling::overlapping(frame.size, core, (overlap, false), &rules);
        let (plain, _) = frame.run(&gpu, &weights, tiling);
        // The second of five tiles, and what its result becomes where a column of normals is another.
        let tile = tiling.tiles().nth(1).unwrap();
        assert_eq!((tiling.count(), tile.core.x, tile.core.width), (5, core, core));
        let inside = |values: &[f32]| -> Vec<f32> {
            let row = frame.size.0 as usize;
            let (begin, end) = (core as usize, 2 * core as usize);
            values.chunks(row).flat_map(|line| line[begin..end].to_vec()).collect()
        };
        let changed = |column: u32| {
            let mut other = frame.clone();
            let width = frame.size.0;
            other.normals.iter_mut().skip(column as usize).step_by(width as usize).for_each(|n| *n = [0.9, -0.9]);
            let (result, _) = other.run(&gpu, &weights, tiling);
            inside(&result) != inside(&plain)
        };
        let end = core - overlap + tiling.window().0;
        let seen = [core - overlap, core, 2 * core - 1, 2 * core - 1 + overlap];
        for column in seen {
            assert!(changed(column), "overlap {overlap}: column {column} is not seen");
        }
        for column in [core - overlap - 1, end] {
            assert!(!changed(column), "overlap {overlap}: column {column} is seen");
        }
    }
}

#[test]
fn the_exact_overlap_and_more_are_exact() {
    let (gpu, weights) = (gpu(), small());
    let rules = rules(&gpu, &weights);
    let frame = Frame::random((117, 61));
    let (whole, _) = frame.run(&gpu, &weights, Tiling::whole(frame.size, &rules));
    for overlap in [rules.overlap, rules.overlap + 3] {
        let tiling = Tiling::overlapping(frame.size, rules.step, (overlap, false), &rules);
        assert!(tiling.count() > 4 && tiling.is_exact(), "{tiling:?}");
        require("exact", same_bits(&frame.run(&gpu, &weights, tiling).0, &whole));
    }
    let (chunks, _) = frame.run(&gpu, &weights, Tiling::overlapping(frame.size, rules.step, (0, false), &rules));
    assert!(same_bits(&chunks, &whole).is_err(), "chunks without overlap have no seams");
}

/// Every window, reconstructed as a frame of its own, and these joined by hand.
#[test]
fn tiles_are_windows_joined() {
    let (gpu, weights) = (gpu(), small());
    let rules = rules(&gpu, &weights);
    let core = rules.step.max(8);
    let frame = Frame::random((3 * core + 5, 2 * core + 3));
    let padded = (frame.size.0.next_multiple_of(4), frame.size.1.next_multiple_of(4));
    let (_, stats) = frame.run(&gpu, &weights, Tiling::whole(frame.size, &rules));
    for (overlap, blend) in [(0, false), (2, false), (1, true), (3, true), (core - 1, true)] {
        let tiling = Tiling::overlapping(frame.size, core, (overlap, blend), &rules);
        let count = (frame.size.0 * frame.size.1) as usize;
        let mut expected = vec![0.0; 3 * count];
        assert!(tiling.count() > 1, "{tiling:?}");
        for tile in tiling.tiles() {
            let window = tile.window.within(frame.size);
            let part = frame.part(window);
            let (result, part_stats) = part.run(&gpu, &weights, Tiling::whole(part.size, &rules));
            assert_eq!(part_stats, stats);
            for i in 0..window.pixels() as usize {
                let (x, y) = (window.x + i as u32 % window.width, window.y + i as u32 / window.width);
                let weight = if blend {
                    expected_weight(&tile, (x, y), overlap, padded)
                } else {
                    let core = tile.core;
                    let inside = |at: u32, begin: u32, length: u32| at >= begin && at < begin + length;
                    f64::from(inside(x, core.x, core.width) && inside(y, core.y, core.height))
                };
                for c in 0..3 {
                    let value = result[c * result.len() / 3 + i];
                    expected[c * count + (y * frame.size.0 + x) as usize] += weight * f64::from(value);
                }
            }
        }
        let (found, _) = frame.run(&gpu, &weights, tiling);
        // One rounding to f32, and those of sums in f64.
        let bound: Vec<f64> = expected.iter().map(|v: &f64| v.abs() * 2f64.powi(-23)).collect();
        require(&format!("{tiling:?}"), within(&found, &expected, &bound));
        let radiance = |i: usize| if frame.exact[i % count] { 1.0 } else { found[i] };
        require("exact pixels", same_bits(&found, &(0..3 * count).map(radiance).collect::<Vec<f32>>()));
    }
}

#[test]
fn demands_that_cannot_be_met() {
    let gpu = gpu();
    let seed = Architecture::seed();
    let (kernels, inputs) = (Kernels::best(gpu.info()), Inputs::NormalScreenDepth);
    let task = Task { info: gpu.info(), architecture: &seed, inputs, kernels, size: (1000, 700), resident: false };
    let choose = |core, overlap, blend| task.choose_overlapping(&Overlapping { core, overlap, blend });
    let message = |core, overlap, blend| choose(core, overlap, blend).unwrap_err().to_string();
    assert!(message(100, 8, false).contains("96 or 128"));
    let found = message(128, 0, true);
    assert!(found.contains("--blend") && found.contains("--overlap"), "{found}");
    let choice = choose(128, 8, true).unwrap();
    assert_eq!((choice.tiling.window(), choice.tiling.count()), ((160, 160), 48));
    let footprint = TiledDenoiser::footprint(&seed, inputs, kernels, &choice.tiling);
    assert_eq!(choice.bytes, footprint.bytes);
    // A window that the device cannot hold.
    let huge = Task { size: (16_384, 16_384), ..task };
    let found =
        huge.choose_overlapping(&Overlapping { core: 16_000, overlap: 8, blend: false }).unwrap_err().to_string();
    assert!(found.contains("--tile 16000") && found.contains("would do"), "{found}");
}
