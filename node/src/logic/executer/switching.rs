//! Switches of connection sets at run time, from the order to the word of every consumer.
//!
//! A switch that an event causes is ordered at once. Values on its new wires wait at the consumer for the end of the
//! old ones, by the in-band boundaries, so the supervisor does not wait. A switch that a user asks for has several
//! steps, each confirmed:
//!
//! ```text
//! Expecting ─all consumers─▶ Opening ─producers that only open─▶ Closing ─all others, and every consumer─▶ switched
//!     └──── too late, or the member has ended ────┘                 └─ too late: not confirmed; it is done by who answers
//!                          ▼
//!          taken back: the old sets stay
//! ```
//! A switch by which programs replace others has the same steps, but is never taken back: late confirmations are not
//! waited for.

mod consumers;

use super::succession::{Succeeded, Succession};
use super::wires::{Difference, Flips};
use super::{ExecContext, Executer, leaf_host, member_path};
use crate::logic::effect::Out;
use crate::logic::protocol::{Change, SetsSwitched, Target, ToCoordinator};
use comms::logic::human::span;
use comms::logic::switch::Flip;
use comms::logic::time::Time;
pub(super) use consumers::pushes_to;
use consumers::{Expected, consumers_of_any, consumers_of_both, expect, second_writer, set_name};
use language::algebra::Command;
use language::plan::{Group, Plan};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long a step of a switch has to be confirmed. Consumers wait 1 s for the end of old wires.
const STEP_WITHIN: Duration = Duration::from_secs(2);
/// How long producers have to confirm that they have opened new wires. Consumers hold those back, and must not give up the old
/// ones before these are closed.
const OPEN_WITHIN: Duration = Duration::from_millis(500);
/// How many switches are followed at one time; a further switch is not reported.
const SWITCHES_MAX: usize = 64;

/// The switches of one group.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Switches {
    /// Switches that are not over, by generation.
    open: BTreeMap<u64, Switch>,
    /// The open sets of members that a person has switched, by slot.
    switched_to: BTreeMap<u32, Vec<u32>>,
    /// Members whose place others are about to take.
    pub(super) succession: Option<Succession>,
}

/// A switch that is not over.
#[derive(Debug, Serialize, Deserialize)]
struct Switch {
    difference: Difference,
    step: Step,
    began: Time,
    until: Time,
    pending: Pending,
    counted: Counted,
    /// The slot whose sets a person wants, and the call that is answered.
    asked: Option<(u32, u64)>,
    /// Programs that this switch replaces by other programs.
    succeeded: Vec<Succeeded>,
    /// Closed wires whose end no consumer waits for.
    unheard: BTreeSet<u32>,
    /// Wires that programs flip by themselves.
    by_themselves: BTreeSet<u32>,
}

/// The words that a switch waits for.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Pending {
    /// Consumers that have not said that they expect it.
    expecting: BTreeSet<u32>,
    /// Consumers that have not taken it.
    taking: BTreeSet<u32>,
    /// Orders to producers that are not confirmed.
    flipping: BTreeSet<u64>,
}

/// The values of closed wires that consumers have counted.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Counted {
    /// How many have not arrived.
    pub lost: u64,
    /// How many came too late, and were dropped.
    pub late: u64,
    /// Wires from which nothing came in time.
    pub missing: BTreeSet<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Step {
    Expecting,
    Opening,
    Closing,
}

