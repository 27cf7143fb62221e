//! Whole nodes on virtual time: agents, the frames between them, and programs that behave as a script says.

#![expect(clippy::wildcard_enum_match_arm, reason = "a test looks for one variant and shows any other")]

use comms::logic::control::{Location, Notice, Order};
use comms::logic::time::Time;
use language::{Options, Source, compile};
use node::logic::agent::{Agent, Identity, Input};
use node::logic::child::{ShimOrder, ShimReport};
use node::logic::effect::{Effect, ProcessId};
use node::logic::programs::Programs;
use node::logic::protocol::{Answer, Change, Ending, FailureCause, Report, Request, StopReply};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

const MODULES: &str = "
module Step(host) { in In: Number; out Out: Number; done; }
module Long(host) { in In: Number; out Out: Number; done; }
module Sensor(host) { out Out: Number; service; }
module Stubborn(host) { done; stop within 100 ms; }
";

/// Something that will happen to a host.
#[derive(Debug)]
enum Coming {
    Input(Input),
    /// The end of an activation, if it is still running.
    Finish(ProcessId, u32),
}

#[derive(Debug, Default)]
struct World {
    now: Time,
    agents: BTreeMap<String, Agent>,
    coming: BTreeMap<(Time, u64), (String, Coming)>,
    counter: u64,
    running: BTreeMap<(String, ProcessId), u32>,
    modules: BTreeMap<ProcessId, String>,
    alive: BTreeSet<(String, ProcessId)>,
    cut: BTreeSet<String>,
    answers: BTreeMap<u64, Vec<Answer>>,
    wires_open: BTreeSet<u32>,
    log: Vec<String>,
    /// Whether shims fail to end their programs.
    immortal: bool,
}

impl World {
    fn new(hosts: &[&str]) -> Self {
        let mut world = Self::default();
        for (boot, host) in (1..).zip(hosts) {
            let identity = Identity { host: (*host).into(), boot, pid: 1, machine: (*host).into(), epoch: 0 };
            let mut programs = Programs::default();
            programs.offer("controllers", ["Step", "Long", "Sensor", "Stubborn"].map(str::to_owned));
            world.agents.insert((*host).into(), Agent::new(identity, programs, Time::ZERO));
        }
        for (boot, from) in (1..).zip(hosts) {
            for to in hosts.iter().filter(|to| *to != from) {
                world.at(0, to, Coming::Input(Input::Appeared { host: (*from).into(), boot }));
            }
        }
        world
    }

    fn at(&mut self, millis: u64, host: &str, coming: Coming) {
        self.counter += 1;
        self.coming.insert((self.now + Duration::from_millis(millis), self.counter), (host.into(), coming));
    }

