//! Programs of ROS 2 as processes: an installation in a folder of the test, with scripts as executables. The test itself answers the
//! services of a node with a lifecycle, on plain Zenoh. So it decides which answer comes, when, and whether at all.

use super::ros_calls::{CANCEL, RESULT, SEND, reply, serve};
use super::ros_topics::{Ros, attachment, run};
use dca_tests::cluster::{Cluster, Program, SOON, Stream, wait_until};
use rustix::process::{Pid, Signal, kill_process, test_kill_process};
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use zenoh::Wait;
use zenoh::query::{Query, Queryable};

const CHANGE: &str = "7/robot1/nav/change_state/lifecycle_msgs::srv::dds_::ChangeState_/RIHS01_356fe34f0475a43acf54542013af4167b0e729f77ea22ffb045c6ad8e20668e5";
const STATE: &str = "7/robot1/nav/get_state/lifecycle_msgs::srv::dds_::GetState_/RIHS01_800a0a5aae599782b02932de0caf563f6dc4e7e94b794eadde075ba2cbef9795";
const EVENT: &str = "7/robot1/nav/transition_event/lifecycle_msgs::msg::dds_::TransitionEvent_/RIHS01_d5f8873a2f0146498f812d7885c7327ce27e463d36811d8792f35ee38c0d6c38";
/// The numbers of states and transitions. Source: `lifecycle_msgs`.
const UNCONFIGURED: u8 = 1;
const INACTIVE: u8 = 2;
const ACTIVE: u8 = 3;
const CONFIGURE: u8 = 1;
const ACTIVATE: u8 = 3;
const DEACTIVATE: u8 = 4;
/// A node that only waits until SIGINT ends it.
pub(super) const SLEEPER: &str = "#!/bin/sh\necho $$ >> \"$FAKE/pids\"\nexec sleep 3600\n";

/// An installation of ROS 2 with the package `demo`.
pub(super) struct Installation {
    folder: PathBuf,
}

impl Installation {
    pub(super) fn new(cluster: &Cluster, executables: &[(&str, &str)]) -> Self {
        let installation = Self { folder: cluster.folder().join("opt ros") };
        let shown = installation.folder.display();
        let setup =
            format!("export AMENT_PREFIX_PATH='{shown}'; export FAKE='{shown}'; export PATH=\"$FAKE/bin:$PATH\"\n");
        installation.write("setup.bash", &setup, 0o644);
        installation.write("share/ament_index/resource_index/packages/demo", "", 0o644);
        for (name, text) in executables {
            installation.write(name, text, 0o755);
        }
        installation
    }

    pub(super) fn write(&self, name: &str, text: &str, mode: u32) {
        let path = self.folder.join(name);
        fs::create_dir_all(path.parent().expect("it has a folder")).expect("the folder is ours");
        fs::write(&path, text).expect("the folder is ours");
        fs::set_permissions(&path, Permissions::from_mode(mode)).expect("the file is ours");
    }

    pub(super) fn path(&self) -> String {
        self.folder.display().to_string()
    }

    pub(super) fn read(&self, name: &str) -> String {
        fs::read_to_string(self.folder.join(name)).unwrap_or_default()
    }

    /// Waits until this number of programs was started, and returns the last one.
    #[track_caller]
    pub(super) fn started(&self, count: usize, mission: &Program) -> Pid {
        let pids = || self.read("pids").lines().filter_map(|pid| Pid::from_raw(pid.parse().ok()?)).collect::<Vec<_>>();
        let are_there = wait_until(SOON, || pids().len() >= count);
        assert!(are_there.is_some(), "{}{}", mission.text(Stream::Out), mission.text(Stream::Err));
        pids()[count - 1]
    }

