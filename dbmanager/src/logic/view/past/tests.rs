use super::*;
use crate::logic::txn::Draft;
use crate::logic::view::tests::{Robot, heal, key, play, steps};
use crate::logic::view::{date, table};
use expect_test::expect;
use proptest::prelude::*;

fn of(at: &str) -> Filter {
    Filter::new(Keys::Only(key(at)), 100)
}

#[test]
fn the_history_of_a_key() {
    let mut team = Robot::team(2);
    team[0].put("first light", "team/gain", "1.0");
    let first = team[0].clone();
    team[1].pull(&first);
    team[0].commit(Draft::new("").put(key("team/gain"), b"x").put(key("team/other"), b"y"));
    team[1].wall = Wall { millis: 0, quality: Quality::Unset };
    team[1].commit(Draft::new("new lens").delete(key("team/gain")));
    heal(&mut team);
    let (left, right) = (team[0].past().history(&of("team/gain")), team[1].past().history(&of("team/gain")));
    expect![[r#"
        WHEN (UTC)            BY  VALUE              WHY          TRANSACTION
        2026-11-21 10:00:02   r1  1.0                first light  0000000000000001:2
        2026-11-21 10:00:03   r1  {"$bytes" = "78"}               0000000000000001:3  ! concurrent with r2's ~2026-11-21 10:00:02
        ~2026-11-21 10:00:02  r2  (deleted)          new lens     0000000000000002:1  ! concurrent with r1's 2026-11-21 10:00:03"#]].assert_eq(&table::history(&left, table::Span::Key, &Datum::to_toml, date::utc));
    let mut sorted = [left, right];
    sorted.iter_mut().for_each(|history| history.sort_by_key(|entry| entry.dot));
    assert_eq!(sorted[0], sorted[1], "every robot tells the same, in the order of its own");
}

#[test]
fn who_has_done_what() {
    let mut team = Robot::team(2);
    for number in 0..4 {
        team[number % 2].put(&format!("number {number}"), "team/a", &number.to_string());
    }
    heal(&mut team);
    let past = team[0].past();
    let all = Filter::new(Keys::Below(String::new()), 100);
    expect![[r#"
        WHEN (UTC)           BY  KEY                           VALUE  WHY             TRANSACTION
        2026-11-21 10:00:01  r1  sys/members/0000000000000001  "r1"   found the team  0000000000000001:1
                                 sys/members/0000000000000002  "r2"
        2026-11-21 10:00:02  r1  team/a                        0      number 0        0000000000000001:2  ! concurrent with r2's 2026-11-21 10:00:02, r2's 2026-11-21 10:00:03
        2026-11-21 10:00:03  r1  team/a                        2      number 2        0000000000000001:3  ! concurrent with r2's 2026-11-21 10:00:02, r2's 2026-11-21 10:00:03
        2026-11-21 10:00:02  r2  team/a                        1      number 1        0000000000000002:1  ! concurrent with r1's 2026-11-21 10:00:03, r1's 2026-11-21 10:00:02
        2026-11-21 10:00:03  r2  team/a                        3      number 3        0000000000000002:2  ! concurrent with r1's 2026-11-21 10:00:03, r1's 2026-11-21 10:00:02"#]].assert_eq(&table::history(&past.history(&all), table::Span::All, &Datum::to_toml, date::utc));
    assert_eq!(past.history(&Filter { limit: 2, ..all.clone() }), past.history(&all)[3..], "the last ones");
    let by = |robot: &str| past.history(&Filter { by: Some(robot.into()), ..all.clone() });
    assert_eq!(by("r2"), past.history(&all)[3..], "who is asked for does not change what is concurrent");
    let times: Vec<u64> = past.history(&all).iter().map(|entry| entry.when.millis).collect();
    let between = Filter { from: Some(times[1]), until: Some(times[2].max(times[1] + 1)), ..all };
    assert!(!past.history(&between).is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn beside_is_what_neither_has_seen(steps in steps(), forget in 0_usize..4000) {
        let mut team = Robot::team(3);
        play(&mut team, &steps, |_| ());
        heal(&mut team);
        // The context of each transaction, from a complete log.
        let mut contexts: BTreeMap<Dot, VersionVector> = BTreeMap::new();
        team[2].past().walk(&BTreeMap::new(), |txn, seen| {
            contexts.insert(txn.dot(), seen.clone());
        });
        team[2].forget(forget);
        let history = team[2].past().history(&of("team/k0"));
        for entry in &history {
            let concurrent = |other: &&HistoryEntry| {
                *other != entry && !contexts[&entry.dot].contains(other.dot) && !contexts[&other.dot].contains(entry.dot)
            };
            let mut expected: Vec<Dot> = history.iter().filter(concurrent).map(|other| other.dot).collect();
            let mut concurrent = entry.concurrent.clone();
            expected.sort();
            concurrent.sort();
            let named = concurrent.iter().filter(|dot| history.iter().any(|entry| entry.dot == **dot));
            prop_assert_eq!(named.copied().collect::<Vec<_>>(), expected);
        }
    }
}
