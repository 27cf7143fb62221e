//! The effects of a node's machines, and the types that they share.

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
    /// Whether the plan has had another program of this path, which may still be there.
    pub is_next: bool,
    /// Executable and its arguments.
    pub command: Vec<String>,
    /// Which of its words are secrets.
    pub secrets: Vec<SecretArgument>,
    /// The devices that it claims.
    pub devices: Vec<String>,
    /// Whether it speaks the control protocol; a plain program is held before `exec` until it is activated.
    pub kind: LeafKind,
    /// Whether it is a service: it never ends by itself.
    pub is_service: bool,
    /// Its policy: the resources it may use, and the action on loss of its agent.
    pub policy: Policy,
    /// The keys of the database that it is connected with.
    pub keys: Vec<KeyBinding>,
    /// Its variables and its folder.
    pub environment: Environment,
}

impl SpawnOrder {
    /// Returns the name by which the program introduces itself: its path, followed by its number if another program may
    /// have the same path.
    pub fn word(&self) -> String {
        if self.is_next { format!("{}#{}", self.path, self.process.leaf) } else { self.path.clone() }
    }
}

/// A word of a command that is a secret of the database. The value is not held here: it is looked up each time the
/// program is started.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SecretArgument {
    /// Which word of the command; the path of a file with the value is appended to it.
    pub word: u32,
    /// The key in the database.
    pub key: String,
}

/// An effect of a machine. The driver carries effects out in order.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Send a frame to another node.
    Transmit {
        /// Name of the node.
        to: String,
        /// The frame.
        frame: Box<Frame>,
    },
    /// Ask other nodes whether they are there.
    Ping {
        /// Numbers the question.
        round: u64,
        /// The names of the nodes asked; none for all.
        only: Option<BTreeSet<String>>,
        /// Whether some may not know yet who asks.
        shows: bool,
    },
    /// Tell another node of this one's name which deployments run here.
    Greet(Box<Namesake>),
    /// Tell the nodes that ask from now on which boot has their name.
    Holders(BTreeMap<String, u64>),
    /// From now on, send the beats of this node to these hosts only: they notice a cut by missing beats.
    Beat(BTreeSet<String>),
    /// Tell users and other listeners about a change of another node.
    Peer(Change),
    /// Start a program under a shim.
    Spawn(Box<SpawnOrder>),
    /// Tell a shim.
    Shim {
        /// The program.
        process: ProcessId,
        /// The order.
        order: ShimOrder,
    },
    /// Kill a shim that has not ended its program in time: it may be suspended. Everything it leaves is ended, and
    /// reported as gone once nothing of it is there any more.
    KillShim {
        /// The program.
        process: ProcessId,
    },
    /// Tell a controller.
    Control {
        /// The program.
        process: ProcessId,
        /// The order.
        order: Order,
    },
    /// Nothing runs any more: close the channels of a program, keep its output until the deployment is removed.
    CloseProcess {
        /// The program.
        process: ProcessId,
    },
    /// A deployment is over on this host: close its socket, and keep its output for a while.
    CloseDeployment {
        /// The deployment.
        deployment: Deployment,
    },
    /// Write down the epoch of a deployment, and give [`Input::Committed`] when it is on the disk or cannot be. Nothing
    /// waits in the meantime.
    ///
    /// [`Input::Committed`]: crate::logic::agent::Input::Committed
    PersistEpoch {
        /// The deployment.
        deployment: Deployment,
        /// The hosts that take part.
        hosts: Vec<String>,
    },
    /// Check whether a user has signed the order of another node, and give [`Input::Judged`]. By then, the disk has the record
    /// that the order was accepted.
    ///
    /// [`Input::Judged`]: crate::logic::agent::Input::Judged
    Judge {
        /// Echoed.
        number: u64,
        /// The deployment that it is about.
        deployment: Deployment,
        /// The node that orders it.
        from: String,
        /// The order.
        order: Box<ToParticipant>,
    },
    /// Check whether the signer of a deployment of this home may still have it, and give [`Input::Resumable`]: it is to
    /// be resumed after a reboot.
    ///
    /// [`Input::Resumable`]: crate::logic::agent::Input::Resumable
    JudgeResumed {
        /// The deployment that ran before the reboot.
        deployment: Deployment,
        /// The request that the user has signed.
        signed: Option<Arc<Signed>>,
    },
    /// Note the outcome of an order that was judged and accepted.
    OrderEnded {
        /// As judged.
        number: u64,
        /// Whether it was done, or why not, for a person.
        outcome: Outcome,
    },
    /// See whether these programs could be started on this host, and give [`Input::Found`].
    ///
    /// [`Input::Found`]: crate::logic::agent::Input::Found
    FindPrograms {
        /// The deployment.
        deployment: Deployment,
        /// The change that asks, echoed.
        number: u32,
        /// How each would be started.
        programs: Vec<SpawnOrder>,
    },
    /// Write down that every host has confirmed the end of a deployment. No input waits for it.
    Settled {
        /// The deployment.
        deployment: Deployment,
    },
    /// Write down that everything is stopped, and by which user, or that the stop was released. No input waits for it.
    KeepEstop {
        /// Numbers the write; answered by [`Input::EstopKept`](crate::logic::agent::Input::EstopKept).
        number: u64,
        /// The user who has stopped everything; none lets programs begin.
        estop: Option<Estop>,
    },
    /// Write down the data that a node needs about a deployment that begins after a reboot. No input waits for it.
    Keep(Box<Kept>),
    /// Remove this data from the disk: the deployment is to end. Answered by [`Input::Unkept`](crate::logic::agent::Input::Unkept).
    Unkeep {
        /// The deployment.
        deployment: Deployment,
    },
    /// Have all these records on the disk, and no others of their kind.
    KeepAll(Vec<Kept>),
    /// Have these tombstones on the disk, and no others.
    KeepTombstones(Vec<Tombstone>),
    /// One element of the answer to a call.
    Answer {
        /// The call.
        call: u64,
        /// The next element of the answer.
        answer: Box<Answer>,
    },
    /// The answer is complete.
    EndAnswers {
        /// The call.
        call: u64,
    },
    /// Answer a call with a program's output.
    Tail {
        /// The call.
        call: u64,
        /// Whose output.
        process: ProcessId,
        /// Goes on as output comes.
        follow: bool,
    },
    /// Answer a call with all that the programs of a deployment write, until it is over here.
    TailAll {
        /// The call.
        call: u64,
        /// The deployment.
        deployment: Deployment,
        /// Its programs here: leaf and absolute path.
        programs: Vec<(u32, String)>,
    },
    /// Write a transaction of the node itself into the database. No caller waits for it.
    WriteDatabase(Box<Commit>),
    /// Nothing is left on this host: the node may leave.
    Leave,
    /// The node has to leave, since another one has its name, and nothing is left on this host.
    Yield {
        /// Why, for a person.
        why: String,
    },
}

/// The outputs of a machine: effects for the driver, messages for nodes (this one included).
#[derive(Debug)]
pub struct Out<'a> {
    /// The time of the input being handled.
    pub now: Time,
    /// The same on the calendar clock of this host, since 1970: only for users, nothing is decided by it.
    pub since_1970: Duration,
    /// For the driver.
    pub effects: &'a mut Vec<Effect>,
    /// For the nodes named.
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

/// Returns the earlier of two deadlines.
pub fn earliest(a: Option<Time>, b: Option<Time>) -> Option<Time> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}
