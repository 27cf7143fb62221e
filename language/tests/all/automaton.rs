//! The automaton of activities against its reference, and against examples of each rule.

mod changed;
#[expect(clippy::wildcard_enum_match_arm, reason = "each rule names the few kinds that it is about")]
mod charts;
mod in_algebra;
mod notices;
#[expect(clippy::wildcard_enum_match_arm, reason = "each rule names the few kinds that it is about")]
mod reference;
mod rules;
mod survey;
