//! The family `rooms:N`: what its scenes are, their XML, and checkerboards as the path tracer shows them.

mod render_support;

use glam::{DVec2, DVec3};
use limpid::render::{Estimator, Sampler, Settings};
use limpid::scene::rooms::rooms;
use limpid::scene::{Camera, Checker, Geometry, Scene, Shape, Spec, Texture, mitsuba};
use render_support::{device, look, rectangle, render, sphere};
use std::collections::BTreeSet;

/// Rounding of a distance between points of a room: a few ulp of 4.
const ROUNDING: f64 = 1e-14;

fn emits(shape: &Shape) -> bool {
    shape.radiance != DVec3::ZERO
}

fn spheres(scene: &Scene) -> Vec<(DVec3, f64)> {
    let sphere = |shape: &Shape| match shape.geometry {
        Geometry::Sphere { center, radius, .. } => Some((center, radius)),
        _ => None,
    };
    scene.shapes.iter().filter_map(sphere).collect()
}

#[test]
fn members_follow_their_definition() {
    let (mut counts, mut lights, mut hidden, mut patterned) = (BTreeSet::new(), BTreeSet::new(), 0, 0);
    let numbers = (0..400).chain(90_000..90_100).chain([u64::MAX]);
    for n in numbers.clone() {
        let scene = rooms(n);
        scene.validate().unwrap();
        let what = format!("rooms:{n}");
        // The walls bound everything: floor, ceiling, back, left and right come first.
        let half = DVec3::new(center(&scene.shapes[4]).x, center(&scene.shapes[1]).y, -center(&scene.shapes[2]).z);
        assert!(scene.shapes[..5].iter().all(|wall| !emits(wall)), "{what}");
        let (eye, spheres) = (scene.camera.origin(), spheres(&scene));
        for (i, (a, ra)) in spheres.iter().enumerate() {
            assert!((half - a.abs()).min_element() >= ra + 0.015 - ROUNDING, "{what}: sphere {i} meets a wall");
            assert!(eye.distance(*a) >= ra + 0.2 - ROUNDING, "{what}: sphere {i} is at the eye");
            for (b, rb) in &spheres[..i] {
                assert!(a.distance(*b) >= ra + rb + 0.015 - ROUNDING, "{what}: sphere {i} meets another");
            }
        }
        let lit: Vec<&Shape> = scene.shapes.iter().filter(|s| emits(s)).collect();
        assert!(lit.iter().all(|light| light.albedo == DVec3::ZERO), "{what}");
        counts.insert(spheres.len());
        lights.insert(lit.len());
        hidden += u32::from(lit.iter().any(|light| is_hidden(eye, center(light), &spheres)));
        patterned += u32::from(scene.shapes.iter().any(|s| s.texture.is_some()));
        assert_eq!(scene, rooms(n), "{what} differs from itself");
    }
    assert_eq!((counts.first(), counts.last()), (Some(&2), Some(&40)));
    assert_eq!(lights, BTreeSet::from([1, 2, 3]));
    // Of 501 scenes: a light behind an object in at least a fifth, patterns in about half.
    assert!(hidden > 100 && (150..350).contains(&patterned), "{hidden} hidden, {patterned} patterned");
    let hashes: BTreeSet<_> = numbers.map(|n| rooms(n).hash()).collect();
    assert_eq!(hashes.len(), 501);
}

fn center(shape: &Shape) -> DVec3 {
    match shape.geometry {
        Geometry::Sphere { center, .. } | Geometry::Rectangle { center, .. } => center,
        ref other => unreachable!("{other:?}"),
    }
}

/// Whether a sphere lies between the eye and a light's centre.
fn is_hidden(eye: DVec3, light: DVec3, spheres: &[(DVec3, f64)]) -> bool {
    let (way, length) = ((light - eye).normalize(), light.distance(eye));
    spheres.iter().filter(|(c, _)| *c != light).any(|(c, r)| {
        let along = (*c - eye).dot(way);
        along > 0.0 && along < length && (eye + way * along).distance(*c) < *r
    })
}

