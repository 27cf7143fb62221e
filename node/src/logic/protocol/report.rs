//! The reports of a deployment to its watchers.

use super::{Deployment, Ending, FailureCause};
use comms::logic::control::Dial;
use language::algebra::StepRecord;
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A step in the life of a deployment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Report {
    /// The home node took it on.
    Accepted {
        /// Under this name and epoch.
        deployment: Deployment,
    },
    /// A host has every program up.
    Prepared {
        /// The host.
        host: String,
        /// How many programs.
        leaves: u32,
    },
    /// A host has every link made.
    Connected {
        /// The host.
        host: String,
    },
    /// The whole tree is confirmed and running.
    Go {
        /// How long PREPARE to GO took.
        #[serde(with = "comms::logic::human::seconds")]
        took: Duration,
        /// Programs that publish signals: instance path, where to dial.
        signals: Vec<(String, Dial)>,
    },
    /// A process changed.
    Process {
        /// Absolute path.
        path: String,
        /// The change.
        change: Change,
        /// Time since GO at the home node.
        #[serde(with = "comms::logic::human::seconds")]
        at: Duration,
    },
    /// Nothing was started, or everything was taken back.
    Refused {
        /// Sentences for a person.
        reasons: Vec<String>,
    },
    /// Over; nothing of it is left on any host that could be reached.
    Finished {
        /// How `main` ended.
        ending: Ending,
        /// Time since GO.
        #[serde(with = "comms::logic::human::seconds")]
        at: Duration,
        /// Hosts that could not confirm.
        unconfirmed: Vec<String>,
    },
    /// After GO: the addresses of the programs that have outputs, for callers that record their ports.
    Programs {
        /// Instance path, where to dial.
        at: Vec<(String, Dial)>,
    },
    /// Its plan was changed while it runs.
    Changed {
        /// How often it was changed, this time included.
        revision: u32,
        /// The user who wanted it.
        by: String,
        /// The changes, one line each.
        changes: Vec<String>,
    },
    /// A change of the running deployment was refused, or taken back: the previous programs run again.
    Unchanged {
        /// The user who wanted it.
        by: String,
        /// Sentences for a person.
        reasons: Vec<String>,
    },
    /// A supervisor has taken some steps. Only callers that record a mission get this report.
    Stepped {
        /// Absolute path of its group.
        path: String,
        /// The number of the first step of this supervisor, from 0 on: a gap shows missing steps.
        number: u64,
        /// The events, and the supervisor's commands.
        steps: Vec<StepRecord>,
        /// Time since GO at the home node.
        #[serde(with = "comms::logic::human::seconds")]
        at: Duration,
    },
    /// The number of reports that are missing here: the home keeps the first reports and the latest.
    Omitted {
        /// How many.
        count: u64,
    },
    /// A change adopts another plan, or takes it back: later reports refer to this plan. Only callers that follow the
    /// mission hear of it.
    Replanned {
        /// The plan, with the numbers of the previous one.
        plan: Box<Plan>,
    },
    /// Just before GO: the programs of the first step begin at one moment.
    Aligned {
        /// How long after GO.
        #[serde(with = "comms::logic::human::seconds")]
        lead: Duration,
        /// How far apart two of these programs may begin at most, as far as that depends on the clocks of their hosts.
        #[serde(with = "comms::logic::human::seconds")]
        within: Duration,
    },
    /// The part of the first step that a host began after that moment.
    BeganLate {
        /// The host.
        host: String,
        /// By how much.
        #[serde(with = "comms::logic::human::seconds")]
        by: Duration,
    },
}

