//! Messages of and to other nodes, and the presence of those.
//!
//! A message about a deployment goes to its machine. The agent answers for a machine that is not there, and for a node that
//! cannot be reached, so that no sender waits for ever.

use super::namesakes::OwnDeployments;
use super::orders::{Handling, Order};
use super::peers::{FromRelay, Way};
use super::promises::Promise;
use super::{Agent, DEPLOYMENTS_MAX, external};
use crate::logic::claims::{Claims, unended};
use crate::logic::effect::{Effect, Out};
use crate::logic::link::{Frame, Received};
use crate::logic::nameserver::Change;
use crate::logic::participant::{Participant, gone};
use crate::logic::protocol::{
    Body, ChangeOrder, ChangeReply, Deployment, Ending, Failure, FailureCause, Message, Namesake, Relay, Target,
    ToCoordinator, ToParticipant, unreachable,
};
use language::plan::Plan;
use std::sync::Arc;
use std::time::Duration;

impl Agent {
    /// Determines which nodes are there now, and reports the changes to everything that they concern.
    pub(super) fn look_around(&mut self, out: &mut Out<'_>) {
        self.attend(out.now);
        let (changes, round) = self.peers.names.tick(out.now);
        for change in changes {
            match &change {
                Change::Appeared { host, boot, replaces, .. } => self.appeared(host, *boot, *replaces, out),
                Change::Detour { host, boot, .. } => self.appeared(host, *boot, false, out),
                Change::Missing { host, since, .. } => {
                    self.peers.missing(host, *since);
                    let participants = self.participants.values_mut();
                    participants.for_each(|participant| participant.host_missing(host, *since, out));
                }
                Change::Lost { host } => self.host_lost(host, out),
                Change::Namesake { .. } => self.greet(out),
                Change::Refused { .. } | Change::Twice { .. } => {}
            }
            out.effects.push(Effect::Peer(change));
        }
        self.peers.tell_holders(out);
        self.peers.beat(out);
        if let Some(round) = round {
            for (via, message) in self.peers.ask(round, out) {
                self.transmit(&via, message, out);
            }
            self.greet(out);
        }
    }

    fn appeared(&mut self, host: &str, boot: u64, replaces: bool, out: &mut Out<'_>) {
        if replaces {
            // Another boot has forgotten everything: for deployments that is the loss of the host.
            self.host_lost(host, out);
        }
        self.peers.appeared(host, boot, out.now);
        self.pending.tombstones.tell(host, out);
        self.parts_back(host, out);
        self.callers.inquiries.ask_again(host, out);
    }

    /// Tells everything that runs that a host is lost.
    fn parts_lost(&mut self, host: &str, out: &mut Out<'_>) {
        self.coordinators.values_mut().for_each(|coordinator| coordinator.host_lost(host, out));
        self.participants.values_mut().for_each(|participant| participant.host_lost(host, out));
    }

    /// Tells everything that runs that a host is there again.
    fn parts_back(&mut self, host: &str, out: &mut Out<'_>) {
        self.coordinators.values_mut().for_each(|coordinator| coordinator.host_back(host, out));
        self.participants.values_mut().for_each(|participant| participant.host_back(host, out));
    }

    fn host_lost(&mut self, host: &str, out: &mut Out<'_>) {
        self.peers.lost(host, out.now);
        self.orders.forget(host);
        self.parts_lost(host, out);
    }

    /// Takes a frame of another node.
    pub(super) fn frame(&mut self, frame: Frame, out: &mut Out<'_>) {
        let from = frame.from.clone();
        let Some(Received { message, answer, is_anew }) = self.peers.receive(out.now, frame) else { return };
        if let Some(frame) = answer {
            self.send_frame(&from, frame, out);
        }
        if is_anew {
            // The other node treats this node as lost, and its parts here as ended.
            self.parts_lost(&from, out);
            self.parts_back(&from, out);
        }
        if let Some(message) = message {
            self.deliver(message, &from, out);
        }
    }

    /// Sends to another node. A message that cannot be sent is answered as a loss, so that its sender does not wait for
    /// ever. Final messages are kept for a lost node, which may not know that it is lost.
    pub(super) fn transmit(&mut self, to: &str, message: Message, out: &mut Out<'_>) {
        let is_known = self.peers.names.knows(to);
        match self.peers.send(out.now, to, message.clone()) {
            Some(frame) => {
                self.send_frame(to, frame, out);
                if is_known {
                    return;
                }
            }
            None if is_known => {
                // So many messages are unacknowledged that the node counts as lost.
                self.peers.names.lose(out.now, to);
                self.host_lost(to, out);
            }
            None => {}
        }
        if let Message { deployment, body: Body::Participant(message) } = message {
            self.answer_for_lost(to, &deployment, message, out);
        }
    }

