//! A machine that sometimes jams, a task that makes a part, and a task that clears a jam.

use crate::headline;
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Message, Out, Outputs, Parameter, Progress, Registry, Signal, Tick,
};
use std::time::Duration;

const PERIOD: Duration = Duration::from_millis(10);
/// How long a machine works at a part.
const WORK: Duration = Duration::from_millis(300);

/// A command to a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
enum MachineCommand {
    /// Make this part. The message is repeated until the part is made.
    Make { part: u32 },
    /// Open the doors and take out the jammed part.
    Clear,
}

impl Message for MachineCommand {
    const TYPE: &'static str = "MachineCommand";
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct MachineState {
    /// How many parts it has made.
    parts: u32,
    jammed: bool,
}

impl Message for MachineState {
    const TYPE: &'static str = "MachineState";
}

#[derive(Inputs)]
struct MachineInputs {
    /// From the client that works with it.
    #[port("In")]
    command: In<MachineCommand>,
}

#[derive(Outputs)]
struct MachineOutputs {
    /// At each period.
    #[port("Out")]
    state: Out<MachineState>,
}

/// Makes parts, one in 0.3 s; jams in the middle of its first parts, as often as its argument requires.
#[derive(Debug)]
struct Machine {
    jams_left: f64,
    state: MachineState,
    work: Duration,
}

impl Machine {
    fn obey(&mut self, command: MachineCommand, elapsed: Duration) {
        match command {
            MachineCommand::Clear => (self.state.jammed, self.work) = (false, Duration::ZERO),
            // A part that is already made is not made again.
            MachineCommand::Make { part } if part <= self.state.parts || self.state.jammed => {}
            MachineCommand::Make { .. } => {
                self.work += elapsed;
                if self.jams_left >= 1.0 && self.work > WORK / 2 {
                    (self.state.jammed, self.jams_left) = (true, self.jams_left - 1.0);
                } else if self.work >= WORK {
                    (self.state.parts, self.work) = (self.state.parts + 1, Duration::ZERO);
                }
            }
        }
    }
}

impl Controller for Machine {
    type Inputs = MachineInputs;
    type Outputs = MachineOutputs;
    const TYPE: &'static str = "Machine";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("jams", Kind::Number(0.0, 100.0)).or("0")];
        About::service("Makes parts; jams so many times before it works.")
            .remembers()
            .every(PERIOD)
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(50))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let state = MachineState { parts: 0, jammed: false };
        Ok(Self { jams_left: arguments.number("jams"), state, work: Duration::ZERO })
    }

    fn main_calc(&mut self, tick: Tick, inputs: &MachineInputs, outputs: &mut MachineOutputs) -> Progress {
        // A client repeats its command all the time: a machine without recent commands stops.
        if let Some(command) = inputs.command.fresh_within(tick.now, Duration::from_millis(100)) {
            self.obey(*command, tick.elapsed);
        }
        outputs.state.send(self.state.clone());
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        vec![
            headline("parts", "", f64::from(self.state.parts)),
            headline("jammed", "", f64::from(u8::from(self.state.jammed))),
        ]
    }
}

#[derive(Inputs)]
struct ClientInputs {
    /// From the machine.
    #[port("In")]
    state: In<MachineState>,
}

#[derive(Outputs)]
struct ClientOutputs {
    /// To the machine.
    #[port("Out")]
    command: Out<MachineCommand>,
}

/// Makes one part; aborts when the machine jams.
#[derive(Debug, Default)]
struct MakePart {
    /// The number of the part; known once the machine has reported how many there are.
    part: Option<u32>,
}

impl Controller for MakePart {
    type Inputs = ClientInputs;
    type Outputs = ClientOutputs;
    const TYPE: &'static str = "MakePart";

    fn about() -> About {
        About::task("Makes one part; aborts when the machine jams.").every(PERIOD)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.part = None;
        Ok(())
    }

    fn main_calc(&mut self, _: Tick, inputs: &ClientInputs, outputs: &mut ClientOutputs) -> Progress {
        let Some(state) = inputs.state.fresh() else { return Progress::Continue };
        let part = *self.part.get_or_insert(state.parts + 1);
        if state.jammed {
            return Progress::Aborted("the machine is jammed".to_owned());
        }
        if state.parts >= part {
            return Progress::Done(Vec::new());
        }
        outputs.command.send(MachineCommand::Make { part });
        Progress::Continue
    }
}

/// Clears a jam.
#[derive(Debug)]
struct ClearJam;

impl Controller for ClearJam {
    type Inputs = ClientInputs;
    type Outputs = ClientOutputs;
    const TYPE: &'static str = "ClearJam";

    fn about() -> About {
        About::task("Clears a jam, and ends when the machine is free.").every(PERIOD)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, inputs: &ClientInputs, outputs: &mut ClientOutputs) -> Progress {
        match inputs.state.fresh() {
            Some(state) if !state.jammed => Progress::Done(Vec::new()),
            Some(_) | None => {
                outputs.command.send(MachineCommand::Clear);
                Progress::Continue
            }
        }
    }
}

pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Machine>().add::<MakePart>().add::<ClearJam>();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_that_jammed_works_once_it_is_cleared() {
        let mut machine =
            Machine { jams_left: 1.0, state: MachineState { parts: 0, jammed: false }, work: Duration::ZERO };
        let make = MachineCommand::Make { part: 1 };
        (0..100).for_each(|_| machine.obey(make, PERIOD));
        assert_eq!(machine.state, MachineState { parts: 0, jammed: true });
        machine.obey(MachineCommand::Clear, PERIOD);
        (0..100).for_each(|_| machine.obey(make, PERIOD));
        assert_eq!(machine.state, MachineState { parts: 1, jammed: false });
    }
}
