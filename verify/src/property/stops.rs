//! Computes the time of a stop: from its cause until the process in the sentence has stopped.
//!
//! When a process ends, the innermost operator around both processes stops the other side. First, the rest of the
//! cause's own side has to stop. Then the order goes down to the other process, past every `shield` and every
//! `finally` around it.

use crate::model::runs;
use crate::times::Times;
use language::automaton::{Chart, StateKind};
use language::plan::{Expression, Group, MemberKind, StateRun, TIMER_LEAST};
use language::sites::ProcessRef;
use std::time::Duration;

/// A member of a group.
#[derive(Clone, Copy)]
struct Place<'p> {
    group: u32,
    source: &'p Group,
    slot: u32,
}

impl Times<'_, '_> {
    /// Returns the longest time from an event of `cause` until `who` has stopped; none if it is not limited.
    pub(super) fn stop_after(&self, cause: ProcessRef, who: ProcessRef) -> Option<Duration> {
        let (causes, stopped) = (self.outwards(cause), self.outwards(who));
        let common = causes.iter().find_map(|&(group, slot)| {
            let (_, other) = stopped.iter().find(|(other, _)| *other == group)?;
            Some((group, slot, *other))
        });
        let last = common.map_or(who.group, |(group, ..)| group);
        for &(group, slot) in causes.iter().take_while(|(inner, _)| *inner != last) {
            self.count_messages(group, slot);
        }
        if let Some((group, slot, _)) = common {
            self.count_messages(group, slot);
        }
        // A group ends once its members other than the cause have stopped.
        let inside = causes.iter().take_while(|(inner, _)| *inner != last);
        let rest = inside.map(|&(group, slot)| {
            let place = self.place(group, slot);
            self.rest_stops(place, slot, &place.source.expression)
        });
        let before = rest.into_iter().try_fold(Duration::ZERO, sum)?;
        let Some((group, slot, other)) = common else {
            return sum(before, self.of_group(who.group).stop);
        };
        let place = self.place(group, other);
        let stop = match slot == other {
            true => self.until_member_stopped(place, &stopped),
            false => self.across(place, slot, &place.source.expression, &stopped).unwrap_or(Some(Duration::ZERO)),
        };
        sum(before, stop)
    }

