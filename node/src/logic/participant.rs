//! A deployment's part on this host: its programs and the supervisors of its groups.
//!
//! Life: `Preparing` (programs started, each has said where it is or why not) → `Connecting` (links made, closed) →
//! `Running` → `Leaving` (every program told to go) → nothing. The home node moves it along; if the home node is lost the
//! participant leaves by itself, unless the spec wants something of it to go on (`loss`).

mod activation;
mod change;
mod external;
mod links;
mod loss;
mod report;
mod status;
mod succession;

use crate::logic::agent::Identity;
use crate::logic::claims::Claims;
use crate::logic::effect::{Out, earliest};
use crate::logic::executer::{Counted, ExecContext, Executer, below_using, group_host, leaf_host};
use crate::logic::instance::{Instance, InstanceContext, Note};
use crate::logic::programs::Programs;
use crate::logic::protocol::{Change, Deployment, Ending, Estop, LeafFacts, Target, ToCoordinator, ToParticipant};
use crate::logic::timed::TimedMap;
pub(in crate::logic) use activation::gone;
use activation::{Together, WOKEN_LATE_MIN};
use change::{Changes, supervisors};
use comms::logic::control::Notice;
use comms::logic::time::Time;
use external::ExternalProcess;
pub use external::{Seen, Wanted};
use language::plan::Plan;
use links::{Asked, Links};
use loss::Loss;
use serde::{Deserialize, Serialize};
use shim::protocol::ShimReport;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use succession::Supervisor;

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
    instances: TimedMap<Instance>,
    executers: TimedMap<Executer>,
    links: Links,
    claims: Claims,
    /// Processes of other deployments that it uses on this host, by the leaves that stand for them.
    externals: BTreeMap<u32, ExternalProcess>,
    loss: Loss,
    changes: Changes,
    together: Together,
    /// The emergency stop that ends it, if one does.
    estop: Option<Estop>,
}

/// The deployment, and the place of this host in it.
#[derive(Debug, Serialize, Deserialize)]
struct Site {
    deployment: Deployment,
    plan: Arc<Plan>,
    home: String,
    /// This host.
    host: String,
    machine: String,
    /// For each process, the group and slot that supervise it.
    supervisors: BTreeMap<Target, (u32, u32)>,
    /// The other hosts whose loss is one for something here.
    relevant: BTreeSet<String>,
}

impl Site {
    /// Returns the surroundings of the supervisors here.
    fn context(&self, since_go: Duration, start: Time) -> ExecContext<'_> {
        let Self { deployment, home, plan, .. } = self;
        ExecContext { deployment, home, plan, since_go, start }
    }

    fn tell_home(&self, message: ToCoordinator, out: &mut Out<'_>) {
        out.send(&self.home, self.deployment.to_coordinator(message));
    }

    fn tell(&self, host: &str, message: ToParticipant, out: &mut Out<'_>) {
        out.send(host, self.deployment.to_participant(message));
    }

    /// Returns the path of a leaf.
    fn path(&self, leaf: u32) -> Option<&str> {
        self.plan.leaves.get(leaf as usize).map(|leaf| leaf.path.as_str())
    }

    /// Returns the path of a group.
    fn group_path(&self, group: u32) -> String {
        self.plan.groups.get(group as usize).map(|group| group.path.clone()).unwrap_or_default()
    }

    /// Returns the host on which a process is supervised.
    fn supervisor_host(&self, target: Target) -> Option<&str> {
        self.supervisors.get(&target).and_then(|(group, _)| group_host(&self.plan, *group))
    }
}

