//! Calls between modules on virtual time: each call has one answer, however its server and the network behave.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use controllers::sdk::harness::{CallEnd, Disturbance, Harness, ModuleId};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Exports, ObjectError, Outputs, Progress, Registry, Reply, Tick, Time,
};
use std::time::Duration;

const WITHIN: Duration = Duration::from_secs(2);

/// Answers a number with its double, 100 ms later.
#[derive(Default)]
struct Doubler {
    open: Vec<(f64, Reply<f64>, Time)>,
    asked: Vec<(f64, Reply<f64>)>,
}

impl Controller for Doubler {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Doubler";

    fn about() -> About {
        About::service("Doubles.")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn exports(exports: &mut Exports<Self>) {
        exports.procedure_later("Double", "Doubles.", |own: &mut Self, number, reply| own.asked.push((number, reply)));
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        let due = tick.now + Duration::from_millis(100);
        self.open.extend(self.asked.drain(..).map(|(number, reply)| (number, reply, due)));
        while self.open.first().is_some_and(|(_, _, due)| *due <= tick.now) {
            let (number, reply, _) = self.open.remove(0);
            reply.send(2.0 * number);
        }
        Progress::Continue
    }
}

#[derive(Outputs)]
struct AskerOutputs {
    #[calls("Ask")]
    ask: Calls<f64, f64>,
}

/// Asks once, and ends with the text of the answer.
struct Asker {
    has_asked: bool,
}

impl Controller for Asker {
    type Inputs = ();
    type Outputs = AskerOutputs;
    const TYPE: &'static str = "Asker";

    fn about() -> About {
        About::task("Asks.")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self { has_asked: false })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.has_asked = false;
        Ok(())
    }

    fn main_calc(&mut self, _: Tick, (): &(), outputs: &mut AskerOutputs) -> Progress {
        if !std::mem::replace(&mut self.has_asked, true) {
            outputs.ask.call(21.0, WITHIN);
        }
        match outputs.ask.answer() {
            None => Progress::Continue,
            Some((_, Ok(number))) => Progress::Done(number.to_string().into_bytes()),
            Some((_, Err(error))) => Progress::Aborted(error.to_string()),
        }
    }
}

struct Pair {
    harness: Harness,
    asker: ModuleId,
    doubler: ModuleId,
}

fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.add::<Asker>().add::<Doubler>();
    registry
}

impl Pair {
    fn new() -> Self {
        let mut harness = Harness::new(Disturbance::NONE);
        let [asker, doubler] = ["Asker", "Doubler"].map(|name| harness.add(registry().create(name, &[]).unwrap()));
        let (caller, server) = (CallEnd { module: asker, name: "Ask" }, CallEnd { module: doubler, name: "Double" });
        let wire = harness.connect_call(caller, server).unwrap();
        harness.open(wire);
        Self { harness, asker, doubler }
    }

    /// Runs until the asker ends; `act` happens after 50 ms. Returns the end, and its time in ms.
    fn end(&mut self, act: impl FnOnce(&mut Self)) -> (String, u128) {
        self.harness.activate(self.asker, &[]);
        assert_eq!(self.harness.run(Time::ZERO + Duration::from_millis(50)), None);
        act(self);
        let report = self.harness.run(Time::ZERO + 5 * WITHIN).unwrap();
        (format!("{:?}", report.ending), report.at.since(Time::ZERO).as_millis())
    }
}

fn aborted(error: &ObjectError) -> String {
    format!("Aborted({:?})", error.to_string())
}

#[test]
fn a_call_has_the_answer_of_its_server() {
    let mut pair = Pair::new();
    pair.harness.activate(pair.doubler, &[]);
    let (end, at) = pair.end(|_| {});
    assert!(end == format!("{:?}", controllers::sdk::harness::Ending::Done(b"42".to_vec())), "{end}");
    assert!((100..150).contains(&at), "{at} ms");
}

#[test]
fn a_call_waits_for_a_server_that_does_not_run_yet() {
    let mut pair = Pair::new();
    let (end, _) = pair.end(|pair| pair.harness.activate(pair.doubler, &[]));
    assert!(end.starts_with("Done"), "{end}");
    let (end, at) = Pair::new().end(|_| {});
    assert!(end.contains("its process does not run") && (1000..1100).contains(&at), "{end} after {at} ms");
}

#[test]
fn a_call_over_a_cut_ends_at_its_deadline() {
    let mut pair = Pair::new();
    pair.harness.activate(pair.doubler, &[]);
    let doubler = pair.doubler;
    let (end, at) = pair.end(|pair| pair.harness.cut(&[doubler]));
    assert_eq!((end, at / 100), (aborted(&ObjectError::Deadline { within: WITHIN }), 20));
}

#[test]
fn a_call_of_a_program_that_dies_is_gone() {
    let mut pair = Pair::new();
    pair.harness.activate(pair.doubler, &[]);
    let (end, at) = pair.end(|pair| {
        pair.harness.replace(pair.doubler, registry().create("Doubler", &[]).unwrap());
    });
    assert_eq!(end, aborted(&ObjectError::Gone));
    assert!((50..80).contains(&at), "{at} ms");
}

#[test]
fn a_call_without_an_open_connection_is_refused() {
    let mut harness = Harness::new(Disturbance::NONE);
    let asker = harness.add(registry().create("Asker", &[]).unwrap());
    harness.activate(asker, &[]);
    let report = harness.run(Time::ZERO + WITHIN).unwrap();
    assert_eq!(format!("{:?}", report.ending), aborted(&ObjectError::NotConnected { name: "Ask".to_owned() }));
    let nowhere = CallEnd { module: asker, name: "Double" };
    assert!(harness.connect_call(CallEnd { module: asker, name: "Ask" }, nowhere).is_err());
}
