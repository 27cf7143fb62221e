//! The model of a picture: processes within processes, their ports, and the connections between them.

use crate::check::spec::{Direction, Endpoint, Expr, ExprKind, Process, Spec, Target};
use crate::plan::{Plan, Transfer};
use std::collections::{BTreeMap, BTreeSet};

/// A process: a group with everything inside, or a leaf.
#[derive(Clone, Debug, Default)]
pub(super) struct Unit {
    pub(super) name: String,
    /// The absolute path of a process that runs, or the name of a state of one: a page colours its box by this.
    pub(super) key: Option<String>,
    pub(super) kind: String,
    /// The text of the doc comments of its type.
    pub(super) doc: String,
    /// Index into the hosts.
    pub(super) host: usize,
    pub(super) is_service: bool,
    pub(super) is_group: bool,
    pub(super) ports: Vec<Port>,
    /// The resources of the group around that it has alone while it runs.
    pub(super) resources: Vec<String>,
    pub(super) units: Vec<Self>,
    pub(super) links: Vec<Link>,
}

#[derive(Clone, Debug)]
pub(super) struct Port {
    pub(super) name: String,
    pub(super) direction: Direction,
    /// Whether something is connected to it.
    pub(super) is_used: bool,
}

/// Returns the port with this name and direction; a new one, if there is none.
pub(super) fn port(ports: &mut Vec<Port>, name: &str, direction: Direction) -> usize {
    let known = ports.iter().position(|port| port.name == name && port.direction == direction);
    known.unwrap_or_else(|| {
        ports.push(Port { name: name.to_owned(), direction, is_used: true });
        ports.len() - 1
    })
}

/// An arrow inside a group.
#[derive(Clone, Debug)]
pub(super) struct Link {
    pub(super) from: End,
    pub(super) to: End,
    /// Number of the connection set; nothing for a port that the group exports.
    pub(super) set: Option<usize>,
    pub(super) label: String,
    pub(super) is_pull: bool,
    /// Whether no event action ever opens the set.
    pub(super) is_cut: bool,
    /// The wires of the plan that run along it, in a picture of a process that runs.
    pub(super) wires: Vec<u32>,
}

