//! The values that wires have lost or not delivered, and those that inputs or seals have refused, as counted by the
//! programs at their ends.

use super::Driver;
use crate::io::event::{Connection, Counted};
use crate::logic::agent::{Agent, Input};
use crate::logic::effect::ProcessId;
use crate::logic::protocol::{LostValues, NodeStatus, RefusedValues};
use comms::logic::seal::{DEVICE, LINK, NO_WIRE, Refused};
use std::collections::BTreeMap;

/// The most wires and inputs of one program that are reported.
const WIRES_MAX: usize = 256;

/// The losses of the programs of this node.
#[derive(Debug, Default)]
pub(super) struct Losses(BTreeMap<ProcessId, Counts>);

/// The counts of one program since it began.
#[derive(Debug, Default)]
struct Counts {
    instance: String,
    /// By the number of the wire.
    lost: BTreeMap<u32, u64>,
    /// By input.
    refused: BTreeMap<String, u64>,
    /// By the number of the wire.
    undelivered: BTreeMap<u32, u64>,
}

impl Losses {
    /// Takes the counts of a program, which is this instance, since its start.
    pub(super) fn note(&mut self, process: ProcessId, instance: String, counted: Counted) {
        let lost = counted.wires.into_iter().take(WIRES_MAX).collect();
        let refused = counted.refused.into_iter().take(WIRES_MAX).collect();
        let undelivered = counted.undelivered.into_iter().take(WIRES_MAX).collect();
        self.0.insert(process, Counts { instance, lost, refused, undelivered });
    }

    /// Removes programs that are gone.
    pub(super) fn forget(&mut self, is_gone: impl Fn(&ProcessId) -> bool) {
        self.0.retain(|process, _| !is_gone(process));
    }

    /// Adds the lost, refused and undelivered values to a status.
    pub(super) fn tell(&self, status: &mut NodeStatus, agent: &Agent) {
        for part in &mut status.deployments {
            let of_part = || self.0.iter().filter(|(process, _)| process.deployment == part.deployment);
            let refused = of_part().flat_map(|(_, Counts { instance, refused, .. })| {
                let named = |(input, count): (&String, &u64)| {
                    let input = format!("{instance}, {input}");
                    RefusedValues { input, count: *count }
                };
                refused.iter().map(named).collect::<Vec<_>>()
            });
            part.refused = refused.collect();
            let named = |(wire, count): (&u32, &u64)| {
                let wire = agent.wire(&part.deployment, *wire)?;
                Some(LostValues { wire, count: *count })
            };
            part.lost = of_part().flat_map(|(_, counts)| &counts.lost).filter_map(named).collect();
            part.undelivered = of_part().flat_map(|(_, counts)| &counts.undelivered).filter_map(named).collect();
        }
    }
}

impl Driver {
    /// Writes to the audit log that a program has received messages on its wires that did not come from the other end.
    pub(super) fn refused(
        &self,
        Connection { deployment, instance, .. }: &Connection,
        wires: Vec<Refused>,
    ) -> Option<Input> {
        let member = self.config.network.member.as_ref()?;
        for Refused { wire, count, why, from } in wires.into_iter().take(WIRES_MAX) {
            let what = match self.state.agent.wire(deployment, wire) {
                Some(ends) => format!("send on the wire `{ends}` of `{deployment}`"),
                None if wire == DEVICE => format!("speak on a device to `{instance}` of `{deployment}`"),
                None if wire == LINK => {
                    let who = from.unwrap_or_else(|| "somebody".to_owned());
                    member.refuse_message(&format!("link to `{instance}` of `{deployment}`"), &format!("{why}: {who}"));
                    continue;
                }
                None if wire == NO_WIRE => format!("call `{instance}` of `{deployment}`"),
                None => continue,
            };
            let from = from.map_or(String::new(), |session| format!(", as session {session}"));
            let why = format!("`{instance}` has dropped it: {why}{from}");
            tracing::debug!(what, count, why, "something was dropped");
            member.refuse_message(&what, &why);
        }
        None
    }
}
