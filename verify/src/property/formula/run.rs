//! Searches for a run of a system that an automaton accepts and that is fair.
//!
//! A run is fair if each event that is possible infinitely often also happens infinitely often: a program is done with each of
//! its outcomes, a stop is answered, a timer elapses. Fairness does not include failures or stops of the whole: these may never
//! happen.

use super::automaton::Automaton;
use crate::explore::{Graph, Limits, Reached};
use crate::system::Label;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// How many transitions are taken between two checks of the budget.
const TURN: usize = 4096;
/// The longest cycle with all possible events that a story shows. If such a cycle is longer, the story has a shorter cycle.
const ROUND_MAX: usize = 16;

/// The observable part of a system.
pub(super) struct Seen<'s> {
    pub(super) graph: &'s Graph,
    /// For each state, the atoms that are true at a position there.
    pub(super) letters: &'s [u32],
    /// The atoms that describe the last event, as a bit set.
    pub(super) events: u32,
    /// For each state, the number of its configuration. Two states with the same configuration may differ in the last event.
    pub(super) configurations: &'s [u32],
    /// Whether a transition has to be taken infinitely often if it is possible infinitely often.
    pub(super) is_natural: &'s dyn Fn(Label) -> bool,
}

/// A run: a beginning, and a cycle that repeats for ever. The cycle is empty if nothing happens any more. Without a cycle, the rest
/// of the run does not matter.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) first: Vec<Label>,
    pub(super) again: Option<Vec<Label>>,
}

/// One event; without a label nothing happens.
#[derive(Clone, Copy, Debug)]
struct Edge {
    label: Option<Label>,
    /// The number of the edge among the edges of its configuration.
    number: u32,
    target: u32,
}

/// A system combined with an automaton.
#[derive(Default)]
struct Product {
    /// For each node, its place in the system, and the state of the automaton. A place is a state. If nothing has just happened
    /// there, its number is larger by the number of states.
    nodes: Vec<(u32, u16)>,
    parents: Vec<Option<(u32, Option<Label>)>>,
    /// For each node, where its edges begin.
    starts: Vec<usize>,
    edges: Vec<Edge>,
}

/// Returns one of the shortest accepted fair runs, if there is one.
pub(super) fn find(seen: &Seen<'_>, automaton: &Automaton, limits: &Limits<'_>) -> Result<Option<Run>, Reached> {
    let (product, free) = Product::explore(seen, automaton, limits)?;
    if let Some(node) = free {
        return Ok(Some(Run { first: product.way(node), again: None }));
    }
    let Some(round) = product.fair(seen, automaton, limits)? else { return Ok(None) };
    let entry = round.first().copied().unwrap_or(0);
    Ok(Some(Run { first: product.way(entry), again: Some(product.around(seen, automaton, entry, &round)) }))
}

impl Seen<'_> {
    fn count(&self) -> u32 {
        self.graph.store.count()
    }

    /// The state of a place.
    fn state(&self, place: u32) -> u32 {
        if place >= self.count() { place - self.count() } else { place }
    }

    fn letter(&self, place: u32) -> u32 {
        match place >= self.count() {
            true => self.letters[self.state(place) as usize] & !self.events,
            false => self.letters[place as usize],
        }
    }

    fn configuration(&self, place: u32) -> u32 {
        self.configurations[self.state(place) as usize]
    }

    /// Returns the edges of a place. If no event has to happen, one of the edges means that nothing happens.
    fn edges(&self, place: u32) -> Vec<Edge> {
        let state = self.state(place);
        let from = (0..).zip(self.graph.from(state));
        let mut edges: Vec<Edge> =
            from.map(|(number, (label, target))| Edge { label: Some(label), number, target }).collect();
        if !edges.iter().any(|edge| self.has_to_come(edge)) {
            edges.push(Edge { label: None, number: u32::MAX, target: self.count() + state });
        }
        edges
    }

    fn has_to_come(&self, edge: &Edge) -> bool {
        edge.label.is_some_and(self.is_natural)
    }
}

impl Product {
    /// Explores everything that can be reached, the nearest first. Stops at a node from which every run is accepted.
    fn explore(seen: &Seen<'_>, automaton: &Automaton, limits: &Limits<'_>) -> Result<(Self, Option<u32>), Reached> {
        let mut product = Self::default();
        let mut known: BTreeMap<(u32, u16), u32> = BTreeMap::new();
        // The state before the start is not a position.
        let starts: Vec<Edge> =
            seen.graph.from(0).map(|(label, target)| Edge { label: Some(label), number: 0, target }).collect();
        let mut open: Option<u32> = None;
        loop {
            let (edges, next) = match open {
                None => (starts.clone(), &automaton.first),
                Some(node) => {
                    let (place, state) = product.nodes[node as usize];
                    product.starts.push(product.edges.len());
                    (seen.edges(place), &automaton.states[usize::from(state)].next)
                }
            };
            for edge in &edges {
                let letter = seen.letter(edge.target);
                for &state in next.iter().filter(|state| automaton.states[usize::from(**state)].fits(letter)) {
                    let count = u32::try_from(product.nodes.len()).unwrap_or(u32::MAX);
                    let target = *known.entry((edge.target, state)).or_insert(count);
                    if target == count {
                        product.nodes.push((edge.target, state));
                        // The start is a step of the story like any other.
                        product.parents.push(Some((open.unwrap_or(u32::MAX), edge.label)));
                    }
                    if automaton.states[usize::from(state)].is_free {
                        return Ok((product, Some(target)));
                    }
                    if open.is_some() {
                        product.edges.push(Edge { target, ..*edge });
                    }
                    product.within(limits)?;
                }
            }
            let after = open.map_or(0, |node| node + 1);
            if after as usize >= product.nodes.len() {
                product.starts.push(product.edges.len());
                return Ok((product, None));
            }
            open = Some(after);
        }
    }

