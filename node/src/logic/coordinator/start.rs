//! The start of a deployment at its home: every host prepares, every host connects, then GO.
//!
//! ```text
//! Preparing ─all prepared─▶ Connecting ─all connected─▶ GO
//!                               └─ with `--aligned` ─▶ ReadingClocks ─all clocks are read─▶ GO
//! each ─ refused, late, host failed, stopped ─▶ refused
//! ```
//! GO waits until the epoch is on the disk. So a restarted node never assigns an epoch that has already run.

use super::aligned::{Aligned, Clocks, Exchange};
use super::mission::Mission;
use super::{CONNECT_WITHIN, PREPARE_WITHIN, REASONS_WITHIN};
use crate::logic::effect::Out;
use crate::logic::instance::watchdog::{READY_WITHIN, ready_within};
use crate::logic::protocol::{Report, StartMode, ToCoordinator, ToParticipant};
use comms::logic::time::Time;
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::time::Duration;

/// How long the home's node may be gone. After a longer absence, a deployment that has not begun is refused. A host may
/// be missing for the same time.
const AWAY_MAX: Duration = Duration::from_secs(5);
/// How long all hosts have to tell their clocks.
const READ_WITHIN: Duration = Duration::from_secs(10);

/// Returns how long hosts have to start their programs: the plan may give a program more time than usual.
pub(super) fn prepare_within(plan: &Plan) -> Duration {
    let slowest = plan.leaves.iter().map(|leaf| ready_within(&leaf.policy)).max().unwrap_or_default();
    PREPARE_WITHIN + slowest.saturating_sub(READY_WITHIN)
}

/// A deployment that has not begun to run.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Start {
    step: Step,
    begun: Time,
    pub(super) until: Time,
    /// The hosts that have not finished the step.
    awaited: BTreeSet<String>,
    /// Whether the epoch is on the disk.
    is_committed: bool,
    /// Why the deployment does not begin.
    pub(super) reasons: Vec<String>,
    /// The clocks of the other hosts; only for an aligned start, in which the first step begins everywhere at one moment.
    clocks: Option<Clocks>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Step {
    Preparing,
    Connecting,
    ReadingClocks,
}

/// The next step of the home.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    Wait,
    Go,
    Refuse,
}

impl Start {
    /// Has every host prepare.
    pub(super) fn new(mission: &Mission, start: StartMode, out: &mut Out<'_>) -> Self {
        for host in &mission.plan.hosts {
            mission.tell(host, ToParticipant::Prepare { plan: (*mission.plan).clone() }, out);
        }
        let is_aligned = start == StartMode::Aligned && mission.plan.hosts.len() > 1;
        Self {
            step: Step::Preparing,
            begun: out.now,
            until: out.now + prepare_within(&mission.plan),
            awaited: mission.hosts.keys().cloned().collect(),
            is_committed: false,
            reasons: Vec::new(),
            clocks: is_aligned.then(Clocks::default),
        }
    }

    /// Takes a message of a host. Returns the message as an error if it is not about the start.
    pub(super) fn receive(
        &mut self,
        mission: &mut Mission,
        message: ToCoordinator,
        from: &str,
        out: &mut Out<'_>,
    ) -> Result<Next, ToCoordinator> {
        match (message, self.step) {
            (ToCoordinator::Prepared { facts, machine }, Step::Preparing) => {
                self.awaited.remove(from);
                mission.register(from, facts, &machine, out);
            }
            (ToCoordinator::Connected, Step::Connecting) => {
                self.awaited.remove(from);
                mission.report(Report::Connected { host: from.to_owned() }, out);
            }
            (ToCoordinator::ClockRead { asked, shown }, Step::ReadingClocks) if self.awaited.contains(from) => {
                let read = Exchange { asked, shown, round_trip: out.now - asked };
                if self.clocks.as_mut().is_none_or(|clocks| clocks.read(from, read)) {
                    self.awaited.remove(from);
                } else {
                    ask_clock(mission, from, out);
                }
            }
            (ToCoordinator::Refused { reasons }, _) => return Ok(self.refused(from, reasons, out.now)),
            (message, _) => return Err(message),
        }
        Ok(self.next(mission, out))
    }

    /// Notes that the epoch is on the disk.
    pub(super) fn committed(&mut self, mission: &Mission, out: &mut Out<'_>) -> Next {
        self.is_committed = true;
        self.next(mission, out)
    }

    /// Continues with the next step when all hosts have finished this one.
    fn next(&mut self, mission: &Mission, out: &mut Out<'_>) -> Next {
        match self.step {
            _ if !self.awaited.is_empty() => {}
            Step::Preparing if !self.reasons.is_empty() => return Next::Refuse,
            Step::Preparing => {
                (self.step, self.until) = (Step::Connecting, out.now + CONNECT_WITHIN);
                self.awaited = mission.hosts.keys().cloned().collect();
                self.awaited.iter().for_each(|host| mission.have_connected(host, out));
            }
            Step::Connecting | Step::ReadingClocks if !self.is_committed => {}
            Step::Connecting if self.clocks.is_some() => {
                (self.step, self.until) = (Step::ReadingClocks, out.now + READ_WITHIN);
                let others = mission.hosts.keys().filter(|host| Some(host.as_str()) != mission.plan.home());
                self.awaited = others.cloned().collect();
                self.awaited.iter().for_each(|host| ask_clock(mission, host, out));
            }
            Step::Connecting | Step::ReadingClocks => return Next::Go,
        }
        Next::Wait
    }

    /// Takes the refusal of a host. The other hosts get a moment to add their reasons.
    pub(super) fn refused(&mut self, from: &str, reasons: Vec<String>, now: Time) -> Next {
        self.reasons.extend(reasons);
        self.awaited.remove(from);
        self.until = self.until.min(now + REASONS_WITHIN);
        if self.awaited.is_empty() { Next::Refuse } else { Next::Wait }
    }

    /// Gives the reasons why the time limit of the step was missed.
    pub(super) fn late(&mut self) {
        if self.reasons.is_empty() {
            self.reasons.extend(self.awaited.iter().map(|host| format!("host `{host}` did not answer in time")));
            if self.awaited.is_empty() {
                self.reasons.push("the disk of its home did not take its epoch in time".to_owned());
            }
        }
    }

    /// Notes that the node was gone and could not receive any answer. After a long absence the user was told that the
    /// deployment is lost, so it must not begin.
    pub(super) fn adopted(&mut self, away: Duration) {
        if away > AWAY_MAX {
            self.reasons.push(format!("its home was gone for {} s before it had begun", away.as_secs()));
            self.until = Time::ZERO;
        } else {
            self.until = self.until + away;
        }
    }

    /// Begins: says GO to all hosts.
    pub(super) fn go(&self, mission: &mut Mission, out: &mut Out<'_>) {
        let aligned = self.clocks.as_ref().map(|clocks| clocks.start(mission.plan.home(), out.now));
        if let Some(Aligned { lead, within, .. }) = aligned {
            mission.report(Report::Aligned { lead, within }, out);
        }
        mission.go(self.begun, &aligned.map(|aligned| aligned.on_hosts).unwrap_or_default(), out);
    }
}

fn ask_clock(mission: &Mission, host: &str, out: &mut Out<'_>) {
    mission.tell(host, ToParticipant::ReadClock { asked: out.now }, out);
}
