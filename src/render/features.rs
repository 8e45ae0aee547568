//! What a scene and its settings need. Everything else is compiled out of the pipelines.

use glam::DVec3;

use super::enclosure::{box_sides, camera_inside, can_block, spheres_apart};
use super::pack::{Frame, order};
use super::settings::{Estimator, Sampler, Settings};
use crate::named::named;
use crate::scene::{Bsdf, DeltaKind, Environment, Falloff, Geometry, Mesh, Scene, Shape, Texture};
use crate::shaders;

/// Up to this many spheres and as many rectangles are held in registers and tested without a loop.
pub const MAX_UNROLLED: usize = 16;

/// Counts and kinds that specialise the pipelines. Two scenes with equal features share them.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Features {
    /// Spheres.
    pub sphere_count: u32,
    /// Rectangles and disks.
    pub rect_count: u32,
    /// Of these, the first disk, in the order of the buffers.
    pub disk_first: u32,
    /// Disks.
    pub disk_count: u32,
    /// Spheres that emit outward.
    pub sphere_light_count: u32,
    /// Rectangles and disks that emit.
    pub rect_light_count: u32,
    /// Spheres whose normal points inward.
    pub inward_count: u32,
    /// Of these, those that emit.
    pub inward_light_count: u32,
    /// Two bits a rectangle: 0 any orientation, 1, 2, 3 across x, y, z.
    pub rect_axes: u32,
    /// One bit a rectangle: set where it can come between a surface and a light.
    pub rect_blockers: u32,
    /// Five bits a side of a box around the whole scene (low x, y, z, high x, y, z): which rectangle that is, counted from 1. One may
    /// be missing (0); all are where there is no such box.
    pub box_sides: u32,
    /// No outward sphere meets another.
    pub spheres_apart: bool,
    /// Meshes.
    pub mesh_count: u32,
    /// Of these, those that emit.
    pub mesh_light_count: u32,
    /// A mesh has vertex normals.
    pub mesh_smooth: bool,
    /// Steps that a ray takes through the tree of triangles, roughly; 0 where there are none.
    pub mesh_steps: u32,
    /// A surface has two reflectances in a checkerboard.
    pub checkers: bool,
    /// A surface has a picture.
    pub bitmaps: bool,
    /// One bit a kind of material that a surface has beyond diffuse ones, as the shader counts them.
    pub materials: u32,
    /// A surface scatters on both sides.
    pub two_sided: bool,
    /// Lights that no ray meets.
    pub delta_count: u32,
    /// One bit a kind of them, as the shader counts them.
    pub delta_kinds: u32,
    /// What surrounds the scene: 0 nothing, 1 the same radiance from everywhere, 2 a map.
    pub environment: u32,
    /// A ray after the last reflection finds light that no light sample has.
    pub last_rays: bool,
    /// Few primitives: all in registers.
    pub preload: bool,
    /// The camera is inside a sphere whose normal points outward.
    pub camera_inside: bool,
    /// As in [`Settings`].
    pub estimator: Estimator,
    /// As in [`Settings`].
    pub sampler: Sampler,
    /// As in [`Settings`].
    pub bounces: u32,
    /// As in [`Settings`].
    pub aa: bool,
    /// The variance of the mean is kept.
    pub variance: bool,
    /// As in [`Settings`].
    pub halves: bool,
    /// As in [`Settings`].
    pub aovs: bool,
    /// The camera has a lens.
    pub lens: bool,
    /// As in [`Settings`]; `u32::MAX` where no path is ended so.
    pub roulette: u32,
}

/// What pipelines leave out where a scene does not need it, and what shows a gain by itself. Whether it is left out changes no bit
/// of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Skip {
    /// Loops over the primitives, read from a buffer: few are held in registers, each with its orientation known.
    Loops,
    /// Shadow tests against rectangles that bound the scene.
    ShadowTests,
    /// Tests of those sides of a box around everything that a ray does not run toward.
    Walls,
    /// The far sides of outward spheres.
    FarSides,
    /// The distances of spheres behind the nearest one.
    Roots,
    /// The lookup of a second reflectance.
    Checkers,
    /// Every material but diffuse ones.
    Materials,
    /// The tree of triangles; kept, it is an empty one.
    Meshes,
    /// The radiance of rays that leave the scene; kept, it is none.
    Environment,
    /// Rays after the last reflection's light sample, where they would meet no light that it leaves to them.
    LastRays,
    /// First-hit values.
    Aovs,
}

