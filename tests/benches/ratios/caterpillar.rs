//! A source at 1 kHz, eight stages in a row, and a sink at each stage. A node starts them from a spec as 17 programs,
//! and then again as one program, with all of them in an in-process group. No value may be lost.

use crate::figures::{Round, Subject, Table, cell};
use crate::node::{HOST, Node};
use crate::programs::times_of;
use anyhow::Context;
use comms::io::clock::now;
use controllers::sdk::{
    About, Arguments, Controller, Every, InProcessGroup, Inputs, Kind, MemberPort, Message, Out, Outputs, Parameter,
    Progress, Registry, Tick, Time,
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How many stages, and sinks.
const STAGES: u32 = 8;
/// The source's period.
const PERIOD: Duration = Duration::from_millis(1);
/// The number of values from the source, and the number of idle periods before and after them.
const VALUES: u64 = 10_000;
const REST: u64 = 500;

/// The longest time for a hop in one process, in microseconds.
const HOP_MAX: f64 = 2.0;

/// Values, each with its number and when it was sent, in nanoseconds. There are several if a stage has received
/// several at once.
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

/// In a group, all calculations of a turn have the same time. So the measuring members of a group read the clock.
fn time<const IN_GROUP: bool>(tick: Tick) -> Time {
    if IN_GROUP { now() } else { tick.now }
}

/// Sends values, and is done some time after its last value.
struct Head<const IN_GROUP: bool>(u64);

impl<const IN_GROUP: bool> Controller for Head<IN_GROUP> {
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
            outputs.out.send(Steps(vec![(self.0 - REST, time::<IN_GROUP>(tick).nanos())]));
        }
        if self.0 > VALUES + 2 * REST { Progress::Done(Vec::new()) } else { Progress::Continue }
    }
}

/// Sends its input on.
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

/// Keeps the age of each received value. Writes the ages to a file when its program ends.
struct Sink<const IN_GROUP: bool> {
    file: PathBuf,
    ages: Vec<u64>,
}

impl<const IN_GROUP: bool> Controller for Sink<IN_GROUP> {
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
        let (steps, now) = (inputs.steps.iter().flat_map(|steps| &steps.0), time::<IN_GROUP>(tick));
        self.ages.extend(steps.map(|(_, sent)| now.nanos().saturating_sub(*sent)));
        Progress::Continue
    }
}

impl<const IN_GROUP: bool> Drop for Sink<IN_GROUP> {
    fn drop(&mut self) {
        let bytes: Vec<u8> = self.ages.iter().flat_map(|age| age.to_le_bytes()).collect();
        // The reader reports a missing file.
        std::fs::write(&self.file, bytes).unwrap_or_default();
    }
}

/// Adds the controllers.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Head<false>>().add::<Stage>().add::<Sink<false>>();
    registry.add_group(group()).expect("its wires fit");
}

/// Returns the whole row as one type.
fn group() -> InProcessGroup {
    const FILE: &[Parameter] = &[Parameter::new("file", Kind::Text(&[]))];
    let mut group = InProcessGroup::new("Caterpillar", "A head, stages, and a sink at each of them.").with(FILE);
    group = group.member::<Head<true>>("head", |_| Vec::new());
    for number in 1..=STAGES {
        let file = move |of: &Arguments| vec![format!("{}{number}", of.text("file"))];
        let (before, stage, sink) = (name(number - 1), name(number), format!("sink{number}"));
        group = group.member::<Stage>(&*stage, |_| Vec::new()).member::<Sink<true>>(&*sink, file);
        group = group
            .wire(MemberPort::new(&before, "Out"), MemberPort::new(&stage, "In"))
            .wire(MemberPort::new(&stage, "Out"), MemberPort::new(&sink, "In"));
    }
    group
}

fn name(stage: u32) -> String {
    if stage == 0 { "head".to_owned() } else { format!("stage{stage}") }
}

/// Measures, and adds lines to the table.
pub(crate) async fn measure(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    let dir = dir.join("caterpillar");
    std::fs::create_dir(&dir)?;
    let mut node = Node::start(&dir).await?;
    let file = |number: u32| dir.join(format!("sink{number}"));
    for spec in [spec(file), spec_of_group(&dir.join("group"))] {
        let mut deployment = node.deploy(&spec)?;
        while deployment.next().await?.is_some() {}
    }
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
    table.heading("caterpillar, 1 kHz, one process", "missed", "a hop");
    for number in 1..=STAGES {
        let path = dir.join(format!("group{number}"));
        let times = times_of(&std::fs::read(&path).with_context(|| format!("sink {number} of the group"))?);
        let missed = VALUES.saturating_sub(u64::try_from(times.len())?);
        let mut subject = Subject::default();
        subject.push(Round::of(times).context("nothing came")?);
        let verdict = if missed == 0 { "0 (reached: 0)".to_owned() } else { format!("{missed} (missed: 0)") };
        let hop = subject.figures().p50.as_secs_f64() * 1e6 / f64::from(number + 1);
        table.line(&format!("over {} wires", number + 1), &subject, [verdict, cell(hop, Some(HOP_MAX))]);
    }
    Ok(())
}

fn spec_of_group(file: &Path) -> String {
    format!(
        "process main() {{
            host {{ \"{HOST}\" }}
            instantiated_processes {{ all instof Caterpillar(\"{HOST}\", {file:?}); }}
            internal_event_actions {{ all }}
        }}"
    )
}

fn spec(file: impl Fn(u32) -> PathBuf) -> String {
    let (mut instances, mut wires) = (format!("head instof Head(\"{HOST}\");"), String::new());
    let mut all = vec!["head".to_owned()];
    for number in 1..=STAGES {
        let before = name(number - 1);
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
