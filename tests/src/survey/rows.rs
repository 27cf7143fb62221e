//! The rows of the survey: dimensions with their ranges, and triggers.

use super::{Disruption, Meddling, Mission, Phase, Task, far, rooms, troubles};
use controllers::sdk::harness::Disturbance;
use controllers::sdk::{Quantity, Random};
use std::fmt::Write as _;
use std::time::Duration;

/// The kind of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// One dimension. All others are nominal.
    Single,
    /// Doors that open by pushing.
    Push,
    /// Doors in rooms of many kinds.
    Room,
    /// The drive through a door without a closer.
    Through,
    /// All dimensions at once, each over half of its range.
    Moderate,
    /// All dimensions at once, each over its whole range.
    Wide,
    /// Something goes wrong.
    Trigger,
    /// Two or three things are wrong at once, far outside the design range of the laws.
    Far,
}

impl Group {
    /// Returns the name of the group.
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "one dimension",
            Self::Push => "to push",
            Self::Room => "rooms",
            Self::Through => "through the door",
            Self::Moderate => "moderate",
            Self::Wide => "wide",
            Self::Trigger => "trigger",
            Self::Far => "far",
        }
    }
}

/// A row of the table and its missions.
#[derive(Clone, Debug)]
pub struct Row {
    /// The kind.
    pub group: Group,
    /// The name of the varying quantity: `radius`, `50 ms a hop`.
    pub name: String,
    /// The unit of the missions' values, such as `m`.
    pub unit: &'static str,
    /// The worlds of the row.
    pub missions: Vec<Mission>,
}

impl Row {
    /// Returns a unique label: the name of the row, or that of its group if the group has only one row.
    pub fn label(&self) -> &str {
        match self.group {
            Group::Single | Group::Push | Group::Room | Group::Through | Group::Trigger => &self.name,
            Group::Moderate | Group::Wide | Group::Far => self.group.name(),
        }
    }
}

/// A varying number of the world: its parameter, its unit, its lowest, nominal and highest values.
struct Dimension {
    name: &'static str,
    unit: &'static str,
    low: f64,
    nominal: f64,
    high: f64,
}

const fn dimension(name: &'static str, unit: &'static str, [low, nominal, high]: [f64; 3]) -> Dimension {
    Dimension { name, unit, low, nominal, high }
}

pub(super) const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// The dimensions that vary only alone, since they do not describe the kind of the door.
const MORE: [Dimension; 31] = [
    dimension("closer_rate", "Nm/rad", [0.0, 2.0, 8.0]),
    dimension("viscosity", "Nm s/rad", [0.0, 1.5, 6.0]),
    dimension("leaf_beyond", "m", [0.05, 0.08, 0.15]),
    dimension("lever_stop", "rad", [35.0 * DEGREE, 45.0 * DEGREE, 60.0 * DEGREE]),
    dimension("lever_rate", "Nm/rad", [0.5, 1.8, 3.0]),
    dimension("turn_slip", "Nm", [0.5, 2.0, 8.0]),
    dimension("droop", "", [0.0, 1.0, 3.0]),
    dimension("torque_limit", "", [0.6, 1.0, 2.0]),
    dimension("force_offset", "N", [0.0, 3.0, 15.0]),
    dimension("laser_noise", "m", [0.002, 0.005, 0.015]),
    dimension("depth_noise", "", [0.01, 0.03, 0.1]),
    dimension("arm_delay", "s", [0.0, 0.0, 0.02]),
    dimension("base_delay", "s", [0.0, 0.0, 0.03]),
    dimension("gripper_delay", "s", [0.0, 0.0, 0.1]),
    dimension("laser_delay", "s", [0.0, 0.0, 0.1]),
    dimension("slip_force", "N", [60.0, 78.0, 120.0]),
    dimension("traction", "N", [80.0, 200.0, 800.0]),
    dimension("grasp_turn", "rad", [0.15, 0.35, 1.0]),
    dimension("jitter", "s", [0.0, 0.0, 0.03]),
    dimension("turn_stiffness_x", "Nm/rad", [10.0, 25.0, 75.0]),
    dimension("turn_stiffness_y", "Nm/rad", [3.0, 8.0, 24.0]),
    dimension("turn_stiffness_z", "Nm/rad", [2.0, 6.0, 20.0]),
    dimension("turn_damping", "Nm s/rad", [0.1, 0.4, 1.2]),
    dimension("latch_play", "rad", [0.2 * DEGREE, 0.6 * DEGREE, 1.5 * DEGREE]),
    dimension("latch_stiffness", "Nm/rad", [2e4, 1e5, 2e5]),
    dimension("latch_damping", "Nm s/rad", [100.0, 400.0, 800.0]),
    dimension("base_speed", "", [0.6, 1.0, 2.0]),
    dimension("base_acceleration", "", [0.6, 1.0, 2.0]),
    dimension("arm_acceleration", "", [0.5, 1.0, 2.0]),
    dimension("grip_force", "N", [25.0, 40.0, 80.0]),
    dimension("grip_speed", "m/s", [0.05, 0.12, 0.25]),
];

