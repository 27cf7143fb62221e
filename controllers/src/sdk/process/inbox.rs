//! The inbox of the control loop: commands in order, and samples that have arrived.

use super::database::Answered;
use super::objects::Call;
use crate::sdk::arguments::Arguments;
use crate::sdk::export::RawReply;
use crate::sdk::module::{Delivery, DeliveryError, Module};
use comms::io::clock::{Wakeup, now};
use comms::io::data::{DataSession, IncomingCall};
use comms::io::direct::{Inlets, Value};
use comms::logic::control::{KeyPort, MessageFate, Notice, Shape};
use comms::logic::object::{Admission, CallId, CallTable, Next, ObjectError};
use comms::logic::seal::{Refusal, Refusals};
use comms::logic::switch::{Arrival, Expect, Flip, Gaps, Intake, Passed, Sequence};
use comms::logic::time::Time;
use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError, Weak};

/// How many samples wait for one input. A further sample replaces the oldest sample of this input, so a busy input does
/// not affect others.
const SAMPLES_MAX: usize = 64;
/// How many commands wait; a controller that leaves so many is stuck.
const COMMANDS_MAX: usize = 64;

/// A command of the node to the control loop.
#[derive(Debug)]
pub(super) enum Command {
    /// Initialise and run.
    Activate { activation: u32, value: Vec<u8>, since: Time },
    /// Stop this activation.
    Stop { activation: u32 },
    /// Continue with these parameters.
    Configure(Arguments),
    /// Use these connections between ports and keys of the database.
    Connect(Vec<KeyPort>),
    /// The fate of a message for the activity whose ports the program has.
    Received { number: u64, fate: MessageFate },
    /// Stop any activation, then end.
    Leave,
}

/// A sample that has arrived.
#[derive(Debug)]
pub(super) struct Arrived {
    pub(super) port: &'static str,
    pub(super) value: Value,
    pub(super) at: Time,
    /// The number of its wire; none if a device has sent it.
    pub(super) wire: Option<u32>,
    pub(super) hold: Hold,
}

impl Arrived {
    /// Hands the sample to a module, directly from its place in memory.
    pub(super) fn deliver(&self, module: &mut dyn Module) -> Result<Delivery, DeliveryError> {
        match &self.value {
            Value::Own(bytes) => module.deliver(self.port, bytes, self.at),
            Value::Loaned(loan) => loan.read(|source| module.deliver_from(self.port, source, self.at)),
        }
    }
}

/// How the samples of a wire wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Hold {
    /// How many samples wait at most.
    pub(super) count_max: usize,
    /// Whether the last sample waits for the next activation without a limit.
    pub(super) is_latched: bool,
}

impl Default for Hold {
    fn default() -> Self {
        Self { count_max: SAMPLES_MAX, is_latched: false }
    }
}

impl Hold {
    pub(super) fn of(shape: &Shape) -> Self {
        let count_max = shape.queue.and_then(|count| usize::try_from(count).ok()).unwrap_or(SAMPLES_MAX).max(1);
        Self { count_max, is_latched: shape.latch }
    }
}

