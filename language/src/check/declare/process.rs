//! Reads processes that group others.

mod backoff;
mod keys;
mod outside;
mod policy;
mod quality;
mod supervision;
mod topics;

use crate::check::activity;
use crate::check::count::Expected;
use crate::check::diagnostics::Diagnostics;
use crate::check::expression;
use crate::check::index;
use crate::check::names::{Names, twice};
use crate::check::resource_args;
use crate::check::spec::{
    Arg, Binding, Connection, Consts, Damage, Endpoint, Export, Instance, Outside, Param, Process, Scope, Set, Target,
    Value, ValueKind,
};
use crate::check::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Constant, OnBoot, Transfer};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, BackArrow, Equals, Text};
use crate::syntax::ast::{Name, Node};
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

/// Reads a process. `places` are the places where its text is damaged.
pub(super) fn process(node: &Node, places: &[Span], consts: &Consts, diagnostics: &mut Diagnostics) -> Option<Process> {
    let mut damage = damage(node, places);
    let name = node.title()?;
    check_sections(node, diagnostics);
    let scope = Scope { params: &[], consts, indices: &[] };
    let params = node.child(SyntaxKind::Params);
    let params = params.map(|node| super::params(&node, "parameter", &mut Reader { scope, diagnostics }));
    let params = params.unwrap_or_default();
    let mut reader = Reader { scope: Scope { params: &params, ..scope }, diagnostics };
    let host = node.child(SyntaxKind::Host).and_then(|node| host(&node, &mut reader));
    let on_boot = node.child(SyntaxKind::OnBoot).and_then(|node| on_boot(&node, reader.diagnostics));
    let (supervision, backoff) = supervision::supervision(node, &mut reader).unzip();
    let Instances { all: mut instances, arrays, are_counted, .. } = Instances::read(node, &mut reader);
    damage.instances |= !are_counted;
    let mut names = Names::new(&instances, damage.instances, diagnostics);
    names.arrays = arrays;
    let exports = exports(node, &mut names);
    let Sets { all: sets, are_whole, .. } = Sets::read(node, &mut names);
    damage.connections |= !are_whole;
    let outside = Outside { keys: keys::read(node, &mut names), topics: topics::read(node, &mut names) };
    let resources = resources(node, &params, names.diagnostics);
    let actions = node.children_of(SyntaxKind::Actions).next();
    names.is_doubtful = damage.actions;
    let mut group = expression::Group {
        names,
        scope: Scope { params: &params, ..scope },
        kept: expression::Kept::default(),
        indices: Vec::new(),
        sets: &sets,
        owned: expression::OwnedSets::of_all(&sets),
        resources: expression::Resources::new(&resources),
        pool: None,
        damage,
        run: Vec::new(),
        size: 0,
        useless: Vec::new(),
    };
    let actions = match activity::is_activity(node) {
        true => activity::read(node, &mut group),
        false => actions.and_then(|node| expression::actions(&node, &mut group)),
    };
    damage.names = group.damage.names;
    let (run, mut taken) = (group.run, group.resources.taken);
    taken.extend(resource_args::given(&instances, &resource_args::places(&resources), &params));
    if !damage.actions && !damage.names {
        diagnostics.extend(unused(&resources, &taken));
    }
    for slot in run {
        instances[slot].is_run = true;
    }
    Some(Process {
        name,
        doc: node.doc(),
        params,
        host,
        instances,
        exports,
        sets,
        outside,
        resources,
        supervision,
        backoff: backoff.flatten(),
        on_boot,
        actions,
        damage,
        is_service: false,
        open: Vec::new(),
    })
}

/// Returns the names that `using` may take: the resources that the group declares, and the
/// resources that the group gets as arguments.
fn resources(node: &Node, params: &[Param], diagnostics: &mut Diagnostics) -> Vec<Name> {
    let mut resources: Vec<Name> = resource_args::known(params);
    let mut first: BTreeMap<String, Span> = resources.iter().map(|name| (name.text.clone(), name.span)).collect();
    for name in node.children_of(SyntaxKind::Resources).flat_map(|node| node.names().skip(1).collect::<Vec<_>>()) {
        match first.entry(name.text.clone()) {
            Entry::Occupied(first) => diagnostics.push(twice("resource", &name.text, name.span, *first.get())),
            Entry::Vacant(place) => {
                place.insert(name.span);
                resources.push(name);
            }
        }
    }
    resources
}

