//! Tests of the model on virtual time.

mod pictures;

use crate::{
    Changes, Fleet, Freshness, Gone, Health, Input, LastEnd, LiveDeployment, Mark, Measured, MissionId, Model,
    PastChange, Position, Presence, Process, RobotId, Wire,
};
use comms::io::clock;
use comms::logic::time::Time;
use node::logic::protocol::{
    Absent, AbsentHost, AbsentProcess, ActivityStatus, Change, Containment, Deployment, DeploymentStatus, Ending,
    Estop, Event, Failure, FailureCause, LostValues, Network, NodeStatus, OpenQuestion, ProcessStatus, RefusedValues,
    Report,
};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

fn at(millis: u64) -> Time {
    Time::ZERO + Duration::from_secs(1000) + Duration::from_millis(millis)
}

fn door() -> Deployment {
    Deployment { name: "door".into(), epoch: 1 }
}

fn robot(host: &str) -> RobotId {
    RobotId { host: host.into(), fleet: Fleet::Standing }
}

/// The deployment [`door`] with its home on `r1`.
fn mission() -> MissionId {
    MissionId { deployment: door(), home: "r1".into(), fleet: Fleet::Standing }
}

fn answered(status: NodeStatus) -> Input {
    Input::Status { fleet: Fleet::Standing, status: Box::new(status) }
}

fn missed(absent: Absent) -> Input {
    Input::Absent { teller: robot("r1"), absent: Box::new(absent) }
}

fn silent(host: &str, why: &str) -> Input {
    Input::Silent { robot: robot(host), why: why.into() }
}

fn known(hosts: &[&str]) -> Input {
    Input::Known { fleet: Fleet::Standing, hosts: hosts.iter().map(|host| (*host).to_owned()).collect() }
}

fn process(path: &str, state: &str) -> ProcessStatus {
    let (path, kind, state) = (path.into(), "Any".into(), state.into());
    ProcessStatus { path, kind, state, pid: Some(7), activity: None }
}

fn part(id: Deployment, processes: Vec<ProcessStatus>) -> DeploymentStatus {
    let (home, phase) = ("r1".into(), "running".into());
    let (lost, refused, undelivered) = Default::default();
    DeploymentStatus { deployment: id, home, phase, processes, lost, refused, undelivered }
}

fn node(host: &str, deployments: Vec<DeploymentStatus>) -> NodeStatus {
    NodeStatus {
        host: host.into(),
        pid: 1,
        version: "1".into(),
        up: Duration::from_secs(60),
        peers: Vec::new(),
        deployments,
        containment: Containment::default(),
        network: Network::default(),
        estop: None,
        policy: None,
        missing: Vec::new(),
        waiting: Vec::new(),
    }
}

fn status(host: &str, processes: &[(&str, &str)]) -> Input {
    let processes = processes.iter().map(|(path, state)| process(path, state)).collect();
    answered(node(host, vec![part(door(), processes)]))
}

fn event(number: u64, ago: u64, report: Report) -> Input {
    let (ago, time) = (Duration::from_millis(ago), Duration::from_secs(1_800_000_000));
    let event = Event { deployment: door(), number, host: "r1".into(), ago, report, time };
    Input::Event { home: robot("r1"), event: Box::new(event) }
}

fn changed(path: &str, change: Change) -> Report {
    Report::Process { path: path.into(), change, at: Duration::ZERO }
}

fn only(model: &Model) -> &Process {
    let mut processes = model.deployments().flat_map(|live| live.processes.values());
    let process = processes.next().expect("there is a process");
    assert!(processes.next().is_none());
    process
}

