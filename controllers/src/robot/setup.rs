//! The setup of a simulated world: everything that differs from world to world. SI units throughout.

use super::camera::Camera;
use super::drive::Limits;
use super::{contact, door, force_torque, laser, room};
use crate::control::puma560::Joints;
use crate::sdk::Random;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// A world: the robot, its door, its sensors, and its faults.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Setup {
    /// The seed of the start pose, of the signs of all errors, and of the noise.
    pub seed: u64,
    /// The door.
    pub door: door::Description,
    /// The room.
    pub room: room::Description,
    /// The contact of hand and lever.
    pub contact: contact::Description,
    /// The drives and the wheels.
    pub machine: Machine,
    /// The errors of the sensors.
    pub sensors: Sensors,
    /// The start pose.
    pub start: Start,
    /// The faults.
    pub faults: Faults,
}

/// The description of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Machine {
    /// The drives of the base.
    pub base: Drives,
    /// The drives of the arm.
    pub arm: Drives,
    /// By which share the odometry believes too much, because the wheels are smaller than it believes.
    pub wheel_error: f64,
    /// The mass beyond the wrist sensor that the robot does not know (kg).
    pub payload: f64,
    /// A factor on how much a force slows down or speeds up the drives.
    pub droop: f64,
    /// A factor on the published strength of the arm's motors.
    pub torque_limit: f64,
    /// The force at which the base's wheels begin to slip (N).
    pub traction: f64,
    /// The largest force of the fingers (N).
    pub grip_force: f64,
    /// The speed at which they close and open (m/s).
    pub grip_speed: f64,
}

/// The description of the drives of base or arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drives {
    /// Time constant (s).
    pub lag: f64,
    /// A factor on the top speed.
    pub speed: f64,
    /// A factor on the acceleration.
    pub acceleration: f64,
}

impl Drives {
    /// Returns the limits of drives whose nominal limits are these.
    pub fn limits<const N: usize>(&self, nominal: &Limits<N>) -> Limits<N> {
        Limits {
            lag: self.lag,
            acceleration: nominal.acceleration.map(|most| most * self.acceleration),
            speed: nominal.speed.map(|most| most * self.speed),
        }
    }
}

impl Default for Machine {
    fn default() -> Self {
        Self {
            base: Drives { lag: 0.08, speed: 1.0, acceleration: 1.0 },
            arm: Drives { lag: 0.02, speed: 1.0, acceleration: 1.0 },
            wheel_error: 0.01,
            payload: 0.0,
            droop: 1.0,
            torque_limit: 1.0,
            traction: 200.0,
            grip_force: 40.0,
            grip_speed: 0.12,
        }
    }
}

/// The errors of the sensors: their noise, and wrong calibrations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensors {
    /// A factor for all noise in this setup.
    pub noise: f64,
    /// The wrist sensor.
    pub force: force_torque::Errors,
    /// The laser.
    pub laser: laser::Errors,
    /// The noise of a mark in the image (px, standard deviation).
    pub pixel_noise: f64,
    /// The noise of a depth, as a share of the depth (standard deviation).
    pub depth_noise: f64,
    /// The share by which the focal length is longer than the controllers assume.
    pub focal_error: f64,
    /// The largest displacement of the camera along each axis (m).
    pub camera_shift: f64,
    /// The largest turn of the camera about each axis (rad).
    pub camera_turn: f64,
    /// The largest offset of each encoder of the arm (rad).
    pub joint_offset: f64,
    /// The constant distance between the fingers that the gripper reports (m). If it is negative, the gripper reports
    /// the true one.
    pub grip_says: f64,
}

impl Default for Sensors {
    fn default() -> Self {
        Self {
            noise: 1.0,
            force: force_torque::Errors {
                force_noise: 0.4,
                torque_noise: 0.02,
                offset: 3.0,
                bias: 0.0,
                spike: 60.0,
                spikes: 0.0,
            },
            laser: laser::Errors { noise: 0.005, ..laser::Errors::default() },
            pixel_noise: 0.5,
            depth_noise: 0.03,
            focal_error: 0.0,
            camera_shift: 0.0,
            camera_turn: 0.0,
            joint_offset: 0.0,
            grip_says: -1.0,
        }
    }
}

/// The focal length (px) of the camera that the maker sold, and its distance behind the grasp point (m).
const FOCAL: f64 = 600.0;
const CAMERA_BEHIND: f64 = 0.12;

