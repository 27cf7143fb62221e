//! The messages between nodes, and between the command line and a node.
//!
//! Every type here is a promise to other versions. Variants and fields are only appended, because postcard numbers
//! them. The envelope of `comms` contains the version.

mod absent;
mod change;
mod clock;
mod deploying;
mod estop;
mod event;
mod facts;
mod failure;
mod kept;
mod message;
mod names;
mod parameters;
mod presence;
mod relay;
mod report;
mod signed;
mod status;

use crate::logic::database::question::{Question, Reply};
pub use absent::{Absent, AbsentHost, AbsentProcess, OpenEnd, OpenHost, Why};
pub use change::{ChangeOrder, ChangeReply, ChangeRequest, ChangeStage, ChangeUnderway, Revision};
pub use clock::{ClockKeeping, ClockReading};
use comms::logic::codec::{Enveloped, Kind};
use comms::logic::control::Dial;
use comms::logic::object::Access;
pub use deploying::{ActivityInput, StartMode, Taken, ToCoordinator, ToParticipant};
pub use estop::{Estop, Estopped};
pub use event::Event;
pub use facts::LeafFacts;
pub use failure::{Failure, FailureCause, ProgramEnd, signal_name};
pub use kept::{Before, Earlier, Kept, Tombstone};
use language::plan::{MemberKind, Plan};
pub use message::{Body, Message};
pub use names::{DeviceName, Names, PortName};
pub use parameters::{InstanceParameters, ParameterStatus};
pub use presence::{AuditHead, Duplicate, Namesake, Ping, Pong, Refusal, Renewing};
pub use relay::{Relay, Relayed};
pub use report::{Change, Report, SetsSwitched, is_unreached, unreachable, unreached};
use serde::{Deserialize, Serialize};
pub use signed::{Order, Ordered, Signed, TeamOfNode};
pub use status::{
    ActivityStatus, Containment, DeploymentStatus, LeafStatus, LostValues, Network, NodeStatus, OpenQuestion,
    PolicyInUse, ProcessStatus, RefusedValues, WaitingDeployment, leaves,
};
use std::fmt;
use std::time::Duration;

/// How long a node with further answers may be silent. Within this time, it sends several signs that further answers come.
pub const SILENCE_MAX: Duration = Duration::from_secs(8);

/// The beginning of the refusal of [`Request::Logs`] if several processes match.
pub const SEVERAL: &str = "several processes end in";

/// One deployment of a spec: its name, and the epoch that distinguishes it from earlier ones.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Deployment {
    /// The name of the spec, unless the user gave another name.
    pub name: String,
    /// Increases with each deployment of this name.
    pub epoch: u64,
}

impl fmt::Display for Deployment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.name, self.epoch)
    }
}

/// A process that a supervisor starts and stops.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Target {
    /// Index into `Plan::leaves`.
    Leaf(u32),
    /// Index into `Plan::groups`.
    Group(u32),
}

impl From<MemberKind> for Target {
    fn from(member: MemberKind) -> Self {
        match member {
            MemberKind::Leaf(leaf) => Self::Leaf(leaf),
            MemberKind::Group(group) => Self::Group(group),
        }
    }
}

impl Deployment {
    /// Returns a message about this deployment to its home.
    pub fn to_coordinator(&self, what: ToCoordinator) -> Message {
        Message { deployment: self.clone(), body: Body::Coordinator(what) }
    }

    /// Returns a message about this deployment to a part of it.
    pub fn to_participant(&self, what: ToParticipant) -> Message {
        Message { deployment: self.clone(), body: Body::Participant(what) }
    }
}

/// How an activation ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Ending {
    /// It ended normally, with a value.
    Done(Vec<u8>),
    /// It ended by a failure.
    Aborted(Failure),
    /// It ended because it was asked to stop.
    Stopped,
    /// It is not known how it ended.
    Unconfirmed,
}

