//! The state of a group: where it is in its expression.
//!
//! # Representation
//! One [`Cell`] for each node of the program, one [`MemberState`] for each member slot, one number for each timer. Nothing is
//! pushed or popped while a group runs: `;;` flips the phase of its cell in place, so a loop runs in constant memory.
//!
//! The configurations of the rules are spread over the cells like this (a node that is not part of the configuration is
//! [`Phase::Idle`] and empty):
//!
//! ```text
//!   a.i<n>, w(d), never      Running                  C;F  C:F  rec1  C else F      Running (first operand active)
//!   s.i<n>                   Stopping                 F of C;F, C:F, else; rec2     Second  (second operand active)
//!   par[..] ff[..] anyk[..]  Running, open, done      stop(C;F) and the like        Stopping (the rest is forgotten)
//!   dis[..]                  Running                  drain(o,Cs)                   Draining: outcome = o, open = |Cs|
//!   slot done(v)             Done, outcome = done(v)  slot aborted(r)               Idle; the first r is the
//!                                                                                   operator's outcome
//!   acq(res,E,v)             Waiting, outcome =       shieldK(C)                    Second; `shield` after its bound:
//!                            done(v), in the queue                                  Stopping
//!   arec: P done(u), pool    P: Done, outcome =       arec that ends                Draining, but its pool continues
//!   full                     done(u)
//!   fin1(C,F)                Running; stop: Stopping  fin2(o,C)                     Second, outcome = o
//!   p => C with value v      Second, outcome = done(v); stop: Draining, outcome = done(v)
//! ```
//!
//! Invariants, between two events:
//! - an active node (`Running`, `Second`, `Stopping`, `Draining`) other than the root has an active parent;
//! - below a node that is `Stopping` or `Draining`, every active leaf is `Stopping` and no timer is armed, except below
//!   a `shield` or a `finally` that is `Second` or a `::`;
//! - `open` is the number of operands that the operator still waits for, and is greater than 0 in `Draining`;
//! - a seat names a node exactly while that `Run` node is `Running` or `Stopping`;
//! - a `using` is in the queue exactly while it is `Waiting`, and holds its resources while it is otherwise active.

use super::event::{Activation, Outcome};
use super::phase::Phase;
use super::program::Program;
use crate::automaton::Configuration;
use crate::script::ScriptErrorKind;
use serde::{Deserialize, Serialize};

/// The configuration of one group: idle, running or stopping. Belongs to one [`Program`].
///
/// The storage of cells and seats is a parameter, so that an explorer can see which of them [`step`](super::step)
/// reads.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct State<C = Vec<Cell>, S = Vec<MemberState>> {
    pub(super) cells: C,
    pub(super) seats: S,
    pub(super) timers: Vec<Activation>,
    /// The `Using` nodes that wait, the first to come first.
    pub(super) queue: Vec<usize>,
    /// For each thing that `using` takes, the node that has it.
    pub(super) holders: Vec<Option<usize>>,
    /// The state of an activity. None if the group is not an activity.
    pub(super) chart: Option<Box<Configuration>>,
}

/// The state of one node. Opaque, but comparable: see [`State::configuration`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Cell {
    pub(super) phase: Phase,
    /// Operands that are waited for.
    pub(super) open: u32,
    /// Operands that are done.
    pub(super) done: u32,
    /// Of a slot: its value. Of an operator: its first abort while it runs, its decided outcome while it drains.
    pub(super) outcome: Option<Outcome>,
}

/// The activations of one member. Opaque.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct MemberState {
    /// The latest one; 0 before the first.
    pub(super) activation: Activation,
    /// The `Run` node that holds it now.
    pub(super) node: Option<usize>,
}

/// The state of a member, as far as its supervisor knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Activity {
    /// Not activated.
    Idle,
    /// Activated; it has not ended.
    Active,
    /// Asked to stop; it has not confirmed.
    Stopping,
}

impl State {
    /// Returns the idle state, in which no member was ever activated.
    pub fn new(program: &Program) -> Self {
        Self {
            cells: vec![Cell::default(); program.nodes.len()],
            seats: vec![MemberState::default(); program.endless.len()],
            timers: vec![Activation::default(); program.timers.len()],
            queue: Vec::with_capacity(program.usings),
            holders: vec![None; program.resources().len()],
            chart: program.automaton().map(|automaton| Box::new(Configuration::new(automaton))),
        }
    }

    /// Returns the idle state of a group whose members' activations are numbered from there on.
    pub fn numbered_from(program: &Program, last: Activation) -> Self {
        let mut state = Self::new(program);
        state.seats.iter_mut().for_each(|seat| seat.activation = last);
        state
    }

    /// Returns whether nothing of the group runs: it was not started since its last outcome.
    pub fn is_idle(&self) -> bool {
        !self.cells[0].phase.is_active()
    }

    /// Lets the next script of an activity fail.
    pub fn fail_script(&mut self, kind: ScriptErrorKind) {
        if let Some(chart) = &mut self.chart {
            chart.fail_script(kind);
        }
    }

    /// Returns the activity of a member; idle for a slot that the group does not have.
    pub fn activity(&self, member: u32) -> Activity {
        match self.seats.get(member as usize).and_then(|seat| seat.node) {
            None => Activity::Idle,
            Some(node) if self.cells[node].phase == Phase::Stopping => Activity::Stopping,
            Some(_) => Activity::Active,
        }
    }

    /// Returns the number of a member's latest activation, 0 before the first.
    pub fn activation(&self, member: u32) -> Activation {
        self.seats.get(member as usize).map_or(Activation(0), |seat| seat.activation)
    }

    /// Returns the number of a timer's latest arm and whether it is armed now.
    pub fn timer(&self, program: &Program, timer: u32) -> (Activation, bool) {
        let node = program.timers.get(timer as usize);
        let transition = program.chart.as_ref().and_then(|chart| chart.timed.get(timer as usize));
        let armed = match (&self.chart, transition) {
            (Some(chart), Some(&transition)) => chart.timer(transition).1,
            (_, _) => node.is_some_and(|&node| self.cells[node].phase == program.armed_phase(node)),
        };
        (self.timers.get(timer as usize).copied().unwrap_or_default(), armed)
    }

    /// Returns the state of an activity. None if the group is not an activity.
    pub fn chart(&self) -> Option<&Configuration> {
        self.chart.as_deref()
    }

    /// Returns the slots of the members that are active or stopping, in slot order.
    pub fn members_active(&self) -> impl Iterator<Item = u32> {
        (0..).zip(&self.seats).filter(|(_, seat)| seat.node.is_some()).map(|(member, _)| member)
    }

    /// Returns the resource names of each waiting `using`, the earliest first.
    pub fn waiting<'a>(&'a self, program: &'a Program) -> impl Iterator<Item = impl Iterator<Item = &'a str>> {
        self.queue.iter().map(|&node| program.taken(node).iter().map(|&index| program.resources()[index].as_str()))
    }

    /// Returns the part of the state that decides the future, without the numbers of activations.
    /// Two states of one program with equal configurations react in the same way to the same
    /// events. An explorer keys its visited states by this. It contains the phase of each node, and
    /// the nodes that wait, in the order of their arrival. Of an activity, [`State::chart`] belongs
    /// to it.
    pub fn configuration(&self) -> (&[Cell], &[usize]) {
        (&self.cells, &self.queue)
    }
}
