//! Groups: the instances of one tree, the wires between them, and its event actions.

use super::library::Library;
use super::module::{ModuleKey, Modules};
use super::piece::Piece;
use crate::name::{Names, identifier};
use crate::remark::Remark;
use std::collections::BTreeMap;

/// The most wires of a group: each writer of a name is connected with each reader.
pub(super) const WIRES_MAX: usize = 10_000;

/// The type of an instance.
#[derive(Clone, Debug)]
pub(super) enum InstanceType {
    /// A program, with its arguments.
    Program { module: ModuleKey, arguments: Vec<(String, String)> },
    /// A group of this name.
    Group(String),
}

/// An instance of a group.
#[derive(Clone, Debug)]
pub(super) struct Instance {
    pub(super) name: String,
    pub(super) kind: InstanceType,
}

/// Where a name of the blackboard is read or written.
#[derive(Clone, Debug)]
pub(super) struct Use {
    /// The name on the blackboard.
    pub(super) key: String,
    pub(super) instance: String,
    /// The module of the instance; none for a group.
    pub(super) module: Option<ModuleKey>,
    pub(super) port: String,
    pub(super) writes: bool,
}

impl Use {
    /// The end of a wire.
    fn end(&self, modules: &Modules) -> String {
        let is_both = self.module.as_ref().is_some_and(|module| modules.is_both(module, &self.port));
        let suffix = if is_both && self.writes { "_out" } else { "" };
        format!("{}, {}{suffix}", self.instance, self.port)
    }
}

/// A port of a group.
#[derive(Clone, Debug)]
pub(super) struct Export {
    pub(super) key: String,
    pub(super) port: String,
    pub(super) writes: bool,
}

/// The behavior of a group.
#[derive(Clone, Debug)]
pub(super) enum Body {
    Actions(Piece),
    /// The states of an activity.
    States(String),
}

/// A group while it is made.
#[derive(Clone, Debug, Default)]
pub(super) struct Scope {
    pub(super) instances: Vec<Instance>,
    pub(super) uses: Vec<Use>,
    pub(super) remarks: Vec<Remark>,
    pub(super) names: Names,
}

impl Scope {
    /// Adds an instance, and returns its name.
    pub(super) fn instance(&mut self, wanted: &str, kind: InstanceType) -> String {
        let name = self.names.take(wanted);
        self.instances.push(Instance { name: name.clone(), kind });
        name
    }
}

/// A group that is complete.
#[derive(Clone, Debug)]
pub(super) struct Group {
    pub(super) name: String,
    pub(super) description: String,
    pub(super) scope: Scope,
    pub(super) body: Body,
    pub(super) exports: Vec<Export>,
    /// Whether the group is a part of a tree, which shares all names with it.
    pub(super) is_part: bool,
}

/// Returns the ports of a group, one for each use of a shared name.
pub(super) fn exports(scope: &Scope, is_shared: impl Fn(&str) -> bool) -> Vec<Export> {
    let mut names = Names::default();
    let shared = scope.uses.iter().filter(|used| is_shared(&used.key));
    shared
        .map(|used| {
            let port = names.take(&identifier(&used.key));
            Export { key: used.key.clone(), port, writes: used.writes }
        })
        .collect()
}

impl Group {
    /// Returns how many wires the group has.
    pub(super) fn wires(&self) -> usize {
        let mut counts: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
        for used in &self.scope.uses {
            let (writers, readers) = counts.entry(&used.key).or_default();
            *if used.writes { writers } else { readers } += 1;
        }
        counts.values().fold(0, |sum, (writers, readers)| sum.saturating_add(writers.saturating_mul(*readers)))
    }

    /// Returns the text of the group.
    pub(super) fn text(&self, modules: &Modules, library: &Library<'_>) -> String {
        let Self { name, description, scope, body, exports, is_part } = self;
        let (word, parameters) = match body {
            Body::States(_) => ("activity", "robot: Host"),
            Body::Actions(_) if name == "main" => ("process", "robot: Host = c1"),
            Body::Actions(_) => ("process", "robot: Host"),
        };
        let mut text = format!("\n/// {description}\n{word} {name}({parameters}){{ host{{robot}}\n");
        if !scope.instances.is_empty() {
            text += "instantiated_processes{\n";
            for Instance { name, kind } in &scope.instances {
                let (kind, arguments) = match kind {
                    InstanceType::Group(group) => (group.as_str(), String::new()),
                    InstanceType::Program { module, arguments } => {
                        let written = arguments.iter().map(|(parameter, value)| {
                            format!(", {parameter} = {}", modules.argument(module, parameter, value))
                        });
                        (modules.name(module), written.collect())
                    }
                };
                text += &format!("{name} instof {kind}(robot{arguments});\n");
            }
            text += "}\n";
        }
        if !exports.is_empty() {
            text += "external_io{\n";
            let shared = scope.uses.iter().filter(|used| library.is_shared(&used.key) || *is_part);
            for (used, export) in shared.zip(exports) {
                text += &format!("{} = {};\n", export.port, used.end(modules));
            }
            text += "}\n";
        }
        text += &self.wires_text(modules);
        let remarks: String = scope.remarks.iter().map(Remark::comment).collect();
        text += &match body {
            Body::Actions(piece) => format!("internal_event_actions{{\n{remarks}{}\n}}\n", piece.text()),
            Body::States(states) => format!("{remarks}{states}\n"),
        };
        text + "}\n"
    }

    fn wires_text(&self, modules: &Modules) -> String {
        let uses = &self.scope.uses;
        let mut readers: BTreeMap<&str, Vec<&Use>> = BTreeMap::new();
        for used in uses.iter().filter(|used| !used.writes) {
            readers.entry(&used.key).or_default().push(used);
        }
        let mut wires = String::new();
        for writer in uses.iter().filter(|used| used.writes) {
            let readers = readers.get(writer.key.as_str()).into_iter().flatten();
            for reader in readers.filter(|reader| reader.instance != writer.instance) {
                // A reader may begin long after the writer has ended, so the last value is kept.
                wires += &format!("{} -> {} latch;\n", writer.end(modules), reader.end(modules));
            }
        }
        if wires.is_empty() { wires } else { format!("internal_connections{{\n{wires}}}\n") }
    }
}
