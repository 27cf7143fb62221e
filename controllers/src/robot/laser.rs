//! A scanning range finder at the front of the base.

use super::body::Wall;
use super::room::{Stretch, Surface};
use crate::sdk::Random;
use nalgebra::{Vector2, Vector3};

/// The number of rays in a sweep.
pub const RAYS: u32 = 361;
/// The distance from the centre of the base to the laser, straight ahead (m).
pub const AHEAD: f64 = 0.30;
/// The reading without an echo (m).
pub const RANGE_MAX: f64 = 8.0;

/// Returns the direction of a ray from straight ahead (rad), positive to the left.
pub fn bearing(ray: u32) -> f64 {
    (0.5 * f64::from(ray) - 90.0).to_radians()
}

/// The largest number of mirrors in a row through which a ray sees the room.
const MIRRORS: u32 = 2;

/// The errors of the laser's ranges.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    /// The noise of one ray (m, standard deviation).
    pub noise: f64,
    /// The constant error of all ranges (m).
    pub bias: f64,
    /// The share of the rays that return a random range.
    pub strays: f64,
    /// The rays without echo: the range of their directions from straight ahead (rad).
    pub blind: (f64, f64),
}

/// Returns one sweep of a room (m), from right to left, by a base at `base` (x, y (m), yaw (rad)).
pub fn sweep(base: &Vector3<f64>, room: &[Stretch], errors: &Errors, random: &mut Random) -> Vec<f64> {
    let (s, c) = base.z.sin_cos();
    let from = base.xy() + Vector2::new(c, s) * AHEAD;
    (0..RAYS)
        .map(|ray| {
            let (s, c) = (base.z + bearing(ray)).sin_cos();
            let range = echo(&from, &Vector2::new(c, s), room);
            let range = if range < RANGE_MAX {
                (range + errors.bias + random.normal(errors.noise)).clamp(0.0, RANGE_MAX)
            } else {
                range
            };
            if errors.strays > 0.0 && random.unit() < errors.strays {
                return random.between(0.0, RANGE_MAX);
            }
            if (errors.blind.0..errors.blind.1).contains(&bearing(ray)) { RANGE_MAX } else { range }
        })
        .collect()
}

/// Returns the range (m) at which a ray finds its echo; [`RANGE_MAX`] if it finds none.
fn echo(from: &Vector2<f64>, along: &Vector2<f64>, room: &[Stretch]) -> f64 {
    let (mut from, mut along, mut gone) = (*from, *along, 0.0);
    for _ in 0..=MIRRORS {
        let seen = room.iter().filter(|stretch| stretch.surface != Surface::Glass);
        let hits = seen.filter_map(|stretch| Some((hit(&from, &along, &stretch.ends)?, stretch)));
        let Some((range, stretch)) = hits.min_by(|a, b| a.0.total_cmp(&b.0)) else { return RANGE_MAX };
        gone += range;
        if stretch.surface == Surface::Plain {
            return gone.min(RANGE_MAX);
        }
        let wall = (stretch.ends.1 - stretch.ends.0).normalize();
        from += along * range;
        along = wall * (2.0 * wall.dot(&along)) - along;
        from += along * 1e-6;
    }
    RANGE_MAX
}

/// Returns the range (m) at which a ray hits a piece of wall. None if the ray misses it.
fn hit(from: &Vector2<f64>, along: &Vector2<f64>, wall: &Wall) -> Option<f64> {
    let (a, b) = wall;
    let (wall, to) = (b - a, a - from);
    let cross = along.perp(&wall);
    if cross.abs() < 1e-12 {
        return None;
    }
    let (range, share) = (to.perp(&wall) / cross, to.perp(along) / cross);
    (range > 0.0 && (0.0..=1.0).contains(&share)).then_some(range)
}

#[cfg(test)]
mod tests {
    use super::super::door::{Description, Door, Side};
    use super::super::room::{self, Place, stretches};
    use super::*;

    fn look(room: &room::Description, side: Side, errors: &Errors) -> Vec<f64> {
        let door = Door::new(Description { side, ..Description::default() });
        sweep(&Vector3::new(-1.75, 0.22, 0.0), &stretches(room, &door, 0.0), errors, &mut Random::new(1))
    }

    const QUIET: Errors = Errors { noise: 0.0, bias: 0.0, strays: 0.0, blind: (0.0, 0.0) };

    #[test]
    fn straight_ahead_is_the_door() {
        for side in [Side::Left, Side::Right] {
            let ranges = look(&room::Description::default(), side, &Errors { noise: 0.005, ..QUIET });
            // One ray has 5 mm of noise; the limit is five deviations. The room is the same from both sides.
            assert!((ranges[180] - 1.45).abs() < 0.025);
            assert!((ranges[0] - 2.72).abs() < 0.025 && (ranges[360] - 2.28).abs() < 0.025);
        }
    }

    #[test]
    fn glass_has_no_echo_and_a_mirror_shows_the_room_again() {
        let glass = room::Description { glass: Place::Latch, ..room::Description::default() };
        let ranges = look(&glass, Side::Left, &QUIET);
        assert!(ranges[0] >= RANGE_MAX && ranges[180] < 2.0 && ranges[360] < 3.0, "the wall on the right is glass");
        // The ray goes 2.72 m to the mirror, back to the base and on to the wall on the left.
        let mirror = room::Description { mirror: Place::Latch, ..room::Description::default() };
        let ranges = look(&mirror, Side::Left, &QUIET);
        assert!((ranges[0] - (2.72 + 5.0)).abs() < 1e-5, "{}", ranges[0]);
    }

    #[test]
    fn some_rays_are_blind_and_some_say_anything() {
        let blind = Errors { blind: (-2.0, 0.0), ..QUIET };
        let ranges = look(&room::Description::default(), Side::Left, &blind);
        assert!(ranges[..180].iter().all(|range| *range >= RANGE_MAX) && ranges[180] < 2.0);
        let (strays, plain) =
            (Errors { strays: 0.1, ..QUIET }, look(&room::Description::default(), Side::Left, &QUIET));
        let ranges = look(&room::Description::default(), Side::Left, &strays);
        let wrong = ranges.iter().zip(plain).filter(|(range, plain)| (*range - plain).abs() > 0.01).count();
        assert!((20..55).contains(&wrong), "{wrong}");
    }
}
