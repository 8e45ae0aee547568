//! glTF files: what is read, how materials are taken, and what is refused.

mod render_support;

use glam::{DMat4, DVec2, DVec3};
use limpid::scene::mitsuba::{self, Options};
use limpid::scene::{Bsdf, DeltaKind, Environment, Falloff, Geometry, Loaded, Spec, Texture, Wrap};
use render_support::*;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A square of side 2 in the plane z = 0 as two triangles, with normals and texture coordinates: 4 positions, 4 normals, 4 uv, 6 indices.
fn square_bytes() -> Vec<u8> {
    let positions = [[-1.0f32, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]];
    let floats = positions.into_iter().flatten().chain([0.0, 0.0, 1.0].into_iter().cycle().take(12));
    let uvs = [0.0f32, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0];
    let bytes: Vec<u8> = floats.chain(uvs).flat_map(f32::to_le_bytes).collect();
    [bytes, [0u16, 1, 2, 0, 2, 3].into_iter().flat_map(u16::to_le_bytes).collect()].concat()
}

/// The square with `material`, and nodes after the square's own.
fn document(material: Value, nodes: Vec<Value>) -> Value {
    let view = |offset: usize, length: usize| json!({ "buffer": 0, "byteOffset": offset, "byteLength": length });
    let accessor = |view: usize, kind: &str, count: usize, component: u32| {
        let mut accessor = json!({ "bufferView": view, "componentType": component, "count": count, "type": kind });
        if view == 0 {
            (accessor["min"], accessor["max"]) = (json!([-1, -1, 0]), json!([1, 1, 0]));
        }
        accessor
    };
    let mut all = vec![json!({ "mesh": 0, "name": "square" })];
    all.extend(nodes);
    json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": (0..all.len()).collect::<Vec<_>>() }],
        "nodes": all,
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2 }, "indices": 3, "material": 0 }] }],
        "materials": [material],
        "accessors": [accessor(0, "VEC3", 4, 5126), accessor(1, "VEC3", 4, 5126), accessor(2, "VEC2", 4, 5126), accessor(3, "SCALAR", 6, 5123)],
        "bufferViews": [view(0, 48), view(48, 48), view(96, 32), view(128, 12)],
        "buffers": [{ "uri": "square.bin", "byteLength": 140 }],
        "cameras": [{ "type": "perspective", "perspective": { "yfov": 0.8, "aspectRatio": 1.5, "znear": 0.1 } }],
        "extensions": { "KHR_lights_punctual": { "lights": [
            { "type": "point", "color": [1, 0.5, 0.25], "intensity": 8 },
            { "type": "directional", "intensity": 2 },
            { "type": "spot", "spot": { "innerConeAngle": 0.25, "outerConeAngle": 0.5 } }
        ] } },
        "textures": [{ "source": 0, "sampler": 0 }],
        "samplers": [{ "wrapS": 33648, "wrapT": 33648 }],
        "images": [{ "uri": "a.png" }]
    })
}

fn camera_node() -> Value {
    json!({ "camera": 0, "translation": [0, 0, 4], "scale": [3, 3, 3] })
}

fn light_node(light: u32) -> Value {
    // A quarter turn about x: what looked along -z looks along +y.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    json!({ "name": "lamp", "translation": [1, 2, 3], "rotation": [half, 0, 0, half], "extensions": { "KHR_lights_punctual": { "light": light } } })
}

fn write(document: &Value) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scene.gltf");
    std::fs::write(&path, document.to_string()).expect("a file");
    std::fs::write(folder.path().join("square.bin"), square_bytes()).expect("a file");
    let picture = image::RgbaImage::from_raw(2, 1, vec![255, 0, 55, 255, 10, 255, 99, 0]).expect("two texels");
    picture.save(folder.path().join("a.png")).expect("a file");
    (folder, path)
}

fn load_with(path: &Path, options: &Options) -> limpid::Result<Loaded> {
    path.display().to_string().parse::<Spec>()?.load(options)
}

fn load(document: &Value) -> limpid::Result<Loaded> {
    let (_folder, path) = write(document);
    load_with(&path, &Options::default())
}

