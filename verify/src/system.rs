//! A system: some parts together with all their possible events, for an explorer.
//!
//! Each part in a system is run by `language::algebra::step`, the same function that runs it on the robot. One automaton for
//! each member represents the surroundings. A running program may be done, with each of its tags, or abort. A program that is
//! stopping stops at some time. An armed timer may elapse. Supervisors of different groups react independently: an order to
//! stop reaches a member group some time after it was given. Between hosts, an order to start and the report of an end take
//! time as well.

mod labels;
mod loss;
mod messages;
mod mode;
mod order;
mod reaction;
mod restart;
mod transit;
mod zone;

use crate::model::{Ends, Model, Seat};
use language::algebra::{Event, Packing, Program, Steps, Value, Words};
use language::automaton::Configuration;
use language::automaton::Failure;
use language::script::ScriptErrorKind;
use language::sites::ProcessRef;
use loss::Rift;
pub(crate) use loss::{Loss, LossKind, is_torn};
pub use mode::FaultKind;
pub(crate) use mode::{Injection, Mode};
pub(crate) use order::has_order;
pub(crate) use reaction::Stepper;
use restart::Restarts;
pub(crate) use restart::{crashes, escalates, is_never_done, is_restarted, taken_along};
use std::collections::BTreeSet;
use transit::Transit;
use zone::Clocks;

/// An event of a system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Label {
    /// The whole is started.
    Start,
    /// The whole is started with the value of this number.
    StartWith(u8),
    /// The whole is asked to stop.
    Stop,
    /// A member of a unit is done, with the value of this number.
    Done(u16, u16, u8),
    /// A member of a unit has failed, with the report of this number.
    Aborted(u16, u16, u8),
    Stopped(u16, u16),
    /// A timer of a unit has elapsed.
    Elapsed(u16, u16),
    /// The next script of an activity fails.
    Script(u16, ScriptErrorKind),
    /// An activity gets a message. The number selects one of the messages that it distinguishes.
    Told(u16, u16),
    /// The order to stop reaches a unit.
    Reached(u16),
    /// The order to start a member of a unit reaches its host.
    Arrived(u16, u16),
    /// A unit receives the report that a member has ended.
    Heard(u16, u16),
    /// The fault.
    Fault(u16, u16),
    /// The second fault.
    Second(u16, u16),
    /// The host is lost.
    Lost,
    /// The node of a host notices the loss. The number is an index into `Plan::hosts`.
    Noted(u16),
    /// The program of a member has died, and is restarted.
    Died(u16, u16),
    /// The restarted program of a member runs again.
    Back(u16, u16),
    /// The programs of a unit have died more often than its group tolerates.
    TooMany(u16),
}

/// The state of the whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    Idle,
    Running,
    Stopping,
    Done,
    Aborted,
    Stopped,
}

impl Phase {
    const ALL: [Self; 6] = [Self::Idle, Self::Running, Self::Stopping, Self::Done, Self::Aborted, Self::Stopped];

    pub(crate) fn is_over(self) -> bool {
        match self {
            Self::Done | Self::Aborted | Self::Stopped => true,
            Self::Idle | Self::Running | Self::Stopping => false,
        }
    }
}

/// A member of a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct MemberRef {
    pub(crate) unit: usize,
    /// The member's slot in the unit.
    pub(crate) member: u32,
}

/// A part in a system.
#[derive(Debug)]
pub(crate) struct Unit {
    pub(crate) part: usize,
    /// The unit around this one, and this one's member slot there.
    pub(crate) parent: Option<MemberRef>,
    /// For each member: its unit, if that is part of the system; otherwise its possible ends with and without failures.
    pub(crate) seats: Vec<Occupant>,
    packing: Packing,
    /// Where the unit's state begins in a packed configuration.
    start: usize,
    /// The messages that the unit distinguishes, if it is an activity.
    messages: Vec<Event>,
}

/// The occupant of a member slot of a unit.
#[derive(Clone, Debug)]
pub(crate) enum Occupant {
    Unit(usize),
    /// A program, or a part as a black box, with its possible ends.
    Box([Ends; 2]),
}

/// A change that is visible to readers and observers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Change {
    pub(crate) unit: usize,
    /// The member; none for the whole system.
    pub(crate) member: Option<u32>,
    pub(crate) what: Changed,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Changed {
    Started,
    /// The order to start the member is in transit to its host.
    Sent,
    Stopping,
    Done(Value),
    /// The member has failed, with this report.
    Aborted(Value),
    Stopped,
    /// The member's program has died, and is restarted.
    Away,
}

