//! What the hand and the lever do to each other: a push before the grasp, a bushing after it.

use super::door::Handle;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Thickness of the lever between the fingers (m).
pub const LEVER_THICKNESS: f64 = 0.02;
const PUSH_STIFFNESS: f64 = 8000.0;
const PUSH_DAMPING: f64 = 40.0;
const PUSH_REACH: f64 = 0.05;
const GRASP_REACH: f64 = 0.035;
const STIFFNESS: f64 = 6000.0;
const DAMPING: f64 = 60.0;
/// Rotational, handle axes: weak about y, where the lever slips in the fingers, and about z.
const TURN_STIFFNESS: [f64; 3] = [25.0, 8.0, 6.0];
const TURN_DAMPING: f64 = 0.4;
/// The hand as the contact sees it, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hand {
    /// Pose of the grasp point.
    pub world_from_tool: Isometry3<f64>,
    /// (m/s).
    pub velocity: Vector3<f64>,
    /// (rad/s).
    pub angular: Vector3<f64>,
}

/// A force (N) and a torque (Nm) about the grasp point on the hand, world axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Push {
    /// (N).
    pub force: Vector3<f64>,
    /// (Nm).
    pub torque: Vector3<f64>,
}

/// Whether the lever is held, and how.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grasp {
    /// Hand in the handle frame, when it closed.
    held: Option<(Vector3<f64>, UnitQuaternion<f64>)>,
}

impl Grasp {
    /// Returns whether the lever is held.
    pub fn holds(&self) -> bool {
        self.held.is_some()
    }

    /// Returns whether closing fingers would meet the lever.
    pub fn reaches(hand: &Hand, handle: &Handle) -> bool {
        let offset = handle.world_from_handle.inverse_transform_point(&hand.world_from_tool.translation.vector.into());
        offset.coords.norm() < GRASP_REACH
    }

    /// Closes the fingers on the lever; they centre it across, and half along the approach.
    pub fn take(&mut self, hand: &Hand, handle: &Handle) {
        let pose = handle.world_from_handle.inv_mul(&hand.world_from_tool);
        let offset = pose.translation.vector.component_mul(&Vector3::new(1.0, 0.0, 0.3));
        self.held = Some((offset, pose.rotation));
    }

    /// Opens the fingers.
    pub fn release(&mut self) {
        self.held = None;
    }

    /// Returns what the door does to the hand; above `slip_force` (N) the lever slips out.
    pub fn push(&mut self, hand: &Hand, handle: &Handle, slip_force: f64) -> Push {
        let Some((offset, rotation)) = &self.held else { return touch(hand, handle) };
        let stretch = hand.world_from_tool.translation.vector
            - (handle.world_from_handle * nalgebra::Point3::from(*offset)).coords;
        let world_from_held = handle.world_from_handle.rotation * rotation;
        let twist = (hand.world_from_tool.rotation * world_from_held.inverse()).scaled_axis();
        let twist_in_handle = handle.world_from_handle.rotation.inverse() * twist;
        let spring = handle.world_from_handle.rotation * twist_in_handle.component_mul(&Vector3::from(TURN_STIFFNESS));
        let push = Push {
            force: -stretch * STIFFNESS - (hand.velocity - handle.velocity) * DAMPING,
            torque: -spring - (hand.angular - handle.angular) * TURN_DAMPING,
        };
        if push.force.norm() > slip_force {
            self.held = None;
        }
        push
    }
}

/// Fingertips against the lever.
fn touch(hand: &Hand, handle: &Handle) -> Push {
    let offset = hand.world_from_tool.translation.vector - handle.world_from_handle.translation.vector;
    let beyond = -offset.dot(&handle.outward);
    let beside = offset + handle.outward * beyond;
    if beyond <= 0.0 || beside.norm() > PUSH_REACH {
        return Push::default();
    }
    let closing = -(hand.velocity - handle.velocity).dot(&handle.outward);
    let force = (PUSH_STIFFNESS * beyond + PUSH_DAMPING * closing).max(0.0);
    Push { force: handle.outward * force, torque: Vector3::zeros() }
}
