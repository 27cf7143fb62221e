//! Links that are slow, one-way, lossy or unstable.

use super::team;
use crate::simulation::world::{Faults, World};
use dbmanager::logic::key::Key;
use dbmanager::logic::replica::AckLevel;
use dbmanager::logic::txn::{Draft, Encoding, Value};
use std::time::Duration;

/// Commits values of `size` bytes, each in one transaction.
fn backlog(world: &mut World, node: usize, (count, size): (usize, usize)) {
    for number in 0..count {
        let value = Value { encoding: Encoding::BYTES, bytes: vec![7; size].into() };
        let key = Key::new(format!("team/backlog/{number}")).expect("it is a key");
        world
            .commit_at(node, Draft::new("backlog").put(key, value), AckLevel::Local)
            .expect("nothing speaks against it");
    }
}

/// Returns how many milliseconds it takes until two robots have the same transactions.
fn time_to_equal(world: &mut World, (a, b): (usize, usize)) -> u64 {
    for step in 0..4000 {
        if world.replica(a).log().vector() == world.replica(b).log().vector() {
            return step * 50;
        }
        world.run_for(50);
    }
    panic!("{a} and {b} do not get equal");
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
fn one_way_link() {
    let mut world = team(3);
    world.network.cut_one_way(0, 1);
    world.put(0, "team/a", 1);
    world.put(1, "team/b", 2);
    world.settle().unwrap();
    world.cut(0, 2);
    world.put(1, "team/c", 3);
    world.run_for(30_000);
    assert_eq!(world.value(0, "team/c"), Some(3), "a push needs no way back");
}

#[test]
fn flapping_link_1s() {
    let mut world = team(2);
    for round in 0..60 {
        if round % 2 == 0 {
            world.cut(0, 1);
        } else {
            world.heal(0, 1);
        }
        world.put(round % 2, &format!("team/k{round}"), round as u64);
        world.run_for(1000);
    }
    assert!(time_to_equal(&mut world, (0, 1)) <= 2_000);
    world.settle().unwrap();
}

#[test]
fn a_link_of_50_kbit_per_s_is_used_well() {
    let mut world = team(2);
    world.isolate(1);
    backlog(&mut world, 0, (1000, 100));
    world.network.choke(1, 6250);
    world.run_for(30_000);
    world.join_network(1);
    let before = world.network.sent;
    let millis = time_to_equal(&mut world, (0, 1));
    let sent = world.network.sent - before;
    let limit = 1000 * 1000 * (100 + 32) / 6250;
    // I13 and I14, in addition to the bytes of the values and 32 bytes for each transaction. Measured: 2.2 times the
    // time, and 1.4 times the bytes.
    assert!(millis <= limit * 5 / 2, "{millis} ms for what takes {limit} ms at least; {sent} bytes");
    assert!(sent <= 1000 * (100 + 32) * 3 / 2, "{sent} bytes");
    world.settle().unwrap();
}

/// A satellite or a mobile network: the time for a backlog depends on its bytes, not on the latency. Measured at 100
/// ms: 1.36 times the time of the bytes; an earlier version took 4.0 times.
#[test]
fn a_long_way_is_no_slow_one() {
    for (millis, rate) in [(100, 1_000_000), (500, 250_000), (1500, 50_000)] {
        let mut world = team(2);
        world.isolate(1);
        backlog(&mut world, 0, (if rate > 100_000 { 5500 } else { 1500 }, 1000));
        world.network.latency_us = [millis * 1000, millis * 1000 + 1];
        world.network.choke(1, rate);
        let before = world.network.sent;
        world.join_network(1);
        let took = time_to_equal(&mut world, (0, 1));
        let sent = world.network.sent - before;
        // The hello, and the question.
        let limit = sent * 1000 / rate + 3 * millis;
        println!("{millis} ms, {rate} B/s: {took} ms of {limit} for {sent} bytes");
        assert!(took <= limit * 3 / 2, "{millis} ms, {rate} B/s: {took} ms of {limit} for {sent} bytes");
    }
}

/// A node counts as failed after 6 s of silence, and the answer in transit is then lost with the link. So no answer
/// may take that long, but the link must still be full. Measured at 500 ms: 1.2 times the time of the bytes alone, and
/// 1.5 s of silence; an earlier version had 7.0 s.
#[test]
fn a_backlog_over_50_kbit_per_s_and_a_long_way_keeps_nodes_apart_for_2_s_at_most() {
    for millis in [250, 500] {
        let mut world = team(2);
        world.isolate(1);
        backlog(&mut world, 0, (600, 40));
        world.network.latency_us = [millis * 1000, millis * 1000 + 1];
        world.network.choke(1, 6250);
        world.run_for(30_000);
        world.join_network(1);
        let (before, _) = (world.network.sent, std::mem::take(&mut world.network.occupied_max));
        let took = time_to_equal(&mut world, (0, 1));
        let (sent, occupied) = (world.network.sent - before, world.network.occupied_max);
        let limit = 600 * (40 + 72) * 1000 / 6250 + 2 * millis;
        println!("{millis} ms: {took} ms of {limit}, {sent} bytes; occupied for {occupied:?}");
        assert!(took <= limit * 3 / 2, "{millis} ms: {took} ms of {limit}");
        assert!(sent <= 600 * (40 + 72) * 3 / 2, "{millis} ms: {sent} bytes");
        assert!(occupied <= Duration::from_secs(2), "{millis} ms: a message waits for {occupied:?}");
        world.settle().unwrap();
    }
}

#[test]
fn a_state_of_large_chunks_comes_over_50_kbit_per_s() {
    let mut world = team(2);
    backlog(&mut world, 0, (20, 20_000));
    world.settle().unwrap();
    world.lose_disk(1);
    world.network.choke(1, 6250);
    world.restart(1);
    world.run_for(200_000);
    assert!(
        world.replica(1).is_member(),
        "400,000 bytes take 64 s, and each chunk longer than it is waited for at first"
    );
    assert_eq!(world.replica(1).state().digest(), world.replica(0).state().digest());
    world.settle().unwrap();
}

#[test]
fn chunk_lost_each_time_at_same_byte() {
    let mut world = team(2);
    world.isolate(1);
    backlog(&mut world, 0, (200, 1000));
    world.network.size_max = 20_000;
    world.join_network(1);
    let millis = time_to_equal(&mut world, (0, 1));
    assert!(millis <= 120_000, "{millis} ms");
    world.settle().unwrap();
}

#[test]
fn tx_bigger_than_mtu_is_pulled() {
    let mut world = team(2);
    let mut draft = Draft::new("large");
    for number in 0..4 {
        let value = Value { encoding: Encoding::BYTES, bytes: vec![7; 50_000].into() };
        draft = draft.put(Key::new(format!("team/large/{number}")).unwrap(), value);
    }
    world.commit_at(0, draft, AckLevel::Local).unwrap();
    world.settle().unwrap();
    assert_eq!(world.siblings(1, "team/large/3"), 1);
}

#[test]
fn push_only_lost_pull_converges() {
    let faults = Faults { drop: 60, ..Faults::default() };
    let mut world = World::new(3, faults);
    world.gather(3);
    world.put(0, "team/a", 1);
    world.settle().unwrap();
}

#[test]
fn duplicate_replies_two_peers() {
    let mut world = team(3);
    world.network.duplicate = 100;
    world.isolate(2);
    backlog(&mut world, 0, (50, 10));
    world.run_for(5_000);
    world.join_network(2);
    world.settle().unwrap();
}

#[test]
fn reply_after_timeout() {
    let mut world = team(2);
    world.isolate(1);
    backlog(&mut world, 0, (10, 10));
    world.network.slow_down(1, Duration::from_secs(3));
    world.join_network(1);
    world.run_for(60_000);
    assert_eq!(world.siblings(1, "team/backlog/9"), 1, "what comes late is taken all the same");
}

#[test]
fn a_backlog_that_two_offer_is_sent_once() {
    let mut world = team(3);
    world.isolate(2);
    backlog(&mut world, 0, (1000, 100));
    world.run_for(20_000);
    world.network.size_max = usize::MAX - 1; // From now on bytes are counted.
    world.join_network(2);
    let before = world.network.sent;
    time_to_equal(&mut world, (0, 2));
    let sent = world.network.sent - before;
    // I14. Measured: 2.6. Each transaction comes from both robots, since both are asked at the same time.
    assert!(sent <= 1000 * (100 + 32) * 3, "{sent} bytes for {} that were missing", 1000 * (100 + 32));
    world.settle().unwrap();
}
