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
    /// Each program begins as soon as it can.
    #[default]
    AtOnce,
    /// All programs begin at one moment, as exactly as the clocks of the hosts can be compared.
    Aligned,
}

/// A message of a participating host to the home of a deployment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToCoordinator {
    /// Every program has started, and has reported its place.
    Prepared {
        /// One entry for each leaf on the host.
        facts: Vec<LeafFacts>,
        /// Identifies the machine and its network. Programs with the same value can reach each other's Unix sockets.
        machine: String,
    },
    /// The host cannot take part. All reasons are given at once.
    Refused {
        /// Sentences for a person.
        reasons: Vec<String>,
    },
    /// Every link of the host's programs is up. All wires are closed.
    Connected,
    /// Nothing of the deployment is left on the host.
    Released,
    /// `main` has ended.
    MainEnded {
        /// How it ended.
        ending: Ending,
    },
    /// A change of a process, for users who watch.
    Happened {
        /// The process.
        target: Target,
        /// The change.
        change: Change,
    },
    /// Everything was done to end the deployment on the host, but something of it may be left.
    Unconfirmed,
    /// The answer to a step of a change.
    Change(ChangeReply),
    /// The steps of a supervisor, for the record.
    Stepped {
        /// The group of the supervisor.
        group: u32,
        /// The number of the first of these steps. Steps are counted from 0.
        number: u64,
        /// The events and the supervisor's commands.
        steps: Vec<StepRecord>,
        /// How often the event actions of the group were changed before these steps.
        changes: u32,
    },
    /// The result of [`ToParticipant::SwitchSets`].
    SetsSwitched {
        /// The number of the call in the order.
        call: u64,
        /// The result of the switch, or the reason why nothing was switched.
        switched: Result<SetsSwitched, String>,
    },
    /// The answer to [`ToParticipant::ReadClock`].
    ClockRead {
        /// The time in the question.
        asked: Time,
        /// The time of the host's monotonic clock.
        shown: Time,
    },
    /// When the host received [`ToParticipant::GoAt`] or next looked at its clock, the moment was already over.
    BeganLate {
        /// How late the host was.
        by: Duration,
    },
    /// The answer of an activity to [`ToParticipant::Tell`].
    Answered {
        /// The number of the call in the order.
        call: u64,
        /// The reaction of the activity, or the reason why it has not accepted the order.
        taken: Result<Taken, String>,
    },
}