named!(
    Skip,
    "skipped feature",
    Loops = "loops",
    ShadowTests = "shadow-tests",
    Walls = "walls",
    FarSides = "far-sides",
    Roots = "roots",
    Checkers = "checkers",
    Materials = "materials",
    Meshes = "meshes",
    Environment = "environment",
    LastRays = "last-rays",
    Aovs = "aovs"
);

impl Features {
    /// The same with something that the scene does not need; with [`Skip::Loops`] it is what scenes of more than
    /// [`MAX_UNROLLED`] spheres or rectangles get.
    #[must_use]
    pub fn with(mut self, skip: Skip) -> Self {
        match skip {
            // The box's sides are read from registers.
            Skip::Loops => (self.preload, self.box_sides) = (false, 0),
            Skip::ShadowTests => self.rect_blockers = u32::MAX,
            Skip::Walls => self.box_sides = 0,
            Skip::FarSides => self.camera_inside = true,
            Skip::Roots => self.spheres_apart = false,
            Skip::Checkers => self.checkers = true,
            Skip::Materials => {
                (self.materials, self.two_sided) = (ALL_MATERIALS, true);
            }
            // Where nothing follows the primitives in the buffer, it reads as a tree without boxes.
            Skip::Meshes if self.mesh_count + self.delta_count == 0 && !self.bitmaps && self.environment < 2 => {
                self.mesh_count = 1;
            }
            Skip::Meshes => {}
            Skip::Environment => self.environment = self.environment.max(1),
            Skip::LastRays => self.last_rays = true,
            Skip::Aovs => self.aovs = true,
        }
        self
    }

    /// What these features leave out of `Skip::ALL`.
    pub fn skips(&self) -> impl Iterator<Item = Skip> {
        let features = self.clone();
        Skip::ALL.into_iter().filter(move |&skip| features.clone().with(skip) != features)
    }

    /// With all of it: the pipeline that renders any scene of these counts and kinds.
    #[must_use]
    pub fn generic(&self) -> Self {
        Skip::ALL.into_iter().fold(self.clone(), Self::with)
    }

    /// Reads them off a scene and its settings.
    pub fn new(scene: &Scene, settings: &Settings) -> Self {
        let shapes: Vec<&Shape> = order(scene).into_iter().map(|i| &scene.shapes[i]).collect();
        let count = |f: &dyn Fn(&Shape) -> bool| shapes.iter().filter(|s| f(s)).count() as u32;
        let rects: Vec<&Shape> = shapes.iter().copied().filter(|s| is_flat(s)).collect();
        let (sphere_count, rect_count) = (count(&is_sphere), rects.len() as u32);
        let preload = sphere_count.max(rect_count) as usize <= MAX_UNROLLED;
        let frame = Frame::of(scene);
        let (mut rect_axes, mut rect_blockers) = (0, u32::MAX);
        if preload {
            rect_blockers = 0;
            for (i, rect) in rects.iter().enumerate() {
                rect_axes |= axis_of(&rect.geometry) << (2 * i);
                rect_blockers |= u32::from(can_block(rect, scene, 1e-7 * frame.half_extent)) << i;
            }
        }
        let mut features = Self {
            sphere_count,
            rect_count,
            disk_first: rects.iter().position(|s| is_disk(s)).unwrap_or(0) as u32,
            disk_count: count(&is_disk),
            sphere_light_count: count(&|s| is_sphere(s) && !is_inward(s) && emits(s)),
            rect_light_count: count(&|s| is_flat(s) && emits(s)),
            inward_count: count(&is_inward),
            inward_light_count: count(&|s| is_inward(s) && emits(s)),
            rect_axes,
            rect_blockers,
            box_sides: if preload { box_sides(&rects, scene, &frame) } else { 0 },
            spheres_apart: preload && spheres_apart(scene, &frame),
            mesh_count: count(&|s| mesh_of(s).is_some()),
            mesh_light_count: count(&|s| mesh_of(s).is_some() && emits(s)),
            mesh_smooth: shapes.iter().any(|s| mesh_of(s).is_some_and(|mesh| !mesh.normals.is_empty())),
            mesh_steps: mesh_steps(&shapes),
            checkers: shapes.iter().any(|s| matches!(s.texture, Some(Texture::Checker(_)))),
            bitmaps: shapes.iter().any(|s| matches!(s.texture, Some(Texture::Bitmap(_)))),
            materials: shapes.iter().map(|s| 1 << material_kind(&s.bsdf)).fold(0, |all, bit| all | bit) & ALL_MATERIALS,
            two_sided: shapes.iter().any(|s| s.two_sided),
            delta_count: scene.delta_lights.len() as u32,
            delta_kinds: scene
                .delta_lights
                .iter()
                .map(|light| 1 << delta_kind(&light.kind))
                .fold(0, |all, bit| all | bit),
            environment: match scene.environment {
                None => 0,
                Some(Environment::Constant(_)) => 1,
                Some(Environment::Map(_)) => 2,
            },
            preload,
            camera_inside: camera_inside(scene),
            estimator: settings.estimator,
            sampler: settings.sampler,
            bounces: settings.bounces,
            aa: settings.aa,
            variance: settings.batch_size() > 0,
            halves: settings.halves,
            aovs: settings.aovs,
            lens: scene.camera.lens.is_some(),
            roulette: settings.roulette_from().unwrap_or(u32::MAX),
            last_rays: true,
        };
        features.last_rays = features.needs_last_rays();
        features
    }

