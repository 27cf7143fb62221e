//! Containers of components of ROS 2. A script stands for the program of the container, and the test answers its services, on plain
//! Zenoh. So the test decides which components are loaded, when the container answers, and whether at all.

use super::ros_calls::reply;
use super::ros_nodes::{Installation, SLEEPER, is_running, stopped};
use super::ros_topics::{Ros, run};
use controllers::ros::Message;
use controllers::ros::composition_interfaces::{ListNodesResponse, LoadNodeRequest, LoadNodeResponse};
use dca_tests::cluster::{Cluster, Program, SOON, Stream, wait_until};
use rustix::process::{Signal, kill_process};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use zenoh::Wait;
use zenoh::query::{Query, Queryable};

/// A program that writes its arguments, and waits until SIGINT ends it.
const BOX: &str = "#!/bin/sh\necho \"$@\" > \"$FAKE/arguments\"\necho $$ >> \"$FAKE/pids\"\nexec sleep 3600\n";
const INDEX: &str = "share/ament_index/resource_index/rclcpp_components/demo";
const MODULE: &str = "ros \"demo box\"; node \"/robot1/box\"; components within 20 s {
    talk \"demo demo::Talker\" { remap \"chatter\" -> \"/news\"; intra_process; }
    hear \"demo demo::Listener\" { node \"/other/listen\"; }
}";

/// The part of a container that others see.
struct Container {
    seen: Arc<Mutex<Seen>>,
    _services: [Queryable<()>; 2],
    /// The requests to load a component.
    requests: Receiver<LoadNodeRequest>,
}

/// How a container answers a request to load a component.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Answer {
    Loads,
    Fails,
    /// It loads the component, and the answer is lost.
    Drops,
    /// It keeps the request.
    Holds,
}

#[derive(Debug)]
struct Seen {
    answer: Answer,
    nodes: Vec<(String, u64)>,
    held: Vec<Query>,
    is_silent: bool,
}

impl Seen {
    fn load(&mut self, request: &LoadNodeRequest) -> LoadNodeResponse {
        let full_node_name = format!("{}/{}", request.node_namespace.trim_end_matches('/'), request.node_name);
        let unique_id = self.nodes.last().map_or(0, |(_, id)| *id) + 1;
        self.nodes.push((full_node_name.clone(), unique_id));
        LoadNodeResponse { success: true, error_message: String::new(), full_node_name, unique_id }
    }
}

fn answer<M: Message>(query: &Query, response: &M) {
    reply(query, &response.to_cdr().expect("it is short"));
}

fn request(query: &Query) -> LoadNodeRequest {
    LoadNodeRequest::from_cdr(&query.payload().expect("it has one").to_bytes()).expect("it is of its type")
}

impl Container {
    fn new(ros: &Ros, how: Answer) -> Self {
        let seen = Seen { answer: how, nodes: Vec::new(), held: Vec::new(), is_silent: false };
        let seen = Arc::new(Mutex::new(seen));
        let (tx, requests) = sync_channel(64);
        let (own, other) = (Arc::clone(&seen), Arc::clone(&seen));
        let load = move |query: Query| {
            let mut seen = own.lock().expect("no test panics here");
            let asked = request(&query);
            match seen.answer {
                Answer::Loads => answer(&query, &seen.load(&asked)),
                Answer::Drops => drop(seen.load(&asked)),
                Answer::Holds => seen.held.push(query),
                Answer::Fails => {
                    let error_message = "Failed to find class".to_owned();
                    answer(&query, &LoadNodeResponse { error_message, ..LoadNodeResponse::default() });
                }
            }
            tx.try_send(asked).unwrap_or_default();
        };
        let list = move |query: Query| {
            let mut seen = other.lock().expect("no test panics here");
            if seen.is_silent {
                return seen.held.push(query);
            }
            let (full_node_names, unique_ids) = seen.nodes.iter().cloned().unzip();
            answer(&query, &ListNodesResponse { full_node_names, unique_ids });
        };
        // The last two words are the type and the hash of the type.
        let key = |service: &str| format!("7/robot1/box/_container/{service}/*/*");
        let serve = |service: &str| ros.session.declare_queryable(key(service)).complete(true);
        let services = [
            serve("load_node").callback(load).wait().expect("a peer"),
            serve("list_nodes").callback(list).wait().expect("a peer"),
        ];
        Self { seen, _services: services, requests }
    }

