//! The room around the door, seen from above: its walls, its objects, and the surfaces that a laser sees.
//!
//! Corners, corridors and niches are side walls near the jambs. A surface has an echo, or it has none (glass, black
//! paint). Or it is a mirror, in which a laser sees the room once more.

use super::body::Wall;
use super::door::{Door, Side};
use nalgebra::Vector2;

/// The default distance of a side wall from the handle (m), and how far a wall extends sideways.
const FAR: f64 = 2.5;
/// The thickness of a wall at a jamb (m).
const JAMB: f64 = 0.05;
/// The rate at which a moving object goes to and fro (rad/s).
const WALK: f64 = 0.5;

/// The description of a room. A negative length means that the object is absent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Description {
    /// The distance from the latch's jamb to the side wall beside it (m).
    pub beside_latch: f64,
    /// The distance from the hinge's jamb to the side wall beside it (m).
    pub beside_hinge: f64,
    /// The length of both side walls, towards the robot (m).
    pub depth: f64,
    /// The distance from the door to the wall of the next room (m).
    pub next_wall: f64,
    /// The angle of a second leaf, which meets the first at the latch (rad).
    pub second_leaf: f64,
    /// The surfaces without echo.
    pub glass: Place,
    /// The surfaces that are mirrors.
    pub mirror: Place,
    /// An object in the room.
    pub body: Standing,
}

/// The surfaces of a kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// No surface.
    None,
    /// The walls on the side of the latch.
    Latch,
    /// The walls on the side of the hinge.
    Hinge,
    /// The walls on both sides.
    Both,
    /// The leaf.
    Leaf,
}

/// A round object that stands or walks in the room: a person, a pillar, a trolley.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// The distance before the door's wall (m).
    pub before: f64,
    /// The distance to the left of the handle, as the robot sees it (m).
    pub aside: f64,
    /// The diameter of the object (m).
    pub size: f64,
    /// How far the object walks to the left and to the right (m).
    pub walks: f64,
}

impl Default for Description {
    /// A wide room in which all surfaces are visible.
    fn default() -> Self {
        let body = Standing { before: -1.0, aside: -0.6, size: 0.3, walks: 0.0 };
        let (glass, mirror) = (Place::None, Place::None);
        Self {
            beside_latch: -1.0,
            beside_hinge: -1.0,
            depth: 4.0,
            next_wall: -1.0,
            second_leaf: -1.0,
            glass,
            mirror,
            body,
        }
    }
}

/// The look of a surface to a laser.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    /// The surface has an echo.
    Plain,
    /// The surface has no echo.
    Glass,
    /// The surface shows the room once more.
    Mirror,
}

/// A surface as seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// The two ends of the surface (m).
    pub ends: Wall,
    /// How the surface looks to a laser.
    pub surface: Surface,
}

/// The index of the leaf in [`stretches`].
pub const LEAF: usize = 6;

/// Returns the surfaces in the room (m) at `time` after the start (s): walls, jambs of 5 cm, side walls, the leaf, and
/// all other obstacles.
pub fn stretches(room: &Description, door: &Door, time: f64) -> Vec<Stretch> {
    let (hinge, mirror) = (door.hinge(), door.mirror());
    let (edge, beside) = (door.description().leaf_beyond + 0.01, door.description().radius + 0.01);
    // Coordinates as for a hinge on the left.
    let p = |x: f64, y: f64| Vector2::new(x, mirror * y);
    let distance = |from: f64, beyond: f64| if beyond < 0.0 { FAR } else { from + beyond };
    let (latch, hinged) = (distance(edge, room.beside_latch), distance(beside, room.beside_hinge));
    let stretch = |place: Place, a: Vector2<f64>, b: Vector2<f64>| {
        let is = |kind: Place| kind == place || kind == Place::Both && place != Place::Leaf && place != Place::None;
        let surface = match (is(room.glass), is(room.mirror)) {
            (true, _) => Surface::Glass,
            (_, true) => Surface::Mirror,
            _ => Surface::Plain,
        };
        Stretch { ends: (a, b), surface }
    };
    let mut all = vec![
        stretch(Place::Latch, p(0.0, -latch), p(0.0, -edge)),
        stretch(Place::Hinge, p(0.0, beside), p(0.0, hinged)),
        stretch(Place::Latch, p(0.0, -edge), p(-JAMB, -edge)),
        stretch(Place::Hinge, p(0.0, beside), p(-JAMB, beside)),
        stretch(Place::Latch, p(0.0, -latch), p(-room.depth, -latch)),
        stretch(Place::Hinge, p(0.0, hinged), p(-room.depth, hinged)),
        stretch(Place::Leaf, hinge, door.edge()),
    ];
    if room.second_leaf >= 0.0 {
        let (second, end) = door.second_leaf(room.second_leaf);
        // The second leaf replaces the wall beside the latch.
        all[0].ends = (p(0.0, -latch.max(second.y.abs())), second);
        all[2].ends = (second, second + (end - second) * 1e-3);
        all.push(stretch(Place::None, second, end));
    }
    if room.depth < FAR {
        all.push(stretch(Place::Latch, p(-room.depth, -latch), p(-room.depth, -latch - FAR)));
        all.push(stretch(Place::Hinge, p(-room.depth, hinged), p(-room.depth, hinged + FAR)));
    }
    if room.next_wall > 0.0 {
        all.push(stretch(Place::None, p(room.next_wall, -FAR), p(room.next_wall, FAR)));
    }
    let Standing { before, aside, size, walks } = room.body;
    if before >= 0.0 {
        let middle = Vector2::new(-before, aside + walks * (WALK * time).sin());
        let corner = |number: u32| {
            let (s, c) = (std::f64::consts::FRAC_PI_4 * f64::from(number)).sin_cos();
            middle + Vector2::new(c, s) * (0.5 * size)
        };
        all.extend((0..8).map(|number| stretch(Place::None, corner(number), corner(number + 1))));
    }
    all
}

