//! Process groups.

mod policy;
mod quality;

use crate::check::count::Expected;
use crate::check::expression;
use crate::check::handed;
use crate::check::index;
use crate::check::names::{Names, twice};
use crate::check::spec::{
    Arg, Binding, Connection, Consts, Damage, Endpoint, Export, Instance, Param, Process, Scope, Set, Target, Value,
    ValueKind,
};
use crate::check::value::{symbol, value};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Constant, Transfer};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, BackArrow, Equals, Text};
use crate::syntax::ast::{Name, Node};
use std::collections::{BTreeMap, BTreeSet};

/// Reads a process; `places` are where its text is damaged.
pub(super) fn process(
    node: &Node,
    places: &[Span],
    consts: &Consts,
    diagnostics: &mut Vec<Diagnostic>,
) -> Option<Process> {
    let mut damage = damage(node, places);
    let name = node.title()?;
    check_sections(node, diagnostics);
    let params = node
        .child(SyntaxKind::Params)
        .map(|node| super::params(&node, "parameter", consts, diagnostics))
        .unwrap_or_default();
    let scope = Scope { params: &params, consts, indices: &[] };
    let host = node.child(SyntaxKind::Host).and_then(|node| host(&node, scope, diagnostics));
    let (mut instances, arrays, are_counted) = instances(node, scope, diagnostics);
    damage.instances |= !are_counted;
    let mut names = Names::new(&instances, damage.instances);
    names.arrays = arrays;
    let exports = exports(node, &mut names, diagnostics);
    let (sets, are_whole) = sets(node, &mut names, diagnostics);
    damage.connections |= !are_whole;
    let resources = resources(node, &params, diagnostics);
    let actions = node.children_of(SyntaxKind::Actions).next();
    names.is_doubtful = damage.actions;
    let mut group = expression::Group {
        names,
        consts,
        indices: Vec::new(),
        sets: &sets,
        resources: &resources,
        unknown: BTreeSet::new(),
        pool: None,
        damage,
        run: Vec::new(),
        taken: BTreeSet::new(),
        useless: Vec::new(),
    };
    let actions = actions.and_then(|node| expression::actions(&node, &mut group, diagnostics));
    damage.names = group.damage.names;
    let (run, mut taken) = (group.run, group.taken);
    taken.extend(handed::given(&instances, &resources, &params));
    if !damage.actions && !damage.names {
        diagnostics.extend(unused(&resources, &taken));
    }
    for slot in run {
        instances[slot].is_run = true;
    }
    let doc = node.doc();
    Some(Process {
        name,
        doc,
        params,
        host,
        instances,
        exports,
        sets,
        resources,
        actions,
        damage,
        is_service: false,
        open: Vec::new(),
    })
}

