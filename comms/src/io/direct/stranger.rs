//! Connections to a program whose other end has not been identified yet.

use super::guard::{End, Guard, Transcript};
use super::outlet::Connection;
use super::packet::{Waits, receive, send_waiting};
use super::server::Shared;
use crate::io::entropy;
use crate::logic::codec::{self, Enveloped};
use crate::logic::direct::{Challenge, Claim, Confirmation, Hello, Nonce, Welcome};
use crate::logic::time::Time;
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::net::sockopt::{set_socket_send_buffer_size, socket_peercred};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;

/// The requested size of the send buffer. The system reduces it to its own limit, 208 KiB by default.
const SEND_BUFFER: usize = 1 << 20;

/// A new connection.
#[derive(Debug)]
pub(super) struct Stranger {
    pub(super) stream: OwnedFd,
    /// The time until which the stranger has to prove its identity.
    pub(super) until: Time,
    said: Said,
}

#[derive(Debug)]
enum Said {
    Nothing,
    /// In a team.
    Hello(Asked),
    /// Its proof does not fit, or the other end of this wire is unknown. The node may not have told this program about
    /// that end yet.
    Claim(Asked, Claim, OwnedFd),
}

/// A requested wire, and the challenge to its client.
#[derive(Debug)]
struct Asked {
    hello: Hello,
    bytes: Vec<u8>,
    challenge: Nonce,
}

/// The events since the stranger was last processed.
#[derive(Clone, Copy, Debug)]
pub(super) struct News {
    /// It has sent something, or is gone.
    pub(super) is_ready: bool,
    /// The node has named the programs at the other ends of wires.
    pub(super) has_keys: bool,
    pub(super) now: Time,
}

/// The fate of a stranger.
pub(super) enum Fate {
    Waits(Stranger),
    Accepted(Consumer),
}

/// A stranger that has proved to be the consumer of a wire, and that still waits for the answer.
#[derive(Debug)]
pub(super) struct Consumer {
    pub(super) key: String,
    connection: Connection,
    welcome: Vec<u8>,
}

impl Stranger {
    /// Returns a stranger that has sent nothing yet.
    pub(super) const fn new(stream: OwnedFd, until: Time) -> Self {
        Self { stream, until, said: Said::Nothing }
    }

    /// Processes its messages. In a team, `shared` gets the strangers whose proof does not fit.
    pub(super) fn turn(self, news: News, shared: &Shared) -> Option<Fate> {
        let who = socket_peercred(&self.stream);
        let fate = self.judge(news, shared);
        fate.inspect_err(|error| {
            tracing::debug!(%error, "refusing a consumer of this host");
            if let (Some(guard), io::ErrorKind::PermissionDenied, Ok(who)) = (&shared.guard, error.kind(), who) {
                let (process, user) = (who.pid.as_raw_nonzero(), who.uid.as_raw());
                guard.refused(format!("process {process} of user {user} on this machine"));
            }
        })
        .ok()
    }

    fn judge(mut self, News { is_ready, has_keys, now }: News, shared: &Shared) -> io::Result<Fate> {
        let is_late = self.until <= now;
        match (std::mem::replace(&mut self.said, Said::Nothing), &shared.guard) {
            (Said::Nothing, _) if is_ready => self.hello(shared),
            (Said::Hello(asked), Some(guard)) if is_ready => self.claim(asked, shared, guard),
            (Said::Claim(asked, claim, bell), Some(guard)) if has_keys || is_ready || is_late => {
                self.check(asked, claim, bell, shared, guard).and_then(|fate| match fate {
                    Fate::Waits(Self { said: Said::Claim(asked, ..), .. }) if is_ready || is_late => {
                        Err(asked.unproved(guard))
                    }
                    fate @ (Fate::Waits(_) | Fate::Accepted(_)) => Ok(fate),
                })
            }
            (said, _) if !is_late => Ok(Fate::Waits(Self { said, ..self })),
            _ => Err(io::ErrorKind::TimedOut.into()),
        }
    }

