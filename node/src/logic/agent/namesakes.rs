//! Another node of this one's name: two robots that were set up alike, or two parts of a network that meet after a cut.
//!
//! Neither node takes on anything while both are there, since it would be unclear which of them is meant. Each tells
//! the other once a second which deployments it runs. If a deployment runs on both, one instance is kept: the one of
//! the higher epoch; within one epoch, the one whose home is reachable from its node; otherwise the one on the node
//! that was there first. The other instance is ended at once, at its home as preempted.

use super::Agent;
use crate::logic::effect::{Effect, Out};
use crate::logic::nameserver::Change;
use crate::logic::protocol::{Answer, Deployment, FailureCause, Namesake};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The agreements between this node and others of its name, while those are there.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Rivalry {
    /// The deployments that were ended here, each with the boot at which it continues. Repeated until the other node
    /// leaves: a message may be lost, or arrive before the other node knows of this one.
    ended: BTreeMap<Deployment, u64>,
    /// The deployments that were reported to run on both nodes, each with the boot of the other node.
    reported: BTreeSet<(u64, Deployment)>,
}

impl Agent {
    /// Returns why this node takes nothing on, if another node has its name.
    pub(super) fn namesake(&self) -> Option<String> {
        let host = &self.identity.host;
        if let Some(place) = self.peers.names.elder() {
            return Some(format!(
                "another node called `{host}` was there first: {place}; give this one another name with `dca-node --name`"
            ));
        }
        let place = self.peers.names.duplicates("").into_iter().find(|one| one.host == *host)?.second;
        Some(format!(
            "a second node is called `{host}`: {place}; nothing begins under this name before that one has another, with \
             `dca-node --name`"
        ))
    }

    /// Tells others of this name which deployments run here.
    pub(super) fn greet(&mut self, out: &mut Out<'_>) {
        let there: BTreeSet<u64> = self.peers.names.namesakes().map(|(boot, _)| boot).collect();
        self.peers.rivalry.ended.retain(|_, boot| there.contains(boot));
        self.peers.rivalry.reported.retain(|(boot, _)| there.contains(boot));
        for to_boot in there {
            let deployments = self.own_deployments().into_iter().collect();
            let ended = self.peers.rivalry.ended.iter().filter(|(_, boot)| **boot == to_boot);
            let ended = ended.map(|(deployment, _)| deployment.clone()).collect();
            let namesake = Namesake { boot: self.identity.boot, to_boot, deployments, ended };
            out.effects.push(Effect::Greet(Box::new(namesake)));
        }
    }

    /// Takes the message of another node of this name. A deployment that runs on both nodes, and that the other one
    /// keeps, is ended here.
    pub(super) fn greeted(&mut self, other: &Namesake, out: &mut Out<'_>) {
        let known = self.peers.names.namesakes().find(|(boot, _)| *boot == other.boot);
        let Some((boot, is_elder)) = known.filter(|_| other.to_boot == self.identity.boot) else { return };
        let own = self.own_deployments();
        let is_ended_there = |one: &&Deployment| other.ended.iter().any(|theirs| theirs.name == one.name);
        own.keys().filter(is_ended_there).for_each(|deployment| self.runs_twice(deployment, boot, true, out));
        for (deployment, reaches_home) in own {
            let Some((theirs, reaches)) = other.deployments.iter().find(|(one, _)| one.name == deployment.name) else {
                continue;
            };
            let keeps = (deployment.epoch, reaches_home, !is_elder) > (theirs.epoch, *reaches, is_elder);
            self.runs_twice(&deployment, boot, keeps, out);
            if keeps {
                continue;
            }
            self.peers.rivalry.ended.insert(deployment.clone(), boot);
            if let Some(coordinator) = self.coordinators.get_mut(&deployment) {
                let place = self.peers.names.place(boot).unwrap_or_default().to_owned();
                coordinator.abort(FailureCause::Preempted(place), out);
            } else if let Some(participant) = self.participants.get_mut(&deployment) {
                participant.give_up(&format!("another node of its name keeps `{deployment}`"), out);
            }
        }
    }

    /// Reports, once, that a deployment also runs on another node of this name, and whether it goes on here.
    fn runs_twice(&mut self, deployment: &Deployment, boot: u64, keeps: bool, out: &mut Out<'_>) {
        if self.peers.rivalry.reported.insert((boot, deployment.clone())) {
            let place = self.peers.names.place(boot).unwrap_or_default().to_owned();
            out.effects.push(Effect::Peer(Change::Twice { deployment: deployment.to_string(), place, keeps }));
        }
    }

    /// Returns the names that two nodes have.
    pub(super) fn duplicates(&self) -> Answer {
        let place = format!("process {} on the host of the node that says so", self.identity.pid);
        Answer::Duplicates(self.peers.names.duplicates(&place))
    }

    /// Returns every deployment with a part here that is not about to end, and whether its home is reached.
    fn own_deployments(&self) -> BTreeMap<Deployment, bool> {
        let homes = self.coordinators.iter().filter(|(_, home)| !home.is_ending()).map(|(one, _)| (one.clone(), true));
        let reaches = |home: &str| home == self.identity.host || self.peers.names.reaches(home);
        let parts = self.participants.iter().filter(|(_, part)| !part.is_leaving());
        parts.map(|(one, part)| (one.clone(), reaches(part.home()))).chain(homes).collect()
    }
}
