//! Waits until a node is ready: then every client that has the right can call it.

use crate::io::peers::Peers;
use comms::io::session::Reach;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinSet;

/// How long it takes to find the interfaces that are up.
const FOUND_WITHIN: Duration = Duration::from_millis(500);

/// Announces that the node is ready. If other hosts should find the node, waits until they can find it.
pub(super) fn announce(peers: &Peers, reach: &Reach, ready: watch::Sender<bool>, tasks: &mut JoinSet<()>) {
    if matches!(reach, Reach::Host) {
        ready.send_replace(true);
        return;
    }
    let mut addresses = peers.session().addresses();
    tasks.spawn(async move {
        let waiting = addresses.wait_for(|addresses| !addresses.is_empty());
        let found = tokio::time::timeout(FOUND_WITHIN, waiting).await.map(|found| found.is_ok());
        let found = if let Ok(found) = found {
            found
        } else {
            tracing::warn!("no network interface is up: other nodes cannot reach this node until an interface is up");
            addresses.wait_for(|addresses| !addresses.is_empty()).await.is_ok()
        };
        if found {
            ready.send_replace(true);
        }
    });
}
