//! A [`Scene`] as Mitsuba 3 XML.

use super::beside::Beside;
use super::transform::swap_camera_convention;
use crate::scene::{
    Bitmap, Bsdf, Checker, DeltaKind, DeltaLight, Environment, Filter, Geometry, Picture, Scene, Shape, Texture, Wrap,
};
use crate::{Error, Result};
use glam::{DMat4, DVec3, DVec4};
use std::collections::BTreeSet;
use std::fmt::Write;

const INTEGRATOR: &str = r#"  <integrator type="path">
    <integer name="max_depth" value="9"/>
    <integer name="rr_depth" value="1000"/>
  </integrator>
"#;

/// The scene as XML that Mitsuba 3 renders to the same picture and that [`super::load_str`] reads back bit for bit
/// (numbers have the shortest digits that identify them). It states 8 bounces and, as the parameters `spp`, `width` and
/// `height`, 16 samples per pixel and the image size. Shape names become unique ids of letters, digits, `_` and `-`. Scenes with
/// meshes or with pictures out of glTF files are refused: see [`write_files`].
pub fn write(scene: &Scene) -> Result<String> {
    let written = write_files(scene, "scene")?;
    match written.beside.first() {
        None => Ok(written.xml),
        Some((name, _)) => {
            Err(Error::input(format!("the scene has meshes or pictures for files of their own ({name})")))
        }
    }
}

/// A scene as XML and what it names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// The scene.
    pub xml: String,
    /// Names and bytes of files in the same folder.
    pub beside: Vec<(String, Vec<u8>)>,
}

/// The same with a file for each mesh, as binary PLY, and for each picture that was not read from one of its own, as EXR; their
/// names begin with `stem`.
pub fn write_files(scene: &Scene, stem: &str) -> Result<Written> {
    let mut beside = Beside::new(stem);
    let camera = &scene.camera;
    let mut xml = String::from("<scene version=\"3.0.0\">\n");
    for (name, value) in [("spp", 16), ("width", camera.width), ("height", camera.height)] {
        line(&mut xml, &format!("  <default name=\"{name}\" value=\"{value}\"/>"));
    }
    xml += INTEGRATOR;
    let kind = if camera.lens.is_some() { "thinlens" } else { "perspective" };
    line(&mut xml, &format!("  <sensor type=\"{kind}\">"));
    if let Some(lens) = camera.lens {
        for (name, length) in [("aperture_radius", lens.aperture_radius), ("focus_distance", lens.focus_distance)] {
            line(&mut xml, &format!("    {}", float(name, length)));
        }
    }
    line(&mut xml, &format!("    {}", float("fov", camera.fov_x_degrees)));
    line(&mut xml, "    <string name=\"fov_axis\" value=\"x\"/>");
    line(&mut xml, &format!("    {}", to_world(swap_camera_convention(camera.to_world))));
    line(&mut xml, "    <film type=\"hdrfilm\">");
    line(&mut xml, "      <integer name=\"width\" value=\"$width\"/>");
    line(&mut xml, "      <integer name=\"height\" value=\"$height\"/>");
    line(&mut xml, "      <rfilter type=\"box\"/>");
    line(&mut xml, "    </film>");
    line(&mut xml, "    <sampler type=\"independent\"><integer name=\"sample_count\" value=\"$spp\"/></sampler>");
    line(&mut xml, "  </sensor>");
    let mut ids = BTreeSet::new();
    for shape in &scene.shapes {
        write_shape(&mut xml, shape, &mut ids, &mut beside)?;
    }
    scene.delta_lights.iter().for_each(|light| write_delta(&mut xml, light, &mut ids));
    scene.environment.iter().for_each(|environment| write_environment(&mut xml, environment));
    Ok(Written { xml: xml + "</scene>\n", beside: beside.finish() })
}

