//! The inputs of an agent. A log keeps them, so that the agent can be made again.

mod as_line;

use crate::logic::effect::ProcessId;
use crate::logic::link::Frame;
use crate::logic::protocol::{Deployment, Namesake, Pong, Request};
use comms::logic::control::Notice;
use serde::{Deserialize, Serialize};
use shim::protocol::ShimReport;
use std::collections::BTreeSet;
use std::time::Duration;

/// An input of an agent.
#[derive(Debug, Serialize, Deserialize)]
pub enum Input {
    /// A node's token has appeared.
    Appeared {
        /// Its name.
        host: String,
        /// Its boot number.
        boot: u64,
    },
    /// A node's token is gone.
    Vanished {
        /// Its name.
        host: String,
        /// Its boot number.
        boot: u64,
    },
    /// A node asks whether this node is present. The driver has already answered.
    Ping {
        /// Its name.
        host: String,
        /// Its boot number.
        boot: u64,
    },
    /// A node answers that it is present.
    Pong(Box<Pong>),
    /// The report of another node of the same name about its deployments.
    Namesake(Box<Namesake>),
    /// A frame from a node.
    Frame(Box<Frame>),
    /// A call from the command line.
    Call {
        /// Numbers the call.
        call: u64,
        /// The request.
        request: Box<Request>,
    },
    /// The caller has gone away.
    CallGone {
        /// The number of the call.
        call: u64,
    },
    /// A report of a shim, with the end of the program's output.
    Shim {
        /// The program.
        process: ProcessId,
        /// The report.
        #[serde(with = "as_line")]
        report: ShimReport,
        /// The last lines that the program has written, if the report says that it ended.
        output: Vec<String>,
    },
    /// A notice of a controller.
    Control {
        /// The program.
        process: ProcessId,
        /// The notice.
        notice: Notice,
    },
    /// The epoch of a deployment that has its home here is on the disk, or cannot be written.
    Committed {
        /// The deployment.
        deployment: Deployment,
        /// Why it is not on the disk, for a person.
        written: Result<(), String>,
    },
    /// The result of [`Effect::KeepEstop`]: the state is on the disk, or cannot be written.
    ///
    /// [`Effect::KeepEstop`]: crate::logic::effect::Effect::KeepEstop
    EstopKept {
        /// As asked.
        number: u64,
        /// Why it is not on the disk, for a person.
        written: Result<(), String>,
    },
    /// The record named by [`Effect::Unkeep`] was removed from the disk, or cannot be removed.
    ///
    /// [`Effect::Unkeep`]: crate::logic::effect::Effect::Unkeep
    Unkept {
        /// The deployment.
        deployment: Deployment,
        /// Why it is still on the disk, for a person.
        written: Result<(), String>,
    },
    /// The verdict for [`Effect::Judge`]: the order is carried out only if it is signed by a user who may ask for it.
    ///
    /// [`Effect::Judge`]: crate::logic::effect::Effect::Judge
    Judged {
        /// As asked.
        number: u64,
        /// Why not, for a person.
        verdict: Result<(), String>,
    },
    /// The verdict for [`Effect::JudgeResumed`]: the deployment is resumed only if its signer still has permission.
    ///
    /// [`Effect::JudgeResumed`]: crate::logic::effect::Effect::JudgeResumed
    Resumable {
        /// The deployment that ran before the reboot.
        deployment: Deployment,
        /// Why not, for a person.
        verdict: Result<(), String>,
    },
    /// A controller has received changed parameters.
    Configured {
        /// The program.
        process: ProcessId,
        /// Each parameter with its value as a spec spells it, or nothing if the value of the spec is valid again.
        parameters: Vec<(String, Option<String>)>,
    },
    /// The answer to [`Effect::FindPrograms`].
    ///
    /// [`Effect::FindPrograms`]: crate::logic::effect::Effect::FindPrograms
    Found {
        /// The deployment.
        deployment: Deployment,
        /// The change that asks.
        number: u32,
        /// A sentence for each program that cannot be started.
        problems: Vec<String>,
    },
    /// An order did not reach a controller.
    Undelivered {
        /// The program.
        process: ProcessId,
        /// Why, for a person.
        why: String,
    },
    /// This agent was made again from its inputs after its node was killed, and its programs are being reached again.
    Adopted {
        /// How long the agent was gone.
        away: Duration,
        /// The programs that are being reached.
        programs: BTreeSet<ProcessId>,
    },
    /// The shim of such a program was reached, or there is none any more. Its reports have arrived before this.
    Reached {
        /// The program.
        process: ProcessId,
    },
    /// The calendar clock of this host was set, or is reported for the first time. It only affects the times of events
    /// for users.
    Calendar {
        /// The time it showed at [`Time::ZERO`](comms::logic::time::Time::ZERO), since 1970.
        origin: Duration,
    },
    /// The node is to leave: it stops everything that has its home here, and releases everything else.
    Leave,
    /// A deadline may have passed.
    Tick,
}
