//! The session of a node, and of the command line: calls, streams, presence, and messages from node to node.
//!
//! Nodes are zenoh peers and form a clique: each node is linked to each other one, and none relays for others. A command line is a client
//! of the node on its host, and reaches every other node through it. The data of controllers uses separate sessions ([`crate::io::data`]).
//!
//! Callbacks of zenoh only put values into bounded queues, so a slow task never blocks a link.

mod call;
mod config;
mod expect;
mod interfaces;
mod links;
mod message;
mod nearby;
mod open;
mod patience;
mod proof;
mod reach;
mod serve;
mod stream;
mod tally;
mod tunnel;

pub use call::{CallError, Replies};
pub(crate) use config::{Settings, unix_locator};
pub use interfaces::dialled as addresses;
pub(crate) use interfaces::{dialled, locator};
pub use message::{Beats, Presence, Subscription, Token, Watch};
pub use nearby::discovery;
pub(crate) use open::{Opened, Redial, Search, plain};
pub(crate) use proof::question;
pub use proof::{Authenticator, Author, Digest, relayed};
pub use serve::{Request, Server};
pub(crate) use tunnel::TunnelOptions;
pub use tunnel::{Identity, PublicKey};

use crate::io::descriptors;
use crate::logic::key::HostName;
use call::Calls;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;
use tokio::sync::watch;

/// How long [`Session::close`] waits. Without this limit zenoh can take 10 s when a peer has vanished.
const CLOSE_WITHIN: Duration = Duration::from_secs(2);
/// How long a session has to be silent before its link is cut. On the slowest radio, a part of an answer arrives each 0.3 s.
const CUT_AFTER: Duration = Duration::from_secs(2);
/// How long a command line without a node waits for the first nodes to answer, and how often it checks.
const SCOUT: [Duration; 2] = [Duration::from_millis(500), Duration::from_millis(20)];
/// Zenoh's thread pools in a process that only sends and receives. One pool serves almost everything, since a hand-over between pools costs
/// more than the wire. Only sending has a separate pool. The reason: a task that receives and passes on waits inside zenoh, without
/// yielding, for the task that sends. And tokio keeps a task that was just woken for the thread that woke it. The main pool has two
/// workers: with one, a call that blocks inside zenoh would block everything.
const RUNTIME_END: &str = "(rx: (handover: app), acc: (handover: app), tx: (worker_threads: 1), net: (handover: app), app: (worker_threads: 2))";
/// Zenoh's thread pools in a process that relays messages between others. A link that takes nothing blocks messages from another link, and
/// there may be several links of both kinds.
const RUNTIME_RELAY: &str = "(rx: (worker_threads: 4), acc: (handover: app), tx: (worker_threads: 1), net: (handover: app), app: (worker_threads: 2))";

/// The role of a process on its links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The session serves its own process only.
    End,
    /// The session passes some messages on to others.
    Relay,
}

/// The reach of a session: this host or the network.
#[derive(Clone, Debug)]
pub enum Reach {
    /// Programs of this user on this host.
    Host,
    /// Also hosts of the local network, unauthenticated.
    Lan,
    /// Also trusted programs on the network.
    Team(Arc<dyn Identity>),
}

/// The options of a node's session.
#[derive(Clone, Debug)]
pub struct NodeOptions {
    /// The node's name, for messages to people.
    pub name: HostName,
    /// The Unix socket to listen on, in a directory that only this user can enter.
    pub socket: PathBuf,
    /// The reach of the session.
    pub reach: Reach,
    /// The TCP port to listen on with [`Reach::Lan`]; 0 for any that is free.
    pub port: u16,
    /// Locators of nodes that are known in advance. A node may be absent; its locator is dialled until it answers.
    pub peers: Vec<String>,
}

/// An open session.
#[derive(Debug)]
pub struct Session {
    opened: Opened,
    calls: Calls,
    /// In a team: signs outgoing messages, and checks incoming messages.
    authenticator: Option<Arc<dyn Authenticator>>,
    /// Each stream of answers that still has a reader holds a receiver of this channel.
    answering: watch::Sender<()>,
}

