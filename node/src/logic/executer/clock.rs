//! The clock of a supervisor: its timers, and the time at which it reacts.
//!
//! The timers of an activity count from one another. If a timer runs out late, because the node was busy or away, the
//! activity reacts as if the timer had been on time, and new timers are measured from its due time. So the timers of an
//! activity run out in the order of their due times, with the same counts as in `dca sim`. `dca verify` relies on this
//! order.

use super::PACE;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The longest delay that is made up for. All timers move later by the rest of a longer delay. So a node that was away for
/// long does not have to carry out each tick of that time.
const MADE_UP: Duration = Duration::from_secs(10);

/// A timer that is set. Alarms run out in this order. Of two alarms that are due together, the alarm that began first runs
/// out first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(super) struct Alarm {
    due: Time,
    /// How many timers began before it.
    order: u64,
    pub(super) timer: u32,
    /// The number of its arming.
    pub(super) number: u32,
}

/// The timers of a supervisor.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Clock {
    alarms: BTreeSet<Alarm>,
    begun: u64,
    /// Whether timers count from one another.
    is_exact: bool,
    /// The time of the reaction that is being carried out.
    now: Time,
}

impl Clock {
    /// The group starts. It may be an activity.
    pub(super) fn start(&mut self, is_activity: bool) {
        self.is_exact = is_activity;
    }

    /// Returns when the first timer runs out.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.alarms.first().map(|alarm| alarm.due)
    }

    /// An event arrives that is not the end of a timer. Timers that are due and late have still to run out after it.
    pub(super) fn read(&mut self, now: Time) {
        self.catch_up(now);
        let due = self.deadline().filter(|_| self.is_exact);
        self.now = due.map_or(now, |due| due.min(now));
    }

    /// Takes the next timer that has run out.
    pub(super) fn ring(&mut self, now: Time) -> Option<Alarm> {
        self.catch_up(now);
        let alarm = *self.alarms.first().filter(|alarm| alarm.due <= now)?;
        self.alarms.remove(&alarm);
        self.now = if self.is_exact { alarm.due } else { now };
        Some(alarm)
    }

    /// Moves all timers later by the delay that is not made up for. Their order and distances stay.
    fn catch_up(&mut self, now: Time) {
        let Some(late) = self.deadline().map(|due| oldest(now).since(due)) else { return };
        if self.is_exact && !late.is_zero() {
            let alarms = std::mem::take(&mut self.alarms);
            self.alarms = alarms.into_iter().map(|alarm| Alarm { due: alarm.due + late, ..alarm }).collect();
        }
    }

    /// Sets a timer. Nothing is measured from before `start`.
    pub(super) fn arm(&mut self, timer: u32, number: u32, after: Duration, start: Time) {
        let (due, order) = (self.now.max(start) + after.max(PACE), self.begun);
        self.begun += 1;
        self.alarms.insert(Alarm { due, order, timer, number });
    }

    /// Forgets a timer.
    pub(super) fn cancel(&mut self, timer: u32, number: u32) {
        self.alarms.retain(|alarm| (alarm.timer, alarm.number) != (timer, number));
    }

    /// The timers have other numbers now. Timers that are not in `timers` are forgotten.
    pub(super) fn renumber(&mut self, timers: &BTreeMap<u32, u32>) {
        let alarms = std::mem::take(&mut self.alarms);
        let kept = alarms.into_iter().filter_map(|alarm| Some(Alarm { timer: *timers.get(&alarm.timer)?, ..alarm }));
        self.alarms = kept.collect();
    }
}

/// The earliest time that is made up for.
fn oldest(now: Time) -> Time {
    Time::ZERO + now.since(Time::ZERO + MADE_UP)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn at(ms: u64) -> Time {
        Time::from_nanos(ms * MS)
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// A clock on which timer 0 ticks every 100 ms from 0 on, and timer 1 runs out at 450 ms.
    fn ticking(is_activity: bool) -> Clock {
        let mut clock = Clock { is_exact: is_activity, ..Clock::default() };
        clock.read(at(0));
        clock.arm(1, 1, ms(450), Time::ZERO);
        clock.arm(0, 1, ms(100), Time::ZERO);
        clock
    }

    /// The timers that run out until `now`, the ticking one beginning again each time.
    fn rung(clock: &mut Clock, now: Time) -> Vec<u32> {
        let mut rung = Vec::new();
        while let Some(alarm) = clock.ring(now) {
            rung.push(alarm.timer);
            if alarm.timer == 0 {
                clock.arm(0, alarm.number + 1, ms(100), Time::ZERO);
            }
        }
        rung
    }

    #[test]
    fn late_ticks_of_an_activity_run_out_in_the_order_of_their_due_times() {
        let mut clock = ticking(true);
        assert_eq!(rung(&mut clock, at(137)), [0]);
        // The delay of 37 ms is not added to the next tick.
        assert_eq!(clock.deadline(), Some(at(200)));
        // The node was away: four ticks, one of them after the other timer.
        assert_eq!(rung(&mut clock, at(510)), [0, 0, 0, 1, 0]);
        assert_eq!(clock.deadline(), Some(at(600)));
    }

    #[test]
    fn a_plain_group_waits_from_now_on() {
        let mut clock = ticking(false);
        assert_eq!(rung(&mut clock, at(510)), [0, 1]);
        assert_eq!(clock.deadline(), Some(at(610)));
    }

    /// An hour would be 36,000 ticks.
    #[test]
    fn a_long_absence_is_made_up_for_in_part() {
        let mut clock = ticking(true);
        let ticks = rung(&mut clock, at(3_600_050));
        assert_eq!(ticks.len(), 102, "all timers are moved by the rest of the delay, and 10 s are made up for");
        assert!(clock.deadline() > Some(at(3_600_050)));
        // The other timer is due 350 ms after the first tick.
        assert_eq!(ticks[..6], [0, 0, 0, 0, 1, 0]);
    }

    #[test]
    fn an_event_after_a_long_absence_keeps_the_distances_of_timers() {
        let mut clock = ticking(true);
        clock.read(at(3_600_050));
        clock.arm(2, 1, ms(150), Time::ZERO);
        assert_eq!(rung(&mut clock, at(3_600_050))[..7], [0, 0, 2, 0, 0, 1, 0]);
    }

    #[test]
    fn an_event_before_a_late_timer_counts_as_not_later_than_it() {
        let mut clock = ticking(true);
        clock.read(at(170));
        clock.arm(2, 1, ms(350), Time::ZERO);
        assert_eq!(rung(&mut clock, at(460)), [0, 0, 0, 0, 1, 2]);
    }

    #[test]
    fn of_two_timers_that_are_due_together_the_first_to_begin_is_first() {
        let mut clock = Clock { is_exact: true, ..Clock::default() };
        clock.read(at(0));
        clock.arm(5, 1, ms(50), Time::ZERO);
        clock.arm(3, 1, ms(50), Time::ZERO);
        assert_eq!(rung(&mut clock, at(50)), [5, 3]);
    }
}