/// Returns the stretches of [`stretches`], without their looks to a laser.
pub fn walls(room: &Description, door: &Door, time: f64) -> Vec<Wall> {
    stretches(room, door, time).into_iter().map(|stretch| stretch.ends).collect()
}

impl Door {
    /// Returns hinge and free edge (m) of a second leaf. It is as wide as the first leaf, meets it at the latch, and is
    /// open by `angle` (rad) in the same direction.
    fn second_leaf(&self, angle: f64) -> Wall {
        let is = self.description();
        let width = is.radius + is.leaf_beyond;
        let other = match is.side {
            Side::Left => Side::Right,
            Side::Right => Side::Left,
        };
        let mut second = Self::new(super::door::Description { side: other, ..*is });
        second.angle = angle;
        let shift = Vector2::new(0.0, -self.mirror() * (is.leaf_beyond + width + 0.02 - is.radius));
        let (hinge, along) = (second.hinge() + shift, second.edge() - second.hinge());
        (hinge, hinge + along)
    }
}

#[cfg(test)]
mod tests {
    use super::super::door::Description as Leaf;
    use super::*;

    fn ends(room: &Description, side: Side) -> Vec<Wall> {
        walls(room, &Door::new(Leaf { side, ..Leaf::default() }), 0.0)
    }

    #[test]
    fn side_walls_stand_beside_their_jambs_on_either_hand() {
        for (side, mirror) in [(Side::Left, 1.0), (Side::Right, -1.0)] {
            let room = Description { beside_latch: 0.2, beside_hinge: 0.3, depth: 1.0, ..Description::default() };
            let all = ends(&room, side);
            assert!((all[4].0 - Vector2::new(0.0, mirror * -0.29)).norm() < 1e-12, "{:?}", all[4]);
            assert!((all[5].1 - Vector2::new(-1.0, mirror * 1.13)).norm() < 1e-12, "{:?}", all[5]);
            assert!((all[8].1 - Vector2::new(-1.0, mirror * 3.63)).norm() < 1e-12, "{:?}", all[8]);
        }
    }

    #[test]
    fn a_second_leaf_that_is_shut_meets_the_first() {
        for side in [Side::Left, Side::Right] {
            let all = ends(&Description { second_leaf: 0.0, ..Description::default() }, side);
            let (first, second) = (all[LEAF], all[7]);
            assert!(((second.1 - first.1).norm() - 0.02).abs() < 1e-12, "{first:?} {second:?}");
            assert!(((second.1 - second.0).norm() - 0.9).abs() < 1e-12 && second.0.x.abs() < 1e-12);
        }
    }

    #[test]
    fn what_walks_comes_back() {
        let body = Standing { before: 0.5, aside: -1.0, size: 0.3, walks: 0.4 };
        let room = Description { body, ..Description::default() };
        let middle = |time: f64| {
            let all = walls(&room, &Door::new(Leaf::default()), time);
            all[7..15].iter().map(|wall| wall.0).sum::<Vector2<f64>>() / 8.0
        };
        assert!((middle(0.0) - Vector2::new(-0.5, -1.0)).norm() < 1e-12);
        assert!((middle(std::f64::consts::PI) - Vector2::new(-0.5, -0.6)).norm() < 1e-12);
    }
}
