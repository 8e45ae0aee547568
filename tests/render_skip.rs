//! What pipelines leave out where a scene does not need it changes no bit of the picture.

mod render_support;

use glam::DVec3;
use limpid::gpu::Gpu;
use limpid::image::Image;
use limpid::metrics::different_values;
use limpid::render::{Estimator, Features, Renderer, Sampler, Settings, Skip};
use limpid::scene::tessellate::grid;
use limpid::scene::{Bsdf, DeltaKind, DeltaLight, Environment, Scene, Shape, rooms};
use limpid::stress::support::mesh_of;
use render_support::*;

const COLOURS: [&str; 3] = ["R", "G", "B"];

fn with_features(gpu: &Gpu, scene: &Scene, settings: &Settings, features: Features) -> Image {
    let mut renderer = Renderer::with_features(gpu, scene, settings, features).expect("renderer");
    renderer.finish().expect("render");
    renderer.image().expect("image")
}

/// The same bits, but for drivers that may contract what the shader does not mark: there the same picture to a thousandth of its mean.
fn assert_same_radiance(gpu: &Gpu, a: &Image, b: &Image, what: &str) {
    for name in COLOURS {
        let (a, b) = (&a.channels[name], &b.channels[name]);
        if gpu.info().name.contains("llvmpipe") {
            let different = different_values(a, b);
            assert_eq!(different, 0, "{what}: {different} of {} values of {name} differ", a.len());
        } else {
            let mean = |plane: &[f32]| plane.iter().map(|&v| f64::from(v)).sum::<f64>() / plane.len() as f64;
            let (a, b) = (mean(a), mean(b));
            assert!((a - b).abs() <= 1e-3 * a, "{what}: means {a} and {b} of {name}");
        }
    }
}

/// The canonical frame, the same with a screen before its light, and rooms with checkers, several lights and many spheres.
fn scenes() -> Vec<(String, Scene)> {
    let mut screen = cornell(48);
    screen.shapes.push(rectangle(DVec3::new(0.1, 0.2, 0.1), DVec3::Z * 0.4, DVec3::X * 0.4, 0.5, 0.0));
    let mut scenes = vec![("spheres".to_owned(), cornell(48)), ("screen".to_owned(), screen)];
    for n in [1, 2, 3, 4, 5, 6] {
        let mut scene = rooms::rooms(n);
        (scene.camera.width, scene.camera.height) = (48, 40);
        scenes.push((format!("rooms:{n}"), scene));
    }
    let mut metal = cornell(48);
    metal.shapes[0].bsdf = Bsdf::Conductor { eta: DVec3::ZERO, k: DVec3::ONE, roughness: Some(0.3) };
    let kind = DeltaKind::Point { position: DVec3::new(0.3, 0.5, 0.2) };
    metal.delta_lights.push(DeltaLight { name: "bulb".into(), intensity: DVec3::ONE, kind });
    metal.environment = Some(Environment::Constant(DVec3::ONE));
    scenes.push(("metal".to_owned(), metal));
    scenes
}

fn check(skip: Skip) {
    check_in(skip, scenes());
}

fn check_in(skip: Skip, scenes: Vec<(String, Scene)>) {
    let gpu = device();
    let mut seen = 0;
    for (name, scene) in scenes {
        for (estimator, sampler) in [(Estimator::Nee, Sampler::Sobol), (Estimator::Cosine, Sampler::Pcg)] {
            for aa in [false, true] {
                if !scene.delta_lights.is_empty() && estimator != Estimator::Nee {
                    continue;
                }
                let settings = Settings { spp: 8, estimator, sampler, aa, aovs: false, ..Settings::default() };
                let features = Features::new(&scene, &settings);
                if !features.skips().any(|s| s == skip) {
                    continue;
                }
                seen += 1;
                let own = with_features(&gpu, &scene, &settings, features.clone());
                let what = format!("{skip} in {name}, {estimator}, aa {aa}");
                assert_same_radiance(&gpu, &own, &with_features(&gpu, &scene, &settings, features.with(skip)), &what);
            }
        }
    }
    assert!(seen >= 4, "{skip} was skipped in {seen} renders");
}

#[test]
fn loops_are_skipped() {
    check(Skip::Loops);
}

#[test]
fn shadow_tests_are_skipped() {
    check(Skip::ShadowTests);
}

#[test]
fn far_sides_are_skipped() {
    check(Skip::FarSides);
}

#[test]
fn checkers_are_skipped() {
    check(Skip::Checkers);
}

#[test]
fn materials_are_skipped() {
    // Not in all of them: pipelines with all materials take a second to compile.
    check_in(Skip::Materials, scenes().into_iter().step_by(3).collect());
}

#[test]
fn meshes_are_skipped() {
    check(Skip::Meshes);
}

#[test]
fn environments_are_skipped() {
    check(Skip::Environment);
}

#[test]
fn last_rays_are_skipped() {
    check(Skip::LastRays);
}

