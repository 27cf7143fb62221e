//! The end of an opening.

use crate::control::filter::{Despike, LowPass};
use crate::control::unload::Unloading;
use crate::message::Velocity;
use nalgebra::{Vector3, Vector6};

/// A force that differs by this much from the force when the load was off (N) has changed. And the frequency below which
/// a part of the force counts for that (Hz).
const CHANGED: f64 = 8.0;
const LEFT_SLOW: f64 = 2.0;

/// The end of an opening: the hand takes off its load, and stays where it is as long as the force stays.
#[derive(Debug)]
pub(super) struct Rest {
    despike: Despike,
    slow: LowPass<3>,
    unloading: Unloading,
    /// The force when the load was off (N, tool axes).
    left: Option<Vector3<f64>>,
}

impl Default for Rest {
    fn default() -> Self {
        let (despike, slow) = (Despike::default(), LowPass::new(LEFT_SLOW));
        Self { despike, slow, unloading: Unloading::of_a_door(), left: None }
    }
}

impl Rest {
    /// Takes the wrench on the hand (N, Nm, tool axes), `dt` (s) after the last one. Returns the slow part of its force.
    pub(super) fn feel(&mut self, wrench: &Vector6<f64>, dt: f64) -> Vector3<f64> {
        let force: Vector3<f64> = self.despike.update(wrench).fixed_rows::<3>(0).into();
        self.slow.update(&force.into(), dt).into()
    }

    /// Returns whether the load is off.
    pub(super) const fn is_unloaded(&self) -> bool {
        self.left.is_some()
    }

    /// Begins again: the load is not off yet.
    pub(super) fn restart(&mut self) {
        (self.unloading, self.left) = (Unloading::of_a_door(), None);
    }

    /// Returns the velocity of a hand at rest that feels `wrench` (N, Nm, tool axes), with a slow part of its force, `dt`
    /// (s) after the last call; `delay` (s) is the delay of the force loop.
    pub(super) fn velocity(&mut self, wrench: &Vector6<f64>, slow: Vector3<f64>, delay: f64, dt: f64) -> Velocity {
        if self.left.is_some_and(|left| (slow - left).norm() > CHANGED) {
            // A visitor pushes, or the leaf moves.
            self.restart();
        }
        let twist = if self.left.is_none() { self.unloading.update(wrench, delay, dt) } else { None };
        if twist.is_none() {
            self.left.get_or_insert(slow);
        }
        Velocity { rests: true, ..Velocity::of_hand(twist.unwrap_or_default().into()) }
    }
}
