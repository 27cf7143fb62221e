//! One program on this host, from PREPARE to the moment when nothing of it is left.
//!
//! ```text
//! Starting ─hello─▶ Prepared ─connect─▶ Connecting ─connected─▶ Idle ⇄ Running ─▶ Stopping ─▶ Idle
//!     any ─program ended, nothing left─▶ Dead          any ─leave─▶ Leaving ─▶ Dead
//! ```
//! Invariants: exactly one ending for each activation, and only when the controller has finished its `Stop()` or when
//! nothing of the program is left; a stop is bounded by `stop_within`, then by the grace after SIGTERM, then by the
//! time the kernel has to remove what was killed.

use crate::logic::child::{ShimOrder, ShimReport};
use crate::logic::effect::{Effect, SpawnOrder};
use crate::logic::protocol::{Change, Ending, Failure, FailureCause, LeafFacts};
use comms::logic::control::{Notice, Order, VERSION};
use comms::logic::time::Time;
use language::plan::LeafKind;
use std::time::Duration;

/// How long a program has to say hello.
const START_WITHIN: Duration = Duration::from_secs(15);
/// How long a program has to make its links.
const CONNECT_WITHIN: Duration = Duration::from_secs(10);
/// How long a program has between SIGTERM and SIGKILL.
const GRACE: Duration = Duration::from_secs(1);
/// The most bytes that a process may leave for the next.
const VALUE_MAX: usize = 1 << 20;
/// How long the kernel has to remove a killed program.
const KILL_WITHIN: Duration = Duration::from_secs(2);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Starting {
        until: Time,
    },
    Prepared,
    Connecting {
        until: Time,
    },
    Idle,
    Running {
        activation: u32,
    },
    Stopping {
        activation: u32,
        until: Time,
        forced: bool,
    },
    /// It cannot take part, and has said so.
    Refused,
    Leaving {
        until: Time,
        forced: bool,
        activation: Option<u32>,
    },
    Dead,
}

/// What an instance has to say to its deployment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Note {
    /// The program is up and has told where it is.
    Prepared(LeafFacts),
    /// It cannot take part.
    Refused(String),
    /// Its links stand.
    Connected,
    /// It has switched the wires of this generation.
    Switched(u64),
    /// An activation ended.
    Ended(u32, Ending),
    /// For those who watch.
    Changed(Change),
    /// Nothing of the program is left.
    Gone,
}

/// One program.
#[derive(Debug)]
pub struct Instance {
    order: SpawnOrder,
    stop_within: Duration,
    stage: Stage,
    pid: Option<u32>,
    cause: Option<FailureCause>,
    last_words: Option<String>,
}

/// What an instance needs to know of the moment, and where it puts what it wants.
#[derive(Debug)]
pub struct Moment<'a> {
    /// The time of the input.
    pub now: Time,
    /// Time since GO.
    pub since_go: Duration,
    /// For the driver.
    pub effects: &'a mut Vec<Effect>,
    /// For the deployment.
    pub notes: &'a mut Vec<Note>,
}

impl Instance {
    /// Starts a program; a plain one is held by its shim.
    pub fn spawn(order: SpawnOrder, stop_within: Duration, moment: &mut Moment<'_>) -> Self {
        moment.effects.push(Effect::Spawn(Box::new(order.clone())));
        let stage = Stage::Starting { until: moment.now + START_WITHIN };
        Self { order, stop_within, stage, pid: None, cause: None, last_words: None }
    }

    /// Returns one word for a person, with the reason when it is dead.
    pub fn state(&self) -> String {
        let word = match self.stage {
            Stage::Starting { .. } => "starting",
            Stage::Prepared | Stage::Connecting { .. } => "connecting",
            Stage::Refused => "refused",
            Stage::Idle => "idle",
            Stage::Running { .. } => "running",
            Stage::Stopping { .. } => "stopping",
            Stage::Leaving { .. } => "leaving",
            Stage::Dead => {
                return self.cause.as_ref().map_or_else(|| "ended".to_owned(), |cause| format!("dead: {cause}"));
            }
        };
        word.to_owned()
    }

    /// Returns the program's process id, once it has one.
    pub fn pid(&self) -> Option<u32> {
        self.pid.filter(|_| self.stage != Stage::Dead)
    }

    /// Returns whether nothing of the program is left.
    pub fn is_gone(&self) -> bool {
        self.stage == Stage::Dead
    }

