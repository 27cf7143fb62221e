//! Whether a door is open: what has to be measured, and the reason when it is not.
//!
//! The estimate of the hinge is fed by the hand alone, and a hand that has lost the handle draws a circle in the air as
//! well; wheels that slip draw one, too. So an opening does not end by its estimate. It ends when the laser sees the leaf
//! at the goal in three sweeps in a row, each less two standard deviations, while the fingers hold something and the hand
//! has turned with the leaf. The estimate only says when it is time to doubt.
//!
//! Source: ours. In the good runs of `tests/tests/false_success.rs` leaf and truth differ by at most 1 degree, hand and leaf
//! by at most 10; the estimate is ahead by 5, with wheels that slip by up to 41.

use super::filter::Debounce;
use super::leaf::Leaf;

/// How far the hand's turn may differ from the leaf's (rad): the lever turns in the fingers by some degrees.
pub const TURN_MAX: f64 = 0.30;
/// How far short of its goal a door may be that is open (rad).
pub const MARGIN: f64 = 0.035;
/// An estimate so far beyond the goal (rad) is in doubt: in good runs it is ahead by some 6 degrees.
pub const AHEAD_MAX: f64 = 0.35;
/// Without the wall in sight the angle rests on wheels, and those may turn on the spot. A base that has turned by so much since
/// (rad) is believed only if the hinge that the hand feels is as far away as it was seen, by this share; one that has never been
/// seen allows a turn by so much.
const TURNED: f64 = 0.05;
const RADIUS_SHARE: f64 = 0.15;
const TURNED_UNSEEN: f64 = 0.15;
const IN_A_ROW: u32 = 3;

/// The expected geometry of a door's handle and hinge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// Between the fingers when they hold the handle, from and to (m).
    pub width: (f64, f64),
    /// From the hinge to the handle, from and to (m).
    pub radius: (f64, f64),
}

/// The measurements of one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// Between the fingers (m).
    pub width: f64,
    /// The estimated angle of the door (rad).
    pub believed: f64,
    /// The leaf as a new sweep shows it, angles positive the way it opens.
    pub leaf: Option<Leaf>,
    /// The estimated radius (m).
    pub radius: f64,
    /// The radius as it was seen (m), if it was.
    pub seen_radius: Option<f64>,
    /// How far the base has turned since the wall was seen (rad), as the wheels say.
    pub turned: f64,
}

/// The verdict on the evidence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Not open yet.
    GoOn,
    /// Open.
    Open,
    /// The evidence does not suffice, or it is not as it should be.
    Doubt(Doubt),
}

/// Why a door that is believed open need not be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// The fingers do not hold the handle.
    Handle,
    /// The laser does not see the leaf before the hand.
    Unseen,
    /// The leaf is not as far open as the hand has moved.
    Behind,
    /// The hand has turned by another angle than the leaf.
    Turn,
    /// No door has such a hinge.
    Hinge,
    /// The angle rests on wheels that may have turned on the spot.
    Wheels,
}

impl Expected {
    /// Returns whether fingers this far apart (m) hold the handle; a width that is no number does not.
    pub fn holds(&self, width: f64) -> bool {
        (self.width.0..=self.width.1).contains(&width)
    }
}

impl Evidence {
    /// Whether the angle is seen, or what has been seen agrees with the wheels. A number that is none does not.
    fn is_seen(&self) -> bool {
        let most = match self.seen_radius {
            Some(seen) if (self.radius / seen - 1.0).abs() <= RADIUS_SHARE => f64::INFINITY,
            Some(_) => TURNED,
            None => TURNED_UNSEEN,
        };
        self.turned <= most
    }
}

/// Watches an opening for its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Watch {
    goal: f64,
    expected: Expected,
    reached: Debounce,
    seen: Option<f64>,
}

impl Watch {
    /// Returns a watch for a door that shall open to `goal` (rad).
    pub fn new(goal: f64, expected: Expected) -> Self {
        Self { goal, expected, reached: Debounce::new(IN_A_ROW), seen: None }
    }

    /// Returns the angle at which the leaf was seen last (rad).
    pub fn seen(&self) -> Option<f64> {
        self.seen
    }