    fn deploy(&mut self, home: &str, text: &str) -> u64 {
        let options = Options::named("test");
        let spec = Source::new("test.dca", text);
        let compiled = compile(&spec, &[Source::new("modules", MODULES)], &options);
        let plan = compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics));
        self.counter += 1;
        let call = self.counter;
        let request = Box::new(Request::Deploy { request: call, plan });
        self.at(0, home, Coming::Input(Input::Call { call, request }));
        call
    }

    fn stop(&mut self, home: &str) -> u64 {
        self.counter += 1;
        let call = self.counter;
        let request = Box::new(Request::Stop { name: "test".into() });
        self.at(0, home, Coming::Input(Input::Call { call, request }));
        call
    }

    fn run_for(&mut self, span: Duration) {
        let end = self.now + span;
        loop {
            let event = self.coming.first_key_value().map(|((time, _), _)| *time);
            let timer = self.agents.values().filter_map(Agent::deadline).min();
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
        match coming {
            Coming::Input(input) => self.give(host, input),
            Coming::Finish(process, activation) => {
                if self.running.get(&(host.into(), process.clone())) == Some(&activation) {
                    self.running.remove(&(host.to_owned(), process.clone()));
                    let notice = Notice::Done { activation, value: vec![] };
                    self.give(host, Input::Control { process, notice });
                }
            }
        }
    }

    fn give(&mut self, host: &str, input: Input) {
        let Some(agent) = self.agents.get_mut(host) else { return };
        let mut effects = Vec::new();
        agent.handle(self.now, input, &mut effects);
        for effect in effects {
            self.carry_out(host, effect);
        }
    }

    fn notice(&mut self, millis: u64, host: &str, process: &ProcessId, notice: Notice) {
        if self.alive.contains(&(host.to_owned(), process.clone())) {
            self.at(millis, host, Coming::Input(Input::Control { process: process.clone(), notice }));
        }
    }

    fn report(&mut self, host: &str, process: &ProcessId, report: ShimReport) {
        let input = Input::Shim { process: process.clone(), report, last_words: None };
        self.at(1, host, Coming::Input(input));
    }

    /// Ends a program as `kill -9` does.
    fn kill(&mut self, host: &str, leaf: u32) {
        let found = self.alive.iter().find(|(on, process)| on == host && process.leaf == leaf);
        let (_, process) = found.expect("the program is alive").clone();
        self.die(host, &process, ShimReport::Signalled { signal: 9 });
    }

    fn die(&mut self, host: &str, process: &ProcessId, how: ShimReport) {
        self.alive.remove(&(host.to_owned(), process.clone()));
        self.running.remove(&(host.to_owned(), process.clone()));
        self.report(host, process, how);
        self.report(host, process, ShimReport::Gone);
    }

    fn carry_out(&mut self, host: &str, effect: Effect) {
        match effect {
            Effect::Transmit { to, frame } => {
                if !self.cut.contains(host) && !self.cut.contains(&to) {
                    self.at(1, &to, Coming::Input(Input::Frame(frame)));
                }
            }
            Effect::Spawn(order) => {
                let process = order.process.clone();
                self.alive.insert((host.into(), process.clone()));
                self.modules.insert(process.clone(), order.command[1].clone());
                self.report(host, &process, ShimReport::Started { pid: 100 + process.leaf });
                let location = Some(Location {
                    session: format!("{host}{}", process.leaf),
                    local: vec!["unix".into()],
                    remote: vec!["tcp".into()],
                });
                let (owns, needs) = (vec![], vec![]);
                let hello = Notice::Hello { version: 1, instance: order.path, location, owns, needs, signals: false };
                self.notice(5, host, &process, hello);
            }
            Effect::Shim { process, order } => match order {
                ShimOrder::Stop { .. } | ShimOrder::Kill if self.immortal => {}
                ShimOrder::Stop { .. } | ShimOrder::Kill => {
                    self.die(host, &process, ShimReport::Signalled { signal: 15 });
                }
                ShimOrder::Go => {}
            },
            Effect::Control { process, order } => self.order(host, &process, order),
            Effect::Answer { call, answer } => self.answers.entry(call).or_default().push(*answer),
            Effect::Commit { .. } | Effect::EndAnswers { .. } | Effect::Forget { .. } | Effect::Bury { .. } => {}
            Effect::Tail { .. } | Effect::Leave => {}
        }
    }

    fn order(&mut self, host: &str, process: &ProcessId, order: Order) {
        let module = self.modules[process].clone();
        match order {
            Order::Connect { .. } => self.notice(3, host, process, Notice::Connected),
            Order::Open { wires, generation } => {
                self.wires_open.extend(wires);
                self.notice(2, host, process, Notice::Switched { generation });
            }
            Order::Close { wires, generation } => {
                self.wires_open.retain(|wire| !wires.contains(wire));
                self.notice(2, host, process, Notice::Switched { generation });
            }
            Order::Activate { activation, .. } => {
                self.log.push(format!("{module} with wires {:?}", self.wires_open));
                self.running.insert((host.into(), process.clone()), activation);
                self.notice(1, host, process, Notice::Running { activation });
                let lasts = match module.as_str() {
                    "Step" => 50,
                    "Long" => 10_000,
                    _ => return,
                };
                self.at(lasts, host, Coming::Finish(process.clone(), activation));
            }
            Order::Stop { activation } => {
                self.running.remove(&(host.to_owned(), process.clone()));
                if module != "Stubborn" {
                    self.notice(4, host, process, Notice::Stopped { activation });
                }
            }
            Order::Exit => self.die(host, process, ShimReport::Exited { code: 0 }),
        }
    }

    /// Returns how the deployment ended.
    fn last_report(&self, call: u64) -> &Report {
        match self.answers[&call].last() {
            Some(Answer::Report(report)) => report,
            other => panic!("no report but {other:?}"),
        }
    }

    fn ending(&self, call: u64) -> &Ending {
        match self.last_report(call) {
            Report::Finished { ending, unconfirmed, .. } => {
                assert_eq!(unconfirmed, &Vec::<String>::new());
                ending
            }
            other => panic!("not finished: {other:?}"),
        }
    }
}

