//! The lines between modules: wires, calls that have no answer yet, and a cut of the network.

use super::ModuleId;
use crate::sdk::export::RawReply;
use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

/// A wire of data, or a connection of a call with an export.
pub(super) struct Wire {
    pub(super) from: (usize, &'static str),
    pub(super) to: (usize, &'static str),
    pub(super) is_call: bool,
    pub(super) open: u32,
}

/// A call without an answer.
pub(super) struct OpenCall {
    /// The module that has made the call, with the name and the number of the call there.
    pub(super) caller: usize,
    pub(super) call: &'static str,
    pub(super) number: u64,
    /// The module that is called, and its export.
    pub(super) server: usize,
    pub(super) export: &'static str,
    pub(super) argument: Vec<u8>,
    /// Until when the call waits for a server that does not run.
    pub(super) begins_by: Time,
    /// Lives as long as the caller waits.
    pub(super) wanted: Arc<()>,
}

/// An answer that a module has given.
pub(super) struct Given {
    pub(super) call: u64,
    pub(super) result: Result<Vec<u8>, ObjectError>,
}

/// The way of one answer. If it is dropped without an answer, its caller receives [`ObjectError::Gone`].
struct AnswerWay {
    call: u64,
    given: Arc<Mutex<Vec<Given>>>,
    is_answered: bool,
}

impl AnswerWay {
    fn give(&mut self, result: Result<Vec<u8>, ObjectError>) {
        self.is_answered = true;
        let given = Given { call: self.call, result };
        self.given.lock().unwrap_or_else(PoisonError::into_inner).push(given);
    }
}

impl Drop for AnswerWay {
    fn drop(&mut self) {
        if !self.is_answered {
            self.give(Err(ObjectError::Gone));
        }
    }
}

/// Wires, open calls and a cut.
#[derive(Default)]
pub(super) struct Lines {
    pub(super) wires: Vec<Wire>,
    open: BTreeMap<u64, OpenCall>,
    numbered: u64,
    /// The answers that modules have given since they were last taken.
    given: Arc<Mutex<Vec<Given>>>,
    /// The modules on one side of a cut. Empty without a cut.
    island: BTreeSet<usize>,
}

impl Lines {
    /// Puts these modules on one side of a cut, and all others on the other side.
    pub(super) fn cut(&mut self, modules: &[ModuleId]) {
        self.island = modules.iter().map(|module| module.number()).collect();
    }

    /// Returns whether a cut is between two modules.
    pub(super) fn is_cut(&self, from: usize, to: usize) -> bool {
        self.island.contains(&from) != self.island.contains(&to)
    }

    /// Returns the export that a call of a module leads to now.
    pub(super) fn server(&self, caller: usize, call: &str) -> Option<(usize, &'static str)> {
        let leads = |wire: &&Wire| wire.is_call && wire.open > 0 && wire.from.0 == caller && wire.from.1 == call;
        self.wires.iter().find(leads).map(|wire| wire.to)
    }

    /// Returns the calls of a module that the spec connects.
    pub(super) fn connected(&self, caller: usize) -> Vec<&'static str> {
        let own = self.wires.iter().filter(|wire| wire.is_call && wire.from.0 == caller);
        own.map(|wire| wire.from.1).collect()
    }

    /// Takes note of a call; returns its number among all calls.
    pub(super) fn begin(&mut self, call: OpenCall) -> u64 {
        self.numbered += 1;
        self.open.insert(self.numbered, call);
        self.numbered
    }

    /// Returns an open call.
    pub(super) fn call(&self, call: u64) -> Option<&OpenCall> {
        self.open.get(&call)
    }

    /// Returns the way of the answer to a call.
    pub(super) fn reply(&self, call: u64) -> Option<RawReply> {
        let wanted = Arc::downgrade(&self.open.get(&call)?.wanted);
        let mut way = AnswerWay { call, given: Arc::clone(&self.given), is_answered: false };
        Some(RawReply::new(move |result| way.give(result), move || wanted.strong_count() > 0))
    }

    /// Removes a call. Its later answers are dropped.
    pub(super) fn end(&mut self, call: u64) -> Option<OpenCall> {
        self.open.remove(&call)
    }

    /// Removes the call that a module has made under this number.
    pub(super) fn cancel(&mut self, caller: usize, call: &str, number: u64) {
        let is_it = |open: &OpenCall| open.caller == caller && open.call == call && open.number == number;
        let found = self.open.iter().find(|(_, open)| is_it(open)).map(|(number, _)| *number);
        found.into_iter().for_each(|call| drop(self.end(call)));
    }

    /// Removes all calls of a module whose activation has ended.
    pub(super) fn end_all(&mut self, caller: usize) {
        let own: Vec<u64> =
            self.open.iter().filter(|(_, call)| call.caller == caller).map(|(number, _)| *number).collect();
        own.into_iter().for_each(|call| drop(self.end(call)));
    }

    /// Takes the answers that modules have given.
    pub(super) fn take_given(&mut self) -> Vec<Given> {
        std::mem::take(&mut *self.given.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