    #[track_caller]
    fn expect(&self, class: &str, mission: &Program) -> LoadNodeRequest {
        let asked = self.requests.recv_timeout(SOON);
        let asked = asked.unwrap_or_else(|_| panic!("{}{}", mission.text(Stream::Out), mission.text(Stream::Err)));
        assert_eq!((asked.package_name.as_str(), asked.plugin_name.as_str()), ("demo", class));
        asked
    }

    fn set(&self, change: impl FnOnce(&mut Seen)) {
        change(&mut self.seen.lock().expect("no test panics here"));
    }
}

fn installation(cluster: &Cluster) -> Installation {
    let ros2 = Installation::new(cluster, &[("lib/demo/box", BOX), ("lib/demo/nav", SLEEPER)]);
    ros2.write(INDEX, "demo::Talker;lib/libtalk.so\ndemo::Listener;lib/libhear.so\n", 0o644);
    ros2
}

#[test]
fn components_are_loaded_one_after_the_other() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = installation(&cluster);
    let spec = ros2.spec(MODULE).replace("raw = \"007\"", "talk = { rate = 5, names = [\"a, b\", \"7\"] }");
    let mission = run(&cluster, &ros, &spec);
    let pid = ros2.started(1, &mission);
    let container = Container::new(&ros, Answer::Holds);
    let first = container.expect("demo::Talker", &mission);
    assert_eq!((first.node_name.as_str(), first.node_namespace.as_str()), ("talk", "/robot1"));
    assert_eq!(first.remap_rules, ["chatter:=/news"]);
    let parameters: Vec<&str> = first.parameters.iter().map(|one| one.name.as_str()).collect();
    assert_eq!(parameters, ["names", "rate"]);
    assert_eq!(first.parameters[0].value.string_array_value, ["a, b", "7"]);
    assert_eq!((first.parameters[1].value.r#type, first.parameters[1].value.integer_value), (2, 5));
    assert_eq!(first.extra_arguments[0].name, "use_intra_process_comms");
    assert!(first.extra_arguments[0].value.bool_value);
    // The answer is late, and the next component waits for it.
    assert!(container.requests.recv_timeout(Duration::from_millis(300)).is_err(), "the first one is not loaded yet");
    container.set(|seen| {
        seen.answer = Answer::Loads;
        let query = seen.held.pop().expect("a request waits");
        answer(&query, &seen.load(&first));
    });
    let second = container.expect("demo::Listener", &mission);
    assert_eq!((second.node_name.as_str(), second.node_namespace.as_str()), ("listen", "/other"));
    assert_eq!((second.remap_rules.len(), second.parameters.len(), second.extra_arguments.len()), (0, 0, 0));
    let arguments = "--ros-args -r __ns:=/robot1 -r __node:=box -p label:=\"7 'x'\" -p gain:=2.0 -p depth:=5 \
                     -p names:=[\"1\", \"x y\", \"\"] -p gains:=[1.0, 2.0]\n";
    assert_eq!(ros2.read("arguments"), arguments);
    assert!(is_running(pid));
    stopped(mission, &cluster);
    assert!(!is_running(pid));
}

/// The answer is lost, but the component is loaded: it is not loaded a second time.
#[test]
fn a_component_whose_answer_is_lost_is_loaded_once() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = installation(&cluster);
    let mission = run(&cluster, &ros, &ros2.spec(MODULE));
    ros2.started(1, &mission);
    let container = Container::new(&ros, Answer::Drops);
    container.expect("demo::Talker", &mission);
    container.set(|seen| seen.answer = Answer::Loads);
    container.expect("demo::Listener", &mission);
    let has_both = || container.seen.lock().expect("no test panics here").nodes.len() == 2;
    assert!(wait_until(SOON, has_both).is_some());
    stopped(mission, &cluster);
    assert!(container.requests.try_recv().is_err(), "no component is loaded twice");
}

