//! The replica, without I/O.
//!
//! | module | holds | shows |
//! |---|---|---|
//! | [`key`], [`cut`], [`txn`] | the words: keys, dots and cuts, transactions | |
//! | [`clock`] | the hybrid clock of one replica | order of stamps extends causality; no date is refused |
//! | [`state`] | the versions of each key | T1 convergence, T2 one serial order, T3 whole transactions, after their causes |

pub mod clock;
pub mod cut;
pub mod key;
pub mod mutant;
pub mod state;
pub mod txn;
