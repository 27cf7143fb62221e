//! Steps that are computed once: what an explorer calls instead of [`step`](super::step).
//!
//! A reaction is local: it looks at the leaf that an event is about and at the operators around it, as far as the outcome
//! climbs. So most of the transitions of a large group are one of a few reactions, beside operands that do not matter.
//!
//! [`Steps`] runs `step` on a state that notes each item at which it looks, in that order. `step` is a function, so the same
//! event with the same words in the items that it looked at has the same effect. The effects are kept in a tree: each fork asks
//! for the word of one item. Nothing is known here of the rules.

use super::event::{Activation, Command, Event, Outcome};
use super::packed::{Packing, Words, seat, word_of_seat};
use super::program::Program;
use super::state::{Cell, MemberState, State};
use super::step::step_in;
use std::cell::{OnceCell, RefCell};
use std::collections::HashMap;
use std::ops::{Index, IndexMut};

/// So many effects are kept of one event: of reactions that look at everything there are too many.
const EFFECTS_MAX: u32 = 2048;

/// What a step does.
#[derive(Clone, Debug, Default)]
pub struct Effect {
    /// The items that change, and their words from then on.
    pub writes: Vec<(u32, u64)>,
    /// What the supervisor orders.
    pub commands: Vec<Command>,
    /// How the group has ended, if it has.
    pub outcome: Option<Outcome>,
}

/// The steps of one program, each computed once.
#[derive(Debug)]
pub struct Steps<'p> {
    program: &'p Program,
    packing: Packing,
    /// For each event, its tree and how many effects are in it.
    roots: Vec<(Branch, u32)>,
    /// The roots of events that carry a value.
    valued: HashMap<Event, usize>,
    forks: Vec<Fork>,
    effects: Vec<Effect>,
    /// The effect of a step that was not kept.
    unkept: Effect,
    scratch: Scratch,
}

/// What a branch of a tree leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Branch {
    Unknown,
    Fork(u32),
    Effect(u32),
}