#[test]
fn aovs_are_skipped() {
    check(Skip::Aovs);
}

#[test]
fn the_generic_pipeline_renders_the_same() {
    let gpu = device();
    for (name, scene) in scenes() {
        let settings = Settings { spp: 8, aovs: false, ..Settings::default() };
        let features = Features::new(&scene, &settings);
        let own = with_features(&gpu, &scene, &settings, features.clone());
        assert_same_radiance(&gpu, &own, &with_features(&gpu, &scene, &settings, features.generic()), &name);
    }
}

/// Every feature is skipped somewhere, and where it is not, the scene needs it.
#[test]
fn a_scene_keeps_what_it_needs() {
    let skips = |scene: &Scene, settings: &Settings| Features::new(scene, settings).skips().collect::<Vec<_>>();
    let settings = Settings { aovs: false, ..Settings::default() };
    assert_eq!(skips(&cornell(8), &settings), Skip::ALL);
    assert!(!skips(&cornell(8), &Settings::default()).contains(&Skip::Aovs));
    let mut scene = cornell(8);
    scene.camera = look([0.5, 0.1, -0.5].into(), [0.0; 3].into(), 60.0, 8, 8); // in the sphere `mid`
    assert!(!skips(&scene, &settings).contains(&Skip::FarSides));
    let mut scene = cornell(8);
    scene.shapes.extend((0..17).map(|i| sphere([0.0, 0.0, f64::from(i) * 0.01], 0.001, 0.5, 0.0)));
    assert!(!skips(&scene, &settings).contains(&Skip::Loops));
    let mut scene = cornell(8);
    let metal = |roughness| Bsdf::Conductor { eta: DVec3::ZERO, k: DVec3::ONE, roughness };
    let glass = Bsdf::Dielectric { ior: 1.5, transmittance: DVec3::ONE };
    let plastic = Bsdf::Plastic { ior: 1.5, specular: DVec3::ONE, nonlinear: false };
    for (shape, bsdf) in scene.shapes.iter_mut().zip([metal(None), metal(Some(0.1)), glass, plastic]) {
        shape.bsdf = bsdf;
    }
    scene.shapes[0].two_sided = true;
    assert!(!skips(&scene, &settings).contains(&Skip::Materials));
    let mut scene = cornell(8);
    scene.shapes[1].bsdf = metal(None);
    assert!(!skips(&scene, &settings).contains(&Skip::LastRays));
    let panel = |radiance| rectangle(DVec3::Y * 0.9, DVec3::X * 0.2, DVec3::Z * 0.2, 0.5, radiance);
    let mesh = |radiance| mesh_of(grid(DVec3::Y * 0.9, DVec3::X * 0.2, DVec3::Z * 0.2, &[0.0, 1.0]), 0.5, radiance);
    for (light, dark) in
        [(panel(1.0), panel(0.0)), (mesh(1.0), mesh(0.0)), (cavity(3.0, 0.5, 1.0), cavity(3.0, 0.5, 0.0))]
    {
        let with = |shape: &Shape| {
            let mut scene = cornell(8);
            scene.shapes.push(shape.clone());
            skips(&scene, &settings)
        };
        assert!(!with(&light).contains(&Skip::LastRays), "{light:?}");
        assert!(with(&dark).contains(&Skip::LastRays), "{dark:?}");
    }
    assert!(!skips(&Scene { shapes: vec![mesh(0.0)], ..cornell(8) }, &settings).contains(&Skip::Meshes));
    let sky = Scene { environment: Some(Environment::Constant(DVec3::ONE)), ..cornell(8) };
    assert!(!skips(&sky, &settings).contains(&Skip::LastRays));
    assert!(!skips(&sky, &settings).contains(&Skip::Environment));
    let found = Settings { estimator: Estimator::Cosine, ..settings.clone() };
    assert!(!skips(&cornell(8), &found).contains(&Skip::LastRays));
    let checkered = (0..20).map(rooms::rooms).find(|scene| scene.shapes.iter().any(|s| s.texture.is_some()));
    assert!(!skips(&checkered.expect("a room with a checkerboard"), &settings).contains(&Skip::Checkers));
}

#[test]
fn without_first_hits_there_is_only_radiance() {
    let gpu = device();
    for aa in [false, true] {
        let settings = Settings { spp: 4, aa, aovs: false, ..Settings::default() };
        let mut renderer = Renderer::new(&gpu, &cornell(24), &settings).expect("renderer");
        renderer.finish().expect("render");
        let image = renderer.image().expect("image");
        assert_eq!(image.channels.keys().map(String::as_str).collect::<Vec<_>>(), ["B", "G", "R"]);
        let whole = render(&gpu, &cornell(24), &Settings { aovs: true, ..settings });
        COLOURS.iter().for_each(|c| assert_eq!(image.channels[*c], whole.channels[*c], "{c} aa {aa}"));
        assert!(renderer.outputs().is_err());
        assert!(renderer.features().skipped().contains(&"first-hit values".to_owned()));
    }
}
