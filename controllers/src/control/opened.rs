//! Whether a door that is believed open is open: what else must be true, and the reason when it is not.
//!
//! The estimate of the hinge is fed by the hand alone, and a hand that has lost the handle draws a circle in the air as
//! well. So the end of an opening asks sensors that the estimate does not use: the fingers, which must hold something,
//! and the direction of the hand, which turns with the door only while it holds it. The checks stand at the end, not on
//! the way: the first estimates of a good opening differ by more.
//!
//! Source: ours; the limits are found with the door model.

/// How far the hand's turn may differ from the estimated angle (rad): the lever turns in the fingers by some degrees.
pub const TURN_MAX: f64 = 0.30;

/// What a door's handle and hinge may be like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// Between the fingers when they hold the handle, from and to (m).
    pub width: (f64, f64),
    /// From the hinge to the handle, from and to (m).
    pub radius: (f64, f64),
}

/// What is known when the estimate says that the door is open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// Between the fingers (m).
    pub width: f64,
    /// The estimated angle of the door (rad).
    pub angle: f64,
    /// How far the hand has turned with the door (rad).
    pub turned: f64,
    /// The estimated radius (m).
    pub radius: f64,
}

/// Why a door that is believed open need not be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// The fingers do not hold the handle.
    Handle,
    /// The hand has turned by another angle than the door is believed to.
    Turn,
    /// No door has such a hinge.
    Hinge,
}

impl Expected {
    /// Returns whether fingers this far apart (m) hold the handle; a width that is no number does not.
    pub fn holds(&self, width: f64) -> bool {
        (self.width.0..=self.width.1).contains(&width)
    }

    /// Returns the first doubt, if there is one. A number that is none is in doubt.
    pub fn doubt(&self, evidence: &Evidence) -> Option<Doubt> {
        let sane = (self.radius.0..=self.radius.1).contains(&evidence.radius);
        let turned = (evidence.turned - evidence.angle).abs() <= TURN_MAX;
        if !self.holds(evidence.width) {
            Some(Doubt::Handle)
        } else if !sane {
            Some(Doubt::Hinge)
        } else {
            (!turned).then_some(Doubt::Turn)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_doubt_has_its_reason() {
        let expected = Expected { width: (0.01, 0.04), radius: (0.3, 1.5) };
        let good = Evidence { width: 0.02, angle: 1.22, turned: 1.15, radius: 0.82 };
        assert_eq!(expected.doubt(&good), None);
        for width in [0.0, 0.009, 0.041, f64::NAN] {
            assert_eq!(expected.doubt(&Evidence { width, ..good }), Some(Doubt::Handle), "{width}");
        }
        for turned in [0.0, 0.9, 1.6, f64::NAN] {
            assert_eq!(expected.doubt(&Evidence { turned, ..good }), Some(Doubt::Turn), "{turned}");
        }
        for radius in [0.05, 0.17, 2.0, f64::NAN] {
            assert_eq!(expected.doubt(&Evidence { radius, ..good }), Some(Doubt::Hinge), "{radius}");
        }
    }
}
