//! Detects joints that do not follow their commands: the encoder sticks, or something holds the joint.
//!
//! Commands and measurements are compared over about a second. The commands are first delayed by the lag of a drive. A
//! joint that is commanded to move at 0.1 rad/s and does not move is found within about 0.8 s.
//!
//! Source: ours; residuals against a model of the drive, Isermann, "Fault-Diagnosis Systems", 2006, chapter 10.

use super::puma560::Joints;

/// The time over which command and measurement are compared, the lag of a drive, and the time for which they have to
/// differ (s).
const MEMORY: f64 = 1.0;
const LAG: f64 = 0.12;
const SURE: f64 = 0.15;
/// A joint does not follow if it was commanded to move further than `TOLD` (rad) and has moved less than the share
/// `SHARE` of that.
const TOLD: f64 = 0.04;
const SHARE: f64 = 0.1;

/// The commanded and the measured motion of each joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Follow {
    lagging: Joints,
    told: Joints,
    gone: Joints,
    last: Option<Joints>,
    differs: Joints,
}

impl Follow {
    /// Takes a command (rad/s) and the angles (rad), `dt` (s) after the last call. Returns the number of a joint that
    /// does not follow, counted from 1.
    pub fn update(&mut self, command: &Joints, angles: &Joints, dt: f64) -> Option<usize> {
        let last = self.last.replace(*angles).unwrap_or(*angles);
        let keep = (1.0 - dt / MEMORY).max(0.0);
        self.lagging += (command - self.lagging) * (1.0 - (-dt / LAG).exp());
        self.told = self.told * keep + self.lagging * dt;
        self.gone = self.gone * keep + (angles - last);
        for joint in 0..6 {
            let (told, gone) = (self.told[joint], self.gone[joint] * self.told[joint].signum());
            let differs = told.abs() > TOLD && gone < SHARE * told.abs();
            self.differs[joint] = if differs { self.differs[joint] + dt } else { 0.0 };
        }
        (0..6).find(|joint| self.differs[*joint] > SURE).map(|joint| joint + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.01;

    /// A joint with a `lag` (s) and a delay of some steps is commanded to move at `rate` (rad/s). The joint's encoder
    /// sticks from the time `sticks` on (s). Returns how long after that the law notices this (s), and for which joint.
    fn noticed(rate: impl Fn(f64) -> f64, lag: f64, sticks: f64) -> Option<(f64, usize)> {
        let (mut follow, mut speed, mut joints) = (Follow::default(), 0.0, Joints::zeros());
        let mut said = vec![joints; 10];
        (0..1000).find_map(|step| {
            let time = f64::from(step) * DT;
            speed += (rate(time) - speed) * DT / lag;
            joints[2] += speed * DT;
            said.push(if time < sticks { joints } else { said[said.len() - 1] });
            let command = Joints::new(0.0, 0.0, rate(time), 0.0, 0.0, 0.0);
            follow.update(&command, &said[said.len() - 10], DT).map(|joint| (time - sticks, joint))
        })
    }

    #[test]
    fn joints_that_follow_late_follow() {
        for lag in [0.01, 0.05, 0.2] {
            let rates: [fn(f64) -> f64; 3] =
                [|_| 0.3, |t| 0.5 * (2.0 * t).sin(), |t| if t % 2.0 < 1.0 { 1.0 } else { -1.0 }];
            for rate in rates {
                assert_eq!(noticed(rate, lag, 99.0), None, "{lag} s");
            }
        }
    }

    #[test]
    fn an_encoder_that_sticks_is_found_out_within_a_second() {
        for rate in [0.1, 0.3, -0.2] {
            let found = noticed(|time| if time < 3.0 { 0.0 } else { rate }, 0.02, 2.0);
            assert!(found.is_some_and(|(time, joint)| time < 1.0 + 0.85 && joint == 3), "{rate}: {found:?}");
        }
        let found = noticed(|_| 0.2, 0.02, 2.0);
        assert!(found.is_some_and(|(time, _)| time < 2.8), "{found:?}");
        // A joint that is not commanded to move is not reported.
        assert_eq!(noticed(|_| 0.0, 0.02, 2.0), None);
    }
}
