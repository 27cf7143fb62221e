//! The connections of one server of a view. Connections that have not been let in yet have a limit of their own.

use super::serve::Guest;
use anyhow::anyhow;
use comms::logic::human::cause;
use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::timeout;

/// How long clients have for the results of their orders when the command is left.
pub(super) const ANSWERED_WITHIN: Duration = Duration::from_secs(1);

/// How many connections a server has at most.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub(super) connections: usize,
    /// How many of them may not have been let in yet. A further one takes the place of the oldest, so no stranger keeps a person out.
    pub(super) strangers: usize,
}

/// The connections of a server.
pub(super) struct Visitors {
    listener: TcpListener,
    limits: Limits,
    tasks: JoinSet<()>,
    strangers: VecDeque<(AbortHandle, Arc<Guest>)>,
}

impl Visitors {
    /// Begins to listen; returns the address as well. `option` is the option of the command that has the address.
    pub(super) async fn listen(
        option: &str,
        address: SocketAddr,
        limits: Limits,
    ) -> anyhow::Result<(Self, SocketAddr)> {
        let listener = TcpListener::bind(address).await.map_err(|error| unheard(option, address, &error))?;
        let address = listener.local_addr()?;
        Ok((Self { listener, limits, tasks: JoinSet::new(), strangers: VecDeque::new() }, address))
    }

    /// Returns the next connection, once there is room for it.
    ///
    /// # Cancellation
    /// Safe.
    pub(super) async fn next(&mut self) -> anyhow::Result<TcpStream> {
        loop {
            tokio::select! {
                accepted = self.listener.accept(), if self.tasks.len() < self.limits.connections => {
                    // A client that has left before it was accepted is no reason to end.
                    if let Ok((stream, _)) = accepted {
                        return Ok(stream);
                    }
                }
                Some(ended) = self.tasks.join_next() => {
                    ended.or_else(|error| if error.is_cancelled() { Ok(()) } else { Err(error) })?;
                }
            }
        }
    }

    /// Serves a connection.
    pub(super) fn serve<F: Future<Output = ()> + Send + 'static>(&mut self, serve: impl FnOnce(Arc<Guest>) -> F) {
        self.strangers.retain(|(task, guest)| !task.is_finished() && !guest.is_known());
        if self.strangers.len() >= self.limits.strangers
            && let Some((oldest, _)) = self.strangers.pop_front()
        {
            oldest.abort();
        }
        let guest = Arc::new(Guest::default());
        let task = self.tasks.spawn(serve(Arc::clone(&guest)));
        self.strangers.push_back((task, guest));
    }

    /// Ends all connections. Each visitor has this time to end by itself.
    pub(super) async fn close(mut self, within: Duration) {
        let ended = async { while self.tasks.join_next().await.is_some() {} };
        timeout(within, ended).await.unwrap_or_default();
        self.tasks.shutdown().await;
    }
}

/// Returns the failure that a server cannot listen, with a way out.
fn unheard(option: &str, address: SocketAddr, error: &io::Error) -> anyhow::Error {
    let free = SocketAddr::new(address.ip(), 0);
    let reason = if error.kind() == ErrorKind::AddrInUse {
        "another program listens there, perhaps another view; "
    } else if error.kind() == ErrorKind::PermissionDenied {
        "ports below 1024 are for root; "
    } else {
        ""
    };
    anyhow!("cannot listen on `{address}`: {}; {reason}`{option} {free}` takes a free port", cause(error))
}