    /// Sends a frame to another node, through a third node if necessary.
    pub(super) fn send_frame(&mut self, to: &str, frame: Frame, out: &mut Out<'_>) {
        match self.peers.way(to, frame) {
            Way::Direct(effect) => out.effects.push(effect),
            Way::Over { via, message } => self.transmit(&via, message, out),
        }
    }

    /// Takes a message that `via` has sent for another node, or has passed on.
    fn relay(&mut self, relay: Relay, via: &str, out: &mut Out<'_>) {
        match self.peers.relay(out.now, relay, via) {
            Some(FromRelay::Send { to, message }) => self.transmit(&to, message, out),
            Some(FromRelay::Frame(frame)) => self.frame(frame, out),
            None => {}
        }
    }

    /// Returns every deployment with a part here that is not about to end, and whether its home is reached.
    fn own_deployments(&self) -> OwnDeployments {
        let homes = self.coordinators.iter().filter(|(_, home)| !home.is_ending()).map(|(one, _)| (one.clone(), true));
        let parts = self.participants.iter().filter(|(_, part)| !part.is_leaving());
        parts.map(|(one, part)| (one.clone(), self.peers.reaches(part.home()))).chain(homes).collect()
    }

    /// Tells others of this name which deployments run here.
    fn greet(&mut self, out: &mut Out<'_>) {
        self.peers.greet(&self.own_deployments(), out);
    }

    /// Takes the message of another node of this name. A deployment that runs on both nodes, and that the other one
    /// keeps, is ended here.
    pub(super) fn greeted(&mut self, other: &Namesake, out: &mut Out<'_>) {
        let own = self.own_deployments();
        let Some(rival) = self.peers.greeted(other, &own, out) else { return };
        for (deployment, reaches_home) in own {
            let Some(keeps) = rival.keeps(&deployment, reaches_home, other) else { continue };
            self.peers.runs_twice(&deployment, rival, keeps, out);
            if keeps {
                continue;
            }
            let place = self.peers.ends_for(&deployment, rival);
            if let Some(coordinator) = self.coordinators.get_mut(&deployment) {
                coordinator.abort(FailureCause::Preempted(place), out);
            } else if let Some(participant) = self.participants.get_mut(&deployment) {
                participant.give_up(&format!("another node of its name keeps `{deployment}`"), out);
            }
        }
    }

    /// Takes the answer of a home: everything that waited for the answer continues.
    fn checked_in(&mut self, number: u64, from: &str, out: &mut Out<'_>) {
        let theirs = self.participants.values_mut().filter(|participant| participant.home() == from);
        let waiting = theirs.filter(|participant| participant.checks_in() == Some(number));
        waiting.for_each(|participant| participant.checked_in(out));
    }

    /// Takes the message of another node that a deployment of this home was stopped while the home was away.
    fn was_stopped(&mut self, deployment: &Deployment, from: &str, out: &mut Out<'_>) {
        let is_meant = |name: &str, origin: u64| name == deployment.name && origin <= deployment.epoch;
        let dropped = self
            .pending
            .take(|one| one.resumed.as_ref().is_some_and(|resumed| is_meant(&one.plan.name, resumed.origin)));
        // The disk forgets them in this order.
        let mut last = None;
        for resumed in dropped.into_iter().filter_map(|one| one.resumed) {
            let why = format!("it was stopped while `{}` was away, as `{from}` says", self.identity.host);
            self.not_resumed(&resumed, &why, out);
            last = Some(resumed.from);
        }
        for (own, home) in &mut self.coordinators {
            if is_meant(&own.name, home.origin()) && !home.is_ending() {
                home.abort(FailureCause::StoppedAway(from.to_owned()), out);
                last = Some(own.clone());
            }
        }
        match last {
            Some(last) => self.callers.promises.add(last, Promise::Mourned(from.to_owned(), deployment.clone())),
            None => out.send(from, Message { deployment: deployment.clone(), body: Body::Mourned }),
        }
    }

