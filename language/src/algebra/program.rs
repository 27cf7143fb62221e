//! An event-action expression as an array of nodes.
//!
//! # Representation
//! The nodes are in textual order, a node before its operands, so a subtree is a contiguous run of the array:
//!
//! ```text
//!   a ;; (b # c)      0 Recurrent ─┬─ 1 a
//!                                  └─ 2 Disable ─┬─ 3 b      end of 2 = end of 4 = 5
//!                                                └─ 4 c
//! ```
//!
//! Invariants, kept by [`Program::compile`], on which `step` rests:
//! - node 0 is the root and the only node without a parent; a parent's index is smaller than its operands';
//! - the first operand of node `i` is `i + 1`; the operand after `c` is `nodes[c].end`; the last operand's `end` is the
//!   node's own, which is how the operands of a node are walked without a list of them;
//! - `;`, `:`, `;;`, `else` and `finally` have two operands, `shield`, `using`, `as`, `with`, `=>` and `repeat` one, constants and members none, `::` at least one,
//!   its source, before the copies of its pool, `else match` its operand, before its arms, and the others any number;
//! - a chain of parents has at most [`DEPTH_MAX`] nodes.

use super::event::{Event, Value};
use super::phase::Phase;
use crate::automaton::{Automaton, Failure, Scripts};
use crate::plan::{DEPTH_MAX, Expression, Given, Group, Member, MemberKind, Notice, StateChart};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// The compiled expression of one group. It never changes; the run is kept in a `State`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Program {
    pub(super) nodes: Vec<Node>,
    /// The connection sets of all `Run` nodes, one after the other.
    pub(super) sets: Vec<u32>,
    /// The sets that are open for as long as the group runs.
    pub(super) sets_always: Vec<u32>,
    /// For each member slot, whether its normal end is a breach of its contract (L7): leaves declared `service`. A
    /// group that is a service by inference may end, namely after a fault that its own expression tolerates
    /// (`logger?`).
    pub(super) endless: Vec<bool>,
    /// For each timer, its `Wait` or `Shield` node.
    pub(super) timers: Vec<usize>,
    /// The names of the resources of all `using`, each once.
    resources: Vec<String>,
    /// The resources of all `Using` nodes, one node after the other: indices into `resources`.
    pub(super) taken: Vec<usize>,
    /// How many `Using` nodes there are.
    pub(super) usings: usize,
    /// The tags of all `Match` and `Repeat` nodes, one after the other, an arm each; none for `else`.
    pub(super) tags: Vec<Option<Arc<str>>>,
    /// The failures of all `Catch` nodes, one after the other, an arm each; none for `else`.
    pub(super) failures: Vec<Option<Failure>>,
    /// The automaton of an activity, whose node is the root.
    pub(super) chart: Option<Box<ChartProgram>>,
}

/// The automaton of an activity, with the places of its runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct ChartProgram {
    pub(super) automaton: Automaton,
    /// The states that run something, each with its node.
    runs: Vec<(usize, usize)>,
    /// The transitions with a timer, in the order of their timers; the first timer is number 0.
    pub(super) timed: Vec<usize>,
    /// The members whose ends it wants to know of: each with whether it is the normal end, and the number of the notice.
    ends: Vec<MemberEnd>,
    /// Whether the activity has no normal end.
    is_service: bool,
}

/// The end of a member that an activity wants to know of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct MemberEnd {
    member: u32,
    is_normal: bool,
    notice: usize,
}

impl ChartProgram {
    /// The notice of the end of a member, if a transition waits for it.
    pub(super) fn notice_of(&self, member: u32, is_normal: bool) -> Option<usize> {
        let is_it = |end: &&MemberEnd| end.member == member && end.is_normal == is_normal;
        self.ends.iter().find(is_it).map(|end| end.notice)
    }

    /// The node of the run of a state.
    pub(super) fn node_of(&self, state: usize) -> Option<usize> {
        self.runs.iter().find(|(of, _)| *of == state).map(|(_, node)| *node)
    }

    /// How long the timer of a transition runs.
    pub(super) fn time_of(&self, transition: usize) -> Option<Duration> {
        self.automaton.chart().transitions.get(transition)?.trigger.time()
    }

    /// The state that runs a node.
    pub(super) fn state_of(&self, node: usize) -> Option<usize> {
        self.runs.iter().find(|(_, of)| *of == node).map(|(state, _)| *state)
    }

    /// The timer of a transition.
    pub(super) fn timer_of(&self, transition: usize) -> Option<u32> {
        self.timed.iter().position(|&timed| timed == transition).map(small)
    }
}

