//! Listeners to everything, and the names that a host has given out, on virtual time.

use super::TWO_HOSTS;
use super::losses::{cut, heal};
use super::world::{Coming, Draw, World};
use node::logic::agent::Input;
use node::logic::protocol::{Answer, Change, Event, Names, Report, Request};
use std::collections::BTreeMap;
use std::time::Duration;

impl World {
    /// Returns the events of a call, and how many of them came before the mark for "all up to now".
    fn events(&self, call: u64) -> (Vec<Event>, usize) {
        let (mut events, mut known) = (Vec::new(), None);
        for answer in &self.answers[&call] {
            let Answer::Events(some) = answer else { panic!("{answer:?}") };
            if some.is_empty() {
                assert_eq!(known.replace(events.len()), None, "the mark comes once");
            }
            events.extend(some.iter().cloned());
        }
        (events, known.expect("the mark comes"))
    }
}

#[test]
fn a_listener_hears_of_every_deployment_with_host_and_time_and_a_later_one_of_the_same() {
    let mut world = World::new(&["c1", "c2"]);
    let first = world.ask("c1", Request::Events { follow: true });
    let gone = world.ask("c1", Request::Events { follow: true });
    for name in ["one", "two"] {
        world.deploy_as(name, "c1", TWO_HOSTS);
        world.run_for(Duration::from_secs(5));
        // The second is over for it.
        world.give("c1", Input::CallGone { call: gone });
    }
    let late = world.ask("c1", Request::Events { follow: false });
    world.run_for(Duration::from_secs(1));
    let ((first, none), (late, all)) = (world.events(first), world.events(late));
    assert_eq!((none, all), (0, late.len()));
    let what = |events: &[Event]| {
        events.iter().map(|event| (event.deployment.clone(), event.number, event.report.clone())).collect::<Vec<_>>()
    };
    assert_eq!(what(&first), what(&late));
    assert!(world.events(gone).0.iter().all(|event| event.deployment.name == "one"));
    for name in ["one", "two"] {
        let of_one: Vec<&Event> = first.iter().filter(|event| event.deployment.name == name).collect();
        assert!(of_one.is_sorted_by(|a, b| a.number < b.number));
        assert!(matches!(of_one[0].report, Report::Accepted { .. }));
        assert!(of_one.last().is_some_and(|last| matches!(last.report, Report::Finished { .. })));
        let host = |path: &str| {
            let is_it = |event: &&&Event| matches!(&event.report, Report::Process { path: of, change: Change::Activated, .. } if of == path);
            of_one.iter().find(is_it).map(|event| event.host.as_str())
        };
        assert_eq!((host("main/pair/sensor"), host("main/last")), (Some("c1"), Some("c2")));
    }
    // A live event is new, and a later listener is told its age.
    assert!(first.iter().all(|event| event.ago == Duration::ZERO));
    let oldest = late[0].ago;
    assert!(oldest > Duration::from_secs(5) && late.iter().all(|event| event.ago <= oldest), "{oldest:?}");
}

/// The time of an event is noted once: it is the same whenever it is asked for, after the calendar clock was set, and from a node
/// that was killed and has taken over.
#[test]
fn the_time_of_an_event_is_one_time() {
    let mut world = World::new(&["c1", "c2"]);
    let calendar = |world: &mut World, seconds| {
        world.give("c1", Input::Calendar { origin: Duration::from_secs(seconds) });
    };
    calendar(&mut world, 1_795_000_000);
    world.deploy_as("one", "c1", TWO_HOSTS);
    world.run_for(Duration::from_millis(700));
    let mut heard = Vec::new();
    let mut ask = |world: &mut World| {
        let call = world.ask("c1", Request::Events { follow: false });
        world.run_for(Duration::from_millis(300));
        let events = world.events(call).0;
        heard.push(events.iter().map(|event| (event.number, event.time)).collect::<Vec<_>>());
        events
    };
    let first = ask(&mut world);
    let time = |ago: Duration| Duration::from_secs(1_795_000_000) + Duration::from_millis(700) - ago;
    assert!(first.iter().all(|event| event.time == time(event.ago)), "{first:?}");
    assert!(first.first().is_some_and(|event| event.time < first[first.len() - 1].time), "{first:?}");
    ask(&mut world);
    calendar(&mut world, 5);
    ask(&mut world);
    world.crash("c1");
    world.run_for(Duration::from_millis(500));
    world.adopt("c1");
    world.run_for(Duration::from_millis(100));
    ask(&mut world);
    calendar(&mut world, 1_795_000_000);
    world.run_for(Duration::from_secs(5));
    let last = ask(&mut world);
    for (earlier, later) in heard.iter().zip(&heard[1..]) {
        assert_eq!(earlier[..], later[..earlier.len()], "{heard:?}");
    }
    // Events during a wrong calendar time show that time, and are still in their place.
    assert!(last.is_sorted_by(|a, b| a.number < b.number && a.ago >= b.ago), "{last:?}");
}

/// Four programs on two hosts that are started again.
const FOUR: &str = r#"
process main() {
    host { "c1" }
    instantiated_processes {
        a instof Sensor("c1") { restart transient; }
        b instof Sensor("c1") { restart transient; }
        c instof Sensor("c2") { restart transient; on_link_loss keep; }
        d instof Sensor("c2") { restart transient; on_link_loss keep; }
        long instof Long("c1");
    }
    internal_event_actions { a, b, c, d, long }
}
"#;

