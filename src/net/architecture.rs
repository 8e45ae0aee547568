//! Architectures: short lists of named nodes, and what follows from a list (shapes, cost, receptive field).

use super::base::{INPUT_CHANNELS, Widths};
use super::layer::kernel_filter;
use crate::{Error, Result};
use std::ops::Range;

/// The place of a node in [`Architecture::nodes`]; inputs come before their users.
pub type NodeId = usize;

/// What a node computes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Op {
    /// The network's input, (N, channels, H, W).
    Input {
        /// Channels.
        channels: usize,
    },
    /// A 3x3 convolution with bias, then leaky ReLU with `slope`, or nothing where `slope` is none.
    Conv {
        /// Channels in.
        cin: usize,
        /// Channels out.
        cout: usize,
        /// The slope of the leaky ReLU; none for a linear layer.
        slope: Option<f32>,
    },
    /// 2x2 max pooling.
    MaxPool,
    /// Nearest 2x upsampling.
    Upsample,
    /// The channels of the first input, then those of the second.
    Concat,
    /// Radiance without texture, and what is inside the picture, of the network's input: [`demodulate`](super::layer::demodulate).
    Demodulate,
    /// 2x2 mean of what is inside the picture: [`masked_pool2d`](super::layer::masked_pool2d).
    MaskedPool,
    /// The weighted means that the first input, logits, makes of the second, noisy pixels, and the third, where there is one, the
    /// coarser level: [`kernel_filter`].
    KernelFilter,
    /// The first input with the texture of the second, the network's input, in the space of the network's output.
    Modulate,
}

/// One node of an architecture.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Unique; for a convolution the stem of its keys in a weights file.
    pub name: String,
    /// What it computes.
    pub op: Op,
    /// What it computes that from.
    pub inputs: Vec<NodeId>,
    /// Channels of its value.
    pub channels: usize,
    /// Its value is `2^level` times smaller than the input in both directions.
    pub level: usize,
    /// Where a convolution's parameters lie in the flat parameter vector.
    pub parameters: Option<ConvParameters>,
}

impl Node {
    /// The inputs that have a gradient: nothing before the noisy pixels of a filter has parameters.
    #[must_use]
    pub fn differentiated(&self) -> Vec<NodeId> {
        match self.op {
            Op::Input { .. } | Op::Demodulate | Op::MaskedPool => Vec::new(),
            Op::Conv { .. } | Op::MaxPool | Op::Upsample | Op::Concat => self.inputs.clone(),
            Op::KernelFilter => {
                self.inputs.iter().copied().enumerate().filter(|(i, _)| *i != 1).map(|(_, id)| id).collect()
            }
            Op::Modulate => self.inputs[..1].to_vec(),
        }
    }
}

/// The parameters of one convolution within the flat parameter vector.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvParameters {
    /// The weights, OIHW.
    pub weight: Range<usize>,
    /// The bias, one for each channel out; follows the weights.
    pub bias: Range<usize>,
}

/// One tensor of a weights file.
#[derive(Clone, Debug, PartialEq)]
pub struct TensorSpec {
    /// The key: `NODE.weight` or `NODE.bias`.
    pub name: String,
    /// `[Cout, Cin, 3, 3]` or `[Cout]`.
    pub shape: Vec<usize>,
    /// Where it lies in the flat parameter vector.
    pub range: Range<usize>,
}

/// A network: its nodes in the order of computation. The last one is the output.
#[derive(Clone, Debug, PartialEq)]
pub struct Architecture {
    name: String,
    nodes: Vec<Node>,
}

/// Whether a filter takes these.
fn is_filter(logits: &Node, fine: &Node, coarse: Option<&Node>) -> bool {
    logits.channels == kernel_filter::logits(coarse.is_some())
        && (fine.channels, fine.level) == (4, logits.level)
        && coarse.is_none_or(|coarse| (coarse.channels, coarse.level) == (4, logits.level + 1))
}

/// A node of a list: its name, what it computes, the names of its inputs.
pub type Row<'a> = (&'a str, Op, &'a [&'a str]);

/// The names that [`Architecture::named`] knows.
pub const NAMES: &[&str] = &["seed", "base", "kpn"];

