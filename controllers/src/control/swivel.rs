//! The stance of a robot that pushes a door open: its base goes into the opening, not into the jambs.
//!
//! If the hand stayed square to the leaf, the forearm would meet the jamb on the side of the latch at a door angle of
//! 10 degrees. So the hand turns about the handle, which turns between the fingers, until the base can enter the
//! opening without meeting a jamb. Base and arm are treated as one rigid body that turns about the handle. Additional
//! motion within the arm's redundancy is only requested from the base. All lengths are measured from the first position
//! of the handle, towards the hinge and into the wall.
//!
//! Source: ours; the margins come from `specs/door_through.dca`.

use super::angle::wrapped;
use super::clearance::BASE_RADIUS;
use nalgebra::Vector2;

/// The room that has to be free on each side of the base (m).
const MARGIN: f64 = 0.06;
/// The distance from the handle to the jamb at the latch, and from the hinge to the jamb at the hinge (m). The first
/// value is for a narrow frame.
const LATCH: f64 = 0.09;
const JAMB: f64 = 0.01;
/// The greatest angle between hand and leaf if the opening leaves a choice, and the greatest angle in any case (rad).
/// Beyond the second value the wrist would meet the leaf.
const ASKEW: (f64, f64) = (0.70, 1.25);
/// The angle of the door at which the hand begins to turn, and the angle from which the hand follows its goal fully
/// (rad).
const FROM: (f64, f64) = (0.03, 0.28);
/// The gain with which the hand approaches its angle (1/s), and its largest rate (rad/s).
const GAIN: f64 = 2.0;
const RATE_MAX: f64 = 0.30;
/// The lag of the hand (rad) at which the door begins to wait, and the lag at which it is slowest.
const BEHIND: (f64, f64) = (0.05, 0.30);
const PACE_MIN: f64 = 0.2;
/// The additional motion of the base: the gain with which it approaches its place (1/s), and its largest speed (m/s).
const BASE_GAIN: f64 = 1.0;
const BASE_MAX: f64 = 0.12;

/// The place of the robot, seen from above in a frame that does not move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stance {
    /// The position of the hand (m).
    pub hand: Vector2<f64>,
    /// The direction in which the hand faces, a unit vector.
    pub ahead: Vector2<f64>,
    /// The position of the middle of the base (m).
    pub base: Vector2<f64>,
}

/// The motion that the law asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn {
    /// The turn rate of the hand about the vertical (rad/s), positive counter-clockwise.
    pub rate: f64,
    /// The share of its speed that the door may use during the turn, at most 1.
    pub pace: f64,
    /// The angle of the door (rad), from the direction in which the handle moves.
    pub angle: f64,
    /// The additional velocity of the base, which does not move the hand (m/s), in the frame of the stances.
    pub base: Vector2<f64>,
}

/// The geometry of one door, taken from the stance before the shut door.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Swivel {
    handle: Vector2<f64>,
    ahead: Vector2<f64>,
    /// +1 if the hinge is on the left.
    side: f64,
}

impl Swivel {
    /// Begins with the door shut, the hand square to it, and its hinge on the left (`side` +1) or on the right (-1).
    pub fn new(start: &Stance, side: f64) -> Self {
        Self { handle: start.hand, ahead: start.ahead, side }
    }

