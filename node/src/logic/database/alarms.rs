//! Alarms of the replica, in words for a person. The latest alarms are kept for `dca db status`.

use super::Effect;
use dbmanager::logic::member::Members;
use dbmanager::logic::replica::Alarm;
use dbmanager::logic::version_vector::ReplicaId;
use std::collections::{BTreeSet, VecDeque};

/// How many alarms are kept.
const ALARMS_MAX: usize = 16;

/// The newest alarms.
#[derive(Debug, Default)]
pub(super) struct Alarms {
    kept: VecDeque<String>,
}

impl Alarms {
    /// Takes an alarm of the replica. A forbidden write arrives again and again, and is reported once.
    pub(super) fn take(&mut self, alarm: &Alarm, members: &Members, team: &str, effects: &mut Vec<Effect>) {
        let words = words(alarm, members, team);
        if let Alarm::Forged { from, why } = alarm {
            let robot = members.robot(*from).map_or_else(|| from.to_string(), str::to_owned);
            effects.push(Effect::Refused { from: robot, why: why.clone() });
            if self.kept.contains(&words) {
                return;
            }
        }
        self.tell(words, effects);
    }

    /// Keeps and reports an alarm, unless it is the same as the previous one.
    pub(super) fn tell(&mut self, words: String, effects: &mut Vec<Effect>) {
        if self.kept.back() != Some(&words) {
            effects.push(Effect::Alarm(words.clone()));
            self.kept.push_back(words);
        }
        if self.kept.len() > ALARMS_MAX {
            self.kept.pop_front();
        }
    }

    /// Forgets these alarms: their causes are over.
    pub(super) fn forget(&mut self, over: &BTreeSet<String>) {
        self.kept.retain(|alarm| !over.contains(alarm));
    }

    /// Returns the alarms, the oldest first.
    pub(super) fn list(&self) -> Vec<String> {
        self.kept.iter().cloned().collect()
    }
}

/// Returns an alarm in words.
pub(super) fn words(alarm: &Alarm, members: &Members, team: &str) -> String {
    let robot = |origin: &ReplicaId| match members.robot(*origin) {
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
        Alarm::NeedsUpgrade(format) => {
            format!("another robot writes format {format}, which this robot cannot read: upgrade DCA on this robot")
        }
        Alarm::Malformed(origin) => format!("{} sent a message that no correct replica sends", robot(origin)),
        Alarm::OtherTeam(_, robot) => format!(
            "`{robot}` belongs to a different team that is also named `{team}`: the two teams do not exchange writes"
        ),
        Alarm::Forged { from, why } => {
            format!("{} has passed on a write that is not permitted: {why}", robot(from))
        }
        Alarm::Rejoining { from } => {
            format!("this replica has given up the name {from}, and now uses another name")
        }
    }
}