    /// Takes what is known. A number that is none is in doubt.
    pub fn update(&mut self, evidence: &Evidence) -> Verdict {
        if !self.expected.holds(evidence.width) {
            return Verdict::Doubt(Doubt::Handle);
        }
        let reached = evidence.leaf.is_some_and(|leaf| leaf.angle - 2.0 * leaf.deviation >= self.goal - MARGIN);
        if let Some(leaf) = evidence.leaf {
            self.seen = Some(leaf.angle);
            if self.reached.update(reached) {
                let turned = (leaf.hand - leaf.angle).abs() <= TURN_MAX;
                let sane = (self.expected.radius.0..=self.expected.radius.1).contains(&evidence.radius);
                return match (turned, sane) {
                    (true, true) if evidence.is_seen() => Verdict::Open,
                    (true, true) => Verdict::Doubt(Doubt::Wheels),
                    (false, _) => Verdict::Doubt(Doubt::Turn),
                    (true, false) => Verdict::Doubt(Doubt::Hinge),
                };
            }
        }
        // A number that is none is not below.
        if evidence.believed < self.goal + AHEAD_MAX || reached {
            return Verdict::GoOn;
        }
        Verdict::Doubt(if self.seen.is_some() { Doubt::Behind } else { Doubt::Unseen })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXPECTED: Expected = Expected { width: (0.01, 0.04), radius: (0.3, 1.5) };
    const LEAF: Leaf = Leaf { angle: 1.23, hand: 1.15, deviation: 0.002 };
    const GOOD: Evidence =
        Evidence { width: 0.02, believed: 1.3, leaf: Some(LEAF), radius: 0.82, seen_radius: Some(0.8), turned: 0.0 };

    /// The last of three verdicts on the same evidence.
    fn verdict(evidence: &Evidence) -> Verdict {
        let mut watch = Watch::new(1.22, EXPECTED);
        watch.update(evidence);
        watch.update(evidence);
        watch.update(evidence)
    }

    #[test]
    fn three_sweeps_show_it_open() {
        let mut watch = Watch::new(1.22, EXPECTED);
        let mut verdicts = Vec::new();
        for leaf in [Some(LEAF), Some(LEAF), None, Some(LEAF)] {
            verdicts.push(watch.update(&Evidence { leaf, ..GOOD }));
        }
        assert_eq!(verdicts, [Verdict::GoOn, Verdict::GoOn, Verdict::GoOn, Verdict::Open]);
    }

    #[test]
    fn each_doubt_has_its_reason() {
        assert_eq!(verdict(&GOOD), Verdict::Open);
        for width in [0.0, 0.009, 0.041, f64::NAN] {
            assert_eq!(verdict(&Evidence { width, ..GOOD }), Verdict::Doubt(Doubt::Handle), "{width}");
        }
        for hand in [0.0, 0.9, 1.6, f64::NAN] {
            let leaf = Some(Leaf { hand, ..LEAF });
            assert_eq!(verdict(&Evidence { leaf, ..GOOD }), Verdict::Doubt(Doubt::Turn), "{hand}");
        }
        for radius in [0.05, 0.17, 2.0, f64::NAN] {
            assert_eq!(verdict(&Evidence { radius, ..GOOD }), Verdict::Doubt(Doubt::Hinge), "{radius}");
        }
    }

    /// Wheels that turned on the spot for 10 s made a door of 53 degrees look like one of 72; the hinge was felt at 1.35 m and had been
    /// seen at 0.82 m.
    #[test]
    fn wheels_are_not_believed_without_the_wall_unless_the_hinge_agrees() {
        let with = |turned, seen_radius| verdict(&Evidence { turned, seen_radius, ..GOOD });
        assert_eq!(with(0.4, Some(0.9)), Verdict::Open);
        for (turned, seen) in [(0.4, Some(0.5)), (0.4, Some(1.1)), (0.2, None), (f64::NAN, None), (0.4, Some(f64::NAN))]
        {
            assert_eq!(with(turned, seen), Verdict::Doubt(Doubt::Wheels), "{turned} {seen:?}");
        }
        assert_eq!(with(0.04, Some(0.5)), Verdict::Open, "the wall is in sight");
        assert_eq!(with(0.1, None), Verdict::Open);
    }

    #[test]
    fn the_estimate_alone_opens_nothing() {
        for believed in [1.6, 3.0, f64::NAN] {
            let none = Evidence { leaf: None, believed, ..GOOD };
            assert_eq!(verdict(&none), Verdict::Doubt(Doubt::Unseen), "{believed}");
            // A leaf at the goal but for its uncertainty, and one that is far from it.
            for (angle, deviation) in [(1.23, 0.03), (0.1, 0.002), (f64::NAN, 0.002)] {
                let leaf = Some(Leaf { angle, hand: angle, deviation });
                let found = verdict(&Evidence { leaf, believed, ..GOOD });
                assert_eq!(found, Verdict::Doubt(Doubt::Behind), "{angle} {believed}");
            }
        }
        let early = Evidence { leaf: Some(Leaf { angle: 1.0, ..LEAF }), ..GOOD };
        assert_eq!(verdict(&early), Verdict::GoOn);
    }
}
