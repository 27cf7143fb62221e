//! The control loop: the one thread that calls the controller, on absolute deadlines or when a trigger sample arrives.

use super::inbox::Inbox;
use super::links::Links;
use crate::sdk::controller::{Progress, Schedule, Stopping};
use crate::sdk::module::{Delivery, Module};
use comms::io::clock::{make_punctual, now};
use comms::io::control::NoticeSender;
use comms::logic::control::Notice;
use comms::logic::signals::{Signal, Signals};
use comms::logic::time::Time;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

/// What the cycle is told.
#[derive(Debug)]
pub(super) enum Command {
    /// Initialise and run.
    Activate { activation: u32, value: Vec<u8> },
    /// Stop this activation.
    Stop { activation: u32 },
    /// Stop whatever runs, then end.
    Leave,
}

/// How the present activation ends once `stop` has finished.
#[derive(Debug)]
enum Ending {
    Done(Vec<u8>),
    Aborted(String),
    Stopped,
}

#[derive(Debug)]
enum Phase {
    Idle,
    Running,
    Stopping { ending: Ending, until: Time },
}

/// The loop and all it knows.
pub(super) struct Cycle {
    module: Box<dyn Module>,
    inbox: Arc<Inbox>,
    links: Arc<Links>,
    notices: NoticeSender,
    schedule: Schedule,
    stop_within: Duration,
    signals_every: Option<Duration>,
    phase: Phase,
    activation: u32,
    due: Time,
    signals_due: Time,
    overruns: u64,
    leaving: bool,
}

impl Cycle {
    pub(super) fn new(module: Box<dyn Module>, inbox: Arc<Inbox>, links: Arc<Links>, notices: NoticeSender) -> Self {
        let about = module.interface().about.clone();
        Self {
            module,
            inbox,
            links,
            notices,
            schedule: about.schedule,
            stop_within: about.stop_within,
            signals_every: about.signals_every,
            phase: Phase::Idle,
            activation: 0,
            due: Time::ZERO,
            signals_due: Time::ZERO,
            overruns: 0,
            leaving: false,
        }
    }

    /// Runs until it is told to leave and nothing runs any more.
    pub(super) fn run(mut self) {
        make_punctual();
        loop {
            while let Some(command) = self.inbox.next_command() {
                self.command(command);
            }
            let triggered = self.take_samples();
            if matches!(self.phase, Phase::Idle) {
                if self.leaving {
                    return self.inbox.leave();
                }
                self.inbox.wakeup.wait(None);
                continue;
            }
            let time = now();
            if time < self.due && !triggered {
                self.inbox.wakeup.wait(Some(self.due));
                continue;
            }
            self.arm(time, triggered);
            self.work(time);
        }
    }

    fn command(&mut self, command: Command) {
        match command {
            Command::Activate { activation, value } if matches!(self.phase, Phase::Idle) && !self.leaving => {
                self.activate(activation, &value);
            }
            Command::Activate { activation, .. } => {
                self.tell(&Notice::Aborted { activation, reason: "it is still running".to_owned() });
            }
            Command::Stop { activation } if activation == self.activation => self.end(Ending::Stopped),
            Command::Stop { .. } => {}
            Command::Leave => {
                self.leaving = true;
                self.end(Ending::Stopped);
            }
        }
    }

    fn activate(&mut self, activation: u32, value: &[u8]) {
        self.activation = activation;
        drop(self.inbox.take_samples());
        let time = now();
        (self.due, self.signals_due, self.overruns) = (time, time, 0);
        self.phase = Phase::Running;
        match guarded(|| self.module.init(value, time)).and_then(|initialised| initialised) {
            Ok(()) => {
                self.send();
                self.tell(&Notice::Running { activation });
            }
            Err(reason) => self.end(Ending::Aborted(reason)),
        }
    }

    /// Begins to stop; a second reason to end changes nothing.
    fn end(&mut self, ending: Ending) {
        if matches!(self.phase, Phase::Running) {
            let time = now();
            self.phase = Phase::Stopping { ending, until: time + self.stop_within };
            self.due = time;
        }
    }

