//! The clocks of the machine. Only this file reads a clock, and only here a thread waits for one.

mod kernel;
mod zone;

use crate::logic::time::Time;
use rustix::thread::set_current_timer_slack;
use rustix::time::{ClockId, clock_gettime};
use std::num::NonZeroU64;
use std::path::Path;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Returns the present time on this host. The clock counts while the host sleeps and is never set.
pub fn now() -> Time {
    since_origin(ClockId::Boottime)
}

/// Returns the time since 1970 on this host's calendar clock, for people. It may be wrong, and it may jump.
pub fn unix_time() -> Duration {
    Duration::from_nanos(since_origin(ClockId::Realtime).nanos())
}

/// Returns how many minutes local time is ahead of UTC at `millis`, milliseconds since 1970. The zone comes from the variable
/// `TZ`, or from `/etc/localtime`.
pub fn minutes_ahead(millis: u64) -> i64 {
    zone::minutes_ahead(millis)
}

/// How often both clocks are read at most, until one pair of reads is quick enough to count as one moment.
const READS_MAX: usize = 4;
/// The longest time for reading both clocks. A longer time shows that something has interrupted the reads.
const READ_WITHIN: Duration = Duration::from_micros(20);

/// Returns the time of the calendar clock at the origin of [`now`], since 1970. It changes only when the calendar clock is
/// set: corrections of its rate (slewing) apply to both clocks.
pub fn calendar_origin() -> Duration {
    let mut best = (Duration::MAX, Duration::ZERO);
    for _ in 0..READS_MAX {
        let (before, shown, after) = (now(), unix_time(), now());
        let took = after - before;
        if took < best.0 {
            best = (took, shown.saturating_sub(before.since(Time::ZERO) + took / 2));
        }
        if took <= READ_WITHIN {
            break;
        }
    }
    best.1
}

/// How far a calendar clock can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockQuality {
    /// A time service keeps it synchronised.
    Kept,
    /// The clock shows a date that may be right, but no service keeps it synchronised.
    Plausible,
    /// The clock shows a date that cannot be right: it has never been set.
    Unset,
}

/// The dates between which an unsynchronised clock may be right, as time since 1970. The lower one is 2024: no program of that
/// time could write what this program reads. The upper one is 2100.
const PLAUSIBLE: [Duration; 2] = [Duration::from_secs(1_704_067_200), Duration::from_secs(4_102_444_800)];

/// Returns how far this host's calendar clock can be trusted. The kernel reports whether chrony, ntpd, PTP or systemd keeps
/// the clock synchronised. Some containers forbid this system call; there, the file that systemd-timesyncd makes after a
/// synchronisation decides.
pub fn belief() -> ClockQuality {
    let kept = kernel::is_kept().unwrap_or_else(|| Path::new("/run/systemd/timesync/synchronized").exists());
    believe(kept, unix_time())
}

fn believe(kept: bool, shown: Duration) -> ClockQuality {
    match shown >= PLAUSIBLE[0] && shown < PLAUSIBLE[1] {
        true if kept => ClockQuality::Kept,
        true => ClockQuality::Plausible,
        false => ClockQuality::Unset,
    }
}

fn since_origin(clock: ClockId) -> Time {
    let read = clock_gettime(clock);
    // A clock that started at its origin is positive in both parts. A calendar clock before 1970 counts as 1970.
    let (seconds, nanos) = (u64::try_from(read.tv_sec).unwrap_or(0), u64::try_from(read.tv_nsec).unwrap_or(0));
    Time::from_nanos(seconds.saturating_mul(1_000_000_000).saturating_add(nanos))
}

/// Waits on tokio's timers, which are late by up to a millisecond or two; control loops use [`Wakeup`].
///
/// # Cancellation
/// Safe.
pub async fn sleep_until(until: Time) {
    tokio::time::sleep(until.since(now())).await;
}

/// Prepares the calling thread for waiting: the kernel wakes it at the deadline instead of up to 50 µs later.
pub fn make_punctual() {
    // The oldest kernels refuse; the thread then only wakes less punctually.
    if let Err(error) = set_current_timer_slack(NonZeroU64::new(1)) {
        tracing::debug!(%error, "timer slack stays as it was");
    }
}

/// Lets a dedicated thread wait for an absolute deadline or for another thread, whichever comes first.
#[derive(Debug, Default)]
pub struct Wakeup {
    pending: Mutex<bool>,
    condvar: Condvar,
}

/// Why a wait is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Woken {
    /// The deadline has come.
    Deadline,
    /// [`Wakeup::wake`] was called since the last wait.
    Called,
}

impl Wakeup {
    /// Ends the present wait, or the next one if there is none.
    pub fn wake(&self) {
        *self.pending.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.condvar.notify_one();
    }

    /// Waits until `until` at the longest; without a deadline until it is woken.
    pub fn wait(&self, until: Option<Time>) -> Woken {
        let mut pending = self.pending.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            if std::mem::take(&mut *pending) {
                return Woken::Called;
            }
            pending = match until.map(|until| until.since(now())) {
                None => self.condvar.wait(pending).unwrap_or_else(PoisonError::into_inner),
                Some(Duration::ZERO) => return Woken::Deadline,
                Some(left) => self.condvar.wait_timeout(pending, left).unwrap_or_else(PoisonError::into_inner).0,
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[test]
    fn time_does_not_go_back() {
        let times: Vec<Time> = (0..1000).map(|_| now()).collect();
        assert!(times.is_sorted());
        assert!(times[0] > Time::ZERO && unix_time() > Duration::from_secs(1_600_000_000));
    }

    /// The origin is only shown to people, so an error of a millisecond is allowed.
    #[test]
    fn the_origin_of_the_calendar_stays_where_it_is() {
        let origins: Vec<Duration> = (0..1000).map(|_| calendar_origin()).collect();
        let (first, last) = (origins.iter().min().unwrap(), origins.iter().max().unwrap());
        assert!(*last - *first < Duration::from_millis(5), "{first:?} to {last:?}");
        let shown = origins[0] + now().since(Time::ZERO);
        assert!(shown.abs_diff(unix_time()) < Duration::from_secs(1), "{shown:?}");
    }

    #[test]
    fn a_clock_is_believed_as_far_as_its_keeper_and_its_date_go() {
        let now = Duration::from_secs(1_795_255_200);
        assert_eq!(believe(true, now), ClockQuality::Kept);
        assert_eq!(believe(false, now), ClockQuality::Plausible);
        assert_eq!(
            believe(false, Duration::from_secs(5)),
            ClockQuality::Unset,
            "a board without a battery begins in 1970"
        );
        assert_eq!(believe(true, Duration::from_secs(5)), ClockQuality::Unset, "whoever keeps it there keeps it wrong");
        assert_ne!(belief(), ClockQuality::Unset, "the machine that runs this test has a date");
    }

    #[test]
    fn waits_for_the_deadline_and_no_less() {
        make_punctual();
        let wakeup = Wakeup::default();
        let until = now() + Duration::from_millis(2);
        assert_eq!(wakeup.wait(Some(until)), Woken::Deadline);
        assert!(now() >= until);
    }

    #[test]
    fn a_call_is_never_missed() {
        let wakeup = Arc::new(Wakeup::default());
        wakeup.wake();
        assert_eq!(wakeup.wait(None), Woken::Called);
        let other = Arc::clone(&wakeup);
        let caller = std::thread::spawn(move || other.wake());
        assert_eq!(wakeup.wait(None), Woken::Called);
        caller.join().unwrap();
        assert_eq!(wakeup.wait(Some(now())), Woken::Deadline);
    }
}