    fn hello(self, shared: &Shared) -> io::Result<Fate> {
        if socket_peercred(&self.stream)?.uid != rustix::process::getuid() {
            return Err(io::Error::other("it runs as another user"));
        }
        let (bytes, bell) = next::<Hello>(&self.stream)?;
        let hello: Hello = codec::decode(&bytes).map_err(io::Error::other)?;
        if hello.token != shared.place.token {
            return Err(refused("the node has not wired it with this program"));
        }
        if shared.guard.is_some() {
            let challenge = entropy::bytes()?;
            say(&self.stream, &encoded(&Challenge { nonce: challenge })?)?;
            return Ok(Fate::Waits(Self { said: Said::Hello(Asked { hello, bytes, challenge }), ..self }));
        }
        self.accept(hello, bell, &Welcome { process: shared.process })
    }

    fn claim(self, asked: Asked, shared: &Shared, guard: &Guard) -> io::Result<Fate> {
        let (bytes, bell) = next::<Claim>(&self.stream)?;
        let claim = codec::decode(&bytes).map_err(io::Error::other)?;
        let bell = bell.ok_or_else(without_bell)?;
        self.check(asked, claim, bell, shared, guard)
    }

    /// Accepts the stranger if its proof fits.
    fn check(self, asked: Asked, claim: Claim, bell: OwnedFd, shared: &Shared, guard: &Guard) -> io::Result<Fate> {
        let transcript = Transcript { hello: &asked.bytes, challenge: asked.challenge, answer: claim.nonce };
        let other = socket_peercred(&self.stream)?.pid;
        let secrets = guard.secrets(&asked.hello.key);
        let fitting = secrets.filter(|secrets| transcript.tag(&secrets.expected, End::Consumer, other) == claim.tag);
        let Some(secrets) = fitting else {
            return Ok(Fate::Waits(Self { said: Said::Claim(asked, claim, bell), ..self }));
        };
        let (end, own) = (End::Producer(shared.process), rustix::process::getpid());
        let tag = transcript.tag(&secrets.shown, end, own).into();
        self.accept(asked.hello, Some(bell), &Confirmation { process: shared.process, tag })
    }

    fn accept(self, hello: Hello, bell: Option<OwnedFd>, welcome: &impl Enveloped) -> io::Result<Fate> {
        let bell = bell.ok_or_else(without_bell)?;
        fcntl_setfl(&bell, fcntl_getfl(&bell)? | OFlags::NONBLOCK)?;
        set_socket_send_buffer_size(&self.stream, SEND_BUFFER)?;
        let connection = Connection::new(Arc::new(self.stream), bell, hello.form);
        Ok(Fate::Accepted(Consumer { key: hello.key, connection, welcome: encoded(welcome)? }))
    }
}

impl Consumer {
    /// Sends the answer, and returns the connection. The caller must allow no value over the wire until it has taken
    /// the connection, because the consumer expects each value after the answer.
    ///
    /// # Errors
    /// The consumer is gone.
    pub(super) fn welcome(self) -> io::Result<Connection> {
        say(&self.connection.stream, &self.welcome)?;
        Ok(self.connection)
    }
}

impl Asked {
    /// Returns the reason why this stranger is finally dropped.
    fn unproved(&self, guard: &Guard) -> io::Error {
        match guard.secrets(&self.hello.key) {
            Some(_) => refused("it does not have the secret of this wire"),
            None => io::Error::other("no program is known at the other end of this wire"),
        }
    }
}

fn next<T: Enveloped>(stream: impl AsFd) -> io::Result<(Vec<u8>, Option<OwnedFd>)> {
    let mut packet = vec![0; T::SIZE_MAX];
    let (size, file) = receive(stream, &mut packet, Waits::Never)?;
    packet.truncate(size);
    Ok((packet, file))
}

fn encoded(message: &impl Enveloped) -> io::Result<Vec<u8>> {
    codec::encode(message).map_err(io::Error::other)
}

fn say(stream: impl AsFd, packet: &[u8]) -> io::Result<()> {
    Ok(send_waiting(stream, &[packet], None, Waits::Never)?)
}

fn refused(why: &str) -> io::Error {
    io::Error::new(io::ErrorKind::PermissionDenied, why)
}

fn without_bell() -> io::Error {
    io::Error::other("it has no bell")
}
