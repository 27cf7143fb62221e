//! `dca replay --foxglove`: serves a record, which clients play, pause and search.

use super::FoxgloveServer;
use crate::logic::foxglove::Hub;
use crate::logic::record::Timeline;
use crate::reader::Reader;
use comms::io::clock;
use comms::logic::time::Time;
use std::net::SocketAddr;

/// Serves a record until the user leaves.
pub(crate) async fn serve(
    address: SocketAddr,
    origins: Vec<String>,
    timeline: Timeline,
    reader: &mut Reader,
) -> anyhow::Result<()> {
    let session = u64::try_from(clock::unix_time().as_millis()).unwrap_or(u64::MAX);
    let mut server = FoxgloveServer::open(address, origins, Hub::of_record(session, timeline)).await?;
    loop {
        let deadline = server.shared.hub().deadline();
        tokio::select! {
            accepted = server.visitors.next() => server.accept(accepted?),
            // A client may have begun to play it, or has paused it.
            () = server.shared.asked.notified() => server.shared.wake(),
            () = until(deadline) => {
                server.shared.hub().play(clock::now());
                server.shared.wake();
            }
            () = reader.left() => break,
        }
    }
    server.close().await;
    Ok(())
}

/// Waits until a time; for ever if there is none.
async fn until(deadline: Option<Time>) {
    match deadline {
        Some(deadline) => clock::sleep_until(deadline).await,
        None => std::future::pending().await,
    }
}
