//! From elements to a [`Scene`].

use super::Options;
use super::emitter::emitter;
use super::files::Files;
use super::material::Materials;
use super::object::Object;
use super::sensor::sensor;
use super::shape::shapes;
use super::xml::{Context, Element, Source};
use crate::Result;
use crate::scene::{Loaded, Scene};
use std::collections::BTreeSet;

const TOP_LEVEL: &str = "default, include, integrator, sensor, bsdf, texture, shape, emitter";

pub fn load(text: &str, file: &str, options: &Options) -> Result<Loaded> {
    let mut files = Files::read(text, file, options)?;
    let context = Context::new(std::mem::take(&mut files.parameters), options.lenient);
    let documents = files.parse()?;
    let folder = files.folder.clone();
    let source = |(file, document)| Source { file, folder: &folder, document, context: &context };
    let names = files.files.iter().map(|file| file.name.as_str());
    let sources: Vec<_> = names.zip(&documents).map(source).collect();
    check_ids(&sources)?;

    let materials = Materials::read(&sources)?;
    let (mut camera, mut bounces, mut list, mut emitters) = (None, None, Vec::new(), Vec::new());
    for element in files.top_level(&sources, 0)? {
        match element.tag() {
            // Read above.
            "default" | "bsdf" | "texture" => {}
            "emitter" => emitters.push(element),
            "shape" => {
                let name = format!("shape-{}", list.len() + 1);
                list.extend(shapes(element, name, &materials)?);
            }
            "sensor" if camera.is_none() => camera = sensor(element, options)?,
            "integrator" if bounces.is_none() => bounces = Some(integrator(element)?),
            "sensor" | "integrator" => {
                element.unsupported(format!("a second <{}>; limpid renders with one", element.tag()))?;
            }
            _ => element.unsupported(format!("{} is not supported; supported: {TOP_LEVEL}", element.words()))?,
        }
    }
    let root = Element::root(&sources[0]);
    let (camera, spp) =
        camera.ok_or_else(|| root.error("the scene has no <sensor>; add one of type perspective or thinlens"))?;
    let mut scene = Scene::new(camera, list);
    emitters.into_iter().try_for_each(|element| emitter(element, &mut scene))?;
    scene.validate()?;
    drop(sources);
    drop(documents);
    Ok(Loaded { scene, spp, bounces: bounces.flatten(), left_out: context.into_notes() })
}

fn check_ids(sources: &[Source]) -> Result<()> {
    let mut ids = BTreeSet::new();
    for element in sources.iter().flat_map(|source| Element::root(source).descendants()) {
        if element.tag() != "ref"
            && let Some(id) = element.attribute("id")?
            && !ids.insert(id)
        {
            return Err(element.error(format!("the id of {} is given twice", element.words())));
        }
    }
    Ok(())
}

/// The bounce limit, where the file states one.
fn integrator(element: Element) -> Result<Option<u32>> {
    let Some(mut object) = Object::new(element, &["path"])? else { return Ok(None) };
    let depth = object.integer("max_depth")?;
    object.pass_over("rr_depth");
    if object.boolean("hide_emitters")? == Some(true) {
        element.unsupported("hide_emitters is not supported: limpid shows its lights")?;
    }
    object.finish()?;
    match depth.map(u32::try_from) {
        None => Ok(None),
        Some(Ok(depth @ 1..)) => Ok(Some(depth - 1)),
        Some(_) => {
            let depth = depth.unwrap_or_default();
            element.unsupported(format!("max_depth is {depth}; limpid needs a limit of at least 1 (1 + bounces)"))?;
            Ok(None)
        }
    }
}
