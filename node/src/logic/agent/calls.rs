//! The calls of command lines to an agent.

use super::{Agent, AwaitingHosts, Resumed};
use crate::logic::coordinator::{Coordinator, Requested};
use crate::logic::database::chronicle;
use crate::logic::effect::{Effect, Out, ProcessId};
use crate::logic::history::Audience;
use crate::logic::participant::Participant;
use crate::logic::protocol::{
    Answer, ChangeRequest, Delivery, Deployment, Names, Report, Request, SEVERAL, Signed, StopReply, SwitchRequest,
    TellRequest,
};
use language::plan::Plan;
use std::sync::Arc;
use std::time::Duration;

/// How many requests are remembered, so that repeating one is harmless.
const REQUESTS_MAX: usize = 10_000;
/// How long a deployment waits for hosts that this node has not seen yet.
const GATHER_WITHIN: Duration = Duration::from_secs(2);

/// The reason why a deployment that a user has stopped does not begin.
pub(super) const STOPPED: &str = "it was stopped before it ran";

impl Agent {
    pub(super) fn call(&mut self, call: u64, request: Request, signed: Option<Arc<Signed>>, out: &mut Out<'_>) {
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
                let is_known = self.forget(&deployment);
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
                self.watch_over(call, &deployment, seen, out);
            }
            Request::Revision { name } => out.answer(call, self.revision(&name)),
            Request::Change(request) => return self.change(call, *request, signed, out),
            Request::Switch(request) => return self.switch(call, &request, out),
            Request::Tell(request) => return self.tell(call, &request, out),
            Request::Estop(estop) => return self.estop(call, &estop, out),
            Request::ReleaseEstop => return self.release_estop(call, out),
            Request::StopAway(tombstone) => self.stop_away(call, *tombstone, out),
            Request::Duplicates => out.answer(call, self.duplicates()),
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
        self.past.over.iter().rev().for_each(|history| history.tell(call, out));
        self.coordinators.values_mut().for_each(|coordinator| coordinator.listen(call, stays, out));
    }

    /// Sends the reports of a deployment that is over, after the first `seen` reports.
    fn watch_over(&self, call: u64, deployment: &Deployment, seen: u64, out: &mut Out<'_>) {
        match self.past.over.iter().find(|over| over.deployment() == deployment) {
            Some(history) => history.tell_missed(call, seen, out),
            None => out.answer(call, unknown(deployment)),
        }
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

    /// Has the home of a deployment give an order to an activity.
    fn tell(&mut self, call: u64, request: &TellRequest, out: &mut Out<'_>) {
        match self.home_of(&request.name) {
            Some(home) => home.tell(call, request, out),
            None => {
                let why = format!("`{}` does not run here", request.name);
                out.answer_last(call, Answer::Delivered(Delivery::Refused(why)));
            }
        }
    }

    /// Returns the names that were given out here, including those still held by programs that could not be ended.
    fn given_names(&self) -> Names {
        let mut names = Names::default();
        self.participants.values().for_each(|participant| participant.names(&self.programs, &mut names));
        self.past.unended.iter().for_each(|(other, left)| names.devices.extend(left.claims.names(other)));
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
        } else if self.pending.requests.contains(&request) {
            Some("this request was made before".to_owned())
        } else {
            let holder = self.holder(&plan.name);
            holder.map(|how| format!("`{}` {how}; `dca stop {}` ends it", plan.name, plan.name))
        };
        if let Some(reason) = refusal {
            let refused = |call| out.answer_last(call, Answer::Report(Report::Refused { reasons: vec![reason] }));
            return one.call.map_or((), refused);
        }
        self.pending.requests.insert(request);
        if self.pending.requests.len() > REQUESTS_MAX {
            self.pending.requests.pop_first();
        }
        self.pending.awaiting.push(one);
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
        let waiting = || self.pending.awaiting.iter().find(|one| one.plan.name == name);
        let resumed = || waiting().filter(|one| one.resumed.is_some()).map(|one| &one.by);
        if let (None, Some(by)) = (begun, resumed()) {
            return Some(format!("waits to be resumed for {by}"));
        }
        begun.or_else(|| Some(waiting()?.by.as_str())).map(|by| format!("is already deployed by {by}"))
    }

    /// Ends deployments that have not begun, for this reason.
    pub(super) fn stop_gathering(&mut self, which: impl Fn(&Plan) -> bool, why: &str, out: &mut Out<'_>) {
        let stopped: Vec<AwaitingHosts> = self.pending.awaiting.extract_if(.., |one| which(&one.plan)).collect();
        for AwaitingHosts { call, resumed, .. } in &stopped {
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
        for resumed in self.pending.awaiting.iter_mut().filter_map(|one| one.resumed.as_mut()) {
            resumed.earliest.take_if(|earliest| *earliest <= out.now);
        }
        let (ready, waiting) = std::mem::take(&mut self.pending.awaiting)
            .into_iter()
            .partition::<Vec<_>, _>(|one| self.may_begin(one, out.now));
        self.pending.awaiting = waiting;
        for one in ready {
            match &one.resumed {
                Some(_) => self.resume(one, out),
                None => self.begin(one, out),
            }
        }
    }

    pub(super) fn begin(
        &mut self,
        AwaitingHosts { call, plan, by, signed, resumed, start, .. }: AwaitingHosts,
        out: &mut Out<'_>,
    ) {
        self.identity.epoch += 1;
        let deployment = Deployment { name: plan.name.clone(), epoch: self.identity.epoch };
        let record = chronicle::begun(&self.identity.host, &deployment, &plan, &by);
        out.effects.push(Effect::WriteDatabase(Box::new(record)));
        let origin = resumed.as_ref().map_or(deployment.epoch, Resumed::origin);
        let audience = Audience { watchers: call.into_iter().collect(), listeners: self.callers.listeners.clone() };
        let request = Requested { by, origin, wanted: Arc::new(plan), signed };
        let home = Coordinator::begin(deployment.clone(), request, start, audience, out);
        out.effects.extend(home.kept().map(|kept| Effect::Keep(Box::new(kept))));
        if let Some(resumed) = resumed {
            out.effects.push(Effect::Unkeep { deployment: resumed.before().clone() });
        }
        self.coordinators.insert(deployment, home);
    }

    /// Returns the programs that a deployment has here, or had.
    fn programs(&self, deployment: &Deployment) -> Option<Vec<(u32, String)>> {
        let past = || self.past.programs.iter().find(|(id, _)| id == deployment).map(|(_, programs)| programs.clone());
        self.participants.get(deployment).map(Participant::programs).or_else(past)
    }

    /// Finds the one leaf of this host that is meant: among the running deployments, otherwise in the latest one that has it.
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
        let past = self.past.programs.iter().map(|(id, programs)| meant((id, programs.clone())));
        let found = std::iter::once(running).chain(past).find(|found| !found.is_empty()).unwrap_or_default();
        match &found[..] {
            [one] => Ok(one.clone()),
            [] => Err(format!("no process `{process}` on host `{}`", self.identity.host)),
            _ => Err(format!("{SEVERAL} `{process}`; give more of the path")),
        }
    }
}

fn unknown(deployment: &Deployment) -> Answer {
    Answer::Refused(format!("`{deployment}` is not known here"))
}

fn elsewhere(call: u64, out: &mut Out<'_>) {
    out.answer(call, Answer::Refused("an agent alone does not know that".to_owned()));
}
