//! Steps that are computed once: explorers call this instead of [`step`](super::step).
//!
//! A reaction is local: it looks at the leaf that an event is about and at the operators around it, as far as the outcome
//! climbs. So most of the transitions of a large group are one of a few reactions, beside operands that do not matter.
//!
//! [`Steps`] runs `step` on a state that notes each item at which it looks, in that order. `step` is a function, so the same
//! event with the same words in the items that it looked at has the same effect. A *footprint* is the items that a step has looked
//! at; an effect is kept under its footprint and their words. Nothing is known here of the rules.

use super::event::{Activation, Command, Event, Outcome};
use super::packed::{Packing, Words, seat, word_of_seat};
use super::program::Program;
use super::state::{Cell, MemberState, State};
use super::step::step_in;
use std::cell::{OnceCell, RefCell};
use std::ops::{Index, IndexMut};

/// The number of effects kept for one event. Reactions that look at everything have too many, and the memo should fit
/// into a processor's cache (4096 of them were 1.6 times slower).
const EFFECTS_MAX: u32 = 256;
/// So many footprints has one event.
const FOOTPRINTS_MAX: usize = 12;
/// After this many more misses than hits, an event is not looked up any more.
const MISSED_MAX: u32 = 64;

/// The effect of a step.
#[derive(Clone, Debug, Default)]
pub struct Effect {
    /// The items that change, and their new words.
    pub writes: Vec<(u32, u64)>,
    /// The orders of the supervisor.
    pub commands: Vec<Command>,
    /// How the group has ended. None if it has not ended.
    pub outcome: Option<Outcome>,
}

/// The steps of one program, each computed once.
#[derive(Debug)]
pub struct Steps<'p> {
    program: &'p Program,
    packing: Packing,
    roots: Vec<Root>,
    /// The roots of events that carry a value.
    valued: Vec<(Event, usize)>,
    footprints: Vec<Vec<u32>>,
    kept: Vec<Kept>,
    /// The words of all that is kept.
    keys: Vec<u64>,
    /// Indices into `kept`, plus 1, at places given by a hash; at most half of them are taken.
    table: Vec<u32>,
    /// The effect of a step that was not kept.
    unkept: Effect,
    scratch: Scratch,
}

/// The known effects of one event.
#[derive(Clone, Debug, Default)]
struct Root {
    footprints: Vec<usize>,
    /// How many effects are kept.
    count: u32,
    /// The number of failed lookups, minus the number of successful lookups.
    missed: u32,
}

/// An effect, with its footprint and where the words of that begin.
#[derive(Debug)]
struct Kept {
    footprint: usize,
    key: usize,
    effect: Effect,
}

#[derive(Debug, Default)]
struct Scratch {
    cells: Vec<OnceCell<Cell>>,
    seats: Vec<OnceCell<MemberState>>,
    timers: Vec<Activation>,
    looked_at: Vec<u32>,
}

impl<'p> Steps<'p> {
    /// Returns the steps of a program, none of which is known yet.
    pub fn new(program: &'p Program, packing: &Packing) -> Self {
        let members = program.endless.len();
        let plain = 2 + 4 * members + program.timers.len();
        let scratch = Scratch {
            cells: vec![OnceCell::new(); program.nodes.len()],
            seats: vec![OnceCell::new(); members],
            timers: vec![Activation(1); program.timers.len()],
            looked_at: Vec::new(),
        };
        Self {
            program,
            packing: packing.clone(),
            roots: vec![Root::default(); plain],
            valued: Vec::new(),
            footprints: Vec::new(),
            kept: Vec::new(),
            keys: Vec::new(),
            table: vec![0; 64],
            unkept: Effect::default(),
            scratch,
        }
    }

