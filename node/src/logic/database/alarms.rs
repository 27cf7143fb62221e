//! Alarms of the replica, in words for a person. The latest alarms are kept for `dca db status`.

use super::{Database, Effect};
use dbmanager::logic::replica::Alarm;
use dbmanager::logic::version_vector::ReplicaId;

/// How many alarms are kept.
const ALARMS_MAX: usize = 16;

impl Database {
    /// Takes an alarm of the replica. A forbidden write may arrive again and again, but its alarm is given once.
    pub(super) fn take_alarm(&mut self, alarm: &Alarm, effects: &mut Vec<Effect>) {
        let words = self.words(alarm);
        if let Alarm::Forged { from, why } = alarm {
            let robot = self.replica.members().robot(*from).map_or_else(|| from.to_string(), str::to_owned);
            effects.push(Effect::Refused { from: robot, why: why.clone() });
            if self.alarms.contains(&words) {
                return;
            }
        }
        self.alarm(words, effects);
    }

    /// Keeps and reports an alarm, unless the previous alarm was the same.
    pub(super) fn alarm(&mut self, words: String, effects: &mut Vec<Effect>) {
        if self.alarms.back() != Some(&words) {
            effects.push(Effect::Alarm(words.clone()));
            self.alarms.push_back(words);
        }
        if self.alarms.len() > ALARMS_MAX {
            self.alarms.pop_front();
        }
    }

    /// Returns an alarm in words.
    pub(super) fn words(&self, alarm: &Alarm) -> String {
        let robot = |origin: &ReplicaId| match self.replica.members().robot(*origin) {
            Some(robot) => format!("`{robot}`"),
            None => format!("the replica {origin}"),
        };
        match alarm {
            Alarm::ClockSuspect { origin, ahead_by } => format!(
                "{} dates its writes {} s ahead of this robot's clock; `dca db heal-clock` mends the order of new ones",
                robot(origin),
                ahead_by.as_secs()
            ),
            Alarm::Fork(origin) => {
                format!("{} has used a number twice: its disk was copied or set back", robot(origin))
            }
            Alarm::Diverged(origin) => format!("{} has the same transactions and another state", robot(origin)),
            Alarm::NeedsUpgrade(format) => format!("a robot writes format {format}: upgrade DCA on this one"),
            Alarm::Malformed(origin) => format!("{} sent what no replica sends", robot(origin)),
            Alarm::OtherTeam(_, robot) => format!(
                "`{robot}` belongs to another team `{}`, which was begun apart from this one: neither receives the writes of the other",
                self.place.team
            ),
            Alarm::Forged { from, why } => {
                format!("{} has passed on a write that is not permitted: {why}", robot(from))
            }
            Alarm::Rejoining { from } => {
                format!("this replica has given up the name {from}, and goes on under another one")
            }
        }
    }
}
