//! Three hosts with a node each on a network, and other hosts without a node, for tests of whole machines.

use super::{Cluster, Host, Network, Program, SOON, Trace};
use rustix::process::Signal;
use std::time::Duration;

/// The names of the nodes: `NAMES[0]` is on host 1.
pub const NAMES: [&str; 3] = ["c1", "c2", "c3"];

/// Hosts on a network of namespaces.
#[derive(Debug)]
pub struct Hosts {
    // The fields are dropped in this order: the processes, their folder, the network.
    /// The nodes, in the order of [`NAMES`].
    pub nodes: Vec<Program>,
    /// The folder of the test.
    pub cluster: Cluster,
    /// The network.
    pub network: Network,
}

impl Hosts {
    /// Starts `count` hosts. The first three have a node that logs with the filter `log`, or with the default filter.
    /// Returns none if namespaces are not allowed.
    ///
    /// # Panics
    /// Panics if a node does not start.
    pub fn start(count: usize, log: Option<&str>) -> Option<Self> {
        Self::start_with(count, log, &[])
    }

    /// Starts hosts like [`Hosts::start`], with more arguments for each node.
    ///
    /// # Panics
    /// Panics like [`Hosts::start`].
    pub fn start_with(count: usize, log: Option<&str>, arguments: &[&str]) -> Option<Self> {
        let (cluster, network) = (Cluster::new(), Network::new(count)?);
        let start = |(number, name)| {
            let host = cluster.host(&network, number);
            log.map_or(host.clone(), |log| host.with_log(log)).node(name, &[&["--lan"], arguments].concat())
        };
        let nodes = (1..).zip(NAMES).map(start).collect();
        Some(Self { nodes, cluster, network })
    }

    /// Returns the host with a number. The numbers begin with 1.
    pub fn host(&self, number: usize) -> Host {
        self.cluster.host(&self.network, number)
    }

    /// Sends a signal to every node.
    ///
    /// # Panics
    /// Panics if a node has ended.
    pub fn signal_nodes(&self, signal: Signal) {
        self.nodes.iter().for_each(|node| node.signal(signal));
    }

    /// Returns the number of shims. Each program on any host has one.
    pub fn shims(&self) -> usize {
        self.cluster.left().iter().filter(|process| process.command[0].ends_with("dca-shim")).count()
    }

    /// Returns the record of a run, by its name below `runs/`.
    ///
    /// # Panics
    /// Panics if the record does not exist.
    pub fn trace(&self, name: &str) -> Trace {
        Trace::read(&self.cluster.folder().join("runs").join(name))
    }

    /// Stops the nodes, and checks that no process is left.
    ///
    /// # Panics
    /// Panics if the exit code of a node is not 0, or if something is left.
    pub fn end(mut self) {
        self.signal_nodes(Signal::TERM);
        for node in self.nodes.drain(..) {
            let ended = node.ended(SOON);
            assert_eq!(ended.code, Some(0), "{ended}");
        }
        self.cluster.expect_nothing_left(Duration::from_secs(2));
    }
}
