//! A deployment's part on this host: its programs and the supervisors of its groups.
//!
//! Life: `Preparing` (programs started, each has said where it is or why not) → `Connecting` (links made, closed) →
//! `Running` → `Leaving` (every program told to go) → nothing. The home node orders each step. If
//! the home node is lost, the participant leaves by itself, unless the spec says that some of its
//! programs continue (`loss`).
//!
//! This file passes each input to the part that it concerns, and each report of a program or
//! supervisor to the parts that depend on this report. `life` prepares, runs and ends the
//! processes, `change` changes the deployment while it runs. The parts:
//!
//! - `site`: the deployment, the place of this host in it, and the messages about it.
//! - `roll`: the reports of programs before GO. `activation`: the activations that wait.
//! - `processes`: the programs and supervisors. `links`: their wires. `external`: processes of other deployments.
//! - `loss`: the hosts that cannot be reached. `progress`: a change. `succession`: programs that take the place of others.
//!
//! Between two inputs, `progress` exists only during a change. Only `Running` has changes, and activations that watch
//! processes of other deployments. `roll` waits for programs only while it is `Preparing` or `Connecting`.

mod activation;
mod change;
mod external;
mod life;
mod links;
mod loss;
mod processes;
mod progress;
mod roll;
mod site;
mod status;
mod succession;

use crate::logic::agent::Identity;
use crate::logic::claims::Claims;
use crate::logic::effect::{Out, earliest};
use crate::logic::executer::{Counted, ExecContext, Executer, MemberRef, Sending, Taking, leaf_host};
use crate::logic::instance::{Instance, InstanceContext, Note};
use crate::logic::programs::Programs;
use crate::logic::protocol::{
    AbsentProcess, ActivityInput, Change, Deployment, DeploymentStatus, Ending, InstanceParameters, Names,
    ProcessStatus, Taken, Target, ToCoordinator, ToParticipant,
};
pub(in crate::logic) use activation::gone;
use activation::{Activation, Activations};
use comms::logic::control::{Dial, MessageFate, Notice, Order, PortMessage};
use comms::logic::time::Time;
use external::Externals;
pub use external::{Seen, Wanted};
use language::plan::Plan;
use life::WOKEN_LATE_MIN;
use links::{Asked, ExpectedSwitch, Links, TakenValues, ask_for_latched, outside_of_switch};
use loss::Loss;
use processes::Processes;
use progress::Progress;
use roll::Roll;
use serde::{Deserialize, Serialize};
use shim::protocol::ShimReport;
use site::Site;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use succession::{Successions, Supervisor};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Phase {
    Preparing,
    Connecting,
    Running,
    Leaving,
}

/// A deployment's part on this host.
#[derive(Debug, Serialize, Deserialize)]
pub struct Participant {
    site: Site,
    phase: Phase,
    roll: Roll,
    processes: Processes,
    links: Links,
    claims: Claims,
    externals: Externals,
    loss: Loss,
    activations: Activations,
    /// The change of the deployment, while there is one.
    change: Option<Progress>,
    successions: Successions,
}

impl Participant {
    /// Starts every program of `host`, idle. `seen` is the state here of the processes of other deployments that it
    /// uses. Answers with `Prepared` or `Refused` when all have reported.
    pub fn prepare(
        deployment: Deployment,
        plan: Arc<Plan>,
        place: &Identity,
        programs: &Programs,
        seen: BTreeMap<u32, Result<Seen, String>>,
        out: &mut Out<'_>,
    ) -> Self {
        let site = Site::new(deployment, plan, place);
        let mut processes = Processes::default();
        processes.add_supervisors(&site);
        let mut participant = Self {
            claims: Claims::of(&site.plan, &site.host),
            links: Links::new(&site.plan),
            site,
            phase: Phase::Preparing,
            roll: Roll::default(),
            processes,
            externals: Externals::default(),
            loss: Loss::default(),
            activations: Activations::default(),
            change: None,
            successions: Successions::default(),
        };
        participant.find_externals(seen);
        participant.start_programs(programs, out);
        participant.report_prepared(out);
        participant
    }

