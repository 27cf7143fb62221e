//! A program that a launch file starts: in the spec it is a module and an instance of this module.

use super::parameter::Literal;
use std::ops::Range;

/// A parameter of a module.
#[derive(Clone, Debug)]
pub(super) struct Parameter {
    pub(super) name: String,
    pub(super) value: Literal,
    /// The parameter of `main` that has its value.
    pub(super) given: Option<String>,
}

/// The end of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ends {
    /// Exit code 0 is the end of its work.
    Done,
    /// It runs until it is stopped.
    Service,
    /// It has a lifecycle, so it runs until it is stopped.
    Lifecycle,
}

/// A program.
#[derive(Clone, Debug)]
pub(super) struct Program {
    pub(super) module: String,
    pub(super) instance: String,
    pub(super) description: String,
    /// The parts of the module that say what is started and how, each with its `;`.
    pub(super) items: Vec<String>,
    pub(super) parameters: Vec<Parameter>,
    pub(super) ends: Ends,
    /// The policies of the instance, each with its `;`.
    pub(super) policies: Vec<String>,
    /// The remarks about it.
    pub(super) remarks: Range<usize>,
}
