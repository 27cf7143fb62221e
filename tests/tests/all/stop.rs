//! Every way to end a mission early leaves nothing behind.

use comms::io::clock;
use dca_tests::cluster::{Cluster, Process, Program, SOON, Stream, Trace, Turn, executable, spec, wait_until};
use node::logic::protocol::Ending;
use rustix::process::Signal;
use std::os::unix::fs::FileTypeExt as _;
use std::time::Duration;

/// How long anything without an owner may last.
const ORPHAN_MAX: Duration = Duration::from_secs(10);
const SLEEP: &str = "
module Sleep(host) { exec \"sleep 600\"; plain; done; }
process main() { host { c1 } instantiated_processes { p instof Sleep(c1); } internal_event_actions { p } }
";
const SERVOING: &str = "▸ (visualserv # distdetect)";

/// Waits until a started mission has been servoing for a while.
fn servoing(mission: Program) -> Program {
    mission.wait_for_times(Stream::Err, SERVOING, 2, SOON);
    mission
}

/// Ctrl-C stops the mission cleanly.
#[test]
fn an_interrupt_ends_the_mission() {
    let _turn = Turn::take();
    for signal in [Signal::INT, Signal::TERM] {
        let cluster = Cluster::new();
        let mission = servoing(cluster.here().dca(&["run", &spec("door_opening")]));
        mission.signal(signal);
        let ended = mission.ended(SOON);
        assert_eq!(ended.code, Some(1), "{ended}");
        assert!(ended.out.starts_with("door_opening: stopped after"), "{ended}");
        cluster.expect_nothing_left(Duration::from_secs(2));
        let trace = Trace::read(&cluster.folder().join("runs/door_opening-1"));
        assert_eq!(trace.finished().0, Ending::Stopped);
        assert!(trace.has_page());
    }
}

/// An interrupt before the mission has begun also leaves nothing.
#[test]
fn an_interrupt_at_once_ends_the_mission() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let mission = cluster.here().dca(&["run", &spec("door_opening")]);
    mission.wait_for(Stream::Err, "starting 22 programs", SOON);
    mission.signal(Signal::INT);
    let ended = mission.ended(SOON);
    assert_eq!(ended.code, Some(1), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));
}

/// After `kill -9` of `dca run`, no process is left after 10 s.
#[test]
fn a_killed_command_leaves_nothing() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let mission = servoing(cluster.here().dca(&["run", &spec("door_opening")]));
    assert!(cluster.left().len() > 40, "22 programs and their shims: {:?}", cluster.left());
    mission.signal(Signal::KILL);
    assert_eq!(mission.ended(SOON).signal, Some(9));
    let took = cluster.expect_nothing_left(ORPHAN_MAX);
    println!("nothing left {took:.1?} after the kill");
}

/// The rule for orphans: `kill -9` of one of three nodes leaves nothing on its host after 10 s, and the mission ends.
#[test]
fn a_killed_node_leaves_nothing_on_its_host() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let here = cluster.here();
    let [_c1, c2, _c3] = ["c1", "c2", "c3"].map(|name| here.node(name, &["--agent-loss-grace", "5"]));
    let mission = servoing(here.dca(&["deploy", &spec("door_opening")]));
    let of_c2 = || {
        let folder = here.run_dir().join("c2").display().to_string();
        let shims_and_programs = cluster.left().into_iter();
        shims_and_programs.filter(|one| format!("{one:?} {:?}", one.environment).contains(&folder)).count()
    };
    assert_eq!(of_c2(), 8, "four programs and their shims: {:?}", cluster.left());
    c2.signal(Signal::KILL);
    assert_eq!(c2.ended(SOON).signal, Some(9));
    let took = wait_until(ORPHAN_MAX, || of_c2() == 0).unwrap_or_else(|| panic!("left: {:?}", cluster.left()));
    println!("nothing left on c2 {took:.1?} after the kill");

    let ended = mission.ended(SOON);
    assert_eq!(ended.code, Some(1), "{ended}");
    assert!(ended.out.contains("host `c2` could not be reached any more"), "{ended}");
    assert!(ended.out.contains("not confirmed that nothing is left on: c2"), "{ended}");
    let programs = || cluster.left().into_iter().filter(|one| one.command[0].ends_with("dca-shim")).count();
    wait_until(ORPHAN_MAX, || programs() == 0).unwrap_or_else(|| panic!("left: {:?}", cluster.left()));
}

