//! The scene as the shaders read it: checked, recentred and scaled in f64, then rows of four f32.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use super::features::{axis_of, emits, is_disk, is_flat, is_inward};
use crate::Result;
use crate::scene::{Checker, Geometry, Scene, Shape};

/// Rows of the camera before the first primitive.
const CAMERA_ROWS: usize = 4;
/// Rows of one primitive (glsl/path_trace.comp names them).
const PRIMITIVE_ROWS: usize = 12;
/// The row of the first primitive's radiance.
pub(super) const FIRST_RADIANCE: usize = CAMERA_ROWS + 2;
/// Rows before those of the checkerboard.
const CHECKER_ROW: usize = 10;

/// Where the scene is and how large: its centre becomes the origin and `scale`, a power of two, brings its half extent into [1, 2).
/// A power of two changes no bit of a mantissa, so scenes that differ by one give the same image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub center: DVec3,
    pub half_extent: f64,
    pub scale: f64,
}

impl Frame {
    pub(super) fn of(scene: &Scene) -> Self {
        let eye = scene.camera.to_world.w_axis.truncate();
        let (mut low, mut high) = (eye, eye);
        for shape in &scene.shapes {
            let (shape_low, shape_high) = shape.geometry.bounds();
            low = low.min(shape_low);
            high = high.max(shape_high);
        }
        let half_extent = (0.5 * (high - low)).max_element();
        let half_extent = if half_extent > 0.0 { half_extent } else { 1.0 };
        Self { center: 0.5 * (low + high), half_extent, scale: (-half_extent.log2().floor()).exp2() }
    }
}

/// The shapes in the order of the buffers: spheres (outward lights, outward, inward lights, inward), then rectangles and
/// disks (rectangles that are lights, disks that are, other disks, other rectangles).
pub(super) fn order(scene: &Scene) -> Vec<usize> {
    let mut indices: Vec<usize> = (0..scene.shapes.len()).collect();
    indices.sort_by_key(|&i| {
        let s = &scene.shapes[i];
        (is_flat(s), is_inward(s), !emits(s), is_disk(s) == emits(s))
    });
    indices
}

/// A part of a larger picture: the camera's image is `width` x `height` pixels, of which the render shows those from `x`, `y`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FilmWindow {
    /// Width of the whole picture, pixels; the camera's horizontal field of view spans it.
    pub width: u32,
    /// Height of the whole picture, pixels.
    pub height: u32,
    /// First column shown.
    pub x: u32,
    /// First row shown.
    pub y: u32,
}

/// The rows of a checked scene. With a window, the scene's camera has the window's size.
pub(super) fn pack(scene: &Scene, window: Option<FilmWindow>) -> Result<Vec<[f32; 4]>> {
    scene.validate()?;
    let frame = Frame::of(scene);
    let extent = frame.half_extent * frame.scale;
    let offset = 2e-5 * extent;
    let order = order(scene);
    let mut rows = Vec::with_capacity(CAMERA_ROWS + PRIMITIVE_ROWS * order.len().max(1));
    pack_camera(scene, window, &frame, offset, &mut rows);
    let power: Vec<f64> =
        order.iter().map(|&i| if sampled(&scene.shapes[i]) { power(&scene.shapes[i]) } else { 0.0 }).collect();
    let total: f64 = power.iter().sum();
    let last_light = power.iter().rposition(|&p| p > 0.0);
    let mut below = 0.0;
    for (k, &i) in order.iter().enumerate() {
        let shape = &scene.shapes[i];
        below += power[k];
        // The last light's share ends at 1 whatever the rounding.
        let upper = if Some(k) == last_light {
            1.0
        } else if total > 0.0 {
            below / total
        } else {
            0.0
        };
        pack_shape(shape, &frame, offset, extent, upper, &mut rows);
    }
    if order.is_empty() {
        rows.resize(CAMERA_ROWS + PRIMITIVE_ROWS, [0.0; 4]);
    }
    Ok(rows)
}

/// Is this a light that is sampled directly? Inward lights surround their receivers and are left to the bounces.
fn sampled(shape: &Shape) -> bool {
    emits(shape) && !is_inward(shape)
}

fn power(shape: &Shape) -> f64 {
    shape.geometry.area() * shape.radiance.element_sum()
}

fn row(v: DVec3, w: f64) -> [f32; 4] {
    [v.x as f32, v.y as f32, v.z as f32, w as f32]
}

