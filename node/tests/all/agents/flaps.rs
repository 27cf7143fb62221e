//! A host is lost again, or only missed, while it takes part again: on virtual time.

use super::losses::{active, cut, heal};
use super::world::{Coming, World};
use node::logic::agent::Input;
use node::logic::protocol::{Estop, Report, Request};
use std::collections::BTreeSet;
use std::time::Duration;

/// A group on each of two hosts is restarted whenever it has failed. Both hear a sensor on c1.
const AGAIN: &str = r#"
process Far(there) {
    host { there }
    external_io { In = long, In; }
    instantiated_processes { long instof Tuned(there); step instof Long(there); }
    internal_event_actions { long, step }
}
process main() {
    host { "c1" }
    instantiated_processes { sensor instof Sensor("c1"); far instof Far("c2"); other instof Far("c3"); }
    internal_connections(sensor, lbl1) { sensor, Out -> far, In; sensor, Out -> other, In; }
    internal_event_actions { sensor[lbl1], ((far else skip) ;; wait(1 s)), ((other else skip) ;; wait(1 s)) }
}
"#;

/// A second interruption of the link between c1, the home, and another host.
#[derive(Clone, Copy, Debug)]
enum Flap {
    /// The link is away for this many milliseconds. Each end notices it after so many, if it does before the link stands.
    Link { away: u64, home_sees: u64, host_sees: u64 },
    /// The node of a host is killed and started again after so many milliseconds.
    Node { host: &'static str, away: u64 },
}

const UNSEEN: u64 = u64::MAX;

/// A host is missing after 300 ms and lost 5 s later.
const FLAPS: [Flap; 10] = [
    Flap::Link { away: 700, home_sees: 0, host_sees: 0 },
    Flap::Link { away: 700, home_sees: 0, host_sees: UNSEEN },
    Flap::Link { away: 700, home_sees: UNSEEN, host_sees: 0 },
    Flap::Link { away: 5200, home_sees: 400, host_sees: 0 },
    Flap::Link { away: 5200, home_sees: 0, host_sees: 400 },
    Flap::Link { away: 7000, home_sees: 0, host_sees: 0 },
    Flap::Node { host: "c2", away: 700 },
    Flap::Node { host: "c2", away: 7000 },
    Flap::Node { host: "c1", away: 700 },
    Flap::Node { host: "c1", away: 7000 },
];

/// The moments, in milliseconds after the link stands, at which a second interruption begins. The host is asked after 200 ms, and its
/// programs are linked 20 ms later.
fn moments() -> impl Iterator<Item = u64> {
    [0, 100].into_iter().chain((200..224).step_by(2)).chain([300])
}

/// How long a host has to take part again once the link stands.
const AGAIN_WITHIN: Duration = Duration::from_secs(3);

/// How long a change takes at the most once the link stands, with its probation, and that of the previous plan if it is undone.
const CHANGED_WITHIN: Duration = Duration::from_secs(22);
/// How long a user waits for an answer at the most, once the link stands.
const ANSWERED_WITHIN: Duration = Duration::from_secs(8);

impl Flap {
    /// Whether the node of a host is killed, and with it the answers to its callers.
    fn kills(self, node: &str) -> bool {
        matches!(self, Self::Node { host, .. } if host == node)
    }