const TWO_HOSTS: &str = r#"
process Pair(here, there) {
    host { there }
    instantiated_processes {
        sensor instof Sensor(here);
        first instof Step(there);
        second instof Step(here);
    }
    internal_connections(sensor, feed) { sensor, Out -> first, In; }
    internal_connections(first, on) { first, Out -> second, In; }
    internal_event_actions { sensor[feed] , (first[on] ; second) }
}
process main() {
    host { "c1" }
    instantiated_processes { pair instof Pair("c1", "c2"); last instof Step("c2"); }
    internal_event_actions { pair ; last }
}
"#;

#[test]
fn a_spec_on_two_hosts_runs_to_its_end_and_leaves_nothing() {
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    assert_eq!(world.alive, BTreeSet::new());
    assert_eq!(world.wires_open, BTreeSet::new());
    let expected = ["Sensor with wires {0, 1}", "Step with wires {0, 1}", "Step with wires {0}", "Step with wires {}"];
    assert_eq!(world.log, expected);
}

#[test]
fn a_crash_ends_the_mission_with_its_cause() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", &TWO_HOSTS.replace("first instof Step", "first instof Long"));
    world.run_for(Duration::from_millis(500));
    world.kill("c1", 0);
    world.run_for(Duration::from_secs(3));
    let Ending::Aborted(failure) = world.ending(call) else { panic!("not aborted") };
    assert_eq!((failure.origin.as_str(), &failure.cause), ("main/pair/sensor", &FailureCause::Signal(9)));
    assert!(failure.to_string().starts_with("main ← pair ← sensor: SIGKILL at 0."), "{failure}");
    assert_eq!(world.alive, BTreeSet::new());
}

#[test]
fn a_program_that_died_idle_fails_when_its_turn_comes() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_millis(40));
    world.kill("c2", 3);
    world.run_for(Duration::from_secs(5));
    let Ending::Aborted(failure) = world.ending(call) else { panic!("not aborted") };
    assert_eq!((failure.origin.as_str(), &failure.cause), ("main/last", &FailureCause::Signal(9)));
}

#[test]
fn stop_ends_it_everywhere_even_what_does_not_listen() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy(
        "c1",
        &TWO_HOSTS
            .replace("first instof Step", "first instof Stubborn")
            .replace("[feed]", "")
            .replace("[on]", "")
            .replace("sensor, Out -> first, In;", "")
            .replace("first, Out -> second, In;", ""),
    );
    world.run_for(Duration::from_millis(500));
    let stop = world.stop("c1");
    world.run_for(Duration::from_secs(10));
    assert_eq!(world.ending(call), &Ending::Stopped);
    assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
    assert_eq!(world.alive, BTreeSet::new());
}

