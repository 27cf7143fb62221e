//! Odometry: the pose that follows from the turns of the wheels alone.

use super::base::{Encoders, TRACK_HALF};
use super::museum::wrapped;
use super::{FloorPose, PERIOD};
use controllers::sdk::{About, Arguments, Controller, In, Inputs, Out, Outputs, Progress, Tick};

#[derive(Inputs)]
pub(super) struct OdometryInputs {
    /// The turns of the wheels.
    #[port("Encoders")]
    encoders: In<Encoders>,
}

#[derive(Outputs)]
pub(super) struct OdometryOutputs {
    /// The pose, in a frame that begins where the robot stood at the start. Its error grows with the way.
    #[port("Pose")]
    pose: Out<FloorPose>,
}

/// Adds up the turns of the wheels.
#[derive(Default)]
pub(super) struct Odometry {
    last: Option<Encoders>,
    pose: FloorPose,
}

/// Returns the pose after both wheels have turned further. The way between is an arc.
pub(super) fn moved(pose: FloorPose, left: f64, right: f64) -> FloorPose {
    let (forward, turned) = ((left + right) / 2.0, (right - left) / (2.0 * TRACK_HALF));
    let direction = pose.yaw + turned / 2.0;
    let (x, y) = (pose.x + forward * direction.cos(), pose.y + forward * direction.sin());
    FloorPose { x, y, yaw: wrapped(pose.yaw + turned) }
}

impl Controller for Odometry {
    type Inputs = OdometryInputs;
    type Outputs = OdometryOutputs;
    const TYPE: &'static str = "Odometry";

    fn about() -> About {
        About::service("Adds up the turns of the wheels.").remembers().every(PERIOD).triggered_by("Encoders")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn main_calc(&mut self, _: Tick, inputs: &OdometryInputs, outputs: &mut OdometryOutputs) -> Progress {
        if let Some(encoders) = inputs.encoders.fresh() {
            // The encoders count from their start, so a lost value loses no way.
            if let Some(last) = self.last.replace(*encoders) {
                self.pose = moved(self.pose, encoders.left - last.left, encoders.right - last.right);
            }
            outputs.pose.send(self.pose);
        }
        Progress::Continue
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wheels_that_turn_equally_go_straight_and_others_turn() {
        let start = FloorPose { x: 1.0, y: 1.0, yaw: 0.0 };
        assert_eq!(moved(start, 2.0, 2.0), FloorPose { x: 3.0, ..start });
        let turned = moved(start, -0.1, 0.1);
        assert!((turned.yaw - 0.5).abs() < 1e-9 && (turned.x - 1.0).abs() < 1e-9);
    }
}
