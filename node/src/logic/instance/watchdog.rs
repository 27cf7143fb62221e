//! How long a program may hang. Its shim measures that, because the shim also runs while the node does not.

use language::plan::{LeafKind, Policy, Watchdog};
use std::time::Duration;

/// How long a controller may give no sign of life, unless its policy says otherwise. A starved host gives each of its threads a
/// turn within some hundred milliseconds, so a loop that is well never takes as long.
pub const WATCHDOG: Duration = Duration::from_secs(5);
/// How long a program has to say hello, and a controller for each `Init`, unless its policy says otherwise.
pub const READY_WITHIN: Duration = Duration::from_secs(15);
/// A hung program has ended at the latest so long after its bound: its shim looks four times in a bound, and the kernel may
/// write a core dump for 2 s.
const HANG_MARGIN: Duration = Duration::from_secs(3);

/// Returns how long a controller has to say hello, and the shim of a plain program to be ready: that program begins later.
pub(super) fn start_within(kind: LeafKind, policy: &Policy) -> Duration {
    match kind {
        LeafKind::Controller => ready_within(policy),
        LeafKind::Plain => READY_WITHIN,
    }
}

/// Returns how long a program has to be ready, at its start and in each `Init`.
pub fn ready_within(policy: &Policy) -> Duration {
    policy.ready_within.unwrap_or(READY_WITHIN)
}

/// Returns the probation of a new program if `asked` was asked for: never shorter than the time to detect that it hangs
/// from its first calculation on, but none if none was asked for. The probation of a plain program begins before it is
/// ready.
pub fn probation(kind: LeafKind, policy: &Policy, asked: Duration) -> Duration {
    if asked.is_zero() {
        return asked;
    }
    let (bound, ready) = watched(kind, policy);
    let ready = ready.filter(|_| kind == LeafKind::Plain);
    let spans = bound.into_iter().chain(ready);
    let found = spans.map(|span| span + span / 4).reduce(|sum, span| sum + span);
    found.map_or(asked, |found| asked.max(found + HANG_MARGIN))
}

/// Returns how the shim watches a program: how long the program may give no sign of life, and how long it may prepare.
/// A plain program is watched only if its policy says so, since most do not send signs of life. A program that must not
/// be watched is watched only if its time to be ready is given.
pub fn watched(kind: LeafKind, policy: &Policy) -> (Option<Duration>, Option<Duration>) {
    match (kind, policy.watchdog) {
        (LeafKind::Controller, Watchdog::Usual) => (Some(WATCHDOG), Some(ready_within(policy))),
        (LeafKind::Controller, Watchdog::Within(bound)) => (Some(bound), Some(ready_within(policy))),
        (LeafKind::Plain, Watchdog::Within(bound)) => (Some(bound), policy.ready_within),
        (LeafKind::Controller | LeafKind::Plain, Watchdog::Never) | (LeafKind::Plain, Watchdog::Usual) => {
            (None, policy.ready_within)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn controllers_are_watched_unless_told_and_others_only_when_told() {
        let (bound, ready) = (Duration::from_millis(500), Duration::from_secs(3));
        let check = |watchdog, ready_within, controller, plain| {
            let policy = Policy { watchdog, ready_within, ..Policy::default() };
            let got = [LeafKind::Controller, LeafKind::Plain].map(|kind| watched(kind, &policy));
            assert_eq!(got, [controller, plain], "{policy:?}");
        };
        check(Watchdog::Usual, None, (Some(WATCHDOG), Some(READY_WITHIN)), (None, None));
        check(Watchdog::Usual, Some(ready), (Some(WATCHDOG), Some(ready)), (None, Some(ready)));
        check(Watchdog::Within(bound), None, (Some(bound), Some(READY_WITHIN)), (Some(bound), None));
        check(Watchdog::Never, None, (None, None), (None, None));
        check(Watchdog::Never, Some(ready), (None, Some(ready)), (None, Some(ready)));
    }

    #[test]
    fn a_probation_is_as_long_as_a_hang_takes_to_be_found() {
        let millis = Duration::from_millis;
        let check = |kind, watchdog, ready_within, expected| {
            let policy = Policy { watchdog, ready_within, ..Policy::default() };
            assert_eq!(probation(kind, &policy, millis(5000)), millis(expected), "{kind:?} {policy:?}");
        };
        check(LeafKind::Controller, Watchdog::Usual, None, 9250);
        assert_eq!(probation(LeafKind::Controller, &Policy::default(), Duration::ZERO), Duration::ZERO);
        check(LeafKind::Controller, Watchdog::Within(millis(400)), None, 5000);
        check(LeafKind::Controller, Watchdog::Never, Some(millis(20_000)), 5000);
        check(LeafKind::Plain, Watchdog::Usual, None, 5000);
        check(LeafKind::Plain, Watchdog::Within(millis(4000)), Some(millis(8000)), 18_000);
    }
}
