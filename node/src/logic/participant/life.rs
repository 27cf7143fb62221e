//! The life of this part of a deployment: its programs are started and linked, its processes run and stop, and it ends.
//!
//! The supervisor of a process orders when the process runs and stops. If a host is lost, each program follows its
//! `on_link_loss`. A process that belongs to another deployment is started and stopped only by that deployment. All
//! programs are told to leave when the home releases this part, when this part gives up, and at an emergency stop.

use super::activation::{Activation, gone};
use super::{Participant, Phase, Seen, Wanted};
use crate::logic::claims::Claims;
use crate::logic::effect::Out;
use crate::logic::instance::{Instance, InstanceContext};
use crate::logic::programs::Programs;
use crate::logic::protocol::{
    ActivityInput, Change, Ending, Estop, Failure, FailureCause, LeafFacts, Target, ToCoordinator, unreached,
};
use comms::logic::control::{Order, Partner};
use comms::logic::time::Time;
use language::plan::{LinkLoss, Notice};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How late GO may come before users are told.
const LATE_MIN: Duration = Duration::from_millis(1);
/// How late this node may wake up for the start before users are told. On a busy machine, a node waits for a core, like every program.
pub(super) const WOKEN_LATE_MIN: Duration = Duration::from_millis(20);

impl Participant {
    /// Takes note of the processes of other deployments that it uses here. A missing process is a reason against it.
    pub(super) fn find_externals(&mut self, all: BTreeMap<u32, Result<Seen, String>>) {
        for (leaf, seen) in all {
            match self.externals.find(leaf, seen) {
                Ok(facts) => self.roll.prepared(facts),
                Err(why) => {
                    let (host, path) = (&self.site.host, self.site.path(leaf).unwrap_or_default());
                    self.roll.object([format!("host `{host}`: `{path}` runs in another deployment: {why}")]);
                }
            }
        }
    }

    /// Starts the programs of this host that no other deployment runs. If there is a reason against one program, starts none.
    pub(super) fn start_programs(&mut self, offered: &Programs, out: &mut Out<'_>) {
        let starts = match self.site.starts(&self.site.plan, offered) {
            Ok(starts) if !self.roll.has_reasons() => starts,
            Ok(_) => return,
            Err(problems) => {
                let host = &self.site.host;
                return self.roll.object(problems.into_iter().map(|why| format!("host `{host}`: {why}")));
            }
        };
        for (number, start) in starts {
            self.roll.wait_for(number);
            self.insert_instance(number, out, |context| Instance::spawn(start, context));
        }
    }

    /// Has the programs make their links.
    pub(super) fn connect(&mut self, facts: Vec<LeafFacts>, machines: Vec<String>, out: &mut Out<'_>) {
        if self.phase != Phase::Preparing {
            return;
        }
        self.phase = Phase::Connecting;
        self.links.register(facts, machines);
        let is_rejoining = self.activations.is_rejoining();
        if is_rejoining {
            let own = self.links.registrations.facts.values().filter(|facts| self.is_own(facts));
            own.for_each(|facts| self.links.tell_where(&self.site, facts, out));
        }
        for leaf in self.processes.instances.numbers() {
            match self.links.orders(&self.site, leaf) {
                Ok(_) if self.site.is_plain(leaf) => {
                    self.with_instance(leaf, out, |instance, _| instance.connect_plain());
                }
                Ok(orders) => {
                    // The programs of the other hosts run already, and some may be gone for good.
                    let rejoin = is_rejoining.then_some(Order::Rejoin);
                    self.roll.wait_for(leaf);
                    self.with_instance(leaf, out, |instance, context| {
                        instance.connect(rejoin.into_iter().chain(orders), context);
                    });
                }
                Err(reasons) => self.roll.object(reasons),
            }
        }
        self.report_connected(out);
    }

    /// Returns whether this host has to report the facts of a leaf.
    fn is_own(&self, facts: &LeafFacts) -> bool {
        let is_known = self.processes.instances.contains(facts.leaf) || self.externals.contains(facts.leaf);
        is_known && self.site.is_here(facts.leaf)
    }

