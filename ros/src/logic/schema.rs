//! A message type with all the messages in it, ready to read and write values.

use super::definition::{Constant, Count, Definition, DefinitionError, Element, Field};
use super::name::TypeName;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write;

/// The largest number of types in one schema.
const STRUCTS_MAX: usize = 500;
/// The greatest depth of messages within messages.
pub(crate) const DEPTH_MAX: usize = 32;
/// The line between two definitions in one text.
const SEPARATOR: &str = "================================================================================";

/// A message type, and the types in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// The type itself is the first one.
    structs: Vec<Struct>,
}

/// A type within a schema.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Struct {
    /// The name.
    pub name: TypeName,
    /// The fields. If a field is another message, it has an index for [`Schema::at`].
    pub fields: Vec<Field<usize>>,
    /// The constants.
    pub constants: Vec<Constant>,
    /// The smallest number of bytes of a value, without padding.
    pub(crate) size_min: usize,
}

impl Schema {
    /// Makes the schema of a type. `find` returns the lines that define each type in it.
    ///
    /// # Errors
    /// If a definition is missing or wrong, or the type contains itself.
    pub fn new<'a>(name: &TypeName, find: impl Fn(&TypeName) -> Option<Cow<'a, str>>) -> Result<Self, DefinitionError> {
        let mut resolver = Resolver { find, structs: Vec::new(), known: BTreeMap::new() };
        resolver.add(name, 0)?;
        // The type itself was added last.
        let root = resolver.structs.len() - 1;
        let order = |index: usize| root - index;
        let mut structs = resolver.structs;
        structs.reverse();
        for field in structs.iter_mut().flat_map(|one| &mut one.fields) {
            if let Element::Message(index) = &mut field.element {
                *index = order(*index);
            }
        }
        Ok(Self { structs })
    }

    /// Reads the text of a schema in a record. First comes the definition of `name`, then the definitions of the messages in it, each after
    /// a line of `=` and a line `MSG: package/Name`.
    ///
    /// # Errors
    /// As in [`Schema::new`].
    pub fn parse(name: &TypeName, text: &str) -> Result<Self, DefinitionError> {
        let (own, others) = match text.find(SEPARATOR) {
            Some(at) => text.split_at(at),
            None => (text, ""),
        };
        let others: BTreeMap<TypeName, &str> = sections(others).collect();
        Self::new(name, |other| {
            let found = if other == name { Some(own) } else { others.get(other).copied() };
            found.map(Cow::Borrowed)
        })
    }

    /// Returns the name of the type.
    pub fn name(&self) -> &TypeName {
        &self.root().name
    }

    /// Returns the type itself.
    pub fn root(&self) -> &Struct {
        &self.structs[0]
    }

    /// Returns the type with the index that a field of this schema has.
    ///
    /// # Panics
    /// If the index is not from a field of this schema.
    pub fn at(&self, index: usize) -> &Struct {
        &self.structs[index]
    }

    /// Returns the type of a field that is a message, or a list of messages.
    pub fn message(&self, field: &Field<usize>) -> Option<&Struct> {
        match &field.element {
            Element::Message(index) => self.structs.get(*index),
            Element::Primitive(_) | Element::Text { .. } => None,
        }
    }

    /// Returns all types, the type itself first.
    pub fn structs(&self) -> &[Struct] {
        &self.structs
    }

    /// Returns the text of the schema in a record, see [`Schema::parse`]. Viewers call this form `ros2msg`.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for (index, one) in self.structs.iter().enumerate() {
            if index > 0 {
                text += &format!("{SEPARATOR}\nMSG: {}\n", one.name.short());
            }
            for constant in &one.constants {
                let Constant { name, of, value } = constant;
                let of = written(of, |name| name.short());
                let _infallible = writeln!(text, "{of} {name}={value}");
            }
            for field in &one.fields {
                let of = written(&field.element, |index| self.structs[*index].name.short());
                let count = match field.count {
                    Count::One => String::new(),
                    Count::Array(size) => format!("[{size}]"),
                    Count::Any => "[]".to_owned(),
                    Count::Max(max) => format!("[<={max}]"),
                };
                let default = field.default.as_ref().map(|default| format!(" {default}")).unwrap_or_default();
                let _infallible = writeln!(text, "{of}{count} {}{default}", field.name);
            }
        }
        text
    }

    /// Returns the smallest number of bytes of an element, without padding.
    pub fn size_min(&self, element: &Element<usize>) -> usize {
        size_min(&self.structs, element)
    }
}

fn written<R>(element: &Element<R>, name: impl Fn(&R) -> String) -> String {
    match element {
        Element::Primitive(primitive) => primitive.as_str().to_owned(),
        Element::Text { max: None } => "string".to_owned(),
        Element::Text { max: Some(max) } => format!("string<={max}"),
        Element::Message(message) => name(message),
    }
}

