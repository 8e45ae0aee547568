//! The architecture `base`, the U-Net of Open Image Denoise, its tensor names included, with free widths; and `kpn`, which predicts
//! kernels with it.

use super::architecture::{Architecture, Op, Row};
use super::layer::kernel_filter;
use crate::{Error, Result};

/// Channels of the input: radiance, albedo and normal, three each.
pub const INPUT_CHANNELS: usize = 9;

/// Channels out of the convolutions of `base` and `kpn`, each a multiple of 16, at most 1024.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Widths {
    /// `enc_conv0`, `enc_conv1`.
    pub enc1: usize,
    /// `enc_conv2`.
    pub enc2: usize,
    /// `enc_conv3`.
    pub enc3: usize,
    /// `enc_conv4`.
    pub enc4: usize,
    /// `enc_conv5a`, `enc_conv5b`.
    pub enc5: usize,
    /// `dec_conv4a`, `dec_conv4b`.
    pub dec4: usize,
    /// `dec_conv3a`, `dec_conv3b`.
    pub dec3: usize,
    /// `dec_conv2a`.
    pub dec2a: usize,
    /// `dec_conv2b`.
    pub dec2b: usize,
    /// `dec_conv1a`.
    pub dec1a: usize,
    /// `dec_conv1b`.
    pub dec1b: usize,
}

/// The convolution that each width is read from, in the order of [`Widths::to_array`].
const NAMED_BY: [&str; 11] = [
    "enc_conv0",
    "enc_conv2",
    "enc_conv3",
    "enc_conv4",
    "enc_conv5a",
    "dec_conv4a",
    "dec_conv3a",
    "dec_conv2a",
    "dec_conv2b",
    "dec_conv1a",
    "dec_conv1b",
];

/// Channels of the radiance, the first of the input.
const RADIANCE: usize = 3;

/// Training treats the network as one of radiance in units this many times as large: a power of two, so that no bit is lost.
/// The transfer `pu` makes small numbers of common radiance (0.1 to 0.4, noise in the second decimal), beside which Adam's
/// steps of equal size are large.
const TRAINING_GAIN: f32 = 4.0;

/// [`Architecture::parameter_scales`] of one tensor.
pub(super) fn training_scales(tensor: &str, shape: &[usize], scales: &mut [f32]) {
    let first = match tensor {
        "enc_conv0.weight" => 0,
        "dec_conv1a.weight" => shape[1] - INPUT_CHANNELS,
        "dec_conv0.weight" | "dec_conv0.bias" => return scales.fill(1.0 / TRAINING_GAIN),
        _ => return,
    };
    for output in scales.chunks_mut(shape[1] * 9) {
        output[first * 9..(first + RADIANCE) * 9].fill(TRAINING_GAIN);
    }
}

const MULTIPLE: usize = 16;
const LARGEST: usize = 1024;

impl Default for Widths {
    /// The widths that limpid trains: 59.9 kMAC a pixel, half of it at full size.
    fn default() -> Self {
        Self::from_array([32, 48, 64, 80, 96, 96, 64, 48, 32, 32, 16])
    }
}

impl Widths {
    /// The widths of Open Image Denoise's network of the same name.
    #[must_use]
    pub const fn open_image_denoise() -> Self {
        Self::from_array([32, 48, 64, 80, 96, 112, 96, 64, 64, 64, 32])
    }

    /// Widths in the order of the fields.
    #[must_use]
    pub const fn from_array(widths: [usize; 11]) -> Self {
        let [enc1, enc2, enc3, enc4, enc5, dec4, dec3, dec2a, dec2b, dec1a, dec1b] = widths;
        Self { enc1, enc2, enc3, enc4, enc5, dec4, dec3, dec2a, dec2b, dec1a, dec1b }
    }

    /// The widths in the order of the fields.
    #[must_use]
    pub const fn to_array(self) -> [usize; 11] {
        let Self { enc1, enc2, enc3, enc4, enc5, dec4, dec3, dec2a, dec2b, dec1a, dec1b } = self;
        [enc1, enc2, enc3, enc4, enc5, dec4, dec3, dec2a, dec2b, dec1a, dec1b]
    }

    /// The widths of a network whose convolutions have `channels_out(NAME)` channels out; the error names what is missing.
    pub fn read(channels_out: impl Fn(&str) -> Option<usize>) -> Result<Self> {
        let mut widths = [0; 11];
        for (width, name) in widths.iter_mut().zip(NAMED_BY) {
            let missing = || Error::input(format!("tensor `{name}.weight`: expected F32 of 4 dimensions, found none"));
            *width = channels_out(name).ok_or_else(missing)?;
        }
        let widths = Self::from_array(widths);
        widths.check()?;
        Ok(widths)
    }

