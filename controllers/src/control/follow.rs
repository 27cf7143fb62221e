//! Detects joints that do not follow their commands: the encoder sticks, or something holds the joint.
//!
//! Commands and measurements are compared over about a second of the device's time. A sample is compared with the
//! commands that held until it was measured, delayed by the lag of a drive. While no sample arrives, nothing is compared:
//! a busy machine holds both back. A joint that is commanded to move at 0.1 rad/s and does not move is found within about
//! 0.8 s.
//!
//! Source: ours; residuals against a model of the drive, Isermann, "Fault-Diagnosis Systems", 2006, chapter 10.

use super::puma560::Joints;
use comms::logic::time::Time;
use std::collections::VecDeque;
use std::time::Duration;

/// The time over which command and measurement are compared, the lag of a drive, and the time for which they have to
/// differ (s).
const MEMORY: f64 = 1.0;
const LAG: f64 = 0.12;
const SURE: f64 = 0.15;
/// A joint does not follow if it was commanded to move further than `TOLD` (rad) and has moved less than the share
/// `SHARE` of that.
const TOLD: f64 = 0.04;
const SHARE: f64 = 0.1;
/// The part of the time between two samples that counts (s). So a joint is reported only after several samples.
const COUNTED_MAX: f64 = 0.03;
/// The time after which the drives have stopped by themselves, if they hear no command.
pub const HELD: Duration = Duration::from_millis(80);
/// The number of commands that are kept until a sample has been measured after them: more than a second at 100 Hz.
const CAPACITY: usize = 128;

/// A command to the joints (rad/s), and when it was given.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Command {
    at: Time,
    rates: Joints,
}

/// The commanded and the measured motion of each joint.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Follow {
    /// The commands that are newer than the last sample.
    coming: VecDeque<Command>,
    /// The command that held when the last sample was measured.
    holds: Option<Command>,
    /// When the last sample was measured, and its angles (rad).
    measured: Time,
    last: Option<Joints>,
    lagging: Joints,
    told: Joints,
    gone: Joints,
    differs: Joints,
}

impl Follow {
    /// Takes a command (rad/s) that is sent at `now`.
    pub fn command(&mut self, rates: &Joints, now: Time) {
        if self.coming.len() == CAPACITY {
            self.coming.pop_front();
        }
        self.coming.push_back(Command { at: now, rates: *rates });
    }

    /// Takes the angles (rad) that were measured at a time of this host's clock. Returns the number of a joint that does
    /// not follow, counted from 1. A sample that is not newer than the last one is ignored.
    pub fn measure(&mut self, angles: &Joints, measured: Time) -> Option<usize> {
        let Some(last) = self.last else {
            (self.last, self.measured) = (Some(*angles), measured);
            return None;
        };
        let dt = measured.since(self.measured).as_secs_f64();
        if dt <= 0.0 {
            return None;
        }
        self.advance(measured);
        self.gone = self.gone * kept(dt) + (angles - last);
        self.last = Some(*angles);
        for joint in 0..6 {
            let (told, gone) = (self.told[joint], self.gone[joint] * self.told[joint].signum());
            let differs = told.abs() > TOLD && gone < SHARE * told.abs();
            self.differs[joint] = if differs { self.differs[joint] + dt.min(COUNTED_MAX) } else { 0.0 };
        }
        (0..6).find(|joint| self.differs[*joint] > SURE).map(|joint| joint + 1)
    }

    /// Counts the commands that held until `to`.
    fn advance(&mut self, to: Time) {
        while let Some(next) = self.coming.front().copied().filter(|next| next.at <= to) {
            self.coming.pop_front();
            self.count(next.at);
            self.holds = Some(next);
        }
        self.count(to);
    }

    /// Counts the command that holds until `to`.
    fn count(&mut self, to: Time) {
        if let Some(Command { at, rates }) = self.holds {
            let end = to.min(at + HELD);
            self.add(&rates, end);
        }
        self.add(&Joints::zeros(), to);
    }

    /// Counts the motion that `rates` (rad/s) command until `to`.
    fn add(&mut self, rates: &Joints, to: Time) {
        let dt = to.since(self.measured).as_secs_f64();
        if dt > 0.0 {
            self.lagging += (rates - self.lagging) * (1.0 - (-dt / LAG).exp());
            self.told = self.told * kept(dt) + self.lagging * dt;
            self.measured = to;
        }
    }
}

