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

use super::succession::Succeeded;
use super::wires::Difference;
use super::{ExecContext, Executer, leaf_host, member_path};
use crate::logic::effect::Out;
use crate::logic::protocol::{Change, SetsSwitched, Target, ToCoordinator};
use comms::logic::human::span;
use comms::logic::switch::Flip;
use comms::logic::time::Time;
pub(super) use consumers::pushes_to;
use consumers::{consumers_of_any, consumers_of_both, second_writer, set_name};
use language::plan::{Group, Plan};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long a step of a switch has to be confirmed. Consumers wait 1 s for the end of old wires.
const STEP_WITHIN: Duration = Duration::from_secs(2);
/// How long producers have to confirm that they have opened new wires. Consumers hold those back, and must not give up the old
/// ones before these are closed.
const OPEN_WITHIN: Duration = Duration::from_millis(500);
/// How many switches are followed at one time; of one more nothing is told.
const SWITCHES_MAX: usize = 64;

/// A switch that is not over.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Switch {
    difference: Difference,
    step: Step,
    began: Time,
    until: Time,
    /// Consumers that have not said that they expect it.
    expecting: BTreeSet<u32>,
    /// Consumers that have not taken it.
    taking: BTreeSet<u32>,
    /// Orders to producers that are not confirmed.
    flipping: BTreeSet<u64>,
    lost: u64,
    late: u64,
    missing: BTreeSet<u32>,
    /// The slot whose sets a person wants, and the call that is answered.
    asked: Option<(u32, u64)>,
    /// Programs whose places others take by it.
    succeeded: Vec<Succeeded>,
    /// Closed wires whose end no consumer waits for, and wires that programs flip by themselves.
    unheard: BTreeSet<u32>,
    by_themselves: BTreeSet<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Step {
    Expecting,
    Opening,
    Closing,
}

impl Executer {
    /// Returns when a step of a switch is too late.
    pub(super) fn switch_deadline(&self) -> Option<Time> {
        self.switches.values().map(|switch| switch.until).min()
    }

