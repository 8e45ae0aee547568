//! Materials, pictures, point lights and environments as the path tracer shows them: against closed forms and quadrature, and light
//! sampling against chance.

mod render_support;

use glam::{DMat2, DMat3, DVec2, DVec3};
use limpid::gpu::Gpu;
use limpid::render::{Estimator, Renderer, Sampler, Settings};
use limpid::scene::{
    Bitmap, Bsdf, DeltaKind, DeltaLight, Environment, EnvironmentMap, Falloff, Filter, Picture, Scene, Shape, Texture,
    Wrap,
};
use render_support::*;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

const WHITE_METAL: Bsdf = Bsdf::Conductor { eta: DVec3::ZERO, k: DVec3::ONE, roughness: None };

fn with(bsdf: Bsdf, shape: Shape) -> Shape {
    Shape { bsdf, ..shape }
}

fn under(sky: f64, scene: Scene) -> Scene {
    Scene { environment: Some(Environment::Constant(DVec3::splat(sky))), ..scene }
}

fn rough(alpha: f64) -> Bsdf {
    Bsdf::Conductor { eta: DVec3::ZERO, k: DVec3::ONE, roughness: Some(alpha) }
}

fn green(gpu: &Gpu, scene: &Scene, settings: &Settings) -> Vec<f64> {
    render(gpu, scene, settings).channels["G"].iter().map(|&v| f64::from(v)).collect()
}

/// A wide plate in the plane z = 0, seen at an angle from its normal through a narrow field of view.
fn plate_at(degrees: f64, (fov, size): (f64, u32), bsdf: Bsdf, albedo: f64) -> Scene {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let plate = with(bsdf, rectangle(DVec3::ZERO, DVec3::X * 1e3, DVec3::Y * 1e3, albedo, 0.0));
    Scene::new(look(DVec3::new(sin, 0.0, cos), DVec3::ZERO, fov, size, size), vec![plate])
}

/// The mean is `expected` within the noise and a relative bias; too much noise proves nothing.
fn assert_mean(values: &[f64], expected: f64, bias: f64, what: &str) {
    let (mean, error) = mean_error(values);
    assert!(error < 0.01 * expected, "{what}: {mean} +- {error} proves nothing of {expected}");
    assert!(
        (mean - expected).abs() <= SIGMAS * error + bias * expected,
        "{what}: {mean} +- {error}, expected {expected}"
    );
}

/// What loses no light shows the same radiance as its surroundings, path by path.
#[test]
fn mirrors_and_glass_vanish_in_a_furnace() {
    let gpu = device();
    let glass = Bsdf::Dielectric { ior: 1.5, transmittance: DVec3::ONE };
    let air = Bsdf::Dielectric { ior: 1.0 / 1.5, transmittance: DVec3::ONE };
    let ball = sphere([0.3, 0.1, 0.0], 0.8, 1.0, 0.0);
    let inner = sphere([0.3, 0.1, 0.0], 0.5, 1.0, 0.0);
    for (what, shapes) in [
        ("mirror", vec![with(WHITE_METAL, ball.clone())]),
        ("glass", vec![with(glass, ball.clone())]),
        ("bubble", vec![with(glass, ball.clone()), with(air, inner.clone())]),
        ("mirror in glass", vec![with(glass, ball), with(WHITE_METAL, inner)]),
    ] {
        let camera = look(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, 40.0, 48, 48);
        let scene = under(2.0, Scene::new(camera, shapes));
        for choice in techniques() {
            // A path of 200 reflections inside a ball keeps less than 1e-5 of its light.
            let image = green(&gpu, &scene, &Settings { roulette: u32::MAX, ..settings(8, 200, choice) });
            let wrong = image.iter().filter(|v| (**v / 2.0 - 1.0).abs() > 3e-5).count();
            assert_eq!(wrong, 0, "{what}, {choice:?}");
        }
        // Ended by chance, in the mean.
        let choice = (Estimator::Nee, Sampler::Pcg);
        let values = green(&gpu, &scene, &Settings { roulette: 1, ..settings(64, 200, choice) });
        assert_mean(&values, 2.0, 0.0, what);
    }
}

