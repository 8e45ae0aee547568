//! A sphere light over a patch, by the closed form.

use super::support::*;
use super::{Case, Checks, Outcome, sampling};
use crate::Result;
use crate::gpu::Gpu;
use crate::render::Estimator;
use crate::scene::Scene;
use glam::DVec3;

pub(super) const CASES: &[Case] = &[
    Case {
        number: "T4",
        name: "sphere light on a patch",
        claim: "a patch is lit by a sphere light above, beside and partly below its horizon by the closed form",
        run: sphere_light,
    },
    Case {
        number: "T5",
        name: "tiny and huge lights",
        claim: "the same for lights of 1e-7 to 0.9999 of their distance (offsets of rays resolve no smaller gap), and 1 - cos of their cone is that of f64",
        run: light_sizes,
    },
];

/// Form factor of a sphere light at distance 1 and radius s on a patch whose normal has cosine c with its direction.
fn form_factor(c: f64, s: f64) -> f64 {
    let s2 = s * s;
    if c >= s {
        return s2 * c;
    }
    if c <= -s {
        return 0.0;
    }
    let h2 = 1.0 / s2;
    let k2 = 1.0 - h2 * c * c;
    let a = s2 * (c * (-c * ((h2 - 1.0) / (1.0 - c * c)).sqrt()).acos() - (k2 * (h2 - 1.0)).sqrt());
    (a + (k2 / (h2 - 1.0)).sqrt().atan()) / std::f64::consts::PI
}

/// The patch is in the plane y = 0; the light stands at the angle from its normal and has the power of one of radius 1.
fn patch_scene(degrees: f64, s: f64) -> Scene {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let half = 1e-4;
    let patch = rectangle(DVec3::ZERO, DVec3::Z * half, DVec3::X * half, 0.8, 0.0);
    let light = sphere([sin, cos, 0.0], s, 0.0, 1.0 / (s * s));
    let camera = look(DVec3::new(-0.5e-4, 1e-4, 0.2e-4), DVec3::ZERO, 10.0, 24, 24);
    Scene::new(camera, vec![patch, light])
}

/// The factor that [`patch_scene`] has.
fn patch_factor(degrees: f64, s: f64) -> f64 {
    form_factor(if degrees == 90.0 { 0.0 } else { degrees.to_radians().cos() }, s)
}

fn sphere_light(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for (degrees, s, listed) in [
        (0.0f64, 0.3, 0.09),
        (60.0, 0.3, 0.045),
        (90.0, 0.3, 0.00589220),
        (100.0, 0.3, 0.00077147),
        (89.0, 0.9, 0.23866671),
        (120.0, 0.9, 0.06231622),
        (45.0, 0.99, 0.78301420),
        (30.0, 1e-3, 8.6602540e-7),
    ] {
        let exact = patch_factor(degrees, s);
        let at = format!("{degrees} degrees, radius {s}");
        checks.at_most("closed form and table", (exact - listed).abs(), 1e-8, &at);
        // 5e-4: rays start 2e-5 of the scene off the surface, and the patch is not a point; at s = 0.99 the light is
        // 0.01 away, so 1.2e-4 of displacement moves the factor by about a per cent of its slope.
        let displaced = if s > 0.98 { 3e-3 } else { 5e-4 };
        for choice in techniques() {
            if choice.0 != Estimator::Nee && s < 0.1 {
                continue; // only light sampling finds so small a light
            }
            // Without light sampling the faintest of these is noise, which the other estimators' bars do not ask about.
            let (spp, precision) = if choice.0 == Estimator::Nee { (256, 0.02) } else { (1024, 0.05) };
            check_patch(&mut checks, gpu, (degrees, s), &settings(spp, 1, choice), (displaced, precision))?;
        }
    }
    Ok(checks.outcome())
}

fn check_patch(
    checks: &mut Checks,
    gpu: &Gpu,
    (degrees, s): (f64, f64),
    settings: &crate::render::Settings,
    bars: (f64, f64),
) -> Result<()> {
    let at = format!("{}+{}, {degrees} degrees, radius {s}", settings.estimator, settings.sampler);
    let values = surface(&render(gpu, &patch_scene(degrees, s), settings)?, "B");
    checks.count("pixels beside the patch", values.len() as u64, 24 * 24, &at);
    check_mean(checks, &values, 0.8 * patch_factor(degrees, s) / (s * s), bars, &at);
    Ok(())
}

/// By what share the factor changes where rays start `offset` above the patch: the light then stands nearer and lower.
fn displaced(degrees: f64, s: f64, offset: f64) -> f64 {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let to_light = DVec3::new(sin, cos - offset, 0.0);
    let (distance, c) = (to_light.length(), to_light.normalize().y);
    (form_factor(c, s / distance) / patch_factor(degrees, s) - 1.0).abs()
}

fn light_sizes(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for degrees in [0.0, 45.0, 80.0] {
        for s in [1e-7, 1e-6, 1e-5, 1e-4, 1e-2, 0.1, 0.5, 0.9, 0.99, 0.999, 0.9999] {
            // Rays start 2e-5 of the scene's half extent off, which is under 1 here. 1e-5: the patch is no point.
            let bias = displaced(degrees, s, 2e-5) + 1e-5;
            for choice in techniques().filter(|(e, _)| *e == Estimator::Nee) {
                check_patch(&mut checks, gpu, (degrees, s), &settings(256, 1, choice), (bias, 0.02))?;
            }
        }
    }
    for [s2, one_minus_cos] in sampling::cones(gpu)? {
        let exact = f64::from(s2) / (1.0 + (1.0 - f64::from(s2)).sqrt());
        let ulp = f64::from(f32::from_bits((exact as f32).to_bits() + 1) - exact as f32);
        let off = (f64::from(one_minus_cos) - exact).abs() / ulp;
        checks.at_most("1 - cos of the cone, ULP", off, 4.0, format_args!("(r/d)^2 = {s2:e}"));
    }
    Ok(checks.outcome())
}
