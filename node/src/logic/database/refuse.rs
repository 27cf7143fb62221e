//! Refuses some requests at once, each with one sentence. The reasons are a level that cannot be reached, an invalid
//! key, a key in no namespace, and local keys for a caller on another machine.

use super::question::{AckLevel, AsOf, Commit, Question, Reply};
use crate::logic::table::counted;
use dbmanager::logic::key::{Key, Namespace};
use dbmanager::logic::replica::Replica;
use dbmanager::logic::txn::{Draft, TxnError};
use std::collections::BTreeSet;

/// The prefix of the keys that never leave the robot.
pub(super) const LOCAL: &str = "local/";
/// The refusal of local keys for a caller on another machine.
const ELSEWHERE: &str = "keys below `local/` can be read and written only on the robot's own machine";

/// Returns why a transaction cannot reach the level asked for, if a replica that it would have to reach is not
/// there.
pub(super) fn out_of_reach(replica: &Replica, own: &str, level: &AckLevel) -> Option<String> {
    let members = replica.members().active().map(|(_, robot)| robot);
    let others: BTreeSet<&str> = members.filter(|robot| *robot != own).collect();
    match level {
        AckLevel::Local | AckLevel::Everywhere => None,
        AckLevel::On(_) | AckLevel::Replicated(_) if !replica.is_member() => Some(format!(
            "nothing was written: `{own}` belongs to no team yet, so the write cannot reach other robots; `dca db status` says how to \
             join a team"
        )),
        AckLevel::On(robots) => {
            let known = |robot: &&String| *robot == own || others.contains(robot.as_str());
            let unknown = robots.iter().find(|robot| !known(robot))?;
            Some(format!("nothing was written: the database has no member `{unknown}`; `dca db status` lists them"))
        }
        AckLevel::Replicated(count) => {
            let there = u64::try_from(others.len()).unwrap_or(u64::MAX);
            (u64::from(*count) > there).then(|| {
                let robots = counted(there, "robot");
                format!("nothing was written: the team has {robots} besides `{own}`, so the write cannot reach {count} robots")
            })
        }
    }
}

/// Returns why a draft is refused for its keys: a key is invalid or in no namespace. Such a key can still be deleted if
/// it exists. Nothing if the keys are right.
pub(super) fn namespaces(draft: &Draft) -> Option<String> {
    let written = || draft.writes().filter(|(_, value)| value.is_some()).map(|(key, _)| key);
    let granted = draft.grants().map(|(prefix, _)| prefix);
    if let Some(why) = written().find_map(|key| Key::new(key.as_str()).err()) {
        return Some(format!("nothing was written: {why}"));
    }
    let lost = written().filter(|key| !is_at_home(key)).chain(granted.filter(|prefix| !begins_well(prefix))).next()?;
    Some(format!(
        "nothing was written: `{lost}` does not belong to a namespace; a key is `team/NAME`, `robot/ROBOT/NAME` or `local/NAME`"
    ))
}

/// Returns whether a key belongs to users. Keys of the database itself are refused in another place, with another sentence.
fn is_at_home(key: &Key) -> bool {
    let segments = key.as_str().split('/').count();
    match key.namespace() {
        Namespace::Robot(_) => segments > 2,
        Namespace::Local | Namespace::System => segments > 1,
        Namespace::Team => segments > 1 && begins_well(key),
    }
}

fn begins_well(key: &Key) -> bool {
    key.namespace() != Namespace::Team || key.as_str().split('/').next() == Some("team")
}

/// Returns the answer to a transaction that was not committed.
pub(super) fn unmet_or_refused(why: &TxnError) -> Reply {
    if let TxnError::Precondition { key, .. } = why {
        return Reply::Unmet { key: key.clone(), why: why.to_string() };
    }
    Reply::Refused(why.to_string())
}

/// Returns the question of a caller on another machine, changed so that its answer has no local keys.
///
/// # Errors
/// The question is about local keys. The text is for a person.
pub(super) fn from_elsewhere(mut question: Question, now: &AsOf) -> Result<Question, String> {
    let own = |key: &Key| key.namespace() == Namespace::Local;
    let below = |prefix: &str| prefix.starts_with(LOCAL);
    let refused = match &question {
        Question::Get { key } => own(key),
        Question::List { prefix, .. } | Question::Export { prefix, .. } => below(prefix),
        Question::Commit(Commit { requires, writes, .. }) => {
            requires.iter().map(|require| &require.key).chain(writes.iter().map(|write| &write.key)).any(own)
        }
        Question::Resolve(resolve) => own(&resolve.key),
        Question::Own(grant) => own(&grant.prefix),
        // The answers to these questions have no local keys.
        Question::Status
        | Question::Found
        | Question::Retire { .. }
        | Question::RetireOlder { .. }
        | Question::Join { .. }
        | Question::HealClock
        | Question::History(_)
        | Question::Conflicts { .. }
        | Question::Diff { .. }
        | Question::Version(_)
        | Question::Watch { .. }
        | Question::Follow { .. }
        | Question::Owners => false,
    };
    if refused {
        return Err(ELSEWHERE.to_owned());
    }
    if let Question::List { prefix, at } | Question::Export { prefix, at } = &mut question {
        // The present readable state includes local keys. The same state, named by its transactions, has none.
        if LOCAL.starts_with(prefix.as_str()) && *at == AsOf::Now {
            *at = now.clone();
        }
    }
    Ok(question)
}
