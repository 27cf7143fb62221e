//! A value that goes to and fro between two programs: the counterpart of `ping.py`.

use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Bytes, Controller, In, Inputs, Kind, Message, Out, Outputs, Parameter, Progress, Registry,
    Stopping, Tick,
};
use std::time::{Duration, Instant};

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Frame {
    number: f64,
    image: Bytes,
}

impl Message for Frame {
    const TYPE: &'static str = "Frame";
    const FIELDS: &'static str = "number: Number, image: Bytes";
}

#[derive(Inputs)]
struct Back {
    #[port("In")]
    frame: In<Frame>,
}

#[derive(Outputs)]
struct Forth {
    #[port("Out")]
    frame: Out<Frame>,
}

/// Sends a frame, and the next one when that is back.
struct Ping {
    image: Bytes,
    rounds: usize,
    sent: Option<Instant>,
    times: Vec<f64>,
}

impl Controller for Ping {
    type Inputs = Back;
    type Outputs = Forth;
    const TYPE: &'static str = "RustPing";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("size", Kind::Number(0.0, 1e7)).or("64"),
            Parameter::new("rounds", Kind::Number(1.0, 1e7)).or("3000"),
        ];
        About::task("Times a value that goes to and fro.")
            .every(Duration::from_millis(100))
            .triggered_by("In")
            .with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let whole = |name| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the parameter has limits")]
            let number = arguments.number(name) as usize;
            number
        };
        let image = Bytes(vec![7; whole("size")]);
        Ok(Self { image, rounds: whole("rounds"), sent: None, times: Vec::new() })
    }

    #[expect(clippy::disallowed_methods, reason = "it is a clock's time that is measured here")]
    fn main_calc(&mut self, _: Tick, inputs: &Back, outputs: &mut Forth) -> Progress {
        if let (Some(_), Some(sent)) = (inputs.frame.fresh(), self.sent) {
            self.times.push(sent.elapsed().as_secs_f64());
        }
        if self.times.len() >= self.rounds {
            self.times.sort_by(f64::total_cmp);
            controllers_say(&format!("hop {:.1}", self.times[self.times.len() / 2] * 0.5e6));
            return Progress::Done(Vec::new());
        }
        self.sent = Some(Instant::now());
        #[expect(clippy::cast_precision_loss, reason = "it counts rounds")]
        outputs.frame.send(Frame { number: self.times.len() as f64, image: self.image.clone() });
        Progress::Continue
    }
}

#[expect(clippy::print_stdout, reason = "its log is its result")]
fn controllers_say(text: &str) {
    println!("{text}");
}

/// Sends each frame back.
struct Pong;

impl Controller for Pong {
    type Inputs = Back;
    type Outputs = Forth;
    const TYPE: &'static str = "RustPong";

    fn about() -> About {
        About::service("Sends each value back.").every(Duration::from_millis(100)).triggered_by("In")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, inputs: &Back, outputs: &mut Forth) -> Progress {
        if let Some(frame) = inputs.frame.fresh() {
            outputs.frame.send(frame.clone());
        }
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, _: &Back, _: &mut Forth) -> Stopping {
        Stopping::Finished
    }
}

/// Adds both.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Ping>().add::<Pong>();
}
