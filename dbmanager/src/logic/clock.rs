//! The hybrid clock: timestamps that extend causality, and follow the wall clock as far as that can be trusted.
//!
//! *State.* The largest timestamp issued or seen, and the best date that a peer with a trusted clock has recently
//! shown.
//!
//! *Rule.* A new timestamp is one tick above the largest known one. It is raised to the wall clock only if that is
//! trusted and not far ahead of better clocks. A timestamp is `(epoch, hlc, origin)`. `hlc` is one number: 48 bits of
//! milliseconds and a counter of 16 bits. So a full counter automatically carries into the milliseconds.
//!
//! *Why it is right.* Each timestamp is larger than all that its replica has issued or seen, for any wall clock. A
//! replica that sees a transaction has seen its timestamp. So `a` before `b` in causality means `stamp(a) < stamp(b)`
//! (I11). Timestamps order writes that did not see each other, and nothing else. A wrong date can
//! make a write lose against a concurrent write. Such a pair is listed as a conflict. But a wrong
//! date can never hide a write from a client that has seen it. Therefore no date is refused: a
//! replica that refused a transaction that others accept would differ from them for ever. In a team
//! with keys, replicas reject timestamps that no correct replica could have issued
//! (`replica::authors`); all replicas decide alike.

use crate::logic::version_vector::ReplicaId;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How far the wall clock may be ahead of better clocks. If it is further ahead, timestamps do not follow it.
const LEAD_MAX_MS: u64 = 3_600_000;
/// How long the date of a peer is remembered.
const REFERENCE_AGE_MAX: Duration = Duration::from_secs(86_400);
/// The last date up to which timestamps follow a wall clock, in milliseconds since 1970: the year 2200. After it,
/// timestamps grow only by ticks, which cannot be used up.
pub const DATE_MAX_MS: u64 = 7_258_118_400_000;
/// Bits of the counter within a millisecond.
const COUNTER_BITS: u32 = 16;

/// How far a wall clock can be trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Quality {
    /// The clock was not set.
    #[default]
    Unset,
    /// The clock shows a date that may be right, for example from a battery-backed clock, but no service keeps it
    /// synchronised.
    Battery,
    /// Kept in step by NTP or PTP.
    Network,
    /// Kept in step by a satellite receiver.
    Satellite,
}

/// A reading of a wall clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wall {
    /// Milliseconds since 1970.
    pub millis: u64,
    /// How far the clock can be trusted.
    pub quality: Quality,
}

/// The position of a transaction in the total order of all transactions. Compared by epoch, then `hlc`, then origin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Timestamp {
    /// Increased when an operator repairs the clocks.
    pub epoch: u16,
    /// 48 bits of milliseconds, 16 bits of counter.
    pub hlc: u64,
    /// The replica that issued the timestamp.
    pub origin: ReplicaId,
}

impl Timestamp {
    /// Returns the next larger timestamp of the same origin.
    #[must_use]
    pub fn next(self) -> Self {
        match self.hlc.checked_add(1) {
            Some(hlc) => Self { hlc, ..self },
            None => Self { epoch: self.epoch.saturating_add(1), hlc: 0, ..self },
        }
    }

    /// Returns the milliseconds since 1970; correct as far as the clocks were right.
    pub fn millis(self) -> u64 {
        self.hlc >> COUNTER_BITS
    }
}

/// The clock of one replica.
#[derive(Clone, Debug)]
pub struct Clock {
    origin: ReplicaId,
    epoch: u16,
    last: u64,
    reference: Option<Reference>,
}

#[derive(Clone, Copy, Debug)]
struct Reference {
    wall: Wall,
    seen: Time,
}

impl Clock {
    /// Returns a clock that continues after `last`, the largest timestamp of the log.
    pub fn new(origin: ReplicaId, last: Timestamp) -> Self {
        Self { origin, epoch: last.epoch, last: last.hlc, reference: None }
    }

