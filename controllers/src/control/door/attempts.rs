//! The attempts at a door: gently first, then harder; in the direction that has moved the door further, if the door has moved.

use crate::control::swing::{Attempt, Opens, Swing};

/// An attempt is the better one if it has moved the door by this much more than the other direction (m).
const BETTER: f64 = 0.005;
/// A handle that has not moved this far was never free (m). A door that was pushed is not pulled shut again.
const MOVED: f64 = 0.03;
const MOVED_PUSHED: f64 = 0.015;
/// The first attempt begins without strain in the other direction.
const MOVED_FIRST: f64 = 0.015;

/// The present attempt, and those that remain.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Attempts {
    swing: Swing,
    limits: Attempt,
    is_first: bool,
    left: Vec<(Swing, Attempt)>,
    /// The furthest way of the handle when it was pulled, and when it was pushed (m).
    pulled: f64,
    pushed: f64,
}

impl Attempts {
    /// Begins with the first attempt at a door that opens in this direction.
    pub(super) fn new(opens: Opens) -> Self {
        let ((swing, limits), left) = (opens.attempts()[0], opens.attempts()[1..].to_vec());
        Self { swing, limits, is_first: true, left, pulled: 0.0, pushed: 0.0 }
    }

    /// Returns whether the hand pulls or pushes.
    pub(super) const fn swing(&self) -> Swing {
        self.swing
    }

    /// Returns the largest forces of the present attempt.
    pub(super) const fn limits(&self) -> Attempt {
        self.limits
    }

    /// Returns the way of the handle from which the door has certainly moved (m).
    pub(super) const fn certain_way(&self) -> f64 {
        match self.swing {
            Swing::Push => MOVED_PUSHED,
            Swing::Pull if self.is_first => MOVED_FIRST,
            Swing::Pull => MOVED,
        }
    }

    /// Returns whether no other attempt is left.
    pub(super) const fn is_last(&self) -> bool {
        self.left.is_empty()
    }

    /// Begins the next attempt after one in which the handle has gone so far (m).
    pub(super) fn next(&mut self, way: f64) {
        let went = if self.swing == Swing::Pull { &mut self.pulled } else { &mut self.pushed };
        *went = went.max(way);
        let better = if self.pulled > self.pushed + BETTER {
            Some(Swing::Pull)
        } else {
            (self.pushed > self.pulled + BETTER).then_some(Swing::Push)
        };
        let next = self.left.iter().position(|(swing, _)| better.is_none_or(|better| *swing == better));
        (self.swing, self.limits) = self.left.remove(next.unwrap_or(0));
        self.is_first = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_direction_that_has_moved_the_door_further_is_next() {
        let mut attempts = Attempts::new(Opens::Either);
        let first = attempts.swing();
        attempts.next(0.0);
        let second = attempts.swing();
        assert_ne!(first, second, "neither has moved it");
        let mut better = attempts.clone();
        better.next(0.01);
        assert_eq!(better.swing(), second);
        attempts.next(0.0);
        assert!(!attempts.is_last());
        while !attempts.is_last() {
            attempts.next(0.0);
        }
    }
}
