//! The control loop: the one thread that calls the controller, on absolute deadlines or when a trigger sample arrives.

mod deadlines;
mod lines;
mod samples;
mod tally;
#[cfg(test)]
mod tests;

use super::database::{Answered, DatabaseLine};
use super::early::Early;
use super::ending::Ending;
use super::heartbeat::{Heartbeat, Spends};
use super::inbox::{Arrived, Command, Inbox, Item, TakenSwitch, ToServe};
use super::links::Links;
use super::node_line::NoticeLog;
use super::wire::fetch_all;
use crate::sdk::arguments::Arguments;
use crate::sdk::controller::{Progress, Stopping};
use crate::sdk::export::Activity;
use crate::sdk::module::{Delivery, DeliveryError, Module, Waker, guarded};
use comms::io::clock::{make_punctual, now};
use comms::logic::control::Notice;
use comms::logic::signals::{Peaks, Signals};
use comms::logic::switch::HOLD_WITHIN;
use comms::logic::time::Time;
use deadlines::Deadlines;
use lines::Lines;
use samples::Samples;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use tally::Tally;

/// The exit code of a program whose loop has panicked, as for any other panic in Rust.
const PANICKED: i32 = 101;
/// How often the losses of wires are reported to the node.
const LOSSES_EVERY: Duration = Duration::from_millis(500);
/// How many calls of others are carried out before the loop checks whether a calculation is due.
const CALLS_AT_ONCE: usize = 16;

#[derive(Debug)]
enum Phase {
    Idle,
    Running,
    /// `is_last` means that `stop` is called once more and not again, since the controller has panicked.
    Stopping {
        ending: Ending,
        until: Time,
        is_last: bool,
    },
}

/// The loop and its state.
pub(super) struct Cycle {
    module: Box<dyn Module>,
    lines: Lines,
    deadlines: Deadlines,
    samples: Samples,
    stop_within: Duration,
    phase: Phase,
    activation: u32,
    tally: Tally,
    /// The values that have come while nothing ran.
    early: Early,
    /// Switches of inputs that are done after the next calculation.
    switches: Vec<TakenSwitch>,
    /// When the node is told the losses of wires next.
    losses_due: Time,
    leaving: bool,
}

impl Cycle {
    pub(super) fn new(mut module: Box<dyn Module>, inbox: Arc<Inbox>, links: Arc<Links>, notices: NoticeLog) -> Self {
        let woken = Arc::clone(&inbox);
        module.take_waker(Waker::new(move || woken.call_loop()));
        let about = module.interface().about.clone();
        Self {
            module,
            lines: Lines::new(inbox, links, notices),
            deadlines: Deadlines::new(about.schedule),
            samples: Samples::new(about.signals_every),
            stop_within: about.stop_within,
            phase: Phase::Idle,
            activation: 0,
            tally: Tally::default(),
            early: Early::default(),
            switches: Vec::new(),
            losses_due: Time::ZERO,
            leaving: false,
        }
    }

    /// Returns the heartbeat on which the loop records its activity.
    pub(super) fn heartbeat(&self) -> Arc<Heartbeat> {
        Arc::clone(&self.lines.heartbeat)
    }

    /// Returns the connection of the loop to the database.
    pub(super) fn database(&self) -> Arc<DatabaseLine> {
        Arc::clone(&self.lines.database)
    }

    /// Runs until it is told to leave and no activation runs any more. If the loop itself panics, the whole process
    /// ends: a program without its loop would look alive to the node.
    pub(super) fn run(self) {
        if catch_unwind(AssertUnwindSafe(|| self.obey())).is_err() {
            // The panic has been reported on standard error.
            std::process::exit(PANICKED);
        }
    }

    fn obey(mut self) {
        make_punctual();
        self.lines.heartbeat.enter(Spends::Working);
        loop {
            while let Some(command) = self.lines.inbox.next_command() {
                self.command(command);
            }
            self.serve();
            self.lines.links.repeat_owed();
            self.lines.notices.tell(self.lines.inbox.take_refused());
            let triggered = self.take_samples();
            self.hand_messages();
            if matches!(self.phase, Phase::Idle) {
                if self.leaving {
                    self.lines.heartbeat.enter(Spends::Waiting);
                    // The module ends first: after SIGTERM the process ends as soon as the inbox is left.
                    drop(self.module);
                    return self.lines.inbox.leave();
                }
                self.wait_idle();
                continue;
            }
            let time = now();
            if time < self.deadlines.due() && !triggered {
                let given_up = self.lines.inbox.deadline();
                let due = self.deadlines.due();
                self.lines.wait(Some(given_up.map_or(due, |at| at.min(due))));
                continue;
            }
            self.arm(time);
            self.work(time);
        }
    }

