//! Whether a program that has died is started again, and when.
//!
//! The first restart is immediate, since most programs that die work again after a restart. Before each later restart,
//! the pause doubles. A program that has died too often is given up, and its supervisor decides what follows. A robot
//! that waits for one of its programs does nothing, so this happens within seconds. If a spec gives `backoff`, the
//! pauses grow until a program has run for some time. Each such pause is shortened by a random share. So programs that
//! have died together from one cause are not restarted together.

use comms::logic::random::Random;
use comms::logic::time::Time;
use language::plan::{Backoff, Policy, Restart};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;

/// How often a program is started again within [`WINDOW`], at most.
pub const RESTARTS_MAX: u32 = 5;
/// The span of time in which restarts are counted.
pub const WINDOW: Duration = Duration::from_secs(60);
/// The pause before the second restart. It doubles with each further restart.
const PAUSE: Duration = Duration::from_millis(100);
/// A pause is shortened by a fifth times a random share. The share is in thousandths, and is below this number.
const SHARES: u64 = 1000;

/// How often one program was started again recently.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Restarts {
    rule: Restart,
    backoff: Option<Backoff>,
    /// The leaf of the program. It determines by how much its pauses are shortened.
    leaf: u32,
    recent: VecDeque<Time>,
    /// How often the program was started again since it last ran for [`WINDOW`].
    in_a_row: u32,
}

impl Restarts {
    /// Returns the restarts of the program of a leaf that has not died yet.
    pub(super) fn new(leaf: u32, policy: &Policy) -> Self {
        let (rule, backoff) = (policy.restart, policy.backoff);
        Self { rule, backoff, leaf, recent: VecDeque::new(), in_a_row: 0 }
    }

    /// Returns whether these are the restarts of another policy.
    pub(super) fn differ(&self, policy: &Policy) -> bool {
        (self.rule, self.backoff) != (policy.restart, policy.backoff)
    }

    /// Returns whether the program is ever started again.
    pub(super) fn are_allowed(&self) -> bool {
        self.rule != Restart::Temporary
    }

    /// Returns whether the program is started again even after it has done its work. A plain program shows this by exit code 0.
    pub(super) fn are_permanent(&self) -> bool {
        self.rule == Restart::Permanent
    }

    /// Notes that the program has died. Returns when it is to be started again; nothing if it is given up.
    pub(super) fn next(&mut self, now: Time) -> Option<Time> {
        if !self.are_allowed() {
            return None;
        }
        if self.recent.back().is_none_or(|at| now.since(*at) >= WINDOW) {
            self.in_a_row = 0;
        }
        while self.recent.front().is_some_and(|at| now.since(*at) >= WINDOW) {
            self.recent.pop_front();
        }
        let count = self.count();
        if count >= RESTARTS_MAX {
            return None;
        }
        let pause = match self.backoff {
            None => count.checked_sub(1).map_or(Duration::ZERO, |doublings| PAUSE * (1 << doublings)),
            Some(backoff) => self.shortened(backoff.pause(self.in_a_row)),
        };
        self.in_a_row = self.in_a_row.saturating_add(1);
        self.recent.push_back(now + pause);
        Some(now + pause)
    }

    /// Returns the pause, shortened by up to a fifth.
    fn shortened(&self, pause: Duration) -> Duration {
        let mut random = Random::new((u64::from(self.leaf) << 32) | u64::from(self.in_a_row));
        let share = u32::try_from(random.below(SHARES)).unwrap_or(0);
        pause - pause / 5 * share / 1000
    }

    /// Returns how often the program was started again recently.
    pub(super) fn count(&self) -> u32 {
        u32::try_from(self.recent.len()).unwrap_or(u32::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Time {
        Time::from_nanos(millis * 1_000_000)
    }

    fn restarts(leaf: u32, restart: Restart, backoff: Option<(u64, u64)>) -> Restarts {
        let backoff = backoff.map(|(first, longest)| Backoff {
            first: Duration::from_millis(first),
            longest: Duration::from_millis(longest),
        });
        Restarts::new(leaf, &Policy { restart, backoff, ..Policy::default() })
    }

    /// Returns the pauses of a program that dies as soon as it runs, in milliseconds, until it is given up. At most
    /// `count` pauses are returned.
    fn pauses(restarts: &mut Restarts, mut now: Time, count: usize) -> Vec<u128> {
        let mut pauses = Vec::new();
        while let Some(next) = restarts.next(now).filter(|_| pauses.len() < count) {
            pauses.push((next - now).as_millis());
            now = next;
        }
        pauses
    }

    #[test]
    fn pauses_double_until_it_is_given_up() {
        let mut restarts = restarts(0, Restart::Transient, None);
        assert_eq!(pauses(&mut restarts, at(0), 9), [0, 100, 200, 400, 800]);
        assert_eq!(restarts.count(), RESTARTS_MAX);
        assert_eq!(restarts.next(at(59_999)), None, "the first one was at 0");
        assert_eq!(restarts.next(at(60_000)), Some(at(60_800)));
        assert_eq!(restarts.next(at(200_000)), Some(at(200_000)), "all of that is long ago");
    }

    #[test]
    fn a_back_off_doubles_up_to_its_longest_a_little_less() {
        let found = pauses(&mut restarts(3, Restart::Transient, Some((1000, 8000))), at(0), 9);
        let bounds = [0, 1000, 2000, 4000, 8000].map(|pause| pause * 4 / 5..=pause);
        assert!(found.len() == 5 && bounds.iter().zip(&found).all(|(bound, pause)| bound.contains(pause)), "{found:?}");
        let again = pauses(&mut restarts(3, Restart::Transient, Some((1000, 8000))), at(0), 9);
        assert_eq!(again, found, "the same each time");
        let others = (0..50).map(|leaf| pauses(&mut restarts(leaf, Restart::Transient, Some((1000, 8000))), at(0), 9));
        let different: std::collections::BTreeSet<u128> = others.map(|pauses| pauses[1]).collect();
        assert!(different.len() > 25, "what died together is started again one after the other: {different:?}");
    }

    /// If restarts are so slow that five do not fall into a minute, the program is never given up.
    #[test]
    fn a_slow_back_off_never_gives_up_and_keeps_its_longest_pause() {
        let mut slow = restarts(0, Restart::Permanent, Some((10_000, 30_000)));
        let found = pauses(&mut slow, at(0), 1000);
        assert_eq!(found.len(), 1000);
        assert!(found[3..].iter().all(|pause| (24_000..=30_000).contains(pause)), "{found:?}");
        let died = *slow.recent.back().expect("it was started") + WINDOW;
        assert_eq!(slow.next(died), Some(died), "it has run for a minute: at once, as the first time");
        let died = died + (WINDOW - Duration::from_millis(1));
        assert!(slow.next(died).is_some_and(|at| (at - died).as_millis() >= 8000), "it has run for less");
    }

    #[test]
    fn a_program_that_dies_now_and_then_is_always_started_again() {
        for backoff in [None, Some((10, 3_600_000))] {
            let mut restarts = restarts(7, Restart::Permanent, backoff);
            let mut now = at(0);
            for death in 0..100 {
                let next = restarts.next(now);
                assert!(next.is_some(), "death {death}");
                now = next.unwrap_or(now) + Duration::from_secs(13);
            }
        }
    }

    #[test]
    fn without_the_policy_nothing_is() {
        assert_eq!(restarts(0, Restart::Temporary, Some((10, 10))).next(at(0)), None);
    }
}
