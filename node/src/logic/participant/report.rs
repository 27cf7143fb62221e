//! The end of a part of a deployment, and its reports: to the home, its progress and each change; to supervisors, how members have ended.

use super::{Participant, Phase};
use crate::logic::claims::Claims;
use crate::logic::effect::Out;
use crate::logic::executer::{Sending, Taking, wants_restarts};
use crate::logic::instance::Instance;
use crate::logic::protocol::{
    ActivityInput, Change, Ending, Estop, Failure, FailureCause, Target, ToCoordinator, ToParticipant,
};
use crate::logic::table::counted;
use comms::logic::control::{MessageFate, Order, PortMessage};
use language::plan::{Expression, Notice, Plan};
use std::collections::BTreeSet;

impl Participant {
    pub(super) fn tell_supervisor(&self, target: Target, activation: u32, ending: Ending, out: &mut Out<'_>) {
        let ending = self.as_stopped(ending);
        match self.site.supervisor_host(target) {
            Some(host) => {
                self.site.tell(host, ToParticipant::Ended { target, activation, ending }, out);
            }
            None if target == Target::Group(0) => {
                self.site.tell_home(ToCoordinator::MainEnded { ending }, out);
            }
            // It was taken away, and no caller waits for it.
            None => {}
        }
    }

    /// Tells the supervisor of a program that it is started again, if it wants to know.
    pub(super) fn tell_restart(&self, target: Target, cause: &FailureCause, out: &mut Out<'_>) {
        let Some((number, _)) = self.site.supervisors.get(&target) else { return };
        let group = self.site.plan.groups.get(*number as usize).filter(|group| wants_restarts(&group.supervision));
        let host = group.and_then(|group| self.site.plan.hosts.get(group.host as usize));
        let message = || ToParticipant::Restarted { target, cause: cause.clone() };
        host.into_iter().for_each(|host| self.site.tell(host, message(), out));
    }

    /// Takes note of parameters that a program was told of while the deployment runs.
    pub fn configured(&self, leaf: u32, parameters: Vec<(String, Option<String>)>, out: &mut Out<'_>) {
        if self.phase == Phase::Running {
            for (parameter, value) in parameters {
                self.tell_parameter(leaf, &parameter, out);
                self.happened(Target::Leaf(leaf), Change::Configured { parameter, value }, out);
            }
        }
    }

    /// Gives an order to an activity. If a user waits, the home gets the answer.
    pub(super) fn tell_activity(
        &mut self,
        group: u32,
        told: &ActivityInput,
        by: Option<&str>,
        call: Option<u64>,
        out: &mut Out<'_>,
    ) {
        let first = out.messages.len();
        let mut answer = Err("its supervisor is not here".to_owned());
        self.with_executer(group, out, |executer, at, out| {
            let Taking { ending, taken } = executer.tell_by(told, by, at, out);
            answer = taken;
            ending
        });
        if let Some(call) = call {
            self.site.tell_home(ToCoordinator::Answered { call, taken: answer }, out);
            // The deployment may end by the order, and the answer comes before that.
            if let Some(consequences) = out.messages.get_mut(first..) {
                consequences.rotate_right(1);
            }
        }
    }

    /// Hands a message to the activity whose ports a program has, and reports its fate to the program.
    pub(super) fn take_message(&mut self, leaf: u32, message: PortMessage, out: &mut Out<'_>) {
        let (number, mut fate) = (message.number, MessageFate::Idle);
        if let Some(group) = self.activity_of(leaf) {
            self.with_executer(group, out, |executer, at, out| {
                let (said, ending) = executer.take_message(message, at, out);
                fate = said;
                ending
            });
        }
        self.with_instance(leaf, out, |instance, context| {
            instance.ask(Order::Received { number, fate }, context);
        });
    }

    /// Takes note that a program has sent a value of an activity.
    pub(super) fn value_sent(&mut self, leaf: u32, number: u64, out: &mut Out<'_>) {
        if let Some(group) = self.activity_of(leaf) {
            self.tell_executer(group, out, |executer, _, _| executer.value_sent(number));
        }
    }

    /// Takes note that a program is gone, which may have had the ports of an activity.
    pub(super) fn ports_lost(&mut self, leaf: u32, out: &mut Out<'_>) {
        if let Some(group) = self.activity_of(leaf) {
            self.tell_executer(group, out, |executer, at, out| executer.ports_lost(at, out));
        }
    }

