//! How far the clock of another host is ahead of the clock here, and how large the error of this offset can be.
//!
//! The other clock was read at some moment between a question and its answer. If this was in the middle, the other
//! clock was ahead by `shown there - (shown here + round trip / 2)`. In any case, the error of this offset is at most
//! half the round trip. So of several questions, the question with the shortest round trip is used. This is the bound of
//! Cristian's algorithm.

use comms::logic::human::span;
use comms::logic::time::Time;
use node::logic::protocol::{ClockKeeping, ClockReading};
use node::logic::table::table;
use serde::Serialize;
use std::time::Duration;

/// How fast two synchronised clocks may drift apart, as a ratio: the kernel slews each by at most 500 ppm. Source: adjtimex(2).
const DRIFT_MAX: f64 = 0.001;
/// If two clocks differ by more than this, in seconds, one of them is reported as wrong.
const WRONG_FROM: f64 = 1.0;

/// One question to a host for the time of its clock, and the answer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exchange {
    /// When the question was sent, on the boot clock.
    pub(crate) asked: Time,
    /// The calendar time here when the question was sent, or slightly later.
    pub(crate) shown_here: Duration,
    /// When the answer arrived.
    pub(crate) answered: Time,
    /// The answer: the time that the other clock showed.
    pub(crate) there: ClockReading,
}

/// The clock of a host, as seen from here.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct HostClock {
    host: String,
    /// How many seconds the clock is ahead of the clock of this machine. Negative if it is behind.
    ahead: f64,
    /// The largest possible error of `ahead`, in seconds.
    error_max: f64,
    /// Whether the clock is synchronised.
    keeping: ClockKeeping,
    /// Whether neither clock was set between the questions.
    steady: bool,
}

impl Exchange {
    fn round_trip(&self) -> Duration {
        self.answered - self.asked
    }

    fn error_max(&self) -> f64 {
        self.round_trip().as_secs_f64() / 2.0
    }

    fn ahead(&self) -> f64 {
        let here = self.shown_here + self.round_trip() / 2;
        let difference = self.there.shown.abs_diff(here).as_secs_f64();
        if self.there.shown < here { -difference } else { difference }
    }

    /// Returns whether one offset of the clocks explains both exchanges.
    fn agrees(&self, other: &Self) -> bool {
        let apart = self.asked.since(other.asked).max(other.asked.since(self.asked));
        let may_differ = self.error_max() + other.error_max() + DRIFT_MAX * apart.as_secs_f64();
        // The tolerance covers the rounding of numbers around 10⁹ s.
        (self.ahead() - other.ahead()).abs() <= may_differ + 1e-6
    }
}

impl HostClock {
    /// Returns the result of exchanges with a host; nothing without an exchange.
    pub(crate) fn of(host: &str, exchanges: &[Exchange]) -> Option<Self> {
        let best = exchanges.iter().min_by_key(|exchange| exchange.round_trip())?;
        Some(Self {
            host: host.to_owned(),
            ahead: best.ahead(),
            error_max: best.error_max(),
            keeping: best.there.keeping,
            steady: exchanges.iter().all(|exchange| best.agrees(exchange)),
        })
    }

    /// Returns warnings for a person.
    pub(crate) fn warnings(&self) -> Vec<String> {
        let Self { host, ahead, error_max, keeping, steady } = self;
        let mut warnings = Vec::new();
        if *keeping == ClockKeeping::Unset {
            warnings
                .push(format!("warning: the clock of `{host}` shows a date that cannot be right: it was never set"));
        } else if ahead.abs() > error_max + WRONG_FROM {
            let (way, by) = (if *ahead > 0.0 { "ahead of" } else { "behind" }, seconds(ahead.abs()));
            warnings.push(format!(
                "warning: the clock of `{host}` is {by} {way} the clock of this machine: one of the clocks is wrong"
            ));
        }
        if !steady {
            warnings.push(format!("warning: the clock of `{host}` or of this machine was set during the comparison"));
        }
        warnings
    }
}

/// Returns a table for people. The hosts that could not be asked are at its end.
pub(crate) fn text(clocks: &[HostClock], unreachable: &[String]) -> String {
    let mut rows = vec![["HOST", "AHEAD", "ERROR AT MOST", "CLOCK"].map(str::to_owned).to_vec()];
    rows.extend(clocks.iter().map(|HostClock { host, ahead, error_max, keeping, .. }| {
        let sign = if *ahead < 0.0 { '-' } else { '+' };
        vec![host.clone(), format!("{sign}{}", seconds(ahead.abs())), seconds(*error_max), keeping.to_string()]
    }));
    rows.extend(unreachable.iter().map(|host| {
        let none = || "-".to_owned();
        vec![host.clone(), none(), none(), "does not answer".to_owned()]
    }));
    table(&rows)
}

