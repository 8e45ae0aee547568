//! Scenes: what is rendered, in f64 on the host, before the renderer recentres and packs it.

mod camera;
pub mod family;
pub mod gltf;
mod hash;
mod light;
mod material;
pub mod math;
mod mesh;
pub mod mitsuba;
pub mod rooms;
mod spec;
pub mod tessellate;
pub mod validate;

pub use light::{DeltaKind, DeltaLight, Environment, EnvironmentMap, Falloff};
pub use material::{Bitmap, Bsdf, Checker, Filter, IOR_RANGE, MIN_ROUGHNESS, Material, Picture, Texture, Wrap};
pub use mesh::{MAX_TRIANGLES, Mesh};
pub use spec::{Loaded, Spec};

use glam::{DMat4, DVec3};
use std::f64::consts::PI;
use std::sync::Arc;

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
    /// Triangles.
    Mesh(Arc<Mesh>),
}

impl Geometry {
    /// The surface's area, square world units.
    #[must_use]
    pub fn area(&self) -> f64 {
        match self {
            Self::Sphere { radius, .. } => 4.0 * PI * radius * radius,
            Self::Rectangle { half_u, half_v, .. } => 4.0 * half_u.length() * half_v.length(),
            Self::Disk { half_u, half_v, .. } => PI * half_u.length() * half_v.length(),
            Self::Mesh(mesh) => mesh.area(),
        }
    }

    /// Lower and upper corner of a box, parallel to the axes, that holds the surface; world space.
    #[must_use]
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let (center, reach) = match *self {
            Self::Sphere { center, radius, .. } => (center, DVec3::splat(radius)),
            Self::Rectangle { center, half_u, half_v } => (center, half_u.abs() + half_v.abs()),
            Self::Disk { center, half_u, half_v } => (center, (half_u * half_u + half_v * half_v).map(f64::sqrt)),
            Self::Mesh(ref mesh) => return mesh.bounds(),
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
            Self::Mesh(ref mesh) => return mesh.span(origin, normal),
        };
        let distance = (center - origin).dot(normal);
        (distance - reach, distance + reach)
    }
}

/// A shape with its material and, for a light, its emission.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// Name for messages.
    pub name: String,
    /// Where it is.
    pub geometry: Geometry,
    /// Reflectance, linear RGB, each in [0, 1]; what of it is reflected how, `bsdf` says.
    pub albedo: DVec3,
    /// Where the reflectance varies over the surface.
    pub texture: Option<Texture>,
    /// How it scatters light.
    pub bsdf: Bsdf,
    /// The back scatters as the front does (Mitsuba's `twosided`); it does not emit.
    pub two_sided: bool,
    /// Emitted radiance, linear RGB, each >= 0 and finite; zero for what is no light.
    pub radiance: DVec3,
}

impl Shape {
    /// Its checkerboard, where its texture is one.
    #[must_use]
    pub fn checker(&self) -> Option<Checker> {
        match self.texture {
            Some(Texture::Checker(checker)) => Some(checker),
            _ => None,
        }
    }

    /// Whether light that falls on it from the front may be scattered at all.
    #[must_use]
    pub fn scatters(&self) -> bool {
        !matches!(self.bsdf, Bsdf::Diffuse) || self.texture.is_some() || self.albedo != DVec3::ZERO
    }
}

/// Everything a render needs to know of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The one camera.
    pub camera: Camera,
    /// All shapes, lights included.
    pub shapes: Vec<Shape>,
    /// Lights that no ray meets.
    pub delta_lights: Vec<DeltaLight>,
    /// What surrounds everything; none is black.
    pub environment: Option<Environment>,
}

impl Scene {
    /// A scene whose only lights are shapes.
    #[must_use]
    pub fn new(camera: Camera, shapes: Vec<Shape>) -> Self {
        Self { camera, shapes, delta_lights: Vec::new(), environment: None }
    }

    /// The largest radiance or intensity of any light.
    #[must_use]
    pub fn max_radiance(&self) -> f64 {
        let shapes = self.shapes.iter().map(|shape| shape.radiance.max_element());
        let deltas = self.delta_lights.iter().map(|light| light.intensity.max_element());
        shapes.chain(deltas).chain(self.environment.as_ref().map(Environment::max_radiance)).fold(0.0, f64::max)
    }
}

/// A half line in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts, world space.
    pub origin: DVec3,
    /// Where it goes, unit length, world space.
    pub direction: DVec3,
}
