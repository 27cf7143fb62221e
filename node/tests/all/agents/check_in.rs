//! Nodes that were away for long begin nothing for a home that has given them up: on virtual time.

use super::adoption::Written;
use super::losses::{active, cut, heal};
use super::world::{Coming, Draw, World};
use node::logic::effect::ProcessId;
use node::logic::nameserver::Change as Peer;
use node::logic::protocol::{Answer, Change, Ending, Report};
use shim::protocol::ShimReport;
use std::collections::BTreeSet;
use std::time::Duration;

/// How a node is away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Away {
    Killed,
    Suspended,
}

const WAYS: [Away; 2] = [Away::Killed, Away::Suspended];

impl World {
    fn take_away(&mut self, host: &str, way: Away) {
        if way == Away::Killed {
            return self.crash(host);
        }
        let node = self.agents.remove(host).expect("it is there");
        self.down.insert(host.to_owned(), Vec::new());
        self.suspended_nodes.insert(host.to_owned(), node);
    }

    fn bring_back(&mut self, host: &str) {
        let Some(node) = self.suspended_nodes.remove(host) else { return self.adopt(host) };
        self.written.insert(host.to_owned(), Written::of(&node));
        self.agents.insert(host.to_owned(), node);
        let held = self.down.remove(host).expect("it is away");
        held.into_iter().for_each(|coming| self.at(0, host, coming));
    }

    /// Returns the programs that have begun on a host since the first `count` beginnings.
    fn begun_since(&self, count: usize, host: &str) -> Vec<&str> {
        let on_host = self.begins[count..].iter().filter(|(_, on, _)| on == host);
        on_host.map(|(_, _, what)| what.as_str()).collect()
    }
}

/// A program on c2 that is started again, with another one on c1 that takes its place.
const INSTEAD: &str = r#"
process main() {
    host { "c1" }
    instantiated_processes {
        far instof Long("c2") { restart transient; }
        near instof Tuned("c1");
        goes_on instof Sensor("c1");
    }
    internal_event_actions { goes_on, (far else near) }
}
"#;

fn begun(hosts: &[&str], text: &str) -> (World, u64) {
    let mut world = World::new(hosts);
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_secs(1));
    (world, call)
}

/// Takes c2 away for so long, where the program of the first leaf dies in the meantime, and brings it back. Returns the
/// number of all beginnings by then.
fn die_while_away(world: &mut World, way: Away, away: Duration) -> usize {
    world.take_away("c2", way);
    world.kill("c2", 0);
    world.run_for(away);
    let before = world.begins.len();
    world.bring_back("c2");
    before
}

fn is_told(world: &World, call: u64, wanted: impl Fn(&Change) -> bool) -> bool {
    let is_it = |answer: &Answer| matches!(answer, Answer::Report(Report::Process { change, .. }) if wanted(change));
    world.answers[&call].iter().any(is_it)
}

/// Its home has gone on without it: the program is not started again, and nothing runs twice.
#[test]
fn what_has_failed_meanwhile_is_not_started_again() {
    for (way, seconds) in WAYS.into_iter().flat_map(|way| [8, 9, 15, 60].map(|seconds| (way, seconds))) {
        let (mut world, call) = begun(&["c1", "c2"], INSTEAD);
        world.take_away("c2", way);
        world.run_for(Duration::from_millis(100));
        world.kill("c2", 0);
        world.run_for(Duration::from_secs(seconds));
        assert_eq!(active(&world, "c1"), [1, 2], "{way:?} for {seconds} s: the other one has taken its place");
        let before = world.begins.len();
        world.bring_back("c2");
        world.run_for(Duration::from_secs(20));
        assert_eq!(world.begun_since(before, "c2"), ["main/far"], "{way:?} for {seconds} s: it takes part again, idle");
        assert!(world.begins.last().is_some_and(|(begun, ..)| *begun > world.closed[0].0), "{way:?}: not before");
        assert!(!is_told(&world, call, |change| *change == Change::Resumed));
        assert_eq!(active(&world, "c1"), [1, 2]);
        world.stop("c1");
        world.run_for(Duration::from_secs(20));
        assert_eq!((world.ending(call), &world.alive), (&Ending::Stopped, &BTreeSet::new()));
    }
}

/// Its home has waited: it is asked, and then the program continues at once.
#[test]
fn what_is_still_wanted_is_started_again_at_once() {
    for (way, millis) in [(Away::Killed, 500), (Away::Killed, 4900), (Away::Suspended, 500), (Away::Suspended, 5900)] {
        let (mut world, call) = begun(&["c1", "c2"], INSTEAD);
        let before = die_while_away(&mut world, way, Duration::from_millis(millis));
        world.run_for(Duration::from_millis(30));
        assert_eq!(world.begun_since(before, "c2"), ["main/far", "Long"], "{way:?} for {millis} ms");
        world.run_for(Duration::from_secs(1));
        assert!(is_told(&world, call, |change| *change == Change::Resumed) && active(&world, "c1") == [2]);
    }
}

