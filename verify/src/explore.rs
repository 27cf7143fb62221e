//! Explores every configuration that a system can reach, the nearest first.
//!
//! The search is breadth-first, so the way back over `parents` is a shortest story.

use crate::store::{Batch, STATES_MAX, Store};
use crate::system::{Change, Frame, Label, Phase, Stepper, System};
use crate::threads::{Alone, Threads, each, lock};
use std::ops::Range;
use std::sync::Mutex;

/// How many transitions are taken between two checks of the budget.
const TURN: usize = 1024;
/// States with more bytes than this are so slow that the budget is checked at each of their transitions.
const LONG: usize = 4096;
/// The approximate total size of the states to which the transitions of one block lead, in bytes.
const BLOCK_BYTES: usize = 16 << 20;
/// The most states of a block.
const BLOCK_MAX: usize = 1 << 14;
/// How many states a thread takes at a time.
const JOB: u32 = 256;

/// The limits of an exploration.
#[derive(Debug)]
pub struct Limits<'l> {
    /// The most states of one exploration.
    pub states: u32,
    /// The most memory of one exploration, in bytes.
    pub memory: usize,
    /// The threads that explore.
    pub threads: &'l dyn Threads,
    /// Is asked from time to time whether the exploration should continue.
    pub goes_on: &'l dyn GoesOn,
}

/// Decides whether to continue. The caller has the clock.
pub trait GoesOn: std::fmt::Debug + Sync {
    /// Returns whether to continue.
    fn goes_on(&self) -> bool;

    /// Receives the progress of the work, for people who wait.
    fn hear(&self, _done: WorkDone) {}
}

/// The progress of a verification.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorkDone {
    /// The number of finished jobs of one kind.
    Jobs {
        /// The kind: `groups`, `sentences`, `faults`, `pairs of faults`.
        what: &'static str,
        /// How many jobs are done.
        done: usize,
        /// How many jobs there are.
        of: usize,
    },
    /// An exploration has found this many states. The total is not known in advance.
    States(u32),
}

/// Never stops an exploration, for tests and small specs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Always;

impl GoesOn for Always {
    fn goes_on(&self) -> bool {
        true
    }
}

/// The limit that was reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reached {
    /// The number of states.
    States,
    /// The memory.
    Memory,
    /// The time.
    Time,
    /// A limit inside a group was reached, so the possible ends of that group are unknown.
    Inside,
    /// The spec has too many outcomes and reasons of failures.
    Values,
}

/// All states and transitions that were found.
#[derive(Debug)]
pub(crate) struct Graph {
    pub(crate) store: Store,
    /// For each state, its predecessor and the label between them.
    pub(crate) parents: Vec<(u32, Label)>,
    /// For each state, where its transitions begin in `targets`; there is one more entry at the end.
    starts: Vec<usize>,
    targets: Vec<u32>,
    labels: Vec<Label>,
    /// How many transitions were taken, including those that were not kept.
    pub(crate) transitions: u64,
    /// The limit that ended the exploration. None if the exploration was complete.
    pub(crate) reached: Option<Reached>,
}

/// Observes every transition: its changes, and the state that it leads to.
pub(crate) trait Observer {
    /// Whether this observer reads the changes of a transition. If not, it gets an empty list.
    const LOOKS_AT_CHANGES: bool = true;

    /// Looks at a transition. `is_fault` tells whether the fault happens in it. May change the notes of `after`. Returns false
    /// to end the exploration here, because the observer has found something.
    fn sees(&self, system: &System<'_>, is_fault: bool, changes: &[Change], after: &mut Frame) -> bool;
}

/// An observer that ignores everything.
pub(crate) struct Nobody;

impl Observer for Nobody {
    const LOOKS_AT_CHANGES: bool = false;

