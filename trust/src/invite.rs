//! Invitations: the line by which a robot joins a team, and the messages between the two machines.
//!
//! The line has the hash of the team's key, a secret for one robot, the end of its validity, and the addresses of the inviter. So
//! the joiner can recognise the right team before it reveals anything. Only then does it send the secret, sealed.

mod handshake;
mod message;

pub use handshake::{INVITES_MAX, Inviter, InviterEffect, JoinError, Joiner, OpenInvite};
pub use message::{Hello, MESSAGE_MAX, Message, Offer, Proof, Welcome};

use crate::identity::KeyId;
use crate::name::UnixTime;
use crate::text::{self, TextError};
use core::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::fmt;
use zeroize::Zeroizing;

/// The most addresses of an invitation.
pub const ADDRESSES_MAX: usize = 4;
/// The longest line, in bytes.
pub const LINE_MAX: usize = 400;
/// Bytes of the secret.
pub const INVITE_SECRET: usize = 16;

const PREFIX: &str = "dca1-";

/// An invitation, which can be used once. `Debug` does not show its secret.
pub struct Invite {
    /// The team's id, by which the joiner recognises the team.
    pub team: KeyId,
    /// The secret. The joiner proves that it knows it.
    pub secret: Zeroizing<[u8; INVITE_SECRET]>,
    /// The time at which the invitation ends.
    pub expires: UnixTime,
    /// The addresses at which the inviter may answer, at most [`ADDRESSES_MAX`].
    pub addresses: Vec<SocketAddr>,
    /// Whether the robot is the first of its team. The team's database then begins with this robot.
    pub founds: bool,
}

/// Precedes the addresses if the robot is the first of its team. No address begins with this byte.
const FOUNDS: u8 = 0;

impl Invite {
    /// Returns the line: `dca1-TEAM-SECRET-REST-CHECKSUM`. The line is secret.
    pub fn to_line(&self) -> Zeroizing<String> {
        let mut rest = self.expires.0.to_be_bytes().to_vec();
        if self.founds {
            rest.push(FOUNDS);
        }
        for address in self.addresses.iter().take(ADDRESSES_MAX) {
            match address.ip() {
                IpAddr::V4(ip) => rest.extend([&[4][..], &ip.octets()].concat()),
                IpAddr::V6(ip) => rest.extend([&[6][..], &ip.octets()].concat()),
            }
            rest.extend(address.port().to_be_bytes());
        }
        let sum = text::checksum(PREFIX, &Zeroizing::new([&self.team.0[..], &*self.secret, &rest].concat()));
        let parts = [&self.team.0[..], &*self.secret, &rest, &sum].map(|part| Zeroizing::new(text::encode(part)));
        Zeroizing::new(format!("{PREFIX}{}-{}-{}-{}", *parts[0], *parts[1], *parts[2], *parts[3]))
    }

    /// Reads a line; surrounding blanks are ignored.
    ///
    /// # Errors
    /// If the text is not such a line, or has a typing error.
    pub fn from_line(line: &str) -> Result<Self, TextError> {
        let line = line.trim();
        let parts: Vec<&str> = line.strip_prefix(PREFIX).ok_or(TextError::Prefix(PREFIX))?.split('-').collect();
        let &[team, secret, rest, sum] = parts.as_slice() else { return Err(TextError::Length) };
        if line.len() > LINE_MAX {
            return Err(TextError::Length);
        }
        let (team, secret) = (text::decode(team)?, Zeroizing::new(text::decode(secret)?));
        let (rest, sum) = (text::decode(rest)?, text::decode(sum)?);
        if sum != text::checksum(PREFIX, &Zeroizing::new([&team[..], &secret, &rest].concat())) {
            return Err(TextError::Checksum);
        }
        let team = <[u8; 32]>::try_from(team).map_err(|_length| TextError::Length)?;
        let secret = <[u8; INVITE_SECRET]>::try_from(&secret[..]).map_err(|_length| TextError::Length)?;
        let (expires, rest) = rest.split_first_chunk::<8>().ok_or(TextError::Length)?;
        let (mut rest, founds) = rest.strip_prefix(&[FOUNDS]).map_or((rest, false), |rest| (rest, true));
        let mut addresses = Vec::new();
        while !rest.is_empty() && addresses.len() < ADDRESSES_MAX {
            let (address, after) = address(rest).ok_or(TextError::Length)?;
            addresses.push(address);
            rest = after;
        }
        if !rest.is_empty() {
            return Err(TextError::Length);
        }
        let expires = UnixTime(u64::from_be_bytes(*expires));
        Ok(Self { team: KeyId(team), secret: Zeroizing::new(secret), expires, addresses, founds })
    }

    /// Returns the hash under which the inviter stores the invitation, so that the secret is not on the inviter's disk.
    pub fn hash(&self) -> [u8; 32] {
        hash(&self.secret)
    }
}

impl fmt::Debug for Invite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Invite(to {}, until {})", self.team, self.expires.0)
    }
}

pub(crate) fn hash(secret: &[u8; INVITE_SECRET]) -> [u8; 32] {
    blake3::derive_key("dca invite 1", secret)
}

fn address(bytes: &[u8]) -> Option<(SocketAddr, &[u8])> {
    let (kind, rest) = bytes.split_first()?;
    let (ip, rest) = match kind {
        4 => rest.split_first_chunk::<4>().map(|(ip, rest)| (IpAddr::from(Ipv4Addr::from(*ip)), rest))?,
        6 => rest.split_first_chunk::<16>().map(|(ip, rest)| (IpAddr::from(Ipv6Addr::from(*ip)), rest))?,
        _ => return None,
    };
    let (port, rest) = rest.split_first_chunk::<2>()?;
    Some((SocketAddr::new(ip, u16::from_be_bytes(*port)), rest))
}
