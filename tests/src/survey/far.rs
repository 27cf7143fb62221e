//! Worlds far outside the design range of the laws. Two or three things are wrong at once, each over its whole range.

use super::rows::{DEGREE, argument};
use super::{Disruption, Meddling, Mission, Phase};
use controllers::sdk::Random;
use controllers::sdk::harness::Disturbance;
use std::time::Duration;

/// A number of the world: its parameter, its unit, and its range.
type Number = (&'static str, &'static str, f64, f64);

/// The faults. The numbers of each line are drawn together.
const WRONG: [&[Number]; 26] = [
    &[("base_slip_door", "rad", 0.0, 66.0 * DEGREE), ("base_slip_for", "s", 0.5, 15.0)],
    &[("base_slip_door", "rad", 45.0 * DEGREE, 62.0 * DEGREE), ("base_slip_for", "s", 5.0, 15.0)],
    &[("base_slip_lever", "rad", 0.0, 25.0 * DEGREE), ("base_slip_for", "s", 0.5, 15.0)],
    &[("lose_at", "rad", 3.0 * DEGREE, 68.0 * DEGREE)],
    &[("slip_force", "N", 10.0, 60.0)],
    &[("shut_at", "rad", 20.0 * DEGREE, 68.0 * DEGREE), ("shut_torque", "Nm", 5.0, 60.0), ("shut_for", "s", 0.5, 10.0)],
    &[("traction", "N", 20.0, 120.0)],
    &[("force_bias", "N", -30.0, 30.0)],
    &[("force_offset", "N", 5.0, 50.0)],
    &[("laser_bias", "m", -0.1, 0.1)],
    &[("laser_noise", "m", 0.01, 0.1)],
    &[("joint_offset", "rad", 0.02, 0.1)],
    &[("wheel_error", "", -0.2, 0.2)],
    &[("focal_error", "", -0.2, 0.2)],
    &[("camera_shift", "m", 0.0, 0.05), ("camera_turn", "rad", 0.0, 0.1)],
    &[("noise", "", 2.0, 8.0)],
    &[("jitter", "s", 0.0, 0.2)],
    &[("force_delay", "s", 0.0, 0.2), ("command_delay", "s", 0.0, 0.1)],
    &[("laser_delay", "s", 0.0, 1.0), ("base_delay", "s", 0.0, 0.3)],
    &[("push_at", "s", 0.0, 40.0), ("push", "N", 20.0, 200.0)],
    &[("radius", "m", 0.5, 1.2), ("lever_length", "m", 0.05, 0.16), ("latch_angle", "rad", 0.1, 45.0 * DEGREE)],
    &[("lever_torque", "Nm", 0.0, 5.0), ("lever_rate", "Nm/rad", 0.0, 10.0)],
    &[("closer", "Nm", 0.0, 40.0), ("closer_rate", "Nm/rad", 0.0, 20.0), ("inertia", "kg m²", 1.0, 60.0)],
    &[("droop", "", 0.0, 20.0), ("torque_limit", "", 0.1, 1.0)],
    &[("turn_slip", "Nm", 0.1, 2.0), ("stiffness", "N/m", 500.0, 48000.0)],
    &[("base_speed", "", 0.3, 2.0), ("arm_speed", "", 0.3, 2.0), ("base_acceleration", "", 0.3, 2.0)],
];
const DEVICES: [&str; 6] = ["arm", "base", "force", "gripper", "laser", "camera"];
const HOW: [&str; 3] = ["silent", "repeats", "restamps"];
/// The longest duration of a hop, and its largest jitter (ms).
const HOP_MAX: f64 = 60.0;

/// Returns the mission of a world with the seed `seed`.
pub(super) fn mission(seed: u64, phases: &[Phase], random: &mut Random) -> Mission {
    let mut pick = |count: usize| pick(count, random);
    let (side, swing) = (["left", "right"][pick(2)], ["pull", "push"][pick(2)]);
    let (first, faults) = (pick(WRONG.len()), pick(5));
    let second = (first + 1 + pick(WRONG.len() - 1)) % WRONG.len();
    let mut arguments = format!("seed = {seed}, side = \"{side}\", swing = \"{swing}\"");
    let mut given: Vec<&str> = Vec::new();
    for (name, unit, low, high) in WRONG[first].iter().chain(WRONG[second]) {
        let value = random.between(*low, *high);
        if !given.contains(name) {
            given.push(name);
            arguments = format!("{arguments}, {}", argument(name, value, unit));
        }
    }
    let mut mission = Mission::nominal();
    match faults {
        0 => arguments = format!("{arguments}, {}", failing(random)),
        1 => mission.disturbance = hops(seed, random),
        2 => mission.meddling = meddling(phases, random),
        _ => {}
    }
    Mission { arguments, ..mission }
}

/// Returns the arguments of a world with a sensor failure, usually while the door opens.
pub(super) fn failing(random: &mut Random) -> String {
    let (device, how) = (DEVICES[pick(DEVICES.len(), random)], HOW[pick(HOW.len(), random)]);
    let when = if random.unit() < 0.3 {
        argument("fails_at", random.between(2.0, 24.0), "s")
    } else {
        argument("fails_door", random.between(0.0, 66.0 * DEGREE), "rad")
    };
    let span = argument("fails_for", random.between(0.1, 10.0), "s");
    format!("fails = \"{device}\", fails_how = \"{how}\", {when}, {span}")
}

fn hops(seed: u64, random: &mut Random) -> Disturbance {
    let mut of = || Duration::from_secs_f64(1e-3 * random.between(0.1, HOP_MAX));
    Disturbance { transfer: of(), transfer_jitter: of(), drop_chance: 0.01, seed, ..Disturbance::NONE }
}

fn meddling(phases: &[Phase], random: &mut Random) -> Option<Meddling> {
    let phase = phases.get(pick(phases.len(), random)).filter(|phase| !phase.active.is_empty())?;
    let leaf = phase.active[pick(phase.active.len(), random)].clone();
    let after = Duration::from_secs_f64(random.between(0.05, phase.span));
    let disruption = if random.unit() < 0.7 { Disruption::Restart } else { Disruption::Kill };
    Some(Meddling { leaf, phase: phase.part, after, disruption })
}

/// A number below `count`.
fn pick(count: usize, random: &mut Random) -> usize {
    let share = random.unit();
    (0..count).rev().find(|index| share * count as f64 >= *index as f64).unwrap_or(0)
}
