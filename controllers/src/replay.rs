//! The controller that stands in for a process whose values were recorded. `dca replay` puts it into a plan.
//!
//! Each activation plays the next recorded activation. The recorded values leave the outputs at the recorded times since
//! the beginning of the activation, and the activation ends as recorded. Values for the inputs are ignored, and the
//! procedures refuse every call.

use crate::sdk::{
    About, Access, Activity, Arguments, CallInterface, Configured, Delivery, DeliveryError, Direction, ExportInterface,
    ExportKind, Interface, Kind, Module, ObjectError, Parameter, PortInterface, Progress, RawReply, Signal, Stopping,
};
use comms::logic::object::Signature;
use comms::logic::replay::{REPLAY, STEPS_MAX, Stamp, Step, take};
use comms::logic::time::Time;
use std::time::Duration;

/// The resolution of the times at which values leave.
const PERIOD: Duration = Duration::from_millis(1);
/// The slowest and the fastest rate.
const RATES: (f64, f64) = (0.001, 1000.0);
/// In a list of names, blanks separate the names.
const PARAMETERS: &[Parameter] = &[
    Parameter::new("file", Kind::Text(&[])),
    Parameter::new("rate", Kind::Number(RATES.0, RATES.1)).or("1"),
    Parameter::new("outputs", Kind::Text(&[])).or(""),
    Parameter::new("inputs", Kind::Text(&[])).or(""),
    Parameter::new("exports", Kind::Text(&[])).or(""),
    Parameter::new("calls", Kind::Text(&[])).or(""),
];

/// Returns the interface of a stand-in without ports.
pub(crate) fn interface() -> Interface {
    let about = About::task("Stands in for a process whose values were recorded. `dca replay` adds it.");
    let about = about.every(PERIOD).with(PARAMETERS);
    Interface { type_name: REPLAY, about, ports: Vec::new(), exports: Vec::new(), calls: Vec::new(), inner: Vec::new() }
}

/// A process that takes the place of a recorded process.
#[derive(Debug)]
pub(crate) struct Replay {
    interface: Interface,
    outputs: Vec<&'static str>,
    rate: f64,
    steps: Vec<u8>,
    /// The number of bytes of the steps that have been played.
    played: usize,
    began: Time,
    /// The values that leave after this calculation.
    leaving: Vec<(&'static str, Vec<u8>)>,
    /// The number of values that have left.
    sent: u64,
}

impl Replay {
    /// Makes a stand-in that is not active yet.
    ///
    /// # Errors
    /// A sentence for a person, if the file cannot be read.
    pub(crate) fn new(arguments: &Arguments) -> Result<Self, String> {
        let file = arguments.text("file");
        let steps = std::fs::metadata(file).and_then(|about| {
            if about.len() > STEPS_MAX { Err(std::io::ErrorKind::FileTooLarge.into()) } else { std::fs::read(file) }
        });
        let steps = steps.map_err(|error| format!("reading the recorded values in `{file}`: {error}"))?;
        let names = |parameter| arguments.text(parameter).split_whitespace().map(for_ever).collect::<Vec<_>>();
        let (outputs, inputs) = (names("outputs"), names("inputs"));
        let port = |direction| move |name: &&'static str| PortInterface::wire(name, direction, "");
        let ports = inputs.iter().map(port(Direction::In)).chain(outputs.iter().map(port(Direction::Out)));
        let export = |name| ExportInterface {
            name,
            kind: ExportKind::Procedure,
            signature: Signature::default(),
            doc: "",
            is_answered_idle: true,
            access: Access::Operate,
        };
        let call = |name| CallInterface { name, signature: Signature::default(), doc: "", required: false };
        let exports = names("exports").into_iter().map(export).collect();
        let calls = names("calls").into_iter().map(call).collect();
        let interface = Interface { ports: ports.collect(), exports, calls, ..interface() };
        let rate = arguments.number("rate");
        let (played, began, leaving, sent) = (0, Time::ZERO, Vec::new(), 0);
        Ok(Self { interface, outputs, rate, steps, played, began, leaving, sent })
    }

    fn next(&self) -> Option<(Step, usize)> {
        let rest = self.steps.get(self.played..)?;
        take(rest).map(|(step, behind)| (step, self.steps.len() - behind.len()))
    }

