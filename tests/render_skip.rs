//! What pipelines leave out where a scene does not need it changes no bit of the picture.

mod render_support;

use glam::DVec3;
use limpid::gpu::Gpu;
use limpid::image::Image;
use limpid::metrics::different_values;
use limpid::render::{Estimator, Features, Renderer, Sampler, Settings, Skip};
use limpid::scene::tessellate::grid;
use limpid::scene::{Bsdf, DeltaKind, DeltaLight, Environment, Geometry, Lens, Scene, Shape, rooms};
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

/// The canonical frame from so far away that rays start a hundredth of a sphere's size off their surfaces: near where a sphere touches
/// another surface, in that sphere or beyond that wall.
fn seen_from_afar(eye: [f64; 3]) -> Scene {
    let mut scene = cornell(96);
    scene.camera = look(eye.into(), [0.0, -0.3, 0.0].into(), 0.4, 96, 96);
    scene.shapes.push(sphere([0.1, -0.2, 0.1], 0.3, 0.5, 0.0));
    scene
}

#[test]
fn walls_are_skipped() {
    let mut more = scenes();
    // A light and another sheet in the ceiling's plane, a sixth side, and one missing elsewhere.
    let mut flush = cornell(48);
    flush.shapes.push(rectangle(DVec3::Y, DVec3::X * 0.3, DVec3::Z * 0.3, 0.5, 4.0));
    flush.shapes.push(rectangle(DVec3::new(0.6, 1.0, 0.3), DVec3::X * 0.3, DVec3::Z * 0.3, 0.9, 0.0));
    more.push(("flush".to_owned(), flush));
    let front = rectangle(DVec3::Z, DVec3::Y, DVec3::X, 0.5, 0.0);
    let mut closed = cornell(48);
    closed.camera = look([0.0, 0.0, 0.9].into(), [0.1, -0.1, 0.0].into(), 80.0, 48, 48);
    closed.shapes.push(front);
    more.push(("closed".to_owned(), closed.clone()));
    more.push(("far".to_owned(), seen_from_afar([0.0, 0.0, 300.0])));
    // In a hall so wide that points of spheres on its floor are moved under it: from there no light is seen.
    let mut under = cornell(96);
    under.camera = look([0.0, -3999.3, 2.5].into(), [0.0, -3999.8, 0.0].into(), 40.0, 96, 96);
    under.shapes.retain(|shape| !matches!(shape.geometry, Geometry::Sphere { .. }));
    for shape in &mut under.shapes {
        let Geometry::Rectangle { center, half_u, half_v } = &mut shape.geometry else { continue };
        [center, half_u, half_v].into_iter().for_each(|v| *v *= 4000.0);
    }
    for i in 0..9 {
        let (x, z) = (-0.6 + 0.6 * f64::from(i % 3), -0.6 + 0.6 * f64::from(i / 3));
        under.shapes.push(sphere([x, -3999.75, z], 0.25, 0.9, if i % 2 == 0 { 0.0 } else { 40.0 }));
    }
    more.push(("under".to_owned(), under));
    for (k, eye) in [[-2.5, 0.3, 0.1], [0.1, -2.0, 0.3]].into_iter().enumerate() {
        let mut open = closed.clone();
        let axis = |shape: &Shape| shape.geometry.bounds().1[k] < -0.99;
        open.shapes.retain(|shape| !axis(shape));
        open.camera = look(eye.into(), [0.1, 0.2, -0.1].into(), 60.0, 48, 48);
        more.push((format!("open along axis {k}"), open));
    }
    for (name, scene) in &more {
        let features = Features::new(scene, &Settings::default());
        assert_eq!(features.box_sides != 0, features.preload && name != "metal", "{name}");
    }
    check_in(Skip::Walls, more);
}

