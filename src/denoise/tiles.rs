//! How a frame is cut into tiles.
//!
//! The network runs on windows that all have one size; a window reaches at least the overlap beyond the core of its tile,
//! but ends where the padded frame ends, so that the network's zero padding falls where the whole frame's does. Only cores
//! are written, each pixel once: the result has the bits of the whole frame.

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
}

/// Rows or columns of a frame, cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Axis {
    /// Of the padded frame.
    padded: u32,
    /// Of a window.
    window: u32,
    /// From one window to the next.
    stride: u32,
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
            return Self { padded, window: padded, stride: padded, overlap, count: 1 };
        }
        let window = padded - (padded - wanted) / step * step;
        let stride = (window - 2 * overlap) / step * step;
        // The first and the last core reach to the frame's ends.
        Self { padded, window, stride, overlap, count: (padded - window).div_ceil(stride) + 1 }
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
        (i * self.stride).min(self.padded - self.window)
    }

    /// Where the core of window `i - 1` ends and that of window `i` begins.
    fn cut(&self, i: u32) -> u32 {
        match i {
            0 => 0,
            i if i == self.count => self.padded,
            i => i * self.stride + self.overlap,
        }
    }
}

/// A frame, cut into tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiling {
    size: (u32, u32),
    overlap: u32,
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
        let axis = |size| Axis::new(size, wanted, rules);
        Self { size, overlap: rules.overlap, x: axis(size.0), y: axis(size.1) }
    }

    /// Tilings with ever smaller windows, from the whole frame down.
    pub fn candidates(size: (u32, u32), rules: TileRules) -> impl Iterator<Item = Self> {
        let longest = size.0.max(size.1).next_multiple_of(rules.alignment).next_multiple_of(rules.step);
        let least = (2 * rules.overlap + rules.step).min(longest);
        let mut last = None;
        (least / rules.step..=longest / rules.step).rev().filter_map(move |steps| {
            let axis = |size| Axis::at_most(size, steps * rules.step, &rules);
            let tiling = Self { size, overlap: rules.overlap, x: axis(size.0), y: axis(size.1) };
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
        for Tile { window, core } in tiling.tiles() {
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
