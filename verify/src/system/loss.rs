//! The loss of a host, and the reactions of the nodes on both sides of it.
//!
//! From outside, a dead host and an unreachable host look the same. Once the node of a supervisor has noticed the
//! loss, the members there have failed for that supervisor, whether or not they still run. Unreachable programs
//! continue until their own node has also noticed the loss; then each follows its `on_link_loss`. A group continues
//! with its expression as long as any program below it may continue. A host that has lost the home host, and on which
//! nothing continues, leaves the mission. Resources that a `using` holds for a member on a lost host are not given to
//! others. The rules come from `node/src/logic`: `participant/loss`, `executer/lost`, `executer/fence`.

mod note;

use super::{Frame, Occupant, System};
use crate::model::{Model, Seat};
use crate::system::MemberRef;
use language::algebra::Activity;
use language::plan::{Expression, LinkLoss, MemberKind};
use std::collections::{BTreeMap, BTreeSet};

/// A host that is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Loss {
    /// Index into `Plan::hosts`.
    pub(crate) host: u32,
    pub(crate) kind: LossKind,
}

/// The state of a lost host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LossKind {
    /// The host's programs have died. Its node, and the supervisors there, continue.
    Programs,
    /// The host has died.
    Death,
    /// The host continues, but cannot reach any other host.
    Cut,
}

/// The reaction of a host to the loss: none yet, noticed it, or left the mission.
const NOTED: u8 = 1;
const LEFT: u8 = 2;

/// The state of a member: it runs, but its supervisor has given it up.
const ORPHAN: u8 = 1;
/// The member has stopped, but its supervisor does not know this.
const GONE: u8 = 2;
/// The member's resources stay reserved.
const FENCED: u8 = 4;
/// The member was started after the loss and has never begun. Its host is unreachable or begins nothing new, or the
/// resources that it needs are fenced.
const UNREACHED: u8 = 8;
const HELD: u8 = 16;
const WAITS: u8 = 32;

/// The two sides of a loss.
#[derive(Debug)]
pub(super) struct Rift {
    home: u32,
    /// For each unit, the host of its supervisor.
    units: Vec<u32>,
    /// For each unit, the hosts of its members.
    seats: Vec<Vec<u32>>,
    /// For each unit, where the flags of its members begin in `Frame::rift`.
    starts: Vec<usize>,
    length: usize,
    /// For each unit, whether some program below it may continue without the other hosts.
    endures: Vec<bool>,
    /// For each group, the resources that are held for each of its members.
    taken: Vec<BTreeMap<u32, BTreeSet<String>>>,
    /// The groups for which a resource is held further outside.
    below: BTreeSet<u32>,
    /// The hosts that have to notice the loss, because it affects them.
    concerned: Vec<u32>,
}

