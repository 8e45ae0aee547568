//! Whole networks on the device: against PyTorch, with every choice of kernels and memory, and with tensors larger than a
//! storage binding.

mod common;

use common::compare::{l2_close, require, same_bits};
use common::networks::{cut, deep, forward, small_base, small_kpn, tiny, weights, wide};
use common::precision::{families, network_limit};
use common::{goldens, gpu};
use limpid::net::architecture::Architecture;
use limpid::net::base::Widths;
use limpid::net::kernel::Family;
use limpid::net::plan::{Fusion, Memory, Plan};
use limpid::net::reference;
use limpid::net::tensor::Tensor;

/// The ways to make a plan that all families have, the plainest first; they agree bit for bit.
const PLANS: [(Memory, Fusion); 4] = [
    (Memory::Kept, Fusion::Layers),
    (Memory::Kept, Fusion::Activation),
    (Memory::Shared, Fusion::Layers),
    (Memory::Shared, Fusion::Activation),
];

/// Plans that add in other orders, for the families that have them: those of a group agree bit for bit.
fn winograd(family: Family) -> &'static [&'static [(Memory, Fusion)]] {
    match family {
        Family::Cpu { .. } => &[
            &[(Memory::Kept, Fusion::Winograd)],
            &[(Memory::Kept, Fusion::InPlace), (Memory::Shared, Fusion::InPlace)],
        ],
        _ => &[],
    }
}

fn input(architecture: &Architecture, size: [usize; 3], name: &str) -> Tensor<f32> {
    goldens::network_input(architecture, size, name)
}

/// Every family and plan against PyTorch's float64 output. The plain plans make the same sums in the same order, and where a
/// value lies or which kernel applies the slope rounds nothing: they agree bit for bit. So do the plans of a group of Winograd's.
fn matches_pytorch(architecture: &Architecture, size: [usize; 3]) {
    let (gpu, goldens) = (gpu(), goldens::read("networks"));
    let case = goldens::network_case(architecture, size);
    let (weights, input) = (weights(architecture), input(architecture, size, &format!("{case}/input")));
    let expected = &goldens[&format!("{case}/output")];
    for family in families(gpu.info()) {
        let outputs = PLANS.map(|plan| forward(&gpu, &weights, family, plan, &input));
        let what = format!("{case}, {}", family.name());
        require(&what, l2_close(&outputs[0].data, expected, network_limit(family)));
        for (plan, output) in PLANS.iter().zip(&outputs).skip(1) {
            require(&format!("{what}, {plan:?}"), same_bits(&output.data, &outputs[0].data));
        }
        for plans in winograd(family) {
            let fast: Vec<_> = plans.iter().map(|plan| forward(&gpu, &weights, family, *plan, &input)).collect();
            for output in &fast {
                require(&format!("{what}, {plans:?}"), l2_close(&output.data, expected, 1e-5));
                require(&format!("{what}, {plans:?}"), same_bits(&output.data, &fast[0].data));
                assert_ne!(output.data, outputs[0].data, "{what}: another plan adds in another order");
            }
        }
    }
}

#[test]
fn seed_matches_pytorch() {
    matches_pytorch(&Architecture::seed(), [1, 32, 32]);
}

#[test]
fn seed_matches_pytorch_on_a_batch_of_another_shape() {
    matches_pytorch(&Architecture::seed(), [2, 64, 32]);
}

#[test]
fn base_matches_pytorch() {
    matches_pytorch(&small_base(), [1, 32, 32]);
}

#[test]
fn base_matches_pytorch_on_a_batch_of_another_shape() {
    matches_pytorch(&small_base(), [2, 48, 16]);
}

#[test]
fn kpn_matches_pytorch() {
    matches_pytorch(&small_kpn(), [1, 32, 32]);
}

#[test]
fn kpn_matches_pytorch_on_a_batch_of_another_shape() {
    matches_pytorch(&small_kpn(), [2, 48, 16]);
}

/// The widths that limpid trains and those of Open Image Denoise, with every choice of kernels, against the f64 reference.
#[test]
fn base_and_kpn_of_full_width_match_the_reference() {
    let gpu = gpu();
    let widths = [Widths::default(), Widths::open_image_denoise()];
    for architecture in widths.iter().flat_map(|w| [Architecture::base(w).unwrap(), Architecture::kpn(w).unwrap()]) {
        let (weights, input) = (weights(&architecture), input(&architecture, [1, 48, 32], "full width"));
        let expected = reference::forward(&architecture, &weights.to_f64(), &input.to_f64()).pop().unwrap();
        for family in families(gpu.info()) {
            for plan in PLANS.iter().chain(&winograd(family).concat()) {
                let output = forward(&gpu, &weights, family, *plan, &input);
                let what = format!("{}, {plan:?}", family.name());
                require(&what, l2_close(&output.data, &expected.data, network_limit(family)));
            }
        }
    }
}

