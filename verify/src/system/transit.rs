//! What is on its way between hosts: orders to start, and reports of an end.
//!
//! A supervisor sends the order to start a member to the node of its host. Until that node takes it the member does not run,
//! although its supervisor counts it as active; an order to stop that is sent meanwhile comes behind it on the same link. A group
//! that has ended reports that to the supervisor around it, which goes on as if it ran until the report is there. What a program
//! comes to counts from when its supervisor hears of it: it has nobody else who knows. What is under way when a link is lost may
//! arrive until the node at its end has noted the loss. The rules are those of `node/src/logic`: `link`, `executer`, `participant`.

use super::{Frame, Label, Occupant, System, Value, small};
use crate::model::Seat;
use language::algebra::Outcome;

/// The order to start is under way.
const START: u8 = 1;
/// A report is under way: how it has ended.
const DONE: u8 = 2;
const ABORTED: u8 = 3;
const STOPPED: u8 = 4;
const UNCONFIRMED: u8 = 5;

/// What a system keeps in mind of messages between hosts: for each of these members two bytes, what is under way and its value.
#[derive(Debug, Default)]
pub(super) struct Transit {
    /// The members of which it is known what is under way.
    seats: Vec<(usize, u32)>,
    /// For each of them, the host of its supervisor and its own: indices into `Plan::hosts`.
    hosts: Vec<(u32, u32)>,
}

/// What has arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Arrival {
    /// The order to start, with a value.
    Start(Value),
    /// The report of an end.
    End(Outcome),
}

impl System<'_> {
    /// Lets messages take their time between hosts: to and from every group that is looked into, and to those of `members` that
    /// are boxes.
    pub(crate) fn follow_messages(&mut self, members: &[(usize, u32)]) {
        let mut followed = Transit::default();
        for unit in 0..self.units.len() {
            let own = self.host_of(unit);
            let mut runs = crate::model::runs(&self.model.parts[self.units[unit].part].expression);
            runs.sort_unstable();
            runs.dedup();
            for member in runs {
                let is_open = matches!(self.units[unit].seats[member as usize], Occupant::Unit(_));
                let host = self.host_of_seat((unit, member));
                if host != own && (is_open || members.contains(&(unit, member))) {
                    followed.seats.push((unit, member));
                    followed.hosts.push((own, host));
                }
            }
        }
        self.transit = followed;
    }

    /// The host of the supervisor of a unit.
    fn host_of(&self, unit: usize) -> u32 {
        self.model.plan.groups[self.model.parts[self.units[unit].part].group as usize].host
    }

    /// The host of a member.
    fn host_of_seat(&self, (unit, member): (usize, u32)) -> u32 {
        let plan = self.model.plan;
        match self.model.parts[self.units[unit].part].members[member as usize] {
            Seat::Leaf(leaf) => plan.leaves[leaf as usize].host,
            Seat::Part(inner) if self.model.parts[inner].is_piece => self.host_of(unit),
            Seat::Part(inner) => plan.groups[self.model.parts[inner].group as usize].host,
        }
    }

    pub(super) fn transit_length(&self) -> usize {
        2 * self.transit.seats.len()
    }

    /// Where it is noted what is under way to or from a member; nothing if that is not known of it.
    fn transit_of(&self, seat: (usize, u32)) -> Option<usize> {
        self.transit.seats.iter().position(|other| *other == seat)
    }

    /// Whether something is under way to or from a member: it does not run, although its supervisor takes it for active.
    pub(super) fn is_under_way(&self, frame: &Frame, seat: (usize, u32)) -> bool {
        self.transit_of(seat).is_some_and(|place| frame.transit[2 * place] != 0)
    }

    /// Whether a group is active for the supervisor around it and does not run: something is under way to or from it.
    pub(crate) fn is_group_under_way(&self, frame: &Frame, (unit, member): (usize, u32)) -> bool {
        let is_group = matches!(self.units[unit].seats[member as usize], Occupant::Unit(_));
        is_group && self.is_under_way(frame, (unit, member))
    }

    /// Whether the order to start a member is under way.
    pub(super) fn is_being_sent(&self, frame: &Frame, seat: (usize, u32)) -> bool {
        self.transit_of(seat).is_some_and(|place| frame.transit[2 * place] == START)
    }

    /// Whether anything is under way at all.
    pub(crate) fn has_messages(&self, frame: &Frame) -> bool {
        frame.transit.iter().step_by(2).any(|message| *message != 0)
    }

    pub(super) fn transit_labels(&self, frame: &Frame, labels: &mut Vec<Label>) {
        for (place, &(unit, member)) in self.transit.seats.iter().enumerate() {
            let (at, slot) = (small(unit), small(member as usize));
            match frame.transit[2 * place] {
                0 => {}
                START => labels.push(Label::Arrived(at, slot)),
                _ => labels.push(Label::Heard(at, slot)),
            }
        }
    }

    /// Sends the order to start a member. Returns whether it has to travel.
    pub(super) fn send_start(&self, frame: &mut Frame, seat: (usize, u32), value: &Value) -> bool {
        let Some(place) = self.transit_of(seat) else { return false };
        frame.transit[2 * place..][..2].copy_from_slice(&[START, self.number(value)]);
        true
    }

    /// Sends the report that a group has ended. Returns whether it has to travel.
    pub(super) fn send_end(&self, frame: &mut Frame, seat: (usize, u32), outcome: &Outcome) -> bool {
        let Some(place) = self.transit_of(seat) else { return false };
        let message = match outcome {
            Outcome::Done(value) => [DONE, self.number(value)],
            Outcome::Stopped => [STOPPED, 0],
            Outcome::Aborted(_) if super::reaction::is_unconfirmed(outcome) => [UNCONFIRMED, 0],
            Outcome::Aborted(_) => [ABORTED, 0],
        };
        frame.transit[2 * place..][..2].copy_from_slice(&message);
        true
    }

    /// Takes what is under way to or from a member.
    pub(super) fn receive(&self, frame: &mut Frame, seat: (usize, u32)) -> Option<Arrival> {
        let place = self.transit_of(seat)?;
        let message = &mut frame.transit[2 * place..][..2];
        let (kind, value) = (message[0], message[1]);
        message.fill(0);
        match kind {
            START => Some(Arrival::Start(self.value(value))),
            DONE => Some(Arrival::End(Outcome::Done(self.value(value)))),
            ABORTED => Some(Arrival::End(super::reaction::failed())),
            STOPPED => Some(Arrival::End(Outcome::Stopped)),
            UNCONFIRMED => Some(Arrival::End(super::reaction::unconfirmed())),
            _ => None,
        }
    }

    /// What a host that takes nothing any more, or has noted the loss of the link, does not receive. Returns the members whose order
    /// to start never arrives.
    pub(super) fn lose_messages(
        &self,
        frame: &mut Frame,
        is_lost: impl Fn(&Frame, (u32, u32)) -> bool,
    ) -> Vec<(usize, u32)> {
        let mut unreached = Vec::new();
        for (place, (&seat, &(own, host))) in self.transit.seats.iter().zip(&self.transit.hosts).enumerate() {
            let kind = frame.transit[2 * place];
            let way = if kind == START { (own, host) } else { (host, own) };
            if kind != 0 && is_lost(frame, way) {
                frame.transit[2 * place..][..2].fill(0);
                if kind == START {
                    unreached.push(seat);
                }
            }
        }
        unreached
    }
}
