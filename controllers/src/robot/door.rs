//! A hinged door with a latch, a closer and a lever handle.

use nalgebra::{Isometry3, Rotation3, UnitQuaternion, Vector2, Vector3};

/// Height of the lever's axis (m).
pub const LEVER_HEIGHT: f64 = 1.05;
/// From the lever's axis to where it is held (m).
pub const LEVER_ARM: f64 = 0.09;
/// From the leaf to the lever (m).
pub const LEVER_STANDOFF: f64 = 0.06;
/// Width of the leaf (m) beyond the radius of the handle.
pub const LEAF_BEYOND: f64 = 0.08;

const INERTIA: f64 = 6.75;
const LATCH_STIFFNESS: f64 = 1e5;
const LATCH_DAMPING: f64 = 400.0;
const LEVER_INERTIA: f64 = 0.01;

/// What a door is like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Description {
    /// From the hinge to where the lever is held (m).
    pub radius: f64,
    /// Torque of the closer at rest (Nm).
    pub closer: f64,
    /// Whether the lever frees the latch.
    pub lock: Lock,
}

/// Whether the lever frees the latch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lock {
    /// It does.
    Unlocked,
    /// It does not.
    Locked,
}

/// A door and its state.
#[derive(Clone, Debug, PartialEq)]
pub struct Door {
    description: Description,
    /// Angle (rad) and rate (rad/s) of the leaf, positive open.
    pub angle: f64,
    rate: f64,
    /// Angle (rad) and rate (rad/s) of the lever, positive down.
    pub lever: f64,
    lever_rate: f64,
}

/// Where the handle is and how it moves, in the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Handle {
    /// Pose: x along the lever from its axis outwards, z into the door.
    pub world_from_handle: Isometry3<f64>,
    /// The lever's axis (m).
    pub axis: Vector3<f64>,
    /// Out of the door, towards the robot.
    pub outward: Vector3<f64>,
    /// Of the handle's origin (m/s).
    pub velocity: Vector3<f64>,
    /// (rad/s).
    pub angular: Vector3<f64>,
}

impl Door {
    /// Returns the door closed, its lever up.
    pub fn new(description: Description) -> Self {
        Self { description, angle: 0.0, rate: 0.0, lever: 0.0, lever_rate: 0.0 }
    }

    /// Returns where the hinge is (m).
    pub fn hinge(&self) -> Vector2<f64> {
        Vector2::new(0.0, self.description.radius)
    }

    /// Returns the free edge of the leaf (m).
    pub fn edge(&self) -> Vector2<f64> {
        self.hinge() + self.along() * (self.description.radius + LEAF_BEYOND)
    }

    /// From the hinge along the leaf.
    fn along(&self) -> Vector2<f64> {
        Vector2::new(-self.angle.sin(), -self.angle.cos())
    }

    /// Returns the handle.
    pub fn handle(&self) -> Handle {
        let along = self.along().push(0.0);
        let outward = Vector3::new(-self.angle.cos(), self.angle.sin(), 0.0);
        let hinge = self.hinge().push(LEVER_HEIGHT);
        let axis = hinge + along * (self.description.radius + LEVER_ARM) + outward * LEVER_STANDOFF;
        let lever = -along * self.lever.cos() - Vector3::z() * self.lever.sin();
        let origin = axis + lever * LEVER_ARM;
        let basis = [lever, (-outward).cross(&lever), -outward];
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&basis));
        let leaf_angular = -Vector3::z() * self.rate;
        let lever_angular = self.lever_axis() * self.lever_rate;
        Handle {
            world_from_handle: Isometry3::from_parts(origin.into(), rotation),
            axis,
            outward,
            velocity: leaf_angular.cross(&(origin - hinge)) + lever_angular.cross(&(origin - axis)),
            angular: leaf_angular + lever_angular,
        }
    }

    /// About which the lever turns downwards.
    fn lever_axis(&self) -> Vector3<f64> {
        (-self.along().push(0.0)).cross(&-Vector3::z())
    }

    /// Lets `dt` (s) pass with a force (N) and a torque (Nm) on the handle, in world axes.
    pub fn step(&mut self, force: &Vector3<f64>, torque: &Vector3<f64>, dt: f64) {
        let handle = self.handle();
        let origin = handle.world_from_handle.translation.vector;
        let moment = (origin - self.hinge().push(LEVER_HEIGHT)).cross(force).z + torque.z;
        let closer = if self.angle > 0.0 { self.description.closer + 2.0 * self.angle } else { 0.0 };
        let friction = 1.5 * self.rate + (self.rate / 0.01).tanh();
        let mut leaf = -moment - friction - closer;
        let locked = self.description.lock == Lock::Locked;
        let latched = self.angle < 0.6f64.to_radians() && (self.lever < 28f64.to_radians() || locked);
        if self.angle < 0.0 || (latched && self.angle > 0.0) {
            leaf -= LATCH_STIFFNESS * self.angle + LATCH_DAMPING * self.rate;
        }
        let stop = 45f64.to_radians();
        let mut lever = ((origin - handle.axis).cross(force) + torque * 0.3).dot(&self.lever_axis());
        lever -= 0.6 + 1.8 * self.lever + 0.05 * self.lever_rate;
        if self.lever < 0.0 {
            lever += 0.6 - 400.0 * self.lever - self.lever_rate;
        } else if self.lever > stop {
            lever -= 400.0 * (self.lever - stop) + self.lever_rate;
        }
        self.rate += dt * leaf / INERTIA;
        self.angle += dt * self.rate;
        self.lever_rate += dt * lever / LEVER_INERTIA;
        self.lever += dt * self.lever_rate;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pulled(lock: Lock, lever: f64) -> f64 {
        let mut door = Door::new(Description { radius: 0.82, closer: 8.0, lock });
        for _ in 0..2000 {
            door.lever = lever;
            let force = door.handle().outward * 30.0;
            door.step(&force, &Vector3::zeros(), 1e-3);
        }
        door.angle.to_degrees()
    }

    #[test]
    fn latch_and_lock_hold() {
        // 30 N at 0.82 m less the closer's 8 Nm turn 6.75 kg m² by about a radian in 2 s; the latch yields 0.01 degrees.
        assert!(pulled(Lock::Unlocked, 0.6) > 40.0);
        assert!(pulled(Lock::Unlocked, 0.1).abs() < 0.1);
        assert!(pulled(Lock::Locked, 0.6).abs() < 0.1);
    }

    #[test]
    fn velocity_is_the_derivative() {
        let mut door = Door::new(Description { radius: 0.82, closer: 8.0, lock: Lock::Unlocked });
        (door.angle, door.rate, door.lever, door.lever_rate) = (0.4, 0.3, 0.2, -0.5);
        let before = door.handle();
        (door.angle, door.lever) = (0.4 + 0.3e-6, 0.2 - 0.5e-6);
        let after = door.handle();
        let step = after.world_from_handle.translation.vector - before.world_from_handle.translation.vector;
        // A forward difference of 1 us: its error is the acceleration times half of that.
        assert!((step / 1e-6 - before.velocity).norm() < 1e-5);
        let turn = (after.world_from_handle.rotation * before.world_from_handle.rotation.inverse()).scaled_axis();
        assert!((turn / 1e-6 - before.angular).norm() < 1e-5);
    }
}
