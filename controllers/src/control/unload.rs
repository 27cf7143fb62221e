//! Unloading: a hand that stops lets go of the force that it had.
//!
//! An arm that only stops stays wound up against what it holds: after a locked door it pressed on with 64 N. So it gives way
//! until it feels next to nothing. What it has wound up, a stiff grasp or a lever that is down, pushes it less and less on the
//! way. What pushes on all the same, a door closer, is held as it is: giving way would not help.
//!
//! Source: ours; an admittance as of [`super::compliant`], which says why its gain is what it is.

use super::filter::Debounce;
use super::oscillation::OscillationGuard;
use nalgebra::{Vector3, Vector6};

/// The gain for forces (m/s/N) and torques (rad/s/Nm), and the largest speeds (m/s, rad/s).
const GAIN: f64 = 1.0 / 450.0;
const TURN: f64 = 0.06;
const SPEED_MAX: f64 = 0.04;
const TURN_MAX: f64 = 0.2;
/// A hand that feels less than the first at the beginning has nothing to let go of (N); it has let go once it feels less than the second
/// so many times in a row.
const LOADED: f64 = 7.0;
const AT_EASE: f64 = 3.5;
const IN_A_ROW: u32 = 5;
/// Over so much way (m) a force that is wound up falls by so much at least (N): 170 N/m, below the spring of a lever.
const STRETCH: f64 = 0.012;
const FALL: f64 = 2.0;
/// The longest way (m) and time (s).
const WAY_MAX: f64 = 0.06;
const TIME_MAX: f64 = 2.6;

/// A hand that unloads itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Unloading {
    guard: OscillationGuard,
    at_ease: Debounce,
    way: f64,
    time: f64,
    /// The way and the force (N) at the last look whether the force falls.
    looked: Option<(f64, f64)>,
    is_over: bool,
}

impl Default for Unloading {
    fn default() -> Self {
        let (guard, at_ease) = (OscillationGuard::default(), Debounce::new(IN_A_ROW));
        Self { guard, at_ease, way: 0.0, time: 0.0, looked: None, is_over: false }
    }
}

impl Unloading {
    /// Returns the velocity (m/s, rad/s, tool axes) that takes the load off a hand that feels `wrench_in_tool` (N, Nm), `dt` (s) after the
    /// last call; none once it is over.
    pub fn update(&mut self, wrench_in_tool: &Vector6<f64>, dt: f64) -> Option<Vector6<f64>> {
        let force: Vector3<f64> = wrench_in_tool.fixed_rows::<3>(0).into();
        let torque: Vector3<f64> = wrench_in_tool.fixed_rows::<3>(3).into();
        let (size, share) = (force.norm(), self.guard.update(&force, dt));
        let (way, before) = *self.looked.get_or_insert((0.0, size));
        self.is_over |= self.time <= 0.0 && size < LOADED;
        self.time += dt;
        if self.way - way >= STRETCH {
            self.is_over |= before - size < FALL;
            self.looked = Some((self.way, size));
        }
        self.is_over |= self.at_ease.update(size < AT_EASE) || self.way > WAY_MAX || self.time > TIME_MAX;
        if self.is_over || !size.is_finite() {
            self.is_over = true;
            return None;
        }
        let linear = (force * GAIN * share).cap_magnitude(SPEED_MAX);
        let angular = (torque * TURN * share).cap_magnitude(TURN_MAX);
        self.way += linear.norm() * dt;
        Some(Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.01;
    /// From the sensor to the motion of the hand (steps).
    const DELAY: usize = 4;

    /// A hand against a spring of so much stiffness (N/m) and with a force that pushes whatever it does (N): the force that is left, the
    /// way (m) and the time (s).
    fn unloaded(stiffness: f64, load: f64, constant: f64) -> (f64, f64, f64) {
        let (mut unloading, mut felt) = (Unloading::default(), vec![load + constant; DELAY]);
        let (mut at, mut time) = (0.0, 0.0);
        loop {
            let Some(twist) = unloading.update(&(Vector6::z() * felt.remove(0)), DT) else {
                return ((load - stiffness * at).max(0.0) + constant, at, time);
            };
            at += twist[2] * DT;
            time += DT;
            felt.push((load - stiffness * at).max(0.0) + constant);
            assert!(time < 5.0, "it never ends");
        }
    }

    #[test]
    fn what_is_wound_up_is_let_go_of() {
        // Soft and stiff grasps, and the spring of a lever.
        for (stiffness, load) in [(6000.0, 64.0), (6000.0, 20.0), (48_000.0, 100.0), (600.0, 20.0)] {
            let (left, way, time) = unloaded(stiffness, load, 0.0);
            assert!(left < 4.0 && way < WAY_MAX && time < TIME_MAX, "{stiffness} N/m: {left} N, {way} m, {time} s");
        }
    }

    #[test]
    fn what_pushes_on_is_held() {
        let (left, way, _) = unloaded(6000.0, 0.0, 12.0);
        assert!(left > 11.0 && way < 1.1 * STRETCH, "{left} N, {way} m");
    }

    #[test]
    fn a_free_hand_stays_where_it_is() {
        assert_eq!(Unloading::default().update(&(Vector6::x() * 6.0), DT), None);
        assert_eq!(Unloading::default().update(&(Vector6::x() * f64::NAN), DT), None);
    }
}