    /// Returns the host of `main`.
    pub fn home(&self) -> &str {
        &self.site.home
    }

    /// Returns every host that takes part.
    pub fn hosts(&self) -> &[String] {
        &self.site.plan.hosts
    }

    /// Returns the plan that it is a part of.
    pub fn plan(&self) -> &Plan {
        &self.site.plan
    }

    /// Returns the path of a leaf.
    pub fn path(&self, leaf: u32) -> Option<&str> {
        self.site.path(leaf)
    }

    /// Returns the hosts whose loss matters here: the home, the hosts of all processes that are
    /// supervised from here on any level, and the hosts that supervise a process here. The loss of
    /// any other host is left to its supervisors.
    pub fn relevant_hosts(&self) -> &BTreeSet<String> {
        &self.site.relevant
    }

    /// Returns the devices it holds on this host.
    pub fn claims(&self) -> &Claims {
        &self.claims
    }

    /// Returns how many of the participant's machines were looked at in total.
    pub fn visits(&self) -> u64 {
        self.processes.visits()
    }

    /// Returns the running processes, in the plan's order.
    pub fn status(&self) -> DeploymentStatus {
        let mut processes: Vec<ProcessStatus> =
            self.processes.status(&self.site).chain(self.externals.status(&self.site)).collect();
        processes.sort_by(|a, b| a.path.cmp(&b.path));
        let phase = match self.phase {
            Phase::Preparing => "preparing",
            Phase::Connecting => "connecting",
            Phase::Running => "running",
            Phase::Leaving => "ending",
        };
        let (deployment, home) = (self.site.deployment.clone(), self.site.home.clone());
        let (lost, refused, undelivered) = Default::default();
        DeploymentStatus { deployment, home, phase: phase.to_owned(), processes, lost, refused, undelivered }
    }

    /// Returns the processes on hosts that are away.
    pub fn elsewhere(&self, is_away: impl Fn(&str) -> bool) -> Vec<AbsentProcess> {
        self.site.elsewhere(is_away)
    }

    /// Adds the names that it has given out on this host.
    pub fn names(&self, programs: &Programs, names: &mut Names) {
        names.ports.extend(self.processes.port_names(&self.site, programs));
        names.devices.extend(self.claims.names(&self.site.deployment));
    }

    /// Returns the programs of this host that have a data session, and where to dial each now.
    pub fn locations(&self) -> Vec<(String, Dial)> {
        self.processes.locations(&self.site, &self.links)
    }

    /// Returns the parameters that can be sent to the programs of this host while they run.
    pub fn parameters(&self, programs: &Programs) -> Vec<InstanceParameters> {
        self.processes.parameters(&self.site, programs)
    }

    /// Returns parameters that the database gives to the instance of a path, as its program gets them.
    pub fn in_si(&self, programs: &Programs, path: &str, stored: Vec<(String, String)>) -> Vec<(String, String)> {
        self.site.in_si(programs, path, stored)
    }

    /// Returns the programs of this host: leaf and absolute path.
    pub fn programs(&self) -> Vec<(u32, String)> {
        self.processes.programs(&self.site)
    }

