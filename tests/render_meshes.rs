//! Triangle meshes: against closed forms, against rectangles, and between estimators.

mod render_support;

use std::sync::Arc;

use glam::{DMat2, DQuat, DVec2, DVec3};
use limpid::gpu::Gpu;
use limpid::render::{Estimator, Renderer, Sampler, Settings};
use limpid::scene::tessellate::{grid, hollow_box};
use limpid::scene::{
    Bitmap, Bsdf, DeltaKind, DeltaLight, Filter, Geometry, Mesh, Picture, Scene, Shape, Texture, Wrap,
};
use limpid::stress::support::mesh_of;
use render_support::*;

/// The rectangle that a shape is, as two triangles.
fn meshed(rect: &Shape) -> Shape {
    let Geometry::Rectangle { center, half_u, half_v } = rect.geometry else { panic!("{rect:?}") };
    let mut mesh = grid(center, half_u, half_v, &[0.0, 1.0]);
    mesh.uvs = vec![DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::ONE];
    Shape { geometry: Geometry::Mesh(Arc::new(mesh)), ..rect.clone() }
}

/// The Cornell box of triangles and of rectangles: the same random numbers, so nearly the same paths.
#[test]
fn triangles_show_what_rectangles_show() {
    let gpu = device();
    let mut scene = cornell(64);
    // On the axis, rays of the picture's diagonals meet two walls at once, and either may be the one that is hit.
    scene.camera.to_world.w_axis += DVec3::new(0.013, 0.007, 0.0).extend(0.0);
    compare(&gpu, &scene, &techniques().collect::<Vec<_>>());
}

/// The same of every material, a picture, a pane of glass and a point that emits.
#[test]
fn triangles_have_the_materials_of_rectangles() {
    let gpu = device();
    let mut scene = cornell(64);
    scene.camera.to_world.w_axis += DVec3::new(0.013, 0.007, 0.0).extend(0.0);
    let (eta, k) = (DVec3::new(0.2, 0.9, 1.1), DVec3::new(3.9, 2.4, 2.2));
    let picture = Picture {
        path: "quarters".into(),
        has_file: true,
        raw: true,
        width: 2,
        height: 2,
        texels: vec![[0.9, 0.1, 0.1], [0.1, 0.9, 0.1], [0.1, 0.1, 0.9], [0.5; 3]],
    };
    let bitmap = Bitmap {
        picture: Arc::new(picture),
        matrix: DMat2::from_cols(DVec2::new(2.0, 0.5), DVec2::new(0.0, 3.0)),
        offset: DVec2::new(0.1, 0.2),
        wrap: Wrap::Mirror,
        filter: Filter::Bilinear,
    };
    let mut pane = rectangle(DVec3::new(0.1, -0.2, 0.7), DVec3::new(0.3, 0.0, 0.1), DVec3::Y * 0.3, 1.0, 0.0);
    pane.bsdf = Bsdf::Dielectric { ior: 1.5, transmittance: DVec3::new(0.9, 0.8, 0.7) };
    let materials = [
        Bsdf::Conductor { eta, k, roughness: Some(0.3) },
        Bsdf::Conductor { eta, k, roughness: None },
        Bsdf::Plastic { ior: 1.5, specular: DVec3::ONE, nonlinear: true },
    ];
    for (wall, bsdf) in scene.shapes.iter_mut().filter(|s| is_rectangle(s)).zip(materials) {
        wall.bsdf = bsdf;
    }
    let last = scene.shapes.iter_mut().rfind(|s| is_rectangle(s)).expect("walls");
    (last.texture, last.two_sided) = (Some(Texture::Bitmap(bitmap)), true);
    scene.shapes.push(pane);
    scene.delta_lights.push(DeltaLight {
        name: "lamp".into(),
        intensity: DVec3::new(0.5, 0.7, 0.9),
        kind: DeltaKind::Point { position: DVec3::new(-0.5, 0.5, 0.4) },
    });
    compare(&gpu, &scene, &[(Estimator::Nee, Sampler::Pcg), (Estimator::Nee, Sampler::Sobol)]);
}

fn is_rectangle(shape: &Shape) -> bool {
    matches!(shape.geometry, Geometry::Rectangle { .. })
}