/// What `using` may take: what the group declares, and what it is handed.
fn resources(node: &Node, params: &[Param], diagnostics: &mut Vec<Diagnostic>) -> Vec<Name> {
    let mut resources: Vec<Name> = handed::known(params);
    for name in node.children_of(SyntaxKind::Resources).flat_map(|node| node.names().skip(1).collect::<Vec<_>>()) {
        match resources.iter().find(|first| first.text == name.text) {
            Some(first) => diagnostics.push(twice("resource", &name.text, name.span, first.span)),
            None => resources.push(name),
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

/// Finds out which parts of the process contain damaged text. Damage between sections may belong to any of them.
fn damage(node: &Node, places: &[Span]) -> Damage {
    let mut damage = Damage::default();
    for error in places {
        let is_here = |part: &Node| part.span().contains(error.at_start());
        let part = node.children().find(is_here).map(|part| part.kind());
        let in_part = |kind: SyntaxKind| part == Some(kind);
        let is_between = part.is_none() || in_part(SyntaxKind::Error);
        damage.header |= is_between || in_part(SyntaxKind::Params) || in_part(SyntaxKind::Host);
        damage.header |= in_part(SyntaxKind::Resources);
        damage.instances |= is_between || in_part(SyntaxKind::Instances);
        damage.external |= is_between || in_part(SyntaxKind::External);
        damage.connections |= is_between || in_part(SyntaxKind::Connections);
        damage.actions |= is_between || in_part(SyntaxKind::Actions);
    }
    damage
}

/// Every section but the connections stands at most once.
fn check_sections(node: &Node, diagnostics: &mut Vec<Diagnostic>) {
    let sections = [SyntaxKind::Host, SyntaxKind::Instances, SyntaxKind::External, SyntaxKind::Actions];
    for kind in sections {
        let mut words = node.children_of(kind).filter_map(|section| section.names().next());
        if let (Some(first), Some(second)) = (words.next(), words.next()) {
            diagnostics.push(twice("section", &second.text, second.span, first.span));
        }
    }
}

fn host(node: &Node, scope: Scope<'_>, diagnostics: &mut Vec<Diagnostic>) -> Option<Value> {
    if let Some(text) = node.token(Text) {
        return Some(Value {
            span: text.span(),
            kind: ValueKind::Constant(Constant::Text(text.content())),
            dimension: None,
        });
    }
    let name = node.names().nth(1)?;
    let before = diagnostics.len();
    let value = symbol(&name, scope, diagnostics);
    let is_known = matches!(value.kind, ValueKind::Param(_)) || scope.consts.contains_key(&name.text);
    if !is_known && !scope.params.is_empty() && diagnostics.len() == before {
        let message = format!("`{}` is no parameter: it stands for the host of that name", name.text);
        let help = format!("write `\"{}\"` if it is meant so", name.text);
        diagnostics.push(Diagnostic::new(Code::W0106, name.span, message).help(help));
    }
    Some(value)
}

/// Returns the instances, the size of each array, and whether all sizes are known.
fn instances(
    node: &Node,
    scope: Scope<'_>,
    diagnostics: &mut Vec<Diagnostic>,
) -> (Vec<Instance>, BTreeMap<String, usize>, bool) {
    let mut instances: Vec<Instance> = Vec::new();
    let mut are_counted = true;
    let mut arrays = BTreeMap::new();
    let mut first: BTreeMap<String, Span> = BTreeMap::new();
    let sections = node.children_of(SyntaxKind::Instances);
    let nodes: Vec<Node> =
        sections.flat_map(|section| section.children_of(SyntaxKind::Instance).collect::<Vec<_>>()).collect();
    for node in nodes {
        let Some(name) = node.names().find(|name| name.text != "instof" || node.names().count() == 1) else { continue };
        if let Some(&first) = first.get(&name.text) {
            diagnostics.push(twice("instance", &name.text, name.span, first));
            continue;
        }
        first.insert(name.text.clone(), name.span);
        let kind = node.child(SyntaxKind::Type).filter(|kind| !kind.compact_text().is_empty());
        let args = node.child(SyntaxKind::Args);
        let args_span = args.as_ref().map_or(node.span().at_end(), Node::span);
        let kind = kind.map(|kind| Name { text: kind.compact_text(), span: kind.span() });
        let policy = policy::policies(&node, scope.consts, diagnostics);
        let count = node.child(SyntaxKind::Count).map(|count| count_of(&count, scope, diagnostics));
        let mut add = |name: Name, scope: Scope<'_>, diagnostics: &mut Vec<Diagnostic>| {
            let args = args.as_ref().map(|args| arguments(args, scope, diagnostics)).unwrap_or_default();
            let (kind, policy) = (kind.clone(), policy.clone());
            instances.push(Instance { name, kind, target: Target::Unknown, args, args_span, policy, is_run: false });
        };
        let Some(count) = count else {
            add(name, scope, diagnostics);
            continue;
        };
        are_counted &= count.is_some();
        let since = diagnostics.len();
        // Of an array of unknown size every index may be right.
        for index in 0..count.unwrap_or(1) {
            let indices = [("i".to_owned(), index)];
            let element = Name { text: index::element(&name.text, index), span: name.span };
            // What is wrong with one of them is wrong with most, and is said once.
            let mut found = Vec::new();
            add(element.clone(), Scope { indices: &indices, ..scope }, &mut found);
            found.retain(|found| !diagnostics[since..].contains(found));
            diagnostics.append(&mut found);
            first.insert(element.text, name.span);
        }
        arrays.insert(name.text, count.unwrap_or(index::COUNT_MAX));
    }
    (instances, arrays, are_counted)
}

/// How many instances there are: `[4]`, or the name of a number.
fn count_of(node: &Node, scope: Scope<'_>, diagnostics: &mut Vec<Diagnostic>) -> Option<usize> {
    let what = format!("how many instances there are, from 1 to {}", index::COUNT_MAX);
    Expected::new(1..=index::COUNT_MAX, what).read(node, scope.consts, diagnostics)
}

fn arguments(node: &Node, scope: Scope<'_>, diagnostics: &mut Vec<Diagnostic>) -> Vec<Arg> {
    let args = node.children_of(SyntaxKind::Arg).filter_map(|arg| {
        let name = arg.token(Equals).and_then(|_| arg.names().next());
        let constant = arg.child(SyntaxKind::Constant)?;
        Some(Arg { name, value: value(&constant, scope, diagnostics) })
    });
    args.collect()
}

fn exports(node: &Node, names: &mut Names<'_>, diagnostics: &mut Vec<Diagnostic>) -> Vec<Export> {
    let mut exports: Vec<Export> = Vec::new();
    let sections = node.children_of(SyntaxKind::External);
    let nodes: Vec<Node> =
        sections.flat_map(|section| section.children_of(SyntaxKind::Export).collect::<Vec<_>>()).collect();
    for node in nodes {
        let endpoint = node.child(SyntaxKind::Endpoint).and_then(|node| endpoint(&node, names, &[], diagnostics));
        let (Some(name), Some(endpoint)) = (node.names().next(), endpoint) else { continue };
        match exports.iter().find(|export| export.name.text == name.text) {
            Some(first) => diagnostics.push(twice("external port", &name.text, name.span, first.name.span)),
            None => exports.push(Export { name, endpoint }),
        }
    }
    exports
}

fn endpoint(
    node: &Node,
    names: &mut Names<'_>,
    bindings: &[Binding],
    diagnostics: &mut Vec<Diagnostic>,
) -> Option<Endpoint> {
    let port = node.names().nth(1)?;
    let instance = index::name(node, names, bindings, diagnostics)?;
    Some(Endpoint { slot: names.exact(&instance, diagnostics)?, port })
}

/// Returns the sets, and whether all of them could be read.
fn sets(node: &Node, names: &mut Names<'_>, diagnostics: &mut Vec<Diagnostic>) -> (Vec<Set>, bool) {
    let mut sets: Vec<Set> = Vec::new();
    let mut first = Known::new();
    let mut are_whole = true;
    for section in node.children_of(SyntaxKind::Connections) {
        // A set of each instance of an array: `internal_connections(robot[i], on)`.
        let owner = section.child(SyntaxKind::Owner);
        let variable = owner.as_ref().and_then(|owner| index::unbound(std::slice::from_ref(owner), names, &[]));
        let rounds = variable.as_ref().map_or(1, |(_, count)| *count);
        let since = diagnostics.len();
        for round in 0..rounds {
            let bindings: Vec<Binding> = variable.iter().map(|(name, _)| (name.clone(), round)).collect();
            let mut found = Vec::new();
            let head = owner.as_ref().and_then(|owner| index::name(owner, names, &bindings, &mut found));
            let slot = head.as_ref().map(|owner| names.exact(owner, &mut found));
            let is_unknown =
                owner.as_ref().is_some_and(|owner| owner.names().next().is_some()) && slot.flatten().is_none();
            let connections = connections(&section, names, &bindings, &mut found);
            are_whole &= !is_unknown;
            if !is_unknown {
                let labels: Vec<Name> =
                    owner.iter().flat_map(|owner| owner.names().skip(1).collect::<Vec<_>>()).collect();
                add_sets(&mut sets, &mut first, (slot.flatten(), labels, section.span()), &connections, &mut found);
            }
            found.retain(|found| !diagnostics[since..].contains(found));
            diagnostics.append(&mut found);
        }
    }
    (sets, are_whole)
}

/// Where each set stands, by owner and label.
type Known = BTreeMap<(Option<usize>, Option<String>), Span>;

/// Adds one set for each label, or the one without a label.
fn add_sets(
    sets: &mut Vec<Set>,
    first: &mut Known,
    (owner, labels, section): (Option<usize>, Vec<Name>, Span),
    connections: &[Connection],
    diagnostics: &mut Vec<Diagnostic>,
) {
    let is_bare = labels.is_empty();
    for label in labels.into_iter().map(Some).chain(is_bare.then_some(None)) {
        let key = (owner, label.as_ref().map(|label| label.text.clone()));
        match (&label, first.get(&key)) {
            (Some(label), Some(&first)) => {
                diagnostics.push(twice("connection set", &label.text, label.span, first));
            }
            (Some(_) | None, _) => {
                let span = label.as_ref().map_or(section, |label| label.span);
                first.insert(key, span);
                sets.push(Set { owner, label, connections: connections.to_vec() });
            }
        }
    }
}

fn connections(
    section: &Node,
    names: &mut Names<'_>,
    bindings: &[Binding],
    diagnostics: &mut Vec<Diagnostic>,
) -> Vec<Connection> {
    let mut connections = Vec::new();
    for node in section.children_of(SyntaxKind::Connection) {
        let ends: Vec<Node> = node.children_of(SyntaxKind::Endpoint).collect();
        let quality = quality::quality(&node, diagnostics);
        // `robot[i], Out -> map, In` stands for one connection of each robot.
        let variable = index::unbound(&ends, names, bindings);
        let rounds = variable.as_ref().map_or(1, |(_, count)| *count);
        let since = diagnostics.len();
        for round in 0..rounds {
            let bound: Vec<Binding> =
                bindings.iter().cloned().chain(variable.iter().map(|(name, _)| (name.clone(), round))).collect();
            let mut found = Vec::new();
            let ends: Vec<Option<Endpoint>> = ends.iter().map(|end| endpoint(end, names, &bound, &mut found)).collect();
            found.retain(|found| !diagnostics[since..].contains(found));
            diagnostics.append(&mut found);
            let [Some(left), Some(right)] = ends.as_slice() else { continue };
            let is_backwards = node.token(BackArrow).is_some();
            let (from, to) = if is_backwards { (right, left) } else { (left, right) };
            let is_pull = |quality: Node| quality.names().next().is_some_and(|name| name.text == "pull");
            let transfer = match node.children_of(SyntaxKind::Quality).any(is_pull) {
                true => Transfer::Pull,
                false => Transfer::Push,
            };
            connections.push(Connection { from: from.clone(), to: to.clone(), transfer, quality, span: node.span() });
        }
    }
    connections
}
