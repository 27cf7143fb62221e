//! The durations of processes, as far as limits, pauses and declared durations determine them.

mod culprit;
mod turn;

use crate::model::Model;
use crate::system::{is_never_done, is_restarted};
use language::plan::{Expression, Group, MemberKind, TIMER_LEAST};
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long an expression takes: from its start to its normal end, and to any end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Span {
    /// The shortest time until it is done; none if it is never done.
    pub(crate) done: Option<Duration>,
    /// The longest time until the process is done. None without a limit, or if the process is never done.
    done_most: Option<Duration>,
    /// The shortest time until the end, in any way. None if the process ends only by a stop.
    pub(crate) end_least: Option<Duration>,
    /// The longest time until it has ended; none if it is not limited.
    pub(crate) end: Option<Duration>,
    /// The longest time that stopping it takes; none if it is not limited.
    pub(crate) stop: Option<Duration>,
}

const ZERO: Option<Duration> = Some(Duration::ZERO);
const NOW: Span = Span { done: ZERO, done_most: ZERO, end_least: ZERO, end: ZERO, stop: ZERO };

/// The known durations, and the data for computing others.
pub(crate) struct Times<'m, 'a> {
    pub(crate) model: &'m Model<'a>,
    /// For members of groups, the shortest and the longest duration that the spec assumes.
    pub(crate) assumed: BTreeMap<(u32, u32), (Duration, Duration)>,
    /// Programs that never end by themselves, even if the spec assumes a duration for them.
    pub(crate) endless: BTreeSet<u32>,
    /// The endless programs that hang, so that they are never done.
    pub(crate) hung: BTreeSet<u32>,
    /// The `using`s whose turn is being computed, so that none of them waits for itself.
    pub(crate) turns: RefCell<Vec<usize>>,
    /// Whether a requested time contains a message between hosts, whose time is counted as zero.
    has_messages: Cell<bool>,
}

impl<'m, 'a> Times<'m, 'a> {
    /// Returns the durations for a run in which no program hangs.
    pub(crate) fn new(model: &'m Model<'a>, assumed: BTreeMap<(u32, u32), (Duration, Duration)>) -> Self {
        Self {
            model,
            assumed,
            endless: BTreeSet::new(),
            hung: BTreeSet::new(),
            turns: RefCell::default(),
            has_messages: Cell::default(),
        }
    }

    /// Returns whether a message between hosts was part of a requested time since the last call.
    pub(crate) fn take_messages(&self) -> bool {
        self.has_messages.take()
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
        self.count_messages(group, slot);
        let mut span = match member.kind {
            MemberKind::Group(inner) => self.of_group(inner),
            MemberKind::Leaf(leaf) => {
                let stop = Some(self.model.plan.leaves[leaf as usize].stop_within);
                let takes = self.model.sites.leaves[leaf as usize].takes.filter(|_| !member.service);
                let done = if member.service { None } else { Some(takes.map_or(Duration::ZERO, |(least, _)| least)) };
                let most = takes.map(|(_, most)| most);
                Span { done, done_most: most, end_least: ZERO, end: most, stop }
            }
        };
        // A program that is restarted begins again, any number of times.
        if let MemberKind::Leaf(leaf) = member.kind {
            span.end = span.end.filter(|_| !is_restarted(self.model, leaf));
            span.done_most = span.done_most.filter(|_| !is_restarted(self.model, leaf));
            span.done = span.done.filter(|_| !is_never_done(self.model, leaf));
        }
        if let Some(&(least, most)) = self.assumed.get(&(group, slot)) {
            (span.done, span.done_most, span.end) = (span.done.map(|_| least), Some(most), Some(most));
        }
        if let MemberKind::Leaf(leaf) = member.kind {
            span.end = span.end.filter(|_| !self.endless.contains(&leaf));
            span.done_most = span.done_most.filter(|_| !self.endless.contains(&leaf));
            span.done = span.done.filter(|_| !self.hung.contains(&leaf));
        }
        span
    }

    /// Notes messages if a member is on another host than its supervisor: it is started and stopped by messages, and answers
    /// with one.
    pub(crate) fn count_messages(&self, group: u32, slot: u32) {
        let plan = self.model.plan;
        let source = &plan.groups[group as usize];
        let host = match source.members[slot as usize].kind {
            MemberKind::Leaf(leaf) => plan.leaves[leaf as usize].host,
            MemberKind::Group(inner) => plan.groups[inner as usize].host,
        };
        self.has_messages.set(self.has_messages.get() || host != source.host);
    }

