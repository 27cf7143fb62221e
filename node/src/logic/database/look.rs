//! Answers questions about the past: history, earlier states, differences, and unsettled conflicts.

use super::question::{AsOf, Choice, Commit, Reply, Resolve};
use super::refuse::LOCAL;
use super::{Checkpoints, REPLY_SIZE_MAX};
use crate::logic::table::counted;
use dbmanager::logic::key::{Key, Namespace};
use dbmanager::logic::replica::Replica;
use dbmanager::logic::state::{CausalContext, State, Version};
use dbmanager::logic::txn::{Value, Write};
use dbmanager::logic::version_vector::{ReplicaId, VersionVector};
use dbmanager::logic::view::as_of::{AsOfError, diff};
use dbmanager::logic::view::conflict;
use dbmanager::logic::view::past::{Filter, Past};
use dbmanager::logic::view::transfer;
use serde::Serialize;

/// The readable content of the database of a robot: nothing that may not be on the disk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Readable<'a> {
    pub(super) replica: &'a Replica,
    pub(super) state: &'a State,
    /// The state below `local/`.
    pub(super) local: &'a State,
    /// States from which the states at earlier moments are computed.
    pub(super) checkpoints: &'a Checkpoints,
    pub(super) robot: &'a str,
}

impl<'a> Readable<'a> {
    pub(super) fn past(&self) -> Past<'a> {
        Past { log: self.replica.log(), state: self.state }
    }

    /// Returns the versions of a key.
    pub(super) fn versions(&self, key: &Key) -> &'a [Version] {
        if key.namespace() == Namespace::Local { self.local.versions(key) } else { self.state.versions(key) }
    }

    /// Answers with the changes to keys and their authors that this replica has kept. A replica that has joined a
    /// team begins with a state, and a long log is cut.
    pub(super) fn history(&self, filter: &Filter, say: &mut impl FnMut(Reply)) {
        if let Some(gone) = self.forgotten() {
            say(Reply::Note(format!("{gone} not kept on `{}`, where others may have more", self.robot)));
        }
        parts(self.past().history(filter)).into_iter().for_each(|part| say(Reply::History(part)));
    }

    /// Returns how many transactions are no longer kept. Nothing if all transactions are kept.
    fn forgotten(&self) -> Option<String> {
        let gone: u64 = self.replica.log().low().iter().map(|(_, seq)| seq).sum();
        (gone > 0).then(|| counted(gone, "older transaction"))
    }

    /// Answers with the unsettled conflicts below a prefix.
    pub(super) fn conflicts(&self, prefix: &str, say: &mut impl FnMut(Reply)) {
        let past = self.past();
        if let Some(gone) = self.forgotten() {
            say(Reply::Note(format!(
                "{gone} not kept on `{}`: races among them are listed where they are",
                self.robot
            )));
        }
        let (mut conflicts, mut races) = (parts(past.conflicts(prefix)), parts(past.races(prefix)).into_iter());
        let last = conflicts.pop().unwrap_or_default();
        conflicts.into_iter().for_each(|part| say(Reply::Conflicts(part, Vec::new())));
        say(Reply::Conflicts(last, races.next().unwrap_or_default()));
        races.for_each(|part| say(Reply::Conflicts(Vec::new(), part)));
    }

    /// Answers with the changes from one moment to another.
    pub(super) fn diff(&self, [from, to]: [&AsOf; 2], prefix: &str, say: &mut impl FnMut(Reply)) {
        let states = self.at(from, prefix).and_then(|before| Ok((before, self.at(to, prefix)?)));
        match states {
            Ok((before, after)) => {
                parts(diff(&before, &after, prefix)).into_iter().for_each(|part| say(Reply::Differences(part)));
            }
            Err(why) => say(Reply::Refused(why.to_string())),
        }
    }

    /// Returns the state at a moment. If the moment is a date, the state is right only for keys below `prefix`.
    pub(super) fn at(&self, moment: &AsOf, prefix: &str) -> Result<State, AsOfError> {
        let past = self.past();
        match moment {
            AsOf::Now => Ok(self.state.clone()),
            AsOf::Version(version) => past.at(version, self.checkpoints.before(version)),
            AsOf::Date(millis) => {
                let version = past.vector_at(*millis, prefix, self.checkpoints.oldest())?;
                past.at(&version, self.checkpoints.before(&version))
            }
            AsOf::On(robot) => {
                let version = self.known_on(robot)?;
                past.at(&version, self.checkpoints.before(&version))
            }
        }
    }

    /// Returns the transactions of this copy that, as far as this replica knows, the named robot also has.
    fn known_on(&self, robot: &str) -> Result<VersionVector, AsOfError> {
        let named = self.replica.members().active().filter(|(_, name)| *name == robot).map(|(origin, _)| origin);
        let origins: Vec<ReplicaId> = named.collect();
        if origins.is_empty() {
            return Err(AsOfError::NoMember { robot: robot.to_owned() });
        }
        if origins.contains(&self.replica.origin()) {
            return Ok(self.replica.log().vector().clone());
        }
        let mut known = VersionVector::default();
        origins.iter().filter_map(|origin| self.replica.acked(*origin)).for_each(|acked| known.join(acked));
        // The robot may have more transactions than this copy.
        known.meet(self.replica.log().vector());
        Ok(known)
    }

    /// Returns the version vector of a moment.
    pub(super) fn version(&self, moment: &AsOf) -> Reply {
        let version: Result<VersionVector, AsOfError> = match moment {
            AsOf::Now => Ok(self.replica.log().vector().clone()),
            AsOf::Version(version) => Ok(version.clone()),
            AsOf::Date(millis) => self.past().vector_at(*millis, "", self.checkpoints.oldest()),
            AsOf::On(robot) => self.known_on(robot),
        };
        version.map_or_else(|why| Reply::Refused(why.to_string()), Reply::Version)
    }

    /// Returns the state that a read below a prefix finds at a moment. Local keys have no past.
    pub(super) fn readable(&self, prefix: &str, moment: &AsOf) -> Result<State, String> {
        match moment {
            AsOf::Now if prefix.starts_with(LOCAL) || LOCAL.starts_with(prefix) => Ok(self.everything()),
            AsOf::Version(_) | AsOf::Date(_) | AsOf::On(_) if prefix.starts_with(LOCAL) => {
                Err("keys below `local/` have no history; only their present values can be shown".to_owned())
            }
            AsOf::Now | AsOf::Version(_) | AsOf::Date(_) | AsOf::On(_) => {
                self.at(moment, prefix).map_err(|why| why.to_string())
            }
        }
    }

    /// Returns the state together with the local keys.
    fn everything(&self) -> State {
        let (mut all, none) = (self.state.clone(), VersionVector::default());
        for (key, versions) in self.local.scan("") {
            for Version { dot, stamp, value } in versions {
                let write = Write { key: key.clone(), value: value.clone() };
                all.apply(*dot, *stamp, CausalContext { context: &none, only: None }, &[write]);
            }
        }
        all
    }

    /// Answers with the keys below a prefix as a file.
    pub(super) fn export(&self, prefix: &str, moment: &AsOf, say: &mut impl FnMut(Reply)) {
        match self.readable(prefix, moment) {
            Ok(state) => {
                let file = transfer::export(&state, prefix);
                let mut part = String::new();
                for line in file.split_inclusive('\n') {
                    part.push_str(line);
                    if part.len() > REPLY_SIZE_MAX {
                        say(Reply::Text(std::mem::take(&mut part)));
                    }
                }
                say(Reply::Text(part));
            }
            Err(why) => say(Reply::Refused(why)),
        }
    }

    /// Returns the reply for a key without a conflict: the key has the chosen value already, or it has another one and
    /// nothing was written.
    pub(super) fn settled_already(&self, key: &Key, choice: &Choice) -> Reply {
        let versions = self.replica.state().versions(key);
        let is_so = match choice {
            Choice::Shown => !versions.is_empty(),
            Choice::Value(value) => versions.last().and_then(|one| one.value.as_ref()) == value.as_ref(),
            Choice::By(name) => versions.iter().any(|one| self.past().robot(one.stamp.origin) == *name),
            Choice::Txn(dot) => versions.iter().any(|one| one.dot == *dot),
        };
        if is_so {
            return Reply::Done(format!("no conflict at `{key}`"));
        }
        if versions.iter().all(|one| one.value.is_none()) {
            return Reply::Refused(format!("nothing was written: `{key}` has neither a conflict nor a value"));
        }
        Reply::Refused(format!(
            "nothing was written: `{key}` has no conflict, and has another value; `dca db get {key}` shows the value, and `dca db put` \
             changes it"
        ))
    }

    /// Returns the transaction that settles a key with a conflict: one more write, which has seen all of the others.
    pub(super) fn settle(&self, resolve: &Resolve) -> Result<Commit, Reply> {
        let Resolve { key, choice, reason, level, within, seen } = resolve;
        let versions = self.replica.state().versions(key);
        if *seen != conflict::seen(versions.iter().map(|version| version.dot)) {
            let what = if seen.is_empty() {
                "say which writes you have seen"
            } else {
                "the writes are no longer those that you have seen"
            };
            return Err(Reply::Refused(format!(
                "nothing is settled: {what}; `dca db conflicts {key}` lists those at `{key}`, with the value for `--seen`"
            )));
        }
        let robot = |version: &Version| self.past().robot(version.stamp.origin);
        let pick = |found: Vec<&Version>, what: &str| match found.as_slice() {
            [version] => Ok(version.value.clone()),
            [] => {
                Err(Reply::Refused(format!("`{key}` has no write {what}; `dca db conflicts {key}` lists the writes")))
            }
            _ => Err(Reply::Refused(format!("`{key}` has several writes {what}; name the transaction"))),
        };
        let value = match choice {
            Choice::Value(value) => value.clone(),
            Choice::Shown => versions.last().and_then(|version| version.value.clone()),
            Choice::By(name) => {
                pick(versions.iter().filter(|one| robot(one) == *name).collect(), &format!("by `{name}`"))?
            }
            Choice::Txn(dot) => pick(versions.iter().filter(|one| one.dot == *dot).collect(), &format!("named {dot}"))?,
        };
        let writes = vec![Write { key: key.clone(), value }];
        Ok(Commit { reason: reason.clone(), requires: vec![], writes, level: level.clone(), within: *within })
    }
}

