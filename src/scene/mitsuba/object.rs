//! A Mitsuba object (sensor, shape, bsdf, ..): its type and its properties, each asked for by name. What nobody asked
//! for is refused at the end, so nothing in a file is passed over in silence.

use super::xml::Element;
use crate::Result;
use glam::{DMat4, DVec3};
use std::collections::BTreeMap;

const PROPERTY_TAGS: [&str; 8] = ["float", "integer", "boolean", "string", "rgb", "point", "vector", "transform"];

/// An object under reading.
pub struct Object<'a> {
    pub element: Element<'a>,
    kind: String,
    properties: BTreeMap<String, Element<'a>>,
    nested: Vec<Element<'a>>,
    known: Vec<&'static str>,
}

impl<'a> Object<'a> {
    /// Reads the properties of `element`, whose type must be one of `kinds`; none where it is passed over.
    pub fn new(element: Element<'a>, kinds: &[&str]) -> Result<Option<Self>> {
        element.only_attributes(&["type", "id", "name"])?;
        let kind = element.required("type")?;
        if !kinds.contains(&kind.as_str()) {
            let (tag, kinds) = (element.tag(), kinds.join(", "));
            element.unsupported(format!("{tag} of type '{kind}' is not supported; supported: {kinds}"))?;
            return Ok(None);
        }
        let mut object = Self { element, kind, properties: BTreeMap::new(), nested: Vec::new(), known: Vec::new() };
        for child in element.children()? {
            if !PROPERTY_TAGS.contains(&child.tag()) {
                object.nested.push(child);
                continue;
            }
            let name = child.required("name")?;
            if object.properties.insert(name.clone(), child).is_some() {
                return Err(child.error(format!("the property '{name}' is given twice")));
            }
        }
        Ok(Some(object))
    }

    pub fn kind(&self) -> &str {
        &self.kind
    }