    /// Returns a mission with one module that names the setup file, and an endless process beside it.
    pub(super) fn spec(&self, module: &str) -> String {
        format!(
            "module Nav(host: Host, label: Text = \"7 'x'\", gain: Number = 2, depth = 5,
                        names: Text[] = [\"1\", \"x y\", \"\"], gains: Number[] = [1, 2], raw = \"007\") {{
                 setup \"{}\"; {module} }}
             process main() {{ host {{ c1 }} instantiated_processes {{ nav instof Nav(c1); }}
             internal_event_actions {{ nav }} }}",
            self.folder.join("setup.bash").display()
        )
    }
}

pub(super) fn is_running(pid: Pid) -> bool {
    test_kill_process(pid).is_ok()
}

/// The part of a node with a lifecycle that others see.
struct Node {
    seen: Arc<Mutex<Seen>>,
    _services: [Queryable<()>; 2],
    /// The requested transitions.
    changes: Receiver<u8>,
}

#[derive(Debug)]
struct Seen {
    state: u8,
    /// The transition that fails.
    failing: Option<u8>,
    /// The transition without an answer.
    holding: Option<u8>,
    held: Vec<Query>,
    is_silent: bool,
}

impl Node {
    fn new(ros: &Ros) -> Self {
        let seen = Seen { state: UNCONFIGURED, failing: None, holding: None, held: Vec::new(), is_silent: false };
        Self::with(ros, seen)
    }

    fn with(ros: &Ros, seen: Seen) -> Self {
        let seen = Arc::new(Mutex::new(seen));
        let (tx, changes) = sync_channel(64);
        let (own, other) = (Arc::clone(&seen), Arc::clone(&seen));
        let change = move |query: Query| {
            let asked = query.payload().expect("it has one").to_bytes()[4];
            let mut seen = own.lock().expect("no test panics here");
            if seen.holding == Some(asked) {
                seen.held.push(query);
            } else {
                let is_done = seen.failing != Some(asked);
                seen.state = if is_done { goal(asked) } else { seen.state };
                reply(&query, &[0, 1, 0, 0, u8::from(is_done)]);
            }
            tx.try_send(asked).unwrap_or_default();
        };
        let ask = move |query: Query| {
            let mut seen = other.lock().expect("no test panics here");
            if seen.is_silent {
                return seen.held.push(query);
            }
            reply(&query, &[0, 1, 0, 0, seen.state, 0, 0, 0, 1, 0, 0, 0, 0]);
        };
        let serve = |key: &str| ros.session.declare_queryable(key.to_owned()).complete(true);
        let services = [
            serve(CHANGE).callback(change).wait().expect("a peer"),
            serve(STATE).callback(ask).wait().expect("a peer"),
        ];
        Self { seen, _services: services, changes }
    }

    #[track_caller]
    fn expect(&self, transition: u8, mission: &Program) {
        let asked = self.changes.recv_timeout(SOON);
        assert_eq!(asked, Ok(transition), "{}{}", mission.text(Stream::Out), mission.text(Stream::Err));
    }

    fn set(&self, change: impl FnOnce(&mut Seen)) {
        change(&mut self.seen.lock().expect("no test panics here"));
    }
}

fn goal(transition: u8) -> u8 {
    if transition == ACTIVATE { ACTIVE } else { INACTIVE }
}

const LIFECYCLE: &str = "ros \"demo nav\"; node \"/robot1/nav\"; lifecycle within 20 s;";

pub(super) fn stopped(mission: Program, cluster: &Cluster) {
    mission.signal(Signal::INT);
    let ended = mission.ended(SOON);
    assert!(ended.err.contains("stopped") || ended.out.contains("stopped"), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(5));
}

/// The test checks the arguments, the environment, the output and the end of a program.
#[test]
fn a_program_of_ros_is_done_or_aborts_by_its_exit_code() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let script = "#!/bin/sh\nprintf '<%s>' \"$@\" > \"$FAKE/arguments\"\necho $RMW_IMPLEMENTATION > \"$FAKE/middleware\"\n\
                  echo \"${NOTIFY_SOCKET:-none}${DCA_CONTROL:-none}\" > \"$FAKE/own\"\nexit $(cat \"$FAKE/code\")\n";
    let ros2 = Installation::new(&cluster, &[("lib/demo/nav", script)]);
    let spec = ros2.spec(
        "ros \"demo nav --fast\"; node \"/robot1/nav\"; remap \"/cmd_vel\" -> \"/robot1/cmd_vel\"; params \"/dev/null\"; done;",
    );
    for code in [0, 3] {
        ros2.write("code", &code.to_string(), 0o644);
        let ended = run(&cluster, &ros, &spec).ended(SOON);
        assert_eq!(ended.code == Some(0), code == 0, "{ended}");
        assert_eq!(ended.err.contains("has ended with exit code 3"), code == 3, "{ended}");
    }
    assert_eq!(ros2.read("middleware"), "rmw_zenoh_cpp\n");
    assert_eq!(
        ros2.read("arguments"),
        "<--fast><--ros-args><-r><__ns:=/robot1><-r><__node:=nav><-r></cmd_vel:=/robot1/cmd_vel><--params-file></dev/null>\
         <-p><label:=\"7 'x'\"><-p><gain:=2.0><-p><depth:=5>\
         <-p><names:=[\"1\", \"x y\", \"\"]><-p><gains:=[1.0, 2.0]><-p><raw:=\"007\">"
    );
    assert_eq!(ros2.read("own"), "nonenone\n");
    cluster.expect_nothing_left(Duration::from_secs(5));
}