#[test]
fn every_reason_of_every_host_is_told_and_nothing_stays() {
    let mut world = World::new(&["c1", "c2"]);
    for host in ["c1", "c2"] {
        let identity = Identity { host: host.into(), boot: 9, pid: 1, machine: host.into(), epoch: 0 };
        world.agents.insert(host.into(), Agent::new(identity, Programs::default(), Time::ZERO));
    }
    world.at(0, "c1", Coming::Input(Input::Appeared { host: "c2".into(), boot: 9 }));
    world.at(0, "c2", Coming::Input(Input::Appeared { host: "c1".into(), boot: 9 }));
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(20));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    assert!(reasons.iter().any(|reason| reason.contains("host `c1`") && reason.contains("`Sensor`")), "{reasons:?}");
    assert!(reasons.iter().any(|reason| reason.contains("host `c2`") && reason.contains("`Step`")), "{reasons:?}");
}

#[test]
fn a_host_that_nobody_has_seen_refuses_at_once() {
    let mut world = World::new(&["c1"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(5));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    assert!(reasons.iter().any(|reason| reason.contains("host `c2` cannot be reached")), "{reasons:?}");
    assert_eq!(world.alive, BTreeSet::new());
}

#[test]
fn a_lost_host_aborts_what_ran_there_and_a_short_cut_does_not() {
    let long = TWO_HOSTS.replace("last instof Step", "last instof Long");
    for (cut_for, survives) in [(2, true), (9, false)] {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", &long);
        world.run_for(Duration::from_secs(1));
        world.cut.insert("c2".into());
        for (on, lost, boot) in [("c1", "c2", 2), ("c2", "c1", 1)] {
            world.at(900, on, Coming::Input(Input::Vanished { host: lost.into(), boot }));
        }
        world.run_for(Duration::from_secs(cut_for));
        world.cut.clear();
        for (on, back, boot) in [("c1", "c2", 2), ("c2", "c1", 1)] {
            world.at(100, on, Coming::Input(Input::Appeared { host: back.into(), boot }));
        }
        world.run_for(Duration::from_secs(40));
        let ending = match world.last_report(call) {
            Report::Finished { ending, .. } => ending,
            other => panic!("{other:?}"),
        };
        match ending {
            Ending::Done(_) => assert!(survives),
            Ending::Aborted(failure) => {
                assert!(!survives, "{failure}");
                assert_eq!(failure.cause, FailureCause::HostLost("c2".into()));
            }
            other => panic!("{other:?}"),
        }
        assert_eq!(world.alive, BTreeSet::new(), "a host that lost its home leaves by itself");
    }
}

/// Here `Stubborn` ignores the stop, and its shim cannot kill it either: the detector of the inner group fires, and what
/// stays unconfirmed there must not look like a clean stop to the group above.
#[test]
fn a_stop_that_nobody_confirms_is_told_to_the_top() {
    let text = r#"
process Inner(here) {
    instantiated_processes { rock instof Stubborn(here); hit instof Step(here); }
    internal_event_actions { rock # hit }
}
process main() {
    host { "c1" }
    instantiated_processes { inner instof Inner("c1"); last instof Step("c1"); }
    internal_event_actions { inner ; last }
}
"#;
    let mut world = World::new(&["c1"]);
    world.immortal = true;
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_secs(30));
    let Report::Finished { ending: Ending::Aborted(failure), .. } = world.last_report(call) else {
        panic!("not aborted")
    };
    assert_eq!((failure.origin.as_str(), &failure.cause), ("main/inner/rock", &FailureCause::StopUnconfirmed));
    assert_eq!(world.log, ["Stubborn with wires {}", "Step with wires {}"], "`last` must not run beside `rock`");
}

#[test]
fn watchers_see_every_change() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(5));
    let changes: Vec<String> = world.answers[&call]
        .iter()
        .filter_map(|answer| match answer {
            Answer::Report(Report::Process { path, change: Change::Activated, .. }) => Some(path.clone()),
            _ => None,
        })
        .collect();
    assert_eq!(changes, ["main", "main/pair", "main/pair/sensor", "main/pair/first", "main/pair/second", "main/last"]);
}

