//! A camera on the hand that finds the marks on the lever.
//!
//! The mounting and the focal length are the true ones. The values that a controller assumes belong to the controller.

use super::door::Handle;
use crate::control::servoing::MARKS;
use crate::sdk::Random;
use nalgebra::{Isometry3, Point3, Vector3};

/// A mark further away than this is too small to be found (m).
const DEPTH_MAX: f64 = 3.0;
/// A mark closer than this is not sharp (m).
const DEPTH_MIN: f64 = 0.02;
/// Width and height of the image (px); its centre is the principal point.
const IMAGE: [f64; 2] = [640.0, 480.0];

/// A camera with its true mounting.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Pose of the camera in the tool frame (m), z along the optical axis.
    pub tool_from_camera: Isometry3<f64>,
    /// Focal length (px).
    pub focal: f64,
    /// The noise of a row or column (px, standard deviation).
    pub pixel_noise: f64,
    /// The noise of the depths of one image, as a share of the depth (standard deviation).
    pub depth_noise: f64,
}

impl Camera {
    /// Returns column, row (px) and depth (m) of each mark in view: in front of the camera, within the image, and on
    /// the side of the lever that faces the camera.
    pub fn look(
        &self,
        world_from_tool: &Isometry3<f64>,
        handle: &Handle,
        random: &mut Random,
    ) -> [Option<[f64; 3]>; 4] {
        let world_from_camera = world_from_tool * self.tool_from_camera;
        let depth_error = 1.0 + random.normal(self.depth_noise);
        MARKS.map(|mark| {
            let (u, v) = (random.normal(self.pixel_noise), random.normal(self.pixel_noise));
            let mark = handle.world_from_handle * Point3::from(Vector3::from(mark));
            let sight = world_from_camera.translation.vector - mark.coords;
            // The marks are painted on the front of the lever.
            if sight.dot(&handle.outward) <= 0.2 * sight.norm() {
                return None;
            }
            let ([x, y], depth) = self.project(&world_from_camera.inverse_transform_point(&mark).coords)?;
            let pixel = [(x + u).clamp(0.0, IMAGE[0]), (y + v).clamp(0.0, IMAGE[1])];
            (depth < DEPTH_MAX).then_some([pixel[0], pixel[1], depth * depth_error])
        })
    }

    /// Returns the place in the image (px) and the depth (m) of a point of the camera frame (m), if the camera sees it.
    fn project(&self, point: &Vector3<f64>) -> Option<([f64; 2], f64)> {
        if point.z < DEPTH_MIN {
            return None;
        }
        let pixel = [point.x / point.z * self.focal + IMAGE[0] / 2.0, point.y / point.z * self.focal + IMAGE[1] / 2.0];
        let inside = pixel.iter().zip(IMAGE).all(|(p, size)| (0.0..size).contains(p));
        inside.then_some((pixel, point.z))
    }
}

#[cfg(test)]
mod tests {
    use super::super::door::{Description, Door};
    use super::*;

    #[test]
    fn a_longer_lens_and_a_shifted_mount_move_the_image_as_a_pinhole_does() {
        let handle = Door::new(Description::default()).handle();
        let world_from_tool = handle.world_from_handle * Isometry3::translation(0.0, 0.0, -0.3);
        let look = |shift: f64, focal: f64| {
            let tool_from_camera = Isometry3::translation(shift, 0.0, 0.0);
            let camera = Camera { tool_from_camera, focal, pixel_noise: 0.0, depth_noise: 0.0 };
            camera.look(&world_from_tool, &handle, &mut Random::new(1)).map(|mark| mark.expect("it is in view"))
        };
        let (plain, shifted, longer) = (look(0.0, 600.0), look(0.006, 600.0), look(0.0, 612.0));
        for i in 0..4 {
            // A pinhole: 6 mm at 0.3 m are 600 · 0.02 = 12 px; 2 % more focal length are 2 % more off the centre.
            assert!((plain[i][0] - shifted[i][0] - 12.0).abs() < 1e-9);
            assert!(((longer[i][0] - 320.0) / (plain[i][0] - 320.0) - 1.02).abs() < 1e-9);
            assert!((plain[i][2] - 0.3).abs() < 1e-12);
        }
    }
}
