//! Tiles against the whole frame: the same bits, for every set of kernels that the device runs; and the memory that they
//! take, which is known beforehand.

mod common;

use common::compare::{require, same_bits};
use common::gpu;
use common::networks::{conv, cut, forward, linear};
use limpid::denoise::{
    Choice, Demand, Denoiser, FrameStats, Guides, Inputs, Kernels, Plane, Preparation, Task, TiledDenoiser, Tiling,
    Transfer,
};
use limpid::gpu::{DeviceOptions, Gpu, Slice};
use limpid::net::architecture::{Architecture, Op, Row};
use limpid::net::kernel::Family;
use limpid::net::plan::{Fusion, Memory, TileRules};
use limpid::net::tensor::{Tensor, seed_of, uniform};
use limpid::net::weights::Weights;

/// Every set of kernels that the device runs.
fn all_kernels(gpu: &Gpu) -> Vec<Kernels> {
    let fusions = |family: Family| {
        let list = [Fusion::Layers, Fusion::Activation, Fusion::best(family)];
        let count = if list[1] == list[2] { 2 } else { 3 };
        list.into_iter().take(count).map(move |fusion| Kernels { family, fusion })
    };
    Family::all(gpu.info()).into_iter().flat_map(fusions).collect()
}

/// Two poolings and channels enough for the kernels of wide layers at three resolutions.
fn small() -> Weights {
    let rows: &[Row] = &[
        ("input", Op::Input { channels: 6 }, &[]),
        ("a", conv(6, 48), &["input"]),
        ("pool1", Op::MaxPool, &["a"]),
        ("b", conv(48, 48), &["pool1"]),
        ("pool2", Op::MaxPool, &["b"]),
        ("c", conv(48, 48), &["pool2"]),
        ("up2", Op::Upsample, &["c"]),
        ("cat2", Op::Concat, &["up2", "b"]),
        ("d", conv(96, 48), &["cat2"]),
        ("up1", Op::Upsample, &["d"]),
        ("cat1", Op::Concat, &["up1", "a"]),
        ("e", conv(96, 48), &["cat1"]),
        ("out", linear(48, 3), &["e"]),
    ];
    glorot(&Architecture::from_rows("small", rows).unwrap())
}

/// Two filters whose logits hardly reach beyond their pixel: what a tile must show is what the filters read.
fn filters() -> Weights {
    let rows: &[Row] = &[
        ("input", Op::Input { channels: 9 }, &[]),
        ("radiance0", Op::Demodulate, &["input"]),
        ("radiance1", Op::MaskedPool, &["radiance0"]),
        ("pool", Op::MaxPool, &["input"]),
        ("logits1", linear(9, 25), &["pool"]),
        ("filter1", Op::KernelFilter, &["logits1", "radiance1"]),
        ("logits0", linear(9, 34), &["input"]),
        ("filter0", Op::KernelFilter, &["logits0", "radiance0", "filter1"]),
        ("output", Op::Modulate, &["filter0", "input"]),
    ];
    glorot(&Architecture::from_rows("filters", rows).unwrap())
}

fn seed() -> Weights {
    glorot(&Architecture::seed())
}

fn glorot(architecture: &Architecture) -> Weights {
    let mut weights = Weights::glorot(architecture, 3);
    weights.metadata.extend(Preparation::of_architecture(architecture).unwrap().metadata());
    weights
}

/// Radiance over three decades, brighter to the right; every seventh pixel exact. Normals, depths and albedo at random.
struct Frame {
    size: (u32, u32),
    inputs: Inputs,
    planes: Vec<Vec<[f32; 4]>>,
}

impl Frame {
    fn random((width, height): (u32, u32), inputs: Inputs) -> Self {
        let stream = seed_of(&format!("tiles {width}x{height}"));
        let u = |i: u64, k: u64| uniform(stream, i * 8 + k);
        let radiance = |i: u64| {
            let scale = 1.0 + (i % u64::from(width)) as f64 / 100.0;
            let level = |k| (scale * 10f64.powf(3.0 * u(i, k) - 2.0)) as f32;
            [level(0), level(1), level(2), f32::from(u8::from(i.is_multiple_of(7)))]
        };
        let screen = |i| {
            let signed = |k| (2.0 * u(i, k) - 1.0) as f32;
            [signed(3), signed(4), (1.0 + 4.0 * u(i, 5)) as f32, 0.0]
        };
        let albedo = |i| [u(i, 3) as f32, u(i, 4) as f32, u(i, 5) as f32, 0.0];
        let count = u64::from(width) * u64::from(height);
        let mut planes: Vec<Vec<[f32; 4]>> = vec![(0..count).map(radiance).collect()];
        match inputs {
            Inputs::NormalScreenDepth => planes.push((0..count).map(screen).collect()),
            Inputs::AlbedoNormal => {
                planes.push((0..count).map(albedo).collect());
                planes.push((0..count).map(screen).collect());
            }
        }
        Self { size: (width, height), inputs, planes }
    }

