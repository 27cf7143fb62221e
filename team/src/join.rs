//! Joining over the network: the messages of [`trust::invite`] over a TCP connection, each with its length in front.
//!
//! Encryption is not needed: the joiner knows the team's key from the invitation line, and the secret is sealed for the signer.
//! An eavesdropper learns only that a robot joins, and its name.

use anyhow::{Context as _, anyhow, bail, ensure};
use comms::io::{clock, entropy, stream};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use thiserror::Error;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use trust::certificate::Certificate;
use trust::identity::{Entropy, SecretKeys};
use trust::invite::{Invite, Inviter, InviterEffect, JoinError, Joiner, MESSAGE_MAX, Message};
use trust::name::Name;
use trust::team::{Credential, Team};

/// How long one conversation may take: four messages on a slow network, and a signature.
const TALK_WITHIN: Duration = Duration::from_secs(15);
/// How long the joiner waits for an address before it tries the next one.
const CONNECT_WITHIN: Duration = Duration::from_secs(4);
/// How many conversations there may be at a time. A further one replaces the oldest conversation of the address with the most.
const TALKS_MAX: usize = 64;
/// How long a conversation with a wrong proof is kept open. So a stranger causes few expensive checks, and the right line does
/// not have to wait.
const WRONG_STAYS: Duration = Duration::from_secs(1);

/// Joins the team of an invitation, at the first of its addresses that answers.
///
/// # Errors
/// If no answer comes, if another team than the team in the line answers, or if the inviter refuses.
///
/// # Cancellation
/// The invitation may have been used.
pub async fn join(line: &str, name: Name, keys: SecretKeys) -> anyhow::Result<(SecretKeys, Team, Credential)> {
    let invite = Invite::from_line(line).context("this is not the line of an invitation")?;
    let addresses = invite.addresses.clone();
    ensure!(!addresses.is_empty(), "the invitation has no address of the inviter");
    let (joiner, hello) = Joiner::begin(invite, name, keys, crate::now(), crate::random()?)?;
    let stream = connect(&addresses).await?;
    let talk = tokio::time::timeout(TALK_WITHIN, talk(stream, joiner, &hello)).await;
    talk.map_err(|_elapsed| anyhow!("the inviter does not answer in time"))?
}

async fn connect(addresses: &[SocketAddr]) -> anyhow::Result<TcpStream> {
    let mut tried = Vec::new();
    for address in addresses {
        match tokio::time::timeout(CONNECT_WITHIN, TcpStream::connect(address)).await {
            Ok(Ok(stream)) => return Ok(stream),
            Ok(Err(error)) => tried.push(format!("{address}: {}", comms::logic::human::cause(&error))),
            Err(_elapsed) => tried.push(format!("{address}: no node answers")),
        }
    }
    bail!(
        "the inviter cannot be reached; `dca team invite` must be waiting there at the same time: {}",
        tried.join("; ")
    )
}

async fn talk(
    mut stream: TcpStream,
    mut joiner: Joiner,
    hello: &Message,
) -> anyhow::Result<(SecretKeys, Team, Credential)> {
    send(&mut stream, hello).await?;
    let proof = match receive(&mut stream).await? {
        Message::Offer(offer) => joiner.offered(*offer, crate::now())?,
        Message::Hello(_) | Message::Proof(_) | Message::Welcome(_) | Message::Refused => bail!(JoinError::Unexpected),
    };
    send(&mut stream, &proof).await?;
    match receive(&mut stream).await? {
        Message::Welcome(welcome) => Ok(joiner.welcomed(*welcome, crate::now())?),
        Message::Refused => bail!(JoinError::Refused),
        Message::Hello(_) | Message::Offer(_) | Message::Proof(_) => bail!(JoinError::Unexpected),
    }
}

/// An event while an inviter waits.
#[derive(Debug)]
pub enum Event {
    /// A robot has joined, and its certificate is stored.
    Joined(Box<Certificate>),
    /// A robot was refused; the reason.
    Refused(SocketAddr, String),
    /// A certificate could not be stored, for this reason. No robot has joined, but the invitation is used up.
    Failed(String),
}

