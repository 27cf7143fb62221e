//! Everything that an agent is attached to: programs with their channels, open calls, and epochs that are being written to the disk.
//!
//! The state of a killed agent is rebuilt from its inputs (`io/input_log`). Its effects are made once more by this,
//! although they have already happened. Numbers show which of the effects have arrived: both ends of a program's
//! channels count every message from the start. When a program is reached again, it says how many orders it has
//! received, and the node says how many notices. Only the rest is sent again. Orders are kept until a notice shows that
//! the program has received them.

use crate::logic::agent::Input;
use crate::logic::effect::{Effect, ProcessId, SpawnOrder};
use crate::logic::protocol::Deployment;
use comms::logic::control::{Notice, Order};
use serde::{Deserialize, Serialize};
use shim::protocol::{ShimOrder, ShimReport};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// How many orders to one program are kept until a notice shows that the program has received them. A program that has
/// missed more orders cannot continue.
const KEPT_MAX: usize = 1024;

/// A program, from its start until nothing of it is left and no caller asks for it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Attachment {
    /// The order that started the program.
    pub order: SpawnOrder,
    /// How many reports of its shim the agent has received.
    pub reports: u64,
    /// Whether a report said how the program ended.
    pub has_ended: bool,
    /// Whether the last report said that nothing of the program is left.
    pub is_gone: bool,
    /// How many notices of the program the agent has received.
    pub notices: u64,
    /// The public keys that the program has made at its start; only in a team.
    pub keys: Vec<u8>,
    /// Whether its deployment is over, although something of the program may still run.
    is_buried: bool,
    /// Every order to its shim, as the line that the shim reads.
    shim_orders: Vec<String>,
    /// How many orders the program was given, all in all.
    orders: u64,
    /// The last orders that the program was given.
    kept: VecDeque<Order>,
}

/// Everything outside of one agent that the agent is attached to.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Attachments {
    programs: BTreeMap<ProcessId, Attachment>,
    calls: BTreeSet<u64>,
    /// The epochs that are not on the disk yet, with the hosts of their deployments.
    commits: BTreeMap<Deployment, Vec<String>>,
    /// Deployments that are over here and still have their folders, the oldest first.
    buried: VecDeque<Deployment>,
    has_left: bool,
}

impl Attachments {
    /// Notes an input, before the agent receives it.
    pub fn taken(&mut self, input: &Input) {
        match input {
            Input::Call { call, .. } => drop(self.calls.insert(*call)),
            Input::CallGone { call } => drop(self.calls.remove(call)),
            Input::Committed { deployment, .. } => drop(self.commits.remove(deployment)),
            Input::Shim { process, report, .. } => {
                let Some(program) = self.programs.get_mut(process) else { return };
                program.reports += 1;
                program.has_ended |= is_ending(report);
                program.is_gone = *report == ShimReport::Gone;
                if program.is_gone && program.is_buried {
                    self.programs.remove(process);
                }
            }
            Input::Control { process, notice } => {
                if let Some(program) = self.programs.get_mut(process).filter(|_| notice.is_counted()) {
                    program.notices += 1;
                    if let Notice::Hello { location: Some(location), .. } = notice {
                        program.keys.clone_from(&location.keys);
                    }
                    program.was_taken(notice);
                }
            }
            Input::Appeared { .. }
            | Input::Vanished { .. }
            | Input::Ping { .. }
            | Input::Pong(_)
            | Input::Namesake(_)
            | Input::Frame(_)
            | Input::Configured { .. }
            | Input::Undelivered { .. }
            | Input::Found { .. }
            | Input::Adopted { .. }
            | Input::Reached { .. }
            | Input::Leave
            | Input::EstopKept { .. }
            | Input::Unkept { .. }
            | Input::Judged { .. }
            | Input::Resumable { .. }
            | Input::Calendar { .. }
            | Input::Tick => {}
        }
    }

