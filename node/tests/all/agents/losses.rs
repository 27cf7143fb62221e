//! Hosts that cannot be reached, and programs with `on_link_loss` during that time, on virtual time.

use super::world::{Coming, Draw, World};
use node::logic::agent::Input;
use node::logic::protocol::{Answer, Change, Ending, FailureCause, Report};
use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Duration;

/// Takes `host` off the network, which everybody notices at once.
pub(super) fn cut(world: &mut World, host: &str) {
    cut_seen(world, host, || 0);
}

/// Takes `host` off the network, which each other host notices after `late` milliseconds.
fn cut_seen(world: &mut World, host: &str, late: impl FnMut() -> u64) {
    world.cut.insert(host.to_owned());
    tell(world, host, |host, boot| Input::Vanished { host, boot }, late);
}

pub(super) fn heal(world: &mut World, host: &str) {
    world.cut.remove(host);
    tell(world, host, |host, boot| Input::Appeared { host, boot }, || 0);
}

/// Tells `host` something of every other host, and those the same of it. Hosts are booted in the order of their names.
fn tell(world: &mut World, host: &str, what: impl Fn(String, u64) -> Input, mut late: impl FnMut() -> u64) {
    let hosts: Vec<(u64, String)> = (1..).zip(world.agents.keys().cloned()).collect();
    let (boot, _) = hosts.iter().find(|(_, name)| name == host).expect("there is such a host");
    for (other_boot, other) in hosts.iter().filter(|(_, name)| name != host) {
        world.at(late(), other, Coming::Input(what(host.to_owned(), *boot)));
        world.at(late(), host, Coming::Input(what(other.clone(), *other_boot)));
    }
}

/// Returns the leaves that are active on `host`, in the plan's order.
pub(super) fn active(world: &World, host: &str) -> Vec<u32> {
    world.running.keys().filter(|(on, _)| on == host).map(|(_, process)| process.leaf).collect()
}

pub(super) const FOUR: &str = r#"
process main() {
    host { "c1" }
    instantiated_processes {
        stays instof Sensor("c2") { on_link_loss keep; }
        soon instof Sensor("c2") { on_link_loss safe_stop_after 2 s; }
        late instof Sensor("c2") { on_link_loss safe_stop_after 8 s; }
        other instof Sensor("c2");
        long instof Long("c1");
    }
    internal_event_actions { stays, soon, late, other, long }
}
"#;

#[test]
fn each_program_does_as_its_policy_says() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", FOUR);
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c2");
    for (millis, expected) in
        [(1900, &[0, 1, 2, 3][..]), (200, &[0, 2, 3]), (2800, &[0, 2, 3]), (200, &[0, 2]), (2800, &[0, 2]), (200, &[0])]
    {
        world.run_for(Duration::from_millis(millis));
        assert_eq!(active(&world, "c2"), expected, "{:?}", world.now);
    }
    let Report::Finished { ending: Ending::Aborted(_), unconfirmed, .. } = world.last_report(call) else {
        panic!("{:?}", world.last_report(call))
    };
    assert_eq!(unconfirmed, &["c2"]);
    // The program runs on until it is known whether it is still wanted.
    world.run_for(Duration::from_secs(3600));
    assert_eq!(active(&world, "c2"), [0]);
    heal(&mut world, "c2");
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.alive.len(), 0, "{:?}", world.alive);
}

/// Without a report for each try, a mission that can never go on looks like one that runs.
#[test]
fn every_try_on_a_lost_host_is_told() {
    let text = r#"
process main() {
    host { "c1" }
    instantiated_processes { long instof Long("c2"); sensor instof Sensor("c1"); }
    internal_event_actions { sensor, retry(3, pause 2 s) long }
}
"#;
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(20));
    let told = world.answers[&call].iter().filter_map(|answer| match answer {
        Answer::Report(Report::Process { path, change: Change::Ended(Ending::Aborted(failure)), .. }) => {
            Some((path.as_str(), failure.cause.clone()))
        }
        _ => None,
    });
    let lost = FailureCause::HostLost("c2".into());
    let told: Vec<_> = told.filter(|(path, _)| *path == "main/long").collect();
    assert_eq!(told, vec![("main/long", lost); 4], "the first try and three more");
    let Report::Finished { ending: Ending::Aborted(failure), .. } = world.last_report(call) else {
        panic!("{:?}", world.last_report(call))
    };
    assert_eq!(failure.origin, "main/long");
}

