//! The Mitsuba XML loader and writer.

use glam::{DMat3, DMat4, DVec2, DVec3};
use limpid::scene::mitsuba::{self, Options};
use limpid::scene::{Camera, Geometry, Loaded, Scene, Shape, family};
use proptest::prelude::*;

const SENSOR: &str = r#"<sensor type="perspective"><float name="fov" value="40"/></sensor>"#;

fn load(body: &str) -> limpid::Result<Loaded> {
    load_with(body, &Options::default())
}

fn load_with(body: &str, options: &Options) -> limpid::Result<Loaded> {
    mitsuba::load_str(&format!("<scene version=\"3.0.0\">\n{body}\n</scene>"), "test.xml", options)
}

/// The only shape of a scene with this shape and a sensor.
fn shape(xml: &str) -> Shape {
    let mut shapes = load(&format!("{SENSOR}\n{xml}")).unwrap().scene.shapes;
    assert_eq!(shapes.len(), 1);
    shapes.remove(0)
}

fn rectangle(xml: &str) -> (DVec3, DVec3, DVec3) {
    match shape(xml).geometry {
        Geometry::Rectangle { center, half_u, half_v } => (center, half_u, half_v),
        other => panic!("{other:?}"),
    }
}

fn camera(xml: &str) -> Camera {
    load(xml).unwrap().scene.camera
}

#[test]
fn canonical_frame_has_exact_numbers() {
    let loaded = mitsuba::load_str(family::CANONICAL_XML, "c.xml", &Options::default()).unwrap();
    assert_eq!((loaded.spp, loaded.bounces), (Some(16), Some(8)));
    let scene = loaded.scene;
    let eye = DMat4::from_translation(DVec3::new(0.0, 0.0, 3.9));
    assert_eq!(scene.camera, Camera { to_world: eye, fov_x_degrees: 39.3, width: 768, height: 768, lens: None });
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    // Centre, half edges and inward normal of each wall, written down by hand.
    let walls = [
        ("floor", -y, x, -z, y),
        ("ceiling", y, x, z, -y),
        ("back", -z, x, y, z),
        ("left", -x, -z, y, x),
        ("right", x, z, y, -x),
    ];
    for ((name, center, half_u, half_v, normal), shape) in walls.into_iter().zip(&scene.shapes) {
        assert_eq!(shape.name, name);
        assert_eq!(shape.geometry, Geometry::Rectangle { center, half_u, half_v });
        assert_eq!(half_u.cross(half_v), normal);
        assert_eq!(shape.radiance, DVec3::ZERO);
    }
    let (white, red) = (DVec3::new(0.725, 0.71, 0.68), DVec3::new(0.63, 0.065, 0.05));
    let green = DVec3::new(0.14, 0.45, 0.091);
    let albedos = [white, white, white, red, green, DVec3::ZERO, white, red, green, white];
    assert_eq!(scene.shapes.iter().map(|shape| shape.albedo).collect::<Vec<_>>(), albedos);
    let light = Geometry::Sphere { center: DVec3::new(0.1, 0.55, 0.1), radius: 0.2, inward: false };
    assert_eq!((&scene.shapes[5].geometry, scene.shapes[5].radiance), (&light, DVec3::splat(12.0)));
    let small = Geometry::Sphere { center: DVec3::new(-0.45, 0.1, 0.2), radius: 0.2, inward: false };
    assert_eq!((&scene.shapes[9].geometry, scene.shapes[9].radiance), (&small, DVec3::ZERO));
}

#[test]
fn written_scenes_load_bit_for_bit() {
    let mut odd = family::spheres(5);
    odd.camera = Camera::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, DVec3::Y, 51.3, 33, 17).unwrap();
    odd.shapes[0].geometry = Geometry::Rectangle {
        center: DVec3::new(1e-9, 1e12, -3.3),
        half_u: DVec3::new(0.3, 0.4, 0.0),
        half_v: DVec3::new(-4e-7, 3e-7, 1e-3),
    };
    odd.shapes[1].geometry =
        Geometry::Disk { center: DVec3::new(0.1, 0.2, 1e3), half_u: 0.3 * DVec3::Z, half_v: 0.7 * DVec3::X };
    odd.shapes[0].radiance = DVec3::new(1e-20, 0.1 + 0.2, 1e17);
    let frames = [family::frame(3, 17), family::frame(90_000, 239)];
    for scene in (0..50).map(family::spheres).chain(frames).chain([family::canonical(), odd]) {
        let xml = mitsuba::write(&scene).unwrap();
        let loaded = mitsuba::load_str(&xml, "written.xml", &Options::default()).unwrap();
        assert_eq!(loaded.scene, scene);
        assert_eq!(loaded.scene.hash(), scene.hash());
        assert_eq!((loaded.spp, loaded.bounces), (Some(16), Some(8)));
        // Also the sign of every zero.
        assert_eq!(format!("{:?}", loaded.scene), format!("{scene:?}"));
    }
}

