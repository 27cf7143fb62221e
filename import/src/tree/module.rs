//! The modules of the spec: one for each kind of action, with its ports and parameters.

use super::library::Direction;
use crate::name::{self, Names, identifier, pascal, quoted};
use std::collections::{BTreeMap, BTreeSet};

/// The task of a program for a condition or an action of a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Role {
    /// It runs once, and succeeds or fails.
    Once,
    /// It fails as soon as the condition does not hold any more.
    While,
    /// It is done as soon as the condition holds.
    Until,
}

/// The part of a tree that a module stands for.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ModuleKey {
    /// The name in the tree, or the text of a script.
    pub(super) id: String,
    pub(super) role: Role,
}

/// A module.
#[derive(Clone, Debug, Default)]
struct Module {
    name: String,
    description: String,
    parameters: BTreeMap<String, BTreeSet<String>>,
    ports: BTreeMap<String, Direction>,
    outcomes: Vec<String>,
}

/// All modules, in the order of their names.
#[derive(Clone, Debug, Default)]
pub(super) struct Modules {
    modules: BTreeMap<ModuleKey, Module>,
    pub(super) names: Names,
}

impl Modules {
    /// Adds a module if it is new; `id` is the wish for its name, and `description` a sentence.
    pub(super) fn declare(&mut self, key: &ModuleKey, id: &str, description: &str) {
        let Self { modules, names } = self;
        modules.entry(key.clone()).or_insert_with(|| {
            let name = match key.role {
                Role::Once => pascal(id),
                Role::While => format!("While{}", pascal(id)),
                Role::Until => format!("Until{}", pascal(id)),
            };
            Module { name: names.take(&name), description: name::plain(description), ..Module::default() }
        });
    }

    /// Notes a parameter with one of its values, and returns its name in the spec.
    pub(super) fn parameter(&mut self, key: &ModuleKey, parameter: &str, value: &str) -> String {
        let name = identifier(parameter);
        // The first parameter is the host.
        let name = if name == "host" { "host_".into() } else { name };
        if let Some(module) = self.modules.get_mut(key) {
            module.parameters.entry(name.clone()).or_default().insert(value.to_owned());
        }
        name
    }

    /// Notes a port, and returns its name in the spec.
    pub(super) fn port(&mut self, key: &ModuleKey, port: &str, direction: Direction) -> String {
        let name = identifier(port);
        if let Some(module) = self.modules.get_mut(key) {
            let known = module.ports.entry(name.clone()).or_insert(direction);
            if *known != direction {
                *known = Direction::Both;
            }
        }
        name
    }

    /// Whether a port is an input and an output.
    pub(super) fn is_both(&self, key: &ModuleKey, input: &str) -> bool {
        self.modules.get(key).and_then(|module| module.ports.get(input)) == Some(&Direction::Both)
    }

    /// Notes the outcomes of a module.
    pub(super) fn outcomes(&mut self, key: &ModuleKey, outcomes: &[String]) {
        if let Some(module) = self.modules.get_mut(key) {
            module.outcomes = outcomes.to_vec();
        }
    }

    /// Returns the name of a module.
    pub(super) fn name(&self, key: &ModuleKey) -> &str {
        self.modules.get(key).map_or("", |module| module.name.as_str())
    }

    /// Returns the value of an argument as the type of the parameter needs it.
    pub(super) fn argument(&self, key: &ModuleKey, parameter: &str, value: &str) -> String {
        let values = self.modules.get(key).and_then(|module| module.parameters.get(parameter));
        values.map_or(ParameterType::Text, ParameterType::of).written(value)
    }

    /// Returns the text of all modules.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        for (key, module) in &self.modules {
            let mut parameters = vec!["host: Host".to_owned()];
            for (name, values) in &module.parameters {
                let kind = ParameterType::of(values);
                parameters.push(format!("{name}: {} = {}", kind.name(), kind.default()));
            }
            let mut facts = String::new();
            for (name, direction) in &module.ports {
                facts += &match direction {
                    Direction::Reads => format!("in {name}; "),
                    Direction::Writes => format!("out {name}; "),
                    Direction::Both => format!("in {name}; out {name}_out; "),
                };
            }
            facts += match (key.role, module.outcomes.as_slice()) {
                (Role::While, _) => "service;",
                (Role::Once | Role::Until, []) => "done;",
                (Role::Once | Role::Until, [..]) => "",
            };
            if !module.outcomes.is_empty() {
                facts += &format!("done({});", module.outcomes.join(" | "));
            }
            let (name, parameters) = (&module.name, parameters.join(", "));
            text += &format!("/// {}\nmodule {name}({parameters}) {{ {facts} }}\n", module.description);
        }
        text
    }
}

/// The type of a parameter, by all its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ParameterType {
    Number,
    Truth,
    Text,
}

impl ParameterType {
    fn of(values: &BTreeSet<String>) -> Self {
        if values.iter().all(|value| number(value).is_some()) {
            Self::Number
        } else if values.iter().all(|value| value == "true" || value == "false") {
            Self::Truth
        } else {
            Self::Text
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Number => "Number",
            Self::Truth => "Truth",
            Self::Text => "Text",
        }
    }

    fn default(self) -> &'static str {
        match self {
            Self::Number => "0",
            Self::Truth => "false",
            Self::Text => "\"\"",
        }
    }

    fn written(self, value: &str) -> String {
        match (self, number(value)) {
            (Self::Number, Some(number)) => format!("{number}"),
            (Self::Truth, _) => value.to_owned(),
            (Self::Number | Self::Text, _) => quoted(value),
        }
    }
}

/// A number that a spec can write.
fn number(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|number| number.is_finite() && number.abs() < 1e15)
}