/// The share of the past that is kept after `dt` (s).
fn kept(dt: f64) -> f64 {
    (1.0 - dt / MEMORY).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The period of the law and of the encoders (ms), and the age of a sample (ms).
    const PERIOD: usize = 10;
    const AGE: usize = 100;

    fn at(ms: usize) -> Time {
        Time::ZERO + Duration::from_millis(ms as u64)
    }

    /// A joint of an arm, and how the machine holds its commands and samples back.
    struct Joint<'a> {
        /// The commanded rate (rad/s) at a time (s).
        rate: &'a dyn Fn(f64) -> f64,
        /// The time constant of its drive (s).
        lag: f64,
        /// When its encoder sticks (s).
        sticks: f64,
        /// Whether the law calculates, the drive takes a command, and a sample arrives at a time (ms).
        calculates: fn(usize) -> bool,
        taken: fn(usize) -> bool,
        arrives: fn(usize) -> bool,
    }

    impl Joint<'_> {
        fn new(rate: &dyn Fn(f64) -> f64) -> Joint<'_> {
            Joint { rate, lag: 0.02, sticks: 99.0, calculates: |_| true, taken: |_| true, arrives: |_| true }
        }

        /// Returns how long after its encoder sticks the law notices this (s), and for which joint.
        fn noticed(&self) -> Option<(f64, usize)> {
            let (mut follow, mut speed, mut angle) = (Follow::default(), 0.0, 0.0);
            let (mut sent, mut heard, mut said, mut newest) = (None, None, vec![0.0; AGE / PERIOD], None);
            (0..1000).find_map(|step| {
                let (ms, time, dt) = (step * PERIOD, (step * PERIOD) as f64 / 1e3, PERIOD as f64 / 1e3);
                if (self.taken)(ms) {
                    heard = sent;
                }
                let target = heard.filter(|(since, _)| ms - since <= 100).map_or(0.0, |(_, rate)| rate);
                speed += (target - speed) * dt / self.lag.max(dt);
                angle += speed * dt;
                said.push(if time < self.sticks { angle } else { said[said.len() - 1] });
                if (self.arrives)(ms) {
                    newest = ms.checked_sub(AGE).map(|measured| (measured, said[step]));
                }
                if !(self.calculates)(ms) {
                    return None;
                }
                let found = newest.and_then(|(measured, angle)| follow.measure(&joints(angle), at(measured)));
                sent = Some((ms, (self.rate)(time)));
                follow.command(&joints((self.rate)(time)), at(ms));
                found.map(|joint| (time - self.sticks, joint))
            })
        }
    }

    /// Six joints of which the third has a value.
    fn joints(third: f64) -> Joints {
        Joints::new(0.0, 0.0, third, 0.0, 0.0, 0.0)
    }

    #[test]
    fn joints_that_follow_late_follow() {
        for lag in [0.01, 0.05, 0.2] {
            let rates: [fn(f64) -> f64; 3] =
                [|_| 0.3, |t| 0.5 * (2.0 * t).sin(), |t| if t % 2.0 < 1.0 { 1.0 } else { -1.0 }];
            for rate in rates {
                assert_eq!(Joint { lag, ..Joint::new(&rate) }.noticed(), None, "{lag} s");
            }
        }
    }

    #[test]
    fn an_encoder_that_sticks_is_found_out_within_a_second() {
        for rate in [0.1, 0.3, -0.2] {
            let rate = |time| if time < 3.0 { 0.0 } else { rate };
            let found = Joint { sticks: 2.0, ..Joint::new(&rate) }.noticed();
            assert!(found.is_some_and(|(time, joint)| time < 1.0 + 0.95 && joint == 3), "{}: {found:?}", rate(3.0));
        }
        let found = Joint { sticks: 2.0, ..Joint::new(&|_| 0.2) }.noticed();
        assert!(found.is_some_and(|(time, _)| time < 2.9), "{found:?}");
        // A joint that is not commanded to move is not reported.
        assert_eq!(Joint { sticks: 2.0, ..Joint::new(&|_| 0.0) }.noticed(), None);
    }

    #[test]
    fn a_busy_machine_holds_no_joint() {
        // For half a second of each 0.7 s, no sample arrives, or the law does not calculate, or the drive hears nothing of
        // a law that does not calculate.
        let waits: fn(usize) -> bool = |ms| ms % 700 >= 500;
        let rates: [fn(f64) -> f64; 2] = [|_| 0.5, |t| if t % 1.4 < 0.7 { 0.0 } else { 1.0 }];
        for rate in rates {
            let joint = || Joint::new(&rate);
            for joint in [
                Joint { arrives: waits, ..joint() },
                Joint { calculates: waits, ..joint() },
                Joint { calculates: waits, taken: waits, arrives: waits, ..joint() },
            ] {
                assert_eq!(joint.noticed(), None);
            }
            // An encoder that sticks is found even then, if the joint is commanded to move while samples arrive.
            let found = Joint { arrives: waits, sticks: 2.0, ..Joint::new(&|_| 0.5) }.noticed();
            assert!(found.is_some_and(|(time, _)| time < 3.0), "{found:?}");
        }
    }
}