/// The U-Net of Chaitanya et al. 2017 without its recurrent blocks, with 6 inputs: radiance r, g, b, screen-space normal x,
/// y, depth. A skip is the value of the last convolution before a pooling; it comes second in the concatenation, after
/// the upsampled value (PyTorch: `cat([upsampled, skip], 1)`).
const SEED: &[Row] = &[
    ("input", Op::Input { channels: 6 }, &[]),
    ("enc_conv1a", conv(6, 32), &["input"]),
    ("enc_conv1b", conv(32, 32), &["enc_conv1a"]),
    ("pool1", Op::MaxPool, &["enc_conv1b"]),
    ("enc_conv2", conv(32, 43), &["pool1"]),
    ("pool2", Op::MaxPool, &["enc_conv2"]),
    ("enc_conv3", conv(43, 57), &["pool2"]),
    ("pool3", Op::MaxPool, &["enc_conv3"]),
    ("enc_conv4", conv(57, 76), &["pool3"]),
    ("pool4", Op::MaxPool, &["enc_conv4"]),
    ("enc_conv5", conv(76, 101), &["pool4"]),
    ("pool5", Op::MaxPool, &["enc_conv5"]),
    ("bottleneck", conv(101, 101), &["pool5"]),
    ("upsample5", Op::Upsample, &["bottleneck"]),
    ("concat5", Op::Concat, &["upsample5", "enc_conv5"]),
    ("dec_conv5a", conv(202, 76), &["concat5"]),
    ("dec_conv5b", conv(76, 76), &["dec_conv5a"]),
    ("upsample4", Op::Upsample, &["dec_conv5b"]),
    ("concat4", Op::Concat, &["upsample4", "enc_conv4"]),
    ("dec_conv4a", conv(152, 57), &["concat4"]),
    ("dec_conv4b", conv(57, 57), &["dec_conv4a"]),
    ("upsample3", Op::Upsample, &["dec_conv4b"]),
    ("concat3", Op::Concat, &["upsample3", "enc_conv3"]),
    ("dec_conv3a", conv(114, 43), &["concat3"]),
    ("dec_conv3b", conv(43, 43), &["dec_conv3a"]),
    ("upsample2", Op::Upsample, &["dec_conv3b"]),
    ("concat2", Op::Concat, &["upsample2", "enc_conv2"]),
    ("dec_conv2a", conv(86, 32), &["concat2"]),
    ("dec_conv2b", conv(32, 32), &["dec_conv2a"]),
    ("upsample1", Op::Upsample, &["dec_conv2b"]),
    ("concat1", Op::Concat, &["upsample1", "enc_conv1b"]),
    ("dec_conv1a", conv(64, 128), &["concat1"]),
    ("dec_conv1b", conv(128, 64), &["dec_conv1a"]),
    ("out_conv", Op::Conv { cin: 64, cout: 3, slope: None }, &["dec_conv1b"]),
];

/// A convolution with the leaky ReLU of slope 0.1 that all but the last one have.
const fn conv(cin: usize, cout: usize) -> Op {
    Op::Conv { cin, cout, slope: Some(0.1) }
}

impl Architecture {
    /// The architecture `seed`.
    pub fn seed() -> Self {
        Self::from_rows("seed", SEED).expect("the list is right: a test builds it")
    }

    /// The architecture of that name, one of [`NAMES`]; `base` and `kpn` may be followed by a colon and their widths.
    pub fn named(name: &str) -> Result<Self> {
        match name.split_once(':') {
            None if name == "seed" => Ok(Self::seed()),
            None if name == "base" => Self::base(&Widths::default()),
            None if name == "kpn" => Self::kpn(&Widths::default()),
            Some(("base", widths)) => Self::base(&widths.parse()?),
            Some(("kpn", widths)) => Self::kpn(&widths.parse()?),
            _ => Err(Error::input(format!("unknown architecture `{name}`: limpid knows {}", NAMES.join(", ")))),
        }
    }

    /// An architecture from a list; an input error says which row does not fit and why.
    ///
    /// The first row, and no other, is the input. The last row is the output, as large as the input.
    pub fn from_rows(name: &str, rows: &[Row]) -> Result<Self> {
        let mut built = Self { name: name.to_owned(), nodes: Vec::with_capacity(rows.len()) };
        let mut offset = 0;
        for &row in rows {
            let node =
                built.resolve(row, offset).map_err(|e| Error::input(format!("{name}: node `{}`: {e}", row.0)))?;
            offset = node.parameters.as_ref().map_or(offset, |p| p.bias.end);
            built.nodes.push(node);
        }
        match built.nodes.last() {
            Some(last) if last.level == 0 => Ok(built),
            _ => Err(Error::input(format!("{name}: the last node must have the input's size"))),
        }
    }

