//! VisualServoing: brings the hand before the handle by what the camera on it sees.

use crate::control::servoing::{self, Seen, Way};
use crate::message::{CameraState, Velocity};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Out, Outputs, Progress, Stopping, Tick};
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use std::time::Duration;

/// How long one image is followed: three periods of the camera and a busy machine's hold-up.
const IMAGE_FRESH: Duration = Duration::from_millis(160);
/// How long it waits for a handle that is out of sight.
const LOST: Duration = Duration::from_secs(5);

/// What it hears.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The camera.
    #[device("camera/state")]
    camera: In<CameraState>,
}

/// What it says.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// How the hand shall move.
    #[port("Out")]
    velocity: Out<Velocity>,
}

/// Brings the hand before the lever and keeps it there; stands still when the lever is out of sight, gives up after 5 s.
#[derive(Debug, Default)]
pub(super) struct VisualServoing {
    seen: Option<(Time, [f64; 6])>,
    way: Option<Way>,
    error: f64,
    started: Time,
}

impl Controller for VisualServoing {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "VisualServoing";

    fn about() -> About {
        About::service("Brings the hand before the lever by what its camera sees, and keeps it there.")
            .every(Duration::from_millis(20))
            .triggered_by("camera/state")
            .signals_every(Duration::from_millis(100))
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self::default();
        Ok(())
    }

    fn run(&mut self, now: Time) {
        self.started = now;
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        if let Some([Some(a), Some(b), Some(c), Some(d)]) = inputs.camera.fresh().map(|image| image.marks) {
            let seen = [a, b, c, d].map(|[u, v, depth]| Seen { pixel: [u, v], depth });
            let servo = servoing::servo(&seen, *self.way.get_or_insert_with(|| Way::nearer(&seen)));
            self.error = servo.error;
            self.seen = Some((tick.now, servo.twist_in_tool.into()));
        }
        let followed = self.seen.filter(|(at, _)| tick.now.since(*at) <= IMAGE_FRESH);
        let twist = followed.map_or([0.0; 6], |(_, twist)| twist);
        outputs.velocity.send(Velocity { twist, null: [0.0; 9] });
        let since = self.seen.map_or(self.started, |(at, _)| at);
        if tick.now.since(since) > LOST {
            return Progress::Aborted("the handle has been out of sight for 5 s".to_owned());
        }
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, _: &Inputs, outputs: &mut Outputs) -> Stopping {
        // Whoever moves the hand learns at once, rather than when the last velocity has grown old.
        outputs.velocity.send(Velocity { twist: [0.0; 6], null: [0.0; 9] });
        Stopping::Finished
    }

    fn signals(&self) -> Vec<Signal> {
        vec![Signal { name: "image error".into(), unit: "px".into(), value: self.error, headline: false }]
    }
}
