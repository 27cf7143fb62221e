//! How long a TCP link may carry nothing before the system gives it up.
//!
//! Zenoh gives a silent link up after its lease, which is the same for all links and has to suit the longest way. The system
//! knows better: it sees which bytes have arrived. Zenoh keeps its sockets to itself, so they are found among this process's
//! descriptors by their two ends.

use rustix::net::sockopt::set_tcp_user_timeout;
use rustix::process::{PidfdFlags, PidfdGetfdFlags, getpid, pidfd_getfd, pidfd_open};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::time::Duration;

/// The two ends of a link, this one first.
pub(super) type Ends = (SocketAddr, SocketAddr);

/// Gives a link so long; says whether it was found.
pub(super) fn set(ends: Ends, patience: Duration) -> bool {
    let millis = u32::try_from(patience.as_millis()).unwrap_or(u32::MAX);
    find(ends).is_some_and(|socket| set_tcp_user_timeout(&socket, millis).is_ok())
}

/// Ends a link, at both sides: who waits for more reads an end.
pub(super) fn cut(ends: Ends) {
    if let Some(Err(error)) = find(ends).map(|socket| socket.shutdown(Shutdown::Both)) {
        tracing::debug!(%error, "a link was not cut");
    }
}

fn find(ends: Ends) -> Option<TcpStream> {
    let own = pidfd_open(getpid(), PidfdFlags::empty()).ok()?;
    let entries = std::fs::read_dir("/proc/self/fd").ok()?.flatten();
    let is_socket = |path: &std::path::Path| {
        std::fs::read_link(path).is_ok_and(|target| target.to_string_lossy().starts_with("socket:"))
    };
    let mut numbers = entries.filter(|entry| is_socket(&entry.path())).filter_map(|entry| {
        let number: i32 = entry.file_name().to_str()?.parse().ok()?;
        Some(number)
    });
    numbers.find_map(|number| {
        // A copy of the descriptor: the same socket, and nothing of zenoh's is touched.
        let socket = TcpStream::from(pidfd_getfd(&own, number, PidfdGetfdFlags::empty()).ok()?);
        let (local, remote) = (plain(socket.local_addr().ok()?), plain(socket.peer_addr().ok()?));
        ((local, remote) == (plain(ends.0), plain(ends.1))).then_some(socket)
    })
}

/// An address of the older family looks different on a socket of both.
fn plain(address: SocketAddr) -> SocketAddr {
    SocketAddr::new(address.ip().to_canonical(), address.port())
}
