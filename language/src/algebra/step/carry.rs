//! Carries the state of a group over to other event actions, while it runs.
//!
//! Operands that have not started may change completely. Running members need the same place in the new expression,
//! with three exceptions around `,`, `#` and `&`:
//!
//! ```text
//!   a , b        →  a , b , c     c starts, with the empty value; so does it where `a` alone becomes `a , c`
//!   a , b , c    →  a , b         c is stopped, if every process that runs in it is `gone`: nobody waits for it
//!   a # wait(d)  →  a # wait(e)   what only waits begins anew
//! ```
//! An activity keeps its states, where they still exist.
//! An operand that has ended keeps its end. Nothing is added or taken away where something is being stopped.

mod alike;
mod chain;
mod chart;
mod operands;

use super::{Cell, Phase, Reaction};
use crate::algebra::event::{Activation, Command, Outcome, Value};
use crate::algebra::program::{Kind, Program, Start};
use crate::algebra::state::{MemberState, State};
use crate::automaton::Configuration;
use alike::{Compared, count, failures, is_alike, sets, tags, taken};
use chain::Chain;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The most comparisons of two nodes: a hostile plan must not hang a node.
const COMPARISONS_MAX: u32 = 500_000;

/// A running group under its new event actions.
#[derive(Clone, Debug, PartialEq)]
pub struct Carried {
    /// Where it is in them.
    pub state: State,
    /// The new numbers of the timers that run on, by the old ones.
    pub timers: BTreeMap<u32, u32>,
    /// The commands that end members, with the old numbers of timers; they come first.
    pub ended: Vec<Command>,
    /// The commands that begin members, with the new numbers of timers.
    pub begun: Vec<Command>,
    /// How this has ended the group. None if the group continues.
    pub outcome: Option<Outcome>,
}

/// Something that runs and has no place in the new event actions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Misfit {
    /// Slots of the members that run in it.
    pub members: BTreeSet<u32>,
    /// Why, as a clause of a sentence.
    pub why: &'static str,
}

/// Carries a group over from one program to the next. Slots of members and numbers of sets mean the same in both; `gone` are the
/// members that are taken away.
///
/// # Errors
/// The running members without a place in the next program.
pub fn carry(old: (&Program, &State), next: &Program, gone: &BTreeSet<u32>) -> Result<Carried, Misfit> {
    let (program, state) = old;
    let mut carrying = Carrying { program, state, next, gone, left: COMPARISONS_MAX, draft: Draft::new(state, next) };
    let is_running = !state.is_idle();
    if is_running {
        carrying.place(0, 0, true)?;
        carrying.switch_always();
    }
    Ok(carrying.finish())
}

/// The draft of the next state.
struct Draft {
    cells: Vec<Cell>,
    seats: Vec<MemberState>,
    /// The new node of each active old node.
    nodes: BTreeMap<usize, usize>,
    timers: BTreeMap<u32, u32>,
    ended: Vec<Command>,
    begun: Vec<Command>,
    /// New operands that start, each with the operator that it belongs to.
    starts: Vec<(usize, usize)>,
    /// New operators whose operands have to be counted again.
    counted: BTreeSet<usize>,
    /// Where an activity is in its changed states.
    chart: Option<Box<Configuration>>,
    /// The new timers that begin, each with its time.
    armed: Vec<(u32, Duration)>,
}

impl Draft {
    fn new(state: &State, next: &Program) -> Self {
        let mut seats = vec![MemberState::default(); next.endless.len()];
        for (seat, before) in seats.iter_mut().zip(&state.seats) {
            seat.activation = before.activation;
        }
        Self {
            cells: vec![Cell::default(); next.nodes.len()],
            seats,
            nodes: BTreeMap::new(),
            timers: BTreeMap::new(),
            ended: Vec::new(),
            begun: Vec::new(),
            starts: Vec::new(),
            counted: BTreeSet::new(),
            chart: None,
            armed: Vec::new(),
        }
    }
}

struct Carrying<'a> {
    program: &'a Program,
    state: &'a State,
    next: &'a Program,
    gone: &'a BTreeSet<u32>,
    /// How many comparisons are left.
    left: u32,
    draft: Draft,
}

