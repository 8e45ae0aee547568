//! Results: on the device for the network, as an [`Image`] for files.

use super::renderer::Renderer;
use crate::gpu::{Buffer, Slice};
use crate::image::Image;
use crate::{Error, Result};

/// Results on the device: four f32 a pixel, row by row from the top. The slices stay the same for a renderer's life;
/// [`Renderer::outputs`] brings their content up to date.
#[derive(Clone)]
pub struct Outputs {
    /// r, g, b of the mean radiance; 1 where the pixel is exact: its first hit reflects nothing, on every sample. Else 0, but
    /// 1/2 where that is so and with `aa` a black pixel is next to one that is not exact.
    pub radiance: Slice,
    /// r, g, b of the first hit's reflectance, 0 at a miss; unused.
    pub albedo: Slice,
    /// x, y, z of the first hit's world normal, on the side that faces the camera, 0 at a miss; unused.
    pub normal_world: Slice,
    /// x (right) and y (up) of the same normal in view space; distance along the ray in world units, 0 at a miss (with
    /// `aa` the mean over the samples that hit); share of the samples that hit.
    pub screen: Slice,
    /// r, g, b of the variance of the mean; unused. Absent where the settings give none.
    pub variance: Option<Slice>,
}

impl Renderer {
    /// The radiance so far, on the device: as in [`Outputs`].
    pub fn radiance(&mut self) -> Result<Slice> {
        self.resolve()?;
        Ok(self.state.plane(&self.state.radiance))
    }

    /// The results so far, on the device. Needs [`Settings::aovs`](super::Settings::aovs).
    pub fn outputs(&mut self) -> Result<Outputs> {
        self.resolve()?;
        let Some([albedo, normal_world, screen]) = self.state.resolved.as_ref().or(self.state.aov.as_ref()) else {
            return Err(Error::input("this render keeps no first-hit values: ask for its radiance, or keep them"));
        };
        let plane = |buffer: &Buffer| self.state.plane(buffer);
        Ok(Outputs {
            radiance: plane(&self.state.radiance),
            albedo: plane(albedo),
            normal_world: plane(normal_world),
            screen: plane(screen),
            variance: self.state.variance.as_ref().map(plane),
        })
    }

    /// The results so far as channels `R,G,B`, `albedo.R/G/B`, `N.X/Y/Z`, `Nscreen.X/Y`, `Z`, and `variance.R/G/B`, where
    /// they are kept, with the settings as attributes.
    pub fn image(&mut self) -> Result<Image> {
        let radiance = self.radiance()?;
        let outputs = self.settings.aovs.then(|| self.outputs()).transpose()?;
        let variance = self.state.variance.as_ref().map(|buffer| self.state.plane(buffer));
        let (width, height) = self.size();
        let mut image = Image { width, height, ..Image::default() };
        let mut planes = |slice: &Slice, names: &[&str]| -> Result<()> {
            let values: Vec<[f32; 4]> = self.gpu.download(slice)?;
            for (i, name) in names.iter().enumerate().filter(|(_, name)| !name.is_empty()) {
                image.channels.insert((*name).to_owned(), values.iter().map(|v| v[i]).collect());
            }
            Ok(())
        };
        planes(&radiance, &["R", "G", "B"])?;
        if let Some(outputs) = outputs {
            planes(&outputs.albedo, &["albedo.R", "albedo.G", "albedo.B"])?;
            planes(&outputs.normal_world, &["N.X", "N.Y", "N.Z"])?;
            planes(&outputs.screen, &["Nscreen.X", "Nscreen.Y", "Z"])?;
        }
        if let Some(variance) = variance {
            // Two batches are the least that has a variance.
            if self.samples_done() >= 2 * self.settings.batch_size() {
                planes(&variance, &["variance.R", "variance.G", "variance.B"])?;
            }
        }
        let stats = self.stats()?;
        let settings = &self.settings;
        let mut attribute = |name: &str, value: String| image.attributes.insert(name.to_owned(), value);
        attribute("spp", self.samples_done().to_string());
        attribute("seed", settings.seed.to_string());
        attribute("bounces", settings.bounces.to_string());
        if let Some(from) = settings.roulette_from() {
            attribute("roulette", from.to_string());
        }
        attribute("estimator", settings.estimator.to_string());
        attribute("sampler", settings.sampler.to_string());
        attribute("aa", settings.aa.to_string());
        attribute("device", self.gpu.info().name.clone());
        attribute("driver", self.gpu.info().driver.clone());
        attribute("sceneHash", self.scene_hash.clone());
        attribute("invalidSamples", stats.invalid.to_string());
        attribute("depth", "ray".to_owned());
        Ok(image)
    }
}
