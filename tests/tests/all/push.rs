//! Doors that the robot has to push. They open without contact with jamb or leaf. A law that is told the wrong direction
//! reports it.

use dca_tests::survey::{Group, Mission, Outcome, Row, fly_all, rows, table};
use std::time::Duration;

const DOOR: &str = include_str!("../../../specs/door_opening.dca");
const LIMIT: Duration = Duration::from_secs(90);

fn mission(arguments: &str, told: Option<&'static str>) -> Mission {
    Mission { arguments: arguments.to_owned(), told, ..Mission::nominal() }
}

/// None of these doors opened before the hand turned around the handle: the forearm would have had to pass through the jamb.
#[test]
fn doors_to_push_open_with_base_and_arm_clear_of_leaf_and_jambs() {
    for world in
        ["side = \"left\", radius = 0.62 m", "side = \"right\", radius = 0.7 m", "side = \"right\", radius = 1.05 m"]
    {
        let mut touched = 0.0f64;
        let outcome = mission(&format!("seed = 5, swing = \"push\", {world}"), None)
            .fly_watched(DOOR, LIMIT, &mut |simulation| {
                touched = touched.max(simulation.signal("main/world", "collision force"));
            })
            .unwrap_or_else(|why| panic!("{why}"));
        assert!(outcome.is_strict() && outcome.wrong < 2.0, "{world}: {outcome:?}");
        assert!(touched <= 0.0, "{world}: {touched} N on base or arm");
    }
}

#[test]
fn doors_to_push_that_nobody_tuned_for_open() {
    let wanted = ["swing push", "push, moderate", "push, wide", "told to push"];
    let is_flown = |row: &Row| row.group == Group::Push && wanted.contains(&row.name.as_str());
    let rows: Vec<_> = rows(1, 3, &[]).into_iter().filter(is_flown).collect();
    let missions: Vec<Mission> = rows.iter().flat_map(|row| row.missions.clone()).collect();
    let outcomes = fly_all(&missions, (DOOR, LIMIT), 2, &|_| {}).unwrap_or_else(|why| panic!("{why}"));
    let mut outcomes = outcomes.into_iter();
    let flown: Vec<_> = rows
        .into_iter()
        .map(|row| {
            let own: Vec<_> = outcomes.by_ref().take(row.missions.len()).collect();
            (row, own)
        })
        .collect();
    let mut all = flown.iter().flat_map(|(_, outcomes)| outcomes);
    assert!(flown.len() == 4 && all.all(Outcome::is_strict), "{}", table::failures(&flown));
}

/// Each of these failed once: a strong lever slowly rose while the hand determined the direction of the door, and its latch
/// held the leaf.
const UNTUNED: [&str; 2] = [
    "seed = 58, side = \"right\", radius = 0.74 m, lever_torque = 1.3 Nm, lever_length = 0.085 m, latch_angle = 0.65 rad",
    "seed = 6, closer = 2.2 Nm, friction = 5 Nm, lever_torque = 1.4 Nm, latch_angle = 0.619 rad, stiffness = 3000 N/m",
];

#[test]
fn doors_with_strong_levers_are_pushed_gently() {
    let missions: Vec<_> = UNTUNED.iter().map(|world| mission(&format!("{world}, swing = \"push\""), None)).collect();
    let outcomes = fly_all(&missions, (DOOR, LIMIT), 2, &|_| {}).unwrap_or_else(|why| panic!("{why}"));
    for (world, outcome) in UNTUNED.iter().zip(outcomes) {
        assert!(outcome.is_strict(), "{world}: {outcome:?}");
    }
}

/// During the opening, the laser loses sight of the wall. So wheels that turned on the spot once made doors of 53 and 58
/// degrees look open.
#[test]
fn wheels_that_turn_on_the_spot_open_no_door() {
    let world = "seed = 940, swing = \"push\", radius = 0.746 m, base_slip_door = 0.892 rad, base_slip_for = 7.6 s";
    let outcome = mission(world, None).fly(DOOR, LIMIT).unwrap_or_else(|why| panic!("{why}"));
    assert!(!outcome.is_false() && outcome.reason().contains("the wheels have slipped"), "{outcome:?}");
}

#[test]
fn who_is_told_the_wrong_way_says_so() {
    let cases = [
        ("swing = \"push\"", "pull", "locked, or to be pushed"),
        ("swing = \"pull\"", "push", "locked, or to be pulled"),
        ("lock = \"locked\"", "either", "locked, or shut by more than 70 N: the lever is down"),
    ];
    for (world, told, why) in cases {
        let outcome = mission(&format!("seed = 5, {world}"), Some(told)).fly(DOOR, LIMIT);
        let outcome = outcome.unwrap_or_else(|why| panic!("{why}"));
        assert!(outcome.reason().contains(why), "{world}, told {told}: {outcome:?}");
        assert!(outcome.worst < 80.0 && outcome.angle.abs() < 1.0, "{world}, told {told}: {outcome:?}");
    }
}
