//! Values of parameters in the form of a spec.

use crate::name::{is_hidden, quoted};
use ros::logic::yaml::{Scalar, YamlValue, python_float, python_integer};

/// A value with its type.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Literal(YamlValue);

impl Literal {
    /// Returns a value by the rules with which `launch` reads one, or the type that a file says; none if a spec cannot have it.
    pub(super) fn of(text: &str, wanted: Option<&str>) -> Option<Self> {
        if text.chars().any(is_hidden) {
            return None;
        }
        let value = match wanted {
            Some("str") => YamlValue::One(Scalar::Text(text.to_owned())),
            Some("int") => YamlValue::One(Scalar::Integer(python_integer(text)?)),
            Some("float") => YamlValue::One(Scalar::Float(python_float(text)?)),
            Some("bool") => YamlValue::of(text).filter(|value| matches!(value, YamlValue::One(Scalar::Truth(_))))?,
            Some(_) | None => YamlValue::of(text)?,
        };
        // ROS 2 does not accept an empty array on a command line.
        (value != YamlValue::List(Vec::new())).then_some(Self(value))
    }

    /// Returns a value that ROS 2 gets as this text.
    pub(super) fn text(text: &str) -> Option<Self> {
        Self::of(text, Some("str"))
    }

    /// Returns whether it is a text.
    pub(super) fn is_text(&self) -> bool {
        matches!(self.0, YamlValue::One(Scalar::Text(_)))
    }

    /// Returns whether a spec can write it: its numbers are finite and have at most 15 digits.
    pub(super) fn is_of_spec(&self) -> bool {
        let is_fit = |scalar: &Scalar| match scalar {
            Scalar::Integer(number) => number.unsigned_abs() < 1_000_000_000_000_000,
            Scalar::Float(number) => *number == 0.0 || number.abs() > 1e-15 && number.abs() < 1e15,
            Scalar::Truth(_) | Scalar::Text(_) => true,
        };
        self.scalars().iter().all(is_fit)
    }

    fn scalars(&self) -> &[Scalar] {
        match &self.0 {
            YamlValue::One(scalar) => std::slice::from_ref(scalar),
            YamlValue::List(scalars) => scalars,
        }
    }

    /// The items, each in this form.
    fn written(&self, form: impl Fn(&Scalar) -> String) -> String {
        let items: Vec<String> = self.scalars().iter().map(form).collect();
        match self.0 {
            YamlValue::One(_) => items.concat(),
            YamlValue::List(_) => format!("[{}]", items.join(", ")),
        }
    }

    /// Returns a parameter of a module or of `main`.
    pub(super) fn declared(&self, name: &str) -> String {
        // An integer has no type: ROS 2 tells it from other numbers.
        let kind = match self.scalars().first() {
            Some(Scalar::Float(_)) => "Number",
            Some(Scalar::Truth(_)) => "Truth",
            Some(Scalar::Text(_)) => "Text",
            Some(Scalar::Integer(_)) | None => "",
        };
        let many = if matches!(self.0, YamlValue::List(_)) && !kind.is_empty() { "[]" } else { "" };
        let colon = if kind.is_empty() { "" } else { ": " };
        format!("{name}{colon}{kind}{many} = {}", self.bare())
    }

    /// Returns the value as a spec has it.
    pub(super) fn bare(&self) -> String {
        self.written(|scalar| match scalar {
            Scalar::Integer(number) => number.to_string(),
            Scalar::Float(number) => number.to_string(),
            Scalar::Truth(truth) => truth.to_string(),
            Scalar::Text(text) => quoted(text),
        })
    }

    /// Returns whether it is an integer, or a list of integers.
    pub(super) fn is_integer(&self) -> bool {
        matches!(self.scalars().first(), Some(Scalar::Integer(_)))
    }

    /// Returns whether it has no fraction, and is not an integer.
    pub(super) fn is_whole_float(&self) -> bool {
        let is_whole = |scalar: &Scalar| matches!(scalar, Scalar::Float(number) if number.fract() == 0.0);
        self.scalars().first().is_some_and(|_| self.scalars().iter().all(is_whole))
    }

    /// Returns the value as YAML that ROS 2 reads with the same type.
    pub(super) fn yaml(&self) -> String {
        self.written(|scalar| match scalar {
            Scalar::Integer(number) => number.to_string(),
            Scalar::Float(number) if number.is_nan() => ".nan".to_owned(),
            Scalar::Float(number) if number.is_infinite() => {
                if *number > 0.0 {
                    ".inf".to_owned()
                } else {
                    "-.inf".to_owned()
                }
            }
            Scalar::Float(number) => format!("{number:?}"),
            Scalar::Truth(truth) => truth.to_string(),
            Scalar::Text(text) => yaml_text(text),
        })
    }
}

/// Returns a text that ROS 2 reads as a text, also if it looks like something else.
fn yaml_text(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_/-.~".contains(c);
    let is_sure = text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '/') && text.chars().all(is_plain);
    if is_sure && Literal::of(text, None).is_some_and(|found| found.is_text()) && text.len() > 1 {
        text.to_owned()
    } else {
        format!("'{}'", text.replace('\'', "''"))
    }
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
        for (text, wanted, expected) in [
            ("5", None, "x = 5"),
            ("-5", None, "x = -5"),
            ("0x46d", None, "x = 1133"),
            ("5", Some("str"), "x: Text = \"5\""),
            ("'5'", None, "x: Text = \"5\""),
            ("5", Some("float"), "x: Number = 5"),
            ("1e5", Some("float"), "x: Number = 100000"),
            ("5.0", None, "x: Number = 5"),
            ("-0.5", None, "x: Number = -0.5"),
            ("1e5", None, "x: Text = \"1e5\""),
            ("007", None, "x = 7"),
            ("007", Some("int"), "x = 7"),
            ("010", Some("int"), "x = 10"),
            ("True", None, "x: Truth = true"),
            ("off", Some("bool"), "x: Truth = false"),
            ("base \"link\"", None, "x: Text = \"base \\\"link\\\"\""),
            ("[1.0, 2.0]", None, "x: Number[] = [1, 2]"),
            ("[1, 2]", None, "x = [1, 2]"),
            ("[a, b c]", None, "x: Text[] = [\"a\", \"b c\"]"),
            ("", None, "x: Text = \"\""),
        ] {
            assert_eq!(Literal::of(text, wanted).map(|found| found.declared("x")).as_deref(), Some(expected), "{text}");
        }
        for (text, wanted) in [
            ("x", Some("int")),
            ("0x5", Some("int")),
            ("x", Some("float")),
            ("1.5", Some("int")),
            ("1", Some("bool")),
            ("a\nb", None),
            ("~", None),
            ("[]", None),
        ] {
            assert_eq!(Literal::of(text, wanted), None, "{text}");
        }
    }

    #[test]
    fn a_value_of_the_command_line_keeps_its_type() {
        for (text, is_of_spec, expected) in [
            ("5.0", true, "5.0"),
            ("1_000", true, "1000"),
            ("'yes'", true, "'yes'"),
            ("base_link", true, "base_link"),
            (".Inf", false, ".inf"),
            ("-.inf", false, "-.inf"),
            (".NaN", false, ".nan"),
            ("12345678901234567", false, "12345678901234567"),
            ("[0x10, 1:30]", true, "[16, 90]"),
            ("[.inf, 1.0]", false, "[.inf, 1.0]"),
        ] {
            let found = Literal::of(text, None).expect("launch reads it");
            assert_eq!((found.is_of_spec(), found.yaml().as_str()), (is_of_spec, expected), "{text}");
        }
    }
}