    /// Waits while nothing runs. A consumer that is connected again takes over the count of undelivered values.
    fn wait_idle(&mut self) {
        let losses = self.lines.inbox.has_told_undelivered().then(|| {
            self.tell_losses(now());
            self.losses_due
        });
        self.lines.wait([self.lines.inbox.deadline(), losses].into_iter().flatten().min());
    }

    /// Carries out calls of others, but only as many at once that the next calculation is not delayed.
    fn serve(&mut self) {
        for _ in 0..CALLS_AT_ONCE {
            let activity = match self.phase {
                Phase::Idle => Activity::Idle,
                Phase::Running => Activity::Running,
                Phase::Stopping { .. } => Activity::Stopping,
            };
            let exports = &self.module.interface().exports;
            let is_procedure = |name: &str| exports.iter().any(|one| one.name == name && !one.is_answered_idle);
            let needs_run = |name: &str| activity == Activity::Idle && is_procedure(name);
            let Some(ToServe { name, argument, reply }) = self.lines.inbox.next_call(needs_run) else { return };
            self.call(|module| module.serve(&name, &argument, activity, reply));
        }
        self.lines.inbox.wake();
    }

    /// Hands the node messages for the activity whose ports the program has. Other programs have no such messages, and
    /// calculate often.
    fn hand_messages(&mut self) {
        if !self.module.hears_idle() {
            return;
        }
        let mut messages = Vec::new();
        self.call(|module| module.drain_messages(now(), &mut |message| messages.push(message)));
        messages.into_iter().for_each(|message| self.lines.tell(&Notice::Message(message)));
    }

    fn command(&mut self, command: Command) {
        match command {
            Command::Activate { activation, value, since } if matches!(self.phase, Phase::Idle) && !self.leaving => {
                self.activate(activation, &value, since);
            }
            Command::Activate { activation, .. } => {
                self.lines.tell(&Notice::Aborted { activation, reason: "it is still running".to_owned() });
            }
            Command::Stop { activation } if activation == self.activation => self.end(Ending::Stopped),
            Command::Stop { .. } => {}
            Command::Configure(arguments) => self.configure(arguments),
            Command::Connect(ports) => drop(self.call(|module| module.connect_keys(ports))),
            Command::Received { number, fate } => drop(self.call(|module| module.received(number, fate))),
            Command::Leave => {
                self.leaving = true;
                self.end(Ending::Stopped);
            }
        }
    }

    /// New parameters never end the activation: the controller continues without the parameters that it refuses.
    fn configure(&mut self, arguments: Arguments) {
        let running = !matches!(self.phase, Phase::Idle);
        match self.call(|module| module.configure(arguments, running)) {
            Some(Err(why)) => tracing::warn!(why, "parameters of the database are ignored"),
            Some(Ok(when)) => tracing::debug!(?when, "there are new parameters"),
            None => {}
        }
    }

    /// Begins an activation that was decided at `since`.
    fn activate(&mut self, activation: u32, value: &[u8], since: Time) {
        self.activation = activation;
        self.take_samples();
        let (time, connected) = (now(), self.lines.links.callers().connected());
        self.deadlines.restart(time);
        self.samples.restart(time);
        self.tally = Tally::default();
        self.phase = Phase::Running;
        for sample in self.early.begin(since) {
            self.deliver(&sample);
        }
        self.lines.heartbeat.enter(Spends::Initialising);
        let initialised = self.call(|module| module.init_with(&connected, value, time));
        self.lines.heartbeat.enter(Spends::Working);
        match initialised {
            Some(Ok(())) => {
                self.send();
                self.lines.tell(&Notice::Running { activation });
            }
            Some(Err(reason)) => self.end(Ending::Aborted(reason)),
            None => {}
        }
    }

