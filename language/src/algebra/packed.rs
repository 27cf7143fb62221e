//! A state in few bits, for an explorer that keeps millions of them.
//!
//! # Representation
//! While an explorer works on a state, it is one number, a *word*, for each *item*: the nodes, the member slots, the places in
//! the queue of `using`, the resources. The word of a node has its phase and the kind of its outcome (4 bits), the number of
//! the outcome's value (8), how many operands are waited for (26) and how many are done (26).
//!
//! Where a state is stored, half a byte a node says its phase and the kind of its outcome. If the values of outcomes matter, a
//! byte a node follows with the number of the value. Then the queue of `using`, three bytes for each place, and for an
//! activity eight bytes with its state. All other data follows from these words: the counts of operands follow from
//! their phases, and seats and holders follow from the active nodes. The numbers of activations are left out, because
//! no rule reads them: they are all 1. Of an abort its report is kept.

use super::charts::Charts;
use super::event::{Activation, Cause, Outcome, Reason, Value};
use super::phase::Phase;
use super::program::{Kind, Program};
use super::state::{Activity, Cell, MemberState};
use crate::automaton::{Configuration, Failure};
use crate::script::ScriptErrorKind;

/// How the states of one program are packed.
#[derive(Clone, Debug)]
pub struct Packing {
    nodes: usize,
    members: usize,
    places: usize,
    resources: usize,
    /// How many bytes a packed state has.
    length: usize,
    /// Each `Run` node with its member.
    runs: Vec<(usize, u32)>,
    /// The nodes that count their operands.
    counting: Vec<usize>,
    /// The `Using` nodes.
    usings: Vec<usize>,
    /// Values by number; number 0 is the empty value, and every value that is not here.
    values: Vec<Value>,
    /// The items of an activity: where it is, and whether each of its timers is armed.
    charts: Option<Charts>,
}

/// A state of one program, a word for each item.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Words {
    words: Vec<u64>,
    nodes: usize,
    members: usize,
    /// Where the items of an activity begin.
    charts: usize,
}

/// The kept part of an outcome.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Held {
    Nothing,
    Done,
    Aborted,
    Unconfirmed,
    Stopped,
}

/// The meaning of each half byte.
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

/// The code of a phase and its held outcome; 16 for an impossible pair.
const CODE_OF: [[u8; 5]; 7] = {
    let (mut table, mut code) = ([[16; 5]; 7], 0);
    while code < 16 {
        let (phase, held) = CODES[code as usize];
        table[phase as usize][held as usize] = code;
        code += 1;
    }
    table
};

const CODE: u64 = 15;
const VALUE: u32 = 4;
const OPEN: u32 = 12;
const DONE: u32 = 38;
const COUNT: u64 = (1 << 26) - 1;

fn phase(word: u64) -> Phase {
    CODES[(word & CODE) as usize].0
}

impl Words {
    /// Returns the word of an item.
    pub fn get(&self, item: u32) -> u64 {
        self.words[item as usize]
    }

    /// Changes the word of an item; returns the previous word.
    pub fn set(&mut self, item: u32, word: u64) -> u64 {
        std::mem::replace(&mut self.words[item as usize], word)
    }

    /// Returns whether a node of the program is active, by its place in textual order.
    pub fn is_node_active(&self, node: usize) -> bool {
        self.words[..self.nodes].get(node).is_some_and(|&word| phase(word).is_active())
    }

    /// Returns whether a node is a `using` that waits for its resources.
    pub fn is_node_waiting(&self, node: usize) -> bool {
        self.words[..self.nodes].get(node).is_some_and(|&word| phase(word) == Phase::Waiting)
    }

    /// Returns whether a `shield` has received a stop and waits, or a `finally` runs because of a stop.
    pub fn is_held_up(&self, program: &Program) -> bool {
        let mut nodes = self.words[..self.nodes].iter().zip(&program.nodes);
        nodes.any(|(&word, node)| {
            let is_shielded = matches!(node.kind, Kind::Shield { .. }) && phase(word) == Phase::Second;
            let is_after_a_stop = CODES[(word & CODE) as usize] == (Phase::Second, Held::Stopped);
            is_shielded || matches!(node.kind, Kind::Finally) && is_after_a_stop
        })
    }

    /// Returns the activity of a member; idle for a slot that the group does not have.
    pub fn activity(&self, member: u32) -> Activity {
        match self.seats().get(member as usize) {
            None | Some(0) => Activity::Idle,
            Some(&seat) if self.seat_phase(seat) == Phase::Stopping => Activity::Stopping,
            Some(_) => Activity::Active,
        }
    }