    fn check(self) -> Result<()> {
        for (width, name) in self.to_array().into_iter().zip(NAMED_BY) {
            if width == 0 || !width.is_multiple_of(MULTIPLE) || width > LARGEST {
                return Err(Error::input(format!(
                    "`{name}` has {width} channels out: `base` takes multiples of {MULTIPLE} up to {LARGEST}"
                )));
            }
        }
        Ok(())
    }
}

impl std::str::FromStr for Widths {
    type Err = Error;

    /// Eleven numbers with commas between them, in the order of the fields.
    fn from_str(text: &str) -> Result<Self> {
        let numbers: Option<Vec<usize>> = text.split(',').map(|number| number.parse().ok()).collect();
        let Some(Ok(widths)) = numbers.map(<[usize; 11]>::try_from) else {
            return Err(Error::input(format!(
                "widths `{text}`: write 11 numbers, one each for {}",
                NAMED_BY.join(", ")
            )));
        };
        let widths = Self::from_array(widths);
        widths.check()?;
        Ok(widths)
    }
}

impl std::fmt::Display for Widths {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(&self.to_array().map(|width| width.to_string()).join(","))
    }
}

/// A convolution without an activation.
const fn linear(cin: usize, cout: usize) -> Op {
    Op::Conv { cin, cout, slope: None }
}

/// The layers of `base` but the last.
fn trunk(w: &Widths) -> Result<[Row<'static>; 28]> {
    w.check()?;
    let conv = |cin, cout| Op::Conv { cin, cout, slope: Some(0.0) };
    Ok([
        ("input", Op::Input { channels: INPUT_CHANNELS }, &[]),
        ("enc_conv0", conv(INPUT_CHANNELS, w.enc1), &["input"]),
        ("enc_conv1", conv(w.enc1, w.enc1), &["enc_conv0"]),
        ("pool1", Op::MaxPool, &["enc_conv1"]),
        ("enc_conv2", conv(w.enc1, w.enc2), &["pool1"]),
        ("pool2", Op::MaxPool, &["enc_conv2"]),
        ("enc_conv3", conv(w.enc2, w.enc3), &["pool2"]),
        ("pool3", Op::MaxPool, &["enc_conv3"]),
        ("enc_conv4", conv(w.enc3, w.enc4), &["pool3"]),
        ("pool4", Op::MaxPool, &["enc_conv4"]),
        ("enc_conv5a", conv(w.enc4, w.enc5), &["pool4"]),
        ("enc_conv5b", conv(w.enc5, w.enc5), &["enc_conv5a"]),
        ("upsample4", Op::Upsample, &["enc_conv5b"]),
        ("concat4", Op::Concat, &["upsample4", "pool3"]),
        ("dec_conv4a", conv(w.enc5 + w.enc3, w.dec4), &["concat4"]),
        ("dec_conv4b", conv(w.dec4, w.dec4), &["dec_conv4a"]),
        ("upsample3", Op::Upsample, &["dec_conv4b"]),
        ("concat3", Op::Concat, &["upsample3", "pool2"]),
        ("dec_conv3a", conv(w.dec4 + w.enc2, w.dec3), &["concat3"]),
        ("dec_conv3b", conv(w.dec3, w.dec3), &["dec_conv3a"]),
        ("upsample2", Op::Upsample, &["dec_conv3b"]),
        ("concat2", Op::Concat, &["upsample2", "pool1"]),
        ("dec_conv2a", conv(w.dec3 + w.enc1, w.dec2a), &["concat2"]),
        ("dec_conv2b", conv(w.dec2a, w.dec2b), &["dec_conv2a"]),
        ("upsample1", Op::Upsample, &["dec_conv2b"]),
        ("concat1", Op::Concat, &["upsample1", "input"]),
        ("dec_conv1a", conv(w.dec2b + INPUT_CHANNELS, w.dec1a), &["concat1"]),
        ("dec_conv1b", conv(w.dec1a, w.dec1b), &["dec_conv1a"]),
    ])
}

impl Architecture {
    /// The architecture `base`: four poolings; skips from the pooled values of three levels and from the input, each second
    /// in its concatenation; ReLU after all convolutions but the last.
    ///
    /// Open Image Denoise's runtime has a ReLU after the last one too, its trainer has none. Here it is linear: what is
    /// negative is cut off as it becomes radiance, so that the picture is the same, and in training a value that is cut
    /// off still has a gradient.
    pub fn base(widths: &Widths) -> Result<Self> {
        let mut rows = trunk(widths)?.to_vec();
        rows.push(("dec_conv0", linear(widths.dec1b, 3), &["dec_conv1b"]));
        Self::from_rows("base", &rows)
    }

