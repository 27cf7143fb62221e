//! In whatever way the door mission fails, the arm ends at rest and releases its force. A hanging sensor does not move
//! anything for long. The tests run on virtual time, and the plant judges them.

use comms::logic::time::Time;
use controllers::sdk::harness::Disturbance;
use dca_tests::simulation::{Finish, Simulation, plan};
use std::time::Duration;

const DOOR: &str = include_str!("../../../specs/door_opening.dca");
const WORLD: &str = "main/world";
/// The place in the spec where the arguments of its world belong.
const PLACE: &str = "DoorWorld(\"c3\"";
const LIMIT: Duration = Duration::from_secs(120);
/// The greatest remaining force (N). A sensor that was set to zero measures it with an error of a few newtons.
const LEFT_MAX: f64 = 8.0;
/// In no run (N).
const FORCE_MAX: f64 = 100.0;

/// The end of a mission, as the plant knows it.
#[derive(Debug)]
struct End {
    why: String,
    /// The force on the hand (N).
    force: f64,
    worst: f64,
    /// The largest speed of the joints (rad/s) and the base (m/s, rad/s).
    fastest: f64,
    angle: f64,
}

/// Flies the spec in this world, and calls `meddle` every 4 ms.
fn fly(spec: &str, world: &str, meddle: &mut dyn FnMut(&mut Simulation)) -> End {
    let text = spec.replace(PLACE, &format!("{PLACE}, {world}"));
    let plan = plan("at_rest.dca", &text).unwrap_or_else(|why| panic!("{why}"));
    let mut simulation = Simulation::new(plan, Disturbance::NONE).unwrap_or_else(|why| panic!("{why}"));
    let why = match simulation.run(Time::ZERO + LIMIT, meddle) {
        Finish::Aborted(why) => why,
        Finish::Done => "done".to_owned(),
        Finish::Unfinished => panic!("{world}: it never ends"),
    };
    let of = |name: &str| simulation.signal(WORLD, name);
    let force = ["force x", "force y", "force z"].map(|axis| of(axis).powi(2)).iter().sum::<f64>().sqrt();
    let joints = (1..=6).map(|joint| of(&format!("joint {joint} speed")).abs());
    let fastest = joints.chain([of("base speed"), of("base yaw rate").abs()]).fold(0.0, f64::max);
    End { why, force, worst: of("peak force"), fastest, angle: of("door angle") }
}

fn expect_at_rest(what: &str, end: &End, reason: &str) {
    assert!(end.why.contains(reason), "{what}: {end:?}");
    assert!(end.force <= LEFT_MAX && end.worst <= FORCE_MAX && end.fastest < 0.01, "{what}: {end:?}");
}

#[test]
fn after_each_failure_the_arm_is_at_rest_and_unloaded() {
    let untouched = &mut |_: &mut Simulation| {};
    for (what, world, reason) in [
        ("a locked door", "seed = 1, lock = \"locked\"", "locked"),
        ("a locked door, held stiffly", "seed = 2, lock = \"locked\", stiffness = 24000 N/m", "locked"),
        ("a hand that loses the handle", "seed = 3, lose_at = 20 deg", "lost the handle"),
    ] {
        expect_at_rest(what, &fly(DOOR, world, untouched), reason);
    }
    // Any controller may die while the hand presses or pulls. The load of a door closer would stay, so these doors have
    // none.
    for (leaf, phase, after_ms) in
        [("/presshandle", "/presshandle", 900), ("/dooropen/model", "/dooropen/", 900), ("/add", "/dooropen/", 3000)]
    {
        let mut began = None;
        let kill = &mut |simulation: &mut Simulation| {
            if simulation.is_any_active(phase) {
                let since = *began.get_or_insert(simulation.now());
                if simulation.now().since(since) >= Duration::from_millis(after_ms) && after_ms > 0 {
                    simulation.crash(leaf);
                }
            }
        };
        expect_at_rest(
            &format!("{leaf} dies"),
            &fly(DOOR, "seed = 4, closer = 0 Nm, closer_rate = 0", kill),
            "SIGKILL",
        );
    }
}

/// Returns whether a hand at rest before an open door is taking off its load.
fn takes_off_its_load(simulation: &Simulation) -> bool {
    simulation.signal("/dooropen/model", "pace") <= 0.0
}

