//! Image-based visual servoing to a lever handle, with the camera on the hand.
//!
//! Source: Chaumette and Hutchinson, "Visual servo control, part I", IEEE Robotics and Automation Magazine 13(4), 2006,
//! equations (10) and (11): `v = -gain L⁺ (s - s*)` with measured depths.

use nalgebra::{SMatrix, SVector, Vector3, Vector6};

/// Width and height of the image (px); its centre is the principal point.
pub const IMAGE: [f64; 2] = [640.0, 480.0];
/// The distance of the camera behind the grasp point, along the approach (m); its axes are the tool's.
pub const CAMERA_BEHIND: f64 = 0.12;
/// The marks on the lever (m, handle frame: x along the lever, z into the door, origin where it is held).
pub const MARKS: [[f64; 3]; 4] = [[-0.05, -0.015, 0.0], [-0.05, 0.015, 0.0], [0.04, -0.012, 0.0], [0.04, 0.012, 0.0]];
/// The gain far from the goal and at the goal (1/s). At 0.9, half a pixel of noise turned the hand by up to 1.7
/// degrees.
const GAIN: (f64, f64) = (0.8, 0.4);
/// The image errors at which the handle counts as far, and as reached (px).
const FAR: (f64, f64) = (40.0, 8.0);
const LINEAR_MAX: f64 = 0.15;
const ANGULAR_MAX: f64 = 0.4;
/// The largest number of steps of a singular value decomposition; some 20 are usual.
const SVD_STEPS: usize = 500;

/// The focal length of the camera, and its final distance from the handle. The calibration is measured on each robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Focal length (px).
    pub focal: f64,
    /// The distance from the camera to the lever when the hand stands before the lever (m).
    pub standoff: f64,
}

impl Default for Calibration {
    fn default() -> Self {
        Self { focal: 600.0, standoff: 0.30 }
    }
}

/// A mark as the camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Column and row (px).
    pub pixel: [f64; 2],
    /// Distance along the optical axis (m).
    pub depth: f64,
}

/// The motion for one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Servo {
    /// Velocity of the hand (m/s, rad/s, tool axes, at the grasp point).
    pub twist_in_tool: Vector6<f64>,
    /// The largest distance of a mark from its goal, along one image axis (px).
    pub error: f64,
}

/// Returns where a point of the camera frame (m) appears in the image, with the focal length `focal` (px). Returns none
/// if the point is not in front of the camera, or not within the image.
pub fn project(point_in_camera: &Vector3<f64>, focal: f64) -> Option<Mark> {
    let (x, y, depth) = (point_in_camera.x, point_in_camera.y, point_in_camera.z);
    if depth < 0.02 {
        return None;
    }
    let pixel = [x / depth * focal + IMAGE[0] / 2.0, y / depth * focal + IMAGE[1] / 2.0];
    let inside = pixel.iter().zip(IMAGE).all(|(p, size)| (0.0..size).contains(p));
    inside.then_some(Mark { pixel, depth })
}

/// The orientation in which the hand takes the lever. The fingers are symmetric, so there are two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// The tool's x axis points along the lever, away from the lever's axis.
    Along,
    /// The tool's x axis points in the opposite direction.
    Against,
}

impl Way {
    fn turned(self) -> f64 {
        match self {
            Self::Along => 1.0,
            Self::Against => -1.0,
        }
    }

    /// Returns the orientation for which the hand has to turn less.
    pub fn nearer(seen: &[Mark; 4]) -> Self {
        let column = |a: usize, b: usize| seen[a].pixel[0] + seen[b].pixel[0];
        if column(2, 3) >= column(0, 1) { Self::Along } else { Self::Against }
    }
}

/// Returns the distance of each mark from its goal (px): column and row of each mark in turn.
pub fn errors(seen: &[Mark; 4], way: Way, calibration: &Calibration) -> SVector<f64, 8> {
    let turned = way.turned();
    SVector::from_fn(|i, _| {
        let (mark, axis) = (MARKS[i / 2], i % 2);
        let wanted = turned * mark[axis] / (mark[2] + calibration.standoff);
        seen[i / 2].pixel[axis] - IMAGE[axis] / 2.0 - wanted * calibration.focal
    })
}