fn unused<'a>(resources: &'a [Name], taken: &BTreeSet<usize>) -> impl Iterator<Item = Diagnostic> + 'a {
    let is_unused = |(index, name): (usize, &'a Name)| (!taken.contains(&index)).then_some(name);
    let unused: Vec<&Name> = resources.iter().enumerate().filter_map(is_unused).collect();
    unused.into_iter().map(|name| {
        let message = format!("no event action uses `{}`", name.text);
        Diagnostic::new(Code::W0123, name.span, message).help(format!("write `using({}) process`", name.text))
    })
}

/// Finds the parts of the process with damaged text. Damage between sections may belong to any part.
fn damage(node: &Node, places: &[Span]) -> Damage {
    let mut damage = Damage::default();
    for error in places {
        let is_here = |part: &Node| part.span().contains(error.at_start());
        let part = node.children().find(is_here).map(|part| part.kind());
        let in_part = |kind: SyntaxKind| part == Some(kind);
        let is_between = part.is_none() || in_part(SyntaxKind::Error);
        damage.header |= is_between || in_part(SyntaxKind::Params) || in_part(SyntaxKind::Host);
        damage.header |=
            in_part(SyntaxKind::Resources) || in_part(SyntaxKind::Supervision) || in_part(SyntaxKind::OnBoot);
        damage.instances |= is_between || in_part(SyntaxKind::Instances);
        damage.external |= is_between || in_part(SyntaxKind::External);
        damage.connections |= is_between || in_part(SyntaxKind::Connections);
        damage.actions |= is_between || in_part(SyntaxKind::Actions);
        let of_activity = [
            SyntaxKind::State,
            SyntaxKind::StateRun,
            SyntaxKind::Transition,
            SyntaxKind::StateVariable,
            SyntaxKind::Port,
        ];
        damage.actions |= part.is_some_and(|part| of_activity.contains(&part));
    }
    damage
}

/// Reports any of these sections that occurs more than once.
fn check_sections(node: &Node, diagnostics: &mut Diagnostics) {
    let sections = [
        SyntaxKind::Host,
        SyntaxKind::Instances,
        SyntaxKind::External,
        SyntaxKind::Actions,
        SyntaxKind::Supervision,
        SyntaxKind::OnBoot,
    ];
    for kind in sections {
        let mut words = node.children_of(kind).filter_map(|section| section.names().next());
        if let (Some(first), Some(second)) = (words.next(), words.next()) {
            diagnostics.push(twice("section", &second.text, second.span, first.span));
        }
    }
}

/// Reads `on_boot{resume}`.
fn on_boot(node: &Node, diagnostics: &mut Diagnostics) -> Option<(OnBoot, Span)> {
    let word = node.names().nth(1)?;
    let on_boot = match word.text.as_str() {
        "none" => OnBoot::None,
        "resume" => OnBoot::Resume,
        _ => {
            let message = format!("`{}` is not an action after a reboot", word.text);
            let help = "write `on_boot{none}` or `on_boot{resume}`";
            diagnostics.push(Diagnostic::new(Code::E0009, word.span, message).help(help));
            return None;
        }
    };
    Some((on_boot, node.span()))
}

fn host(node: &Node, reader: &mut Reader<'_>) -> Option<Value> {
    if let Some(text) = node.token(Text) {
        return Some(Value {
            span: text.span(),
            kind: ValueKind::Constant(Constant::Text(text.content())),
            dimension: None,
        });
    }
    let name = node.names().nth(1)?;
    let before = reader.diagnostics.count();
    let value = reader.symbol(&name);
    let is_known = matches!(value.kind, ValueKind::Param(_)) || reader.scope.consts.contains_key(&name.text);
    if !is_known && !reader.scope.params.is_empty() && reader.diagnostics.count() == before {
        let message = format!("`{}` is not a parameter: it stands for the host of that name", name.text);
        let help = format!("if this host is meant, write `\"{}\"`", name.text);
        reader.diagnostics.push(Diagnostic::new(Code::W0106, name.span, message).help(help));
    }
    Some(value)
}

/// The instances of a group.
#[derive(Default)]
struct Instances {
    all: Vec<Instance>,
    /// The size of each array.
    arrays: BTreeMap<String, usize>,
    /// Whether all sizes are known.
    are_counted: bool,
    /// Where each name is declared.
    known: BTreeMap<String, Span>,
}