/// A configuration of a system, unpacked.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub(crate) states: Vec<Words>,
    /// For each unit, whether an order to stop it is in transit.
    pub(crate) ordered: Vec<bool>,
    pub(crate) phase: Phase,
    /// Whether the fault has happened.
    pub(crate) is_faulty: bool,
    /// Whether the second fault has happened.
    pub(crate) is_twice_faulty: bool,
    /// The effects of a loss on hosts and members: see `loss`.
    pub(crate) rift: Vec<u8>,
    /// The effects of deaths on members and units: see `restart`.
    pub(crate) restarts: Vec<u8>,
    /// The messages in transit between hosts: see `transit`.
    pub(crate) transit: Vec<u8>,
    /// The due times of the timers of each activity: see `zone`.
    pub(crate) zones: Vec<u64>,
    /// The notes of observers.
    pub(crate) notes: Vec<u8>,
}

impl Frame {
    /// Copies everything except the states from another configuration.
    fn take_rest_of(&mut self, other: &Self) {
        self.ordered.clone_from(&other.ordered);
        self.rift.clone_from(&other.rift);
        self.restarts.clone_from(&other.restarts);
        self.transit.clone_from(&other.transit);
        self.zones.clone_from(&other.zones);
        self.notes.clone_from(&other.notes);
        (self.phase, self.is_faulty, self.is_twice_faulty) = (other.phase, other.is_faulty, other.is_twice_faulty);
    }
}

/// Parts together.
#[derive(Debug)]
pub(crate) struct System<'a> {
    pub(crate) model: &'a Model<'a>,
    pub(crate) units: Vec<Unit>,
    pub(crate) mode: Mode,
    /// How many bytes observers need.
    pub(crate) notes: usize,
    values: &'a [Value],
    /// The two sides of a loss, if `mode` contains one.
    rift: Option<Rift>,
    restarts: Restarts,
    transit: Transit,
    /// The members that may fail while an order to stop is on its way to them.
    failing: Vec<MemberRef>,
    clocks: Clocks,
    /// Whether the possible ends of everything in it are known.
    is_whole: bool,
}

impl<'a> System<'a> {
    /// Makes a system from a part and those parts below it for which `is_open` is true; the others
    /// become black boxes. Pieces of an open group are open if a part inside them is open.
    pub(crate) fn new(model: &'a Model<'a>, root: usize, is_open: &dyn Fn(usize) -> bool) -> Self {
        let mut system = Self {
            model,
            units: Vec::new(),
            mode: Mode::default(),
            notes: 0,
            values: &model.values.all,
            rift: None,
            restarts: Restarts::default(),
            transit: Transit::default(),
            failing: Vec::new(),
            clocks: Clocks::default(),
            is_whole: true,
        };
        system.add(root, None, is_open);
        system.follow_messages(&[]);
        system
    }

    /// Allows the timers of an expression to elapse in any order.
    pub(crate) fn forget_order(&mut self) {
        self.clocks.forget_order();
    }

    /// Returns whether every black box in the system has been explored completely.
    pub(crate) fn is_whole(&self) -> bool {
        self.is_whole
    }

