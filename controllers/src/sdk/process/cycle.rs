//! The control loop: the one thread that calls the controller, on absolute deadlines or when a trigger sample arrives.

mod deadlines;
mod lines;
mod samples;
mod tally;

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
use crate::sdk::module::{Delivery, DeliveryError, Module, Waker};
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
    Stopping { ending: Ending, until: Time },
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
                self.lines.wait(self.lines.inbox.deadline());
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
    /// call.
    fn call<T>(&mut self, call: impl FnOnce(&mut dyn Module) -> T) -> Option<T> {
        let reason = match guarded(|| call(self.module.as_mut())) {
            Ok(result) => return Some(result),
            Err(reason) => reason,
        };
        if let Phase::Stopping { until, .. } = &mut self.phase {
            *until = now();
            self.deadlines.restart(*until);
        }
        self.end(Ending::Aborted(reason));
        None
    }

    /// Begins to stop; a second reason to end changes nothing.
    fn end(&mut self, ending: Ending) {
        if matches!(self.phase, Phase::Running) {
            let time = now();
            self.deadlines.restart(time);
            self.phase = Phase::Stopping { ending, until: time + self.stop_within };
        }
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
                let late = matches!(self.phase, Phase::Stopping { until, .. } if now() >= until);
                if late || stopping != Some(Stopping::Again) {
                    self.ended();
                }
            }
        }
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
            self.lines.notices.tell(self.lines.inbox.take_losses());
        }
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
        self.tally.log();
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
        if !self.samples.are_shown() {
            return;
        }
        let Some(mut values) = self.call(|module| module.signals()) else { return };
        let Some(missed) = self.samples.look(&values, time) else { return };
        values.extend(self.tally.signals(self.lines.inbox.waiting_losses()));
        self.lines.links.show(&Signals { stamp: time, values });
        if !missed.is_empty() {
            self.lines.links.show(&Peaks { stamp: time, values: missed });
        }
    }
}

/// Calls the controller. A panic in its code becomes a reason.
fn guarded<T>(call: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(call)).map_err(|panic| {
        let text = panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str));
        format!("the controller panicked: {}", text.unwrap_or("no message"))
    })
}

#[cfg(test)]
mod tests {
    use super::super::inbox::Hold;
    use super::*;
    use crate::sdk::controller::{About, Configured};
    use crate::sdk::interface::Interface;
    use comms::io::control;
    use comms::logic::codec;
    use comms::logic::frame::Decoder;
    use comms::logic::signals::Signal;
    use std::cell::Cell;
    use std::io::Read;
    use std::os::unix::net::{UnixListener, UnixStream};

    /// Panics once, in the call with this name.
    struct Fragile {
        interface: Interface,
        breaks_in: Cell<&'static str>,
    }

    impl Fragile {
        fn at(&self, call: &'static str) {
            if self.breaks_in.get() == call {
                self.breaks_in.set("");
                panic!("in {call}");
            }
        }
    }

    impl Module for Fragile {
        fn interface(&self) -> &Interface {
            &self.interface
        }
        fn deliver(&mut self, _: &str, _: &[u8], _: Time) -> Result<Delivery, DeliveryError> {
            self.at("deliver");
            Ok(Delivery::Stored)
        }
        fn init(&mut self, _: &[u8], _: Time) -> Result<(), String> {
            self.at("init");
            Ok(())
        }
        fn configure(&mut self, _: Arguments, _: bool) -> Result<Configured, String> {
            Ok(Configured::Now)
        }
        fn calculate(&mut self, _: Time) -> Progress {
            self.at("calculate");
            Progress::Continue
        }
        fn stop(&mut self, _: Time) -> Stopping {
            self.at("stop");
            Stopping::Finished
        }
        fn drain(&mut self, _: &mut dyn FnMut(&'static str, Vec<u8>)) {
            self.at("drain");
        }
        fn signals(&self) -> Vec<Signal> {
            self.at("signals");
            Vec::new()
        }
    }

    fn next(stream: &mut UnixStream, decoder: &mut Decoder) -> Notice {
        loop {
            if let Some(body) = decoder.next_frame().unwrap() {
                return codec::decode(&body).unwrap();
            }
            let mut bytes = [0; 256];
            let size = stream.read(&mut bytes).unwrap();
            assert_ne!(size, 0, "the loop is gone");
            decoder.push(&bytes[..size]);
        }
    }

    /// Runs a controller that panics in `call`, and then activates it once more.
    fn check(call: &'static str, expected: &[Notice]) {
        let path = std::env::temp_dir().join(format!("dca-cycle-{}-{call}", std::process::id()));
        let listener = UnixListener::bind(&path).unwrap();
        let (notices, _orders) = control::connect(&path, Duration::from_secs(30)).unwrap();
        let (mut stream, mut decoder) = (listener.accept().unwrap().0, Decoder::new(1 << 16));
        std::fs::remove_file(&path).unwrap();
        let period = Duration::from_millis(1);
        let about = About::service("Panics once.").every(period).signals_every(period);
        let interface = Interface {
            type_name: "Fragile",
            about,
            ports: Vec::new(),
            exports: Vec::new(),
            calls: Vec::new(),
            inner: Vec::new(),
        };
        let module = Box::new(Fragile { interface, breaks_in: Cell::new(call) });
        let inbox = Arc::new(Inbox::default());
        let cycle = Cycle::new(module, Arc::clone(&inbox), Arc::default(), NoticeLog::new(notices));
        let running = std::thread::spawn(move || cycle.run());
        let activate =
            |activation| assert!(inbox.command(Command::Activate { activation, value: Vec::new(), since: now() }));
        let stop = |activation| assert!(inbox.command(Command::Stop { activation }));

        activate(1);
        for notice in expected {
            assert_eq!(next(&mut stream, &mut decoder), *notice, "{call}");
            match call {
                "deliver" => inbox.sample("In", Vec::new(), Hold::default()),
                "stop" => stop(1),
                _ => {}
            }
        }
        activate(2);
        assert_eq!(next(&mut stream, &mut decoder), Notice::Running { activation: 2 }, "{call}");
        stop(2);
        assert_eq!(next(&mut stream, &mut decoder), Notice::Stopped { activation: 2 }, "{call}");
        inbox.command(Command::Leave);
        running.join().unwrap();
    }

    #[test]
    fn a_panic_anywhere_ends_the_activation_and_not_the_loop() {
        let running = Notice::Running { activation: 1 };
        let aborted =
            |call: &str| Notice::Aborted { activation: 1, reason: format!("the controller panicked: in {call}") };
        check("init", &[aborted("init")]);
        for call in ["deliver", "calculate", "drain", "signals"] {
            check(call, &[running.clone(), aborted(call)]);
        }
        check("stop", &[running, Notice::Stopped { activation: 1 }]);
    }
}