#[test]
fn a_short_cut_is_felt_only_by_who_wants_to() {
    for (millis, stopped) in [(1900, false), (3000, true)] {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", FOUR);
        world.run_for(Duration::from_secs(1));
        cut(&mut world, "c2");
        world.run_for(Duration::from_millis(millis));
        heal(&mut world, "c2");
        world.run_for(Duration::from_millis(1000));
        if !stopped {
            assert_eq!(active(&world, "c2"), [0, 1, 2, 3]);
            continue;
        }
        let Ending::Aborted(failure) = world.ending(call) else { panic!("not aborted") };
        assert_eq!((failure.origin.as_str(), &failure.cause), ("main/soon", &FailureCause::HostLost("c1".into())));
        assert_eq!(world.alive.len(), 0);
    }
}

/// A group whose host lost its home goes on with its expression, if its programs may: with `keep` to its end, with
/// `hold` up to the next new step. Then nothing is left, although the home could not be asked.
#[test]
fn a_group_goes_on_alone() {
    for (policy, steps) in [("keep", 1), ("hold", 0)] {
        let text = r#"
process Pair(there) {
    host { there }
    instantiated_processes {
        long instof Long(there) { on_link_loss POLICY; }
        next instof Step(there) { on_link_loss POLICY; }
    }
    internal_event_actions { long ; next }
}
process main() {
    host { "c1" }
    instantiated_processes { pair instof Pair("c2"); }
    internal_event_actions { pair }
}
"#;
        let mut world = World::new(&["c1", "c2"]);
        world.deploy("c1", &text.replace("POLICY", policy));
        world.run_for(Duration::from_secs(1));
        cut(&mut world, "c2");
        world.run_for(Duration::from_secs(8));
        assert_eq!(active(&world, "c2"), [0], "{policy}");
        world.run_for(Duration::from_secs(3));
        assert_eq!(world.log.iter().filter(|line| line.starts_with("Step")).count(), steps, "{policy}");
        assert_eq!(world.alive.len(), 0, "{policy}: {:?}", world.alive);
    }
}

const ARM: &str = r#"
process main() {
    host { "c1" }
    resource arm;
    instantiated_processes {
        far instof Long("c2") { on_link_loss keep; }
        near instof Step("c1");
        other instof Step("c3");
    }
    internal_event_actions { (using(arm) far)? , (wait(1 s) ; using(arm) near) , other }
}
"#;

/// Returns how often the program of a module was activated.
fn runs(world: &World, module: &str) -> usize {
    world.log.iter().filter(|line| line.starts_with(module)).count()
}

/// A lost host may go on with its orders. Its resources are free when it has reported its end.
#[test]
fn what_a_lost_host_may_still_use_is_given_to_nobody() {
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", ARM);
    world.run_for(Duration::from_millis(500));
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(3600));
    assert_eq!((active(&world, "c2"), runs(&world, "Step")), (vec![], 1), "it has ended, and nobody knows");
    let held = Change::Held { resource: "arm".into(), host: "c2".into() };
    let told = world.answers[&call].iter().filter(
        |answer| matches!(answer, Answer::Report(Report::Process { path, change, .. }) if path == "main/near" && *change == held),
    );
    assert_eq!(told.count(), 1, "people are told once");
    heal(&mut world, "c2");
    world.run_for(Duration::from_secs(5));
    assert_eq!(runs(&world, "Step"), 2);
    assert!(matches!(world.ending(call), Ending::Done(_)), "{:?}", world.last_report(call));
    assert_eq!(world.alive, BTreeSet::new());
}

/// A member that waits for a lost host can still be stopped. A host that was lost before anything began there is not
/// waited for.
#[test]
fn only_what_has_begun_on_a_lost_host_is_waited_for() {
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", ARM);
    world.run_for(Duration::from_millis(500));
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(10));
    world.stop("c1");
    world.run_for(Duration::from_secs(30));
    let Report::Finished { ending, unconfirmed, .. } = world.last_report(call) else { panic!("it has not ended") };
    assert_eq!((ending, &unconfirmed[..]), (&Ending::Stopped, &["c2".to_owned()][..]));

    let mut world = World::new(&["c1", "c2", "c3"]);
    let late = ARM.replace(
        "(using(arm) far)? , (wait(1 s) ; using(arm) near)",
        "wait(10 s) ; (using(arm) far)? ; using(arm) near",
    );
    let call = world.deploy("c1", &late);
    world.run_for(Duration::from_millis(500));
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(30));
    assert!(
        matches!(world.last_report(call), Report::Finished { ending: Ending::Done(_), .. }),
        "{:?}",
        world.last_report(call)
    );
}

