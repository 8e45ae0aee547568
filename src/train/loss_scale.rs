//! The dynamic loss scale of mixed precision (Micikevicius et al., "Mixed Precision Training", 2018), kept on the device.
//!
//! The gradient of the loss is multiplied by it, so that gradients in f16 do not vanish; the parameters' gradients are divided
//! by it. A step with a gradient that is not finite is skipped and halves it; a row of good steps doubles it.

use crate::Result;
use crate::gpu::{Buffer, Gpu, Recorder};
use crate::net::device::{DeviceTensor, groups, windows};
use crate::{push_block, shaders};
use serde::{Deserialize, Serialize};

push_block! {
    /// Push constants of `scale_gradient.comp`.
    pub struct ScalePush for shaders::scale_gradient { count: u32 }
}
push_block! {
    /// Push constants of `unscale_gradient.comp`.
    pub struct UnscalePush for shaders::unscale_gradient { count: u32 }
}
push_block! {
    /// Push constants of `update_loss_scale.comp`.
    pub struct UpdatePush for shaders::update_loss_scale { growth_interval: u32, largest: f32 }
}

/// Good steps in a row before the scale is doubled.
pub const GROWTH_INTERVAL: u32 = 2000;
/// The scale is not doubled beyond this.
const LARGEST: f32 = (1 << 24) as f32;

/// What is kept from step to step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The scale, a power of two.
    pub scale: f32,
    /// Good steps since it last changed.
    pub good_steps: u32,
}

impl Default for State {
    fn default() -> Self {
        Self { scale: 65_536.0, good_steps: 0 }
    }
}

impl State {
    /// Whether it is one that [`LossScale`] may come to: a power of two from 1.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        const MANTISSA: u32 = 0x7f_ffff;
        (1.0..=LARGEST).contains(&self.scale) && self.scale.to_bits() & MANTISSA == 0
    }
}

/// The scale on the device.
pub struct LossScale {
    gpu: Gpu,
    state: Buffer,
    /// One word, not 0 between [`Self::unscale`] and [`Self::update`] where the step has to be skipped.
    pub skip: Buffer,
}

impl LossScale {
    /// The first scale.
    pub fn new(gpu: &Gpu) -> Result<Self> {
        let this = Self { gpu: gpu.clone(), state: gpu.buffer("loss scale", 8)?, skip: gpu.buffer("skip", 4)? };
        this.set(State::default())?;
        Ok(this)
    }

    /// The scale that the next step uses.
    pub fn get(&self) -> Result<State> {
        let words: Vec<u32> = self.gpu.download(&self.state.slice(0, 8))?;
        Ok(State { scale: f32::from_bits(words[0]), good_steps: words[1] })
    }

    /// Sets the scale that the next step uses.
    ///
    /// # Panics
    /// Where it is no power of two from 1.
    pub fn set(&self, state: State) -> Result<()> {
        assert!(state.is_valid(), "{state:?}");
        self.gpu.upload(&self.state.all(), &[state.scale.to_bits(), state.good_steps])
    }

    /// Records the scaling of the loss's gradient.
    pub fn scale(&self, rec: &mut Recorder, gradient: &DeviceTensor) -> Result<()> {
        let kernel = self.gpu.kernel::<shaders::scale_gradient::Shader>(&Default::default())?;
        for (begin, count) in windows(self.gpu.info(), gradient.shape.texels()) {
            let gradient = gradient.slice.slice(begin * 16, count * 16);
            let bind = shaders::scale_gradient::Bind { loss_scale: self.state.all(), gradient };
            rec.dispatch(&kernel, &bind, &ScalePush { count: count as u32 }, groups(count));
        }
        Ok(())
    }

    /// Records the division of the parameters' gradients by the scale, and the check that they are finite.
    pub fn unscale(&self, rec: &mut Recorder, gradient: &Buffer) -> Result<()> {
        let kernel = self.gpu.kernel::<shaders::unscale_gradient::Shader>(&Default::default())?;
        let count = gradient.bytes() / 16;
        let bind = shaders::unscale_gradient::Bind {
            loss_scale: self.state.all(),
            gradient: gradient.all(),
            skip: self.skip.all(),
        };
        rec.dispatch(&kernel, &bind, &UnscalePush { count: count as u32 }, groups(count));
        Ok(())
    }

    /// Records the choice of the next step's scale.
    pub fn update(&self, rec: &mut Recorder) -> Result<()> {
        let kernel = self.gpu.kernel::<shaders::update_loss_scale::Shader>(&Default::default())?;
        let bind = shaders::update_loss_scale::Bind { loss_scale: self.state.all(), skip: self.skip.all() };
        rec.dispatch(&kernel, &bind, &UpdatePush { growth_interval: GROWTH_INTERVAL, largest: LARGEST }, [1, 1, 1]);
        Ok(())
    }
}
