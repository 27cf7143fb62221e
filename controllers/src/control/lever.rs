//! The lever while the door opens: the hand keeps it down until the latch is free. A hand that has to turn about the
//! lever then lets it up.
//!
//! Drives give way a little to a constant force, so the lever of a hand that only stops pressing rises by 15 degrees in
//! ten seconds. Instead, the law holds the height of the hand. The lever is let up in the same way as it was pressed:
//! the hand rises along the arc of a lever of medium length and rolls back. A lever that is up pushes back, which ends
//! the rise.
//!
//! Source: ours.

use super::press::{LEVER, ROLL};
use nalgebra::{UnitQuaternion, Vector3};

/// The gain with which a height is held (1/s), and the largest speed (m/s).
const GAIN: f64 = 3.0;
const HOLD_MAX: f64 = 0.02;
/// If the lever pushes with more than its first force plus `HARDER` (N), the hand gives up its height and holds the
/// present height instead. This limit is at least the first and at most the second value of `FORCE_MAX` (N).
const HARDER: f64 = 8.0;
const FORCE_MAX: (f64, f64) = (30.0, 48.0);
/// The time over which the force at the beginning is averaged (s).
const FELT_TIME: f64 = 0.25;
/// The speed at which the hand rises (m/s), and the downward force on the hand at which the rise stops (N): the lever
/// is up.
const RISE: f64 = 0.03;
const RISE_FORCE: f64 = 12.0;
/// The lean below which a hand is level (rad), and the lean below which it may turn about the lever.
const LEVEL: f64 = 0.04;
const LEANS: f64 = 0.35;
/// The longest time for which the hand lets the lever up (s).
const TIME_MAX: f64 = 5.0;

/// A lever in the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lever {
    /// The height of the hand that keeps the lever down (m).
    height: Option<f64>,
    /// The force with which the lever pushes at first (N), and the time over which this force has been averaged (s).
    felt: (f64, f64),
    /// For how long the hand has been letting the lever up (s); none once the lever is up.
    rising: Option<f64>,
}

impl Default for Lever {
    fn default() -> Self {
        Self { height: None, felt: (0.0, 0.0), rising: Some(0.0) }
    }
}

impl Lever {
    /// Returns the upward speed (m/s, not positive) with which a hand at `height` (m) keeps the lever down, `dt` (s)
    /// after the last call. `upward` is the force of the lever on the hand, upwards (N).
    pub fn hold(&mut self, height: f64, upward: f64, dt: f64) -> f64 {
        let held = self.height.get_or_insert(height);
        let (felt, time) = &mut self.felt;
        if *time < FELT_TIME {
            *time += dt;
            *felt += (upward - *felt) * (dt / *time).min(1.0);
        }
        if upward > (*felt + HARDER).clamp(FORCE_MAX.0, FORCE_MAX.1) {
            *held = height;
        }
        (GAIN * (*held - height)).clamp(-HOLD_MAX, 0.0)
    }

    /// Lets the lever up, `dt` (s) after the last call. `rotation` is the orientation of the hand, and `upward` the
    /// force that pushes the hand upwards (N). Returns how fast the hand rises (m/s) and rolls about its z axis
    /// (rad/s); none once the lever is up.
    pub fn rise(&mut self, rotation: &UnitQuaternion<f64>, upward: f64, dt: f64) -> Option<(f64, f64)> {
        let time = self.rising? + dt;
        let (x, y) = (rotation * Vector3::x(), rotation * Vector3::y());
        self.rising = (x.z.abs() > LEVEL && time < TIME_MAX).then_some(time);
        let up = RISE * (1.0 + upward / RISE_FORCE).clamp(0.0, 1.0);
        self.rising.map(|_| (up, -(x.z * y.z).signum() * RISE * ROLL / LEVER))
    }

    /// Returns whether the lever still has to be let up.
    pub fn is_rising(&self) -> bool {
        self.rising.is_some()
    }

    /// Returns whether the hand may turn about the lever: the lever is nearly up.
    pub fn is_up(&self, rotation: &UnitQuaternion<f64>) -> bool {
        let is_rising = self.rising.is_none_or(|time| time > 0.0);
        is_rising && (self.rising.is_none() || (rotation * Vector3::x()).z.abs() < LEANS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hand_that_sinks_is_held_and_one_that_is_pushed_hard_gives_way() {
        let mut lever = Lever::default();
        assert!(lever.hold(1.0, 20.0, 0.01).abs() < 1e-12);
        assert!(
            (lever.hold(1.004, 20.0, 0.01) + 0.012).abs() < 1e-12 && (lever.hold(1.1, 20.0, 0.01) + 0.02).abs() < 1e-12
        );
        assert!(lever.hold(0.9, 20.0, 0.01).abs() < 1e-12, "it never rises by itself");
        assert!(lever.hold(1.05, 40.0, 0.01).abs() < 1e-12 && lever.hold(1.05, 20.0, 0.01).abs() < 1e-12);
    }

    /// A strong spring has 40 N: a hand that gives way to 30 N lets such a lever creep up until its latch catches.
    #[test]
    fn a_strong_lever_is_kept_down() {
        let mut lever = Lever::default();
        for _ in 0..100 {
            assert!(lever.hold(1.0, 40.0, 0.01).abs() < 1e-12);
        }
        assert!(lever.hold(1.004, 46.0, 0.01) < -0.01 && lever.hold(1.004, 46.0, 0.01) < -0.01);
        assert!(lever.hold(1.004, 49.0, 0.01).abs() < 1e-12, "no lever needs as much");
    }

    #[test]
    fn it_is_let_up_as_it_was_pressed_to_either_side() {
        for side in [1.0, -1.0] {
            // A hand that faces x, with the lever to one side and pressed by 0.6 rad.
            let level = UnitQuaternion::from_basis_unchecked(&[Vector3::y() * side, Vector3::z() * side, Vector3::x()]);
            let (mut lever, mut roll, mut up, dt) = (Lever::default(), -0.6 * side, 0.0, 0.01);
            let at = |roll: f64| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), roll) * level;
            assert!(!lever.is_up(&at(roll)));
            while let Some((rise, turn)) = lever.rise(&at(roll), 5.0, dt) {
                (up, roll) = (up + rise * dt, roll + turn * dt);
            }
            assert!(roll.abs() < LEVEL && lever.is_up(&at(roll)), "{side}: {roll}");
            // The hand rises as far as a lever of 0.1 m has to be pressed for that angle.
            assert!((up - (0.6 - LEVEL) * LEVER / ROLL).abs() < 1e-3, "{side}: {up}");
        }
        // A raised lever pushes back, and the hand rises no further.
        let leaning = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.5)
            * UnitQuaternion::from_basis_unchecked(&[Vector3::y(), Vector3::z(), Vector3::x()]);
        let risen = Lever::default().rise(&leaning, -15.0, 0.01);
        assert!(risen.is_some_and(|(rise, roll)| rise.abs() < 1e-12 && roll.abs() > 0.1), "{risen:?}");
    }
}
