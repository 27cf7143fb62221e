//! Routes arrows in straight pieces through the channels between columns. Each net has its own lane in each channel
//! where it changes its height. Nets that lead backwards are drawn below all boxes.

use super::column::{Columns, Item};
use super::layout::{PORT_STEP, Placed, TOP, label_width, labels};
use super::model::{End, Unit};
use super::place::{Heights, offset};
use crate::check::spec::Direction;
use std::collections::{BTreeMap, BTreeSet};

/// The distance between two lanes.
const LANE: i32 = 9;
/// The distance between nets that end at one port, if there is enough space.
const FAN_STEP: i32 = 3;
/// The space for all nets that end at one port. It is less than the distance between two ports.
const FAN: i32 = PORT_STEP - 4;
/// The space between boxes and the nearest lane.
const MARGIN: i32 = 14;

/// The places of a group's columns and arrows.
pub(super) struct Routes {
    /// The left edge and the width of each column.
    pub(super) xs: Vec<(i32, i32)>,
    pub(super) width: i32,
    pub(super) bottom: i32,
    /// The places of the group's own ports.
    pub(super) border: Vec<(i32, i32)>,
    /// The corners of each link.
    pub(super) lines: Vec<Vec<(i32, i32)>>,
}

/// A change of height in a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Turn {
    /// The turn of a net that continues to the right.
    Net(usize),
    /// The turn down to a lane below the boxes.
    Out(usize),
    /// The turn up from that lane.
    Back(usize),
}

pub(super) struct Router<'a> {
    unit: &'a Unit,
    columns: &'a Columns,
    heights: &'a Heights<'a>,
    inner: &'a [Placed],
    /// The height of each port of the group itself.
    border: Vec<i32>,
    /// How far above or below its port a net ends. This is for nets that share their port with other nets.
    fan: BTreeMap<(End, usize), i32>,
}

impl<'a> Router<'a> {
    pub(super) fn new(unit: &'a Unit, columns: &'a Columns, heights: &'a Heights<'a>, inner: &'a [Placed]) -> Self {
        let border = vec![TOP; unit.ports.len()];
        let mut router = Self { unit, columns, heights, inner, border, fan: BTreeMap::new() };
        for direction in [Direction::In, Direction::Out] {
            let ports = (0..unit.ports.len()).filter(|&port| unit.ports[port].direction == direction);
            let mut wishes: Vec<(i32, usize)> = ports.map(|port| (router.wish(port), port)).collect();
            wishes.sort_unstable();
            let mut next = i32::MIN;
            for (wish, port) in wishes {
                router.border[port] = wish.max(next);
                next = router.border[port] + PORT_STEP;
            }
        }
        router.fan = router.fans();
        router
    }

    /// Returns the ends of nets that share a port. They end next to each other, in the order in which they arrive,
    /// because nets on top of each other would look like one line.
    fn fans(&self) -> BTreeMap<(End, usize), i32> {
        let mut ends: BTreeMap<End, BTreeSet<(bool, i32, usize)>> = BTreeMap::new();
        for (index, net) in self.columns.nets.iter().enumerate() {
            for &link in &net.links {
                let to = self.unit.links[link].to;
                let before = self.channels(to, false).checked_sub(1).and_then(|column| self.pass(index, column));
                let from = before.unwrap_or_else(|| self.height(net.from));
                ends.entry(to).or_default().insert((self.is_back(link), from, index));
            }
        }
        let mut fans = BTreeMap::new();
        for (end, nets) in ends {
            let last = i32::try_from(nets.len()).unwrap_or(i32::MAX).saturating_sub(1);
            let step = (FAN / last.max(1)).clamp(1, FAN_STEP);
            for (place, (.., net)) in (0..).zip(nets) {
                // If there are too many nets, some end at the same place.
                fans.entry((end, net)).or_insert((place * step - last * step / 2).clamp(-FAN / 2, FAN / 2));
            }
        }
        fans
    }

    /// Returns the height at which a net ends at a port.
    fn arrival(&self, net: usize, end: End) -> i32 {
        self.height(end) + self.fan.get(&(end, net)).copied().unwrap_or(0)
    }

