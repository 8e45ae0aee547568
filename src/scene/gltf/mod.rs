//! glTF 2.0: `.gltf` and `.glb` files.
//!
//! Read are the default scene's triangles with normals and texture coordinates, metallic-roughness materials with a base colour texture
//! and emission, the first perspective camera, and `KHR_lights_punctual`, `KHR_materials_emissive_strength`, `KHR_materials_ior`,
//! `KHR_materials_transmission`, `KHR_texture_transform`. How a material becomes one of limpid's stands in `material.rs`. A file without a camera is shown
//! as a whole, one without light under an even sky; both are named in [`Loaded::left_out`]. Anything else is an error or, with
//! [`Options::lenient`], left out and named.

mod material;

use super::mitsuba::Options;
use super::validate::check_size;
use super::{Camera, DeltaKind, DeltaLight, Environment, Falloff, Geometry, Loaded, Mesh, Scene, Shape};
use crate::{Error, Result};
use glam::{DMat3, DMat4, DVec2, DVec3};
use gltf::khr_lights_punctual::Kind;
use gltf::mesh::Mode;
use material::Materials;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

/// Height of a picture whose size nobody states, pixels.
const DEFAULT_HEIGHT: u32 = 768;
/// The horizontal field of view of the camera that a file without one gets, degrees.
const DEFAULT_FOV: f64 = 45.0;

/// What is not supported, and whether it is refused.
pub(super) struct Notes<'a> {
    file: &'a Path,
    lenient: bool,
    list: RefCell<Vec<String>>,
}

impl Notes<'_> {
    fn error(&self, message: impl std::fmt::Display) -> Error {
        Error::input(format!("{}: {message}", self.file.display()))
    }

    /// Notes it once.
    fn note(&self, message: impl std::fmt::Display) {
        let note = format!("{}: {message}", self.file.display());
        let mut list = self.list.borrow_mut();
        if !list.contains(&note) {
            list.push(note);
        }
    }

    /// An error, or a note where the file is read leniently.
    fn unsupported(&self, message: impl std::fmt::Display) -> Result<()> {
        if self.lenient {
            self.note(message);
            return Ok(());
        }
        Err(self.error(format!("{message} (--lenient leaves it out)")))
    }
}

/// Loads and validates a file.
pub fn load(path: impl AsRef<Path>, options: &Options) -> Result<Loaded> {
    let path = path.as_ref();
    let notes = Notes { file: path, lenient: options.lenient, list: RefCell::default() };
    if !options.parameters.is_empty() {
        return Err(notes.error("parameters ($name) go with Mitsuba XML files"));
    }
    std::fs::File::open(path).map_err(|error| Error::io(path, error))?;
    let (document, buffers, images) = gltf::import(path).map_err(|error| notes.error(error))?;
    let root = document.default_scene().or_else(|| document.scenes().next());
    let root = root.ok_or_else(|| notes.error("the file has no scene"))?;
    let materials = Materials::new(&notes, &images);
    let mut reading = Reading {
        notes: &notes,
        materials,
        buffers: &buffers,
        options,
        parts: Parts::default(),
        visited: BTreeSet::new(),
    };
    for node in root.nodes() {
        reading.node(&node, DMat4::IDENTITY)?;
    }
    let parts = reading.parts;
    let camera = parts.camera.map_or_else(|| overview(&parts.shapes, options, &notes), Ok)?;
    let mut scene = Scene::new(camera, parts.shapes);
    scene.delta_lights = parts.lights;
    if scene.max_radiance() == 0.0 {
        notes.note("no light: shown under an even sky of radiance 1");
        scene.environment = Some(Environment::Constant(DVec3::ONE));
    }
    scene.validate().map_err(|error| notes.error(error))?;
    Ok(Loaded { scene, spp: None, bounces: None, left_out: notes.list.into_inner() })
}

#[derive(Default)]
struct Parts {
    camera: Option<Camera>,
    shapes: Vec<Shape>,
    lights: Vec<DeltaLight>,
}

struct Reading<'a> {
    notes: &'a Notes<'a>,
    materials: Materials<'a>,
    buffers: &'a [gltf::buffer::Data],
    options: &'a Options,
    parts: Parts,
    visited: BTreeSet<usize>,
}