    /// Writes the time of a measurement, converted to the clock of this host, into a value.
    #[expect(clippy::cast_precision_loss, reason = "exact for 104 days")]
    fn write_stamp(&self, bytes: &mut [u8], stamp: Stamp) {
        let since = stamp.nanos as f64 / 1e9 / self.rate;
        let time = (self.began.since(Time::ZERO).as_secs_f64() + since).max(0.0);
        let place = usize::try_from(stamp.place).ok().and_then(|place| bytes.get_mut(place..place.checked_add(8)?));
        if let Some(place) = place {
            place.copy_from_slice(&time.to_le_bytes());
        }
    }

    fn is_due(&self, at: Duration, now: Time) -> bool {
        now.since(self.began).as_secs_f64() * self.rate >= at.as_secs_f64()
    }
}

impl Module for Replay {
    fn interface(&self) -> &Interface {
        &self.interface
    }

    fn deliver(&mut self, _: &str, _: &[u8], _: Time) -> Result<Delivery, DeliveryError> {
        Ok(Delivery::Stored)
    }

    fn init(&mut self, _: &[u8], now: Time) -> Result<(), String> {
        self.leaving.clear();
        while let Some((step, behind)) = self.next() {
            self.played = behind;
            if step == Step::Begin {
                self.began = now;
                return Ok(());
            }
        }
        Err("the record has no further run of this process".to_owned())
    }

    fn configure(&mut self, _: Arguments, _: bool) -> Result<Configured, String> {
        Err("a process that is replayed has no parameters that change".to_owned())
    }

    fn calculate(&mut self, now: Time) -> Progress {
        while let Some((step, behind)) = self.next() {
            match step {
                Step::Value { at, port, mut bytes, stamp } if self.is_due(at, now) => {
                    if let Some(stamp) = stamp {
                        self.write_stamp(&mut bytes, stamp);
                    }
                    let output = usize::try_from(port).ok().and_then(|place| self.outputs.get(place));
                    self.leaving.extend(output.map(|output| (*output, bytes)));
                    self.sent += 1;
                }
                Step::Done { at, value } if self.is_due(at, now) => return Progress::Done(value),
                Step::Aborted { at, reason } if self.is_due(at, now) => {
                    return Progress::Aborted(format!("as recorded: {reason}"));
                }
                Step::Begin | Step::Value { .. } | Step::Done { .. } | Step::Aborted { .. } => break,
            }
            self.played = behind;
        }
        Progress::Continue
    }

    fn stop(&mut self, _: Time) -> Stopping {
        self.leaving.clear();
        Stopping::Finished
    }

    fn drain(&mut self, send: &mut dyn FnMut(&'static str, Vec<u8>)) {
        self.leaving.drain(..).for_each(|(port, bytes)| send(port, bytes));
    }

    fn signals(&self) -> Vec<Signal> {
        #[expect(clippy::cast_precision_loss, reason = "a count for people")]
        let value = self.sent as f64;
        vec![Signal { name: "values".to_owned(), unit: String::new(), value, headline: false }]
    }

    fn serve(&mut self, name: &str, _: &[u8], _: Activity, reply: RawReply) {
        let reason = format!("`{name}` is not carried out: the process is replayed from a record");
        reply.answer(Err(ObjectError::Refused { reason }));
    }
}

/// Returns a text that lives as long as the process, like the names in interfaces. An interface is made once.
fn for_ever(text: &str) -> &'static str {
    Box::leak(text.to_owned().into_boxed_str())
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::replay::append;

    fn replay(steps: &[Step], rate: &str) -> Replay {
        let bytes = steps.iter().fold(Vec::new(), |bytes, step| append(step, bytes).unwrap());
        let file = tempfile(&bytes);
        let words = [format!("file={}", file.display()), format!("rate={rate}"), "outputs=A B".to_owned()];
        let made = Replay::new(&Arguments::parse(PARAMETERS, &words).unwrap()).unwrap();
        std::fs::remove_file(file).unwrap();
        made
    }

