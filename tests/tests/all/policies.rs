//! The consequences for programs that die, and for programs on a cut-off host, under the policies of the spec.

use comms::io::clock::now;
use dca_tests::cluster::{Cluster, Network, Program, SOON, Stream, Trace, Turn, spec, wait_until};
use node::logic::protocol::{Change, Ending, ProcessStatus};
use rustix::process::Signal;
use std::time::Duration;

const MISSION_MAX: Duration = Duration::from_secs(120);

/// Returns how often a program was restarted, and how often it then continued its activation.
fn restarts(trace: &Trace, leaf: &str) -> (usize, usize) {
    let changes = trace.changes(leaf);
    let count = |is: fn(&Change) -> bool| changes.iter().filter(|change| is(change)).count();
    (count(|change| matches!(change, Change::Restarting { .. })), count(|change| *change == Change::Resumed))
}

#[track_caller]
fn kill(cluster: &Cluster, leaf: &str) {
    cluster.expect_leaf(leaf).signal(Signal::KILL);
}

/// The laser, the servoing law, the law that moves the robot, and a hand that waits for its turn are killed while the
/// robot servos. Three hosts run in one command, and wires cross two of them. The door still opens.
#[test]
#[ignore = "long: a real door"]
fn the_door_opens_although_programs_died() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let mut text = std::fs::read_to_string(spec("door_opening")).expect("the spec is there");
    let restarted = [
        ("laser instof LaserSensor(host1)", "distdetect/laser", 1),
        ("visualserv instof VisualServoing(host1)", "visualserv", 1),
        ("redundancy instof RedundancyResolution(host1)", "motionctrl/redundancy", 1),
        ("fingers instof GripperControl(host1, \"close\")", "closegrip/fingers", 0),
    ];
    for (instance, _, _) in restarted {
        let (before, after) = text.split_once(&format!("{instance};")).unwrap_or_else(|| panic!("no `{instance};`"));
        text = format!("{before}{instance} {{ restart transient; }}{after}");
    }
    let mission = cluster.here().dca(&["run", &cluster.file("door_opening.dca", &text)]);
    mission.wait_for_times(Stream::Err, "▸ (visualserv # distdetect)", 2, SOON);
    for (_, leaf, _) in restarted {
        kill(&cluster, &format!("main/dooropensyst/{leaf}"));
        mission.wait_for(Stream::Err, &format!("! dooropensyst/{leaf} died and is started again"), SOON);
    }
    let ended = mission.ended(MISSION_MAX);
    assert!(ended.code == Some(0) && ended.out.starts_with("door_opening: done"), "{ended}");
    assert!(ended.out.contains("died and is started again (1 of 5 in 60 s): SIGKILL (external)"), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));
    let trace = Trace::read(&cluster.folder().join("runs/door_opening-1"));
    for (_, leaf, resumed) in restarted {
        assert_eq!(restarts(&trace, &format!("main/dooropensyst/{leaf}")), (1, resumed), "{leaf}");
    }
}

#[test]
fn what_dies_too_often_is_given_up() {
    let cluster = Cluster::new();
    let script = cluster.file("broken.sh", "echo run >> runs.txt; exit 3");
    let text = format!(
        "module Broken(host) {{ exec \"sh {script}\"; plain; done; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{ broken instof Broken(c1) {{ restart transient; }} }}
            internal_event_actions {{ broken }}
        }}"
    );
    let ended = cluster.here().ask(&["run", &cluster.file("broken.dca", &text)]);
    let chain = "main ← broken: left with exit code 3 before it was done after 5 restarts at ";
    assert!(ended.code == Some(1) && ended.out.contains(chain), "{ended}");
    let runs = std::fs::read_to_string(cluster.folder().join("runs.txt")).expect("it ran");
    assert_eq!(runs.lines().count(), 6);
    cluster.expect_nothing_left(Duration::from_secs(2));
}

