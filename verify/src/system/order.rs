//! The order in which the timers of an expression elapse, as far as the text of the expression proves it.
//!
//! A supervisor measures a timer from the reaction in which it begins, and makes its timers elapse in the order of their due
//! times. Of two timers that are due together, the timer that began first elapses first. So if one timer begins with an
//! operator, and another one begins with the same operator or later, the first one elapses first if its time is not longer.
//! No other order is assumed: a supervisor may be late, and then times on a way do not add up.

use crate::system::zone::nanoseconds;
use language::plan::Expression;

/// For each timer of an expression, the timers that elapse before it if both are armed.
#[derive(Debug, Default)]
pub(super) struct Order(Vec<Vec<u32>>);

/// A timer of an expression.
#[derive(Clone, Copy, Debug)]
struct Timer {
    number: u32,
    /// In nanoseconds.
    time: u64,
    /// Whether the timer begins only in the reaction that starts the expression, at most once.
    is_first: bool,
}

/// Returns whether some timers of an expression elapse in a known order.
pub(crate) fn has_order(expression: &Expression) -> bool {
    Order::of(expression).is_some()
}

impl Order {
    /// Returns the order of the timers of an expression; none if no two of them have an order.
    pub(super) fn of(expression: &Expression) -> Option<Self> {
        let mut order = Self::default();
        order.read(expression);
        order.0.iter().any(|earlier| !earlier.is_empty()).then_some(order)
    }

    /// Returns the timers that elapse before a timer, if they are armed.
    pub(super) fn before(&self, timer: u32) -> &[u32] {
        self.0.get(timer as usize).map_or(&[], Vec::as_slice)
    }

    /// Notes the order of the timers in an expression, and returns these timers. They are numbered in the order of the text.
    fn read(&mut self, expression: &Expression) -> Vec<Timer> {
        match expression {
            Expression::Wait(time) => vec![self.add(nanoseconds(*time), true)],
            Expression::Shield { bound: Some(bound), of } => {
                let bound = self.add(nanoseconds(*bound), false);
                let inner = self.read(of);
                self.compare(&inner, &[bound]);
                [vec![bound], inner].concat()
            }
            Expression::Concurrent(of)
            | Expression::FailFast(of)
            | Expression::Disable(of)
            | Expression::AnyOf { of, .. }
            | Expression::AtLeast { of, .. } => {
                let mut all = Vec::new();
                for operand in of {
                    let own = self.read(operand);
                    self.compare(&all, &own);
                    all.extend(own);
                }
                all
            }
            // One arm starts together with the `match`.
            Expression::Match(arms) => arms.iter().flat_map(|arm| self.read(&arm.body)).collect(),
            Expression::Shield { bound: None, of }
            | Expression::Tagged { of, .. }
            | Expression::With { of, .. }
            | Expression::Named { of, .. } => self.read(of),
            Expression::Sequence(first, next)
            | Expression::Conditional(first, next)
            | Expression::Otherwise(first, next)
            | Expression::Finally(first, next) => {
                let first = self.read(first);
                [first, later(self.read(next))].concat()
            }
            Expression::Catch { of, arms } => {
                let first = self.read(of);
                let arms = arms.iter().flat_map(|arm| self.read(&arm.body)).collect();
                [first, later(arms)].concat()
            }
            // A `using` may wait, the operands of a loop start again, and an activity has zones.
            Expression::Using { .. }
            | Expression::Repeat { .. }
            | Expression::Recurrent(..)
            | Expression::Asynchronous { .. }
            | Expression::Chart(_)
            | Expression::Run { .. }
            | Expression::Skip
            | Expression::Never
            | Expression::Fail(_) => {
                later(expression.operands().into_iter().flat_map(|operand| self.read(operand)).collect())
            }
        }
    }

    fn add(&mut self, time: u64, is_first: bool) -> Timer {
        self.0.push(Vec::new());
        Timer { number: u32::try_from(self.0.len() - 1).unwrap_or(u32::MAX), time, is_first }
    }

    /// Notes the order between the timers of two operands that run at the same time. The first operand starts first.
    fn compare(&mut self, first: &[Timer], second: &[Timer]) {
        for one in first {
            for other in second {
                if one.is_first && one.time <= other.time {
                    self.0[other.number as usize].push(one.number);
                } else if other.is_first && other.time < one.time {
                    self.0[one.number as usize].push(other.number);
                }
            }
        }
    }
}

/// The timers of an expression that starts later than the expression around it, or several times.
fn later(timers: Vec<Timer>) -> Vec<Timer> {
    timers.into_iter().map(|timer| Timer { is_first: false, ..timer }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn wait(seconds: u64) -> Expression {
        Expression::Wait(Duration::from_secs(seconds))
    }

    fn after_a_step(expression: Expression) -> Expression {
        Expression::Sequence(Box::new(Expression::Run { member: 0, sets: Vec::new() }), Box::new(expression))
    }

    /// Returns the order as pairs: the earlier timer, the later timer.
    fn pairs(expression: &Expression) -> Vec<(u32, u32)> {
        let order = Order::of(expression).unwrap_or_default();
        let timers = 0..u32::try_from(order.0.len()).expect("few timers");
        timers
            .flat_map(|timer| order.before(timer).iter().map(move |earlier| (*earlier, timer)).collect::<Vec<_>>())
            .collect()
    }

    #[test]
    fn timers_that_begin_together_have_the_order_of_their_times() {
        assert_eq!(pairs(&Expression::Concurrent(vec![wait(5), wait(3)])), [(1, 0)]);
        assert_eq!(pairs(&Expression::Disable(vec![wait(3), wait(3)])), [(0, 1)]);
        // Both take 10 ms, the shortest time of a timer.
        let short = |ms| Expression::Wait(Duration::from_millis(ms));
        assert_eq!(pairs(&Expression::Concurrent(vec![short(9), short(1)])), [(0, 1)]);
    }

    #[test]
    fn a_timer_that_begins_later_and_takes_as_long_is_later() {
        assert_eq!(pairs(&Expression::Disable(vec![wait(3), after_a_step(wait(3))])), [(0, 1)]);
        assert_eq!(pairs(&Expression::Disable(vec![after_a_step(wait(5)), wait(3)])), [(1, 0)]);
        // The step may end in the reaction that starts both, and then the other timer begins first.
        assert_eq!(pairs(&Expression::Disable(vec![after_a_step(wait(3)), wait(3)])), []);
    }

    #[test]
    fn a_shorter_timer_that_begins_later_has_no_order() {
        assert_eq!(pairs(&Expression::Disable(vec![wait(5), after_a_step(wait(3))])), []);
        assert_eq!(pairs(&Expression::Disable(vec![after_a_step(wait(5)), after_a_step(wait(3))])), []);
    }

    #[test]
    fn a_timer_of_a_loop_has_no_order_with_a_longer_one() {
        let again = Expression::Recurrent(Box::new(wait(1)), Box::new(wait(2)));
        assert_eq!(pairs(&Expression::Disable(vec![again.clone(), wait(5)])), []);
        assert_eq!(pairs(&Expression::Disable(vec![wait(1), again])), [(0, 1), (0, 2)]);
    }

    #[test]
    fn the_bound_of_a_shield_begins_with_a_stop() {
        let shield = |bound| Expression::Shield { bound: Some(Duration::from_secs(bound)), of: Box::new(wait(3)) };
        assert_eq!(pairs(&shield(3)), [(1, 0)]);
        assert_eq!(pairs(&shield(2)), []);
    }
}
