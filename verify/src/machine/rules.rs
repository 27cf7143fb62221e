//! The rules of the manual, one function for each operator with at most two operands. Operators with more operands are
//! in `joins`.

use super::writer::{ABORTED, DONE, IDLE, Node, REPORT, RUNS, START, STOP, STOPPED, Writer};
use super::{Term, Test};
use crate::story::seconds;
use language::plan::{Expression, Given, Group, MemberKind};

/// How the second of two operands follows the first one.
struct Turn {
    /// The outcome of the first operand after which the second one follows.
    after: u32,
    /// The value with which the second operand starts.
    given: Term,
    /// Whether the first follows again.
    is_loop: bool,
}

impl Writer<'_> {
    pub(super) fn write(&mut self, expression: &Expression, around: Option<(Node, u32)>) -> Node {
        let node = self.node(around, 6);
        let (nothing, left) = (Term::Number(0), Term::Of(self.control.value));
        match expression {
            Expression::Run { member, .. } => self.run(node, *member),
            Expression::Skip => self.rule(node, START, &[], self.reports(node, DONE)),
            Expression::Fail(_) => self.rule(node, START, &[], self.reports(node, ABORTED)),
            // Plans with activities or `else match` were already refused.
            Expression::Never | Expression::Chart(_) | Expression::Catch { .. } => self.lasting(node),
            Expression::Wait(after) => {
                let word = self.timer(seconds(*after));
                self.lasting(node);
                let ends = [vec![self.enter(node, IDLE)], self.reports(node, DONE)].concat();
                self.event(word, &[Test::Is(node.phase, 1)], ends);
            }
            Expression::Sequence(p, q) => {
                self.in_turn(node, [p, q], Turn { after: DONE, given: nothing, is_loop: false });
            }
            Expression::Conditional(p, q) => {
                self.in_turn(node, [p, q], Turn { after: DONE, given: left, is_loop: false });
            }
            Expression::Recurrent(p, q) => self.in_turn(node, [p, q], Turn { after: DONE, given: left, is_loop: true }),
            Expression::Otherwise(p, q) => {
                self.in_turn(node, [p, q], Turn { after: ABORTED, given: nothing, is_loop: false });
            }
            Expression::Finally(p, q) => self.finally(node, [p, q]),
            Expression::Match(_) => self.matching(node, expression),
            Expression::Shield { bound, of } => {
                let word = bound.map(|after| self.timer(seconds(after)));
                self.shield(node, word, of);
            }
            Expression::Using { resources, of } => self.using(node, resources, of),
            Expression::Tagged { tag, of } => self.tagged(node, tag, of),
            Expression::With { given, of } => self.given(node, given, of),
            Expression::Named { name, of } => self.named(node, name, of),
            Expression::Repeat { until, of } => self.repeat(node, until, of),
            Expression::Concurrent(of) => self.concurrent(node, of),
            Expression::FailFast(of) => self.fail_fast(node, of),
            Expression::AnyOf { count, of } => self.any(node, *count, of),
            Expression::AtLeast { count, of } => self.at_least(node, *count, of),
            Expression::Disable(of) => self.disable(node, of),
            Expression::Asynchronous { source, pool } => self.pool(node, source, pool),
        }
        node
    }

    /// Returns the word for the next timer of the group.
    fn timer(&mut self, time: String) -> String {
        self.current.timers += 1;
        let group = self.model.group_name(u32::try_from(self.current.group).unwrap_or(u32::MAX));
        format!("elapsed({group}, {time}, {})", self.current.timers - 1)
    }

    /// An operand that runs until it is stopped, and confirms the stop at once.
    fn lasting(&mut self, node: Node) {
        let starts = [vec![self.enter(node, 1)], self.reports(node, RUNS)].concat();
        self.rule(node, START, &[], starts);
        let stops = [vec![self.enter(node, IDLE)], self.reports(node, STOPPED)].concat();
        self.rule(node, STOP, &[], stops);
    }

    /// A process. Phases: 1 it runs; 2 it was asked to stop.
    fn run(&mut self, node: Node, member: u32) {
        let group = u32::try_from(self.current.group).unwrap_or(u32::MAX);
        let source: &Group = &self.model.plan.groups[self.current.group];
        let (name, slot) = (self.model.name(group, member), &source.members[member as usize]);
        let mut starts = [vec![self.enter(node, 1)], self.reports(node, RUNS)].concat();
        let mut stops = [vec![self.enter(node, 2)], self.reports(node, RUNS)].concat();
        let mut stoppable = vec![Test::Is(node.phase, 1)];
        match slot.kind {
            MemberKind::Leaf(leaf) => {
                let ends = |this: &Self, result, tag| {
                    let report = this.report(node, Term::Number(result), Term::Number(tag));
                    [vec![this.enter(node, IDLE)], report].concat()
                };
                let runs = [Test::Is(node.phase, 1)];
                let outcomes =
                    if self.tags.is_empty() { &[][..] } else { &self.model.plan.leaves[leaf as usize].outcomes };
                if !slot.service && outcomes.is_empty() {
                    self.event(format!("done({name})"), &runs, ends(self, DONE, 0));
                }
                for tag in outcomes.iter().filter(|_| !slot.service) {
                    let sets = ends(self, DONE, self.tag(tag));
                    self.event(format!("done({name}, {tag})"), &runs, sets);
                }
                self.event(format!("aborted({name})"), &runs, ends(self, ABORTED, 0));
                self.event(format!("stopped({name})"), &[Test::Is(node.phase, 2)], ends(self, STOPPED, 0));
            }
            MemberKind::Group(inner) => {
                self.runs.push((inner, node));
                starts.extend(self.orders(inner, Term::Of(self.control.value)));
                if let Some(travels) = self.groups[inner as usize].travels {
                    // If the group has already ended, an order to stop has no effect.
                    let ended = [Test::Is(node.phase, 1), Test::Not(travels.report, 0)];
                    self.rule(node, STOP, &ended, stops.clone());
                    stoppable.push(Test::Is(travels.report, 0));
                    stops.extend(self.sends(travels.stop, travels.link));
                }
                stops.push((self.groups[inner as usize].is_ordered, Term::Number(1)));
            }
        }
        self.rule(node, START, &[], starts);
        self.rule(node, STOP, &stoppable, stops);
        self.rule(node, STOP, &[Test::Is(node.phase, 2)], self.reports(node, RUNS));
    }

    /// Returns the number of a tag; values without a tag have the number 0.
    pub(super) fn tag(&self, tag: &str) -> u32 {
        let index = self.tags.iter().position(|known| known == tag);
        index.and_then(|index| u32::try_from(index + 1).ok()).unwrap_or(0)
    }

    /// `;` `:` `;;` and `else`. Phases: 1 the first operand runs; 2 the second operand runs; 3 the running operand was
    /// stopped, and the other one does not run any more.
    fn in_turn(&mut self, node: Node, [p, q]: [&Expression; 2], Turn { after, given, is_loop }: Turn) {
        let (first, second) = (self.write(p, Some((node, 0))), self.write(q, Some((node, 1))));
        let nothing = Term::Number(0);
        self.begins(node, first);
        let is_first = Test::Is(node.phase, 1);
        let next = [vec![self.enter(node, 2)], self.start(second, given)].concat();
        self.rule(node, REPORT, &[is_first.clone(), Test::Is(self.control.result, after)], next);
        self.passes_on(node, &[is_first, Test::Not(self.control.result, after)]);
        let is_second = Test::Is(node.phase, 2);
        if is_loop {
            let again = [vec![self.enter(node, 1)], self.start(first, nothing)].concat();
            self.rule(node, REPORT, &[is_second.clone(), Test::Is(self.control.result, DONE)], again);
            self.passes_on(node, &[is_second, Test::Not(self.control.result, DONE)]);
        } else {
            self.passes_on(node, &[is_second]);
        }
        self.passes_on(node, &[Test::Is(node.phase, 3)]);
        for (phase, operand) in [(1, first), (2, second)] {
            let stops = [vec![self.enter(node, 3)], self.stop(operand)].concat();
            self.rule(node, STOP, &[Test::Is(node.phase, phase)], stops);
        }
        self.rule(node, STOP, &[Test::Is(node.phase, 3)], self.reports(node, RUNS));
    }

    /// Phases: 1 `P` runs; 2 `Q` runs.
    fn finally(&mut self, node: Node, [p, q]: [&Expression; 2]) {
        let (first, second) = (self.write(p, Some((node, 0))), self.write(q, Some((node, 1))));
        let (held, kept) = (self.own(node, "held", 3), self.own(node, "kept", self.tags.len()));
        let cleared = [self.enter(node, IDLE), (held, Term::Number(0)), (kept, Term::Number(0))];
        let (is_first, is_second) = (Test::Is(node.phase, 1), Test::Is(node.phase, 2));
        self.begins(node, first);
        self.rule(node, REPORT, &[is_first.clone(), Test::Is(self.control.result, RUNS)], self.passes(node));
        let outcome =
            vec![self.enter(node, 2), (held, Term::Of(self.control.result)), (kept, Term::Of(self.control.value))];
        let next = [outcome, self.start(second, Term::Number(0))].concat();
        self.rule(node, REPORT, &[is_first.clone(), Test::Not(self.control.result, RUNS)], next);
        self.rule(node, REPORT, &[is_second.clone(), Test::Is(self.control.result, RUNS)], self.passes(node));
        // If `P` was done, a failure of `Q` is the result.
        let fails = Test::All(vec![Test::Is(self.control.result, ABORTED), Test::Is(held, DONE)]);
        let aborts = [cleared.to_vec(), self.reports(node, ABORTED)].concat();
        self.rule(node, REPORT, &[is_second.clone(), fails.clone()], aborts);
        let ends = [cleared.to_vec(), self.report(node, Term::Of(held), Term::Of(kept))].concat();
        let ended = [is_second.clone(), Test::Not(self.control.result, RUNS), Test::Fails(Box::new(fails))];
        self.rule(node, REPORT, &ended, ends);
        self.rule(node, STOP, &[is_first], self.stop(first));
        let waits = [vec![(held, Term::Number(STOPPED)), (kept, Term::Number(0))], self.reports(node, RUNS)].concat();
        self.rule(node, STOP, &[is_second], waits);
    }

    /// Phases: the number of the running arm, from 1.
    fn matching(&mut self, node: Node, expression: &Expression) {
        let Expression::Match(arms) = expression else { return };
        self.machine.variables[node.phase.0].most = u32::try_from(arms.len()).unwrap_or(u32::MAX);
        let mut others: Vec<Test> = Vec::new();
        for (operand, arm) in (0..).zip(arms) {
            let body = self.write(&arm.body, Some((node, operand)));
            let mut tests = others.clone();
            let mut given = Term::Of(self.control.value);
            if let Some(tag) = &arm.tag {
                tests.push(Test::Is(self.control.value, self.tag(tag)));
                others.push(Test::Not(self.control.value, self.tag(tag)));
                given = Term::Number(0);
            } else {
                others.push(Test::Any(Vec::new()));
            }
            self.rule(node, START, &tests, [vec![self.enter(node, operand + 1)], self.start(body, given)].concat());
            self.rule(node, STOP, &[Test::Is(node.phase, operand + 1)], self.stop(body));
        }
        self.rule(node, START, &others, self.reports(node, ABORTED));
        self.passes_on(node, &[]);
    }

    /// Phases: 1 the operand runs; 2 a stop waits for it; 3 the stop has waited long enough.
    fn shield(&mut self, node: Node, timer: Option<String>, of: &Expression) {
        let inner = self.write(of, Some((node, 0)));
        let is_asked = Test::Not(node.phase, 1);
        self.begins(node, inner);
        self.passes_on(node, &[Test::Is(node.phase, 1)]);
        self.rule(node, REPORT, &[is_asked.clone(), Test::Is(self.control.result, RUNS)], self.passes(node));
        let ends = [vec![self.enter(node, IDLE)], self.reports(node, STOPPED)].concat();
        self.rule(node, REPORT, &[is_asked.clone(), Test::Not(self.control.result, RUNS)], ends);
        let waits = [vec![self.enter(node, 2)], self.reports(node, RUNS)].concat();
        self.rule(node, STOP, &[Test::Is(node.phase, 1)], waits);
        self.rule(node, STOP, &[is_asked], self.reports(node, RUNS));
        if let Some(word) = timer {
            self.event(word, &[Test::Is(node.phase, 2)], [vec![self.enter(node, 3)], self.stop(inner)].concat());
        }
    }

    /// Phases: 1 the operand runs; 2 it was stopped.
    fn repeat(&mut self, node: Node, until: &[String], of: &Expression) {
        let inner = self.write(of, Some((node, 0)));
        let (runs, is_stopped) = (Test::Is(node.phase, 1), Test::Is(node.phase, 2));
        let is_end = Test::Any(until.iter().map(|tag| Test::Is(self.control.value, self.tag(tag))).collect());
        let goes_on = Test::All(vec![Test::Is(self.control.result, DONE), Test::Fails(Box::new(is_end))]);
        self.begins(node, inner);
        self.rule(node, REPORT, &[runs.clone(), goes_on.clone()], self.start(inner, Term::Number(0)));
        self.passes_on(node, &[runs.clone(), Test::Fails(Box::new(goes_on))]);
        self.passes_on(node, std::slice::from_ref(&is_stopped));
        self.rule(node, STOP, &[runs], [vec![self.enter(node, 2)], self.stop(inner)].concat());
        self.rule(node, STOP, &[is_stopped], self.reports(node, RUNS));
    }

    /// Here a value has a tag only if it begins with the bytes of a tag.
    fn given(&mut self, node: Node, given: &Given, of: &Expression) {
        let inner = self.write(of, Some((node, 0)));
        let value = match given {
            Given::Known { value, .. } => Term::Number(value.tag().map_or(0, |tag| self.tag(tag))),
            Given::Result(name) => {
                let kept = self.current.kept.iter().find(|(known, _)| known == name);
                kept.map_or(Term::Number(0), |(_, kept)| Term::Of(*kept))
            }
        };
        self.rule(node, START, &[], [vec![self.enter(node, 1)], self.start(inner, value)].concat());
        self.passes_on(node, &[]);
        self.rule(node, STOP, &[], self.stop(inner));
    }

    fn named(&mut self, node: Node, name: &str, of: &Expression) {
        let kept = self.own(node, "kept", self.tags.len());
        self.current.kept.push((name.to_owned(), kept));
        let inner = self.write(of, Some((node, 0)));
        self.current.kept.pop();
        let keeps = vec![self.enter(node, 1), (kept, Term::Of(self.control.value))];
        self.rule(node, START, &[], [keeps, self.start(inner, Term::Number(0))].concat());
        self.rule(node, REPORT, &[Test::Is(self.control.result, RUNS)], self.passes(node));
        let ends = [vec![self.enter(node, IDLE), (kept, Term::Number(0))], self.passes(node)].concat();
        self.rule(node, REPORT, &[Test::Not(self.control.result, RUNS)], ends);
        self.rule(node, STOP, &[], self.stop(inner));
    }

    fn tagged(&mut self, node: Node, tag: &str, of: &Expression) {
        let inner = self.write(of, Some((node, 0)));
        self.begins(node, inner);
        let named = self.report(node, Term::Number(DONE), Term::Number(self.tag(tag)));
        self.rule(node, REPORT, &[Test::Is(self.control.result, DONE)], [vec![self.enter(node, IDLE)], named].concat());
        self.passes_on(node, &[Test::Not(self.control.result, DONE)]);
        self.rule(node, STOP, &[], self.stop(inner));
    }
}
