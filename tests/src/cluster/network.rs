//! Hosts on a separate network: namespaces, each with one end of a wire, the other ends on a bridge.
//!
//! The bridge has a namespace too, so nothing of the machine's own network is touched, and several tests can have the
//! same addresses at the same time.

use rustix::process::{getpid, getuid};
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use std::fs::File;
use std::io::Write;
use std::os::fd::AsFd;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::JoinHandle;

/// Hosts 1, 2, … on one bridge, as 10.77.0.1, 10.77.0.2, …. Dropped, they are removed.
#[derive(Debug)]
pub struct Network {
    name: String,
    hosts: usize,
}

impl Network {
    /// Makes a network; none, with a word of why on the terminal, where a test cannot have one.
    ///
    /// # Panics
    /// The kernel refuses a step.
    pub fn new(hosts: usize) -> Option<Self> {
        let network = Self::begin(hosts)?;
        let bridge = format!("{}b", network.name);
        ip(&format!("-n {bridge} link add br0 type bridge"));
        ip(&format!("-n {bridge} link set br0 up"));
        for number in network.hosts() {
            let host = network.namespace(number);
            ip(&format!("link add eth0 netns {host} type veth peer name port{number} netns {bridge}"));
            ip(&format!("-n {bridge} link set port{number} master br0 up"));
            network.connect(number);
        }
        Some(network)
    }

    /// Makes hosts without interfaces to others.
    pub(super) fn begin(hosts: usize) -> Option<Self> {
        if !getuid().is_root() {
            return skip("needs root, for network namespaces");
        }
        if Command::new("ip").arg("-V").output().is_err() {
            return skip("needs the program `ip` (iproute2), for network namespaces");
        }
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("dt{}x{}", getpid().as_raw_nonzero(), COUNT.fetch_add(1, Ordering::Relaxed));
        if let Err(why) = try_ip(&format!("netns add {name}b")) {
            return skip(&format!("needs network namespaces: {why}"));
        }
        // From here on a failure removes everything that was made.
        let network = Self { name, hosts };
        for number in network.hosts() {
            let host = network.namespace(number);
            ip(&format!("netns add {host}"));
            ip(&format!("-n {host} link set lo up"));
        }
        Some(network)
    }

    /// Gives a host its address on its interface, which is there.
    pub(super) fn connect(&self, number: usize) {
        let host = self.namespace(number);
        ip(&format!("-n {host} address add 10.77.0.{number}/24 dev eth0"));
        ip(&format!("-n {host} link set eth0 up"));
        // As on a machine with a gateway: multicast goes out of the one interface.
        ip(&format!("-n {host} route add default via 10.77.0.254"));
    }

    /// Moves an interface of this machine to a host.
    pub(super) fn take(&self, number: usize, interface: &str) {
        let host = self.namespace(number);
        ip(&format!("link set {interface} netns {host}"));
        ip(&format!("-n {host} link set {interface} name eth0"));
        self.connect(number);
    }

    /// Returns the namespace of host `number`.
    pub fn namespace(&self, number: usize) -> String {
        format!("{}h{number}", self.name)
    }

    /// Returns the numbers of its hosts.
    pub fn hosts(&self) -> impl Iterator<Item = usize> {
        1..=self.hosts
    }

    /// Takes host `number` off the network, as if its cable were pulled.
    pub fn cut(&self, number: usize) {
        ip(&format!("-n {}b link set port{number} down", self.name));
    }

    /// Puts host `number` back.
    pub fn heal(&self, number: usize) {
        ip(&format!("-n {}b link set port{number} up", self.name));
    }

    /// Keeps these hosts from reaching each other; each still reaches all others.
    pub fn keep_apart(&self, numbers: &[usize]) {
        for number in numbers {
            ip(&format!("-n {}b link set port{number} type bridge_slave isolated on", self.name));
        }
    }

    /// Lets a host reach those again that it was kept apart from.
    pub fn let_meet(&self, number: usize) {
        ip(&format!("-n {}b link set port{number} type bridge_slave isolated off", self.name));
    }

    /// Changes something of a host's own interfaces, as `ip` does.
    pub fn set(&self, number: usize, arguments: &str) {
        ip(&format!("-n {} {arguments}", self.namespace(number)));
    }

    /// Does something of the test's own on a host, in a thread that stays there; so do the threads that it starts.
    ///
    /// # Panics
    /// The thread, when the kernel does not let it go there.
    pub fn inside<T: Send + 'static>(&self, number: usize, work: impl FnOnce() -> T + Send + 'static) -> JoinHandle<T> {
        let place = format!("/run/netns/{}", self.namespace(number));
        std::thread::spawn(move || {
            let namespace = File::open(&place).expect("a namespace is a file there");
            move_into_link_name_space(namespace.as_fd(), Some(LinkNameSpaceType::Network))
                .unwrap_or_else(|error| panic!("{place}: {error}"));
            work()
        })
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        for number in 1..=self.hosts {
            drop(try_ip(&format!("netns del {}", self.namespace(number))));
        }
        drop(try_ip(&format!("netns del {}b", self.name)));
    }
}

/// Says on the terminal why a test cannot have a network. The test harness keeps what its macros print; this is for everyone to see.
pub(super) fn skip<T>(why: &str) -> Option<T> {
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    writeln!(std::io::stderr(), "{test}: skipped: {why}").unwrap_or_default();
    None
}

fn ip(arguments: &str) {
    if let Err(why) = try_ip(arguments) {
        panic!("ip {arguments}: {why}");
    }
}

fn try_ip(arguments: &str) -> Result<(), String> {
    let output = Command::new("ip").args(arguments.split(' ')).output().map_err(|error| error.to_string())?;
    if output.status.success() {
        return Ok(());
    }
    Err(String::from_utf8_lossy(&output.stderr).trim().to_owned())
}
