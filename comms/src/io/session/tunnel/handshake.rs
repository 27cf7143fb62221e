//! The first messages between the ends of a tunnel: their identities, then the revocations that they know.
//!
//! The dialling side identifies itself first. The listening side shows its credential only after it trusts the dialling side. So an
//! untrusted host learns a key, but no name.

use super::{HUNG_UP, Identity, PublicKey};
use crate::io::stream::{self, StreamError};
use crate::logic::codec::{self, Enveloped};
use crate::logic::tunnel::{Introduction, Revocations};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::Notify;

/// How long at most a peer waits that may be trusted soon.
const LET_IN_WITHIN: Duration = Duration::from_secs(2);

/// This end of a connection, and the key of the other end.
#[derive(Clone, Copy)]
pub(super) struct Side<'a> {
    pub(super) session: &'a str,
    pub(super) identity: &'a dyn Identity,
    pub(super) changed: &'a Notify,
    pub(super) key: PublicKey,
}

/// The peer at the other end.
#[derive(Debug)]
pub(super) struct Peer {
    pub(super) session: String,
    pub(super) name: String,
    pub(super) key: PublicKey,
    pub(super) credential: Vec<u8>,
}

/// The dialler's part.
pub(super) async fn introduce(
    stream: &mut (impl AsyncRead + AsyncWrite + Unpin),
    side: Side<'_>,
    wanted: Option<&str>,
) -> Result<Peer, String> {
    send(stream, &side.introduction()).await?;
    let checked = side.check(receive(stream).await.map_err(|_end| "it does not trust this node")?);
    // A refused peer gets the revocations as well. A peer with revoked keys can learn of that only here, since no node accepts it.
    // The sets are signed, and contain no secret.
    let sent = send(stream, &Revocations { sets: side.identity.revocations() }).await;
    let peer = match checked {
        Ok(peer) => peer,
        Err(why) => {
            // The peer's own sets are received and ignored. Closing earlier would discard the bytes that were just sent.
            drop(receive::<Revocations>(stream).await);
            return Err(why);
        }
    };
    if wanted.is_some_and(|wanted| wanted != peer.session) {
        return Err("another session listens there".to_owned());
    }
    sent?;
    side.hear(receive(stream).await?, &peer)?;
    Ok(peer)
}

/// The part of the listening side.
pub(super) async fn examine(
    stream: &mut (impl AsyncRead + AsyncWrite + Unpin),
    side: Side<'_>,
) -> Result<Peer, String> {
    let introduction = receive(stream).await?;
    side.wait_for(&introduction).await;
    let peer = side.check(introduction)?;
    send(stream, &side.introduction()).await?;
    send(stream, &Revocations { sets: side.identity.revocations() }).await?;
    side.hear(receive(stream).await?, &peer)?;
    Ok(peer)
}

impl Side<'_> {
    fn introduction(&self) -> Introduction {
        Introduction { session: self.session.to_owned(), credential: self.identity.credential() }
    }

    /// Waits for a while until a peer may be trusted. Both ends of a wire get each other's keys at the same time, and one end may
    /// dial before the other has received them.
    async fn wait_for(&self, introduction: &Introduction) {
        let let_in = async {
            while let Some(mut news) = self.identity.awaits(&self.key, &introduction.credential)
                && news.changed().await.is_ok()
            {}
        };
        drop(tokio::time::timeout(LET_IN_WITHIN, let_in).await);
    }

    fn check(&self, introduction: Introduction) -> Result<Peer, String> {
        let Introduction { session, credential } = introduction;
        let name = self.identity.judge(&self.key, &credential)?;
        if session == self.session || session.parse::<zenoh::config::ZenohId>().is_err() {
            return Err("its session identifier is not valid".to_owned());
        }
        Ok(Peer { session, name, key: self.key, credential })
    }

    /// Takes the revocations of the peer. They may revoke the peer itself.
    fn hear(&self, revocations: Revocations, peer: &Peer) -> Result<(), String> {
        if self.identity.hear(&revocations.sets) {
            self.changed.notify_one();
        }
        self.identity.judge(&peer.key, &peer.credential).map(drop)
    }
}

async fn send<T: Enveloped>(stream: &mut (impl AsyncWrite + Unpin), message: &T) -> Result<(), String> {
    let bytes = codec::encode(message).map_err(|error| error.to_string())?;
    stream::send(stream, &bytes, T::SIZE_MAX).await.map_err(cause)
}

async fn receive<T: Enveloped>(stream: &mut (impl AsyncRead + Unpin)) -> Result<T, String> {
    let bytes = stream::receive(stream, T::SIZE_MAX).await.map_err(cause)?;
    codec::decode(&bytes).map_err(|error| format!("its message cannot be read: {error}"))
}

fn cause(error: StreamError) -> String {
    if matches!(error, StreamError::HungUp(_)) { HUNG_UP.to_owned() } else { error.to_string() }
}
