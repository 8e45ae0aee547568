//! Random scenes: version 1 of the family `spheres:N`, and its animation.
//!
//! Everything follows from N by a counter: draw `k` of scene N is `pcg4d(N low, N high, k, salt)` (Jarzynski and
//! Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020), its first 32 bits and the upper 21 of its second
//! making a number of 53 bits in [0, 1). Sines come from [`super::math`], so the scenes have the same bits everywhere.
//!
//! The box, its colours, the field of view and the camera's base are those of the canonical frame ([`canonical`]).

use super::math::{positive_zero, sin_cos_degrees};
use super::{Camera, Geometry, Material, Scene, mitsuba};
use glam::{DMat3, DMat4, DVec3};
use std::ops::RangeInclusive;

/// The version of the family; it changes whenever any scene of it does, and then earlier figures no longer hold.
pub const FAMILY_VERSION: u32 = 1;

/// The scenes kept for measurements; training refuses them.
pub const HELD_OUT: RangeInclusive<u64> = 90_000..=99_999;

/// Frames after which the animation of [`frame`] repeats.
pub const FRAME_PERIOD: u32 = 240;

/// The least gap between two spheres and between a sphere and a wall, scene units.
pub const MIN_GAP: f64 = 0.02;

/// The canonical frame as Mitsuba 3 XML.
pub const CANONICAL_XML: &str = include_str!("../../scenes/cornell-spheres.xml");

const SPHERE_NAMES: [&str; 5] = ["light", "sphere-1", "sphere-2", "sphere-3", "sphere-4"];
const SPHERE_COUNT: usize = SPHERE_NAMES.len();

/// Where each kind of draw begins; the centres come last, for they are drawn until they fit.
mod draw {
    pub const CAMERA: u32 = 0; // x, y, z, yaw, pitch
    pub const RADIUS: u32 = 8; // one a sphere
    pub const ALBEDO: u32 = 16; // three a sphere
    pub const CENTER: u32 = 1024; // three a sphere, 15 a try
    pub const PATH: u32 = 0x8000_0000; // per sphere and axis: PATH_STRIDE draws
    pub const PATH_STRIDE: u32 = 4;
    pub const PAN: u32 = 0xc000_0000;
}

/// Whether scene N is held out from training.
pub fn is_held_out(n: u64) -> bool {
    HELD_OUT.contains(&n)
}

/// The canonical frame, 768x768.
pub fn canonical() -> Scene {
    mitsuba::load_str(CANONICAL_XML, "cornell-spheres.xml", &mitsuba::Options::default())
        .expect("the embedded scene is valid")
        .scene
}

/// Scene N of the family, 768x768: the box of the canonical frame, one sphere as the light, four diffuse spheres, the
/// camera moved by up to 0.3 along each axis and turned by up to 6 degrees in yaw and pitch.
pub fn spheres(n: u64) -> Scene {
    Member::new(n).at(0)
}

/// Frame t of the animation of scene N: the spheres move on closed paths inside the box and the camera pans in a fixed
/// random direction. Frame 0 is [`spheres`]; frame t + [`FRAME_PERIOD`] is frame t; in every frame all gaps are at least
/// [`MIN_GAP`].
pub fn frame(n: u64, t: u32) -> Scene {
    Member::new(n).at(t)
}

/// All that defines scene N and its animation.
struct Member {
    origin: DVec3,
    yaw_degrees: f64,
    pitch_degrees: f64,
    /// The direction of the pan: cosine (yaw) and sine (pitch).
    pan: (f64, f64),
    paths: [Path; SPHERE_COUNT],
    albedos: [DVec3; SPHERE_COUNT],
}

