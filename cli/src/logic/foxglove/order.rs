//! The orders of clients: to read and to set parameters, to call a procedure, to stop.

use super::catalog::{ProgramName, Target};
use super::protocol::{GivenValue, ParameterValue};
use crate::logic::object::argument_of_json;
use crate::logic::process_name::DeploymentName;
use comms::logic::object::{Exported, Exports};
use serde_json::{Value, json};
use std::sync::Arc;

/// An order.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Order {
    /// Read the named parameters, or all parameters if no name is given.
    Parameters {
        names: Vec<String>,
    },
    SetParameters {
        values: Vec<GivenValue>,
    },
    Call(Box<ProcedureCall>),
    Stop(DeploymentName),
    Estop {
        reason: String,
    },
    Release,
}

/// A call of a procedure.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ProcedureCall {
    pub(crate) program: ProgramName,
    pub(crate) exported: Exported,
    /// All exports of the program, which have the types of argument and result.
    pub(crate) exports: Arc<Exports>,
    pub(crate) argument: Vec<u8>,
}

/// A procedure, with all exports of its program.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Procedure {
    pub(super) exported: Exported,
    pub(super) exports: Arc<Exports>,
}

/// Names an order at its client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ticket {
    /// The name that the client has given to its request, if it has given one.
    Parameters(Option<String>),
    Call {
        service: u32,
        number: u32,
    },
}

/// An order of a client.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Given {
    pub(crate) viewer: u64,
    pub(crate) ticket: Ticket,
    pub(crate) order: Order,
}

impl Given {
    /// Returns the program that is called, if it is a call.
    pub(crate) fn callee(&self) -> Option<&ProgramName> {
        if let Order::Call(call) = &self.order { Some(&call.program) } else { None }
    }
}

/// The result of an order.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Answer {
    /// The present values of parameters, and a sentence for each that was not set.
    Values {
        values: Vec<ParameterValue>,
        problems: Vec<String>,
    },
    /// The result of a call.
    Done(Value),
    Failed(String),
}

impl Order {
    /// Returns whether it stops something.
    pub(super) fn is_stop(&self) -> bool {
        matches!(self, Self::Stop(_) | Self::Estop { .. })
    }
}

/// Returns the services that stop missions: name, schemas of argument and result, and effect.
pub(super) fn services() -> [(&'static str, Value, Value, Target); 2] {
    let text = |what: &str| json!({ "type": "string", "description": what });
    let truth = |what: &str| json!({ "type": "boolean", "description": what });
    let texts = |what: &str| json!({ "type": "array", "items": { "type": "string" }, "description": what });
    let object = |properties: Value| json!({ "type": "object", "properties": properties });
    let stop = object(json!({ "deployment": text("NAME, or NAME@NUMBER for one run of it") }));
    let stopped = object(json!({
        "confirmed": truth("whether every host has confirmed that nothing of the deployment is left"),
        "stopped": truth("whether the deployment has ended, as far as its home knows"),
        "unconfirmed": texts("the hosts that have not confirmed this"),
        "may_go_on": texts("the work that may continue outside of the programs of the deployment"),
        "text": text("the result as a sentence"),
    }));
    let estop = object(json!({
        "reason": text("the reason, shown to every user"),
        "release": truth("let programs begin again, instead of stopping"),
    }));
    let host =
        object(json!({ "host": text("the host"), "stopped": truth("whether the host has confirmed the order") }));
    let estopped = object(json!({
        "confirmed": truth("whether every known host has confirmed the order"),
        "hosts": { "type": "array", "items": host },
        "text": text("the result as a sentence"),
    }));
    [("/dca/stop", stop, stopped, Target::Stop), ("/dca/estop", estop, estopped, Target::Estop)]
}

/// Reads a stop.
///
/// # Errors
/// One sentence about the mistake.
pub(super) fn read(target: &Target, payload: &[u8]) -> Result<Order, String> {
    let given = value(payload);
    match target {
        // An order with any argument stops everything. Only a whole and valid argument lets programs begin again.
        Target::Estop => {
            let given = given.unwrap_or_default();
            if given.get("release") == Some(&Value::Bool(true)) {
                return Ok(Order::Release);
            }
            let reason = given.get("reason").and_then(Value::as_str).unwrap_or_default().to_owned();
            Ok(Order::Estop { reason })
        }
        Target::Stop => {
            let given = given?;
            let name = given.get("deployment").and_then(Value::as_str);
            let name = name.ok_or("the deployment is missing: `{\"deployment\": \"NAME\"}`")?;
            DeploymentName::parse(name).map(Order::Stop)
        }
        Target::Procedure { .. } | Target::Replay => Err("this is not a stop".to_owned()),
    }
}

/// Reads a call of a procedure of a program with these exports.
///
/// # Errors
/// One sentence about the mistake.
pub(super) fn procedure(program: &ProgramName, procedure: Procedure, payload: &[u8]) -> Result<Order, String> {
    let Procedure { exported, exports } = procedure;
    let argument = argument_of_json(&exports, &exported.signature, &value(payload)?);
    let argument = argument.map_err(|why| format!("`{}` cannot be called so: {why}", exported.name))?;
    Ok(Order::Call(Box::new(ProcedureCall { program: program.clone(), exported, exports, argument })))
}

pub(super) fn value(payload: &[u8]) -> Result<Value, String> {
    if payload.is_empty() {
        return Ok(json!({}));
    }
    serde_json::from_slice(payload).map_err(|why| format!("the argument is not JSON: {why}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estop_stops_whatever_its_argument_is() {
        let read = |text: &str| read(&Target::Estop, text.as_bytes()).unwrap();
        for text in ["", "{}", "null", "[]", "{\"release\": \"true\"}", "{\"release\": true", "{\"reason\": 5}"] {
            assert_eq!(read(text), Order::Estop { reason: String::new() }, "{text}");
        }
        assert_eq!(read("{\"reason\": \"a person\"}"), Order::Estop { reason: "a person".to_owned() });
        assert_eq!(read("{\"release\": true}"), Order::Release);
    }

    #[test]
    fn a_stop_names_its_deployment() {
        let read = |text: &str| read(&Target::Stop, text.as_bytes());
        assert!(matches!(read("{\"deployment\": \"door@3\"}"), Ok(Order::Stop(name)) if name.text() == "door@3"));
        for wrong in ["", "{}", "{\"deployment\": 5}", "{\"deployment\": \"\"}", "door"] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