impl Instances {
    fn read(group: &Node, reader: &mut Reader<'_>) -> Self {
        let mut instances = Self { are_counted: true, ..Self::default() };
        for section in group.children_of(SyntaxKind::Instances) {
            for node in section.children_of(SyntaxKind::Instance) {
                instances.add(&node, reader);
            }
        }
        instances
    }

    /// Adds an instance, or all instances of an array.
    fn add(&mut self, node: &Node, reader: &mut Reader<'_>) {
        let is_name = |name: &Name| name.text != "instof" || node.names().count() == 1;
        let Some(name) = node.names().find(is_name) else { return };
        if let Some(&first) = self.known.get(&name.text) {
            reader.diagnostics.push(twice("instance", &name.text, name.span, first));
            return;
        }
        self.known.insert(name.text.clone(), name.span);
        let kind = node.child(SyntaxKind::Type).filter(|kind| !kind.compact_text().is_empty());
        let args = node.child(SyntaxKind::Args);
        let template = Instance {
            kind: kind.map(|kind| Name { text: kind.compact_text(), span: kind.span() }),
            target: Target::Unknown,
            args: Vec::new(),
            args_span: args.as_ref().map_or(node.span().at_end(), Node::span),
            policies: policy::policies(node, reader),
            is_run: false,
            name,
        };
        let Some(count) = node.child(SyntaxKind::Count) else {
            let args = args.map(|args| arguments(&args, reader)).unwrap_or_default();
            self.all.push(Instance { args, ..template });
            return;
        };
        let count = count_of(&count, reader);
        self.are_counted &= count.is_some();
        let mut rounds = reader.diagnostics.rounds();
        // If the size of the array is unknown, every index may be right.
        for index in 0..count.unwrap_or(1) {
            let name = Name { text: index::element(&template.name.text, index), span: template.name.span };
            if let Some(&first) = self.known.get(&name.text) {
                reader.diagnostics.push(twice("instance", &name.text, name.span, first));
                break;
            }
            // All elements of an array usually have the same mistake, which is then reported once.
            let indices = [("i".to_owned(), index)];
            let scope = Scope { indices: &indices, ..reader.scope };
            let mut reader = Reader { scope, diagnostics: reader.diagnostics };
            let args = args.as_ref().map(|args| arguments(args, &mut reader)).unwrap_or_default();
            reader.diagnostics.end_round(&mut rounds);
            self.known.insert(name.text.clone(), name.span);
            self.all.push(Instance { name, args, ..template.clone() });
        }
        self.arrays.insert(template.name.text, count.unwrap_or(index::COUNT_MAX));
    }
}

/// Reads the number of instances: `[4]`, or the name of a number.
fn count_of(node: &Node, reader: &mut Reader<'_>) -> Option<usize> {
    let what = format!("the number of instances, from 1 to {}", index::COUNT_MAX);
    let count = Expected::new(1..=index::COUNT_MAX, what).read(node, reader)?;
    reader.diagnostics.may_replicate(count, node.span()).then_some(count)
}

fn arguments(node: &Node, reader: &mut Reader<'_>) -> Vec<Arg> {
    let args = node.children_of(SyntaxKind::Arg).filter_map(|arg| {
        let name = arg.token(Equals).and_then(|_| arg.names().next());
        let constant = arg.child(SyntaxKind::Constant)?;
        Some(Arg { name, value: reader.value(&constant) })
    });
    args.collect()
}

fn exports(node: &Node, names: &mut Names<'_>) -> Vec<Export> {
    let mut exports: Vec<Export> = Vec::new();
    let mut first: BTreeMap<String, Span> = BTreeMap::new();
    let sections = node.children_of(SyntaxKind::External);
    let nodes: Vec<Node> =
        sections.flat_map(|section| section.children_of(SyntaxKind::Export).collect::<Vec<_>>()).collect();
    for node in nodes {
        let endpoint = node.child(SyntaxKind::Endpoint).and_then(|node| endpoint(&node, names, &[]));
        let (Some(name), Some(endpoint)) = (node.names().next(), endpoint) else { continue };
        if let Some(&first) = first.get(&name.text) {
            names.diagnostics.push(twice("external port", &name.text, name.span, first));
            continue;
        }
        first.insert(name.text.clone(), name.span);
        exports.push(Export { name, endpoint });
    }
    exports
}

fn endpoint(node: &Node, names: &mut Names<'_>, bindings: &[Binding]) -> Option<Endpoint> {
    let port = node.names().nth(1)?;
    let instance = index::name(node, names, bindings)?;
    Some(Endpoint { slot: names.exact(&instance)?, port })
}

