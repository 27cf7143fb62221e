//! Problems in the middle of a mission, each with its own rows: devices report wrong values, the base is moved from
//! outside, or the machine is very busy.

use super::Mission;
use super::rows::{DEGREE, Draw, Group, Row, argument};
use controllers::sdk::Random;
use controllers::sdk::harness::Disturbance;
use std::time::Duration;

/// Makes the mission with a number and a seed.
type Make = fn((u32, u64), &mut Random) -> Mission;

/// The rows.
const TROUBLES: [(&str, Make); 12] = [
    ("the base is turned from outside", |world, random| push(world, &turned(random))),
    ("the base is turned, to pull", |world, random| pull(world, &turned(random))),
    ("a gripper says 20 mm, handle lost", |world, random| both(world, &lost(random))),
    ("a gripper says 20 mm, grip slips", |world, random| both(world, &slips(random))),
    ("a steering encoder jumps", |world, random| both(world, &jumps(random))),
    ("the arm's encoders stick", |world, random| both(world, &sticks(random))),
    ("force spikes", |world, random| both(world, &spikes(random))),
    ("very busy", |world, random| Mission { disturbance: very_busy(world.1), ..pull(world, &radius(random)) }),
    ("very busy, to push", |world, random| Mission { disturbance: very_busy(world.1), ..push(world, &radius(random)) }),
    ("a strong closer", |world, random| both(world, &closer(random))),
    ("a visitor opens it", |world, random| both(world, &opens(random))),
    ("a weak lever springs back", |world, random| both(world, &weak(random))),
];

/// Returns a row for each trouble.
pub(super) fn rows(draw: &Draw) -> Vec<Row> {
    let of = |(name, make): (&str, Make)| {
        draw.row(Group::Trigger, name, "", &mut |number, random| make((number, draw.world(number)), random))
    };
    TROUBLES.into_iter().map(of).collect()
}

fn with((number, seed): (u32, u64), swing: &str, arguments: &str) -> Mission {
    let side = if number.is_multiple_of(2) { "left" } else { "right" };
    let arguments = format!("seed = {seed}, side = \"{side}\", swing = \"{swing}\", {arguments}");
    Mission { arguments, ..Mission::nominal() }
}

fn push(world: (u32, u64), arguments: &str) -> Mission {
    with(world, "push", arguments)
}

fn pull(world: (u32, u64), arguments: &str) -> Mission {
    with(world, "pull", arguments)
}

fn both(world: (u32, u64), arguments: &str) -> Mission {
    if world.0 % 3 == 2 { push(world, arguments) } else { pull(world, arguments) }
}

/// Returns a radius near the nominal one, so that all worlds differ.
fn radius(random: &mut Random) -> String {
    argument("radius", random.between(0.75, 0.9), "m")
}

fn turned(random: &mut Random) -> String {
    let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
    let at = argument("turn_at", random.between(20.0, 64.0) * DEGREE, "rad");
    let rate = argument("turn_rate", sign * random.between(0.05, 0.2), "rad/s");
    format!("{at}, {rate}, {}", argument("turn_for", random.between(0.5, 3.0), "s"))
}

fn lost(random: &mut Random) -> String {
    let closer = argument("closer", random.between(0.0, 16.0), "Nm");
    format!("grip_says = 20 mm, {closer}, {}", argument("lose_at", random.between(3.0, 68.0) * DEGREE, "rad"))
}

fn slips(random: &mut Random) -> String {
    format!("grip_says = 20 mm, {}", argument("slip_force", random.between(8.0, 30.0), "N"))
}

fn jumps(random: &mut Random) -> String {
    let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
    let at = argument("jump_at", random.between(0.5, 66.0) * DEGREE, "rad");
    format!("{at}, {}", argument("jump_by", sign * random.between(0.3, 1.6), "rad"))
}

fn sticks(random: &mut Random) -> String {
    let when = if random.unit() < 0.5 {
        argument("fails_at", random.between(1.0, 24.0), "s")
    } else {
        argument("fails_door", random.between(0.0, 66.0) * DEGREE, "rad")
    };
    format!(
        "fails = \"arm\", fails_how = \"restamps\", {when}, {}",
        argument("fails_for", random.between(2.0, 60.0), "s")
    )
}

fn spikes(random: &mut Random) -> String {
    let size = argument("spike", random.between(20.0, 200.0), "N");
    format!("{size}, {}", argument("spikes", random.between(0.001, 0.03), ""))
}

/// Returns the disturbance of a loaded machine together with a poor network. Such a case once occurred.
fn very_busy(seed: u64) -> Disturbance {
    Disturbance {
        transfer: Duration::from_micros(100),
        transfer_jitter: Duration::from_millis(10),
        hold_chance: 0.05,
        hold_max: Duration::from_millis(60),
        drop_chance: 0.05,
        seed,
    }
}

fn closer(random: &mut Random) -> String {
    let (closer, radius) = (random.between(30.0, 40.0), random.between(0.5, 0.7));
    format!("{}, {}", argument("closer", closer, "Nm"), argument("radius", radius, "m"))
}

fn opens(random: &mut Random) -> String {
    let at = argument("shut_at", random.between(5.0, 66.0) * DEGREE, "rad");
    let torque = argument("shut_torque", -random.between(5.0, 50.0), "Nm");
    format!("{at}, {torque}, {}", argument("shut_for", random.between(0.5, 6.0), "s"))
}

fn weak(random: &mut Random) -> String {
    let torque = argument("lever_torque", random.between(0.0, 0.3), "Nm");
    format!("{torque}, {}", argument("slip_force", random.between(6.0, 25.0), "N"))
}
