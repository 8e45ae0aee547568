//! Renders a data set, file by file; what is there already is kept.

use super::{DatasetSettings, MANIFEST, Manifest, Part, file_hash};
use crate::gpu::Gpu;
use crate::image::{Image, exr};
use crate::render::{Renderer, Settings};
use crate::scene::Scene;
use crate::scene::family::FAMILY_VERSION;
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// How a call of [`Writer::run`] ended.
#[derive(Debug)]
pub enum Written {
    /// The data set is whole.
    Whole(Manifest),
    /// The caller asked to stop; the files so far are kept.
    Stopped,
}

/// Makes a data set.
pub struct Writer {
    gpu: Gpu,
    dir: PathBuf,
    /// With the files so far.
    manifest: Manifest,
    /// What the folder's manifest said.
    before: Option<Manifest>,
    noisy: Option<Renderer>,
    target: Option<Renderer>,
    rendered: u64,
}

impl Writer {
    /// For a folder, which is made where there is none. Refuses one with another data set.
    pub fn new(gpu: &Gpu, dir: &Path, settings: &DatasetSettings) -> Result<Self> {
        let before = check(dir, settings)?;
        std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, e))?;
        crate::image::file::writable(dir.join(MANIFEST))?;
        Ok(Self {
            gpu: gpu.clone(),
            dir: dir.to_owned(),
            manifest: Manifest::new(settings),
            before,
            noisy: None,
            target: None,
            rendered: 0,
        })
    }

    /// Samples a pixel of all pictures together.
    #[must_use]
    pub fn all_spp(settings: &DatasetSettings) -> u64 {
        u64::from(settings.count)
            * Part::all().map(|part| u64::from(settings.render_settings(0, part).spp)).sum::<u64>()
    }

    /// Pictures that were rendered, not kept.
    #[must_use]
    pub fn rendered(&self) -> u64 {
        self.rendered
    }

    /// Makes what is missing, then the manifest. `progress` is told the share that is done and whether it was kept, not
    /// rendered; where it returns false, the work stops.
    pub fn run(&mut self, mut progress: impl FnMut(f64, bool) -> bool) -> Result<Written> {
        let all = Self::all_spp(&self.manifest.settings) as f64;
        let mut done = 0.0;
        for n in self.manifest.scenes.clone() {
            for part in Part::all() {
                let spp = f64::from(self.manifest.settings.render_settings(n, part).spp);
                let kept = self.kept(n, part)?;
                let sum = match &kept {
                    Some(sum) => Some(sum.clone()),
                    None => self.render(n, part, |share| progress((done + share * spp) / all, false))?,
                };
                let Some(sum) = sum else { return Ok(Written::Stopped) };
                self.manifest.files.insert(part.file(n), sum);
                done += spp;
                if !progress(done / all, kept.is_some()) && done < all {
                    return Ok(Written::Stopped);
                }
            }
        }
        self.manifest.write(&self.dir)?;
        Ok(Written::Whole(self.manifest.clone()))
    }

    /// The sha256 of a picture that is there as it would be rendered.
    fn kept(&self, n: u64, part: Part) -> Result<Option<String>> {
        let path = self.dir.join(part.file(n));
        let Some(sum) = file_hash(&path)? else { return Ok(None) };
        if let Some(before) = &self.before {
            return Ok((before.files.get(&part.file(n)) == Some(&sum)).then_some(sum));
        }
        // A file that cannot be read is no picture to lose.
        let Ok(image) = exr::read(&path) else { return Ok(None) };
        let settings = &self.manifest.settings;
        match misfit(&image, &settings.scene(n), &settings.render_settings(n, part)) {
            None => Ok(Some(sum)),
            Some(what) => {
                Err(Error::input(format!("{}: is of another data set ({what}); name another folder", path.display())))
            }
        }
    }

    /// Renders and writes a picture; its sha256, none where `progress` stopped it.
    fn render(&mut self, n: u64, part: Part, mut progress: impl FnMut(f64) -> bool) -> Result<Option<String>> {
        let settings = self.manifest.settings.render_settings(n, part);
        let scene = self.manifest.settings.scene(n);
        let slot = match part {
            Part::Noisy(_) => &mut self.noisy,
            Part::Target => &mut self.target,
        };
        let renderer = set(&self.gpu, slot, &scene, &settings)?;
        loop {
            let step = renderer.advance()?;
            if step.done() {
                break;
            }
            if !progress(step.fraction) {
                return Ok(None);
            }
        }
        let mut image = renderer.image()?;
        if part == Part::Target {
            image.channels.retain(|name, _| ["R", "G", "B"].contains(&name.as_str()));
        }
        image.attributes.insert("scene".into(), format!("spheres:{n}"));
        image.attributes.insert("familyVersion".into(), FAMILY_VERSION.to_string());
        image.attributes.insert("limpid".into(), env!("CARGO_PKG_VERSION").into());
        let path = self.dir.join(part.file(n));
        exr::write(&image, &path)?;
        self.rendered += 1;
        file_hash(&path)
    }
}