    /// Returns the effect of an event in a state. All numbers of activations are 1.
    pub fn step(&mut self, words: &Words, event: Event) -> &Effect {
        let root = self.root(&event);
        let known = &self.roots[root];
        let found = if known.missed < MISSED_MAX { self.find(&known.footprints, words) } else { None };
        if let Some(found) = found {
            self.roots[root].missed = self.roots[root].missed.saturating_sub(1);
            return &self.kept[found].effect;
        }
        let effect = self.compute(words, event, None);
        match self.footprint(root) {
            Some(footprint) if self.roots[root].count < EFFECTS_MAX => self.keep(root, footprint, words, effect),
            Some(_) | None => {
                self.roots[root].missed += 1;
                self.unkept = effect;
                &self.unkept
            }
        }
    }

    /// Returns the nodes that end at an event, including those that are restarted in the same step.
    pub fn ended(&mut self, words: &Words, event: Event) -> Vec<usize> {
        let mut ended = Vec::new();
        self.unkept = self.compute(words, event, Some(&mut ended));
        ended
    }

    /// The effect kept under the words of one of some footprints.
    fn find(&self, footprints: &[usize], words: &Words) -> Option<usize> {
        footprints.iter().find_map(|&footprint| {
            let items = &self.footprints[footprint];
            let mask = self.table.len() - 1;
            let mut slot = hash(footprint, items.iter().map(|&item| words.get(item))) & mask;
            while let Some(index) = (self.table[slot] as usize).checked_sub(1) {
                let Kept { footprint: own, key, .. } = self.kept[index];
                let is_same = |(&item, &word): (&u32, &u64)| words.get(item) == word;
                if own == footprint && items.iter().zip(&self.keys[key..]).all(is_same) {
                    return Some(index);
                }
                slot = (slot + 1) & mask;
            }
            None
        })
    }

    /// The number of the last step's reads, as a footprint of an event.
    fn footprint(&mut self, root: usize) -> Option<usize> {
        let (own, looked_at) = (&mut self.roots[root].footprints, &self.scratch.looked_at);
        if let Some(known) = own.iter().find(|&&known| self.footprints[known] == *looked_at) {
            return Some(*known);
        }
        if own.len() == FOOTPRINTS_MAX {
            return None;
        }
        self.footprints.push(looked_at.clone());
        own.push(self.footprints.len() - 1);
        own.last().copied()
    }

    fn keep(&mut self, root: usize, footprint: usize, words: &Words, effect: Effect) -> &Effect {
        let key = self.keys.len();
        self.keys.extend(self.footprints[footprint].iter().map(|&item| words.get(item)));
        self.kept.push(Kept { footprint, key, effect });
        self.roots[root].count += 1;
        if self.kept.len() * 2 > self.table.len() {
            self.table = vec![0; 2 * self.table.len()];
            (0..self.kept.len()).for_each(|index| self.place(index));
        } else {
            self.place(self.kept.len() - 1);
        }
        &self.kept[self.kept.len() - 1].effect
    }

    /// Finds a place in the table.
    fn place(&mut self, index: usize) {
        let Kept { footprint, key, .. } = self.kept[index];
        let mask = self.table.len() - 1;
        let words = self.keys[key..].iter().take(self.footprints[footprint].len());
        let mut slot = hash(footprint, words.copied()) & mask;
        while self.table[slot] != 0 {
            slot = (slot + 1) & mask;
        }
        self.table[slot] = small(index + 1);
    }

    /// The number of an event's root.
    fn root(&mut self, event: &Event) -> usize {
        let of_member = |kind: usize, member: u32| 2 + 4 * member as usize + kind;
        let plain = match event {
            Event::Start(value) if value.bytes().is_empty() => Some(0),
            Event::Stop => Some(1),
            Event::Done { member, value, .. } if value.bytes().is_empty() => Some(of_member(0, *member)),
            Event::Aborted { member, report, .. } if report.bytes().is_empty() => Some(of_member(1, *member)),
            Event::Stopped { member, .. } => Some(of_member(2, *member)),
            Event::StopUnconfirmed { member, .. } => Some(of_member(3, *member)),
            Event::Elapsed { timer, .. } => Some(2 + 4 * self.program.endless.len() + *timer as usize),
            Event::Start(_) | Event::Done { .. } | Event::Aborted { .. } | Event::Message { .. } | Event::Notice(_) => {
                None
            }
        };
        let valued = || self.valued.iter().find(|(known, _)| known == event).map(|(_, root)| *root);
        if let Some(root) = plain.or_else(valued) {
            return root;
        }
        self.roots.push(Root::default());
        self.valued.push((event.clone(), self.roots.len() - 1));
        self.roots.len() - 1
    }

