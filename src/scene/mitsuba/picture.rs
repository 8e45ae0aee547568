//! Pictures beside the scene: EXR, PNG and JPEG.

use crate::image::{check_size, exr, png::srgb_decode};
use crate::scene::Picture;
use crate::{Error, Result};
use std::path::Path;

/// Reads a picture in linear RGB. Numbers of 8 and 16 bits are sRGB unless `raw`; grey counts for all three colours, alpha for none.
pub fn read(path: &Path, raw: bool) -> Result<Picture> {
    let is_exr = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    if is_exr { read_exr(path, raw) } else { read_integers(path, raw) }
}

fn read_exr(path: &Path, raw: bool) -> Result<Picture> {
    let image = exr::read(path)?;
    let plane = |name: &str| image.channels.get(name);
    let planes = match [plane("R"), plane("G"), plane("B"), plane("Y")] {
        [Some(r), Some(g), Some(b), _] => [r, g, b],
        [None, None, None, Some(y)] => [y, y, y],
        _ => {
            let names: Vec<_> = image.channels.keys().map(String::as_str).collect();
            return Err(Error::input(format!(
                "{}: has the channels {}; a picture needs R, G, B or Y",
                path.display(),
                names.join(", ")
            )));
        }
    };
    let texels = (0..image.pixel_count()).map(|i| planes.map(|plane| plane[i])).collect();
    Ok(Picture { path: path.to_owned(), has_file: true, raw, width: image.width, height: image.height, texels })
}

fn read_integers(path: &Path, raw: bool) -> Result<Picture> {
    let fail = |cause: String| Error::input(format!("{}: {cause}", path.display()));
    let reader = image::ImageReader::open(path).map_err(|error| Error::io(path, error))?;
    let reader = reader.with_guessed_format().map_err(|error| Error::io(path, error))?;
    if !matches!(reader.format(), Some(image::ImageFormat::Png | image::ImageFormat::Jpeg)) {
        return Err(fail("no picture that can be read; supported: EXR, PNG, JPEG".into()));
    }
    let (width, height) = image::ImageReader::into_dimensions(reader).map_err(|error| fail(error.to_string()))?;
    check_size(width, height).map_err(|error| fail(error.to_string()))?;
    let decoded = image::ImageReader::open(path)
        .and_then(image::ImageReader::with_guessed_format)
        .map_err(|error| Error::io(path, error))?
        .decode()
        .map_err(|error| fail(format!("truncated or damaged: {error}")))?;
    let linear = |v: f32| if raw { v } else { srgb_decode(v) };
    let texels = decoded.to_rgb32f().pixels().map(|pixel| pixel.0.map(linear)).collect();
    Ok(Picture { path: path.to_owned(), has_file: true, raw, width, height, texels })
}
