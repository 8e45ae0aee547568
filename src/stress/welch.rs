//! Do two ways to render give the same picture? Welch's test over blocks of pixels (Jung, Hanika, Dachsbacher, JCGT 9(2) 2020).

use super::support::*;
use super::{Checks, Outcome};
use crate::Result;
use crate::gpu::Gpu;
use crate::render::{Estimator, Renderer, Sampler, Settings};

/// Means of 8x8 blocks (over the channels too), one vector a render.
pub(super) fn block_means(renderer: &mut Renderer, renders: u32, first_seed: u32) -> Result<Vec<Vec<f64>>> {
    let (width, height) = renderer.size();
    let one = |i| {
        renderer.set_seed(first_seed + i);
        renderer.finish()?;
        let image = renderer.image()?;
        let mut blocks = vec![0.0; (width / 8 * (height / 8)) as usize];
        for channel in ["R", "G", "B"] {
            for (i, &v) in image.channels[channel].iter().enumerate() {
                let (x, y) = (i as u32 % width, i as u32 / width);
                blocks[(y / 8 * (width / 8) + x / 8) as usize] += f64::from(v) / 192.0;
            }
        }
        Ok(blocks)
    };
    (0..renders).map(one).collect()
}

/// What Welch's test says of two sets of renders.
#[derive(Debug)]
pub(super) struct Agreement {
    /// Blocks that vary at all (a block of nothing but exact pixels has no test).
    blocks: usize,
    /// Share of them with p < 0.01.
    rejected: f64,
    /// The smallest p over the Sidak limit at alpha 0.01: under 1 is a rejection.
    worst: f64,
    /// Sum of t over all blocks in standard deviations: sees a small bias common to all.
    common: f64,
}

impl Agreement {
    /// 1.5 % where there are many blocks; with few, what chance exceeds once in 1000 (normal bound of the binomial).
    fn allowed(&self) -> f64 {
        f64::max(0.015, 0.01 + 3.1 * (0.01 * 0.99 / self.blocks as f64).sqrt())
    }

    fn accepts(&self) -> bool {
        self.rejected <= self.allowed() && self.worst >= 1.0 && self.common.abs() < SIGMAS
    }

    /// The pictures must agree.
    pub(super) fn check(&self, checks: &mut Checks, at: &str) {
        checks.at_least("blocks that vary", self.blocks as f64, 8.0, at);
        checks.at_most("share of blocks with p < 0.01", self.rejected, self.allowed(), at);
        checks.at_least("smallest p over its Sidak limit", self.worst, 1.0, at);
        checks.at_most("bias common to all blocks, sigmas", self.common.abs(), SIGMAS, at);
    }
}

pub(super) fn welch(a: &[Vec<f64>], b: &[Vec<f64>], scale: f64) -> Agreement {
    let mut p_values = Vec::new();
    let (mut sum_t, mut sum_variance) = (0.0, 0.0);
    for block in 0..a[0].len() {
        let (ma, ea) = mean_error(&a.iter().map(|r| r[block] * scale).collect::<Vec<_>>());
        let (mb, eb) = mean_error(&b.iter().map(|r| r[block]).collect::<Vec<_>>());
        let variance = ea * ea + eb * eb;
        if variance <= 1e-24 {
            continue;
        }
        let t = (ma - mb) / variance.sqrt();
        let (na, nb) = (a.len() as f64, b.len() as f64);
        let freedom = variance * variance / (ea.powi(4) / (na - 1.0) + eb.powi(4) / (nb - 1.0));
        p_values.push(student_p(t.abs(), freedom));
        sum_t += t;
        sum_variance += freedom / (freedom - 2.0);
    }
    let n = p_values.len();
    let limit = 1.0 - 0.99f64.powf(1.0 / n as f64);
    Agreement {
        blocks: n,
        rejected: 1.0 - p_values.iter().filter(|&&p| p >= 0.01).count() as f64 / n as f64,
        worst: p_values.iter().copied().fold(1.0, f64::min) / limit,
        common: sum_t / sum_variance.sqrt(),
    }
}

/// Two-sided p of Student's t: Simpson's rule over the density, in the variable that makes the tail finite.
fn student_p(t: f64, freedom: f64) -> f64 {
    // P(|T| > t) = c * integral over theta from atan(t / sqrt(v)) to pi/2 of cos^(v-1); normalised by the same from 0.
    let integral = |from: f64| {
        let (n, to) = (2000, std::f64::consts::FRAC_PI_2);
        let h = (to - from) / f64::from(n);
        let f = |i: i32| (from + h * f64::from(i)).cos().max(0.0).powf(freedom - 1.0);
        let weight = |i: i32| match i {
            0 => 1.0,
            _ if i == n => 1.0,
            _ if i % 2 == 1 => 4.0,
            _ => 2.0,
        };
        (0..=n).map(|i| f(i) * weight(i)).sum::<f64>() * h / 3.0
    };
    integral((t / freedom.sqrt()).atan()) / integral(0.0)
}

/// Every other technique against `nee`+`sobol` on the canonical frame, and the same scaled by 1.01, which must be told apart.
pub fn estimators_agree(gpu: &Gpu, size: u32, renders: u32) -> Result<Outcome> {
    let scene = cornell(size);
    let means = |estimator, sampler, seed| {
        let s = Settings { spp: 64, estimator, sampler, ..Settings::default() };
        block_means(&mut Renderer::new(gpu, &scene, &s)?, renders, seed)
    };
    let best = means(Estimator::Nee, Sampler::Sobol, 500)?;
    let mut checks = Checks::default();
    for (estimator, sampler, seed) in [
        (Estimator::Uniform, Sampler::Pcg, 100),
        (Estimator::Cosine, Sampler::Pcg, 200),
        (Estimator::Cosine, Sampler::Sobol, 300),
        (Estimator::Nee, Sampler::Pcg, 400),
    ] {
        let side = means(estimator, sampler, seed)?;
        let at = format!("{estimator}+{sampler}");
        welch(&side, &best, 1.0).check(&mut checks, &at);
        let wrong = welch(&side, &best, 1.01);
        checks.holds("1 % of light too much and not seen", !wrong.accepts(), format_args!("{at}: {wrong:?}"));
    }
    Ok(checks.outcome())
}

#[cfg(test)]
mod tests {
    use super::student_p;

    #[test]
    fn student_p_values() {
        // Tables: t = 2.750 with 30 degrees of freedom has p = 0.01, 2.042 has 0.05.
        assert!((student_p(2.75, 30.0) - 0.01).abs() < 1e-5);
        assert!((student_p(2.0423, 30.0) - 0.05).abs() < 1e-5);
        assert!((student_p(0.0, 30.0) - 1.0).abs() < 1e-12);
    }
}