impl Switches {
    /// Returns when a step of a switch is too late.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.open.values().map(|switch| switch.until).min()
    }

    /// Returns whether programs hand their connections over, or are about to.
    pub(super) fn hand_over(&self) -> bool {
        self.succession.is_some() || self.open.values().any(Switch::is_handover)
    }

    /// Forgets the switches that are not over, and those that a person has made.
    pub(super) fn clear(&mut self) {
        self.open.clear();
        self.switched_to.clear();
    }

    /// Returns the sets to close when the event actions close the sets in `close`. If a user has switched to other
    /// sets, these are closed instead.
    fn instead_of(&mut self, close: Vec<u32>, group: &Group) -> Vec<u32> {
        let owner = |set: &u32| group.sets.get(*set as usize).and_then(|set| set.owner);
        let mut closed = Vec::new();
        let mut owners = BTreeSet::new();
        for set in close {
            match owner(&set) {
                Some(slot) if self.switched_to.contains_key(&slot) || owners.contains(&slot) => {
                    closed.extend(self.switched_to.remove(&slot).into_iter().flatten());
                    owners.insert(slot);
                }
                Some(_) | None => closed.push(set),
            }
        }
        closed
    }

    fn generations(&self, is_meant: impl Fn(&Switch) -> bool) -> Vec<u64> {
        self.open.iter().filter(|(_, switch)| is_meant(switch)).map(|(generation, _)| *generation).collect()
    }
}

impl Executer {
    /// Notes that the producers of a generation of wires are switched.
    pub fn switched(&mut self, generation: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.confirm(&BTreeSet::from([generation]));
        self.activate_ready(context, out);
        self.flipped(generation, context, out);
    }

    /// Switches to the sets that the commands of one event leave open.
    pub(super) fn connect(&mut self, commands: &[Command], context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        let (mut close, mut open) = (Vec::new(), Vec::new());
        for command in commands {
            if let Command::Disconnect { set } = command {
                close.push(*set);
            } else if let Command::Connect { set } = command {
                open.push(*set);
            }
        }
        if close.is_empty() && open.is_empty() {
            return;
        }
        let owners = close.iter().filter_map(|set| group.sets.get(*set as usize)?.owner).collect::<BTreeSet<_>>();
        owners.into_iter().for_each(|slot| self.forget_switch(slot, context, out));
        let close = self.switches.instead_of(close, group);
        let difference = self.wires.difference(close, open);
        self.begin_switch(difference, context, out);
    }

    /// Carries a switch out that an event causes.
    pub(super) fn begin_switch(&mut self, difference: Difference, context: ExecContext<'_>, out: &mut Out<'_>) {
        if difference.is_empty() {
            return;
        }
        self.hurry_handovers(context, out);
        let generation = self.wires.next_generation();
        let consumers = consumers_of_both(context.plan, &difference);
        let is_followed = !consumers.is_empty() && self.switches.open.len() < SWITCHES_MAX;
        if is_followed {
            let expected =
                Expected { generation, difference: &difference, consumers: &consumers, then: &BTreeMap::new() };
            expect(expected, self.group, context, out);
        }
        let (close, open) = (&difference.close[..], &difference.open[..]);
        let flipping = self.wires.order(Flips { generation, close, open, ends: close }, self.group, context, out);
        if is_followed {
            let pending = Pending { taking: consumers, flipping, ..Pending::default() };
            let switch = Switch { step: Step::Closing, pending, ..Switch::new(difference, BTreeSet::new(), out.now) };
            self.switches.open.insert(generation, switch);
        }
    }

    /// Hands the connections of programs over to their successors.
    pub(super) fn begin_handover(&mut self, handover: Handover, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Handover { generation, difference, unheard, succeeded, then } = handover;
        let by_themselves = then
            .values()
            .flat_map(|flip| flip.close.iter().copied().chain(flip.open.iter().map(|opening| opening.wire)));
        let by_themselves = by_themselves.collect();
        let close = difference.close.iter().copied().filter(|wire| !unheard.contains(wire)).collect();
        let heard = Difference { close, ..difference.clone() };
        let consumers = consumers_of_any(context.plan, &heard);
        let expected = Expected { generation, difference: &heard, consumers: &consumers, then: &then };
        expect(expected, self.group, context, out);
        let switch = Switch::new(difference, consumers, out.now);
        self.switches.open.insert(generation, Switch { succeeded, unheard, by_themselves, ..switch });
        self.go_on(generation, context, out);
    }

