//! What nodes of one network tell each other before there is a link: where they can be dialled.

use super::codec::{Enveloped, Kind};
use serde::{Deserialize, Serialize};

/// One datagram. Append only.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Word {
    /// A node can be dialled at the address that this came from.
    Here {
        /// Its session.
        session: String,
        /// Its name.
        name: String,
        /// Its TCP port.
        port: u16,
    },
    /// Somebody looks for nodes: each answers with [`Word::Here`].
    Ask,
}

impl Enveloped for Word {
    const KIND: Kind = Kind::Word;
    const VERSION: u16 = 1;
    const SIZE_MAX: usize = 512;
}
