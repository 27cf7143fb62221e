//! The calls of command lines to an agent, and the begin of deployments.
//!
//! A deployment that a user wants waits for hosts that this node has not seen yet. A deployment that is resumed
//! after a reboot waits longer, and in a team also for permission.

use super::Agent;
use super::boot::{Interrupted, Resumed};
use super::orders::signed_request;
use super::pending::AwaitingHosts;
use super::promises::Promise;
use crate::logic::coordinator::{Coordinator, Requested};
use crate::logic::database::chronicle;
use crate::logic::effect::{Effect, Out, ProcessId};
use crate::logic::history::{Audience, History};
use crate::logic::meant::{MeantActivity, meant};
use crate::logic::participant::Participant;
use crate::logic::protocol::{
    Answer, Before, ChangeRequest, Delivery, Deployment, Ending, Estop, Failure, FailureCause, Kept, Names, Report,
    Request, SEVERAL, Signed, StopReply, SwitchRequest, TellRequest, Tombstone,
};
use language::plan::Plan;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// How long a deployment waits for hosts that this node has not seen yet.
const GATHER_WITHIN: Duration = Duration::from_secs(2);

/// The reason why a deployment that a user has stopped does not begin.
pub(super) const STOPPED: &str = "it was stopped before it ran";

impl Agent {
    /// Takes a call. A request that a user has signed is passed on to the nodes that carry it out.
    pub(super) fn take_call(&mut self, call: u64, request: Request, out: &mut Out<'_>) {
        let Request::Signed(signed) = request else { return self.call(call, request, None, out) };
        match signed_request(&signed) {
            Ok(request) => self.call(call, request, Some(Arc::new(*signed)), out),
            Err(why) => out.answer_last(call, Answer::Refused(why)),
        }
    }

    fn call(&mut self, call: u64, request: Request, signed: Option<Arc<Signed>>, out: &mut Out<'_>) {
        match request {
            Request::Deploy { request, plan, by, start } => {
                let (until, call) = (out.now + GATHER_WITHIN, Some(call));
                let one = AwaitingHosts { until, call, plan, by, signed, resumed: None, start };
                return self.deploy(request, one, out);
            }
            Request::Status => out.answer(call, Answer::Status(self.status(out.now))),
            Request::Absent => out.answer(call, Answer::Absent(self.absent(out.now))),
            Request::Plan { deployment } => {
                let plan = self.participants.get(&deployment).map(|participant| Box::new(participant.plan().clone()));
                out.answer(call, plan.map_or_else(|| unknown(&deployment), Answer::Plan));
            }
            Request::Locations { deployment } => {
                let locations = self.participants.get(&deployment).map(Participant::locations);
                out.answer(call, locations.map_or_else(|| unknown(&deployment), Answer::Locations));
            }
            Request::Forget { deployment } => {
                // Either may know of it.
                let is_open = self.peers.absence.forget(&deployment);
                let is_known = self.past.forget(&deployment) || is_open;
                out.answer(call, Answer::Stop(if is_known { StopReply::Stopped } else { StopReply::Unknown }));
            }
            Request::Stop { name } => {
                if let Some(home) = self.home_of(&name) {
                    return home.stop(Some(call), out);
                }
                if self.stop_waiting(call, &name, out) {
                    return;
                }
                out.answer(call, Answer::Stop(StopReply::Unknown));
            }
            Request::Watch { deployment, seen } => {
                if let Some(coordinator) = self.coordinators.get_mut(&deployment) {
                    return coordinator.watch(call, seen, out);
                }
                self.past.watch(call, &deployment, seen, out);
            }
            Request::Revision { name } => out.answer(call, self.revision(&name)),
            Request::Change(request) => return self.change(call, *request, signed, out),
            Request::Switch(request) => return self.switch(call, &request, out),
            Request::Tell(request) => return self.tell(call, &request, out),
            Request::Estop(estop) => return self.estop(call, &estop, out),
            Request::ReleaseEstop => return self.stopped.release(call, out),
            Request::StopAway(tombstone) => self.stop_away(call, *tombstone, out),
            Request::Duplicates => {
                let place = format!("process {} on the host of the node that says so", self.identity.pid);
                out.answer(call, Answer::Duplicates(self.peers.names.duplicates(&place)));
            }
            Request::Names => out.answer(call, Answer::Names(self.given_names())),
            Request::Events { follow: true } => {
                self.tell_events(call, true, out);
                // The empty list marks that these were all events up to now.
                out.answer(call, Answer::Events(Vec::new()));
                return self.callers.listeners.push(call);
            }
            Request::Events { follow: false } => return self.inquire(call, out),
            Request::Logs { deployment, process, follow } => match self.find(deployment.as_deref(), &process) {
                Ok(process) => return out.effects.push(Effect::Tail { call, process, follow }),
                Err(why) => out.answer(call, Answer::Refused(why)),
            },
            Request::Parameters => out.answer(call, self.parameters()),
            Request::Output { deployment } => match self.programs(&deployment) {
                Some(programs) => return out.effects.push(Effect::TailAll { call, deployment, programs }),
                None => out.answer(call, unknown(&deployment)),
            },
            // Other parts of a node answer these requests; an agent alone has no database and no team.
            Request::Unlinked => out.answer(call, Answer::Unlinked(Vec::new())),
            Request::Credentials => out.answer(call, Answer::Credentials(Vec::new())),
            Request::Clock | Request::Team | Request::Signed(_) | Request::Revoke { .. } => elsewhere(call, out),
            Request::Revocations(_) | Request::Database(_) | Request::Here { .. } => elsewhere(call, out),
            Request::RenewUser { .. } | Request::Call(_) => elsewhere(call, out),
        }
        out.effects.push(Effect::EndAnswers { call });
    }

