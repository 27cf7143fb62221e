//! Controllers for tests that count: a source of numbers at 1 kHz, a sink that writes down the numbers it receives, a
//! filter between them, and one that is done after a while. Other controllers send beats at 100 Hz, and write down the
//! times of their own beats or the beats they receive.

use comms::logic::time::Time;
use controllers::ros::example_interfaces::FibonacciGoal;
use controllers::ros::std_msgs::String as Text;
use controllers::ros::std_srvs::{TriggerRequest, TriggerResponse};
use controllers::ros::tf2_msgs::TFMessage;
use controllers::sdk::{
    About, Arguments, Calls, Controller, Every, Exports, In, InProcessGroup, Inputs, Kind, MemberPort, Message, Out,
    Outputs, Parameter, Progress, Registry, Stopping, Tick, process,
};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

const PERIOD: Duration = Duration::from_millis(1);

/// Numbers in order. One message has several if one calculation has had several.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Numbers {
    numbers: Vec<u64>,
}

impl Message for Numbers {
    const TYPE: &'static str = "Numbers";
}

#[derive(Outputs)]
struct SourceOutputs {
    #[port("Out")]
    out: Out<Numbers>,
}

/// Counts from 1 on.
struct Source {
    number: u64,
}

impl Controller for Source {
    type Inputs = ();
    type Outputs = SourceOutputs;
    const TYPE: &'static str = "Source";

    fn about() -> About {
        About::service("Counts at 1 kHz.").every(PERIOD)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self { number: 0 })
    }

    fn main_calc(&mut self, _: Tick, (): &(), outputs: &mut SourceOutputs) -> Progress {
        self.number += 1;
        outputs.out.send(Numbers { numbers: vec![self.number] });
        Progress::Continue
    }
}

#[derive(Inputs)]
struct SinkInputs {
    #[port("In")]
    first: Every<Numbers>,
    #[port("Other", optional)]
    second: Every<Numbers>,
}

/// Merges two sequences. Each keeps its order.
fn merged(mut first: VecDeque<u64>, mut second: VecDeque<u64>) -> impl Iterator<Item = u64> {
    std::iter::from_fn(move || match (first.front(), second.front()) {
        (Some(one), Some(other)) if one > other => second.pop_front(),
        (None, _) => second.pop_front(),
        (Some(_), _) => first.pop_front(),
    })
}

/// Writes down the runs of numbers that it has received, in their order: `1-70 1-3`.
struct Sink {
    file: String,
    runs: Vec<(u64, u64)>,
}

impl Sink {
    fn take(&mut self, number: u64) {
        match self.runs.last_mut() {
            Some((_, last)) if *last + 1 == number => *last = number,
            _ => self.runs.push((number, number)),
        }
    }
}

impl Controller for Sink {
    type Inputs = SinkInputs;
    type Outputs = ();
    const TYPE: &'static str = "Sink";

    fn about() -> About {
        const FILE: &[Parameter] = &[Parameter::new("file", Kind::Text(&[]))];
        About::service("Writes down the runs of numbers that it has got.").every(PERIOD).with(FILE)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { file: arguments.text("file").to_owned(), runs: Vec::new() })
    }

    fn main_calc(&mut self, _: Tick, inputs: &SinkInputs, (): &mut ()) -> Progress {
        // One calculation may see several switches. It cannot see which of its inputs was the first to have a value.
        let both =
            [&inputs.first, &inputs.second].map(|input| input.iter().flat_map(|one| one.numbers.clone()).collect());
        let [first, second]: [VecDeque<u64>; 2] = both;
        merged(first, second).for_each(|number| self.take(number));
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, _: &SinkInputs, (): &mut ()) -> Stopping {
        let runs: Vec<String> = self.runs.iter().map(|(first, last)| format!("{first}-{last}")).collect();
        std::fs::write(&self.file, runs.join(" ")).expect("the folder is the test's own");
        Stopping::Finished
    }
}

#[derive(Inputs)]
struct PassInputs {
    #[port("In")]
    input: Every<Numbers>,
}

