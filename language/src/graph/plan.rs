//! The model of a picture from the plan of a deployment. A view of a running mission has no spec.
//!
//! A plan has wires between leaves. A wire that crosses the border of a group gets a port there.

use super::model::{End, Link, Unit, port};
use crate::check::spec::Direction;
use crate::plan::{Expression, Group, LeafPort, MemberKind, Plan, Transfer, Wire};
use std::collections::{BTreeMap, BTreeSet};

/// Returns the unit of `main` with everything below it. The caller has validated the plan.
pub(super) fn unit(plan: &Plan) -> Unit {
    let mut root = group(plan, 0);
    for (number, set) in sets(plan) {
        let wire = &plan.wires[number as usize];
        if let (Some(from), Some(to)) = (place(plan, &wire.from), place(plan, &wire.to)) {
            connect(&mut root, &from, &to, &Crossing { wire, number, set });
        }
    }
    root
}

/// Returns the connection set of each wire, by the number of the wire. A wire that was taken away from a running plan has none.
pub(super) fn sets(plan: &Plan) -> BTreeMap<u32, Set<'_>> {
    let (live, mut sets) = (plan.live_groups(), BTreeMap::new());
    for (_, group) in (0_u32..).zip(&plan.groups).filter(|(number, _)| live.contains(number)) {
        let open = opened(group);
        for (number, set) in (0_u32..).zip(&group.sets) {
            let is_cut = set.owner.is_some() && !open.contains(&number);
            let new = Set { number: sets.len(), label: set.label.as_deref().unwrap_or_default(), is_cut };
            for wire in &set.wires {
                sets.entry(*wire).or_insert(new);
            }
        }
    }
    sets
}

/// The connection set of a wire.
#[derive(Clone, Copy, Debug)]
pub(super) struct Set<'a> {
    number: usize,
    label: &'a str,
    /// Whether no event action ever opens it.
    is_cut: bool,
}

/// Returns the connection sets that a group opens.
fn opened(group: &Group) -> BTreeSet<u32> {
    let (mut open, mut waiting) = (BTreeSet::new(), vec![&group.expression]);
    while let Some(part) = waiting.pop() {
        if let Expression::Run { sets, .. } = part {
            open.extend(sets);
        }
        waiting.extend(part.operands());
    }
    open
}

/// A wire that is being drawn.
struct Crossing<'a> {
    wire: &'a Wire,
    number: u32,
    set: Set<'a>,
}

fn group(plan: &Plan, number: u32) -> Unit {
    let group = &plan.groups[number as usize];
    let mut unit = Unit { is_group: true, ..empty(&group.path, &group.process, group.host) };
    let mut slots = BTreeMap::new();
    for (slot, member) in (0_u32..).zip(&group.members).filter(|(_, member)| !member.name.is_empty()) {
        let inner = match member.kind {
            MemberKind::Group(inner) => self::group(plan, inner),
            MemberKind::Leaf(leaf) => {
                let leaf = &plan.leaves[leaf as usize];
                empty(&leaf.path, &leaf.module, leaf.host)
            }
        };
        slots.insert(slot, unit.units.len());
        unit.units.push(Unit { is_service: member.service, ..inner });
    }
    take(&mut unit, &slots, group);
    unit
}

fn empty(path: &str, kind: &str, host: u32) -> Unit {
    Unit {
        name: path.rsplit('/').next().unwrap_or(path).to_owned(),
        key: Some(path.to_owned()),
        kind: kind.to_owned(),
        host: host as usize,
        ..Unit::default()
    }
}

/// Notes the resources that each member of a group holds while it runs.
fn take(unit: &mut Unit, slots: &BTreeMap<u32, usize>, group: &Group) {
    let mut waiting: Vec<(&Expression, Vec<&String>)> = vec![(&group.expression, Vec::new())];
    while let Some((part, mut held)) = waiting.pop() {
        if let Expression::Using { resources, .. } = part {
            held.extend(resources);
        } else if let Expression::Run { member, .. } = part
            && let Some(inner) = slots.get(member).and_then(|slot| unit.units.get_mut(*slot))
        {
            for name in &held {
                if !inner.resources.contains(name) {
                    inner.resources.push((*name).clone());
                }
            }
        }
        waiting.extend(part.operands().into_iter().rev().map(|part| (part, held.clone())));
    }
}