/// The home itself was killed as well, and has given no host up.
#[test]
fn a_home_that_was_away_as_well_answers_when_it_is_back() {
    for (first, second) in [("c1", "c2"), ("c2", "c1")] {
        let (mut world, call) = begun(&["c1", "c2"], INSTEAD);
        ["c1", "c2"].into_iter().for_each(|host| world.take_away(host, Away::Killed));
        world.kill("c2", 0);
        world.run_for(Duration::from_secs(9));
        let before = world.begins.len();
        world.bring_back(first);
        world.run_for(Duration::from_millis(800));
        assert!(world.begun_since(before, "c2").is_empty(), "{first} is back first");
        world.bring_back(second);
        world.run_for(Duration::from_secs(2));
        assert_eq!(world.begun_since(before, "c2"), ["main/far", "Long"], "{first} is back first");
        assert_eq!(active(&world, "c1"), [2], "{:?}", world.answers[&call]);
    }
}

/// Waiting has a limit: an unreachable home is lost in the end, and the policies decide as at any cut. When it is back,
/// all of that is stopped.
#[test]
fn a_home_that_cannot_be_reached_is_lost_in_the_end() {
    for (policy, goes_on) in [("", false), ("on_link_loss keep; ", true), ("on_link_loss hold; ", true)] {
        for way in WAYS {
            let text = INSTEAD.replace("restart transient; ", &format!("restart transient; {policy}"));
            let (mut world, _) = begun(&["c1", "c2"], &text);
            cut(&mut world, "c2");
            let before = die_while_away(&mut world, way, Duration::from_secs(9));
            world.run_for(Duration::from_secs(3));
            assert!(world.begun_since(before, "c2").is_empty(), "{policy}{way:?}: the home may be back any moment");
            world.run_for(Duration::from_secs(7));
            let expected = if goes_on { &["main/far", "Long"][..] } else { &[] };
            assert_eq!(world.begun_since(before, "c2"), expected, "{policy}{way:?}");
            heal(&mut world, "c2");
            world.run_for(Duration::from_secs(2));
            assert_eq!(active(&world, "c2"), Vec::<u32>::new(), "{policy}{way:?}");
        }
    }
}

/// A home that is there and never answers is not waited for without end.
#[test]
fn a_home_that_does_not_answer_is_waited_for_30_s() {
    let (mut world, _) = begun(&["c1", "c2"], INSTEAD);
    world.take_away("c2", Away::Killed);
    world.kill("c2", 0);
    world.run_for(Duration::from_secs(4));
    let (before, home) = (world.begins.len(), world.agents.remove("c1").expect("it is there"));
    world.bring_back("c2");
    for (seconds, begun) in [(29, &[][..]), (2, &["main/far", "Long"])] {
        world.run_for(Duration::from_secs(seconds));
        assert_eq!(world.begun_since(before, "c2"), begun);
    }
    world.agents.insert("c1".to_owned(), home);
}

/// A group on the host that was away decides nothing alone, neither for its own host nor for another.
#[test]
fn a_group_goes_no_step_further_before_its_home_has_answered() {
    let text = r#"
process Pair(there, other) {
    host { there }
    instantiated_processes { first instof Long(there); next instof Sensor(other); }
    internal_event_actions { first else next }
}
process main() {
    host { "c1" }
    instantiated_processes { pair instof Pair("c2", "OTHER"); near instof Sensor("c1"); }
    internal_event_actions { pair else near }
}
"#;
    for (way, other) in WAYS.into_iter().flat_map(|way| ["c2", "c3"].map(|other| (way, other))) {
        for (seconds, expected) in [(9, &[][..]), (4, &["Sensor"])] {
            let (mut world, _) = begun(&["c1", "c2", "c3"], &text.replace("OTHER", other));
            let before = die_while_away(&mut world, way, Duration::from_secs(seconds));
            world.run_for(Duration::from_millis(300));
            assert_eq!(world.begun_since(before, other), expected, "{way:?} for {seconds} s, next on {other}");
        }
    }
}

