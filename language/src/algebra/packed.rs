//! A state in a few bits a node, for an explorer that keeps millions of them.
//!
//! # Representation
//! Half a byte a node says its phase and the kind of outcome that it holds. If the values of outcomes matter, a byte a node
//! follows with the number of the value. At last the queue of `using`, three bytes a place. All else follows from these:
//! counts of operands from their phases, seats and holders from the nodes that are active. Two things are left out because no
//! rule reads them: why something has aborted (but for an unconfirmed stop), and the numbers of activations, which are all 1
//! in a state that was unpacked.

use super::event::{Activation, Cause, Outcome, Reason, Value};
use super::phase::Phase;
use super::program::{Kind, Program};
use super::state::{Cell, MemberState, State};
use std::sync::Arc;

/// How the states of one program are packed.
#[derive(Clone, Debug)]
pub struct Packing {
    nodes: usize,
    places: usize,
    /// Values by number; number 0 is the empty value, and every value that is not here.
    values: Vec<Value>,
    /// The reason of every abort but an unconfirmed stop.
    failed: Outcome,
}

/// What an outcome is, as far as it is kept.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Held {
    Nothing,
    Done,
    Aborted,
    Unconfirmed,
    Stopped,
}

/// What half a byte says.
const CODES: [(Phase, Held); 16] = [
    (Phase::Idle, Held::Nothing),
    (Phase::Running, Held::Nothing),
    (Phase::Running, Held::Aborted),
    (Phase::Running, Held::Unconfirmed),
    (Phase::Second, Held::Nothing),
    (Phase::Stopping, Held::Nothing),
    (Phase::Draining, Held::Done),
    (Phase::Draining, Held::Aborted),
    (Phase::Draining, Held::Unconfirmed),
    (Phase::Draining, Held::Stopped),
    (Phase::Done, Held::Done),
    (Phase::Waiting, Held::Done),
    (Phase::Second, Held::Done),
    (Phase::Second, Held::Aborted),
    (Phase::Second, Held::Unconfirmed),
    (Phase::Second, Held::Stopped),
];

impl Packing {
    /// Returns the packing of the states of a program. `values` are the values that outcomes may have besides the empty one,
    /// at most 255; any other is packed as the empty value.
    pub fn new(program: &Program, values: &[Value]) -> Self {
        let values = std::iter::once(Value::EMPTY).chain(values.iter().take(255).cloned()).collect();
        let reason = Reason { member: None, cause: Cause::Failed(Arc::from("")) };
        let (nodes, places) = (program.nodes.len(), program.usings);
        Self { nodes, places, values, failed: Outcome::Aborted(reason) }
    }

    /// Returns how many bytes a packed state has.
    pub fn length(&self) -> usize {
        let values = if self.values.len() > 1 { self.nodes } else { 0 };
        self.nodes.div_ceil(2) + values + 3 * self.places
    }

    /// Appends a state.
    pub fn pack(&self, state: &State, bytes: &mut Vec<u8>) {
        let of = |cell: Option<&Cell>| cell.map_or(0, code);
        bytes.extend(state.cells.chunks(2).map(|pair| of(pair.first()) | of(pair.get(1)) << 4));
        if self.values.len() > 1 {
            bytes.extend(state.cells.iter().map(|cell| self.number(cell)));
        }
        for place in 0..self.places {
            let node = state.queue.get(place).map_or(0, |&node| u32::try_from(node + 1).unwrap_or(0));
            bytes.extend(&node.to_le_bytes()[..3]);
        }
    }

    /// The number of the value that a cell holds.
    fn number(&self, cell: &Cell) -> u8 {
        let Some(Outcome::Done(value)) = &cell.outcome else { return 0 };
        let known = self.values.iter().position(|other| other == value);
        known.and_then(|known| u8::try_from(known).ok()).unwrap_or(0)
    }

