//! The trees in all files, and the ports of their actions.

use crate::xml::{File, ImportError, Node, elements, tag};
use std::collections::{BTreeMap, BTreeSet};

/// The sort of a node of a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sort {
    Action,
    Condition,
    Control,
    Decorator,
    SubTree,
}

/// Whether a node reads or writes the blackboard through a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Direction {
    Reads,
    Writes,
    Both,
}

/// The entry of a `<TreeNodesModel>` for a node.
#[derive(Clone, Debug)]
pub(super) struct Model<'a> {
    pub(super) sort: Sort,
    pub(super) ports: BTreeMap<&'a str, Direction>,
}

/// A tree, with the name of its file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tree<'a> {
    pub(super) file: &'a str,
    pub(super) element: Node<'a>,
}

/// All trees and models of some files.
#[derive(Clone, Debug, Default)]
pub(super) struct Library<'a> {
    pub(super) trees: BTreeMap<&'a str, Tree<'a>>,
    models: BTreeMap<&'a str, Model<'a>>,
    /// The names on the blackboards of subtrees that the tree around one connects.
    shared: BTreeSet<&'a str>,
    /// Whether some subtree shares all names with the tree around it.
    shares_all: bool,
    /// The elements of files that are not read.
    pub(super) includes: Vec<Tree<'a>>,
}

/// Returns the sort that an element `<Action ID="…">` has by its name.
pub(super) fn sort_of(name: &str) -> Option<Sort> {
    match name {
        "Action" => Some(Sort::Action),
        "Condition" => Some(Sort::Condition),
        "Control" => Some(Sort::Control),
        "Decorator" => Some(Sort::Decorator),
        "SubTree" | "SubTreePlus" => Some(Sort::SubTree),
        _ => None,
    }
}

impl<'a> Library<'a> {
    /// Reads the trees and the models of files.
    ///
    /// # Errors
    /// Two trees have the same name, or a tree has none.
    pub(super) fn read(files: &[File<'a>]) -> Result<Self, ImportError> {
        let mut library = Self::default();
        for &File { name: file, root } in files {
            for element in elements(root) {
                match tag(element) {
                    "BehaviorTree" => {
                        let id = element.attribute("ID").unwrap_or("main");
                        let tree = Tree { file, element };
                        if library.trees.insert(id, tree).is_some() {
                            let why = format!("a second tree has the ID `{id}`; give each tree an ID of its own");
                            return Err(ImportError::at(file, element, why));
                        }
                    }
                    "TreeNodesModel" => library.models(element),
                    _ => library.includes.push(Tree { file, element }),
                }
            }
        }
        for tree in library.trees.values() {
            for subtree in tree.element.descendants().filter(|node| node.is_element()) {
                if is_subtree(subtree) {
                    let mapped = subtree.attributes().map(|attribute| attribute.name()).filter(|name| is_port(name));
                    library.shared.extend(mapped);
                    library.shares_all |= shares_all(subtree);
                }
            }
        }
        Ok(library)
    }

    fn models(&mut self, models: Node<'a>) {
        for element in elements(models) {
            let (Some(sort), Some(id)) = (sort_of(tag(element)), element.attribute("ID")) else { continue };
            let ports = elements(element).filter_map(|port| {
                let direction = match tag(port) {
                    "input_port" => Direction::Reads,
                    "output_port" => Direction::Writes,
                    "inout_port" => Direction::Both,
                    _ => return None,
                };
                Some((port.attribute("name")?, direction))
            });
            self.models.insert(id, Model { sort, ports: ports.collect() });
        }
    }

    /// Returns what is known about a node of this name.
    pub(super) fn model(&self, id: &str) -> Option<&Model<'a>> {
        self.models.get(id)
    }

    /// Whether the tree around a subtree can read or write this name of the blackboard.
    pub(super) fn is_shared(&self, key: &str) -> bool {
        key.starts_with('@') || self.shared.contains(key) || self.shares_all && !key.starts_with('_')
    }

    /// Returns the tree that a robot runs.
    ///
    /// # Errors
    /// The file names a tree that it does not have, or does not name one of several trees.
    pub(super) fn main(&self, file: File<'a>) -> Result<&'a str, ImportError> {
        let wrong = |why: String| Err(ImportError::at(file.name, file.root, why));
        let names: Vec<&'a str> = self.trees.keys().copied().collect();
        if let Some(main) = file.root.attribute("main_tree_to_execute") {
            let found = names.iter().find(|name| **name == main);
            let why = || format!("no tree has the ID `{main}`; {}", listed(&names));
            return found.map_or_else(|| wrong(why()), |name| Ok(*name));
        }
        let own = elements(file.root).filter(|element| tag(*element) == "BehaviorTree");
        let own: Vec<&'a str> = own.map(|element| element.attribute("ID").unwrap_or("main")).collect();
        let called: BTreeSet<&str> = self.trees.values().flat_map(|tree| called(tree.element)).collect();
        let free: Vec<&'a str> = own.iter().copied().filter(|name| !called.contains(name)).collect();
        match (own.as_slice(), free.as_slice()) {
            ([], _) => wrong("the file has no <BehaviorTree>".into()),
            ([only], _) | ([..], [only]) => Ok(only),
            ([..], _) => wrong(format!(
                "it is not clear which tree is the main one; add main_tree_to_execute=\"…\" to <root>; {}",
                listed(&names)
            )),
        }
    }
}

fn listed(names: &[&str]) -> String {
    let some: Vec<String> = names.iter().take(10).map(|name| format!("`{name}`")).collect();
    let more = if names.len() > some.len() { ", …" } else { "" };
    format!("the trees are {}{more}", some.join(", "))
}

/// The trees that a tree contains.
fn called(tree: Node<'_>) -> impl Iterator<Item = &str> {
    tree.descendants().filter(|node| node.is_element() && is_subtree(*node)).filter_map(|node| node.attribute("ID"))
}

fn is_subtree(node: Node<'_>) -> bool {
    sort_of(tag(node)) == Some(Sort::SubTree)
}

/// Whether a subtree uses the names of the blackboard of the tree around it.
pub(super) fn shares_all(subtree: Node<'_>) -> bool {
    let names = ["_autoremap", "__autoremap"];
    names.into_iter().filter_map(|name| subtree.attribute(name)).any(|value| value == "true" || value == "1")
}

/// Whether an attribute of a node of a tree is a port.
pub(super) fn is_port(name: &str) -> bool {
    !name.starts_with('_') && name != "ID" && name != "name"
}
