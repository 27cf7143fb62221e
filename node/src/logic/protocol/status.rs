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
    /// How long it has been up.
    #[serde(with = "comms::logic::human::seconds")]
    pub up: Duration,
    /// Other nodes that it can reach.
    pub peers: Vec<String>,
    /// Deployments with a part here.
    pub deployments: Vec<DeploymentStatus>,
    /// The means by which it keeps hold of its programs.
    #[serde(default)]
    pub containment: Containment,
    /// The peers that it accepts over the network.
    #[serde(default)]
    pub network: Network,
    /// The user who has stopped everything, if there is one.
    #[serde(default)]
    pub estop: Option<Estop>,
    /// The execution policy that holds there, if one does.
    #[serde(default)]
    pub policy: Option<PolicyInUse>,
    /// Other nodes that it has reached recently, and that do not answer. Each known node is in one of the two lists.
    #[serde(default)]
    pub missing: Vec<String>,
    /// Deployments with their home here that have not begun.
    #[serde(default)]
    pub waiting: Vec<WaitingDeployment>,
}

/// A deployment that its home has accepted and that has not begun.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WaitingDeployment {
    /// Its name.
    pub name: String,
    /// The user who wants it, such as `ann@c1`.
    pub by: String,
    /// The deployment that ran before the machine was rebooted, if this one resumes it.
    pub resumes: Option<Deployment>,
    /// The time until it may begin; zero if it waits for hosts only.
    #[serde(with = "comms::logic::human::seconds")]
    pub begins_in: Duration,
    /// The hosts that it waits for.
    pub hosts: Vec<String>,
    /// The time until it is given up if these hosts do not come.
    #[serde(with = "comms::logic::human::seconds")]
    pub at_most: Duration,
}

impl WaitingDeployment {
    /// Returns its state in words that stay the same while time passes.
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

/// The execution policy of a node, as it was when the last program was started.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyInUse {
    /// Its file.
    pub file: String,
    /// The sandbox of programs: `standard` or `none`, and the reasons why it or the policy is weakened, for a user.
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
    /// None: it stays on its own machine.
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

/// The means that find everything that a program has started, so that nothing of it is left when it is over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Containment {
    /// Its shim, which inherits every process it leaves. Processes that a killed shim has left are found by their
    /// environment and their session.
    #[default]
    Subreaper,
    /// The shim, and a control group of version 2 around the node and all its programs, which none of them leaves by
    /// itself.
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

/// A deployment as one host sees it.
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
    /// Values lost on wires to its programs on this host.
    pub lost: Vec<LostValues>,
    /// The values that inputs of its programs on this host have refused.
    pub refused: Vec<RefusedValues>,
}

/// Values that were sent over a wire and have not come: dropped by a link that was cut or congested, or without room in the queue. Counted
/// since the program at its end began.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LostValues {
    /// The ends of the wire: `main/a, Out -> main/b, In`.
    pub wire: String,
    /// How many.
    pub count: u64,
}

/// Values that an input has refused, because a number in them was not finite. Counted since its program began.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusedValues {
    /// The input: `main/b, In`, or `main/b, arm/state` of a device.
    pub input: String,
    /// How many.
    pub count: u64,
}

/// A process as its host sees it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProcessStatus {
    /// Absolute path.
    pub path: String,
    /// Its type.
    pub kind: String,
    /// `starting`, `idle`, `running`, `stopping`, `dead: SIGSEGV` …
    pub state: String,
    /// Process id of a leaf's program.
    pub pid: Option<u32>,
    /// The details of an activity that runs.
    pub activity: Option<ActivityStatus>,
}

/// An activity that runs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActivityStatus {
    /// The names of its states.
    pub states: Vec<String>,
    /// The questions that wait for an answer.
    pub questions: Vec<OpenQuestion>,
    /// The orders that it waits for, as `dca ctl` takes them.
    pub orders: Vec<String>,
}

/// A question of an activity that waits for an answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OpenQuestion {
    /// Its number, counted from 1 by the supervisor.
    pub number: u64,
    /// The question with its answers.
    pub text: String,
    /// The answers.
    pub options: Vec<String>,
}

impl ProcessStatus {
    /// Returns the process of another deployment that this one stands for: the name of that deployment, and the path there.
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

/// Returns every leaf of all deployments, dead or alive. A leaf lies below a group, and nothing lies below it on any host.
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
