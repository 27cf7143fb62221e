//! The messages of the paper's processes and of the devices. SI units throughout.
//!
//! Stamps are times of the clock of the host that the device is at, when the device measured; on one host they compare with
//! every controller's clock. Between hosts they do not: there the arrival counts.
//!
//! The tool frame is at the grasp point, z along the approach; the base frame is the centre of the base on the floor.

use crate::sdk::Message;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Messages. If a field names its type in a spec, `dca check` compares more than the name.
macro_rules! messages {
    ($($(#[$meta:meta])* $name:ident { $($(#[$field_meta:meta])* $field:ident: $type:ty $(= $kind:literal)?,)+ })+) => {
        $($(#[$meta])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        pub struct $name { $($(#[$field_meta])* pub $field: $type,)+ }
        impl Message for $name {
            const TYPE: &'static str = stringify!($name);
            const FIELDS: &'static str = concat!($($(stringify!($field), ": ", $kind, ", ",)?)+);
            messages!(@stamp $($field)+);
        })+
    };
    // A message whose first field is a stamp was measured then.
    (@stamp stamp $($field:ident)*) => {
        fn stamp(&self) -> Option<Time> {
            Some(self.stamp)
        }
    };
    // A message that passes on a measurement has the time of that measurement in `measured`.
    (@stamp measured $($field:ident)*) => {
        fn stamp(&self) -> Option<Time> {
            Duration::try_from_secs_f64(self.measured).ok().map(|since| Time::ZERO + since)
        }
    };
    (@stamp $($field:ident)*) => {};
}

messages! {
    /// A velocity for the hand, and wishes for the rest of the robot.
    Velocity {
        /// Linear (m/s), then angular (rad/s), of the grasp point along tool axes.
        twist: [f64; 6] = "Number[6]",
        /// A desired motion in the null space, which the hand does not notice: base x, y (m/s), yaw (rad/s), six joints
        /// (rad/s).
        null: [f64; 9] = "Number[9]",
        /// The base does not turn; the arm turns in its place.
        steady: bool = "Truth",
        /// The hand comes to rest: no other velocity adds to this one, and the base stays where it is. A twist of zero
        /// says that the load is off the hand.
        rests: bool = "Truth",
    }
    /// The force and torque of contacts on the hand.
    Wrench {
        /// The time of measurement by the device's stamp (s since the origin of its host's clock).
        measured: f64 = "Time",
        /// (N), tool axes.
        force: [f64; 3] = "Force[3]",
        /// (Nm) about the grasp point, tool axes.
        torque: [f64; 3] = "Torque[3]",
    }
    /// The direction in which the hand is led, for compliance beside it.
    Constraint {
        /// Unit vector along which the hand is led, tool axes.
        tangent: [f64; 3] = "Number[3]",
        /// Unit vector upwards, tool axes.
        up: [f64; 3] = "Number[3]",
        /// The hand may give way upwards and downwards.
        upward: bool = "Truth",
        /// Another law turns the hand about the vertical, so compliance does not.
        turned: bool = "Truth",
    }
    /// The arm's joints.
    JointState {
        /// The time of measurement by the device's stamp (s since the origin of its host's clock).
        measured: f64 = "Time",
        /// (rad).
        angles: [f64; 6] = "Angle[6]",
        /// (rad/s).
        rates: [f64; 6] = "AngularSpeed[6]",
    }
    /// Commanded rates of the arm's joints.
    JointVelocity {
        /// (rad/s).
        rates: [f64; 6] = "AngularSpeed[6]",
        /// The load is off the hand, and nothing has moved it since: an arm that stops stays where it is.
        rests: bool = "Truth",
    }
    /// A commanded velocity of the base.
    BaseVelocity {
        /// x, y (m/s), yaw (rad/s), base axes.
        rates: [f64; 3] = "Number[3]",
    }
    /// The pose of the base by dead reckoning.
    BasePose {
        /// The time of measurement by the device's stamp (s since the origin of its host's clock).
        measured: f64 = "Time",
        /// x, y (m), yaw (rad), in the frame of the first sample.
        pose: [f64; 3] = "Number[3]",
    }
    /// The base as its server shows it. Times are since the host was started.
    BaseStatus {
        /// x, y (m), yaw (rad) by dead reckoning, in the frame of the server's start.
        pose: [f64; 3] = "Number[3]",
        /// x, y (m/s), yaw (rad/s), base axes.
        velocity: [f64; 3] = "Number[3]",
        /// When a command was obeyed last; 0 if none was (s).
        commanded: f64 = "Time",
        /// When the watchdog has ended a command last; 0 if it never had to (s).
        stopped: f64 = "Time",
        /// How many commands were refused: without the lock, or under a grant that is over.
        refused: f64 = "Number",
        /// The holder of the lock; empty if there is none.
        holder: String = "Text",
    }
    /// The arm as its server shows it. Times are since the host was started.
    ArmStatus {
        /// (rad).
        angles: [f64; 6] = "Angle[6]",
        /// (rad/s).
        rates: [f64; 6] = "AngularSpeed[6]",
        /// As of the base (s).
        commanded: f64 = "Time",
        /// As of the base (s).
        stopped: f64 = "Time",
        /// As of the base.
        refused: f64 = "Number",
        /// As of the base.
        holder: String = "Text",
    }
    /// The gripper as its server shows it. Times are since the host was started.
    GripperStatus {
        /// Between the fingers (m).
        width: f64 = "Length",
        /// With which they press (N).
        force: f64 = "Force",
        /// As of the base (s).
        commanded: f64 = "Time",
        /// As of the base.
        refused: f64 = "Number",
        /// As of the base.
        holder: String = "Text",
    }
    /// A width for the fingers to go to.
    Grip {
        /// Between the fingers (m).
        width: f64 = "Length",
        /// They press with no more than this (N).
        force: f64 = "Force",
    }
    /// One sweep of the laser.
    LaserScan {
        /// From right to left, half a degree apart, from -90 to 90 degrees about straight ahead (m).
        ranges: Vec<f64> = "Length[]",
    }
    /// Device `arm`: what its encoders say.
    ArmState {
        /// On the device's clock.
        stamp: Time,
        /// (rad).
        angles: [f64; 6],
        /// (rad/s).
        rates: [f64; 6],
    }
    /// Device `arm`: joint velocities to hold for at most 100 ms.
    ArmCommand {
        /// The name of the speaker; another one is not heard until 100 ms after this one's last word.
        owner: String,
        /// (rad/s); none to let go of the device.
        rates: Option<[f64; 6]>,
        /// The fencing number under which the device is held; none where no lock is used.
        fence: Option<u64>,
    }
    /// Device `base`: what its encoders say.
    BaseState {
        /// On the device's clock.
        stamp: Time,
        /// Steering angles of the casters (rad).
        steering: [f64; 4],
        /// Rolling angles of the wheels (rad).
        rolling: [f64; 4],
        /// Whether its bumper is pressed.
        bumped: bool,
    }
    /// Device `base`: a velocity to hold for at most 100 ms.
    BaseCommand {
        /// As for the arm.
        owner: String,
        /// x, y (m/s), yaw (rad/s), base axes; none to let go of the device.
        velocity: Option<[f64; 3]>,
        /// The fencing number under which the device is held; none where no lock is used.
        fence: Option<u64>,
    }
    /// Device `ft`: the wrench on the hand, tool axes, tool weight removed.
    FtState {
        /// On the device's clock.
        stamp: Time,
        /// (N).
        force: [f64; 3],
        /// (Nm).
        torque: [f64; 3],
        /// The number of times it has been set to zero.
        zeroed: u32,
    }
    /// Device `ft`: sets its present measurement to zero.
    FtCommand {
        /// Only if [`FtState::zeroed`] is this; so a repeated command does no harm.
        after: u32,
    }
    /// Device `gripper`.
    GripperState {
        /// On the device's clock.
        stamp: Time,
        /// Between the fingers (m).
        width: f64,
        /// With which they press (N).
        force: f64,
    }
    /// Device `gripper`: a width to go to; it holds the last command.
    GripperCommand {
        /// As for the arm.
        owner: String,
        /// (m); none to let go of the device.
        width: Option<f64>,
        /// The fingers press with no more than this (N).
        force: f64,
        /// The fencing number under which the device is held; none where no lock is used.
        fence: Option<u64>,
    }
    /// Device `laser`: one sweep, as in [`LaserScan`].
    LaserState {
        /// On the device's clock.
        stamp: Time,
        /// (m).
        ranges: Vec<f64>,
    }
    /// Device `camera`: the marks of a lever handle, as found in one image.
    CameraState {
        /// On the device's clock.
        stamp: Time,
        /// Column, row (px) and depth (m) of each mark that is seen.
        marks: [Option<[f64; 3]>; 4],
    }
}

impl Velocity {
    /// The hand at rest.
    pub const REST: Self = Self { twist: [0.0; 6], null: [0.0; 9], steady: false, rests: false };

    /// Returns a motion of the hand (m/s, rad/s, tool axes) that leaves it to others how the rest of the robot moves.
    pub fn of_hand(twist: [f64; 6]) -> Self {
        Self { twist, ..Self::REST }
    }

    /// Returns whether it asks for no motion at all.
    pub fn moves_nothing(&self) -> bool {
        self.twist.iter().chain(&self.null).all(|rate| rate.abs() <= 0.0)
    }
}
