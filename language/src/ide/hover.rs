//! Describes the name, operator or unit at the pointer.

pub(super) mod interface;

use super::Analysis;
use super::index::{Kind, Symbol};
use super::words::{self, Place};
use crate::check::lower::exclusivity;
use crate::check::spec::{Instance, Set, Target, Value};
use crate::check::words_of;
use crate::source::{Origin, Span};
use crate::syntax::ast::Node;
use crate::syntax::{SyntaxKind, SyntaxToken};
use crate::unit;
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// The largest number of names in one list.
const NAMES_MAX: usize = 12;

/// The description of a place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hover {
    /// The place of the name.
    pub span: Span,
    /// The description, as Markdown.
    pub text: String,
}

impl Analysis {
    /// Returns the information about the name, word, operator or unit at a byte offset of the spec.
    pub fn hover(&self, offset: usize) -> Option<Hover> {
        if let Some((span, symbol)) = self.index().place_at(offset) {
            return Some(Hover { span, text: self.describe(&self.index().symbols[symbol]) });
        }
        let token = self.token_at(offset)?;
        let range = token.text_range();
        let span = Span { origin: Origin::Spec, start: range.start().into(), end: range.end().into() };
        if let Some(hover) = in_sentence(&token, offset) {
            return Some(hover);
        }
        Some(Hover { span, text: unit_text(&token).or_else(|| word_text(&token))? })
    }

    fn describe(&self, symbol: &Symbol) -> String {
        match symbol.kind {
            Kind::Process(process) => self.process_text(process),
            Kind::Module(module) => self.module_text(module),
            Kind::Constant => self.constant_text(&symbol.name),
            Kind::Param(owner, place) => self.param_text(owner, place),
            Kind::Instance(process, slot) => self.instance_text(process, slot),
            Kind::Export(process, place) => self.export_text(process, place),
            Kind::Port(module, port) => self.port_text(module, port),
            Kind::Label(process, set) => self.set_text(process, &self.model.processes[process].sets[set]),
            Kind::Resource(process, _) => self.resource_text(process, &symbol.name),
            Kind::Type(named) => self.type_text(named),
            Kind::Field => self.field_text(symbol.declaration),
            Kind::Outcome => self.outcome_text(&symbol.name),
            Kind::Result => "The name of a result: `with` starts processes with it.".to_owned(),
            Kind::Variable => "The variable of a replication: one copy is made for each of its values.".to_owned(),
        }
    }

    /// Returns the text of a named constant, in SI units.
    fn constant_text(&self, name: &str) -> String {
        let Some(constant) = self.model.consts.get(name) else { return String::new() };
        let values = constant.values.iter().take(NAMES_MAX).map(Value::to_string);
        let values = values.collect::<Vec<_>>().join(", ");
        let values = if constant.is_list { format!("[{values}]") } else { values };
        let dimension = constant.values.first().and_then(|value| value.dimension);
        let si = if dimension.is_some() { "\nIn SI units." } else { "" };
        format!("{}{si}", code(&format!("const {name} = {values};")))
    }

    fn resource_text(&self, process: usize, name: &str) -> String {
        let group = &self.model.processes[process].name.text;
        format!(
            "{}\nOf `{group}`: only one `using({name})` runs at a time, the others wait.",
            code(&format!("resource {name};"))
        )
    }

    /// Returns the text of an outcome, with its processes.
    fn outcome_text(&self, name: &str) -> String {
        let mut owners = Vec::new();
        let mut shown = name.to_owned();
        for (owner, outcomes) in self.model.outcomes() {
            let Some(outcome) = outcomes.iter().find(|outcome| outcome.name.text == name) else { continue };
            owners.push(owner.text.as_str());
            if let Some(kind) = &outcome.kind {
                shown = format!("{name}: {kind}");
            }
        }
        format!("{}\nAn outcome of {}.", code(&shown), list(owners.into_iter()))
    }

    /// Returns the text of a parameter: `name: Type = value`, and the dimension of its type.
    fn param_text(&self, owner: Target, place: usize) -> String {
        let (param, name, is_start) = match owner {
            Target::Process(process) => {
                let process = &self.model.processes[process];
                (process.params.get(place), process.name.text.as_str(), false)
            }
            Target::Module(module) => {
                let module = &self.model.modules[module];
                let is_start = place >= module.params.as_ref().map_or(0, Vec::len);
                (module.declared().nth(place), module.name.text.as_str(), is_start)
            }
            Target::Unknown => (None, "", false),
        };
        let Some(param) = param else { return String::new() };
        let what = if is_start { "The start value" } else { "A parameter" };
        format!("{}\n{what} of `{name}`.{}", code(&param.to_string()), interface::quantity(param))
    }

    fn instance_text(&self, process: usize, slot: usize) -> String {
        let group = &self.model.processes[process];
        let instance = &group.instances[slot];
        let kind = instance.kind.as_ref().map_or("?", |kind| kind.text.as_str());
        let mut text = code(&format!("{} instof {kind}", self.written(instance)));
        text += &match instance.target {
            Target::Process(target) => format!("\n{}", self.process_text(target)),
            Target::Module(target) => format!("\n{}", self.module_text(target)),
            Target::Unknown => "\nNo interface is known: ports and arguments are not checked.".to_owned(),
        };
        let hosts = self.hosts_of(process, slot);
        if !hosts.is_empty() {
            let _infallible = write!(text, "\n\nRuns on {}.", list(hosts.iter().map(String::as_str)));
        }
        if let Some(actions) = &group.actions {
            let others = exclusivity::concurrent_with(actions, slot);
            let others: BTreeSet<&str> = others.iter().map(|&other| self.written(&group.instances[other])).collect();
            let _infallible = match others.is_empty() {
                true => write!(text, "\n\nOf `{}`, nothing runs together with it.", group.name.text),
                false => write!(text, "\n\nMay run together with {}.", list(others.into_iter())),
            };
        }
        text
    }