/// The connection sets of a group.
#[derive(Default)]
struct Sets {
    all: Vec<Set>,
    /// The place of each set, found by its owner and its label.
    known: BTreeMap<(Option<usize>, Option<String>), Span>,
    /// Whether all sets could be read.
    are_whole: bool,
}

impl Sets {
    fn read(group: &Node, names: &mut Names<'_>) -> Self {
        let mut sets = Self { are_whole: true, ..Self::default() };
        for section in group.children_of(SyntaxKind::Connections) {
            // Reads a set for each instance of an array: `internal_connections(robot[i], on)`.
            let owner = section.child(SyntaxKind::Owner);
            let variable = owner.as_ref().and_then(|owner| index::unbound(std::slice::from_ref(owner), names, &[]));
            let count = variable.as_ref().map_or(1, |(_, count)| *count);
            let mut rounds = names.diagnostics.rounds();
            for round in 0..count {
                let bindings: Vec<Binding> = variable.iter().map(|(name, _)| (name.clone(), round)).collect();
                sets.add_section(&section, owner.as_ref(), &bindings, names);
                names.diagnostics.end_round(&mut rounds);
            }
        }
        sets
    }

    /// Adds the sets of a section, unless the owner is unknown.
    fn add_section(&mut self, section: &Node, owner: Option<&Node>, bindings: &[Binding], names: &mut Names<'_>) {
        let head = owner.and_then(|owner| index::name(owner, names, bindings));
        let slot = head.and_then(|owner| names.exact(&owner));
        let connections = connections(section, names, bindings);
        if slot.is_none() && owner.is_some_and(|owner| owner.names().next().is_some()) {
            self.are_whole = false;
            return;
        }
        let labels: Vec<Name> = owner.iter().flat_map(|owner| owner.names().skip(1).collect::<Vec<_>>()).collect();
        let is_bare = labels.is_empty();
        for label in labels.into_iter().map(Some).chain(is_bare.then_some(None)) {
            if !names.diagnostics.may_replicate(connections.len(), section.span()) {
                self.are_whole = false;
                return;
            }
            let key = (slot, label.as_ref().map(|label| label.text.clone()));
            match (&label, self.known.get(&key)) {
                (Some(label), Some(&first)) => {
                    names.diagnostics.push(twice("connection set", &label.text, label.span, first));
                }
                (Some(_) | None, _) => {
                    let span = label.as_ref().map_or(section.span(), |label| label.span);
                    self.known.insert(key, span);
                    self.all.push(Set { owner: slot, label, connections: connections.clone() });
                }
            }
        }
    }
}

fn connections(section: &Node, names: &mut Names<'_>, bindings: &[Binding]) -> Vec<Connection> {
    let mut connections = Vec::new();
    let is_outside = |node: &Node| [SyntaxKind::Keys, SyntaxKind::Topic].iter().any(|kind| node.child(*kind).is_some());
    for node in section.children_of(SyntaxKind::Connection).filter(|node| !is_outside(node)) {
        let ends: Vec<Node> = node.children_of(SyntaxKind::Endpoint).collect();
        let quality = quality::quality(&node, names.diagnostics);
        let is_pull = |quality: Node| quality.names().next().is_some_and(|name| name.text == "pull");
        let transfer = match node.children_of(SyntaxKind::Quality).any(is_pull) {
            true => Transfer::Pull,
            false => Transfer::Push,
        };
        // `robot[i], Out -> map, In` stands for one connection of each robot.
        let variable = index::unbound(&ends, names, bindings);
        let count = variable.as_ref().map_or(1, |(_, count)| *count);
        let mut rounds = names.diagnostics.rounds();
        for round in 0..count {
            let own = variable.iter().map(|(name, _)| (name.clone(), round));
            let bound: Vec<Binding> = bindings.iter().cloned().chain(own).collect();
            let ends: Vec<Option<Endpoint>> = ends.iter().map(|end| endpoint(end, names, &bound)).collect();
            names.diagnostics.end_round(&mut rounds);
            let [Some(left), Some(right)] = ends.as_slice() else { continue };
            let is_backwards = node.token(BackArrow).is_some();
            let (from, to) = if is_backwards { (right, left) } else { (left, right) };
            connections.push(Connection { from: from.clone(), to: to.clone(), transfer, quality, span: node.span() });
        }
    }
    connections
}
