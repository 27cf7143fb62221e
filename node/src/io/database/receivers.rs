//! The receivers of answers of the database: callers of this node, and other replicas.

use crate::io::caller::Caller;
use crate::logic::protocol::Answer;
use comms::io::session::Request;
use std::collections::BTreeMap;

/// The receivers that wait for answers.
#[derive(Default)]
pub(super) struct Receivers {
    /// By number of the call.
    callers: BTreeMap<u64, Caller>,
    /// Calls whose callers are gone, until the database is told.
    gone: Vec<u64>,
    /// Questions of other replicas.
    peers: BTreeMap<u64, Box<Request>>,
    /// The number of the last of them.
    asked: u64,
}

impl Receivers {
    /// Waits with a caller for the answers to a call.
    pub(super) fn call(&mut self, call: u64, caller: Caller) {
        self.callers.insert(call, caller);
    }

    /// Gives an answer to a caller, which may be gone.
    pub(super) fn answer(&mut self, call: u64, answer: Answer) {
        if let Some(caller) = self.callers.get(&call)
            && !caller.offer(answer)
        {
            self.callers.remove(&call);
            self.gone.push(call);
        }
    }

    /// Completes the answers to a call.
    pub(super) fn end(&mut self, call: u64) {
        self.callers.remove(&call).into_iter().for_each(Caller::end);
    }

    /// Takes the calls whose callers are gone.
    pub(super) fn take_gone(&mut self) -> Vec<u64> {
        std::mem::take(&mut self.gone)
    }

    /// Waits with another replica for the reply to a question; returns its number.
    pub(super) fn ask(&mut self, request: Box<Request>) -> u64 {
        self.asked += 1;
        self.peers.insert(self.asked, request);
        self.asked
    }

    /// Takes the question that is replied to.
    pub(super) fn reply(&mut self, asked: u64) -> Option<Box<Request>> {
        self.peers.remove(&asked)
    }
}