    /// Reports every event of the deployments that have their home here; a listener that stays also gets the future events.
    pub(super) fn tell_events(&mut self, call: u64, stays: bool, out: &mut Out<'_>) {
        self.past.tell(call, out);
        self.coordinators.values_mut().for_each(|coordinator| coordinator.listen(call, stays, out));
    }

    /// Returns the home of the deployment of a name, if it is here.
    fn home_of(&mut self, name: &str) -> Option<&mut Coordinator> {
        self.coordinators.iter_mut().find(|(deployment, _)| deployment.name == name).map(|(_, home)| home)
    }

    fn parameters(&self) -> Answer {
        Answer::Parameters(self.participants.values().flat_map(|one| one.parameters(&self.programs)).collect())
    }

    fn revision(&mut self, name: &str) -> Answer {
        let revision = self.home_of(name).map(|home| Answer::Revision(Box::new(home.revision())));
        revision.unwrap_or_else(|| Answer::Refused(format!("`{name}` does not run here")))
    }

    /// Has the home of a deployment switch a process to other connection sets.
    fn switch(&mut self, call: u64, request: &SwitchRequest, out: &mut Out<'_>) {
        match self.home_of(&request.name) {
            Some(home) => home.switch(call, request, out),
            None => {
                let why = format!("`{}` does not run here", request.name);
                out.answer_last(call, Answer::Switched(Err(why)));
            }
        }
    }

    /// Has the home of a deployment give an order to an activity. While the home is away, an activity on this host takes the
    /// order itself.
    fn tell(&mut self, call: u64, request: &TellRequest, out: &mut Out<'_>) {
        if let Some(home) = self.home_of(&request.name) {
            return home.tell(call, request, out);
        }
        let mut parts = self.participants.iter_mut().filter(|(deployment, _)| deployment.name == request.name);
        let delivery = match parts.next() {
            Some((_, part)) if self.peers.is_away(part.home()) => alone(&self.identity.host, part, request, out),
            Some((_, part)) => {
                Delivery::Refused(format!("`{}`, the home of `{}`, gives orders", part.home(), request.name))
            }
            None => Delivery::Refused(format!("`{}` does not run here", request.name)),
        };
        out.answer_last(call, Answer::Delivered(delivery));
    }

    /// Returns the names that were given out here, including those still held by programs that could not be ended.
    fn given_names(&self) -> Names {
        let mut names = Names::default();
        self.participants.values().for_each(|participant| participant.names(&self.programs, &mut names));
        self.past.names(&mut names);
        names
    }

    /// Returns parameters that the database gives to an instance, as its program gets them: quantities in SI units.
    pub fn in_si(&self, deployment: &Deployment, path: &str, stored: Vec<(String, String)>) -> Vec<(String, String)> {
        match self.participants.get(deployment) {
            Some(participant) => participant.in_si(&self.programs, path, stored),
            None => stored,
        }
    }

    /// Returns the ends of a wire of a deployment, for users.
    pub fn wire(&self, deployment: &Deployment, number: u32) -> Option<String> {
        let plan = self.participants.get(deployment)?.plan();
        plan.wires.get(number as usize).map(|wire| plan.ends(wire))
    }

