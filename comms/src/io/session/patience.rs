//! The time that a TCP link may carry nothing before the system gives the link up.
//!
//! Zenoh gives a silent link up after its lease, which is the same for all links and has to suit the slowest one. The system
//! knows more: it sees which bytes have arrived. Zenoh does not give access to its sockets, so this module finds them among
//! the descriptors of this process, by their two ends.

use rustix::net::sockopt::{set_tcp_user_timeout, tcp_user_timeout};
use rustix::process::{PidfdFlags, PidfdGetfdFlags, getpid, pidfd_getfd, pidfd_open};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::os::fd::AsRawFd;
use std::time::Duration;

/// How long a link may carry nothing, in addition to its round trips.
const BESIDES: Duration = Duration::from_secs(1);
/// The least time for a new link. Its round trip was measured only once, and may grow later. With the time to the next sign
/// of life, and to the first repetition of that, a cut is noticed after 1.9 s.
const ONCE_MIN: Duration = Duration::from_millis(1250);

/// The two ends of a link: this process first, then the peer.
pub(super) type Ends = (SocketAddr, SocketAddr);

/// Sets how long a link may carry nothing; returns whether the link was found.
pub(super) fn set(ends: Ends, patience: Duration) -> bool {
    find(ends).is_some_and(|socket| set_tcp_user_timeout(&socket, millis(patience)).is_ok())
}

/// Returns whether there is a link with these ends.
pub(super) fn is_there(ends: Ends) -> bool {
    find(ends).is_some()
}

/// Returns how long a link with this round trip may carry nothing.
pub(super) fn of(round_trip: Duration) -> Duration {
    BESIDES + 2 * round_trip
}

/// The same for a new link, whose round trip is measured once.
pub(super) fn of_new(round_trip: Duration) -> Duration {
    of(round_trip).max(ONCE_MIN)
}

/// Sets the limit of a new link by its round trip, which the system has measured with the first messages. Returns whether the
/// link was found.
pub(super) fn set_as_measured(ends: Ends) -> bool {
    let Some(socket) = find(ends) else { return false };
    let patience = round_trip(&socket).map(of_new);
    patience.is_some_and(|patience| set_tcp_user_timeout(&socket, millis(patience)).is_ok())
}

/// Cuts a link, for both sides: a waiting reader gets the end of the file.
pub(super) fn cut(ends: Ends) {
    if let Some(Err(error)) = find(ends).map(|socket| socket.shutdown(Shutdown::Both)) {
        tracing::debug!(%error, "a link was not cut");
    }
}

/// Sets this limit on each link to an address that has none yet. Such a link is being made, and zenoh has not reported it
/// yet.
pub(super) fn set_towards(place: SocketAddr, patience: Duration) {
    for (socket, (_, remote)) in sockets() {
        if remote == plain(place) && tcp_user_timeout(&socket).is_ok_and(|limit| limit == 0) {
            let set = set_tcp_user_timeout(&socket, millis(patience));
            tracing::trace!(%place, ?set, "a link that is being made has a limit");
        }
    }
}

fn find(ends: Ends) -> Option<TcpStream> {
    let ends = (plain(ends.0), plain(ends.1));
    sockets().find_map(|(socket, of)| (of == ends).then_some(socket))
}

/// The TCP sockets of this process that are connected, and their two ends.
fn sockets() -> impl Iterator<Item = (TcpStream, Ends)> {
    let own = pidfd_open(getpid(), PidfdFlags::empty()).ok();
    let entries = std::fs::read_dir("/proc/self/fd").ok().into_iter().flatten().flatten();
    let is_socket = |path: &std::path::Path| {
        std::fs::read_link(path).is_ok_and(|target| target.to_string_lossy().starts_with("socket:"))
    };
    let numbers = entries.filter(move |entry| is_socket(&entry.path())).filter_map(|entry| {
        let number: i32 = entry.file_name().to_str()?.parse().ok()?;
        Some(number)
    });
    numbers.filter_map(move |number| {
        // A copy of the descriptor: it refers to the same socket, and zenoh's own descriptor is not changed.
        let socket = TcpStream::from(pidfd_getfd(own.as_ref()?, number, PidfdGetfdFlags::empty()).ok()?);
        let ends = (plain(socket.local_addr().ok()?), plain(socket.peer_addr().ok()?));
        Some((socket, ends))
    })
}

