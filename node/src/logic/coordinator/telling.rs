//! Orders of people for an activity: finds the activity that they mean, and passes the order on.

use super::{Coordinator, Phase};
use crate::logic::effect::Out;
use crate::logic::executer::group_host;
use crate::logic::protocol::{ActivityInput, TellRequest, ToParticipant};
use language::plan::{Expression, Notice, Plan, StateChart};

/// The longest text of a message, in bytes.
const TEXT_MAX: usize = 4096;

impl Coordinator {
    /// Passes an order on to the supervisor of an activity; returns the path of the activity.
    ///
    /// # Errors
    /// The sentence says why no activity takes the order.
    pub fn tell(&self, request: &TellRequest, out: &mut Out<'_>) -> Result<String, String> {
        let mission = &self.mission;
        if !matches!(self.phase, Phase::Running) {
            return Err(format!("`{}` does not run", mission.deployment.name));
        }
        let (group, path, chart) = activity(&mission.plan, &request.process)?;
        check(chart, &path, &request.order)?;
        let host = group_host(&mission.plan, group).unwrap_or_default();
        if mission.hosts.get(host).is_some_and(|part| part.has_failed()) {
            return Err(format!("host `{host}`, which runs `{path}`, is lost"));
        }
        let (told, by) = (request.order.clone(), Some(request.by.clone()));
        out.send(host, mission.deployment.to_participant(ToParticipant::Tell { group, told, by }));
        Ok(path)
    }
}

/// Whether an activity takes an order of a person.
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

/// Finds the one activity that is meant by an absolute path or the end of one.
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