/// An item that waits for the loop, in order.
#[derive(Debug)]
pub(super) enum Item {
    Sample(Arrived),
    /// This many values were sent to this input, but will not arrive.
    Lost(&'static str, u64),
    /// A switch of inputs has arrived: all samples before this item arrived before the switch.
    Taken(TakenSwitch),
}

/// A switch of inputs that has arrived, for the node and for outputs.
#[derive(Debug)]
pub(super) struct TakenSwitch {
    /// The notice for the node.
    pub(super) notice: Notice,
    /// The outputs to flip with this switch.
    pub(super) then: Option<Flip>,
}

/// A sample for which it is not known yet whether it has to wait for others.
#[derive(Debug)]
struct Sample {
    port: &'static str,
    value: Value,
    wire: Option<u32>,
    hold: Hold,
}

#[derive(Debug, Default)]
struct Waiting {
    commands: VecDeque<Command>,
    items: VecDeque<Item>,
    /// The order of samples that switches of wires require.
    intake: Intake<Sample>,
    /// By wire, which numbers have arrived.
    gaps: BTreeMap<u32, Gaps>,
    losses: Losses,
    refusals: Refusals,
    /// By generation, the expected switches: the number of the order, and the outputs to flip.
    expected: BTreeMap<u64, (u64, Option<Flip>)>,
    /// The calls of other programs.
    calls: CallTable<(IncomingCall, Weak<DataSession>)>,
    /// The calls that the loop has taken and may still answer, each with whether the caller waits.
    wanted: BTreeMap<CallId, Weak<AtomicBool>>,
    /// The answers to calls of this program.
    answers: Vec<OwnAnswer>,
    /// Answers of the database.
    database: Vec<Answered>,
    left: bool,
}

/// The values that wires have lost and inputs have refused since the program began.
#[derive(Debug, Default)]
struct Losses {
    of_wires: BTreeMap<u32, u64>,
    /// By input, the number of refused values.
    refused: BTreeMap<&'static str, u64>,
    /// The values of wires of outputs that were not delivered, as last reported.
    undelivered: Vec<(u32, u64)>,
    /// Whether there are numbers that the node does not know yet.
    is_news: bool,
}

impl Losses {
    fn add(&mut self, wire: u32, count: u64) {
        if count > 0 {
            *self.of_wires.entry(wire).or_default() += count;
            self.is_news = true;
        }
    }
}

/// An answer to a call of this program.
pub(super) type OwnAnswer = (Call, Result<Vec<u8>, ObjectError>);

/// A call for the loop.
#[derive(Debug)]
pub(super) struct ToServe {
    pub(super) name: String,
    pub(super) argument: Vec<u8>,
    pub(super) reply: RawReply,
}

/// The inbox: the listener and zenoh's threads fill it, and the cycle empties it.
#[derive(Debug, Default)]
pub(super) struct Inbox {
    waiting: Mutex<Waiting>,
    has_left: Condvar,
    wakeup: Wakeup,
    /// The arrivals over direct paths, which the loop reads itself.
    inlets: OnceLock<Arc<Inlets>>,
    /// Whether the last wait has read the arrivals, and nothing has been taken since.
    has_read: AtomicBool,
    /// Whether the controller wants a calculation because of something that is not from a port.
    is_called: AtomicBool,
}

impl Inbox {
    /// Lets the loop read the arrivals over direct paths. Call this before the loop begins.
    pub(super) fn read_from(&self, inlets: &Arc<Inlets>) {
        self.inlets.get_or_init(|| Arc::clone(inlets));
    }

    /// Ends the present wait of the loop, or its next one.
    pub(super) fn wake(&self) {
        match self.inlets.get() {
            Some(inlets) => inlets.wake(),
            None => self.wakeup.wake(),
        }
    }

    /// Makes a calculation due at once.
    pub(super) fn call_loop(&self) {
        self.is_called.store(true, Ordering::Release);
        self.wake();
    }

    /// Returns whether a calculation was made due since the last call.
    pub(super) fn take_call(&self) -> bool {
        self.is_called.swap(false, Ordering::AcqRel)
    }

    /// Waits until there is an item, or until `until`; without a deadline for ever. Arrivals over direct paths are
    /// read.
    pub(super) fn wait(&self, until: Option<Time>) {
        match self.inlets.get() {
            Some(inlets) => self.has_read.store(inlets.wait(until), Ordering::Relaxed),
            None => drop(self.wakeup.wait(until)),
        }
    }

    /// Puts a command into the queue; returns whether there was room.
    pub(super) fn command(&self, command: Command) -> bool {
        let room = {
            let commands = &mut self.lock().commands;
            let room = commands.len() < COMMANDS_MAX || matches!(command, Command::Leave);
            if room {
                commands.push_back(command);
            }
            room
        };
        self.wake();
        room
    }

    /// Takes a sample that is not affected by switches.
    pub(super) fn sample(&self, port: &'static str, bytes: Vec<u8>, hold: Hold) {
        self.lock().push(Sample { port, value: bytes.into(), wire: None, hold });
        self.wake();
    }

    /// Takes an item that has arrived over a wire.
    pub(super) fn arrive(
        &self,
        wire: u32,
        sequence: Option<Sequence>,
        port: &'static str,
        hold: Hold,
        arrival: Arrival<Value>,
    ) {
        if let Some(sequence) = sequence {
            let (mut waiting, is_value) = (self.lock(), matches!(arrival, Arrival::Value(_)));
            let gaps = waiting.gaps.entry(wire).or_default();
            let lost = if is_value { gaps.value(sequence) } else { gaps.boundary(sequence) };
            let end = waiting.items.len();
            waiting.losses.add(wire, lost.into());
            waiting.lost(end, port, lost.into());
        }
        let arrival = match arrival {
            Arrival::Value(value) => Arrival::Value(Sample { port, value, wire: Some(wire), hold }),
            Arrival::Boundary(boundary) => Arrival::Boundary(boundary),
        };
        self.pass(|intake, out| intake.arrive(now(), wire, hold.count_max, arrival, out));
    }