    /// Takes an order of another node. In a team, an order that starts something waits for its verdict.
    fn take_order(&mut self, order: Order, out: &mut Out<'_>) {
        if !self.identity.is_guarded {
            return self.obey(order, out);
        }
        match self.orders.take(order, out) {
            Handling::Now(order) => self.obey(order, out),
            Handling::Waits => {}
            Handling::TooMany(order) => order.refuse(&self.identity.host, "too many orders wait to be judged", out),
        }
    }

    /// Carries out an order that a user has signed, or refuses it.
    pub(super) fn judged(&mut self, number: u64, verdict: Result<(), String>, out: &mut Out<'_>) {
        let Some(order) = self.orders.judged(number, verdict.is_ok()) else { return };
        match verdict {
            Ok(()) => self.obey(order, out),
            Err(why) => order.refuse(&self.identity.host, &why, out),
        }
    }

    fn obey(&mut self, Order { deployment, from, order }: Order, out: &mut Out<'_>) {
        if let Some(order) = order.plain() {
            self.deliver_to_participant(&deployment, order, &from, out);
        }
    }

    fn deliver(&mut self, message: Message, from: &str, out: &mut Out<'_>) {
        let Message { deployment, body } = message;
        match body {
            Body::Tombstone => {}
            Body::Stopped => self.was_stopped(&deployment, from, out),
            Body::Mourned => self.pending.tombstones.mourned(&deployment, from, out),
            Body::Leaves => self.peers.absence.leaves(from),
            Body::Inquiry { number } => self.callers.inquiries.inquired(number, from, out),
            Body::Reported { number } => self.callers.inquiries.answered(number, from),
            Body::CheckIn { number } => self.callers.check_ins.come(&self.peers.names, number, from),
            Body::CheckedIn { number } => self.checked_in(number, from, out),
            Body::Relay(relay) => self.relay(*relay, from, out),
            Body::Coordinator(message) => {
                if let Some(coordinator) = self.coordinators.get_mut(&deployment) {
                    return coordinator.receive(message, from, out);
                }
                self.peers.confirm(&deployment, &message, from);
            }
            Body::Participant(order) => self.take_order(Order { deployment, from: from.to_owned(), order }, out),
        }
    }

    /// Delivers a message of this node to itself: the node has already judged its order.
    pub(super) fn deliver_own(&mut self, message: Message, out: &mut Out<'_>) {
        let host = self.identity.host.clone();
        match message {
            Message { deployment, body: Body::Participant(order) } => {
                self.obey(Order { deployment, from: host, order }, out);
            }
            message => self.deliver(message, &host, out),
        }
    }

    /// A participant obeys its own home alone. A participant that is gone reports that.
    fn deliver_to_participant(
        &mut self,
        deployment: &Deployment,
        message: ToParticipant,
        from: &str,
        out: &mut Out<'_>,
    ) {
        let Some(participant) = self.participants.get_mut(deployment) else {
            return self.answer_without_participant(deployment, message, from, out);
        };
        let is_home = participant.home() == from;
        if let ToParticipant::Moved { facts } = &message
            && let Some(coordinator) = self.coordinators.get_mut(deployment)
        {
            coordinator.moved(facts, from, out);
        }
        if matches!(message, ToParticipant::Prepare { .. } | ToParticipant::Rejoin { .. }) {
            let reason = format!("host `{}`: `{deployment}` is already there", self.identity.host);
            out.send(from, deployment.to_coordinator(ToCoordinator::Refused { reasons: vec![reason] }));
        } else if message == ToParticipant::Release && !is_home {
            out.send(from, deployment.to_coordinator(ToCoordinator::Released));
        } else if let ToParticipant::Change(order) = message {
            if is_home {
                self.take_change(deployment, order, out);
            }
        } else if participant.is_rejoining() && is_for_members(&message) {
            answer_of_absent(message, self.cause_of_absence())
                .into_iter()
                .for_each(|answer| out.send(from, deployment.to_participant(answer)));
        } else if is_home || !is_for_home(&message) {
            participant.receive(message, from, out);
        }
    }

    /// Carries out a step of a change. Devices that other deployments hold are not taken.
    fn take_change(&mut self, deployment: &Deployment, order: ChangeOrder, out: &mut Out<'_>) {
        if let Some(reply) = self.against_change(deployment, &order) {
            let home = self.participants.get(deployment).map(Participant::home);
            home.into_iter()
                .for_each(|home| out.send(home, deployment.to_coordinator(ToCoordinator::Change(reply.clone()))));
            return;
        }
        if let Some(participant) = self.participants.get_mut(deployment) {
            participant.take_change(order, &self.programs, out);
        }
    }

