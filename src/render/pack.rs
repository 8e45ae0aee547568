//! The scene as the shaders read it: checked, recentred and scaled in f64, then rows of four f32.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DMat3, DVec3};

use super::environment;
use super::features::{axis_of, delta_kind, emits, is_disk, is_flat, is_inward, is_sphere, material_kind, mesh_of};
use super::mesh;
use crate::scene::{
    Bitmap, Bsdf, Checker, DeltaKind, DeltaLight, Environment, Falloff, Geometry, Mesh, Picture, Scene, Shape, Texture,
};
use crate::{Error, Result};

/// Rows of the camera and of the environment before the first primitive.
const CAMERA_ROWS: usize = 8;
/// The first row of the environment.
const ENVIRONMENT_ROW: usize = 4;
/// Rows of one primitive (glsl/lib/scene.glsl names them).
const PRIMITIVE_ROWS: usize = 16;
/// The row of the first primitive's radiance.
pub(super) const FIRST_RADIANCE: usize = CAMERA_ROWS + 2;
/// Rows before those of the texture, and before those of the material.
const TEXTURE_ROW: usize = 10;
const MATERIAL_ROW: usize = 12;
const BITMAP_ROW: usize = 15;
/// A gap between touching rectangles would leak: their hit tests are a few roundings wider than they are, by this share of
/// the scene's half extent. Free ones are tested as they are.
pub(super) const SLACK: f64 = 2e-6;
/// Rows are numbered by floats.
const MAX_ROWS: usize = 1 << 24;

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
/// disks (rectangles that are lights, disks that are, other disks, other rectangles), then meshes (lights, others).
pub(super) fn order(scene: &Scene) -> Vec<usize> {
    let mut indices: Vec<usize> = (0..scene.shapes.len()).collect();
    indices.sort_by_key(|&i| {
        let s = &scene.shapes[i];
        (mesh_of(s).is_some(), is_flat(s), is_inward(s), !emits(s), is_disk(s) == emits(s))
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
    let mut rows = Vec::with_capacity(CAMERA_ROWS + PRIMITIVE_ROWS * (order.len() + scene.delta_lights.len()).max(1));
    pack_camera(scene, window, &frame, offset, &mut rows);
    rows.resize(CAMERA_ROWS, [0.0; 4]);
    let shares = light_shares(scene, &order, frame.half_extent);
    let edges = |shape: &Shape| (!is_sphere(shape)).then(|| shape.geometry.bounds());
    let boxes: Vec<_> = scene.shapes.iter().map(edges).collect();
    for (&i, &upper) in order.iter().zip(&shares) {
        let rectangle = matches!(scene.shapes[i].geometry, Geometry::Rectangle { .. });
        let slack = if rectangle && touches(&boxes, i, frame.half_extent) { SLACK * extent } else { 0.0 };
        pack_shape(&scene.shapes[i], &frame, offset, slack, upper, &mut rows);
    }
    for (light, &upper) in scene.delta_lights.iter().zip(&shares[order.len()..]) {
        pack_delta(light, &frame, upper, &mut rows);
    }
    rows.resize(rows.len().max(CAMERA_ROWS + PRIMITIVE_ROWS), [0.0; 4]);
    pack_meshes(&order.iter().map(|&i| &scene.shapes[i]).collect::<Vec<_>>(), &frame, offset, &mut rows);
    pack_bitmaps(scene, &order, &mut rows);
    if let Some(environment) = &scene.environment {
        let share = 1.0 - shares.last().copied().unwrap_or(0.0);
        let header = environment::pack(environment, share, &mut rows);
        rows[ENVIRONMENT_ROW..CAMERA_ROWS].copy_from_slice(&header);
    }
    if rows.len() > MAX_ROWS {
        return Err(Error::input(format!(
            "triangles, textures and environment map need {} rows of 16 bytes, at most {MAX_ROWS} can be had: make them smaller",
            rows.len()
        )));
    }
    Ok(rows)
}

/// Where the share of each shape, in the order of the buffers, and then of each point ends in the choice of lights, by power; what is
/// left to 1 belongs to the environment's map.
fn light_shares(scene: &Scene, order: &[usize], half_extent: f64) -> Vec<f64> {
    let shapes = order.iter().map(|&i| if sampled(&scene.shapes[i]) { power(&scene.shapes[i]) } else { 0.0 });
    let powers: Vec<f64> =
        shapes.chain(scene.delta_lights.iter().map(|light| delta_power(light, half_extent))).collect();
    let map = match &scene.environment {
        Some(Environment::Map(map)) => 4.0 * PI * half_extent * half_extent * environment::mean(map).element_sum(),
        _ => 0.0,
    };
    let total = powers.iter().sum::<f64>() + map;
    let last = powers.iter().rposition(|&power| power > 0.0);
    let mut below = 0.0;
    let shares = powers.iter().enumerate().map(|(k, power)| {
        below += power;
        // The last light's share ends at 1 whatever the rounding.
        if Some(k) >= last && last.is_some() && map == 0.0 {
            1.0
        } else if total > 0.0 {
            below / total
        } else {
            0.0
        }
    });
    shares.collect()
}

/// Power in the unit of [`power`]: that over pi.
fn delta_power(light: &DeltaLight, half_extent: f64) -> f64 {
    let solid_angle = match light.kind {
        DeltaKind::Point { .. } => 4.0 * PI,
        DeltaKind::Spot { cutoff_degrees, .. } => 2.0 * PI * (1.0 - cutoff_degrees.to_radians().cos()),
        // What falls on the scene's cross section.
        DeltaKind::Directional { .. } => PI * half_extent * half_extent,
    };
    light.intensity.element_sum() * solid_angle / PI
}

/// Rows as of a primitive: place and kind; radiance; a spot's axis; what its fading is linear in.
fn pack_delta(light: &DeltaLight, frame: &Frame, upper: f64, rows: &mut Vec<[f32; 4]>) {
    let begin = rows.len();
    let kind = f64::from(delta_kind(&light.kind));
    // Distances are scaled, and intensity falls with their square.
    let (place, scale) = match light.kind {
        DeltaKind::Point { position } | DeltaKind::Spot { position, .. } => {
            ((position - frame.center) * frame.scale, frame.scale * frame.scale)
        }
        DeltaKind::Directional { direction } => (-direction, 1.0),
    };
    rows.extend([row(place, kind), [0.0; 4], row(light.intensity * scale, upper)]);
    if let DeltaKind::Spot { direction, beam_degrees, cutoff_degrees, falloff, .. } = light.kind {
        let fading = match falloff {
            // In parts of a turn.
            Falloff::Linear => {
                [cutoff_degrees / (cutoff_degrees - beam_degrees), -360.0 / (cutoff_degrees - beam_degrees)]
            }
            Falloff::Squared => {
                let [beam, cutoff] = [beam_degrees, cutoff_degrees].map(|angle| angle.to_radians().cos());
                [-cutoff / (beam - cutoff), 1.0 / (beam - cutoff)]
            }
        };
        rows.extend([row(direction, 0.0), row(DVec3::new(fading[0], fading[1], 0.0), 0.0)]);
    }
    rows.resize(begin + PRIMITIVE_ROWS, [0.0; 4]);
}

/// The texels of each picture once, and in the rows of the shapes where they are.
fn pack_bitmaps(scene: &Scene, order: &[usize], rows: &mut Vec<[f32; 4]>) {
    let mut packed: Vec<(*const Picture, usize)> = Vec::new();
    for (k, &i) in order.iter().enumerate() {
        let Some(Texture::Bitmap(bitmap)) = &scene.shapes[i].texture else { continue };
        let key = Arc::as_ptr(&bitmap.picture);
        let first = packed.iter().find(|(picture, _)| *picture == key).map(|(_, first)| *first);
        let first = first.unwrap_or_else(|| {
            let first = rows.len();
            rows.extend(bitmap.picture.texels.iter().map(|&[r, g, b]| [r, g, b, 0.0]));
            packed.push((key, first));
            first
        });
        let flags = bitmap.wrap as u32 + 4 * bitmap.filter as u32;
        rows[CAMERA_ROWS + PRIMITIVE_ROWS * k + BITMAP_ROW] =
            [first as f32, bitmap.picture.width as f32, bitmap.picture.height as f32, flags as f32];
    }
}

/// Appends the triangles, and notes in the rows of meshes that emit where their tables are.
fn pack_meshes(shapes: &[&Shape], frame: &Frame, offset: f64, rows: &mut Vec<[f32; 4]>) {
    let first = shapes.iter().position(|s| mesh_of(s).is_some()).unwrap_or(shapes.len());
    let meshes: Vec<&Mesh> = shapes[first..].iter().filter_map(|s| mesh_of(s)).collect();
    if meshes.is_empty() {
        // A pipeline for meshes finds a tree without boxes here.
        rows.resize(rows.len() + PRIMITIVE_ROWS + mesh::HEADER_ROWS, [0.0; 4]);
        return;
    }
    let corners = shapes[first..].iter().any(|s| s.texture.is_some()) || meshes.iter().any(|m| !m.normals.is_empty());
    let lights = shapes[first..].iter().filter(|s| emits(s)).count();
    let packed = mesh::pack(&meshes, frame, offset, rows.len(), corners, lights);
    for (i, [table, count]) in packed.tables.into_iter().enumerate() {
        let geometry = &mut rows[CAMERA_ROWS + PRIMITIVE_ROWS * (first + i)];
        (geometry[0], geometry[1]) = (table, count);
    }
    rows.extend(packed.rows);
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

/// Whether another shape but a sphere comes near shape `index`: whether its box meets one of `boxes`, those of the shapes.
fn touches(boxes: &[Option<(DVec3, DVec3)>], index: usize, half_extent: f64) -> bool {
    let near = DVec3::splat(10.0 * SLACK * half_extent);
    let meets = |a: (DVec3, DVec3), b: (DVec3, DVec3)| b.0.cmple(a.1 + near).all() && b.1.cmpge(a.0 - near).all();
    let mut others = boxes.iter().enumerate().filter(|(i, _)| *i != index).filter_map(|(_, other)| *other);
    boxes[index].is_some_and(|own| others.any(|other| meets(own, other)))
}

/// Rows of one shape; `slack` is how much wider than the surface the hit test of a rectangle is.
fn pack_shape(shape: &Shape, frame: &Frame, offset: f64, slack: f64, upper: f64, rows: &mut Vec<[f32; 4]>) {
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
            let test = [1.0 + slack / lu, 1.0 + slack / lv];
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
        Geometry::Mesh(ref mesh) => {
            rows.push([0.0, 0.0, 0.0, (mesh.area() * frame.scale * frame.scale) as f32]);
            rows.push(row(shape.albedo, 0.0));
            rows.push(row(shape.radiance, upper));
        }
    }
    rows.resize(begin + TEXTURE_ROW, [0.0; 4]);
    match &shape.texture {
        None => {}
        Some(Texture::Checker(Checker { albedo, repeats, offset })) => {
            rows.push(row(*albedo, 1.0));
            rows.push([repeats.x, repeats.y, offset.x, offset.y].map(|v| v as f32));
        }
        Some(Texture::Bitmap(Bitmap { matrix, offset, .. })) => {
            rows.push([matrix.x_axis.x, matrix.y_axis.x, offset.x, 2.0].map(|v| v as f32));
            rows.push([matrix.x_axis.y, matrix.y_axis.y, offset.y, 0.0].map(|v| v as f32));
        }
    }
    rows.resize(begin + MATERIAL_ROW, [0.0; 4]);
    pack_material(shape, rows);
    rows.resize(begin + PRIMITIVE_ROWS, [0.0; 4]);
}

/// See MATERIAL in glsl/lib/scene.glsl.
fn pack_material(shape: &Shape, rows: &mut Vec<[f32; 4]>) {
    let (kind, two_sided) = (material_kind(&shape.bsdf) as f32, f32::from(u8::from(shape.two_sided)));
    let head = |roughness: f64, ior: f64| [kind, roughness as f32, ior as f32, two_sided];
    match shape.bsdf {
        Bsdf::Diffuse => rows.push(head(0.0, 1.0)),
        Bsdf::Conductor { eta, k, roughness } => {
            rows.extend([head(roughness.unwrap_or(0.0), 1.0), row(eta, 0.0), row(k, 0.0)]);
        }
        Bsdf::Dielectric { ior, transmittance } => {
            rows.extend([head(0.0, ior), row(shape.albedo, 0.0), row(transmittance, 0.0)]);
        }
        Bsdf::Plastic { ior, specular, nonlinear } => {
            // The choice of lobes by the means of their reflectances, as Mitsuba's.
            let base = match &shape.texture {
                Some(Texture::Bitmap(bitmap)) => bitmap.picture.mean(),
                Some(Texture::Checker(checker)) => 0.5 * (shape.albedo + checker.albedo),
                None => shape.albedo,
            };
            let (base, coating) = (base.element_sum(), specular.element_sum());
            let share = if base + coating > 0.0 { coating / (base + coating) } else { 0.5 };
            rows.extend([
                head(0.0, ior),
                row(specular, diffuse_reflectance(1.0 / ior)),
                [share as f32, f32::from(u8::from(nonlinear)), 0.0, 0.0],
            ]);
        }
    }
}

/// Part of diffuse light that a dielectric surface reflects, by the index of refraction beyond over that before it: fits by Egan and
/// Hilgeman (1973) below 1 and d'Eon and Irving (2011) above, as Mitsuba's.
fn diffuse_reflectance(eta: f64) -> f64 {
    let inverse = 1.0 / eta;
    if eta < 1.0 {
        0.0636 * inverse + (eta * (eta * -1.4399 + 0.7099) + 0.6681)
    } else {
        let fit = [-1.36881, 4.98554, -7.80989, 6.75335, -3.4793, 0.919317];
        fit.into_iter().fold(0.0, |sum, c| sum * inverse + c)
    }
}

/// The rows of a plane from its normal on: `axis` as [`axis_of`] gives it, `test` is how far a hit may be from the centre, `inner` how far it is left, in
/// halves of the edges.
fn push_plane([u, v]: [DVec3; 2], axis: u32, test: [f64; 2], inner: [f64; 2], rows: &mut Vec<[f32; 4]>) {
    let (lu, lv) = (u.length(), v.length());
    rows.push(row(u.cross(v).normalize() + DVec3::ZERO, f64::from(axis))); // no -0
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
