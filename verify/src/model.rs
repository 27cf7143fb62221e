//! A plan as parts: its groups, and pieces of large groups, each with the events at its boundary.
//!
//! A supervisor only sees that a member starts, is done, aborts or has stopped. So a group can be explored with its members as
//! black boxes that do these things at any time, regardless of their content. The cost is then the sum over groups, not the
//! product. The same holds for the operands of a `,` that share nothing with the rest of their group. If there are many, they
//! become separate parts, by the law `P, Q, R = (P, Q), R` of tasks.

use crate::story::inside::Way;
use crate::values::{Values, readers};
use language::algebra::{Program, Value};
use language::automaton::Scripts;
use language::plan::{Expression, Given, Group, Member, MemberKind, Notice, Plan};
use language::sites::{Property, Sites};
use std::time::Duration;

/// A group with at most this many configurations, estimated from its operators, is not divided.
const WHOLE_MAX: u64 = 20_000;
/// A group with more members than this is not divided either: each piece has a place for each of them.
const MEMBERS_MAX: usize = 2000;
/// The most operands of one `,` that stay together.
const BESIDE_MAX: usize = 3;

/// A spec, ready to be verified.
#[derive(Debug)]
pub struct Model<'a> {
    /// The plan.
    pub plan: &'a Plan,
    /// The places in the text.
    pub sites: &'a Sites,
    /// The parts. The groups of the plan come first, under their own numbers.
    pub(crate) parts: Vec<Part>,
    /// For each group except `main`, the group around it and its slot there.
    pub(crate) around: Vec<Option<(u32, u32)>>,
    /// The values that the expressions and sentences distinguish.
    pub(crate) values: Values,
}

/// A group, or a piece of one.
#[derive(Debug)]
pub(crate) struct Part {
    /// The group of the plan.
    pub(crate) group: u32,
    pub(crate) program: Program,
    pub(crate) expression: Expression,
    /// For each node, its number in the complete expression of the group.
    pub(crate) nodes: Vec<u32>,
    pub(crate) members: Vec<Seat>,
    /// Whether the part is a piece of a group. A piece reacts together with the part around it.
    pub(crate) is_piece: bool,
    /// The possible ends: first with failures of programs, then without failures. Known after `ends`.
    pub(crate) ends: [Ends; 2],
    /// Whether the exploration is complete: no limit has ended it, here or in an inner part.
    pub(crate) is_whole: bool,
    /// Whether the part can end, and can also reach a state from which it never ends; known after `ends`. Such a part is not used
    /// as a black box.
    pub(crate) may_hang: bool,
    /// Whether the part is or contains an activity, and can end in the reaction that starts it; known after `ends`.
    pub(crate) ends_at_once: bool,
    /// Whether the part looks at the outcome with which it is started.
    pub(crate) reads_start: bool,
    /// A way to each of the `ends`, if the part is or contains an activity.
    pub(crate) ways: [Vec<Way>; 2],
}

/// The content of a member slot of a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Seat {
    Leaf(u32),
    /// A group or a piece: a part.
    Part(usize),
}

/// How something can end by itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Ends {
    /// The possible values for the next process: the empty one, or one for each tag.
    pub(crate) done: Vec<Value>,
    /// The reports with which it may fail: one for each reason that an expression distinguishes, and an empty one for all others.
    pub(crate) aborted: Vec<Value>,
}

impl<'a> Model<'a> {
    /// Divides a plan into parts.
    pub fn new(plan: &'a Plan, sites: &'a Sites) -> Self {
        Self::with(plan, sites, WHOLE_MAX)
    }

    /// Keeps each group whole, even a large group.
    pub(crate) fn of_groups(plan: &'a Plan, sites: &'a Sites) -> Self {
        Self::with(plan, sites, u64::MAX)
    }

    /// Divides the groups that have more than `whole` configurations.
    pub(crate) fn with(plan: &'a Plan, sites: &'a Sites, whole: u64) -> Self {
        let around = vec![None; plan.groups.len()];
        let mut model = Self { plan, sites, parts: Vec::new(), around, values: Values::default() };
        for (index, group) in (0..).zip(&plan.groups) {
            for (slot, member) in (0..).zip(&group.members) {
                if let MemberKind::Group(inner) = member.kind {
                    model.around[inner as usize] = Some((index, slot));
                }
            }
        }
        let mut pieces = Vec::new();
        for group in 0..plan.groups.len() {
            let part = Outline::of(&model, group, whole, &mut pieces);
            model.parts.push(part);
        }
        model.parts.append(&mut pieces);
        for (part, reads_start) in readers(&model.parts).into_iter().enumerate() {
            model.parts[part].reads_start = reads_start;
        }
        model.values = Values::of(&model);
        model
    }

