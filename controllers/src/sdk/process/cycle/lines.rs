//! The lines between the loop and everything else: the other threads of the process, other programs, the node.

use crate::sdk::process::database::DatabaseLine;
use crate::sdk::process::heartbeat::{Heartbeat, Spends};
use crate::sdk::process::inbox::{Inbox, TakenSwitch};
use crate::sdk::process::links::Links;
use crate::sdk::process::node_line::NoticeLog;
use comms::logic::control::Notice;
use comms::logic::time::Time;
use std::sync::Arc;

/// The lines of the loop.
pub(super) struct Lines {
    /// Samples, commands and answers for the loop.
    pub(super) inbox: Arc<Inbox>,
    /// The wires and calls.
    pub(super) links: Arc<Links>,
    /// The notices for the node.
    pub(super) notices: NoticeLog,
    /// The orders for the database.
    pub(super) database: Arc<DatabaseLine>,
    /// On which the loop records its activity.
    pub(super) heartbeat: Arc<Heartbeat>,
}

impl Lines {
    pub(super) fn new(inbox: Arc<Inbox>, links: Arc<Links>, notices: NoticeLog) -> Self {
        let database = Arc::new(DatabaseLine::new(notices.clone()));
        Self { inbox, links, notices, database, heartbeat: Arc::default() }
    }

    /// Waits for something in the inbox.
    pub(super) fn wait(&self, until: Option<Time>) {
        self.heartbeat.enter(Spends::Waiting);
        self.inbox.wait(until);
        self.heartbeat.enter(Spends::Working);
    }

    /// Flips the wires that a switch of inputs makes the program itself flip, and tells the node.
    pub(super) fn flip(&self, switch: &TakenSwitch) {
        if let Some(flip) = &switch.then {
            self.links.flip(flip);
        }
        self.tell(&switch.notice);
    }

    /// The listener notices a node that is gone, and the program reports to the next node later.
    pub(super) fn tell(&self, notice: &Notice) {
        if let Err(error) = self.notices.send(notice) {
            tracing::debug!(%error, "the node was not told");
        }
    }
}