/// One operator, constant or member.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Node {
    /// The operator that it is an operand of; none for the root.
    pub(super) parent: Option<usize>,
    /// One past the last node of its subtree.
    pub(super) end: usize,
    /// Whether no fault-free run of it ends.
    pub(super) service: bool,
    pub(super) kind: Kind,
}

/// The operator of a node, or a process, with its operands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Kind {
    Run {
        member: u32,
        /// Where its connection sets are in [`Program::sets`].
        sets: Range<usize>,
    },
    Skip,
    Never,
    Fail(Arc<str>),
    Wait {
        timer: u32,
        after: Duration,
    },
    /// `,`
    Concurrent {
        /// How many operands have to end: those that are not services, or all when every one is a service.
        tasks: u32,
    },
    /// `&`
    FailFast {
        operands: u32,
    },
    AnyOf {
        count: u32,
        operands: u32,
    },
    AtLeast {
        count: u32,
        operands: u32,
    },
    /// `#`
    Disable,
    /// `;`
    Sequence,
    /// `:`
    Conditional,
    /// `;;`
    Recurrent,
    /// `else`
    Otherwise,
    /// `match`
    Match {
        /// Where the tags of its arms are in [`Program::tags`].
        tags: Range<usize>,
    },
    /// `shield`
    Shield {
        /// How long it holds up a stop; without one, until its operand ends.
        bound: Option<Bound>,
    },
    /// `using`
    Using {
        /// The place of its resources in [`Program::taken`].
        taken: Range<usize>,
    },
    /// `::`
    Asynchronous,
    /// `finally`
    Finally,
    /// `as`
    Tagged(Arc<str>),
    /// The states of an activity.
    Chart,
    /// `with`
    With(Start),
    /// `repeat`
    Repeat {
        /// Where the tags that end it are in [`Program::tags`].
        tags: Range<usize>,
    },
    /// `else match`
    Catch {
        /// Where the failures of its arms are in [`Program::failures`].
        failures: Range<usize>,
    },
    /// `p => P`
    Named(Arc<str>),
}

/// The value that the operand of a `with` starts with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Start {
    Known(Value),
    /// The value that the node `keeper` around the `with` keeps.
    Kept {
        keeper: usize,
        /// The number of nodes between the two that also keep values.
        between: u32,
    },
}

/// How long a `shield` holds up a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Bound {
    pub(super) timer: u32,
    pub(super) after: Duration,
}

impl Program {
    /// Compiles the expression of a group of a validated plan, with the service flags of its members.
    ///
    /// # Panics
    /// If the expression is nested deeper than [`DEPTH_MAX`], names a member that the group has not, or is a chart that is
    /// not an automaton; `Plan::validate` refuses all of these.
    pub fn compile(group: &Group) -> Self {
        let endless = |member: &Member| member.service && matches!(member.kind, MemberKind::Leaf(_));
        let mut program = Self {
            nodes: Vec::new(),
            sets: Vec::new(),
            sets_always: group.sets_always.clone(),
            endless: group.members.iter().map(endless).collect(),
            timers: Vec::new(),
            resources: Vec::new(),
            taken: Vec::new(),
            usings: 0,
            tags: Vec::new(),
            failures: Vec::new(),
            chart: None,
        };
        if let Expression::Chart(chart) = &group.expression {
            program.chart = Some(Box::new(ChartProgram::new(chart, &group.members)));
            let timers = program.chart.iter().map(|chart| chart.timed.len()).sum();
            program.timers = vec![0; timers];
        }
        program.add(&group.members, &group.expression, None, 1);
        if let Some(chart) = &mut program.chart {
            let first = Some(1).filter(|&first| first < program.nodes[0].end);
            let nodes = std::iter::successors(first, |&node| Some(program.nodes[node].end));
            chart.runs.iter_mut().zip(nodes).for_each(|(run, node)| run.1 = node);
        }
        program
    }

    /// Returns the state whose timer has run out by this event; none if it is another event, or the group is not an activity.
    pub fn timed_state(&self, event: &Event) -> Option<usize> {
        let Event::Elapsed { timer, .. } = event else { return None };
        let chart = self.chart.as_deref()?;
        chart.timed.get(*timer as usize).map(|&transition| chart.automaton.chart().transitions[transition].source)
    }

    /// Returns the same program with another way to find the results of scripts. [`Self::compile`] lets each script run.
    #[must_use]
    pub fn with_scripts(mut self, scripts: Scripts) -> Self {
        if let Some(chart) = &mut self.chart {
            chart.automaton.set_scripts(scripts);
        }
        self
    }

    /// Returns whether the group is an activity with scripts.
    pub fn has_scripts(&self) -> bool {
        self.automaton().is_some_and(|automaton| !automaton.chart().scripts.is_empty())
    }

    /// Returns the automaton of an activity; none if the group is not an activity.
    pub fn automaton(&self) -> Option<&Automaton> {
        self.chart.as_ref().map(|chart| &chart.automaton)
    }

