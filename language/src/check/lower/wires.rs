//! Resolves connections through the borders of groups, in either direction, to wires between leaves.

use super::messages::Messages;
use super::tree::Tree;
use crate::check::spec::{Endpoint, Spec};
use crate::plan::{ConnectionSet, KeyBinding, LeafPort, MemberKind, Quality, Transfer, Wire};
use std::collections::BTreeMap;

/// All wires, each once. Two sets can share a wire.
#[derive(Default)]
pub(super) struct Wires {
    pub(super) all: Vec<Wire>,
    known: BTreeMap<(u32, String, u32, String, Transfer, Quality), u32>,
}

impl Wires {
    /// Returns the sets of a group and adds their wires.
    pub(super) fn sets(&mut self, tree: &Tree, spec: &Spec, messages: &Messages, group: usize) -> Vec<ConnectionSet> {
        let process = &spec.processes[tree.process_of[group]];
        let port = |endpoint: &Endpoint| match end(tree, spec, group, endpoint)? {
            End::Leaf(port) => Some(port),
            End::Activity { group, port } => Some(LeafPort { leaf: messages.leaf(group)?, port: port.to_owned() }),
        };
        let sets = process.sets.iter().map(|set| {
            let wires = set.connections.iter().filter_map(|connection| {
                let (from, to) = (port(&connection.from)?, port(&connection.to)?);
                Some(self.add(Wire { from, to, transfer: connection.transfer, quality: connection.quality }))
            });
            let mut wires: Vec<u32> = wires.collect();
            wires.dedup();
            ConnectionSet {
                owner: set.owner.map(number),
                label: set.label.as_ref().map(|label| label.text.clone()),
                wires,
            }
        });
        sets.collect()
    }

    /// Adds a wire and returns its number. If there is an equal wire, its number is returned.
    pub(super) fn add(&mut self, wire: Wire) -> u32 {
        let (from, to) = (wire.from.clone(), wire.to.clone());
        let key = (from.leaf, from.port, to.leaf, to.port, wire.transfer, wire.quality);
        let next = number(self.all.len());
        *self.known.entry(key).or_insert_with(|| {
            self.all.push(wire);
            next
        })
    }
}

/// Connects the ports of leaves with keys of the database.
pub(super) fn connect_keys(tree: &mut Tree, spec: &Spec, group: usize) {
    for connection in &spec.processes[tree.process_of[group]].outside.keys {
        let Some(LeafPort { leaf, port }) = leaf_port(tree, spec, group, &connection.endpoint) else { continue };
        let binding = KeyBinding { port, keys: connection.keys.clone(), is_write: connection.is_write };
        let known = &mut tree.leaves[leaf as usize].keys;
        if !known.contains(&binding) {
            known.push(binding);
        }
    }
}

/// The owner of a port, after following all exports of groups.
pub(super) enum End<'e> {
    /// A port of a leaf.
    Leaf(LeafPort),
    /// A message port of a group that is an activity.
    Activity {
        /// The group.
        group: usize,
        /// The port.
        port: &'e str,
    },
}

/// Follows a port of a group's member down to the leaf or the activity that has it.
pub(super) fn end<'e>(tree: &Tree, spec: &'e Spec, group: usize, endpoint: &'e Endpoint) -> Option<End<'e>> {
    let (mut group, mut endpoint) = (group, endpoint);
    loop {
        match tree.groups[group].members[endpoint.slot].kind {
            MemberKind::Leaf(leaf) => return Some(End::Leaf(LeafPort { leaf, port: endpoint.port.text.clone() })),
            MemberKind::Group(inner) => {
                group = inner as usize;
                let process = &spec.processes[tree.process_of[group]];
                let port = endpoint.port.text.as_str();
                match process.exports.iter().find(|export| export.name.text == port) {
                    Some(export) => endpoint = &export.endpoint,
                    None => return process.message_port(port).map(|_| End::Activity { group, port }),
                }
            }
        }
    }
}

/// Follows a port of a group's member down to the leaf that has it.
pub(super) fn leaf_port(tree: &Tree, spec: &Spec, group: usize, endpoint: &Endpoint) -> Option<LeafPort> {
    if let Some(End::Leaf(port)) = end(tree, spec, group, endpoint) { Some(port) } else { None }
}

fn number(index: usize) -> u32 {
    u32::try_from(index).expect("a plan has fewer than 2^32 wires")
}
