//! Chunks, checkpoints, limits of the device, first-hit values: what must not change a bit, and what must be exact.

mod render_support;

use glam::{DMat4, DVec3};
use limpid::Error;
use limpid::image::Image;
use limpid::render::{Estimator, Renderer, Sampler, Settings, loop_limit};
use limpid::scene::{Geometry, Scene};
use render_support::*;

fn small(sampler: Sampler, aa: bool) -> Settings {
    Settings { spp: 160, sampler, aa, variance: true, ..Settings::default() }
}

#[test]
fn chunk_size_changes_no_bit() {
    let gpu = device();
    for (estimator, sampler) in [(Estimator::Nee, Sampler::Sobol), (Estimator::Cosine, Sampler::Pcg)] {
        for aa in [false, true] {
            let settings = Settings { estimator, ..small(sampler, aa) };
            let whole = render(&gpu, &cornell(40), &settings);
            for chunk in [1, 7, 33] {
                let mut renderer = Renderer::new(&gpu, &cornell(40), &settings).expect("renderer");
                renderer.limit_chunk(chunk);
                renderer.finish().expect("render");
                assert_same_bits(&whole, &renderer.image().expect("image"), &format!("chunk {chunk} aa {aa}"));
            }
        }
    }
}

#[test]
fn two_runs_are_the_same_and_seeds_differ() {
    let gpu = device();
    let settings = Settings::default();
    let mut renderer = Renderer::new(&gpu, &cornell(48), &settings).expect("renderer");
    renderer.finish().expect("render");
    let first = renderer.image().expect("image");
    renderer.set_seed(1);
    renderer.finish().expect("render");
    let other = renderer.image().expect("image");
    renderer.set_seed(0);
    renderer.finish().expect("render");
    assert_same_bits(&first, &renderer.image().expect("image"), "restart");
    let changed = first.channels["R"].iter().zip(&other.channels["R"]).filter(|(a, b)| a != b).count();
    assert!(changed > first.channels["R"].len() / 2);
}

#[test]
fn scenes_share_a_renderer() {
    let gpu = device();
    let member = |n| {
        let mut scene = limpid::scene::family::spheres(n);
        (scene.camera.width, scene.camera.height) = (64, 64);
        scene
    };
    let mut renderer = Renderer::new(&gpu, &member(1), &Settings::default()).expect("renderer");
    renderer.finish().expect("render");
    for n in [2, 3] {
        renderer.set_scene(&member(n)).expect("family scenes have the same features");
        renderer.finish().expect("render");
        let shared = renderer.image().expect("image");
        assert_same_bits(&shared, &render(&gpu, &member(n), &Settings::default()), "own renderer");
    }
    let error = renderer.set_scene(&cornell(32)).expect_err("another size");
    assert!(matches!(error, Error::Input(_)), "{error}");
}

#[test]
fn resumed_is_uninterrupted() {
    let gpu = device();
    let directory = tempfile::tempdir().expect("directory");
    let path = directory.path().join("render.ckpt");
    for (sampler, aa) in [(Sampler::Pcg, false), (Sampler::Sobol, true)] {
        let settings = small(sampler, aa);
        let whole = render(&gpu, &cornell(40), &settings);
        let mut first = Renderer::new(&gpu, &cornell(40), &settings).expect("renderer");
        first.limit_chunk(9);
        for _ in 0..5 {
            first.advance().expect("advance");
        }
        first.checkpoint(&path).expect("checkpoint");
        let partial = first.image().expect("image");
        drop(first);
        let mut second = Renderer::new(&gpu, &cornell(40), &settings).expect("renderer");
        second.restore(&path).expect("restore");
        assert_same_bits(&partial, &second.image().expect("image"), "right after the restore");
        second.finish().expect("render");
        assert_same_bits(&whole, &second.image().expect("image"), "resumed");
    }
}