/// Returns how often each program was restarted, from these events.
fn restarts(events: &[Event]) -> BTreeMap<String, usize> {
    let mut restarts = BTreeMap::new();
    for event in events {
        if let Report::Process { path, change: Change::Restarting { .. }, .. } = &event.report {
            *restarts.entry(path.clone()).or_default() += 1;
        }
    }
    restarts
}

/// Programs die, frames get lost, nodes are killed and come back: what counts as everything has all that had happened anywhere when it was
/// asked for, though a home does not know it at that moment.
#[test]
fn everything_is_what_had_happened_on_any_host() {
    let paths = ["main/a", "main/b", "main/c", "main/d"];
    let (mut complete, mut were_early) = (0, 0);
    for seed in 0..400 {
        let (mut draw, mut world) = (Draw::new(seed), World::new(&["c1", "c2"]));
        world.deploy("c1", FOUR);
        world.run_for(Duration::from_secs(1));
        world.loses_one_in = (draw.below(2) == 0).then_some(5);
        let mut died = BTreeMap::<&str, usize>::new();
        for _ in 0..8 {
            let host = ["c1", "c2"][draw.index(2)];
            let leaf = draw.below(4);
            let (path, on) = (paths[usize::try_from(leaf).unwrap()], if leaf < 2 { "c1" } else { "c2" });
            let leaf = u32::try_from(leaf).unwrap();
            match draw.below(5) {
                0 if !world.down.contains_key(host) => world.crash(host),
                1 if world.down.contains_key(host) => world.adopt(host),
                _ if world.alive.iter().any(|(there, process)| there == on && process.leaf == leaf) => {
                    world.kill(on, leaf);
                    *died.entry(path).or_default() += 1;
                }
                _ => {}
            }
            world.run_for(Duration::from_millis(draw.below(200)));
        }
        for host in world.down.keys().cloned().collect::<Vec<_>>() {
            world.adopt(&host);
        }
        world.run_for(Duration::from_millis(draw.below(5)));
        let [now, all] = [true, false].map(|follow| world.ask("c1", Request::Events { follow }));
        world.run_for(Duration::from_secs(5));
        let (early, known) = world.events(now);
        let is_whole = |events: &[Event]| {
            let restarts = restarts(events);
            died.iter().all(|(path, count)| restarts.get(*path).is_some_and(|known| known >= count))
        };
        were_early += usize::from(!is_whole(&early[..known]));
        if matches!(world.answers[&all].last(), Some(Answer::Behind(_))) {
            continue;
        }
        complete += 1;
        let events = world.events(all).0;
        assert!(is_whole(&events), "seed {seed}: {died:?}, told {:?}", restarts(&events));
    }
    assert!(complete >= 300 && were_early >= 100, "{complete} complete, {were_early} would not have been at once");
}

/// A host that is cut off may have seen something; a caller is told so after 3 s at most.
#[test]
fn a_home_names_whom_it_has_not_heard() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", FOUR);
    world.run_for(Duration::from_secs(1));
    let ask = |world: &mut World, millis| {
        let call = world.ask("c1", Request::Events { follow: false });
        world.run_for(Duration::from_millis(millis));
        world.answers.get(&call).and_then(|answers| answers.last().cloned())
    };
    assert_eq!(ask(&mut world, 5), Some(Answer::Events(Vec::new())));
    let behind = Some(Answer::Behind(vec!["c2".into()]));
    cut(&mut world, "c2");
    assert_eq!(ask(&mut world, 100), None, "it may answer yet");
    assert_eq!(ask(&mut world, 3000), behind);
    assert_eq!(ask(&mut world, 5), behind, "it is missing");
    heal(&mut world, "c2");
    world.run_for(Duration::from_secs(1));
    assert_eq!(ask(&mut world, 1000), Some(Answer::Events(Vec::new())));
}

#[test]
fn a_listener_does_not_keep_a_node_from_leaving() {
    let mut world = World::new(&["c1", "c2"]);
    world.ask("c1", Request::Events { follow: true });
    world.run_for(Duration::from_secs(1));
    world.at(0, "c1", Coming::Input(Input::Leave));
    world.run_for(Duration::from_secs(3));
    assert!(!world.agents.contains_key("c1"));
}

#[test]
fn a_host_names_its_ports_and_its_devices() {
    let text = r#"
process main() {
    host { "c1" }
    instantiated_processes { cam instof Sensor("c1"); viewer instof Long("c2"); arm instof Arm("c2"); }
    internal_connections(viewer, view) { cam, Out -> viewer, In; }
    internal_event_actions { cam[view] , viewer , arm }
}
"#;
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", text);
    world.run_for(Duration::from_millis(50));
    let asked = ["c1", "c2"].map(|host| world.ask(host, Request::Names));
    world.run_for(Duration::from_millis(1));
    let [here, there] = asked.map(|call| {
        let [Answer::Names(names)] = &world.answers[&call][..] else { panic!("{:?}", world.answers[&call]) };
        names.clone()
    });
    let ports = |names: &Names| {
        names.ports.iter().map(|port| (port.path.clone(), port.port.clone(), port.is_output)).collect::<Vec<_>>()
    };
    assert_eq!(ports(&here), [("main/cam".to_owned(), "Out".to_owned(), true)]);
    assert_eq!(ports(&there), [("main/viewer".to_owned(), "In".to_owned(), false)]);
    assert_eq!(here.devices, []);
    let [device] = &there.devices[..] else { panic!("{there:?}") };
    assert_eq!((device.device.as_str(), device.path.as_str(), device.is_exclusive), ("arm", "main/arm", true));
}
