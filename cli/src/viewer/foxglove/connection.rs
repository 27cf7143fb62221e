//! One connection of a client: its handshake, then frames in both directions.

use super::super::serve::{Guest, REQUEST_WITHIN, request};
use crate::logic::foxglove::{Ended, Endpoint, Entrance, Hub, Peer, Refusal, Socket, user};
use crate::logic::http::{self, Head, Status};
use comms::io::clock;
use comms::logic::time::Time;
use node::console;
use node::logic::printable::printable;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, Read as _};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::sync::{Notify, watch};
use tokio::time::{interval, timeout};

/// How often a connection is looked at when nothing happens.
const BEAT_EVERY: Duration = Duration::from_secs(1);
/// How often a client is asked for a sign of life.
const PING_EVERY: Duration = Duration::from_secs(10);
/// How long after the last byte from or to a client its connection is closed.
const SILENT_MAX: Duration = Duration::from_secs(30);
/// How long this program may have been suspended. After more, requests may be so old that their person has given up.
const STALLED_MAX: Duration = Duration::from_secs(5);
/// How many bytes are put into the buffer of a connection before they are sent.
const LEAVING_MIN: usize = 64 << 10;
/// How many bytes may wait to be sent while more is read.
const LEAVING_MAX: usize = 1 << 20;
/// The longest table of sockets that is read, in bytes.
const TABLE_MAX: u64 = 16 << 20;
/// How many pages that may not connect are named at the terminal.
const TOLD_MAX: usize = 8;

const TEXT: &str = "text/plain; charset=utf-8";

/// The parts that all connections share.
pub(super) struct Shared {
    pub(super) entrance: Entrance,
    pub(super) hub: Mutex<Hub>,
    /// Changes when there may be something for clients. Its end is the end of the server.
    pub(super) changed: watch::Sender<u64>,
    /// Tells the server that a client has asked for something.
    pub(super) asked: Notify,
    /// The pages that were named at the terminal.
    pub(super) told: Mutex<BTreeSet<String>>,
}

/// The value of `changed` that ends all connections.
const END: u64 = u64::MAX;

impl Shared {
    pub(super) fn hub(&self) -> MutexGuard<'_, Hub> {
        self.hub.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Has connections look for messages.
    pub(super) fn wake(&self) {
        self.changed.send_modify(|count| *count = count.saturating_add(1).min(END - 1));
    }

    /// Ends all connections once they have sent everything.
    pub(super) fn end(&self) {
        self.changed.send_replace(END);
    }

    /// Names a page that may not connect, once: its person sees nothing but that the connection fails.
    fn tell(&self, refusal: &Refusal) {
        let Some(origin) = &refusal.origin else { return };
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        if told.len() < TOLD_MAX && told.insert(origin.clone()) {
            console::note(&format!("note: refused: {}", printable(&refusal.why)));
        }
    }
}

/// A client that has been let in. It leaves when this is dropped.
struct Entered<'a> {
    shared: &'a Shared,
    viewer: u64,
}

impl Drop for Entered<'_> {
    fn drop(&mut self) {
        self.shared.hub().leave(self.viewer);
        self.shared.asked.notify_one();
    }
}

/// Serves one client. A client that leaves or sends nonsense ends only its own connection.
pub(super) async fn run(mut stream: TcpStream, shared: Arc<Shared>, guest: Arc<Guest>) {
    let Ok(Ok(request)) = timeout(REQUEST_WITHIN, request(&mut stream)).await else { return };
    let checked = match request {
        Ok((head, _)) => check(&stream, &shared, head).await,
        Err(status) => Err(Refusal { status, why: status.line().to_owned(), origin: None }),
    };
    let entered = checked.and_then(|answer| {
        let viewer = shared.hub().enter().ok_or_else(|| {
            let why = "too many clients are connected: close a window of another client".to_owned();
            Refusal { status: Status::Busy, why, origin: None }
        })?;
        Ok((answer, Entered { shared: &shared, viewer }))
    });
    match entered {
        Ok((answer, entered)) => {
            guest.let_in();
            // Programs are looked for at once.
            shared.asked.notify_one();
            if stream.write_all(&answer).await.is_ok() {
                talk(&mut stream, &entered).await;
            }
        }
        Err(refusal) => {
            shared.tell(&refusal);
            let answer = http::answer(refusal.status, TEXT, "", format!("{}\n", refusal.why).as_bytes());
            // The client may have left.
            drop(timeout(REQUEST_WITHIN, stream.write_all(&answer)).await);
        }
    }
    drop(timeout(BEAT_EVERY, stream.shutdown()).await);
}

