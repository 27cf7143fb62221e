//! The effects of losing a link between two hosts while a third host relays messages: control continues, but data is
//! not relayed.

use super::case::is_step;
use super::span::{Span, span};
use super::{Mission, Row, Severity, Table, torn};
use crate::explore::{Limits, Nobody, explore};
use crate::story::{member_name, running, story};
use crate::system::MemberRef;
use crate::system::{FaultKind, Frame, Phase, System};
use crate::times::Times;
use crate::wires::{Line, lines};
use std::collections::BTreeMap;

/// The phase in which no step is running.
const BETWEEN: &str = "between two steps";

/// Adds a row for each link, and for each set of wires that stop carrying data with it.
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
    let spans: Vec<Span> = lines.iter().filter_map(|line| span(&system, line)).collect();
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
            // A phase with a running step is more informative than a phase with orders in transit.
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

/// Returns the running steps.
fn phase(system: &System<'_>, frame: &Frame) -> String {
    let steps = system.there(frame).into_iter().filter(|seat| is_step(system, *seat));
    let names: Vec<String> = steps.filter_map(|MemberRef { unit, member }| member_name(system, unit, member)).collect();
    if names.is_empty() { BETWEEN.to_owned() } else { names.join(", ") }
}
