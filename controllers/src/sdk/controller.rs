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
/// One activation is `init`, `run`, then `main_calc` once per period (or per sample of the trigger port) until it says
/// that it is done or aborted, or until a stop is asked for; then `stop` once per period until it is finished. After
/// that `init` may be called again. Calls never overlap. Inputs are forgotten between activations.
pub trait Controller: Sized + Send + 'static {
    /// Its inputs, a struct with `#[derive(Inputs)]`, or `()`.
    type Inputs: InputSet;
    /// Its outputs, a struct with `#[derive(Outputs)]`, or `()`.
    type Outputs: OutputSet;
    /// The process type in specs.
    const TYPE: &'static str;

    /// Describes the type.
    fn about() -> About;

    /// Makes an idle instance from arguments that have the declared kinds.
    ///
    /// # Errors
    /// Says in one line what is wrong with the arguments.
    fn new(arguments: &Arguments) -> Result<Self, String>;

    /// Prepares an activation; forgets the previous one. `value` is the value of the previous process, often empty.
    ///
    /// # Errors
    /// Says in one line why it cannot run; the activation is then aborted.
    fn init(&mut self, value: &[u8]) -> Result<(), String> {
        let _ = value;
        Ok(())
    }

    /// Begins running; called once, directly after `init`.
    fn run(&mut self, now: Time) {
        let _ = now;
    }

    /// Takes other values for its parameters during the run, between two calculations. A controller that cannot do that
    /// keeps the default implementation: then [`Controller::new`] gets them before the next activation.
    ///
    /// # Errors
    /// Says in one line what is wrong with them; the old ones stay.
    fn configure(&mut self, arguments: &Arguments) -> Result<Configured, String> {
        let _ = arguments;
        Ok(Configured::Later)
    }

    /// Reads the inputs, calculates, sends to the outputs.
    fn main_calc(&mut self, tick: Tick, inputs: &Self::Inputs, outputs: &mut Self::Outputs) -> Progress;

    /// Stops and releases everything; called once per period until it is [`Stopping::Finished`], at most for
    /// [`About::stop_within`].
    fn stop(&mut self, tick: Tick, inputs: &Self::Inputs, outputs: &mut Self::Outputs) -> Stopping {
        let _ = (tick, inputs, outputs);
        Stopping::Finished
    }

    /// Returns why nothing may be sure about the end of the last [`Controller::stop`], for a person: something outside that
    /// may go on, or that is not as it should be. Asked once, after the stop. Then the stop counts as unconfirmed.
    fn unconfirmed(&self) -> Option<String> {
        None
    }

    /// Declares what others may call and read, between two calculations. The procedures are functions of this type:
    /// `exports.procedure("Grip", "Closes the fingers.", Self::grip).state("opening", "How far it is open.", Self::opening)`.
    fn exports(exports: &mut Exports<Self>) {
        let _ = exports;
    }

    /// Returns what a person or a recorder would like to see, in a fixed order.
    fn signals(&self) -> Vec<Signal> {
        Vec::new()
    }
}

/// When other parameters take effect in a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Configured {
    /// From its next calculation on.
    Now,
    /// When it is activated the next time.
    Later,
}

/// The moment of one calculation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// This host's clock.
    pub now: Time,
    /// Since the last calculation of this activation; one period at the first.
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
    /// Call again.
    Continue,
    /// Ended normally, leaving this value to the next process.
    Done(Vec<u8>),
    /// Failed, and why, for a person.
    Aborted(String),
}

impl Progress {
    /// Returns the normal end that leaves `value` to the next process, encoded with postcard. A number in it that is not finite is an
    /// abort, and so is a value that cannot be encoded.
    pub fn done<T: Serialize + ?Sized>(value: &T) -> Self {
        if !is_finite(value) {
            return Self::Aborted("a number in its result value is not finite".to_owned());
        }
        match postcard::to_stdvec(value) {
            Ok(bytes) => Self::Done(bytes),
            Err(cause) => Self::Aborted(format!("cannot encode its result value: {cause}")),
        }
    }

