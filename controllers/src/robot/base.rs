//! The base of the robot: drives for three axes, and casters whose wheels may slip without the knowledge of their encoders.

use super::drive::{Drive, Limits};
use super::plant::DT;
use super::setup::Machine;
use crate::control::caster::{self, Casters, Pose};
use nalgebra::Vector3;

/// The nominal limits of the drives, without their lag.
const LIMITS: Limits<3> = Limits { lag: 0.0, acceleration: [1.0, 1.0, 1.5], speed: [0.6, 0.6, 0.7] };

/// The base of the robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Base {
    /// Its drives: x, y (m/s), yaw (rad/s), base axes.
    pub drive: Drive<3>,
    pose: Pose,
    casters: Casters,
    /// (m).
    wheel_radius: f64,
}

/// The motion of the base in one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    /// The velocity of the base (m/s, rad/s, base axes).
    pub(super) body: Vector3<f64>,
    /// The part of it that slides over the floor, because it is beyond the traction of the wheels.
    pub(super) slid: Vector3<f64>,
    /// Whether the wheels turn on the spot.
    pub(super) slips: bool,
    /// The rate at which something outside turns the base (rad/s).
    pub(super) turned: f64,
}

impl Base {
    /// Returns a base at rest.
    pub(super) fn new(machine: &Machine, pose: Pose, casters: Casters) -> Self {
        let wheel_radius = caster::WHEEL_RADIUS / (1.0 + machine.wheel_error);
        Self { drive: Drive::new(machine.base.limits(&LIMITS)), pose, casters, wheel_radius }
    }

    /// Returns where it is: x, y (m), yaw (rad).
    pub const fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Returns the angles of its casters (rad).
    pub(super) const fn casters(&self) -> &Casters {
        &self.casters
    }

    /// Lets one step pass. The encoders of the wheels see neither a slide nor a turn by something outside.
    pub(super) fn advance(&mut self, motion: &Motion) {
        let Motion { body, slid, slips, turned } = motion;
        if !slips {
            self.pose = caster::advance(&self.pose, &(body * DT));
        }
        self.pose.z += turned * DT;
        let rolled = body - slid;
        let steering = std::array::from_fn(|i| self.casters[i]);
        self.casters += caster::rates_from_body(&steering, self.wheel_radius) * rolled * DT;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::redundancy;

    #[test]
    fn it_has_the_acceleration_that_the_controllers_count_on() {
        for (has, believed) in LIMITS.acceleration.iter().zip(redundancy::BASE_ACCELERATION_MAX) {
            assert!((has - believed).abs() < 1e-12);
        }
    }

    /// The encoders count the rolling of the wheels, without slides and turns of the base.
    #[test]
    fn its_encoders_do_not_see_slides_and_turns() {
        let rolls = Motion { body: Vector3::x() * 0.1, slid: Vector3::zeros(), slips: false, turned: 0.0 };
        let new = || Base::new(&Machine::default(), Pose::zeros(), Casters::zeros());
        let [mut rolled, mut slid, mut slipped, mut turned] = [new(), new(), new(), new()];
        rolled.advance(&rolls);
        slid.advance(&Motion { slid: rolls.body, ..rolls });
        slipped.advance(&Motion { slips: true, ..rolls });
        turned.advance(&Motion { turned: 1.0, ..rolls });
        assert!(rolled.pose().x > 0.0 && slid.pose() == rolled.pose() && slid.casters() == &Casters::zeros());
        assert!(slipped.pose() == &Pose::zeros() && slipped.casters() == rolled.casters());
        assert!(turned.pose().z > 0.0 && turned.casters() == rolled.casters());
    }
}
