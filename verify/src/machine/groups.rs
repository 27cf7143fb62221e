//! The rules of a group: `using`, and the messages between groups.

use super::writer::{
    ABORTED, Current, DELIVER, DONE, GRANT, GroupVars, IDLE, Link, Node, OVER, REPORT, REST, RUNNING, RUNS, SETTLE,
    START, STOP, STOPPED, STOPPING, Sets, Use, Writer,
};
use super::{Term, Test, Var};
use language::plan::{Expression, Group};

impl Writer<'_> {
    /// Returns the group of the plan that is being written.
    pub(super) fn source(&self) -> &Group {
        &self.model.plan.groups[self.current.group]
    }

    pub(super) fn group(&mut self, group: usize) -> Node {
        self.current = Current { group, ..Current::default() };
        let model = self.model;
        let root = self.write(&model.plan.groups[group].expression, None);
        for index in 0..self.current.uses.len() {
            self.takes_turns(root, index);
        }
        let waiting = self.groups[group].waiting;
        self.rule(root, SETTLE, &[Test::Is(self.control.result, RUNS)], self.todo(root, GRANT, 1));
        let delivers = self.todo(root, DELIVER, 0);
        self.rule(root, GRANT, &[Test::Less(waiting, self.control.operand)], delivers.clone());
        let ends = Test::Not(self.control.result, RUNS);
        let mut over = delivers;
        if group == 0 {
            over.push((self.control.whole, Term::Number(OVER)));
            self.rule(root, SETTLE, &[ends], over);
            return root;
        }
        // An order to stop has no target any more.
        over.push((self.groups[group].is_ordered, Term::Number(0)));
        match self.groups[group].travels {
            None => {
                over.extend(self.deliver(group, Term::Of(self.control.result), Term::Of(self.control.value)));
                self.rule(root, SETTLE, &[ends], over);
            }
            Some(travels) => {
                over.extend(self.sends(travels.report, travels.back));
                over.extend(self.says(group, Term::Of(self.control.result), Term::Of(self.control.value)));
                let too_late = [over.clone(), self.takes(travels.stop, travels.link)].concat();
                self.rule(root, SETTLE, &[ends.clone(), Test::Not(travels.stop, 0)], too_late);
                self.rule(root, SETTLE, &[ends, Test::Is(travels.stop, 0)], over);
            }
        }
        root
    }

    /// `using`. Phases: 1 it waits; 2 it has its resources. The other rules are written once every `using` of the
    /// group is known.
    pub(super) fn using(&mut self, node: Node, resources: &[String], of: &Expression) {
        let number = self.current.uses.len();
        let place = self.own(node, "place", self.nodes as usize + number + 1);
        let kept = self.own(node, "kept", self.tags.len());
        for resource in resources {
            if self.current.held.iter().all(|(name, _)| name != resource) {
                let held = self.machine.variable(format!("g{}_held{}", self.current.group, self.current.held.len()), 1);
                self.current.held.push((resource.clone(), held));
            }
        }
        let inner = self.write(of, Some((node, 0)));
        self.current.uses.push(Use { node, place, kept, takes: resources.to_vec(), inner });
    }

    /// Writes the rules of the root: a `using` starts at once, waits, gets its turn, and releases its resources.
    fn takes_turns(&mut self, root: Node, index: usize) {
        let Use { node, place, kept, inner, ref takes } = self.current.uses[index];
        let waiting = self.groups[self.current.group].waiting;
        let taken = self.current.held.iter().filter(|(name, _)| takes.contains(name)).map(|(_, held)| *held);
        let taken: Vec<_> = taken.collect();
        let others = self.current.uses.iter().filter(|other| other.node.number != node.number);
        let places: Vec<_> = others.clone().map(|other| other.place).collect();
        let rivals = others.filter(|other| other.takes.iter().any(|name| takes.contains(name)));
        let rivals: Vec<_> = rivals.map(|rival| rival.place).collect();
        let free: Vec<Test> = taken.iter().map(|held| Test::Is(*held, 0)).collect();
        let takes: Sets = taken.iter().map(|held| (*held, Term::Number(1))).collect();
        let frees: Sets = taken.iter().map(|held| (*held, Term::Number(0))).collect();
        let mut leaves: Sets = places.iter().map(|other| (*other, Term::MovesUp(*other, place))).collect();
        leaves.extend([(place, Term::Number(0)), (kept, Term::Number(0)), (waiting, Term::OneLess(waiting))]);

        let unwanted = rivals.iter().map(|rival| Test::Is(*rival, 0));
        let at_once = Test::All(free.iter().cloned().chain(unwanted).collect());
        let begins = vec![self.enter(node, 2)];
        let starts = [begins.clone(), takes.clone(), self.start(inner, Term::Of(self.control.value))].concat();
        self.rule(node, START, std::slice::from_ref(&at_once), starts);
        let waits = vec![self.enter(node, 1), (place, Term::OneMore(waiting)), (waiting, Term::OneMore(waiting))];
        let waits = [waits, vec![(kept, Term::Of(self.control.value))], self.reports(node, RUNS)].concat();
        self.rule(node, START, &[Test::Fails(Box::new(at_once))], waits);

        let later = |rival: &Var| Test::Any(vec![Test::Is(*rival, 0), Test::Less(place, *rival)]);
        let is_first = Test::All(free.into_iter().chain(rivals.iter().map(later)).collect());
        let turn = Test::Same(place, self.control.operand);
        let granted = [begins, takes, leaves.clone(), self.start(inner, Term::Of(kept))].concat();
        self.rule(root, GRANT, &[turn.clone(), is_first.clone()], granted);
        let next = vec![(self.control.operand, Term::OneMore(self.control.operand))];
        self.rule(root, GRANT, &[turn, Test::Fails(Box::new(is_first))], next);

        self.rule(node, REPORT, &[Test::Is(self.control.result, RUNS)], self.passes(node));
        let ends = [vec![self.enter(node, IDLE)], frees, self.passes(node)].concat();
        self.rule(node, REPORT, &[Test::Not(self.control.result, RUNS)], ends);
        let gives_up = [leaves, vec![self.enter(node, IDLE)], self.reports(node, STOPPED)].concat();
        self.rule(node, STOP, &[Test::Is(node.phase, 1)], gives_up);
        self.rule(node, STOP, &[Test::Is(node.phase, 2)], self.stop(inner));
    }

    /// Registers a delivery for a group: that it starts, or its result for the group around it.
    fn deliver(&self, group: usize, result: Term, value: Term) -> Sets {
        let place = self.groups[group].place;
        let place = vec![
            (place, Term::OneMore(self.control.pending)),
            (self.control.pending, Term::OneMore(self.control.pending)),
        ];
        [place, self.says(group, result, value)].concat()
    }

    /// Returns the effect of a result, which is delivered at once or is in transit.
    fn says(&self, group: usize, result: Term, value: Term) -> Sets {
        let own = &self.groups[group];
        vec![(own.result, result), (own.value, value)]
    }

    /// Orders the start of a group: at once, or when the order reaches its host.
    pub(super) fn orders(&self, group: u32, value: Term) -> Sets {
        let group = group as usize;
        match self.groups[group].travels {
            None => self.deliver(group, Term::Number(RUNS), value),
            Some(travels) => {
                [self.sends(travels.start, travels.link), self.says(group, Term::Number(RUNS), value)].concat()
            }
        }
    }

    /// Puts a message at the end of its link.
    pub(super) fn sends(&self, place: Var, link: Link) -> Sets {
        let count = self.links[&link];
        vec![(place, Term::OneMore(count)), (count, Term::OneMore(count))]
    }

    /// Removes a message from its link; those behind it move up.
    fn takes(&self, place: Var, link: Link) -> Sets {
        let all = self.groups.iter().filter_map(|group| group.travels).flat_map(|travels| {
            [(travels.start, travels.link), (travels.stop, travels.link), (travels.report, travels.back)]
        });
        let others = all.filter(|(other, of)| *of == link && *other != place).map(|(other, _)| other);
        let mut sets: Sets = others.map(|other| (other, Term::MovesUp(other, place))).collect();
        sets.extend([(place, Term::Number(0)), (self.links[&link], Term::OneLess(self.links[&link]))]);
        sets
    }

    /// Writes the rules between groups: the start and the stop of the whole, and all messages.
    pub(super) fn between(&mut self, roots: &[Node]) {
        let starts =
            [vec![(self.control.whole, Term::Number(RUNNING))], self.start(roots[0], Term::Number(0))].concat();
        self.event("start".to_owned(), &[Test::Is(self.control.whole, 0)], starts);
        let stops = [vec![(self.control.whole, Term::Number(STOPPING))], self.stop(roots[0])].concat();
        self.event("stop".to_owned(), &[Test::Is(self.control.whole, RUNNING)], stops);
        let delivers = Test::Is(self.control.todo, DELIVER);
        let control =
            [self.control.at, self.control.todo, self.control.operand, self.control.result, self.control.value];
        let rests = control.map(|var| (var, Term::Number(REST))).to_vec();
        self.change(None, vec![delivers.clone(), Test::Is(self.control.pending, 0)], rests);
        for (group, &root) in (0_u32..).zip(roots).skip(1) {
            let (result, value) = (self.groups[group as usize].result, self.groups[group as usize].value);
            let forgets = [result, value].map(|var| (var, Term::Number(0))).to_vec();
            match self.groups[group as usize].travels {
                None => {
                    let place = self.groups[group as usize].place;
                    let others = self.groups.iter().map(|other| other.place).filter(|other| *other != place);
                    let mut takes: Sets = others.map(|other| (other, Term::MovesUp(other, place))).collect();
                    takes.extend([
                        (self.control.pending, Term::OneLess(self.control.pending)),
                        (place, Term::Number(0)),
                    ]);
                    takes.extend(forgets);
                    let first = vec![delivers.clone(), Test::Is(place, 1)];
                    let starts = [takes.clone(), self.start(root, Term::Of(value))].concat();
                    self.change(None, [&first[..], &[Test::Is(result, RUNS)]].concat(), starts);
                    for (tests, hears) in self.hears(group) {
                        self.change(None, [first.clone(), tests].concat(), [takes.clone(), hears].concat());
                    }
                }
                Some(travels) => {
                    let name = self.model.around[group as usize].map(|(around, slot)| self.model.name(around, slot));
                    let name = name.unwrap_or_default();
                    let takes = [self.takes(travels.start, travels.link), forgets.clone()].concat();
                    let starts = [takes, self.start(root, Term::Of(value))].concat();
                    self.event(format!("arrived({name})"), &[Test::Is(travels.start, 1)], starts);
                    let takes = [self.takes(travels.report, travels.back), forgets].concat();
                    for (mut tests, hears) in self.hears(group) {
                        tests.push(Test::Is(travels.report, 1));
                        self.event(format!("heard({name})"), &tests, [takes.clone(), hears].concat());
                    }
                }
            }
            self.reached(group, root);
        }
    }

    /// Returns the reaction of each node that runs a group to the result of that group.
    fn hears(&self, group: u32) -> Vec<(Vec<Test>, Sets)> {
        let (result, value) = (self.groups[group as usize].result, self.groups[group as usize].value);
        let runs = self.runs.iter().filter(|(inner, _)| *inner == group).map(|(_, node)| *node);
        let mut all = Vec::new();
        for node in runs {
            // A group that stops without an order to stop has failed.
            let own = [(1, DONE, DONE), (1, ABORTED, ABORTED), (1, STOPPED, ABORTED)];
            let asked = [DONE, ABORTED, STOPPED].map(|came| (2, came, STOPPED));
            for (phase, came, counts) in own.into_iter().chain(asked) {
                let given = if counts == DONE { Term::Of(value) } else { Term::Number(0) };
                let hears = [vec![self.enter(node, IDLE)], self.report(node, Term::Number(counts), given)].concat();
                all.push((vec![Test::Is(result, came), Test::Is(node.phase, phase)], hears));
            }
        }
        all
    }

    /// Writes the rule for the arrival of the order to stop a group.
    fn reached(&mut self, group: u32, root: Node) {
        let GroupVars { is_ordered, travels, .. } = self.groups[group as usize];
        let word = format!("reached({})", self.model.group_name(group));
        let mut tests = vec![Test::Is(is_ordered, 1)];
        let mut arrives = vec![(is_ordered, Term::Number(0))];
        if let Some(travels) = travels {
            tests.push(Test::Is(travels.stop, 1));
            arrives.extend(self.takes(travels.stop, travels.link));
        }
        let stops = [arrives.clone(), self.stop(root)].concat();
        self.event(word.clone(), &[&tests[..], &[Test::Not(root.phase, IDLE)]].concat(), stops);
        self.event(word, &[&tests[..], &[Test::Is(root.phase, IDLE)]].concat(), arrives);
    }
}