fn write_shape(xml: &mut String, shape: &Shape, ids: &mut BTreeSet<String>, beside: &mut Beside) -> Result<()> {
    let kind = match &shape.geometry {
        Geometry::Sphere { .. } => "sphere",
        Geometry::Rectangle { .. } => "rectangle",
        Geometry::Disk { .. } => "disk",
        Geometry::Mesh(_) => "ply",
    };
    line(xml, &format!("  <shape type=\"{kind}\" id=\"{}\">", unique_id(&shape.name, kind, ids)));
    match &shape.geometry {
        &Geometry::Sphere { center, radius, inward } => {
            line(xml, &format!("    {}", triple("point", "center", center)));
            line(xml, &format!("    {}", float("radius", radius)));
            if inward {
                line(xml, "    <boolean name=\"flip_normals\" value=\"true\"/>");
            }
        }
        &Geometry::Rectangle { center, half_u, half_v } | &Geometry::Disk { center, half_u, half_v } => {
            let normal = half_u.cross(half_v).normalize_or_zero();
            let columns = [half_u, half_v, normal].map(|v| v.extend(0.0));
            let matrix = DMat4::from_cols(columns[0], columns[1], columns[2], center.extend(1.0));
            line(xml, &format!("    {}", to_world(matrix)));
        }
        Geometry::Mesh(mesh) => {
            line(xml, &format!("    {}", file_beside(&beside.mesh(mesh))));
            if mesh.normals.is_empty() {
                line(xml, "    <boolean name=\"face_normals\" value=\"true\"/>");
            }
        }
    }
    let bsdf = bsdf(shape, beside)?;
    line(
        xml,
        &if shape.two_sided { format!("    <bsdf type=\"twosided\">{bsdf}</bsdf>") } else { format!("    {bsdf}") },
    );
    if shape.radiance != DVec3::ZERO {
        line(xml, &format!("    <emitter type=\"area\">{}</emitter>", rgb("radiance", shape.radiance)));
    }
    line(xml, "  </shape>");
    Ok(())
}

fn bsdf(shape: &Shape, beside: &mut Beside) -> Result<String> {
    let albedo = shape.albedo;
    Ok(match shape.bsdf {
        Bsdf::Diffuse => format!("<bsdf type=\"diffuse\">{}</bsdf>", reflectance("reflectance", shape, beside)?),
        Bsdf::Conductor { eta, k, roughness } => {
            let colors = rgb("eta", eta) + &rgb("k", k) + &reflectance("specular_reflectance", shape, beside)?;
            let (kind, rough) = match roughness {
                None => ("conductor", String::new()),
                Some(alpha) => (
                    "roughconductor",
                    r#"<string name="distribution" value="ggx"/>"#.to_owned() + &float("alpha", alpha),
                ),
            };
            format!("<bsdf type=\"{kind}\">{rough}{colors}</bsdf>")
        }
        Bsdf::Dielectric { ior, transmittance } => {
            let colors = rgb("specular_reflectance", albedo) + &rgb("specular_transmittance", transmittance);
            format!("<bsdf type=\"dielectric\">{}{colors}</bsdf>", relative_ior(ior))
        }
        Bsdf::Plastic { ior, specular, nonlinear } => format!(
            "<bsdf type=\"plastic\">{}<boolean name=\"nonlinear\" value=\"{nonlinear}\"/>{}{}</bsdf>",
            relative_ior(ior),
            rgb("specular_reflectance", specular),
            reflectance("diffuse_reflectance", shape, beside)?
        ),
    })
}

/// Over 1, so that the quotient is read back to the last bit.
fn relative_ior(ior: f64) -> String {
    float("int_ior", ior) + &float("ext_ior", 1.0)
}

fn reflectance(name: &str, shape: &Shape, beside: &mut Beside) -> Result<String> {
    Ok(match &shape.texture {
        None => rgb(name, shape.albedo),
        Some(Texture::Checker(checker)) => checkerboard(name, shape.albedo, *checker),
        Some(Texture::Bitmap(map)) => bitmap(name, map, beside)?,
    })
}

fn checkerboard(name: &str, albedo: DVec3, checker: Checker) -> String {
    let Checker { albedo: second, repeats, offset } = checker;
    format!(
        "<texture type=\"checkerboard\" name=\"{name}\">\n      {}{}\n      <transform name=\"to_uv\"><scale x=\"{:?}\" y=\"{:?}\"/><translate x=\"{:?}\" y=\"{:?}\"/></transform>\n    </texture>",
        rgb("color0", albedo),
        rgb("color1", second),
        repeats.x,
        repeats.y,
        offset.x,
        offset.y
    )
}