    /// Interrupts c2, and runs on until the link stands again.
    fn happen(self, world: &mut World) {
        let millis = Duration::from_millis;
        match self {
            Self::Link { away, home_sees, host_sees } => {
                world.cut.insert("c2".to_owned());
                for (on, of, boot, after) in [("c1", "c2", 2, home_sees), ("c2", "c1", 1, host_sees)] {
                    if after < away {
                        world.at(after, on, Coming::Input(Input::Vanished { host: of.to_owned(), boot }));
                    }
                }
                world.run_for(millis(away));
                heal(world, "c2");
            }
            Self::Node { host, away } => {
                world.crash(host);
                world.run_for(millis(away));
                world.adopt(host);
            }
        }
    }
}

/// Returns a world in which hosts were lost and their links stand again since so many milliseconds.
fn coming_back(hosts: &[&str], millis: u64) -> (World, u64) {
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", AGAIN);
    world.run_for(Duration::from_secs(1));
    hosts.iter().for_each(|host| cut(&mut world, host));
    world.run_for(Duration::from_secs(12));
    hosts.iter().for_each(|host| assert_eq!(active(&world, host), Vec::<u32>::new(), "{host} stops by its own rules"));
    hosts.iter().for_each(|host| heal(&mut world, host));
    world.run_for(Duration::from_millis(millis));
    (world, call)
}

/// Returns after how long all programs of these hosts have run, if they do within a minute.
fn run_after(world: &mut World, hosts: &[&str]) -> Option<Duration> {
    let (since, mut awaited): (_, BTreeSet<&str>) = (world.now, hosts.iter().copied().collect());
    (0..1200).find_map(|_| {
        world.run_for(Duration::from_millis(50));
        awaited.retain(|host| active(world, host).len() < 2);
        awaited.is_empty().then(|| world.now - since)
    })
}

#[track_caller]
fn check_run(world: &mut World, hosts: &[&str], case: &str) {
    let took = run_after(world, hosts);
    assert!(took.is_some_and(|took| took <= AGAIN_WITHIN), "{case}: after {took:?}");
}

/// A host is interrupted on its way back, in each way and at each step. It takes part again soon after its link stands.
#[test]
fn a_host_that_flaps_on_its_way_back_is_asked_again_at_once() {
    for flap in FLAPS {
        for millis in moments() {
            let (mut world, _) = coming_back(&["c2"], millis);
            flap.happen(&mut world);
            check_run(&mut world, &["c2"], &format!("{flap:?} after {millis} ms"));
        }
    }
}

#[test]
fn two_hosts_that_flap_at_once_are_asked_again_at_once() {
    for away in [700, 5200, 7000] {
        for millis in moments() {
            let (mut world, _) = coming_back(&["c2", "c3"], millis);
            cut(&mut world, "c2");
            cut(&mut world, "c3");
            world.run_for(Duration::from_millis(away));
            heal(&mut world, "c2");
            heal(&mut world, "c3");
            check_run(&mut world, &["c2", "c3"], &format!("{away} ms after {millis} ms"));
        }
    }
}

/// A user wants something while a host takes part again and flaps: it is done or refused, and the user hears that soon.
#[test]
fn a_user_is_answered_while_a_host_flaps_on_its_way_back() {
    let changed = AGAIN.replace("wait(1 s)", "wait(900 ms)");
    let again: [&[&str]; 2] = [&[], &["main/far/long"]];
    for flap in FLAPS {
        for millis in moments() {
            let case = format!("{flap:?} after {millis} ms");
            for again in again {
                let text = if again.is_empty() { &changed } else { AGAIN };
                let (mut world, _) = coming_back(&["c2"], millis);
                let call = world.change("c1", text, (1, 0), again);
                world.run_for(Duration::from_millis(1));
                flap.happen(&mut world);
                world.run_for(ANSWERED_WITHIN);
                let is_answered = world.answers.contains_key(&call);
                assert!(is_answered || flap.kills("c1"), "{case}: no answer to a change of {again:?}");
                check_run(&mut world, &["c2", "c3"], &case);
            }
        }
    }
}

#[test]
fn a_mission_ends_while_a_host_flaps_on_its_way_back() {
    for flap in FLAPS {
        for millis in moments() {
            let case = format!("{flap:?} after {millis} ms");
            for is_estop in [false, true] {
                let (mut world, _) = coming_back(&["c2"], millis);
                let estop = || Request::Estop(Estop { by: "ann@c1".into(), reason: "smoke".into() });
                let call = if is_estop { world.ask("c1", estop()) } else { world.stop("c1") };
                world.run_for(Duration::from_millis(1));
                flap.happen(&mut world);
                world.run_for(ANSWERED_WITHIN);
                assert!(world.answers.contains_key(&call) || flap.kills("c1"), "{case}: {is_estop}");
                let left: BTreeSet<_> = world.alive.iter().collect();
                assert!(left.is_empty(), "{case}: {is_estop}: {left:?}");
            }
        }
    }
}

/// A host flaps while a deployment starts: it runs, or is refused with the reason, soon after the link stands.
#[test]
fn a_start_during_which_a_host_flaps_is_soon_decided() {
    for flap in FLAPS.into_iter().filter(|flap| !flap.kills("c1")) {
        for millis in (0..40).step_by(3) {
            let mut world = World::new(&["c1", "c2", "c3"]);
            world.run_for(Duration::from_secs(1));
            let call = world.deploy("c1", AGAIN);
            world.run_for(Duration::from_millis(millis));
            flap.happen(&mut world);
            let took = run_after(&mut world, &["c2", "c3"]);
            let last = world.last_report(call);
            let is_refused = matches!(last, Report::Refused { reasons } if reasons[0].contains("host `c"));
            let is_soon = took.is_some_and(|took| took <= AGAIN_WITHIN) || is_refused && world.alive.is_empty();
            assert!(is_soon, "{flap:?} after {millis} ms: after {took:?}: {last:?}");
        }
    }
}

/// A host takes part again although another one is still lost that it hears, and one that hears it.
#[test]
fn a_host_takes_part_again_while_others_are_lost() {
    let text = r#"
process Far(there) {
    host { there }
    external_io { In = long, In; Out = long, Out; }
    instantiated_processes { long instof Tuned(there); step instof Long(there); }
    internal_event_actions { long, step }
}
process main() {
    host { "c1" }
    instantiated_processes {
        first instof Far("c2");
        second instof Far("c3");
    }
    internal_connections(first, on) { first, Out -> second, In; }
    internal_connections(second, on) { second, Out -> first, In; }
    internal_event_actions { ((first[on] else skip) ;; wait(1 s)), ((second[on] else skip) ;; wait(1 s)) }
}
"#;
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c2");
    cut(&mut world, "c3");
    world.run_for(Duration::from_secs(12));
    for host in ["c2", "c3"] {
        assert_eq!(active(&world, host), Vec::<u32>::new(), "{:?}", world.answers[&call]);
        heal(&mut world, host);
        check_run(&mut world, &[host], host);
    }
}

/// A host flaps during a change. The change is made or undone soon after the link stands, and the host takes part.
#[test]
fn a_change_during_which_a_host_flaps_is_soon_decided() {
    for flap in FLAPS {
        for millis in (0..24).step_by(2).chain([500, 1900]) {
            let case = format!("{flap:?} after {millis} ms");
            let mut world = World::new(&["c1", "c2", "c3"]);
            world.deploy("c1", AGAIN);
            world.run_for(Duration::from_secs(1));
            let call = world.change("c1", AGAIN, (1, 0), &["main/far/long", "main/other/long"]);
            world.run_for(Duration::from_millis(millis));
            flap.happen(&mut world);
            world.run_for(CHANGED_WITHIN);
            assert!(world.answers.contains_key(&call) || flap.kills("c1"), "{case}: no answer");
            check_run(&mut world, &["c2", "c3"], &case);
            let next = world.change("c1", &AGAIN.replace("wait(1 s)", "wait(900 ms)"), (1, 0), &[]);
            world.run_for(CHANGED_WITHIN);
            let told = world.answers.get(&next).and_then(|answers| answers.last());
            let is_busy = format!("{told:?}").contains("is changing");
            assert!(told.is_some() && !is_busy, "{case}: {told:?}");
        }
    }
}
