//! Redundancy resolution: from one velocity of the hand to nine rates of base and arm.
//!
//! The law is a weighted, damped pseudo-inverse with a null-space motion. The base has a larger weight than the arm,
//! and the weight of a joint grows while it moves towards its limit. Near a singularity the damping grows. A command
//! that is too fast is scaled as a whole, so the hand keeps its direction. Accelerations are
//! limited. Finally the quick arm compensates for the slow base. A model of the base's lag computes
//! the missing motion of the hand, and the arm adds this motion. Without this, a stop at the handle
//! overran by 2 mm, which cost 19 N.
//!
//! The arm stands in the middle of the base, so base and joint 1 turn about one axis. If the base
//! must be steady, joint 1 makes the turn of the base. This changes neither the motion of the hand
//! nor the outline of the robot. When the robot comes to rest, the arm alone moves the hand.
//!
//! Source: Chan and Dubey, IEEE Trans. Robotics and Automation 11(2), 1995 (joint-limit weights; ours are a sixth of
//! theirs, the mean over the joints); Maciejewski and Klein, J. Robotic Systems 5(6), 1988, in the form of Chiaverini,
//! Siciliano and Egeland, IEEE Trans. Control Systems Technology 2(2), 1994 (damping by the smallest singular value);
//! Petersson, Austin, Christensen, "DCA", section 5 (the module's place).

use super::puma560::{self, Forward, Joints};
use super::ramp::towards_together;
use nalgebra::{Matrix6, SMatrix, SVector, Vector3, Vector6};

/// Base rates (x, y (m/s), yaw (rad/s), in base axes), then six joint rates (rad/s).
pub type Rates = SVector<f64, 9>;

/// Largest base speeds: x, y (m/s), yaw (rad/s).
pub const BASE_RATES_MAX: [f64; 3] = [0.5, 0.5, 0.6];
/// Largest changes of rate: base x, y (m/s²), yaw (rad/s²). All laws that move the base use these.
pub const BASE_ACCELERATION_MAX: [f64; 3] = [1.0, 1.0, 1.5];
/// Time constant of the base's drives (s).
pub const BASE_LAG: f64 = 0.08;
/// Largest change of a joint rate (rad/s²).
pub const JOINT_ACCELERATION_MAX: f64 = 6.0;

/// The two rates that turn about the vertical through the middle of the base.
const YAW: usize = 2;
const JOINT_1: usize = 3;
const WEIGHTS: [f64; 9] = [4.0, 4.0, 3.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5];
const SINGULAR_BELOW: f64 = 0.10;
const DAMPING: f64 = 0.08;
const ARM_DAMPING: f64 = 0.05;

/// The rates, with measures of how difficult the command was.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolved {
    /// The rates to command.
    pub rates: Rates,
    /// Smallest singular value of the weighted Jacobian.
    pub singular_value_min: f64,
    /// The factor by which the command was too fast; 1 if it was not.
    pub scaling: f64,
}

/// The motion that is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Velocity of the hand (m/s, rad/s, tool axes, at the grasp point).
    pub twist_in_tool: Vector6<f64>,
    /// A desired motion in the null space: it does not move the hand.
    pub null: Rates,
    /// Whether the base must not turn.
    pub steady: bool,
    /// Whether the base comes to rest, so that the arm alone moves the hand.
    pub rests: bool,
}

/// Resolves motions. It remembers the last command, for the joint-limit weights and the acceleration limits, and the
/// modelled response of the base.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Resolver {
    previous: Rates,
    base: Vector3<f64>,
}

