//! The backward pass of a network at one size.

use super::kernel::{conv2d as conv_grad, elementwise, kernel_filter};
use crate::Result;
use crate::gpu::{Buffer, Gpu, Recorder, Slice};
use crate::net::architecture::{NodeId, Op};
use crate::net::device::{DeviceTensor, Shape};
use crate::net::kernel::{conv2d, winograd};
use crate::net::parameters::Parameters;
use crate::net::plan::Plan;

/// Gradients of every value and parameter.
pub struct Backward {
    gpu: Gpu,
    /// By node; none for the network's input.
    gradients: Vec<Option<DeviceTensor>>,
    /// Where the second gradient of a value goes before it is added to the first.
    extra: Option<Buffer>,
    /// What the gradients of a filter keep for one another, 16 bytes a pixel.
    kept: Option<Buffer>,
    scratch: conv_grad::Scratch,
    zero_bias: Slice,
    /// Parameter gradients, laid out as [`Parameters::flat`].
    pub flat: Buffer,
}

/// Gradients that have been written so far, by node.
type Written = Vec<bool>;

impl Backward {
    /// Tensors for the backward pass of `plan`, whose values must all be kept.
    pub fn new(gpu: &Gpu, parameters: &Parameters, plan: &Plan) -> Result<Self> {
        let nodes = parameters.architecture().nodes();
        let gradient = |id: NodeId| match &nodes[id].differentiated()[..] {
            [] => Ok(None),
            _ => DeviceTensor::new(gpu, &format!("d {}", nodes[id].name), plan.values[id].shape).map(Some),
        };
        let users = |id: NodeId| nodes.iter().filter(|n| n.differentiated().contains(&id)).count();
        let extra = (1..nodes.len()).filter(|id| users(*id) > 1).map(|id| plan.values[id].shape.bytes()).max();
        let filters = (0..nodes.len()).filter(|id| nodes[*id].op == Op::KernelFilter);
        let kept = filters.map(|id| plan.values[id].shape.bytes()).max();
        let convs = parameters
            .convs
            .iter()
            .zip(nodes)
            .filter_map(|(conv, node)| conv.as_ref().map(|c| (c.layer, plan.values[node.inputs[0]].shape)));
        let layers: Vec<(conv2d::Layer, Shape)> = convs.collect();
        let widest = layers.iter().map(|(l, _)| l.input.texels() * 4).max().unwrap_or(0);
        Ok(Self {
            gpu: gpu.clone(),
            gradients: (0..nodes.len()).map(gradient).collect::<Result<_>>()?,
            extra: extra.map(|bytes| gpu.buffer("second gradient", bytes)).transpose()?,
            kept: kept.map(|bytes| gpu.buffer("kept of filters", bytes)).transpose()?,
            scratch: conv_grad::Scratch::new(gpu, parameters.family(), &layers)?,
            zero_bias: gpu.buffer("zero bias", u64::from(widest + 64) * 4)?.all(),
            flat: gpu.buffer("parameter gradients", parameters.flat.bytes())?,
        })
    }

    /// Where the gradient of the network's output goes before [`Self::record`].
    ///
    /// # Panics
    /// Never: the output is no input node.
    #[must_use]
    pub fn output_gradient(&self) -> &DeviceTensor {
        self.gradients.last().and_then(Option::as_ref).expect("the output has a gradient")
    }

