use super::*;
use crate::logic::clock::{Quality, Wall};
use crate::logic::log::Log;
use crate::logic::snapshot;
use crate::logic::txn::Draft;
use crate::logic::view::past::{Filter, Keys};
use crate::logic::view::tests::{MORNING, Robot, heal, key, play, steps};
use crate::logic::view::{date, table};
use expect_test::expect;
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_moment_is_shown_as_it_was(steps in steps(), keep in 0_usize..3000, from in any::<prop::sample::Index>()) {
        let mut team = Robot::team(3);
        let mut moments: Vec<Robot> = team.clone();
        play(&mut team, &steps, |robot| moments.push(robot.clone()));
        heal(&mut team);
        let last = team[0].clone();
        for moment in &moments {
            let shown = last.past().at(moment.log.vector(), None).unwrap();
            prop_assert_eq!(&shown, &moment.state);
            prop_assert_eq!(shown.digest(), moment.state.digest());
        }
        // The same from a base on: it has all transactions that are missing in the log.
        team[0].forget(keep);
        let low = team[0].log.low();
        let base = from.get(&moments);
        let base = Base { heads: base.log.heads().clone(), state: base.state.clone() };
        for later in &moments {
            match team[0].past().at(later.log.vector(), Some(&base)) {
                Ok(shown) => prop_assert_eq!(&shown, &later.state),
                Err(AsOfError::Compacted { .. }) => {
                    let reaches = base.vector().dominates(&low) && later.log.vector().dominates(&base.vector());
                    prop_assert!(!reaches && later.log.vector() != team[0].log.vector() && !low.is_empty());
                }
                Err(other) => prop_assert!(false, "{}", other),
            }
        }
    }

    #[test]
    fn a_difference_is_what_leads_from_one_to_the_other(steps in steps(), at in any::<prop::sample::Index>()) {
        let mut team = Robot::team(3);
        let mut moments: Vec<Robot> = team.clone();
        play(&mut team, &steps, |robot| moments.push(robot.clone()));
        heal(&mut team);
        let (before, after) = (&moments[at.index(moments.len())].state, &team[0].state);
        let shown = |state: &State| -> BTreeMap<Key, Datum> {
            let value = |(key, versions): (&Key, &[Version])| {
                Some((key.clone(), Datum::of(versions.last()?.value.as_ref()?)))
            };
            state.scan("").filter_map(value).collect()
        };
        let mut walked = shown(before);
        for difference in diff(before, after, "") {
            prop_assert_eq!(walked.get(&difference.key), difference.before.as_ref());
            match difference.after {
                Some(datum) => walked.insert(difference.key, datum),
                None => walked.remove(&difference.key),
            };
        }
        prop_assert_eq!(walked, shown(after));
        prop_assert_eq!(diff(after, after, ""), vec![]);
        let sent = after.scan("").map(|(key, versions)| (key.clone(), versions.to_vec()));
        prop_assert_eq!(state_of(sent).digest(), after.digest());
    }
}

#[test]
fn what_was_dropped_is_not_made_up() {
    let mut team = Robot::team(2);
    let early = team[0].vector();
    team[0].put("a", "team/a", "1");
    let mid = team[0].vector();
    team[0].put("b", "team/a", "2");
    let (manifest, chunks) = snapshot::take(&team[0].state, team[0].log.heads());
    let late = team[0].vector();
    team[0].forget(0);
    let past = team[0].past();
    assert_eq!(past.at(&mid, None), Err(AsOfError::Compacted { oldest: late.clone() }));
    assert_eq!(past.at(&late, None).unwrap(), team[0].state);
    let heads = manifest.heads.iter().cloned().collect();
    let base = Base { heads, state: manifest.assemble(&chunks).unwrap() };
    assert_eq!(past.at(&early, Some(&base)), Err(AsOfError::Compacted { oldest: late }));
    let ahead = team[1].past().at(&mid, None);
    expect![
        "this robot lacks some transactions that were seen at that moment (0000000000000001:2); ask again when they have arrived"
    ]
    .assert_eq(&ahead.unwrap_err().to_string());
}

