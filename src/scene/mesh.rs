//! Triangle meshes.

use super::validate::check_point;
use crate::{Error, Result};
use glam::{DMat4, DVec2, DVec3};

/// A triangle whose doubled area is under this part of the squared diagonal of its mesh has no direction to speak of.
const DEGENERATE: f64 = 1e-12;
/// The most triangles of one mesh: what the tables on the device can number.
pub const MAX_TRIANGLES: usize = 1 << 21;

/// Triangles in world space. One-sided as the other shapes; the normal of a triangle (a, b, c) is `(b - a) x (c - a)`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertices.
    pub positions: Vec<DVec3>,
    /// Three vertices each.
    pub triangles: Vec<[u32; 3]>,
    /// A unit normal a vertex, between which the surface is shaded; empty where each triangle is flat.
    pub normals: Vec<DVec3>,
    /// Texture coordinates a vertex; empty where there are none.
    pub uvs: Vec<DVec2>,
}

impl Mesh {
    /// The vertices of a triangle.
    #[must_use]
    pub fn corners(&self, triangle: [u32; 3]) -> [DVec3; 3] {
        triangle.map(|i| self.positions[i as usize])
    }

    /// Twice the area of a triangle, along its normal.
    #[must_use]
    pub fn cross(&self, triangle: [u32; 3]) -> DVec3 {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(c - a)
    }

    /// The area of all triangles, square world units.
    #[must_use]
    pub fn area(&self) -> f64 {
        self.triangles.iter().map(|&triangle| 0.5 * self.cross(triangle).length()).sum()
    }

    /// Lower and upper corner of the box around all vertices.
    #[must_use]
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let all = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        self.positions.iter().fold(all, |(low, high), &p| (low.min(p), high.max(p)))
    }

    /// The least and the greatest distance of a vertex from a plane through `origin`, along its unit `normal`.
    #[must_use]
    pub fn span(&self, origin: DVec3, normal: DVec3) -> (f64, f64) {
        let distances = self.positions.iter().map(|p| (*p - origin).dot(normal));
        distances.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), d| (low.min(d), high.max(d)))
    }

    /// Moves all vertices; normals stay perpendicular to the surface, on the side on which they were.
    pub fn transform(&mut self, to_world: DMat4) {
        let normal_matrix = glam::DMat3::from_mat4(to_world).inverse().transpose();
        self.positions.iter_mut().for_each(|p| *p = to_world.transform_point3(*p));
        self.normals.iter_mut().for_each(|n| *n = unit(normal_matrix * *n));
    }

    /// Turns every triangle and every normal around.
    pub fn flip(&mut self) {
        self.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        self.normals.iter_mut().for_each(|n| *n = DVec3::ZERO - *n);
    }

    /// Drops the triangles that have no area; how many.
    pub fn drop_degenerate(&mut self) -> usize {
        let before = self.triangles.len();
        self.triangles = self.with_area().collect();
        before - self.triangles.len()
    }

    /// The triangles that have an area.
    fn with_area(&self) -> impl Iterator<Item = [u32; 3]> {
        let (low, high) = self.bounds();
        let limit = DEGENERATE * (high - low).length_squared();
        self.triangles.iter().copied().filter(move |t| self.cross(*t).length() > limit)
    }

    /// Normals for shading: at each vertex the mean of its triangles' normals, weighted by their angles there (Thürmer and
    /// Wüthrich 1998, as Mitsuba).
    pub fn smooth(&mut self) {
        let mut normals = vec![DVec3::ZERO; self.positions.len()];
        for &triangle in &self.triangles {
            let (corners, normal) = (self.corners(triangle), self.cross(triangle).normalize_or_zero());
            for (i, &vertex) in triangle.iter().enumerate() {
                let edge = |k: usize| (corners[(i + k) % 3] - corners[i]).normalize_or_zero();
                normals[vertex as usize] += normal * edge(1).angle_between(edge(2));
            }
        }
        // A vertex without a triangle needs some normal.
        self.normals = normals.into_iter().map(|n| n.try_normalize().unwrap_or(DVec3::X)).collect();
    }

    /// Whether corners and coordinates can be worked with.
    pub(super) fn is_sound(&self) -> bool {
        self.lost_triangle().is_none() && self.check_positions().is_ok()
    }

    fn lost_triangle(&self) -> Option<&[u32; 3]> {
        self.triangles.iter().find(|t| t.iter().any(|&i| i as usize >= self.positions.len()))
    }

    fn check_positions(&self) -> Result<()> {
        self.positions.iter().try_for_each(|p| check_point("vertex", *p))
    }

    /// Refuses what cannot be rendered: no triangle, too many, corners that do not exist, triangles without area,
    /// coordinates out of range, normals without direction, arrays of different lengths.
    pub fn validate(&self) -> Result<()> {
        let (vertices, triangles) = (self.positions.len(), self.triangles.len());
        let fail = |message: String| Err(Error::input(message));
        if triangles == 0 || triangles > MAX_TRIANGLES {
            return fail(format!("{triangles} triangles; it must have 1 to {MAX_TRIANGLES}"));
        }
        for (what, length) in [("normals", self.normals.len()), ("texture coordinates", self.uvs.len())] {
            if length != 0 && length != vertices {
                return fail(format!("{length} {what} for {vertices} vertices"));
            }
        }
        if let Some(triangle) = self.lost_triangle() {
            return fail(format!("a triangle has the vertices {triangle:?} of {vertices}"));
        }
        self.check_positions()?;
        if let Some(normal) = self.normals.iter().find(|n| (n.length() - 1.0).abs() > 1e-3 || !n.is_finite()) {
            return fail(format!("a vertex has the normal {normal}; it must have a length"));
        }
        if let Some(uv) = self.uvs.iter().find(|uv| !uv.is_finite()) {
            return fail(format!("a vertex has the texture coordinates {uv}"));
        }
        match triangles - self.with_area().count() {
            0 => Ok(()),
            some => fail(format!("{some} triangles have no area")),
        }
    }
}

/// The vector at length 1; one that has it keeps its bits.
fn unit(v: DVec3) -> DVec3 {
    if (v.length_squared() - 1.0).abs() <= 4.0 * f64::EPSILON { v } else { v.normalize_or_zero() }
}
