//! Reads launch files in YAML, within limits: one document without aliases, of limited size and depth.

use super::entity::{Attribute, Entity, Place, kind};
use crate::xml::{DEPTH_MAX, ImportError, NODES_MAX, TEXT_MAX};
use language::Source;
use saphyr_parser::{Event, Marker, Parser, ScalarStyle};

/// A value with its place.
#[derive(Debug)]
struct Yaml {
    place: Place,
    content: Content,
}

#[derive(Debug)]
enum Content {
    Scalar(Scalar),
    List(Vec<Yaml>),
    Map(Vec<(String, Yaml)>),
}

#[derive(Debug)]
struct Scalar {
    text: String,
    /// Whether it stands in quotes, so that it is a text in a list.
    is_quoted: bool,
}

/// A list or a map that is not complete.
#[derive(Debug)]
struct Open {
    value: Yaml,
    /// The key whose value comes next.
    key: Option<String>,
}

/// Reads a file, and returns its actions.
///
/// # Errors
/// The file is not YAML, is too long or too deep, or is not a list of actions behind `launch`.
pub(super) fn read(source: &Source) -> Result<Entity, ImportError> {
    let reader = Reader { file: &source.name };
    let root = reader.document(source)?;
    let place = root.place;
    let not_launch = "a launch file in YAML is a list of actions behind the key `launch`";
    let Content::Map(entries) = root.content else { return Err(reader.error(place, not_launch)) };
    let [(key, actions)] = one(entries).ok_or_else(|| reader.error(place, not_launch))?;
    if key != "launch" {
        return Err(reader.error(place, not_launch));
    }
    let children = reader.actions(actions)?;
    Ok(Entity { kind: key, place, attributes: Vec::new(), children })
}

#[derive(Clone, Copy, Debug)]
struct Reader<'a> {
    file: &'a str,
}

