//! Orders of people to an activity. The home finds the activity that a person means, and passes on the answer of its supervisor.

use super::mission::Mission;
use crate::logic::effect::Out;
use crate::logic::executer::group_host;
use crate::logic::protocol::{ActivityInput, Answer, Delivery, Taken, TellRequest, ToParticipant};
use comms::logic::time::Time;
use language::plan::{Expression, Notice, Plan, StateChart};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// The longest text of a message, in bytes.
const TEXT_MAX: usize = 4096;
/// How long a supervisor has to confirm an order. The user waits longer than this.
const CONFIRM_WITHIN: Duration = Duration::from_secs(3);
/// How many calls may wait at one time.
const CALLS_MAX: usize = 256;

/// The calls that wait for the answer of an activity.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Orders(BTreeMap<u64, Handed>);

/// An order that was sent to the host of an activity.
#[derive(Debug, Serialize, Deserialize)]
struct Handed {
    path: String,
    host: String,
    until: Time,
}

impl Orders {
    /// Sends an order to the supervisor of an activity; `call` is answered when the supervisor has confirmed the order.
    ///
    /// # Errors
    /// The answer, if the order was sent to no supervisor.
    pub(super) fn give(
        &mut self,
        mission: &Mission,
        call: u64,
        request: &TellRequest,
        out: &mut Out<'_>,
    ) -> Result<(), Delivery> {
        if self.0.len() >= CALLS_MAX {
            return Err(Delivery::Refused(format!("{CALLS_MAX} orders already wait for an answer; try again later")));
        }
        let (group, path, chart) = activity(&mission.plan, &request.process).map_err(Delivery::Refused)?;
        check(chart, &path, &request.order).map_err(Delivery::Refused)?;
        let host = group_host(&mission.plan, group).unwrap_or_default().to_owned();
        if mission.is_lost(&host) {
            return Err(Delivery::Unconfirmed(format!("host `{host}`, which runs `{path}`, is lost")));
        }
        let (told, by) = (request.order.clone(), Some(request.by.clone()));
        mission.tell(&host, ToParticipant::Tell { group, told, by, call: Some(call) }, out);
        self.0.insert(call, Handed { path, host, until: out.now + CONFIRM_WITHIN });
        Ok(())
    }

    /// Passes on the answer of a supervisor.
    pub(super) fn told(&mut self, call: u64, taken: Result<Taken, String>, out: &mut Out<'_>) {
        if let Some(Handed { path, .. }) = self.0.remove(&call) {
            let taken = taken.map(|taken| Delivery::Taken { path, taken });
            out.answer_last(call, Answer::Delivered(taken.unwrap_or_else(Delivery::Refused)));
        }
    }

    /// Returns when [`Orders::tick`] wants to be called.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.0.values().map(|handed| handed.until).min()
    }

    /// Gives up calls whose supervisors do not answer.
    pub(super) fn tick(&mut self, mission: &Mission, out: &mut Out<'_>) {
        let now = out.now;
        self.0.retain(|call, Handed { path, host, until }| {
            let why = if mission.is_lost(host) {
                format!("the order was sent to host `{host}`, which is lost; `{path}` has not confirmed the order")
            } else if *until <= now {
                let within = CONFIRM_WITHIN.as_secs();
                format!(
                    "the order was sent to host `{host}`, and `{path}` has not confirmed it within {within} s; the order may still arrive"
                )
            } else {
                return true;
            };
            out.answer_last(*call, Answer::Delivered(Delivery::Unconfirmed(why)));
            false
        });
    }

    /// Answers all calls because the deployment ends.
    pub(super) fn abandon(&mut self, name: &str, out: &mut Out<'_>) {
        for (call, _) in std::mem::take(&mut self.0) {
            out.answer_last(call, Answer::Delivered(Delivery::Refused(format!("`{name}` ends"))));
        }
    }
}

/// Checks whether an activity takes an order of a person.
fn check(chart: &StateChart, path: &str, order: &ActivityInput) -> Result<(), String> {
    match order {
        ActivityInput::Message { text, .. } if text.len() > TEXT_MAX => {
            Err(format!("a message has at most {TEXT_MAX} bytes"))
        }
        ActivityInput::Message { port, .. } if !chart.inputs.contains(port) => Err(match chart.inputs.as_slice() {
            [] => format!("`{path}` has no input ports"),
            inputs => format!("`{path}` has no input port `{port}`; it has `{}`", inputs.join("`, `")),
        }),
        ActivityInput::Notice(notice @ (Notice::Suspend | Notice::Resume)) if chart.notice(notice).is_none() => {
            Err(format!("`{path}` has no transition `on {notice}`"))
        }
        ActivityInput::Answer { option, .. }
            if chart.questions.iter().all(|question| !question.options.contains(option)) =>
        {
            Err(format!("no question of `{path}` has the answer `{option}`"))
        }
        ActivityInput::Message { .. }
        | ActivityInput::Answer { .. }
        | ActivityInput::Notice(Notice::Suspend | Notice::Resume) => Ok(()),
        ActivityInput::Notice(notice) => Err(format!("people cannot tell an activity of `{notice}`")),
    }
}

/// Finds the only activity whose absolute path is `process`, or ends with `process`.
fn activity<'p>(plan: &'p Plan, process: &str) -> Result<(u32, String, &'p StateChart), String> {
    let live = plan.live_groups();
    let end = format!("/{process}");
    let mut found = Vec::new();
    for (number, group) in (0_u32..).zip(&plan.groups).filter(|(number, _)| live.contains(number)) {
        if let Expression::Chart(chart) = &group.expression
            && (group.path == process || group.path.ends_with(&end))
        {
            found.push((number, group.path.clone(), &**chart));
        }
    }
    match found.as_slice() {
        [_] => found.pop().ok_or_else(String::new),
        [] => Err(format!("`{}` has no activity `{process}`", plan.name)),
        [..] => {
            let paths: Vec<&str> = found.iter().take(4).map(|(_, path, _)| path.as_str()).collect();
            Err(format!("several activities end in `{process}`: {}; give more of the path", paths.join(", ")))
        }
    }
}
