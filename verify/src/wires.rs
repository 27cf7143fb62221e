//! Who sends to whom, and when: two writers of one input, and processes that never get what they need.
//!
//! A wire carries data while its connection set is open and its sender runs. A set is open while the node that names it
//! runs, or while its group does.

use crate::explore::{Graph, Limits, Nobody, explore};
use crate::finding::{Finding, diagnostic, help, reason};
use crate::model::Model;
use crate::story::{member_name, story};
use crate::system::{Frame, Mode, System};
use language::Code;
use language::algebra::Activity;
use language::plan::{Expression, Retention, Transfer};
use std::collections::BTreeMap;

/// A wire where it is declared.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    pub(crate) wire: u32,
    pub(crate) group: u32,
    pub(crate) set: u32,
    /// The members of that group at or around its two ends.
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
        inputs.entry((to.leaf, &to.port)).or_default().push(*line);
    }
    let mut is_open = false;
    for (group, _) in (0_u32..).zip(&model.plan.groups) {
        let Some(watch) = Watch::new(model, group, &lines, limits) else {
            is_open |= lines.iter().any(|line| line.group == group);
            continue;
        };
        findings.extend(watch.two_writers(&inputs));
        findings.extend(watch.blind(&inputs));
    }
    let is_wrong =
        |code| findings.iter().any(|found: &Finding| found.diagnostic.as_ref().is_some_and(|it| it.code == code));
    let (two, blind) = (is_wrong(Code::E0814), is_wrong(Code::E0816));
    if is_open {
        findings.push(Finding::open("who sends to whom at the same time: a group was not looked at whole"));
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

/// Every wire with the set that it is in.
pub(crate) fn lines(model: &Model<'_>) -> Vec<Line> {
    let mut lines = Vec::new();
    for (group, source) in (0_u32..).zip(&model.plan.groups) {
        for (set, source) in (0_u32..).zip(&source.sets) {
            for &wire in &source.wires {
                let ends = &model.plan.wires[wire as usize];
                let member = |leaf| holder(model, group, leaf);
                if let (Some(from), Some(to)) = (member(ends.from.leaf), member(ends.to.leaf)) {
                    lines.push(Line { wire, group, set, from, to });
                }
            }
        }
    }
    lines
}

/// The member of a group that is or holds a leaf.
fn holder(model: &Model<'_>, group: u32, leaf: u32) -> Option<u32> {
    let path = &model.plan.leaves[leaf as usize].path;
    let own = format!("{}/", model.plan.groups[group as usize].path);
    let name = path.strip_prefix(&own)?.split('/').next()?;
    let members = model.plan.groups[group as usize].members.iter();
    (0_u32..).zip(members).find(|(_, member)| member.name == name).map(|(slot, _)| slot)
}

/// A group with its wires, explored whole.
struct Watch<'w, 'a> {
    model: &'w Model<'a>,
    group: u32,
    system: System<'w>,
    graph: Graph,
    /// For each unit and node, the sets that it names.
    named: Vec<(usize, usize, Vec<u32>)>,
}

impl<'w, 'a> Watch<'w, 'a> {
    fn new(model: &'w Model<'a>, group: u32, lines: &[Line], limits: &Limits<'_>) -> Option<Self> {
        let lines: Vec<Line> = lines.iter().filter(|line| line.group == group).copied().collect();
        let is_piece = |part: usize| model.parts[part].is_piece && model.parts[part].group == group;
        let mut system = System::new(model, group as usize, &|part| !lines.is_empty() && is_piece(part));
        system.mode = Mode { aborts: true, ..Mode::default() };
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
        Some(Self { model, group, system, graph, named })
    }

    fn is_set_open(&self, frame: &Frame, set: u32) -> bool {
        if frame.phase.is_over() {
            return false;
        }
        let source = &self.model.plan.groups[self.group as usize];
        source.sets_always.contains(&set)
            || self
                .named
                .iter()
                .any(|(unit, node, sets)| sets.contains(&set) && frame.states[*unit].is_node_active(*node))
    }

    fn runs(&self, frame: &Frame, member: u32) -> bool {
        let is_own = |unit: usize| {
            let part = &self.model.parts[self.system.units[unit].part];
            frame.states[unit].activity(member) != Activity::Idle && (part.members.len() > member as usize)
        };
        (0..self.system.units.len()).any(is_own)
    }

    fn is_live(&self, frame: &Frame, line: Line) -> bool {
        self.is_set_open(frame, line.set) && self.runs(frame, line.from)
    }

    /// Pairs of wires from different sources to one input that carry data at the same time.
    fn two_writers(&self, inputs: &BTreeMap<(u32, &str), Vec<Line>>) -> Vec<Finding> {
        let mut findings = Vec::new();
        for ((leaf, port), lines) in inputs {
            let own: Vec<Line> = lines.iter().filter(|line| line.group == self.group).copied().collect();
            for (index, &one) in own.iter().enumerate() {
                let wire = |line: Line| &self.model.plan.wires[line.wire as usize].from;
                let sites = &self.model.sites.groups[self.group as usize];
                // Connections of an array are written once, for all of its instances: that is meant.
                let is_other = |other: &&Line| {
                    wire(**other) != wire(one) && sites.sets[other.set as usize] != sites.sets[one.set as usize]
                };
                let others = own[index + 1..].iter().filter(is_other);
                for &other in others {
                    let both = |frame: &Frame| self.is_live(frame, one) && self.is_live(frame, other);
                    let Some(state) = self.first(both) else { continue };
                    let path = crate::model::short(&self.model.plan.leaves[*leaf as usize].path);
                    let name = |member| member_name(&self.system, 0, member).unwrap_or_default();
                    let (first, second) = (name(one.from), name(other.from));
                    let message = format!("`{first}` and `{second}` send to `{path}`, `{port}` at the same time");
                    let found = diagnostic(Code::E0814, sites.sets[other.set as usize], message);
                    let found = reason(found, sites.sets[one.set as usize], "the other connection");
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

    /// Processes that can end, and need an input of which no wire ever carries data while they run.
    fn blind(&self, inputs: &BTreeMap<(u32, &str), Vec<Line>>) -> Vec<Finding> {
        let mut findings = Vec::new();
        for (leaf, facts) in (0_u32..).zip(&self.model.sites.leaves) {
            let path = &self.model.plan.leaves[leaf as usize].path;
            for port in &facts.inputs {
                let Some(lines) = inputs.get(&(leaf, port.as_str())) else { continue };
                let is_own = |line: &&Line| line.group == self.group;
                if !lines.iter().all(|line| is_own(&line)) || self.is_service(leaf) {
                    continue;
                }
                let Some(state) = self.first(|frame| self.runs(frame, lines[0].to)) else { continue };
                if lines.iter().any(|&line| self.ever_meets(line)) {
                    continue;
                }
                let line = lines[0];
                let sites = &self.model.sites.groups[self.group as usize];
                let path = crate::model::short(path);
                let message = format!("`{path}` needs `{port}` and never gets it: it works blind");
                let found = diagnostic(Code::E0816, sites.sets[line.set as usize], message);
                let found = reason(found, sites.members[line.to as usize], "needs it");
                let found = help(found, self.advice(line));
                findings.push(Finding::fails(found, Some(story(&self.system, &self.graph, state))));
            }
        }
        findings
    }

    fn is_service(&self, leaf: u32) -> bool {
        let seats = self.model.plan.groups.iter().flat_map(|group| &group.members);
        seats.into_iter().any(|member| member.kind == language::plan::MemberKind::Leaf(leaf) && member.service)
    }

    fn ever_meets(&self, line: Line) -> bool {
        let wire = &self.model.plan.wires[line.wire as usize];
        if wire.transfer == Transfer::Pull || wire.quality.retention == Retention::Latch {
            return self.first(|frame| self.is_set_open(frame, line.set)).is_some();
        }
        self.first(|frame| self.is_live(frame, line) && self.runs(frame, line.to)).is_some()
    }

    fn advice(&self, line: Line) -> String {
        let set = &self.model.plan.groups[self.group as usize].sets[line.set as usize];
        let name = |member| member_name(&self.system, 0, member).unwrap_or_default();
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