/// SIGINT comes first. Afterwards no process that the program has started is left, even if it has left the program's session.
#[test]
fn a_stop_interrupts_a_program_and_leaves_nothing_of_it() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let script = "#!/bin/sh\ntrap 'echo interrupted > \"$FAKE/how\"; exit 0' INT\necho working\nsetsid sleep 3600 &\necho $! >> \"$FAKE/pids\"\n\
                  echo $$ >> \"$FAKE/pids\"\nwhile true; do sleep 0.05; done\n";
    let stubborn = "#!/bin/sh\ntrap '' INT TERM\necho $$ >> \"$FAKE/pids\"\nwhile true; do sleep 0.05; done\n";
    let launch = "#!/bin/sh\necho \"$@\" > \"$FAKE/arguments\"\nexec \"$FAKE/lib/demo/nav\"\n";
    let ros2 = Installation::new(
        &cluster,
        &[
            ("lib/demo/nav", script),
            ("bin/ros2", launch),
            ("share/demo/launch/up.launch.py", ""),
            ("lib/demo/stubborn", stubborn),
        ],
    );
    for (number, what) in (1..).zip(["demo nav", "demo up.launch.py slam:=true"]) {
        let mission = run(&cluster, &ros, &ros2.spec(&format!("ros \"{what}\"; service;")));
        let pids = [2 * number - 1, 2 * number].map(|count| ros2.started(count, &mission));
        let logs = || cluster.here().ask(&["logs", "main/nav"]).out;
        assert!(wait_until(SOON, || logs().contains("working")).is_some(), "{}", logs());
        stopped(mission, &cluster);
        assert_eq!(ros2.read("how"), "interrupted\n");
        assert!(!pids.into_iter().any(is_running));
        fs::remove_file(ros2.folder.join("how")).expect("the file is ours");
    }
    let expected = "launch --noninteractive demo up.launch.py slam:=true label:=7 'x' gain:=2 depth:=5 \
                    names:=[\"1\", \"x y\", \"\"] gains:=[1.0, 2.0] raw:=007\n";
    assert_eq!(ros2.read("arguments"), expected);
    let mission = run(&cluster, &ros, &ros2.spec("ros \"demo stubborn\"; service; stop within 100 ms;"));
    let pid = ros2.started(5, &mission);
    stopped(mission, &cluster);
    assert!(!is_running(pid));
}

#[test]
fn a_program_that_is_not_installed_is_refused_before_anything_runs() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = Installation::new(&cluster, &[("lib/demo/nav", SLEEPER)]);
    let spec = ros2.spec("ros \"demo nav\"; service;");
    for (from, to, why) in [
        ("setup.bash", "none.bash", "none.bash` cannot be read: No such file or directory"),
        ("/setup.bash", "", "opt ros` cannot be read: it is a directory"),
        ("demo nav", "other nav", "ROS 2 has no package `other` in"),
        ("demo nav", "demo nag", "package `demo` has no executable `nag`;"),
        ("demo nav\"; service", "demo nav\"; params \"none.yaml\"; service", "none.yaml` cannot be read"),
    ] {
        let ended = run(&cluster, &ros, &spec.replace(from, to)).ended(SOON);
        assert!(ended.code == Some(1) && format!("{}{}", ended.out, ended.err).contains(why), "{why}: {ended}");
    }
    assert_eq!(ros2.read("pids"), "");
}

