//! People who switch a process to other connection sets: finds what they mean, and passes on what its supervisor says.

use super::{Coordinator, Phase};
use crate::logic::effect::{Effect, Out};
use crate::logic::executer::group_host;
use crate::logic::protocol::{Answer, SetsSwitched, SwitchRequest, ToParticipant};
use language::plan::{Plan, owned_sets};
use std::time::Duration;

/// How long a supervisor has to answer: each of its three steps has 2 s.
const ANSWER_WITHIN: Duration = Duration::from_secs(8);
/// How many people may wait at one time.
const CALLS_MAX: usize = 64;

impl Coordinator {
    /// Has a supervisor switch a process; `call` is answered when that is confirmed.
    pub fn switch(&mut self, call: u64, request: &SwitchRequest, out: &mut Out<'_>) {
        let found = self.to_switch(request);
        let host = found.as_ref().ok().and_then(|(group, ..)| group_host(&self.plan, *group));
        match (found, host) {
            (Ok((group, slot, sets)), Some(host)) => {
                let order = ToParticipant::SwitchSets { group, slot, sets, call };
                out.send(host, self.deployment.to_participant(order));
                self.switches.insert(call, out.now + ANSWER_WITHIN);
            }
            (found, _) => answer(call, Err(found.err().unwrap_or_default()), out),
        }
    }

    /// Returns the group, the member of it and its sets that are meant.
    fn to_switch(&self, request: &SwitchRequest) -> Result<(u32, u32, Vec<u32>), String> {
        let name = &self.deployment.name;
        if self.phase != Phase::Running {
            return Err(format!("`{name}` does not run"));
        }
        if self.switches.len() >= CALLS_MAX {
            return Err("too many switches are asked for at this moment".to_owned());
        }
        let (group, slot) = member(&self.plan, &request.process)?;
        let host = group_host(&self.plan, group).unwrap_or_default();
        if self.lost.contains(host) {
            return Err(format!("host `{host}`, which supervises `{}`, is lost", request.process));
        }
        let owned = self.plan.groups.get(group as usize).map(|group| owned_sets(group, slot)).unwrap_or_default();
        let set = |label: &String| {
            let found = owned.iter().find(|(_, owned)| *owned == label).map(|(set, _)| *set);
            found.ok_or_else(|| match &owned.iter().map(|(_, label)| format!("`{label}`")).collect::<Vec<_>>()[..] {
                [] => format!("`{}` has no labelled connection sets", request.process),
                labels => {
                    format!("`{}` has no connection set `{label}`; it has {}", request.process, labels.join(", "))
                }
            })
        };
        Ok((group, slot, request.labels.iter().map(set).collect::<Result<_, String>>()?))
    }

    /// Passes on what a supervisor says.
    pub(super) fn sets_switched(&mut self, call: u64, switched: Result<SetsSwitched, String>, out: &mut Out<'_>) {
        if self.switches.remove(&call).is_some() {
            answer(call, switched, out);
        }
    }

    /// Waits no longer for a supervisor that does not answer.
    pub(super) fn tick_calls_to_switch(&mut self, out: &mut Out<'_>) {
        for (call, _) in self.switches.extract_if(.., |_, until| *until <= out.now).collect::<Vec<_>>() {
            let within = ANSWER_WITHIN.as_secs();
            let why = format!("the supervisor did not answer within {within} s; whether it was switched is not known");
            answer(call, Err(why), out);
        }
    }

    /// Answers who still waits: the deployment ends.
    pub(super) fn abandon_switches(&mut self, out: &mut Out<'_>) {
        for (call, _) in std::mem::take(&mut self.switches) {
            answer(call, Err(format!("`{}` ends", self.deployment.name)), out);
        }
    }
}

/// Finds the one member that is meant by an absolute path or the end of one.
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

fn answer(call: u64, switched: Result<SetsSwitched, String>, out: &mut Out<'_>) {
    out.effects.push(Effect::Answer { call, answer: Box::new(Answer::Switched(switched)) });
    out.effects.push(Effect::EndAnswers { call });
}
