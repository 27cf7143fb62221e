//! The programs of a killed node, until each has reported its changes to the new node.
//!
//! The shim of a program reports, and so does a controller itself: it connects again and says how many notices it has made.

use crate::logic::effect::ProcessId;
use std::collections::BTreeMap;

/// The programs that have not sent all their reports.
#[derive(Debug, Default)]
pub(super) struct Returning {
    programs: BTreeMap<ProcessId, Missing>,
}

/// The reports that a program still has to send.
#[derive(Debug, Default)]
struct Missing {
    /// Whether its shim has not been reached.
    shim: bool,
    /// Whether it has not connected.
    connection: bool,
    /// How many notices it has made.
    notices: u64,
}

impl Returning {
    /// Waits for the shim of a program, and for a controller itself.
    pub(super) fn expect(&mut self, process: ProcessId, is_controller: bool) {
        self.programs.insert(process, Missing { shim: true, connection: is_controller, notices: 0 });
    }

    /// Returns whether a controller has not connected again. Its orders are kept until it connects.
    pub(super) fn expects(&self, process: &ProcessId) -> bool {
        self.programs.get(process).is_some_and(|missing| missing.connection)
    }

    /// Notes that the shim of a program was reached, and has sent all its reports.
    pub(super) fn shim_is_back(&mut self, process: &ProcessId) {
        self.programs.entry(process.clone()).and_modify(|missing| missing.shim = false);
    }

    /// Notes that a controller has connected again, which has made `notices` notices.
    pub(super) fn is_back(&mut self, process: &ProcessId, notices: u64) {
        self.programs.entry(process.clone()).and_modify(|missing| {
            (missing.connection, missing.notices) = (false, notices);
        });
    }

    /// Takes note that a program has ended, or that another one takes its place.
    pub(super) fn is_gone(&mut self, process: &ProcessId) {
        self.programs.entry(process.clone()).and_modify(|missing| *missing = Missing::default());
    }

    /// Returns the programs that have reported everything, and forgets them; `taken` is how many notices of a program were taken.
    pub(super) fn complete(&mut self, taken: impl Fn(&ProcessId) -> u64) -> Vec<ProcessId> {
        let has_told = |process: &ProcessId, missing: &mut Missing| {
            !missing.shim && !missing.connection && missing.notices <= taken(process)
        };
        self.programs.extract_if(.., has_told).map(|(process, _)| process).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::protocol::Deployment;

    #[test]
    fn a_program_has_told_everything_when_its_shim_and_itself_have() {
        let process = |leaf| ProcessId { deployment: Deployment { name: "d".into(), epoch: 1 }, leaf };
        let [plain, controller, ended] = [1, 2, 3].map(process);
        let mut returning = Returning::default();
        returning.expect(plain.clone(), false);
        returning.expect(controller.clone(), true);
        returning.expect(ended.clone(), true);
        assert_eq!([&plain, &controller].map(|process| returning.expects(process)), [false, true]);
        returning.is_back(&controller, 5);
        returning.shim_is_back(&plain);
        assert_eq!(returning.complete(|_| 5), [plain]);
        returning.shim_is_back(&controller);
        returning.is_gone(&ended);
        assert_eq!(returning.complete(|_| 4), [ended], "one notice is on its way");
        assert_eq!(returning.complete(|_| 5), [controller]);
        assert_eq!(returning.complete(|_| 5), []);
    }
}
