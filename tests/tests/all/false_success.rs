//! The door mission never ends with success while the door is shut: a small part of the door survey, with every trigger.

use controllers::sdk::harness::Disturbance;
use dca_tests::simulation::Finish;
use dca_tests::survey::{Disruption, Group, Meddling, Mission, Outcome, Row, active_in_phases, fly_all, rows, table};
use std::time::Duration;

const DOOR: &str = include_str!("../../../specs/door_opening.dca");
/// The largest error of the angle (deg). A sweep is 50 ms old, and a door may turn by 10 degrees a second.
const WRONG_MAX: f64 = 2.0;
/// Rows whose world deceives the laser: half of the leaf has no echo, a wall stands beside the leaf, or a push turns the base.
/// In these worlds, the end depends on the path of the hand and on the estimate of the hinge.
const DECEIVED: [&str; 3] = ["half without echo", "side wall by the latch", "the base is turned from outside"];
const LIMIT: Duration = Duration::from_secs(90);
/// The greatest force in any run, whatever fails (N).
const FORCE_MAX: f64 = 100.0;
const RECOVERY: &str = include_str!("../../../specs/door_recovery.dca");

fn fly(text: &str, rows: Vec<Row>) -> Vec<(Row, Vec<Outcome>)> {
    let missions: Vec<Mission> = rows.iter().flat_map(|row| row.missions.clone()).collect();
    let outcomes = fly_all(&missions, (text, LIMIT), 2, &|_| {}).unwrap_or_else(|why| panic!("{why}"));
    let mut outcomes = outcomes.into_iter();
    rows.into_iter()
        .map(|row| {
            let own = outcomes.by_ref().take(row.missions.len()).collect();
            (row, own)
        })
        .collect()
}

/// One world of each kind in which something fails. Of the worlds with a killed or restarted program, it takes only every
/// fifth.
#[test]
fn a_mission_of_each_kind_does_not_end_well_with_the_door_shut() {
    let mut meddled = 0;
    check_survey(1, |row| {
        let is_meddled = row.missions.iter().any(|mission| mission.meddling.is_some());
        meddled += usize::from(is_meddled);
        !is_meddled || meddled % 5 == 1
    });
}

#[test]
#[ignore = "long: three worlds of each row of the survey"]
fn no_mission_ends_well_with_the_door_shut() {
    check_survey(3, |_| true);
}

fn check_survey(worlds: u32, mut chosen: impl FnMut(&Row) -> bool) {
    let phases = active_in_phases(DOOR, LIMIT).unwrap_or_else(|why| panic!("{why}"));
    assert!(phases.iter().all(|phase| !phase.active.is_empty()), "a phase was not met: {phases:?}");
    let is_flown = |row: &Row| row.group != Group::Single || ["nominal", "swing push"].contains(&row.name.as_str());
    let rows = rows(worlds, 1, &phases).into_iter().filter(is_flown).filter(|row| chosen(row));
    let flown = fly(DOOR, rows.collect());
    let (text, failures) = (table::text(&flown), table::failures(&flown));
    let is_false = flown.iter().flat_map(|(_, outcomes)| outcomes).any(Outcome::is_false);
    assert!(!is_false, "{text}\n{failures}");
    let worst = flown.iter().flat_map(|(_, outcomes)| outcomes).map(|outcome| outcome.worst).fold(0.0, f64::max);
    assert!(worst <= FORCE_MAX, "{worst:.0} N\n{text}\n{failures}");
    let named = |name: &str| {
        let row = flown.iter().find(|(row, _)| row.name == name);
        &row.unwrap_or_else(|| panic!("there is no row `{name}`")).1
    };
    // Slipping wheels disturb the estimate of the hinge, but not the angle that the laser sees.
    let slipped =
        || flown.iter().filter(|(row, _)| row.name.starts_with("base slips")).flat_map(|(_, outcomes)| outcomes);
    let done = slipped().filter(|outcome| outcome.finish == Finish::Done).count();
    assert!(done > 0, "{text}\n{failures}");
    let is_wrong = |outcome: &Outcome| outcome.finish == Finish::Done && outcome.wrong > WRONG_MAX;
    let wrong = |(row, outcomes): &(Row, Vec<Outcome>)| {
        let wrong = outcomes.iter().filter(|outcome| is_wrong(outcome)).map(|outcome| outcome.wrong);
        wrong.reduce(f64::max).map(|wrong| format!("{}: the laser was wrong by {wrong:.1} deg", row.name))
    };
    let wrong: Vec<String> =
        flown.iter().filter(|(row, _)| !DECEIVED.contains(&row.name.as_str())).filter_map(wrong).collect();
    assert!(wrong.is_empty(), "{}\n{text}\n{failures}", wrong.join("\n"));
    // The mission does not simply refuse everything: the nominal world is strict, and a lost handle is reported.
    assert!(named("nominal").iter().all(Outcome::is_strict), "{text}\n{failures}");
    let told = |outcome: &Outcome| outcome.reason().contains("lost the handle");
    assert!(named("handle lost").iter().all(told), "{text}\n{failures}");
}

