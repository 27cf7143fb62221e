//! The messages of the paper's processes and of the devices. SI units throughout.
//!
//! A stamp is the time at which the device measured, on the clock of the device's host. On one host, stamps compare
//! with every controller's clock. Between hosts they do not, and the time of arrival is used instead.
//!
//! The tool frame is at the grasp point, z along the approach; the base frame is the centre of the base on the floor.

use crate::sdk::Message;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Defines messages. If a field names its type in a spec, `dca check` compares more than the name.
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
    // If the first field of a message is a stamp, this is the time of its measurement.
    (@stamp stamp $($field:ident)*) => {
        fn stamp(&self) -> Option<Time> {
            Some(self.stamp)
        }
    };
    // A message that passes on a measurement has the time of this measurement in `measured`.
    (@stamp measured $($field:ident)*) => {
        fn stamp(&self) -> Option<Time> {
            Duration::try_from_secs_f64(self.measured).ok().map(|since| Time::ZERO + since)
        }
    };
    (@stamp $($field:ident)*) => {};
}

messages! {
    /// A velocity for the hand, and desired motions for the rest of the robot.
    Velocity {
        /// The velocity of the grasp point along tool axes: linear (m/s), then angular (rad/s).
        twist: [f64; 6] = "Number[6]",
        /// A desired motion in the null space, which does not move the hand: base x, y (m/s), yaw (rad/s), six joints
        /// (rad/s).
        null: [f64; 9] = "Number[9]",
        /// Whether the base must not turn; the arm turns in its place.
        steady: bool = "Truth",
        /// Whether the hand comes to rest. Then no other velocity adds to this one, and the base stays where it is. A
        /// twist of zero means that the load is off the hand.
        rests: bool = "Truth",
    }
    /// The force and torque of contacts on the hand.
    Wrench {
        /// The time of measurement by the device's stamp (s since the origin of its host's clock).
        measured: f64 = "Time",
        /// The force (N), tool axes.
        force: [f64; 3] = "Force[3]",
        /// The torque (Nm) about the grasp point, tool axes.
        torque: [f64; 3] = "Torque[3]",
    }
    /// The direction in which another law leads the hand. The hand gives way only across this direction.
    Constraint {
        /// Unit vector along which the hand is led, tool axes.
        tangent: [f64; 3] = "Number[3]",
        /// Unit vector upwards, tool axes.
        up: [f64; 3] = "Number[3]",
        /// Whether the hand may give way upwards and downwards.
        upward: bool = "Truth",
        /// Whether another law turns the hand about the vertical. Then the compliance law does not move the hand.
        turned: bool = "Truth",
    }
    /// The arm's joints.
    JointState {
        /// The time of measurement by the device's stamp (s since the origin of its host's clock).
        measured: f64 = "Time",
        /// The angles of the joints (rad).
        angles: [f64; 6] = "Angle[6]",
        /// The rates of the joints (rad/s).
        rates: [f64; 6] = "AngularSpeed[6]",
    }
    /// Commanded rates of the arm's joints.
    JointVelocity {
        /// The rates of the joints (rad/s).
        rates: [f64; 6] = "AngularSpeed[6]",
        /// Whether the load is off the hand and nothing has moved the hand since. Then an arm that stops stays where it
        /// is.
        rests: bool = "Truth",
    }
    /// A commanded velocity of the base.
    BaseVelocity {
        /// The rates: x, y (m/s), yaw (rad/s), base axes.
        rates: [f64; 3] = "Number[3]",
    }
    /// The pose of the base by dead reckoning.
    BasePose {
        /// The time of measurement by the device's stamp (s since the origin of its host's clock).
        measured: f64 = "Time",
        /// The pose: x, y (m), yaw (rad), in the frame of the first sample.
        pose: [f64; 3] = "Number[3]",
    }
    /// The base as its server shows it. Times are measured from the start of the host.
    BaseStatus {
        /// The pose by dead reckoning: x, y (m), yaw (rad), in the frame of the server's start.
        pose: [f64; 3] = "Number[3]",
        /// The velocity: x, y (m/s), yaw (rad/s), base axes.
        velocity: [f64; 3] = "Number[3]",
        /// When a command was last obeyed (s). 0 if no command was obeyed.
        commanded: f64 = "Time",
        /// When the watchdog last ended a command (s); 0 if it never did.
        stopped: f64 = "Time",
        /// The number of refused commands: without the lock, or under a grant that is over.
        refused: f64 = "Number",
        /// The holder of the lock; empty if there is none.
        holder: String = "Text",
    }
    /// The arm as its server shows it. Times are measured from the start of the host.
    ArmStatus {
        /// The angles of the joints (rad).
        angles: [f64; 6] = "Angle[6]",
        /// The rates of the joints (rad/s).
        rates: [f64; 6] = "AngularSpeed[6]",
        /// When a command was last obeyed (s). 0 if no command was obeyed.
        commanded: f64 = "Time",
        /// When the watchdog last ended a command (s); 0 if it never did.
        stopped: f64 = "Time",
        /// The number of refused commands: without the lock, or under a grant that is over.
        refused: f64 = "Number",
        /// The holder of the lock; empty if there is none.
        holder: String = "Text",
    }
    /// The gripper as its server shows it. Times are measured from the start of the host.
    GripperStatus {
        /// The distance between the fingers (m).
        width: f64 = "Length",
        /// The force with which the fingers press (N).
        force: f64 = "Force",
        /// When a command was last obeyed (s). 0 if no command was obeyed.
        commanded: f64 = "Time",
        /// The number of refused commands: without the lock, or under a grant that is over.
        refused: f64 = "Number",
        /// The holder of the lock; empty if there is none.
        holder: String = "Text",
    }
    /// A width for the fingers to go to.
    Grip {
        /// The distance between the fingers (m).
        width: f64 = "Length",
        /// The largest force with which the fingers press (N).
        force: f64 = "Force",
    }
    /// One sweep of the laser.
    LaserScan {
        /// The ranges from right to left (m), half a degree apart, from -90 to 90 degrees about straight ahead.
        ranges: Vec<f64> = "Length[]",
    }
    /// Device `arm`: the readings of its encoders.
    ArmState {
        /// The time of the measurement, on the device's clock.
        stamp: Time,
        /// The angles of the joints (rad).
        angles: [f64; 6],
        /// The rates of the joints (rad/s).
        rates: [f64; 6],
    }
    /// Device `arm`: joint velocities to hold for at most 100 ms.
    ArmCommand {
        /// The name of the sender. Commands of another sender are ignored until 100 ms after this sender's last
        /// command.
        owner: String,
        /// The rates of the joints (rad/s); none to let go of the device.
        rates: Option<[f64; 6]>,
        /// The fencing number under which the device is held; none where no lock is used.
        fence: Option<u64>,
    }
    /// Device `base`: the readings of its encoders and its bumper.
    BaseState {
        /// The time of the measurement, on the device's clock.
        stamp: Time,
        /// Steering angles of the casters (rad).
        steering: [f64; 4],
        /// Rolling angles of the wheels (rad).
        rolling: [f64; 4],
        /// Whether the bumper is pressed.
        bumped: bool,
    }
    /// Device `base`: a velocity to hold for at most 100 ms.
    BaseCommand {
        /// The name of the sender, as in [`ArmCommand`].
        owner: String,
        /// The velocity: x, y (m/s), yaw (rad/s), base axes; none to let go of the device.
        velocity: Option<[f64; 3]>,
        /// The fencing number under which the device is held; none where no lock is used.
        fence: Option<u64>,
    }
    /// Device `ft`: the wrench on the hand, tool axes, without the weight of the tool.
    FtState {
        /// The time of the measurement, on the device's clock.
        stamp: Time,
        /// The force (N).
        force: [f64; 3],
        /// The torque (Nm).
        torque: [f64; 3],
        /// How often the sensor has been set to zero.
        zeroed: u32,
    }
    /// Device `ft`: sets its present measurement to zero.
    FtCommand {
        /// The command is only obeyed if [`FtState::zeroed`] has this value, so a repeated command does no harm.
        after: u32,
    }
    /// Device `gripper`: its measurements.
    GripperState {
        /// The time of the measurement, on the device's clock.
        stamp: Time,
        /// The distance between the fingers (m).
        width: f64,
        /// The force with which the fingers press (N).
        force: f64,
    }
    /// Device `gripper`: a width for the fingers to go to. The gripper holds the last command.
    GripperCommand {
        /// The name of the sender, as in [`ArmCommand`].
        owner: String,
        /// The distance between the fingers (m); none to let go of the device.
        width: Option<f64>,
        /// The largest force with which the fingers press (N).
        force: f64,
        /// The fencing number under which the device is held; none where no lock is used.
        fence: Option<u64>,
    }
    /// Device `laser`: one sweep, as in [`LaserScan`].
    LaserState {
        /// The time of the measurement, on the device's clock.
        stamp: Time,
        /// The ranges (m), as in [`LaserScan`].
        ranges: Vec<f64>,
    }
    /// Device `camera`: the marks of a lever handle, as found in one image.
    CameraState {
        /// The time of the measurement, on the device's clock.
        stamp: Time,
        /// Column, row (px) and depth (m) of each mark; none for a mark that is not seen.
        marks: [Option<[f64; 3]>; 4],
    }
}

impl Velocity {
    /// The hand at rest.
    pub const REST: Self = Self { twist: [0.0; 6], null: [0.0; 9], steady: false, rests: false };

    /// Returns a motion of the hand (m/s, rad/s, tool axes) without any wish for the rest of the robot.
    pub fn of_hand(twist: [f64; 6]) -> Self {
        Self { twist, ..Self::REST }
    }

    /// Returns whether the velocity asks for no motion at all.
    pub fn moves_nothing(&self) -> bool {
        self.twist.iter().chain(&self.null).all(|rate| rate.abs() <= 0.0)
    }
}