    /// Takes the nested elements with this tag.
    pub fn take_nested(&mut self, tag: &'static str) -> Vec<Element<'a>> {
        self.known.push(tag);
        let (taken, rest) = self.nested.drain(..).partition(|element| element.tag() == tag);
        self.nested = rest;
        taken
    }

    /// Takes the nested element with this tag, of which there may be one.
    pub fn take_one_nested(&mut self, tag: &'static str) -> Result<Option<Element<'a>>> {
        let taken = self.take_nested(tag);
        match taken.get(1) {
            Some(second) => Err(second.error(format!("a second <{tag}> inside {}", self.element.words()))),
            None => Ok(taken.first().copied()),
        }
    }

    /// Takes the nested `<ref>` elements, each with the id that it names.
    pub fn references(&mut self) -> Result<Vec<(Element<'a>, String)>> {
        let id = |reference: Element<'a>| {
            reference.only_attributes(&["id", "name"])?;
            reference.no_children()?;
            Ok((reference, reference.required("id")?))
        };
        self.take_nested("ref").into_iter().map(id).collect()
    }

    /// Is the property, where there is one, a number?
    pub fn is_number(&self, name: &str) -> bool {
        self.properties.get(name).is_some_and(|property| ["float", "integer"].contains(&property.tag()))
    }

    fn take(&mut self, name: &'static str, tags: &[&str]) -> Result<Option<Element<'a>>> {
        self.known.push(name);
        let Some(property) = self.properties.remove(name) else { return Ok(None) };
        if !tags.contains(&property.tag()) {
            let tags: Vec<_> = tags.iter().map(|tag| format!("<{tag}>")).collect();
            return Err(property.error(format!("{} must be {}", property.words(), tags.join(" or "))));
        }
        Ok(Some(property))
    }

    fn scalar(&mut self, name: &'static str, tags: &[&str]) -> Result<Option<(Element<'a>, String)>> {
        let Some(property) = self.take(name, tags)? else { return Ok(None) };
        property.only_attributes(&["name", "value"])?;
        property.no_children()?;
        Ok(Some((property, property.required("value")?)))
    }

    pub fn float(&mut self, name: &'static str) -> Result<Option<f64>> {
        match self.scalar(name, &["float", "integer"])? {
            Some((property, _)) => property.number("value"),
            None => Ok(None),
        }
    }

    pub fn integer(&mut self, name: &'static str) -> Result<Option<i64>> {
        let Some((property, text)) = self.scalar(name, &["integer"])? else { return Ok(None) };
        text.trim()
            .parse()
            .map(Some)
            .map_err(|_| property.error(format!("{}: \"{text}\" is not an integer", property.words())))
    }

    /// An integer of at least 1.
    pub fn count(&mut self, name: &'static str) -> Result<Option<u32>> {
        let element = self.properties.get(name).copied().unwrap_or(self.element);
        let Some(value) = self.integer(name)? else { return Ok(None) };
        match u32::try_from(value) {
            Ok(count) if count > 0 => Ok(Some(count)),
            _ => Err(element.error(format!("{name} is {value}; it must be 1 to {}", u32::MAX))),
        }
    }

    pub fn boolean(&mut self, name: &'static str) -> Result<Option<bool>> {
        let Some((property, text)) = self.scalar(name, &["boolean"])? else { return Ok(None) };
        match text.to_ascii_lowercase().as_str() {
            "true" => Ok(Some(true)),
            "false" => Ok(Some(false)),
            _ => Err(property.error(format!("{}: \"{text}\" is neither true nor false", property.words()))),
        }
    }

    pub fn string(&mut self, name: &'static str) -> Result<Option<String>> {
        Ok(self.scalar(name, &["string"])?.map(|(_, text)| text))
    }

    /// The file that the object cannot be without.
    pub fn filename(&mut self) -> Result<String> {
        let element = self.element;
        let file = self.string("filename")?;
        file.ok_or_else(|| element.error(format!("{} lacks <string name=\"filename\">", element.words())))
    }

    /// A property that makes no difference here; its value is not looked at.
    pub fn pass_over(&mut self, name: &'static str) {
        self.known.push(name);
        self.properties.remove(name);
    }

    /// Three numbers as `rgb`, or one grey `float`; `check` refuses values.
    pub fn color(&mut self, name: &'static str, check: fn(DVec3) -> Result<()>) -> Result<Option<DVec3>> {
        let Some((property, text)) = self.scalar(name, &["rgb", "float"])? else { return Ok(None) };
        if text.trim_start().starts_with('#') {
            return Err(property.error("colours as #rrggbb are not supported; write three linear numbers"));
        }
        let numbers = property.numbers("value")?.unwrap_or_default();
        let color = match numbers[..] {
            [grey] => DVec3::splat(grey),
            [r, g, b] if property.tag() == "rgb" => DVec3::new(r, g, b),
            _ => return Err(property.error(format!("{} has {} numbers", property.words(), numbers.len()))),
        };
        check(color).map_err(|error| property.error(error))?;
        Ok(Some(color))
    }

    pub fn point(&mut self, name: &'static str) -> Result<Option<DVec3>> {
        self.three(name, "point")
    }

    pub fn vector(&mut self, name: &'static str) -> Result<Option<DVec3>> {
        self.three(name, "vector")
    }

    fn three(&mut self, name: &'static str, tag: &str) -> Result<Option<DVec3>> {
        let Some(property) = self.take(name, &[tag])? else { return Ok(None) };
        property.no_children()?;
        property.only_attributes(&["name", "value", "x", "y", "z"])?;
        // As in Mitsuba, no coordinate may be left out.
        if property.attribute("value")?.is_none() {
            ["x", "y", "z"].into_iter().try_for_each(|name| property.required(name).map(drop))?;
        }
        super::transform::vector(property, 0.0).map(Some)
    }

    pub fn transform(&mut self, name: &'static str) -> Result<Option<DMat4>> {
        self.take(name, &["transform"])?.map(super::transform::transform).transpose()
    }

    /// Refuses what has not been asked for.
    pub fn finish(self) -> Result<()> {
        let supported = if self.known.is_empty() { "nothing".to_owned() } else { self.known.join(", ") };
        let (kind, tag) = (&self.kind, self.element.tag());
        self.properties.values().chain(&self.nested).try_for_each(|left| {
            let words = left.words();
            left.unsupported(format!("{words} in the {kind} {tag} is not supported; supported there: {supported}"))
        })
    }
}
