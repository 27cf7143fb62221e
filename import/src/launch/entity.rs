//! The actions of a launch file, in the same form for XML and YAML.

use crate::xml::{self, Node};

/// A place in a file, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) line: u32,
    pub(crate) column: u32,
}

/// An attribute of an action.
#[derive(Clone, Debug)]
pub(super) struct Attribute {
    pub(super) name: String,
    pub(super) value: String,
}

/// An action, or a part of an action, such as a parameter of a node.
#[derive(Clone, Debug)]
pub(super) struct Entity {
    /// The kind, with `_` for `-`: both forms are in use.
    pub(super) kind: String,
    pub(super) place: Place,
    pub(super) attributes: Vec<Attribute>,
    pub(super) children: Vec<Self>,
}

impl Entity {
    /// Returns an action of XML, with all inside it. The nesting of the document is limited.
    pub(super) fn of_xml(node: Node<'_>) -> Self {
        let (line, column) = xml::place(node);
        let attribute =
            |found: roxmltree::Attribute<'_, '_>| Attribute { name: found.name().into(), value: found.value().into() };
        Self {
            kind: kind(xml::tag(node)),
            place: Place { line, column },
            attributes: node.attributes().map(attribute).collect(),
            children: xml::elements(node).map(Self::of_xml).collect(),
        }
    }

    /// Returns the text of an attribute.
    pub(super) fn get(&self, name: &str) -> Option<&str> {
        let found = self.attributes.iter().find(|attribute| attribute.name == name);
        found.map(|attribute| attribute.value.as_str())
    }

    /// Returns the parts of a kind.
    pub(super) fn parts<'a>(&'a self, kind: &'a str) -> impl Iterator<Item = &'a Self> {
        self.children.iter().filter(move |child| child.kind == kind)
    }
}

/// Returns the kind of an action by its name in a file.
pub(super) fn kind(name: &str) -> String {
    name.replace('-', "_")
}