    /// Returns the normal end `tag`, one of [`About::outcomes`], leaving `value` to the next process; `&()` leaves none.
    ///
    /// The bytes are the postcard encoding of `(tag, value)`: the length of the tag in one byte, the tag, and the value as
    /// [`Progress::done`] encodes it. A `match` takes the tag off again. A tag that is empty or longer than [`TAG_MAX`] is
    /// an abort, and so is a value that `done` refuses. Whether `About::outcomes` has the tag is checked when the process
    /// ends.
    pub fn outcome<T: Serialize + ?Sized>(tag: &str, value: &T) -> Self {
        if !(1..=TAG_MAX).contains(&tag.len()) {
            return Self::Aborted(format!("`{tag}` cannot be the tag of an outcome"));
        }
        Self::done(&(tag, value))
    }
}

/// Whether `stop` has to be called again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stopping {
    /// One period later.
    Again,
    /// Nothing moves any more on behalf of this controller.
    Finished,
}

/// The description of a controller type.
#[derive(Clone, Debug, PartialEq)]
pub struct About {
    /// One sentence.
    pub doc: &'static str,
    /// True if it never ends normally (a sensor, a motion controller); false if it ends by itself (a detector, a step).
    pub service: bool,
    /// Whether it keeps state from one calculation to the next that it does not find again by itself.
    pub remembers: bool,
    /// When it calculates.
    pub schedule: Schedule,
    /// The longest its `stop` may take.
    pub stop_within: Duration,
    /// Its parameters after the host, in order.
    pub parameters: &'static [Parameter],
    /// How often its signals are published; none if it has none.
    pub signals_every: Option<Duration>,
    /// Its normal ends, when it has several: each [`Progress::outcome`] is one of them.
    pub outcomes: &'static [Outcome],
    /// The message type of the value that it starts with; none if it does not declare one.
    pub start: Option<StartValue>,
}

/// The value that a controller type gets in its [`Controller::init`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StartValue {
    /// The message type: `Place`.
    pub type_name: &'static str,
    /// The fields of the message, as of a record; empty if the message type does not name them.
    pub fields: &'static str,
}

/// A normal end of a controller type, which a spec can `match`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// A word of the language, of at most [`TAG_MAX`] bytes: `found`.
    pub tag: &'static str,
    /// The message type of the value that comes with it; none if there is no value.
    pub type_name: Option<&'static str>,
}

/// The longest tag of an outcome, in bytes.
pub const TAG_MAX: usize = 64;

/// When a controller calculates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// From one calculation to the next, on absolute deadlines.
    pub period: Duration,
    /// The port whose every new sample starts a calculation at once; the period is then the longest wait for one.
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

    /// Returns it keeping state from one calculation to the next, such as an estimate or how far it has come, which an instance
    /// that is started again in the middle does not have. `dca check` then refuses a `restart` of it alone. A type that finds
    /// its state again, from its inputs or from the database, does not say so.
    #[must_use]
    pub const fn remembers(mut self) -> Self {
        self.remembers = true;
        self
    }

    /// Returns it with a period; 10 ms otherwise.
    #[must_use]
    pub const fn every(mut self, period: Duration) -> Self {
        self.schedule.period = period;
        self
    }

    /// Returns it calculating on each new sample of `port`, and at the latest after one period.
    #[must_use]
    pub const fn triggered_by(mut self, port: &'static str) -> Self {
        self.schedule.trigger = Some(port);
        self
    }

    /// Returns it with a bound on `stop`; 500 ms otherwise.
    #[must_use]
    pub const fn stop_within(mut self, bound: Duration) -> Self {
        self.stop_within = bound;
        self
    }

    /// Returns it with parameters after the host.
    #[must_use]
    pub const fn with(mut self, parameters: &'static [Parameter]) -> Self {
        self.parameters = parameters;
        self
    }

    /// Returns it with several normal ends.
    #[must_use]
    pub const fn ends_with(mut self, outcomes: &'static [Outcome]) -> Self {
        self.outcomes = outcomes;
        self
    }

    /// Returns it starting with a value of this type, as `goto with { x = 2 m, y = 1 m }` in a spec gives one. [`Controller::init`]
    /// gets its bytes, for `postcard::from_bytes`.
    #[must_use]
    pub const fn starts_with<T: Message>(mut self) -> Self {
        self.start = Some(StartValue { type_name: T::TYPE, fields: T::FIELDS });
        self
    }

    /// Returns it publishing its signals this often.
    #[must_use]
    pub const fn signals_every(mut self, period: Duration) -> Self {
        self.signals_every = Some(period);
        self
    }
}
