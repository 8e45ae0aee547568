//! The files beside a scene that is written: meshes as PLY, pictures out of other files as EXR.

use crate::Result;
use crate::image::{Image, exr};
use crate::scene::{Mesh, Picture};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Arc;

/// The files so far, each named after what it is beside.
pub(super) struct Beside {
    stem: String,
    files: Vec<(String, Vec<u8>)>,
    /// Names of what was written, by its address: meshes and pictures that shapes share are written once.
    names: BTreeMap<usize, String>,
}

impl Beside {
    pub(super) fn new(stem: &str) -> Self {
        Self { stem: stem.to_owned(), files: Vec::new(), names: BTreeMap::new() }
    }

    pub(super) fn finish(self) -> Vec<(String, Vec<u8>)> {
        self.files
    }

    /// The name of the file of a mesh.
    pub(super) fn mesh(&mut self, mesh: &Arc<Mesh>) -> String {
        self.file(Arc::as_ptr(mesh).addr(), "mesh", "ply", || Ok(ply(mesh))).expect("PLY has no limits")
    }

    /// The name of the file of a picture.
    pub(super) fn picture(&mut self, picture: &Arc<Picture>) -> Result<String> {
        self.file(Arc::as_ptr(picture).addr(), "picture", "exr", || {
            let mut image = Image::new(picture.width, picture.height);
            image.set_rgb("", [0, 1, 2].map(|c| picture.texels.iter().map(|texel| texel[c]).collect()));
            exr::encode(&image)
        })
    }

    fn file(
        &mut self,
        address: usize,
        what: &str,
        extension: &str,
        bytes: impl FnOnce() -> Result<Vec<u8>>,
    ) -> Result<String> {
        if let Some(name) = self.names.get(&address) {
            return Ok(name.clone());
        }
        let name = format!("{}.{what}-{}.{extension}", self.stem, self.files.len());
        self.files.push((name.clone(), bytes()?));
        self.names.insert(address, name.clone());
        Ok(name)
    }
}

/// Binary PLY with numbers of 64 bits.
fn ply(mesh: &Mesh) -> Vec<u8> {
    let names: &[&str] = match (mesh.normals.is_empty(), mesh.uvs.is_empty()) {
        (true, true) => &["x", "y", "z"],
        (true, false) => &["x", "y", "z", "u", "v"],
        (false, true) => &["x", "y", "z", "nx", "ny", "nz"],
        (false, false) => &["x", "y", "z", "nx", "ny", "nz", "u", "v"],
    };
    let mut header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", mesh.positions.len());
    for name in names {
        // Writing to a String cannot fail.
        let _ = writeln!(header, "property double {name}");
    }
    let _ =
        write!(header, "element face {}\nproperty list uchar int vertex_indices\nend_header\n", mesh.triangles.len());
    let mut bytes = header.into_bytes();
    for (i, position) in mesh.positions.iter().enumerate() {
        let mut numbers = position.to_array().to_vec();
        numbers.extend(mesh.normals.get(i).iter().flat_map(|n| n.to_array()));
        numbers.extend(mesh.uvs.get(i).iter().flat_map(|uv| uv.to_array()));
        bytes.extend(numbers.into_iter().flat_map(f64::to_le_bytes));
    }
    for corners in &mesh.triangles {
        bytes.push(3);
        bytes.extend(corners.iter().flat_map(|i| i.to_le_bytes()));
    }
    bytes
}
