//! What a user may name as a scene: `spheres`, `spheres:N`, `rooms:N` or a file.

use super::{Scene, family, gltf, mitsuba, rooms};
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// A scene as named on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Spec {
    /// `spheres`: the canonical frame.
    Canonical,
    /// `spheres:N`: scene N of the family.
    Family(u64),
    /// `rooms:N`: scene N of the other family.
    Rooms(u64),
    /// A Mitsuba 3 XML or glTF 2.0 file.
    File(PathBuf),
}

/// A scene with the settings that its file states.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// The scene; its camera holds the image size.
    pub scene: Scene,
    /// Samples per pixel, where stated.
    pub spp: Option<u32>,
    /// The bounce limit (Mitsuba's `max_depth` - 1), where stated.
    pub bounces: Option<u32>,
    /// What of the file was left out, each with file and line.
    pub left_out: Vec<String>,
}

impl std::str::FromStr for Spec {
    type Err = Error;

    fn from_str(spec: &str) -> Result<Self> {
        if spec == "spheres" {
            return Ok(Self::Canonical);
        }
        for (family, of) in [("spheres", Self::Family as fn(u64) -> Self), ("rooms", Self::Rooms)] {
            let Some(number) = spec.strip_prefix(family).and_then(|rest| rest.strip_prefix(':')) else { continue };
            // `parse` alone would take a plus sign.
            let digits = !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit());
            return match number.parse() {
                Ok(n) if digits => Ok(of(n)),
                _ => Err(Error::input(format!(
                    "scene '{spec}': '{number}' is no scene number; write {family}:N with N from 0 to {}",
                    u64::MAX
                ))),
            };
        }
        Ok(Self::File(PathBuf::from(spec)))
    }
}

impl Spec {
    /// Loads and validates the scene. `options` serve a file: its parameters and the image size; the size also replaces
    /// the 768x768 of the other kinds.
    pub fn load(&self, options: &mitsuba::Options) -> Result<Loaded> {
        let scene = match self {
            Self::File(path) if is_gltf(path) => return gltf::load(path, options),
            Self::File(path) => return mitsuba::load(path, options),
            _ if !options.parameters.is_empty() => {
                return Err(Error::input("parameters ($name) go with a scene file, not with the built-in scenes"));
            }
            Self::Canonical => family::canonical(),
            Self::Family(n) => family::spheres(*n),
            Self::Rooms(n) => rooms::rooms(*n),
        };
        sized(scene, options)
    }

    /// The version of the random family that the scene is of.
    #[must_use]
    pub fn family_version(&self) -> Option<u32> {
        match self {
            Self::Family(_) => Some(family::FAMILY_VERSION),
            Self::Rooms(_) => Some(rooms::ROOMS_VERSION),
            Self::Canonical | Self::File(_) => None,
        }
    }

    /// Loads frame `t` of an animation; only `spheres:N` has one.
    pub fn load_frame(&self, t: u32, options: &mitsuba::Options) -> Result<Loaded> {
        match self {
            Self::Family(n) => sized(family::frame(*n, t), options),
            _ => Err(Error::input("only the scenes spheres:N move; give one where frames are asked for")),
        }
    }
}

fn is_gltf(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default();
    ["gltf", "glb"].iter().any(|known| extension.eq_ignore_ascii_case(known))
}

fn sized(mut scene: Scene, options: &mitsuba::Options) -> Result<Loaded> {
    if let Some((width, height)) = options.size {
        (scene.camera.width, scene.camera.height) = (width, height);
    }
    scene.validate()?;
    Ok(Loaded { scene, spp: None, bounces: None, left_out: Vec::new() })
}

impl Scene {
    /// Loads the scene named `spec`: `spheres`, `spheres:N`, `rooms:N` or the path of a Mitsuba 3 XML or glTF 2.0 file.
    pub fn from_spec(spec: &str) -> Result<Self> {
        Ok(spec.parse::<Spec>()?.load(&mitsuba::Options::default())?.scene)
    }
}
