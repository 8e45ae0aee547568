//! The files of a scene: the one that was named and those that it includes.

use super::xml::{self, Context, Element, Source};
use super::{Options, read_text};
use crate::{Error, Result};
use roxmltree::Document;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// As deep as includes may nest, and as many files as a scene may have: no scene needs more, and a file may include itself.
const MAX_DEPTH: usize = 15;
const MAX_FILES: usize = 1000;

/// One file.
pub struct File {
    pub name: String,
    pub text: String,
    /// The files that its `<include>` elements name, in their order.
    includes: Vec<usize>,
}

/// All files of a scene, the main one first.
pub struct Files {
    pub files: Vec<File>,
    /// The folder of the main file.
    pub folder: PathBuf,
    /// The `<default>` values, replaced by those from outside; of two files the one that is read first has the word.
    pub parameters: BTreeMap<String, String>,
}

impl Files {
    /// Reads what the main file includes.
    pub fn read(text: &str, file: &str, options: &Options) -> Result<Self> {
        let folder = Path::new(file).parent().unwrap_or(Path::new("")).to_owned();
        let mut files = Self { files: Vec::new(), folder, parameters: BTreeMap::new() };
        files.add(text.to_owned(), file.to_owned(), options, 0)?;
        let Some(name) = options.parameters.keys().find(|name| !files.parameters.contains_key(*name)) else {
            return Ok(files);
        };
        let names: Vec<_> = files.parameters.keys().map(String::as_str).collect();
        let names = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        Err(Error::input(format!("{file}: no parameter '{name}'; the file defines: {names}")))
    }

    /// Adds a file and all that it includes; its index.
    fn add(&mut self, text: String, name: String, options: &Options, depth: usize) -> Result<usize> {
        let index = self.files.len();
        let document = xml::parse(&text, &name)?;
        let unset = Context::new(BTreeMap::new(), false);
        let folder = self.folder.clone();
        let source = Source { file: &name, folder: &folder, document: &document, context: &unset };
        let root = Element::root(&source);
        check_root(root)?;
        self.files.push(File { name: name.clone(), text: String::new(), includes: Vec::new() });
        let mut defined = BTreeSet::new();
        for element in root.children()? {
            match element.tag() {
                "default" => self.default(element, &mut defined, options)?,
                "include" => {
                    let context = Context::new(self.parameters.clone(), false);
                    let source = Source { context: &context, ..source };
                    let included = self.include(element.within(&source), options, depth)?;
                    self.files[index].includes.push(included);
                }
                _ => {}
            }
        }
        self.files[index].text = text;
        Ok(index)
    }

    fn default(&mut self, element: Element, defined: &mut BTreeSet<String>, options: &Options) -> Result<()> {
        element.only_attributes(&["name", "value"])?;
        element.no_children()?;
        let name = element.required("name")?;
        if name.is_empty() || !name.chars().all(|c| c.is_alphanumeric() || "_-".contains(c)) {
            return Err(element.error(format!("'{name}' is no parameter name; use letters, digits, _ and -")));
        }
        let value = options.parameters.get(&name).cloned().map_or_else(|| element.required("value"), Ok)?;
        if !defined.insert(name.clone()) {
            return Err(element.error(format!("{} is given twice", element.words())));
        }
        self.parameters.entry(name).or_insert(value);
        Ok(())
    }

    fn include(&mut self, element: Element, options: &Options, depth: usize) -> Result<usize> {
        element.only_attributes(&["filename"])?;
        element.no_children()?;
        let path = self.folder.join(element.required("filename")?);
        if depth == MAX_DEPTH || self.files.len() == MAX_FILES {
            return Err(element.error(format!(
                "includes nest more than {MAX_DEPTH} deep or name more than {MAX_FILES} files: does a file include itself?"
            )));
        }
        let text = read_text(&path, "the included scene file").map_err(|error| element.error(error))?;
        self.add(text, path.display().to_string(), options, depth + 1)
    }

    /// The files parsed, in their order.
    pub fn parse(&self) -> Result<Vec<Document<'_>>> {
        self.files.iter().map(|file| xml::parse(&file.text, &file.name)).collect()
    }

    /// The elements below the root of a file, those of its includes in their place.
    pub fn top_level<'a>(&self, sources: &'a [Source<'a>], index: usize) -> Result<Vec<Element<'a>>> {
        let mut elements = Vec::new();
        let mut includes = self.files[index].includes.iter();
        for element in Element::root(&sources[index]).children()? {
            match (element.tag(), includes.as_slice().first()) {
                ("include", Some(&included)) => {
                    includes.next();
                    elements.extend(self.top_level(sources, included)?);
                }
                _ => elements.push(element),
            }
        }
        Ok(elements)
    }
}

fn check_root(root: Element) -> Result<()> {
    if root.tag() != "scene" {
        return Err(root.error(format!("{} is no Mitsuba scene; the root must be <scene>", root.words())));
    }
    root.only_attributes(&["version"])?;
    let version = root.required("version")?;
    if !["2.", "3."].iter().any(|known| version.starts_with(known)) {
        return Err(root.error(format!("scene version \"{version}\" is not supported; supported: 3.x (and 2.x)")));
    }
    Ok(())
}