/// Checks the handshake of a client; returns the answer that accepts it.
async fn check(stream: &TcpStream, shared: &Shared, head: Head) -> Result<Vec<u8>, Refusal> {
    let ends = stream.peer_addr().and_then(|peer| Ok((peer, stream.local_addr()?)));
    let peer = match ends {
        Ok((peer, here)) => {
            let found = tokio::task::spawn_blocking(move || {
                let table = table(if peer.is_ipv4() { "/proc/net/tcp" } else { "/proc/net/tcp6" })?;
                Ok::<_, io::Error>(user(&table, &endpoint(peer), &endpoint(here)))
            });
            let own = rustix::process::geteuid().as_raw();
            match found.await {
                Ok(Ok(Some(user))) if user == own || user == 0 => Peer::Own,
                _ => Peer::Other,
            }
        }
        Err(_) => Peer::Other,
    };
    shared.entrance.check(&head, peer)
}

fn endpoint(address: SocketAddr) -> Endpoint {
    let octets = match address {
        SocketAddr::V4(address) => address.ip().octets().to_vec(),
        SocketAddr::V6(address) => address.ip().octets().to_vec(),
    };
    Endpoint { octets, port: address.port() }
}

fn table(file: &str) -> io::Result<String> {
    let mut table = String::new();
    File::open(file)?.take(TABLE_MAX).read_to_string(&mut table)?;
    Ok(table)
}

/// Exchanges frames with a client until either end closes.
async fn talk(stream: &mut TcpStream, entered: &Entered<'_>) {
    let Entered { shared, viewer } = entered;
    let (mut socket, mut changed) = (Socket::new(), shared.changed.subscribe());
    changed.mark_changed();
    let (mut from, mut to) = stream.split();
    let (mut chunk, mut beat) = (vec![0; 16 << 10], interval(BEAT_EVERY));
    let mut turn = clock::now();
    let (mut alive, mut pinged) = (turn, turn);
    loop {
        let now = clock::now();
        if now.since(turn) >= STALLED_MAX {
            socket.close("this view was suspended: connect again");
            return send(&mut to, &mut socket).await;
        }
        turn = now;
        let is_cut = now.since(alive) >= SILENT_MAX || shared.hub().is_overrun(*viewer);
        if is_cut || fill(&mut socket, shared, *viewer, now).is_err() {
            return;
        }
        if *changed.borrow_and_update() == END && socket.leaving().is_empty() {
            socket.close("the view ends");
            return send(&mut to, &mut socket).await;
        }
        let is_sending = !socket.leaving().is_empty();
        let may_read = socket.leaving().len() < LEAVING_MAX;
        tokio::select! {
            read = from.read(&mut chunk), if may_read => {
                let Ok(count @ 1..) = read else { return };
                alive = clock::now();
                // Requests that came while this program was suspended are discarded in the next turn.
                if alive.since(turn) < STALLED_MAX && take(&mut socket, &chunk[..count], shared, *viewer).is_err() {
                    return send(&mut to, &mut socket).await;
                }
            }
            written = to.write(socket.leaving()), if is_sending => {
                let Ok(count @ 1..) = written else { return };
                socket.leaving().drain(..count);
                alive = clock::now();
            }
            result = changed.changed(), if !is_sending => {
                if result.is_err() {
                    return;
                }
            }
            _ = beat.tick() => {
                if now.since(pinged) >= PING_EVERY && !is_sending {
                    pinged = now;
                    if socket.ping().is_err() {
                        return;
                    }
                }
            }
        }
    }
}

/// Moves messages for a client into its buffer when that is empty.
fn fill(socket: &mut Socket, shared: &Shared, viewer: u64, now: Time) -> Result<(), Ended> {
    if !socket.leaving().is_empty() {
        return Ok(());
    }
    let mut hub = shared.hub();
    while socket.leaving().len() < LEAVING_MIN
        && let Some(frame) = hub.next(viewer, now)
    {
        socket.put(frame)?;
    }
    Ok(())
}

/// Takes bytes of a client in.
fn take(socket: &mut Socket, bytes: &[u8], shared: &Shared, viewer: u64) -> Result<(), Ended> {
    let mut hub = shared.hub();
    let at = super::robots::arrival();
    let taken = socket.take(bytes, |frame| hub.take(viewer, &frame, at));
    drop(hub);
    shared.asked.notify_one();
    taken
}

/// Sends the rest to a client that is being left.
async fn send(to: &mut tokio::net::tcp::WriteHalf<'_>, socket: &mut Socket) {
    // The client may have left.
    drop(timeout(BEAT_EVERY, to.write_all(socket.leaving())).await);
}
