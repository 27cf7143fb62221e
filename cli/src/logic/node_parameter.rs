//! Parameters of ROS 2 nodes: reads their values, and converts texts of users to their values.
//!
//! Source: `rcl_interfaces/msg/ParameterType`, `ParameterValue` and `ParameterDescriptor`.

use serde_json::{Value, json};

/// The kinds of values, in the order of the numbers in `ParameterType`. Each has a word for a person and the field of the value.
const KINDS: [(&str, &str); 10] = [
    ("not set", ""),
    ("a truth", "bool_value"),
    ("an integer", "integer_value"),
    ("a number", "double_value"),
    ("a text", "string_value"),
    ("bytes", "byte_array_value"),
    ("truths", "bool_array_value"),
    ("integers", "integer_array_value"),
    ("numbers", "double_array_value"),
    ("texts", "string_array_value"),
];

/// The kind of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Kind(usize);

impl Kind {
    /// Returns the kind of a value or a descriptor; nothing if it is not a known kind.
    pub(crate) fn of(told: &Value) -> Option<Self> {
        let number = usize::try_from(told.get("type")?.as_u64()?).ok()?;
        (1..KINDS.len()).contains(&number).then_some(Self(number))
    }

    fn word(self) -> &'static str {
        KINDS[self.0].0
    }

    fn field(self) -> &'static str {
        KINDS[self.0].1
    }

    /// Converts a text of a user to a value of this kind.
    ///
    /// # Errors
    /// Describes which values the kind accepts.
    pub(crate) fn read(self, text: &str) -> Result<Value, String> {
        let expected = || format!("expected {}{}", self.word(), self.example());
        let value = match self.0 {
            1 => text.parse::<bool>().ok().map(Value::from),
            2 => text.parse::<i64>().ok().map(Value::from),
            3 => text.parse::<f64>().ok().filter(|number| number.is_finite()).map(Value::from),
            4 => Some(Value::from(text)),
            _ => serde_json::from_str(text).ok().and_then(|list| self.list(list)),
        };
        Ok(json!({ "type": self.0, self.field(): value.ok_or_else(expected)? }))
    }

    /// Returns a list whose values are all of this kind.
    fn list(self, list: Value) -> Option<Value> {
        let Value::Array(values) = list else { return None };
        let is_fit = |value: &Value| match self.0 {
            5 => value.as_u64().is_some_and(|byte| byte <= 255),
            6 => value.is_boolean(),
            7 => value.as_i64().is_some(),
            8 => value.is_number(),
            _ => value.is_string(),
        };
        values.iter().all(is_fit).then_some(Value::Array(values))
    }

    fn example(self) -> &'static str {
        match self.0 {
            1 => ": `true` or `false`",
            2 => ", such as `5`",
            3 => ", such as `0.5`",
            6 => ", such as `[true, false]`",
            5 | 7 => ", such as `[1, 2]`",
            8 => ", such as `[0.5, 1.0]`",
            9 => ", such as `[\"a\", \"b\"]`",
            _ => "",
        }
    }
}

/// Returns the value in a `ParameterValue`; nothing if it is not set.
pub(crate) fn value(told: &Value) -> Option<Value> {
    told.get(Kind::of(told)?.field()).cloned()
}

/// Describes which values a parameter accepts according to its descriptor: `a number in 0.0..1.0, read only`.
pub(crate) fn takes(descriptor: &Value) -> String {
    let mut text = Kind::of(descriptor).map_or("anything", Kind::word).to_owned();
    for name in ["floating_point_range", "integer_range"] {
        let range = descriptor.get(name).and_then(|ranges| ranges.get(0));
        if let Some((from, to)) = range.and_then(|range| Some((range.get("from_value")?, range.get("to_value")?))) {
            text += &format!(" in {from}..{to}");
        }
    }
    if descriptor.get("read_only").and_then(Value::as_bool) == Some(true) {
        text += ", read only";
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_becomes_a_value_of_its_kind() {
        for (number, text, field, expected) in [
            (1, "true", "bool_value", json!(true)),
            (2, "-5", "integer_value", json!(-5)),
            (3, "5", "double_value", json!(5.0)),
            (4, "5", "string_value", json!("5")),
            (4, "", "string_value", json!("")),
            (5, "[0, 255]", "byte_array_value", json!([0, 255])),
            (6, "[]", "bool_array_value", json!([])),
            (7, "[1, -2]", "integer_array_value", json!([1, -2])),
            (8, "[1, 2.5]", "double_array_value", json!([1, 2.5])),
            (9, "[\"a\"]", "string_array_value", json!(["a"])),
        ] {
            let told = Kind(number).read(text).unwrap();
            assert_eq!((&told["type"], &told[field]), (&json!(number), &expected), "{text}");
            assert_eq!(value(&told), Some(expected));
        }
        for (number, text) in [
            (1, "1"),
            (2, "5.0"),
            (2, "9223372036854775808"),
            (3, "NaN"),
            (3, "x"),
            (5, "[256]"),
            (7, "1"),
            (8, "[\"a\"]"),
            (9, "[1]"),
        ] {
            assert!(Kind(number).read(text).unwrap_err().starts_with("expected "), "{text}");
        }
    }

    #[test]
    fn other_answers_have_no_kind() {
        for told in
            [json!({}), json!({"type": 0}), json!({"type": 10}), json!({"type": -1}), json!({"type": "1"}), json!(1)]
        {
            assert_eq!((Kind::of(&told), value(&told)), (None, None), "{told}");
        }
    }

    #[test]
    fn a_descriptor_says_what_is_taken() {
        let range =
            json!({"type": 3, "floating_point_range": [{"from_value": 0.0, "to_value": 1.5}], "integer_range": []});
        assert_eq!(takes(&range), "a number in 0.0..1.5");
        assert_eq!(takes(&json!({"type": 4, "read_only": true})), "a text, read only");
        assert_eq!(takes(&json!({})), "anything");
    }
}
