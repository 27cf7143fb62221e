//! A supervisor whose members are on hosts that are lost.

use super::fence::{self, Against};
use super::members::MemberRef;
use super::wires::Flips;
use super::{ExecContext, Executer, leaf_host, member_host, member_path};
use crate::logic::effect::Out;
use crate::logic::protocol::{ActivityInput, Change, Ending, Failure, FailureCause, Target, ToParticipant};
use language::algebra::{Activation, Activity, State};
use language::plan::{Group, MemberKind, Notice, Plan};
use std::collections::BTreeSet;
use std::time::Duration;

/// How many activations of a member, as a power of two, have numbers of their own until its supervisor's host rejoins.
const NUMBERS: u32 = 22;

impl Executer {
    /// Begins for the time `number` on this host. Its numbers differ from the numbers of the
    /// previous times, whose answers may still be on their way.
    pub fn rejoins(&mut self, number: u32) {
        self.state = State::numbered_from(&self.program, Activation(number << NUMBERS));
        self.wires.number_from(u64::from(number) << 32);
        self.switches.clear();
    }

    /// Opens the wires of its open sets again whose producers are on a host that has rejoined.
    pub fn reopen(&mut self, host: &str, context: ExecContext<'_>, out: &mut Out<'_>) {
        let producer = |wire: u32| leaf_host(context.plan, context.plan.wires.get(wire as usize)?.from.leaf);
        let theirs: Vec<u32> =
            self.wires.open_wires().into_iter().filter(|wire| producer(*wire) == Some(host)).collect();
        self.wires.order(Flips { open: &theirs, ..Flips::default() }, self.group, context, out);
    }

    /// Takes the loss of a host: its members fail, and the group stops waiting for them.
    pub fn host_lost(&mut self, host: &str, context: ExecContext<'_>, out: &mut Out<'_>) -> Option<Ending> {
        self.switch_without(host, context, out);
        self.confirm(&self.wires.unconfirmed_by(host));
        let group = context.plan.groups.get(self.group as usize)?;
        // A waiting member was never told to run.
        let begun = self.members.activations().filter(|run| !self.members.is_waiting(run.slot));
        let theirs = begun.filter(|run| member_host(context.plan, group, run.slot) == Some(host)).filter_map(|run| {
            let kind = group.members.get(run.slot as usize)?.kind;
            Some((run.slot, run.activation, fence::hosts(context.plan, kind)))
        });
        self.fences.lose(host, theirs);
        self.activate_ready(context, out);
        // All members of the host fail because of this loss, including members that the group would
        // stop after the first failure.
        let is_stopping = |slot: u32| self.state.activity(slot) == Activity::Stopping;
        let lost: Vec<(MemberRef, bool)> = self.members.activations().map(|run| (run, is_stopping(run.slot))).collect();
        // An activity gets the event of the loss before its members fail because of it.
        if let Some(ending) = self.tell(&ActivityInput::Notice(Notice::HostLost(host.to_owned())), context, out) {
            return Some(ending);
        }
        for (run, stopping) in lost {
            if member_host(context.plan, group, run.slot) != Some(host) {
                continue;
            }
            let cause = if stopping { FailureCause::HostLostStopping } else { FailureCause::HostLost };
            let cause = cause(host.to_owned());
            let ending = Ending::Aborted(Failure { origin: String::new(), cause, at: Duration::ZERO });
            if let Some(ending) = self.ended(run, ending, context, out) {
                return Some(ending);
            }
        }
        None
    }

    /// Notes how an ending bears on a fence: the activation has ended, or it may still run.
    pub(super) fn look_at_end(&mut self, run: MemberRef, ending: &Ending, context: ExecContext<'_>) {
        let MemberRef { slot, activation } = run;
        let group = context.plan.groups.get(self.group as usize);
        let Some((target, host)) = group.and_then(|group| self.target(context.plan, group, slot)) else { return };
        if *ending == Ending::Unconfirmed {
            return self.fences.unconfirmed(slot, activation, host, self.members.is_current(run));
        }
        let cause = if let Ending::Aborted(failure) = ending { Some(&failure.cause) } else { None };
        let is_known = match (target, cause) {
            // The report is of a host that cannot know: the host itself was not asked.
            (_, Some(FailureCause::HostLost(lost) | FailureCause::HostLostStopping(lost))) => lost != host,
            // A group that its node has left goes before its programs do.
            (Target::Group(_), Some(FailureCause::NotAvailable(_))) => false,
            (Target::Leaf(_) | Target::Group(_), _) => true,
        };
        if is_known {
            self.fences.ended(slot, activation);
        }
    }

    /// Takes note of the hosts that may still do something for a member that has ended.
    pub fn loosened(&mut self, slot: u32, hosts: BTreeSet<String>, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.fences.loosen(slot, hosts);
        self.open_fences(context, out);
    }

    /// Does the work that has waited for lost hosts, and reports the changes to others.
    pub(super) fn open_fences(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.activate_ready(context, out);
        // A running group may still end well. Its supervisor is told at the end.
        if !self.run.is_on {
            self.pass_on_fences(context, out);
        }
    }

    /// Tells the supervisor of the group which hosts may still do something for it.
    pub(super) fn pass_on_fences(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(hosts) = self.fences.news() else { return };
        let message = ToParticipant::Loose { target: Target::Group(self.group), hosts: hosts.into_iter().collect() };
        // Groups are listed after the group that contains them.
        let is_here = |group: &&Group| group.members.iter().any(|one| one.kind == MemberKind::Group(self.group));
        let above =
            context.plan.groups.iter().find(is_here).and_then(|group| context.plan.hosts.get(group.host as usize));
        above.into_iter().for_each(|host| out.send(host, context.deployment.to_participant(message.clone())));
    }

    /// Returns the reserved resource that a member waits for although the algebra has granted it, and the program that
    /// may still use it.
    pub(super) fn held(&self, slot: u32, plan: &Plan) -> Option<Change> {
        let Against { resource, host, user, is_lost } = self.fences.against(slot)?;
        let (resource, host) = (resource.to_owned(), host.to_owned());
        if is_lost {
            return Some(Change::Held { resource, host });
        }
        let group = plan.groups.get(self.group as usize)?;
        Some(Change::HeldBy { resource, host, by: member_path(plan, group, user)? })
    }

    /// Returns one sentence for users about each member that waits for a resource which others may still use.
    pub fn waits(&self, plan: &Plan) -> Vec<String> {
        let Some(group) = plan.groups.get(self.group as usize) else { return Vec::new() };
        let sentence = |slot: u32| {
            let (path, held) = (member_path(plan, group, slot)?, self.held(slot, plan)?);
            Some(format!("`{path}` {}", held.held_text()?))
        };
        self.members.all_waiting().filter_map(sentence).collect()
    }

    /// Takes note that nothing of the deployment is left on a host that was lost.
    pub fn host_cleared(&mut self, host: &str, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.fences.clear(host);
        self.open_fences(context, out);
    }

    /// Takes note that a host is there again.
    pub fn host_back(&mut self, host: &str) {
        self.fences.reach(host);
    }
}