    /// Returns whether any expression or sentence distinguishes tags; otherwise all values are equivalent.
    pub(crate) fn has_tags(&self) -> bool {
        let looks = |property: &Property| property.sentence.events().iter().any(|event| event.kind.outcome().is_some());
        self.plan.groups.iter().any(|group| names_tags(&group.expression)) || self.sites.properties.iter().any(looks)
    }

    /// Returns whether a part of a group runs a member of the group, directly or in a piece.
    pub(crate) fn holds(&self, part: usize, slot: u32) -> bool {
        self.held(part).iter().any(|(_, held)| *held == slot)
    }

    /// Returns the members of its group that a part runs, directly or in pieces, each with its part and node.
    pub(crate) fn held(&self, part: usize) -> Vec<((usize, usize), u32)> {
        let runs = run_nodes(&self.parts[part].expression);
        runs.into_iter().flat_map(|(node, member)| self.held_at((part, node), member)).collect()
    }

    /// Returns the members that a node of a part runs: one member, or all members of a piece.
    pub(crate) fn held_at(&self, at: (usize, usize), member: u32) -> Vec<((usize, usize), u32)> {
        match self.parts[at.0].members.get(member as usize) {
            Some(Seat::Part(piece)) if self.parts[*piece].is_piece => self.held(*piece),
            Some(Seat::Part(_) | Seat::Leaf(_)) | None => vec![(at, member)],
        }
    }

    /// Returns the name of a process for people: its path without `main/`.
    pub(crate) fn name(&self, group: u32, slot: u32) -> String {
        let group = &self.plan.groups[group as usize];
        let path = format!("{}/{}", group.path, group.members[slot as usize].name);
        short(&path)
    }

    /// The name of a group for a reader.
    pub(crate) fn group_name(&self, group: u32) -> String {
        short(&self.plan.groups[group as usize].path)
    }

    /// The leaves at and below a member.
    pub(crate) fn leaves_below(&self, group: u32, slot: u32) -> Vec<u32> {
        match self.plan.groups[group as usize].members[slot as usize].kind {
            MemberKind::Leaf(leaf) => vec![leaf],
            MemberKind::Group(inner) => self.leaves_of_group(inner),
        }
    }

    /// Returns the leaves that a slot of a part runs; the slot may contain a piece of the group.
    pub(crate) fn leaves_in(&self, part: usize, slot: u32) -> Vec<u32> {
        match self.parts[part].members.get(slot as usize) {
            Some(Seat::Leaf(leaf)) => vec![*leaf],
            Some(Seat::Part(inner)) if self.parts[*inner].is_piece => {
                let group = self.parts[*inner].group;
                self.held(*inner).into_iter().flat_map(|(_, member)| self.leaves_below(group, member)).collect()
            }
            Some(Seat::Part(inner)) => self.leaves_of_group(self.parts[*inner].group),
            None => Vec::new(),
        }
    }

    /// Returns the leaves of a group and of all groups in it.
    pub(crate) fn leaves_of_group(&self, group: u32) -> Vec<u32> {
        let slots = 0..u32::try_from(self.plan.groups[group as usize].members.len()).unwrap_or(0);
        slots.flat_map(|slot| self.leaves_below(group, slot)).collect()
    }
}

/// Returns a path without `main/` in front.
pub(crate) fn short(path: &str) -> String {
    path.strip_prefix("main/").unwrap_or(path).to_owned()
}

fn names_tags(expression: &Expression) -> bool {
    let is_one = matches!(
        expression,
        Expression::Match(_) | Expression::Chart(_) | Expression::Repeat { .. } | Expression::Catch { .. }
    );
    is_one || expression.operands().into_iter().any(names_tags)
}

/// Divides the expression of one group.
struct Outline<'m> {
    group: usize,
    source: &'m Group,
    /// All finished pieces.
    parts: &'m mut Vec<Part>,
    /// The number of the first piece; the groups have the smaller numbers.
    first_piece: usize,
}

