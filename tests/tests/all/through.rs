//! `specs/door_through.dca`: the robot opens a door and drives through it, on virtual time in several worlds.

use comms::logic::time::Time;
use controllers::sdk::harness::Disturbance;
use dca_tests::cluster::{Cluster, Trace, Turn, spec};
use dca_tests::simulation::{Finish, Simulation, plan};
use std::time::Duration;

const THROUGH: &str = include_str!("../../../specs/door_through.dca");
const PLACE: &str = "closer = 0 Nm, closer_rate = 0";
const LIMIT: Duration = Duration::from_secs(200);
const WORLD: &str = "main/world";
/// The radius of the base (m). If the base is farther beyond the wall than this, it is on the other side.
const BASE: f64 = 0.31;

/// The free space on each side that the spec requires (mm).
const MARGIN: f64 = 50.0;

/// How a mission ended.
#[derive(Debug)]
struct Passage {
    finish: Finish,
    /// The distance of the base's centre beyond the wall (m).
    beyond: f64,
    /// The largest force between robot and leaf, jambs or walls (N).
    collision: f64,
    /// The largest force on the hand (N).
    worst: f64,
    /// The measured free space on each side (mm).
    clearance: f64,
    /// The free space during the drive (mm).
    room: f64,
    seconds: f64,
}

fn fly(world: &str) -> Passage {
    assert!(THROUGH.contains(PLACE), "the spec's world is written so");
    let text = THROUGH.replace(PLACE, world);
    let plan = plan("door_through.dca", &text).unwrap_or_else(|why| panic!("{why}"));
    let mut simulation = Simulation::new(plan, Disturbance::NONE).unwrap_or_else(|why| panic!("{why}"));
    let (mut collision, mut clearance, mut room) = (0.0f64, f64::NAN, f64::INFINITY);
    let finish = simulation.run(Time::ZERO + LIMIT, &mut |simulation| {
        collision = collision.max(simulation.signal(WORLD, "collision force"));
        let measured = simulation.signal("/passage/drive", "clearance");
        clearance = if measured.is_nan() { clearance } else { measured };
        if simulation.is_active("/passage/drive") {
            room = room.min(simulation.signal(WORLD, "room of base"));
        }
    });
    let (beyond, worst) = (simulation.signal(WORLD, "base beyond wall"), simulation.signal(WORLD, "peak force"));
    let seconds = simulation.now().since(Time::ZERO).as_secs_f64();
    Passage { finish, beyond, collision, worst, clearance, room, seconds }
}

#[test]
fn it_drives_through_a_door_on_either_side() {
    check_passages(&["", "radius = 0.7 m, side = \"right\", seed = 4"]);
}

#[test]
#[ignore = "long: doors of many kinds"]
fn it_drives_through_doors_of_many_kinds() {
    check_passages(&[
        "side = \"right\"",
        "radius = 0.7 m, seed = 2",
        "radius = 1.0 m, seed = 3",
        "radius = 1.0 m, side = \"right\", wheel_error = 0.05, seed = 5",
        "wheel_error = -0.05, seed = 6",
        "noise = 2, laser_bias = 0.01 m, seed = 7",
        "laser_bias = -0.01 m, start_yaw = 0.1 rad, seed = 8",
        "friction = 4 Nm, inertia = 20, seed = 9",
    ]);
}

fn check_passages(worlds: &[&str]) {
    for world in worlds {
        let comma = if world.is_empty() { "" } else { ", " };
        let passed = fly(&format!("{PLACE}{comma}{world}"));
        assert_eq!(passed.finish, Finish::Done, "{world}: {passed:?}");
        assert!(passed.beyond > BASE, "{world}: {:.2} m", passed.beyond);
        assert!(passed.collision < 1e-9, "{world}: it ran into something with {:.0} N", passed.collision);
        assert!(passed.clearance >= MARGIN && passed.worst < 60.0, "{world}");
        // The steering is accurate to a centimetre, and the noise and bias of the laser add another.
        assert!(passed.room >= MARGIN - 20.0, "{world}: {:.0} mm", passed.room);
        assert!(passed.seconds < 120.0, "{world}: {:.0} s", passed.seconds);
    }
}

#[test]
fn what_it_cannot_pass_it_says() {
    for (world, reason) in [
        ("closer = 8 Nm, closer_rate = 2", "the door closes by itself"),
        ("closer = 0 Nm, closer_rate = 0, radius = 0.56 m", "not wide enough: "),
    ] {
        let passed = fly(world);
        let Finish::Aborted(why) = &passed.finish else { panic!("{world}: {:?}", passed.finish) };
        assert!(why.contains(reason), "{world}: {why}");
        assert!(passed.beyond < 0.0 && passed.collision < 1e-9 && passed.worst < 60.0, "{world}");
    }
}

/// The mission runs with real processes and real time.
#[test]
#[ignore = "long: a real door"]
fn the_programs_drive_through() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let ended = cluster.here().dca(&["run", &spec("door_through")]).ended(LIMIT);
    assert_eq!(ended.code, Some(0), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));
    let trace = Trace::read(&cluster.folder().join("runs/door_through-1"));
    let beyond = trace.signal(WORLD, "base beyond wall");
    let collision = trace.signal(WORLD, "collision force").into_iter().map(|sample| sample.value).fold(0.0, f64::max);
    let beyond = beyond.last().expect("the world publishes it").value;
    println!("{beyond:.2} m beyond, {collision:.0} N");
    assert!(beyond > BASE && collision < 1e-9, "{beyond} m, {collision} N");
}

#[test]
fn a_law_that_remembers_is_not_started_again_alone() {
    let model = "model instof ModelBasedCtrl(host1, goal = 80 deg, width_min = 10 mm, width_max = 40 mm)";
    let text = THROUGH.replace(model, &format!("{model} {{ restart transient; }}"));
    let why = plan("door_through.dca", &text).expect_err("it is refused");
    assert!(
        why.contains("error[E0112]: a restart of `model` would lose the state that `ModelBasedCtrl` remembers"),
        "{why}"
    );
    assert_eq!(why.matches("[E").count(), 1, "nothing else is wrong: {why}");
    let sensor = "laser instof LaserSensor(host1)";
    assert!(plan("door_through.dca", &THROUGH.replace(sensor, &format!("{sensor} {{ restart transient; }}"))).is_ok());
}
