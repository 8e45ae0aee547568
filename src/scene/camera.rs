//! The pinhole camera on the host: construction and rays in f64.

use super::math::{positive_zero, sin_cos_degrees};
use super::{Camera, Ray};
use crate::{Error, Result};
use glam::{DMat4, DVec3, DVec4};

impl Camera {
    /// A camera at `origin` that looks at `target` with `up` upward in the picture. `fov_x_degrees` is horizontal.
    pub fn look_at(
        origin: DVec3,
        target: DVec3,
        up: DVec3,
        fov_x_degrees: f64,
        width: u32,
        height: u32,
    ) -> Result<Self> {
        Ok(Self { to_world: look_at_matrix(origin, target, up)?, fov_x_degrees, width, height, lens: None })
    }

    /// The tangents of half the field of view, horizontal and vertical (pixels are square).
    pub fn half_extent(&self) -> (f64, f64) {
        let (sin, cos) = sin_cos_degrees(0.5 * self.fov_x_degrees);
        let x = sin / cos;
        (x, x * f64::from(self.height) / f64::from(self.width))
    }

    /// The ray through the image point (x, y) in pixels: (0, 0) is the top left corner of the image, x grows to the
    /// right and y downward; the centre of pixel (i, j) is (i + 0.5, j + 0.5). World space, unit direction.
    pub fn ray(&self, x: f64, y: f64) -> Ray {
        let (half_x, half_y) = self.half_extent();
        let view = DVec3::new(
            (2.0 * x / f64::from(self.width) - 1.0) * half_x,
            (1.0 - 2.0 * y / f64::from(self.height)) * half_y,
            -1.0,
        );
        Ray { origin: self.origin(), direction: self.to_world.transform_vector3(view).normalize() }
    }

    /// The ray through the centre of pixel (i, j); see [`Camera::ray`].
    pub fn pixel_ray(&self, i: u32, j: u32) -> Ray {
        self.ray(f64::from(i) + 0.5, f64::from(j) + 0.5)
    }

    /// The eye, world space.
    pub fn origin(&self) -> DVec3 {
        self.to_world.w_axis.truncate()
    }
}

/// Camera to world (x right, y up, view -z) of an eye at `origin` that looks at `target`.
pub(super) fn look_at_matrix(origin: DVec3, target: DVec3, up: DVec3) -> Result<DMat4> {
    let back = (origin - target).try_normalize();
    let right = back.and_then(|back| up.cross(back).try_normalize());
    let (Some(back), Some(right)) = (back, right) else {
        return Err(Error::input(format!(
            "look-at from {origin} to {target} with up {up}: origin and target must differ, and up must not be parallel \
             to the view"
        )));
    };
    let columns = [right.extend(0.0), back.cross(right).extend(0.0), back.extend(0.0), origin.extend(1.0)];
    Ok(without_negative_zeros(DMat4::from_cols(columns[0], columns[1], columns[2], columns[3])))
}

/// `m` with every -0 made +0.
pub(super) fn without_negative_zeros(m: DMat4) -> DMat4 {
    let column = |v: DVec4| DVec4::from_array(v.to_array().map(positive_zero));
    DMat4::from_cols(column(m.x_axis), column(m.y_axis), column(m.z_axis), column(m.w_axis))
}
