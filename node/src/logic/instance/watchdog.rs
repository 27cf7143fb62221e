//! How long a program may hang. Its shim measures this, because the shim runs even when the node does not run.

use language::plan::{LeafKind, Policy, Watchdog};
use shim::protocol::WatchdogBounds;
use std::time::Duration;

/// How long a controller may give no sign of life, unless its policy gives another time. A starved host gives each of
/// its threads a turn within some hundred milliseconds. So a healthy loop never takes that long.
pub const WATCHDOG: Duration = Duration::from_secs(5);
/// How long a program has to say hello, and a controller to complete each `Init`, unless its policy gives another time.
pub const READY_WITHIN: Duration = Duration::from_secs(15);
/// How long a hung program takes at most to end, after its shim has noticed the hang: the kernel may write a core dump for
/// 2 s. The shim checks the program four times per bound. So it notices a hang within a quarter of the bound.
const HANG_MARGIN: Duration = Duration::from_secs(3);

/// Returns how long a controller has to say hello. For a plain program, returns how long its shim has to be ready,
/// because the program itself begins later.
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

/// Returns the probation of a new program, for a requested probation `asked`. It is long enough to detect that the
/// program hangs from its first calculation on. If no probation was requested, there is none. The probation of a plain
/// program begins before it is ready.
pub fn probation(kind: LeafKind, policy: &Policy, asked: Duration) -> Duration {
    if asked.is_zero() {
        return asked;
    }
    let WatchdogBounds { silence, ready_within } = watched(kind, policy);
    let spans = silence.into_iter().chain(ready_within.filter(|_| kind == LeafKind::Plain));
    let found = spans.map(|span| span + span / 4).reduce(|sum, span| sum + span);
    found.map_or(asked, |found| asked.max(found + HANG_MARGIN))
}

/// Returns how long the shim lets a program hang. Most plain programs send no signs of life, so a plain program is watched
/// for them only if its policy says so. If the policy forbids watching, the shim only watches the time to be ready, if
/// this time is given.
pub fn watched(kind: LeafKind, policy: &Policy) -> WatchdogBounds {
    let (silence, ready_within) = match (kind, policy.watchdog) {
        (LeafKind::Controller, Watchdog::Usual) => (Some(WATCHDOG), Some(ready_within(policy))),
        (LeafKind::Controller, Watchdog::Within(bound)) => (Some(bound), Some(ready_within(policy))),
        (LeafKind::Plain, Watchdog::Within(bound)) => (Some(bound), policy.ready_within),
        (LeafKind::Controller | LeafKind::Plain, Watchdog::Never) | (LeafKind::Plain, Watchdog::Usual) => {
            (None, policy.ready_within)
        }
    };
    WatchdogBounds { silence, ready_within }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn controllers_are_watched_unless_told_and_others_only_when_told() {
        let (bound, ready) = (Duration::from_millis(500), Duration::from_secs(3));
        let check = |watchdog, ready_within, controller, plain| {
            let policy = Policy { watchdog, ready_within, ..Policy::default() };
            let got = [LeafKind::Controller, LeafKind::Plain]
                .map(|kind| watched(kind, &policy))
                .map(|bounds| (bounds.silence, bounds.ready_within));
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
