//! Converts the values of programs to values of scripts, and back: the only place that knows both forms.
//!
//! | type | in a script |
//! |---|---|
//! | a number, a quantity | `f64`; the result may also be a whole number |
//! | `Truth`, `Text` | `bool`, a string |
//! | a record, a list | a map, an array |
//! | no value | `()` |

use super::engine::{ELEMENTS_MAX, TEXT_MAX, as_float};
use super::{ScriptError, ScriptResult};
use crate::algebra::Value;
use crate::message::Layout;
use rhai::{Array, Dynamic, Map};

/// Reads a value of this layout. An empty value is `()`, unless the type needs no bytes. `name` is for errors.
pub(super) fn read(value: &Value, layout: &Layout, name: &str) -> Result<Dynamic, ScriptError> {
    // As in the engine, the outermost list or record is not counted.
    let mut reader = Reader { bytes: value.bytes(), left: ELEMENTS_MAX + 1 };
    let read = reader.value(layout).and_then(|read| if reader.bytes.is_empty() { Ok(read) } else { Err(Wrong::Bytes) });
    if read.is_err() && value.bytes().is_empty() {
        return Ok(Dynamic::UNIT);
    }
    read.map_err(|wrong| match wrong {
        Wrong::Bytes => ScriptError::failed(&format!("the bytes of `{name}` are not a value of its type")),
        Wrong::Size => ScriptError::budget(&format!(
            "`{name}` has a text of more than {TEXT_MAX} bytes, or more than {ELEMENTS_MAX} values"
        )),
    })
}

/// Why a value cannot be read.
enum Wrong {
    Bytes,
    Size,
}

struct Reader<'b> {
    bytes: &'b [u8],
    /// How many more values may be read.
    left: usize,
}

impl Reader<'_> {
    fn value(&mut self, layout: &Layout) -> Result<Dynamic, Wrong> {
        self.left = self.left.checked_sub(1).ok_or(Wrong::Size)?;
        match layout {
            Layout::Number { .. } => {
                let bytes = self.take(8)?.try_into().ok().ok_or(Wrong::Bytes)?;
                Ok(Dynamic::from_float(f64::from_le_bytes(bytes)))
            }
            Layout::Truth => match self.take(1)? {
                [0] => Ok(Dynamic::FALSE),
                [1] => Ok(Dynamic::TRUE),
                _ => Err(Wrong::Bytes),
            },
            Layout::Text => {
                let length = self.count()?;
                let text = std::str::from_utf8(self.take(length)?).ok().ok_or(Wrong::Bytes)?;
                if length > TEXT_MAX { Err(Wrong::Size) } else { Ok(Dynamic::from(text.to_owned())) }
            }
            Layout::Record(fields) => {
                let field = |(name, layout): &(String, Layout)| Ok((name.as_str().into(), self.value(layout)?));
                Ok(Dynamic::from_map(fields.iter().map(field).collect::<Result<Map, Wrong>>()?))
            }
            Layout::List { of, count } => {
                let count = match count {
                    Some(count) => *count,
                    None => self.count()?,
                };
                if count > self.left {
                    return Err(Wrong::Size);
                }
                Ok(Dynamic::from_array((0..count).map(|_| self.value(of)).collect::<Result<Array, Wrong>>()?))
            }
            // The checker refuses scripts that read messages of ROS 2.
            Layout::Ros { .. } => Err(Wrong::Bytes),
        }
    }

    fn take(&mut self, count: usize) -> Result<&[u8], Wrong> {
        let (taken, rest) = self.bytes.split_at_checked(count).ok_or(Wrong::Bytes)?;
        self.bytes = rest;
        Ok(taken)
    }

    /// Reads a length, with seven bits in each byte, the least significant first.
    fn count(&mut self) -> Result<usize, Wrong> {
        let mut count = 0_usize;
        for shift in (0..32).step_by(7) {
            let byte = self.take(1)?[0];
            count |= usize::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Ok(count);
            }
        }
        Err(Wrong::Bytes)
    }
}

/// A value that is not known before a run. It has every type.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unknown;