    /// Returns the slots of the members that are active or stopping, in slot order.
    pub fn members_active(&self) -> impl Iterator<Item = u32> {
        (0..).zip(self.seats()).filter(|(_, seat)| **seat != 0).map(|(member, _)| member)
    }

    /// Returns whether a timer is armed.
    pub fn is_armed(&self, program: &Program, timer: u32) -> bool {
        if program.chart.as_ref().is_some_and(|chart| (timer as usize) < chart.timed.len()) {
            return self.words[self.charts + 2 + timer as usize] != 0;
        }
        let node = program.timers.get(timer as usize);
        node.is_some_and(|&node| phase(self.words[node]) == program.armed_phase(node))
    }

    /// Returns whether an activity would look at a message at once.
    pub fn hears(&self) -> bool {
        self.words.get(self.charts + 1).is_some_and(|&hears| hears != 0)
    }

    fn seats(&self) -> &[u64] {
        &self.words[self.nodes..self.nodes + self.members]
    }

    fn seat_phase(&self, seat: u64) -> Phase {
        number_to_node(seat).map_or(Phase::Idle, |node| phase(self.words[node]))
    }
}

impl Packing {
    /// Returns the packing of the states of a program. `values` are the values, besides the empty
    /// value, that outcomes may have, at most 255. Any other value is packed as the value with its
    /// tag, or as the empty value.
    pub fn new(program: &Program, values: &[Value]) -> Self {
        let values: Vec<Value> = std::iter::once(Value::EMPTY).chain(values.iter().take(255).cloned()).collect();
        let (nodes, members, places) = (program.nodes.len(), program.endless.len(), program.usings);
        let (mut runs, mut counting, mut usings) = (Vec::new(), Vec::new(), Vec::new());
        for (node, source) in program.nodes.iter().enumerate() {
            match source.kind {
                Kind::Run { member, .. } => runs.push((node, member)),
                Kind::Using { .. } => usings.push(node),
                Kind::Concurrent { .. }
                | Kind::FailFast { .. }
                | Kind::AnyOf { .. }
                | Kind::AtLeast { .. }
                | Kind::Disable
                | Kind::Named(_)
                | Kind::Asynchronous => counting.push(node),
                Kind::Skip
                | Kind::Never
                | Kind::Fail(_)
                | Kind::Wait { .. }
                | Kind::Sequence
                | Kind::Conditional
                | Kind::Recurrent
                | Kind::Otherwise
                | Kind::Match { .. }
                | Kind::Shield { .. }
                | Kind::Finally
                | Kind::Tagged(_)
                | Kind::With(_)
                | Kind::Repeat { .. }
                | Kind::Catch { .. }
                | Kind::Chart => {}
            }
        }
        let resources = program.resources().len();
        let charts = program.chart.as_deref().map(Charts::new);
        let own = charts.as_ref().map_or(0, |_| Charts::LENGTH);
        let length = nodes.div_ceil(2) + if values.len() > 1 { nodes } else { 0 } + 3 * places + own;
        Self { nodes, members, places, resources, length, runs, counting, usings, values, charts }
    }

    /// Returns how many bytes a packed state has.
    pub fn length(&self) -> usize {
        self.length
    }

    /// Returns the idle state.
    pub fn idle(&self) -> Words {
        let (items, charts) = (self.items(), self.chart_start());
        Words { words: vec![0; items], nodes: self.nodes, members: self.members, charts }
    }

    /// Appends a state.
    pub fn pack(&self, words: &Words, bytes: &mut Vec<u8>) {
        let start = bytes.len();
        bytes.resize(start + self.length(), 0);
        let queue = self.nodes + self.members..self.nodes + self.members + self.places;
        let chart = self.charts.as_ref().map(|_| self.chart_start());
        for item in (0..self.nodes).chain(queue).chain(chart) {
            self.patch(small(item), words.words[item], &mut bytes[start..]);
        }
    }

    /// Writes the word of one item into a packed state.
    pub fn patch(&self, item: u32, word: u64, bytes: &mut [u8]) {
        let item = item as usize;
        let bits = word.to_le_bytes();
        if let Some(place) = item.checked_sub(self.nodes + self.members) {
            let end = self.length() - self.charts.as_ref().map_or(0, |_| Charts::LENGTH);
            if place < self.places {
                let start = end - 3 * (self.places - place);
                bytes[start..start + 3].copy_from_slice(&bits[..3]);
            } else if item == self.chart_start() {
                bytes[end..].copy_from_slice(&bits);
            }
        } else if item < self.nodes {
            let byte = &mut bytes[item / 2];
            let code = bits[0] & 15;
            *byte = if item.is_multiple_of(2) { *byte & 0xf0 | code } else { *byte & 0x0f | code << 4 };
            if self.values.len() > 1 {
                bytes[self.nodes.div_ceil(2) + item] = (word >> VALUE).to_le_bytes()[0];
            }
        }
    }

