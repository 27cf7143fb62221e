//! The observed effects of a row, in the record of the run and in the programs themselves.

use super::row::{Row, is_below, path};
use dca_tests::cluster::{Fakes, SOON, Trace, pass, wait_until};
use language::plan::Plan;
use node::logic::protocol::{Change, Ending, FailureCause};
use std::time::Duration;

/// How long the test checks which programs continue, and whether data still arrives.
const HOLD: Duration = Duration::from_millis(600);

/// The part of a record that shows a fault and its effects.
pub(crate) struct Seen<'t> {
    changes: Vec<(Duration, &'t str, &'t Change)>,
}

impl<'t> Seen<'t> {
    /// Returns everything from the first report of a program's end onwards.
    pub(crate) fn since_the_end_of(trace: &'t Trace, program: &str) -> Self {
        let mut changes = trace.all_changes();
        let is_fault = |cause: &FailureCause| matches!(cause, FailureCause::Signal(_) | FailureCause::Watchdog(_));
        let is_end = |change: &Change| {
            matches!(change, Change::Ended(Ending::Unconfirmed))
                || matches!(change, Change::Ended(Ending::Aborted(why)) if is_fault(&why.cause))
        };
        let first = changes.iter().position(|(_, path, change)| *path == program && is_end(change));
        let first = first.unwrap_or_else(|| panic!("the record has no end of `{program}`: {changes:?}"));
        Self { changes: changes.split_off(first) }
    }

    /// Everything.
    pub(crate) fn all(trace: &'t Trace) -> Self {
        Self { changes: trace.all_changes() }
    }

    /// Checks that the immediate effects are those of the row. All of them are seen, and nothing else is stopped
    /// before a process has ended.
    pub(crate) fn expect_at_once(&self, row: &Row) {
        let (stops, fails) = row.follows();
        for process in &stops {
            let is_stop = |change: &Change| matches!(change, Change::Stopping | Change::Ended(Ending::Stopped));
            let found = self.changes.iter().any(|(_, path, change)| is_below(path, process) && is_stop(change));
            assert!(found, "{}: `{process}` is not stopped: {:?}", row.name, self.changes);
        }
        for process in fails.iter().filter(|process| *process != "main") {
            self.expect_failure(row, process);
        }
        let at_once = self.changes.iter().skip(1).take_while(|(.., change)| !matches!(change, Change::Ended(_)));
        for (_, path, change) in at_once {
            let is_said = stops.iter().any(|process| is_below(path, process));
            assert!(is_said || **change != Change::Stopping, "{}: `{path}` is stopped, too", row.name);
        }
    }

    /// Checks that a process or group has failed.
    pub(crate) fn expect_failure(&self, row: &Row, process: &str) {
        let is_failure = |change: &Change| matches!(change, Change::Ended(Ending::Aborted(_)));
        let found = self.changes.iter().any(|(_, path, change)| *path == process && is_failure(change));
        assert!(found, "{}: `{process}` does not fail: {:?}", row.name, self.changes);
    }

    /// Returns the time from the end of the program until everything has ended.
    pub(crate) fn safe_after(&self) -> Duration {
        let ends = self.changes.iter().filter(|(.., change)| matches!(change, Change::Ended(_))).map(|(at, ..)| *at);
        ends.max().unwrap_or_default() - self.changes[0].0
    }
}

/// Checks that the programs still running are those of the row, and remain the same.
pub(crate) fn expect_running(row: &Row, fakes: &Fakes<'_>, within: Duration) {
    let expected: Vec<String> = row.running.iter().map(|name| path(name)).collect();
    let is_so = || {
        let active = fakes.active();
        let all_named = active.iter().all(|path| expected.iter().any(|name| is_below(path, name)));
        all_named && expected.iter().all(|name| active.iter().any(|path| is_below(path, name)))
    };
    let said = || format!("{}: runs {:#?}, and the row says {expected:#?}", row.name, fakes.active());
    wait_until(within, is_so).unwrap_or_else(|| panic!("{}", said()));
    pass(HOLD);
    assert!(is_so(), "{}", said());
}

/// Checks that the wires named by the row no longer carry values.
pub(crate) fn expect_dead_wires(row: &Row, fakes: &Fakes<'_>) {
    let wires = row.at_once.split_once(" no longer arrives").map_or("", |(wires, _)| wires);
    let inputs: Vec<(String, &str)> = wires
        .split(", ")
        .filter_map(|wire| wire.split_once(" -> ")?.1.split_once('.').map(|(name, port)| (path(name), port)))
        .collect();
    assert!(!inputs.is_empty(), "{}: {}", row.name, row.at_once);
    let counts = || inputs.iter().map(|(path, port)| fakes.heard(path, port)).collect::<Vec<_>>();
    assert!(counts().iter().all(|count| *count > 0), "{}: {inputs:?} never got anything", row.name);
    let is_dead = || {
        let before = counts();
        pass(HOLD);
        before == counts()
    };
    wait_until(SOON, is_dead).unwrap_or_else(|| panic!("{}: {inputs:?} still get something", row.name));
}

/// Checks that inputs get no more values from a hanging program exactly if the row says that something becomes blind.
pub(crate) fn expect_blind(row: &Row, fakes: &Fakes<'_>, plan: &Plan, program: &str) {
    let active = fakes.active();
    let sends = |leaf: u32| plan.leaves[leaf as usize].path == program;
    let fed = plan.wires.iter().filter(|wire| sends(wire.from.leaf));
    let fed: Vec<(&str, &str)> =
        fed.map(|wire| (plan.leaves[wire.to.leaf as usize].path.as_str(), wire.to.port.as_str())).collect();
    let counts = || fed.iter().map(|(path, port)| fakes.heard(path, port)).collect::<Vec<_>>();
    let before = counts();
    pass(HOLD);
    let after = counts();
    let blind: Vec<_> = (0..fed.len()).filter(|at| before[*at] > 0 && before[*at] == after[*at]).collect();
    let is_blind = blind.iter().any(|at| active.iter().any(|path| path == fed[*at].0));
    let told = format!("{}: {fed:?} got {before:?}, then {after:?}", row.name);
    match row.verdict.as_str() {
        "goes on blind" => assert!(is_blind, "{told}"),
        "goes on without" => assert!(!is_blind, "{told}"),
        // The following step is blind until its limit ends it.
        _ => {}
    }
}
