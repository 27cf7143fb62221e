//! Schemas: the values that keys below a prefix may hold.
//!
//! A schema is an ordinary value, a table at `team/schema/<pattern>`. It is written, replicated and watched, and has
//! conflicts, like any other value. A segment `+` of the pattern stands for any one segment, so `robot/+/params/force`
//! applies to every robot.
//!
//! ```toml
//! type = "float"           # bool, integer, float, text, bytes, list, table
//! min = 0.0                # the ends are in the range; of lists and texts it is the length
//! max = 200.0
//! unit = "N"
//! one_of = [0.0, 200.0]    # an enumeration
//! default = 50.0           # what a reader takes if there is nothing
//! required = true          # it is not to be deleted
//! doc = "largest force of the gripper"
//! ```
//!
//! If several schemas match a key, the schema with the longest pattern applies. If several have the longest, the one whose
//! first `+` comes last applies.
//!
//! *A schema is advice to writers.* It is checked before a commit, when the writer can still correct the value. Stored
//! values are never refused or rewritten: they may come from a robot that did not know the schema, and a replica that
//! refused others' data would differ from them for ever. Fields that this program does not know are ignored.

mod check;

pub use check::Breach;

use super::value::Datum;
use crate::logic::key::Key;
use crate::logic::state::State;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::collections::BTreeMap;
use thiserror::Error;

/// The prefix of all schemas.
pub const SCHEMA: &str = "team/schema/";
/// The segment of a pattern that stands for any segment.
const ANY: &str = "+";
/// The names of types, as in [`Datum::kind`].
const KINDS: [&str; 7] = ["bool", "integer", "float", "text", "bytes", "list", "table"];

/// The schema of the keys below a prefix.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Schema {
    /// The type, by its name in [`Datum::kind`].
    pub kind: Option<String>,
    /// The smallest number, or the shortest length.
    pub min: Option<Datum>,
    /// The largest number, or the greatest length.
    pub max: Option<Datum>,
    /// The unit of a number.
    pub unit: Option<String>,
    /// The permitted values; all if empty.
    pub one_of: Vec<Datum>,
    /// The default.
    pub default: Option<Datum>,
    /// Whether the key must have a value.
    pub required: bool,
    /// The description, for people.
    pub doc: String,
}

/// Why a value is not a schema.
#[derive(Clone, Debug, Error, PartialEq, Eq, Serialize, Deserialize)]
pub enum SchemaError {
    /// The schema is not a table.
    #[error("a schema is a table, such as {{type = \"float\", min = 0.0, max = 200.0, unit = \"N\"}}; this is {found}")]
    NoTable {
        /// The type of the value.
        found: String,
    },
    /// A field has another type.
    #[error("the field `{field}` of a schema must be {expected}, got {found}")]
    Field {
        /// The name of the field.
        field: String,
        /// The rule.
        expected: String,
        /// The type of the field.
        found: String,
    },
}

/// All schemas of a team at one version vector.
#[derive(Clone, Debug, Default)]
pub struct Schemas {
    by_pattern: BTreeMap<String, Schema>,
    malformed: Vec<(Key, SchemaError)>,
}

impl Schema {
    /// Reads a schema.
    ///
    /// # Errors
    /// If the value is not a schema.
    pub fn of(datum: &Datum) -> Result<Self, SchemaError> {
        let Datum::Table(fields) = datum else {
            return Err(SchemaError::NoTable { found: datum.to_string() });
        };
        let mut schema = Self::default();
        for (field, datum) in fields {
            schema.set(field, datum).map_err(|expected| SchemaError::Field {
                field: field.clone(),
                expected,
                found: datum.to_string(),
            })?;
        }
        schema.check_own()?;
        Ok(schema)
    }