    /// Light samples have all of the light of spheres that diffuse surfaces reflect, and only of that.
    fn needs_last_rays(&self) -> bool {
        let others = self.rect_light_count + self.mesh_light_count + self.inward_light_count + self.environment;
        self.estimator != Estimator::Nee || self.sampled_lights() == 0 || others + self.materials > 0
    }

    /// `loops_end`: the device ends a run's loops after some rounds.
    pub(super) fn path_trace_spec(&self, loops_end: bool) -> shaders::path_trace::Spec {
        shaders::path_trace::Spec {
            sphere_count: self.sphere_count,
            rect_count: self.rect_count,
            disk_first: self.disk_first,
            disk_count: self.disk_count,
            sphere_light_count: self.sphere_light_count,
            rect_light_count: self.rect_light_count,
            inward_first: self.sphere_count - self.inward_count,
            inward_light_count: self.inward_light_count,
            rect_axes: self.rect_axes,
            rect_blockers: self.rect_blockers,
            box_sides: self.box_sides,
            spheres_apart: self.spheres_apart,
            mesh_count: self.mesh_count,
            mesh_light_count: self.mesh_light_count,
            mesh_smooth: self.mesh_smooth,
            loops_end,
            checkers: self.checkers,
            bitmaps: self.bitmaps,
            materials: self.materials,
            two_sided: self.two_sided,
            delta_count: self.delta_count,
            delta_kinds: self.delta_kinds,
            environment: self.environment,
            last_rays: self.last_rays,
            preload: self.preload,
            camera_inside: self.camera_inside,
            estimator: match self.estimator {
                Estimator::Uniform => 0,
                Estimator::Cosine => 1,
                Estimator::Nee => 2,
            },
            sampler: match self.sampler {
                Sampler::Pcg => 0,
                Sampler::Sobol => 1,
            },
            bounces: self.bounces,
            antialias: self.aa,
            variance: self.variance,
            halves: self.halves,
            aovs: self.aovs,
            lens: self.lens,
            roulette: self.roulette,
        }
    }

    /// Loop iterations of one path at most, inner loops included: whether a driver unrolls them is its own affair. With
    /// triangles an estimate: there the shader finds out for itself, and goes on in another run.
    pub(super) fn iterations_per_path(&self) -> u32 {
        let primitives = self.sphere_count + self.rect_count + self.mesh_steps;
        let lights = self.sampled_lights();
        let queries = if self.estimator == Estimator::Nee { 2 * primitives + lights } else { primitives };
        (self.bounces + 2) * (1 + queries)
    }

    fn sampled_lights(&self) -> u32 {
        let map = u32::from(self.environment == 2);
        self.sphere_light_count + self.rect_light_count + self.mesh_light_count + self.delta_count + map
    }

