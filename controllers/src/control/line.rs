//! A straight line among points that are not all on it.
//!
//! Source: Fischler and Bolles, "Random sample consensus", CACM 24(6), 1981; total least squares by the eigenvector of
//! the scatter matrix, Pearson, Phil. Mag. 2(11), 1901.

use crate::sdk::Random;
use nalgebra::{Matrix2, Vector2, Vector3};

const TRIALS: u32 = 40;

/// A straight line: the points p with `normal · p = distance`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Unit normal, pointing from the origin to the line.
    pub normal: Vector2<f64>,
    /// Distance of the line from the origin (m), not negative.
    pub distance: f64,
    /// The number of points on the line.
    pub inliers: usize,
}

/// Returns the line that most `points` (m) lie on, to within `tolerance` (m). Returns none if fewer than ten points, or
/// less than a third of them, lie on it.
pub fn fit(points: &[Vector2<f64>], tolerance: f64, random: &mut Random) -> Option<Line> {
    let mut best: Option<Line> = None;
    for _ in 0..TRIALS {
        let (a, b) = (pick(points, random)?, pick(points, random)?);
        let Some(along) = (b - a).try_normalize(0.05) else { continue };
        let line = line(Vector2::new(-along.y, along.x), &a);
        let inliers = on(points, &line, tolerance).count();
        if best.is_none_or(|best| inliers > best.inliers) {
            best = Some(Line { inliers, ..line });
        }
    }
    let best = best.filter(|best| best.inliers >= 10 && best.inliers * 3 >= points.len())?;
    let inliers: Vec<_> = on(points, &best, tolerance).collect();
    through(&inliers).map(|(line, _)| line)
}

/// How accurately points determine their line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The number of points.
    pub count: usize,
    /// The distance from the first to the last point along the line (m).
    pub length: f64,
    /// Standard deviation of the line's direction (rad).
    pub direction: f64,
}

/// Returns the line closest to all `points` (m), and how well it is known. Returns none for fewer than three points,
/// and if a coordinate is not finite.
pub fn through(points: &[Vector2<f64>]) -> Option<(Line, Spread)> {
    let count = points.len();
    if count < 3 {
        return None;
    }
    let mean = points.iter().sum::<Vector2<f64>>() / count as f64;
    let scatter: Matrix2<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    if !scatter.iter().all(|number| number.is_finite()) {
        return None;
    }
    let eigen = scatter.symmetric_eigen();
    let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let (across, along) = (eigen.eigenvalues.min().max(0.0), eigen.eigenvalues.max());
    let (near, far) = points.iter().fold((f64::MAX, f64::MIN), |(near, far), point| {
        let at = normal.perp(point);
        (near.min(at), far.max(at))
    });
    let direction = (across / (count - 2) as f64 / along.max(1e-12)).sqrt();
    let spread = Spread { count, length: far - near, direction };
    Some((Line { inliers: count, ..line(normal, &mean) }, spread))
}

/// Returns the point where two lines meet (m); none if they are nearly parallel.
pub fn crossing(a: &Line, b: &Line) -> Option<Vector2<f64>> {
    let cross = a.normal.perp(&b.normal);
    let meet = Vector2::new(
        a.distance * b.normal.y - b.distance * a.normal.y,
        b.distance * a.normal.x - a.distance * b.normal.x,
    );
    (cross.abs() > 0.1).then(|| meet / cross)
}

fn line(normal: Vector2<f64>, point: &Vector2<f64>) -> Line {
    let distance = normal.dot(point);
    Line { normal: normal * distance.signum(), distance: distance.abs(), inliers: 0 }
}

fn on<'a>(points: &'a [Vector2<f64>], line: &Line, tolerance: f64) -> impl Iterator<Item = Vector2<f64>> + 'a {
    let line = *line;
    points.iter().copied().filter(move |p| (line.normal.dot(p) - line.distance).abs() <= tolerance)
}

fn pick(points: &[Vector2<f64>], random: &mut Random) -> Option<Vector2<f64>> {
    let count = u64::try_from(points.len()).ok().filter(|count| *count > 0)?;
    points.get(usize::try_from(random.bits() % count).ok()?).copied()
}

/// Returns the direction of a vector as seen from above; the x axis for a vertical vector.
pub fn horizontal(v: &Vector3<f64>) -> Vector2<f64> {
    v.xy().try_normalize(1e-6).unwrap_or_else(Vector2::x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_wall_behind_the_furniture() {
        let mut random = Random::new(3);
        let normal = Vector2::new(0.96, 0.28);
        let mut points: Vec<_> = (0..100)
            .map(|i| {
                let along = Vector2::new(-0.28, 0.96) * (0.01 * f64::from(i) - 0.5);
                normal * (1.2 + random.normal(0.005)) + along
            })
            .collect();
        points.extend((0..50).map(|i| Vector2::new(0.4 + 0.01 * f64::from(i), 0.2)));
        let line = fit(&points, 0.02, &mut Random::new(5)).unwrap();
        // 100 points with a deviation of 5 mm: the deviation is 0.5 mm for the distance, and 5 mm / (0.29 m · 10) for
        // the slope. The limits are four deviations.
        assert!((line.distance - 1.2).abs() < 2e-3, "{line:?}");
        assert!((line.normal - normal).norm() < 7e-3, "{line:?}");
        assert_eq!(fit(&points[..5], 0.02, &mut random), None);
    }

    #[test]
    fn points_that_are_not_finite_make_no_line() {
        for number in [f64::NAN, f64::INFINITY, f64::MAX] {
            let points = [Vector2::new(1.0, 0.0), Vector2::new(1.0, number), Vector2::new(1.0, 2.0)];
            assert_eq!(through(&points), None, "{number}");
        }
    }
}
