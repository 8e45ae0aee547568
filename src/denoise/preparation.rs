//! What weights expect: which channels their network reads, and how radiance becomes its numbers and back.

use crate::named::named;
use crate::net::architecture::Architecture;
use crate::net::weights::Weights;
use crate::shared_constants::{TRANSFER_LOG1P, TRANSFER_PU};
use crate::{Error, Result};
use std::fmt::Display;

/// The channels that a network reads of a frame, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inputs {
    /// Radiance r, g, b; screen-space normal x, y; depth divided by the frame's largest.
    NormalScreenDepth,
    /// Radiance r, g, b; albedo r, g, b; world-space normal x, y, z, from [-1, 1] to [0, 1].
    AlbedoNormal,
}

impl Inputs {
    /// The metadata key.
    pub const KEY: &str = "inputs";
    /// The planes of a frame that hold them, radiance first, four floats a pixel each: what [`crate::render::Outputs`] calls
    /// so, and of what channels of a file each is made.
    #[must_use]
    pub const fn planes(self) -> &'static [(&'static str, [&'static str; 3])] {
        match self {
            Self::NormalScreenDepth => &[("radiance", ["R", "G", "B"]), ("screen", ["Nscreen.X", "Nscreen.Y", "Z"])],
            Self::AlbedoNormal => &[
                ("radiance", ["R", "G", "B"]),
                ("albedo", ["albedo.R", "albedo.G", "albedo.B"]),
                ("normal_world", ["N.X", "N.Y", "N.Z"]),
            ],
        }
    }

    /// How many channels they are.
    #[must_use]
    pub const fn channels(self) -> usize {
        match self {
            Self::NormalScreenDepth => 6,
            Self::AlbedoNormal => 9,
        }
    }
}

named!(
    Inputs,
    "inputs",
    NormalScreenDepth = "radiance,normal_screen.xy,depth",
    AlbedoNormal = "radiance,albedo,normal",
);

/// How radiance becomes the network's numbers, and back; the exposure belongs to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transfer {
    /// `ln(1 + exposure * radiance)`; the exposure brings the geometric mean of the luminance to 0.5.
    Log1p,
    /// Open Image Denoise's for HDR pictures: a perceptually uniform curve that is 1 at an exposed radiance of 65504; the
    /// exposure brings the geometric mean of the luminance to 0.18.
    Pu,
}

impl Transfer {
    /// The metadata key.
    pub const KEY: &str = "transfer";
    /// The shaders' number of it.
    #[must_use]
    pub const fn id(self) -> u32 {
        match self {
            Self::Log1p => TRANSFER_LOG1P,
            Self::Pu => TRANSFER_PU,
        }
    }
}

named!(Transfer, "transfer", Log1p = "log1p", Pu = "pu");

/// What is done to a frame before and after the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Preparation {
    /// The network's input.
    pub inputs: Inputs,
    /// How radiance is written in it.
    pub transfer: Transfer,
}

impl Preparation {
    /// What Open Image Denoise does to a frame with albedo and normals.
    pub const OPEN_IMAGE_DENOISE: Self = Self { inputs: Inputs::AlbedoNormal, transfer: Transfer::Pu };

    /// What limpid trains networks of an architecture with.
    pub fn of_architecture(architecture: &Architecture) -> Result<Self> {
        match architecture.input_channels() {
            6 => Ok(Self { inputs: Inputs::NormalScreenDepth, transfer: Transfer::Log1p }),
            9 => Ok(Self::OPEN_IMAGE_DENOISE),
            count => {
                Err(Error::input(format!("`{}` reads {count} channels: limpid makes 6 or 9", architecture.name())))
            }
        }
    }

    /// What the metadata of weights ask for; `file` names these in errors.
    pub fn of_weights(weights: &Weights, file: &str) -> Result<Self> {
        let inputs = choose(weights, file, Inputs::KEY, &Inputs::ALL)?;
        let transfer = choose(weights, file, Transfer::KEY, &Transfer::ALL)?;
        let (made, read) = (inputs.channels(), weights.architecture.input_channels());
        if made != read {
            return Err(Error::input(format!(
                "{file}: metadata `{}`: `{}` are {made} channels, but `{}` reads {read}",
                Inputs::KEY,
                inputs.name(),
                weights.architecture.name()
            )));
        }
        // Its first and last layers undo and do this transfer.
        if weights.architecture.name() == "kpn" && transfer != Transfer::Pu {
            return Err(Error::input(format!(
                "{file}: metadata `{}`: `kpn` takes `{}`, found `{transfer}`",
                Transfer::KEY,
                Transfer::Pu
            )));
        }
        Ok(Self { inputs, transfer })
    }

    /// The metadata that ask for it.
    #[must_use]
    pub fn metadata(self) -> [(String, String); 2] {
        [(Inputs::KEY, self.inputs.name()), (Transfer::KEY, self.transfer.name())]
            .map(|(k, v)| (k.to_owned(), v.to_owned()))
    }
}

/// The value of a metadata key, which must be one of `known`.
fn choose<T: Copy + Display>(weights: &Weights, file: &str, key: &str, known: &[T]) -> Result<T> {
    let found = weights.metadata.get(key).map_or("none", String::as_str);
    if let Some(value) = known.iter().find(|value| value.to_string() == found) {
        return Ok(*value);
    }
    let expected = known.iter().map(|value| format!("`{value}`")).collect::<Vec<_>>().join(" or ");
    Err(Error::input(format!("{file}: metadata `{key}`: expected {expected}, found `{found}`")))
}
