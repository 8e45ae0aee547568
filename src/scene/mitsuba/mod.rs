//! Mitsuba 3 XML: the subset that limpid renders, read and written.
//!
//! Read are: `sphere` (`center`, `radius`, `to_world` with uniform scale), `rectangle`, `disk` and `cube` (`to_world`
//! without shear), `obj` and `ply` (`filename`, `to_world`, `face_normals`, `flip_tex_coords`), each with `flip_normals` where it makes sense; the bsdfs `diffuse`, `conductor`, `roughconductor` (`ggx`,
//! one `alpha`), `dielectric`, `plastic` and `twosided` with one bsdf; colours as `rgb` or one `float`, the diffuse ones also as a
//! `checkerboard` or a `bitmap` (EXR, PNG, JPEG), each nested or by `ref`; the emitters `area`, `point`, `spot`, `directional`, `constant` and
//! `envmap`; one `perspective` or `thinlens` sensor (`fov`, `fov_axis`, `to_world`; `aperture_radius`, `focus_distance`) with an `hdrfilm` (`width`, `height`, `box` filter) and a `sampler` (`sample_count`); the
//! `path` integrator (`max_depth`); transforms of `lookat`, `rotate`, `translate`, `scale` and `matrix`; `default` and
//! `$name`; `include` of scene files, below `<scene>`. `near_clip`, `far_clip`, `rr_depth`, the sampler's kind and seed and
//! the film's file format make no difference and are passed over. Defaults are Mitsuba's (a missing material is grey 0.5, of an emitter black).
//! Anything else is an error that names file, line and element or, with [`Options::lenient`], left out and named in
//! [`Loaded::left_out`]. Files that a scene names are looked for in the folder of the scene's main file.

mod beside;
mod emitter;
mod files;
mod load;
mod material;
mod media;
mod meshes;
mod object;
mod picture;
mod sensor;
mod shape;
mod texture;
mod transform;
mod write;
mod xml;

pub use write::{Written, write, write_files};

use super::Loaded;
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// What may be set from outside the file.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Values for the file's `<default>` parameters, by name.
    pub parameters: BTreeMap<String, String>,
    /// Image width and height in place of the film's.
    pub size: Option<(u32, u32)>,
    /// What is not supported is left out and named in [`Loaded::left_out`], not refused: a property, a shape, an emitter; of
    /// a material the default, or the one that it wraps, takes the place. What is wrong is an error all the same.
    pub lenient: bool,
}

/// The largest scene file, bytes.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// Loads and validates a scene file.
pub fn load(path: impl AsRef<Path>, options: &Options) -> Result<Loaded> {
    let path = path.as_ref();
    let text = read_text(path, "scene")?;
    load_str(&text, &path.display().to_string(), options)
}

/// The text of a scene file; `what` it is, for messages.
fn read_text(path: &Path, what: &str) -> Result<String> {
    let shown = path.display();
    let metadata = std::fs::metadata(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Error::input(format!(
            "{what} '{shown}': no such file; give spheres, spheres:N, a Mitsuba 3 XML or a glTF file"
        )),
        _ => Error::io(path, error),
    })?;
    if metadata.is_dir() {
        return Err(Error::input(format!("{what} '{shown}' is a directory; give spheres, spheres:N or an XML file")));
    }
    if metadata.len() > MAX_FILE_BYTES {
        return Err(Error::input(format!("{shown}: scene files end at {MAX_FILE_BYTES} bytes")));
    }
    let bytes = std::fs::read(path).map_err(|error| Error::io(path, error))?;
    String::from_utf8(bytes)
        .map_err(|_| Error::input(format!("{shown}: not text in UTF-8; scene files are Mitsuba 3 XML")))
}

/// Loads and validates a scene from XML text; `file` is the name for messages, and its folder holds the files that the scene
/// names.
pub fn load_str(text: &str, file: &str, options: &Options) -> Result<Loaded> {
    load::load(text, file, options)
}