impl Member {
    fn new(n: u64) -> Self {
        let u = |index: u32| uniform(n, index);
        let radius = |i: usize| {
            let u = u(draw::RADIUS + i as u32);
            if i == 0 { between(0.12, 0.28, u) } else { between(0.15, 0.40, u) }
        };
        let albedo = |i: usize| match i {
            0 => DVec3::ZERO,
            _ => DVec3::from_array([0, 1, 2].map(|axis| between(0.05, 0.9, u(draw::ALBEDO + 3 * i as u32 + axis)))),
        };
        let radii: [f64; SPHERE_COUNT] = std::array::from_fn(radius);
        let centers = draw_centers(n, &radii);
        let angle = sin_cos_degrees(360.0 * u(draw::PAN));
        Self {
            origin: DVec3::from_array([0, 1, 2].map(|axis| between(-0.3, 0.3, u(draw::CAMERA + axis)))),
            yaw_degrees: between(-6.0, 6.0, u(draw::CAMERA + 3)),
            pitch_degrees: between(-6.0, 6.0, u(draw::CAMERA + 4)),
            pan: (angle.1, angle.0),
            paths: std::array::from_fn(|i| Path::new(n, i as u32, centers[i], radii[i])),
            albedos: std::array::from_fn(albedo),
        }
    }

    fn at(mut self, t: u32) -> Scene {
        let t = t % FRAME_PERIOD;
        if t != 0 {
            keep_apart(&mut self.paths);
        }
        let mut scene = canonical();
        scene.camera = self.camera(&scene.camera, t);
        scene.shapes.retain(|shape| matches!(shape.geometry, Geometry::Rectangle { .. }));
        for (i, path) in self.paths.iter().enumerate() {
            let radiance = if i == 0 { 12.0 * (0.2 / path.radius) * (0.2 / path.radius) } else { 0.0 };
            let geometry = Geometry::Sphere { center: path.center(t), radius: path.radius, inward: false };
            let material = Material::diffuse(self.albedos[i]);
            scene.shapes.push(material.shape(SPHERE_NAMES[i].to_owned(), geometry, DVec3::splat(radiance)));
        }
        scene
    }

    /// Turns the base camera, which looks down -z: first pitch (up is positive), then yaw (left is positive).
    fn camera(&self, base: &Camera, t: u32) -> Camera {
        const PAN_DEGREES: f64 = 5.0;
        let swing = PAN_DEGREES * sin_cos_degrees(phase_degrees(t, 1)).0;
        let (sy, cy) = sin_cos_degrees(self.yaw_degrees + swing * self.pan.0);
        let (sp, cp) = sin_cos_degrees(self.pitch_degrees + swing * self.pan.1);
        let pitch = DMat3::from_cols(DVec3::X, DVec3::new(0.0, cp, sp), DVec3::new(0.0, -sp, cp));
        let yaw = DMat3::from_cols(DVec3::new(cy, 0.0, -sy), DVec3::Y, DVec3::new(sy, 0.0, cy));
        let to_world = DMat4::from_mat3_translation(yaw * pitch, base.origin() + self.origin);
        Camera { to_world: super::camera::without_negative_zeros(to_world), ..base.clone() }
    }
}

/// The closed path of one sphere: on each axis a sine whose range lies inside the box and holds the start.
#[derive(Clone, Debug)]
struct Path {
    start: DVec3,
    radius: f64,
    /// The factor of all movement, 0 (at rest) to 1.
    scale: f64,
    /// Per axis: amplitude times the sine and cosine of the phase at t = 0, and turns a period.
    axes: [(f64, f64, u32); 3],
}

impl Path {
    fn new(n: u64, sphere: u32, start: DVec3, radius: f64) -> Self {
        /// The farthest that a path goes from its start to one side.
        const REACH: f64 = 0.5;
        let limit = 1.0 - (radius + MIN_GAP);
        let axis = |axis: usize| {
            let first = draw::PATH + draw::PATH_STRIDE * (3 * sphere + axis as u32);
            let u = |k: u32| uniform(n, first + k);
            let below = u(0) * (start[axis] + limit).clamp(0.0, REACH);
            let above = u(1) * (limit - start[axis]).clamp(0.0, REACH);
            // The start lies `sin` above the middle of a range of half width `amplitude`.
            let (amplitude, sin) = (0.5 * (below + above), 0.5 * (below - above));
            let cos = (amplitude * amplitude - sin * sin).max(0.0).sqrt();
            (sin, if u(2) < 0.5 { cos } else { -cos }, if u(3) < 0.7 { 1 } else { 2 })
        };
        Self { start, radius, scale: 1.0, axes: [axis(0), axis(1), axis(2)] }
    }

