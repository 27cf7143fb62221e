//! A deployment that is to end before its `main` has, and what its home keeps of it on the disk until then.

use super::{Coordinator, Phase};
use crate::logic::effect::{Effect, Out};
use crate::logic::protocol::{
    Answer, Ending, Failure, FailureCause, Kept, Report, StopReply, Target, ToParticipant, Why,
};
use language::plan::OnBoot;
use std::time::Duration;

impl Coordinator {
    /// Ends the deployment because somebody asked, `call` is answered when nothing is left; or because its node leaves.
    pub fn stop(&mut self, call: Option<u64>, out: &mut Out<'_>) {
        self.is_leaving |= call.is_none();
        if call.is_some() {
            self.is_unwanted = true;
            self.unkeep(out);
        }
        self.stoppers.extend(call);
        match self.phase {
            Phase::Preparing | Phase::Connecting => {
                self.reasons.push("it was stopped before it ran".to_owned());
                self.end(None, out);
            }
            Phase::Running => {
                self.is_asked = true;
                let Some(home) = self.plan.home().map(str::to_owned) else { return };
                let order = ToParticipant::Stop { target: Target::Group(0), activation: 1 };
                out.send(&home, self.deployment.to_participant(order));
            }
            Phase::Ending | Phase::Over => {}
        }
    }

    /// Ends the deployment at once, for this cause.
    pub fn abort(&mut self, cause: FailureCause, out: &mut Out<'_>) {
        if self.phase == Phase::Running {
            let origin = self.plan.groups.first().map(|main| main.path.clone()).unwrap_or_default();
            let at = self.go_at.map_or(Duration::ZERO, |go| out.now - go);
            return self.end(Some(Ending::Aborted(Failure { origin, cause, at })), out);
        }
        self.reasons.push(format!("it {cause}"));
        self.end(None, out);
    }

    /// Returns whether it is over, or comes to its end.
    pub fn is_ending(&self) -> bool {
        matches!(self.phase, Phase::Ending | Phase::Over)
    }

    /// Returns what is kept of it on the disk; nothing once it is to end.
    pub fn kept(&self) -> Option<Kept> {
        if self.is_ending() || self.is_unwanted {
            return None;
        }
        Some(self.record(false))
    }

    fn record(&self, has_ended: bool) -> Kept {
        let signed = self.signed.as_deref();
        let resume = (self.wanted.on_boot == OnBoot::Resume).then(|| ((*self.wanted).clone(), signed.cloned()));
        let (deployment, origin, by) = (self.deployment.clone(), self.origin(), self.begun_by.clone());
        Kept { deployment, origin, by, hosts: self.hosts.clone(), has_ended, waits: false, resume }
    }

    fn unkeep(&mut self, out: &mut Out<'_>) {
        self.unkeeping += u32::from(self.is_unwanted);
        out.effects.push(Effect::Unkeep { deployment: self.deployment.clone() });
    }

    /// Has the end written down: for good, unless its node leaves, which may be for a reboot.
    pub(super) fn keep_end(&mut self, out: &mut Out<'_>) {
        let is_done = matches!(self.ending, Some(Ending::Done(_)));
        if self.is_leaving && !self.is_unwanted && !is_done {
            return out.effects.push(Effect::Keep(Box::new(self.record(true))));
        }
        self.unkeep(out);
    }

    /// Takes note that the disk has forgotten it, or refuses to.
    pub fn unkept(&mut self, out: &mut Out<'_>) {
        self.unkeeping = self.unkeeping.saturating_sub(1);
        if self.phase == Phase::Ending && self.waiting.is_empty() {
            self.finish(out);
        }
    }

    /// Asks the disk again, whose word a node that was killed has not heard.
    pub fn unkeep_again(&mut self, out: &mut Out<'_>) {
        if self.unkeeping > 0 {
            self.unkeeping = 1;
            out.effects.push(Effect::Unkeep { deployment: self.deployment.clone() });
        }
    }

    /// Takes its end, unless a user who has asked for that is still to be promised that it is for good: the deadline of the end comes first.
    pub(super) fn finish(&mut self, out: &mut Out<'_>) {
        if self.unkeeping > 0 && self.deadline.is_some() {
            return;
        }
        self.phase = Phase::Over;
        self.deadline = None;
        let at = self.go_at.map_or(Duration::ZERO, |go| out.now - go);
        let late = std::mem::take(&mut self.waiting);
        self.lost.extend(late.iter().cloned());
        let why = |host: &String| match (self.unable.contains(host), late.contains(host)) {
            (true, _) => Why::Unable,
            (false, true) => Why::Late,
            (false, false) => Why::Lost,
        };
        self.unconfirmed = self.lost.iter().map(|host| (host.clone(), why(host))).collect();
        let unconfirmed = std::mem::take(&mut self.lost).into_iter().collect();
        let last = match self.ending.take() {
            Some(ending) => Report::Finished { ending, at, unconfirmed },
            None => Report::Refused { reasons: std::mem::take(&mut self.reasons) },
        };
        self.report(last, out);
        for call in std::mem::take(&mut self.watchers) {
            out.effects.push(Effect::EndAnswers { call });
        }
        for call in std::mem::take(&mut self.stoppers) {
            out.effects.push(Effect::Answer { call, answer: Box::new(Answer::Stop(StopReply::Stopped)) });
            out.effects.push(Effect::EndAnswers { call });
        }
    }
}
