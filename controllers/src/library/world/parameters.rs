//! Every constant of the simulated world, as a parameter of its process: range, unit, meaning.

use super::delay::Delays;
use crate::robot::door::{Lock, Side, Swing};
use crate::robot::room::Place;
use crate::robot::setup::{Setup, Slip};
use crate::sdk::{Arguments, Kind, Parameter, Quantity};
use std::time::Duration;

/// Makes the parameters, and the table of their units and meanings for people.
macro_rules! parameters {
    ($($name:literal: $kind:expr, $default:literal, $unit:literal, $meaning:literal;)+) => {
        /// The parameters of the process, in the order of a spec's arguments.
        pub(super) const PARAMETERS: &[Parameter] = &[$(Parameter::new($name, $kind).or($default),)+];
        #[cfg(test)]
        const MEANINGS: &[(&str, &str)] = &[$(($unit, $meaning),)+];
    };
}

/// A number from `low` to `high`: a share, or a value in a unit that specs do not have.
const fn from(low: f64, high: f64) -> Kind {
    Kind::Number(low, high)
}

const fn length(low: f64, high: f64) -> Kind {
    Kind::Quantity(Quantity::Length, low, high)
}

const fn time(low: f64, high: f64) -> Kind {
    Kind::Quantity(Quantity::Time, low, high)
}

const fn angle(low: f64, high: f64) -> Kind {
    Kind::Quantity(Quantity::Angle, low, high)
}

const fn force(low: f64, high: f64) -> Kind {
    Kind::Quantity(Quantity::Force, low, high)
}

const fn torque(low: f64, high: f64) -> Kind {
    Kind::Quantity(Quantity::Torque, low, high)
}

const fn mass(low: f64, high: f64) -> Kind {
    Kind::Quantity(Quantity::Mass, low, high)
}

const fn stiffness(low: f64, high: f64) -> Kind {
    Kind::Quantity(Quantity::Stiffness, low, high)
}

