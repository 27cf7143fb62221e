//! Carries out the orders of clients.

use super::super::parameters::{commit, homes};
use super::super::serve::ORDER_WITHIN;
use crate::client::{Client, Clients, words};
use crate::io::taps::Taps;
use crate::io::user;
use crate::live::Live;
use crate::logic::foxglove::{
    Answer, Given, GivenValue, Order, ParameterValue, Parameters, ProcedureCall, ProgramName, Ticket,
};
use crate::logic::object;
use crate::logic::process_name::DeploymentName;
use crate::object::{Callee, sentence, signed};
use crate::{ConnectArgs, estop, orders, param, stop};
use comms::logic::object::ObjectError;
use node::logic::protocol::{Estop, Request};
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;
use view::{Model, RobotId};

/// How long a procedure has to answer. A client such as Foxglove waits without an end.
const CALL_WITHIN: Duration = Duration::from_secs(10);

/// The result of an order.
pub(super) struct Carried {
    pub(super) viewer: u64,
    pub(super) ticket: Ticket,
    pub(super) answer: Answer,
}

/// The ways to robots that an order needs.
struct Ways {
    clients: Clients,
    connect: ConnectArgs,
    taps: Option<Arc<Taps>>,
    /// The host of each program that should run, by deployment and path: `door:main/hit`.
    homes: BTreeMap<String, String>,
    /// The connection to the program that is called, and its host.
    callee: Option<(Arc<Client>, String)>,
}

/// Carries an order out.
pub(super) fn give(
    given: Given,
    live: &Live,
    model: &Model,
    taps: Option<Arc<Taps>>,
) -> impl Future<Output = Carried> + Send + use<> {
    let robot = given.callee().and_then(|program| robot_of(model, program));
    let Given { viewer, ticket, order } = given;
    let callee = robot.and_then(|robot| Some((live.client_of(&robot)?, robot.host)));
    let ways = Ways { clients: live.clients(), connect: live.connect(), taps, homes: homes(model), callee };
    async move {
        let answer = timeout(ORDER_WITHIN, carry_out(order, ways)).await.unwrap_or_else(|_| {
            Answer::Failed(format!("no result within {} s: it may have been carried out", ORDER_WITHIN.as_secs()))
        });
        Carried { viewer, ticket, answer }
    }
}

/// Returns the robot of a program.
fn robot_of(model: &Model, program: &ProgramName) -> Option<RobotId> {
    let live = model.deployments().find(|live| live.id == program.mission)?;
    Some(live.id.robot(&live.processes.get(&program.path)?.host))
}

async fn carry_out(order: Order, ways: Ways) -> Answer {
    match order {
        Order::Parameters { names } => {
            let read = parameters(&ways.clients).await;
            Answer::Values { problems: read.unread(&ways.homes), values: named(read.values, &names) }
        }
        Order::SetParameters { values } => set_parameters(&ways, values).await,
        Order::Call(call) => called(&ways, *call).await,
        Order::Stop(name) => stopped(&ways.clients, &name).await,
        Order::Estop { reason } => everywhere(&ways, Request::Estop(Estop { by: user::name_and_host(), reason })).await,
        Order::Release => everywhere(&ways, Request::ReleaseEstop).await,
    }
}

/// Returns the values of these names, or all if none is named.
fn named(mut values: Vec<ParameterValue>, names: &[String]) -> Vec<ParameterValue> {
    values.retain(|one| names.is_empty() || names.contains(&one.name));
    values
}

/// Reads all parameters that can be reached.
pub(super) async fn parameters(clients: &Clients) -> Parameters {
    let mut all = Parameters::default();
    for client in clients.iter() {
        if let Err(failure) = param::live::read(client, &mut all).await {
            all.problems.push(format!("parameters cannot be read: {}", words(&failure)));
        }
    }
    all
}

async fn set_parameters(ways: &Ways, mut values: Vec<GivenValue>) -> Answer {
    let names: Vec<String> = values.iter().map(|one| one.name.clone()).collect();
    let commit = commit(ways.connect.clone());
    let mut problems = Vec::new();
    for client in ways.clients.iter() {
        if values.is_empty() {
            break;
        }
        match param::live::set(client, &commit, &mut values).await {
            Ok(more) => problems.extend(more),
            Err(failure) => problems.push(format!("not everything was set: {}", words(&failure))),
        }
    }
    // The client gets the present value, even if it has requested another value.
    let present = parameters(&ways.clients).await;
    problems.extend(values.iter().map(|one| present.not_set(&one.name, &ways.homes)));
    problems.extend(present.unread(&ways.homes));
    Answer::Values { values: named(present.values, &names), problems }
}

async fn called(ways: &Ways, call: ProcedureCall) -> Answer {
    let ProcedureCall { program: ProgramName { mission, path }, exported, exports, argument } = call;
    let deployment = mission.deployment;
    let (Some((client, host)), Some(taps)) = (&ways.callee, &ways.taps) else {
        return Answer::Failed(format!("`{path}` cannot be reached"));
    };
    let prepared = taps.prepare(&exported, argument, CALL_WITHIN);
    let callee = Callee { deployment: &deployment, host, path: &path };
    let call = match signed(client, callee, exported.access, prepared).await {
        Ok(call) => call,
        Err(failure) => return Answer::Failed(words(&failure)),
    };
    match taps.call(&deployment.name, &path, call).await {
        Ok(Ok(bytes)) => {
            let result = object::result(&exports, &exported.signature, &bytes);
            Answer::Done(if result.is_null() { json!({}) } else { result })
        }
        Ok(Err(error)) => Answer::Failed(told(&path, &exported.name, &error)),
        Err(failure) => Answer::Failed(words(&failure)),
    }
}

/// Returns the sentence about a call that has no result. It says so if the call may have been carried out.
fn told(path: &str, name: &str, error: &ObjectError) -> String {
    let doubt = if error.may_have_happened() { "; the call may have been carried out" } else { "" };
    format!("{}{doubt}", sentence(path, name, error))
}

async fn stopped(clients: &Clients, name: &DeploymentName) -> Answer {
    match stop::stop(clients, name).await {
        Ok(ended) => {
            let done = || format!("`{}` is stopped; nothing of it is left", name.text());
            let text = ended.failure.as_ref().map_or_else(done, words);
            Answer::Done(json!({
                "confirmed": ended.is_stopped && ended.failure.is_none(), "stopped": ended.is_stopped,
                "unconfirmed": ended.unconfirmed, "may_go_on": ended.may_go_on, "text": text,
            }))
        }
        Err(failure) => Answer::Failed(words(&failure)),
    }
}

async fn everywhere(ways: &Ways, request: Request) -> Answer {
    match orders::outcomes(&ways.clients, &ways.connect, &request).await {
        Ok(outcomes) => {
            let hosts: Vec<_> = outcomes.iter().map(|(host, outcome)| estop::in_json(host, outcome)).collect();
            let is_confirmed = outcomes.values().all(estop::Outcome::is_confirmed);
            Answer::Done(json!({ "confirmed": is_confirmed, "hosts": hosts, "text": orders::in_one_line(&outcomes) }))
        }
        Err(failure) => Answer::Failed(words(&failure)),
    }
}
