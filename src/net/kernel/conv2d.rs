//! 3x3 convolution: `conv2d.comp`, `conv2d_cpu.comp`, `conv2d_narrow.comp`, and the packing of its weights, `pack_weights.comp`.

use super::{Family, coop};
use crate::Result;
use crate::gpu::{Gpu, Kernel, Recorder, Slice};
use crate::net::device::{Channels, DeviceTensor, groups};
use crate::push_block;
use crate::shaders;

push_block! {
    /// Push constants of `conv2d.comp`.
    pub struct PortablePush for shaders::conv2d {
        height: u32, width: u32, cin4: u32, cout4: u32, row_begin: u32, count: u32,
    }
}

push_block! {
    /// Push constants of `conv2d_cpu.comp`.
    pub struct CpuPush for shaders::conv2d_cpu {
        height: u32, width: u32, cin4: u32, cout4: u32, tiles_x: u32, tiles_y: u32, tile_row_begin: u32, tile_count: u32,
        window_row: u32,
    }
}

push_block! {
    /// Push constants of `conv2d_narrow.comp`.
    pub struct NarrowPush for shaders::conv2d_narrow {
        height: i32, width: i32, cin4: i32, tiles_x: u32, tiles_y: u32, tile_row_begin: u32, tile_count: u32,
        window_row: u32,
    }
}

push_block! {
    /// Push constants of `pack_weights.comp`.
    pub struct PackPush for shaders::pack_weights {
        cin: u32, cout: u32, lanes: u32, in4: u32, count: u32, transposed: u32, segment: u32, segment_padded: u32,
    }
}

/// Tile of `conv2d_cpu.comp`, pixels.
const TILE: (u32, u32) = (6, 4);
/// Side of a tile of `conv2d_narrow.comp`, pixels.
const NARROW_TILE: u32 = 4;
/// Invocations of a workgroup of `conv2d_cpu.comp`.
const LOCAL: u32 = 64;

/// A convolution's channels.
#[derive(Clone, Copy, Debug)]
pub struct Layer {
    /// Channels of the operand.
    pub input: Channels,
    /// Channels of the result.
    pub cout: u32,
}

impl Layer {
    /// The channels that a pass reads and writes: forward, or transposed for the input gradient.
    #[must_use]
    pub fn direction(self, transposed: bool) -> (Channels, Channels) {
        let out = Channels::new(self.cout);
        if transposed { (out, self.input) } else { (self.input, out) }
    }

    /// Bytes of the packed weights.
    #[must_use]
    pub fn packed_bytes(self, family: Family, transposed: bool) -> u64 {
        match family {
            Family::Portable | Family::Cpu { .. } => self.packed_texels(family, transposed) * 16,
            Family::Coop(_) => coop::packed_bytes(self, transposed),
        }
    }

    fn packed_texels(self, family: Family, transposed: bool) -> u64 {
        let (read, written) = self.direction(transposed);
        let lanes = family.lanes();
        let blocks = (written.texels() * 4).div_ceil(lanes);
        u64::from(blocks) * u64::from(read.texels()) * 9 * u64::from(lanes)
    }
}

/// Records the packing of OIHW `weight` into `packed`.
pub fn pack(
    gpu: &Gpu,
    rec: &mut Recorder,
    family: Family,
    layer: Layer,
    weight: &Slice,
    packed: &Slice,
    transposed: bool,
) -> Result<()> {
    if let Family::Coop(matrices) = family {
        return coop::pack(gpu, rec, matrices, layer, weight, packed, transposed);
    }
    let (read, _) = layer.direction(transposed);
    let (segment, segment_padded) = layer.input.segment();
    let count = layer.packed_texels(family, transposed);
    let push = PackPush {
        cin: layer.input.count(),
        cout: layer.cout,
        lanes: family.lanes(),
        in4: read.texels(),
        count: count as u32,
        transposed: u32::from(transposed),
        segment,
        segment_padded,
    };
    let kernel = gpu.kernel::<shaders::pack_weights::Shader>(&Default::default())?;
    let bind = shaders::pack_weights::Bind { weight: weight.clone(), packed: packed.clone() };
    rec.dispatch(&kernel, &bind, &push, groups(count));
    Ok(())
}

