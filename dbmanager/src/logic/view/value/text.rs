//! Values as TOML and JSON text, in both directions, without loss.
//!
//! A value that the form cannot express is a table with one name that begins with `$`. Examples are `{"$bytes" =
//! "00ff"}`, likewise `$sealed`, `{"$opaque" = "9:00ff"}` with the tag before the bytes, and in JSON `{"$float":
//! "inf"}`. A table that happens to look like this gets a further `$`: `{"$$bytes" = …}`. Bytes are hexadecimal.

use super::{DEPTH_MAX, Datum, Float};
use std::collections::BTreeMap;
use std::fmt;
use thiserror::Error;
use toml::Spanned;
use toml::de::{DeInteger, DeValue};

/// Why a text is not a value, with the position.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub struct TextError {
    /// The line, from 1.
    pub line: usize,
    /// The column of the error, in characters from 1.
    pub column: usize,
    /// The mistake.
    pub what: String,
    /// The advice; may be empty.
    pub hint: String,
}

impl fmt::Display for TextError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, column {}: {}", self.line, self.column, self.what)?;
        if self.hint.is_empty() { Ok(()) } else { write!(f, " ({})", self.hint) }
    }
}

/// A mistake in a part of a text.
pub(in crate::logic::view) struct Fault {
    what: String,
    /// Advice; empty if there is none.
    hint: String,
}

impl Fault {
    pub(in crate::logic::view) fn new(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { what: what.into(), hint: hint.into() }
    }

    /// Returns error and advice in one text.
    pub(super) fn joined(self) -> String {
        let Self { what, hint } = self;
        if hint.is_empty() { what } else { format!("{what} ({hint})") }
    }
}

impl Datum {
    /// Returns the value in TOML on one line.
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        write(self, &mut text);
        text
    }

    /// Reads a value from TOML.
    ///
    /// # Errors
    /// If the text is not such a value.
    pub fn from_toml(text: &str) -> Result<Self, TextError> {
        let value = DeValue::parse(text).map_err(|error| {
            let word = text.trim();
            if word.is_empty() {
                return at(text, 0, Fault::new("there is no value", "an empty text is \"\""));
            }
            let bare = word.starts_with(char::is_alphabetic) && !word.contains(['"', '\'', '\n']);
            let hint = if bare { format!("a text stands in quotes: {}", quote(word)) } else { String::new() };
            let what = error.message().trim().replace('\n', ", ");
            at(text, error.span().map_or(0, |span| span.start), Fault::new(what, hint))
        })?;
        of_toml(text, &value)
    }
}

/// Converts a part of a TOML document to a value; `text` is the document.
pub(in crate::logic::view) fn of_toml(text: &str, value: &Spanned<DeValue<'_>>) -> Result<Datum, TextError> {
    nested(text, value, 0)
}

fn nested(text: &str, value: &Spanned<DeValue<'_>>, depth: usize) -> Result<Datum, TextError> {
    let refuse = |fault: Fault| at(text, value.span().start, fault);
    // A table that only marks the kind of a value adds a level to the text, but not to the value.
    if depth > DEPTH_MAX + 1 {
        return Err(refuse(Fault::new("lists and tables are nested too deeply", "")));
    }
    match value.get_ref() {
        DeValue::String(text) => Ok(Datum::Text(text.to_string())),
        DeValue::Integer(number) => integer(number).map(Datum::Integer).map_err(refuse),
        DeValue::Float(number) => float(number.as_str())
            .map(Datum::float)
            .ok_or_else(|| refuse(Fault::new(format!("{number} is not a 64-bit float"), ""))),
        DeValue::Boolean(yes) => Ok(Datum::Bool(*yes)),
        DeValue::Datetime(_) => Err(refuse(Fault::new("a date is not a value", "write it as a text, in quotes"))),
        DeValue::Array(items) => {
            items.iter().map(|item| nested(text, item, depth + 1)).collect::<Result<_, _>>().map(Datum::List)
        }
        DeValue::Table(fields) => {
            let read = |(name, field): (&Spanned<_>, _)| {
                let name: &std::borrow::Cow<'_, str> = name.get_ref();
                Ok((name.to_string(), nested(text, field, depth + 1)?))
            };
            untag(fields.iter().map(read).collect::<Result<_, _>>()?).map_err(refuse)
        }
    }
}

/// Reads a number of TOML; none if its exponent is too large or too small for 64 bits.
fn float(number: &str) -> Option<f64> {
    let parsed = number.parse::<f64>().ok()?;
    let digits = number.split(['e', 'E']).next().unwrap_or_default();
    let is_lost = parsed.is_infinite() || (parsed == 0.0 && digits.contains(|digit| ('1'..='9').contains(&digit)));
    (!is_lost || number.contains(['i', 'n'])).then_some(parsed)
}

fn integer(number: &DeInteger<'_>) -> Result<i64, Fault> {
    i64::from_str_radix(number.as_str(), number.radix()).map_err(|_cause| too_large(number.as_str()))
}

pub(super) fn too_large(number: &str) -> Fault {
    let hint = "a float has a point or an exponent; a longer number is best a text";
    Fault::new(format!("the integer {number} does not fit into 64 bits with a sign"), hint)
}

