//! Device times of a network: layer by layer, whole, and of a training step.
//!
//! Operations are those of the direct convolution, two a multiply-accumulate, whatever the kernels save of them. Bytes are
//! what has to be moved at least: what a layer reads and writes, once.

use super::{Times, WarmUp, repeat};
use crate::Result;
use crate::gpu::{Gpu, Recorder};
use crate::net::architecture::{Architecture, Op};
use crate::net::kernel::Family;
use crate::net::parameters::Parameters;
use crate::net::plan::{Fusion, Memory, Plan};
use crate::net::tensor::{Tensor, seed_of};
use crate::net::weights::Weights;
use crate::train::adam::Adam;
use crate::train::preset::Preset;
use crate::train::step::Step;
use serde::Serialize;
use std::collections::BTreeMap;

/// A part of a network, or the whole.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Of the node, of the shader, or what the whole is.
    pub name: String,
    /// The kernels that ran, in order, repeats left out.
    pub kernels: Vec<&'static str>,
    /// Milliseconds on the device.
    pub ms: Times,
    /// Operations of the direct convolution; 0 where there is none.
    pub operations: f64,
    /// Bytes read and written at least.
    pub bytes: f64,
}

impl Row {
    /// Operations a second, in thousand millions, at the median.
    #[must_use]
    pub fn gflops(&self) -> f64 {
        self.operations / self.ms.median * 1e-6
    }
}

/// What the network reads: uniform in [-1, 1), (1, channels, height, width).
fn input(architecture: &Architecture, (h, w): (u32, u32)) -> Tensor {
    Tensor::uniform([1, architecture.input_channels(), h as usize, w as usize], seed_of("bench"))
}

/// A network on random input, at one size.
struct Network {
    architecture: Architecture,
    plan: Plan,
    parameters: Parameters,
}

impl Network {
    fn new(gpu: &Gpu, family: Family, weights: &Weights, (h, w): (u32, u32), fusion: Fusion) -> Result<Self> {
        let architecture = &weights.architecture;
        let parameters = Parameters::new(gpu, family, weights, false)?;
        let plan = Plan::new(gpu, architecture, family, (1, h, w), Memory::Shared, fusion)?;
        plan.input().upload(gpu, &input(architecture, (h, w)).data)?;
        Ok(Self { architecture: architecture.clone(), plan, parameters })
    }

    /// Operations and least bytes of a node.
    fn cost(&self, id: usize) -> (f64, f64) {
        let node = &self.architecture.nodes()[id];
        let shape = self.plan.values[id].shape;
        let pixels = f64::from(shape.n) * f64::from(shape.h) * f64::from(shape.w);
        let operations = match node.op {
            Op::Conv { cin, cout, .. } => 18.0 * cin as f64 * cout as f64 * pixels,
            _ => 0.0,
        };
        let read: u64 =
            self.plan.reads(&self.architecture, id).iter().map(|r| self.plan.values[*r].shape.bytes()).sum();
        let weights = node.parameters.as_ref().map_or(0, |p| p.weight.len() * 4);
        (operations, (read + shape.bytes()) as f64 + weights as f64)
    }
}

/// What a network read and made of it, NCHW.
pub struct Values {
    /// Its input.
    pub input: Tensor,
    /// Its output.
    pub output: Tensor,
}

/// What is timed, with which kernels, and how often after the first run.
pub struct Bench<'a> {
    /// The device.
    pub gpu: &'a Gpu,
    /// The kernels.
    pub family: Family,
    /// The network.
    pub weights: &'a Weights,
    /// Runs.
    pub runs: u32,
}

