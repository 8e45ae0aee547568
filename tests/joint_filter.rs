//! The filter that reconstructions are measured against does what it says.

#[path = "common/joint_filter.rs"]
mod joint_filter;

use joint_filter::{Picture, RADII};
use limpid::image::Image;
use limpid::net::tensor::{seed_of, uniform};

const WIDTH: usize = 40;
const HEIGHT: usize = 30;

/// Noisy radiance on a wall: albedo at random, depths rising to the right, normals toward the camera.
fn wall() -> Picture {
    let u = |name: &str, i: usize| uniform(seed_of(name), i as u64) as f32;
    let plane = |value: &dyn Fn(usize) -> f32| -> Vec<f32> { (0..WIDTH * HEIGHT).map(value).collect() };
    Picture {
        width: WIDTH,
        radiance: ["r", "g", "b"].map(|name| plane(&|i| 2.0 * u(name, i))),
        albedo: ["R", "G", "B"].map(|name| plane(&|i| 0.2 + 0.7 * u(name, i))),
        normal: [0.0, 0.0, 1.0].map(|v| plane(&|_| v)),
        depth: plane(&|i| 3.0 + 0.02 * (i % WIDTH) as f32),
        aa: false,
    }
}

fn lit(picture: &mut Picture, irradiance: [f32; 3]) {
    for (c, light) in irradiance.into_iter().enumerate() {
        picture.radiance[c] = picture.albedo[c].iter().map(|albedo| albedo * light).collect();
    }
}

/// Relative errors of a few roundings; sums of n equal terms add up to n more.
fn close(found: f32, expected: f32, roundings: usize) {
    let bound = roundings as f32 * f32::EPSILON * expected.abs();
    assert!((found - expected).abs() <= bound, "found {found}, expected {expected}, within {bound}");
}

#[test]
fn a_constant_stays_constant() {
    let mut picture = wall();
    lit(&mut picture, [0.5, 1.5, 4.0]);
    for radius in RADII {
        let found = picture.filtered(radius);
        for (found, expected) in found.iter().zip(&picture.radiance) {
            found.iter().zip(expected).for_each(|(a, r)| close(*a, *r, 2 * WIDTH * HEIGHT + 8));
        }
    }
}

#[test]
fn no_radius_is_no_filter() {
    let picture = wall();
    let found = picture.filtered(0);
    for (found, expected) in found.iter().zip(&picture.radiance) {
        found.iter().zip(expected).for_each(|(a, r)| close(*a, *r, 2));
    }
}

/// The plain mean of irradiance where neither normal nor depth tells pixels apart, cut off at the picture's ends.
#[test]
fn it_is_a_box_on_a_flat_wall() {
    let mut picture = wall();
    picture.depth = vec![2.0; WIDTH * HEIGHT];
    for radius in [1usize, 3, 7] {
        let found = picture.filtered(radius);
        for (x, y) in [(0usize, 0usize), (WIDTH - 1, 5), (20, 15), (3, HEIGHT - 1)] {
            let (mut sum, mut count) = (0.0, 0);
            for v in y.saturating_sub(radius)..=(y + radius).min(HEIGHT - 1) {
                for u in x.saturating_sub(radius)..=(x + radius).min(WIDTH - 1) {
                    let j = v * WIDTH + u;
                    sum += f64::from(picture.radiance[1][j]) / f64::from(picture.albedo[1][j]);
                    count += 1;
                }
            }
            let i = y * WIDTH + x;
            close(found[1][i], (sum / f64::from(count)) as f32 * picture.albedo[1][i], count as usize + 8);
        }
    }
    // A slope is no edge: noise is averaged along it.
    let spread = |plane: &[f32], albedo: &[f32]| {
        let values: Vec<f64> = plane.iter().zip(albedo).map(|(v, a)| f64::from(v / a)).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64
    };
    let mut sloped = wall();
    sloped.depth = (0..WIDTH * HEIGHT).map(|i| 3.0 + 0.3 * (i % WIDTH) as f32).collect();
    let (noisy, filtered) = (&sloped.radiance[0], &sloped.filtered(7)[0]);
    // At least 8x8 pixels at a corner, each with a weight of at least a half: 1/32 of the variance, and chance.
    assert!(spread(filtered, &sloped.albedo[0]) < spread(noisy, &sloped.albedo[0]) / 16.0);
}