/// The system of a suspended node still takes messages. An order to begin that has waited there counts only if its home
/// still means it; an order to end is carried out.
#[test]
fn an_order_that_has_waited_in_the_system_is_not_carried_out_too_late() {
    let text = r#"
process main() {
    host { "c1" }
    instantiated_processes { far instof Step("c2"); near instof Sensor("c1"); }
    internal_event_actions { (wait(1500 ms) ; far) else near }
}
"#;
    for (seconds, begins) in [(9, false), (4, true)] {
        let (mut world, call) = begun(&["c1", "c2"], text);
        world.take_away("c2", Away::Suspended);
        let before = world.begins.len();
        world.run_for(Duration::from_secs(seconds));
        assert!(world.down["c2"].iter().any(|coming| matches!(coming, Coming::Input(_))), "the order waits");
        world.bring_back("c2");
        world.run_for(Duration::from_secs(1));
        assert_eq!(world.begun_since(before, "c2").contains(&"Step"), begins, "suspended for {seconds} s");
        assert_eq!(matches!(world.answers[&call].last(), Some(Answer::Report(Report::Finished { .. }))), begins);
    }
}

/// Orders that the home gives after its answer are carried out, and so is a stop before it.
#[test]
fn orders_of_the_home_are_carried_out_as_ever() {
    for way in WAYS {
        let (mut world, call) = begun(&["c1", "c2"], &INSTEAD.replace("far else near", "retry(9, pause 1 s) far"));
        die_while_away(&mut world, way, Duration::from_secs(9));
        world.run_for(Duration::from_secs(4));
        assert_eq!(active(&world, "c2"), [0], "{way:?}: the next try finds its program");
        world.take_away("c2", way);
        world.kill("c2", 0);
        world.run_for(Duration::from_secs(4));
        world.stop("c1");
        world.run_for(Duration::from_millis(10));
        let before = world.begins.len();
        world.bring_back("c2");
        world.run_for(Duration::from_secs(5));
        assert_eq!(world.ending(call), &Ending::Stopped, "{way:?}");
        assert!(!world.begun_since(before, "c2").contains(&"Long"), "{way:?}");
        assert_eq!(world.alive, BTreeSet::new());
    }
}

/// Each home is asked for its own deployments, and this host needs no answer for those that have their home here.
#[test]
fn each_home_answers_for_its_own() {
    let spec = |home: &str, others: &str| {
        format!(
            "process main() {{ host {{ \"{home}\" }} instantiated_processes {{ {others} far instof Sensor(\"c2\") {{ restart transient; on_link_loss keep; }} }}
             internal_event_actions {{ {}far }} }}",
            others.split_whitespace().filter(|word| word.starts_with("idle")).map(|name| format!("{name}, ")).collect::<String>(),
        )
    };
    let idle = |names: &[&str]| names.iter().map(|name| format!("{name} instof Sensor(\"c2\"); ")).collect::<String>();
    let mut world = World::new(&["c1", "c2", "c3"]);
    world.deploy_as("one", "c1", &spec("c1", ""));
    world.deploy_as("two", "c3", &spec("c3", &idle(&["idle1"])));
    world.deploy_as("own", "c2", &spec("c2", &idle(&["idle1", "idle2"])));
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c3");
    world.take_away("c2", Away::Killed);
    for (leaf, name) in [(0, "one"), (1, "two"), (2, "own")] {
        let is_it = |(_, process): &&(String, ProcessId)| process.leaf == leaf && process.deployment.name == name;
        let (_, process) = world.alive.iter().find(is_it).expect("it is there").clone();
        world.die("c2", &process, ShimReport::Signalled { signal: 9 });
    }
    world.run_for(Duration::from_secs(4));
    world.bring_back("c2");
    let runs = |world: &World, name: &str, leaf: u32| {
        world.running.keys().any(|(_, process)| process.deployment.name == name && process.leaf == leaf)
    };
    world.run_for(Duration::from_millis(300));
    assert_eq!([("one", 0), ("two", 1), ("own", 2)].map(|(name, leaf)| runs(&world, name, leaf)), [true, false, true]);
    world.run_for(Duration::from_secs(12));
    assert!(runs(&world, "two", 1), "its home is lost, and it says `keep`");
    heal(&mut world, "c3");
    world.run_for(Duration::from_secs(5));
    assert!(!runs(&world, "two", 1) && runs(&world, "one", 0) && runs(&world, "own", 2));
}

/// A node that is killed again while it waits for its home still waits when it is made again.
#[test]
fn who_is_killed_again_meanwhile_still_waits() {
    let (mut world, _) = begun(&["c1", "c2"], INSTEAD);
    world.take_away("c2", Away::Killed);
    world.kill("c2", 0);
    world.run_for(Duration::from_secs(4));
    let before = world.begins.len();
    world.one_way.insert(("c1".into(), "c2".into()));
    for _ in 0..3 {
        world.bring_back("c2");
        world.run_for(Duration::from_millis(100));
        world.take_away("c2", Away::Killed);
        world.run_for(Duration::from_millis(100));
    }
    world.bring_back("c2");
    world.run_for(Duration::from_millis(20));
    assert!(world.begun_since(before, "c2").is_empty());
    world.one_way.clear();
    world.run_for(Duration::from_millis(500));
    assert_eq!(world.begun_since(before, "c2"), ["main/far", "Long"]);
}

