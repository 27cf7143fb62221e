//! The algorithm of SCXML (W3C, appendix D) for the charts of this test. It knows nothing of the import.

use super::chart::{Act, Condition, Kind, State, Transition};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

/// The most steps between two events from outside: a chart that makes more is not compared.
const STEPS_MAX: usize = 60;

/// An event that waits for its time.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Pending {
    at: Duration,
    event: usize,
    milliseconds: u64,
    id: usize,
}

/// A chart that runs.
pub(super) struct Interpreter<'a> {
    chart: &'a [State],
    pub(super) active: BTreeSet<usize>,
    memories: BTreeMap<usize, BTreeSet<usize>>,
    internal: VecDeque<String>,
    count: i64,
    /// The labels of all actions so far, in order.
    pub(super) log: Vec<String>,
    pub(super) now: Duration,
    pending: Vec<Pending>,
    /// The final state of the whole chart, once it was entered.
    pub(super) end: Option<usize>,
    /// Whether the import says in a remark that this chart differs here, or the order of two events is open.
    pub(super) differs: bool,
}

impl<'a> Interpreter<'a> {
    pub(super) fn start(chart: &'a [State]) -> Self {
        let mut model = Self {
            chart,
            active: BTreeSet::new(),
            memories: BTreeMap::new(),
            internal: VecDeque::new(),
            count: 0,
            log: Vec::new(),
            now: Duration::ZERO,
            pending: Vec::new(),
            end: None,
            differs: false,
        };
        model.active.insert(0);
        let mut entered = BTreeSet::new();
        model.add(&model.initial_of(0), 0, &mut entered);
        model.enter(&entered);
        model.settle();
        model
    }

    /// The active states without active states inside, or the final state of the whole chart.
    pub(super) fn leaves(&self) -> Vec<usize> {
        let is_leaf = |state: &usize| !self.active.iter().any(|inner| self.is_inside(*inner, *state));
        if let Some(end) = self.end {
            return vec![end];
        }
        self.active.iter().copied().filter(is_leaf).collect()
    }

    /// Takes an event from outside.
    pub(super) fn send(&mut self, event: &str) {
        if self.end.is_none() {
            let chosen = self.select(Some(event));
            self.microstep(&chosen);
            self.settle();
        }
    }

    /// Lets time pass.
    pub(super) fn pass(&mut self, until: Duration) {
        while let Some(next) = self.pending.iter().min_by_key(|pending| pending.at).cloned()
            && next.at <= until
        {
            self.differs |= self.pending.iter().filter(|pending| pending.at == next.at).count() > 1;
            self.pending.retain(|pending| *pending != next);
            self.now = next.at;
            self.send(&format!("t{}", next.event));
        }
        self.now = until;
    }

    /// Transitions without an event and internal events, until there are none.
    fn settle(&mut self) {
        for _ in 0..STEPS_MAX {
            if self.end.is_some() || self.differs {
                return;
            }
            let mut chosen = self.select(None);
            if chosen.is_empty() {
                let Some(event) = self.internal.pop_front() else { return };
                chosen = self.select(Some(&event));
            }
            self.microstep(&chosen);
        }
        self.differs = true;
    }

