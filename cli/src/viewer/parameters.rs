//! The parameters on the page: their list, and changes of their values.

use super::ways::{READ_WITHIN, Ways};
use crate::ConnectArgs;
use crate::client::{Client, words};
use crate::db::databases::DatabaseArgs;
use crate::db::write::CommitArgs;
use crate::live::Live;
use crate::logic::foxglove::{GivenValue, Parameters};
use crate::param;
use comms::io::clock;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;
use view::{Model, RobotId};

/// How long a change of a parameter has to be on a disk.
const COMMIT_WITHIN: Duration = Duration::from_secs(5);
/// The most parameters on the page.
const SHOWN_MAX: usize = 500;

/// Returns the options of a change that a person makes in a view.
pub(super) fn commit(connect: ConnectArgs) -> CommitArgs {
    CommitArgs::local("set in a viewer".to_owned(), COMMIT_WITHIN, DatabaseArgs::of(connect))
}

/// Returns the host of each program that should run, by deployment and path: `door:main/hit`.
pub(super) fn homes(model: &Model) -> BTreeMap<String, String> {
    let running = model.deployments().filter(|live| live.end.is_none());
    let programs = running.flat_map(|live| {
        let name = |path: &String| format!("{}:{path}", live.id.deployment.name);
        live.processes
            .iter()
            .filter(|(_, one)| one.pid.is_some())
            .map(move |(path, one)| (name(path), one.host.clone()))
    });
    programs.collect()
}

/// Returns the parameters of all robots as JSON, and a sentence for each robot whose parameters are not known.
pub(super) async fn list(ways: Ways, homes: BTreeMap<String, String>) -> Value {
    let (mut all, mut rows) = (Parameters::default(), Vec::new());
    let until = clock::now() + READ_WITHIN;
    for client in &ways.clients {
        let within = until.since(clock::now());
        match timeout(within, param::live::list(client, &mut all)).await {
            Ok(Ok(listed)) => rows.extend(listed.into_iter().map(|row| of_robot(client, row))),
            Ok(Err(failure)) => all.problems.push(format!("parameters cannot be read: {}", words(&failure))),
            Err(_) => {
                all.problems.push(format!("parameters cannot be read: no answer within {} s", READ_WITHIN.as_secs()));
            }
        }
    }
    let mut notes = all.unread(&homes);
    if rows.len() > SHOWN_MAX {
        notes.push(format!("not shown: {} parameters; `dca param list` lists all", rows.len() - SHOWN_MAX));
        rows.truncate(SHOWN_MAX);
    }
    json!({ "parameters": rows, "notes": notes })
}

/// Adds the robot to a parameter. Two commands may have robots of one name.
fn of_robot(client: &Client, mut row: Value) -> Value {
    let host = row.get("host").and_then(Value::as_str).unwrap_or_default().to_owned();
    row["robot"] = RobotId { host, fleet: client.fleet() }.to_string().into();
    row
}

/// A change of a parameter of a robot.
pub(super) struct ParameterChange {
    robot: String,
    client: Option<Arc<Client>>,
    connect: ConnectArgs,
    given: GivenValue,
}

impl ParameterChange {
    /// Reads a change that the page asks for. Without a value, an earlier change is undone.
    pub(super) fn read(body: &Value, live: &Live, model: &Model) -> Option<Self> {
        let text = |name: &str| Some(body.get(name)?.as_str()?.to_owned());
        let (robot, name) = (text("robot")?, text("name")?);
        let value = match body.get("value") {
            None | Some(Value::Null) => None,
            Some(value) => Some(Value::String(value.as_str()?.to_owned())),
        };
        let id = model.robots().map(|one| &one.id).find(|id| id.to_string() == robot);
        let client = id.and_then(|id| live.client_of(id));
        Some(Self { robot, client, connect: live.connect(), given: GivenValue { name, value } })
    }

    /// Carries the change out. Returns the result in one sentence, as `dca param set` prints it.
    pub(super) async fn carry_out(self) -> String {
        let Self { robot, client, connect, given } = self;
        let name = &given.name;
        let not_set = |why: &str| format!("NOT DONE: `{name}` was not set: {why}");
        let Some(client) = client else { return not_set(&format!("`{robot}` does not answer")) };
        match param::live::change(&client, &commit(connect), &given).await {
            Ok(Some(counts)) => match &given.value {
                Some(value) => format!("`{name}` is set to {}; {counts}", value.as_str().unwrap_or_default()),
                None => format!("`{name}` has the value of the spec again; {counts}"),
            },
            Ok(None) => not_set("there is no such parameter"),
            Err(failure) => not_set(&words(&failure)),
        }
    }
}