/// A request of a command line to a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// Runs a plan. Answered by a stream of [`Report`]; the last is [`Report::Finished`] or [`Report::Refused`].
    Deploy {
        /// A number that makes a repeated request harmless.
        request: u64,
        /// The plan to run.
        plan: Plan,
        /// The user who deploys it, for the records, such as `ann@c1`.
        by: String,
        /// When the programs of the first step begin.
        start: StartMode,
    },
    /// Asks for the status of the node. Answered by [`NodeStatus`].
    Status,
    /// Stops a deployment. Answered by [`StopReply`] when nothing of it is left.
    Stop {
        /// The deployment.
        name: String,
    },
    /// Asks for the output of a process. Answered by a stream of raw output.
    Logs {
        /// The deployment, if several deployments have such a process.
        deployment: Option<String>,
        /// The absolute path of the process, or the end of it.
        process: String,
        /// Whether later output follows as it comes.
        follow: bool,
    },
    /// Continues to watch a deployment after answers were cut off. Answered like `Deploy`.
    Watch {
        /// The deployment.
        deployment: Deployment,
        /// How many of its reports the caller already has.
        seen: u64,
    },
    /// Asks the database a question. Answered by [`Answer::Database`]; the answer has no keys that are local to the robot.
    Database(Question),
    /// Asks for the parameters of programs. Answered by [`Answer::Parameters`].
    Parameters,
    /// The same as `Database`, but from the node's own machine.
    Here {
        /// A secret that the node has written to a file. Only this user of this machine can read the file.
        proof: String,
        /// The question.
        question: Question,
    },
    /// Asks for all output of the programs of a deployment on this host, until the deployment is over here. Answered by
    /// a stream of [`Answer::Wrote`].
    Output {
        /// The deployment. It may already be over.
        deployment: Deployment,
    },
    /// Asks for links that the node lacks. Answered by [`Answer::Unlinked`].
    Unlinked,
    /// Asks for hosts that do not answer. Answered by [`Answer::Absent`].
    Absent,
    /// Makes the node forget the end of a deployment that some host has not confirmed. Answered by [`StopReply`].
    Forget {
        /// The deployment.
        deployment: Deployment,
    },
    /// Asks for the plan of a deployment. Answered by [`Answer::Plan`].
    Plan {
        /// The deployment. It has a part on the node.
        deployment: Deployment,
    },
    /// Asks for the plan and its revision. Answered by [`Answer::Revision`], or refused if no such deployment has its home here.
    Revision {
        /// The name of the deployment.
        name: String,
    },
    /// Changes a deployment. Answered by a stream of [`Report`] about this change only; the last is [`Report::Changed`]
    /// or [`Report::Unchanged`].
    Change(Box<ChangeRequest>),
    /// Asks for the events that the node knows as the home of deployments, including the last deployments that are
    /// over. Answered by a stream of [`Answer::Events`]: known events, then an answer without events, then new events.
    Events {
        /// Whether new events follow as they happen.
        follow: bool,
    },
    /// Asks for the names that the host has given out. Answered by [`Answer::Names`].
    Names,
    /// Asks where programs are. Answered by [`Answer::Locations`], or refused if the deployment has no part on the node.
    Locations {
        /// The deployment.
        deployment: Deployment,
    },
    /// Revokes keys. Answered by [`Answer::Revoked`] when this is on the node's disk.
    Revoke {
        /// A set of revocations, signed with the team's key or by an admin of the team.
        set: Vec<u8>,
    },
    /// Asks for the calendar clock. Answered by [`Answer::Clock`], at once.
    Clock,
    /// Asks for the team of the node. Answered by [`Answer::Team`], at once.
    Team,
    /// A signed request. Answered like that request, if the node is in a team and the signer may ask for it.
    Signed(Box<Signed>),
    /// Asks for names that two nodes share. Answered by [`Answer::Duplicates`].
    Duplicates,
    /// Switches a running process to other connection sets that it has. The home of the deployment does this. Answered
    /// by [`Answer::Switched`].
    Switch(SwitchRequest),
    /// Stops everything on the node at once; nothing begins there before [`Request::ReleaseEstop`]. Answered by
    /// [`Answer::Estopped`] when nothing runs.
    Estop(Estop),
    /// Lets programs begin again. Answered by [`Answer::Released`].
    ReleaseEstop,
    /// Stores a tombstone for a home that the node does not reach, until the home has received it. Answered by [`StopReply`].
    StopAway(Box<Tombstone>),
    /// Asks for the credentials of nodes. Answered by [`Answer::Credentials`], at once.
    Credentials,
    /// Asks for the renewal of a user's certificate. Answered by [`Answer::Credentials`] with only the renewed credential, at once.
    RenewUser {
        /// Signed by the user: `trust::renewal::ask`.
        ask: Vec<u8>,
    },
    /// Adds sets of revocations, signed with the team's key or by an admin of the team. Answered by
    /// [`Answer::Revocations`] when all are on the disk.
    Revocations(Vec<Vec<u8>>),
    /// A call of a procedure. A user signs it and sends it to a program, which asks its node. Nodes do not answer it directly.
    Call(Box<CallRequest>),
    /// Gives an order to an activity. The home of the deployment passes it on. Answered by [`Answer::Delivered`] once
    /// the activity has confirmed the order.
    Tell(Box<TellRequest>),
}