#[test]
fn written_names_become_unique_ids() {
    let mut scene = family::canonical();
    for (shape, name) in scene.shapes.iter_mut().zip(["a", "a", "", "$x <\"&>", "a-2"]) {
        shape.name = name.into();
    }
    let loaded = mitsuba::load_str(&mitsuba::write(&scene).unwrap(), "w.xml", &Options::default()).unwrap().scene;
    let names: Vec<_> = loaded.shapes.iter().take(5).map(|shape| shape.name.as_str()).collect();
    assert_eq!(names, ["a", "a-2", "rectangle", "_x_____", "a-2-2"]);
    assert_eq!(loaded.hash(), scene.hash());
}

#[test]
fn parameters_are_substituted() {
    let xml = r#"<default name="a" value="0.25"/><default name="ab" value="3"/>
        <sensor type="perspective"><float name="fov" value="40"/></sensor>
        <shape type="sphere"><point name="center" value="$a,$ab,-$a"/><float name="radius" value="$ab"/></shape>"#;
    let sphere = |options: &Options| load_with(xml, options).unwrap().scene.shapes.remove(0).geometry;
    let expected = Geometry::Sphere { center: DVec3::new(0.25, 3.0, -0.25), radius: 3.0, inward: false };
    assert_eq!(sphere(&Options::default()), expected);
    let set = |name: &str| Options { parameters: [(name.to_owned(), "7".to_owned())].into(), ..Options::default() };
    assert_eq!(
        sphere(&set("ab")),
        Geometry::Sphere { center: DVec3::new(0.25, 7.0, -0.25), radius: 7.0, inward: false }
    );
    let error = load_with(xml, &set("b")).unwrap_err().to_string();
    assert!(error.contains("'b'") && error.contains("a, ab"), "{error}");
    let size = Options { parameters: [("size".to_owned(), "99".to_owned())].into(), ..Options::default() };
    let camera = mitsuba::load_str(family::CANONICAL_XML, "c.xml", &size).unwrap().scene.camera;
    assert_eq!((camera.width, camera.height), (99, 99));
}

