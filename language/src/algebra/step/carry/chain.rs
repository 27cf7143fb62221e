//! `P ; Q ; R`, `P : Q : R` and `P else Q else R`: chains, which are nested as pairs in any way.

use super::{Carrying, Misfit};
use crate::algebra::phase::Phase;
use crate::algebra::program::{Kind, Program};
use crate::algebra::state::Cell;

/// The operators that are written as chains and nested as pairs.
#[derive(Clone, Copy)]
pub(super) enum Chain {
    Sequence,
    Conditional,
    Otherwise,
}

impl Chain {
    pub(super) fn has(self, program: &Program, node: usize) -> bool {
        match self {
            Self::Sequence => program.nodes[node].kind == Kind::Sequence,
            Self::Conditional => program.nodes[node].kind == Kind::Conditional,
            Self::Otherwise => program.nodes[node].kind == Kind::Otherwise,
        }
    }

    /// Returns the operands of the chain that a node is the top of, in the order of the text.
    fn links(self, program: &Program, node: usize) -> Vec<usize> {
        let (mut links, mut waiting) = (Vec::new(), vec![node]);
        while let Some(node) = waiting.pop() {
            if self.has(program, node) {
                waiting.extend([program.second(node), program.first(node)]);
            } else {
                links.push(node);
            }
        }
        links
    }
}

impl Carrying<'_> {
    /// In `P ; Q ; R`, with any nesting of its pairs, one operand runs. The operands before and after it may be
    /// anything.
    pub(super) fn place_chain(&mut self, o: usize, n: usize, chain: Chain, calm: bool) -> Result<(), Misfit> {
        let (links, others) = (chain.links(self.program, o), chain.links(self.next, n));
        let is_active = |link: &usize| self.state.cells[*link].phase.is_active();
        let Some(place) = links.iter().position(is_active) else { return Err(self.misfit(o, "")) };
        let link = links[place];
        let mut order: Vec<(bool, usize, usize)> = Vec::new();
        for (at, &other) in others.iter().enumerate() {
            let is_same = self.is_same(link, other);
            // Another operand of the chain keeps this place.
            if is_same || !links.iter().any(|&before| before != link && self.is_same(before, other)) {
                order.push((!is_same, at.abs_diff(place), other));
            }
        }
        order.sort_unstable();
        let mut misfit = self.misfit(link, "the new event actions have no place for it there");
        let is_only = others.len() == links.len();
        for (nth, (_, _, other)) in order.into_iter().enumerate() {
            // The operand that is chosen for its place has the reason if it does not fit.
            match self.place(link, other, calm) {
                Ok(()) => {
                    let is_stopping = self.state.cells[o].phase == Phase::Stopping;
                    self.lead_to(other, n, is_stopping);
                    return Ok(());
                }
                Err(why) if nth == 0 && is_only => misfit = why,
                Err(_) => {}
            }
        }
        Err(misfit)
    }

    /// Enters the nodes of a chain on the way to the operand that runs.
    fn lead_to(&mut self, link: usize, n: usize, is_stopping: bool) {
        let mut node = link;
        while node != n {
            let Some(parent) = self.next.nodes[node].parent else { return };
            let phase = match node == self.next.first(parent) {
                _ if is_stopping => Phase::Stopping,
                true => Phase::Running,
                false => Phase::Second,
            };
            self.draft.cells[parent] = Cell { phase, ..Cell::default() };
            node = parent;
        }
    }
}