    /// Issues the next timestamp. `None` if no timestamp is left, which only a forged timestamp can cause.
    pub fn tick(&mut self, now: Time, wall: Wall) -> Option<Timestamp> {
        let lift = if self.follows(now, wall) { wall.millis.checked_mul(1 << COUNTER_BITS).unwrap_or(0) } else { 0 };
        let next = match self.last.checked_add(1) {
            Some(next) => next,
            None => {
                self.epoch = self.epoch.checked_add(1)?;
                1
            }
        };
        self.last = next.max(lift);
        Some(Timestamp { epoch: self.epoch, hlc: self.last, origin: self.origin })
    }

    /// Notes a timestamp that another replica issued, and the wall clock of that replica.
    pub fn observe(&mut self, now: Time, stamp: Timestamp, wall: Wall) {
        let seen = (stamp.epoch, stamp.hlc);
        (self.epoch, self.last) = (self.epoch, self.last).max(seen);
        if wall.quality < Quality::Network {
            return;
        }
        let better = |known: &Reference| {
            let fresh = now.since(known.seen) < REFERENCE_AGE_MAX;
            !fresh || (wall.quality, wall.millis) >= (known.wall.quality, known.wall.millis)
        };
        if self.reference.as_ref().is_none_or(better) {
            self.reference = Some(Reference { wall, seen: now });
        }
    }

    /// Continues under another origin.
    pub fn move_to(&mut self, origin: ReplicaId) {
        self.origin = origin;
    }

    /// Begins a new epoch. Later timestamps are above all others, and near the wall clock again.
    ///
    /// Returns false if no epoch was left.
    pub fn heal(&mut self) -> bool {
        let Some(epoch) = self.epoch.checked_add(1) else { return false };
        (self.epoch, self.last, self.reference) = (epoch, 0, None);
        true
    }

    /// Returns how far `stamp` is ahead of a trusted wall clock, if this is suspicious.
    pub fn suspects(stamp: Timestamp, wall: Wall) -> Option<Duration> {
        let ahead = stamp.millis().saturating_sub(wall.millis);
        (wall.quality >= Quality::Network && ahead > LEAD_MAX_MS).then(|| Duration::from_millis(ahead))
    }

