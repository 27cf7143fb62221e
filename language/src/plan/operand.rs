//! The parts of expressions that stand beside operands: the arms of `match` and `else match`, and the values that processes
//! start with.

use super::{Expression, PlanError};
use crate::algebra::Value;
use crate::automaton::Failure;
use serde::{Deserialize, Serialize};

/// The most bytes of a value that a spec gives to a process, and of its text.
pub const GIVEN_MAX: usize = 64 * 1024;

/// A value that a spec gives to a process for its start.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Given {
    /// The spec has the value.
    Known {
        /// The value as a spec spells it, in SI units.
        text: String,
        /// The value for `Init` of the process.
        value: Value,
    },
    /// The value that an [`Expression::Named`] around it keeps under this name.
    Result(String),
}

/// One way on in a `match`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arm {
    /// The tag of the arm. An arm without a tag takes every tag that no earlier arm has.
    pub tag: Option<String>,
    /// The expression that starts, with the value behind the tag; without a tag, with the whole value.
    pub body: Expression,
}

/// One way on in an `else match`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CatchArm {
    /// The failure that it is taken for; without one for every failure that no arm before takes.
    pub failure: Option<Failure>,
    /// The expression that starts, with the reason as text.
    pub body: Expression,
}

impl std::fmt::Display for Given {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Known { text, .. } => out.write_str(text),
            Self::Result(name) => out.write_str(name),
        }
    }
}

impl Given {
    /// Whether it is small enough.
    pub(super) fn check(&self) -> Result<(), PlanError> {
        let count = match self {
            Self::Known { text, value } => text.len().max(value.bytes().len()),
            Self::Result(name) => name.len(),
        };
        match count <= GIVEN_MAX {
            true => Ok(()),
            false => Err(PlanError::TooLarge { what: "bytes in one value", count, limit: GIVEN_MAX }),
        }
    }
}
