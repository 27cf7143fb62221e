//! The checks that are run at each effect of a replica.

use super::{Node, World};
use dbmanager::logic::record::Batch;
use dbmanager::logic::replica::{AckLevel, Alarm, Answer, Effect, Replica};
use dbmanager::logic::version_vector::{Dot, ReplicaId, VersionVector};
use std::collections::BTreeMap;

impl World {
    /// Handles that a replica has taken over the state of another. Watchers start again at the other's version
    /// vector. If a transaction that was here is lost, clients start again as well.
    pub(super) fn taken_over(&mut self, node: usize, before: &VersionVector, still: &[Effect]) {
        let Some(replica) = self.nodes[node].replica.as_ref() else { return };
        let cut = replica.log().vector().clone();
        self.reference.means(node, replica);
        if !cut.dominates(before) {
            self.reference.left_behind = true;
            self.forgets(node);
        }
        // Transactions shown later in this step are already in the version vector.
        let shown =
            still.iter().filter_map(|effect| if let Effect::Visible(dot, _) = effect { Some(*dot) } else { None });
        let mut first: BTreeMap<ReplicaId, u64> = BTreeMap::new();
        for dot in shown {
            first.entry(dot.origin).or_insert(dot.seq);
        }
        let left = cut.iter().map(|(origin, seq)| (origin, first.get(&origin).map_or(seq, |first| first - 1)));
        self.clients.watch_anew(node);
        self.reference.replaced(node, left.filter(|(_, seq)| *seq > 0).collect());
    }

    pub(super) fn answered(&mut self, node: usize, ticket: u64, answer: Answer) {
        match answer {
            Answer::Committed(dot) => {
                self.committed = Some(dot);
                self.reference.acknowledged(node, dot);
                return;
            }
            Answer::Refused(_) => {}
            Answer::Reached(dot) => self.reached(node, ticket, dot),
            Answer::Pending(_) if self.owed.contains_key(&ticket) => {}
            Answer::Pending(_) => self.reference.blame(format!("I12: ticket {ticket} at {node} is answered twice")),
        }
        self.owed.remove(&ticket);
    }

    /// I6: a caller that was told that other robots have a transaction can rely on their disks.
    pub(super) fn reached(&mut self, node: usize, ticket: u64, dot: Dot) {
        let Some((_, level, losses)) = self.owed.get(&ticket) else {
            return self.reference.blame(format!("I12: ticket {ticket} at {node} is answered twice"));
        };
        let (own, name) = (&self.nodes[node].name, self.replica(node).name_of(dot));
        let has = |other: &&Node| {
            let cut = other.replica.as_ref().map_or(&other.asleep.1, |replica| replica.log().vector());
            cut.contains(name) || cut.contains(dot)
        };
        let others = || self.nodes.iter().enumerate().filter(|(index, _)| *index != node).map(|(_, other)| other);
        let holders = others().filter(has).count();
        let enough = match level {
            AckLevel::Local => true,
            AckLevel::Replicated(count) => holders >= *count,
            AckLevel::On(names) => {
                names.iter().all(|on| on == own || others().any(|other| other.name == *on && has(&other)))
            }
            AckLevel::Everywhere => {
                let members = self.replica(node).members();
                let origin = |other: &Node| other.replica.as_ref().map_or(other.asleep.0, Replica::origin);
                others().filter(|other| members.is_active(origin(other))).all(|other| has(&other))
            }
        };
        // A robot that had the transaction may have lost its disk since.
        if !enough && self.losses == *losses {
            let level = level.clone();
            self.reference.blame(format!("I6: {dot} of {node} has not reached {level:?}, but {holders} others"));
        }
    }

    /// I7: an alarm is wrong if nothing in this simulation gives a reason for it.
    pub(super) fn alarm(&mut self, node: usize, alarm: Alarm) {
        match &alarm {
            Alarm::Diverged(peer) if !self.faults.can_roll_back() => {
                let wrong = |(at, node): (usize, &Node)| {
                    Some(format!("at {at}: {}", self.reference.check_versions(node.replica.as_ref()?).err()?))
                };
                let wrong: Vec<String> = self.nodes.iter().enumerate().filter_map(wrong).collect();
                self.reference.blame(format!("I1: {node} and {peer} have diverged; {wrong:#?}"));
            }
            Alarm::Forged { why, .. } => self.reference.blame(format!("{node} refuses what is honest: {why}")),
            Alarm::Malformed(peer) => self.reference.blame(format!("{node} cannot read what {peer} sent")),
            Alarm::Fork(origin) if !self.faults.can_roll_back() => {
                self.reference.blame(format!("I7: {node} sees a fork of {origin}"));
            }
            Alarm::Diverged(_)
            | Alarm::Fork(_)
            | Alarm::ClockSuspect { .. }
            | Alarm::NeedsUpgrade(_)
            | Alarm::OtherTeam(..)
            | Alarm::Rejoining { .. } => {}
        }
        self.alarms.push((node, alarm));
    }

    /// I8: all members have the transactions that are dropped from a log.
    pub(super) fn truncated(&mut self, node: usize, (batch, replaced): (&Batch, bool)) {
        let gone = batch.0.iter().filter(|(name, record)| name.first() == Some(&b'l') && record.is_none());
        if replaced || self.faults.can_roll_back() {
            return;
        }
        let number = |bytes: Option<&[u8]>| bytes.and_then(|b| b.try_into().ok()).map(u64::from_be_bytes);
        let dots: Vec<Dot> = gone
            .filter_map(|(name, _)| {
                Some(Dot { origin: ReplicaId::new(number(name.get(1..9))?), seq: number(name.get(9..17))? })
            })
            .collect();
        if dots.is_empty() {
            return;
        }
        let Some(members) = self.nodes[node].replica.as_ref().map(Replica::members) else { return };
        for other in &self.nodes {
            let (origin, cut) = match &other.replica {
                Some(replica) => (replica.origin(), replica.log().vector()),
                None => (other.asleep.0, &other.asleep.1),
            };
            if let Some(dot) = dots.iter().find(|dot| members.is_active(origin) && !cut.contains(**dot)) {
                return self.reference.blame(format!("I8: {node} has dropped {dot}, which {} lacks", other.name));
            }
        }
    }
}