    /// Has a program send the values of an activity.
    pub(super) fn send_values(&mut self, group: u32, sendings: Vec<Sending>, out: &mut Out<'_>) {
        // Most groups send nothing, and each group is asked at each event.
        if sendings.is_empty() {
            return;
        }
        let Some((_, leaf)) = self.site.plan.ports_of(group) else { return };
        for Sending { number, port, value } in sendings {
            let (order, mut is_there) = (Order::Send { number, port: port.clone(), value }, false);
            self.with_instance(leaf, out, |instance, context| is_there = instance.ask(order, context));
            if !is_there {
                self.tell_executer(group, out, |executer, at, out| {
                    executer.value_sent(number);
                    executer.not_sent(&port, at, out);
                });
            }
        }
    }

    /// Returns the activity whose ports a program has.
    fn activity_of(&self, leaf: u32) -> Option<u32> {
        let (group, _) = self.site.supervisors.get(&Target::Leaf(leaf))?;
        self.site.plan.ports_of(*group).filter(|(_, ports)| *ports == leaf).map(|_| *group)
    }

    /// Tells the activity that supervises a program of a parameter with another value, if it waits for that.
    fn tell_parameter(&self, leaf: u32, parameter: &str, out: &mut Out<'_>) {
        let Some(&(number, slot)) = self.site.supervisors.get(&Target::Leaf(leaf)) else { return };
        let Some(group) = self.site.plan.groups.get(number as usize) else { return };
        let (Expression::Chart(chart), Some(member)) = (&group.expression, group.members.get(slot as usize)) else {
            return;
        };
        let notice = Notice::ParameterChanged { member: member.name.clone(), parameter: parameter.to_owned() };
        if let Some(host) = self.site.plan.hosts.get(group.host as usize).filter(|_| chart.notice(&notice).is_some()) {
            self.site.tell(
                host,
                ToParticipant::Tell { group: number, told: ActivityInput::Notice(notice), by: None, call: None },
                out,
            );
        }
    }

    pub(super) fn happened(&self, target: Target, change: Change, out: &mut Out<'_>) {
        self.site.tell_home(ToCoordinator::Happened { target, change }, out);
    }

    pub(super) fn report_prepared(&mut self, out: &mut Out<'_>) {
        if self.phase != Phase::Preparing || !self.roll.waiting.is_empty() {
            return;
        }
        let reasons = self.take_reasons();
        let message = if reasons.is_empty() {
            ToCoordinator::Prepared { facts: std::mem::take(&mut self.roll.facts), machine: self.site.machine.clone() }
        } else {
            ToCoordinator::Refused { reasons }
        };
        self.site.tell_home(message, out);
    }

    pub(super) fn report_connected(&mut self, out: &mut Out<'_>) {
        if self.phase != Phase::Connecting || !self.roll.waiting.is_empty() {
            return;
        }
        let reasons = self.take_reasons();
        let message = if reasons.is_empty() { ToCoordinator::Connected } else { ToCoordinator::Refused { reasons } };
        self.site.tell_home(message, out);
    }

    /// Returns the reasons against this deployment, and clears them. A reason that several programs share is given
    /// once: most often they are of one executable.
    pub(super) fn take_reasons(&mut self) -> Vec<String> {
        let mut reasons = std::mem::take(&mut self.roll.reasons);
        for (why, leaves) in std::mem::take(&mut self.roll.refusals) {
            let leaf = leaves.first().and_then(|leaf| self.site.plan.leaves.get(*leaf as usize));
            let others = match leaves.len() {
                0 | 1 => String::new(),
                count => format!(" (and {})", counted(count - 1, "other")),
            };
            reasons.extend(leaf.map(|leaf| {
                let host = self.site.plan.hosts.get(leaf.host as usize).map_or("", String::as_str);
                format!("`{}`{others} cannot take part on `{host}`: {why}", leaf.path)
            }));
        }
        reasons
    }

    pub(super) fn report_released(&self, out: &mut Out<'_>) {
        if self.is_over() {
            let message =
                if self.unconfirmed().is_empty() { ToCoordinator::Released } else { ToCoordinator::Unconfirmed };
            self.site.tell_home(message, out);
        }
    }