    /// Expects a switch of inputs; `ticket` is the number of the order.
    pub(super) fn expect(&self, ticket: u64, expect: Expect, then: Option<Flip>) {
        self.lock().expected.insert(expect.generation, (ticket, then));
        self.pass(|intake, out| intake.expect(now(), expect, out));
    }

    /// Records that a wire is linked, before anything arrives over it.
    pub(super) fn link(&self, wire: u32) {
        self.lock().intake.link(wire);
    }

    /// Forgets wires that are no longer linked.
    pub(super) fn forget(&self, wires: impl IntoIterator<Item = u32>) {
        let wires: Vec<u32> = wires.into_iter().collect();
        let mut waiting = self.lock();
        waiting.gaps.retain(|wire, _| !wires.contains(wire));
        waiting.losses.of_wires.retain(|wire, _| !wires.contains(wire));
        drop(waiting);
        self.pass(|intake, out| wires.into_iter().for_each(|wire| intake.forget(wire, out)));
    }

    /// Returns when the wait for an expected item or of a call ends, or when refusals are to be reported.
    pub(super) fn deadline(&self) -> Option<Time> {
        let waiting = self.lock();
        [waiting.intake.deadline(), waiting.refusals.deadline(), waiting.calls.begins_by()].into_iter().flatten().min()
    }

    fn pass(&self, act: impl FnOnce(&mut Intake<Sample>, &mut Vec<Passed<Sample>>)) {
        let (mut waiting, mut out) = (self.lock(), Vec::new());
        act(&mut waiting.intake, &mut out);
        out.into_iter().for_each(|passed| waiting.passed(passed));
        drop(waiting);
        self.wake();
    }

    /// Takes a call of another program.
    pub(super) fn called(&self, incoming: IncomingCall, session: &Weak<DataSession>) {
        let (id, deadline) = (incoming.call.id.clone(), incoming.deadline);
        let admission = self.lock().calls.admit(id, deadline, now(), (incoming, Weak::clone(session)));
        match admission {
            Admission::Admitted => self.wake(),
            Admission::TurnedAway((incoming, _), error) => incoming.way.answer(Err(error)),
        }
    }

    /// Records that a call was cancelled.
    pub(super) fn cancelled(&self, id: &CallId) {
        let mut waiting = self.lock();
        drop(waiting.calls.cancel(id));
        if let Some(wanted) = waiting.wanted.remove(id).and_then(|wanted| wanted.upgrade()) {
            wanted.store(false, Ordering::Relaxed);
        }
    }

    /// Returns the next call whose caller still waits. `needs_run` says of its export whether only a running process answers it now.
    pub(super) fn next_call(&self, needs_run: impl Fn(&str) -> bool) -> Option<ToServe> {
        loop {
            let next = self.lock().calls.next(now(), |(incoming, _)| needs_run(&incoming.call.name));
            let (incoming, session) = match next? {
                Next::Run(call) => call,
                Next::Expired(_) => continue,
            };
            let IncomingCall { call, deadline, way, .. } = incoming;
            let is_there = move |caller: &str| session.upgrade().is_some_and(|session| session.is_linked(caller));
            if !is_there(&call.id.session) {
                continue;
            }
            let wanted = Arc::new(AtomicBool::new(true));
            let mut waiting = self.lock();
            waiting.wanted.retain(|_, wanted| wanted.strong_count() > 0);
            waiting.wanted.insert(call.id.clone(), Arc::downgrade(&wanted));
            drop(waiting);
            let caller = call.id.session;
            let is_wanted = move || wanted.load(Ordering::Relaxed) && now() < deadline && is_there(&caller);
            let reply = RawReply::new(move |result| way.answer(result), is_wanted);
            return Some(ToServe { name: call.name, argument: call.argument.0, reply });
        }
    }

    /// Takes an answer to a call of this program.
    pub(super) fn answered(&self, call: Call, result: Result<Vec<u8>, ObjectError>) {
        // There are only as many answers as calls were made, which are few.
        self.lock().answers.push((call, result));
        self.wake();
    }

    pub(super) fn take_answers(&self) -> Vec<OwnAnswer> {
        std::mem::take(&mut self.lock().answers)
    }

