//! The joint filter that reconstructions are measured against, on a picture that limpid rendered:
//!
//!     cargo run --release --example joint_filter -- IN.exr OUT.exr --radius 7
//!
//! R, G, B of OUT.exr are the noisy radiance of IN.exr, filtered; the other channels are as they were.

#[path = "../tests/common/joint_filter.rs"]
mod joint_filter;

use clap::Parser;
use limpid::image::exr;
use std::path::PathBuf;

/// Filter the noisy radiance of a picture: a box over demodulated radiance with normal and depth weights
#[derive(Parser)]
struct Args {
    /// Picture that `limpid render` wrote
    #[arg(value_name = "IN.exr")]
    input: PathBuf,
    /// EXR file to write
    #[arg(value_name = "OUT.exr")]
    output: PathBuf,
    /// Pixels to each side
    #[arg(long, value_name = "PIXELS", default_value_t = joint_filter::RADII[1], value_parser = radius)]
    radius: usize,
}

fn radius(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|radius| *radius <= 1024).ok_or_else(|| "write a number from 0 to 1024".to_owned())
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let mut image = exr::read(&args.input)?;
    let filtered = joint_filter::Picture::of(&image)?.filtered(args.radius);
    image.set_rgb("", filtered);
    exr::write(&image, &args.output)?;
    Ok(())
}