impl Reader<'_> {
    fn error(self, place: Place, why: impl Into<String>) -> ImportError {
        ImportError { file: self.file.into(), line: place.line, column: place.column, why: why.into() }
    }

    /// Reads the document as values.
    fn document(self, source: &Source) -> Result<Yaml, ImportError> {
        let start = Place { line: 1, column: 1 };
        if source.text.len() > TEXT_MAX {
            let why = format!("the file has {} bytes; at most {TEXT_MAX} are read", source.text.len());
            return Err(self.error(start, why));
        }
        let (mut open, mut root, mut count) = (Vec::<Open>::new(), None, 0);
        for event in Parser::new_from_str(&source.text) {
            let (event, span) = event.map_err(|error| self.error(place_of(error.marker()), error.info()))?;
            let place = place_of(&span.start);
            count += 1;
            if count > NODES_MAX {
                return Err(self.error(place, format!("the file has more than {NODES_MAX} parts")));
            }
            let complete = match event {
                Event::Nothing | Event::StreamStart | Event::StreamEnd | Event::DocumentEnd => None,
                Event::DocumentStart(_) if root.is_some() => {
                    return Err(self.error(place, "the file has a second document; a launch file has one"));
                }
                Event::DocumentStart(_) => None,
                Event::Alias(_) => {
                    return Err(self.error(place, "aliases (`*name`) are not supported; write the value again"));
                }
                Event::Scalar(text, style, ..) => {
                    let is_quoted = matches!(style, ScalarStyle::SingleQuoted | ScalarStyle::DoubleQuoted);
                    let scalar = Scalar { text: text.into_owned(), is_quoted };
                    Some(Yaml { place, content: Content::Scalar(scalar) })
                }
                Event::SequenceStart(..) | Event::MappingStart(..) => {
                    let is_list = matches!(event, Event::SequenceStart(..));
                    let content = if is_list { Content::List(Vec::new()) } else { Content::Map(Vec::new()) };
                    open.push(Open { value: Yaml { place, content }, key: None });
                    if open.len() > DEPTH_MAX {
                        return Err(self.error(place, format!("values are nested more than {DEPTH_MAX} deep")));
                    }
                    None
                }
                Event::SequenceEnd | Event::MappingEnd => open.pop().map(|open| open.value),
            };
            if let Some(value) = complete {
                match open.last_mut() {
                    Some(around) => self.add(around, value)?,
                    None => root = Some(value),
                }
            }
        }
        root.ok_or_else(|| self.error(start, "the file is empty"))
    }

    /// Puts a complete value into the list or the map around it.
    fn add(self, around: &mut Open, value: Yaml) -> Result<(), ImportError> {
        match (&mut around.value.content, around.key.take()) {
            (Content::List(list), _) => list.push(value),
            (Content::Map(entries), Some(key)) => entries.push((key, value)),
            (Content::Map(entries), None) => {
                let place = value.place;
                let Content::Scalar(key) = value.content else {
                    return Err(self.error(place, "a key must be a text here"));
                };
                let key = key.text;
                if entries.iter().any(|(known, _)| *known == key) {
                    return Err(self.error(place, format!("the key `{key}` occurs twice")));
                }
                around.key = Some(key);
            }
            // A scalar is complete at once, so nothing is inside it.
            (Content::Scalar(_), _) => {}
        }
        Ok(())
    }

    /// Reads a list whose items are maps with one key, the kind of an action.
    fn actions(self, list: Yaml) -> Result<Vec<Entity>, ImportError> {
        let why = "a list of actions is expected here: `- node:`";
        let place = list.place;
        let Content::List(items) = list.content else { return Err(self.error(place, why)) };
        let action = |item: Yaml| {
            let place = item.place;
            let Content::Map(entries) = item.content else { return Err(self.error(place, why)) };
            let [(name, body)] = one(entries).ok_or_else(|| self.error(place, why))?;
            self.entity(&name, place, body)
        };
        items.into_iter().map(action).collect()
    }

    /// Reads an action of this kind: its attributes, its parts, and the actions inside it.
    fn entity(self, name: &str, place: Place, body: Yaml) -> Result<Entity, ImportError> {
        let mut entity = Entity { kind: kind(name), place, attributes: Vec::new(), children: Vec::new() };
        let inside = body.place;
        match body.content {
            Content::List(items) => {
                entity.children = self.actions(Yaml { place: inside, content: Content::List(items) })?;
            }
            Content::Scalar(scalar) if matches!(scalar.text.as_str(), "" | "~" | "null") => {}
            Content::Scalar(_) => {
                return Err(self.error(inside, format!("`{name}` needs keys, such as `name: …`, each on its line")));
            }
            Content::Map(entries) => {
                for (key, value) in entries {
                    self.entry(&mut entity, key, value)?;
                }
            }
        }
        Ok(entity)
    }

    fn entry(self, entity: &mut Entity, key: String, value: Yaml) -> Result<(), ImportError> {
        if key == "children" {
            entity.children.extend(self.actions(value)?);
            return Ok(());
        }
        let is_of_maps = matches!(&value.content, Content::List(items)
            if items.iter().any(|item| matches!(item.content, Content::Map(_))));
        let place = value.place;
        match value.content {
            Content::List(items) if is_of_maps => {
                for item in items {
                    let place = item.place;
                    entity.children.push(self.entity(&key, place, item)?);
                }
            }
            Content::Map(entries) => {
                entity.children.push(self.entity(&key, place, Yaml { place, content: Content::Map(entries) })?);
            }
            content @ (Content::Scalar(_) | Content::List(_)) => {
                entity.attributes.push(Attribute { name: key, value: flow(&content) });
            }
        }
        Ok(())
    }
}

/// Returns a value in one line. A text in a list has quotes, so that it stays one text.
fn flow(content: &Content) -> String {
    match content {
        Content::Scalar(scalar) => scalar.text.clone(),
        Content::Map(_) => String::new(),
        Content::List(items) => {
            let is_plain = |text: &str| text.chars().all(|c| c.is_ascii_alphanumeric() || "._-+".contains(c));
            let item = |item: &Yaml| match &item.content {
                Content::Scalar(Scalar { text, is_quoted }) if *is_quoted || !is_plain(text) || text.is_empty() => {
                    format!("'{}'", text.replace('\'', "''"))
                }
                content @ (Content::Scalar(_) | Content::List(_) | Content::Map(_)) => flow(content),
            };
            format!("[{}]", items.iter().map(item).collect::<Vec<_>>().join(", "))
        }
    }
}

/// Returns the only entry of a map; none if there are others, or no entry.
fn one(entries: Vec<(String, Yaml)>) -> Option<[(String, Yaml); 1]> {
    entries.try_into().ok()
}

fn place_of(marker: &Marker) -> Place {
    let number = |found: usize| u32::try_from(found).unwrap_or(u32::MAX);
    Place { line: number(marker.line()).max(1), column: number(marker.col()).saturating_add(1) }
}