    /// Returns when [`Instance::tick`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        match self.stage {
            Stage::Starting { until }
            | Stage::Connecting { until }
            | Stage::Stopping { until, .. }
            | Stage::Leaving { until, .. } => Some(until),
            Stage::Prepared | Stage::Idle | Stage::Running { .. } | Stage::Refused | Stage::Dead => None,
        }
    }

    /// Makes the program's links.
    pub fn connect(&mut self, orders: impl IntoIterator<Item = Order>, moment: &mut Moment<'_>) {
        if self.stage != Stage::Prepared {
            return;
        }
        self.stage = Stage::Connecting { until: moment.now + CONNECT_WITHIN };
        for order in orders {
            self.tell(order, moment);
        }
    }

    /// Passes an order to open or close wires on. Returns whether the program will answer.
    pub fn switch(&mut self, order: Order, moment: &mut Moment<'_>) -> bool {
        let answers = !matches!(self.stage, Stage::Dead | Stage::Leaving { .. }) && self.is_controller();
        if answers {
            self.tell(order, moment);
        }
        answers
    }

    /// Initialises and runs the program.
    pub fn activate(&mut self, activation: u32, value: Vec<u8>, moment: &mut Moment<'_>) {
        match self.stage {
            Stage::Idle => {
                self.stage = Stage::Running { activation };
                moment.notes.push(Note::Changed(Change::Activated));
                if self.is_controller() {
                    self.tell(Order::Activate { activation, value }, moment);
                } else {
                    self.tell_shim(ShimOrder::Go, moment);
                }
            }
            Stage::Running { activation: other } | Stage::Stopping { activation: other, .. } if other == activation => {
            }
            Stage::Running { .. } | Stage::Stopping { .. } => self.end(activation, FailureCause::Busy, moment),
            Stage::Starting { .. } | Stage::Prepared | Stage::Connecting { .. } | Stage::Refused => {
                self.end(activation, FailureCause::NotAvailable("it is not connected".into()), moment);
            }
            Stage::Leaving { .. } | Stage::Dead => {
                let gone = || FailureCause::NotAvailable("its program is not running".into());
                self.end(activation, self.cause.clone().unwrap_or_else(gone), moment);
            }
        }
    }

    /// Stops an activation; one that is over is left to the ending already sent.
    pub fn stop(&mut self, activation: u32, moment: &mut Moment<'_>) {
        if self.stage != (Stage::Running { activation }) {
            return;
        }
        moment.notes.push(Note::Changed(Change::Stopping));
        if self.is_controller() {
            self.stage = Stage::Stopping { activation, until: moment.now + self.stop_within, forced: false };
            self.tell(Order::Stop { activation }, moment);
        } else {
            let until = moment.now + self.stop_within + KILL_WITHIN;
            self.stage = Stage::Stopping { activation, until, forced: true };
            self.tell_shim(ShimOrder::Stop { grace: self.stop_within }, moment);
        }
    }

    /// Stops whatever activation runs: its supervisor is lost.
    pub fn stop_current(&mut self, moment: &mut Moment<'_>) {
        if let Stage::Running { activation } = self.stage {
            self.stop(activation, moment);
        }
    }

    /// Takes note that an order did not reach the program: it is of no more use.
    pub fn undelivered(&mut self, why: String, moment: &mut Moment<'_>) {
        if !matches!(self.stage, Stage::Dead | Stage::Leaving { .. }) {
            self.cause.get_or_insert(FailureCause::NotAvailable(why));
            self.tell_shim(ShimOrder::Stop { grace: GRACE }, moment);
        }
    }

    /// Returns whether the program may still be there although everything was done to end it.
    pub fn is_unconfirmed(&self) -> bool {
        self.stage == Stage::Dead && self.cause == Some(FailureCause::StopUnconfirmed)
    }

    fn activation(&self) -> Option<u32> {
        match self.stage {
            Stage::Running { activation } | Stage::Stopping { activation, .. } => Some(activation),
            Stage::Leaving { activation, .. } => activation,
            Stage::Starting { .. }
            | Stage::Prepared
            | Stage::Connecting { .. }
            | Stage::Idle
            | Stage::Refused
            | Stage::Dead => None,
        }
    }

    /// Ends the program.
    pub fn leave(&mut self, moment: &mut Moment<'_>) {
        match self.stage {
            Stage::Dead => moment.notes.push(Note::Gone),
            Stage::Leaving { .. } => {}
            // One that has not said hello has no channel for an order yet.
            Stage::Starting { .. } | Stage::Refused => self.force_out(moment),
            Stage::Prepared
            | Stage::Connecting { .. }
            | Stage::Idle
            | Stage::Running { .. }
            | Stage::Stopping { .. } => {
                if self.is_controller() {
                    let (until, activation) = (moment.now + self.stop_within + GRACE, self.activation());
                    self.stage = Stage::Leaving { until, forced: false, activation };
                    self.tell(Order::Exit, moment);
                } else {
                    self.force_out(moment);
                }
            }
        }
    }

    /// Takes a word from the controller.
    pub fn hear(&mut self, notice: Notice, moment: &mut Moment<'_>) {
        match notice {
            Notice::Hello { version, location, owns, needs, signals, .. } => {
                if !matches!(self.stage, Stage::Starting { .. }) {
                    return;
                }
                if version != VERSION {
                    let why = format!("it speaks version {version} of the control protocol, this node {VERSION}");
                    return self.refuse(&why, moment);
                }
                self.stage = Stage::Prepared;
                let leaf = self.order.process.leaf;
                moment.notes.push(Note::Prepared(LeafFacts { leaf, location, owns, needs, signals }));
            }
            Notice::Connected if matches!(self.stage, Stage::Connecting { .. }) => {
                self.stage = Stage::Idle;
                moment.notes.push(Note::Connected);
            }
            Notice::ConnectFailed { reason } if matches!(self.stage, Stage::Connecting { .. }) => {
                self.refuse(&reason, moment);
            }
            Notice::Switched { generation } => moment.notes.push(Note::Switched(generation)),
            Notice::Done { activation, value } => {
                let ending = if value.len() <= VALUE_MAX {
                    Ending::Done(value)
                } else {
                    let why = format!("it leaves a value of {} bytes; {VALUE_MAX} are allowed", value.len());
                    Ending::Aborted(self.failure(FailureCause::Reported(why), moment))
                };
                self.ended(activation, ending, moment);
            }
            Notice::Aborted { activation, reason } => {
                let failure = self.failure(FailureCause::Reported(reason), moment);
                self.ended(activation, Ending::Aborted(failure), moment);
            }
            Notice::Stopped { activation } => self.ended(activation, Ending::Stopped, moment),
            Notice::Connected | Notice::ConnectFailed { .. } | Notice::Running { .. } => {}
        }
    }

    /// Takes a word from the shim. `last_words` is the last line of the program's output.
    pub fn observe(&mut self, report: ShimReport, last_words: Option<String>, moment: &mut Moment<'_>) {
        match report {
            ShimReport::Ready => {
                if matches!(self.stage, Stage::Starting { .. }) && !self.is_controller() {
                    self.stage = Stage::Prepared;
                    moment.notes.push(Note::Prepared(LeafFacts::plain(self.order.process.leaf)));
                }
            }
            ShimReport::Started { pid } => {
                self.pid = Some(pid);
                moment.notes.push(Note::Changed(Change::Started { pid }));
            }
            ShimReport::Exited { code } => {
                self.cause.get_or_insert(FailureCause::Exit(code));
                self.last_words = last_words;
            }
            ShimReport::Signalled { signal } => {
                self.cause.get_or_insert(FailureCause::Signal(signal));
                self.last_words = last_words;
            }
            ShimReport::ExecFailed { reason } => {
                self.cause.get_or_insert(FailureCause::Exec(reason));
            }
            ShimReport::Gone => self.gone(moment),
        }
    }

    /// Confirms the links of a plain program, which has none.
    pub fn connect_plain(&mut self) {
        if self.stage == Stage::Prepared && !self.is_controller() {
            self.stage = Stage::Idle;
        }
    }

    /// Does what is due.
    pub fn tick(&mut self, moment: &mut Moment<'_>) {
        if self.deadline().is_none_or(|at| at > moment.now) {
            return;
        }
        match self.stage {
            Stage::Starting { .. } => {
                let words =
                    self.last_words.as_ref().map(|words| format!("; it last said: {words}")).unwrap_or_default();
                self.refuse(&format!("it did not report within {} s{words}", START_WITHIN.as_secs()), moment);
            }
            Stage::Connecting { .. } => {
                self.refuse(&format!("it did not make its links within {} s", CONNECT_WITHIN.as_secs()), moment);
            }
            Stage::Stopping { activation, forced: false, .. } => {
                let until = moment.now + GRACE + KILL_WITHIN;
                self.stage = Stage::Stopping { activation, until, forced: true };
                self.tell_shim(ShimOrder::Stop { grace: GRACE }, moment);
            }
            Stage::Stopping { activation, forced: true, .. } => {
                self.stage = Stage::Dead;
                self.cause = Some(FailureCause::StopUnconfirmed);
                moment.notes.push(Note::Ended(activation, Ending::Unconfirmed));
            }
            Stage::Leaving { forced: false, .. } => self.force_out(moment),
            Stage::Leaving { forced: true, .. } => {
                self.cause = Some(FailureCause::StopUnconfirmed);
                self.gone(moment);
            }
            Stage::Prepared | Stage::Idle | Stage::Running { .. } | Stage::Refused | Stage::Dead => {}
        }
    }

    fn gone(&mut self, moment: &mut Moment<'_>) {
        let cause = self.cause.clone().unwrap_or_else(|| FailureCause::NotAvailable("its shim was killed".into()));
        let before = std::mem::replace(&mut self.stage, Stage::Dead);
        moment.effects.push(Effect::Forget { process: self.order.process.clone() });
        match before {
            Stage::Starting { .. } | Stage::Prepared | Stage::Connecting { .. } => {
                let words = self.last_words.clone().unwrap_or_else(|| cause.to_string());
                self.refuse(&words, moment);
            }
            Stage::Running { activation } => {
                let ending = if cause == FailureCause::Exit(0) && !self.is_controller() {
                    Ending::Done(Vec::new())
                } else {
                    Ending::Aborted(self.failure(cause, moment))
                };
                moment.notes.push(Note::Ended(activation, ending));
                self.again(moment);
            }
            Stage::Stopping { activation, .. } => {
                moment.notes.push(Note::Ended(activation, Ending::Stopped));
                self.again(moment);
            }
            Stage::Idle => moment.notes.push(Note::Changed(Change::Died(cause))),
            Stage::Leaving { activation, .. } => {
                if let Some(activation) = activation {
                    let ending =
                        Ending::Aborted(self.failure(FailureCause::NotAvailable("its node left".into()), moment));
                    moment.notes.push(Note::Ended(activation, ending));
                }
                moment.notes.push(Note::Gone);
            }
            Stage::Refused | Stage::Dead => {}
        }
    }

    /// Holds a plain program ready for its next activation: it runs once for each.
    fn again(&mut self, moment: &mut Moment<'_>) {
        if self.is_controller() {
            return;
        }
        (self.pid, self.cause, self.last_words) = (None, None, None);
        self.stage = Stage::Idle;
        moment.effects.push(Effect::Spawn(Box::new(self.order.clone())));
    }

    /// Takes the controller's word that an activation is over. A stop that has gone as far as a signal ends with the
    /// program, not with its last words.
    fn ended(&mut self, activation: u32, ending: Ending, moment: &mut Moment<'_>) {
        let current = match self.stage {
            Stage::Running { activation } | Stage::Stopping { activation, forced: false, .. } => Some(activation),
            Stage::Stopping { forced: true, .. }
            | Stage::Starting { .. }
            | Stage::Prepared
            | Stage::Connecting { .. }
            | Stage::Idle
            | Stage::Refused
            | Stage::Leaving { .. }
            | Stage::Dead => None,
        };
        if current == Some(activation) {
            self.stage = Stage::Idle;
            moment.notes.push(Note::Ended(activation, ending));
        }
    }

    fn end(&self, activation: u32, cause: FailureCause, moment: &mut Moment<'_>) {
        let failure = self.failure(cause, moment);
        moment.notes.push(Note::Ended(activation, Ending::Aborted(failure)));
    }

    fn failure(&self, cause: FailureCause, moment: &Moment<'_>) -> Failure {
        Failure { origin: self.order.path.clone(), cause, at: moment.since_go }
    }

    fn refuse(&mut self, why: &str, moment: &mut Moment<'_>) {
        if self.stage != Stage::Dead {
            self.stage = Stage::Refused;
        }
        moment.notes.push(Note::Refused(format!("`{}` cannot take part: {why}", self.order.path)));
    }

    fn force_out(&mut self, moment: &mut Moment<'_>) {
        let (until, activation) = (moment.now + GRACE + KILL_WITHIN, self.activation());
        self.stage = Stage::Leaving { until, forced: true, activation };
        self.tell_shim(ShimOrder::Stop { grace: GRACE }, moment);
    }

    fn is_controller(&self) -> bool {
        self.order.kind == LeafKind::Controller
    }

    fn tell(&self, order: Order, moment: &mut Moment<'_>) {
        moment.effects.push(Effect::Control { process: self.order.process.clone(), order });
    }

    fn tell_shim(&self, order: ShimOrder, moment: &mut Moment<'_>) {
        moment.effects.push(Effect::Shim { process: self.order.process.clone(), order });
    }
}
