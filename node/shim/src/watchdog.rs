//! Whether a program hangs: it gives no sign of life for too long, or prepares for too long.
//!
//! Only time in which the watcher ran is counted. If the watcher itself was late, because the host slept,
//! was suspended or is overloaded, the program gets a new bound. A false alarm costs a mission, and a late
//! alarm costs only some seconds. If a watcher is late every time, it has had many turns while the
//! program had none. Then this time is also counted.

use comms::logic::time::Time;
use shim::protocol::{EndReason, WatchdogBounds};
use std::time::Duration;

/// How many looks there are in a bound.
const LOOKS: u32 = 4;
/// The shortest time between two looks.
const LOOK_MIN: Duration = Duration::from_millis(1);
/// After this many late looks in a row, late looks count as well.
const LATE_MAX: u32 = 8;

/// The watcher of one program.
#[derive(Debug)]
pub(crate) struct Watchdog {
    bounds: WatchdogBounds,
    step: Duration,
    looked_at: Time,
    /// How long it has been silent; none before its first sign of life.
    silent: Option<Duration>,
    preparation: Option<Preparation>,
    /// How many looks in a row were late.
    late: u32,
}

/// The program's start, or one `Init`.
#[derive(Debug)]
struct Preparation {
    /// The number of the `Init`; none for the start.
    number: Option<u64>,
    elapsed: Duration,
}

impl Watchdog {
    /// Returns the watcher of a program that begins now; none if nothing is to be watched. If `from_start` is set,
    /// signs of life and readiness are expected from now on, else from the first sign on.
    pub(crate) fn new(bounds: WatchdogBounds, from_start: bool, now: Time) -> Option<Self> {
        let step = (bounds.shortest()? / LOOKS).max(LOOK_MIN);
        Some(Self {
            bounds,
            step,
            looked_at: now,
            silent: from_start.then_some(Duration::ZERO),
            preparation: from_start.then_some(Preparation { number: None, elapsed: Duration::ZERO }),
            late: 0,
        })
    }

    /// Returns when [`Watchdog::look`] wants to be called.
    pub(crate) fn next_look(&self) -> Time {
        self.looked_at + self.step
    }

    /// Takes a datagram of the program: `WATCHDOG=1`, `X_INIT=7` while its 7th round is an `Init`, `READY=1`. Source:
    /// sd_notify(3).
    pub(crate) fn hear(&mut self, text: &str, now: Time) {
        self.pass(now);
        for line in text.lines() {
            let init = line.strip_prefix("X_INIT=").and_then(|number| number.parse().ok());
            if line == "WATCHDOG=1" || init.is_some() {
                self.silent = Some(Duration::ZERO);
                self.late = 0;
            }
            match (&self.preparation, init) {
                (Some(Preparation { number, .. }), Some(_)) if *number == init => {}
                (_, Some(_)) => self.preparation = Some(Preparation { number: init, elapsed: Duration::ZERO }),
                // A started program reports when it is ready. If a program only runs its `Init`, a
                // sign of life without `X_INIT` shows that the `Init` is over.
                (Some(Preparation { number: Some(_), .. }), None) if line == "WATCHDOG=1" => self.preparation = None,
                // From here on, the time without a sign of life is measured.
                _ if line == "READY=1" => {
                    (self.preparation, self.silent) = (None, self.silent.map(|_| Duration::ZERO));
                }
                _ => {}
            }
        }
    }

    /// Returns why the program must be ended now. None if it may continue.
    pub(crate) fn look(&mut self, now: Time) -> Option<EndReason> {
        self.pass(now);
        // A start with its own time limit may use it.
        let WatchdogBounds { silence, ready_within } = self.bounds;
        let starts =
            ready_within.is_some() && self.preparation.as_ref().is_some_and(|preparation| preparation.number.is_none());
        let late = silence.filter(|bound| !starts && self.silent.is_some_and(|silent| silent >= *bound));
        let prepares = |within: &Duration| self.preparation.as_ref().is_some_and(|one| one.elapsed >= *within);
        let slow = ready_within.filter(prepares);
        slow.map(EndReason::StartTimeout).or(late.map(EndReason::Watchdog))
    }

    /// Gives a new bound, as to a program that a debugger holds.
    pub(crate) fn forgive(&mut self) {
        self.silent = self.silent.map(|_| Duration::ZERO);
        if let Some(preparation) = &mut self.preparation {
            preparation.elapsed = Duration::ZERO;
        }
    }

