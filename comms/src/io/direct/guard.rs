//! The proofs that the two ends of a direct path exchange in a team: each shows that it is an end of this wire.
//!
//! Each direction of a wire has a secret that only its two ends know. An end proves that it has the secret by a keyed
//! hash (BLAKE3). The hash covers the handshake, with random bytes of both ends, and the process id of the end itself.
//! The other end gets that id from the kernel, which knows the process at the other end of the socket. So a recorded
//! proof is worthless, and so is a proof that a third program relays. After the handshake no other program can read or
//! write the socket, so values are sent unsealed.

use super::packet::{Waits, receive, send_waiting};
use crate::io::entropy;
use crate::logic::codec::{self, Enveloped};
use crate::logic::direct::{Challenge, Claim, Confirmation, Nonce};
use rustix::io::Errno;
use rustix::net::sockopt::socket_peercred;
use rustix::process::{Pid, getpid};
use std::fmt;
use std::io;
use std::os::fd::{BorrowedFd, OwnedFd};
use zeroize::Zeroizing;

/// The secrets of one wire.
pub struct WireSecrets {
    /// The secret that this end proves it has.
    pub shown: Zeroizing<[u8; 32]>,
    /// The secret that the other end has to prove it has.
    pub expected: Zeroizing<[u8; 32]>,
}

/// Returns the secrets of the wire with a key.
type SecretsOf = Box<dyn Fn(&str) -> Option<WireSecrets> + Send + Sync>;

/// The secrets of the wires of a program in a team.
pub struct Guard {
    secrets: SecretsOf,
    refused: Box<dyn Fn(String) + Send + Sync>,
}

/// The messages that both ends have sent before a proof.
#[derive(Debug)]
pub(super) struct Transcript<'a> {
    /// The consumer's hello, as it was sent.
    pub(super) hello: &'a [u8],
    pub(super) challenge: Nonce,
    /// The consumer's random bytes.
    pub(super) answer: Nonce,
}

/// The end that proves something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    Consumer,
    /// Includes the producer's welcome.
    Producer(u128),
}

impl fmt::Debug for WireSecrets {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WireSecrets").finish_non_exhaustive()
    }
}

impl fmt::Debug for Guard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Guard").finish_non_exhaustive()
    }
}

impl Guard {
    /// Takes `secrets`, which returns the secrets of the wire with a key, or none while the other end is unknown.
    /// `refused` gets a message for people about each refused program; it must only note the message.
    pub fn new(
        secrets: impl Fn(&str) -> Option<WireSecrets> + Send + Sync + 'static,
        refused: impl Fn(String) + Send + Sync + 'static,
    ) -> Self {
        Self { secrets: Box::new(secrets), refused: Box::new(refused) }
    }

    pub(super) fn secrets(&self, key: &str) -> Option<WireSecrets> {
        (self.secrets)(key)
    }

    pub(super) fn refused(&self, who: String) {
        (self.refused)(who);
    }

    /// Proves to a producer that this is the consumer of its wire, and checks its proof; returns the producer's process.
    pub(super) fn show(&self, stream: &OwnedFd, key: &str, hello: &[u8], bell: BorrowedFd<'_>) -> io::Result<u128> {
        let refused = |why: &str| io::Error::new(io::ErrorKind::PermissionDenied, why);
        send_waiting(stream, &[hello], None, Waits::UntilTimeout)?;
        let Challenge { nonce: challenge } = hear(stream)?;
        let secrets = self.secrets(key).ok_or_else(|| refused("no program is known at the other end of this wire"))?;
        let transcript = Transcript { hello, challenge, answer: entropy::bytes()? };
        let tag = transcript.tag(&secrets.shown, End::Consumer, getpid()).into();
        let claim = codec::encode(&Claim { nonce: transcript.answer, tag }).map_err(io::Error::other)?;
        send_waiting(stream, &[&claim], Some(bell), Waits::UntilTimeout)?;
        let Confirmation { process, tag } = hear(stream)?;
        let pid = socket_peercred(stream)?.pid;
        if transcript.tag(&secrets.expected, End::Producer(process), pid) == tag {
            Ok(process)
        } else {
            Err(refused("the program that listens there does not have the secret of this wire"))
        }
    }
}

impl Transcript<'_> {
    /// Returns the proof that an end in this process has a secret. Comparing two such hashes takes constant time.
    pub(super) fn tag(&self, secret: &[u8; 32], end: End, process: Pid) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new_keyed(secret);
        let (role, says) = match end {
            End::Consumer => (0_u8, 0),
            End::Producer(says) => (1, says),
        };
        // All fields but the last have a fixed length.
        hasher.update(&[role]).update(&process.as_raw_nonzero().get().to_le_bytes()).update(&says.to_le_bytes());
        hasher.update(&self.challenge).update(&self.answer).update(self.hello).finalize()
    }
}

/// Returns the next message of the other end. The timeout of the socket limits the wait.
pub(super) fn hear<T: Enveloped>(stream: &OwnedFd) -> io::Result<T> {
    let mut packet = vec![0; T::SIZE_MAX];
    let (size, _) = receive(stream, &mut packet, Waits::UntilTimeout)?;
    let packet = packet.get(..size).filter(|packet| !packet.is_empty()).ok_or(Errno::CONNREFUSED)?;
    codec::decode(packet).map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tag_is_for_one_end_one_process_and_what_was_said() {
        let transcript = Transcript { hello: b"hello", challenge: [1; 32], answer: [2; 32] };
        let (own, other) = (getpid(), Pid::INIT);
        let tag = transcript.tag(&[3; 32], End::Consumer, own);
        let changed = [
            transcript.tag(&[4; 32], End::Consumer, own),
            transcript.tag(&[3; 32], End::Consumer, other),
            transcript.tag(&[3; 32], End::Producer(0), own),
            Transcript { hello: b"hell", ..transcript }.tag(&[3; 32], End::Consumer, own),
            Transcript { hello: b"hello", challenge: [0; 32], answer: [2; 32] }.tag(&[3; 32], End::Consumer, own),
            Transcript { hello: b"hello", challenge: [1; 32], answer: [0; 32] }.tag(&[3; 32], End::Consumer, own),
        ];
        assert!(own != other && changed.iter().all(|changed| *changed != tag));
        let transcript = Transcript { hello: b"hello", challenge: [1; 32], answer: [2; 32] };
        assert_eq!(transcript.tag(&[3; 32], End::Consumer, own), tag);
        let [one, two] = [1, 2].map(|process| transcript.tag(&[3; 32], End::Producer(process), own));
        assert_ne!(one, two);
    }
}