    fn count(&self) -> usize {
        self.columns.items.len()
    }

    /// Returns the height at which the arrow of a border port would be straight.
    fn wish(&self, port: usize) -> i32 {
        let border = End { unit: None, port };
        for (index, net) in self.columns.nets.iter().enumerate() {
            if net.from == border {
                let first = net.links.iter().find_map(|&link| self.in_column(self.unit.links[link].to, 0));
                return first.or_else(|| self.pass(index, 0)).unwrap_or(TOP);
            }
            if net.links.iter().any(|&link| self.unit.links[link].to == border) {
                let last = self.count().saturating_sub(1);
                return self.in_column(net.from, last).or_else(|| self.pass(index, last)).unwrap_or(TOP);
            }
        }
        TOP
    }

    fn in_column(&self, end: End, column: usize) -> Option<i32> {
        end.unit.filter(|member| self.columns.of.get(member) == Some(&column)).map(|_| self.height(end))
    }

    /// Returns the height of an end.
    fn height(&self, end: End) -> i32 {
        let Some(member) = end.unit else { return self.border[end.port] };
        let item = Item::Unit(member);
        let top = self.columns.of.get(&member).and_then(|&column| self.heights.tops[column].get(&item));
        top.copied().unwrap_or(TOP) + offset(item, end.port, self.inner)
    }

    /// Returns the height at which a net passes a column.
    fn pass(&self, net: usize, column: usize) -> Option<i32> {
        let top = self.heights.tops.get(column)?.get(&Item::Pass(net))?;
        Some(top + offset(Item::Pass(net), 0, self.inner))
    }

    /// Returns the first channel to the right of a source, or the last channel to the left of a target.
    fn channels(&self, end: End, is_source: bool) -> usize {
        match end.unit {
            Some(member) => self.columns.of[&member] + usize::from(is_source),
            None if is_source => 0,
            None => self.count(),
        }
    }

    fn is_back(&self, link: usize) -> bool {
        let link = &self.unit.links[link];
        self.channels(link.to, false) < self.channels(link.from, true)
    }

    /// Returns the heights between which a net changes in a channel: the height on the left, and all heights on the
    /// right.
    fn turn(&self, net: usize, channel: usize) -> Option<(i32, Vec<i32>)> {
        let source = self.columns.nets[net].from;
        let first = self.channels(source, true);
        let forward = self.columns.nets[net].links.iter().filter(|&&link| !self.is_back(link));
        let targets: Vec<End> = forward.map(|&link| self.unit.links[link].to).collect();
        let last = targets.iter().map(|&end| self.channels(end, false)).max()?;
        if channel < first || channel > last {
            return None;
        }
        let left = if channel == first { self.height(source) } else { self.pass(net, channel - 1)? };
        let here = targets.iter().filter(|&&end| self.channels(end, false) == channel);
        let mut right: Vec<i32> = here.map(|&end| self.arrival(net, end)).collect();
        if channel < last {
            right.extend(self.pass(net, channel));
        }
        Some((left, right))
    }

    /// Returns the turns of each channel, from left to right. First come arrows that leave backwards, then falling
    /// nets, rising nets, and arrows that return from below.
    fn lanes(&self) -> Vec<Vec<Turn>> {
        let mut lanes: Vec<Vec<((i32, i32), Turn)>> = vec![Vec::new(); self.count() + 1];
        for net in 0..self.columns.nets.len() {
            for (channel, lanes) in lanes.iter_mut().enumerate() {
                let Some((left, right)) = self.turn(net, channel) else { continue };
                if right.iter().any(|&height| height != left) {
                    let falls = right.iter().sum::<i32>() > left * i32::try_from(right.len()).unwrap_or(1);
                    lanes.push((if falls { (1, -left) } else { (2, left) }, Turn::Net(net)));
                }
            }
        }
        for link in (0..self.unit.links.len()).filter(|&link| self.is_back(link)) {
            let ends = &self.unit.links[link];
            lanes[self.channels(ends.from, true)].push(((0, -self.height(ends.from)), Turn::Out(link)));
            lanes[self.channels(ends.to, false)].push(((3, self.height(ends.to)), Turn::Back(link)));
        }
        let sorted = lanes.into_iter().map(|mut lanes| {
            lanes.sort_unstable();
            lanes.into_iter().map(|(_, turn)| turn).collect()
        });
        sorted.collect()
    }