    /// Switches a running member to other connection sets of its own. The home gets the result.
    pub fn switch_sets(&mut self, slot: u32, sets: &[u32], call: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        match self.sets_to_switch(slot, sets, context) {
            Ok(difference) if difference.sets_closed.is_empty() && difference.sets_opened.is_empty() => {
                self.answer_switch(call, Ok(SetsSwitched::default()), context, out);
            }
            Ok(difference) => {
                self.hurry_handovers(context, out);
                let generation = self.wires.next_generation();
                let consumers = consumers_of_any(context.plan, &difference);
                let expected =
                    Expected { generation, difference: &difference, consumers: &consumers, then: &BTreeMap::new() };
                expect(expected, self.group, context, out);
                let switch = Switch { asked: Some((slot, call)), ..Switch::new(difference, consumers, out.now) };
                self.switches.open.insert(generation, switch);
                self.go_on(generation, context, out);
            }
            Err(why) => self.answer_switch(call, Err(why), context, out),
        }
    }

    /// Returns why a member cannot be switched to these sets now, or the wires that the switch would flip.
    fn sets_to_switch(&self, slot: u32, sets: &[u32], context: ExecContext<'_>) -> Result<Difference, String> {
        let Some(group) = context.plan.groups.get(self.group as usize) else {
            return Err("there is no such group".into());
        };
        let path = member_path(context.plan, group, slot).unwrap_or_default();
        if !self.members.is_active(slot) || self.members.is_waiting(slot) {
            return Err(format!(
                "`{path}` does not run at this moment; its next activation opens the sets that the event actions name"
            ));
        }
        if self.switches.open.values().any(|switch| switch.asked.is_some_and(|(other, _)| other == slot)) {
            return Err(format!("`{path}` is being switched at this moment"));
        }
        if self.switches.open.len() >= SWITCHES_MAX {
            return Err("too many switches are not confirmed".to_owned());
        }
        let owned = |set: &u32| group.sets.get(*set as usize).filter(|set| set.owner == Some(slot));
        let labelled: BTreeSet<u32> =
            self.wires.open_sets().filter(|set| owned(set).is_some_and(|set| set.label.is_some())).collect();
        let wanted: BTreeSet<u32> = sets.iter().copied().collect();
        let (sets_closed, sets_opened) = (&labelled - &wanted, &wanted - &labelled);
        let of = |set: &u32| self.wires.of_set(*set);
        let wires =
            |sets: &BTreeSet<u32>| -> BTreeSet<u32> { sets.iter().flat_map(|set| of(set).iter().copied()).collect() };
        let count = |wire: &u32| self.wires.times_open(*wire);
        let closes = |wire: &u32| {
            let fewer = sets_closed.iter().filter(|set| of(set).contains(wire)).count();
            count(wire) == fewer && !wires(&sets_opened).contains(wire)
        };
        let close: Vec<u32> = wires(&sets_closed).into_iter().filter(closes).collect();
        let open: Vec<u32> = wires(&sets_opened).into_iter().filter(|wire| count(wire) == 0).collect();
        let stay = self.wires.open_wires().into_iter().filter(|wire| !close.contains(wire));
        if let Some(why) = second_writer(context.plan, &open, stay) {
            return Err(why);
        }
        let (sets_closed, sets_opened) = (sets_closed.into_iter().collect(), sets_opened.into_iter().collect());
        Ok(Difference { sets_closed, sets_opened, close, open })
    }

    /// Takes the word of a consumer that it expects a switch.
    pub fn expecting(&mut self, generation: u64, leaf: u32, context: ExecContext<'_>, out: &mut Out<'_>) {
        if let Some(switch) = self.switches.open.get_mut(&generation) {
            switch.pending.expecting.remove(&leaf);
            self.go_on(generation, context, out);
        }
    }