#[test]
fn the_moment_of_a_state_is_that_of_its_event() {
    let mut model = Model::new(1);
    // The event of an earlier start is heard before any node has answered.
    model.apply(at(5000), event(0, 4000, changed("main/a", Change::Started { pid: 7 })));
    model.apply(at(5100), status("r1", &[("main/a", "idle")]));
    assert_eq!((only(&model).since.at, only(&model).since.is_exact), (at(1000), true));
    // A state without an event began at the latest when it was seen.
    model.apply(at(6000), status("r1", &[("main/a", "running")]));
    assert_eq!((only(&model).since.at, only(&model).since.is_exact), (at(6000), false));
    let cause = FailureCause::Signal(11);
    model.apply(at(6500), event(1, 10, changed("main/a", Change::Restarting { cause, count: 1 })));
    model.apply(at(6550), status("r1", &[("main/a", "restarting")]));
    assert_eq!((only(&model).since.at, only(&model).restarts), (at(6490), 1));
    assert_eq!(model.health(&mission(), only(&model)), Health::Changing);
    // The same state later is the same.
    let before = model.position();
    model.apply(at(7500), status("r1", &[("main/a", "restarting")]));
    assert!(model.since(before).is_empty());
    assert_eq!(only(&model).since.at, at(6490));
}

#[test]
fn a_crash_is_a_failed_process_and_a_failed_event() {
    let mut model = Model::new(1);
    model.apply(at(0), status("r1", &[("main/a", "running")]));
    model.apply(at(100), event(0, 0, changed("main/a", Change::Died(FailureCause::Signal(11)))));
    model.apply(at(150), status("r1", &[("main/a", "dead: SIGSEGV")]));
    assert_eq!((model.health(&mission(), only(&model)), only(&model).word()), (Health::Failed, "dead"));
    let last = model.events().next_back().expect("there is an event");
    assert_eq!((last.is_failure, last.path.as_deref()), (true, Some("main/a")));
}

#[test]
fn a_host_that_does_not_answer_leaves_its_processes_unknown() {
    let mut model = Model::new(1);
    assert_eq!(model.freshness(at(0)), Freshness::Never);
    model.apply(at(0), status("r1", &[("main/a", "running")]));
    assert!(model.freshness(at(2999)).is_live());
    assert_eq!(model.freshness(at(3000)).to_string(), "not live since 3 s");
    model.apply(at(4000), silent("r1", "it may be suspended"));
    assert_eq!(model.health(&mission(), only(&model)), Health::Unknown);
    let robot = model.robots().next().expect("it is kept");
    assert_eq!(robot.presence, Presence::Silent("it may be suspended".into()));
    assert_eq!(robot.freshness(at(4500)).to_string(), "not live since 4 s");
    model.apply(at(5000), status("r1", &[("main/a", "running")]));
    assert_eq!(model.health(&mission(), only(&model)), Health::Running);
}

#[test]
fn a_lost_host_has_processes_that_its_peers_know() {
    let mut model = Model::new(1);
    model.apply(at(0), status("r1", &[("main", "running")]));
    let lost = AbsentHost { host: "r2".into(), heard: Duration::from_secs(40), lost: true };
    let away = AbsentProcess { deployment: door(), host: "r2".into(), path: "main/b".into(), kind: "Arm".into() };
    let absent = Absent { hosts: vec![lost], ends: Vec::new(), processes: vec![away] };
    model.apply(at(100), missed(absent.clone()));
    let live = model.deployments().next().expect("it runs");
    assert_eq!(model.health(&live.id, &live.processes["main/b"]), Health::Unknown);
    assert_eq!(model.robots().find(|robot| robot.id.host == "r2").map(|robot| &robot.presence), Some(&Presence::Lost));
    // A lost host does not answer either: this is not new.
    let seen = model.position();
    model.apply(at(150), silent("r2", "it cannot be reached"));
    assert!(model.since(seen).is_empty());
    // A host that has just answered is not lost.
    model.apply(at(200), status("r2", &[("main/b", "running")]));
    model.apply(at(210), missed(absent));
    assert!(model.robots().all(|robot| robot.presence == Presence::Here));
}