impl System<'_> {
    /// Allows the loss of a host in this system. Groups that the loss may split have to be open: see [`is_torn`].
    pub(crate) fn lose(&mut self, loss: Loss) {
        self.mode.lost = Some(loss);
        if loss.kind != LossKind::Programs {
            let mut rift = self.rift_of();
            rift.concerned = self.concerned(&rift, loss);
            self.rift = Some(rift);
        }
    }

    /// Keeps the resources of a `using` reserved for a member whose stop is not confirmed.
    pub(super) fn keep_taken(&mut self, MemberRef { unit, member }: MemberRef) {
        if self.rift.is_some() {
            return;
        }
        let rift = self.rift_of();
        let group = self.model.parts[self.units[unit].part].group;
        if rift.below.contains(&group) || rift.taken[group as usize].contains_key(&member) {
            self.rift = Some(rift);
        }
    }

    /// Notes that the stop of a member was not confirmed.
    pub(super) fn stays_taken(&self, frame: &mut Frame, MemberRef { unit, member }: MemberRef) {
        if let Some(rift) = &self.rift {
            frame.rift[rift.starts[unit] + member as usize] |= FENCED;
        }
    }

    fn rift_of(&self) -> Rift {
        let plan = self.model.plan;
        let part = |unit: usize| &self.model.parts[self.units[unit].part];
        let units: Vec<u32> = (0..self.units.len()).map(|unit| plan.groups[part(unit).group as usize].host).collect();
        let host = |unit: usize, seat: &Seat| match *seat {
            Seat::Leaf(leaf) => plan.leaves[leaf as usize].host,
            Seat::Part(inner) if self.model.parts[inner].is_piece => units[unit],
            Seat::Part(inner) => plan.groups[self.model.parts[inner].group as usize].host,
        };
        let seats: Vec<Vec<u32>> =
            (0..units.len()).map(|unit| part(unit).members.iter().map(|seat| host(unit, seat)).collect()).collect();
        let mut length = plan.hosts.len();
        let mut starts = Vec::new();
        for seats in &seats {
            starts.push(length);
            length += seats.len();
        }
        let endures = (0..units.len()).map(|unit| endures(self.model, part(unit).group)).collect();
        let taken: Vec<_> = plan.groups.iter().map(|group| taken(&group.expression)).collect();
        let below = below(self.model, &taken);
        Rift { home: plan.groups[0].host, units, seats, starts, length, endures, taken, below, concerned: Vec::new() }
    }

    /// Returns the hosts that have to act when they notice a loss.
    fn concerned(&self, rift: &Rift, loss: Loss) -> Vec<u32> {
        let mut hosts = BTreeSet::new();
        for (unit, &own) in rift.units.iter().enumerate() {
            for &host in &rift.seats[unit] {
                if self.is_cut(own, host) {
                    hosts.extend([own, host]);
                }
                // The loss of any supervisor above it makes a program stop by itself, not only the loss of its own
                // supervisor.
                if self.is_cut_from_above(rift, unit, host) {
                    hosts.insert(host);
                }
            }
            if self.is_cut(rift.home, own) || self.beyond(own).any(|lost| self.awaits_loss(unit, lost)) {
                hosts.insert(own);
            }
        }
        hosts.into_iter().filter(|host| loss.kind != LossKind::Death || *host != loss.host).collect()
    }

    pub(super) fn rift_length(&self) -> usize {
        self.rift.as_ref().map_or(0, |rift| rift.length)
    }

    // ---- where things stand ----

    /// Returns whether a host has been lost and both sides continue separately.
    pub(crate) fn is_split(&self, frame: &Frame) -> bool {
        self.mode.lost.is_some_and(|loss| loss.kind != LossKind::Programs) && frame.is_faulty
    }

    /// Returns whether the supervisor of a unit is silent, because its host has died or has left the mission.
    pub(crate) fn is_silent(&self, frame: &Frame, unit: usize) -> bool {
        let Some(rift) = self.rift.as_ref().filter(|_| frame.is_faulty) else { return false };
        self.is_out(frame, rift.units[unit])
    }

    /// Returns whether nothing runs on a host any more.
    fn is_out(&self, frame: &Frame, host: u32) -> bool {
        let is_dead = |loss: Loss| loss.kind == LossKind::Death && loss.host == host;
        self.mode.lost.is_some_and(is_dead) || frame.rift.get(host as usize) == Some(&LEFT)
    }

    fn is_cut(&self, one: u32, other: u32) -> bool {
        self.mode.lost.is_some_and(|loss| (one == loss.host) != (other == loss.host))
    }

    /// Returns the hosts that a host cannot reach after the loss.
    fn beyond(&self, host: u32) -> impl Iterator<Item = u32> {
        let hosts = (0_u32..).zip(&self.model.plan.hosts).map(|(other, _)| other);
        hosts.filter(move |other| self.is_cut(host, *other))
    }

    /// Returns whether the loss separates a member from its supervisor.
    pub(crate) fn is_severed(&self, frame: &Frame, MemberRef { unit, member }: MemberRef) -> bool {
        let Some(rift) = self.rift.as_ref().filter(|_| frame.is_faulty) else { return false };
        self.is_cut(rift.units[unit], rift.seats[unit][member as usize])
    }

    /// Returns whether the loss separates a member from its home host, or from a supervisor above it.
    pub(crate) fn is_cut_off(&self, frame: &Frame, MemberRef { unit, member }: MemberRef) -> bool {
        let Some(rift) = self.rift.as_ref().filter(|_| frame.is_faulty) else { return false };
        self.is_cut_from_above(rift, unit, rift.seats[unit][member as usize])
    }

    /// The same for a host on which a member of a unit runs, whether or not the loss has already happened.
    fn is_cut_from_above(&self, rift: &Rift, unit: usize, host: u32) -> bool {
        let mut above = std::iter::successors(Some(unit), |unit| Some(self.units[*unit].parent?.unit));
        self.is_cut(rift.home, host) || above.any(|unit| self.is_cut(rift.units[unit], host))
    }

    fn has_noted(&self, frame: &Frame, host: u32) -> bool {
        frame.rift.get(host as usize).is_some_and(|noted| *noted != 0)
    }

    /// Returns whether an active member has failed for its supervisor, or is about to, because its host is lost.
    pub(crate) fn is_refused(&self, frame: &Frame, member_ref: MemberRef) -> bool {
        let MemberRef { unit, member } = member_ref;
        if self.is_given_up(frame, member_ref) {
            return true;
        }
        let Some(loss) = self.mode.lost.filter(|_| frame.is_faulty) else { return false };
        let Some(rift) = &self.rift else {
            let seat = self.model.parts[self.units[unit].part].members.get(member as usize);
            return matches!(seat, Some(Seat::Leaf(leaf)) if self.model.plan.leaves[*leaf as usize].host == loss.host);
        };
        self.is_severed(frame, member_ref) && self.has_noted(frame, rift.units[unit])
            || self.flags(frame, member_ref) & HELD != 0
    }

    /// Returns whether a member is silent, and its supervisor does not know the reason yet.
    pub(super) fn is_unheard(&self, frame: &Frame, seat: MemberRef) -> bool {
        self.is_severed(frame, seat) && !self.is_refused(frame, seat)
    }

    /// Returns whether the report of a member's end may have been in transit since before the loss, and may still
    /// arrive.
    pub(super) fn may_have_ended(&self, frame: &Frame, seat: MemberRef) -> bool {
        let has_begun = self.flags(frame, seat) & (UNREACHED | HELD | WAITS) == 0 && !self.is_under_way(frame, seat);
        self.mode.hears_late && has_begun && self.is_unheard(frame, seat)
    }

    /// Returns whether an active member has not begun because a lost host may still use its resources.
    pub(crate) fn waits_for_ever(&self, frame: &Frame, seat: MemberRef) -> bool {
        self.flags(frame, seat) & WAITS != 0
    }

    fn flags(&self, frame: &Frame, MemberRef { unit, member }: MemberRef) -> u8 {
        let rift = self.rift.as_ref().filter(|_| frame.is_faulty || frame.is_twice_faulty);
        rift.map_or(0, |rift| frame.rift[rift.starts[unit] + member as usize])
    }

    /// Returns whether a program, or a black box, is really running or stopping, even if its supervisor does not know
    /// this.
    pub(crate) fn is_there(&self, frame: &Frame, seat: MemberRef) -> bool {
        let MemberRef { unit, member } = seat;
        let is_active = frame.states[unit].activity(member) != Activity::Idle && !self.is_under_way(frame, seat);
        let Some(rift) = self.rift.as_ref().filter(|_| frame.is_faulty || frame.is_twice_faulty) else {
            return is_active;
        };
        let flags = self.flags(frame, seat);
        let has_begun = flags & (GONE | UNREACHED | HELD | WAITS) == 0;
        !self.is_out(frame, rift.seats[unit][member as usize]) && (flags & ORPHAN != 0 || is_active && has_begun)
    }

    /// Returns whether a member, or anything in it, is really running or stopping.
    pub(crate) fn is_anything_there(&self, frame: &Frame, seat: MemberRef) -> bool {
        match self.units[seat.unit].seats[seat.member as usize] {
            Occupant::Box(_) => self.is_there(frame, seat),
            Occupant::Unit(inner) => {
                let slots = (0_u32..).zip(&self.units[inner].seats).map(|(slot, _)| slot);
                slots.into_iter().any(|slot| self.is_anything_there(frame, MemberRef { unit: inner, member: slot }))
            }
        }
    }

    /// Returns whether a member is on the host that may be lost.
    pub(crate) fn is_on_lost(&self, MemberRef { unit, member }: MemberRef) -> bool {
        let host = self.rift.as_ref().map(|rift| rift.seats[unit][member as usize]);
        host.is_some() && host == self.mode.lost.map(|loss| loss.host)
    }

    /// Returns the programs and black boxes that are running or stopping.
    pub(crate) fn there(&self, frame: &Frame) -> Vec<MemberRef> {
        let mut there = Vec::new();
        for (unit, source) in self.units.iter().enumerate() {
            for (member, occupant) in (0..).zip(&source.seats) {
                if matches!(occupant, Occupant::Box(_)) && self.is_there(frame, MemberRef { unit, member }) {
                    there.push(MemberRef { unit, member });
                }
            }
        }
        there
    }

    /// Returns whether a program runs without a supervisor that the mission can reach.
    pub(crate) fn is_adrift(&self, frame: &Frame, member_ref: MemberRef) -> bool {
        let Some(rift) = self.rift.as_ref().filter(|_| frame.is_faulty) else { return false };
        let seats = std::iter::successors(Some(member_ref), |seat| self.units[seat.unit].parent);
        let is_lost = |seat: MemberRef| self.is_severed(frame, seat) || self.is_silent(frame, seat.unit);
        let is_home_away = self.is_out(frame, rift.home);
        self.is_there(frame, member_ref) && (is_home_away || seats.into_iter().any(is_lost))
    }

    /// Returns whether a member runs, and neither it nor a group around it is being stopped.
    pub(crate) fn is_running(&self, frame: &Frame, seat: MemberRef) -> bool {
        let mut at = Some(seat);
        while let Some(seat) = at {
            let MemberRef { unit, member } = seat;
            if self.is_severed(frame, seat) || self.is_silent(frame, unit) {
                // The parts around it are no longer relevant.
                return match self.units[unit].seats[member as usize] {
                    Occupant::Box(_) => self.is_there(frame, seat),
                    Occupant::Unit(inner) => frame.states[inner].is_node_active(0) && !self.is_silent(frame, inner),
                };
            }
            let is_active = frame.states[unit].activity(member) == Activity::Active;
            if !is_active || self.waits_for_ever(frame, seat) || self.is_group_under_way(frame, seat) {
                return false;
            }
            at = self.units[unit].parent;
        }
        true
    }

    /// Returns how the programs of a member react to unreachable hosts; black boxes do not react.
    pub(crate) fn link_loss(&self, MemberRef { unit, member }: MemberRef) -> LinkLoss {
        match self.model.parts[self.units[unit].part].members.get(member as usize) {
            Some(Seat::Leaf(leaf)) => self.model.plan.leaves[*leaf as usize].policy.link_loss,
            Some(Seat::Part(_)) | None => LinkLoss::Leave,
        }
    }
}

