//! Calls between modules: on their way, at their server, and back.

use super::lines::{Given, OpenCall, Wire};
use super::{ConnectError, Harness, HarnessEvent, ModuleId, State, WireId};
use crate::sdk::calls::CallOrder;
use crate::sdk::export::Activity;
use crate::sdk::module::Delivery;
use comms::logic::object::{ObjectError, begins_by};
use std::sync::Arc;
use std::time::Duration;

/// How often a call looks again whether its server runs.
const SERVE_AGAIN: Duration = Duration::from_millis(10);

/// An end of the connection of a call: the call, or the export that it leads to.
#[derive(Clone, Copy, Debug)]
pub struct CallEnd<'a> {
    /// The module.
    pub module: ModuleId,
    /// The name there.
    pub name: &'a str,
}

impl Harness {
    /// Makes a closed connection of a call with an export. A call of a process by its path is not simulated.
    ///
    /// # Errors
    /// If the call or the export does not exist, or the types differ.
    pub fn connect_call(&mut self, caller: CallEnd<'_>, server: CallEnd<'_>) -> Result<WireId, ConnectError> {
        let missing = |module: &'static str, direction, end: CallEnd<'_>| ConnectError::NoPort {
            module,
            direction,
            port: end.name.to_owned(),
        };
        let (from, to) = (self.module(caller.module).interface(), self.module(server.module).interface());
        let call = from.calls.iter().find(|call| call.name == caller.name);
        let call = call.ok_or_else(|| missing(from.type_name, "call", caller))?;
        let export = to.exports.iter().find(|export| export.name == server.name);
        let export = export.ok_or_else(|| missing(to.type_name, "export", server))?;
        if !export.signature.fits(&call.signature) {
            return Err(ConnectError::Types { from: from.type_name, to: to.type_name });
        }
        let (from, to) = ((caller.module.0, call.name), (server.module.0, export.name));
        self.lines.wires.push(Wire { from, to, is_call: true, open: 0 });
        Ok(WireId(self.lines.wires.len() - 1))
    }

    /// Starts the calls that a module has made.
    pub(super) fn send_calls(&mut self, slot: usize) {
        let mut orders = Vec::new();
        self.slots[slot].module.drain_calls(&mut |call, order| orders.push((call, order)));
        for (call, order) in orders {
            match order {
                CallOrder::Cancel { number } => self.lines.cancel(slot, call, number),
                CallOrder::Make { number, to, argument, within } => {
                    let server = self.lines.server(slot, call).filter(|_| to.is_none());
                    let (server, export) = server.unwrap_or((slot, call));
                    let made = OpenCall {
                        caller: slot,
                        call,
                        number,
                        server,
                        export,
                        argument,
                        begins_by: begins_by(self.now, self.now + within),
                        wanted: Arc::new(()),
                    };
                    let is_connected = server != slot;
                    let opened = self.lines.begin(made);
                    if is_connected {
                        self.put(self.now + within, late(opened, within));
                        self.travel(slot, server, HarnessEvent::Serve { call: opened });
                    } else {
                        let result = Err(ObjectError::NotConnected { name: call.to_owned() });
                        self.put(self.now, HarnessEvent::Answer { call: opened, result });
                    }
                }
            }
        }
    }

    /// Starts the way of an event from one module to another; the network may lose it.
    fn travel(&mut self, from: usize, to: usize, event: HarnessEvent) {
        let jitter = self.disturbance.transfer_jitter.mul_f64(self.random.unit());
        if !self.lines.is_cut(from, to) {
            self.put(self.now + self.disturbance.transfer + jitter, event);
        }
    }

    /// Lets a server carry out a call, once the server runs.
    pub(super) fn serve(&mut self, number: u64) {
        let Some(call) = self.lines.call(number) else { return };
        let server = &mut self.slots[call.server];
        let activity = match server.state {
            State::Idle => Activity::Idle,
            State::Running => Activity::Running,
            State::Stopping { .. } => Activity::Stopping,
        };
        let exports = &server.module.interface().exports;
        let needs_run = exports.iter().any(|export| export.name == call.export && !export.is_answered_idle);
        if activity == Activity::Idle && needs_run && self.now < call.begins_by {
            return self.put(self.now + SERVE_AGAIN, HarnessEvent::Serve { call: number });
        }
        if let Some(reply) = self.lines.reply(number) {
            server.module.serve(call.export, &call.argument, activity, reply);
        }
    }

    /// Starts the ways of the answers that modules have given.
    pub(super) fn take_answers(&mut self) {
        for Given { call, result } in self.lines.take_given() {
            if let Some(ends) = self.lines.call(call).map(|open| (open.server, open.caller)) {
                self.travel(ends.0, ends.1, HarnessEvent::Answer { call, result });
            }
        }
    }

    /// Hands an answer to the caller.
    pub(super) fn answer(&mut self, number: u64, result: Result<Vec<u8>, ObjectError>) {
        let Some(OpenCall { caller, call, number, .. }) = self.lines.end(number) else { return };
        let (now, slot) = (self.now, &mut self.slots[caller]);
        let delivery = slot.module.answered(call, number, result);
        if delivery == Delivery::Triggers && matches!(slot.state, State::Running) {
            self.arm(caller, now);
        }
    }
}

/// Returns the end of a call whose answer has not come in time.
fn late(call: u64, within: Duration) -> HarnessEvent {
    HarnessEvent::Answer { call, result: Err(ObjectError::Deadline { within }) }
}
