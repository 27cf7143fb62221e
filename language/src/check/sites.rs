//! Finds the place in the text for each part of a plan.

use super::lower::places;
use super::spec::{Direction, Spec, Target};
use crate::plan::{MemberKind, Plan};
use crate::sites::{GroupSites, LeafFacts, Property, Sites};

/// Returns the places of a plan that was made of this spec and root, with its properties.
pub(super) fn sites(spec: &Spec, root: usize, plan: &Plan, properties: Vec<Property>) -> Sites {
    let empty = GroupSites { name: spec.processes[root].name.span, members: vec![], nodes: vec![], sets: vec![] };
    let groups = vec![empty; plan.groups.len()];
    let mut sites = Sites { groups, leaves: vec![LeafFacts::default(); plan.leaves.len()], properties };
    let mut open = vec![(0, root)];
    while let Some((group, process)) = open.pop() {
        let source = &spec.processes[process];
        let members = source.instances.iter().map(|instance| instance.name.span).collect();
        let nodes = source.actions.as_ref().map_or_else(|| vec![source.name.span], places);
        let first = |set: &super::spec::Set| set.connections.first().map_or(source.name.span, |first| first.span);
        let sets = source.sets.iter().map(first).collect();
        sites.groups[group] = GroupSites { name: source.name.span, members, nodes, sets };
        for (member, instance) in plan.groups[group].members.iter().zip(&source.instances) {
            match (member.kind, instance.target) {
                (MemberKind::Group(inner), Target::Process(target)) => open.push((inner as usize, target)),
                (MemberKind::Leaf(leaf), Target::Module(module)) => {
                    let module = &spec.modules[module];
                    let needs = module.ports.iter().filter(|port| port.direction == Direction::In && !port.is_optional);
                    let inputs = needs.map(|port| port.name.text.clone()).collect();
                    sites.leaves[leaf as usize] = LeafFacts { takes: module.takes, inputs };
                }
                (MemberKind::Leaf(_) | MemberKind::Group(_), _) => {}
            }
        }
    }
    sites
}