    /// Returns the reply to a step of a change that cannot be taken, if that is the case. A device that was free when
    /// it was examined may be held since.
    fn against_change(&self, deployment: &Deployment, order: &ChangeOrder) -> Option<ChangeReply> {
        let host = &self.identity.host;
        match order {
            ChangeOrder::Examine { number, plan } => {
                let mut reasons = self.conflicts(deployment, &Claims::of(plan, host));
                if self.run.leaving {
                    reasons.push(format!("host `{host}`: its node is leaving"));
                }
                (!reasons.is_empty()).then_some(ChangeReply::Examined { number: *number, reasons })
            }
            ChangeOrder::Apply { number, plan, .. } => {
                let reason = self.conflicts(deployment, &Claims::of(plan, host)).into_iter().next()?;
                Some(ChangeReply::Failed { number: *number, reason })
            }
            ChangeOrder::Link { .. }
            | ChangeOrder::LinkAlso { .. }
            | ChangeOrder::Adopt { .. }
            | ChangeOrder::Settle { .. } => None,
        }
    }

    fn answer_without_participant(
        &mut self,
        deployment: &Deployment,
        message: ToParticipant,
        from: &str,
        out: &mut Out<'_>,
    ) {
        if let ToParticipant::Prepare { plan } = message {
            self.prepare(deployment.clone(), plan, from, out);
        } else if let ToParticipant::Rejoin { plan, number, since_go } = message {
            self.prepare(deployment.clone(), plan, from, out);
            if let Some(participant) = self.participants.get_mut(deployment) {
                participant.rejoins(number, out.now, since_go);
            }
        } else if message == ToParticipant::Release {
            let is_loose = self.past.is_unended(deployment);
            out.send(
                from,
                deployment.to_coordinator(if is_loose { ToCoordinator::Unconfirmed } else { ToCoordinator::Released }),
            );
        } else if let ToParticipant::Change(order) = message {
            let reason = format!("host `{}`: its node has left the deployment", self.identity.host);
            out.send(from, deployment.to_coordinator(ToCoordinator::Change(order.failed(reason))));
        } else {
            let answer = answer_of_absent(message, self.cause_of_absence());
            answer.into_iter().for_each(|answer| out.send(from, deployment.to_participant(answer)));
        }
    }

    /// Returns why nothing is left here of a deployment that once had a part here.
    fn cause_of_absence(&self) -> FailureCause {
        self.stopped.by().cloned().map_or_else(gone, FailureCause::Estop)
    }

    fn prepare(&mut self, deployment: Deployment, plan: Plan, from: &str, out: &mut Out<'_>) {
        let host = &self.identity.host;
        let refuse = |why: String, out: &mut Out<'_>| {
            out.send(
                from,
                deployment.to_coordinator(ToCoordinator::Refused { reasons: vec![format!("host `{host}`: {why}")] }),
            );
        };
        if self.run.leaving {
            return refuse("its node is leaving".into(), out);
        }
        if let Some(why) = self.obstacle(out.now) {
            return refuse(why, out);
        }
        if let Err(why) = plan.validate() {
            return refuse(format!("the plan is not sound: {why}"), out);
        }
        if let Some(other) = self.participants.keys().find(|other| other.name == deployment.name) {
            return refuse(format!("`{}` is already there (epoch {})", other.name, other.epoch), out);
        }
        if let Some(other) = self.past.unended_of(&deployment.name) {
            return refuse(format!("programs of `{other}` {}", unended(other)), out);
        }
        if self.participants.len() >= DEPLOYMENTS_MAX {
            return refuse(format!("it already takes part in {DEPLOYMENTS_MAX} deployments"), out);
        }
        if let Some(why) = self.conflicts(&deployment, &Claims::of(&plan, host)).first() {
            return refuse(why.clone(), out);
        }
        let seen = external::used_by(&plan, host, &self.participants, &self.programs);
        let place = &self.identity;
        let participant = Participant::prepare(deployment.clone(), Arc::new(plan), place, &self.programs, seen, out);
        self.participants.insert(deployment, participant);
    }

    /// Gives the answer that an unreachable host would give.
    fn answer_for_lost(&mut self, lost: &str, deployment: &Deployment, message: ToParticipant, out: &mut Out<'_>) {
        let Some(message) = message.plain() else { return };
        if matches!(message, ToParticipant::Prepare { .. } | ToParticipant::Rejoin { .. }) {
            self.tell_coordinator(deployment, ToCoordinator::Refused { reasons: vec![unreachable(lost)] }, lost, out);
        } else if message == ToParticipant::Release {
            // A host that never took part has nothing to release; a lost host is reported as unconfirmed.
            self.tell_coordinator(deployment, ToCoordinator::Released, lost, out);
        } else if let ToParticipant::Change(order) = message {
            let reply = order.failed(format!("host `{lost}` cannot be reached"));
            self.tell_coordinator(deployment, ToCoordinator::Change(reply), lost, out);
        } else {
            let answer = answer_of_absent(message, FailureCause::HostLost(lost.to_owned()));
            let here = self.identity.host.clone();
            answer.into_iter().for_each(|answer| out.send(&here, deployment.to_participant(answer)));
        }
    }

    fn tell_coordinator(&mut self, deployment: &Deployment, message: ToCoordinator, from: &str, out: &mut Out<'_>) {
        if let Some(coordinator) = self.coordinators.get_mut(deployment) {
            coordinator.receive(message, from, out);
        }
    }
}