impl Outline<'_> {
    fn of(model: &Model<'_>, group: usize, whole: u64, pieces: &mut Vec<Part>) -> Part {
        let source = &model.plan.groups[group];
        let first_piece = model.plan.groups.len();
        let mut outline = Outline { group, source, parts: pieces, first_piece };
        let mut part = Draft { members: seats(source), names: source.members.clone(), nodes: Vec::new() };
        let expression = if configurations(&source.expression) > whole && source.members.len() <= MEMBERS_MAX {
            outline.write(&source.expression, &mut 0, &mut part)
        } else {
            part.nodes = (0..count(&source.expression)).collect();
            source.expression.clone()
        };
        outline.finish(expression, part, false)
    }

    fn finish(&self, expression: Expression, draft: Draft, is_piece: bool) -> Part {
        let group = Group { members: draft.names, expression: expression.clone(), ..self.source.clone() };
        let program = Program::compile(&group).with_scripts(Scripts::Assumed);
        let (nodes, members) = (draft.nodes, draft.members);
        let group = u32::try_from(self.group).unwrap_or(u32::MAX);
        Part {
            group,
            program,
            expression,
            nodes,
            members,
            is_piece,
            ends: [Ends::default(), Ends::default()],
            is_whole: false,
            may_hang: false,
            ends_at_once: false,
            reads_start: false,
            ways: [Vec::new(), Vec::new()],
        }
    }

    /// Copies an expression; `number` is the number of its first node in the complete expression of the group.
    fn write(&mut self, expression: &Expression, number: &mut u32, draft: &mut Draft) -> Expression {
        let own = *number;
        draft.nodes.push(own);
        *number += 1;
        let Expression::Concurrent(operands) = expression else {
            return with_operands(expression, |operand| self.write(operand, number, draft));
        };
        let starts: Vec<u32> = operands
            .iter()
            .map(|operand| {
                let start = *number;
                *number += count(operand);
                start
            })
            .collect();
        let is_small = self.names_members()
            || operands.iter().all(|operand| runs(operand).len() < 2) && operands.len() <= BESIDE_MAX;
        let mut kept = Vec::new();
        let mut pieces: Vec<(&Expression, u32)> = Vec::new();
        for (operand, &start) in operands.iter().zip(&starts) {
            let is_task = !self.is_service(operand);
            let is_apart = !may_end_at_once(operand) && self.is_alone(operand) && results(operand).is_empty();
            if !is_small && is_task && is_apart {
                pieces.push((operand, start));
            } else {
                kept.push((operand, start));
            }
        }
        let mut operands = Vec::new();
        for (operand, start) in kept {
            operands.push((start, self.write(operand, &mut { start }, draft)));
        }
        for chunk in halves(&pieces, BESIDE_MAX.saturating_sub(operands.len()).max(2)) {
            let start = chunk[0].1;
            let member = self.piece(chunk, own, draft);
            draft.nodes.push(start);
            operands.push((start, Expression::Run { member, sets: Vec::new() }));
        }
        Expression::Concurrent(operands.into_iter().map(|(_, operand)| operand).collect())
    }

    /// Makes a piece from some operands of a `,`; returns its slot in the part around it.
    fn piece(&mut self, operands: &[(&Expression, u32)], own: u32, around: &mut Draft) -> u32 {
        let mut draft = Draft { members: seats(self.source), names: self.source.members.clone(), nodes: Vec::new() };
        let expression = match operands {
            [(operand, start)] => self.write(operand, &mut { *start }, &mut draft),
            _ => {
                draft.nodes.push(own);
                let mut written = Vec::new();
                for half in halves(operands, 2) {
                    match half {
                        [(operand, start)] if runs(operand).len() < 2 => {
                            written.push(self.write(operand, &mut { *start }, &mut draft));
                        }
                        _ => {
                            draft.nodes.push(half[0].1);
                            let member = self.piece(half, own, &mut draft);
                            written.push(Expression::Run { member, sets: Vec::new() });
                        }
                    }
                }
                Expression::Concurrent(written)
            }
        };
        let part = self.finish(expression, draft, true);
        self.parts.push(part);
        let index = self.first_piece + self.parts.len() - 1;
        around.members.push(Seat::Part(index));
        around.names.push(Member { name: String::new(), kind: MemberKind::Group(0), service: false });
        u32::try_from(around.members.len() - 1).unwrap_or(u32::MAX)
    }

    /// Returns whether this is an activity that waits for the ends of members.
    fn names_members(&self) -> bool {
        let Expression::Chart(chart) = &self.source.expression else { return false };
        chart.notices.iter().any(|notice| matches!(notice, Notice::Done(_) | Notice::Aborted(_)))
    }

    /// Returns whether an operand shares no member and no resource with the rest of its group.
    fn is_alone(&self, operand: &Expression) -> bool {
        let (own, all) = (runs(operand), runs(&self.source.expression));
        let is_shared = |member: &u32| count_of(&all, *member) != count_of(&own, *member);
        let (taken, everywhere) = (resources(operand), resources(&self.source.expression));
        let is_taken_elsewhere = |name: &&str| count_of(&everywhere, *name) != count_of(&taken, *name);
        !own.iter().any(is_shared) && !taken.iter().any(is_taken_elsewhere)
    }

    fn is_service(&self, operand: &Expression) -> bool {
        let group = Group { expression: operand.clone(), ..self.source.clone() };
        Program::compile(&group).is_service()
    }
}

