//! Checks senders, receivers and times of data: two writers of one input, and processes that never get their inputs.
//!
//! A wire carries data while its connection set is open and its sender runs. A set is open while the node that names it runs; a set
//! that no node names is open while its group runs.

use crate::explore::{Graph, Limits, Nobody, explore};
use crate::finding::{Finding, diagnostic, help, reason};
use crate::model::Model;
use crate::property::place_of;
use crate::story::story;
use crate::system::{Frame, Mode, System};
use language::Code;
use language::algebra::Activity;
use language::plan::{Expression, Retention, Transfer};
use std::collections::{BTreeMap, BTreeSet};

/// A wire, with its declaration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    pub(crate) wire: u32,
    pub(crate) group: u32,
    pub(crate) set: u32,
    /// The members of that group at the two ends of the wire, or groups that contain the ends.
    from: u32,
    to: u32,
}

/// Looks at every wire of every group.
pub(crate) fn check(model: &Model<'_>, limits: &Limits<'_>) -> Vec<Finding> {
    let lines = lines(model);
    let mut findings = Vec::new();
    let mut inputs: BTreeMap<(u32, &str), Vec<Line>> = BTreeMap::new();
    for line in &lines {
        let to = &model.plan.wires[line.wire as usize].to;
        if model.plan.has_many_senders(to) {
            continue;
        }
        inputs.entry((to.leaf, &to.port)).or_default().push(*line);
    }
    let mut is_open = false;
    for (group, _) in (0_u32..).zip(&model.plan.groups) {
        let is_bare =
            |leaf: u32| is_of(model, leaf, group) && needs(model, leaf).any(|port| !inputs.contains_key(&(leaf, port)));
        let leaves = 0..u32::try_from(model.plan.leaves.len()).unwrap_or(u32::MAX);
        if !lines.iter().any(|line| line.group == group) && !leaves.clone().any(is_bare) {
            continue;
        }
        let Some(watch) = Watch::new(model, &[group], limits) else {
            is_open = true;
            continue;
        };
        findings.extend(watch.two_writers(&inputs));
        findings.extend(watch.blind(&inputs));
    }
    for groups in writing_groups(&inputs) {
        match Watch::new(model, &groups, limits) {
            Some(watch) => findings.extend(watch.two_writers(&inputs)),
            None => is_open = true,
        }
    }
    let is_wrong =
        |code| findings.iter().any(|found: &Finding| found.diagnostic.as_ref().is_some_and(|it| it.code == code));
    let (two, blind) = (is_wrong(Code::E0814), is_wrong(Code::E0816));
    if is_open {
        findings.push(Finding::open(
            "which processes send to each other at the same time: a group was not examined completely",
        ));
        return findings;
    }
    if !two {
        let sentence =
            "every device has one owner at a time, and no two connections send to one input at the same time";
        findings.push(Finding::proved(sentence));
    }
    if !blind && !lines.is_empty() {
        findings.push(Finding::proved("every process that can end gets what it needs while it runs"));
    }
    findings
}

/// Returns the inputs that a program needs and that other programs have to send, for programs that can end. Left out are inputs
/// from keys of the database, and inputs of a process that runs in another deployment.
fn needs<'m>(model: &'m Model<'_>, leaf: u32) -> impl Iterator<Item = &'m str> {
    let is_service = place_of(model, leaf)
        .is_some_and(|(group, slot)| model.plan.groups[group as usize].members[slot as usize].service);
    let of_plan = model.plan.leaves.get(leaf as usize).filter(|leaf| !is_service && leaf.external.is_none());
    let inputs = of_plan.and_then(|of_plan| Some((of_plan, model.sites.leaves.get(leaf as usize)?)));
    inputs.into_iter().flat_map(|(of_plan, facts)| {
        let is_of_keys = |port: &str| of_plan.keys.iter().any(|binding| !binding.is_write && binding.port == port);
        facts.inputs.iter().map(String::as_str).filter(move |port| !is_of_keys(port))
    })
}

fn is_of(model: &Model<'_>, leaf: u32, group: u32) -> bool {
    place_of(model, leaf).is_some_and(|(of, _)| of == group)
}

/// Returns each pair of groups with connections to the same input.
fn writing_groups(inputs: &BTreeMap<(u32, &str), Vec<Line>>) -> BTreeSet<[u32; 2]> {
    let mut pairs = BTreeSet::new();
    for lines in inputs.values() {
        let groups: BTreeSet<u32> = lines.iter().map(|line| line.group).collect();
        for &one in &groups {
            pairs.extend(groups.range(one + 1..).map(|&other| [one, other]));
        }
    }
    pairs
}

