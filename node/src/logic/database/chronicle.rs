//! The records of deployments that a home writes: the plan, the user who deployed it, and the result.
//!
//! The keys are `robot/<home>/deployments/<name>/<epoch>/begun` and `…/ended`, and each value is a table. The latest
//! records of each name are kept. One counter gives the epochs of all names. So only the database, which has the
//! records, knows which epochs belong to a name.

use super::question::{AckLevel, Commit};
use crate::logic::history::History;
use crate::logic::protocol::{Deployment, Ending, Report};
use dbmanager::logic::key::Key;
use dbmanager::logic::state::State;
use dbmanager::logic::txn::Write;
use dbmanager::logic::view::value::Datum;
use language::plan::Plan;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How many deployments of one name are kept.
const KEPT: usize = 100;
/// How many records are removed at a time, at most.
const FORGOTTEN_MAX: usize = 512;

/// Returns the record of the beginning of a deployment.
pub fn begun(home: &str, deployment: &Deployment, plan: &Plan, by: &str) -> Commit {
    let hosts = plan.hosts.iter().map(|host| Datum::from(host.as_str())).collect();
    let fields = [
        ("by", Datum::from(by)),
        ("hosts", Datum::List(hosts)),
        ("programs", Datum::Integer(i64::try_from(plan.leaves.len()).unwrap_or(i64::MAX))),
    ];
    commit(home, deployment, "begun", fields)
}

/// Returns a record as the node writes it. The record of a beginning also removes the oldest records of the same name.
pub(super) fn trimmed(mut commit: Commit, state: &State) -> Commit {
    let Some((below, begun)) = commit.writes.iter().find_map(|write| beginning(&write.key)) else { return commit };
    let epoch = |key: &Key| key.as_str().strip_prefix(&below)?.split_once('/')?.0.parse::<u64>().ok();
    let there = state.scan(&below).filter(|(key, _)| state.get(key).is_some());
    let known: Vec<(u64, &Key)> = there.filter_map(|(key, _)| Some((epoch(key)?, key))).collect();
    let epochs: BTreeSet<u64> = known.iter().map(|(epoch, _)| *epoch).chain([begun]).collect();
    if let Some(oldest) = epochs.iter().rev().nth(KEPT - 1) {
        let old = known.iter().filter(|(epoch, _)| epoch < oldest && *epoch != begun).take(FORGOTTEN_MAX);
        commit.writes.extend(old.map(|(_, key)| Write { key: (*key).clone(), value: None }));
    }
    commit
}

/// If the key belongs to a beginning, returns the prefix of all deployments of its name, and its epoch.
fn beginning(key: &Key) -> Option<(String, u64)> {
    let (below, epoch) = key.as_str().strip_suffix("/begun")?.rsplit_once('/')?;
    let is_chronicle = below.starts_with("robot/") && below.split('/').nth(2) == Some("deployments");
    Some((format!("{below}/"), epoch.parse().ok().filter(|_| is_chronicle)?))
}

/// Returns the record of the end of a deployment; nothing if the end is not among the reports.
pub fn ended(home: &str, history: &History) -> Option<Commit> {
    let fields = history.latest().find_map(|report| match report {
        Report::Finished { ending, at, unconfirmed } => Some([
            ("how", Datum::from(words(ending).as_str())),
            ("after_s", Datum::float(at.as_secs_f64())),
            ("unconfirmed", Datum::List(unconfirmed.iter().map(|host| Datum::from(host.as_str())).collect())),
        ]),
        Report::Refused { reasons } => Some([
            ("how", Datum::from(format!("refused: {}", reasons.join("; ")).as_str())),
            ("after_s", Datum::float(0.0)),
            ("unconfirmed", Datum::List(Vec::new())),
        ]),
        Report::Accepted { .. }
        | Report::Prepared { .. }
        | Report::Connected { .. }
        | Report::Go { .. }
        | Report::Process { .. }
        | Report::Programs { .. }
        | Report::Changed { .. }
        | Report::Stepped { .. }
        | Report::Unchanged { .. }
        | Report::Replanned { .. }
        | Report::Aligned { .. }
        | Report::BeganLate { .. }
        | Report::Omitted { .. } => None,
    })?;
    Some(commit(home, history.deployment(), "ended", fields))
}

fn words(ending: &Ending) -> String {
    match ending {
        Ending::Done(_) => "done".to_owned(),
        Ending::Stopped => "stopped".to_owned(),
        Ending::Aborted(failure) => format!("aborted: {failure}"),
        Ending::Unconfirmed => "unconfirmed".to_owned(),
    }
}

fn commit<const N: usize>(home: &str, deployment: &Deployment, what: &str, fields: [(&str, Datum); N]) -> Commit {
    let table = fields.into_iter().map(|(name, datum)| (name.to_owned(), datum)).collect::<BTreeMap<_, _>>();
    let value = Datum::Table(table).encode().ok();
    // If a value is too long, no record is written. The deployment runs even without a record.
    let writes = key(home, deployment, what).filter(|_| value.is_some()).map(|key| Write { key, value });
    Commit {
        reason: format!("`{}` has {what}", deployment.name),
        requires: Vec::new(),
        writes: writes.into_iter().collect(),
        level: AckLevel::Local,
        within: Duration::ZERO,
    }
}

fn key(home: &str, deployment: &Deployment, what: &str) -> Option<Key> {
    Key::new(format!("{}{}/{what}", below(home, &deployment.name), deployment.epoch)).ok()
}

/// Returns the prefix of the records of all deployments of one name. The epoch follows the prefix.
pub fn below(home: &str, name: &str) -> String {
    // A name may have characters that are invalid in a key.
    let plain = |c: char| if c.is_control() || "*$?#/".contains(c) { '_' } else { c };
    let name: String = name.chars().map(plain).collect();
    format!("robot/{home}/deployments/{name}/")
}
