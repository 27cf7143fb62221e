//! A start at one moment: the home compares the clocks of the hosts, and tells each of them the moment on its own clock.
//!
//! ```text
//! home  ─ReadClock(asked)─▶ host      all hosts are connected; eight times, one after the other
//!       ◀─ClockRead(shown)─           read at some moment between question and answer
//!       ──GoAt(start)────▶            on the clock of the host
//! ```
//! The clocks are those that nobody sets, so a wrong calendar does not matter. A host has read its own at some moment between the
//! question and the answer: if it was the middle, it is ahead by `shown - (asked + round trip / 2)`, and wherever it was, that is wrong
//! by half the round trip at the most. So of several questions the one with the shortest round trip counts, as in `dca clock`.
//!
//! The moment is late enough that supervisors on all hosts have told their programs to run by then: orders and wires go from host to
//! host meanwhile. A word that is lost, repeated or late shifts nothing, since what is told is a moment and no span.

use super::{Coordinator, Phase};
use crate::logic::effect::Out;
use crate::logic::protocol::{Report, StartMode, ToParticipant};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// How often each host is asked.
const EXCHANGES: u32 = 8;
/// How long all hosts have to answer.
const READ_WITHIN: Duration = Duration::from_secs(10);
/// How long after GO programs begin at the least: supervisors activate them, and producers open their wires.
const LEAD: Duration = Duration::from_millis(100);
/// How many of the longest round trips are added to that.
const LEAD_TRIPS: u32 = 4;
/// How long after GO at the most.
const LEAD_MAX: Duration = Duration::from_millis(500);

/// The clocks of the hosts of a deployment, as far as they are known.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Aligning {
    is_begun: bool,
    clocks: BTreeMap<String, HostClock>,
}

/// The clock of a host.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct HostClock {
    answers: u32,
    /// The exchange with the shortest round trip.
    best: Option<Exchange>,
}

/// A question to a host, and the answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Exchange {
    asked: Time,
    shown: Time,
    round_trip: Duration,
}

impl Exchange {
    /// Returns a moment of the home on the clock of the host.
    fn there(&self, here: Time) -> Time {
        let read = self.asked + self.round_trip / 2;
        if here >= read {
            self.shown + (here - read)
        } else {
            Time::ZERO + self.shown.since(Time::ZERO).saturating_sub(read - here)
        }
    }
}

impl Coordinator {
    /// Takes note of when the programs of its first step are to begin. On one host they do so at one moment in any case.
    pub fn starts(&mut self, start: StartMode) {
        let is_aligned = start == StartMode::Aligned && self.hosts.len() > 1;
        self.aligning = is_aligned.then(Aligning::default);
    }

    /// Returns whether nothing has to be known of clocks any more; asks the other hosts what theirs show, once all is linked.
    pub(super) fn clocks_are_read(&mut self, out: &mut Out<'_>) -> bool {
        let Some(aligning) = self.aligning.as_mut().filter(|aligning| !aligning.is_begun) else { return true };
        aligning.is_begun = true;
        let home = self.plan.home();
        self.waiting = self.hosts.iter().filter(|host| Some(host.as_str()) != home).cloned().collect();
        self.deadline = Some(out.now + READ_WITHIN);
        self.waiting.iter().for_each(|host| self.ask_clock(host, out));
        self.waiting.is_empty()
    }

    fn ask_clock(&self, host: &str, out: &mut Out<'_>) {
        out.send(host, self.deployment.to_participant(ToParticipant::ReadClock { asked: out.now }));
    }

    /// Takes the answer of a host.
    pub(super) fn clock_read(&mut self, from: &str, (asked, shown): (Time, Time), out: &mut Out<'_>) {
        if self.phase != Phase::Connecting || !self.waiting.contains(from) {
            return;
        }
        let Some(aligning) = self.aligning.as_mut().filter(|aligning| aligning.is_begun) else { return };
        let clock = aligning.clocks.entry(from.to_owned()).or_default();
        let exchange = Exchange { asked, shown, round_trip: out.now - asked };
        clock.answers += 1;
        clock.best = Some(
            clock.best.map_or(exchange, |best| if exchange.round_trip < best.round_trip { exchange } else { best }),
        );
        if clock.answers < EXCHANGES {
            return self.ask_clock(from, out);
        }
        self.waiting.remove(from);
        self.go_if_ready(out);
    }

    /// Returns the moment of the start on the clock of each host, and says how exact that is; nothing if each begins at once.
    pub(super) fn start_on_hosts(&mut self, out: &mut Out<'_>) -> BTreeMap<String, Time> {
        let Some(aligning) = &self.aligning else { return BTreeMap::new() };
        let known = aligning.clocks.iter().filter_map(|(host, clock)| Some((host, clock.best?)));
        let known: Vec<(&String, Exchange)> = known.collect();
        let mut trips: Vec<Duration> = known.iter().map(|(_, exchange)| exchange.round_trip).collect();
        trips.sort_unstable_by(|a, b| b.cmp(a));
        let lead = (LEAD + LEAD_TRIPS * trips.first().copied().unwrap_or_default()).min(LEAD_MAX);
        let start = out.now + lead;
        let mut on_hosts: BTreeMap<String, Time> =
            known.iter().map(|(host, exchange)| ((*host).clone(), exchange.there(start))).collect();
        on_hosts.extend(self.plan.home().map(|home| (home.to_owned(), start)));
        // Each may be wrong by half its round trip, two of them in different directions.
        let within = trips.iter().take(2).sum::<Duration>() / 2;
        self.report(Report::Aligned { lead, within }, out);
        on_hosts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::random::Random;

    /// Wherever between question and answer the host has read its clock, and whichever clock is ahead, the moment is wrong by half the
    /// round trip at the most.
    #[test]
    fn a_moment_on_another_clock_is_as_exact_as_the_round_trip() {
        let mut random = Random::new(7);
        let at = |nanos: u64| Time::from_nanos(nanos);
        for _ in 0..10_000 {
            let asked = 10_000_000_000_000 + random.below(1_000_000_000);
            let bits = random.below(30);
            let round_trip = random.below(1 << bits);
            let read = asked + random.below(round_trip + 1);
            // The other machine has booted earlier or later by so much.
            let (booted, is_ahead) = (random.below(9_000_000_000_000), random.below(2) == 0);
            let there = |here: u64| if is_ahead { here + booted } else { here - booted };
            let exchange =
                Exchange { asked: at(asked), shown: at(there(read)), round_trip: Duration::from_nanos(round_trip) };
            let start = read + random.below(2_000_000_000) - 1_000_000_000;
            let (told, meant) = (exchange.there(at(start)), at(there(start)));
            let off = told.since(meant).max(meant.since(told));
            assert!(off <= Duration::from_nanos(round_trip / 2 + 1), "{off:?} of {round_trip} ns");
        }
    }
}