/// Returns the value of a table, which may only mark the kind of a value.
pub(super) fn untag(mut fields: BTreeMap<String, Datum>) -> Result<Datum, Fault> {
    let Some(tag) = tag_of(&fields).map(str::to_owned) else { return Ok(Datum::Table(fields)) };
    let content = fields.remove(&tag);
    if let (Some(name), Some(field)) = (tag.strip_prefix('$').filter(|name| name.starts_with('$')), &content) {
        return Ok(Datum::Table(BTreeMap::from([(name.to_owned(), field.clone())])));
    }
    let hint = "write one more `$` before a name that begins with `$` and is alone in its table";
    let Some(Datum::Text(text)) = content else {
        return Err(Fault::new(format!("`{tag}` is not a kind of value"), hint));
    };
    let datum = match tag.as_str() {
        "$bytes" => unhex(&text).map(Datum::Bytes),
        "$sealed" => unhex(&text).map(Datum::Sealed),
        "$opaque" => text.split_once(':').and_then(|(tag, digits)| {
            let (tag, bytes) = (tag.parse().ok()?, unhex(digits)?);
            Some(Datum::Opaque { tag, bytes })
        }),
        "$float" => NAMED_FLOATS.iter().find(|(name, _)| *name == text).map(|(_, number)| Datum::float(*number)),
        _ => return Err(Fault::new(format!("`{tag}` is not a kind of value"), hint)),
    };
    datum.ok_or_else(|| Fault::new(format!("{} is not a `{tag}`", quote(&text)), hint))
}

/// The floats that JSON numbers cannot express.
const NAMED_FLOATS: [(&str, f64); 3] = [("inf", f64::INFINITY), ("-inf", f64::NEG_INFINITY), ("nan", f64::NAN)];

/// Returns the name of a table with a single name that begins with `$`.
pub(super) fn tag_of(fields: &BTreeMap<String, Datum>) -> Option<&str> {
    let (name, _) = fields.first_key_value()?;
    (fields.len() == 1 && name.starts_with('$')).then_some(name)
}

/// Returns the name and the content of the table for a value that has no form of its own.
pub(super) fn tagged(datum: &Datum) -> Option<(&'static str, String)> {
    match datum {
        Datum::Bytes(bytes) => Some(("$bytes", hex(bytes))),
        Datum::Sealed(bytes) => Some(("$sealed", hex(bytes))),
        Datum::Opaque { tag, bytes } => Some(("$opaque", format!("{tag}:{}", hex(bytes)))),
        Datum::Float(number) => {
            let same = |(_, known): &&(&str, f64)| Float::new(*known) == *number;
            NAMED_FLOATS.iter().find(same).map(|(name, _)| ("$float", (*name).to_owned()))
        }
        Datum::Bool(_) | Datum::Integer(_) | Datum::Text(_) | Datum::List(_) | Datum::Table(_) => None,
    }
}

fn write(datum: &Datum, text: &mut String) {
    match datum {
        Datum::Bool(yes) => text.push_str(if *yes { "true" } else { "false" }),
        Datum::Integer(number) => text.push_str(&number.to_string()),
        Datum::Float(number) if number.get().is_nan() => text.push_str("nan"),
        // The shortest digits that give the same number again, always with a point or an exponent.
        Datum::Float(number) => text.push_str(&format!("{number:?}")),
        Datum::Text(content) => text.push_str(&quote(content)),
        Datum::List(items) => {
            text.push('[');
            for (index, item) in items.iter().enumerate() {
                text.push_str(if index == 0 { "" } else { ", " });
                write(item, text);
            }
            text.push(']');
        }
        Datum::Table(fields) => {
            text.push('{');
            for (index, (name, field)) in fields.iter().enumerate() {
                text.push_str(if index == 0 { "" } else { ", " });
                match tag_of(fields) {
                    Some(tag) => text.push_str(&quote(&format!("${tag}"))),
                    None => text.push_str(&name_in_table(name)),
                }
                text.push_str(" = ");
                write(field, text);
            }
            text.push('}');
        }
        Datum::Bytes(_) | Datum::Sealed(_) | Datum::Opaque { .. } => {
            let (tag, content) = tagged(datum).unwrap_or_default();
            text.push_str(&format!("{{\"{tag}\" = {}}}", quote(&content)));
        }
    }
}

fn name_in_table(name: &str) -> String {
    let plain = |character: char| character.is_ascii_alphanumeric() || matches!(character, '-' | '_');
    if !name.is_empty() && name.chars().all(plain) { name.to_owned() } else { quote(name) }
}

/// Returns a text in quotes, in the form that both TOML and JSON read.
pub fn quote(text: &str) -> String {
    let mut quoted = String::with_capacity(text.len() + 2);
    quoted.push('"');
    for character in text.chars() {
        match character {
            '"' => quoted.push_str("\\\""),
            '\\' => quoted.push_str("\\\\"),
            '\n' => quoted.push_str("\\n"),
            '\r' => quoted.push_str("\\r"),
            '\t' => quoted.push_str("\\t"),
            // TOML requires these to be escaped; all of them are below U+10000.
            _ if character.is_control() => quoted.push_str(&format!("\\u{:04x}", u32::from(character))),
            _ => quoted.push(character),
        }
    }
    quoted.push('"');
    quoted
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(digits: &str) -> Option<Vec<u8>> {
    let (pairs, []) = digits.as_bytes().as_chunks::<2>() else { return None };
    let digit = |byte: u8| char::from(byte).to_digit(16).and_then(|digit| u8::try_from(digit).ok());
    pairs.iter().map(|[high, low]| Some(digit(*high)? << 4 | digit(*low)?)).collect()
}

/// Returns the error with its position in a text, given as a byte index.
pub(in crate::logic::view) fn at(text: &str, byte: usize, fault: Fault) -> TextError {
    let before = text.get(..byte).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or(before).chars().count() + 1;
    TextError { line, column, what: fault.what, hint: fault.hint }
}