/// A part that is being written.
struct Draft {
    members: Vec<Seat>,
    names: Vec<Member>,
    nodes: Vec<u32>,
}

fn seats(group: &Group) -> Vec<Seat> {
    let seat = |member: &Member| match member.kind {
        MemberKind::Leaf(leaf) => Seat::Leaf(leaf),
        MemberKind::Group(group) => Seat::Part(group as usize),
    };
    group.members.iter().map(seat).collect()
}

/// Splits items into at most `count` runs of nearly equal length.
fn halves<T>(items: &[T], count: usize) -> impl Iterator<Item = &[T]> {
    let length = items.len().div_ceil(count.max(1)).max(1);
    items.chunks(length)
}

fn count_of<T: PartialEq>(items: &[T], one: T) -> usize {
    items.iter().filter(|item| **item == one).count()
}

/// Returns the number of nodes of an expression.
pub(crate) fn count(expression: &Expression) -> u32 {
    expression.operands().into_iter().map(count).fold(1, u32::saturating_add)
}

/// Returns the approximate number of configurations of an active expression. The numbers of
/// operands in sequence are added, and the numbers of parallel operands are multiplied.
fn configurations(expression: &Expression) -> u64 {
    let parts = || expression.operands().into_iter().map(configurations);
    match expression {
        Expression::Run { .. } => 2,
        Expression::Skip | Expression::Never | Expression::Fail(_) | Expression::Wait(_) => 1,
        Expression::Sequence(..)
        | Expression::Conditional(..)
        | Expression::Recurrent(..)
        | Expression::Otherwise(..)
        | Expression::Match(_)
        | Expression::Using { .. }
        | Expression::Chart(_)
        | Expression::Tagged { .. }
        | Expression::With { .. }
        | Expression::Named { .. }
        | Expression::Repeat { .. }
        | Expression::Catch { .. } => parts().fold(1, u64::saturating_add),
        Expression::Shield { .. } | Expression::Finally(..) => parts().fold(1, u64::saturating_add).saturating_mul(2),
        Expression::Concurrent(_)
        | Expression::FailFast(_)
        | Expression::AnyOf { .. }
        | Expression::AtLeast { .. }
        | Expression::Disable(_)
        | Expression::Asynchronous { .. } => parts().map(|part| part.saturating_add(1)).fold(1, u64::saturating_mul),
    }
}

/// Returns the members that an expression runs, each as often as it occurs.
pub(crate) fn runs(expression: &Expression) -> Vec<u32> {
    expression.members()
}

/// Returns the nodes of an expression that run a member, each with this member.
pub(crate) fn run_nodes(expression: &Expression) -> Vec<(usize, u32)> {
    let (mut runs, mut node) = (Vec::new(), 0);
    walk(expression, &mut |expression| {
        if let Expression::Run { member, .. } = expression {
            runs.push((node, *member));
        }
        node += 1;
    });
    runs
}