/// Three groups on three hosts share an arm. Hosts are cut off and come back at any time and frames are lost: no two use it
/// at a time, and when all hosts are there again it all comes to an end.
#[test]
fn two_never_use_one_thing_whatever_is_lost() {
    let text = r#"
process Hand(where: Host, there: Host, arm: Resource) {
    host { where }
    instantiated_processes {
        near instof Long(where) { on_link_loss keep; }
        far instof Long(there) { on_link_loss safe_stop_after 7 s; }
    }
    internal_event_actions { using(arm) (near? ; far?) }
}
process main() {
    host { "c1" }
    resource arm;
    instantiated_processes {
        a instof Hand("c2", "c3", arm);
        b instof Hand("c3", "c3", arm);
        c instof Hand("c1", "c2", arm);
    }
    internal_event_actions { ((a? , b? , c?) ;; skip) # (wait(120 s)) }
}
"#;
    for seed in 0..40 {
        let mut draw = Draw::new(seed);
        let mut world = World::new(&["c1", "c2", "c3"]);
        world.loses_one_in = (seed % 3 > 0).then_some(7 + seed);
        let call = world.deploy("c1", text);
        // A host that is lost before all are ready takes the mission back.
        world.run_for(Duration::from_secs(2));
        let mut gone = None;
        for _ in 0..600 {
            world.run_for(Duration::from_millis(100 + draw.below(200)));
            let users: Vec<_> = world.running.keys().collect();
            assert!(users.len() <= 1, "seed {seed} at {:?}: {users:?}", world.now);
            match gone {
                None if draw.below(25) == 0 => {
                    let host = ["c2", "c3"][draw.index(2)];
                    cut_seen(&mut world, host, || draw.below(3000));
                    gone = Some(host);
                }
                Some(host) if draw.below(40) == 0 => {
                    heal(&mut world, host);
                    gone = None;
                }
                None | Some(_) => {}
            }
        }
        if let Some(host) = gone {
            heal(&mut world, host);
        }
        world.run_for(Duration::from_secs(200));
        assert!(
            matches!(world.last_report(call), Report::Finished { .. }),
            "seed {seed}: {:?}",
            world.last_report(call)
        );
        assert_eq!(world.alive, BTreeSet::new(), "seed {seed}");
    }
}

/// The supervisor is lost, but not the home: its work is taken over, and the programs that went on without it end when
/// it is back.
#[test]
fn what_went_on_without_its_supervisor_ends_when_that_is_back() {
    let text = r#"
process Pair(here, there) {
    host { here }
    instantiated_processes { a instof Sensor(there) { on_link_loss keep; } b instof Sensor(there); }
    internal_event_actions { a, b }
}
process main() {
    host { "c1" }
    instantiated_processes { pair instof Pair("c2", "c3"); fallback instof Sensor("c1"); long instof Long("c1"); }
    internal_event_actions { (pair else fallback) # (long ; long ; long) }
}
"#;
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_secs(1));
    assert_eq!(active(&world, "c3"), [0, 1]);
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(6));
    assert_eq!((active(&world, "c3"), active(&world, "c1")), (vec![0], vec![2, 3]));
    heal(&mut world, "c2");
    world.run_for(Duration::from_secs(1));
    assert_eq!((active(&world, "c3"), active(&world, "c1")), (vec![], vec![2, 3]));
    world.run_for(Duration::from_secs(30));
    assert!(matches!(world.last_report(call), Report::Finished { ending: Ending::Done(_), .. }));
    assert_eq!(world.alive.len(), 0);
}

/// Two hosts never agree to the millisecond on a loss. A host that has not lost the other hears of ended members.
#[test]
fn a_loss_that_only_one_side_has_seen_is_told() {
    for (late_on_c1, late_on_c2) in [(0, 200), (200, 0)] {
        let mut world = World::new(&["c1", "c2"]);
        let text = FOUR.replace(" { on_link_loss keep; }", ";").replace(" { on_link_loss safe_stop_after 2 s; }", ";");
        let text = text.replace(" { on_link_loss safe_stop_after 8 s; }", ";");
        let call = world.deploy("c1", &text);
        world.run_for(Duration::from_secs(1));
        let mut late = [late_on_c1, late_on_c2].into_iter();
        cut_seen(&mut world, "c2", || late.next().unwrap());
        world.run_for(Duration::from_millis(5100));
        heal(&mut world, "c2");
        world.run_for(Duration::from_secs(5));
        let Report::Finished { ending: Ending::Aborted(_), .. } = world.last_report(call) else {
            panic!("{late_on_c1} {late_on_c2}: {:?}", world.last_report(call))
        };
        assert_eq!(world.alive.len(), 0);
    }
}

