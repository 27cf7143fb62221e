//! Other event actions for a group, while it runs.
//!
//! A running member keeps its place in the new event actions ([`carry`]). Whether it has a place is checked before
//! anything changes, and again when the change takes effect, since the group may have moved in between.

use super::{ExecContext, Executer, member_path};
use crate::logic::effect::Out;
use crate::logic::protocol::{Ending, Failure, FailureCause};
use language::algebra::{Carried, Event, Misfit, Program, carry};
use language::plan::{Group, Plan};
use std::collections::BTreeSet;

impl Executer {
    /// Returns why the group cannot continue with the event actions of a plan. None if it can.
    pub fn against_actions(&self, plan: &Plan) -> Option<String> {
        let group = plan.groups.get(self.group as usize)?;
        let misfit = self.carried(group, &Program::compile(group))?.err()?;
        let paths = misfit.members.iter().filter_map(|slot| member_path(plan, group, *slot));
        let runs = match paths.map(|path| format!("`{path}`")).collect::<Vec<_>>() {
            paths if paths.is_empty() => "something waits".to_owned(),
            paths if paths.len() == 1 => format!("{} runs", paths.join("")),
            paths => format!("{} run", paths.join(", ")),
        };
        Some(format!(
            "the event actions of `{}` cannot change now: {runs}, and {}; wait until that has ended, or stop the deployment",
            group.path, misfit.why
        ))
    }

    /// Switches to the event actions of the plan. Returns how the group ended, if that ended it. If a running member
    /// has no place in them, the group is stopped and has failed.
    pub fn adopt_actions(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) -> Option<Ending> {
        let group = context.plan.groups.get(self.group as usize)?;
        let next = Program::compile(group);
        match self.carried(group, &next) {
            None => {
                self.renew_actions(context.plan);
                // The texts of questions are no part of the event actions.
                self.renew_questions(context, out);
                None
            }
            Some(Ok(carried)) => {
                // The next event actions name the connections and the programs of the plan.
                self.succeed_now(context, out);
                self.fences.retake(group);
                self.take_on(next, carried, context, out)
            }
            Some(Err(_)) => {
                let why = "a change of its event actions could not be taken back any more".to_owned();
                let (origin, at) = (group.path.clone(), context.since_go);
                self.supervised.give_up(Failure { origin, cause: FailureCause::Failed(why), at });
                self.react(Event::Stop, context, out)
            }
        }
    }

    /// Takes the event actions of the plan, if nothing of the group runs.
    pub(super) fn renew_actions(&mut self, plan: &Plan) {
        let Some(group) = plan.groups.get(self.group as usize).filter(|_| self.state.is_idle()) else { return };
        let next = Program::compile(group);
        if next != self.program {
            self.state = self.state.idle_for(&next);
            self.program = next;
            self.outside.news.changes += 1;
            self.fences.retake(group);
        }
    }

    /// Returns the state of the group in other event actions. None if the event actions are equal, or if nothing of the group runs.
    fn carried(&self, group: &Group, next: &Program) -> Option<Result<Carried, Misfit>> {
        if *next == self.program || self.state.is_idle() {
            return None;
        }
        let gone: BTreeSet<u32> =
            (0..).zip(&group.members).filter(|(_, member)| member.name.is_empty()).map(|(slot, _)| slot).collect();
        Some(carry((&self.program, &self.state), next, &gone))
    }

    fn take_on(
        &mut self,
        next: Program,
        carried: Carried,
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) -> Option<Ending> {
        self.clock.read(out.now);
        // A record compares the steps before the change with the event actions before it.
        if !self.outside.news.steps.is_empty() {
            self.record(context, out);
        }
        self.outside.news.changes += 1;
        self.connect(&carried.ended, context, out);
        for command in carried.ended {
            self.carry_out(command, context, out);
        }
        self.clock.renumber(&carried.timers);
        (self.program, self.state) = (next, carried.state);
        self.connect(&carried.begun, context, out);
        for command in carried.begun {
            self.carry_out(command, context, out);
        }
        self.renew_questions(context, out);
        carried.outcome.map(|outcome| self.conclude(outcome, context, out))
    }
}