/// A renderer for a scene, the one in `slot` where it fits.
pub(super) fn set<'a>(
    gpu: &Gpu,
    slot: &'a mut Option<Renderer>,
    scene: &Scene,
    settings: &Settings,
) -> Result<&'a mut Renderer> {
    let same = |r: &Renderer| (r.settings().spp, r.settings().estimator) == (settings.spp, settings.estimator);
    let fits = |mut r: Renderer| (same(&r) && r.set_scene(scene).is_ok()).then_some(r);
    let mut renderer = match slot.take().and_then(fits) {
        Some(renderer) => renderer,
        None => Renderer::new(gpu, scene, settings)?,
    };
    renderer.set_seed(settings.seed);
    Ok(slot.insert(renderer))
}

/// The manifest of a folder, which must be of these settings; an error where the folder holds another data set.
fn check(dir: &Path, settings: &DatasetSettings) -> Result<Option<Manifest>> {
    settings.check()?;
    let other = |what: String| {
        Err(Error::input(format!("{}: holds another data set ({what}); name another folder", dir.display())))
    };
    if let Some(manifest) = Manifest::read(dir)? {
        return match manifest.differs(settings) {
            Some(what) => other(what),
            None => Ok(Some(manifest)),
        };
    }
    let entries = match std::fs::read_dir(dir) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(Error::io(dir, e)),
    };
    // An unfinished data set has no manifest, but its files have names.
    let files: Vec<String> = settings.scenes().into_iter().flat_map(|n| Part::all().map(move |p| p.file(n))).collect();
    for entry in entries {
        let name = entry.map_err(|e| Error::io(dir, e))?.file_name().to_string_lossy().into_owned();
        if name.starts_with("spheres-") && name.ends_with(".exr") && !files.contains(&name) {
            return other(format!("{name} is none of its files"));
        }
    }
    Ok(None)
}

/// Why a picture is not what rendering would make, if so.
fn misfit(image: &Image, scene: &Scene, settings: &Settings) -> Option<String> {
    let size = (scene.camera.width, scene.camera.height);
    if (image.width, image.height) != size {
        return Some(format!("{}x{} pixels, asked for {}x{}", image.width, image.height, size.0, size.1));
    }
    let wanted = [
        ("spp", settings.spp.to_string()),
        ("seed", settings.seed.to_string()),
        ("bounces", settings.bounces.to_string()),
        ("estimator", settings.estimator.to_string()),
        ("sampler", settings.sampler.to_string()),
        ("aa", settings.aa.to_string()),
        ("sceneHash", scene.hash()),
        ("familyVersion", FAMILY_VERSION.to_string()),
    ];
    wanted.into_iter().find_map(|(name, value)| match image.attributes.get(name) {
        Some(found) if *found == value => None,
        found => Some(format!("{name} {}, asked for {value}", found.map_or("not stated", String::as_str))),
    })
}