fn bitmap(name: &str, map: &Bitmap, beside: &mut Beside) -> Result<String> {
    let (x, y) = (map.matrix.x_axis, map.matrix.y_axis);
    let to_uv = DMat4::from_cols(
        DVec4::new(x.x, x.y, 0.0, 0.0),
        DVec4::new(y.x, y.y, 0.0, 0.0),
        DVec4::Z,
        DVec4::new(map.offset.x, map.offset.y, 0.0, 1.0),
    );
    let filter = match map.filter {
        Filter::Bilinear => "bilinear",
        Filter::Nearest => "nearest",
    };
    let wrap = match map.wrap {
        Wrap::Repeat => "repeat",
        Wrap::Mirror => "mirror",
        Wrap::Clamp => "clamp",
    };
    let picture = &map.picture;
    // Those of glTF files have been multiplied by a colour.
    let (file, raw) = if picture.has_file {
        (filename(picture), picture.raw)
    } else {
        (file_beside(&beside.picture(picture)?), true)
    };
    Ok(format!(
        "<texture type=\"bitmap\" name=\"{name}\">\n      {}<boolean name=\"raw\" value=\"{}\"/><string name=\"filter_type\" value=\"{filter}\"/><string name=\"wrap_mode\" value=\"{wrap}\"/>\n      {}\n    </texture>",
        file,
        raw,
        transform("to_uv", to_uv)
    ))
}

/// The fading of glTF's spot lights, which Mitsuba does not have, becomes Mitsuba's.
fn write_delta(xml: &mut String, light: &DeltaLight, ids: &mut BTreeSet<String>) {
    let (kind, color, place) = match light.kind {
        DeltaKind::Point { position } => ("point", "intensity", triple("point", "position", position)),
        DeltaKind::Spot { position, direction, beam_degrees, cutoff_degrees, .. } => {
            let (x, y) = direction.any_orthonormal_pair();
            let matrix = DMat4::from_cols(x.extend(0.0), y.extend(0.0), direction.extend(0.0), position.extend(1.0));
            let angles = float("cutoff_angle", cutoff_degrees) + &float("beam_width", beam_degrees);
            ("spot", "intensity", to_world(matrix) + &angles)
        }
        DeltaKind::Directional { direction } => ("directional", "irradiance", triple("vector", "direction", direction)),
    };
    let id = unique_id(&light.name, kind, ids);
    line(xml, &format!("  <emitter type=\"{kind}\" id=\"{id}\">{place}{}</emitter>", rgb(color, light.intensity)));
}

fn triple(tag: &str, name: &str, v: DVec3) -> String {
    let [x, y, z] = v.to_array();
    format!("<{tag} name=\"{name}\" x=\"{x:?}\" y=\"{y:?}\" z=\"{z:?}\"/>")
}

fn write_environment(xml: &mut String, environment: &Environment) {
    let text = match environment {
        Environment::Constant(radiance) => {
            format!("  <emitter type=\"constant\">{}</emitter>", rgb("radiance", *radiance))
        }
        Environment::Map(map) => format!(
            "  <emitter type=\"envmap\">{}{}{}</emitter>",
            filename(&map.picture),
            float("scale", map.scale),
            to_world(DMat4::from_mat3(map.to_world))
        ),
    };
    line(xml, &text);
}

/// The file that a picture came from, as a full path: the scene may be written elsewhere.
fn filename(picture: &Picture) -> String {
    let path = std::fs::canonicalize(&picture.path).unwrap_or_else(|_| picture.path.clone());
    file_beside(&path.display().to_string())
}

fn file_beside(path: &str) -> String {
    let path = path.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
    format!("<string name=\"filename\" value=\"{path}\"/>")
}

fn float(name: &str, value: f64) -> String {
    format!("<float name=\"{name}\" value=\"{value:?}\"/>")
}

/// A name as an XML id that no earlier shape has.
fn unique_id(name: &str, kind: &str, ids: &mut BTreeSet<String>) -> String {
    let valid = |c: char| if c.is_ascii_alphanumeric() || "_-".contains(c) { c } else { '_' };
    let base: String = if name.is_empty() { kind.to_owned() } else { name.chars().map(valid).collect() };
    let mut id = base.clone();
    let mut copy = 2;
    while !ids.insert(id.clone()) {
        id = format!("{base}-{copy}");
        copy += 1;
    }
    id
}

fn to_world(matrix: DMat4) -> String {
    transform("to_world", matrix)
}

fn transform(name: &str, matrix: DMat4) -> String {
    let rows: Vec<_> = matrix.transpose().to_cols_array().iter().map(|v| format!("{v:?}")).collect();
    format!("<transform name=\"{name}\"><matrix value=\"{}\"/></transform>", rows.join(" "))
}

fn rgb(name: &str, color: DVec3) -> String {
    let [r, g, b] = color.to_array();
    format!("<rgb name=\"{name}\" value=\"{r:?},{g:?},{b:?}\"/>")
}

fn line(xml: &mut String, text: &str) {
    // Writing to a String cannot fail.
    let _ = writeln!(xml, "{text}");
}
