//! Which pixels of a picture need no reconstruction.

use crate::Result;
use crate::image::Image;

/// Whether each pixel's radiance is exact: it shows what reflects nothing (albedo 0), a light or nothing at all. Where it is
/// black the pixels around it must be exact as well, for samples with camera rays of their own may all miss a surface that
/// covers a little of a pixel; but not where the attribute `aa` is `false`, all rays of a pixel being one. `radiance` names
/// the channels as [`Image::rgb`] does. [`crate::render::Outputs`] says the same.
pub fn exact_pixels(image: &Image, radiance: &str) -> Result<Vec<bool>> {
    let (albedo, radiance) = (image.rgb("albedo")?, image.rgb(radiance)?);
    let zero = |planes: &[&[f32]; 3], i: usize| planes.iter().all(|plane| plane[i] == 0.0);
    let own: Vec<bool> = (0..image.pixel_count()).map(|i| zero(&albedo, i)).collect();
    if image.attributes.get("aa").is_some_and(|aa| aa == "false") {
        return Ok(own);
    }
    let (width, height) = (image.width as usize, image.height as usize);
    let around = |i: usize, end: usize| i.saturating_sub(1)..(i + 2).min(end);
    let all_around = |i: usize| {
        let (x, y) = (i % width, i / width);
        around(y, height).all(|v| own[v * width..][around(x, width)].iter().all(|exact| *exact))
    };
    Ok((0..own.len()).map(|i| own[i] && (!zero(&radiance, i) || all_around(i))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 5x4 pixels: a surface in the corner and one within, next to which is a light; nothing else.
    fn picture(aa: Option<&str>) -> Image {
        let mut image = Image { width: 5, height: 4, ..Image::default() };
        for name in ["albedo.R", "albedo.G", "albedo.B", "R", "G", "B"] {
            image.channels.insert(name.into(), vec![0.0; 20]);
        }
        for (name, pixel) in [("albedo.R", 0), ("albedo.B", 13), ("B", 0), ("R", 13), ("G", 12)] {
            image.channels.get_mut(name).unwrap()[pixel] = 0.25;
        }
        if let Some(aa) = aa {
            image.attributes.insert("aa".into(), aa.into());
        }
        image
    }

    #[test]
    fn neighbours_count_where_rays_differ() {
        let exact = |aa| -> String {
            let exact = exact_pixels(&picture(aa), "").unwrap();
            exact.chunks(5).flat_map(|row| row.iter().map(|e| if *e { '1' } else { '.' }).chain([' '])).collect()
        };
        assert_eq!(exact(Some("false")), ".1111 11111 111.1 11111 ");
        for aa in [Some("true"), None] {
            assert_eq!(exact(aa), "..111 ..... 111.. 11... ", "{aa:?}");
        }
    }
}