/// A request to give an order to an activity.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TellRequest {
    /// The deployment.
    pub name: String,
    /// The absolute path of the activity, or the end of it.
    pub process: String,
    /// The order.
    pub order: ActivityInput,
    /// The user who gives the order; in a team, its signer.
    pub by: String,
}

/// A call of a procedure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CallRequest {
    /// The deployment of the program.
    pub deployment: Deployment,
    /// The absolute path of its process.
    pub path: String,
    /// The procedure.
    pub procedure: String,
    /// The right that the user needs.
    pub access: Access,
    /// The digest of the call and its argument: `comms::io::data::call_digest`.
    pub digest: [u8; 32],
}

/// A request to switch connection sets.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SwitchRequest {
    /// The deployment.
    pub name: String,
    /// The absolute path of a process, or the end of it.
    pub process: String,
    /// Labels of connection sets of the process. Exactly these sets should be open.
    pub labels: Vec<String>,
}

/// An element of the answer to a [`Request`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Answer {
    /// To `Deploy`.
    Report(Report),
    /// To `Status`.
    Status(NodeStatus),
    /// To `Stop`, `Forget` and `StopAway`.
    Stop(StopReply),
    /// To `Logs`.
    Output(Vec<u8>),
    /// A sentence for a person: the request cannot be answered.
    Refused(String),
    /// To `Database`.
    Database(Reply),
    /// To `Parameters`: every program of this host.
    Parameters(Vec<InstanceParameters>),
    /// To `Output`.
    Wrote {
        /// Absolute path of the process.
        path: String,
        /// The bytes that its program wrote.
        bytes: Vec<u8>,
    },
    /// To `Unlinked`: the peers that the node dials without having a link. Each has its name or place, and the reason, for a person.
    Unlinked(Vec<(String, String)>),
    /// To `Absent`.
    Absent(Absent),
    /// To `Plan`.
    Plan(Box<Plan>),
    /// To `Revision`.
    Revision(Box<Revision>),
    /// To `Events`: some events. The events of each deployment are in order.
    Events(Vec<Event>),
    /// To `Names`.
    Names(Names),
    /// To `Locations`: the programs of this host with a data session, by absolute path, and the address of each.
    Locations(Vec<(String, Dial)>),
    /// To `Revoke`.
    Revoked {
        /// Whether the revocation was new for the node.
        is_new: bool,
    },
    /// To `Clock`.
    Clock(ClockReading),
    /// To `Team`: nothing if the node is in no team.
    Team(Option<TeamOfNode>),
    /// To `Duplicates`: names that are used by two nodes which this node can reach. The name of this node may be among them.
    Duplicates(Vec<Duplicate>),
    /// To `Switch`: the result of the switch, or the reason why nothing was switched.
    Switched(Result<SetsSwitched, String>),
    /// To `Estop`.
    Estopped(Estopped),
    /// To `ReleaseEstop`.
    Released {
        /// Whether everything was stopped.
        was_stopped: bool,
        /// Why the release is not on the disk of the node. Then the node may not know of it after its next start.
        unwritten: Option<String>,
    },
    /// To `Credentials`: the latest credentials of the nodes of the team, this node's first. Nothing if the node is in no team.
    Credentials(Vec<Vec<u8>>),
    /// To `Revocations`: all sets that the node has. No set contains another one.
    Revocations(Vec<Vec<u8>>),
    /// To `Events`, as the last answer: hosts of which the node may not have received all events from before the
    /// question. The node itself may be among them.
    Behind(Vec<String>),
    /// To `Tell`.
    Delivered(Delivery),
}

/// The result of an order for an activity.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Delivery {
    /// The activity has accepted the order.
    Taken {
        /// The absolute path of the activity.
        path: String,
        /// The reaction of the activity.
        taken: Taken,
    },
    /// The activity has not accepted the order, for this reason.
    Refused(String),
    /// The activity has not confirmed the order, for this reason.
    Unconfirmed(String),
}

impl Enveloped for Request {
    const KIND: Kind = Kind::Request;
}

impl Enveloped for Answer {
    const KIND: Kind = Kind::Answer;
}

