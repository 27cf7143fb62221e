//! Lays out boxes in boxes, the innermost first. All lengths are pixels; a place is relative to the box around.

use super::column::{Item, columns};
use super::model::{End, Unit};
use super::place::Heights;
use super::route::{Router, Routes};
use crate::check::spec::Direction;
use std::collections::{BTreeMap, BTreeSet};

/// The band with the name at the top of a box.
pub(super) const BAND: i32 = 22;
/// Where the content of a group begins.
pub(super) const TOP: i32 = BAND + 18;
/// The room around and between boxes.
pub(super) const GAP: i32 = 18;
/// The room after a line that passes by.
pub(super) const PASS_GAP: i32 = 6;
/// From one port to the next.
pub(super) const PORT_STEP: i32 = 16;
/// Boxes without connections are placed in rows of about this width.
const ROW: i32 = 640;
/// The second line of a leaf: its type.
const TYPE_LINE: i32 = 16;
/// The third line of a leaf that runs: its state.
const STATE_LINE: i32 = 16;
/// The columns for the state of a process that runs.
const STATE_WIDTH: i32 = 126;

/// A box with its place.
#[derive(Clone, Debug, Default)]
pub(super) struct Placed {
    pub(super) x: i32,
    pub(super) y: i32,
    pub(super) width: i32,
    pub(super) height: i32,
    /// Where each port is on the border.
    pub(super) ports: Vec<(i32, i32)>,
    pub(super) inner: Vec<Self>,
    /// The corners of each link, from port to port.
    pub(super) lines: Vec<Vec<(i32, i32)>>,
}

/// The columns that a text of the usual size takes.
pub(super) fn text_width(text: &str) -> i32 {
    i32::try_from(text.chars().count()).unwrap_or(1000).min(1000) * 7
}

/// The links whose labels are written, each with its distance from the port: labels of sets that share a port stand
/// side by side.
pub(super) fn labels(unit: &Unit) -> Vec<(usize, i32)> {
    let mut seen = BTreeSet::new();
    let mut indents: BTreeMap<End, i32> = BTreeMap::new();
    let mut labels = Vec::new();
    for (index, link) in unit.links.iter().enumerate() {
        if !link.label.is_empty() && seen.insert((link.from, link.set)) {
            let indent = indents.entry(link.from).or_default();
            labels.push((index, *indent));
            *indent += label_width(&link.label);
        }
    }
    labels
}

/// The columns that a label takes, with the room after it.
pub(super) fn label_width(label: &str) -> i32 {
    text_width(label) * 5 / 7 + 5
}

/// The plate with the resources of a unit; nothing if it takes none.
pub(super) fn plate(unit: &Unit) -> Option<String> {
    (!unit.resources.is_empty()).then(|| format!("using {}", unit.resources.join(", ")))
}

/// The columns of a plate, with a little room at both ends.
pub(super) fn plate_width(plate: &str) -> i32 {
    text_width(plate) * 5 / 6 + 12
}

/// Arranges a unit and everything inside it.
pub(super) fn layout(unit: &Unit, hosts: &[String]) -> Placed {
    if unit.is_group { group(unit, hosts) } else { leaf(unit, hosts) }
}

fn head_width(unit: &Unit, hosts: &[String]) -> i32 {
    let host = hosts.get(unit.host).map_or(0, |host| text_width(host));
    let kind = if unit.is_group { text_width(&unit.kind) + 12 } else { 0 };
    let state = if unit.is_group && unit.key.is_some() { STATE_WIDTH } else { 0 };
    let head = text_width(&unit.name) + kind + host + state + if unit.is_service { 46 } else { 30 };
    head.max(plate(unit).map_or(0, |plate| plate_width(&plate) + 16))
}

fn names_width(unit: &Unit, direction: Direction) -> i32 {
    let names = unit.ports.iter().filter(|port| port.direction == direction).map(|port| text_width(&port.name));
    names.max().unwrap_or(0)
}

