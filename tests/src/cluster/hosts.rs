//! Three hosts on a network with a node each, and others without, for tests that need the whole machine.

use super::{Cluster, Host, Network, Program, SOON, Trace};
use rustix::process::Signal;
use std::time::Duration;

/// The names of the nodes: `NAMES[0]` is on host 1.
pub const NAMES: [&str; 3] = ["c1", "c2", "c3"];

/// Hosts on a network of namespaces.
#[derive(Debug)]
pub struct Hosts {
    // Dropped in this order: the processes, their folder, the network.
    /// The nodes, in the order of [`NAMES`].
    pub nodes: Vec<Program>,
    /// The folder of the test.
    pub cluster: Cluster,
    /// The network.
    pub network: Network,
}

impl Hosts {
    /// Starts `count` hosts, the first three with a node that logs by the filter `log`, or as nodes do. Returns none
    /// where namespaces are not allowed.
    ///
    /// # Panics
    /// A node does not start.
    pub fn start(count: usize, log: Option<&str>) -> Option<Self> {
        Self::start_with(count, log, &[])
    }

    /// The same with more arguments for each node.
    ///
    /// # Panics
    /// As [`Hosts::start`].
    pub fn start_with(count: usize, log: Option<&str>, arguments: &[&str]) -> Option<Self> {
        let (cluster, network) = (Cluster::new(), Network::new(count)?);
        let start = |(number, name)| {
            let host = cluster.host(&network, number);
            log.map_or(host.clone(), |log| host.with_log(log)).node(name, &[&["--lan"], arguments].concat())
        };
        let nodes = (1..).zip(NAMES).map(start).collect();
        Some(Self { nodes, cluster, network })
    }

    /// Returns a host, by its number from 1.
    pub fn host(&self, number: usize) -> Host {
        self.cluster.host(&self.network, number)
    }

    /// Sends every node a signal.
    ///
    /// # Panics
    /// A node has ended.
    pub fn signal_nodes(&self, signal: Signal) {
        self.nodes.iter().for_each(|node| node.signal(signal));
    }

    /// Returns how many shims there are: one for each program on any host.
    pub fn shims(&self) -> usize {
        self.cluster.left().iter().filter(|process| process.command[0].ends_with("dca-shim")).count()
    }

    /// Returns the record of a run, by its name below `runs/`.
    ///
    /// # Panics
    /// There is no such record.
    pub fn trace(&self, name: &str) -> Trace {
        Trace::read(&self.cluster.folder().join("runs").join(name))
    }

    /// Stops the nodes and checks that no process is left.
    ///
    /// # Panics
    /// A node ends with another exit code than 0, or something is left.
    pub fn end(mut self) {
        self.signal_nodes(Signal::TERM);
        for node in self.nodes.drain(..) {
            let ended = node.ended(SOON);
            assert_eq!(ended.code, Some(0), "{ended}");
        }
        self.cluster.expect_nothing_left(Duration::from_secs(2));
    }
}
