//! The status of a replica and its team. It shows which replicas are behind and by how much, and which of them prevent
//! the removal of old data.

use super::Database;
use super::question::{Clock, ContentsStatus, MemberStatus, Status, StoreStatus};
use comms::logic::time::Time;
use dbmanager::logic::clock::{Quality, Wall};
use dbmanager::logic::version_vector::VersionVector;
use dbmanager::logic::view::past::Past;
use dbmanager::logic::view::status::Lag;
use std::time::Duration;

/// How long a replica is considered present after a message from it.
pub(super) const HEARD_WITHIN: Duration = Duration::from_secs(30);

impl Database {
    /// Returns the status of the replica and its team.
    pub(super) fn status(&mut self, now: Time) -> Status {
        let past = Past { log: self.replica.log(), state: self.replica.state() };
        let races = self.derived.races.of(&past);
        let (state, log, stable) = (self.readable().state, self.replica.log(), self.replica.stable());
        let count = |count: usize| u64::try_from(count).unwrap_or(u64::MAX);
        let (version, mine) = (log.vector(), self.replica.origin());
        let member = |(origin, robot): (_, &str)| {
            let none = VersionVector::default();
            let said = if origin == mine { version } else { self.replica.acked(origin).unwrap_or(&none) };
            MemberStatus {
                robot: robot.to_owned(),
                origin,
                heard: self.heard.get(&origin).map(|heard| now.since(heard.at)),
                lacks: Lag::of(log, said),
                ahead: missing(said, version),
                pins: stable.pinned_by.contains(&origin),
                clock: self.heard.get(&origin).and_then(|heard| heard.walls).map(|(theirs, ours)| clock(theirs, ours)),
            }
        };
        let mut members: Vec<MemberStatus> = self.replica.members().active().map(member).collect();
        members.sort_by(|a, b| (&a.robot, a.origin).cmp(&(&b.robot, b.origin)));
        Status {
            robot: self.place.robot.clone(),
            origin: self.replica.address(),
            team: self.place.team.clone(),
            member: self.replica.is_member(),
            store: StoreStatus {
                closed: self.disk.closed().map(str::to_owned),
                place: self.place.store.clone(),
                log_len: count(log.len()),
                log_size: count(log.size()),
            },
            contents: ContentsStatus {
                version: version.clone(),
                stable: stable.vector.clone(),
                digest: format!("{:032x}", state.digest()),
                keys: count(state.scan("").filter(|(key, _)| state.get(key).is_some()).count()),
                conflicts: count(state.conflicts("").count()),
                races: count(races),
            },
            clock: quality(self.wall.quality).to_owned(),
            members,
            alarms: self.alarms.list(),
            other_team: self.teams().others(now),
        }
    }
}

fn clock(theirs: Wall, ours: Wall) -> Clock {
    Clock { quality: quality(theirs.quality).to_owned(), ahead: theirs.millis.wrapping_sub(ours.millis).cast_signed() }
}

/// Returns how many transactions of `whole` are not in `part`.
fn missing(whole: &VersionVector, part: &VersionVector) -> u64 {
    // A peer may report any number.
    whole.beyond(part).iter().fold(0, |sum: u64, (origin, seq)| sum.saturating_add(seq - part.get(origin)))
}

fn quality(quality: Quality) -> &'static str {
    match quality {
        Quality::Unset => "unset",
        Quality::Battery => "plausible",
        Quality::Network => "network",
        Quality::Satellite => "satellite",
    }
}
