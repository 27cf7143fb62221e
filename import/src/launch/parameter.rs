//! Values of parameters in the form of a spec.

use crate::name::{is_hidden, quoted};

/// The type of a parameter in a spec.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Type {
    Number,
    Truth,
    Text,
    /// Without a type: ROS 2 reads the value as YAML.
    Any,
}

/// A value with its type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Literal {
    pub(super) kind: Type,
    /// As the spec writes it.
    pub(super) text: String,
}

impl Literal {
    /// Returns a value by the rules with which `launch` reads one, or the type that a file says; none if a spec cannot have it.
    ///
    /// Source: YAML 1.1, as PyYAML reads it.
    pub(super) fn of(text: &str, wanted: Option<&str>) -> Option<Self> {
        if text.chars().any(is_hidden) {
            return None;
        }
        let is_integer = |text: &str| {
            let digits = text.strip_prefix('-').unwrap_or(text);
            (1..=15).contains(&digits.len())
                && digits.bytes().all(|byte| byte.is_ascii_digit())
                && (digits == "0" || !digits.starts_with('0'))
        };
        let number = text.parse::<f64>().ok().filter(|found| found.is_finite() && found.abs() < 1e15);
        let number = number.filter(|found| *found == 0.0 || found.abs() > 1e-15);
        let truth = match text {
            "true" | "True" | "TRUE" | "yes" | "Yes" | "YES" | "on" | "On" | "ON" => Some("true"),
            "false" | "False" | "FALSE" | "no" | "No" | "NO" | "off" | "Off" | "OFF" => Some("false"),
            _ => None,
        };
        let plain = |kind, text: &str| Some(Self { kind, text: text.to_owned() });
        match (wanted, truth, number) {
            (Some("str"), _, _) => plain(Type::Text, &quoted(text)),
            (Some("float"), _, Some(number)) => plain(Type::Number, &format!("{number}")),
            (Some("float" | "int" | "bool"), None, None) => None,
            (Some("int"), ..) if !is_integer(text) => None,
            (_, Some(truth), _) => plain(Type::Truth, truth),
            (_, None, Some(_)) if is_integer(text) => plain(Type::Any, text),
            // YAML 1.1 has no numbers such as `1e5`.
            (_, None, Some(number)) if text.contains('.') => plain(Type::Number, &format!("{number}")),
            _ if is_for_ros(text) => plain(Type::Any, &quoted(text)),
            _ => plain(Type::Text, &quoted(text)),
        }
    }

    /// Returns a value that ROS 2 gets as this text.
    pub(super) fn text(text: &str) -> Option<Self> {
        (!text.chars().any(is_hidden)).then(|| Self { kind: Type::Text, text: quoted(text) })
    }

    /// Returns a parameter of a module or of `main`.
    pub(super) fn declared(&self, name: &str) -> String {
        let kind = match self.kind {
            Type::Number => ": Number",
            Type::Truth => ": Truth",
            Type::Text => ": Text",
            Type::Any => "",
        };
        format!("{name}{kind} = {}", self.text)
    }
}

/// Returns whether only ROS 2 reads a text as a list or a number.
fn is_for_ros(text: &str) -> bool {
    let is_octal = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    text.starts_with('[') || is_octal || matches!(text, ".inf" | "-.inf" | ".nan")
}

/// Returns whether a parameter of ROS 2 can be one of a module.
pub(super) fn is_name(name: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    name.len() <= 60
        && name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.chars().all(is_part)
        && name != "host"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_types_of_yaml() {
        for (text, wanted, kind, expected) in [
            ("5", None, Type::Any, "5"),
            ("-5", None, Type::Any, "-5"),
            ("5", Some("str"), Type::Text, "\"5\""),
            ("5", Some("float"), Type::Number, "5"),
            ("5.0", None, Type::Number, "5"),
            ("-0.5", None, Type::Number, "-0.5"),
            ("1e5", None, Type::Text, "\"1e5\""),
            ("007", None, Type::Any, "\"007\""),
            ("True", None, Type::Truth, "true"),
            ("off", None, Type::Truth, "false"),
            ("base \"link\"", None, Type::Text, "\"base \\\"link\\\"\""),
            ("[1.0, 2.0]", None, Type::Any, "\"[1.0, 2.0]\""),
            ("", None, Type::Text, "\"\""),
        ] {
            assert_eq!(Literal::of(text, wanted), Some(Literal { kind, text: expected.to_owned() }), "{text}");
        }
        for (text, wanted) in [("x", Some("int")), ("x", Some("float")), ("1.5", Some("int")), ("a\nb", None)] {
            assert_eq!(Literal::of(text, wanted), None, "{text}");
        }
    }
}