    fn sees(&self, _: &System<'_>, _: bool, _: &[Change], _: &mut Frame) -> bool {
        true
    }
}

/// The result of an exploration: the graph, and the state in which an observer ended it.
pub(crate) struct Found {
    pub(crate) graph: Graph,
    pub(crate) stopped_at: Option<u32>,
}

/// Explores a system. If `keeps_edges`, transitions are kept, for questions about later possibilities.
///
/// States are taken in blocks, in the order of their numbers. Several threads may work on a block. The result depends only on
/// this order, not on the threads.
pub(crate) fn explore(
    system: &System<'_>,
    limits: &Limits<'_>,
    keeps_edges: bool,
    observer: &(impl Observer + Sync),
) -> Found {
    let mut graph = Graph::new(system);
    if system.model.values.is_limited {
        graph.reached = Some(Reached::Values);
        return Found { graph, stopped_at: None };
    }
    let mut workers = vec![Mutex::new(Worker::new(system))];
    let (mut state, mut degree) = (0, 1);
    while state < graph.store.count() {
        limits.goes_on.hear(WorkDone::States(graph.store.count()));
        graph.reached = over(&graph, limits);
        if graph.reached.is_some() {
            break;
        }
        let size = (BLOCK_BYTES / (degree * system.length())).clamp(1, BLOCK_MAX);
        let end = graph.store.count().min(state + u32::try_from(size).unwrap_or(1));
        let jobs = jobs(state..end);
        if jobs.len() > 1 {
            workers.resize_with(limits.threads.count().max(1), || Mutex::new(Worker::new(system)));
        }
        let work = |thread: usize, job| lock(&workers[thread]).expand(&graph.store, job, limits, observer);
        let mut blocks = each(limits.threads, jobs, work);
        graph.reached = blocks.iter().find_map(|block| block.reached);
        if graph.reached.is_some() {
            break;
        }
        if let Some(last) = blocks.iter().position(|block| block.is_violated) {
            blocks.truncate(last + 1);
        }
        degree = blocks.iter().flat_map(|block| block.degrees.iter().copied()).max().unwrap_or(0).max(1) as usize;
        if let Some(stopped_at) = graph.add(blocks, limits.threads, keeps_edges) {
            return Found { graph, stopped_at: Some(stopped_at) };
        }
        state = end;
    }
    if !system.is_whole() {
        graph.reached.get_or_insert(Reached::Inside);
    }
    Found { graph, stopped_at: None }
}

/// The transitions from some consecutive states, in order.
struct Block {
    batch: Batch,
    /// How many transitions lead from each state.
    degrees: Vec<u32>,
    /// Whether the last transition violates the observer's property.
    is_violated: bool,
    /// The limit that was reached. If there is one, the block must not be used.
    reached: Option<Reached>,
}

/// The buffers in which a thread applies labels.
struct Worker<'s> {
    system: &'s System<'s>,
    stepper: Stepper<'s>,
    frame: Frame,
    labels: Vec<Label>,
    changes: Vec<Change>,
}

impl<'s> Worker<'s> {
    fn new(system: &'s System<'s>) -> Self {
        let (stepper, frame) = (system.stepper(), system.initial());
        Self { system, stepper, frame, labels: Vec::new(), changes: Vec::new() }
    }

    fn expand<O: Observer>(&mut self, store: &Store, states: Range<u32>, limits: &Limits<'_>, observer: &O) -> Block {
        let mut block = Block { batch: Batch::default(), degrees: Vec::new(), is_violated: false, reached: None };
        for state in states {
            let source = store.get(state);
            self.system.unpack(source, &mut self.frame);
            self.system.labels(&self.frame, &mut self.labels);
            block.degrees.push(u32::try_from(self.labels.len()).unwrap_or(u32::MAX));
            for &label in &self.labels {
                let was_faulty = self.frame.is_faulty;
                let changes = O::LOOKS_AT_CHANGES.then_some(&mut self.changes);
                self.stepper.apply(&mut self.frame, label, changes);
                let is_fault = self.frame.is_faulty && !was_faulty;
                block.is_violated = !observer.sees(self.system, is_fault, &self.changes, &mut self.frame);
                let items = self.stepper.changed();
                block.batch.push((state, label), source, |bytes| self.system.patch(&self.frame, items, bytes));
                self.stepper.undo(&mut self.frame);
                if block.is_violated {
                    return block;
                }
                if block.batch.count().is_multiple_of(TURN) || self.system.length() > LONG {
                    block.reached = match block.batch.size() > limits.memory {
                        true => Some(Reached::Memory),
                        false => (!limits.goes_on.goes_on()).then_some(Reached::Time),
                    };
                    if block.reached.is_some() {
                        return block;
                    }
                }
            }
        }
        block
    }
}

/// Divides a block into parts for single threads.
fn jobs(states: Range<u32>) -> Vec<Range<u32>> {
    let starts = states.clone().step_by(JOB as usize);
    starts.map(|start| start..states.end.min(start + JOB)).collect()
}

fn over(graph: &Graph, limits: &Limits<'_>) -> Option<Reached> {
    if graph.store.count() > limits.states.min(STATES_MAX) {
        return Some(Reached::States);
    }
    if graph.memory() > limits.memory {
        return Some(Reached::Memory);
    }
    (!limits.goes_on.goes_on()).then_some(Reached::Time)
}