#[test]
fn who_has_joined_can_look_back_to_that() {
    let mut team = Robot::team(1);
    let mut checkpoints = Checkpoints::default();
    checkpoints.note(&team[0].past());
    let before = team[0].vector();
    team[0].put("", "team/old", "1");
    team[0].forget(0);
    checkpoints.note(&team[0].past());
    let mut moments = vec![team[0].clone()];
    for number in 0..20 * CHECKPOINT_PERIOD as u64 {
        team[0].put("", &format!("team/{}", number % 7), &number.to_string());
        checkpoints.note(&team[0].past());
        if number % 1000 == 0 {
            moments.push(team[0].clone());
        }
    }
    let look = |robot: &Robot, checkpoints: &Checkpoints, vector: &VersionVector| {
        robot.past().at(vector, checkpoints.before(vector))
    };
    for moment in &moments {
        assert_eq!(look(&team[0], &checkpoints, moment.log.vector()).unwrap().digest(), moment.state.digest());
    }
    let oldest = moments[0].vector();
    assert_eq!(look(&team[0], &checkpoints, &before), Err(AsOfError::Compacted { oldest }));
    assert!((2..=CHECKPOINTS_MAX).contains(&checkpoints.0.len()));
    // With the dropped transactions, the oldest moment is lost. The next one can still be shown.
    let half = team[0].log.size() / 2;
    team[0].forget(half);
    checkpoints.note(&team[0].past());
    let reached = checkpoints.oldest().unwrap().vector();
    for moment in &moments {
        let shown = look(&team[0], &checkpoints, moment.log.vector());
        assert_eq!(shown.is_ok(), moment.log.vector().dominates(&reached));
    }
    assert!(look(&team[0], &checkpoints, moments[15].log.vector()).is_ok());
}

#[test]
fn the_first_that_the_log_drops_takes_only_itself() {
    let mut robot = Robot::team(1).remove(0);
    let mut checkpoints = Checkpoints::default();
    let mut moments = Vec::new();
    for number in 0..3000 {
        robot.put("", "team/a", &number.to_string());
        checkpoints.note(&robot.past());
        moments.push(robot.vector());
    }
    let whole = robot.log.len();
    robot.forget(robot.log.size() - 1);
    checkpoints.note(&robot.past());
    assert_eq!(robot.log.len(), whole - 1);
    let shown = |moment: &VersionVector| robot.past().at(moment, checkpoints.before(moment)).is_ok();
    assert!(moments.iter().step_by(100).all(shown));
}

#[test]
fn one_clock_in_2099_does_not_end_dates() {
    let mut team = Robot::team(2);
    let (mut checkpoints, right) = (Checkpoints::default(), team[0].wall);
    let before = team[0].vector();
    team[1].wall.millis = 4_070_908_800_000;
    team[1].put("a clock in 2099", "team/b", "1");
    heal(&mut team);
    // The log is rewritten afterwards; nothing was written since.
    team[0].wall = right;
    team[0].forget(0);
    checkpoints.note(&team[0].past());
    let late = |team: &[Robot]| team[0].past().vector_at(MORNING + 3_600_000, "", checkpoints.oldest());
    assert_eq!(late(&team), Err(AsOfError::Compacted { oldest: team[0].vector() }));
    team[0].put("in order, and seen", "team/a", "1");
    let seen = team[0].vector();
    team[1].put("in 2099, and not seen", "team/b", "2");
    heal(&mut team);
    assert_eq!(late(&team), Ok(seen));
    let early = team[0].past().vector_at(MORNING, "", checkpoints.oldest());
    assert!(matches!(early, Err(AsOfError::Compacted { oldest }) if oldest.dominates(&before)));
}

#[test]
fn a_date_is_a_cut() {
    let mut team = Robot::team(2);
    team[0].put("at 10:00:02", "team/a", "1");
    team[1].wall = Wall { millis: 5000, quality: Quality::Unset };
    team[1].put("in 1970", "team/b", "1");
    team[0].put("at 10:00:03", "team/a", "2");
    heal(&mut team);
    team[0].wall.millis = MORNING + 10_000;
    team[0].put("at 10:00:11", "team/a", "3");
    let past = team[0].past();
    let at = |seconds: u64| -> Result<_, AsOfError> {
        let state = past.at(&past.vector_at(MORNING + 1000 * seconds, "", None)?, None)?;
        let read = |text: &str| state.get(&key(text)).map(|v| Datum::of(v.value.as_ref().unwrap()).to_toml());
        Ok((read("team/a"), read("team/b")))
    };
    let one = || Some("1".to_owned());
    assert_eq!(at(0), Ok((None, None)), "it was not before the last date that was seen there");
    let refused = at(2).unwrap_err();
    assert_eq!(refused, at(10).unwrap_err(), "it may have been then, or not");
    expect!["the state at that date is not known: 1 of the requested changes have no date, since their robot's clock was not set (the first is 0000000000000002:1, by `r2`); ask for a later date, or for a version as `dca db version` prints it"].assert_eq(&refused.to_string());
    assert_eq!(at(11), Ok((Some("3".into()), one())), "whoever wrote at that date had seen it");
    let of_a = past.vector_at(MORNING + 2000, "team/a", None).unwrap();
    assert_eq!(of_a.to_string(), "0000000000000001:2", "other keys are not its business");
}

