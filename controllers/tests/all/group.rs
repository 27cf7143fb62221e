//! In-process groups on virtual time: the definition of a turn, how groups end, and which ones are refused.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::io::direct::Filler;
use controllers::sdk::harness::{Disturbance, Ending, Harness, ModuleId};
use controllers::sdk::{
    About, Arguments, Configured, Controller, Every, GroupError, InProcessGroup, InnerValue, Inputs, Kind, MemberPort,
    Message, Module, Out, Outcome, Outlets, Outputs, Parameter, PortInterface, Progress, Registry, Signal, Stopping,
    Tick, Time,
};
use serde::{Deserialize, Serialize};
use std::time::Duration;

const PERIOD: Duration = Duration::from_millis(1);

/// Its number, and when it was sent in ns.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Step(u64, u64);

impl Message for Step {
    const TYPE: &'static str = "Step";
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Other(u64);

impl Message for Other {
    const TYPE: &'static str = "Other";
}

#[derive(Inputs)]
struct Hears {
    #[port("In")]
    heard: Every<Step>,
}

#[derive(Inputs)]
struct HearsAtWill {
    #[port("In", optional)]
    heard: Every<Step>,
}

#[derive(Inputs)]
struct HearsOther {
    #[port("In")]
    _heard: Every<Other>,
}

#[derive(Outputs)]
struct Says {
    #[port("Out")]
    said: Out<Step>,
}

/// Counts on the grid of its period; is done after a number of values, or aborts.
struct Head {
    number: u64,
    done_at: u64,
}

impl Controller for Head {
    type Inputs = ();
    type Outputs = Says;
    const TYPE: &'static str = "Head";

    fn about() -> About {
        const DONE: &[Parameter] = &[Parameter::new("done_at", Kind::Number(0.0, 1e9)).or("1000000")];
        About::task("Counts.").every(PERIOD).with(DONE)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let done_at = arguments.number("done_at");
        if done_at < 1.0 {
            return Err("it would be done before it begins".to_owned());
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is small and positive")]
        Ok(Self { number: 0, done_at: done_at as u64 })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.number = 0;
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut Says) -> Progress {
        self.number += 1;
        outputs.said.send(Step(self.number, tick.now.nanos()));
        if self.number >= self.done_at { Progress::Done(b"end".to_vec()) } else { Progress::Continue }
    }

    fn signals(&self) -> Vec<Signal> {
        #[expect(clippy::cast_precision_loss, reason = "it is small")]
        let value = self.number as f64;
        vec![Signal { name: "number".into(), unit: String::new(), value, headline: false }]
    }
}

/// Passes on the last value that it gets.
struct Stage;

impl Controller for Stage {
    type Inputs = Hears;
    type Outputs = Says;
    const TYPE: &'static str = "Stage";

    fn about() -> About {
        About::service("Passes on.").every(PERIOD * 1000).triggered_by("In")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, inputs: &Hears, outputs: &mut Says) -> Progress {
        inputs.heard.iter().last().into_iter().for_each(|step| outputs.said.send(step.clone()));
        Progress::Continue
    }
}

/// Shows how many it has got in order, how many not, and how old the oldest was; takes two turns to stop.
#[derive(Default)]
struct Sink {
    next: u64,
    missed: u64,
    age_max: u64,
    stops: u32,
}

impl Controller for Sink {
    type Inputs = HearsAtWill;
    type Outputs = ();
    const TYPE: &'static str = "Sink";

    fn about() -> About {
        About::service("Keeps count.").every(PERIOD * 1000).triggered_by("In")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self { next: 1, ..Self::default() };
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &HearsAtWill, (): &mut ()) -> Progress {
        for Step(number, sent) in inputs.heard.iter() {
            self.missed += number - self.next;
            self.next = number + 1;
            self.age_max = self.age_max.max(tick.now.nanos() - sent);
        }
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, _: &HearsAtWill, (): &mut ()) -> Stopping {
        self.stops += 1;
        if self.stops < 2 { Stopping::Again } else { Stopping::Finished }
    }

    fn signals(&self) -> Vec<Signal> {
        #[expect(clippy::cast_precision_loss, reason = "they are small")]
        let show = |name: &str, value: u64| {
            let (name, unit) = (name.to_owned(), String::new());
            Signal { name, unit, value: value as f64, headline: false }
        };
        vec![show("got", self.next - 1), show("missed", self.missed), show("age", self.age_max)]
    }
}

/// Takes something else.
struct Stranger;

impl Controller for Stranger {
    type Inputs = HearsOther;
    type Outputs = ();
    const TYPE: &'static str = "Stranger";

