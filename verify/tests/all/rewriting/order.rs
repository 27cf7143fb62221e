//! Which timer of a group elapses before another one: a second reading of the rule in the manual.

use language::plan::{Expression, TIMER_LEAST};
use std::time::Duration;

/// A timer, with the operators around it. Each operator has the place of the operand that contains the timer; the bound of a
/// `shield` has the last place.
struct Timer<'e> {
    time: Duration,
    way: Vec<(&'e Expression, usize)>,
}

const BOUND: usize = usize::MAX;

/// Keeps the armed timers that may elapse next.
pub(crate) fn keep_next(expression: &Expression, armed: &mut Vec<u32>) {
    let mut timers = Vec::new();
    gather(expression, &mut Vec::new(), &mut timers);
    let all = armed.clone();
    armed.retain(|own| !all.iter().any(|other| is_before(&timers[*other as usize], &timers[*own as usize])));
}

fn gather<'e>(expression: &'e Expression, way: &mut Vec<(&'e Expression, usize)>, timers: &mut Vec<Timer<'e>>) {
    if let Expression::Wait(time) = expression {
        timers.push(Timer { time: (*time).max(TIMER_LEAST), way: way.clone() });
    } else if let Expression::Shield { bound: Some(time), .. } = expression {
        let way = way.iter().copied().chain([(expression, BOUND)]).collect();
        timers.push(Timer { time: (*time).max(TIMER_LEAST), way });
    }
    for (place, operand) in expression.operands().into_iter().enumerate() {
        way.push((expression, place));
        gather(operand, way, timers);
        way.pop();
    }
}

/// Returns whether a timer elapses before another one that is armed at the same time. It begins together with the innermost operator
/// around both, and the other one cannot be due earlier.
fn is_before(one: &Timer<'_>, other: &Timer<'_>) -> bool {
    let is_same = |(one, other): &(&(&Expression, usize), &(&Expression, usize))| {
        std::ptr::eq(one.0, other.0) && one.1 == other.1
    };
    let shared = one.way.iter().zip(&other.way).take_while(is_same).count();
    let (Some((around, place)), Some((_, other_place))) = (one.way.get(shared), other.way.get(shared)) else {
        return false;
    };
    let is_shield = matches!(around, Expression::Shield { .. }) && *other_place == BOUND;
    let begins_at_once = |(operator, place): &(&Expression, usize)| match *place {
        BOUND => false,
        0 => is_parallel(operator) || starts_its_first(operator),
        _ => is_parallel(operator) || matches!(operator, Expression::Match(_)),
    };
    (is_parallel(around) || is_shield)
        && one.way[shared + 1..].iter().all(begins_at_once)
        && (one.time, *place) < (other.time, *other_place)
}

fn is_parallel(operator: &Expression) -> bool {
    matches!(
        operator,
        Expression::Concurrent(_)
            | Expression::FailFast(_)
            | Expression::Disable(_)
            | Expression::AnyOf { .. }
            | Expression::AtLeast { .. }
    )
}

/// Returns whether an operator starts its first operand together with itself, and only once.
fn starts_its_first(operator: &Expression) -> bool {
    !matches!(
        operator,
        Expression::Using { .. }
            | Expression::Repeat { .. }
            | Expression::Recurrent(..)
            | Expression::Asynchronous { .. }
            | Expression::Chart(_)
    )
}
