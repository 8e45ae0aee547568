//! Seam energy, references in two halves and defects, against values worked out by hand.

use limpid::image::Image;
use limpid::metrics::{self, Defects, compare, compare_halves, reference_noise, seam_energy};
use limpid::net::tensor::{seed_of, uniform};

fn close(found: f64, expected: f64) {
    // The inputs are f32: 2^-24, some times over.
    assert!((found - expected).abs() <= 1e-6 * expected.abs().max(1e-3), "found {found}, expected {expected}");
}

fn plane(width: u32, height: u32, value: impl Fn(u32, u32) -> f64) -> Vec<f32> {
    (0..width * height).map(|i| value(i % width, i / width) as f32).collect()
}

/// Seam energy of an error about a reference of 0.3.
fn energy((width, height): (u32, u32), chunk: u32, error: impl Fn(u32, u32) -> f64) -> f64 {
    let r = plane(width, height, |_, _| 0.3);
    let a = plane(width, height, |x, y| 0.3 + error(x, y));
    seam_energy([&a; 3], [&r; 3], width, chunk).unwrap()
}

#[test]
fn a_smooth_error_has_no_seams() {
    let slope = 1.0 / 1024.0;
    // Every difference is the slope; values up to 0.6 are rounded to f32, by 2^-25 at most, twice a difference.
    let bound = 4.0 * 2f64.powi(-25) / slope;
    for (size, chunk) in [((96, 64), 32), ((100, 70), 16), ((70, 40), 64), ((64, 3), 8)] {
        let found = energy(size, chunk, |x, y| slope * f64::from(x + y));
        assert!((found - 1.0).abs() <= bound, "{size:?}, {chunk}: {found}");
    }
    // A wave along x: a difference changes by at most k^2 from one to the next, and among N that follow one another, of which one
    // is at a border, by N k^2 from their mean; the mean of |cos| over whole halves of the wave is 2/pi.
    let (k, chunk) = (std::f64::consts::PI / 128.0, 32);
    let found = energy((1024, 1), chunk, |x, _| 0.1 * (k * f64::from(x)).sin());
    let bound = f64::from(chunk) * k / std::f64::consts::FRAC_2_PI;
    assert!((found - 1.0).abs() <= bound, "{found}, within {bound}");
}

#[test]
fn an_offset_of_one_chunk_is_a_seam() {
    let (slope, offset, chunk) = (1.0 / 1024.0, 1.0 / 64.0, 16);
    let error = |begin: u32, side: u32| {
        let inside = move |at: u32| at >= begin && at < begin + side;
        move |x, y| slope * f64::from(x + y) + if inside(x) && inside(y) { offset } else { 0.0 }
    };
    let found = energy((64, 64), chunk, error(16, 16));
    // Three borders of 64 pairs each way; the chunk has 16 pairs on each of four sides, whose mean is the offset.
    let (pairs, changed) = (6.0 * 64.0, 64.0);
    close(found, 1.0 + changed * (offset - slope) / (pairs * slope));
    // Off the grid it is no seam, but content elsewhere.
    let elsewhere = 2.0 * 64.0 * 63.0 - pairs;
    let found = energy((64, 64), chunk, error(20, 16));
    close(found, 1.0 / (1.0 + changed * (offset - slope) / (elsewhere * slope)));
    // Along x alone, and along y alone.
    assert!(energy((64, 9), 16, |x, y| slope * f64::from(x + y + x / 16)) > 1.5);
    assert!(energy((9, 64), 16, |x, y| slope * f64::from(x + y + y / 16)) > 1.5);
    // What the reference has too is content; what is clamped away does not show.
    let step = plane(64, 64, |x, _| f64::from(x / 16) * 0.2);
    let a: Vec<f32> = step.iter().enumerate().map(|(i, v)| v + 1e-3 * (i % 2) as f32).collect();
    let content = seam_energy([&a; 3], [&step; 3], 64, 16).unwrap();
    assert!((content - 1.0).abs() < 0.05, "{content}");
    let (a, r) = (plane(64, 64, |x, _| 2.0 + f64::from(x / 16)), plane(64, 64, |_, _| 3.0));
    assert!(seam_energy([&a; 3], [&r; 3], 64, 16).unwrap().is_nan());
}

