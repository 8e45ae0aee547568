//! The files that a command makes, from the name of its EXR.

use limpid::image::{Image, exr, file, png};
use limpid::{Error, Result};
use std::path::{Path, PathBuf};

/// Where one picture goes.
#[derive(Clone, Debug)]
pub struct Files {
    /// All channels.
    pub exr: PathBuf,
    /// The picture.
    pub png: PathBuf,
    /// Noisy and reconstructed picture side by side.
    pub compare: PathBuf,
    /// The state of an unfinished render.
    pub checkpoint: PathBuf,
}

impl Files {
    /// The files beside `exr`, which must end so.
    pub fn new(exr: &Path) -> Result<Self> {
        let is_exr = exr.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr"));
        if !is_exr || exr.file_stem().is_none_or(|stem| stem.is_empty()) {
            return Err(Error::input(format!(
                "output '{}': limpid writes OpenEXR and puts the PNG beside it; give a name that ends in .exr",
                exr.display()
            )));
        }
        let mut checkpoint = exr.as_os_str().to_owned();
        checkpoint.push(".checkpoint");
        Ok(Self {
            exr: exr.to_owned(),
            png: exr.with_extension("png"),
            compare: exr.with_extension("compare.png"),
            checkpoint: checkpoint.into(),
        })
    }

    /// The files of frame `t`: `OUT.0007.exr` and so on.
    pub fn frame(&self, t: u32) -> Result<Self> {
        Self::new(&self.exr.with_extension(format!("{t:04}.exr")))
    }

    /// Checks that all of them can be written.
    pub fn writable(&self, compare: bool) -> Result<()> {
        let list = [&self.exr, &self.png, &self.checkpoint];
        list.into_iter().chain(compare.then_some(&self.compare)).try_for_each(file::writable)
    }

    /// Writes the picture, the comparison where there are noisy channels, and last the EXR, whose presence says that
    /// everything is there; the names of what was written.
    pub fn write(&self, image: &Image, exposure_ev: f32) -> Result<Vec<PathBuf>> {
        let mut written = vec![self.exr.clone(), self.png.clone()];
        let rgb = image.rgb("")?;
        png::write(&self.png, image.width, image.height, rgb, exposure_ev)?;
        if image.has_rgb("noisy") {
            png::write_compare(&self.compare, image.width, image.height, [image.rgb("noisy")?, rgb], exposure_ev)?;
            written.push(self.compare.clone());
        }
        exr::write(image, &self.exr)?;
        Ok(written)
    }
}

/// Reads an exposure in EV.
pub fn parse_exposure(text: &str) -> std::result::Result<f32, String> {
    match text.parse::<f32>() {
        Ok(ev) if ev.abs() <= 64.0 => Ok(ev),
        _ => Err("an exposure is a number of EV from -64 to 64".into()),
    }
}
