//! The gripper: fingers that close on the lever, or on nothing.
//!
//! Fingers that have lost a lever close to its thickness, and can hold it again only once they have opened. Closed on
//! nothing, they press against each other.

use super::contact::{Description, Grasp, Hand, Push};
use super::door::Handle;
use super::plant::DT;
use super::setup::Machine;
use crate::control::ramp::towards;

/// The widest the fingers open (m).
pub(super) const GRIP_MAX: f64 = 0.10;
const FORCE_RISE: f64 = 400.0;

/// The gripper.
#[derive(Clone, Debug, PartialEq)]
pub struct Gripper {
    /// Between the fingers (m).
    width: f64,
    target: f64,
    /// The force with which the fingers press (N), and the largest allowed force.
    force: f64,
    force_max: f64,
    /// The largest force that they can (N), and their speed (m/s).
    strength: f64,
    speed: f64,
    grasp: Grasp,
}

impl Gripper {
    /// Returns a gripper that is closed on nothing.
    pub(super) fn new(machine: &Machine, contact: Description) -> Self {
        Self {
            width: 0.0,
            target: 0.0,
            force: 0.0,
            force_max: machine.grip_force,
            strength: machine.grip_force,
            speed: machine.grip_speed,
            grasp: Grasp::new(contact),
        }
    }

    /// Returns whether the fingers hold the lever.
    pub fn holds(&self) -> bool {
        self.grasp.holds()
    }

    /// Returns the width between the fingers (m).
    pub const fn width(&self) -> f64 {
        self.width
    }

    /// Returns the force with which the fingers press (N).
    pub const fn force(&self) -> f64 {
        self.force
    }

    /// Sends the fingers to a width (m); they press with at most `force` (N), and with at most the force that they can exert.
    pub fn close_to(&mut self, width: f64, force: f64) {
        if !width.is_finite() || !force.is_finite() {
            return;
        }
        self.target = width.clamp(0.0, GRIP_MAX);
        self.force_max = force.clamp(0.0, self.strength);
    }

    /// Lets go of the lever.
    pub(super) fn release(&mut self) {
        self.grasp.release();
    }

    /// Returns the force and torque of the lever on the hand.
    pub(super) fn push(&mut self, hand: &Hand, handle: &Handle) -> Push {
        self.grasp.push(hand, handle)
    }

    /// Returns whether closing fingers would meet the lever.
    pub(super) fn reaches(&self, hand: &Hand, handle: &Handle) -> bool {
        self.grasp.reaches(hand, handle)
    }

    /// Lets one step pass. The fingers stop at a lever of this thickness (m) if it is between them.
    pub(super) fn step(&mut self, hand: &Hand, handle: &Handle, thickness: f64) {
        let next = towards(self.width, self.target, self.speed * DT);
        let closes = self.width > thickness && next <= thickness || self.holds() && next < thickness;
        if closes && (self.holds() || self.reaches(hand, handle)) {
            if !self.holds() {
                self.grasp.take(hand, handle);
            }
            self.width = thickness;
            self.force = towards(self.force, self.force_max, FORCE_RISE * DT);
            self.grasp.centre(hand, handle, self.force);
            return;
        }
        self.miss(next, thickness);
    }

    /// Lets one step pass without a lever between the fingers, whose thickness would be this (m).
    pub(super) fn step_without(&mut self, thickness: f64) {
        self.miss(towards(self.width, self.target, self.speed * DT), thickness);
    }

    fn miss(&mut self, next: f64, thickness: f64) {
        if next > thickness || !self.holds() {
            self.grasp.release();
        }
        self.width = next;
        self.force = if next <= 0.0 { self.force_max } else { 0.0 };
    }
}