#[test]
fn a_mission_that_is_done_leaves_the_arm_without_load() {
    for world in [
        "seed = 7, closer = 0 Nm, closer_rate = 0, friction = 8 Nm",
        "seed = 8, closer = 0 Nm, closer_rate = 0, stiffness = 40000 N/m",
        "seed = 9, closer = 0 Nm, closer_rate = 0, swing = \"push\", friction = 6 Nm",
    ] {
        let (mut since, mut done) = (None, None);
        let end = fly(DOOR, world, &mut |simulation| {
            if takes_off_its_load(simulation) {
                since.get_or_insert(simulation.now());
            }
            if !simulation.is_any_active("/dooropen/") && since.is_some() {
                done.get_or_insert(simulation.now());
            }
        });
        expect_at_rest(world, &end, "done");
        assert!(end.angle > 64.0 && done.zip(since).is_some(), "{world}: {end:?}");
    }
}

/// Each event happens 0.2 s after the hand has come to rest before the open door.
#[test]
fn a_stop_or_a_failure_while_the_load_is_taken_off_leaves_the_arm_without_load() {
    type Meddle = fn(&mut Simulation);
    let troubles: [(&str, Meddle, &str); 4] = [
        ("a stop", Simulation::stop, "done"),
        ("the law dies", |simulation| assert!(simulation.crash("/dooropen/model")), "SIGKILL"),
        ("the sum dies", |simulation| assert!(simulation.crash("/dooropen/add")), "SIGKILL"),
        (
            "the controller of the force sensor dies",
            |simulation| assert!(simulation.crash("/dooropen/force")),
            "SIGKILL",
        ),
    ];
    for (what, meddle, reason) in troubles {
        let (mut since, mut is_over) = (None, false);
        let end = fly(DOOR, "seed = 9, closer = 0 Nm, closer_rate = 0", &mut |simulation| {
            if takes_off_its_load(simulation) && !is_over {
                let since = *since.get_or_insert(simulation.now());
                if simulation.now().since(since) >= Duration::from_millis(200) {
                    is_over = true;
                    meddle(simulation);
                }
            }
        });
        assert!(is_over, "{what}: the door was not open");
        expect_at_rest(what, &end, reason);
        assert!(end.angle > 60.0, "{what}: {end:?}");
    }
}

/// The fingers keep holding an open door, so the pull of a closer stays, and the door stays open.
#[test]
fn a_door_that_is_open_is_not_let_go_of() {
    let end = fly(DOOR, "seed = 5, closer = 20 Nm", &mut |_| {});
    assert!(end.why == "done" && end.angle > 68.0 && end.force > 15.0 && end.fastest < 0.01, "{end:?}");
}

/// A visitor once pushed the hand while it was looking for the handle, and kept pushing with all 150 N. The arm
/// continued to servo.
#[test]
fn a_force_on_the_hand_stops_the_arm_whatever_it_does() {
    for at in [2, 8] {
        let world = format!("seed = 3, push_at = {at} s, push = 150 N");
        let end = fly(DOOR, &world, &mut |_| {});
        assert!(end.why.contains("motionctrl/puma: the force on the hand exceeds 80 N"), "{world}: {end:?}");
        assert!(end.worst < 120.0 && end.fastest < 0.2, "{world}: {end:?}");
    }
}

/// An arm takes up to 3 s to release the force on its hand. During this time its reader once missed the joints, and the
/// mission ended with `no joint angles for 1 s`.
#[test]
fn an_arm_that_lets_go_of_its_force_tells_the_true_reason() {
    let visitor = "shut_at = 40 deg, shut_torque = 60 Nm, shut_for = 10 s";
    let world = format!("seed = 4, slip_force = 300 N, stiffness = 3000 N/m, {visitor}");
    let end = fly(DOOR, &world, &mut |_| {});
    assert!(end.why.contains("motionctrl/puma: the force on the hand exceeds 80 N"), "{end:?}");
}

/// The base once moved sideways into a wall that its laser did not see, with 122 N.
#[test]
fn a_base_that_looks_for_the_handle_meets_no_wall_beside_it() {
    let door = "seed = 200002, side = \"right\", start_aside = -0.16 m, start_yaw = 0.12 rad, lock = \"locked\"";
    let end = fly(DOOR, &format!("{door}, wall_latch = 0.243441 m"), &mut |_| {});
    assert!(end.why.contains("no room") && end.worst < 1.0 && end.fastest < 0.01, "{end:?}");
}

/// A laser sees neither glass nor mirrors, and no body beside the base. The base once pressed against these with 377 N,
/// 351 N and 261 N until its task ended.
#[test]
fn a_base_that_meets_what_it_does_not_see_goes_back() {
    let left = "side = \"left\", start_aside = 0.22 m, start_yaw = -0.06 rad";
    let body = "body_before = 0.872555 m, body_aside = 1.384815 m, body_size = 0.393509 m, wall_depth = 3.463061 m";
    for world in [
        format!("seed = 42420011, {left}, glass = \"hinge\", wall_hinge = 0.228585 m"),
        format!("seed = 42420001, {left}, mirror = \"hinge\", wall_hinge = 0.464339 m"),
        format!("seed = 42420005, {left}, {body}"),
    ] {
        let (mut bumper, end) = (0.0, |simulation: &Simulation| simulation.signal(WORLD, "collision force"));
        let flown = fly(DOOR, &world, &mut |simulation| bumper = end(simulation));
        assert!(flown.why.contains("its bumper is pressed"), "{world}: {flown:?}");
        assert!(flown.worst < FORCE_MAX && bumper < 8.5 && flown.fastest < 0.01, "{world}: {bumper} N, {flown:?}");
    }
}

