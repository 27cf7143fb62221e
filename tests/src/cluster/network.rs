//! Hosts on a separate network. Each host is a namespace with one end of a wire, and the other ends are on a bridge.
//!
//! The bridge also has a namespace, so the machine's own network stays unchanged. Several tests can use the same addresses at the
//! same time.

use rustix::process::{getpid, getuid};
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use std::fs::File;
use std::io::Write;
use std::os::fd::AsFd;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::JoinHandle;

/// Hosts 1, 2, … on one bridge, as 10.77.0.1, 10.77.0.2, …. Dropping the network removes them.
#[derive(Debug)]
pub struct Network {
    name: String,
    hosts: usize,
}

impl Network {
    /// Makes a network. If a test cannot have one, it prints the reason on the terminal and returns none.
    ///
    /// # Panics
    /// Panics if the kernel refuses a step.
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

    /// Makes hosts without interfaces to other hosts.
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
        // After this point, a failure removes everything that was made.
        let network = Self { name, hosts };
        for number in network.hosts() {
            let host = network.namespace(number);
            ip(&format!("netns add {host}"));
            ip(&format!("-n {host} link set lo up"));
        }
        Some(network)
    }

    /// Gives a host its address on its interface. The interface must exist.
    pub(super) fn connect(&self, number: usize) {
        let host = self.namespace(number);
        ip(&format!("-n {host} address add 10.77.0.{number}/24 dev eth0"));
        ip(&format!("-n {host} link set eth0 up"));
        // On a machine with a gateway, multicast also leaves through the only interface.
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

    /// Removes host `number` from the network, like a pulled cable.
    pub fn cut(&self, number: usize) {
        ip(&format!("-n {}b link set port{number} down", self.name));
    }

    /// Puts host `number` back.
    pub fn heal(&self, number: usize) {
        ip(&format!("-n {}b link set port{number} up", self.name));
    }

    /// Prevents these hosts from reaching each other. Each host still reaches all others.
    pub fn keep_apart(&self, numbers: &[usize]) {
        for number in numbers {
            ip(&format!("-n {}b link set port{number} type bridge_slave isolated on", self.name));
        }
    }

    /// Lets a host reach all hosts again after [`Self::keep_apart`].
    pub fn let_meet(&self, number: usize) {
        ip(&format!("-n {}b link set port{number} type bridge_slave isolated off", self.name));
    }

    /// Changes the interfaces of a host with `ip`.
    pub fn set(&self, number: usize, arguments: &str) {
        ip(&format!("-n {} {arguments}", self.namespace(number)));
    }

    /// Does some work of the test on a host, in a thread that stays there. Threads that it starts also stay there.
    ///
    /// # Panics
    /// The thread panics if the kernel does not let it enter the namespace.
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

/// Prints on the terminal why a test cannot have a network. The test harness captures the output of macros, but everybody should see
/// this message.
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