/// Why a session could not be opened.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum OpenError {
    /// The path of the socket cannot be used.
    #[error("the socket path `{path}` cannot be used: {problem}")]
    SocketPath {
        /// The path.
        path: PathBuf,
        /// The reason.
        problem: &'static str,
    },
    /// No node on this host.
    #[error("no node answers at `{path}`: {cause}")]
    NoNode {
        /// The socket tried.
        path: PathBuf,
        /// The system's words.
        cause: String,
    },
    /// The TCP port cannot be had.
    #[error(
        "cannot listen on port {port} of {address}: {cause}; choose another port with `--port`, or leave out `--port` for any free port"
    )]
    Port {
        /// The TCP port that is taken.
        port: u16,
        /// The address of the port.
        address: String,
        /// The system's words.
        cause: String,
    },
    /// No other host of the team can connect.
    #[error("other nodes of the team cannot connect: {cause}")]
    Tunnels {
        /// The reason.
        cause: String,
    },
    /// Zenoh refuses.
    #[error("cannot open a session: {cause}")]
    Zenoh {
        /// The text of the error.
        cause: String,
    },
    /// The system gives no thread.
    #[error("cannot open a session: no thread to open it on")]
    NoThread,
}

/// Prepares this process for sessions: raises its limit of descriptors, and sets the threads of zenoh. `main` has to call this first; a
/// later or second call has no effect on the threads.
pub fn prepare_process(role: Role) {
    descriptors::raise();
    const VARIABLE: &str = "ZENOH_RUNTIME";
    let threads = std::fs::read_dir("/proc/self/task").map_or(0, Iterator::count);
    if threads != 1 || std::env::var_os(VARIABLE).is_some() {
        tracing::debug!(threads, "zenoh keeps its own thread pools");
        return;
    }
    set_variable(VARIABLE, if role == Role::Relay { RUNTIME_RELAY } else { RUNTIME_END });
}

#[expect(unsafe_code, reason = "zenoh takes the layout of its thread pools from the environment and from nowhere else")]
fn set_variable(name: &str, value: &str) {
    // SAFETY: the caller has checked that this process has a single thread, which is this one. So no other thread reads the environment
    // now.
    unsafe { std::env::set_var(name, value) };
}

/// Takes the port from the system before zenoh does, since only the system gives the reason of a failure. 0 gives a free port.
fn take_port(address: IpAddr, port: u16) -> Result<u16, OpenError> {
    let taken = TcpListener::bind(SocketAddr::new(address, port)).and_then(|listener| listener.local_addr());
    let failed =
        |cause: std::io::Error| OpenError::Port { port, address: address.to_string(), cause: cause.to_string() };
    taken.map(|at| at.port()).map_err(failed)
}

impl Session {
    /// Opens the session of a node.
    ///
    /// With [`Reach::Lan`] and [`Reach::Team`] it also listens on one TCP port, at every address that this machine has or gets. It looks
    /// for other nodes on every network interface, including interfaces that come up later: see [`Session::addresses`].
    ///
    /// # Errors
    /// If the socket cannot be used, or another node listens on it.
    ///
    /// # Cancellation
    /// The session is still opened in the background, and closed again.
    pub async fn open_node(options: NodeOptions) -> Result<Self, OpenError> {
        let mut listen = vec![unix_locator(&options.socket)?];
        let (name, mut tunnels) = (options.name.as_str().to_owned(), None);
        let everywhere = || {
            let address = nearby::everywhere();
            Ok((address, take_port(address, options.port)?))
        };
        let search = match options.reach {
            Reach::Host => Search::Off,
            Reach::Lan => {
                let (address, port) = everywhere()?;
                listen.push(locator(address, port));
                Search::Found(name, port)
            }
            Reach::Team(identity) => {
                let (address, port) = everywhere()?;
                let entrance = options.socket.clone();
                tunnels = Some(TunnelOptions { identity, listen: vec![(address, port).into()], entrance });
                Search::Found(name, port)
            }
        };
        let is_here = |peer: &String| tunnels.is_none() || peer.starts_with("unixsock-stream/");
        // All robots may share one list, which then also contains this robot.
        let is_own = |peer: &String| matches!(&search, Search::Found(_, port) if reach::is_own(peer, *port));
        let peers: Vec<String> = options.peers.into_iter().filter(|peer| !is_own(peer)).collect();
        let dialled: Vec<String> = peers.iter().filter(|peer| is_here(peer)).cloned().collect();
        let settings = Settings::node().listen(&listen).connect(&dialled);
        let mut session = Self::open(settings, Redial::Found, search, tunnels).await?;
        session.opened.watch_told(&peers);
        tracing::debug!(host = options.name.as_str(), locators = ?session.locators(), "node session is open");
        Ok(session)
    }

    /// Returns a receiver of the addresses at which other machines can find this machine. The receiver gets each
    /// change. The list is empty without a network, and with [`Reach::Host`].
    pub fn addresses(&self) -> watch::Receiver<Vec<String>> {
        self.opened.addresses()
    }

    /// Returns the peers that are dialled but not linked: the name or locator of each, and the reason, for people.
    pub fn unlinked(&self) -> Vec<(String, String)> {
        self.opened.unlinked()
    }

