//! How long things take, as far as limits, pauses and declared durations say it.

mod turn;

use crate::model::Model;
use crate::system::{is_never_done, is_restarted};
use language::plan::{Expression, Group, MemberKind};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long an expression takes: from its start to its normal end at the least, to any end at the most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Span {
    /// The least time until it is done; none if it is never done.
    pub(crate) done: Option<Duration>,
    /// The most time until it has ended; none if nothing bounds it.
    pub(crate) end: Option<Duration>,
    /// The most time that a stop of it takes; none if nothing bounds it.
    pub(crate) stop: Option<Duration>,
}

const NOW: Span = Span { done: Some(Duration::ZERO), end: Some(Duration::ZERO), stop: Some(Duration::ZERO) };

/// The durations that are known, and those that were asked for and are not.
pub(crate) struct Times<'m, 'a> {
    pub(crate) model: &'m Model<'a>,
    /// For a member of a group, what the spec assumes.
    pub(crate) assumed: BTreeMap<(u32, u32), (Duration, Duration)>,
    /// Programs that never end by themselves, whatever the spec says of them.
    pub(crate) endless: BTreeSet<u32>,
    /// Those of them that hang, so that they are never done.
    pub(crate) hung: BTreeSet<u32>,
    /// The `using` whose turn is being worked out, so that none asks for itself.
    pub(crate) turns: RefCell<Vec<usize>>,
}

impl<'m, 'a> Times<'m, 'a> {
    /// What is known when nothing hangs.
    pub(crate) fn new(model: &'m Model<'a>, assumed: BTreeMap<(u32, u32), (Duration, Duration)>) -> Self {
        Self { model, assumed, endless: BTreeSet::new(), hung: BTreeSet::new(), turns: RefCell::default() }
    }
}

impl Times<'_, '_> {
    /// How long a group takes.
    pub(crate) fn of_group(&self, group: u32) -> Span {
        let source = &self.model.plan.groups[group as usize];
        self.of(group, source, &source.expression)
    }

    /// How long a member takes.
    pub(crate) fn of_member(&self, group: u32, slot: u32) -> Span {
        let member = &self.model.plan.groups[group as usize].members[slot as usize];
        let mut span = match member.kind {
            MemberKind::Group(inner) => self.of_group(inner),
            MemberKind::Leaf(leaf) => {
                let stop = Some(self.model.plan.leaves[leaf as usize].stop_within);
                let takes = self.model.sites.leaves[leaf as usize].takes.filter(|_| !member.service);
                let done = if member.service { None } else { Some(takes.map_or(Duration::ZERO, |(least, _)| least)) };
                Span { done, end: takes.map(|(_, most)| most), stop }
            }
        };
        // One that dies and is started again begins anew, any number of times.
        if let MemberKind::Leaf(leaf) = member.kind {
            span.end = span.end.filter(|_| !is_restarted(self.model, leaf));
            span.done = span.done.filter(|_| !is_never_done(self.model, leaf));
        }
        if let Some(&(least, most)) = self.assumed.get(&(group, slot)) {
            (span.done, span.end) = (span.done.map(|_| least), Some(most));
        }
        if let MemberKind::Leaf(leaf) = member.kind {
            span.end = span.end.filter(|_| !self.endless.contains(&leaf));
            span.done = span.done.filter(|_| !self.hung.contains(&leaf));
        }
        span
    }

    /// The same where some programs hang and others never end by themselves; nothing is assumed of the groups around them.
    pub(crate) fn without_end(&self, hung: &[u32], others: &[u32]) -> Self {
        let leaves: BTreeSet<u32> = hung.iter().chain(others).copied().collect();
        let mut assumed = self.assumed.clone();
        assumed
            .retain(|&(group, slot), _| !self.model.leaves_below(group, slot).iter().any(|leaf| leaves.contains(leaf)));
        Self {
            model: self.model,
            assumed,
            endless: leaves,
            hung: hung.iter().copied().collect(),
            turns: RefCell::default(),
        }
    }

    /// How long a member is active at the most, by the narrowest thing around each of its places that has a bound.
    pub(crate) fn until_ended(&self, group: u32, slot: u32) -> Option<Duration> {
        let source = &self.model.plan.groups[group as usize];
        let outer = match self.model.around[group as usize] {
            Some((outer, slot)) => self.until_ended(outer, slot),
            None => None,
        };
        self.narrowest((group, source), &source.expression, slot, outer).unwrap_or(outer)
    }

    /// The same below an expression, around which something has the bound `outer`; nothing if the member has no place there.
    fn narrowest(
        &self,
        (group, source): (u32, &Group),
        expression: &Expression,
        slot: u32,
        outer: Option<Duration>,
    ) -> Option<Option<Duration>> {
        let own = self.of(group, source, expression).end;
        let bound = [own, outer].into_iter().flatten().min();
        if matches!(expression, Expression::Run { member, .. } if *member == slot) {
            return Some(bound);
        }
        let operands = expression.operands().into_iter();
        operands
            .filter_map(|operand| self.narrowest((group, source), operand, slot, bound))
            .reduce(|one, other| one.zip(other).map(|(one, other)| one.max(other)))
    }