    fn place(&self, group: u32, slot: u32) -> Place<'_> {
        Place { group, source: &self.model.plan.groups[group as usize], slot }
    }

    /// Returns a process and the groups around it, the innermost first, each by its group and slot.
    fn outwards(&self, who: ProcessRef) -> Vec<(u32, u32)> {
        let around = |group: u32| self.model.around[group as usize];
        let first = who.member.map(|slot| (who.group, slot)).or_else(|| around(who.group));
        std::iter::successors(first, |(group, _)| around(*group)).collect()
    }

    /// Returns the longest time over all operators that have the two processes in different operands; none if there is
    /// no such operator.
    fn across(
        &self,
        place: Place<'_>,
        cause: u32,
        expression: &Expression,
        stopped: &[(u32, u32)],
    ) -> Option<Option<Duration>> {
        let operands = expression.operands();
        let mut found: Vec<Option<Duration>> = Vec::new();
        for (index, one) in operands.iter().enumerate() {
            found.extend(self.across(place, cause, one, stopped));
            if !runs(one).contains(&cause) {
                continue;
            }
            let others = operands.iter().enumerate().filter(|(other, _)| *other != index).map(|(_, other)| other);
            for other in others.filter(|other| runs(other).contains(&place.slot)) {
                let stop = self.until_stopped(place, other, stopped);
                let before = self
                    .rest_stops(place, cause, one)
                    .and_then(|rest| sum(rest, self.queued(place, cause, expression)));
                found.push(before.and_then(|before| sum(before, stop)));
            }
        }
        (!found.is_empty()).then(|| longest(found.into_iter()))
    }

    /// Returns the longest time until everything in an expression except the cause has stopped.
    fn rest_stops(&self, place: Place<'_>, cause: u32, expression: &Expression) -> Option<Duration> {
        if matches!(expression, Expression::Run { member, .. } if *member == cause) {
            return Some(Duration::ZERO);
        }
        let operands = expression.operands();
        if operands.is_empty() || matches!(expression, Expression::Shield { .. } | Expression::Finally(..)) {
            return self.of(place.group, place.source, expression).stop;
        }
        let rest = longest(operands.into_iter().map(|operand| self.rest_stops(place, cause, operand)));
        rest.and_then(|rest| sum(rest, self.queued(place, cause, expression)))
    }

    /// Returns the longest time for which the end of the cause may wait in the queue of an activity. A transition in another
    /// region waits until the runs that it leaves have stopped. Each event before the cause in the queue may lead to such a
    /// transition. In one reaction, each run stops at most once, since no run begins before the end of the reaction.
    fn queued(&self, place: Place<'_>, cause: u32, expression: &Expression) -> Option<Duration> {
        let Expression::Chart(chart) = expression else { return Some(Duration::ZERO) };
        let is_own = |run: &&StateRun| runs(&run.expression).contains(&cause);
        let is_beside = |run: &&StateRun| {
            chart.runs.iter().filter(is_own).any(|own| own.state != run.state && are_together(&chart.chart, own, run))
        };
        let beside: Vec<&StateRun> = chart.runs.iter().filter(is_beside).collect();
        let stops = beside.iter().map(|run| self.of(place.group, place.source, &run.expression).stop);
        let stops = stops.into_iter().try_fold(Duration::ZERO, sum)?;
        let timers = chart.chart.transitions.iter().filter(|transition| transition.trigger.time().is_some()).count();
        let reactions = 1 + beside.len() + timers + chart.notices.len();
        Some(stops.saturating_mul(u32::try_from(reactions).unwrap_or(u32::MAX)))
    }

    /// Returns the longest time from an order to stop until the member, or the named process inside it, has stopped.
    fn until_stopped(&self, place: Place<'_>, expression: &Expression, stopped: &[(u32, u32)]) -> Option<Duration> {
        let of = |operand: &Expression| self.of(place.group, place.source, operand);
        let inner = |operand: &Expression| match runs(operand).contains(&place.slot) {
            true => self.until_stopped(place, operand, stopped),
            false => Some(Duration::ZERO),
        };
        if let Expression::Run { .. } = expression {
            return self.until_member_stopped(place, stopped);
        }
        if let Expression::Shield { bound, of: body } = expression {
            return match (bound.map(|bound| bound.max(TIMER_LEAST)), of(body).end) {
                // An operand that ends within its time limit is never stopped.
                (Some(bound), Some(end)) if end < bound => Some(end),
                (Some(bound), _) => sum(bound, inner(body)),
                (None, end) => end,
            };
        }
        if let Expression::Finally(body, last) = expression
            && runs(last).contains(&place.slot)
        {
            let after = of(body).stop.and_then(|stop| sum(stop, of(last).end));
            return longest([inner(body), after].into_iter());
        }
        longest(expression.operands().into_iter().map(inner))
    }

    fn until_member_stopped(&self, place: Place<'_>, stopped: &[(u32, u32)]) -> Option<Duration> {
        let inside = stopped.iter().position(|at| *at == (place.group, place.slot)).and_then(|at| at.checked_sub(1));
        match (place.source.members[place.slot as usize].kind, inside) {
            (MemberKind::Group(_), Some(inside)) => {
                self.count_messages(place.group, place.slot);
                let (group, slot) = stopped[inside];
                let place = self.place(group, slot);
                self.until_stopped(place, &place.source.expression, stopped)
            }
            (MemberKind::Group(_) | MemberKind::Leaf(_), _) => self.of_member(place.group, place.slot).stop,
        }
    }
}

/// Returns whether two runs of an activity may be active at the same time: one state contains the other, or they are in two
/// regions.
fn are_together(chart: &Chart, one: &StateRun, other: &StateRun) -> bool {
    let outwards = |run: &StateRun| -> Vec<usize> {
        std::iter::successors(Some(run.state as usize), |state| chart.states[*state].parent).collect()
    };
    let (one, other) = (outwards(one), outwards(other));
    let common = one.iter().find(|state| other.contains(state));
    common.is_none_or(|state| {
        *state == one[0] || *state == other[0] || matches!(chart.states[*state].kind, StateKind::Parallel)
    })
}

fn sum(one: Duration, other: Option<Duration>) -> Option<Duration> {
    Some(one.saturating_add(other?))
}

fn longest(times: impl Iterator<Item = Option<Duration>>) -> Option<Duration> {
    times.collect::<Option<Vec<_>>>().map(|times| times.into_iter().max().unwrap_or_default())
}