#[derive(Outputs)]
struct PassOutputs {
    #[port("Out")]
    out: Out<Numbers>,
}

/// Sends its input on.
struct Pass {
    fails_at: u64,
}

impl Controller for Pass {
    type Inputs = PassInputs;
    type Outputs = PassOutputs;
    const TYPE: &'static str = "Pass";

    fn about() -> About {
        const FAILS: &[Parameter] = &[Parameter::new("fails_at", Kind::Number(0.0, 1e9))];
        About::service("Passes numbers on, and aborts after so many, if any.")
            .every(PERIOD * 100)
            .triggered_by("In")
            .with(FAILS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is small and positive")]
        Ok(Self { fails_at: arguments.number("fails_at") as u64 })
    }

    fn main_calc(&mut self, _: Tick, inputs: &PassInputs, outputs: &mut PassOutputs) -> Progress {
        let numbers: Vec<u64> = inputs.input.iter().flat_map(|one| one.numbers.clone()).collect();
        if numbers.is_empty() {
            return Progress::Continue;
        }
        outputs.out.send(Numbers { numbers });
        self.fails_at = self.fails_at.saturating_sub(u64::from(self.fails_at > 1));
        if self.fails_at == 1 { Progress::Aborted("it was to fail".to_owned()) } else { Progress::Continue }
    }
}

/// Is done after a while.
struct Pulse {
    left: u32,
}

impl Controller for Pulse {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Pulse";

    fn about() -> About {
        About::task("Is done after 10 ms.").every(PERIOD)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self { left: 0 })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.left = 10;
        Ok(())
    }

    fn main_calc(&mut self, _: Tick, (): &(), (): &mut ()) -> Progress {
        self.left = self.left.saturating_sub(1);
        if self.left == 0 { Progress::Done(Vec::new()) } else { Progress::Continue }
    }
}

/// How often something beats.
const BEAT: Duration = Duration::from_millis(10);
/// The padding of a beat. With it, beats fill the buffers of a link with a suspended reader in less than a second.
const PADDING: usize = 4096;
/// The padding for which a beat travels in shared memory.
const LONG_PADDING: usize = 100_000;

/// One beat.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Beat {
    from: String,
    number: u64,
    sent: Time,
    padding: String,
}

impl Message for Beat {
    const TYPE: &'static str = "Beat";
}

/// A file of lines. Each line is complete once it was written. A restarted program appends its lines after the line
/// `begins`.
struct Log {
    path: PathBuf,
    file: Option<File>,
}

impl Log {
    const PARAMETERS: &[Parameter] = &[Parameter::new("file", Kind::Text(&[]))];

    fn of(arguments: &Arguments) -> Self {
        Self { path: arguments.text("file").into(), file: None }
    }

    fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    fn begin(&mut self) -> Result<(), String> {
        let opened = OpenOptions::new().create(true).append(true).open(&self.path);
        self.file = Some(opened.map_err(|error| error.to_string())?);
        self.add("begins\n");
        Ok(())
    }

    fn add(&mut self, lines: &str) {
        let written = self.file.as_mut().map(|file| file.write_all(lines.as_bytes()));
        written.transpose().expect("the folder is the test's own");
    }
}

#[derive(Outputs)]
struct BeatOutputs {
    #[port("Out")]
    out: Out<Beat>,
}

/// Sends beats and writes down their times: `1234 10` is the time and the interval since the previous beat, in
/// nanoseconds.
struct Heart<const SIZE: usize> {
    log: Log,
    number: u64,
}

impl<const SIZE: usize> Controller for Heart<SIZE> {
    type Inputs = ();
    type Outputs = BeatOutputs;
    const TYPE: &'static str = if SIZE == PADDING { "Heart" } else { "Drum" };

