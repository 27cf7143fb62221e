//! The deployment, the place of this host in it, and the messages that this host sends about it: to the home, every change;
//! to the host of a supervisor, how a member has ended.

use super::loss::relevant;
use crate::logic::agent::Identity;
use crate::logic::effect::{Out, ProcessId};
use crate::logic::executer::{ExecContext, group_host, leaf_host, wants_restarts};
use crate::logic::instance::Start;
use crate::logic::programs::{self, Programs};
use crate::logic::protocol::{
    ActivityInput, Change, ChangeReply, Deployment, Ending, Estop, Failure, FailureCause, Target, ToCoordinator,
    ToParticipant,
};
use comms::logic::time::Time;
use language::plan::{Expression, Leaf, LeafKind, LinkLoss, MemberKind, Notice, Plan};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// For each process, the group and slot that supervise it.
pub(super) type Supervisors = BTreeMap<Target, (u32, u32)>;

/// The deployment, and the place of this host in it.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Site {
    pub(super) deployment: Deployment,
    pub(super) plan: Arc<Plan>,
    pub(super) home: String,
    /// This host.
    pub(super) host: String,
    pub(super) machine: String,
    supervisors: Supervisors,
    /// The other hosts whose loss is one for something here.
    pub(super) relevant: BTreeSet<String>,
    /// The emergency stop that ends this part. None without an emergency stop.
    pub(super) estop: Option<Estop>,
}

impl Site {
    /// Returns the place of a host in a deployment.
    pub(super) fn new(deployment: Deployment, plan: Arc<Plan>, place: &Identity) -> Self {
        let host = place.host.as_str();
        let supervisors = supervisors(&plan);
        Self {
            relevant: relevant(&plan, &supervisors, host),
            supervisors,
            home: plan.home().unwrap_or(host).to_owned(),
            deployment,
            plan,
            host: host.to_owned(),
            machine: place.machine.clone(),
            estop: None,
        }
    }

    /// Takes the next plan, and returns the previous one. The processes of both plans are supervised until [`Site::settle`]:
    /// a program that is being replaced is supervised until it has left.
    pub(super) fn change(&mut self, plan: Plan) -> Arc<Plan> {
        let before = std::mem::replace(&mut self.plan, Arc::new(plan));
        let supervisors = supervisors(&self.plan);
        self.relevant.extend(relevant(&self.plan, &supervisors, &self.host));
        self.supervisors.extend(supervisors);
        before
    }

    /// Forgets the supervisors of the previous plan.
    pub(super) fn settle(&mut self) {
        self.supervisors = supervisors(&self.plan);
    }

    /// Returns how each program of this host is started by a plan.
    pub(super) fn starts(&self, plan: &Plan, offered: &Programs) -> Result<Vec<(u32, Start)>, Vec<String>> {
        let (mut starts, mut problems, live) = (Vec::new(), Vec::new(), plan.live_leaves());
        let is_mine = |number: &u32| live.contains(number) && leaf_host(plan, *number) == Some(&self.host);
        let started = (0_u32..).zip(&plan.leaves).filter(|(_, leaf)| leaf.external.is_none());
        for (number, leaf) in started.filter(|(number, _)| is_mine(number)) {
            let process = ProcessId { deployment: self.deployment.clone(), leaf: number };
            match offered.command(leaf) {
                Ok(command) => {
                    let order = programs::order(process, command, plan, leaf);
                    starts.push((number, Start { order, stop_within: leaf.stop_within }));
                }
                Err(why) => problems.push(why),
            }
        }
        problems.dedup();
        if problems.is_empty() { Ok(starts) } else { Err(problems) }
    }