/// Returns whether the loss of a host may split a group, or separate it from the group around it. Such a group has to
/// be open.
pub(crate) fn is_torn(model: &Model<'_>, group: u32) -> bool {
    let host = model.around[group as usize]
        .map_or(model.plan.groups[group as usize].host, |(around, _)| model.plan.groups[around as usize].host);
    endures(model, group) || !is_all_on(model, group, host)
}

fn is_all_on(model: &Model<'_>, group: u32, host: u32) -> bool {
    let source = &model.plan.groups[group as usize];
    source.host == host
        && source.members.iter().all(|member| match member.kind {
            MemberKind::Leaf(leaf) => model.plan.leaves[leaf as usize].host == host,
            MemberKind::Group(inner) => is_all_on(model, inner, host),
        })
}

/// Returns whether some program below a group may continue when hosts are lost.
fn endures(model: &Model<'_>, group: u32) -> bool {
    let leaves = model.leaves_of_group(group);
    leaves.into_iter().any(|leaf| model.plan.leaves[leaf as usize].policy.link_loss != LinkLoss::Leave)
}

/// Returns the resources that are held around each run of a member.
fn taken(expression: &Expression) -> BTreeMap<u32, BTreeSet<String>> {
    let mut taken = BTreeMap::new();
    collect(expression, &BTreeSet::new(), &mut taken);
    taken
}

fn collect(expression: &Expression, around: &BTreeSet<String>, taken: &mut BTreeMap<u32, BTreeSet<String>>) {
    if let Expression::Run { member, .. } = expression
        && !around.is_empty()
    {
        taken.entry(*member).or_default().extend(around.iter().cloned());
    }
    let own = if let Expression::Using { resources, .. } = expression { &resources[..] } else { &[] };
    let around = around.iter().chain(own).cloned().collect();
    expression.operands().into_iter().for_each(|operand| collect(operand, &around, taken));
}

/// Returns the groups for which a resource is held further outside.
fn below(model: &Model<'_>, taken: &[BTreeMap<u32, BTreeSet<String>>]) -> BTreeSet<u32> {
    // A group has a greater number than the group that contains it.
    let mut below = BTreeSet::new();
    for (group, around) in (0_u32..).zip(&model.around) {
        if let Some((outer, slot)) = around
            && (below.contains(outer) || taken[*outer as usize].contains_key(slot))
        {
            below.insert(group);
        }
    }
    below
}
