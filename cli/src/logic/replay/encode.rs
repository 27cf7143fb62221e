//! Encodes a recorded value again to the bytes that its process sent.

use crate::logic::record::{RecordedValue, ValueForm, field_names};
use comms::logic::layout::{Field, Layout, Message, Part, Writer, write};
use serde_json::Value;

/// The field name of a message that is not a record.
const VALUE: &str = "value";

/// The names of fields that contain the time of measurement.
const STAMPS: [&str; 2] = ["stamp", "measured"];
/// The size of a number, in bytes.
const NUMBER: usize = 8;
/// The type of the time of measurement.
const TIME: &str = "Time";

/// The bytes of a value, and the position of the time of measurement in them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Encoded {
    pub(crate) bytes: Vec<u8>,
    pub(crate) stamp: Option<usize>,
}

impl Encoded {
    /// Returns the time of measurement, in seconds on the clock of its host.
    pub(crate) fn measured(&self) -> Option<f64> {
        self.bytes.get(self.stamp?..)?.first_chunk().map(|number| f64::from_le_bytes(*number))
    }
}

/// Encodes a value. Returns nothing if the record does not contain the whole value, or if its type is unknown or does not fit.
pub(crate) fn encode(value: &RecordedValue, message: Option<&Message>) -> Option<Encoded> {
    let (mut bytes, mut stamp) = (Vec::new(), None);
    match value.form {
        ValueForm::Cdr => {
            let is_cdr = message.is_none_or(|message| matches!(message.layout, Layout::Piece { .. }));
            is_cdr.then(|| Writer::new(&mut bytes).piece(&value.data))?;
        }
        ValueForm::Json => {
            let object: Value = serde_json::from_slice(&value.data).ok()?;
            let unknown = || raw(&object).map(|bytes| Encoded { bytes, stamp: None });
            let Some(message) = message else { return unknown() };
            let layout = renamed(&message.layout);
            if let Layout::Record(fields) = &layout {
                for field in fields {
                    let begin = bytes.len();
                    let Ok(()) = write_field(field, &object, &mut bytes) else { return unknown() };
                    stamp = stamp.or_else(|| place_of_stamp(field, begin, bytes.len()));
                }
            } else {
                let Some(whole) = object.get(VALUE) else { return unknown() };
                write(&layout, &Json(whole), &mut Writer::new(&mut bytes)).ok()?;
            }
        }
    }
    Some(Encoded { bytes, stamp })
}

fn write_field(field: &Field, object: &Value, bytes: &mut Vec<u8>) -> Result<(), NoSuchPart> {
    write(&field.layout, &Json(object).field(field)?, &mut Writer::new(bytes))
}

/// Returns the position of the time of measurement, if the field contains it: as a number, or as a list of one number.
fn place_of_stamp(field: &Field, begin: usize, end: usize) -> Option<usize> {
    let is_time = |layout: &Layout| matches!(layout, Layout::Number { of } if of == TIME);
    let one = if let Layout::List { of, count: None } = &field.layout { of } else { &field.layout };
    let has_one = is_time(one) && STAMPS.contains(&field.name.as_str());
    // If the time is optional, a byte that says that it is present comes before the number.
    end.checked_sub(NUMBER).filter(|place| has_one && *place >= begin && end - begin <= NUMBER + 1)
}

/// Returns the layout with the field names of a record.
fn renamed(layout: &Layout) -> Layout {
    match layout {
        Layout::Record(fields) => {
            let named = std::iter::zip(field_names(fields), fields);
            Layout::Record(named.map(|(name, field)| Field { name, layout: renamed(&field.layout) }).collect())
        }
        Layout::List { of, count } => Layout::List { of: Box::new(renamed(of)), count: *count },
        Layout::Number { .. } | Layout::Truth | Layout::Text | Layout::Piece { .. } => layout.clone(),
    }
}

/// A value of a record, or a part of such a value.
struct Json<'a>(&'a Value);

/// A part is missing, or it is of another kind.
struct NoSuchPart;

impl Part for Json<'_> {
    type Error = NoSuchPart;

    fn leaf(&self, layout: &Layout, writer: &mut Writer<'_>) -> Result<(), NoSuchPart> {
        match (layout, self.0) {
            (Layout::Number { .. }, Value::Number(number)) => writer.number(number.as_f64().ok_or(NoSuchPart)?),
            (Layout::Truth, Value::Bool(truth)) => writer.truth(*truth),
            (Layout::Text, Value::String(text)) => writer.text(text),
            _ => return Err(NoSuchPart),
        }
        Ok(())
    }

    fn field(&self, field: &Field) -> Result<Self, NoSuchPart> {
        self.0.get(&field.name).map(Json).ok_or(NoSuchPart)
    }

    fn elements(&self, _: &Layout, count: Option<usize>) -> Result<Vec<Self>, NoSuchPart> {
        let elements = self.0.as_array().filter(|all| count.is_none_or(|count| count == all.len()));
        Ok(elements.ok_or(NoSuchPart)?.iter().map(Json).collect())
    }
}

/// Returns the bytes of a value whose type was unknown when it was recorded.
fn raw(object: &Value) -> Option<Vec<u8>> {
    let size = object.get("size")?.as_u64().and_then(|size| usize::try_from(size).ok())?;
    let text = object.get("bytes")?.as_str().filter(|_| object.as_object().is_some_and(|all| all.len() == 2))?;
    from_base64(text).filter(|bytes| bytes.len() == size)
}

