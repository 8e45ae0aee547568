//! A short fingerprint of a scene.

use super::math::positive_zero;
use super::{Bsdf, DeltaKind, Environment, Geometry, Mesh, Picture, Scene, Shape, Texture};
use glam::DVec3;
use sha2::{Digest, Sha256};

impl Scene {
    /// 16 hexadecimal digits: the head of the SHA-256 over image size, camera and shapes in their order, from the exact
    /// bits of every f64 (-0 counts as 0). Names do not count. Two scenes with one hash render alike.
    pub fn hash(&self) -> String {
        let mut state = Sha256::new();
        state.update(b"limpid scene 1");
        let camera = &self.camera;
        state.update(camera.width.to_le_bytes());
        state.update(camera.height.to_le_bytes());
        numbers(&mut state, &[camera.fov_x_degrees]);
        numbers(&mut state, &camera.to_world.to_cols_array());
        if let Some(lens) = camera.lens {
            state.update(b"lens");
            numbers(&mut state, &[lens.aperture_radius, lens.focus_distance]);
        }
        state.update((self.shapes.len() as u64).to_le_bytes());
        for shape in &self.shapes {
            match &shape.geometry {
                &Geometry::Sphere { center, radius, inward } => {
                    state.update(if inward { b"i" } else { b"s" });
                    vectors(&mut state, &[center]);
                    numbers(&mut state, &[radius]);
                }
                &Geometry::Rectangle { center, half_u, half_v } => {
                    state.update(b"r");
                    vectors(&mut state, &[center, half_u, half_v]);
                }
                &Geometry::Disk { center, half_u, half_v } => {
                    state.update(b"d");
                    vectors(&mut state, &[center, half_u, half_v]);
                }
                Geometry::Mesh(mesh) => self::mesh(&mut state, mesh),
            }
            vectors(&mut state, &[shape.albedo, shape.radiance]);
            material(&mut state, shape);
        }
        for light in &self.delta_lights {
            vectors(&mut state, &[light.intensity]);
            match light.kind {
                DeltaKind::Point { position } => {
                    state.update(b"point");
                    vectors(&mut state, &[position]);
                }
                DeltaKind::Spot { position, direction, beam_degrees, cutoff_degrees, falloff } => {
                    state.update(b"spot");
                    state.update([falloff as u8]);
                    vectors(&mut state, &[position, direction]);
                    numbers(&mut state, &[beam_degrees, cutoff_degrees]);
                }
                DeltaKind::Directional { direction } => {
                    state.update(b"directional");
                    vectors(&mut state, &[direction]);
                }
            }
        }
        match &self.environment {
            None => {}
            Some(Environment::Constant(radiance)) => {
                state.update(b"constant");
                vectors(&mut state, &[*radiance]);
            }
            Some(Environment::Map(map)) => {
                state.update(b"map");
                numbers(&mut state, &[map.scale]);
                numbers(&mut state, &map.to_world.to_cols_array());
                picture(&mut state, &map.picture);
            }
        }
        state.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect()
    }
}

/// A plain diffuse surface adds nothing.
fn material(state: &mut Sha256, shape: &Shape) {
    match &shape.texture {
        None => {}
        Some(Texture::Checker(checker)) => {
            state.update(b"c");
            vectors(state, &[checker.albedo]);
            numbers(state, &[checker.repeats.to_array(), checker.offset.to_array()].concat());
        }
        Some(Texture::Bitmap(bitmap)) => {
            state.update(b"bitmap");
            state.update([bitmap.wrap as u8, bitmap.filter as u8]);
            numbers(state, &bitmap.matrix.to_cols_array());
            numbers(state, &bitmap.offset.to_array());
            picture(state, &bitmap.picture);
        }
    }
    match shape.bsdf {
        Bsdf::Diffuse => {}
        Bsdf::Conductor { eta, k, roughness } => {
            state.update(b"conductor");
            vectors(state, &[eta, k]);
            numbers(state, &[roughness.unwrap_or(0.0)]);
        }
        Bsdf::Dielectric { ior, transmittance } => {
            state.update(b"dielectric");
            numbers(state, &[ior]);
            vectors(state, &[transmittance]);
        }
        Bsdf::Plastic { ior, specular, nonlinear } => {
            state.update(b"plastic");
            numbers(state, &[ior, f64::from(u8::from(nonlinear))]);
            vectors(state, &[specular]);
        }
    }
    if shape.two_sided {
        state.update(b"two-sided");
    }
}

fn picture(state: &mut Sha256, picture: &Picture) {
    state.update(picture.width.to_le_bytes());
    state.update(picture.height.to_le_bytes());
    picture.texels.iter().flatten().for_each(|v| state.update(v.to_bits().to_le_bytes()));
}

fn mesh(state: &mut Sha256, mesh: &Mesh) {
    state.update(b"m");
    for count in [mesh.positions.len(), mesh.triangles.len(), mesh.normals.len(), mesh.uvs.len()] {
        state.update((count as u64).to_le_bytes());
    }
    mesh.triangles.as_flattened().iter().for_each(|i| state.update(i.to_le_bytes()));
    vectors(state, &mesh.positions);
    vectors(state, &mesh.normals);
    mesh.uvs.iter().for_each(|uv| numbers(state, &uv.to_array()));
}

fn vectors(state: &mut Sha256, vectors: &[DVec3]) {
    vectors.iter().for_each(|v| numbers(state, &v.to_array()));
}

fn numbers(state: &mut Sha256, numbers: &[f64]) {
    numbers.iter().for_each(|&v| state.update(positive_zero(v).to_bits().to_le_bytes()));
}