#[test]
fn foreign_or_damaged_checkpoints_are_refused() {
    let gpu = device();
    let settings = Settings { spp: 4, ..Settings::default() };
    let mut renderer = Renderer::new(&gpu, &cornell(16), &settings).expect("renderer");
    renderer.advance().expect("advance");
    let bytes = renderer.checkpoint_bytes().expect("bytes");
    renderer.restore_bytes(&bytes).expect("its own");
    let mut flipped = bytes.clone();
    flipped[200] ^= 1;
    for (bad, what) in
        [(&bytes[..10], "short"), (&bytes[..bytes.len() - 1], "cut"), (&flipped[..], "flipped"), (&[][..], "empty")]
    {
        assert!(matches!(renderer.restore_bytes(bad), Err(Error::Input(_))), "{what}");
    }
    renderer.set_seed(9);
    assert!(matches!(renderer.restore_bytes(&bytes), Err(Error::Input(_))), "another seed");
}

/// T33: lavapipe silently ends all loops of a shader run after 65,535 iterations in sum.
#[test]
fn loop_limit_is_known() {
    let gpu = device();
    let limit = loop_limit(&gpu).expect("probe");
    println!("{}: {limit} iterations", gpu.info().name);
    assert!((1000..=100_000).contains(&limit));
    if gpu.info().name.contains("llvmpipe") {
        assert!(limit <= 65_535, "the budget of this driver was {limit}: has it been lifted?");
    }
}

/// T29 and the loop limit: 16,384 samples of a furnace, where every sample has the same value.
#[test]
fn many_samples_stay_exact() {
    let gpu = device();
    let shapes = vec![cavity(1.0, 0.5, 1.0), sphere([0.3, 0.1, 0.0], 0.25, 0.5, 1.0)];
    let scene = Scene { camera: look(DVec3::new(-0.5, 0.0, 0.2), DVec3::X, 80.0, 16, 16), shapes };
    let settings = Settings { spp: 16_384, estimator: Estimator::Cosine, ..Settings::default() };
    let expected = (1.0 - 0.5f64.powi(9)) / 0.5;
    for &v in &render(&gpu, &scene, &settings).channels["R"] {
        assert!((f64::from(v) / expected - 1.0).abs() <= 1e-6, "{v}, expected {expected}");
    }
    // And a frame with light and shadow against Mitsuba's mean; 0.15 % as everywhere.
    let settings = Settings { spp: 16_384, aa: true, ..Settings::default() };
    let image = render(&gpu, &cornell(16), &settings);
    let mean = image.channels["G"].iter().map(|&v| f64::from(v)).sum::<f64>() / 256.0;
    assert!((mean / 0.39049 - 1.0).abs() < 0.0015, "{mean}");
}

fn scaled(scene: &Scene, factor: f64) -> Scene {
    let mut scene = scene.clone();
    let m = &mut scene.camera.to_world;
    *m = DMat4::from_cols(m.x_axis, m.y_axis, m.z_axis, (m.w_axis.truncate() * factor).extend(1.0));
    for shape in &mut scene.shapes {
        match &mut shape.geometry {
            Geometry::Sphere { center, radius, .. } => {
                *center *= factor;
                *radius *= factor;
            }
            Geometry::Rectangle { center, half_u, half_v } => {
                *center *= factor;
                *half_u *= factor;
                *half_v *= factor;
            }
            other => unreachable!("{other:?}"),
        }
    }
    scene
}

fn map_channels(image: &Image, names: &[&str], f: impl Fn(f32) -> f32) -> Image {
    let mut image = image.clone();
    for name in names {
        image.channels.get_mut(*name).expect("channel").iter_mut().for_each(|v| *v = f(*v));
    }
    image
}

/// T9, T10, T12: what must change nothing, or only by a power of two.
#[test]
fn symmetries_are_exact() {
    let gpu = device();
    let scene = cornell(48);
    let base = render(&gpu, &scene, &Settings::default());

    let mut brighter = scene.clone();
    brighter.shapes.iter_mut().for_each(|s| s.radiance *= 8.0);
    let expected = map_channels(&base, &["R", "G", "B"], |v| v * 8.0);
    assert_same_bits(&expected, &render(&gpu, &brighter, &Settings::default()), "radiance x 8");

    let larger = render(&gpu, &scaled(&scene, 1024.0), &Settings::default());
    assert_same_bits(&map_channels(&base, &["Z"], |v| v * 1024.0), &larger, "scene x 1024");

    let mut turned = scene.clone();
    for shape in &mut turned.shapes {
        shape.albedo = DVec3::new(shape.albedo.y, shape.albedo.z, shape.albedo.x);
    }
    let image = render(&gpu, &turned, &Settings::default());
    for (from, to) in [("G", "R"), ("B", "G"), ("R", "B")] {
        assert_eq!(base.channels[from], image.channels[to], "{from} became {to}");
    }

    // Not square: on the diagonals of a square frame the edges between walls are ties.
    let mut ordered = scene;
    ordered.camera.height = 37;
    let base = render(&gpu, &ordered, &Settings::default());
    let mut reversed = ordered;
    reversed.shapes.reverse();
    assert_same_bits(&base, &render(&gpu, &reversed, &Settings::default()), "order of the shapes");
}

