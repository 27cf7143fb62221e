//! Finds the other nodes of this network by zenoh's scouting messages, and announces this node.
//!
//! Each node regularly sends a `Hello` on every interface, by multicast, and answers a `Scout` with a `Hello`. A session that
//! receives a `Hello` dials the address that the datagram came from. The interfaces are checked each second: the group is joined on
//! new ones, and left on those that have gone. Zenoh's own scouting reads the interfaces only once, and knows only IPv4.
//!
//! Nothing that arrives here is trusted: a datagram only proposes a place to dial.

mod scouting;

use super::interfaces::{self, Address};
use crate::logic::human::cause;
use scouting::Message;
use socket2::{Domain, Protocol, Socket, Type};
use std::collections::BTreeSet;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV6};
use std::time::Duration;
use tokio::net::UdpSocket;
use tokio::sync::watch;

/// The port of the multicast groups on which nodes find each other. It differs from zenoh's port, so that other programs stay
/// apart.
const PORT: u16 = 7999;
/// The group over IPv4.
const GROUP_V4: Ipv4Addr = Ipv4Addr::new(224, 0, 0, 231);
/// The multicast group over IPv6, on one cable.
const GROUP_V6: Ipv6Addr = Ipv6Addr::new(0xff02, 0, 0, 0, 0, 0, 0x0dca, 0x0231);
/// How often the interfaces are read.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// How often a node announces itself when nothing is new: once in so many seconds. Otherwise it does so each second.
const QUIET_EVERY: u32 = 3;
/// For how many seconds a change is treated as new.
const NEW_FOR: u32 = 10;
/// The longest datagram.
const SIZE_MAX: usize = 1024;

/// A node that has announced itself on the network.
pub(crate) struct NearbyNode {
    pub(crate) session: String,
    pub(crate) name: String,
    pub(crate) at: SocketAddr,
}

/// The facts that a node announces of itself. A command line announces nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Announced {
    pub(crate) session: String,
    pub(crate) name: String,
    pub(crate) port: u16,
}

/// The sockets of one family of addresses.
struct Family {
    group: SocketAddr,
    /// Receives datagrams to the group.
    receiver: UdpSocket,
    /// Sends, and receives datagrams to this node alone.
    sender: UdpSocket,
}

/// Looks for nodes and announces this one, for ever.
pub(crate) async fn look(own: Option<Announced>, addresses: watch::Sender<Vec<String>>, heard: impl Fn(NearbyNode)) {
    let families: Vec<Family> = [Family::open(GROUP_V4.into()), Family::open(GROUP_V6.into())]
        .into_iter()
        .filter_map(|family| {
            family.inspect_err(|error| tracing::debug!(%error, "a family of addresses is not used")).ok()
        })
        .collect();
    let (mut known, mut turn, mut new) = (BTreeSet::new(), 0, NEW_FOR);
    let mut look = tokio::time::interval(LOOK_EVERY);
    loop {
        let (v4, v6) = (families.first(), families.get(1));
        let received = tokio::select! {
            _ = look.tick() => {
                let found = interfaces::now();
                if found != known {
                    log_change(&known, &found, own.is_some());
                    families.iter().for_each(|family| family.follow(&known, &found));
                    addresses.send_replace(found.iter().map(|address| address.ip.to_string()).collect());
                    (known, new) = (found, NEW_FOR);
                }
                (turn, new) = ((turn + 1) % QUIET_EVERY, new.saturating_sub(1));
                if new > 0 || turn == 0 {
                    for family in &families {
                        family.announce(&known, own.as_ref()).await;
                    }
                }
                continue;
            }
            received = receive(v4) => received,
            received = receive(v6) => received,
        };
        match received {
            Some((Message::Hello(Announced { session, name, port }), from)) => {
                let mut at = from;
                at.set_port(port);
                heard(NearbyNode { session, name, at });
            }
            Some((Message::Scout, from)) => {
                let family = families.iter().find(|family| family.group.is_ipv4() == from.is_ipv4());
                let answered = family.zip(own.as_ref()).and_then(|(family, own)| {
                    let hello = scouting::hello(own, family.places(&known, None))?;
                    Some(family.sender.try_send_to(&hello, from))
                });
                if let Some(Err(error)) = answered {
                    tracing::debug!(%error, "a question for nodes nearby is not answered");
                }
            }
            None => {}
        }
    }
}

/// Logs the addresses on which the node listens now, and the addresses that have gone.
fn log_change(before: &BTreeSet<Address>, now: &BTreeSet<Address>, is_node: bool) {
    for (addresses, what) in [(now - before, "listening on"), (before - now, "no longer listening on")] {
        for Address { name, ip, .. } in addresses.iter().filter(|_| is_node) {
            tracing::info!("{what} {ip} ({name})");
        }
    }
}

/// Returns the interfaces on which nodes of other machines can be found, and the reason if discovery is impossible
/// there.
pub async fn discovery() -> (Vec<String>, Result<(), String>) {
    let found = interfaces::now();
    let names: BTreeSet<String> = found.iter().map(|address| address.name.clone()).collect();
    let open = |group| Family::open(group).and_then(|family| family.try_join(&found));
    // One family of addresses is enough.
    let opened = open(GROUP_V4.into()).or_else(|error| open(GROUP_V6.into()).map_err(|_none_either| error));
    (names.into_iter().collect(), opened.map_err(|error| cause(&error)))
}

