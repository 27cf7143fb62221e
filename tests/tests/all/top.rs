//! `dca top` at a terminal, with real processes.

use dca_tests::cluster::{Cluster, SOON, Stream, wait_until};
use rustix::process::Signal;

/// A program that writes, and an activity with a question.
const SPEC: &str = "
    module Talker(host) { exec \"sh -c 'echo hello from the talker; exec sleep 600'\"; plain; done; }
    module Sleeper(host) { exec \"sleep 600\"; plain; done; }
    activity Ask(here: Host) {
        host{here}
        one instof Sleeper(here);
        two instof Sleeper(here);
        initial state waiting { run one; on after 1 s confirm operator \"Go on?\" options(yes -> moving, no -> done); }
        state moving { run two; on done -> done; }
    }
    process main() {
        host{c1}
        instantiated_processes { talker instof Talker(c1); ask instof Ask(c1); }
        internal_event_actions { talker , ask }
    }";

/// The output that leaves the other screen and shows the cursor.
const GIVEN_BACK: &str = "\x1b[?25h\x1b[?1049l";

#[test]
fn a_person_looks_answers_stops_everything_and_leaves() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("door.dca", SPEC)]);
    mission.wait_for(Stream::Err, "started in", SOON);
    let mut top = here.typed(80, &[], &["top"]);
    let shown = top.wait_for("asks a question");
    assert!(shown.contains("1 robot") && shown.contains("door@1") && shown.contains("talker: Talker"), "{shown}");
    assert!(shown.lines().all(|line| line.chars().count() <= 80), "{shown}");
    // The output of a process is selected: the cursor goes to the last row, which is the talker.
    top.press("G\r");
    top.wait_for("hello from the talker");
    top.press("6");
    top.wait_for("Go on?");
    top.press("a");
    top.wait_for("Answer: 1: yes  2: no");
    top.press("1");
    top.wait_for("has taken the answer `yes`");
    assert!(wait_until(SOON, || cluster.leaf("main/ask/two").is_some()).is_some());
    top.wait_for("no question is open");
    top.press("E");
    top.wait_for("Stop everything on 1 robot at once?");
    assert!(cluster.leaf("main/talker").is_some());
    top.press("y");
    top.wait_for("EVERYTHING IS STOPPED");
    assert!(wait_until(SOON, || here.pids().is_empty()).is_some());
    top.press("q");
    let left = top.left();
    assert_eq!((left.code, left.is_restored), (Some(0), true), "{left:?}");
    assert!(left.written.contains(GIVEN_BACK), "{left:?}");
    assert_eq!(mission.ended(SOON).code, Some(1));
}

/// The keys for a stop and for leaving arrive at once, as on a slow line.
#[test]
fn an_order_that_was_given_is_carried_out_though_the_person_leaves() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("door.dca", SPEC)]);
    mission.wait_for(Stream::Err, "started in", SOON);
    let mut top = here.typed(80, &[], &["top"]);
    top.wait_for("talker: Talker");
    top.press("Eyq");
    let left = top.left();
    assert_eq!((left.code, left.is_restored), (Some(0), true), "{left:?}");
    let (_, after) = left.written.rsplit_once(GIVEN_BACK).expect("the terminal is given back");
    assert!(after.contains("c1: stopped; no program runs"), "{left:?}");
    assert!(wait_until(SOON, || here.pids().is_empty()).is_some());
    assert_eq!(mission.ended(SOON).code, Some(1));
}

#[test]
fn the_terminal_is_given_back_after_a_signal_and_without_colours_none_are_sent() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    for signal in [Signal::TERM, Signal::INT, Signal::HUP, Signal::QUIT] {
        let mut top = here.typed(80, &[("NO_COLOR", "1")], &["top", "--ascii"]);
        top.wait_for("nothing is deployed");
        top.signal(signal);
        let left = top.left();
        assert_eq!((left.code, left.is_restored), (Some(0), true), "{left:?}");
        assert!(left.written.contains(GIVEN_BACK), "{left:?}");
        let colours = (30..38).map(|code| format!(";{code}m"));
        assert!(left.written.is_ascii() && colours.into_iter().all(|code| !left.written.contains(&code)), "{left:?}");
    }
}

#[test]
fn without_a_terminal_or_a_node_it_says_what_is_missing() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let piped = here.ask(&["top"]);
    assert_eq!((piped.code, piped.out.as_str()), (Some(2), ""), "{piped}");
    assert!(piped.err.contains("`dca top` needs a terminal") && piped.err.contains("`dca status --watch`"), "{piped}");
    let alone = here.typed(80, &[], &["top"]).left();
    assert_eq!((alone.code, alone.is_restored), (Some(3), true), "{alone:?}");
    assert!(alone.written.contains("no node runs on this machine") && !alone.written.contains("1049"), "{alone:?}");
}