/// Between the loss of its link and its place among the missing, no node lists a host.
#[test]
fn a_host_that_is_not_listed_for_a_moment_stays() {
    let mut model = Model::new(1);
    model.apply(at(0), status("r2", &[("main/b", "running")]));
    model.apply(at(1000), known(&["r1"]));
    model.apply(at(9000), known(&["r1"]));
    let robot = model.robots().find(|robot| robot.id.host == "r2").expect("it is kept");
    assert_eq!(robot.presence, Presence::Silent("no node that answers reaches it".into()));
    assert_eq!((robot.heard, model.health(&mission(), only(&model))), (Some(at(0)), Health::Unknown));
    model.apply(at(10_000), known(&["r1", "r2"]));
    model.apply(at(19_000), known(&["r1"]));
    model.apply(at(28_000), known(&["r1"]));
    assert!(model.robots().any(|robot| robot.id.host == "r2"), "it was listed in between");
    model.apply(at(29_000), known(&["r1"]));
    assert!(model.robots().all(|robot| robot.id.host != "r2"));
    let phases: Vec<String> = model.deployments().map(|live| live.phase()).collect();
    assert_eq!(phases, ["not known: its hosts have left"]);
}

#[test]
fn a_host_that_is_back_without_a_deployment_has_no_processes_of_it() {
    let mut model = Model::new(1);
    model.apply(at(0), status("r1", &[("main", "running")]));
    let away = AbsentProcess { deployment: door(), host: "r2".into(), path: "main/b".into(), kind: "Arm".into() };
    let absent = Absent { hosts: Vec::new(), ends: Vec::new(), processes: vec![away] };
    model.apply(at(100), missed(absent));
    model.apply(at(200), answered(node("r1", Vec::new())));
    model.apply(at(300), answered(node("r2", Vec::new())));
    let live = model.deployments().next().expect("it is kept");
    assert!(live.processes.is_empty(), "{:?}", live.processes);
}

#[test]
fn a_deployment_ends_as_its_event_says() {
    let mut model = Model::new(1);
    model.apply(at(0), status("r1", &[("main", "running")]));
    model.apply(at(10), event(3, 0, Report::Go { took: Duration::from_secs(1), signals: Vec::new() }));
    let failure = Failure { origin: "main/a".into(), cause: FailureCause::Exit(3), at: Duration::from_secs(2) };
    let (ending, unconfirmed) = (Ending::Aborted(failure), Vec::new());
    model.apply(at(2010), event(4, 0, Report::Finished { ending, at: Duration::from_secs(2), unconfirmed }));
    // A host that is still cleaning up does not undo the end.
    model.apply(at(2020), status("r1", &[("main", "running")]));
    model.apply(at(2100), answered(node("r1", Vec::new())));
    let live = model.deployments().next().expect("it is kept");
    assert_eq!((live.began, live.processes.len()), (Some(at(10)), 0));
    assert!(live.phase().starts_with("finished: aborted") && live.end.as_ref().is_some_and(|end| end.is_failed));
    for epoch in 2..40 {
        let id = Deployment { name: "door".into(), epoch };
        model.apply(at(epoch * 1000), answered(node("r1", vec![part(id, Vec::new())])));
    }
    assert_eq!(model.deployments().count(), 21, "one that runs, and the last that are over");
    assert!(model.deployments().all(|live| live.id.deployment.epoch > 18));
}

#[test]
fn a_question_is_open_until_it_is_answered() {
    let mut model = Model::new(1);
    let question = OpenQuestion { number: 3, text: "go\x1b[2J?".into(), options: vec!["yes".into(), "no".into()] };
    let activity = ActivityStatus { states: vec!["Asking".into()], questions: vec![question], orders: Vec::new() };
    let asking = ProcessStatus { activity: Some(activity), ..process("main/a", "running; in Asking") };
    model.apply(at(0), answered(node("r1", vec![part(door(), vec![asking])])));
    let open: Vec<_> =
        model.questions().map(|one| (one.mission.home.as_str(), one.path, one.question.text.clone())).collect();
    assert_eq!(open, [("r1", "main/a", "go\\x1b[2J?".to_owned())]);
    model.apply(at(100), status("r1", &[("main/a", "running")]));
    assert_eq!(model.questions().count(), 0);
}

