//! The timers of an expression: pauses, limits and shields.

use super::{DEADLINE, Expression};
use std::time::Duration;

/// The shortest time that a supervisor waits for: a shorter `wait` takes as long.
pub const TIMER_LEAST: Duration = Duration::from_millis(10);

/// The purpose of a timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimerKind {
    /// `wait(5 s)`, or the pause of a `retry`: the expression waits.
    Pause,
    /// `P within 5 s`: P may take so long.
    Limit,
    /// `shield(5 s) P`: a stop waits for P, so long at most.
    Shield,
}

impl Expression {
    /// Returns the purpose of each timer, in the order in which a program numbers them.
    pub fn timers(&self) -> Vec<TimerKind> {
        let mut timers = Vec::new();
        self.add_timers(&mut timers);
        timers
    }

    fn add_timers(&self, timers: &mut Vec<TimerKind>) {
        if let Self::Sequence(clock, end) = self
            && is_deadline(clock, end)
        {
            return timers.push(TimerKind::Limit);
        }
        if let Self::Wait(_) = self {
            timers.push(TimerKind::Pause);
        }
        if let Self::Shield { bound: Some(_), .. } = self {
            timers.push(TimerKind::Shield);
        }
        self.operands().into_iter().for_each(|operand| operand.add_timers(timers));
    }
}

/// Whether two steps are the clock of a `within`, written out.
fn is_deadline(clock: &Expression, end: &Expression) -> bool {
    let is_reason = matches!(end, Expression::Fail(why) if why.starts_with(DEADLINE));
    is_reason && matches!(clock, Expression::Wait(_))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Options, Source, compile};

    #[test]
    fn a_limit_is_no_pause() {
        let text = "module Step(host) { done; }
            process main(){
                host{c1}
                instantiated_processes{ a instof Step(c1); b instof Step(c1); }
                internal_event_actions{ (a within 5 s) ; wait(2 s) ; shield(3 s) (b within 1 s) ; (wait(1 s) ; fail(\"no\")) }
            }";
        let plan = compile(&Source::new("a.dca", text), &[], &Options::named("a")).plan.unwrap();
        use TimerKind::{Limit, Pause, Shield};
        assert_eq!(plan.groups[0].expression.timers(), [Limit, Pause, Shield, Limit, Pause]);
    }
}