#[derive(Debug)]
struct Fork {
    item: u32,
    branches: Vec<(u64, Branch)>,
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
            roots: vec![(Branch::Unknown, 0); plain],
            valued: HashMap::new(),
            forks: Vec::new(),
            effects: Vec::new(),
            unkept: Effect::default(),
            scratch,
        }
    }

    /// Returns what an event does in a state. All numbers of activations are 1.
    pub fn step(&mut self, words: &Words, event: Event) -> &Effect {
        let root = self.root(&event);
        let mut at = self.roots[root].0;
        while let Branch::Fork(fork) = at {
            let Fork { item, branches } = &self.forks[fork as usize];
            let word = words.get(*item);
            at = branches.iter().find(|(known, _)| *known == word).map_or(Branch::Unknown, |(_, branch)| *branch);
        }
        if let Branch::Effect(effect) = at {
            return &self.effects[effect as usize];
        }
        let effect = self.compute(words, event);
        if self.roots[root].1 >= EFFECTS_MAX {
            self.unkept = effect;
            return &self.unkept;
        }
        self.keep(root, words, effect)
    }

    /// The number of the tree of an event.
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
            Event::Start(_) | Event::Done { .. } | Event::Aborted { .. } => None,
        };
        if let Some(plain) = plain.or_else(|| self.valued.get(event).copied()) {
            return plain;
        }
        self.roots.push((Branch::Unknown, 0));
        self.valued.insert(event.clone(), self.roots.len() - 1);
        self.roots.len() - 1
    }

    /// Lets `step` run, and sees what it looks at.
    fn compute(&mut self, words: &Words, event: Event) -> Effect {
        let Self { program, packing, scratch, .. } = self;
        let (nodes, start) = (scratch.cells.len(), packing.usings_start());
        scratch.looked_at.clear();
        scratch.looked_at.extend((start..packing.items()).map(small));
        let looked_at = RefCell::new(std::mem::take(&mut scratch.looked_at));
        let (queue, holders) = packing.queue(words);
        let cell = |node: usize| packing.cell(words.get(small(node)));
        let seat = |member: usize| seat(words.get(small(nodes + member)));
        let mut state = State {
            cells: Watched { known: &mut scratch.cells, first: 0, read: &cell, looked_at: &looked_at },
            seats: Watched { known: &mut scratch.seats, first: nodes, read: &seat, looked_at: &looked_at },
            timers: std::mem::take(&mut scratch.timers),
            queue,
            holders,
        };
        let mut effect = Effect::default();
        effect.outcome = step_in(program, &mut state, event, &mut effect.commands);
        let State { timers, queue, holders, .. } = state;
        (scratch.looked_at, scratch.timers) = (looked_at.into_inner(), timers);
        scratch.timers.fill(Activation(1));
        for &item in &scratch.looked_at {
            let index = item as usize;
            let word = if index < nodes {
                scratch.cells[index].take().map(|cell| packing.word(&cell))
            } else if index < start {
                scratch.seats[index - nodes].take().map(|seat| word_of_seat(&seat))
            } else {
                Some(packing.word_of_using(index, &queue, &holders))
            };
            effect.writes.extend(word.filter(|&word| word != words.get(item)).map(|word| (item, word)));
        }
        effect
    }

    /// Puts an effect at the end of the way that `step` has looked at.
    fn keep(&mut self, root: usize, words: &Words, effect: Effect) -> &Effect {
        let number = small(self.effects.len());
        self.effects.push(effect);
        self.roots[root].1 += 1;
        let mut link: Option<(usize, usize)> = None;
        let looked_at = std::mem::take(&mut self.scratch.looked_at);
        for &item in &looked_at {
            let fork = match self.branch(root, link) {
                Branch::Fork(fork) => fork as usize,
                Branch::Unknown | Branch::Effect(_) => {
                    self.forks.push(Fork { item, branches: Vec::new() });
                    let fork = self.forks.len() - 1;
                    *self.branch_mut(root, link) = Branch::Fork(small(fork));
                    fork
                }
            };
            let (word, branches) = (words.get(item), &mut self.forks[fork].branches);
            let known = branches.iter().position(|(known, _)| *known == word);
            let branch = known.unwrap_or_else(|| {
                branches.push((word, Branch::Unknown));
                branches.len() - 1
            });
            link = Some((fork, branch));
        }
        self.scratch.looked_at = looked_at;
        *self.branch_mut(root, link) = Branch::Effect(number);
        &self.effects[number as usize]
    }

    fn branch(&self, root: usize, link: Option<(usize, usize)>) -> Branch {
        link.map_or(self.roots[root].0, |(fork, branch)| self.forks[fork].branches[branch].1)
    }

    fn branch_mut(&mut self, root: usize, link: Option<(usize, usize)>) -> &mut Branch {
        match link {
            None => &mut self.roots[root].0,
            Some((fork, branch)) => &mut self.forks[fork].branches[branch].1,
        }
    }
}

/// Cells or seats that are read from words when they are looked at for the first time.
struct Watched<'w, T> {
    known: &'w mut Vec<OnceCell<T>>,
    /// The item of the first.
    first: usize,
    read: &'w dyn Fn(usize) -> T,
    looked_at: &'w RefCell<Vec<u32>>,
}

impl<T> Index<usize> for Watched<'_, T> {
    type Output = T;

    fn index(&self, index: usize) -> &T {
        self.known[index].get_or_init(|| {
            self.looked_at.borrow_mut().push(small(self.first + index));
            (self.read)(index)
        })
    }
}

impl<T> IndexMut<usize> for Watched<'_, T> {
    fn index_mut(&mut self, index: usize) -> &mut T {
        let _ = &self[index];
        self.known[index].get_mut().expect("it was read just now")
    }
}

fn small(count: usize) -> u32 {
    u32::try_from(count).expect("a plan has fewer than 2^32 nodes")
}