    fn within(&self, limits: &Limits<'_>) -> Result<(), Reached> {
        let count = self.edges.len();
        if self.nodes.len() > limits.states as usize {
            return Err(Reached::States);
        }
        // The share of a node in three lists and in the table.
        if count * size_of::<Edge>() + self.nodes.len() * 64 > limits.memory {
            return Err(Reached::Memory);
        }
        if count.is_multiple_of(TURN) && !limits.goes_on.goes_on() { Err(Reached::Time) } else { Ok(()) }
    }

    fn from(&self, node: u32) -> &[Edge] {
        &self.edges[self.starts[node as usize]..self.starts[node as usize + 1]]
    }

    /// Returns the labels of a shortest way to a node.
    fn way(&self, node: u32) -> Vec<Label> {
        let mut way = Vec::new();
        let mut at = Some(node);
        while let Some((before, label)) = at.and_then(|node| self.parents.get(node as usize).copied().flatten()) {
            way.extend(label);
            at = Some(before);
        }
        way.reverse();
        way
    }

    /// Returns the nodes of a strongly connected component that is accepted and fair, the nearest first.
    ///
    /// If a component leaves out an event that is possible infinitely often, it is searched again without the configurations in
    /// which this event is possible.
    fn fair(&self, seen: &Seen<'_>, automaton: &Automaton, limits: &Limits<'_>) -> Result<Option<Vec<u32>>, Reached> {
        let all: Vec<u32> = (0..u32::try_from(self.nodes.len()).unwrap_or(u32::MAX)).collect();
        let (mut open, mut best) = (vec![all], None::<Vec<u32>>);
        while let Some(nodes) = open.pop() {
            for mut part in self.connected(&nodes) {
                if !limits.goes_on.goes_on() {
                    return Err(Reached::Time);
                }
                part.sort_unstable();
                let fulfilled = part.iter().fold(0, |sum, &node| sum | self.fulfils(automaton, node));
                if fulfilled.count_ones() as usize != automaton.promises
                    || best.as_ref().is_some_and(|it| it[0] <= part[0])
                {
                    continue;
                }
                let unfair = self.unfair(seen, &part);
                if unfair.is_empty() {
                    best = Some(part);
                } else {
                    let place = |node: u32| self.nodes[node as usize].0;
                    part.retain(|&node| !unfair.contains(&seen.configuration(place(node))));
                    open.push(part);
                }
            }
        }
        Ok(best)
    }

    fn fulfils(&self, automaton: &Automaton, node: u32) -> u32 {
        let mask = u32::try_from((1_u64 << automaton.promises) - 1).unwrap_or(u32::MAX);
        automaton.states[usize::from(self.nodes[node as usize].1)].fulfils & mask
    }

    /// Returns the configurations of a component in which an event has to happen that leads out of it.
    fn unfair(&self, seen: &Seen<'_>, part: &[u32]) -> BTreeSet<u32> {
        let mut taken: BTreeSet<(u32, u32)> = BTreeSet::new();
        for &node in part {
            let configuration = seen.configuration(self.nodes[node as usize].0);
            let inside = self.from(node).iter().filter(|edge| part.binary_search(&edge.target).is_ok());
            taken.extend(inside.map(|edge| (configuration, edge.number)));
        }
        let mut unfair = BTreeSet::new();
        for &node in part {
            let place = self.nodes[node as usize].0;
            let configuration = seen.configuration(place);
            let all = seen.edges(place);
            if all.iter().any(|edge| seen.has_to_come(edge) && !taken.contains(&(configuration, edge.number))) {
                unfair.insert(configuration);
            }
        }
        unfair
    }

    /// Returns the strongly connected components of some nodes that contain a cycle. Source: Tarjan 1972, "Depth-first search
    /// and linear graph algorithms".
    fn connected(&self, nodes: &[u32]) -> Vec<Vec<u32>> {
        let mut search = Search { among: nodes, numbers: BTreeMap::new(), stack: Vec::new(), parts: Vec::new() };
        for &node in nodes {
            if !search.numbers.contains_key(&node) {
                search.from(self, node);
            }
        }
        let is_round = |part: &Vec<u32>| part.len() > 1 || self.from(part[0]).iter().any(|edge| edge.target == part[0]);
        search.parts.retain(is_round);
        search.parts
    }

