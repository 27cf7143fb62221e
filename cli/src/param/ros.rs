//! Parameters of a ROS 2 node. The node keeps them itself. They are read and set through the process that runs its program.

use super::{Program, datum_of};
use crate::ConnectArgs;
use crate::logic::node_parameter::{Kind, takes, value};
use crate::logic::process_name::ProcessName;
use crate::object::{Visit, visit};
use anyhow::{Context as _, anyhow};
use dbmanager::logic::view::value::Datum;
use node::console::Failure;
use node::logic::printable::printable;
use serde_json::{Value, json};
use std::time::Duration;

/// How long the node may take for each answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(5);

/// A parameter of a ROS 2 node.
pub(super) struct NodeParameter {
    pub(super) name: String,
    /// Nothing if the parameter is not set.
    pub(super) value: Option<Value>,
    pub(super) takes: String,
}

impl NodeParameter {
    /// Returns the value in the spec with which the node was started.
    fn given(&self, program: &Program) -> Option<Datum> {
        let mut statuses = program.told.parameters.iter().flatten();
        statuses.find(|status| status.parameter.name == self.name)?.given.as_ref().map(datum_of)
    }

    /// Returns a row of the list.
    pub(super) fn row(&self, program: &Program) -> Vec<String> {
        let value = self.value.as_ref().map_or_else(|| "-".to_owned(), |value| printable(&value.to_string()));
        let given = self.given(program).map_or_else(|| "-".to_owned(), |given| given.to_toml());
        vec![program.name(), printable(&self.name), value, given, self.takes.clone()]
    }

    /// Returns the parameter as JSON.
    pub(super) fn json(&self, program: &Program) -> Value {
        let given = self.given(program).and_then(|given| serde_json::from_str::<Value>(&given.to_json()).ok());
        json!({
            "deployment": program.told.deployment.name,
            "host": program.host,
            "instance": program.told.path,
            "module": program.told.module,
            "parameter": self.name,
            "value": self.value,
            "spec": given,
            "takes": self.takes,
            "unit": null,
            "key": null,
        })
    }
}

/// Returns the parameters of a node, sorted by name.
pub(super) fn list(connect: &ConnectArgs, program: &Program) -> Result<Vec<NodeParameter>, Failure> {
    with(connect, program, async |visit| {
        let mut names = names(visit, program).await?;
        names.sort();
        let asked = json!({ "names": names });
        let values = asked_for(visit, program, "get_parameters", &asked, "values").await?;
        let descriptors = asked_for(visit, program, "describe_parameters", &asked, "descriptors").await?;
        if values.len() != names.len() || descriptors.len() != names.len() {
            let name = program.name();
            return Err(anyhow!("the parameters of `{name}` have changed while they were asked for; try again").into());
        }
        let all = names.into_iter().zip(values.iter().zip(&descriptors));
        let one = |(name, (told, descriptor)): (String, (&Value, &Value))| NodeParameter {
            name,
            value: value(told),
            takes: takes(descriptor),
        };
        Ok(all.map(one).collect())
    })
}

/// Returns the value of a parameter.
pub(super) fn get(connect: &ConnectArgs, program: &Program, parameter: &str) -> Result<Value, Failure> {
    with(connect, program, async |visit| {
        let told = present(visit, program, parameter).await?;
        Ok(value(&told).unwrap_or_default())
    })
}

/// Sets a parameter. Returns the value that the node reports afterwards.
pub(super) fn set(connect: &ConnectArgs, program: &Program, parameter: &str, text: &str) -> Result<Value, Failure> {
    with(connect, program, async |visit| {
        let kind = present(visit, program, parameter).await.map(|told| Kind::of(&told))?;
        let kind = kind.context("the node does not report the type of the value")?;
        let written = kind.read(text).map_err(|expected| anyhow!("`{parameter}` cannot be `{text}`: {expected}"))?;
        let asked = json!({ "parameters": [{ "name": parameter, "value": written }] });
        let results = asked_for(visit, program, "set_parameters", &asked, "results").await?;
        let result =
            results.first().with_context(|| format!("`{}` has not said whether it was set", program.name()))?;
        if result.get("successful").and_then(Value::as_bool) == Some(true) {
            return Ok(value(&written).unwrap_or_default());
        }
        let why = result.get("reason").and_then(Value::as_str).unwrap_or_default();
        let why = if why.is_empty() { "it gives no reason" } else { why };
        Err(anyhow!("`{parameter}` of `{}` was not set: the node refuses `{text}`: {why}", program.name()).into())
    })
}

fn with<T>(
    connect: &ConnectArgs,
    program: &Program,
    work: impl AsyncFnOnce(&Visit<'_>) -> Result<T, Failure>,
) -> Result<T, Failure> {
    visit(connect, &ProcessName::new(&program.name()), ANSWER_WITHIN, work)
}

/// Returns the value of a parameter with its kind, as reported by the node.
async fn present(visit: &Visit<'_>, program: &Program, parameter: &str) -> Result<Value, Failure> {
    let asked = json!({ "names": [parameter] });
    let told = asked_for(visit, program, "get_parameters", &asked, "values").await?;
    match told.into_iter().next().filter(|told| Kind::of(told).is_some()) {
        Some(told) => Ok(told),
        // The node's answer has no value for a name that it does not know.
        None => {
            let names = names(visit, program).await?;
            let hint = match language::nearest(parameter, names.iter().map(String::as_str)) {
                _ if names.iter().any(|name| name == parameter) => "it is declared, and has no value".to_owned(),
                Some(near) => format!("did you mean `{near}`?"),
                None => format!("`dca param list {}` lists all", program.name()),
            };
            let node = program.told.ros_node.as_deref().unwrap_or_default();
            Err(anyhow!("node `{node}` of `{}` has no value of `{parameter}`; {hint}", program.name()).into())
        }
    }
}

async fn names(visit: &Visit<'_>, program: &Program) -> Result<Vec<String>, Failure> {
    let asked = json!({ "prefixes": [], "depth": 0 });
    let told = visit.call("list_parameters", &asked).await?;
    let names = told.pointer("/result/names").and_then(Value::as_array);
    let names = names.with_context(|| format!("`{}` has not sent the names of its parameters", program.name()))?;
    Ok(names.iter().filter_map(|name| name.as_str().map(str::to_owned)).collect())
}

/// Calls a service. Returns a list that is in its answer.
async fn asked_for(
    visit: &Visit<'_>,
    program: &Program,
    service: &str,
    asked: &Value,
    list: &str,
) -> Result<Vec<Value>, Failure> {
    let mut told = visit.call(service, asked).await?;
    let list = told.get_mut(list).map(Value::take);
    match list {
        Some(Value::Array(list)) => Ok(list),
        _ => Err(anyhow!("the answer of `{service}` of `{}` has no list", program.name()).into()),
    }
}