    pub(super) fn report_prepared(&mut self, out: &mut Out<'_>) {
        if self.phase == Phase::Preparing
            && let Some(report) = self.roll.prepared_all(&self.site)
        {
            self.site.tell_home(report, out);
        }
    }

    pub(super) fn report_connected(&mut self, out: &mut Out<'_>) {
        if self.phase == Phase::Connecting
            && let Some(report) = self.roll.connected_all(&self.site)
        {
            self.site.tell_home(report, out);
        }
    }

    /// Holds the devices that a controller says are its own.
    pub(super) fn hold_own(&mut self, facts: &LeafFacts) {
        let path = self.site.path(facts.leaf).unwrap_or_default();
        self.claims.extend(Claims::of_owner(path, &facts.owns));
    }

    /// Links a program of this host that was started again, and tells the hosts of the programs that dial it.
    pub(super) fn rejoin(&mut self, facts: LeafFacts, out: &mut Out<'_>) {
        let leaf = facts.leaf;
        self.links.tell_where(&self.site, &facts, out);
        self.links.moved(&self.site, &self.processes, facts, out);
        let orders = self.links.orders(&self.site, leaf);
        self.with_instance(leaf, out, |instance, context| match orders {
            Ok(orders) => instance.connect(orders, context),
            Err(reasons) => instance.turn_away(&reasons.join("; "), context),
        });
    }

    /// Takes note of GO.
    pub(super) fn go(&mut self, now: Time) {
        if self.phase == Phase::Connecting {
            self.phase = Phase::Running;
        }
        self.activations.go(now);
    }

    /// Takes the time of the start. None if programs begin as soon as they can.
    pub(super) fn start_at(&mut self, start: Option<Time>, out: &mut Out<'_>) {
        self.activations.start_at(start);
        self.begin_together(LATE_MIN, out);
        self.activate_waiting(out);
    }

    /// Returns when the programs of the first step begin, until then.
    pub fn starts_at(&self) -> Option<Time> {
        self.activations.starts_at()
    }

    /// Activates the processes that have waited, if the time of the start has come. This node may have been suspended,
    /// or killed and started again, at that moment: if it is too late, its home is told.
    pub(super) fn begin_together(&mut self, late_min: Duration, out: &mut Out<'_>) {
        let Some(by) = self.activations.begin(out.now) else { return };
        if by >= late_min {
            let late_ms = by.as_secs_f64() * 1000.0;
            tracing::warn!(deployment = %self.site.deployment, late_ms, "this host begins late at an aligned start");
            self.site.tell_home(ToCoordinator::BeganLate { by }, out);
        }
        self.activate_waiting(out);
    }

    /// Activates what waits, unless it has to wait on.
    fn activate_waiting(&mut self, out: &mut Out<'_>) {
        for activation in self.activations.take() {
            self.activate(activation, out);
        }
    }

    /// Takes note that its node was gone: no program could answer it in the meantime.
    pub fn adopted(&mut self, away: Duration) {
        self.processes.instances.each(|_, instance| instance.adopted(away));
    }

    /// Waits for the answer of its home to this question; returns whether it waits. A part without its home does not wait.
    pub fn check_in(&mut self, number: u64, now: Time) -> bool {
        let is_alone = self.phase == Phase::Leaving || self.is_home_lost();
        if !is_alone {
            self.activations.check_in(number, now);
            self.processes.instances.each(|_, instance| instance.check_in());
            self.processes.executers.each(|_, executer| executer.check_in());
        }
        !is_alone
    }

    /// Returns the question that its home has not answered.
    pub fn checks_in(&self) -> Option<u64> {
        self.activations.checks_in()
    }