    fn upload(&self, gpu: &Gpu) -> (Slice, Guides) {
        let upload = |pixels: &Vec<[f32; 4]>| {
            let buffer = gpu.buffer("plane", pixels.len() as u64 * 16).unwrap();
            gpu.upload(&buffer.all(), pixels).unwrap();
            buffer.slice(0, pixels.len() as u64 * 16)
        };
        let slices: Vec<Slice> = self.planes.iter().map(upload).collect();
        (slices[0].clone(), Guides::of_planes(self.inputs, &slices[1..]))
    }

    fn whole(&self, gpu: &Gpu, weights: &Weights, kernels: Kernels) -> Vec<f32> {
        let (radiance, guides) = self.upload(gpu);
        let denoiser = Denoiser::with_kernels(gpu, weights, kernels, self.size).unwrap();
        denoiser.run(&radiance, &guides).unwrap().0.concat()
    }

    /// Calls `f` with the planes as the tiles' denoiser takes them.
    fn with_planes<R>(&self, f: impl FnOnce(&[Plane]) -> R) -> R {
        let pixels: Vec<_> = self.planes.iter().map(|plane| move |i: usize| plane[i]).collect();
        f(&pixels.iter().map(|pixel| pixel as Plane).collect::<Vec<_>>())
    }

    fn tiled(&self, gpu: &Gpu, weights: &Weights, kernels: Kernels, tiling: Tiling) -> Vec<f32> {
        let mut denoiser = TiledDenoiser::new(gpu, weights, kernels, tiling).unwrap();
        let mut shares = Vec::new();
        let (planes, _) = self.with_planes(|planes| denoiser.run(planes, |share| shares.push(share)).unwrap());
        assert_eq!((shares.len() as u32, shares.last()), (tiling.count(), Some(&1.0)));
        planes.concat()
    }
}

#[test]
fn tiles_equal_the_whole_frame() {
    let (gpu, weights) = (gpu(), small());
    let mut counts = Vec::new();
    for kernels in all_kernels(&gpu) {
        let rules = kernels.tile_rules(&weights.architecture);
        for (width, height) in [(117, 61), (50, 93), (9, 5)] {
            let frame = Frame::random((width, height), Inputs::NormalScreenDepth);
            let whole = frame.whole(&gpu, &weights, kernels);
            // One tile from host memory, then smaller and smaller ones.
            let mut tilings = vec![Tiling::whole(frame.size, &rules), Tiling::cores(frame.size, rules.step, &rules)];
            tilings.push(Tiling::cores(frame.size, 3 * rules.step, &rules));
            tilings.extend(Tiling::candidates(frame.size, rules).skip(1).step_by(3));
            for tiling in tilings {
                let tiled = frame.tiled(&gpu, &weights, kernels, tiling);
                require(&format!("{kernels:?}, {tiling:?}"), same_bits(&tiled, &whole));
                counts.push(tiling.count());
            }
        }
    }
    assert!(counts.iter().filter(|count| **count > 4).count() > 5, "hardly any tiles: {counts:?}");
}

/// A tile in which every pixel is exact does not go through the network: the same bits.
#[test]
fn tiles_without_noise_are_skipped() {
    let (gpu, weights) = (gpu(), small());
    let kernels = Kernels::best(gpu.info());
    let rules = kernels.tile_rules(&weights.architecture);
    let mut frame = Frame::random((117, 61), Inputs::NormalScreenDepth);
    let tiling = Tiling::cores(frame.size, rules.step, &rules);
    // All of the left 40 columns but one pixel.
    for y in 0..61 {
        (0..40).for_each(|x| frame.planes[0][y * 117 + x][3] = 1.0);
    }
    frame.planes[0][3 * 117 + 5][3] = 0.0;
    let inside = |core: limpid::denoise::Rect| core.x + core.width <= 40 && !(core.x <= 5 && core.y <= 3);
    let expected = tiling.tiles().filter(|tile| inside(tile.core)).count();
    assert!(expected > 1 && expected < tiling.count() as usize / 2, "{expected} of {}", tiling.count());
    let mut denoiser = TiledDenoiser::new(&gpu, &weights, kernels, tiling).unwrap();
    let (planes, _) = frame.with_planes(|planes| denoiser.run(planes, |_| ()).unwrap());
    assert_eq!(denoiser.skipped() as usize, expected);
    require("skipped", same_bits(&planes.concat(), &frame.whole(&gpu, &weights, kernels)));
}

