//! One training step on the device: forward, loss, backward, Adam, packing of the new weights; one command list.

use super::adam::Adam;
use super::backward::Backward;
use super::loss::Loss;
use super::loss_scale::{self, LossScale};
use crate::Result;
use crate::gpu::{Buffer, Commands, Gpu, Recorder, Timings};
use crate::net::architecture::Architecture;
use crate::net::device::{Channels, DeviceTensor, Shape, folded, groups};
use crate::net::kernel::Family;
use crate::net::parameters::Parameters;
use crate::net::plan::{Fusion, Memory, Plan};
use crate::net::weights::Weights;
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `l1_loss.comp`.
    pub struct LossPush for shaders::l1_loss { batch: u32, height: u32, width: u32, scale: f32 }
}
push_block! {
    /// Push constants of `adam.comp`.
    pub struct AdamPush for shaders::adam { count: u32, beta1: f32, beta2: f32, epsilon: f32 }
}

/// Side of the square of pixels of a workgroup of `l1_loss.comp`.
const LOSS_TILE: u32 = 16;

/// What Adam keeps from step to step.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Steps done.
    pub step: u64,
    /// Mean of the gradient, for each parameter.
    pub mean: Vec<f32>,
    /// Mean of its square, for each parameter.
    pub mean_square: Vec<f32>,
    /// The loss scale of the next step; none for kernels without f16.
    pub loss_scale: Option<loss_scale::State>,
}

/// Crops a step, their height and width.
pub type Size = (u32, u32, u32);

/// The tensors and commands of one size.
struct Pass {
    plan: Plan,
    backward: Backward,
    target: DeviceTensor,
    /// Parts of the loss, as many as this size has.
    loss: Buffer,
    commands: Commands,
    /// Forward pass and loss alone.
    forward: Commands,
}

/// A network in training at one batch size or at several.
pub struct Step {
    gpu: Gpu,
    /// The network's parameters.
    pub parameters: Parameters,
    passes: Vec<Pass>,
    /// The pass that was run last.
    last: usize,
    mean: Buffer,
    mean_square: Buffer,
    factors: Buffer,
    /// Factors of the learning rate, by parameter.
    scales: Buffer,
    adam: Adam,
    minimised: Loss,
    /// For kernels with f16.
    loss_scale: Option<LossScale>,
    /// Not 0 where Adam skips the step.
    skip: Buffer,
    steps_done: u64,
}

impl Step {
    /// Tensors and commands for batches of one size.
    pub fn new(gpu: &Gpu, family: Family, weights: &Weights, size: Size, adam: Adam, loss: Loss) -> Result<Self> {
        Self::with_sizes(gpu, family, weights, &[size], adam, loss)
    }

    /// Tensors and commands for batches of several sizes, which train the same parameters.
    pub fn with_sizes(
        gpu: &Gpu,
        family: Family,
        weights: &Weights,
        sizes: &[Size],
        adam: Adam,
        loss: Loss,
    ) -> Result<Self> {
        let parameters = Parameters::new(gpu, family, weights, true)?;
        let like_parameters = |name| gpu.buffer(name, parameters.flat.bytes());
        let (mean, mean_square) = (like_parameters("Adam mean")?, like_parameters("Adam mean square")?);
        let factors = gpu.buffer("Adam factors", 8)?;
        let scales = like_parameters("learning rate scales")?;
        gpu.upload(&scales.all(), &parameters.pad(&weights.architecture.parameter_scales()))?;
        let loss_scale = match family {
            Family::Portable | Family::Cpu { .. } => None,
            Family::Coop(_) => Some(LossScale::new(gpu)?),
        };
        let skip = match &loss_scale {
            Some(scale) => scale.skip.clone(),
            None => gpu.buffer("skip", 4)?,
        };
        let gpu = gpu.clone();
        let mut this = Self {
            gpu,
            parameters,
            passes: Vec::new(),
            last: 0,
            mean,
            mean_square,
            factors,
            scales,
            adam,
            minimised: loss,
            loss_scale,
            skip,
            steps_done: 0,
        };
        for size in sizes {
            let pass = this.pass(&weights.architecture, family, *size)?;
            this.passes.push(pass);
        }
        Ok(this)
    }