    /// Goes on: its home has answered, or is lost.
    pub fn checked_in(&mut self, out: &mut Out<'_>) {
        if !self.activations.checked_in() {
            return;
        }
        for leaf in self.processes.instances.numbers() {
            self.with_instance(leaf, out, |instance, context| instance.checked_in(context));
        }
        self.activate_waiting(out);
        self.each_executer(out, |executer, at, out| executer.checked_in(at, out));
    }

    /// Limits the wait for the home.
    pub(super) fn tick_check_in(&mut self, out: &mut Out<'_>) {
        if self.activations.is_home_silent(out.now) {
            let (deployment, home) = (&self.site.deployment, &self.site.home);
            tracing::warn!(%deployment, home, "the home has not reported whether it has given up this host: this part continues");
            self.checked_in(out);
        }
    }

    /// Takes note that its host takes part again, for the time `number`; GO was `since_go` ago.
    pub fn rejoins(&mut self, number: u32, now: Time, since_go: Duration) {
        self.activations.rejoin(now, since_go);
        self.processes.executers.each(|_, executer| executer.rejoins(number));
    }

    /// Returns whether its host takes part again, and its programs are not all up.
    pub fn is_rejoining(&self) -> bool {
        self.activations.is_rejoining()
    }

    /// Runs a process of this host, for its supervisor.
    pub(super) fn activate(&mut self, activation: Activation, out: &mut Out<'_>) {
        let Activation { target, number, decided, .. } = activation;
        let refuse = |origin: String, cause: FailureCause, at: Duration| Ending::Aborted(Failure { origin, cause, at });
        match target {
            target if self.is_leaving() => {
                let ending = refuse(String::new(), gone(), self.activations.since_go(out.now));
                self.site.tell_supervisor(target, number, ending, out);
            }
            target if self.activations.is_early(target, out.now) => self.activations.defer(activation),
            Target::Leaf(leaf) if self.externals.contains(leaf) => {
                if self.externals.attach(leaf, number) {
                    self.site.happened(target, Change::Activated, out);
                    self.end_watch_if_over(leaf, out);
                }
            }
            Target::Leaf(leaf) if self.refuse_held(leaf, number, out) => {}
            Target::Leaf(leaf) => {
                self.with_instance(leaf, out, |instance, context| {
                    instance.activate(number, activation.value, decided, context);
                });
            }
            Target::Group(group) => {
                if let Some(executer) = self.processes.executers.get(group).filter(|executer| executer.is_running()) {
                    if executer.activation() != number {
                        let (origin, at) = (self.site.group_path(group), self.activations.since_go(out.now));
                        let ending = refuse(origin, FailureCause::Busy, at);
                        self.site.tell_supervisor(target, number, ending, out);
                    }
                    return;
                }
                self.site.happened(target, Change::Activated, out);
                self.with_executer(group, out, |executer, at, out| {
                    executer.activate(number, &activation.value, at, out)
                });
            }
        }
    }

    /// Starts programs of this host again, together with a program that has died.
    pub(super) fn renew(&mut self, leaves: &[u32], with: &str, out: &mut Out<'_>) {
        for leaf in leaves {
            self.with_instance(*leaf, out, |instance, context| instance.renew(with, context));
        }
    }

    /// Stops an activation of a process of this host.
    pub(super) fn stop(&mut self, target: Target, activation: u32, out: &mut Out<'_>) {
        match target {
            target if self.activations.cancel(target, activation) => {
                self.site.tell_supervisor(target, activation, Ending::Stopped, out);
            }
            Target::Leaf(leaf) if self.externals.contains(leaf) => {
                if self.externals.detach(leaf, activation) {
                    self.site.ended(target, activation, Ending::Stopped, out);
                }
            }
            Target::Leaf(leaf) => self.with_instance(leaf, out, |instance, context| instance.stop(activation, context)),
            Target::Group(group) => {
                self.site.happened(target, Change::Stopping, out);
                self.with_executer(group, out, |executer, at, out| executer.stop(activation, at, out));
            }
        }
    }

