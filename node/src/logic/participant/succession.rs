//! Programs of this host that replace other programs while both programs run.
//!
//! The change starts and links the next program as if it were added. Then its supervisor has it take over the
//! activation of its predecessor, which keeps running in the meantime. Once it runs, the supervisor hands the
//! connections over, and stops the predecessor. The predecessor leaves when the change has held; it stays until then,
//! in case the next program is unhealthy.
//!
//! A program is here from the order of its supervisor until it runs or ends. If it still has to finish a stop, its next
//! activation waits here.

use crate::logic::protocol::Ending;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The programs that are to take the place of others and are not running yet.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Successions {
    all: BTreeMap<u32, Succession>,
}

/// A program that is to take the place of another one.
#[derive(Debug, Serialize, Deserialize)]
struct Succession {
    by: Supervisor,
    /// The next activation, if the program first has to finish a stop.
    then: Option<NextActivation>,
}

/// The supervisor of a group.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Supervisor {
    pub(super) group: u32,
    pub(super) host: String,
}

/// An activation that follows a stop.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct NextActivation {
    pub(super) activation: u32,
    pub(super) value: Vec<u8>,
}

impl Successions {
    /// Takes note that a supervisor has a program take the place of another one.
    pub(super) fn begin(&mut self, leaf: u32, by: Supervisor, then: Option<NextActivation>) {
        self.all.insert(leaf, Succession { by, then });
    }

    /// Takes the end of an activation. Returns the next activation if the program has finished its earlier stop; otherwise
    /// it takes the place of no program any more.
    pub(super) fn ended(&mut self, leaf: u32, ending: &Ending) -> Option<NextActivation> {
        let then = self.all.get_mut(&leaf)?.then.take().filter(|_| *ending == Ending::Stopped);
        if then.is_none() {
            self.all.remove(&leaf);
        }
        then
    }

    /// Takes note that a program runs. Returns the supervisor that waits for this.
    pub(super) fn begun(&mut self, leaf: u32) -> Option<Supervisor> {
        self.all.remove(&leaf).map(|succession| succession.by)
    }

    /// Returns whether a program is to take the place of another one, and does not run yet.
    pub(super) fn contains(&self, leaf: u32) -> bool {
        self.all.contains_key(&leaf)
    }

    /// Forgets all of them: the change has held, or was taken back.
    pub(super) fn clear(&mut self) {
        self.all.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A program that was stopped before begins again once. Any other end of it ends the succession.
    #[test]
    fn a_program_begins_again_after_its_stop() {
        let by = Supervisor { group: 1, host: "c1".into() };
        let next = NextActivation { activation: 3, value: vec![7] };
        let mut successions = Successions::default();
        successions.begin(5, by.clone(), Some(next.clone()));
        assert_eq!(successions.ended(5, &Ending::Stopped), Some(next.clone()));
        assert!(successions.contains(5));
        assert_eq!(successions.begun(5), Some(by.clone()));
        assert_eq!(successions.begun(5), None);
        successions.begin(5, by.clone(), Some(next));
        assert_eq!(successions.ended(5, &Ending::Done(Vec::new())), None);
        assert!(!successions.contains(5));
        successions.begin(5, by, None);
        assert_eq!(successions.ended(5, &Ending::Stopped), None);
        assert!(!successions.contains(5));
        assert_eq!(successions.ended(6, &Ending::Stopped), None, "it takes the place of no program");
    }
}