    /// Takes the report of a consumer that it has taken a switch, with the values it has counted.
    pub fn taken(&mut self, generation: u64, leaf: u32, theirs: Counted, context: ExecContext<'_>, out: &mut Out<'_>) {
        if let Some(switch) = self.switches.open.get_mut(&generation)
            && switch.pending.taking.remove(&leaf)
        {
            switch.pending.expecting.remove(&leaf);
            switch.counted.add(theirs);
            self.go_on(generation, context, out);
        }
    }

    /// Takes the word of the producers of a host.
    fn flipped(&mut self, number: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        let mut open = self.switches.open.iter_mut();
        let theirs =
            open.find_map(|(generation, switch)| switch.pending.flipping.remove(&number).then_some(*generation));
        if let Some(generation) = theirs {
            self.go_on(generation, context, out);
        }
    }

    /// Takes the next step of a switch once the present one is confirmed.
    pub(super) fn go_on(&mut self, generation: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(switch) = self.switches.open.get_mut(&generation) else { return };
        match switch.step {
            Step::Expecting if switch.pending.expecting.is_empty() => {
                (switch.step, switch.until) = (Step::Opening, out.now + OPEN_WITHIN);
                // A producer that also closes wires does both between two values.
                let ((close, open), ends) = (switch.ordered(), switch.ends());
                let producer = |wire: &u32| context.plan.wires.get(*wire as usize).map(|wire| wire.from.leaf);
                let closing: BTreeSet<Option<u32>> = close.iter().map(producer).collect();
                let open: Vec<u32> = open.into_iter().filter(|wire| !closing.contains(&producer(wire))).collect();
                self.order_flips(Flips { generation, close: &[], open: &open, ends: &ends }, context, out);
                self.go_on(generation, context, out);
            }
            Step::Opening if switch.pending.flipping.is_empty() => {
                (switch.step, switch.until) = (Step::Closing, out.now + STEP_WITHIN);
                if switch.succeeded.is_empty() {
                    let Difference { sets_closed, sets_opened, .. } = switch.difference.clone();
                    let slot = switch.asked.map(|(slot, _)| slot);
                    let difference = self.wires.difference(sets_closed, sets_opened);
                    self.note_switched(slot, context.plan);
                    if let Some(switch) = self.switches.open.get_mut(&generation) {
                        switch.difference = difference;
                    }
                }
                let Some(switch) = self.switches.open.get(&generation) else { return };
                let ((close, open), ends) = (switch.ordered(), switch.ends());
                self.order_flips(Flips { generation, close: &close, open: &open, ends: &ends }, context, out);
                self.go_on(generation, context, out);
            }
            Step::Closing if switch.pending.flipping.is_empty() && switch.pending.taking.is_empty() => {
                self.end_switch(generation, context, out);
            }
            Step::Expecting | Step::Opening | Step::Closing => {}
        }
    }

    /// Orders the wires of the present step of a switch, and notes which words it waits for.
    fn order_flips(&mut self, flips: Flips<'_>, context: ExecContext<'_>, out: &mut Out<'_>) {
        let flipping = self.wires.order(flips, self.group, context, out);
        if let Some(switch) = self.switches.open.get_mut(&flips.generation) {
            switch.pending.flipping = flipping;
        }
    }

    fn note_switched(&mut self, slot: Option<u32>, plan: &Plan) {
        let Some((slot, group)) = slot.zip(plan.groups.get(self.group as usize)) else { return };
        let owned = |set: &u32| group.sets.get(*set as usize).is_some_and(|set| set.owner == Some(slot));
        let open = self.wires.open_sets().filter(owned).collect();
        self.switches.switched_to.insert(slot, open);
    }

    /// Stops waiting for programs of a lost host.
    pub(super) fn switch_without(&mut self, host: &str, context: ExecContext<'_>, out: &mut Out<'_>) {
        let is_elsewhere = |leaf: &u32| leaf_host(context.plan, *leaf) != Some(host);
        let gone = self.wires.unconfirmed_by(host);
        for Switch { pending, .. } in self.switches.open.values_mut() {
            pending.expecting.retain(is_elsewhere);
            pending.taking.retain(is_elsewhere);
            pending.flipping.retain(|number| !gone.contains(number));
        }
        for generation in self.switches.generations(|_| true) {
            self.go_on(generation, context, out);
        }
    }

