//! Writes and reads values of any type with serde and postcard, like Rust programs. This is the reference for Python's messages.
//!
//! A line of standard input is `{"type": TYPE, "value": VALUE}` or `{"type": TYPE, "bytes": HEX}`. The answer is one line: the bytes in
//! hexadecimal digits, or the value. It is `null` for bytes that do not have exactly this type. A TYPE is `"number"`, `"truth"`, `"text"`,
//! `"bytes"`, `["optional", TYPE]`, `["list", TYPE, COUNT]` or `["record", [TYPE, ...]]`. A number is given by its bits.
//!
//! A line `{"ros": NAME, "bytes": HEX}` has the CDR of a ROS 2 message. The answer has the bytes that the Rust struct writes, the bytes on
//! a wire, and the fields.

#![expect(clippy::print_stdout, reason = "it answers on standard output")]

use ros::for_each_message;
use ros::typed::{self, Message};
use serde::de::{self, DeserializeSeed, Deserializer, SeqAccess, Visitor};
use serde::ser::{Error as _, Serialize, SerializeSeq, SerializeStruct, SerializeTuple, Serializer};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt;
use std::io::BufRead;

/// A value of a type.
struct Typed<'a>(&'a Value, &'a Value);

impl Typed<'_> {
    fn elements(&self) -> impl Iterator<Item = &Value> {
        self.1.as_array().into_iter().flatten()
    }
}

impl Serialize for Typed<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self(of, value) = self;
        let wrong = || S::Error::custom("the value is not of its type");
        match (of.as_str(), of[0].as_str()) {
            (Some("number"), _) => serializer.serialize_f64(f64::from_bits(value.as_u64().ok_or_else(wrong)?)),
            (Some("truth"), _) => serializer.serialize_bool(value.as_bool().ok_or_else(wrong)?),
            (Some("text"), _) => serializer.serialize_str(value.as_str().ok_or_else(wrong)?),
            (Some("bytes"), _) => serializer.serialize_bytes(&bytes(value).ok_or_else(wrong)?),
            (_, Some("optional")) if value.is_null() => serializer.serialize_none(),
            (_, Some("optional")) => serializer.serialize_some(&Typed(&of[1], value)),
            (_, Some("list")) => {
                let elements: Vec<&Value> = self.elements().collect();
                if of[2].is_null() {
                    let mut list = serializer.serialize_seq(Some(elements.len()))?;
                    elements.iter().try_for_each(|one| list.serialize_element(&Typed(&of[1], one)))?;
                    return list.end();
                }
                let mut list = serializer.serialize_tuple(elements.len())?;
                elements.iter().try_for_each(|one| list.serialize_element(&Typed(&of[1], one)))?;
                list.end()
            }
            _ => {
                let fields = of[1].as_array().ok_or_else(wrong)?;
                let mut record = serializer.serialize_struct("Record", fields.len())?;
                for (of, value) in fields.iter().zip(self.elements()) {
                    record.serialize_field("field", &Typed(of, value))?;
                }
                record.end()
            }
        }
    }
}

/// A type whose values are to be read.
#[derive(Clone, Copy)]
struct Type<'a>(&'a Value);

impl<'de> DeserializeSeed<'de> for Type<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        let of = self.0;
        let count = |value: &Value| value.as_u64().and_then(|count| usize::try_from(count).ok());
        match (of.as_str(), of[0].as_str()) {
            (Some("number"), _) => deserializer.deserialize_f64(self),
            (Some("truth"), _) => deserializer.deserialize_bool(self),
            (Some("text"), _) => deserializer.deserialize_str(self),
            (Some("bytes"), _) => deserializer.deserialize_bytes(self),
            (_, Some("optional")) => deserializer.deserialize_option(self),
            (_, Some("list")) => match count(&of[2]) {
                None => deserializer.deserialize_seq(self),
                Some(count) => deserializer.deserialize_tuple(count, self),
            },
            _ => deserializer.deserialize_tuple(of[1].as_array().map_or(0, Vec::len), self),
        }
    }
}

impl<'de> Visitor<'de> for Type<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a value of the type {}", self.0)
    }

    fn visit_f64<E: de::Error>(self, number: f64) -> Result<Value, E> {
        Ok(json!(number.to_bits()))
    }

    fn visit_bool<E: de::Error>(self, truth: bool) -> Result<Value, E> {
        Ok(json!(truth))
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Value, E> {
        Ok(json!(text))
    }

    fn visit_bytes<E: de::Error>(self, bytes: &[u8]) -> Result<Value, E> {
        Ok(json!(digits(bytes)))
    }

    fn visit_none<E: de::Error>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        Type(&self.0[1]).deserialize(deserializer)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Value, A::Error> {
        let mut all = Vec::new();
        let is_record = self.0[0] == "record";
        loop {
            let of = if is_record { &self.0[1][all.len()] } else { &self.0[1] };
            match elements.next_element_seed(Type(of))? {
                Some(element) => all.push(element),
                None => return Ok(Value::Array(all)),
            }
        }
    }
}

fn digits(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn bytes(digits: &Value) -> Option<Vec<u8>> {
    let digits = digits.as_str()?;
    (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(digits.get(at..at + 2)?, 16).ok()).collect()
}

/// Reads the CDR of a message, and returns the description of Rust's struct.
type Read = fn(&[u8]) -> Option<Value>;

fn read_ros<M: Message + Serialize>(bytes: &[u8]) -> Option<Value> {
    let value = M::from_cdr(bytes).ok()?;
    let (again, wire) = (value.to_cdr().ok()?, postcard::to_stdvec(&value).ok()?);
    Some(json!({ "bytes": digits(&again), "wire": digits(&wire), "value": serde_json::to_value(&value).ok()? }))
}

macro_rules! all {
    ($($package:ident::$name:ident,)+) => {
        BTreeMap::from([$((<typed::$package::$name as Message>::SPEC, read_ros::<typed::$package::$name> as Read),)+])
    };
}

fn answer(line: &str, messages: &BTreeMap<&str, Read>) -> Option<Value> {
    let asked: Value = serde_json::from_str(line).ok()?;
    if let Some(name) = asked["ros"].as_str() {
        return messages.get(name)?(&bytes(&asked["bytes"])?);
    }
    let of = &asked["type"];
    if let Some(value) = asked.get("value") {
        return postcard::to_stdvec(&Typed(of, value)).ok().map(|bytes| json!(digits(&bytes)));
    }
    let bytes = bytes(&asked["bytes"])?;
    let mut deserializer = postcard::Deserializer::from_bytes(&bytes);
    let value = Type(of).deserialize(&mut deserializer).ok()?;
    deserializer.finalize().ok()?.is_empty().then_some(value)
}

fn main() {
    let messages: BTreeMap<&str, Read> = for_each_message!(all);
    for line in std::io::stdin().lock().lines().map_while(Result::ok) {
        println!("{}", answer(&line, &messages).unwrap_or(Value::Null));
    }
}
