//! Assigns members to columns and orders them, so that arrows lead from left to right and rarely cross.

use super::model::{End, Link, Unit};
use std::collections::BTreeMap;

/// How often the order within columns is improved, in each direction.
const SWEEPS: usize = 4;

/// Larger groups are not sorted, because their picture is unreadable and sorting could take minutes.
const SORTED_MAX: usize = 300;

/// Arrows that start at one port in one set. They are drawn as one line that forks.
#[derive(Clone, Debug)]
pub(super) struct Net {
    pub(super) from: End,
    /// Indices of the links.
    pub(super) links: Vec<usize>,
}

/// An item that needs space in a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Item {
    /// A member.
    Unit(usize),
    /// A net that passes the column.
    Pass(usize),
}

/// The members of a group in columns.
#[derive(Debug)]
pub(super) struct Columns {
    /// The items of each column from top to bottom.
    pub(super) items: Vec<Vec<Item>>,
    /// The column of each connected member.
    pub(super) of: BTreeMap<usize, usize>,
    pub(super) nets: Vec<Net>,
}

/// Arranges the connected members.
pub(super) fn columns(unit: &Unit) -> Columns {
    let nets = nets(&unit.links);
    let order = order(unit);
    let place: BTreeMap<usize, usize> = order.iter().enumerate().map(|(place, &member)| (member, place)).collect();
    let inner: Vec<(usize, usize)> = unit
        .links
        .iter()
        .filter_map(|link| link.from.unit.zip(link.to.unit))
        .filter(|(from, to)| place[from] < place[to])
        .collect();
    let mut of: BTreeMap<usize, usize> = BTreeMap::new();
    for &member in &order {
        let before = inner.iter().filter(|(_, to)| *to == member).filter_map(|(from, _)| of.get(from));
        let column = before.map(|column| column + 1).max().unwrap_or(0);
        of.insert(member, column);
    }
    // A source is placed next to the members that receive its values.
    for &member in order.iter().rev() {
        let has_before = inner.iter().any(|(_, to)| *to == member);
        let after = inner.iter().filter(|(from, _)| *from == member).map(|(_, to)| of[to]).min();
        if let (false, Some(after)) = (has_before, after) {
            of.insert(member, after.saturating_sub(1));
        }
    }
    let count = of.values().max().map_or(0, |last| last + 1);
    let mut items: Vec<Vec<Item>> = vec![Vec::new(); count];
    for (&member, &column) in &of {
        items[column].push(Item::Unit(member));
    }
    for (index, net) in nets.iter().enumerate() {
        for column in passes(net, &unit.links, &of, count) {
            items[column].push(Item::Pass(index));
        }
    }
    let mut columns = Columns { items, of, nets };
    columns.sort(unit);
    columns
}

fn nets(links: &[Link]) -> Vec<Net> {
    let mut nets: Vec<Net> = Vec::new();
    let mut known: BTreeMap<(End, Option<usize>), usize> = BTreeMap::new();
    for (index, link) in links.iter().enumerate() {
        let net = *known.entry((link.from, link.set)).or_insert(nets.len());
        match nets.get_mut(net) {
            Some(net) => net.links.push(index),
            None => nets.push(Net { from: link.from, links: vec![index] }),
        }
    }
    nets
}

/// Returns the connected members in an order in which most arrows lead forward. A very large group has the order of the
/// text.
fn order(unit: &Unit) -> Vec<usize> {
    let inner: Vec<(usize, usize)> = unit.links.iter().filter_map(|link| link.from.unit.zip(link.to.unit)).collect();
    let ends = unit.links.iter().flat_map(|link| [link.from.unit, link.to.unit]).flatten();
    let mut left: std::collections::BTreeSet<usize> = ends.collect();
    if left.len() > SORTED_MAX {
        return left.into_iter().collect();
    }
    let mut order = Vec::with_capacity(left.len());
    while !left.is_empty() {
        let count = |member: usize, is_in: bool| {
            let touches = |&&(from, to): &&(usize, usize)| {
                let (own, other) = if is_in { (to, from) } else { (from, to) };
                own == member && other != member && left.contains(&other)
            };
            inner.iter().filter(touches).count()
        };
        // First comes a member without incoming arrows. Otherwise, it is a member that sends more than it receives, or
        // else the first.
        let best = left.iter().copied().min_by_key(|&member| {
            let ins = count(member, true);
            let balance = ins.saturating_sub(count(member, false));
            if ins == 0 { (0, 0, member) } else { (1, balance, member) }
        });
        let Some(best) = best else { break };
        left.remove(&best);
        order.push(best);
    }
    order
}

/// Returns the columns that a net passes.
fn passes(net: &Net, links: &[Link], of: &BTreeMap<usize, usize>, count: usize) -> std::ops::Range<usize> {
    let first = net.from.unit.map_or(0, |member| of[&member] + 1);
    let last = net.links.iter().map(|&link| links[link].to.unit.map_or(count, |member| of[&member])).max();
    first..last.unwrap_or(first).max(first)
}

impl Columns {
    /// Orders each column by the places of the connected items.
    fn sort(&mut self, unit: &Unit) {
        for sweep in 0..SWEEPS * 2 {
            let is_forward = sweep % 2 == 0;
            let count = self.items.len();
            for step in 1..count {
                let column = if is_forward { step } else { count - 1 - step };
                let other = if is_forward { column - 1 } else { column + 1 };
                let places: BTreeMap<Item, usize> =
                    self.items[other].iter().enumerate().map(|(place, &item)| (item, place)).collect();
                let mut keyed: Vec<(usize, Item)> = self.items[column]
                    .iter()
                    .enumerate()
                    .map(|(place, &item)| (self.centre(unit, item, &places).unwrap_or(place * 1000), item))
                    .collect();
                keyed.sort_by_key(|&(centre, _)| centre);
                self.items[column] = keyed.into_iter().map(|(_, item)| item).collect();
            }
        }
    }

    /// Returns the mean place of the items in the next column that are connected with this item, in thousandths.
    fn centre(&self, unit: &Unit, item: Item, places: &BTreeMap<Item, usize>) -> Option<usize> {
        let mut found = Vec::new();
        for (index, net) in self.nets.iter().enumerate() {
            let mut ends = vec![net.from.unit.map(Item::Unit), Some(Item::Pass(index))];
            ends.extend(net.links.iter().map(|&link| unit.links[link].to.unit.map(Item::Unit)));
            let ends: Vec<Item> = ends.into_iter().flatten().collect();
            if ends.contains(&item) {
                found.extend(ends.iter().filter(|&&end| end != item).filter_map(|end| places.get(end)));
            }
        }
        (!found.is_empty()).then(|| found.iter().map(|&&place| place * 1000).sum::<usize>() / found.len())
    }
}