fn seconds(seconds: f64) -> String {
    span(Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::random::Random;

    /// Returns an exchange with a host whose clock is ahead by `ahead` milliseconds. The link has these delays in microseconds.
    fn exchange(at: u64, ahead: i32, (there, back): (u64, u64)) -> Exchange {
        let began = Duration::from_secs(1_795_000_000);
        let here = |micros: u64| began + Duration::from_micros(at + micros);
        let read = here(there);
        let by = Duration::from_millis(u64::from(ahead.unsigned_abs()));
        let shown = if ahead < 0 { read.saturating_sub(by) } else { read + by };
        let moment = |micros: u64| Time::from_nanos((at + micros) * 1000);
        let there_reading = ClockReading { shown, keeping: ClockKeeping::Kept };
        Exchange { asked: moment(0), shown_here: here(0), answered: moment(there + back), there: there_reading }
    }

    #[test]
    fn the_true_offset_is_within_the_bound_whatever_the_delays_are() {
        let mut random = Random::new(7);
        for _ in 0..10_000 {
            let ahead = i32::try_from(random.below(4_000_000)).unwrap() - 2_000_000;
            let mut delay = || {
                let bits = random.below(21);
                random.below(1 << bits)
            };
            let delays: Vec<(u64, u64)> = (0..8).map(|_| (delay(), delay())).collect();
            let exchanges: Vec<Exchange> =
                (0..).zip(&delays).map(|(at, delays)| exchange(at * 3_000_000, ahead, *delays)).collect();
            let clock = HostClock::of("c2", &exchanges).unwrap();
            let least = delays.iter().map(|(there, back)| there + back).min().unwrap();
            assert!(
                (clock.error_max - Duration::from_micros(least).as_secs_f64() / 2.0).abs() < 1e-9,
                "the least round trip counts"
            );
            let off = (clock.ahead - f64::from(ahead) / 1e3).abs();
            assert!(off <= clock.error_max + 1e-6, "{clock:?}: {ahead} ms, {delays:?}");
            assert!(clock.steady, "{clock:?}: {ahead} ms, {delays:?}");
        }
    }

    #[test]
    fn a_clock_that_was_set_meanwhile_is_told() {
        let check = |second: i32, expected: bool| {
            let exchanges = [exchange(0, 0, (200, 200)), exchange(1000, second, (300, 300))];
            assert_eq!(HostClock::of("c2", &exchanges).map(|clock| clock.steady), Some(expected), "{second} ms");
        };
        [(0, true), (5, false), (-3_600_000, false)].into_iter().for_each(|(second, expected)| check(second, expected));
        assert_eq!(HostClock::of("c2", &[]), None);
    }

    #[test]
    fn a_wrong_clock_is_told_and_an_unset_one() {
        let wrong = HostClock::of("c2", &[exchange(0, -300_500, (1000, 1000))]).unwrap();
        let right = HostClock::of("c1", &[exchange(0, 0, (40, 60))]).unwrap();
        let mut board = exchange(0, 0, (100, 100));
        board.there = ClockReading { shown: Duration::from_secs(5), keeping: ClockKeeping::Unset };
        let board = HostClock::of("c3", &[board]).unwrap();
        let expected = [
            "HOST  AHEAD          ERROR AT MOST  CLOCK",
            "c1    -0.01 ms       0.05 ms        kept",
            "c2    -300.5 s       1 ms           kept",
            "c3    -1794999995 s  0.1 ms         not set",
            "c4    -              -              does not answer",
        ];
        let text = text(&[right.clone(), wrong.clone(), board.clone()], &["c4".to_owned()]);
        assert_eq!(text.lines().map(str::trim_end).collect::<Vec<_>>(), expected);
        assert_eq!(right.warnings(), [""; 0]);
        let behind =
            "warning: the clock of `c2` is 300.5 s behind the clock of this machine: one of the clocks is wrong";
        assert_eq!(wrong.warnings(), [behind]);
        assert!(board.warnings()[0].contains("it was never set"), "{board:?}");
    }
}
