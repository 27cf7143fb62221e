//! The way through an open door, and how much room it has, seen from above.
//!
//! Beside the leaf, where the hand has let go of the handle, one sweep shows leaf, wall and the leaf's free edge. The
//! leaf hides the jamb on the side of the latch. This jamb is assumed to be as far from the hinge as the leaf is wide.
//! That is enough to drive around the edge. In front of the opening both of its sides are in sight. The way through is
//! the straight line that keeps furthest from every point that the laser sees.
//!
//! If a leaf of width w is open by the angle a, w·sin(a) is free between the leaf and the jamb. A robot that drives
//! past the leaf, a disc of radius R with a margin m, needs sin(a) ≥ 2(R + m)/w.
//!
//! Source: ours; the widest straight corridor among points is the empty corridor problem, Houle and Maciel, "Finding
//! the widest empty corridor through a set of points", 1988, here by trying directions.

use super::clearance::{BASE_RADIUS, beside};
use super::line::{Line, crossing};
use nalgebra::{Isometry2, Point2, Rotation2, Vector2};

/// The greatest distance between neighbouring points on a leaf (m).
const GAP: f64 = 0.15;
/// Points this close to a line lie on it (m).
const TOLERANCE: f64 = 0.02;
/// The distance from the leaf's edge to the base's centre on the way around it, in addition to the base's radius (m).
const AROUND: f64 = 0.30;
/// The distance from the leaf's edge back to the place from which the robot looks through the door, in addition to the
/// base's radius (m).
const BEFORE: f64 = 0.45;
/// The final distance of the base beyond the wall, in addition to its radius (m): wheels may be wrong by 5 % of the
/// way.
const BEYOND: f64 = 0.30;
/// The range in which a corridor is searched, around its expected place: by angle (rad), the steps of this angle (rad),
/// and sideways (m).
const TURN: f64 = 0.20;
const TURN_STEP: f64 = 0.01;
const BESIDE: f64 = 0.25;
/// The least room on each side of the centre (m): anything narrower is a gap between two points of one side.
const ROOM_MIN: f64 = 0.10;
/// Sides of a corridor further away than this (m) do not belong to a door.
const SIDE_MAX: f64 = 1.5;

/// A straight way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// A place on the way (m).
    pub at: Vector2<f64>,
    /// The direction of the way (rad).
    pub heading: f64,
}

/// A door that stands open, as seen from above (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doorway {
    /// The point where the leaf meets the wall (m).
    pub hinge: Vector2<f64>,
    /// The free edge of the leaf (m).
    pub edge: Vector2<f64>,
    /// The place of the free edge when the door is shut (m).
    pub latch: Vector2<f64>,
    /// The normal of the wall, a unit vector towards the robot's side.
    pub out: Vector2<f64>,
}

/// A straight way without obstacles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corridor {
    /// The way in the middle between the sides of the corridor.
    pub way: Way,
    /// The distance from the way to each side (m).
    pub room: f64,
}

impl Way {
    /// Returns its direction as a unit vector.
    pub fn along(&self) -> Vector2<f64> {
        Rotation2::new(self.heading) * Vector2::x()
    }

    /// Returns how far `point` (m) is along the way and to its left (m).
    pub fn coordinates(&self, point: &Vector2<f64>) -> Vector2<f64> {
        Rotation2::new(-self.heading) * (point - self.at)
    }

    /// Returns the way in another frame; `frame` is the pose of this frame in the other one.
    #[must_use]
    pub fn moved(&self, frame: &Isometry2<f64>) -> Self {
        Self { at: (frame * Point2::from(self.at)).coords, heading: self.heading + frame.rotation.angle() }
    }
}

impl Doorway {
    /// Returns the door whose leaf is before the hand, measured in one sweep of `points` (m, base axes). `wall` and
    /// `leaf` are lines in this sweep. The leaf's normal points in the direction of the hand, which is at `hand` (m).
    /// Returns none if wall and leaf are parallel, or the leaf is not seen.
    pub fn measured(points: &[Vector2<f64>], wall: &Line, leaf: &Line, hand: &Vector2<f64>) -> Option<Self> {
        let hinge = crossing(wall, leaf)?;
        let along = Vector2::new(-leaf.normal.y, leaf.normal.x);
        // The hand holds the handle, which is nearer to the edge than to the hinge.
        let to_edge = along * along.dot(&(hand - hinge)).signum();
        let is_on_leaf = |point: &&Vector2<f64>| (leaf.normal.dot(point) - leaf.distance).abs() < TOLERANCE;
        let from = to_edge.dot(&(hand - hinge));
        let mut out: Vec<f64> = points.iter().filter(is_on_leaf).map(|point| to_edge.dot(&(point - hinge))).collect();
        out.retain(|at| *at > from - GAP);
        out.sort_by(f64::total_cmp);
        let width = out.iter().fold(from, |end, at| if at - end < GAP { end.max(*at) } else { end });
        // The normals of both lines point away from the robot. When the door is shut, the face before the hand looks
        // out of the wall, and the leaf's edge is at the latch.
        let (face, out) = (-leaf.normal, -wall.normal);
        let quarter = face.perp(&to_edge).signum() * std::f64::consts::FRAC_PI_2;
        let latch = hinge + Rotation2::new(quarter) * out * width;
        (width > 0.0).then_some(Self { hinge, edge: hinge + to_edge * width, latch, out })
    }

