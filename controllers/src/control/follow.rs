//! Whether joints follow their commands: an encoder that sticks says that they do not, and a joint that is held does not.
//!
//! Commands and measurements are compared over about a second, the commands as late as drives are. A joint that is told to
//! move by 0.1 rad/s is found out within 0.8 s.
//!
//! Source: ours; residuals against a model of the drive, Isermann, "Fault-Diagnosis Systems", 2006, chapter 10.

use super::puma560::Joints;

/// The time over which both are compared, the lag of a drive, and how long they have to differ (s).
const MEMORY: f64 = 1.0;
const LAG: f64 = 0.12;
const SURE: f64 = 0.15;
/// A joint does not follow if it was commanded to move this far (rad) and has moved less than this share.
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
    /// Takes a command (rad/s) and the angles (rad), `dt` (s) after the last call. Returns a joint that does not follow, from 1.
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

    /// Joints with a lag and a delay in steps that are commanded to move at `rate` (rad/s) at times, and stick from a
    /// time on (s): the time at which that is noticed (s).
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
        // A joint that stands still need not move.
        assert_eq!(noticed(|_| 0.0, 0.02, 2.0), None);
    }
}
