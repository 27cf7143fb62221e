//! Looks at every configuration that a system can reach, the nearest first.
//!
//! Breadth-first, so the way back over `parents` is a shortest story.

use crate::store::Store;
use crate::system::{Change, Frame, Label, Phase, System};

/// As many configurations are looked at between two questions about the budget.
const TURN: u32 = 1024;

/// What may be spent.
#[derive(Debug)]
pub struct Limits<'l> {
    /// The most states of one exploration.
    pub states: u32,
    /// The most memory of one exploration, in bytes.
    pub memory: usize,
    /// Asked from time to time whether there is still time.
    pub goes_on: &'l dyn GoesOn,
}

/// Whether there is still time. The caller has the clock.
pub trait GoesOn: std::fmt::Debug {
    /// Returns whether to go on.
    fn goes_on(&self) -> bool;
}

/// For tests and small specs: there is always time.
#[derive(Clone, Copy, Debug, Default)]
pub struct Always;

impl GoesOn for Always {
    fn goes_on(&self) -> bool {
        true
    }
}

/// Which limit was reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reached {
    /// The number of states.
    States,
    /// The memory.
    Memory,
    /// The time.
    Time,
    /// One of these, for a group inside: how that may end is not known.
    Inside,
}

/// Everything that was found.
#[derive(Debug)]
pub(crate) struct Graph {
    pub(crate) store: Store,
    /// For each state, the one before it and what happened.
    pub(crate) parents: Vec<(u32, Label)>,
    /// For each state, where its transitions begin in `targets`; one more at the end.
    starts: Vec<usize>,
    targets: Vec<u32>,
    labels: Vec<Label>,
    /// The limit that ended the exploration, if one did.
    pub(crate) reached: Option<Reached>,
}

/// Sees every transition: what it changes, and where it leads.
pub(crate) trait Observer {
    /// May change the notes of `after`. Returns false to end the exploration there: something was found.
    fn sees(&mut self, system: &System<'_>, before: &Frame, changes: &[Change], after: &mut Frame) -> bool;
}

/// Sees nothing.
pub(crate) struct Nobody;

impl Observer for Nobody {
    fn sees(&mut self, _: &System<'_>, _: &Frame, _: &[Change], _: &mut Frame) -> bool {
        true
    }
}

/// What an exploration ends with: everything, and the state in which an observer ended it.
pub(crate) struct Found {
    pub(crate) graph: Graph,
    pub(crate) stopped_at: Option<u32>,
}

/// Explores a system. `keeps_edges` says whether transitions are kept, for questions about what is possible later.
pub(crate) fn explore(
    system: &System<'_>,
    limits: &Limits<'_>,
    keeps_edges: bool,
    observer: &mut dyn Observer,
) -> Found {
    let mut store = Store::new(system.length());
    let mut frame = system.initial();
    let (mut bytes, mut labels, mut changes) = (Vec::new(), Vec::new(), Vec::new());
    system.pack(&frame, &mut bytes);
    store.add(&bytes);
    let parents = vec![(0, Label::Start)];
    let mut graph = Graph { store, parents, starts: vec![0], targets: vec![], labels: vec![], reached: None };
    let mut next = frame.clone();
    let mut state = 0;
    while state < graph.store.count() {
        if state % TURN == 0 || graph.store.count() > limits.states {
            graph.reached = over(&graph, limits);
            if graph.reached.is_some() {
                break;
            }
        }
        system.unpack(graph.store.get(state), &mut frame);
        system.labels(&frame, &mut labels);
        for &label in &labels {
            next.clone_from(&frame);
            system.apply(&mut next, label, &mut changes);
            let goes_on = observer.sees(system, &frame, &changes, &mut next);
            system.pack(&next, &mut bytes);
            let (target, is_new) = graph.store.add(&bytes);
            if is_new {
                graph.parents.push((state, label));
            }
            if keeps_edges {
                graph.targets.push(target);
                graph.labels.push(label);
            }
            if !goes_on {
                // The story must end with this transition, also where its target was known before.
                if !is_new {
                    graph.parents.push((state, label));
                    let last = u32::try_from(graph.parents.len() - 1).unwrap_or(u32::MAX);
                    return Found { graph, stopped_at: Some(last) };
                }
                return Found { graph, stopped_at: Some(target) };
            }
        }
        if keeps_edges {
            graph.starts.push(graph.targets.len());
        }
        state += 1;
    }
    if !system.is_whole() {
        graph.reached.get_or_insert(Reached::Inside);
    }
    Found { graph, stopped_at: None }
}

fn over(graph: &Graph, limits: &Limits<'_>) -> Option<Reached> {
    if graph.store.count() > limits.states {
        return Some(Reached::States);
    }
    let parents = graph.parents.capacity() * size_of::<(u32, Label)>();
    let edges = graph.targets.capacity() * (4 + size_of::<Label>()) + graph.starts.capacity() * size_of::<usize>();
    if graph.store.memory() + parents + edges > limits.memory {
        return Some(Reached::Memory);
    }
    (!limits.goes_on.goes_on()).then_some(Reached::Time)
}

impl Graph {
    /// What happens on a shortest way to a state.
    pub(crate) fn way(&self, mut state: u32) -> Vec<Label> {
        let mut way = Vec::new();
        while state != 0 {
            let (before, label) = self.parents[state as usize];
            way.push(label);
            state = before;
        }
        way.reverse();
        way
    }

