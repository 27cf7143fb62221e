//! The effects of a node's machines, and the types that these machines share.

use crate::logic::database::question::Commit;
use crate::logic::gate::Outcome;
use crate::logic::link::Frame;
use crate::logic::nameserver::Change;
use crate::logic::protocol::{Answer, Deployment, Estop, Kept, Message, Namesake, Signed, ToParticipant, Tombstone};
use comms::logic::control::Order;
use comms::logic::time::Time;
use language::plan::{Environment, KeyBinding, LeafKind, Policy};
use serde::{Deserialize, Serialize};
use shim::protocol::ShimOrder;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// One program of one deployment on this host.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ProcessId {
    /// The deployment.
    pub deployment: Deployment,
    /// Index into `Plan::leaves`.
    pub leaf: u32,
}

/// How to start a program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SpawnOrder {
    /// The program and its deployment.
    pub process: ProcessId,
    /// Absolute path of the instance.
    pub path: String,
    /// Whether the plan has had another program with this path. That program may still be there.
    pub is_next: bool,
    /// Executable and its arguments.
    pub command: Vec<String>,
    /// The words of the command that are secrets.
    pub secrets: Vec<SecretArgument>,
    /// The devices that the program claims.
    pub devices: Vec<String>,
    /// Whether the program speaks the control protocol. A plain program, which does not, is held before `exec` until it is activated.
    pub kind: LeafKind,
    /// Whether the program is a service. A service never ends by itself.
    pub is_service: bool,
    /// The policy of the program: the resources that it may use, and the action when its agent is lost.
    pub policy: Policy,
    /// The keys of the database to which the program is connected.
    pub keys: Vec<KeyBinding>,
    /// The variables and the folder of the program.
    pub environment: Environment,
}

impl SpawnOrder {
    /// Returns the name by which the program introduces itself: its path. If another program may have the same path,
    /// the program's number follows.
    pub fn word(&self) -> String {
        if self.is_next { format!("{}#{}", self.path, self.process.leaf) } else { self.path.clone() }
    }
}

/// A word of a command that is a secret of the database. The value is not stored here: it is read each time the program is started.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SecretArgument {
    /// Which word of the command. The path of a file with the value is appended to this word.
    pub word: u32,
    /// The key in the database.
    pub key: String,
}

