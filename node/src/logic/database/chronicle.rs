//! What a home writes down of its deployments: what was deployed, by whom, how it ended.
//!
//! `robot/<home>/deployments/<name>/<epoch>/begun` and `…/ended`, each a table. The latest of each name are kept.

use super::question::{Commit, Far};
use crate::logic::protocol::{Deployment, Ending, Report};
use dbmanager::logic::key::Key;
use dbmanager::logic::txn::Write;
use dbmanager::logic::view::value::Datum;
use language::plan::Plan;
use std::collections::BTreeMap;
use std::time::Duration;

/// How many deployments of one name are kept.
const KEPT: u64 = 100;

/// Returns what is written down when a deployment begins.
pub fn begun(home: &str, deployment: &Deployment, plan: &Plan, by: &str) -> Commit {
    let hosts = plan.hosts.iter().map(|host| Datum::from(host.as_str())).collect();
    let fields = [
        ("by", Datum::from(by)),
        ("hosts", Datum::List(hosts)),
        ("programs", Datum::Integer(i64::try_from(plan.leaves.len()).unwrap_or(i64::MAX))),
    ];
    let mut commit = commit(home, deployment, "begun", fields);
    if let Some(old) = deployment.epoch.checked_sub(KEPT) {
        let old = Deployment { name: deployment.name.clone(), epoch: old };
        let keys = ["begun", "ended"].into_iter().filter_map(|what| key(home, &old, what));
        commit.writes.extend(keys.map(|key| Write { key, value: None }));
    }
    commit
}

/// Returns what is written down when a deployment is over; nothing if its reports do not say how it ended.
pub fn ended(home: &str, deployment: &Deployment, reports: &[Report]) -> Option<Commit> {
    let fields = reports.iter().rev().find_map(|report| match report {
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
        | Report::Process { .. } => None,
    })?;
    Some(commit(home, deployment, "ended", fields))
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
    // A value that is too long is not written down; that the deployment ran does not depend on it.
    let writes = key(home, deployment, what).filter(|_| value.is_some()).map(|key| Write { key, value });
    Commit {
        reason: format!("`{}` has {what}", deployment.name),
        requires: Vec::new(),
        writes: writes.into_iter().collect(),
        far: Far::Local,
        within: Duration::ZERO,
    }
}

fn key(home: &str, deployment: &Deployment, what: &str) -> Option<Key> {
    // A name may have characters that a key must not have.
    let plain = |c: char| if c.is_control() || "*$?#/".contains(c) { '_' } else { c };
    let name: String = deployment.name.chars().map(plain).collect();
    Key::new(format!("robot/{home}/deployments/{name}/{}/{what}", deployment.epoch)).ok()
}