/// The dimensions that vary alone, and also all at once.
const DIMENSIONS: [Dimension; 31] = [
    dimension("radius", "m", [0.6, 0.82, 1.1]),
    dimension("closer", "Nm", [0.0, 8.0, 30.0]),
    dimension("inertia", "kg m²", [2.0, 6.75, 35.0]),
    dimension("friction", "Nm", [0.0, 1.0, 8.0]),
    dimension("lever_height", "m", [0.85, 1.05, 1.25]),
    dimension("lever_length", "m", [0.07, 0.09, 0.12]),
    dimension("latch_angle", "rad", [20.0 * DEGREE, 28.0 * DEGREE, 38.0 * DEGREE]),
    dimension("lever_standoff", "m", [0.045, 0.06, 0.1]),
    dimension("lever_thickness", "m", [0.012, 0.02, 0.03]),
    dimension("lever_torque", "Nm", [0.2, 0.6, 1.5]),
    dimension("stiffness", "N/m", [3000.0, 6000.0, 48000.0]),
    dimension("touch_stiffness", "N/m", [4000.0, 8000.0, 64000.0]),
    dimension("base_lag", "s", [0.03, 0.08, 0.25]),
    dimension("arm_lag", "s", [0.01, 0.02, 0.05]),
    dimension("wheel_error", "", [-0.05, 0.01, 0.05]),
    dimension("payload", "kg", [0.0, 0.0, 3.0]),
    dimension("noise", "", [0.3, 1.0, 3.0]),
    dimension("pixel_noise", "px", [0.2, 0.5, 1.5]),
    dimension("force_noise", "N", [0.1, 0.4, 1.2]),
    dimension("force_bias", "N", [-6.0, 0.0, 6.0]),
    dimension("laser_bias", "m", [-0.02, 0.0, 0.02]),
    dimension("focal_error", "", [-0.03, 0.0, 0.03]),
    dimension("camera_shift", "m", [0.0, 0.0, 0.01]),
    dimension("camera_turn", "rad", [0.0, 0.0, 1.5 * DEGREE]),
    dimension("joint_offset", "rad", [0.0, 0.0, DEGREE]),
    dimension("start_distance", "m", [1.6, 1.75, 1.95]),
    dimension("start_aside", "m", [0.1, 0.22, 0.34]),
    dimension("start_yaw", "rad", [-0.2, -0.06, 0.08]),
    dimension("camera_delay", "s", [0.0, 0.0, 0.3]),
    dimension("force_delay", "s", [0.0, 0.0, 0.02]),
    dimension("command_delay", "s", [0.0, 0.0, 0.02]),
];

impl Dimension {
    fn argument(&self, value: f64) -> String {
        argument(self.name, value, self.unit)
    }