    /// Makes `state` the one that was packed as `bytes`, which have [`Self::length`].
    pub fn unpack(&self, program: &Program, bytes: &[u8], state: &mut State) {
        let halves = self.nodes.div_ceil(2);
        for (node, cell) in state.cells.iter_mut().enumerate() {
            let (phase, held) = CODES[usize::from(bytes[node / 2] >> (4 * (node % 2)) & 15)];
            let value = if self.values.len() > 1 { usize::from(bytes[halves + node]) } else { 0 };
            *cell = Cell { phase, outcome: self.outcome(held, value), ..Cell::default() };
        }
        let queue = &bytes[bytes.len() - 3 * self.places..];
        state.queue.clear();
        for place in queue.chunks(3) {
            let node = u32::from_le_bytes([place[0], place[1], place[2], 0]) as usize;
            state.queue.extend(node.checked_sub(1));
        }
        derive(program, state);
    }

    fn outcome(&self, held: Held, value: usize) -> Option<Outcome> {
        match held {
            Held::Nothing => None,
            Held::Done => Some(Outcome::Done(self.values.get(value).cloned().unwrap_or_default())),
            Held::Aborted => Some(self.failed.clone()),
            Held::Unconfirmed => Some(Outcome::Aborted(Reason { member: None, cause: Cause::StopUnconfirmed })),
            Held::Stopped => Some(Outcome::Stopped),
        }
    }
}

fn code(cell: &Cell) -> u8 {
    let held = match &cell.outcome {
        None => Held::Nothing,
        Some(Outcome::Done(_)) => Held::Done,
        Some(Outcome::Aborted(reason)) if reason.cause == Cause::StopUnconfirmed => Held::Unconfirmed,
        Some(Outcome::Aborted(_)) => Held::Aborted,
        Some(Outcome::Stopped) => Held::Stopped,
    };
    let code = CODES.iter().position(|&known| known == (cell.phase, held));
    debug_assert!(code.is_some(), "every phase with the outcomes that it may hold is in the table");
    code.and_then(|code| u8::try_from(code).ok()).unwrap_or(0)
}

/// Fills in what follows from the phases of the nodes.
fn derive(program: &Program, state: &mut State) {
    state.seats.fill(MemberState { activation: Activation(1), node: None });
    state.timers.fill(Activation(1));
    state.holders.fill(None);
    for node in 0..program.nodes.len() {
        let phase = state.cells[node].phase;
        let is_active = phase.is_active();
        if phase == Phase::Draining {
            state.cells[node].open = count(program, state, node, |_| true);
            continue;
        }
        match &program.nodes[node].kind {
            Kind::Run { member, .. } if is_active => state.seats[*member as usize].node = Some(node),
            Kind::Using { .. } if is_active && phase != Phase::Waiting => {
                program.taken(node).iter().for_each(|&index| state.holders[index] = Some(node));
            }
            Kind::Concurrent { .. } if is_active => {
                state.cells[node].open = count(program, state, node, |operand| program.is_task(node, operand));
                state.cells[node].done = done(program, state, node);
            }
            Kind::FailFast { .. } | Kind::AnyOf { .. } if is_active => {
                state.cells[node].open = count(program, state, node, |_| true);
                state.cells[node].done = done(program, state, node);
            }
            Kind::Run { .. }
            | Kind::Skip
            | Kind::Never
            | Kind::Fail(_)
            | Kind::Wait { .. }
            | Kind::Concurrent { .. }
            | Kind::FailFast { .. }
            | Kind::AnyOf { .. }
            | Kind::Disable
            | Kind::Sequence
            | Kind::Conditional
            | Kind::Recurrent
            | Kind::Otherwise
            | Kind::Match { .. }
            | Kind::Shield { .. }
            | Kind::Using { .. }
            | Kind::Asynchronous
            | Kind::Finally
            | Kind::Tagged(_) => {}
        }
    }
}

/// How many operands are active.
fn count(program: &Program, state: &State, node: usize, counts: impl Fn(usize) -> bool) -> u32 {
    let is_active = |&operand: &usize| state.cells[operand].phase.is_active() && counts(operand);
    small(program.operands(node).filter(is_active).count())
}

fn done(program: &Program, state: &State, node: usize) -> u32 {
    small(program.operands(node).filter(|&operand| state.cells[operand].phase == Phase::Done).count())
}

fn small(count: usize) -> u32 {
    u32::try_from(count).expect("a plan has fewer than 2^32 operands")
}