    /// Returns whether the group is a service: no fault-free run of it ends. This is the `service` of the group as a
    /// member of another.
    pub fn is_service(&self) -> bool {
        self.nodes[0].service
    }

    /// Returns whether no fault-free run of a node's subtree ends, by the node's place in textual order.
    pub fn is_service_node(&self, node: usize) -> bool {
        self.nodes.get(node).is_some_and(|node| node.service)
    }

    /// Returns how many timers there are; they are numbered from 0 in textual order.
    pub fn timers(&self) -> u32 {
        small(self.timers.len())
    }

    /// Returns the names of the resources of all `using`, in the order of their first appearance.
    pub fn resources(&self) -> &[String] {
        &self.resources
    }

    /// Adds the subtree of `expression`; the operands are added before the node's own flags can be known.
    fn add(&mut self, members: &[Member], expression: &Expression, parent: Option<usize>, depth: usize) {
        assert!(depth <= DEPTH_MAX, "a validated expression is nested at most {DEPTH_MAX} deep");
        let node = self.nodes.len();
        let kind = self.kind(expression, parent);
        self.nodes.push(Node { parent, end: node + 1, service: false, kind });
        for operand in expression.operands() {
            self.add(members, operand, Some(node), depth + 1);
        }
        self.nodes[node].end = self.nodes.len();
        self.nodes[node].service = self.infer_service(node, members);
        let tasks = self.operands(node).filter(|&operand| self.is_task(node, operand)).count();
        if let Kind::Concurrent { tasks: counted } = &mut self.nodes[node].kind {
            *counted = small(tasks);
        }
    }

    fn kind(&mut self, expression: &Expression, parent: Option<usize>) -> Kind {
        match expression {
            Expression::Run { member, sets } => {
                let start = self.sets.len();
                self.sets.extend(sets);
                Kind::Run { member: *member, sets: start..self.sets.len() }
            }
            Expression::Skip => Kind::Skip,
            Expression::Never => Kind::Never,
            Expression::Fail(why) => Kind::Fail(why.as_str().into()),
            Expression::Wait(after) => Kind::Wait { timer: self.timer(), after: *after },
            Expression::Concurrent(_) => Kind::Concurrent { tasks: 0 },
            Expression::FailFast(of) => Kind::FailFast { operands: small(of.len()) },
            Expression::AnyOf { count, of } => {
                let operands = small(of.len());
                Kind::AnyOf { count: (*count).min(operands), operands }
            }
            Expression::AtLeast { count, of } => {
                let operands = small(of.len());
                Kind::AtLeast { count: (*count).min(operands), operands }
            }
            Expression::Disable(_) => Kind::Disable,
            Expression::Sequence(..) => Kind::Sequence,
            Expression::Conditional(..) => Kind::Conditional,
            Expression::Recurrent(..) => Kind::Recurrent,
            Expression::Otherwise(..) => Kind::Otherwise,
            Expression::Match(arms) => {
                let start = self.tags.len();
                self.tags.extend(arms.iter().map(|arm| arm.tag.as_deref().map(Arc::from)));
                Kind::Match { tags: start..self.tags.len() }
            }
            Expression::Shield { bound, .. } => {
                Kind::Shield { bound: bound.map(|after| Bound { timer: self.timer(), after }) }
            }
            Expression::Using { resources, .. } => self.using(resources),
            Expression::Asynchronous { .. } => Kind::Asynchronous,
            Expression::Finally(..) => Kind::Finally,
            Expression::Tagged { tag, .. } => Kind::Tagged(tag.as_str().into()),
            Expression::Chart(_) => Kind::Chart,
            Expression::With { given, .. } => Kind::With(self.given(given, parent)),
            Expression::Named { name, .. } => Kind::Named(name.as_str().into()),
            Expression::Repeat { until, .. } => {
                let start = self.tags.len();
                self.tags.extend(until.iter().map(|tag| Some(Arc::from(tag.as_str()))));
                Kind::Repeat { tags: start..self.tags.len() }
            }
            Expression::Catch { arms, .. } => {
                let start = self.failures.len();
                self.failures.extend(arms.iter().map(|arm| arm.failure.clone()));
                Kind::Catch { failures: start..self.failures.len() }
            }
        }
    }

    /// Returns the start value of a `with` that has this parent.
    fn given(&self, given: &Given, parent: Option<usize>) -> Start {
        let name = match given {
            Given::Known { value, .. } => return Start::Known(value.clone()),
            Given::Result(name) => name,
        };
        let mut between = 0;
        for keeper in std::iter::successors(parent, |&node| self.nodes[node].parent) {
            if let Kind::Named(kept) = &self.nodes[keeper].kind {
                if **kept == **name {
                    return Start::Kept { keeper, between };
                }
                between += 1;
            }
        }
        // This is a part of an expression that is compiled alone. A valid expression names only values around it.
        Start::Known(Value::EMPTY)
    }

