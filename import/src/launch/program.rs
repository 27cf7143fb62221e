//! A program that a launch file starts: in the spec it is a module and an instance of this module.

use super::parameter::Literal;
use crate::name::Names;
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

/// A container of components.
#[derive(Clone, Debug, Default)]
pub(super) struct Container {
    /// The full name of its node.
    pub(super) node: String,
    pub(super) components: Vec<Component>,
    /// The names of its components and of the parameters of its module.
    pub(super) names: Names,
}

/// A component in a container.
#[derive(Clone, Debug)]
pub(super) struct Component {
    /// The full name of its node.
    pub(super) node: String,
    /// The component as the spec has it.
    pub(super) text: String,
    /// Its parameters.
    pub(super) record: Option<Record>,
}

/// The parameters of a component, as one parameter of the module.
#[derive(Clone, Debug)]
pub(super) struct Record {
    /// The declaration in the module.
    pub(super) declared: String,
    /// The argument of the instance, if a value comes from a parameter of `main`.
    pub(super) given: Option<String>,
}

impl Container {
    /// Returns a container without components.
    pub(super) fn new(node: String) -> Self {
        let mut names = Names::default();
        names.take("host");
        Self { node, components: Vec::new(), names }
    }

    /// Returns the name of the node of a component that gives no other name.
    pub(super) fn own_node(&self, name: &str) -> String {
        let namespace = self.node.rsplit_once('/').map_or("", |(namespace, _)| namespace);
        format!("{namespace}/{name}")
    }
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
    /// Its components, if it can be a container.
    pub(super) container: Option<Container>,
    /// The remarks about it.
    pub(super) remarks: Range<usize>,
}