    /// Returns the width of the leaf (m).
    pub fn width(&self) -> f64 {
        (self.edge - self.hinge).norm()
    }

    /// Returns how far the door is open (rad), positive for both directions of opening.
    pub fn angle(&self) -> f64 {
        let (shut, open) = (self.latch - self.hinge, self.edge - self.hinge);
        shut.perp(&open).abs().atan2(shut.dot(&open))
    }

    /// Returns how far the door has to be open (rad) for a disc of `radius` (m) to pass with a `margin` (m) on both
    /// sides; none if the door is too narrow.
    pub fn angle_needed(&self, radius: f64, margin: f64) -> Option<f64> {
        let sine = 2.0 * (radius + margin) / self.width();
        (sine <= 1.0).then(|| sine.asin())
    }

    /// Returns half of the free width between leaf and latch (m).
    pub fn room(&self) -> f64 {
        0.5 * self.width() * self.angle().min(std::f64::consts::FRAC_PI_2).sin()
    }

    /// Returns the door in another frame; `frame` is the pose of this frame in the other one.
    #[must_use]
    pub fn moved(&self, frame: &Isometry2<f64>) -> Self {
        let at = |point: &Vector2<f64>| (frame * Point2::from(*point)).coords;
        let (hinge, edge, latch) = (at(&self.hinge), at(&self.edge), at(&self.latch));
        Self { hinge, edge, latch, out: frame.rotation * self.out }
    }

    /// Returns the way through the door. It begins in front of the leaf's edge. It runs along the leaf, or square to
    /// the wall if the leaf is open by more than a right angle.
    pub fn way(&self) -> Way {
        let to_edge = (self.edge - self.hinge) / self.width();
        let is_wide = self.angle() > std::f64::consts::FRAC_PI_2;
        let back = if is_wide { self.out } else { to_edge };
        // In the middle between the latch and the line through the hinge along the way.
        let aside = self.hinge - self.latch - back * back.dot(&(self.hinge - self.latch));
        let middle = self.latch + aside * 0.5;
        let before = back.dot(&(self.edge - middle)).max(0.0) + BASE_RADIUS + BEFORE;
        Way { at: middle + back * before, heading: (-back).y.atan2((-back).x) }
    }

    /// Returns where the base turns around the leaf's edge (m).
    pub fn around(&self) -> Vector2<f64> {
        self.edge + (self.edge - self.hinge) / self.width() * (BASE_RADIUS + AROUND)
    }

    /// Returns how far the base has to go along `way` to be beyond the wall (m).
    pub fn length(&self, way: &Way) -> f64 {
        let slope = -self.out.dot(&way.along());
        (self.out.dot(&(way.at - self.hinge)) + BASE_RADIUS + BEYOND) / slope.max(0.3)
    }

    /// Returns the distance from the leaf to the straight stretch between two places (m); 0 if the stretch crosses the
    /// leaf.
    pub fn beside(&self, from: &Vector2<f64>, to: &Vector2<f64>) -> f64 {
        if crosses([from, to], [&self.hinge, &self.edge]) {
            return 0.0;
        }
        let ends = [(from, &self.hinge, &self.edge), (to, &self.hinge, &self.edge)];
        let edges = [(&self.hinge, from, to), (&self.edge, from, to)];
        ends.into_iter().chain(edges).map(|(point, a, b)| beside(point, a, b)).fold(f64::INFINITY, f64::min)
    }

