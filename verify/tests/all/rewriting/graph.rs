//! The brute-force graph of several hosts: states, the events between them, and properties of all ways through them.

use std::collections::{BTreeMap, BTreeSet};

/// A member, as its group and slot.
pub(crate) type Seat = (u32, u32);

/// The observable events of a member.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Started,
    Done,
    Failed,
    Stopped,
}

/// The observable part of a state.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    /// The programs that are active for their supervisors, even while they stop, and the groups that run.
    pub(crate) active: BTreeSet<Seat>,
    /// The running members that are not being stopped, neither alone nor together with a group around them.
    pub(crate) running: BTreeSet<Seat>,
    /// The members to which an order to start is in transit.
    pub(crate) starting: BTreeSet<Seat>,
    /// The groups that have ended without the knowledge of the supervisor around them. For a program, only the
    /// knowledge of its supervisor counts.
    pub(crate) unheard: BTreeSet<Seat>,
    /// The groups in which something is being stopped, or a `shield` or a `finally` delays a stop.
    pub(crate) stopping: BTreeSet<u32>,
    /// Whether a host has been lost.
    pub(crate) is_lost: bool,
}

/// The way to a state.
#[derive(Debug)]
pub(crate) struct Edge {
    /// The events, in order.
    pub(crate) happened: Vec<(Seat, Kind)>,
    pub(crate) target: usize,
    /// Whether the transition needs neither a failure nor a request to stop.
    pub(crate) is_natural: bool,
}

/// All states, with the events from each state to another.
#[derive(Debug, Default)]
pub(crate) struct Graph {
    pub(crate) seen: Vec<Seen>,
    pub(crate) edges: Vec<Vec<Edge>>,
    /// For each state, whether the whole has ended there.
    pub(crate) ended: Vec<bool>,
}

impl Graph {
    /// Returns whether a watcher objects to a transition. The watcher keeps a small number along each way.
    pub(crate) fn objects<N: Copy + Default + Ord>(
        &self,
        watch: impl Fn(N, &[(Seat, Kind)], &Seen) -> Result<N, ()>,
    ) -> bool {
        let mut known = BTreeSet::from([(0, N::default())]);
        let mut open = vec![(0, N::default())];
        while let Some((state, note)) = open.pop() {
            for edge in &self.edges[state] {
                let Ok(note) = watch(note, &edge.happened, &self.seen[edge.target]) else { return true };
                if known.insert((edge.target, note)) {
                    open.push((edge.target, note));
                }
            }
        }
        false
    }

    /// Returns whether the whole can end from every state, without a failure and without a request to stop.
    pub(crate) fn always_ends(&self) -> bool {
        let mut back = vec![Vec::new(); self.seen.len()];
        for (state, edges) in self.edges.iter().enumerate() {
            edges.iter().filter(|edge| edge.is_natural).for_each(|edge| back[edge.target].push(state));
        }
        let mut open: Vec<usize> = (0..self.seen.len()).filter(|&state| self.ended[state]).collect();
        let mut known: BTreeSet<usize> = open.iter().copied().collect();
        while let Some(at) = open.pop() {
            open.extend(back[at].iter().copied().filter(|from| known.insert(*from)));
        }
        known.len() == self.seen.len()
    }

    /// Returns whether the obligation that a watcher notes can always be met, without a failure and without a request
    /// to stop. A calm watcher considers only runs without failures and stops.
    pub(crate) fn pays(
        &self,
        is_calm: bool,
        first: bool,
        watch: impl Fn(bool, &[(Seat, Kind)], &Seen) -> bool,
    ) -> bool {
        self.pays_noted(is_calm, first, |is_owed| is_owed, watch)
    }

    /// Returns the same for a watcher with a larger note.
    pub(crate) fn pays_noted<N: Copy + Ord>(
        &self,
        is_calm: bool,
        first: N,
        is_owed: impl Fn(N) -> bool,
        watch: impl Fn(N, &[(Seat, Kind)], &Seen) -> N,
    ) -> bool {
        let mut back: BTreeMap<(usize, N), Vec<(usize, N)>> = BTreeMap::from([((0, first), Vec::new())]);
        let mut open = vec![(0, first)];
        while let Some((state, note)) = open.pop() {
            for edge in self.edges[state].iter().filter(|edge| edge.is_natural || !is_calm) {
                let next = (edge.target, watch(note, &edge.happened, &self.seen[edge.target]));
                let ways = back.entry(next).or_insert_with(|| {
                    open.push(next);
                    Vec::new()
                });
                if edge.is_natural {
                    ways.push((state, note));
                }
            }
        }
        let mut paid: Vec<(usize, N)> = back.keys().filter(|(_, note)| !is_owed(*note)).copied().collect();
        let mut known: BTreeSet<(usize, N)> = paid.iter().copied().collect();
        while let Some(at) = paid.pop() {
            paid.extend(back[&at].iter().filter(|from| known.insert(**from)));
        }
        known.len() == back.len()
    }
}