parameters! {
    "lock": Kind::Text(&["unlocked", "locked"]), "unlocked", "", "whether the lever frees the latch";
    "seed": from(0.0, 1e9), "1", "", "the seed of the start, of all errors and of the noise";
    "radius": length(0.5, 1.2), "0.82", "m", "distance from the hinge to the held place of the lever";
    "closer": torque(0.0, 40.0), "8", "Nm", "torque of the closer at rest";
    "push_at": time(-1.0, 1e6), "-1", "s", "when a visitor begins to push the hand; -1: never";
    "push": force(0.0, 200.0), "60", "N", "final force of the visitor, 4 s later";
    "lose_at": angle(-1.0, 2.5), "-1", "rad", "at this angle of the door, the lever leaves the fingers for good; -1: never";
    "slip_force": force(1.0, 1000.0), "78", "N", "force at which a held lever slips out";
    "turn_slip": torque(0.1, 50.0), "2", "Nm", "torque at which a held lever turns between the fingers, about their closing axis";
    "base_slip_at": time(-1.0, 1e6), "-1", "s", "when the wheels begin to turn on the spot; -1: never";
    "base_slip_for": time(0.0, 60.0), "1", "s", "duration of this slip";
    "base_slip_lever": angle(-1.0, 1.6), "-1", "rad", "the slip begins at this angle of the lever; -1: never";
    "base_slip_door": angle(-1.0, 2.5), "-1", "rad", "the slip begins at this angle of the door; -1: never";
    "side": Kind::Text(&["left", "right"]), "left", "", "side of the hinge, seen by the robot";
    "swing": Kind::Text(&["pull", "push"]), "pull", "", "direction in which the robot must open the door";
    "inertia": from(1.0, 60.0), "6.75", "kg m²", "inertia of the leaf about its hinge";
    "closer_rate": from(0.0, 20.0), "2", "Nm/rad", "increase of the closer's torque with the angle";
    "friction": torque(0.0, 15.0), "1", "Nm", "dry friction of the hinge";
    "viscosity": from(0.0, 20.0), "1.5", "Nm s/rad", "viscous friction of the hinge";
    "leaf_beyond": length(0.02, 0.3), "0.08", "m", "width of the leaf beyond the handle";
    "latch_angle": angle(0.05, 1.2), "0.4886921905584123", "rad", "angle of the lever that frees the latch";
    "lever_height": length(0.7, 1.4), "1.05", "m", "height of the lever's axis above the floor";
    "lever_length": length(0.05, 0.16), "0.09", "m", "distance from the lever's axis to its held place";
    "lever_standoff": length(0.03, 0.15), "0.06", "m", "distance from the leaf to the lever";
    "lever_thickness": length(0.008, 0.05), "0.02", "m", "thickness of the lever between the fingers";
    "lever_stop": angle(0.2, 1.5), "0.7853981633974483", "rad", "angle of the lever's stop";
    "lever_torque": torque(0.0, 5.0), "0.6", "Nm", "torque of the lever's spring at rest";
    "lever_rate": from(0.0, 10.0), "1.8", "Nm/rad", "increase of this torque with the lever's angle";
    "touch_stiffness": stiffness(500.0, 64000.0), "8000", "N/m", "stiffness of a fingertip against the lever";
    "touch_damping": from(0.0, 400.0), "40", "N s/m", "damping of a fingertip against the lever";
    "touch_reach": length(0.01, 0.1), "0.05", "m", "how far beside its middle a fingertip meets the lever";
    "grasp_reach": length(0.005, 0.08), "0.035", "m", "how far from its middle closing fingers meet the lever";
    "grasp_turn": angle(0.05, 1.5), "0.35", "rad", "largest angle between hand and lever at which the fingers close on it";
    "stiffness": stiffness(500.0, 48000.0), "6000", "N/m", "stiffness of the lever in closed fingers";
    "damping": from(0.0, 400.0), "60", "N s/m", "damping of the lever in closed fingers";
    "base_lag": time(0.005, 0.5), "0.08", "s", "time constant of the base's drives";
    "arm_lag": time(0.002, 0.2), "0.02", "s", "time constant of the arm's drives";
    "wheel_error": from(-0.2, 0.2), "0.01", "", "share by which the odometry overestimates";
    "payload": mass(0.0, 5.0), "0", "kg", "mass beyond the wrist sensor that its calibration omits";
    "droop": from(0.0, 20.0), "1", "", "effect of a force on the drives, as a multiple of the nominal one";
    "torque_limit": from(0.1, 4.0), "1", "", "strength of the arm's motors, as a multiple of the published one";
    "traction": force(20.0, 2000.0), "200", "N", "force at which the base's wheels begin to slide";
    "noise": from(0.0, 10.0), "1", "", "factor of all noise";
    "force_noise": force(0.0, 10.0), "0.4", "N", "standard deviation of a force";
    "torque_noise": torque(0.0, 1.0), "0.02", "Nm", "standard deviation of a torque";
    "force_offset": force(0.0, 50.0), "3", "N", "largest error of each force until the sensor is set to zero";
    "force_bias": force(-30.0, 30.0), "0", "N", "drift along the approach that setting to zero does not remove";
    "laser_noise": length(0.0, 0.1), "0.005", "m", "standard deviation of one ray";
    "laser_bias": length(-0.1, 0.1), "0", "m", "error of all rays";
    "pixel_noise": from(0.0, 10.0), "0.5", "px", "standard deviation of a mark in the image";
    "depth_noise": from(0.0, 0.3), "0.03", "", "standard deviation of a depth, as a share of it";
    "focal_error": from(-0.2, 0.2), "0", "", "share by which the focal length exceeds the believed one";
    "camera_shift": length(0.0, 0.05), "0", "m", "largest error of the camera's place, along each axis";
    "camera_turn": angle(0.0, 0.2), "0", "rad", "largest error of the camera's direction, about each axis";
    "joint_offset": angle(0.0, 0.1), "0", "rad", "largest error of each encoder of the arm";
    "start_distance": length(1.3, 2.6), "1.75", "m", "distance from the base to the wall at the start";
    "start_aside": length(-1.0, 1.0), "0.22", "m", "distance to the left of the handle at the start";
    "start_yaw": angle(-0.8, 0.8), "-0.06", "rad", "direction of the base at the start, counter-clockwise from straight ahead";
    "start_spread": from(0.0, 4.0), "1", "", "the seed moves the start by up to this multiple of 0.08 m, 0.06 m and 0.05 rad";
    "start_wrist": angle(-4.6, 4.6), "1.5707963267948966", "rad", "angle of joint 6: it points the fingers' x axis to the left; -1.5707963 to the right";
    "arm_delay": time(0.0, 1.0), "0", "s", "delay from the arm's encoders to their readers";
    "base_delay": time(0.0, 1.0), "0", "s", "delay from the base's encoders";
    "force_delay": time(0.0, 1.0), "0", "s", "delay from the wrist sensor";
    "gripper_delay": time(0.0, 1.0), "0", "s", "delay from the gripper";
    "laser_delay": time(0.0, 1.0), "0", "s", "delay from the laser";
    "camera_delay": time(0.0, 1.0), "0", "s", "delay from the camera";
    "command_delay": time(0.0, 1.0), "0", "s", "delay from a command to the drives";
    "jitter": time(0.0, 1.0), "0", "s", "largest random addition to each of these delays";
    "turn_stiffness_x": from(1.0, 200.0), "25", "Nm/rad", "stiffness of a held lever against turning between closed fingers, about itself";
    "turn_stiffness_y": from(1.0, 100.0), "8", "Nm/rad", "stiffness of a held lever against turning about the closing axis of the fingers";
    "turn_stiffness_z": from(1.0, 100.0), "6", "Nm/rad", "stiffness of a held lever against turning about the approach axis";
    "turn_damping": from(0.0, 2.0), "0.4", "Nm s/rad", "damping of these three turns";
    "latch_play": angle(0.001, 0.05), "0.010471975511965976", "rad", "below this angle of the leaf the latch catches it";
    "latch_stiffness": from(1e4, 2e5), "100000", "Nm/rad", "stiffness of latch and frame, about the hinge";
    "latch_damping": from(0.0, 800.0), "400", "Nm s/rad", "damping of latch and frame, about the hinge";
    "base_speed": from(0.2, 3.0), "1", "", "largest speed of the base, as a multiple of 0.6 m/s and 0.7 rad/s";
    "base_acceleration": from(0.2, 3.0), "1", "", "its acceleration, as a multiple of 1 m/s² and 1.5 rad/s²";
    "arm_speed": from(0.2, 3.0), "1", "", "largest speed of the joints, as a multiple of the published one";
    "arm_acceleration": from(0.2, 3.0), "1", "", "their acceleration, as a multiple of 8 rad/s²";
    "grip_force": force(5.0, 200.0), "40", "N", "largest force of the fingers";
    "grip_speed": from(0.02, 0.5), "0.12", "m/s", "speed of the fingers";
    "shut_at": angle(-1.0, 2.5), "-1", "rad", "at this angle of the door, a visitor begins to shut it; -1: never";
    "shut_torque": torque(-100.0, 100.0), "30", "Nm", "torque of this visitor about the hinge, reached within 0.2 s; a negative torque \
     opens the door";
    "shut_for": time(0.0, 60.0), "2", "s", "duration of this torque";
    "wall_latch": length(-1.0, 4.0), "-1", "m", "distance from the latch's jamb to a side wall; -1: 2.5 m from the handle";
    "wall_hinge": length(-1.0, 4.0), "-1", "m", "distance from the hinge's jamb to a side wall; -1: 2.5 m from the handle";
    "wall_depth": length(0.05, 4.0), "4", "m", "length of both side walls towards the robot";
    "next_wall": length(-1.0, 8.0), "-1", "m", "distance from the door to the wall of the next room; -1: out of sight";
    "second_leaf": angle(-1.0, 2.5), "-1", "rad", "angle of a second leaf beside the latch; -1: there is none";
    "glass": Kind::Text(&["none", "latch", "hinge", "both", "leaf"]), "none", "", "walls on these sides, or the leaf, have no echo";
    "mirror": Kind::Text(&["none", "latch", "hinge", "both", "leaf"]), "none", "", "walls on these sides, or the leaf, are mirrors";
    "body_before": length(-1.0, 3.0), "-1", "m", "distance of a round body from the wall; -1: there is none";
    "body_aside": length(-2.5, 2.5), "-0.6", "m", "its distance to the left of the handle";
    "body_size": length(0.05, 1.0), "0.3", "m", "its diameter";
    "body_walks": length(0.0, 2.0), "0", "m", "its movement to the left and to the right";
    "strays": from(0.0, 0.5), "0", "", "share of the laser's rays with a random range";
    "blind_from": angle(-1.6, 1.6), "0", "rad", "from this direction, rays have no echo; straight ahead is 0";
    "blind_to": angle(-1.6, 1.6), "0", "rad", "up to this direction";
    "spike": force(0.0, 500.0), "60", "N", "a false force across the approach in single readings";
    "spikes": from(0.0, 0.5), "0", "", "share of the readings with such a force";
    "grip_says": length(-1.0, 0.1), "-1", "m", "a fixed width that the gripper reports; -1: the true one";
    "turn_at": angle(-1.0, 2.5), "-1", "rad", "at this angle of the door, an outside force begins to turn the base; -1: never";
    "turn_rate": from(-0.5, 0.5), "0.1", "rad/s", "speed of this turn, counter-clockwise";
    "turn_for": time(0.0, 60.0), "2", "s", "duration of this turn";
    "jump_at": angle(-1.0, 2.5), "-1", "rad", "at this angle of the door, the steering encoder of one caster jumps; -1: never";
    "jump_by": angle(-3.2, 3.2), "0.5", "rad", "size of the jump";
    "fails": Kind::Text(&["none", "arm", "base", "force", "gripper", "laser", "camera"]), "none", "", "the sensor that fails for a while";
    "fails_how": Kind::Text(&["silent", "repeats", "restamps"]), "silent", "", "it falls silent, repeats its last sample, or stamps old \
     values as new";
    "fails_at": time(-1.0, 1e6), "-1", "s", "time of the failure; -1: never";
    "fails_door": angle(-1.0, 2.5), "-1", "rad", "the failure begins at this angle of the door; -1: never";
    "fails_for": time(0.0, 60.0), "1", "s", "duration of the failure";
    "commands": Kind::Text(&["anyone", "holder"]), "anyone", "", "senders that a free device obeys: the first one, or none without the \
     lock";
}

