//! Checks values against a schema, and explains violations to the writer.

use super::{ANY, SCHEMA, Schema, SchemaError, Schemas};
use crate::logic::key::Key;
use crate::logic::state::State;
use crate::logic::txn::Draft;
use crate::logic::view::value::Datum;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::fmt;

/// A violation of a schema, as one sentence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Breach {
    /// The key.
    pub key: String,
    /// The violated rule.
    pub(super) must_be: String,
    /// The value; nothing for a deletion.
    pub(super) found: Option<String>,
    /// The advice; may be empty.
    pub(super) hint: String,
}

impl fmt::Display for Breach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { key, must_be, found, hint } = self;
        write!(f, "{key} must {}{must_be}", if found.is_some() { "be " } else { "" })?;
        if let Some(found) = found {
            write!(f, ", got {found}")?;
        }
        if hint.is_empty() { Ok(()) } else { write!(f, " ({hint})") }
    }
}

impl Schema {
    /// Returns how a value violates the schema. None if the value is valid.
    pub fn breach(&self, datum: &Datum) -> Option<Breach> {
        let breach = |must_be: String, hint: &str| {
            let (found, hint) = (Some(datum.to_string()), hint.to_owned());
            Some(Breach { key: String::new(), must_be, found, hint })
        };
        // Values that cannot be read cannot be checked.
        if matches!(datum, Datum::Sealed(_) | Datum::Opaque { .. }) {
            return None;
        }
        if let Some(kind) = self.kind.as_deref().filter(|kind| *kind != datum.kind()) {
            let article = if kind == "integer" { "an" } else { "a" };
            let article = if kind == "bytes" { String::new() } else { format!("{article} ") };
            let hint = match (kind, datum) {
                ("float", Datum::Integer(number)) => format!("as a float it is written {number}.0"),
                ("text", _) => "a text stands in quotes".to_owned(),
                _ => String::new(),
            };
            return breach(format!("{article}{kind}"), &hint);
        }
        if !self.one_of.is_empty() && !self.one_of.contains(datum) {
            let all: Vec<String> = self.one_of.iter().map(Datum::to_string).collect();
            return breach(format!("one of {}", all.join(", ")), "");
        }
        let (size, what) = match datum {
            Datum::Integer(_) | Datum::Float(_) => (datum.clone(), ""),
            Datum::Text(text) => (length(text.chars().count()), " characters"),
            Datum::Bytes(bytes) => (length(bytes.len()), " bytes"),
            Datum::List(items) => (length(items.len()), " values"),
            Datum::Bool(_) | Datum::Table(_) | Datum::Sealed(_) | Datum::Opaque { .. } => return None,
        };
        // A value that cannot be compared, such as NaN, is outside every range.
        let within = |end: &Option<Datum>, wrong: Ordering| {
            end.as_ref().is_none_or(|end| compare(&size, end).is_some_and(|order| order != wrong))
        };
        if within(&self.min, Ordering::Less) && within(&self.max, Ordering::Greater) {
            return None;
        }
        let long = if what.is_empty() { "" } else { " long" };
        let unit = match &self.unit {
            Some(unit) if what.is_empty() => format!(" {unit}"),
            _ => what.to_owned(),
        };
        let range = match (&self.min, &self.max) {
            (Some(min), Some(max)) if min == max => format!("{}{unit}{long}", number(min)),
            (Some(min), Some(max)) => format!("between {} and {}{unit}{long}", number(min), number(max)),
            (Some(min), None) => format!("at least {}{unit}{long}", number(min)),
            (None, Some(max)) => format!("at most {}{unit}{long}", number(max)),
            (None, None) => return None,
        };
        let found = if what.is_empty() { number(&size) } else { format!("{}{what}", number(&size)) };
        Some(Breach { key: String::new(), must_be: range, found: Some(found), hint: String::new() })
    }
}

