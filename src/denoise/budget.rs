//! Whether a frame is reconstructed as a whole or in tiles: what the user asked for, and what memory allows.

use super::Denoiser;
use super::network::Kernels;
use super::preparation::Inputs;
use super::tiled::TiledDenoiser;
use super::tiles::Tiling;
use crate::gpu::{DeviceInfo, Footprint};
use crate::net::architecture::Architecture;
use crate::net::plan::TileRules;
use crate::{Error, Result};

const MIB: u64 = 1 << 20;

/// What the user asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Demand {
    /// Side of a tile's core, pixels.
    pub tile: Option<u32>,
    /// Most bytes of all buffers of the reconstruction.
    pub max_bytes: Option<u64>,
}

/// Tiles with an overlap of the user's choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overlapping {
    /// Side of a tile's core, pixels.
    pub core: u32,
    /// Pixels that windows reach beyond each side of it; fewer than the exact overlap make an approximate result.
    pub overlap: u32,
    /// Whether results are interpolated across the overlap.
    pub blend: bool,
}

/// What decides how much memory a reconstruction takes.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// The device.
    pub info: &'a DeviceInfo,
    /// The network.
    pub architecture: &'a Architecture,
    /// What it reads.
    pub inputs: Inputs,
    /// Its kernels.
    pub kernels: Kernels,
    /// Width and height of the frame, pixels.
    pub size: (u32, u32),
    /// Whether the frame lies on the device already; as a whole it then needs no buffers of its own.
    pub resident: bool,
}

/// How a frame will be reconstructed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Its tiles.
    pub tiling: Tiling,
    /// Bytes of all buffers.
    pub bytes: u64,
}

impl Task<'_> {
    /// The memory that a tiling takes.
    #[must_use]
    pub fn footprint(&self, tiling: &Tiling) -> Footprint {
        if self.resident && tiling.count() == 1 {
            Denoiser::footprint(self.architecture, self.kernels, self.size)
        } else {
            TiledDenoiser::footprint(self.architecture, self.inputs, self.kernels, tiling)
        }
    }

    /// The tiling asked for, or the largest windows that fit. An error names the number that would do.
    pub fn choose(&self, demand: &Demand) -> Result<Choice> {
        match demand.tile {
            Some(core) => self.check(core, demand, |core, rules| Tiling::cores(self.size, core, rules)),
            None => self.largest(demand),
        }
    }

    /// The tiling asked for. An error names the number that would do.
    pub fn choose_overlapping(&self, tiles: &Overlapping) -> Result<Choice> {
        let Overlapping { core, overlap, blend } = *tiles;
        if blend && overlap == 0 {
            return Err(Error::input("--blend with --overlap 0: nothing to blend across; e.g. --overlap 32 would do"));
        }
        let cut = |core, rules: &_| Tiling::overlapping(self.size, core, (overlap, blend), rules);
        self.check(core, &Demand::default(), cut)
    }

    fn check(&self, core: u32, demand: &Demand, cut: impl Fn(u32, &TileRules) -> Tiling) -> Result<Choice> {
        let rules = self.kernels.tile_rules(self.architecture);
        check_core(core, rules.step, self.architecture.name())?;
        let tiling = cut(core, &rules);
        let footprint = self.footprint(&tiling);
        let bytes = footprint.bytes;
        let limit = if !footprint.within_limits(self.info) {
            format!("{} allows", self.info.name)
        } else if let Some(most) = demand.max_bytes.filter(|most| bytes > *most) {
            format!("--max-memory {} allows", most / MIB)
        } else {
            return Ok(Choice { tiling, bytes });
        };
        let fits = |core: u32| {
            let footprint = self.footprint(&cut(core, &rules));
            footprint.within_limits(self.info) && demand.max_bytes.is_none_or(|most| footprint.bytes <= most)
        };
        let smaller = (1..core / rules.step).rev().map(|steps| steps * rules.step).find(|core| fits(*core));
        let mend = match smaller {
            Some(core) => format!("--tile {core} would do"),
            None => format!("no tile is small enough: --max-memory {} would do", bytes.div_ceil(MIB)),
        };
        Err(Error::input(format!("--tile {core} needs {} MiB, more than {limit}: {mend}", bytes.div_ceil(MIB))))
    }

    fn largest(&self, demand: &Demand) -> Result<Choice> {
        let rules = self.kernels.tile_rules(self.architecture);
        let most = demand.max_bytes.unwrap_or(self.info.memory_bytes / 4 * 3);
        let mut least = u64::MAX;
        for tiling in Tiling::candidates(self.size, rules) {
            let footprint = self.footprint(&tiling);
            let possible = footprint.within_limits(self.info);
            if possible && footprint.bytes <= most {
                return Ok(Choice { tiling, bytes: footprint.bytes });
            }
            if possible {
                least = least.min(footprint.bytes);
            }
        }
        let (width, height) = self.size;
        Err(Error::input(match least {
            u64::MAX => format!("{} cannot hold the smallest tile of {width}x{height} pixels", self.info.name),
            least => format!(
                "reconstruction of {width}x{height} pixels in {} MiB: the smallest tile needs --max-memory {}",
                most / MIB,
                least.div_ceil(MIB)
            ),
        }))
    }
}

/// Refuses a core that does not lie on the grid.
pub fn check_core(core: u32, step: u32, architecture: &str) -> Result<()> {
    if core > 0 && core.is_multiple_of(step) {
        return Ok(());
    }
    let above = core.saturating_add(1).next_multiple_of(step);
    let near = if core < step { above.to_string() } else { format!("{} or {above}", core / step * step) };
    Err(Error::input(format!("--tile {core}: `{architecture}` needs a multiple of {step}, e.g. {near}")))
}
