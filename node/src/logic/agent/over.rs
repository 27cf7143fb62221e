//! Drops deployments that are over, and lets a node leave when nothing is left.

use super::{Agent, END_KEPT, LINGER_MAX, OVER_MAX, UnendedPrograms};
use crate::logic::database::chronicle;
use crate::logic::effect::{Effect, Out, ProcessId};
use crate::logic::link::Link;
use crate::logic::protocol::{Deployment, Message, OpenEnd, OpenHost, ToCoordinator, Why};
use comms::logic::time::Time;

impl Agent {
    /// Drops the deployments that are over. A node with nothing left then leaves, if it is to leave.
    pub(super) fn tidy_up(&mut self, now: Time, effects: &mut Vec<Effect>) {
        for (deployment, coordinator) in self.coordinators.extract_if(.., |_, coordinator| coordinator.is_over()) {
            let (history, unconfirmed) = coordinator.into_history();
            if unconfirmed.is_empty() {
                effects.push(Effect::Settled { deployment });
            } else {
                self.peers.absence.open(now, deployment, &self.identity.host, unconfirmed);
            }
            let record = chronicle::ended(&self.identity.host, &history);
            effects.extend(record.map(|record| Effect::WriteDatabase(Box::new(record))));
            self.past.over.push_front(history);
            self.past.over_until = Some(now + END_KEPT);
        }
        self.past.over_until.take_if(|until| *until <= now);
        self.past.over.truncate(OVER_MAX);
        for (deployment, participant) in self.participants.extract_if(.., |_, participant| participant.is_over()) {
            if participant.home() != self.identity.host && !self.peers.names.reaches(participant.home()) {
                let away = participant
                    .hosts()
                    .iter()
                    .filter(|host| **host != self.identity.host && !self.peers.names.reaches(host));
                let open = away.map(|host| (host.clone(), Why::Lost)).collect();
                self.peers.absence.open(now, deployment.clone(), participant.home(), open);
            }
            self.stopped.note_open(&deployment, participant.may_go_on());
            let leaves = participant.unconfirmed();
            if !leaves.is_empty() {
                let (home, claims) = (participant.home().to_owned(), participant.claims().clone());
                self.past.unended.insert(deployment.clone(), UnendedPrograms { home, leaves, claims });
            }
            effects.push(Effect::CloseDeployment { deployment: deployment.clone() });
            self.past.programs.push_front((deployment, participant.programs()));
        }
        self.past.programs.truncate(OVER_MAX);
        self.tell_stopped(effects);
        if !self.coordinators.is_empty() || !self.participants.is_empty() {
            return;
        }
        if self.run.leaving {
            self.take_leave(now, effects);
        } else if let Some(why) = self.namesake().filter(|_| {
            self.peers.names.elder().is_some() && self.pending.awaiting.is_empty() && self.peers.names.is_known(now)
        }) {
            effects.push(Effect::Yield { why });
        }
    }

    /// Announces to the others that this node leaves, unless something may run on after it, and ends when they have acknowledged.
    fn take_leave(&mut self, now: Time, effects: &mut Vec<Effect>) {
        // A node that is gone cannot send its last messages again; without them the others would wait for it.
        let until = match self.run.lingers_until {
            Some(until) => until,
            None => {
                if self.past.unended.is_empty() {
                    let since_1970 = self.since_1970(now);
                    let mut out = Out { now, since_1970, effects, messages: &mut Vec::new() };
                    let others: Vec<String> =
                        self.peers.links.keys().filter(|host| self.peers.names.reaches(host)).cloned().collect();
                    others.iter().for_each(|host| self.transmit(host, Message::leaves(), &mut out));
                }
                // The listeners are told that nothing follows.
                effects.extend(self.callers.listeners.iter().map(|call| Effect::EndAnswers { call: *call }));
                *self.run.lingers_until.insert(now + LINGER_MAX)
            }
        };
        if until <= now || self.is_heard() && self.callers.promises.is_empty() {
            effects.push(Effect::Leave);
        }
    }

    /// Takes note that nothing is left of a program which could not be ended with its deployment. After the last such program,
    /// the home is told.
    pub(super) fn loose_ended(&mut self, process: &ProcessId, out: &mut Out<'_>) {
        let Some(loose) = self.past.unended.get_mut(&process.deployment) else { return };
        loose.leaves.remove(&process.leaf);
        if loose.leaves.is_empty() {
            let home = std::mem::take(&mut loose.home);
            self.past.unended.remove(&process.deployment);
            out.send(&home, process.deployment.to_coordinator(ToCoordinator::Released));
        }
    }

    /// Takes a user's statement that nothing is left of a deployment that is over; returns whether anything was listed as left.
    pub(super) fn forget(&mut self, deployment: &Deployment) -> bool {
        let is_listed = self.peers.absence.forget(deployment);
        self.past.unended.remove(deployment).is_some() || is_listed
    }

    /// Adds deployments that could not be ended here and are not listed: their homes may have forgotten them.
    pub(super) fn tell_unended(&self, ends: &mut Vec<OpenEnd>) {
        for (deployment, unended) in &self.past.unended {
            if ends.iter().all(|end| end.deployment != *deployment) {
                let hosts = vec![OpenHost { host: self.identity.host.clone(), why: Why::Unable, heard: None }];
                ends.push(OpenEnd { deployment: deployment.clone(), home: unended.home.clone(), hosts });
            }
        }
    }

    /// Whether every node that can be reached has acknowledged everything.
    fn is_heard(&self) -> bool {
        let is_idle = |links: &Vec<Link>| links.last().is_none_or(|link| link.deadline().is_none());
        self.peers.links.iter().all(|(host, links)| is_idle(links) || !self.peers.names.reaches(host))
    }
}