    /// Records the gradients of all parameters from that of the output.
    pub fn record(&self, rec: &mut Recorder, parameters: &Parameters, plan: &Plan) -> Result<()> {
        let nodes = parameters.architecture().nodes();
        let mut written: Written = vec![false; nodes.len()];
        for id in (1..nodes.len()).rev() {
            let Some(dy) = self.gradients[id].as_ref() else { continue };
            let inputs = &nodes[id].inputs;
            match nodes[id].op {
                Op::Input { .. } | Op::Demodulate | Op::MaskedPool => {}
                Op::KernelFilter => self.filter(rec, &mut written, plan, inputs, dy)?,
                Op::Modulate => self.into(rec, &mut written, inputs[0], |rec, dx| {
                    let [x, input] = [0, 1].map(|i| &plan.values[inputs[i]]);
                    kernel_filter::modulate(&self.gpu, rec, (x, input), dy, dx)
                })?,
                Op::MaxPool => self.into(rec, &mut written, inputs[0], |rec, dx| {
                    elementwise::max_pool2d(&self.gpu, rec, &plan.values[inputs[0]], dy, dx)
                })?,
                Op::Upsample => {
                    self.into(rec, &mut written, inputs[0], |rec, dx| elementwise::upsample2d(&self.gpu, rec, dy, dx))?;
                }
                Op::Concat => {
                    for (second, input) in [(false, inputs[0]), (true, inputs[1])] {
                        self.into(rec, &mut written, input, |rec, dx| {
                            elementwise::concat(&self.gpu, rec, dy, dx, second)
                        })?;
                    }
                }
                Op::Conv { slope, .. } => {
                    if let Some(slope) = slope {
                        elementwise::leaky_relu(&self.gpu, rec, &plan.values[id], dy, dy, slope)?;
                    }
                    self.conv(rec, &mut written, parameters, plan, id)?;
                }
            }
        }
        Ok(())
    }

    fn conv(
        &self,
        rec: &mut Recorder,
        written: &mut Written,
        parameters: &Parameters,
        plan: &Plan,
        id: NodeId,
    ) -> Result<()> {
        let conv = parameters.convs[id].as_ref().expect("a convolution has parameters");
        let dy = self.gradients[id].as_ref().expect("no input");
        let input = parameters.architecture().nodes()[id].inputs[0];
        let family = parameters.family();
        let flat = |slice: &Slice, at: usize| self.flat.slice(at as u64 * 4, slice.bytes());
        let weight_grad = flat(&conv.weight, conv.at.0);
        conv_grad::weight_grad(&self.gpu, rec, conv.layer, &self.scratch, &plan.values[input], dy, &weight_grad)?;
        conv_grad::bias_grad(&self.gpu, rec, conv.layer, &self.scratch, dy, &flat(&conv.bias, conv.at.1))?;
        let weight = conv.packed_transposed.as_ref().expect("parameters made for training");
        let bias = &self.zero_bias;
        self.into(rec, written, input, |rec, dx| match &conv.winograd_transposed {
            Some(weight) => {
                let pass = winograd::Pass { low: None, x: dy, weight, bias, y: dx, slope: 1.0 };
                winograd::record(&self.gpu, rec, family, &pass)
            }
            None => conv2d::record(&self.gpu, rec, family, &conv2d::Pass { x: dy, weight, bias, y: dx, slope: 1.0 }),
        })
    }

    fn filter(
        &self,
        rec: &mut Recorder,
        written: &mut Written,
        plan: &Plan,
        inputs: &[NodeId],
        dy: &DeviceTensor,
    ) -> Result<()> {
        let kept = self.kept.as_ref().expect("made where there is a filter").slice(0, dy.shape.bytes());
        let operands = plan.filter_operands(inputs);
        self.into(rec, written, inputs[0], |rec, dx| kernel_filter::logits(&self.gpu, rec, operands, dy, &kept, dx))?;
        if let Some(coarse) = operands.coarse {
            self.into(rec, written, inputs[2], |rec, dx| {
                kernel_filter::coarse(&self.gpu, rec, operands.logits, coarse, &kept, dx)
            })?;
        }
        Ok(())
    }

    /// Lets `f` write the gradient of a value, or add to it where an earlier user has written one.
    fn into(
        &self,
        rec: &mut Recorder,
        written: &mut Written,
        id: NodeId,
        f: impl FnOnce(&mut Recorder, &DeviceTensor) -> Result<()>,
    ) -> Result<()> {
        let Some(gradient) = &self.gradients[id] else { return Ok(()) };
        if !std::mem::replace(&mut written[id], true) {
            return f(rec, gradient);
        }
        let extra = self.extra.as_ref().expect("a value with two users");
        let second = DeviceTensor { shape: gradient.shape, slice: extra.slice(0, gradient.shape.bytes()) };
        f(rec, &second)?;
        elementwise::add(&self.gpu, rec, gradient, &second, gradient)
    }
}
