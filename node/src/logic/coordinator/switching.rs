//! Requests of users to switch a process to other connection sets: the home finds the process, and passes on the answer of its
//! supervisor.

use super::mission::Mission;
use crate::logic::effect::Out;
use crate::logic::executer::group_host;
use crate::logic::protocol::{Answer, SetsSwitched, SwitchRequest, ToParticipant};
use comms::logic::time::Time;
use language::plan::{Plan, owned_sets};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// How long a supervisor has to answer. Its three steps may take 2 s each.
const ANSWER_WITHIN: Duration = Duration::from_secs(8);
/// How many calls may wait at one time.
const CALLS_MAX: usize = 64;

/// The calls that wait for a switch, each with its time limit.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Switches(BTreeMap<u64, Time>);

impl Switches {
    /// Orders a supervisor to switch a process; `call` is answered when the supervisor has confirmed the switch.
    ///
    /// # Errors
    /// The reason why the process cannot be switched, for the caller.
    pub(super) fn ask(
        &mut self,
        mission: &Mission,
        call: u64,
        request: &SwitchRequest,
        out: &mut Out<'_>,
    ) -> Result<(), String> {
        if self.0.len() >= CALLS_MAX {
            return Err("too many switches of connections are already in progress; try again later".to_owned());
        }
        let plan = &mission.plan;
        let (group, slot) = member(plan, &request.process)?;
        let host = group_host(plan, group).unwrap_or_default();
        if mission.is_lost(host) {
            return Err(format!("host `{host}`, which supervises `{}`, is lost", request.process));
        }
        let owned = plan.groups.get(group as usize).map(|group| owned_sets(group, slot)).unwrap_or_default();
        let set = |label: &String| {
            let found = owned.iter().find(|(_, owned)| *owned == label).map(|(set, _)| *set);
            found.ok_or_else(|| match &owned.iter().map(|(_, label)| format!("`{label}`")).collect::<Vec<_>>()[..] {
                [] => format!("`{}` has no labelled connection sets", request.process),
                labels => {
                    format!("`{}` has no connection set `{label}`; it has {}", request.process, labels.join(", "))
                }
            })
        };
        let sets = request.labels.iter().map(set).collect::<Result<_, String>>()?;
        mission.tell(host, ToParticipant::SwitchSets { group, slot, sets, call }, out);
        self.0.insert(call, out.now + ANSWER_WITHIN);
        Ok(())
    }

    /// Passes on the answer of a supervisor.
    pub(super) fn switched(&mut self, call: u64, switched: Result<SetsSwitched, String>, out: &mut Out<'_>) {
        if self.0.remove(&call).is_some() {
            out.answer_last(call, Answer::Switched(switched));
        }
    }

    /// Returns when [`Switches::tick`] wants to be called.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.0.values().min().copied()
    }

    /// Gives up calls whose supervisors do not answer.
    pub(super) fn tick(&mut self, out: &mut Out<'_>) {
        let now = out.now;
        for (call, _) in self.0.extract_if(.., |_, until| *until <= now) {
            let within = ANSWER_WITHIN.as_secs();
            let why =
                format!("the supervisor did not answer within {within} s; the connections may have been switched");
            out.answer_last(call, Answer::Switched(Err(why)));
        }
    }

    /// Answers all calls because the deployment ends.
    pub(super) fn abandon(&mut self, name: &str, out: &mut Out<'_>) {
        for (call, _) in std::mem::take(&mut self.0) {
            out.answer_last(call, Answer::Switched(Err(format!("`{name}` ends"))));
        }
    }
}

/// Finds the only member whose absolute path is `process`, or ends with `process`.
fn member(plan: &Plan, process: &str) -> Result<(u32, u32), String> {
    let end = format!("/{process}");
    let mut found = Vec::new();
    for (number, group) in (0_u32..).zip(&plan.groups) {
        for (slot, member) in (0_u32..).zip(&group.members).filter(|(_, member)| !member.name.is_empty()) {
            let path = format!("{}/{}", group.path, member.name);
            if path == process {
                return Ok((number, slot));
            }
            found.extend(path.ends_with(&end).then_some(((number, slot), path)));
        }
    }
    match &found[..] {
        [(one, _)] => Ok(*one),
        [] => Err(format!("`{}` has no process `{process}`", plan.name)),
        several => {
            let paths: Vec<String> = several.iter().take(4).map(|(_, path)| format!("`{path}`")).collect();
            Err(format!("several processes end in `{process}`: {}; give more of the path", paths.join(", ")))
        }
    }
}
