//! The angle of a door, measured in one sweep of a laser: the angle between the leaf and a straight line that does not
//! move.
//!
//! The laser sees leaf and line in the same sweep. So a shut door cannot look open, even if the
//! wheels slip, or if the hand has lost the handle. The leaf is the line right before the hand that
//! holds its handle. The other line is found before the door moves, and is then followed from sweep
//! to sweep:
//! - If the line of the leaf continues on both sides, or further than any leaf, it is the wall, and the door is shut.
//! - A wall with an opening that the leaf would fit shows how far the leaf is open. A law that begins with a half-open
//!   door learns the angle in this way.
//! - Any other line, such as a side wall, shows only how far the leaf turns from now on. A wall
//!   on only one side of the leaf proves nothing. In a corner, the side wall begins at the edge of a
//!   shut leaf, and this looks like an open leaf, where the wall begins at the hinge.
//!
//! Source: lines by random samples and total least squares, as in [`super::line`]; the deviation of a line's direction
//! is that of a straight-line fit, Bevington, "Data Reduction and Error Analysis", 1969, section 6.4.

use super::angle::wrapped;
use super::line::{self, Line, Spread, crossing, horizontal};
use crate::sdk::Random;
use nalgebra::{Isometry3, Rotation2, Vector2, Vector3};

/// The largest distance of a wall's points from the wall of the previous sweep (m): between sweeps the base turns by a
/// degree or two.
const WALL_GATE: f64 = 0.06;
/// The greatest turn of a wall between two sweeps, beyond the turn measured by the wheels (rad).
const WALL_TURN: f64 = 0.06;
/// A laser that is nearer to the wall than this (m), or behind it, sees the jambs in its place.
const WALL_NEAR: f64 = 0.20;
/// The distance from the middle of the base to its laser, straight ahead (m).
const LASER: f64 = 0.30;
/// The deviation of the direction of a wall that has just gone out of sight (rad), and its growth per rad that the base
/// has turned since.
const WHEELS: (f64, f64) = (0.01, 0.08);
/// Points this close to a line lie on it [m]: four deviations of the laser.
const TOLERANCE: f64 = 0.02;
/// The least and the greatest distance of the leaf behind the grasp point (m).
const BEHIND: (f64, f64) = (-0.01, 0.22);
/// The greatest distance of the leaf's points to each side of the grasp point (m).
const BESIDE: f64 = 0.6;
/// The greatest angle of the leaf to the hand (rad): the lever turns in the fingers.
const ASKEW: f64 = 0.40;
/// The distances from the hand, to each side, at which points on the leaf's line belong to the wall (m).
const WALL_BESIDE: (f64, f64) = (0.4, 1.5);
/// The number of points on one side, spread over more than `WALL_LENGTH` (m), from which a wall is certain.
const WALL_POINTS: usize = 5;
const WALL_LENGTH: f64 = 0.2;
/// No leaf is wider than this (m).
const LEAF_MAX: f64 = 1.6;
/// The greatest distance from the end of a leaf to the line of its wall (m), and the least angle between leaf and wall
/// (rad).
const HINGE_GATE: f64 = 0.15;
const AJAR_MIN: f64 = 0.08;
/// The least and the greatest distance from hinge to handle (m), and the uncertainty of the measured edges of opening
/// and leaf (m).
const RADIUS: (f64, f64) = (0.3, 1.5);
const EDGE: f64 = 0.15;
/// The largest number of stray points in an opening, and the least number of points of a wall beyond it.
const STRAYS: usize = 3;
const BEYOND_POINTS: usize = 10;
/// The least length of a line that a leaf is measured against (m).
const REFERENCE_MIN: f64 = 0.4;
/// Walls further away than this from the hand (m) are not the door's.
const WALL_FAR: f64 = 2.5;
/// The greatest distance between neighbouring points on a leaf (m).
const GAP: f64 = 0.15;
/// The leaf is seen over at least this length (m).
const LENGTH_MIN: f64 = 0.20;

/// The smallest angle between leaf and wall (rad) at which the point where they meet is measured.
/// The measurement is a mean over at least `MEAN_FROM` and about `MEAN_OF` sweeps.
const MEETS: f64 = 0.2;
const MEAN_FROM: u32 = 10;
const MEAN_OF: u32 = 40;

