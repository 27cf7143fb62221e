//! Callers that wait until a transaction has reached their acknowledgement level.

use super::interface::{AckLevel, Answer, Effect};
use super::ledger::Ledger;
use crate::logic::version_vector::{Dot, ReplicaId};
use comms::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet};

/// The most tickets that wait. A later caller is answered at once that its transaction is pending.
const WAITING_MAX: usize = 1024;

/// The transaction that a caller waits for.
#[derive(Debug)]
pub(super) struct Waiting {
    /// The transaction.
    pub(super) dot: Dot,
    /// The level that the transaction has to reach.
    pub(super) level: AckLevel,
    /// When the caller gives up.
    pub(super) until: Time,
}

/// The waiting callers, by ticket.
#[derive(Debug, Default)]
pub(super) struct Tickets(BTreeMap<u64, Waiting>);

impl Tickets {
    pub(super) fn deadline(&self) -> Option<Time> {
        self.0.values().map(|waiting| waiting.until).min()
    }

    /// Makes a caller wait. Returns false if there are too many callers, or its time is already over.
    pub(super) fn wait(&mut self, now: Time, ticket: u64, waiting: Waiting) -> bool {
        let waits = self.0.len() < WAITING_MAX && waiting.until > now;
        if waits {
            self.0.insert(ticket, waiting);
        }
        waits
    }

    /// Answers the callers whose transactions have reached their level, or whose time is over.
    pub(super) fn settle(&mut self, now: Time, reached: impl Fn(Dot, &AckLevel) -> bool, effects: &mut Vec<Effect>) {
        self.0.retain(|ticket, Waiting { dot, level, until }| {
            let answer = if reached(*dot, level) {
                Answer::Reached(*dot)
            } else if *until <= now {
                Answer::Pending(*dot)
            } else {
                return true;
            };
            effects.push(Effect::Answer(*ticket, answer));
            false
        });
    }

    /// Gives new names to the transactions that callers wait for.
    pub(super) fn rename(&mut self, names: &BTreeMap<Dot, Dot>) {
        for Waiting { dot, .. } in self.0.values_mut() {
            *dot = names.get(dot).copied().unwrap_or(*dot);
        }
    }
}

/// Returns whether a transaction has reached a level, as far as this replica knows.
pub(super) fn has_reached(ledger: &Ledger, dot: Dot, level: &AckLevel) -> bool {
    let (me, dot) = (ledger.identity.origin(), ledger.contents().name_of(dot));
    let here = ledger.log().vector().contains(dot);
    let has = |origin: ReplicaId| origin == me || ledger.acks.acked(origin).is_some_and(|vector| vector.contains(dot));
    let robots = || {
        let reached = ledger.others().filter(|(origin, _)| has(*origin));
        reached.map(|(_, robot)| robot).collect::<BTreeSet<_>>()
    };
    here && match level {
        AckLevel::Local => true,
        AckLevel::Replicated(count) => {
            robots().iter().filter(|robot| **robot != ledger.identity.robot()).count() >= *count
        }
        AckLevel::On(names) => {
            let reached = robots();
            names.iter().all(|name| *name == ledger.identity.robot() || reached.contains(name.as_str()))
        }
        AckLevel::Everywhere => ledger.is_member() && ledger.others().all(|(origin, _)| has(origin)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn each_caller_hears_once_that_it_is_done_or_that_its_time_is_over() {
        let (mut tickets, mut effects) = (Tickets::default(), Vec::new());
        let dot = |seq| Dot { origin: ReplicaId::new(1), seq };
        let later = Time::ZERO + Duration::from_secs(1);
        let everywhere = |seq| Waiting { dot: dot(seq), level: AckLevel::Everywhere, until: later };
        assert!(!tickets.wait(later, 9, everywhere(9)), "its time is over");
        for ticket in 1..=3 {
            assert!(tickets.wait(Time::ZERO, ticket, everywhere(ticket)));
        }
        tickets.rename(&BTreeMap::from([(dot(2), dot(20))]));
        tickets.settle(Time::ZERO, |dot, _| dot.seq == 20, &mut effects);
        tickets.settle(later, |dot, _| dot.seq == 3, &mut effects);
        let answers: Vec<(u64, Answer)> = effects
            .into_iter()
            .map(|effect| {
                let Effect::Answer(ticket, answer) = effect else { panic!("{effect:?}") };
                (ticket, answer)
            })
            .collect();
        assert_eq!(
            answers,
            [(2, Answer::Reached(dot(20))), (1, Answer::Pending(dot(1))), (3, Answer::Reached(dot(3)))]
        );
        assert_eq!(tickets.deadline(), None);
    }

    #[test]
    fn no_more_wait_than_there_are_places() {
        let mut tickets = Tickets::default();
        let dot = Dot { origin: ReplicaId::new(1), seq: 1 };
        let until = Time::ZERO + Duration::from_secs(1);
        let waiting = (0..2 * WAITING_MAX as u64)
            .filter(|ticket| tickets.wait(Time::ZERO, *ticket, Waiting { dot, level: AckLevel::Local, until }));
        assert_eq!(waiting.count(), WAITING_MAX);
    }
}
