//! Robots of another team with the same name as this team. That team was begun separately, for example when two users
//! began a team in the same minute.
//!
//! A robot that is alone in its team gives way by itself (`dbmanager`'s `hello.rs`). If both teams have several
//! members, an operator decides which team stays. Until then, every member of both teams reports the other team.

use super::status::HEARD_WITHIN;
use super::{KnownPeer, Place};
use comms::logic::time::Time;
use dbmanager::logic::replica::Replica;
use dbmanager::logic::version_vector::ReplicaId;
use std::collections::{BTreeMap, BTreeSet};

/// How many replicas are remembered.
const REPLICAS_MAX: usize = 64;

/// The robots that said recently that they belong to another team.
#[derive(Debug, Default)]
pub(super) struct OtherTeam(BTreeMap<ReplicaId, (String, Time)>);

impl OtherTeam {
    /// Notes that a robot has said that it belongs to another team. Returns whether this is new.
    pub(super) fn hear(&mut self, now: Time, origin: ReplicaId, robot: &str) -> bool {
        self.0.retain(|_, (_, at)| now.since(*at) < HEARD_WITHIN);
        let is_new = !self.0.contains_key(&origin);
        if is_new && self.0.len() >= REPLICAS_MAX {
            return false;
        }
        self.0.insert(origin, (robot.to_owned(), now));
        is_new
    }

    /// Returns the name in the last message of a robot.
    fn replica(&self, now: Time, robot: &str) -> Option<ReplicaId> {
        let heard = self.0.iter().filter(|(_, (name, at))| name == robot && now.since(*at) < HEARD_WITHIN);
        heard.max_by_key(|(_, (_, at))| *at).map(|(origin, _)| *origin)
    }

    /// Returns the robots with recent messages, except the robots of the own team.
    pub(super) fn robots(&self, now: Time, is_own: impl Fn(&str) -> bool) -> Vec<String> {
        let late = self.0.values().filter(|(robot, at)| now.since(*at) < HEARD_WITHIN && !is_own(robot));
        late.map(|(robot, _)| robot.clone()).collect::<BTreeSet<_>>().into_iter().collect()
    }
}

/// The team of this robot, and another one of its name.
#[derive(Clone, Copy, Debug)]
pub(super) struct Teams<'a> {
    pub(super) place: &'a Place,
    pub(super) replica: &'a Replica,
    pub(super) other: &'a OtherTeam,
    /// The other replicas that were heard recently.
    pub(super) heard: &'a BTreeMap<ReplicaId, KnownPeer>,
}

impl Teams<'_> {
    /// Returns which robots do not get the writes made here although users might expect it, and where to read about it.
    pub(super) fn unheard_by(&self, now: Time) -> Option<String> {
        let Place { robot, team, .. } = self.place;
        if !self.replica.is_member() {
            let is_alone = !self.heard.values().any(|heard| heard.member);
            let note = "belongs to no team yet, so this write stays on the robot until it joins a team; `dca db status` says how";
            return is_alone.then(|| format!("`{robot}` {note}"));
        }
        let others = self.others(now);
        (!others.is_empty()).then(|| {
            format!(
                "`{}` will not get this: there is a second team `{team}`, begun apart; `dca db status` says how they become one",
                others.join("`, `")
            )
        })
    }

    /// Returns the robots with recent messages that belong to another team of this name.
    pub(super) fn others(&self, now: Time) -> Vec<String> {
        let members = self.replica.members();
        self.other.robots(now, |robot| members.active().any(|(_, member)| member == robot))
    }

    /// Returns whether this robot has left its team, which a robot does if it is the only member, and the team of `robot` is there.
    pub(super) fn gives_way_to(&self, now: Time, robot: &str) -> bool {
        !self.replica.is_member() && self.other.replica(now, robot).is_some()
    }

    /// Returns the replica of another team that a robot has.
    pub(super) fn replica_of(&self, now: Time, robot: &str) -> Result<ReplicaId, String> {
        let Place { robot: own, team, .. } = self.place;
        if !self.replica.is_member() {
            return Err(format!("`{own}` belongs to no team; it joins `{team}` by itself when it hears a member"));
        }
        self.other.replica(now, robot).ok_or_else(|| {
            format!("`{own}` has no recent message of a robot `{robot}` of another team `{team}`; `dca db status` lists such robots")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_robot_is_told_once_and_forgotten_when_it_is_silent() {
        let (mut other, origin, begin) = (OtherTeam::default(), ReplicaId::new(1), Time::ZERO);
        let at = |seconds| begin + Duration::from_secs(seconds);
        assert!(other.hear(at(0), origin, "r2") && !other.hear(at(20), origin, "r2"));
        assert_eq!(other.robots(at(40), |_| false), ["r2"]);
        assert!(other.robots(at(40), |robot| robot == "r2").is_empty(), "it has joined under another origin");
        assert!(other.robots(at(60), |_| false).is_empty() && other.hear(at(60), origin, "r2"));
    }
}
