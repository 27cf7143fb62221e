//! Finds the place in the text for each part of a plan.

use super::lower::{places, topics};
use super::spec::{Direction, Port, Spec, Target};
use crate::plan::{Expression, MemberKind, Plan};
use crate::sites::{GroupSites, LeafFacts, Property, Sites};

/// Returns the places of a plan that was made from this spec and root, with its properties.
pub(super) fn sites(spec: &Spec, root: usize, plan: &Plan, properties: Vec<Property>) -> Sites {
    let empty = GroupSites { name: spec.processes[root].name.span, members: vec![], nodes: vec![], sets: vec![] };
    let groups = vec![empty; plan.groups.len()];
    let mut sites = Sites { groups, leaves: vec![LeafFacts::default(); plan.leaves.len()], properties };
    let mut open = vec![(0, root)];
    while let Some((group, process)) = open.pop() {
        let source = &spec.processes[process];
        let mut members: Vec<_> = source.instances.iter().map(|instance| instance.name.span).collect();
        if source.chart().is_some() {
            // The program for the ports of an activity is the last member, and has no instance in the text.
            members.resize(plan.groups[group].members.len(), source.name.span);
        }
        let nodes = source.actions.as_ref().map_or_else(|| vec![source.name.span], places);
        let first = |set: &super::spec::Set| set.connections.first().map_or(source.name.span, |first| first.span);
        let sets = source.sets.iter().map(first).collect();
        sites.groups[group] = GroupSites { name: source.name.span, members, nodes, sets };
        for (member, instance) in plan.groups[group].members.iter().zip(&source.instances) {
            match (member.kind, instance.target) {
                (MemberKind::Group(inner), Target::Process(target)) => open.push((inner as usize, target)),
                (MemberKind::Leaf(leaf), Target::Module(module)) => {
                    let module = &spec.modules[module];
                    let inputs = module.ports.iter().filter(|port| port.direction == Direction::In);
                    let (optional, needed): (Vec<_>, Vec<_>) = inputs.partition(|port| port.is_optional);
                    let names = |ports: Vec<&Port>| ports.iter().map(|port| port.name.text.clone()).collect();
                    let (inputs, optional) = (names(needed), names(optional));
                    sites.leaves[leaf as usize] = LeafFacts { takes: module.times.takes, inputs, optional };
                }
                (MemberKind::Leaf(_) | MemberKind::Group(_), _) => {}
            }
        }
    }
    add_bridges(spec, plan, &mut sites.groups[0]);
    sites
}

/// Adds the places of the bridges to ROS 2, which are the last members of `main` and have no instance in the text.
fn add_bridges(spec: &Spec, plan: &Plan, main: &mut GroupSites) {
    let (Some(span), Some(group)) = (topics::place(spec), plan.groups.first()) else { return };
    let count = group.members.len().saturating_sub(main.members.len());
    if let (Expression::Concurrent(of), Some(root)) = (&group.expression, main.nodes.first())
        && of.len() == count + 1
    {
        main.nodes.insert(0, *root);
    }
    main.members.extend(std::iter::repeat_n(span, count));
    main.nodes.extend(std::iter::repeat_n(span, count));
    main.sets.push(span);
}
