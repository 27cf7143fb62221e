//! The loss of a host in the world of several hosts: the consequences of its death or of a cut. They follow the
//! manual's page "When hosts cannot be reached", for programs without an `on_link_loss`.
//!
//! A message in transit arrives until the node at its end has noted the loss. A later message never arrives. A node
//! that has lost the home leaves. The remaining supervisors hear that members beyond the loss have failed, or that
//! their stop is not confirmed.

use super::{Event, Move, Seat, Work, World};
use language::automaton::Failure;
use language::plan::MemberKind;
use std::collections::BTreeSet;

/// The host that may be lost, and the kind of the loss.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Loss {
    pub(crate) host: u32,
    pub(crate) fate: Fate,
}

/// The state of a lost host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fate {
    /// Its node has died.
    Dead,
    /// The host continues, but no message passes between it and the others.
    Cut,
}

/// The progress of a loss.
#[derive(Clone, Debug, Default)]
pub(super) struct Rift {
    pub(super) is_lost: bool,
    /// The hosts whose nodes have noted the loss.
    noted: BTreeSet<u32>,
    /// The hosts on which nothing runs any more.
    left: BTreeSet<u32>,
}

impl World<'_> {
    /// Whether the loss separates two hosts.
    pub(super) fn is_cut(&self, one: u32, other: u32) -> bool {
        self.loss.is_some_and(|loss| self.rift.is_lost && (one == loss.host) != (other == loss.host))
    }

    /// Returns whether the supervisor of a group has stopped its work.
    pub(super) fn is_silent(&self, group: u32) -> bool {
        self.rift.left.contains(&self.plan.groups[group as usize].host)
    }

    pub(super) fn loss_moves(&self, all: &mut Vec<Move>) {
        if self.loss.is_none() {
            return;
        }
        if !self.rift.is_lost {
            return all.push(Move::Lost);
        }
        let hosts = 0..u32::try_from(self.plan.hosts.len()).expect("few hosts");
        let unknowing = hosts.filter(|host| !self.rift.left.contains(host) && !self.rift.noted.contains(host));
        all.extend(unknowing.map(Move::Noted));
        all.extend(self.out_of_reach(|host| self.rift.noted.contains(&host)).into_iter().map(Move::Refused));
    }

    /// Returns the members beyond the loss that are active for a supervisor on such a host.
    fn out_of_reach(&self, is_on: impl Fn(u32) -> bool) -> Vec<Seat> {
        let mut seats = Vec::new();
        for (group, source) in (0_u32..).zip(&self.plan.groups).filter(|(group, _)| !self.is_silent(*group)) {
            let slots = (0_u32..).zip(&source.members).map(|(slot, _)| (group, slot));
            let is_away =
                |seat: &Seat| self.link(*seat).is_some_and(|(own, other)| is_on(own) && self.is_cut(own, other));
            seats.extend(slots.filter(|seat| is_away(seat) && self.is_being_stopped(*seat).is_some()));
        }
        seats
    }

    pub(super) fn is_lost(&mut self) {
        self.rift.is_lost = true;
        if let Some(loss) = self.loss.filter(|loss| loss.fate == Fate::Dead) {
            self.leaves(loss.host);
        }
    }

    /// A host leaves: nothing runs on it any more, and no message reaches it.
    fn leaves(&mut self, host: u32) {
        self.rift.left.insert(host);
        self.queues.retain(|(_, to, _), _| *to != host);
        let gone: Vec<Seat> = self.programs.keys().copied().filter(|seat| self.host_of(*seat) == host).collect();
        self.programs.retain(|seat, _| !gone.contains(seat));
    }

    fn host_of(&self, seat: Seat) -> u32 {
        match self.kind(seat) {
            MemberKind::Leaf(leaf) => self.plan.leaves[leaf as usize].host,
            MemberKind::Group(inner) => self.plan.groups[inner as usize].host,
        }
    }

    /// The node of a host notes the loss.
    pub(super) fn note(&mut self, host: u32) {
        let is_late = |from: u32| self.is_cut(from, host);
        let late: Vec<_> = self.queues.keys().copied().filter(|(from, to, _)| *to == host && is_late(*from)).collect();
        late.iter().for_each(|way| drop(self.queues.remove(way)));
        if self.is_cut(self.plan.groups[0].host, host) {
            return self.leaves(host);
        }
        self.rift.noted.insert(host);
        // A program on this host stops by its own rules if its supervisor is beyond the loss.
        let own = |seat: &Seat| self.plan.groups[seat.0 as usize].host;
        let here = self.programs.keys().copied().filter(|seat| self.host_of(*seat) == host);
        let gone: Vec<Seat> = here.filter(|seat| self.is_cut(own(seat), host)).collect();
        self.programs.retain(|seat, _| !gone.contains(seat));
        for seat in self.out_of_reach(|own| own == host) {
            let work = self.gives_up(seat);
            self.follow(work);
        }
    }

    /// Returns the event that a supervisor receives for a member beyond the loss.
    pub(super) fn gives_up(&self, (group, slot): Seat) -> Option<Work> {
        let event = match self.is_being_stopped((group, slot))? {
            true => Event::Unconfirmed(slot),
            false => Event::Failed(slot, Failure::HostLost),
        };
        Some(Work::Happen(group, event))
    }
}