/// A version of the family never changes.
#[test]
fn members_keep_their_hashes() {
    let hashes = [0, 7, 90_000, 99_999].map(|n| rooms(n).hash());
    assert_eq!(hashes, ["69c181b1ae75179b", "c19a24fe46635bd8", "1116d1e67fb108f6", "99ccd428ef77d5a4"]);
}

#[test]
fn the_name_is_parsed_and_written_scenes_load_bit_for_bit() {
    assert_eq!("rooms:12".parse::<Spec>().unwrap(), Spec::Rooms(12));
    for bad in ["rooms:", "rooms:x", "rooms:+1", "rooms:18446744073709551616"] {
        let error = bad.parse::<Spec>().unwrap_err().to_string();
        assert!(error.contains("rooms:N"), "{error}");
    }
    for n in 0..40 {
        let scene = rooms(n);
        let loaded =
            mitsuba::load_str(&mitsuba::write(&scene).unwrap(), "rooms.xml", &mitsuba::Options::default()).unwrap();
        assert_eq!(loaded.scene, scene, "rooms:{n}");
    }
}

/// The reflectance at a point, from the definition.
fn reflectance(shape: &Shape, p: DVec3) -> Option<DVec3> {
    /// Closer to the edge of a cell than this, either side will do: f32 places a hit to about 1e-6.
    const EDGE: f64 = 1e-4;
    let Some(checker) = shape.checker() else { return Some(shape.albedo) };
    let uv = match shape.geometry {
        Geometry::Rectangle { center, half_u, half_v } => {
            let along = |half: DVec3| 0.5 + 0.5 * (p - center).dot(half) / half.length_squared();
            DVec2::new(along(half_u), along(half_v))
        }
        Geometry::Sphere { center, radius, .. } => {
            let n = (p - center) / radius;
            let turn = n.y.atan2(n.x) / std::f64::consts::TAU;
            DVec2::new(turn.rem_euclid(1.0), n.z.acos() / std::f64::consts::PI)
        }
        Geometry::Disk { center, half_u, half_v } => {
            let s = DVec2::new(
                half_u.dot(p - center) / half_u.length_squared(),
                half_v.dot(p - center) / half_v.length_squared(),
            );
            DVec2::new(s.length(), (s.y.atan2(s.x) / std::f64::consts::TAU).rem_euclid(1.0))
        }
        Geometry::Mesh(_) => unreachable!(),
    };
    let cell = (uv * checker.repeats + checker.offset).map(|v| v.rem_euclid(1.0));
    let near = |v: f64| v.min((v - 0.5).abs()).min(1.0 - v) < EDGE * (1.0 + checker.repeats.max_element());
    if near(cell.x) || near(cell.y) {
        return None;
    }
    Some(if (cell.x > 0.5) == (cell.y > 0.5) { shape.albedo } else { checker.albedo })
}

/// The closest hit of a camera ray, and the shape that is hit.
fn hit(scene: &Scene, camera: &Camera, (i, j): (u32, u32)) -> Option<(DVec3, usize)> {
    let ray = camera.pixel_ray(i, j);
    let distance = |shape: &Shape| match shape.geometry {
        Geometry::Sphere { center, radius, .. } => {
            let to = center - ray.origin;
            let along = to.dot(ray.direction);
            let under = radius * radius - (to - ray.direction * along).length_squared();
            (under > 0.0).then(|| along - under.sqrt())
        }
        Geometry::Rectangle { center, half_u, half_v } => {
            let normal = half_u.cross(half_v);
            let t = (center - ray.origin).dot(normal) / ray.direction.dot(normal);
            let f = ray.origin + ray.direction * t - center;
            let inside = |half: DVec3| f.dot(half).abs() <= half.length_squared();
            (t > 0.0 && inside(half_u) && inside(half_v)).then_some(t)
        }
        Geometry::Disk { center, half_u, half_v } => {
            let t = (center - ray.origin).dot(half_u.cross(half_v)) / ray.direction.dot(half_u.cross(half_v));
            let f = ray.origin + ray.direction * t - center;
            let part = |half: DVec3| f.dot(half) / half.length_squared();
            (t > 0.0 && part(half_u).hypot(part(half_v)) <= 1.0).then_some(t)
        }
        Geometry::Mesh(_) => unreachable!(),
    };
    let hits = scene.shapes.iter().enumerate().filter_map(|(k, shape)| Some((distance(shape)?, k)));
    let (t, k) = hits.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some((ray.origin + ray.direction * t, k))
}