    fn deploy(&mut self, request: u64, one: AwaitingHosts, out: &mut Out<'_>) {
        let plan = &one.plan;
        let home_is_here = plan.home() == Some(&self.identity.host);
        let refusal = if self.run.leaving {
            Some("this node is leaving".to_owned())
        } else if let Some(why) = self.obstacle(out.now) {
            Some(why)
        } else if let Err(why) = plan.validate() {
            Some(format!("the plan is not sound: {why}"))
        } else if plan.live_leaves().len() < plan.leaves.len() {
            Some("the plan is not sound: a process is a member of no group".to_owned())
        } else if !home_is_here {
            Some(format!("`main` does not run on `{}`", self.identity.host))
        } else if self.pending.is_known(request) {
            Some("this request was made before".to_owned())
        } else {
            let holder = self.holder(&plan.name);
            holder.map(|how| format!("`{}` {how}; `dca stop {}` ends it", plan.name, plan.name))
        };
        if let Some(reason) = refusal {
            let refused = |call| out.answer_last(call, Answer::Report(Report::Refused { reasons: vec![reason] }));
            return one.call.map_or((), refused);
        }
        self.pending.note(request);
        self.pending.wait(one);
        self.begin_gathered(out);
    }

    fn change(&mut self, call: u64, request: ChangeRequest, signed: Option<Arc<Signed>>, out: &mut Out<'_>) {
        let deployment = Deployment { name: request.name.clone(), epoch: request.epoch };
        let obstacle = if self.run.leaving { Some("this node is leaving".to_owned()) } else { self.obstacle(out.now) };
        match (obstacle, self.coordinators.get_mut(&deployment)) {
            (None, Some(home)) => home.change(call, request, signed, out),
            (obstacle, _) => {
                let reasons = vec![obstacle.unwrap_or_else(|| format!("`{deployment}` does not run here"))];
                out.answer_last(call, Answer::Report(Report::Unchanged { by: request.by, reasons }));
            }
        }
    }

    /// Returns the state of a deployment of this name that has not ended, for a person.
    fn holder(&self, name: &str) -> Option<String> {
        let begun = self.coordinators.iter().find(|(other, _)| other.name == name).map(|(_, home)| home.begun_by());
        let waiting = || self.pending.find(name);
        let resumed = || waiting().filter(|one| one.resumed.is_some()).map(|one| &one.by);
        if let (None, Some(by)) = (begun, resumed()) {
            return Some(format!("waits to be resumed for {by}"));
        }
        begun.or_else(|| Some(waiting()?.by.as_str())).map(|by| format!("is already deployed by {by}"))
    }

    /// Ends deployments that have not begun, for this reason.
    pub(super) fn stop_gathering(&mut self, which: impl Fn(&Plan) -> bool, why: &str, out: &mut Out<'_>) {
        for AwaitingHosts { call, resumed, .. } in &self.pending.take(|one| which(&one.plan)) {
            if let Some(call) = *call {
                out.answer_last(call, Answer::Report(Report::Refused { reasons: vec![why.to_owned()] }));
            }
            // A node that leaves may be ended by a reboot.
            if let Some(resumed) = resumed.as_ref().filter(|_| !self.run.leaving) {
                self.not_resumed(resumed, why, out);
            }
        }
    }

    /// Begins the deployments whose hosts are all there, or whose time of waiting is over.
    pub(super) fn begin_gathered(&mut self, out: &mut Out<'_>) {
        for one in self.pending.take_ready(&self.peers, out.now) {
            match &one.resumed {
                Some(_) => self.resume(one, out),
                None => self.begin(one, out),
            }
        }
    }

    fn begin(
        &mut self,
        AwaitingHosts { call, plan, by, signed, resumed, start, .. }: AwaitingHosts,
        out: &mut Out<'_>,
    ) {
        self.identity.epoch += 1;
        let deployment = Deployment { name: plan.name.clone(), epoch: self.identity.epoch };
        let record = chronicle::begun(&self.identity.host, &deployment, &plan, &by);
        out.effects.push(Effect::WriteDatabase(Box::new(record)));
        let origin = resumed.as_ref().map_or(deployment.epoch, |resumed| resumed.origin);
        let audience = Audience { watchers: call.into_iter().collect(), listeners: self.callers.listeners.clone() };
        let request = Requested { by, origin, wanted: Arc::new(plan), signed };
        let home = Coordinator::begin(deployment.clone(), request, start, audience, out);
        out.effects.extend(home.kept().map(|kept| Effect::Keep(Box::new(kept))));
        if let Some(resumed) = resumed {
            out.effects.push(Effect::Unkeep { deployment: resumed.from });
        }
        self.coordinators.insert(deployment, home);
    }