impl Link {
    /// Returns an arrow that belongs to no connection set.
    pub(super) fn plain(from: End, to: End) -> Self {
        Self { from, to, set: None, label: String::new(), is_pull: false, is_cut: false, wires: Vec::new() }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct End {
    /// The member; nothing for the border of the group itself.
    pub(super) unit: Option<usize>,
    /// Index into the ports.
    pub(super) port: usize,
}

/// The deployed instances, by path.
struct Known<'a> {
    spec: &'a Spec,
    hosts: BTreeMap<&'a str, usize>,
    /// The ports of leaves that have a wire.
    wired: BTreeSet<(&'a str, &'a str)>,
}

/// Returns the unit of a process group with everything below it.
pub(super) fn unit(spec: &Spec, root: usize, plan: &Plan) -> Unit {
    let groups = plan.groups.iter().map(|group| (group.path.as_str(), group.host as usize));
    let leaves = plan.leaves.iter().map(|leaf| (leaf.path.as_str(), leaf.host as usize));
    let ends = plan.wires.iter().flat_map(|wire| [&wire.from, &wire.to]);
    let ends = ends.map(|end| (plan.leaves[end.leaf as usize].path.as_str(), end.port.as_str()));
    let keys =
        plan.leaves.iter().flat_map(|leaf| leaf.keys.iter().map(|keys| (leaf.path.as_str(), keys.port.as_str())));
    let wired = ends.chain(keys).collect();
    group(&Known { spec, hosts: groups.chain(leaves).collect(), wired }, root, "main", "main")
}

/// Groups nest finitely here, and not deeper than a plan may be.
fn group(known: &Known<'_>, index: usize, name: &str, path: &str) -> Unit {
    let process = &known.spec.processes[index];
    let units = process.instances.iter().enumerate().map(|(slot, instance)| {
        let name = &instance.name.text;
        let path = format!("{path}/{name}");
        match instance.target {
            Target::Process(target) => group(known, target, name, &path),
            Target::Module(_) | Target::Unknown => leaf(known, process, slot, &path),
        }
    });
    let ports = process.exports.iter().map(|export| exported(known.spec, process, export));
    let messages = process.chart().into_iter().flat_map(|chart| &chart.ports);
    let messages =
        messages.map(|port| Port { name: port.name.text.clone(), direction: port.direction, is_used: false });
    let mut unit = Unit {
        name: name.to_owned(),
        kind: process.name.text.clone(),
        doc: process.doc.clone(),
        host: known.hosts.get(path).copied().unwrap_or(0),
        is_service: process.is_service,
        is_group: true,
        ports: ports.chain(messages).collect(),
        units: units.collect(),
        ..Unit::default()
    };
    connect(&mut unit, process);
    if let Some(actions) = &process.actions {
        take(&mut unit, process, actions, &mut Vec::new());
    }
    unit
}

fn leaf(known: &Known<'_>, process: &Process, slot: usize, path: &str) -> Unit {
    let instance = &process.instances[slot];
    let module = if let Target::Module(module) = instance.target { Some(&known.spec.modules[module]) } else { None };
    let mut ports: Vec<Port> = Vec::new();
    let mut add = |name: &str, direction: Direction| {
        if ports.iter().all(|port| port.name != name) {
            let is_used = known.wired.contains(&(path, name));
            ports.push(Port { name: name.to_owned(), direction, is_used });
        }
    };
    for port in module.iter().flat_map(|module| &module.ports) {
        add(&port.name.text, port.direction);
    }
    // A module without an interface has the ports that the spec speaks of.
    for connection in process.sets.iter().flat_map(|set| &set.connections) {
        for (end, direction) in [(&connection.from, Direction::Out), (&connection.to, Direction::In)] {
            if end.slot == slot {
                add(&end.port.text, direction);
            }
        }
    }
    for export in process.exports.iter().filter(|export| export.endpoint.slot == slot) {
        add(&export.endpoint.port.text, guess(&export.endpoint.port.text));
    }
    Unit {
        name: instance.name.text.clone(),
        kind: instance.kind.as_ref().map(|kind| kind.text.clone()).unwrap_or_default(),
        doc: module.map(|module| module.doc.clone()).unwrap_or_default(),
        host: known.hosts.get(path).copied().unwrap_or(0),
        is_service: module.is_some_and(|module| module.is_service),
        ports,
        ..Unit::default()
    }
}

/// A port of a group, with the direction of the port behind it.
fn exported(spec: &Spec, process: &Process, export: &crate::check::spec::Export) -> Port {
    let direction = direction(spec, process, &export.endpoint).unwrap_or_else(|| guess(&export.name.text));
    Port { name: export.name.text.clone(), direction, is_used: false }
}

fn direction(spec: &Spec, process: &Process, endpoint: &Endpoint) -> Option<Direction> {
    match process.instances[endpoint.slot].target {
        Target::Module(module) => {
            let port = spec.modules[module].ports.iter().find(|port| port.name.text == endpoint.port.text)?;
            Some(port.direction)
        }
        Target::Process(target) => {
            let target = &spec.processes[target];
            match target.exports.iter().find(|export| export.name.text == endpoint.port.text) {
                Some(export) => direction(spec, target, &export.endpoint),
                None => target.message_port(&endpoint.port.text).map(|port| port.direction),
            }
        }
        Target::Unknown => None,
    }
}

/// The direction of a port of which only the name is known.
fn guess(name: &str) -> Direction {
    if name.to_lowercase().starts_with("in") { Direction::In } else { Direction::Out }
}

/// Adds the arrows of a group, and marks the ports of inner groups that they touch.
fn connect(unit: &mut Unit, process: &Process) {
    let mut open = BTreeSet::new();
    if let Some(actions) = &process.actions {
        opened(actions, &mut open);
    }
    let mut links = Vec::new();
    for (index, export) in process.exports.iter().enumerate() {
        let border = End { unit: None, port: index };
        let Some(inner) = end(unit, &export.endpoint) else { continue };
        let is_in = unit.ports[index].direction == Direction::In;
        let (from, to) = if is_in { (border, inner) } else { (inner, border) };
        links.push(Link::plain(from, to));
    }
    for (index, set) in process.sets.iter().enumerate() {
        for connection in &set.connections {
            let (Some(from), Some(to)) = (end(unit, &connection.from), end(unit, &connection.to)) else { continue };
            links.push(Link {
                set: Some(index),
                label: set.label.as_ref().map(|label| label.text.clone()).unwrap_or_default(),
                is_pull: connection.transfer == Transfer::Pull,
                is_cut: set.owner.is_some() && !open.contains(&index),
                ..Link::plain(from, to)
            });
        }
    }
    links.extend(topics(unit, process));
    for end in links.iter().flat_map(|link| [link.from, link.to]) {
        if let Some(inner) = end.unit.map(|slot| &mut unit.units[slot]).filter(|inner| inner.is_group) {
            inner.ports[end.port].is_used = true;
        }
    }
    unit.links = links;
}

/// Adds the topics and services of ROS 2 of a group, which stand beside its members; returns the arrows to and from them.
fn topics(unit: &mut Unit, process: &Process) -> Vec<Link> {
    let (mut links, count) = (Vec::new(), unit.units.len());
    for topic in &process.outside.topics {
        let Some(inner) = end(unit, &topic.endpoint) else { continue };
        let direction = if topic.way.is_outward() { Direction::In } else { Direction::Out };
        let name = topic.name.text.as_str();
        let known = unit.units.iter().skip(count).position(|unit| unit.name == name).map(|at| count + at);
        let slot = known.unwrap_or_else(|| {
            unit.units.push(Unit {
                name: name.to_owned(),
                kind: if topic.way.is_service() { "service" } else { "topic" }.to_owned(),
                host: unit.host,
                is_service: true,
                ..Unit::default()
            });
            unit.units.len() - 1
        });
        // A topic to which the mission both publishes and subscribes has a port on each side.
        let ports = &mut unit.units[slot].ports;
        let port = ports.iter().position(|port| port.direction == direction).unwrap_or_else(|| {
            ports.push(Port { name: topic.endpoint.port.text.clone(), direction, is_used: true });
            ports.len() - 1
        });
        let outer = End { unit: Some(slot), port };
        let (from, to) = if topic.way.is_outward() { (inner, outer) } else { (outer, inner) };
        links.push(Link::plain(from, to));
    }
    links
}

/// Notes the resources that each member holds while it runs. `held` has the resources of the `using`s around the expression.
fn take(unit: &mut Unit, process: &Process, expr: &Expr, held: &mut Vec<usize>) {
    let before = held.len();
    if let ExprKind::Using(taken, _) = &expr.kind {
        held.extend(taken);
    } else if let ExprKind::Run(slot, _) = &expr.kind {
        for name in held.iter().map(|&resource| &process.resources[resource].text) {
            let resources = &mut unit.units[*slot].resources;
            if !resources.contains(name) {
                resources.push(name.clone());
            }
        }
    }
    expr.parts().into_iter().for_each(|part| take(unit, process, part, held));
    held.truncate(before);
}

fn end(unit: &Unit, endpoint: &Endpoint) -> Option<End> {
    let port = unit.units[endpoint.slot].ports.iter().position(|port| port.name == endpoint.port.text)?;
    Some(End { unit: Some(endpoint.slot), port })
}

/// The connection sets that an expression opens.
fn opened(expr: &Expr, open: &mut BTreeSet<usize>) {
    if let ExprKind::Run(_, sets) = &expr.kind {
        open.extend(sets);
    }
    for part in expr.parts() {
        opened(part, open);
    }
}
