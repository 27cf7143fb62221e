//! The activity that a person means with an order, and whether it takes the order.

use crate::logic::executer::group_host;
use crate::logic::protocol::{ActivityInput, TellRequest};
use language::plan::{Expression, Notice, Plan, StateChart};

/// The longest text of a message, in bytes.
const TEXT_MAX: usize = 4096;

/// An activity of a plan.
pub(super) struct MeantActivity {
    /// The number of its group.
    pub(super) group: u32,
    pub(super) path: String,
    /// The host of its supervisor.
    pub(super) host: String,
}

/// Finds the activity that an order is for.
///
/// # Errors
/// Why there is no such activity, or why it does not take the order.
pub(super) fn meant(plan: &Plan, request: &TellRequest) -> Result<MeantActivity, String> {
    let (group, path, chart) = activity(plan, &request.process)?;
    check(chart, &path, &request.order)?;
    let host = group_host(plan, group).unwrap_or_default().to_owned();
    Ok(MeantActivity { group, path, host })
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
