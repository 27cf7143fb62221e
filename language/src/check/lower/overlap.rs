//! Checks the connections of a process whose old and new program are to overlap. Only its own supervisor can hand
//! connections over, and only connections with pushed values.

use super::tree::Tree;
use crate::check::diagnostics::Diagnostics;
use crate::check::spec::Spec;
use crate::check::types::no_overlap;
use crate::plan::{Leaf, Replacement, Transfer, Wire};
use std::collections::BTreeSet;

/// Reports each instance with `replace overlap` if another program cannot take over its connections during the run.
pub(super) fn check(spec: &Spec, tree: &Tree, wires: &[Wire], diagnostics: &mut Diagnostics) {
    let mut told = BTreeSet::new();
    for (number, leaf) in (0_u32..).zip(&tree.leaves).filter(|(_, leaf)| is_meant(leaf)) {
        let (group, slot) = tree.place_of[number as usize];
        let instance = &spec.processes[tree.process_of[group]].instances[slot];
        let Some(span) = instance.policies.overlap else { continue };
        let Some(why) = obstacle(tree, wires, number, leaf, group) else { continue };
        // Several leaves may have the same text.
        if told.insert(span) {
            diagnostics.push(no_overlap(span, &instance.name.text, &why));
        }
    }
}

fn is_meant(leaf: &Leaf) -> bool {
    leaf.policy.replacement == Replacement::Overlap
}

/// Returns the reason if the connections of a leaf cannot be handed over.
fn obstacle(tree: &Tree, wires: &[Wire], number: u32, leaf: &Leaf, group: usize) -> Option<String> {
    let written = leaf.keys.iter().find(|keys| keys.is_write);
    if let Some(keys) = written {
        return Some(format!("it writes `{}` of the database, and both programs would write this key", keys.keys));
    }
    let is_its = |wire: &Wire| wire.from.leaf == number || wire.to.leaf == number;
    let port = |wire: &Wire| if wire.from.leaf == number { wire.from.port.clone() } else { wire.to.port.clone() };
    let other = |transfer: Transfer, words: &str| {
        let wire = wires.iter().find(|wire| is_its(wire) && wire.transfer == transfer)?;
        Some(format!("`{}` {words}", port(wire)))
    };
    let is_far = |wire: &Wire, at: u32| {
        let others = tree.groups.iter().enumerate().filter(|(other, _)| *other != group);
        is_its(wire) && others.flat_map(|(_, group)| &group.sets).any(|set| set.wires.contains(&at))
    };
    let far = || (0_u32..).zip(wires).find(|(at, wire)| is_far(wire, *at)).map(|(_, wire)| port(wire));
    other(Transfer::Pull, "is pulled, and only values that are pushed can be handed over")
        .or_else(|| other(Transfer::Call, "is a call, and only values that are pushed can be handed over"))
        .or_else(|| {
            Some(format!(
                "`{}` is connected by another group, whose supervisor does not know of the second program",
                far()?
            ))
        })
}