    /// Takes a message about this deployment.
    pub fn receive(&mut self, message: ToParticipant, from: &str, out: &mut Out<'_>) {
        match message {
            // It is prepared already: that is how it came to be.
            ToParticipant::Prepare { .. } | ToParticipant::Rejoin { .. } => {}
            ToParticipant::Connect { facts, machines } => self.connect(facts, machines, out),
            ToParticipant::Go => {
                self.activations.has_rejoined();
                self.go(out.now);
                self.start_at(None, out);
            }
            ToParticipant::GoAt { start } => {
                self.go(out.now);
                self.start_at(Some(start), out);
            }
            ToParticipant::ReadClock { asked } => {
                self.activations.await_moment();
                self.site.tell_home(ToCoordinator::ClockRead { asked, shown: out.now }, out);
            }
            ToParticipant::Reopen { host } => {
                self.each_executer(out, |executer, at, out| executer.reopen(&host, at, out));
            }
            ToParticipant::Release => self.leave(out),
            ToParticipant::Activate { target, activation, value, ago } => {
                self.go(out.now);
                let decided = out.now.before(ago);
                self.activate(Activation { target, number: activation, value, decided }, out);
            }
            ToParticipant::Stop { target, activation } => self.stop(target, activation, out),
            ToParticipant::Ended { target, activation, ending } => self.member_ended(target, activation, ending, out),
            ToParticipant::Succeed { group, leaf, activation, value } => {
                let by = Supervisor { group, host: from.to_owned() };
                self.succeed(by, leaf, activation, value, out);
            }
            ToParticipant::Switch { .. }
            | ToParticipant::Flip { .. }
            | ToParticipant::Expect { .. }
            | ToParticipant::ExpectAnd { .. }
            | ToParticipant::Switched { .. }
            | ToParticipant::Expecting { .. }
            | ToParticipant::Taken { .. }
            | ToParticipant::Succeeding { .. }
            | ToParticipant::SwitchSets { .. } => self.follow_switch(message, from, out),
            ToParticipant::Tell { .. } => self.tell_activity(message, out),
            ToParticipant::Loose { target, hosts } => {
                let Some((group, slot)) = self.site.supervisor(target) else { return };
                let hosts = hosts.into_iter().collect();
                self.tell_executer(group, out, |executer, at, out| executer.loosened(slot, hosts, at, out));
            }
            ToParticipant::Cleared { host } => {
                self.each_executer(out, |executer, at, out| executer.host_cleared(&host, at, out));
            }
            ToParticipant::Restarted { target, cause } => {
                let Some((group, slot)) = self.site.supervisor(target) else { return };
                self.with_executer(group, out, |executer, at, out| executer.member_restarted(slot, &cause, at, out));
            }
            ToParticipant::Repeat { wires } => self.links.repeat(&self.site, &self.processes, &wires, from, out),
            ToParticipant::Renew { leaves, with } => self.renew(&leaves, &with, out),
            // The agent has already taken the programs that a change starts: `take_change`.
            ToParticipant::Change(_) | ToParticipant::Ordered(_) => {}
            ToParticipant::Moved { facts } => {
                if leaf_host(&self.site.plan, facts.leaf) == Some(from) {
                    self.links.moved(&self.site, &self.processes, facts, out);
                }
            }
        }
    }

    /// Carries out a part of a switch: opens and closes wires of programs on this host, or tells a supervisor of this host.
    fn follow_switch(&mut self, message: ToParticipant, from: &str, out: &mut Out<'_>) {
        let Self { site, processes, links, .. } = &mut *self;
        let asked = |group, generation| Asked { group, generation, host: from.to_owned() };
        if let ToParticipant::Switch { wires, open, group, generation } = message {
            links.flip(site, processes, outside_of_switch(&wires, open), asked(group, generation), out);
        } else if let ToParticipant::Flip { group, generation, flip } = message {
            links.flip(site, processes, flip, asked(group, generation), out);
        } else if let ToParticipant::Expect { group, leaf, expect } = message {
            links.expect(site, processes, ExpectedSwitch { group, leaf, expect, then: None }, from, out);
        } else if let ToParticipant::ExpectAnd { group, leaf, expect, then } = message {
            links.expect(site, processes, ExpectedSwitch { group, leaf, expect, then: Some(then) }, from, out);
        } else if let ToParticipant::Switched { group, generation } = message {
            self.tell_executer(group, out, |executer, at, out| executer.switched(generation, at, out));
        } else if let ToParticipant::Expecting { group, leaf, generation } = message {
            self.tell_executer(group, out, |executer, at, out| executer.expecting(generation, leaf, at, out));
        } else if let ToParticipant::Taken { group, leaf, generation, lost, late, missing } = message {
            let counted = Counted { lost, late, missing: missing.into_iter().collect() };
            self.tell_executer(group, out, |executer, at, out| executer.taken(generation, leaf, counted, at, out));
        } else if let ToParticipant::Succeeding { group, leaf, is_handed_over } = message {
            self.tell_executer(group, out, |executer, at, out| executer.succeeding(leaf, is_handed_over, at, out));
        } else if let ToParticipant::SwitchSets { group, slot, sets, call } = message {
            self.tell_executer(group, out, |executer, at, out| executer.switch_sets(slot, &sets, call, at, out));
        }
    }