#[test]
fn a_clock_that_nobody_keeps_tells_dates_all_the_same() {
    let mut team = Robot::team(2);
    for (robot, quality) in team.iter_mut().zip([Quality::Battery, Quality::Unset]) {
        // So did robots whose system clock was right, but not synchronised by systemd.
        (robot.log, robot.state, robot.wall.quality) = Default::default();
        robot.wall.quality = quality;
    }
    team[0].put("at 10:00:02", "team/a", "1");
    team[0].put("at 10:00:03", "team/a", "2");
    let first = team[0].clone();
    team[1].pull(&first);
    team[1].put("at 10:00:04", "team/a", "3");
    assert!(team[1].log.last_stamp().millis() < 10, "stamps go on from nothing");
    let past = team[1].past();
    let history = past.history(&Filter::new(Keys::Only(key("team/a")), 9));
    expect![[r#"
        WHEN (UTC)            BY                VALUE  WHY          TRANSACTION
        ~2026-11-21 10:00:02  0000000000000001  1      at 10:00:02  0000000000000001:1
        ~2026-11-21 10:00:03  0000000000000001  2      at 10:00:03  0000000000000001:2
        ~2026-11-21 10:00:04  0000000000000002  3      at 10:00:04  0000000000000002:1"#]]
    .assert_eq(&table::history(&history, table::Span::Key, &Datum::to_toml, date::utc));
    let shown = |seconds: u64| {
        let state = past.at(&past.vector_at(MORNING + 1000 * seconds, "", None).unwrap(), None).unwrap();
        state.get(&key("team/a")).map(|v| Datum::of(v.value.as_ref().unwrap()).to_toml())
    };
    assert_eq!([1, 2, 3, 4].map(shown), [None, Some("1".into()), Some("2".into()), Some("3".into())]);
}

#[test]
fn without_any_date_no_question_by_date_is_answered() {
    let mut robot = Robot { log: Log::default(), state: State::default(), ..Robot::team(1).remove(0) };
    robot.wall = Wall { millis: 5000, quality: Quality::Unset };
    robot.put("", "team/a", "1");
    let past = robot.past();
    let history = past.history(&Filter { from: Some(MORNING), ..Filter::new(Keys::Below(String::new()), 9) });
    expect![[r#"
        WHEN (UTC)  BY                VALUE  WHY  TRANSACTION
        no date     0000000000000001  1           0000000000000001:1"#]]
    .assert_eq(&table::history(&history, table::Span::Key, &Datum::to_toml, date::utc));
    for date in [5000, 6000, MORNING] {
        assert!(matches!(past.vector_at(date, "", None), Err(AsOfError::Undated { count: 1, .. })), "{date}");
    }
    // Once the log is cut, its remaining part does not show more.
    let base = Base { heads: robot.log.heads().clone(), state: robot.state.clone() };
    robot.forget(0);
    let vector = robot.past().vector_at(MORNING, "", Some(&base));
    assert_eq!(vector, Err(AsOfError::Compacted { oldest: robot.vector() }));
}

#[test]
fn what_has_changed() {
    let mut team = Robot::team(2);
    team[0].commit(Draft::new("").put(key("team/same"), b"x").put(key("team/old"), b"x").put(key("team/gain"), b"1"));
    let before = team[0].clone();
    team[1].pull(&before);
    team[0].commit(Draft::new("").delete(key("team/old")).put(key("team/same"), b"x"));
    team[0].put("", "team/new", "[1, 2.5]");
    team[0].put("", "team/gain", "1");
    team[1].put("", "team/gain", "2");
    heal(&mut team);
    expect![[r#"
        ~ team/gain  {"$bytes" = "31"} → 1  ! 2 concurrent writes
        + team/new   [1, 2.5]
        - team/old   {"$bytes" = "78"}"#]]
    .assert_eq(&table::differences(&diff(&before.state, &team[0].state, "team/"), &Datum::to_toml));
}

#[test]
fn two_robots_are_compared_by_the_names_behind_their_prefixes() {
    let mut team = Robot::team(1);
    for (name, value) in [
        ("robot/r2/same", "1"),
        ("robot/r3/same", "1"),
        ("robot/r2/gain", "1.5"),
        ("robot/r3/gain", "2.0"),
        ("robot/r2/only", "true"),
        ("robot/r3/new", "4"),
        ("robot/r31/x", "5"),
    ] {
        team[0].put("", name, value);
    }
    expect![[r#"
        ~ robot/r3/gain  1.5 → 2.0
        + robot/r3/new   4
        - robot/r3/only  true"#]]
    .assert_eq(&table::differences(&compare(&team[0].state, "robot/r2/", "robot/r3/"), &Datum::to_toml));
    assert_eq!(compare(&team[0].state, "robot/r2/", "robot/r2/"), []);
}