/// Waits for a message. If the kernel has no such family of addresses, it waits for ever.
async fn receive(family: Option<&Family>) -> Option<(Message, SocketAddr)> {
    let Some(family) = family else { return std::future::pending().await };
    let (mut to_group, mut to_self) = ([0; SIZE_MAX], [0; SIZE_MAX]);
    let (received, bytes) = tokio::select! {
        received = family.receiver.recv_from(&mut to_group) => (received, &to_group[..]),
        received = family.sender.recv_from(&mut to_self) => (received, &to_self[..]),
    };
    match received {
        Ok((size, from)) => Some((scouting::read(bytes.get(..size)?)?, from)),
        Err(error) => {
            // The interface of the socket has gone. The socket works again once there is an interface.
            tracing::debug!(%error, "a multicast socket cannot be read");
            tokio::time::sleep(LOOK_EVERY).await;
            None
        }
    }
}

impl Family {
    fn open(group: IpAddr) -> io::Result<Self> {
        let (domain, any): (Domain, IpAddr) = match group {
            IpAddr::V4(_) => (Domain::IPV4, Ipv4Addr::UNSPECIFIED.into()),
            IpAddr::V6(_) => (Domain::IPV6, Ipv6Addr::UNSPECIFIED.into()),
        };
        let open = |at: SocketAddr| {
            let socket = Socket::new(domain, Type::DGRAM, Some(Protocol::UDP))?;
            socket.set_reuse_address(true)?;
            if at.is_ipv6() {
                socket.set_only_v6(true)?;
            }
            socket.bind(&at.into())?;
            socket.set_nonblocking(true)?;
            UdpSocket::from_std(socket.into())
        };
        // Binds to the group itself where the kernel allows that, so that no other datagrams arrive.
        let at = if group.is_ipv4() { group } else { any };
        Ok(Self {
            group: SocketAddr::new(group, PORT),
            receiver: open(SocketAddr::new(at, PORT))?,
            sender: open(SocketAddr::new(any, 0))?,
        })
    }

    fn is_of(&self, address: &Address) -> bool {
        address.ip.is_ipv4() == self.group.is_ipv4()
    }

    /// Joins the group on new interfaces, and leaves it on interfaces that have gone.
    fn follow(&self, before: &BTreeSet<Address>, now: &BTreeSet<Address>) {
        let receiver = socket2::SockRef::from(&self.receiver);
        for address in (before - now).iter().filter(|address| self.is_of(address)) {
            let left = match address.ip {
                IpAddr::V4(ip) => receiver.leave_multicast_v4(&GROUP_V4, &ip),
                IpAddr::V6(_) => receiver.leave_multicast_v6(&GROUP_V6, address.index),
            };
            left.unwrap_or_else(|error| tracing::debug!(%error, ip = %address.ip, "a multicast group cannot be left"));
        }
        // Joins on all present interfaces: leaving affects a whole interface, which may still have another address.
        for address in now.iter().filter(|address| self.is_of(address)) {
            self.join(address)
                .unwrap_or_else(|error| tracing::debug!(%error, ip = %address.ip, "a multicast group cannot be joined, or was joined before"));
        }
    }

    /// Joins the group on all interfaces.
    fn try_join(&self, addresses: &BTreeSet<Address>) -> io::Result<()> {
        addresses.iter().filter(|address| self.is_of(address)).try_for_each(|address| self.join(address))
    }

    fn join(&self, address: &Address) -> io::Result<()> {
        let receiver = socket2::SockRef::from(&self.receiver);
        match address.ip {
            IpAddr::V4(ip) => receiver.join_multicast_v4(&GROUP_V4, &ip),
            IpAddr::V6(_) => receiver.join_multicast_v6(&GROUP_V6, address.index),
        }
    }

    /// Returns the addresses at which a node can be dialled; the addresses of interface `first` come first.
    fn places(&self, addresses: &BTreeSet<Address>, first: Option<u32>) -> impl Iterator<Item = IpAddr> {
        let mut own: Vec<&Address> = addresses.iter().filter(|address| self.is_of(address)).collect();
        own.sort_by_key(|address| first != Some(address.index));
        own.into_iter().map(|address| address.ip)
    }

    /// Sends a `Hello` to the group on every interface, from each of its addresses. A session that is not a node sends a `Scout`.
    async fn announce(&self, addresses: &BTreeSet<Address>, own: Option<&Announced>) {
        let mut sent_on = BTreeSet::new();
        for address in addresses.iter().filter(|address| self.is_of(address)) {
            let hello = |own| scouting::hello(own, self.places(addresses, Some(address.index)));
            let Some(datagram) = own.map_or_else(scouting::scout, hello) else { continue };
            let sender = socket2::SockRef::from(&self.sender);
            let (chosen, to) = match address.ip {
                IpAddr::V4(ip) => (sender.set_multicast_if_v4(&ip), self.group),
                // For IPv6 the kernel chooses the address that belongs to the cable, so one message per interface is enough.
                IpAddr::V6(_) if !sent_on.insert(address.index) => continue,
                IpAddr::V6(_) => {
                    let to = SocketAddrV6::new(GROUP_V6, PORT, 0, address.index);
                    (sender.set_multicast_if_v6(address.index), to.into())
                }
            };
            let sent = match chosen {
                Ok(()) => self.sender.send_to(&datagram, to).await.map(drop),
                Err(error) => Err(error),
            };
            if let Err(error) = sent {
                tracing::debug!(%error, ip = %address.ip, "nothing can be sent on an interface");
            }
        }
    }
}

/// Returns the address at which a node listens with TCP. It means every address that this machine
/// has or will have, IPv4 and IPv6 if the kernel has both.
pub(crate) fn everywhere() -> IpAddr {
    let both = std::net::TcpListener::bind(SocketAddr::new(Ipv6Addr::UNSPECIFIED.into(), 0));
    if both.is_ok() { Ipv6Addr::UNSPECIFIED.into() } else { Ipv4Addr::UNSPECIFIED.into() }
}
