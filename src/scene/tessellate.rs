//! Meshes that are computed, to put the path tracer to the test.

use super::Mesh;
use glam::DVec3;
use std::collections::HashMap;
use std::f64::consts::TAU;

/// A unit sphere of 20 * 4^`levels` triangles that look outward.
#[must_use]
pub fn icosphere(levels: u32) -> Mesh {
    let (mut positions, mut triangles) = icosahedron();
    for _ in 0..levels {
        let mut middles = HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                positions.push((positions[a as usize] + positions[b as usize]).normalize());
                positions.len() as u32 - 1
            })
        };
        let split = |[a, b, c]: [u32; 3]| {
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
        };
        triangles = triangles.into_iter().flat_map(split).collect();
    }
    Mesh { positions, triangles, ..Mesh::default() }
}

fn icosahedron() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let phi = f64::midpoint(1.0, 5f64.sqrt());
    let signs = [(1.0, phi), (-1.0, phi), (1.0, -phi), (-1.0, -phi)];
    let corners = signs.iter().flat_map(|&(a, b)| [[a, b, 0.0], [0.0, a, b], [b, 0.0, a]]);
    let positions: Vec<DVec3> = corners.map(|p| DVec3::from_array(p).normalize()).collect();
    // Neighbours are 1.05 apart, others 1.70 and more.
    let near = |i: usize, j: usize| positions[i].distance(positions[j]) < 1.2;
    let mut triangles = Vec::new();
    for (i, j, k) in (0..12).flat_map(|i| (i + 1..12).flat_map(move |j| (j + 1..12).map(move |k| (i, j, k)))) {
        if near(i, j) && near(j, k) && near(i, k) {
            let outward = (positions[j] - positions[i]).cross(positions[k] - positions[i]).dot(positions[i]) > 0.0;
            let (j, k) = if outward { (j, k) } else { (k, j) };
            triangles.push([i as u32, j as u32, k as u32]);
        }
    }
    (positions, triangles)
}

/// A unit sphere of triangles that look outward: `slices` from pole to pole, each cut into needles at latitudes 20 degrees apart.
#[must_use]
pub fn needle_sphere(slices: u32) -> Mesh {
    let rings: Vec<f64> = (0..=9).map(|i| (20.0 * f64::from(i)).clamp(0.5, 179.5).to_radians()).collect();
    let n = rings.len() as u32;
    let mut positions = vec![DVec3::Z, DVec3::NEG_Z];
    for i in 0..slices {
        let (y, x) = (TAU * f64::from(i) / f64::from(slices)).sin_cos();
        positions.extend(rings.iter().map(|a| DVec3::new(x * a.sin(), y * a.sin(), a.cos())));
    }
    let at = |i: u32, k: u32| 2 + n * (i % slices) + k;
    let band =
        |i: u32, k: u32| [[at(i, k), at(i, k + 1), at(i + 1, k)], [at(i + 1, k), at(i, k + 1), at(i + 1, k + 1)]];
    let poles = |i: u32| [[0, at(i, 0), at(i + 1, 0)], [1, at(i + 1, n - 1), at(i, n - 1)]];
    let slice = |i: u32| poles(i).into_iter().chain((0..n - 1).flat_map(move |k| band(i, k)));
    Mesh { positions, triangles: (0..slices).flat_map(slice).collect(), ..Mesh::default() }
}

/// A rectangle as a grid whose lines lie at these parts of its sides, two triangles a cell; its front is on the side of
/// `half_u` x `half_v`.
#[must_use]
pub fn grid(center: DVec3, half_u: DVec3, half_v: DVec3, lines: &[f64]) -> Mesh {
    let n = lines.len() as u32;
    let at = |s: f64, t: f64| center + (2.0 * s - 1.0) * half_u + (2.0 * t - 1.0) * half_v;
    let positions = lines.iter().flat_map(|&t| lines.iter().map(move |&s| at(s, t))).collect();
    let cell = |i: u32, j: u32| {
        let a = j * n + i;
        [[a, a + 1, a + n + 1], [a, a + n + 1, a + n]]
    };
    let triangles = (0..n - 1).flat_map(|j| (0..n - 1).flat_map(move |i| cell(i, j))).collect();
    Mesh { positions, triangles, ..Mesh::default() }
}

/// The faces of the box [-1, 1]^3 as grids that look inward and meet vertex to vertex.
#[must_use]
pub fn hollow_box(lines: &[f64]) -> Mesh {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    // Outward, u, v with u x v = -outward.
    let faces = [(x, z, y), (-x, y, z), (y, x, z), (-y, z, x), (z, y, x), (-z, x, y)];
    let mut all = Mesh::default();
    for mesh in faces.map(|(out, u, v)| grid(out, u, v, lines)) {
        let first = all.positions.len() as u32;
        all.positions.extend(&mesh.positions);
        all.triangles.extend(mesh.triangles.iter().map(|t| t.map(|i| i + first)));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every edge is shared by two triangles that run along it in opposite directions: closed, and all on one side.
    #[test]
    fn spheres_are_closed_and_look_outward() {
        for (mesh, triangles) in [(icosphere(0), 20), (icosphere(3), 1280), (needle_sphere(50), 1000)] {
            assert_eq!(mesh.triangles.len(), triangles);
            mesh.validate().unwrap();
            let mut edges = std::collections::HashSet::new();
            for &[a, b, c] in &mesh.triangles {
                assert!([(a, b), (b, c), (c, a)].into_iter().all(|edge| edges.insert(edge)));
                assert!(mesh.cross([a, b, c]).dot(mesh.positions[a as usize]) > 0.0);
            }
            assert!(edges.iter().all(|&(a, b)| edges.contains(&(b, a))));
        }
    }
}
