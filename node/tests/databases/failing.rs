//! Disks that fail, and come back.

use super::world::{World, commit, put};
use dbmanager::logic::view::value::Datum;
use node::logic::database::question::{Far, Question, Reply};
use std::time::Duration;

/// Tries to write on a disk that takes nothing.
fn fail(world: &mut World, robot: usize, question: Question) -> Reply {
    world.robots[robot].broken = true;
    world.ask(robot, question)
}

fn write_on(level: Far) -> Question {
    commit(vec![put("team/new", &Datum::from(1))], level)
}

#[test]
fn a_disk_that_fails_stops_writes_and_nothing_else() {
    let mut world = World::team(&["r1", "r2"]);
    world.write(0, "team/kept", 1);
    let refused = fail(&mut world, 0, write_on(Far::Local));
    assert!(matches!(refused, Reply::Refused(why) if why.contains("may not have been written")));
    assert_eq!(world.read(0, "team/kept"), [Datum::from(1)]);
    assert!(world.read(0, "team/new").is_empty());
    let refused = world.ask(0, write_on(Far::Local));
    assert!(matches!(refused, Reply::Refused(why) if why.contains("no space left on device")));
    world.write(1, "team/other", 1);
    world.run(Duration::from_secs(3));
    assert!(world.read(0, "team/other").is_empty(), "what cannot be kept is not taken");
    assert!(world.status(0).closed.is_some());
    world.reopen(0);
    world.run(Duration::from_secs(12));
    assert_eq!(world.read(0, "team/other"), [Datum::from(1)]);
    world.write(0, "team/new", 2);
}
