//! Messages between the home of a deployment, its hosts and its supervisors.

use super::{Change, ChangeOrder, ChangeReply, Ending, FailureCause, LeafFacts, Ordered, SetsSwitched, Target};
use comms::logic::switch::{Expect, Flip};
use comms::logic::time::Time;
use language::algebra::StepRecord;
use language::plan::{Notice, Plan};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// When the programs of the first step of a deployment begin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum StartMode {
    /// Each as soon as it can.
    #[default]
    AtOnce,
    /// All at one moment, as exactly as the clocks of the hosts can be compared.
    Aligned,
}

/// From a host that takes part in a deployment to its home.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToCoordinator {
    /// Every program is started and has told where it is.
    Prepared {
        /// One entry for each leaf of the host.
        facts: Vec<LeafFacts>,
        /// Names the machine and its network: programs with the same one reach each other's Unix sockets.
        machine: String,
    },
    /// Not possible, with every reason at once.
    Refused {
        /// Sentences for a person.
        reasons: Vec<String>,
    },
    /// Every link of the host's programs stands, all closed.
    Connected,
    /// Nothing of it is left here.
    Released,
    /// `main` has ended.
    MainEnded {
        /// How it ended.
        ending: Ending,
    },
    /// For the users who watch.
    Happened {
        /// The process.
        target: Target,
        /// The change.
        change: Change,
    },
    /// Everything was done to end it here, and something may be left.
    Unconfirmed,
    /// To a step of a change while it runs.
    Change(ChangeReply),
    /// For the record: the reaction of a supervisor to some events.
    Stepped {
        /// Its group.
        group: u32,
        /// The number of the first step, from 0 on.
        number: u64,
        /// The events, and the supervisor's commands.
        steps: Vec<StepRecord>,
    },
    /// The result of [`ToParticipant::SwitchSets`].
    SetsSwitched {
        /// As ordered.
        call: u64,
        /// How it went, or why nothing was switched.
        switched: Result<SetsSwitched, String>,
    },
    /// To [`ToParticipant::ReadClock`].
    ClockRead {
        /// As asked.
        asked: Time,
        /// The time of the host's monotonic clock.
        shown: Time,
    },
    /// The moment of [`ToParticipant::GoAt`] was over when the host heard of it, or looked at its clock again.
    BeganLate {
        /// By how much.
        by: Duration,
    },
    /// The answer of an activity to [`ToParticipant::Tell`].
    Answered {
        /// As ordered.
        call: u64,
        /// The reaction of the activity, or why the activity has not taken the order.
        taken: Result<Taken, String>,
    },
}

