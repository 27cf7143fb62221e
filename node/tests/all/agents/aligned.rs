//! A start at one moment on several hosts whose clocks differ, on virtual time.

use super::TWO_HOSTS;
use super::world::{Draw, World};
use comms::logic::time::Time;
use node::logic::agent::Input;
use node::logic::protocol::{Answer, Ending, Report, StartMode};
use std::collections::BTreeSet;
use std::time::Duration;

/// A group on each host with programs on others; then one more.
const THREE: &str = r#"
process Pair(own, other) {
    host { own }
    instantiated_processes { source instof Sensor(other); sink instof Step(own); }
    internal_connections(source, feed) { source, Out -> sink, In; }
    internal_event_actions { source[feed] , sink }
}
process main() {
    host { "c1" }
    instantiated_processes {
        one instof Pair("c1", "c2"); two instof Pair("c2", "c3"); three instof Pair("c3", "c1"); last instof Step("c2");
    }
    internal_event_actions { (one , two , three) ; last }
}
"#;

/// The hosts of the programs of its first step, by their numbers.
const HOSTS: [&str; 6] = ["c2", "c1", "c3", "c2", "c1", "c3"];

impl World {
    /// Returns the boot clock of a host.
    pub(super) fn there(&self, host: &str) -> Time {
        self.now + self.ahead.get(host).copied().unwrap_or_default()
    }

    /// Returns a moment of a host on the clock of the world.
    pub(super) fn here(&self, host: &str, there: Time) -> Option<Time> {
        let ahead = self.ahead.get(host).copied().unwrap_or_default();
        Some(Time::ZERO + there.since(Time::ZERO).saturating_sub(ahead))
    }

    /// Three hosts whose machines have booted at different times, and whose calendars differ.
    fn of_three() -> Self {
        let mut world = Self::new(&["c1", "c2", "c3"]);
        for (host, ahead) in [("c1", 500), ("c2", 100_000), ("c3", 7)] {
            world.ahead.insert(host.to_owned(), Duration::from_secs(ahead) + Duration::from_micros(333 * ahead));
            world.give(host, Input::Calendar { origin: Duration::from_secs(1_795_000_000 - 3000 * ahead) });
        }
        world
    }

    /// Runs until GO. Returns the reported alignment: the delay after GO, and its accuracy.
    fn until_go(&mut self, call: u64) -> Option<(Duration, Duration)> {
        let mut aligned = None;
        for _ in 0..5000 {
            self.run_for(Duration::from_millis(1));
            for answer in self.answers.get(&call).into_iter().flatten() {
                match answer {
                    Answer::Report(Report::Aligned { lead, within }) => aligned = Some((*lead, *within)),
                    Answer::Report(Report::Go { .. }) => return aligned,
                    _ => {}
                }
            }
        }
        panic!("no GO: {:?}", self.answers);
    }

    /// Returns when the programs of the first step have begun, which are the first six of [`THREE`].
    fn begun_first(&self) -> Vec<Time> {
        self.begun.iter().filter(|(process, _)| process.leaf < 6).map(|(_, at)| *at).collect()
    }
}

#[test]
fn programs_of_the_first_step_begin_at_one_moment() {
    for start in [StartMode::AtOnce, StartMode::Aligned] {
        let mut world = World::of_three();
        world.start = start;
        let call = world.deploy("c1", THREE);
        let told = world.until_go(call);
        let go = world.now;
        world.run_for(Duration::from_secs(5));
        assert_eq!(world.ending(call), &Ending::Done(vec![]));
        let begun = world.begun_first();
        let moments: BTreeSet<Time> = begun.iter().copied().collect();
        assert_eq!(begun.len(), 6);
        if start == StartMode::AtOnce {
            assert!(told.is_none() && moments.len() > 1, "orders take their time: {moments:?}");
            continue;
        }
        // A round trip is 2 ms here, and both ways take the same.
        assert_eq!(told, Some((Duration::from_millis(108), Duration::from_millis(2))));
        assert_eq!(moments, BTreeSet::from([go + Duration::from_millis(108)]));
        // Later members begin when they can: the step lasts 50 ms.
        let last = world.begun.iter().find(|(process, _)| process.leaf == 6).map(|(_, at)| *at - go);
        assert!(
            last.is_some_and(|last| last > Duration::from_millis(158) && last < Duration::from_millis(180)),
            "{last:?}"
        );
    }
}

/// On one host, and without the option, nothing is different.
#[test]
fn on_one_host_nothing_waits() {
    let mut world = World::new(&["c1"]);
    world.start = StartMode::Aligned;
    let call = world.deploy("c1", &TWO_HOSTS.replace("\"c2\"", "\"c1\""));
    assert_eq!(world.until_go(call), None);
    let go = world.now;
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    assert!(world.begun.values().any(|at| *at - go < Duration::from_millis(10)), "{:?}", world.begun);
}