    /// Refuses to begin a program that would use a device at the same time as a program that could
    /// not be ended. Returns whether it has refused the start.
    fn refuse_held(&self, leaf: u32, activation: u32, out: &mut Out<'_>) -> bool {
        let wanted = self.links.claims_of(&self.site, leaf);
        let holder = |other: u32| {
            let theirs = self.links.claims_of(&self.site, other);
            let (device, by) = wanted.first_conflict(&theirs)?;
            Some(FailureCause::DeviceHeld { device: device.to_owned(), by: by.to_owned() })
        };
        // If the program of the process itself has not ended, the process refuses to begin by itself.
        let others = self.processes.unconfirmed().into_iter().filter(|other| *other != leaf);
        let Some(cause) = others.into_iter().find_map(holder) else { return false };
        let origin = self.site.path(leaf).unwrap_or_default().to_owned();
        let ending = Ending::Aborted(Failure { origin, cause, at: self.activations.since_go(out.now) });
        self.site.ended(Target::Leaf(leaf), activation, ending, out);
        true
    }

    /// Returns the leaves of this host that stand for processes of other deployments.
    pub fn externals(&self) -> Vec<u32> {
        self.externals.leaves()
    }

    /// Returns the program that another deployment means by a path.
    pub fn served(&self, path: &str) -> Option<u32> {
        let is_meant = |leaf: &u32| self.path(*leaf) == Some(path) && !self.site.is_succeeded(*leaf);
        self.processes.instances.iter().map(|(leaf, _)| leaf).find(is_meant)
    }

    /// Returns what another deployment sees of a process here.
    ///
    /// # Errors
    /// Why it cannot be used, for a person.
    pub fn show(&self, wanted: &Wanted<'_>, programs: &Programs) -> Result<Seen, String> {
        let external = wanted.external;
        let name = &external.deployment;
        match self.phase {
            Phase::Preparing | Phase::Connecting => return Err(format!("`{name}` does not run yet")),
            Phase::Leaving => return Err(format!("`{name}` has ended")),
            Phase::Running => {}
        }
        let found = self.served(&external.path).and_then(|leaf| Some((leaf, self.site.leaf(leaf)?)));
        let (leaf, found) = found.ok_or_else(|| format!("`{name}` runs no `{}` there", external.path))?;
        wanted.check(found, programs)?;
        let instance = self.processes.instances.get(leaf).filter(|instance| instance.has_joined());
        let seen = instance.and_then(|instance| Seen::new(self.links.facts(leaf)?, instance.is_active()));
        match instance {
            Some(instance) if seen.is_some() && instance.is_gone() => Err(format!("{external} has died")),
            _ => seen.ok_or_else(|| format!("{external} is not there")),
        }
    }

    /// Returns which programs call a process of another deployment, by their keys; none outside of a team.
    pub fn callers(&self, leaf: u32) -> Vec<Partner> {
        let is_linked = matches!(self.phase, Phase::Connecting | Phase::Running);
        is_linked.then(|| self.links.callers(&self.site, leaf)).flatten().unwrap_or_default()
    }

    /// Takes note of the present state of a process of another deployment.
    pub fn sees(&mut self, leaf: u32, seen: Result<Seen, String>, out: &mut Out<'_>) {
        if !self.externals.sees(leaf, seen) {
            return;
        }
        if let Some(facts) = self.externals.facts(leaf).filter(|facts| self.links.facts(leaf) != Some(facts)) {
            self.links.tell_where(&self.site, &facts, out);
            self.links.moved(&self.site, &self.processes, facts, out);
        }
        self.end_watch_if_over(leaf, out);
    }

    fn end_watch_if_over(&mut self, leaf: u32, out: &mut Out<'_>) {
        let Some((activation, why)) = self.externals.end_if_over(&self.site, leaf) else { return };
        let (origin, at) = (self.site.path(leaf).unwrap_or_default().to_owned(), self.activations.since_go(out.now));
        let failure = Failure { origin, cause: FailureCause::NotAvailable(why), at };
        self.site.ended(Target::Leaf(leaf), activation, Ending::Aborted(failure), out);
    }