/// Nodes are killed and suspended at any time and for any time, programs die, frames are lost: on a host that a home has given up, and
/// reaches again, nothing begins before its part there is over.
#[test]
fn nothing_begins_on_a_host_that_was_given_up() {
    let text = r#"
process Far(there, other) {
    host { there }
    instantiated_processes {
        a instof Sensor(there) { restart transient; }
        b instof Long(other) { restart transient; on_link_loss keep; }
        c instof Step(there);
    }
    internal_event_actions { a, ((b ; c) ;; skip) }
}
process main() {
    host { "c1" }
    instantiated_processes {
        sensor instof Sensor("c1");
        far instof Far("c2", "c3");
        solo instof Sensor("c3") { restart transient; }
    }
    internal_event_actions { sensor, ((far else skip) ;; wait(1 s)), ((solo else skip) ;; wait(1 s)) }
}
"#;
    let (mut given_up, mut begins) = (0, 0);
    for seed in 0..100 {
        let mut draw = Draw::new(seed);
        let (mut world, call) = begun(&["c1", "c2", "c3"], text);
        world.loses_by_chance = (seed % 3 > 0).then(|| (Draw::new(seed), 4));
        let (mut away, mut watched) = (BTreeSet::new(), Watched::default());
        for _ in 0..12 {
            let host = ["c2", "c3"][draw.index(2)];
            match draw.below(3) {
                0 if world.alive.iter().any(|(on, _)| on == host) => {
                    let theirs = world.alive.iter().filter(|(on, _)| on == host).map(|(_, one)| one.leaf);
                    let leaves: Vec<u32> = theirs.collect();
                    world.kill(host, leaves[draw.index(leaves.len() as u64)]);
                }
                1 | 2 if away.remove(host) => world.bring_back(host),
                _ if away.insert(host) => world.take_away(host, WAYS[draw.index(2)]),
                _ => {}
            }
            watched.run_for(&mut world, draw.below(9000));
        }
        away.into_iter().for_each(|host| world.bring_back(host));
        watched.run_for(&mut world, 5000);
        assert_eq!(watched.wrong, Vec::<String>::new(), "seed {seed}");
        (given_up, begins) = (given_up + watched.given_up, begins + world.begins.len());
        world.run_for(Duration::from_secs(60));
        let has_ended = matches!(world.answers[&call].last(), Some(Answer::Report(Report::Finished { .. })));
        assert!(
            has_ended || (0..60).any(|_| all_run(&mut world)),
            "seed {seed}: {:#?}",
            world.answers[&call].iter().rev().take(12).collect::<Vec<_>>()
        );
    }
    println!("{given_up} given up, {begins} begun");
    assert!(given_up > 100 && begins > 1000, "{given_up} {begins}");
}

/// The known state of the parts on c2 and c3.
#[derive(Debug, Default)]
struct Watched {
    /// How many of the changes were looked at.
    changes: usize,
    begins: usize,
    closed: usize,
    /// Hosts that c1 has lost and not reached again.
    lost: BTreeSet<String>,
    /// Hosts where nothing of the deployment is.
    empty: BTreeSet<String>,
    /// Hosts that c1 has reached again, and informed that it has given them up.
    told: BTreeSet<String>,
    given_up: usize,
    wrong: Vec<String>,
}

impl Watched {
    fn run_for(&mut self, world: &mut World, millis: u64) {
        for _ in 0..millis {
            world.run_for(Duration::from_millis(1));
            for (at, host, what) in &world.begins[self.begins..] {
                self.empty.remove(host);
                if self.told.contains(host) && !world.closed[self.closed..].iter().any(|(_, on)| on == host) {
                    self.wrong.push(format!("{what} on {host} at {at:?}"));
                }
            }
            for (_, host) in &world.closed[self.closed..] {
                self.told.remove(host);
                self.empty.insert(host.clone());
            }
            for (_, change) in world.changes[self.changes..].iter().filter(|(on, _)| on == "c1") {
                match change {
                    Peer::Lost { host } => drop(self.lost.insert(host.clone())),
                    Peer::Appeared { host, .. } if self.lost.remove(host) && !self.empty.contains(host) => {
                        self.given_up += 1;
                        self.told.insert(host.clone());
                    }
                    _ => {}
                }
            }
            (self.changes, self.begins, self.closed) = (world.changes.len(), world.begins.len(), world.closed.len());
        }
    }
}

fn all_run(world: &mut World) -> bool {
    world.run_for(Duration::from_millis(100));
    !active(world, "c2").is_empty() && active(world, "c3").len() == 2
}
