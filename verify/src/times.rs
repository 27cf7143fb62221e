//! The durations of processes, as far as limits, pauses and declared durations bound them.

mod culprit;
mod turn;

use crate::model::Model;
use crate::system::{is_never_done, is_restarted};
use language::plan::{Expression, Group, MemberKind};
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long an expression takes: from its start to its normal end, and to any end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Span {
    /// The least time until it is done; none if it is never done.
    pub(crate) done: Option<Duration>,
    /// The most time until it is done, if it ever is; none if nothing bounds it.
    done_most: Option<Duration>,
    /// The least time until it has ended in any way; none if it never ends by itself.
    pub(crate) end_least: Option<Duration>,
    /// The most time until it has ended; none if nothing bounds it.
    pub(crate) end: Option<Duration>,
    /// The most time that a stop of it takes; none if nothing bounds it.
    pub(crate) stop: Option<Duration>,
}

const ZERO: Option<Duration> = Some(Duration::ZERO);
const NOW: Span = Span { done: ZERO, done_most: ZERO, end_least: ZERO, end: ZERO, stop: ZERO };

/// The known durations, and the unknown ones that were asked for.
pub(crate) struct Times<'m, 'a> {
    pub(crate) model: &'m Model<'a>,
    /// For a member of a group, the durations that the spec assumes.
    pub(crate) assumed: BTreeMap<(u32, u32), (Duration, Duration)>,
    /// Programs that never end by themselves, whatever the spec says about them.
    pub(crate) endless: BTreeSet<u32>,
    /// The endless programs that hang, so that they are never done.
    pub(crate) hung: BTreeSet<u32>,
    /// The `using` whose turn is being computed, so that none asks for itself.
    pub(crate) turns: RefCell<Vec<usize>>,
    /// Whether a time that was asked for has a message between hosts in it, which counts as no time.
    has_messages: Cell<bool>,
}

impl<'m, 'a> Times<'m, 'a> {
    /// The durations for a run in which nothing hangs.
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

    /// Whether a message between hosts was part of a question since the last call.
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

    /// A member is started and stopped by messages, and answers with one, if it is on another host than its supervisor.
    pub(crate) fn count_messages(&self, group: u32, slot: u32) {
        let plan = self.model.plan;
        let source = &plan.groups[group as usize];
        let host = match source.members[slot as usize].kind {
            MemberKind::Leaf(leaf) => plan.leaves[leaf as usize].host,
            MemberKind::Group(inner) => plan.groups[inner as usize].host,
        };
        self.has_messages.set(self.has_messages.get() || host != source.host);
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
            has_messages: Cell::default(),
        }
    }

    /// How long a member is active at most, by the narrowest bound around each of its places.
    pub(crate) fn until_ended(&self, group: u32, slot: u32) -> Option<Duration> {
        let source = &self.model.plan.groups[group as usize];
        let outer = match self.model.around[group as usize] {
            Some((outer, slot)) => self.until_ended(outer, slot),
            None => None,
        };
        self.narrowest(group, source, &source.expression, slot, outer).unwrap_or(outer)
    }

    /// The same below an expression, around which something has the bound `outer`; nothing if the member has no place there.
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

    /// How long an expression of a group takes.
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
                let time = Some(*time);
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
            // It may take any number of rounds.
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
                let held = match (bound, parts[0].end) {
                    // An operand that ends before its bound is never stopped.
                    (Some(bound), Some(end)) if end < *bound => Some(end),
                    (Some(bound), _) => add(Some(*bound), stop),
                    (None, end) => end,
                };
                Span { stop: held, ..parts[0] }
            }
            Expression::Using { .. } => {
                let turn = self.turn(group, source, expression);
                let (done_most, end) = (add(turn, parts[0].done_most), add(turn, parts[0].end));
                Span { done_most, end, ..parts[0] }
            }
            Expression::Tagged { .. } | Expression::With { .. } => parts[0],
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
        // Only tasks are waited for. With a service, something is stopped at the end: the services, or all operands if
        // one of them fails.
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

/// The longest, if all are known.
fn longest(times: impl Iterator<Item = Option<Duration>>) -> Option<Duration> {
    times.collect::<Option<Vec<_>>>().map(|times| times.into_iter().max().unwrap_or_default())
}

fn all(times: impl Iterator<Item = Option<Duration>>) -> Option<Duration> {
    longest(times)
}

/// The least time until one of them is done.
fn soonest(parts: &[Span]) -> Option<Duration> {
    parts.iter().filter_map(|part| part.done).min()
}

/// The least time until one of them has ended.
fn first(parts: &[Span]) -> Option<Duration> {
    parts.iter().filter_map(|part| part.end_least).min()
}

/// All come to their ends. Some of them may fail, and need not have been done.
fn at_least(parts: &[Span], count: usize, stop: Option<Duration>) -> Span {
    let mut done: Vec<Duration> = parts.iter().filter_map(|part| part.done).collect();
    done.sort_unstable();
    let done = done.get(count.saturating_sub(1)).copied();
    let end = longest(parts.iter().map(|part| part.end));
    let end_least = all(parts.iter().map(|part| part.end_least));
    let done = done.zip(end_least).map(|(done, end)| done.max(end));
    Span { done, done_most: end, end_least, end, stop }
}

/// When the first operand fails, one of the others follows.
fn caught(parts: &[Span], stop: Option<Duration>) -> Span {
    let [of, arms @ ..] = parts else { return NOW };
    let ways = arms.iter().filter(|arm| arm.done.is_some()).map(|arm| add(of.end, arm.done_most));
    let own = of.done.is_some().then_some(of.done_most);
    let end = add(of.end, longest(arms.iter().map(|arm| arm.end)));
    Span { done: soonest(parts), done_most: longest(ways.chain(own)), end_least: of.end_least, end, stop }
}

/// The second begins once the first is done. Nothing follows a first operand that fails.
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

/// The first to end stops the others. An operand whose least time exceeds another's greatest time is never the first.
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