    fn about() -> About {
        About::service("Beats at 100 Hz.").every(BEAT).signals_every(BEAT * 10).with(Log::PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { log: Log::of(arguments), number: 0 })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.log.begin()
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut BeatOutputs) -> Progress {
        self.number += 1;
        let (from, padding) = (self.log.name(), "-".repeat(SIZE));
        outputs.out.send(Beat { from, number: self.number, sent: tick.now, padding });
        self.log.add(&format!("{} {}\n", tick.now.nanos(), tick.elapsed.as_nanos()));
        Progress::Continue
    }
}

/// Returns a reader's line: the time and the age of the beat in nanoseconds, its sender, its number, and the number of
/// lost beats so far.
fn line(now: Time, beat: &Beat, lost: u64) -> String {
    let age = now.since(beat.sent).as_nanos();
    format!("{} {age} {} {} {lost}\n", now.nanos(), beat.from, beat.number)
}

#[derive(Inputs)]
struct EarInputs {
    #[port("In")]
    beats: Every<Beat>,
}

/// Writes down each beat when it arrives.
struct Ear(Log);

impl Controller for Ear {
    type Inputs = EarInputs;
    type Outputs = ();
    const TYPE: &'static str = "Ear";

    fn about() -> About {
        About::service("Hears each beat.").every(BEAT).triggered_by("In").with(Log::PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self(Log::of(arguments)))
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.0.begin()
    }

    fn main_calc(&mut self, tick: Tick, inputs: &EarInputs, (): &mut ()) -> Progress {
        let lost = inputs.beats.lost();
        let lines: String = inputs.beats.iter().map(|beat| line(tick.now, beat, lost)).collect();
        self.0.add(&lines);
        Progress::Continue
    }
}

#[derive(Inputs)]
struct EyeInputs {
    #[port("In")]
    beat: In<Beat>,
}

/// Writes down the newest beat in each calculation.
struct Eye(Log);

impl Controller for Eye {
    type Inputs = EyeInputs;
    type Outputs = ();
    const TYPE: &'static str = "Eye";

    fn about() -> About {
        About::service("Looks at the newest beat at 100 Hz.").every(BEAT).with(Log::PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self(Log::of(arguments)))
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.0.begin()
    }

    fn main_calc(&mut self, tick: Tick, inputs: &EyeInputs, (): &mut ()) -> Progress {
        if let Some(beat) = inputs.beat.fresh() {
            self.0.add(&line(tick.now, beat, inputs.beat.lost()));
        }
        Progress::Continue
    }
}

#[derive(Debug, Inputs)]
struct EchoInputs {
    #[port("In")]
    heard: In<Text>,
}

#[derive(Debug, Outputs)]
struct EchoOutputs {
    #[port("Out")]
    said: Out<Text>,
}

/// Sends each message of ROS 2 back.
#[derive(Debug)]
struct Echo;

impl Controller for Echo {
    type Inputs = EchoInputs;
    type Outputs = EchoOutputs;
    const TYPE: &'static str = "Echo";

    fn about() -> About {
        About::service("Sends each text back.").triggered_by("In").every(PERIOD * 100)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, inputs: &EchoInputs, outputs: &mut EchoOutputs) -> Progress {
        if let Some(heard) = inputs.heard.fresh() {
            outputs.said.send(heard.clone());
        }
        Progress::Continue
    }
}

#[derive(Debug, Inputs)]
struct TransformInputs {
    #[port("In")]
    heard: In<TFMessage>,
}

#[derive(Debug, Outputs)]
struct TransformOutputs {
    #[port("Out")]
    said: Out<TFMessage>,
}

/// Sends each message of transforms back.
#[derive(Debug)]
struct TransformEcho;

impl Controller for TransformEcho {
    type Inputs = TransformInputs;
    type Outputs = TransformOutputs;
    const TYPE: &'static str = "TransformEcho";

    fn about() -> About {
        About::service("Sends transforms back.").triggered_by("In").every(PERIOD * 100)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, inputs: &TransformInputs, outputs: &mut TransformOutputs) -> Progress {
        if let Some(heard) = inputs.heard.fresh() {
            outputs.said.send(heard.clone());
        }
        Progress::Continue
    }
}

