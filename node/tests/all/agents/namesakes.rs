//! Two nodes of one name that meet after a cut: neither accepts new deployments, and one of each pair of deployments
//! goes on.

use super::TWO_HOSTS;
use super::losses::{FOUR, active, cut, heal};
use super::world::{Draw, World};
use comms::logic::time::Time;
use node::logic::agent::Input;
use node::logic::nameserver::Change;
use node::logic::protocol::{Answer, Ending, FailureCause, Pong, Report, Request};
use std::time::Duration;

const LONG: &str = r#"
process main() {
    host { "c1" }
    instantiated_processes { a instof Sensor("c1"); b instof Long("c1"); }
    internal_event_actions { (a & b) ;; skip }
}
"#;

/// Two networks with a node `c1` each, of which the first was there longer.
struct Two {
    worlds: [World; 2],
    /// Whether the two hear of each other.
    meet: bool,
    /// Whether the first node does not hear the messages of the second.
    is_deaf: bool,
    draw: Option<Draw>,
}

impl Two {
    fn new() -> Self {
        Self { worlds: [World::new(&["c1", "c2"]), World::new(&["c0", "c1"])], meet: false, is_deaf: false, draw: None }
    }

    /// Whether a word from one to the other arrives.
    fn arrives(&mut self) -> bool {
        self.draw.as_mut().is_none_or(|draw| draw.below(3) > 0)
    }

    fn run_for(&mut self, millis: u64) {
        for _ in 0..millis / 50 {
            self.worlds.iter_mut().for_each(|world| world.run_for(Duration::from_millis(50)));
            let said = self.worlds.each_mut().map(|world| std::mem::take(&mut world.greeted));
            if !self.meet {
                continue;
            }
            for (to, said) in [1, 0].into_iter().zip(said) {
                let (boot, now) = ([2, 1][to], self.worlds[to].now.since(Time::ZERO));
                // The first is there for longer, in the eyes of both.
                let up = if boot == 1 { now + Duration::from_secs(100) } else { now / 2 };
                let (to_boot, round) = (self.worlds[to].boots["c1"], self.worlds[to].rounds["c1"]);
                let (from, place, session) = ("c1".to_owned(), format!("boot {boot}"), String::new());
                let pong = Pong { from, boot, to_boot, round, up, place, holder: None, session, origin: 0 };
                if self.arrives() {
                    self.worlds[to].give("c1", Input::Pong(Box::new(pong)));
                }
                let is_deaf = to == 0 && self.is_deaf;
                for namesake in said.into_iter().filter(|_| !is_deaf) {
                    if self.arrives() {
                        self.worlds[to].give("c1", Input::Namesake(Box::new(namesake)));
                    }
                }
            }
        }
    }

    fn deploy(&mut self, on: usize, name: &str) -> u64 {
        self.worlds[on].deploy_as(name, "c1", LONG)
    }

    /// Returns how many programs run on each.
    fn alive(&self) -> [usize; 2] {
        self.worlds.each_ref().map(|world| world.alive.len())
    }

    /// Returns the reports that each got of deployments that run on both.
    fn twice(&self) -> [Vec<String>; 2] {
        self.worlds.each_ref().map(|world| {
            let told = world.changes.iter().filter_map(|(_, change)| match change {
                Change::Twice { .. } => Some(change.to_string()),
                _ => None,
            });
            told.collect()
        })
    }
}

fn refusal(world: &World, call: u64) -> Option<String> {
    match world.answers.get(&call)?.last()? {
        Answer::Report(Report::Refused { reasons }) => Some(reasons.join("; ")),
        _ => None,
    }
}

#[test]
fn the_one_that_goes_on_is_told_however_late_it_hears_the_other() {
    let mut two = Two::new();
    two.deploy(0, "test");
    two.deploy(1, "test");
    two.run_for(2000);
    (two.meet, two.is_deaf) = (true, true);
    two.run_for(5000);
    assert_eq!(two.alive(), [2, 0], "the second has heard the first, and has ended its part");
    assert_eq!(two.twice()[0], Vec::<String>::new());
    two.is_deaf = false;
    two.run_for(3000);
    let told = "`test@1` also runs on another node with the name of this node (boot 2): the deployment is ended there";
    assert_eq!(two.twice()[0], [told]);
    assert_eq!(two.alive(), [2, 0]);
}

#[test]
fn of_one_epoch_the_one_that_was_there_first_goes_on() {
    let mut two = Two::new();
    let calls = [two.deploy(0, "test"), two.deploy(1, "test")];
    two.run_for(2000);
    assert_eq!(two.alive(), [2, 2]);
    two.meet = true;
    two.run_for(2000);
    assert_eq!(two.alive(), [2, 0], "within 2 s");
    let Report::Finished { ending: Ending::Aborted(failure), .. } = two.worlds[1].last_report(calls[1]) else {
        panic!("{:?}", two.worlds[1].last_report(calls[1]))
    };
    assert_eq!((failure.origin.as_str(), &failure.cause), ("main", &FailureCause::Preempted("boot 1".into())));
    assert!(!matches!(two.worlds[0].last_report(calls[0]), Report::Finished { .. }));
    let told = |place, ends| {
        vec![format!(
            "`test@1` also runs on another node with the name of this node ({place}): the deployment is ended {ends}"
        )]
    };
    assert_eq!(two.twice(), [told("boot 2", "there"), told("boot 1", "here")], "both are told");
}

