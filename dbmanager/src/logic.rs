//! The replica, without I/O.
//!
//! | module | holds | shows |
//! |---|---|---|
//! | [`key`], [`version_vector`], [`txn`] | the terms: keys, dots and version vectors, transactions | |
//! | [`clock`] | the hybrid clock of one replica | timestamps extend causality; no date is refused |
//! | [`state`] | the versions of each key | T1 convergence, T2 one serial order, T3 whole transactions |
//! | [`log`] | each origin's transactions, gap-free and chained | T6 a dot names one transaction, T7 liveness |
//! | [`merge`] | the merge of two states when a replica returns | nothing is lost, hidden or brought back |
//! | [`member`] | the members of the team | admission and the retire barrier |
//! | [`owner`] | the owners of prefixes | terms that fence; conditions there hold for the team |
//! | [`gc`] | removal of data that every member has | T5 nothing comes back |
//! | [`record`] | the records on the disk | T4 durability: a batch goes before messages that promise it |
//! | [`message`], [`delta`], [`snapshot`] | the messages between replicas | |
//! | [`replica`] | the state machine that drives all of these, and its parts | |
//! | [`view`] | the view of the database for people and programs | |

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