    /// Takes note of the programs of other deployments that call programs here, and informs the called programs.
    pub fn serve(&mut self, clients: BTreeMap<u32, Vec<Partner>>, out: &mut Out<'_>) {
        self.links.serve(&self.site, &self.processes, clients, out);
    }

    /// Takes note that a host is missing.
    pub fn host_missing(&mut self, host: &str, now: Time, out: &mut Out<'_>) {
        let stop = |(leaf, instance): (u32, &Instance)| match instance.link_loss() {
            LinkLoss::SafeStopAfter(time) if self.site.is_below(Target::Leaf(leaf), host) => Some((now + time, leaf)),
            LinkLoss::SafeStopAfter(_) | LinkLoss::Leave | LinkLoss::Keep | LinkLoss::Hold => None,
        };
        if self.loss.missing(host, self.processes.instances.iter().filter_map(stop)) {
            let news = ActivityInput::Notice(Notice::LinkLost(host.to_owned()));
            for group in self.processes.executers.numbers() {
                self.with_executer(group, out, |executer, at, out| executer.tell(&news, at, out));
            }
        }
    }

    /// Takes the loss of a host.
    pub fn host_lost(&mut self, host: &str, out: &mut Out<'_>) {
        // The host may be lost without having been missing: another boot has its name, or it no longer takes messages.
        self.host_missing(host, out.now, out);
        self.loss.lost(host);
        if host == self.site.home {
            if self.phase != Phase::Running || !self.processes.go_on_alone(&self.site) {
                return self.give_up(&unreached(host), out);
            }
            self.go_on_alone(out);
        } else {
            self.cut(self.supervised_from(host), host, out);
        }
        for group in self.processes.executers.numbers() {
            self.with_executer(group, out, |executer, at, out| executer.host_lost(host, at, out));
        }
        if host == self.site.home {
            // No answer is to be expected any more.
            self.checked_in(out);
        }
    }

    /// Takes note that a host is there again.
    pub fn host_back(&mut self, host: &str, out: &mut Out<'_>) {
        let was_lost = self.loss.back(host);
        self.processes.executers.each(|_, executer| executer.host_back(host));
        if was_lost {
            if host == self.site.home {
                return self.leave(out);
            }
            for target in self.supervised_from(host) {
                self.stop_for(target, host, out);
            }
        }
        self.processes.instances.each(|_, instance| instance.reach(host));
    }

    /// Stops the programs whose time without a host is over, and leaves once nothing continues without the home.
    pub(super) fn tick_loss(&mut self, out: &mut Out<'_>) {
        while let Some((leaf, host)) = self.loss.next_stop(out.now) {
            self.with_instance(leaf, out, |instance, context| instance.cut(&host, context));
        }
        if self.is_done_alone() {
            self.leave(out);
        }
    }

    pub(super) fn is_done_alone(&self) -> bool {
        self.phase == Phase::Running && self.is_home_lost() && !self.processes.go_on_alone(&self.site)
    }

    fn is_home_lost(&self) -> bool {
        self.loss.is_lost(&self.site.home)
    }

    fn go_on_alone(&mut self, out: &mut Out<'_>) {
        let home = self.site.home.clone();
        let groups = self.processes.executers.numbers();
        for group in groups.into_iter().filter(|group| !self.site.endures(*group)).collect::<Vec<_>>() {
            self.stop_for(Target::Group(group), &home, out);
        }
        for leaf in self.processes.instances.numbers() {
            self.follow_policy(leaf, &home, Instance::leave, out);
        }
    }

    /// Follows the policies of everything below these processes.
    fn cut(&mut self, mut targets: Vec<Target>, host: &str, out: &mut Out<'_>) {
        while let Some(target) = targets.pop() {
            match target {
                Target::Leaf(leaf) => {
                    self.follow_policy(leaf, host, |instance, context| instance.cut(host, context), out);
                }
                Target::Group(group) if self.site.endures(group) && self.processes.contains(target) => {
                    targets.extend(self.site.members(group));
                }
                Target::Group(_) => self.stop_for(target, host, out),
            }
        }
    }