    /// The centre at frame t; the start itself at t = 0.
    fn center(&self, t: u32) -> DVec3 {
        let offset = self.axes.map(|(amplitude_sin, amplitude_cos, turns)| {
            let (sin, cos) = sin_cos_degrees(phase_degrees(t, turns));
            self.scale * (amplitude_cos * sin + amplitude_sin * (cos - 1.0))
        });
        DVec3::from_array((self.start + DVec3::from_array(offset)).to_array().map(positive_zero))
    }
}

/// Shrinks the movement of spheres that would come too close in any frame of the period. It ends: each round shrinks
/// one pair at least, and a pair at rest keeps the gap of frame 0.
fn keep_apart(paths: &mut [Path; SPHERE_COUNT]) {
    const SHRINK: f64 = 0.85;
    const REST: f64 = 1.0 / 64.0;
    let mut shrunk = true;
    while std::mem::take(&mut shrunk) {
        for (i, j) in (0..SPHERE_COUNT).flat_map(|i| (0..i).map(move |j| (i, j))) {
            if (paths[i].scale > 0.0 || paths[j].scale > 0.0) && !pair_fits(&paths[i], &paths[j]) {
                for k in [i, j] {
                    let scale = paths[k].scale * SHRINK;
                    paths[k].scale = if scale < REST { 0.0 } else { scale };
                }
                shrunk = true;
            }
        }
    }
}

fn pair_fits(a: &Path, b: &Path) -> bool {
    (0..FRAME_PERIOD).all(|t| apart(a.center(t), a.radius, b.center(t), b.radius))
}

fn apart(a: DVec3, a_radius: f64, b: DVec3, b_radius: f64) -> bool {
    a.distance(b) >= a_radius + b_radius + MIN_GAP
}

fn phase_degrees(t: u32, turns: u32) -> f64 {
    f64::from(t * turns % FRAME_PERIOD) * (360.0 / f64::from(FRAME_PERIOD))
}

/// Draws all centres together until all gaps hold, so that they are uniform among the arrangements that fit.
fn draw_centers(n: u64, radii: &[f64; SPHERE_COUNT]) -> [DVec3; SPHERE_COUNT] {
    let mut first = draw::CENTER;
    loop {
        let centers: [DVec3; SPHERE_COUNT] = std::array::from_fn(|i| {
            let limit = 1.0 - (radii[i] + MIN_GAP);
            let draw = |axis: u32| between(-limit, limit, uniform(n, first + 3 * i as u32 + axis));
            DVec3::new(draw(0), draw(1), draw(2))
        });
        let fits = |i: usize| (0..i).all(|j| apart(centers[i], radii[i], centers[j], radii[j]));
        if (0..SPHERE_COUNT).all(fits) {
            return centers;
        }
        first += 3 * SPHERE_COUNT as u32;
    }
}

pub(super) fn between(low: f64, high: f64, u: f64) -> f64 {
    positive_zero(low + (high - low) * u)
}

fn uniform(n: u64, index: u32) -> f64 {
    const SALT: u32 = 0x6c69_6d70; // "limp"
    uniform_of(n, index, SALT)
}

/// Draw `index` of scene N of the family with this salt, in [0, 1).
pub(super) fn uniform_of(n: u64, index: u32, salt: u32) -> f64 {
    let bits = pcg4d([n as u32, (n >> 32) as u32, index, salt]);
    let bits = (u64::from(bits[0]) << 21) | u64::from(bits[1] >> 11);
    bits as f64 * (1.0 / (1u64 << 53) as f64)
}

/// The hash pcg4d of Jarzynski and Olano.
fn pcg4d(v: [u32; 4]) -> [u32; 4] {
    let mut v = v.map(|x| x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    mix(&mut v);
    v = v.map(|x| x ^ (x >> 16));
    mix(&mut v);
    v
}

fn mix(v: &mut [u32; 4]) {
    for (to, a, b) in [(0, 1, 3), (1, 2, 0), (2, 0, 1), (3, 1, 2)] {
        v[to] = v[to].wrapping_add(v[a].wrapping_mul(v[b]));
    }
}