/// Writes the result of a script as a value of the declared type. No type has the value `()`. The limits of the engine
/// bound the result as well.
pub(super) fn written(value: &Dynamic, result: &ScriptResult) -> Result<Value, ScriptError> {
    let mut writer = Writer { bytes: Vec::new(), result, path: String::new() };
    writer.value(value, &result.layout)?;
    Ok(Value::new(&writer.bytes))
}

struct Writer<'r> {
    bytes: Vec<u8>,
    result: &'r ScriptResult,
    /// The place in the result of the value that is written: `.pose.x`.
    path: String,
}

impl Writer<'_> {
    fn value(&mut self, value: &Dynamic, layout: &Layout) -> Result<(), ScriptError> {
        if value.is::<Unknown>() {
            return Ok(());
        }
        match layout {
            Layout::Number { .. } => {
                let number = value.as_float().or_else(|_| value.as_int().map(as_float));
                let number = number.ok().ok_or_else(|| self.misfit("a number", named(value)))?;
                if !number.is_finite() {
                    return Err(self.misfit("a finite number", &number.to_string()));
                }
                self.bytes.extend(number.to_le_bytes());
            }
            Layout::Truth => {
                let truth = value.as_bool().ok().ok_or_else(|| self.misfit("`true` or `false`", named(value)))?;
                self.bytes.push(u8::from(truth));
            }
            Layout::Text => {
                let text = value.clone().into_string().ok().ok_or_else(|| self.misfit("a text", named(value)))?;
                self.count(text.len());
                self.bytes.extend(text.as_bytes());
            }
            Layout::Record(fields) => self.record(value, fields)?,
            Layout::List { of, count } => self.list(value, of, *count)?,
            Layout::Ros { .. } => return Err(self.misfit("a message of ROS 2", named(value))),
        }
        Ok(())
    }

    fn record(&mut self, value: &Dynamic, fields: &[(String, Layout)]) -> Result<(), ScriptError> {
        let map = value.as_map_ref().ok().ok_or_else(|| self.misfit("a record", named(value)))?;
        let has = |key: &str| fields.iter().any(|(name, _)| name == key);
        if let Some(other) = map.keys().find(|key| !has(key)) {
            return Err(self.misfit("a record of this type", &format!("one with a field `{other}`")));
        }
        for (name, layout) in fields {
            let Some(value) = map.get(name.as_str()) else {
                return Err(self.misfit(&format!("a field `{name}`"), "a record without it"));
            };
            self.inside(&format!(".{name}"), value, layout)?;
        }
        Ok(())
    }

    fn list(&mut self, value: &Dynamic, of: &Layout, count: Option<usize>) -> Result<(), ScriptError> {
        let list = value.as_array_ref().ok().ok_or_else(|| self.misfit("a list", named(value)))?;
        match count {
            Some(count) if count != list.len() => {
                return Err(self.misfit(&format!("{count} values"), &list.len().to_string()));
            }
            Some(_) => {}
            None => self.count(list.len()),
        }
        for (index, value) in list.iter().enumerate() {
            self.inside(&format!("[{index}]"), value, of)?;
        }
        Ok(())
    }

    fn inside(&mut self, part: &str, value: &Dynamic, layout: &Layout) -> Result<(), ScriptError> {
        let length = self.path.len();
        self.path.push_str(part);
        self.value(value, layout)?;
        self.path.truncate(length);
        Ok(())
    }

    fn misfit(&self, needed: &str, given: &str) -> ScriptError {
        let ScriptResult { variable, of, .. } = self.result;
        let place = if self.path.is_empty() { "it".to_owned() } else { format!("`{variable}{}`", self.path) };
        ScriptError::failed(&format!("`{variable}` is of type `{of}`, so {place} needs {needed}, not {given}"))
    }

    fn count(&mut self, mut count: usize) {
        while count > 0x7f {
            self.bytes.push((count & 0x7f | 0x80).to_le_bytes()[0]);
            count >>= 7;
        }
        self.bytes.push(count.to_le_bytes()[0]);
    }
}

/// Returns the kind of a value in words.
fn named(value: &Dynamic) -> &'static str {
    match value.type_name() {
        "()" => "`()`",
        "bool" => "a truth value",
        "i64" | "f64" => "a number",
        "string" => "a text",
        "char" => "a letter",
        "map" => "a record",
        "array" => "a list",
        "Fn" => "a function",
        _ => "a value of another type",
    }
}
