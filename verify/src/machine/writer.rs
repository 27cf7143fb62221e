//! The parts of all rules: the control that all nodes share, calls and reports.

use super::{Change, Machine, Term, Test, Var};
use crate::model::Model;
use language::plan::Expression;
use std::collections::BTreeMap;

/// The machine is at rest: no node has an action to perform. Events can happen only in this state.
pub(super) const REST: u32 = 0;
/// The node starts, with `value`.
pub(super) const START: u32 = 1;
/// The node has to stop.
pub(super) const STOP: u32 = 2;
/// The node gets a report from its operand number `operand`: its `result`, and its `value` for the next process.
pub(super) const REPORT: u32 = 3;
/// The node goes through its operands, up to number `operand`, and stops those that run.
pub(super) const HALT: u32 = 4;
/// The node decides, from the reports of its operands.
pub(super) const WEIGH: u32 = 5;
/// The group whose root is this node gives free resources to the `using` at position `operand` of the queue.
pub(super) const GRANT: u32 = 6;
/// The first order or report between groups is delivered.
pub(super) const DELIVER: u32 = 7;
/// The root of a group has reacted with `result`.
pub(super) const SETTLE: u32 = 8;

/// The results: the node runs, or how it has ended.
pub(super) const RUNS: u32 = 0;
pub(super) const DONE: u32 = 1;
pub(super) const ABORTED: u32 = 2;
pub(super) const STOPPED: u32 = 3;

/// The phase of an inactive node. The other phases are documented where they are used.
pub(super) const IDLE: u32 = 0;

/// The state of the whole: not started, running, stopping, over.
pub(super) const RUNNING: u32 = 1;
pub(super) const STOPPING: u32 = 2;
pub(super) const OVER: u32 = 3;

pub(super) type Sets = Vec<(Var, Term)>;

/// A node of an expression, with its number and its phase.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    pub(super) number: u32,
    pub(super) phase: Var,
    /// The operator around the node, and the number of the operand.
    around: Option<(u32, u32)>,
}

/// One `using` of a group.
pub(super) struct Use {
    pub(super) node: Node,
    /// The position in the queue, from 1; 0 if it does not wait.
    pub(super) place: Var,
    /// The value with which it starts when its turn comes.
    pub(super) kept: Var,
    pub(super) takes: Vec<String>,
    pub(super) inner: Node,
}

/// The variables of a group, without the variables of its nodes.
pub(super) struct GroupVars {
    /// Whether an order to stop the group is in transit.
    pub(super) is_ordered: Var,
    /// The position among the deliveries, from 1; 0 if there is none for this group.
    pub(super) place: Var,
    /// The content of the delivery: 0 for a start, otherwise the reported result.
    pub(super) result: Var,
    pub(super) value: Var,
    /// How many `using`s of the group wait.
    pub(super) waiting: Var,
    /// Set if the group is on another host than the group around it.
    pub(super) travels: Option<Travels>,
}

/// A link from one host to another: indices into `Plan::hosts`.
pub(super) type Link = (u32, u32);

/// The messages between a group and the group around it. Each variable is the position of a message on its link, from
/// 1; 0 if there is no such message.
#[derive(Clone, Copy)]
pub(super) struct Travels {
    pub(super) start: Var,
    pub(super) stop: Var,
    pub(super) report: Var,
    /// The links to the group's host, and back.
    pub(super) link: Link,
    pub(super) back: Link,
}

/// The variables of the control that all nodes share.
pub(super) struct Control {
    /// The node that has an action to carry out, the action, and the operand of the action.
    pub(super) at: Var,
    pub(super) todo: Var,
    pub(super) operand: Var,
    /// The reported result, and the value with which a node starts or that it has left.
    pub(super) result: Var,
    pub(super) value: Var,
    /// The state of the whole.
    pub(super) whole: Var,
    /// The number of deliveries between groups that are pending.
    pub(super) pending: Var,
}

/// The group that is being written.
#[derive(Default)]
pub(super) struct Current {
    pub(super) group: usize,
    /// How many timers it has so far.
    pub(super) timers: usize,
    pub(super) uses: Vec<Use>,
    /// Whether each of its resources is taken.
    pub(super) held: Vec<(String, Var)>,
    /// The names of results around the node that is being written, each with the variable of its value.
    pub(super) kept: Vec<(String, Var)>,
}

