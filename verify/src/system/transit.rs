//! Messages in transit between hosts: orders to start and to stop, and reports of an end.
//!
//! A supervisor sends the order to start a member to the node of the member's host. Until that node takes the order, the
//! member does not run, although its supervisor treats it as active. A group that has ended reports this to the
//! supervisor around it, which treats the group as running until the report arrives. The end of a
//! program has effect from the moment at which its supervisor learns of it, because no other
//! process knows it before. Messages between two hosts keep their order. A message in transit on a
//! lost link may arrive until the receiving node has noticed the loss. The rules come from
//! `node/src/logic`: `link`, `executer`, `participant`.

use super::reaction::{failed, is_unconfirmed, unconfirmed};
use super::{Frame, Label, Occupant, System, Value, small};
use crate::model::Seat;
use crate::system::MemberRef;
use language::algebra::{Activity, Outcome};
use language::automaton::Failure;

/// An order to start is in transit.
const START: u8 = 1;
/// A report is in transit: how the group has ended.
const DONE: u8 = 2;
const ABORTED: u8 = 3;
const STOPPED: u8 = 4;
const UNCONFIRMED: u8 = 5;

/// The number of bytes for each member: the message to or from it, the value of the message, its position on the link,
/// and the position of an order to stop.
const BYTES: usize = 4;
/// The offsets of these bytes: the message, and the two positions. The first message on a link has position 1.
const WHAT: usize = 0;
const VALUE: usize = 1;
const MESSAGE: usize = 2;
const STOP: usize = 3;

/// The messages between hosts that a system keeps track of.
#[derive(Debug, Default)]
pub(super) struct Transit {
    /// The members whose messages are tracked.
    seats: Vec<MemberRef>,
    /// For each of these members, the host of its supervisor and its own host: indices into `Plan::hosts`.
    hosts: Vec<(u32, u32)>,
}

/// A message that has arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Arrival {
    /// The order to start, with a value.
    Start(Value),
    /// The report of an end.
    End(Outcome),
}

