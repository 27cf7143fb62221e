//! The present network interfaces of this machine.

use std::collections::BTreeSet;
use std::net::{IpAddr, SocketAddr, TcpListener};

/// One address of a network interface. Over it, others can be found and can find this machine.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Address {
    /// The interface's name.
    pub(crate) name: String,
    /// The number of the interface in the kernel.
    pub(crate) index: u32,
    /// The address.
    pub(crate) ip: IpAddr,
}

/// Returns every address of each interface that is up, has a carrier and takes part in multicast.
pub(crate) fn now() -> BTreeSet<Address> {
    let interfaces = pnet_datalink::interfaces().into_iter();
    let usable = interfaces.filter(|one| one.is_up() && one.is_running() && one.is_multicast() && !one.is_loopback());
    let addresses = usable.flat_map(|one| {
        let (name, index) = (one.name, one.index);
        one.ips.into_iter().map(move |network| Address { name: name.clone(), index, ip: network.ip() })
    });
    addresses.filter(|address| !address.ip.is_unspecified() && !address.ip.is_loopback()).collect()
}

/// Returns the addresses of this host that programs on any other host can dial. Left out are addresses that are valid
/// only on their own cable, and addresses that are too new to listen on.
pub fn dialled() -> Vec<IpAddr> {
    let usable = |ip: &IpAddr| !is_link_local(*ip) && TcpListener::bind((*ip, 0)).is_ok();
    now().into_iter().map(|address| address.ip).filter(usable).collect()
}

/// Returns the locator of an address and a port.
pub(crate) fn locator(ip: IpAddr, port: u16) -> String {
    format!("tcp/{}", SocketAddr::new(ip, port))
}

fn is_link_local(ip: IpAddr) -> bool {
    matches!(ip, IpAddr::V6(ip) if ip.segments()[0] & 0xffc0 == 0xfe80)
}