/// Fresnel's equations for a conductor, by complex numbers as they stand in textbooks.
fn fresnel(cos: f64, eta: f64, k: f64) -> f64 {
    let mul = |a: DVec2, b: DVec2| DVec2::new(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
    let root = |a: DVec2| {
        let r = a.length();
        DVec2::new((0.5 * (r + a.x)).sqrt(), (0.5 * (r - a.x)).sqrt().copysign(a.y))
    };
    let n = DVec2::new(eta, k);
    let n2 = mul(n, n);
    let t = root(n2 - DVec2::X * (1.0 - cos * cos)); // n cos of the refracted ray
    let ratio = |a: DVec2, b: DVec2| a.length_squared() / b.length_squared();
    let (c, nc) = (DVec2::X * cos, n2 * cos);
    0.5 * (ratio(c - t, c + t) + ratio(nc - t, nc + t))
}

#[test]
fn metals_reflect_by_fresnel() {
    let gpu = device();
    for (eta, k) in [(0.2, 3.9), (1.44, 1.6), (4.4, 5.2), (2.0, 0.0)] {
        for degrees in [0.0f64, 40.0, 75.0, 88.0] {
            let cos = degrees.to_radians().cos();
            let metal = Bsdf::Conductor { eta: DVec3::new(9.0, eta, 9.0), k: DVec3::new(9.0, k, 9.0), roughness: None };
            let scene = under(1.0, plate_at(degrees, (0.01, 4), metal, 0.5));
            let (value, _) = mean_error(&green(&gpu, &scene, &settings(1, 1, (Estimator::Nee, Sampler::Pcg))));
            let expected = 0.5 * fresnel(cos, eta, k);
            // At 88 degrees 0.005 degrees of the field of view change the reflectance by some 1e-4, and evenly to both sides.
            assert!((value / expected - 1.0).abs() < 1e-4, "{eta} + {k} i, {degrees}: {value}, expected {expected}");
        }
    }
}

/// Radiance that a rough white metal sends to a direction at this cosine in a furnace of 1, by quadrature over microfacet normals.
fn rough_albedo(cos_o: f64, alpha: f64) -> f64 {
    let masking = |c: f64| 2.0 / (1.0 + (1.0 + alpha * alpha * (1.0 - c * c) / (c * c)).sqrt());
    let o = DVec3::new((1.0 - cos_o * cos_o).sqrt(), 0.0, cos_o);
    let (steps, turns) = (4000, 256);
    let mut sum = 0.0;
    for i in 0..steps {
        // tan = alpha * sqrt(x / (1 - x)) has density D cos.
        let x = (f64::from(i) + 0.5) / f64::from(steps);
        let tan2 = alpha * alpha * x / (1.0 - x);
        let (cos, sin) = (1.0 / (1.0 + tan2).sqrt(), (tan2 / (1.0 + tan2)).sqrt());
        for j in 0..turns {
            let phi = TAU * (f64::from(j) + 0.5) / f64::from(turns);
            let m = DVec3::new(sin * phi.cos(), sin * phi.sin(), cos);
            let cos_m = o.dot(m);
            let wi = 2.0 * cos_m * m - o;
            if cos_m > 0.0 && wi.z > 0.0 {
                sum += masking(cos_o) * masking(wi.z) * cos_m / (cos_o * cos);
            }
        }
    }
    sum / f64::from(steps * turns)
}

#[test]
fn rough_metal_in_a_furnace() {
    let gpu = device();
    for alpha in [0.05, 0.3, 0.9] {
        for degrees in [0.0f64, 45.0, 80.0] {
            let cos = degrees.to_radians().cos();
            let scene = under(1.0, plate_at(degrees, (0.1, 24), rough(alpha), 1.0));
            for choice in techniques() {
                let values = green(&gpu, &scene, &settings(64, 1, choice));
                // 1e-4: the field of view spans 0.1 degrees.
                assert_mean(&values, rough_albedo(cos, alpha), 3e-4, &format!("alpha {alpha}, {degrees}, {choice:?}"));
            }
        }
    }
}

/// A white base under a coating loses nothing where reflection inside is counted; 0.6 %: the fits of its diffuse reflectance.
#[test]
fn white_plastic_in_a_furnace() {
    let gpu = device();
    for ior in [1.3, 1.5, 1.9] {
        for degrees in [0.0f64, 60.0, 85.0] {
            let bsdf = Bsdf::Plastic { ior, specular: DVec3::ONE, nonlinear: true };
            let scene = under(1.0, plate_at(degrees, (0.1, 24), bsdf, 1.0));
            for choice in techniques() {
                assert_mean(
                    &green(&gpu, &scene, &settings(64, 1, choice)),
                    1.0,
                    6e-3,
                    &format!("{ior} {degrees} {choice:?}"),
                );
            }
        }
    }
}

/// One surface between media: what it reflects of the sky and lets pass of a panel behind it.
#[test]
fn one_surface_of_glass() {
    let gpu = device();
    for ior in [1.5, 1.0 / 1.5] {
        for degrees in [0.0f64, 30.0, 60.0, 80.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let glass = Bsdf::Dielectric { ior, transmittance: DVec3::splat(0.5) };
            let mut scene = under(2.0, plate_at(degrees, (0.1, 24), glass, 0.25));
            scene.shapes.push(rectangle(DVec3::NEG_Z * 0.1, DVec3::X * 2e3, DVec3::Y * 2e3, 0.0, 3.0));
            let cos_t = (1.0 - sin * sin / (ior * ior)).max(0.0).sqrt();
            let s = (cos - ior * cos_t) / (cos + ior * cos_t);
            let p = (cos_t - ior * cos) / (cos_t + ior * cos);
            let reflected = 0.5 * (s * s + p * p);
            let expected = 0.25 * 2.0 * reflected + 0.5 * 3.0 * (1.0 - reflected) / (ior * ior);
            for choice in techniques() {
                let what = format!("{ior} {degrees} {choice:?}");
                assert_mean(&green(&gpu, &scene, &settings(256, 2, choice)), expected, 3e-4, &what);
            }
        }
    }
}

/// 8x5 texels, one of them bright.
fn sky() -> EnvironmentMap {
    let texel = |i: u32| {
        let (x, y) = (i % 8, i / 8);
        if (x, y) == (5, 1) { [40.0, 30.0, 20.0] } else { [0.1 * (x + 1) as f32, 0.2 + 0.1 * y as f32, 0.5] }
    };
    let picture = Picture {
        path: "sky".into(),
        has_file: true,
        raw: false,
        width: 8,
        height: 5,
        texels: (0..40).map(texel).collect(),
    };
    let to_world = DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(-0.4);
    EnvironmentMap { picture: Arc::new(picture), scale: 1.5, to_world }
}

/// What the definition says of a direction.
fn seen(map: &EnvironmentMap, d: DVec3) -> DVec3 {
    let m = map.to_world.transpose() * d;
    let (width, height) = (map.picture.width as usize, map.picture.height as usize);
    let x = (m.x.atan2(-m.z) / TAU).rem_euclid(1.0) * width as f64 - 0.5;
    let y = (m.y.clamp(-1.0, 1.0).acos() / PI * (height - 1) as f64).min((height - 1) as f64 - 1e-9);
    let texel = |i: f64, j: f64| {
        let i = i.rem_euclid(width as f64) as usize;
        DVec3::from_array(map.picture.texels[j as usize * width + i].map(f64::from))
    };
    let (i, j) = (x.floor(), y.floor());
    let row = |j: f64| texel(i, j).lerp(texel(i + 1.0, j), x - i);
    map.scale * row(j).lerp(row(j + 1.0), y - j)
}

#[test]
fn the_sky_is_where_its_definition_says() {
    let gpu = device();
    let map = sky();
    for to in [DVec3::X, DVec3::NEG_X, DVec3::new(0.1, 0.9, 0.2), DVec3::new(0.1, -0.9, 0.2), DVec3::Z, DVec3::NEG_Z] {
        let camera = look(DVec3::ZERO, to, 100.0, 64, 64);
        let scene = Scene { environment: Some(Environment::Map(map.clone())), ..Scene::new(camera, Vec::new()) };
        let image = render(&gpu, &scene, &settings(1, 4, (Estimator::Nee, Sampler::Sobol)));
        for i in 0..64 * 64 {
            let expected = seen(&map, scene.camera.pixel_ray(i % 64, i / 64).direction);
            for (k, name) in ["R", "G", "B"].into_iter().enumerate() {
                let value = f64::from(image.channels[name][i as usize]);
                // Texels differ by 60, and f32 places a direction to about 1e-6 of a turn, eight texels: 5e-4.
                assert!((value - expected[k]).abs() < 1e-3, "{to}: {name} {value}, expected {}", expected[k]);
            }
        }
    }
}

/// A patch under the sky reflects the integral over its hemisphere.
#[test]
fn a_patch_under_the_sky() {
    let gpu = device();
    let map = sky();
    for normal in [DVec3::Y, DVec3::new(0.6, 0.0, -0.8), DVec3::NEG_Y] {
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let steps = 1500;
        let mut sum = 0.0;
        for i in 0..steps {
            let x = (f64::from(i) + 0.5) / f64::from(steps);
            for j in 0..steps {
                let phi = TAU * (f64::from(j) + 0.5) / f64::from(steps);
                let d = x.sqrt() * (phi.cos() * tangent + phi.sin() * bitangent) + (1.0 - x).sqrt() * normal;
                sum += seen(&map, d).y;
            }
        }
        let expected = 0.5 * sum / f64::from(steps).powi(2);
        let patch = rectangle(DVec3::ZERO, tangent, normal.cross(tangent), 0.5, 0.0);
        let scene = Scene {
            environment: Some(Environment::Map(map.clone())),
            ..Scene::new(look(normal * 2.0 + tangent * 0.3, DVec3::ZERO, 10.0, 32, 32), vec![patch])
        };
        for choice in techniques() {
            let spp = if choice.0 == Estimator::Nee { 64 } else { 1024 };
            assert_mean(
                &green(&gpu, &scene, &settings(spp, 1, choice)),
                expected,
                2e-4,
                &format!("{normal} {choice:?}"),
            );
        }
    }
}

/// Each kind alone, and two of them together, in closed form, at three scales.
#[test]
fn a_patch_under_lights_without_a_surface() {
    let gpu = device();
    let settings = |spp| settings(spp, 1, (Estimator::Nee, Sampler::Sobol));
    let place = DVec3::new(0.6, 0.8, 0.3);
    let away = -place.normalize();
    // The patch lies 22 degrees off the axis.
    let axis = glam::DQuat::from_axis_angle(away.any_orthonormal_vector(), 22f64.to_radians()) * away;
    let spot = |scale: f64, falloff| DeltaKind::Spot {
        position: place * scale,
        direction: axis,
        beam_degrees: 15.0,
        cutoff_degrees: 30.0,
        falloff,
    };
    let cos = |degrees: f64| degrees.to_radians().cos();
    let squared = ((cos(22.0) - cos(30.0)) / (cos(15.0) - cos(30.0))).powi(2);
    for scale in [1e-6, 1.0, 1e6] {
        let half = 1e-4 * scale;
        let patch = rectangle(DVec3::ZERO, DVec3::Z * half, DVec3::X * half, 0.5, 0.0);
        let camera = look(DVec3::new(0.2, 1.0, 0.1) * half, DVec3::ZERO, 10.0, 16, 16);
        let below = sphere((DVec3::NEG_Y * scale).to_array(), 0.1 * scale, 0.0, 0.0);
        let light = |kind: DeltaKind| {
            let intensity = DVec3::new(1.0, 3.0, 2.0);
            let scale2 = if kind == (DeltaKind::Directional { direction: away }) { 1.0 } else { scale * scale };
            DeltaLight { name: "light".into(), intensity: intensity * scale2, kind }
        };
        let inverse_square = 1.0 / place.length_squared();
        let kinds = [
            (DeltaKind::Point { position: place * scale }, inverse_square),
            (DeltaKind::Directional { direction: away }, 1.0),
            (spot(scale, Falloff::Linear), inverse_square * 8.0 / 15.0),
            (spot(scale, Falloff::Squared), inverse_square * squared),
        ];
        let reflected = 0.5 / PI * 3.0 * -away.y;
        for (kind, factor) in kinds {
            let mut scene = Scene::new(camera.clone(), vec![patch.clone(), below.clone()]);
            scene.delta_lights.push(light(kind));
            for value in green(&gpu, &scene, &settings(2)) {
                // 5e-4: rays start 2e-5 of the scene off the patch, which is no point.
                let expected = reflected * factor;
                assert!((value / expected - 1.0).abs() < 5e-4, "{kind:?}: {value}, expected {expected}");
            }
            // Behind something it is dark.
            scene.shapes.push(sphere((0.5 * place * scale).to_array(), 0.2 * scale, 0.5, 0.0));
            assert!(green(&gpu, &scene, &settings(2)).iter().all(|v| *v == 0.0), "{kind:?}");
        }
        // One at a time, by power; the kinds add up.
        let mut scene = Scene::new(camera.clone(), vec![patch.clone(), below.clone()]);
        scene.delta_lights.extend(kinds.map(|(kind, _)| light(kind)));
        let sum: f64 = kinds.iter().map(|(_, factor)| factor).sum();
        assert_mean(&green(&gpu, &scene, &settings(256)), reflected * sum, 5e-4, &format!("all at scale {scale}"));
    }
    // Beyond the cutoff there is nothing, in the beam there is all.
    for (degrees, factor) in [(31.0, 0.0), (14.0, 1.0)] {
        let direction = glam::DQuat::from_axis_angle(away.any_orthonormal_vector(), f64::to_radians(degrees)) * away;
        for falloff in [Falloff::Linear, Falloff::Squared] {
            let kind =
                DeltaKind::Spot { position: place, direction, beam_degrees: 15.0, cutoff_degrees: 30.0, falloff };
            let patch = rectangle(DVec3::ZERO, DVec3::Z * 1e-4, DVec3::X * 1e-4, 0.5, 0.0);
            let mut scene = Scene::new(look(DVec3::Y * 1e-4, DVec3::ZERO, 10.0, 4, 4), vec![patch]);
            scene.delta_lights.push(DeltaLight { name: "spot".into(), intensity: DVec3::splat(3.0), kind });
            let expected = factor * 0.5 / PI * 3.0 * -away.y / place.length_squared();
            for value in green(&gpu, &scene, &settings(1)) {
                assert!((value - expected).abs() <= 5e-4 * expected, "{degrees}: {value}, expected {expected}");
            }
        }
    }
    let mut scene = cornell(8);
    scene.delta_lights.push(DeltaLight {
        name: "bulb".into(),
        intensity: DVec3::ONE,
        kind: DeltaKind::Point { position: DVec3::ZERO },
    });
    let error = Renderer::new(&gpu, &scene, &Settings { estimator: Estimator::Cosine, ..Settings::default() });
    assert!(error.err().expect("refused").to_string().contains("light without a surface: use nee"));
}

/// Light sampling and its weights show in the mean what bounces alone find: every material under every kind of light.
#[test]
fn light_sampling_shows_what_chance_shows() {
    let gpu = device();
    let floor = || rectangle(DVec3::NEG_Y, DVec3::Z * 3.0, DVec3::X * 3.0, 0.5, 0.0);
    let metal = |alpha| Bsdf::Conductor {
        eta: DVec3::new(0.2, 0.9, 1.1),
        k: DVec3::new(3.9, 2.4, 2.1),
        roughness: Some(alpha),
    };
    let plastic = Bsdf::Plastic { ior: 1.5, specular: DVec3::ONE, nonlinear: false };
    for (name, bsdf) in [("metal 0.15", metal(0.15)), ("metal 0.6", metal(0.6)), ("plastic", plastic)] {
        let lights: [(&str, Scene); 4] = [
            ("sphere", Scene::new(cornell(1).camera, vec![sphere([0.8, 1.0, 0.8], 0.5, 0.0, 6.0)])),
            ("rectangle", Scene::new(cornell(1).camera, vec![rectangle(DVec3::Y * 1.2, DVec3::X, DVec3::Z, 0.0, 4.0)])),
            ("sky", Scene { environment: Some(Environment::Map(sky())), ..Scene::new(cornell(1).camera, Vec::new()) }),
            (
                "all",
                Scene {
                    environment: Some(Environment::Map(sky())),
                    ..Scene::new(
                        cornell(1).camera,
                        vec![
                            sphere([0.8, 1.0, 0.8], 0.3, 0.0, 9.0),
                            rectangle(DVec3::new(-0.8, 1.2, 0.0), DVec3::X * 0.4, DVec3::Z * 0.4, 0.0, 6.0),
                        ],
                    )
                },
            ),
        ];
        for (light, mut scene) in lights {
            scene.camera = look(DVec3::new(0.3, 0.6, 3.0), DVec3::NEG_Y * 0.4, 30.0, 32, 32);
            scene.shapes.extend([with(bsdf, floor()), with(bsdf, sphere([-0.3, -0.5, 0.0], 0.5, 0.7, 0.0))]);
            let means = |estimator, spp| {
                let s = Settings { spp, estimator, bounces: 3, sampler: Sampler::Pcg, ..Settings::default() };
                mean_of_seeds(&gpu, &scene, &s)
            };
            let ((nee, nee_error), (chance, chance_error)) = (means(Estimator::Nee, 64), means(Estimator::Cosine, 256));
            let error = nee_error.hypot(chance_error);
            let what = format!("{name}, {light}: {nee} +- {nee_error}, {chance} +- {chance_error}");
            assert!(error < 0.01 * nee, "{what} proves nothing");
            assert!((nee - chance).abs() < SIGMAS * error, "{what}");
        }
    }
}

/// Turned around, a surface shows its back; with two sides that is its front.
#[test]
fn backs_that_reflect() {
    let gpu = device();
    let of = |half_u: DVec3, half_v: DVec3, two_sided: bool| {
        let plate = Shape { two_sided, ..rectangle(DVec3::new(0.1, 0.2, 0.0), half_u, half_v, 0.5, 0.0) };
        let light = sphere([0.5, 0.4, 2.0], 0.4, 0.0, 5.0);
        let scene = Scene::new(look(DVec3::new(0.3, 0.1, 3.0), DVec3::ZERO, 30.0, 32, 32), vec![light, plate]);
        green(&gpu, &scene, &settings(16, 2, (Estimator::Nee, Sampler::Sobol)))
    };
    let (x, y) = (DVec3::X, DVec3::Y * 0.7);
    let front = of(x, y, false);
    assert!(front.iter().sum::<f64>() > 0.0);
    assert_eq!(of(y, x, false).iter().filter(|v| **v > 0.0).count(), front.iter().filter(|v| **v >= 5.0).count());
    for (a, b) in front.iter().zip(of(y, x, true)) {
        assert!((a - b).abs() <= 1e-5 * a, "{a} {b}");
    }
    // The back of what emits is dark.
    let panel = Shape { two_sided: true, ..rectangle(DVec3::ZERO, y, x, 0.0, 7.0) };
    let scene = Scene::new(look(DVec3::Z * 3.0, DVec3::ZERO, 30.0, 8, 8), vec![panel]);
    assert!(green(&gpu, &scene, &settings(1, 1, (Estimator::Nee, Sampler::Sobol))).iter().all(|v| *v == 0.0));
    // Light outside a sphere does not reach its inside.
    let shell = Shape { two_sided: true, ..sphere([0.0; 3], 1.0, 0.5, 0.0) };
    let shapes = vec![shell, sphere([3.0, 1.0, 0.0], 1.0, 0.0, 9.0)];
    let scene = Scene::new(look(DVec3::X * 0.2, DVec3::Z, 60.0, 16, 16), shapes);
    assert!(green(&gpu, &scene, &settings(8, 4, (Estimator::Nee, Sampler::Sobol))).iter().all(|v| *v == 0.0));
    // The inside of a sphere that has two sides reflects as an inward one does.
    let furnace = |shape: Shape, two_sided| {
        let scene = Scene::new(
            look(DVec3::X * 0.2, DVec3::Z, 60.0, 32, 32),
            vec![Shape { two_sided, ..shape }, sphere([0.0; 3], 0.1, 0.0, 3.0)],
        );
        green(&gpu, &scene, &settings(64, 8, (Estimator::Nee, Sampler::Sobol)))
    };
    let (inward, _) = mean_error(&furnace(cavity(1.0, 0.5, 0.0), false));
    let (inside, error) = mean_error(&furnace(sphere([0.0; 3], 1.0, 0.5, 0.0), true));
    assert!((inside - inward).abs() < SIGMAS * error + 1e-5 * inward && inward > 0.0, "{inside} {inward} {error}");
}

/// The reflectance of the first hit is that of the picture there.
#[test]
fn pictures_lie_where_their_definition_says() {
    let gpu = device();
    let texels: Vec<[f32; 3]> =
        (0..15u32).map(|i| [i as f32 / 15.0, (i * 7 % 15) as f32 / 15.0, (i * 4 % 15) as f32 / 15.0]).collect();
    let picture = Arc::new(Picture { path: "a".into(), has_file: true, raw: true, width: 5, height: 3, texels });
    let (center, half_u, half_v) = (DVec3::new(0.1, -0.2, 0.0), DVec3::X, DVec3::Y * 0.8);
    for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
        for filter in [Filter::Bilinear, Filter::Nearest] {
            let matrix = DMat2::from_angle(0.4) * DMat2::from_diagonal(DVec2::new(3.0, -2.5));
            let bitmap = Bitmap { picture: picture.clone(), matrix, offset: DVec2::new(0.3, -0.7), wrap, filter };
            let plate =
                Shape { texture: Some(Texture::Bitmap(bitmap.clone())), ..rectangle(center, half_u, half_v, 1.0, 0.0) };
            let scene = Scene::new(look(DVec3::Z * 3.0, DVec3::ZERO, 40.0, 64, 64), vec![plate]);
            let image = render(&gpu, &scene, &settings(1, 1, (Estimator::Nee, Sampler::Sobol)));
            let mut compared = 0;
            for i in 0..64 * 64 {
                let ray = scene.camera.pixel_ray(i % 64, i / 64);
                let p = ray.origin - ray.direction * (ray.origin.z / ray.direction.z) - center;
                let s = DVec2::new(p.x / half_u.x, p.y / half_v.y);
                if s.abs().max_element() > 0.999 {
                    continue;
                }
                let Some(expected) = looked_up(&bitmap, 0.5 + 0.5 * s) else { continue };
                compared += 1;
                for (k, name) in ["albedo.R", "albedo.G", "albedo.B"].into_iter().enumerate() {
                    let value = f64::from(image.channels[name][i as usize]);
                    assert!(
                        (value - expected[k]).abs() < 2e-5,
                        "{wrap:?} {filter:?} {name}: {value}, expected {}",
                        expected[k]
                    );
                }
            }
            assert!(compared > 1000, "{compared}");
        }
    }
}