    /// Tells a supervisor of this host how a member has ended.
    fn member_ended(&mut self, target: Target, activation: u32, ending: Ending, out: &mut Out<'_>) {
        let Some((group, slot)) = self.site.supervisor(target) else { return };
        self.with_executer(group, out, |executer, at, out| {
            if !executer.speaks(slot, target, at, out) {
                return None;
            }
            executer.ended(MemberRef { slot, activation }, ending, at, out)
        });
    }

    /// Gives an order to an activity. If a user waits, the home gets the answer.
    fn tell_activity(&mut self, message: ToParticipant, out: &mut Out<'_>) {
        let ToParticipant::Tell { group, told, by, call } = message else { return };
        let first = out.messages.len();
        let answer = self.give(group, &told, by.as_deref(), out);
        if let Some(call) = call {
            self.site.tell_home(ToCoordinator::Answered { call, taken: answer }, out);
            // The deployment may end by the order, and the answer comes before that.
            if let Some(consequences) = out.messages.get_mut(first..) {
                consequences.rotate_right(1);
            }
        }
    }

    /// Gives an order to an activity whose supervisor is on this host, and returns how it has reacted.
    ///
    /// # Errors
    /// Why it has not taken the order.
    pub fn give(
        &mut self,
        group: u32,
        told: &ActivityInput,
        by: Option<&str>,
        out: &mut Out<'_>,
    ) -> Result<Taken, String> {
        let mut answer = Err("its supervisor is not here".to_owned());
        self.with_executer(group, out, |executer, at, out| {
            let Taking { ending, taken } = executer.tell_by(told, by, at, out);
            answer = taken;
            ending
        });
        answer
    }

    /// Hands a message to the activity whose ports a program has, and reports its fate to the program.
    fn take_message(&mut self, leaf: u32, message: PortMessage, out: &mut Out<'_>) {
        let (number, mut fate) = (message.number, MessageFate::Idle);
        if let Some(group) = self.site.activity_of(leaf) {
            self.with_executer(group, out, |executer, at, out| {
                let (said, ending) = executer.take_message(message, at, out);
                fate = said;
                ending
            });
        }
        self.processes.ask(leaf, Order::Received { number, fate }, out);
    }

    /// Has a program send the values of an activity.
    fn send_values(&mut self, group: u32, sendings: Vec<Sending>, out: &mut Out<'_>) {
        // Most groups send nothing, and each group is asked at each event.
        if sendings.is_empty() {
            return;
        }
        let Some((_, leaf)) = self.site.plan.ports_of(group) else { return };
        for Sending { number, port, value } in sendings {
            if !self.processes.ask(leaf, Order::Send { number, port: port.clone(), value }, out) {
                self.tell_executer(group, out, |executer, at, out| {
                    executer.value_sent(number);
                    executer.not_sent(&port, at, out);
                });
            }
        }
    }

    /// Refuses a controller that has said hello, since it must not run beside something else.
    pub fn refuse(&mut self, leaf: u32, why: &str, out: &mut Out<'_>) {
        self.with_instance(leaf, out, |instance, context| instance.turn_away(why, context));
    }

    /// Takes a word from a controller.
    pub fn hear(&mut self, leaf: u32, notice: Notice, out: &mut Out<'_>) {
        let is_running = matches!(notice, Notice::Running { .. });
        self.with_instance(leaf, out, |instance, context| instance.hear(notice, context));
        if is_running {
            self.has_begun(leaf, out);
        }
    }

    /// Takes a word from a shim.
    pub fn observe(&mut self, leaf: u32, report: ShimReport, output: Vec<String>, out: &mut Out<'_>) {
        self.with_instance(leaf, out, |instance, context| instance.observe(report, output, context));
    }