/// A node that is told to leave ends its part of all missions, and then leaves.
#[test]
fn a_node_that_leaves_takes_its_programs_along() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let here = cluster.here();
    let nodes = ["c1", "c2", "c3"].map(|name| here.node(name, &[]));
    let mission = servoing(here.dca(&["deploy", &spec("door_opening")]));
    for node in &nodes {
        node.signal(Signal::TERM);
    }
    for node in nodes {
        let ended = node.ended(SOON);
        assert_eq!(ended.code, Some(0), "{ended}");
    }
    let ended = mission.ended(SOON);
    assert!(ended.code == Some(1) || ended.code == Some(3), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));
}

/// A node whose terminal closes leaves as if it were told to. `nohup` keeps a node running.
#[test]
fn a_node_leaves_with_its_terminal() {
    let cluster = Cluster::new();
    let here = cluster.here();
    // The parent of this test may ignore the signal.
    let bound = here.node_under(&["--default-signal=HUP"], "c1");
    let mission = here.mission(&cluster.file("sleep.dca", SLEEP));
    bound.signal(Signal::HUP);
    let ended = bound.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert!(!mission.ended(SOON).out.is_empty());
    cluster.expect_nothing_left(Duration::from_secs(2));

    let free = here.node_under(&["nohup"], "c1");
    let mission = here.mission(&cluster.file("sleep.dca", SLEEP));
    free.signal(Signal::HUP);
    assert_eq!(here.ask(&["status", "sleep"]).code, Some(0), "it answers");
    assert!(free.is_running() && mission.is_running());
    free.signal(Signal::TERM);
    let ended = free.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
}

/// The parent of a node may have blocked SIGTERM or ignored SIGCHLD. The node resets both, and its programs inherit the
/// defaults.
#[test]
fn a_node_takes_its_signals_back() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let node = here.node_under(&["--block-signal=TERM", "--ignore-signal=CHLD"], "c1");
    let mission = here.mission(&cluster.file("sleep.dca", SLEEP));
    let sleeps = |one: &Process| one.command == ["sleep", "600"];
    let mut program = None;
    wait_until(SOON, || {
        program = cluster.left().into_iter().find(sleeps);
        program.is_some()
    });
    let program = program.expect("it runs");
    let status = std::fs::read_to_string(format!("/proc/{}/status", program.pid)).expect("it runs");
    let blocked = status.lines().find_map(|line| line.strip_prefix("SigBlk:")).expect("a status has it").trim();
    assert_eq!(u64::from_str_radix(blocked, 16), Ok(0), "{status}");
    node.signal(Signal::TERM);
    let ended = node.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    drop(mission);
    cluster.expect_nothing_left(Duration::from_secs(2));
}

/// A node whose run folder was removed continues, and so do its programs. A second node with the same name ends
/// nothing.
#[test]
fn a_second_node_leaves_the_first_alone_whose_folder_is_gone() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let node = here.node("c1", &[]);
    std::fs::remove_file(here.run_dir().join("c1/lock")).expect("it is there");
    let second = here.start_node("c1", &[]).ended(SOON);
    let taken = "a node named `c1` is already running on this machine";
    assert!(second.code == Some(1) && second.err.contains(taken), "{second}");
    assert_eq!(here.ask(&["status"]).code, Some(0), "the first one can still be reached");
    let mission = here.mission(&cluster.file("sleep.dca", SLEEP));
    let sleeps = || cluster.left().into_iter().find(|one| one.command == ["sleep", "600"]).map(|one| one.pid);
    wait_until(SOON, || sleeps().is_some()).expect("it runs");
    let first = sleeps();
    let aside = here.run_dir().with_extension("aside");
    std::fs::rename(here.run_dir(), aside).expect("it is there");
    let second = here.start_node("c1", &[]).ended(SOON);
    let told = format!("{taken}, as process {}", node.pid());
    assert!(second.code == Some(1) && second.err.contains(&told), "{second}");
    assert_eq!(sleeps(), first);
    node.signal(Signal::TERM);
    let ended = node.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    drop(mission);
    assert_eq!(sleeps(), None);
}

