//! The reports of a part of a deployment: to the home, its progress and each change; to supervisors, how members have
//! ended.

use super::{Participant, Phase};
use crate::logic::effect::Out;
use crate::logic::executer::{group_host, wants_restarts};
use crate::logic::protocol::{Change, Ending, FailureCause, Target, ToCoordinator, ToParticipant};
use crate::logic::table::counted;

impl Participant {
    pub(super) fn tell_supervisor(&self, target: Target, activation: u32, ending: Ending, out: &mut Out<'_>) {
        let ending = self.as_stopped(ending);
        match self.supervisors.get(&target).and_then(|(group, _)| group_host(&self.plan, *group)) {
            Some(host) => {
                out.send(host, self.deployment.to_participant(ToParticipant::Ended { target, activation, ending }));
            }
            None if target == Target::Group(0) => {
                out.send(&self.home, self.deployment.to_coordinator(ToCoordinator::MainEnded { ending }));
            }
            // It was taken away, and nobody waits for it.
            None => {}
        }
    }

    /// Tells the supervisor of a program that it is started again, if it wants to know.
    pub(super) fn tell_restart(&self, target: Target, cause: &FailureCause, out: &mut Out<'_>) {
        let Some((number, _)) = self.supervisors.get(&target) else { return };
        let group = self.plan.groups.get(*number as usize).filter(|group| wants_restarts(&group.supervision));
        let host = group.and_then(|group| self.plan.hosts.get(group.host as usize));
        let message = || ToParticipant::Restarted { target, cause: cause.clone() };
        host.into_iter().for_each(|host| out.send(host, self.deployment.to_participant(message())));
    }

    /// Takes note of parameters that a program was told of while the deployment runs.
    pub fn configured(&self, leaf: u32, parameters: Vec<(String, Option<String>)>, out: &mut Out<'_>) {
        if self.phase == Phase::Running {
            for (parameter, value) in parameters {
                self.happened(Target::Leaf(leaf), Change::Configured { parameter, value }, out);
            }
        }
    }

    pub(super) fn happened(&self, target: Target, change: Change, out: &mut Out<'_>) {
        out.send(&self.home, self.deployment.to_coordinator(ToCoordinator::Happened { target, change }));
    }

    pub(super) fn report_prepared(&mut self, out: &mut Out<'_>) {
        if self.phase != Phase::Preparing || !self.waiting.is_empty() {
            return;
        }
        let reasons = self.take_reasons();
        let message = if reasons.is_empty() {
            ToCoordinator::Prepared { facts: std::mem::take(&mut self.facts), machine: self.machine.clone() }
        } else {
            ToCoordinator::Refused { reasons }
        };
        out.send(&self.home, self.deployment.to_coordinator(message));
    }

    pub(super) fn report_connected(&mut self, out: &mut Out<'_>) {
        if self.phase != Phase::Connecting || !self.waiting.is_empty() {
            return;
        }
        let reasons = self.take_reasons();
        let message = if reasons.is_empty() { ToCoordinator::Connected } else { ToCoordinator::Refused { reasons } };
        out.send(&self.home, self.deployment.to_coordinator(message));
    }

    /// Returns the reasons against this deployment, and forgets them. One that several programs have is one sentence: most
    /// often they are of one executable.
    pub(super) fn take_reasons(&mut self) -> Vec<String> {
        let mut reasons = std::mem::take(&mut self.reasons);
        for (why, leaves) in std::mem::take(&mut self.refusals) {
            let leaf = leaves.first().and_then(|leaf| self.plan.leaves.get(*leaf as usize));
            let others = match leaves.len() {
                0 | 1 => String::new(),
                count => format!(" (and {})", counted(count - 1, "other")),
            };
            reasons.extend(leaf.map(|leaf| {
                let host = self.plan.hosts.get(leaf.host as usize).map_or("", String::as_str);
                format!("`{}`{others} cannot take part on `{host}`: {why}", leaf.path)
            }));
        }
        reasons
    }

    pub(super) fn report_released(&self, out: &mut Out<'_>) {
        if self.is_over() {
            let message =
                if self.unconfirmed().is_empty() { ToCoordinator::Released } else { ToCoordinator::Unconfirmed };
            out.send(&self.home, self.deployment.to_coordinator(message));
        }
    }
}
