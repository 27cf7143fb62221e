//! All durations of a replica, in one place.

use std::time::Duration;

/// The shortest time between two hellos, used after a change.
pub(crate) const HELLO_PERIOD_MIN: Duration = Duration::from_secs(1);
/// The longest time between two hellos, while nothing changes.
pub(crate) const HELLO_PERIOD_MAX: Duration = Duration::from_secs(10);

/// How long to wait after a push that did not fit before its sender is asked: the previous push may be in transit.
pub(crate) const PULL_AFTER_PUSH: Duration = Duration::from_millis(50);
/// How late an answer to a pull may be and still count as a measurement of the link's delay.
pub(crate) const PULL_ANSWER_LATE_MAX: Duration = Duration::from_secs(10);
/// How long a peer is not asked after its first silence; each further silence makes this four times as long.
pub(crate) const PULL_PAUSE_MIN: Duration = Duration::from_millis(200);
/// The longest time for which a silent peer is not asked.
pub(crate) const PULL_PAUSE_MAX: Duration = Duration::from_millis(12_800);
/// After this many silences in a row, the longest pause applies.
pub(crate) const SILENCES_MAX: u32 = 4;

/// The shortest wait for a chunk of a state before it is requested again. Each repetition waits twice as long.
pub(crate) const CHUNK_WAIT_MIN: Duration = Duration::from_secs(2);
/// The longest wait for a chunk: twice its time on the slowest radio. A lost chunk looks like a slow one.
pub(crate) const CHUNK_WAIT_MAX: Duration = Duration::from_secs(20);
/// If the time between chunks is shorter than this, more of them are requested at a time.
pub(crate) const CHUNK_TIME_FAST: Duration = Duration::from_millis(250);
/// If a single chunk takes no longer than this, two at a time are tried: the link may have a long delay and still be fast.
pub(crate) const CHUNK_TIME_TRY: Duration = Duration::from_secs(4);
/// How often a chunk is requested again before the download is broken off.
pub(crate) const CHUNK_TRIES_MAX: u32 = 3;

/// How long the response to a pull may be in transit: the longest transaction over a radio of 50 kbit/s.
pub(crate) const PULL_WITHIN: Duration = Duration::from_secs(60);
/// How long a chunk of a state may be in transit: longer than any download waits for it.
pub(crate) const CHUNK_WITHIN: Duration = Duration::from_secs(30);

/// Returns how long a peer is not asked after `silences` unanswered pulls in a row, at least one.
pub(crate) fn pull_pause(silences: u32) -> Duration {
    PULL_PAUSE_MIN * (1 << (2 * (silences.clamp(1, SILENCES_MAX) - 1)))
}

const _: () = {
    const fn before(a: Duration, b: Duration) -> bool {
        a.as_nanos() < b.as_nanos()
    }
    assert!(before(HELLO_PERIOD_MIN, HELLO_PERIOD_MAX));
    assert!(before(PULL_AFTER_PUSH, PULL_PAUSE_MIN), "a pushed transaction arrives before a replica pauses its pulls");
    assert!(PULL_PAUSE_MIN.as_nanos() << (2 * (SILENCES_MAX - 1)) == PULL_PAUSE_MAX.as_nanos());
    assert!(before(PULL_ANSWER_LATE_MAX, PULL_WITHIN) && before(CHUNK_WAIT_MAX, CHUNK_WITHIN));
    assert!(before(CHUNK_TIME_FAST, CHUNK_WAIT_MIN) && before(CHUNK_WAIT_MIN, CHUNK_TIME_TRY));
    assert!(
        before(CHUNK_TIME_TRY, CHUNK_WAIT_MAX),
        "a chunk that takes so long may come over a fast link with a long delay"
    );
};
