//! How a frame is cut into tiles.
//!
//! The network runs on windows that all have one size; a window reaches at least the overlap beyond the core of its tile,
//! but ends where the padded frame ends, so that the network's zero padding falls where the whole frame's does. Only cores
//! are written, each pixel once: the result has the bits of the whole frame.
//!
//! With a smaller overlap it has not: the network sees zeros where the frame goes on, and results differ from tile to tile.
//! Blending interpolates them across the overlap.

use crate::net::plan::TileRules;

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Rect {
    /// The part inside a frame of `width` x `height` pixels, in which the rectangle begins.
    #[must_use]
    pub fn within(self, (width, height): (u32, u32)) -> Self {
        Self { width: self.width.min(width - self.x), height: self.height.min(height - self.y), ..self }
    }

    /// Pixels.
    #[must_use]
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

/// One tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// What the network runs on, in the padded frame.
    pub window: Rect,
    /// What is written, in the padded frame.
    pub core: Rect,
    /// Column and row of tiles.
    index: (u32, u32),
}

/// Rows or columns of a frame, cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Axis {
    /// Of the padded frame.
    padded: u32,
    /// Of a window.
    window: u32,
    /// From one core to the next.
    stride: u32,
    /// What the first core has beyond a stride.
    first: u32,
    overlap: u32,
    count: u32,
}

impl Axis {
    /// Windows of `wanted` pixels, or a little more where that keeps the last one on the grid; a multiple of the step, and more
    /// than two overlaps.
    fn new(size: u32, wanted: u32, rules: &TileRules) -> Self {
        let TileRules { alignment, step, overlap } = *rules;
        let padded = size.next_multiple_of(alignment);
        if wanted >= padded {
            return Self::whole(padded, overlap);
        }
        let window = padded - (padded - wanted) / step * step;
        let stride = (window - 2 * overlap) / step * step;
        // The first and the last core reach to the frame's ends.
        let count = (padded - window).div_ceil(stride) + 1;
        Self { padded, window, stride, first: overlap, overlap, count }
    }

    fn whole(padded: u32, overlap: u32) -> Self {
        Self { padded, window: padded, stride: padded, first: 0, overlap, count: 1 }
    }

    /// Cores at the multiples of `core`, which the alignment divides, in windows of at least `overlap` more on each side.
    fn chunks(size: u32, core: u32, overlap: u32, alignment: u32) -> Self {
        let padded = size.next_multiple_of(alignment);
        let wanted = u64::from(core) + 2 * u64::from(overlap);
        if wanted >= u64::from(padded) {
            return Self::whole(padded, overlap);
        }
        let window = (wanted as u32).next_multiple_of(alignment);
        Self { padded, window, stride: core, first: 0, overlap, count: padded.div_ceil(core) }
    }

    /// As few windows as there are with `most` pixels, and these as small as that allows.
    fn at_most(size: u32, most: u32, rules: &TileRules) -> Self {
        let count = Self::new(size, most, rules).count;
        if count == 1 {
            return Self::new(size, u32::MAX, rules);
        }
        let padded = size.next_multiple_of(rules.alignment);
        let least = (padded + 2 * rules.overlap * (count - 1)).div_ceil(count);
        Self::new(size, least.next_multiple_of(rules.step).max(2 * rules.overlap + rules.step), rules)
    }

    fn begin(&self, i: u32) -> u32 {
        (i * self.stride + self.first).saturating_sub(self.overlap).min(self.padded - self.window)
    }

    /// Where the core of window `i - 1` ends and that of window `i` begins.
    fn cut(&self, i: u32) -> u32 {
        match i {
            0 => 0,
            i if i == self.count => self.padded,
            i => i * self.stride + self.first,
        }
    }

    /// The part of 0..`size` to which core `i` gives something where results are blended, and the weights there: the share that
    /// the core has of the `overlap` pixels to either side of a pixel's centre. They are linear across the overlap, and those of all cores sum to 1.
    fn weights(&self, i: u32, size: u32) -> (u32, Vec<f64>) {
        let reach = f64::from(self.overlap);
        let (first, last) = (i == 0, i + 1 == self.count);
        let begin = if first { 0 } else { self.cut(i).saturating_sub(self.overlap) };
        let end = if last { size } else { (self.cut(i + 1) + self.overlap).min(size) };
        // Beyond the frame the cores at its ends go on.
        let low = if first { f64::NEG_INFINITY } else { f64::from(self.cut(i)) };
        let high = if last { f64::INFINITY } else { f64::from(self.cut(i + 1)) };
        let weight = |x: u32| {
            let centre = f64::from(x) + 0.5;
            ((centre + reach).min(high) - (centre - reach).max(low)) / (2.0 * reach)
        };
        (begin, (begin..end).map(weight).collect())
    }
}