/// The programs that prepare or make their links, and their reports so far.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Roll {
    waiting: BTreeSet<u32>,
    facts: Vec<LeafFacts>,
    reasons: Vec<String>,
    /// Why programs cannot take part, and which.
    refusals: BTreeMap<String, Vec<u32>>,
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
        let (host, machine) = (place.host.as_str(), place.machine.clone());
        let home = plan.home().unwrap_or(host).to_owned();
        let live = plan.live_groups();
        let is_mine = |number: &u32| live.contains(number) && group_host(&plan, *number) == Some(host);
        let groups = (0_u32..).zip(&plan.groups).filter(|(number, _)| is_mine(number));
        let below = below_using(&plan);
        let supervisor = |number: u32| Some((number, Executer::new(&plan, number, below.contains(&number))?));
        let executers = groups.filter_map(|(number, _)| supervisor(number)).collect();
        let mut participant = Self {
            claims: Claims::of(&plan, host),
            links: Links { live: plan.live_wires(), ..Links::default() },
            site: Site {
                supervisors: supervisors(&plan),
                relevant: loss::relevant(&plan, host),
                deployment,
                plan,
                home,
                host: host.to_owned(),
                machine,
            },
            phase: Phase::Preparing,
            roll: Roll::default(),
            instances: TimedMap::default(),
            executers,
            externals: BTreeMap::new(),
            loss: Loss::default(),
            changes: Changes::default(),
            together: Together::default(),
            estop: None,
        };
        participant.find_externals(seen);
        participant.start_programs(host, programs, out);
        participant.report_prepared(out);
        participant
    }

    /// Starts each program of this host, unless there is a reason against one of them, or another deployment runs it.
    fn start_programs(&mut self, host: &str, offered: &Programs, out: &mut Out<'_>) {
        let starts = match self.starts(&self.site.plan, host, offered) {
            Ok(starts) if self.roll.reasons.is_empty() => starts,
            Ok(_) => return,
            Err(problems) => {
                let reasons = problems.into_iter().map(|why| format!("host `{host}`: {why}"));
                return self.roll.reasons.extend(reasons);
            }
        };
        for (number, start) in starts {
            let (mut notes, since_go) = (Vec::new(), Duration::ZERO);
            let mut context = InstanceContext { now: out.now, since_go, effects: out.effects, notes: &mut notes };
            self.roll.waiting.insert(number);
            self.instances.insert(number, Instance::spawn(start, &mut context));
        }
    }

    /// Returns the host of `main`.
    pub fn home(&self) -> &str {
        &self.site.home
    }

    /// Returns every host that takes part.
    pub fn hosts(&self) -> &[String] {
        &self.site.plan.hosts
    }

    /// Takes a message about this deployment.
    pub fn receive(&mut self, message: ToParticipant, from: &str, out: &mut Out<'_>) {
        match message {
            // It is prepared already: that is how it came to be.
            ToParticipant::Prepare { .. } | ToParticipant::Rejoin { .. } => {}
            ToParticipant::Connect { facts, machines } => self.connect(facts, machines, out),
            ToParticipant::Go => {
                self.together.rejoining = false;
                self.go(out.now);
                self.start_at(None, out);
            }
            ToParticipant::GoAt { start } => {
                self.go(out.now);
                self.start_at(Some(start), out);
            }
            ToParticipant::ReadClock { asked } => self.read_clock(asked, out),
            ToParticipant::Reopen { host } => {
                self.each_executer(out, |executer, at, out| executer.reopen(&host, at, out));
            }
            ToParticipant::Release => self.leave(out),
            ToParticipant::Activate { target, activation, value } => {
                self.go(out.now);
                self.activate(target, activation, value, out);
            }
            ToParticipant::Stop { target, activation } => self.stop(target, activation, out),
            ToParticipant::Ended { target, activation, ending } => self.member_ended(target, activation, ending, out),
            ToParticipant::Switch { wires, open, group, generation } => {
                self.switch(&wires, open, Asked { group, generation, host: from.to_owned() }, out);
            }
            ToParticipant::Switched { group, generation } => {
                self.tell_executer(group, out, |executer, at, out| executer.switched(generation, at, out));
            }
            ToParticipant::Flip { group, generation, flip } => {
                self.flip(flip, Asked { group, generation, host: from.to_owned() }, out);
            }
            ToParticipant::Expect { group, leaf, expect } => self.expect(leaf, expect, None, group, from, out),
            ToParticipant::ExpectAnd { group, leaf, expect, then } => {
                self.expect(leaf, expect, Some(then), group, from, out);
            }
            ToParticipant::Succeed { group, leaf, activation, value } => {
                let by = Supervisor { group, host: from.to_owned() };
                self.succeed(by, leaf, activation, value, out);
            }
            ToParticipant::Expecting { .. }
            | ToParticipant::Taken { .. }
            | ToParticipant::Succeeding { .. }
            | ToParticipant::SwitchSets { .. } => self.follow_switch(message, out),
            ToParticipant::Tell { group, told, by, call } => self.tell_activity(group, &told, by.as_deref(), call, out),
            ToParticipant::Loose { target, hosts } => {
                let Some(&(group, slot)) = self.site.supervisors.get(&target) else { return };
                self.tell_executer(group, out, |executer, at, out| {
                    executer.loosened(slot, hosts.into_iter().collect(), at, out);
                });
            }
            ToParticipant::Cleared { host } => {
                self.each_executer(out, |executer, at, out| executer.host_cleared(&host, at, out));
            }
            ToParticipant::Restarted { target, cause } => {
                let Some(&(group, slot)) = self.site.supervisors.get(&target) else { return };
                self.with_executer(group, out, |executer, at, out| executer.member_restarted(slot, &cause, at, out));
            }
            ToParticipant::Repeat { wires } => self.repeat(&wires, from, out),
            ToParticipant::Renew { leaves, with } => self.renew(&leaves, &with, out),
            // The agent has already taken the programs that a change starts: `take_change`.
            ToParticipant::Change(_) | ToParticipant::Ordered(_) => {}
            ToParticipant::Moved { facts } => {
                if leaf_host(&self.site.plan, facts.leaf) == Some(from) {
                    self.moved(facts, out);
                }
            }
        }
    }

    /// Starts programs of this host again, together with one that has died.
    fn renew(&mut self, leaves: &[u32], with: &str, out: &mut Out<'_>) {
        for leaf in leaves {
            self.with_instance(*leaf, out, |instance, context| instance.renew(with, context));
        }
    }

    /// Passes a message about a switch on to a supervisor of this host.
    fn follow_switch(&mut self, message: ToParticipant, out: &mut Out<'_>) {
        if let ToParticipant::Expecting { group, leaf, generation } = message {
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

    /// Returns the devices it holds on this host.
    pub fn claims(&self) -> &Claims {
        &self.claims
    }

    /// Returns the path of a leaf.
    pub fn path(&self, leaf: u32) -> Option<&str> {
        self.site.path(leaf)
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

    /// Returns the plan that it is a part of.
    pub fn plan(&self) -> &Plan {
        &self.site.plan
    }

    /// Takes note that its node was gone: no program could answer it in the meantime.
    pub fn adopted(&mut self, away: Duration) {
        self.instances.each(|_, instance| instance.adopted(away));
    }

    /// Lets time pass.
    pub fn tick(&mut self, out: &mut Out<'_>) {
        self.tick_loss(out);
        self.tick_check_in(out);
        self.begin_together(WOKEN_LATE_MIN, out);
        for leaf in self.instances.due(out.now) {
            self.with_instance(leaf, out, Instance::tick);
        }
        for group in self.executers.due(out.now) {
            self.with_executer(group, out, Executer::tick);
        }
    }

    /// Returns when [`Participant::tick`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        let first = earliest(earliest(self.loss_deadline(), self.check_in_deadline()), self.starts_at());
        [self.instances.deadline(), self.executers.deadline()].into_iter().fold(first, earliest)
    }

    fn go(&mut self, now: Time) {
        if self.phase == Phase::Connecting {
            self.phase = Phase::Running;
        }
        self.together.go_at.get_or_insert(now);
    }

    fn with_instance(
        &mut self,
        leaf: u32,
        out: &mut Out<'_>,
        act: impl FnOnce(&mut Instance, &mut InstanceContext<'_>),
    ) {
        let mut notes = Vec::new();
        let since_go = self.since_go(out.now);
        let mut context = InstanceContext { now: out.now, since_go, effects: out.effects, notes: &mut notes };
        self.instances.with(leaf, |instance| act(instance, &mut context));
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
                self.roll.facts.push(facts);
                self.roll.waiting.remove(&leaf);
                self.report_prepared(out);
            }
            Note::Refused(why) => {
                self.roll.refusals.entry(why).or_default().push(leaf);
                self.roll.waiting.remove(&leaf);
                if self.phase == Phase::Preparing { self.report_prepared(out) } else { self.report_connected(out) }
            }
            Note::Connected => {
                self.roll.waiting.remove(&leaf);
                self.report_connected(out);
            }
            Note::Switched(ticket) => self.confirm_switch(leaf, ticket, out),
            Note::Expecting(ticket) => self.confirm_expecting(ticket, out),
            Note::Taken { ticket, lost, late, missing } => self.confirm_taken(ticket, lost, late, missing, out),
            Note::Message(message) => self.take_message(leaf, message, out),
            Note::Sent(number) => self.value_sent(leaf, number, out),
            Note::Ended(activation, ending) => {
                if self.begins_again(leaf, &ending, out) {
                    return;
                }
                if !self.is_succeeded(leaf) {
                    self.happened(target, Change::Ended(ending.clone()), out);
                }
                self.tell_supervisor(target, activation, ending, out);
                self.forget_switches(leaf, out);
            }
            Note::EndedLate(activation) => {
                self.happened(target, Change::EndedLate, out);
                // The end of an activation that is not current decides nothing; it only releases resources.
                self.tell_supervisor(target, activation, Ending::Stopped, out);
            }
            Note::Changed(change) => {
                if matches!(change, Change::Died(_) | Change::Restarting { .. } | Change::Renewing { .. }) {
                    self.forget_switches(leaf, out);
                    self.forget_linking(leaf, out);
                    self.ports_lost(leaf, out);
                }
                if let Change::Restarting { cause, .. } = &change {
                    self.tell_restart(target, cause, out);
                }
                self.tell_change(leaf, change, out);
            }
            Note::Moved(facts) => {
                self.hold_own(&facts);
                self.rejoin(facts, out);
            }
            Note::Rejoined => self.resume(leaf, out),
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

    fn with_executer(
        &mut self,
        group: u32,
        out: &mut Out<'_>,
        act: impl FnOnce(&mut Executer, ExecContext<'_>, &mut Out<'_>) -> Option<Ending>,
    ) {
        let context = self.site.context(self.since_go(out.now), self.together.start());
        let acted = self
            .executers
            .with(group, |executer| (act(executer, context, out), executer.activation(), executer.take_sendings()));
        self.report_handover(out);
        let Some((ending, activation, sendings)) = acted else { return };
        self.send_values(group, sendings, out);
        let Some(ending) = ending else { return };
        let target = Target::Group(group);
        self.happened(target, Change::Ended(ending.clone()), out);
        self.tell_supervisor(target, activation, ending, out);
    }

    fn each_executer(&mut self, out: &mut Out<'_>, act: impl Fn(&mut Executer, ExecContext<'_>, &mut Out<'_>)) {
        for group in self.executers.numbers() {
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

    fn since_go(&self, now: Time) -> Duration {
        self.together.go_at.map_or(Duration::ZERO, |at| now - at)
    }
}