#[test]
fn meshes_cameras_and_lights() {
    let mut document = document(json!({}), vec![camera_node(), light_node(0), light_node(1), light_node(2)]);
    // A mirror image, moved: the front stays the front.
    document["nodes"][0]["scale"] = json!([-2, 1, 1]);
    document["nodes"][0]["translation"] = json!([0, 5, 0]);
    let scene = load(&document).expect("a scene").scene;
    let camera = &scene.camera;
    assert_eq!(camera.to_world, DMat4::from_translation(DVec3::Z * 4.0));
    assert_eq!((camera.width, camera.height), (1152, 768));
    assert!(((0.5 * camera.fov_x_degrees).to_radians().tan() - 1.5 * 0.4f64.tan()).abs() < 1e-6);
    let Geometry::Mesh(mesh) = &scene.shapes[0].geometry else { panic!("{:?}", scene.shapes[0]) };
    assert_eq!(mesh.positions[0], DVec3::new(2.0, 4.0, 0.0));
    assert_eq!(mesh.uvs[0], DVec2::Y);
    for &triangle in &mesh.triangles {
        assert_eq!(mesh.cross(triangle), DVec3::Z * 8.0);
    }
    assert!(mesh.normals.iter().all(|n| *n == DVec3::Z));
    let [point, sun, spot] = &scene.delta_lights[..] else { panic!("{:?}", scene.delta_lights) };
    assert_eq!((point.name.as_str(), point.intensity), ("lamp", DVec3::new(8.0, 4.0, 2.0)));
    assert_eq!(point.kind, DeltaKind::Point { position: DVec3::new(1.0, 2.0, 3.0) });
    let DeltaKind::Directional { direction } = sun.kind else { panic!("{sun:?}") };
    assert!(direction.distance(DVec3::Y) < 1e-6 && sun.intensity == DVec3::splat(2.0), "{direction}");
    let DeltaKind::Spot { direction, beam_degrees, cutoff_degrees, falloff, .. } = spot.kind else {
        panic!("{spot:?}")
    };
    assert!(direction.distance(DVec3::Y) < 1e-6 && falloff == Falloff::Squared);
    assert!((beam_degrees - 0.25f64.to_degrees()).abs() < 1e-4 && (cutoff_degrees - 0.5f64.to_degrees()).abs() < 1e-4);
}

#[test]
fn nested_nodes_compose() {
    let mut document = document(
        json!({}),
        vec![json!({ "children": [0], "translation": [0, 0, 7], "scale": [2, 2, 2] }), camera_node()],
    );
    document["scenes"][0]["nodes"] = json!([1, 2]);
    document["nodes"][0]["translation"] = json!([1, 0, 0]);
    let scene = load(&document).expect("a scene").scene;
    let Geometry::Mesh(mesh) = &scene.shapes[0].geometry else { panic!("{:?}", scene.shapes[0]) };
    assert_eq!(mesh.positions[2], DVec3::new(4.0, 2.0, 7.0));
}