    /// Hands over what has arrived; says whether a calculation is due at once. An idle controller hears nothing.
    fn take_samples(&mut self) -> bool {
        let mut triggered = false;
        for sample in self.inbox.take_samples() {
            if matches!(self.phase, Phase::Idle) {
                continue;
            }
            match self.module.deliver(sample.port, &sample.bytes, sample.at) {
                Ok(Delivery::Triggers) => triggered = true,
                Ok(Delivery::Stored) => {}
                Err(error) => tracing::warn!(%error, "a sample was not taken"),
            }
        }
        triggered && matches!(self.phase, Phase::Running)
    }

    /// Sets the next deadline: on the grid of the period, or one period after a trigger. Missed deadlines are counted.
    fn arm(&mut self, time: Time, triggered: bool) {
        let period = self.schedule.period;
        if triggered || self.schedule.trigger.is_some() {
            self.due = time + period;
            return;
        }
        self.due = self.due + period;
        if self.due <= time {
            let missed = (time - self.due).as_nanos() / period.as_nanos().max(1) + 1;
            self.overruns += u64::try_from(missed).unwrap_or(u64::MAX);
            let skip = u32::try_from(missed).unwrap_or(u32::MAX);
            self.due = self.due + period * skip;
        }
    }

    fn work(&mut self, time: Time) {
        match &self.phase {
            Phase::Idle => {}
            Phase::Running => {
                for fetch in self.links.fetches() {
                    let delivered = fetch
                        .fetch(self.schedule.period / 2)
                        .map(|bytes| self.module.deliver(fetch.port, &bytes, now()));
                    if let Some(Err(error)) = delivered {
                        tracing::warn!(%error, "a fetched sample was not taken");
                    }
                }
                let progress = guarded(|| self.module.calculate(time)).unwrap_or_else(Progress::Aborted);
                self.send();
                self.show(time);
                match progress {
                    Progress::Continue => {}
                    Progress::Done(value) => self.end(Ending::Done(value)),
                    Progress::Aborted(reason) => self.end(Ending::Aborted(reason)),
                }
            }
            Phase::Stopping { until, .. } => {
                let late = time >= *until;
                let stopping = guarded(|| self.module.stop(time)).unwrap_or(Stopping::Finished);
                self.send();
                if stopping == Stopping::Finished || late {
                    self.ended();
                }
            }
        }
    }

    fn ended(&mut self) {
        let Phase::Stopping { ending, .. } = std::mem::replace(&mut self.phase, Phase::Idle) else { return };
        let activation = self.activation;
        if self.overruns > 0 {
            tracing::info!(overruns = self.overruns, "deadlines were missed");
        }
        self.tell(&match ending {
            Ending::Done(value) => Notice::Done { activation, value },
            Ending::Aborted(reason) => Notice::Aborted { activation, reason },
            Ending::Stopped => Notice::Stopped { activation },
        });
    }

    fn send(&mut self) {
        let links = &self.links;
        self.module.drain(&mut |port, bytes| links.send(port, bytes));
    }

    fn show(&mut self, time: Time) {
        let Some(every) = self.signals_every else { return };
        if time < self.signals_due {
            return;
        }
        self.signals_due = time + every;
        let mut values = self.module.signals();
        #[expect(clippy::cast_precision_loss, reason = "a count for people")]
        let value = self.overruns as f64;
        values.push(Signal { name: "overruns".to_owned(), unit: String::new(), value, headline: false });
        self.links.show(&Signals { stamp: time, values });
    }

    /// A node that is gone is noticed by the listener.
    fn tell(&self, notice: &Notice) {
        if let Err(error) = self.notices.send(notice) {
            tracing::debug!(%error, "the node was not told");
        }
    }
}

/// Calls the controller; a panic of its code becomes a reason.
fn guarded<T>(call: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(call)).map_err(|panic| {
        let text = panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str));
        format!("the controller panicked: {}", text.unwrap_or("no message"))
    })
}
