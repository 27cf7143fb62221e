//! The datagram with which a node announces where it can be dialled.

use super::codec::{Enveloped, Kind};
use serde::{Deserialize, Serialize};

/// One datagram. Append only.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Announcement {
    /// A node can be dialled at the address that this came from.
    Here {
        /// Its session.
        session: String,
        /// Its name.
        name: String,
        /// Its TCP port.
        port: u16,
    },
    /// A client looks for nodes: each answers with [`Announcement::Here`].
    Ask,
}

impl Enveloped for Announcement {
    const KIND: Kind = Kind::Announcement;
    const SIZE_MAX: usize = 512;
}

#[cfg(test)]
mod tests {
    use super::super::codec::encode;
    use super::*;

    /// Bytes that nodes of other versions say and hear.
    #[test]
    fn golden_announcements() {
        let here = Announcement::Here { session: "a1".into(), name: "c1".into(), port: 7447 };
        assert_eq!(encode(&here).unwrap(), *b"DC\x01\x00\x05\x00\x00\x02a1\x02c1\x97\x3a");
        assert_eq!(encode(&Announcement::Ask).unwrap(), *b"DC\x01\x00\x05\x00\x01");
    }
}
