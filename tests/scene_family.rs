//! The family `spheres:N`, its animation, validation, the hash and the host camera.

use glam::{DMat4, DVec2, DVec3};
use limpid::scene::family::{self, FRAME_PERIOD, MIN_GAP};
use limpid::scene::{Camera, Checker, Geometry, Scene, Shape, Spec, Texture, mitsuba};

/// Rounding of a distance between points of the box: a few ulp of 1.
const ROUNDING: f64 = 1e-14;

const CHECKER: Checker = Checker { albedo: DVec3::ZERO, repeats: DVec2::ONE, offset: DVec2::ZERO };

type Change = fn(&mut Scene);
type BoxedChange = Box<dyn Fn(&mut Scene)>;

fn spheres(scene: &Scene) -> Vec<(DVec3, f64, &Shape)> {
    scene
        .shapes
        .iter()
        .filter_map(|shape| match shape.geometry {
            Geometry::Sphere { center, radius, .. } => Some((center, radius, shape)),
            _ => None,
        })
        .collect()
}

fn assert_gaps(scene: &Scene, what: &str) {
    let spheres = spheres(scene);
    assert_eq!(spheres.len(), 5, "{what}");
    for (i, (a, ra, _)) in spheres.iter().enumerate() {
        let reach = a.abs().max_element() + ra;
        assert!(reach <= 1.0 - MIN_GAP + ROUNDING, "{what}: sphere {i} reaches {reach}");
        for (b, rb, _) in &spheres[..i] {
            let gap = a.distance(*b) - ra - rb;
            assert!(gap >= MIN_GAP - ROUNDING, "{what}: sphere {i} has a gap of {gap}");
        }
    }
}

#[test]
fn members_follow_their_definition() {
    let walls = &family::canonical().shapes[..5];
    for n in (0..300).chain(90_000..90_100).chain([u64::MAX]) {
        let scene = family::spheres(n);
        scene.validate().unwrap();
        assert_gaps(&scene, &format!("spheres:{n}"));
        assert_eq!(&scene.shapes[..5], walls);
        let camera = &scene.camera;
        assert_eq!((camera.width, camera.height, camera.fov_x_degrees), (768, 768, 39.3));
        assert!((camera.origin() - DVec3::new(0.0, 0.0, 3.9)).abs().max_element() <= 0.3);
        let view = -camera.to_world.z_axis;
        let (yaw, pitch) = ((-view.x).atan2(-view.z).to_degrees(), view.y.asin().to_degrees());
        assert!(yaw.abs() <= 6.0 && pitch.abs() <= 6.0, "{yaw} {pitch}");
        assert!(camera.to_world.x_axis.y.abs() < 1e-15, "no roll");
        for (i, (_, radius, shape)) in spheres(&scene).into_iter().enumerate() {
            if i == 0 {
                assert!((0.12..0.28).contains(&radius));
                assert_eq!(shape.albedo, DVec3::ZERO);
                let power = shape.radiance.x * radius * radius;
                assert!((power - 12.0 * 0.04).abs() < 1e-14, "{power}");
            } else {
                assert!((0.15..0.40).contains(&radius));
                assert!(shape.albedo.to_array().iter().all(|a| (0.05..0.9).contains(a)));
                assert_eq!(shape.radiance, DVec3::ZERO);
            }
        }
    }
}

