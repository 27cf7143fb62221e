//! The progress of a deployment's start: programs run, links are made, GO is given.

use comms::logic::human::span;
use language::plan::Plan;
use node::logic::table::counted;
use std::time::Duration;

/// The progress until GO.
#[derive(Debug, Clone)]
pub struct Start {
    hosts: Vec<Host>,
    took: Option<Duration>,
    /// For an aligned start: the largest possible time between the begins of the programs of the first step.
    aligned: Option<Duration>,
}

#[derive(Debug, Clone)]
struct Host {
    name: String,
    leaves: usize,
    stage: Stage,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    Asked,
    Prepared,
    Connected,
}

impl Start {
    pub(super) fn new(plan: &Plan) -> Self {
        let host = |index: usize, name: &String| {
            let leaves = plan.leaves.iter().filter(|leaf| usize::try_from(leaf.host) == Ok(index)).count();
            Host { name: name.clone(), leaves, stage: Stage::Asked }
        };
        Self {
            hosts: plan.hosts.iter().enumerate().map(|(index, name)| host(index, name)).collect(),
            took: None,
            aligned: None,
        }
    }

    pub(super) fn prepared(&mut self, host: &str, leaves: u32) {
        if let Some(host) = self.hosts.iter_mut().find(|known| known.name == host) {
            host.leaves = usize::try_from(leaves).unwrap_or(usize::MAX);
            host.stage = host.stage.max(Stage::Prepared);
        }
    }

    pub(super) fn connected(&mut self, host: &str) {
        if let Some(host) = self.hosts.iter_mut().find(|known| known.name == host) {
            host.stage = Stage::Connected;
        }
    }

    pub(super) fn aligned(&mut self, within: Duration) {
        self.aligned = Some(within);
    }

    pub(super) fn go(&mut self, took: Duration) {
        self.took = Some(took);
    }

    /// Returns whether GO was given.
    pub fn is_running(&self) -> bool {
        self.took.is_some()
    }

    /// Returns the time from PREPARE to GO, once GO was given.
    pub fn took(&self) -> Option<Duration> {
        self.took
    }

    /// Returns the number of programs and the number of hosts.
    pub fn size(&self) -> (usize, usize) {
        (self.hosts.iter().map(|host| host.leaves).sum(), self.hosts.len())
    }

    /// Returns one line about the progress: `starting 20 programs: c1 7 up · c2 linked · c3 …`.
    pub fn line(&self) -> String {
        let (programs, _) = self.size();
        let hosts = self.hosts.iter().map(|host| match host.stage {
            Stage::Asked => format!("{} …", host.name),
            Stage::Prepared => format!("{} {} up", host.name, host.leaves),
            Stage::Connected => format!("{} linked", host.name),
        });
        format!("starting {}: {}", counted(programs, "program"), hosts.collect::<Vec<_>>().join(" · "))
    }

    /// Returns one line once GO was given: `20 programs on 3 hosts, started in 0.8 s`. For an aligned start, the line
    /// says how exact it was.
    pub fn done(&self) -> Option<String> {
        let (programs, hosts) = self.size();
        let took = self.took?.as_secs_f64();
        let aligned = self.aligned.map_or(String::new(), |within| format!(", aligned to within {}", span(within)));
        Some(format!("{} on {}, started in {took:.1} s{aligned}", counted(programs, "program"), counted(hosts, "host")))
    }
}