/// A change of one process that a person may want to see.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Change {
    /// The process was activated.
    Activated,
    /// The process was asked to stop.
    Stopping,
    /// The process ended.
    Ended(Ending),
    /// Its program died while it was not running.
    Died(FailureCause),
    /// A program is up.
    Started {
        /// Its process id on its host.
        pid: u32,
    },
    /// Its program died and is started again.
    Restarting {
        /// The cause of its death.
        cause: FailureCause,
        /// How often it was started again lately, this time included.
        count: u32,
    },
    /// A program that was started again continues the activation of the previous program.
    Resumed,
    /// The process was to be activated, and waits: a lost host may still use a resource that the process takes.
    Held {
        /// The resource.
        resource: String,
        /// The host.
        host: String,
    },
    /// A parameter of it was changed while it was up.
    Configured {
        /// The parameter.
        parameter: String,
        /// The value now, as a spec spells it; none if the value of the spec counts again.
        value: Option<String>,
    },
    /// Its program is ended, and another one takes its place.
    Replacing,
    /// The program that took its place was unhealthy; its predecessor is started again.
    Reverting {
        /// The cause of the failure.
        cause: FailureCause,
    },
    /// Its program is ended and started again, since another program of its group has died.
    Renewing {
        /// Absolute path of the other one.
        with: String,
    },
    /// The process was to be activated, and waits: the end of another process is unconfirmed, and that process may still use
    /// its resources.
    HeldBy {
        /// The resource; empty if it is taken for the group of both.
        resource: String,
        /// Absolute path of the other one.
        by: String,
        /// The host of the other one.
        host: String,
    },
    /// Its program, whose stop could not be confirmed, has ended after all: its resources are free.
    EndedLate,
    /// Connection sets of the group were switched, from one set of a consumer to another.
    Switched(SetsSwitched),
    /// An activity has said, sent or lost something, or asks a question.
    Says {
        /// The report, as a clause behind the name of the activity.
        text: String,
        /// Whether it is about its usual work: a word, or a value that was sent or lost. A flood of these may be thinned.
        is_routine: bool,
    },
    /// The active states of an activity have changed.
    Entered {
        /// The names of the active states without active inner states.
        states: Vec<String>,
    },
}

/// How a switch of connection sets has gone.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetsSwitched {
    /// The sets that were closed, each with the path of its owner: `main/hit/force[lbl1]`.
    pub closed: Vec<String>,
    /// The sets that were opened.
    pub opened: Vec<String>,
    /// From the order to the last confirmation.
    #[serde(with = "comms::logic::human::seconds")]
    pub took: Duration,
    /// Values that were sent over closed wires and have not arrived, or found no room while they were held back.
    pub lost: u64,
    /// Values that were dropped because they came over wires that had been given up.
    pub late: u64,
    /// Absolute paths of programs that have not confirmed in time; they switch once they can.
    pub unconfirmed: Vec<String>,
}

impl SetsSwitched {
    /// Returns whether every value has arrived in its order, and every program has confirmed.
    pub fn is_smooth(&self) -> bool {
        (self.lost, self.late) == (0, 0) && self.unconfirmed.is_empty()
    }

    /// Returns the result of the switch, for a person.
    pub fn text(&self) -> String {
        let list = |sets: &[String]| if sets.is_empty() { "nothing".to_owned() } else { sets.join(", ") };
        let mut text = format!(
            "connections switched from {} to {} in {:.2} ms",
            list(&self.closed),
            list(&self.opened),
            self.took.as_secs_f64() * 1000.0
        );
        for (count, what) in [(self.lost, "lost"), (self.late, "late, and dropped")] {
            if count > 0 {
                text = format!("{text}; {count} {} {what}", if count == 1 { "value" } else { "values" });
            }
        }
        if !self.unconfirmed.is_empty() {
            text = format!("{text}; not confirmed by `{}`", self.unconfirmed.join("`, `"));
        }
        text
    }
}

impl Change {
    /// Returns why a process that was to be activated waits, in words that follow its name.
    pub fn held_text(&self) -> Option<String> {
        if let Self::Held { resource, host } = self {
            return Some(format!("waits for `{resource}`: the host `{host}` is lost and may still use it"));
        }
        let Self::HeldBy { resource, by, host } = self else { return None };
        let what = if resource.is_empty() { "what is taken for its group".to_owned() } else { format!("`{resource}`") };
        Some(format!(
            "waits for {what}: the stop of `{by}` on `{host}` could not be confirmed, and it may still use it; end its \
             program there, then this goes on"
        ))
    }
}

/// The end of a reason that is the loss of a host.
const UNREACHED: &str = "could not be reached any more";

/// Returns the reason that a host was lost.
pub fn unreached(host: &str) -> String {
    format!("host `{host}` {UNREACHED}")
}

const UNREACHABLE: &str = "cannot be reached; start `dca-node";

/// Returns the reason why a deployment with a lost host cannot begin.
pub fn unreachable(host: &str) -> String {
    format!("host `{host}` {UNREACHABLE} --name {host}` on it, in the same team or with `--insecure-lan`")
}

/// Returns whether the reasons of a refusal say that a host was lost, or could not be reached. A later attempt may
/// succeed.
pub fn is_unreached(reasons: &[String]) -> bool {
    reasons.iter().any(|reason| reason.ends_with(UNREACHED) || reason.contains(UNREACHABLE))
}
