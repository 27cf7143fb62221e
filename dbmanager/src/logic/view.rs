//! Views of the database for people and programs: pure functions of a replica's state and log.
//!
//! | module | answers |
//! |---|---|
//! | [`value`] | what does a key hold, as a typed value and as text? |
//! | [`schema`] | what values may a key hold? |
//! | [`past`] | which transactions have changed a key, by whom, when and why? |
//! | [`as_of`] | which value had a key at another time, and which keys have changed since? |
//! | [`conflict`] | which conflicts and races are not resolved? |
//! | [`watch`] | which changes happen now? |
//! | [`status`] | how far are others behind? |
//! | [`transfer`] | how is the database written to a file, and read from one? |
//! | [`draft`] | which changes are requested, and under which conditions? |
//! | [`token`], [`date`] | how are version vectors and dates written as text? |
//! | [`table`] | how do these results look on a terminal? |

pub mod as_of;
pub mod conflict;
pub mod date;
pub mod draft;
pub mod past;
pub mod schema;
pub mod status;
pub mod table;
pub mod token;
pub mod transfer;
pub mod value;
pub mod watch;

#[cfg(test)]
mod tests;