/// Decodes base64 text. Source: RFC 4648, section 4.
fn from_base64(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3);
    for four in text.as_bytes().chunks(4) {
        let digits = four.iter().position(|sign| *sign == b'=').unwrap_or(four.len());
        if four.len() != 4 || digits < 2 || four.iter().skip(digits).any(|sign| *sign != b'=') {
            return None;
        }
        let bits = four.iter().take(digits).try_fold(0_u32, |bits, sign| Some(bits << 6 | digit(*sign)?))?;
        let bits = bits << (6 * (4 - digits));
        bytes.extend(bits.to_be_bytes().into_iter().skip(1).take(digits - 1));
    }
    Some(bytes)
}

fn digit(sign: u8) -> Option<u32> {
    Some(match sign {
        b'A'..=b'Z' => u32::from(sign - b'A'),
        b'a'..=b'z' => u32::from(sign - b'a') + 26,
        b'0'..=b'9' => u32::from(sign - b'0') + 52,
        b'+' => 62,
        b'/' => 63,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::record::{Entry, Form, Rows};
    use std::sync::Arc;
    use std::time::Duration;

    fn number() -> Layout {
        Layout::Number { of: "Force".to_owned() }
    }

    /// Records a value as a recorder does, reads it back, and encodes it again.
    fn again(message: Option<&Message>, bytes: &[u8]) -> Option<Vec<u8>> {
        let (from, to) = ("main/a/Out".to_owned(), "main/b/In".to_owned());
        let entry = Entry::Port {
            from,
            to,
            at: Duration::ZERO,
            bytes: bytes.to_vec(),
            message: message.cloned().map(Arc::new),
        };
        let mut rows = Rows::default();
        let row = rows.row(&entry, Duration::ZERO);
        let form = match rows.topics()[row.topic].form {
            Form::Json => ValueForm::Json,
            Form::Ros => ValueForm::Cdr,
        };
        let value = RecordedValue { from: String::new(), to: String::new(), at: Duration::ZERO, form, data: row.data };
        encode(&value, message).map(|encoded| encoded.bytes)
    }

    #[test]
    fn the_time_of_measurement_has_a_place() {
        let field = |name: &str, layout| Field { name: name.to_owned(), layout };
        let time = || Layout::Number { of: "Time".to_owned() };
        let optional = Layout::List { of: Box::new(time()), count: None };
        let place = |fields: Vec<Field>, data: &str| {
            let message = Message { name: "Range".to_owned(), layout: Layout::Record(fields) };
            let data = data.as_bytes().to_vec();
            let value = RecordedValue {
                from: String::new(),
                to: String::new(),
                at: Duration::ZERO,
                form: ValueForm::Json,
                data,
            };
            let encoded = encode(&value, Some(&message)).unwrap();
            (encoded.stamp, encoded.measured())
        };
        let who = || field("who", Layout::Text);
        assert_eq!(place(vec![who(), field("stamp", time())], r#"{"who":"ab","stamp":1.5}"#), (Some(3), Some(1.5)));
        assert_eq!(place(vec![field("measured", time()), who()], r#"{"who":"","measured":2}"#), (Some(0), Some(2.0)));
        assert_eq!(place(vec![field("stamp", optional.clone())], r#"{"stamp":[2.5]}"#), (Some(1), Some(2.5)));
        assert_eq!(place(vec![field("stamp", optional)], r#"{"stamp":[]}"#), (None, None));
        assert_eq!(place(vec![field("stamp", number())], r#"{"stamp":1}"#), (None, None));
        assert_eq!(place(vec![field("until", time())], r#"{"until":1}"#), (None, None));
    }

    #[test]
    fn a_recorded_value_has_the_bytes_that_were_sent() {
        let field = |name: &str, layout| Field { name: name.to_owned(), layout };
        let list = |of, count| Layout::List { of: Box::new(of), count };
        let inner = Layout::Record(vec![field("x", number()), field("who", Layout::Text)]);
        let fields = vec![
            field("force", list(number(), Some(3))),
            field("soft", Layout::Truth),
            field("at", inner.clone()),
            field("way", list(inner, None)),
        ];
        let wrench = Message { name: "Wrench".to_owned(), layout: Layout::Record(fields) };
        let sent = ([0.1, -2.5e-300, 1e22], true, (0.3, "ä\n"), vec![(7.0, ""), (1.0 / 3.0, "b")]);
        let bytes = postcard::to_stdvec(&sent).unwrap();
        assert_eq!(again(Some(&wrench), &bytes), Some(bytes.clone()));
        let unknown = again(None, &bytes);
        assert_eq!(unknown, Some(bytes), "of an unknown type all bytes are recorded");
        let plain = Message { name: "Force".to_owned(), layout: number() };
        let bytes = postcard::to_stdvec(&0.1).unwrap();
        assert_eq!(again(Some(&plain), &bytes), Some(bytes));
        assert_eq!(again(Some(&plain), &postcard::to_stdvec(&f64::NAN).unwrap()), None, "JSON has no such number");
        let ros =
            Message { name: "ros.std.String".to_owned(), layout: Layout::Piece { of: "ros.std.String".to_owned() } };
        let hello = [11, 0, 1, 0, 0, 3, 0, 0, 0, b'h', b'i', 0].to_vec();
        assert_eq!(again(Some(&ros), &hello), Some(hello));
    }

    #[test]
    fn bytes_come_back_from_their_text() {
        for size in 0..20_u8 {
            let bytes: Vec<u8> = (0..size).map(|at| at.wrapping_mul(53).wrapping_add(200)).collect();
            assert_eq!(again(None, &bytes), Some(bytes));
        }
        for wrong in ["A", "A===", "====", "AA=A", "AAA", "AA*A"] {
            assert_eq!(from_base64(wrong), None, "{wrong}");
        }
    }
}
