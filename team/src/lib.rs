//! A process as a member of a team: the decisions of `trust`, on the disk and on the network of `comms`.
//!
//! A node is a [`member::Member`]: its keys and its certificate are in the folder of its state. It vouches for each of
//! its programs, a [`program::ProgramIdentity`], and for visitors from its machine, a [`visitor::VisitorIdentity`];
//! none of them has the node's key. All are identities of tunnels ([`comms::io::session::Identity`]). With [`join`] a
//! robot becomes a member of a team.

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

/// Returns the time of the calendar, as this machine's clock shows it.
pub fn now() -> UnixTime {
    UnixTime(clock::unix_time().as_secs())
}

/// Returns random bytes for one operation.
///
/// # Errors
/// The system has none.
pub fn random() -> std::io::Result<Entropy> {
    entropy::bytes().map(|seed| Entropy::new(&seed))
}