impl Schemas {
    /// Returns the violations of a transaction, by key. They are reported before the commit; the caller may commit
    /// anyway.
    pub fn check(&self, draft: &Draft) -> Vec<Breach> {
        let breach = |(key, value): (&Key, Option<&_>)| {
            let datum = value.map(Datum::of);
            if let Some(datum) = datum.as_ref().filter(|_| key.as_str().starts_with(SCHEMA)) {
                return Schema::of(datum).err().map(|error| own(key, error));
            }
            let schema = self.find(key)?;
            let breach = match &datum {
                Some(datum) => schema.breach(datum)?,
                None if schema.required => {
                    let (key, hint) = (String::new(), schema.doc.clone());
                    Breach { key, must_be: "not be deleted: it is required".to_owned(), found: None, hint }
                }
                None => return None,
            };
            Some(Breach { key: key.to_string(), ..breach })
        };
        draft.writes().filter_map(breach).collect()
    }

    /// Returns the violations of a state. These are values that were written before the schema, or by a caller that
    /// committed anyway, and required keys without `+` that have no value.
    pub fn audit(&self, state: &State) -> Vec<Breach> {
        let mut breaches: Vec<Breach> = Vec::new();
        for (key, versions) in state.scan("") {
            let Some(value) = versions.last().and_then(|version| version.value.as_ref()) else { continue };
            let breach = self.find(key).and_then(|schema| schema.breach(&Datum::of(value)));
            breaches.extend(breach.map(|breach| Breach { key: key.to_string(), ..breach }));
        }
        let required = self.iter().filter(|(pattern, schema)| {
            let one = schema.required && schema.default.is_none() && !pattern.split('/').any(|segment| segment == ANY);
            one && Key::new(*pattern).is_ok_and(|key| state.get(&key).is_none())
        });
        breaches.extend(required.map(|(pattern, schema)| Breach {
            key: pattern.to_owned(),
            must_be: "have a value: it is required".to_owned(),
            found: None,
            hint: schema.doc.clone(),
        }));
        breaches.extend(self.malformed.iter().map(|(key, error)| own(key, error.clone())));
        breaches
    }
}

/// Returns the violation for an invalid schema.
fn own(key: &Key, error: SchemaError) -> Breach {
    Breach { key: key.to_string(), must_be: "hold a schema".to_owned(), found: None, hint: error.to_string() }
}

/// Returns the exact order of two values that are numbers; none for other values.
pub(super) fn compare(left: &Datum, right: &Datum) -> Option<Ordering> {
    if let (Datum::Integer(left), Datum::Integer(right)) = (left, right) {
        Some(left.cmp(right))
    } else if let (Datum::Float(left), Datum::Float(right)) = (left, right) {
        left.get().partial_cmp(&right.get())
    } else if let (Datum::Integer(left), Datum::Float(right)) = (left, right) {
        mixed(*left, right.get())
    } else if let (Datum::Float(left), Datum::Integer(right)) = (left, right) {
        mixed(*right, left.get()).map(Ordering::reverse)
    } else {
        None
    }
}

/// Returns the order of an integer and a float. They are first compared as floats, since rounding keeps the order. If
/// these are equal, the float is whole, and both are compared as integers.
fn mixed(integer: i64, float: f64) -> Option<Ordering> {
    #[expect(clippy::cast_precision_loss, reason = "rounding to the nearest keeps the order")]
    let rounded = integer as f64;
    #[expect(clippy::cast_possible_truncation, reason = "it is whole and no larger than 2^63 where this is looked at")]
    let whole = float as i128;
    Some(rounded.partial_cmp(&float)?.then(i128::from(integer).cmp(&whole)))
}

fn length(count: usize) -> Datum {
    Datum::Integer(i64::try_from(count).unwrap_or(i64::MAX))
}

/// Returns a number in the form that people write: `200`, not `200.0`.
fn number(datum: &Datum) -> String {
    if let Datum::Float(number) = datum
        && !number.get().is_nan()
    {
        return number.get().to_string();
    }
    datum.to_string()
}