    /// Numbers the timer of the next node.
    fn timer(&mut self) -> u32 {
        self.timers.push(self.nodes.len());
        small(self.timers.len() - 1)
    }

    fn using(&mut self, names: &[String]) -> Kind {
        let start = self.taken.len();
        for name in names {
            let known = self.resources.iter().position(|other| other == name);
            self.taken.push(known.unwrap_or(self.resources.len()));
            if known.is_none() {
                self.resources.push(name.clone());
            }
        }
        self.usings += 1;
        Kind::Using { taken: start..self.taken.len() }
    }

    /// The service rules, upward from the members. `any k of` is a service if fewer than `k`
    /// operands are tasks. `&` is a service if one operand is a service, because it waits for all
    /// operands. `match` is a service if every arm is a service. `fail` and `wait` end by
    /// themselves.
    fn infer_service(&self, node: usize, members: &[Member]) -> bool {
        let mut services = self.operands(node).map(|operand| self.nodes[operand].service);
        match &self.nodes[node].kind {
            Kind::Run { member, .. } => members[*member as usize].service,
            Kind::Never | Kind::Recurrent | Kind::Asynchronous => true,
            Kind::Skip | Kind::Fail(_) | Kind::Wait { .. } => false,
            Kind::Concurrent { .. } => self.end(node) > node + 1 && services.all(|service| service),
            Kind::Disable | Kind::Match { .. } => services.all(|service| service),
            Kind::Sequence | Kind::Conditional | Kind::FailFast { .. } | Kind::AtLeast { .. } | Kind::Finally => {
                services.any(|service| service)
            }
            Kind::Otherwise
            | Kind::Shield { .. }
            | Kind::Using { .. }
            | Kind::Tagged(_)
            | Kind::With(_)
            | Kind::Named(_)
            | Kind::Repeat { .. }
            | Kind::Catch { .. } => self.nodes[node + 1].service,
            Kind::Chart => self.chart.as_ref().is_some_and(|chart| chart.is_service),
            Kind::AnyOf { count, .. } => services.filter(|service| !service).count() < *count as usize,
        }
    }

    /// Whether `,` waits for this operand: tasks, or every operand when all of them are services.
    pub(super) fn is_task(&self, node: usize, operand: usize) -> bool {
        self.nodes[node].service || !self.nodes[operand].service
    }

    /// Returns the resources of a `Using` node: indices of [`Self::resources`].
    pub(super) fn taken(&self, node: usize) -> &[usize] {
        if let Kind::Using { taken } = &self.nodes[node].kind { &self.taken[taken.clone()] } else { &[] }
    }

    /// Returns the phase in which the timer of a node runs.
    pub(super) fn armed_phase(&self, node: usize) -> Phase {
        if matches!(self.nodes[node].kind, Kind::Shield { .. }) { Phase::Second } else { Phase::Running }
    }

    /// Returns the operands of a node in textual order.
    pub(super) fn operands(&self, node: usize) -> impl Iterator<Item = usize> + Clone {
        let last = self.end(node);
        let first = Some(node + 1).filter(|&first| first < last);
        std::iter::successors(first, move |&operand| Some(self.end(operand)).filter(|&next| next < last))
    }

    /// Returns the first operand of a node that has one.
    pub(super) fn first(&self, node: usize) -> usize {
        node + 1
    }

    /// Returns the second operand of a node that has two.
    pub(super) fn second(&self, node: usize) -> usize {
        self.end(node + 1)
    }

    fn end(&self, node: usize) -> usize {
        self.nodes[node].end
    }
}

impl ChartProgram {
    fn new(chart: &StateChart, members: &[Member]) -> Self {
        let end = |(notice, known): (usize, &Notice)| {
            let (name, is_normal) = known.end_of()?;
            let member = members.iter().position(|member| member.name == name)?;
            Some(MemberEnd { member: small(member), is_normal, notice })
        };
        let ends = chart.notices.iter().enumerate().filter_map(end).collect();
        let automaton = Automaton::new(chart.chart.clone()).expect("the chart of a validated plan is an automaton");
        let transitions = &automaton.chart().transitions;
        let timed = (0..transitions.len()).filter(|&number| transitions[number].trigger.time().is_some()).collect();
        let runs = chart.runs.iter().map(|run| (run.state as usize, 0)).collect();
        Self { automaton, runs, timed, ends, is_service: chart.is_service() }
    }
}

fn small(count: usize) -> u32 {
    u32::try_from(count).expect("a plan has fewer than 2^32 operands")
}
