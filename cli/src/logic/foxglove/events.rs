//! The topic of events: the reports of all deployments, as a record has them, each with its deployment.

use super::JSON;
use super::catalog::Description;
use crate::logic::record::{EVENTS, Entry, Rows, event_schema};
use node::logic::protocol::{Event, Report};
use serde_json::{Value, json};

/// Returns the topic and its description.
pub(super) fn channel() -> (&'static str, Description) {
    let mut schema = event_schema();
    schema["properties"]["deployment"] = json!({ "type": "string", "description": "the deployment: name and number" });
    (EVENTS, Description { form: JSON, schema_name: "dca.Event".to_owned(), schema: schema.to_string() })
}

/// Returns the message for an event. None for an event that only programs need.
pub(super) fn payload(event: &Event) -> Option<Vec<u8>> {
    if matches!(event.report, Report::Programs { .. } | Report::Stepped { .. }) {
        return None;
    }
    let row = Rows::default().row(&Entry::Report(event.report.clone()), event.time);
    let mut message: Value = serde_json::from_slice(&row.data).ok()?;
    message["deployment"] = json!(event.deployment.to_string());
    // The host is known here for every kind of report.
    message["host"] = json!(event.host);
    Some(message.to_string().into_bytes())
}