/// A frame, cut into tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiling {
    size: (u32, u32),
    overlap: u32,
    /// The overlap with which the result has the bits of the whole frame.
    exact_overlap: u32,
    blend: bool,
    x: Axis,
    y: Axis,
}

impl Tiling {
    /// One tile: a frame of `width` x `height` pixels as a whole.
    #[must_use]
    pub fn whole(size: (u32, u32), rules: &TileRules) -> Self {
        Self::windows(size, u32::MAX, rules)
    }

    /// Cores of `core` x `core` pixels, a multiple of the step; those at the frame's ends need an overlap on one side only and
    /// are larger by the other.
    #[must_use]
    pub fn cores(size: (u32, u32), core: u32, rules: &TileRules) -> Self {
        Self::windows(size, core.saturating_add(2 * rules.overlap), rules)
    }

    fn windows(size: (u32, u32), wanted: u32, rules: &TileRules) -> Self {
        Self::exact(size, rules, |size| Axis::new(size, wanted, rules))
    }

    fn exact(size: (u32, u32), rules: &TileRules, axis: impl Fn(u32) -> Axis) -> Self {
        let TileRules { overlap, .. } = *rules;
        Self { size, overlap, exact_overlap: overlap, blend: false, x: axis(size.0), y: axis(size.1) }
    }

    /// Cores of `core` x `core` pixels, a multiple of the step, at the multiples of that, in windows that reach `overlap` pixels
    /// beyond each side and then on to the alignment, but stay inside the padded frame: the last ones of a frame that is no multiple of `core`
    /// are moved back into it. With `blend`, results are interpolated across the overlap, which is then not 0. Without, an
    /// overlap as large as the exact one is rounded up to the step, and the result is exact.
    ///
    /// # Panics
    /// Where results are to be blended across nothing.
    #[must_use]
    pub fn overlapping(size: (u32, u32), core: u32, (overlap, blend): (u32, bool), rules: &TileRules) -> Self {
        assert!(overlap > 0 || !blend, "nothing to blend across");
        if overlap >= rules.overlap && !blend {
            // More than the frame changes nothing.
            let overlap = overlap.min(size.0.max(size.1).max(rules.overlap)).next_multiple_of(rules.step);
            return Self { exact_overlap: rules.overlap, ..Self::cores(size, core, &TileRules { overlap, ..*rules }) };
        }
        let axis = |size| Axis::chunks(size, core, overlap, rules.alignment);
        Self { size, overlap, exact_overlap: rules.overlap, blend, x: axis(size.0), y: axis(size.1) }
    }

    /// Tilings with ever smaller windows, from the whole frame down.
    pub fn candidates(size: (u32, u32), rules: TileRules) -> impl Iterator<Item = Self> {
        let longest = size.0.max(size.1).next_multiple_of(rules.alignment).next_multiple_of(rules.step);
        let least = (2 * rules.overlap + rules.step).min(longest);
        let mut last = None;
        (least / rules.step..=longest / rules.step).rev().filter_map(move |steps| {
            let axis = |size| Axis::at_most(size, steps * rules.step, &rules);
            let tiling = Self::exact(size, &rules, axis);
            (last.replace(tiling) != Some(tiling)).then_some(tiling)
        })
    }

    /// Width and height of the frame, pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// Width and height of every window, pixels.
    #[must_use]
    pub fn window(&self) -> (u32, u32) {
        (self.x.window, self.y.window)
    }

    /// Width and height of the cores inside the frame, pixels; the frame's own where they reach over all of it.
    #[must_use]
    pub fn core(&self) -> (u32, u32) {
        let core = |axis: Axis, size| if axis.count == 1 { size } else { axis.stride };
        (core(self.x, self.size.0), core(self.y, self.size.1))
    }

    /// Pixels that windows reach at least beyond their cores, but for the frame's ends.
    #[must_use]
    pub fn overlap(&self) -> u32 {
        self.overlap
    }

    /// The overlap with which the result has the bits of the whole frame, pixels.
    #[must_use]
    pub fn exact_overlap(&self) -> u32 {
        self.exact_overlap
    }

    /// Whether results are interpolated across the overlap.
    #[must_use]
    pub fn blend(&self) -> bool {
        self.blend
    }

    /// Whether the result has the bits of the whole frame.
    #[must_use]
    pub fn is_exact(&self) -> bool {
        self.count() == 1 || (!self.blend && self.overlap >= self.exact_overlap)
    }

