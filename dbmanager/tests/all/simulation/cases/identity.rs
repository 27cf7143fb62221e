//! Disks that are lost, restored, copied or damaged: no acknowledged transaction is lost, and no name is used twice.

use super::team;
use crate::simulation::scenes;
use dbmanager::logic::record::Records;
use dbmanager::logic::replica::{Config, Replica};

#[test]
fn disk_lost_same_name_returns() {
    let mut world = team(3);
    world.put(2, "team/a", 1);
    world.settle().unwrap();
    let before = world.replica(2).origin();
    world.lose_disk(2);
    world.restart(2);
    world.put(2, "team/b", 2);
    world.settle().unwrap();
    assert_eq!((world.value(2, "team/a"), world.value(0, "team/b")), (Some(1), Some(2)));
    assert_ne!(world.replica(2).origin(), before, "a new disk is a new origin");
}

#[test]
fn restored_backup_isolated_writes_then_meets() {
    let mut world = team(2);
    world.expect_forks();
    world.put(1, "team/a", 1);
    world.settle().unwrap();
    let backup = world.backup(1);
    world.put(1, "team/b", 2);
    world.settle().unwrap();
    world.restore(1, backup);
    world.isolate(1);
    world.restart(1);
    world.put(1, "team/c", 3);
    world.put(1, "team/d", 4);
    world.join_network(1);
    world.settle().unwrap();
    for (key, value) in [("team/a", 1), ("team/b", 2), ("team/c", 3), ("team/d", 4)] {
        assert_eq!((world.value(0, key), world.value(1, key)), (Some(value), Some(value)), "{key}");
    }
}

#[test]
fn a_restored_backup_that_its_witness_notices_writes_nothing_under_its_old_name() {
    let mut world = team(3);
    let backup = world.backup(1);
    let before = world.replica(1).origin();
    world.put(1, "team/a", 1);
    world.settle().unwrap();
    world.restore(1, backup);
    world.isolate(1);
    world.restart_copied(1);
    world.put(1, "team/a", 2);
    assert_ne!(world.replica(1).origin(), before);
    world.join_network(1);
    world.settle().unwrap();
    assert_eq!(world.siblings(0, "team/a"), 2, "neither has seen the other");
}

#[test]
fn set_back_without_witness_only_others_transactions_lost() {
    scenes::set_back().unwrap();
}

#[test]
fn number_used_twice_is_an_alarm_at_once() {
    scenes::fork().unwrap();
}

#[test]
fn two_writes_under_one_name_are_both_kept() {
    scenes::two_writes().unwrap();
}

#[test]
fn write_that_had_seen_another_of_the_same_number() {
    scenes::seen_by_number().unwrap();
}

#[test]
fn state_of_the_other_branch_hides_nothing() {
    scenes::other_branch().unwrap();
}

#[test]
fn tail_lost_flush_lied_seq_reused() {
    let mut world = team(2);
    world.expect_forks();
    let before = world.backup(1);
    world.put(1, "team/a", 1);
    world.settle().unwrap();
    world.restore(1, before);
    world.restart(1);
    world.settle().unwrap();
    assert_eq!(world.value(1, "team/a"), Some(1));
}

#[test]
fn sdcard_cloned_two_live() {
    let mut world = team(2);
    world.expect_forks();
    world.put(1, "team/a", 1);
    world.settle().unwrap();
    let before = world.replica(1).origin();
    let card = world.backup(1);
    world.add_clone(1, card);
    world.put(2, "team/b", 2);
    world.put(1, "team/c", 3);
    world.settle().unwrap();
    for node in 0..3 {
        let values = ["team/a", "team/b", "team/c"].map(|key| world.value(node, key));
        assert_eq!(values, [Some(1), Some(2), Some(3)], "at {node}");
    }
    let origins = [1, 2].map(|node| world.replica(node).origin());
    assert!(origins[0] != origins[1] && !origins.contains(&before), "both have new names");
}

#[test]
fn a_bit_that_flips_in_any_record_is_noticed() {
    let mut world = team(2);
    world.put(1, "team/a", 1);
    world.settle().unwrap();
    let records = world.backup(1);
    let open = |records: &Records| {
        let config = Config { robot: "r1".into(), seed: 1, log_size: 0 };
        Replica::open(config, records)
    };
    assert!(open(&records).is_ok());
    for (name, record) in &records {
        for index in [0, record.len() / 2, record.len() - 1] {
            let mut damaged = records.clone();
            damaged.get_mut(name).unwrap()[index] ^= 4;
            assert!(open(&damaged).is_err(), "byte {index} of {name:?}");
        }
        let mut less = records.clone();
        less.remove(name);
        assert!(open(&less).is_err(), "without {name:?}");
    }
}

#[test]
fn fsync_eio_once() {
    let mut world = team(2);
    world.break_next_write(1);
    world.put(1, "team/a", 1);
    world.restart(1);
    world.put(1, "team/b", 2);
    world.settle().unwrap();
    assert_eq!(world.value(0, "team/b"), Some(2));
}

#[test]
fn disk_full_then_freed() {
    let mut world = team(2);
    world.put(1, "team/a", 1);
    world.fill_disk(1, true);
    world.put(1, "team/a", 2);
    world.restart(1);
    assert_eq!(world.value(1, "team/a"), Some(1), "what could not be written was never shown");
    world.fill_disk(1, false);
    world.restart(1);
    world.put(1, "team/a", 3);
    world.settle().unwrap();
    assert_eq!(world.value(0, "team/a"), Some(3));
}