impl Sensors {
    /// Returns the camera with its true mounting; `random` draws the errors of its position and orientation.
    pub fn camera(&self, random: &mut Random) -> Camera {
        let mut within = |span: f64| Vector3::from_fn(|_, _| random.between(-span, span));
        let shift = Vector3::new(0.0, 0.0, -CAMERA_BEHIND) + within(self.camera_shift);
        let turn = UnitQuaternion::from_scaled_axis(within(self.camera_turn));
        Camera {
            tool_from_camera: Isometry3::from_parts(shift.into(), turn),
            focal: FOCAL * (1.0 + self.focal_error),
            pixel_noise: self.pixel_noise * self.noise,
            depth_noise: self.depth_noise * self.noise,
        }
    }

    /// Returns the offset of each encoder of the arm (rad).
    pub fn joint_offsets(&self, random: &mut Random) -> Joints {
        Joints::from_fn(|_, _| random.between(-self.joint_offset, self.joint_offset))
    }

    /// Returns the errors of the wrist sensor, noise included.
    pub fn force(&self) -> force_torque::Errors {
        let errors = self.force;
        let (force_noise, torque_noise) = (errors.force_noise * self.noise, errors.torque_noise * self.noise);
        force_torque::Errors { force_noise, torque_noise, ..errors }
    }

    /// Returns the errors of the laser, noise included.
    pub fn laser(&self) -> laser::Errors {
        laser::Errors { noise: self.laser.noise * self.noise, ..self.laser }
    }
}

/// The start pose of the robot: before the handle, looking at it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// The distance from the wall (m).
    pub distance: f64,
    /// The distance to the left of the handle (m).
    pub aside: f64,
    /// The yaw of the base, counter-clockwise from straight ahead (rad).
    pub yaw: f64,
    /// The seed moves the start pose by up to this multiple of 0.08 m, 0.06 m and 0.05 rad.
    pub spread: f64,
    /// The angle of joint 6 (rad): a quarter turn points the fingers' x axis to the left, three quarters to the right.
    pub wrist: f64,
}

impl Default for Start {
    fn default() -> Self {
        Self { distance: 1.75, aside: 0.22, yaw: -0.06, spread: 1.0, wrist: std::f64::consts::FRAC_PI_2 }
    }
}

/// The faults of a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Faults {
    /// The lever leaves the fingers for good when the door is this far open (rad).
    pub lose_at: f64,
    /// The trigger at which the base's wheels begin to turn on the spot.
    pub base_slip: Slip,
    /// For how long the wheels turn on the spot (s).
    pub base_slip_for: f64,
    /// A visitor begins to shut the door when it is first open by this angle (rad).
    pub shut_at: f64,
    /// The torque with which the visitor shuts the door (Nm).
    pub shut_torque: f64,
    /// For how long the visitor shuts the door (s).
    pub shut_for: f64,
    /// Something outside turns the base.
    pub turned: Turned,
    /// The steering encoder of one caster jumps.
    pub jump: Jump,
}

/// A turn of the base by something outside, such as a bump or a sliding mat. The wheels do not notice it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turned {
    /// The angle of the door at which the turn begins (rad).
    pub at: f64,
    /// The rate of the turn, counter-clockwise (rad/s).
    pub rate: f64,
    /// The duration of the turn (s).
    pub span: f64,
}

/// An encoder that jumps once and keeps the new offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jump {
    /// The angle of the door at which it jumps (rad).
    pub at: f64,
    /// The angle by which the encoder jumps (rad).
    pub by: f64,
}

/// The triggers of wheel slip; the first one counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// The time after the start (s).
    pub time: f64,
    /// The angle of the lever at which the slip begins (rad).
    pub lever: f64,
    /// The angle of the door at which the slip begins (rad).
    pub door: f64,
}

impl Default for Faults {
    /// No faults.
    fn default() -> Self {
        let never = f64::INFINITY;
        Self {
            lose_at: never,
            base_slip: Slip { time: never, lever: never, door: never },
            base_slip_for: 1.0,
            shut_at: never,
            shut_torque: 30.0,
            shut_for: 2.0,
            turned: Turned { at: never, rate: 0.1, span: 2.0 },
            jump: Jump { at: never, by: 0.5 },
        }
    }
}