/// The leaf as one sweep shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leaf {
    /// The angle from the shut leaf to the leaf (rad), positive counter-clockwise seen from above.
    pub angle: f64,
    /// The angle from the direction that faces the shut leaf to the direction of the hand (rad), by the arm alone. It
    /// is also positive counter-clockwise.
    pub hand: f64,
    /// Standard deviation of `angle` (rad).
    pub deviation: f64,
    /// The distance from the hand to the leaf (m).
    pub away: f64,
    /// The direction that the leaf faces away from the hand, a unit vector (base axes).
    pub normal: Vector2<f64>,
}

/// A line that does not move, and the shut leaf derived from it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reference {
    line: Line,
    /// The angle from the normal of `line` to the normal of the shut leaf (rad). `deviation` is the uncertainty of this
    /// angle (rad).
    shut: f64,
    deviation: f64,
    /// The line of the shut leaf (base axes), followed by the wheels; none if `line` is certainly the door's wall.
    door: Option<Line>,
}

/// The line that a door is measured against, followed from sweep to sweep.
#[derive(Clone, Debug)]
pub struct Wall {
    reference: Option<Reference>,
    /// The sum of the base's turns since the wall was last seen (rad); none while the wall is in sight.
    turned: Option<f64>,
    /// The mean distance from the handle to the point where leaf and shut leaf meet (m), and the number of sweeps in
    /// this mean.
    radius: (f64, u32),
    random: Random,
}

impl Default for Wall {
    fn default() -> Self {
        Self { reference: None, turned: None, radius: (0.0, 0), random: Random::new(1) }
    }
}

impl Wall {
    /// Takes a sweep as `points` (m, base axes) with the hand at `base_from_tool`. Since the last sweep the base has
    /// moved by `moved` (x, y (m), yaw (rad), base axes). Returns the leaf, if it is seen and a reference line is
    /// known.
    pub fn update(
        &mut self,
        points: &[Vector2<f64>],
        moved: &Vector3<f64>,
        base_from_tool: &Isometry3<f64>,
    ) -> Option<Leaf> {
        let before = match &self.reference {
            None => self.find(points, base_from_tool)?,
            Some(reference) => reference.seen_from(moved),
        };
        let near = near(points, &before.line, WALL_GATE);
        let found = line::through(&near).and_then(|first| line::through(&self::near(&near, &first.0, TOLERANCE)));
        let away = before.line.distance - before.line.normal.x * LASER;
        let is_wall = |(line, spread): &(Line, Spread)| {
            let askew = turn(&before.line.normal, &line.normal).abs();
            away > WALL_NEAR && spread.count >= 20 && spread.length >= LENGTH_MIN && askew < WALL_TURN
        };
        let (line, deviation) = match found.filter(is_wall) {
            Some((line, spread)) => {
                self.turned = None;
                (line, spread.direction)
            }
            // While the wall is out of sight, its place comes from the wheels, with a deviation that grows.
            None => {
                let turned = self.turned.insert(self.turned.unwrap_or(0.0) + moved.z.abs());
                (before.line, WHEELS.0 + WHEELS.1 * *turned)
            }
        };
        let normal = Rotation2::new(before.shut) * line.normal;
        let reference = Reference { line, door: before.door.map(|door| Line { normal, ..door }), ..before };
        self.reference = Some(reference);
        let (leaf, spread) = self.leaf(points, base_from_tool)?;
        let angle = wrapped(turn(&line.normal, &leaf.normal) - reference.shut);
        let at = base_from_tool.translation.vector.xy();
        if self.turned.is_none() && angle.abs() > MEETS {
            self.meet(&reference.door.unwrap_or(line), &leaf, &at);
        }
        let facing = horizontal(&(base_from_tool.rotation * Vector3::z()));
        Some(Leaf {
            angle,
            hand: wrapped(turn(&line.normal, &facing) - reference.shut),
            deviation: deviation.hypot(spread.direction).hypot(reference.deviation),
            away: leaf.distance - leaf.normal.dot(&at),
            normal: leaf.normal,
        })
    }

    /// Returns wall and leaf as lines (base axes) in the sweep that [`Wall::update`] has just taken, if both are known.
    /// The leaf's normal points in the direction of the hand.
    pub fn lines(&mut self, points: &[Vector2<f64>], base_from_tool: &Isometry3<f64>) -> Option<(Line, Line)> {
        let (leaf, _) = self.leaf(points, base_from_tool)?;
        Some((self.reference?.line, leaf))
    }