    /// Returns the durations if some programs hang and others never end by themselves. Nothing is assumed for the groups
    /// around them.
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
            has_messages: Cell::default(),
        }
    }

    /// Returns the longest time for which a member is active: the smallest limit around each of its occurrences.
    pub(crate) fn until_ended(&self, group: u32, slot: u32) -> Option<Duration> {
        let source = &self.model.plan.groups[group as usize];
        let outer = match self.model.around[group as usize] {
            Some((outer, slot)) => self.until_ended(outer, slot),
            None => None,
        };
        self.narrowest(group, source, &source.expression, slot, outer).unwrap_or(outer)
    }

    /// Returns the same within an expression that has the limit `outer`; none if the member does not occur in it.
    fn narrowest(
        &self,
        group: u32,
        source: &Group,
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
            .filter_map(|operand| self.narrowest(group, source, operand, slot, bound))
            .reduce(|one, other| one.zip(other).map(|(one, other)| one.max(other)))
    }

    /// Returns the durations of an expression of a group.
    pub(crate) fn of(&self, group: u32, source: &Group, expression: &Expression) -> Span {
        let parts: Vec<Span> =
            expression.operands().into_iter().map(|operand| self.of(group, source, operand)).collect();
        let stop = longest(parts.iter().map(|part| part.stop));
        match expression {
            Expression::Run { member, .. } => self.of_member(group, *member),
            Expression::Skip => NOW,
            Expression::Never => Span { done: None, end_least: None, end: None, ..NOW },
            Expression::Fail(_) => Span { done: None, ..NOW },
            Expression::Chart(chart) => {
                let done = (!chart.is_service()).then_some(Duration::ZERO);
                Span { done, done_most: None, end_least: Some(Duration::ZERO), end: None, stop }
            }
            Expression::Wait(time) => {
                let time = Some((*time).max(TIMER_LEAST));
                Span { done: time, done_most: time, end_least: time, end: time, ..NOW }
            }
            Expression::Sequence(..) | Expression::Conditional(..) => in_turn(&parts, stop),
            Expression::Finally(..) => Span {
                end: add(parts[0].end, parts[1].end),
                stop: add(parts[0].stop, parts[1].end),
                ..in_turn(&parts, stop)
            },
            Expression::Recurrent(..) | Expression::Asynchronous { .. } => {
                Span { done: None, done_most: None, end_least: parts[0].end_least, end: None, stop }
            }
            // The number of rounds is not limited.
            Expression::Repeat { .. } => Span { done_most: None, end: None, ..parts[0] },
            Expression::Otherwise(..) | Expression::Catch { .. } => caught(&parts, stop),
            Expression::Concurrent(of) => self.concurrent(source, of, &parts),
            Expression::FailFast(_) => {
                let done_most = longest(parts.iter().map(|part| part.done_most));
                let done = all(parts.iter().map(|part| part.done));
                let end = add(longest(parts.iter().map(|part| part.end)), stop);
                Span { done, done_most, end_least: first(&parts), end, stop }
            }
            Expression::AnyOf { count, .. } => {
                let mut done: Vec<Duration> = parts.iter().filter_map(|part| part.done).collect();
                done.sort_unstable();
                let done = done.get((*count as usize).saturating_sub(1)).copied();
                let end = add(longest(parts.iter().map(|part| part.end)), stop);
                Span { done, done_most: end, end_least: first(&parts), end, stop }
            }
            Expression::AtLeast { count, .. } => at_least(&parts, *count as usize, stop),
            Expression::Disable(_) => disable(&parts, stop),
            Expression::Match(_) => {
                let done_most = longest(parts.iter().filter(|part| part.done.is_some()).map(|part| part.done_most));
                let end = longest(parts.iter().map(|part| part.end));
                Span { done: soonest(&parts), done_most, end_least: first(&parts), end, stop }
            }
            Expression::Shield { bound, .. } => {
                let bound = bound.map(|bound| bound.max(TIMER_LEAST));
                let held = match (bound, parts[0].end) {
                    // An operand that ends within its time limit is never stopped.
                    (Some(bound), Some(end)) if end < bound => Some(end),
                    (Some(bound), _) => add(Some(bound), stop),
                    (None, end) => end,
                };
                Span { stop: held, ..parts[0] }
            }
            Expression::Using { .. } => {
                let turn = self.turn(group, source, expression);
                let (done_most, end) = (add(turn, parts[0].done_most), add(turn, parts[0].end));
                Span { done_most, end, ..parts[0] }
            }
            Expression::Tagged { .. } | Expression::With { .. } | Expression::Named { .. } => parts[0],
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
        // Only tasks are waited for. If there is a service, something is stopped at the end: the services, or all operands
        // if one of them fails.
        let waited = is_service || !services.contains(&true);
        let left = longest(parts.iter().zip(&services).filter(|(_, service)| **service).map(|(part, _)| part.stop));
        let done_most = longest(tasks().map(|part| part.done_most));
        let done_most = if waited { done_most } else { add(done_most, left) };
        let end = if services.contains(&true) { add(end, stop) } else { end };
        Span { done, done_most, end_least: first(parts), end, stop }
    }
}

