//! Meshes in OBJ and PLY files: what is read, what is refused.

use glam::{DVec2, DVec3};
use limpid::scene::mitsuba::{self, Options};
use limpid::scene::{Geometry, Loaded, Mesh};
use proptest::prelude::*;
use std::path::Path;
use tempfile::TempDir;

/// A folder with one mesh file and scenes that name it.
struct Folder(TempDir);

impl Folder {
    fn new(name: &str, bytes: &[u8]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(name), bytes).unwrap();
        Self(folder)
    }

    /// Loads a scene with this shape on line 3.
    fn load(&self, shape: &str, options: &Options) -> limpid::Result<Loaded> {
        let sensor = r#"<sensor type="perspective"><float name="fov" value="40"/></sensor>"#;
        let text = format!("<scene version=\"3.0.0\">\n{sensor}\n{shape}\n</scene>");
        mitsuba::load_str(&text, self.0.path().join("test.xml").to_str().unwrap(), options)
    }

    fn shape(&self, file: &str, inside: &str) -> String {
        let kind = Path::new(file).extension().unwrap().to_str().unwrap();
        format!(r#"<shape type="{kind}"><string name="filename" value="{file}"/>{inside}</shape>"#)
    }

    fn mesh(&self, file: &str, inside: &str) -> Mesh {
        let mut scene = self.load(&self.shape(file, inside), &Options::default()).unwrap().scene;
        match scene.shapes.remove(0).geometry {
            Geometry::Mesh(mesh) => (*mesh).clone(),
            other => panic!("{other:?}"),
        }
    }

    fn error(&self, file: &str, inside: &str) -> String {
        let error = self.load(&self.shape(file, inside), &Options::default()).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    }
}

fn flag(name: &str, value: bool) -> String {
    format!(r#"<boolean name="{name}" value="{value}"/>"#)
}

const OBJ: &str = "# a square and a triangle in two groups
mtllib none.mtl
o first
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 1
vt 0 0
vt 1 0
vt 1 0.25
usemtl none
g a
f 1/1 2/2 3/3
g b
f 1/1 3/3 4/1
";

#[test]
fn obj_files() {
    let folder = Folder::new("a.obj", OBJ.as_bytes());
    let mesh = folder.mesh("a.obj", &flag("face_normals", true));
    let positions = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 1.0)].map(DVec3::from);
    assert_eq!(mesh.positions, positions);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert!(mesh.normals.is_empty());
    // Mitsuba turns the texture coordinates of OBJ files upside down unless it is told otherwise.
    assert_eq!(mesh.uvs, [(0.0, 1.0), (1.0, 1.0), (1.0, 0.75), (0.0, 1.0)].map(DVec2::from));
    let kept = folder.mesh("a.obj", &flag("flip_tex_coords", false));
    assert_eq!(kept.uvs, [(0.0, 0.0), (1.0, 0.0), (1.0, 0.25), (0.0, 0.0)].map(DVec2::from));

    // Without normals of its own: those that Mitsuba 3.9 computes, weighted by angles.
    let mitsuba = [
        (0.37048277, -0.37048277, 0.85175407),
        (0.0, 0.0, 1.0),
        (0.37048277, -0.37048277, 0.85175407),
        (0.57735026, -0.57735026, 0.57735026),
    ];
    let close = |a: &[DVec3], b: &[DVec3]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.distance(*b) < 2e-7);
    assert!(close(&kept.normals, &mitsuba.map(DVec3::from)), "{:?}", kept.normals);
    let flipped = folder.mesh("a.obj", &flag("flip_normals", true));
    assert_eq!(flipped.triangles, [[0, 2, 1], [0, 3, 2]]);
    assert!(close(&flipped.normals, &mitsuba.map(|n| -DVec3::from(n))), "{:?}", flipped.normals);

    let moved = r#"<transform name="to_world"><scale x="-2" y="3"/><translate z="5"/></transform>"#;
    let moved = folder.mesh("a.obj", moved);
    assert_eq!(moved.positions[3], DVec3::new(0.0, 3.0, 6.0));
    // Mirrored, the order of the corners gives the other side, as in Mitsuba.
    assert!(moved.normals[1].distance(DVec3::NEG_Z) < 1e-15, "{:?}", moved.normals);
}