/// A process that may run on a lost host is reported until the host, or a person, has confirmed that nothing is left.
#[test]
fn what_a_lost_host_has_not_confirmed_is_told_until_it_is_back() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let nodes = ["c1", "c2"].map(|name| here.node(name, &[]));
    let text = "module Sleeper(host) { exec \"sleep 600\"; plain; }
        process main() {
            host { c1 }
            instantiated_processes { far instof Sleeper(c2); }
            internal_event_actions { far }
        }";
    let mission = here.dca(&["deploy", &cluster.file("far.dca", text)]);
    mission.wait_for(Stream::Err, "▸", SOON);
    nodes[1].signal(Signal::STOP);
    let ended = mission.ended(SOON);
    assert!(ended.code == Some(1) && ended.out.contains("not confirmed that nothing is left on: c2"), "{ended}");
    assert!(cluster.left().iter().any(|one| one.command == ["sleep", "600"]), "{:?}", cluster.left());
    let (status, listed) = (here.ask(&["status"]), here.ask(&["nodes"]));
    let row = status.out.lines().find(|line| line.starts_with("far@1")).unwrap_or_default();
    assert!(status.code == Some(0) && row.contains("unconfirmed on  c2 (lost, heard "), "{status}");
    assert!(status.err.contains("warning: `c2` is lost") && status.err.contains("--forget"), "{status}");
    let row = listed.out.lines().find(|line| line.starts_with("c2")).unwrap_or_default();
    assert!(row.contains("lost, heard ") && row.contains("far?"), "{listed}");
    for _ in 0..2 {
        let stop = here.ask(&["stop", "far"]);
        let told = stop.err.contains("`c2` (lost, heard ") && stop.err.contains("has not confirmed");
        assert!(stop.code == Some(3) && told, "{stop}");
    }
    let json: serde_json::Value = serde_json::from_str(&here.ask(&["status", "--json"]).out).expect("it is JSON");
    assert_eq!(json[0]["absent"]["ends"][0]["hosts"][0]["why"], "lost", "{json}");
    // The next node of the home knows this from its journal, even after nothing is left to adopt.
    let inputs = here.run_dir().join("c1/inputs");
    wait_until(SOON, || !inputs.exists()).expect("the end is long told");
    nodes[0].kill();
    let again = here.node("c1", &[]);
    let (status, listed) = (here.ask(&["status"]), here.ask(&["nodes"]));
    assert!(status.out.contains("far@1  unconfirmed on  c2 (not heard since `c1` was started again)"), "{status}");
    assert!(listed.out.lines().any(|line| line.starts_with("c2") && line.contains("not heard yet")), "{listed}");
    nodes[1].signal(Signal::CONT);
    wait_until(SOON, || here.ask(&["status"]).out == "nothing is deployed on c1, c2\n").expect("c2 has confirmed");
    let stop = here.ask(&["stop", "far"]);
    assert!(stop.code == Some(1) && stop.err.contains("no deployment `far` is running"), "{stop}");
    [&again, &nodes[1]].into_iter().for_each(|node| node.signal(Signal::TERM));
    cluster.expect_nothing_left(ORPHAN_MAX);
}