#[test]
fn a_wire_counts_what_it_loses_and_how_fast() {
    let mut model = Model::new(1);
    let name = "main/a, Out -> main/b, In";
    let losing = |count| {
        let lost = vec![LostValues { wire: name.into(), count }];
        let refused = vec![RefusedValues { input: "main/b, In".into(), count: 2 }];
        let part = DeploymentStatus { lost, refused, ..part(door(), vec![process("main/b", "running")]) };
        answered(node("r1", vec![part]))
    };
    let counts = |model: &Model| {
        let live = model.deployments().next().expect("it runs");
        model.wires(live).map(|wire| (wire.lost, wire.lost_a_second, wire.refused)).collect::<Vec<_>>()
    };
    model.apply(at(0), losing(10));
    assert_eq!(counts(&model), [(10, 0.0, 2)], "it is not known since when");
    model.apply(at(2000), losing(30));
    assert_eq!(counts(&model), [(30, 10.0, 2)]);
    model.apply(at(3000), losing(30));
    assert_eq!(counts(&model), [(30, 0.0, 2)]);
    // Its program was started again.
    model.apply(at(4000), losing(5));
    assert_eq!(counts(&model), [(5, 5.0, 2)]);
    // The host of its output counts values until the consumer is connected again, and counts them itself.
    let cut = |undelivered: Vec<LostValues>| {
        let part = DeploymentStatus { undelivered, ..part(door(), vec![process("main/a", "running")]) };
        answered(node("r2", vec![part]))
    };
    let missing = |model: &Model| {
        let live = model.deployments().next().expect("it runs");
        model.wires(live).map(Wire::missing).collect::<Vec<_>>()
    };
    model.apply(at(4000), cut(vec![LostValues { wire: name.into(), count: 7 }]));
    assert_eq!(missing(&model), [12]);
    model.apply(at(4000), losing(5));
    assert_eq!(missing(&model), [12], "the other host knows nothing of it");
    model.apply(at(4000), cut(Vec::new()));
    assert_eq!(missing(&model), [5]);
    let (mission, path, port) = (mission(), "main/a".into(), "Out".into());
    model.apply(at(4000), Input::Measured(Measured { mission, path, port, hertz: 100.0 }));
    let live = model.deployments().next().expect("it runs");
    assert_eq!(model.wires(live).next().and_then(|wire| wire.rate).map(|rate| rate.hertz), Some(100.0));
}

#[test]
fn output_that_is_told_again_is_there_once() {
    let mut model = Model::new(1);
    let output =
        |path: &str, bytes: &[u8]| Input::Output { mission: mission(), path: path.into(), bytes: bytes.into() };
    model.apply(at(0), output("main/a", b"one\ntwo\nhal"));
    model.apply(at(0), output("main/b", b"other\n"));
    model.apply(at(1000), Input::OutputBegins { mission: mission(), path: "main/a".into() });
    model.apply(at(1000), output("main/a", b"one\ntwo\nhalf\n"));
    let lines: Vec<_> = model.lines().map(|line| (line.ordinal, line.text.as_str())).collect();
    assert_eq!(lines, [(2, "other"), (3, "one"), (4, "two"), (5, "half")]);
}

#[test]
fn an_estop_and_a_new_node_are_changes_and_age_is_not() {
    let mut model = Model::new(1);
    model.apply(at(0), answered(node("r1", Vec::new())));
    let seen = model.position();
    let older = NodeStatus { up: Duration::from_secs(61), ..node("r1", Vec::new()) };
    model.apply(at(1000), answered(older));
    assert!(model.since(seen).is_empty());
    let estop = Some(Estop { by: "ann@c1".into(), reason: "a person\x1b[2J".into() });
    model.apply(at(2000), answered(NodeStatus { estop, ..node("r1", Vec::new()) }));
    let told: Vec<_> = model.since(seen).robots.iter().map(|robot| robot.estop.clone()).collect();
    assert_eq!(told, [Some("everything was stopped by ann@c1: a person\\x1b[2J".to_owned())]);
    let seen = model.position();
    model.apply(at(3000), answered(NodeStatus { pid: 2, ..node("r1", Vec::new()) }));
    assert_eq!(model.since(seen).robots.len(), 1);
}