/// Returns the names from a member of `main` down to the leaf of a port.
fn place<'a>(plan: &'a Plan, end: &LeafPort) -> Option<Vec<&'a str>> {
    let path = plan.leaves[end.leaf as usize].path.strip_prefix("main/")?;
    Some(path.split('/').collect())
}

/// Draws a wire between two leaves below a unit.
fn connect(unit: &mut Unit, from: &[&str], to: &[&str], crossing: &Crossing<'_>) {
    let (Some((first, from_rest)), Some((last, to_rest))) = (from.split_first(), to.split_first()) else { return };
    let (Some(out), Some(into)) = (member(unit, first), member(unit, last)) else { return };
    if out == into && !from_rest.is_empty() && !to_rest.is_empty() {
        return connect(&mut unit.units[out], from_rest, to_rest, crossing);
    }
    let Crossing { wire, number, set } = crossing;
    let end = |of: &LeafPort, direction| WireEnd { port: of.port.clone(), direction, wire: *number };
    let from = border(&mut unit.units[out], from_rest, &end(&wire.from, Direction::Out));
    let to = border(&mut unit.units[into], to_rest, &end(&wire.to, Direction::In));
    if let (Some(from), Some(to)) = (from, to) {
        let (from, to) = (End { unit: Some(out), port: from }, End { unit: Some(into), port: to });
        let is_pull = wire.transfer == Transfer::Pull;
        let (label, is_cut) = (set.label.to_owned(), set.is_cut);
        let link = Link { set: Some(set.number), label, is_pull, is_cut, ..Link::plain(from, to) };
        draw(unit, link, *number);
    }
}

/// One end of a wire that is being drawn.
struct WireEnd {
    port: String,
    direction: Direction,
    wire: u32,
}

/// Returns the port on the border of a unit that leads to a port of the leaf below it.
fn border(unit: &mut Unit, rest: &[&str], end: &WireEnd) -> Option<usize> {
    let Some((next, rest)) = rest.split_first() else { return Some(port(&mut unit.ports, &end.port, end.direction)) };
    let slot = member(unit, next)?;
    let inner = End { unit: Some(slot), port: border(&mut unit.units[slot], rest, end)? };
    let is_in = end.direction == Direction::In;
    let known = unit.links.iter().find_map(|link| {
        let (ours, theirs) = if is_in { (link.from, link.to) } else { (link.to, link.from) };
        (ours.unit.is_none() && theirs == inner).then_some(ours.port)
    });
    let number = known.unwrap_or_else(|| {
        // Two inner ports of one name get two ports on the border.
        let is_taken = unit.ports.iter().any(|port| port.name == end.port && port.direction == end.direction);
        let name = if is_taken { format!("{next}.{}", end.port) } else { end.port.clone() };
        port(&mut unit.ports, &name, end.direction)
    });
    let border = End { unit: None, port: number };
    let (from, to) = if is_in { (border, inner) } else { (inner, border) };
    draw(unit, Link::plain(from, to), end.wire);
    Some(number)
}

fn member(unit: &Unit, name: &str) -> Option<usize> {
    unit.units.iter().position(|inner| inner.name == name)
}