/// None within a rounding of where the nearest texel changes.
fn looked_up(bitmap: &Bitmap, uv: DVec2) -> Option<DVec3> {
    let size = DVec2::new(f64::from(bitmap.picture.width), f64::from(bitmap.picture.height));
    let at = (bitmap.matrix * uv + bitmap.offset) * size;
    let texel = |x: f64, y: f64| {
        let place = |i: f64, n: f64| match bitmap.wrap {
            Wrap::Repeat => i.rem_euclid(n),
            Wrap::Mirror => {
                let i = i.rem_euclid(2.0 * n);
                if i < n { i } else { 2.0 * n - 1.0 - i }
            }
            Wrap::Clamp => i.clamp(0.0, n - 1.0),
        };
        let index = place(y, size.y) as usize * size.x as usize + place(x, size.x) as usize;
        DVec3::from_array(bitmap.picture.texels[index].map(f64::from))
    };
    if bitmap.filter == Filter::Nearest {
        let near = |v: f64| (v - v.round()).abs() < 1e-4;
        let (x, y) = (at.x.floor(), at.y.floor());
        return (!near(at.x) && !near(at.y)).then(|| texel(x, y));
    }
    let (corner, f) = ((at - 0.5).floor(), (at - 0.5) - (at - 0.5).floor());
    let row = |y: f64| texel(corner.x, y).lerp(texel(corner.x + 1.0, y), f.x);
    Some(row(corner.y).lerp(row(corner.y + 1.0), f.y))
}
