//! Another node of this one's name: two robots that were set up alike, or two parts of a network that meet after a cut.
//!
//! Neither takes anything on while both are there, since nobody could say which is meant. Each tells the other what it runs, once
//! a second. Of a deployment that runs on both, one goes on: that of the higher epoch; of one epoch that whose home is reached
//! from there; else that of the node that was there first. The other is ended at once, at its home as preempted.

use super::Agent;
use crate::logic::effect::{Effect, Out};
use crate::logic::nameserver::Change;
use crate::logic::protocol::{Answer, Deployment, Namesake};
use std::collections::BTreeMap;

impl Agent {
    /// Says why this node takes nothing on, where another one has its name.
    pub(super) fn namesake(&self) -> Option<String> {
        let host = &self.identity.host;
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

    /// Tells others of this name what runs here.
    pub(super) fn greet(&self, out: &mut Out<'_>) {
        for (to_boot, _) in self.names.namesakes() {
            let deployments = self.own_deployments().into_iter().collect();
            let namesake = Namesake { boot: self.identity.boot, to_boot, deployments };
            out.effects.push(Effect::Greet(Box::new(namesake)));
        }
    }

    /// Takes the word of another node of this name. What both run, and the other keeps, is ended here.
    pub(super) fn greeted(&mut self, other: &Namesake, out: &mut Out<'_>) {
        let known = self.names.namesakes().find(|(boot, _)| *boot == other.boot);
        let Some((boot, is_elder)) = known.filter(|_| other.to_boot == self.identity.boot) else { return };
        let place = self.names.place(boot).unwrap_or_default().to_owned();
        for (deployment, reaches_home) in self.own_deployments() {
            let Some((theirs, reaches)) = other.deployments.iter().find(|(one, _)| one.name == deployment.name) else {
                continue;
            };
            let keeps = (deployment.epoch, reaches_home, !is_elder) > (theirs.epoch, *reaches, is_elder);
            let (name, place) = (deployment.to_string(), place.clone());
            out.effects.push(Effect::Peer(Change::Twice { deployment: name, place: place.clone(), keeps }));
            if keeps {
                continue;
            }
            if let Some(coordinator) = self.coordinators.get_mut(&deployment) {
                coordinator.preempt(place, out);
            } else if let Some(participant) = self.participants.get_mut(&deployment) {
                participant.leave(out);
            }
        }
    }

    /// Answers which names two nodes have.
    pub(super) fn duplicates(&self) -> Answer {
        let place = format!("process {} on the host of the node that says so", self.identity.pid);
        Answer::Duplicates(self.names.duplicates(&place))
    }

    /// Returns every deployment that has a part here which does not end, and whether its home is reached.
    fn own_deployments(&self) -> BTreeMap<Deployment, bool> {
        let homes = self.coordinators.iter().filter(|(_, home)| !home.is_ending()).map(|(one, _)| (one.clone(), true));
        let reaches = |home: &str| home == self.identity.host || self.names.reaches(home);
        let parts = self.participants.iter().filter(|(_, part)| !part.is_leaving());
        parts.map(|(one, part)| (one.clone(), reaches(part.home()))).chain(homes).collect()
    }
}