/// A source on one host feeds two monitors on another. The source is killed twice, and one monitor in between. The
/// other monitor continues to receive values, so dialling programs are informed across hosts.
#[test]
fn who_is_started_again_is_found_from_other_hosts() {
    let cluster = Cluster::new();
    let Some(network) = Network::new(2) else { return };
    let hosts = [1, 2].map(|number| cluster.host(&network, number));
    let nodes = [hosts[0].node("c1", &["--lan"]), hosts[1].node("c2", &["--lan"])];
    let text = "
        process main() {
            host { c1 }
            instantiated_processes {
                source instof RateSource(c1) { restart transient; }
                monitor instof RateMonitor(c2);
                other instof RateMonitor(c2) { restart transient; }
            }
            internal_connections(source, lbl1) { source, Out -> monitor, In; source, Out -> other, In; }
            internal_event_actions { source[lbl1], monitor, other }
        }";
    let mission = hosts[0].dca(&["deploy", &cluster.file("beats.dca", text)]);
    mission.wait_for(Stream::Err, "▸", SOON);
    // A program that is killed before it resumes its activation still resumes it only once.
    let running = |leaf: &str| {
        let path = format!("main/{leaf}");
        let is_running =
            |(_, one): (String, ProcessStatus)| (one.path == path && one.state == "running").then_some(one.pid);
        hosts[0].processes(&[]).into_iter().find_map(is_running).flatten()
    };
    let mut killed_at = now();
    for leaf in ["source", "other", "source"] {
        wait_until(SOON, || running(leaf).is_some()).unwrap_or_else(|| panic!("`{leaf}` does not run"));
        let before = running(leaf);
        killed_at = now();
        kill(&cluster, &format!("main/{leaf}"));
        let goes_on = || running(leaf).is_some_and(|after| Some(after) != before);
        wait_until(SOON, goes_on).unwrap_or_else(|| panic!("`{leaf}` is not started again"));
    }
    let beats = |trace: &Trace| {
        let received = trace.signal("main/monitor", "received");
        let first = received.iter().find(|sample| sample.stamp >= killed_at)?.value;
        Some((first, received.last()?.value))
    };
    // While the record is being written, it already shows the values so far.
    let runs = cluster.folder().join("runs/beats-1");
    let is_heard = || beats(&Trace::so_far(&runs)).is_some_and(|(first, last)| last > first + 50.0);
    wait_until(SOON, is_heard).unwrap_or_else(|| panic!("few beats: {:?}", beats(&Trace::so_far(&runs))));
    let stop = hosts[1].ask(&["stop", "beats"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    drop(mission.ended(SOON));
    let trace = Trace::read(&runs);
    assert_eq!((restarts(&trace, "main/source"), restarts(&trace, "main/other")), ((2, 2), (1, 1)));
    end(&cluster, nodes);
}

/// The host of three programs is cut off. One program stops by its own policy, one stops with its host, and one
/// continues until the host is back.
#[test]
fn a_host_that_is_cut_off_does_as_its_programs_say() {
    let cluster = Cluster::new();
    let Some(network) = Network::new(2) else { return };
    let hosts = [1, 2].map(|number| cluster.host(&network, number));
    let nodes = [hosts[0].node("c1", &["--lan"]), hosts[1].node("c2", &["--lan"])];
    let text = "
        module Sleeper(host) { exec \"sleep 600\"; plain; service; }
        process main() {
            host { c1 }
            instantiated_processes {
                stays instof Sleeper(c2) { on_link_loss keep; }
                soon instof Sleeper(c2) { on_link_loss safe_stop_after 1 s; }
                other instof Sleeper(c2);
            }
            internal_event_actions { stays, soon, other }
        }";
    let mission = hosts[0].dca(&["deploy", &cluster.file("cut.dca", text)]);
    let runs = |name: &str| cluster.leaf(&format!("main/{name}")).is_some();
    wait_until(SOON, || runs("stays") && runs("soon") && runs("other")).expect("all of them run");
    network.cut(2);
    wait_until(SOON, || !runs("soon")).expect("it stops 1 s after its supervisor was missed");
    assert!(runs("other"), "its supervisor is not lost before 5 s");
    wait_until(SOON, || !runs("other")).expect("its home is lost");
    let ended = mission.ended(SOON);
    assert!(ended.code == Some(1) && ended.out.contains("not confirmed that nothing is left on: c2"), "{ended}");
    assert!(runs("stays"));
    let stop = hosts[1].ask(&["stop", "cut"]);
    assert!(stop.code == Some(3) && stop.err.contains("`dca stop cut --away c1`"), "a lost home gets no stop: {stop}");
    network.heal(2);
    wait_until(SOON, || !runs("stays")).expect("its home has given it up");
    let trace = Trace::read(&cluster.folder().join("runs/cut-1"));
    assert!(matches!(trace.finished().0, Ending::Aborted(_)));
    end(&cluster, nodes);
}

const SHORT: &str = "
    module Near(host) { exec \"true\"; plain; done; }
    process main() {
        host { c1 }
        instantiated_processes { near instof Near(c2); }
        internal_event_actions { near }
    }";

/// A host is cut off for longer than allowed, and returns. Its group is restarted, and a wire across the cut carries
/// data again.
#[test]
fn a_lost_host_takes_part_again() {
    let cluster = Cluster::new();
    let Some(network) = Network::new(2) else { return };
    let hosts = [1, 2].map(|number| cluster.host(&network, number).with_log("node=debug,comms=debug"));
    let nodes = [hosts[0].node("c1", &["--lan"]), hosts[1].node("c2", &["--lan"])];
    let text = "
        module Sleeper(host) { exec \"sleep 600\"; plain; done; }
        process Far() {
            host { c2 }
            external_io { Out = source, Out; }
            instantiated_processes { source instof RateSource(c2); sleeper instof Sleeper(c2); }
            internal_event_actions { source, sleeper }
        }
        process main() {
            host { c1 }
            instantiated_processes { monitor instof RateMonitor(c1); far instof Far(); }
            internal_connections(monitor, on) { far, Out -> monitor, In; }
            internal_event_actions { monitor[on], ((far else skip) ;; wait(1 s)) }
        }";
    let mission = hosts[0].dca(&["deploy", &cluster.file("again.dca", text)]);
    mission.wait_for(Stream::Err, "started in", SOON);
    let sleeper = || cluster.leaf("main/far/sleeper").map(|process| process.pid);
    let first = wait_until(SOON, || sleeper().is_some()).and_then(|_| sleeper()).expect("it runs");
    let received = || {
        let trace = Trace::so_far(&cluster.folder().join("runs/again-1"));
        trace.signal("main/monitor", "received").last().map_or(0.0, |sample| sample.value)
    };
    wait_until(SOON, || received() > 0.0).expect("data flows");
    network.cut(2);
    nodes[0].wait_for(Stream::Err, "is lost", SOON);
    wait_until(SOON, || sleeper().is_none()).expect("it stops by its own rules");
    let before = received();
    network.heal(2);
    let again = wait_until(SOON, || sleeper().is_some_and(|pid| pid != first));
    assert!(
        again.is_some(),
        "{}\n--- c1\n{}\n--- c2\n{}",
        mission.text(Stream::Err),
        nodes[0].text(Stream::Err),
        nodes[1].text(Stream::Err)
    );
    assert!(wait_until(SOON, || received() > before + 50.0).is_some(), "{}", hosts[0].ask(&["status"]));
    // The folders of the last eight finished deployments are kept. The first part of this deployment is one of them.
    let short = cluster.file("short.dca", SHORT);
    for _ in 0..9 {
        let done = hosts[0].ask(&["deploy", "--no-record", &short]);
        assert_eq!(done.code, Some(0), "{done}");
    }
    let socket = hosts[1].run_dir().join("c2/again.1/control.sock");
    assert!(socket.exists(), "what runs has its folder: {}", socket.display());
    assert_eq!(hosts[0].ask(&["stop", "again"]).code, Some(0));
    assert_eq!(mission.ended(SOON).code, Some(1));
    end(&cluster, nodes);
}

/// The node of a host is killed or suspended for longer than allowed, and in the meantime the program there dies. It is
/// not restarted for a mission that has continued without it.
#[test]
fn a_node_that_was_away_too_long_runs_nothing_again() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let home = here.node("c1", &[]);
    for (name, signal) in [("killed", Signal::KILL), ("asleep", Signal::STOP)] {
        let far = here.node("c2", &[]);
        let see = || here.statuses(&[]).iter().filter(|node| node.peers.len() == 1).count() == 2;
        wait_until(SOON, see).expect("they see each other");
        let ran = cluster.file(&format!("{name}.ran"), "");
        let text = format!(
            "module Far(host) {{ exec \"sh -c 'echo ran >> {ran}; exec sleep 600'\"; plain; done; }}
            module Near(host) {{ exec \"sleep 600\"; plain; done; }}
            process main() {{
                host {{ c1 }}
                instantiated_processes {{ far instof Far(c2) {{ restart transient; }} near instof Near(c1); }}
                internal_event_actions {{ far else near }}
            }}"
        );
        let mission = here.dca(&["deploy", &cluster.file(&format!("{name}.dca"), &text)]);
        let runs = || std::fs::read_to_string(&ran).expect("it is there").lines().count();
        wait_until(SOON, || runs() == 1).unwrap_or_else(|| panic!("{name}: {}", mission.text(Stream::Err)));
        far.signal(signal);
        let goes_on_without_it = || {
            kill(&cluster, "main/far");
            wait_until(SOON, || cluster.leaf("main/near").is_some()).expect("its home has given it up");
        };
        let far = if signal == Signal::KILL {
            assert_eq!(far.ended(SOON).signal, Some(9));
            goes_on_without_it();
            here.node("c2", &[])
        } else {
            goes_on_without_it();
            far.signal(Signal::CONT);
            far
        };
        let is_idle =
            |(host, one): &(String, ProcessStatus)| host == "c2" && one.path == "main/far" && one.state == "idle";
        let takes_part = || here.processes(&[]).iter().any(is_idle);
        wait_until(SOON, takes_part).unwrap_or_else(|| panic!("{name}: {}", here.ask(&["status"])));
        assert_eq!(runs(), 1, "{name}: {}", far.text(Stream::Err));
        assert!(cluster.leaf("main/near").is_some());
        assert_eq!(here.ask(&["stop", name]).code, Some(0));
        assert_eq!(mission.ended(SOON).code, Some(1));
        far.signal(Signal::TERM);
        assert_eq!(far.ended(SOON).code, Some(0));
    }
    end(&cluster, [home]);
}

/// The host of a program that holds the arm is cut off, and the program continues there. Another program gets the arm
/// only after that host is back and has ended the first program.
#[test]
fn what_a_host_that_is_cut_off_may_use_is_given_to_nobody() {
    let cluster = Cluster::new();
    let Some(network) = Network::new(2) else { return };
    let hosts = [1, 2].map(|number| cluster.host(&network, number));
    let nodes = [hosts[0].node("c1", &["--lan"]), hosts[1].node("c2", &["--lan"])];
    let text = "
        module Far(host) { exec \"sleep 600\"; plain; done; }
        module Near(host) { exec \"true\"; plain; done; }
        process main() {
            host { c1 }
            resource arm;
            instantiated_processes { far instof Far(c2) { on_link_loss keep; } near instof Near(c1); }
            internal_event_actions { (using(arm) far)? , (wait(1 s) ; using(arm) near) }
        }";
    let mission = hosts[0].dca(&["deploy", &cluster.file("arm.dca", text)]);
    let runs = |name: &str| cluster.leaf(&format!("main/{name}")).is_some();
    wait_until(SOON, || runs("far")).expect("it has the arm");
    network.cut(2);
    mission.wait_for(Stream::Err, "near waits for `arm`: the host `c2` is lost and may still use it", SOON);
    assert!(runs("far") && mission.is_running());
    network.heal(2);
    let ended = mission.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert!(!runs("far"));
    end(&cluster, nodes);
}

fn end<const COUNT: usize>(cluster: &Cluster, nodes: [Program; COUNT]) {
    for node in nodes {
        node.signal(Signal::TERM);
        let ended = node.ended(SOON);
        assert_eq!(ended.code, Some(0), "{ended}");
    }
    cluster.expect_nothing_left(Duration::from_secs(2));
}