/// Means over many members: a draw used twice, a wrong range or a stuck bit shows here.
#[test]
fn draws_are_uniform() {
    let count = 4000;
    // (low, high) of each figure; their means are within 5 standard errors of the middle, the correlations of 0.
    let mut figures: Vec<(f64, f64, Vec<f64>)> = Vec::new();
    for n in 0..count {
        let scene = family::spheres(n);
        let origin = scene.camera.origin() - DVec3::new(0.0, 0.0, 3.9);
        let view = -scene.camera.to_world.z_axis;
        let mut values = origin.to_array().map(|v| (-0.3, 0.3, v)).to_vec();
        values.push((-6.0, 6.0, (-view.x).atan2(-view.z).to_degrees()));
        values.push((-6.0, 6.0, view.y.asin().to_degrees()));
        for (i, (_, _, shape)) in spheres(&scene).into_iter().enumerate().skip(1) {
            assert!(i < 5);
            values.extend(shape.albedo.to_array().map(|a| (0.05, 0.9, a)));
        }
        figures.resize(values.len(), (0.0, 0.0, Vec::new()));
        for (&(low, high, value), figure) in values.iter().zip(&mut figures) {
            (figure.0, figure.1) = (low, high);
            figure.2.push(value);
        }
    }
    let unit: Vec<Vec<f64>> = figures
        .iter()
        .map(|(low, high, values)| values.iter().map(|v| (v - low) / (high - low) - 0.5).collect())
        .collect();
    let n = count as f64;
    for (i, a) in unit.iter().enumerate() {
        let mean = a.iter().sum::<f64>() / n;
        let variance = a.iter().map(|v| v * v).sum::<f64>() / n;
        assert!(mean.abs() < 5.0 * (1.0 / 12.0 / n).sqrt(), "figure {i}: mean {mean}");
        // The variance of u^2 for u uniform in [-1/2, 1/2] is 1/180.
        assert!((variance - 1.0 / 12.0).abs() < 5.0 * (1.0 / 180.0 / n).sqrt(), "figure {i}: variance {variance}");
        for (j, b) in unit[..i].iter().enumerate() {
            let covariance = a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / n;
            assert!(covariance.abs() < 5.0 / 12.0 / n.sqrt(), "figures {i} and {j}: covariance {covariance}");
        }
    }
}

/// The family's bits are fixed for version 1, on every machine.
#[test]
fn version_1_keeps_its_bits() {
    assert_eq!(family::FAMILY_VERSION, 1);
    let hashes = [0, 7, 90_000, 99_999].map(|n| family::spheres(n).hash());
    assert_eq!(hashes, ["ba2aa047ed26e293", "e9a1db9f31d07076", "db488e49ae632d62", "20770a62fab617a9"]);
    assert_eq!(family::frame(7, 100).hash(), "4a3dc3cf5d25f8f2");
    assert_eq!(family::canonical().hash(), "9ecf3d1fad84369f");
}

#[test]
fn held_out_range() {
    let held_out: Vec<_> =
        [0, 89_999, 90_000, 99_999, 100_000].into_iter().filter(|&n| family::is_held_out(n)).collect();
    assert_eq!(held_out, [90_000, 99_999]);
}

#[test]
fn frames_keep_gaps_and_close_the_path() {
    let mut moved: f64 = 0.0;
    for n in [0, 1, 7, 90_000] {
        let first = family::spheres(n);
        assert_eq!(family::frame(n, 0), first);
        assert_eq!(family::frame(n, FRAME_PERIOD), first);
        assert_eq!(family::frame(n, u32::MAX), family::frame(n, u32::MAX % FRAME_PERIOD));
        let mut before = first.clone();
        for t in 1..=FRAME_PERIOD {
            let scene = family::frame(n, t);
            scene.validate().unwrap();
            assert_gaps(&scene, &format!("spheres:{n} frame {t}"));
            assert_ne!(scene.camera.to_world, before.camera.to_world, "the camera pans");
            for ((a, ra, _), (b, rb, _)) in spheres(&scene).into_iter().zip(spheres(&before)) {
                assert_eq!(ra, rb);
                // On each axis at most amplitude 0.5 and 2 turns a period: 0.5 * 2 * 2 pi / 240 a frame.
                assert!(a.distance(b) < 0.0262 * 3f64.sqrt(), "spheres:{n} frame {t}: a jump of {}", a.distance(b));
                moved = moved.max(a.distance(spheres(&first)[1].0));
            }
            before = scene;
        }
    }
    assert!(moved > 0.3, "the spheres move: {moved}");
}

