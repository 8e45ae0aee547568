//! A network's forward pass at one size: its tensors and its dispatches.

use super::architecture::{Architecture, NodeId, Op};
use super::device::{Channels, DeviceTensor, Shape};
use super::kernel::{concat, conv2d, leaky_relu, max_pool2d, upsample2d};
use super::parameters::{Parameters, node_channels};
use crate::gpu::{Gpu, Recorder};
use crate::{Error, Result};

/// How the tensors of a plan share memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Memory {
    /// Tensors that never live at the same time share memory.
    Shared,
    /// Every tensor keeps its value, as the backward pass needs.
    Kept,
}

/// Which kernels a plan is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fusion {
    /// A dispatch a layer.
    Layers,
    /// The leaky ReLU is part of the convolution.
    Activation,
}

/// The tensors of one size.
pub struct Plan {
    gpu: Gpu,
    fusion: Fusion,
    /// One a node.
    pub values: Vec<DeviceTensor>,
}

/// Bytes that slices of the arena begin at.
const ALIGNMENT: u64 = 256;

/// Places for values of `bytes[i]` that live from step `i` to step `last_use[i]`, the largest first, each as low as it fits;
/// and the size of the whole.
fn places(bytes: &[u64], last_use: &[usize]) -> (Vec<u64>, u64) {
    let mut order: Vec<usize> = (0..bytes.len()).collect();
    order.sort_by_key(|i| (std::cmp::Reverse(bytes[*i]), *i));
    let mut offsets = vec![0; bytes.len()];
    for (placed, &i) in order.iter().enumerate() {
        let together = |j: usize| j.max(i) <= last_use[j.min(i)];
        let taken = order[..placed].iter().filter(|j| together(**j));
        let mut live: Vec<(u64, u64)> = taken.map(|j| (offsets[*j], offsets[*j] + bytes[*j])).collect();
        live.sort_unstable();
        let mut at = 0;
        for (begin, end) in live {
            if at + bytes[i] <= begin {
                break;
            }
            at = at.max(end.next_multiple_of(ALIGNMENT));
        }
        offsets[i] = at;
    }
    let total = offsets.iter().zip(bytes).map(|(at, size)| at + size).max().unwrap_or(0);
    (offsets, total)
}

/// The size of every node's value.
fn shapes(architecture: &Architecture, n: u32, h: u32, w: u32) -> Vec<Shape> {
    let channels = node_channels(architecture);
    let shape =
        |(node, c): (&super::architecture::Node, Channels)| Shape { n, h: h >> node.level, w: w >> node.level, c };
    architecture.nodes().iter().zip(channels).map(shape).collect()
}

fn last_uses(architecture: &Architecture) -> Vec<usize> {
    let count = architecture.nodes().len();
    let mut last: Vec<usize> = (0..count).collect();
    last[count - 1] = count;
    for (id, node) in architecture.nodes().iter().enumerate() {
        for input in &node.inputs {
            last[*input] = last[*input].max(id);
        }
    }
    last
}

impl Plan {
    /// Tensors for `n` images of `h` x `w` pixels.
    pub fn new(
        gpu: &Gpu,
        architecture: &Architecture,
        size: (u32, u32, u32),
        memory: Memory,
        fusion: Fusion,
    ) -> Result<Self> {
        let (n, h, w) = size;
        let alignment = architecture.alignment() as u32;
        if n == 0 || h == 0 || w == 0 || !h.is_multiple_of(alignment) || !w.is_multiple_of(alignment) {
            return Err(Error::input(format!(
                "{n} images of {w}x{h}: `{}` needs sizes that are multiples of {alignment}",
                architecture.name()
            )));
        }
        let shapes = shapes(architecture, n, h, w);
        let values = match memory {
            Memory::Kept => {
                let tensor = |(s, node): (&Shape, &super::architecture::Node)| DeviceTensor::new(gpu, &node.name, *s);
                shapes.iter().zip(architecture.nodes()).map(tensor).collect::<Result<Vec<_>>>()?
            }
            Memory::Shared => {
                let bytes: Vec<u64> = shapes.iter().map(Shape::bytes).collect();
                let (offsets, total) = places(&bytes, &last_uses(architecture));
                let arena = gpu.buffer("activations", total)?;
                let tensor = |(s, at): (&Shape, &u64)| DeviceTensor { shape: *s, slice: arena.slice(*at, s.bytes()) };
                shapes.iter().zip(&offsets).map(tensor).collect()
            }
        };
        Ok(Self { gpu: gpu.clone(), fusion, values })
    }

    /// Where the network's input goes.
    #[must_use]
    pub fn input(&self) -> &DeviceTensor {
        &self.values[0]
    }

    /// Where the network's output is.
    #[must_use]
    pub fn output(&self) -> &DeviceTensor {
        &self.values[self.values.len() - 1]
    }

    /// Records the forward pass.
    pub fn record(&self, rec: &mut Recorder, parameters: &Parameters) -> Result<()> {
        for id in 0..self.values.len() {
            self.record_node(rec, parameters, id)?;
        }
        Ok(())
    }

    fn record_node(&self, rec: &mut Recorder, parameters: &Parameters, id: NodeId) -> Result<()> {
        let node = &parameters.architecture().nodes()[id];
        let y = &self.values[id];
        let x = |i: usize| &self.values[node.inputs[i]];
        match node.op {
            Op::Input { .. } => Ok(()),
            Op::MaxPool => max_pool2d::record(&self.gpu, rec, x(0), y),
            Op::Upsample => upsample2d::record(&self.gpu, rec, x(0), y),
            Op::Concat => concat::record(&self.gpu, rec, x(0), x(1), y),
            Op::Conv { slope, .. } => {
                let conv = parameters.convs[id].as_ref().expect("a convolution has parameters");
                let fused = if self.fusion == Fusion::Activation { slope } else { None };
                let pass =
                    conv2d::Pass { x: x(0), weight: &conv.packed, bias: &conv.bias, y, slope: fused.unwrap_or(1.0) };
                conv2d::record(&self.gpu, rec, parameters.family(), &pass)?;
                match slope {
                    Some(slope) if fused.is_none() => leaky_relu::record(&self.gpu, rec, y, y, slope),
                    _ => Ok(()),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_live_together_do_not_overlap() {
        let architecture = Architecture::seed();
        let bytes: Vec<u64> = shapes(&architecture, 1, 64, 96).iter().map(Shape::bytes).collect();
        let last = last_uses(&architecture);
        let (offsets, total) = places(&bytes, &last);
        for j in 0..bytes.len() {
            for i in 0..j {
                let apart = offsets[i] + bytes[i] <= offsets[j] || offsets[j] + bytes[j] <= offsets[i];
                assert!(last[i] < j || apart, "{i} and {j}");
            }
            assert!(offsets[j] + bytes[j] <= total && offsets[j].is_multiple_of(ALIGNMENT));
        }
        // The least there can be: what lives at the widest step, one of which is the operand and the result of dec_conv1a.
        let live = |step: usize| (0..=step).filter(|i| last[*i] >= step).map(|i| bytes[i]).sum::<u64>();
        let least = (0..bytes.len()).map(live).max().unwrap();
        assert!(total <= least + least / 8, "{total} bytes where {least} live at once");
    }
}
