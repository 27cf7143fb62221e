//! Values as text, in the form of `ros/generate/values.py`.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use ros::logic::cdr::{self, Value};
use ros::logic::schema::Schema;
use std::fmt::Write;

/// Appends a value. Floats are shown as their bits and texts as their bytes, so the comparison is exact.
fn append(text: &mut String, value: &Value) {
    let mut list = |ends: [char; 2], values: &[Value]| {
        text.push(ends[0]);
        for (index, value) in values.iter().enumerate() {
            text.push_str(if index > 0 { "," } else { "" });
            append(text, value);
        }
        text.push(ends[1]);
    };
    match value {
        Value::Truth(truth) => write!(text, "{truth}").unwrap(),
        Value::Signed(number) => write!(text, "{number}").unwrap(),
        Value::Unsigned(number) => write!(text, "{number}").unwrap(),
        Value::Single(number) => write!(text, "{:08x}", number.to_bits()).unwrap(),
        Value::Double(number) => write!(text, "{:016x}", number.to_bits()).unwrap(),
        Value::Text(one) => {
            let bytes: String = one.bytes().map(|byte| format!("{byte:02x}")).collect();
            write!(text, "\"{bytes}\"").unwrap();
        }
        Value::Bytes(bytes) => {
            let all: Vec<Value> = bytes.iter().map(|byte| Value::Unsigned((*byte).into())).collect();
            list(['[', ']'], &all);
        }
        Value::List(values) => list(['[', ']'], values),
        Value::Record(values) => list(['{', '}'], values),
    }
}

pub(crate) fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len() / 2).map(|at| u8::from_str_radix(&hex[2 * at..2 * at + 2], 16).unwrap()).collect()
}

/// Checks the rest of a line `V`: the bytes are read as this text, and the same bytes are written again.
#[track_caller]
pub(crate) fn check(schema: &Schema, line: &str) {
    let (hex, expected) = line.split_once(' ').unwrap();
    let bytes = bytes(hex);
    let value = cdr::read(schema, &bytes).unwrap_or_else(|why| panic!("{}: {why}: {hex}", schema.name()));
    let mut found = String::new();
    append(&mut found, &value);
    assert_eq!(found, expected, "{}", schema.name());
    assert_eq!(cdr::write(schema, &value).as_ref(), Ok(&bytes), "{}: {expected}", schema.name());
}