/// If a home is suspended while it stops, the command waits for it. It tells the person so, and how long it waits. Then
/// the stop ends well.
#[test]
fn a_home_that_does_not_answer_is_waited_for_with_a_note() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let nodes = ["c1", "c2"].map(|name| here.node(name, &[]));
    // The program takes its time, so that the home can be suspended between the order and the end.
    let stopping = cluster.folder().join("stopping");
    let script =
        format!("trap \\\"touch {}; sleep 5; exit 0\\\" TERM; while :; do sleep 0.1; done", stopping.display());
    let text = format!(
        "module Slow(host) {{ exec \"sh -c '{script}'\"; plain; stop within 30 s; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{ slow instof Slow(c1); }}
            internal_event_actions {{ slow }}
        }}"
    );
    let mission = here.dca(&["deploy", &cluster.file("slow.dca", &text)]);
    mission.wait_for(Stream::Err, "▸", SOON);
    let stop = here.dca(&["stop", "slow"]);
    wait_until(SOON, || stopping.exists()).unwrap_or_else(|| panic!("{}", stop.text(Stream::Err)));
    nodes[0].signal(Signal::STOP);
    stop.wait_for(Stream::Err, "asking again for 30 s (Ctrl-C to leave)", SOON);
    assert!(stop.text(Stream::Err).starts_with("note: the ") && stop.is_running(), "{}", stop.text(Stream::Err));
    nodes[0].signal(Signal::CONT);
    let stopped = stop.ended(SOON);
    assert!(stopped.code == Some(0) && stopped.out.contains("`slow` is stopped; nothing of it is left"), "{stopped}");
    // By now, a watching command may have given up the home.
    let watched = mission.ended(SOON);
    assert!(matches!(watched.code, Some(1 | 3)), "{watched}");
    nodes.iter().for_each(|node| node.signal(Signal::TERM));
    cluster.expect_nothing_left(ORPHAN_MAX);
}

/// After the end of a deployment, its output stays, but no socket is left, whether its programs were killed or have
/// ended.
#[test]
fn sockets_go_with_their_deployment() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let program = executable("dca-counting").display().to_string();
    let text = format!(
        "module Source(host) {{ exec \"'{program}' Source\"; out Out: Numbers; service; }}
        module Sleep(host) {{ exec \"sh -c 'echo WORD; exec sleep 600'\"; plain; done; }}
        process main() {{
        host {{ c1 }} instantiated_processes {{ source instof Source(c1); sleep instof Sleep(c1) {{ watchdog 1 h; }} }}
        internal_event_actions {{ source , sleep }} }}"
    );
    let sockets = || {
        let mut found = Vec::new();
        let mut folders = vec![here.run_dir().join("c1")];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
                let kind = entry.file_type().expect("Linux says it");
                if kind.is_dir() {
                    folders.push(entry.path());
                } else if kind.is_socket() && entry.file_name() != "node.sock" {
                    found.push(entry.path());
                }
            }
        }
        found
    };
    // Until this mission has written something, the logs show the previous one.
    for (kills, word) in [(false, "first"), (true, "second")] {
        let mission = here.mission(&cluster.file("two.dca", &text.replace("WORD", word)));
        wait_until(SOON, || here.ask(&["logs", "sleep"]).out.contains(word)).expect("it runs");
        assert!(sockets().len() >= 4, "{:?}", sockets());
        if kills {
            // Both programs end at once, since the end of one is the end of the mission.
            let programs = ["main/source", "main/sleep"].map(|path| cluster.expect_leaf(path));
            programs.iter().for_each(|program| program.signal(Signal::KILL));
        }
        here.ask(&["stop", "two"]);
        mission.ended(SOON);
        assert!(wait_until(SOON, || sockets().is_empty()).is_some(), "{:?}", sockets());
        assert!(here.ask(&["logs", "sleep"]).out.contains(word));
    }
}

/// A second Ctrl-C does not wait for a slow program, and leaves nothing of the mission behind.
#[test]
fn who_asks_twice_does_not_wait() {
    const STUBBORN: &str = "
module Stubborn(host) { exec \"sh -c 'trap : TERM INT; while :; do sleep 0.1; done'\"; plain; stop within 40 s; }
process main() { host { c1 } instantiated_processes { a instof Stubborn(c1); } internal_event_actions { a } }
";
    let cluster = Cluster::new();
    let mission = cluster.here().dca(&["run", "--no-record", &cluster.file("stubborn.dca", STUBBORN)]);
    mission.wait_for(Stream::Err, "▸", SOON);
    mission.signal(Signal::INT);
    mission.wait_for(Stream::Err, "press Ctrl-C again to leave without waiting", SOON);
    let asked = clock::now();
    mission.signal(Signal::INT);
    let ended = mission.ended(SOON);
    let took = clock::now() - asked;
    assert!(ended.code == Some(1) && ended.err.contains("this command ended while `"), "{ended}");
    println!("over {took:.2?} after the second Ctrl-C");
    assert!(took < Duration::from_secs(20), "the program has 40 s to stop: {took:?}");
    cluster.expect_nothing_left(Duration::from_secs(10));
}
