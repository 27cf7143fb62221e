//! Encodes and decodes expressions, formulas and layouts.
//!
//! The reader of an expression calls itself for each level of nesting, and the stack is limited. So bytes that are nested
//! more deeply than an expression may be are refused during the read, not afterwards: a peer's bytes cannot crash a node.

use super::{DEPTH_MAX, Expression};
use crate::automaton::Formula;
use crate::message::Layout;
use serde::de::{Deserialize, Deserializer, Error};
use serde::ser::{Serialize, Serializer};
use std::cell::Cell;

thread_local! {
    /// How many nested expressions are being read.
    static OPEN: Cell<usize> = const { Cell::new(0) };
}

/// One level of an expression that is being read.
struct Level;

impl Level {
    fn enter() -> Option<Self> {
        let depth = OPEN.get();
        (depth < DEPTH_MAX).then(|| {
            OPEN.set(depth + 1);
            Self
        })
    }
}

impl Drop for Level {
    fn drop(&mut self) {
        OPEN.set(OPEN.get().saturating_sub(1));
    }
}

impl<'de> Deserialize<'de> for Expression {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let deep = || D::Error::custom(format_args!("event actions are nested deeper than {DEPTH_MAX} levels"));
        let _level = Level::enter().ok_or_else(deep)?;
        // The derived function, which bears the same name.
        Self::deserialize(deserializer)
    }
}

impl Serialize for Expression {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

impl<'de> Deserialize<'de> for Formula {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let deep = || D::Error::custom(format_args!("a formula is nested deeper than {DEPTH_MAX} levels"));
        let _level = Level::enter().ok_or_else(deep)?;
        Self::deserialize(deserializer)
    }
}

impl Serialize for Formula {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

impl<'de> Deserialize<'de> for Layout {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let deep = || D::Error::custom(format_args!("a type is nested deeper than {DEPTH_MAX} levels"));
        let _level = Level::enter().ok_or_else(deep)?;
        Self::deserialize(deserializer)
    }
}

impl Serialize for Layout {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::algebra::Value;
    use crate::plan::Given;

    /// Returns the bytes of `skip` within `count` shields.
    fn shields(count: usize) -> Vec<u8> {
        let shield = Expression::Shield { bound: None, of: Box::new(Expression::Skip) };
        let bytes = postcard::to_allocvec(&shield).unwrap();
        let (skip, around) = bytes.split_last().unwrap();
        [around.repeat(count), vec![*skip]].concat()
    }

    #[test]
    fn what_is_nested_too_deeply_is_refused_before_the_stack_ends() {
        let read = |count| postcard::from_bytes::<Expression>(&shields(count));
        let deepest = read(DEPTH_MAX - 1).unwrap();
        assert_eq!(postcard::to_allocvec(&deepest).unwrap(), shields(DEPTH_MAX - 1));
        assert!(read(DEPTH_MAX).is_err() && read(1_000_000).is_err());
        assert!(read(DEPTH_MAX - 1).is_ok(), "an error leaves nothing open");
    }

    /// Returns the first byte of an expression. Nodes of other versions read it, so a new operator comes last.
    fn number(expression: &Expression) -> u8 {
        match expression {
            Expression::Run { .. } => 0,
            Expression::Skip => 1,
            Expression::Never => 2,
            Expression::Fail(_) => 3,
            Expression::Wait(_) => 4,
            Expression::Concurrent(_) => 5,
            Expression::FailFast(_) => 6,
            Expression::AnyOf { .. } => 7,
            Expression::Disable(_) => 8,
            Expression::Sequence(..) => 9,
            Expression::Conditional(..) => 10,
            Expression::Recurrent(..) => 11,
            Expression::Otherwise(..) => 12,
            Expression::Match(_) => 13,
            Expression::Shield { .. } => 14,
            Expression::Using { .. } => 15,
            Expression::Asynchronous { .. } => 16,
            Expression::Finally(..) => 17,
            Expression::Tagged { .. } => 18,
            Expression::Chart(_) => 19,
            Expression::With { .. } => 20,
            Expression::Repeat { .. } => 21,
            Expression::Catch { .. } => 22,
            Expression::AtLeast { .. } => 23,
            Expression::Named { .. } => 24,
        }
    }

    #[test]
    fn each_operator_keeps_its_number() {
        let skip = || Box::new(Expression::Skip);
        let all = [
            Expression::Run { member: 0, sets: Vec::new() },
            Expression::Skip,
            Expression::Never,
            Expression::Fail(String::new()),
            Expression::Wait(std::time::Duration::ZERO),
            Expression::Concurrent(Vec::new()),
            Expression::FailFast(Vec::new()),
            Expression::AnyOf { count: 1, of: Vec::new() },
            Expression::Disable(Vec::new()),
            Expression::Sequence(skip(), skip()),
            Expression::Conditional(skip(), skip()),
            Expression::Recurrent(skip(), skip()),
            Expression::Otherwise(skip(), skip()),
            Expression::Match(Vec::new()),
            Expression::Shield { bound: None, of: skip() },
            Expression::Using { resources: Vec::new(), of: skip() },
            Expression::Asynchronous { source: skip(), pool: Vec::new() },
            Expression::Finally(skip(), skip()),
            Expression::Tagged { tag: String::new(), of: skip() },
            Expression::Chart(Box::default()),
            Expression::With { given: Given::Known { text: String::new(), value: Value::EMPTY }, of: skip() },
            Expression::Repeat { until: Vec::new(), of: skip() },
            Expression::Catch { of: skip(), arms: Vec::new() },
            Expression::AtLeast { count: 1, of: Vec::new() },
            Expression::Named { name: String::new(), of: skip() },
        ];
        for expression in all {
            assert_eq!(postcard::to_allocvec(&expression).unwrap()[0], number(&expression), "{expression:?}");
        }
    }
}
