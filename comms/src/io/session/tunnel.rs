//! Tunnels between hosts of a team: TLS 1.3 with keys at both ends around the bytes of a zenoh link.
//!
//! Zenoh itself listens only on a Unix socket. A [`Tunnels`] listens on TCP in its place. It lets in only peers whose
//! credential its [`Identity`] trusts, and relays their bytes to that socket. The dialling side does the same. So no
//! byte of an untrusted host reaches zenoh, new keys and revocations apply at once, and a link ends
//! with its credential.
//!
//! ```text
//! zenoh ── Unix socket ── Tunnels ═══ TLS over TCP ═══ Tunnels ── Unix socket ── zenoh
//! ```

mod handshake;
mod table;
mod tls;

pub use tls::PublicKey;

use super::patience::{self, Ends};
use crate::io::clock::now;
use crate::io::stream;
use crate::logic::human;
use handshake::{Peer, Side};
use std::collections::BTreeSet;
use std::fmt;
use std::io::ErrorKind::{BrokenPipe, ConnectionAborted, ConnectionReset, UnexpectedEof};
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use table::{Standing, Table};
use tls::Tls;
use tokio::io::{AsyncRead, AsyncWrite, copy_bidirectional_with_sizes};
use tokio::net::{TcpListener, TcpStream, UnixListener, UnixStream};
use tokio::sync::{Notify, watch};
use tokio::task::JoinSet;
use zeroize::Zeroizing;

/// How long the two ends have to identify themselves: four round trips of 3 s, and a reserve.
const HANDSHAKE_WITHIN: Duration = Duration::from_secs(15);
/// How many connections may be in the handshake at a time; a new connection replaces the oldest.
const HANDSHAKES_MAX: usize = 512;
/// How long zenoh has to connect to a tunnel that was dialled for it.
const ENTERED_WITHIN: Duration = Duration::from_secs(10);
/// How often the peers at the other ends of tunnels are judged again.
const JUDGE_EVERY: Duration = Duration::from_secs(5);
/// How many addresses of others are remembered.
const MET_MAX: usize = 256;
/// The reason for refusing a peer that has closed the connection before its identity was known.
const HUNG_UP: &str = "it closed the connection before it had identified itself";
/// How many bytes a tunnel reads at once.
const BUFFER_SIZE: usize = 32 << 10;

/// The identity of this process toward other hosts, and the peers that it trusts. Many tasks use it at once, and it
/// must not wait.
pub trait Identity: fmt::Debug + Send + Sync {
    /// Returns the secret Ed25519 key by which this process is known, and its public key.
    fn key(&self) -> (Zeroizing<[u8; 32]>, PublicKey);

    /// Returns the credential that makes others trust that key, at most 4,000 bytes.
    fn credential(&self) -> Vec<u8>;

    /// Checks a key by its credential; returns the name of its owner.
    ///
    /// # Errors
    /// The reason, for people, if the key is not trusted.
    fn judge(&self, key: &PublicKey, credential: &[u8]) -> Result<String, String>;

    /// Returns a receiver that changes when a refused peer has to be checked again, since it may be trusted soon. None
    /// if the result of [`Identity::judge`] is final.
    fn awaits(&self, _key: &PublicKey, _credential: &[u8]) -> Option<watch::Receiver<()>> {
        None
    }

    /// Returns the revocations that this process knows.
    fn revocations(&self) -> Vec<u8>;

    /// Takes revocations from a trusted peer. Returns whether any of them was unknown.
    fn hear(&self, revocations: &[u8]) -> bool;

    /// Notes that a peer was refused, and why.
    fn refused(&self, from: SocketAddr, why: &str);
}

/// The options of tunnels.
#[derive(Clone, Debug)]
pub(crate) struct TunnelOptions {
    pub(crate) identity: Arc<dyn Identity>,
    /// Where to listen.
    pub(crate) listen: Vec<SocketAddr>,
    /// The Unix socket of zenoh, in a folder that only this user can enter.
    pub(crate) entrance: PathBuf,
}

/// The tunnels of a session.
#[derive(Debug)]
pub(crate) struct Tunnels {
    session: String,
    identity: Arc<dyn Identity>,
    tls: Tls,
    entrance: PathBuf,
    locators: Vec<String>,
    made: AtomicU64,
    table: Mutex<Table>,
    /// The addresses from which trusted peers have connected.
    met: Mutex<BTreeSet<IpAddr>>,
    /// The present tunnels, each a task.
    tasks: Mutex<JoinSet<()>>,
    /// Notified when a change may end tunnels.
    changed: Notify,
}

impl fmt::Debug for Tls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Tls(..)")
    }
}