    fn about() -> About {
        const ENDS: &[Outcome] = &[Outcome { tag: "found", type_name: None }];
        About::task("Is of another type.").ends_with(ENDS)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, _: &HearsOther, (): &mut ()) -> Progress {
        Progress::Continue
    }
}

fn nothing(_: &Arguments) -> Vec<String> {
    Vec::new()
}

/// A head, stages one behind the other, and a sink at each; added in this order, or in reverse.
fn caterpillar(stages: usize, is_reversed: bool) -> InProcessGroup {
    const DONE: &[Parameter] = &[Parameter::new("done_at", Kind::Number(0.0, 1e9)).or("1000000")];
    let name = |stage: usize| if stage == 0 { "head".to_owned() } else { format!("stage{stage}") };
    let mut group = InProcessGroup::new("Caterpillar", "Counts through stages.").with(DONE);
    let add = |group: InProcessGroup, stage: usize| match stage {
        0 => group.member::<Head>("head", |of| vec![of.number("done_at").to_string()]),
        _ => group.member::<Stage>(name(stage), nothing).member::<Sink>(format!("sink{stage}"), nothing),
    };
    for at in 0..=stages {
        group = add(group, if is_reversed { stages - at } else { at });
    }
    for stage in 1..=stages {
        group = group.wire(MemberPort::new(&name(stage - 1), "Out"), MemberPort::new(&name(stage), "In"));
        group = group.wire(MemberPort::new(&name(stage), "Out"), MemberPort::new(&format!("sink{stage}"), "In"));
    }
    group
}

fn create(group: InProcessGroup, arguments: &[&str]) -> Box<dyn Module> {
    let mut registry = Registry::default();
    registry.add_group(group).unwrap();
    let type_name = registry.interfaces().next().unwrap().type_name;
    registry.create(type_name, arguments).unwrap()
}

fn signal(harness: &Harness, module: ModuleId, name: &str) -> f64 {
    harness.signals(module).into_iter().find(|signal| signal.name == name).unwrap().value
}

#[track_caller]
fn same(one: f64, other: f64) {
    assert!((one - other).abs() < 1e-9, "{one} is not {other}");
}

#[test]
fn every_value_is_at_every_sink_in_the_turn_that_it_was_sent_in() {
    let mut harness = Harness::new(Disturbance { transfer: Duration::ZERO, ..Disturbance::NONE });
    let group = harness.add(create(caterpillar(8, false), &["2000"]));
    harness.activate(group, b"");
    let report = harness.run(Time::ZERO + PERIOD * 3000).unwrap();
    // Nothing of the last turn is lost, and the sinks, which take two turns to stop, get them.
    assert_eq!((report.ending, report.at), (Ending::Done(b"end".to_vec()), Time::ZERO + PERIOD * 2000));
    for sink in 1..=8 {
        for (of, value) in [("got", 2000.0), ("missed", 0.0), ("age", 0.0)] {
            same(signal(&harness, group, &format!("sink{sink} {of}")), value);
        }
    }
    same(signal(&harness, group, "head number"), 2000.0);
}

#[test]
fn what_is_sent_to_a_member_before_is_there_in_the_next_turn() {
    let mut harness = Harness::new(Disturbance { transfer: Duration::ZERO, ..Disturbance::NONE });
    let group = harness.add(create(caterpillar(3, true), &[]));
    harness.activate(group, b"");
    assert_eq!(harness.run(Time::ZERO + PERIOD * 100), None);
    for (sink, turns) in [(1, 1.0), (2, 2.0), (3, 3.0)] {
        same(signal(&harness, group, &format!("sink{sink} missed")), 0.0);
        same(signal(&harness, group, &format!("sink{sink} age")), turns * 1e6);
    }
}

/// A member whose stop fails; the name of the type says how.
struct Stuck<const PANICS: bool>;

impl<const PANICS: bool> Controller for Stuck<PANICS> {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = if PANICS { "Panics" } else { "Fails" };

