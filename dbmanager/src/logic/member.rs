//! The members of the team, which are part of the replicated state.
//!
//! *State.* `sys/members/<origin>`: the origin is a member. `sys/retired/<origin>`: it is not a member any more. Such
//! records only appear and are never deleted. So a replica with more transactions knows more, and a retirement beats a
//! membership in any order.
//!
//! *Joining.* A member (the sponsor) admits an origin before that has shown a transaction to any other replica, and the
//! origin begins with the sponsor's state. So a replica that counts a transaction of the sponsor after the admission knows
//! the newcomer. A replica that counts only earlier ones counts nothing that the newcomer does not have from the
//! beginning. A replica that has retired the sponsor no longer counts the sponsor's transactions. So it also treats as
//! retired a newcomer of that sponsor which it does not know. For an unknown sponsor, the sponsor's own sponsor decides.
//!
//! *Retiring.* A replica that has applied a retirement no longer exchanges messages with the retired origin, but takes its
//! transactions from others. For garbage collection, the origin is still included until each
//! remaining member has the retirement (the *barrier*). After the barrier no member takes anything
//! new from the origin, and everything that any member took before is here.
//!
//! *Coming back.* `sys/brought/<origin>/<n>` lists the transactions that came with that origin when it was admitted: the
//! origins that are not members, each with its last number. See [`merge`](crate::logic::merge).

use crate::logic::clock::Timestamp;
use crate::logic::key::Key;
use crate::logic::notary;
use crate::logic::state::{State, Version};
use crate::logic::txn::{Encoding, Value, Write};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use std::collections::BTreeMap;

const MEMBERS: &str = "sys/members/";
const RETIRED: &str = "sys/retired/";
const REBASED: &str = "sys/brought/";
/// How many entries one record of rebased transactions has.
const BROUGHT_MAX: usize = 1024;
/// How many generations of sponsors a replica reports to others.
pub const SPONSORS_MAX: usize = 32;

/// The members of the team at one version vector.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Members {
    active: BTreeMap<ReplicaId, String>,
    sponsors: BTreeMap<ReplicaId, ReplicaId>,
    retired: BTreeMap<ReplicaId, Vec<(Dot, Timestamp)>>,
    rebased: BTreeMap<ReplicaId, Rebased>,
}

/// The part of a non-member origin's transactions that was rebased.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rebased {
    /// The last rebased transaction.
    pub last: Dot,
    /// The timestamp of that transaction.
    pub stamp: Timestamp,
    /// The transaction that contains everything that remains of the rebased transactions.
    pub by: Dot,
}

/// Returns whether a key is a record of this module. Such records are facts of one team and are not moved to another team.
pub fn is_record(key: &Key) -> bool {
    [MEMBERS, RETIRED, REBASED].iter().any(|prefix| key.as_str().starts_with(prefix)) || notary::is_record(key)
}

/// Returns the writes that record which transactions came with `origin`: the last one of each other origin, with its
/// timestamp.
pub fn arrival(origin: ReplicaId, rebased: &[(Dot, Timestamp)]) -> Vec<Write> {
    let records = rebased.chunks(BROUGHT_MAX).enumerate().filter_map(|(index, entries)| {
        let bytes = postcard::to_stdvec(entries).ok()?;
        let value = Value { encoding: Encoding::BYTES, bytes: bytes.into() };
        Some(Write { key: Key::new(format!("{REBASED}{origin}/{index:06}")).ok()?, value: Some(value) })
    });
    records.collect()
}

/// Returns the write that makes `origin` a member.
pub fn admission(origin: ReplicaId, robot: &str) -> Option<Write> {
    let value = Value { encoding: Encoding::TEXT, bytes: robot.as_bytes().into() };
    Some(Write { key: Key::new(format!("{MEMBERS}{origin}")).ok()?, value: Some(value) })
}

/// Returns the write that retires `origin`.
pub fn retirement(origin: ReplicaId) -> Option<Write> {
    let value = Value { encoding: Encoding::TEXT, bytes: [].into() };
    Some(Write { key: Key::new(format!("{RETIRED}{origin}")).ok()?, value: Some(value) })
}

/// Returns the origin that a write to this key admits; none if it admits none.
pub fn admitted_by(key: &Key) -> Option<ReplicaId> {
    ReplicaId::parse(key.as_str().strip_prefix(MEMBERS)?)
}

/// Returns the robots for which `origin` was admitted: one, unless a member has lied.
pub fn robots(state: &State, origin: ReplicaId) -> Vec<String> {
    let Ok(key) = Key::new(format!("{MEMBERS}{origin}")) else { return Vec::new() };
    let values = state.versions(&key).iter().filter_map(|version| version.value.as_ref());
    values.map(|value| String::from_utf8_lossy(&value.bytes).into_owned()).collect()
}