    /// Returns the components of a vector into the wall and towards the hinge.
    fn seen(&self, vector: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.ahead.dot(vector), self.side * self.ahead.perp(vector))
    }

    /// Takes the stance. `beside` is the angle from the hand's axis to the path of the handle (rad, counter-clockwise),
    /// and `radius` the distance of the hinge (m). Returns the motion that the law asks for.
    pub fn turn(&self, now: &Stance, beside: f64, radius: f64) -> Turn {
        let ahead = self.seen(&now.ahead);
        let turned = ahead.y.atan2(ahead.x);
        let angle = turned + self.side * beside;
        let hand = self.seen(&(now.hand - self.handle)).y;
        // The position of the base relative to the hand, in axes that turn with the hand.
        let arm = self.seen(&(now.base - now.hand));
        let (s, c) = turned.sin_cos();
        let arm = Vector2::new(c * arm.x + s * arm.y, c * arm.y - s * arm.x);
        let place = |turned: f64| hand + arm.x * turned.sin() + arm.y * turned.cos();
        let (low, high) = (BASE_RADIUS - LATCH + MARGIN, radius + JAMB - BASE_RADIUS - MARGIN);
        let middle = 0.5 * (low + high);
        let wanted = place(angle - ASKEW.0).clamp(low.min(middle), high.max(middle));
        let share = ((angle - FROM.0) / (FROM.1 - FROM.0)).clamp(0.0, 1.0);
        let reach = ((wanted - hand) / arm.norm().max(0.1)).clamp(-0.9, 0.9);
        // There are two angles with the base at its place. This is the angle with the base behind the hand.
        let goal = std::f64::consts::PI - reach.asin() - arm.y.atan2(arm.x);
        let goal = share * wrapped(goal);
        let missing = goal.max(angle - ASKEW.1) - turned;
        let late = (missing.abs() - BEHIND.0) / (BEHIND.1 - BEHIND.0);
        let aside = (share * BASE_GAIN * (wanted - place(turned))).clamp(-BASE_MAX, BASE_MAX);
        Turn {
            rate: self.side * (GAIN * missing).clamp(-RATE_MAX, RATE_MAX),
            pace: 1.0 - late.clamp(0.0, 1.0) * (1.0 - PACE_MIN),
            angle,
            base: Vector2::new(-self.ahead.y, self.ahead.x) * (self.side * aside),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation2;

    /// Returns the clearance between base and jambs (m) for a hinge on the left, in the frame of the handle. The
    /// corners belong to the jambs at the latch and at the hinge.
    fn room(base: &Vector2<f64>, radius: f64) -> f64 {
        let corners = [Vector2::new(0.0, -0.09), Vector2::new(-0.05, -0.09), Vector2::new(0.0, radius + 0.01)];
        let corner = corners.iter().map(|corner| (base - corner).norm()).fold(f64::INFINITY, f64::min);
        let beside = if (-0.09..radius + 0.01).contains(&base.y) { f64::INFINITY } else { base.x.abs() };
        corner.min(beside) - BASE_RADIUS
    }

    #[test]
    fn the_base_goes_through_the_middle_of_narrow_and_wide_openings() {
        for (side, aside) in [(1.0, 0.15), (1.0, -0.15), (-1.0, 0.15), (-1.0, -0.15)] {
            for radius in [0.65, 0.82, 1.1] {
                // Base and arm as one rigid body; the handle on its arc, 6 cm before the leaf.
                let arm = Vector2::new(-0.8, aside);
                let at = |angle: f64| {
                    let (s, c) = f64::sin_cos(angle);
                    Vector2::new(radius * s - 0.06 * c + 0.06, radius * (1.0 - c) - 0.06 * s)
                };
                let mirrored = |v: Vector2<f64>| Vector2::new(v.x, side * v.y);
                let stance = |angle: f64, turned: f64| Stance {
                    hand: mirrored(at(angle)),
                    ahead: mirrored(Vector2::new(turned.cos(), turned.sin())),
                    base: mirrored(at(angle) + Rotation2::new(turned) * mirrored(arm)),
                };
                let swivel = Swivel::new(&stance(0.0, 0.0), side);
                let (mut angle, mut turned, dt) = (0.0f64, 0.0f64, 0.01);
                while angle < 1.2 {
                    let now = stance(angle, turned);
                    let base = mirrored(now.base) - Vector2::new(0.06, 0.0);
                    assert!(room(&base, radius) > 0.03, "{side} {aside} {radius}: {angle} {base}");
                    assert!((angle - turned).abs() < ASKEW.1 + 0.1, "{angle} {turned}");
                    let turn = swivel.turn(&now, side * (angle - turned), radius);
                    turned += side * turn.rate * dt;
                    angle += turn.pace * 0.12 / radius * dt;
                }
            }
        }
    }
}
