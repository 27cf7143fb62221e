//! The arm of the robot: six joints with drives, stops, and encoders that may be off.

use super::drive::{Drive, Limits};
use super::plant::DT;
use super::setup::Machine;
use crate::control::puma560::{self, Joints};

/// The nominal limits of the drives, without their lag.
const LIMITS: Limits<6> = Limits { lag: 0.0, acceleration: [8.0; 6], speed: puma560::RATES_MAX };

/// The arm of the robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Its drives (rad/s).
    pub drive: Drive<6>,
    joints: Joints,
    /// How far each encoder is off (rad).
    offsets: Joints,
    limits_hit: u32,
}

impl Arm {
    /// Returns an arm at rest.
    pub(super) fn new(machine: &Machine, joints: Joints, offsets: Joints) -> Self {
        Self { drive: Drive::new(machine.arm.limits(&LIMITS)), joints, offsets, limits_hit: 0 }
    }

    /// Returns the true angles of its joints (rad).
    pub(super) const fn joints(&self) -> &Joints {
        &self.joints
    }

    /// Returns the angles from its encoders (rad).
    pub fn encoders(&self) -> Joints {
        self.joints + self.offsets
    }

    /// Returns how many steps a joint has been held back at its limit.
    pub const fn limits_hit(&self) -> u32 {
        self.limits_hit
    }

    /// Lets one step pass with these rates of the joints (rad/s).
    pub(super) fn advance(&mut self, rates: &Joints) {
        let wanted = self.joints + rates * DT;
        self.joints = wanted.zip_zip_map(&puma560::lowest(), &puma560::highest(), f64::clamp);
        if (self.joints - wanted).amax() > 0.0 {
            self.limits_hit += 1;
        }
    }
}
