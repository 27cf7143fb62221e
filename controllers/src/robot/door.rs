//! A hinged door with a latch, a closer and a lever handle.

use nalgebra::{Isometry3, Rotation3, UnitQuaternion, Vector2, Vector3};

const LEVER_INERTIA: f64 = 0.01;
/// The share of the fingers' torque about the lever's axis that reaches the lever; the rest slips.
const FINGERS_TURN: f64 = 0.3;

/// The description of a door.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Description {
    /// The side of the hinge, as the robot sees it.
    pub side: Side,
    /// The direction in which the leaf opens, as the robot sees it.
    pub swing: Swing,
    /// The state of the lock.
    pub lock: Lock,
    /// From the hinge to where the lever is held (m).
    pub radius: f64,
    /// Width of the leaf (m) beyond the radius of the handle.
    pub leaf_beyond: f64,
    /// Of the leaf about its hinge (kg m²).
    pub inertia: f64,
    /// Torque of the closer at rest (Nm).
    pub closer: f64,
    /// The growth of that torque with the angle (Nm/rad).
    pub closer_rate: f64,
    /// Dry friction of the hinge (Nm).
    pub friction: f64,
    /// Viscous friction of the hinge (Nm s/rad).
    pub viscosity: f64,
    /// The latch.
    pub latch: Latch,
    /// The lever handle.
    pub lever: Lever,
}

/// The description of a latch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latch {
    /// The angle of the lever that frees the latch (rad).
    pub angle: f64,
    /// Below this angle of the leaf the latch catches it (rad).
    pub play: f64,
    /// Of the latch and of the frame, about the hinge (Nm/rad).
    pub stiffness: f64,
    /// (Nm s/rad).
    pub damping: f64,
}

/// The description of a lever handle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lever {
    /// Height of its axis (m).
    pub height: f64,
    /// From its axis to where it is held (m).
    pub length: f64,
    /// From the leaf to the lever (m).
    pub standoff: f64,
    /// Its thickness between the fingers (m).
    pub thickness: f64,
    /// The angle at which it stops (rad).
    pub stop: f64,
    /// Torque of its spring when it leaves its rest (Nm).
    pub torque: f64,
    /// The growth of that torque with its angle (Nm/rad).
    pub rate: f64,
}

impl Default for Description {
    /// The nominal door: 25 kg, 0.9 m wide, a closer, a lever, its hinge on the left; the robot pulls.
    fn default() -> Self {
        Self {
            side: Side::Left,
            swing: Swing::Pull,
            lock: Lock::Unlocked,
            radius: 0.82,
            leaf_beyond: 0.08,
            inertia: 6.75,
            closer: 8.0,
            closer_rate: 2.0,
            friction: 1.0,
            viscosity: 1.5,
            latch: Latch {
                angle: 28f64.to_radians(),
                play: 0.6 * std::f64::consts::PI / 180.0,
                stiffness: 1e5,
                damping: 400.0,
            },
            lever: Lever {
                height: 1.05,
                length: 0.09,
                standoff: 0.06,
                thickness: 0.02,
                stop: 45f64.to_radians(),
                torque: 0.6,
                rate: 1.8,
            },
        }
    }
}

/// The side of the hinge, as the robot sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The hinge is on the left; the lever points to the left as well.
    Left,
    /// The hinge is on the right; the lever points to the right as well.
    Right,
}

/// The direction in which the leaf opens, as the robot sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Swing {
    /// Towards the robot.
    Pull,
    /// Away from the robot.
    Push,
}

/// The state of the lock: a lever frees the latch only if the door is unlocked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lock {
    /// The lever frees the latch.
    Unlocked,
    /// The lever does not free the latch.
    Locked,
}

/// A door and its state.
#[derive(Clone, Debug, PartialEq)]
pub struct Door {
    description: Description,
    /// The angle of the leaf (rad), and its rate (rad/s), positive when it opens.
    pub angle: f64,
    rate: f64,
    /// The angle of the lever (rad), and its rate (rad/s), positive downwards.
    pub lever: f64,
    lever_rate: f64,
    /// The least angle of the leaf since the latch has caught it (rad): the bolt lets the leaf in, but not out.
    caught: Option<f64>,
}

/// Pose and motion of the handle in the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Handle {
    /// The pose of the handle: x along the lever, away from its axis, z into the door.
    pub world_from_handle: Isometry3<f64>,
    /// A point on the lever's axis (m).
    pub axis: Vector3<f64>,
    /// The direction out of the door, towards the robot, a unit vector.
    pub outward: Vector3<f64>,
    /// The velocity of the handle's origin (m/s).
    pub velocity: Vector3<f64>,
    /// The angular velocity (rad/s).
    pub angular: Vector3<f64>,
}

impl Door {
    /// Returns the closed door, with its lever up.
    pub fn new(description: Description) -> Self {
        Self { description, angle: 0.0, rate: 0.0, lever: 0.0, lever_rate: 0.0, caught: Some(0.0) }
    }

    /// Returns the description of the door.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// Returns the place of the hinge (m).
    pub fn hinge(&self) -> Vector2<f64> {
        Vector2::new(0.0, self.mirror() * self.description.radius)
    }

