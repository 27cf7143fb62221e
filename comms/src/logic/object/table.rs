//! The calls that wait for the loop of the called program. Their number is limited, they keep their order of arrival,
//! and each waits until its deadline. A call of a process that does not run waits for a moment until the process begins.

use super::{CallId, ObjectError};
use crate::logic::time::Time;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// The most calls that wait.
pub const WAITING_MAX: usize = 256;
/// The most waiting calls of one session, so that one caller leaves room for others.
pub const PER_CALLER_MAX: usize = 64;
/// How long the order to begin an activation may take. For so long a call waits for a process that does not run.
pub const BEGIN_WITHIN: Duration = Duration::from_secs(1);

/// Returns until when a call that comes at `now` waits for a process that does not run: for at most [`BEGIN_WITHIN`], and at most half
/// of the time that its caller has left.
pub fn begins_by(now: Time, deadline: Time) -> Time {
    now + BEGIN_WITHIN.min(deadline.since(now) / 2)
}

/// The calls that wait.
#[derive(Debug)]
pub struct CallTable<T> {
    waiting: VecDeque<Waiting<T>>,
    /// The number of waiting calls of each session.
    shares: BTreeMap<String, usize>,
}

#[derive(Debug)]
struct Waiting<T> {
    id: CallId,
    deadline: Time,
    /// Until when the call waits for the beginning of its process.
    begins_by: Time,
    call: T,
}

/// The answer to a call that arrives.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Admission<T> {
    /// The call waits.
    Admitted,
    /// The call does not wait. It is returned with the reason.
    TurnedAway(T, ObjectError),
}

/// The next call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Next<T> {
    /// The call has to be carried out.
    Run(T),
    /// The caller does not wait any longer, and the call was not carried out.
    Expired(T),
}

impl<T> Default for CallTable<T> {
    fn default() -> Self {
        Self { waiting: VecDeque::new(), shares: BTreeMap::new() }
    }
}

impl<T> CallTable<T> {
    /// Adds a call that arrives now.
    pub fn admit(&mut self, id: CallId, deadline: Time, now: Time, call: T) -> Admission<T> {
        let share = self.shares.get(&id.session).copied().unwrap_or(0);
        if self.waiting.len() >= WAITING_MAX || share >= PER_CALLER_MAX {
            let waiting = if share >= PER_CALLER_MAX { share } else { self.waiting.len() };
            return Admission::TurnedAway(
                call,
                ObjectError::Busy { waiting: u32::try_from(waiting).unwrap_or(u32::MAX) },
            );
        }
        self.shares.insert(id.session.clone(), share + 1);
        let begins_by = begins_by(now, deadline);
        self.waiting.push_back(Waiting { id, deadline, begins_by, call });
        Admission::Admitted
    }

    /// Returns the call that has waited for longest. A call that needs a running process, as `needs_run` says, waits for the beginning
    /// of its process, but not longer than [`begins_by`] says.
    pub fn next(&mut self, now: Time, needs_run: impl Fn(&T) -> bool) -> Option<Next<T>> {
        let is_due = |one: &Waiting<T>| one.begins_by <= now || !needs_run(&one.call);
        let place = self.waiting.iter().position(is_due)?;
        let Waiting { id, deadline, call, .. } = self.waiting.remove(place)?;
        self.release(&id.session);
        Some(if deadline <= now { Next::Expired(call) } else { Next::Run(call) })
    }

    /// Returns when the first of the waiting calls no longer waits for the beginning of its process.
    pub fn begins_by(&self) -> Option<Time> {
        self.waiting.iter().map(|one| one.begins_by).min()
    }

    /// Removes a cancelled call and returns it; none if it does not wait here.
    pub fn cancel(&mut self, id: &CallId) -> Option<T> {
        let place = self.waiting.iter().position(|waiting| waiting.id == *id)?;
        let waiting = self.waiting.remove(place)?;
        self.release(&waiting.id.session);
        Some(waiting.call)
    }

    /// Returns how many calls wait.
    pub fn len(&self) -> usize {
        self.waiting.len()
    }

    /// Returns whether no call waits.
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    fn release(&mut self, session: &str) {
        let Some(share) = self.shares.get_mut(session) else { return };
        *share -= 1;
        if *share == 0 {
            self.shares.remove(session);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Clone, Debug)]
    enum Step {
        Admit {
            session: u8,
            number: u64,
            deadline: u64,
        },
        /// The process runs, or calls with an even number need a run and have none.
        Next {
            runs: bool,
        },
        Cancel {
            session: u8,
            number: u64,
        },
        Pass(u64),
    }

    const BEGIN_WITHIN_NANOS: u64 = 1_000_000_000;

