//! The steps of a plan's main sequence, and their names.

use language::automaton::Failure;
use language::plan::{Arm, CatchArm, DEADLINE, Expression, Group, Member, MemberKind, Plan};
use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;

/// One element of the main sequence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Step {
    /// Its expression as written in the spec, without labels.
    pub(super) name: String,
    /// The slots of the members that the step runs.
    pub(super) members: BTreeSet<u32>,
}

/// Returns the group with the main sequence, and the steps of the sequence.
pub(super) fn steps(plan: &Plan) -> (Option<&Group>, Vec<Step>) {
    let groups = breadth_first(plan);
    let is_chained = |group: &&&Group| has_sequence(&group.expression) || is_activity(group);
    let chained = groups.iter().find(is_chained);
    let group = chained.or_else(|| groups.iter().find(|group| group.members.len() > 1)).or_else(|| groups.first());
    let mut steps = Vec::new();
    if let Some(group) = group.filter(|group| is_activity(group)) {
        let members = (0..).zip(&group.members).map(|(slot, _)| slot).collect();
        steps.push(Step { name: text(&group.expression, &group.members).1, members });
    } else if let Some(group) = group {
        flatten(sequence(&group.expression), &group.members, &mut steps);
        steps.retain(|step| !step.members.is_empty());
    }
    (group.copied(), steps)
}

/// Returns whether a group is an activity. The states of an activity are its phases.
fn is_activity(group: &Group) -> bool {
    matches!(group.expression, Expression::Chart(_))
}

/// Returns all groups breadth first from `main`, except services, which do not end by themselves.
fn breadth_first(plan: &Plan) -> Vec<&Group> {
    let mut found: Vec<&Group> = Vec::new();
    let mut queue = VecDeque::from([0]);
    while let Some(group) = queue.pop_front().and_then(|index: usize| plan.groups.get(index)) {
        // A plan from another program may be wrong. Without this bound, groups that contain each other would be an endless loop.
        if found.len() == plan.groups.len() {
            break;
        }
        found.push(group);
        for member in group.members.iter().filter(|member| !member.service) {
            if let MemberKind::Group(index) = member.kind {
                queue.extend(usize::try_from(index));
            }
        }
    }
    found
}

fn has_sequence(expression: &Expression) -> bool {
    is_sequence(expression) || parts(expression).iter().any(|child| has_sequence(child))
}

fn is_sequence(expression: &Expression) -> bool {
    use Expression as E;
    matches!(expression, E::Sequence(..) | E::Conditional(..) | E::Recurrent(..))
}

/// Returns the first part of `expression` that is a sequence. The members beside it are background.
fn sequence(expression: &Expression) -> &Expression {
    if is_sequence(expression) || matches!(expression, Expression::Otherwise(..) | Expression::Finally(..)) {
        return expression;
    }
    parts(expression).into_iter().find(|child| has_sequence(child)).map_or(expression, sequence)
}

/// Returns the operands as written in the spec. The clock of a deadline and the further tries of a retry are not among them.
fn parts(expression: &Expression) -> Vec<&Expression> {
    let one = deadline(expression).map(|(of, _)| of).or_else(|| retry(expression).map(|(of, ..)| of));
    one.map_or_else(|| expression.operands(), |of| vec![of])
}

/// If the expression is an expanded `P within d`, returns `P` and the time `d`.
fn deadline(expression: &Expression) -> Option<(&Expression, Duration)> {
    let Expression::Disable(of) = expression else { return None };
    let [of, Expression::Sequence(clock, end)] = &of[..] else { return None };
    match (&**clock, &**end) {
        (Expression::Wait(limit), Expression::Fail(why)) if why.starts_with(DEADLINE) => Some((of, *limit)),
        _ => None,
    }
}

/// If the expression is an expanded `retry(n) P`, returns `P`, the number of tries, and the pause before each further try.
fn retry(expression: &Expression) -> Option<(&Expression, usize, Option<Duration>)> {
    let (mut tries, mut waiting) = (Vec::new(), vec![expression]);
    while let Some(next) = waiting.pop() {
        if let Expression::Otherwise(p, q) = next { waiting.extend([&**q, &**p]) } else { tries.push(next) }
    }
    let (&first, again) = tries.split_first()?;
    let paused = |next: &&Expression| {
        let Expression::Sequence(clock, of) = next else { return None };
        let Expression::Wait(pause) = &**clock else { return None };
        (**of == *first).then_some(*pause)
    };
    if again.iter().all(|next| *next == first) {
        return Some((first, again.len(), None)).filter(|_| !again.is_empty());
    }
    let pause = paused(again.first()?)?;
    again.iter().all(|next| paused(next) == Some(pause)).then_some((first, again.len(), Some(pause)))
}

fn flatten(expression: &Expression, members: &[Member], steps: &mut Vec<Step>) {
    let is_two = matches!(expression, Expression::Otherwise(..) | Expression::Finally(..));
    if is_sequence(expression) || is_two && has_sequence(expression) {
        for child in parts(expression) {
            flatten(child, members, steps);
        }
    } else {
        let mut slots = BTreeSet::new();
        collect(expression, &mut slots);
        steps.push(Step { name: text(expression, members).1, members: slots });
    }
}