/// Returns every wire with its connection set.
pub(crate) fn lines(model: &Model<'_>) -> Vec<Line> {
    let mut lines = Vec::new();
    for (group, source) in (0_u32..).zip(&model.plan.groups) {
        for (set, source) in (0_u32..).zip(&source.sets) {
            for &wire in &source.wires {
                let ends = &model.plan.wires[wire as usize];
                // Any number of processes may make a call, and a call sends no data. Any number may send to an activity, which
                // takes each message.
                if ends.transfer == Transfer::Call || model.plan.has_ports(ends.to.leaf) {
                    continue;
                }
                let member = |leaf| holder(model, group, leaf);
                if let (Some(from), Some(to)) = (member(ends.from.leaf), member(ends.to.leaf)) {
                    lines.push(Line { wire, group, set, from, to });
                }
            }
        }
    }
    lines
}

/// Returns the member of a group that is or contains a leaf.
fn holder(model: &Model<'_>, group: u32, leaf: u32) -> Option<u32> {
    let path = &model.plan.leaves[leaf as usize].path;
    let own = format!("{}/", model.plan.groups[group as usize].path);
    let name = path.strip_prefix(&own)?.split('/').next()?;
    let members = model.plan.groups[group as usize].members.iter();
    (0_u32..).zip(members).find(|(_, member)| member.name == name).map(|(slot, _)| slot)
}

/// A group with its wires, or two groups with wires to the same inputs, explored completely.
struct Watch<'w, 'a> {
    model: &'w Model<'a>,
    groups: Vec<u32>,
    system: System<'w>,
    graph: Graph,
    /// For each unit and node, the named connection sets.
    named: Vec<(usize, usize, Vec<u32>)>,
}

impl<'w, 'a> Watch<'w, 'a> {
    fn new(model: &'w Model<'a>, groups: &[u32], limits: &Limits<'_>) -> Option<Self> {
        let outwards = |group: u32| {
            let around = |group: &u32| model.around[*group as usize].map(|(outer, _)| outer);
            std::iter::successors(Some(group), around).collect::<Vec<u32>>()
        };
        let root =
            outwards(groups[0]).into_iter().find(|outer| groups.iter().all(|own| outwards(*own).contains(outer)))?;
        // The groups on the paths from the innermost group that contains all of these groups down to each of them, with all their pieces.
        let open: BTreeSet<u32> =
            groups.iter().flat_map(|own| outwards(*own).into_iter().take_while(|outer| *outer != root)).collect();
        let is_open = |part: usize| model.parts[part].group == root || open.contains(&model.parts[part].group);
        let mut system = System::new(model, root as usize, &is_open);
        system.mode = Mode { aborts: true, stops: true, ..Mode::default() };
        let graph = explore(&system, limits, false, &Nobody).graph;
        if graph.reached.is_some() {
            return None;
        }
        let mut named = Vec::new();
        for (unit, source) in system.units.iter().enumerate() {
            let mut node = 0;
            crate::model::walk(&model.parts[source.part].expression, &mut |expression| {
                if let Expression::Run { sets, .. } = expression
                    && !sets.is_empty()
                {
                    named.push((unit, node, sets.clone()));
                }
                node += 1;
            });
        }
        Some(Self { model, groups: groups.to_vec(), system, graph, named })
    }

    /// Returns whether a unit belongs to a group.
    fn is_of(&self, unit: usize, group: u32) -> bool {
        self.model.parts[self.system.units[unit].part].group == group
    }

    fn is_set_open(&self, frame: &Frame, line: Line) -> bool {
        if frame.phase.is_over() {
            return false;
        }
        let source = &self.model.plan.groups[line.group as usize];
        let is_on = |unit: usize| self.is_of(unit, line.group) && frame.states[unit].is_node_active(0);
        let is_named = |(unit, node, sets): &(usize, usize, Vec<u32>)| {
            self.is_of(*unit, line.group) && sets.contains(&line.set) && frame.states[*unit].is_node_active(*node)
        };
        source.sets_always.contains(&line.set) && (0..self.system.units.len()).any(is_on)
            || self.named.iter().any(is_named)
    }

    /// Whether a member of a group runs.
    fn runs(&self, frame: &Frame, group: u32, member: u32) -> bool {
        let is_own = |unit: usize| {
            let part = &self.model.parts[self.system.units[unit].part];
            part.group == group
                && part.members.len() > member as usize
                && frame.states[unit].activity(member) != Activity::Idle
        };
        (0..self.system.units.len()).any(is_own)
    }

    fn is_live(&self, frame: &Frame, line: Line) -> bool {
        self.is_set_open(frame, line) && self.runs(frame, line.group, line.from)
    }

    /// The name of a member.
    fn name(&self, group: u32, member: u32) -> String {
        self.model.name(group, member)
    }