/// A scene as it is and with its rectangles as triangles.
fn compare(gpu: &Gpu, scene: &Scene, choices: &[(Estimator, Sampler)]) {
    let mut other = scene.clone();
    for shape in other.shapes.iter_mut().filter(|s| is_rectangle(s)) {
        *shape = meshed(shape);
    }
    for &choice in choices {
        for aa in [false, true] {
            let s = Settings { aa, ..settings(64, 8, choice) };
            let (a, b) = (render(gpu, scene, &s), render(gpu, &other, &s));
            for name in ["R", "G", "B", "albedo.R", "N.X", "N.Y", "N.Z", "Z"] {
                // A path may turn into another one where a rounding decides what it hits: two pixels at most as measured.
                let differs = |(x, y): (&f32, &f32)| (x - y).abs() > 1e-3 * x.abs().max(y.abs()) + 1e-5;
                let count = a.channels[name].iter().zip(&b.channels[name]).filter(|&p| differs(p)).count();
                assert!(count <= 8, "{choice:?} aa {aa}: {count} of 4096 values of {name} differ");
            }
        }
    }
}

/// A rectangle light of triangles of all sizes: the form factor of a square of half side a at distance 1, from under its
/// centre: 4/pi * q * atan(q) with q = a / sqrt(1 + a²).
#[test]
fn mesh_light_on_a_patch() {
    let gpu = device();
    let lines = [0.0, 0.01, 0.02, 0.3, 0.31, 0.8, 1.0];
    for a in [0.1f64, 0.5, 2.0] {
        let q = a / (1.0 + a * a).sqrt();
        let expected = 0.5 * 3.0 * 4.0 / std::f64::consts::PI * q * q.atan();
        let turn = DQuat::from_rotation_z(0.4) * DQuat::from_rotation_x(0.4);
        let patch = rectangle(DVec3::ZERO, turn * DVec3::Z * 1e-3, turn * DVec3::X * 1e-3, 0.5, 0.0);
        let light = mesh_of(grid(turn * DVec3::Y, turn * DVec3::X * a, turn * DVec3::Z * a, &lines), 0.0, 3.0);
        let camera = look(turn * DVec3::new(2e-4, 1e-3, 1e-4), DVec3::ZERO, 10.0, 24, 24);
        for patch in [patch.clone(), meshed(&patch)] {
            let scene = Scene::new(camera.clone(), vec![patch, light.clone()]);
            for choice in techniques() {
                let values = surface(&render(&gpu, &scene, &settings(256, 1, choice)), "R");
                assert_eq!(values.len(), 24 * 24);
                let (mean, error) = mean_error(&values);
                assert!(error < 0.05 * expected);
                // 5e-4: rays start 2e-5 of the scene off the patch, which is no point.
                let allowed = SIGMAS * error + 5e-4 * expected;
                assert!((mean - expected).abs() < allowed, "{choice:?} {a}: {mean} +- {error}, expected {expected}");
            }
        }
    }
}

/// A strip of 2,048 triangles that are thinner than a hit is exact: a shadow ray that ends on one of them may not be stopped by its
/// neighbours. Half length b at distance 1, width w: albedo / pi * w * (atan b + b / (1 + b^2)).
#[test]
fn slivers_of_a_light_do_not_shade_one_another() {
    let gpu = device();
    let (b, half_width) = (0.5f64, 1e-5);
    let expected = 0.5 / std::f64::consts::PI * 3e4 * 2.0 * half_width * (b.atan() + b / (1.0 + b * b));
    let turn = DQuat::from_rotation_z(0.4) * DQuat::from_rotation_x(0.4);
    let patch = rectangle(DVec3::ZERO, turn * DVec3::Z * 1e-3, turn * DVec3::X * 1e-3, 0.5, 0.0);
    let lines: Vec<f64> = (0..=32).map(|i| f64::from(i) / 32.0).collect();
    let strip = grid(turn * DVec3::Y, turn * DVec3::X * half_width, turn * DVec3::Z * b, &lines);
    let camera = look(turn * DVec3::new(2e-4, 1e-3, 1e-4), DVec3::ZERO, 10.0, 24, 24);
    let scene = Scene::new(camera, vec![patch, mesh_of(strip, 0.0, 3e4)]);
    for sampler in [Sampler::Pcg, Sampler::Sobol] {
        let values = surface(&render(&gpu, &scene, &settings(256, 1, (Estimator::Nee, sampler))), "R");
        let (mean, error) = mean_error(&values);
        assert!(error < 2e-3 * expected);
        let allowed = SIGMAS * error + 5e-4 * expected;
        assert!((mean - expected).abs() < allowed, "{sampler:?}: {mean} +- {error}, expected {expected}");
    }
}