    /// The node of one row, its parameters beginning at `offset`.
    fn resolve(&self, (name, op, from): Row, offset: usize) -> std::result::Result<Node, String> {
        if self.find(name).is_some() {
            return Err("the name is taken".into());
        }
        if matches!(op, Op::Input { .. }) != self.nodes.is_empty() {
            return Err("the first node, and no other, is the input".into());
        }
        let find = |from: &&str| self.find(from).ok_or_else(|| format!("there is no `{from}` before it"));
        let inputs = from.iter().map(find).collect::<std::result::Result<Vec<_>, _>>()?;
        let sources: Vec<&Node> = inputs.iter().map(|&i| &self.nodes[i]).collect();
        let mut parameters = None;
        let (channels, level) = match (op, &sources[..]) {
            (Op::Input { channels }, []) => (channels, 0),
            (Op::Conv { cin, cout, .. }, [x]) if cin == x.channels => {
                let weight = offset..offset + cout * cin * 9;
                parameters = Some(ConvParameters { bias: weight.end..weight.end + cout, weight });
                (cout, x.level)
            }
            (Op::Conv { cin, .. }, [x]) => return Err(format!("takes {cin} channels, but is given {}", x.channels)),
            (Op::MaxPool, [x]) => (x.channels, x.level + 1),
            (Op::Upsample, [x]) => (x.channels, x.level.checked_sub(1).ok_or("would be larger than the input")?),
            (Op::Concat, [a, b]) if a.level == b.level => (a.channels + b.channels, a.level),
            (Op::Concat, [_, _]) => return Err("its inputs differ in size".into()),
            (Op::Demodulate, [x]) if x.channels == INPUT_CHANNELS => (4, x.level),
            (Op::MaskedPool, [x]) if x.channels == 4 => (4, x.level + 1),
            (Op::KernelFilter, [logits, fine]) if is_filter(logits, fine, None) => (4, logits.level),
            (Op::KernelFilter, [logits, fine, coarse]) if is_filter(logits, fine, Some(coarse)) => (4, logits.level),
            (Op::Modulate, [x, input])
                if (x.channels, input.channels) == (4, INPUT_CHANNELS) && x.level == input.level =>
            {
                (3, x.level)
            }
            (Op::Demodulate | Op::MaskedPool | Op::KernelFilter | Op::Modulate, _) => {
                return Err("its inputs have other channels or sizes than it takes".into());
            }
            _ => return Err(format!("has {} inputs", sources.len())),
        };
        Ok(Node { name: name.to_owned(), op, inputs, channels, level, parameters })
    }

    fn find(&self, name: &str) -> Option<NodeId> {
        self.nodes.iter().position(|node| node.name == name)
    }

    /// The name that weights files carry.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The nodes in the order of computation.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The node of that name.
    pub fn node(&self, name: &str) -> Option<&Node> {
        self.find(name).map(|id| &self.nodes[id])
    }

    /// Channels of the input.
    pub fn input_channels(&self) -> usize {
        self.nodes[0].channels
    }

    /// Channels of the output.
    pub fn output_channels(&self) -> usize {
        self.nodes[self.nodes.len() - 1].channels
    }

    /// The tensors of a weights file in the order of the flat parameter vector, which they fill without gaps.
    pub fn tensors(&self) -> Vec<TensorSpec> {
        let mut all = Vec::new();
        for node in &self.nodes {
            if let (Op::Conv { cin, cout, .. }, Some(ConvParameters { weight, bias })) = (node.op, &node.parameters) {
                let spec = |part: &str, shape, range: &Range<usize>| TensorSpec {
                    name: format!("{}.{part}", node.name),
                    shape,
                    range: range.clone(),
                };
                all.push(spec("weight", vec![cout, cin, 3, 3], weight));
                all.push(spec("bias", vec![cout], bias));
            }
        }
        all
    }

    /// The length of the flat parameter vector.
    pub fn parameter_count(&self) -> usize {
        self.nodes.iter().filter_map(|node| node.parameters.as_ref()).map(|p| p.bias.end).max().unwrap_or(0)
    }

    /// For every parameter, how large it is beside others in training: the factor of its initial value and of its learning
    /// rate. 1 but in `base`, where what reads radiance has 4 and what gives it 1/4.
    #[must_use]
    pub fn parameter_scales(&self) -> Vec<f32> {
        let mut scales = vec![1.0; self.parameter_count()];
        if self.name != "seed" {
            for TensorSpec { name, shape, range } in self.tensors() {
                super::base::training_scales(&name, &shape, &mut scales[range]);
            }
        }
        scales
    }

    /// Multiply-accumulates of one forward pass, for each pixel of the input.
    pub fn macs_per_pixel(&self) -> f64 {
        let weights = |node: &Node| node.parameters.as_ref().map_or(0, |p| p.weight.len()) as f64;
        self.nodes.iter().map(|node| weights(node) / f64::powi(4.0, node.level as i32)).sum()
    }

