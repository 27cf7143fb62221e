//! A scanning range finder at the front of the base.

use super::door::Door;
use crate::sdk::Random;
use nalgebra::{Vector2, Vector3};

/// Rays in a sweep.
pub const RAYS: u32 = 361;
/// From the centre of the base to the laser, straight ahead (m).
pub const AHEAD: f64 = 0.30;
/// The reading without an echo (m).
pub const RANGE_MAX: f64 = 8.0;

/// Returns the direction of a ray about straight ahead (rad).
pub fn bearing(ray: u32) -> f64 {
    (0.5 * f64::from(ray) - 90.0).to_radians()
}

/// The errors of its ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Of one ray (m, standard deviation).
    pub noise: f64,
    /// Of all (m).
    pub bias: f64,
}

/// Returns one sweep (m) from a base at `base` (x, y (m), yaw (rad)).
pub fn sweep(base: &Vector3<f64>, door: &Door, errors: &Errors, random: &mut Random) -> Vec<f64> {
    let (s, c) = base.z.sin_cos();
    let from = base.xy() + Vector2::new(c, s) * AHEAD;
    let walls = walls(door);
    (0..RAYS)
        .map(|ray| {
            let (s, c) = (base.z + bearing(ray)).sin_cos();
            let hits = walls.iter().filter_map(|(a, b)| hit(&from, &Vector2::new(c, s), a, b));
            let range = hits.fold(RANGE_MAX, f64::min);
            if range < RANGE_MAX {
                (range + errors.bias + random.normal(errors.noise)).clamp(0.0, RANGE_MAX)
            } else {
                range
            }
        })
        .collect()
}

/// The index of the leaf in [`walls`].
pub const LEAF: usize = 6;

/// The room from above: two stretches of wall, jambs of 5 cm, side walls, and the leaf.
pub fn walls(door: &Door) -> [(Vector2<f64>, Vector2<f64>); 7] {
    let (hinge, mirror) = (door.hinge(), door.mirror());
    let (edge, beside) = (door.description().leaf_beyond + 0.01, door.description().radius + 0.01);
    // As for a hinge on the left.
    let p = |x: f64, y: f64| Vector2::new(x, mirror * y);
    [
        (p(0.0, -2.5), p(0.0, -edge)),
        (p(0.0, beside), p(0.0, 2.5)),
        (p(0.0, -edge), p(-0.05, -edge)),
        (p(0.0, beside), p(-0.05, beside)),
        (p(0.0, -2.5), p(-4.0, -2.5)),
        (p(0.0, 2.5), p(-4.0, 2.5)),
        (hinge, door.edge()),
    ]
}

/// The range (m) at which a ray meets a stretch of wall.
fn hit(from: &Vector2<f64>, along: &Vector2<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> Option<f64> {
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
    use super::super::door::{Description, Side};
    use super::*;

    #[test]
    fn straight_ahead_is_the_door() {
        for side in [Side::Left, Side::Right] {
            let door = Door::new(Description { side, ..Description::default() });
            let errors = Errors { noise: 0.005, bias: 0.0 };
            let ranges = sweep(&Vector3::new(-1.75, 0.22, 0.0), &door, &errors, &mut Random::new(1));
            // One ray of 5 mm noise; five deviations. The room is the same from both sides.
            assert!((ranges[180] - 1.45).abs() < 0.025);
            assert!((ranges[0] - 2.72).abs() < 0.025 && (ranges[360] - 2.28).abs() < 0.025);
        }
    }
}