    /// Calls the controller. A panic in its code ends the activation. A panic during a stop ends the stop, with a last
    /// call, and makes the end an abort.
    fn call<T>(&mut self, call: impl FnOnce(&mut dyn Module) -> T) -> Option<T> {
        let reason = match guarded(|| call(self.module.as_mut())) {
            Ok(result) => return Some(result),
            Err(reason) => reason,
        };
        if let Phase::Stopping { ending, is_last, .. } = &mut self.phase {
            ending.fail(format!("its stop failed: {reason}"));
            *is_last = true;
            self.deadlines.restart(now());
            return None;
        }
        self.end(Ending::Aborted(reason));
        None
    }

    /// Begins to stop; a second reason to end changes nothing. The node limits the time of the stop, so it is told of a
    /// stop that it has not ordered.
    fn end(&mut self, ending: Ending) {
        if !matches!(self.phase, Phase::Running) {
            return;
        }
        match ending {
            Ending::Done(_) | Ending::Aborted(_) => self.lines.tell(&Notice::Stopping { activation: self.activation }),
            Ending::Stopped => {}
        }
        let time = now();
        self.deadlines.restart(time);
        self.phase = Phase::Stopping { ending, until: time + self.stop_within, is_last: false };
    }

    /// Hands over the items that have arrived; returns whether a calculation is due at once. An idle controller gets no
    /// samples. Its next activation gets the samples that [`Early`] keeps for it.
    fn take_samples(&mut self) -> bool {
        let mut triggered = self.lines.inbox.take_call();
        let hears = !matches!(self.phase, Phase::Idle) || self.module.hears_idle();
        for item in self.lines.inbox.take_items() {
            match item {
                Item::Sample(sample) if hears => triggered |= self.deliver(&sample),
                Item::Sample(sample) => self.early.keep(sample),
                Item::Lost(port, count) if hears => {
                    self.tally.lost += count;
                    self.call(|module| module.lose(port, count));
                }
                Item::Lost(..) => {}
                Item::Taken(switch) => {
                    if triggered && matches!(self.phase, Phase::Running) {
                        // Values from before the switch are calculated before any later values.
                        let time = now();
                        self.arm(time);
                        self.work(time);
                        triggered = false;
                    }
                    self.take_switch(switch);
                }
            }
        }
        for ((activation, call, number), result) in self.lines.inbox.take_answers() {
            // An answer to an earlier activation is dropped.
            if !matches!(self.phase, Phase::Idle) && activation == self.activation {
                let delivery = self.call(|module| module.answered(call, number, result));
                triggered |= delivery == Some(Delivery::Triggers);
            }
        }
        for Answered { activation, number, answer } in self.lines.inbox.take_database() {
            if !matches!(self.phase, Phase::Idle) && activation == self.activation {
                let delivery = self.call(|module| module.database_answered(number, answer));
                triggered |= delivery == Some(Delivery::Triggers);
            }
        }
        triggered && matches!(self.phase, Phase::Running)
    }

    /// Carries out a switch of inputs: at once, or after the next calculation if outputs depend on the values before
    /// the switch.
    fn take_switch(&mut self, switch: TakenSwitch) {
        // If a switch only opens wires, later values need it at once. Consumers hold back later values only for a
        // limited time.
        let closes = switch.then.as_ref().is_some_and(|flip| !flip.close.is_empty());
        let is_soon = self.deadlines.is_soon(now(), HOLD_WITHIN / 2);
        let waits = closes && is_soon && matches!(self.phase, Phase::Running);
        if waits { self.switches.push(switch) } else { self.lines.flip(&switch) }
    }

    fn finish_switches(&mut self) {
        std::mem::take(&mut self.switches).iter().for_each(|switch| self.lines.flip(switch));
    }

    fn deliver(&mut self, sample: &Arrived) -> bool {
        match self.call(|module| sample.deliver(module)) {
            Some(Ok(delivery)) => delivery == Delivery::Triggers,
            None => false,
            Some(Err(error)) => {
                self.not_taken(error);
                false
            }
        }
    }

    /// Counts a value that its input has refused.
    fn not_taken(&mut self, error: DeliveryError) {
        if let DeliveryError::NotFinite { port } = error {
            self.tally.refused += 1;
            return self.lines.inbox.refuse_value(port);
        }
        tracing::warn!(%error, "cannot take a sample");
    }

    /// Sets the next deadline, and counts missed deadlines.
    fn arm(&mut self, time: Time) {
        self.tally.overruns += self.deadlines.arm(time);
    }

    fn work(&mut self, time: Time) {
        match &self.phase {
            Phase::Idle => {}
            Phase::Running => self.calculate(time),
            Phase::Stopping { .. } => {
                let stopping = self.call(|module| module.stop(time));
                self.send();
                self.stopped(stopping);
            }
        }
    }

