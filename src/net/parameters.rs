//! A network's parameters on the device: one flat buffer, and the packed copies that the convolutions read.

use super::architecture::{Architecture, NodeId, Op};
use super::device::Channels;
use super::kernel::{Family, conv2d, winograd};
use super::weights::Weights;
use crate::Result;
use crate::gpu::{Buffer, Footprint, Gpu, Recorder, Slice};

/// Each tensor begins at a multiple of this many floats and is padded to it with zeros.
const ALIGNMENT: usize = 64;

/// One convolution's parameters.
pub struct ConvParameters {
    /// Channels.
    pub layer: conv2d::Layer,
    /// OIHW weights in the flat buffer.
    pub weight: Slice,
    /// Bias in the flat buffer, padded to a multiple of 64 floats.
    pub bias: Slice,
    /// Weights as the forward pass reads them.
    pub packed: Slice,
    /// Weights as the input gradient reads them; only for training.
    pub packed_transposed: Option<Slice>,
    /// Weights as a Winograd convolution reads them; only where it fits.
    pub winograd: Option<Slice>,
    /// The same for the input gradient; only for training.
    pub winograd_transposed: Option<Slice>,
    /// First float of the weights and of the bias in the flat buffer.
    pub at: (usize, usize),
}

/// All parameters of a network.
pub struct Parameters {
    gpu: Gpu,
    architecture: Architecture,
    family: Family,
    /// All tensors, padded.
    pub flat: Buffer,
    /// By node; none for what is no convolution.
    pub convs: Vec<Option<ConvParameters>>,
}

/// The channel segments of every node's value: a concatenation keeps its operands apart.
#[must_use]
pub fn node_channels(architecture: &Architecture) -> Vec<Channels> {
    let nodes = architecture.nodes();
    let of = |node: &super::architecture::Node| match node.op {
        Op::Concat => {
            Channels { first: nodes[node.inputs[0]].channels as u32, second: nodes[node.inputs[1]].channels as u32 }
        }
        _ => Channels::new(node.channels as u32),
    };
    nodes.iter().map(of).collect()
}

/// The channels that the convolution of node `id` reads and writes; `channels` are [`node_channels`].
#[must_use]
pub fn conv_layer(architecture: &Architecture, channels: &[Channels], id: NodeId) -> conv2d::Layer {
    let node = &architecture.nodes()[id];
    conv2d::Layer { input: channels[node.inputs[0]], cout: node.channels as u32 }
}

fn padded(count: usize) -> usize {
    count.next_multiple_of(ALIGNMENT)
}

fn flat_bytes(architecture: &Architecture) -> u64 {
    architecture.tensors().iter().map(|t| padded(t.range.len()) as u64 * 4).sum()
}

/// Bytes of the weights of a convolution as a Winograd convolution reads them; none where no plan reads them.
fn winograd_bytes(family: Family, layer: conv2d::Layer, level: usize, transposed: bool) -> Option<u64> {
    winograd::fits(family, layer, level).then(|| winograd::weights_bytes(family, layer, transposed))
}

impl Parameters {
    /// The memory that [`Self::new`] will take for inference.
    #[must_use]
    pub fn footprint(architecture: &Architecture, family: Family) -> Footprint {
        let channels = node_channels(architecture);
        let convs = (0..channels.len()).filter(|id| architecture.nodes()[*id].parameters.is_some());
        let packed = convs.flat_map(|id| {
            let layer = conv_layer(architecture, &channels, id);
            let level = architecture.nodes()[id].level;
            [Some(layer.packed_bytes(family, false)), winograd_bytes(family, layer, level, false)]
        });
        let flat = std::iter::once(flat_bytes(architecture));
        flat.chain(packed.flatten()).map(Footprint::buffer).sum()
    }

