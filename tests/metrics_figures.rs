//! The figures of `limpid compare` against values worked out by hand or from their definition.

use limpid::image::{Image, png::srgb_encode};
use limpid::metrics::{self, Comparison, Figures};

fn evaluate(a: [&[f32]; 3], r: [&[f32]; 3], width: u32) -> Comparison {
    metrics::evaluate(a, r, width, a[0].len() as u32 / width, None).unwrap()
}

fn grey(a: &[f32], r: &[f32], width: u32) -> Figures {
    evaluate([a; 3], [r; 3], width).all
}

fn close(found: f64, expected: f64) {
    // The inputs are f32 (and their display values rounded to f32): 2^-24, some times over.
    assert!((found - expected).abs() <= 1e-6 * expected.abs().max(1e-3), "found {found}, expected {expected}");
}

/// Numbers in [0, 1) without a pattern.
fn noise(count: usize, seed: u32) -> Vec<f32> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    (0..count).map(|_| next()).collect()
}

#[test]
fn hand_computed() {
    // One pixel: the three channels differ.
    let found = evaluate([&[2.0], &[0.5], &[-1.0]], [&[0.25], &[0.5], &[0.5]], 1).all;
    close(found.mae01, (0.75 + 0.0 + 0.5) / 3.0);
    // 1.75^2 / (0.0625 + 0.01), 0, 1.5^2 / (0.25 + 0.01)
    close(found.relmse, (3.0625 / 0.0725 + 2.25 / 0.26) / 3.0);
    assert_eq!(found.pixels, 1);
    // sRGB is 12.92 x at the dark end: the difference is 0.01292 everywhere.
    let found = grey(&[0.001; 6], &[0.002; 6], 3);
    close(found.psnr, -20.0 * 0.01292f64.log10());
    close(found.mae01, 0.001);
    // Flat images: the variances are 0, and 0.01292 and 0.02584 the means.
    let (ma, mr) = (0.01292f64, 0.02584);
    close(found.ssim, (2.0 * ma * mr + 1e-4) / (ma * ma + mr * mr + 1e-4));
    close(grey(&[0.0; 4], &[1.0; 4], 2).psnr + 1.0, 1.0);
}

#[test]
fn equal_images() {
    let a = noise(30 * 20, 1);
    let found = grey(&a, &a, 30);
    assert_eq!((found.mae01, found.relmse, found.flip), (0.0, 0.0, 0.0));
    assert_eq!(found.psnr, f64::INFINITY);
    assert!((found.ssim - 1.0).abs() < 1e-12);
    let json = serde_json::to_value(evaluate([&a; 3], [&a; 3], 30)).unwrap();
    assert!(json["all"]["psnr"].is_null() && json["surface"].is_null());
    assert_eq!((json["all"]["mae01"].as_f64(), json["all"]["pixels"].as_u64()), (Some(0.0), Some(600)));
}

/// SSIM from its definition: a two-dimensional window, covariances about the means.
fn ssim_by_definition(a: &[f64], r: &[f64], width: i64, height: i64) -> f64 {
    let mut sum = 0.0;
    for y in 0..height {
        for x in 0..width {
            let mut taps = Vec::new();
            for v in (y - 5).max(0)..=(y + 5).min(height - 1) {
                for u in (x - 5).max(0)..=(x + 5).min(width - 1) {
                    let distance = ((u - x).pow(2) + (v - y).pow(2)) as f64;
                    let i = (v * width + u) as usize;
                    taps.push(((-distance / (2.0 * 2.25)).exp(), a[i], r[i]));
                }
            }
            let total: f64 = taps.iter().map(|t| t.0).sum();
            let mean = |f: &dyn Fn(f64, f64) -> f64| taps.iter().map(|t| t.0 * f(t.1, t.2)).sum::<f64>() / total;
            let (ma, mr) = (mean(&|a, _| a), mean(&|_, r| r));
            let (va, vr) = (mean(&|a, _| (a - ma).powi(2)), mean(&|_, r| (r - mr).powi(2)));
            let covariance = mean(&|a, r| (a - ma) * (r - mr));
            sum += (2.0 * ma * mr + 1e-4) * (2.0 * covariance + 9e-4) / ((ma * ma + mr * mr + 1e-4) * (va + vr + 9e-4));
        }
    }
    sum / (width * height) as f64
}

#[test]
fn ssim_is_its_definition_at_every_size() {
    for (width, height) in [(1, 1), (3, 2), (1, 9), (11, 11), (24, 13)] {
        let count = width * height;
        let planes: Vec<Vec<f32>> = (0..6).map(|seed| noise(count, seed)).collect();
        let [a, r] = [0, 3].map(|first| [&planes[first][..], &planes[first + 1], &planes[first + 2]]);
        let luma = |p: [&[f32]; 3]| -> Vec<f64> {
            let s = |c: usize, i: usize| f64::from(srgb_encode(p[c][i]));
            (0..count).map(|i| 0.2126 * s(0, i) + 0.7152 * s(1, i) + 0.0722 * s(2, i)).collect()
        };
        let expected = ssim_by_definition(&luma(a), &luma(r), width as i64, height as i64);
        let found = evaluate(a, r, width as u32).all.ssim;
        // Both in f64; the variances cancel to about 1e-16 of values up to 1, over C2 = 9e-4.
        assert!((found - expected).abs() < 1e-11, "{width}x{height}: {found} {expected}");
    }
}

