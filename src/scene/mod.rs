//! Scenes: what is rendered, in f64 on the host, before the renderer recentres and packs it.

mod camera;
pub mod family;
mod hash;
pub mod math;
pub mod mitsuba;
pub mod rooms;
mod spec;
pub mod validate;

pub use spec::{Loaded, Spec};

use glam::{DMat4, DVec2, DVec3, Vec2Swizzles};
use std::f64::consts::PI;

/// What makes a camera blur what is not in focus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Radius of the aperture, world units, > 0.
    pub aperture_radius: f64,
    /// Depth along the view direction of the plane that is in focus, world units, > 0.
    pub focus_distance: f64,
}

/// A pinhole camera, or one with a thin lens.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Camera to world. In camera space x points right, y up, and the view direction is -z. Rigid (no scale).
    pub to_world: DMat4,
    /// Horizontal field of view in degrees (0 < fov < 180).
    pub fov_x_degrees: f64,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// The lens; none for a pinhole.
    pub lens: Option<Lens>,
}

/// The surface of one shape.
#[derive(Clone, Debug, PartialEq)]
pub enum Geometry {
    /// A sphere. One-sided along its normal, as Mitsuba's `diffuse` and `area`.
    Sphere {
        /// Centre, world space.
        center: DVec3,
        /// Radius, world units, > 0.
        radius: f64,
        /// The normal points to the centre (a cavity; Mitsuba's `flip_normals`), not outward.
        inward: bool,
    },
    /// A rectangle `center + s*half_u + t*half_v`, s and t in [-1, 1]; its normal is `half_u x half_v`. One-sided, as
    /// Mitsuba's `diffuse` and `area`: the back neither reflects nor emits, but blocks.
    Rectangle {
        /// Centre, world space.
        center: DVec3,
        /// Half of the first edge.
        half_u: DVec3,
        /// Half of the second edge; perpendicular to `half_u`.
        half_v: DVec3,
    },
    /// A disk `center + s*half_u + t*half_v` with s² + t² at most 1; where the radii differ, an ellipse. Otherwise as a
    /// rectangle.
    Disk {
        /// Centre, world space.
        center: DVec3,
        /// One radius.
        half_u: DVec3,
        /// The other radius; perpendicular to `half_u`.
        half_v: DVec3,
    },
}

impl Geometry {
    /// The surface's area, square world units.
    #[must_use]
    pub fn area(&self) -> f64 {
        match self {
            Self::Sphere { radius, .. } => 4.0 * PI * radius * radius,
            Self::Rectangle { half_u, half_v, .. } => 4.0 * half_u.length() * half_v.length(),
            Self::Disk { half_u, half_v, .. } => PI * half_u.length() * half_v.length(),
        }
    }

    /// Lower and upper corner of a box, parallel to the axes, that holds the surface; world space.
    #[must_use]
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let (center, reach) = match *self {
            Self::Sphere { center, radius, .. } => (center, DVec3::splat(radius)),
            Self::Rectangle { center, half_u, half_v } => (center, half_u.abs() + half_v.abs()),
            Self::Disk { center, half_u, half_v } => (center, (half_u * half_u + half_v * half_v).map(f64::sqrt)),
        };
        (center - reach, center + reach)
    }

    /// The least and the greatest distance of the surface from a plane through `origin`, along its unit `normal`.
    #[must_use]
    pub fn span(&self, origin: DVec3, normal: DVec3) -> (f64, f64) {
        let (center, reach) = match *self {
            Self::Sphere { center, radius, .. } => (center, radius),
            Self::Rectangle { center, half_u, half_v } => (center, half_u.dot(normal).abs() + half_v.dot(normal).abs()),
            Self::Disk { center, half_u, half_v } => (center, half_u.dot(normal).hypot(half_v.dot(normal))),
        };
        let distance = (center - origin).dot(normal);
        (distance - reach, distance + reach)
    }
}

/// A checkerboard in the surface's parameters (u, v), as Mitsuba's `checkerboard` texture: the cell of (u, v) follows from
/// `uv = repeats * (u, v) + offset`; where both or neither of the fractions of uv are above 1/2 lies the first reflectance, elsewhere the
/// second. On a rectangle u and v run from 0 to 1 along `half_u` and `half_v`; on a sphere u is the longitude about z from x, as
/// part of a turn, and v the angle from z as part of half a turn. On a disk u is the distance from the centre as part of the
/// radius, and v the angle from `half_u` toward `half_v` as part of a turn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checker {
    /// The second reflectance, linear RGB, each in [0, 1]; [`Shape::albedo`] is the first.
    pub albedo: DVec3,
    /// Pairs of cells along u and v.
    pub repeats: DVec2,
    /// Shift of the cells, in pairs.
    pub offset: DVec2,
}

impl Checker {
    /// The same cells where u and v change places.
    #[must_use]
    pub fn swapped(self) -> Self {
        Self { repeats: self.repeats.yx(), offset: self.offset.yx(), ..self }
    }

    /// The same cells where v runs the other way.
    #[must_use]
    pub fn mirrored(self) -> Self {
        let DVec2 { x, y } = self.repeats;
        Self { repeats: DVec2::new(x, -y), offset: self.offset + DVec2::new(0.0, y), ..self }
    }
}

/// A shape with its diffuse material and, for a light, its emission.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// Name for messages.
    pub name: String,
    /// Where it is.
    pub geometry: Geometry,
    /// Lambertian reflectance, linear RGB, each in [0, 1].
    pub albedo: DVec3,
    /// A second reflectance in a checkerboard; none where the surface has one colour.
    pub checker: Option<Checker>,
    /// Emitted radiance, linear RGB, each >= 0 and finite; zero for what is no light.
    pub radiance: DVec3,
}

/// Everything a render needs to know of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The one camera.
    pub camera: Camera,
    /// All shapes, lights included.
    pub shapes: Vec<Shape>,
}

/// A half line in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts, world space.
    pub origin: DVec3,
    /// Where it goes, unit length, world space.
    pub direction: DVec3,
}
