//! The end of a part of a deployment: every program is told to go, and supervisors elsewhere hear that the groups of this host are gone.

use super::{Participant, Phase};
use crate::logic::effect::Out;
use crate::logic::executer::{ExecContext, group_host};
use crate::logic::instance::Instance;
use crate::logic::protocol::{Ending, Estop, Failure, FailureCause, Target, ToCoordinator, ToParticipant};

impl Participant {
    /// Tells every program to go after an emergency stop. Supervisors on other hosts hear that as the cause.
    pub fn stop_at_once(&mut self, estop: &Estop, out: &mut Out<'_>) {
        if self.phase == Phase::Leaving {
            return;
        }
        self.estop = Some(estop.clone());
        if matches!(self.phase, Phase::Preparing | Phase::Connecting) {
            let reasons = vec![format!("host `{}`: {estop}", self.host)];
            out.send(&self.home, self.deployment.to_coordinator(ToCoordinator::Refused { reasons }));
        }
        self.leave(out);
    }

    /// Returns an ending with the emergency stop as its cause, if there was one: people read the first cause that is told.
    pub(super) fn as_stopped(&self, ending: Ending) -> Ending {
        match (ending, &self.estop) {
            (Ending::Aborted(Failure { origin, cause: FailureCause::NotAvailable(_), at }), Some(estop)) => {
                Ending::Aborted(Failure { origin, cause: FailureCause::Estop(estop.clone()), at })
            }
            (ending, _) => ending,
        }
    }

    /// Tells every program to go.
    pub fn leave(&mut self, out: &mut Out<'_>) {
        if self.phase != Phase::Leaving {
            (self.phase, self.check_in) = (Phase::Leaving, None);
            self.abandon_groups(out);
            self.begin_never(out);
            for leaf in self.instances.numbers() {
                self.with_instance(leaf, out, Instance::leave);
            }
            self.report_released(out);
        }
    }

    fn abandon_groups(&mut self, out: &mut Out<'_>) {
        let since_go = self.since_go(out.now);
        let start = self.together.start();
        let context = ExecContext { deployment: &self.deployment, home: &self.home, plan: &self.plan, since_go, start };
        self.executers.each(|group, executer| {
            if !executer.is_running() {
                return;
            }
            // What was taken for it is not free before its programs have ended.
            executer.abandon(context, out);
            let origin = self.plan.groups.get(group as usize).map(|group| group.path.clone()).unwrap_or_default();
            let left = || FailureCause::NotAvailable("its host has ended its part".into());
            let cause = self.estop.clone().map_or_else(left, FailureCause::Estop);
            let (target, activation) = (Target::Group(group), executer.activation());
            let ending = Ending::Aborted(Failure { origin, cause, at: since_go });
            if let Some(host) = self.supervisors.get(&target).and_then(|(group, _)| group_host(&self.plan, *group)) {
                out.send(host, self.deployment.to_participant(ToParticipant::Ended { target, activation, ending }));
            }
        });
    }

    /// Returns whether it comes to its end here.
    pub fn is_leaving(&self) -> bool {
        self.phase == Phase::Leaving
    }

    /// Returns whether nothing of it is left here.
    pub fn is_over(&self) -> bool {
        self.phase == Phase::Leaving && self.instances.are_over()
    }
}
