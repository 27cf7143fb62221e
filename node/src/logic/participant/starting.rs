//! The start of the programs of this host.

use super::Participant;
use crate::logic::effect::{Out, ProcessId};
use crate::logic::executer::leaf_host;
use crate::logic::instance::{Instance, InstanceContext};
use crate::logic::programs::{self, Programs};
use std::sync::Arc;
use std::time::Duration;

impl Participant {
    /// Starts each program of this host, unless something is against one of them, or another deployment runs it.
    pub(super) fn start_programs(&mut self, host: &str, offered: &Programs, out: &mut Out<'_>) {
        let live = self.plan.live_leaves();
        let mine = |(number, _): &(u32, _)| live.contains(number) && leaf_host(&self.plan, *number) == Some(host);
        let plan = Arc::clone(&self.plan);
        let mut orders = Vec::new();
        let started = (0_u32..).zip(&plan.leaves).filter(|(_, leaf)| leaf.external.is_none());
        for (number, leaf) in started.filter(mine) {
            match offered.command(leaf) {
                Ok(command) => {
                    let process = ProcessId { deployment: self.deployment.clone(), leaf: number };
                    orders.push((number, programs::order(process, command, (&plan, leaf)), leaf.stop_within));
                }
                Err(why) => self.reasons.push(format!("host `{host}`: {why}")),
            }
        }
        self.reasons.dedup();
        if !self.reasons.is_empty() {
            return;
        }
        for (number, order, stop_within) in orders {
            let (mut notes, since_go) = (Vec::new(), Duration::ZERO);
            let mut context = InstanceContext { now: out.now, since_go, effects: out.effects, notes: &mut notes };
            self.waiting.insert(number);
            self.instances.insert(number, Instance::spawn(order, stop_within, &mut context));
        }
    }
}
