//! Wrong clocks: they may make a write lose against a concurrent one, but never lose a write.

use super::team;
use crate::simulation::world::EPOCH_MS;
use dbmanager::logic::clock::Quality;
use dbmanager::logic::replica::{Alarm, Input};

const YEAR_2099_MS: i64 = 73 * 365 * 86_400_000;

#[test]
fn a_robot_that_boots_in_1970_overwrites_what_it_saw_and_loses_races() {
    let mut world = team(2);
    world.put(0, "team/seen", 1);
    world.settle().unwrap();
    world.crash(1);
    let clock = world.clock(1);
    (clock.offset_ms, clock.quality) = (-(EPOCH_MS as i64), Quality::Unset);
    world.isolate(1);
    world.restart(1);
    world.put(1, "team/seen", 2);
    world.run_for(60_000);
    world.put(0, "team/race", 3);
    world.put(1, "team/race", 4);
    world.join_network(1);
    world.settle().unwrap();
    assert_eq!((world.value(0, "team/seen"), world.siblings(0, "team/seen")), (Some(2), 1), "it saw the other");
    assert_eq!((world.value(0, "team/race"), world.siblings(0, "team/race")), (Some(3), 2), "the loser is kept");
}

#[test]
fn a_robot_that_boots_in_2099_is_named_and_everybody_goes_on_until_the_clocks_are_healed() {
    let mut world = team(3);
    world.clock(2).offset_ms = YEAR_2099_MS;
    world.crash(2);
    world.restart(2);
    world.put(2, "team/a", 1);
    world.settle().unwrap();
    assert!(world.alarms.iter().any(|(node, alarm)| *node == 0 && matches!(alarm, Alarm::ClockSuspect { .. })));
    world.put(0, "team/a", 2);
    world.settle().unwrap();
    assert_eq!(world.value(2, "team/a"), Some(2), "who has seen it can overwrite it");
    let newest = |world: &crate::simulation::world::World| world.replica(0).log().last_stamp();
    assert!(newest(&world).millis() > EPOCH_MS + YEAR_2099_MS as u64 / 2);
    world.clock(2).offset_ms = 0;
    world.input(0, |_, wall| Input::HealClock(wall));
    world.put(0, "team/b", 3);
    world.settle().unwrap();
    let healed = newest(&world);
    assert!(healed.epoch == 1 && healed.millis() < EPOCH_MS + 86_400_000, "dates are near the truth again: {healed:?}");
    world.put(2, "team/b", 4);
    world.settle().unwrap();
    assert_eq!(world.value(1, "team/b"), Some(4));
}

#[test]
fn a_clock_that_stands_still_or_jumps_back_stops_nobody() {
    let mut world = team(2);
    world.clock(0).frozen = Some(EPOCH_MS);
    (1..50).for_each(|value| world.put(0, "team/a", value));
    world.clock(0).frozen = None;
    world.clock(0).offset_ms = -3_600_000;
    (50..100).for_each(|value| world.put(0, "team/a", value));
    world.settle().unwrap();
    assert_eq!(world.value(1, "team/a"), Some(99));
}