/// Whether only the home may send this message.
fn is_for_home(message: &ToParticipant) -> bool {
    use ToParticipant as To;
    matches!(message, To::Connect { .. } | To::Go | To::GoAt { .. } | To::ReadClock { .. })
}

/// Whether a message gives orders to processes. A host that rejoins does not have its processes yet.
fn is_for_members(message: &ToParticipant) -> bool {
    matches!(message, ToParticipant::Activate { .. } | ToParticipant::Stop { .. })
}

/// Returns the answer that an absent part of a deployment would give its supervisor, so that the supervisor does not
/// wait for ever.
fn answer_of_absent(message: ToParticipant, cause: FailureCause) -> Option<ToParticipant> {
    match message {
        ToParticipant::Activate { target, activation, .. } => {
            // The supervisor knows the path and the time.
            let failure = Failure { origin: String::new(), cause, at: Duration::ZERO };
            Some(ToParticipant::Ended { target, activation, ending: Ending::Aborted(failure) })
        }
        ToParticipant::Stop { target, activation } => {
            let ending = if let FailureCause::HostLost(host) = cause {
                let cause = FailureCause::HostLostStopping(host);
                Ending::Aborted(Failure { origin: String::new(), cause, at: Duration::ZERO })
            } else {
                Ending::Unconfirmed
            };
            Some(ToParticipant::Ended { target, activation, ending })
        }
        ToParticipant::Switch { group, generation, .. } | ToParticipant::Flip { group, generation, .. } => {
            Some(ToParticipant::Switched { group, generation })
        }
        ToParticipant::Succeed { leaf, activation, .. } => {
            let failure = Failure { origin: String::new(), cause, at: Duration::ZERO };
            let (target, ending) = (Target::Leaf(leaf), Ending::Aborted(failure));
            Some(ToParticipant::Ended { target, activation, ending })
        }
        ToParticipant::Expect { group, leaf, expect } | ToParticipant::ExpectAnd { group, leaf, expect, .. } => {
            let (generation, missing) = (expect.generation, Vec::new());
            Some(ToParticipant::Taken { group, leaf, generation, lost: 0, late: 0, missing })
        }
        ToParticipant::Prepare { .. }
        | ToParticipant::Connect { .. }
        | ToParticipant::Go
        | ToParticipant::GoAt { .. }
        | ToParticipant::ReadClock { .. }
        | ToParticipant::Release
        | ToParticipant::Ended { .. }
        | ToParticipant::Switched { .. }
        | ToParticipant::Moved { .. }
        | ToParticipant::Loose { .. }
        | ToParticipant::Cleared { .. }
        | ToParticipant::Restarted { .. }
        | ToParticipant::Renew { .. }
        | ToParticipant::Rejoin { .. }
        | ToParticipant::Reopen { .. }
        | ToParticipant::Ordered(_)
        | ToParticipant::Expecting { .. }
        | ToParticipant::Taken { .. }
        | ToParticipant::SwitchSets { .. }
        | ToParticipant::Tell { .. }
        | ToParticipant::Repeat { .. }
        | ToParticipant::Succeeding { .. }
        | ToParticipant::Change(_) => None,
    }
}
