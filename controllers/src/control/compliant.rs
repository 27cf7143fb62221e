//! Compliance: the hand gives way to the force that it feels.
//!
//! The law is an admittance without inertia, so the force loop has one integrator and a delay. The loop is stable while
//! `stiffness · gain · delay < pi/2`, and calm below 0.6, the budget. With the fingers' 6000 N/m and a delay of 35 ms
//! the gain may be 1/350 m/s/N. A stiffer hand or a slower network needs a smaller gain, and neither is known in
//! advance. So the gain is 1/2000 for quick changes of the force. A constant force is not an oscillation, so the hand
//! gives way to it with up to 1/600. The measured delay caps both gains, so that they keep the budget. If a stiffer
//! grasp oscillates, [`super::oscillation`] reduces the gain.
//!
//! Source: Whitney, "Force feedback control of manipulator fine motions", J. Dynamic Systems 99, 1977 (damping
//! control); the bound is that of an integrator with a delay, Åström and Murray, "Feedback Systems", 2008, section 9.4.

use super::filter::LowPass;
use super::oscillation::OscillationGuard;
use nalgebra::{Vector3, Vector6};

/// The inverse of the gain (N s/m) for a force that changes.
pub const ACROSS: f64 = 2000.0;
/// The inverse of the gain (N s/m) for a force that stays.
const ACROSS_SLOW: f64 = 600.0;
/// A force that stays raises the gain from the first value on (N). From the second value on, the gain is
/// 1/`ACROSS_SLOW`.
const STAYS: (f64, f64) = (15.0, 35.0);
/// The frequency below which a force counts as constant (Hz).
const SLOW: f64 = 2.0;
const UP: f64 = 2000.0;
const TURN: f64 = 0.12;
/// A hand that presses a lever gives way vertically only to the part of the force beyond this (N).
const HOLD: f64 = 48.0;
/// No lever makes the hand roll so far that the cosine of the roll is less than this.
const ROLLED: f64 = 0.4;
const LINEAR_MAX: f64 = 0.15;
const ANGULAR_MAX: f64 = 0.5;
/// The stiffness that the budget assumes (N/m): the stiffness of fingers on a lever.
pub const STIFFNESS: f64 = 6000.0;
/// The largest allowed `stiffness · gain · delay` (N/m · m/s/N · s, so without a unit).
pub const BUDGET: f64 = 0.6;
/// With a longer delay (s) even the smallest useful gain is too large, and the laws refuse to work.
pub const DELAY_MAX: f64 = 0.40;

/// The direction in which another law leads the hand; compliance does not move the hand along it. Unit vectors in tool
/// axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guide {
    /// The direction in which the hand is led, a unit vector.
    pub tangent_in_tool: Vector3<f64>,
    /// The vertical, upwards, a unit vector.
    pub up_in_tool: Vector3<f64>,
    /// Whether the hand may give way upwards and downwards.
    pub upward: bool,
    /// Whether another law turns the hand about the vertical. Then the compliance law does not move the hand.
    pub turned: bool,
}

impl Guide {
    /// The horizontal direction across the path, to its left (a unit vector, tool axes).
    fn across(&self) -> Vector3<f64> {
        self.up_in_tool.cross(&self.tangent_in_tool)
    }

    /// Returns the vector whose scalar product with a force is the force that counts across the path. A pressed lever
    /// pushes back along its arc, at 45 degrees as much sideways as upwards. The hand has rolled with the lever, so
    /// only a force along the hand's own x axis is a strain. The horizontal force that has this x component counts.
    pub fn felt(&self) -> Vector3<f64> {
        let across = self.across();
        if self.upward || across.x.abs() < ROLLED { across } else { Vector3::x() / across.x }
    }
}

/// The number of hops in the whole force loop, and the number of hops before the law. The door specs wire the loop:
/// sensor, ForceTorque, CompliantCtrl or ModelBasedCtrl, AddVelocity, RedundancyResolution, Puma560Ctrl, arm.
const HOPS: (f64, f64) = (6.0, 2.0);
/// The delay of the force loop in addition to its hops: the drives' lag, and half a period (s).
const LAG: f64 = 0.035;

