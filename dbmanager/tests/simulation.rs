//! Whole teams of replicas on virtual time, over a network and disks that fail: many seeds, and named cases.

#[expect(clippy::unwrap_used, reason = "it is part of the tests")]
#[path = "simulation/world.rs"]
mod world;

use world::{Faults, World};

/// Seeds of the quick tier. `cargo run --release -p dbmanager --example seeds -- 1 1000000` runs more.
const SEEDS: u64 = 300;

#[test]
fn seeds_of_the_quick_tier_converge_and_lose_nothing() {
    for seed in 1..=SEEDS {
        if let Err(broken) = world::run(seed, Default::default()) {
            panic!("seed {seed}: {broken}");
        }
    }
}

#[test]
fn a_seed_replays() {
    assert_eq!(world::run(7, Default::default()), world::run(7, Default::default()));
}

/// Returns a calm team of this many robots, all of them members.
fn team(count: usize) -> World {
    let mut world = World::new(1, Faults::default(), Default::default());
    world.gather(count);
    world
}

#[test]
fn data_mule_chain_a_b_c_never_ac() {
    let mut world = team(3);
    world.cut(0, 2);
    world.put(0, "team/a", 1);
    world.put(2, "team/c", 2);
    world.settle().unwrap();
}

#[test]
fn three_way_partition_heals_pairwise() {
    let mut world = team(3);
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        world.cut(a, b);
    }
    for node in 0..3 {
        world.put(node, "team/a", 1 + node as u64);
    }
    world.run_for(20_000);
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        world.heal(a, b);
        world.run_for(20_000);
    }
    world.settle().unwrap();
    assert_eq!(world.siblings(0, "team/a"), 3);
}

#[test]
fn require_absent_both_create() {
    let mut world = team(2);
    world.cut(0, 1);
    world.create(0, "team/a", 1);
    world.create(1, "team/a", 2);
    world.heal(0, 1);
    world.settle().unwrap();
    assert_eq!(world.siblings(0, "team/a"), 2, "both hold, and everybody can see it");
}

#[test]
fn away_90_days_returns() {
    let mut world = team(3);
    world.put(0, "team/a", 1);
    world.settle().unwrap();
    world.crash(2);
    world.delete(0, "team/a");
    world.run_for(90 * 86_400_000);
    assert_eq!(world.siblings(0, "team/a"), 1, "the deletion is kept for who is away");
    world.restart(2);
    world.settle().unwrap();
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
fn disk_lost_same_name_returns() {
    let mut world = team(3);
    world.put(2, "team/a", 1);
    world.settle().unwrap();
    world.lose_disk(2);
    world.restart(2);
    world.put(2, "team/b", 2);
    world.settle().unwrap();
    assert_eq!((world.value(2, "team/a"), world.value(0, "team/b")), (Some(1), Some(2)));
}

#[test]
fn restored_backup_isolated_writes_then_meets() {
    let mut world = team(2);
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
    // One origin has written twice under one number: the reference cannot say what is right, but we can.
    world.converge().unwrap();
    for (key, value) in [("team/a", 1), ("team/b", 2), ("team/c", 3), ("team/d", 4)] {
        assert_eq!((world.value(0, key), world.value(1, key)), (Some(value), Some(value)), "{key}");
    }
}

#[test]
fn tail_lost_flush_lied_seq_reused() {
    let mut world = team(2);
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
    world.put(1, "team/a", 1);
    world.settle().unwrap();
    let card = world.backup(1);
    world.add_clone(1, card);
    world.put(2, "team/b", 2);
    world.put(1, "team/c", 3);
    // Both have written as the same origin: the reference knows no two transactions of one name.
    world.converge().unwrap();
    for node in 0..3 {
        let values = ["team/a", "team/b", "team/c"].map(|key| world.value(node, key));
        assert_eq!(values, [Some(1), Some(2), Some(3)], "at {node}");
    }
}

#[test]
fn key_deleted_everywhere_leaves_nothing() {
    let mut world = team(3);
    world.put(0, "team/a", 1);
    world.settle().unwrap();
    world.delete(1, "team/a");
    world.settle().unwrap();
    world.run_for(60_000);
    assert_eq!([0, 1, 2].map(|node| world.siblings(node, "team/a")), [0, 0, 0]);
}

#[test]
fn push_only_lost_pull_converges() {
    let faults = Faults { drop: 60, ..Faults::default() };
    let mut world = World::new(3, faults, Default::default());
    world.gather(3);
    world.put(0, "team/a", 1);
    world.settle().unwrap();
}

#[test]
fn peer_with_lower_low_cut_needs_snapshot_both_ways() {
    let mut world = team(3);
    world.isolate(2);
    world.put(2, "team/z", 9);
    world.put(0, "team/a", 1);
    world.run_for(20_000);
    // A fresh member that has everything as a snapshot, and is the only one that the third can reach.
    world.gather(4);
    world.run_for(20_000);
    world.heal(2, 3);
    world.run_for(20_000);
    assert_eq!((world.value(2, "team/a"), world.value(3, "team/z")), (Some(1), Some(9)));
    world.join_network(2);
    world.settle().unwrap();
}