    /// Makes `words` the state that was packed as `bytes`, which have [`Self::length`].
    pub fn unpack(&self, program: &Program, bytes: &[u8], words: &mut Words) {
        let all = &mut words.words;
        let halves = self.nodes.div_ceil(2);
        for (pair, byte) in all[..self.nodes].chunks_mut(2).zip(bytes) {
            let codes = [byte & 15, byte >> 4];
            pair.iter_mut().zip(codes).for_each(|(word, code)| *word = u64::from(code));
        }
        if self.values.len() > 1 {
            let values = &bytes[halves..halves + self.nodes];
            all[..self.nodes].iter_mut().zip(values).for_each(|(word, value)| *word |= u64::from(*value) << VALUE);
        }
        all[self.nodes..].fill(0);
        for &(node, member) in &self.runs {
            if phase(all[node]).is_active() {
                all[self.nodes + member as usize] = node_to_number(Some(node));
            }
        }
        let end = self.length() - self.charts.as_ref().map_or(0, |_| Charts::LENGTH);
        if let Some(charts) = &self.charts {
            let mut word = [0; Charts::LENGTH];
            word.copy_from_slice(&bytes[end..]);
            let start = self.chart_start();
            charts.unpack(u64::from_le_bytes(word), &mut all[start..]);
        }
        let queue = &bytes[end - 3 * self.places..end];
        for (place, bytes) in queue.chunks(3).enumerate() {
            let number = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], 0]);
            all[self.nodes + self.members + place] = u64::from(number);
        }
        for &node in &self.usings {
            let phase = phase(all[node]);
            if phase.is_active() && phase != Phase::Waiting {
                for &index in program.taken(node) {
                    all[self.nodes + self.members + self.places + index] = node_to_number(Some(node));
                }
            }
        }
        self.counting.iter().for_each(|&node| count(program, all, node));
    }

    /// The first item of `using`: its queue and the holders of the resources.
    pub(super) fn usings_start(&self) -> usize {
        self.nodes + self.members
    }

    /// How many items there are.
    pub(super) fn items(&self) -> usize {
        self.chart_start() + self.charts.as_ref().map_or(0, Charts::items)
    }

    /// Where the items of an activity begin.
    pub(super) fn chart_start(&self) -> usize {
        self.nodes + self.members + self.places + self.resources
    }

    /// Returns the state of an activity. None if the program is not an activity.
    pub fn chart(&self, program: &Program, words: &Words) -> Option<Box<Configuration>> {
        let word = words.words.get(self.chart_start()).copied().unwrap_or(0);
        Some(Box::new(self.charts.as_ref()?.configuration(program.automaton()?, word)))
    }

    /// Returns whether the next script of an activity may fail: the activity runs, and has scripts.
    pub fn may_fail_script(&self, program: &Program, words: &Words) -> bool {
        let is_possible = |configuration: &Configuration| !configuration.is_idle() && !configuration.fails_script();
        program.has_scripts() && self.chart(program, words).is_some_and(|configuration| is_possible(&configuration))
    }

    /// Returns the changed words of an activity whose next script fails: each item, with its word.
    pub fn fail_script(&self, program: &Program, words: &Words, kind: ScriptErrorKind) -> Vec<(u32, u64)> {
        let Some(mut configuration) = self.chart(program, words) else { return Vec::new() };
        configuration.fail_script(kind);
        (small(self.chart_start())..).zip(self.words_of_chart(Some(&configuration))).collect()
    }

    /// The words of where an activity is.
    pub(super) fn words_of_chart(&self, configuration: Option<&Configuration>) -> Vec<u64> {
        let Some((charts, configuration)) = self.charts.as_ref().zip(configuration) else { return Vec::new() };
        let plain = configuration.without_numbers(&|value| self.values[self.number(value)].clone());
        charts.words(plain)
    }

    /// The queue of a state, and the holders of resources.
    pub(super) fn queue(&self, words: &Words) -> (Vec<usize>, Vec<Option<usize>>) {
        let (queue, holders) = words.words[self.usings_start()..self.chart_start()].split_at(self.places);
        let queue = queue.iter().filter_map(|&number| number_to_node(number));
        (queue.collect(), holders.iter().map(|&number| number_to_node(number)).collect())
    }

    /// The word of an item of `using`.
    pub(super) fn word_of_using(&self, item: usize, queue: &[usize], holders: &[Option<usize>]) -> u64 {
        let place = item - self.usings_start();
        match place.checked_sub(self.places) {
            None => node_to_number(queue.get(place).copied()),
            Some(resource) => node_to_number(holders[resource]),
        }
    }

    /// The cell of a word.
    pub(super) fn cell(&self, word: u64) -> Cell {
        let (phase, held) = CODES[(word & CODE) as usize];
        let value = (word >> VALUE & 0xff) as usize;
        let outcome = match held {
            Held::Nothing => None,
            Held::Done => Some(Outcome::Done(self.values.get(value).cloned().unwrap_or_default())),
            Held::Aborted => Some(aborted(Cause::Reported(self.values.get(value).cloned().unwrap_or_default()))),
            Held::Unconfirmed => Some(aborted(Cause::StopUnconfirmed)),
            Held::Stopped => Some(Outcome::Stopped),
        };
        let count = |shift: u32| u32::try_from(word >> shift & COUNT).unwrap_or(0);
        Cell { phase, open: count(OPEN), done: count(DONE), outcome }
    }

    /// The value behind a tag is only kept if it is one of the values. The tag is always kept: a `match` may look at it later.
    fn number(&self, value: &Value) -> usize {
        value.place_in(&self.values).unwrap_or(0)
    }

    /// The number of the report of a failure.
    fn report(&self, reason: &Failure) -> usize {
        match self.number(&reason.report()) {
            0 if *reason != Failure::Reported => self.number(&Failure::other().report()),
            number => number,
        }
    }

    /// The word of a cell.
    pub(super) fn word(&self, cell: &Cell) -> u64 {
        let (held, value) = match &cell.outcome {
            None => (Held::Nothing, 0),
            Some(Outcome::Done(value)) => (Held::Done, self.number(value)),
            Some(Outcome::Aborted(reason)) if reason.cause == Cause::StopUnconfirmed => (Held::Unconfirmed, 0),
            Some(Outcome::Aborted(reason)) => (Held::Aborted, self.report(&Failure::of(&reason.cause))),
            Some(Outcome::Stopped) => (Held::Stopped, 0),
        };
        let code = CODE_OF[cell.phase as usize][held as usize];
        debug_assert!(code < 16, "every phase with the outcomes that it may hold is in the table");
        let (open, done) = (u64::from(cell.open), u64::from(cell.done));
        u64::from(code) | (value as u64) << VALUE | open << OPEN | done << DONE
    }
}

