//! How much device memory a reconstruction may take, and in what tiles.

use limpid::Result;
use limpid::denoise::{Choice, Demand, Overlapping, Task};

/// The flags of every command that reconstructs.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct TileArgs {
    /// Reconstruct in tiles of N x N pixels and what they need around them; the bits are those of the whole frame
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub tile: Option<u32>,
    /// Show the tiles only K pixels of the frame beyond each side (more where the network's grid asks for it); fewer than the
    /// exact overlap (128 or more for `seed`) make an APPROXIMATE result, with seams where tiles meet. 0 cuts the frame into chunks that know nothing of each other
    #[arg(long, value_name = "K", requires = "tile", conflicts_with = "max_memory")]
    #[arg(value_parser = clap::value_parser!(u32).range(..=16384))]
    pub overlap: Option<u32>,
    /// Interpolate between the results of overlapping tiles, with linear weights across the overlap; the result is approximate
    #[arg(long, requires = "overlap")]
    pub blend: bool,
    /// Device memory of the reconstruction at most; picks the whole frame or the largest tiles that fit [default: three quarters
    /// of the device's]
    #[arg(long, value_name = "MiB", value_parser = clap::value_parser!(u64).range(1..=1 << 32))]
    pub max_memory: Option<u64>,
}

/// What decides how a frame is cut.
#[derive(Clone, Copy, Debug)]
pub enum Cut {
    /// The bits are those of the whole frame.
    Exact(Demand),
    /// With an overlap that was given.
    Overlapping(Overlapping),
}

impl Cut {
    /// The tiling for a task; an error where nothing fits.
    pub fn choose(&self, task: &Task) -> Result<Choice> {
        match self {
            Self::Exact(demand) => task.choose(demand),
            Self::Overlapping(tiles) => task.choose_overlapping(tiles),
        }
    }
}

impl TileArgs {
    /// What they ask for.
    pub fn cut(&self) -> Cut {
        match (self.tile, self.overlap) {
            (Some(core), Some(overlap)) => Cut::Overlapping(Overlapping { core, overlap, blend: self.blend }),
            _ => Cut::Exact(Demand { tile: self.tile, max_bytes: self.max_memory.map(|mib| mib << 20) }),
        }
    }

    /// Whether any is given.
    pub fn any(&self) -> bool {
        self.tile.is_some() || self.max_memory.is_some()
    }
}