/// T28: first hits against f64.
#[test]
fn first_hits_are_exact() {
    let gpu = device();
    let mut scene = limpid::scene::family::spheres(5);
    (scene.camera.width, scene.camera.height) = (61, 43);
    let image = render(&gpu, &scene, &Settings { spp: 1, ..Settings::default() });
    let axes = scene.camera.to_world;
    let mut hits = 0;
    for y in 0..43 {
        for x in 0..61 {
            let ray = scene.camera.pixel_ray(x, y);
            let (i, plane) =
                ((y * 61 + x) as usize, |name: &str| f64::from(image.channels[name][(y * 61 + x) as usize]));
            let Some((t, normal, shape, clearance)) = first_hit(&scene, ray.origin, ray.direction) else {
                assert!(image.channels["Z"][i] == 0.0 && plane("R") == 0.0, "a miss at {x},{y}");
                continue;
            };
            if clearance < 1e-4 {
                continue; // so close to an edge that roundings decide
            }
            hits += 1;
            // The error of a hit grows with 1/cos of its angle.
            let slope = 1e-6 / normal.dot(ray.direction).abs().max(1e-3);
            assert!((plane("Z") - t).abs() <= 4.0 * slope * t, "depth {} and {t} at {x},{y}", plane("Z"));
            let n = DVec3::new(plane("N.X"), plane("N.Y"), plane("N.Z"));
            assert!((n - normal).length() <= 20.0 * slope, "normal {n} and {normal} at {x},{y}");
            let screen = (n.dot(axes.x_axis.truncate()), n.dot(axes.y_axis.truncate()));
            assert!((plane("Nscreen.X") - screen.0).abs() < 1e-6 && (plane("Nscreen.Y") - screen.1).abs() < 1e-6);
            for (k, name) in ["albedo.R", "albedo.G", "albedo.B"].into_iter().enumerate() {
                assert_eq!(image.channels[name][i], scene.shapes[shape].albedo[k] as f32);
            }
        }
    }
    assert!(hits > 2000, "{hits}");
}

/// Distance, normal, shape, and how far (relative) the ray passes from any silhouette.
fn first_hit(scene: &Scene, o: DVec3, d: DVec3) -> Option<(f64, DVec3, usize, f64)> {
    let mut best: Option<(f64, DVec3, usize)> = None;
    let mut clearance = f64::INFINITY;
    for (i, shape) in scene.shapes.iter().enumerate() {
        let hit = match shape.geometry {
            Geometry::Sphere { center, radius, .. } => {
                let f = o - center;
                let b = -f.dot(d);
                let nearest = (f + b * d).length();
                clearance = clearance.min((nearest - radius).abs());
                (nearest < radius).then(|| {
                    let t = b - (radius * radius - nearest * nearest).sqrt();
                    (t, (o + t * d - center) / radius)
                })
            }
            Geometry::Rectangle { center, half_u, half_v } => {
                let normal = half_u.cross(half_v).normalize();
                let t = (center - o).dot(normal) / d.dot(normal);
                let q = o + t * d - center;
                let edge =
                    (q.dot(half_u).abs() / half_u.length_squared()).max(q.dot(half_v).abs() / half_v.length_squared());
                clearance = clearance.min((edge - 1.0).abs());
                (t > 0.0 && edge < 1.0).then_some((t, normal))
            }
            ref other => unreachable!("{other:?}"),
        };
        if let Some((t, n)) = hit.filter(|(t, _)| *t > 0.0 && best.is_none_or(|(b, ..)| *t < b)) {
            best = Some((t, n, i));
        }
    }
    best.map(|(t, n, i)| (t, n, i, clearance))
}

