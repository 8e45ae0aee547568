//! XML elements with parameters substituted, and errors that name file and line.

use super::picture;
use crate::scene::Picture;
use crate::{Error, Result};
use roxmltree::{Document, Node, NodeType};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What all files of a scene share.
pub struct Context {
    /// Values by name.
    pub parameters: BTreeMap<String, String>,
    /// What is not supported is noted and passed over, not refused.
    lenient: bool,
    notes: RefCell<Vec<String>>,
    /// What has been read, by path and whether it is raw.
    pictures: RefCell<BTreeMap<(PathBuf, bool), Arc<Picture>>>,
}

impl Context {
    pub fn new(parameters: BTreeMap<String, String>, lenient: bool) -> Self {
        Self { parameters, lenient, notes: RefCell::default(), pictures: RefCell::default() }
    }

    /// Adds a note; an element that is read twice is noted once.
    pub fn note(&self, note: String) {
        let mut notes = self.notes.borrow_mut();
        if !notes.contains(&note) {
            notes.push(note);
        }
    }

    pub fn into_notes(self) -> Vec<String> {
        self.notes.into_inner()
    }
}

/// A parsed file.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    pub file: &'a str,
    /// The folder of the scene's main file, where the files that it names are looked for.
    pub folder: &'a Path,
    pub document: &'a Document<'a>,
    pub context: &'a Context,
}

impl Source<'_> {
    /// The picture in a file that the scene names; it is read once.
    pub fn picture(&self, file: &str, raw: bool) -> Result<Arc<Picture>> {
        let key = (self.folder.join(file), raw);
        if let Some(picture) = self.context.pictures.borrow().get(&key) {
            return Ok(picture.clone());
        }
        let picture = Arc::new(picture::read(&key.0, raw)?);
        self.context.pictures.borrow_mut().insert(key, picture.clone());
        Ok(picture)
    }
}

/// Parses the text; an error names the line.
pub fn parse<'a>(text: &'a str, file: &str) -> Result<Document<'a>> {
    Document::parse(text)
        .map_err(|error| Error::input(format!("{file}:{}: not well-formed XML: {error}", error.pos().row)))
}

/// One element.
#[derive(Clone, Copy)]
pub struct Element<'a> {
    pub source: &'a Source<'a>,
    node: Node<'a, 'a>,
}

impl<'a> Element<'a> {
    pub fn new(source: &'a Source<'a>, node: Node<'a, 'a>) -> Self {
        Self { source, node }
    }

    pub fn root(source: &'a Source<'a>) -> Self {
        Self::new(source, source.document.root_element())
    }

    /// The same element with the parameters of another source of the same file.
    pub fn within(&self, source: &'a Source<'a>) -> Self {
        Self::new(source, self.node)
    }

    pub fn tag(&self) -> &'a str {
        self.node.tag_name().name()
    }

    /// An input error at this element's line.
    pub fn error(&self, message: impl std::fmt::Display) -> Error {
        // Text begins with the line break after the element before it.
        let range = self.node.range();
        let text = &self.source.document.input_text()[range.clone()];
        let blank = text.len() - text.trim_start().len();
        let line = self.source.document.text_pos_at(range.start + blank).row;
        Error::input(format!("{}:{line}: {message}", self.source.file))
    }

    /// Notes, at this element's line, what the caller should know.
    pub fn note(&self, message: impl std::fmt::Display) {
        self.source.context.note(self.error(message).to_string());
    }

    /// For what limpid lacks and Mitsuba may have: an error or, where the user asked for that, a note.
    pub fn unsupported(&self, message: impl std::fmt::Display) -> Result<()> {
        let error = self.error(message);
        if !self.source.context.lenient {
            return Err(error);
        }
        self.source.context.note(error.to_string());
        Ok(())
    }

    /// This element in words, e.g. `<float name="fov">`.
    pub fn words(&self) -> String {
        let attribute = ["name", "type", "id"].iter().find_map(|name| Some((name, self.node.attribute(*name)?)));
        match attribute {
            Some((name, value)) => format!("<{} {name}=\"{value}\">", self.tag()),
            None => format!("<{}>", self.tag()),
        }
    }

    /// The value of an attribute, parameters substituted.
    pub fn attribute(&self, name: &str) -> Result<Option<String>> {
        self.node.attribute(name).map(|value| self.substitute(value)).transpose()
    }

    /// The value of an attribute that must be there.
    pub fn required(&self, name: &str) -> Result<String> {
        self.attribute(name)?.ok_or_else(|| self.error(format!("{} lacks the attribute '{name}'", self.words())))
    }

    /// Refuses attributes other than these.
    pub fn only_attributes(&self, allowed: &[&str]) -> Result<()> {
        match self.node.attributes().find(|a| !allowed.contains(&a.name()) || a.namespace().is_some()) {
            None => Ok(()),
            Some(a) => Err(self.error(format!(
                "{} has the attribute '{}'; supported: {}",
                self.words(),
                a.name(),
                allowed.join(", ")
            ))),
        }
    }

    /// The child elements; refuses text between them.
    pub fn children(&self) -> Result<Vec<Element<'a>>> {
        let mut children = Vec::new();
        for node in self.node.children() {
            match node.node_type() {
                NodeType::Element => children.push(Self::new(self.source, node)),
                NodeType::Text if !node.text().unwrap_or("").trim().is_empty() => {
                    return Err(Self::new(self.source, node).error(format!("text inside {}", self.words())));
                }
                _ => {}
            }
        }
        Ok(children)
    }

    /// All elements below this one, in document order.
    pub fn descendants(&self) -> impl Iterator<Item = Element<'a>> + use<'a> {
        let source = self.source;
        self.node.descendants().filter(Node::is_element).map(move |node| Self::new(source, node))
    }

    /// Refuses children.
    pub fn no_children(&self) -> Result<()> {
        match self.children()?.first() {
            None => Ok(()),
            Some(child) => Err(child.error(format!("{} inside {} is not supported", child.words(), self.words()))),
        }
    }

    /// One finite number in an attribute.
    pub fn number(&self, name: &str) -> Result<Option<f64>> {
        self.attribute(name)?.map(|text| self.parse_number(name, &text)).transpose()
    }

    /// The numbers in an attribute, separated by commas or blanks.
    pub fn numbers(&self, name: &str) -> Result<Option<Vec<f64>>> {
        let Some(text) = self.attribute(name)? else { return Ok(None) };
        let parts = text.split(|c: char| c == ',' || c.is_ascii_whitespace()).filter(|part| !part.is_empty());
        parts.map(|part| self.parse_number(name, part)).collect::<Result<_>>().map(Some)
    }

    fn parse_number(&self, name: &str, text: &str) -> Result<f64> {
        match text.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(self.error(format!("{}: {name}=\"{text}\" is not a finite number", self.words()))),
        }
    }

    /// Replaces each `$name`; of names that begin alike the longest wins.
    fn substitute(&self, value: &str) -> Result<String> {
        let mut parts = value.split('$');
        let mut result = parts.next().unwrap_or("").to_owned();
        for part in parts {
            let known = self.source.context.parameters.iter().filter(|(name, _)| part.starts_with(name.as_str()));
            let Some((name, replacement)) = known.max_by_key(|(name, _)| name.len()) else {
                let names: Vec<_> = self.source.context.parameters.keys().map(String::as_str).collect();
                return Err(self.error(format!(
                    "unknown parameter in \"{value}\"; the <default> elements define: {}",
                    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
                )));
            };
            result += replacement;
            result += &part[name.len()..];
        }
        Ok(result)
    }
}
