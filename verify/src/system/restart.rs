//! Restarts of programs by their policy, which event actions do not see.
//!
//! The activation of the member outlives the death of its program. The supervisor does not learn of the death, and the program is
//! away until it runs again as if it had just begun. Depending on the strategy of its group, programs of other members are
//! restarted with it. A program that has died too often has failed, and cannot be started any more. A group whose programs have
//! died too often stops everything and has failed. States do not count the deaths, so each
//! consequence may come at any time at which it is possible. The rules come from `node/src/logic`:
//! `instance/restarts`, `executer/supervision`.

use super::{Changed, FaultKind, Frame, Label, System, small};
use crate::model::{Model, Seat};
use crate::system::MemberRef;
use language::algebra::Activity;
use language::automaton::Failure;
use language::plan::{LeafKind, MemberKind, Restart, Strategy};
use std::time::Duration;

/// How often one program is restarted within [`WINDOW`].
const RESTARTS_MAX: u32 = 5;
const WINDOW: Duration = Duration::from_secs(60);

/// The member is away and will return.
const AWAY: u8 = 1;
/// The member has been given up: each activation fails.
const GIVEN_UP: u8 = 2;
/// The stop of the member was not confirmed: each activation fails.
const UNCONFIRMED: u8 = 4;
/// The programs of a unit have died too often: the unit stops, and has failed then.
const ESCALATES: u8 = 1;

/// The restarts that a system keeps track of.
#[derive(Debug, Default)]
pub(super) struct Restarts {
    /// The members for which the state notes whether they are away or given up.
    seats: Vec<MemberRef>,
    /// The units that may stop because of too many deaths.
    units: Vec<usize>,
}

/// Returns whether a program is restarted when it dies.
pub(crate) fn is_restarted(model: &Model<'_>, leaf: u32) -> bool {
    model.plan.leaves[leaf as usize].policy.restart != Restart::Temporary
}

/// Returns whether a program is restarted even if it has done its work.
pub(crate) fn is_never_done(model: &Model<'_>, leaf: u32) -> bool {
    let leaf = &model.plan.leaves[leaf as usize];
    leaf.policy.restart == Restart::Permanent && leaf.kind != LeafKind::Controller
}

/// Returns the possible consequences of a program's death under its policy: it is restarted, it has died too often, or the
/// programs of its group have died too often.
pub(crate) fn crashes(model: &Model<'_>, group: u32, leaf: u32) -> Vec<FaultKind> {
    if !is_restarted(model, leaf) {
        return vec![FaultKind::Crash];
    }
    let mut kinds = Vec::new();
    let borne = model.plan.groups[group as usize].supervision.intensity;
    if borne.is_none_or(|borne| borne.restarts > 0) {
        kinds.push(FaultKind::Crash);
    }
    // Five restarts of one program alone, at such intervals that the group tolerates them.
    let is_given_up = borne.is_none_or(|borne| match borne.restarts {
        0 => false,
        restarts => borne.within.saturating_mul(RESTARTS_MAX.div_ceil(restarts) - 1) < WINDOW,
    });
    if is_given_up {
        kinds.push(FaultKind::GivenUp);
    }
    if escalates(model, group) {
        kinds.push(FaultKind::TooMany);
    }
    kinds
}

/// Returns whether the programs of a group can die more often than the group tolerates.
pub(crate) fn escalates(model: &Model<'_>, group: u32) -> bool {
    let source = &model.plan.groups[group as usize];
    let Some(borne) = source.supervision.intensity else { return false };
    let restarted = |kind: MemberKind| matches!(kind, MemberKind::Leaf(leaf) if is_restarted(model, leaf));
    let programs = source.members.iter().filter(|member| restarted(member.kind)).count() as u128;
    let windows = borne.within.as_nanos().div_ceil(WINDOW.as_nanos());
    programs * windows * u128::from(RESTARTS_MAX) > u128::from(borne.restarts)
}

/// Returns the slots of a group whose programs are restarted together with another program.
pub(crate) fn taken_along(model: &Model<'_>, group: u32, slot: u32) -> Vec<u32> {
    let source = &model.plan.groups[group as usize];
    let slots = (0_u32..).zip(&source.members).map(|(other, _)| other);
    match source.supervision.strategy {
        Strategy::OneForOne => Vec::new(),
        Strategy::OneForAll => slots.filter(|other| *other != slot).collect(),
        Strategy::RestForOne => slots.filter(|other| *other > slot).collect(),
    }
}

