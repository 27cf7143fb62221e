//! A process as a member of a team: applies the decisions of `trust` to the disk, and to the network of `comms`.
//!
//! A node is a [`member::Member`]; its keys and its certificate are in its state folder. It vouches for each of its
//! programs, a [`program::ProgramIdentity`], and for visitors from its machine, a [`visitor::VisitorIdentity`].
//! Neither programs nor visitors have the node's key. All three are identities of tunnels
//! ([`comms::io::session::Identity`]). With [`join`] a robot becomes a member of a team.

pub mod audit;
mod cards;
pub mod folder;
pub mod join;
pub mod member;
pub mod program;
pub mod visitor;

use comms::io::{clock, entropy};
use trust::identity::Entropy;
use trust::name::UnixTime;

/// Returns the time of this machine's calendar clock.
pub fn now() -> UnixTime {
    UnixTime(clock::unix_time().as_secs())
}

/// Returns random bytes for one operation.
///
/// # Errors
/// If the system has none.
pub fn random() -> std::io::Result<Entropy> {
    entropy::bytes().map(|seed| Entropy::new(&seed))
}