impl Graph {
    /// The idle state alone.
    fn new(system: &System<'_>) -> Self {
        let mut store = Store::new(system.length());
        let (mut first, mut bytes) = (Batch::default(), Vec::new());
        system.pack(&system.initial(), &mut bytes);
        first.push((0, Label::Start), &bytes, |_| ());
        store.add(&mut [first], &Alone, |_, _| ());
        let parents = vec![(0, Label::Start)];
        Self { store, parents, starts: vec![0], targets: Vec::new(), labels: Vec::new(), transitions: 0, reached: None }
    }

    /// Returns the used memory in bytes.
    pub(crate) fn memory(&self) -> usize {
        let edges = self.targets.capacity() * (4 + size_of::<Label>()) + self.starts.capacity() * size_of::<usize>();
        self.store.memory() + self.parents.capacity() * size_of::<(u32, Label)>() + edges
    }

    /// Adds the results of the next states. Returns the state at the end of a violation, if there is one.
    fn add(&mut self, blocks: Vec<Block>, threads: &dyn Threads, keeps_edges: bool) -> Option<u32> {
        let is_violated = blocks.last().is_some_and(|block| block.is_violated);
        let (mut batches, degrees): (Vec<Batch>, Vec<Vec<u32>>) =
            blocks.into_iter().map(|block| (block.batch, block.degrees)).unzip();
        self.transitions += batches.iter().map(|batch| batch.count() as u64).sum::<u64>();
        let mut news: Vec<(usize, usize)> = Vec::new();
        self.store.add(&mut batches, threads, |batch, transition| news.push((batch, transition)));
        if self.parents.len() + news.len() > self.parents.capacity() {
            self.parents.reserve_exact(news.len().max(self.parents.len() / 8));
        }
        self.parents.extend(news.iter().map(|&(batch, transition)| batches[batch].origins[transition]));
        if is_violated && let Some(batch) = batches.last() {
            // The story must end with this transition, even if its target was already known.
            let last = batch.count() - 1;
            if news.last() != Some(&(batches.len() - 1, last)) {
                self.parents.push(batch.origins[last]);
            }
            return u32::try_from(self.parents.len() - 1).ok();
        }
        if keeps_edges {
            for (batch, degrees) in batches.iter().zip(degrees) {
                self.targets.extend((0..batch.count()).map(|transition| batch.target(transition)));
                self.labels.extend(batch.origins.iter().map(|(_, label)| *label));
                for degree in degrees {
                    self.starts.push(self.starts.last().copied().unwrap_or(0) + degree as usize);
                }
            }
        }
        None
    }

    /// Returns the labels of a shortest way to a state.
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

    /// Returns a way from a state, without failures, to the nearest state in which no event happens any more. The way is empty
    /// if there is no such state.
    pub(crate) fn dead_end(&self, system: &System<'_>, state: u32) -> Vec<Label> {
        let mut known: std::collections::BTreeMap<u32, (u32, Label)> = std::collections::BTreeMap::new();
        let mut open = std::collections::VecDeque::from([state]);
        while let Some(at) = open.pop_front() {
            let mut next =
                self.from(at).filter(|(label, target)| system.is_natural(*label) && *target != at).peekable();
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

    /// Returns the transitions from an explored state.
    pub(crate) fn from(&self, state: u32) -> impl Iterator<Item = (Label, u32)> + '_ {
        let range = match (self.starts.get(state as usize), self.starts.get(state as usize + 1)) {
            (Some(&start), Some(&end)) => start..end,
            (_, _) => 0..0,
        };
        range.map(|edge| (self.labels[edge], self.targets[edge]))
    }

    /// Returns for each state whether a goal can be reached from it over transitions for which `counts` is true.
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

    /// Returns the nearest state that has a property.
    pub(crate) fn first(&self, system: &System<'_>, mut has: impl FnMut(&Frame) -> bool) -> Option<u32> {
        let mut frame = system.initial();
        (0..self.store.count()).find(|&state| {
            system.unpack(self.store.get(state), &mut frame);
            has(&frame)
        })
    }

    /// Returns for each state whether it has a property.
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

/// Returns whether the whole has ended.
pub(crate) fn is_over(frame: &Frame) -> bool {
    frame.phase.is_over()
}

/// Returns whether the whole was asked to stop but has not stopped yet.
pub(crate) fn is_stopping(frame: &Frame) -> bool {
    frame.phase == Phase::Stopping
}