fn check_albedo(scene: &Scene, what: &str) {
    let gpu = device();
    let settings = Settings { spp: 1, estimator: Estimator::Cosine, sampler: Sampler::Pcg, ..Settings::default() };
    let image = render(&gpu, scene, &settings);
    let albedo = image.rgb("albedo").unwrap();
    let (mut second, mut wrong, mut counted) = (0, Vec::new(), 0);
    for (at, pixel) in (0..image.height).flat_map(|j| (0..image.width).map(move |i| (i, j))).enumerate() {
        let Some((p, k)) = hit(scene, &scene.camera, pixel) else { continue };
        let Some(expected) = reflectance(&scene.shapes[k], p) else { continue };
        counted += 1;
        second += u32::from(scene.shapes[k].checker().is_some_and(|c| c.albedo == expected));
        let found = albedo.map(|plane| plane[at]);
        if found != expected.to_array().map(|v| v as f32) {
            wrong.push((pixel, found, expected));
        }
    }
    // A hit at the very edge of a shape may fall on either side.
    assert!(wrong.len() * 500 <= counted, "{what}: {} of {counted} wrong, the first {:?}", wrong.len(), wrong[0]);
    assert!(second > 100, "{what}: {second} pixels show the second reflectance");
}

#[test]
fn checkerboards_lie_where_their_definition_says() {
    let checker = |repeats: (f64, f64), offset: (f64, f64)| {
        let checker = Checker { albedo: DVec3::new(0.1, 0.7, 0.3), repeats: repeats.into(), offset: offset.into() };
        Some(Texture::Checker(checker))
    };
    let walls = [
        Shape {
            texture: checker((3.0, 5.0), (0.2, 0.1)),
            ..rectangle(DVec3::new(-1.2, 0.1, -0.3), DVec3::X, 0.8 * DVec3::Y, 0.6, 0.0)
        },
        // Across no axis.
        Shape {
            texture: checker((4.0, 1e-3), (0.3, 0.0)),
            ..rectangle(DVec3::new(1.2, 0.0, 0.0), DVec3::new(0.6, 0.0, 0.8), DVec3::Y, 0.4, 0.0)
        },
    ];
    let ball = Shape { texture: checker((2.0, 3.0), (0.0, 0.25)), ..sphere([0.0, 0.2, 1.0], 0.7, 0.5, 0.0) };
    let light = sphere([0.0, 4.0, 4.0], 0.5, 0.0, 5.0);
    let disk = Geometry::Disk { center: DVec3::new(0.1, -1.0, 1.5), half_u: 0.7 * DVec3::X, half_v: -0.9 * DVec3::Z };
    let disk = Shape { geometry: disk, texture: checker((2.0, 3.0), (0.1, 0.2)), ..walls[0].clone() };
    let shapes = [walls.to_vec(), vec![disk, ball, light]].concat();
    let camera = look(DVec3::new(0.4, 0.5, 5.0), DVec3::ZERO, 45.0, 96, 80);
    check_albedo(&Scene::new(camera, shapes.clone()), "few shapes");
    // More than are held in registers.
    let far = |i: u32| sphere([f64::from(i), 40.0, -40.0], 0.3, 0.5, 0.0);
    let many = [shapes, (0..20).map(far).collect()].concat();
    let camera = look(DVec3::new(0.4, 0.5, 5.0), DVec3::ZERO, 45.0, 96, 80);
    check_albedo(&Scene::new(camera, many), "many shapes");
}

#[test]
fn rooms_show_their_patterns() {
    let numbers = (0..12).filter(|n| rooms(*n).shapes.iter().any(|s| s.texture.is_some()));
    for n in numbers.take(3) {
        let mut scene = rooms(n);
        (scene.camera.width, scene.camera.height) = (96, 96);
        check_albedo(&scene, &format!("rooms:{n}"));
    }
}