fn collect(expression: &Expression, slots: &mut BTreeSet<u32>) {
    if let Expression::Run { member, .. } = expression {
        slots.insert(*member);
    }
    for child in expression.operands() {
        collect(child, slots);
    }
}

/// Returns how tightly an expression binds (a higher number binds more tightly), and its text.
fn text(expression: &Expression, members: &[Member]) -> (u8, String) {
    use Expression as E;
    if let Some((of, limit)) = deadline(expression) {
        return (6, format!("{} within {} s", inside(of, 7, members), limit.as_secs_f64()));
    }
    if let Some((of, times, pause)) = retry(expression) {
        let pause = pause.map_or(String::new(), |pause| format!(", pause {} s", pause.as_secs_f64()));
        return (6, format!("retry({times}{pause}) {}", inside(of, 6, members)));
    }
    let (level, operator) = match expression {
        E::Otherwise(of, skip) if **skip == E::Skip => return (8, format!("{}?", inside(of, 8, members))),
        E::Run { member, .. } => {
            let member = usize::try_from(*member).ok().and_then(|slot| members.get(slot));
            return (9, member.map_or("?", |member| &member.name).to_owned());
        }
        E::Skip => return (9, "skip".to_owned()),
        E::Never => return (9, "never".to_owned()),
        E::Fail(why) => return (9, format!("fail(\"{why}\")")),
        E::Wait(time) => return (9, format!("wait({} s)", time.as_secs_f64())),
        E::AnyOf { count, of } | E::AtLeast { count, of } => {
            let word = if matches!(expression, E::AnyOf { .. }) { "any" } else { "at least" };
            let of = of.iter().map(|child| text(child, members).1).collect::<Vec<_>>();
            return (9, format!("{word} {count} of ({})", of.join(", ")));
        }
        E::Concurrent(_) => (0, ", "),
        E::FailFast(_) => (1, " & "),
        E::Disable(_) => (2, " # "),
        E::Sequence(..) => (3, " ; "),
        E::Otherwise(..) => (4, " else "),
        E::Conditional(..) => (5, " : "),
        E::Recurrent(..) => (5, " ;; "),
        E::Match(arms) => {
            let arms = arms.iter().map(|arm| self::arm(arm, members)).collect::<Vec<_>>();
            return (9, format!("match {{ {} }}", arms.join(", ")));
        }
        E::Shield { bound, of } => {
            let bound = bound.map_or(String::new(), |bound| format!("({} s)", bound.as_secs_f64()));
            return (6, format!("shield{bound} {}", inside(of, 6, members)));
        }
        E::Using { resources, of } => {
            return (6, format!("using({}) {}", resources.join(", "), inside(of, 6, members)));
        }
        E::Finally(first, second) => {
            return (3, format!("{} finally {}", inside(first, 4, members), inside(second, 4, members)));
        }
        E::Chart(chart) => return (9, format!("{} states", chart.chart.states.len().saturating_sub(1))),
        E::Catch { of, arms } => {
            let word = |arm: &CatchArm| arm.failure.as_ref().map_or_else(|| "else".to_owned(), Failure::to_string);
            let arm = |arm: &CatchArm| format!("{} => {}", word(arm), inside(&arm.body, 1, members));
            let arms = arms.iter().map(arm).collect::<Vec<_>>().join(", ");
            return (4, format!("{} else match {{ {arms} }}", inside(of, 4, members)));
        }
        E::Repeat { until, of } => {
            return (6, format!("repeat {} until {}", inside(of, 6, members), until.join(" | ")));
        }
        E::With { given, of } => return (8, format!("{} with {given}", inside(of, 8, members))),
        E::Named { name, of } => return (5, format!("{name} => {}", inside(of, 5, members))),
        E::Tagged { tag, of } => return (8, format!("{} as {tag}", inside(of, 8, members))),
        E::Asynchronous { source, pool } => {
            let one = pool.first().map_or(String::new(), |one| inside(one, 5, members));
            return (5, format!("{} ::[{}] {one}", inside(source, 6, members), pool.len()));
        }
    };
    let parts = expression.operands().into_iter().map(|child| match text(child, members) {
        (inner, text) if inner > level || level == 3 && inner == 3 => text,
        (_, text) => format!("({text})"),
    });
    (level, parts.collect::<Vec<_>>().join(operator))
}

/// Returns the text of an arm by an outcome. `found p => Q` gives the value of the outcome a name.
fn arm(arm: &Arm, members: &[Member]) -> String {
    let tag = arm.tag.as_deref().unwrap_or("else");
    if let Expression::Named { name, of } = &arm.body {
        return format!("{tag} {name} => {}", inside(of, 1, members));
    }
    format!("{tag} => {}", inside(&arm.body, 1, members))
}

/// Returns the text of an operand, in brackets if it binds less tightly than `level`.
fn inside(expression: &Expression, level: u8, members: &[Member]) -> String {
    match text(expression, members) {
        (own, text) if own >= level => text,
        (_, text) => format!("({text})"),
    }
}