    fn pass(&self, architecture: &Architecture, family: Family, size: Size) -> Result<Pass> {
        let gpu = &self.gpu;
        let plan = Plan::new(gpu, architecture, family, size, Memory::Kept, Fusion::training(family))?;
        let backward = Backward::new(gpu, &self.parameters, &plan)?;
        let target = DeviceTensor::new(gpu, "target", plan.output().shape.with_channels(Channels::new(3)))?;
        let loss = gpu.buffer("loss", loss_tiles(target.shape) * 4)?;
        let mut rec = gpu.recorder();
        plan.record(&mut rec, &self.parameters)?;
        record_loss(gpu, &mut rec, self.minimised, [plan.output(), &target, backward.output_gradient()], &loss)?;
        let forward = rec.finish()?;
        let mut pass = Pass { plan, backward, target, loss, commands: gpu.recorder().finish()?, forward };
        let mut rec = gpu.recorder();
        self.record_pass(&mut rec, &pass)?;
        pass.commands = rec.finish()?;
        Ok(pass)
    }

    /// Records one whole step of the first size.
    pub fn record(&self, rec: &mut Recorder) -> Result<()> {
        self.record_pass(rec, &self.passes[0])
    }

    fn record_pass(&self, rec: &mut Recorder, pass: &Pass) -> Result<()> {
        let Pass { plan, backward, target, loss, .. } = pass;
        let (gpu, parameters) = (&self.gpu, &self.parameters);
        plan.record(rec, parameters)?;
        record_loss(gpu, rec, self.minimised, [plan.output(), target, backward.output_gradient()], loss)?;
        if let Some(scale) = &self.loss_scale {
            scale.scale(rec, backward.output_gradient())?;
        }
        backward.record(rec, parameters, plan)?;
        if let Some(scale) = &self.loss_scale {
            scale.unscale(rec, &backward.flat)?;
        }
        self.record_adam(rec, &backward.flat)?;
        if let Some(scale) = &self.loss_scale {
            scale.update(rec)?;
        }
        parameters.record_pack(rec)
    }

