//! Why a call has no answer.

use crate::logic::human::span;
use std::time::Duration;
use thiserror::Error;

/// Why a call has no answer.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CallError {
    /// No program serves the key, or the server vanished or gave up before its first answer.
    #[error("no program answers at `{key}`")]
    Unreachable {
        /// The host and the verb.
        key: String,
    },
    /// No answer came in time. The request may have been carried out.
    #[error("no answer from `{key}` within {}", span(*.within))]
    Timeout {
        /// The host and the verb.
        key: String,
        /// The time given.
        within: Duration,
    },
    /// For this time, the server of a stream has sent no sign of life.
    #[error("`{key}` has sent nothing for {}", span(*.silent))]
    Silent {
        /// The host and the verb.
        key: String,
        /// How long.
        silent: Duration,
    },
    /// The stream has ended without its mark, or its answers do not match the mark.
    #[error("the answers from `{key}` broke off after {count}: {why}")]
    Broken {
        /// The host and the verb.
        key: String,
        /// How many answers came.
        count: u64,
        /// For a person.
        why: String,
    },
    /// In a team: other programs have answered, but not the called one.
    #[error("`{key}` has not answered, but {why}")]
    Forged {
        /// The host and the verb.
        key: String,
        /// The answering session, for a person.
        why: String,
    },
    /// The server's reason.
    #[error("{reason}")]
    Refused {
        /// For a person.
        reason: String,
    },
    /// The session is closed, or zenoh refuses.
    #[error("cannot call `{key}`: {cause}")]
    Session {
        /// The host and the verb.
        key: String,
        /// Zenoh's words.
        cause: String,
    },
}