    fn tempfile(bytes: &[u8]) -> std::path::PathBuf {
        use std::sync::atomic::{AtomicU32, Ordering};
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let file = std::env::temp_dir().join(format!("dca-replay-{}-{number}", std::process::id()));
        std::fs::write(&file, bytes).unwrap();
        file
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn value(at: u64, port: u32) -> Step {
        Step::Value { at: ms(at), port, bytes: vec![u8::try_from(at).unwrap()], stamp: None }
    }

    fn sent(replay: &mut Replay) -> Vec<(&'static str, u8)> {
        let mut all = Vec::new();
        replay.drain(&mut |port, bytes| all.push((port, bytes[0])));
        all
    }

    #[test]
    fn values_leave_at_their_times_and_each_activation_is_the_next_one() {
        let done = Step::Done { at: ms(40), value: vec![9] };
        let steps = [Step::Begin, value(0, 0), value(20, 1), value(21, 0), done, Step::Begin, value(10, 0)];
        let mut replay = replay(&steps, "2");
        let at = |ms: u64| Time::ZERO + Duration::from_micros(1_000_000 + ms * 1000);
        replay.init(&[], at(0)).unwrap();
        assert_eq!(replay.calculate(at(0)), Progress::Continue);
        assert_eq!(sent(&mut replay), [("A", 0)]);
        assert_eq!((replay.calculate(at(9)), sent(&mut replay)), (Progress::Continue, vec![]));
        assert_eq!((replay.calculate(at(11)), sent(&mut replay)), (Progress::Continue, vec![("B", 20), ("A", 21)]));
        assert_eq!(replay.calculate(at(19)), Progress::Continue);
        assert_eq!(replay.calculate(at(20)), Progress::Done(vec![9]));
        replay.init(&[], at(100)).unwrap();
        assert_eq!((replay.calculate(at(105)), sent(&mut replay)), (Progress::Continue, vec![("A", 10)]));
        assert_eq!(replay.calculate(at(9000)), Progress::Continue, "it was not ended");
        assert_eq!(replay.init(&[], at(9001)).unwrap_err(), "the record has no further run of this process");
    }

    #[test]
    fn an_activation_that_is_stopped_early_leaves_out_the_rest_of_its_values() {
        let steps = [Step::Begin, value(5, 0), value(50, 0), Step::Begin, value(7, 1)];
        let mut replay = replay(&steps, "1");
        replay.init(&[], Time::ZERO).unwrap();
        replay.calculate(Time::ZERO + ms(6));
        replay.stop(Time::ZERO + ms(6));
        replay.init(&[], Time::ZERO + ms(10)).unwrap();
        replay.calculate(Time::ZERO + ms(20));
        assert_eq!(sent(&mut replay), [("B", 7)]);
    }

    #[test]
    fn the_time_of_measurement_is_on_the_clock_of_this_host() {
        let stamp = |place, nanos| Some(Stamp { place, nanos });
        let measured = |at, stamp| Step::Value { at: ms(at), port: 0, bytes: vec![7; 10], stamp };
        let steps = [
            Step::Begin,
            measured(10, stamp(1, 8_000_000)),
            measured(12, stamp(0, -4_000_000)),
            measured(12, stamp(3, 0)),
        ];
        let mut replay = replay(&steps, "2");
        let began = Time::ZERO + Duration::from_secs(50);
        replay.init(&[], began).unwrap();
        replay.calculate(began + ms(6));
        let mut all = Vec::new();
        replay.drain(&mut |_, bytes| all.push(bytes));
        let number = |bytes: &[u8]| f64::from_le_bytes(bytes.try_into().unwrap());
        assert_eq!((all[0][0], number(&all[0][1..9]).to_bits(), all[0][9]), (7, 50.004_f64.to_bits(), 7));
        assert_eq!(number(&all[1][..8]).to_bits(), 49.998_f64.to_bits());
        assert_eq!(all[2], [7; 10], "the place is not within the value");
    }

    #[test]
    fn a_failure_is_that_of_the_record() {
        let steps = [Step::Begin, Step::Aborted { at: ms(1), reason: "no door".to_owned() }];
        let mut replay = replay(&steps, "1");
        replay.init(&[], Time::ZERO).unwrap();
        assert_eq!(replay.calculate(Time::ZERO + ms(2)), Progress::Aborted("as recorded: no door".to_owned()));
        let missing = Arguments::parse(PARAMETERS, &["file=/nowhere/at/all"]).unwrap();
        assert!(Replay::new(&missing).unwrap_err().contains("reading the recorded values in `/nowhere/at/all`"));
    }
}