#[test]
fn roots_are_skipped() {
    let mut more = scenes();
    let mut touching = cornell(48);
    touching.shapes.push(sphere([0.0, 0.0, 0.0], 0.2, 0.5, 0.0));
    touching.shapes.push(sphere([0.0, -0.3, 0.0], 0.1, 0.9, 0.0));
    more.push(("touching".to_owned(), touching));
    // A sheet that cuts spheres: points of it are moved into them.
    let mut far = seen_from_afar([0.0, 120.0, 270.0]);
    far.shapes.retain(|shape| shape.geometry.bounds().0.y < 0.99); // the ceiling
    far.shapes.push(rectangle(DVec3::Y * -0.9, DVec3::Z, DVec3::X, 0.8, 0.0));
    more.push(("far".to_owned(), far));
    for (name, scene) in &more {
        let features = Features::new(scene, &Settings::default());
        assert_eq!(features.spheres_apart, features.preload && features.sphere_count > 1, "{name}");
    }
    check_in(Skip::Roots, more);
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
    scene.shapes.push(sphere([0.0; 3], 0.2, 0.5, 0.0));
    assert!(skips(&scene, &settings).contains(&Skip::Roots));
    scene.shapes.push(sphere([0.0, 0.29, 0.0], 0.1, 0.5, 0.0)); // meets that
    assert!(!skips(&scene, &settings).contains(&Skip::Roots));
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

/// Only a scene in a box leaves out walls: one side may be missing, and the camera looks in there.
#[test]
fn a_box_holds_the_scene() {
    let boxed = |change: &dyn Fn(&mut Scene)| {
        let mut scene = cornell(8);
        change(&mut scene);
        Features::new(&scene, &Settings::default()).box_sides != 0
    };
    let eye = |eye: [f64; 3]| move |scene: &mut Scene| scene.camera = look(eye.into(), [0.0; 3].into(), 60.0, 8, 8);
    let wall = |scene: &Scene, axis: usize| {
        let across = |s: &Shape| s.geometry.bounds().0[axis] == s.geometry.bounds().1[axis];
        scene.shapes.iter().position(across).expect("a wall")
    };
    assert!(boxed(&|_| {}));
    assert!(boxed(&eye([0.9, -0.9, 0.9])) && boxed(&eye([0.9, -0.9, 90.0])));
    // Beside the box, behind it, in a side, with a lens that reaches beyond one.
    assert!(!boxed(&eye([1.1, 0.0, 3.0])) && !boxed(&eye([0.0, 0.2, -2.0])) && !boxed(&eye([0.2, 1.0, 0.0])));
    let lens = |radius| Some(Lens { aperture_radius: radius, focus_distance: 1.0 });
    assert!(boxed(&|scene| scene.camera.lens = lens(0.9)) && !boxed(&|scene| scene.camera.lens = lens(1.1)));
    // So far off that rays past the missing side's rim are as good as parallel to the walls.
    assert!(boxed(&eye([0.0, 0.0, 300.0])) && !boxed(&eye([0.0, 0.0, 3000.0])));
    // Two sides missing; one of another size, place or direction; a round one.
    assert!(!boxed(&|scene| drop(scene.shapes.remove(wall(scene, 0)))));
    for change in [
        (&|center: &mut DVec3, _: &mut DVec3| *center *= 1.001) as &dyn Fn(&mut DVec3, &mut DVec3),
        &|_, half| *half *= 1.001,
        &|_, half| *half += DVec3::X * 0.001,
    ] {
        assert!(!boxed(&|scene| {
            let wall = wall(scene, 0);
            let Geometry::Rectangle { center, half_u, .. } = &mut scene.shapes[wall].geometry else { return };
            change(center, half_u);
        }));
    }
    assert!(!boxed(&|scene| {
        let wall = wall(scene, 1);
        let Geometry::Rectangle { center, half_u, half_v } = scene.shapes[wall].geometry else { return };
        scene.shapes[wall].geometry = Geometry::Disk { center, half_u, half_v };
    }));
    // Something sticks out; a side that light passes; touching spheres where there is light outside.
    assert!(!boxed(&|scene| scene.shapes.push(sphere([0.9, 0.0, 0.0], 0.11, 0.5, 0.0))));
    assert!(boxed(&|scene| scene.shapes.push(sphere([0.9, 0.0, 0.0], 0.1, 0.5, 0.0))));
    assert!(!boxed(&|scene| {
        let wall = wall(scene, 2);
        scene.shapes[wall].bsdf = Bsdf::Dielectric { ior: 1.5, transmittance: DVec3::ONE };
    }));
    let sky = |scene: &mut Scene| scene.environment = Some(Environment::Constant(DVec3::ONE));
    assert!(!boxed(&sky));
    assert!(boxed(&|scene| {
        sky(scene);
        scene.shapes.retain(|shape| matches!(shape.geometry, Geometry::Rectangle { .. }));
    }));
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