    /// Asks every host of the deployments whose home is here, and answers the call once they have answered.
    fn inquire(&mut self, call: u64, out: &mut Out<'_>) {
        let all = self.coordinators.values().flat_map(Coordinator::taking_part);
        let hosts: BTreeSet<String> = all.filter(|host| **host != self.identity.host).cloned().collect();
        self.callers.inquiries.ask(call, hosts, &self.peers.names, out);
    }

    /// Ends everything on this host; the call is answered when nothing of it runs.
    fn estop(&mut self, call: u64, estop: &Estop, out: &mut Out<'_>) {
        let estop = estop.bounded();
        let why = format!("it {}", FailureCause::Estop(estop.clone()));
        self.stop_gathering(|_| true, &why, out);
        for participant in self.participants.values_mut() {
            participant.stop_at_once(&estop, out);
        }
        for coordinator in self.coordinators.values_mut() {
            coordinator.abort(FailureCause::Estop(estop.clone()), out);
        }
        self.stopped.stop(call, estop, out);
    }

    /// Stops a deployment of this name that has not begun, and answers when it is certain that it never begins. Returns whether
    /// there is such a deployment.
    fn stop_waiting(&mut self, call: u64, name: &str, out: &mut Out<'_>) -> bool {
        let Some(one) = self.pending.find(name) else { return false };
        let before = one.resumed.as_ref().map(|resumed| resumed.from.clone());
        self.stop_gathering(|plan| plan.name == name, STOPPED, out);
        if let Some(before) = before {
            self.callers.promises.add(before, Promise::Stopped(call));
        } else {
            out.answer_last(call, Answer::Stop(StopReply::Stopped));
        }
        true
    }

    /// Keeps a tombstone for a home that does not answer.
    fn stop_away(&mut self, call: u64, tombstone: Tombstone, out: &mut Out<'_>) {
        let Tombstone { home, deployment } = &tombstone;
        let refusal = if *home == self.identity.host {
            Some(format!("`{}` has its home here: `dca stop {}` ends it", deployment.name, deployment.name))
        } else if self.peers.names.reaches(home) {
            Some(format!("`{home}` answers: `dca stop {}` ends it there", deployment.name))
        } else {
            None
        };
        if let Some(why) = refusal {
            return out.answer(call, Answer::Refused(why));
        }
        self.pending.tombstones.add(tombstone, out);
        out.answer(call, Answer::Stop(StopReply::Stopped));
    }

    /// Reports the end of the deployments that ran before this node, and waits with those that are resumed.
    pub(super) fn look_back(&mut self, out: &mut Out<'_>) {
        for Before { kept, was_rebooted } in self.pending.take_earlier() {
            let Kept { deployment, origin, by, hosts, has_ended, resume, .. } = kept;
            if !has_ended {
                let cause = if was_rebooted { FailureCause::Rebooted } else { FailureCause::Restarted };
                tracing::warn!(%deployment, %cause, "a deployment has not come to its end");
                self.tell_over(&deployment, hosts, cause, out);
            }
            let is_known = self.pending.find(&deployment.name).is_some();
            match resume.filter(|_| was_rebooted && !is_known) {
                Some((plan, signed)) => {
                    let interrupted = Interrupted { from: deployment, origin, by, plan, signed };
                    self.pending.wait(interrupted.wait(out.now));
                }
                None => out.effects.push(Effect::Unkeep { deployment }),
            }
        }
    }

    /// Keeps the last report of a deployment that no node has seen end.
    fn tell_over(&mut self, deployment: &Deployment, hosts: Vec<String>, cause: FailureCause, out: &mut Out<'_>) {
        let unconfirmed = hosts.iter().filter(|host| **host != self.identity.host).cloned().collect();
        let mut history = History::new(deployment.clone(), hosts);
        let failure = Failure { origin: "main".to_owned(), cause, at: Duration::ZERO };
        let (ending, at) = (Ending::Aborted(failure), Duration::ZERO);
        history.report(Report::Finished { ending, at, unconfirmed }, 0, &Audience::default(), out);
        let record = chronicle::ended(&self.identity.host, &history);
        out.effects.extend(record.map(|record| Effect::WriteDatabase(Box::new(record))));
        self.past.remember(history);
    }

