//! A source at 1 kHz, eight stages one behind the other, and a sink at each: 17 programs, started by a node from a spec. Nothing may be
//! missed.

use crate::figures::{Round, Subject, Table};
use crate::node::{HOST, Node};
use crate::programs::times_of;
use anyhow::Context;
use controllers::sdk::{
    About, Arguments, Controller, Every, Inputs, Kind, Message, Out, Outputs, Parameter, Progress, Registry, Tick,
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How many stages, and sinks.
const STAGES: u32 = 8;
/// The source's period.
const PERIOD: Duration = Duration::from_millis(1);
/// How many values it sends, and how many periods it rests before and after them.
const VALUES: u64 = 10_000;
const REST: u64 = 500;

/// Values, each with its number and when it was sent, in nanoseconds. Several if a stage has had several at once.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Steps(Vec<(u64, u64)>);

impl Message for Steps {
    const TYPE: &'static str = "Steps";
}

#[derive(Inputs)]
struct In {
    #[port("In")]
    steps: Every<Steps>,
}

#[derive(Outputs)]
struct Onward {
    #[port("Out")]
    out: Out<Steps>,
}

/// Sends, and is done some time after its last value.
struct Head(u64);

impl Controller for Head {
    type Inputs = ();
    type Outputs = Onward;
    const TYPE: &'static str = "Head";

    fn about() -> About {
        About::task("Sends numbers at 1 kHz.").every(PERIOD)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self(0))
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut Onward) -> Progress {
        self.0 += 1;
        if (REST + 1..=REST + VALUES).contains(&self.0) {
            outputs.out.send(Steps(vec![(self.0 - REST, tick.now.nanos())]));
        }
        if self.0 > VALUES + 2 * REST { Progress::Done(Vec::new()) } else { Progress::Continue }
    }
}

/// Passes on what it gets.
struct Stage;

impl Controller for Stage {
    type Inputs = In;
    type Outputs = Onward;
    const TYPE: &'static str = "Stage";

    fn about() -> About {
        About::service("Passes on.").every(PERIOD * 1000).triggered_by("In")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, inputs: &In, outputs: &mut Onward) -> Progress {
        let steps: Vec<(u64, u64)> = inputs.steps.iter().flat_map(|steps| steps.0.iter().copied()).collect();
        if !steps.is_empty() {
            outputs.out.send(Steps(steps));
        }
        Progress::Continue
    }
}

/// Keeps how old each value was that came; writes them to a file when its program ends.
struct Sink {
    file: PathBuf,
    ages: Vec<u64>,
}

impl Controller for Sink {
    type Inputs = In;
    type Outputs = ();
    const TYPE: &'static str = "Sink";

    fn about() -> About {
        const FILE: &[Parameter] = &[Parameter::new("file", Kind::Text(&[]))];
        About::service("Keeps ages.").every(PERIOD * 1000).triggered_by("In").with(FILE)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { file: arguments.text("file").into(), ages: Vec::new() })
    }

    fn main_calc(&mut self, tick: Tick, inputs: &In, (): &mut ()) -> Progress {
        let steps = inputs.steps.iter().flat_map(|steps| &steps.0);
        self.ages.extend(steps.map(|(_, sent)| tick.now.nanos().saturating_sub(*sent)));
        Progress::Continue
    }
}

impl Drop for Sink {
    fn drop(&mut self) {
        let bytes: Vec<u8> = self.ages.iter().flat_map(|age| age.to_le_bytes()).collect();
        // The reader says that the file is missing.
        std::fs::write(&self.file, bytes).unwrap_or_default();
    }
}

/// Adds the controllers.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Head>();
    registry.add::<Stage>();
    registry.add::<Sink>();
}

/// Measures, and adds its lines.
pub(crate) async fn measure(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    let dir = dir.join("caterpillar");
    std::fs::create_dir(&dir)?;
    let mut node = Node::start(&dir).await?;
    let file = |number: u32| dir.join(format!("sink{number}"));
    let mut deployment = node.deploy(&spec(file))?;
    while deployment.next().await?.is_some() {}
    node.end().await?;
    table.heading("caterpillar, 1 kHz, from the source to each sink", "missed", "most");
    for number in 1..=STAGES {
        let times = times_of(&std::fs::read(file(number)).with_context(|| format!("sink {number}"))?);
        let most = times.iter().max().copied().unwrap_or_default();
        let missed = VALUES.saturating_sub(u64::try_from(times.len())?);
        let mut subject = Subject::default();
        subject.push(Round::of(times).context("nothing came")?);
        let verdict = if missed == 0 { "0 (reached: 0)".to_owned() } else { format!("{missed} (missed: 0)") };
        table.line(&format!("over {} wires", number + 1), &subject, [verdict, format!("{most:.1?}")]);
    }
    Ok(())
}

fn spec(file: impl Fn(u32) -> PathBuf) -> String {
    let (mut instances, mut wires) = (format!("head instof Head(\"{HOST}\");"), String::new());
    let mut all = vec!["head".to_owned()];
    for number in 1..=STAGES {
        let before = if number == 1 { "head".to_owned() } else { format!("stage{}", number - 1) };
        let path = file(number);
        instances +=
            &format!("stage{number} instof Stage(\"{HOST}\"); sink{number} instof Sink(\"{HOST}\", {path:?});");
        wires += &format!("{before}, Out -> stage{number}, In queue 8000;");
        wires += &format!("stage{number}, Out -> sink{number}, In queue 8000;");
        all.extend([format!("stage{number}"), format!("sink{number}")]);
    }
    let actions = all.join(", ");
    format!(
        "process main() {{
            host {{ \"{HOST}\" }}
            instantiated_processes {{ {instances} }}
            internal_connections {{ {wires} }}
            internal_event_actions {{ {actions} }}
        }}"
    )
}