    /// Draws a value from a share of the range around the nominal value. If both sides are possible, values below and
    /// above are equally likely.
    fn draw(&self, share: f64, random: &mut Random) -> f64 {
        let (low, high) =
            (self.nominal + (self.low - self.nominal) * share, self.nominal + (self.high - self.nominal) * share);
        let is_one_sided = self.low >= self.nominal;
        if is_one_sided || random.unit() < 0.5 {
            random.between(self.nominal, high)
        } else {
            random.between(low, self.nominal)
        }
    }
}

/// Returns an argument in the form of a spec. It leaves out a unit that specs do not know.
pub(super) fn argument(parameter: &str, value: f64, unit: &str) -> String {
    let is_known = Quantity::ALL.iter().any(|quantity| quantity.unit() == unit);
    let unit = if is_known { format!(" {unit}") } else { String::new() };
    format!("{parameter} = {value:.6}{unit}")
}

fn mission(arguments: String) -> Mission {
    Mission { arguments, ..Mission::nominal() }
}

/// Returns the side of the hinge. Left and right alternate.
fn side(number: u32) -> &'static str {
    if number.is_multiple_of(2) { "left" } else { "right" }
}

/// Draws the worlds of rows. Each row has its own stream, so another selection of rows does not change it.
pub(super) struct Draw {
    worlds: u32,
    seed: u64,
}