#[test]
fn odd_sizes_work_and_match() {
    let gpu = device();
    for (width, height) in [(1, 1), (1, 37), (37, 1), (33, 65)] {
        let mut scene = cornell(1);
        (scene.camera.width, scene.camera.height) = (width, height);
        let image = render(&gpu, &scene, &Settings { spp: 2, ..Settings::default() });
        assert_eq!(image.channels["R"].len(), (width * height) as usize);
    }
}

#[test]
fn bad_settings_are_refused() {
    let gpu = device();
    let refused = |scene: &Scene, settings: Settings| match Renderer::new(&gpu, scene, &settings) {
        Err(Error::Input(text)) => text,
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("accepted"),
    };
    refused(&cornell(8), Settings { spp: 0, ..Settings::default() });
    refused(&cornell(8), Settings { bounces: 1 << 20, ..Settings::default() });
    let mut scene = cornell(8);
    scene.shapes[0].albedo.x = 1.5;
    refused(&scene, Settings::default());
    scene.shapes[0].albedo.x = f64::NAN;
    refused(&scene, Settings::default());
}

/// T24 in part: scenes at the edge of what makes sense render, finite, without a message from the validation layer.
#[test]
fn strange_scenes_render() {
    let gpu = device();
    let camera = look(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, 40.0, 24, 24);
    let many: Vec<_> = (0..40)
        .map(|i| {
            sphere([f64::from(i % 8) * 0.3 - 1.0, f64::from(i / 8) * 0.3 - 0.7, 0.0], 0.12, 0.5, f64::from(i % 7 == 0))
        })
        .collect();
    let floor = || rectangle(DVec3::NEG_Y, DVec3::Z * 2.0, DVec3::X * 2.0, 0.5, 0.0);
    let scenes = [
        ("empty", vec![]),
        ("only a light", vec![sphere([0.0; 3], 0.5, 0.0, 1.0)]),
        ("camera in a light", vec![sphere([0.0, 0.0, 3.0], 1.0, 0.5, 1.0), floor()]),
        ("camera on a sphere", vec![sphere([0.0, 0.0, 2.0], 1.0, 0.5, 1.0), floor()]),
        ("coincident", vec![sphere([0.0; 3], 0.5, 0.5, 1.0), sphere([0.0; 3], 0.5, 0.5, 0.0), floor()]),
        ("light touches floor", vec![sphere([0.0, -0.5, 0.0], 0.5, 0.0, 1.0), floor()]),
        ("light through floor", vec![sphere([0.0, -1.0, 0.0], 0.5, 0.0, 1.0), floor()]),
        ("more than fit into registers", many.into_iter().chain([floor()]).collect()),
        ("white", vec![sphere([0.0; 3], 0.5, 1.0, 1.0), floor()]),
    ];
    for (name, shapes) in scenes {
        let scene = Scene { camera: camera.clone(), shapes };
        for estimator in [Estimator::Uniform, Estimator::Cosine, Estimator::Nee] {
            for aa in [false, true] {
                let image = render(&gpu, &scene, &Settings { spp: 4, estimator, aa, ..Settings::default() });
                assert!(image.channels["R"].iter().all(|&v| v >= 0.0), "{name}");
            }
        }
    }
}

/// The loop over many primitives and the unrolled tests give one answer: 17 spheres against 16, one of them hidden away.
#[test]
fn loops_and_registers_agree() {
    let gpu = device();
    let scene = |count: usize| {
        let mut shapes: Vec<_> = (0..count)
            .map(|i| {
                sphere(
                    [(i as f64 * 0.37).sin(), (i as f64 * 0.73).cos() * 0.8, (i as f64).sin() * 0.5],
                    0.1,
                    0.6,
                    f64::from(i < 2) * 3.0,
                )
            })
            .collect();
        shapes.push(rectangle(DVec3::NEG_Y, DVec3::Z * 2.0, DVec3::X * 2.0, 0.5, 0.0));
        if count == 17 {
            shapes[16] = shapes[15].clone();
        }
        Scene { camera: look(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, 40.0, 64, 64), shapes }
    };
    let a = render(&gpu, &scene(16), &Settings { spp: 64, ..Settings::default() });
    let b = render(&gpu, &scene(17), &Settings { spp: 64, ..Settings::default() });
    for i in 0..a.channels["R"].len() {
        assert_eq!(a.channels["Z"][i], b.channels["Z"][i]);
    }
    let mean = |image: &Image| surface(image, "R").iter().sum::<f64>();
    assert!((mean(&a) / mean(&b) - 1.0).abs() < 1e-3, "{} {}", mean(&a), mean(&b));
}