    /// Runs `step`, and records its reads.
    fn compute(&mut self, words: &Words, event: Event, ended: Option<&mut Vec<usize>>) -> Effect {
        let Self { program, packing, scratch, unkept, .. } = self;
        let (nodes, start) = (scratch.cells.len(), packing.usings_start());
        scratch.looked_at.clear();
        scratch.looked_at.extend((start..packing.items()).map(small));
        let looked_at = RefCell::new(std::mem::take(&mut scratch.looked_at));
        let (queue, holders) = packing.queue(words);
        let cell = |node: usize| packing.cell(words.get(small(node)));
        let seat = |member: usize| seat(words.get(small(nodes + member)));
        let mut state = State {
            cells: Watched { known: &mut scratch.cells, first: 0, read: cell, looked_at: &looked_at },
            seats: Watched { known: &mut scratch.seats, first: nodes, read: seat, looked_at: &looked_at },
            timers: std::mem::take(&mut scratch.timers),
            queue,
            holders,
            chart: packing.chart(program, words),
        };
        let mut effect = std::mem::take(unkept);
        effect.writes.clear();
        effect.commands.clear();
        effect.outcome = step_in(program, &mut state, event, &mut effect.commands, ended);
        let State { timers, queue, holders, chart, .. } = state;
        let chart = packing.words_of_chart(chart.as_deref());
        (scratch.looked_at, scratch.timers) = (looked_at.into_inner(), timers);
        scratch.timers.fill(Activation(1));
        for &item in &scratch.looked_at {
            let index = item as usize;
            let word = if index < nodes {
                scratch.cells[index].take().map(|cell| packing.word(&cell))
            } else if index < start {
                scratch.seats[index - nodes].take().map(|seat| word_of_seat(&seat))
            } else if index < packing.chart_start() {
                Some(packing.word_of_using(index, &queue, &holders))
            } else {
                chart.get(index - packing.chart_start()).copied()
            };
            effect.writes.extend(word.filter(|&word| word != words.get(item)).map(|word| (item, word)));
        }
        effect
    }
}

/// Cells or seats that are read from words when they are looked at for the first time.
struct Watched<'w, T, R> {
    known: &'w mut Vec<OnceCell<T>>,
    /// The item of the first.
    first: usize,
    read: R,
    looked_at: &'w RefCell<Vec<u32>>,
}

impl<T, R: Fn(usize) -> T> Index<usize> for Watched<'_, T, R> {
    type Output = T;

    fn index(&self, index: usize) -> &T {
        self.known[index].get_or_init(|| {
            self.looked_at.borrow_mut().push(small(self.first + index));
            (self.read)(index)
        })
    }
}

impl<T, R: Fn(usize) -> T> IndexMut<usize> for Watched<'_, T, R> {
    fn index_mut(&mut self, index: usize) -> &mut T {
        let _ = &self[index];
        self.known[index].get_mut().expect("it was read just now")
    }
}

fn hash(footprint: usize, words: impl Iterator<Item = u64>) -> usize {
    const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;
    let sum = words.fold(footprint as u64, |sum, word| (sum ^ word).wrapping_mul(FACTOR).rotate_left(29));
    usize::try_from(sum >> 32 ^ sum & 0xffff_ffff).unwrap_or(0)
}

fn small(count: usize) -> u32 {
    u32::try_from(count).expect("a plan has fewer than 2^32 nodes")
}
