//! Drives and the rules of a device: it has one owner at a time, and no command is valid for longer than 100 ms.

use crate::control::ramp::towards;
use comms::logic::time::Time;
use std::time::Duration;

/// The time for which a command is valid.
pub const WATCHDOG: Duration = Duration::from_millis(100);

/// The controller that may command a device.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Owner {
    name: Option<String>,
    heard: Time,
}

impl Owner {
    /// Returns whether a command of `name` at `now` is obeyed. Commands of other senders are ignored until 100 ms after
    /// the owner's last command.
    pub fn admit(&mut self, name: &str, now: Time) -> bool {
        let free = self.name.as_deref().is_none_or(|owner| owner == name) || now.since(self.heard) > WATCHDOG;
        if free {
            if self.name.as_deref() != Some(name) {
                self.name = Some(name.to_owned());
            }
            self.heard = now;
        }
        free
    }

    /// Lets another sender command the device.
    pub fn release(&mut self) {
        self.name = None;
    }
}

/// N velocity servos with a first-order lag, an acceleration limit, a speed limit and a watchdog.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive<const N: usize> {
    limits: Limits<N>,
    target: [f64; N],
    heard: Option<Time>,
    /// Whether the last command was to let go of the drive.
    released: bool,
    /// When the watchdog last ended a command; none if it never did.
    pub stopped: Option<Time>,
    /// The present speed of each axis (SI).
    pub velocity: [f64; N],
}

/// The limits of a drive (SI).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits<const N: usize> {
    /// The time constant (s).
    pub lag: f64,
    /// The largest acceleration of each axis (m/s² or rad/s²).
    pub acceleration: [f64; N],
    /// The largest speed of each axis (m/s or rad/s).
    pub speed: [f64; N],
}

impl<const N: usize> Drive<N> {
    /// Returns a drive at rest.
    pub const fn new(limits: Limits<N>) -> Self {
        Self { limits, target: [0.0; N], heard: None, released: true, stopped: None, velocity: [0.0; N] }
    }

    /// Takes a command, clamped to the speed limits. No `target` brings the axes to rest. A command that is not finite
    /// is ignored.
    pub fn command(&mut self, target: Option<&[f64; N]>, now: Time) {
        if target.is_some_and(|target| !target.iter().all(|speed| speed.is_finite())) {
            return;
        }
        (self.heard, self.released) = (target.map(|_| now), target.is_none());
        if let Some(target) = target {
            let speed = &self.limits.speed;
            self.target = std::array::from_fn(|i| target[i].clamp(-speed[i], speed[i]));
        }
    }

    /// Returns whether the owner has let go of the drive, or has been silent for `patience` since the watchdog ended a
    /// command.
    pub fn is_left(&self, now: Time, patience: Duration) -> bool {
        let is_silent = |at| self.heard.is_none() && now.since(at) > patience;
        self.released || self.stopped.is_some_and(is_silent)
    }

    /// Lets `dt` (s) pass until `now`.
    pub fn step(&mut self, now: Time, dt: f64) {
        if self.heard.take_if(|heard| now.since(*heard) > WATCHDOG).is_some() {
            self.stopped = Some(now);
        }
        let alive = self.heard.is_some();
        for i in 0..N {
            let target = if alive { self.target[i] } else { 0.0 };
            // The lag is integrated exactly, so that it is stable for any step.
            let lagged = self.velocity[i] + (target - self.velocity[i]) * (1.0 - (-dt / self.limits.lag).exp());
            self.velocity[i] = towards(self.velocity[i], lagged, self.limits.acceleration[i] * dt);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_brings_it_to_rest_without_a_jump() {
        let limits = Limits { lag: 0.08, acceleration: [1.0], speed: [0.5] };
        let (mut drive, mut now) = (Drive::new(limits), Time::ZERO);
        let mut steps = Vec::new();
        for i in 0..3000 {
            if i < 1000 {
                drive.command(Some(&[0.9]), now);
            }
            let before = drive.velocity[0];
            now = now + Duration::from_millis(1);
            drive.step(now, 1e-3);
            steps.push((drive.velocity[0] - before).abs());
            if i == 999 {
                assert!((drive.velocity[0] - 0.5).abs() < 1e-3, "clamped to the speed limit");
            }
        }
        assert!(drive.velocity[0].abs() < 1e-6);
        assert!(steps.iter().all(|step| *step <= 1e-3 + 1e-12));
    }

    #[test]
    fn a_command_that_is_not_finite_counts_for_nothing() {
        let limits = Limits { lag: 0.08, acceleration: [1.0; 2], speed: [0.5; 2] };
        for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let (mut drive, mut now) = (Drive::new(limits), Time::ZERO);
            for i in 0..1000 {
                drive.command(Some(&if i < 500 { [0.1, 0.2] } else { [0.1, number] }), now);
                now = now + Duration::from_millis(1);
                drive.step(now, 1e-3);
                assert!(drive.velocity.iter().all(|speed| speed.is_finite()), "{number}");
            }
            assert!(drive.stopped.is_some(), "the watchdog has ended the last command that was one");
        }
    }

    #[test]
    fn one_owner_at_a_time() {
        let at = |ms| Time::ZERO + Duration::from_millis(ms);
        let mut owner = Owner::default();
        assert!(owner.admit("a", at(0)) && !owner.admit("b", at(50)) && owner.admit("a", at(60)));
        assert!(!owner.admit("b", at(160)) && owner.admit("b", at(161)) && !owner.admit("a", at(170)));
        owner.release();
        assert!(owner.admit("a", at(171)));
    }
}