    /// What this scene does not need and the pipelines therefore do not have, in words.
    pub fn skipped(&self) -> Vec<String> {
        let mut list = Vec::new();
        let mut skip = |yes: bool, text: &str| {
            if yes {
                list.push(text.to_owned());
            }
        };
        let lights = self.sampled_lights();
        let free = (0..self.rect_count).filter(|i| self.preload && self.rect_blockers >> i & 1 == 0).count();
        let aligned = (0..self.rect_count).filter(|i| self.preload && self.rect_axes >> (2 * i) & 3 != 0).count();
        skip(self.sphere_count == 0, "sphere intersection");
        skip(self.rect_count == 0, "rectangle intersection");
        skip(self.disk_count == 0, "disks");
        skip(self.sphere_light_count == 0, "sphere lights");
        skip(self.mesh_count == 0, "triangles and their tree");
        skip(self.mesh_count > 0 && !self.mesh_smooth, "interpolated normals");
        skip(self.rect_light_count == 0, "rectangle lights and multiple importance sampling");
        skip(self.inward_count == 0, "inward spheres");
        skip(lights < 2 && self.estimator == Estimator::Nee, "choice among lights");
        skip(self.estimator != Estimator::Nee, "light sampling and shadow rays");
        skip(!self.checkers, "checkerboards");
        skip(!self.bitmaps, "pictures on surfaces");
        skip(self.materials == 0, "all materials but diffuse ones");
        skip(!self.two_sided, "reflection on backs");
        skip(self.delta_count == 0, "lights without a surface");
        skip(self.environment == 0, "the environment");
        skip(self.box_sides != 0, "walls that a ray leaves behind");
        skip(!self.camera_inside, "far sides of outward spheres");
        skip(self.spheres_apart, "distances of spheres behind the nearest");
        skip(self.preload, "primitive loops (all primitives in registers)");
        skip(!self.aa, "a camera ray for every sample (one first hit a pixel)");
        skip(!self.variance, "variance");
        skip(!self.aovs, "first-hit values");
        skip(!self.lens, "the lens");
        skip(self.roulette == u32::MAX, "Russian roulette");
        skip(!self.halves, "the difference of two halves");
        if aligned > 0 {
            skip(true, &format!("general plane tests for {aligned} axis-aligned rectangles"));
        }
        if free > 0 && self.estimator == Estimator::Nee {
            skip(true, &format!("shadow tests against {free} rectangles that bound the scene"));
        }
        list
    }
}

/// Kinds of materials as the shader counts them (glsl/lib/bsdf.glsl).
pub(super) fn material_kind(bsdf: &Bsdf) -> u32 {
    match bsdf {
        Bsdf::Diffuse => 0,
        Bsdf::Conductor { roughness: None, .. } => 1,
        Bsdf::Conductor { roughness: Some(_), .. } => 2,
        Bsdf::Dielectric { .. } => 3,
        Bsdf::Plastic { .. } => 4,
    }
}

/// Kinds of lights without a surface as the shader counts them (glsl/lib/lights.glsl).
pub(super) fn delta_kind(kind: &DeltaKind) -> u32 {
    match kind {
        DeltaKind::Point { .. } => 0,
        DeltaKind::Directional { .. } => 1,
        DeltaKind::Spot { falloff: Falloff::Linear, .. } => 2,
        DeltaKind::Spot { falloff: Falloff::Squared, .. } => 3,
    }
}

const ALL_MATERIALS: u32 = 0b11110;

/// A rectangle or a disk?
pub(super) fn is_flat(shape: &Shape) -> bool {
    matches!(shape.geometry, Geometry::Rectangle { .. } | Geometry::Disk { .. })
}

pub(super) fn is_sphere(shape: &Shape) -> bool {
    matches!(shape.geometry, Geometry::Sphere { .. })
}

pub(super) fn mesh_of(shape: &Shape) -> Option<&Mesh> {
    match &shape.geometry {
        Geometry::Mesh(mesh) => Some(mesh),
        _ => None,
    }
}

/// Two nodes a level and some triangles, as long as the tree is balanced.
fn mesh_steps(shapes: &[&Shape]) -> u32 {
    let triangles: usize = shapes.iter().filter_map(|s| mesh_of(s)).map(|mesh| mesh.triangles.len()).sum();
    if triangles > 0 { 2 * triangles.ilog2() + 8 } else { 0 }
}

pub(super) fn is_disk(shape: &Shape) -> bool {
    matches!(shape.geometry, Geometry::Disk { .. })
}

pub(super) fn is_inward(shape: &Shape) -> bool {
    matches!(shape.geometry, Geometry::Sphere { inward: true, .. })
}

pub(super) fn emits(shape: &Shape) -> bool {
    shape.radiance.max_element() > 0.0
}

/// 1, 2, 3 where the edges run along axes and the normal along x, y, z; 0 otherwise.
pub(super) fn axis_of(geometry: &Geometry) -> u32 {
    let Geometry::Rectangle { half_u, half_v, .. } = geometry else { return 0 };
    let along = |v: DVec3| {
        let (v, length) = (v.abs(), v.length());
        (0..3).find(|&i| v[i] >= length * (1.0 - 1e-12) && (0..3).all(|j| j == i || v[j] <= 1e-9 * length))
    };
    match (along(*half_u), along(*half_v)) {
        (Some(u), Some(v)) if u != v => (3 - u - v) as u32 + 1,
        _ => 0,
    }
}
