//! Finds the steps for which a limit leaves no time: `(a else (wait(20 s) ; b)) within 10 s` never starts `b`.
//!
//! An exploration knows the order of a few timers only, and no durations of programs. So these steps are found from the shortest times.

use crate::finding::{Finding, diagnostic, help};
use crate::model::Model;
use crate::story::seconds;
use crate::times::Times;
use language::plan::{Expression, Group, MemberKind};
use language::{Code, Span};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long a process may still run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Left {
    /// No known limit stops the node.
    Free,
    /// The node is stopped once `limit` has passed. At least `used` of this time has already passed.
    Within { limit: Duration, used: Duration },
    /// The node never starts, because it would start only after `used`. `cause` is the node that makes it too late.
    Over { limit: Duration, used: Duration, cause: usize },
}

impl Left {
    /// Returns the time that is left after a further time. An unknown time changes nothing.
    fn after(self, time: Option<Duration>, node: usize) -> Self {
        match (self, time) {
            (Self::Within { limit, used }, Some(time)) => {
                let used = used.saturating_add(time);
                if used > limit { Self::Over { limit, used, cause: node } } else { Self::Within { limit, used } }
            }
            (left, _) => left,
        }
    }

    /// Returns the time that is left under a further limit.
    fn within(self, limit: Option<Duration>) -> Self {
        match (self, limit) {
            (Self::Free, Some(limit)) => Self::Within { limit, used: Duration::ZERO },
            (Self::Within { limit: outer, used }, Some(limit)) if limit < outer.saturating_sub(used) => {
                Self::Within { limit, used: Duration::ZERO }
            }
            (left, _) => left,
        }
    }

    /// Returns the alternative that leaves more time.
    fn or(self, other: Self) -> Self {
        let rest = |left: Self| match left {
            Self::Free => Duration::MAX,
            Self::Within { limit, used } => limit.saturating_sub(used),
            Self::Over { .. } => Duration::ZERO,
        };
        if rest(self) >= rest(other) && !matches!(self, Self::Over { .. }) { self } else { other }
    }
}

/// The occurrences of the steps of each group, by their text.
type Tries = BTreeMap<(u32, Span), Vec<Try>>;

/// One occurrence of a step. The same text in a `retry` has one occurrence for each try.
#[derive(Clone, Copy, Debug)]
struct Try {
    group: u32,
    member: u32,
    left: Left,
    /// Set if the step begins in time, but its try ends too late: the earliest end of this try, and its node.
    too_late: Option<(Duration, usize)>,
}

/// Finds the steps that never start, and the steps of a `retry` that are never retried in time.
pub(crate) fn check(times: &Times<'_, '_>) -> Vec<Finding> {
    let model = times.model;
    let mut tries: Tries = BTreeMap::new();
    let mut lefts: Vec<Option<Left>> = vec![None; model.plan.groups.len()];
    lefts[0] = Some(Left::Free);
    // A group has a greater number than the group that contains it.
    for (group, source) in (0_u32..).zip(&model.plan.groups) {
        let Some(left) = lefts[group as usize] else { continue };
        let mut walk = Walk { times, group, source, node: 0, too_late: None, tries: &mut tries, lefts: &mut lefts };
        walk.at(&source.expression, left);
    }
    // Steps after a step that never starts have the same cause. A text is reported only once for all instances of its
    // group.
    let (mut causes, mut places) = (BTreeSet::new(), BTreeSet::new());
    let found = tries.into_iter().filter_map(|((group, span), tries)| {
        let (cause, finding) = finding(model, span, &tries)?;
        (causes.insert((group, cause)) && places.insert(span)).then_some(finding)
    });
    found.collect()
}

/// Returns the finding for a step, with the node that causes it.
fn finding(model: &Model<'_>, span: Span, tries: &[Try]) -> Option<(usize, Finding)> {
    let (first, others) = tries.split_first()?;
    let name = model.name(first.group, first.member);
    let is_over = |one: &Try| matches!(one.left, Left::Over { .. });
    if let Some(Left::Over { limit, used, cause }) = tries.iter().all(is_over).then_some(first.left) {
        let message = format!(
            "`{name}` is never started here: that takes {} at the least, and after {} it is stopped",
            seconds(used),
            seconds(limit)
        );
        let found = help(diagnostic(Code::E0812, span, message), format!("give it more than {}", seconds(used)));
        return Some((cause, Finding::fails(found, None)));
    }
    let next = others.first().filter(|_| others.iter().all(|one| is_over(one) || one.too_late.is_some()))?;
    let (limit, ends, cause) = match (next.left, next.too_late) {
        (Left::Over { limit, used, cause }, _) => (limit, used, cause),
        (Left::Within { limit, .. }, Some((ends, cause))) => (limit, ends, cause),
        (Left::Free | Left::Within { .. }, _) => return None,
    };
    let verb = if is_over(next) { "begins" } else { "ends" };
    let message = format!(
        "`{name}` is never tried again in time: a second try {verb} after {} at the least, and after {} it is stopped",
        seconds(ends),
        seconds(limit)
    );
    let advice =
        format!("give it more than {}, or put the limit around one try: `retry(...) (... within ...)`", seconds(ends));
    Some((cause, Finding::fails(help(diagnostic(Code::E0815, span, message), advice), None)))
}

struct Walk<'w, 'm, 'a> {
    times: &'w Times<'m, 'a>,
    group: u32,
    source: &'w Group,
    /// The number of the next node.
    node: usize,
    /// Set if the try ends too late: the shortest time to its end, and the number of its node.
    too_late: Option<(Duration, usize)>,
    tries: &'w mut Tries,
    lefts: &'w mut Vec<Option<Left>>,
}