#[test]
fn a_viewer_resumes_where_it_was_and_else_begins_again() {
    let mut model = Model::new(17);
    model.apply(at(0), status("r1", &[("main", "running"), ("main/a", "running")]));
    let first = model.since(Position::default());
    assert!(first.is_whole && first.processes.len() == 2);
    let seen = first.position;
    assert_eq!(seen.to_string(), "17-1");
    // A process that changes twice comes once.
    model.apply(at(1000), status("r1", &[("main", "running"), ("main/a", "stopping")]));
    model.apply(at(2000), status("r1", &[("main", "running"), ("main/a", "idle")]));
    let changes = model.since(seen);
    let states: Vec<&str> = changes.processes.iter().map(|(_, process)| process.state.as_str()).collect();
    assert_eq!((changes.is_whole, states), (false, vec!["idle"]));
    let seen = changes.position;
    model.apply(at(3000), status("r1", &[("main", "running")]));
    model.apply(at(3000), known(&[]));
    model.apply(at(13_000), known(&[]));
    let changes = model.since(seen);
    let gone =
        [Gone::Process(mission(), "main/a".into()), Gone::Process(mission(), "main".into()), Gone::Robot(robot("r1"))];
    assert_eq!(changes.gone.iter().map(|gone| (*gone).clone()).collect::<Vec<_>>(), gone);
    // A view that was started again has another number, and a position of the future is none.
    for strange in [Position { model: 16, ..seen }, Position { model: 17, number: 999 }] {
        assert!(model.since(strange).is_whole);
    }
    for round in 0..5000 {
        model.apply(at(4000 + round), status("r1", &[("main", "running"), (&format!("main/{round}"), "idle")]));
    }
    assert!(model.since(seen).is_whole, "more is gone than is remembered");
}

/// A viewer that has taken in changes at some moments.
#[derive(Default)]
struct Mirror {
    position: Position,
    robots: BTreeSet<RobotId>,
    states: BTreeMap<(MissionId, String), String>,
    deployments: BTreeMap<MissionId, String>,
}

impl Mirror {
    fn take(&mut self, changes: &Changes<'_>) {
        if changes.is_whole {
            *self = Self::default();
        }
        for gone in &changes.gone {
            match gone {
                Gone::Robot(host) => drop(self.robots.remove(host)),
                Gone::Deployment(id) => {
                    self.deployments.remove(id);
                    self.states.retain(|(of, _), _| of != id);
                }
                Gone::Process(id, path) => drop(self.states.remove(&(id.clone(), path.clone()))),
                Gone::Wire(..) => {}
            }
        }
        self.robots.extend(changes.robots.iter().map(|robot| robot.id.clone()));
        self.deployments.extend(changes.deployments.iter().map(|live| (live.id.clone(), live.phase())));
        let state =
            |(id, process): &(&MissionId, &Process)| (((*id).clone(), process.path.clone()), process.state.clone());
        self.states.extend(changes.processes.iter().map(state));
        self.position = changes.position;
    }
}

/// Three viewers look at other moments while processes, robots and deployments come and go; all end with the whole truth.
#[test]
fn every_viewer_sees_the_same_in_the_end() {
    for seed in 0..50_u64 {
        let mut random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut next = |below: u64| {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random % below
        };
        let mut model = Model::new(1);
        let mut viewers: [Mirror; 3] = std::array::from_fn(|_| Mirror::default());
        for step in 0..200 {
            let host = format!("r{}", next(3));
            let mut parts = Vec::new();
            for _ in 0..next(3) {
                let id = Deployment { name: "m".into(), epoch: 1 + next(2) };
                let mut processes = Vec::new();
                for _ in 0..next(4) {
                    let state = ["idle", "running", "dead: SIGSEGV"][usize::try_from(next(3)).unwrap()];
                    processes.push(process(&format!("main/{host}/{}", next(4)), state));
                }
                parts.push(part(id, processes));
            }
            let input = match next(8) {
                0 => known(&["r0", "r1", "r2"][..usize::try_from(next(4)).unwrap()]),
                1 => silent(&host, "why"),
                _ => answered(node(&host, parts)),
            };
            model.apply(at(step * 1000), input);
            for viewer in viewers.iter_mut().filter(|_| next(3) == 0) {
                let changes = model.since(viewer.position);
                viewer.take(&changes);
            }
        }
        for viewer in &mut viewers {
            viewer.take(&model.since(viewer.position));
            let robots: BTreeSet<RobotId> = model.robots().map(|robot| robot.id.clone()).collect();
            let state = |id: &MissionId, process: &Process| ((id.clone(), process.path.clone()), process.state.clone());
            let live = model.deployments();
            let states = live.flat_map(|live| live.processes.values().map(|process| state(&live.id, process)));
            let deployments = model.deployments().map(|live| (live.id.clone(), live.phase()));
            assert_eq!((&viewer.robots, &viewer.states), (&robots, &states.collect()), "seed {seed}");
            assert_eq!(viewer.deployments, deployments.collect(), "seed {seed}");
        }
    }
}