    /// Returns the sets to close for those that the event actions close: others, if a user has switched to those.
    pub(super) fn instead_of(&mut self, close: Vec<u32>, group: &Group) -> Vec<u32> {
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

    /// Carries a switch out that an event causes.
    pub(super) fn begin_switch(&mut self, difference: Difference, context: ExecContext<'_>, out: &mut Out<'_>) {
        if difference.is_empty() {
            return;
        }
        self.hurry_handovers(context, out);
        self.generation += 1;
        let generation = self.generation;
        let consumers = consumers_of_both(context.plan, &difference);
        let is_followed = !consumers.is_empty() && self.switches.len() < SWITCHES_MAX;
        if is_followed {
            self.expect((generation, &difference), (&consumers, &BTreeMap::new()), context, out);
        }
        let flipping =
            self.order_flips((&difference.close, &difference.open, &difference.close), generation, context, out);
        if is_followed {
            let expecting = BTreeSet::new();
            let switch = Switch { flipping, expecting, ..Switch::new(difference, consumers, out.now) };
            self.switches.insert(generation, Switch { step: Step::Closing, ..switch });
        }
    }

    /// Hands the connections of programs over to their successors, which flip their own wires by `then`. For the
    /// `unheard` wires it is unknown whether further values arrive.
    pub(super) fn begin_handover(
        &mut self,
        (difference, unheard): (Difference, BTreeSet<u32>),
        (succeeded, then): (Vec<Succeeded>, &BTreeMap<u32, Flip>),
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) {
        let generation = self.generation;
        let by_themselves = then
            .values()
            .flat_map(|flip| flip.close.iter().copied().chain(flip.open.iter().map(|opening| opening.wire)));
        let by_themselves = by_themselves.collect();
        let close = difference.close.iter().copied().filter(|wire| !unheard.contains(wire)).collect();
        let expected = Difference { close, ..difference.clone() };
        let consumers = consumers_of_any(context.plan, &expected);
        self.expect((generation, &expected), (&consumers, then), context, out);
        let switch = Switch::new(difference, consumers, out.now);
        self.switches.insert(generation, Switch { succeeded, unheard, by_themselves, ..switch });
        self.go_on(generation, context, out);
    }

    /// Switches a running member to other connection sets of its own. The home hears the result.
    pub fn switch_sets(&mut self, (slot, sets): (u32, &[u32]), call: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        match self.sets_to_switch(slot, sets, context) {
            Ok(difference) if difference.sets_closed.is_empty() && difference.sets_opened.is_empty() => {
                self.answer_switch(call, Ok(SetsSwitched::default()), context, out);
            }
            Ok(difference) => {
                self.hurry_handovers(context, out);
                self.generation += 1;
                let generation = self.generation;
                let consumers = consumers_of_any(context.plan, &difference);
                self.expect((generation, &difference), (&consumers, &BTreeMap::new()), context, out);
                let switch = Switch { asked: Some((slot, call)), ..Switch::new(difference, consumers, out.now) };
                self.switches.insert(generation, switch);
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
        if !self.active.contains_key(&slot) || self.waiting.contains_key(&slot) {
            return Err(format!(
                "`{path}` does not run at this moment; its next activation opens the sets that the event actions name"
            ));
        }
        if self.switches.values().any(|switch| switch.asked.is_some_and(|(other, _)| other == slot)) {
            return Err(format!("`{path}` is being switched at this moment"));
        }
        if self.switches.len() >= SWITCHES_MAX {
            return Err("too many switches are not confirmed".to_owned());
        }
        let owned = |set: &u32| group.sets.get(*set as usize).filter(|set| set.owner == Some(slot));
        let open = self.open_sets.iter().filter(|(_, count)| **count > 0).map(|(set, _)| *set);
        let labelled: BTreeSet<u32> = open.filter(|set| owned(set).is_some_and(|set| set.label.is_some())).collect();
        let wanted: BTreeSet<u32> = sets.iter().copied().collect();
        let (sets_closed, sets_opened) = (&labelled - &wanted, &wanted - &labelled);
        let of = |set: &u32| self.wires_of(*set);
        let wires =
            |sets: &BTreeSet<u32>| -> BTreeSet<u32> { sets.iter().flat_map(|set| of(set).iter().copied()).collect() };
        let count = |wire: &u32| self.open.get(wire).copied().unwrap_or_default();
        let closes = |wire: &u32| {
            let fewer = sets_closed.iter().filter(|set| of(set).contains(wire)).count();
            usize::try_from(count(wire)).is_ok_and(|count| count == fewer) && !wires(&sets_opened).contains(wire)
        };
        let close: Vec<u32> = wires(&sets_closed).into_iter().filter(closes).collect();
        let open: Vec<u32> = wires(&sets_opened).into_iter().filter(|wire| count(wire) == 0).collect();
        let stays = |wire: &u32| count(wire) > 0 && !close.contains(wire);
        if let Some(why) = second_writer(context.plan, &open, self.open.keys().copied().filter(stays)) {
            return Err(why);
        }
        let (sets_closed, sets_opened) = (sets_closed.into_iter().collect(), sets_opened.into_iter().collect());
        Ok(Difference { sets_closed, sets_opened, close, open })
    }

    /// Takes the word of a consumer that it expects a switch.
    pub fn expecting(&mut self, (generation, leaf): (u64, u32), context: ExecContext<'_>, out: &mut Out<'_>) {
        if let Some(switch) = self.switches.get_mut(&generation) {
            switch.expecting.remove(&leaf);
            self.go_on(generation, context, out);
        }
    }

    /// Takes the report of a consumer that it has taken a switch: the values it counts, and the wires from which
    /// nothing came.
    pub fn taken(
        &mut self,
        (generation, leaf): (u64, u32),
        (lost, late, missing): (u64, u64, Vec<u32>),
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) {
        if let Some(switch) = self.switches.get_mut(&generation)
            && switch.taking.remove(&leaf)
        {
            switch.expecting.remove(&leaf);
            (switch.lost, switch.late) = (switch.lost + lost, switch.late + late);
            switch.missing.extend(missing);
            self.go_on(generation, context, out);
        }
    }

    /// Takes the word of the producers of a host.
    pub(super) fn flipped(&mut self, number: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        let theirs = self
            .switches
            .iter_mut()
            .find_map(|(generation, switch)| switch.flipping.remove(&number).then_some(*generation));
        if let Some(generation) = theirs {
            self.go_on(generation, context, out);
        }
    }

    /// Takes the next step of a switch once the present one is confirmed.
    pub(super) fn go_on(&mut self, generation: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(switch) = self.switches.get_mut(&generation) else { return };
        match switch.step {
            Step::Expecting if switch.expecting.is_empty() => {
                (switch.step, switch.until) = (Step::Opening, out.now + OPEN_WITHIN);
                // A producer that also closes wires does both between two values.
                let ((close, open), ends) = (switch.ordered(), switch.ends());
                let producer = |wire: &u32| context.plan.wires.get(*wire as usize).map(|wire| wire.from.leaf);
                let closing: BTreeSet<Option<u32>> = close.iter().map(producer).collect();
                let open: Vec<u32> = open.into_iter().filter(|wire| !closing.contains(&producer(wire))).collect();
                let flipping = self.order_flips((&[], &open, &ends), generation, context, out);
                if let Some(switch) = self.switches.get_mut(&generation) {
                    switch.flipping = flipping;
                }
                self.go_on(generation, context, out);
            }
            Step::Opening if switch.flipping.is_empty() => {
                (switch.step, switch.until) = (Step::Closing, out.now + STEP_WITHIN);
                if switch.succeeded.is_empty() {
                    let Difference { sets_closed, sets_opened, .. } = switch.difference.clone();
                    let slot = switch.asked.map(|(slot, _)| slot);
                    let difference = self.difference(sets_closed, sets_opened);
                    self.note_switched(slot, context.plan);
                    if let Some(switch) = self.switches.get_mut(&generation) {
                        switch.difference = difference;
                    }
                }
                let Some(switch) = self.switches.get(&generation) else { return };
                let ((close, open), ends) = (switch.ordered(), switch.ends());
                let flipping = self.order_flips((&close, &open, &ends), generation, context, out);
                if let Some(switch) = self.switches.get_mut(&generation) {
                    switch.flipping = flipping;
                }
                self.go_on(generation, context, out);
            }
            Step::Closing if switch.flipping.is_empty() && switch.taking.is_empty() => {
                self.end_switch(generation, context, out);
            }
            Step::Expecting | Step::Opening | Step::Closing => {}
        }
    }

    fn note_switched(&mut self, slot: Option<u32>, plan: &Plan) {
        let Some((slot, group)) = slot.zip(plan.groups.get(self.group as usize)) else { return };
        let owned = |set: &u32| group.sets.get(*set as usize).is_some_and(|set| set.owner == Some(slot));
        let open = self.open_sets.iter().filter(|(_, count)| **count > 0).map(|(set, _)| *set).filter(owned);
        let open = open.collect();
        self.switched_to.insert(slot, open);
    }

    /// Stops waiting for programs of a lost host.
    pub(super) fn switch_without(&mut self, host: &str, context: ExecContext<'_>, out: &mut Out<'_>) {
        let is_elsewhere = |leaf: &u32| leaf_host(context.plan, *leaf) != Some(host);
        let gone: BTreeSet<u64> =
            self.unconfirmed.iter().filter(|(_, wires)| wires.host == host).map(|(number, _)| *number).collect();
        for switch in self.switches.values_mut() {
            switch.expecting.retain(is_elsewhere);
            switch.taking.retain(is_elsewhere);
            switch.flipping.retain(|number| !gone.contains(number));
        }
        for generation in self.switches.keys().copied().collect::<Vec<_>>() {
            self.go_on(generation, context, out);
        }
    }

    /// Drops all switches, since the group has ended. Callers that asked for one are answered.
    pub(super) fn end_switches(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.switches.retain(|_, switch| switch.asked.is_some() || !switch.succeeded.is_empty());
        for generation in self.switches.keys().copied().collect::<Vec<_>>() {
            self.end_switch(generation, context, out);
        }
        self.switched_to.clear();
    }

    /// Gives up the switches that are too late.
    pub(super) fn tick_switches(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        let late = self.switches.iter().filter(|(_, switch)| switch.until <= out.now).map(|(number, _)| *number);
        for generation in late.collect::<Vec<_>>() {
            if !self.hurry(generation, context, out) {
                self.end_switch(generation, context, out);
            }
        }
    }

    /// Takes back the switch that a person has asked for, if the member ends before the old sets were closed.
    pub(super) fn forget_switch(&mut self, slot: u32, context: ExecContext<'_>, out: &mut Out<'_>) {
        let theirs = self
            .switches
            .iter()
            .find(|(_, switch)| switch.step != Step::Closing && switch.asked.is_some_and(|(other, _)| other == slot));
        if let Some(generation) = theirs.map(|(generation, _)| *generation) {
            self.end_switch(generation, context, out);
        }
    }

    fn end_switch(&mut self, generation: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(switch) = self.switches.remove(&generation) else { return };
        self.stop_succeeded(&switch.succeeded, context, out);
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        let path = |leaf: u32| context.plan.leaves.get(leaf as usize).map(|leaf| leaf.path.clone());
        let silent = |leaves: &BTreeSet<u32>| leaves.iter().filter_map(|leaf| path(*leaf)).collect::<Vec<_>>();
        if switch.step != Step::Closing && switch.succeeded.is_empty() {
            let mut who = silent(&switch.expecting);
            if switch.step == Step::Opening {
                let open = self.open_wires();
                let opened: Vec<u32> =
                    switch.difference.open.iter().copied().filter(|wire| !open.contains(wire)).collect();
                let producers = opened.iter().filter_map(|wire| context.plan.wires.get(*wire as usize));
                who = silent(&producers.map(|wire| wire.from.leaf).collect());
                // Closed by the switch that has opened it, a wire is as if it had never been opened.
                self.order_flips((&opened, &[], &[]), generation, context, out);
            }
            let member = switch.asked.and_then(|(slot, _)| Some((slot, member_path(context.plan, group, slot)?)));
            let why = match member {
                Some((slot, member)) if !self.active.contains_key(&slot) => format!("`{member}` has ended meanwhile"),
                Some(_) | None => format!(
                    "`{}` did not answer within {}; the old connections stay",
                    who.join("`, `"),
                    span(if switch.step == Step::Opening { OPEN_WITHIN } else { STEP_WITHIN })
                ),
            };
            let call = switch.asked.map(|(_, call)| call);
            return call.into_iter().for_each(|call| self.answer_switch(call, Err(why.clone()), context, out));
        }
        let name = |set: &u32| set_name(group, *set);
        let missing = switch.missing.iter().filter_map(|wire| context.plan.wires.get(*wire as usize));
        let mut silent: BTreeSet<String> = silent(&switch.taking).into_iter().collect();
        silent.extend(missing.filter_map(|wire| path(wire.from.leaf)));
        if !switch.flipping.is_empty() {
            let wires = switch.difference.close.iter().chain(&switch.difference.open);
            let hosts =
                switch.flipping.iter().filter_map(|number| self.unconfirmed.get(number)).map(|wires| &wires.host);
            let hosts: BTreeSet<&String> = hosts.collect();
            let is_there =
                |leaf: &u32| leaf_host(context.plan, *leaf).is_some_and(|host| hosts.iter().any(|one| *one == host));
            let leaves = wires.filter_map(|wire| context.plan.wires.get(*wire as usize)).map(|wire| wire.from.leaf);
            silent.extend(leaves.filter(is_there).filter_map(path));
        }
        let switched = SetsSwitched {
            closed: switch.difference.sets_closed.iter().map(name).collect(),
            opened: switch.difference.sets_opened.iter().map(name).collect(),
            took: out.now - switch.began,
            lost: switch.lost,
            late: switch.late,
            unconfirmed: silent.into_iter().collect(),
        };
        let (target, change) = (Target::Group(self.group), Change::Switched(switched.clone()));
        out.send(context.home, context.deployment.to_coordinator(ToCoordinator::Happened { target, change }));
        if let Some((_, call)) = switch.asked {
            self.answer_switch(call, Ok(switched), context, out);
        }
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

impl Switch {
    fn new(difference: Difference, consumers: BTreeSet<u32>, now: Time) -> Self {
        Self {
            difference,
            step: Step::Expecting,
            began: now,
            until: now + STEP_WITHIN,
            expecting: consumers.clone(),
            taking: consumers,
            flipping: BTreeSet::new(),
            lost: 0,
            late: 0,
            missing: BTreeSet::new(),
            asked: None,
            succeeded: Vec::new(),
            unheard: BTreeSet::new(),
            by_themselves: BTreeSet::new(),
        }
    }

    /// Returns whether programs hand their connections over by it.
    pub(super) fn is_handover(&self) -> bool {
        !self.succeeded.is_empty()
    }

    /// Returns whether not all of a handover is ordered.
    pub(super) fn is_to_be_ordered(&self) -> bool {
        self.is_handover() && self.step != Step::Closing
    }

    pub(super) fn wait_for_nobody(&mut self) {
        (self.expecting, self.flipping) = (BTreeSet::new(), BTreeSet::new());
    }

    /// Returns the wires to close and to open, without those that programs flip by themselves.
    fn ordered(&self) -> (Vec<u32>, Vec<u32>) {
        let ours = |wires: &[u32]| wires.iter().copied().filter(|wire| !self.by_themselves.contains(wire)).collect();
        (ours(&self.difference.close), ours(&self.difference.open))
    }

    /// Returns the closed wires whose end consumers wait for.
    fn ends(&self) -> Vec<u32> {
        self.difference.close.iter().copied().filter(|wire| !self.unheard.contains(wire)).collect()
    }
}