impl Walk<'_, '_, '_> {
    fn at(&mut self, expression: &Expression, left: Left) {
        let node = self.node;
        self.node += 1;
        match expression {
            Expression::Run { member, .. } => self.run(node, *member, left),
            Expression::Chart(_) => {
                expression.operands().into_iter().for_each(|operand| self.at(operand, Left::Free));
            }
            Expression::Sequence(one, other)
            | Expression::Conditional(one, other)
            | Expression::Recurrent(one, other) => {
                self.at(one, left);
                let done = if left == Left::Free { None } else { self.times.of(self.group, self.source, one).done };
                self.at(other, left.after(done, self.node));
            }
            Expression::Otherwise(one, other) => {
                self.at(one, left);
                let failed = if left == Left::Free { None } else { self.failed(one) };
                self.instead(other, left.after(failed, self.node));
            }
            Expression::Catch { of, arms } => {
                self.at(of, left);
                let failed = if left == Left::Free { None } else { self.failed(of) };
                for arm in arms {
                    self.instead(&arm.body, left.after(failed, self.node));
                }
            }
            Expression::Disable(of) => {
                let bounds: Vec<Option<Duration>> = of.iter().map(|operand| self.bound(operand)).collect();
                for (index, operand) in of.iter().enumerate() {
                    let others = bounds.iter().enumerate().filter(|(other, _)| *other != index);
                    self.at(operand, left.within(others.filter_map(|(_, bound)| *bound).min()));
                }
            }
            // The operand also runs when everything is stopped.
            Expression::Finally(one, other) => {
                self.at(one, left);
                self.at(other, Left::Free);
            }
            // A shield that has begun cannot be stopped.
            Expression::Shield { of, .. } => {
                self.at(of, if matches!(left, Left::Over { .. }) { left } else { Left::Free });
            }
            Expression::Asynchronous { source, pool } => {
                self.at(source, left);
                let done = if left == Left::Free { None } else { self.times.of(self.group, self.source, source).done };
                pool.iter().for_each(|one| self.at(one, left.after(done, self.node)));
            }
            Expression::Skip
            | Expression::Never
            | Expression::Fail(_)
            | Expression::Wait(_)
            | Expression::Concurrent(_)
            | Expression::FailFast(_)
            | Expression::AnyOf { .. }
            | Expression::AtLeast { .. }
            | Expression::Match(_)
            | Expression::Using { .. }
            | Expression::Tagged { .. }
            | Expression::With { .. }
            | Expression::Named { .. }
            | Expression::Repeat { .. } => {
                expression.operands().into_iter().for_each(|operand| self.at(operand, left));
            }
        }
    }

    /// Checks an operand that runs when another one has failed. It may begin without enough time to be done.
    fn instead(&mut self, other: &Expression, left: Left) {
        let before = self.too_late;
        if let Left::Within { limit, used } = left {
            let done = self.times.of(self.group, self.source, other).done;
            let ends = done.map(|done| used.saturating_add(done)).filter(|ends| *ends > limit);
            self.too_late = ends.map(|ends| (ends, self.node)).or(before);
        }
        self.at(other, left);
        self.too_late = before;
    }

    fn run(&mut self, node: usize, member: u32, left: Left) {
        let sites = &self.times.model.sites.groups[self.group as usize];
        let span = sites.nodes.get(node).copied().unwrap_or(sites.name);
        let one = Try { group: self.group, member, left, too_late: self.too_late };
        self.tries.entry((self.group, span)).or_default().push(one);
        if let MemberKind::Group(inner) = self.source.members[member as usize].kind
            && !matches!(left, Left::Over { .. })
        {
            // An order to stop takes some time to reach another host.
            let is_near = self.times.model.plan.groups[inner as usize].host == self.source.host;
            let left = if is_near { left } else { Left::Free };
            let known = &mut self.lefts[inner as usize];
            *known = Some(known.map_or(left, |known| known.or(left)));
        }
    }

    /// Returns the longest time until an expression has ended, if no message between hosts is involved.
    fn bound(&self, expression: &Expression) -> Option<Duration> {
        self.times.take_messages();
        let end = self.times.of(self.group, self.source, expression).end;
        end.filter(|_| !self.times.take_messages())
    }

    /// Returns the shortest time until an expression fails; none if it never does.
    fn failed(&self, expression: &Expression) -> Option<Duration> {
        let sooner = |of: Vec<Option<Duration>>| of.into_iter().flatten().min();
        match expression {
            Expression::Skip | Expression::Never | Expression::Wait(_) => None,
            Expression::Sequence(one, other) | Expression::Conditional(one, other) => {
                let done = self.times.of(self.group, self.source, one).done;
                let after = done.and_then(|done| Some(done.saturating_add(self.failed(other)?)));
                sooner(vec![self.failed(one), after])
            }
            Expression::Otherwise(one, other) => Some(self.failed(one)?.saturating_add(self.failed(other)?)),
            Expression::Disable(of) => sooner(of.iter().map(|operand| self.failed(operand)).collect()),
            Expression::Tagged { of, .. }
            | Expression::With { of, .. }
            | Expression::Named { of, .. }
            | Expression::Repeat { of, .. } => self.failed(of),
            Expression::Run { .. }
            | Expression::Chart(_)
            | Expression::Fail(_)
            | Expression::Concurrent(_)
            | Expression::FailFast(_)
            | Expression::AnyOf { .. }
            | Expression::AtLeast { .. }
            | Expression::Recurrent(..)
            | Expression::Match(_)
            | Expression::Shield { .. }
            | Expression::Using { .. }
            | Expression::Asynchronous { .. }
            | Expression::Catch { .. }
            | Expression::Finally(..) => self.times.of(self.group, self.source, expression).end_least,
        }
    }
}