    /// Adds a part.
    fn add(&mut self, part: usize, parent: Option<MemberRef>, is_open: &dyn Fn(usize) -> bool) -> usize {
        let source = &self.model.parts[part];
        let packing = Packing::new(&source.program, self.values);
        let index = self.units.len();
        let start = self.units.last().map_or(0, |unit| unit.start + unit.packing.length());
        let messages = messages::of(&source.expression);
        self.clocks.add(&source.expression);
        self.units.push(Unit { part, parent, seats: Vec::new(), packing, start, messages });
        // A part has a slot for each member of its group, including the members that its pieces
        // run. Members of pieces are never active in the part itself.
        let runs: BTreeSet<u32> = crate::model::runs(&source.expression).into_iter().collect();
        let is_box = |model: &Model<'_>, inner: usize| {
            !is_open(inner) && !model.parts[inner].ends_at_once && !model.parts[inner].reads_start
        };
        let mut seats = Vec::with_capacity(source.members.len());
        for (slot, seat) in (0..).zip(&source.members) {
            seats.push(match *seat {
                Seat::Part(inner) if runs.contains(&slot) && !is_box(self.model, inner) => {
                    Occupant::Unit(self.add(inner, Some(MemberRef { unit: index, member: slot }), is_open))
                }
                Seat::Part(inner) => {
                    // A member that no expression runs has no behaviour.
                    self.is_whole &= self.model.parts[inner].is_whole || !runs.contains(&slot);
                    Occupant::Box(self.model.parts[inner].ends.clone())
                }
                Seat::Leaf(leaf) => Occupant::Box(self.leaf_ends(part, slot, leaf)),
            });
        }
        self.units[index].seats = seats;
        index
    }

    fn leaf_ends(&self, part: usize, slot: u32, leaf: u32) -> [Ends; 2] {
        let group = &self.model.plan.groups[self.model.parts[part].group as usize];
        let is_service = group.members.get(slot as usize).is_some_and(|member| member.service);
        let leaf_plan = &self.model.plan.leaves[leaf as usize];
        let tags = &leaf_plan.outcomes;
        let done = match is_service {
            true => Vec::new(),
            false if is_never_done(self.model, leaf) => Vec::new(),
            false if tags.is_empty() || self.values.is_empty() => vec![Value::EMPTY],
            false => tags.iter().filter_map(|tag| Value::tagged(tag, &[])).collect(),
        };
        let mut aborted = vec![Value::EMPTY];
        let ended = is_service.then_some(Failure::ServiceEnded);
        // If the supervisor's own host is lost, the supervisor is lost as well.
        let is_away = leaf_plan.host != group.host;
        for reason in [Failure::Crash].into_iter().chain(Some(Failure::HostLost).filter(|_| is_away)).chain(ended) {
            let report = self.value(self.report(&reason));
            if !aborted.contains(&report) {
                aborted.push(report);
            }
        }
        [Ends { done: done.clone(), aborted }, Ends { done, aborted: Vec::new() }]
    }

    pub(crate) fn program(&self, unit: usize) -> &'a Program {
        &self.model.parts[self.units[unit].part].program
    }

    /// Returns the unit and slot of a member of a group, if that group is in the system.
    pub(crate) fn find(&self, group: u32, slot: u32) -> Option<MemberRef> {
        let holds = |unit: &Unit| {
            let part = &self.model.parts[unit.part];
            part.group == group && crate::model::runs(&part.expression).contains(&slot)
        };
        self.units.iter().position(holds).map(|unit| MemberRef { unit, member: slot })
    }

    /// Returns whether a member is a group or a piece of a group.
    pub(crate) fn is_group(&self, MemberRef { unit, member }: MemberRef) -> bool {
        matches!(self.model.parts[self.units[unit].part].members.get(member as usize), Some(Seat::Part(_)))
    }

    /// Returns whether a member is a process, or inside this process.
    pub(crate) fn is_below(&self, member: MemberRef, who: ProcessRef) -> bool {
        let Some(slot) = who.member else { return true };
        let seat = self.find(who.group, slot);
        std::iter::successors(Some(member), |MemberRef { unit, .. }| self.units[*unit].parent)
            .any(|at| Some(at) == seat)
    }

    // ---- packing ----

    /// How many bytes a configuration takes.
    pub(crate) fn length(&self) -> usize {
        self.states_length()
            + self.units.len().div_ceil(8)
            + 1
            + self.rift_length()
            + self.restarts_length()
            + self.transit_length()
            + size_of::<u64>() * self.clocks.count()
            + self.notes
    }

    fn states_length(&self) -> usize {
        self.units.last().map_or(0, |unit| unit.start + unit.packing.length())
    }

    pub(crate) fn initial(&self) -> Frame {
        Frame {
            states: self.units.iter().map(|unit| unit.packing.idle()).collect(),
            ordered: vec![false; self.units.len()],
            phase: Phase::Idle,
            is_faulty: false,
            is_twice_faulty: false,
            rift: vec![0; self.rift_length()],
            restarts: vec![0; self.restarts_length()],
            transit: vec![0; self.transit_length()],
            zones: vec![0; self.clocks.count()],
            notes: vec![0; self.notes],
        }
    }

    pub(crate) fn pack(&self, frame: &Frame, bytes: &mut Vec<u8>) {
        bytes.clear();
        for (unit, state) in self.units.iter().zip(&frame.states) {
            unit.packing.pack(state, bytes);
        }
        bytes.resize(self.length(), 0);
        self.pack_rest(frame, &mut bytes[self.states_length()..]);
    }

    /// Updates a packed configuration to a frame that differs from it only in these items of these units.
    pub(crate) fn patch(&self, frame: &Frame, items: impl Iterator<Item = (usize, u32)>, bytes: &mut [u8]) {
        for (unit, item) in items {
            let Unit { packing, start, .. } = &self.units[unit];
            packing.patch(item, frame.states[unit].get(item), &mut bytes[*start..*start + packing.length()]);
        }
        self.pack_rest(frame, &mut bytes[self.states_length()..]);
    }

    /// Everything but the states.
    fn pack_rest(&self, frame: &Frame, bytes: &mut [u8]) {
        let (orders, rest) = bytes.split_at_mut(self.units.len().div_ceil(8));
        for (eight, byte) in frame.ordered.chunks(8).zip(orders) {
            *byte = eight.iter().rev().fold(0, |byte, ordered| byte << 1 | u8::from(*ordered));
        }
        rest[0] = frame.phase as u8 | u8::from(frame.is_twice_faulty) << 6 | u8::from(frame.is_faulty) << 7;
        let (rift, rest) = rest[1..].split_at_mut(frame.rift.len());
        let (restarts, rest) = rest.split_at_mut(frame.restarts.len());
        let (transit, rest) = rest.split_at_mut(frame.transit.len());
        let (zones, notes) = rest.split_at_mut(size_of::<u64>() * frame.zones.len());
        for (number, bytes) in frame.zones.iter().zip(zones.chunks_exact_mut(size_of::<u64>())) {
            bytes.copy_from_slice(&number.to_le_bytes());
        }
        rift.copy_from_slice(&frame.rift);
        restarts.copy_from_slice(&frame.restarts);
        transit.copy_from_slice(&frame.transit);
        notes.copy_from_slice(&frame.notes);
    }

    pub(crate) fn unpack(&self, bytes: &[u8], frame: &mut Frame) {
        let mut rest = bytes;
        for (index, unit) in self.units.iter().enumerate() {
            let (own, others) = rest.split_at(unit.packing.length());
            unit.packing.unpack(self.program(index), own, &mut frame.states[index]);
            rest = others;
        }
        for (index, ordered) in frame.ordered.iter_mut().enumerate() {
            *ordered = rest[index / 8] >> (index % 8) & 1 == 1;
        }
        rest = &rest[self.units.len().div_ceil(8)..];
        frame.phase = Phase::ALL[usize::from(rest[0] & 7).min(5)];
        frame.is_twice_faulty = rest[0] >> 6 & 1 == 1;
        frame.is_faulty = rest[0] >> 7 == 1;
        let (rift, rest) = rest[1..].split_at(frame.rift.len());
        let (restarts, rest) = rest.split_at(frame.restarts.len());
        let (transit, rest) = rest.split_at(frame.transit.len());
        let (zones, notes) = rest.split_at(size_of::<u64>() * frame.zones.len());
        for (number, bytes) in frame.zones.iter_mut().zip(zones.chunks_exact(size_of::<u64>())) {
            *number = bytes.try_into().map_or(0, u64::from_le_bytes);
        }
        frame.rift.copy_from_slice(rift);
        frame.restarts.copy_from_slice(restarts);
        frame.transit.copy_from_slice(transit);
        frame.notes.copy_from_slice(notes);
    }

    /// Returns the phase of the whole in a packed configuration.
    pub(crate) fn phase_of(&self, bytes: &[u8]) -> Phase {
        Phase::ALL[usize::from(bytes[self.states_length() + self.units.len().div_ceil(8)] & 7).min(5)]
    }

    /// If a value has a tag, only the tag is stored in a packed state, with the tags inside it at which a `match` may look.
    fn number(&self, value: &Value) -> u8 {
        // The first value with a tag has nothing behind the tag.
        value.place_in(self.values).and_then(|known| u8::try_from(known + 1).ok()).unwrap_or(0)
    }

    /// Returns the number of the report of a failure. All reasons that no expression distinguishes have the same number.
    pub(crate) fn report(&self, reason: &Failure) -> u8 {
        match self.number(&reason.report()) {
            0 if *reason != Failure::Reported => self.number(&Failure::other().report()),
            number => number,
        }
    }

    /// Returns the reason for the number of a report.
    fn reason(&self, number: u8) -> Failure {
        Failure::of_report(&self.value(number))
    }

    /// Returns the same reason for people, if an expression distinguishes it.
    pub(crate) fn reason_told(&self, number: u8) -> Option<Failure> {
        Some(self.reason(number)).filter(|reason| ![Failure::Reported, Failure::other()].contains(reason))
    }

    /// The tag of the value of a number.
    pub(crate) fn tag(&self, number: u8) -> Option<&str> {
        usize::from(number).checked_sub(1).and_then(|index| self.values.get(index)?.tag())
    }

    /// The value of a number.
    pub(crate) fn value(&self, number: u8) -> Value {
        usize::from(number).checked_sub(1).and_then(|index| self.values.get(index).cloned()).unwrap_or_default()
    }

    /// Returns the present configuration of a unit's activity; none if the unit is not an activity.
    pub(crate) fn place(&self, frame: &Frame, unit: usize) -> Option<Box<Configuration>> {
        self.units[unit].packing.chart(self.program(unit), &frame.states[unit])
    }

    /// Returns a stepper, which applies labels to the units.
    pub(crate) fn stepper(&self) -> Stepper<'_> {
        let steps = (0..self.units.len()).map(|unit| Steps::new(self.program(unit), &self.units[unit].packing));
        Stepper::new(self, steps.collect())
    }
}

pub(crate) fn small(index: usize) -> u16 {
    u16::try_from(index).unwrap_or(u16::MAX)
}
