//! Start values as bytes, in the form in which a controller would leave a value for the next one (postcard).

use super::data::{Data, data, filled};
use crate::algebra::Value;
use crate::check::spec::{self, Expr, Kind, Param, Process, Shape, Spec, StartValue};
use crate::check::types::{declared, takers};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Constant, Given};
use crate::unit;
use std::cell::RefCell;

/// The start values of one group.
pub(super) struct Starts<'a> {
    spec: &'a Spec,
    process: &'a Process,
    /// The values of the parameters of the group.
    values: &'a [Data],
    /// The values that do not fit. A value that is passed on is known here for the first time.
    found: RefCell<Vec<Diagnostic>>,
}

impl<'a> Starts<'a> {
    pub(super) fn new(spec: &'a Spec, process: &'a Process, values: &'a [Data]) -> Self {
        Self { spec, process, values, found: RefCell::default() }
    }

    /// Returns the diagnostics of the values that did not fit.
    pub(super) fn found(self) -> Vec<Diagnostic> {
        self.found.into_inner()
    }

    /// Returns the value that an expression is started with. A value that does not fit is reported, and the result is
    /// none.
    pub(super) fn given(&self, start: &StartValue, part: &Expr) -> Option<Given> {
        let value = match start {
            StartValue::Known(value) => value,
            StartValue::Result(name) => return Some(Given::Result(name.text.clone())),
            StartValue::Kept(..) => return None,
        };
        let takers = takers(self.spec, self.process, part);
        let declared = declared(&takers);
        let param = declared.first().map(|(_, param)| *param);
        let given = self.written(param, value);
        if given.is_none() {
            self.found.borrow_mut().push(misfit(param, value));
        }
        given
    }

    fn written(&self, param: Option<&Param>, value: &spec::Value) -> Option<Given> {
        let given = data(value, self.values)?;
        let given = match param {
            Some(param) => filled(self.spec, param, Some(given))?,
            None => given,
        };
        let mut writer = Writer { spec: self.spec, bytes: Vec::new(), text: String::new() };
        writer.value(param.and_then(|param| param.kind.as_ref()), &given)?;
        Some(Given::Known { text: writer.text, value: Value::new(&writer.bytes) })
    }
}

fn misfit(param: Option<&Param>, value: &spec::Value) -> Diagnostic {
    if let Some((param, kind)) = param.and_then(|param| Some((param, param.kind.as_ref()?))) {
        let message = format!("`{}` is of type {kind}, but this value has another type", param.name.text);
        return Diagnostic::new(Code::E0213, value.span, message).reason(param.name.span, "declared here");
    }
    let message = "the program does not declare the type of its start value";
    let found =
        Diagnostic::new(Code::E0425, value.span, message).help("declare it in the interface: `init goal: Place;`");
    match param {
        Some(param) => found.reason(param.name.span, "has no type"),
        None => found,
    }
}

/// Writes a value as bytes, and as a text that people read.
struct Writer<'a> {
    spec: &'a Spec,
    bytes: Vec<u8>,
    text: String,
}

impl Writer<'_> {
    /// Writes a value. Returns none if the value is not of this type.
    fn value(&mut self, kind: Option<&Kind>, value: &Data) -> Option<()> {
        match (kind.map(|kind| self.spec.shape(kind)), value) {
            (Some(Shape::Record(fields)), Data::Record(given)) => {
                self.text.push_str(if fields.is_empty() { "{" } else { "{ " });
                for (place, field) in fields.iter().enumerate() {
                    let (_, value) = given.iter().find(|(name, _)| *name == field.name.text)?;
                    self.text.push_str(if place == 0 { "" } else { ", " });
                    self.text.push_str(&format!("{} = ", field.name.text));
                    self.value(field.kind.as_ref(), value)?;
                }
                self.text.push_str(if fields.is_empty() { "}" } else { " }" });
                Some(())
            }
            (Some(Shape::List(element, count)), Data::Record(values)) => {
                let element = Kind { text: element.to_owned(), span: kind?.span, fields: None };
                match count {
                    Some(count) if count != values.len() => return None,
                    Some(_) => {}
                    None => self.count(values.len()),
                }
                self.text.push('[');
                for (place, (_, value)) in values.iter().enumerate() {
                    self.text.push_str(if place == 0 { "" } else { ", " });
                    self.value(Some(&element), value)?;
                }
                self.text.push(']');
                Some(())
            }
            (Some(Shape::Plain(name)), Data::Plain(constant, _)) => self.plain(Some(name), constant),
            (None, Data::Plain(constant, _)) => self.plain(None, constant),
            (Some(_), Data::Plain(..) | Data::Record(_)) | (None, Data::Record(_)) => None,
        }
    }

    fn plain(&mut self, name: Option<&str>, constant: &Constant) -> Option<()> {
        let is = |names: &[&str]| name.is_none_or(|name| names.contains(&name));
        match constant {
            Constant::Text(text) if is(&["Text", "Host"]) => {
                self.count(text.len());
                self.bytes.extend(text.as_bytes());
                self.text.push_str(&format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"")));
            }
            Constant::Number(number) if is(&["Number"]) || name.is_some_and(|name| unit::of_type(name).is_some()) => {
                self.bytes.extend(number.to_le_bytes());
                self.text.push_str(&number.to_string());
            }
            Constant::Truth(truth) if is(&["Truth"]) => {
                self.bytes.push(u8::from(*truth));
                self.text.push_str(if *truth { "true" } else { "false" });
            }
            Constant::Text(_) | Constant::Number(_) | Constant::Truth(_) | Constant::Secret(_) => return None,
        }
        Some(())
    }

    /// Writes a length with seven bits in each byte, the least significant first.
    fn count(&mut self, mut count: usize) {
        while count > 0x7f {
            self.bytes.push(u8::try_from(count & 0x7f).unwrap_or_default() | 0x80);
            count >>= 7;
        }
        self.bytes.push(u8::try_from(count).unwrap_or_default());
    }
}