/// Returns the whole-body Jacobian (6×9). The columns are base x, y (m/s), yaw (rad/s), then the arm (rad/s). The rows are
/// the velocity (m/s) and the angular velocity (rad/s) of the hand, along base axes.
pub fn jacobian_in_base(forward: &Forward) -> SMatrix<f64, 6, 9> {
    let mut jacobian = SMatrix::<f64, 6, 9>::zeros();
    jacobian[(0, 0)] = 1.0;
    jacobian[(1, 1)] = 1.0;
    let turning = Vector3::z().cross(&forward.base_from_tool.translation.vector);
    jacobian.fixed_view_mut::<3, 1>(0, 2).copy_from(&turning);
    jacobian[(5, 2)] = 1.0;
    jacobian.fixed_view_mut::<6, 6>(0, 3).copy_from(&forward.jacobian_in_base);
    jacobian
}

/// Returns the gradient of the joint-limit criterion; positive towards the upper limit.
fn limit_gradient(q: &Joints) -> Joints {
    let (low, high) = (puma560::lowest(), puma560::highest());
    Joints::from_fn(|i, _| {
        let (above, below) = ((high[i] - q[i]).max(1e-3), (q[i] - low[i]).max(1e-3));
        (high[i] - low[i]).powi(2) * (below - above) / (24.0 * above.powi(2) * below.powi(2))
    })
}

impl Resolver {
    /// Returns the last command.
    pub fn previous(&self) -> &Rates {
        &self.previous
    }

    /// Begins again from the rates that the robot has now.
    pub fn restart(&mut self, rates: Rates) {
        self.previous = rates;
        self.base = rates.fixed_rows::<3>(0).into();
    }

    /// Returns the rates for a motion with the joints at `q` (rad). `dt` (s) is the time since the last call.
    pub fn resolve(&mut self, q: &Joints, motion: &Motion, dt: f64) -> Resolved {
        let Motion { twist_in_tool, null, steady, rests } = motion;
        let forward = puma560::forward(q);
        let rotation = forward.base_from_tool.rotation;
        let linear = rotation * twist_in_tool.fixed_rows::<3>(0);
        let angular = rotation * twist_in_tool.fixed_rows::<3>(3);
        let twist = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
        let jacobian = jacobian_in_base(&forward);
        let gradient = limit_gradient(q);
        let inverse_weights = Rates::from_fn(|i, _| {
            let near = if i < 3 || gradient[i - 3] * self.previous[i] <= 0.0 { 0.0 } else { gradient[i - 3].abs() };
            1.0 / (WEIGHTS[i] * (1.0 + near.min(50.0)))
        });
        let weighted = SMatrix::<f64, 9, 6>::from_fn(|i, j| inverse_weights[i] * jacobian[(j, i)]);
        let gram: Matrix6<f64> = jacobian * weighted;
        // The search for eigenvalues of a matrix that is not finite never ends.
        if !gram.iter().chain(twist.iter()).chain(null.iter()).all(|number| number.is_finite()) {
            let q = if q.iter().all(|angle| angle.is_finite()) { *q } else { puma560::door_posture() };
            return Resolved { rates: self.rest(&q, dt), singular_value_min: 0.0, scaling: 1.0 };
        }
        let singular_value_min = gram.symmetric_eigenvalues().min().max(0.0).sqrt();
        let lack = (1.0 - (singular_value_min / SINGULAR_BELOW).powi(2)).max(0.0);
        let damped = gram + Matrix6::identity() * (DAMPING.powi(2) * lack);
        let Some(factor) = damped.cholesky() else {
            return Resolved { rates: self.rest(q, dt), singular_value_min, scaling: 1.0 };
        };
        let mut wanted = weighted * factor.solve(&(twist - jacobian * null)) + null;
        if *steady {
            wanted[JOINT_1] += std::mem::take(&mut wanted[YAW]);
        }
        if *rests {
            let arm = puma560::rates_for(q, twist_in_tool);
            wanted = Rates::from_fn(|i, _| if i < 3 { 0.0 } else { arm[i - 3] });
        }
        let fastest = Rates::from_fn(|i, _| if i < 3 { BASE_RATES_MAX[i] } else { puma560::RATES_MAX[i - 3] });
        let scaling = wanted.zip_map(&fastest, |rate, max| rate.abs() / max).max().max(1.0);
        Resolved { rates: self.limited(&jacobian, wanted / scaling, dt), singular_value_min, scaling }
    }

