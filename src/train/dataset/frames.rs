//! Pictures in host memory, with what inference takes from each as a whole: exposure and depth scale.

use super::write::set;
use super::{DatasetSettings, Manifest, Part};
use crate::denoise::{FrameStats, Guides, Inputs, Preparation, exact_pixels};
use crate::gpu::{Buffer, Gpu, Slice};
use crate::image::{Image, exr};
use crate::render::Renderer;
use crate::scene::Scene;
use crate::{Error, Result};
use rayon::prelude::*;
use std::path::Path;

/// Three values a pixel, row by row from the top.
pub type Plane = Vec<[f32; 3]>;

/// A noisy version of a scene.
pub struct Noisy {
    /// Its radiance.
    pub radiance: Plane,
    /// (exposure, 1 / depth, 0, 0) of the whole picture.
    pub stats: [f32; 4],
}

/// A scene's pictures.
pub struct Picture {
    /// The scene's number.
    pub scene: u64,
    /// What the network reads beside radiance, in the order of [`Inputs::planes`].
    pub guides: Vec<Plane>,
    /// Pixels whose radiance is exact.
    pub exact: Vec<bool>,
    /// What the network shall make of the noisy versions.
    pub target: Plane,
    /// The noisy versions.
    pub noisy: Vec<Noisy>,
}

/// Pictures of one size for a network.
pub struct Frames {
    gpu: Gpu,
    preparation: Preparation,
    size: (u32, u32),
    pictures: Vec<Picture>,
    stats: FrameStats,
    planes: Vec<Slice>,
    result: Buffer,
}

impl Frames {
    /// None so far.
    pub fn new(gpu: &Gpu, preparation: Preparation, size: (u32, u32)) -> Result<Self> {
        let bytes = u64::from(size.0) * u64::from(size.1) * 16;
        let planes = preparation.inputs.planes().iter();
        Ok(Self {
            gpu: gpu.clone(),
            preparation,
            size,
            pictures: Vec::new(),
            stats: FrameStats::new(gpu, preparation.transfer, size.0, size.1)?,
            planes: planes.map(|(name, _)| Ok(gpu.buffer(name, bytes)?.slice(0, bytes))).collect::<Result<_>>()?,
            result: gpu.buffer("frame stats", 16)?,
        })
    }

    /// The pictures of a data set; `progress(done, all)` is called after each scene, and where it returns false the work
    /// stops and there is no result.
    pub fn load(
        gpu: &Gpu,
        preparation: Preparation,
        dir: &Path,
        manifest: &Manifest,
        mut progress: impl FnMut(u64, u64) -> bool,
    ) -> Result<Option<Self>> {
        let size = (manifest.settings.width, manifest.settings.height);
        let mut frames = Self::new(gpu, preparation, size)?;
        let inputs = preparation.inputs;
        let read = |n: u64| -> Result<Picture> {
            let paths = manifest.checked_files(dir, n)?;
            let read = |path: &std::path::PathBuf| {
                let named = |e: Error| Error::input(format!("{}: {e}", path.display()));
                let image = exr::read(path)?;
                if (image.width, image.height) != size {
                    return Err(Error::input(format!("{}: not the size that the manifest states", path.display())));
                }
                image.rgb("").map_err(named)?;
                Ok(image)
            };
            let images = paths.par_iter().map(read).collect::<Result<Vec<_>>>()?;
            let (target, noisy) = images.split_last().expect("a scene has several pictures");
            picture(n, inputs, noisy, target).map_err(|e| Error::input(format!("{}: {e}", paths[0].display())))
        };
        let mut done = 0;
        for numbers in manifest.scenes.chunks(rayon::current_num_threads()) {
            let pictures = numbers.par_iter().map(|n| read(*n)).collect::<Result<Vec<_>>>()?;
            for picture in pictures {
                frames.push(picture)?;
                done += 1;
                if !progress(done, manifest.scenes.len() as u64) {
                    return Ok(None);
                }
            }
        }
        Ok(Some(frames))
    }

    /// Renders the pictures of these scenes, whose numbers seed their noise, as a data set of these settings has them.
    pub fn render(
        gpu: &Gpu,
        preparation: Preparation,
        settings: &DatasetSettings,
        scenes: &[(u64, Scene)],
        mut progress: impl FnMut(u64, u64),
    ) -> Result<Self> {
        let mut frames = Self::new(gpu, preparation, (settings.width, settings.height))?;
        let mut renderers: [Option<Renderer>; 2] = [None, None];
        for (i, (n, scene)) in scenes.iter().enumerate() {
            let scene = settings.sized(scene.clone());
            let mut images = Vec::new();
            for part in Part::all() {
                let slot = &mut renderers[usize::from(part == Part::Target)];
                let renderer = set(gpu, slot, &scene, &settings.render_settings(*n, part))?;
                renderer.finish()?;
                images.push(renderer.image()?);
            }
            let (target, noisy) = images.split_last().expect("a scene has several pictures");
            frames.push(picture(*n, preparation.inputs, noisy, target)?)?;
            progress(i as u64 + 1, scenes.len() as u64);
        }
        Ok(frames)
    }

    /// What is done to the pictures before and after the network.
    #[must_use]
    pub fn preparation(&self) -> Preparation {
        self.preparation
    }

    /// Pixels across and down.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// The pictures.
    #[must_use]
    pub fn pictures(&self) -> &[Picture] {
        &self.pictures
    }

    /// Adds a picture, whose noisy versions get their exposure and depth scale here.
    fn push(&mut self, mut picture: Picture) -> Result<()> {
        let upload = |slice: &Slice, plane: &Plane| {
            let texels: Vec<[f32; 4]> = plane.iter().map(|[x, y, z]| [*x, *y, *z, 0.0]).collect();
            self.gpu.upload(slice, &texels)
        };
        let (radiance, guides) = self.planes.split_first().expect("radiance comes first");
        for (slice, plane) in guides.iter().zip(&picture.guides) {
            upload(slice, plane)?;
        }
        let of_planes = Guides::of_planes(self.preparation.inputs, guides);
        for noisy in &mut picture.noisy {
            upload(radiance, &noisy.radiance)?;
            let mut rec = self.gpu.recorder();
            self.stats.record(&mut rec, radiance, &of_planes, &self.result.slice(0, 16))?;
            rec.finish()?.run()?;
            noisy.stats = self.gpu.download(&self.result.slice(0, 16))?[0];
        }
        self.pictures.push(picture);
        Ok(())
    }
}

/// A scene's pictures as planes; all of one size.
fn picture(scene: u64, inputs: Inputs, noisy: &[Image], target: &Image) -> Result<Picture> {
    let guides_of = &noisy[0];
    let channels = |image: &Image, names: [&str; 3]| -> Result<Plane> {
        let [x, y, z] = [image.channel(names[0])?, image.channel(names[1])?, image.channel(names[2])?];
        Ok(x.iter().zip(y).zip(z).map(|((x, y), z)| [*x, *y, *z]).collect())
    };
    let rgb = |image: &Image| channels(image, ["R", "G", "B"]);
    let versions = noisy.iter().map(|image| Ok(Noisy { radiance: rgb(image)?, stats: [0.0; 4] }));
    Ok(Picture {
        scene,
        guides: inputs.planes()[1..].iter().map(|(_, names)| channels(guides_of, *names)).collect::<Result<_>>()?,
        exact: exact_pixels(guides_of, "")?,
        target: rgb(target)?,
        noisy: versions.collect::<Result<_>>()?,
    })
}
