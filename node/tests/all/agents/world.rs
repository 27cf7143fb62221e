//! Several agents on virtual time, the frames between them, and programs that follow a script.

use super::adoption::Written;
use super::switching::{Data, Traffic};
use comms::logic::control::{MessageFate, Notice};
use comms::logic::time::Time;
use language::plan::{PORTS, Plan, Policy};
use language::{Options, Source, compile};
use node::logic::agent::{Agent, Identity, Input};
use node::logic::effect::{Effect, ProcessId, SpawnOrder};
use node::logic::nameserver::Change;
use node::logic::node_state::NodeState;
use node::logic::programs::Programs;
use node::logic::protocol::{
    Answer, ChangeRequest, Deployment, Earlier, Ending, Estop, Kept, Namesake, Report, Request, StartMode, Tombstone,
};
use shim::protocol::{ShimOrder, ShimReport};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

const MODULES: &str = "
module Step(host) { in In: Number; out Out: Number; done; }
module Long(host) { in In: Number; out Out: Number; done; }
module Walker(host, way: Text = good) { done; }
module Sensor(host) { out Out: Number; service; }
module Stubborn(host) { done; stop within 100 ms; }
module Arm(host) { done; claims arm; }
module Eye(host) { done; claims arm(read); }
module Owner(host) { done; }
module Server(host) { proc Drive(Number) -> Number; service; claims wheels; }
module Client(host) { calls Go(Number) -> Number; service; }
module Tuned(host, way: Text = good) { in In: Number; in Other: Number; out Out: Number; service; }
module Mic(host) { out Heard: Text; service; }
module Speaker(host) { in Words: Text; service; }
module Script(host) { exec \"sh Script\"; plain; done; }
";

/// Something that will happen to a host.
#[derive(Debug)]
pub(super) enum Coming {
    Input(Input),
    /// A word of a program, which counts as long as no other has taken its place.
    Notice(ProcessId, u32, Notice),
    /// The end of an activation, if it is still running in the same program.
    Finish(ProcessId, u32, u32),
    /// Something of the data that goes from program to program.
    Data(Data),
}

#[derive(Debug, Default)]
pub(super) struct World {
    pub(super) now: Time,
    pub(super) agents: BTreeMap<String, NodeState>,
    /// The records of each node, for a successor.
    pub(super) written: BTreeMap<String, Written>,
    /// The nodes that were killed, and the messages that wait for them.
    pub(super) down: BTreeMap<String, Vec<Coming>>,
    /// The host whose node is killed with its next input, and the number of effects that are still carried out.
    pub(super) dies_after: Option<(String, usize)>,
    /// The nodes that are suspended: their systems take frames for them.
    pub(super) suspended_nodes: BTreeMap<String, NodeState>,
    /// Every start and activation of a program: when, where, and its path.
    pub(super) begins: Vec<(Time, String, String)>,
    /// Every part of a deployment that is over: when and where.
    pub(super) closed: Vec<(Time, String)>,
    /// How many orders each program has taken, and how many its shim.
    pub(super) took: BTreeMap<ProcessId, (u64, u64)>,
    pub(super) coming: BTreeMap<(Time, u64), (String, Coming)>,
    pub(super) counter: u64,
    pub(super) running: BTreeMap<(String, ProcessId), u32>,
    pub(super) modules: BTreeMap<ProcessId, String>,
    /// The command that each program was started with last.
    pub(super) commands: BTreeMap<ProcessId, Vec<String>>,
    pub(super) alive: BTreeSet<(String, ProcessId)>,
    /// How often each program was started.
    pub(super) lives: BTreeMap<ProcessId, u32>,
    /// The policies that each program was started with, by its path.
    pub(super) spawned: BTreeMap<String, Vec<Policy>>,
    /// The programs that were told that the others run already.
    pub(super) rejoining: BTreeSet<ProcessId>,
    /// The sessions that each program dials.
    pub(super) dialled: BTreeMap<ProcessId, BTreeSet<String>>,
    pub(super) cut: BTreeSet<String>,
    /// The pairs of hosts between which no message arrives, sender first.
    pub(super) one_way: BTreeSet<(String, String)>,
    /// The boot number of each host.
    pub(super) boots: BTreeMap<String, u64>,
    /// The boots that each host deals with.
    pub(super) holders: BTreeMap<String, BTreeMap<String, u64>>,
    /// The last round in which each host has asked for the presence of others.
    pub(super) rounds: BTreeMap<String, u64>,
    /// The messages to other nodes of the own name.
    pub(super) greeted: Vec<Namesake>,
    /// The changes of other nodes, as each host saw them.
    pub(super) changes: Vec<(String, Change)>,
    /// One frame in this many is lost, if any.
    pub(super) loses_one_in: Option<u64>,
    /// By chance one frame in this many is lost, if any.
    pub(super) loses_by_chance: Option<(Draw, u64)>,
    pub(super) transmitted: u64,
    /// The deployments that were asked for.
    pub(super) calls: Vec<u64>,
    pub(super) answers: BTreeMap<u64, Vec<Answer>>,
    pub(super) wires_open: BTreeSet<u32>,
    /// The program that opened each wire last.
    pub(super) openers: BTreeMap<u32, ProcessId>,
    pub(super) log: Vec<String>,
    pub(super) plan: Option<Plan>,
    /// Whether shims fail to end their programs.
    pub(super) immortal: bool,
    /// Whether shims are suspended, and do not hear their orders.
    pub(super) suspended: bool,
    /// The programs whose output was requested.
    pub(super) tailed: Vec<Vec<ProcessId>>,
    /// The calls with no more answers.
    pub(super) answered: BTreeSet<u64>,
    /// Whether programs leave at once with exit code 1.
    pub(super) fails_at_start: bool,
    /// The ends that each host has written down.
    pub(super) settled: Vec<(String, Deployment)>,
    /// The record on each host of the user who has stopped everything.
    pub(super) estops: BTreeMap<String, Option<Estop>>,
    /// The running deployments on each host's disk.
    pub(super) kept: BTreeMap<String, BTreeMap<u64, Kept>>,
    /// The tombstones on the disk of each host.
    pub(super) tombstones: BTreeMap<String, Vec<Tombstone>>,
    /// Whether programs do not leave when asked to.
    pub(super) lingers: bool,
    /// Whether programs never send a hello.
    pub(super) hangs_at_start: bool,
    /// The last lines that programs write before they end.
    pub(super) output: Vec<String>,
    /// How long the disk takes to write something down.
    pub(super) disk_ms: u64,
    /// Why the disk takes nothing.
    pub(super) disk_refuses: Option<String>,
    /// Whether the hosts are in a team.
    pub(super) is_guarded: bool,
    /// The judged orders, with their hosts.
    pub(super) judged: Vec<(String, Deployment)>,
    /// The outcomes of accepted orders, with their hosts.
    pub(super) ended: Vec<(String, Result<(), String>)>,
    /// The reason for which others' orders are refused.
    pub(super) verdict: Option<String>,
    /// The data between programs.
    pub(super) traffic: Traffic,
    /// The version of the control protocol that programs speak, if it is another.
    pub(super) version: Option<u16>,
    pub(super) start: StartMode,
    /// By how much the boot clock of a host is ahead.
    pub(super) ahead: BTreeMap<String, Duration>,
    /// When each program has begun for the first time.
    pub(super) begun: BTreeMap<ProcessId, Time>,
    /// The values that programs have sent for activities, with their outputs.
    pub(super) sent: Vec<(String, Vec<u8>)>,
    /// The fates of messages for activities, by their numbers.
    pub(super) fates: Vec<(u64, MessageFate)>,
}

impl World {
    pub(super) fn new(hosts: &[&str]) -> Self {
        Self::with(hosts, false)
    }

