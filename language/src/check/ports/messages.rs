//! The ports of activities as ends of connections: they receive values and queue messages, and send values.

use super::Interfaces;
use crate::check::spec::{CallRole, Connection, Direction, Endpoint, Kind, Port, Process, Spec};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Transfer;
use crate::source::Span;
use std::collections::BTreeSet;

/// The types of a call that hands a message to a queue.
const MESSAGE: &str = "QueueMessage";
const RECEIPT: &str = "Receipt";

/// Returns the places where activities declare their ports.
pub(super) fn declared(spec: &Spec) -> BTreeSet<Span> {
    let charts = spec.processes.iter().filter_map(Process::chart);
    charts.flat_map(|chart| &chart.ports).map(|port| port.name.span).collect()
}

impl Interfaces<'_> {
    /// Returns whether a call hands queue messages to an input of an activity.
    pub(super) fn is_message_call(&self, from: &Port, to: &Port) -> bool {
        let is = |kind: Option<&Kind>, name: &str| kind.is_some_and(|kind| kind.text == name);
        let sends = |port: &Port| {
            let call = port.call.as_ref().filter(|call| call.role == CallRole::Caller);
            call.is_some_and(|call| is(call.argument.as_ref(), MESSAGE)) && is(port.kind.as_ref(), RECEIPT)
        };
        sends(from) && to.direction == Direction::In && self.messages.contains(&to.name.span)
    }

    /// Returns the reason if an activity would have to fetch values. Each message is an event that comes once, so an
    /// activity never fetches.
    pub(super) fn pulled(&self, connection: &Connection, to: Option<&Port>) -> Option<Diagnostic> {
        let to = to.filter(|to| connection.transfer == Transfer::Pull && self.messages.contains(&to.name.span))?;
        let message =
            format!("`{}` takes each message when it arrives; an activity cannot fetch messages", to.name.text);
        let diagnostic = Diagnostic::new(Code::E0304, connection.span, message);
        Some(diagnostic.reason(to.name.span, "declared here").help("remove `pull`"))
    }

    /// Returns the reason if a port of an activity is connected with the database or with ROS 2, which is not possible.
    pub(super) fn outside(&self, port: &Port, endpoint: &Endpoint, code: Code) -> Option<Diagnostic> {
        let message = || {
            format!("`{}` is a port of an activity, so only other processes can be connected with it", port.name.text)
        };
        let found =
            self.messages.contains(&port.name.span).then(|| Diagnostic::new(code, endpoint.port.span, message()))?;
        Some(found.reason(port.name.span, "declared here").help("put a program between both ends"))
    }
}