    /// Returns the place of the leaf's free edge (m).
    pub fn edge(&self) -> Vector2<f64> {
        self.hinge() + self.along() * (self.description.radius + self.description.leaf_beyond)
    }

    /// Returns +1 for a hinge on the left, -1 for a hinge on the right.
    pub fn mirror(&self) -> f64 {
        match self.description.side {
            Side::Left => 1.0,
            Side::Right => -1.0,
        }
    }

    /// Returns the sense in which the leaf turns when it opens: +1 for counter-clockwise seen from above, else -1.
    fn sense(&self) -> f64 {
        match self.description.swing {
            Swing::Pull => -self.mirror(),
            Swing::Push => self.mirror(),
        }
    }

    /// Returns the direction from the hinge along the leaf, a unit vector.
    fn along(&self) -> Vector2<f64> {
        let (s, c) = (self.sense() * self.angle).sin_cos();
        Vector2::new(s, -c) * self.mirror()
    }

    /// Returns pose and motion of the handle.
    pub fn handle(&self) -> Handle {
        let Description { radius, lever: is, .. } = self.description;
        let along = self.along().push(0.0);
        let (s, c) = (self.sense() * self.angle).sin_cos();
        let outward = Vector3::new(-c, -s, 0.0);
        let hinge = self.hinge().push(is.height);
        let axis = hinge + along * (radius + is.length) + outward * is.standoff;
        let lever = -along * self.lever.cos() - Vector3::z() * self.lever.sin();
        let origin = axis + lever * is.length;
        let basis = [lever, (-outward).cross(&lever), -outward];
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&basis));
        let leaf_angular = Vector3::z() * (self.sense() * self.rate);
        let lever_angular = self.lever_axis() * self.lever_rate;
        Handle {
            world_from_handle: Isometry3::from_parts(origin.into(), rotation),
            axis,
            outward,
            velocity: leaf_angular.cross(&(origin - hinge)) + lever_angular.cross(&(origin - axis)),
            angular: leaf_angular + lever_angular,
        }
    }

    /// Returns the axis about which the lever turns downwards.
    fn lever_axis(&self) -> Vector3<f64> {
        (-self.along().push(0.0)).cross(&-Vector3::z())
    }

    /// Lets a force (N) act on the leaf at the place `at` (m) for `dt` (s), both seen from above.
    pub fn push_leaf(&mut self, at: &Vector2<f64>, force: &Vector2<f64>, dt: f64) {
        self.rate += dt * self.sense() * (at - self.hinge()).perp(force) / self.description.inertia;
    }

    /// Applies a torque (Nm) that shuts the leaf for `dt` (s), like a visitor who leans on the leaf.
    pub fn push_shut(&mut self, torque: f64, dt: f64) {
        self.rate -= dt * torque / self.description.inertia;
    }

    /// Lets `dt` (s) pass with a force (N) and a torque (Nm) on the handle, in world axes.
    pub fn step(&mut self, force: &Vector3<f64>, torque: &Vector3<f64>, dt: f64) {
        let is = self.description;
        let handle = self.handle();
        let origin = handle.world_from_handle.translation.vector;
        let moment = (origin - self.hinge().push(is.lever.height)).cross(force).z + torque.z;
        let closer = if self.angle > 0.0 { is.closer + is.closer_rate * self.angle } else { 0.0 };
        let friction = is.viscosity * self.rate + is.friction * (self.rate / 0.01).tanh();
        let mut leaf = self.sense() * moment - friction - closer;
        let is_out = self.lever < is.latch.angle || is.lock == Lock::Locked;
        let caught = self.caught.or((self.angle < is.latch.play).then_some(self.angle)).filter(|_| is_out);
        self.caught = caught.map(|least| least.min(self.angle).max(0.0));
        // How far the leaf strains the frame, or the latch.
        let strain = if self.angle < 0.0 { Some(self.angle) } else { self.caught.map(|least| self.angle - least) };
        if let Some(strain) = strain.filter(|strain| *strain != 0.0) {
            leaf -= is.latch.stiffness * strain + is.latch.damping * self.rate;
        }
        let mut lever = ((origin - handle.axis).cross(force) + torque * FINGERS_TURN).dot(&self.lever_axis());
        lever -= is.lever.torque + is.lever.rate * self.lever + 0.05 * self.lever_rate;
        if self.lever < 0.0 {
            lever += is.lever.torque - 400.0 * self.lever - self.lever_rate;
        } else if self.lever > is.lever.stop {
            lever -= 400.0 * (self.lever - is.lever.stop) + self.lever_rate;
        }
        self.rate += dt * leaf / is.inertia;
        self.angle += dt * self.rate;
        self.lever_rate += dt * lever / LEVER_INERTIA;
        self.lever += dt * self.lever_rate;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EVERY_WAY: [(Side, Swing); 4] =
        [(Side::Left, Swing::Pull), (Side::Left, Swing::Push), (Side::Right, Swing::Pull), (Side::Right, Swing::Push)];

    fn door(side: Side, swing: Swing) -> Door {
        Door::new(Description { side, swing, ..Description::default() })
    }

    fn pulled(lock: Lock, lever: f64) -> f64 {
        let mut door = Door::new(Description { lock, ..Description::default() });
        for _ in 0..2000 {
            door.lever = lever;
            let force = door.handle().outward * 30.0;
            door.step(&force, &Vector3::zeros(), 1e-3);
        }
        door.angle.to_degrees()
    }

    #[test]
    fn latch_and_lock_hold() {
        // 30 N at 0.82 m less the closer's 8 Nm turn 6.75 kg m² by about a radian in 2 s; the latch yields 0.01
        // degrees.
        assert!(pulled(Lock::Unlocked, 0.6) > 40.0);
        assert!(pulled(Lock::Unlocked, 0.1).abs() < 0.1);
        assert!(pulled(Lock::Locked, 0.6).abs() < 0.1);
    }

    /// A latch that pulled the leaf shut at once used to throw it at the hand with 0.6 m/s.
    #[test]
    fn a_leaf_that_is_caught_ajar_goes_in_and_not_out() {
        let mut door = door(Side::Left, Swing::Pull);
        (door.lever, door.caught, door.angle) = (0.2, None, 0.01);
        let push = |door: &mut Door, force: f64| {
            let (force, before) = (door.handle().outward * force, door.angle);
            for _ in 0..100 {
                door.lever = 0.2;
                door.step(&force, &Vector3::zeros(), 1e-3);
                assert!(door.rate.abs() < 0.4, "{} rad/s", door.rate);
            }
            door.angle - before
        };
        assert!(push(&mut door, 30.0).abs() < 1e-3, "the latch holds it where it is");
        assert!(push(&mut door, -10.0) < -2e-3, "it can be shut");
        push(&mut door, 30.0);
        assert!(door.angle.abs() < 1e-3, "and stays so: {} rad", door.angle);
    }

    #[test]
    fn each_door_opens_its_own_way() {
        for (side, swing) in EVERY_WAY {
            let mut door = door(side, swing);
            // Every closed leaf is in the wall. Its handle is before the robot, and its lever points to the hinge.
            let handle = door.handle();
            assert!((handle.world_from_handle.translation.vector - Vector3::new(-0.06, 0.0, 1.05)).norm() < 1e-12);
            assert!((handle.outward + Vector3::x()).norm() < 1e-12 && door.edge().x.abs() < 1e-12);
            let lever = handle.world_from_handle.rotation * Vector3::x();
            assert!((lever - Vector3::y() * door.mirror()).norm() < 1e-12);
            // If the leaf is half a radian open, its edge is on the robot's side or on the other side.
            door.angle = 0.5;
            let towards = if swing == Swing::Pull { -1.0 } else { 1.0 };
            assert!((door.edge().x - towards * 0.9 * 0.5f64.sin()).abs() < 1e-12);
            assert!((door.edge() - door.hinge()).norm() - 0.9 < 1e-12);
        }
    }

    #[test]
    fn work_on_the_handle_is_the_energy_of_the_leaf() {
        // Without closer and friction, the work of a force along the handle's path is 1/2 I w².
        for (side, swing) in EVERY_WAY {
            let free = Description {
                side,
                swing,
                closer: 0.0,
                closer_rate: 0.0,
                friction: 0.0,
                viscosity: 0.0,
                ..Description::default()
            };
            let mut door = Door::new(free);
            door.angle = 0.2;
            let mut work = 0.0;
            for _ in 0..1000 {
                door.lever = 0.6;
                let towards = if swing == Swing::Pull { 20.0 } else { -20.0 };
                let force = door.handle().outward * towards;
                let before = door.handle();
                door.step(&force, &Vector3::zeros(), 1e-3);
                let leaf = |handle: &Handle| handle.axis - handle.outward * 0.06;
                work += force.dot(&(leaf(&door.handle()) - leaf(&before))) * 0.82 / 0.91;
            }
            // The lever turns a little within a step, and the leaf does not gain this part of the work.
            let energy = 0.5 * 6.75 * door.rate * door.rate;
            assert!((work - energy).abs() < 0.02 * energy, "{side:?} {swing:?}: {work} J, {energy} J");
        }
    }

    #[test]
    fn velocity_is_the_derivative() {
        for (side, swing) in EVERY_WAY {
            let mut door = door(side, swing);
            (door.angle, door.rate, door.lever, door.lever_rate) = (0.4, 0.3, 0.2, -0.5);
            let before = door.handle();
            (door.angle, door.lever) = (0.4 + 0.3e-6, 0.2 - 0.5e-6);
            let after = door.handle();
            let step = after.world_from_handle.translation.vector - before.world_from_handle.translation.vector;
            // A forward difference over 1 us: its error is the acceleration times half of that.
            assert!((step / 1e-6 - before.velocity).norm() < 1e-5);
            let turn = (after.world_from_handle.rotation * before.world_from_handle.rotation.inverse()).scaled_axis();
            assert!((turn / 1e-6 - before.angular).norm() < 1e-5);
        }
    }
}
