//! VisualServoing: brings the hand in front of the handle with the camera on the hand.

use crate::control::servoing::{self, Calibration, Mark, Way};
use crate::message::{CameraState, Velocity};
use crate::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Quantity, Stopping, Tick,
};
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use std::time::Duration;

/// The time for which one image is used: three periods of the camera, and a delay on a busy machine.
const IMAGE_FRESH: Duration = Duration::from_millis(160);
/// The longest wait for a handle that is out of sight.
const LOST: Duration = Duration::from_secs(5);

/// The parameters of controllers that use the camera: `focal` (px) and `standoff` (m) of [`Calibration`].
pub(super) const CALIBRATION: [Parameter; 2] = [
    Parameter::new("focal", Kind::Number(100.0, 5000.0)).or("600"),
    Parameter::new("standoff", Kind::Quantity(Quantity::Length, 0.2, 0.6)).or("0.3"),
];

/// Returns the calibration of the camera from the arguments.
pub(super) fn calibration(arguments: &Arguments) -> Calibration {
    Calibration { focal: arguments.number("focal"), standoff: arguments.number("standoff") }
}

/// The inputs of the controller.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The camera.
    #[device("camera/state")]
    camera: In<CameraState>,
}

/// The outputs of the controller.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The velocity of the hand.
    #[port("Out")]
    velocity: Out<Velocity>,
}

/// Brings the hand in front of the lever, and keeps it there. Stands still while the lever is out of sight, and gives up
/// after 5 s.
#[derive(Debug, Default)]
pub(super) struct VisualServoing {
    calibration: Calibration,
    seen: Option<(Time, [f64; 6])>,
    /// The last image.
    last: Option<[Option<[f64; 3]>; 4]>,
    way: Option<Way>,
    error: f64,
    started: Time,
}

impl Controller for VisualServoing {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "VisualServoing";

    fn about() -> About {
        About::service(
            "Brings the hand in front of the lever with the image of its camera of a focal length [px], and keeps it there with the \
             camera at a stand-off [m].",
        )
            .every(Duration::from_millis(20))
            .triggered_by("camera/state")
            .with(&CALIBRATION)
            .signals_every(Duration::from_millis(100))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { calibration: calibration(arguments), ..Self::default() })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self { calibration: self.calibration, ..Self::default() };
        Ok(())
    }

    fn run(&mut self, now: Time) {
        self.started = now;
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        // No two images are identical: if a camera hangs and sends its last image again, this image is ignored.
        let image = inputs.camera.fresh().map(|image| image.marks).filter(|marks| Some(*marks) != self.last);
        self.last = image.or(self.last);
        if let Some([Some(a), Some(b), Some(c), Some(d)]) = image {
            let seen = [a, b, c, d].map(|[u, v, depth]| Mark { pixel: [u, v], depth });
            let servo = servoing::servo(&seen, *self.way.get_or_insert_with(|| Way::nearer(&seen)), &self.calibration);
            self.error = servo.error;
            self.seen = Some((tick.now, servo.twist_in_tool.into()));
        }
        let followed = self.seen.filter(|(at, _)| tick.now.since(*at) <= IMAGE_FRESH);
        let twist = followed.map_or([0.0; 6], |(_, twist)| twist);
        outputs.velocity.send(Velocity::of_hand(twist));
        let since = self.seen.map_or(self.started, |(at, _)| at);
        if tick.now.since(since) > LOST {
            return Progress::Aborted("the handle has been out of sight for 5 s".to_owned());
        }
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, _: &Inputs, outputs: &mut Outputs) -> Stopping {
        // The controller that moves the hand learns of the end at once, and does not have to wait until the last
        // velocity expires.
        outputs.velocity.send(Velocity::REST);
        Stopping::Finished
    }

    fn signals(&self) -> Vec<Signal> {
        vec![Signal { name: "image error".into(), unit: "px".into(), value: self.error, headline: false }]
    }
}
