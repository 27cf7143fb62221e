//! The requests of the controller to the database of its node, and the requests without an answer. This module is
//! between the loop and the control channel.
//!
//! Nothing is sent twice. If the node was lost, the answer to open requests is "unknown", and watches start again.

use super::inbox::Inbox;
use super::node_line::NoticeLog;
use crate::sdk::database::{DatabaseOrder, Unknown};
use comms::io::control::ControlError;
use comms::logic::control::Notice;
use comms::logic::database::{DatabaseAnswer, DatabaseRefusal, DatabaseRequest};
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The connection of a program to the database.
#[derive(Debug)]
pub(super) struct DatabaseLine {
    notices: NoticeLog,
    open: Mutex<Open>,
}

/// An open request.
#[derive(Debug, Default)]
struct Open {
    made: u64,
    /// By its number on the channel, each request.
    requests: BTreeMap<u64, Asked>,
}

#[derive(Debug)]
struct Asked {
    activation: u32,
    /// The number of the request in its activation.
    number: u64,
    /// The request of a watch, which is repeated on a new channel; none for other requests.
    watch: Option<DatabaseRequest>,
    /// The channel over which the request was sent; none without a node.
    channel: Option<u64>,
}

/// An answer, for the loop.
#[derive(Debug)]
pub(super) struct Answered {
    pub(super) activation: u32,
    /// The number of the request in that activation.
    pub(super) number: u64,
    pub(super) answer: Result<DatabaseAnswer, Unknown>,
}

impl DatabaseLine {
    pub(super) fn new(notices: NoticeLog) -> Self {
        Self { notices, open: Mutex::default() }
    }

    /// Executes an order of an activation; never waits.
    pub(super) fn order(&self, activation: u32, order: DatabaseOrder, inbox: &Inbox) {
        let mut open = self.open();
        match order {
            DatabaseOrder::Ask { number, request } => {
                open.made += 1;
                let (id, is_watch) = (open.made, matches!(request, DatabaseRequest::Watch { .. }));
                let watch = is_watch.then(|| request.clone());
                match self.notices.send_now(&Notice::Database { number: id, request }) {
                    Ok(channel) if channel.is_some() || is_watch => {
                        open.requests.insert(id, Asked { activation, number, watch, channel });
                    }
                    Ok(_) => inbox.database(refused(activation, number, DatabaseRefusal::NoNode)),
                    Err(error) => inbox.database(refused(activation, number, too_long(&error))),
                }
            }
            DatabaseOrder::Taken { number } => {
                if let Some(id) = open.find(activation, number) {
                    self.say(id, DatabaseRequest::Taken { parts: 1 });
                }
            }
            DatabaseOrder::Cancel { number } => {
                if let Some(id) = open.find(activation, number) {
                    open.requests.remove(&id);
                    self.say(id, DatabaseRequest::Cancel);
                }
            }
        }
    }

    /// Takes an answer of the node.
    pub(super) fn take(&self, id: u64, answer: DatabaseAnswer, inbox: &Inbox) {
        let mut open = self.open();
        // The answer to a request that is no longer wanted is dropped.
        let Some(asked) = open.requests.get(&id) else { return };
        let (activation, number) = (asked.activation, asked.number);
        if !answer.is_part() {
            open.requests.remove(&id);
        }
        inbox.database(Answered { activation, number, answer: Ok(answer) });
    }

    /// Takes note of a new channel: requests over earlier channels get the answer "unknown", and watches start again.
    pub(super) fn renew(&self, inbox: &Inbox) {
        let (mut open, channel) = (self.open(), self.notices.channel());
        let Open { made, requests } = &mut *open;
        let (lost, kept) = std::mem::take(requests).into_iter().partition(|(_, asked)| asked.channel < Some(channel));
        *requests = kept;
        for asked in BTreeMap::into_values(lost) {
            let (activation, number) = (asked.activation, asked.number);
            let Some(request) = asked.watch.clone() else {
                inbox.database(Answered { activation, number, answer: Err(Unknown::NodeLost) });
                continue;
            };
            *made += 1;
            let channel = self.notices.send_now(&Notice::Database { number: *made, request }).unwrap_or_default();
            requests.insert(*made, Asked { channel, ..asked });
        }
    }

    /// Drops all requests, because the activation is over.
    pub(super) fn cancel_all(&self) {
        for (id, asked) in std::mem::take(&mut self.open().requests) {
            if asked.watch.is_some() {
                self.say(id, DatabaseRequest::Cancel);
            }
        }
    }

    /// Sends a request about a watch. Without a node it is lost.
    fn say(&self, number: u64, request: DatabaseRequest) {
        if let Err(error) = self.notices.send_now(&Notice::Database { number, request }) {
            tracing::debug!(%error, "the node was not told");
        }
    }

    fn open(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Open {
    fn find(&self, activation: u32, number: u64) -> Option<u64> {
        let mut requests = self.requests.iter();
        let found = requests.find(|(_, asked)| asked.activation == activation && asked.number == number);
        found.map(|(id, _)| *id)
    }
}

fn refused(activation: u32, number: u64, why: DatabaseRefusal) -> Answered {
    Answered { activation, number, answer: Ok(DatabaseAnswer::Refused(why)) }
}

fn too_long(error: &ControlError) -> DatabaseRefusal {
    DatabaseRefusal::Database { why: error.to_string() }
}
