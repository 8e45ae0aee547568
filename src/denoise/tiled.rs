//! Reconstruction of frames in host memory, tile by tile: the device never holds more of a frame than a tile.

use super::frame::{BIN, Guides};
use super::network::{Kernels, Network, PIXEL_BYTES};
use super::preparation::Inputs;
use super::tiles::{Rect, Tile, Tiling};
use crate::Result;
use crate::gpu::{Buffer, Commands, Footprint, Gpu, Recorder, Slice, Timings};
use crate::net::architecture::Architecture;
use crate::net::weights::Weights;

/// A plane of a frame in host memory: its pixel `i`, row by row from the top.
pub type Plane<'a> = &'a dyn Fn(usize) -> [f32; 4];

/// A network made ready for frames of one size, cut into tiles of one size.
pub struct TiledDenoiser {
    network: Network,
    /// The network alone.
    forward: Commands,
    tiling: Tiling,
    /// A window of each of [`Inputs::planes`].
    planes: Vec<Buffer>,
    /// Tiles of the last frame in which every pixel was exact.
    skipped: u32,
}

/// Pixels of the frame that the device holds at once: a window's, and at least a row of bins.
fn plane_pixels(tiling: &Tiling) -> u64 {
    let (width, height) = tiling.size();
    window_pixels(tiling).max(u64::from(width) * u64::from(height.min(BIN)))
}

/// Pixels of a window, without what lies past the frame in every window.
fn window_pixels(tiling: &Tiling) -> u64 {
    let ((width, height), window) = (tiling.size(), tiling.window());
    u64::from(width.min(window.0)) * u64::from(height.min(window.1))
}

fn add(sum: &mut Timings, part: &Timings) {
    sum.submitted = sum.submitted.or(part.submitted);
    sum.device_ms += part.device_ms;
    sum.wall_ms += part.wall_ms;
}

/// Copies a core into the planes r, g, b where every pixel of it is exact (1 in the fourth place of the radiance), and says so.
fn keep_exact(radiance: Plane, core: Rect, width: u32, result: &mut [Vec<f32>; 3]) -> bool {
    let pixels = || {
        (core.y..core.y + core.height)
            .flat_map(move |y| (core.x..core.x + core.width).map(move |x| y as usize * width as usize + x as usize))
    };
    if !pixels().all(|i| radiance(i)[3] > 0.5) {
        return false;
    }
    for i in pixels() {
        let value = radiance(i);
        result.iter_mut().zip(value).for_each(|(plane, value)| plane[i] = value);
    }
    true
}

impl TiledDenoiser {
    /// The memory that [`Self::new`] will take; nothing more is allocated later.
    #[must_use]
    pub fn footprint(architecture: &Architecture, inputs: Inputs, kernels: Kernels, tiling: &Tiling) -> Footprint {
        let network = Network::footprint(architecture, kernels, tiling.size(), tiling.window(), window_pixels(tiling));
        let planes = inputs.planes().iter().map(|_| Footprint::buffer(plane_pixels(tiling) * PIXEL_BYTES));
        std::iter::once(network).chain(planes).sum()
    }

    /// Tensors and buffers for one tile. The tiling must follow the rules of these kernels, or tiles will not fit together.
    pub fn new(gpu: &Gpu, weights: &Weights, kernels: Kernels, tiling: Tiling) -> Result<Self> {
        let network = Network::new(gpu, weights, kernels, tiling.size(), tiling.window(), window_pixels(&tiling))?;
        let mut rec = gpu.recorder();
        network.plan.record(&mut rec, &network.parameters)?;
        let plane = |(name, _): &(&str, _)| gpu.buffer(name, plane_pixels(&tiling) * PIXEL_BYTES);
        let planes = network.preparation.inputs.planes().iter().map(plane).collect::<Result<_>>()?;
        Ok(Self { network, forward: rec.finish()?, tiling, planes, skipped: 0 })
    }

    /// The kernels in use.
    #[must_use]
    pub fn kernels(&self) -> Kernels {
        self.network.kernels
    }

    /// Reconstructs a frame, given as its [`Inputs::planes`]: the planes r, g, b and the times. `progress` is told the share of the
    /// tiles that are done.
    ///
    /// # Panics
    /// Where there are more planes or fewer; so do the methods below.
    pub fn run(&mut self, frame: &[Plane], mut progress: impl FnMut(f64)) -> Result<([Vec<f32>; 3], Timings)> {
        let (width, height) = self.tiling.size();
        let mut result = [(); 3].map(|()| vec![0.0; width as usize * height as usize]);
        let mut blended = self.tiling.blend().then(|| [(); 3].map(|()| vec![0.0; result[0].len()]));
        let mut timings = self.measure(frame)?;
        let count = self.tiling.count();
        self.skipped = 0;
        for (i, tile) in self.tiling.tiles().enumerate() {
            if blended.is_none() && keep_exact(frame[0], tile.core.within(self.tiling.size()), width, &mut result) {
                self.skipped += 1;
            } else {
                // A single tile is on the device since it was measured.
                if count > 1 {
                    self.upload(frame, tile.window.within(self.tiling.size()))?;
                }
                let (pixels, part) = self.compute(&tile)?;
                match &mut blended {
                    Some(sums) => self.blend(&tile, &pixels, sums),
                    None => self.write(&tile, &pixels, &mut result),
                }
                add(&mut timings, &part);
            }
            progress((i + 1) as f64 / f64::from(count));
        }
        Ok((blended.map_or(result, |sums| sums.map(|plane| plane.iter().map(|&v| v as f32).collect())), timings))
    }

    /// Tiles of the last frame that the network did not see because all their pixels were exact.
    #[must_use]
    pub fn skipped(&self) -> u32 {
        self.skipped
    }