#[test]
fn seams_need_chunks_that_meet() {
    let a = vec![0.5; 12];
    for (chunk, fits) in [(0, false), (1, false), (2, true), (3, true), (4, false), (u32::MAX, false)] {
        let found = seam_energy([&a; 3], [&a; 3], 4, chunk);
        assert_eq!(found.is_ok(), fits, "{chunk}");
        if let Err(error) = found {
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains("4x3") && error.to_string().contains("from 2 to 3"), "{error}");
        }
    }
    assert!(seam_energy([&[f32::NAN; 12]; 3], [&a; 3], 4, 2).unwrap_err().to_string().contains("the image"));
}

fn image(width: u32, planes: [&[f32]; 3]) -> Image {
    let mut image = Image::new(width, planes[0].len() as u32 / width);
    image.set_rgb("", planes.map(<[f32]>::to_vec));
    image
}

#[test]
fn two_references_by_hand() {
    let grey = |values: &[f32]| image(values.len() as u32, [values; 3]);
    let (a, first, second) = (grey(&[0.5, 2.0]), grey(&[0.3, 1.0]), grey(&[0.1, 3.0]));
    let found = compare_halves(&a, "", [&first, &second]).unwrap().all;
    // Means 0.2 and 2: the differences have one sign at the first pixel, two at the second.
    close(found.relmse, (0.2 * 0.4 / (0.04 + 0.01) - 1.0 / (4.0 + 0.01)) / 2.0);
    close(found.mae01, (0.3 + 0.0) / 2.0);
    let noise = reference_noise([&first, &second]).unwrap();
    close(noise.mae01, (0.2 / 2.0 + 0.0) / 2.0);
    close(noise.relmse, (0.04 / 4.0 / 0.05 + 4.0 / 4.0 / 4.01) / 2.0);
    // The channels count alike.
    let colours = |r: f32| image(1, [&[r], &[0.25], &[0.5]]);
    let found = compare_halves(&colours(2.0), "", [&colours(0.0), &colours(1.0)]).unwrap().all;
    close(found.relmse, 2.0 / (0.25 + 0.01) / 3.0);
}

/// Noise of the references adds to relMSE against either and against their mean, and nothing to the product.
#[test]
fn noise_of_the_references_does_not_count() {
    let count = 40_000;
    let noise = |seed: u64, amount: f64| -> Vec<f32> {
        (0..count).map(|i| (0.5 + amount * (2.0 * uniform(seed, i) - 1.0)) as f32).collect()
    };
    let [a, first, second] = ["image", "first", "second"].map(|name| noise(seed_of(name), 0.05));
    let [a, first, second] = [a, first, second].map(|v| image(200, [&v[..]; 3]));
    let truth = image(200, [&vec![0.5; count as usize][..]; 3]);
    let exact = compare(&a, &truth).unwrap().all.relmse;
    let product = compare_halves(&a, "", [&first, &second]).unwrap().all.relmse;
    let rgb = |image: &Image| -> [Vec<f32>; 3] { image.rgb("").unwrap().map(<[f32]>::to_vec) };
    let planes = [rgb(&a), rgb(&first), rgb(&second)];
    let [x, r1, r2] = planes.each_ref().map(|p| [&p[0][..], &p[1][..], &p[2][..]]);
    assert_eq!(metrics::relmse(x, [r1, r2]), product);
    let against_mean = compare(&a, &metrics::mean_reference([&first, &second]).unwrap()).unwrap().all.relmse;
    // Uniform in +-0.05: errors of the image and of both references have this variance s2, and (e - n1) (e - n2) - e^2 three
    // products of two of them. The denominators' noise, of variance s2 / 2, changes them by 11 times that, and by its square.
    let s2 = 0.05 * 0.05 / 3.0;
    let bound = 5.0 * 3f64.sqrt() * s2 / 0.26 / (count as f64).sqrt() + 0.01 * exact;
    assert!((product - exact).abs() <= bound, "{product} against {exact}, within {bound}");
    assert!(against_mean - exact > 5.0 * bound, "{against_mean} against {exact}");
    let noise = reference_noise([&first, &second]).unwrap().relmse;
    assert!((against_mean - exact - noise).abs() <= 2.0 * bound, "{against_mean} = {exact} + {noise}");
}

