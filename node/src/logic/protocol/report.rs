//! The reports of a deployment to its watchers.

use super::{Deployment, Ending, FailureCause};
use comms::logic::control::Dial;
use language::algebra::StepRecord;
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A step in the course of a deployment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Report {
    /// The home node has accepted the deployment.
    Accepted {
        /// The deployment with its name and epoch.
        deployment: Deployment,
    },
    /// Every program of a host has started.
    Prepared {
        /// The host.
        host: String,
        /// How many programs the host has.
        leaves: u32,
    },
    /// Every link of a host is made.
    Connected {
        /// The host.
        host: String,
    },
    /// The whole tree is confirmed and begins to run.
    Go {
        /// The time from PREPARE to GO.
        #[serde(with = "comms::logic::human::seconds")]
        took: Duration,
        /// The programs that publish signals: instance path, address.
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
    /// Nothing was started, or everything was undone.
    Refused {
        /// Sentences for a person.
        reasons: Vec<String>,
    },
    /// The deployment is over. Nothing of it is left on any host that could be reached.
    Finished {
        /// How `main` ended.
        ending: Ending,
        /// Time since GO.
        #[serde(with = "comms::logic::human::seconds")]
        at: Duration,
        /// Hosts that could not confirm that nothing is left.
        unconfirmed: Vec<String>,
    },
    /// After GO: the addresses of the programs with outputs, for callers that record ports.
    Programs {
        /// Instance path and address.
        at: Vec<(String, Dial)>,
    },
    /// The plan was changed while the deployment runs.
    Changed {
        /// The number of changes so far, including this one.
        revision: u32,
        /// The user who made the change.
        by: String,
        /// The changes, one line for each.
        changes: Vec<String>,
    },
    /// A change of the running deployment was refused or undone. The previous programs run.
    Unchanged {
        /// The user who asked for the change.
        by: String,
        /// Sentences for a person.
        reasons: Vec<String>,
    },
    /// A supervisor has taken some steps. Only callers that record the mission get this report.
    Stepped {
        /// Absolute path of the supervisor's group.
        path: String,
        /// The number of the first of these steps. The steps of a supervisor are counted from 0, so a gap shows missing steps.
        number: u64,
        /// The events and the supervisor's commands.
        steps: Vec<StepRecord>,
        /// How often the event actions of the group were changed before these steps.
        changes: u32,
        /// Time since GO at the home node.
        #[serde(with = "comms::logic::human::seconds")]
        at: Duration,
    },
    /// Reports are missing here. The home keeps the first reports and the latest ones.
    Omitted {
        /// How many reports are missing.
        count: u64,
    },
    /// A change applies another plan, or is undone. Later reports refer to this plan. Only callers that follow the
    /// mission get this report.
    Replanned {
        /// The plan. It keeps the numbers of the previous plan.
        plan: Box<Plan>,
    },
    /// Sent just before GO: the programs of the first step begin at one moment.
    Aligned {
        /// The time from GO to this moment.
        #[serde(with = "comms::logic::human::seconds")]
        lead: Duration,
        /// The largest possible time between the starts of two of these programs that the clocks of their hosts can cause.
        #[serde(with = "comms::logic::human::seconds")]
        within: Duration,
    },
    /// A host began its part of the first step after that moment.
    BeganLate {
        /// The host.
        host: String,
        /// How late the host began it.
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
    /// The program of the process died while the process was not active.
    Died(FailureCause),
    /// A program has started.
    Started {
        /// Its process id on its host.
        pid: u32,
    },
    /// The program of the process died and is being restarted.
    Restarting {
        /// The cause of its death.
        cause: FailureCause,
        /// How many times it was restarted recently, including this time.
        count: u32,
    },
    /// A restarted program continues the activation of the previous program.
    Resumed,
    /// The process should be activated, but waits: a lost host may still use a resource that it needs.
    Held {
        /// The resource.
        resource: String,
        /// The host.
        host: String,
    },
    /// A parameter of the process was changed while its program was running.
    Configured {
        /// The parameter.
        parameter: String,
        /// The present value, as a spec writes it. Nothing if the value of the spec is used again.
        value: Option<String>,
    },
    /// The program of the process is ended, and another one takes its place.
    Replacing,
    /// A program that has replaced another was unhealthy, so its predecessor is restarted.
    Reverting {
        /// The cause of the failure.
        cause: FailureCause,
    },
    /// The program of the process is restarted, because another program of its group has died.
    Renewing {
        /// Absolute path of the other program.
        with: String,
    },
    /// The process should be activated, but waits: the end of another process is unconfirmed, and that process may
    /// still use its resources.
    HeldBy {
        /// The resource; empty if the group of both processes uses it.
        resource: String,
        /// Absolute path of the other process.
        by: String,
        /// The host of the other process.
        host: String,
    },
    /// The program could not be stopped with certainty, but it has ended now. Its resources are free.
    EndedLate,
    /// Connection sets of the group were switched, from one set of a consumer to another one.
    Switched(SetsSwitched),
    /// An activity has said, sent or lost something, or asks a question.
    Says {
        /// The report, as a clause that follows the name of the activity.
        text: String,
        /// Whether it is about usual work: a text, or a value that was sent or lost. If there are very many of these,
        /// some may be left out.
        is_routine: bool,
    },
    /// The active states of an activity have changed.
    Entered {
        /// The names of the active states that have no active inner states.
        states: Vec<String>,
    },
}

/// The result of a switch of connection sets.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetsSwitched {
    /// The sets that were closed, each with the path of its owner: `main/hit/force[lbl1]`.
    pub closed: Vec<String>,
    /// The sets that were opened.
    pub opened: Vec<String>,
    /// The time from the order to the last confirmation.
    #[serde(with = "comms::logic::human::seconds")]
    pub took: Duration,
    /// Values that were sent over closed wires and have not arrived, or that found no room while they were held back.
    pub lost: u64,
    /// Values that were dropped because they came over wires that had already been given up.
    pub late: u64,
    /// Absolute paths of programs that have not confirmed in time. The members switch as soon as they can.
    pub unconfirmed: Vec<String>,
}

impl SetsSwitched {
    /// Returns whether every value has arrived in order, and every program has confirmed.
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
    /// If a process waits for its activation, returns the reason, in words that follow its name.
    pub fn held_text(&self) -> Option<String> {
        if let Self::Held { resource, host } = self {
            return Some(format!("waits for `{resource}`: the host `{host}` is lost and may still use it"));
        }
        let Self::HeldBy { resource, by, host } = self else { return None };
        let what = if resource.is_empty() { "the resources of its group".to_owned() } else { format!("`{resource}`") };
        Some(format!(
            "waits for {what}: the stop of `{by}` on `{host}` could not be confirmed, and `{by}` may still use this; to continue, end its \
             program on that host"
        ))
    }
}

/// The end of a reason that says that a host was lost.
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

/// Returns whether a refusal has the reason that a host was lost or could not be reached. Then a later attempt may succeed.
pub fn is_unreached(reasons: &[String]) -> bool {
    reasons.iter().any(|reason| reason.ends_with(UNREACHED) || reason.contains(UNREACHABLE))
}