    /// Hosts in a team: the orders of others are judged.
    pub(super) fn guarded(hosts: &[&str]) -> Self {
        Self::with(hosts, true)
    }

    fn with(hosts: &[&str], is_guarded: bool) -> Self {
        let mut world = Self { is_guarded, ..Self::default() };
        for (boot, host) in (1..).zip(hosts) {
            let (own, machine, open) = ((*host).to_owned(), (*host).to_owned(), Vec::new());
            let identity = Identity {
                host: own,
                boot,
                pid: 1,
                machine,
                epoch: 0,
                open,
                is_guarded,
                estop: None,
                earlier: Earlier::default(),
            };
            let agent = Agent::new(identity, offered(), Time::ZERO);
            world.agents.insert((*host).into(), NodeState::new(agent, Time::ZERO));
            world.boots.insert((*host).into(), boot);
        }
        for (boot, from) in (1..).zip(hosts) {
            for to in hosts.iter().filter(|to| *to != from) {
                world.at(0, to, Coming::Input(Input::Appeared { host: (*from).into(), boot }));
            }
        }
        world
    }

    pub(super) fn at(&mut self, millis: u64, host: &str, coming: Coming) {
        self.counter += 1;
        self.coming.insert((self.now + Duration::from_millis(millis), self.counter), (host.into(), coming));
    }

