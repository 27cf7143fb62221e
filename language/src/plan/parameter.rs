//! The parameters of a controller and the values that they take, as plain data.

use super::Constant;
use crate::unit::{self, NotRead};
use serde::{Deserialize, Serialize};
use std::fmt;

/// A parameter in the form for a program: a field of a record is a separate parameter, `grasp.force`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// The values that the parameter takes.
    pub accepts: Accepts,
}

/// The values that a parameter takes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Accepts {
    /// Its interface does not declare it.
    Any,
    /// Any text.
    Text,
    /// Any number, in SI units.
    Number,
    /// `true` or `false`.
    Truth,
    /// A number, in SI units, both ends included.
    Between {
        /// The smallest, if there is one.
        low: Option<f64>,
        /// The largest, if there is one.
        high: Option<f64>,
    },
    /// One of these values.
    OneOf(Vec<Constant>),
    /// A quantity, in SI units, both ends included.
    Quantity {
        /// Its type, such as `Force`.
        of: String,
        /// The smallest, if there is one.
        low: Option<f64>,
        /// The largest, if there is one.
        high: Option<f64>,
    },
    /// A secret, which a spec can only give with `secret("KEY")`.
    Secret,
}

impl Accepts {
    /// Checks whether a value is one of them; it is spelt as in a spec, a text without quotes.
    ///
    /// # Errors
    /// The expected value, such as `a number from 1 to 200`.
    pub fn check(&self, text: &str) -> Result<(), String> {
        self.read(text).map(drop)
    }

    /// Returns a value in the form for its program: a quantity as a number in SI units, anything else as it is spelt. A
    /// number without a unit is in SI units.
    ///
    /// # Errors
    /// The expected value, such as `a number from 1 to 200`.
    pub fn read(&self, text: &str) -> Result<String, String> {
        let number = || text.parse::<f64>().ok().filter(|number| number.is_finite());
        let is_fit = match self {
            Self::Any | Self::Text => true,
            Self::Number => number().is_some(),
            Self::Truth => text == "true" || text == "false",
            Self::Between { low, high } => number().is_some_and(|number| is_between(number, *low, *high)),
            Self::OneOf(all) => all.iter().any(|one| match one {
                Constant::Text(one) => one == text,
                Constant::Number(one) => number().is_some_and(|number| number.total_cmp(one).is_eq()),
                Constant::Truth(one) => one.to_string() == text,
                Constant::Secret(_) => false,
            }),
            Self::Quantity { of, low, high } => return self.quantity(text, of, (*low, *high)),
            Self::Secret => false,
        };
        if is_fit { Ok(text.to_owned()) } else { Err(self.expected()) }
    }

    fn quantity(&self, text: &str, of: &str, ends: (Option<f64>, Option<f64>)) -> Result<String, String> {
        let (low, high) = ends;
        let hint = || format!("write it in {}", unit::spellings(of));
        match unit::read(text) {
            Ok((number, None)) if is_between(number, low, high) => Ok(text.to_owned()),
            Ok((_, None)) | Err(NotRead::NoNumber) => Err(self.expected()),
            Ok((number, Some(dimension))) if unit::of_type(of).is_some_and(|(own, _)| own == dimension) => {
                if is_between(number, low, high) { Ok(number.to_string()) } else { Err(self.expected()) }
            }
            Ok((_, Some(dimension))) => {
                let other = unit::type_of(dimension).map_or_else(|| "another quantity".to_owned(), with_article);
                Err(format!("{}, not {other}; {}", self.expected(), hint()))
            }
            Err(NotRead::NoUnit(symbol)) => {
                Err(format!("{}, and `{symbol}` is not a unit; {}", self.expected(), hint()))
            }
        }
    }

    /// Returns the symbol of the SI unit of the values, such as `N`. None if the values have no unit.
    pub fn unit(&self) -> Option<String> {
        match self {
            Self::Quantity { of, .. } => unit::symbol(of),
            Self::Any | Self::Text | Self::Number | Self::Truth => None,
            Self::Between { .. } | Self::OneOf(_) | Self::Secret => None,
        }
    }

