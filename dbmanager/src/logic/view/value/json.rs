//! Values as JSON, and in other [`serde`] formats: formats for people get the JSON form, formats for machines get tag
//! and bytes.

use super::text::{self, Fault, TextError};
use super::{Datum, Value};
use serde::de::{Deserializer, Error as _, MapAccess, SeqAccess, Visitor};
use serde::ser::{Serialize, Serializer};
use serde::{Deserialize, de};
use std::collections::BTreeMap;
use std::fmt;

impl Datum {
    /// Returns the value as JSON on one line.
    pub fn to_json(&self) -> String {
        // Writing to memory fails only for names that are not text, and these are text.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Reads a value from JSON.
    ///
    /// # Errors
    /// If the text is not JSON, or is `null`, which is not a value.
    pub fn from_json(text: &str) -> Result<Self, TextError> {
        if let Some((byte, number)) = integers(text).find(|(_, number)| number.parse::<i64>().is_err()) {
            return Err(text::at(text, byte, text::too_large(number)));
        }
        serde_json::from_str(text).map_err(|error| {
            let whole = error.to_string();
            let place = format!(" at line {} column {}", error.line(), error.column());
            let what = whole.strip_suffix(&place).unwrap_or(&whole).to_owned();
            TextError { line: error.line(), column: error.column(), what, hint: String::new() }
        })
    }
}

/// Returns the numbers without point and exponent, with their positions. `serde_json` would read the longest of them as
/// floats.
fn integers(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let (mut quoted, mut escaped) = (false, false);
    let outside = move |character: char| {
        let string = quoted || character == '"';
        match character {
            _ if escaped => escaped = false,
            '\\' => escaped = quoted,
            '"' => quoted = !quoted,
            _ => {}
        }
        string || !(character.is_ascii_alphanumeric() || matches!(character, '-' | '+' | '.'))
    };
    let mut byte = 0;
    let words = text.split(outside).map(move |word| {
        let at = byte;
        byte += word.len();
        // The text was split at one character behind the word; this skips it.
        byte += text.get(byte..).and_then(|rest| rest.chars().next()).map_or(0, char::len_utf8);
        (at, word)
    });
    let digits = |word: &str| {
        let digits = word.strip_prefix('-').unwrap_or(word);
        !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit())
    };
    words.filter(move |(_, word)| digits(word) && *word != "-0")
}

impl Serialize for Datum {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if !serializer.is_human_readable() {
            return self.to_value().serialize(serializer);
        }
        if let Some((tag, content)) = text::tagged(self) {
            return serializer.collect_map([(tag, content)]);
        }
        match self {
            Self::Bool(yes) => serializer.serialize_bool(*yes),
            Self::Integer(number) => serializer.serialize_i64(*number),
            Self::Float(number) => serializer.serialize_f64(number.get()),
            Self::Text(text) => serializer.serialize_str(text),
            Self::List(items) => serializer.collect_seq(items),
            Self::Table(fields) => match text::tag_of(fields) {
                Some(tag) => serializer.collect_map([(format!("${tag}"), &fields[tag])]),
                None => serializer.collect_map(fields),
            },
            Self::Bytes(_) | Self::Sealed(_) | Self::Opaque { .. } => serializer.serialize_unit(),
        }
    }
}

impl<'de> Deserialize<'de> for Datum {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            deserializer.deserialize_any(Reader)
        } else {
            Value::deserialize(deserializer).map(|value| Self::of(&value))
        }
    }
}

struct Reader;

fn refuse<E: de::Error>(fault: Fault) -> E {
    E::custom(fault.joined())
}

impl<'de> Visitor<'de> for Reader {
    type Value = Datum;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_bool<E: de::Error>(self, yes: bool) -> Result<Datum, E> {
        Ok(Datum::Bool(yes))
    }

    fn visit_i64<E: de::Error>(self, number: i64) -> Result<Datum, E> {
        Ok(Datum::Integer(number))
    }

    fn visit_u64<E: de::Error>(self, number: u64) -> Result<Datum, E> {
        i64::try_from(number).map(Datum::Integer).map_err(|_cause| refuse(text::too_large(&number.to_string())))
    }

    fn visit_f64<E: de::Error>(self, number: f64) -> Result<Datum, E> {
        Ok(Datum::float(number))
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Datum, E> {
        Ok(Datum::from(text))
    }

    fn visit_unit<E: de::Error>(self) -> Result<Datum, E> {
        Err(refuse(Fault::new("`null` is not a value", "delete the key instead")))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Datum, A::Error> {
        let mut list = Vec::new();
        while let Some(item) = items.next_element()? {
            list.push(item);
        }
        Ok(Datum::List(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<Datum, A::Error> {
        let mut table = BTreeMap::new();
        while let Some((name, field)) = fields.next_entry::<String, _>()? {
            if table.contains_key(&name) {
                return Err(A::Error::custom(format!("the name {} occurs twice", text::quote(&name))));
            }
            table.insert(name, field);
        }
        text::untag(table).map_err(refuse)
    }
}