/// Rounds that end at once must not keep the node from anything else: found by a reader, both hung the agent.
#[test]
fn a_loop_that_takes_no_time_can_be_stopped() {
    let main = |body: &str| {
        format!(
            r#"process main() {{
    host {{ "c1" }}
    instantiated_processes {{ a instof Step("c1"); }}
    internal_event_actions {{ {body} }}
}}"#
        )
    };
    for body in ["a? ;; skip", "(a? , wait(0 s)) ;; wait(0 s)"] {
        let mut world = World::new(&["c1"]);
        let call = world.deploy("c1", &main(body));
        world.run_for(Duration::from_millis(300));
        world.kill("c1", 0);
        world.run_for(Duration::from_secs(1));
        world.stop("c1");
        world.run_for(Duration::from_secs(5));
        assert_eq!(world.ending(call), &Ending::Stopped, "{body}");
    }
}

#[test]
fn a_node_that_leaves_is_not_waited_for() {
    // While it prepares: nothing runs without it.
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_millis(4));
    world.at(0, "c2", Coming::Input(Input::Leave));
    world.run_for(Duration::from_secs(5));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("{:?}", world.last_report(call)) };
    assert!(reasons.iter().any(|reason| reason.contains("host `c2`")), "{reasons:?}");
    assert_eq!(world.alive, BTreeSet::new());

    // While something runs there: that has failed.
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", &TWO_HOSTS.replace("first instof Step", "first instof Long"));
    world.run_for(Duration::from_millis(500));
    world.at(0, "c2", Coming::Input(Input::Leave));
    world.run_for(Duration::from_secs(10));
    let Report::Finished { ending: Ending::Aborted(failure), .. } = world.last_report(call) else {
        panic!("{:?}", world.last_report(call))
    };
    assert_eq!(failure.cause, FailureCause::NotAvailable("its node left".into()));
    assert_eq!(world.alive, BTreeSet::new());
}

#[test]
fn what_has_not_begun_can_be_stopped() {
    let mut world = World::new(&["c1"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_millis(100));
    let stop = world.stop("c1");
    world.run_for(Duration::from_secs(5));
    assert!(matches!(world.last_report(call), Report::Refused { .. }));
    assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
    assert_eq!(world.alive, BTreeSet::new());
}

/// The host of a group's supervisor is lost: what it ran here is stopped before something takes its place.
#[test]
fn a_lost_supervisor_leaves_nothing_running() {
    let text = r#"
process Pair(here, there) {
    host { there }
    instantiated_processes { slow instof Long(here); }
    internal_event_actions { slow }
}
process main() {
    host { "c1" }
    instantiated_processes { pair instof Pair("c1", "c2"); fallback instof Long("c1"); }
    internal_event_actions { pair else fallback }
}
"#;
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", text);
    world.run_for(Duration::from_secs(1));
    assert_eq!(world.running.len(), 1);
    world.cut.insert("c2".into());
    world.at(900, "c1", Coming::Input(Input::Vanished { host: "c2".into(), boot: 2 }));
    world.run_for(Duration::from_millis(6500));
    let running: Vec<u32> = world.running.keys().map(|(_, process)| process.leaf).collect();
    assert_eq!(running.len(), 1, "the fallback alone");
    // It comes back with the same boot: its part of the deployment is fenced off.
    world.cut.clear();
    world.at(0, "c1", Coming::Input(Input::Appeared { host: "c2".into(), boot: 2 }));
    world.run_for(Duration::from_secs(3));
    assert!(world.alive.iter().all(|(host, _)| host == "c1"));
    let stop = world.stop("c1");
    world.run_for(Duration::from_secs(30));
    assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
    assert_eq!(world.alive, BTreeSet::new());
}
