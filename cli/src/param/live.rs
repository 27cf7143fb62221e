//! Parameters for a view that stays connected: reads their present values, and changes them.

use super::{Program, Reached, active, datum, programs_of};
use crate::client::{Client, words};
use crate::db::databases::Databases;
use crate::db::write::{CommitArgs, CommitProgress};
use crate::logic::foxglove::{GivenValue, ParameterValue, Parameters};
use anyhow::anyhow;
use dbmanager::logic::key::Key;
use dbmanager::logic::txn::Write;
use language::plan::Accepts;
use node::console::Failure;
use serde_json::Value;

/// Adds the present values of the parameters of all running programs that a connection reaches. The names are such as
/// `door:main/hit/force.threshold`. Leaves out secrets.
pub(crate) async fn read(client: &Client, all: &mut Parameters) -> Result<(), Failure> {
    let Reached { programs, answered, silent } = programs_of(&through(client).await?).await?;
    // A ROS 2 node keeps its parameters itself.
    let ours = programs.iter().filter(|program| program.told.ros_node.is_none());
    all.values.extend(ours.flat_map(Program::values));
    all.answered.extend(answered);
    all.silent.extend(silent);
    Ok(())
}

/// Returns the parameters of all running programs that a connection reaches, as `dca param list --json` prints them. `all`
/// gets the nodes that answer, the nodes that do not, and a sentence for each program whose parameters are not known.
pub(crate) async fn list(client: &Client, all: &mut Parameters) -> Result<Vec<Value>, Failure> {
    let Reached { programs, answered, silent } = programs_of(&through(client).await?).await?;
    all.answered.extend(answered);
    all.silent.extend(silent);
    all.problems.extend(programs.iter().filter_map(|program| {
        let name = program.name();
        match (&program.told.ros_node, &program.told.parameters) {
            (Some(_), _) => Some(format!("`{name}` is a ROS 2 node: `dca param list {name}` asks it")),
            (None, None) => Some(format!("the parameters of `{name}` are not known")),
            (None, Some(_)) => None,
        }
    }));
    let ours = programs.iter().filter(|program| program.told.ros_node.is_none());
    Ok(ours.flat_map(Program::json).collect())
}

/// Sets a parameter, or undoes its change. Returns a sentence that says when the program begins to use the value. Returns
/// nothing if the connection does not reach the program.
pub(crate) async fn change(
    client: &Client,
    commit: &CommitArgs,
    given: &GivenValue,
) -> Result<Option<String>, Failure> {
    let databases = through(client).await?;
    let Reached { programs, silent, .. } = programs_of(&databases).await?;
    let Some((program, parameter)) = parameter_of(&programs, &given.name) else {
        let why = silent.into_iter().next().map(|(host, why)| anyhow!("host `{host}` does not answer: {why}"));
        return why.map_or(Ok(None), |why| Err(Failure::Unreachable(why)));
    };
    set_one(&databases, commit, program, parameter, given.value.as_ref()).await?;
    Ok(Some(match databases.statuses().await {
        Ok((nodes, _)) => program.counts_from(&active(&nodes)),
        Err(failure) => format!("it is not known whether `{}` uses the value now: {}", program.name(), words(&failure)),
    }))
}

/// Sets parameters, or undoes changes. Returns a sentence for each change that failed. `values` keeps the names of
/// programs that this connection does not reach.
pub(crate) async fn set(
    client: &Client,
    commit: &CommitArgs,
    values: &mut Vec<GivenValue>,
) -> Result<Vec<String>, Failure> {
    let databases = through(client).await?;
    let Reached { programs, .. } = programs_of(&databases).await?;
    let mut problems = Vec::new();
    for given in std::mem::take(values) {
        match parameter_of(&programs, &given.name) {
            None => values.push(given),
            Some((program, parameter)) => {
                if let Err(failure) = set_one(&databases, commit, program, parameter, given.value.as_ref()).await {
                    problems.push(format!("`{}` was not set: {}", given.name, words(&failure)));
                }
            }
        }
    }
    Ok(problems)
}

async fn through(client: &Client) -> Result<Databases<'_>, Failure> {
    let robot = match client.local() {
        Some(local) => Some(local.to_owned()),
        None => client.all().await?.into_iter().next(),
    };
    let robot = robot.ok_or_else(|| Failure::Unreachable(anyhow!("no node answers")))?;
    Ok(Databases::through(client, robot))
}

async fn set_one(
    databases: &Databases<'_>,
    commit: &CommitArgs,
    program: &Program,
    name: &str,
    value: Option<&Value>,
) -> Result<(), Failure> {
    let parameter = program.parameter(name)?;
    let write = match value {
        None | Some(Value::Null) => {
            let set = program.set.get(&parameter.name).and_then(|set| set.last());
            let Some((key, _)) = set else { return Ok(()) };
            Write { key: Key::new(key.clone())?, value: None }
        }
        Some(_) if parameter.accepts == Accepts::Secret => {
            return Err(anyhow!("it is a secret; `dca db put --secret` changes it").into());
        }
        Some(value) => {
            let text = match value {
                Value::String(text) => text.clone(),
                Value::Number(_) | Value::Bool(_) => value.to_string(),
                Value::Null | Value::Array(_) | Value::Object(_) => {
                    return Err(anyhow!("expected {}, not {value}", parameter.accepts).into());
                }
            };
            let read =
                parameter.accepts.read(&text).map_err(|expected| anyhow!("expected {expected}, not `{text}`"))?;
            let datum = datum(&parameter.accepts, &read)?;
            Write { key: Key::new(program.key(&parameter.name))?, value: Some(datum.encode()?) }
        }
    };
    let question = commit.question(commit.reason_or(""), vec![], vec![write]);
    match commit.write_on(databases, &question).await? {
        CommitProgress::AckLevel(_) | CommitProgress::Done(_) => Ok(()),
        CommitProgress::Pending(_) => Err(commit.pending()),
    }
}

/// Returns the program and the parameter with this name.
fn parameter_of<'a>(programs: &'a [Program], name: &'a str) -> Option<(&'a Program, &'a str)> {
    let (program, parameter) = name.rsplit_once('.')?;
    Some((programs.iter().find(|one| one.name() == program)?, parameter))
}

impl Program {
    /// Returns the present values of the program's parameters.
    fn values(&self) -> Vec<ParameterValue> {
        let statuses = self.told.parameters.iter().flatten();
        let shown = statuses.filter(|status| status.parameter.accepts != Accepts::Secret);
        let value = |name: &String| {
            let value = serde_json::from_str(&self.value(name)?.to_json()).ok()?;
            Some(ParameterValue { name: format!("{}.{name}", self.name()), value })
        };
        shown.filter_map(|status| value(&status.parameter.name)).collect()
    }
}
