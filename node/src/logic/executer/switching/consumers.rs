//! The participants of a switch and their names.

use crate::logic::effect::Out;
use crate::logic::executer::wires::{Difference, are_of_one_input};
use crate::logic::executer::{ExecContext, leaf_host};
use crate::logic::protocol::ToParticipant;
use comms::logic::switch::{Expect, Flip};
use language::plan::{Group, Plan};
use std::collections::{BTreeMap, BTreeSet};

/// A switch that consumers are to expect.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected<'a> {
    pub(super) generation: u64,
    pub(super) difference: &'a Difference,
    pub(super) consumers: &'a BTreeSet<u32>,
    /// The wires that some of the consumers flip by themselves once they have taken it.
    pub(super) then: &'a BTreeMap<u32, Flip>,
}

/// Makes the consumers of a group expect a switch.
pub(super) fn expect(expected: Expected<'_>, group: u32, context: ExecContext<'_>, out: &mut Out<'_>) {
    let Expected { generation, difference, consumers, then } = expected;
    for &leaf in consumers {
        let Some(host) = leaf_host(context.plan, leaf) else { continue };
        let theirs =
            |wires: &[u32]| wires.iter().copied().filter(|wire| pushes_to(context.plan, *wire, leaf)).collect();
        let expect = Expect { generation, close: theirs(&difference.close), open: theirs(&difference.open) };
        let order = match then.get(&leaf).cloned() {
            None => ToParticipant::Expect { group, leaf, expect },
            Some(then) => ToParticipant::ExpectAnd { group, leaf, expect, then },
        };
        out.send(host, context.deployment.to_participant(order));
    }
}

/// Returns why wires cannot be opened next to those that stay: an input has one writer at a time.
pub(super) fn second_writer(plan: &Plan, open: &[u32], stay: impl Iterator<Item = u32>) -> Option<String> {
    let ends = |wire: u32| plan.wires.get(wire as usize);
    let stay: Vec<u32> = stay.collect();
    open.iter().find_map(|wire| {
        let new = ends(*wire)?;
        let other =
            stay.iter().filter_map(|wire| ends(*wire)).find(|other| other.to == new.to && other.from != new.from)?;
        let path = |leaf: u32| plan.leaves.get(leaf as usize).map_or("?", |leaf| &leaf.path);
        Some(format!(
            "`{}` writes to `{}`, `{}` at this moment, and `{}` would, too: an input has one writer at a time",
            path(other.from.leaf),
            path(new.to.leaf),
            new.to.port,
            path(new.from.leaf)
        ))
    })
}

pub(in crate::logic::executer) fn pushes_to(plan: &Plan, wire: u32, leaf: u32) -> bool {
    plan.wires.get(wire as usize).is_some_and(|ends| ends.to.leaf == leaf) && are_of_one_input(plan, wire, wire)
}

/// Returns the consumers to which a switch closes wires and opens others.
pub(super) fn consumers_of_both(plan: &Plan, difference: &Difference) -> BTreeSet<u32> {
    let closed = consumers_of(plan, &difference.close);
    closed.intersection(&consumers_of(plan, &difference.open)).copied().collect()
}

pub(super) fn consumers_of_any(plan: &Plan, difference: &Difference) -> BTreeSet<u32> {
    &consumers_of(plan, &difference.close) | &consumers_of(plan, &difference.open)
}

/// Returns the programs that these wires push to.
pub(super) fn consumers_of(plan: &Plan, wires: &[u32]) -> BTreeSet<u32> {
    let pushed = wires.iter().filter(|wire| are_of_one_input(plan, **wire, **wire));
    pushed.filter_map(|wire| plan.wires.get(*wire as usize)).map(|wire| wire.to.leaf).collect()
}

/// Returns the name of a set, with the path of its owner: `main/hit/force[lbl1]`; one without an owner has its group's.
pub(super) fn set_name(group: &Group, set: u32) -> String {
    let Some(set) = group.sets.get(set as usize) else { return String::new() };
    let owner = set.owner.and_then(|slot| group.members.get(slot as usize));
    let owner = owner.map_or_else(|| group.path.clone(), |member| format!("{}/{}", group.path, member.name));
    set.label.as_ref().map_or_else(|| owner.clone(), |label| format!("{owner}[{label}]"))
}