    /// Drops all switches, since the group has ended. Callers that asked for one are answered.
    pub(super) fn end_switches(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.switches.open.retain(|_, switch| switch.asked.is_some() || switch.is_handover());
        for generation in self.switches.generations(|_| true) {
            self.end_switch(generation, context, out);
        }
        self.switches.switched_to.clear();
    }

    /// Gives up the switches that are too late.
    pub(super) fn tick_switches(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        for generation in self.switches.generations(|switch| switch.until <= out.now) {
            if !self.hurry(generation, context, out) {
                self.end_switch(generation, context, out);
            }
        }
    }

    /// Takes back the switch that a person has asked for, if the member ends before the old sets were closed.
    fn forget_switch(&mut self, slot: u32, context: ExecContext<'_>, out: &mut Out<'_>) {
        let is_theirs =
            |switch: &Switch| switch.step != Step::Closing && switch.asked.is_some_and(|(other, _)| other == slot);
        if let Some(generation) = self.switches.generations(is_theirs).first() {
            self.end_switch(*generation, context, out);
        }
    }

    /// Orders all that is left of handovers, before something else is ordered of the same wires.
    pub(super) fn hurry_handovers(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        for generation in self.switches.generations(Switch::is_handover) {
            self.hurry(generation, context, out);
        }
    }

    /// Stops waiting for the members of a handover, so that all its orders are sent. Returns whether an order was missing.
    fn hurry(&mut self, generation: u64, context: ExecContext<'_>, out: &mut Out<'_>) -> bool {
        let mut was_left = false;
        while let Some(switch) = self.switches.open.get_mut(&generation).filter(|switch| switch.is_to_be_ordered()) {
            was_left = true;
            switch.wait_for_nobody();
            self.go_on(generation, context, out);
        }
        was_left
    }

    fn end_switch(&mut self, generation: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(switch) = self.switches.open.remove(&generation) else { return };
        self.stop_succeeded(&switch.succeeded, context, out);
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        if switch.step != Step::Closing && !switch.is_handover() {
            return self.take_switch_back(&switch, generation, context, out);
        }
        let name = |set: &u32| set_name(group, *set);
        let switched = SetsSwitched {
            closed: switch.difference.sets_closed.iter().map(name).collect(),
            opened: switch.difference.sets_opened.iter().map(name).collect(),
            took: out.now - switch.began,
            lost: switch.counted.lost,
            late: switch.counted.late,
            unconfirmed: self.silent(&switch, context.plan).into_iter().collect(),
        };
        let (target, change) = (Target::Group(self.group), Change::Switched(switched.clone()));
        out.send(context.home, context.deployment.to_coordinator(ToCoordinator::Happened { target, change }));
        if let Some((_, call)) = switch.asked {
            self.answer_switch(call, Ok(switched), context, out);
        }
    }

    /// Closes the sets that a switch has opened before its old sets were closed. The caller gets the reason.
    fn take_switch_back(&mut self, switch: &Switch, generation: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        let plan = context.plan;
        let mut who: BTreeSet<u32> = switch.pending.expecting.clone();
        if switch.step == Step::Opening {
            let open = self.wires.open_wires();
            let opened: Vec<u32> = switch.difference.open.iter().copied().filter(|wire| !open.contains(wire)).collect();
            who = opened.iter().filter_map(|wire| plan.wires.get(*wire as usize)).map(|wire| wire.from.leaf).collect();
            // Closed by the switch that has opened it, a wire is as if it had never been opened.
            self.order_flips(Flips { generation, close: &opened, open: &[], ends: &[] }, context, out);
        }
        let Some((slot, call)) = switch.asked else { return };
        let member = plan.groups.get(self.group as usize).and_then(|group| member_path(plan, group, slot));
        let why = match member {
            Some(member) if !self.members.is_active(slot) => format!("`{member}` has ended meanwhile"),
            Some(_) | None => format!(
                "`{}` did not answer within {}; the old connections stay",
                who.iter().filter_map(|leaf| leaf_path(plan, *leaf)).collect::<Vec<_>>().join("`, `"),
                span(if switch.step == Step::Opening { OPEN_WITHIN } else { STEP_WITHIN })
            ),
        };
        self.answer_switch(call, Err(why), context, out);
    }