/// A stop waits for nothing: a program that has not begun never begins.
#[test]
fn a_stop_before_the_moment_is_no_later_for_it() {
    let mut world = World::of_three();
    world.start = StartMode::Aligned;
    let call = world.deploy("c1", THREE);
    world.until_go(call);
    world.run_for(Duration::from_millis(30));
    let asked = world.now;
    world.stop("c1");
    let is_over = |world: &World| matches!(world.last_report(call), Report::Finished { .. });
    while !is_over(&world) && world.now - asked < Duration::from_secs(2) {
        world.run_for(Duration::from_millis(1));
    }
    assert_eq!(world.ending(call), &Ending::Stopped);
    assert!(world.now - asked < Duration::from_millis(60), "{:?}", world.now - asked);
    world.run_for(Duration::from_secs(2));
    assert_eq!((world.begun.len(), &world.alive), (0, &BTreeSet::new()));
}

/// A step that is to end within 70 ms and takes 50 has not less time for having waited, and a pause keeps its length.
#[test]
fn times_of_the_first_step_count_from_the_moment() {
    let text = THREE.replace("source[feed] , sink }", "source[feed] , (sink within 70 ms) , wait(300 ms) }");
    let mut world = World::of_three();
    world.start = StartMode::Aligned;
    let call = world.deploy("c1", &text);
    world.until_go(call);
    let go = world.now;
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    let last = world.begun.iter().find(|(process, _)| process.leaf == 6).map(|(_, at)| *at - go);
    assert!(
        last.is_some_and(|last| last > Duration::from_millis(408) && last < Duration::from_millis(430)),
        "{last:?}"
    );
}

/// Lost messages are repeated. A host that hears of the moment too late begins at once; no program begins early, and
/// nothing is left out or done twice.
#[test]
fn lost_words_do_not_keep_anything_from_beginning() {
    let (mut aligned, mut late) = (0, 0);
    for seed in 0..300 {
        let mut world = World::of_three();
        world.start = StartMode::Aligned;
        world.loses_by_chance = Some((Draw::new(seed), 20));
        let call = world.deploy("c1", THREE);
        let (lead, _) = world.until_go(call).expect("it is aligned");
        let moment = world.now + lead;
        world.run_for(Duration::from_secs(20));
        assert_eq!(world.ending(call), &Ending::Done(vec![]), "seed {seed}");
        assert!(world.lives.values().all(|lives| *lives == 1), "seed {seed}");
        let begun = world.begun_first();
        // A service whose message is late may be stopped before it has begun. A task has to begin.
        let tasks = world.begun.keys().filter(|process| process.leaf < 6 && process.leaf % 2 == 1).count();
        assert_eq!(tasks, 3, "seed {seed}");
        // Until GO arrives here a millisecond may pass, and an asymmetric round trip may add another.
        let early = begun.iter().filter(|at| **at + Duration::from_millis(2) < moment).count();
        assert_eq!(early, 0, "seed {seed}: {begun:?}, {moment:?}");
        for report in world.answers.get(&call).into_iter().flatten() {
            let Answer::Report(Report::BeganLate { host, by }) = report else { continue };
            late += 1;
            let there =
                world.begun.iter().filter(|(process, _)| HOSTS.get(process.leaf as usize) == Some(&host.as_str()));
            let is_late = |at: Time| at + Duration::from_millis(3) >= moment + *by;
            assert!(there.clone().all(|(_, at)| is_late(*at)), "seed {seed}: {host} was late by {by:?}");
        }
        let (first, last) = (begun.iter().min().copied(), begun.iter().max().copied());
        aligned += u32::from(last.zip(first).is_some_and(|(last, first)| last - first <= Duration::from_millis(1)));
    }
    assert!(aligned > 90, "{aligned} of 300 have begun at one moment although words were lost");
    assert!(late > 10, "{late} hosts have said that they heard of the moment too late");
}

/// A node that is killed between the word and the moment, and started again after it.
#[test]
fn a_node_that_sleeps_over_the_moment_says_so() {
    let mut world = World::of_three();
    world.start = StartMode::Aligned;
    let call = world.deploy("c1", THREE);
    let (lead, _) = world.until_go(call).expect("it is aligned");
    let moment = world.now + lead;
    world.run_for(lead / 2);
    world.crash("c2");
    world.run_for(Duration::from_millis(600));
    world.adopt("c2");
    let back = world.now;
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    let late = world.answers[&call].iter().filter_map(|answer| match answer {
        Answer::Report(Report::BeganLate { host, by }) => Some((host.as_str(), *by)),
        _ => None,
    });
    let late: Vec<(&str, Duration)> = late.collect();
    assert!(matches!(late[..], [("c2", by)] if by + Duration::from_millis(3) >= back - moment), "{late:?}");
}
