//! Computes the size of a box and the places of its parts. The heights come first, column by column.

use super::column::{Columns, Item};
use super::layout::{GAP, PASS_GAP, PORT_STEP, Placed, TOP};
use super::model::{End, Link};
use std::collections::BTreeMap;

/// The heights of all items in the columns of one group.
#[derive(Debug)]
pub(super) struct Heights<'a> {
    columns: &'a Columns,
    links: &'a [Link],
    inner: &'a [Placed],
    /// The upper edge of each item of each column.
    pub(super) tops: Vec<BTreeMap<Item, i32>>,
    /// The lower edge of the lowest item.
    pub(super) bottom: i32,
}

impl<'a> Heights<'a> {
    /// Stacks the items of each column, each as close as possible to the items that it is connected with.
    pub(super) fn new(columns: &'a Columns, links: &'a [Link], inner: &'a [Placed]) -> Self {
        let count = columns.items.len();
        let mut heights = Self { columns, links, inner, tops: vec![BTreeMap::new(); count], bottom: TOP };
        for column in 0..count {
            heights.stack(column, column.checked_sub(1));
        }
        for column in (0..count.saturating_sub(1)).rev() {
            heights.stack(column, Some(column + 1));
        }
        for column in 1..count {
            heights.stack(column, Some(column - 1));
        }
        let lowest = heights.tops.iter().flat_map(|tops| tops.values()).min().copied().unwrap_or(TOP);
        for top in heights.tops.iter_mut().flat_map(|tops| tops.values_mut()) {
            *top += TOP - lowest;
        }
        let ends = heights.tops.iter().flat_map(|tops| tops.iter().map(|(&item, &top)| top + height(item, inner)));
        heights.bottom = ends.max().unwrap_or(TOP);
        heights
    }

    fn stack(&mut self, column: usize, other: Option<usize>) {
        let mut tops = BTreeMap::new();
        let mut end = i32::MIN;
        for &item in &self.columns.items[column] {
            let wish = other.and_then(|other| self.wish(item, other));
            let wish = wish.or_else(|| self.tops[column].get(&item).copied());
            let top = wish.unwrap_or(if end == i32::MIN { TOP } else { end }).max(end);
            tops.insert(item, top);
            end = top + height(item, self.inner) + if let Item::Unit(_) = item { GAP } else { PASS_GAP };
        }
        self.tops[column] = tops;
    }

    /// Returns the place of an item at which its arrows to or from another column would be straight, on average.
    fn wish(&self, item: Item, other: usize) -> Option<i32> {
        let mut wishes = Vec::new();
        for (index, net) in self.columns.nets.iter().enumerate() {
            let mut ends = vec![(end_item(net.from), net.from.port), (Some(Item::Pass(index)), 0)];
            ends.extend(net.links.iter().map(|&link| (end_item(self.links[link].to), self.links[link].to.port)));
            let own: Vec<usize> = ends.iter().filter(|(end, _)| *end == Some(item)).map(|&(_, port)| port).collect();
            for (end, port) in ends.iter().filter(|(end, _)| *end != Some(item)) {
                let Some(top) = end.and_then(|end| self.tops[other].get(&end)) else { continue };
                let there = top + end.map_or(0, |end| offset(end, *port, self.inner));
                wishes.extend(own.iter().map(|&port| there - offset(item, port, self.inner)));
            }
        }
        let count = i32::try_from(wishes.len()).ok().filter(|&count| count > 0)?;
        Some(wishes.iter().sum::<i32>() / count)
    }
}

fn end_item(end: End) -> Option<Item> {
    end.unit.map(Item::Unit)
}

/// Returns the height of an item.
pub(super) fn height(item: Item, inner: &[Placed]) -> i32 {
    match item {
        Item::Unit(member) => inner[member].height,
        Item::Pass(_) => PORT_STEP / 2,
    }
}

/// Returns the distance of a port from the upper edge of its item.
pub(super) fn offset(item: Item, port: usize, inner: &[Placed]) -> i32 {
    match item {
        Item::Unit(member) => inner[member].ports[port].1,
        Item::Pass(_) => PORT_STEP / 4,
    }
}