/// Returns whether an expression may end at the moment at which it starts. Then the order in which operands begin matters, and no
/// operand becomes a piece.
fn may_end_at_once(expression: &Expression) -> bool {
    match expression {
        Expression::Skip | Expression::Fail(_) | Expression::Chart(_) => true,
        Expression::Run { .. } | Expression::Never | Expression::Wait(_) => false,
        Expression::Sequence(first, _)
        | Expression::Conditional(first, _)
        | Expression::Recurrent(first, _)
        | Expression::Otherwise(first, _)
        | Expression::Finally(first, _) => may_end_at_once(first),
        Expression::Catch { of, .. } => may_end_at_once(of),
        Expression::Concurrent(_)
        | Expression::FailFast(_)
        | Expression::AnyOf { .. }
        | Expression::AtLeast { .. }
        | Expression::Disable(_)
        | Expression::Match(_)
        | Expression::Shield { .. }
        | Expression::Using { .. }
        | Expression::Tagged { .. }
        | Expression::With { .. }
        | Expression::Named { .. }
        | Expression::Repeat { .. }
        | Expression::Asynchronous { .. } => expression.operands().into_iter().any(may_end_at_once),
    }
}

/// The results around an expression with which something in it starts.
fn results(expression: &Expression) -> Vec<&str> {
    let mut used: Vec<&str> = expression.operands().into_iter().flat_map(results).collect();
    if let Expression::With { given: Given::Result(name), .. } = expression {
        used.push(name);
    } else if let Expression::Named { name, .. } = expression {
        used.retain(|other| other != name);
    }
    used
}

fn resources(expression: &Expression) -> Vec<&str> {
    let own: Vec<&str> = if let Expression::Using { resources, .. } = expression {
        resources.iter().map(String::as_str).collect()
    } else {
        Vec::new()
    };
    own.into_iter().chain(expression.operands().into_iter().flat_map(resources)).collect()
}

/// Visits all parts of an expression, an operator before its operands.
pub(crate) fn walk(expression: &Expression, visit: &mut impl FnMut(&Expression)) {
    visit(expression);
    for operand in expression.operands() {
        walk(operand, visit);
    }
}

/// Returns the times of the timers of an expression, in textual order.
pub(crate) fn times_of(expression: &Expression) -> Vec<Duration> {
    let mut times = Vec::new();
    if let Expression::Chart(chart) = expression {
        times.extend(chart.chart.transitions.iter().filter_map(|transition| transition.trigger.time()));
    }
    walk(expression, &mut |expression| {
        if let Expression::Wait(time) | Expression::Shield { bound: Some(time), .. } = expression {
            times.push(*time);
        }
    });
    times
}

/// Returns the same operator with other operands.
fn with_operands(expression: &Expression, mut write: impl FnMut(&Expression) -> Expression) -> Expression {
    let mut copy = expression.clone();
    match &mut copy {
        Expression::Run { .. } | Expression::Skip | Expression::Never | Expression::Fail(_) | Expression::Wait(_) => {}
        Expression::Concurrent(of)
        | Expression::FailFast(of)
        | Expression::Disable(of)
        | Expression::AnyOf { of, .. }
        | Expression::AtLeast { of, .. } => of.iter_mut().for_each(|operand| *operand = write(operand)),
        Expression::Sequence(p, q)
        | Expression::Conditional(p, q)
        | Expression::Recurrent(p, q)
        | Expression::Otherwise(p, q)
        | Expression::Finally(p, q) => {
            **p = write(p);
            **q = write(q);
        }
        Expression::Match(arms) => arms.iter_mut().for_each(|arm| arm.body = write(&arm.body)),
        Expression::Catch { of, arms } => {
            **of = write(of);
            arms.iter_mut().for_each(|arm| arm.body = write(&arm.body));
        }
        Expression::Shield { of, .. }
        | Expression::Using { of, .. }
        | Expression::Tagged { of, .. }
        | Expression::With { of, .. }
        | Expression::Named { of, .. }
        | Expression::Repeat { of, .. } => {
            **of = write(of);
        }
        Expression::Asynchronous { source, pool } => {
            **source = write(source);
            pool.iter_mut().for_each(|operand| *operand = write(operand));
        }
        Expression::Chart(chart) => chart.runs.iter_mut().for_each(|run| run.expression = write(&run.expression)),
    }
    copy
}