    /// Height and width of the input must be multiples of this.
    pub fn alignment(&self) -> usize {
        1 << self.nodes.iter().map(|node| node.level).max().unwrap_or(0)
    }

    /// A size, rounded up to the alignment.
    pub fn padded(&self, size: usize) -> usize {
        size.next_multiple_of(self.alignment())
    }

    /// The width in pixels of the input region that one output pixel can depend on.
    pub fn receptive_field(&self) -> usize {
        let mut fields: Vec<usize> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let widest = node.inputs.iter().map(|&i| fields[i]).max().unwrap_or(1);
            // The distance, in input pixels, of neighbouring elements of the node's input.
            let step = node.inputs.first().map_or(1, |&i| 1 << self.nodes[i].level);
            fields.push(match node.op {
                Op::Input { .. } | Op::Upsample | Op::Concat | Op::Demodulate | Op::Modulate => widest,
                Op::Conv { .. } => widest + 2 * step,
                Op::MaxPool | Op::MaskedPool => widest + step,
                // 2 pixels to either side, or 1 of the coarser level.
                Op::KernelFilter => widest + 4 * step,
            });
        }
        fields[fields.len() - 1]
    }

    /// How many pixels a tile needs beyond each side of its core, for its core to have the values of the whole frame.
    ///
    /// Cores and tiles begin and end on the grid of [`alignment`](Self::alignment); then this is exact: at every node the
    /// region that the core depends on lies within the tile.
    pub fn tile_overlap(&self) -> usize {
        self.tile_overlap_in_blocks(|_| 1)
    }

    /// The same where a convolution's results are computed in blocks of `block(id)` x `block(id)` (a power of two), so that the
    /// rounding of each depends on all that its block reads. Cores and tiles begin on the grid of [`tile_step`](Self::tile_step).
    pub fn tile_overlap_in_blocks(&self, block: impl Fn(NodeId) -> usize) -> usize {
        // How far the core depends on elements below its first one, at each node in that node's elements. What it depends on
        // beyond its last one is as far: both ends lie on the grid.
        let mut reach = vec![0usize; self.nodes.len()];
        for (id, node) in self.nodes.iter().enumerate().rev() {
            for &input in &node.inputs {
                let needed = match node.op {
                    Op::Conv { .. } => reach[id].next_multiple_of(block(id)) + 1,
                    Op::MaxPool | Op::MaskedPool => 2 * reach[id],
                    Op::Upsample => reach[id].div_ceil(2),
                    Op::KernelFilter if self.nodes[input].level > node.level => reach[id].div_ceil(2) + 1,
                    Op::KernelFilter if Some(&input) == node.inputs.get(1) => reach[id] + 2,
                    Op::Input { .. } | Op::Concat | Op::Demodulate | Op::KernelFilter | Op::Modulate => reach[id],
                };
                reach[input] = reach[input].max(needed);
            }
        }
        let pixels = self.nodes.iter().zip(&reach).map(|(node, reach)| reach << node.level);
        pixels.max().unwrap_or(0).next_multiple_of(self.tile_step(block))
    }

    /// The grid, in pixels, on which tiles begin: of the alignment and of all blocks.
    pub fn tile_step(&self, block: impl Fn(NodeId) -> usize) -> usize {
        // Powers of two: the largest is a multiple of all.
        let blocks = self.nodes.iter().enumerate().map(|(id, node)| block(id) << node.level);
        blocks.max().unwrap_or(1).max(self.alignment())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seed_has_the_published_figures() {
        let seed = Architecture::seed();
        assert_eq!(seed.parameter_count(), 787_617);
        assert_eq!((seed.macs_per_pixel() / 100.0).round(), 1803.0);
        assert_eq!(seed.alignment(), 32);
        assert_eq!(seed.receptive_field(), 286);
        assert_eq!(seed.tile_overlap(), 128);
        assert_eq!(seed.tile_step(|_| 1), 32);
        assert_eq!((seed.input_channels(), seed.output_channels()), (6, 3));
        assert_eq!((seed.padded(1), seed.padded(768), seed.padded(769)), (32, 768, 800));
    }

    /// By hand for `seed`: two convolutions at full size in blocks of 4 and one at half size.
    #[test]
    fn blocks_widen_the_overlap() {
        let seed = Architecture::seed();
        let blocks = |names: &'static [&'static str]| {
            let nodes = seed.nodes().to_vec();
            move |id: NodeId| if names.contains(&nodes[id].name.as_str()) { 4 } else { 1 }
        };
        let fast = blocks(&["dec_conv1a", "dec_conv1b", "dec_conv2a"]);
        assert_eq!((seed.tile_overlap_in_blocks(&fast), seed.tile_step(&fast)), (160, 32));
        // 4 elements of the last level are 128 pixels.
        let deep = blocks(&["bottleneck"]);
        assert_eq!((seed.tile_overlap_in_blocks(&deep), seed.tile_step(&deep)), (256, 128));
    }

    /// By hand for two filters and their logits by one convolution each.
    #[test]
    fn filters_reach_two_pixels_and_one_of_the_coarser_level() {
        let linear = |cout| Op::Conv { cin: 9, cout, slope: None };
        let rows: &[Row] = &[
            ("input", Op::Input { channels: 9 }, &[]),
            ("radiance0", Op::Demodulate, &["input"]),
            ("radiance1", Op::MaskedPool, &["radiance0"]),
            ("pool", Op::MaxPool, &["input"]),
            ("logits1", linear(25), &["pool"]),
            ("filter1", Op::KernelFilter, &["logits1", "radiance1"]),
            ("logits0", linear(34), &["input"]),
            ("filter0", Op::KernelFilter, &["logits0", "radiance0", "filter1"]),
            ("output", Op::Modulate, &["filter0", "input"]),
        ];
        // The last pixel reads one of filter1, that reads 2 further of radiance1: 3 of these are 6 pixels.
        assert_eq!(Architecture::from_rows("filters", rows).unwrap().tile_overlap(), 6);
        let fine: &[Row] = &[
            rows[0],
            rows[1],
            ("logits0", linear(25), &["input"]),
            ("filter0", Op::KernelFilter, &["logits0", "radiance0"]),
            rows[8],
        ];
        assert_eq!(Architecture::from_rows("filter", fine).unwrap().tile_overlap(), 2);
    }

    #[test]
    fn seed_has_18_convolutions_and_only_the_last_is_linear() {
        let seed = Architecture::seed();
        let slopes: Vec<_> = seed
            .nodes()
            .iter()
            .filter_map(|n| if let Op::Conv { slope, .. } = n.op { Some(slope) } else { None })
            .collect();
        assert_eq!(slopes.len(), 18);
        assert!(slopes[..17].iter().all(|&slope| slope == Some(0.1)));
        assert_eq!(slopes[17], None);
    }

    #[test]
    fn tensors_fill_the_parameters_without_gaps() {
        let seed = Architecture::seed();
        let mut end = 0;
        for spec in seed.tensors() {
            assert_eq!(spec.range.start, end, "{}", spec.name);
            assert_eq!(spec.range.len(), spec.shape.iter().product::<usize>(), "{}", spec.name);
            end = spec.range.end;
        }
        assert_eq!(end, seed.parameter_count());
    }

    #[test]
    fn every_name_builds_under_its_name() {
        for name in NAMES {
            assert_eq!(Architecture::named(name).unwrap().name(), *name);
        }
        assert!(Architecture::named("sead").unwrap_err().to_string().contains("seed"));
    }

    #[test]
    fn a_row_that_does_not_fit_is_named() {
        let input: Row = ("input", Op::Input { channels: 6 }, &[]);
        for (rows, what) in [
            (vec![input, ("a", conv(7, 3), &["input"][..])], "`a`: takes 7 channels, but is given 6"),
            (vec![input, ("a", conv(6, 3), &["b"])], "`a`: there is no `b` before it"),
            (vec![input, ("input", conv(6, 3), &["input"])], "`input`: the name is taken"),
            (vec![input, ("a", Op::Upsample, &["input"])], "`a`: would be larger"),
            (vec![input, ("a", Op::MaxPool, &["input"])], "last node"),
            (vec![input, ("a", Op::MaxPool, &["input"]), ("b", Op::Concat, &["a", "input"])], "`b`: its inputs differ"),
            (vec![input, ("a", Op::Concat, &["input"])], "`a`: has 1 inputs"),
            (vec![input, ("a", Op::Demodulate, &["input"])], "`a`: its inputs have other channels or sizes"),
            (vec![input, ("a", Op::KernelFilter, &["input", "input"])], "`a`: its inputs have other channels or sizes"),
            (vec![("a", conv(6, 3), &[])], "`a`: the first node"),
            (vec![], "last node"),
        ] {
            let message = Architecture::from_rows("test", &rows).unwrap_err().to_string();
            assert!(message.contains(what), "{message}");
        }
    }
}