    fn expected(&self) -> String {
        match self {
            Self::Any => "any value".to_owned(),
            Self::Text => "a text".to_owned(),
            Self::Number | Self::Between { low: None, high: None } => "a number".to_owned(),
            Self::Truth => "`true` or `false`".to_owned(),
            Self::Secret => "`secret(\"KEY\")` in the spec".to_owned(),
            Self::Between { low: Some(low), high: Some(high) } => format!("a number from {low} to {high}"),
            Self::Between { low: Some(low), high: None } => format!("a number of {low} or more"),
            Self::Between { low: None, high: Some(high) } => format!("a number of {high} or less"),
            Self::OneOf(all) => {
                let all: Vec<String> = all.iter().map(|one| format!("`{}`", one.bare())).collect();
                format!("one of {}", all.join(", "))
            }
            Self::Quantity { of, low, high } => {
                let (what, unit) = (with_article(of), self.unit().unwrap_or_default());
                match (low, high) {
                    (Some(low), Some(high)) => format!("{what} from {low} to {high} {unit}"),
                    (Some(low), None) => format!("{what} of {low} {unit} or more"),
                    (None, Some(high)) => format!("{what} of {high} {unit} or less"),
                    (None, None) => format!("{what} in {unit}"),
                }
            }
        }
    }
}

fn is_between(number: f64, low: Option<f64>, high: Option<f64>) -> bool {
    low.is_none_or(|low| low <= number) && high.is_none_or(|high| number <= high)
}

/// `a Force`, `an Angle`
fn with_article(name: &str) -> String {
    let article = if name.starts_with(['A', 'E', 'I', 'O', 'U']) { "an" } else { "a" };
    format!("{article} {name}")
}

/// In the form of an interface: `Number in 1..200`, `Force in 1 N..200 N`.
impl fmt::Display for Accepts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let end = |end: &Option<f64>| end.map(|end| end.to_string()).unwrap_or_default();
        match self {
            Self::Any => f.write_str("any"),
            Self::Text => f.write_str("Text"),
            Self::Number => f.write_str("Number"),
            Self::Truth => f.write_str("Truth"),
            Self::Secret => f.write_str("Secret"),
            Self::Between { low, high } => write!(f, "Number in {}..{}", end(low), end(high)),
            Self::OneOf(all) => f.write_str(&all.iter().map(Constant::bare).collect::<Vec<_>>().join(" | ")),
            Self::Quantity { of, low: None, high: None } => f.write_str(of),
            Self::Quantity { of, low, high } => {
                let unit = self.unit().unwrap_or_default();
                let end = |end: &Option<f64>| end.map(|end| format!("{end} {unit}")).unwrap_or_default();
                write!(f, "{of} in {}..{}", end(low), end(high))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantity_is_taken_in_its_units_and_in_no_other() {
        let force = Accepts::Quantity { of: "Force".into(), low: Some(1.0), high: Some(200.0) };
        for (text, read) in [("12.0", "12.0"), ("20 N", "20"), ("0.15kN", "150"), ("1e2 N", "100")] {
            assert_eq!(force.read(text).as_deref(), Ok(read), "{text}");
        }
        let expected = "a Force from 1 to 200 N";
        for (text, why) in [
            ("20 m", ", not a Length; write it in `N` or `kN`"),
            ("20 rad", ", not an Angle; write it in `N` or `kN`"),
            ("20 m/h", ", not a Speed; write it in `N` or `kN`"),
            ("20 kg/m", ", not another quantity; write it in `N` or `kN`"),
            ("20 Newton", ", and `Newton` is not a unit; write it in `N` or `kN`"),
            ("500", ""),
            ("0.5 kN", ""),
            ("much", ""),
        ] {
            assert_eq!(force.read(text), Err(format!("{expected}{why}")), "{text}");
        }
        assert_eq!((force.to_string().as_str(), force.unit().as_deref()), ("Force in 1 N..200 N", Some("N")));
        let speed = Accepts::Quantity { of: "Speed".into(), low: None, high: None };
        assert_eq!((speed.to_string().as_str(), speed.read("fast")), ("Speed", Err("a Speed in m/s".to_owned())));
    }
}
