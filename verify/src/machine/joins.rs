//! The rules of operators with many operands: `,` `&` `any` `at least` `#` and `::`.
//!
//! Phases: 1 the operands start, one after the other; 2 they run; 3 the operands that still run are stopped, one after the other;
//! 4 the node waits until all of them have confirmed.

use super::writer::{ABORTED, DONE, HALT, IDLE, Node, REPORT, RUNS, START, STOP, STOPPED, Sets, WEIGH, Writer};
use super::{Term, Test, Var};
use language::plan::{Expression, Group};

/// A node with its operands, and its decision.
struct Join {
    node: Node,
    operands: Vec<Node>,
    /// The decided outcome; 0 before the decision.
    held: Var,
    /// The value for the next process.
    kept: Var,
    /// The value with which every operand starts.
    given: Var,
}

/// The counters of a node that waits for the ends of some operands.
struct Count {
    /// How many ends the node waits for.
    open: Var,
    /// Whether the node will abort.
    is_bad: Var,
    /// The changes for each outcome of each operand.
    outcomes: Vec<Vec<(Vec<Test>, Sets)>>,
    at_first: Sets,
}

impl Writer<'_> {
    fn join(&mut self, node: Node, of: &[Expression]) -> Join {
        let (held, kept) = (self.own(node, "held", 3), self.own(node, "kept", self.tags.len()));
        let given = self.own(node, "given", self.tags.len());
        let operands = (0..).zip(of).map(|(operand, of)| self.write(of, Some((node, operand)))).collect();
        Join { node, operands, held, kept, given }
    }

    fn counting(&mut self, join: &Join, open: usize) -> (Var, Var, Sets) {
        let (left, is_bad) = (self.own(join.node, "open", open), self.own(join.node, "bad", 1));
        let at_first = vec![(left, Term::Number(u32::try_from(open).unwrap_or(u32::MAX))), (is_bad, Term::Number(0))];
        (left, is_bad, at_first)
    }

    /// `P , Q`: runs until every task has ended; a service that aborts ends it at once.
    pub(super) fn concurrent(&mut self, node: Node, of: &[Expression]) {
        let join = self.join(node, of);
        let services: Vec<bool> = of.iter().map(|operand| is_service(operand, self.source())).collect();
        let is_waited_for = |service: bool| !service || services.iter().all(|service| *service);
        let tasks = services.iter().filter(|service| is_waited_for(**service)).count();
        let (open, is_bad, at_first) = self.counting(&join, tasks);
        let outcomes = services.iter().map(|&service| {
            let (mut done, mut aborted) = (Vec::new(), vec![(is_bad, Term::Number(1))]);
            if is_waited_for(service) {
                done.push((open, Term::OneLess(open)));
                done.extend((tasks == 1).then_some((join.kept, Term::Of(self.control.value))));
            }
            aborted.push((open, if service { Term::Number(0) } else { Term::OneLess(open) }));
            vec![
                (vec![Test::Is(self.control.result, DONE)], done),
                (vec![Test::Is(self.control.result, ABORTED)], aborted),
            ]
        });
        let count = Count { open, is_bad, outcomes: outcomes.collect(), at_first };
        self.counts(&join, &count);
    }

    /// `P & Q`: runs until all operands are done, or one aborts.
    pub(super) fn fail_fast(&mut self, node: Node, of: &[Expression]) {
        let join = self.join(node, of);
        let (open, is_bad, at_first) = self.counting(&join, of.len());
        let mut done = vec![(open, Term::OneLess(open))];
        done.extend((of.len() == 1).then_some((join.kept, Term::Of(self.control.value))));
        let aborted = vec![(is_bad, Term::Number(1)), (open, Term::Number(0))];
        let each = vec![
            (vec![Test::Is(self.control.result, DONE)], done),
            (vec![Test::Is(self.control.result, ABORTED)], aborted),
        ];
        let count = Count { open, is_bad, outcomes: vec![each; of.len()], at_first };
        self.counts(&join, &count);
    }

    /// `any k of`: runs until k operands are done, or too many have aborted for that.
    pub(super) fn any(&mut self, node: Node, count: u32, of: &[Expression]) {
        let join = self.join(node, of);
        let (open, is_bad, mut at_first) = self.counting(&join, count as usize);
        let spares = of.len().saturating_sub(count as usize);
        let spare = self.own(node, "spare", spares);
        at_first.push((spare, Term::Number(u32::try_from(spares).unwrap_or(u32::MAX))));
        let (done, aborted) = (Test::Is(self.control.result, DONE), Test::Is(self.control.result, ABORTED));
        let mut counts = vec![(open, Term::OneLess(open))];
        counts.extend((count == 1).then_some((join.kept, Term::Of(self.control.value))));
        let fails = vec![(is_bad, Term::Number(1)), (open, Term::Number(0))];
        let is_last = Test::All(vec![Test::Is(spare, 0), Test::Not(open, 0)]);
        let each = vec![
            (vec![done.clone(), Test::Not(open, 0)], counts),
            (vec![done, Test::Is(open, 0)], Vec::new()),
            (vec![aborted.clone(), is_last.clone()], fails),
            (vec![aborted, Test::Fails(Box::new(is_last))], vec![(spare, Term::OneLess(spare))]),
        ];
        let count = Count { open, is_bad, outcomes: vec![each; of.len()], at_first };
        self.counts(&join, &count);
    }

    /// `at least k of`: runs until all operands have ended. It aborts if too few of them are done.
    pub(super) fn at_least(&mut self, node: Node, count: u32, of: &[Expression]) {
        let join = self.join(node, of);
        let (open, is_bad, mut at_first) = self.counting(&join, of.len());
        let spares = of.len().saturating_sub(count as usize);
        let spare = self.own(node, "spare", spares);
        at_first.push((spare, Term::Number(u32::try_from(spares).unwrap_or(u32::MAX))));
        let (done, aborted) = (Test::Is(self.control.result, DONE), Test::Is(self.control.result, ABORTED));
        let ended = (open, Term::OneLess(open));
        let each = vec![
            (vec![done], vec![ended]),
            (vec![aborted.clone(), Test::Is(spare, 0)], vec![(is_bad, Term::Number(1)), ended]),
            (vec![aborted, Test::Not(spare, 0)], vec![(spare, Term::OneLess(spare)), ended]),
        ];
        let count = Count { open, is_bad, outcomes: vec![each; of.len()], at_first };
        self.counts(&join, &count);
    }

    /// Starts all operands and counts each outcome. When enough have ended, the others are stopped.
    fn counts(&mut self, join: &Join, count: &Count) {
        let Join { node, operands, held, kept, given } = join;
        let (node, last) = (*node, operands.len() - 1);
        let begins = vec![self.enter(node, 1), (*given, Term::Of(self.control.value))];
        let begins = [begins, count.at_first.clone(), self.start(operands[0], Term::Of(self.control.value))].concat();
        self.rule(node, START, &[], begins);
        let weighs = [
            self.todo(node, WEIGH, 0),
            vec![(self.control.value, Term::Number(0)), (self.control.result, Term::Number(RUNS))],
        ]
        .concat();
        for (index, outcomes) in count.outcomes.iter().enumerate() {
            let own = Test::Is(self.control.operand, u32::try_from(index).unwrap_or(u32::MAX));
            let mut starting = outcomes.clone();
            starting.push((vec![Test::Is(self.control.result, RUNS)], Vec::new()));
            for (tests, sets) in starting {
                let next = operands.get(index + 1).map(|next| self.start(*next, Term::Of(*given)));
                let sets = [sets, next.unwrap_or_else(|| weighs.clone())].concat();
                self.rule(node, REPORT, &[vec![own.clone(), Test::Is(node.phase, 1)], tests].concat(), sets);
            }
            for (tests, sets) in outcomes {
                let tests = [vec![own.clone(), Test::Is(node.phase, 2)], tests.clone()].concat();
                self.rule(node, REPORT, &tests, [sets.clone(), weighs.clone()].concat());
            }
        }
        debug_assert_eq!(count.outcomes.len(), last + 1, "each operand has its outcomes");
        self.rule(node, REPORT, &[Test::Is(node.phase, 2), Test::Is(self.control.result, RUNS)], self.passes(node));
        let goes_on = [vec![self.enter(node, 2)], self.reports(node, RUNS)].concat();
        self.rule(node, WEIGH, &[Test::Not(count.open, 0)], goes_on);
        let halts = self.todo(node, HALT, 0);
        let is_over = Test::Is(count.open, 0);
        let done = [vec![self.enter(node, 3), (*held, Term::Number(DONE))], halts.clone()].concat();
        self.rule(node, WEIGH, &[is_over.clone(), Test::Is(count.is_bad, 0)], done);
        let aborted = vec![self.enter(node, 3), (*held, Term::Number(ABORTED)), (*kept, Term::Number(0))];
        self.rule(node, WEIGH, &[is_over, Test::Is(count.is_bad, 1)], [aborted, halts].concat());
        let mut cleared = count.at_first.clone();
        cleared.iter_mut().for_each(|(_, term)| *term = Term::Number(0));
        self.drains(join, &cleared);
        self.is_stopped(join);
    }

    /// `P # Q`: the first outcome decides, and the other operands are stopped; later operands do not start any more.
    pub(super) fn disable(&mut self, node: Node, of: &[Expression]) {
        let join = self.join(node, of);
        let (begins, ends) = (Test::Is(node.phase, 1), Test::Not(self.control.result, RUNS));
        let starts = [
            vec![self.enter(node, 1), (join.given, Term::Of(self.control.value))],
            self.start(join.operands[0], Term::Of(self.control.value)),
        ];
        self.rule(node, START, &[], starts.concat());
        for index in 0..join.operands.len() {
            let own = Test::Is(self.control.operand, u32::try_from(index).unwrap_or(u32::MAX));
            let sets = match join.operands.get(index + 1) {
                Some(next) => self.start(*next, Term::Of(join.given)),
                None => [vec![self.enter(node, 2)], self.reports(node, RUNS)].concat(),
            };
            self.rule(node, REPORT, &[begins.clone(), own, Test::Is(self.control.result, RUNS)], sets);
        }
        let first = vec![
            self.enter(node, 3),
            (join.held, Term::Of(self.control.result)),
            (join.kept, Term::Of(self.control.value)),
        ];
        let halts = [first, self.todo(node, HALT, 0)].concat();
        let runs = Test::Is(node.phase, 2);
        self.rule(node, REPORT, &[Test::Any(vec![begins, runs.clone()]), ends], halts);
        self.rule(node, REPORT, &[runs, Test::Is(self.control.result, RUNS)], self.passes(node));
        self.drains(&join, &[]);
        self.is_stopped(&join);
    }

    /// Stops the operands that still run. The outcome is the already decided one, once all operands have confirmed.
    fn drains(&mut self, join: &Join, cleared: &[(Var, Term)]) {
        let Join { node, operands, held, kept, given } = join;
        let (node, number) = (*node, |count: usize| u32::try_from(count).unwrap_or(u32::MAX));
        let runs = Test::Any(operands.iter().map(|operand| Test::Not(operand.phase, IDLE)).collect());
        let mut ends = vec![self.enter(node, IDLE)];
        ends.extend([*held, *kept, *given].map(|var| (var, Term::Number(0))));
        ends.extend(cleared.iter().copied());
        ends.extend(self.report(node, Term::Of(*held), Term::Of(*kept)));
        for (index, operand) in operands.iter().enumerate() {
            let own = Test::Is(self.control.operand, number(index));
            let next = vec![(self.control.operand, Term::Number(number(index + 1)))];
            self.rule(node, HALT, &[own.clone(), Test::Is(operand.phase, IDLE)], next);
            self.rule(node, HALT, &[own.clone(), Test::Not(operand.phase, IDLE)], self.stop(*operand));
            self.rule(node, REPORT, &[own, Test::Is(node.phase, 3)], self.todo(node, HALT, number(index + 1)));
        }
        let is_through = Test::Is(self.control.operand, number(operands.len()));
        let waits = [vec![self.enter(node, 4)], self.reports(node, RUNS)].concat();
        self.rule(node, HALT, &[is_through.clone(), runs.clone()], waits);
        self.rule(node, HALT, &[is_through, Test::Fails(Box::new(runs.clone()))], ends.clone());
        let drains = Test::Is(node.phase, 4);
        self.rule(node, REPORT, &[drains.clone(), runs.clone()], self.reports(node, RUNS));
        self.rule(node, REPORT, &[drains.clone(), Test::Fails(Box::new(runs))], ends);
        let killed = vec![(*held, Term::Number(STOPPED)), (*kept, Term::Number(0))];
        self.rule(node, STOP, &[drains], [killed, self.reports(node, RUNS)].concat());
    }

    /// Handles a stop while the operands run: their results are discarded.
    fn is_stopped(&mut self, join: &Join) {
        let stopped = vec![self.enter(join.node, 3), (join.held, Term::Number(STOPPED)), (join.kept, Term::Number(0))];
        self.rule(join.node, STOP, &[Test::Is(join.node.phase, 2)], [stopped, self.todo(join.node, HALT, 0)].concat());
    }

    /// `P ::[n] Q`. Phases: 1 it runs; 2 a place of the pool starts; 3 and 4 as for the other operators; 5 the source is stopped,
    /// since something has failed; 6 the pool comes to its own end. While no place is free, `owed`
    /// says that `kept` holds the result of the source.
    pub(super) fn pool(&mut self, node: Node, source: &Expression, pool: &[Expression]) {
        let operands: Vec<Expression> = std::iter::once(source).chain(pool).cloned().collect();
        let join = self.join(node, &operands);
        let owed = self.own(node, "owed", 1);
        let (first, nothing) = (join.operands[0], Term::Number(0));
        let (runs, is_source) = (Test::Is(node.phase, 1), Test::Is(self.control.operand, 0));
        let result = |result| Test::Is(self.control.result, result);
        let [is_running, is_done, has_failed] = [RUNS, DONE, ABORTED].map(result);
        let is_place = Test::Not(self.control.operand, 0);
        let spawns = self.todo(node, WEIGH, 1);
        self.begins(node, first);
        self.rule(node, REPORT, &[runs.clone(), is_running.clone()], self.passes(node));
        self.rule(node, REPORT, &[runs.clone(), is_source, is_done.clone()], spawns.clone());
        for (index, place) in (1..).zip(&join.operands[1..]) {
            let own = [runs.clone(), Test::Is(self.control.operand, index)];
            let starts = [vec![self.enter(node, 2)], self.start(*place, Term::Of(self.control.value))].concat();
            self.rule(node, WEIGH, &[&own[..], &[Test::Is(place.phase, IDLE)]].concat(), starts);
            let next = vec![(self.control.operand, Term::Number(index + 1))];
            self.rule(node, WEIGH, &[&own[..], &[Test::Not(place.phase, IDLE)]].concat(), next);
        }
        let is_full = Test::Is(self.control.operand, u32::try_from(operands.len()).unwrap_or(u32::MAX));
        let owes = [vec![(owed, Term::Number(1)), (join.kept, Term::Of(self.control.value))], self.reports(node, RUNS)]
            .concat();
        self.rule(node, WEIGH, &[runs.clone(), is_full], owes);
        let again = [vec![self.enter(node, 1)], self.start(first, nothing)].concat();
        let begins = Test::Is(node.phase, 2);
        self.rule(node, REPORT, &[begins.clone(), Test::Fails(Box::new(has_failed.clone()))], again);
        let has_place = [runs.clone(), is_place, is_done];
        self.rule(node, REPORT, &[&has_place[..], &[Test::Is(owed, 0)]].concat(), self.reports(node, RUNS));
        let given = vec![(owed, nothing), (join.kept, nothing), (self.control.value, Term::Of(join.kept))];
        self.rule(node, REPORT, &[&has_place[..], &[Test::Is(owed, 1)]].concat(), [spawns, given].concat());
        self.pool_fails(&join, owed, &[Test::Any(vec![runs, begins]), has_failed]);
        self.drains(&join, &[(owed, nothing)]);
        let stopped =
            vec![self.enter(node, 3), (join.held, Term::Number(STOPPED)), (join.kept, nothing), (owed, nothing)];
        let is_active = Test::Any(vec![Test::Is(node.phase, 1), Test::Is(node.phase, 6)]);
        self.rule(node, STOP, &[is_active], [stopped, self.todo(node, HALT, 0)].concat());
    }

    fn pool_fails(&mut self, join: &Join, owed: Var, tests: &[Test]) {
        let Join { node, operands, held, kept, .. } = join;
        let (node, first) = (*node, operands[0]);
        let failed = vec![(*held, Term::Number(ABORTED)), (*kept, Term::Number(0)), (owed, Term::Number(0))];
        let weighs = self.todo(node, WEIGH, 0);
        let stops = [failed.clone(), vec![self.enter(node, 5)], self.stop(first)].concat();
        self.rule(node, REPORT, &[tests, &[Test::Not(first.phase, IDLE)]].concat(), stops);
        let ends = [failed, vec![self.enter(node, 6)], weighs.clone()].concat();
        self.rule(node, REPORT, &[tests, &[Test::Is(first.phase, IDLE)]].concat(), ends);
        let is_ending = Test::Any(vec![Test::Is(node.phase, 5), Test::Is(node.phase, 6)]);
        self.rule(node, REPORT, &[is_ending], [vec![self.enter(node, 6)], weighs].concat());
        let runs = Test::Any(operands.iter().map(|operand| Test::Not(operand.phase, IDLE)).collect());
        let winds_down = Test::Is(node.phase, 6);
        self.rule(node, WEIGH, &[winds_down.clone(), runs.clone()], self.reports(node, RUNS));
        let over = [vec![self.enter(node, IDLE), (*held, Term::Number(0))], self.reports(node, ABORTED)].concat();
        self.rule(node, WEIGH, &[winds_down, Test::Fails(Box::new(runs))], over);
    }
}

