//! Messages about deployments: each goes to its machine. The agent answers for a machine that is not there.

use super::{Agent, DEPLOYMENTS_MAX};
use crate::logic::claims::{Claims, unended};
use crate::logic::effect::Out;
use crate::logic::participant::{Participant, gone};
use crate::logic::protocol::{
    Body, ChangeOrder, ChangeReply, Deployment, Ending, Failure, FailureCause, Message, Target, ToCoordinator,
    ToParticipant, unreachable,
};
use language::plan::Plan;
use std::sync::Arc;
use std::time::Duration;

impl Agent {
    pub(super) fn deliver(&mut self, message: Message, from: &str, out: &mut Out<'_>) {
        let Message { deployment, body } = message;
        match body {
            Body::Tombstone => {}
            Body::Stopped => self.was_stopped(&deployment, from, out),
            Body::Mourned => self.mourned(&deployment, from, out),
            Body::Leaves => self.peers.absence.leaves(from),
            Body::Inquiry { number } => self.inquired(number, from, out),
            Body::Reported { number } => self.reported(number, from),
            Body::CheckIn { number } => self.checks_in(number, from),
            Body::CheckedIn { number } => self.checked_in(number, from, out),
            Body::Relay(relay) => self.relay(*relay, from, out),
            Body::Coordinator(message) => {
                if let Some(coordinator) = self.coordinators.get_mut(&deployment) {
                    return coordinator.receive(message, from, out);
                }
                self.confirm(&deployment, &message, from);
            }
            Body::Participant(message) => self.take_order(deployment, message, from, out),
        }
    }

    /// Delivers a message of this node to itself: the node has already judged its order.
    pub(super) fn deliver_own(&mut self, message: Message, out: &mut Out<'_>) {
        let host = self.identity.host.clone();
        match message {
            Message { deployment, body: Body::Participant(message) } => {
                if let Some(message) = message.plain() {
                    self.deliver_to_participant(&deployment, message, &host, out);
                }
            }
            message => self.deliver(message, &host, out),
        }
    }

    /// A participant obeys its own home alone. A participant that is gone reports that.
    pub(super) fn deliver_to_participant(
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
    pub(super) fn take_change(&mut self, deployment: &Deployment, order: ChangeOrder, out: &mut Out<'_>) {
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

    pub(super) fn answer_without_participant(
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
            let is_loose = self.past.unended.contains_key(deployment);
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
        self.stopped_by().cloned().map_or_else(gone, FailureCause::Estop)
    }

    pub(super) fn prepare(&mut self, deployment: Deployment, plan: Plan, from: &str, out: &mut Out<'_>) {
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
        if let Some(other) = self.past.unended.keys().find(|other| other.name == deployment.name) {
            return refuse(format!("programs of `{other}` {}", unended(other)), out);
        }
        if self.participants.len() >= DEPLOYMENTS_MAX {
            return refuse(format!("it already takes part in {DEPLOYMENTS_MAX} deployments"), out);
        }
        if let Some(why) = self.conflicts(&deployment, &Claims::of(&plan, host)).first() {
            return refuse(why.clone(), out);
        }
        let (place, seen) = (&self.identity, self.externals(&plan));
        let participant = Participant::prepare(deployment.clone(), Arc::new(plan), place, &self.programs, seen, out);
        self.participants.insert(deployment, participant);
    }

    /// Gives the answer that an unreachable host would give.
    pub(super) fn answer_for_lost(
        &mut self,
        lost: &str,
        deployment: &Deployment,
        message: ToParticipant,
        out: &mut Out<'_>,
    ) {
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

    pub(super) fn tell_coordinator(
        &mut self,
        deployment: &Deployment,
        message: ToCoordinator,
        from: &str,
        out: &mut Out<'_>,
    ) {
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
