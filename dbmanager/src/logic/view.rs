//! Views of the database for people and programs: pure functions of a replica's state and log.
//!
//! | module | answers |
//! |---|---|
//! | [`value`] | what does a key hold, as a typed value and as text? |
//! | [`schema`] | what is it meant to hold? |
//! | [`past`] | who has changed it, when and why? |
//! | [`as_of`] | what did it hold at another time, and what has changed since? |
//! | [`conflict`] | what has nobody settled? |
//! | [`watch`] | what is happening to it? |
//! | [`status`] | how far are others behind? |
//! | [`transfer`] | how is it written to a file, and read from one? |
//! | [`draft`] | what is to be changed, and only if what? |
//! | [`token`], [`date`] | how are version vectors and dates written down? |
//! | [`table`] | how does all of it look on a terminal? |

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