fn leaf(unit: &Unit, hosts: &[String]) -> Placed {
    let ports = names_width(unit, Direction::In) + names_width(unit, Direction::Out) + 44;
    let width = head_width(unit, hosts).max(text_width(&unit.kind) + 24).max(ports).max(96);
    let width = if unit.key.is_some() { width.max(STATE_WIDTH + 8) } else { width };
    let lines = BAND + TYPE_LINE + if unit.key.is_some() { STATE_LINE } else { 0 };
    let (mut ins, mut outs) = (0, 0);
    let places = unit.ports.iter().map(|port| {
        let (x, row) = if port.direction == Direction::In { (0, &mut ins) } else { (width, &mut outs) };
        *row += 1;
        (x, lines + 6 + (*row - 1) * PORT_STEP + PORT_STEP / 2)
    });
    let ports = places.collect();
    let height = lines + 12 + ins.max(outs) * PORT_STEP;
    Placed { width, height, ports, ..Placed::default() }
}

fn group(unit: &Unit, hosts: &[String]) -> Placed {
    let mut inner: Vec<Placed> = unit.units.iter().map(|unit| layout(unit, hosts)).collect();
    let columns = columns(unit);
    let heights = Heights::new(&columns, &unit.links, &inner);
    let margins = (names_width(unit, Direction::In), names_width(unit, Direction::Out));
    let Routes { xs, width, bottom, border, lines } = Router::new(unit, &columns, &heights, &inner).routes(margins);
    let tops = heights.tops;
    for (&member, &column) in &columns.of {
        let (left, room) = xs[column];
        inner[member].x = left + (room - inner[member].width) / 2;
        inner[member].y = tops[column][&Item::Unit(member)];
    }
    let mut placed = Placed { ports: border, inner, lines, ..Placed::default() };
    let is_apart = |member: &usize| !columns.of.contains_key(member);
    let apart: Vec<usize> = (0..unit.units.len()).filter(is_apart).collect();
    let start = if columns.of.is_empty() { TOP } else { bottom + GAP };
    let (row_width, bottom) = rows(&mut placed.inner, &apart, start, width.max(ROW));
    placed.width = width.max(row_width).max(head_width(unit, hosts)).max(160);
    placed.height = bottom + GAP;
    for (place, port) in placed.ports.iter_mut().zip(&unit.ports) {
        place.0 = if port.direction == Direction::In { 0 } else { placed.width };
    }
    // Lines to the right border end on it, even if the box has become wider.
    for (line, link) in placed.lines.iter_mut().zip(&unit.links) {
        if let (None, Some(last)) = (link.to.unit, line.last_mut()) {
            last.0 = placed.width;
        }
    }
    placed
}

