//! Disks that fail, and come back.

use super::world::{World, commit, open, put};
use dbmanager::logic::view::past::Keys;
use dbmanager::logic::view::value::Datum;
use node::logic::database::question::{AckLevel, AsOf, Question, Reply};
use node::logic::database::{Database, Effect, Input};
use std::time::Duration;

/// Tries to write on a disk that takes nothing.
fn fail(world: &mut World, robot: usize, question: Question) -> Reply {
    world.robots[robot].broken = true;
    world.ask(robot, question)
}

fn write_on(level: AckLevel) -> Question {
    commit(vec![put("team/new", &Datum::from(1))], level)
}

#[test]
fn a_disk_that_fails_stops_writes_and_nothing_else() {
    let mut world = World::team(&["r1", "r2"]);
    world.write(0, "team/kept", 1);
    let refused = fail(&mut world, 0, write_on(AckLevel::Local));
    assert!(matches!(refused, Reply::Unknown(why) if why.contains("the write may be missing")));
    assert_eq!(world.read(0, "team/kept"), [Datum::from(1)]);
    assert!(world.read(0, "team/new").is_empty());
    let refused = world.ask(0, write_on(AckLevel::Local));
    assert!(matches!(refused, Reply::Refused(why) if why.contains("no space left on device")));
    world.write(1, "team/other", 1);
    world.run(Duration::from_secs(3));
    assert!(world.read(0, "team/other").is_empty(), "what cannot be kept is not taken");
    assert!(world.status(0).store.closed.is_some() && !world.status(0).alarms.is_empty());
    world.reopen(0);
    let status = world.status(0);
    assert_eq!((status.store.closed, status.alarms.len()), (None, 1), "whether there is room again is not known yet");
    world.run(Duration::from_secs(12));
    assert!(world.status(0).alarms.is_empty(), "there is room again");
    assert_eq!(world.read(0, "team/other"), [Datum::from(1)]);
    world.write(0, "team/new", 2);
}

#[test]
fn nobody_is_told_what_is_not_on_the_disk() {
    let mut world = World::team(&["r1", "r2"]);
    let watch = |from| Question::Watch { keys: Keys::Below("team/".into()), from };
    let call = world.call(0, watch(None));
    let [Reply::Version(from)] = world.replies(0, call) else { panic!("not watching") };
    let from = from.clone();
    fail(&mut world, 0, write_on(AckLevel::Local));
    assert_eq!((world.told(0, call), world.robots[0].ended.contains(&call)), (vec![], true));
    // While the disk is away, a watch that resumes is told to return later, and no position can be named.
    let later = world.call(0, watch(Some(from.clone())));
    assert!(world.replies(0, later).is_empty() && world.robots[0].ended.contains(&later));
    for question in [watch(None), Question::Version(AsOf::Now)] {
        assert!(matches!(world.ask(0, question), Reply::Refused(_)));
    }
    world.reopen(0);
    let again = world.call(0, watch(Some(from)));
    let written = world.write(0, "team/b", 2);
    assert_eq!(world.told(0, again), [written], "it bears the name of the one that was not written");
}

#[test]
fn an_order_that_is_not_on_the_disk_is_not_done() {
    let mut world = World::team(&["r1", "r2"]);
    let answer = fail(&mut world, 0, Question::Retire { member: "r2".into() });
    assert!(matches!(&answer, Reply::Unknown(why) if why.contains("the write may be missing")), "{answer:?}");
    world.reopen(0);
    assert_eq!(world.status(0).members.len(), 2);
}

#[test]
fn what_was_committed_before_a_failure_stays_committed() {
    let mut world = World::team(&["r1", "r2"]);
    world.away(&[1], true);
    let call = world.call(0, write_on(AckLevel::Everywhere));
    fail(&mut world, 0, write_on(AckLevel::Everywhere));
    assert!(matches!(world.replies(0, call), [Reply::Committed(_)]), "{:?}", world.replies(0, call));
    assert!(world.robots[0].ended.contains(&call));
}

#[test]
fn who_does_not_become_another_is_found_as_before() {
    let mut world = World::team(&["r1", "r2"]);
    // A copy of the disk says hello: its replica has to start again under another name, which does not reach the disk.
    let mut copy = Database::new(open("r1", &world.robots[0].disk, 50), "r1", "dca", None);
    let (before, mut effects) = (copy.address(), Vec::new());
    copy.handle(world.now, world.wall(), vec![Input::Appeared], &mut effects);
    let hello = effects
        .into_iter()
        .find_map(|effect| if let Effect::Broadcast(envelope) = effect { Some(envelope) } else { None });
    world.robots[0].broken = true;
    world.robots[0].inbox.push(Input::Envelope(hello.unwrap()));
    world.turns();
    assert!(world.robots[0].machine.closed().is_some());
    world.reopen(0);
    assert_eq!(world.robots[0].machine.address(), before);
    world.away(&[1], true);
    world.write(0, "team/a", 1);
    world.away(&[1], false);
    world.run(Duration::from_secs(20));
    assert_eq!(world.read(1, "team/a"), [Datum::from(1)], "it can be asked");
}
