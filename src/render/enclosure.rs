//! What a path tracer may take for granted where a scene lies in a box, or where its spheres are apart.

use glam::DVec3;

use super::features::axis_of;
use super::pack::Frame;
use crate::scene::{Bsdf, Geometry, Scene, Shape};

/// How exactly the sides of a box must meet, by the scene's half extent.
const MEET: f64 = 1e-9;
/// How far what must be off them is off them, likewise: more than a ray starts off its surface.
const APART: f64 = 1e-4;

/// The numbers from 1 on of the rectangles that are the sides of a box with the whole scene in it, five bits a side (low x, y, z, then
/// high); one may be missing. 0 where there is no such box. The camera is in the box or looks in from before the missing side.
pub(super) fn box_sides(rects: &[&Shape], scene: &Scene, frame: &Frame) -> u32 {
    let (low, high) = rects
        .iter()
        .map(|rect| rect.geometry.bounds())
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), (a, b)| (low.min(a), high.max(b)));
    let meets = |a: DVec3, b: DVec3| (a - b).abs().max_element() <= MEET * frame.half_extent;
    let spans = |rect: &Shape, axis: usize, end: DVec3| {
        let (mut from, mut to) = (low, high);
        (from[axis], to[axis]) = (end[axis], end[axis]);
        let (a, b) = rect.geometry.bounds();
        axis_of(&rect.geometry) == axis as u32 + 1 && meets(a, from) && meets(b, to)
    };
    let side = |s: usize| rects.iter().position(|rect| spans(rect, s % 3, if s < 3 { low } else { high }));
    let sides: [Option<usize>; 6] = std::array::from_fn(side);
    let missing: Vec<usize> = (0..6).filter(|&s| sides[s].is_none()).collect();
    let lets_through = sides.iter().flatten().any(|&i| matches!(rects[i].bsdf, Bsdf::Dielectric { .. }));
    if missing.len() > 1 || lets_through {
        return 0;
    }
    // Where a surface touches a side, its points may be moved beyond that: rays from there must find nothing, in a box or without.
    let lit = scene.environment.is_some() || sides.iter().flatten().any(|&i| rects[i].two_sided);
    let gap = if lit { APART } else { -MEET } * frame.half_extent;
    if !holds(scene, (low, high), gap, missing.first().copied(), frame) {
        return 0;
    }
    sides.iter().enumerate().map(|(s, i)| i.map_or(0, |i| (i as u32 + 1) << (5 * s))).sum()
}

/// Does the box hold all shapes, and the camera, which may be beyond the missing side too? Hits of rectangles are left within them; the
/// rest keeps `gap` to the sides.
fn holds(scene: &Scene, (low, high): (DVec3, DVec3), gap: f64, missing: Option<usize>, frame: &Frame) -> bool {
    let within = |(a, b): (DVec3, DVec3), gap: f64| a.cmpge(low + gap).all() && b.cmple(high - gap).all();
    let shapes = scene.shapes.iter().all(|shape| {
        let flat = matches!(shape.geometry, Geometry::Rectangle { .. });
        within(shape.geometry.bounds(), if flat { -MEET * frame.half_extent } else { gap })
    });
    let mut eye = scene.camera.to_world.w_axis.truncate();
    if let Some(s) = missing {
        let (axis, middle) = (s % 3, 0.5 * (low + high));
        let beyond = if s < 3 { eye[axis] < middle[axis] } else { eye[axis] > middle[axis] };
        eye[axis] = if beyond { middle[axis] } else { eye[axis] };
    }
    let lens = DVec3::splat(scene.camera.lens.map_or(0.0, |lens| lens.aperture_radius));
    shapes && within((eye - lens, eye + lens), APART * frame.half_extent)
}

/// Does no outward sphere meet another?
pub(super) fn spheres_apart(scene: &Scene, frame: &Frame) -> bool {
    let outward: Vec<(DVec3, f64)> = scene.shapes.iter().filter_map(outward_sphere).collect();
    let apart = |(i, a): (usize, &(DVec3, f64))| {
        outward[..i].iter().all(|b| a.0.distance(b.0) >= a.1 + b.1 - MEET * frame.half_extent)
    };
    outward.len() > 1 && outward.iter().enumerate().all(apart)
}

fn outward_sphere(shape: &Shape) -> Option<(DVec3, f64)> {
    match shape.geometry {
        Geometry::Sphere { center, radius, inward: false } => Some((center, radius)),
        _ => None,
    }
}