impl Tunnels {
    /// Binds the addresses to listen on. [`Tunnels::serve`] accepts.
    pub(super) async fn bind(session: String, options: TunnelOptions) -> Result<(Self, Vec<TcpListener>), String> {
        let (secret, public) = options.identity.key();
        let tls = Tls::new(&secret, &public).map_err(|error| format!("the key cannot be used: {error}"))?;
        let (mut listeners, mut locators) = (Vec::new(), Vec::new());
        for address in options.listen {
            let bound = TcpListener::bind(address).await.and_then(|listener| Ok((listener.local_addr()?, listener)));
            let (at, listener) =
                bound.map_err(|error| format!("cannot listen on {address}: {}", human::cause(&error)))?;
            locators.push(super::locator(at.ip(), at.port()));
            listeners.push(listener);
        }
        let tunnels = Self {
            session,
            identity: options.identity,
            tls,
            entrance: options.entrance,
            locators,
            made: AtomicU64::new(0),
            table: Mutex::default(),
            met: Mutex::default(),
            tasks: Mutex::default(),
            changed: Notify::new(),
        };
        Ok((tunnels, listeners))
    }

    /// Returns the locators at which it listens.
    pub(crate) fn locators(&self) -> &[String] {
        &self.locators
    }

    /// Accepts others on a listener, for ever.
    pub(super) async fn serve(self: Arc<Self>, listener: TcpListener) {
        stream::accept(listener, HANDSHAKES_MAX, |stream, from| Arc::clone(&self).admit(stream, from)).await;
    }

    /// Ends tunnels to peers that are no longer trusted; runs for ever.
    pub(super) async fn judge(self: Arc<Self>) {
        loop {
            drop(tokio::time::timeout(JUDGE_EVERY, self.changed.notified()).await);
            let standing: Vec<(String, Standing)> = {
                let table = self.table();
                table.all().map(|(session, standing)| (session.clone(), standing.clone())).collect()
            };
            for (session, standing) in standing {
                if let Err(why) = self.identity.judge(&standing.key, &standing.credential) {
                    tracing::warn!(session, why, "a tunnel ends: the peer at its other end is no longer trusted");
                    self.identity.refused(standing.ends.1, &why);
                    standing.end.notify_one();
                }
            }
        }
    }

    /// Makes the check of all tunnels run at once.
    pub(crate) fn judge_again(&self) {
        self.changed.notify_one();
    }