    /// A way on from a state, without failures, to the nearest one in which nothing happens any more; nothing if there is none.
    pub(crate) fn dead_end(&self, state: u32) -> Vec<Label> {
        let mut known: std::collections::BTreeMap<u32, (u32, Label)> = std::collections::BTreeMap::new();
        let mut open = std::collections::VecDeque::from([state]);
        while let Some(at) = open.pop_front() {
            let mut next = self.from(at).filter(|(label, target)| is_natural(*label) && *target != at).peekable();
            if next.peek().is_none() {
                let (mut way, mut back) = (Vec::new(), at);
                while let Some(&(before, label)) = known.get(&back).filter(|_| back != state) {
                    way.push(label);
                    back = before;
                }
                way.reverse();
                return way;
            }
            for (label, target) in next.filter(|(_, target)| *target != state) {
                if let std::collections::btree_map::Entry::Vacant(place) = known.entry(target) {
                    place.insert((at, label));
                    open.push_back(target);
                }
            }
        }
        Vec::new()
    }

    /// How many transitions there are, if they were kept.
    pub(crate) fn transitions(&self) -> usize {
        self.targets.len()
    }

    /// The transitions from a state that was looked at.
    pub(crate) fn from(&self, state: u32) -> impl Iterator<Item = (Label, u32)> + '_ {
        let range = match (self.starts.get(state as usize), self.starts.get(state as usize + 1)) {
            (Some(&start), Some(&end)) => start..end,
            (_, _) => 0..0,
        };
        range.map(|edge| (self.labels[edge], self.targets[edge]))
    }

    /// For each state, whether one of the goals can be reached from it over transitions that count.
    pub(crate) fn can_reach(&self, goals: &[bool], counts: &dyn Fn(Label) -> bool) -> Vec<bool> {
        let states = self.store.count() as usize;
        let mut ends = vec![0_u32; states + 1];
        for (edge, &target) in self.targets.iter().enumerate() {
            if counts(self.labels[edge]) {
                ends[target as usize + 1] += 1;
            }
        }
        for state in 0..states {
            ends[state + 1] += ends[state];
        }
        let mut sources = vec![0_u32; ends[states] as usize];
        let mut next = ends.clone();
        for state in 0..self.store.count() {
            for (label, target) in self.from(state) {
                if counts(label) {
                    sources[next[target as usize] as usize] = state;
                    next[target as usize] += 1;
                }
            }
        }
        let mut can = goals.to_vec();
        let mut open: Vec<u32> = (0..self.store.count()).filter(|&state| goals[state as usize]).collect();
        while let Some(state) = open.pop() {
            for &source in &sources[ends[state as usize] as usize..ends[state as usize + 1] as usize] {
                if !std::mem::replace(&mut can[source as usize], true) {
                    open.push(source);
                }
            }
        }
        can
    }

    /// Which states have a property.
    pub(crate) fn which(&self, system: &System<'_>, mut has: impl FnMut(&Frame) -> bool) -> Vec<bool> {
        let mut frame = system.initial();
        let states = 0..self.store.count();
        states
            .map(|state| {
                system.unpack(self.store.get(state), &mut frame);
                has(&frame)
            })
            .collect()
    }
}

/// Whether something happens without anybody failing or asking for it: programs that end, stops that are answered, timers.
pub(crate) fn is_natural(label: Label) -> bool {
    match label {
        Label::Start | Label::Done(..) | Label::Stopped(..) | Label::Elapsed(..) | Label::Reached(_) => true,
        Label::Stop | Label::Aborted(..) | Label::Fault(..) | Label::Lost => false,
    }
}

/// Whether the whole is over.
pub(crate) fn is_over(frame: &Frame) -> bool {
    frame.phase.is_over()
}

/// Whether the whole has been asked to stop and has not.
pub(crate) fn is_stopping(frame: &Frame) -> bool {
    frame.phase == Phase::Stopping
}