fn add(one: Option<Duration>, other: Option<Duration>) -> Option<Duration> {
    Some(one?.saturating_add(other?))
}

/// Returns the longest of some times, if all are known.
fn longest(times: impl Iterator<Item = Option<Duration>>) -> Option<Duration> {
    times.collect::<Option<Vec<_>>>().map(|times| times.into_iter().max().unwrap_or_default())
}

fn all(times: impl Iterator<Item = Option<Duration>>) -> Option<Duration> {
    longest(times)
}

/// Returns the shortest time until one of some parts is done.
fn soonest(parts: &[Span]) -> Option<Duration> {
    parts.iter().filter_map(|part| part.done).min()
}

/// Returns the shortest time until one of some parts has ended.
fn first(parts: &[Span]) -> Option<Duration> {
    parts.iter().filter_map(|part| part.end_least).min()
}

/// Returns the durations if all parts end by themselves. Some of them may fail, and do not have to be done.
fn at_least(parts: &[Span], count: usize, stop: Option<Duration>) -> Span {
    let mut done: Vec<Duration> = parts.iter().filter_map(|part| part.done).collect();
    done.sort_unstable();
    let done = done.get(count.saturating_sub(1)).copied();
    let end = longest(parts.iter().map(|part| part.end));
    let end_least = all(parts.iter().map(|part| part.end_least));
    let done = done.zip(end_least).map(|(done, end)| done.max(end));
    Span { done, done_most: end, end_least, end, stop }
}

/// Returns the durations if one of the other parts follows when the first one fails.
fn caught(parts: &[Span], stop: Option<Duration>) -> Span {
    let [of, arms @ ..] = parts else { return NOW };
    let ways = arms.iter().filter(|arm| arm.done.is_some()).map(|arm| add(of.end, arm.done_most));
    let own = of.done.is_some().then_some(of.done_most);
    let end = add(of.end, longest(arms.iter().map(|arm| arm.end)));
    Span { done: soonest(parts), done_most: longest(ways.chain(own)), end_least: of.end_least, end, stop }
}

/// Returns the durations if the second part begins once the first is done. Nothing follows a first part that fails.
fn in_turn(parts: &[Span], stop: Option<Duration>) -> Span {
    let [one, other] = parts else { return NOW };
    let after = add(one.done_most, other.end);
    Span {
        done: add(one.done, other.done),
        done_most: add(one.done_most, other.done_most),
        end_least: one.end_least,
        end: if one.done.is_some() { longest([one.end, after].into_iter()) } else { one.end },
        stop,
    }
}

/// Returns the durations if the first part that ends stops the others. A part whose shortest time exceeds another one's
/// longest time is never the first.
fn disable(parts: &[Span], stop: Option<Duration>) -> Span {
    let most = parts.iter().filter_map(|part| part.end).min();
    let is_first = |least: Option<Duration>| least.is_some_and(|least| most.is_none_or(|most| least <= most));
    let others = |own: usize| {
        let others = parts.iter().enumerate().filter(|(other, _)| *other != own);
        longest(others.map(|(_, part)| part.stop))
    };
    let winners =
        |least: fn(&Span) -> Option<Duration>| parts.iter().enumerate().filter(move |(_, part)| is_first(least(part)));
    let done_most = |(own, part): (usize, &Span)| {
        let most = [part.done_most, most].into_iter().flatten().min();
        add(most, others(own))
    };
    Span {
        done: soonest(parts).filter(|done| is_first(Some(*done))),
        done_most: longest(winners(|part| part.done).map(done_most)),
        end_least: first(parts),
        end: most.and_then(|_| longest(winners(|part| part.end_least).map(|(own, _)| add(most, others(own))))),
        stop,
    }
}