/// The answer to [`Request::Stop`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StopReply {
    /// Nothing of the deployment is left.
    Stopped,
    /// No such deployment has its home here.
    Unknown,
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::codec;
    use dbmanager::logic::version_vector::{Dot, ReplicaId};
    use dbmanager::logic::view::past::When;

    #[test]
    fn json_has_times_in_seconds_and_names_as_strings() {
        let check = |json: serde_json::Result<String>, expected: &str| assert_eq!(json.unwrap(), expected);
        let (peers, deployments) = (Vec::new(), Vec::new());
        let (host, version, up) = ("c1".into(), "1".into(), Duration::from_millis(1500));
        let containment = Containment::ControlGroup;
        let status = NodeStatus {
            host,
            pid: 7,
            version,
            up,
            peers,
            deployments,
            containment,
            network: Network::Insecure,
            estop: None,
            policy: None,
            missing: vec!["c2".into()],
            waiting: Vec::new(),
        };
        let text = r#"{"host":"c1","pid":7,"version":"1","up":1.5,"peers":[],"deployments":[],"containment":"control_group","network":"insecure","estop":null,"policy":null,"missing":["c2"],"waiting":[]}"#;
        check(serde_json::to_string(&status), text);
        assert_eq!(serde_json::from_str::<NodeStatus>(text).unwrap(), status);
        let dot = Dot { origin: ReplicaId::new(0xfedc_ba98_7654_3210), seq: 3 };
        check(serde_json::to_string(&dot), r#"{"origin":"fedcba9876543210","seq":3}"#);
        let when = When { millis: 1_700_000_000_123, trusted: true };
        check(serde_json::to_string(&when), r#"{"at":1700000000.123,"trusted":true}"#);
        assert_eq!(serde_json::from_str::<When>(r#"{"at":1700000000.123,"trusted":true}"#).unwrap(), when);
    }

    fn empty() -> Plan {
        let (hosts, groups, leaves, wires, claims) = Default::default();
        Plan { name: String::new(), hosts, groups, leaves, wires, claims, on_boot: Default::default() }
    }

    #[test]
    fn a_status_stays_as_it_was() {
        let (peers, deployments) = (Vec::new(), Vec::new());
        let (host, version, up) = ("c1".into(), "1".into(), Duration::new(3, 4));
        let containment = Containment::ControlGroup;
        let network = Network::Host;
        let (estop, policy) = (None, Some(PolicyInUse { file: "p".into(), sandbox: "none".into() }));
        let missing = vec!["c2".into()];
        let (resumes, begins_in, hosts, at_most) = (None, Duration::new(7, 0), Vec::new(), Duration::new(9, 0));
        let waiting = vec![WaitingDeployment { name: "d".into(), by: "a".into(), resumes, begins_in, hosts, at_most }];
        let status = NodeStatus {
            host,
            pid: 7,
            version,
            up,
            peers,
            deployments,
            containment,
            network,
            estop,
            policy,
            missing,
            waiting,
        };
        let bytes = *b"\x02c1\x07\x011\x03\x04\0\0\x01\0\0\x01\x01p\x04none\x01\x02c2\x01\x01d\x01a\0\x07\0\0\x09\0";
        assert_eq!(postcard::to_stdvec(&status).unwrap(), bytes);
    }

    #[test]
    fn what_goes_over_the_wire_stays_as_it_was() {
        let ping = Ping { from: "c1".into(), boot: 5, round: 300 };
        assert_eq!(codec::encode(&ping).unwrap(), *b"DC\x01\x00\x69\x00\x02c1\x05\xac\x02");
        let dot = Dot { origin: ReplicaId::new(300), seq: 3 };
        assert_eq!(postcard::to_stdvec(&dot).unwrap(), [0xac, 2, 3]);
        assert_eq!(postcard::to_stdvec(&When { millis: 300, trusted: true }).unwrap(), [0xac, 2, 1]);
        let (deployment, heard) = (Deployment { name: "d".into(), epoch: 2 }, Duration::new(3, 4));
        let lost = OpenHost { host: "c2".into(), why: Why::Late, heard: Some(heard) };
        let absent = Answer::Absent(Absent {
            hosts: vec![AbsentHost { host: "c2".into(), heard, lost: true }],
            ends: vec![OpenEnd { deployment: deployment.clone(), home: "c1".into(), hosts: vec![lost] }],
            processes: vec![AbsentProcess {
                deployment: deployment.clone(),
                host: "c2".into(),
                path: "m".into(),
                kind: "A".into(),
            }],
        });
        let bytes =
            *b"\x09\x01\x02c2\x03\x04\x01\x01\x01d\x02\x02c1\x01\x02c2\x01\x01\x03\x04\x01\x01d\x02\x02c2\x01m\x01A";
        assert_eq!(postcard::to_stdvec(&absent).unwrap(), bytes);
        assert_eq!(postcard::to_stdvec(&Request::Absent).unwrap(), [10]);
        let told = Change::Configured { parameter: "p".into(), value: Some("1".into()) };
        assert_eq!(postcard::to_stdvec(&told).unwrap(), *b"\x08\x01p\x01\x011");
        assert_eq!(postcard::to_stdvec(&Request::Plan { deployment: deployment.clone() }).unwrap(), *b"\x0c\x01d\x02");
        assert_eq!(
            postcard::to_stdvec(&Request::Forget { deployment: deployment.clone() }).unwrap(),
            *b"\x0b\x01d\x02"
        );
        assert_eq!(postcard::to_stdvec(&Request::Events { follow: true }).unwrap(), [15, 1]);
        assert_eq!(postcard::to_stdvec(&Request::Names).unwrap(), [16]);
        let (id, path) = (deployment.clone(), "m".to_owned());
        let port =
            PortName { deployment: id.clone(), path: path.clone(), port: "P".into(), is_output: true, kind: None };
        let device = DeviceName { device: "a".into(), deployment: id, path, is_exclusive: true };
        let names = Answer::Names(Names { ports: vec![port], devices: vec![device] });
        assert_eq!(
            postcard::to_stdvec(&names).unwrap(),
            *b"\x0d\x01\x01d\x02\x01m\x01P\x01\x00\x01\x01a\x01d\x02\x01m\x01"
        );
        assert_eq!(postcard::to_stdvec(&Request::Clock).unwrap(), [19]);
        let clock = ClockReading { shown: Duration::new(3, 4), keeping: ClockKeeping::Unset };
        assert_eq!(postcard::to_stdvec(&Answer::Clock(clock)).unwrap(), [16, 3, 4, 2]);
        assert_eq!(postcard::to_stdvec(&Request::Team).unwrap(), [20]);
        let signed = Signed { head: vec![1], body: vec![2, 3] };
        assert_eq!(postcard::to_stdvec(&Request::Signed(Box::new(signed.clone()))).unwrap(), [21, 1, 1, 2, 2, 3]);
        let ordered = ToParticipant::Prepare { plan: empty() }.signed(Some(&signed));
        assert_eq!(postcard::to_stdvec(&ordered).unwrap(), [17, 1, 1, 2, 2, 3, 0]);
        assert_eq!(postcard::to_stdvec(&Request::Duplicates).unwrap(), [22]);
        let twice = Duplicate { host: "c1".into(), first: "a".into(), second: "b".into() };
        assert_eq!(postcard::to_stdvec(&Answer::Duplicates(vec![twice])).unwrap(), *b"\x12\x01\x02c1\x01a\x01b");
        let (deployments, ended) = (vec![(deployment.clone(), true)], vec![deployment.clone()]);
        let namesake = Namesake { boot: 5, to_boot: 6, deployments, ended };
        assert_eq!(codec::encode(&namesake).unwrap(), *b"DC\x01\x00\x6a\x00\x05\x06\x01\x01d\x02\x01\x01\x01d\x02");
        let estop = Estop { by: "a".into(), reason: "b".into() };
        assert_eq!(postcard::to_stdvec(&Request::Estop(estop)).unwrap(), *b"\x18\x01a\x01b");
        assert_eq!(postcard::to_stdvec(&Request::ReleaseEstop).unwrap(), [25]);
        let estopped = Answer::Estopped(Estopped { unended: vec!["d@2 m".into()], unwritten: None });
        assert_eq!(postcard::to_stdvec(&estopped).unwrap(), *b"\x14\x01\x05d@2 m\x00");
        let released = Answer::Released { was_stopped: true, unwritten: None };
        assert_eq!(postcard::to_stdvec(&released).unwrap(), [21, 1, 0]);
        let report = Report::Connected { host: "c2".into() };
        let time = Duration::new(5, 6);
        let event = Event { deployment, number: 300, host: "c2".into(), ago: heard, report, time };
        let bytes = *b"\x0c\x01\x01d\x02\xac\x02\x02c2\x03\x04\x02\x02c2\x05\x06";
        assert_eq!(postcard::to_stdvec(&Answer::Events(vec![event])).unwrap(), bytes);
    }

    #[test]
    fn what_asks_for_a_call_stays_as_it_was() {
        let asked = CallRequest {
            deployment: Deployment { name: "d".into(), epoch: 2 },
            path: "m".into(),
            procedure: "G".into(),
            access: Access::Operate,
            digest: [7; 32],
        };
        let bytes = [&b"\x1e\x01d\x02\x01m\x01G\x01"[..], &[7; 32]].concat();
        assert_eq!(postcard::to_stdvec(&Request::Call(Box::new(asked))).unwrap(), bytes);
    }
}