    fn about() -> About {
        About::service("Cannot stop.").every(PERIOD)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, (): &(), (): &mut ()) -> Progress {
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, (): &(), (): &mut ()) -> Stopping {
        assert!(!PANICS, "it presses");
        Stopping::Failed("it presses".to_owned())
    }
}

/// The other members are still stopped, also if that takes several turns.
#[test]
fn the_stop_of_a_member_that_fails_aborts_the_group_after_all_others_have_stopped() {
    let group = InProcessGroup::new("Group", "Counts.")
        .member::<Stuck<false>>("one", nothing)
        .member::<Stuck<true>>("two", nothing)
        .member::<Head>("head", |_| vec!["10".to_owned()])
        .member::<Sink>("sink", nothing)
        .wire(MemberPort::new("head", "Out"), MemberPort::new("sink", "In"));
    let mut harness = Harness::new(Disturbance { transfer: Duration::ZERO, ..Disturbance::NONE });
    let group = harness.add(create(group, &[]));
    harness.activate(group, b"");
    let report = harness.run(Time::ZERO + PERIOD * 100).unwrap();
    let reason = "its stop failed: `one`: it presses; `two`: the controller panicked: it presses".to_owned();
    // The sink takes two turns to stop.
    assert_eq!((report.ending, report.at), (Ending::Aborted(reason), Time::ZERO + PERIOD * 10));
}

/// Values from outside trigger a member at once, and the grid of the others stays.
#[test]
fn a_trigger_from_outside_does_not_shift_the_period_of_others() {
    let mut harness = Harness::new(Disturbance { transfer: Duration::ZERO, ..Disturbance::NONE });
    let group = caterpillar(1, false)
        .member::<Stage>("gate", nothing)
        .member::<Sink>("after", nothing)
        .wire(MemberPort::new("gate", "Out"), MemberPort::new("after", "In"))
        .expose(MemberPort::new("gate", "In"), "In")
        .expose(MemberPort::new("gate", "Out"), "Out");
    let group = harness.add(create(group, &[]));
    let (mut registry, period) = (Registry::default(), Duration::from_micros(300));
    let fast = InProcessGroup::new("Fast", "Counts faster.")
        .member::<Metronome>("one", nothing)
        .expose(MemberPort::new("one", "Out"), "Out");
    registry.add_group(fast).unwrap().add::<Sink>();
    let fast = harness.add(registry.create("Fast", &[]).unwrap());
    let sink = harness.add(registry.create("Sink", &[]).unwrap());
    for (from, to) in [(fast, group), (group, sink)] {
        let wire = harness.connect((from, "Out"), (to, "In")).unwrap();
        harness.open(wire);
    }
    [sink, group, fast].into_iter().for_each(|module| harness.activate(module, b""));
    assert_eq!(harness.run(Time::ZERO + PERIOD * 600), None);
    same(signal(&harness, group, "head number"), 601.0);
    same(signal(&harness, group, "sink1 missed"), 0.0);
    for (module, of) in [(group, "after "), (sink, "")] {
        let got = (PERIOD * 600).as_nanos() / period.as_nanos() + 1;
        same(signal(&harness, module, &format!("{of}got")), f64::from(u32::try_from(got).unwrap()));
        same(signal(&harness, module, &format!("{of}age")), 0.0);
    }
}

/// Counts every 0.3 ms.
struct Metronome(Head);

impl Controller for Metronome {
    type Inputs = ();
    type Outputs = Says;
    const TYPE: &'static str = "Metronome";

    fn about() -> About {
        About::service("Counts.").every(Duration::from_micros(300))
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self(Head { number: 0, done_at: u64::MAX }))
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut Says) -> Progress {
        self.0.main_calc(tick, &(), outputs)
    }
}

/// Looks at some of the outputs inside a group.
#[derive(Default)]
struct Person {
    looks_at: Vec<usize>,
    /// The outputs, the numbers of their values, and the head's count at that time.
    seen: Vec<(usize, u64, u64)>,
}

impl Outlets for Person {
    fn send(&mut self, _: &'static str, _: Vec<u8>) {}

    fn send_filled(&mut self, _: &'static str, _: &mut dyn FnMut(&mut Filler<'_>) -> bool) -> bool {
        false
    }

