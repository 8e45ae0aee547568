//! Materials, textures and lights without a surface in Mitsuba files: what is read, written and refused.

use glam::{DMat2, DMat3, DVec2, DVec3};
use limpid::image::{Image, exr};
use limpid::scene::mitsuba::{self, Options};
use limpid::scene::{Bsdf, DeltaKind, Environment, Falloff, Filter, Scene, Shape, Texture, Wrap};
use std::path::Path;

const SENSOR: &str = r#"<sensor type="perspective"><float name="fov" value="40"/></sensor>"#;

fn scene_in(folder: &Path, body: &str) -> limpid::Result<Scene> {
    let file = folder.join("scene.xml");
    let xml = format!("<scene version=\"3.0.0\">{SENSOR}\n{body}</scene>");
    Ok(mitsuba::load_str(&xml, &file.display().to_string(), &Options::default())?.scene)
}

fn scene(body: &str) -> limpid::Result<Scene> {
    scene_in(Path::new(""), body)
}

fn sphere(bsdf: &str) -> Shape {
    scene(&format!("<shape type=\"sphere\">{bsdf}</shape>")).expect(bsdf).shapes.remove(0)
}

/// 3x2 texels, PNG and EXR.
fn pictures() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let codes: Vec<u8> = (0..18).map(|i| 12 * i + 7).collect();
    let png = image::RgbImage::from_raw(3, 2, codes).expect("18 numbers");
    png.save(folder.path().join("a.png")).expect("a file");
    for (name, height) in [("sky.exr", 3), ("thin.exr", 2)] {
        let mut image = Image::new(3, height);
        for (k, name) in ["R", "G", "B"].into_iter().enumerate() {
            image.channels.insert(name.into(), (0..3 * height).map(|i| i as f32 * 2.5 + k as f32).collect());
        }
        exr::write(&image, folder.path().join(name)).expect("a file");
    }
    folder
}