    /// Finds pairs of wires from different outputs to one input that carry data at the same time: the first for each pair of
    /// connections.
    fn two_writers(&self, inputs: &BTreeMap<(u32, &str), Vec<Line>>) -> Vec<Finding> {
        let (mut findings, mut told) = (Vec::new(), BTreeSet::new());
        for ((leaf, port), lines) in inputs {
            let own: Vec<Line> = lines.iter().filter(|line| self.groups.contains(&line.group)).copied().collect();
            for (index, &one) in own.iter().enumerate() {
                let from = |line: Line| &self.model.plan.wires[line.wire as usize].from;
                let span = |line: Line| self.model.sites.groups[line.group as usize].sets[line.set as usize];
                // Two groups are considered together only for the inputs to which both send.
                let is_other =
                    |other: &&Line| from(**other) != from(one) && (self.groups.len() == 1 || other.group != one.group);
                for &other in own[index + 1..].iter().filter(is_other) {
                    let both = |frame: &Frame| self.is_live(frame, one) && self.is_live(frame, other);
                    if told.contains(&(leaf, port, span(one), span(other))) {
                        continue;
                    }
                    let Some(state) = self.first(both) else { continue };
                    told.insert((leaf, port, span(one), span(other)));
                    let path = crate::model::short(&self.model.plan.leaves[*leaf as usize].path);
                    let message = match (self.name(one.group, one.from), self.name(other.group, other.from)) {
                        (first, second) if first == second => {
                            let (first_port, second_port) = (&from(one).port, &from(other).port);
                            format!(
                                "`{first_port}` and `{second_port}` of `{first}` are sent to `{path}`, `{port}` at the same time"
                            )
                        }
                        (first, second) => {
                            format!("`{first}` and `{second}` send to `{path}`, `{port}` at the same time")
                        }
                    };
                    let mut found = diagnostic(Code::E0814, span(other), message);
                    if span(one) != span(other) {
                        found = reason(found, span(one), "the other connection");
                    }
                    let found = help(found, "run them in turn, or merge their values in a process of its own");
                    findings.push(Finding::fails(found, Some(story(&self.system, &self.graph, state))));
                }
            }
        }
        findings.truncate(10);
        findings
    }

    fn first(&self, has: impl FnMut(&Frame) -> bool) -> Option<u32> {
        self.graph.first(&self.system, has)
    }

    /// Finds processes that can end but need an input for which no wire ever carries data while they run.
    fn blind(&self, inputs: &BTreeMap<(u32, &str), Vec<Line>>) -> Vec<Finding> {
        let (mut findings, group) = (Vec::new(), self.groups[0]);
        for (leaf, source) in (0_u32..).zip(&self.model.plan.leaves) {
            let path = crate::model::short(&source.path);
            for port in needs(self.model, leaf) {
                let sites = &self.model.sites.groups[group as usize];
                let message = format!("`{path}` needs `{port}`, but never gets a value there: it works blind");
                let Some(lines) = inputs.get(&(leaf, port)) else {
                    let Some((_, slot)) = place_of(self.model, leaf).filter(|(of, _)| *of == group) else { continue };
                    let Some(state) = self.first(|frame| self.runs(frame, group, slot)) else { continue };
                    let found = diagnostic(Code::E0816, sites.members[slot as usize], message);
                    let found =
                        help(found, format!("nothing is connected to it: write `sender, Out -> {path}, {port}`"));
                    findings.push(Finding::fails(found, Some(story(&self.system, &self.graph, state))));
                    continue;
                };
                if lines.iter().any(|line| line.group != group) {
                    continue;
                }
                let line = lines[0];
                let Some(state) = self.first(|frame| self.runs(frame, group, line.to)) else { continue };
                if lines.iter().any(|&line| self.ever_meets(line)) {
                    continue;
                }
                let found = diagnostic(Code::E0816, sites.sets[line.set as usize], message);
                let found = reason(found, sites.members[line.to as usize], "needs it");
                let found = help(found, self.advice(line));
                findings.push(Finding::fails(found, Some(story(&self.system, &self.graph, state))));
            }
        }
        findings
    }

    fn ever_meets(&self, line: Line) -> bool {
        let wire = &self.model.plan.wires[line.wire as usize];
        if wire.transfer == Transfer::Pull || wire.quality.retention == Retention::Latch {
            return self.first(|frame| self.is_set_open(frame, line)).is_some();
        }
        self.first(|frame| self.is_live(frame, line) && self.runs(frame, line.group, line.to)).is_some()
    }

    fn advice(&self, line: Line) -> String {
        let set = &self.model.plan.groups[line.group as usize].sets[line.set as usize];
        let name = |member| self.name(line.group, member);
        let is_named = self.named.iter().any(|(_, _, sets)| sets.contains(&line.set));
        match (&set.label, is_named) {
            (Some(label), false) => {
                let owner = set.owner.map(name).unwrap_or_default();
                let owner = owner.rsplit('/').next().unwrap_or_default();
                format!("no event action opens this connection: write `{owner}[{label}]`")
            }
            (_, _) => format!("run `{}` beside `{}`", name(line.from), name(line.to)),
        }
    }
}