/// Doors and networks for which the laws were not tuned. Each of them failed once. `swing push` is not among them: the hand
/// stays square to the leaf, so the forearm would have to pass through the jamb.
const UNTUNED: [&str; 11] = [
    "side right",
    "lever_length",
    "latch_angle",
    "lever_standoff",
    "touch_stiffness",
    "force_bias",
    "camera_turn",
    "20 ms a hop",
    "5-30 ms a hop",
    "50 ms a hop",
    "5-50 ms a hop",
];

#[test]
fn doors_that_nobody_tuned_for_open_gently() {
    check_untuned(1);
}

#[test]
#[ignore = "long: three worlds of each"]
fn more_doors_that_nobody_tuned_for_open_gently() {
    check_untuned(3);
}

fn check_untuned(worlds: u32) {
    let flown =
        fly(DOOR, rows(worlds, 2, &[]).into_iter().filter(|row| UNTUNED.contains(&row.name.as_str())).collect());
    assert_eq!(flown.len(), UNTUNED.len());
    let is_strict = flown.iter().flat_map(|(_, outcomes)| outcomes).all(Outcome::is_strict);
    assert!(is_strict, "{}\n{}", table::text(&flown), table::failures(&flown));
}

/// All parameters are far from the design values at the same time: noise is three times as large, grasps are eight times as
/// stiff, and closers need 60 N. Before noise and stiffness were measured, 37 of 48 doors opened, 24 of them gently.
#[test]
#[ignore = "long: a share of 20 worlds"]
fn wide_worlds_open() {
    let flown = fly(DOOR, rows(20, 11, &[]).into_iter().filter(|row| row.label() == "wide").collect());
    let (text, failures) = (table::text(&flown), table::failures(&flown));
    let outcomes = || flown.iter().flat_map(|(_, outcomes)| outcomes);
    let open = outcomes().filter(|outcome| outcome.is_success()).count();
    assert!(open * 100 >= outcomes().count() * 85, "{text}\n{failures}");
    assert!(!outcomes().any(|outcome| outcome.is_false() || outcome.worst > FORCE_MAX), "{text}\n{failures}");
}

/// A restarted `model` at 33 degrees once mistook the leaf for the wall, and continued to 120 degrees and 333 N.
#[test]
fn who_is_started_again_in_the_opening_sees_how_far_it_is() {
    for after in [5.2, 6.4, 8.0].map(Duration::from_secs_f64) {
        let (leaf, disruption) = ("/dooropen/model".to_owned(), Disruption::Restart);
        let meddling = Some(Meddling { leaf, phase: "/dooropen/", after, disruption });
        let arguments = "seed = 70005".to_owned();
        let mission = Mission { arguments, meddling, ..Mission::nominal() };
        let outcome = mission.fly(DOOR, LIMIT).unwrap_or_else(|why| panic!("{why}"));
        assert!(outcome.is_strict() && outcome.angle < 80.0 && outcome.worst < 60.0, "{after:?}: {outcome:?}");
    }
}

/// From 58 degrees on, wheels turned on the spot for 7 to 11 s while the laser did not see the wall. This made three of these
/// doors look open at 58.4 and 59.3 degrees. At that time the base turned. Now the base is steady, and the hand feels that the
/// hinge is elsewhere.
#[test]
fn wheels_that_spin_shortly_before_the_end_open_no_door() {
    check_spins(1);
}

#[test]
#[ignore = "long: 40 worlds"]
fn wheels_that_spin_shortly_before_the_end_open_none_of_many_doors() {
    check_spins(10);
}

fn check_spins(worlds: u32) {
    let rows = rows(worlds, 3, &[]).into_iter().filter(|row| row.name == "base spins at the end").collect();
    let flown = fly(DOOR, rows);
    let (text, failures) = (table::text(&flown), table::failures(&flown));
    let outcomes: Vec<&Outcome> = flown.iter().flat_map(|(_, outcomes)| outcomes).collect();
    let is_bad = |outcome: &&Outcome| outcome.is_false() || outcome.worst > FORCE_MAX;
    assert!(outcomes.len() == 4 * worlds as usize && !outcomes.iter().any(is_bad), "{text}\n{failures}");
    let told = outcomes.iter().filter(|outcome| outcome.reason().contains("the wheels have slipped")).count();
    assert!(told > worlds as usize, "{text}\n{failures}");
}

/// Sliding wheels turn the base without turning themselves. Before this had a bound, this mission ended with success at 61.9
/// degrees, 8 degrees short.
#[test]
fn wheels_that_slide_open_no_door() {
    for (closer, traction) in [(20, 60), (25, 80), (15, 50)] {
        let world = format!("seed = 5, swing = \"push\", closer = {closer} Nm, traction = {traction} N");
        let mission = Mission { arguments: world.clone(), ..Mission::nominal() };
        let outcome = mission.fly(DOOR, LIMIT).unwrap_or_else(|why| panic!("{why}"));
        let is_told = outcome.reason().contains("the wheels have slipped");
        assert!(outcome.worst < 60.0 && (is_told || outcome.angle > 66.0), "{world}: {outcome:?}");
    }
}

