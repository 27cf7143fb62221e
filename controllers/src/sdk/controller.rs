//! The trait that a controller implements.

use super::arguments::{Arguments, Parameter};
use super::export::Exports;
use super::finite::is_finite;
use super::port::{InputSet, Message, OutputSet};
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use serde::Serialize;
use std::time::Duration;

/// A leaf of a spec: `Init()`, `Run()`, `MainCalc()` and `Stop()` of the paper's section 4.2.
///
/// One activation is `init`, then `run`. After that `main_calc` is called once per period, or once per sample of the
/// trigger port. This ends when `main_calc` returns that the controller is done or aborted, or when a stop is
/// requested. Then `stop` is called once per period until it is finished. After that `init` may be called again. Calls
/// never overlap. Inputs are forgotten between activations.
pub trait Controller: Sized + Send + 'static {
    /// The inputs: a struct with `#[derive(Inputs)]`, or `()`.
    type Inputs: InputSet;
    /// The outputs: a struct with `#[derive(Outputs)]`, or `()`.
    type Outputs: OutputSet;
    /// The name of the process type in specs.
    const TYPE: &'static str;

    /// Describes the type.
    fn about() -> About;

    /// Makes an instance that is not active, from arguments of the declared kinds.
    ///
    /// # Errors
    /// Says in one line what is wrong with the arguments.
    fn new(arguments: &Arguments) -> Result<Self, String>;

    /// Prepares an activation and forgets the previous one. `value` is the value of the previous process, often empty.
    ///
    /// # Errors
    /// Says in one line why the controller cannot run; the activation is then aborted.
    fn init(&mut self, value: &[u8]) -> Result<(), String> {
        let _ = value;
        Ok(())
    }

    /// Begins to run; called once, directly after `init`.
    fn run(&mut self, now: Time) {
        let _ = now;
    }

    /// Takes new values for the parameters during the run, between two calculations. A controller that cannot do that
    /// keeps the default implementation: then [`Controller::new`] gets the values before the next activation.
    ///
    /// # Errors
    /// Says in one line what is wrong with the new values; the old values stay.
    fn configure(&mut self, arguments: &Arguments) -> Result<Configured, String> {
        let _ = arguments;
        Ok(Configured::Later)
    }

    /// Reads the inputs, calculates, and sends to the outputs.
    fn main_calc(&mut self, tick: Tick, inputs: &Self::Inputs, outputs: &mut Self::Outputs) -> Progress;

    /// Stops and releases everything. It is called once per period until it no longer returns [`Stopping::Again`]. If
    /// this takes longer than [`About::stop_within`], the program is killed, and the activation is aborted.
    fn stop(&mut self, tick: Tick, inputs: &Self::Inputs, outputs: &mut Self::Outputs) -> Stopping {
        let _ = (tick, inputs, outputs);
        Stopping::Finished
    }

    /// Returns, for a person, why the end of the last [`Controller::stop`] is not certain:
    /// something outside of the program may continue, or may be in a wrong state. Called once,
    /// after the stop. If there is a reason, an ordered stop counts as unconfirmed, and any other end is an abort.
    fn unconfirmed(&self) -> Option<String> {
        None
    }

    /// Declares which procedures others may call and which states they may read, between two calculations. The
    /// procedures are functions of this type: `exports.procedure("Grip", "Closes the fingers.",
    /// Self::grip).state("opening", "How far it is open.", Self::opening)`.
    fn exports(exports: &mut Exports<Self>) {
        let _ = exports;
    }

    /// Returns the values that a person or a recorder may want to see, in a fixed order.
    fn signals(&self) -> Vec<Signal> {
        Vec::new()
    }
}

/// The time from which a controller uses new parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Configured {
    /// From the next calculation on.
    Now,
    /// From the next activation on.
    Later,
}

/// The moment of one calculation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// The present time on this host's clock.
    pub now: Time,
    /// The time since the last calculation of this activation; one period at the first calculation.
    pub elapsed: Duration,
}

impl Tick {
    /// Returns [`Tick::elapsed`] in seconds.
    pub fn dt(self) -> f64 {
        self.elapsed.as_secs_f64()
    }
}

/// The result of a calculation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Progress {
    /// The activation continues.
    Continue,
    /// The activation has ended normally. The next process gets this value.
    Done(Vec<u8>),
    /// The activation has failed, for this reason; the text is for a person.
    Aborted(String),
}

impl Progress {
    /// Returns the normal end with `value` for the next process, encoded with postcard. The result is an abort if a
    /// number in the value is not finite, or the value cannot be encoded.
    pub fn done<T: Serialize + ?Sized>(value: &T) -> Self {
        if !is_finite(value) {
            return Self::Aborted("a number in its result value is not finite".to_owned());
        }
        match postcard::to_stdvec(value) {
            Ok(bytes) => Self::Done(bytes),
            Err(cause) => Self::Aborted(format!("cannot encode its result value: {cause}")),
        }
    }

