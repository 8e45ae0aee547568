//! Single rays against the triangles of a scene, traced as the path tracer does.

use glam::DVec3;

use super::pack::{Frame, pack};
use crate::gpu::{Buffer, Gpu};
use crate::scene::Scene;
use crate::{Result, shaders};

crate::push_block! {
    /// Push constants of `mesh_probe`.
    struct Push for crate::shaders::mesh_probe { count: u32 }
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TriangleHit {
    /// World units from the origin; below 0 where there is none.
    pub distance: f64,
    /// Of the second and the third vertex.
    pub weights: [f32; 2],
}

/// The closest hits of rays from a first point toward a second, in a scene whose shapes are one mesh. Both points are rounded to
/// f32 as the vertices are, so that a ray toward a vertex aims at the vertex of the tables.
pub(crate) fn closest_triangles(gpu: &Gpu, scene: &Scene, rays: &[[DVec3; 2]]) -> Result<Vec<TriangleHit>> {
    let frame = Frame::of(scene);
    let place = |p: DVec3| ((p - frame.center) * frame.scale).as_vec3();
    let placed = rays.iter().flat_map(|&[from, to]| {
        let (from, to) = (place(from), place(to));
        [from, (to - from).normalize()].map(|v| v.extend(0.0).to_array())
    });
    let (rows, placed) = (pack(scene, None)?, placed.collect::<Vec<_>>());
    let (scene, queries) = (upload(gpu, "scene", &rows)?, upload(gpu, "rays", &placed)?);
    let bytes = 16 * rays.len() as u64;
    let hits = gpu.buffer("hits", bytes)?;
    let kernel = gpu.kernel::<shaders::mesh_probe::Shader>(&shaders::mesh_probe::Spec {})?;
    let bind = shaders::mesh_probe::Bind { scene: scene.all(), rays: queries.all(), hits: hits.slice(0, bytes) };
    let mut rec = gpu.recorder();
    let count = rays.len() as u32;
    rec.dispatch(&kernel, &bind, &Push { count }, [count.div_ceil(64), 1, 1]);
    rec.finish()?.run()?;
    let hit = |[t, _, v, w]: [f32; 4]| TriangleHit { distance: f64::from(t) / frame.scale, weights: [v, w] };
    Ok(gpu.download(&bind.hits)?.into_iter().map(hit).collect())
}

fn upload(gpu: &Gpu, name: &str, rows: &[[f32; 4]]) -> Result<Buffer> {
    let buffer = gpu.buffer(name, size_of_val(rows) as u64)?;
    gpu.upload(&buffer.slice(0, size_of_val(rows) as u64), rows)?;
    Ok(buffer)
}