#[test]
fn names_and_numbers_of_others_have_limits() {
    let mut model = Model::new(1);
    model.apply(at(0), status("r\x1b[2J", &[]));
    model.apply(at(0), status("r1", &[("main/\u{202e}", "running"), ("main", "run\x1b[2Jning")]));
    let hostile = Deployment { name: "a\nb".into(), epoch: 1 };
    model.apply(at(0), answered(node("r1", vec![part(door(), vec![process("main", "x\ny")]), part(hostile, vec![])])));
    assert_eq!((model.robots().count(), model.omitted().names), (1, 2));
    assert_eq!(only(&model).state, "x\\ny");
    (0..400).for_each(|number| model.apply(at(1), answered(node(&format!("s{number}"), vec![]))));
    assert_eq!((model.robots().count(), model.omitted().items), (256, 145));
    (0..3000).for_each(|number| model.apply(at(2), event(number, 0, changed("main", Change::Activated))));
    let oldest = model.events().next().map(|event| event.ordinal);
    assert_eq!((model.events().len(), oldest), (2000, Some(1000)));
    let many = (0..30_000).map(|number| process(&format!("main/{number}"), "idle")).collect();
    model.apply(at(3), answered(node("r1", vec![part(door(), many)])));
    let count: usize = model.deployments().map(|live| live.processes.len()).sum();
    assert_eq!(count, 19_999, "the process that is gone took room until then");
    let bytes = b"a line\n".repeat(5000);
    model.apply(at(4), Input::Output { mission: mission(), path: "main".into(), bytes });
    assert_eq!(model.lines().len(), 2000);
}

/// Two `dca run` of one spec, and a node that stays: all are called `r1`, and none knows of another.
#[test]
fn nodes_of_one_name_that_do_not_know_of_each_other_are_several() {
    let mut model = Model::new(1);
    let fleets = [Fleet::Standing, Fleet::Command(47), Fleet::Command(48)];
    let states = ["running", "idle", "dead: SIGSEGV"];
    for (fleet, state) in fleets.into_iter().zip(states) {
        let status = Box::new(node("r1", vec![part(door(), vec![process("main/a", state)])]));
        model.apply(at(0), Input::Status { fleet, status });
    }
    let shown = |model: &Model| -> Vec<(Fleet, String)> {
        let all =
            model.deployments().flat_map(|live| live.processes.values().map(|one| (live.id.fleet, one.state.clone())));
        all.collect()
    };
    assert_eq!(shown(&model), fleets.into_iter().zip(states.map(str::to_owned)).collect::<Vec<_>>());
    assert_eq!(model.robots().map(|robot| robot.id.fleet).collect::<Vec<_>>(), fleets);
    // The end, the loss and the silence of one are not those of another.
    let home = RobotId { fleet: fleets[1], ..robot("r1") };
    let report = Report::Finished { ending: Ending::Done(Vec::new()), at: Duration::ZERO, unconfirmed: Vec::new() };
    let Input::Event { event, .. } = event(0, 0, report) else { panic!("it is an event") };
    model.apply(at(100), Input::Event { home: home.clone(), event });
    model.apply(at(200), Input::Silent { robot: RobotId { fleet: fleets[2], ..robot("r1") }, why: "it hangs".into() });
    let ended: Vec<bool> = model.deployments().map(|live| live.end.is_some()).collect();
    assert_eq!(ended, [false, true, false]);
    let health = |model: &Model| -> Vec<Health> {
        let all = model.deployments().flat_map(|live| live.processes.values().map(|one| model.health(&live.id, one)));
        all.collect()
    };
    assert_eq!(health(&model), [Health::Running, Health::Quiet, Health::Unknown]);
    model.apply(at(300), Input::Known { fleet: fleets[1], hosts: BTreeSet::new() });
    assert_eq!(model.robots().map(|robot| robot.id.fleet).collect::<Vec<_>>(), [fleets[0], fleets[2]]);
    assert_eq!(shown(&model).len(), 2);
}

