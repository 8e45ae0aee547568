//! How much device memory a reconstruction may take, and in what tiles.

use limpid::denoise::Demand;

/// The flags of every command that reconstructs.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct TileArgs {
    /// Reconstruct in tiles of N x N pixels and what they need around them; the bits are those of the whole frame
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub tile: Option<u32>,
    /// Device memory of the reconstruction at most; picks the whole frame or the largest tiles that fit [default: three quarters
    /// of the device's]
    #[arg(long, value_name = "MiB", value_parser = clap::value_parser!(u64).range(1..=1 << 32))]
    pub max_memory: Option<u64>,
}

impl TileArgs {
    /// What they ask for.
    pub fn demand(&self) -> Demand {
        Demand { tile: self.tile, max_bytes: self.max_memory.map(|mib| mib << 20) }
    }

    /// Whether either is given.
    pub fn any(&self) -> bool {
        self.tile.is_some() || self.max_memory.is_some()
    }
}
