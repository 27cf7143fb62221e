//! The replica, without I/O.
//!
//! | module | holds | shows |
//! |---|---|---|
//! | [`key`], [`version_vector`], [`txn`] | the words: keys, dots and version vectors, transactions | |
//! | [`clock`] | the hybrid clock of one replica | timestamps extend causality; no date is refused |
//! | [`state`] | the versions of each key | T1 convergence, T2 one serial order, T3 whole transactions |
//! | [`log`] | each origin's transactions, gap-free and chained | T6 a dot names one transaction, T7 liveness |
//! | [`merge`] | how two states become one, when a replica comes back | nothing is lost, hidden or brought back |
//! | [`member`] | who belongs to the team | admission and the retire barrier |
//! | [`owner`] | who writes below a prefix | terms that fence; conditions there hold for the team |
//! | [`gc`] | what everybody has | T5 nothing comes back |
//! | [`record`] | what is on the disk | T4 durability: a batch goes before what promises it |
//! | [`message`], [`delta`], [`snapshot`] | what replicas say to each other | |
//! | [`replica`] | the machine that drives all of it, and its parts | |
//! | [`view`] | what people and programs see of it | |

pub mod clock;
pub mod delta;
pub mod gc;
pub mod key;
pub mod log;
pub mod member;
pub mod merge;
pub mod message;
pub mod notary;
pub mod owner;
pub mod record;
pub mod replica;
pub mod snapshot;
pub mod state;
mod timing;
pub mod txn;
pub mod version_vector;
pub mod view;
