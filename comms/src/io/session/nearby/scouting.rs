//! The messages by which nodes find each other: zenoh's `Scout` and `Hello`. So any zenoh program that scouts on the group of nodes
//! lists them.
//!
//! The metadata of each locator in a `Hello` contains the name of the node: `tcp/10.0.0.2:7447?dca=c2`. A node in a team leaves the
//! name empty. Other zenoh programs have no such metadata, and are not dialled.

use super::Announced;
use std::net::{IpAddr, SocketAddr};
use zenoh::config::WhatAmI;
use zenoh::internal::buffers::{HasReader, HasWriter};
use zenoh_codec::{RCodec, WCodec, Zenoh080};
use zenoh_protocol::core::Locator;
use zenoh_protocol::scouting::{HelloProto, Scout, ScoutingBody, ScoutingMessage};

/// The metadata key that marks a locator of a DCA node; its value is the node's name.
const NAME: &str = "dca";
/// How many locators a `Hello` has at most, so that it fits into a datagram.
const LOCATORS_MAX: usize = 8;

/// One message.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Message {
    /// The sender looks for nodes. Each node answers with a `Hello`.
    Scout,
    /// A node can be dialled at the address that this datagram came from.
    Hello(Announced),
}

/// Returns the datagram that asks for nodes.
pub(super) fn scout() -> Option<Vec<u8>> {
    let what = WhatAmI::Router | WhatAmI::Peer;
    encoded(&Scout { version: zenoh_protocol::VERSION, what, zid: None }.into())
}

/// Returns the datagram in which a node announces that it listens at these addresses.
pub(super) fn hello(own: &Announced, addresses: impl Iterator<Item = IpAddr>) -> Option<Vec<u8>> {
    let locator = |ip| Locator::new("tcp", SocketAddr::new(ip, own.port).to_string(), format!("{NAME}={}", own.name));
    let locators = addresses.take(LOCATORS_MAX).filter_map(|ip| locator(ip).ok()).collect();
    let (version, whatami) = (zenoh_protocol::VERSION, WhatAmI::Peer);
    encoded(&HelloProto { version, whatami, zid: own.session.parse().ok()?, locators }.into())
}

/// Returns the message in a datagram; none if it does not concern a node.
pub(super) fn read(datagram: &[u8]) -> Option<Message> {
    let message: ScoutingMessage = Zenoh080::new().read(&mut datagram.reader()).ok()?;
    match message.body {
        ScoutingBody::Scout(scout) => scout.what.matches(WhatAmI::Peer).then_some(Message::Scout),
        ScoutingBody::Hello(hello) => {
            let listens = |locator: &Locator| {
                let name = locator.metadata().get(NAME)?.to_owned();
                let at: SocketAddr = locator.address().as_str().parse().ok()?;
                (locator.protocol().as_str() == "tcp").then_some((name, at.port()))
            };
            let (name, port) = hello.locators.iter().find_map(listens)?;
            Some(Message::Hello(Announced { session: hello.zid.to_string(), name, port }))
        }
    }
}

fn encoded(message: &ScoutingMessage) -> Option<Vec<u8>> {
    let mut datagram = Vec::new();
    Zenoh080::new().write(&mut datagram.writer(), message).ok()?;
    Some(datagram)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn announced(name: &str) -> Announced {
        Announced { session: "a1b2".into(), name: name.into(), port: 7447 }
    }

    #[test]
    fn a_hello_says_who_listens_where() {
        let addresses = || ["10.77.0.2".parse().unwrap(), "fe80::7".parse().unwrap()].into_iter();
        for name in ["c1", "", "a_long-name"] {
            let datagram = hello(&announced(name), addresses()).unwrap();
            assert_eq!(read(&datagram), Some(Message::Hello(announced(name))));
        }
        let many = std::iter::repeat_n("fe80:1111:2222:3333:4444:5555:6666:7777".parse().unwrap(), 100);
        let longest = hello(&announced(&"n".repeat(63)), many).unwrap();
        assert!(longest.len() < super::super::SIZE_MAX, "{}", longest.len());
    }

    /// The bytes that zenoh programs send and accept. Source: zenoh-protocol 1.10.2, `scouting`.
    #[test]
    fn the_bytes_are_those_of_zenoh() {
        assert_eq!(scout().unwrap(), [0x01, 0x09, 0x03]);
        let datagram = hello(&announced("c1"), ["10.0.0.2".parse().unwrap()].into_iter()).unwrap();
        assert_eq!(datagram, b"\x22\x09\x11\xb2\xa1\x01\x18tcp/10.0.0.2:7447?dca=c1");
    }

    #[test]
    fn programs_of_others_are_answered_and_not_dialled() {
        let other = |locators: &[&str]| {
            let locators = locators.iter().map(|locator| locator.parse().unwrap()).collect();
            let (version, whatami) = (zenoh_protocol::VERSION, WhatAmI::Router);
            encoded(&HelloProto { version, whatami, zid: "7".parse().unwrap(), locators }.into()).unwrap()
        };
        for locators in [&[][..], &["tcp/10.0.0.2:7447"], &["udp/10.0.0.2:7447?dca=c1"], &["tcp/here:7447?dca=c1"]] {
            assert_eq!(read(&other(locators)), None, "{locators:?}");
        }
        let scout = |what| encoded(&Scout { version: 9, what, zid: None }.into()).unwrap();
        assert_eq!(read(&scout(WhatAmI::Peer.into())), Some(Message::Scout));
        assert_eq!(read(&scout(WhatAmI::Client.into())), None, "it looks for others");
    }

    proptest! {
        #[test]
        fn any_datagram_is_read_or_ignored(datagram: Vec<u8>) {
            drop(read(&datagram));
        }
    }
}