#[test]
fn specs() {
    assert_eq!("spheres".parse::<Spec>().unwrap(), Spec::Canonical);
    assert_eq!("spheres:7".parse::<Spec>().unwrap(), Spec::Family(7));
    assert_eq!("a/b.xml".parse::<Spec>().unwrap(), Spec::File("a/b.xml".into()));
    for bad in ["spheres:", "spheres:x", "spheres:-1", "spheres:+1", "spheres:1.5", "spheres:99999999999999999999"] {
        let error = bad.parse::<Spec>().unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("spheres:N"), "{error}");
    }
    assert_eq!(Scene::from_spec("spheres:7").unwrap(), family::spheres(7));
    let missing = Scene::from_spec("no/such/file.xml").unwrap_err();
    assert_eq!(missing.exit_code(), 2);
    assert!(missing.to_string().contains("no/such/file.xml"));
    let size = mitsuba::Options { size: Some((64, 32)), ..Default::default() };
    let camera = Spec::Canonical.load(&size).unwrap().scene.camera;
    assert_eq!((camera.width, camera.height, camera.fov_x_degrees), (64, 32, 39.3));
    assert_eq!(Spec::Family(3).load_frame(5, &Default::default()).unwrap().scene, family::frame(3, 5));
    assert!(Spec::Canonical.load_frame(0, &Default::default()).is_err());
    assert!(Spec::Canonical.load(&mitsuba::Options { size: Some((0, 1)), ..Default::default() }).is_err());
}

#[test]
fn validation_refuses_what_cannot_be_rendered() {
    let change = |f: Change| {
        let mut scene = family::spheres(1);
        f(&mut scene);
        scene
    };
    fn sphere(scene: &mut Scene, new_center: DVec3, new_radius: f64) {
        scene.shapes[5].geometry = Geometry::Sphere { center: new_center, radius: new_radius, inward: false };
    }
    fn rectangle(scene: &mut Scene, half_u: DVec3, half_v: DVec3) {
        scene.shapes[0].geometry = Geometry::Rectangle { center: DVec3::ZERO, half_u, half_v };
    }
    let bad: [(&str, Change); 24] = [
        ("no pixels", |s| s.camera.width = 0),
        ("no pixels", |s| s.camera.height = 0),
        ("too large", |s| s.camera.width = 16_385),
        ("too large", |s| (s.camera.width, s.camera.height) = (16_384, 16_385)),
        ("field of view", |s| s.camera.fov_x_degrees = 0.0),
        ("field of view", |s| s.camera.fov_x_degrees = 180.0),
        ("field of view", |s| s.camera.fov_x_degrees = f64::NAN),
        ("position", |s| s.camera.to_world.w_axis.x = f64::INFINITY),
        ("rotation", |s| s.camera.to_world.x_axis *= 1.01),
        ("rotation", |s| s.camera.to_world.x_axis *= -1.0),
        ("rotation", |s| s.camera.to_world.y_axis.y = f64::NAN),
        ("radius", |s| sphere(s, DVec3::ZERO, 0.0)),
        ("radius", |s| sphere(s, DVec3::ZERO, -1.0)),
        ("radius", |s| sphere(s, DVec3::ZERO, f64::NAN)),
        ("center", |s| sphere(s, DVec3::new(0.0, f64::NAN, 0.0), 1.0)),
        ("center", |s| sphere(s, DVec3::new(0.0, 0.0, 1e16), 1.0)),
        ("degenerate", |s| rectangle(s, DVec3::ZERO, DVec3::X)),
        ("sheared", |s| rectangle(s, DVec3::X, DVec3::new(1.0, 1.0, 0.0))),
        ("edge", |s| rectangle(s, DVec3::X, DVec3::new(f64::NAN, 1.0, 0.0))),
        ("reflectance", |s| s.shapes[0].albedo.x = 1.0 + 1e-12),
        ("reflectance", |s| s.shapes[0].albedo.y = -0.1),
        ("reflectance", |s| s.shapes[0].albedo.z = f64::NAN),
        ("radiance", |s| s.shapes[5].radiance.x = -1.0),
        ("radiance", |s| s.shapes[5].radiance.x = f64::INFINITY),
    ];
    for (i, (word, f)) in bad.into_iter().enumerate() {
        let error = change(f).validate().unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(word), "case {i}: {error}");
    }
    let error = change(|s| s.shapes[5].radiance.x = -1.0).validate().unwrap_err();
    assert!(error.to_string().contains("'light'"), "the shape is named: {error}");
    let good: [Change; 3] = [
        |s| s.shapes.clear(),
        |s| s.shapes[0].albedo = DVec3::ONE,
        |s| (s.camera.width, s.camera.height) = (16_384, 16_384),
    ];
    good.into_iter().for_each(|f| change(f).validate().unwrap());
}