/// The architectures that are shipped, at odd sizes.
#[test]
fn tiles_of_seed_equal_the_whole_frame() {
    let sizes = [((333, 221), 1), ((200, 410), 1), ((610, 33), 2)];
    tiles_equal_the_whole(&seed(), Inputs::NormalScreenDepth, &sizes);
}

#[test]
fn tiles_of_base_equal_the_whole_frame() {
    let sizes = [((333, 221), 2), ((99, 310), 1)];
    tiles_equal_the_whole(&glorot(&Architecture::named("base").unwrap()), Inputs::AlbedoNormal, &sizes);
}

#[test]
fn tiles_of_kpn_equal_the_whole_frame() {
    let sizes = [((333, 221), 2), ((99, 310), 1)];
    tiles_equal_the_whole(&glorot(&Architecture::named("kpn").unwrap()), Inputs::AlbedoNormal, &sizes);
    tiles_equal_the_whole(&filters(), Inputs::AlbedoNormal, &[((333, 221), 12), ((70, 411), 6)]);
}

fn tiles_equal_the_whole(weights: &Weights, inputs: Inputs, sizes: &[((u32, u32), u32)]) {
    let gpu = gpu();
    let kernels = Kernels::best(gpu.info());
    let rules = kernels.tile_rules(&weights.architecture);
    for (size, tiles) in sizes {
        let frame = Frame::random(*size, inputs);
        let tiling = Tiling::cores(frame.size, 64, &rules);
        assert!(tiling.count() >= *tiles, "{tiling:?}");
        let tiled = frame.tiled(&gpu, weights, kernels, tiling);
        require(&format!("{tiling:?}"), same_bits(&tiled, &frame.whole(&gpu, weights, kernels)));
    }
}

/// A tile of `seed` about columns 320 to 352 of a frame of 672 (or rows, where `turned`), in which everything beyond
/// `overlap` pixels from the core is `poison`: the core, and the core of the whole frame.
fn poisoned(
    gpu: &Gpu,
    kernels: Kernels,
    turned: bool,
    (overlap, margin): (usize, usize),
    poison: f32,
) -> [Vec<f32>; 2] {
    let (core, length, side) = (320..352, 672, 32);
    let of = |begin: usize, length: usize| if turned { [begin, 0, length, side] } else { [0, begin, side, length] };
    let [_, _, height, width] = of(0, length);
    let whole = Tensor::uniform([1, 6, height, width], 11);
    let begin = core.start - overlap - margin;
    let mut tile = cut(&whole, of(begin, core.len() + 2 * (overlap + margin)));
    let seen = margin..tile.shape[if turned { 2 } else { 3 }] - margin;
    let row = tile.shape[3];
    for (i, value) in tile.data.iter_mut().enumerate() {
        let at = if turned { i / row % tile.shape[2] } else { i % row };
        if !seen.contains(&at) {
            *value = poison;
        }
    }
    let weights = seed();
    let run = |input: &Tensor<f32>| forward(gpu, &weights, kernels.family, (Memory::Shared, kernels.fusion), input);
    let (tile, whole) = (run(&tile), run(&whole));
    [cut(&tile, of(overlap + margin, core.len())).data, cut(&whole, of(core.start, core.len())).data]
}

/// Nothing beyond the overlap reaches the core, be it no number; and the overlap is no larger than it must be: the next
/// smaller one gives other bits.
#[test]
fn the_overlap_is_exact() {
    let gpu = gpu();
    for kernels in all_kernels(&gpu) {
        let TileRules { alignment, step, overlap } = kernels.tile_rules(&Architecture::seed());
        // In blocks of 4x4 results, the last levels need a little more.
        let expected = if kernels.fusion == Fusion::InPlace { 192 } else { 128 };
        assert_eq!((alignment, step, overlap), (32, 32, expected), "{kernels:?}");
        let overlap = overlap as usize;
        for turned in [false, true] {
            let what = format!("{kernels:?}, turned {turned}");
            for poison in [f32::NAN, 1e4] {
                let [core, whole] = poisoned(&gpu, kernels, turned, (overlap, 64), poison);
                require(&format!("{what}, {poison}"), same_bits(&core, &whole));
            }
            // The tile ends there: zeros, as beyond a frame's end.
            let [core, whole] = poisoned(&gpu, kernels, turned, (overlap, 0), f32::NAN);
            require(&what, same_bits(&core, &whole));
            let [core, whole] = poisoned(&gpu, kernels, turned, (overlap - 32, 0), f32::NAN);
            let differ = core.iter().zip(&whole).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
            assert!(differ > 0, "{what}: an overlap of {} would do", overlap - 32);
            println!("{what}: with an overlap of {}, {differ} of {} values differ", overlap - 32, core.len());
        }
    }
}