/// Each home counts its own epochs, and both may have begun a deployment of this name.
#[test]
fn deployments_of_one_name_with_two_homes_are_two() {
    let mut model = Model::new(1);
    let of = |home: &str| DeploymentStatus { home: home.into(), ..part(door(), vec![process("main/a", "running")]) };
    model.apply(at(0), answered(node("r1", vec![of("r1")])));
    let report = Report::Finished { ending: Ending::Stopped, at: Duration::ZERO, unconfirmed: Vec::new() };
    model.apply(at(100), event(0, 0, report));
    model.apply(at(200), answered(node("r1", Vec::new())));
    // The first one has ended. The second one runs on another host, and misses a host.
    model.apply(at(300), answered(node("r2", vec![of("r2")])));
    let away = AbsentProcess { deployment: door(), host: "r3".into(), path: "main/b".into(), kind: "Arm".into() };
    let missing = Absent { hosts: Vec::new(), ends: Vec::new(), processes: vec![away] };
    model.apply(at(400), Input::Absent { teller: robot("r2"), absent: Box::new(missing) });
    let shown: Vec<_> =
        model.deployments().map(|live| (live.id.home.as_str(), live.phase(), live.processes.len())).collect();
    assert_eq!(shown, [("r1", "finished: stopped".to_owned(), 0), ("r2", "running".to_owned(), 2)]);
}

/// A process of one path in two deployments has its own moments, output and wires in each.
#[test]
fn processes_of_one_path_in_two_deployments_are_two() {
    let mut model = Model::new(1);
    let gate = Deployment { name: "gate".into(), epoch: 1 };
    let both = vec![part(door(), vec![process("main/a", "idle")]), part(gate, vec![process("main/a", "idle")])];
    model.apply(at(5000), event(0, 4000, changed("main/a", Change::Started { pid: 7 })));
    model.apply(at(5000), answered(node("r1", both)));
    let since: Vec<bool> =
        model.deployments().flat_map(|live| live.processes.values()).map(|one| one.since.is_exact).collect();
    assert_eq!(since, [true, false]);
}

/// 20 robots with 50 processes each: what an input costs is printed.
#[test]
fn a_thousand_processes_cost_little() {
    let robot = |number: usize, state: &str| {
        let processes = (0..50).map(|one| process(&format!("main/r{number}/p{one}"), state)).collect();
        answered(node(&format!("r{number}"), vec![part(door(), processes)]))
    };
    let mut model = Model::new(1);
    let mut inputs: Vec<(u64, Input)> = Vec::new();
    for second in 0..20 {
        let state = if second % 2 == 0 { "running" } else { "idle" };
        inputs.extend((0..20).map(|number| (second, robot(number, state))));
        let path = format!("main/r{second}/p0");
        inputs
            .extend((0..50).map(|number| (second, event(second * 50 + number, 0, changed(&path, Change::Activated)))));
    }
    let (count, begun) = (inputs.len(), clock::now());
    for (second, input) in inputs {
        model.apply(at(second * 1000), input);
    }
    let took = clock::now().since(begun) / u32::try_from(count).unwrap();
    println!("{count} inputs of 20 robots with 1,000 processes: {} us each", took.as_micros());
    assert_eq!(model.deployments().map(|live| live.processes.len()).sum::<usize>(), 1000);
    // The limit is far above the usual time: a machine may be very busy.
    assert!(took < Duration::from_millis(20), "{took:?}");
    let begun = clock::now();
    assert_eq!(model.since(Position::default()).processes.len(), 1000);
    println!("all changes: {} us", clock::now().since(begun).as_micros());
}