    /// Takes note that an order did not reach a program.
    pub fn undelivered(&mut self, leaf: u32, why: String, out: &mut Out<'_>) {
        self.with_instance(leaf, out, |instance, context| instance.undelivered(why, context));
    }

    /// Takes note of parameters that a program was told of while the deployment runs.
    pub fn configured(&self, leaf: u32, parameters: Vec<(String, Option<String>)>, out: &mut Out<'_>) {
        if self.phase == Phase::Running {
            self.site.configured(leaf, parameters, out);
        }
    }

    /// Lets time pass.
    pub fn tick(&mut self, out: &mut Out<'_>) {
        self.tick_loss(out);
        self.tick_check_in(out);
        self.begin_together(WOKEN_LATE_MIN, out);
        for leaf in self.processes.instances.due(out.now) {
            self.with_instance(leaf, out, Instance::tick);
        }
        for group in self.processes.executers.due(out.now) {
            self.with_executer(group, out, Executer::tick);
        }
    }

    /// Returns when [`Participant::tick`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        let alone = self.is_done_alone().then_some(Time::ZERO);
        [alone, self.loss.deadline(), self.activations.deadline(), self.processes.deadline()]
            .into_iter()
            .fold(None, earliest)
    }

    /// Adds a program, and takes its reports.
    fn insert_instance(
        &mut self,
        leaf: u32,
        out: &mut Out<'_>,
        make: impl FnOnce(&mut InstanceContext<'_>) -> Instance,
    ) {
        let (mut notes, since_go) = (Vec::new(), self.activations.since_go(out.now));
        let instance = make(&mut InstanceContext { now: out.now, since_go, effects: out.effects, notes: &mut notes });
        self.processes.instances.insert(leaf, instance);
        for note in notes {
            self.note(leaf, note, out);
        }
    }

    /// Does something with a program, and takes its reports.
    fn with_instance(
        &mut self,
        leaf: u32,
        out: &mut Out<'_>,
        act: impl FnOnce(&mut Instance, &mut InstanceContext<'_>),
    ) {
        let (mut notes, since_go) = (Vec::new(), self.activations.since_go(out.now));
        let mut context = InstanceContext { now: out.now, since_go, effects: out.effects, notes: &mut notes };
        self.processes.instances.with(leaf, |instance| act(instance, &mut context));
        for note in notes {
            self.note(leaf, note, out);
        }
    }

    fn note(&mut self, leaf: u32, note: Note, out: &mut Out<'_>) {
        let target = Target::Leaf(leaf);
        match note {
            Note::Prepared(facts) if self.is_adding(leaf) => self.added(facts, out),
            Note::Refused(why) if self.is_adding(leaf) => self.not_added(leaf, &why, out),
            Note::Connected if self.is_adding(leaf) => {
                self.with_instance(leaf, out, Instance::is_added);
                self.linked(leaf, Ok(()), out);
            }
            Note::Prepared(facts) => {
                self.hold_own(&facts);
                self.roll.prepared(facts);
                self.report_prepared(out);
            }
            Note::Refused(why) => {
                self.roll.refused(leaf, why);
                self.report_prepared(out);
                self.report_connected(out);
            }
            Note::Connected => {
                self.roll.connected(leaf);
                self.report_connected(out);
            }
            Note::Switched(ticket) => self.links.switched(&self.site, leaf, ticket, out),
            Note::Expecting(ticket) => self.links.expects(&self.site, ticket, out),
            Note::Taken { ticket, lost, late, missing } => {
                self.links.taken(&self.site, ticket, TakenValues { lost, late, missing }, out);
            }
            Note::Message(message) => self.take_message(leaf, message, out),
            Note::Sent(number) => {
                if let Some(group) = self.site.activity_of(leaf) {
                    self.tell_executer(group, out, |executer, _, _| executer.value_sent(number));
                }
            }
            Note::Ended(activation, ending) => self.activation_ended(leaf, activation, ending, out),
            Note::EndedLate(activation) => {
                self.site.happened(target, Change::EndedLate, out);
                // The end of an activation that is not current decides nothing; it only releases resources.
                self.site.tell_supervisor(target, activation, Ending::Stopped, out);
            }
            Note::Changed(change) => self.changed(leaf, change, out),
            Note::Moved(facts) => {
                self.hold_own(&facts);
                self.rejoin(facts, out);
            }
            Note::Rejoined => {
                let open = self.links.reopen(&self.site, leaf);
                self.with_instance(leaf, out, |instance, context| instance.resume(open, context));
                ask_for_latched(&self.site, leaf, out);
            }
            Note::Linked(made) => self.linked(leaf, made, out),
            Note::Replaced => self.replaced(leaf, out),
            Note::Healthy => self.healthy(leaf, out),
            Note::Unhealthy(why) => self.unhealthy(leaf, &why, out),
            Note::Gone => {
                self.removed(leaf);
                self.report_released(out);
            }
        }
    }

    /// Takes the end of an activation of a program.
    fn activation_ended(&mut self, leaf: u32, activation: u32, ending: Ending, out: &mut Out<'_>) {
        if let Some(next) = self.successions.ended(leaf, &ending) {
            return self.with_instance(leaf, out, |instance, context| {
                instance.activate(next.activation, next.value, context.now, context);
            });
        }
        let (target, ending) = (Target::Leaf(leaf), self.site.as_removed(leaf, ending));
        if !self.site.is_succeeded(leaf) {
            self.site.happened(target, Change::Ended(ending.clone()), out);
        }
        self.site.tell_supervisor(target, activation, ending, out);
        self.forget_switches(leaf, out);
    }

    /// Takes a change of a program.
    fn changed(&mut self, leaf: u32, change: Change, out: &mut Out<'_>) {
        if matches!(change, Change::Died(_) | Change::Restarting { .. } | Change::Renewing { .. }) {
            self.forget_switches(leaf, out);
            self.forget_linking(leaf, out);
            if let Some(group) = self.site.activity_of(leaf) {
                self.tell_executer(group, out, |executer, at, out| executer.ports_lost(at, out));
            }
        }
        if let Change::Restarting { cause, .. } = &change {
            self.site.tell_restart(Target::Leaf(leaf), cause, out);
        }
        // Users see a process with two programs as one.
        if matches!(change, Change::Stopping | Change::Ended(Ending::Stopped)) && self.site.is_succeeded(leaf) {
            return;
        }
        let is_next = change == Change::Activated && self.successions.contains(leaf);
        let change = if is_next { Change::Replacing } else { change };
        self.site.happened(Target::Leaf(leaf), change, out);
    }

    /// A program that is gone no longer takes part in switches.
    fn forget_switches(&mut self, leaf: u32, out: &mut Out<'_>) {
        if !self.processes.is_linked(leaf) {
            self.links.forget_program(&self.site, leaf, out);
        }
    }

    /// Does something with a supervisor, and takes its values and its end.
    fn with_executer(
        &mut self,
        group: u32,
        out: &mut Out<'_>,
        act: impl FnOnce(&mut Executer, ExecContext<'_>, &mut Out<'_>) -> Option<Ending>,
    ) {
        let context = self.site.context(self.activations.since_go(out.now), self.activations.start());
        let acted = self
            .processes
            .executers
            .with(group, |executer| (act(executer, context, out), executer.activation(), executer.take_sendings()));
        self.report_handover(out);
        let Some((ending, activation, sendings)) = acted else { return };
        self.send_values(group, sendings, out);
        if let Some(ending) = ending {
            self.site.ended(Target::Group(group), activation, ending, out);
        }
    }

    fn each_executer(&mut self, out: &mut Out<'_>, act: impl Fn(&mut Executer, ExecContext<'_>, &mut Out<'_>)) {
        for group in self.processes.executers.numbers() {
            self.tell_executer(group, out, &act);
        }
    }

    fn tell_executer(
        &mut self,
        group: u32,
        out: &mut Out<'_>,
        act: impl FnOnce(&mut Executer, ExecContext<'_>, &mut Out<'_>),
    ) {
        self.with_executer(group, out, |executer, at, out| {
            act(executer, at, out);
            None
        });
    }
}