    /// Finds the path of every arrow. `margins` is the space for the names of the group's own ports.
    pub(super) fn routes(&self, margins: (i32, i32)) -> Routes {
        let lanes = self.lanes();
        let mut lane_x: BTreeMap<(usize, Turn), i32> = BTreeMap::new();
        let mut xs = Vec::new();
        let mut x = margins.0 + 8;
        for (channel, turns) in lanes.iter().enumerate() {
            x += MARGIN + self.labels_width(channel);
            for &turn in turns {
                lane_x.insert((channel, turn), x);
                x += LANE;
            }
            x += MARGIN;
            if let Some(items) = self.columns.items.get(channel) {
                let widths =
                    items.iter().map(|&item| if let Item::Unit(member) = item { self.inner[member].width } else { 0 });
                let width = widths.max().unwrap_or(0);
                xs.push((x, width));
                x += width;
            }
        }
        let back: Vec<usize> = (0..self.unit.links.len()).filter(|&link| self.is_back(link)).collect();
        let below = |link: usize| {
            let lane = back.iter().position(|&other| other == link).unwrap_or(0);
            self.lowest() + MARGIN + LANE * i32::try_from(lane).unwrap_or(0)
        };
        let lines = (0..self.unit.links.len()).map(|link| self.line(link, &xs, &lane_x, below(link))).collect();
        let bottom = back.last().map_or(self.lowest(), |&link| below(link) + 4);
        let width = x + margins.1 + 8;
        let border = self.border.iter().map(|&y| (0, y)).collect();
        Routes { xs, width, bottom, border, lines }
    }

    fn lowest(&self) -> i32 {
        self.border.iter().map(|y| y + PORT_STEP / 2).max().unwrap_or(0).max(self.heights.bottom)
    }

    /// Returns the space for the labels of arrows that start in a channel.
    fn labels_width(&self, channel: usize) -> i32 {
        let here = labels(self.unit).into_iter().map(|(link, indent)| (&self.unit.links[link], indent));
        let here = here.filter(|(link, _)| self.channels(link.from, true) == channel);
        here.map(|(link, indent)| indent + label_width(&link.label)).max().unwrap_or(0)
    }

    fn line(
        &self,
        link: usize,
        xs: &[(i32, i32)],
        lane_x: &BTreeMap<(usize, Turn), i32>,
        below: i32,
    ) -> Vec<(i32, i32)> {
        let ends = &self.unit.links[link];
        let edge = |end: End, is_source: bool| {
            end.unit.map_or(0, |member| {
                let (left, room) = xs[self.columns.of[&member]];
                let width = self.inner[member].width;
                left + (room - width) / 2 + if is_source { width } else { 0 }
            })
        };
        let net = self.columns.nets.iter().position(|net| net.links.contains(&link)).unwrap_or(0);
        let (start, end) = (self.height(ends.from), self.arrival(net, ends.to));
        let mut line = vec![(edge(ends.from, true), start)];
        let (first, last) = (self.channels(ends.from, true), self.channels(ends.to, false));
        if self.is_back(link) {
            let lane = |channel, turn| lane_x.get(&(channel, turn)).copied().unwrap_or(0);
            let (out, back) = (lane(first, Turn::Out(link)), lane(last, Turn::Back(link)));
            line.extend([(out, start), (out, below), (back, below), (back, end)]);
        } else {
            let mut y = start;
            for channel in first..=last {
                let next = if channel == last { end } else { self.pass(net, channel).unwrap_or(y) };
                if let Some(&x) = lane_x.get(&(channel, Turn::Net(net))).filter(|_| next != y) {
                    line.extend([(x, y), (x, next)]);
                }
                y = next;
            }
        }
        line.push((edge(ends.to, false), end));
        line
    }
}