#[test]
fn obj_normals_follow_the_surface() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 1\nvn 0 -0.6 0.8\nf 1//1 2//1 3//1\n";
    let folder = Folder::new("a.obj", text.as_bytes());
    // Scaled by 2 in z and mirrored in x: (0, -0.6, 0.8 / 2), of unit length; not turned by the mirror.
    let inside = r#"<transform name="to_world"><scale x="-1" z="2"/></transform>"#;
    let mesh = folder.mesh("a.obj", inside);
    assert!(mesh.normals.iter().all(|n| n.distance(DVec3::new(0.0, -0.6, 0.4).normalize()) < 1e-15), "{mesh:?}");
}

const PLY_BODY: &str = "element vertex 4
property float x
property double y
property float z
property float u
property float v
property uchar red
element comment 1
property list uchar float numbers
element face 2
property list uchar int vertex_indices
property int flags
end_header
";

fn ply_ascii() -> Vec<u8> {
    let rows = "0 0 0 0 0 7\n1 0 0 1 0 7\n1 1 0 1 0.25 7\n0 1 1 0 0 7\n2 0.5 0.25\n3 0 1 2 9\n4 0 1 2 3 9\n";
    format!("ply\nformat ascii 1.0\ncomment made by hand\n{PLY_BODY}{rows}").into_bytes()
}

fn ply_binary(big: bool) -> Vec<u8> {
    let format = if big { "binary_big_endian" } else { "binary_little_endian" };
    let mut bytes = format!("ply\nformat {format} 1.0\n{PLY_BODY}").into_bytes();
    macro_rules! put {
        ($($value:expr),*) => { $(bytes.extend(if big { $value.to_be_bytes().to_vec() } else { $value.to_le_bytes().to_vec() });)* };
    }
    for (x, y, z, u, v) in
        [(0f32, 0f64, 0f32, 0f32, 0f32), (1., 0., 0., 1., 0.), (1., 1., 0., 1., 0.25), (0., 1., 1., 0., 0.)]
    {
        put!(x, y, z, u, v, 7u8);
    }
    put!(2u8, 0.5f32, 0.25f32);
    put!(3u8, 0i32, 1i32, 2i32, 9i32, 4u8, 0i32, 1i32, 2i32, 3i32, 9i32);
    bytes
}

#[test]
fn ply_files() {
    for (name, bytes) in [("ascii", ply_ascii()), ("little", ply_binary(false)), ("big", ply_binary(true))] {
        let folder = Folder::new("a.ply", &bytes);
        let mesh = folder.mesh("a.ply", &flag("face_normals", true));
        let positions = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 1.0)].map(DVec3::from);
        assert_eq!(mesh.positions, positions, "{name}");
        // A polygon becomes a fan.
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 1, 2], [0, 2, 3]], "{name}");
        assert_eq!(mesh.uvs, [(0.0, 0.0), (1.0, 0.0), (1.0, 0.25), (0.0, 0.0)].map(DVec2::from), "{name}");
        assert_eq!(folder.mesh("a.ply", &flag("flip_tex_coords", true)).uvs[2], DVec2::new(1.0, 0.75), "{name}");
    }
}

#[test]
fn triangles_without_area_are_dropped_and_counted() {
    let text = format!("{OBJ}f 1/1 1/1 2/2\nf 1/1 2/2 2/2\n");
    let folder = Folder::new("a.obj", text.as_bytes());
    let loaded = folder.load(&folder.shape("a.obj", ""), &Options::default()).unwrap();
    let Geometry::Mesh(mesh) = &loaded.scene.shapes[0].geometry else { panic!() };
    assert_eq!(mesh.triangles.len(), 2);
    assert_eq!(loaded.left_out.len(), 1);
    assert!(loaded.left_out[0].contains("test.xml:3: ") && loaded.left_out[0].contains("2 triangles have no area"));
    let folder = Folder::new("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n");
    assert!(folder.error("a.obj", "").contains("0 triangles"));
}