impl Reading<'_> {
    /// Nodes are a forest, which nobody has checked yet.
    fn node(&mut self, node: &gltf::Node, parent: DMat4) -> Result<()> {
        if !self.visited.insert(node.index()) {
            return Err(self.notes.error(format!("node {} has two parents or is its own ancestor", node.index())));
        }
        let columns = node.transform().matrix().map(|column| column.map(f64::from));
        let to_world = parent * DMat4::from_cols_array_2d(&columns);
        let name = node.name().map_or_else(|| format!("node-{}", node.index()), str::to_owned);
        if let Some(camera) = node.camera()
            && self.parts.camera.is_none()
        {
            self.parts.camera = self.camera(&camera, to_world)?;
        }
        if let Some(light) = node.light() {
            let light = self.light(&light, to_world, &name)?;
            self.parts.lights.push(light);
        }
        if let Some(mesh) = node.mesh() {
            if node.skin().is_some() || mesh.primitives().any(|primitive| primitive.morph_targets().len() > 0) {
                self.notes.unsupported(format!("node '{name}': skins and morph targets are not supported"))?;
            }
            for primitive in mesh.primitives() {
                let shape = self.primitive(&primitive, to_world, &name)?;
                self.parts.shapes.extend(shape);
            }
        }
        node.children().try_for_each(|child| self.node(&child, to_world))
    }

    fn camera(&self, camera: &gltf::Camera, to_world: DMat4) -> Result<Option<Camera>> {
        let gltf::camera::Projection::Perspective(perspective) = camera.projection() else {
            self.notes.unsupported("orthographic cameras are not supported")?;
            return Ok(None);
        };
        let stated = f64::from(perspective.aspect_ratio().unwrap_or(4.0 / 3.0));
        let width = (f64::from(DEFAULT_HEIGHT) * stated).round().clamp(1.0, 1e6) as u32;
        let (width, height) = self.options.size.unwrap_or((width, DEFAULT_HEIGHT));
        check_size(width, height)?;
        let half_y = (0.5 * f64::from(perspective.yfov())).tan();
        let fov_x = 2.0 * (half_y * f64::from(width) / f64::from(height)).atan();
        Ok(Some(Camera {
            to_world: self.rigid(to_world, "a camera")?,
            fov_x_degrees: fov_x.to_degrees(),
            width,
            height,
            lens: None,
        }))
    }

    /// Scale makes no difference to cameras and lights.
    fn rigid(&self, to_world: DMat4, what: &str) -> Result<DMat4> {
        let axes = DMat3::from_mat4(to_world);
        let [x, y, z] = [axes.x_axis, axes.y_axis, axes.z_axis].map(DVec3::normalize_or_zero);
        let matrix = DMat4::from_cols(x.extend(0.0), y.extend(0.0), z.extend(0.0), to_world.w_axis);
        if (DMat3::from_cols(x, y, z).determinant() - 1.0).abs() > super::validate::SHEAR_TOLERANCE {
            return Err(self.notes.error(format!("{what} is mirrored, sheared or scaled to nothing")));
        }
        Ok(matrix)
    }

    fn light(&self, light: &gltf::khr_lights_punctual::Light, to_world: DMat4, name: &str) -> Result<DeltaLight> {
        let position = to_world.w_axis.truncate();
        let direction = || Ok::<_, Error>(-self.rigid(to_world, "a light")?.z_axis.truncate());
        let kind = match light.kind() {
            Kind::Point => DeltaKind::Point { position },
            Kind::Directional => DeltaKind::Directional { direction: direction()? },
            Kind::Spot { inner_cone_angle, outer_cone_angle } => DeltaKind::Spot {
                position,
                direction: direction()?,
                beam_degrees: f64::from(inner_cone_angle).to_degrees(),
                cutoff_degrees: f64::from(outer_cone_angle).to_degrees(),
                falloff: Falloff::Squared,
            },
        };
        let color = DVec3::from_array(light.color().map(f64::from));
        let light = DeltaLight { name: name.to_owned(), intensity: color * f64::from(light.intensity()), kind };
        light.validate().map_err(|error| self.notes.error(format!("light '{name}': {error}")))?;
        Ok(light)
    }

    fn primitive(&self, primitive: &gltf::Primitive, to_world: DMat4, name: &str) -> Result<Option<Shape>> {
        if primitive.mode() != Mode::Triangles {
            self.notes
                .unsupported(format!("mesh '{name}': {:?} are not supported, only Triangles", primitive.mode()))?;
            return Ok(None);
        }
        if primitive.get(&gltf::Semantic::Colors(0)).is_some() {
            self.notes.unsupported(format!("mesh '{name}': colours of vertices are not supported"))?;
        }
        let surface = self.materials.of(&primitive.material())?;
        let mut mesh = self.mesh(primitive, surface.uv_set, name)?;
        let fail = |error: Error| self.notes.error(format!("mesh '{name}': {error}"));
        if !mesh.is_sound() {
            return mesh.validate().map_err(fail).map(|()| None);
        }
        mesh.transform(to_world);
        if DMat3::from_mat4(to_world).determinant() < 0.0 {
            // Its front stays its front.
            mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        if !mesh.is_sound() {
            return mesh.validate().map_err(fail).map(|()| None);
        }
        let dropped = mesh.drop_degenerate();
        if dropped > 0 {
            self.notes.note(format!("mesh '{name}': {dropped} triangles without area are left out"));
        }
        if mesh.triangles.is_empty() {
            return Ok(None);
        }
        if surface.radiance != DVec3::ZERO {
            mesh.normals.clear();
        }
        mesh.validate().map_err(fail)?;
        Ok(Some(surface.material.shape(name.to_owned(), Geometry::Mesh(Arc::new(mesh)), surface.radiance)))
    }

    fn mesh(&self, primitive: &gltf::Primitive, uv_set: u32, name: &str) -> Result<Mesh> {
        let reader = primitive.reader(|buffer| self.buffers.get(buffer.index()).map(|data| &data.0[..]));
        let positions: Vec<DVec3> = match reader.read_positions() {
            Some(positions) => positions.map(|p| DVec3::from_array(p.map(f64::from))).collect(),
            None => return Err(self.notes.error(format!("mesh '{name}' has no positions that can be read"))),
        };
        let indices: Vec<u32> = match reader.read_indices() {
            Some(indices) => indices.into_u32().collect(),
            None if primitive.indices().is_some() => {
                return Err(self.notes.error(format!("mesh '{name}' has indices that cannot be read")));
            }
            None => (0..positions.len() as u32).collect(),
        };
        let normals: Vec<DVec3> = reader.read_normals().map_or_else(Vec::new, |normals| {
            normals.map(|n| DVec3::from_array(n.map(f64::from)).normalize_or_zero()).collect()
        });
        let uvs = reader
            .read_tex_coords(uv_set)
            .map_or_else(Vec::new, |uvs| uvs.into_f32().map(|uv| DVec2::from_array(uv.map(f64::from))).collect());
        Ok(Mesh { positions, triangles: indices.as_chunks().0.to_vec(), normals, uvs })
    }
}

/// A view of all shapes from the front, a little from above and from the right.
fn overview(shapes: &[Shape], options: &Options, notes: &Notes) -> Result<Camera> {
    notes.note("no camera: shown as a whole");
    let bounds = shapes.iter().map(|shape| shape.geometry.bounds());
    let (low, high) = bounds
        .reduce(|(low, high), (a, b)| (low.min(a), high.max(b)))
        .ok_or_else(|| notes.error("neither a camera nor a mesh: there is nothing to show"))?;
    let (center, radius) = (0.5 * (low + high), (0.5 * (high - low).length()).max(1e-9));
    let (width, height) = options.size.unwrap_or((DEFAULT_HEIGHT, DEFAULT_HEIGHT));
    let narrow = (0.5 * DEFAULT_FOV).to_radians().tan() * f64::from(height.min(width)) / f64::from(width);
    let distance = radius / narrow.atan().sin();
    let from = center + DVec3::new(0.4, 0.3, 1.0).normalize() * distance;
    Camera::look_at(from, center, DVec3::Y, DEFAULT_FOV, width, height)
}