/// Answers robots that want to join, until `events` is closed. `keep` writes a certificate to the disk; a robot is accepted only
/// after that.
///
/// # Cancellation
/// A join in progress is cut off.
pub async fn invite(
    listeners: Vec<TcpListener>,
    inviter: Inviter,
    keep: impl Fn(&Certificate) -> anyhow::Result<()> + Send + Sync + 'static,
    events: mpsc::Sender<Event>,
) {
    let door = Arc::new(Door { inviter: Mutex::new(inviter), keep: Box::new(keep), events });
    let mut listening: JoinSet<()> =
        listeners.into_iter().map(|listener| accept(listener, Arc::clone(&door))).collect();
    while listening.join_next().await.is_some() {}
}

/// The disk of the inviter refuses.
#[derive(Debug, Error)]
#[error("cannot store the certificate")]
struct NotKept;

type Keep = Box<dyn Fn(&Certificate) -> anyhow::Result<()> + Send + Sync>;

struct Door {
    inviter: Mutex<Inviter>,
    keep: Keep,
    events: mpsc::Sender<Event>,
}

async fn accept(listener: TcpListener, door: Arc<Door>) {
    stream::accept(listener, TALKS_MAX, |stream, from| answer(stream, from, Arc::clone(&door))).await;
}

async fn answer(mut stream: TcpStream, from: SocketAddr, door: Arc<Door>) {
    let talk = tokio::time::timeout(TALK_WITHIN, door.talk(&mut stream)).await;
    let event = match talk.unwrap_or_else(|_elapsed| Err(anyhow!("it did not send its request in time"))) {
        Ok(certificate) => Event::Joined(Box::new(certificate)),
        Err(error) if error.is::<NotKept>() => Event::Failed(format!("{error:#}")),
        Err(error) => Event::Refused(from, format!("{error:#}")),
    };
    door.events.send(event).await.unwrap_or_default();
}

impl Door {
    async fn talk(&self, stream: &mut TcpStream) -> anyhow::Result<Certificate> {
        let Message::Hello(hello) = receive(stream).await? else { bail!(JoinError::Unexpected) };
        let own = entropy::bytes()?;
        let offer = self.inviter().hello(&hello, own);
        send(stream, &offer).await?;
        let Message::Proof(proof) = receive(stream).await? else { bail!(JoinError::Unexpected) };
        let mut entropy: Entropy = crate::random()?;
        let proven = self.inviter().proven((&hello.nonce, &own), &proof, crate::now(), &mut entropy);
        let effects = match proven {
            Ok(effects) => effects,
            Err(error) => {
                clock::sleep_until(clock::now() + WRONG_STAYS).await;
                send(stream, &Message::Refused).await?;
                return Err(error.into());
            }
        };
        let mut welcome = None;
        for effect in effects {
            match effect {
                InviterEffect::Spend(_, certificate) => {
                    if let Err(error) = (self.keep)(&certificate) {
                        send(stream, &Message::Refused).await.unwrap_or_default();
                        return Err(error.context(NotKept));
                    }
                }
                InviterEffect::Reply(message) => {
                    send(stream, &message).await?;
                    welcome = Some(message);
                }
            }
        }
        match welcome {
            Some(Message::Welcome(welcome)) => Ok(welcome.certificate),
            _ => bail!(JoinError::Unexpected),
        }
    }

    fn inviter(&self) -> std::sync::MutexGuard<'_, Inviter> {
        self.inviter.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

async fn send(stream: &mut TcpStream, message: &Message) -> anyhow::Result<()> {
    Ok(stream::send(stream, &message.to_bytes(), MESSAGE_MAX).await?)
}

async fn receive(stream: &mut TcpStream) -> anyhow::Result<Message> {
    let bytes = stream::receive(stream, MESSAGE_MAX).await?;
    Message::from_bytes(&bytes).context("the answer of the other side is not a message of joining")
}

#[cfg(test)]
mod tests;
