//! What a path tracer may take for granted of where shapes lie: nothing beyond a wall, all in a box, spheres apart.

use glam::DVec3;

use super::features::axis_of;
use super::pack::{Frame, SLACK};
use crate::scene::{Bsdf, DeltaLight, Environment, Geometry, Scene, Shape};

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
    if !holds(scene, (low, high), gap, frame) || !sees_inside(scene, (low, high), missing.first().copied(), frame) {
        return 0;
    }
    sides.iter().enumerate().map(|(s, i)| i.map_or(0, |i| (i as u32 + 1) << (5 * s))).sum()
}

/// Does the box hold all shapes? Hits of rectangles are left within them; the rest keeps `gap` to the sides.
fn holds(scene: &Scene, (low, high): (DVec3, DVec3), gap: f64, frame: &Frame) -> bool {
    scene.shapes.iter().all(|shape| {
        let flat = matches!(shape.geometry, Geometry::Rectangle { .. });
        let gap = if flat { -MEET * frame.half_extent } else { gap };
        let (a, b) = shape.geometry.bounds();
        a.cmpge(low + gap).all() && b.cmple(high - gap).all()
    })
}

/// Is the camera in the box, or before its missing side?
fn sees_inside(scene: &Scene, (low, high): (DVec3, DVec3), missing: Option<usize>, frame: &Frame) -> bool {
    let (eye, lens) = (scene.camera.origin(), scene.camera.lens.map_or(0.0, |lens| lens.aperture_radius));
    let (to_low, to_high) = (eye - low - lens, high - eye - lens);
    let mut gaps = to_low.min(to_high);
    let mut least = APART * frame.half_extent;
    if let Some(s) = missing {
        let axis = s % 3;
        let (before, opposite) = if s < 3 { (-to_low, to_high) } else { (-to_high, to_low) };
        gaps[axis] = opposite[axis];
        // Sides are tested wider than they are. A ray that passes the missing side's rim must not meet the opposite one's so.
        least = least.max(10.0 * SLACK * frame.half_extent * before[axis] / (high - low)[axis]);
    }
    gaps.min_element() > least
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

/// Is the camera in an outward sphere?
pub(super) fn camera_inside(scene: &Scene) -> bool {
    let eye = scene.camera.origin();
    scene.shapes.iter().filter_map(outward_sphere).any(|(center, radius)| eye.distance(center) <= radius)
}

/// A rectangle or disk that has the whole scene, lights included, on one side of its plane never comes between a surface and a light.
pub(super) fn can_block(flat: &Shape, scene: &Scene, tolerance: f64) -> bool {
    let (Geometry::Rectangle { center, half_u, half_v } | Geometry::Disk { center, half_u, half_v }) = flat.geometry
    else {
        return true;
    };
    let outside = matches!(scene.environment, Some(Environment::Map(_)))
        || scene.delta_lights.iter().any(|light| light.position().is_none());
    if outside {
        return true;
    }
    let normal = half_u.cross(half_v).normalize();
    let shapes = scene.shapes.iter().map(|shape| shape.geometry.span(center, normal));
    let points = scene.delta_lights.iter().filter_map(DeltaLight::position);
    let points = points.map(|position| (position - center).dot(normal)).map(|d| (d, d));
    let (low, high) = shapes.chain(points).fold((0.0f64, 0.0f64), |(low, high), (a, b)| (low.min(a), high.max(b)));
    low < -tolerance && high > tolerance
}