    #[derive(Debug)]
    struct Admitted {
        session: u8,
        number: u64,
        deadline: u64,
        begins_by: u64,
        call: usize,
    }

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let step = prop_oneof![
            6 => (0_u8..6, 0_u64..50, 0_u64..200)
                .prop_map(|(session, number, deadline)| Step::Admit { session, number, deadline }),
            2 => any::<bool>().prop_map(|runs| Step::Next { runs }),
            1 => (0_u8..6, 0_u64..50).prop_map(|(session, number)| Step::Cancel { session, number }),
            1 => (0_u64..20).prop_map(Step::Pass),
        ];
        prop::collection::vec(step, 0..1500)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        /// Compared with the simplest model: a list of all admitted calls with their ends.
        #[test]
        fn each_call_has_one_end_and_in_order(steps in steps()) {
            let (mut table, mut model, mut now) = (CallTable::default(), Vec::<Admitted>::new(), 0);
            let id = |session: u8, number| CallId { session: session.to_string(), number };
            for (call, step) in steps.into_iter().enumerate() {
                match step {
                    Step::Pass(time) => now += time,
                    Step::Admit { session, number, deadline } => {
                        let own = model.iter().filter(|one| one.session == session).count();
                        let admission = table.admit(id(session, number), Time::from_nanos(deadline), Time::from_nanos(now), call);
                        if own >= PER_CALLER_MAX || model.len() >= WAITING_MAX {
                            let busy = matches!(admission, Admission::TurnedAway(back, ObjectError::Busy { .. }) if back == call);
                            prop_assert!(busy);
                        } else {
                            prop_assert_eq!(admission, Admission::Admitted);
                            let begins_by = now + BEGIN_WITHIN_NANOS.min(deadline.saturating_sub(now) / 2);
                            model.push(Admitted { session, number, deadline, begins_by, call });
                        }
                    }
                    Step::Next { runs } => {
                        let place = model.iter().position(|one| runs || one.call % 2 == 1 || one.begins_by <= now);
                        let expected = place.map(|place| model.remove(place)).map(|Admitted { deadline, call, .. }| {
                            if deadline <= now { Next::Expired(call) } else { Next::Run(call) }
                        });
                        prop_assert_eq!(table.next(Time::from_nanos(now), |call| !runs && call % 2 == 0), expected);
                    }
                    Step::Cancel { session, number } => {
                        let place = model.iter().position(|one| (one.session, one.number) == (session, number));
                        prop_assert_eq!(table.cancel(&id(session, number)), place.map(|place| model.remove(place).call));
                    }
                }
                prop_assert_eq!((table.len(), table.is_empty()), (model.len(), model.is_empty()));
                prop_assert!(table.len() <= WAITING_MAX);
                let begins_by = model.iter().map(|one| one.begins_by).min();
                prop_assert_eq!(table.begins_by(), begins_by.map(Time::from_nanos));
            }
            while table.next(Time::ZERO, |_| false).is_some() {}
            prop_assert!(table.shares.is_empty());
        }
    }

    #[test]
    fn a_call_waits_for_an_activation_but_not_for_ever() {
        let now = Time::from_nanos(1_000_000_000);
        let id = |number| CallId { session: "s".to_owned(), number };
        let after = |millis| now + Duration::from_millis(millis);
        let mut table = CallTable::default();
        assert_eq!(table.admit(id(1), after(9_000), now, "long"), Admission::Admitted);
        assert_eq!(table.admit(id(2), after(100), now, "short"), Admission::Admitted);
        assert_eq!(table.admit(id(3), after(9_000), now, "state"), Admission::Admitted);
        assert_eq!(table.begins_by(), Some(after(50)));
        let idle = |call: &&str| *call != "state";
        assert_eq!(table.next(now, idle), Some(Next::Run("state")), "it needs no activation");
        assert_eq!(table.next(after(49), idle), None);
        assert_eq!(table.next(after(50), idle), Some(Next::Run("short")));
        assert_eq!(table.next(after(50), idle), None);
        assert_eq!(table.next(after(50), |_| false), Some(Next::Run("long")), "an activation runs");
        assert_eq!(table.admit(id(4), after(9_000), now, "gone"), Admission::Admitted);
        assert_eq!(table.cancel(&id(4)), Some("gone"));
        assert_eq!((table.next(now + BEGIN_WITHIN, idle), table.begins_by()), (None, None), "its caller has gone");
        (0..64).for_each(|number| assert_eq!(table.admit(id(number), after(9_000), now, "one"), Admission::Admitted));
        assert!(matches!(table.admit(id(64), after(9_000), now, "more"), Admission::TurnedAway("more", _)));
        assert_eq!(table.next(now + BEGIN_WITHIN, idle), Some(Next::Run("one")));
    }
}
