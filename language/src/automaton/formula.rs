//! Guards and assigned values: arithmetic over finite variables.

use super::configuration::Configuration;
use serde::{Deserialize, Serialize};

/// An expression over finite variables. A condition is a formula whose value is not 0.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(remote = "Self")] // `plan::nested` limits how deep the bytes nest.
pub enum Formula {
    /// A number; `true` is 1.
    Number(i64),
    /// The value of a variable.
    Variable(usize),
    /// 1 if the state is active, otherwise 0.
    In(usize),
    /// 1 if the operand is 0, otherwise 0.
    Not(Box<Self>),
    /// 1 if neither operand is 0, otherwise 0.
    And(Box<Self>, Box<Self>),
    /// 1 if an operand is not 0, otherwise 0.
    Or(Box<Self>, Box<Self>),
    /// 1 if the relation holds, otherwise 0.
    Compare(Relation, Box<Self>, Box<Self>),
    /// The sum.
    Add(Box<Self>, Box<Self>),
    /// The difference.
    Subtract(Box<Self>, Box<Self>),
    /// The product.
    Multiply(Box<Self>, Box<Self>),
}

/// A relation of two numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Relation {
    /// `==`
    Equal,
    /// `<`
    Less,
    /// `<=`
    AtMost,
}

impl Formula {
    /// Returns the value.
    pub(super) fn value(&self, configuration: &Configuration) -> i64 {
        let of = |formula: &Self| formula.value(configuration);
        match self {
            Self::Number(number) => *number,
            Self::Variable(variable) => i64::from(configuration.variables[*variable]),
            Self::In(state) => i64::from(configuration.active[*state]),
            Self::Not(a) => i64::from(of(a) == 0),
            Self::And(a, b) => i64::from(of(a) != 0 && of(b) != 0),
            Self::Or(a, b) => i64::from(of(a) != 0 || of(b) != 0),
            Self::Compare(Relation::Equal, a, b) => i64::from(of(a) == of(b)),
            Self::Compare(Relation::Less, a, b) => i64::from(of(a) < of(b)),
            Self::Compare(Relation::AtMost, a, b) => i64::from(of(a) <= of(b)),
            Self::Add(a, b) => of(a).saturating_add(of(b)),
            Self::Subtract(a, b) => of(a).saturating_sub(of(b)),
            Self::Multiply(a, b) => of(a).saturating_mul(of(b)),
        }
    }

    /// Returns the operands.
    pub(super) fn operands(&self) -> [Option<&Self>; 2] {
        match self {
            Self::Number(_) | Self::Variable(_) | Self::In(_) => [None, None],
            Self::Not(a) => [Some(a), None],
            Self::And(a, b)
            | Self::Or(a, b)
            | Self::Compare(_, a, b)
            | Self::Add(a, b)
            | Self::Subtract(a, b)
            | Self::Multiply(a, b) => [Some(a), Some(b)],
        }
    }
}