impl System<'_> {
    /// Tracks whether these members are away, if they are ever restarted, and permits them and every group to die too often.
    pub(crate) fn follow_restarts(&mut self, members: &[MemberRef]) {
        let seats: Vec<_> = members.iter().copied().filter(|seat| self.is_restarted(*seat)).collect();
        self.restarts.seats.extend(seats);
        self.restarts.seats.sort_unstable();
        self.restarts.seats.dedup();
        self.restarts.units = (0..self.units.len()).filter(|unit| self.may_escalate(*unit)).collect();
    }

    /// Tracks a member that a fault strikes.
    pub(crate) fn follow_fault(&mut self, member: MemberRef, kind: FaultKind) {
        match kind {
            FaultKind::Crash => self.follow_restarts(&[member]),
            FaultKind::GivenUp | FaultKind::Unanswered => self.restarts.seats.push(member),
            FaultKind::TooMany => self.follow_restarts(&[]),
            FaultKind::Hang | FaultKind::HostLost | FaultKind::CutOff | FaultKind::LinkLost => {}
        }
        self.restarts.seats.sort_unstable();
        self.restarts.seats.dedup();
        if kind == FaultKind::Unanswered {
            self.keep_taken(member);
        }
    }

    /// Returns whether the program of a member is restarted when it dies.
    pub(crate) fn is_restarted(&self, seat: MemberRef) -> bool {
        self.leaf(seat).is_some_and(|leaf| is_restarted(self.model, leaf))
    }

    fn may_escalate(&self, unit: usize) -> bool {
        let part = &self.model.parts[self.units[unit].part];
        !part.is_piece && escalates(self.model, part.group)
    }

    fn leaf(&self, MemberRef { unit, member }: MemberRef) -> Option<u32> {
        match self.model.parts[self.units[unit].part].members.get(member as usize) {
            Some(Seat::Leaf(leaf)) => Some(*leaf),
            Some(Seat::Part(_)) | None => None,
        }
    }

    /// Returns the unit of the complete group to which a unit belongs as a piece.
    fn whole(&self, unit: usize) -> usize {
        let outwards = std::iter::successors(Some(unit), |unit| Some(self.units[*unit].parent?.unit));
        outwards.into_iter().find(|unit| !self.model.parts[self.units[*unit].part].is_piece).unwrap_or(unit)
    }

    pub(super) fn restarts_length(&self) -> usize {
        self.restarts.seats.len() + self.restarts.units.len()
    }

    /// Returns the place of a member's notes about restarts.
    pub(crate) fn place_of(&self, seat: MemberRef) -> Option<usize> {
        self.restarts.seats.iter().position(|other| *other == seat)
    }

    fn flags_of(&self, frame: &Frame, seat: MemberRef) -> u8 {
        self.place_of(seat).map_or(0, |place| frame.restarts[place])
    }

    /// Returns whether the program of a member has died and does not run again yet.
    pub(crate) fn is_away(&self, frame: &Frame, seat: MemberRef) -> bool {
        self.flags_of(frame, seat) & AWAY != 0
    }

    /// The same for a known place of the notes.
    pub(crate) fn notes_away(frame: &Frame, place: usize) -> bool {
        frame.restarts[place] & AWAY != 0
    }

    /// Returns whether a member cannot be started any more.
    pub(super) fn is_given_up(&self, frame: &Frame, seat: MemberRef) -> bool {
        self.flags_of(frame, seat) & (GIVEN_UP | UNCONFIRMED) != 0
    }

    pub(super) fn was_unconfirmed(&self, frame: &Frame, seat: MemberRef) -> bool {
        self.flags_of(frame, seat) & UNCONFIRMED != 0
    }

    /// Appends the labels of deaths that affect whole units.
    pub(super) fn restart_labels(&self, frame: &Frame, labels: &mut Vec<Label>) {
        if !self.mode.crashes {
            return;
        }
        for (place, &unit) in (self.restarts.seats.len()..).zip(&self.restarts.units) {
            if frame.states[unit].is_node_active(0) && frame.restarts[place] & ESCALATES == 0 {
                labels.push(Label::TooMany(small(unit)));
            }
        }
    }

    /// Appends the labels for the death of an active member. Returns whether the member is away, so that it has no other labels.
    pub(super) fn death_labels(&self, frame: &Frame, seat: MemberRef, labels: &mut Vec<Label>) -> bool {
        let Some(place) = self.place_of(seat) else { return false };
        let (unit, member) = (small(seat.unit), small(seat.member as usize));
        let is_away = frame.restarts[place] & AWAY != 0;
        if is_away {
            labels.push(Label::Back(unit, member));
            if self.mode.aborts {
                labels.push(Label::Aborted(unit, member, self.report(&Failure::Crash)));
            }
        } else if self.mode.crashes {
            labels.push(Label::Died(unit, member));
        }
        is_away
    }

    /// Notes, at an activation or its end, that a member is not away.
    pub(super) fn is_here(&self, frame: &mut Frame, seat: MemberRef) {
        if let Some(place) = self.place_of(seat) {
            frame.restarts[place] &= !AWAY;
        }
    }

    /// Handles the death of a member's program that is restarted. Returns the changes: of this member, and of the members that
    /// are restarted with it.
    pub(super) fn dies(&self, frame: &mut Frame, seat: MemberRef) -> Vec<(usize, u32, Changed)> {
        let mut changes = vec![(seat.unit, seat.member, Changed::Away)];
        let with = self.restarts.seats.iter().filter(|other| self.is_taken_along(seat, **other));
        changes.extend(with.map(|&MemberRef { unit, member }| (unit, member, Changed::Away)));
        changes.retain(|&(unit, member, _)| frame.states[unit].activity(member) == Activity::Active);
        for (unit, member, _) in &changes {
            if let Some(place) = self.place_of(MemberRef { unit: *unit, member: *member }) {
                frame.restarts[place] |= AWAY;
            }
        }
        changes
    }

    /// Returns whether a member is restarted together with another one.
    fn is_taken_along(&self, struck: MemberRef, other: MemberRef) -> bool {
        let group = self.model.parts[self.units[struck.unit].part].group;
        let slots = taken_along(self.model, group, struck.member);
        let outwards = std::iter::successors(Some(other), |MemberRef { unit, .. }| self.units[*unit].parent);
        let whole = self.whole(struck.unit);
        let mut at = outwards.into_iter().filter(|MemberRef { unit, .. }| {
            self.model.parts[self.units[*unit].part].group == group && self.whole(*unit) == whole
        });
        self.is_restarted(other) && at.any(|MemberRef { member: slot, .. }| slots.contains(&slot))
    }

    /// Notes that a member is not started any more.
    pub(super) fn give_up_member(&self, frame: &mut Frame, seat: MemberRef, kind: FaultKind) {
        // A plain program can be started again.
        let is_controller =
            self.leaf(seat).is_some_and(|leaf| self.model.plan.leaves[leaf as usize].kind == LeafKind::Controller);
        let flag = if kind == FaultKind::Unanswered { UNCONFIRMED } else { GIVEN_UP };
        if let Some(place) = self.place_of(seat).filter(|_| is_controller || flag == UNCONFIRMED) {
            frame.restarts[place] |= flag;
        }
    }

    /// Handles too many deaths of the programs in a unit's group. Returns the unit that stops.
    pub(super) fn too_many(&self, frame: &mut Frame, unit: usize) -> usize {
        let whole = self.whole(unit);
        if let Some(place) = self.restarts.units.iter().position(|other| *other == whole) {
            frame.restarts[self.restarts.seats.len() + place] |= ESCALATES;
        }
        whole
    }

    /// Returns whether a unit that ends does so because its programs have died too often. A second call returns false.
    pub(super) fn take_escalation(&self, frame: &mut Frame, unit: usize) -> bool {
        let Some(place) = self.restarts.units.iter().position(|other| *other == unit) else { return false };
        let flag = &mut frame.restarts[self.restarts.seats.len() + place];
        std::mem::take(flag) & ESCALATES != 0
    }
}
