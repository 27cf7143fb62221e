//! Messages about the status of a node and of its deployments.

use super::{Deployment, Estop};
use comms::logic::human::span;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt;
use std::time::Duration;

/// The answer to [`super::Request::Status`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeStatus {
    /// The node's name.
    pub host: String,
    /// The node's process id.
    pub pid: u32,
    /// Version of DCA.
    pub version: String,
    /// How long the node has been running.
    #[serde(with = "comms::logic::human::seconds")]
    pub up: Duration,
    /// Other nodes that it can reach.
    pub peers: Vec<String>,
    /// Deployments that have a part on the node.
    pub deployments: Vec<DeploymentStatus>,
    /// How the node finds everything that its programs have started.
    #[serde(default)]
    pub containment: Containment,
    /// The peers that the node accepts over the network.
    #[serde(default)]
    pub network: Network,
    /// The user who has stopped everything, if there is one.
    #[serde(default)]
    pub estop: Option<Estop>,
    /// The execution policy that applies on the node, if there is one.
    #[serde(default)]
    pub policy: Option<PolicyInUse>,
    /// Other nodes that it reached recently, and that do not answer now. Each known node is either in `peers` or in this list.
    #[serde(default)]
    pub missing: Vec<String>,
    /// Deployments with their home on the node that have not begun.
    #[serde(default)]
    pub waiting: Vec<WaitingDeployment>,
}

/// A deployment that its home has accepted, and that has not begun.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WaitingDeployment {
    /// Its name.
    pub name: String,
    /// The user who has deployed it, such as `ann@c1`.
    pub by: String,
    /// The deployment that ran before a reboot of the machine, if this one resumes it.
    pub resumes: Option<Deployment>,
    /// The time until it may begin. Zero if it waits only for hosts.
    #[serde(with = "comms::logic::human::seconds")]
    pub begins_in: Duration,
    /// The hosts that it waits for.
    pub hosts: Vec<String>,
    /// The time after which it is given up if these hosts do not come.
    #[serde(with = "comms::logic::human::seconds")]
    pub at_most: Duration,
}

impl WaitingDeployment {
    /// Describes its state in words that do not change with time.
    pub fn state(&self) -> &'static str {
        if self.resumes.is_some() { "waits to be resumed" } else { "waits to begin" }
    }
}

impl fmt::Display for WaitingDeployment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let whole = |time: Duration| span(Duration::from_secs(time.as_secs() + u64::from(time.subsec_nanos() > 0)));
        f.write_str(self.state())?;
        if !self.begins_in.is_zero() {
            write!(f, ", in {}", whole(self.begins_in))?;
        }
        if !self.hosts.is_empty() {
            write!(f, ", for {} (at most {})", self.hosts.join(", "), whole(self.at_most))?;
        }
        Ok(())
    }
}

/// The execution policy of a node, as it was at the last start of a program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyInUse {
    /// Its file.
    pub file: String,
    /// The sandbox of programs: `standard` or `none`. Also the reasons why the sandbox or the policy is weak, for a user.
    pub sandbox: String,
}

impl fmt::Display for PolicyInUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "policy {}, sandbox {}", self.file, self.sandbox)
    }
}

/// The peers that a node accepts over the network.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Network {
    /// No other nodes: it stays on its own machine.
    #[default]
    Host,
    /// All nodes.
    Insecure,
    /// The nodes of its team.
    Team {
        /// The name of the team.
        name: String,
    },
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Host => Ok(()),
            Self::Insecure => f.write_str("open to everybody on the network: --insecure-lan"),
            Self::Team { name } => write!(f, "team {name}"),
        }
    }
}

/// How a node finds everything that a program has started, so that nothing is left when the program is over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Containment {
    /// The shim of the program inherits all processes that the program leaves. If a shim was killed, the processes are
    /// found by their environment and their session.
    #[default]
    Subreaper,
    /// The shim, and a control group of version 2 around the node and all of its programs. No program can leave this group by itself.
    ControlGroup,
}

impl fmt::Display for Containment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Subreaper => "subreaper",
            Self::ControlGroup => "subreaper and control group",
        })
    }
}