/// Returns the answer with the versions of one key. If the key has no versions, the answer has no entry.
pub(super) fn entries(key: &Key, versions: &[Version]) -> Reply {
    Reply::Entries(if versions.is_empty() { Vec::new() } else { vec![(key.clone(), versions.to_vec())] })
}

/// Answers with the keys below a prefix, in parts of a bounded size.
pub(super) fn list(state: &State, prefix: &str, say: &mut impl FnMut(Reply)) {
    let (mut entries, mut size) = (Vec::new(), 0);
    for (key, versions) in state.scan(prefix) {
        let bytes = |value: &Value| value.bytes.len();
        size += key.as_str().len()
            + versions.iter().map(|version| 64 + version.value.as_ref().map_or(0, bytes)).sum::<usize>();
        entries.push((key.clone(), versions.to_vec()));
        if size > REPLY_SIZE_MAX {
            say(Reply::Entries(std::mem::take(&mut entries)));
            size = 0;
        }
    }
    say(Reply::Entries(entries));
}

/// Returns items in parts of a bounded size. At least one part is returned.
fn parts<T: Serialize>(items: Vec<T>) -> Vec<Vec<T>> {
    let (mut parts, mut size) = (vec![Vec::new()], 0);
    for item in items {
        // An item that cannot be encoded is reported later, when it is sent.
        let bytes = postcard::to_stdvec(&item).map_or(0, |bytes| bytes.len());
        if size + bytes > REPLY_SIZE_MAX {
            parts.push(Vec::new());
            size = 0;
        }
        size += bytes;
        if let Some(part) = parts.last_mut() {
            part.push(item);
        }
    }
    parts
}