#[test]
fn hash_sees_every_number() {
    let scene = family::spheres(1);
    let hash = scene.hash();
    assert!(hash.len() == 16 && hash.bytes().all(|b| b.is_ascii_hexdigit()));
    let next = |v: &mut f64| *v = v.next_up();
    let changes: [BoxedChange; 13] = [
        Box::new(|s| s.camera.width += 1),
        Box::new(|s| s.camera.height += 1),
        Box::new(move |s| next(&mut s.camera.fov_x_degrees)),
        Box::new(move |s| next(&mut s.camera.to_world.w_axis.z)),
        Box::new(move |s| next(&mut s.shapes[0].albedo.x)),
        Box::new(move |s| next(&mut s.shapes[5].radiance.z)),
        Box::new(|s| s.shapes[0].texture = Some(Texture::Checker(CHECKER))),
        Box::new(|s| {
            s.shapes[0].texture = Some(Texture::Checker(Checker { repeats: DVec2::new(1.0, 2.0), ..CHECKER }))
        }),
        Box::new(|s| s.shapes[0].texture = Some(Texture::Checker(Checker { albedo: DVec3::X, ..CHECKER }))),
        Box::new(|s| match s.shapes[0].geometry {
            Geometry::Rectangle { center, half_u, half_v } => {
                s.shapes[0].geometry = Geometry::Disk { center, half_u, half_v };
            }
            _ => unreachable!(),
        }),
        Box::new(|s| s.shapes.swap(6, 7)),
        Box::new(|s| drop(s.shapes.pop())),
        Box::new(move |s| match &mut s.shapes[0].geometry {
            Geometry::Rectangle { half_v, .. } => next(&mut half_v.x),
            _ => unreachable!(),
        }),
    ];
    let mut hashes = vec![hash.clone()];
    for (i, change) in changes.iter().enumerate() {
        let mut other = scene.clone();
        change(&mut other);
        assert!(!hashes.contains(&other.hash()), "change {i}");
        hashes.push(other.hash());
    }
    let mut same = scene.clone();
    same.shapes[0].name = "another".into();
    same.shapes[0].radiance.x = -0.0;
    assert_eq!(same.hash(), hash);
}

#[test]
fn camera_rays() {
    let camera = Camera { to_world: DMat4::IDENTITY, fov_x_degrees: 90.0, width: 4, height: 2, lens: None };
    // Half extents are 1 and 1/2: the corners of the image plane at z = -1 are (-1, 1/2) and (1, -1/2).
    let corner = camera.ray(0.0, 0.0).direction;
    assert!(corner.distance(DVec3::new(-1.0, 0.5, -1.0).normalize()) < 1e-15);
    let corner = camera.ray(4.0, 2.0).direction;
    assert!(corner.distance(DVec3::new(1.0, -0.5, -1.0).normalize()) < 1e-15);
    assert_eq!(camera.ray(2.0, 1.0).direction, DVec3::NEG_Z);
    assert_eq!(camera.pixel_ray(3, 0), camera.ray(3.5, 0.5));

    let eye = DVec3::new(3.0, 2.0, 1.0);
    let camera = Camera::look_at(eye, DVec3::new(-1.0, 0.5, 2.0), DVec3::Y, 50.0, 7, 5).unwrap();
    camera.validate().unwrap();
    let middle = camera.ray(3.5, 2.5);
    assert_eq!(middle.origin, eye);
    assert!(middle.direction.distance((DVec3::new(-1.0, 0.5, 2.0) - eye).normalize()) < 1e-15);
    assert!(camera.ray(3.5, 0.0).direction.y > middle.direction.y, "the top of the image is up");
    assert!(middle.direction.cross(DVec3::Y).dot(camera.ray(7.0, 2.5).direction) > 0.0, "x grows to the right");
    assert!(Camera::look_at(eye, eye, DVec3::Y, 50.0, 7, 5).is_err());
    assert!(Camera::look_at(DVec3::ZERO, DVec3::Y, DVec3::Y, 50.0, 7, 5).is_err());
}
