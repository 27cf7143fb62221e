//! The calls that wait for the loop of the called program. Their number is limited, they keep their order of arrival,
//! and each waits until its deadline.

use super::{CallId, ObjectError};
use crate::logic::time::Time;
use std::collections::{BTreeMap, VecDeque};

/// The most calls that wait.
pub const WAITING_MAX: usize = 256;
/// The most waiting calls of one session, so that one caller leaves room for others.
pub const PER_CALLER_MAX: usize = 64;

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
    /// Adds a call that has arrived.
    pub fn admit(&mut self, id: CallId, deadline: Time, call: T) -> Admission<T> {
        let share = self.shares.get(&id.session).copied().unwrap_or(0);
        if self.waiting.len() >= WAITING_MAX || share >= PER_CALLER_MAX {
            let waiting = if share >= PER_CALLER_MAX { share } else { self.waiting.len() };
            return Admission::TurnedAway(
                call,
                ObjectError::Busy { waiting: u32::try_from(waiting).unwrap_or(u32::MAX) },
            );
        }
        self.shares.insert(id.session.clone(), share + 1);
        self.waiting.push_back(Waiting { id, deadline, call });
        Admission::Admitted
    }

    /// Returns the call that has waited for longest.
    pub fn next(&mut self, now: Time) -> Option<Next<T>> {
        let Waiting { id, deadline, call } = self.waiting.pop_front()?;
        self.release(&id.session);
        Some(if deadline <= now { Next::Expired(call) } else { Next::Run(call) })
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
        Admit { session: u8, number: u64, deadline: u64 },
        Next,
        Cancel { session: u8, number: u64 },
        Pass(u64),
    }

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let step = prop_oneof![
            6 => (0_u8..6, 0_u64..50, 0_u64..200)
                .prop_map(|(session, number, deadline)| Step::Admit { session, number, deadline }),
            2 => Just(Step::Next),
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
            let (mut table, mut model, mut now) = (CallTable::default(), Vec::<(u8, u64, u64, usize)>::new(), 0);
            let id = |session: u8, number| CallId { session: session.to_string(), number };
            for (call, step) in steps.into_iter().enumerate() {
                match step {
                    Step::Pass(time) => now += time,
                    Step::Admit { session, number, deadline } => {
                        let own = model.iter().filter(|(other, ..)| *other == session).count();
                        let admission = table.admit(id(session, number), Time::from_nanos(deadline), call);
                        if own >= PER_CALLER_MAX || model.len() >= WAITING_MAX {
                            let busy = matches!(admission, Admission::TurnedAway(back, ObjectError::Busy { .. }) if back == call);
                            prop_assert!(busy);
                        } else {
                            prop_assert_eq!(admission, Admission::Admitted);
                            model.push((session, number, deadline, call));
                        }
                    }
                    Step::Next => {
                        let expected = (!model.is_empty()).then(|| model.remove(0)).map(|(.., deadline, call)| {
                            if deadline <= now { Next::Expired(call) } else { Next::Run(call) }
                        });
                        prop_assert_eq!(table.next(Time::from_nanos(now)), expected);
                    }
                    Step::Cancel { session, number } => {
                        let place = model.iter().position(|one| (one.0, one.1) == (session, number));
                        prop_assert_eq!(table.cancel(&id(session, number)), place.map(|place| model.remove(place).3));
                    }
                }
                prop_assert_eq!((table.len(), table.is_empty()), (model.len(), model.is_empty()));
                prop_assert!(table.len() <= WAITING_MAX);
            }
            while table.next(Time::ZERO).is_some() {}
            prop_assert!(table.shares.is_empty());
        }
    }
}
