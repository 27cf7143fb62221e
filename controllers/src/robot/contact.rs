//! What the hand and the lever do to each other: a push before the grasp, a bushing after it.

use super::door::Handle;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Rotational, handle axes: weak about y, where the lever slips in the fingers, and about z.
const TURN_STIFFNESS: [f64; 3] = [25.0, 8.0, 6.0];
const TURN_DAMPING: f64 = 0.4;

/// What hand and lever are like where they touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Description {
    /// Of a fingertip against the lever (N/m).
    pub touch_stiffness: f64,
    /// (N s/m).
    pub touch_damping: f64,
    /// How far beside its middle a fingertip still meets the lever (m).
    pub touch_reach: f64,
    /// How far from the lever's middle closing fingers still meet it (m).
    pub grasp_reach: f64,
    /// Of the lever in closed fingers (N/m).
    pub stiffness: f64,
    /// (N s/m).
    pub damping: f64,
    /// A held lever slips out at this force (N).
    pub slip_force: f64,
}

impl Default for Description {
    fn default() -> Self {
        Self {
            touch_stiffness: 8000.0,
            touch_damping: 40.0,
            touch_reach: 0.05,
            grasp_reach: 0.035,
            stiffness: 6000.0,
            damping: 60.0,
            slip_force: 160.0,
        }
    }
}

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
#[derive(Clone, Debug, PartialEq)]
pub struct Grasp {
    description: Description,
    /// Hand in the handle frame, when it closed.
    held: Option<(Vector3<f64>, UnitQuaternion<f64>)>,
}

impl Grasp {
    /// Returns open fingers.
    pub fn new(description: Description) -> Self {
        Self { description, held: None }
    }

    /// Returns whether the lever is held.
    pub fn holds(&self) -> bool {
        self.held.is_some()
    }

    /// Returns whether closing fingers would meet the lever.
    pub fn reaches(&self, hand: &Hand, handle: &Handle) -> bool {
        let offset = handle.world_from_handle.inverse_transform_point(&hand.world_from_tool.translation.vector.into());
        offset.coords.norm() < self.description.grasp_reach
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

    /// Returns what the door does to the hand; above a certain force the lever slips out.
    pub fn push(&mut self, hand: &Hand, handle: &Handle) -> Push {
        let Some((offset, rotation)) = &self.held else { return self.touch(hand, handle) };
        let Description { stiffness, damping, slip_force, .. } = self.description;
        let stretch = hand.world_from_tool.translation.vector
            - (handle.world_from_handle * nalgebra::Point3::from(*offset)).coords;
        let world_from_held = handle.world_from_handle.rotation * rotation;
        let twist = (hand.world_from_tool.rotation * world_from_held.inverse()).scaled_axis();
        let twist_in_handle = handle.world_from_handle.rotation.inverse() * twist;
        let spring = handle.world_from_handle.rotation * twist_in_handle.component_mul(&Vector3::from(TURN_STIFFNESS));
        let push = Push {
            force: -stretch * stiffness - (hand.velocity - handle.velocity) * damping,
            torque: -spring - (hand.angular - handle.angular) * TURN_DAMPING,
        };
        if push.force.norm() > slip_force {
            self.held = None;
        }
        push
    }

    /// Fingertips against the lever.
    fn touch(&self, hand: &Hand, handle: &Handle) -> Push {
        let is = &self.description;
        let offset = hand.world_from_tool.translation.vector - handle.world_from_handle.translation.vector;
        let beyond = -offset.dot(&handle.outward);
        let beside = offset + handle.outward * beyond;
        if beyond <= 0.0 || beside.norm() > is.touch_reach {
            return Push::default();
        }
        let closing = -(hand.velocity - handle.velocity).dot(&handle.outward);
        let force = (is.touch_stiffness * beyond + is.touch_damping * closing).max(0.0);
        Push { force: handle.outward * force, torque: Vector3::zeros() }
    }
}