/// Returns the world that the arguments describe.
pub(super) fn setup(arguments: &Arguments) -> Setup {
    let mut setup = Setup { seed: arguments.number("seed").to_bits(), ..Setup::default() };
    let door = &mut setup.door;
    door.side = if arguments.text("side") == "right" { Side::Right } else { Side::Left };
    door.swing = if arguments.text("swing") == "push" { Swing::Push } else { Swing::Pull };
    door.lock = if arguments.text("lock") == "locked" { Lock::Locked } else { Lock::Unlocked };
    for (name, field) in numbers(&mut setup) {
        *field = arguments.number(name);
    }
    let at = |name| Some(arguments.number(name)).filter(|at| *at >= 0.0).unwrap_or(f64::INFINITY);
    setup.faults.lose_at = at("lose_at");
    setup.faults.base_slip =
        Slip { time: at("base_slip_at"), lever: at("base_slip_lever"), door: at("base_slip_door") };
    (setup.faults.shut_at, setup.faults.turned.at, setup.faults.jump.at) =
        (at("shut_at"), at("turn_at"), at("jump_at"));
    (setup.room.glass, setup.room.mirror) = (place(arguments.text("glass")), place(arguments.text("mirror")));
    setup
}

fn place(text: &str) -> Place {
    match text {
        "latch" => Place::Latch,
        "hinge" => Place::Hinge,
        "both" => Place::Both,
        "leaf" => Place::Leaf,
        _ => Place::None,
    }
}