/// Returns the origin that a write to this key retires; none if it retires none.
pub fn retired_by(key: &Key) -> Option<ReplicaId> {
    ReplicaId::parse(key.as_str().strip_prefix(RETIRED)?)
}

impl Members {
    /// Reads the members from a state.
    pub fn of(state: &State) -> Self {
        let origin = |key: &Key| ReplicaId::parse(key.as_str().strip_prefix(MEMBERS)?);
        let by = |versions: &[Version]| versions.iter().map(|version| (version.dot, version.stamp)).collect();
        let retired: BTreeMap<ReplicaId, Vec<(Dot, Timestamp)>> =
            state.scan(RETIRED).filter_map(|(key, versions)| Some((retired_by(key)?, by(versions)))).collect();
        let name = |versions: &[Version]| {
            let value = versions.last()?.value.as_ref()?;
            Some(String::from_utf8_lossy(&value.bytes).into_owned())
        };
        let active = state.scan(MEMBERS).filter_map(|(key, versions)| Some((origin(key)?, name(versions)?)));
        let sponsor = |versions: &[Version]| versions.first().map(|version| version.dot.origin);
        let sponsors = state.scan(MEMBERS).filter_map(|(key, versions)| Some((origin(key)?, sponsor(versions)?)));
        let sponsors = sponsors.collect();
        let active = active.filter(|(origin, _)| !retired.contains_key(origin)).collect();
        Self { active, sponsors, retired, rebased: rebased(state) }
    }

    /// Returns whether `origin` is a member.
    pub fn is_active(&self, origin: ReplicaId) -> bool {
        self.active.contains_key(&origin)
    }

    /// Returns the robot of a member.
    pub fn robot(&self, origin: ReplicaId) -> Option<&str> {
        self.active.get(&origin).map(String::as_str)
    }

    /// Returns the sponsor of an origin, the sponsor's sponsor, and so on, up to [`SPONSORS_MAX`].
    pub fn sponsors(&self, origin: ReplicaId) -> Vec<ReplicaId> {
        let sponsor = |of: &ReplicaId| self.sponsors.get(of).copied().filter(|by| by != of);
        std::iter::successors(Some(origin), sponsor).skip(1).take(SPONSORS_MAX).collect()
    }

    /// Returns the members.
    pub fn active(&self) -> impl Iterator<Item = (ReplicaId, &str)> {
        self.active.iter().map(|(origin, robot)| (*origin, robot.as_str()))
    }

    /// Returns the timestamp of the first known retirement of `origin`.
    pub fn retired(&self, origin: ReplicaId) -> Option<Timestamp> {
        self.retired.get(&origin)?.iter().map(|(_, stamp)| *stamp).min()
    }

    /// Returns the rebased part of an origin that is not a member.
    pub fn rebased(&self, origin: ReplicaId) -> Option<&Rebased> {
        self.rebased.get(&origin)
    }

    /// Returns the rebased parts of all origins that are not members.
    pub fn all_rebased(&self) -> impl Iterator<Item = &Rebased> {
        self.rebased.values()
    }

    /// Returns the retired origins before their barrier: not every member is known to have a retirement of them, according
    /// to `has`.
    pub fn before_barrier<'a>(
        &'a self,
        has: impl Fn(ReplicaId) -> Option<&'a VersionVector>,
    ) -> impl Iterator<Item = ReplicaId> {
        let everywhere =
            move |dot: Dot| self.active.keys().all(|origin| has(*origin).is_some_and(|vector| vector.contains(dot)));
        let open = move |by: &Vec<(Dot, Timestamp)>| !by.iter().any(|(dot, _)| everywhere(*dot));
        self.retired.iter().filter(move |(_, by)| open(by)).map(|(origin, _)| *origin)
    }
}

fn rebased(state: &State) -> BTreeMap<ReplicaId, Rebased> {
    let mut rebased: BTreeMap<ReplicaId, Rebased> = BTreeMap::new();
    for version in state.scan(REBASED).flat_map(|(_, versions)| versions) {
        let Some(value) = &version.value else { continue };
        let Ok(entries) = postcard::from_bytes::<Vec<(Dot, Timestamp)>>(&value.bytes) else { continue };
        for (last, stamp) in entries {
            let entry = Rebased { last, stamp, by: version.dot };
            let known = rebased.entry(last.origin).or_insert(entry);
            *known = entry.max(*known);
        }
    }
    rebased
}