/// Returns the delay of the whole force loop (s) for a law whose wrench is `age` (s) old when it arrives. Each hop is
/// assumed to be as slow as the hops before the law.
pub fn loop_delay(age: f64) -> f64 {
    LAG + age * HOPS.0 / HOPS.1
}

/// The state of a hand that gives way to forces.
#[derive(Clone, Debug, PartialEq)]
pub struct Compliance {
    slow: LowPass<3>,
    /// The recent magnitude of the force, in any direction.
    size: LowPass<1>,
    guard: OscillationGuard,
}

impl Default for Compliance {
    fn default() -> Self {
        Self { slow: LowPass::new(SLOW), size: LowPass::new(SLOW), guard: OscillationGuard::default() }
    }
}

/// Returns the largest gain (m/s/N) that keeps the budget in a loop with this `delay` (s).
pub fn gain_max(delay: f64) -> f64 {
    BUDGET / (STIFFNESS * delay.max(1e-3))
}

impl Compliance {
    /// Returns the velocity (m/s, rad/s, tool axes) that gives way to `wrench_in_tool` (N, Nm, on the hand), `dt` (s)
    /// after the last call. Without a `guide` the hand gives way in every direction, with a guide only across the
    /// guide's direction. `delay` (s) is the delay of the force loop.
    pub fn update(
        &mut self,
        wrench_in_tool: &Vector6<f64>,
        guide: Option<&Guide>,
        delay: f64,
        dt: f64,
    ) -> Vector6<f64> {
        let force: Vector3<f64> = wrench_in_tool.fixed_rows::<3>(0).into();
        let torque: Vector3<f64> = wrench_in_tool.fixed_rows::<3>(3).into();
        let slow = Vector3::from(self.slow.update(&force.into(), dt));
        let [size] = self.size.update(&[force.norm()], dt);
        let (cap, share) = (gain_max(delay), self.guard.update(&force, dt));
        let gain = |slow: f64| {
            // A force that swings to and fro averages to less than half of its magnitude.
            let stays = ((2.0 * slow.abs() - size - STAYS.0) / (STAYS.1 - STAYS.0)).clamp(0.0, 1.0);
            (1.0 / ACROSS + stays * (1.0 / ACROSS_SLOW - 1.0 / ACROSS)).min(cap) * share
        };
        let linear = match guide {
            None => force * gain(slow.norm()),
            Some(guide) => {
                let (across, felt) = (guide.across(), guide.felt());
                let up = guide.up_in_tool.dot(&force);
                let up = if guide.upward { up } else { up - up.clamp(-HOLD, HOLD) };
                across * felt.dot(&force) * gain(felt.dot(&slow)) + guide.up_in_tool * (up * cap.min(1.0 / UP) * share)
            }
        };
        let torque = match guide {
            Some(guide) if guide.turned => torque - guide.up_in_tool * guide.up_in_tool.dot(&torque),
            _ => torque,
        };
        let (linear, angular) = (linear.cap_magnitude(LINEAR_MAX), (torque * TURN).cap_magnitude(ANGULAR_MAX));
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUICK: f64 = 0.03;

    #[test]
    fn gives_way_along_the_force() {
        let v = Compliance::default().update(&Vector6::new(6.0, 0.0, 0.0, 0.0, 1.0, 0.0), None, QUICK, 0.008);
        assert!((v - Vector6::new(0.003, 0.0, 0.0, 0.0, 0.12, 0.0)).norm() < 1e-12);
        let wild = Compliance::default().update(&Vector6::new(0.0, 1e4, 0.0, 0.0, 0.0, 1e4), None, QUICK, 0.008);
        assert!((wild.norm() - 0.15f64.hypot(0.5)).abs() < 1e-12);
    }

    #[test]
    fn gives_way_more_to_a_force_that_stays() {
        let (mut hand, force) = (Compliance::default(), Vector6::new(40.0, 0.0, 0.0, 0.0, 0.0, 0.0));
        let first = hand.update(&force, None, QUICK, 0.008).x;
        let later = (0..100).map(|_| hand.update(&force, None, QUICK, 0.008).x).last().unwrap();
        assert!((first - 0.02).abs() < 1e-3 && (later - 40.0 / 600.0).abs() < 1e-3, "{first} {later}");
        // A force that swings to and fro does not raise the gain.
        let mut hand = Compliance::default();
        let swing = |i: u32| Vector6::new(if i % 12 < 6 { 40.0 } else { -40.0 }, 0.0, 0.0, 0.0, 0.0, 0.0);
        let most = (0..200).map(|i| hand.update(&swing(i), None, QUICK, 0.008).x.abs()).fold(0.0, f64::max);
        assert!(most < 0.03, "{most}");
    }

    #[test]
    fn leaves_the_guided_direction_alone() {
        let guide = Guide { tangent_in_tool: -Vector3::z(), up_in_tool: Vector3::y(), upward: false, turned: false };
        let v = Compliance::default().update(&Vector6::new(6.0, 6.0, 60.0, 0.0, 0.0, 0.0), Some(&guide), QUICK, 0.008);
        assert!((v - Vector6::new(0.003, 0.0, 0.0, 0.0, 0.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn a_lever_that_pushes_back_along_its_arc_is_no_strain() {
        // The hand has rolled by 40 degrees with the lever; `up_in_tool` is the vertical of the world.
        let (s, c) = 40f64.to_radians().sin_cos();
        let up_in_tool = Vector3::new(s, c, 0.0);
        let guide = Guide { tangent_in_tool: -Vector3::z(), up_in_tool, upward: false, turned: false };
        let give = |x: f64, y: f64| {
            let wrench = Vector6::new(x, y, 0.0, 0.0, 0.0, 0.0);
            Compliance::default().update(&wrench, Some(&guide), QUICK, 0.008)
        };
        assert!(give(0.0, 30.0).norm() < 1e-12, "{}", give(0.0, 30.0));
        // The hand gives way to a pull along the lever, in a level direction.
        let v = Vector3::from(give(6.0, 0.0).fixed_rows::<3>(0));
        assert!((v.norm() - 0.003 / c).abs() < 1e-12 && v.dot(&up_in_tool).abs() < 1e-12 && v.x > 0.0, "{v}");
    }

    #[test]
    fn leaves_a_turn_that_another_law_makes_alone() {
        let guide = Guide { tangent_in_tool: Vector3::z(), up_in_tool: Vector3::y(), upward: false, turned: true };
        let v = Compliance::default().update(&Vector6::new(0.0, 0.0, 0.0, 1.0, 2.0, 0.5), Some(&guide), QUICK, 0.008);
        assert!((v - Vector6::new(0.0, 0.0, 0.0, 0.12, 0.0, 0.06)).norm() < 1e-12, "{v}");
    }

    /// Returns the largest force in the last second (N) of a hand at a wall with this stiffness (N/m), in a loop with
    /// this delay (s).
    fn late_force(stiffness: f64, delay: f64) -> f64 {
        let (dt, steps) = (0.004, 2000);
        let late = (0..1000).take_while(|steps| f64::from(*steps) * dt < delay).count();
        let (mut hand, mut at, mut forces) = (Compliance::default(), 0.005, Vec::new());
        for _ in 0..steps {
            forces.push(-stiffness * at);
            let felt = if forces.len() > late { forces[forces.len() - 1 - late] } else { 0.0 };
            at += dt * hand.update(&Vector6::new(felt, 0.0, 0.0, 0.0, 0.0, 0.0), None, delay, dt).x;
        }
        forces[steps - 250..].iter().fold(0.0, |most, force| f64::max(most, force.abs()))
    }

    #[test]
    fn the_loop_is_calm_within_its_budget() {
        for (stiffness, delay) in [(6000.0, 0.03), (6000.0, 0.1), (6000.0, DELAY_MAX), (48_000.0, 0.03)] {
            let force = late_force(stiffness, delay);
            assert!(force < 1.0, "{force} N at {stiffness} N/m and {delay} s");
        }
    }
}
