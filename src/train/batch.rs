//! Chunks of pictures in host memory as batches on the device.

use super::data::record_target;
use super::dataset::{Frames, Picture};
use super::split::Chunk;
use crate::denoise::{Crop, Frame, Guides, OutputPush, Preparation, record_input};
use crate::gpu::{Buffer, Commands, Gpu, Recorder, Slice};
use crate::net::device::{DeviceTensor, groups};
use crate::{Result, shaders};
use rayon::prelude::*;

/// Bytes between one chunk's stats and the next one's.
const STATS_STRIDE: u64 = 256;
/// The same in elements of four floats.
const STATS_ELEMENTS: usize = STATS_STRIDE as usize / 16;

/// What is uploaded for the chunks of a batch, and the commands that make network inputs and targets of it.
pub struct Batch {
    gpu: Gpu,
    side: u32,
    count: u32,
    radiance: Buffer,
    guides: Vec<Buffer>,
    reference: Buffer,
    stats: Buffer,
    reconstruction: Buffer,
    prepare: Commands,
    reconstruct: Commands,
}

impl Batch {
    /// For batches whose inputs, targets and results are these tensors of square crops.
    pub fn new(
        gpu: &Gpu,
        preparation: Preparation,
        (input, target, output): (&DeviceTensor, &DeviceTensor, &DeviceTensor),
    ) -> Result<Self> {
        let (count, side) = (input.shape.n, input.shape.w);
        assert_eq!(input.shape.h, side);
        let plane = u64::from(side) * u64::from(side) * 16;
        let stride = plane.next_multiple_of(256);
        assert_eq!(plane, stride, "a crop's side is a multiple of the alignment");
        let planes = |name: &str| gpu.buffer(name, plane * u64::from(count));
        let mut batch = Self {
            gpu: gpu.clone(),
            side,
            count,
            radiance: planes("batch radiance")?,
            guides: preparation.inputs.planes()[1..].iter().map(|(name, _)| planes(name)).collect::<Result<_>>()?,
            reference: planes("batch reference")?,
            stats: gpu.buffer("batch stats", STATS_STRIDE * u64::from(count))?,
            reconstruction: planes("batch reconstruction")?,
            prepare: gpu.recorder().finish()?,
            reconstruct: gpu.recorder().finish()?,
        };
        let mut rec = gpu.recorder();
        for i in 0..count {
            batch.record_prepare(&mut rec, preparation, i, (&input.slice, &target.slice))?;
        }
        batch.prepare = rec.finish()?;
        let mut rec = gpu.recorder();
        for i in 0..count {
            batch.record_reconstruct(&mut rec, preparation, i, &output.slice)?;
        }
        batch.reconstruct = rec.finish()?;
        Ok(batch)
    }

    /// Chunk `i`'s part of a buffer or tensor with equal parts for all.
    fn part(&self, slice: &Slice, i: u32) -> Slice {
        let bytes = slice.bytes() / u64::from(self.count);
        slice.slice(u64::from(i) * bytes, bytes)
    }

    fn stats(&self, i: u32) -> Slice {
        self.stats.slice(u64::from(i) * STATS_STRIDE, 16)
    }

    fn record_prepare(
        &self,
        rec: &mut Recorder,
        preparation: Preparation,
        i: u32,
        (input, target): (&Slice, &Slice),
    ) -> Result<()> {
        let guides: Vec<Slice> = self.guides.iter().map(|buffer| self.part(&buffer.all(), i)).collect();
        let guides = Guides::of_planes(preparation.inputs, &guides);
        let (radiance, stats, side) = (self.part(&self.radiance.all(), i), self.stats(i), self.side);
        let frame = Frame { radiance: &radiance, guides: &guides, stats: &stats, size: (side, side) };
        let crop = Crop { x: 0, y: 0, width: side, height: side, orientation: 0 };
        record_input(&self.gpu, rec, preparation.transfer, &frame, crop, &self.part(input, i))?;
        let reference = self.part(&self.reference.all(), i);
        record_target(&self.gpu, rec, preparation.transfer, (&reference, &stats, side), crop, self.part(target, i))
    }

