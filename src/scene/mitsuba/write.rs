//! A [`Scene`] as Mitsuba 3 XML.

use super::transform::swap_camera_convention;
use crate::scene::{Checker, Geometry, Scene, Shape};
use glam::{DMat4, DVec3};
use std::collections::BTreeSet;
use std::fmt::Write;

const INTEGRATOR: &str = r#"  <integrator type="path">
    <integer name="max_depth" value="9"/>
    <integer name="rr_depth" value="1000"/>
  </integrator>
"#;

/// The scene as XML that Mitsuba 3 renders to the same picture and that [`super::load_str`] reads back bit for bit
/// (numbers have the shortest digits that identify them). It states 8 bounces and, as the parameters `spp`, `width` and
/// `height`, 16 samples per pixel and the image size. Shape names become unique ids of letters, digits, `_` and `-`.
pub fn write(scene: &Scene) -> String {
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
            line(&mut xml, &format!("    <float name=\"{name}\" value=\"{length:?}\"/>"));
        }
    }
    line(&mut xml, &format!("    <float name=\"fov\" value=\"{:?}\"/>", camera.fov_x_degrees));
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
    scene.shapes.iter().for_each(|shape| write_shape(&mut xml, shape, &mut ids));
    xml + "</scene>\n"
}

fn write_shape(xml: &mut String, shape: &Shape, ids: &mut BTreeSet<String>) {
    let kind = match shape.geometry {
        Geometry::Sphere { .. } => "sphere",
        Geometry::Rectangle { .. } => "rectangle",
        Geometry::Disk { .. } => "disk",
    };
    line(xml, &format!("  <shape type=\"{kind}\" id=\"{}\">", unique_id(&shape.name, kind, ids)));
    match shape.geometry {
        Geometry::Sphere { center, radius, inward } => {
            let [x, y, z] = center.to_array();
            line(xml, &format!("    <point name=\"center\" x=\"{x:?}\" y=\"{y:?}\" z=\"{z:?}\"/>"));
            line(xml, &format!("    <float name=\"radius\" value=\"{radius:?}\"/>"));
            if inward {
                line(xml, "    <boolean name=\"flip_normals\" value=\"true\"/>");
            }
        }
        Geometry::Rectangle { center, half_u, half_v } | Geometry::Disk { center, half_u, half_v } => {
            let normal = half_u.cross(half_v).normalize_or_zero();
            let columns = [half_u, half_v, normal].map(|v| v.extend(0.0));
            let matrix = DMat4::from_cols(columns[0], columns[1], columns[2], center.extend(1.0));
            line(xml, &format!("    {}", to_world(matrix)));
        }
    }
    match shape.checker {
        None => line(xml, &format!("    <bsdf type=\"diffuse\">{}</bsdf>", rgb("reflectance", shape.albedo))),
        Some(checker) => write_checkerboard(xml, shape.albedo, checker),
    }
    if shape.radiance != DVec3::ZERO {
        line(xml, &format!("    <emitter type=\"area\">{}</emitter>", rgb("radiance", shape.radiance)));
    }
    line(xml, "  </shape>");
}

fn write_checkerboard(xml: &mut String, albedo: DVec3, checker: Checker) {
    let Checker { albedo: second, repeats, offset } = checker;
    line(xml, "    <bsdf type=\"diffuse\"><texture type=\"checkerboard\" name=\"reflectance\">");
    line(xml, &format!("      {}{}", rgb("color0", albedo), rgb("color1", second)));
    line(
        xml,
        &format!(
            "      <transform name=\"to_uv\"><scale x=\"{:?}\" y=\"{:?}\"/><translate x=\"{:?}\" y=\"{:?}\"/></transform>",
            repeats.x, repeats.y, offset.x, offset.y
        ),
    );
    line(xml, "    </texture></bsdf>");
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
    let rows: Vec<_> = matrix.transpose().to_cols_array().iter().map(|v| format!("{v:?}")).collect();
    format!("<transform name=\"to_world\"><matrix value=\"{}\"/></transform>", rows.join(" "))
}

fn rgb(name: &str, color: DVec3) -> String {
    let [r, g, b] = color.to_array();
    format!("<rgb name=\"{name}\" value=\"{r:?},{g:?},{b:?}\"/>")
}

fn line(xml: &mut String, text: &str) {
    // Writing to a String cannot fail.
    let _ = writeln!(xml, "{text}");
}
