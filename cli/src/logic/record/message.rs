//! Shows messages of wires as JSON objects with a schema. The interface of the sender gives the layout of the bytes.
//!
//! Samples on wires are encoded with postcard, which does not describe its content. Source:
//! <https://postcard.jamesmunns.com/wire-format>.

use crate::logic::record::schema;
use crate::logic::ros;
use comms::logic::layout::{Build, Field, Layout, Message, Reader, read};
use language::Source;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// The field name of a message that is not a record.
const VALUE: &str = "value";

/// The types of outputs: by module, then by output.
pub type Messages = BTreeMap<String, BTreeMap<String, Message>>;

/// Returns the messages of each output of each module, as far as the texts declare them.
pub(crate) fn messages(interfaces: &[Source]) -> Messages {
    let message = |of: language::Message| Message { name: of.name, layout: layout(of.layout) };
    let outputs = |all: BTreeMap<String, language::Message>| {
        all.into_iter().map(|(output, declared)| (output, message(declared))).collect()
    };
    language::messages(interfaces).into_iter().map(|(module, all)| (module, outputs(all))).collect()
}

fn layout(declared: language::Layout) -> Layout {
    match declared {
        language::Layout::Number { of } => Layout::Number { of },
        language::Layout::Truth => Layout::Truth,
        language::Layout::Text => Layout::Text,
        language::Layout::Ros { of } => Layout::Piece { of },
        language::Layout::Record(fields) => {
            Layout::Record(fields.into_iter().map(|(name, of)| Field { name, layout: layout(of) }).collect())
        }
        language::Layout::List { of, count } => Layout::List { of: Box::new(layout(*of)), count },
    }
}

/// Returns the JSON schema of a message. Lists are arrays, and all kinds of numbers are numbers.
pub(crate) fn schema(title: &str, message: &Message) -> Value {
    let mut schema = match &message.layout {
        Layout::Record(_) => property(&message.layout),
        of @ (Layout::Number { .. } | Layout::Truth | Layout::Text | Layout::Piece { .. } | Layout::List { .. }) => {
            json!({ "type": "object", "properties": { VALUE: property(of) } })
        }
    };
    schema["title"] = json!(title);
    schema
}

fn property(layout: &Layout) -> Value {
    match layout {
        Layout::Number { of } => json!({ "type": "number", "description": of }),
        Layout::Truth => json!({ "type": "boolean" }),
        Layout::Text => json!({ "type": "string" }),
        Layout::Piece { of } => json!({ "type": "object", "description": of }),
        Layout::List { of, .. } => json!({ "type": "array", "items": property(of) }),
        Layout::Record(fields) => {
            let names = names(fields);
            let properties = std::iter::zip(names, fields).map(|(name, field)| (name, property(&field.layout)));
            json!({ "type": "object", "properties": properties.collect::<Map<_, _>>() })
        }
    }
}

/// Returns a name for each field that a viewer can use in a plot.
pub(crate) fn names(fields: &[Field]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for field in fields {
        let name = schema::free_name(schema::plain_name(&field.name), |name| names.iter().any(|other| other == name));
        names.push(name);
    }
    names
}

/// Decodes a message to an object; returns nothing unless all bytes fit the layout. A field is left
/// out if JSON cannot represent its number, for example an infinity.
pub(crate) fn decode(message: &Message, bytes: &[u8]) -> Option<Value> {
    let value = read(&message.layout, bytes, &mut Json)?;
    Some(match (&message.layout, value) {
        (Layout::Record(_) | Layout::Piece { .. }, Some(object)) => object,
        (_, Some(value)) => json!({ VALUE: value }),
        (_, None) => json!({}),
    })
}

/// Makes JSON. Returns nothing for a value with a number that JSON cannot hold.
struct Json;

impl Build for Json {
    type Value = Option<Value>;

    fn number(&mut self, number: f64) -> Option<Value> {
        number.is_finite().then(|| json!(number))
    }

