//! The end of a part of a deployment: every program is told to go, and supervisors elsewhere hear that the groups of this host are gone.

use super::{Participant, Phase};
use crate::logic::effect::Out;
use crate::logic::executer::{ExecContext, group_host};
use crate::logic::instance::Instance;
use crate::logic::protocol::{Ending, Failure, FailureCause, Target, ToParticipant};

impl Participant {
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
            let failure = Failure {
                origin,
                cause: FailureCause::NotAvailable("its host has ended its part".into()),
                at: since_go,
            };
            let (target, activation) = (Target::Group(group), executer.activation());
            let ending = Ending::Aborted(failure);
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