    /// Returns the losses of each wire and the refusals of each input since the program began, and the given undelivered
    /// values, if the node does not know them yet.
    pub(super) fn take_losses(&self, undelivered: Vec<(u32, u64)>) -> Option<Notice> {
        let losses = &mut self.lock().losses;
        losses.is_news |= losses.undelivered != undelivered;
        losses.undelivered = undelivered;
        std::mem::take(&mut losses.is_news).then(|| Notice::Losses {
            wires: losses.of_wires.iter().map(|(wire, count)| (*wire, *count)).collect(),
            refused: losses.refused.iter().map(|(input, count)| ((*input).to_owned(), *count)).collect(),
            undelivered: losses.undelivered.clone(),
        })
    }

    /// Returns whether the node was last told of undelivered values.
    pub(super) fn has_told_undelivered(&self) -> bool {
        !self.lock().losses.undelivered.is_empty()
    }

    /// Records that an input has refused a value, because a number in it is not finite.
    pub(super) fn refuse_value(&self, input: &'static str) {
        let losses = &mut self.lock().losses;
        *losses.refused.entry(input).or_default() += 1;
        losses.is_news = true;
    }

    /// Records that a message without the seal of the other end has arrived over a wire.
    pub(super) fn refuse(&self, wire: u32, why: Refusal, from: Option<String>) {
        self.lock().refusals.note(now(), wire, why, from);
        self.wake();
    }

    /// Records that the program at the other end of a wire has changed.
    pub(super) fn partner_changed(&self, wire: u32) {
        self.lock().refusals.changed(wire);
    }

    /// Returns the refusals that are to be reported to the node now.
    pub(super) fn take_refused(&self) -> Option<Notice> {
        let refusals = &mut self.lock().refusals;
        let wires = refusals.deadline().map_or(Vec::new(), |_| refusals.take(now()));
        (!wires.is_empty()).then_some(Notice::Refused { wires })
    }

    /// Marks all losses as not yet reported, so that another node gets them.
    pub(super) fn tell_losses_again(&self) {
        let losses = &mut self.lock().losses;
        losses.is_news = !losses.of_wires.is_empty() || !losses.refused.is_empty() || !losses.undelivered.is_empty();
    }

    /// Takes an answer of the database.
    pub(super) fn database(&self, answered: Answered) {
        // There are only as many answers as requests, and as a watch may have in transit.
        self.lock().database.push(answered);
        self.wake();
    }

    pub(super) fn take_database(&self) -> Vec<Answered> {
        std::mem::take(&mut self.lock().database)
    }

    pub(super) fn next_command(&self) -> Option<Command> {
        self.lock().commands.pop_front()
    }

    pub(super) fn take_items(&self) -> VecDeque<Item> {
        if let Some(inlets) = self.inlets.get()
            && !self.has_read.swap(false, Ordering::Relaxed)
        {
            // A late loop has not waited, so it reads the arrivals here.
            inlets.read();
        }
        let (mut waiting, now) = (self.lock(), now());
        if waiting.intake.deadline().is_some_and(|due| due <= now) {
            let mut out = Vec::new();
            waiting.intake.tick(now, &mut out);
            out.into_iter().for_each(|passed| waiting.passed(passed));
        }
        std::mem::take(&mut waiting.items)
    }

    /// Returns how many values were lost that [`Inbox::take_items`] will report.
    pub(super) fn waiting_losses(&self) -> u64 {
        let count = |item: &Item| if let Item::Lost(_, count) = item { *count } else { 0 };
        self.lock().items.iter().map(count).sum()
    }

    /// Records that the cycle has ended.
    pub(super) fn leave(&self) {
        self.lock().left = true;
        self.has_left.notify_all();
    }