    fn truth(&mut self, truth: bool) -> Option<Value> {
        Some(json!(truth))
    }

    fn text(&mut self, text: &str) -> Option<Value> {
        Some(json!(text))
    }

    fn piece(&mut self, of: &str, bytes: &[u8]) -> Option<Option<Value>> {
        ros::decode(of, bytes).map(Some)
    }

    fn record(&mut self, fields: &[Field], values: Vec<Option<Value>>) -> Option<Value> {
        let fields = std::iter::zip(names(fields), values);
        Some(Value::Object(fields.filter_map(|(name, value)| Some((name, value?))).collect()))
    }

    fn list(&mut self, elements: Vec<Option<Value>>) -> Option<Value> {
        elements.into_iter().collect::<Option<Vec<Value>>>().map(Value::Array)
    }
}

/// For a ROS 2 message, returns its type, such as `ros.sensor.LaserScan`, and its CDR bytes. Returns nothing for another message.
pub(super) fn cdr<'a>(message: &'a Message, bytes: &'a [u8]) -> Option<(&'a str, &'a [u8])> {
    let Layout::Piece { of } = &message.layout else { return None };
    let mut reader = Reader::new(bytes);
    let cdr = reader.piece().filter(|_| reader.rest().is_empty())?;
    Some((of, cdr))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number() -> Layout {
        Layout::Number { of: "Force".to_owned() }
    }

    fn wrench() -> Message {
        let list = |of, count| Layout::List { of: Box::new(of), count };
        let fields = [
            ("force", list(number(), Some(3))),
            ("who", Layout::Text),
            ("soft", Layout::Truth),
            ("near", list(number(), None)),
        ];
        let fields = fields.map(|(name, layout)| Field { name: name.to_owned(), layout }).to_vec();
        Message { name: "Wrench".to_owned(), layout: Layout::Record(fields) }
    }

    #[test]
    fn bytes_are_read_as_postcard_writes_them() {
        let check = |value: &([f64; 3], &str, bool, Vec<f64>), expected: Option<Value>| {
            assert_eq!(decode(&wrench(), &postcard::to_stdvec(value).unwrap()), expected, "{value:?}");
        };
        let long = "ä".repeat(100);
        let near = vec![0.5; 200];
        let all = json!({ "force": [1.0, -2.5, 0.0], "who": long, "soft": true, "near": near });
        check(&([1.0, -2.5, 0.0], &long, true, near.clone()), Some(all));
        let without = json!({ "who": "", "soft": false, "near": [] });
        check(&([1.0, f64::NAN, 0.0], "", false, vec![]), Some(without));
        let whole = postcard::to_stdvec(&([1.0, 2.0, 3.0], "ann", true, vec![4.0])).unwrap();
        for end in 0..whole.len() {
            assert_eq!(decode(&wrench(), &whole[..end]), None, "{end}");
        }
        assert_eq!(decode(&wrench(), &[&whole[..], &[0]].concat()), None, "a byte is left");
        let plain = Message { name: "Force".to_owned(), layout: number() };
        assert_eq!(decode(&plain, &postcard::to_stdvec(&2.0).unwrap()), Some(json!({ "value": 2.0 })));
        assert_eq!(decode(&plain, &postcard::to_stdvec(&2.0_f32).unwrap()), None, "of another size");
        assert_eq!(decode(&plain, &postcard::to_stdvec(&f64::INFINITY).unwrap()), Some(json!({})));
    }

    #[test]
    fn a_schema_has_the_types_of_all_fields() {
        let number = json!({ "type": "number", "description": "Force" });
        let expected = json!({
            "title": "dca.types.Wrench",
            "type": "object",
            "properties": {
                "force": { "type": "array", "items": number },
                "who": { "type": "string" },
                "soft": { "type": "boolean" },
                "near": { "type": "array", "items": number },
            },
        });
        assert_eq!(schema("dca.types.Wrench", &wrench()), expected);
    }
}