impl Bench<'_> {
    /// Every node that a plan computes, for a picture of `size` (height, width).
    pub fn layers(&self, size: (u32, u32), fusion: Fusion) -> Result<(Vec<Row>, WarmUp)> {
        let architecture = &self.weights.architecture;
        let network = Network::new(self.gpu, self.family, self.weights, size, fusion)?;
        let mut rec = self.gpu.recorder();
        rec.time_each();
        let mut ends = Vec::new();
        for id in 0..architecture.nodes().len() {
            network.plan.record_node(&mut rec, &network.parameters, id)?;
            ends.push(rec.len());
        }
        let mut commands = rec.finish()?;
        let warm_up = commands.run()?.wall_ms;
        let samples: Vec<_> = (0..self.runs).map(|_| Ok(commands.run()?.operations)).collect::<Result<_>>()?;
        let mut rows = Vec::new();
        let mut begin = 0;
        for (id, end) in ends.into_iter().enumerate() {
            let range = std::mem::replace(&mut begin, end)..end;
            if range.is_empty() {
                continue;
            }
            let mut kernels: Vec<&'static str> = Vec::new();
            for (name, _) in &samples[0][range.clone()] {
                if !kernels.contains(name) {
                    kernels.push(name);
                }
            }
            let ms = samples.iter().map(|s| s[range.clone()].iter().map(|(_, ms)| ms).sum()).collect();
            let (operations, bytes) = network.cost(id);
            let name = architecture.nodes()[id].name.clone();
            rows.push(Row { name, kernels, ms: Times::of(ms), operations, bytes });
        }
        Ok((rows, warm_up))
    }

    /// The whole network in one command list.
    pub fn net(&self, size: (u32, u32), fusion: Fusion) -> Result<(Row, WarmUp, Values)> {
        let gpu = self.gpu;
        let architecture = &self.weights.architecture;
        let network = Network::new(gpu, self.family, self.weights, size, fusion)?;
        let mut rec = gpu.recorder();
        network.plan.record(&mut rec, &network.parameters)?;
        let mut commands = rec.finish()?;
        let (ms, warm_up) = repeat(&mut commands, self.runs)?;
        // The runs before may have written over the input.
        let input = input(architecture, size);
        network.plan.input().upload(gpu, &input.data)?;
        commands.run()?;
        let shape = [1, architecture.output_channels(), size.0 as usize, size.1 as usize];
        let output = Tensor::new(shape, network.plan.output().download(gpu)?);
        let costs = (0..architecture.nodes().len()).filter(|id| network.plan.computes(*id)).map(|id| network.cost(id));
        let (operations, bytes) = costs.fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        let row = Row { name: "network".to_owned(), kernels: Vec::new(), ms, operations, bytes };
        Ok((row, warm_up, Values { input, output }))
    }

    /// A training step of `batch` crops: the whole, then every kernel with its share. Forward, input gradient and weight gradient
    /// count as much as each other.
    pub fn train(&self, (batch, crop): (u32, u32)) -> Result<(Vec<Row>, WarmUp)> {
        let gpu = self.gpu;
        let architecture = &self.weights.architecture;
        let mut step =
            Step::new(gpu, self.family, self.weights, (batch, crop, crop), Adam::default(), Preset::Fresh.loss())?;
        let side = crop as usize;
        let random =
            |channels: usize, name: &str| Tensor::uniform([batch as usize, channels, side, side], seed_of(name)).data;
        step.input().upload(gpu, &random(architecture.input_channels(), "input"))?;
        step.target().upload(gpu, &random(architecture.output_channels(), "target"))?;
        let start = std::time::Instant::now();
        step.run(0.0)?;
        let warm_up = start.elapsed().as_secs_f64() * 1e3;
        let ms = (0..self.runs).map(|_| Ok(step.run(0.0)?.1.device_ms)).collect::<Result<_>>()?;
        let operations = 6.0 * architecture.macs_per_pixel() * f64::from(batch) * f64::from(crop) * f64::from(crop);
        let mut rows = vec![Row {
            name: "training step".to_owned(),
            kernels: Vec::new(),
            ms: Times::of(ms),
            operations,
            bytes: 0.0,
        }];
        rows.extend(by_kernel(gpu, |rec| step.record(rec), self.runs)?);
        Ok((rows, warm_up))
    }
}

/// What `record` adds, summed by shader, the longest first.
fn by_kernel(gpu: &Gpu, record: impl FnOnce(&mut Recorder) -> Result<()>, runs: u32) -> Result<Vec<Row>> {
    let mut rec = gpu.recorder();
    rec.time_each();
    record(&mut rec)?;
    let mut commands = rec.finish()?;
    commands.run()?;
    let mut samples: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
    for run in 0..runs as usize {
        for (name, ms) in commands.run()?.operations {
            let all = samples.entry(name).or_insert_with(|| vec![0.0; runs as usize]);
            all[run] += ms;
        }
    }
    let row = |(name, ms): (&'static str, Vec<f64>)| Row {
        name: name.to_owned(),
        kernels: vec![name],
        ms: Times::of(ms),
        operations: 0.0,
        bytes: 0.0,
    };
    let mut rows: Vec<_> = samples.into_iter().map(row).collect();
    rows.sort_by(|a, b| b.ms.median.total_cmp(&a.ms.median));
    Ok(rows)
}
