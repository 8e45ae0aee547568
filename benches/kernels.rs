//! Device time of the kernels, by timestamps: convolutions of `seed` forward and backward, a whole network, a training
//! step, the path tracer. `cargo bench` runs all, `cargo bench -- conv2d` some.

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, SamplingMode, Throughput, criterion_group, criterion_main};
use limpid::gpu::{Commands, DeviceOptions, Gpu, Recorder};
use limpid::net::architecture::Architecture;
use limpid::net::device::{DeviceTensor, Shape};
use limpid::net::kernel::{Family, conv2d};
use limpid::net::parameters::{Parameters, node_channels};
use limpid::net::plan::{Fusion, Memory, Plan};
use limpid::net::weights::Weights;
use limpid::render::{Estimator, Renderer, Sampler, Settings};
use limpid::scene::family;
use limpid::train::adam::Adam;
use limpid::train::kernel::conv2d as conv_grad;
use limpid::train::loss::Loss;
use limpid::train::step::Step;
use std::time::Duration;

/// Convolutions that cover the widths and sizes of `seed`, two pictures of 128x128.
const LAYERS: [&str; 7] =
    ["enc_conv1b", "enc_conv3", "enc_conv5", "dec_conv5a", "dec_conv3a", "dec_conv1a", "out_conv"];
const BATCH: u32 = 2;
const CROP: u32 = 128;

fn gpu() -> Gpu {
    Gpu::new(&DeviceOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

/// Criterion times what the device says it took, not the host's wait.
fn device_time(iterations: u64, mut run: impl FnMut() -> f64) -> Duration {
    Duration::from_secs_f64((0..iterations).map(|_| run()).sum::<f64>() * 1e-3)
}

fn commands(gpu: &Gpu, record: impl FnOnce(&mut Recorder) -> limpid::Result<()>) -> Commands {
    let mut rec = gpu.recorder();
    record(&mut rec).unwrap();
    rec.finish().unwrap()
}

fn bench_commands(group: &mut BenchmarkGroup<'_, WallTime>, name: &str, mut commands: Commands) {
    group.bench_function(name, |b| b.iter_custom(|n| device_time(n, || commands.run().unwrap().device_ms)));
}

fn group<'c>(c: &'c mut Criterion, name: &str) -> BenchmarkGroup<'c, WallTime> {
    let mut group = c.benchmark_group(name);
    group.sample_size(10).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    group.sampling_mode(SamplingMode::Flat);
    group
}

/// Elements of a throughput are floating-point operations, two a multiply-accumulate.
fn operations(macs: f64) -> Throughput {
    Throughput::Elements((2.0 * macs) as u64)
}

fn convolutions(c: &mut Criterion) {
    let (gpu, seed) = (gpu(), Architecture::seed());
    let family = Family::choose(gpu.info());
    let weights = Weights::glorot(&seed, 0);
    let parameters = Parameters::new(&gpu, family, &weights, true).unwrap();
    let channels = node_channels(&seed);
    for name in LAYERS {
        let id = seed.nodes().iter().position(|n| n.name == name).expect("a layer of `seed`");
        let (node, conv) = (&seed.nodes()[id], parameters.convs[id].as_ref().expect("a convolution"));
        let shape = |c| Shape { n: BATCH, h: CROP >> node.level, w: CROP >> node.level, c };
        let tensor = |name, c| DeviceTensor::new(&gpu, name, shape(c)).unwrap();
        let input = channels[node.inputs[0]];
        let (x, y) = (tensor("x", input), tensor("y", channels[id]));
        let zero = gpu.buffer("zero", u64::from(input.texels()) * 16 + 256).unwrap().all();
        let scratch = conv_grad::Scratch::new(&gpu, family, &[(conv.layer, x.shape)]).unwrap();
        let dw = gpu.buffer("dw", conv.weight.bytes()).unwrap().all();
        let pixels = f64::from(BATCH) * f64::from(x.shape.h) * f64::from(x.shape.w);
        let mut group = group(c, &format!("conv2d/{name}"));
        group.throughput(operations(pixels * 9.0 * f64::from(input.count()) * node.channels as f64));
        let forward = conv2d::Pass { x: &x, weight: &conv.packed, bias: &conv.bias, y: &y, slope: 0.1 };
        bench_commands(&mut group, "forward", commands(&gpu, |rec| conv2d::record(&gpu, rec, family, &forward)));
        let transposed = conv.packed_transposed.as_ref().expect("made for training");
        let backward = conv2d::Pass { x: &y, weight: transposed, bias: &zero, y: &x, slope: 1.0 };
        bench_commands(&mut group, "dgrad", commands(&gpu, |rec| conv2d::record(&gpu, rec, family, &backward)));
        let weight_grad = commands(&gpu, |rec| conv_grad::weight_grad(&gpu, rec, conv.layer, &scratch, &x, &y, &dw));
        bench_commands(&mut group, "wgrad", weight_grad);
    }
}

fn networks(c: &mut Criterion) {
    let (gpu, seed) = (gpu(), Architecture::seed());
    let family = Family::choose(gpu.info());
    let weights = Weights::glorot(&seed, 0);
    let mut group = group(c, "seed");
    group.throughput(operations(seed.macs_per_pixel() * 256.0 * 256.0));
    let parameters = Parameters::new(&gpu, family, &weights, false).unwrap();
    for (name, fusion) in [("plain", Fusion::Activation), ("fastest", Fusion::best(family))] {
        let plan = Plan::new(&gpu, &seed, family, (1, 256, 256), Memory::Shared, fusion).unwrap();
        bench_commands(
            &mut group,
            &format!("forward 256x256 {name}"),
            commands(&gpu, |rec| plan.record(rec, &parameters)),
        );
    }
    // Forward, input gradient and weight gradient cost the same.
    group.throughput(operations(3.0 * seed.macs_per_pixel() * f64::from(BATCH * CROP * CROP)));
    let adam = Adam::default();
    let mut step = Step::new(&gpu, family, &weights, (BATCH, CROP, CROP), adam, Loss::Mae).unwrap();
    group.bench_function("training step 2x128x128", |b| {
        b.iter_custom(|n| device_time(n, || step.run(adam.learning_rate).unwrap().1.device_ms));
    });
}

fn path_tracing(c: &mut Criterion) {
    let gpu = gpu();
    let mut scene = family::canonical();
    (scene.camera.width, scene.camera.height) = (256, 256);
    let mut group = group(c, "path_trace 256x256 16 spp");
    for (estimator, sampler) in [(Estimator::Cosine, Sampler::Pcg), (Estimator::Nee, Sampler::Sobol)] {
        let settings = Settings { estimator, sampler, ..Settings::default() };
        let mut renderer = Renderer::new(&gpu, &scene, &settings).unwrap();
        renderer.finish().unwrap();
        // Elements of the throughput are rays.
        group.throughput(Throughput::Elements(renderer.stats().unwrap().rays));
        group.bench_function(format!("{estimator} {sampler}"), |b| {
            b.iter_custom(|n| {
                device_time(n, || {
                    renderer.restart();
                    renderer.finish().unwrap();
                    renderer.stats().unwrap().device_ms
                })
            });
        });
    }
}

criterion_group!(benches, convolutions, networks, path_tracing);
criterion_main!(benches);
