//! What the loss of a link between two hosts does where a third one passes messages on: control goes on, data does not take the way around.

use super::case::is_step;
use super::{Mission, Row, Severity, Table, torn};
use crate::explore::{Limits, Nobody, explore};
use crate::model::{Model, short};
use crate::property::place_of;
use crate::story::{member_name, running, story};
use crate::system::{FaultKind, Frame, Phase, System};
use crate::times::Times;
use crate::wires::{Line, lines};
use language::plan::Expression;
use std::collections::BTreeMap;

/// The phase in which no step runs.
const BETWEEN: &str = "between two steps";

/// A wire between two hosts, in a system.
struct Span {
    /// The hosts, the smaller first.
    hosts: (u32, u32),
    /// The unit of the group that has the wire, and the nodes that open it; none if it is always open.
    unit: usize,
    nodes: Option<Vec<usize>>,
    from: (usize, u32),
    to: (usize, u32),
    words: String,
}

/// Adds a row for each link and each set of wires that go dead with it.
pub(super) fn rows(times: &Times<'_, '_>, limits: &Limits<'_>, table: &mut Table) {
    let model = times.model;
    if model.plan.hosts.len() < 3 {
        return;
    }
    let host = |leaf: u32| model.plan.leaves[leaf as usize].host;
    let ends = |line: &Line| (&model.plan.wires[line.wire as usize].from, &model.plan.wires[line.wire as usize].to);
    let mut lines = lines(model);
    lines.retain(|line| host(ends(line).0.leaf) != host(ends(line).1.leaf));
    if lines.is_empty() {
        return;
    }
    if !limits.goes_on.goes_on() {
        return table.unfinished.push("links".to_owned());
    }
    let system = torn(model, &[]);
    let graph = explore(&system, limits, true, &Nobody).graph;
    table.states += u64::from(graph.store.count());
    if graph.reached.is_some() {
        return table.unfinished.push("links".to_owned());
    }
    let spans: Vec<Span> = lines.iter().filter_map(|line| span(model, &system, line)).collect();
    let mut rows: BTreeMap<(String, String), Row> = BTreeMap::new();
    let mut frame = system.initial();
    for state in 0..graph.store.count() {
        system.unpack(graph.store.get(state), &mut frame);
        if frame.phase != Phase::Running {
            continue;
        }
        let mut dead: BTreeMap<(u32, u32), Vec<&str>> = BTreeMap::new();
        for span in spans.iter().filter(|span| span.carries(&system, &frame)) {
            dead.entry(span.hosts).or_default().push(&span.words);
        }
        for ((one, other), words) in dead {
            let name = |host: u32| model.plan.hosts[host as usize].as_str();
            let program = format!("{} - {}", name(one), name(other));
            let key = (program.clone(), words.join(", "));
            // A phase with a step in it says more than one in which orders are under way.
            let phase = phase(&system, &frame);
            if rows.get(&key).is_some_and(|known| known.phase != BETWEEN || phase == BETWEEN) {
                continue;
            }
            let row = Row {
                program,
                fault: FaultKind::LinkLost.word().to_owned(),
                phase,
                effect: format!("{} no longer arrives; messages between the nodes take another way", key.1),
                running: running(&system, &frame).0,
                safe_within: None,
                mission: if system.program(0).is_service() { Mission::GoesOn } else { Mission::CanBeDone },
                severity: Severity::Blind,
                story: story(&system, &graph, state),
            };
            rows.insert(key, row);
        }
    }
    table.rows.extend(rows.into_values());
}

/// The steps that run.
fn phase(system: &System<'_>, frame: &Frame) -> String {
    let steps = system.there(frame).into_iter().filter(|seat| is_step(system, *seat));
    let names: Vec<String> = steps.filter_map(|(unit, member)| member_name(system, unit, member)).collect();
    if names.is_empty() { BETWEEN.to_owned() } else { names.join(", ") }
}

fn span(model: &Model<'_>, system: &System<'_>, line: &Line) -> Option<Span> {
    let wire = &model.plan.wires[line.wire as usize];
    let leaf = |leaf: u32| &model.plan.leaves[leaf as usize];
    let hosts = (leaf(wire.from.leaf).host, leaf(wire.to.leaf).host);
    let seat = |leaf: u32| {
        let mut at = place_of(model, leaf);
        while let Some((group, slot)) = at {
            if let Some(seat) = system.find(group, slot) {
                return Some(seat);
            }
            at = model.around[group as usize];
        }
        None
    };
    let source = &model.plan.groups[line.group as usize];
    let mut named = Vec::new();
    let mut unit_of_group = None;
    for (unit, of) in system.units.iter().enumerate() {
        let part = &model.parts[of.part];
        if part.group != line.group {
            continue;
        }
        unit_of_group.get_or_insert(unit);
        let mut node = 0;
        crate::model::walk(&part.expression, &mut |expression| {
            if matches!(expression, Expression::Run { sets, .. } if sets.contains(&line.set)) {
                named.push(node);
            }
            node += 1;
        });
    }
    let nodes = if source.sets_always.contains(&line.set) { None } else { Some(named) };
    let words = format!(
        "{}.{} -> {}.{}",
        short(&leaf(wire.from.leaf).path),
        wire.from.port,
        short(&leaf(wire.to.leaf).path),
        wire.to.port
    );
    let hosts = (hosts.0.min(hosts.1), hosts.0.max(hosts.1));
    Some(Span { hosts, unit: unit_of_group?, nodes, from: seat(wire.from.leaf)?, to: seat(wire.to.leaf)?, words })
}

impl Span {
    /// Whether data goes over it.
    fn carries(&self, system: &System<'_>, frame: &Frame) -> bool {
        let is_open = match &self.nodes {
            None => frame.states[self.unit].is_node_active(0),
            Some(nodes) => nodes.iter().any(|node| frame.states[self.unit].is_node_active(*node)),
        };
        is_open && system.is_there(frame, self.from) && system.is_there(frame, self.to)
    }
}