    fn follows(&self, now: Time, wall: Wall) -> bool {
        if wall.quality < Quality::Network || wall.millis > DATE_MAX_MS {
            return false;
        }
        let restrains = |known: &Reference| {
            let age = now.since(known.seen);
            let date = known.wall.millis.saturating_add(u64::try_from(age.as_millis()).unwrap_or(u64::MAX));
            let better = age < REFERENCE_AGE_MAX && known.wall.quality > wall.quality;
            better && wall.millis > date.saturating_add(LEAD_MAX_MS)
        };
        !self.reference.as_ref().is_some_and(restrains)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ME: ReplicaId = ReplicaId::new(1);
    const YEAR_2099_MS: u64 = 4_070_908_800_000;
    const YEAR_2026_MS: u64 = 1_790_000_000_000;

    fn wall(millis: u64, quality: Quality) -> Wall {
        Wall { millis, quality }
    }

    fn clock() -> Clock {
        Clock::new(ME, Timestamp::default())
    }

    #[test]
    fn clock_1970_boot() {
        let seen = Timestamp { epoch: 0, hlc: YEAR_2026_MS << 16, origin: ReplicaId::new(2) };
        let mut clock = Clock::new(ME, seen);
        let stamp = clock.tick(Time::ZERO, wall(5, Quality::Unset)).unwrap();
        assert!(stamp > seen && stamp.millis() == YEAR_2026_MS, "goes on from the log, not from 1970");
    }

    #[test]
    fn clock_2099_boot_then_heal() {
        let mut clock = clock();
        let ahead = clock.tick(Time::ZERO, wall(YEAR_2099_MS, Quality::Network)).unwrap();
        assert!(Clock::suspects(ahead, wall(YEAR_2026_MS, Quality::Network)).is_some());
        assert_eq!(
            Clock::suspects(ahead, wall(0, Quality::Unset)),
            None,
            "a clock that is not trusted suspects nobody"
        );
        let mut other = Clock::new(ReplicaId::new(2), Timestamp::default());
        other.observe(Time::ZERO, ahead, wall(YEAR_2099_MS, Quality::Network));
        let pinned = other.tick(Time::ZERO, wall(YEAR_2026_MS, Quality::Network)).unwrap();
        assert!(pinned > ahead && pinned.millis() == YEAR_2099_MS);
        assert!(other.heal());
        let healed = other.tick(Time::ZERO, wall(YEAR_2026_MS, Quality::Network)).unwrap();
        assert!(healed > pinned && healed.millis() == YEAR_2026_MS);
    }

    #[test]
    fn clock_steps_back_during_commit() {
        let mut clock = clock();
        let first = clock.tick(Time::ZERO, wall(1000, Quality::Network)).unwrap();
        let second = clock.tick(Time::ZERO, wall(10, Quality::Network)).unwrap();
        assert_eq!((second.millis(), second.hlc), (1000, first.hlc + 1));
    }

    #[test]
    fn hlc_counter_overflow() {
        let mut clock = clock();
        let first = clock.tick(Time::ZERO, wall(7, Quality::Network)).unwrap();
        let mut last = first;
        for _ in 0..70_000 {
            let next = clock.tick(Time::ZERO, wall(7, Quality::Network)).unwrap();
            assert!(next > last);
            last = next;
        }
        assert_eq!(last.millis(), 8);
    }

    #[test]
    fn a_worse_clock_does_not_run_ahead_of_a_better_one() {
        let mut clock = clock();
        clock.observe(Time::ZERO, Timestamp::default(), wall(YEAR_2026_MS, Quality::Satellite));
        let pending = clock.tick(Time::ZERO, wall(YEAR_2099_MS, Quality::Network)).unwrap();
        assert_eq!(pending.millis(), 0);
        let equal = clock.tick(Time::ZERO, wall(YEAR_2099_MS, Quality::Satellite)).unwrap();
        assert_eq!(equal.millis(), YEAR_2099_MS);
    }

    #[test]
    fn the_date_of_a_better_clock_goes_on() {
        let mut clock = clock();
        clock.observe(Time::ZERO, Timestamp::default(), wall(YEAR_2026_MS, Quality::Satellite));
        let (later, now) = (Duration::from_secs(7200), wall(YEAR_2026_MS + 7_200_000, Quality::Network));
        let stamp = clock.tick(Time::ZERO + later, now).unwrap();
        assert_eq!(stamp.millis(), YEAR_2026_MS + 7_200_000, "two hours later it is two hours later for both");
    }

    #[test]
    fn forged_stamps_use_up_the_epochs_and_then_commits_fail() {
        let mut clock = clock();
        clock.observe(Time::ZERO, Timestamp { epoch: 3, hlc: u64::MAX, origin: ME }, Wall::default());
        assert_eq!(clock.tick(Time::ZERO, Wall::default()).map(|stamp| (stamp.epoch, stamp.hlc)), Some((4, 1)));
        clock.observe(Time::ZERO, Timestamp { epoch: u16::MAX, hlc: u64::MAX, origin: ME }, Wall::default());
        assert_eq!(clock.tick(Time::ZERO, Wall::default()), None);
        assert!(!clock.heal());
    }

    proptest! {
        #[test]
        fn stamps_grow_whatever_the_wall_says(walls in proptest::collection::vec((any::<u64>(), 0..4_u8), 1..50)) {
            let mut clock = clock();
            let mut last = Timestamp::default();
            for (millis, quality) in walls {
                let quality = [Quality::Unset, Quality::Battery, Quality::Network, Quality::Satellite][usize::from(quality)];
                let next = clock.tick(Time::ZERO, wall(millis, quality)).unwrap();
                prop_assert!(next > last);
                last = next;
            }
        }
    }
}
