//! Random scenes of many kinds: version 1 of the family `rooms:N`, for training and for measuring how far a network carries.
//!
//! Beside [`super::family`], whose box and five spheres it never shows: rooms of other proportions, colours and patterns, 1 to
//! 40 spheres, one to three lights of any colour and size, cameras near and far, radiance over three decades. The numbers of
//! shapes come in twelve combinations, so that a renderer needs few pipelines.

use super::camera::look_at_matrix;
use super::family::{between, uniform_of};
use super::math::sin_cos_degrees;
use super::{Camera, Checker, Geometry, Material, Scene, Shape, Texture};
use glam::{DVec2, DVec3};

/// The version of the family; it changes whenever any scene of it does.
pub const ROOMS_VERSION: u32 = 1;

/// How many shapes a scene has, and whether surfaces may have patterns.
struct Kind {
    spheres: usize,
    sphere_lights: usize,
    rect_lights: usize,
    patterns: bool,
}

const fn kind(spheres: usize, sphere_lights: usize, rect_lights: usize, patterns: bool) -> Kind {
    Kind { spheres, sphere_lights, rect_lights, patterns }
}

/// Scene N is of one of these, each as likely.
const KINDS: [Kind; 12] = [
    kind(1, 1, 0, true),
    kind(3, 1, 0, false),
    kind(3, 0, 1, true),
    kind(4, 1, 0, true),
    kind(4, 2, 0, false),
    kind(6, 1, 0, false),
    kind(6, 0, 1, true),
    kind(6, 1, 1, false),
    kind(10, 1, 0, true),
    kind(10, 3, 0, false),
    kind(20, 1, 0, true),
    kind(38, 2, 0, false),
];

/// Numbers of one scene, drawn one after another.
struct Draws {
    n: u64,
    next: u32,
}

impl Draws {
    fn unit(&mut self) -> f64 {
        const SALT: u32 = 0x726f_6f6d; // "room"
        self.next += 1;
        uniform_of(self.n, self.next - 1, SALT)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        between(low, high, self.unit())
    }

    /// True with this probability.
    fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    fn color(&mut self, low: f64, high: f64) -> DVec3 {
        DVec3::new(self.between(low, high), self.between(low, high), self.between(low, high))
    }

    /// As likely in any factor of two from `low` to `high`, both powers of two times a common number.
    fn scale(&mut self, low: f64, doublings: u32) -> f64 {
        let steps = self.between(0.0, f64::from(doublings));
        // Between powers of two on a line: no libm, the same bits everywhere.
        let (whole, part) = (steps.floor(), steps.fract());
        low * whole_power(whole) * (1.0 + part)
    }
}

fn whole_power(exponent: f64) -> f64 {
    f64::from(1u32 << exponent as u32)
}

/// Scene N of the family, 768x768.
pub fn rooms(n: u64) -> Scene {
    let mut draws = Draws { n, next: 0 };
    let kind = &KINDS[(draws.unit() * KINDS.len() as f64) as usize];
    let half = DVec3::new(draws.between(0.8, 1.7), draws.between(0.7, 1.4), draws.between(0.8, 2.0));
    let camera = camera(&mut draws, half);
    let level = draws.scale(1.0 / 32.0, 10);
    let mut shapes = walls(&mut draws, half, kind.patterns);
    for i in 0..kind.rect_lights {
        shapes.push(ceiling_light(&mut draws, half, level, i));
    }
    let mut placed = Placed { half, eye: camera.origin(), spheres: Vec::new() };
    let count = kind.spheres + kind.sphere_lights;
    let largest = largest_radius(count);
    for i in 0..kind.spheres {
        let wanted = draws.between(0.3, 1.0) * largest;
        let (center, radius) = placed.place(&mut draws, wanted);
        shapes.push(sphere(&mut draws, format!("sphere-{}", i + 1), (center, radius), kind.patterns));
    }
    for i in 0..kind.sphere_lights {
        shapes.push(sphere_light(&mut draws, &mut placed, level, largest, i));
    }
    Scene::new(camera, shapes)
}