#[test]
fn shapes_and_materials() {
    let sphere = shape(r#"<shape type="sphere"/>"#);
    assert_eq!(sphere.geometry, Geometry::Sphere { center: DVec3::ZERO, radius: 1.0, inward: false });
    assert_eq!((sphere.name.as_str(), sphere.albedo, sphere.radiance), ("shape-1", DVec3::splat(0.5), DVec3::ZERO));
    let cavity = shape(r#"<shape type="sphere"><boolean name="flip_normals" value="true"/></shape>"#);
    assert_eq!(cavity.geometry, Geometry::Sphere { center: DVec3::ZERO, radius: 1.0, inward: true });
    let moved = shape(
        r#"<shape type="sphere"><point name="center" x="1" y="0" z="0"/><float name="radius" value="0.5"/>
           <transform name="to_world"><scale value="2"/><rotate z="1" angle="90"/><translate y="3"/></transform>
           <bsdf type="diffuse"><float name="reflectance" value="0.3"/></bsdf>
           <emitter type="area"><float name="radiance" value="4"/></emitter></shape>"#,
    );
    assert_eq!(moved.geometry, Geometry::Sphere { center: DVec3::new(0.0, 5.0, 0.0), radius: 1.0, inward: false });
    assert_eq!((moved.albedo, moved.radiance), (DVec3::splat(0.3), DVec3::splat(4.0)));
    // Without a material an emitter reflects nothing in Mitsuba.
    let lamp = r#"<shape type="rectangle"><emitter type="area"><float name="radiance" value="4"/></emitter></shape>"#;
    assert_eq!(shape(lamp).albedo, DVec3::ZERO);

    assert_eq!(rectangle(r#"<shape type="rectangle"/>"#), (DVec3::ZERO, DVec3::X, DVec3::Y));
    let scaled = r#"<shape type="rectangle"><transform name="to_world"><scale x="2" y="3"/>
        <rotate x="1" angle="-90"/><translate value="1 2 3"/></transform></shape>"#;
    assert_eq!(rectangle(scaled), (DVec3::new(1.0, 2.0, 3.0), 2.0 * DVec3::X, -3.0 * DVec3::Z));
    // Mirrored, the normal stays the image of +z, as in Mitsuba; flip_normals turns it.
    for (attributes, flip, normal) in [("x=\"-1\"", false, 1.0), ("z=\"-1\"", false, -1.0), ("", true, -1.0)] {
        let (_, half_u, half_v) = rectangle(&format!(
            r#"<shape type="rectangle"><boolean name="flip_normals" value="{flip}"/>
               <transform name="to_world"><scale {attributes}/></transform></shape>"#
        ));
        assert_eq!(half_u.cross(half_v), normal * DVec3::Z, "{attributes} {flip}");
    }
    let disk = shape(
        r#"<shape type="disk"><transform name="to_world"><scale x="2" y="3"/><rotate x="1" angle="-90"/>
        <translate value="1 2 3"/></transform></shape>"#,
    );
    let expected =
        Geometry::Disk { center: DVec3::new(1.0, 2.0, 3.0), half_u: 2.0 * DVec3::X, half_v: -3.0 * DVec3::Z };
    assert_eq!(disk.geometry, expected);
    for (attributes, flip, normal) in [("x=\"-1\"", false, 1.0), ("z=\"-1\"", false, -1.0), ("", true, -1.0)] {
        let disk = shape(&format!(
            r#"<shape type="disk"><boolean name="flip_normals" value="{flip}"/>
               <transform name="to_world"><scale {attributes}/></transform></shape>"#
        ));
        let Geometry::Disk { half_u, half_v, .. } = disk.geometry else { panic!("{disk:?}") };
        assert_eq!(half_u.cross(half_v), normal * DVec3::Z, "{attributes} {flip}");
    }
    // References may come before the material, and reach nested ones.
    let shapes = load(&format!(
        r#"{SENSOR}<shape type="sphere"><ref id="m"/></shape>
        <shape type="sphere"><bsdf type="diffuse" id="m"><rgb name="reflectance" value="0.1 0.2 0.3"/></bsdf></shape>"#
    ));
    let shapes = shapes.unwrap().scene.shapes;
    assert!(shapes.iter().all(|shape| shape.albedo == DVec3::new(0.1, 0.2, 0.3)));
}

#[test]
fn checkerboards() {
    let of = |inside: &str, around: &str| {
        let texture = format!(
            r#"<bsdf type="diffuse"><texture type="checkerboard" name="reflectance">{inside}</texture></bsdf>{around}"#
        );
        shape(&format!(r#"<shape type="rectangle">{texture}</shape>"#))
    };
    let plain = of("", "");
    let checker = plain.checker().unwrap();
    assert_eq!((plain.albedo, checker.albedo), (DVec3::splat(0.4), DVec3::splat(0.2)));
    assert_eq!((checker.repeats, checker.offset), (DVec2::ONE, DVec2::ZERO));
    let colors = r#"<rgb name="color0" value="0.1 0.2 0.3"/><rgb name="color1" value="0.4 0.5 0.6"/>
        <transform name="to_uv"><scale x="3" y="5"/><translate x="0.25" y="-0.5"/></transform>"#;
    let colored = of(colors, "");
    let checker = colored.checker().unwrap();
    assert_eq!((colored.albedo, checker.albedo), (DVec3::new(0.1, 0.2, 0.3), DVec3::new(0.4, 0.5, 0.6)));
    assert_eq!((checker.repeats, checker.offset), (DVec2::new(3.0, 5.0), DVec2::new(0.25, -0.5)));
    // Where the normal is turned u and v change places, and with them the cells.
    let flipped = of(colors, r#"<boolean name="flip_normals" value="true"/>"#).checker().unwrap();
    assert_eq!((flipped.repeats, flipped.offset), (DVec2::new(5.0, 3.0), DVec2::new(-0.5, 0.25)));
}

/// The six faces written down by hand: centre, and the world directions of u and v in Mitsuba's cube.
fn faces(turned: bool) -> Vec<Geometry> {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let faces = [(-y, z, x), (y, -x, -z), (x, y, -z), (z, y, x), (-x, y, z), (-z, -y, x)];
    let face = |(center, u, v): (DVec3, DVec3, DVec3)| {
        let (half_u, half_v) = if turned { (u, v) } else { (v, u) };
        assert_eq!(half_u.cross(half_v), if turned { -center } else { center });
        Geometry::Rectangle { center, half_u, half_v }
    };
    faces.map(face).to_vec()
}

#[test]
fn cubes_are_six_rectangles() {
    let cube = |inside: &str| {
        let texture = r#"<bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
            <transform name="to_uv"><scale x="3" y="5"/></transform></texture></bsdf>"#;
        load(&format!("{SENSOR}<shape type=\"cube\" id=\"box\">{inside}{texture}</shape>")).unwrap().scene.shapes
    };
    let geometries = |shapes: &[Shape]| shapes.iter().map(|s| s.geometry.clone()).collect::<Vec<_>>();
    let plain = cube("");
    assert_eq!(geometries(&plain), faces(false));
    assert_eq!((plain[0].name.as_str(), plain[5].name.as_str()), ("box-1", "box-6"));
    assert!(plain.iter().all(|shape| shape.checker().unwrap().repeats == DVec2::new(5.0, 3.0)));
    let flipped = cube(r#"<boolean name="flip_normals" value="true"/>"#);
    assert_eq!(geometries(&flipped), faces(true));
    assert!(flipped.iter().all(|shape| shape.checker().unwrap().repeats == DVec2::new(3.0, 5.0)));
    let transform = |inside: &str| format!("<transform name=\"to_world\">{inside}</transform>");
    // Outward still where it is mirrored; also turned and scaled.
    let operations = r#"<scale x="-1" y="2" z="0.5"/><rotate y="1" angle="30"/><translate x="3"/>"#;
    for shape in cube(&transform(operations)) {
        let Geometry::Rectangle { center, half_u, half_v } = shape.geometry else { panic!("{shape:?}") };
        let outward = center - DVec3::new(3.0, 0.0, 0.0);
        assert!(half_u.cross(half_v).normalize().distance(outward.normalize()) < 1e-15, "{shape:?}");
    }
    let sheared = transform(r#"<matrix value="1 0 0 0 0 1 0.1 0 0 0 1 0 0 0 0 1"/>"#);
    let error = load(&format!("{SENSOR}\n<shape type=\"cube\">{sheared}</shape>")).unwrap_err().to_string();
    assert!(error.starts_with("test.xml:3: sheared cube"), "{error}");
}

#[test]
fn checkerboards_on_turned_disks() {
    let of = |attributes: &str| {
        shape(&format!(
            r#"<shape type="disk"><transform name="to_world"><scale {attributes}/></transform>
            <bsdf type="diffuse"><texture type="checkerboard" name="reflectance"><transform name="to_uv">
            <scale x="3" y="5"/><translate x="0.25" y="-0.5"/></transform></texture></bsdf></shape>"#
        ))
        .checker()
        .unwrap()
    };
    let plain = of("x=\"1\"");
    assert_eq!((plain.repeats, plain.offset), (DVec2::new(3.0, 5.0), DVec2::new(0.25, -0.5)));
    // The angle runs the other way: 5 v - 1/2 = -5 (1 - v) + 4.5.
    let turned = of("x=\"-1\"");
    assert_eq!((turned.repeats, turned.offset), (DVec2::new(3.0, -5.0), DVec2::new(0.25, 4.5)));
}

#[test]
fn included_files() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, body: &str| {
        std::fs::write(folder.path().join(name), format!("<scene version=\"3.0.0\">\n{body}\n</scene>")).unwrap();
    };
    let load = |options: &Options| mitsuba::load(folder.path().join("main.xml"), options);
    write(
        "main.xml",
        &format!(
            r#"<default name="r" value="2"/><default name="part" value="parts"/>{SENSOR}<shape type="sphere" id="first"/>
            <include filename="$part.xml"/><shape type="sphere" id="last"><ref id="red"/></shape>"#
        ),
    );
    write(
        "parts.xml",
        r#"<default name="r" value="9"/><default name="s" value="0.5"/><include filename="colours.xml"/>
        <shape type="sphere" id="part"><float name="radius" value="$r"/><point name="center" x="$s" y="0" z="0"/></shape>"#,
    );
    let red = r#"<bsdf type="diffuse" id="red"><rgb name="reflectance" value="1,0,0"/></bsdf>"#;
    write("colours.xml", red);
    let scene = load(&Options::default()).unwrap().scene;
    // In the includes' place, with the parameters of the file that includes.
    assert_eq!(scene.shapes.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["first", "part", "last"]);
    let part = Geometry::Sphere { center: DVec3::new(0.5, 0.0, 0.0), radius: 2.0, inward: false };
    assert_eq!(scene.shapes[1].geometry, part);
    assert_eq!(scene.shapes[2].albedo, DVec3::X);
    let set = Options { parameters: [("s".to_owned(), "7".to_owned())].into(), ..Options::default() };
    let Geometry::Sphere { center, .. } = load(&set).unwrap().scene.shapes[1].geometry else { panic!() };
    assert_eq!(center.x, 7.0);

    let fails = |parts: [&str; 2]| {
        let error = load(&Options::default()).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let error = error.to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    };
    write("colours.xml", &format!("\n{red}\n<shape type=\"sphere\" id=\"part\"/>"));
    fails(["colours.xml:4: ", "id"]);
    write("colours.xml", "\n<bsdf type=\"diffuse\"><float name=\"reflectance\" value=\"2\"/></bsdf>");
    fails(["colours.xml:3: ", "[0, 1]"]);
    write("colours.xml", "<include filename=\"none.xml\"/>");
    fails(["colours.xml:2: ", "none.xml"]);
    write("colours.xml", "<include filename=\"parts.xml\"/>");
    fails(["parts.xml:2: ", "include itself"]);
    write("colours.xml", "<include filename=\"$nope.xml\"/>");
    fails(["colours.xml:2: ", "unknown parameter"]);
    std::fs::write(folder.path().join("colours.xml"), "<bsdf type=\"diffuse\"/>").unwrap();
    fails(["colours.xml:1: ", "<scene>"]);
    std::fs::write(folder.path().join("colours.xml"), "<scene version=\"3.0.0\">\n<a></scene>").unwrap();
    fails(["colours.xml:2: ", "well-formed"]);
    write("colours.xml", "<shape type=\"sphere\"><include filename=\"x.xml\"/></shape>");
    fails(["colours.xml:2: ", "include"]);
}

#[test]
fn lenient_leaves_out_and_names_it() {
    let body = r##"<integrator type="volpath"/>
        <bsdf type="bumpmap" id="a"><bsdf type="diffuse"><float name="reflectance" value="0.25"/></bsdf></bsdf>
        <bsdf type="hair" id="b"/>
        <shape type="sphere" id="one"><ref id="a"/><float name="bumpiness" value="1"/></shape>
        <shape type="sphere" id="two"><ref id="b"/></shape>
        <shape type="sdfgrid" id="none"><bsdf type="diffuse"/></shape>
        <shape type="sphere" id="none-2"><transform name="to_world"><scale x="2"/></transform></shape>
        <shape type="cube" id="none-3"><transform name="to_world"><matrix value="1 1 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform></shape>
        <shape type="rectangle" id="three"><emitter type="projector"/></shape>
        <emitter type="sky"/>
        <medium type="homogeneous"/>"##;
    let strict = load(&format!(
        "{SENSOR}
{body}"
    ))
    .unwrap_err()
    .to_string();
    assert!(strict.starts_with("test.xml:4: ") && strict.contains("bumpmap"), "{strict}");
    let lenient = Options { lenient: true, ..Options::default() };
    let loaded = load_with(
        &format!(
            "{SENSOR}
{body}"
        ),
        &lenient,
    )
    .unwrap();
    let shapes: Vec<_> = loaded.scene.shapes.iter().map(|s| (s.name.as_str(), s.albedo.x)).collect();
    assert_eq!(shapes, [("one", 0.25), ("two", 0.5), ("three", 0.5)]);
    let mut left_out = loaded.left_out;
    left_out.sort();
    let expected = [
        (10, "sheared cube"),
        (11, "projector"),
        (12, "'sky'"),
        (13, "<medium"),
        (3, "volpath"),
        (4, "bumpmap"),
        (5, "hair"),
        (6, "bumpiness"),
        (8, "sdfgrid"),
        (9, "ellipsoid"),
    ];
    assert_eq!(left_out.len(), expected.len(), "{left_out:#?}");
    for (note, (line, word)) in left_out.iter().zip(expected) {
        assert!(note.starts_with(&format!("test.xml:{line}: ")) && note.contains(word), "{note}");
    }
    // What is wrong, not unsupported, is refused all the same.
    for wrong in [
        r#"<shape type="sphere"><float name="radius" value="-1"/></shape>"#,
        r#"<shape type="sphere"><ref id="nope"/></shape>"#,
        r#"<bsdf type="diffuse"><float name="reflectance" value="2"/></bsdf>"#,
    ] {
        assert!(
            load_with(
                &format!(
                    "{SENSOR}
{wrong}"
                ),
                &lenient
            )
            .is_err(),
            "{wrong}"
        );
    }
}

#[test]
fn rotations_follow_the_right_hand() {
    let xml = |axis: &str| {
        format!(r#"<shape type="rectangle"><transform name="to_world"><rotate {axis} angle="30"/></transform></shape>"#)
    };
    for (axis, matrix) in [
        ("x=\"1\"", DMat3::from_rotation_x(30f64.to_radians())),
        ("y=\"1\"", DMat3::from_rotation_y(30f64.to_radians())),
        ("z=\"1\"", DMat3::from_rotation_z(30f64.to_radians())),
        ("x=\"0.6\" z=\"-0.8\"", DMat3::from_axis_angle(DVec3::new(0.6, 0.0, -0.8), 30f64.to_radians())),
    ] {
        let (_, half_u, half_v) = rectangle(&xml(axis));
        assert!(half_u.distance(matrix.x_axis) < 1e-15 && half_v.distance(matrix.y_axis) < 1e-15, "{axis}");
    }
}

#[test]
fn sensors() {
    let sensor = |inside: &str| camera(&format!(r#"<sensor type="perspective">{inside}</sensor>"#));
    let plain = sensor(r#"<float name="fov" value="40"/>"#);
    assert_eq!((plain.width, plain.height, plain.fov_x_degrees), (768, 576, 40.0));
    // Mitsuba's camera without to_world looks along +z with x to the left: limpid's turned about y by 180 degrees.
    assert_eq!(plain.to_world, DMat4::from_diagonal(DVec3::new(-1.0, 1.0, -1.0).extend(1.0)));
    let eye = DVec3::new(1.0, 2.0, 3.0);
    let look = sensor(
        r#"<float name="fov" value="40"/><transform name="to_world">
        <lookat origin="1 2 3" target="0,0,0" up="0, 0, 1"/></transform><float name="near_clip" value="0.1"/>"#,
    );
    let expected = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 40.0, 768, 576).unwrap();
    assert_eq!(look, expected);
    assert!(look.ray(384.0, 288.0).direction.distance(-eye.normalize()) < 1e-15);

    // 20 x 10 pixels: tan of the horizontal half angle is 2 tan(fov/2) for y, 2/sqrt(5) tan(fov/2) for the diagonal.
    let film = r#"<film type="hdrfilm"><integer name="width" value="20"/><integer name="height" value="10"/></film>"#;
    let tangent = |axis: &str| {
        let fov = format!(r#"<float name="fov" value="40"/><string name="fov_axis" value="{axis}"/>{film}"#);
        sensor(&fov).half_extent().0 / 20f64.to_radians().tan()
    };
    for (axis, factor) in [("x", 1.0), ("y", 2.0), ("diagonal", 2.0 / 5f64.sqrt()), ("smaller", 2.0), ("larger", 1.0)] {
        assert!((tangent(axis) - factor).abs() < 1e-14, "{axis}: {} {factor}", tangent(axis));
    }
    // A size from outside changes the aspect before the axis is resolved.
    let fov_y =
        r#"<sensor type="perspective"><float name="fov" value="40"/><string name="fov_axis" value="y"/></sensor>"#;
    let square = load_with(fov_y, &Options { size: Some((8, 8)), ..Options::default() }).unwrap().scene.camera;
    assert!((square.fov_x_degrees - 40.0).abs() < 1e-13);
}

#[test]
fn errors_name_line_and_element() {
    // Every body starts at line 2 of the file; the sensor is line 2 where it is given.
    let cases = [
        (3, "roughplastic", r#"<bsdf type="roughplastic" id="a"/>"#),
        (3, "supported: sphere, rectangle", r#"<shape type="cylinder"/>"#),
        (3, "lacks <string name=\"filename\">", "<texture type=\"bitmap\" id=\"x\"/>"),
        (3, "noise", "<texture type=\"noise\" id=\"x\"/>"),
        (4, "<float name=\"radiuss\">", "<shape type=\"sphere\">\n<float name=\"radiuss\" value=\"1\"/></shape>"),
        (4, "<medium", "<shape type=\"sphere\">\n<medium type=\"x\" name=\"interior\"/></shape>"),
        (3, "second <sensor>", r#"<sensor type="perspective"><float name="fov" value="4"/></sensor>"#),
        (4, "second <integrator>", "<integrator type=\"path\"/>\n<integrator type=\"path\"/>"),
        (3, "'direct' is not supported", r#"<integrator type="direct"/>"#),
        (3, "limit", r#"<integrator type="path"><integer name="max_depth" value="-1"/></integrator>"#),
        (3, "hide_emitters", r#"<integrator type="path"><boolean name="hide_emitters" value="true"/></integrator>"#),
        (3, "'nope'", r#"<shape type="sphere"><ref id="nope"/></shape>"#),
        (3, "filename", r#"<bsdf type="diffuse"><texture type="bitmap" name="reflectance"/></bsdf>"#),
        (3, "must be named", r#"<bsdf type="diffuse"><texture type="checkerboard" name="x"/></bsdf>"#),
        (
            4,
            "beside its texture",
            "<bsdf type=\"diffuse\"><float name=\"reflectance\" value=\"1\"/>\n<texture type=\"checkerboard\" name=\"reflectance\"/></bsdf>",
        ),
        (
            3,
            "rotations",
            r#"<bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
            <transform name="to_uv"><rotate z="1" angle="30"/></transform></texture></bsdf>"#,
        ),
        (
            3,
            "at most 1e4",
            r#"<bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
            <transform name="to_uv"><scale x="20000"/></transform></texture></bsdf>"#,
        ),
        (
            3,
            "rotates a sphere",
            r#"<shape type="sphere"><transform name="to_world"><rotate x="1" angle="30"/></transform>
            <bsdf type="diffuse"><texture type="checkerboard" name="reflectance"/></bsdf></shape>"#,
        ),
        (3, "2 materials", r#"<shape type="sphere"><bsdf type="diffuse"/><bsdf type="diffuse"/></shape>"#),
        (
            3,
            "twice",
            r#"<shape type="sphere"><float name="radius" value="1"/><float name="radius" value="1"/></shape>"#,
        ),
        (4, "id", "<bsdf type=\"diffuse\" id=\"a\"/>\n<shape type=\"sphere\" id=\"a\"/>"),
        (3, "unknown parameter", r#"<shape type="sphere"><float name="radius" value="$r"/></shape>"#),
        (3, "not a finite number", r#"<shape type="sphere"><float name="radius" value="1x"/></shape>"#),
        (3, "not a finite number", r#"<shape type="sphere"><float name="radius" value="nan"/></shape>"#),
        (3, "lacks the attribute 'z'", r#"<shape type="sphere"><point name="center" x="1" y="0"/></shape>"#),
        (3, "radius", r#"<shape type="sphere"><float name="radius" value="0"/></shape>"#),
        (3, "must be <rgb> or <float>", r#"<bsdf type="diffuse"><integer name="reflectance" value="1"/></bsdf>"#),
        (3, "[0, 1]", r#"<bsdf type="diffuse"><rgb name="reflectance" value="1,1,1.1"/></bsdf>"#),
        (3, "2 numbers", r#"<bsdf type="diffuse"><rgb name="reflectance" value="1,1"/></bsdf>"#),
        (3, "#rrggbb", r##"<bsdf type="diffuse"><rgb name="reflectance" value="#ffffff"/></bsdf>"##),
        (
            3,
            "radiance",
            r#"<shape type="sphere"><emitter type="area"><float name="radiance" value="-1"/></emitter></shape>"#,
        ),
        (3, "radiance", r#"<shape type="sphere"><emitter type="area"/></shape>"#),
        (3, "'point' is not supported", r#"<shape type="sphere"><emitter type="point"/></shape>"#),
        (3, "ellipsoid", r#"<shape type="sphere"><transform name="to_world"><scale x="2"/></transform></shape>"#),
        (3, "mirror", r#"<shape type="sphere"><transform name="to_world"><scale x="-1"/></transform></shape>"#),
        (3, "singular", r#"<shape type="rectangle"><transform name="to_world"><scale y="0"/></transform></shape>"#),
        (
            3,
            "sheared",
            r#"<shape type="rectangle"><transform name="to_world">
            <matrix value="1 1 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform></shape>"#,
        ),
        (
            4,
            "last row",
            "<shape type=\"rectangle\"><transform name=\"to_world\">\n<matrix value=\"1 0 0 0 0 1 0 0 0 0 1 0 1 0 0 1\"/></transform></shape>",
        ),
        (3, "16", r#"<shape type="rectangle"><transform name="to_world"><matrix value="1 0 0"/></transform></shape>"#),
        (3, "<shear>", r#"<shape type="rectangle"><transform name="to_world"><shear/></transform></shape>"#),
        (3, "'angle'", r#"<shape type="rectangle"><transform name="to_world"><rotate x="1"/></transform></shape>"#),
        (3, "axis", r#"<shape type="rectangle"><transform name="to_world"><rotate angle="1"/></transform></shape>"#),
        (
            3,
            "length 2",
            r#"<shape type="rectangle"><transform name="to_world"><rotate x="2" angle="1"/></transform></shape>"#,
        ),
        (3, "'w'", r#"<shape type="rectangle"><transform name="to_world"><translate w="1"/></transform></shape>"#),
        (3, "text", "words"),
        (3, "lacks the attribute 'type'", "<shape/>"),
    ];
    for (line, word, body) in cases {
        let error = load(&format!("{SENSOR}\n{body}")).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let error = error.to_string();
        assert!(error.starts_with(&format!("test.xml:{line}: ")) && error.contains(word), "{word}: {error}");
    }
}

#[test]
fn sensor_and_root_errors() {
    let sensor = |inside: &str| {
        load(&format!("<sensor type=\"perspective\"><float name=\"fov\" value=\"40\"/>\n{inside}</sensor>"))
            .unwrap_err()
            .to_string()
    };
    for (word, inside) in [
        ("box", r#"<film type="hdrfilm"><rfilter type="gaussian"/></film>"#),
        ("hdrfilm", r#"<film type="specfilm"/>"#),
        ("must be 1 to", r#"<film type="hdrfilm"><integer name="width" value="0"/></film>"#),
        ("must be 1 to", r#"<sampler type="independent"><integer name="sample_count" value="0"/></sampler>"#),
        ("too large", r#"<film type="hdrfilm"><integer name="width" value="20000"/></film>"#),
        ("crop_width", r#"<film type="hdrfilm"><integer name="crop_width" value="5"/></film>"#),
        ("fov_axis", r#"<string name="fov_axis" value="z"/>"#),
        ("scale", r#"<transform name="to_world"><scale value="2"/></transform>"#),
        ("mirror", r#"<transform name="to_world"><scale x="-1"/></transform>"#),
        ("parallel", r#"<transform name="to_world"><lookat origin="0 0 0" target="0 1 0" up="0 1 0"/></transform>"#),
    ] {
        let error = sensor(inside);
        assert!(error.starts_with("test.xml:") && error.contains(word), "{word}: {error}");
    }
    let whole = |text: &str| mitsuba::load_str(text, "test.xml", &Options::default()).unwrap_err().to_string();
    for (word, text) in [
        ("no <sensor>", "<scene version=\"3.0.0\"/>"),
        ("<scene>", "<a/>"),
        ("version", "<scene/>"),
        ("0.6.0", "<scene version=\"0.6.0\"/>"),
        ("test.xml:2: not well-formed", "<scene version=\"3.0.0\">\n<a></b></scene>"),
        ("not well-formed", ""),
        ("lacks <float name=\"fov\">", "<scene version=\"3.0.0\"><sensor type=\"perspective\"/></scene>"),
    ] {
        assert!(whole(text).contains(word), "{word}: {}", whole(text));
    }
}

#[test]
fn deep_and_large_files_are_no_crash() {
    for depth in [1_000, 100_000] {
        let text = format!("<scene version=\"3.0.0\">{}{}</scene>", "<bsdf>".repeat(depth), "</bsdf>".repeat(depth));
        assert!(mitsuba::load_str(&text, "deep.xml", &Options::default()).is_err());
    }
}

#[test]
fn files_that_are_no_scene() {
    let folder = tempfile::tempdir().unwrap();
    let error = mitsuba::load(folder.path(), &Options::default()).unwrap_err().to_string();
    assert!(error.contains("directory"), "{error}");
    let path = folder.path().join("x.xml");
    std::fs::write(&path, [0xff, 0xfe, 0x00]).unwrap();
    let error = mitsuba::load(&path, &Options::default()).unwrap_err().to_string();
    assert!(error.contains("x.xml") && error.contains("UTF-8"), "{error}");
    std::fs::write(&path, family::CANONICAL_XML).unwrap();
    assert_eq!(Scene::from_spec(path.to_str().unwrap()).unwrap(), family::canonical());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Pieces of the canonical file cut out, doubled or replaced: an error or a valid scene, never a panic.
    #[test]
    fn mutated_files_never_panic(edits in prop::collection::vec((any::<prop::sample::Index>(), 0..40usize, edit()), 1..4)) {
        let mut text: Vec<char> = family::CANONICAL_XML.chars().collect();
        for (at, length, insert) in edits {
            let at = at.index(text.len());
            let end = (at + length).min(text.len());
            text.splice(at..end, insert.chars());
        }
        let text: String = text.into_iter().collect();
        if let Ok(loaded) = mitsuba::load_str(&text, "mutated.xml", &Options::default()) {
            loaded.scene.validate().unwrap();
            let again = mitsuba::load_str(&mitsuba::write(&loaded.scene).unwrap(), "again.xml", &Options::default()).unwrap();
            prop_assert_eq!(again.scene.hash(), loaded.scene.hash());
        }
    }

    /// Numbers of any size in every place of a transform and of a shape.
    #[test]
    fn odd_numbers_never_panic(numbers in prop::collection::vec(number(), 12)) {
        let n = |i: usize| &numbers[i];
        let body = format!(
            r#"{SENSOR}<shape type="rectangle"><transform name="to_world"><scale x="{}" y="{}" z="{}"/>
            <rotate x="{}" y="{}" z="{}" angle="{}"/><translate x="{}" y="{}"/></transform></shape>
            <shape type="sphere"><float name="radius" value="{}"/><point name="center" x="{}" y="{}" z="0"/></shape>"#,
            n(0), n(1), n(2), n(3), n(4), n(5), n(6), n(7), n(8), n(9), n(10), n(11)
        );
        if let Ok(loaded) = load(&body) {
            loaded.scene.validate().unwrap();
        }
    }
}

fn edit() -> impl Strategy<Value = String> {
    prop_oneof![
        Just(String::new()),
        Just("<scale x=\"1e300\"/>".to_owned()),
        Just("$size".to_owned()),
        Just("$".to_owned()),
        Just("-".to_owned()),
        Just("0".to_owned()),
        Just("e9".to_owned()),
        Just("\"".to_owned()),
        Just("<ref id=\"white\"/>".to_owned()),
        "\\PC{0,6}",
    ]
}

fn number() -> impl Strategy<Value = String> {
    prop_oneof![
        any::<f64>().prop_map(|v| format!("{v:?}")),
        (-2.0..2.0f64).prop_map(|v| v.to_string()),
        Just("0".to_owned()),
        Just("1".to_owned())
    ]
}

/// Those that scripts/mitsuba_agreement.py renders, with every file that they name.
#[test]
fn the_scenes_of_this_folder_load() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/scenes");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let scenes: Vec<_> = files.filter(|path| path.extension().is_some_and(|end| end == "xml")).collect();
    assert_eq!(scenes.len(), 10);
    for path in scenes {
        let loaded = mitsuba::load(&path, &Options::default());
        assert!(loaded.is_ok(), "{}: {:?}", path.display(), loaded.err());
    }
}
