//! What hosts say of processes of the deployment, for the people who watch.

use super::Coordinator;
use crate::logic::effect::Out;
use crate::logic::protocol::{Change, Report, Target};
use language::algebra::StepRecord;
use std::time::Duration;

impl Coordinator {
    /// Returns the hosts that take part.
    pub fn hosts(&self) -> &[String] {
        &self.hosts
    }

    pub(super) fn happened(&mut self, target: Target, change: Change, out: &mut Out<'_>) {
        let process = match target {
            Target::Leaf(leaf) => self.plan.leaves.get(leaf as usize).map(|leaf| (leaf.path.clone(), leaf.host)),
            Target::Group(group) => self.plan.groups.get(group as usize).map(|group| (group.path.clone(), group.host)),
        };
        if let Some((path, host)) = process {
            let at = self.go_at.map_or(Duration::ZERO, |go| out.now - go);
            self.report_of(host, Report::Process { path, change, at }, out);
        }
    }

    pub(super) fn stepped(&mut self, group: u32, (number, steps): (u64, Vec<StepRecord>), out: &mut Out<'_>) {
        if let Some(group) = self.plan.groups.get(group as usize) {
            let at = self.go_at.map_or(Duration::ZERO, |go| out.now - go);
            let (path, host) = (group.path.clone(), group.host);
            self.report_of(host, Report::Stepped { path, number, steps, at }, out);
        }
    }
}