    /// Takes the point where the lines of the shut leaf and of the leaf meet as the hinge.
    fn meet(&mut self, shut: &Line, leaf: &Line, hand: &Vector2<f64>) {
        let Some(hinge) = crossing(shut, leaf) else { return };
        let radius = leaf.normal.perp(&(hinge - hand)).abs();
        let (mean, count) = &mut self.radius;
        *count = count.saturating_add(1).min(MEAN_OF);
        *mean += (radius - *mean) / f64::from(*count);
    }

    /// Returns the observed distance from the hand to the hinge (m), if leaf and wall were seen at an angle in enough
    /// sweeps.
    pub fn radius(&self) -> Option<f64> {
        (self.radius.1 >= MEAN_FROM).then_some(self.radius.0)
    }

    /// Returns the sum of the base's turns in both directions since the wall was last seen (rad), from the wheels; none
    /// while the wall is in sight.
    pub fn turned(&self) -> Option<f64> {
        self.turned
    }

    /// Returns whether a reference line for the leaf has been found.
    pub fn is_found(&self) -> bool {
        self.reference.is_some()
    }

    /// Finds a line against which the leaf before the hand can be measured.
    fn find(&mut self, points: &[Vector2<f64>], base_from_tool: &Isometry3<f64>) -> Option<Reference> {
        let (leaf, spread) = self.leaf(points, base_from_tool)?;
        let hand = base_from_tool.translation.vector.xy();
        let foot = hand + leaf.normal * (leaf.distance - leaf.normal.dot(&hand));
        let along = Vector2::new(-leaf.normal.y, leaf.normal.x);
        let on_leaf = near(points, &leaf, TOLERANCE);
        let sides = [1.0, -1.0].map(|side| Side::new(&on_leaf, &foot, along * side));
        let (wall, _) = line::through(&on_leaf)?;
        let coplanar = line::through(&near(points, &wall, TOLERANCE)).map(|(line, _)| Reference {
            line,
            shut: 0.0,
            deviation: 0.0,
            door: None,
        });
        if sides.iter().all(|side| side.is_wall) {
            return coplanar;
        }
        let is_other = |point: &&Vector2<f64>| {
            (leaf.normal.dot(point) - leaf.distance).abs() > 2.0 * TOLERANCE && (**point - hand).norm() < WALL_FAR
        };
        let mut others: Vec<_> = points.iter().filter(is_other).copied().collect();
        let mut best: Option<Reference> = None;
        for _ in 0..3 {
            let Some(line) = line::fit(&others, TOLERANCE, &mut self.random) else { break };
            let on_line = near(&others, &line, TOLERANCE);
            let shut = turn(&line.normal, &leaf.normal);
            let begins = sides.iter().any(|side| (line.normal.dot(&side.place()) - line.distance).abs() < HINGE_GATE);
            if begins && shut.abs() > AJAR_MIN && has_opening(&line, &leaf, &on_line, &sides) {
                return Some(Reference { line, shut: 0.0, deviation: 0.0, door: None });
            }
            if let Some((_, seen)) = line::through(&on_line).filter(|(_, seen)| seen.length > REFERENCE_MIN) {
                let deviation = seen.direction.hypot(spread.direction);
                // A line that begins at an end of the leaf is perhaps the door's wall.
                if best.is_none() || begins && shut.abs() > AJAR_MIN {
                    best = Some(Reference { line, shut, deviation, door: Some(leaf) });
                }
                if begins && shut.abs() > AJAR_MIN {
                    break;
                }
            }
            others.retain(|point| (line.normal.dot(point) - line.distance).abs() > 2.0 * TOLERANCE);
        }
        // The opening leaf may hide a wall on only one side, so any other line is better.
        best.or(coplanar.filter(|_| sides[0].end + sides[1].end > LEAF_MAX))
    }

    fn leaf(&mut self, points: &[Vector2<f64>], base_from_tool: &Isometry3<f64>) -> Option<(Line, Spread)> {
        let normal = horizontal(&(base_from_tool.rotation * Vector3::z()));
        let hand = base_from_tool.translation.vector.xy();
        let is_before_hand = |point: &&Vector2<f64>| {
            let (behind, beside) = (normal.dot(&(**point - hand)), normal.perp(&(**point - hand)));
            // An askew leaf is nearer on one side.
            let askew = beside.abs() * ASKEW;
            behind > BEHIND.0 - askew && behind < BEHIND.1 + askew && beside.abs() < BESIDE
        };
        let before: Vec<_> = points.iter().filter(is_before_hand).copied().collect();
        let found = line::fit(&before, TOLERANCE, &mut self.random)?;
        let (mut leaf, spread) = line::through(&near(&before, &found, TOLERANCE))?;
        // A line has two normals; the leaf gets the normal in the direction of the hand.
        let same = leaf.normal.dot(&normal).signum();
        (leaf.normal, leaf.distance) = (leaf.normal * same, leaf.distance * same);
        let fits = turn(&normal, &leaf.normal).abs() < ASKEW && spread.length > LENGTH_MIN;
        fits.then_some((leaf, spread))
    }
}