#[test]
fn reflection_models() {
    assert_eq!(sphere(r#"<bsdf type="diffuse"/>"#).bsdf, Bsdf::Diffuse);
    let mirror = Bsdf::Conductor { eta: DVec3::ZERO, k: DVec3::ONE, roughness: None };
    assert_eq!(sphere(r#"<bsdf type="conductor"/>"#).bsdf, mirror);
    let gold = sphere(
        r#"<bsdf type="conductor"><string name="material" value="Au"/>
        <rgb name="specular_reflectance" value="0.9,0.8,0.7"/></bsdf>"#,
    );
    let Bsdf::Conductor { eta, k, roughness: None } = gold.bsdf else { panic!("{gold:?}") };
    assert!((eta.x - 0.143).abs() < 1e-3 && (k.x - 3.983).abs() < 1e-3, "{eta} {k}");
    assert_eq!(gold.albedo, DVec3::new(0.9, 0.8, 0.7));
    let rough = sphere(
        r#"<bsdf type="roughconductor"><string name="distribution" value="ggx"/>
        <float name="alpha" value="0.3"/><rgb name="eta" value="1,2,3"/><float name="k" value="4"/></bsdf>"#,
    );
    let expected = Bsdf::Conductor { eta: DVec3::new(1.0, 2.0, 3.0), k: DVec3::splat(4.0), roughness: Some(0.3) };
    assert_eq!(rough.bsdf, expected);
    let glass = sphere(r#"<bsdf type="dielectric"/>"#).bsdf;
    assert_eq!(glass, Bsdf::Dielectric { ior: 1.5046 / 1.000277, transmittance: DVec3::ONE });
    let water = sphere(
        r#"<bsdf type="dielectric"><string name="int_ior" value="Water"/><integer name="ext_ior" value="1"/>
        <rgb name="specular_transmittance" value="1,0.5,0"/></bsdf>"#,
    );
    assert_eq!(water.bsdf, Bsdf::Dielectric { ior: 1.333, transmittance: DVec3::new(1.0, 0.5, 0.0) });
    let plastic = sphere(
        r#"<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.1,0.2,0.3"/>
        <float name="int_ior" value="1.8"/><float name="ext_ior" value="1.2"/><boolean name="nonlinear" value="true"/></bsdf>"#,
    );
    assert_eq!(plastic.albedo, DVec3::new(0.1, 0.2, 0.3));
    assert_eq!(plastic.bsdf, Bsdf::Plastic { ior: 1.8 / 1.2, specular: DVec3::ONE, nonlinear: true });
    let both = sphere(r#"<bsdf type="twosided"><bsdf type="conductor"/></bsdf>"#);
    assert!(both.two_sided && both.bsdf == mirror);
    assert!(!sphere(r#"<bsdf type="conductor"/>"#).two_sided);
}

#[test]
fn bitmaps() {
    let folder = pictures();
    let of = |inside: &str, around: &str, kind: &str| {
        let body = format!(
            r#"<texture type="bitmap" id="t"><string name="filename" value="a.png"/>{inside}</texture>
            <shape type="{kind}"><bsdf type="diffuse"><ref name="reflectance" id="t"/></bsdf>{around}</shape>"#
        );
        match scene_in(folder.path(), &body).expect("a scene").shapes.remove(0).texture {
            Some(Texture::Bitmap(bitmap)) => bitmap,
            other => panic!("{other:?}"),
        }
    };
    let plain = of("", "", "rectangle");
    assert_eq!((plain.matrix, plain.offset), (DMat2::IDENTITY, DVec2::ZERO));
    assert_eq!((plain.wrap, plain.filter), (Wrap::Repeat, Filter::Bilinear));
    assert_eq!((plain.picture.width, plain.picture.height), (3, 2));
    // IEC 61966-2-1 of the codes 7, 19 and 31.
    let linear = |code: f64| {
        let v = code / 255.0;
        if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    };
    for (value, code) in plain.picture.texels[0].into_iter().zip([7.0, 19.0, 31.0]) {
        assert!((f64::from(value) - linear(code)).abs() < 1e-6, "{value} {code}");
    }
    let raw = of(
        r#"<boolean name="raw" value="true"/><string name="filter_type" value="nearest"/>
        <string name="wrap_mode" value="mirror"/><transform name="to_uv"><scale x="2" y="3"/><translate x="0.5"/></transform>"#,
        "",
        "rectangle",
    );
    assert!((raw.picture.texels[0][0] - 7.0 / 255.0).abs() < 1e-7);
    assert_eq!((raw.wrap, raw.filter), (Wrap::Mirror, Filter::Nearest));
    assert_eq!((raw.matrix, raw.offset), (DMat2::from_diagonal(DVec2::new(2.0, 3.0)), DVec2::new(0.5, 0.0)));
    // The texture stays where it was when a shape is turned around: u and v change places on a rectangle, v runs back on a disk.
    let flip = r#"<boolean name="flip_normals" value="true"/>"#;
    assert_eq!(of("", flip, "rectangle").matrix, DMat2::from_cols(DVec2::Y, DVec2::X));
    let disk = of("", flip, "disk");
    assert_eq!((disk.matrix, disk.offset), (DMat2::from_diagonal(DVec2::new(1.0, -1.0)), DVec2::Y));
}

#[test]
fn lights_without_a_surface() {
    let folder = pictures();
    let scene = scene_in(
        folder.path(),
        r#"<emitter type="point" id="bulb"><point name="position" x="1" y="2" z="3"/><rgb name="intensity" value="4,5,6"/></emitter>
        <emitter type="point"><transform name="to_world"><translate x="-1"/></transform></emitter>
        <emitter type="spot"><float name="cutoff_angle" value="40"/>
        <transform name="to_world"><rotate x="1" angle="90"/><translate y="1"/></transform></emitter>
        <emitter type="directional"><vector name="direction" x="3" y="-4" z="0"/><float name="irradiance" value="2"/></emitter>
        <emitter type="envmap"><string name="filename" value="sky.exr"/><float name="scale" value="0.5"/>
        <transform name="to_world"><rotate y="1" angle="90"/><scale value="7"/></transform></emitter>"#,
    )
    .expect("a scene");
    let [bulb, other, spot, sun] = &scene.delta_lights[..] else { panic!("{:?}", scene.delta_lights) };
    assert_eq!((bulb.name.as_str(), bulb.intensity), ("bulb", DVec3::new(4.0, 5.0, 6.0)));
    assert_eq!(bulb.kind, DeltaKind::Point { position: DVec3::new(1.0, 2.0, 3.0) });
    assert_eq!((other.kind, other.intensity), (DeltaKind::Point { position: DVec3::NEG_X }, DVec3::ONE));
    let DeltaKind::Spot { position, direction, beam_degrees, cutoff_degrees, falloff } = spot.kind else {
        panic!("{spot:?}")
    };
    assert_eq!((position, cutoff_degrees, beam_degrees, falloff), (DVec3::Y, 40.0, 30.0, Falloff::Linear));
    assert!(direction.distance(DVec3::NEG_Y) < 1e-15, "{direction}");
    let DeltaKind::Directional { direction } = sun.kind else { panic!("{sun:?}") };
    assert!(direction.distance(DVec3::new(0.6, -0.8, 0.0)) < 1e-15 && sun.intensity == DVec3::splat(2.0), "{sun:?}");
    let Some(Environment::Map(map)) = &scene.environment else { panic!("{:?}", scene.environment) };
    assert_eq!((map.scale, map.picture.texels[4]), (0.5, [10.0, 11.0, 12.0]));
    let turned = DMat3::from_cols(DVec3::NEG_Z, DVec3::Y, DVec3::X);
    assert!(map.to_world.abs_diff_eq(turned, 1e-15), "{}", map.to_world);
    assert!((scene.max_radiance() - 11.0).abs() < 1e-6, "{}", scene.max_radiance());
    let sky = scene_in(folder.path(), r#"<emitter type="constant"><rgb name="radiance" value="1,2,3"/></emitter>"#);
    assert_eq!(sky.expect("a scene").environment, Some(Environment::Constant(DVec3::new(1.0, 2.0, 3.0))));
}

/// Everything written is read back, and scenes that differ in any of it have another hash.
#[test]
fn written_scenes_are_read_back() {
    let folder = pictures();
    let rough = r#"<string name="distribution" value="ggx"/>"#;
    let shapes = [
        r#"<bsdf type="conductor"><string name="material" value="Cu"/></bsdf>"#.to_owned(),
        format!(r#"<bsdf type="twosided"><bsdf type="roughconductor">{rough}<float name="alpha" value="0.17"/></bsdf></bsdf>"#),
        format!(r#"<bsdf type="roughconductor">{rough}<float name="alpha" value="0.18"/></bsdf>"#),
        r#"<bsdf type="dielectric"><string name="ext_ior" value="water"/></bsdf>"#.to_owned(),
        r#"<bsdf type="conductor"><texture type="bitmap" name="specular_reflectance"><string name="filename" value="a.png"/></texture></bsdf>"#.to_owned(),
        r#"<bsdf type="plastic"><rgb name="specular_reflectance" value="0.1,0.2,0.3"/></bsdf>"#.to_owned(),
        r#"<bsdf type="plastic"><texture type="bitmap" name="diffuse_reflectance"><string name="filename" value="a.png"/>
        <string name="wrap_mode" value="clamp"/><transform name="to_uv"><rotate z="1" angle="30"/><scale x="3"/></transform></texture></bsdf>"#.to_owned(),
        r#"<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="a.png"/>
        <boolean name="raw" value="true"/><string name="filter_type" value="nearest"/></texture></bsdf>"#.to_owned(),
    ];
    let mut hashes = std::collections::BTreeSet::new();
    for bsdf in &shapes {
        for emitter in [
            "",
            r#"<emitter type="constant"/><emitter type="directional"><vector name="direction" x="0" y="-1" z="0"/></emitter>"#,
            r#"<emitter type="point"/><emitter type="spot"/><emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>"#,
        ] {
            let scene = scene_in(folder.path(), &format!("<shape type=\"sphere\" id=\"s\">{bsdf}</shape>{emitter}"))
                .expect(bsdf);
            let mut back = mitsuba::load_str(&mitsuba::write(&scene).unwrap(), "other/place.xml", &Options::default())
                .expect(bsdf)
                .scene;
            assert!(hashes.insert(scene.hash()), "{bsdf} {emitter}");
            assert_eq!(back.hash(), scene.hash(), "{bsdf} {emitter}");
            // Names and paths may differ.
            back.delta_lights.iter_mut().zip(&scene.delta_lights).for_each(|(a, b)| a.name.clone_from(&b.name));
            assert_eq!((back.delta_lights, back.camera), (scene.delta_lights, scene.camera));
            assert_eq!(back.shapes[0].bsdf, scene.shapes[0].bsdf);
            assert_eq!(back.shapes[0].two_sided, scene.shapes[0].two_sided);
        }
    }
    assert_eq!(hashes.len(), 3 * shapes.len());
}

#[test]
fn errors_say_what_is_wrong_and_where() {
    let folder = pictures();
    std::fs::write(folder.path().join("broken.png"), &std::fs::read(folder.path().join("a.png")).unwrap()[..40])
        .unwrap();
    std::fs::write(folder.path().join("words.txt"), "no picture").unwrap();
    let texture = |name: &str, more: &str| {
        format!(r#"<texture type="bitmap" id="t"><string name="filename" value="{name}"/>{more}</texture>"#)
    };
    let envmap = |inside: &str| format!(r#"<emitter type="envmap">{inside}</emitter>"#);
    let sky = r#"<string name="filename" value="sky.exr"/>"#;
    for (words, body) in [
        (["none.png", "No such file"], texture("none.png", "")),
        (["broken.png", ""], texture("broken.png", "")),
        (["words.txt", "supported: EXR, PNG, JPEG"], texture("words.txt", "")),
        (["sky.exr", "[0, 1]"], texture("sky.exr", "")),
        (["wrap_mode", "repeat, mirror, clamp"], texture("a.png", r#"<string name="wrap_mode" value="x"/>"#)),
        (["at most 1e4", "bitmap"], texture("a.png", r#"<transform name="to_uv"><scale x="20000"/></transform>"#)),
        (["material \"Xx\"", "Ag, Al"], r#"<bsdf type="conductor"><string name="material" value="Xx"/></bsdf>"#.into()),
        (
            ["beside eta", "conductor"],
            r#"<bsdf type="conductor"><string name="material" value="Ag"/><float name="eta" value="1"/></bsdf>"#.into(),
        ),
        (["beckmann", "ggx"], r#"<bsdf type="roughconductor"/>"#.into()),
        (
            ["alpha is 2", "[0.001, 1]"],
            r#"<bsdf type="roughconductor"><string name="distribution" value="ggx"/><float name="alpha" value="2"/></bsdf>"#.into(),
        ),
        (["int_ior \"milk\"", "water"], r#"<bsdf type="dielectric"><string name="int_ior" value="milk"/></bsdf>"#.into()),
        (["0.1..=10", "refraction"], r#"<bsdf type="plastic"><float name="int_ior" value="0"/></bsdf>"#.into()),
        (["two sides", "dielectric"], r#"<bsdf type="twosided"><bsdf type="dielectric"/></bsdf>"#.into()),
        (["two materials", "twosided"], r#"<bsdf type="twosided"><bsdf type="diffuse"/><bsdf type="diffuse"/></bsdf>"#.into()),
        (["lacks the bsdf", "twosided"], r#"<bsdf type="twosided"/>"#.into()),
        (["no texture has the id 'x'", ""], r#"<bsdf type="diffuse"><ref name="reflectance" id="x"/></bsdf>"#.into()),
        (["must be named reflectance", ""], format!("{}<bsdf type=\"diffuse\"><ref name=\"x\" id=\"t\"/></bsdf>", texture("a.png", ""))),
        (["lacks <string name=\"filename\">", "envmap"], envmap("")),
        (["at least 2x3", "thin.exr"], envmap(&sky.replace("sky", "thin"))),
        (["rotation", "envmap"], envmap(&format!("{sky}<transform name=\"to_world\"><scale x=\"2\"/></transform>"))),
        (["second environment", ""], r#"<emitter type="constant"/><emitter type="constant"/>"#.into()),
        (
            ["position beside to_world", ""],
            r#"<emitter type="point"><point name="position" x="0" y="0" z="0"/><transform name="to_world"/></emitter>"#.into(),
        ),
        (["direction beside to_world", ""], r#"<emitter type="directional"><vector name="direction" x="0" y="0" z="1"/><transform name="to_world"/></emitter>"#.into()),
        (["direction has no length", ""], r#"<emitter type="directional"><vector name="direction" x="0" y="0" z="0"/></emitter>"#.into()),
        (["beam of 15", "under 180"], r#"<emitter type="spot"><float name="cutoff_angle" value="15"/><float name="beam_width" value="15"/></emitter>"#.into()),
        (["radiance [-1.0", ""], r#"<emitter type="point"><float name="intensity" value="-1"/></emitter>"#.into()),
    ] {
        let error = scene_in(folder.path(), &body).expect_err(&body).to_string();
        assert!(error.contains("scene.xml:2: ") && words.iter().all(|word| error.contains(word)), "{words:?}: {error}");
    }
}