impl System<'_> {
    /// Makes messages between hosts take time: to and from every open group, and those black boxes that are in
    /// `members`.
    pub(crate) fn follow_messages(&mut self, members: &[MemberRef]) {
        let mut followed = Transit::default();
        for unit in 0..self.units.len() {
            let own = self.host_of(unit);
            let mut runs = crate::model::runs(&self.model.parts[self.units[unit].part].expression);
            runs.sort_unstable();
            runs.dedup();
            for member in runs {
                let is_open = matches!(self.units[unit].seats[member as usize], Occupant::Unit(_));
                let host = self.host_of_seat(MemberRef { unit, member });
                let is_known = self.transit.seats.contains(&MemberRef { unit, member });
                if host != own && (is_open || is_known || members.contains(&MemberRef { unit, member })) {
                    followed.seats.push(MemberRef { unit, member });
                    followed.hosts.push((own, host));
                }
            }
        }
        self.transit = followed;
    }

    /// Finds all orders to start that share a link with the order to a member. Makes these orders
    /// take time, so that a later message on the link arrives after them.
    pub(crate) fn follow_link(&mut self, member_ref: MemberRef) {
        let MemberRef { unit, .. } = member_ref;
        let link = (self.host_of(unit), self.host_of_seat(member_ref));
        let mut others = Vec::new();
        for unit in (0..self.units.len()).filter(|unit| self.host_of(*unit) == link.0 && link.0 != link.1) {
            let slots = (0_u32..).zip(&self.units[unit].seats).map(|(slot, _)| MemberRef { unit, member: slot });
            others.extend(slots.filter(|seat| self.host_of_seat(*seat) == link.1));
        }
        self.follow_messages(&others);
    }

    /// Lets black boxes among these members fail while an order to stop is on its way to them. On one host, an order reaches
    /// a program at once.
    pub(crate) fn follow_failures(&mut self, members: Vec<MemberRef>) {
        let is_far = |seat: &MemberRef| self.is_group(*seat) || self.host_of_seat(*seat) != self.host_of(seat.unit);
        self.failing = members.into_iter().filter(is_far).collect();
    }

    /// The host of the supervisor of a unit.
    pub(super) fn host_of(&self, unit: usize) -> u32 {
        self.model.plan.groups[self.model.parts[self.units[unit].part].group as usize].host
    }

    /// The host of a member.
    fn host_of_seat(&self, MemberRef { unit, member }: MemberRef) -> u32 {
        let plan = self.model.plan;
        match self.model.parts[self.units[unit].part].members[member as usize] {
            Seat::Leaf(leaf) => plan.leaves[leaf as usize].host,
            Seat::Part(inner) if self.model.parts[inner].is_piece => self.host_of(unit),
            Seat::Part(inner) => plan.groups[self.model.parts[inner].group as usize].host,
        }
    }

    pub(super) fn transit_length(&self) -> usize {
        BYTES * self.transit.seats.len()
    }

    /// Returns the place of the messages to and from a member; none if they are not tracked.
    fn transit_of(&self, seat: MemberRef) -> Option<usize> {
        self.transit.seats.iter().position(|other| *other == seat)
    }

    /// Returns whether the messages to and from a member are tracked.
    pub(super) fn is_followed(&self, seat: MemberRef) -> bool {
        self.transit_of(seat).is_some()
    }

    fn message(&self, frame: &Frame, seat: MemberRef) -> u8 {
        self.transit_of(seat).map_or(0, |place| frame.transit[BYTES * place + WHAT])
    }

    /// Returns whether a message is in transit to or from a member. The member does not run then,
    /// although its supervisor treats it as active.
    pub(crate) fn is_under_way(&self, frame: &Frame, seat: MemberRef) -> bool {
        self.message(frame, seat) != 0
    }

    /// Returns whether a member has ended, but its supervisor does not know this.
    pub(super) fn has_ended_unheard(&self, frame: &Frame, seat: MemberRef) -> bool {
        self.message(frame, seat) > START
    }

    /// Returns whether a member is a group whose messages are tracked.
    pub(super) fn is_distant_group(&self, seat: MemberRef) -> bool {
        self.is_group(seat) && self.is_followed(seat)
    }

    /// Returns whether a group counts as active for the supervisor around it but does not run, because a message is in
    /// transit.
    pub(crate) fn is_group_under_way(&self, frame: &Frame, seat: MemberRef) -> bool {
        self.is_under_way(frame, seat) && self.is_distant_group(seat)
    }

    /// Returns whether any message is in transit.
    pub(super) fn has_messages(&self, frame: &Frame) -> bool {
        frame.transit.iter().skip(WHAT).step_by(BYTES).any(|message| *message != 0)
    }

    pub(super) fn transit_labels(&self, frame: &Frame, labels: &mut Vec<Label>) {
        for (bytes, &MemberRef { unit, member }) in frame.transit.chunks_exact(BYTES).zip(&self.transit.seats) {
            let (at, slot) = (small(unit), small(member as usize));
            match bytes[WHAT] {
                _ if bytes[MESSAGE] != 1 => {}
                START => labels.push(Label::Arrived(at, slot)),
                _ => labels.push(Label::Heard(at, slot)),
            }
        }
    }

    /// Returns whether an order to stop a member may arrive: no other message is before it on the link.
    pub(super) fn is_stop_next(&self, frame: &Frame, seat: MemberRef) -> bool {
        self.transit_of(seat).is_none_or(|place| frame.transit[BYTES * place + STOP] == 1)
    }

    /// Returns the link of a message: the sending and the receiving host.
    fn way(&self, place: usize, of: usize, kind: u8) -> (u32, u32) {
        let (own, host) = self.transit.hosts[place];
        if of == MESSAGE && kind != START { (host, own) } else { (own, host) }
    }

    /// Returns mutable positions of all messages on one link.
    fn on_link<'f>(&self, frame: &'f mut Frame, link: (u32, u32)) -> impl Iterator<Item = &'f mut u8> {
        let mut of_link = Vec::new();
        for (place, bytes) in frame.transit.chunks_exact_mut(BYTES).enumerate() {
            let kind = bytes[WHAT];
            for (of, byte) in bytes.iter_mut().enumerate().skip(MESSAGE) {
                if *byte != 0 && self.way(place, of, kind) == link {
                    of_link.push(byte);
                }
            }
        }
        of_link.into_iter()
    }

    fn send(&self, frame: &mut Frame, place: usize, of: usize, [kind, value]: [u8; 2]) {
        let way = self.way(place, of, kind);
        let last = self.on_link(frame, way).map(|other| *other).max().unwrap_or(0);
        let bytes = &mut frame.transit[BYTES * place..][..BYTES];
        if of == MESSAGE {
            (bytes[WHAT], bytes[VALUE]) = (kind, value);
        }
        bytes[of] = last.saturating_add(1);
    }

    /// Removes a message from its link.
    fn take(&self, frame: &mut Frame, place: usize, of: usize) -> [u8; 2] {
        let bytes = &mut frame.transit[BYTES * place..][..BYTES];
        let (kind, value, before) = (bytes[WHAT], bytes[VALUE], std::mem::take(&mut bytes[of]));
        if of == MESSAGE {
            (bytes[WHAT], bytes[VALUE]) = (0, 0);
        }
        if before != 0 {
            let way = self.way(place, of, kind);
            self.on_link(frame, way).filter(|other| **other > before).for_each(|other| *other -= 1);
        }
        [kind, value]
    }

    /// Sends the order to start a member. Returns whether it takes time.
    pub(super) fn send_start(&self, frame: &mut Frame, seat: MemberRef, value: &Value) -> bool {
        let place = self.transit_of(seat);
        if let Some(place) = place {
            self.send(frame, place, MESSAGE, [START, self.number(value)]);
        }
        place.is_some()
    }

    /// Sends the order to stop a member, if it takes time and is not in transit yet.
    pub(super) fn send_stop(&self, frame: &mut Frame, seat: MemberRef) {
        if let Some(place) = self.transit_of(seat).filter(|place| frame.transit[BYTES * place + STOP] == 0) {
            self.send(frame, place, STOP, [0; 2]);
        }
    }

    /// Handles an order to stop that has arrived, or has no target any more.
    pub(super) fn receive_stop(&self, frame: &mut Frame, seat: MemberRef) {
        if let Some(place) = self.transit_of(seat) {
            self.take(frame, place, STOP);
        }
    }

    /// Sends the report that a group has ended. Returns whether it takes time.
    pub(super) fn send_end(&self, frame: &mut Frame, seat: MemberRef, outcome: &Outcome) -> bool {
        let message = match outcome {
            Outcome::Done(value) => [DONE, self.number(value)],
            Outcome::Stopped => [STOPPED, 0],
            Outcome::Aborted(_) if is_unconfirmed(outcome) => [UNCONFIRMED, 0],
            Outcome::Aborted(reason) => [ABORTED, self.report(&Failure::of(&reason.cause))],
        };
        let place = self.transit_of(seat);
        if let Some(place) = place {
            self.send(frame, place, MESSAGE, message);
        }
        place.is_some()
    }

    /// Takes the message to or from a member, which has arrived.
    pub(super) fn receive(&self, frame: &mut Frame, seat: MemberRef) -> Option<Arrival> {
        let place = self.transit_of(seat)?;
        let [kind, value] = self.take(frame, place, MESSAGE);
        match kind {
            START => Some(Arrival::Start(self.value(value))),
            DONE => Some(Arrival::End(Outcome::Done(self.value(value)))),
            ABORTED => Some(Arrival::End(failed(&self.reason(value)))),
            STOPPED => Some(Arrival::End(Outcome::Stopped)),
            UNCONFIRMED => Some(Arrival::End(unconfirmed())),
            _ => None,
        }
    }

    /// Discards the messages that a host does not receive because it takes no messages any more, or has noticed the loss
    /// of the link. Returns the members whose order to start never arrives.
    pub(super) fn lose_messages(&self, frame: &mut Frame, is_lost: impl Fn((u32, u32)) -> bool) -> Vec<MemberRef> {
        let mut unreached = Vec::new();
        for (place, &seat) in self.transit.seats.iter().enumerate() {
            let kind = frame.transit[BYTES * place + WHAT];
            if kind != 0 && is_lost(self.way(place, MESSAGE, kind)) {
                self.take(frame, place, MESSAGE);
                if kind == START {
                    unreached.push(seat);
                }
            }
        }
        unreached
    }

    /// Returns whether an answer to a stop, an order, a report between hosts, or the notice of a loss is still expected.
    pub(crate) fn has_stops(&self, frame: &Frame) -> bool {
        let is_stopping = |unit: usize| {
            let state = &frame.states[unit];
            let is_box = |member: u32| matches!(self.units[unit].seats[member as usize], Occupant::Box(_));
            let is_awaited = |member: u32| {
                is_box(member) && state.activity(member) == Activity::Stopping
                    || self.is_refused(frame, MemberRef { unit, member })
            };
            !self.is_silent(frame, unit) && state.members_active().any(is_awaited)
        };
        frame.ordered.contains(&true)
            || self.has_messages(frame)
            || self.is_news_due(frame)
            || (0..self.units.len()).any(is_stopping)
    }

    /// Returns whether a `shield` or a `finally` delays a stop.
    pub(crate) fn is_held_up(&self, frame: &Frame) -> bool {
        let unit = |unit: usize| !self.is_silent(frame, unit) && frame.states[unit].is_held_up(self.program(unit));
        (0..self.units.len()).any(unit)
    }
}