/// The law ended with these doors open at 68 degrees. With a stiff grasp, the arm then swung as it came to rest, up to the 78
/// N at which the lever slips out. So the mission once ended with success while the door was shut.
#[test]
fn an_arm_that_comes_to_rest_keeps_a_stiff_grasp() {
    for (seed, number) in [(9107, 3), (9109, 1)] {
        let row = rows(4, seed, &[]).into_iter().find(|row| row.label() == "wide");
        let mission = row.and_then(|row| row.missions.get(number - 1).cloned());
        let mission = mission.unwrap_or_else(|| panic!("{seed}: there is no mission {number}"));
        let outcome = mission.fly(DOOR, LIMIT).unwrap_or_else(|why| panic!("{why}"));
        assert!(outcome.is_strict() && outcome.worst < 60.0, "{seed}: {outcome:?}");
    }
}

/// A visitor pushes the hand more and more, and the lever slips out shortly before the end of the mission. By then, the law
/// had reported the door as open. The closer shut the door before the arm had come to rest.
#[test]
fn a_lever_that_slips_out_before_the_end_of_the_mission_is_lost() {
    let mut lost = 0;
    for step in 0..10 {
        let at = 35.6 + 0.2 * f64::from(step);
        let visitor = format!("push_at = {at:.2} s, push = 200 N");
        let arguments = format!("seed = 3, closer = 20 Nm, slip_force = 40 N, {visitor}");
        let mission = Mission { arguments, ..Mission::nominal() };
        let outcome = mission.fly(DOOR, LIMIT).unwrap_or_else(|why| panic!("{why}"));
        assert!(!outcome.is_false(), "{at} s: {outcome:?}");
        lost += u32::from(outcome.reason().contains("lost the handle"));
    }
    assert!(lost > 6, "{lost}");
}

/// Each sensor fails at 67 degrees, before it is known whether the door stays open.
#[test]
fn a_sensor_that_fails_at_the_end_opens_no_door() {
    for sensor in ["arm", "base", "force", "gripper", "laser"] {
        for how in ["silent", "repeats", "restamps"] {
            let fails = format!("fails = \"{sensor}\", fails_how = \"{how}\", fails_door = 67 deg, fails_for = 60 s");
            let mission = Mission { arguments: format!("seed = 3, {fails}"), ..Mission::nominal() };
            let outcome = mission.fly(DOOR, LIMIT).unwrap_or_else(|why| panic!("{why}"));
            assert!(!outcome.is_false() && outcome.worst < FORCE_MAX, "{fails}: {outcome:?}");
        }
    }
}

/// With a sensor that is 23 N wrong after it was set to zero, the laws once pulled with 105 N.
#[test]
fn a_force_sensor_that_is_not_at_zero_is_refused() {
    let mission = Mission { arguments: "seed = 1, force_bias = 20 N".to_owned(), ..Mission::nominal() };
    let outcome = mission.fly(DOOR, LIMIT).unwrap_or_else(|why| panic!("{why}"));
    assert!(outcome.reason().contains("the force sensor is not at zero") && outcome.worst < 1.0, "{outcome:?}");
}

#[test]
fn a_force_loop_that_is_too_slow_is_refused() {
    for transfer in [70, 80].map(Duration::from_millis) {
        let disturbance = Disturbance { transfer, ..Disturbance::NONE };
        let mission = Mission { disturbance, ..Mission::nominal() };
        let outcome = mission.fly(DOOR, LIMIT).unwrap_or_else(|why| panic!("{why}"));
        let told = ["the force loop is too slow", "inputs are too old"];
        assert!(told.iter().any(|why| outcome.reason().contains(why)), "{transfer:?}: {outcome:?}");
        assert!(outcome.worst < 100.0, "{transfer:?}: {outcome:?}");
    }
}

#[test]
#[ignore = "long: each controller in each phase"]
fn with_recovery_the_door_opens_whoever_is_killed() {
    let phases = active_in_phases(RECOVERY, LIMIT).unwrap_or_else(|why| panic!("{why}"));
    let is_kill = |row: &Row| row.name.starts_with("killed") || row.name == "base slips in the press";
    let flown = fly(RECOVERY, rows(1, 1, &phases).into_iter().filter(is_kill).collect());
    let outcomes = || flown.iter().flat_map(|(_, outcomes)| outcomes);
    let open = outcomes().filter(|outcome| outcome.is_success()).count();
    let (text, failures) = (table::text(&flown), table::failures(&flown));
    assert!(flown.len() > phases.len() && open * 10 >= outcomes().count() * 9, "{text}\n{failures}");
    assert!(!outcomes().any(Outcome::is_false), "{text}\n{failures}");
}