fn pack_camera(scene: &Scene, window: Option<FilmWindow>, frame: &Frame, offset: f64, rows: &mut Vec<[f32; 4]>) {
    let camera = &scene.camera;
    let (w, h) = (camera.width, camera.height);
    let film = window.unwrap_or(FilmWindow { width: w, height: h, x: 0, y: 0 });
    let axes = DMat3::from_mat4(camera.to_world);
    let half_width = (0.5 * camera.fov_x_degrees.to_radians()).tan();
    let half_height = half_width * f64::from(film.height) / f64::from(film.width);
    let (right, up) = (axes.x_axis * half_width, axes.y_axis * half_height);
    // Scale and centre of the window on the whole film, which is [-1, 1].
    let (scale_x, scale_y) = (f64::from(w) / f64::from(film.width), f64::from(h) / f64::from(film.height));
    let center_x = (2.0 * f64::from(film.x) + f64::from(w)) / f64::from(film.width) - 1.0;
    let center_y = 1.0 - (2.0 * f64::from(film.y) + f64::from(h)) / f64::from(film.height);
    let eye = (camera.to_world.w_axis.truncate() - frame.center) * frame.scale;
    rows.push(row(eye, offset));
    rows.push(row(right * scale_x, 1.0 / frame.scale));
    let (aperture, focus) = camera.lens.map_or((0.0, 0.0), |lens| (lens.aperture_radius, lens.focus_distance));
    rows.push(row(up * scale_y, aperture * frame.scale));
    rows.push(row(right * center_x + up * center_y - axes.z_axis, focus * frame.scale));
}

fn pack_shape(shape: &Shape, frame: &Frame, offset: f64, extent: f64, upper: f64, rows: &mut Vec<[f32; 4]>) {
    let begin = rows.len();
    let place = |p: DVec3| (p - frame.center) * frame.scale;
    match shape.geometry {
        Geometry::Sphere { center, radius, inward } => {
            rows.push(row(place(center), radius * frame.scale));
            rows.push(row(shape.albedo, f64::from(u8::from(inward))));
            rows.push(row(shape.radiance, upper));
        }
        Geometry::Rectangle { center, half_u, half_v } => {
            let aligned = axis_of(&shape.geometry) != 0;
            let (u, v) = (snap(half_u * frame.scale, aligned), snap(half_v * frame.scale, aligned));
            let (lu, lv) = (u.length(), v.length());
            // A gap between touching rectangles would leak: the test is a few roundings wider than the surface.
            let test = [1.0 + 2e-6 * extent / lu, 1.0 + 2e-6 * extent / lv];
            let inner = [(1.0 - offset / lu).max(0.0), (1.0 - offset / lv).max(0.0)];
            rows.push(row(place(center), 4.0 * lu * lv));
            rows.push(row(shape.albedo, 0.0));
            rows.push(row(shape.radiance, upper));
            push_plane([u, v], axis_of(&shape.geometry), test, inner, rows);
        }
        Geometry::Disk { center, half_u, half_v } => {
            let (u, v) = (half_u * frame.scale, half_v * frame.scale);
            let inner = (1.0 - offset / u.length().min(v.length())).max(0.0);
            rows.push(row(place(center), PI * u.length() * v.length()));
            rows.push(row(shape.albedo, 0.0));
            rows.push(row(shape.radiance, upper));
            push_plane([u, v], 0, [1.0; 2], [inner; 2], rows);
        }
    }
    rows.resize(begin + CHECKER_ROW, [0.0; 4]);
    if let Some(Checker { albedo, repeats, offset }) = shape.checker {
        rows.push(row(albedo, 1.0));
        rows.push([repeats.x, repeats.y, offset.x, offset.y].map(|v| v as f32));
    }
    rows.resize(begin + PRIMITIVE_ROWS, [0.0; 4]);
}

/// The rows of a plane from its normal on: `axis` as [`axis_of`] gives it, `test` is how far a hit may be from the centre, `inner` how far it is left, in
/// halves of the edges.
fn push_plane([u, v]: [DVec3; 2], axis: u32, test: [f64; 2], inner: [f64; 2], rows: &mut Vec<[f32; 4]>) {
    let (lu, lv) = (u.length(), v.length());
    rows.push(row(u.cross(v).normalize(), f64::from(axis)));
    rows.push(row(u / (lu * lu), test[0]));
    rows.push(row(v / (lv * lv), test[1]));
    rows.push(row(u, inner[0]));
    rows.push(row(v, inner[1]));
    rows.push(row(u.abs() * test[0] + v.abs() * test[1], 0.0));
    rows.push(row(u.abs() * inner[0] + v.abs() * inner[1], 0.0));
}

/// Rotations in floating point leave 1e-17 where an edge along an axis has zeros.
fn snap(v: DVec3, aligned: bool) -> DVec3 {
    let limit = v.length() * 1e-6;
    if aligned { DVec3::from_array(v.to_array().map(|x| if x.abs() < limit { 0.0 } else { x })) } else { v }
}