    /// Sets a field; returns the required type if the value does not have it.
    fn set(&mut self, field: &str, datum: &Datum) -> Result<(), String> {
        let text = || {
            let Datum::Text(text) = datum else { return Err("a text".to_owned()) };
            Ok(text.clone())
        };
        match field {
            "type" => {
                let kind = text()?;
                let known = KINDS.contains(&kind.as_str());
                self.kind = Some(known.then_some(kind).ok_or_else(|| format!("one of {}", KINDS.join(", ")))?);
            }
            "min" | "max" => {
                let number =
                    matches!(datum, Datum::Integer(_)) || matches!(datum, Datum::Float(f) if !f.get().is_nan());
                let end = number.then(|| datum.clone()).ok_or_else(|| "a number".to_owned())?;
                *(if field == "min" { &mut self.min } else { &mut self.max }) = Some(end);
            }
            "unit" => self.unit = Some(text()?),
            "doc" => self.doc = text()?,
            "one_of" => {
                let Datum::List(items) = datum else { return Err("a list of values".to_owned()) };
                if items.is_empty() {
                    return Err("a list with at least one value".to_owned());
                }
                self.one_of.clone_from(items);
            }
            "default" => self.default = Some(datum.clone()),
            "required" => {
                let Datum::Bool(yes) = datum else { return Err("true or false".to_owned()) };
                self.required = *yes;
            }
            _ => {}
        }
        Ok(())
    }

    /// Checks that the fields of the schema do not contradict each other.
    fn check_own(&self) -> Result<(), SchemaError> {
        if let (Some(min), Some(max)) = (&self.min, &self.max)
            && check::compare(min, max) == Some(Ordering::Greater)
        {
            let (field, expected) = ("max".to_owned(), format!("at least min, which is {min}"));
            return Err(SchemaError::Field { field, expected, found: max.to_string() });
        }
        match self.default.as_ref().and_then(|default| Some((default, self.breach(default)?))) {
            Some((default, breach)) => {
                let found = default.to_string();
                Err(SchemaError::Field { field: "default".to_owned(), expected: breach.must_be, found })
            }
            None => Ok(()),
        }
    }
}

impl Schemas {
    /// Reads the schemas of a state. Invalid schemas are kept separately, and do not affect valid schemas.
    pub fn of(state: &State) -> Self {
        let mut schemas = Self::default();
        for (key, versions) in state.scan(SCHEMA) {
            let Some(value) = versions.last().and_then(|version| version.value.as_ref()) else { continue };
            let pattern = key.as_str().strip_prefix(SCHEMA).unwrap_or_default();
            match Schema::of(&Datum::of(value)) {
                Ok(schema) => drop(schemas.by_pattern.insert(pattern.to_owned(), schema)),
                Err(error) => schemas.malformed.push((key.clone(), error)),
            }
        }
        schemas
    }

    /// Returns the values at the keys of schemas that are not schemas.
    pub fn malformed(&self) -> &[(Key, SchemaError)] {
        &self.malformed
    }

    /// Returns the schemas by pattern.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Schema)> {
        self.by_pattern.iter().map(|(pattern, schema)| (pattern.as_str(), schema))
    }

    /// Returns the schema that applies to a key.
    pub fn find(&self, key: &Key) -> Option<&Schema> {
        // People write patterns by hand, so there are few, and all of them can be checked.
        let matching = self.by_pattern.iter().filter(|(pattern, _)| matches(pattern, key.as_str()));
        let rank = |pattern: &str| {
            let literal = pattern.split('/').map(|segment| segment != ANY).collect::<Vec<_>>();
            (literal.len(), literal)
        };
        matching.max_by_key(|(pattern, _)| rank(pattern)).map(|(_, schema)| schema)
    }

    /// Returns the value that a reader of a key gets: the present value, or the default.
    pub fn read(&self, state: &State, key: &Key) -> Option<Datum> {
        let stored = state.get(key).and_then(|version| version.value.as_ref()).map(Datum::of);
        stored.or_else(|| self.find(key)?.default.clone())
    }
}

/// Returns whether a key is at or below a pattern.
fn matches(pattern: &str, key: &str) -> bool {
    let mut segments = key.split('/');
    pattern.split('/').all(|expected| segments.next().is_some_and(|found| expected == ANY || expected == found))
}

#[cfg(test)]
mod tests;