    /// Returns the surroundings of the supervisors here.
    pub(super) fn context(&self, since_go: Duration, start: Time) -> ExecContext<'_> {
        let Self { deployment, home, plan, .. } = self;
        ExecContext { deployment, home, plan, since_go, start }
    }

    /// Returns a leaf of the plan.
    pub(super) fn leaf(&self, leaf: u32) -> Option<&Leaf> {
        self.plan.leaves.get(leaf as usize)
    }

    /// Returns the path of a leaf.
    pub(super) fn path(&self, leaf: u32) -> Option<&str> {
        self.leaf(leaf).map(|leaf| leaf.path.as_str())
    }

    /// Returns the path of a group.
    pub(super) fn group_path(&self, group: u32) -> String {
        self.plan.groups.get(group as usize).map(|group| group.path.clone()).unwrap_or_default()
    }

    /// Returns whether a program has no links.
    pub(super) fn is_plain(&self, leaf: u32) -> bool {
        self.leaf(leaf).is_none_or(|leaf| leaf.kind == LeafKind::Plain)
    }

    /// Returns the group that supervises a process, and the slot of the process there.
    pub(super) fn supervisor(&self, target: Target) -> Option<(u32, u32)> {
        self.supervisors.get(&target).copied()
    }

    /// Returns the host on which a process is supervised.
    pub(super) fn supervisor_host(&self, target: Target) -> Option<&str> {
        self.supervisor(target).and_then(|(group, _)| group_host(&self.plan, group))
    }

    /// Returns the processes that are supervised on a host.
    pub(super) fn supervised_from(&self, host: &str) -> impl Iterator<Item = Target> {
        let is_theirs = move |group: u32| group_host(&self.plan, group) == Some(host);
        self.supervisors.iter().filter(move |(_, (group, _))| is_theirs(*group)).map(|(target, _)| *target)
    }

    /// Whether some group above a process is supervised on `host`.
    pub(super) fn is_below(&self, target: Target, host: &str) -> bool {
        let above = |target: &Target| self.supervisor(*target).map(|(group, _)| Target::Group(group));
        let is_there =
            |target: Target| matches!(target, Target::Group(group) if group_host(&self.plan, group) == Some(host));
        std::iter::successors(above(&target), above).any(is_there)
    }

    /// Whether some program below a group may continue when hosts are lost.
    pub(super) fn endures(&self, group: u32) -> bool {
        let mut targets = vec![Target::Group(group)];
        while let Some(target) = targets.pop() {
            match target {
                Target::Group(group) => targets.extend(self.members(group)),
                Target::Leaf(leaf) => {
                    if self.leaf(leaf).is_some_and(|leaf| leaf.policy.link_loss != LinkLoss::Leave) {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// Returns the members that a group supervises.
    pub(super) fn members(&self, group: u32) -> impl Iterator<Item = Target> {
        let members = self.plan.groups.get(group as usize).map_or(&[][..], |group| &group.members);
        members.iter().map(|member| member.kind.into())
    }

    /// Returns whether the plan has another program in the place of this one, which is about to leave.
    pub(super) fn is_succeeded(&self, leaf: u32) -> bool {
        let Some((group, slot)) = self.supervisor(Target::Leaf(leaf)) else { return true };
        let members = self.plan.groups.get(group as usize).map_or(&[][..], |group| &group.members);
        members.get(slot as usize).is_none_or(|member| member.kind != MemberKind::Leaf(leaf))
    }

    /// Returns the activity whose ports a program has.
    pub(super) fn activity_of(&self, leaf: u32) -> Option<u32> {
        let (group, _) = self.supervisor(Target::Leaf(leaf))?;
        self.plan.ports_of(group).filter(|(_, ports)| *ports == leaf).map(|_| group)
    }

    /// Sends a message to the home.
    pub(super) fn tell_home(&self, message: ToCoordinator, out: &mut Out<'_>) {
        out.send(&self.home, self.deployment.to_coordinator(message));
    }

    /// Sends a message to the part of the deployment on a host.
    pub(super) fn tell(&self, host: &str, message: ToParticipant, out: &mut Out<'_>) {
        out.send(host, self.deployment.to_participant(message));
    }

    /// Tells the home that this host cannot take part.
    pub(super) fn refuse(&self, why: &str, out: &mut Out<'_>) {
        let reasons = vec![format!("host `{}`: {why}", self.host)];
        self.tell_home(ToCoordinator::Refused { reasons }, out);
    }

    /// Tells the home about a change of a process.
    pub(super) fn happened(&self, target: Target, change: Change, out: &mut Out<'_>) {
        self.tell_home(ToCoordinator::Happened { target, change }, out);
    }

    /// Tells the home that an activation has ended, and its supervisor how.
    pub(super) fn ended(&self, target: Target, activation: u32, ending: Ending, out: &mut Out<'_>) {
        self.happened(target, Change::Ended(ending.clone()), out);
        self.tell_supervisor(target, activation, ending, out);
    }

    /// Tells the supervisor of a process how an activation has ended.
    pub(super) fn tell_supervisor(&self, target: Target, activation: u32, ending: Ending, out: &mut Out<'_>) {
        let ending = self.as_stopped(ending);
        match self.supervisor_host(target) {
            Some(host) => {
                self.tell(host, ToParticipant::Ended { target, activation, ending }, out);
            }
            None if target == Target::Group(0) => {
                self.tell_home(ToCoordinator::MainEnded { ending }, out);
            }
            // The process was removed, and no caller waits for it.
            None => {}
        }
    }

    /// Returns an ending with the emergency stop as its cause, if there was one: users read the first cause.
    pub(super) fn as_stopped(&self, ending: Ending) -> Ending {
        match (ending, &self.estop) {
            (Ending::Aborted(Failure { origin, cause: FailureCause::NotAvailable(_), at }), Some(estop)) => {
                Ending::Aborted(Failure { origin, cause: FailureCause::Estop(estop.clone()), at })
            }
            (ending, _) => ending,
        }
    }

    /// Returns the ending of a program. A program that a change removes was stopped by its supervisor, and may leave
    /// before it has confirmed this stop.
    pub(super) fn as_removed(&self, leaf: u32, ending: Ending) -> Ending {
        let is_removed = || !self.plan.live_leaves().contains(&leaf);
        match ending {
            Ending::Aborted(Failure { cause: FailureCause::NotAvailable(_), .. }) if is_removed() => Ending::Stopped,
            Ending::Aborted(_) | Ending::Done(_) | Ending::Stopped | Ending::Unconfirmed => ending,
        }
    }

    /// Tells the supervisor of a program that it is started again, if it wants to know.
    pub(super) fn tell_restart(&self, target: Target, cause: &FailureCause, out: &mut Out<'_>) {
        let group = self.supervisor(target).and_then(|(number, _)| self.plan.groups.get(number as usize));
        let is_wanted = group.is_some_and(|group| wants_restarts(&group.supervision));
        if let Some(host) = self.supervisor_host(target).filter(|_| is_wanted) {
            self.tell(host, ToParticipant::Restarted { target, cause: cause.clone() }, out);
        }
    }

    /// Reports parameters that a program was told of while the deployment runs.
    pub(super) fn configured(&self, leaf: u32, parameters: Vec<(String, Option<String>)>, out: &mut Out<'_>) {
        for (parameter, value) in parameters {
            self.tell_parameter(leaf, &parameter, out);
            self.happened(Target::Leaf(leaf), Change::Configured { parameter, value }, out);
        }
    }

    /// Tells the activity that supervises a program of a parameter with another value, if it waits for that.
    fn tell_parameter(&self, leaf: u32, parameter: &str, out: &mut Out<'_>) {
        let target = Target::Leaf(leaf);
        let Some((number, slot)) = self.supervisor(target) else { return };
        let Some(group) = self.plan.groups.get(number as usize) else { return };
        let (Expression::Chart(chart), Some(member)) = (&group.expression, group.members.get(slot as usize)) else {
            return;
        };
        let notice = Notice::ParameterChanged { member: member.name.clone(), parameter: parameter.to_owned() };
        if let Some(host) = self.supervisor_host(target).filter(|_| chart.notice(&notice).is_some()) {
            self.tell(
                host,
                ToParticipant::Tell { group: number, told: ActivityInput::Notice(notice), by: None, call: None },
                out,
            );
        }
    }

    /// Answers a step of a change.
    pub(super) fn answer_change(&self, reply: ChangeReply, out: &mut Out<'_>) {
        self.tell_home(ToCoordinator::Change(reply), out);
    }

    /// Tells the home the reasons against the next plan here.
    pub(super) fn examined(&self, number: u32, problems: Vec<String>, out: &mut Out<'_>) {
        let reasons = problems.into_iter().map(|why| format!("host `{}`: {why}", self.host)).collect();
        self.answer_change(ChangeReply::Examined { number, reasons }, out);
    }

    /// Returns whether the plan has a leaf on this host.
    pub(super) fn is_here(&self, leaf: u32) -> bool {
        leaf_host(&self.plan, leaf) == Some(self.host.as_str())
    }
}

fn supervisors(plan: &Plan) -> Supervisors {
    let mut supervisors = Supervisors::new();
    for (group, members) in (0_u32..).zip(plan.groups.iter().map(|group| &group.members)) {
        for (slot, member) in (0_u32..).zip(members) {
            supervisors.insert(member.kind.into(), (group, slot));
        }
    }
    supervisors
}