/// Channel counts, widths and heights that fill no texel, tile or workgroup.
#[test]
fn odd_sizes_match_the_reference() {
    let (gpu, architecture) = (gpu(), tiny());
    let weights = weights(&architecture);
    for size in [[1, 2, 2], [3, 2, 34], [1, 26, 14], [2, 70, 10]] {
        let input = input(&architecture, size, "odd");
        let expected = reference::forward(&architecture, &weights.to_f64(), &input.to_f64()).pop().unwrap();
        for family in families(gpu.info()) {
            let outputs = PLANS.map(|plan| forward(&gpu, &weights, family, plan, &input));
            for (plan, output) in PLANS.iter().zip(&outputs) {
                let what = format!("{size:?}, {}, {plan:?}", family.name());
                require(&what, l2_close(&output.data, &expected.data, network_limit(family)));
                require(&what, same_bits(&output.data, &outputs[0].data));
            }
        }
    }
}

#[test]
fn sizes_off_the_grid_are_refused() {
    let (gpu, seed) = (gpu(), Architecture::seed());
    for size in [(1, 32, 33), (1, 48, 32), (1, 1, 1), (1, 0, 32), (1, 32, 0), (0, 32, 32)] {
        for (memory, fusion) in PLANS {
            let error = Plan::new(&gpu, &seed, Family::Portable, size, memory, fusion)
                .err()
                .map(|e| e.to_string())
                .unwrap_or_default();
            let named = error.contains(&format!("{}x{}", size.2, size.1)) && error.contains("multiples of 32");
            assert!(named, "{size:?}: {error}");
        }
    }
}

/// A network of 60 channels at 800x736: tensors of 135 MiB. Every kernel that writes them must cut its work into storage
/// bindings of at most 128 MiB. Strips over the full height, so that no cut between rows is missed, against the
/// reference; and the picture's left and right ends.
fn large_tensors(architecture: &Architecture, plans: impl Fn(Family) -> Vec<(Memory, Fusion)>) {
    let gpu = gpu();
    let (height, width) = (800, 736);
    let weights = weights(architecture);
    let input = input(architecture, [1, height, width], "wide");
    let bytes = (60 * height * width * 4) as u64;
    if gpu.info().is_cpu {
        assert!(bytes > gpu.info().max_storage_range, "{bytes} bytes fit a binding: the test shows nothing");
    }
    // A strip's margin: three convolutions, the outer one's taps widened to whole windows of the pooling.
    const MARGIN: usize = 6;
    let strips = [(0, 24), (360, 24), (width - 24, 24)].map(|(x, columns): (usize, usize)| {
        let (from, to) = (x.saturating_sub(MARGIN), (x + columns + MARGIN).min(width));
        let part = cut(&input, [0, from, height, to - from]).to_f64();
        let output = reference::forward(architecture, &weights.to_f64(), &part).pop().unwrap();
        (x, cut(&output, [0, x - from, height, columns]))
    });
    for family in families(gpu.info()) {
        for plan in plans(family) {
            let output = forward(&gpu, &weights, family, plan, &input);
            for (x, expected) in &strips {
                for y in (0..height).step_by(8) {
                    // Eight rows at a time, so that a single wrong one stands out.
                    let (part, expected) = (cut(&output, [y, *x, 8, 24]), cut(expected, [y, 0, 8, 24]));
                    let what = format!("{}, {plan:?}, rows from {y}, columns from {x}", family.name());
                    require(&what, l2_close(&part.data, &expected.data, network_limit(family)));
                }
            }
        }
    }
}

#[test]
fn tensors_larger_than_a_storage_binding() {
    large_tensors(&wide(), |_| vec![(Memory::Shared, Fusion::Layers), (Memory::Shared, Fusion::Activation)]);
}

/// Wide layers on the portable kernels alone would take minutes on a CPU driver; theirs are above.
#[test]
fn winograd_writes_tensors_larger_than_a_storage_binding() {
    large_tensors(&deep(), |family| winograd(family).concat().into_iter().filter(|p| p.0 == Memory::Shared).collect());
}

/// `seed` on a whole frame of 768x768, whose largest tensors are cut in three, against a tile of it that fits without a
/// cut. With the overlap that the architecture states, a tile's core has the frame's bits.
#[test]
fn a_whole_frame_equals_a_tile_of_it() {
    let (gpu, seed) = (gpu(), Architecture::seed());
    let (weights, family) = (weights(&seed), Family::choose(gpu.info()));
    let frame = input(&seed, [1, 768, 768], "frame");
    let plan = (Memory::Shared, Fusion::Activation);
    let whole = forward(&gpu, &weights, family, plan, &frame);
    // The core begins above the first cut (row 341 of the 128 channels at full size) and reaches the frame's end.
    let overlap = seed.tile_overlap();
    let (y, x, columns) = (320, 352, 32);
    let tile = cut(&frame, [y - overlap, x - overlap, 768 - y + overlap, columns + 2 * overlap]);
    let tile = forward(&gpu, &weights, family, plan, &tile);
    let core = cut(&tile, [overlap, overlap, 768 - y, columns]);
    require("core", same_bits(&core.data, &cut(&whole, [y, x, 768 - y, columns]).data));
}