    /// Uploads `weights`; `training` adds what the backward pass reads.
    pub fn new(gpu: &Gpu, family: Family, weights: &Weights, training: bool) -> Result<Self> {
        let architecture = weights.architecture.clone();
        let channels = node_channels(&architecture);
        let flat = gpu.buffer("parameters", flat_bytes(&architecture))?;
        let mut at = 0;
        let mut convs = Vec::new();
        for (id, node) in architecture.nodes().iter().enumerate() {
            let Some(parameters) = &node.parameters else {
                convs.push(None);
                continue;
            };
            let (weight_at, bias_at) = (at, at + padded(parameters.weight.len()));
            at = bias_at + padded(parameters.bias.len());
            let layer = conv_layer(&architecture, &channels, id);
            let packed = |name, transposed| -> Result<Slice> {
                Ok(gpu.buffer(name, layer.packed_bytes(family, transposed))?.all())
            };
            let transformed = |transposed| -> Result<Option<Slice>> {
                let bytes = winograd_bytes(family, layer, node.level, transposed);
                bytes.map(|bytes| Ok(gpu.buffer("transformed weights", bytes)?.all())).transpose()
            };
            convs.push(Some(ConvParameters {
                layer,
                weight: flat.slice(weight_at as u64 * 4, padded(parameters.weight.len()) as u64 * 4),
                bias: flat.slice(bias_at as u64 * 4, padded(parameters.bias.len()) as u64 * 4),
                packed: packed("packed weights", false)?,
                packed_transposed: if training { Some(packed("transposed weights", true)?) } else { None },
                winograd: transformed(false)?,
                winograd_transposed: if training { transformed(true)? } else { None },
                at: (weight_at, bias_at),
            }));
        }
        let this = Self { gpu: gpu.clone(), architecture, family, flat, convs };
        this.set(&weights.parameters)?;
        Ok(this)
    }

    /// The network.
    #[must_use]
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// The kernels that the packed copies are for.
    #[must_use]
    pub fn family(&self) -> Family {
        self.family
    }

    /// Floats of the flat buffer, padding included.
    #[must_use]
    pub fn padded_len(&self) -> usize {
        self.flat.bytes() as usize / 4
    }

    /// Uploads the flat parameter vector of [`Architecture::tensors`] and packs it.
    ///
    /// # Panics
    /// Where `values` has another length.
    pub fn set(&self, values: &[f32]) -> Result<()> {
        self.gpu.upload(&self.flat.all(), &self.pad(values))?;
        let mut rec = self.gpu.recorder();
        self.record_pack(&mut rec)?;
        rec.finish()?.run()?;
        Ok(())
    }

    /// The flat parameter vector, read back.
    pub fn get(&self) -> Result<Vec<f32>> {
        Ok(self.unpad(&self.gpu.download::<f32>(&self.flat.all())?))
    }

    fn each(&self, mut f: impl FnMut(std::ops::Range<usize>, usize)) {
        for (node, conv) in self.architecture.nodes().iter().zip(&self.convs) {
            if let (Some(p), Some(conv)) = (&node.parameters, conv) {
                f(p.weight.clone(), conv.at.0);
                f(p.bias.clone(), conv.at.1);
            }
        }
    }

    /// A flat vector laid out as the flat buffer.
    ///
    /// # Panics
    /// Where `values` has another length.
    #[must_use]
    pub fn pad(&self, values: &[f32]) -> Vec<f32> {
        assert_eq!(values.len(), self.architecture.parameter_count());
        let mut padded = vec![0f32; self.padded_len()];
        self.each(|range, at| padded[at..at + range.len()].copy_from_slice(&values[range]));
        padded
    }

    /// The inverse of [`Self::pad`].
    #[must_use]
    pub fn unpad(&self, padded: &[f32]) -> Vec<f32> {
        let mut values = vec![0f32; self.architecture.parameter_count()];
        self.each(|range, at| {
            let count = range.len();
            values[range].copy_from_slice(&padded[at..at + count]);
        });
        values
    }

    /// Records the packing of every convolution's weights.
    pub fn record_pack(&self, rec: &mut Recorder) -> Result<()> {
        for conv in self.convs.iter().flatten() {
            conv2d::pack(&self.gpu, rec, self.family, conv.layer, &conv.weight, &conv.packed, false)?;
            if let Some(packed) = &conv.packed_transposed {
                conv2d::pack(&self.gpu, rec, self.family, conv.layer, &conv.weight, packed, true)?;
            }
            for (out, transposed) in [(&conv.winograd, false), (&conv.winograd_transposed, true)] {
                if let Some(out) = out {
                    let (layer, weight) = (conv.layer, &conv.weight);
                    winograd::transform_weights(&self.gpu, rec, self.family, layer, weight, out, transposed)?;
                }
            }
        }
        Ok(())
    }
}