    /// Has a program react to the loss of a host; `stop` stops it.
    fn follow_policy(
        &mut self,
        leaf: u32,
        host: &str,
        stop: impl FnOnce(&mut Instance, &mut InstanceContext<'_>),
        out: &mut Out<'_>,
    ) {
        self.with_instance(leaf, out, |instance, context| match instance.link_loss() {
            LinkLoss::Leave => stop(instance, context),
            LinkLoss::Hold => instance.hold(host),
            LinkLoss::Keep | LinkLoss::SafeStopAfter(_) => {}
        });
    }

    /// Stops the programs and groups here of a supervisor that cannot be reached, or has given them up.
    fn stop_for(&mut self, target: Target, host: &str, out: &mut Out<'_>) {
        match target {
            Target::Leaf(leaf) => self.with_instance(leaf, out, |instance, context| instance.cut(host, context)),
            Target::Group(group) => {
                self.with_executer(group, out, |executer, at, out| executer.stop(executer.activation(), at, out));
            }
        }
    }

    /// Returns the processes of this host whose supervisors are on another.
    fn supervised_from(&self, host: &str) -> Vec<Target> {
        self.site.supervised_from(host).filter(|target| self.processes.contains(*target)).collect()
    }

    /// Tells every program to go after an emergency stop. Supervisors on other hosts get this as the cause.
    pub fn stop_at_once(&mut self, estop: &Estop, out: &mut Out<'_>) {
        if self.phase == Phase::Leaving {
            return;
        }
        self.site.estop = Some(estop.clone());
        self.give_up(&estop.to_string(), out);
    }

    /// Tells every program to go, although the home has not asked for that. If the home waits for
    /// this part to prepare or to make its links, it gets the reason. Otherwise it could take the
    /// report that everything was released for an earlier report.
    pub fn give_up(&mut self, why: &str, out: &mut Out<'_>) {
        if matches!(self.phase, Phase::Preparing | Phase::Connecting) {
            self.site.refuse(why, out);
        }
        self.leave(out);
    }

    /// Tells every program to go.
    pub fn leave(&mut self, out: &mut Out<'_>) {
        if self.phase == Phase::Leaving {
            return;
        }
        self.phase = Phase::Leaving;
        self.activations.checked_in();
        let (since_go, start) = (self.activations.since_go(out.now), self.activations.start());
        self.processes.abandon_groups(&self.site, since_go, start, out);
        // The waiting activations never begin.
        for Activation { target, number, .. } in self.activations.take() {
            self.site.tell_supervisor(target, number, Ending::Stopped, out);
        }
        for leaf in self.processes.instances.numbers() {
            self.with_instance(leaf, out, Instance::leave);
        }
        self.report_released(out);
    }

    /// Tells the home once nothing of it is left here.
    pub(super) fn report_released(&self, out: &mut Out<'_>) {
        if self.is_over() {
            let is_confirmed = self.processes.unconfirmed().is_empty();
            let message = if is_confirmed { ToCoordinator::Released } else { ToCoordinator::Unconfirmed };
            self.site.tell_home(message, out);
        }
    }

    /// Returns the programs that may still be there although everything was done to end them.
    pub fn unconfirmed(&self) -> BTreeSet<u32> {
        self.processes.unconfirmed()
    }

    /// Returns the programs that have stopped while work outside of them may continue, each with a description of the work.
    pub fn may_go_on(&self) -> Vec<String> {
        self.processes.open_work(&self.site)
    }

    /// Returns whether this part ends here.
    pub fn is_leaving(&self) -> bool {
        self.phase == Phase::Leaving
    }

    /// Returns whether nothing of it is left here.
    pub fn is_over(&self) -> bool {
        self.phase == Phase::Leaving && self.processes.instances.are_over()
    }
}