/// Three groups over three hosts, with every policy.
const EVERYWHERE: &str = r#"
process Pair(here, there) {
    host { here }
    instantiated_processes {
        a instof Sensor(there) { on_link_loss keep; restart transient; }
        b instof Long(here) { on_link_loss hold; restart permanent; }
        c instof Step(there) { on_link_loss safe_stop_after 3 s; }
    }
    internal_connections(a, feed) { a, Out -> b, In; }
    internal_connections(b, feed) { b, Out -> c, In; }
    internal_event_actions { a[feed] , ((b[feed] ; c) ;; skip) }
}
process main() {
    host { "c1" }
    instantiated_processes {
        one instof Pair("c2", "c3");
        two instof Pair("c3", "c1");
        last instof Step("c2") { restart transient; }
        plain instof Sensor("c3");
    }
    internal_event_actions { (one else last) & (two else plain) }
}
"#;

/// Every deployment ends, with any cuts and kills: once the network is whole and the mission is stopped, it reports its
/// end, and nothing is left anywhere.
#[test]
fn whatever_is_cut_whenever_nothing_is_left() {
    whatever_is_cut_whenever_nothing_is_left_for(0..100);
}

#[test]
#[ignore = "long: 300 seeds"]
fn whatever_is_cut_whenever_nothing_is_left_for_more_seeds() {
    whatever_is_cut_whenever_nothing_is_left_for(100..400);
}

fn whatever_is_cut_whenever_nothing_is_left_for(seeds: Range<u64>) {
    for seed in seeds {
        let mut draw = Draw::new(seed);
        let mut world = World::new(&["c1", "c2", "c3"]);
        let call = world.deploy("c1", EVERYWHERE);
        world.run_for(Duration::from_millis(50));
        for _ in 0..2 + draw.below(6) {
            let host = ["c1", "c2", "c3"][draw.index(3)];
            if draw.below(3) == 0 {
                let alive: Vec<(String, u32)> = world.alive.iter().map(|(on, one)| (on.clone(), one.leaf)).collect();
                if let Some((on, leaf)) = alive.get(draw.index(8)) {
                    world.kill(on, *leaf);
                }
            } else if world.cut.contains(host) {
                heal(&mut world, host);
            } else if world.cut.is_empty() {
                cut_seen(&mut world, host, || draw.below(500));
                world.run_for(Duration::from_millis(500));
            }
            // Often long enough that only one side has lost the other.
            let millis = if draw.below(2) == 0 { 4500 + draw.below(500) } else { draw.below(8000) };
            world.run_for(Duration::from_millis(millis));
        }
        for host in world.cut.clone() {
            heal(&mut world, &host);
        }
        world.run_for(Duration::from_secs(10));
        let is_over = matches!(world.last_report(call), Report::Finished { .. });
        let stop = (!is_over).then(|| world.stop("c1"));
        world.run_for(Duration::from_secs(60));
        assert!(
            matches!(world.last_report(call), Report::Finished { .. }),
            "seed {seed}: {:?}",
            world.last_report(call)
        );
        assert_eq!(world.alive, BTreeSet::new(), "seed {seed}");
        assert!(stop.is_none_or(|stop| world.answers.contains_key(&stop)), "seed {seed}");
    }
}

/// The grace of a program without its agent is given to its shim, which outlives the agent.
#[test]
fn what_happens_without_an_agent_is_told_beforehand() {
    let text = r#"
process main() {
    host { "c1" }
    instantiated_processes {
        brief instof Sensor("c1") { on_agent_loss stop within 300 ms; }
        other instof Script("c1");
    }
    internal_event_actions { brief # (other ; other) }
}
"#;
    let mut world = World::new(&["c1"]);
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_secs(2));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    let agent_loss = |path| world.spawned[path].iter().map(|policy| policy.agent_loss).collect::<Vec<_>>();
    assert_eq!(agent_loss("main/brief"), [Some(Duration::from_millis(300))]);
    // A plain program is restarted for each activation, and held ready for the next.
    assert_eq!(agent_loss("main/other"), [None; 3]);
}
