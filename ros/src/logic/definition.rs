//! Definitions in the form of `.msg` and `.srv` files: one line for each field or constant.
//!
//! Source: <https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html>.

use super::name::{Folder, TypeName};
use thiserror::Error;

/// The largest number of fields in one definition.
const FIELDS_MAX: usize = 1000;
/// The largest size of an array of fixed size.
const ARRAY_MAX: usize = 1 << 24;

/// A message as its file defines it. Other messages in it are given by their names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Definition {
    /// The fields in their order.
    pub fields: Vec<Field<TypeName>>,
    /// The constants in their order.
    pub constants: Vec<Constant>,
}

/// A field. `R` refers to another message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field<R> {
    /// The name.
    pub name: String,
    /// The type of the value, or of each element.
    pub element: Element<R>,
    /// The number of elements.
    pub count: Count,
    /// The text of the default value, if the definition has one.
    pub default: Option<String>,
}

/// The type of a single value, or of an element of a list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Element<R> {
    /// A number or a truth value.
    Primitive(Primitive),
    /// A text.
    Text {
        /// The largest number of bytes, if the type has a limit.
        max: Option<usize>,
    },
    /// Another message.
    Message(R),
}

/// The number of elements of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// A single value, which is not a list.
    One,
    /// An array of this size.
    Array(usize),
    /// A list of any length.
    Any,
    /// A list with at most this number of elements.
    Max(usize),
}

/// A type of fixed size. `char` is [`Primitive::U8`], as in ROS 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Primitive {
    /// `bool`.
    Bool,
    /// `byte`, eight bits without a sign.
    Byte,
    /// `int8`.
    I8,
    /// `uint8`.
    U8,
    /// `int16`.
    I16,
    /// `uint16`.
    U16,
    /// `int32`.
    I32,
    /// `uint32`.
    U32,
    /// `int64`.
    I64,
    /// `uint64`.
    U64,
    /// `float32`.
    F32,
    /// `float64`.
    F64,
}

/// A constant, such as `uint8 OK=0`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Constant {
    /// The name.
    pub name: String,
    /// The type of its value.
    pub of: Element<TypeName>,
    /// The text of its value.
    pub value: String,
}

/// The reason why a definition cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DefinitionError {
    /// A line that is neither a field nor a constant.
    #[error("line {line} of `{name}` is neither a field nor a constant: `{text}`")]
    Line {
        /// The message.
        name: String,
        /// The number of the line, from 1.
        line: usize,
        /// The line.
        text: String,
    },
    /// A type without a definition.
    #[error("no definition of `{0}` is known")]
    Unknown(String),
    /// A message that contains itself, or is too large.
    #[error("`{0}` contains itself, or too many other messages")]
    TooLarge(String),
}

impl Primitive {
    /// All primitives.
    pub const ALL: [Self; 12] = [
        Self::Bool,
        Self::Byte,
        Self::I8,
        Self::U8,
        Self::I16,
        Self::U16,
        Self::I32,
        Self::U32,
        Self::I64,
        Self::U64,
        Self::F32,
        Self::F64,
    ];

    /// Returns the word for the type in a definition.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::Byte => "byte",
            Self::I8 => "int8",
            Self::U8 => "uint8",
            Self::I16 => "int16",
            Self::U16 => "uint16",
            Self::I32 => "int32",
            Self::U32 => "uint32",
            Self::I64 => "int64",
            Self::U64 => "uint64",
            Self::F32 => "float32",
            Self::F64 => "float64",
        }
    }

    /// Returns the size in bytes.
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::Byte | Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    fn parse(text: &str) -> Option<Self> {
        match text {
            "char" => Some(Self::U8),
            _ => Self::ALL.into_iter().find(|primitive| primitive.as_str() == text),
        }
    }
}

impl Definition {
    /// Reads the lines of one message; `owner` is its name.
    ///
    /// # Errors
    /// If a line is neither a field nor a constant, or there are too many lines.
    pub fn parse(owner: &TypeName, text: &str) -> Result<Self, DefinitionError> {
        let mut definition = Self { fields: Vec::new(), constants: Vec::new() };
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            if definition.take(owner, line).is_none() {
                return Err(DefinitionError::Line { name: owner.to_string(), line: index + 1, text: line.to_owned() });
            }
            if definition.fields.len() > FIELDS_MAX || definition.constants.len() > FIELDS_MAX {
                return Err(DefinitionError::TooLarge(owner.to_string()));
            }
        }
        Ok(definition)
    }

    fn take(&mut self, owner: &TypeName, line: &str) -> Option<()> {
        let (of, rest) = line.split_once(char::is_whitespace)?;
        let (element, count) = element(owner, of)?;
        let rest = rest.trim_start();
        let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len());
        let (name, rest) = rest.split_at(end);
        if !name.starts_with(|first: char| first.is_ascii_alphabetic()) {
            return None;
        }
        let (name, rest) = (name.to_owned(), rest.trim_start());
        if let Some(value) = rest.strip_prefix('=') {
            let value = without_comment(value, &element);
            let is_constant = count == Count::One && !matches!(element, Element::Message(_)) && !value.is_empty();
            is_constant.then(|| self.constants.push(Constant { name, of: element, value }))
        } else {
            let default = Some(without_comment(rest, &element)).filter(|default| !default.is_empty());
            self.fields.push(Field { name, element, count, default });
            Some(())
        }
    }
}