/// A message of the home of a deployment, or of one of its supervisors, to a participating host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToParticipant {
    /// Start all of your programs. They stay idle.
    Prepare {
        /// The whole plan of the deployment.
        plan: Plan,
    },
    /// Make the links.
    Connect {
        /// The facts of every leaf of the deployment.
        facts: Vec<LeafFacts>,
        /// The machine of each host, in the order of the hosts in the plan.
        machines: Vec<String>,
    },
    /// The whole tree is confirmed. From now on, activations may come.
    Go,
    /// End every program and forget the deployment.
    Release,
    /// Run a process.
    Activate {
        /// The process.
        target: Target,
        /// The number of the activation; its end repeats it.
        activation: u32,
        /// The value for its `Init`.
        value: Vec<u8>,
        /// How long ago its supervisor decided it.
        ago: Duration,
    },
    /// Stop a process.
    Stop {
        /// The process.
        target: Target,
        /// The number of the activation.
        activation: u32,
    },
    /// A process that you supervise has ended. There is exactly one such message for each activation.
    Ended {
        /// The process.
        target: Target,
        /// The number of the activation.
        activation: u32,
        /// How it ended.
        ending: Ending,
    },
    /// Open or close wires of your producers.
    Switch {
        /// Indices into `Plan::wires`.
        wires: Vec<u32>,
        /// Whether to open or to close the wires.
        open: bool,
        /// The group whose supervisor asks. The answer repeats it.
        group: u32,
        /// The supervisor's number for this order. The answer repeats it.
        generation: u64,
    },
    /// The wires that one of your groups has asked for are switched.
    Switched {
        /// The group whose supervisor gave the order.
        group: u32,
        /// The generation of the order.
        generation: u64,
    },
    /// A program of the sender was restarted, and programs of yours dial it.
    Moved {
        /// The facts of the new program.
        facts: LeafFacts,
    },
    /// A group that you supervise has ended, or ends with the next message. Lost hosts may still do something for it,
    /// so its resources are not free. The latest of these messages is used.
    Loose {
        /// The group.
        target: Target,
        /// The lost hosts; none once everything is known.
        hosts: Vec<String>,
    },
    /// Nothing of the deployment is left on a host that was lost or has left.
    Cleared {
        /// The host.
        host: String,
    },
    /// A step of a change while it runs.
    Change(ChangeOrder),
    /// The program of a process that you supervise has died and is being restarted.
    Restarted {
        /// The process.
        target: Target,
        /// The cause of its death.
        cause: FailureCause,
    },
    /// Restart these programs of yours, together with a program that has died.
    Renew {
        /// Indices into `Plan::leaves`.
        leaves: Vec<u32>,
        /// The absolute path of the program that has died.
        with: String,
    },
    /// Start all of your programs again. They stay idle. You were lost or have left, and nothing of the deployment is left on your host.
    Rejoin {
        /// The whole present plan of the deployment.
        plan: Plan,
        /// How many times hosts have rejoined this deployment, counted from 1. Your supervisors number their orders
        /// from this number on. So an answer from before you were lost is not mistaken for a new answer.
        number: u32,
        /// The time since GO at the home.
        since_go: Duration,
    },
    /// The programs of a host run again. Open the wires of your programs to that host again.
    Reopen {
        /// The host.
        host: String,
    },
    /// An order that starts something, with the request of a user. Nodes in a team accept such an order only in this form.
    Ordered(Box<Ordered>),
    /// Flip wires of your producers. Each producer switches all of its wires between two values. Answered by `Switched`.
    Flip {
        /// The group whose supervisor asks. The answer repeats it.
        group: u32,
        /// The supervisor's number for this order. The answer repeats it.
        generation: u64,
        /// The wires to flip.
        flip: Flip,
    },
    /// Tell a program of yours to expect a switch of its inputs. Answered by `Expecting`, and then by `Taken`.
    Expect {
        /// The group whose supervisor asks.
        group: u32,
        /// The program.
        leaf: u32,
        /// Its inputs.
        expect: Expect,
    },
    /// A program expects a switch that one of your groups has asked for.
    Expecting {
        /// The group.
        group: u32,
        /// The program.
        leaf: u32,
        /// The number of the switch.
        generation: u64,
    },
    /// A program has completed a switch that one of your groups has asked for, or no longer waits for it.
    Taken {
        /// The group.
        group: u32,
        /// The program.
        leaf: u32,
        /// The number of the switch.
        generation: u64,
        /// How many values were sent over closed wires and have not arrived.
        lost: u64,
        /// How many values were dropped because they came too late.
        late: u64,
        /// Wires on which nothing arrived in time.
        missing: Vec<u32>,
    },
    /// Switch a running member to other connection sets that it has.
    SwitchSets {
        /// The group.
        group: u32,
        /// The member.
        slot: u32,
        /// Indices of the sets that should be open.
        sets: Vec<u32>,
        /// The number of the call; the answer repeats it.
        call: u64,
    },
    /// The same as `Expect`. When all values from before the switch have been processed, the program also flips its own outputs.
    ExpectAnd {
        /// The group whose supervisor asks.
        group: u32,
        /// The program.
        leaf: u32,
        /// Its inputs.
        expect: Expect,
        /// The switch of its outputs. Wires that are only opened are open before the first calculation after the switch.
        then: Flip,
    },
    /// Let a program of yours replace another program, which runs until then. Answered by `Succeeding`.
    Succeed {
        /// The group whose supervisor asks.
        group: u32,
        /// The program.
        leaf: u32,
        /// The activation of the other program.
        activation: u32,
        /// The value for its `Init`.
        value: Vec<u8>,
    },
    /// A program is initialised and runs beside its predecessor.
    Succeeding {
        /// The group.
        group: u32,
        /// The program.
        leaf: u32,
        /// Whether the predecessor still exists, so that it can hand over its connections.
        is_handed_over: bool,
    },
    /// Report your monotonic clock, for an aligned start. Nothing is activated before `GoAt` or `Go`. Answered by `ClockRead`.
    ReadClock {
        /// When the home asks, on its own clock. The answer repeats it.
        asked: Time,
    },
    /// The same as `Go`. Also, programs that are activated before a certain moment begin at that moment.
    GoAt {
        /// The moment, on the clock of the receiver.
        start: Time,
    },
    /// An activity that you supervise gets a message or a notice. An activity that does not run ignores it.
    Tell {
        /// The group of the activity.
        group: u32,
        /// The message or the notice.
        told: ActivityInput,
        /// The user who gives the order. Nothing if a node has noticed the event itself.
        by: Option<String>,
        /// The call that waits for [`ToCoordinator::Answered`]; nothing if no user waits.
        call: Option<u64>,
    },
    /// The consumer of these wires was restarted. Send it their last values again.
    Repeat {
        /// Numbers of latched wires.
        wires: Vec<u32>,
    },
}

/// The reaction of an activity to an order that it has accepted.
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
    /// An order to suspend or to resume, or a notice about a host, a member or a parameter.
    Notice(Notice),
    /// An answer to a question.
    Answer {
        /// The number of the question. The supervisor counts questions from 1.
        question: u64,
        /// The answer.
        option: String,
    },
}