/// The largest sphere of so many: all of them fill about the same part of the room.
fn largest_radius(count: usize) -> f64 {
    match count {
        0..=2 => 0.55,
        3..=5 => 0.42,
        6..=8 => 0.36,
        9..=13 => 0.3,
        14..=24 => 0.24,
        _ => 0.18,
    }
}

/// Outside the open front or inside, looking somewhere into the depth of the room.
fn camera(draws: &mut Draws, half: DVec3) -> Camera {
    let fov = draws.between(32.0, 80.0);
    let (sin, cos) = sin_cos_degrees(0.5 * fov);
    let distance = draws.between(0.7, 1.3) * half.x.max(half.y) * cos / sin;
    let z = (half.z * draws.between(-0.2, 1.0) + distance).clamp(0.5 * half.z, half.z + 3.0);
    let eye = DVec3::new(draws.between(-0.5, 0.5) * half.x, draws.between(-0.6, 0.6) * half.y, z);
    let target = DVec3::new(draws.between(-0.4, 0.4) * half.x, draws.between(-0.4, 0.4) * half.y, -half.z);
    let to_world = look_at_matrix(eye, target, DVec3::Y).expect("the target lies behind the eye's plane, far from up");
    Camera { to_world, fov_x_degrees: fov, width: 768, height: 768, lens: None }
}

/// Floor, ceiling, back, left and right; the front is open. Normals point inward.
fn walls(draws: &mut Draws, half: DVec3, patterns: bool) -> Vec<Shape> {
    let shared = if draws.chance(0.6) { DVec3::splat(draws.between(0.5, 0.85)) } else { draws.color(0.2, 0.85) };
    let (x, y, z) = (DVec3::X * half.x, DVec3::Y * half.y, DVec3::Z * half.z);
    let faces = [("floor", -y, z, x), ("ceiling", y, x, z), ("back", -z, x, y), ("left", -x, y, z), ("right", x, z, y)];
    let wall = |(i, (name, center, half_u, half_v)): (usize, (&str, DVec3, DVec3, DVec3))| {
        let own = draws.chance(if i < 3 { 0.3 } else { 0.7 });
        let color = draws.color(0.05, 0.85);
        let texture = pattern(draws, patterns, 12.0).map(Texture::Checker);
        let material = Material { texture, ..Material::diffuse(if own { color } else { shared }) };
        material.shape(name.to_owned(), Geometry::Rectangle { center, half_u, half_v }, DVec3::ZERO)
    };
    faces.into_iter().enumerate().map(wall).collect()
}

/// Checkers or stripes on half of the surfaces that may have them.
fn pattern(draws: &mut Draws, patterns: bool, most: f64) -> Option<Checker> {
    /// Stripes are checkers whose cells never end in one direction.
    const ENDLESS: f64 = 1e-3;
    let (has, stripes, other_way) = (draws.chance(0.5), draws.unit(), draws.chance(0.5));
    let albedo = draws.color(0.03, 0.9);
    let (repeats, offset) = (draws.between(1.0, most), draws.unit());
    let (u, v) = match stripes < 0.4 {
        true if other_way => (ENDLESS, repeats),
        true => (repeats, ENDLESS),
        false => (repeats, repeats),
    };
    let offset = DVec2::new(if u == ENDLESS { 0.0 } else { offset }, if v == ENDLESS { 0.0 } else { offset });
    (patterns && has).then_some(Checker { albedo, repeats: DVec2::new(u, v), offset })
}

fn sphere(draws: &mut Draws, name: String, (center, radius): (DVec3, f64), patterns: bool) -> Shape {
    let geometry = Geometry::Sphere { center, radius, inward: false };
    let albedo = draws.color(0.03, 0.9);
    let texture = pattern(draws, patterns, 6.0).map(Texture::Checker);
    Material { texture, ..Material::diffuse(albedo) }.shape(name, geometry, DVec3::ZERO)
}

