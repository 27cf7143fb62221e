use super::*;
use crate::logic::txn::Draft;
use crate::logic::view::tests::{Robot, heal, key, toml};
use crate::logic::view::{date, table};
use expect_test::expect;

#[test]
fn both_values_who_and_why() {
    let mut team = Robot::team(2);
    team[0].put("brighter", "team/gain", "1.5");
    team[1].commit(Draft::new("not used any more").delete(key("team/gain")));
    heal(&mut team);
    let conflicts = team[0].past().conflicts("team/");
    assert_eq!(conflicts, team[1].past().conflicts("team/"));
    expect![[r#"
        team/gain: 2 writes did not see each other (--seen 39158c935eeb)
          1.5               r1  2026-11-21 10:00:02Z  0000000000000001:2  brighter
          (deleted)  shown  r2  2026-11-21 10:00:02Z  0000000000000002:1  not used any more"#]]
    .assert_eq(&table::conflicts(&conflicts, &[], &Datum::to_toml, date::utc));
    team[0].forget(0);
    assert_eq!(team[0].past().conflicts("team/")[0].versions[0].reason, None, "the log does not reach back");
    team[1].put("keep it", "team/gain", "1.5");
    assert_eq!(team[1].past().conflicts(""), vec![]);
}

/// Returns a write under a condition.
fn relying(on: &str, condition: Condition, write: &str, value: &str) -> Draft {
    Draft::new("relies").require(key(on), condition).put(key(write), toml(value).encode().unwrap())
}

#[test]
fn require_absent_both_create() {
    let mut team = Robot::team(2);
    team[0].commit(relying("team/leader", Condition::Absent, "team/leader", "\"r1\""));
    team[1].commit(relying("team/leader", Condition::Absent, "team/leader", "\"r2\""));
    heal(&mut team);
    let past = team[0].past();
    assert_eq!((past.conflicts("").len(), past.races("").len(), past.races("robot/").len()), (1, 1, 0));
    expect![[r#"
        team/leader: 2 writes did not see each other (--seen 39158c935eeb)
          "r1"         r1  2026-11-21 10:00:02Z  0000000000000001:2  relies
          "r2"  shown  r2  2026-11-21 10:00:02Z  0000000000000002:1  relies

        team/leader: r2 relied on there being nothing, unaware of a change (--seen 39158c935eeb)
          relied on it    r2  2026-11-21 10:00:02Z  0000000000000002:1  relies
          had changed it  r1  2026-11-21 10:00:02Z  0000000000000001:2  relies"#]]
    .assert_eq(&table::conflicts(&past.conflicts(""), &past.races(""), &Datum::to_toml, date::utc));
    assert_eq!(team[1].past().races(""), past.races(""));
    team[0].put("r1 it is", "team/leader", "\"r1\"");
    assert_eq!(team[0].past().races(""), vec![]);
}

#[test]
fn cas_same_key_both_sides() {
    let mut team = Robot::team(3);
    let first = team[0].put("", "team/n", "1");
    heal(&mut team);
    team[0].commit(relying("team/n", Condition::Is(first), "team/n", "2"));
    team[1].commit(relying("team/n", Condition::Is(first), "team/n", "3"));
    heal(&mut team);
    assert_eq!(team[2].past().races("").len(), 1, "one update would be lost");
    team[2].put("both were seen", "team/n", "4");
    heal(&mut team);
    assert!(team.iter().all(|robot| robot.past().races("").is_empty()));
}

#[test]
fn write_skew_shows_although_no_key_is_in_conflict() {
    let mut team = Robot::team(2);
    team[0].commit(Draft::new("").put(key("team/a"), b"1").put(key("team/b"), b"1"));
    heal(&mut team);
    team[0].commit(Draft::new("b is there").require(key("team/b"), Condition::Exists).delete(key("team/a")));
    team[1].commit(Draft::new("a is there").require(key("team/a"), Condition::Exists).delete(key("team/b")));
    heal(&mut team);
    let past = team[0].past();
    assert_eq!((past.conflicts("").len(), past.races("").len()), (0, 1));
    assert_eq!((past.races("")[0].relied.by.as_str(), past.races("")[0].changed.by.as_str()), ("r2", "r1"));
}

#[test]
fn who_relied_on_what_stayed_so_raced_nobody() {
    let mut team = Robot::team(2);
    team[0].put("", "team/a", "1");
    heal(&mut team);
    team[0].put("still there", "team/a", "2");
    team[1].commit(relying("team/a", Condition::Exists, "team/b", "1"));
    heal(&mut team);
    assert_eq!(team[0].past().races(""), vec![]);
}

/// Two robots that are cut off from each other rely on one key. The list has one line with the count, for any number of pairs, and
/// one write resolves all of them.
#[test]
fn a_key_has_one_line_whatever_the_number_of_races() {
    let mut team = Robot::team(2);
    let first = team[0].put("", "team/n", "0");
    heal(&mut team);
    let mut last = [first, first];
    for number in 1..=60 {
        for robot in [0, 1] {
            let value = (number * 2 + robot).to_string();
            last[robot] = team[robot].commit(relying("team/n", Condition::Is(last[robot]), "team/n", &value));
        }
    }
    heal(&mut team);
    let races = team[0].past().races("");
    assert_eq!((races.len(), &races), (1, &team[1].past().races("")), "1,830 pairs");
    assert!((60..=120).contains(&races[0].count), "{races:?}");
    let told = table::conflicts(&[], &races, &Datum::to_toml, date::utc);
    assert!(told.contains(&format!("more transactions (--seen {})", races[0].seen)), "{told}");
    team[1].put("both were seen", "team/n", "200");
    heal(&mut team);
    assert!(team.iter().all(|robot| robot.past().races("").is_empty()));
}

/// More keys than once were listed.
#[test]
fn no_key_is_left_out() {
    let mut team = Robot::team(2);
    for robot in [0, 1] {
        for number in 0..1100 {
            let key = format!("team/leader/{number}");
            team[robot].commit(relying(&key, Condition::Absent, &key, "1"));
        }
    }
    heal(&mut team);
    assert_eq!(team[0].past().races("").len(), 1100);
}
