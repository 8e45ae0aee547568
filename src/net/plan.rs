//! A network's forward pass at one size: its tensors and its dispatches.

use super::architecture::{Architecture, NodeId, Op};
use super::device::{Channels, DeviceTensor, Shape};
use super::kernel::{Family, concat, conv2d, demodulate, kernel_filter, leaky_relu, max_pool2d, upsample2d, winograd};
use super::parameters::{Parameters, conv_layer, node_channels};
use crate::gpu::{Footprint, Gpu, Recorder};
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
    /// The convolutions that [`winograd::fits`] are its, for families with these kernels; the others as
    /// [`Fusion::Activation`].
    Winograd,
    /// The same, and they read the operands of a concatenation with what is upsampled where they are: for inference.
    InPlace,
}

impl Fusion {
    /// The fastest for inference.
    #[must_use]
    pub fn best(family: Family) -> Self {
        match Self::training(family) {
            Self::Winograd => Self::InPlace,
            other => other,
        }
    }

    /// The fastest that keeps every value.
    #[must_use]
    pub fn training(family: Family) -> Self {
        match family {
            Family::Cpu { .. } => Self::Winograd,
            _ => Self::Activation,
        }
    }

    /// The slope that a convolution's own kernel applies, of a node with this one.
    fn slope(self, slope: Option<f32>) -> f32 {
        if self == Self::Layers { 1.0 } else { slope.unwrap_or(1.0) }
    }
}

/// How a node is computed.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Job {
    /// By its layer's own kernels, from its inputs.
    Layer,
    /// By a convolution of `x`, with the upsampled `low` before it where there is such.
    Winograd { low: Option<NodeId>, x: NodeId },
    /// Not at all: its users read its inputs.
    Nothing,
}

/// The tensors of one size.
pub struct Plan {
    gpu: Gpu,
    family: Family,
    fusion: Fusion,
    jobs: Vec<Job>,
    /// One a node; what no kernel writes is a texel that nobody reads.
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

/// What each node is computed by.
fn jobs(architecture: &Architecture, family: Family, fusion: Fusion) -> Vec<Job> {
    let nodes = architecture.nodes();
    let channels = node_channels(architecture);
    let mut jobs = vec![Job::Layer; nodes.len()];
    if matches!(fusion, Fusion::Layers | Fusion::Activation) {
        return jobs;
    }
    for (id, node) in nodes.iter().enumerate() {
        let is_conv = matches!(node.op, Op::Conv { .. });
        if !is_conv || !winograd::fits(family, conv_layer(architecture, &channels, id), node.level) {
            continue;
        }
        let input = node.inputs[0];
        let (low, x) = match (&nodes[input].op, &nodes[input].inputs[..]) {
            (Op::Concat, &[first, second]) if fusion == Fusion::InPlace && nodes[first].op == Op::Upsample => {
                (Some(nodes[first].inputs[0]), second)
            }
            _ => (None, input),
        };
        jobs[id] = Job::Winograd { low, x };
    }
    // From the end: what nobody reads any more is not computed.
    for id in (0..nodes.len() - 1).rev() {
        if matches!(nodes[id].op, Op::Concat | Op::Upsample)
            && !reads(architecture, &jobs).iter().any(|r| r.contains(&id))
        {
            jobs[id] = Job::Nothing;
        }
    }
    jobs
}

/// What each node's kernels read.
fn reads(architecture: &Architecture, jobs: &[Job]) -> Vec<Vec<NodeId>> {
    let of = |(job, node): (&Job, &super::architecture::Node)| match job {
        Job::Layer => node.inputs.clone(),
        Job::Winograd { low, x } => low.iter().chain([x]).copied().collect(),
        Job::Nothing => Vec::new(),
    };
    jobs.iter().zip(architecture.nodes()).map(of).collect()
}

fn last_uses(architecture: &Architecture, jobs: &[Job]) -> Vec<usize> {
    let count = architecture.nodes().len();
    let mut last: Vec<usize> = (0..count).collect();
    last[count - 1] = count;
    for (id, reads) in reads(architecture, jobs).iter().enumerate() {
        for read in reads {
            last[*read] = last[*read].max(id);
        }
    }
    last
}

/// Side of the blocks of results that a node computes at once.
fn block(job: &Job) -> usize {
    if matches!(job, Job::Winograd { .. }) { winograd::TILE as usize } else { 1 }
}

/// How a plan may be cut into tiles whose cores have the bits of the whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileRules {
    /// Frames are padded to a multiple of this.
    pub alignment: u32,
    /// Tiles and cores begin at multiples of this, itself a multiple of the alignment.
    pub step: u32,
    /// Pixels that a tile needs beyond each side of its core, where the frame does not end before; a multiple of `step`.
    pub overlap: u32,
}