#[test]
fn bad_references_are_named() {
    let good = image(2, [&[0.5; 2]; 3]);
    let broken = image(2, [&[0.5, f32::NAN], &[0.5; 2], &[0.5; 2]]);
    let message = |a: &Image, halves: [&Image; 2]| {
        let error = compare_halves(a, "", halves).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    assert!(message(&broken, [&good, &good]).contains("the image"));
    assert!(message(&good, [&broken, &good]).contains("the reference"));
    assert!(message(&good, [&good, &broken]).contains("second reference"));
    let found = message(&good, [&good, &image(1, [&[0.5; 2]; 3])]);
    assert!(found.contains("1x2") && found.contains("2x1"), "{found}");
    assert!(reference_noise([&good, &broken]).is_err());
}

#[test]
fn defects_are_counted() {
    let size = 9;
    // Dark, a bright edge from column 6 on, one bright pixel of the reference's own.
    let mut r = plane(size, size, |x, _| if x >= 6 { 1.0 } else { 0.05 });
    r[40] = 5.0;
    let at = |x: usize, y: usize| y * size as usize + x;
    let found = |changes: &[(usize, [f32; 3])], r: &[f32]| {
        let mut a = [r.to_vec(), r.to_vec(), r.to_vec()];
        for (i, value) in changes {
            (0..3).for_each(|c| a[c][*i] = value[c]);
        }
        metrics::defects([&a[0], &a[1], &a[2]], [r; 3], size, size).unwrap()
    };
    let none = Defects { fireflies: 0, black: 0, non_finite: 0 };
    assert_eq!(found(&[], &r), none);
    // Ten times 0.05 is 0.5: more is a firefly, but beside the bright edge, and where the reference has it.
    assert_eq!(found(&[(at(1, 1), [0.45; 3])], &r), none);
    assert_eq!(found(&[(at(1, 1), [0.55; 3])], &r), Defects { fireflies: 1, ..none });
    assert_eq!(found(&[(at(5, 1), [0.55; 3])], &r), none);
    assert_eq!(found(&[(40, [20.0; 3])], &r), none);
    // The reference's bright pixel is gone from the medians about it.
    assert_eq!(found(&[(at(3, 4), [0.55; 3])], &r), Defects { fireflies: 1, ..none });
    // Black: all channels, and where the reference is not.
    assert_eq!(found(&[(0, [1e-4; 3]), (1, [-1.0; 3]), (2, [0.0, 0.0, 2e-4])], &r), Defects { black: 2, ..none });
    assert_eq!(found(&[(0, [0.0; 3])], &vec![0.009; 81]), none);
    // Under 0.01 counts as 0.01.
    assert_eq!(found(&[(0, [0.09; 3]), (80, [0.11; 3])], &vec![0.0; 81]), Defects { fireflies: 1, ..none });
    let broken = [(0, [f32::NAN, 1.0, 1.0]), (1, [f32::INFINITY; 3]), (2, [1.0, 1.0, f32::NEG_INFINITY])];
    assert_eq!(found(&broken, &r), Defects { non_finite: 3, ..none });
    assert!(metrics::defects([&r; 3], [&vec![f32::NAN; 81]; 3], size, size).is_err());
}
