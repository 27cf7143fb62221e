//! Messages of wires as JSON objects with a schema. The interface of the sender gives the layout of the bytes.
//!
//! Samples on wires are encoded with postcard, which says nothing of what is in them. Source: <https://postcard.jamesmunns.com/wire-format>.

use crate::logic::record::schema;
use language::{Layout, Message};
use serde_json::{Map, Value, json};

/// Field of a message that is no record.
const VALUE: &str = "value";
/// How many bytes the length of something takes at most.
const LENGTH_BYTES_MAX: usize = 10;

/// Returns the schema of a message. Lists are arrays; every number is one.
pub(super) fn schema(title: &str, message: &Message) -> Value {
    let mut schema = match &message.layout {
        Layout::Record(_) => property(&message.layout),
        of @ (Layout::Number { .. } | Layout::Truth | Layout::Text | Layout::List { .. }) => {
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
        Layout::List { of, .. } => json!({ "type": "array", "items": property(of) }),
        Layout::Record(fields) => {
            let names = names(fields);
            let properties = std::iter::zip(names, fields).map(|(name, (_, of))| (name, property(of)));
            json!({ "type": "object", "properties": properties.collect::<Map<_, _>>() })
        }
    }
}

/// Returns a name for each field that a viewer can plot by.
fn names(fields: &[(String, Layout)]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for (field, _) in fields {
        let name = schema::free_name(schema::plain_name(field), |name| names.iter().any(|other| other == name));
        names.push(name);
    }
    names
}

/// Returns a message as an object; nothing if the bytes are not laid out so, to the last one. A field with a number that JSON
/// has not, as an infinite one, is left out.
pub(crate) fn decode(message: &Message, bytes: &[u8]) -> Option<Value> {
    let mut reader = Reader { rest: bytes };
    let value = reader.value(&message.layout)?;
    if !reader.rest.is_empty() {
        return None;
    }
    Some(match (&message.layout, value) {
        (Layout::Record(_), Some(object)) => object,
        (_, Some(value)) => json!({ VALUE: value }),
        (_, None) => json!({}),
    })
}

struct Reader<'a> {
    rest: &'a [u8],
}

impl Reader<'_> {
    /// Returns the next value: nothing if there is none, `Some(None)` if it has a number that JSON has not.
    fn value(&mut self, layout: &Layout) -> Option<Option<Value>> {
        match layout {
            Layout::Number { .. } => {
                let (number, rest) = self.rest.split_first_chunk()?;
                self.rest = rest;
                let number = f64::from_le_bytes(*number);
                Some(number.is_finite().then(|| json!(number)))
            }
            Layout::Truth => match self.bytes(1)? {
                [0] => Some(Some(json!(false))),
                [1] => Some(Some(json!(true))),
                _ => None,
            },
            Layout::Text => {
                let length = self.length()?;
                let text = std::str::from_utf8(self.bytes(length)?).ok()?;
                Some(Some(json!(text)))
            }
            Layout::Record(fields) => {
                let mut object = Map::new();
                for (name, (_, of)) in std::iter::zip(names(fields), fields) {
                    let value = self.value(of)?;
                    object.extend(value.map(|value| (name, value)));
                }
                Some(Some(Value::Object(object)))
            }
            Layout::List { of, count } => {
                let count = count.map_or_else(|| self.length(), Some)?;
                // An element has a byte at least.
                if count > self.rest.len() {
                    return None;
                }
                let elements: Vec<Option<Value>> = (0..count).map(|_| self.value(of)).collect::<Option<_>>()?;
                Some(elements.into_iter().collect::<Option<Vec<Value>>>().map(Value::Array))
            }
        }
    }

    fn bytes(&mut self, count: usize) -> Option<&[u8]> {
        let (bytes, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(bytes)
    }

    /// Reads a number of variable length: seven bits a byte, the lowest first.
    fn length(&mut self) -> Option<usize> {
        let mut length = 0_u64;
        for place in 0..LENGTH_BYTES_MAX {
            let [byte] = *self.bytes(1)? else { return None };
            length |= u64::from(byte & 0x7f).checked_shl(u32::try_from(7 * place).ok()?)?;
            if byte < 0x80 {
                return usize::try_from(length).ok();
            }
        }
        None
    }
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
        let fields = fields.map(|(name, of)| (name.to_owned(), of)).to_vec();
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
    fn nothing_that_is_sent_makes_it_take_memory_or_time() {
        let list = |of, count| Layout::List { of: Box::new(of), count };
        let empty = || Layout::Record(Vec::new());
        for layout in [list(empty(), None), list(empty(), Some(usize::MAX)), list(number(), None), Layout::Text] {
            let message = Message { name: "Any".to_owned(), layout };
            assert_eq!(decode(&message, &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01]), None);
            assert_eq!(decode(&message, &[0xff; 20]), None);
        }
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