#[derive(Debug, Outputs)]
struct ResetOutputs {
    #[calls("Reset")]
    reset: Calls<TriggerRequest, TriggerResponse>,
}

/// Calls a service of ROS 2 until it succeeds, and passes the service's answer to clients of ROS 2.
#[derive(Debug)]
struct Resetter {
    told: String,
}

impl Controller for Resetter {
    type Inputs = ();
    type Outputs = ResetOutputs;
    const TYPE: &'static str = "Resetter";

    fn about() -> About {
        About::service("Calls a service of ROS 2, and answers another.").triggered_by("Reset").every(PERIOD * 100)
    }

    fn exports(exports: &mut Exports<Self>) {
        exports.procedure("Told", "Returns what the service has answered.", |resetter, _: TriggerRequest| {
            if resetter.told.is_empty() {
                return Err("the service has not answered".to_owned());
            }
            Ok(TriggerResponse { success: true, message: resetter.told.clone() })
        });
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self { told: String::new() })
    }

    fn main_calc(&mut self, _: Tick, (): &(), outputs: &mut ResetOutputs) -> Progress {
        while let Some((_, answer)) = outputs.reset.answer() {
            if let Ok(answer) = answer {
                self.told = answer.message;
            }
        }
        if self.told.is_empty() && outputs.reset.pending() == 0 {
            outputs.reset.call(TriggerRequest::default(), PERIOD * 30_000);
        }
        Progress::Continue
    }
}

/// Is done at once, with the goal of an action of ROS 2 as its value.
#[derive(Debug)]
struct Order;

impl Controller for Order {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Order";

    fn about() -> About {
        About::task("Orders five numbers.").every(PERIOD)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, (): &(), (): &mut ()) -> Progress {
        Progress::done(&FibonacciGoal { order: 5 })
    }
}

/// Makes a source, a row of eight stages that send their input on, and a sink at each stage, all in one process.
fn caterpillar() -> InProcessGroup {
    const FILE: &[Parameter] = &[Parameter::new("file", Kind::Text(&[]))];
    let nothing = |_: &Arguments| Vec::new();
    let mut group = InProcessGroup::new("Caterpillar", "Counts through eight stages.").with(FILE);
    group = group.member::<Source>("stage0", nothing);
    for number in 1..=8 {
        let file = move |of: &Arguments| vec![format!("{}{number}", of.text("file"))];
        let (before, stage, sink) = (format!("stage{}", number - 1), format!("stage{number}"), format!("sink{number}"));
        group = group.member::<Pass>(&*stage, |_| vec!["0".to_owned()]).member::<Sink>(&*sink, file);
        group = group
            .wire(MemberPort::new(&before, "Out"), MemberPort::new(&stage, "In"))
            .wire(MemberPort::new(&stage, "Out"), MemberPort::new(&sink, "In"));
    }
    group
}

/// Makes two stages in a row that send their input on, in one process.
fn twice() -> InProcessGroup {
    let pass = |_: &Arguments| vec!["0".to_owned()];
    let group =
        InProcessGroup::new("Twice", "Passes on twice.").member::<Pass>("first", pass).member::<Pass>("second", pass);
    let group = group.wire(MemberPort::new("first", "Out"), MemberPort::new("second", "In"));
    group.expose(MemberPort::new("first", "In"), "In").expose(MemberPort::new("second", "Out"), "Out")
}

fn main() -> ExitCode {
    let mut registry = Registry::default();
    registry.add::<Source>();
    registry.add::<Sink>();
    registry.add::<Pass>();
    registry.add::<Pulse>();
    registry.add::<Heart<PADDING>>();
    registry.add::<Heart<LONG_PADDING>>();
    registry.add::<Ear>();
    registry.add::<Eye>();
    registry.add::<Echo>();
    registry.add::<TransformEcho>();
    registry.add::<Resetter>();
    registry.add::<Order>();
    for group in [caterpillar(), twice()] {
        registry.add_group(group).expect("its wires fit");
    }
    process::run(&registry)
}
