//! Scenes: named cases that are also run with injected bugs, since seeds hardly ever reach the conditions of these
//! bugs.

use super::world::{Faults, World};
use dbmanager::logic::replica::Alarm;

/// How a scene ends.
type Ending = Result<(), String>;
/// A scene and its name.
type Scene = (&'static str, fn() -> Ending);

/// All scenes, by name.
#[cfg_attr(test, expect(dead_code, reason = "the named cases call each by itself"))]
pub(crate) const ALL: [Scene; 9] = [
    ("two_with_each_others_transactions_as_state_only", states_only),
    ("retired_robot_meets_one_who_does_not_know", last_words),
    ("set_back_without_witness_only_others_transactions_lost", set_back),
    ("number_used_twice_is_an_alarm_at_once", fork),
    ("two_writes_under_one_name_are_both_kept", two_writes),
    ("two_of_a_retired_side_come_back_one_after_the_other", two_returns),
    ("write_that_had_seen_another_of_the_same_number", seen_by_number),
    ("two_teams_of_one_name_become_one", second_team),
    ("state_of_the_other_branch_hides_nothing", other_branch),
];

fn team(count: usize) -> World {
    let mut world = World::new(1, Faults::default());
    world.gather(count);
    world
}

fn must(holds: bool, what: &str) -> Ending {
    if holds { Ok(()) } else { Err(what.to_owned()) }
}

/// Two members have each received a state with transactions that the other lacks, and the robots that wrote these
/// transactions are lost.
pub(crate) fn states_only() -> Ending {
    let mut world = team(4);
    world.isolate(0);
    world.isolate(1);
    world.cut(2, 3);
    world.put(2, "team/a", 1);
    world.put(3, "team/b", 2);
    // Two new members, each of which gets the transactions of one of the two as a state.
    world.cut(3, 4);
    world.gather(5);
    world.cut(2, 5);
    world.cut(4, 5);
    world.gather(6);
    world.heal(0, 4);
    world.heal(1, 5);
    world.run_for(20_000);
    must(world.value(0, "team/a") == Some(1) && world.value(1, "team/b") == Some(2), "each has a state")?;
    (2..6).for_each(|node| world.crash(node));
    world.heal(0, 1);
    world.run_for(60_000);
    must(world.replica(0).log().vector() == world.replica(1).log().vector(), "T7: they never meet")?;
    // One robot has started again, and has left the other robots' transactions to these robots.
    (0..6).for_each(|node| world.join_network(node));
    world.settle()?;
    must(world.value(0, "team/b") == Some(2) && world.value(1, "team/a") == Some(1), "all is there in the end")
}

/// A retired robot has written concurrently with a deletion. The robot that it meets has the deletion, but not the
/// retirement.
pub(crate) fn last_words() -> Ending {
    let mut world = team(3);
    world.put(0, "team/a", 1);
    world.settle()?;
    world.isolate(2);
    world.put(2, "team/a", 2);
    world.delete(0, "team/a");
    world.run_for(30_000);
    world.cut(0, 1);
    world.retire(0, 2);
    world.run_for(30_000);
    world.heal(1, 2);
    world.run_for(10_000);
    world.cut(1, 2);
    world.heal(0, 1);
    world.run_for(30_000);
    must(world.value(0, "team/a") == Some(2), "the deletion had not seen it")?;
    world.join_network(2);
    world.settle()
}

/// A store is set back. It loses none of its own transactions, but it loses a deletion that it had acknowledged.
pub(crate) fn set_back() -> Ending {
    let mut world = team(3);
    world.expect_forks();
    world.put(0, "team/a", 1);
    world.settle()?;
    let backup = world.backup(1);
    world.delete(0, "team/a");
    world.settle()?;
    world.run_for(30_000);
    must(world.siblings(0, "team/a") == 0, "nobody needs the deletion any more")?;
    world.restore(1, backup);
    world.isolate(1);
    world.restart(1);
    world.put(1, "team/a", 2);
    world.join_network(1);
    world.converge()?;
    let digests = [0, 1, 2].map(|node| world.replica(node).state().digest());
    must(digests == [digests[0]; 3], "I1: equal cuts, different states")?;
    must(world.value(0, "team/a") == Some(2), "what it wrote had not seen the deletion, which nobody knows any more")
}

/// A store is set back, and its robot uses a number twice before it receives any message.
pub(crate) fn fork() -> Ending {
    let mut world = team(2);
    world.expect_forks();
    let (backup, origin) = (world.backup(1), world.replica(1).origin());
    world.put(1, "team/a", 1);
    world.put(1, "team/a", 3);
    world.settle()?;
    world.restore(1, backup);
    world.isolate(1);
    world.restart(1);
    world.join_network(1);
    world.put(1, "team/b", 2);
    world.run_for(200);
    must(world.alarms.contains(&(0, Alarm::Fork(origin))), "T6: a number was used twice, and no alarm says so")?;
    world.settle()?;
    must(world.value(0, "team/a") == Some(3) && world.value(0, "team/b") == Some(2), "I5: both are kept")
}

/// A store is set back, and its robot writes more than before, before it receives any message. A robot that had seen
/// the first writes has overwritten them. This must not overwrite any of the second writes.
pub(crate) fn two_writes() -> Ending {
    let mut world = team(3);
    world.expect_forks();
    let backup = world.backup(1);
    world.put(1, "team/x", 1);
    world.settle()?;
    world.put(2, "team/a", 2);
    world.put(2, "team/b", 2);
    world.settle()?;
    world.restore(1, backup);
    world.isolate(1);
    world.restart(1);
    ["team/a", "team/b", "team/y"].into_iter().for_each(|key| world.put(1, key, 7));
    world.join_network(1);
    world.settle()?;
    for key in ["team/a", "team/b"] {
        must(
            world.siblings(0, key) == 2,
            &format!("I5: what was acknowledged at {key} was overwritten by who never saw it"),
        )?;
    }
    must(world.value(0, "team/x") == Some(1) && world.value(0, "team/y") == Some(7), "I5: all is kept")
}

/// Two robots of a retired side have the same writes. The first one comes back with them, and others overwrite and
/// delete them. Then the second one comes back: nothing returns with it.
pub(crate) fn two_returns() -> Ending {
    let mut world = team(3);
    world.cut(0, 1);
    world.cut(0, 2);
    world.put(1, "team/a", 1);
    world.put(1, "team/b", 1);
    world.run_for(20_000);
    world.retire(0, 1);
    world.retire(0, 2);
    world.run_for(30_000);
    world.isolate(2);
    world.heal(0, 1);
    world.run_for(60_000);
    must(world.value(0, "team/a") == Some(1) && world.value(0, "team/b") == Some(1), "the first comes back with them")?;
    world.delete(0, "team/a");
    world.put(0, "team/b", 2);
    world.run_for(30_000);
    world.join_network(2);
    world.settle()?;
    must(world.value(0, "team/a").is_none(), "I2: the deletion had seen what the second brings back")?;
    must(world.siblings(0, "team/b") == 1, "I2: the value had seen what the second brings back")
}

/// A store is set back, and its robot uses a number again, for another write that only one robot gets. That robot meets
/// one that has written after seeing the first transaction of the number. This must not overwrite the other write.
pub(crate) fn seen_by_number() -> Ending {
    let mut world = team(4);
    world.expect_forks();
    world.isolate(3);
    let backup = world.backup(1);
    world.put(1, "team/x", 1);
    world.run_for(20_000);
    world.put(2, "team/a", 2);
    world.run_for(20_000);
    world.restore(1, backup);
    world.isolate(1);
    world.restart(1);
    world.put(1, "team/a", 7);
    world.heal(1, 3);
    world.run_for(20_000);
    must(world.value(3, "team/a") == Some(7) && world.siblings(3, "team/a") == 1, "one robot has the second write")?;
    world.crash(1);
    world.heal(0, 3);
    world.heal(2, 3);
    world.run_for(60_000);
    for node in [0, 2, 3] {
        must(world.siblings(node, "team/a") == 2, "I5: a write was overwritten by one that had not seen it")?;
    }
    world.restart(1);
    world.join_network(1);
    world.join_network(3);
    world.settle()?;
    for node in 0..4 {
        must(world.siblings(node, "team/a") == 2, "I5: a write was overwritten by one that had not seen it")?;
        must(world.value(node, "team/x") == Some(1), "I5: a write was taken away by who had not seen it")?;
    }
    Ok(())
}

/// A robot that received no messages has founded a second team. Two such robots meet, and then meet a team with several
/// members.
pub(crate) fn second_team() -> Ending {
    let mut world = team(1);
    world.put(0, "team/a", 1);
    let second = world.found_apart("team/b", 2);
    world.settle()?;
    let third = world.found_apart("team/c", 3);
    world.settle()?;
    for node in [0, second, third] {
        let values = ["team/a", "team/b", "team/c"].map(|key| world.value(node, key));
        must(values == [Some(1), Some(2), Some(3)], "I6: what was written in a second team is gone")?;
        must(world.replica(node).members().active().count() == 3, "T7: two teams of one name stay two")?;
    }
    Ok(())
}

/// A store is set back, and its robot uses a number again and continues. Another robot has the first transaction of
/// that number, and knows of the second one. It is then given the state of a robot on the second branch, whose log is
/// too short to show this.
pub(crate) fn other_branch() -> Ending {
    let mut world = team(3);
    world.expect_forks();
    world.isolate(2);
    let (backup, origin) = (world.backup(1), world.replica(1).origin());
    world.put(1, "team/a", 1);
    world.run_for(20_000);
    world.restore(1, backup);
    world.heal(1, 2);
    world.network.cut_one_way(0, 1);
    world.restart(1);
    world.put(1, "team/b", 2);
    world.run_for(200);
    must(world.alarms.contains(&(0, Alarm::Fork(origin))), "T6: a number was used twice, and no alarm says so")?;
    world.cut(0, 1);
    world.put(1, "team/c", 3);
    world.run_for(20_000);
    must(
        world.value(2, "team/b") == Some(2) && world.value(2, "team/c") == Some(3),
        "one robot has the second branch",
    )?;
    // The owner of the store starts again from that state, with a log that begins after the branch.
    world.crash(1);
    world.restart_copied(1);
    world.run_for(30_000);
    must(world.replica(1).is_member(), "T7: it is not admitted")?;
    world.crash(2);
    world.heal(0, 1);
    world.run_for(60_000);
    must(world.value(0, "team/c") == Some(3), "T7: they never meet")?;
    must(world.value(0, "team/a") == Some(1), "I5: the state of the other branch hides what was acknowledged")?;
    world.restart(2);
    world.join_network(2);
    world.settle()?;
    for node in 0..3 {
        let values = ["team/a", "team/b", "team/c"].map(|key| world.value(node, key));
        must(values == [Some(1), Some(2), Some(3)], "I5: both branches are kept")?;
    }
    Ok(())
}