/// Returns a value without the comment after it. A text may contain `#`.
fn without_comment(value: &str, of: &Element<TypeName>) -> String {
    let end = match of {
        Element::Text { .. } if !value.trim_start().starts_with('#') => value.len(),
        Element::Text { .. } | Element::Primitive(_) | Element::Message(_) => value.find('#').unwrap_or(value.len()),
    };
    value[..end].trim().to_owned()
}

/// Reads the type of a field: `float64[36]`, `string<=10[<=5]`, `Point`.
fn element(owner: &TypeName, text: &str) -> Option<(Element<TypeName>, Count)> {
    let (of, count) = match text.strip_suffix(']') {
        None => (text, Count::One),
        Some(list) => {
            let (of, count) = list.rsplit_once('[')?;
            (of, count_of(count)?)
        }
    };
    let element = match of.split_once("<=") {
        Some(("string", max)) => Element::Text { max: Some(number(max)?) },
        Some(_) => return None,
        None if of == "string" => Element::Text { max: None },
        None => match Primitive::parse(of) {
            Some(primitive) => Element::Primitive(primitive),
            None => Element::Message(message_name(owner, of)?),
        },
    };
    Some((element, count))
}

/// Returns the message to which a definition refers. A name without a package belongs to the same package.
fn message_name(owner: &TypeName, text: &str) -> Option<TypeName> {
    match text {
        "Header" => TypeName::new("std_msgs", Folder::Msg, text),
        // Texts with two bytes per character have no counterpart here.
        "wstring" => None,
        _ if text.contains('/') => TypeName::parse(text),
        _ => TypeName::new(owner.package(), Folder::Msg, text),
    }
}

fn count_of(text: &str) -> Option<Count> {
    match text.strip_prefix("<=") {
        Some(max) => Some(Count::Max(number(max)?)),
        None if text.is_empty() => Some(Count::Any),
        None => Some(Count::Array(number(text).filter(|size| *size <= ARRAY_MAX)?)),
    }
}

/// Reads a positive number.
fn number(text: &str) -> Option<usize> {
    let is_plain = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    is_plain.then(|| text.parse().ok()).flatten().filter(|number| *number > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn owner() -> TypeName {
        TypeName::parse("a_msgs/B").unwrap()
    }

    #[test]
    fn fields_and_constants_are_read() {
        let text = "# A comment.\n\nstring<=5[<=3] names  # of these\nuint8 OK = 0 # fine\nstring WHO=a # b\nint32 n -5\n\
                    float64[36] covariance\nPoint[] path\nother_msgs/C c\nHeader header\nchar[16] gid\n";
        let Definition { fields, constants } = Definition::parse(&owner(), text).unwrap();
        let field = |name: &str, element, count| Field { name: name.to_owned(), element, count, default: None };
        let message = |name| Element::Message(TypeName::parse(name).unwrap());
        let mut n = field("n", Element::Primitive(Primitive::I32), Count::One);
        n.default = Some("-5".to_owned());
        let expected = [
            field("names", Element::Text { max: Some(5) }, Count::Max(3)),
            n,
            field("covariance", Element::Primitive(Primitive::F64), Count::Array(36)),
            field("path", message("a_msgs/Point"), Count::Any),
            field("c", message("other_msgs/C"), Count::One),
            field("header", message("std_msgs/Header"), Count::One),
            field("gid", Element::Primitive(Primitive::U8), Count::Array(16)),
        ];
        assert_eq!(fields, expected);
        let constants: Vec<_> = constants.iter().map(|one| (one.name.as_str(), one.value.as_str())).collect();
        assert_eq!(constants, [("OK", "0"), ("WHO", "a # b")]);
    }

    #[test]
    fn other_lines_are_refused_with_their_number() {
        let lines = [
            "int32",
            "int32[",
            "int32] a",
            "int32[-1] a",
            "int32[0] a",
            "int32[99999999999] a",
            "int32<=4 a",
            "string<=x a",
            "wstring a",
            "int32 1a",
            "int32[] A=1",
            "Point A=1",
            "int32 A=",
            "a/b/c/d e",
            "---",
        ];
        for line in lines {
            let found = Definition::parse(&owner(), &format!("bool ok\n{line}"));
            let expected = DefinitionError::Line { name: "a_msgs/msg/B".to_owned(), line: 2, text: line.to_owned() };
            assert_eq!(found, Err(expected), "{line}");
        }
    }

    #[test]
    fn a_definition_has_a_limit() {
        let text = |count| "bool a\n".repeat(count);
        assert!(Definition::parse(&owner(), &text(FIELDS_MAX)).is_ok());
        assert!(Definition::parse(&owner(), &text(FIELDS_MAX + 1)).is_err());
    }
}