/// The points on the leaf's line on one side of the hand.
struct Side {
    foot: Vector2<f64>,
    along: Vector2<f64>,
    /// How far the points continue without gaps (m).
    end: f64,
    /// Whether there are enough points beyond the edge of any leaf.
    is_wall: bool,
}

impl Side {
    fn new(on_leaf: &[Vector2<f64>], foot: &Vector2<f64>, along: Vector2<f64>) -> Self {
        let mut out: Vec<f64> = on_leaf.iter().map(|point| along.dot(&(point - foot))).filter(|at| *at > 0.0).collect();
        out.sort_by(f64::total_cmp);
        let end = out.iter().fold(0.0, |end, at| if at - end < GAP { *at } else { end });
        out.retain(|at| (WALL_BESIDE.0..WALL_BESIDE.1).contains(at));
        let length = out.last().zip(out.first()).map_or(0.0, |(last, first)| last - first);
        Self { foot: *foot, along, end, is_wall: out.len() >= WALL_POINTS && length > WALL_LENGTH }
    }

    /// Where these points end (m, base axes).
    fn place(&self) -> Vector2<f64> {
        self.foot + self.along * self.end
    }
}

/// Returns whether a wall has an opening that the leaf before the hand would shut: the opening has
/// hardly any points, and there is a wall on its other side.
fn has_opening(wall: &Line, leaf: &Line, on_wall: &[Vector2<f64>], sides: &[Side; 2]) -> bool {
    let Some(hinge) = crossing(wall, leaf) else { return false };
    let [near, far] = sides;
    let to_hinge = near.along.dot(&(hinge - near.foot));
    // The direction from the hinge past the hand to the edge, for the open leaf and for the shut leaf.
    let (to_edge, edge) = if to_hinge > 0.0 { (-near.along, far.end) } else { (near.along, near.end) };
    let (radius, width) = (to_hinge.abs(), to_hinge.abs() + edge);
    let shut = Rotation2::new(turn(&leaf.normal, &wall.normal)) * to_edge;
    let at = |point: &Vector2<f64>| shut.dot(&(point - hinge));
    let within = on_wall.iter().filter(|point| (EDGE..width - EDGE).contains(&at(point))).count();
    let beyond: Vec<f64> = on_wall.iter().map(at).filter(|at| (width - EDGE..width + LEAF_MAX).contains(at)).collect();
    let (from, to) = beyond.iter().fold((f64::MAX, f64::MIN), |(from, to), at| (from.min(*at), to.max(*at)));
    (RADIUS.0..RADIUS.1).contains(&radius)
        && width < LEAF_MAX
        && within <= STRAYS
        && beyond.len() >= BEYOND_POINTS
        && to - from > WALL_LENGTH
}

impl Reference {
    /// Returns the reference in the axes of the base after a motion.
    fn seen_from(&self, moved: &Vector3<f64>) -> Self {
        Self { line: seen_from(&self.line, moved), door: self.door.map(|door| seen_from(&door, moved)), ..*self }
    }
}

/// A line of the last sweep, in the axes of the base after a motion.
fn seen_from(line: &Line, moved: &Vector3<f64>) -> Line {
    let distance = line.distance - line.normal.dot(&moved.xy());
    Line { normal: Rotation2::new(-moved.z) * line.normal, distance, inliers: line.inliers }
}

fn near(points: &[Vector2<f64>], line: &Line, gate: f64) -> Vec<Vector2<f64>> {
    points.iter().filter(|point| (line.normal.dot(point) - line.distance).abs() < gate).copied().collect()
}

