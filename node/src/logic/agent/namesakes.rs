//! Another node of this one's name: two robots that were set up alike, or two parts of a network that meet after a cut.
//!
//! While both nodes are present, neither node accepts new work, because the name would not say
//! which node is meant. Once a second, each of the two nodes tells the other which deployments it
//! runs. If a deployment runs on both nodes, one instance is kept: the instance with the higher
//! epoch. If the epochs are equal, it is the instance whose home is reachable from its node,
//! otherwise the instance on the node that was there first. The other instance is ended at once, at
//! its home as preempted.

use super::peers::Peers;
use crate::logic::effect::{Effect, Out};
use crate::logic::nameserver::Change;
use crate::logic::protocol::{Deployment, Namesake};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The agreements between this node and other nodes of its name, while these are present.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Rivalry {
    /// The deployments that were ended here, each with the boot at which it continues. Repeated until the other node
    /// leaves: a message may be lost, or arrive before the other node knows of this one.
    ended: BTreeMap<Deployment, u64>,
    /// The deployments that were reported to run on both nodes, each with the boot of the other node.
    reported: BTreeSet<(u64, Deployment)>,
}

/// Every deployment with a part here that is not about to end, and whether its home is reached.
pub(super) type OwnDeployments = BTreeMap<Deployment, bool>;

/// A node with the name of this node that has reported its deployments.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rival {
    boot: u64,
    /// Whether it was there first.
    is_elder: bool,
}

impl Rival {
    /// Returns whether this node keeps a deployment that runs on both nodes; nothing if it does not run on the other one.
    pub(super) fn keeps(self, own: &Deployment, reaches_home: bool, other: &Namesake) -> Option<bool> {
        let (theirs, reaches) = other.deployments.iter().find(|(one, _)| one.name == own.name)?;
        Some((own.epoch, reaches_home, !self.is_elder) > (theirs.epoch, *reaches, self.is_elder))
    }
}

impl Peers {
    /// Returns why this node takes nothing on, if another node has its name.
    pub(super) fn namesake(&self) -> Option<String> {
        let host = &self.host;
        if let Some(place) = self.names.elder() {
            return Some(format!(
                "another node called `{host}` was there first: {place}; give this one another name with `dca-node --name`"
            ));
        }
        let place = self.names.duplicates("").into_iter().find(|one| one.host == *host)?.second;
        Some(format!(
            "a second node is called `{host}`: {place}; nothing begins under this name before that one has another, with \
             `dca-node --name`"
        ))
    }

    /// Tells others of this name which deployments run here.
    pub(super) fn greet(&mut self, own: &OwnDeployments, out: &mut Out<'_>) {
        let there: BTreeSet<u64> = self.names.namesakes().map(|(boot, _)| boot).collect();
        self.rivalry.ended.retain(|_, boot| there.contains(boot));
        self.rivalry.reported.retain(|(boot, _)| there.contains(boot));
        for to_boot in there {
            let deployments = own.iter().map(|(deployment, reaches)| (deployment.clone(), *reaches)).collect();
            let ended = self.rivalry.ended.iter().filter(|(_, boot)| **boot == to_boot);
            let ended = ended.map(|(deployment, _)| deployment.clone()).collect();
            let namesake = Namesake { boot: self.boot, to_boot, deployments, ended };
            out.effects.push(Effect::Greet(Box::new(namesake)));
        }
    }

    /// Takes the message of another node of this name; nothing if it is not for this boot, or of an unknown node. Reports the
    /// deployments that the other node has ended.
    pub(super) fn greeted(&mut self, other: &Namesake, own: &OwnDeployments, out: &mut Out<'_>) -> Option<Rival> {
        let (boot, is_elder) = self.names.namesakes().find(|(boot, _)| *boot == other.boot)?;
        let rival = (other.to_boot == self.boot).then_some(Rival { boot, is_elder })?;
        let is_ended_there = |one: &&Deployment| other.ended.iter().any(|theirs| theirs.name == one.name);
        own.keys().filter(is_ended_there).for_each(|deployment| self.runs_twice(deployment, rival, true, out));
        Some(rival)
    }

    /// Reports once that a deployment also runs on another node of this name, and whether the deployment continues here.
    pub(super) fn runs_twice(&mut self, deployment: &Deployment, rival: Rival, keeps: bool, out: &mut Out<'_>) {
        if self.rivalry.reported.insert((rival.boot, deployment.clone())) {
            let place = self.place_of(rival);
            out.effects.push(Effect::Peer(Change::Twice { deployment: deployment.to_string(), place, keeps }));
        }
    }

    /// Takes note that a deployment ends here, and continues at another node of this name. Returns where that is.
    pub(super) fn ends_for(&mut self, deployment: &Deployment, rival: Rival) -> String {
        self.rivalry.ended.insert(deployment.clone(), rival.boot);
        self.place_of(rival)
    }

    fn place_of(&self, rival: Rival) -> String {
        self.names.place(rival.boot).unwrap_or_default().to_owned()
    }
}