    /// Returns the paths of the programs that have not confirmed their part of a switch.
    fn silent(&self, switch: &Switch, plan: &Plan) -> BTreeSet<String> {
        let from = |wire: &u32| plan.wires.get(*wire as usize).map(|wire| wire.from.leaf);
        let mut silent: BTreeSet<u32> = switch.pending.taking.clone();
        silent.extend(switch.counted.missing.iter().filter_map(from));
        let hosts = self.wires.silent_hosts(&switch.pending.flipping);
        let flipped = switch.difference.close.iter().chain(&switch.difference.open).filter_map(from);
        silent.extend(flipped.filter(|leaf| leaf_host(plan, *leaf).is_some_and(|host| hosts.contains(host))));
        silent.into_iter().filter_map(|leaf| leaf_path(plan, leaf)).collect()
    }

    fn answer_switch(
        &self,
        call: u64,
        switched: Result<SetsSwitched, String>,
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) {
        let answer = ToCoordinator::SetsSwitched { call, switched };
        out.send(context.home, context.deployment.to_coordinator(answer));
    }
}

/// Programs that hand their connections over to their successors.
#[derive(Debug)]
pub(super) struct Handover {
    pub(super) generation: u64,
    pub(super) difference: Difference,
    /// Closed wires of which it is unknown whether further values arrive.
    pub(super) unheard: BTreeSet<u32>,
    pub(super) succeeded: Vec<Succeeded>,
    /// The wires that programs flip by themselves.
    pub(super) then: BTreeMap<u32, Flip>,
}

impl Switch {
    fn new(difference: Difference, consumers: BTreeSet<u32>, now: Time) -> Self {
        Self {
            difference,
            step: Step::Expecting,
            began: now,
            until: now + STEP_WITHIN,
            pending: Pending { expecting: consumers.clone(), taking: consumers, flipping: BTreeSet::new() },
            counted: Counted::default(),
            asked: None,
            succeeded: Vec::new(),
            unheard: BTreeSet::new(),
            by_themselves: BTreeSet::new(),
        }
    }

    /// Returns whether programs hand their connections over by it.
    fn is_handover(&self) -> bool {
        !self.succeeded.is_empty()
    }

    /// Returns whether not all of a handover is ordered.
    fn is_to_be_ordered(&self) -> bool {
        self.is_handover() && self.step != Step::Closing
    }

    fn wait_for_nobody(&mut self) {
        (self.pending.expecting, self.pending.flipping) = (BTreeSet::new(), BTreeSet::new());
    }

    /// Returns the wires to close and to open, without the wires that programs switch by themselves.
    fn ordered(&self) -> (Vec<u32>, Vec<u32>) {
        let ours = |wires: &[u32]| wires.iter().copied().filter(|wire| !self.by_themselves.contains(wire)).collect();
        (ours(&self.difference.close), ours(&self.difference.open))
    }

    /// Returns the closed wires whose end consumers wait for.
    fn ends(&self) -> Vec<u32> {
        self.difference.close.iter().copied().filter(|wire| !self.unheard.contains(wire)).collect()
    }
}

impl Counted {
    fn add(&mut self, more: Self) {
        (self.lost, self.late) = (self.lost + more.lost, self.late + more.late);
        self.missing.extend(more.missing);
    }
}

fn leaf_path(plan: &Plan, leaf: u32) -> Option<String> {
    plan.leaves.get(leaf as usize).map(|leaf| leaf.path.clone())
}
