//! The last lines of programs that were stopped by a deadline. They may show why a program took so long.

use language::plan::{DEADLINE, Expression, Plan};
use node::logic::executer::member_path;
use node::logic::output_lines::{LAST_LINES_MAX, last_lines};
use node::logic::protocol::{Change, Ending, Failure, FailureCause};
use std::collections::{BTreeMap, BTreeSet};

/// The last output of the programs of a mission, and the programs that have a deadline.
#[derive(Debug, Clone)]
pub(super) struct Late {
    /// The paths of the processes that a deadline limits, by the path of their group and the message of the deadline.
    deadlines: BTreeMap<(String, String), BTreeSet<String>>,
    /// The last lines of each program, by its path.
    lines: BTreeMap<String, Vec<String>>,
    /// Processes that were stopped and have not run again.
    stopped: BTreeSet<String>,
}

impl Late {
    pub(super) fn new(plan: &Plan) -> Self {
        let mut deadlines = BTreeMap::new();
        for group in &plan.groups {
            find(&group.expression, &mut |why, of| {
                let of = of.members().into_iter().filter_map(|slot| member_path(plan, group, slot)).collect();
                deadlines.insert((group.path.clone(), why.to_owned()), of);
            });
        }
        let lines = plan.leaves.iter().map(|leaf| (leaf.path.clone(), Vec::new())).collect();
        Self { deadlines, lines, stopped: BTreeSet::new() }
    }

    /// Continues with another plan, and keeps the output of programs.
    pub(super) fn replan(&mut self, plan: &Plan) {
        let next = Self::new(plan);
        self.deadlines.extend(next.deadlines);
        for (path, lines) in next.lines {
            self.lines.entry(path).or_insert(lines);
        }
    }

    /// Adds whole lines of a program.
    pub(super) fn wrote(&mut self, path: &str, text: &str) {
        let Some(lines) = self.lines.get_mut(path) else { return };
        lines.extend(last_lines(text.as_bytes(), false));
        lines.drain(..lines.len().saturating_sub(LAST_LINES_MAX));
    }

    pub(super) fn change(&mut self, path: &str, change: &Change) {
        match change {
            Change::Activated => drop(self.stopped.remove(path)),
            Change::Ended(Ending::Stopped | Ending::Unconfirmed) => drop(self.stopped.insert(path.to_owned())),
            Change::Ended(Ending::Done(_) | Ending::Aborted(_))
            | Change::Stopping
            | Change::Died(_)
            | Change::Started { .. }
            | Change::Restarting { .. }
            | Change::Resumed
            | Change::Held { .. }
            | Change::HeldBy { .. }
            | Change::EndedLate
            | Change::Switched(_)
            | Change::Says { .. }
            | Change::Entered { .. }
            | Change::Configured { .. }
            | Change::Replacing
            | Change::Renewing { .. }
            | Change::Reverting { .. } => {}
        }
    }

    /// If a failure is a deadline, returns the programs that it has stopped, with the last lines of each. Leaves out
    /// programs without output.
    pub(super) fn of(&self, failure: &Failure) -> Vec<(&str, &[String])> {
        let FailureCause::Failed(why) = &failure.cause else { return Vec::new() };
        let Some(of) = self.deadlines.get(&(failure.origin.clone(), why.clone())) else { return Vec::new() };
        let is_late =
            |path: &str| path.match_indices('/').any(|(end, _)| of.contains(&path[..end])) || of.contains(path);
        let written = self.lines.iter().filter(|(path, lines)| !lines.is_empty() && self.stopped.contains(*path));
        written.filter(|(path, _)| is_late(path)).map(|(path, lines)| (path.as_str(), &lines[..])).collect()
    }
}

/// Calls `found` for each `P within d`, with the message of its deadline and with `P`.
fn find(expression: &Expression, found: &mut dyn FnMut(&str, &Expression)) {
    if let Expression::Disable(of) = expression
        && let [of, Expression::Sequence(_, end)] = &of[..]
        && let Expression::Fail(why) = &**end
        && why.starts_with(DEADLINE)
    {
        found(why, of);
    }
    expression.operands().into_iter().for_each(|operand| find(operand, found));
}