#[test]
fn materials() {
    let of = |material: Value| load(&document(material, vec![camera_node()])).expect("a scene").scene.shapes.remove(0);
    let pbr = |metallic: f64, roughness: f64| json!({ "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.25, 0.125, 1], "metallicFactor": metallic, "roughnessFactor": roughness } });
    let color = DVec3::new(0.5, 0.25, 0.125);
    let metal = |roughness| Bsdf::Conductor { eta: DVec3::ZERO, k: DVec3::ONE, roughness };
    let close = |a: f64, b: f64| (a - b).abs() < 1e-6;
    assert_eq!(of(json!({})).albedo, DVec3::ONE);
    let shape = of(pbr(1.0, 0.5));
    let Bsdf::Conductor { roughness: Some(alpha), .. } = shape.bsdf else { panic!("{shape:?}") };
    assert!(close(alpha, 0.25) && shape.albedo == color && !shape.two_sided);
    assert_eq!(of(pbr(1.0, 0.0)).bsdf, metal(None));
    assert_eq!(of(pbr(0.0, 0.9)).bsdf, Bsdf::Diffuse);
    assert_eq!(of(pbr(0.0, 0.05)).bsdf, Bsdf::Plastic { ior: 1.5, specular: DVec3::ONE, nonlinear: false });
    let mut glass = pbr(0.0, 0.0);
    glass["extensions"] =
        json!({ "KHR_materials_transmission": { "transmissionFactor": 1 }, "KHR_materials_ior": { "ior": 1.25 } });
    assert_eq!(of(glass).bsdf, Bsdf::Dielectric { ior: 1.25, transmittance: color });
    let mut lamp = json!({ "doubleSided": true, "emissiveFactor": [1, 0.5, 0.25] });
    lamp["extensions"] = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": 8 } });
    let lamp = of(lamp);
    assert!(lamp.two_sided && lamp.radiance == DVec3::new(8.0, 4.0, 2.0));
    let mut painted = pbr(0.0, 1.0);
    painted["pbrMetallicRoughness"]["baseColorTexture"] =
        json!({ "index": 0, "extensions": { "KHR_texture_transform": { "offset": [0.5, 0], "scale": [2, 3] } } });
    let Some(Texture::Bitmap(bitmap)) = of(painted).texture else { panic!("no picture") };
    assert_eq!((bitmap.wrap, bitmap.offset), (Wrap::Mirror, DVec2::new(0.5, 0.0)));
    assert_eq!(bitmap.matrix * DVec2::ONE, DVec2::new(2.0, 3.0));
    // Codes 255 and 0 are 1 and 0, times the factor.
    assert_eq!(bitmap.picture.texels[0][..2], [0.5, 0.0]);
    assert_eq!(bitmap.picture.texels[1][1], 0.25);
}

/// Mitsuba 3 XML with a mesh and a picture, which a colour has changed, beside it.
#[test]
fn written_as_xml_it_is_the_same_scene() {
    let mut painted = json!({ "pbrMetallicRoughness": { "baseColorFactor": [0.3, 0.7, 0.2, 1], "metallicFactor": 0 } });
    painted["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    let (folder, path) = write(&document(painted, vec![camera_node(), light_node(0), light_node(1)]));
    let scene = load_with(&path, &Options::default()).expect("a scene").scene;
    let written = mitsuba::write_files(&scene, "out").expect("a scene");
    let names: Vec<&str> = written.beside.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["out.mesh-0.ply", "out.picture-1.exr"]);
    for (name, bytes) in &written.beside {
        std::fs::write(folder.path().join(name), bytes).expect("a file");
    }
    let xml = folder.path().join("out.xml");
    std::fs::write(&xml, &written.xml).expect("a file");
    let back = mitsuba::load(&xml, &Options::default()).expect("a scene").scene;
    let Some(Texture::Bitmap(bitmap)) = &back.shapes[0].texture else { panic!("{:?}", back.shapes[0]) };
    let Some(Texture::Bitmap(of_gltf)) = &scene.shapes[0].texture else { panic!("{:?}", scene.shapes[0]) };
    assert_eq!(bitmap.picture.texels, of_gltf.picture.texels);
    assert_eq!((bitmap.matrix, bitmap.offset), (of_gltf.matrix, of_gltf.offset));
    assert_eq!(back.shapes[0].geometry, scene.shapes[0].geometry);
    for (a, b) in back.delta_lights.iter().zip(&scene.delta_lights) {
        assert_eq!((a.kind, a.intensity), (b.kind, b.intensity));
    }
    assert_eq!(back.camera, scene.camera);
    assert_eq!(back.hash(), scene.hash());
}

/// A file with neither is shown as a whole under an even sky, and says so.
#[test]
fn without_camera_and_light() {
    let loaded =
        load(&document(json!({ "pbrMetallicRoughness": { "metallicFactor": 0 } }), Vec::new())).expect("a scene");
    assert_eq!(loaded.scene.environment, Some(Environment::Constant(DVec3::ONE)));
    assert!(loaded.left_out.iter().any(|note| note.contains("no camera")), "{:?}", loaded.left_out);
    assert!(loaded.left_out.iter().any(|note| note.contains("no light")), "{:?}", loaded.left_out);
    let gpu = device();
    let mut scene = loaded.scene;
    (scene.camera.width, scene.camera.height) = (32, 32);
    let image = render(&gpu, &scene, &limpid::render::Settings { spp: 4, ..Default::default() });
    let hits = image.channels["Z"].iter().filter(|z| **z > 0.0).count();
    // All of the square is seen, and does not fill the picture. White under an even sky, it is as bright.
    assert!((100..900).contains(&hits), "{hits}");
    assert!(
        image.channels["R"].iter().all(|v| (v - 1.0).abs() < 1e-3),
        "darkest {:?}",
        image.channels["R"].iter().min_by(|a, b| a.total_cmp(b))
    );
}

#[test]
fn errors_name_the_file_and_what_is_wrong() {
    let fails = |document: Value, words: &[&str]| {
        let error = load(&document).expect_err("refused").to_string();
        assert!(error.contains("scene.gltf") && words.iter().all(|word| error.contains(word)), "{words:?}: {error}");
    };
    let with = |change: &dyn Fn(&mut Value)| {
        let mut all = document(json!({ "name": "paint" }), vec![camera_node(), light_node(2)]);
        change(&mut all);
        all
    };
    fails(with(&|d| d["meshes"][0]["primitives"][0]["mode"] = json!(1)), &["square", "Lines"]);
    fails(
        with(&|d| d["materials"][0]["normalTexture"] = json!({ "index": 0 })),
        &["paint", "normal texture", "--lenient"],
    );
    fails(with(&|d| d["materials"][0]["alphaMode"] = json!("BLEND")), &["paint", "alphaMode"]);
    fails(with(&|d| d["buffers"][0]["uri"] = json!("none.bin")), &[""]);
    fails(with(&|d| d["images"][0]["uri"] = json!("none.png")), &[""]);
    fails(with(&|d| d["accessors"][3]["count"] = json!(600)), &[""]);
    fails(with(&|d| d["bufferViews"][0]["byteOffset"] = json!(100_000)), &[""]);
    fails(with(&|d| d["accessors"][0]["bufferView"] = json!(77)), &[""]);
    fails(with(&|d| d["nodes"][0]["children"] = json!([0])), &["node 0", "own ancestor"]);
    let flat = load(&with(&|d| d["nodes"][0]["scale"] = json!([0, 1, 1]))).expect("a scene");
    assert!(
        flat.scene.shapes.is_empty() && flat.left_out[0].contains("2 triangles without area"),
        "{:?}",
        flat.left_out
    );
    fails(
        with(&|d| {
            d["cameras"][0] =
                json!({ "type": "orthographic", "orthographic": { "xmag": 1, "ymag": 1, "zfar": 2, "znear": 1 } })
        }),
        &["orthographic"],
    );
    fails(
        with(&|d| d["extensions"]["KHR_lights_punctual"]["lights"][2]["spot"]["innerConeAngle"] = json!(0.7)),
        &["lamp", "beam"],
    );
    fails(with(&|d| d["extensionsRequired"] = json!(["KHR_draco_mesh_compression"])), &[""]);
    fails(with(&|d| d["scenes"] = json!([])), &[""]);
    let (folder, path) = write(&json!({}));
    for text in ["", "words", "{", "glTF\u{2}\0\0\0"] {
        std::fs::write(&path, text).expect("a file");
        assert!(load_with(&path, &Options::default()).expect_err(text).to_string().contains("scene.gltf"));
    }
    assert!(
        load_with(&folder.path().join("none.glb"), &Options::default())
            .expect_err("none")
            .to_string()
            .contains("none.glb")
    );
    // Indices beyond the vertices.
    let (folder, path) = write(&with(&|_| {}));
    let mut bytes = square_bytes();
    bytes[128] = 99;
    std::fs::write(folder.path().join("square.bin"), &bytes).expect("a file");
    let error = load_with(&path, &Options::default()).expect_err("refused").to_string();
    assert!(error.contains("square") && error.contains("99"), "{error}");
    // Cut short at every length.
    for length in (0..140).step_by(7) {
        std::fs::write(folder.path().join("square.bin"), &square_bytes()[..length]).expect("a file");
        assert!(load_with(&path, &Options::default()).is_err(), "{length}");
    }
}

#[test]
fn lenient_leaves_out_and_names_it() {
    let mut all = document(json!({ "name": "paint", "normalTexture": { "index": 0 } }), vec![camera_node()]);
    all["materials"][0]["alphaMode"] = json!("MASK");
    let (_folder, path) = write(&all);
    let loaded = load_with(&path, &Options { lenient: true, ..Options::default() }).expect("a scene");
    assert_eq!(loaded.scene.shapes.len(), 1);
    assert_eq!(loaded.left_out.iter().filter(|note| note.contains("paint")).count(), 2, "{:?}", loaded.left_out);
}