#[test]
fn a_component_that_is_not_loaded_aborts_the_process_with_the_reason() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = installation(&cluster);
    let short = ros2.spec(&MODULE.replace("20 s", "1 s"));
    let long = ros2.spec(MODULE);
    for (number, how, why) in [
        (1, None, "its service `/robot1/box/_container/load_node` is not there after 1 s"),
        (2, Some(Answer::Holds), "component `talk` (`demo::Talker` of `demo`) was not loaded within 1 s"),
        (3, Some(Answer::Fails), "component `talk` (`demo::Talker` of `demo`) was not loaded: Failed to find class"),
    ] {
        let mission = run(&cluster, &ros, if how == Some(Answer::Fails) { &long } else { &short });
        let pid = ros2.started(number, &mission);
        let _container = how.map(|how| Container::new(&ros, how));
        let ended = mission.ended(SOON);
        assert!(ended.code == Some(1) && format!("{}{}", ended.out, ended.err).contains(why), "{why}: {ended}");
        assert!(!is_running(pid));
    }
    cluster.expect_nothing_left(Duration::from_secs(5));
}

/// The test covers a crash, another client, and a silent container.
#[test]
fn a_container_that_fails_while_it_runs_aborts_its_process() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = installation(&cluster);
    let spec = ros2.spec(&MODULE.replace("20 s", "3 s"));
    for (number, why) in (1..).zip([
        "has ended with SIGSEGV",
        "component `hear` (`demo::Listener` of `demo`) is not loaded any more: another client",
        "it has not listed its components for 3 s",
    ]) {
        let mission = run(&cluster, &ros, &spec);
        let pid = ros2.started(number, &mission);
        let container = Container::new(&ros, Answer::Loads);
        container.expect("demo::Talker", &mission);
        container.expect("demo::Listener", &mission);
        match number {
            1 => kill_process(pid, Signal::SEGV).expect("it runs"),
            2 => container.set(|seen| drop(seen.nodes.pop())),
            _ => container.set(|seen| seen.is_silent = true),
        }
        let ended = mission.ended(SOON);
        assert!(ended.code == Some(1) && format!("{}{}", ended.out, ended.err).contains(why), "{why}: {ended}");
        assert!(wait_until(SOON, || !is_running(pid)).is_some());
    }
    cluster.expect_nothing_left(Duration::from_secs(5));
}

#[test]
fn a_killed_container_is_started_again_with_its_components() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = installation(&cluster);
    let spec = ros2.spec(MODULE).replace("Nav(c1);", "Nav(c1) { restart transient; };");
    let mission = run(&cluster, &ros, &spec);
    for number in 1..=2 {
        let pid = ros2.started(number, &mission);
        let container = Container::new(&ros, Answer::Loads);
        container.expect("demo::Talker", &mission);
        container.expect("demo::Listener", &mission);
        drop(container);
        if number == 1 {
            kill_process(pid, Signal::KILL).expect("it runs");
        }
    }
    stopped(mission, &cluster);
}

#[test]
fn a_component_that_is_not_installed_is_refused_before_anything_runs() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = installation(&cluster);
    ros2.write("bad.yaml", "talk: 5\n", 0o644);
    let spec = ros2.spec(MODULE);
    let bad = format!("params \"{}/bad.yaml\"; remap \"chatter\"", ros2.path());
    for (from, to, why) in [
        (
            "demo::Talker",
            "demo::Walker",
            "package `demo` has no component `demo::Walker`; it has `demo::Talker`, `demo::Listener`",
        ),
        ("\"demo demo::Talker\"", "\"other other::Talker\"", "ROS 2 has no package `other` with components in"),
        ("remap \"chatter\"", "params \"none.yaml\"; remap \"chatter\"", "none.yaml` cannot be read: No such file"),
        ("remap \"chatter\"", &bad, "it has no `ros__parameters`"),
    ] {
        let ended = run(&cluster, &ros, &spec.replace(from, to)).ended(SOON);
        assert!(ended.code == Some(1) && format!("{}{}", ended.out, ended.err).contains(why), "{why}: {ended}");
    }
    assert_eq!(ros2.read("pids"), "");
}