    /// The architecture `kpn`, a kernel-predicting network (Vogels et al. 2018): the layers of [`base`](Self::base) but the last,
    /// and at each of its five levels a filter whose weights they give. It filters radiance without texture, from the coarsest level to
    /// the finest.
    pub fn kpn(widths: &Widths) -> Result<Self> {
        let w = widths;
        let (coarsest, others) = (kernel_filter::logits(false), kernel_filter::logits(true));
        let filters: [Row; 16] = [
            ("radiance0", Op::Demodulate, &["input"]),
            ("radiance1", Op::MaskedPool, &["radiance0"]),
            ("radiance2", Op::MaskedPool, &["radiance1"]),
            ("radiance3", Op::MaskedPool, &["radiance2"]),
            ("radiance4", Op::MaskedPool, &["radiance3"]),
            ("kernel_conv4", linear(w.enc5, coarsest), &["enc_conv5b"]),
            ("filter4", Op::KernelFilter, &["kernel_conv4", "radiance4"]),
            ("kernel_conv3", linear(w.dec4, others), &["dec_conv4b"]),
            ("filter3", Op::KernelFilter, &["kernel_conv3", "radiance3", "filter4"]),
            ("kernel_conv2", linear(w.dec3, others), &["dec_conv3b"]),
            ("filter2", Op::KernelFilter, &["kernel_conv2", "radiance2", "filter3"]),
            ("kernel_conv1", linear(w.dec2b, others), &["dec_conv2b"]),
            ("filter1", Op::KernelFilter, &["kernel_conv1", "radiance1", "filter2"]),
            ("kernel_conv0", linear(w.dec1b, others), &["dec_conv1b"]),
            ("filter0", Op::KernelFilter, &["kernel_conv0", "radiance0", "filter1"]),
            ("output", Op::Modulate, &["filter0", "input"]),
        ];
        Self::from_rows("kpn", &[&trunk(widths)?[..], &filters].concat())
    }

    /// What [`Architecture::named`] makes this architecture of: its name and, for a `base` or `kpn` of other than the default widths,
    /// these.
    #[must_use]
    pub fn specification(&self) -> String {
        let channels_out = |name: &str| self.node(name).map(|node| node.channels);
        match Widths::read(channels_out) {
            Ok(widths) if self.name() != "seed" && widths != Widths::default() => format!("{}:{widths}", self.name()),
            _ => self.name().to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_costs_at_most_60_kmac_a_pixel() {
        let base = Architecture::base(&Widths::default()).unwrap();
        assert!(base.macs_per_pixel() <= 60_000.0, "{}", base.macs_per_pixel());
        assert!(base.macs_per_pixel() > 59_000.0, "widths that leave much unused: {}", base.macs_per_pixel());
        assert_eq!((base.input_channels(), base.output_channels()), (9, 3));
    }

    /// Parameters, cost, receptive field and alignment as published for Open Image Denoise 2.
    #[test]
    fn the_original_has_the_published_figures() {
        let base = Architecture::base(&Widths::open_image_denoise()).unwrap();
        assert_eq!(base.parameter_count(), 919_811);
        assert_eq!((base.macs_per_pixel() / 100.0).round(), 1254.0);
        assert_eq!((base.receptive_field(), base.alignment()), (174, 16));
    }

    #[test]
    fn only_the_last_of_16_convolutions_is_linear() {
        let base = Architecture::base(&Widths::default()).unwrap();
        let slope = |op: Op| if let Op::Conv { slope, .. } = op { Some(slope) } else { None };
        let slopes: Vec<_> = base.nodes().iter().filter_map(|n| slope(n.op)).collect();
        assert_eq!(slopes.len(), 16);
        assert!(slopes[..15].iter().all(|&slope| slope == Some(0.0)));
        assert_eq!(slopes[15], None);
    }

    #[test]
    fn a_specification_makes_the_same_architecture() {
        for widths in [Widths::default(), Widths::open_image_denoise(), Widths::from_array([16; 11])] {
            let base = Architecture::base(&widths).unwrap();
            assert_eq!(Architecture::named(&base.specification()).unwrap(), base);
        }
        assert_eq!(Architecture::base(&Widths::default()).unwrap().specification(), "base");
        assert_eq!(Architecture::seed().specification(), "seed");
    }

    #[test]
    fn widths_that_do_not_fit_are_refused() {
        for (text, what) in [
            ("base:32", "11 numbers"),
            ("base:", "11 numbers"),
            ("base:a,b,c,d,e,f,g,h,i,j,k", "11 numbers"),
            ("base:16,16,16,16,16,16,16,16,16,16,20", "`dec_conv1b` has 20"),
            ("base:0,16,16,16,16,16,16,16,16,16,16", "`enc_conv0` has 0"),
            ("base:16,1040,16,16,16,16,16,16,16,16,16", "up to 1024"),
            ("seed:16", "unknown architecture"),
        ] {
            let message = Architecture::named(text).unwrap_err().to_string();
            assert!(message.contains(what), "{text}: {message}");
        }
    }
}