    fn select(&mut self, event: Option<&str>) -> Vec<&'a Transition> {
        let is_atomic = |state: &usize| self.children(*state).next().is_none();
        let mut found: Vec<&'a Transition> = Vec::new();
        for leaf in self.active.iter().copied().filter(is_atomic) {
            let mut around = std::iter::once(leaf).chain(self.ancestors(leaf));
            let first = around.find_map(|state| {
                self.chart[state].transitions.iter().find(|transition| self.is_enabled(transition, event))
            });
            if let Some(first) = first
                && !found.iter().any(|other| std::ptr::eq(*other, first))
            {
                found.push(first);
            }
        }
        // The import says that a parallel state around a source and its targets is not left.
        self.differs |= found.iter().any(|transition| self.has_parallel_around(transition));
        let mut kept: Vec<&'a Transition> = Vec::new();
        for transition in found {
            let exits = self.exit_set(transition);
            let conflicting: Vec<&Transition> =
                kept.iter().copied().filter(|other| !self.exit_set(other).is_disjoint(&exits)).collect();
            if conflicting.iter().all(|other| self.is_inside(transition.source, other.source)) {
                kept.retain(|other| !conflicting.iter().any(|removed| std::ptr::eq(*removed, *other)));
                kept.push(transition);
            }
        }
        kept
    }

    fn is_enabled(&self, transition: &Transition, event: Option<&str>) -> bool {
        let fits = match (event, transition.events.as_slice()) {
            (None, tokens) => tokens.is_empty(),
            (Some(event), tokens) => tokens.iter().any(|token| {
                let stem = token.strip_suffix(".*").unwrap_or(token);
                token == "*" || event == stem || event.starts_with(&format!("{stem}."))
            }),
        };
        fits && match transition.condition {
            None => true,
            Some(Condition::Below(limit)) => self.count < limit,
            Some(Condition::In(state)) => self.active.contains(&state),
            Some(Condition::NotIn(state)) => !self.active.contains(&state),
            Some(Condition::Foreign) => false,
        }
    }

    fn microstep(&mut self, chosen: &[&'a Transition]) {
        let exits: BTreeSet<usize> = chosen.iter().flat_map(|transition| self.exit_set(transition)).collect();
        let left = self.active.clone();
        for &state in exits.iter().rev() {
            for child in self.chart[state].children.clone() {
                let memory: BTreeSet<usize> = match self.chart[child].kind {
                    Kind::History { deep: true } => {
                        let is_atomic = |inner: &usize| self.children(*inner).next().is_none();
                        left.iter().copied().filter(|inner| is_atomic(inner) && self.is_inside(*inner, state)).collect()
                    }
                    Kind::History { deep: false } => {
                        left.iter().copied().filter(|inner| self.chart[*inner].parent == Some(state)).collect()
                    }
                    Kind::Atomic | Kind::Compound | Kind::Parallel | Kind::Final => continue,
                };
                self.memories.insert(child, memory);
            }
        }
        for &state in exits.iter().rev() {
            self.act(&self.chart[state].exit);
            self.active.remove(&state);
        }
        for transition in chosen {
            self.act(&transition.acts);
        }
        let mut entered = BTreeSet::new();
        for transition in chosen.iter().filter(|transition| !transition.targets.is_empty()) {
            for &target in &transition.targets {
                self.add_descendants(target, &mut entered);
            }
            let domain = self.domain(transition);
            for target in self.effective(&transition.targets) {
                self.add_ancestors(target, domain, &mut entered);
            }
        }
        // The algorithm enters states around a history a second time if they were not left.
        entered.retain(|state| !self.active.contains(state));
        self.enter(&entered);
    }

    fn enter(&mut self, entered: &BTreeSet<usize>) {
        let mut completed = None;
        for &state in entered {
            self.active.insert(state);
            // The import says that such states are entered one step later.
            self.differs |= self.begins_inside(state);
            self.act(&self.chart[state].entry);
            if self.chart[state].kind != Kind::Final {
                continue;
            }
            let Some(parent) = self.chart[state].parent.filter(|parent| *parent != 0) else {
                self.end = Some(state);
                continue;
            };
            self.internal.push_back(format!("done.state.s{parent}"));
            if let Some(around) = self.chart[parent].parent
                && self.chart[around].kind == Kind::Parallel
                && self.children(around).all(|region| self.is_complete(region))
            {
                self.internal.push_back(format!("done.state.s{around}"));
                completed = Some(self.internal.len());
            }
        }
        // The import says that the completion of a parallel state comes behind all events of its step.
        self.differs |= completed.is_some_and(|count| count != self.internal.len());
        if self.end.is_some() {
            for state in self.active.clone().into_iter().rev() {
                self.act(&self.chart[state].exit);
            }
        }
    }

    /// Whether a state in a region begins in several states, or in a state that is not directly inside it.
    fn begins_inside(&self, state: usize) -> bool {
        let is_direct = |target: &usize| self.chart[*target].parent == Some(state);
        let is_plain = self.chart[state].initial.iter().all(is_direct);
        !is_plain && self.ancestors(state).any(|around| self.chart[around].kind == Kind::Parallel)
    }

    /// Whether the innermost state around a source and its targets is parallel.
    fn has_parallel_around(&self, transition: &Transition) -> bool {
        let targets = self.effective(&transition.targets);
        let mut around = self.ancestors(transition.source);
        let first = around.find(|state| targets.iter().all(|target| self.is_inside(*target, *state)));
        let is_parallel = first.is_some_and(|state| self.chart[state].kind == Kind::Parallel);
        is_parallel && !targets.is_empty() && self.domain(transition) != transition.source
    }

    fn is_complete(&self, state: usize) -> bool {
        match self.chart[state].kind {
            Kind::Compound => {
                self.children(state).any(|inner| self.chart[inner].kind == Kind::Final && self.active.contains(&inner))
            }
            Kind::Parallel => self.children(state).all(|inner| self.is_complete(inner)),
            Kind::Atomic | Kind::Final | Kind::History { .. } => false,
        }
    }

    fn act(&mut self, acts: &[Act]) {
        for act in acts {
            match act {
                Act::Log(label) => self.log.push(label.clone()),
                Act::Raise(event) => self.internal.push_back(event.clone()),
                Act::Count => self.count += 1,
                Act::Reset => self.count = 0,
                Act::Cancel(id) => self.pending.retain(|pending| pending.id != *id),
                &Act::Send { event, milliseconds, id } => {
                    // One timer of the import holds one event of a sort.
                    self.differs |= self
                        .pending
                        .iter()
                        .any(|other| (other.event, other.milliseconds, other.id) == (event, milliseconds, id));
                    let at = self.now + Duration::from_millis(milliseconds);
                    self.pending.push(Pending { at, event, milliseconds, id });
                }
            }
        }
    }

    fn exit_set(&self, transition: &Transition) -> BTreeSet<usize> {
        if transition.targets.is_empty() {
            return BTreeSet::new();
        }
        let domain = self.domain(transition);
        self.active.iter().copied().filter(|state| self.is_inside(*state, domain)).collect()
    }

    fn domain(&self, transition: &Transition) -> usize {
        let targets = self.effective(&transition.targets);
        let source = transition.source;
        let holds = |state: usize| targets.iter().all(|target| self.is_inside(*target, state));
        if transition.is_internal && self.chart[source].kind == Kind::Compound && holds(source) {
            return source;
        }
        let is_compound = |state: &usize| *state == 0 || self.chart[*state].kind == Kind::Compound;
        self.ancestors(source).filter(is_compound).find(|state| holds(*state)).unwrap_or(0)
    }

    /// The states that targets mean, histories replaced by their memories or defaults.
    fn effective(&self, targets: &[usize]) -> Vec<usize> {
        let of = |&target: &usize| match self.chart[target].kind {
            Kind::History { .. } => match self.memories.get(&target) {
                Some(memory) => memory.iter().copied().collect(),
                None => self.chart[target].initial.clone(),
            },
            Kind::Atomic | Kind::Compound | Kind::Parallel | Kind::Final => vec![target],
        };
        targets.iter().flat_map(of).collect()
    }

    /// Adds states, and those between them and a state around them.
    fn add(&self, states: &[usize], around: usize, entered: &mut BTreeSet<usize>) {
        states.iter().for_each(|state| self.add_descendants(*state, entered));
        states.iter().for_each(|state| self.add_ancestors(*state, around, entered));
    }

    fn add_descendants(&self, state: usize, entered: &mut BTreeSet<usize>) {
        match self.chart[state].kind {
            Kind::History { .. } => {
                let parent = self.chart[state].parent.unwrap_or(0);
                self.add(&self.effective(&[state]), parent, entered);
            }
            Kind::Compound => {
                entered.insert(state);
                self.add(&self.initial_of(state), state, entered);
            }
            Kind::Parallel => {
                entered.insert(state);
                self.add_regions(state, entered);
            }
            Kind::Atomic | Kind::Final => {
                entered.insert(state);
            }
        }
    }

    fn add_ancestors(&self, state: usize, around: usize, entered: &mut BTreeSet<usize>) {
        for ancestor in self.ancestors(state).take_while(|ancestor| *ancestor != around) {
            entered.insert(ancestor);
            if self.chart[ancestor].kind == Kind::Parallel {
                self.add_regions(ancestor, entered);
            }
        }
    }

    fn add_regions(&self, state: usize, entered: &mut BTreeSet<usize>) {
        for region in self.children(state).collect::<Vec<_>>() {
            if !entered.iter().any(|inner| *inner == region || self.is_inside(*inner, region)) {
                self.add_descendants(region, entered);
            }
        }
    }

    fn initial_of(&self, state: usize) -> Vec<usize> {
        match self.chart[state].initial.as_slice() {
            [] => self.children(state).take(1).collect(),
            initial => initial.to_vec(),
        }
    }

    /// The states directly inside, without histories.
    fn children(&self, state: usize) -> impl Iterator<Item = usize> + '_ {
        let children = self.chart[state].children.iter().copied();
        children.filter(|child| !matches!(self.chart[*child].kind, Kind::History { .. }))
    }

    fn ancestors(&self, state: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(self.chart[state].parent, |state| self.chart[*state].parent)
    }

    fn is_inside(&self, state: usize, around: usize) -> bool {
        self.ancestors(state).any(|ancestor| ancestor == around)
    }
}