    /// Where the result of a tile counts when blended: a part of the frame, and the weights of its columns and rows; a
    /// pixel's is the product. The weights of all tiles sum to 1 at every pixel.
    #[must_use]
    pub fn weights(&self, tile: &Tile) -> (Rect, [Vec<f64>; 2]) {
        let (x, columns) = self.x.weights(tile.index.0, self.size.0);
        let (y, rows) = self.y.weights(tile.index.1, self.size.1);
        (Rect { x, y, width: columns.len() as u32, height: rows.len() as u32 }, [columns, rows])
    }

    /// Tiles.
    #[must_use]
    pub fn count(&self) -> u32 {
        self.x.count * self.y.count
    }

    /// The tiles, row by row.
    pub fn tiles(self) -> impl Iterator<Item = Tile> {
        let Self { x, y, .. } = self;
        let core = |axis: Axis, i: u32| (axis.cut(i), axis.cut(i + 1) - axis.cut(i));
        (0..self.count()).map(move |i| {
            let (i, j) = (i % x.count, i / x.count);
            let ((core_x, width), (core_y, height)) = (core(x, i), core(y, j));
            Tile {
                window: Rect { x: x.begin(i), y: y.begin(j), width: x.window, height: y.window },
                core: Rect { x: core_x, y: core_y, width, height },
                index: (i, j),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: [TileRules; 3] = [
        TileRules { alignment: 32, step: 32, overlap: 128 },
        TileRules { alignment: 4, step: 8, overlap: 16 },
        TileRules { alignment: 1, step: 1, overlap: 0 },
    ];

    /// What every tiling must be: cores that fill the frame without overlapping, on the grid, with the overlap about them.
    fn check(tiling: &Tiling, rules: &TileRules) {
        let (width, height) = tiling.size();
        let padded = (width.next_multiple_of(rules.alignment), height.next_multiple_of(rules.alignment));
        let mut area = 0;
        for Tile { window, core, .. } in tiling.tiles() {
            area += core.pixels();
            assert_eq!((window.width, window.height), tiling.window());
            let axes = [
                (window.x, window.width, core.x, core.width, padded.0, width),
                (window.y, window.height, core.y, core.height, padded.1, height),
            ];
            for (begin, length, core, core_length, padded, size) in axes {
                let what = format!("{tiling:?}: {window:?} {core:?}");
                assert!(begin.is_multiple_of(rules.step) && core.is_multiple_of(rules.step), "{what}");
                assert!(core + core_length == padded || (core + core_length).is_multiple_of(rules.step), "{what}");
                assert!(core_length > 0 && core < size, "{what}: nothing of the frame in it");
                assert!(begin <= core.saturating_sub(rules.overlap), "{what}");
                assert!(begin + length >= (core + core_length + rules.overlap).min(padded), "{what}");
                assert!(begin + length <= padded, "{what}");
            }
        }
        // Each pixel of the frame in exactly one core: the areas add up, and two tiles share no pixel.
        assert_eq!(area, u64::from(padded.0) * u64::from(padded.1), "{tiling:?}");
        let tiles: Vec<Tile> = tiling.tiles().take(64).collect();
        for (i, a) in tiles.iter().enumerate() {
            for b in &tiles[..i] {
                let apart = |a: u32, n: u32, b: u32, m: u32| a + n <= b || b + m <= a;
                let (a, b) = (a.core, b.core);
                assert!(apart(a.x, a.width, b.x, b.width) || apart(a.y, a.height, b.y, b.height), "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn cores_fill_the_frame_and_windows_hold_what_they_need() {
        for rules in &RULES {
            for size in [(1, 1), (31, 33), (333, 221), (768, 768), (2000, 100), (1037, 63)] {
                check(&Tiling::whole(size, rules), rules);
                assert_eq!(Tiling::whole(size, rules).count(), 1);
                for cores in [1, 2, 3, 7, 100] {
                    check(&Tiling::cores(size, cores * rules.step, rules), rules);
                }
                let mut last = u64::MAX;
                for tiling in Tiling::candidates(size, *rules).step_by(3) {
                    check(&tiling, rules);
                    let (width, height) = tiling.window();
                    assert!(u64::from(width) * u64::from(height) <= last, "{tiling:?}: larger than the one before");
                    last = u64::from(width) * u64::from(height);
                }
                assert_eq!(Tiling::candidates(size, *rules).next(), Some(Tiling::whole(size, rules)));
            }
        }
    }

    #[test]
    fn interior_cores_have_the_size_asked_for() {
        let tiling = Tiling::cores((4096, 4096), 256, &RULES[0]);
        let cores: Vec<u32> = tiling.tiles().take(3).map(|tile| tile.core.width).collect();
        assert_eq!(cores, [256 + 128, 256, 256]);
        assert_eq!((tiling.window(), tiling.core()), ((512, 512), (256, 256)));
        // 4096 = 384 + 13 * 256 + 384.
        assert_eq!(tiling.count(), 15 * 15);
    }
}
