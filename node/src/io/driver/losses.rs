//! The values that wires have lost, and those that were refused, as the programs at their ends count them.

use super::Driver;
use crate::io::event::Connection;
use crate::logic::agent::{Agent, Input};
use crate::logic::effect::ProcessId;
use crate::logic::protocol::{LostValues, NodeStatus};
use comms::logic::seal::{DEVICE, LINK, NO_WIRE, Refused};
use std::collections::BTreeMap;

/// How many wires of one program are told at most.
const WIRES_MAX: usize = 256;

/// The losses of the programs of this node, by the number of the wire.
#[derive(Debug, Default)]
pub(super) struct Losses(BTreeMap<ProcessId, BTreeMap<u32, u64>>);

impl Losses {
    /// Takes what a program has counted since it began.
    pub(super) fn note(&mut self, process: ProcessId, wires: Vec<(u32, u64)>) {
        self.0.insert(process, wires.into_iter().take(WIRES_MAX).collect());
    }

    /// Forgets programs that are not there any more.
    pub(super) fn forget(&mut self, is_gone: impl Fn(&ProcessId) -> bool) {
        self.0.retain(|process, _| !is_gone(process));
    }

    /// Adds what was lost to a status.
    pub(super) fn tell(&self, status: &mut NodeStatus, agent: &Agent) {
        for part in &mut status.deployments {
            let of_part = self.0.iter().filter(|(process, _)| process.deployment == part.deployment);
            let wires = of_part.flat_map(|(_, wires)| wires);
            let named = wires.filter_map(|(wire, count)| {
                let wire = agent.wire(&part.deployment, *wire)?;
                Some(LostValues { wire, count: *count })
            });
            part.lost = named.collect();
        }
    }
}

impl Driver {
    /// Puts into the audit log that somebody has spoken on wires of a program who is not at their other ends.
    pub(super) fn refused(
        &self,
        Connection { deployment, instance, .. }: &Connection,
        wires: Vec<Refused>,
    ) -> Option<Input> {
        let member = self.config.member.as_ref()?;
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