    /// Notes the round trip of a link, measured by the time of an answer. A link that carries nothing for much longer than this is given
    /// up.
    pub fn note_round_trip(&self, session: &str, took: Duration) {
        // Rounded to a few steps, so that the limit of the link seldom changes.
        let millis = patience::of(took).as_millis().max(1);
        let millis = u64::try_from(millis).unwrap_or(u64::MAX).checked_next_power_of_two().unwrap_or(u64::MAX);
        self.opened.set_patience(session, Duration::from_millis(millis));
    }

    /// Cuts the link to a session that sends no data any more because its process has stopped, although its system runs. A link to a
    /// process on the same machine is not cut: it ends with its lease.
    pub fn cut(&self, session: &str) {
        self.opened.cut_if_silent(session, CUT_AFTER);
    }

    /// Opens the session of a command line through the node that listens on `socket`.
    ///
    /// # Errors
    /// If no node answers there.
    ///
    /// # Cancellation
    /// The session is still opened in the background, and closed again.
    pub async fn open_client(socket: &Path) -> Result<Self, OpenError> {
        let locator = unix_locator(socket)?;
        // Connects to the socket before zenoh does, since only the system gives the reason of a failure.
        UnixStream::connect(socket)
            .map_err(|cause| OpenError::NoNode { path: socket.to_owned(), cause: cause.to_string() })?;
        Self::open(Settings::client(&locator), Redial::Listed, Search::Off, None).await
    }

    /// Opens the session of a command line on a host without a node. It looks for nodes on the local network, and returns when the first
    /// have answered, or after half a second.
    ///
    /// # Errors
    /// If there is no network to look on.
    ///
    /// # Cancellation
    /// The session is still opened in the background, and closed again.
    pub async fn open_scout() -> Result<Self, OpenError> {
        let session = Self::open(Settings::node(), Redial::Listed, Search::Ask, None).await?;
        let [within, look_every] = SCOUT;
        let found = async {
            while !session.opened.is_linked() {
                tokio::time::sleep(look_every).await;
            }
        };
        tokio::time::timeout(within, found).await.unwrap_or_default();
        Ok(session)
    }

    async fn open(
        settings: Settings,
        redial: Redial,
        search: Search,
        tunnels: Option<TunnelOptions>,
    ) -> Result<Self, OpenError> {
        // Zenoh blocks while it opens, and panics on a single-threaded runtime.
        let opening = on_thread("dca-open", move || Opened::open(settings, redial, search, tunnels));
        let opened = opening.await.ok_or(OpenError::NoThread)??;
        Ok(Self { opened, calls: Calls::default(), authenticator: None, answering: watch::Sender::new(()) })
    }

    /// Signs outgoing messages from now on, and checks incoming messages. Call this before any message is sent.
    #[must_use]
    pub fn authenticated_by(mut self, authenticator: Arc<dyn Authenticator>) -> Self {
        self.authenticator = Some(authenticator);
        self
    }

    /// Checks all peers from other hosts of the team again, after the keys or revocations on which their trust is based have changed.
    pub fn judge_again(&self) {
        self.opened.judge_again();
    }

    /// Returns the session's id, lower-case hex.
    pub fn id(&self) -> String {
        self.opened.id()
    }

    /// Serves `key`, which may be an expression such as [`crate::logic::key::rpc_any`]. Since another session may serve the
    /// same key, a request may also name this session ([`Session::at_the_other_end`]).
    ///
    /// At most 256 requests wait; further requests are refused.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn serve(&self, key: &str) -> Result<Server, CallError> {
        Server::open(self, key)
    }

    /// Waits until each caller of a complete stream has taken the whole stream.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn answered(&self) {
        self.answering.closed().await;
    }

    /// Returns the locators at which the session listens.
    pub fn locators(&self) -> Vec<String> {
        self.opened.locators()
    }

    /// Closes the session; waits 2 s at most.
    ///
    /// # Cancellation
    /// The session closes in the background.
    pub async fn close(self) {
        let closing = on_thread("dca-close", move || self.opened.close());
        if tokio::time::timeout(CLOSE_WITHIN, closing).await.is_err() {
            tracing::debug!("the session is still closing");
        }
    }
}

/// Runs a blocking function on a separate thread; none if no thread can be started.
async fn on_thread<T: Send + 'static>(name: &str, work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    let (done_tx, done) = tokio::sync::oneshot::channel();
    let thread = std::thread::Builder::new().name(name.to_owned());
    // The thread ends with its work. A caller that no longer waits does not want the result.
    thread.spawn(move || drop(done_tx.send(work()))).ok()?;
    done.await.ok()
}
