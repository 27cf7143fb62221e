//! The load on the hand of an arm that stops: the arm takes the load off, and measures the rest.
//!
//! On a busy machine, samples are late. A late sample says nothing about the load, so the arm waits at rest for the
//! next one. An arm that mistook a late sample for no load left 65 N on the handle of a locked door. The wait has a
//! limit, and so has the whole unloading. A load that may be left at this limit is reported with the end of the arm.

use crate::control::compliant::loop_delay;
use crate::control::puma560::{self, Joints};
use crate::control::unload::Unloading;
use crate::library::{SENSED, SILENCE};
use crate::message::{ArmState, FtState};
use crate::sdk::{In, Tick};
use nalgebra::{Vector3, Vector6};
use std::time::Duration;

/// The longest time in which the load is taken off. After this, 400 ms of the stop are left for the arm and its lock.
const WITHIN: Duration = Duration::from_millis(3100);
/// If the load on a hand is off, an arm that stops does not move the hand, unless the force has grown by this much (N).
const GROWN: f64 = 12.0;
/// If the remaining force is smaller than this (N), it is not reported: a lever that is not quite up pushes back with
/// less.
const REPORTED: f64 = 20.0;

/// The knowledge of the load on the hand.
#[derive(Debug, Default)]
pub(super) struct Load {
    unloading: Unloading,
    /// The force on a hand whose load another law has taken off (N).
    held: Option<f64>,
    /// The time since the stop began, and the time since the last samples of arm and wrist sensor.
    stopping: Duration,
    numb: Duration,
    end: Option<End>,
}

/// How the load was taken off.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    /// The load is off, as the wrist sensor reports.
    Off,
    /// A load may be left: the force that was last felt (N), and the reason.
    MayBeLeft(f64, &'static str),
}

impl Load {
    /// Takes whether another law has taken the load off, and a new sample of the wrist sensor.
    pub(super) fn hold(&mut self, rests: bool, force: Option<&FtState>) {
        self.held = force.map(size).or(self.held).filter(|_| rests);
    }

    /// Returns whether another law has taken the load off.
    pub(super) fn is_held(&self) -> bool {
        self.held.is_some()
    }

    /// Returns the rates of the joints (rad/s) that take the load off the hand; none once the load is off or the time
    /// is over.
    pub(super) fn take_off(&mut self, tick: Tick, state: &In<ArmState>, force: &In<FtState>) -> Option<Joints> {
        if self.end.is_some() {
            return None;
        }
        self.stopping += tick.elapsed;
        let fresh = state.fresh_within(tick.now, SENSED).zip(force.fresh_within(tick.now, SENSED));
        self.numb = if fresh.is_some() { Duration::ZERO } else { self.numb + tick.elapsed };
        let rates = fresh.map(|(state, wrench)| {
            let delay = loop_delay(force.age(tick.now).unwrap_or_default().as_secs_f64());
            self.rates(tick, state, wrench, delay)
        });
        match rates {
            // If the force grows before the arm is at rest, it still has to be taken off.
            Some(None) if self.held.is_some() => {}
            Some(None) => self.end = Some(End::Off),
            // A robot without a wrist sensor has nothing to wait for.
            None if force.received() == 0 => self.end = Some(End::Off),
            None if self.numb > SILENCE => self.end(force, "no samples of arm and wrist sensor for 1 s"),
            Some(Some(_)) | None if self.stopping > WITHIN => self.end(force, "taking it off takes too long"),
            Some(Some(rates)) => return Some(rates),
            None => {
                self.unloading.pause(tick.dt());
                return Some(Joints::zeros());
            }
        }
        None
    }

    /// Returns a sentence for a person about the load that may be left on the hand, if there is one.
    pub(super) fn unconfirmed(&self) -> Option<String> {
        match self.end? {
            End::Off => None,
            End::MayBeLeft(force, why) => Some(format!("the hand may still press with {force:.0} N: {why}")),
        }
    }

    /// Returns the rates that take off a measured load; none if the load is off.
    fn rates(&mut self, tick: Tick, state: &ArmState, wrench: &FtState, delay: f64) -> Option<Joints> {
        self.held = self.held.filter(|held| size(wrench) < held + GROWN);
        if self.held.is_some() {
            return None;
        }
        let ([x, y, z], [a, b, c]) = (wrench.force, wrench.torque);
        let twist = self.unloading.update(&Vector6::new(x, y, z, a, b, c), delay, tick.dt())?;
        Some(puma560::rates_for(&Joints::from(state.angles), &twist))
    }

    /// Ends with the force that was last felt; `why` is the reason why this force may be left.
    fn end(&mut self, force: &In<FtState>, why: &'static str) {
        // If another law has left a load on purpose, it is the load of a door.
        let intended = self.held.map_or(0.0, |held| held + GROWN);
        let felt = force.latest().map_or(0.0, size);
        self.end = Some(if felt < REPORTED.max(intended) { End::Off } else { End::MayBeLeft(felt, why) });
    }
}

/// Returns the magnitude of a force (N).
pub(super) fn size(wrench: &FtState) -> f64 {
    Vector3::from(wrench.force).norm()
}