/// White or coloured, of luminance about 1.
fn tint(draws: &mut Draws) -> DVec3 {
    let (white, color) = (draws.chance(0.5), draws.color(0.1, 1.0));
    if white { DVec3::ONE } else { color / color.max_element() }
}

/// A sphere light of any size, in a quarter of the scenes hidden from the eye by a sphere.
fn sphere_light(draws: &mut Draws, placed: &mut Placed, level: f64, largest: f64, i: usize) -> Shape {
    let wanted = draws.between(0.03, 1.0) * largest * 0.8;
    let hidden = draws.chance(0.25);
    let behind = draws.between(0.05, 0.3);
    let hiding = (draws.unit() * placed.spheres.len() as f64) as usize;
    let place = hidden.then(|| placed.behind(hiding, wanted, behind)).flatten();
    let (center, radius) = place.unwrap_or_else(|| placed.place(draws, wanted));
    let power = level * draws.scale(0.5, 2);
    let radiance = tint(draws) * (12.0 * (0.2 / radius) * (0.2 / radius) * power);
    let name = format!("light-{}", i + 1);
    Material::diffuse(DVec3::ZERO).shape(name, Geometry::Sphere { center, radius, inward: false }, radiance)
}

/// A rectangle a little under the ceiling.
fn ceiling_light(draws: &mut Draws, half: DVec3, level: f64, i: usize) -> Shape {
    let (a, b) = (draws.between(0.05, 0.5) * half.x, draws.between(0.05, 0.5) * half.z);
    let reach = DVec2::new(half.x - a - 0.05, half.z - b - 0.05);
    let center = DVec3::new(draws.between(-reach.x, reach.x), half.y - 0.02, draws.between(-reach.y, reach.y));
    let power = level * draws.scale(0.5, 2);
    // The radiance that a sphere light of this power and area has.
    let radiance = tint(draws) * (12.0 * 0.04 * std::f64::consts::PI / (4.0 * a * b) * power);
    let geometry = Geometry::Rectangle { center, half_u: DVec3::X * a, half_v: DVec3::Z * b };
    Material::diffuse(DVec3::ZERO).shape(format!("panel-{}", i + 1), geometry, radiance)
}

/// Spheres that have their place, none touching another, a wall or the eye.
struct Placed {
    half: DVec3,
    eye: DVec3,
    spheres: Vec<(DVec3, f64)>,
}

impl Placed {
    const GAP: f64 = 0.015;
    /// The eye keeps this distance from every surface.
    const CLEARANCE: f64 = 0.2;

    fn fits(&self, center: DVec3, radius: f64) -> bool {
        let inside = (self.half - center.abs()).min_element() >= radius + Self::GAP;
        let clear = self.eye.distance(center) >= radius + Self::CLEARANCE;
        inside && clear && self.spheres.iter().all(|(c, r)| c.distance(center) >= r + radius + Self::GAP)
    }

    /// A free place for a sphere, which shrinks where none is found.
    fn place(&mut self, draws: &mut Draws, wanted: f64) -> (DVec3, f64) {
        let mut radius = wanted;
        loop {
            for _ in 0..16 {
                let limit = self.half - (radius + Self::GAP);
                let center = DVec3::new(
                    draws.between(-limit.x, limit.x),
                    draws.between(-limit.y, limit.y),
                    draws.between(-limit.z, limit.z),
                );
                if self.fits(center, radius) {
                    self.spheres.push((center, radius));
                    return (center, radius);
                }
            }
            radius *= 0.9;
        }
    }

    /// The place behind sphere `hiding`, seen from the eye, where a smaller sphere is free to lie.
    fn behind(&mut self, hiding: usize, wanted: f64, gap: f64) -> Option<(DVec3, f64)> {
        let (center, radius) = *self.spheres.get(hiding)?;
        let own = wanted.min(0.6 * radius);
        let center = center + (center - self.eye).normalize() * (radius + own + gap);
        self.fits(center, own).then(|| {
            self.spheres.push((center, own));
            (center, own)
        })
    }
}