    /// Returns the next rates of a robot that comes to rest. The joints are at `q` (rad), and `dt` (s) is the time
    /// since the last call.
    pub fn rest(&mut self, q: &Joints, dt: f64) -> Rates {
        self.limited(&jacobian_in_base(&puma560::forward(q)), Rates::zeros(), dt)
    }

    fn limited(&mut self, jacobian: &SMatrix<f64, 6, 9>, wanted: Rates, dt: f64) -> Rates {
        let [x, y, yaw, before @ ..]: [f64; 9] = self.previous.into();
        let wanted_base = [wanted[0], wanted[1], wanted[2]];
        let base = towards_together(&[x, y, yaw], &wanted_base, &BASE_ACCELERATION_MAX.map(|most| most * dt));
        let base = Vector3::from(base);
        self.base += (base - self.base) * (1.0 - (-dt / BASE_LAG).exp());
        let missing = jacobian.fixed_columns::<3>(0) * (wanted.fixed_rows::<3>(0) - self.base);
        let arm: Matrix6<f64> = jacobian.fixed_columns::<6>(3).into();
        let damped = arm * arm.transpose() + Matrix6::identity() * ARM_DAMPING.powi(2);
        let help = damped.cholesky().map_or_else(Joints::zeros, |factor| arm.transpose() * factor.solve(&missing));
        let wanted = Joints::from_fn(|i, _| wanted[i + 3] + help[i]);
        let too_fast = wanted.zip_map(&Joints::from(puma560::RATES_MAX), |rate, max| rate.abs() / max).max().max(1.0);
        let arm = towards_together(&before, &(wanted / too_fast).into(), &[JOINT_ACCELERATION_MAX * dt; 6]);
        self.previous = Rates::from_fn(|i, _| if i < 3 { base[i] } else { arm[i - 3] });
        self.previous
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(twist_in_tool: Vector6<f64>, null: Rates) -> Motion {
        Motion { twist_in_tool, null, steady: false, rests: false }
    }

    #[test]
    fn what_is_not_finite_moves_nothing() {
        let q = puma560::door_posture();
        for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let (mut angles, mut twist, mut null) = (q, Vector6::zeros(), Rates::zeros());
            angles[2] = number;
            let motion_by_angles = (angles, motion(twist, null));
            twist[0] = number;
            let motion_by_twist = (q, motion(twist, null));
            null[4] = number;
            for (q, motion) in [motion_by_angles, motion_by_twist, (q, motion(Vector6::zeros(), null))] {
                let resolved = Resolver::default().resolve(&q, &motion, 0.01);
                assert_eq!(resolved.rates, Rates::zeros(), "{number}");
            }
        }
    }

    #[test]
    fn a_steady_base_leaves_its_turn_to_the_arm() {
        let q = puma560::door_posture() + Joints::new(0.4, -0.1, 0.2, 0.1, -0.2, 0.1);
        let null = Rates::from_fn(|i, _| 0.02 * (i as f64 - 4.0));
        let free = motion(Vector6::new(0.02, -0.03, 0.05, 0.05, -0.02, 0.04), null);
        let [free, steady] =
            [free, Motion { steady: true, ..free }].map(|motion| Resolver::default().resolve(&q, &motion, 3.0).rates);
        assert!(steady[YAW].abs() <= 0.0 && free[YAW].abs() > 0.01, "{free} {steady}");
        let jacobian = jacobian_in_base(&puma560::forward(&q));
        assert!((jacobian * (free - steady)).norm() < 1e-12, "the hand moves alike");
        assert!((free - steady).fixed_rows::<5>(4).norm() < 1e-12, "and so does the arm above its foot");
    }