    /// Returns by how much the leaf has turned since this measurement (rad), from a sweep of `points` (m, in the frame
    /// of this door). Returns none if the leaf is out of sight or has turned by more than 0.5 rad.
    pub fn turned(&self, points: &[Vector2<f64>]) -> Option<f64> {
        const SPAN: f64 = 0.5;
        let (to_edge, width) = ((self.edge - self.hinge) / self.width(), self.width());
        let turn = |point: &Vector2<f64>| {
            let (along, beside) = (to_edge.dot(&(point - self.hinge)), to_edge.perp(&(point - self.hinge)));
            let reach = along.hypot(beside);
            ((0.3 * width..width + TOLERANCE).contains(&reach) && along > 0.0).then(|| beside.atan2(along))
        };
        let mut turns: Vec<f64> = points.iter().filter_map(turn).filter(|turn| turn.abs() < SPAN).collect();
        turns.sort_by(f64::total_cmp);
        (turns.len() >= 10).then(|| turns[turns.len() / 2])
    }
}

/// Returns the widest straight corridor among `points` (m) near `guess`. Only points within `length` (m) from the start
/// of `guess` count. Returns none if the corridor does not have two sides or is too narrow.
pub fn corridor(points: &[Vector2<f64>], guess: &Way, length: f64) -> Option<Corridor> {
    let turns = 0..=lossless(2.0 * TURN / TURN_STEP);
    let all = turns.filter_map(|step| {
        let way = Way { heading: guess.heading - TURN + TURN_STEP * f64::from(step), ..*guess };
        let coordinates = points.iter().map(|point| way.coordinates(point));
        let inside = coordinates.filter(|at| (-BASE_RADIUS..length).contains(&at.x) && at.y.abs() < SIDE_MAX);
        let mut sides: Vec<f64> = inside.map(|at| at.y).collect();
        sides.sort_by(f64::total_cmp);
        let gaps = sides.windows(2).map(|pair| (0.5 * (pair[0] + pair[1]), 0.5 * (pair[1] - pair[0])));
        let (beside, room) = gaps.filter(|gap| gap.0.abs() < BESIDE).max_by(|a, b| a.1.total_cmp(&b.1))?;
        let left = Rotation2::new(way.heading) * Vector2::y();
        Some(Corridor { way: Way { at: way.at + left * beside, ..way }, room })
    });
    all.max_by(|a, b| a.room.total_cmp(&b.room)).filter(|widest| widest.room > ROOM_MIN)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small positive number")]
fn lossless(steps: f64) -> u32 {
    steps.round() as u32
}

fn crosses([a, b]: [&Vector2<f64>; 2], [c, d]: [&Vector2<f64>; 2]) -> bool {
    let side = |from: &Vector2<f64>, to: &Vector2<f64>, point: &Vector2<f64>| (to - from).perp(&(point - from)) > 0.0;
    side(a, b, c) != side(a, b, d) && side(c, d, a) != side(c, d, b)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    /// A door in the wall x = 0, hinge at (0, 0.8), `width` wide (m), open by `angle` (rad) towards negative x. With
    /// `mirror` -1 the hinge is on the right.
    pub(in crate::control) fn doorway(angle: f64, width: f64, mirror: f64) -> Doorway {
        let p = |x: f64, y: f64| Vector2::new(x, mirror * y);
        let edge = p(-width * angle.sin(), 0.8 - width * angle.cos());
        Doorway { hinge: p(0.0, 0.8), edge, latch: p(0.0, 0.8 - width), out: -Vector2::x() }
    }

    fn door(angle: f64, mirror: f64) -> Doorway {
        doorway(angle, 0.9, mirror)
    }

    /// 101 points along each stretch.
    fn points(stretches: &[(Vector2<f64>, Vector2<f64>)]) -> Vec<Vector2<f64>> {
        let one = |(from, to): &(Vector2<f64>, Vector2<f64>)| {
            let (from, step) = (*from, (to - from) / 100.0);
            (0..=100).map(move |i| from + step * f64::from(i))
        };
        stretches.iter().flat_map(one).collect()
    }

    /// Returns the visible points of a door: the leaf and both walls.
    fn seen(door: &Doorway) -> Vec<Vector2<f64>> {
        let beside = (door.latch - door.hinge).normalize();
        points(&[(door.hinge, door.edge), (door.latch, door.latch + beside), (door.hinge, door.hinge - beside)])
    }

    #[test]
    fn a_sweep_beside_the_leaf_shows_the_whole_door() {
        for mirror in [1.0, -1.0] {
            for angle in [1.0, 1.3, FRAC_PI_2, 1.8] {
                let truth = door(angle, mirror);
                let to_edge = (truth.edge - truth.hinge).normalize();
                let face = Vector2::new(-angle.cos(), mirror * angle.sin());
                // The robot stands square to the leaf, 0.85 m behind the hand; its frame has the leaf ahead.
                let hand = truth.hinge + to_edge * 0.8 + face * 0.06;
                let base = Isometry2::new(hand + face * 0.85, (-face).y.atan2((-face).x));
                let from_base = base.inverse();
                let found = truth.moved(&from_base);
                let line = |on: &Vector2<f64>, normal: Vector2<f64>| {
                    let normal = from_base.rotation * normal;
                    let distance = normal.dot(on);
                    Line { normal: normal * distance.signum(), distance: distance.abs(), inliers: 100 }
                };
                let (wall, leaf) = (line(&found.hinge, Vector2::x()), line(&found.hinge, -face));
                let all: Vec<_> = points(&[(found.hinge, found.edge)]);
                let hand = (from_base * Point2::from(hand)).coords;
                let got = Doorway::measured(&all, &wall, &leaf, &hand).unwrap_or_else(|| panic!("{angle} {mirror}"));
                let wrong = (got.hinge - found.hinge).norm() + (got.edge - found.edge).norm();
                // The limit is a step between the points along the leaf.
                assert!(wrong < 0.01, "{got:?} {found:?}");
                assert!(
                    (got.latch - found.latch).norm() < 0.01 && (got.angle() - angle).abs() < 1e-6,
                    "{got:?} {found:?}"
                );
            }
        }
    }

    #[test]
    fn the_way_leads_past_the_edge_through_the_middle() {
        for mirror in [1.0, -1.0] {
            for angle in [1.2, 1.4, FRAC_PI_2, 1.9] {
                let door = door(angle, mirror);
                let way = door.way();
                let end = way.at + way.along() * door.length(&way);
                let beside = [&door.edge, &door.hinge, &door.latch].map(|side| way.coordinates(side).y.abs());
                let nearest = beside.into_iter().fold(f64::MAX, f64::min);
                // Beside the leaf the formula applies; a leaf beyond the right angle is out of the way.
                assert!((nearest - door.room()).abs() < 1e-9, "{nearest} {} {angle}", door.room());
                assert!(end.x > BASE_RADIUS && end.x < BASE_RADIUS + 0.5, "{end}");
                assert!(way.at.x < door.edge.x - BASE_RADIUS, "{way:?}");
                // The robot drives from behind the leaf around its edge.
                let face = Vector2::new(-angle.cos(), mirror * angle.sin());
                let behind = door.edge + face * 1.1;
                let around = door.around();
                assert!(door.beside(&behind, &around).min(door.beside(&around, &way.at)) > BASE_RADIUS + 0.2);
                assert!(door.beside(&behind, &(way.at + way.along())) < 1e-9, "that is through the leaf");
            }
        }
        assert!((door(1.2, 1.0).room() - 0.45 * 1.2f64.sin()).abs() < 1e-9);
        let needed = door(1.2, 1.0).angle_needed(0.31, 0.05).unwrap();
        assert!((needed.sin() * 0.9 - 0.72).abs() < 1e-9);
        assert_eq!(door(1.2, 1.0).angle_needed(0.41, 0.05), None);
    }

    #[test]
    fn the_corridor_is_as_wide_as_what_is_seen() {
        for mirror in [1.0, -1.0] {
            let door = door(1.2, mirror);
            let way = door.way();
            // The expected way is 8 cm to the side and turned by 6 degrees.
            let wrong = Isometry2::new(Vector2::new(0.0, 0.08), 0.1);
            let guess = Way { at: way.at + wrong.translation.vector, heading: way.heading + wrong.rotation.angle() };
            let found = corridor(&seen(&door), &guess, door.length(&way)).unwrap();
            // The leaf is not the only side: a slanted path is a little wider than the straight one.
            assert!(found.room >= door.room() - 0.005 && found.room < door.room() + 0.03, "{found:?} {}", door.room());
            let middle = door.latch + (door.hinge - door.latch) * 0.5;
            assert!(found.way.coordinates(&middle).y.abs() < 0.08, "{found:?}");
            // One side alone is not a corridor.
            assert_eq!(corridor(&points(&[(door.hinge, door.edge)]), &guess, 2.0), None);
        }
    }

    #[test]
    fn a_leaf_that_turns_is_seen_to() {
        for mirror in [1.0, -1.0] {
            let open = door(1.2, mirror);
            let turned = open.turned(&seen(&door(1.0, mirror))).unwrap();
            assert!((turned - mirror * 0.2).abs() < 0.01, "{turned}");
            assert!(open.turned(&seen(&open)).unwrap().abs() < 0.01);
            assert_eq!(open.turned(&seen(&door(0.3, mirror))), None);
        }
    }
}