    /// Returns the normal end `tag`, one of [`About::outcomes`], with `value` for the next process; `&()` for no value.
    ///
    /// The bytes are the postcard encoding of `(tag, value)`: the length of the tag in one byte, the tag, and the value
    /// as [`Progress::done`] encodes it. A `match` removes the tag again. The result is an abort if the tag is empty or
    /// longer than [`TAG_MAX`], or if `done` refuses the value. Whether `About::outcomes` contains the tag is checked
    /// when the process ends.
    pub fn outcome<T: Serialize + ?Sized>(tag: &str, value: &T) -> Self {
        if !(1..=TAG_MAX).contains(&tag.len()) {
            return Self::Aborted(format!("`{tag}` cannot be the tag of an outcome"));
        }
        Self::done(&(tag, value))
    }
}

/// Whether `stop` has to be called again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Stopping {
    /// Call `stop` again, one period later.
    Again,
    /// Nothing moves any more on behalf of this controller.
    Finished,
    /// The stop has failed, for this reason; the text is for a person. `stop` is not called again, and the activation is
    /// aborted.
    Failed(String),
}

/// The description of a controller type.
#[derive(Clone, Debug, PartialEq)]
pub struct About {
    /// One sentence.
    pub doc: &'static str,
    /// Whether the type never ends normally (a sensor, a motion controller). Otherwise it ends by itself (a detector, a
    /// step).
    pub service: bool,
    /// Whether the controller keeps state from one calculation to the next that it could not find again by itself.
    pub remembers: bool,
    /// When the controller calculates.
    pub schedule: Schedule,
    /// The longest duration of a stop.
    pub stop_within: Duration,
    /// Its parameters after the host, in order.
    pub parameters: &'static [Parameter],
    /// How often the signals are published. None without signals.
    pub signals_every: Option<Duration>,
    /// The normal ends, if there are several: each [`Progress::outcome`] is one of them.
    pub outcomes: &'static [Outcome],
    /// The message type of the value with which an activation starts; none if the type does not declare one.
    pub start: Option<StartValue>,
}

/// The value that [`Controller::init`] of a type gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StartValue {
    /// The message type: `Place`.
    pub type_name: &'static str,
    /// The fields of the message, as in a record; empty if the message type does not name them.
    pub fields: &'static str,
}

/// A normal end of a controller type, which a spec can `match`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// A word of the language, of at most [`TAG_MAX`] bytes: `found`.
    pub tag: &'static str,
    /// The message type of the value of this end; none for an end without a value.
    pub type_name: Option<&'static str>,
}

/// The longest tag of an outcome, in bytes.
pub const TAG_MAX: usize = 64;

/// When a controller calculates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// The time from one calculation to the next, on absolute deadlines.
    pub period: Duration,
    /// The port at which every new sample starts a calculation at once. The period is then the longest wait for a
    /// sample.
    pub trigger: Option<&'static str>,
}

impl About {
    const fn new(doc: &'static str, service: bool) -> Self {
        Self {
            doc,
            service,
            remembers: false,
            schedule: Schedule { period: Duration::from_millis(10), trigger: None },
            stop_within: Duration::from_millis(500),
            parameters: &[],
            signals_every: None,
            outcomes: &[],
            start: None,
        }
    }

    /// Returns a type that never ends normally.
    pub const fn service(doc: &'static str) -> Self {
        Self::new(doc, true)
    }

    /// Returns a type that ends by itself.
    pub const fn task(doc: &'static str) -> Self {
        Self::new(doc, false)
    }

    /// Declares that the type keeps state from one calculation to the next, such as an estimate or the progress of a
    /// motion. An instance that is restarted in the middle does not have this state, so `dca check` refuses a
    /// `restart` of this process alone. Do not use this for a type that finds its state again, from its inputs or from
    /// the database.
    #[must_use]
    pub const fn remembers(mut self) -> Self {
        self.remembers = true;
        self
    }

    /// Sets the period; 10 ms without this.
    #[must_use]
    pub const fn every(mut self, period: Duration) -> Self {
        self.schedule.period = period;
        self
    }

    /// Makes each new sample of `port` start a calculation. Without a sample, the next calculation is one period later.
    #[must_use]
    pub const fn triggered_by(mut self, port: &'static str) -> Self {
        self.schedule.trigger = Some(port);
        self
    }

    /// Sets the longest duration of `stop`; 500 ms without this.
    #[must_use]
    pub const fn stop_within(mut self, bound: Duration) -> Self {
        self.stop_within = bound;
        self
    }

    /// Sets the parameters after the host.
    #[must_use]
    pub const fn with(mut self, parameters: &'static [Parameter]) -> Self {
        self.parameters = parameters;
        self
    }

    /// Sets the normal ends.
    #[must_use]
    pub const fn ends_with(mut self, outcomes: &'static [Outcome]) -> Self {
        self.outcomes = outcomes;
        self
    }

    /// Sets the type of the start value, which a spec gives for example as `goto with { x = 2 m, y = 1 m }`.
    /// [`Controller::init`] gets its bytes, for `postcard::from_bytes`.
    #[must_use]
    pub const fn starts_with<T: Message>(mut self) -> Self {
        self.start = Some(StartValue { type_name: T::TYPE, fields: T::FIELDS });
        self
    }

    /// Sets how often the signals are published.
    #[must_use]
    pub const fn signals_every(mut self, period: Duration) -> Self {
        self.signals_every = Some(period);
        self
    }
}