    /// Returns the programs that may still be there although everything was done to end them.
    pub fn unconfirmed(&self) -> BTreeSet<u32> {
        self.instances.iter().filter(|(_, instance)| instance.is_unconfirmed()).map(|(leaf, _)| leaf).collect()
    }

    /// Returns the programs that have stopped while work outside of them may go on, each with a description of the work.
    pub fn may_go_on(&self) -> Vec<String> {
        let causes = self.instances.iter().filter_map(|(leaf, instance)| Some((leaf, instance.open_work()?)));
        causes.map(|(leaf, cause)| format!("{}: {cause}", self.path(leaf).unwrap_or_default())).collect()
    }

    /// Returns why a plan cannot be taken on if it lacks a program that could not be ended: the resources of that program would
    /// be free with this plan.
    pub(super) fn unended_without(&self, plan: &Plan) -> Vec<String> {
        let live = plan.live_leaves();
        let gone = self.unconfirmed().into_iter().filter(|leaf| !live.contains(leaf));
        let paths = gone.filter_map(|leaf| self.path(leaf));
        paths
            .map(|path| format!("`{path}` could not be ended and may still use what it has; end it, then take it away"))
            .collect()
    }

    /// Refuses to begin a program that would use a device at the same time as a program that could not be ended;
    /// returns whether it did.
    pub(super) fn refuse_held(&self, leaf: u32, activation: u32, out: &mut Out<'_>) -> bool {
        let wanted = self.devices(leaf);
        let holder = |other: u32| {
            let theirs = self.devices(other);
            let (device, by) = wanted.first_conflict(&theirs)?;
            Some(FailureCause::DeviceHeld { device: device.to_owned(), by: by.to_owned() })
        };
        // The process refuses its own unended program by itself.
        let others = self.unconfirmed().into_iter().filter(|other| *other != leaf);
        let Some(cause) = others.into_iter().find_map(holder) else { return false };
        let origin = self.path(leaf).unwrap_or_default().to_owned();
        let ending = Ending::Aborted(Failure { origin, cause, at: self.since_go(out.now) });
        self.happened(Target::Leaf(leaf), Change::Ended(ending.clone()), out);
        self.tell_supervisor(Target::Leaf(leaf), activation, ending, out);
        true
    }

    /// Returns the devices of a program: its claims in the spec, and those that it named itself.
    fn devices(&self, leaf: u32) -> Claims {
        let mut claims = Claims::of_leaf(&self.site.plan, leaf);
        let path = self.path(leaf).unwrap_or_default();
        let facts = self.links.registrations.facts.get(&leaf);
        facts.into_iter().for_each(|facts| claims.extend(Claims::of_owner(path, &facts.owns)));
        claims
    }

    /// Tells every program to go after an emergency stop. Supervisors on other hosts hear that as the cause.
    pub fn stop_at_once(&mut self, estop: &Estop, out: &mut Out<'_>) {
        if self.phase == Phase::Leaving {
            return;
        }
        self.estop = Some(estop.clone());
        self.give_up(&estop.to_string(), out);
    }

    /// Tells every program to go, although the home has not asked for that. A home that waits for this part to prepare, or to make its
    /// links, gets the reason: it must not take a report that everything was released for an earlier one.
    pub fn give_up(&mut self, why: &str, out: &mut Out<'_>) {
        if matches!(self.phase, Phase::Preparing | Phase::Connecting) {
            let reasons = vec![format!("host `{}`: {why}", self.site.host)];
            self.site.tell_home(ToCoordinator::Refused { reasons }, out);
        }
        self.leave(out);
    }

    /// Returns an ending with the emergency stop as its cause, if there was one: users read the first cause.
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
            (self.phase, self.together.check_in) = (Phase::Leaving, None);
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
        let context = self.site.context(since_go, self.together.start());
        self.executers.each(|group, executer| {
            if !executer.is_running() {
                return;
            }
            // Its resources are not free before its programs have ended.
            executer.abandon(context, out);
            let origin = self.site.group_path(group);
            let left = || FailureCause::NotAvailable("its host has ended its part".into());
            let cause = self.estop.clone().map_or_else(left, FailureCause::Estop);
            let (target, activation) = (Target::Group(group), executer.activation());
            let ending = Ending::Aborted(Failure { origin, cause, at: since_go });
            if let Some(host) = self.site.supervisor_host(target) {
                self.site.tell(host, ToParticipant::Ended { target, activation, ending }, out);
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
