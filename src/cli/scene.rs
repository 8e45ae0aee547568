//! `limpid scene`: a scene as Mitsuba 3 XML.

use super::report;
use limpid::image::file;
use limpid::scene::mitsuba;
use limpid::{Error, Result};
use std::path::PathBuf;

/// Write a scene as Mitsuba 3 XML
///
/// `limpid render` reads the file back to the same bits, and Mitsuba 3 renders it as it is. Meshes (PLY) and pictures out of glTF
/// files (EXR) go to files beside it.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// `spheres` (the canonical frame), `spheres:N`, `rooms:N` (scene N of a random family) or a Mitsuba 3 XML or glTF file
    #[arg(default_value = "spheres")]
    scene: String,
    /// XML file to write [default: standard output]
    #[arg(short, long, value_name = "OUT.xml")]
    output: Option<PathBuf>,
    /// Frame of the animation of `spheres:N`
    #[arg(long, value_name = "T")]
    frame: Option<u32>,
    /// Image size that the file states, e.g. 640x480
    #[arg(long, value_name = "WxH", value_parser = super::render::parse_size)]
    size: Option<(u32, u32)>,
    /// Leave out what of a scene file is not supported and name it, instead of refusing the file
    #[arg(long)]
    lenient: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    let spec: limpid::scene::Spec = args.scene.parse()?;
    let options = mitsuba::Options { size: args.size, lenient: args.lenient, ..mitsuba::Options::default() };
    let loaded = match args.frame {
        Some(t) => spec.load_frame(t, &options)?,
        None => spec.load(&options)?,
    };
    super::progress::left_out(&loaded.left_out);
    let Some(path) = &args.output else {
        let xml = mitsuba::write(&loaded.scene)
            .map_err(|error| Error::input(format!("{}: {error}; name an XML file with --output", args.scene)))?;
        report::print(xml.trim_end())?;
        return Ok(0);
    };
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let written = mitsuba::write_files(&loaded.scene, &stem)?;
    // The scene last: where it is, what it names is too.
    for (name, bytes) in &written.beside {
        file::write_bytes(path.with_file_name(name), bytes)?;
    }
    file::write_bytes(path, written.xml.as_bytes())?;
    Ok(0)
}
