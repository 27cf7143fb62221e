//! Two controllers for tests of values between runs: one leaves the next number each time, and the other writes down the
//! number that it starts with.

use controllers::sdk::{
    About, Arguments, Controller, Kind, Message, Outcome, Parameter, Progress, Registry, Tick, process,
};
use serde::{Deserialize, Serialize};
use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

/// The interval between two calculations.
const PERIOD: Duration = Duration::from_millis(1);

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Count {
    number: u64,
}

impl Message for Count {
    const TYPE: &'static str = "Count";
}

/// Leaves the number of its runs since the program was started.
struct Counter {
    number: u64,
}

impl Controller for Counter {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Counter";

    fn about() -> About {
        const NUMBER: &[Outcome] = &[Outcome { tag: "number", type_name: Some(Count::TYPE) }];
        About::task("Leaves the next number each time.").every(PERIOD).ends_with(NUMBER)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self { number: 0 })
    }

    fn main_calc(&mut self, _: Tick, (): &(), (): &mut ()) -> Progress {
        self.number += 1;
        Progress::outcome("number", &Count { number: self.number })
    }
}

/// Adds a line with its start value to a file.
struct Noter {
    path: PathBuf,
}

impl Controller for Noter {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Noter";

    fn about() -> About {
        const FILE: &[Parameter] = &[Parameter::new("file", Kind::Text(&[]))];
        About::task("Writes down its start value.").every(PERIOD).with(FILE).starts_with::<Count>()
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { path: arguments.text("file").into() })
    }

    fn init(&mut self, value: &[u8]) -> Result<(), String> {
        let start: Count = postcard::from_bytes(value).map_err(|why| format!("cannot read the start value: {why}"))?;
        let file = OpenOptions::new().create(true).append(true).open(&self.path);
        let written = file.and_then(|mut file| file.write_all(format!("{}\n", start.number).as_bytes()));
        written.map_err(|error| format!("cannot write `{}`: {error}", self.path.display()))
    }

    fn main_calc(&mut self, _: Tick, (): &(), (): &mut ()) -> Progress {
        Progress::done(&())
    }
}

fn main() -> ExitCode {
    let mut registry = Registry::default();
    registry.add::<Counter>();
    registry.add::<Noter>();
    process::run(&registry)
}
