//! The parameters of a controller and the values that they take, as plain data.

use super::Constant;
use serde::{Deserialize, Serialize};
use std::fmt;

/// A parameter as a program gets it: a field of a record is one of its own, `grasp.force`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// The values that the parameter takes.
    pub accepts: Accepts,
}

/// Which values a parameter takes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Accepts {
    /// Its interface does not say.
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
    /// One of these.
    OneOf(Vec<Constant>),
}

impl Accepts {
    /// Looks whether a value is one of them; it is spelt as a spec spells it, a text without quotes.
    ///
    /// # Errors
    /// The expected value, such as `a number from 1 to 200`.
    pub fn check(&self, text: &str) -> Result<(), String> {
        let number = || text.parse::<f64>().ok().filter(|number| number.is_finite());
        let is_fit = match self {
            Self::Any | Self::Text => true,
            Self::Number => number().is_some(),
            Self::Truth => text == "true" || text == "false",
            Self::Between { low, high } => number()
                .is_some_and(|number| low.is_none_or(|low| low <= number) && high.is_none_or(|high| number <= high)),
            Self::OneOf(all) => all.iter().any(|one| match one {
                Constant::Text(one) => one == text,
                Constant::Number(one) => number().is_some_and(|number| number.total_cmp(one).is_eq()),
                Constant::Truth(one) => one.to_string() == text,
            }),
        };
        if is_fit { Ok(()) } else { Err(self.expected()) }
    }

    fn expected(&self) -> String {
        match self {
            Self::Any => "any value".to_owned(),
            Self::Text => "a text".to_owned(),
            Self::Number | Self::Between { low: None, high: None } => "a number".to_owned(),
            Self::Truth => "`true` or `false`".to_owned(),
            Self::Between { low: Some(low), high: Some(high) } => format!("a number from {low} to {high}"),
            Self::Between { low: Some(low), high: None } => format!("a number of {low} or more"),
            Self::Between { low: None, high: Some(high) } => format!("a number of {high} or less"),
            Self::OneOf(all) => {
                let all: Vec<String> = all.iter().map(|one| format!("`{}`", bare(one))).collect();
                format!("one of {}", all.join(", "))
            }
        }
    }
}

/// A value as a spec spells it, a text without quotes.
fn bare(constant: &Constant) -> String {
    match constant {
        Constant::Text(text) => text.clone(),
        Constant::Number(number) => number.to_string(),
        Constant::Truth(truth) => truth.to_string(),
    }
}

/// As an interface says it: `Number in 1..200`.
impl fmt::Display for Accepts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let end = |end: &Option<f64>| end.map(|end| end.to_string()).unwrap_or_default();
        match self {
            Self::Any => f.write_str("any"),
            Self::Text => f.write_str("Text"),
            Self::Number => f.write_str("Number"),
            Self::Truth => f.write_str("Truth"),
            Self::Between { low, high } => write!(f, "Number in {}..{}", end(low), end(high)),
            Self::OneOf(all) => f.write_str(&all.iter().map(bare).collect::<Vec<_>>().join(" | ")),
        }
    }
}
