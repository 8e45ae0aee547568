//! Meshes in files beside the scene: Wavefront OBJ and PLY.

use crate::scene::Mesh;
use crate::{Error, Result};
use glam::{DVec2, DVec3};
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{Header, Property, PropertyAccess, PropertyAccessResult};
use std::io::{BufRead, Cursor};
use std::path::Path;

/// The largest file of a mesh, bytes.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// Reads a file of the kind `obj` or `ply`; nothing of it is checked beyond what reading takes.
pub fn read(path: &Path, kind: &str) -> Result<Mesh> {
    let shown = path.display();
    let metadata = std::fs::metadata(path).map_err(|error| Error::input(format!("{shown}: {error}")))?;
    if !metadata.is_file() || metadata.len() > MAX_FILE_BYTES {
        return Err(Error::input(format!("{shown}: no file of at most {MAX_FILE_BYTES} bytes")));
    }
    let bytes = std::fs::read(path).map_err(|error| Error::io(path, error))?;
    if kind == "obj" { obj(&bytes) } else { ply(&bytes) }.map_err(|error| Error::input(format!("{shown}: {error}")))
}

/// Vertices, normals, texture coordinates and faces of an OBJ file; groups and materials make no difference.
fn obj(bytes: &[u8]) -> Result<Mesh> {
    // Lines that would start a new mesh or name other files are kept from the reader.
    let shapes = |line: &&[u8]| {
        let word = line.trim_ascii_start().split(u8::is_ascii_whitespace).next();
        matches!(word, Some(b"v" | b"vt" | b"vn" | b"f"))
    };
    let lines: Vec<&[u8]> = bytes.split(|&b| b == b'\n').filter(shapes).collect();
    let options = tobj::LoadOptions { single_index: true, triangulate: true, ignore_points: true, ignore_lines: true };
    let no_materials = |_: &Path| Err(tobj::LoadError::OpenFileFailed);
    let (models, _) = tobj::load_obj_buf(&mut Cursor::new(lines.join(&b'\n')), &options, no_materials)
        .map_err(|error| Error::input(format!("no OBJ file that can be read: {error}")))?;
    let Some(mesh) = models.into_iter().next().map(|model| model.mesh) else { return Ok(Mesh::default()) };
    let vectors = |numbers: &[f64]| numbers.as_chunks().0.iter().map(|&v| DVec3::from_array(v)).collect::<Vec<_>>();
    let mesh = Mesh {
        positions: vectors(&mesh.positions),
        triangles: mesh.indices.as_chunks().0.to_vec(),
        normals: vectors(&mesh.normals),
        uvs: mesh.texcoords.as_chunks().0.iter().map(|&v| DVec2::from_array(v)).collect(),
    };
    for (what, count) in [("normal", mesh.normals.len()), ("texture coordinates", mesh.uvs.len())] {
        if count != 0 && count != mesh.positions.len() {
            return Err(Error::input(format!("some corners of faces have a {what}, others not")));
        }
    }
    Ok(mesh)
}

/// A vertex of a PLY file: position, normal, texture coordinates; what the file lacks stays 0.
struct Vertex([f64; 8]);

/// The names of its parts in a file.
const PARTS: [&[&str]; 8] =
    [&["x"], &["y"], &["z"], &["nx"], &["ny"], &["nz"], &["u", "s", "texture_u"], &["v", "t", "texture_v"]];

/// A face of a PLY file.
struct Face(Vec<i64>);

/// The names of its list in a file.
const CORNERS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// What is read past.
struct Other;

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self([0.0; 8])
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let value = match property {
            Property::Float(v) => f64::from(v),
            Property::Double(v) => v,
            _ => return PropertyAccessResult::Ignored,
        };
        let Some(part) = PARTS.iter().position(|names| names.contains(&name)) else {
            return PropertyAccessResult::Ignored;
        };
        self.0[part] = value;
        PropertyAccessResult::Set
    }
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self(Vec::new())
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if !CORNERS.contains(&name) {
            return PropertyAccessResult::Ignored;
        }
        self.0 = match property {
            Property::ListChar(list) => list.into_iter().map(i64::from).collect(),
            Property::ListUChar(list) => list.into_iter().map(i64::from).collect(),
            Property::ListShort(list) => list.into_iter().map(i64::from).collect(),
            Property::ListUShort(list) => list.into_iter().map(i64::from).collect(),
            Property::ListInt(list) => list.into_iter().map(i64::from).collect(),
            Property::ListUInt(list) => list.into_iter().map(i64::from).collect(),
            _ => return PropertyAccessResult::Ignored,
        };
        PropertyAccessResult::Set
    }
}

impl PropertyAccess for Other {
    fn new() -> Self {
        Self
    }

    fn set_property(&mut self, _: &str, _: Property) -> PropertyAccessResult {
        PropertyAccessResult::Ignored
    }
}

/// Vertices and faces of a PLY file, text or binary of either byte order; polygons become fans of triangles.
fn ply(bytes: &[u8]) -> Result<Mesh> {
    let fail = |error: ParseError| Error::input(format!("no PLY file that can be read: {error}"));
    let mut reader = Reader::new(Cursor::new(bytes));
    let header = Parser::<Other>::new().read_header(&mut reader).map_err(fail)?;
    let mut mesh = Mesh::default();
    for (name, element) in &header.elements {
        match name.as_str() {
            "vertex" => {
                let vertices = elements::<Vertex>(&mut reader, name, &header).map_err(fail)?;
                let has = |part: usize| PARTS[part].iter().any(|name| element.properties.contains_key(*name));
                if let Some(part) = (0..3).find(|&part| !has(part)) {
                    return Err(Error::input(format!("its vertices have no '{}'", PARTS[part][0])));
                }
                mesh.positions = vertices.iter().map(|Vertex(v)| DVec3::new(v[0], v[1], v[2])).collect();
                if (3..6).all(has) {
                    mesh.normals = vertices.iter().map(|Vertex(v)| DVec3::new(v[3], v[4], v[5])).collect();
                }
                if (6..8).all(has) {
                    mesh.uvs = vertices.iter().map(|Vertex(v)| DVec2::new(v[6], v[7])).collect();
                }
            }
            "face" => {
                for Face(corners) in elements(&mut reader, name, &header).map_err(fail)? {
                    mesh.triangles.extend(fan(&corners)?);
                }
            }
            _ => drop(elements::<Other>(&mut reader, name, &header).map_err(fail)?),
        }
    }
    Ok(mesh)
}

fn elements<E: PropertyAccess>(
    reader: &mut Reader<impl BufRead>,
    name: &str,
    header: &Header,
) -> std::result::Result<Vec<E>, ParseError> {
    Parser::new().read_payload_for_element(reader, &header.elements[name], header)
}

/// The triangles of a convex polygon.
fn fan(corners: &[i64]) -> Result<impl Iterator<Item = [u32; 3]>> {
    let indices: Option<Vec<u32>> = corners.iter().map(|&i| u32::try_from(i).ok()).collect();
    let indices = indices.ok_or_else(|| Error::input(format!("a face has the vertices {corners:?}")))?;
    Ok((2..indices.len()).map(move |i| [indices[0], indices[i - 1], indices[i]]))
}