#[test]
fn the_higher_epoch_goes_on_whoever_was_there_first() {
    let mut two = Two::new();
    two.deploy(0, "test");
    two.deploy(1, "other");
    two.run_for(500);
    two.deploy(1, "test");
    two.run_for(2000);
    assert_eq!(two.alive(), [2, 4]);
    two.meet = true;
    two.run_for(2000);
    assert_eq!(two.alive(), [0, 4], "what runs on one alone goes on, too");
}

#[test]
fn neither_takes_anything_on_while_both_are_there_and_both_are_shown() {
    let mut two = Two::new();
    two.deploy(0, "first");
    two.deploy(1, "second");
    two.run_for(2000);
    two.meet = true;
    two.run_for(2000);
    assert_eq!(two.alive(), [2, 2], "nothing runs on both");
    let calls = [two.deploy(0, "more"), two.deploy(1, "more")];
    let asked = [0, 1].map(|on| two.worlds[on].ask("c1", Request::Duplicates));
    two.run_for(500);
    let whys = [0, 1].map(|on| refusal(&two.worlds[on], calls[on]).expect("it is refused"));
    assert!(whys[0].starts_with("a second node is called `c1`: boot 2; nothing begins under this name"), "{whys:?}");
    assert!(whys[1].starts_with("another node called `c1` was there first: boot 1"), "{whys:?}");
    for (on, (first, second)) in [(0, ("process", "boot 2")), (1, ("boot 1", "process"))] {
        let [Answer::Duplicates(all)] = &two.worlds[on].answers[&asked[on]][..] else { panic!() };
        let [one] = &all[..] else { panic!("{all:?}") };
        assert!(one.host == "c1" && one.first.starts_with(first) && one.second.starts_with(second), "{one:?}");
    }
    // The other one has gone, or has another name: the name is free again.
    two.meet = false;
    two.run_for(10_000);
    let calls = [two.deploy(0, "more"), two.deploy(1, "more")];
    two.run_for(1000);
    assert_eq!([0, 1].map(|on| refusal(&two.worlds[on], calls[on])), [None, None]);
}

/// With any deployments on either side, and any number of lost messages: once the two have met, nothing runs on both,
/// and of each name that ran one deployment goes on.
#[test]
fn of_each_name_one_goes_on() {
    for seed in 0..200 {
        let mut two = Two::new();
        let mut draw = Draw::new(seed);
        let mut names = std::collections::BTreeMap::<&str, [bool; 2]>::new();
        for _ in 0..1 + draw.below(5) {
            let (on, name) = (draw.index(2), ["x", "y", "z"][draw.index(3)]);
            two.deploy(on, name);
            names.entry(name).or_default()[on] = true;
            two.run_for(50 * draw.below(4));
        }
        two.run_for(2000);
        let before: usize = names.values().map(|on| 2 * on.iter().filter(|there| **there).count()).sum();
        assert_eq!(two.alive().iter().sum::<usize>(), before, "seed {seed}");
        (two.meet, two.draw) = (true, Some(Draw::new(seed)));
        two.run_for(8000);
        assert_eq!(two.alive().iter().sum::<usize>(), 2 * names.len(), "seed {seed}: {names:?} {:?}", two.alive());
    }
}

/// More boots of its name than this node remembers links of come and go while a host is cut off: it is dealt with again, as if the two had
/// just met.
#[test]
fn a_host_is_heard_again_after_many_others_had_its_name() {
    let mut world = World::new(&["c1", "c2"]);
    let first = world.deploy("c1", FOUR);
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(1));
    for boot in 100..106 {
        world.give("c1", Input::Appeared { host: "c2".into(), boot });
        world.run_for(Duration::from_millis(200));
        let (to_boot, round) = (world.boots["c1"], world.rounds["c1"]);
        let (from, up, place, session) = ("c2".into(), Duration::ZERO, "elsewhere".into(), String::new());
        let pong = Pong { from, boot, to_boot, round, up, place, holder: None, session, origin: 0 };
        world.give("c1", Input::Pong(Box::new(pong)));
        world.run_for(Duration::from_millis(100));
        world.give("c1", Input::Vanished { host: "c2".into(), boot });
        world.run_for(Duration::from_secs(1));
    }
    let taken = world.changes.iter().filter(|(_, change)| matches!(change, Change::Appeared { replaces: true, .. }));
    assert_eq!(taken.count(), 6);
    heal(&mut world, "c2");
    world.run_for(Duration::from_secs(10));
    let last = world.last_report(first);
    assert!(matches!(last, Report::Finished { ending: Ending::Aborted(_), .. }), "{last:?}");
    assert_eq!(active(&world, "c2"), Vec::<u32>::new(), "what ran there for a home that has given it up has ended");
    let second = world.deploy_as("again", "c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(second), &Ending::Done(vec![]));
}
