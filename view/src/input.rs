//! The inputs of the model: the reports of nodes and programs.

use crate::identity::{Fleet, MissionId, RobotId};
use language::plan::Plan;
use node::logic::database::question;
use node::logic::protocol::{Absent, Event, NodeStatus};
use std::collections::BTreeSet;

/// Something that a view has learnt.
#[derive(Clone, Debug)]
pub enum Input {
    /// A node has answered with its status.
    Status {
        /// The nodes that it belongs to.
        fleet: Fleet,
        /// Its answer.
        status: Box<NodeStatus>,
    },
    /// A node has not answered in time.
    Silent {
        /// Its robot.
        robot: RobotId,
        /// Why, for a person.
        why: String,
    },
    /// A node has reported the hosts that do not answer it, and the processes that may run there.
    Absent {
        /// The node that has reported it.
        teller: RobotId,
        /// Its answer.
        absent: Box<Absent>,
    },
    /// All hosts that are known now, whether they answer or not. Other hosts have left.
    Known {
        /// The nodes that know of each other.
        fleet: Fleet,
        /// Their hosts.
        hosts: BTreeSet<String>,
    },
    /// Something has happened in a deployment.
    Event {
        /// The home of the deployment, which has reported the event.
        home: RobotId,
        /// The event.
        event: Box<Event>,
    },
    /// Something has happened to the view itself, for example a stream of events that broke off.
    Note {
        /// The robot that it is about.
        robot: RobotId,
        /// The note, for a person.
        text: String,
    },
    /// The plan of a deployment.
    Plan {
        /// The deployment.
        mission: MissionId,
        /// Its plan.
        plan: Box<Plan>,
    },
    /// The output of a program is sent again from its beginning: the view drops the lines that it already has.
    OutputBegins {
        /// Its deployment.
        mission: MissionId,
        /// The absolute path of its process.
        path: String,
    },
    /// A program has written something.
    Output {
        /// Its deployment.
        mission: MissionId,
        /// The absolute path of its process.
        path: String,
        /// The bytes.
        bytes: Vec<u8>,
    },
    /// The values of an output were counted for a while.
    Measured(Measured),
    /// A database has reported how far other replicas are behind.
    Database {
        /// The nodes that its robot belongs to.
        fleet: Fleet,
        /// Its answer.
        status: Box<question::Status>,
    },
}

/// How often values leave an output.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// The deployment.
    pub mission: MissionId,
    /// The absolute path of the process.
    pub path: String,
    /// The port.
    pub port: String,
    /// Values a second (Hz).
    pub hertz: f64,
}
