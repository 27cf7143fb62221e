//! A camera on the hand that finds the marks on the lever.

use super::door::Handle;
use crate::control::servoing::{CAMERA_BEHIND, IMAGE, MARKS, project};
use crate::sdk::Random;
use nalgebra::{Isometry3, Point3, Translation3, Vector3};

const PIXEL_NOISE: f64 = 0.5;
const DEPTH_NOISE: f64 = 0.03;
/// Beyond this a mark is too small to be found (m).
const DEPTH_MAX: f64 = 3.0;

/// Returns column, row (px) and depth (m) of each mark in view: in front, within the image, on the side that faces it.
pub fn look(world_from_tool: &Isometry3<f64>, handle: &Handle, random: &mut Random) -> [Option<[f64; 3]>; 4] {
    let world_from_camera = world_from_tool * Translation3::new(0.0, 0.0, -CAMERA_BEHIND);
    let depth_error = 1.0 + random.normal(DEPTH_NOISE);
    MARKS.map(|mark| {
        let (u, v) = (random.normal(PIXEL_NOISE), random.normal(PIXEL_NOISE));
        let mark = handle.world_from_handle * Point3::from(Vector3::from(mark));
        let sight = world_from_camera.translation.vector - mark.coords;
        // The marks are painted on the front of the lever.
        if sight.dot(&handle.outward) <= 0.2 * sight.norm() {
            return None;
        }
        let seen = project(&world_from_camera.inverse_transform_point(&mark).coords)?;
        let pixel = [(seen.pixel[0] + u).clamp(0.0, IMAGE[0]), (seen.pixel[1] + v).clamp(0.0, IMAGE[1])];
        (seen.depth < DEPTH_MAX).then_some([pixel[0], pixel[1], seen.depth * depth_error])
    })
}