impl TileRules {
    /// Of a plan of these kernels.
    #[must_use]
    pub fn new(architecture: &Architecture, family: Family, fusion: Fusion) -> Self {
        let jobs = jobs(architecture, family, fusion);
        Self {
            alignment: architecture.alignment() as u32,
            step: architecture.tile_step(|id| block(&jobs[id])) as u32,
            overlap: architecture.tile_overlap_in_blocks(|id| block(&jobs[id])) as u32,
        }
    }
}

/// What a plan computes and holds, known before anything is allocated.
struct Layout {
    jobs: Vec<Job>,
    shapes: Vec<Shape>,
}

impl Layout {
    fn new(architecture: &Architecture, family: Family, (n, h, w): (u32, u32, u32), fusion: Fusion) -> Self {
        let jobs = jobs(architecture, family, fusion);
        let mut shapes = shapes(architecture, n, h, w);
        for (shape, _) in shapes.iter_mut().zip(&jobs).filter(|(_, job)| **job == Job::Nothing) {
            *shape = Shape { n: 1, h: 1, w: 1, c: Channels::new(4) };
        }
        Self { jobs, shapes }
    }

    /// The places of the values in memory that they share, and its size.
    fn arena(&self, architecture: &Architecture) -> (Vec<u64>, u64) {
        let bytes: Vec<u64> = self.shapes.iter().map(Shape::bytes).collect();
        places(&bytes, &last_uses(architecture, &self.jobs))
    }
}

impl Plan {
    /// The memory that [`Self::new`] will take with [`Memory::Shared`]; `size` as there.
    #[must_use]
    pub fn footprint(architecture: &Architecture, family: Family, size: (u32, u32, u32), fusion: Fusion) -> Footprint {
        let layout = Layout::new(architecture, family, size, fusion);
        let largest = layout.shapes.iter().map(Shape::bytes).max().unwrap_or(0);
        Footprint::arena(layout.arena(architecture).1, largest)
    }

    /// Lets the kernels of a plan be made on threads of their own, those that take longest first, while the caller reads
    /// files and allocates memory.
    pub fn request_kernels(gpu: &Gpu, architecture: &Architecture, family: Family, fusion: Fusion) -> Result<()> {
        let channels = node_channels(architecture);
        let jobs = jobs(architecture, family, fusion);
        let winograd = |id: &NodeId| matches!(jobs[*id], Job::Winograd { .. });
        let mut written: Vec<Channels> = (0..jobs.len()).filter(winograd).map(|id| channels[id]).collect();
        written.sort_by_key(|c| std::cmp::Reverse(c.texels()));
        for c in written {
            winograd::kernel(gpu, family, c)?;
        }
        for (id, node) in architecture.nodes().iter().enumerate().filter(|(id, _)| jobs[*id] == Job::Layer) {
            if let Op::Conv { slope, .. } = node.op {
                conv2d::request(gpu, family, channels[id], fusion.slope(slope))?;
            }
        }
        Ok(())
    }