#[test]
fn files_that_are_no_mesh() {
    let obj = |text: &str| Folder::new("a.obj", text.as_bytes()).error("a.obj", "");
    for (text, part) in [
        ("", "0 triangles"),
        ("v 0 0 0\nf 1 2 3\n", "a.obj"),
        ("v 0 0\nf 1 1 1\n", "a.obj"),
        ("v 0 0 x\n", "a.obj"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9\n", "a.obj"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2 3\n", "texture coordinates"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2 3\n", "normal"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 0\nf 1//1 2//1 3//1\n", "normal"),
        ("v 0 0 0\nv 1e300 0 0\nv 0 1 0\nf 1 2 3\n", "vertex"),
        ("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "vertex"),
    ] {
        let error = obj(text);
        assert!(error.contains("test.xml:3: ") && error.contains(part), "{text:?}: {error}");
    }
    let ply = |bytes: &[u8]| Folder::new("a.ply", bytes).error("a.ply", "");
    let whole = ply_ascii();
    for (bytes, part) in [
        (&b""[..], "a.ply"),
        (b"ply\n", "a.ply"),
        (&whole[..whole.len() / 2], "a.ply"),
        (&whole[..whole.len() - 9], "a.ply"),
        (
            b"ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n3 0 1 2\n",
            "vertices",
        ),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n", "'y'"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n", "a.ply"),
    ] {
        let error = ply(bytes);
        assert!(error.contains("test.xml:3: ") && error.contains(part), "{error}");
    }
    let negative = String::from_utf8(whole).unwrap().replace("3 0 1 2 9", "3 0 -1 2 9");
    assert!(ply(negative.as_bytes()).contains("-1"));

    let folder = Folder::new("a.obj", OBJ.as_bytes());
    assert!(folder.error("none.obj", "").contains("none.obj"));
    assert!(folder.error("a.obj", r#"<float name="x" value="1"/>"#).contains("<float name=\"x\">"));
    assert!(folder.error("a.obj", r#"<transform name="to_world"><scale z="0"/></transform>"#).contains("singular"));
    std::fs::create_dir(folder.0.path().join("b.obj")).unwrap();
    assert!(folder.error("b.obj", "").contains("no file"));
    let error = folder.load("<shape type=\"obj\"/>", &Options::default()).unwrap_err().to_string();
    assert!(error.contains("test.xml:3: ") && error.contains("filename"), "{error}");
    let checker = r#"<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"/></bsdf>"#;
    let bare = Folder::new("c.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    assert!(bare.error("c.obj", checker).contains("texture coordinates"));
}

/// Mitsuba takes the interpolated normals of a mesh that emits for its light's: refused, or flat where the user allows it.
#[test]
fn meshes_that_emit_are_flat() {
    let folder = Folder::new("a.obj", OBJ.as_bytes());
    let light = r#"<emitter type="area"><float name="radiance" value="3"/></emitter>"#;
    assert!(folder.error("a.obj", light).contains("face_normals"));
    let flat = format!("{light}{}", flag("face_normals", true));
    assert!(folder.mesh("a.obj", &flat).normals.is_empty());
    let lenient = Options { lenient: true, ..Options::default() };
    let loaded = folder.load(&folder.shape("a.obj", light), &lenient).unwrap();
    let Geometry::Mesh(mesh) = &loaded.scene.shapes[0].geometry else { panic!() };
    assert!(mesh.normals.is_empty() && loaded.left_out[0].contains("face_normals"));
}

#[test]
fn scenes_with_meshes_have_hashes() {
    let folder = Folder::new("a.obj", OBJ.as_bytes());
    let scene = folder.load(&folder.shape("a.obj", ""), &Options::default()).unwrap().scene;
    let changes: [fn(&mut Mesh); 5] = [
        |m| m.positions[1].x = 1.5,
        |m| m.triangles.swap(0, 1),
        |m| m.normals[0] = DVec3::X,
        |m| m.uvs[0].y = 0.5,
        |m| m.normals.clear(),
    ];
    let mut hashes = vec![scene.hash()];
    for change in changes {
        let mut other = scene.clone();
        let Geometry::Mesh(mesh) = &mut other.shapes[0].geometry else { panic!() };
        change(std::sync::Arc::make_mut(mesh));
        hashes.push(other.hash());
    }
    hashes.sort();
    hashes.dedup();
    assert_eq!(hashes.len(), 6);
}

/// Smooth, flat, emitting, with and without texture coordinates: to the last bit. A mesh of two shapes has one file.
#[test]
fn written_meshes_are_read_back() {
    let folder = Folder::new("a.obj", OBJ.as_bytes());
    let light = r#"<emitter type="area"><float name="radiance" value="3"/></emitter>"#;
    let turned = r#"<transform name="to_world"><rotate y="1" angle="40"/><scale x="1" y="2" z="0.3"/></transform>"#;
    let shape = |inside: &str| folder.shape("a.obj", inside);
    let text =
        [turned.to_owned(), flag("face_normals", true), flag("face_normals", true) + light].map(|s| shape(&s)).concat();
    let mut scene = folder.load(&text, &Options::default()).unwrap().scene;
    let copy = scene.shapes[0].clone();
    scene.shapes.push(copy);
    scene.shapes[1].name = "flat".into();
    let Geometry::Mesh(mesh) = &mut scene.shapes[1].geometry else { panic!() };
    std::sync::Arc::make_mut(mesh).uvs.clear();
    let error = mitsuba::write(&scene).unwrap_err().to_string();
    assert!(error.contains("meshes"), "{error}");
    let written = mitsuba::write_files(&scene, "s & t").unwrap();
    let names: Vec<&str> = written.beside.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["s & t.mesh-0.ply", "s & t.mesh-1.ply", "s & t.mesh-2.ply"]);
    for (name, bytes) in &written.beside {
        std::fs::write(folder.0.path().join(name), bytes).unwrap();
    }
    let file = folder.0.path().join("s.xml");
    let back = mitsuba::load_str(&written.xml, file.to_str().unwrap(), &Options::default()).unwrap().scene;
    for (a, b) in scene.shapes.iter().zip(&back.shapes) {
        assert_eq!(a.geometry, b.geometry, "{}", a.name);
    }
    assert_eq!(scene.hash(), back.hash());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    /// Bytes changed, cut out or put in anywhere: an error or a mesh that can be rendered, never a panic.
    #[test]
    fn mutated_meshes_never_panic(
        kind in 0..4usize,
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0..6usize, prop::collection::vec(any::<u8>(), 0..4)), 1..5),
    ) {
        let (name, mut bytes) = match kind {
            0 => ("a.obj", OBJ.as_bytes().to_vec()),
            1 => ("a.ply", ply_ascii()),
            2 => ("a.ply", ply_binary(false)),
            _ => ("a.ply", ply_binary(true)),
        };
        for (at, length, insert) in edits {
            let at = at.index(bytes.len());
            let end = (at + length).min(bytes.len());
            bytes.splice(at..end, insert);
        }
        let folder = Folder::new(name, &bytes);
        if let Ok(loaded) = folder.load(&folder.shape(name, ""), &Options::default()) {
            loaded.scene.validate().unwrap();
        }
    }

    /// Words of an OBJ file in any order.
    #[test]
    fn shuffled_obj_files_never_panic(words in prop::collection::vec(0..WORDS.len(), 0..60)) {
        let text: String = words.into_iter().map(|i| WORDS[i]).collect::<Vec<_>>().join(" ");
        let folder = Folder::new("a.obj", format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n{text}").as_bytes());
        if let Ok(loaded) = folder.load(&folder.shape("a.obj", ""), &Options::default()) {
            loaded.scene.validate().unwrap();
        }
    }
}

const WORDS: [&str; 22] = [
    "\nv",
    "\nvt",
    "\nvn",
    "\nf",
    "\nl",
    "\np",
    "\ng",
    "\n",
    "1",
    "2",
    "3",
    "-1",
    "-2",
    "0",
    "1/1",
    "2/1/1",
    "3//1",
    "1//",
    "1e99",
    "nan",
    "99999999999999999999",
    "é",
];