    /// Ends all tunnels.
    pub(super) fn close(&self) {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner).abort_all();
    }

    /// Sets how long a tunnel may carry nothing before it is given up. Returns whether the session has a tunnel.
    pub(super) fn set_patience(&self, session: &str, patience: Duration) -> bool {
        self.ends_of(session).is_some_and(|ends| patience::set(ends, patience))
    }

    /// Returns the two ends of the tunnel to a session.
    pub(super) fn ends_of(&self, session: &str) -> Option<Ends> {
        self.table().get(session).map(|standing| standing.ends)
    }

    /// Returns the sessions whose tunnels have existed for at least `age`.
    pub(super) fn older_than(&self, age: Duration) -> Vec<String> {
        let (table, now) = (self.table(), now());
        let old = table.all().filter(|(_, standing)| now - standing.since >= age);
        old.map(|(session, _)| session.clone()).collect()
    }

    /// Cuts a tunnel; returns whether the session had one.
    pub(super) fn cut(&self, session: &str) -> bool {
        self.table().get(session).map(|standing| standing.end.notify_one()).is_some()
    }

    /// Makes a tunnel to the listener at an address. If `wanted` is given, the peer has to be that session. Returns the
    /// peer's session and name, and the path of a Unix socket that leads to it and can be connected once.
    pub(super) async fn dial(
        self: &Arc<Self>,
        address: &str,
        wanted: Option<&str>,
    ) -> Result<(String, String, PathBuf), String> {
        let (stream, peer, ends) = tokio::time::timeout(HANDSHAKE_WITHIN, self.meet(address, wanted))
            .await
            .map_err(|_elapsed| "it did not identify itself in time".to_owned())??;
        let (number, end) = self.enter(&peer, ends, &self.session)?;
        let path = self.path();
        let listener = UnixListener::bind(&path);
        let listener = listener.map_err(|error| format!("cannot make a socket: {}", human::cause(&error)))?;
        let (own, session, entry) = (Arc::clone(self), peer.session.clone(), path.clone());
        self.spawn(async move {
            let entered = tokio::time::timeout(ENTERED_WITHIN, listener.accept()).await;
            drop(std::fs::remove_file(&entry));
            if let Ok(Ok((local, _))) = entered {
                carry(stream, local, &end).await;
            }
            own.table().leave(&session, number);
        });
        Ok((peer.session, peer.name, path))
    }

    async fn meet(
        &self,
        address: &str,
        wanted: Option<&str>,
    ) -> Result<(tokio_rustls::client::TlsStream<TcpStream>, Peer, Ends), String> {
        let cause = |error: std::io::Error| human::cause(&error);
        let stream = TcpStream::connect(address).await.map_err(cause)?;
        let ends = prepare(&stream).map_err(cause)?;
        let connecting = self.tls.connector.connect(tls::server_name(), stream);
        let mut stream = connecting.await.map_err(|_tls| "it is not in a team".to_owned())?;
        let key = tls::peer_key(stream.get_ref().1)?;
        let peer = handshake::introduce(&mut stream, self.side(key), wanted).await?;
        Ok((stream, peer, ends))
    }

    /// Lets a peer in that has connected, or refuses it.
    async fn admit(self: Arc<Self>, stream: TcpStream, from: SocketAddr) {
        // A peer that only probes the port sends nothing, and is not reported.
        let mut first = [0];
        let said = tokio::time::timeout(HANDSHAKE_WITHIN, stream.peek(&mut first)).await;
        if !matches!(said, Ok(Ok(1))) {
            return;
        }
        let admitted = tokio::time::timeout(HANDSHAKE_WITHIN, self.examine(stream)).await;
        let admitted = admitted.unwrap_or_else(|_elapsed| Err("it did not identify itself in time".to_owned()));
        match admitted {
            Ok((stream, peer, ends)) => {
                let Ok((number, end)) = self.enter(&peer, ends, &peer.session) else { return };
                let own = Arc::clone(&self);
                self.spawn(async move {
                    match UnixStream::connect(&own.entrance).await {
                        Ok(local) => carry(stream, local, &end).await,
                        Err(error) => tracing::warn!(%error, "a tunnel cannot reach its session"),
                    }
                    own.table().leave(&peer.session, number);
                });
            }
            // A member has stopped waiting for this process, which was suspended or busy. It is not reported as
            // untrusted.
            Err(why) if why == HUNG_UP && self.met().contains(&from.ip()) => {
                tracing::debug!(%from, "a peer has hung up at an address of a former member");
            }
            Err(why) => self.identity.refused(from, &why),
        }
    }

    async fn examine(
        &self,
        stream: TcpStream,
    ) -> Result<(tokio_rustls::server::TlsStream<TcpStream>, Peer, Ends), String> {
        let ends = prepare(&stream).map_err(|error| human::cause(&error))?;
        let accepting = self.tls.acceptor.accept(stream);
        let mut stream = accepting.await.map_err(|error| {
            let has_gone = matches!(error.kind(), UnexpectedEof | ConnectionReset | ConnectionAborted | BrokenPipe);
            if has_gone { HUNG_UP } else { "it speaks no TLS with a key of its own" }.to_owned()
        })?;
        let key = tls::peer_key(stream.get_ref().1)?;
        let peer = handshake::examine(&mut stream, self.side(key)).await?;
        Ok((stream, peer, ends))
    }

    fn side(&self, key: PublicKey) -> Side<'_> {
        Side { session: &self.session, identity: &*self.identity, changed: &self.changed, key }
    }

    fn enter(&self, peer: &Peer, ends: Ends, dialler: &str) -> Result<(u64, Arc<Notify>), String> {
        let end = Arc::new(Notify::new());
        let standing = Standing {
            dialler: dialler.to_owned(),
            since: now(),
            key: peer.key,
            credential: peer.credential.clone(),
            ends,
            end: Arc::clone(&end),
        };
        let number = self.table().enter(&peer.session, standing)?;
        // The peer was trusted a moment ago, but may have been revoked since then. The search for tunnels of revoked
        // peers has not seen this tunnel yet.
        if let Err(why) = self.identity.judge(&peer.key, &peer.credential) {
            self.table().leave(&peer.session, number);
            self.identity.refused(ends.1, &why);
            return Err(why);
        }
        let mut met = self.met();
        if met.len() < MET_MAX {
            met.insert(ends.1.ip());
        }
        drop(met);
        if !patience::set_as_measured(ends) {
            tracing::debug!(?ends, "the socket of a tunnel was not found");
        }
        tracing::debug!(session = peer.session, name = peer.name, "a tunnel stands");
        Ok((number, end))
    }

    fn spawn(&self, task: impl Future<Output = ()> + Send + 'static) {
        let mut tasks = self.tasks.lock().unwrap_or_else(PoisonError::into_inner);
        while tasks.try_join_next().is_some() {}
        tasks.spawn(task);
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn met(&self) -> MutexGuard<'_, BTreeSet<IpAddr>> {
        self.met.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns an unused path beside the entrance.
    fn path(&self) -> PathBuf {
        let number = self.made.fetch_add(1, Ordering::Relaxed);
        let session = self.session.get(..8).unwrap_or(&self.session);
        let path = self.entrance.parent().unwrap_or(Path::new("/")).join(format!("{session}.{number}"));
        // A process that was killed may have left its socket there.
        drop(std::fs::remove_file(&path));
        path
    }
}

fn prepare(stream: &TcpStream) -> std::io::Result<Ends> {
    stream.set_nodelay(true)?;
    Ok((stream.local_addr()?, stream.peer_addr()?))
}

/// Relays bytes in both directions until both sides have ended, or the tunnel has to end.
async fn carry(mut tunnel: impl AsyncRead + AsyncWrite + Unpin, mut local: UnixStream, end: &Notify) {
    let carried = tokio::select! {
        carried = copy_bidirectional_with_sizes(&mut tunnel, &mut local, BUFFER_SIZE, BUFFER_SIZE) => carried.map(drop),
        () = end.notified() => Ok(()),
    };
    if let Err(error) = carried {
        tracing::debug!(%error, "a tunnel has ended");
    }
}

#[cfg(test)]
mod tests;
