//! What training shows `base`: crops whose normals are those of a mirrored scene, inputs and targets in one space.

mod common;

use common::gpu;
use limpid::denoise::{Axes, Preparation};
use limpid::net::device::{Channels, DeviceTensor, Shape};
use limpid::scene::family;
use limpid::train::data::{Data, DataSettings, Part, Scenes};

const BATCH: u32 = 8;
const CROP: u32 = 32;

/// A world-space normal after a crop's orientation, from the definition: mirrored in the camera's right, then in its up, then
/// in the diagonal between right and down.
fn turned(n: [f64; 3], axes: &Axes, orientation: u32) -> [f64; 3] {
    let (right, up) = (axes.right.map(f64::from), axes.up.map(f64::from));
    let mirrored = |n: [f64; 3], axis: [f64; 3]| {
        let along: f64 = n.iter().zip(axis).map(|(n, a)| n * a).sum();
        std::array::from_fn(|i| n[i] - 2.0 * along * axis[i])
    };
    let diagonal = std::array::from_fn(|i| (right[i] + up[i]) / 2f64.sqrt());
    let steps = [(1, right), (2, up), (4, diagonal)];
    steps.into_iter().filter(|(bit, _)| orientation & bit != 0).fold(n, |n, (_, axis)| mirrored(n, axis))
}

/// The walls of the box are across the world's axes, the camera is not: so the normals of a crop tell how it was turned, and
/// by which axes.
#[test]
fn normals_of_crops_are_turned_by_the_scene_s_camera() {
    let gpu = gpu();
    let settings = DataSettings {
        seed: 3,
        batch: BATCH,
        crop: CROP,
        window: 48,
        pool: 1,
        initial: 1,
        refresh: 1000,
        spp: 2,
        reference_spp: 2,
        larger_crops: vec![],
        scenes: Scenes::Spheres,
    };
    let axes = Axes::of(&family::spheres(Data::scene_of(&settings, Part::Training, 0)).camera);
    let mut data = Data::new(&gpu, &settings, Preparation::OPEN_IMAGE_DENOISE, 16, Part::Training).unwrap();
    data.prepare(0, |_, _| {}).unwrap();
    let (input, target) = tensors(&gpu);
    let walls: Vec<[f64; 3]> = (0..3)
        .flat_map(|axis| [1.0, -1.0].map(|sign| std::array::from_fn(|i| if i == axis { sign } else { 0.0 })))
        .collect();
    let mut seen = [0; 8];
    for step in 0..6 {
        data.load(step, &input, &target).unwrap();
        let values = input.download(&gpu).unwrap();
        let plane = (CROP * CROP) as usize;
        for crop in values.chunks(9 * plane) {
            let normal =
                |at: usize| -> [f64; 3] { std::array::from_fn(|c| 2.0 * f64::from(crop[(6 + c) * plane + at]) - 1.0) };
            let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
            // How many pixels show a wall, for each orientation that the crop may have.
            let count = |orientation: u32| {
                let walls: Vec<_> = walls.iter().map(|n| turned(*n, &axes, orientation)).collect();
                (0..plane).filter(|at| walls.iter().any(|wall| near(normal(*at), *wall))).count()
            };
            let counts: Vec<usize> = (0..8).map(count).collect();
            let best = (0..8).max_by_key(|o| counts[*o]).unwrap();
            assert!(counts[best] > plane / 4, "no orientation fits the walls of a crop: {counts:?}");
            seen[best] += 1;
        }
    }
    // 48 crops in 8 orientations: the chance that fewer than 5 turn up is below 1e-9.
    assert!(seen.iter().filter(|n| **n > 0).count() >= 5, "{seen:?}");
}

fn tensors(gpu: &limpid::gpu::Gpu) -> (DeviceTensor, DeviceTensor) {
    let shape = |channels| Shape { n: BATCH, h: CROP, w: CROP, c: Channels::new(channels) };
    (DeviceTensor::new(gpu, "input", shape(9)).unwrap(), DeviceTensor::new(gpu, "target", shape(3)).unwrap())
}

/// Light sources are exact, in the noisy picture as in the reference: there, input and target must be equal, whatever the
/// inputs and the transfer.
#[test]
fn inputs_and_targets_share_their_space() {
    let gpu = gpu();
    let settings = DataSettings {
        seed: 1,
        batch: BATCH,
        crop: CROP,
        window: 32,
        pool: 6,
        initial: 6,
        refresh: 1000,
        spp: 1,
        reference_spp: 2,
        larger_crops: vec![],
        scenes: Scenes::Spheres,
    };
    let mut data = Data::new(&gpu, &settings, Preparation::OPEN_IMAGE_DENOISE, 16, Part::Training).unwrap();
    data.prepare(0, |_, _| {}).unwrap();
    let (input, target) = tensors(&gpu);
    let plane = (CROP * CROP) as usize;
    let mut lights = 0;
    for step in 0..4 {
        data.load(step, &input, &target).unwrap();
        let (inputs, targets) = (input.download(&gpu).unwrap(), target.download(&gpu).unwrap());
        for (input, target) in inputs.chunks(9 * plane).zip(targets.chunks(3 * plane)) {
            // A light reflects nothing, and is no miss, whose radiance is 0.
            let black = |at: usize| (3..6).all(|c| input[c * plane + at] == 0.0);
            for at in (0..plane).filter(|at| black(*at) && target[*at] > 0.0) {
                lights += 1;
                (0..3)
                    .for_each(|c| assert_eq!(input[c * plane + at], target[c * plane + at], "pixel {at}, channel {c}"));
            }
        }
    }
    assert!(lights > 20, "{lights} pixels of lights show nothing");
}