#[test]
fn figures_grow_with_the_error() {
    let r: Vec<f32> = noise(64 * 64, 9).iter().map(|v| 0.2 + 0.5 * v).collect();
    let worse = |amount: f32| {
        let a: Vec<f32> = r.iter().zip(noise(64 * 64, 5)).map(|(r, n)| r + amount * (n - 0.5)).collect();
        grey(&a, &r, 64)
    };
    let (small, large) = (worse(0.02), worse(0.2));
    assert!(0.0 < small.mae01 && small.mae01 < large.mae01 && small.relmse < large.relmse);
    assert!(small.psnr > large.psnr && 1.0 > small.ssim && small.ssim > large.ssim);
    assert!(0.0 < small.flip && small.flip < large.flip && large.flip < 1.0);
    // Black against white is as far apart as FLIP goes.
    let far = grey(&[0.0; 400], &[1.0; 400], 20).flip;
    assert!(far > 0.9 && far <= 1.0, "{far}");
}

fn image(width: u32, height: u32, value: f32) -> Image {
    let mut image = Image::new(width, height);
    let plane = vec![value; image.pixel_count()];
    image.set_rgb("", [plane.clone(), plane.clone(), plane]);
    image
}

#[test]
fn surface_pixels_are_those_with_depth_and_albedo() {
    let (mut a, mut r) = (image(4, 1, 0.5), image(4, 1, 0.5));
    // A surface, a light, nothing, a surface of one colour.
    r.channels.insert("Z".into(), vec![1.0, 1.0, 0.0, 2.0]);
    let dark = || vec![0.3, 0.0, 0.0, 0.0];
    r.set_rgb("albedo", [dark(), dark(), vec![0.3, 0.0, 0.0, 0.1]]);
    a.channels.insert("R".into(), vec![0.6, 0.9, 0.9, 0.5]);
    let found = metrics::compare(&a, &r).unwrap();
    close(found.all.mae01, (0.1 + 0.4 + 0.4) / 12.0);
    let surface = found.surface.unwrap();
    assert_eq!((found.all.pixels, surface.pixels), (4, 2));
    close(surface.mae01, 0.1 / 6.0);
    close(surface.relmse, 0.01 / 0.26 / 6.0);
    assert!(surface.flip < found.all.flip);

    // The image's own channels serve where the reference has none; a reference without surfaces has no such figures.
    let mut with = a.clone();
    with.channels.extend(r.channels.iter().filter(|(name, _)| name.len() > 1).map(|(k, v)| (k.clone(), v.clone())));
    with.channels.insert("Z".into(), r.channels["Z"].clone());
    let plain = image(4, 1, 0.5);
    assert_eq!(metrics::compare(&with, &plain).unwrap().surface.unwrap().pixels, 2);
    assert_eq!(metrics::compare(&a, &plain).unwrap().surface, None);
    r.channels.insert("Z".into(), vec![0.0; 4]);
    assert_eq!(metrics::compare(&a, &r).unwrap().surface, None);

    a.set_rgb("noisy", [vec![1.0; 4], vec![1.0; 4], vec![1.0; 4]]);
    close(metrics::compare_channels(&a, "noisy", &plain, "").unwrap().all.mae01, 0.5);
}

#[test]
fn bad_input_is_named() {
    let (a, r) = (image(4, 3, 0.5), image(4, 3, 0.5));
    let message = |a: &Image, r: &Image| {
        let error = metrics::compare(a, r).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    for bad in [f32::NAN, f32::INFINITY] {
        let mut broken = a.clone();
        broken.channels.get_mut("G").unwrap()[6] = bad;
        let found = message(&broken, &r);
        assert!(found.contains("the image") && found.contains("(2, 1)") && found.contains("green"), "{found}");
        assert!(message(&r, &broken).contains("the reference"));
    }
    let found = message(&a, &image(3, 4, 0.5));
    assert!(found.contains("4x3") && found.contains("3x4"), "{found}");
    let mut missing = a.clone();
    missing.channels.remove("B");
    assert!(message(&missing, &r).contains("'B'"));
    assert!(metrics::evaluate([&[]; 3], [&[]; 3], 0, 0, None).is_err());
    assert!(metrics::evaluate([&[1.0]; 3], [&[1.0]; 3], 1, 1, Some(&[])).is_err());
    assert!(metrics::evaluate([&[1.0]; 3], [&[1.0, 2.0]; 3], 1, 1, None).is_err());
}