    fn record_reconstruct(&self, rec: &mut Recorder, preparation: Preparation, i: u32, output: &Slice) -> Result<()> {
        let spec = shaders::network_output::Spec { transfer: preparation.transfer.id() };
        let kernel = self.gpu.kernel::<shaders::network_output::Shader>(&spec)?;
        let push = OutputPush { begin: 0, count: self.side * self.side, width: self.side, padded_width: self.side };
        let bind = shaders::network_output::Bind {
            network: self.part(output, i),
            radiance: self.part(&self.radiance.all(), i),
            stats: self.stats(i),
            y: self.part(&self.reconstruction.all(), i),
        };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(push.count)));
        Ok(())
    }

    /// Chunks of a batch.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count as usize
    }

    /// Writes the inputs and targets of these chunks.
    ///
    /// # Panics
    /// Where there are more or fewer than [`Self::count`].
    pub fn load(&mut self, frames: &Frames, chunks: &[Chunk]) -> Result<()> {
        assert_eq!(chunks.len(), self.count());
        let upload = |buffer: &Buffer, texel: &(dyn Fn(&Chunk, &Picture, usize) -> [f32; 4] + Sync)| {
            self.gpu.upload(&buffer.all(), &self.gather(frames, chunks, texel))
        };
        upload(&self.radiance, &|c, p, at| {
            let [r, g, b] = p.noisy[c.noisy as usize].radiance[at];
            [r, g, b, f32::from(u8::from(p.exact[at]))]
        })?;
        for (i, buffer) in self.guides.iter().enumerate() {
            upload(buffer, &|_, p, at| padded(p.guides[i][at]))?;
        }
        upload(&self.reference, &|_, p, at| padded(p.target[at]))?;
        let mut stats = vec![[0f32; 4]; STATS_ELEMENTS * chunks.len()];
        for (c, stats) in chunks.iter().zip(stats.chunks_mut(STATS_ELEMENTS)) {
            stats[0] = frames.pictures()[c.picture as usize].noisy[c.noisy as usize].stats;
        }
        self.gpu.upload(&self.stats.all(), &stats)?;
        self.prepare.run()?;
        Ok(())
    }

    /// The pixels of chunks, one chunk after the other.
    fn gather<T: Send + Copy + Default>(
        &self,
        frames: &Frames,
        chunks: &[Chunk],
        pixel: &(dyn Fn(&Chunk, &Picture, usize) -> T + Sync),
    ) -> Vec<T> {
        let (side, width) = (self.side as usize, frames.size().0 as usize);
        let mut out = vec![T::default(); side * side * chunks.len()];
        out.par_chunks_mut(side * side).zip(chunks).for_each(|(out, c)| {
            let picture = &frames.pictures()[c.picture as usize];
            for (y, row) in out.chunks_mut(side).enumerate() {
                let begin = (c.y as usize + y) * width + c.x as usize;
                row.iter_mut().enumerate().for_each(|(x, out)| *out = pixel(c, picture, begin + x));
            }
        });
        out
    }

    /// The radiance that inference would make of the network's output for the chunks that were loaded, pixel after pixel.
    pub fn reconstruction(&mut self) -> Result<Vec<[f32; 4]>> {
        self.reconstruct.run()?;
        self.gpu.download(&self.reconstruction.all())
    }

    /// The radiance of the targets of chunks, pixel after pixel.
    #[must_use]
    pub fn targets(&self, frames: &Frames, chunks: &[Chunk]) -> Vec<[f32; 3]> {
        self.gather(frames, chunks, &|_, p, at| p.target[at])
    }
}

fn padded([x, y, z]: [f32; 3]) -> [f32; 4] {
    [x, y, z, 0.0]
}