/// Two halves, lit and dark, that differ in nothing else but what `edge` makes of the right one: no light crosses.
fn keeps_apart(edge: impl Fn(&mut Picture, usize)) -> bool {
    let mut picture = wall();
    lit(&mut picture, [1.0; 3]);
    let right = |i: usize| i % WIDTH >= 17;
    for i in (0..WIDTH * HEIGHT).filter(|i| right(*i)) {
        edge(&mut picture, i);
        (0..3).for_each(|c| picture.radiance[c][i] = 0.0);
    }
    let found = picture.filtered(10);
    let left: Vec<usize> = (0..WIDTH * HEIGHT).filter(|i| !right(*i)).collect();
    left.iter().for_each(|&i| assert!(found[0][i] <= picture.radiance[0][i] * 1.001));
    let dark = (0..WIDTH * HEIGHT).filter(|i| right(*i)).all(|i| (0..3).all(|c| found[c][i] == 0.0));
    // 21x21 pixels at most, three roundings each.
    dark && left.iter().all(|&i| (found[0][i] - picture.radiance[0][i]).abs() <= 1323.0 * f32::EPSILON)
}

#[test]
fn light_does_not_cross_edges() {
    assert!(keeps_apart(|picture, i| (0..3).for_each(|c| picture.normal[c][i] = [1.0, 0.0, 0.0][c])), "a normal's");
    assert!(keeps_apart(|picture, i| picture.depth[i] += 1.0), "a depth's");
    // A light beside the wall.
    assert!(keeps_apart(|picture, i| (0..3).for_each(|c| picture.albedo[c][i] = 0.0)), "a light's");
    assert!(!keeps_apart(|_, _| ()), "nothing keeps the halves apart, and no light crosses");
}

#[test]
fn exact_pixels_stay() {
    let mut picture = wall();
    for c in 0..3 {
        picture.albedo[c][500] = 0.0;
        picture.radiance[c][500] = 1e6;
    }
    let found = picture.filtered(7);
    for (c, plane) in found.iter().enumerate() {
        assert_eq!(plane[500], 1e6);
        // No share of it elsewhere: irradiance is 2 / 0.2 at most.
        assert!(plane.iter().enumerate().all(|(i, v)| i == 500 || *v <= 10.001 * picture.albedo[c][i]));
    }
    // The eight about it are partly light where samples have rays of their own; others are not.
    picture.aa = true;
    let near = |i: usize| (i % WIDTH).abs_diff(500 % WIDTH).max((i / WIDTH).abs_diff(500 / WIDTH)) <= 1;
    (0..WIDTH * HEIGHT).filter(|i| near(*i)).for_each(|i| picture.radiance[0][i] = 1e6);
    let found = &picture.filtered(7)[0];
    assert!((0..WIDTH * HEIGHT).all(|i| if near(i) { found[i] == 1e6 } else { found[i] <= 10.001 }));
}

#[test]
fn it_reads_what_limpid_writes() {
    let picture = wall();
    let mut image = Image::new(WIDTH as u32, HEIGHT as u32);
    image.set_rgb("", picture.radiance.clone());
    image.set_rgb("albedo", picture.albedo.clone());
    for (name, plane) in ["N.X", "N.Y", "N.Z"].into_iter().zip(&picture.normal) {
        image.channels.insert(name.into(), plane.clone());
    }
    assert!(Picture::of(&image).is_err_and(|error| error.to_string().contains("'Z'")));
    image.channels.insert("Z".into(), picture.depth.clone());
    assert_eq!(Picture::of(&image).unwrap().filtered(3), picture.filtered(3));
    assert!(!Picture::of(&image).unwrap().aa);
    image.attributes.insert("aa".into(), "true".into());
    assert!(Picture::of(&image).unwrap().aa);
    // The noisy radiance where there is one.
    image.move_rgb("", "noisy").unwrap();
    image.set_rgb("", [0, 1, 2].map(|_| vec![0.0; WIDTH * HEIGHT]));
    assert_eq!(Picture::of(&image).unwrap().filtered(3), picture.filtered(3));
}
