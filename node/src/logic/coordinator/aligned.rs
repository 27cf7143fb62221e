//! A start at one moment: the home compares the clocks of the hosts, and tells each host the moment on its own clock.
//!
//! ```text
//! home  ─ReadClock(asked)─▶ host      all hosts are connected; eight times, one after the other
//!       ◀─ClockRead(shown)─           read at some moment between question and answer
//!       ──GoAt(start)────▶            on the clock of the host
//! ```
//! These clocks start at the boot of a machine, so a wrong calendar does not matter. A host has read its clock at
//! some moment between the question and the answer. The home assumes the middle: the clock is ahead by
//! `shown - (asked + round trip / 2)`. The error is at most half the round trip. So the home uses the question with the
//! shortest round trip, as `dca clock` does.
//!
//! The start is late enough that the supervisors on all hosts have told their programs to run by then. A lost, repeated
//! or late message does not shift the start, because the message names a moment and not a duration.

use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// How often each host is asked.
const EXCHANGES: u32 = 8;
/// The least time from GO to the start of programs: supervisors activate them, and producers open their wires.
const LEAD: Duration = Duration::from_millis(100);
/// How many times the longest round trip is added to `LEAD`.
const LEAD_TRIPS: u32 = 4;
/// The longest time from GO to the start of programs.
const LEAD_MAX: Duration = Duration::from_millis(500);

/// The clocks of the other hosts of a deployment.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Clocks(BTreeMap<String, HostClock>);

/// The clock of a host.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct HostClock {
    answers: u32,
    /// The exchange with the shortest round trip.
    best: Option<Exchange>,
}

/// A question to a host, and the answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Exchange {
    pub(super) asked: Time,
    pub(super) shown: Time,
    pub(super) round_trip: Duration,
}

/// A start at one moment.
#[derive(Debug)]
pub(super) struct Aligned {
    /// How long after GO the start is.
    pub(super) lead: Duration,
    /// How much time there may be between the starts of two hosts.
    pub(super) within: Duration,
    /// The moment of the start, on the clock of each host.
    pub(super) on_hosts: BTreeMap<String, Time>,
}

impl Exchange {
    /// Converts a moment on the home's clock to the clock of this host.
    fn there(&self, here: Time) -> Time {
        let read = self.asked + self.round_trip / 2;
        if here >= read { self.shown + (here - read) } else { self.shown.before(read - here) }
    }
}

impl Clocks {
    /// Takes the answer of a host; returns whether the host has answered often enough.
    pub(super) fn read(&mut self, host: &str, exchange: Exchange) -> bool {
        let clock = self.0.entry(host.to_owned()).or_default();
        clock.answers += 1;
        if clock.best.is_none_or(|best| exchange.round_trip < best.round_trip) {
            clock.best = Some(exchange);
        }
        clock.answers >= EXCHANGES
    }

    /// Returns the moment of the start if the home says GO at `now`.
    pub(super) fn start(&self, home: Option<&str>, now: Time) -> Aligned {
        let known = || self.0.iter().filter_map(|(host, clock)| Some((host, clock.best?)));
        let mut trips: Vec<Duration> = known().map(|(_, exchange)| exchange.round_trip).collect();
        trips.sort_unstable_by(|a, b| b.cmp(a));
        let lead = (LEAD + LEAD_TRIPS * trips.first().copied().unwrap_or_default()).min(LEAD_MAX);
        let start = now + lead;
        let mut on_hosts: BTreeMap<String, Time> =
            known().map(|(host, exchange)| (host.clone(), exchange.there(start))).collect();
        on_hosts.extend(home.map(|home| (home.to_owned(), start)));
        // Each clock may be wrong by half its round trip, and two clocks may be wrong in different directions.
        Aligned { lead, within: trips.iter().take(2).sum::<Duration>() / 2, on_hosts }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::random::Random;

    /// The error of the moment is at most half the round trip. It does not matter when the host has read its clock
    /// between question and answer, nor which clock is ahead.
    #[test]
    fn a_moment_on_another_clock_is_as_exact_as_the_round_trip() {
        let mut random = Random::new(7);
        let at = |nanos: u64| Time::from_nanos(nanos);
        for _ in 0..10_000 {
            let asked = 10_000_000_000_000 + random.below(1_000_000_000);
            let bits = random.below(30);
            let round_trip = random.below(1 << bits);
            let read = asked + random.below(round_trip + 1);
            // The boot of the other machine was earlier or later than the home's boot, by this time.
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