/// Returns whether an expression never ends without a fault.
fn is_service(expression: &Expression, group: &Group) -> bool {
    let is = |operand: &Expression| is_service(operand, group);
    match expression {
        Expression::Run { member, .. } => group.members[*member as usize].service,
        Expression::Never | Expression::Recurrent(..) | Expression::Asynchronous { .. } => true,
        Expression::Skip | Expression::Fail(_) | Expression::Wait(_) => false,
        Expression::Concurrent(of) | Expression::Disable(of) => of.iter().all(is),
        Expression::FailFast(of) | Expression::AtLeast { of, .. } => of.iter().any(is),
        Expression::AnyOf { count, of } => of.iter().filter(|operand| !is(operand)).count() < *count as usize,
        Expression::Sequence(p, q) | Expression::Conditional(p, q) | Expression::Finally(p, q) => is(p) || is(q),
        Expression::Otherwise(p, _) => is(p),
        Expression::Catch { of, .. } => is(of),
        Expression::Chart(chart) => chart.is_service(),
        Expression::Match(arms) => arms.iter().all(|arm| is(&arm.body)),
        Expression::Shield { of, .. }
        | Expression::Using { of, .. }
        | Expression::Tagged { of, .. }
        | Expression::With { of, .. }
        | Expression::Named { of, .. }
        | Expression::Repeat { of, .. } => is(of),
    }
}