fn size_min(structs: &[Struct], element: &Element<usize>) -> usize {
    match element {
        Element::Primitive(primitive) => primitive.size(),
        Element::Text { .. } => 4,
        Element::Message(index) => structs[*index].size_min,
    }
}

/// Returns the definitions in a text. Each begins with a line of `=` and a line `MSG: package/Name`.
pub(crate) fn sections(text: &str) -> impl Iterator<Item = (TypeName, &str)> {
    text.split(SEPARATOR).filter_map(|section| {
        let (title, body) = section.trim_start().split_once('\n')?;
        let title = ["MSG:", "SRV:", "ACTION:"].iter().find_map(|kind| title.strip_prefix(kind))?;
        Some((TypeName::parse(title.trim())?, body))
    })
}

/// Collects the types of a schema: first the types in a message, then the message.
struct Resolver<F> {
    find: F,
    structs: Vec<Struct>,
    /// None while a type is being resolved.
    known: BTreeMap<TypeName, Option<usize>>,
}

impl<'a, F: Fn(&TypeName) -> Option<Cow<'a, str>>> Resolver<F> {
    fn add(&mut self, name: &TypeName, depth: usize) -> Result<usize, DefinitionError> {
        match self.known.get(name) {
            Some(Some(index)) => return Ok(*index),
            Some(None) => return Err(DefinitionError::TooLarge(name.to_string())),
            None if self.known.len() >= STRUCTS_MAX || depth > DEPTH_MAX => {
                return Err(DefinitionError::TooLarge(name.to_string()));
            }
            None => {}
        }
        let text = (self.find)(name).ok_or_else(|| DefinitionError::Unknown(name.to_string()))?;
        let Definition { fields, constants } = Definition::parse(name, &text)?;
        self.known.insert(name.clone(), None);
        let mut resolved = Vec::with_capacity(fields.len());
        for Field { name, element, count, default } in fields {
            let element = match element {
                Element::Primitive(primitive) => Element::Primitive(primitive),
                Element::Text { max } => Element::Text { max },
                Element::Message(other) => Element::Message(self.add(&other, depth + 1)?),
            };
            resolved.push(Field { name, element, count, default });
        }
        let sizes = resolved.iter().map(|field| match field.count {
            Count::One => size_min(&self.structs, &field.element),
            Count::Array(size) => size_min(&self.structs, &field.element).saturating_mul(size),
            Count::Any | Count::Max(_) => 4,
        });
        // A message without fields is one byte.
        let size_min = sizes.fold(0_usize, usize::saturating_add).max(1);
        let index = self.structs.len();
        self.structs.push(Struct { name: name.clone(), fields: resolved, constants, size_min });
        self.known.insert(name.clone(), Some(index));
        Ok(index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> TypeName {
        TypeName::parse(text).unwrap()
    }

    #[test]
    fn a_text_has_the_definitions_of_all_messages() {
        let text = "uint8 OK=0\nb/Point[<=4] path\nstring<=3 who\nfloat64[2] at 0.5\n\
                    ================================================================================\nMSG: b/Point\nc/X x\nc/X y\n\
                    ================================================================================\nMSG: c/X\nfloat64 x\n";
        let schema = Schema::parse(&name("a/Way"), text).unwrap();
        assert_eq!(schema.text(), text);
        assert_eq!(schema.structs().iter().map(|one| one.size_min).collect::<Vec<_>>(), [4 + 4 + 16, 16, 8]);
    }

    #[test]
    fn a_message_that_contains_itself_is_refused() {
        let find = |text: &'static str| move |_: &TypeName| Some(Cow::Borrowed(text));
        assert_eq!(Schema::new(&name("a/A"), find("A a")), Err(DefinitionError::TooLarge("a/msg/A".to_owned())));
        let missing = Schema::new(&name("a/A"), |other| (other.name() == "A").then_some(Cow::Borrowed("B b")));
        assert_eq!(missing, Err(DefinitionError::Unknown("a/msg/B".to_owned())));
    }

    #[test]
    fn nesting_has_a_limit() {
        let text = |count: usize| {
            let rest: String = (1..count).map(|at| format!("{SEPARATOR}\nMSG: a/A{at}\nA{} next\n", at + 1)).collect();
            format!("A1 next\n{rest}{SEPARATOR}\nMSG: a/A{count}\nbool end\n")
        };
        assert!(Schema::parse(&name("a/A"), &text(DEPTH_MAX)).is_ok());
        assert!(Schema::parse(&name("a/A"), &text(DEPTH_MAX + 1)).is_err());
    }
}
