//! Doors in rooms: side walls near the jambs, surfaces without echo, bodies beside the door, a second leaf, mirrors.
//! Each row is flown with unlocked doors and, under a second name, with locked doors.

use super::Mission;
use super::rows::{DEGREE, Draw, Group, Row, argument};
use controllers::sdk::Random;

/// Draws the arguments of a room.
type Make = fn(&mut Random) -> String;

/// The rows.
const ROOMS: [(&str, Make); 12] = [
    ("side wall by the latch", |random| length("wall_latch", random, 0.1, 0.5)),
    ("side wall by the hinge", |random| length("wall_hinge", random, 0.02, 0.5)),
    ("end of a corridor", corridor),
    ("niche", |random| format!("{}, {}", corridor(random), length("wall_depth", random, 0.1, 0.8))),
    ("glass beside the door", |random| format!("glass = \"{}\", {}", side_of(random), some_corridor(random))),
    ("half without echo", blind),
    ("a body beside the door", |random| format!("{}, {}", body(random), some_corridor(random))),
    ("a body that walks", |random| format!("{}, {}", body(random), length("body_walks", random, 0.1, 1.0))),
    ("a second leaf", |random| format!("{}, {}", second_leaf(random), some_corridor(random))),
    ("a mirror beside the door", |random| format!("mirror = \"{}\", {}", side_of(random), some_corridor(random))),
    ("a next room", |random| format!("{}, {}", length("next_wall", random, 1.0, 4.0), some_corridor(random))),
    ("stray rays", |random| argument("strays", random.between(0.02, 0.15), "")),
];

/// Returns the rows of rooms, each with unlocked doors and with locked doors.
pub(super) fn rows(draw: &Draw) -> Vec<Row> {
    let of = |(name, make): (&str, Make)| {
        ["unlocked", "locked"].map(|lock| {
            let name = if lock == "locked" { format!("{name}, locked") } else { name.to_owned() };
            draw.row(Group::Room, &name, "", &mut |number, random| {
                mission((number, draw.world(number)), make, lock, random)
            })
        })
    };
    ROOMS.into_iter().flat_map(of).collect()
}

/// Returns the mission in a room of a row. Every third door has to be pushed. The robot starts on the side of the
/// hinge, since it has room there.
fn mission((number, seed): (u32, u64), make: Make, lock: &str, random: &mut Random) -> Mission {
    let (side, aside, yaw) = if number.is_multiple_of(2) { ("left", 0.22, -0.06) } else { ("right", -0.16, 0.12) };
    let swing = if number % 3 == 2 { "push" } else { "pull" };
    let start = format!("start_aside = {aside} m, start_yaw = {yaw} rad");
    let door = format!("side = \"{side}\", {start}, swing = \"{swing}\", lock = \"{lock}\"");
    Mission { arguments: format!("seed = {seed}, {door}, {}", make(random)), ..Mission::nominal() }
}

fn length(name: &str, random: &mut Random, low: f64, high: f64) -> String {
    argument(name, random.between(low, high), "m")
}

fn side_of(random: &mut Random) -> &'static str {
    let share = random.unit();
    if share < 0.4 {
        "latch"
    } else if share < 0.8 {
        "hinge"
    } else {
        "both"
    }
}

fn corridor(random: &mut Random) -> String {
    format!("{}, {}", length("wall_latch", random, 0.1, 0.8), length("wall_hinge", random, 0.05, 0.8))
}

/// A side wall in two rooms of three.
fn some_corridor(random: &mut Random) -> String {
    let share = random.unit();
    if share < 0.33 {
        length("wall_latch", random, 0.1, 0.8)
    } else if share < 0.66 {
        length("wall_hinge", random, 0.05, 0.8)
    } else {
        length("wall_depth", random, 1.0, 4.0)
    }
}

fn blind(random: &mut Random) -> String {
    let middle = random.between(-10.0, 10.0) * DEGREE;
    let (from, to) = if random.unit() < 0.5 { (-1.6, middle) } else { (middle, 1.6) };
    format!("{}, {}", argument("blind_from", from, "rad"), argument("blind_to", to, "rad"))
}

/// A person beside the door, outside the path of the leaf.
fn body(random: &mut Random) -> String {
    let aside = if random.unit() < 0.5 { random.between(-1.3, -0.8) } else { random.between(1.2, 1.8) };
    let before = length("body_before", random, 0.2, 1.2);
    format!("{before}, {}, {}", argument("body_aside", aside, "m"), length("body_size", random, 0.15, 0.5))
}

fn second_leaf(random: &mut Random) -> String {
    let open = if random.unit() < 0.3 { 0.0 } else { random.between(0.1, 2.0) };
    argument("second_leaf", open, "rad")
}
