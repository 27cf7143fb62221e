//! People who give a message to an activity: finds the activity that they mean, and passes the message on.

use super::{Coordinator, Phase};
use crate::logic::effect::Out;
use crate::logic::executer::group_host;
use crate::logic::protocol::{TellRequest, ToParticipant};
use language::plan::{Expression, Plan, StateChart};

/// The longest text of a message, in bytes.
const TEXT_MAX: usize = 4096;

impl Coordinator {
    /// Passes a message on to the supervisor of an activity; returns the path of the activity.
    ///
    /// # Errors
    /// The sentence says why no activity takes the message.
    pub fn tell(&self, request: &TellRequest, out: &mut Out<'_>) -> Result<String, String> {
        let mission = &self.mission;
        if !matches!(self.phase, Phase::Running) {
            return Err(format!("`{}` does not run", mission.deployment.name));
        }
        if request.text.len() > TEXT_MAX {
            return Err(format!("a message has at most {TEXT_MAX} bytes"));
        }
        let (group, path, chart) = activity(&mission.plan, &request.process)?;
        if !chart.inputs.contains(&request.port) {
            return Err(match chart.inputs.as_slice() {
                [] => format!("`{path}` has no input ports"),
                inputs => format!("`{path}` has no input port `{}`; it has `{}`", request.port, inputs.join("`, `")),
            });
        }
        let host = group_host(&mission.plan, group).unwrap_or_default();
        if mission.hosts.get(host).is_some_and(|part| part.has_failed()) {
            return Err(format!("host `{host}`, which runs `{path}`, is lost"));
        }
        let TellRequest { port, text, priority, .. } = request.clone();
        out.send(host, mission.deployment.to_participant(ToParticipant::Tell { group, port, text, priority }));
        Ok(path)
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