    /// Notes an effect, before it is carried out.
    pub fn given(&mut self, effect: &Effect) {
        match effect {
            Effect::Spawn(order) => {
                // The part of a deployment on this host may begin again after it was over, in the same epoch and the same folder.
                self.buried.retain(|buried| *buried != order.process.deployment);
                self.programs.insert(order.process.clone(), Attachment::new((**order).clone()));
            }
            Effect::Shim { process, order } => {
                if let Some(program) = self.programs.get_mut(process) {
                    program.shim_orders.push(order.to_string());
                }
            }
            Effect::Control { process, order } => {
                if let Some(program) = self.programs.get_mut(process).filter(|_| order.is_counted()) {
                    program.orders += 1;
                    program.kept.push_back(order.clone());
                    let old = program.kept.len().saturating_sub(KEPT_MAX);
                    program.kept.drain(..old);
                }
            }
            Effect::CloseProcess { process } => self.forget(|other| other == process),
            Effect::CloseDeployment { deployment } => {
                self.forget(|process| process.deployment == *deployment);
                self.buried.retain(|buried| buried != deployment);
                self.buried.push_back(deployment.clone());
            }
            Effect::PersistEpoch { deployment, hosts } => drop(self.commits.insert(deployment.clone(), hosts.clone())),
            Effect::EndAnswers { call } | Effect::Tail { call, .. } | Effect::TailAll { call, .. } => {
                self.calls.remove(call);
            }
            Effect::Leave | Effect::Yield { .. } => self.has_left = true,
            Effect::Transmit { .. }
            | Effect::Ping { .. }
            | Effect::Greet(_)
            | Effect::Holders(_)
            | Effect::Beat(_)
            | Effect::Peer(_)
            | Effect::Settled { .. }
            | Effect::KeepEstop { .. }
            | Effect::Keep(_)
            | Effect::Unkeep { .. }
            | Effect::KeepAll(_)
            | Effect::KeepTombstones(_)
            | Effect::KillShim { .. }
            | Effect::FindPrograms { .. }
            | Effect::Answer { .. }
            | Effect::Judge { .. }
            | Effect::JudgeResumed { .. }
            | Effect::OrderEnded { .. }
            | Effect::WriteDatabase(_) => {}
        }
    }

    /// Drops the programs that `which` selects. A program of which something is left is dropped later, with its last report.
    fn forget(&mut self, which: impl Fn(&ProcessId) -> bool) {
        self.programs.retain(|process, program| {
            let is_meant = which(process);
            program.is_buried |= is_meant;
            !is_meant || !program.is_gone
        });
    }

    /// Returns the program that introduces itself with this name: [`SpawnOrder::word`].
    pub fn find(&self, deployment: &Deployment, word: &str) -> Option<&ProcessId> {
        let (path, number) = word.rsplit_once('#').map_or((word, None), |(path, number)| (path, Some(number)));
        let leaf: Option<u32> = number.and_then(|number| number.parse().ok());
        let is_it = |(process, program): &(&ProcessId, &Attachment)| {
            let is_named = if program.order.is_next { leaf == Some(process.leaf) } else { number.is_none() };
            is_named && program.order.path == path && !program.is_buried
        };
        self.of(deployment).find(is_it).map(|(process, _)| process)
    }

    /// Returns the programs of a deployment.
    fn of(&self, deployment: &Deployment) -> impl Iterator<Item = (&ProcessId, &Attachment)> {
        let first = ProcessId { deployment: deployment.clone(), leaf: 0 };
        let deployment = deployment.clone();
        self.programs.range(first..).take_while(move |(process, _)| process.deployment == deployment)
    }

    /// Returns whether a deployment has programs that were not closed on this host.
    pub fn has_programs(&self, deployment: &Deployment) -> bool {
        self.of(deployment).any(|(_, program)| !program.is_buried)
    }

    /// Returns one program.
    pub fn program(&self, process: &ProcessId) -> Option<&Attachment> {
        self.programs.get(process)
    }

    /// Returns every program, including the programs of deployments that are over.
    pub fn programs(&self) -> impl Iterator<Item = (&ProcessId, &Attachment)> {
        self.programs.iter()
    }

    /// Returns the calls that wait for answers.
    pub fn calls(&self) -> impl Iterator<Item = u64> {
        self.calls.iter().copied()
    }

    /// Returns the epochs that are not on the disk yet, with the hosts of their deployments.
    pub fn commits(&self) -> impl Iterator<Item = (&Deployment, &[String])> {
        self.commits.iter().map(|(deployment, hosts)| (deployment, hosts.as_slice()))
    }

    /// Removes and returns the oldest deployment that is over and has no program left; nothing unless more than `count`
    /// deployments are over.
    pub fn take_buried(&mut self, count: usize) -> Option<Deployment> {
        let has_ended = |deployment: &Deployment| self.of(deployment).next().is_none();
        let oldest = self.buried.iter().position(has_ended).filter(|_| self.buried.len() > count)?;
        self.buried.remove(oldest)
    }

    /// Returns whether the agent has ordered the node to leave.
    pub fn has_left(&self) -> bool {
        self.has_left
    }
}

impl Attachment {
    fn new(order: SpawnOrder) -> Self {
        Self {
            order,
            reports: 0,
            has_ended: false,
            is_gone: false,
            notices: 0,
            keys: Vec::new(),
            is_buried: false,
            shim_orders: Vec::new(),
            orders: 0,
            kept: VecDeque::new(),
        }
    }