    /// Tensors for `n` images of `h` x `w` pixels.
    pub fn new(
        gpu: &Gpu,
        architecture: &Architecture,
        family: Family,
        size: (u32, u32, u32),
        memory: Memory,
        fusion: Fusion,
    ) -> Result<Self> {
        let (n, h, w) = size;
        if matches!(fusion, Fusion::Winograd | Fusion::InPlace) && Fusion::training(family) != Fusion::Winograd {
            return Err(Error::input(format!("the kernels `{}` have no Winograd convolution", family.name())));
        }
        let alignment = architecture.alignment() as u32;
        if n == 0 || h == 0 || w == 0 || !h.is_multiple_of(alignment) || !w.is_multiple_of(alignment) {
            return Err(Error::input(format!(
                "{n} images of {w}x{h}: `{}` needs sizes that are multiples of {alignment}",
                architecture.name()
            )));
        }
        let layout = Layout::new(architecture, family, size, fusion);
        let values = match memory {
            Memory::Kept => {
                let tensor = |(s, node): (&Shape, &super::architecture::Node)| DeviceTensor::new(gpu, &node.name, *s);
                layout.shapes.iter().zip(architecture.nodes()).map(tensor).collect::<Result<Vec<_>>>()?
            }
            Memory::Shared => {
                let (offsets, total) = layout.arena(architecture);
                // A kernel writes every texel of a value, those that only pad too, before another reads it.
                let arena = gpu.unset_buffer("activations", total)?;
                let tensor = |(s, at): (&Shape, &u64)| DeviceTensor { shape: *s, slice: arena.slice(*at, s.bytes()) };
                layout.shapes.iter().zip(&offsets).map(tensor).collect()
            }
        };
        Ok(Self { gpu: gpu.clone(), family, fusion, jobs: layout.jobs, values })
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
    ///
    /// # Panics
    /// Where the parameters are for other kernels.
    pub fn record(&self, rec: &mut Recorder, parameters: &Parameters) -> Result<()> {
        (0..self.jobs.len()).try_for_each(|id| self.record_node(rec, parameters, id))
    }

    /// Records what makes one node's value, where anything does.
    ///
    /// # Panics
    /// As [`Self::record`].
    pub fn record_node(&self, rec: &mut Recorder, parameters: &Parameters, id: NodeId) -> Result<()> {
        assert_eq!(self.family, parameters.family());
        match &self.jobs[id] {
            Job::Nothing => Ok(()),
            Job::Layer => self.record_layer(rec, parameters, id),
            Job::Winograd { low, x } => self.record_winograd(rec, parameters, id, (*low, *x)),
        }
    }

    /// Whether a node's value is computed, or its users read its inputs instead.
    #[must_use]
    pub fn computes(&self, id: NodeId) -> bool {
        self.jobs[id] != Job::Nothing
    }

    /// The nodes whose values are read to compute a node.
    #[must_use]
    pub fn reads(&self, architecture: &Architecture, id: NodeId) -> Vec<NodeId> {
        reads(architecture, &self.jobs).swap_remove(id)
    }

    fn record_winograd(
        &self,
        rec: &mut Recorder,
        parameters: &Parameters,
        id: NodeId,
        (low, x): (Option<NodeId>, NodeId),
    ) -> Result<()> {
        let conv = parameters.convs[id].as_ref().expect("a convolution has parameters");
        let Op::Conv { slope, .. } = parameters.architecture().nodes()[id].op else { unreachable!("a convolution") };
        let pass = winograd::Pass {
            low: low.map(|low| &self.values[low]),
            x: &self.values[x],
            weight: conv.winograd.as_ref().expect("made where the layer fits"),
            bias: &conv.bias,
            y: &self.values[id],
            slope: slope.unwrap_or(1.0),
        };
        winograd::record(&self.gpu, rec, self.family, &pass)
    }

    /// What a filter reads, of the inputs of its node.
    #[must_use]
    pub fn filter_operands(&self, inputs: &[NodeId]) -> kernel_filter::Operands<'_> {
        let value = |id: &NodeId| &self.values[*id];
        kernel_filter::Operands { logits: value(&inputs[0]), fine: value(&inputs[1]), coarse: inputs.get(2).map(value) }
    }

    fn record_layer(&self, rec: &mut Recorder, parameters: &Parameters, id: NodeId) -> Result<()> {
        let node = &parameters.architecture().nodes()[id];
        let y = &self.values[id];
        let x = |i: usize| &self.values[node.inputs[i]];
        match node.op {
            Op::Input { .. } => Ok(()),
            Op::MaxPool => max_pool2d::record(&self.gpu, rec, x(0), y),
            Op::Upsample => upsample2d::record(&self.gpu, rec, x(0), y),
            Op::Concat => concat::record(&self.gpu, rec, x(0), x(1), y),
            Op::Demodulate => demodulate::record(&self.gpu, rec, x(0), y),
            Op::MaskedPool => demodulate::record_pool(&self.gpu, rec, x(0), y),
            Op::KernelFilter => kernel_filter::record(&self.gpu, rec, self.filter_operands(&node.inputs), y),
            Op::Modulate => demodulate::record_modulate(&self.gpu, rec, x(0), x(1), y),
            Op::Conv { slope, .. } => {
                let conv = parameters.convs[id].as_ref().expect("a convolution has parameters");
                let fused = self.fusion.slope(slope);
                let pass = conv2d::Pass { x: x(0), weight: &conv.packed, bias: &conv.bias, y, slope: fused };
                conv2d::record(&self.gpu, rec, parameters.family(), &pass)?;
                match slope {
                    Some(slope) if self.fusion == Fusion::Layers => leaky_relu::record(&self.gpu, rec, y, y, slope),
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
        let last = last_uses(&architecture, &vec![Job::Layer; architecture.nodes().len()]);
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
