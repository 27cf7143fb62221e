//! Questions about one configuration. Each answer is the sentence of the rule, asked of all states.

use super::{Heard, Set};
use language::algebra::Cause;
use language::automaton::{Chart, Failure, Formula, History, Relation, StateKind, Target, Trigger};
use std::collections::BTreeMap;

/// A configuration.
#[derive(Clone, Copy)]
pub(super) struct Place<'a> {
    pub(super) chart: &'a Chart,
    pub(super) active: &'a Set,
    pub(super) variables: &'a [i32],
    pub(super) memories: &'a BTreeMap<usize, Set>,
}

impl Place<'_> {
    /// Whether `state` is inside `other`, at any depth.
    fn is_inside(self, state: usize, other: usize) -> bool {
        let parent = self.chart.states[state].parent;
        parent.is_some_and(|parent| parent == other || self.is_inside(parent, other))
    }

    fn kind(&self, state: usize) -> &StateKind {
        &self.chart.states[state].kind
    }

    fn is_history(&self, state: usize) -> bool {
        matches!(self.kind(state), StateKind::History { .. })
    }

    fn children(self, state: usize) -> Set {
        let all = 0..self.chart.states.len();
        all.filter(|&child| self.chart.states[child].parent == Some(state) && !self.is_history(child)).collect()
    }

    /// The active states without active inner states.
    pub(super) fn leaves(self) -> Set {
        let is_leaf = |&state: &usize| !self.active.iter().any(|&inner| self.is_inside(inner, state));
        self.active.iter().copied().filter(is_leaf).collect()
    }

    pub(super) fn has_completed(self, state: usize) -> bool {
        let children = self.children(state);
        match self.kind(state) {
            StateKind::Compound { .. } => {
                children.iter().any(|child| self.active.contains(child) && *self.kind(*child) == StateKind::Final)
            }
            StateKind::Parallel => children.iter().all(|&child| self.has_completed(child)),
            _ => false,
        }
    }

    pub(super) fn number(self, formula: &Formula) -> i64 {
        let truth = i64::from;
        match formula {
            Formula::Number(number) => *number,
            Formula::Variable(variable) => self.variables[*variable].into(),
            Formula::In(state) => truth(self.active.contains(state)),
            Formula::Not(a) => truth(self.number(a) == 0),
            Formula::And(a, b) => truth(self.number(a) != 0 && self.number(b) != 0),
            Formula::Or(a, b) => truth(self.number(a) != 0 || self.number(b) != 0),
            Formula::Compare(Relation::Equal, a, b) => truth(self.number(a) == self.number(b)),
            Formula::Compare(Relation::Less, a, b) => truth(self.number(a) < self.number(b)),
            Formula::Compare(Relation::AtMost, a, b) => truth(self.number(a) <= self.number(b)),
            Formula::Add(a, b) => clamp(i128::from(self.number(a)) + i128::from(self.number(b))),
            Formula::Subtract(a, b) => clamp(i128::from(self.number(a)) - i128::from(self.number(b))),
            Formula::Multiply(a, b) => clamp(i128::from(self.number(a)) * i128::from(self.number(b))),
        }
    }

    /// Where a transition leads, histories and `resume` replaced.
    pub(super) fn leads_to(self, number: usize) -> Set {
        let transition = &self.chart.transitions[number];
        match &transition.target {
            Target::Stay | Target::Done(_) | Target::Abort(_) => Set::new(),
            Target::States(targets) => targets.iter().flat_map(|&target| self.meant(target)).collect(),
            Target::Resume => match self.memories.get(&transition.source) {
                Some(memory) => memory.clone(),
                None => match self.chart.states[transition.source].parent.map(|parent| self.kind(parent)) {
                    Some(StateKind::Compound { initial }) => {
                        initial.iter().flat_map(|&target| self.meant(target)).collect()
                    }
                    _ => panic!("a suspended state is inside a compound one"),
                },
            },
        }
    }

    fn meant(self, target: usize) -> Set {
        match self.kind(target) {
            StateKind::History { default, .. } => {
                self.memories.get(&target).cloned().unwrap_or_else(|| default.iter().copied().collect())
            }
            _ => Set::from([target]),
        }
    }

    /// The smallest state around the source and the targets; the source may be that itself if the transition is internal.
    pub(super) fn domain(self, number: usize) -> usize {
        let (transition, targets) = (&self.chart.transitions[number], self.leads_to(number));
        let source = transition.source;
        let is_internal = transition.internal && matches!(self.kind(source), StateKind::Compound { .. });
        let is_around = |state: &usize| {
            let has_source = self.is_inside(source, *state) || (is_internal && *state == source);
            has_source && targets.iter().all(|&target| self.is_inside(target, *state))
        };
        // Of the states around one state, the innermost has the greatest number.
        (0..self.chart.states.len()).filter(is_around).max().unwrap_or(0)
    }

    /// The states that transitions leave.
    pub(super) fn left(self, chosen: &[usize]) -> Set {
        let leaves = |number: usize, domain: usize, state: usize| match self.chart.transitions[number].target {
            Target::Stay => false,
            Target::Done(_) | Target::Abort(_) => true,
            Target::States(_) | Target::Resume => self.is_inside(state, domain),
        };
        let domains: Vec<(usize, usize)> = chosen.iter().map(|&number| (number, self.domain(number))).collect();
        let is_left = |state: &usize| domains.iter().any(|&(number, domain)| leaves(number, domain, *state));
        self.active.iter().copied().filter(is_left).collect()
    }

    /// The new memories of histories when states are left.
    pub(super) fn recalled(self, exits: &Set) -> BTreeMap<usize, Set> {
        let mut memories = BTreeMap::new();
        for history in 0..self.chart.states.len() {
            let (StateKind::History { depth, .. }, Some(parent)) =
                (self.kind(history), self.chart.states[history].parent)
            else {
                continue;
            };
            if exits.contains(&parent) {
                let memory = match depth {
                    History::Shallow => self.active.intersection(&self.children(parent)).copied().collect(),
                    History::Deep => self.leaves().into_iter().filter(|&leaf| self.is_inside(leaf, parent)).collect(),
                };
                memories.insert(history, memory);
            }
        }
        memories
    }

    /// The new memories of suspended states when states are left and entered.
    pub(super) fn suspending(self, left: &Set, entries: &Set) -> BTreeMap<usize, Set> {
        let is_suspended = |state: &usize| *self.kind(*state) == StateKind::Suspended;
        let mut memories = BTreeMap::new();
        for state in entries.iter().copied().filter(|state| is_suspended(state)) {
            let parent = self.chart.states[state].parent.expect("a suspended state is not the root");
            let inside: Set = left.iter().copied().filter(|&leaf| self.is_inside(leaf, parent)).collect();
            let sibling = inside.iter().find(|&leaf| is_suspended(leaf) && self.children(parent).contains(leaf));
            match sibling {
                _ if inside.is_empty() => None,
                Some(sibling) => self.memories.get(sibling).cloned(),
                None => Some(inside.clone()),
            }
            .and_then(|memory| memories.insert(state, memory));
        }
        memories
    }

    /// The states inside `domain` that are active after `targets` were entered: a recursion over the tree.
    pub(super) fn begun(self, domain: usize, targets: &Set) -> Set {
        let leads = |state: usize| targets.iter().any(|&target| target == state || self.is_inside(target, state));
        let mut states = Set::new();
        match self.kind(domain) {
            StateKind::Compound { initial } => {
                let towards = self.children(domain).into_iter().find(|&child| leads(child));
                let (child, targets) = match towards {
                    Some(child) => (child, targets.clone()),
                    None => {
                        let targets: Set = initial.iter().flat_map(|&target| self.meant(target)).collect();
                        let leads = |&child: &usize| {
                            targets.iter().any(|&target| target == child || self.is_inside(target, child))
                        };
                        (self.children(domain).into_iter().find(leads).expect("it begins inside"), targets)
                    }
                };
                states.insert(child);
                states.extend(self.begun(child, &targets));
            }
            StateKind::Parallel => {
                for region in self.children(domain) {
                    states.insert(region);
                    states.extend(self.begun(region, targets));
                }
            }
            _ => {}
        }
        states
    }

    /// The transitions that an event takes: those enabled that no other one which is taken precedes.
    pub(super) fn taken(self, heard: &Heard) -> Vec<usize> {
        let own = |state: usize| self.enabled(state, heard).into_iter().collect();
        match heard {
            Heard::Done(state, _) | Heard::Complete(state) => return own(*state),
            Heard::Aborted(state, _) => return self.nearest(*state, heard).into_iter().collect(),
            Heard::Timer(number) => return own(self.chart.transitions[*number].source),
            Heard::Always | Heard::Message(..) | Heard::Signal(_) | Heard::Notice(_) => {}
        }
        let mut found: Vec<usize> = vec![];
        for number in self.leaves().into_iter().filter_map(|leaf| self.nearest(leaf, heard)) {
            if !found.contains(&number) {
                found.push(number);
            }
        }
        // Each is decided once all that precede it are; no two precede each other.
        let before: Vec<Vec<usize>> = (0..found.len()).map(|place| self.preceding(&found, place)).collect();
        let mut is_taken: Vec<Option<bool>> = vec![None; found.len()];
        while let Some(place) = (0..found.len())
            .find(|&place| is_taken[place].is_none() && before[place].iter().all(|&other| is_taken[other].is_some()))
        {
            is_taken[place] = Some(before[place].iter().all(|&other| is_taken[other] == Some(false)));
        }
        (0..found.len()).filter(|&place| is_taken[place] == Some(true)).map(|place| found[place]).collect()
    }

    /// The found transitions that take precedence over one of them.
    fn preceding(self, found: &[usize], place: usize) -> Vec<usize> {
        let source = |place: usize| self.chart.transitions[found[place]].source;
        let own = self.left(&[found[place]]);
        let precedes = |&other: &usize| {
            let inner = self.is_inside(source(other), source(place));
            let outer = self.is_inside(source(place), source(other));
            (inner || (!outer && other < place)) && !own.is_disjoint(&self.left(&[found[other]]))
        };
        (0..found.len()).filter(|&other| other != place && precedes(&other)).collect()
    }

    /// The first enabled transition of a state, or else of the states around it.
    fn nearest(self, state: usize, heard: &Heard) -> Option<usize> {
        let outer = || self.chart.states[state].parent.and_then(|parent| self.nearest(parent, heard));
        self.enabled(state, heard).or_else(outer)
    }

    fn enabled(self, state: usize, heard: &Heard) -> Option<usize> {
        let mut all = self.chart.transitions.iter().enumerate();
        let fits = |number: usize, trigger: &Trigger| match (trigger, heard) {
            (Trigger::Always, Heard::Always) => true,
            (Trigger::Any, Heard::Message(..) | Heard::Signal(_)) => true,
            (Trigger::Complete, Heard::Complete(_)) => true,
            (Trigger::Message { port, filter: None }, Heard::Message(other, ..)) => port == other,
            (Trigger::Message { port, filter: Some(filter) }, Heard::Message(other, filters, _)) => {
                port == other && filters.contains(filter)
            }
            (Trigger::Signal(a), Heard::Signal(b)) | (Trigger::Notice(a), Heard::Notice(b)) => a == b,
            (Trigger::Done(None), Heard::Done(..)) | (Trigger::Aborted(None), Heard::Aborted(..)) => true,
            (Trigger::Done(Some(tag)), Heard::Done(_, value)) => value.tag() == Some(tag),
            (Trigger::Aborted(Some(failure)), Heard::Aborted(_, reason)) => match (failure, &reason.cause) {
                (Failure::Timeout, Cause::Failed(why)) => why.starts_with("the deadline `"),
                (Failure::Failed(text), Cause::Failed(why)) => text.as_str() == &**why,
                (failure, Cause::Reported(report)) => match (report.text(), report.bytes(), failure) {
                    (Some(text), _, Failure::Timeout) => text.starts_with("the deadline `"),
                    (Some(text), _, failure) => *failure == Failure::Failed(text.to_owned()),
                    (None, [0, number @ 1..=5], failure) => {
                        let marked =
                            [Failure::Busy, Failure::ServiceEnded, Failure::NoMatch, Failure::Crash, Failure::HostLost];
                        marked[usize::from(*number) - 1] == *failure
                    }
                    (None, _, failure) => *failure == Failure::Reported,
                },
                (Failure::StopUnconfirmed, cause) => *cause == Cause::StopUnconfirmed,
                (Failure::Busy, cause) => *cause == Cause::Busy,
                (Failure::NoMatch, cause) => *cause == Cause::NoMatch,
                (Failure::ServiceEnded, cause) => *cause == Cause::ServiceEnded,
                (_, _) => false,
            },
            (Trigger::After(_) | Trigger::Every(_), Heard::Timer(timer)) => *timer == number,
            _ => false,
        };
        let holds = |guard: &Option<Formula>| guard.as_ref().is_none_or(|guard| self.number(guard) != 0);
        all.find(|(number, one)| one.source == state && fits(*number, &one.trigger) && holds(&one.guard))
            .map(|(number, _)| number)
    }
}

fn clamp(number: i128) -> i64 {
    i64::try_from(number).unwrap_or(if number < 0 { i64::MIN } else { i64::MAX })
}
