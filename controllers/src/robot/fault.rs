//! The faults of a world that have begun. Each begins once, at its trigger.

use super::door::Door;
use super::setup::{Faults, Turned};
use comms::logic::time::Time;

/// The time in which a visitor's torque on the leaf rises (s), as in a person's push.
const SHUT_RISE: f64 = 0.2;

/// The faults of a world, and which of them have begun.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Active {
    faults: Faults,
    began: Time,
    slipping_since: Option<Time>,
    shutting_since: Option<Time>,
    turning_since: Option<Time>,
    has_jumped: bool,
    has_lost: bool,
    turn: f64,
}

impl Active {
    /// Returns the faults of a world that begins.
    pub(super) const fn new(faults: Faults, now: Time) -> Self {
        Self {
            faults,
            began: now,
            slipping_since: None,
            shutting_since: None,
            turning_since: None,
            has_jumped: false,
            has_lost: false,
            turn: 0.0,
        }
    }

    /// Takes the state of the door at the beginning of a step.
    pub(super) fn look(&mut self, door: &Door, now: Time) {
        let Faults { lose_at, shut_at, turned, jump, .. } = self.faults;
        self.has_lost |= door.angle >= lose_at;
        self.has_jumped |= door.angle >= jump.at;
        begin(&mut self.turning_since, door.angle >= turned.at, now);
        begin(&mut self.shutting_since, door.angle >= shut_at, now);
        let Turned { rate, span, .. } = turned;
        self.turn = if lasts(self.turning_since, now, span) { rate } else { 0.0 };
    }

    /// Returns whether the wheels of the base turn on the spot.
    pub(super) fn slips(&mut self, door: &Door, now: Time) -> bool {
        let Faults { base_slip, base_slip_for, .. } = self.faults;
        let is_time = now.since(self.began).as_secs_f64() >= base_slip.time;
        let is_pressed = door.lever >= base_slip.lever || door.angle >= base_slip.door;
        begin(&mut self.slipping_since, is_time || is_pressed, now);
        lasts(self.slipping_since, now, base_slip_for)
    }

    /// Returns whether the lever has left the fingers for good.
    pub(super) const fn has_lost(&self) -> bool {
        self.has_lost
    }

    /// Returns by how much the steering encoder of the first caster has jumped (rad).
    pub(super) const fn jump(&self) -> f64 {
        if self.has_jumped { self.faults.jump.by } else { 0.0 }
    }

    /// Returns the rate at which something outside turns the base (rad/s).
    pub(super) const fn turn(&self) -> f64 {
        self.turn
    }

    /// Returns the torque with which a visitor leans on the leaf (Nm).
    pub(super) fn shut_torque(&self, now: Time) -> f64 {
        let since = self.shutting_since.map(|since| now.since(since).as_secs_f64());
        let share = since.filter(|since| *since < self.faults.shut_for);
        share.map_or(0.0, |since| (since / SHUT_RISE).min(1.0)) * self.faults.shut_torque
    }
}

/// Begins a fault once its trigger has occurred.
fn begin(since: &mut Option<Time>, is_triggered: bool, now: Time) {
    if is_triggered {
        since.get_or_insert(now);
    }
}

/// Returns whether a fault that lasts for a span (s) is active.
fn lasts(since: Option<Time>, now: Time, span: f64) -> bool {
    since.is_some_and(|since| now.since(since).as_secs_f64() < span)
}

#[cfg(test)]
mod tests {
    use super::super::setup::{Jump, Slip};
    use super::*;

    /// Each fault begins at its trigger, lasts its time, and does not begin again.
    #[test]
    fn each_fault_begins_once() {
        let faults = Faults {
            base_slip: Slip { door: 0.5, ..Faults::default().base_slip },
            shut_at: 0.5,
            turned: Turned { at: 0.5, rate: 0.1, span: 2.0 },
            jump: Jump { at: 0.5, by: 0.3 },
            lose_at: 0.8,
            ..Faults::default()
        };
        let at = |millis: u64| Time::from_nanos(millis * 1_000_000);
        let is_near = |value: f64, expected: f64| (value - expected).abs() < 1e-9;
        let mut door = Door::new(super::super::door::Description::default());
        let mut active = Active::new(faults, at(0));
        active.look(&door, at(10));
        assert!(!active.slips(&door, at(10)) && active.turn() == 0.0 && active.jump() == 0.0 && !active.has_lost());
        door.angle = 0.6;
        active.look(&door, at(20));
        assert!(
            active.slips(&door, at(20))
                && is_near(active.turn(), 0.1)
                && is_near(active.jump(), 0.3)
                && !active.has_lost()
        );
        assert!(active.shut_torque(at(20)) == 0.0 && (active.shut_torque(at(120)) - 15.0).abs() < 1e-9);
        active.look(&door, at(2020));
        assert!(!active.slips(&door, at(2020)) && active.turn() == 0.0 && active.shut_torque(at(2020)) == 0.0);
        assert!(is_near(active.jump(), 0.3), "an encoder stays where it has jumped to");
    }
}
