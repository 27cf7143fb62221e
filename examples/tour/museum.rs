//! The museum: its walls, exhibits and tags.

/// A place on the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    pub(super) x: f64,
    pub(super) y: f64,
}

impl Point {
    pub(super) const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    pub(super) fn distance(self, other: Self) -> f64 {
        (self.x - other.x).hypot(self.y - other.y)
    }
}

/// An exhibit, with the place from which a robot explains it.
#[derive(Debug)]
pub(super) struct Exhibit {
    pub(super) place: Point,
    /// The explanation. Empty for the dock.
    pub(super) story: &'static str,
}

/// A straight wall.
#[derive(Debug)]
struct Wall {
    from: Point,
    to: Point,
}

/// The size of the floor.
pub(super) const SIZE: Point = Point::new(10.0, 6.0);
/// The greatest distance that a sonar measures.
pub(super) const SONAR_MAX: f64 = 3.0;
/// The directions of the sonars of a robot, relative to its own direction. The first looks ahead.
#[expect(clippy::approx_constant, reason = "the mounting is exact to a thousandth of a radian")]
pub(super) const SONARS: [f64; 8] = [0.0, 0.785, 1.571, 2.356, 3.142, -2.356, -1.571, -0.785];

/// The exhibits. The first is the dock, whose place differs from robot to robot.
pub(super) const EXHIBITS: [Exhibit; 5] = [
    Exhibit { place: Point::new(0.0, 0.0), story: "" },
    Exhibit { place: Point::new(1.2, 4.8), story: "this clock has gone for three hundred years" },
    Exhibit { place: Point::new(5.2, 1.0), story: "on this loom ten people made one carpet" },
    Exhibit { place: Point::new(5.2, 4.9), story: "the globe shows no south pole yet" },
    Exhibit { place: Point::new(8.7, 4.6), story: "this engine pumped water out of a mine" },
];

/// The marks on the walls that a robot can recognise.
pub(super) const TAGS: [Point; 6] = [
    Point::new(0.0, 2.0),
    Point::new(2.5, 6.0),
    Point::new(3.45, 1.5),
    Point::new(5.5, 0.0),
    Point::new(10.0, 2.0),
    Point::new(7.05, 4.5),
];

const WALLS: [Wall; 6] = [
    Wall { from: Point::new(0.0, 0.0), to: Point::new(10.0, 0.0) },
    Wall { from: Point::new(10.0, 0.0), to: Point::new(10.0, 6.0) },
    Wall { from: Point::new(10.0, 6.0), to: Point::new(0.0, 6.0) },
    Wall { from: Point::new(0.0, 6.0), to: Point::new(0.0, 0.0) },
    Wall { from: Point::new(3.5, 0.0), to: Point::new(3.5, 3.6) },
    Wall { from: Point::new(7.0, 2.4), to: Point::new(7.0, 6.0) },
];

/// Returns the distance from a place to the next wall in a direction, at most `limit`.
pub(super) fn range(from: Point, direction: f64, limit: f64) -> f64 {
    let to = Point::new(from.x + limit * direction.cos(), from.y + limit * direction.sin());
    let hits = WALLS.iter().filter_map(|wall| crossing(from, to, wall));
    limit * hits.fold(1.0, f64::min)
}

/// Returns whether no wall stands between two places. A wall at the second place does not count, because a tag hangs on it.
pub(super) fn sees(from: Point, to: Point) -> bool {
    WALLS.iter().filter_map(|wall| crossing(from, to, wall)).all(|part| part > 0.98)
}

/// Returns the distance from a place to the nearest wall.
pub(super) fn clearance(place: Point) -> f64 {
    let distance = |wall: &Wall| {
        let (x, y) = (wall.to.x - wall.from.x, wall.to.y - wall.from.y);
        let along = ((place.x - wall.from.x) * x + (place.y - wall.from.y) * y) / (x * x + y * y);
        let along = along.clamp(0.0, 1.0);
        place.distance(Point::new(wall.from.x + along * x, wall.from.y + along * y))
    };
    WALLS.iter().map(distance).fold(f64::INFINITY, f64::min)
}

/// Returns the part of the way from one place to another at which a wall is crossed.
fn crossing(from: Point, to: Point, wall: &Wall) -> Option<f64> {
    let (ax, ay) = (to.x - from.x, to.y - from.y);
    let (bx, by) = (wall.to.x - wall.from.x, wall.to.y - wall.from.y);
    let (cx, cy) = (wall.from.x - from.x, wall.from.y - from.y);
    let across = ax * by - ay * bx;
    if across.abs() < 1e-12 {
        return None; // They are parallel.
    }
    let (on_way, on_wall) = ((cx * by - cy * bx) / across, (cx * ay - cy * ax) / across);
    ((0.0..=1.0).contains(&on_way) && (0.0..=1.0).contains(&on_wall)).then_some(on_way)
}

/// Returns an angle in the range from -π to π.
pub(super) fn wrapped(angle: f64) -> f64 {
    let turns = (angle / std::f64::consts::TAU).round();
    angle - turns * std::f64::consts::TAU
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_ends_at_the_next_wall() {
        let middle = Point::new(5.0, 3.0);
        for (direction, expected) in [(0.0, 2.0), (std::f64::consts::PI, 1.5), (std::f64::consts::FRAC_PI_2, 3.0)] {
            assert!((range(middle, direction, 9.0) - expected).abs() < 1e-9, "{direction}");
        }
        assert!((range(middle, 0.0, 1.0) - 1.0).abs() < 1e-9, "no wall within the limit");
        assert!(!sees(Point::new(1.0, 1.0), Point::new(5.0, 1.0)));
        assert!(TAGS.iter().all(|tag| sees(Point::new(tag.x.clamp(0.3, 9.7), tag.y.clamp(0.3, 5.7)), *tag)));
    }

    #[test]
    fn a_robot_can_stand_at_each_exhibit() {
        for exhibit in &EXHIBITS[1..] {
            assert!(clearance(exhibit.place) > 0.5, "{exhibit:?}");
        }
    }
}
