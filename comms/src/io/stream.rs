//! TCP sockets: accepting connections, and frames on them ([`crate::logic::frame`]).

use crate::logic::frame::{self, FrameError, PREFIX_SIZE};
use std::collections::{BTreeMap, VecDeque};
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;
use thiserror::Error;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{AbortHandle, JoinSet};

/// The pause before the next accept after the system has refused one.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Accepts connections for ever, and serves each. At most `serving_max` are served at a time. A further connection
/// replaces the oldest connection of the address that has the most. So an address with many
/// connections cannot end the connections of another address.
///
/// # Cancellation
/// All connections end.
pub async fn accept<F>(listener: TcpListener, serving_max: usize, serve: impl Fn(TcpStream, SocketAddr) -> F)
where
    F: Future<Output = ()> + Send + 'static,
{
    let (mut tasks, mut begun) = (JoinSet::new(), VecDeque::<(IpAddr, AbortHandle)>::new());
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = tasks.join_next() => continue,
        };
        let Ok((stream, from)) = accepted else {
            tokio::time::sleep(ACCEPT_PAUSE).await;
            continue;
        };
        begun.retain(|(_, task)| !task.is_finished());
        if begun.len() >= serving_max
            && let Some((_, given_up)) = gives_way(&begun).and_then(|place| begun.remove(place))
        {
            given_up.abort();
        }
        begun.push_back((from.ip(), tasks.spawn(serve(stream, from))));
    }
}

/// Returns the index of the oldest connection of the address that has the most.
fn gives_way<T>(begun: &VecDeque<(IpAddr, T)>) -> Option<usize> {
    let mut counts = BTreeMap::<IpAddr, usize>::new();
    begun.iter().for_each(|(address, _)| *counts.entry(*address).or_default() += 1);
    let most = counts.values().copied().max()?;
    begun.iter().position(|(address, _)| counts.get(address) == Some(&most))
}

/// Why a frame could not be sent or received.
#[derive(Debug, Error)]
pub enum StreamError {
    /// The connection is broken.
    #[error("the other side has hung up")]
    HungUp(#[source] std::io::Error),
    /// The frame is longer than allowed.
    #[error(transparent)]
    TooLong(#[from] FrameError),
}

/// Sends a frame.
///
/// # Errors
/// The connection is broken, or `body` is longer than `size_max`.
pub async fn send(stream: &mut (impl AsyncWrite + Unpin), body: &[u8], size_max: usize) -> Result<(), StreamError> {
    stream.write_all(&frame::encode(body, size_max)?).await.map_err(StreamError::HungUp)?;
    stream.flush().await.map_err(StreamError::HungUp)
}

/// Receives a frame. Nothing is allocated for a frame that is too long.
///
/// # Errors
/// The connection is broken, or the frame is longer than `size_max`.
pub async fn receive(stream: &mut (impl AsyncRead + Unpin), size_max: usize) -> Result<Vec<u8>, StreamError> {
    let mut prefix = [0; PREFIX_SIZE];
    stream.read_exact(&mut prefix).await.map_err(StreamError::HungUp)?;
    let size = usize::try_from(u32::from_le_bytes(prefix)).unwrap_or(usize::MAX);
    if size > size_max {
        return Err(FrameError::TooLong { size, size_max }.into());
    }
    let mut body = vec![0; size];
    stream.read_exact(&mut body).await.map_err(StreamError::HungUp)?;
    Ok(body)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_with_many_connections_ends_its_own() {
        let begun = |machines: &[u8]| machines.iter().map(|machine| (IpAddr::from([10, 0, 0, *machine]), ())).collect();
        assert_eq!(gives_way::<()>(&begun(&[])), None);
        assert_eq!(gives_way(&begun(&[1, 2, 3])), Some(0), "the oldest");
        assert_eq!(gives_way(&begun(&[1, 2, 3, 2, 1, 2])), Some(1));
    }

    #[tokio::test]
    async fn a_frame_arrives_whole_or_not_at_all() {
        let (mut near, mut far) = tokio::io::duplex(64);
        send(&mut near, b"abc", 3).await.unwrap();
        assert_eq!(receive(&mut far, 3).await.unwrap(), b"abc");
        assert!(matches!(send(&mut near, b"abcd", 3).await, Err(StreamError::TooLong(_))));
        send(&mut near, b"abcd", 4).await.unwrap();
        assert!(matches!(receive(&mut far, 3).await, Err(StreamError::TooLong(_))));
        let (mut near, mut far) = tokio::io::duplex(64);
        near.write_all(&[9, 0, 0, 0, 1]).await.unwrap();
        drop(near);
        assert!(matches!(receive(&mut far, 9).await, Err(StreamError::HungUp(_))));
    }
}
