//! Numbers that were used twice: a disk was set back, and its robot continued to write.

use super::*;

impl Team {
    /// Sets the disk of a robot back to an earlier state, exactly, and starts the robot.
    fn set_back(&mut self, node: usize, disk: Records) {
        self.disks[node] = disk;
        self.replicas[node] = Replica::open(self.config(node), &self.disks[node]).unwrap();
    }

    fn values(&self, node: usize, name: &str) -> Vec<u8> {
        // Copies of one write have the same timestamp, and count as one.
        let value = |version: &Version| Some((version.stamp, version.value.as_ref()?.bytes[0]));
        let values: BTreeMap<Timestamp, u8> = self.versions(node, name).iter().filter_map(value).collect();
        let mut values: Vec<u8> = values.into_values().collect();
        values.sort_unstable();
        values
    }
}

/// Robot 1 has written; robot 2 has seen that, and has written as well. Then robot 1 is set back to its earlier state, and
/// writes three times.
fn used_twice(count: usize, away: &[usize]) -> Team {
    let mut team = Team::of(count);
    team.away = away.iter().copied().collect();
    let before = team.disks[1].clone();
    team.commit(1, put("team/x", b"1"));
    team.run(30);
    team.commit(2, put("team/a", b"2"));
    team.commit(2, put("team/b", b"2"));
    team.run(30);
    team.away.insert(1);
    team.set_back(1, before);
    for name in ["team/a", "team/b", "team/y"] {
        assert!(matches!(team.commit(1, put(name, b"7")), Answer::Committed(_)));
    }
    team
}

#[test]
fn what_was_written_under_numbers_used_before_is_not_overwritten_by_who_never_saw_it() {
    let mut team = used_twice(3, &[]);
    team.away.clear();
    let txns = team.replicas[2].log().in_order().into_iter().map(|(_, encoded)| encoded.clone()).collect();
    let (from, origin) = (team.replicas[2].origin(), team.replicas[1].origin());
    team.input(1, Input::Received(from, Message::Push(txns), WALL));
    assert_eq!(team.values(1, "team/a"), b"7", "the other one is not taken yet");
    team.run(120);
    for node in 0..3 {
        assert_eq!(team.values(node, "team/a"), b"27", "at {node}");
        assert_eq!((team.values(node, "team/b"), team.values(node, "team/y")), (b"27".to_vec(), b"7".to_vec()));
        assert_eq!(team.values(node, "team/x"), b"1");
    }
    assert!(team.alarms.iter().any(|(_, alarm)| *alarm == Alarm::Fork(origin)), "and it is told");
}

#[test]
fn two_branches_that_have_spread_are_brought_together_although_who_wrote_both_is_gone() {
    // Robots 0 and 3 receive only the second branch. Then its writer is lost for good.
    let mut team = used_twice(5, &[0, 3]);
    let others = |team: &mut Team, away: &[usize]| team.away = away.iter().copied().collect();
    others(&mut team, &[2, 4]);
    team.run(60);
    assert_eq!(team.values(0, "team/a"), b"7");
    team.commit(3, put("team/y", b"8"));
    team.run(20);
    others(&mut team, &[1]);
    team.run(300);
    for node in [0, 2, 3, 4] {
        assert_eq!(team.values(node, "team/a"), b"27", "at {node}");
        assert_eq!((team.values(node, "team/y"), team.values(node, "team/x")), (b"8".to_vec(), b"1".to_vec()));
        assert!(team.replicas[node].is_member(), "{node}");
    }
}
