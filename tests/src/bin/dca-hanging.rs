//! A controller for tests. It hangs in the requested place, or works well at 1 kHz.

use comms::io::clock::Wakeup;
use controllers::sdk::{About, Arguments, Controller, Kind, Parameter, Progress, Registry, Tick, process};
use std::process::ExitCode;
use std::time::Duration;

/// The interval between two calculations.
const PERIOD: Duration = Duration::from_millis(1);
/// The places where it may hang.
const PLACES: &[&str] = &["none", "new", "init", "main_calc"];
/// The number of the calculation after which it hangs.
const CALCULATIONS: u32 = 200;

struct Hanging {
    place: String,
    calculations: u32,
}

impl Hanging {
    /// Never returns if this is the requested place.
    fn hang_in(&self, place: &str) {
        if self.place == place {
            loop {
                Wakeup::default().wait(None);
            }
        }
    }
}

impl Controller for Hanging {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Hanging";

    fn about() -> About {
        const PLACE: &[Parameter] = &[Parameter::new("place", Kind::Text(PLACES))];
        About::service("Hangs in `new`, in `init` or in `main_calc`, or not at all.").every(PERIOD).with(PLACE)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let hanging = Self { place: arguments.text("place").to_owned(), calculations: 0 };
        hanging.hang_in("new");
        Ok(hanging)
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.hang_in("init");
        self.calculations = 0;
        Ok(())
    }

    fn main_calc(&mut self, _: Tick, (): &(), (): &mut ()) -> Progress {
        self.calculations += 1;
        if self.calculations > CALCULATIONS {
            self.hang_in("main_calc");
        }
        Progress::Continue
    }
}

fn main() -> ExitCode {
    let mut registry = Registry::default();
    registry.add::<Hanging>();
    process::run(&registry)
}