/// Single readings of the force sensor show 153 N to 198 N. These doors once ended with `the force on the hand exceeds
/// 80 N`.
#[test]
fn spikes_of_the_force_sensor_end_no_opening() {
    for (door, spike, share) in [
        ("seed = 42420007, side = \"left\"", 153.369863, 0.024996),
        ("seed = 42420008, side = \"right\"", 179.624306, 0.006453),
        ("seed = 42420010, side = \"right\"", 197.805838, 0.009818),
    ] {
        let end = fly(DOOR, &format!("{door}, spike = {spike} N, spikes = {share}"), &mut |_| {});
        assert!(end.why == "done" && end.angle > 60.0 && end.worst < 60.0, "{door}: {end:?}");
    }
}

/// A lever that springs back out of the fingers is a lost handle. If 45 N do not press a lever down to its latch,
/// nothing shows that it is down.
#[test]
fn a_lever_that_is_not_down_is_not_called_down() {
    let springs_back = fly(DOOR, "seed = 5, lever_torque = 2 Nm, lever_rate = 2, slip_force = 45 N", &mut |_| {});
    expect_at_rest("a lever that springs back", &springs_back, "lost the handle: there is nothing between the fingers");
    let (mut lever, stiff) = (0.0_f64, "seed = 5, lever_torque = 1.5 Nm, lever_rate = 8");
    let end = fly(DOOR, stiff, &mut |simulation| lever = lever.max(simulation.signal(WORLD, "lever angle")));
    expect_at_rest("a stiff lever", &end, "the lever is down as far as it was pressed");
    assert!(lever < 27.0, "its latch is free at 28 degrees: {lever}");
}

/// The gripper reports that it holds the handle, but it does not. The lever slides off the fingertips at 58 degrees, and
/// the closer brings the leaf back. The leaf once met the fingers from the side with 725 N.
#[test]
fn a_leaf_that_comes_back_past_the_fingers_is_no_hammer() {
    let door = "seed = 200003, side = \"left\", swing = \"push\", closer = 11.854083 Nm";
    let world = format!("{door}, grip_says = 20 mm, lose_at = 0.238953 rad");
    let end = fly(DOOR, &world, &mut |_| {});
    assert!(end.why != "done" && end.worst < 150.0 && end.fastest < 0.01, "{end:?}");
}

/// Samples with an old time stamp, and old values with a new one. The first kind once made the hand press on the handle
/// with 146 N.
#[test]
fn a_force_sensor_that_hangs_is_noticed_before_it_matters() {
    for how in ["repeats", "restamps"] {
        for at in [10, 13, 14, 15, 16, 17] {
            let world =
                format!("seed = 3, fails = \"force\", fails_how = \"{how}\", fails_at = {at} s, fails_for = 60 s");
            let end = fly(DOOR, &world, &mut |_| {});
            println!("{how} at {at} s: {:.1} N at most, {}", end.worst, end.why);
            assert!(end.worst <= 60.0 && end.fastest < 0.01, "{world}: {end:?}");
            let told =
                if how == "repeats" { "`ft/state` has received its last sample" } else { "the force sensor hangs" };
            let is_old = end.why.contains("inputs are too old");
            assert!(end.why.contains(told) || is_old, "{world}: {end:?}");
        }
    }
}

#[test]
fn a_laser_that_hangs_is_noticed() {
    for at in [4, 19, 22] {
        let world =
            format!("seed = 3, fails = \"laser\", fails_how = \"restamps\", fails_at = {at} s, fails_for = 60 s");
        let end = fly(DOOR, &world, &mut |_| {});
        assert!(end.why.contains("the laser hangs") && end.worst <= FORCE_MAX, "{world}: {end:?}");
    }
}

/// The gripper once closed on any object after an approach that ended by its length.
#[test]
fn an_approach_that_touches_nothing_has_failed() {
    let short = DOOR.replace("until = \"touch\"", "until = \"touch\", length = 120 mm");
    assert!(short != DOOR, "the spec says until when it approaches");
    let end = fly(&short, "seed = 6", &mut |_| {});
    assert!(end.why.contains("nothing was touched on the path of 120 mm"), "{end:?}");
}