    #[test]
    fn a_base_at_rest_leaves_the_hand_to_the_arm() {
        let q = puma560::door_posture() + Joints::new(0.4, -0.1, 0.2, 0.1, -0.2, 0.1);
        let null = Rates::from_fn(|i, _| 0.02 * (i as f64 - 4.0));
        let twist = Vector6::new(0.02, -0.03, 0.01, 0.05, -0.02, 0.04);
        let rests = Motion { rests: true, ..motion(twist, null) };
        let rates = Resolver::default().resolve(&q, &rests, 3.0).rates;
        assert!(rates.fixed_rows::<3>(0).norm() <= 0.0, "{rates}");
        let arm = puma560::rates_for(&q, &twist);
        assert!((rates.fixed_rows::<6>(3) - arm).norm() < 1e-12, "{rates} {arm}");
    }

    #[test]
    fn hand_moves_as_asked_and_null_motion_stays_unnoticed() {
        let q = puma560::door_posture() + Joints::new(0.1, -0.1, 0.2, 0.1, -0.2, 0.1);
        let twist = Vector6::new(0.02, -0.03, 0.01, 0.05, -0.02, 0.04);
        let null = Rates::from_fn(|i, _| 0.02 * (i as f64 - 4.0));
        // Three seconds of acceleration reach any rate and let the base follow, so only rounding is left: 1e-9.
        let rates = Resolver::default().resolve(&q, &motion(twist, null), 3.0).rates;
        let forward = puma560::forward(&q);
        let got = jacobian_in_base(&forward) * rates;
        let inverse = forward.base_from_tool.rotation.inverse();
        assert!((inverse * got.fixed_rows::<3>(0) - twist.fixed_rows::<3>(0)).norm() < 1e-9);
        assert!((inverse * got.fixed_rows::<3>(3) - twist.fixed_rows::<3>(3)).norm() < 1e-9);
    }

    #[test]
    fn the_arm_makes_up_for_the_base() {
        // The hand shall start to move at once, though the base cannot: ten steps of 10 ms, a base with the model's
        // lag.
        let (q, twist) = (puma560::door_posture(), Vector6::new(0.0, 0.0, 0.03, 0.0, 0.0, 0.0));
        let (mut resolver, mut base) = (Resolver::default(), Vector3::zeros());
        let mut rates = Rates::zeros();
        for _ in 0..10 {
            rates = resolver.resolve(&q, &motion(twist, Rates::zeros()), 0.01).rates;
            base += (rates.fixed_rows::<3>(0) - base) * (1.0 - (-0.01f64 / BASE_LAG).exp());
        }
        let forward = puma560::forward(&q);
        rates.fixed_rows_mut::<3>(0).copy_from(&base);
        let got = forward.base_from_tool.rotation.inverse() * (jacobian_in_base(&forward) * rates).fixed_rows::<3>(0);
        // The damping of the arm's inverse leaves two per cent.
        assert!((got.z - 0.03).abs() < 6e-4, "{got}");
    }

    #[test]
    fn too_fast_keeps_its_direction_and_starts_gently() {
        let twist = Vector6::new(3.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let q = puma560::door_posture();
        let resolved = Resolver::default().resolve(&q, &motion(twist, Rates::zeros()), 10.0);
        assert!(resolved.scaling > 1.0);
        let got = jacobian_in_base(&puma560::forward(&q)) * resolved.rates * resolved.scaling;
        assert!((got.norm() - 3.0).abs() < 1e-9);
        let first = Resolver::default().resolve(&q, &motion(twist, Rates::zeros()), 0.01).rates;
        assert!(first.iter().skip(3).all(|rate| rate.abs() <= 0.06 + 1e-12));
        // From rest, the base accelerates in the direction in which it will go.
        let (first, wanted) = (first.fixed_rows::<3>(0), resolved.rates.fixed_rows::<3>(0));
        assert!((first.normalize() - wanted.normalize()).norm() < 1e-9, "{first} {wanted}");
    }
}