    /// Resumes a deployment, if nothing is against it and, in a team, its signer still has permission.
    fn resume(&mut self, mut one: AwaitingHosts, out: &mut Out<'_>) {
        let obstacle = self.obstacle(out.now);
        let Some(resumed) = &mut one.resumed else { return };
        if let Some(why) = obstacle {
            return self.not_resumed(resumed, &why, out);
        }
        if !self.identity.is_guarded || resumed.is_permitted() {
            return self.begin(one, out);
        }
        out.effects.extend(resumed.ask(&one.signed));
        self.pending.wait(one);
    }

    /// Takes the verdict about a deployment that is to be resumed.
    pub(super) fn resumable(&mut self, deployment: &Deployment, verdict: Result<(), String>, out: &mut Out<'_>) {
        let Some(mut one) = self.pending.take_resumed(deployment) else { return };
        let Some(resumed) = &mut one.resumed else { return };
        match verdict {
            Ok(()) => {
                resumed.permit();
                self.resume(one, out);
            }
            Err(why) => self.not_resumed(resumed, &why, out),
        }
    }

    /// Reports why a deployment is not resumed after all.
    pub(super) fn not_resumed(&mut self, resumed: &Resumed, why: &str, out: &mut Out<'_>) {
        let deployment = resumed.from.clone();
        tracing::warn!(%deployment, why, "a deployment is not resumed");
        if let Some(history) = self.past.history_or_new(&deployment, &self.identity.host) {
            let reasons = vec![format!("the deployment is not resumed: {why}")];
            let audience = Audience { listeners: self.callers.listeners.clone(), ..Audience::default() };
            history.report(Report::Refused { reasons }, 0, &audience, out);
        }
        out.effects.push(Effect::Unkeep { deployment });
    }

    /// Returns the programs that a deployment has here, or had.
    fn programs(&self, deployment: &Deployment) -> Option<Vec<(u32, String)>> {
        let past = || self.past.programs_of(deployment).cloned();
        self.participants.get(deployment).map(Participant::programs).or_else(past)
    }

    /// Finds the leaf of this host that the name means, among the running deployments, otherwise in the latest deployment that has it.
    fn find(&self, deployment: Option<&str>, process: &str) -> Result<ProcessId, String> {
        let end = format!("/{process}");
        let meant = |(id, programs): (&Deployment, Vec<(u32, String)>)| {
            let is_named = deployment.is_none_or(|name| name == id.name || name == id.to_string());
            let programs =
                programs.into_iter().filter(|(_, path)| is_named && (path == process || path.ends_with(&end)));
            programs.map(|(leaf, _)| ProcessId { deployment: id.clone(), leaf }).collect::<Vec<_>>()
        };
        let running: Vec<_> =
            self.participants.iter().flat_map(|(id, participant)| meant((id, participant.programs()))).collect();
        let past = self.past.programs().map(|(id, programs)| meant((id, programs.clone())));
        let found = std::iter::once(running).chain(past).find(|found| !found.is_empty()).unwrap_or_default();
        match &found[..] {
            [one] => Ok(one.clone()),
            [] => Err(format!("no process `{process}` on host `{}`", self.identity.host)),
            _ => Err(format!("{SEVERAL} `{process}`; give more of the path")),
        }
    }
}

/// Gives an order to an activity on this host, whose home is away.
fn alone(host: &str, part: &mut Participant, request: &TellRequest, out: &mut Out<'_>) -> Delivery {
    match meant(part.plan(), request) {
        Ok(MeantActivity { path, host: other, .. }) if other != host => {
            Delivery::Unconfirmed(format!("`{path}` is on `{other}`, and the home of `{}` is away", request.name))
        }
        Ok(MeantActivity { group, path, .. }) => match part.give(group, &request.order, Some(&request.by), out) {
            Ok(taken) => Delivery::Taken { path, taken },
            Err(why) => Delivery::Refused(why),
        },
        Err(why) => Delivery::Refused(why),
    }
}

fn unknown(deployment: &Deployment) -> Answer {
    Answer::Refused(format!("`{deployment}` is not known here"))
}

fn elsewhere(call: u64, out: &mut Out<'_>) {
    out.answer(call, Answer::Refused("an agent alone does not know that".to_owned()));
}