fn turn(from: &Vector2<f64>, to: &Vector2<f64>) -> f64 {
    from.perp(to).atan2(from.dot(to))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    /// The sweep of a laser at the origin that sees a wall at x = 1 and a leaf open by `angle` about (1, 0.8); and the
    /// hand that holds the handle.
    fn sweep(angle: f64, with_leaf: bool, random: &mut Random) -> (Vec<Vector2<f64>>, Isometry3<f64>) {
        let hinge = Vector2::new(1.0, 0.8);
        let along = Vector2::new(-angle.sin(), -angle.cos());
        let out = Vector2::new(-angle.cos(), angle.sin());
        let mut points: Vec<_> = (0..100).map(|i| Vector2::new(1.0, 0.83 + 0.012 * f64::from(i))).collect();
        points.extend((0..100).map(|i| Vector2::new(1.0, -0.1 - 0.012 * f64::from(i))));
        if with_leaf {
            points.extend((0..90).map(|i| hinge + along * (0.01 * f64::from(i))));
        }
        for point in &mut points {
            *point += Vector2::new(random.normal(0.005), random.normal(0.005));
        }
        let hand = hinge + along * 0.75 + out * 0.06;
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -angle);
        let level = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
        (points, Isometry3::from_parts(hand.push(1.0).into(), yaw * level))
    }

    #[test]
    fn the_leaf_is_measured_against_the_wall() {
        let (mut wall, mut random, mut worst) = (Wall::default(), Random::new(7), 0.0f64);
        for i in 0..=120 {
            let angle = 0.01 * f64::from(i);
            let (points, hand) = sweep(angle, true, &mut random);
            let leaf = wall.update(&points, &Vector3::zeros(), &hand);
            if i == 0 {
                assert!(leaf.is_some_and(|leaf| leaf.angle.abs() < 0.01), "{leaf:?}");
            }
            // Below 10 degrees leaf and wall are too close to be distinguished everywhere.
            if i > 20 {
                let leaf = leaf.unwrap_or_else(|| panic!("not seen at {angle}"));
                assert!((leaf.hand + angle).abs() < 0.01, "{leaf:?} at {angle}");
                assert!(leaf.deviation < 0.005, "{leaf:?}");
                worst = worst.max((leaf.angle + angle).abs() / leaf.deviation);
            }
        }
        // Over 100 sweeps the largest error is some three deviations.
        assert!(worst < 5.0, "{worst}");
        // The hand is 0.75 m from the hinge.
        assert!(wall.radius().is_some_and(|radius| (radius - 0.75).abs() < 0.01), "{:?}", wall.radius());
    }

    #[test]
    fn whoever_begins_in_the_middle_knows_how_far_it_is_open() {
        for angle in [0.0, 0.2, 0.6, 1.0, 1.3] {
            let (mut wall, mut random) = (Wall::default(), Random::new(7));
            let (points, hand) = sweep(angle, true, &mut random);
            let leaf = wall.update(&points, &Vector3::zeros(), &hand);
            assert!(leaf.is_some_and(|leaf| (leaf.angle + angle).abs() < 0.03), "{leaf:?} at {angle}");
        }
    }

    #[test]
    fn a_hand_in_the_air_sees_no_leaf() {
        let (mut wall, mut random) = (Wall::default(), Random::new(7));
        assert!(
            wall.update(&sweep(0.0, true, &mut random).0, &Vector3::zeros(), &sweep(0.0, true, &mut random).1)
                .is_some()
        );
        for i in 0..100 {
            // The leaf is shut, and the hand moves on as if it held it.
            let points = sweep(0.0, true, &mut random).0;
            let hand = sweep(0.013 * f64::from(i), false, &mut random).1;
            let leaf = wall.update(&points, &Vector3::zeros(), &hand);
            assert!(leaf.is_none_or(|leaf| leaf.angle.abs() < 0.1), "{leaf:?} at {i}");
        }
    }

    #[test]
    fn a_base_that_turns_does_not_lose_the_wall() {
        let (mut wall, mut random) = (Wall::default(), Random::new(7));
        let mut seen = 0;
        for i in 0..100 {
            // The base turns by 0.02 rad per sweep, and the odometry does not notice it: the wheels slip.
            let turned = Rotation2::new(-0.02 * f64::from(i.min(50)));
            let (points, hand) = sweep(0.6, true, &mut random);
            let points: Vec<_> = if i == 0 { sweep(0.0, true, &mut random).0 } else { points };
            let points: Vec<_> = points.iter().map(|point| turned * point).collect();
            let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turned.angle());
            let leaf = wall.update(&points, &Vector3::zeros(), &(yaw * hand));
            seen += u32::from(leaf.is_some_and(|leaf| (leaf.angle + 0.6).abs() < 0.02));
        }
        assert!(seen > 90, "{seen}");
    }
}