/// An effect of a machine. The driver carries out the effects in order.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Send a frame to another node.
    Transmit {
        /// Name of the node.
        to: String,
        /// The frame.
        frame: Box<Frame>,
    },
    /// Ask other nodes whether they are present.
    Ping {
        /// The number of the question.
        round: u64,
        /// The names of the asked nodes. None if all nodes are asked.
        only: Option<BTreeSet<String>>,
        /// Whether some of the asked nodes may not know yet who asks.
        shows: bool,
    },
    /// Tell another node with the name of this node which deployments run here.
    Greet(Box<Namesake>),
    /// From now on, tell a node that asks which boot holds the asking node's name.
    Holders(BTreeMap<String, u64>),
    /// From now on, send the beats of this node only to these hosts, which notice an interrupted line by missing beats.
    Beat(BTreeSet<String>),
    /// Tell users and other listeners about a change of another node.
    Peer(Change),
    /// Start a program under a shim.
    Spawn(Box<SpawnOrder>),
    /// Send an order to a shim.
    Shim {
        /// The program.
        process: ProcessId,
        /// The order.
        order: ShimOrder,
    },
    /// Kill a shim that has not ended its program in time: the shim may be suspended. Everything that the shim leaves
    /// is ended. The program is reported as gone once nothing of it is left.
    KillShim {
        /// The program.
        process: ProcessId,
    },
    /// Send an order to a controller.
    Control {
        /// The program.
        process: ProcessId,
        /// The order.
        order: Order,
    },
    /// Close the channels of a program of which nothing runs any more. Keep its output until the deployment is removed.
    CloseProcess {
        /// The program.
        process: ProcessId,
    },
    /// Close the socket of a deployment that is over on this host. Keep its output for a while.
    CloseDeployment {
        /// The deployment.
        deployment: Deployment,
    },
    /// Write down the epoch of a deployment. When it is on the disk or cannot be written, give [`Input::Committed`].
    /// The node does not wait in the meantime.
    ///
    /// [`Input::Committed`]: crate::logic::agent::Input::Committed
    PersistEpoch {
        /// The deployment.
        deployment: Deployment,
        /// The hosts that take part.
        hosts: Vec<String>,
    },
    /// Check whether a user has signed the order of another node, and give [`Input::Judged`]. Before that input, the
    /// disk gets the record that the order was accepted.
    ///
    /// [`Input::Judged`]: crate::logic::agent::Input::Judged
    Judge {
        /// The number that the input has as well.
        number: u64,
        /// The deployment of the order.
        deployment: Deployment,
        /// The node that gives the order.
        from: String,
        /// The order.
        order: Box<ToParticipant>,
    },
    /// Check whether the signer of a deployment of this home may still run it, and give [`Input::Resumable`]. The
    /// deployment is to be resumed after a reboot.
    ///
    /// [`Input::Resumable`]: crate::logic::agent::Input::Resumable
    JudgeResumed {
        /// The deployment that ran before the reboot.
        deployment: Deployment,
        /// The request that the user has signed.
        signed: Option<Arc<Signed>>,
    },
    /// Note the outcome of an order that was checked and accepted.
    OrderEnded {
        /// The number of [`Effect::Judge`].
        number: u64,
        /// That the order was carried out, or the reason why it was not, for a person.
        outcome: Outcome,
    },
    /// Find out whether these programs could be started on this host, and give [`Input::Found`].
    ///
    /// [`Input::Found`]: crate::logic::agent::Input::Found
    FindPrograms {
        /// The deployment.
        deployment: Deployment,
        /// The number of the change that asks. The input has it as well.
        number: u32,
        /// How each program would be started.
        programs: Vec<SpawnOrder>,
    },
    /// Write down that every host has confirmed the end of a deployment. No input waits for this write.
    Settled {
        /// The deployment.
        deployment: Deployment,
    },
    /// Write down which user has stopped everything, or that the stop was released. No input waits for this write.
    KeepEstop {
        /// The number of the write. The answer [`Input::EstopKept`](crate::logic::agent::Input::EstopKept) has the same number.
        number: u64,
        /// The user who has stopped everything; nothing if programs may begin.
        estop: Option<Estop>,
    },
    /// Write down the data that a node needs about a deployment that begins again after a reboot. No input waits for this write.
    Keep(Box<Kept>),
    /// Remove this data from the disk, because the deployment is to end. The answer is
    /// [`Input::Unkept`](crate::logic::agent::Input::Unkept).
    Unkeep {
        /// The deployment.
        deployment: Deployment,
    },
    /// Write all these records to the disk, and remove all other records of this kind.
    KeepAll(Vec<Kept>),
    /// Write these tombstones to the disk, and remove all others.
    KeepTombstones(Vec<Tombstone>),
    /// Send one element of the answer to a call.
    Answer {
        /// The call.
        call: u64,
        /// The next element of the answer.
        answer: Box<Answer>,
    },
    /// Tell a caller that the answer is complete.
    EndAnswers {
        /// The call.
        call: u64,
    },
    /// Answer a call with a program's output.
    Tail {
        /// The call.
        call: u64,
        /// The program that has written the output.
        process: ProcessId,
        /// Whether the answer continues while the program writes more.
        follow: bool,
    },
    /// Answer a call with all output of a deployment's programs, until the deployment is over here.
    TailAll {
        /// The call.
        call: u64,
        /// The deployment.
        deployment: Deployment,
        /// The programs of the deployment on this host: leaf and absolute path.
        programs: Vec<(u32, String)>,
    },
    /// Write a transaction of the node itself into the database. No caller waits for this write.
    WriteDatabase(Box<Commit>),
    /// Let the node leave: nothing is left on this host.
    Leave,
    /// Make the node leave, since another node has its name, and nothing is left on this host.
    Yield {
        /// The reason, for a person.
        why: String,
    },
}

/// The outputs of a machine: effects for the driver, and messages for nodes, which may include this one.
#[derive(Debug)]
pub struct Out<'a> {
    /// The time of the input that is being handled.
    pub now: Time,
    /// The same time on the calendar clock of this host, since 1970. It is only for users: no decision depends on it.
    pub since_1970: Duration,
    /// The effects for the driver.
    pub effects: &'a mut Vec<Effect>,
    /// The messages, each with the name of its node.
    pub messages: &'a mut Vec<(String, Message)>,
}

impl Out<'_> {
    /// Sends a message to a node, which may be this one.
    pub fn send(&mut self, to: &str, message: Message) {
        self.messages.push((to.to_owned(), message));
    }

    /// Sends one element of the answer to a call.
    pub fn answer(&mut self, call: u64, answer: Answer) {
        self.effects.push(Effect::Answer { call, answer: Box::new(answer) });
    }

    /// Sends the last element of the answer to a call.
    pub fn answer_last(&mut self, call: u64, answer: Answer) {
        self.answer(call, answer);
        self.effects.push(Effect::EndAnswers { call });
    }
}

/// Returns the earlier of two deadlines; either may be absent.
pub fn earliest(a: Option<Time>, b: Option<Time>) -> Option<Time> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}