    /// Returns a cycle through an accepted and fair component. It has every event that has to happen, if it is not too long for
    /// a reader.
    fn around(&self, seen: &Seen<'_>, automaton: &Automaton, entry: u32, part: &[u32]) -> Vec<Label> {
        let mut wanted: BTreeSet<(u32, u32)> = BTreeSet::new();
        for &node in part {
            let place = self.nodes[node as usize].0;
            let edges = seen.edges(place);
            let has_to_come = edges.iter().filter(|edge| seen.has_to_come(edge));
            wanted.extend(has_to_come.map(|edge| (seen.configuration(place), edge.number)));
        }
        let long = self.round(seen, automaton, entry, part, wanted);
        if long.len() <= ROUND_MAX { long } else { self.round(seen, automaton, entry, part, BTreeSet::new()) }
    }

    /// Returns a cycle through some nodes that fulfils every promise and takes these edges of configurations.
    fn round(
        &self,
        seen: &Seen<'_>,
        automaton: &Automaton,
        entry: u32,
        part: &[u32],
        mut wanted: BTreeSet<(u32, u32)>,
    ) -> Vec<Label> {
        let all = part.iter().fold(0, |sum, &node| sum | self.fulfils(automaton, node));
        let (mut labels, mut at, mut fulfilled) = (Vec::new(), entry, self.fulfils(automaton, entry));
        loop {
            let is_over = wanted.is_empty() && fulfilled == all;
            let is_goal = |from: u32, edge: &Edge| match is_over {
                true => edge.target == entry,
                false => {
                    let configuration = seen.configuration(self.nodes[from as usize].0);
                    wanted.contains(&(configuration, edge.number))
                        || self.fulfils(automaton, edge.target) & !fulfilled != 0
                }
            };
            let way = self.nearest(part, at, &is_goal);
            for (from, edge) in &way {
                wanted.remove(&(seen.configuration(self.nodes[*from as usize].0), edge.number));
                fulfilled |= self.fulfils(automaton, edge.target);
                labels.extend(edge.label);
                at = edge.target;
            }
            if is_over || way.is_empty() {
                return labels;
            }
        }
    }

    /// Returns the shortest way inside a component whose last edge is a goal.
    fn nearest(&self, part: &[u32], start: u32, is_goal: &dyn Fn(u32, &Edge) -> bool) -> Vec<(u32, Edge)> {
        let mut known: BTreeMap<u32, (u32, Edge)> = BTreeMap::new();
        let mut open = VecDeque::from([start]);
        while let Some(node) = open.pop_front() {
            for edge in self.from(node).iter().filter(|edge| part.binary_search(&edge.target).is_ok()) {
                if is_goal(node, edge) {
                    let (mut way, mut at) = (vec![(node, *edge)], node);
                    while let Some(&(before, edge)) = known.get(&at).filter(|_| at != start) {
                        way.push((before, edge));
                        at = before;
                    }
                    way.reverse();
                    return way;
                }
                if edge.target != start && !known.contains_key(&edge.target) {
                    known.insert(edge.target, (node, *edge));
                    open.push_back(edge.target);
                }
            }
        }
        Vec::new()
    }
}

/// A search for strongly connected components.
struct Search<'s> {
    /// In ascending order.
    among: &'s [u32],
    /// For each node that was found, its number in the order of discovery, and the lowest number that it reaches; `u32::MAX`
    /// once its component is known.
    numbers: BTreeMap<u32, (u32, u32)>,
    stack: Vec<u32>,
    parts: Vec<Vec<u32>>,
}

impl Search<'_> {
    fn from(&mut self, product: &Product, root: u32) {
        // The call stack, each entry with its next edge. Recursive calls would become as deep as the longest way.
        let mut calls = vec![(root, 0)];
        self.find(root);
        while let Some((node, next)) = calls.last_mut() {
            let node = *node;
            let Some(edge) = product.from(node).get(*next) else {
                calls.pop();
                let (number, low) = self.numbers[&node];
                if let Some((before, _)) = calls.last() {
                    self.lower(*before, low);
                }
                if number == low {
                    self.close(node);
                }
                continue;
            };
            *next += 1;
            if self.among.binary_search(&edge.target).is_err() {
                continue;
            }
            match self.numbers.get(&edge.target) {
                None => {
                    self.find(edge.target);
                    calls.push((edge.target, 0));
                }
                Some(&(_, u32::MAX)) => {}
                Some(&(number, _)) => self.lower(node, number),
            }
        }
    }

    fn find(&mut self, node: u32) {
        let number = u32::try_from(self.numbers.len()).unwrap_or(u32::MAX);
        self.numbers.insert(node, (number, number));
        self.stack.push(node);
    }

    fn lower(&mut self, node: u32, low: u32) {
        if let Some((_, own)) = self.numbers.get_mut(&node) {
            *own = low.min(*own);
        }
    }

    /// Makes a component of the nodes on the stack down to this one.
    fn close(&mut self, node: u32) {
        let mut part = Vec::new();
        while let Some(other) = self.stack.pop() {
            part.push(other);
            if let Some((_, low)) = self.numbers.get_mut(&other) {
                *low = u32::MAX;
            }
            if other == node {
                break;
            }
        }
        self.parts.push(part);
    }
}