/// Meshes, rectangles and spheres that emit, side by side: light sampling shows what chance shows.
#[test]
fn mesh_lights_beside_others() {
    let gpu = device();
    let mut scene = cornell(48);
    scene.shapes.push(rectangle(DVec3::new(-0.6, 0.9, 0.0), DVec3::X * 0.2, DVec3::Z * 0.2, 0.0, 4.0));
    let lines = [0.0, 0.1, 0.15, 0.6, 1.0];
    for (center, radiance) in [(DVec3::new(0.6, 0.8, 0.3), 6.0), (DVec3::new(-0.2, -0.2, -0.7), 3.0)] {
        let small = |mesh: Mesh| Mesh { positions: mesh.positions.iter().map(|p| center - *p * 0.1).collect(), ..mesh };
        scene.shapes.push(mesh_of(small(hollow_box(&lines)), 0.3, radiance));
    }
    let means = |estimator| {
        let s = Settings { spp: 64, estimator, sampler: Sampler::Pcg, ..Settings::default() };
        mean_of_seeds(&gpu, &scene, &s)
    };
    let ((nee, nee_error), (cosine, cosine_error)) = (means(Estimator::Nee), means(Estimator::Cosine));
    let error = nee_error.hypot(cosine_error);
    assert!(error < 0.005 * nee, "standard error {error} of {nee} proves nothing");
    assert!((nee - cosine).abs() < SIGMAS * error, "{nee} +- {nee_error}, {cosine} +- {cosine_error}");
}

/// A patch whose vertices all have a normal 30 degrees off its own reflects by that one: the light, a far sphere, lies 60
/// degrees from it on one side and stands in it on the other.
#[test]
fn interpolated_normals_decide_the_cosine() {
    let gpu = device();
    let s2 = 0.04f64; // (0.2 / 1)²
    for (degrees, cosine) in [(-30.0f64, 0.5f64), (30.0, 1.0)] {
        let at = |degrees: f64| DVec3::new(degrees.to_radians().sin(), degrees.to_radians().cos(), 0.0);
        let mut patch = grid(DVec3::ZERO, DVec3::Z * 1e-3, DVec3::X * 1e-3, &[0.0, 1.0]);
        patch.normals = vec![at(degrees); patch.positions.len()];
        let light = sphere(at(30.0).to_array(), 0.2, 0.0, 3.0);
        let camera = look(DVec3::new(2e-4, 1e-3, 1e-4), DVec3::ZERO, 10.0, 24, 24);
        let scene = Scene::new(camera, vec![mesh_of(patch, 0.5, 0.0), light]);
        let expected = 0.5 * 3.0 * s2 * cosine;
        for choice in techniques() {
            let image = render(&gpu, &scene, &settings(if choice.0 == Estimator::Nee { 256 } else { 1024 }, 1, choice));
            assert!(image.channels["N.X"].iter().all(|x| (f64::from(*x) - at(degrees).x).abs() < 1e-6));
            let values = surface(&image, "R");
            assert_eq!(values.len(), 24 * 24);
            let (mean, error) = mean_error(&values);
            assert!(error < 0.05 * expected);
            let allowed = SIGMAS * error + 5e-4 * expected;
            assert!((mean - expected).abs() < allowed, "{choice:?} {degrees}: {mean} +- {error}, expected {expected}");
        }
    }
}

/// Another scene of the same features may have a tree of another size.
#[test]
fn a_renderer_takes_other_meshes() {
    let gpu = device();
    let camera = look(DVec3::new(0.0, 0.0, 0.9), DVec3::ZERO, 60.0, 16, 16);
    let scene = |lines: &[f64]| Scene::new(camera.clone(), vec![mesh_of(hollow_box(lines), 0.5, 1.0)]);
    let mut renderer = Renderer::new(&gpu, &scene(&[0.0, 0.4, 1.0]), &Settings::default()).expect("renderer");
    let other = scene(&[0.0, 0.001, 1.0]);
    let mut fresh = Renderer::new(&gpu, &other, &Settings::default()).expect("renderer");
    assert_eq!(renderer.features().mesh_steps, fresh.features().mesh_steps);
    renderer.set_scene(&other).expect("the same features");
    for renderer in [&mut renderer, &mut fresh] {
        renderer.finish().expect("render");
    }
    assert_same_bits(&renderer.image().expect("image"), &fresh.image().expect("image"), "set and fresh");
}