/// Returns the delays of all samples and commands.
pub(super) fn delays(arguments: &Arguments) -> Delays {
    let of = |name| Duration::from_secs_f64(arguments.number(name));
    let state = ["arm_delay", "base_delay", "force_delay", "gripper_delay", "laser_delay", "camera_delay"].map(of);
    Delays { state, command: of("command_delay"), jitter: of("jitter") }
}

/// The numbers of a world by the names of their parameters.
#[expect(clippy::too_many_lines, reason = "it is a table")]
fn numbers(setup: &mut Setup) -> [(&'static str, &mut f64); 83] {
    let Setup { door, room, contact, machine, sensors, start, faults, .. } = setup;
    let [turn_x, turn_y, turn_z] = &mut contact.turn_stiffness;
    [
        ("radius", &mut door.radius),
        ("closer", &mut door.closer),
        ("slip_force", &mut contact.slip_force),
        ("turn_slip", &mut contact.turn_slip),
        ("base_slip_for", &mut faults.base_slip_for),
        ("inertia", &mut door.inertia),
        ("closer_rate", &mut door.closer_rate),
        ("friction", &mut door.friction),
        ("viscosity", &mut door.viscosity),
        ("leaf_beyond", &mut door.leaf_beyond),
        ("latch_angle", &mut door.latch.angle),
        ("lever_height", &mut door.lever.height),
        ("lever_length", &mut door.lever.length),
        ("lever_standoff", &mut door.lever.standoff),
        ("lever_thickness", &mut door.lever.thickness),
        ("lever_stop", &mut door.lever.stop),
        ("lever_torque", &mut door.lever.torque),
        ("lever_rate", &mut door.lever.rate),
        ("touch_stiffness", &mut contact.touch_stiffness),
        ("touch_damping", &mut contact.touch_damping),
        ("touch_reach", &mut contact.touch_reach),
        ("grasp_reach", &mut contact.grasp_reach),
        ("grasp_turn", &mut contact.grasp_turn),
        ("stiffness", &mut contact.stiffness),
        ("damping", &mut contact.damping),
        ("base_lag", &mut machine.base.lag),
        ("arm_lag", &mut machine.arm.lag),
        ("wheel_error", &mut machine.wheel_error),
        ("payload", &mut machine.payload),
        ("droop", &mut machine.droop),
        ("torque_limit", &mut machine.torque_limit),
        ("traction", &mut machine.traction),
        ("noise", &mut sensors.noise),
        ("force_noise", &mut sensors.force.force_noise),
        ("torque_noise", &mut sensors.force.torque_noise),
        ("force_offset", &mut sensors.force.offset),
        ("force_bias", &mut sensors.force.bias),
        ("laser_noise", &mut sensors.laser.noise),
        ("laser_bias", &mut sensors.laser.bias),
        ("pixel_noise", &mut sensors.pixel_noise),
        ("depth_noise", &mut sensors.depth_noise),
        ("focal_error", &mut sensors.focal_error),
        ("camera_shift", &mut sensors.camera_shift),
        ("camera_turn", &mut sensors.camera_turn),
        ("joint_offset", &mut sensors.joint_offset),
        ("start_distance", &mut start.distance),
        ("start_aside", &mut start.aside),
        ("start_yaw", &mut start.yaw),
        ("start_spread", &mut start.spread),
        ("start_wrist", &mut start.wrist),
        ("turn_stiffness_x", turn_x),
        ("turn_stiffness_y", turn_y),
        ("turn_stiffness_z", turn_z),
        ("turn_damping", &mut contact.turn_damping),
        ("latch_play", &mut door.latch.play),
        ("latch_stiffness", &mut door.latch.stiffness),
        ("latch_damping", &mut door.latch.damping),
        ("base_speed", &mut machine.base.speed),
        ("base_acceleration", &mut machine.base.acceleration),
        ("arm_speed", &mut machine.arm.speed),
        ("arm_acceleration", &mut machine.arm.acceleration),
        ("grip_force", &mut machine.grip_force),
        ("grip_speed", &mut machine.grip_speed),
        ("shut_torque", &mut faults.shut_torque),
        ("shut_for", &mut faults.shut_for),
        ("wall_latch", &mut room.beside_latch),
        ("wall_hinge", &mut room.beside_hinge),
        ("wall_depth", &mut room.depth),
        ("next_wall", &mut room.next_wall),
        ("second_leaf", &mut room.second_leaf),
        ("body_before", &mut room.body.before),
        ("body_aside", &mut room.body.aside),
        ("body_size", &mut room.body.size),
        ("body_walks", &mut room.body.walks),
        ("strays", &mut sensors.laser.strays),
        ("blind_from", &mut sensors.laser.blind.0),
        ("blind_to", &mut sensors.laser.blind.1),
        ("spike", &mut sensors.force.spike),
        ("spikes", &mut sensors.force.spikes),
        ("grip_says", &mut sensors.grip_says),
        ("turn_rate", &mut faults.turned.rate),
        ("turn_for", &mut faults.turned.span),
        ("jump_by", &mut faults.jump.by),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_the_nominal_world() {
        let arguments = Arguments::parse::<&str>(PARAMETERS, &[]).unwrap();
        let nominal = Setup { seed: 1f64.to_bits(), ..Setup::default() };
        assert_eq!(setup(&arguments), nominal);
        assert_eq!(delays(&arguments), Delays::default());
    }

    #[test]
    fn every_number_reaches_the_world() {
        let nominal = setup(&Arguments::parse::<&str>(PARAMETERS, &[]).unwrap());
        let quiet = delays(&Arguments::parse::<&str>(PARAMETERS, &[]).unwrap());
        let own = ["push_at", "push", "fails", "fails_how", "fails_at", "fails_door", "fails_for", "commands"];
        for parameter in PARAMETERS.iter().filter(|parameter| !own.contains(&parameter.name)) {
            let value = match parameter.kind {
                Kind::Number(low, high) | Kind::Whole(low, high) | Kind::Quantity(_, low, high) => {
                    (0.4 * low + 0.6 * high).to_string()
                }
                Kind::Text(words) => words[1].to_owned(),
                Kind::Truth => "true".to_owned(),
                Kind::Secret => String::new(),
            };
            let given = Arguments::parse(PARAMETERS, &[format!("{}={value}", parameter.name)]).unwrap();
            let is_other = setup(&given) != nominal || delays(&given) != quiet;
            assert!(is_other, "`{}` changes nothing", parameter.name);
        }
    }

    #[test]
    fn the_manual_has_each_parameter() {
        let page = include_str!("../../../../docs/src/door.md");
        for (parameter, (unit, meaning)) in PARAMETERS.iter().zip(MEANINGS) {
            let range = match parameter.kind {
                Kind::Number(low, high) | Kind::Whole(low, high) => format!("{low} to {high}"),
                Kind::Quantity(quantity, low, high) => {
                    assert_eq!(quantity.unit(), *unit, "`{}`", parameter.name);
                    format!("{low} to {high}")
                }
                Kind::Text(words) => words.iter().map(|word| format!("`{word}`")).collect::<Vec<_>>().join(", "),
                Kind::Truth => "`true`, `false`".to_owned(),
                Kind::Secret => String::new(),
            };
            let default = parameter.default.unwrap_or_default();
            let line = format!("| `{}` | {default} | {range} | {unit} | {meaning} |", parameter.name);
            assert!(page.contains(&line), "docs/src/door.md lacks this line:\n{line}");
        }
    }
}