/// The shared control, and the rules written so far.
pub(super) struct Writer<'m> {
    pub(super) model: &'m Model<'m>,
    pub(super) machine: Machine,
    pub(super) control: Control,
    pub(super) groups: Vec<GroupVars>,
    /// The number of messages on each link.
    pub(super) links: BTreeMap<Link, Var>,
    pub(super) nodes: u32,
    pub(super) tags: Vec<String>,
    pub(super) current: Current,
    /// For each member that is a group, the nodes that run it.
    pub(super) runs: Vec<(u32, Node)>,
}

/// Writes all groups of a model.
pub(super) fn write(model: &Model<'_>) -> Machine {
    let mut machine = Machine::default();
    let plan = model.plan;
    let nodes: u32 = plan.groups.iter().map(|group| crate::model::count(&group.expression)).sum();
    let tags = tags(model);
    let widest = plan.groups.iter().map(|group| widest(&group.expression)).max().unwrap_or(0);
    let (at, todo) = (machine.variable("at".into(), nodes as usize), machine.variable("todo".into(), 8));
    let operand = machine.variable("operand".into(), widest.max(nodes as usize) + 1);
    let (result, value) = (machine.variable("result".into(), 3), machine.variable("value".into(), tags.len()));
    let whole = machine.variable("whole".into(), 3);
    let pending = machine.variable("pending".into(), plan.groups.len());
    let mut links = BTreeMap::new();
    let groups = (0..plan.groups.len())
        .map(|group| {
            let mut own = |what: &str, most| machine.variable(format!("g{group}_{what}"), most);
            GroupVars {
                is_ordered: own("ordered", 1),
                place: own("place", plan.groups.len()),
                result: own("result", 3),
                value: own("value", tags.len()),
                waiting: own("waiting", nodes as usize),
                travels: travels(model, group, &mut machine, &mut links),
            }
        })
        .collect();
    let control = Control { at, todo, operand, result, value, whole, pending };
    let (current, runs) = (Current::default(), Vec::new());
    let mut writer = Writer { model, machine, control, groups, links, nodes: 0, tags, current, runs };
    let roots: Vec<Node> = (0..plan.groups.len()).map(|group| writer.group(group)).collect();
    writer.between(&roots);
    writer.machine
}

/// Returns the variables for the messages of a group, if these messages take time.
fn travels(model: &Model<'_>, group: usize, machine: &mut Machine, links: &mut BTreeMap<Link, Var>) -> Option<Travels> {
    let (around, _) = model.around[group]?;
    let host = |group: usize| model.plan.groups[group].host;
    let (own, other) = (host(around as usize), host(group));
    if own == other {
        return None;
    }
    // For each group an order to start, and an order to stop or a report.
    let most = 2 * model.plan.groups.len();
    let (link, back) = ((own, other), (other, own));
    for (from, to) in [link, back] {
        links.entry((from, to)).or_insert_with(|| machine.variable(format!("link{from}_{to}"), most));
    }
    let mut own = |what: &str| machine.variable(format!("g{group}_{what}"), most);
    Some(Travels { start: own("start"), stop: own("stop"), report: own("report"), link, back })
}

/// Returns the tags that outcomes may have, if an expression distinguishes them.
fn tags(model: &Model<'_>) -> Vec<String> {
    if !model.has_tags() {
        return Vec::new();
    }
    let mut tags: Vec<String> = model.plan.leaves.iter().flat_map(|leaf| leaf.outcomes.clone()).collect();
    for group in &model.plan.groups {
        crate::model::walk(&group.expression, &mut |expression| {
            if let Expression::Tagged { tag, .. } = expression {
                tags.push(tag.clone());
            } else if let Expression::Match(arms) = expression {
                tags.extend(arms.iter().filter_map(|arm| arm.tag.clone()));
            } else if let Expression::Repeat { until, .. } = expression {
                tags.extend(until.iter().cloned());
            }
        });
    }
    tags.sort();
    tags.dedup();
    tags
}

fn widest(expression: &Expression) -> usize {
    let operands = expression.operands();
    operands.iter().map(|operand| widest(operand)).max().unwrap_or(0).max(operands.len())
}

