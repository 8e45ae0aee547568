//! The error of a picture from the difference between its two halves.

use super::renderer::Renderer;
use crate::{Error, Result, shaders};

crate::push_block! {
    /// Push constants of `error_estimate`.
    pub struct Push for crate::shaders::error_estimate {
        width: u32, height: u32, sample_count: u32, rows: u32, first_sum: u32
    }
}

/// Rows that one invocation adds up.
const ROWS: u32 = 16;
/// Invocations of a work group.
const GROUP: u32 = 64;

impl Renderer {
    /// The estimated relMSE of the picture so far to what it would be with endless samples: the mean over pixels and
    /// channels of the squared half difference between the halves' means over (radiance^2 + 0.01). None where the halves are not
    /// equal: before the first two samples, after an odd number, in the middle of a pass. Needs [`Settings::halves`].
    ///
    /// [`Settings::halves`]: super::Settings::halves
    pub fn relmse_estimate(&mut self) -> Result<Option<f64>> {
        if !self.features.halves {
            return Err(Error::input("an estimate of the error needs a render in two halves"));
        }
        let (cursor, (width, height)) = (self.cursor, self.size());
        if cursor.row != 0 || cursor.begin == 0 || !cursor.begin.is_multiple_of(2) {
            return Ok(None);
        }
        self.resolve()?;
        let columns = |rows: u32| width * rows.div_ceil(ROWS);
        let starts = (0..height).step_by(self.state.window_rows as usize);
        let windows: Vec<(u32, u32)> =
            starts.map(|first| (first, self.state.window_rows.min(height - first))).collect();
        let count: u32 = windows.iter().map(|(_, rows)| columns(*rows)).sum();
        let sums = self.gpu.buffer("error sums", u64::from(count) * 4)?;
        let kernel = self.gpu.kernel::<shaders::error_estimate::Shader>(&shaders::error_estimate::Spec {})?;
        let mut rec = self.gpu.recorder();
        let mut first_sum = 0;
        for (first, height) in windows {
            let bind = self.state.error_estimate_bind(first, sums.all());
            let push = Push { width, height, sample_count: cursor.begin, rows: ROWS, first_sum };
            rec.dispatch(&kernel, &bind, &push, [columns(height).div_ceil(GROUP), 1, 1]);
            first_sum += columns(height);
        }
        rec.finish()?.run()?;
        let values: Vec<f32> = self.gpu.download(&sums.slice(0, u64::from(count) * 4))?;
        let sum: f64 = values.into_iter().map(f64::from).sum();
        Ok(Some(sum / (f64::from(width) * f64::from(height))))
    }
}