/// Adds a wire to the arrow that is there, or else a new arrow.
fn draw(unit: &mut Unit, link: Link, wire: u32) {
    let known = unit.links.iter().position(|known| (known.from, known.to, known.set) == (link.from, link.to, link.set));
    let place = known.unwrap_or_else(|| {
        unit.links.push(link);
        unit.links.len() - 1
    });
    unit.links[place].wires.push(wire);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{PlanError, difference};
    use crate::{NoPicture, Options, Source, activities_of_plan, compile, graph_of_activity, graph_of_plan};

    const SPEC: &str = "
        module Arm(host) { exec \"arm\"; in Set: Pose; out Now: Pose; }
        process Inner(here) {
            host { here }
            instantiated_processes { a instof Arm(here); b instof Arm(here); }
            external_io { Set = a, Set; Now = b, Now; }
            internal_connections { a, Now -> b, Set; }
            internal_event_actions { a, b }
        }
        process main() {
            host { c1 }
            resource table;
            instantiated_processes { left instof Inner(c1); right instof Arm(c2); }
            internal_connections { right, Now -> left, Set; left, Now -> right, Set; }
            internal_event_actions { left, using(table) right }
        }";

    fn plan(text: &str) -> Plan {
        let compiled = compile(&Source::new("a.dca", text), &[], &Options::named("a"));
        compiled.plan.unwrap_or_else(|| panic!("{:?}", compiled.diagnostics))
    }

    /// The links of a unit in words.
    fn links(unit: &Unit) -> Vec<String> {
        let name = |end: &End| match end.unit {
            Some(slot) => format!("{}.{}", unit.units[slot].name, unit.units[slot].ports[end.port].name),
            None => format!("border.{}", unit.ports[end.port].name),
        };
        let words = |link: &Link| format!("{} -> {} {:?}", name(&link.from), name(&link.to), link.wires);
        let mut links: Vec<String> = unit.links.iter().map(words).collect();
        links.sort();
        links
    }

    #[test]
    fn a_wire_gets_a_port_on_each_border_that_it_crosses() {
        let plan = plan(SPEC);
        let root = unit(&plan);
        let number = |ends: &str| plan.wires.iter().position(|wire| plan.ends(wire) == ends).expect(ends);
        let ends = [
            "main/left/a, Now -> main/left/b, Set",
            "main/right, Now -> main/left/a, Set",
            "main/left/b, Now -> main/right, Set",
        ];
        let [inside, into, out] = ends.map(number);
        assert_eq!(links(&root), [format!("left.Now -> right.Set [{out}]"), format!("right.Now -> left.Set [{into}]")]);
        let left = &root.units[0];
        assert_eq!(
            links(left),
            [
                format!("a.Now -> b.Set [{inside}]"),
                format!("b.Now -> border.Now [{out}]"),
                format!("border.Set -> a.Set [{into}]")
            ]
        );
        assert_eq!((left.key.as_deref(), left.host), (Some("main/left"), 0));
        assert_eq!(root.units[1].resources, ["table"]);
    }

    /// A process that is added again under its old name gets other numbers, and the old ones stay in the plan.
    #[test]
    fn a_process_that_was_taken_away_has_no_arrows_and_no_states() {
        let activity = "
            activity Patrol(here: Host) {
                host { here }
                look instof Arm(here);
                initial state looking { run look; on done -> resting; }
                state resting { on after 1 s -> looking; }
            }";
        let text = SPEC.replace("left instof", "patrol instof Patrol(c1); left instof");
        let text = text.replace("{ left, using", "{ patrol, left, using") + activity;
        let without = text.replace("patrol instof Patrol(c1); left instof Inner(c1);", "");
        let without = without.replace("internal_connections { right, Now -> left, Set; left, Now -> right, Set; }", "");
        let running = plan(&text);
        let smaller = difference(&running, &plan(&without.replace("{ patrol, left, using", "{ using"))).unwrap().plan;
        assert_eq!((links(&unit(&smaller)), activities_of_plan(&smaller).count()), (Vec::new(), 0));
        let whole = difference(&smaller, &running).unwrap().plan;
        assert!(whole.groups.len() > running.groups.len() && whole.wires.len() > running.wires.len());
        let root = unit(&whole);
        let left = root.units.iter().find(|unit| unit.name == "left").expect("it is back");
        let all = [links(&root), links(left)].concat();
        assert!(all.len() == 5 && all.iter().all(|link| link.matches(',').count() == 0), "{all:?}");
        let activities: Vec<_> = activities_of_plan(&whole).collect();
        let &[(number, "main/patrol")] = activities.as_slice() else { panic!("{activities:?}") };
        assert!(whole.live_groups().contains(&u32::try_from(number).unwrap()));
        assert!(graph_of_activity(&whole, number).is_ok_and(|graph| graph.is_some()));
    }

    #[test]
    fn a_plan_of_a_stranger_that_is_not_sound_has_no_picture() {
        let check = |damage: fn(&mut Plan)| {
            let mut plan = plan(SPEC);
            damage(&mut plan);
            graph_of_plan(&plan).expect_err("it is not sound")
        };
        let circle = check(|plan| plan.groups[0].members[0].kind = MemberKind::Group(0));
        assert!(matches!(circle, NoPicture::Unsound(PlanError::Membership { .. })), "{circle}");
        let astray = check(|plan| plan.wires[0].from.leaf = 99);
        assert!(matches!(astray, NoPicture::Unsound(PlanError::Index { .. })), "{astray}");
        let empty = check(|plan| (plan.groups, plan.leaves, plan.wires) = (Vec::new(), Vec::new(), Vec::new()));
        assert_eq!(empty, NoPicture::Unsound(PlanError::Empty));
    }
}