    /// Counts the time since the last look, unless this look is late by chance.
    fn pass(&mut self, now: Time) {
        let elapsed = now - self.looked_at;
        self.looked_at = now;
        self.late = if elapsed > 2 * self.step { self.late + 1 } else { 0 };
        if (1..=LATE_MAX).contains(&self.late) {
            return self.forgive();
        }
        self.silent = self.silent.map(|silent| silent + elapsed);
        if let Some(preparation) = &mut self.preparation {
            preparation.elapsed += elapsed;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUND: Duration = Duration::from_millis(400);
    const READY: Duration = Duration::from_millis(1000);
    const HUNG: EndReason = EndReason::Watchdog(BOUND);
    const SLOW: EndReason = EndReason::StartTimeout(READY);

    /// A watcher that looks when it wants to, on virtual time in milliseconds.
    struct World {
        watchdog: Watchdog,
        now: u64,
    }

    impl World {
        fn new(silence: Option<Duration>, ready_within: Option<Duration>, from_start: bool) -> Self {
            let bounds = WatchdogBounds { silence, ready_within };
            let watchdog = Watchdog::new(bounds, from_start, Time::ZERO).unwrap();
            Self { watchdog, now: 0 }
        }

        fn at(&self) -> Time {
            Time::from_nanos(self.now * 1_000_000)
        }

        /// Passes time without a sign of life; returns after how many milliseconds the program is ended, and why.
        fn pass(&mut self, millis: u64) -> Option<(u64, EndReason)> {
            let (began, until) = (self.now, self.now + millis);
            while self.now < until {
                self.now += 1;
                if self.at() >= self.watchdog.next_look()
                    && let Some(why) = self.watchdog.look(self.at())
                {
                    return Some((self.now - began, why));
                }
            }
            None
        }

        fn hear(&mut self, text: &str) {
            self.watchdog.hear(text, self.at());
        }

        /// The host sleeps, or the watcher is suspended.
        fn jump(&mut self, millis: u64) -> Option<EndReason> {
            self.now += millis;
            self.watchdog.look(self.at())
        }
    }

    #[test]
    fn a_program_that_falls_silent_is_ended_after_its_bound() {
        let mut world = World::new(Some(BOUND), None, false);
        assert_eq!(world.pass(10_000), None, "it has not begun to speak: an older one never does");
        for _ in 0..50 {
            world.hear("WATCHDOG=1");
            assert_eq!(world.pass(399), None);
        }
        world.hear("WATCHDOG=1");
        assert_eq!(world.pass(10_000), Some((400, HUNG)));
        let mut world = World::new(Some(BOUND), None, true);
        assert_eq!(world.pass(10_000), Some((400, HUNG)), "it was to speak from the beginning");
    }

    #[test]
    fn an_init_has_a_bound_of_its_own() {
        let mut world = World::new(Some(BOUND), Some(READY), false);
        let mut init = |number: u64, count: u64| {
            for _ in 0..count {
                world.hear(&format!("X_INIT={number}"));
                let ended = world.pass(100);
                if ended.is_some() {
                    return ended.map(|(_, why)| why);
                }
            }
            None
        };
        assert_eq!(init(3, 9), None);
        assert_eq!(init(5, 9), None, "another one");
        assert_eq!(init(5, 1), Some(SLOW));
        world.hear("WATCHDOG=1");
        assert_eq!(world.pass(10_000), Some((400, HUNG)), "it is over");
        world.hear("X_INIT=7");
        assert_eq!(world.pass(10_000), Some((400, HUNG)), "suspended in it");
    }

    #[test]
    fn a_program_that_is_to_say_when_it_is_ready_says_so() {
        let mut world = World::new(None, Some(READY), true);
        world.hear("WATCHDOG=1\nSTATUS=loading");
        assert_eq!(world.pass(10_000), Some((1000, SLOW)));
        let mut world = World::new(None, Some(READY), true);
        world.hear("STATUS=here\nREADY=1\n");
        assert_eq!(world.pass(10_000), None);
        // With a watchdog as well, the time without a sign of life is measured from when it is ready.
        assert_eq!(World::new(Some(BOUND), Some(READY), true).pass(10_000), Some((1000, SLOW)));
        let mut world = World::new(Some(BOUND), Some(READY), true);
        assert_eq!(world.pass(900), None);
        world.hear("READY=1");
        assert_eq!(world.pass(10_000), Some((400, HUNG)));
    }

    #[test]
    fn time_that_nobody_has_watched_does_not_count() {
        let mut world = World::new(Some(BOUND), Some(READY), false);
        world.hear("WATCHDOG=1");
        assert_eq!(world.pass(399), None);
        for _ in 0..10 {
            assert_eq!(world.jump(3_600_000), None, "the host slept");
            assert_eq!(world.pass(399), None);
        }
        assert_eq!(world.pass(1), Some((1, HUNG)), "a whole bound was witnessed");
        world.hear("X_INIT=1");
        assert_eq!(world.jump(3_600_000), None);
        world.watchdog.forgive();
        assert_eq!(world.pass(399), None, "a debugger holds it");
    }

    #[test]
    fn a_watcher_that_is_late_every_time_still_finds_a_hang() {
        let mut world = World::new(Some(BOUND), None, false);
        world.hear("WATCHDOG=1");
        let looks = (1..).find(|_| world.jump(250) == Some(HUNG));
        assert_eq!(looks, Some(LATE_MAX + 2));
        let mut world = World::new(Some(BOUND), None, false);
        for _ in 0..100 {
            world.hear("WATCHDOG=1");
            assert_eq!(
                [world.jump(250), world.jump(250)],
                [None, None],
                "it gives signs of life, as late as all others"
            );
        }
    }

    #[test]
    fn nothing_to_watch_is_not_watched() {
        assert!(Watchdog::new(WatchdogBounds::default(), true, Time::ZERO).is_none());
    }
}
