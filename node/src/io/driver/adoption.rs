//! Takes over from a killed node: makes its agent again and attaches to its programs, which still run.

use super::Driver;
use crate::io::child::leftovers;
use crate::io::input_log::InputLog;
use crate::io::run_dir::RunDir;
use crate::io::starter::{Adopted, Job};
use crate::logic::agent::Input;
use crate::logic::effect::ProcessId;
use crate::logic::node_state::NodeState;
use comms::io::clock;
use language::plan::LeafKind;
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Makes the agent of a killed node again, if there is one to take over. Blocks.
pub(super) fn replay(inputs: &InputLog) -> Option<NodeState> {
    // An input that killed the last node must not kill this one as well.
    let replayed = catch_unwind(AssertUnwindSafe(|| inputs.replay()));
    let why = match replayed {
        Ok(Ok(found)) => return found.filter(|state| !state.attachments.has_left()),
        Ok(Err(error)) => format!("{error:#}"),
        Err(_panicked) => "its last input cannot be processed".to_owned(),
    };
    tracing::error!(why, "the state of the previous node cannot be taken over: its programs end");
    None
}

/// Kills the programs that an earlier node has left in the folder and this one does not adopt. Blocks.
pub(super) fn end_strangers(dir: &RunDir, state: &NodeState) {
    let known = state.attachments.programs().filter(|(_, program)| !program.is_gone);
    let known: BTreeSet<_> = known.map(|(process, _)| dir.process(process)).collect();
    leftovers::end_others(dir.path(), &known);
}

impl Driver {
    /// Connects again to the programs of the agent that was made from its inputs.
    pub(super) fn adopt(&mut self) {
        // The replay used the programs that the previous node offered.
        self.files.inputs.begin(&self.state);
        let programs: Vec<ProcessId> = self.state.attachments.programs().map(|(process, _)| process.clone()).collect();
        let mut adopted = BTreeSet::new();
        for process in programs {
            let Some(program) = self.state.attachments.program(&process).cloned() else { continue };
            if program.is_gone {
                continue;
            }
            adopted.insert(process.clone());
            self.running.returning.expect(process.clone(), program.order.kind == LeafKind::Controller);
            let start = self.start(program.order.clone());
            self.later(Job::Adopt(Box::new(Adopted { start, program })));
        }
        let commits: Vec<_> =
            self.state.attachments.commits().map(|(name, hosts)| (name.clone(), hosts.to_vec())).collect();
        commits.into_iter().for_each(|(deployment, hosts)| self.commit(deployment, hosts));
        tracing::info!(programs = adopted.len(), "a node of this name was killed: its programs are taken over");
        let away = clock::now() - self.state.at;
        let gone = self.state.attachments.calls().map(|call| Input::CallGone { call });
        self.queues.pending.extend(std::iter::once(Input::Adopted { away, programs: adopted }).chain(gone));
        self.drain();
    }
}