    pub(super) fn deploy(&mut self, home: &str, text: &str) -> u64 {
        self.deploy_as("test", home, text)
    }

    pub(super) fn deploy_as(&mut self, name: &str, home: &str, text: &str) -> u64 {
        let options = Options::named(name);
        let spec = Source::new("test.dca", text);
        let compiled = compile(&spec, &[Source::new("modules", MODULES)], &options);
        let plan = compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics));
        self.plan = Some(plan.clone());
        self.counter += 1;
        let call = self.counter;
        self.calls.push(call);
        let request = Box::new(Request::Deploy { request: call, plan, by: "ann".into(), start: self.start });
        self.at(0, home, Coming::Input(Input::Call { call, request }));
        call
    }

    pub(super) fn ask(&mut self, host: &str, request: Request) -> u64 {
        self.counter += 1;
        let (call, request) = (self.counter, Box::new(request));
        self.at(0, host, Coming::Input(Input::Call { call, request }));
        call
    }

    /// Asks for a change of the deployment `test`, which is at this epoch and revision.
    pub(super) fn change(&mut self, home: &str, text: &str, (epoch, revision): (u64, u32), again: &[&str]) -> u64 {
        let compiled =
            compile(&Source::new("test.dca", text), &[Source::new("modules", MODULES)], &Options::named("test"));
        let plan = compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics));
        let (name, by, again) = ("test".into(), "ann".into(), again.iter().map(|path| (*path).to_owned()).collect());
        let probation = Duration::from_secs(2);
        self.ask(home, Request::Change(Box::new(ChangeRequest { name, epoch, revision, plan, again, probation, by })))
    }

    pub(super) fn stop(&mut self, home: &str) -> u64 {
        self.counter += 1;
        let call = self.counter;
        let request = Box::new(Request::Stop { name: "test".into() });
        self.at(0, home, Coming::Input(Input::Call { call, request }));
        call
    }

    pub(super) fn run_for(&mut self, span: Duration) {
        let end = self.now + span;
        loop {
            let event = self.coming.first_key_value().map(|((time, _), _)| *time);
            let timer = self.agents.iter().filter_map(|(host, node)| self.here(host, node.agent.deadline()?)).min();
            let Some(next) = event.into_iter().chain(timer).min().filter(|next| *next <= end) else { break };
            self.now = self.now.max(next);
            let due = self.coming.first_key_value().is_some_and(|((time, _), _)| *time <= self.now);
            if let Some((_, (host, coming))) = due.then(|| self.coming.pop_first()).flatten() {
                self.happen(&host, coming);
            } else {
                for host in self.agents.keys().cloned().collect::<Vec<_>>() {
                    self.give(&host, Input::Tick);
                }
            }
        }
        self.now = end;
    }

    fn happen(&mut self, host: &str, coming: Coming) {
        if let Coming::Data(data) = coming {
            return self.data(host, data);
        }
        if let Some(held) = self.down.get_mut(host) {
            // Reports of programs and shims wait for the next node; everything else is lost, except frames for a
            // suspended node.
            let sleeps = self.suspended_nodes.contains_key(host);
            let is_kept = match &coming {
                Coming::Input(Input::Frame(_)) => sleeps,
                Coming::Input(input) => matches!(input, Input::Shim { .. } | Input::Control { .. }),
                _ => true,
            };
            return held.extend(Some(coming).filter(|_| is_kept));
        }
        match coming {
            Coming::Data(_) => {}
            Coming::Input(input) => self.give(host, input),
            Coming::Notice(process, life, notice) => {
                if self.lives[&process] == life {
                    self.give(host, Input::Control { process, notice });
                }
            }
            Coming::Finish(process, life, activation) => {
                let runs = self.running.get(&(host.into(), process.clone())) == Some(&activation);
                if runs && self.lives[&process] == life {
                    self.finish(host, process, activation);
                }
            }
        }
    }

    pub(super) fn give(&mut self, host: &str, input: Input) {
        let Some(mut node) = self.agents.remove(host) else { return };
        let (now, mut effects) = (self.there(host), Vec::new());
        self.written.entry(host.to_owned()).or_insert_with(|| Written::of(&node)).input(now, &input);
        node.take(now, input, &mut effects);
        let dies_after = self.dies_after.take_if(|(dying, _)| dying == host).map(|(_, count)| count);
        let count = dies_after.unwrap_or(effects.len());
        self.agents.insert(host.to_owned(), node);
        for effect in effects.into_iter().take(count) {
            self.carry_out(host, effect);
        }
        if dies_after.is_some() {
            self.crash(host);
        }
    }

    pub(super) fn carry_out(&mut self, host: &str, effect: Effect) {
        match effect {
            Effect::Transmit { to, frame } => self.transmit(host, &to, frame),
            Effect::Ping { round, only, .. } => self.ping(host, round, only.as_ref()),
            Effect::Greet(namesake) => self.greeted.push(*namesake),
            Effect::Holders(holders) => drop(self.holders.insert(host.into(), holders)),
            Effect::Peer(change) => self.changes.push((host.into(), change)),
            Effect::Spawn(order) => self.spawn(host, *order),
            Effect::Shim { process, order } if self.took(&process, false) => match order {
                ShimOrder::Stop { .. } | ShimOrder::Kill if self.immortal || self.suspended => {}
                ShimOrder::Stop { .. } | ShimOrder::Kill => {
                    self.die(host, &process, ShimReport::Signalled { signal: 15 });
                }
                ShimOrder::Go => self.run(host, &process, 1),
            },
            Effect::Control { process, order } if self.took(&process, true) => self.order(host, &process, order),
            // It is gone, and its report tells this.
            Effect::Shim { .. } | Effect::Control { .. } => {}
            Effect::Answer { call, answer } => self.answer(call, *answer),
            Effect::KillShim { .. } if self.immortal => {}
            Effect::KillShim { process } => self.die(host, &process, ShimReport::Signalled { signal: 9 }),
            Effect::Settled { deployment } => self.settled.push((host.into(), deployment)),
            Effect::KeepEstop { number, estop } => self.keep_estop(host, number, estop),
            Effect::Keep(kept) => {
                let files = self.kept.entry(host.into()).or_default();
                if self.disk_refuses.is_none() {
                    files.insert(kept.deployment.epoch, *kept);
                }
            }
            Effect::Unkeep { deployment } => {
                let written = self.written();
                if written.is_ok() {
                    self.kept.entry(host.into()).or_default().remove(&deployment.epoch);
                }
                self.at(self.disk_ms, host, Coming::Input(Input::Unkept { deployment, written }));
            }
            Effect::KeepAll(all) => {
                self.kept.insert(host.into(), all.into_iter().map(|kept| (kept.deployment.epoch, kept)).collect());
            }
            Effect::KeepTombstones(all) => drop(self.tombstones.insert(host.into(), all)),
            Effect::FindPrograms { deployment, number, programs } => {
                let is_missing = |order: &SpawnOrder| order.command.iter().any(|word| word == "way=missing");
                let problem = |SpawnOrder { path, .. }| format!("`{path}` cannot be started: there is no such program");
                let problems = programs.into_iter().filter(is_missing).map(problem).collect();
                self.at(1, host, Coming::Input(Input::Found { deployment, number, problems }));
            }
            Effect::PersistEpoch { deployment, .. } => {
                let written = self.written();
                self.at(self.disk_ms, host, Coming::Input(Input::Committed { deployment, written }));
            }
            Effect::EndAnswers { call } => drop(self.answered.insert(call)),
            Effect::Tail { process, .. } => self.tailed.push(vec![process]),
            Effect::TailAll { deployment, programs, .. } => {
                let process = |(leaf, _)| ProcessId { deployment: deployment.clone(), leaf };
                self.tailed.push(programs.into_iter().map(process).collect());
            }
            Effect::CloseProcess { .. } | Effect::WriteDatabase(_) | Effect::Yield { .. } => {}
            Effect::CloseDeployment { .. } => self.closed.push((self.now, host.into())),
            Effect::Beat(_) => {}
            Effect::OrderEnded { outcome, .. } => self.ended.push((host.into(), outcome)),
            Effect::Judge { number, deployment, .. } => {
                self.judged.push((host.into(), deployment));
                let verdict = self.verdict.clone().map_or(Ok(()), Err);
                self.at(self.disk_ms, host, Coming::Input(Input::Judged { number, verdict }));
            }
            Effect::JudgeResumed { deployment, .. } => {
                self.judged.push((host.into(), deployment.clone()));
                let verdict = self.verdict.clone().map_or(Ok(()), Err);
                self.at(1, host, Coming::Input(Input::Resumable { deployment, verdict }));
            }
            Effect::Leave => self.leave(host),
        }
    }

    /// Takes a node away: it answers and sends nothing any more.
    fn leave(&mut self, host: &str) {
        self.agents.remove(host);
        let boot = self.boots.remove(host).expect("a node leaves once");
        for other in self.agents.keys().cloned().collect::<Vec<_>>() {
            self.at(1, &other, Coming::Input(Input::Vanished { host: host.to_owned(), boot }));
        }
    }

    /// Returns how the deployment ended.
    pub(super) fn last_report(&self, call: u64) -> &Report {
        match self.answers[&call].last() {
            Some(Answer::Report(report)) => report,
            other => panic!("no report but {other:?}"),
        }
    }

    pub(super) fn ending(&self, call: u64) -> &Ending {
        match self.last_report(call) {
            Report::Finished { ending, unconfirmed, .. } => {
                assert_eq!(unconfirmed, &Vec::<String>::new());
                ending
            }
            other => panic!("not finished: {other:?}"),
        }
    }
}

/// The programs that every host offers.
pub(super) fn offered() -> Programs {
    let mut programs = Programs::default();
    let types = ["Step", "Long", "Sensor", "Stubborn", "Arm", "Eye", "Owner", "Tuned", "Server", "Client", "Walker"];
    programs.offer("controllers", types.map(str::to_owned));
    programs.offer("controllers", ["Mic", "Speaker", PORTS].map(str::to_owned));
    programs
}

/// A small linear congruential generator; its random numbers do not have to be good. Source: Knuth, MMIX.
#[derive(Debug)]
pub(super) struct Draw(u64);

impl Draw {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(super) fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % bound
    }

    pub(super) fn index(&mut self, bound: u64) -> usize {
        usize::try_from(self.below(bound)).expect("it is small")
    }
}