/// A deployment, as one host reports it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeploymentStatus {
    /// The deployment.
    pub deployment: Deployment,
    /// The host of `main`.
    pub home: String,
    /// `preparing`, `connecting`, `running`, `ending`.
    pub phase: String,
    /// Groups and leaves of this host.
    pub processes: Vec<ProcessStatus>,
    /// The values that were lost on wires to its programs on this host.
    pub lost: Vec<LostValues>,
    /// The values that inputs of its programs on this host have refused.
    pub refused: Vec<RefusedValues>,
    /// The values that programs on this host have sent while the consumers on other hosts were not connected. A consumer
    /// that is connected again counts them as lost.
    pub undelivered: Vec<LostValues>,
}

/// Values that were sent over a wire and have not arrived: a cut or congested link has dropped them, or the queue had
/// no room. They are counted since the start of the receiving program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LostValues {
    /// The ends of the wire: `main/a, Out -> main/b, In`.
    pub wire: String,
    /// The number of values.
    pub count: u64,
}

/// Values that an input has refused because they contain a number that is not finite. They are counted since the start of the program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusedValues {
    /// The input: `main/b, In`, or `main/b, arm/state` for a device.
    pub input: String,
    /// The number of values.
    pub count: u64,
}

/// A process, as its host reports it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProcessStatus {
    /// Its absolute path.
    pub path: String,
    /// Its type.
    pub kind: String,
    /// `starting`, `idle`, `running`, `stopping`, `dead: SIGSEGV` …
    pub state: String,
    /// The process id of its program, if it is a leaf.
    pub pid: Option<u32>,
    /// The details of the activity, if the process is a running activity.
    pub activity: Option<ActivityStatus>,
}

/// A running activity.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActivityStatus {
    /// The names of its active states.
    pub states: Vec<String>,
    /// The questions that wait for an answer.
    pub questions: Vec<OpenQuestion>,
    /// The orders that it waits for, in the form of `dca ctl`.
    pub orders: Vec<String>,
}

/// A question of an activity that waits for an answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OpenQuestion {
    /// Its number. The supervisor counts questions from 1.
    pub number: u64,
    /// The question, including its answers.
    pub text: String,
    /// The possible answers.
    pub options: Vec<String>,
}

impl ProcessStatus {
    /// If the process stands for a process of another deployment, returns the name of that deployment and the path of the process there.
    pub fn stands_for(&self) -> Option<(&str, &str)> {
        let (word, external) = self.state.split_once(": `").filter(|_| self.pid.is_none())?;
        let (path, deployment) = external.strip_suffix('`')?.split_once("` of `")?;
        ["running", "idle"].contains(&word).then_some((deployment, path))
    }
}

/// A leaf, and where it is.
#[derive(Clone, Copy, Debug)]
pub struct LeafStatus<'a> {
    /// The host that it runs on.
    pub host: &'a str,
    /// The deployment that it belongs to.
    pub deployment: &'a Deployment,
    /// Its state, as its host reports it.
    pub process: &'a ProcessStatus,
}

/// Returns every leaf of all deployments, even if its program does not run. A leaf is below a group, and no process on
/// any host is below a leaf.
pub fn leaves(nodes: &[NodeStatus]) -> Vec<LeafStatus<'_>> {
    let all = nodes.iter().flat_map(|node| {
        node.deployments.iter().flat_map(move |DeploymentStatus { deployment, processes, .. }| {
            processes.iter().map(move |process| LeafStatus { host: &node.host, deployment, process })
        })
    });
    let all: Vec<LeafStatus<'_>> = all.collect();
    let above = |one: &LeafStatus<'_>| one.process.path.rsplit_once('/').map(|(above, _)| above.to_owned());
    let groups: BTreeSet<_> = all.iter().filter_map(|one| Some((one.deployment, above(one)?))).collect();
    let is_leaf =
        |one: &LeafStatus<'_>| above(one).is_some() && !groups.contains(&(one.deployment, one.process.path.clone()));
    all.into_iter().filter(is_leaf).collect()
}
