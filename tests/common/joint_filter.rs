//! A joint bilateral box filter, nothing in it learned: what a reconstruction must at least beat.
//!
//! Radiance is divided by albedo, averaged over a square, and multiplied by albedo again. In the mean a pixel counts
//! by how well its normal agrees, and by how near its depth is to what the surface's slope foretells; pixels whose radiance is exact (albedo 0:
//! lights, nothing) count nowhere and stay as they are. So do their neighbours where samples have rays of their own (--aa): these pixels are
//! partly light, which no guide tells.
#![allow(dead_code)]

use limpid::Result;
use limpid::image::Image;
use rayon::prelude::*;

/// The radii that it is tried with, pixels.
pub const RADII: [usize; 5] = [3, 7, 10, 15, 31];
/// No albedo is taken to be less.
const ALBEDO_LEAST: f32 = 0.01;
/// Depths may differ by this share of the depth, and by twice what the slope makes.
const DEPTH_SHARE: f32 = 0.01;

/// What the filter reads of a picture, planes row by row from the top.
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Linear r, g, b.
    pub radiance: [Vec<f32>; 3],
    /// Linear r, g, b.
    pub albedo: [Vec<f32>; 3],
    /// World-space x, y, z, unit length.
    pub normal: [Vec<f32>; 3],
    /// Along the ray.
    pub depth: Vec<f32>,
    /// Whether each sample has a camera ray of its own.
    pub aa: bool,
}

impl Picture {
    /// Of the channels `albedo.R/G/B`, `N.X/Y/Z`, `Z` and the noisy radiance: `noisy.R/G/B`, or `R`, `G`, `B` where these are absent.
    pub fn of(image: &Image) -> Result<Self> {
        let radiance = image.rgb(if image.has_rgb("noisy") { "noisy" } else { "" })?.map(<[f32]>::to_vec);
        let albedo = image.rgb("albedo")?.map(<[f32]>::to_vec);
        let channel = |name| image.channel(name).map(<[f32]>::to_vec);
        let aa = image.attributes.get("aa").is_some_and(|aa| aa == "true");
        let normal = [channel("N.X")?, channel("N.Y")?, channel("N.Z")?];
        Ok(Self { width: image.width as usize, radiance, albedo, normal, depth: channel("Z")?, aa })
    }

    /// The radiance, filtered over squares of `2 * radius + 1` pixels.
    pub fn filtered(&self, radius: usize) -> [Vec<f32>; 3] {
        let prepared = Prepared::new(self);
        let pixels: Vec<[f32; 3]> = (0..self.depth.len()).into_par_iter().map(|i| prepared.pixel(i, radius)).collect();
        [0, 1, 2].map(|c| pixels.iter().map(|pixel| pixel[c]).collect())
    }

    fn height(&self) -> usize {
        self.depth.len() / self.width
    }

    /// Whether a pixel's radiance is exact, or may be so in part.
    fn keeps(&self, i: usize) -> bool {
        let (x, y, reach) = (i % self.width, i / self.width, usize::from(self.aa));
        let near = |at: usize, size: usize| at.saturating_sub(reach)..(at + reach + 1).min(size);
        near(y, self.height())
            .any(|v| near(x, self.width).any(|u| self.albedo.iter().all(|plane| plane[v * self.width + u] == 0.0)))
    }

    /// The change of depth from a pixel to the next along a line: the smaller of those to either side, as an edge is
    /// on one side only.
    fn slope(&self, i: usize, at: usize, length: usize, stride: usize) -> f32 {
        let before = (at > 0).then(|| (self.depth[i] - self.depth[i - stride]).abs());
        let after = (at + 1 < length).then(|| (self.depth[i + stride] - self.depth[i]).abs());
        before.into_iter().chain(after).reduce(f32::min).unwrap_or(0.0)
    }
}

struct Prepared<'a> {
    picture: &'a Picture,
    /// Radiance by albedo.
    irradiance: [Vec<f32>; 3],
    /// 0 where the radiance stays, else 1.
    counts: Vec<f32>,
    /// Of the depth, along x and y.
    slopes: [Vec<f32>; 2],
}

impl<'a> Prepared<'a> {
    fn new(picture: &'a Picture) -> Self {
        let (width, height, count) = (picture.width, picture.height(), picture.depth.len());
        let counts = |i: usize| if picture.keeps(i) { 0.0 } else { 1.0 };
        let irradiance = |c: usize| (0..count).map(|i| picture.radiance[c][i] / albedo(picture, c, i)).collect();
        Self {
            irradiance: [0, 1, 2].map(irradiance),
            counts: (0..count).map(counts).collect(),
            slopes: [
                (0..count).map(|i| picture.slope(i, i % width, width, 1)).collect(),
                (0..count).map(|i| picture.slope(i, i / width, height, width)).collect(),
            ],
            picture,
        }
    }

    fn pixel(&self, i: usize, radius: usize) -> [f32; 3] {
        let Self { picture, irradiance, .. } = self;
        if self.counts[i] == 0.0 {
            return [0, 1, 2].map(|c| picture.radiance[c][i]);
        }
        let (x, y) = (i % picture.width, i / picture.width);
        let columns = x.saturating_sub(radius)..(x + radius + 1).min(picture.width);
        let (mut sum, mut weights) = ([0.0; 3], 0.0);
        for v in y.saturating_sub(radius)..(y + radius + 1).min(picture.height()) {
            for u in columns.clone() {
                let j = v * picture.width + u;
                let weight = self.weight(i, j, (x.abs_diff(u) as f32, y.abs_diff(v) as f32));
                (0..3).for_each(|c| sum[c] += weight * irradiance[c][j]);
                weights += weight;
            }
        }
        [0, 1, 2].map(|c| sum[c] / weights * albedo(picture, c, i))
    }

    /// How much pixel `j`, so far away, counts for pixel `i`: 1 for `i` itself.
    fn weight(&self, i: usize, j: usize, (dx, dy): (f32, f32)) -> f32 {
        let Picture { normal, depth, .. } = self.picture;
        let cosine = (0..3).map(|c| normal[c][i] * normal[c][j]).sum::<f32>().max(0.0);
        let (square, slope) = (cosine * cosine, dx * self.slopes[0][i] + dy * self.slopes[1][i]);
        let alike = (square * square) * (square * square);
        let near = 1.0 - (depth[i] - depth[j]).abs() / (2.0 * slope + DEPTH_SHARE * depth[i]);
        // The 32nd power.
        let alike = (alike * alike) * (alike * alike);
        if i == j { 1.0 } else { self.counts[j] * alike * near.max(0.0) }
    }
}

fn albedo(picture: &Picture, c: usize, i: usize) -> f32 {
    picture.albedo[c][i].max(ALBEDO_LEAST)
}
