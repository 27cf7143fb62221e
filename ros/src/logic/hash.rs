//! The hash of a type, RIHS01: SHA-256 of the description of a type as JSON.
//!
//! Source: REP 2016, <https://www.ros.org/reps/rep-2016.html>, and `rosidl_generator_type_description`.

use super::definition::{Count, Element, Field, Primitive};
use super::schema::{Schema, Struct};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The word that ROS 2 Humble writes in place of a hash, because it does not support hashes.
pub const NOT_SUPPORTED: &str = "TypeHashNotSupported";
/// The name of the field that a message without fields has in its description.
const PLACEHOLDER: &str = "structure_needs_at_least_one_member";

/// The numbers of kinds of types in a description.
const MESSAGE: u32 = 1;
const TEXT: u32 = 17;
const TEXT_MAX: u32 = 21;
/// In a list, one of these is added to the number of the element.
const ARRAY: u32 = 48;
const LIST_MAX: u32 = 96;
const LIST: u32 = 144;

/// Returns the hash of a type, as in keys and tokens.
pub fn rihs01(schema: &Schema) -> String {
    let own = description(schema, schema.root());
    let others = schema.structs().iter().skip(1);
    let others: BTreeMap<String, String> = others.map(|one| (one.name.to_string(), description(schema, one))).collect();
    let others: Vec<String> = others.into_values().collect();
    let text = format!("{{\"type_description\": {own}, \"referenced_type_descriptions\": [{}]}}", others.join(", "));
    let mut hash = "RIHS01_".to_owned();
    for byte in Sha256::digest(text.as_bytes()) {
        let _infallible = write!(hash, "{byte:02x}");
    }
    hash
}

fn description(schema: &Schema, of: &Struct) -> String {
    let mut fields: Vec<String> = of.fields.iter().map(|one| field(schema, one)).collect();
    if fields.is_empty() {
        fields.push(field_text(PLACEHOLDER, number(Primitive::U8), Limits { elements: 0, text: 0 }, ""));
    }
    format!("{{\"type_name\": \"{}\", \"fields\": [{}]}}", of.name, fields.join(", "))
}

fn field(schema: &Schema, of: &Field<usize>) -> String {
    let (raised, capacity) = match of.count {
        Count::One => (0, 0),
        Count::Array(size) => (ARRAY, size),
        Count::Max(max) => (LIST_MAX, max),
        Count::Any => (LIST, 0),
    };
    let (kind, text_max, nested) = match &of.element {
        Element::Primitive(primitive) => (number(*primitive), 0, String::new()),
        Element::Text { max: None } => (TEXT, 0, String::new()),
        Element::Text { max: Some(max) } => (TEXT_MAX, *max, String::new()),
        Element::Message(index) => (MESSAGE, 0, schema.at(*index).name.to_string()),
    };
    field_text(&of.name, raised + kind, Limits { elements: capacity, text: text_max }, &nested)
}

/// The size of an array or the limit of a list, and the limit of a text; zero for no limit.
struct Limits {
    elements: usize,
    text: usize,
}

fn field_text(name: &str, kind: u32, limits: Limits, nested: &str) -> String {
    let Limits { elements: capacity, text: text_max } = limits;
    format!(
        "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {kind}, \"capacity\": {capacity}, \"string_capacity\": {text_max}, \
         \"nested_type_name\": \"{nested}\"}}}}"
    )
}

fn number(primitive: Primitive) -> u32 {
    match primitive {
        Primitive::I8 => 2,
        Primitive::U8 => 3,
        Primitive::I16 => 4,
        Primitive::U16 => 5,
        Primitive::I32 => 6,
        Primitive::U32 => 7,
        Primitive::I64 => 8,
        Primitive::U64 => 9,
        Primitive::F32 => 10,
        Primitive::F64 => 11,
        Primitive::Bool => 15,
        Primitive::Byte => 16,
    }
}
