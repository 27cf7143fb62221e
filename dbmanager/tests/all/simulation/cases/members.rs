//! Members of the team: joining, being away, being retired, coming back.

use super::team;
use crate::simulation::scenes;

/// A day in milliseconds.
const DAY: u64 = 86_400_000;

#[test]
fn who_was_away_for_15_days_returns() {
    returns_after(15);
}

#[test]
#[ignore = "long: 90 days"]
fn who_was_away_for_90_days_returns() {
    returns_after(90);
}

fn returns_after(days: u64) {
    let mut world = team(3);
    world.put(0, "team/a", 1);
    world.settle().expect("it settles");
    world.crash(2);
    world.delete(0, "team/a");
    world.run_for(days * DAY);
    assert_eq!(world.siblings(0, "team/a"), 1, "the deletion is kept for who is away");
    world.restart(2);
    world.settle().expect("it settles");
    world.run_for(30_000);
    assert_eq!((world.siblings(0, "team/a"), world.siblings(2, "team/a")), (0, 0));
}

#[test]
fn retired_while_away_returns_with_writes() {
    let mut world = team(3);
    world.put(0, "team/a", 1);
    world.settle().unwrap();
    world.isolate(2);
    world.put(2, "team/a", 2);
    world.put(2, "team/b", 3);
    world.delete(0, "team/a");
    world.retire(0, 2);
    world.run_for(60_000);
    assert_eq!(world.siblings(0, "team/a"), 0, "the retired robot holds nothing back");
    world.join_network(2);
    world.settle().unwrap();
    assert_eq!(world.siblings(0, "team/a"), 1, "what it wrote is there; the deletion it never saw is no obstacle");
    assert_eq!(world.value(1, "team/b"), Some(3));
}

#[test]
fn retired_while_away_does_not_bring_back_what_was_deleted() {
    brings_nothing_back_after(15);
}

#[test]
#[ignore = "long: 90 days"]
fn retired_for_90_days_does_not_bring_back_what_was_deleted() {
    brings_nothing_back_after(90);
}

fn brings_nothing_back_after(days: u64) {
    let mut world = team(3);
    world.put(0, "team/a", 1);
    world.settle().expect("it settles");
    world.crash(2);
    world.delete(0, "team/a");
    let away = world.asleep(2);
    world.retire_origin(0, away);
    world.run_for(days * DAY);
    assert_eq!(world.siblings(0, "team/a"), 0, "nobody waits for who is retired");
    world.restart(2);
    world.settle().expect("it settles");
    assert_eq!((world.siblings(0, "team/a"), world.siblings(2, "team/a")), (0, 0), "and it has no zombies");
}

#[test]
fn retired_origin_tx_still_in_flight() {
    let mut world = team(3);
    world.cut(0, 2);
    world.put(2, "team/a", 1);
    world.retire(0, 2);
    world.delete(0, "team/a");
    world.settle().unwrap();
    assert_eq!(world.value(0, "team/a"), Some(1), "the deletion had not seen it");
}

#[test]
fn retire_both_sides_of_partition_each_other() {
    let mut world = team(2);
    world.cut(0, 1);
    world.put(0, "team/a", 1);
    world.put(1, "team/b", 2);
    world.retire(0, 1);
    world.retire(1, 0);
    world.run_for(30_000);
    world.heal(0, 1);
    world.settle().unwrap();
    assert_eq!((world.value(0, "team/b"), world.value(1, "team/a")), (Some(2), Some(1)));
}

#[test]
fn last_member_standing() {
    let mut world = team(2);
    world.put(1, "team/a", 1);
    world.settle().unwrap();
    world.crash(1);
    let gone = world.asleep(1);
    world.retire_origin(0, gone);
    world.delete(0, "team/a");
    world.run_for(60_000);
    assert_eq!((world.siblings(0, "team/a"), world.replica(0).is_member()), (0, true));
    world.check_limits().unwrap();
}

#[test]
fn the_first_robot_has_no_privilege() {
    let mut world = team(3);
    world.put(0, "team/a", 1);
    world.settle().unwrap();
    world.retire(1, 0);
    world.run_for(20_000);
    world.lose_disk(0);
    world.restart(0);
    world.settle().unwrap();
    assert_eq!(world.value(0, "team/a"), Some(1));
}

#[test]
fn snapshot_source_dies_half_way() {
    let mut world = team(3);
    for number in 0..2000 {
        world.put(0, &format!("team/many/{number}"), number);
    }
    world.settle().unwrap();
    world.lose_disk(2);
    world.restart(2);
    world.network.choke(2, 20_000);
    world.cut(1, 2);
    world.run_for(2_000);
    world.crash(0);
    world.heal(1, 2);
    world.run_for(60_000);
    assert!(world.replica(2).is_member(), "another has the same chunks");
    world.settle().unwrap();
}

#[test]
fn snapshot_then_tail_from_other_peer() {
    let mut world = team(2);
    world.put(0, "team/a", 1);
    world.gather(3);
    world.cut(0, 2);
    world.put(0, "team/b", 2);
    world.run_for(20_000);
    assert_eq!((world.value(2, "team/a"), world.value(2, "team/b")), (Some(1), Some(2)));
    world.settle().unwrap();
}

#[test]
fn peer_with_lower_low_cut_needs_snapshot_both_ways() {
    let mut world = team(3);
    world.isolate(2);
    world.put(2, "team/z", 9);
    world.put(0, "team/a", 1);
    world.run_for(20_000);
    // A new member that got everything as a snapshot. The third robot can reach only this one.
    world.gather(4);
    world.run_for(20_000);
    world.heal(2, 3);
    world.run_for(20_000);
    assert_eq!((world.value(2, "team/a"), world.value(3, "team/z")), (Some(1), Some(9)));
    world.join_network(2);
    world.settle().unwrap();
}

#[test]
fn two_with_each_others_transactions_as_state_only() {
    scenes::states_only().unwrap();
}

#[test]
fn two_who_were_admitted_by_others_that_are_gone() {
    let mut world = team(2);
    world.cut(0, 1);
    world.cut(1, 2);
    world.gather(3);
    world.isolate(3);
    world.heal(1, 3);
    world.gather(4);
    world.put(2, "team/a", 1);
    world.put(3, "team/b", 2);
    world.crash(0);
    world.crash(1);
    world.heal(2, 3);
    world.run_for(60_000);
    for node in 2..4 {
        assert_eq!((world.value(node, "team/a"), world.value(node, "team/b")), (Some(1), Some(2)), "at {node}");
    }
    (0..4).for_each(|node| world.join_network(node));
    world.settle().unwrap();
}

#[test]
fn retired_robot_meets_one_who_does_not_know() {
    scenes::last_words().unwrap();
}

#[test]
fn two_of_a_retired_side_come_back_one_after_the_other() {
    scenes::two_returns().unwrap();
}

#[test]
fn two_teams_of_one_name_become_one() {
    scenes::second_team().unwrap();
}

#[test]
fn forty_robots_boot_at_once() {
    let mut world = team(40);
    world.put(39, "team/a", 1);
    (0..40).for_each(|node| world.crash(node));
    (0..40).for_each(|node| world.restart(node));
    world.run_for(15_000);
    assert!((0..40).all(|node| world.value(node, "team/a") == Some(1)));
    world.settle().unwrap();
}