/// Exposure and depth scale, found in strips as narrow as a row of bins, have the bits of the whole frame's.
#[test]
fn stats_of_strips_equal_the_frame() {
    let gpu = gpu();
    for weights in [small(), glorot(&Architecture::named("base").unwrap())] {
        let Preparation { inputs, transfer } = Preparation::of_weights(&weights, "weights").unwrap();
        let kernels = Kernels::best(gpu.info());
        let rules = kernels.tile_rules(&weights.architecture);
        for (width, height) in [(1, 1), (33, 47), (300, 285), (40, 2005), (5000, 40)] {
            let mut frame = Frame::random((width, height), inputs);
            // The deepest pixel is in the last row, the brightest bins are to the right.
            frame.planes[1].last_mut().unwrap()[2] = 77.0;
            let (radiance, guides) = frame.upload(&gpu);
            let out = gpu.buffer("stats", 16).unwrap().slice(0, 16);
            let mut rec = gpu.recorder();
            FrameStats::new(&gpu, transfer, width, height).unwrap().record(&mut rec, &radiance, &guides, &out).unwrap();
            rec.finish().unwrap().run().unwrap();
            let whole: Vec<f32> = gpu.download(&out).unwrap();
            assert_eq!(whole[1], if transfer == Transfer::Log1p { 1.0 / 77.0 } else { 1.0 });
            for tiling in [Tiling::whole(frame.size, &rules), Tiling::cores(frame.size, rules.step, &rules)] {
                let mut denoiser = TiledDenoiser::new(&gpu, &weights, kernels, tiling).unwrap();
                frame.with_planes(|planes| denoiser.measure(planes)).unwrap();
                let what = format!("{transfer:?}, {width}x{height}, {} tiles", tiling.count());
                require(&what, same_bits(&denoiser.stats().unwrap(), &whole[..2]));
            }
        }
    }
}

/// What a reconstruction takes is what was foretold, to the byte, before and after it runs; and hardly
/// more is reserved.
#[test]
fn memory_is_foretold() {
    let named = |name| glorot(&Architecture::named(name).unwrap());
    let weights = [small(), seed(), named("base"), named("kpn")];
    for kernels in all_kernels(&gpu()) {
        for weights in &weights {
            let rules = kernels.tile_rules(&weights.architecture);
            let inputs = Preparation::of_weights(weights, "weights").unwrap().inputs;
            let frame = Frame::random((400, 37), inputs);
            let tilings = [Tiling::whole(frame.size, &rules), Tiling::cores(frame.size, rules.step, &rules)];
            for tiling in tilings {
                // A device of its own, which counts nobody else's buffers.
                let gpu = Gpu::new(&DeviceOptions { validation: true, ..DeviceOptions::default() }).unwrap();
                let mut denoiser = TiledDenoiser::new(&gpu, weights, kernels, tiling).unwrap();
                let foretold = TiledDenoiser::footprint(&weights.architecture, inputs, kernels, &tiling).bytes;
                assert_eq!(foretold, gpu.peak_bytes(), "{kernels:?}, {tiling:?}");
                let tile = tiling.tiles().last().unwrap();
                frame.with_planes(|planes| {
                    denoiser.measure(planes).unwrap();
                    let mut result = [(); 3].map(|()| vec![0.0; frame.planes[0].len()]);
                    if weights.architecture.name() == "small" {
                        denoiser.reconstruct(planes, &tile, &mut result).unwrap();
                    }
                });
                assert_eq!(foretold, gpu.peak_bytes(), "{kernels:?}, {tiling:?}: more while it ran");
                // Small buffers share blocks of 16 MiB, one of which transfers go through.
                assert!(gpu.reserved_bytes() <= foretold + (64 << 20), "{} reserved", gpu.reserved_bytes());
                assert_eq!(gpu.drain_validation(), Vec::<String>::new());
            }
            let gpu = Gpu::new(&DeviceOptions::default()).unwrap();
            let _whole = Denoiser::with_kernels(&gpu, weights, kernels, frame.size).unwrap();
            let foretold = Denoiser::footprint(&weights.architecture, kernels, frame.size).bytes;
            assert_eq!(foretold, gpu.peak_bytes(), "{kernels:?}, the whole frame");
        }
    }
}