    /// Takes the result of a call of `stop`; none if the call has panicked. A stop that takes too long is ended by the
    /// node, which kills the program. Only a program that is to leave ends such a stop itself.
    fn stopped(&mut self, stopping: Option<Stopping>) {
        let Phase::Stopping { ending, until, is_last } = &mut self.phase else { return };
        match stopping {
            Some(Stopping::Again) if *is_last => {}
            Some(Stopping::Again) if self.leaving && now() >= *until => {
                if let Ending::Aborted(reason) = ending {
                    tracing::warn!(reason, "the stop after an abort did not finish in time");
                }
                // The node ends the activation itself, because the stop was late.
                *ending = Ending::Stopped;
            }
            Some(Stopping::Again) => return,
            Some(Stopping::Failed(why)) => ending.fail(format!("its stop failed: {why}")),
            Some(Stopping::Finished) | None => {}
        }
        self.ended();
    }

    fn calculate(&mut self, time: Time) {
        self.lines.heartbeat.enter(Spends::Waiting);
        let fetched = fetch_all(&self.lines.links.fetches(), self.deadlines.period() / 2);
        self.lines.heartbeat.enter(Spends::Working);
        for (port, bytes) in fetched {
            match self.call(|module| module.deliver(port, &bytes, now())) {
                Some(Ok(_)) => {}
                Some(Err(error)) => self.not_taken(error),
                None => return,
            }
        }
        let Some(progress) = self.call(|module| module.calculate(time)) else { return };
        self.send();
        self.finish_switches();
        self.tell_losses(time);
        self.show(time);
        match progress {
            Progress::Continue => {}
            Progress::Done(value) => self.end(Ending::Done(value)),
            Progress::Aborted(reason) => self.end(Ending::Aborted(reason)),
        }
    }

    /// Reports the losses of wires to the node regularly. If the node is lost, the next node gets them.
    fn tell_losses(&mut self, time: Time) {
        if time >= self.losses_due {
            self.losses_due = time + LOSSES_EVERY;
            self.lines.notices.tell(self.lines.inbox.take_losses(self.lines.links.undelivered()));
        }
    }

    /// Returns the present counts.
    fn counts(&self) -> Tally {
        let undelivered = self.lines.links.undelivered().iter().map(|(_, count)| count).sum();
        Tally { undelivered, ..self.tally.with_losses(self.lines.inbox.waiting_losses()) }
    }

    fn ended(&mut self) {
        let Phase::Stopping { ending, .. } = std::mem::replace(&mut self.phase, Phase::Idle) else { return };
        let unconfirmed = self.call(|module| module.unconfirmed()).flatten();
        self.finish_switches();
        self.lines.links.callers().cancel_all();
        self.lines.database.cancel_all();
        // The last values are sent, and the peaks since the last sample.
        self.losses_due = Time::ZERO;
        self.samples.finish();
        self.tell_losses(now());
        self.show(now());
        let activation = self.activation;
        self.counts().log();
        self.lines.tell(&ending.notice(activation, unconfirmed));
    }

    fn send(&mut self) {
        let (activation, links) = (self.activation, Arc::clone(&self.lines.links));
        let (inbox, database) = (Arc::clone(&self.lines.inbox), Arc::clone(&self.lines.database));
        self.call(|module| module.drain_to(&mut &*links));
        let order = &mut |call, order| links.callers().order(activation, call, order, &inbox);
        self.call(|module| module.drain_calls(order));
        self.call(|module| module.drain_database(&mut |order| database.order(activation, order, &inbox)));
    }

    fn show(&mut self, time: Time) {
        if !self.samples.has_own() {
            return self.show_counts(time);
        }
        let Some(mut values) = self.call(|module| module.signals()) else { return };
        let Some(missed) = self.samples.look(&values, time) else { return };
        values.extend(self.counts().signals());
        self.lines.links.show(&Signals { stamp: time, values });
        if !missed.is_empty() {
            self.lines.links.show(&Peaks { stamp: time, values: missed });
        }
    }

    /// Shows the counts of a controller without signals.
    fn show_counts(&mut self, time: Time) {
        if self.samples.is_due(time) {
            let counts = self.counts();
            if self.samples.count(counts, time) {
                self.lines.links.show(&Signals { stamp: time, values: counts.signals().into() });
            }
        }
    }
}