    /// Returns the orders to the shim after the first `taken` orders.
    pub fn shim_orders(&self, taken: u64) -> Vec<ShimOrder> {
        let taken = usize::try_from(taken).unwrap_or(usize::MAX);
        self.shim_orders.iter().skip(taken).filter_map(|line| ShimOrder::parse(line)).collect()
    }

    /// Returns the orders after the first `taken` orders; nothing if some of these are not kept any more.
    pub fn orders(&self, taken: u64) -> Option<Vec<Order>> {
        let missed = usize::try_from(self.orders.checked_sub(taken)?).ok()?;
        let skip = self.kept.len().checked_sub(missed)?;
        Some(self.kept.iter().skip(skip).cloned().collect())
    }

    /// Drops the order that a notice answers, and all orders before it: a program takes its orders in sequence.
    fn was_taken(&mut self, notice: &Notice) {
        let is_answered = |order: &Order| match (notice, order) {
            (Notice::Connected | Notice::ConnectFailed { .. }, Order::Connect { .. }) => true,
            (
                Notice::Switched { generation },
                Order::Open { generation: ordered, .. } | Order::Close { generation: ordered, .. },
            ) => generation == ordered,
            (
                Notice::Running { activation }
                | Notice::Done { activation, .. }
                | Notice::Aborted { activation, .. }
                | Notice::Stopped { activation },
                Order::Activate { activation: ordered, .. },
            ) => activation == ordered,
            (Notice::Sent { number }, Order::Send { number: ordered, .. }) => number == ordered,
            _ => false,
        };
        if let Some(last) = self.kept.iter().rposition(is_answered) {
            self.kept.drain(..=last);
        }
    }
}

fn is_ending(report: &ShimReport) -> bool {
    match report {
        ShimReport::Exited { .. }
        | ShimReport::Signalled { .. }
        | ShimReport::ExecFailed { .. }
        | ShimReport::Ended { .. } => true,
        ShimReport::Ready | ShimReport::Started { .. } | ShimReport::Gone => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::plan::{LeafKind, Policy};

    fn deployment(epoch: u64) -> Deployment {
        Deployment { name: "door".into(), epoch }
    }

    fn spawn(epoch: u64) -> Effect {
        Effect::Spawn(Box::new(SpawnOrder {
            process: ProcessId { deployment: deployment(epoch), leaf: 0 },
            path: "main/a".into(),
            is_next: false,
            command: Vec::new(),
            secrets: Vec::new(),
            devices: Vec::new(),
            kind: LeafKind::Controller,
            is_service: false,
            policy: Policy::default(),
            keys: Vec::new(),
            environment: Default::default(),
        }))
    }

    fn close(epoch: u64) -> Effect {
        Effect::CloseDeployment { deployment: deployment(epoch) }
    }

    fn gone(epoch: u64) -> Input {
        let process = ProcessId { deployment: deployment(epoch), leaf: 0 };
        Input::Shim { process, report: ShimReport::Gone, output: Vec::new() }
    }

    #[test]
    fn only_the_folders_of_what_is_over_are_given_up_the_oldest_first() {
        let mut attachments = Attachments::default();
        for epoch in 1..=3 {
            attachments.given(&spawn(epoch));
            attachments.taken(&gone(epoch));
            attachments.given(&close(epoch));
        }
        assert_eq!(attachments.take_buried(3), None);
        assert_eq!(attachments.take_buried(2), Some(deployment(1)));
        assert_eq!(attachments.take_buried(2), None);
    }

    #[test]
    fn the_folder_of_a_part_that_begins_anew_stays() {
        let mut attachments = Attachments::default();
        attachments.given(&spawn(1));
        attachments.taken(&gone(1));
        attachments.given(&close(1));
        attachments.given(&spawn(1));
        attachments.given(&close(2));
        assert_eq!(attachments.take_buried(0), Some(deployment(2)));
        assert_eq!(attachments.take_buried(0), None, "it runs again");
        attachments.taken(&gone(1));
        attachments.given(&close(1));
        attachments.given(&close(1));
        assert_eq!(attachments.take_buried(0), Some(deployment(1)));
        assert_eq!(attachments.take_buried(0), None, "once");
    }

    #[test]
    fn the_folder_of_a_program_that_could_not_be_ended_stays_until_it_is_gone() {
        let mut attachments = Attachments::default();
        attachments.given(&spawn(1));
        attachments.given(&close(1));
        attachments.given(&close(2));
        assert_eq!(attachments.take_buried(1), Some(deployment(2)), "the next one that has ended");
        assert_eq!(attachments.take_buried(0), None);
        attachments.taken(&gone(1));
        assert_eq!(attachments.take_buried(0), Some(deployment(1)));
    }
}
