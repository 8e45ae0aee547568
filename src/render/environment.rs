//! The environment as the shaders read it (glsl/lib/environment.glsl): texels, and tables by which light sampling draws directions.

use std::f64::consts::PI;

use glam::DVec3;

use crate::scene::{Environment, EnvironmentMap};

/// Appends the rows of a map; returns the four rows of the header. `share` is the map's in the choice of lights.
pub(super) fn pack(environment: &Environment, share: f64, rows: &mut Vec<[f32; 4]>) -> [[f32; 4]; 4] {
    let row = |v: DVec3, w: f64| [v.x as f32, v.y as f32, v.z as f32, w as f32];
    let map = match environment {
        Environment::Constant(radiance) => return [row(*radiance, 0.0), [0.0; 4], [0.0; 4], [0.0; 4]],
        Environment::Map(map) => map,
    };
    let first = rows.len() as f64;
    let (width, height) = (map.picture.width as usize, map.picture.height as usize);
    let cells = Cells::of(map);
    for (i, texel) in map.picture.texels.iter().enumerate() {
        let (x, y) = (i % width, i / width);
        let density = if y + 1 < height { cells.density(x, y) } else { 0.0 };
        rows.push(row(DVec3::from_array(texel.map(f64::from)) * map.scale, density));
    }
    for (y, (threshold, other)) in alias(&cells.rows).into_iter().enumerate() {
        rows.push([threshold, other as f64, edge(y, height), edge(y + 1, height)].map(|v| v as f32));
    }
    for weights in cells.weights.chunks(width) {
        let entries = alias(weights).into_iter();
        rows.extend(entries.map(|(threshold, other)| [threshold as f32, other as f32, 0.0, 0.0]));
    }
    let axes = [map.to_world.x_axis, map.to_world.y_axis, map.to_world.z_axis];
    [row(DVec3::ZERO, first), row(axes[0], width as f64), row(axes[1], height as f64), row(axes[2], share)]
}

/// The mean radiance over all directions.
pub(super) fn mean(map: &EnvironmentMap) -> DVec3 {
    let (width, height) = (map.picture.width as usize, map.picture.height as usize);
    let texel = |x: usize, y: usize| DVec3::from_array(map.picture.texels[y * width + x % width].map(f64::from));
    let cell = |x: usize, y: usize| {
        0.25 * (texel(x, y) + texel(x + 1, y) + texel(x, y + 1) + texel(x + 1, y + 1)) * solid_angle(y, width, height)
    };
    let sum: DVec3 = (0..height - 1).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| cell(x, y)).sum();
    sum * map.scale / (4.0 * PI)
}

/// The cosine of the upper edge of a row of cells.
fn edge(y: usize, height: usize) -> f64 {
    (PI * y as f64 / (height - 1) as f64).cos()
}

/// Of one cell.
fn solid_angle(y: usize, width: usize, height: usize) -> f64 {
    2.0 * PI / width as f64 * (edge(y, height) - edge(y + 1, height))
}

/// Cells between the centres of four texels, and how much light comes through each.
struct Cells {
    width: usize,
    height: usize,
    /// Light through each cell, row by row.
    weights: Vec<f64>,
    /// Through each row.
    rows: Vec<f64>,
    total: f64,
}

impl Cells {
    fn of(map: &EnvironmentMap) -> Self {
        let (width, height) = (map.picture.width as usize, map.picture.height as usize);
        let luminance =
            |x: usize, y: usize| map.picture.texels[y * width + x % width].iter().map(|&v| f64::from(v)).sum::<f64>();
        let mut weights = Vec::with_capacity(width * (height - 1));
        for y in 0..height - 1 {
            let angle = solid_angle(y, width, height);
            weights.extend((0..width).map(|x| {
                angle * (luminance(x, y) + luminance(x + 1, y) + luminance(x, y + 1) + luminance(x + 1, y + 1))
            }));
        }
        let rows: Vec<f64> = weights.chunks(width).map(|row| row.iter().sum()).collect();
        let total = rows.iter().sum();
        Self { width, height, weights, rows, total }
    }

    /// Probability density per solid angle in a cell.
    fn density(&self, x: usize, y: usize) -> f64 {
        if self.total > 0.0 {
            self.weights[y * self.width + x] / self.total / solid_angle(y, self.width, self.height)
        } else {
            1.0 / (4.0 * PI)
        }
    }
}

/// Walker's alias table (Vose 1991): a column keeps a draw below its threshold and hands the rest to its alias. Weights that are all 0
/// count alike.
fn alias(weights: &[f64]) -> Vec<(f64, usize)> {
    let mean = weights.iter().sum::<f64>() / weights.len() as f64;
    let mut table: Vec<(f64, usize)> = (0..weights.len()).map(|i| (1.0, i)).collect();
    if mean <= 0.0 {
        return table;
    }
    let mut scaled: Vec<f64> = weights.iter().map(|weight| weight / mean).collect();
    let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..weights.len()).partition(|&i| scaled[i] < 1.0);
    while let (Some(&below), Some(&above)) = (small.last(), large.last()) {
        small.pop();
        table[below] = (scaled[below], above);
        scaled[above] -= 1.0 - scaled[below];
        if scaled[above] < 1.0 {
            large.pop();
            small.push(above);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alias_tables_have_the_weights_as_probabilities() {
        let weights = [0.0, 3.0, 1.0, 0.5, 7.0, 0.0, 2.5];
        let mut shares = [0.0; 7];
        for (i, (threshold, other)) in alias(&weights).into_iter().enumerate() {
            assert!((0.0..=1.0).contains(&threshold), "{threshold}");
            shares[i] += threshold / 7.0;
            shares[other] += (1.0 - threshold) / 7.0;
        }
        for (share, weight) in shares.iter().zip(weights) {
            assert!((share - weight / 14.0).abs() < 1e-15, "{share} for {weight}");
        }
        assert_eq!(alias(&[0.0; 3]), [(1.0, 0), (1.0, 1), (1.0, 2)]);
    }
}