/// Operands of one pass.
pub struct Pass<'a> {
    /// What is read.
    pub x: &'a DeviceTensor,
    /// Packed weights.
    pub weight: &'a Slice,
    /// At least as many floats as the result has places, rounded up to 16.
    pub bias: &'a Slice,
    /// What is written.
    pub y: &'a DeviceTensor,
    /// Leaky ReLU slope of the result; 1 leaves it linear.
    pub slope: f32,
}

/// Records `y = leaky_relu(conv(x) + bias)`.
pub fn record(gpu: &Gpu, rec: &mut Recorder, family: Family, pass: &Pass<'_>) -> Result<()> {
    match family {
        Family::Portable => record_portable(gpu, rec, pass),
        Family::Cpu { lanes } if pass.y.shape.c.texels() == 1 => record_narrow(gpu, rec, lanes, pass),
        Family::Cpu { lanes } => record_cpu(gpu, rec, lanes, pass),
        Family::Coop(matrices) => coop::record(gpu, rec, matrices, pass),
    }
}

/// Splits `units` (each of `rows(unit) = [first, end)` rows of the result) into runs whose rows fit a storage binding, and
/// gives for each run its units, the first row of its window and the window.
fn row_windows(
    gpu: &Gpu,
    y: &DeviceTensor,
    units: u32,
    rows: impl Fn(u32) -> (u32, u32),
) -> Vec<(u32, u32, u32, Slice)> {
    let row_bytes = u64::from(y.shape.w) * u64::from(y.shape.c.texels()) * 16;
    let limit = gpu.info().max_storage_range;
    let mut out = Vec::new();
    let mut begin = 0;
    while begin < units {
        // 16 rows of whole texels are a multiple of a slice's alignment.
        let window_row = rows(begin).0 & !15;
        let fits = |unit: u32| u64::from(rows(unit).1 - window_row) * row_bytes <= limit;
        assert!(fits(begin), "a row of {row_bytes} bytes is too long for the device's storage bindings");
        let mut end = begin + 1;
        while end < units && fits(end) {
            end += 1;
        }
        let bytes = u64::from(rows(end - 1).1 - window_row) * row_bytes;
        out.push((begin, end, window_row, y.slice.slice(u64::from(window_row) * row_bytes, bytes)));
        begin = end;
    }
    out
}

/// [`row_windows`] of rows of tiles of `tile_height` pixels, over all images.
pub(super) fn tile_windows(gpu: &Gpu, y: &DeviceTensor, tile_height: u32) -> Vec<(u32, u32, u32, Slice)> {
    let (n, h) = (y.shape.n, y.shape.h);
    let tiles_y = h.div_ceil(tile_height);
    row_windows(gpu, y, n * tiles_y, |tile_row| {
        let (image, y0) = (tile_row / tiles_y, tile_row % tiles_y * tile_height);
        (image * h + y0, image * h + (y0 + tile_height).min(h))
    })
}

fn record_portable(gpu: &Gpu, rec: &mut Recorder, pass: &Pass<'_>) -> Result<()> {
    let kernel = gpu.kernel::<shaders::conv2d::Shader>(&shaders::conv2d::Spec { slope: pass.slope })?;
    let shape = pass.y.shape;
    let cout4 = shape.c.texels();
    // Windows of 16 rows, so that each begins where its slice does.
    let units = (shape.n * shape.h).div_ceil(16);
    for (begin, end, window_row, y) in
        row_windows(gpu, pass.y, units, |u| (u * 16, ((u + 1) * 16).min(shape.n * shape.h)))
    {
        let rows = (end * 16).min(shape.n * shape.h) - begin * 16;
        let count = rows * shape.w * cout4;
        let push = PortablePush {
            height: shape.h,
            width: shape.w,
            cin4: pass.x.shape.c.texels(),
            cout4,
            row_begin: window_row,
            count,
        };
        let bind =
            shaders::conv2d::Bind { x: pass.x.slice.clone(), weight: pass.weight.clone(), bias: pass.bias.clone(), y };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(count)));
    }
    Ok(())
}