/// Puts boxes side by side in rows; returns how wide the rows are and where the last one ends.
fn rows(inner: &mut [Placed], members: &[usize], start: i32, width: i32) -> (i32, i32) {
    let (mut x, mut y, mut row_bottom, mut widest) = (GAP, start, start, 0);
    for &member in members {
        let placed = &mut inner[member];
        if x > GAP && x + placed.width + GAP > width {
            (x, y) = (GAP, row_bottom + GAP);
        }
        (placed.x, placed.y) = (x, y);
        x += placed.width + GAP;
        row_bottom = row_bottom.max(y + placed.height);
        widest = widest.max(x);
    }
    (widest, if members.is_empty() { start.max(TOP) - if start > TOP { GAP } else { 0 } } else { row_bottom })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Plan;
    use crate::{Options, Source, activities_of_plan, compile, graph, graph_of_activity, graph_of_plan};
    use std::path::Path;

    /// Checks the pictures of a plan; returns how many there are.
    fn check_live(path: &str, plan: &Plan) -> usize {
        let activities = activities_of_plan(plan).filter_map(|(group, _)| graph_of_activity(plan, group).ok()?);
        let graphs: Vec<_> = graph_of_plan(plan).into_iter().chain(activities).collect();
        graphs.iter().for_each(|graph| check(path, &graph.root, &layout(&graph.root, &graph.hosts)));
        let root = super::super::plan::unit(plan);
        for (number, wire) in (0_u32..).zip(&plan.wires) {
            let ends = [&wire.from, &wire.to].map(|end| plan.leaves[end.leaf as usize].path.split('/'));
            let [from, to] = ends.map(Iterator::collect::<Vec<_>>);
            let common = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
            // One arrow between the two members of the innermost common group, and one inside each border that is crossed.
            let crossed = (from.len() - common).saturating_sub(1) + (to.len() - common).saturating_sub(1);
            let is_own = from == to;
            assert_eq!(arrows(&root, number), if is_own { 1 } else { 1 + crossed }, "{path}: {}", plan.ends(wire));
        }
        graphs.len()
    }

    /// How many arrows a wire runs along.
    fn arrows(unit: &Unit, wire: u32) -> usize {
        let own = unit.links.iter().filter(|link| link.wires.contains(&wire)).count();
        own + unit.units.iter().map(|inner| arrows(inner, wire)).sum::<usize>()
    }

    fn check(path: &str, unit: &Unit, placed: &Placed) {
        let path = format!("{path}/{}", unit.name);
        assert_eq!(unit.units.len(), placed.inner.len());
        for (index, one) in placed.inner.iter().enumerate() {
            assert!(one.x >= 0 && one.x + one.width <= placed.width, "{path} is too narrow");
            assert!(one.y > BAND && one.y + one.height <= placed.height, "{path} is too low");
            for other in &placed.inner[index + 1..] {
                let is_beside = one.x + one.width <= other.x || other.x + other.width <= one.x;
                let is_below = one.y + one.height <= other.y || other.y + other.height <= one.y;
                assert!(is_beside || is_below, "boxes overlap in {path}");
            }
        }
        for (link, line) in unit.links.iter().zip(&placed.lines) {
            let place = |end: End| match end.unit {
                None => placed.ports[end.port],
                Some(slot) => {
                    let inner = &placed.inner[slot];
                    (inner.x + inner.ports[end.port].0, inner.y + inner.ports[end.port].1)
                }
            };
            let (from, to) = (place(link.from), place(link.to));
            let last = line.last().unwrap();
            assert_eq!((line.first(), last.0), (Some(&from), to.0), "{path}: {link:?}");
            assert!((last.1 - to.1).abs() < PORT_STEP / 2, "{path}: {link:?}");
            for pair in line.windows(2) {
                assert!(pair[0].0 == pair[1].0 || pair[0].1 == pair[1].1, "{path}: {link:?} is not straight: {line:?}");
            }
        }
        // Two overlapping lines look like one, unless they come from one port.
        let drawn: Vec<_> = unit.links.iter().zip(&placed.lines).collect();
        for (index, (link, line)) in drawn.iter().enumerate() {
            for (other, others) in drawn[..index].iter().filter(|(other, _)| other.from != link.from) {
                let shared = line.windows(2).find(|one| others.windows(2).any(|two| are_over_each_other(one, two)));
                assert_eq!(shared, None, "{path}: {link:?} and {other:?}");
            }
        }
        for (unit, placed) in unit.units.iter().zip(&placed.inner) {
            check(&path, unit, placed);
        }
    }

    /// Whether two straight pieces have more than a point in common.
    fn are_over_each_other(one: &[(i32, i32)], two: &[(i32, i32)]) -> bool {
        let range = |a: i32, b: i32| (a.min(b), a.max(b));
        let share = |one: (i32, i32), two: (i32, i32)| one.0.max(two.0) < one.1.min(two.1);
        let (ys, xs) = (
            |piece: &[(i32, i32)]| range(piece[0].1, piece[1].1),
            |piece: &[(i32, i32)]| range(piece[0].0, piece[1].0),
        );
        let lie = |a: (i32, i32), b: (i32, i32)| a == b && a.0 == a.1;
        lie(ys(one), ys(two)) && share(xs(one), xs(two)) || lie(xs(one), xs(two)) && share(ys(one), ys(two))
    }

    #[test]
    fn boxes_hold_their_parts_and_arrows_end_at_ports() {
        let (mut drawn, mut live) = (0, 0);
        for folder in ["tests/corpus", "tests/graph", "../specs"] {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
            for path in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
                let read = |path: &Path| Source::new(path.to_string_lossy(), std::fs::read_to_string(path).unwrap());
                if path.extension().is_none_or(|extension| extension != "dca") {
                    continue;
                }
                let interface = path.with_extension("interface");
                let interfaces = if interface.exists() { vec![read(&interface)] } else { Vec::new() };
                if let (Some(graph), _) = graph(&read(&path), &interfaces, &Options::named("a")) {
                    check(&path.to_string_lossy(), &graph.root, &layout(&graph.root, &graph.hosts));
                    drawn += 1;
                }
                let name = path.to_string_lossy();
                if let Some(plan) = compile(&read(&path), &interfaces, &Options::named("a")).plan {
                    live += check_live(&name, &plan);
                }
            }
        }
        assert!(drawn > 10 && live > drawn, "{drawn} {live}");
    }
}