    /// Returns the name of an instance in the text. For an element of an array, this is the name of the array.
    fn written(&self, instance: &Instance) -> &str {
        self.text(instance.name.span)
    }

    /// Returns the hosts of everything in the plan that comes from an instance.
    fn hosts_of(&self, process: usize, slot: usize) -> Vec<String> {
        let Some(plan) = &self.plan else { return Vec::new() };
        let (group, name) = (&self.model.processes[process], &self.model.processes[process].instances[slot].name.text);
        let around = plan.groups.iter().filter(|other| other.process == group.name.text);
        let paths: BTreeSet<String> = around.map(|around| format!("{}/{name}", around.path)).collect();
        let leaves = plan.leaves.iter().filter(|leaf| paths.contains(&leaf.path)).map(|leaf| leaf.host);
        let groups = plan.groups.iter().filter(|group| paths.contains(&group.path)).map(|group| group.host);
        let hosts: BTreeSet<u32> = leaves.chain(groups).collect();
        hosts.into_iter().filter_map(|host| plan.hosts.get(host as usize).cloned()).collect()
    }

    /// Returns a connection set in the form of a spec.
    fn set_text(&self, process: usize, set: &Set) -> String {
        let group = &self.model.processes[process];
        let name = |slot: usize| self.written(&group.instances[slot]);
        let owner = set.owner.map_or("", name);
        let label = set.label.as_ref().map_or("", |label| label.text.as_str());
        let mut lines = format!("internal_connections({owner}, {label})");
        for connection in set.connections.iter().take(NAMES_MAX) {
            let (from, to) = (&connection.from, &connection.to);
            let ends = (name(from.slot), &from.port.text, name(to.slot), &to.port.text);
            let _infallible = write!(lines, "\n    {}, {} -> {}, {};", ends.0, ends.1, ends.2, ends.3);
        }
        if set.connections.len() > NAMES_MAX {
            lines += "\n    ...";
        }
        format!("{}\nOpen while `{owner}` runs as `{owner}[{label}]`.", code(&lines))
    }
}

/// Returns the quantity of a unit, as text.
fn unit_text(token: &SyntaxToken) -> Option<String> {
    let is_unit = token.kind() == SyntaxKind::Ident && token.parent()?.kind() == SyntaxKind::Constant;
    let (factor, dimension) = unit::unit(token.text(), None).filter(|_| is_unit)?;
    let measures = |name: &str| unit::of_type(name).is_some_and(|(other, _)| other == dimension);
    let kind = unit::types().find(|(name, _)| measures(name));
    let kind = kind.map_or(String::new(), |(name, _)| format!(" A unit of type `{name}`."));
    Some(format!("`1 {}` is `{factor}` in SI units.{kind}", token.text()))
}

/// Returns the meaning of a word of a sentence, or of its formula.
fn in_sentence(token: &SyntaxToken, offset: usize) -> Option<Hover> {
    let parent = token.parent().filter(|parent| parent.kind() == SyntaxKind::Sentence)?;
    let offset = u32::try_from(offset).ok()?;
    let all = words_of(&Node::new(parent, Origin::Spec));
    let word = all.into_iter().find(|word| word.span.start <= offset && offset <= word.span.end)?;
    let known = match word.is_formula {
        true => words::find(&word.text, &[Place::Formula, Place::Event]),
        false => words::in_sentence(&word.text),
    };
    Some(Hover { span: word.span, text: known?.meaning.to_owned() })
}

/// Returns the meaning of a keyword or an operator, as text.
fn word_text(token: &SyntaxToken) -> Option<String> {
    let parent = token.parent()?.kind();
    let in_actions = token.parent_ancestors().any(|node| node.kind() == SyntaxKind::Actions);
    let places: &[Place] = match token.kind() {
        SyntaxKind::Ident if parent == SyntaxKind::Quality => &[Place::Quality],
        SyntaxKind::Ident if parent == SyntaxKind::Policy => &[Place::Policy, Place::Rule, Place::Inside],
        SyntaxKind::Ident if in_actions => &[Place::Section, Place::Action, Place::Suffix, Place::Inside],
        SyntaxKind::Ident => &[Place::Item, Place::Section, Place::ModuleItem, Place::Inside],
        _ if in_actions && parent != SyntaxKind::Labels => &[Place::Operator],
        _ => return None,
    };
    words::find(token.text(), places).map(|word| word.meaning.to_owned())
}

/// Returns a block of code in the language.
fn code(text: &str) -> String {
    format!("```dca\n{text}\n```")
}

/// Lists names in a sentence.
fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<String> = names.map(|name| format!("`{name}`")).collect();
    let shown = names.len().min(NAMES_MAX);
    let more = if shown < names.len() { " and others" } else { "" };
    format!("{}{more}", names[..shown].join(", "))
}
