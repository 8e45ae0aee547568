//! A short fingerprint of a scene.

use super::math::positive_zero;
use super::{Geometry, Scene};
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
            match shape.geometry {
                Geometry::Sphere { center, radius, inward } => {
                    state.update(if inward { b"i" } else { b"s" });
                    vectors(&mut state, &[center]);
                    numbers(&mut state, &[radius]);
                }
                Geometry::Rectangle { center, half_u, half_v } => {
                    state.update(b"r");
                    vectors(&mut state, &[center, half_u, half_v]);
                }
                Geometry::Disk { center, half_u, half_v } => {
                    state.update(b"d");
                    vectors(&mut state, &[center, half_u, half_v]);
                }
            }
            vectors(&mut state, &[shape.albedo, shape.radiance]);
            if let Some(checker) = shape.checker {
                state.update(b"c");
                vectors(&mut state, &[checker.albedo]);
                numbers(&mut state, &[checker.repeats.to_array(), checker.offset.to_array()].concat());
            }
        }
        state.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect()
    }
}

fn vectors(state: &mut Sha256, vectors: &[DVec3]) {
    vectors.iter().for_each(|v| numbers(state, &v.to_array()));
}

fn numbers(state: &mut Sha256, numbers: &[f64]) {
    numbers.iter().for_each(|&v| state.update(positive_zero(v).to_bits().to_le_bytes()));
}