/// From the home of a deployment, or a supervisor of it, to a host that takes part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToParticipant {
    /// Start every program of yours, idle.
    Prepare {
        /// The whole plan of the deployment.
        plan: Plan,
    },
    /// Make the links.
    Connect {
        /// Facts of every leaf of the deployment.
        facts: Vec<LeafFacts>,
        /// The machine of each host of the plan, in the plan's order.
        machines: Vec<String>,
    },
    /// The whole tree is confirmed; from now on activations may come.
    Go,
    /// End every program and forget the deployment.
    Release,
    /// Run a process.
    Activate {
        /// The process.
        target: Target,
        /// Echoed in the ending.
        activation: u32,
        /// For its `Init`.
        value: Vec<u8>,
    },
    /// Stop a process.
    Stop {
        /// The process.
        target: Target,
        /// The number of the activation.
        activation: u32,
    },
    /// A process that you supervise has ended: exactly one for each activation.
    Ended {
        /// The process.
        target: Target,
        /// The number of the activation.
        activation: u32,
        /// How it ended.
        ending: Ending,
    },
    /// Open or close wires whose producers are yours.
    Switch {
        /// Indices into `Plan::wires`.
        wires: Vec<u32>,
        /// Open or close.
        open: bool,
        /// The group whose supervisor asks, and its number for this, echoed.
        group: u32,
        /// The generation of the order.
        generation: u64,
    },
    /// The wires that a group of yours asked for are switched.
    Switched {
        /// The group whose supervisor gave the order.
        group: u32,
        /// The generation of the order.
        generation: u64,
    },
    /// A program of the sender was started again: programs of yours dial it.
    Moved {
        /// The facts of the new program.
        facts: LeafFacts,
    },
    /// A group that you supervise has ended, or ends with the next message, and lost hosts may still do something for
    /// it: its resources are not free. The latest message counts.
    Loose {
        /// The group.
        target: Target,
        /// The hosts; none when all is known.
        hosts: Vec<String>,
    },
    /// Nothing of the deployment is left on a host that was lost, or has left.
    Cleared {
        /// The host.
        host: String,
    },
    /// A step of a change while it runs.
    Change(ChangeOrder),
    /// The program of a process that you supervise has died, and is started again.
    Restarted {
        /// Which process.
        target: Target,
        /// The cause of its death.
        cause: FailureCause,
    },
    /// Start these programs of yours again, together with one that has died.
    Renew {
        /// Indices into `Plan::leaves`.
        leaves: Vec<u32>,
        /// Absolute path of the dead one.
        with: String,
    },
    /// Start every program of yours again, idle: you were lost, or have left, and nothing of the deployment is left at yours.
    Rejoin {
        /// The whole present plan of the deployment.
        plan: Plan,
        /// How many times this has been done for the deployment, from 1. Your supervisors number their orders from it
        /// on, so that an answer that was on its way when you were lost is not mistaken for a new one.
        number: u32,
        /// Since GO at the home.
        since_go: Duration,
    },
    /// A host has its programs up again: open the wires again that they produce.
    Reopen {
        /// The host.
        host: String,
    },
    /// An order that starts something, with the request of a user: nodes in a team take such an order only in this form.
    Ordered(Box<Ordered>),
    /// Flip wires whose producers are yours, each producer all its wires between two values. Answered by `Switched`.
    Flip {
        /// The group whose supervisor asks, and its number for this, echoed.
        group: u32,
        /// The generation of the order.
        generation: u64,
        /// The wires.
        flip: Flip,
    },
    /// A program of yours is to expect a switch of its inputs. Answered by `Expecting` and then by `Taken`.
    Expect {
        /// The group whose supervisor asks.
        group: u32,
        /// The program.
        leaf: u32,
        /// Its inputs.
        expect: Expect,
    },
    /// A program expects a switch that a group of yours has asked for.
    Expecting {
        /// The group.
        group: u32,
        /// The program.
        leaf: u32,
        /// The switch.
        generation: u64,
    },
    /// A program has taken a switch that a group of yours has asked for, or no longer waits for it.
    Taken {
        /// The group.
        group: u32,
        /// The program.
        leaf: u32,
        /// The switch.
        generation: u64,
        /// How many values were sent over closed wires, and have not arrived.
        lost: u64,
        /// How many values were dropped since they came too late.
        late: u64,
        /// Wires that nothing was heard of in time.
        missing: Vec<u32>,
    },
    /// Switch a running member to other connection sets of its own.
    SwitchSets {
        /// The group.
        group: u32,
        /// The member.
        slot: u32,
        /// Indices into its sets.
        sets: Vec<u32>,
        /// Echoed.
        call: u64,
    },
    /// Like `Expect`. When all values before the switch have had their calculation, the program flips its own outputs.
    ExpectAnd {
        /// The group whose supervisor asks.
        group: u32,
        /// The program.
        leaf: u32,
        /// Its inputs.
        expect: Expect,
        /// The switch of its outputs. Wires that it only opens are open before the first calculation after the switch.
        then: Flip,
    },
    /// A program of yours is to take the place of another one, which keeps running in the meantime. Answered by
    /// `Succeeding`.
    Succeed {
        /// The group whose supervisor asks.
        group: u32,
        /// The program.
        leaf: u32,
        /// The activation of the other one.
        activation: u32,
        /// For its `Init`.
        value: Vec<u8>,
    },
    /// A program is initialised, and runs beside its predecessor.
    Succeeding {
        /// The group.
        group: u32,
        /// The program.
        leaf: u32,
        /// Whether the predecessor is there, so that it can hand its connections over.
        is_handed_over: bool,
    },
    /// Report your monotonic clock: the start is aligned. Nothing is activated before `GoAt`, or `Go`. Answered by
    /// `ClockRead`.
    ReadClock {
        /// When the home asks, on its own clock; echoed.
        asked: Time,
    },
    /// As `Go`; and programs that are activated before a moment begin at that moment.
    GoAt {
        /// The moment, on the clock of the receiver.
        start: Time,
    },
    /// An activity that you supervise is told of something. An activity that does not run drops it.
    Tell {
        /// The group that is the activity.
        group: u32,
        /// The message or the notice.
        told: ActivityInput,
        /// The user who gives it; none if a node noticed it.
        by: Option<String>,
        /// The call that waits for [`ToCoordinator::Answered`]; none if no user waits.
        call: Option<u64>,
    },
    /// The consumer of these wires was started again: send it their last values.
    Repeat {
        /// Numbers of latched wires.
        wires: Vec<u32>,
    },
}

/// The reaction of an activity to an order that it has taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Taken {
    /// It has reacted.
    Reacted,
    /// The order waits, because a transition waits for a stop.
    Waits,
    /// No transition takes the order in the present states.
    Ignored,
}

/// A message or a notice for an activity.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ActivityInput {
    /// A message at an input port.
    Message {
        /// The input port.
        port: String,
        /// The content.
        text: String,
        /// The priority.
        priority: u8,
    },
    /// An order to suspend or to resume, or news of the surroundings.
    Notice(Notice),
    /// An answer to a question.
    Answer {
        /// The number of the question, counted from 1 by the supervisor.
        question: u64,
        /// The answer.
        option: String,
    },
}