    fn show_inner(&mut self, values: &mut Vec<InnerValue>, heard: &mut [bool]) {
        let step = |value: &InnerValue| postcard::from_bytes::<Step>(&value.bytes).unwrap().0;
        self.seen.extend(values.drain(..).map(|value| (value.at, value.number, step(&value))));
        for (at, is_heard) in heard.iter_mut().enumerate() {
            *is_heard = self.looks_at.contains(&at);
        }
    }
}

/// Only outputs that lead to other members are inner wires. Their values are shown only while a client watches them,
/// and all are counted.
#[test]
fn what_is_sent_inside_is_shown_while_somebody_looks() {
    let mut group = create(caterpillar(2, false).expose(MemberPort::new("stage2", "Out"), "Out"), &[]);
    let names = |group: &dyn Module| {
        let inner = group.interface().inner.iter();
        inner.map(|inner| format!("{}: {} -> {}", inner.name, inner.type_name, inner.inputs.join(", "))).collect()
    };
    let inner: Vec<String> = names(&*group);
    let expected =
        ["head.Out: Step -> stage1.In", "stage1.Out: Step -> sink1.In, stage2.In", "stage2.Out: Step -> sink2.In"];
    assert_eq!(inner, expected);
    let alone: Vec<String> = names(&*create(
        InProcessGroup::new("G", "One.").member::<Head>("a", nothing).expose(MemberPort::new("a", "Out"), "Out"),
        &[],
    ));
    assert_eq!(alone, Vec::<String>::new());

    group.init(b"", Time::ZERO).unwrap();
    let (mut person, mut turns) = (Person::default(), 0);
    let mut turn = |person: &mut Person, looks_at: &[usize]| {
        looks_at.clone_into(&mut person.looks_at);
        assert_eq!(group.calculate(Time::ZERO + PERIOD * turns), Progress::Continue);
        turns += 1;
        group.drain_to(person);
        std::mem::take(&mut person.seen)
    };
    // A client that starts watching during a turn sees the next turn; a client that stops sees no more.
    assert_eq!(turn(&mut person, &[]), []);
    assert_eq!(turn(&mut person, &[1]), []);
    assert_eq!(turn(&mut person, &[0, 1, 2]), [(1, 3, 3)]);
    assert_eq!(turn(&mut person, &[]), [(0, 4, 4), (1, 4, 4), (2, 4, 4)]);
    assert_eq!(turn(&mut person, &[2]), []);
    assert_eq!(turn(&mut person, &[2]), [(2, 6, 6)]);
    // They are counted from the start of the program on, as other outputs are.
    group.init(b"", Time::ZERO).unwrap();
    assert_eq!(group.calculate(Time::ZERO), Progress::Continue);
    group.drain_to(&mut person);
    assert_eq!(person.seen, [(2, 7, 1)]);
}

#[test]
fn other_arguments_are_for_all_members_or_for_none() {
    let mut group = create(caterpillar(1, false), &["5"]);
    let parameters = group.interface().about.parameters;
    let arguments = |text: &str| Arguments::parse(parameters, &[text]).unwrap();
    let refused = group.configure(arguments("0"), true);
    assert_eq!(refused, Err("`head`: it would be done before it begins".to_owned()));
    assert_eq!(group.configure(arguments("2"), true), Ok(Configured::Later));
    group.init(b"", Time::ZERO).unwrap();
    assert_eq!(group.calculate(Time::ZERO), Progress::Continue);
    assert_eq!(group.calculate(Time::ZERO + PERIOD), Progress::Done(b"end".to_vec()));
}

#[test]
fn what_does_not_fit_is_refused() {
    let one = || InProcessGroup::new("G", "One.").member::<Head>("a", nothing);
    let two = || one().member::<Stage>("b", nothing);
    let no_port = |direction, member: &str, port: &str| GroupError::NoPort {
        group: "G",
        direction,
        member: member.into(),
        port: port.into(),
    };
    let twice = |name: &str| GroupError::Twice { group: "G", name: name.into() };
    let types = |from: &str, to: &str| GroupError::Types { group: "G", from: from.into(), to: to.into() };
    let wired = || two().wire(MemberPort::new("a", "Out"), MemberPort::new("b", "In"));
    let table = [
        (InProcessGroup::new("G", "Empty."), GroupError::Count { group: "G", count: 0 }),
        (one().member::<Head>("a", nothing), twice("a")),
        (two(), GroupError::Unconnected { group: "G", member: "b".into(), port: "In" }),
        (two().wire(MemberPort::new("c", "Out"), MemberPort::new("b", "In")), no_port("output", "c", "Out")),
        (two().wire(MemberPort::new("a", "Out"), MemberPort::new("b", "Out")), no_port("input", "b", "Out")),
        (one().expose(MemberPort::new("a", "In"), "In"), no_port("port", "a", "In")),
        (wired().wire(MemberPort::new("a", "Out"), MemberPort::new("b", "In")), twice("a.Out -> b.In")),
        (wired().expose(MemberPort::new("a", "Out"), "X").expose(MemberPort::new("b", "Out"), "X"), twice("X")),
        (
            one().member::<Stranger>("s", nothing).wire(MemberPort::new("a", "Out"), MemberPort::new("s", "In")),
            types("a.Out", "s.In"),
        ),
        (
            two()
                .member::<Stranger>("s", nothing)
                .expose(MemberPort::new("b", "In"), "X")
                .expose(MemberPort::new("s", "In"), "X"),
            types("X", "s.In"),
        ),
        (
            one().member::<Stranger>("s", nothing).expose(MemberPort::new("s", "In"), "X"),
            GroupError::Outcomes { group: "G", member: "s".into() },
        ),
    ];
    for (group, error) in table {
        assert_eq!(Registry::default().add_group(group).map(|_| ()), Err(error));
    }
    let group = create(wired().expose(MemberPort::new("b", "Out"), "Onward"), &[]);
    let interface = group.interface();
    let ports: Vec<&str> = interface.ports.iter().map(|port: &PortInterface| port.name).collect();
    assert_eq!((ports, interface.about.service, interface.about.schedule.period), (vec!["Onward"], false, PERIOD));
}