    /// Waits until the cycle has ended; the limits of the cycle bound this wait.
    pub(super) fn wait_left(&self) {
        let waiting = self.has_left.wait_while(self.lock(), |waiting| !waiting.left);
        drop(waiting.unwrap_or_else(PoisonError::into_inner));
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Waiting {
    fn push(&mut self, Sample { port, value, wire, hold }: Sample) {
        let same = |item: &Item| matches!(item, Item::Sample(other) if other.port == port);
        if self.items.iter().filter(|item| same(item)).count() >= hold.count_max {
            let oldest = self.items.iter().position(same);
            if let Some((oldest, Item::Sample(given_up))) =
                oldest.and_then(|oldest| Some((oldest, self.items.remove(oldest)?)))
            {
                given_up.wire.into_iter().for_each(|wire| self.losses.add(wire, 1));
                self.lost(oldest, port, 1);
            }
        }
        self.items.push_back(Item::Sample(Arrived { port, value, at: now(), wire, hold }));
    }

    /// Records lost values of an input, before the item at the index `at`.
    fn lost(&mut self, at: usize, port: &'static str, count: u64) {
        let before = at.checked_sub(1).and_then(|before| self.items.get_mut(before));
        match before {
            _ if count == 0 => {}
            Some(Item::Lost(other, lost)) if *other == port => *lost += count,
            _ => self.items.insert(at, Item::Lost(port, count)),
        }
    }

    fn passed(&mut self, passed: Passed<Sample>) {
        match passed {
            Passed::Value(sample) => self.push(sample),
            Passed::Taken(taken) => {
                let Some((ticket, then)) = self.expected.remove(&taken.generation) else { return };
                let notice = Notice::Taken { ticket, lost: taken.lost, late: taken.late, missing: taken.missing };
                self.items.push_back(Item::Taken(TakenSwitch { notice, then }));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_gives_way_in_a_queue_of_its_own() {
        let inbox = Inbox::default();
        let short = Hold::of(&Shape { queue: Some(2), latch: true, ..Shape::default() });
        for number in 0..4 {
            inbox.sample("In", vec![number], short);
            inbox.sample("Other", vec![number], Hold::default());
        }
        let (mut taken, mut lost) = (Vec::new(), Vec::new());
        assert_eq!(inbox.waiting_losses(), 2);
        for item in inbox.take_items() {
            match item {
                Item::Sample(sample) => taken.push(sample),
                Item::Lost(port, count) => lost.push((port, count)),
                Item::Taken(_) => panic!("there is no switch"),
            }
        }
        assert_eq!(lost.iter().map(|(_, count)| count).sum::<u64>(), 2);
        assert!(lost.iter().all(|(port, _)| *port == "In"));
        let first = |sample: &Arrived| match &sample.value {
            Value::Own(bytes) => bytes[0],
            Value::Loaned(_) => panic!("it is nobody else's"),
        };
        let of = |port| taken.iter().filter(|sample| sample.port == port).map(first).collect::<Vec<_>>();
        assert_eq!((of("In"), of("Other")), (vec![2, 3], vec![0, 1, 2, 3]));
        assert!(taken.iter().all(|sample| sample.hold.is_latched == (sample.port == "In")));
        assert_eq!(Hold::of(&Shape::default()), Hold::default());
    }

    /// A link has lost the numbers 2 to 4; then one value is replaced in a full queue.
    #[test]
    fn what_a_link_has_lost_is_counted_before_what_comes_after_it() {
        let inbox = Inbox::default();
        let hold = Hold::of(&Shape { queue: Some(2), ..Shape::default() });
        inbox.link(3);
        for number in [1, 5, 6] {
            let sequence = Sequence { publisher: (1, 1), number };
            inbox.arrive(3, Some(sequence), "In", hold, Arrival::Value(vec![0].into()));
        }
        let items = inbox.take_items();
        let what = |item: &Item| match item {
            Item::Sample(_) => 0,
            Item::Lost("In", count) => *count,
            Item::Lost(..) | Item::Taken(_) => panic!("{item:?}"),
        };
        assert_eq!(items.iter().map(what).filter(|what| *what > 0).sum::<u64>(), 4);
        let told = |refused: &[(&str, u64)], undelivered: &[(u32, u64)]| {
            let refused = refused.iter().map(|(input, count)| ((*input).to_owned(), *count)).collect();
            Some(Notice::Losses { wires: vec![(3, 4)], refused, undelivered: undelivered.to_vec() })
        };
        let take = |undelivered: &[(u32, u64)]| inbox.take_losses(undelivered.to_vec());
        assert_eq!((take(&[]), take(&[])), (told(&[], &[]), None));
        inbox.tell_losses_again();
        assert_eq!(take(&[]), told(&[], &[]));
        inbox.refuse_value("In");
        inbox.refuse_value("In");
        assert_eq!((take(&[]), take(&[])), (told(&[("In", 2)], &[]), None));
        let cut = [(5, 7)];
        assert_eq!((take(&cut), take(&cut)), (told(&[("In", 2)], &cut), None));
        inbox.tell_losses_again();
        assert_eq!((take(&cut), take(&[]), take(&[])), (told(&[("In", 2)], &cut), told(&[("In", 2)], &[]), None));
        assert_eq!(items.iter().map(what).filter(|what| *what == 0).count(), 2);
    }
}