/// Variance of the mean: over pairs of seeds, (x1 - x2)^2 / (v1 + v2) has mean 1 (T31), within what 7 batches allow.
#[test]
fn variance_is_that_of_the_mean() {
    let gpu = device();
    let settings = Settings { spp: 256, variance: true, sampler: Sampler::Pcg, ..Settings::default() };
    let a = render(&gpu, &cornell(64), &settings);
    let b = render(&gpu, &cornell(64), &Settings { seed: 1, ..settings.clone() });
    let (mut squares, mut variances) = (0.0, 0.0);
    for i in 0..a.channels["R"].len() {
        let value = |image: &Image, name: &str| f64::from(image.channels[name][i]);
        squares += (value(&a, "R") - value(&b, "R")).powi(2);
        variances += value(&a, "variance.R") + value(&b, "variance.R");
    }
    // 4,000 pixels: the ratio of the sums has a relative error of about sqrt(2/4000) = 2 %, more for unequal variances.
    assert!((squares / variances - 1.0).abs() < 0.15, "{}", squares / variances);
    let few = render(&gpu, &cornell(16), &Settings { spp: 7, ..settings.clone() });
    assert!(!few.channels.contains_key("variance.R"), "absent under 8 samples");
    let sobol = render(&gpu, &cornell(16), &Settings { sampler: Sampler::Sobol, ..settings });
    assert!(!sobol.channels.contains_key("variance.R"), "absent for sobol");
}

/// Exact pixels: the light and the empty space around the box take one ray and hold their radiance.
#[test]
fn exact_pixels_cost_one_ray() {
    let gpu = device();
    let mut renderer =
        Renderer::new(&gpu, &cornell(64), &Settings { spp: 128, ..Settings::default() }).expect("renderer");
    renderer.limit_chunk(8);
    renderer.finish().expect("render");
    let outputs = renderer.outputs().expect("outputs");
    let radiance: Vec<[f32; 4]> = gpu.download(&outputs.radiance).expect("download");
    let albedo: Vec<[f32; 4]> = gpu.download(&outputs.albedo).expect("download");
    let mut rough = 0;
    for (r, a) in radiance.iter().zip(&albedo) {
        assert_eq!(r[3] == 1.0, a[0] == 0.0);
        assert!(r[3] == 0.0 || r[..3] == [0.0; 3] || r[..3] == [12.0; 3]);
        rough += u64::from(r[3] == 0.0);
    }
    let stats = renderer.stats().expect("stats");
    assert_eq!(stats.samples, rough * 128);
    assert!(rough > 3000 && rough < 4096 - 50);
}

/// A dark room of nothing but exact pixels: rays = pixels.
#[test]
fn rays_are_counted() {
    let gpu = device();
    let camera = look(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, 40.0, 40, 24);
    let light = Scene { camera: camera.clone(), shapes: vec![sphere([0.0; 3], 0.5, 0.0, 1.0)] };
    let rays = |scene: &Scene, settings: Settings| {
        let mut renderer = Renderer::new(&gpu, scene, &settings).expect("renderer");
        renderer.finish().expect("render");
        renderer.stats().expect("stats").rays
    };
    assert_eq!(rays(&light, Settings { spp: 512, ..Settings::default() }), 40 * 24);
    // In a closed cavity without light no path ends early: one camera ray a dispatch and `bounces` rays a sample.
    let room = Scene { camera: look(DVec3::ZERO, DVec3::X, 40.0, 40, 24), shapes: vec![cavity(1.0, 0.5, 0.0)] };
    let settings = Settings { spp: 64, bounces: 5, estimator: Estimator::Cosine, ..Settings::default() };
    assert_eq!(rays(&room, settings.clone()), 40 * 24 * (1 + 64 * 5));
    assert_eq!(rays(&room, Settings { aa: true, ..settings }), 40 * 24 * 64 * 6);
}