/// Returns an address in its plain form. A socket for both families shows an IPv4 address as an IPv6 address.
fn plain(address: SocketAddr) -> SocketAddr {
    SocketAddr::new(address.ip().to_canonical(), address.port())
}

fn millis(time: Duration) -> u32 {
    u32::try_from(time.as_millis()).unwrap_or(u32::MAX)
}

/// Returns the smoothed round trip of a link.
fn round_trip(socket: &TcpStream) -> Option<Duration> {
    info(socket).map(|info| Duration::from_micros(u64::from(info.tcpi_rtt)))
}

/// Returns how many bytes have arrived over a link; none if the link was not found.
pub(super) fn received(ends: Ends) -> Option<u64> {
    info(&find(ends)?).map(|info| info.tcpi_bytes_received)
}

/// Returns the system's data about a link. Source: tcp(7), `TCP_INFO`. No crate in use has a safe signature for it.
#[expect(unsafe_code, reason = "rustix does not read TCP_INFO")]
fn info(socket: &TcpStream) -> Option<libc::tcp_info> {
    // SAFETY: `tcp_info` is a plain C structure of integers, for which all zeros are a valid value.
    let mut info: libc::tcp_info = unsafe { std::mem::zeroed() };
    let mut size = libc::socklen_t::try_from(size_of_val(&info)).ok()?;
    // SAFETY: the socket is open during the call, and the kernel writes at most `size` bytes to the structure.
    let answer = unsafe {
        let to = (&raw mut info).cast();
        libc::getsockopt(socket.as_raw_fd(), libc::IPPROTO_TCP, libc::TCP_INFO, to, &raw mut size)
    };
    (answer == 0).then_some(info)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;
    use std::net::TcpListener;

    #[test]
    fn a_quick_link_is_given_up_after_1250_ms() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let near = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let far = listener.accept().unwrap().0;
        let ends = |stream: &TcpStream| (stream.local_addr().unwrap(), stream.peer_addr().unwrap());
        for stream in [&near, &far] {
            assert!(set_as_measured(ends(stream)));
            assert_eq!(tcp_user_timeout(stream).unwrap(), 1250);
        }
        assert!(!set_as_measured((ends(&near).0, ends(&near).0)), "there is no such link");
    }

    #[test]
    fn the_system_counts_what_comes_over_a_link() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let near = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let mut far = listener.accept().unwrap().0;
        let ends = (near.local_addr().unwrap(), near.peer_addr().unwrap());
        assert_eq!((received(ends), received((ends.0, ends.0))), (Some(0), None));
        far.write_all(b"words").unwrap();
        near.peek(&mut [0; 5]).unwrap();
        assert_eq!(received(ends), Some(5));
    }

    #[test]
    fn a_link_that_is_being_made_gets_a_limit_and_one_that_stands_keeps_its_own() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let (place, slow) = (listener.local_addr().unwrap(), of_new(Duration::from_secs(1)));
        let (old, new) = (TcpStream::connect(place).unwrap(), TcpStream::connect(place).unwrap());
        set_tcp_user_timeout(&old, 5000).unwrap();
        set_towards(place, slow);
        assert_eq!(slow, Duration::from_secs(3));
        assert_eq!((tcp_user_timeout(&old).unwrap(), tcp_user_timeout(&new).unwrap()), (5000, 3000));
        let far = listener.accept().unwrap().0;
        assert_eq!(tcp_user_timeout(&far).unwrap(), 0, "its other end is another matter");
    }
}