#[test]
fn a_node_is_configured_active_and_deactivated() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = Installation::new(&cluster, &[("lib/demo/nav", SLEEPER)]);
    let mission = run(&cluster, &ros, &ros2.spec(LIFECYCLE));
    let pid = ros2.started(1, &mission);
    let node = Node::new(&ros);
    // The answer to `configure` is late, and the mission waits for this answer.
    node.set(|seen| seen.holding = Some(CONFIGURE));
    node.expect(CONFIGURE, &mission);
    assert!(node.changes.recv_timeout(Duration::from_millis(300)).is_err(), "it is not activated yet");
    node.set(|seen| {
        (seen.holding, seen.state) = (None, INACTIVE);
        seen.held.drain(..).for_each(|query| reply(&query, &[0, 1, 0, 0, 1]));
    });
    node.expect(ACTIVATE, &mission);
    assert!(is_running(pid));
    mission.signal(Signal::INT);
    node.expect(DEACTIVATE, &mission);
    let ended = mission.ended(SOON);
    assert!(ended.err.contains("stopped") || ended.out.contains("stopped"), "{ended}");
    assert!(!is_running(pid));
    cluster.expect_nothing_left(Duration::from_secs(5));
}

/// A navigation mission. A stop cancels the goal of the action, and deactivates the node that serves it.
#[test]
fn a_goal_of_a_node_is_canceled_and_the_node_deactivated() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = Installation::new(&cluster, &[("lib/demo/nav", SLEEPER)]);
    let servers = [SEND, RESULT, CANCEL].map(|key| serve(&ros, key));
    let [sent, asked, canceled] = &servers.each_ref().map(|(_, queries)| queries);
    let goal = "module Count(host) { action \"/fib\": ros.example.Fibonacci; }";
    let spec = ros2.spec(LIFECYCLE).replace("Nav(c1);", "Nav(c1); order instof Order(c1); count instof Count(c1);");
    let spec = format!("{goal}\n{}", spec.replace("{ nav }", "{ nav # (order : count) }"));
    let mission = run(&cluster, &ros, &spec);
    ros2.started(1, &mission);
    let node = Node::new(&ros);
    node.expect(CONFIGURE, &mission);
    node.expect(ACTIVATE, &mission);
    let goal = sent.recv_timeout(SOON).unwrap_or_else(|_| panic!("{}", mission.text(Stream::Err)));
    reply(&goal, &[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    let question = asked.recv_timeout(SOON).expect("it asks for the result");
    mission.signal(Signal::INT);
    let cancel = canceled.recv_timeout(SOON).expect("a stop cancels the goal");
    reply(&cancel, &[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    reply(&question, &[0, 1, 0, 0, 5, 0, 0, 0, 1, 0, 0, 0, 7, 0, 0, 0]);
    node.expect(DEACTIVATE, &mission);
    let ended = mission.ended(SOON);
    assert!(format!("{}{}", ended.out, ended.err).contains("stopped"), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(5));
}

#[test]
fn a_node_that_cannot_be_configured_is_refused_with_its_reason() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = Installation::new(&cluster, &[("lib/demo/nav", SLEEPER), ("lib/demo/dies", "#!/bin/sh\nexit 7\n")]);
    let spec = ros2.spec(&LIFECYCLE.replace("20 s", "1 s"));
    let ended = run(&cluster, &ros, &spec.replace("demo nav", "demo dies")).ended(SOON);
    let why = "has ended with exit code 7 before it was configured";
    assert!(ended.code == Some(1) && format!("{}{}", ended.out, ended.err).contains(why), "{ended}");
    // First the services are missing, then an answer is missing, then a transition fails.
    for (number, why) in (1..).zip([
        "its service `/robot1/nav/change_state` is not there after 1 s",
        "it has not answered the request to configure in time",
        "it has failed to configure, and is unconfigured; its output says why",
    ]) {
        let mission = run(&cluster, &ros, &spec);
        let pid = ros2.started(number, &mission);
        let node = (number > 1).then(|| Node::new(&ros));
        let transition = Some(CONFIGURE);
        node.iter().for_each(|node| {
            node.set(|seen| if number == 2 { seen.holding = transition } else { seen.failing = transition });
        });
        let ended = mission.ended(SOON);
        assert!(ended.code == Some(1) && format!("{}{}", ended.out, ended.err).contains(why), "{why}: {ended}");
        assert!(!is_running(pid));
    }
    cluster.expect_nothing_left(Duration::from_secs(5));
}

/// The test covers a crash, a silent node, and another client. The process aborts with the reason, and the mission continues without
/// it.
#[test]
fn a_node_that_fails_while_it_runs_aborts_its_process() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = Installation::new(&cluster, &[("lib/demo/nav", SLEEPER)]);
    let spec = ros2.spec(&LIFECYCLE.replace("20 s", "3 s"));
    for (number, why) in (1..).zip([
        "has ended with SIGSEGV",
        "it is inactive: another client, or the node itself, has changed its state",
        "it has not reported its state for 3 s",
    ]) {
        let mission = run(&cluster, &ros, &spec);
        let pid = ros2.started(number, &mission);
        let node = Node::new(&ros);
        node.expect(CONFIGURE, &mission);
        node.expect(ACTIVATE, &mission);
        match number {
            1 => kill_process(pid, Signal::SEGV).expect("it runs"),
            2 => {
                node.set(|seen| seen.state = INACTIVE);
                // The bytes are the time, and three times a number and an empty label, each with its gap.
                let label = [1, 0, 0, 0, 0];
                let event = [&[0, 1, 0, 0][..], &[0; 8], &[4, 0, 0, 0], &label, &[3, 0, 0], &label, &[2, 0, 0], &label];
                let event = event.concat();
                ros.session.put(EVENT, event).attachment(attachment(1)).wait().expect("a peer");
            }
            _ => node.set(|seen| seen.is_silent = true),
        }
        let ended = mission.ended(SOON);
        assert!(ended.code == Some(1) && format!("{}{}", ended.out, ended.err).contains(why), "{why}: {ended}");
        assert!(wait_until(SOON, || !is_running(pid)).is_some());
    }
    cluster.expect_nothing_left(Duration::from_secs(5));
}

/// The death of the program is the death of its process, so the rules for restarts apply.
#[test]
fn a_killed_program_is_started_again_and_active_again() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = Installation::new(&cluster, &[("lib/demo/nav", SLEEPER)]);
    let spec = ros2.spec(LIFECYCLE).replace("Nav(c1);", "Nav(c1) { restart transient; };");
    let mission = run(&cluster, &ros, &spec);
    let first = ros2.started(1, &mission);
    let node = Node::new(&ros);
    node.expect(CONFIGURE, &mission);
    node.expect(ACTIVATE, &mission);
    drop(node);
    kill_process(first, Signal::KILL).expect("it runs");
    let second = ros2.started(2, &mission);
    let node = Node::new(&ros);
    node.expect(CONFIGURE, &mission);
    node.expect(ACTIVATE, &mission);
    // The DCA program dies. The ROS 2 program dies with it, and both are started again.
    drop(node);
    cluster.expect_leaf("main/nav").signal(Signal::KILL);
    ros2.started(3, &mission);
    assert!(!is_running(second));
    let node = Node::new(&ros);
    node.expect(CONFIGURE, &mission);
    node.expect(ACTIVATE, &mission);
    mission.signal(Signal::INT);
    node.expect(DEACTIVATE, &mission);
    let ended = mission.ended(SOON);
    let shown = format!("{}{}", ended.out, ended.err);
    assert!(shown.contains("SIGKILL") && shown.contains("stopped"), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(5));
}

/// A node that refuses to be deactivated is ended, so that a stopped process is never active.
#[test]
fn a_node_that_does_not_deactivate_is_ended() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let ros2 = Installation::new(&cluster, &[("lib/demo/nav", SLEEPER)]);
    for (number, is_late) in (1..).zip([false, true]) {
        let module = format!("{LIFECYCLE} stop within 500 ms;");
        let mission = run(&cluster, &ros, &ros2.spec(&module));
        let pid = ros2.started(number, &mission);
        let node = Node::new(&ros);
        node.expect(CONFIGURE, &mission);
        node.expect(ACTIVATE, &mission);
        let transition = Some(DEACTIVATE);
        node.set(|seen| if is_late { seen.holding = transition } else { seen.failing = transition });
        mission.signal(Signal::INT);
        node.expect(DEACTIVATE, &mission);
        let ended = mission.ended(SOON);
        assert!(format!("{}{}", ended.out, ended.err).contains("stopped"), "{ended}");
        assert!(!is_running(pid));
    }
    cluster.expect_nothing_left(Duration::from_secs(5));
}