/// The outcome of all that has failed for this cause.
fn aborted(cause: Cause) -> Outcome {
    Outcome::Aborted(Reason { member: None, cause })
}

/// The seat of a word.
pub(super) fn seat(word: u64) -> MemberState {
    MemberState { activation: Activation(1), node: number_to_node(word) }
}

/// The word of a seat.
pub(super) fn word_of_seat(seat: &MemberState) -> u64 {
    node_to_number(seat.node)
}

fn node_to_number(node: Option<usize>) -> u64 {
    node.map_or(0, |node| node as u64 + 1)
}

fn number_to_node(number: u64) -> Option<usize> {
    usize::try_from(number).ok()?.checked_sub(1)
}

/// Fills in how many operands of a node are waited for, and how many are done.
fn count(program: &Program, all: &mut [u64], node: usize) {
    let own = phase(all[node]);
    if !own.is_active() {
        return;
    }
    let kind = &program.nodes[node].kind;
    let has_slots = !matches!(kind, Kind::Disable | Kind::Asynchronous | Kind::Named(_)) && own != Phase::Draining;
    let waits_for_all = !matches!(kind, Kind::Concurrent { .. });
    let is_counted =
        |operand: usize| own == Phase::Draining || has_slots && (waits_for_all || program.is_task(node, operand));
    let (mut open, mut done) = (0, 0);
    for operand in program.operands(node) {
        let phase = phase(all[operand]);
        open += u64::from(phase.is_active() && is_counted(operand));
        done += u64::from(has_slots && phase == Phase::Done);
    }
    all[node] |= open << OPEN | done << DONE;
}

fn small(count: usize) -> u32 {
    u32::try_from(count).expect("a plan has fewer than 2^32 nodes")
}
