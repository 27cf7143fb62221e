//! The connections to robots that a question of the page needs.

use crate::ConnectArgs;
use crate::client::Client;
use crate::live::Live;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use view::RobotId;

/// How long robots have for the answer to a question of the page.
pub(super) const READ_WITHIN: Duration = Duration::from_secs(8);

/// The connections to robots.
pub(super) struct Ways {
    pub(super) clients: Vec<Arc<Client>>,
    pub(super) connect: ConnectArgs,
}

/// A request for the connection to one robot, or for all connections.
pub(super) struct WaysRequest {
    robot: Option<RobotId>,
    reply: oneshot::Sender<Ways>,
}

impl WaysRequest {
    /// Asks the view for connections. Returns nothing if the view ends.
    pub(super) async fn send(to: &mpsc::Sender<Self>, robot: Option<RobotId>) -> Option<Ways> {
        let (reply, ways) = oneshot::channel();
        to.send(Self { robot, reply }).await.ok()?;
        ways.await.ok()
    }

    /// Answers with the connections.
    pub(super) fn answer(self, live: &Live) {
        let clients = match &self.robot {
            Some(robot) => live.client_of(robot).into_iter().collect(),
            None => live.clients().shared(),
        };
        // A browser that has left needs no connection.
        drop(self.reply.send(Ways { clients, connect: live.connect() }));
    }
}