    /// How long an expression of a group takes.
    pub(crate) fn of(&self, group: u32, source: &Group, expression: &Expression) -> Span {
        let parts: Vec<Span> =
            expression.operands().into_iter().map(|operand| self.of(group, source, operand)).collect();
        let stop = longest(parts.iter().map(|part| part.stop));
        match expression {
            Expression::Run { member, .. } => self.of_member(group, *member),
            Expression::Skip => NOW,
            Expression::Never => Span { done: None, end: None, ..NOW },
            Expression::Fail(_) => Span { done: None, ..NOW },
            Expression::Wait(time) => Span { done: Some(*time), end: Some(*time), ..NOW },
            Expression::Sequence(..) | Expression::Conditional(..) => {
                let span = in_turn(&parts, stop);
                // What is never done is followed by nothing.
                if parts[0].done.is_none() { Span { end: parts[0].end, ..span } } else { span }
            }
            Expression::Finally(..) => {
                let after = add(parts[0].stop, parts[1].end);
                Span { stop: after, ..in_turn(&parts, stop) }
            }
            Expression::Recurrent(..) | Expression::Asynchronous { .. } => Span { done: None, end: None, stop },
            Expression::Otherwise(..) => {
                let done = parts.iter().filter_map(|part| part.done).min();
                Span { done, end: in_turn(&parts, stop).end, stop }
            }
            Expression::Concurrent(of) => self.concurrent(source, of, &parts),
            Expression::FailFast(_) => {
                let done = all(parts.iter().map(|part| part.done));
                Span { done, end: add(longest(parts.iter().map(|part| part.end)), stop), stop }
            }
            Expression::AnyOf { count, .. } => {
                let mut done: Vec<Duration> = parts.iter().filter_map(|part| part.done).collect();
                done.sort_unstable();
                let done = done.get((*count as usize).saturating_sub(1)).copied();
                Span { done, end: add(longest(parts.iter().map(|part| part.end)), stop), stop }
            }
            Expression::Disable(_) => {
                let done = parts.iter().filter_map(|part| part.done).min();
                let end = parts.iter().filter_map(|part| part.end).min();
                Span { done: done.filter(|done| end.is_none_or(|end| *done <= end)), end: add(end, stop), stop }
            }
            Expression::Match(_) => {
                let done = parts.iter().filter_map(|part| part.done).min();
                Span { done, end: longest(parts.iter().map(|part| part.end)), stop }
            }
            Expression::Shield { bound, .. } => {
                let held = match (bound, parts[0].end) {
                    // What ends before its bound is never stopped.
                    (Some(bound), Some(end)) if end <= *bound => Some(end),
                    (Some(bound), _) => add(Some(*bound), stop),
                    (None, end) => end,
                };
                Span { stop: held, ..parts[0] }
            }
            Expression::Using { .. } => {
                Span { end: add(self.turn((group, source), expression), parts[0].end), ..parts[0] }
            }
            Expression::Tagged { .. } => parts[0],
        }
    }

    fn concurrent(&self, source: &Group, of: &[Expression], parts: &[Span]) -> Span {
        let service = |operand: &Expression| {
            let group = Group { expression: operand.clone(), ..source.clone() };
            language::algebra::Program::compile(&group).is_service()
        };
        let services: Vec<bool> = of.iter().map(service).collect();
        let is_service = services.iter().all(|service| *service);
        let tasks =
            || parts.iter().zip(&services).filter(|(_, service)| is_service || !**service).map(|(part, _)| part);
        let stop = longest(parts.iter().map(|part| part.stop));
        let done = all(tasks().map(|part| part.done));
        let end = longest(tasks().map(|part| part.end));
        // Tasks alone are waited for; with a service something is stopped at the end.
        Span { done, end: if services.contains(&true) { add(end, stop) } else { end }, stop }
    }
}

fn add(one: Option<Duration>, other: Option<Duration>) -> Option<Duration> {
    Some(one?.saturating_add(other?))
}

/// The longest, if all are known.
fn longest(times: impl Iterator<Item = Option<Duration>>) -> Option<Duration> {
    times.collect::<Option<Vec<_>>>().map(|times| times.into_iter().max().unwrap_or_default())
}

fn all(times: impl Iterator<Item = Option<Duration>>) -> Option<Duration> {
    longest(times)
}

fn in_turn(parts: &[Span], stop: Option<Duration>) -> Span {
    let sum = |time: fn(&Span) -> Option<Duration>| {
        parts.iter().map(time).try_fold(Duration::ZERO, |sum, time| Some(sum.saturating_add(time?)))
    };
    Span { done: sum(|part| part.done), end: sum(|part| part.end), stop }
}
