//! Triangles as the shaders read them (glsl/lib/mesh.glsl): one tree of boxes over all meshes, each triangle with its normal, and
//! tables by which lights choose.
//!
//! The tree is a list of boxes, each before what it holds. A ray that misses a box skips what it holds, so it needs no stack, which
//! every device has but none fast. The list comes once for each octant of directions, nearer children first.

use std::time::Duration;

use glam::{DVec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;

use super::pack::Frame;
use crate::scene::Mesh;

/// Triangles of a leaf at most: their number less one takes three bits.
const MAX_LEAF: u32 = 4;
/// Boxes are larger than their triangles by this part of the scene's half extent, several roundings of a coordinate.
const SLACK: f32 = 4e-6;
/// Rows of boxes at most, 64 MiB, where they come in eight orders; larger trees have one for all rays.
const MAX_ORDERED_ROWS: usize = 1 << 22;
/// Rows before the boxes.
pub(super) const HEADER_ROWS: usize = 2;

/// A triangle of one of the meshes.
#[derive(Clone, Copy)]
struct Item {
    mesh: u32,
    corners: [u32; 3],
}

/// The rows of all meshes, and what their materials' rows say of them as lights.
pub(super) struct Packed {
    /// Header, boxes, triangles, corners, light tables.
    pub rows: Vec<[f32; 4]>,
    /// A mesh's first row in the light tables and its number of triangles; the row counts from the first row of all.
    pub tables: Vec<[f32; 2]>,
}

/// Packs the meshes; their rows begin at `first_row`. `corners` asks for normals and texture coordinates, `lights` is the number of
/// meshes, the first, that emit.
pub(super) fn pack(
    meshes: &[&Mesh],
    frame: &Frame,
    offset: f64,
    first_row: usize,
    corners: bool,
    lights: usize,
) -> Packed {
    let items: Vec<Item> = (0..).zip(meshes).flat_map(|(mesh, m)| items(mesh, m)).collect();
    let place =
        |item: &Item| meshes[item.mesh as usize].corners(item.corners).map(|p| (p - frame.center) * frame.scale);
    let soup: Vec<Triangle> = items.iter().map(|item| triangle(place(item))).collect();
    let bvh = build(&soup);
    let slack = SLACK * (frame.half_extent * frame.scale) as f32;
    let octants = if 16 * bvh.nodes.len() <= MAX_ORDERED_ROWS { 8 } else { 1 };

    let mut rows = vec![[0.0; 4]; HEADER_ROWS];
    (0..octants).for_each(|octant| rows.extend(boxes(&bvh, octant, slack)));
    let first_triangle = first_row + rows.len();
    let order: Vec<&Item> = bvh.primitive_indices.iter().map(|&i| &items[i as usize]).collect();
    order.iter().for_each(|item| rows.extend(triangle_rows(place(item), item.mesh, offset)));
    // A pipeline for textures reads rows of corners even where no mesh has a texture, and makes nothing of them: any will do.
    let first_corner = if corners { first_row + rows.len() } else { first_triangle };
    if corners {
        order.iter().for_each(|item| rows.extend(corner_rows(meshes[item.mesh as usize], item.corners)));
    }
    // A sampled point lies on its triangle up to a rounding, its neighbours as well.
    let short = 2.0 * offset;
    rows[0] = [first_triangle as f32, first_corner as f32, bvh.nodes.len() as f32, (octants - 1) as f32];
    rows[1] = [short as f32, 0.0, 0.0, 0.0];
    let mut tables = Vec::new();
    for (number, mesh) in (0..).zip(&meshes[..lights]) {
        let table = light_table(mesh, number, &order);
        tables.push([(first_row + rows.len()) as f32, table.len() as f32]);
        rows.extend(table);
    }
    Packed { rows, tables }
}

fn items(mesh: u32, m: &Mesh) -> impl Iterator<Item = Item> {
    m.triangles.iter().map(move |&corners| Item { mesh, corners })
}

fn triangle(corners: [DVec3; 3]) -> Triangle {
    let [v0, v1, v2] = corners.map(|p| Vec3A::from(p.as_vec3()));
    Triangle { v0, v1, v2 }
}

/// A tree by the surface area heuristic.
fn build(soup: &[Triangle]) -> Bvh2 {
    let params = BvhBuildParams { max_prims_per_leaf: MAX_LEAF, ..BvhBuildParams::medium_build() };
    build_bvh2_from_tris(soup, params, &mut Duration::default())
}

/// The boxes, each before what it holds, nearer ones first for directions of an octant: one bit an axis, set where they fall. Two
/// rows a box: its lower and upper corner, and in the first row how to go on, the place of the next box after all that this
/// one holds or, of a leaf, -1 - (8 * first triangle + triangles - 1).
fn boxes(bvh: &Bvh2, octant: usize, slack: f32) -> Vec<[f32; 4]> {
    let mut rows = Vec::with_capacity(2 * bvh.nodes.len());
    // Either a node to write or, once all that it holds is written, the place of its own row.
    let mut open = vec![Err(0usize)];
    while let Some(next) = open.pop() {
        let index = match next {
            Err(index) => index,
            Ok(row) => {
                let place = (rows.len() / 2) as f32;
                let row: &mut [f32; 4] = &mut rows[row];
                row[3] = place;
                continue;
            }
        };
        let node = &bvh.nodes[index];
        let (low, high) = (node.aabb.min - slack, node.aabb.max + slack);
        let leaf = -1.0 - (8 * node.first_index + node.prim_count).saturating_sub(1) as f32;
        rows.extend([[low.x, low.y, low.z, leaf], [high.x, high.y, high.z, 0.0]]);
        if !node.is_leaf() {
            open.push(Ok(rows.len() - 2));
            open.extend(far_and_near(bvh, node.first_index as usize, octant).map(Err));
        }
    }
    rows
}

/// Two children, `first` and the next, in the order in which rays of an octant should meet them last: by their centres, along the axis on
/// which these are farthest apart.
fn far_and_near(bvh: &Bvh2, first: usize, octant: usize) -> [usize; 2] {
    let gap = bvh.nodes[first + 1].aabb.center() - bvh.nodes[first].aabb.center();
    let axis = gap.abs().max_position();
    let falls = octant >> axis & 1 == 1;
    if (gap[axis] >= 0.0) == falls { [first, first + 1] } else { [first + 1, first] }
}

/// Vertices, each with the least weight that keeps a hit `offset` away from the opposite edge, then normal and mesh.
fn triangle_rows(corners: [DVec3; 3], mesh: u32, offset: f64) -> [[f32; 4]; 4] {
    let cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let normal = cross.normalize();
    let row = |v: DVec3, w: f64| [v.x as f32, v.y as f32, v.z as f32, w as f32];
    let corner = |i: usize| {
        let opposite = corners[(i + 1) % 3].distance(corners[(i + 2) % 3]);
        row(corners[i], (offset * opposite / cross.length()).min(1.0 / 3.0))
    };
    [corner(0), corner(1), corner(2), row(normal, f64::from(mesh))]
}

/// The vertices' normals, each with its u, then the three v.
fn corner_rows(mesh: &Mesh, corners: [u32; 3]) -> [[f32; 4]; 4] {
    let flat = mesh.cross(corners).normalize();
    let uv = corners.map(|i| mesh.uvs.get(i as usize).copied().unwrap_or_default().as_vec2());
    let row = |i: usize| {
        let n = mesh.normals.get(corners[i] as usize).copied().unwrap_or(flat).as_vec3();
        [n.x, n.y, n.z, uv[i].x]
    };
    [row(0), row(1), row(2), [uv[0].y, uv[1].y, uv[2].y, 0.0]]
}

/// The triangles of an emitting mesh: the part of its area up to and with each, and its number.
fn light_table(mesh: &Mesh, number: u32, order: &[&Item]) -> Vec<[f32; 4]> {
    let area = mesh.area();
    let mut sum = 0.0;
    let mine = order.iter().enumerate().filter(|(_, item)| item.mesh == number);
    mine.map(|(i, item)| {
        sum += 0.5 * mesh.cross(item.corners).length() / area;
        [sum as f32, i as f32, 0.0, 0.0]
    })
    .collect()
}
