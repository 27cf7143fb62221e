//! Finds the programs that lose their data because another program fails, now or in a later step.

use super::span::{Span, span};
use crate::explore::Graph;
use crate::model::Model;
use crate::system::MemberRef;
use crate::system::{Frame, Phase, System};
use crate::wires::{Line, lines};
use language::algebra::Activity;
use std::cell::{OnceCell, RefCell};
use std::collections::{BTreeMap, BTreeSet};

/// For each state, whether a property holds there.
type InStates = Vec<bool>;

/// The wires of a system, and the states in which their readers lose data.
pub(super) struct Readers<'c, 'a> {
    system: &'c System<'a>,
    graph: &'c Graph,
    /// The wires to inputs that their programs require.
    lines: OnceCell<Vec<Line>>,
    /// For each sending program and each state, whether its data is read in this state or later.
    heard: RefCell<BTreeMap<u32, InStates>>,
    /// For each input and each state, whether its program runs without a sender in this state or later, although it never does without
    /// a fault.
    missed: RefCell<BTreeMap<(u32, String), Option<InStates>>>,
}

impl<'c, 'a> Readers<'c, 'a> {
    pub(super) fn new(system: &'c System<'a>, graph: &'c Graph) -> Self {
        Self { system, graph, lines: OnceCell::new(), heard: RefCell::default(), missed: RefCell::default() }
    }

    /// Returns whether a program reads the output of `sender`, in this state or later.
    pub(super) fn hear(&self, sender: u32, state: u32) -> bool {
        let mut heard = self.heard.borrow_mut();
        let heard = heard.entry(sender).or_insert_with(|| {
            let spans = self.spans(|model, line| model.plan.wires[line.wire as usize].from.leaf == sender);
            let is_read =
                |span: &Span, frame: &Frame| span.carries(self.system, frame) && self.system.is_running(frame, span.to);
            self.leads_to(|frame| spans.iter().any(|span| is_read(span, frame)))
        });
        heard.get(state as usize).copied().unwrap_or(false)
    }

    /// Returns whether a program runs without its lost sender, in this state or later, although it never does without a fault.
    pub(super) fn miss(&self, gone: &[u32], settled: &Frame, state: u32) -> bool {
        let model = self.system.model;
        let of_gone = |line: &&Line| gone.contains(&model.plan.wires[line.wire as usize].from.leaf);
        let inputs: BTreeSet<(u32, String)> =
            self.lines().iter().filter(of_gone).map(|line| input(model, line)).collect();
        inputs.into_iter().any(|(leaf, port)| self.misses(leaf, port, settled, state))
    }

    fn misses(&self, leaf: u32, port: String, settled: &Frame, state: u32) -> bool {
        let spans = self.spans(|model, line| input(model, line) == (leaf, port.clone()));
        let works = |frame: &Frame| {
            frame.phase == Phase::Running && spans.first().is_some_and(|span| self.system.is_running(frame, span.to))
        };
        let has_sender = |frame: &Frame| {
            let is_active =
                |MemberRef { unit, member }: MemberRef| frame.states[unit].activity(member) != Activity::Idle;
            spans.iter().any(|span| is_active(span.from))
        };
        let mut missed = self.missed.borrow_mut();
        let missed = missed.entry((leaf, port)).or_insert_with(|| {
            let is_bare = |frame: &Frame| works(frame) && !has_sender(frame);
            let is_normal = self.graph.first(self.system, |frame| !frame.is_faulty && is_bare(frame)).is_some();
            (!is_normal).then(|| self.leads_to(is_bare))
        });
        let Some(missed) = missed else { return false };
        let is_sent = spans.iter().any(|span| self.system.is_there(settled, span.from));
        works(settled) && !is_sent || missed.get(state as usize).copied().unwrap_or(false)
    }

    /// Returns for each state whether it, or a later state in a run without faults, has a property.
    fn leads_to(&self, has: impl FnMut(&Frame) -> bool) -> Vec<bool> {
        let goals = self.graph.which(self.system, has);
        self.graph.can_reach(&goals, &|label| self.system.is_natural(label))
    }

    fn spans(&self, is_it: impl Fn(&Model<'a>, &Line) -> bool) -> Vec<Span> {
        let lines = self.lines().iter().filter(|line| is_it(self.system.model, line));
        lines.filter_map(|line| span(self.system, line)).collect()
    }

    fn lines(&self) -> &[Line] {
        self.lines.get_or_init(|| {
            let model = self.system.model;
            let mut lines = lines(model);
            lines.retain(|line| {
                let (leaf, port) = input(model, line);
                !model.sites.leaves.get(leaf as usize).is_some_and(|facts| facts.optional.contains(&port))
            });
            lines
        })
    }
}

/// Returns the input at the end of a wire.
fn input(model: &Model<'_>, line: &Line) -> (u32, String) {
    let to = &model.plan.wires[line.wire as usize].to;
    (to.leaf, to.port.clone())
}