impl Carrying<'_> {
    /// Finds the place of the old node `o` in the new node `n`. It is `calm` where nothing is being stopped.
    fn place(&mut self, o: usize, n: usize, calm: bool) -> Result<(), Misfit> {
        let cell = &self.state.cells[o];
        match cell.phase {
            Phase::Idle => return Ok(()),
            Phase::Done => {
                self.draft.cells[n] = cell.clone();
                return Ok(());
            }
            Phase::Running | Phase::Second | Phase::Stopping | Phase::Draining | Phase::Waiting => {}
        }
        if self.left == 0 {
            return Err(self.misfit(o, "the event actions are too large to compare"));
        }
        self.left -= 1;
        let misfit = match self.attempt(o, n, |me| me.place_same(o, n, calm)) {
            Ok(()) => return Ok(()),
            Err(misfit) => misfit,
        };
        let chains = [Chain::Sequence, Chain::Conditional, Chain::Otherwise];
        let is_link = |chain: &Chain| chain.has(self.program, o) || chain.has(self.next, n);
        for chain in chains.into_iter().filter(is_link).collect::<Vec<_>>() {
            if calm && self.attempt(o, n, |me| me.place_chain(o, n, chain, calm)).is_ok() {
                return Ok(());
            }
        }
        let gives_way = calm
            && (self.attempt(o, n, |me| me.wrap(o, n)).is_ok() || self.attempt(o, n, |me| me.unwrap(o, n)).is_ok());
        if gives_way { Ok(()) } else { Err(misfit) }
    }

    /// Does something that places `o` in `n`, and takes it back if that fails.
    fn attempt(&mut self, o: usize, n: usize, act: impl FnOnce(&mut Self) -> Result<(), Misfit>) -> Result<(), Misfit> {
        let lengths = (self.draft.ended.len(), self.draft.begun.len(), self.draft.starts.len());
        let done = act(self);
        if done.is_err() {
            let (draft, inside) = (&mut self.draft, n..self.next.nodes[n].end);
            draft.ended.truncate(lengths.0);
            draft.begun.truncate(lengths.1);
            draft.starts.truncate(lengths.2);
            draft.cells[inside.clone()].fill(Cell::default());
            draft.counted.retain(|node| !inside.contains(node));
            draft.timers.retain(|_, timer| !inside.contains(&self.next.timers[*timer as usize]));
            for node in o..self.program.nodes[o].end {
                draft.nodes.remove(&node);
                if let Kind::Run { member, .. } = self.program.nodes[node].kind {
                    let seat = &mut draft.seats[member as usize];
                    seat.node = seat.node.filter(|node| !inside.contains(node));
                }
            }
        }
        done
    }

    /// Places a node whose operator stays.
    fn place_same(&mut self, o: usize, n: usize, calm: bool) -> Result<(), Misfit> {
        let (old, new) = (self.program, self.next);
        let cell = &self.state.cells[o];
        let is_calm = calm && matches!(cell.phase, Phase::Running | Phase::Second);
        match (&old.nodes[o].kind, &new.nodes[n].kind) {
            (Kind::Run { member, .. }, Kind::Run { member: other, .. }) if member == other => {
                self.put(o, n);
                self.draft.seats[*member as usize].node = Some(n);
                self.switch_sets(sets(old, o), sets(new, n));
                Ok(())
            }
            (Kind::Wait { timer, after }, Kind::Wait { timer: other, after: as_long }) if after == as_long => {
                self.put(o, n);
                self.draft.timers.insert(*timer, *other);
                Ok(())
            }
            (Kind::Never, Kind::Never) => {
                self.put(o, n);
                Ok(())
            }
            (Kind::Concurrent { .. }, Kind::Concurrent { .. })
            | (Kind::FailFast { .. }, Kind::FailFast { .. })
            | (Kind::Disable, Kind::Disable) => self.align(o, n, is_calm),
            (Kind::AnyOf { count, operands }, Kind::AnyOf { count: other, operands: as_many })
            | (Kind::AtLeast { count, operands }, Kind::AtLeast { count: other, operands: as_many })
                if (count, operands) == (other, as_many) =>
            {
                self.place_operands(o, n, is_calm)
            }
            (Kind::Asynchronous, Kind::Asynchronous) if old.operands(o).count() == new.operands(n).count() => {
                self.place_operands(o, n, is_calm)
            }
            (Kind::Shield { bound: old_bound }, Kind::Shield { bound }) => {
                let is_held_up = cell.phase == Phase::Second;
                if is_held_up && old_bound.map(|bound| bound.after) != bound.map(|bound| bound.after) {
                    return Err(self.misfit(o, "its `shield` delays a stop, and the limit of the `shield` has changed"));
                }
                if let (true, Some(before), Some(bound)) = (is_held_up, old_bound, bound) {
                    self.draft.timers.insert(before.timer, bound.timer);
                }
                self.place_operands(o, n, calm && !is_held_up)
            }
            (Kind::Using { .. }, Kind::Using { .. }) if taken(old, o) == taken(new, n) => {
                self.place_operands(o, n, is_calm)
            }
            (Kind::Tagged(tag), Kind::Tagged(other)) if tag == other => self.place_operands(o, n, is_calm),
            (Kind::With(start), Kind::With(other)) if self.is_same_start(start, other) => {
                self.place_operands(o, n, is_calm)
            }
            (Kind::With(_), Kind::With(_)) => Err(self.misfit(o, "it was started with another value")),
            (Kind::Match { .. }, Kind::Match { .. }) => self.place_arm(o, n, is_calm),
            (Kind::Catch { .. }, Kind::Catch { .. }) => self.place_catch(o, n, is_calm),
            (Kind::Sequence, Kind::Sequence) => self.place_chain(o, n, Chain::Sequence, is_calm),
            (Kind::Conditional, Kind::Conditional) => self.place_chain(o, n, Chain::Conditional, is_calm),
            (Kind::Otherwise, Kind::Otherwise) => self.place_chain(o, n, Chain::Otherwise, is_calm),
            (Kind::Chart, Kind::Chart) if old.chart == new.chart => {
                // Only the timers of the states stay. The runs of the states may have changed, and have timers of their own.
                let own = old.chart.iter().flat_map(|chart| (0..).zip(&chart.timed)).map(|(timer, _)| (timer, timer));
                self.draft.timers.extend(own);
                self.place_operands(o, n, is_calm)
            }
            (Kind::Chart, Kind::Chart) => chart::place(self, o, n, is_calm),
            // Its next end is compared with the new outcomes.
            (Kind::Repeat { .. }, Kind::Repeat { .. })
            | (Kind::Recurrent, Kind::Recurrent)
            | (Kind::Named(_), Kind::Named(_))
            | (Kind::Finally, Kind::Finally) => self.place_operands(o, n, is_calm),
            _ => Err(self.misfit(o, "the new event actions have another expression in its place")),
        }
    }

    /// Returns whether two `with` start their operands with the same value. The name of the value does not matter.
    fn is_same_start(&self, old: &Start, new: &Start) -> bool {
        match (old, new) {
            (Start::Known(value), Start::Known(other)) => value == other,
            (Start::Kept { keeper, .. }, Start::Kept { keeper: other, .. }) => {
                self.draft.nodes.get(keeper) == Some(other)
            }
            (Start::Known(_), Start::Kept { .. }) | (Start::Kept { .. }, Start::Known(_)) => false,
        }
    }

    fn put(&mut self, o: usize, n: usize) {
        self.draft.cells[n] = self.state.cells[o].clone();
        self.draft.nodes.insert(o, n);
    }

    fn place_operands(&mut self, o: usize, n: usize, calm: bool) -> Result<(), Misfit> {
        self.put(o, n);
        let (old, new) = (self.program, self.next);
        old.operands(o).zip(new.operands(n)).try_for_each(|(o, n)| self.place(o, n, calm))
    }

    /// Only one arm of a `match` runs; in the new program it is also the arm of its tag.
    fn place_arm(&mut self, o: usize, n: usize, calm: bool) -> Result<(), Misfit> {
        self.put(o, n);
        let (old, new) = (self.program, self.next);
        let mut arms = old.operands(o).zip(tags(old, o));
        let Some((arm, tag)) = arms.find(|(arm, _)| self.state.cells[*arm].phase.is_active()) else { return Ok(()) };
        let found = new.operands(n).zip(tags(new, n)).find(|(_, other)| *other == tag);
        match found {
            Some((other, _)) => self.place(arm, other, calm),
            None => Err(self.misfit(arm, "the arm of its `match` does not exist any more")),
        }
    }

    /// The arm of an `else match` that runs; in the new program it is also the arm of its failure. While the operand before them
    /// runs, the arms may be anything.
    fn place_catch(&mut self, o: usize, n: usize, calm: bool) -> Result<(), Misfit> {
        self.put(o, n);
        let (old, new) = (self.program, self.next);
        if self.state.cells[old.first(o)].phase.is_active() {
            return self.place(old.first(o), new.first(n), calm);
        }
        let mut arms = old.operands(o).skip(1).zip(failures(old, o));
        let Some((arm, failure)) = arms.find(|(arm, _)| self.state.cells[*arm].phase.is_active()) else {
            return Ok(());
        };
        let found = new.operands(n).skip(1).zip(failures(new, n)).find(|(_, other)| *other == failure);
        match found {
            Some((other, _)) => self.place(arm, other, calm),
            None => Err(self.misfit(arm, "the arm of its `else match` does not exist any more")),
        }
    }

    /// Whether the two nodes, with all nodes below them, have the same meaning.
    fn is_same(&mut self, o: usize, n: usize) -> bool {
        let (old, new) = (self.program, self.next);
        let length = old.nodes[o].end - o;
        if new.nodes[n].end - n != length {
            return false;
        }
        (0..length).all(|at| {
            self.left = self.left.saturating_sub(1);
            let compared = |program, first: usize| Compared { program, node: first + at, first };
            self.left > 0 && is_alike(compared(old, o), compared(new, n))
        })
    }

    /// Returns the members that run below a node.
    fn members(&self, o: usize) -> BTreeSet<u32> {
        let nodes = o..self.program.nodes[o].end;
        let is_active = |node: &usize| self.state.cells[*node].phase.is_active();
        let member = |node: usize| {
            if let Kind::Run { member, .. } = self.program.nodes[node].kind { Some(member) } else { None }
        };
        nodes.filter(is_active).filter_map(member).collect()
    }

    fn misfit(&self, o: usize, why: &'static str) -> Misfit {
        Misfit { members: self.members(o), why }
    }

    fn switch_always(&mut self) {
        self.switch_sets(&self.program.sets_always, &self.next.sets_always);
    }

    /// Opens and closes the sets that only one of the two nodes has.
    fn switch_sets(&mut self, old: &[u32], new: &[u32]) {
        let only =
            |of: &[u32], other: &[u32]| of.iter().copied().filter(|set| !other.contains(set)).collect::<Vec<_>>();
        self.draft.ended.extend(only(old, new).into_iter().map(|set| Command::Disconnect { set }));
        self.draft.begun.extend(only(new, old).into_iter().map(|set| Command::Connect { set }));
    }

    /// Makes the state, and starts the new operands.
    fn finish(self) -> Carried {
        let Self { state: old, next, mut draft, .. } = self;
        let mut holders = vec![None; next.resources().len()];
        for &node in draft.nodes.values().filter(|&&node| draft.cells[node].phase != Phase::Waiting) {
            next.taken(node).iter().for_each(|&index| holders[index] = Some(node));
        }
        let queue = old.queue.iter().filter_map(|node| draft.nodes.get(node).copied()).collect();
        // No number of a timer that has run before is used again soon.
        let last = old.timers.iter().copied().max().unwrap_or_default();
        let mut timers = vec![last; next.timers.len()];
        for (before, after) in &draft.timers {
            timers[*after as usize] = old.timers[*before as usize];
        }
        let starting: BTreeSet<usize> = draft.starts.iter().map(|(_, operand)| *operand).collect();
        for &node in &draft.counted {
            count(next, &mut draft.cells, node, &starting);
        }
        let chart = match draft.chart.take() {
            Some(moved) => Some(moved),
            None if old.is_idle() || self.program.chart != next.chart => State::new(next).chart,
            None => old.chart.clone(),
        };
        let mut state = State { cells: draft.cells, seats: draft.seats, timers, queue, holders, chart };
        let mut reaction =
            Reaction { program: next, state: &mut state, commands: &mut draft.begun, ended: None, notice: None };
        for (timer, after) in std::mem::take(&mut draft.armed) {
            reaction.arm(timer, after);
        }
        let outcome = reaction.begin_anew(&draft.starts, &draft.counted);
        Carried { state, timers: draft.timers, ended: draft.ended, begun: draft.begun, outcome }
    }
}

