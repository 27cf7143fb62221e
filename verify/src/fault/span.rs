//! A wire in a system: the hosts of its two ends, and the states in which data goes over it.

use crate::model::{Model, short, walk};
use crate::property::place_of;
use crate::system::MemberRef;
use crate::system::{Frame, System};
use crate::wires::Line;
use language::plan::{Expression, LeafPort};

/// A wire, with the set that opens it.
#[derive(Clone, Debug)]
pub(super) struct Span {
    /// The hosts of its two ends, the smaller number first.
    pub(super) hosts: (u32, u32),
    /// A unit of the group that has the wire, and the nodes that open the wire, each with its unit.
    /// No nodes if the wire is always open.
    unit: usize,
    nodes: Option<Vec<(usize, usize)>>,
    pub(super) from: MemberRef,
    pub(super) to: MemberRef,
    /// The wire in the words of a spec.
    pub(super) words: String,
}

/// Returns the wire of a line; none if its group is a black box.
pub(super) fn span(system: &System<'_>, line: &Line) -> Option<Span> {
    let model = system.model;
    let wire = &model.plan.wires[line.wire as usize];
    let leaf = |leaf: u32| &model.plan.leaves[leaf as usize];
    let hosts = (leaf(wire.from.leaf).host, leaf(wire.to.leaf).host);
    let mut named = Vec::new();
    let mut unit_of_group = None;
    for (unit, of) in system.units.iter().enumerate() {
        let part = &model.parts[of.part];
        if part.group != line.group {
            continue;
        }
        unit_of_group.get_or_insert(unit);
        let mut node = 0;
        walk(&part.expression, &mut |expression| {
            if matches!(expression, Expression::Run { sets, .. } if sets.contains(&line.set)) {
                named.push((unit, node));
            }
            node += 1;
        });
    }
    let unit = unit_of_group?;
    let is_always_open = model.plan.groups[line.group as usize].sets_always.contains(&line.set);
    Some(Span {
        hosts: (hosts.0.min(hosts.1), hosts.0.max(hosts.1)),
        unit,
        nodes: if is_always_open { None } else { Some(named) },
        from: seat_of(system, wire.from.leaf)?,
        to: seat_of(system, wire.to.leaf)?,
        words: format!("{} -> {}", end(model, &wire.from), end(model, &wire.to)),
    })
}

fn end(model: &Model<'_>, port: &LeafPort) -> String {
    format!("{}.{}", short(&model.plan.leaves[port.leaf as usize].path), port.port)
}

/// Returns the seat of a program, or of the innermost black box around it.
fn seat_of(system: &System<'_>, leaf: u32) -> Option<MemberRef> {
    let around = |(group, _): &(u32, u32)| system.model.around[*group as usize];
    let mut places = std::iter::successors(place_of(system.model, leaf), around);
    places.find_map(|(group, slot)| system.find(group, slot))
}

impl Span {
    /// Returns whether data goes over the wire in a state.
    pub(super) fn carries(&self, system: &System<'_>, frame: &Frame) -> bool {
        let is_open = match &self.nodes {
            None => frame.states[self.unit].is_node_active(0),
            Some(nodes) => nodes.iter().any(|(unit, node)| frame.states[*unit].is_node_active(*node)),
        };
        is_open && system.is_there(frame, self.from) && system.is_there(frame, self.to)
    }
}