/// `seed` on frames of a size, by the device's best kernels.
fn task<'a>(gpu: &'a Gpu, seed: &'a Architecture, size: (u32, u32)) -> Task<'a> {
    let inputs = Inputs::NormalScreenDepth;
    Task { info: gpu.info(), architecture: seed, inputs, kernels: Kernels::best(gpu.info()), size, resident: false }
}

fn limited(mib: u64) -> Demand {
    Demand { tile: None, max_bytes: Some(mib << 20) }
}

/// The number that an error names after `flag`.
fn named(message: &str, flag: &str) -> u64 {
    let at = message.rfind(flag).unwrap_or_else(|| panic!("no {flag} in: {message}")) + flag.len() + 1;
    let digits: String = message[at..].chars().take_while(char::is_ascii_digit).collect();
    digits.parse().unwrap_or_else(|_| panic!("no number after {flag} in: {message}"))
}

#[test]
fn the_largest_tiles_that_fit_are_chosen() {
    let (gpu, seed) = (gpu(), Architecture::seed());
    let task = task(&gpu, &seed, (1920, 1080));
    let whole = task.choose(&limited(1 << 20)).unwrap();
    assert_eq!(whole.tiling.count(), 1);
    let (mut last, mut seen) = (whole, 0);
    for percent in [100, 90, 50, 35, 25] {
        let most = whole.bytes * percent / 100;
        let choice = task.choose(&Demand { tile: None, max_bytes: Some(most) }).unwrap();
        assert!(choice.bytes <= most && choice.bytes > most / 2, "{choice:?} of {most}");
        assert_eq!(choice.bytes, task.footprint(&choice.tiling).bytes);
        assert!(choice.tiling.count() >= last.tiling.count(), "{choice:?} after {last:?}");
        seen += u32::from(choice.tiling.count() > last.tiling.count());
        last = choice;
    }
    assert!(seen >= 3, "one tiling for all");
    // No flag, a frame larger than the device's allocations and views allow.
    let huge = Task { size: (16_384, 16_384), ..task };
    let Choice { tiling, bytes } = huge.choose(&Demand::default()).unwrap();
    assert!(tiling.count() > 1 && bytes < gpu.info().memory_bytes);
    assert!(huge.footprint(&tiling).within_limits(gpu.info()));
    assert!(!huge.footprint(&Tiling::whole(huge.size, &task.kernels.tile_rules(&seed))).within_limits(gpu.info()));
}

#[test]
fn an_error_names_the_number_that_would_do() {
    let (gpu, seed) = (gpu(), Architecture::seed());
    let task = task(&gpu, &seed, (1000, 700));
    let message = |demand: Demand| task.choose(&demand).unwrap_err().to_string();
    // Too little for any tile.
    let least = named(&message(limited(1)), "--max-memory");
    task.choose(&limited(least)).unwrap();
    assert_eq!(named(&message(limited(least - 1)), "--max-memory"), least);
    // A tile that needs more than is allowed.
    let most = (least + 100) << 20;
    let large = Demand { tile: Some(640), max_bytes: Some(most) };
    let core = named(&message(large), "--tile") as u32;
    let choice = task.choose(&Demand { tile: Some(core), max_bytes: Some(most) }).unwrap();
    assert!(choice.bytes <= most);
    assert!(task.choose(&Demand { tile: Some(core + 32), max_bytes: Some(most) }).is_err(), "a larger one would do");
    // Not even the smallest tile fits: the memory that the one asked for needs.
    let needed = named(&message(Demand { tile: Some(64), max_bytes: Some(1 << 20) }), "--max-memory");
    task.choose(&Demand { tile: Some(64), max_bytes: Some(needed << 20) }).unwrap();
    assert!(task.choose(&Demand { tile: Some(64), max_bytes: Some((needed - 1) << 20) }).is_err());
    // Off the grid.
    for (core, parts) in [(100, "96 or 128"), (31, "e.g. 32"), (u32::MAX, "multiple of 32")] {
        let message = message(Demand { tile: Some(core), max_bytes: None });
        assert!(message.contains(parts) && message.contains(&core.to_string()), "{message}");
    }
}
