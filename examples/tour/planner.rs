//! Planning: the shortest way to an exhibit, by A* on a grid.

use super::museum::{EXHIBITS, Point, SIZE, clearance};
use super::{FRESH, FloorPose, PERIOD, Tour, TourLeg, start};
use controllers::sdk::{About, Arguments, Controller, In, Inputs, Kind, Outcome, Parameter, Progress, Quantity, Tick};
use std::collections::{BTreeMap, BTreeSet};

/// The edge of a cell.
const CELL: f64 = 0.2;
/// The distance that a way keeps from walls.
const MARGIN: f64 = 0.45;

/// A cell of the grid, counted from the origin of the floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Cell {
    x: i32,
    y: i32,
}

impl Cell {
    #[expect(clippy::cast_possible_truncation, reason = "a place on the floor has few cells")]
    fn of(place: Point) -> Self {
        Self { x: (place.x.clamp(0.0, SIZE.x) / CELL) as i32, y: (place.y.clamp(0.0, SIZE.y) / CELL) as i32 }
    }

    fn middle(self) -> Point {
        Point::new((f64::from(self.x) + 0.5) * CELL, (f64::from(self.y) + 0.5) * CELL)
    }

    fn is_free(self) -> bool {
        let middle = self.middle();
        let is_inside = middle.x > 0.0 && middle.y > 0.0 && middle.x < SIZE.x && middle.y < SIZE.y;
        is_inside && clearance(middle) >= MARGIN
    }

    /// The cells beside and across, each with its distance.
    fn neighbours(self) -> impl Iterator<Item = (Self, f64)> {
        let steps = (-1..=1).flat_map(|x: i32| (-1..=1).map(move |y: i32| (x, y))).filter(|step| *step != (0, 0));
        steps.map(move |(x, y)| (Self { x: self.x + x, y: self.y + y }, CELL * f64::from(x).hypot(f64::from(y))))
    }
}

/// Returns the shortest way between two places that keeps its distance from walls, as a line with few corners. None if
/// there is no such way.
pub(super) fn way(from: Point, to: Point) -> Option<Vec<Point>> {
    let goal = Cell::of(to);
    let cells = search(Cell::of(from), goal)?;
    let mut line: Vec<Point> = cells.into_iter().map(Cell::middle).collect();
    line.push(to);
    Some(straightened(from, &line))
}

/// A*: the cells from a start to a goal. The start may be near a wall.
fn search(start: Cell, goal: Cell) -> Option<Vec<Cell>> {
    let estimate = |cell: Cell| cell.middle().distance(goal.middle());
    // Costs in whole millimetres have a total order.
    #[expect(clippy::cast_possible_truncation, reason = "ways are short")]
    let millis = |cost: f64| (cost * 1000.0) as i64;
    let mut open = BTreeSet::from([(millis(estimate(start)), start)]);
    let mut best = BTreeMap::from([(start, (0.0, start))]);
    while let Some((_, cell)) = open.pop_first() {
        if cell == goal {
            let mut back = vec![goal];
            while let Some(last) = back.last().copied().filter(|last| *last != start) {
                back.push(best.get(&last)?.1);
            }
            back.reverse();
            return Some(back);
        }
        let cost = best.get(&cell)?.0;
        for (next, step) in cell.neighbours().filter(|(next, _)| next.is_free() || *next == goal) {
            let cost = cost + step;
            if best.get(&next).is_none_or(|(known, _)| cost + 1e-9 < *known) {
                best.insert(next, (cost, cell));
                open.insert((millis(cost + estimate(next)), next));
            }
        }
    }
    None
}

/// Leaves out the corners of a line that are not necessary to keep the distance from walls.
fn straightened(from: Point, line: &[Point]) -> Vec<Point> {
    let (mut at, mut kept, mut next) = (from, Vec::new(), 0);
    while next < line.len() {
        let far = (next..line.len()).rev().find(|end| is_free_between(at, line[*end])).unwrap_or(next);
        at = line[far];
        kept.push(at);
        next = far + 1;
    }
    kept
}

fn is_free_between(from: Point, to: Point) -> bool {
    let steps = (from.distance(to) / (CELL / 2.0)).ceil().max(1.0);
    let mut part = 0.0;
    while part < steps {
        part += 1.0;
        let share = part / steps;
        let place = Point::new(from.x + share * (to.x - from.x), from.y + share * (to.y - from.y));
        // The last part of a way may be near a wall, for example at a dock.
        if clearance(place) < MARGIN && place.distance(to) > 0.3 {
            return false;
        }
    }
    true
}

#[derive(Inputs)]
pub(super) struct PlanInputs {
    /// Where the robot is.
    #[port("Pose")]
    pose: In<FloorPose>,
}

/// Plans the way to the next exhibit of a tour.
pub(super) struct PlanLeg {
    dock: Point,
    tour: Tour,
}

impl Controller for PlanLeg {
    type Inputs = PlanInputs;
    type Outputs = ();
    const TYPE: &'static str = "PlanLeg";

    fn about() -> About {
        const DOCK: &[Parameter] = &[
            Parameter::new("x", Kind::Quantity(Quantity::Length, 0.0, 10.0)),
            Parameter::new("y", Kind::Quantity(Quantity::Length, 0.0, 6.0)),
        ];
        const OUTCOMES: &[Outcome] =
            &[Outcome { tag: "leg", type_name: Some("TourLeg") }, Outcome { tag: "over", type_name: None }];
        About::task("Plans the way to the next exhibit of a tour. Exhibit 0 is the dock.")
            .every(PERIOD)
            .with(DOCK)
            .starts_with::<Tour>()
            .ends_with(OUTCOMES)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let dock = Point::new(arguments.number("x"), arguments.number("y"));
        Ok(Self { dock, tour: Tour::default() })
    }

    fn init(&mut self, value: &[u8]) -> Result<(), String> {
        self.tour = start(value)?;
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &PlanInputs, (): &mut ()) -> Progress {
        if self.tour.stops.is_empty() {
            return Progress::outcome("over", &());
        }
        let Some(stop) = self.tour.next() else {
            return Progress::Aborted(format!("the museum has no exhibit {:?}", self.tour.stops));
        };
        let Some(pose) = inputs.pose.fresh_within(tick.now, FRESH) else { return Progress::Continue };
        let to = if stop == 0 { self.dock } else { EXHIBITS[stop].place };
        let Some(line) = way(Point::new(pose.x, pose.y), to) else {
            return Progress::Aborted(format!("there is no way to exhibit {stop}"));
        };
        let (x, y) = line.iter().map(|corner| (corner.x, corner.y)).unzip();
        let Tour { number, stops } = self.tour.clone();
        Progress::outcome("leg", &TourLeg { number, stops, x, y })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_way_keeps_its_distance_from_walls_and_has_no_detour() {
        let docks = [Point::new(1.0, 0.8), Point::new(2.3, 0.8)];
        let places: Vec<Point> = EXHIBITS.iter().skip(1).map(|exhibit| exhibit.place).chain(docks).collect();
        for from in &places {
            for to in &places {
                let line = way(*from, *to).unwrap();
                let (mut at, mut length) = (*from, 0.0);
                for corner in &line {
                    assert!(is_free_between(at, *corner), "{from:?} {to:?}: {line:?}");
                    length += at.distance(*corner);
                    at = *corner;
                }
                assert_eq!(at, *to);
                assert!(length < from.distance(*to) + 9.0, "{from:?} {to:?}: {length}");
            }
        }
        assert_eq!(way(places[0], Point::new(3.5, 1.0)), None, "this is in a wall");
    }
}