    fn record_adam(&self, rec: &mut Recorder, gradient: &Buffer) -> Result<()> {
        let (gpu, parameters) = (&self.gpu, &self.parameters);
        let kernel = gpu.kernel::<shaders::adam::Shader>(&Default::default())?;
        let count = (parameters.padded_len() / 4) as u32;
        let adam = self.adam;
        let push = AdamPush { count, beta1: adam.beta1 as f32, beta2: adam.beta2 as f32, epsilon: adam.epsilon as f32 };
        let bind = shaders::adam::Bind {
            gradient: gradient.all(),
            step_factors: self.factors.all(),
            parameter: parameters.flat.all(),
            first_moment: self.mean.all(),
            second_moment: self.mean_square.all(),
            skip: self.skip.all(),
            scale: self.scales.all(),
        };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(count)));
        Ok(())
    }

    /// The forward pass of the first size, whose values are all kept.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.passes[0].plan
    }

    /// Where the network inputs of a batch of the first size go.
    #[must_use]
    pub fn input(&self) -> &DeviceTensor {
        self.input_of(0)
    }

    /// Where the targets of a batch of the first size go, in the space of the network's output.
    #[must_use]
    pub fn target(&self) -> &DeviceTensor {
        self.target_of(0)
    }

    /// Where the network inputs of a batch of size `i` go.
    #[must_use]
    pub fn input_of(&self, i: usize) -> &DeviceTensor {
        self.passes[i].plan.input()
    }

    /// Where the targets of a batch of size `i` go.
    #[must_use]
    pub fn target_of(&self, i: usize) -> &DeviceTensor {
        &self.passes[i].target
    }

    /// The recorded operations of the first size, for the hazard checker.
    #[must_use]
    pub fn commands(&self) -> &Commands {
        &self.passes[0].commands
    }

    /// Steps done, over all runs.
    #[must_use]
    pub fn steps_done(&self) -> u64 {
        self.steps_done
    }

    /// Takes one step at a learning rate with a batch of the first size; gives the loss before it.
    pub fn run(&mut self, learning_rate: f64) -> Result<(f64, Timings)> {
        self.run_size(0, learning_rate)
    }

    /// The same with a batch of size `i`.
    pub fn run_size(&mut self, i: usize, learning_rate: f64) -> Result<(f64, Timings)> {
        let (c1, c2) = self.adam.corrections(self.steps_done + 1);
        self.gpu.upload(&self.factors.all(), &[(learning_rate / c1) as f32, (1.0 / c2.sqrt()) as f32])?;
        let timings = self.passes[i].commands.run()?;
        self.last = i;
        self.steps_done += 1;
        let crops = self.passes[i].target.shape.n;
        Ok((self.loss_of(i, crops)?, timings))
    }

    /// The loss that the last pass of size `i` left, of its first `crops` crops.
    fn loss_of(&self, i: usize, crops: u32) -> Result<f64> {
        let Pass { loss, target, .. } = &self.passes[i];
        let shape = Shape { n: crops, ..target.shape };
        let parts: Vec<f32> = self.gpu.download(&loss.slice(0, loss_tiles(shape) * 4))?;
        let terms = 3.0 * f64::from(self.minimised.scales()) * shape.texels() as f64;
        Ok(parts.iter().map(|p| f64::from(*p)).sum::<f64>() / terms)
    }

    /// Computes the network's output for a batch of the first size, and the loss of its first `crops` crops; parameters and
    /// moments stay.
    pub fn forward(&mut self, crops: u32) -> Result<(f64, Timings)> {
        let timings = self.passes[0].forward.run()?;
        Ok((self.loss_of(0, crops)?, timings))
    }

    /// The gradient of the last step, in the order of the flat parameter vector.
    pub fn gradient(&self) -> Result<Vec<f32>> {
        Ok(self.parameters.unpad(&self.gpu.download::<f32>(&self.passes[self.last].backward.flat.all())?))
    }

    /// What Adam keeps.
    pub fn moments(&self) -> Result<Moments> {
        let read = |b: &Buffer| -> Result<Vec<f32>> { Ok(self.parameters.unpad(&self.gpu.download::<f32>(&b.all())?)) };
        let loss_scale = self.loss_scale.as_ref().map(LossScale::get).transpose()?;
        Ok(Moments {
            step: self.steps_done,
            mean: read(&self.mean)?,
            mean_square: read(&self.mean_square)?,
            loss_scale,
        })
    }

    /// Continues from saved moments; the parameters are set apart.
    pub fn set_moments(&mut self, moments: &Moments) -> Result<()> {
        self.gpu.upload(&self.mean.all(), &self.parameters.pad(&moments.mean))?;
        self.gpu.upload(&self.mean_square.all(), &self.parameters.pad(&moments.mean_square))?;
        if let Some(scale) = &self.loss_scale {
            scale.set(moments.loss_scale.unwrap_or_default())?;
        }
        self.steps_done = moments.step;
        Ok(())
    }

    /// The weights as they are now.
    pub fn weights(&self, architecture: &Architecture) -> Result<Weights> {
        let metadata = std::collections::BTreeMap::new();
        Ok(Weights { architecture: architecture.clone(), parameters: self.parameters.get()?, metadata })
    }
}

/// Workgroups of `l1_loss.comp`, which compute a part of the loss each.
fn loss_tiles(shape: Shape) -> u64 {
    [shape.h.div_ceil(LOSS_TILE), shape.w.div_ceil(LOSS_TILE)].map(u64::from).iter().product::<u64>()
        * u64::from(shape.n)
}

/// Records the loss of 3 channels, in parts, and its gradient.
pub fn record_loss(
    gpu: &Gpu,
    rec: &mut Recorder,
    loss: Loss,
    [output, target, gradient]: [&DeviceTensor; 3],
    parts: &Buffer,
) -> Result<()> {
    assert_eq!((output.shape, output.shape), (target.shape, gradient.shape));
    let Shape { n: batch, h: height, w: width, .. } = output.shape;
    let kernel = gpu.kernel::<shaders::l1_loss::Shader>(&shaders::l1_loss::Spec { scales: loss.scales() })?;
    let bind = shaders::l1_loss::Bind {
        prediction: output.slice.clone(),
        target: target.slice.clone(),
        gradient: gradient.slice.clone(),
        partial: parts.all(),
    };
    let scale = 1.0 / (3.0 * loss.scales() as f32 * output.shape.texels() as f32);
    rec.dispatch(&kernel, &bind, &LossPush { batch, height, width, scale }, folded(loss_tiles(output.shape)));
    Ok(())
}