    /// Finds the exposure and the depth scale of a frame, strip by strip, for the tiles that follow.
    pub fn measure(&mut self, frame: &[Plane]) -> Result<Timings> {
        let (width, height) = self.tiling.size();
        let stats = &self.network.frame_stats;
        // All rows, or as many as fit whatever a row of bins has.
        let rows = plane_pixels(&self.tiling) / u64::from(width);
        let each = if rows >= u64::from(height) { stats.bin_rows() } else { rows as u32 / BIN };
        let mut timings = Timings::default();
        for begin in (0..stats.bin_rows()).step_by(each as usize) {
            let bin_rows = begin..(begin + each).min(stats.bin_rows());
            let rows = stats.rows(&bin_rows);
            let strip = Rect { x: 0, y: rows.start, width, height: rows.end - rows.start };
            self.upload(frame, strip)?;
            let (radiance, guides) = self.loaded(strip);
            add(&mut timings, &self.now(|rec| self.network.record_strip(rec, (&radiance, &guides), bin_rows))?);
        }
        add(&mut timings, &self.now(|rec| self.network.frame_stats.record_join(rec, &self.network.stats))?);
        Ok(timings)
    }

    /// Exposure and 1 / depth, as [`Self::measure`] found them.
    pub fn stats(&self) -> Result<[f32; 2]> {
        let stats: Vec<f32> = self.network.gpu.download(&self.network.stats)?;
        Ok([stats[0], stats[1]])
    }

    /// Pixels of the last frame that held what no renderer should give and were repaired; see [`super::FrameStats::record`].
    pub fn repaired(&self) -> Result<u64> {
        self.network.repaired()
    }

    /// Reconstructs one tile of the measured frame: writes the pixels of its core, and no others, into the planes r, g, b of
    /// the frame.
    pub fn reconstruct(&mut self, frame: &[Plane], tile: &Tile, result: &mut [Vec<f32>; 3]) -> Result<Timings> {
        self.upload(frame, tile.window.within(self.tiling.size()))?;
        let (pixels, timings) = self.compute(tile)?;
        self.write(tile, &pixels, result);
        Ok(timings)
    }

    /// The result for a window that is on the device, as far as it lies in the frame.
    fn compute(&mut self, tile: &Tile) -> Result<(Vec<[f32; 4]>, Timings)> {
        let window = tile.window.within(self.tiling.size());
        let ((radiance, guides), size) = (self.loaded(window), (window.width, window.height));
        let mut timings = self.now(|rec| self.network.record_input(rec, (&radiance, &guides), size))?;
        add(&mut timings, &self.forward.run()?);
        add(&mut timings, &self.now(|rec| self.network.record_output(rec, &radiance, size))?);
        Ok((self.network.download(window.pixels())?, timings))
    }

    /// Copies the core.
    fn write(&self, tile: &Tile, pixels: &[[f32; 4]], result: &mut [Vec<f32>; 3]) {
        let core = tile.core.within(self.tiling.size());
        for y in core.y..core.y + core.height {
            let (from, to) = self.places(tile, (core.x, y));
            let row = &pixels[from..from + core.width as usize];
            for (c, plane) in result.iter_mut().enumerate() {
                plane[to..to + row.len()].iter_mut().zip(row).for_each(|(value, pixel)| *value = pixel[c]);
            }
        }
    }

    /// Adds what the tile gives to the frame. In f64, so that equal results come out as they are.
    fn blend(&self, tile: &Tile, pixels: &[[f32; 4]], sums: &mut [Vec<f64>; 3]) {
        let (part, [columns, rows]) = self.tiling.weights(tile);
        for (y, row_weight) in (part.y..).zip(rows) {
            let (from, to) = self.places(tile, (part.x, y));
            for (c, plane) in sums.iter_mut().enumerate() {
                let values = plane[to..].iter_mut().zip(&pixels[from..]);
                for ((sum, pixel), weight) in values.zip(&columns) {
                    *sum += weight * row_weight * f64::from(pixel[c]);
                }
            }
        }
    }

    /// Where a pixel of the frame lies in the result of a tile's window, and in the frame.
    fn places(&self, tile: &Tile, (x, y): (u32, u32)) -> (usize, usize) {
        let (size, window) = (self.tiling.size(), tile.window.within(self.tiling.size()));
        let from = (y - window.y) * window.width + x - window.x;
        (from as usize, y as usize * size.0 as usize + x as usize)
    }

    fn upload(&self, frame: &[Plane], part: Rect) -> Result<()> {
        assert_eq!(frame.len(), self.planes.len(), "planes of {:?}", self.network.preparation.inputs);
        let width = self.tiling.size().0 as usize;
        let columns = part.x as usize..(part.x + part.width) as usize;
        for (plane, buffer) in frame.iter().zip(&self.planes) {
            let rows = (part.y..part.y + part.height).map(|y| y as usize * width);
            let pixels: Vec<[f32; 4]> = rows.flat_map(|row| columns.clone().map(move |x| plane(row + x))).collect();
            self.network.gpu.upload(&buffer.all(), &pixels)?;
        }
        Ok(())
    }

    fn loaded(&self, part: Rect) -> (Slice, Guides) {
        let slice = |buffer: &Buffer| buffer.slice(0, part.pixels() * PIXEL_BYTES);
        let guides: Vec<Slice> = self.planes[1..].iter().map(slice).collect();
        (slice(&self.planes[0]), Guides::of_planes(self.network.preparation.inputs, &guides))
    }

    fn now(&self, record: impl FnOnce(&mut Recorder) -> Result<()>) -> Result<Timings> {
        let mut rec = self.network.gpu.recorder();
        record(&mut rec)?;
        rec.finish()?.run()
    }
}
