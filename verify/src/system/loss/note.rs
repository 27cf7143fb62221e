//! The consequences of losing a host: nodes notice it, programs stop or continue, and supervisors give up unreachable
//! members.

use super::super::reaction::{Blow, failed};
use super::super::{Frame, Label, Occupant, System, small};
use super::{FENCED, GONE, HELD, LEFT, LossKind, NOTED, ORPHAN, UNREACHED, WAITS};
use crate::system::MemberRef;
use language::algebra::Activity;
use language::automaton::Failure;
use language::plan::LinkLoss;
use std::collections::VecDeque;

impl System<'_> {
    pub(in crate::system) fn loss_labels(&self, frame: &Frame, labels: &mut Vec<Label>) {
        if !frame.is_faulty {
            return labels.push(Label::Lost);
        }
        let unknowing = |host: &&u32| !self.has_noted(frame, **host);
        let hosts = self.rift.iter().flat_map(|rift| &rift.concerned).filter(unknowing);
        labels.extend(hosts.map(|host| Label::Noted(small(*host as usize))));
    }

    pub(in crate::system) fn is_news_due(&self, frame: &Frame) -> bool {
        let mut hosts = self.rift.iter().flat_map(|rift| &rift.concerned);
        frame.is_faulty && hosts.any(|host| !self.has_noted(frame, *host))
    }

    /// Notes, at the activation of a member, whether it begins; returns the same.
    pub(in crate::system) fn begins(&self, frame: &mut Frame, seat: MemberRef) -> bool {
        let MemberRef { unit, member } = seat;
        let is_struck = frame.is_faulty || frame.is_twice_faulty;
        let Some(rift) = self.rift.as_ref().filter(|_| is_struck) else { return true };
        let flag = match () {
            () if self.is_severed(frame, seat) => UNREACHED,
            () if self.is_fenced(frame, seat) => WAITS,
            () if self.begins_nothing(frame, seat) => HELD,
            () => 0,
        };
        let flags = &mut frame.rift[rift.starts[unit] + member as usize];
        *flags = *flags & !(GONE | UNREACHED | HELD | WAITS) | flag;
        flag == 0
    }

    /// Returns whether the host of a program has noticed a loss and begins nothing new.
    fn begins_nothing(&self, frame: &Frame, seat: MemberRef) -> bool {
        let MemberRef { unit, member } = seat;
        let Some(rift) = &self.rift else { return false };
        let host = rift.seats[unit][member as usize];
        matches!(self.units[unit].seats[member as usize], Occupant::Box(_))
            && self.has_noted(frame, host)
            && self.link_loss(seat) != LinkLoss::Keep
            && (self.is_cut(rift.home, host) || self.is_below_cut(unit, host))
    }

    /// Notes whether a member begins when the order to start it arrives; returns the same.
    pub(in crate::system) fn is_taken(&self, frame: &mut Frame, seat: MemberRef) -> bool {
        let MemberRef { unit, member } = seat;
        let is_struck = frame.is_faulty || frame.is_twice_faulty;
        let Some(rift) = self.rift.as_ref().filter(|_| is_struck) else {
            return !self.is_refused(frame, seat);
        };
        if self.is_out(frame, rift.seats[unit][member as usize]) {
            // The node has left the mission: it answers that there is nothing to start.
            self.send_end(frame, seat, &failed(&Failure::Crash));
            return false;
        }
        let is_given_up = frame.states[unit].activity(member) == Activity::Idle;
        let flag = match () {
            () if self.begins_nothing(frame, seat) => HELD,
            // The supervisor has given the member up before it began.
            () if is_given_up && self.is_severed(frame, seat) => ORPHAN,
            () => 0,
        };
        frame.rift[rift.starts[unit] + member as usize] |= flag;
        flag != HELD && (flag == ORPHAN || !self.is_refused(frame, seat))
    }

    /// Discards messages in transit to a dead host.
    pub(in crate::system) fn lose_to_the_dead(&self, frame: &mut Frame) {
        let dead = self.mode.lost.filter(|loss| self.rift.is_some() && loss.kind == LossKind::Death);
        self.lose_messages(frame, |(_, to)| dead.is_some_and(|loss| loss.host == to));
    }

    /// Discards messages in transit over the loss to a host that has noticed it.
    fn lose_late(&self, frame: &mut Frame, host: u32) {
        let Some(rift) = &self.rift else { return };
        let unreached = self.lose_messages(frame, |(from, to)| to == host && self.is_cut(from, to));
        for MemberRef { unit, member } in unreached {
            frame.rift[rift.starts[unit] + member as usize] |= UNREACHED;
        }
    }

    /// Returns the actions of a host's node when it notices the loss: first the stops on this host, then the reports
    /// to its supervisors.
    pub(in crate::system) fn note(&self, frame: &mut Frame, host: u32) -> VecDeque<Blow> {
        let Some(rift) = &self.rift else { return VecDeque::new() };
        self.lose_late(frame, host);
        let is_home_away = self.is_cut(rift.home, host);
        let leaves = is_home_away && !self.goes_on(frame, host);
        let mut blows = VecDeque::new();
        for (unit, &own) in rift.units.iter().enumerate() {
            for member in (0..).take(rift.seats[unit].len()).filter(|slot| rift.seats[unit][*slot as usize] == host) {
                let seat = MemberRef { unit, member };
                let is_box = matches!(self.units[unit].seats[member as usize], Occupant::Box(_));
                if !is_box || !self.is_there(frame, seat) || !(leaves || self.stops(frame, seat)) {
                    continue;
                }
                if self.is_severed(frame, seat) || self.is_silent(frame, unit) {
                    let flags = &mut frame.rift[rift.starts[unit] + member as usize];
                    *flags = *flags & !ORPHAN | GONE;
                    blows.push_back(Blow::Tell(unit, member));
                } else if own != host || !leaves {
                    blows.push_back(Blow::End(unit, member, frame.states[unit].activity(member)));
                }
            }
            if own == host && !leaves && (is_home_away || self.is_supervised_across(unit)) && !rift.endures[unit] {
                blows.push_back(Blow::Stop(unit));
            }
            if let Some(MemberRef { unit: around, member }) = self.units[unit].parent
                && own == host
                && leaves
                && rift.units[around] != host
                && !self.is_severed(frame, MemberRef { unit: around, member })
            {
                blows.push_back(Blow::End(around, member, frame.states[around].activity(member)));
            }
        }
        frame.rift[host as usize] = if leaves { LEFT } else { NOTED };
        if !leaves {
            self.give_up(frame, host, &mut blows);
        }
        blows
    }

    /// Makes the supervisors of a host give up the members beyond the loss.
    fn give_up(&self, frame: &mut Frame, host: u32, blows: &mut VecDeque<Blow>) {
        let Some(rift) = &self.rift else { return };
        for unit in (0..rift.units.len()).filter(|unit| rift.units[*unit] == host) {
            // An activity learns of the loss before its members fail because of it.
            blows.extend(self.beyond(host).map(|lost| Blow::News(unit, lost)));
            let group = self.model.parts[self.units[unit].part].group;
            let severed: Vec<u32> = frame.states[unit]
                .members_active()
                .filter(|member| self.is_severed(frame, MemberRef { unit, member: *member }))
                .collect();
            for member in severed {
                let is_box = matches!(self.units[unit].seats[member as usize], Occupant::Box(_));
                let is_there = is_box && self.is_there(frame, MemberRef { unit, member });
                let is_taken = rift.below.contains(&group) || rift.taken[group as usize].contains_key(&member);
                let flags = &mut frame.rift[rift.starts[unit] + member as usize];
                if *flags & UNREACHED == 0 {
                    *flags |= if is_there { ORPHAN } else { 0 } | if is_taken { FENCED } else { 0 };
                }
                blows.push_back(Blow::End(unit, member, frame.states[unit].activity(member)));
            }
        }
    }

    /// Returns whether something on a host continues without the home host.
    fn goes_on(&self, frame: &Frame, host: u32) -> bool {
        let Some(rift) = &self.rift else { return false };
        let keeps = |unit: usize, member: u32| {
            let is_box = matches!(self.units[unit].seats[member as usize], Occupant::Box(_));
            is_box
                && self.link_loss(MemberRef { unit, member }) != LinkLoss::Leave
                && self.is_there(frame, MemberRef { unit, member })
        };
        (0..rift.units.len()).any(|unit| {
            let runs = rift.units[unit] == host && frame.states[unit].is_node_active(0);
            let mut here = (0..).zip(&rift.seats[unit]).filter(|(_, other)| **other == host);
            runs && rift.endures[unit] || here.any(|(member, _)| keeps(unit, member))
        })
    }

    /// Returns whether a program stops by its own rules when its node notices the loss.
    fn stops(&self, frame: &Frame, seat: MemberRef) -> bool {
        let MemberRef { unit, member } = seat;
        let Some(rift) = &self.rift else { return false };
        let host = rift.seats[unit][member as usize];
        let mut above = std::iter::successors(Some(unit), |unit| Some(self.units[*unit].parent?.unit));
        match self.link_loss(seat) {
            LinkLoss::Keep | LinkLoss::Hold => false,
            LinkLoss::SafeStopAfter(_) => above.any(|unit| self.is_cut(rift.units[unit], host)),
            LinkLoss::Leave => {
                self.is_cut(rift.home, host)
                    || self.is_severed(frame, seat)
                    || rift.units[unit] == host && self.is_below_cut(unit, host)
            }
        }
    }

    /// Returns whether a unit, or a unit around it on the same host, has its supervisor beyond the loss.
    fn is_below_cut(&self, unit: usize, host: u32) -> bool {
        let Some(rift) = &self.rift else { return false };
        let mut around = std::iter::successors(Some(unit), |unit| Some(self.units[*unit].parent?.unit));
        around.by_ref().take_while(|unit| rift.units[*unit] == host).any(|unit| self.is_supervised_across(unit))
    }

    fn is_supervised_across(&self, unit: usize) -> bool {
        let around = self.units[unit].parent.zip(self.rift.as_ref());
        around.is_some_and(|(MemberRef { unit: around, .. }, rift)| self.is_cut(rift.units[around], rift.units[unit]))
    }

    /// Returns whether a lost host may still use a resource that a member needs.
    fn is_fenced(&self, frame: &Frame, MemberRef { unit, member }: MemberRef) -> bool {
        let Some(rift) = &self.rift else { return false };
        let group = self.model.parts[self.units[unit].part].group;
        let taken = &rift.taken[group as usize];
        let Some(wanted) = taken.get(&member) else { return false };
        let is_same = |unit: &usize| self.model.parts[self.units[*unit].part].group == group;
        (0..self.units.len()).filter(is_same).any(|unit| {
            let others = taken.iter().filter(|(other, names)| **other != member && !names.is_disjoint(wanted));
            others.into_iter().any(|(&other, _)| self.is_loose(frame, MemberRef { unit, member: other }))
        })
    }

    /// Returns whether a lost host may still act for a member.
    fn is_loose(&self, frame: &Frame, seat: MemberRef) -> bool {
        let MemberRef { unit, member } = seat;
        self.flags(frame, seat) & FENCED != 0
            || matches!(self.units[unit].seats.get(member as usize), Some(&Occupant::Unit(inner))
                if (0..).take(self.units[inner].seats.len()).any(|slot| self.is_loose(frame, MemberRef { unit: inner, member: slot })))
    }
}