impl Draw {
    pub(super) fn row(
        &self,
        group: Group,
        name: &str,
        unit: &'static str,
        make: &mut dyn FnMut(u32, &mut Random) -> Mission,
    ) -> Row {
        let hash = name.bytes().fold(self.seed, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
        let mut random = Random::new(hash);
        let missions = (0..self.worlds).map(|number| make(number, &mut random)).collect();
        Row { group, name: name.to_owned(), unit, missions }
    }

    /// Returns the seed of a world. It differs between surveys.
    pub(super) fn world(&self, number: u32) -> u64 {
        (self.seed % 100_000) * 10_000 + u64::from(number) + 1
    }

    fn alone(&self, dimension: &Dimension) -> Row {
        self.row(Group::Single, dimension.name, dimension.unit, &mut |number, random| {
            let value = dimension.draw(1.0, random);
            let (seed, side) = (self.world(number), side(number));
            let arguments = format!("seed = {seed}, side = \"{side}\", {}", dimension.argument(value));
            Mission { value: Some(value), ..mission(arguments) }
        })
    }

    fn together(&self, group: Group, share: f64) -> Row {
        self.row(group, "all at once", "", &mut |number, random| mission(self.world_of_all(number, share, random)))
    }

    fn world_of_all(&self, number: u32, share: f64, random: &mut Random) -> String {
        let side = if random.unit() < 0.5 { "left" } else { "right" };
        let mut arguments = format!("seed = {}, side = \"{side}\"", self.world(number));
        for dimension in &DIMENSIONS {
            let value = dimension.draw(share, random);
            write!(arguments, ", {}", dimension.argument(value)).expect("a text takes what is written");
        }
        arguments
    }

    /// Leaves of all widths through which a base may pass. The hinge is on either side, and wheels and laser have small
    /// errors.
    fn through(&self) -> Row {
        self.row(Group::Through, "drive through", "m", &mut |number, random| {
            let (radius, wheels) = (random.between(0.68, 1.05), random.between(-0.05, 0.05));
            let (seed, laser) = (self.world(number), random.between(-0.01, 0.01));
            let side = if random.unit() < 0.5 { "left" } else { "right" };
            let errors = format!("wheel_error = {wheels:.6}, laser_bias = {laser:.6} m");
            let arguments = format!("seed = {seed}, side = \"{side}\", radius = {radius:.6} m, {errors}");
            Mission { task: Task::Through, value: Some(radius), ..mission(arguments) }
        })
    }

    /// Doors that have to be pushed: the hinge is on either side, and the dimensions vary one after the other and all
    /// at once. In further rows, the laws are told in which direction the door opens, correctly or wrongly.
    fn pushes(&self) -> Vec<Row> {
        let push = ", swing = \"push\"";
        let plain = |name: &str, told: Option<&'static str>, swing: &'static str| {
            self.row(Group::Push, name, "", &mut |number, _| {
                let arguments = format!("seed = {}, side = \"{}\"{swing}", self.world(number), side(number));
                Mission { told, ..mission(arguments) }
            })
        };
        let of_all = |name: &str, share: f64| {
            self.row(Group::Push, name, "", &mut |number, random| {
                mission(self.world_of_all(number, share, random) + push)
            })
        };
        // There are eight times as many worlds as in other rows, so each dimension occurs on both sides if there are
        // enough worlds.
        let alone = Self { worlds: self.worlds * 8, seed: self.seed };
        let alone = alone.row(Group::Push, "one dimension", "", &mut |number, random| {
            let dimension = &DIMENSIONS[number as usize % DIMENSIONS.len()];
            let value = dimension.draw(1.0, random);
            let (seed, side) = (self.world(number), side(number));
            mission(format!("seed = {seed}, side = \"{side}\", {}{push}", dimension.argument(value)))
        });
        vec![
            plain("swing push", None, push),
            alone,
            of_all("push, moderate", 0.5),
            of_all("push, wide", 1.0),
            plain("told to push", Some("push"), push),
            plain("told to push, is to be pulled", Some("push"), ""),
            plain("told to pull, is to be pushed", Some("pull"), push),
        ]
    }

    fn trigger(&self, name: &str, unit: &'static str, parameter: &str, [low, high]: [f64; 2]) -> Row {
        self.row(Group::Trigger, name, unit, &mut |number, random| {
            let value = random.between(low, high);
            let (seed, side) = (self.world(number), side(number));
            let arguments = format!("seed = {seed}, side = \"{side}\", {}", argument(parameter, value, unit));
            Mission { value: Some(value), ..mission(arguments) }
        })
    }

    /// Wheels and lens differ widely from their nominal values. The controllers know measured values, which differ from
    /// the true values by up to this share.
    fn measured(&self, name: &str, share: f64) -> Row {
        self.row(Group::Single, name, "", &mut |number, random| {
            let (wheels, focal) = (random.between(-0.1, 0.1), random.between(-0.1, 0.1));
            let mut measured = |truth: f64| truth * (1.0 + random.between(-share, share));
            let (radius, focal_px) = (measured(0.055 / (1.0 + wheels)), measured(600.0 * (1.0 + focal)));
            let calibration = vec![
                ("XR4000Odometry(host2", format!("wheel_radius = {radius:.6} m")),
                ("VisualServoing(host1", format!("focal = {focal_px:.3}")),
                ("DistanceThreshold(host1", format!("focal = {focal_px:.3}")),
            ];
            let errors = format!("wheel_error = {wheels:.6}, focal_error = {focal:.6}");
            Mission { calibration, ..mission(format!("seed = {}, {errors}", self.world(number))) }
        })
    }

    /// A visitor shuts the door again while the robot is opening it.
    fn shut(&self) -> Row {
        self.row(Group::Trigger, "a visitor shuts it", "rad", &mut |number, random| {
            let (at, torque, span) =
                (random.between(10.0, 66.0) * DEGREE, random.between(5.0, 50.0), random.between(0.5, 6.0));
            let swing = if number.is_multiple_of(3) { ", swing = \"push\"" } else { "" };
            let visitor = format!("shut_at = {at:.6} rad, shut_torque = {torque:.6} Nm, shut_for = {span:.6} s");
            Mission { value: Some(at), ..mission(format!("seed = {}, {visitor}{swing}", self.world(number))) }
        })
    }

    /// Wheels that turn on the spot for a long time, late in the opening. The doors open by pulling or pushing.
    fn spins(&self) -> Row {
        self.row(Group::Trigger, "base spins for long", "rad", &mut |number, random| {
            let (at, span) = (random.between(30.0, 62.0) * DEGREE, random.between(3.0, 15.0));
            let (side, swing) = (if random.unit() < 0.5 { "left" } else { "right" }, random.unit());
            let swing = if swing < 0.7 { "push" } else { "pull" };
            let traction = random.between(40.0, 200.0);
            let slip = format!("base_slip_door = {at:.6} rad, base_slip_for = {span:.6} s, traction = {traction:.3} N");
            let arguments = format!("seed = {}, side = \"{side}\", swing = \"{swing}\", {slip}", self.world(number));
            Mission { value: Some(at), ..mission(arguments) }
        })
    }

    /// Wheels that begin to turn on the spot shortly before the door is open, at every half degree. Three of four doors
    /// have to be pushed, so the laser does not see the wall at that time. On doors that have to be pulled, the laser
    /// fails.
    fn aimed_spins(&self) -> Row {
        // There are four times as many worlds as in other rows, so each angle occurs on either side if there are enough
        // worlds.
        let draw = Self { worlds: self.worlds * 4, seed: self.seed };
        draw.row(Group::Trigger, "base spins at the end", "rad", &mut |number, random| {
            let at = (50.0 + 0.5 * f64::from(number % 25)) * DEGREE;
            let (span, traction) = (random.between(1.0, 15.0), random.between(40.0, 300.0));
            let (radius, wheels) = (random.between(0.62, 1.05), random.between(-0.05, 0.05));
            let side = if random.unit() < 0.5 { "left" } else { "right" };
            let swing = if number % 4 < 3 {
                "swing = \"push\"".to_owned()
            } else {
                let how = if random.unit() < 0.5 { "repeats" } else { "restamps" };
                format!("fails = \"laser\", fails_how = \"{how}\", fails_door = {at:.6} rad, fails_for = {span:.6} s")
            };
            let slip = format!("base_slip_door = {at:.6} rad, base_slip_for = {span:.6} s, traction = {traction:.3} N");
            let robot = format!("side = \"{side}\", radius = {radius:.6} m, wheel_error = {wheels:.6}");
            let arguments = format!("seed = {}, {robot}, {swing}, {slip}", self.world(number));
            Mission { value: Some(at), ..mission(arguments) }
        })
    }

    fn fails(&self) -> Row {
        self.row(Group::Trigger, "a sensor fails", "", &mut |number, random| {
            let swing = if number.is_multiple_of(3) { ", swing = \"push\"" } else { "" };
            mission(format!("seed = {}, {}{swing}", self.world(number), far::failing(random)))
        })
    }

    fn far(&self, phases: &[Phase]) -> Row {
        self.row(Group::Far, "two or three at once", "", &mut |number, random| {
            far::mission(self.world(number), phases, random)
        })
    }

    fn hops(&self, name: &str, low_ms: u64, high_ms: u64) -> Row {
        self.row(Group::Trigger, name, "", &mut |number, _| {
            let (transfer, transfer_jitter) = (Duration::from_millis(low_ms), Duration::from_millis(high_ms - low_ms));
            let seed = self.world(number);
            let disturbance = Disturbance { transfer, transfer_jitter, seed, ..Disturbance::NONE };
            Mission { disturbance, ..mission(format!("seed = {seed}")) }
        })
    }

    fn meddled(&self, disruption: Disruption, phase: &Phase, task: Task) -> Row {
        let leaves = &phase.active;
        let verb = match disruption {
            Disruption::Restart => "restarted",
            Disruption::Kill => "killed",
        };
        // There is at least one world for each controller, even if a row has fewer worlds.
        let worlds = self.worlds.max(u32::try_from(leaves.len()).unwrap_or(u32::MAX));
        let draw = Self { worlds, seed: self.seed };
        let again = if task == Task::Recover { "again: " } else { "" };
        let name = format!("{again}{verb} in {}", phase.part.trim_matches('/'));
        draw.row(Group::Trigger, &name, "s", &mut |number, random| {
            let leaf = leaves[number as usize % leaves.len()].clone();
            let after = random.between(0.05, phase.span);
            let meddling = Meddling { leaf, phase: phase.part, after: Duration::from_secs_f64(after), disruption };
            let seed = self.world(number);
            Mission { task, meddling: Some(meddling), value: Some(after), ..mission(format!("seed = {seed}")) }
        })
    }
}

/// Returns all rows with `worlds` missions each. `phases` lists the active processes of each phase, as returned by
/// [`super::active_in_phases`].
pub fn rows(worlds: u32, seed: u64, phases: &[Phase]) -> Vec<Row> {
    let draw = Draw { worlds, seed };
    let plain = |name: &str, arguments: &'static str| {
        draw.row(Group::Single, name, "", &mut |number, _| mission(format!("seed = {}{arguments}", draw.world(number))))
    };
    let mut rows = vec![plain("nominal", ""), plain("side right", ", side = \"right\"")];
    rows.extend(DIMENSIONS.iter().chain(&MORE).map(|dimension| draw.alone(dimension)));
    rows.push(draw.row(Group::Single, "hand and eye", "", &mut |number, random| {
        let focal = random.between(-0.03, 0.03);
        let errors = "camera_shift = 10 mm, camera_turn = 1.5 deg";
        mission(format!("seed = {}, {errors}, focal_error = {focal:.6}", draw.world(number)))
    }));
    rows.push(draw.row(Group::Single, "busy machine", "", &mut |number, _| {
        let seed = draw.world(number);
        Mission { disturbance: Disturbance::busy(seed), ..mission(format!("seed = {seed}")) }
    }));
    rows.extend([draw.measured("measured to 0.5 %", 0.005), draw.measured("measured to 2 %", 0.02)]);
    rows.extend(draw.pushes());
    rows.extend(rooms::rows(&draw));
    rows.push(draw.through());
    rows.push(draw.together(Group::Moderate, 0.5));
    rows.push(draw.together(Group::Wide, 1.0));
    rows.push(draw.trigger("handle lost", "rad", "lose_at", [3.0 * DEGREE, 60.0 * DEGREE]));
    rows.push(draw.trigger("grip slips", "N", "slip_force", [10.0, 18.0]));
    // With the present laws, the door opens from 14 s to 23 s. After the row with a fixed time, the following two rows disturb the
    // opening and the press independently of time.
    rows.push(draw.trigger("base slips by the clock", "s", "base_slip_at", [18.0, 28.0]));
    rows.push(draw.trigger("base slips in the opening", "rad", "base_slip_door", [0.0, 60.0 * DEGREE]));
    rows.push(draw.trigger("base slips in the press", "rad", "base_slip_lever", [0.0, 28.0 * DEGREE]));
    rows.push(draw.hops("20 ms a hop", 20, 20));
    rows.push(draw.hops("50 ms a hop", 50, 50));
    rows.push(draw.hops("0-20 ms a hop", 0, 20));
    rows.push(draw.hops("5-30 ms a hop", 5, 30));
    rows.push(draw.hops("5-50 ms a hop", 5, 50));
    rows.extend([draw.shut(), draw.spins(), draw.aimed_spins(), draw.fails()]);
    rows.extend(troubles::rows(&draw));
    let open = Task::Open;
    for (disruption, task) in [(Disruption::Restart, open), (Disruption::Kill, open), (Disruption::Kill, Task::Recover)]
    {
        let met = phases.iter().filter(|phase| !phase.active.is_empty());
        rows.extend(met.map(|phase| draw.meddled(disruption, phase, task)));
    }
    rows.push(draw.far(phases));
    rows
}