/// Lets the kernel that [`record`] will use be made on a thread of its own, where making it takes long.
pub fn request(gpu: &Gpu, family: Family, written: Channels, slope: f32) -> Result<()> {
    match family {
        Family::Cpu { lanes } if written.texels() == 1 => narrow_kernel(gpu, lanes, written, slope).map(drop),
        Family::Cpu { lanes } => cpu_kernel(gpu, lanes, slope).map(drop),
        Family::Portable | Family::Coop(_) => Ok(()),
    }
}

fn cpu_kernel(gpu: &Gpu, lanes: u32, slope: f32) -> Result<Kernel<shaders::conv2d_cpu::Shader>> {
    gpu.kernel_with_subgroup(&shaders::conv2d_cpu::Spec { l: lanes, slope }, lanes)
}

fn narrow_kernel(
    gpu: &Gpu,
    lanes: u32,
    written: Channels,
    slope: f32,
) -> Result<Kernel<shaders::conv2d_narrow::Shader>> {
    gpu.kernel_with_subgroup(&shaders::conv2d_narrow::Spec { l: lanes, cout: written.count(), slope }, lanes)
}

fn record_cpu(gpu: &Gpu, rec: &mut Recorder, lanes: u32, pass: &Pass<'_>) -> Result<()> {
    let kernel = cpu_kernel(gpu, lanes, pass.slope)?;
    let shape = pass.y.shape;
    let cout4 = shape.c.texels();
    let (tiles_x, tiles_y) = (shape.w.div_ceil(TILE.0), shape.h.div_ceil(TILE.1));
    for (begin, end, window_row, y) in tile_windows(gpu, pass.y, TILE.1) {
        let tile_count = (end - begin) * tiles_x;
        let push = CpuPush {
            height: shape.h,
            width: shape.w,
            cin4: pass.x.shape.c.texels(),
            cout4,
            tiles_x,
            tiles_y,
            tile_row_begin: begin,
            tile_count,
            window_row,
        };
        let bind = shaders::conv2d_cpu::Bind {
            x: pass.x.slice.clone(),
            weight: pass.weight.clone(),
            bias: pass.bias.clone(),
            y,
        };
        rec.dispatch(&kernel, &bind, &push, [tile_count.div_ceil(LOCAL / lanes), (cout4 * 4).div_ceil(lanes), 1]);
    }
    Ok(())
}

fn record_narrow(gpu: &Gpu, rec: &mut Recorder, lanes: u32, pass: &Pass<'_>) -> Result<()> {
    let shape = pass.y.shape;
    let kernel = narrow_kernel(gpu, lanes, shape.c, pass.slope)?;
    let (tiles_x, tiles_y) = (shape.w.div_ceil(NARROW_TILE), shape.h.div_ceil(NARROW_TILE));
    for (begin, end, window_row, y) in tile_windows(gpu, pass.y, NARROW_TILE) {
        let tile_count = (end - begin) * tiles_x;
        let push = NarrowPush {
            height: shape.h as i32,
            width: shape.w as i32,
            cin4: pass.x.shape.c.texels() as i32,
            tiles_x,
            tiles_y,
            tile_row_begin: begin,
            tile_count,
            window_row,
        };
        let bind = shaders::conv2d_narrow::Bind {
            x: pass.x.slice.clone(),
            weight: pass.weight.clone(),
            bias: pass.bias.clone(),
            y,
        };
        rec.dispatch(&kernel, &bind, &push, [tile_count.div_ceil(LOCAL), 1, 1]);
    }
    Ok(())
}