impl Reaction<'_, Vec<Cell>, Vec<MemberState>> {
    /// Starts new operands, and ends the operators that no longer wait for anything.
    fn begin_anew(&mut self, starts: &[(usize, usize)], counted: &BTreeSet<usize>) -> Option<Outcome> {
        for &(parent, operand) in starts {
            if self.cell(parent).phase == Phase::Running
                && let Some(outcome) = self.start(operand, Value::EMPTY)
                && let Some(outcome) = self.e_ctx(operand, outcome)
            {
                return Some(outcome);
            }
        }
        for &node in counted.iter().rev() {
            if self.cell(node).phase != Phase::Running || self.cell(node).open > 0 {
                continue;
            }
            let kind = &self.program.nodes[node].kind;
            let outcome = if matches!(kind, Kind::Concurrent { .. }) {
                self.par(node, None)
            } else if matches!(kind, Kind::FailFast { .. }) {
                self.ff(node)
            } else {
                None
            };
            if let Some(outcome) = outcome.and_then(|outcome| self.e_ctx(node, outcome)) {
                return Some(outcome);
            }
        }
        self.e_grant()
    }
}

impl State {
    /// Returns the idle state of a program that replaces this one's: the numbers of activations continue.
    pub fn idle_for(&self, next: &Program) -> Self {
        let mut state = Self::new(next);
        for (seat, before) in state.seats.iter_mut().zip(&self.seats) {
            seat.activation = before.activation;
        }
        state.timers.fill(self.timers.iter().copied().max().unwrap_or(Activation(0)));
        state
    }
}
