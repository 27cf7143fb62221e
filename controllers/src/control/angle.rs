//! Angles in the plane.

/// Returns the same direction as `angle` (rad), in [-π, π].
pub fn wrapped(angle: f64) -> f64 {
    angle.sin().atan2(angle.cos())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    #[test]
    fn a_turn_more_or_less_is_the_same_direction() {
        for turns in [-2.0, -1.0, 0.0, 1.0, 2.0] {
            for angle in [-3.0, -1.0, 0.0, 1e-9, 2.5] {
                assert!((wrapped(angle + turns * TAU) - angle).abs() < 1e-14, "{angle} and {turns} turns");
            }
        }
        assert!((wrapped(1.5 * PI) + 0.5 * PI).abs() < 1e-15);
    }
}