/// Returns the velocity that brings the four marks to their goals. If a number in the calculation is not finite, the
/// velocity is zero and the error is infinite.
pub fn servo(seen: &[Mark; 4], way: Way, calibration: &Calibration) -> Servo {
    let focal = calibration.focal;
    let mut interaction = SMatrix::<f64, 8, 6>::zeros();
    let errors = errors(seen, way, calibration) / focal;
    for (i, seen) in seen.iter().enumerate() {
        let x = (seen.pixel[0] - IMAGE[0] / 2.0) / focal;
        let y = (seen.pixel[1] - IMAGE[1] / 2.0) / focal;
        let z = seen.depth.clamp(0.2, 2.0);
        let rows = [[-1.0 / z, 0.0, x / z, x * y, -(1.0 + x * x), y], [0.0, -1.0 / z, y / z, 1.0 + y * y, -x * y, -x]];
        for (k, row) in rows.iter().enumerate() {
            interaction.set_row(2 * i + k, &nalgebra::RowVector6::from_row_slice(row));
        }
    }
    let far = ((errors.amax() * focal - FAR.1) / (FAR.0 - FAR.1)).clamp(0.0, 1.0);
    let gain = GAIN.1 + far * (GAIN.0 - GAIN.1);
    // With a number that is not finite `svd` never ends.
    if !interaction.iter().chain(errors.iter()).all(|number| number.is_finite()) {
        return Servo { twist_in_tool: Vector6::zeros(), error: f64::INFINITY };
    }
    let correction = interaction.try_svd(true, true, f64::EPSILON, SVD_STEPS).and_then(|svd| {
        let cut = svd.singular_values.max() * 1e-3;
        svd.solve(&errors, cut).ok()
    });
    let correction = correction.map_or_else(Vector6::zeros, |velocity| velocity * -gain);
    let linear = Vector3::new(correction[0], correction[1], correction[2]).map(|v| v.clamp(-LINEAR_MAX, LINEAR_MAX));
    let angular = Vector3::new(correction[3], correction[4], correction[5]).map(|w| w.clamp(-ANGULAR_MAX, ANGULAR_MAX));
    let at_grasp = linear + angular.cross(&Vector3::new(0.0, 0.0, CAMERA_BEHIND));
    Servo {
        twist_in_tool: Vector6::new(at_grasp.x, at_grasp.y, at_grasp.z, angular.x, angular.y, angular.z),
        error: errors.amax() * focal,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Translation3, UnitQuaternion};

    /// The pose of the hand after 20 s (m, rad, handle frame), from about 0.8 m away, with a camera of `focal` (px) and
    /// the `believed` calibration. Also returns the largest error in the image (px).
    fn converged(focal: f64, believed: &Calibration) -> (Isometry3<f64>, f64) {
        let camera_from_tool = Translation3::new(0.0, 0.0, CAMERA_BEHIND);
        let turn = UnitQuaternion::from_euler_angles(0.05, -0.1, 0.1);
        // The handle is the origin.
        let mut tool = Isometry3::from_parts(Vector3::new(0.1, -0.08, -0.8).into(), turn);
        let mut error = f64::MAX;
        for _ in 0..500 {
            let camera = tool * camera_from_tool.inverse();
            let place = |mark: [f64; 3]| (camera.inverse() * nalgebra::Point3::from(mark)).coords;
            let seen = MARKS.map(|mark| project(&place(mark), focal).unwrap());
            let servo = servo(&seen, Way::nearer(&seen), believed);
            error = servo.error;
            let (v, w) = (servo.twist_in_tool.fixed_rows::<3>(0) * 0.04, servo.twist_in_tool.fixed_rows::<3>(3) * 0.04);
            tool *= Isometry3::from_parts(v.into(), UnitQuaternion::from_scaled_axis(w));
        }
        (tool, error)
    }

    #[test]
    fn converges_from_a_metre() {
        let (tool, error) = converged(600.0, &Calibration::default());
        // 20 s, half of them at a gain of 0.4/s, leave e^-4 or so of 8 px.
        assert!(error < 0.3, "{error}");
        let goal = Vector3::new(0.0, 0.0, CAMERA_BEHIND - 0.30);
        assert!((tool.translation.vector - goal).norm() < 1e-3 && tool.rotation.angle() < 3e-3);
    }

    #[test]
    fn marks_that_are_not_finite_move_nothing() {
        let seen = MARKS.map(|[x, y, _]| Mark { pixel: [320.0 + 900.0 * x, 240.0 + 900.0 * y], depth: 0.5 });
        for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN] {
            for poison in [0, 1, 2] {
                let mut seen = seen;
                match poison {
                    2 => seen[1].depth = number,
                    axis => seen[1].pixel[axis] = number,
                }
                let servo = servo(&seen, Way::nearer(&seen), &Calibration::default());
                assert!(servo.twist_in_tool.iter().all(|rate| rate.is_finite()), "{number} {poison}: {servo:?}");
                assert!(poison == 2 || servo.error > 1e6, "{number} {poison}: {servo:?}");
            }
        }
    }

    /// A pinhole camera: through a longer lens a lever looks as large from further away. A measured focal length gives
    /// the right distance.
    #[test]
    fn a_focal_length_that_is_not_measured_is_a_wrong_distance() {
        for focal in [540.0, 660.0] {
            let distance = |believed| CAMERA_BEHIND - converged(focal, &believed).0.translation.z;
            let wrong = distance(Calibration::default());
            assert!((wrong - 0.30 * focal / 600.0).abs() < 2e-3, "{focal}: {wrong}");
            assert!((distance(Calibration { focal, ..Calibration::default() }) - 0.30).abs() < 1e-3, "{focal}");
            assert!((distance(Calibration { focal, standoff: 0.35 }) - 0.35).abs() < 1e-3, "{focal}");
        }
    }
}