impl Writer<'_> {
    /// Writes a silent change of a node for the action `todo`.
    pub(super) fn rule(&mut self, node: Node, todo: u32, tests: &[Test], sets: Sets) {
        let own = [Test::Is(self.control.todo, todo), Test::Is(self.control.at, node.number)];
        self.change(None, own.into_iter().chain(tests.iter().cloned()).collect(), sets);
    }

    /// Writes how a node begins: it enters phase 1, and starts an operand with its own value.
    pub(super) fn begins(&mut self, node: Node, operand: Node) {
        let sets = [vec![self.enter(node, 1)], self.start(operand, Term::Of(self.control.value))].concat();
        self.rule(node, START, &[], sets);
    }

    /// Writes an event, which can happen only while no node has an action to perform.
    pub(super) fn event(&mut self, word: String, tests: &[Test], sets: Sets) {
        let rests = [Test::Is(self.control.todo, REST), Test::Not(self.control.whole, OVER)];
        self.change(Some(word), rests.into_iter().chain(tests.iter().cloned()).collect(), sets);
    }

    /// Writes a change. If a variable is set several times, the last value applies.
    pub(super) fn change(&mut self, word: Option<String>, tests: Vec<Test>, mut sets: Sets) {
        let mut last: Sets = Vec::new();
        while let Some((var, term)) = sets.pop() {
            if last.iter().all(|(known, _)| *known != var) {
                last.push((var, term));
            }
        }
        last.reverse();
        self.machine.changes.push(Change { word, tests, sets: last });
    }

    pub(super) fn todo(&self, node: Node, todo: u32, operand: u32) -> Sets {
        let number = Term::Number;
        vec![
            (self.control.at, number(node.number)),
            (self.control.todo, number(todo)),
            (self.control.operand, number(operand)),
        ]
    }

    pub(super) fn enter(&self, node: Node, phase: u32) -> (Var, Term) {
        (node.phase, Term::Number(phase))
    }

    /// Calls a node to start with a value.
    pub(super) fn start(&self, node: Node, value: Term) -> Sets {
        let mut sets = self.todo(node, START, 0);
        sets.extend([(self.control.result, Term::Number(RUNS)), (self.control.value, value)]);
        sets
    }

    /// Calls a node to stop.
    pub(super) fn stop(&self, node: Node) -> Sets {
        let mut sets = self.todo(node, STOP, 0);
        sets.extend([(self.control.result, Term::Number(RUNS)), (self.control.value, Term::Number(0))]);
        sets
    }

    /// Reports the state of a node to the operator around it.
    pub(super) fn report(&self, node: Node, result: Term, value: Term) -> Sets {
        let mut sets = match node.around {
            Some((around, operand)) => vec![
                (self.control.at, Term::Number(around)),
                (self.control.todo, Term::Number(REPORT)),
                (self.control.operand, Term::Number(operand)),
            ],
            None => self.todo(node, SETTLE, 0),
        };
        sets.extend([(self.control.result, result), (self.control.value, value)]);
        sets
    }

    pub(super) fn reports(&self, node: Node, result: u32) -> Sets {
        self.report(node, Term::Number(result), Term::Number(0))
    }

    /// Reports the result of an operand as the result of the node itself.
    pub(super) fn passes(&self, node: Node) -> Sets {
        self.report(node, Term::Of(self.control.result), Term::Of(self.control.value))
    }

    /// Writes the rules of a node that runs as long as its operand, and ends in the same way.
    pub(super) fn passes_on(&mut self, node: Node, tests: &[Test]) {
        let with = |test: Test| tests.iter().cloned().chain([test]).collect::<Vec<_>>();
        self.rule(node, REPORT, &with(Test::Is(self.control.result, RUNS)), self.passes(node));
        let ends = [vec![self.enter(node, IDLE)], self.passes(node)].concat();
        self.rule(node, REPORT, &with(Test::Not(self.control.result, RUNS)), ends);
    }

    /// Returns a new node with phases up to this number.
    pub(super) fn node(&mut self, around: Option<(Node, u32)>, phases: usize) -> Node {
        let number = self.nodes;
        self.nodes += 1;
        let phase = self.machine.variable(format!("n{number}"), phases);
        Node { number, phase, around: around.map(|(node, operand)| (node.number, operand)) }
    }

    /// Returns a variable of a node, in addition to its phase.
    pub(super) fn own(&mut self, node: Node, what: &str, most: usize) -> Var {
        self.machine.variable(format!("n{}_{what}", node.number), most)
    }
}
