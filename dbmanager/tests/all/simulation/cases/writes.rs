//! Promises to the callers of a commit.

use super::team;
use dbmanager::logic::key::Key;
use dbmanager::logic::replica::AckLevel;
use dbmanager::logic::txn::{Condition, Draft};

fn key(text: &str) -> Key {
    Key::new(text).expect("it is a key")
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
fn cas_same_key_both_sides() {
    let mut world = team(2);
    world.put(0, "team/a", 1);
    world.settle().unwrap();
    let version = world.replica(0).state().get(&key("team/a")).unwrap().dot;
    world.cut(0, 1);
    let swap = |value: u64| {
        Draft::new("swap").require(key("team/a"), Condition::Is(version)).put(key("team/a"), &value.to_le_bytes())
    };
    assert!(world.commit_at(0, swap(2), AckLevel::Local).is_some());
    assert!(world.commit_at(1, swap(3), AckLevel::Local).is_some());
    assert_eq!(world.commit_at(0, swap(4), AckLevel::Local), None, "on one robot only one of them holds");
    world.heal(0, 1);
    world.settle().unwrap();
    assert!(world.replica(0).state().is_conflict(&key("team/a")));
    assert_eq!(world.commit_at(0, swap(5), AckLevel::Local), None);
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
    world.check_limits().unwrap();
}

#[test]
fn ack_k_then_k_disks_die() {
    let mut world = team(3);
    let draft = Draft::new("dear").put(key("team/a"), &1_u64.to_le_bytes());
    let dot = world.commit_at(0, draft, AckLevel::Replicated(1)).unwrap();
    world.run_for(2_000);
    assert!(world.replica(0).has_reached(dot, &AckLevel::Replicated(1)));
    world.lose_disk(0);
    world.restart(0);
    world.settle().unwrap();
    assert_eq!(world.value(0, "team/a"), Some(1));
}

#[test]
fn pending_ticket_resolved_after_reboot() {
    let mut world = team(2);
    world.cut(0, 1);
    let draft = Draft::new("patient").put(key("team/a"), &1_u64.to_le_bytes());
    let dot = world.commit_at(0, draft, AckLevel::Everywhere).unwrap();
    world.run_for(10_000);
    world.crash(0);
    world.restart(0);
    assert!(!world.replica(0).has_reached(dot, &AckLevel::Everywhere));
    world.heal(0, 1);
    world.settle().unwrap();
    world.run_for(20_000);
    assert!(world.replica(0).has_reached(dot, &AckLevel::Everywhere));
}

#[test]
fn empty_tx_and_deletions_of_nothing() {
    let mut world = team(2);
    assert!(world.commit_at(0, Draft::new("nothing"), AckLevel::Local).is_some());
    world.delete(1, "team/never");
    world.settle().unwrap();
    world.run_for(60_000);
    assert_eq!(world.siblings(0, "team/never"), 0);
}

#[test]
fn a_key_written_10_000_times_is_one_key() {
    let mut world = team(2);
    for value in 0..10_000 {
        world.put(0, "team/a", value);
        if value % 100 == 0 {
            world.run_for(1_000);
        }
    }
    world.settle().unwrap();
    world.run_for(60_000);
    world.check_limits().unwrap();
    assert_eq!((world.value(1, "team/a"), world.siblings(1, "team/a")), (Some(9_999), 1));
}
