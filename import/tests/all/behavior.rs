//! An imported tree behaves as an interpreter of BehaviorTree.CPP's rules says, which knows nothing of the import.
//!
//! Each action takes a random time and succeeds or fails, by its name and the time of its start. Each condition changes with time.
//! The interpreter has no ticks: it says when each action starts, and how and when the tree ends. The imported spec is simulated
//! with the same actions.

use crate::random::Random;
use import::import;
use language::{Ending, Options, Simulation, Source, Transition, compile};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::time::Duration;

/// A tree.
#[derive(Clone, Debug)]
enum Node {
    Action(usize),
    Condition(usize),
    Sequence(Vec<Self>),
    Fallback(Vec<Self>),
    Parallel {
        successes: usize,
        failures: usize,
        children: Vec<Self>,
    },
    ParallelAll(Vec<Self>),
    Reactive {
        is_sequence: bool,
        children: Vec<Self>,
    },
    Inverter(Box<Self>),
    Force {
        success: bool,
        child: Box<Self>,
    },
    Retry(u64, Box<Self>),
    Repeat(u64, Box<Self>),
    Timeout(u64, Box<Self>),
    Delay(u64, Box<Self>),
    IfThenElse(Vec<Self>),
    TryCatch(Vec<Self>),
    /// The node is skipped if a condition holds.
    Skip(usize, Box<Self>),
}

/// The result of a run of a node, with times in nanoseconds.
#[derive(Clone, Debug)]
struct Run {
    end: u64,
    is_success: bool,
    /// Whether the node was skipped; then `is_success` says nothing.
    is_skipped: bool,
    /// The actions, with the times of their starts.
    starts: Vec<(u64, usize)>,
}

/// Random numbers of one event.
fn mixed(seed: u64, number: usize, time: u64) -> Random {
    Random(seed ^ (number as u64).wrapping_mul(0x9E37_79B9) ^ time.wrapping_mul(0x85EB_CA6B))
}

/// How long an action takes that starts at a time, and whether it succeeds.
fn action(seed: u64, number: usize, start: u64) -> (u64, bool) {
    let mut random = mixed(seed, number, start);
    (1_000 + random.next() % 3_000_000_000, random.below(3) > 0)
}

/// Whether a condition holds at a time, and when it changes next.
fn condition(seed: u64, number: usize, time: u64) -> (bool, u64) {
    let mut random = mixed(seed, number, 0);
    let (high, low) = (1_000_000_007 + random.next() % 5_000_000_000, 1_000_000_007 + random.next() % 2_000_000_000);
    let phase = random.next() % (high + low);
    let inside = (time + phase) % (high + low);
    if inside < high { (true, time + high - inside) } else { (false, time + high + low - inside) }
}

/// Makes random trees.
struct Maker {
    random: Random,
    actions: usize,
    conditions: usize,
    /// The last time that was given, so that no two times are the same.
    time: u64,
}

impl Maker {
    fn nodes(&mut self, least: usize, depth: usize) -> Vec<Node> {
        let count = least + self.random.below(3);
        (0..count).map(|_| self.node(depth)).collect()
    }

    fn inner(&mut self, depth: usize) -> Box<Node> {
        Box::new(self.node(depth))
    }

    fn time(&mut self) -> u64 {
        self.time += 37;
        1 + (self.time * 7919) % 4001
    }

    fn condition(&mut self) -> usize {
        self.conditions += 1;
        self.conditions
    }

    /// A condition in one of its forms, or any node.
    fn reactive_child(&mut self, is_sequence: bool, depth: usize) -> Node {
        match self.random.below(6) {
            0 | 1 => Node::Condition(self.condition()),
            2 => Node::Inverter(Box::new(Node::Condition(self.condition()))),
            3 => {
                let conditions = (0..2).map(|_| Node::Condition(self.condition())).collect();
                if is_sequence { Node::Sequence(conditions) } else { Node::Fallback(conditions) }
            }
            _ => self.node(depth),
        }
    }

    fn node(&mut self, depth: usize) -> Node {
        let kind = if depth == 0 { 0 } else { self.random.below(19) };
        let depth = depth.saturating_sub(1);
        match kind {
            1 => Node::Condition(self.condition()),
            2 | 3 => Node::Sequence(self.nodes(1, depth)),
            4 | 5 => Node::Fallback(self.nodes(1, depth)),
            6 => {
                let children = self.nodes(2, depth);
                let successes = 1 + self.random.below(children.len());
                // The thresholds that have an exact counterpart.
                let failures = if successes == 1 && self.random.one_in(2) { 1 } else { children.len() - successes + 1 };
                Node::Parallel { successes, failures, children }
            }
            7 => Node::ParallelAll(self.nodes(2, depth)),
            8 | 9 => {
                let is_sequence = self.random.one_in(2);
                let children = (0..2 + self.random.below(3)).map(|_| self.reactive_child(is_sequence, depth)).collect();
                Node::Reactive { is_sequence, children }
            }
            10 => Node::Inverter(self.inner(depth)),
            11 => Node::Force { success: self.random.one_in(2), child: self.inner(depth) },
            12 => Node::Retry(1 + self.random.next() % 3, self.inner(depth)),
            13 => Node::Repeat(1 + self.random.next() % 3, self.inner(depth)),
            14 => match self.random.one_in(2) {
                true => Node::Timeout(self.time(), self.inner(depth)),
                false => Node::Delay(self.time(), self.inner(depth)),
            },
            15 => match self.random.one_in(2) {
                true => Node::TryCatch(self.nodes(2, depth)),
                false => Node::IfThenElse((0..2 + self.random.below(2)).map(|_| self.node(depth)).collect()),
            },
            16..=18 => {
                let number = self.condition();
                let child = match self.inner(depth) {
                    child if matches!(*child, Node::Skip(..)) => return *child,
                    child => child,
                };
                Node::Skip(number, child)
            }
            _ => {
                self.actions += 1;
                Node::Action(self.actions)
            }
        }
    }
}

fn xml(node: &Node) -> String {
    let all = |nodes: &[Node]| nodes.iter().map(xml).collect::<String>();
    match node {
        Node::Action(number) => format!("<Action ID=\"A{number}\"/>"),
        Node::Condition(number) => format!("<Condition ID=\"C{number}\"/>"),
        Node::Sequence(nodes) => format!("<Sequence>{}</Sequence>", all(nodes)),
        Node::Fallback(nodes) => format!("<Fallback>{}</Fallback>", all(nodes)),
        Node::Parallel { successes, failures, children } => {
            format!("<Parallel success_count=\"{successes}\" failure_count=\"{failures}\">{}</Parallel>", all(children))
        }
        Node::ParallelAll(nodes) => format!("<ParallelAll>{}</ParallelAll>", all(nodes)),
        Node::Reactive { is_sequence, children } => {
            let name = if *is_sequence { "ReactiveSequence" } else { "ReactiveFallback" };
            format!("<{name}>{}</{name}>", all(children))
        }
        Node::Inverter(child) => format!("<Inverter>{}</Inverter>", xml(child)),
        Node::Force { success: true, child } => format!("<ForceSuccess>{}</ForceSuccess>", xml(child)),
        Node::Force { success: false, child } => format!("<ForceFailure>{}</ForceFailure>", xml(child)),
        Node::Retry(count, child) => {
            format!("<RetryUntilSuccessful num_attempts=\"{count}\">{}</RetryUntilSuccessful>", xml(child))
        }
        Node::Repeat(count, child) => format!("<Repeat num_cycles=\"{count}\">{}</Repeat>", xml(child)),
        Node::Timeout(time, child) => format!("<Timeout msec=\"{time}\">{}</Timeout>", xml(child)),
        Node::Delay(time, child) => format!("<Delay delay_msec=\"{time}\">{}</Delay>", xml(child)),
        Node::IfThenElse(nodes) => format!("<IfThenElse>{}</IfThenElse>", all(nodes)),
        Node::TryCatch(nodes) => format!("<TryCatch>{}</TryCatch>", all(nodes)),
        Node::Skip(number, child) => {
            let child = xml(child);
            let end = child.find([' ', '>', '/']).expect("it is an element");
            format!("{} _skipIf=\"{number}\"{}", &child[..end], &child[end..])
        }
    }
}

/// A condition that has to keep its value while a later node runs.
#[derive(Clone, Copy)]
struct Guard {
    condition: usize,
    holds: bool,
}

/// The conditions that a node consists of, if each has to keep its value for the node to succeed, or to fail.
fn guards_of(node: &Node, holds: bool) -> Option<Vec<Guard>> {
    match (node, holds) {
        (Node::Condition(condition), _) => Some(vec![Guard { condition: *condition, holds }]),
        (Node::Inverter(child), _) => guards_of(child, !holds),
        (Node::Sequence(nodes) | Node::Reactive { is_sequence: true, children: nodes }, true)
        | (Node::Fallback(nodes) | Node::Reactive { is_sequence: false, children: nodes }, false) => {
            let all: Option<Vec<Vec<Guard>>> = nodes.iter().map(|node| guards_of(node, holds)).collect();
            Some(all?.concat())
        }
        _ => None,
    }
}

/// How many nodes of a tree would run again while a later node of a reactive one runs.
fn repeated(node: &Node) -> usize {
    let all = |nodes: &[Node]| nodes.iter().map(repeated).sum::<usize>();
    match node {
        Node::Action(_) | Node::Condition(_) => 0,
        Node::Reactive { is_sequence, children } => {
            let before = &children[..children.len() - 1];
            before.iter().filter(|child| guards_of(child, *is_sequence).is_none()).count() + all(children)
        }
        Node::Sequence(nodes)
        | Node::Fallback(nodes)
        | Node::Parallel { children: nodes, .. }
        | Node::ParallelAll(nodes)
        | Node::IfThenElse(nodes)
        | Node::TryCatch(nodes) => all(nodes),
        Node::Inverter(child)
        | Node::Force { child, .. }
        | Node::Retry(_, child)
        | Node::Repeat(_, child)
        | Node::Timeout(_, child)
        | Node::Delay(_, child)
        | Node::Skip(_, child) => repeated(child),
    }
}

/// The interpreter.
struct Interpreter {
    seed: u64,
    /// Whether two things happen at one instant, so that their order matters.
    has_tie: Cell<bool>,
}

impl Interpreter {
    fn run(&self, node: &Node, start: u64) -> Run {
        match node {
            Node::Action(number) => {
                let (time, is_success) = action(self.seed, *number, start);
                Run { end: start + time, is_success, is_skipped: false, starts: vec![(start, *number)] }
            }
            Node::Condition(number) => Run {
                end: start,
                is_success: condition(self.seed, *number, start).0,
                is_skipped: false,
                starts: vec![],
            },
            Node::Sequence(nodes) => self.row(nodes, start, false),
            Node::Fallback(nodes) => self.row(nodes, start, true),
            Node::Parallel { successes, failures, children } => self.parallel(*successes, *failures, children, start),
            Node::ParallelAll(nodes) => {
                let runs: Vec<Run> = nodes.iter().map(|node| self.run(node, start)).collect();
                let end = runs.iter().map(|run| run.end).max().unwrap_or(start);
                let is_success = runs.iter().all(|run| run.is_success);
                Run {
                    end,
                    is_success,
                    is_skipped: false,
                    starts: runs.into_iter().flat_map(|run| run.starts).collect(),
                }
            }
            Node::Reactive { is_sequence, children } => self.reactive(*is_sequence, children, start),
            Node::Inverter(child) => {
                let run = self.run(child, start);
                Run { is_success: !run.is_success, ..run }
            }
            Node::Force { success, child } => Run { is_success: *success, ..self.run(child, start) },
            Node::Retry(count, child) => self.rounds(*count, child, start, true),
            Node::Repeat(count, child) => self.rounds(*count, child, start, false),
            Node::Timeout(time, child) => self.cut(self.run(child, start), start + time * 1_000_000, false),
            Node::Delay(time, child) => self.run(child, start + time * 1_000_000),
            Node::IfThenElse(nodes) => {
                let first = self.run(&nodes[0], start);
                match (first.is_success, nodes.get(2)) {
                    (true, _) => after(first, |end| self.run(&nodes[1], end)),
                    (false, Some(other)) => after(first, |end| self.run(other, end)),
                    (false, None) => first,
                }
            }
            Node::Skip(number, child) => match condition(self.seed, *number, start).0 {
                true => Run { end: start, is_success: true, is_skipped: true, starts: vec![] },
                false => self.run(child, start),
            },
            Node::TryCatch(nodes) => {
                let (last, tried) = nodes.split_last().expect("it has two children");
                let run = self.row(tried, start, false);
                if run.is_success {
                    return run;
                }
                Run { is_success: false, is_skipped: false, ..after(run, |end| self.run(last, end)) }
            }
        }
    }

    /// Children one after the other. While one runs, the conditions before it are asked again at each tick.
    ///
    /// The tree would run the other nodes before it again as well. A spec runs them once, and a remark says so.
    fn reactive(&self, is_sequence: bool, children: &[Node], start: u64) -> Run {
        let mut whole = Run { end: start, is_success: is_sequence, is_skipped: true, starts: vec![] };
        let mut guards = Vec::new();
        for child in children {
            let all_skipped = whole.is_skipped;
            let now = whole.end;
            let change = guards.iter().map(|guard: &Guard| self.next_change(*guard, now)).min();
            whole = after(whole, |end| match change {
                Some(change) => self.cut(self.run(child, end), change, !is_sequence),
                None => self.run(child, end),
            });
            if !whole.is_skipped && whole.is_success != is_sequence {
                return whole;
            }
            whole.is_skipped &= all_skipped;
            guards.extend(guards_of(child, is_sequence).into_iter().flatten());
        }
        Run { is_success: is_sequence, ..whole }
    }

    /// When a condition gets another value than a guard needs; at once if it has it now.
    fn next_change(&self, guard: Guard, now: u64) -> u64 {
        let (holds, change) = condition(self.seed, guard.condition, now);
        if holds == guard.holds { change } else { now }
    }

    /// Children one after the other, until one ends in this way.
    fn row(&self, nodes: &[Node], start: u64, until: bool) -> Run {
        let mut whole = Run { end: start, is_success: !until, is_skipped: true, starts: vec![] };
        for node in nodes {
            let all_skipped = whole.is_skipped;
            whole = after(whole, |end| self.run(node, end));
            if !whole.is_skipped && whole.is_success == until {
                return whole;
            }
            whole.is_skipped &= all_skipped;
        }
        Run { is_success: !until, ..whole }
    }

    fn rounds(&self, count: u64, child: &Node, start: u64, until: bool) -> Run {
        let rounds = vec![child.clone(); usize::try_from(count).expect("it is small")];
        self.row(&rounds, start, until)
    }

    fn parallel(&self, successes: usize, failures: usize, children: &[Node], start: u64) -> Run {
        let runs: Vec<Run> = children.iter().map(|child| self.run(child, start)).collect();
        let mut ends: Vec<(u64, bool)> = runs.iter().map(|run| (run.end, run.is_success)).collect();
        ends.sort_by_key(|(end, _)| *end);
        self.note_tie(ends.windows(2).any(|two| two[0].0 == two[1].0));
        let (mut succeeded, mut failed) = (0, 0);
        for (end, is_success) in ends {
            *if is_success { &mut succeeded } else { &mut failed } += 1;
            let has_failed = failed == failures || children.len() - failed < successes;
            if succeeded == successes || has_failed {
                let starts = runs.into_iter().flat_map(|run| run.starts).filter(|(at, _)| *at < end).collect();
                return Run { end, is_success: succeeded == successes, is_skipped: false, starts };
            }
        }
        unreachable!("all children have ended")
    }

    /// A run that ends at a time at the latest, in a given way.
    fn cut(&self, run: Run, latest: u64, is_success: bool) -> Run {
        self.note_tie(run.end == latest);
        if run.end <= latest {
            return run;
        }
        let starts = run.starts.into_iter().filter(|(at, _)| *at < latest).collect();
        Run { end: latest, is_success, is_skipped: false, starts }
    }

    fn note_tie(&self, is_tie: bool) {
        self.has_tie.set(self.has_tie.get() || is_tie);
    }
}

/// The next run behind a run.
fn after(run: Run, next: impl FnOnce(u64) -> Run) -> Run {
    let next = next(run.end);
    Run { starts: [run.starts, next.starts].concat(), ..next }
}

/// Simulates a spec with the same actions and conditions.
fn simulate(text: &str, seed: u64) -> Run {
    let compiled = compile(&Source::new("tree.dca", text), &[], &Options::named("tree"));
    let plan = compiled.plan.unwrap_or_else(|| panic!("{text}\n{:?}", compiled.diagnostics));
    let checks = checks(text);
    let mut simulation = Simulation::start(&plan);
    let mut starts = Vec::new();
    let mut ends: BTreeMap<String, (u64, Ending)> = BTreeMap::new();
    let nanoseconds = |time: Duration| u64::try_from(time.as_nanos()).expect("it is not long");
    loop {
        for event in simulation.take_happenings() {
            let (now, path) = (nanoseconds(event.at), event.path.clone());
            let name = path.rsplit('/').next().unwrap_or_default().to_owned();
            match event.transition {
                Transition::Started if path.contains('/') => {
                    let (end, is_success) = match checks.get(&name) {
                        Some(number) => (now, condition(seed, *number, now).0),
                        None => end_of(&name, seed, now, &mut starts),
                    };
                    let ending = if is_success { Ending::Done } else { Ending::Aborted("it failed".into()) };
                    ends.insert(path, (end, ending));
                }
                Transition::Stopped => {
                    // An action that was stopped as it started has done nothing.
                    if starts.last().is_some_and(|(at, _)| *at == now) && name.starts_with('a') {
                        starts.retain(|start| *start != (now, number_of(&name)));
                    }
                    ends.remove(&path);
                }
                Transition::Done | Transition::Aborted(_) => {
                    ends.remove(&path);
                }
                Transition::Started
                | Transition::Stopping
                | Transition::Waits(_)
                | Transition::Limited(_)
                | Transition::Says(_) => {}
            }
        }
        let now = nanoseconds(simulation.now());
        if let Some(outcome) = simulation.outcome() {
            return Run { end: now, is_success: *outcome == Transition::Done, is_skipped: false, starts };
        }
        let next = ends
            .iter()
            .min_by_key(|(_, (end, _))| *end)
            .map(|(path, (end, ending))| (path.clone(), *end, ending.clone()));
        let timer = simulation.next_timer().map(nanoseconds);
        match (next, timer) {
            (Some((path, end, ending)), timer) if timer.is_none_or(|timer| end < timer) => {
                simulation.pass(Duration::from_nanos(end - now));
                simulation.end(&path, ending).expect("it runs");
            }
            (_, Some(timer)) => simulation.pass(Duration::from_nanos(timer - now)),
            (_, None) => panic!("nothing happens any more:\n{text}"),
        }
    }
}

/// The conditions that scripts check, by their instances: the code of a script is the number of its condition.
fn checks(text: &str) -> BTreeMap<String, usize> {
    let mut modules: BTreeMap<&str, usize> = BTreeMap::new();
    let mut code = None;
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("/// Done if `") {
            code = rest.split('`').next().and_then(|digits| digits.parse().ok());
        } else if let (Some(rest), Some(number)) = (line.strip_prefix("module "), code.take()) {
            modules.insert(rest.split('(').next().unwrap_or_default(), number);
        }
    }
    let instances = text.lines().filter_map(|line| line.trim().split_once(" instof "));
    let instances = instances.filter_map(|(name, kind)| Some((name, modules.get(kind.split('(').next()?)?)));
    instances.map(|(name, number)| (name.to_owned(), *number)).collect()
}

/// The number in a name such as `a7`.
fn number_of(name: &str) -> usize {
    name[1..].split('_').next().and_then(|digits| digits.parse().ok()).expect("a number")
}

/// When a process ends that starts now, and whether it is done then.
fn end_of(name: &str, seed: u64, now: u64, starts: &mut Vec<(u64, usize)>) -> (u64, bool) {
    if let Some(name) = name.strip_prefix("while_") {
        let (holds, change) = condition(seed, number_of(name), now);
        return (if holds { change } else { now }, false);
    }
    if let Some(name) = name.strip_prefix("until_") {
        let (holds, change) = condition(seed, number_of(name), now);
        return (if holds { now } else { change }, true);
    }
    if name.starts_with('c') {
        return (now, condition(seed, number_of(name), now).0);
    }
    starts.push((now, number_of(name)));
    let (time, is_success) = action(seed, number_of(name), now);
    (now + time, is_success)
}

/// Compares a tree, unless two things happen at one instant.
fn check(seed: u64) -> bool {
    let mut maker = Maker { random: Random(seed), actions: 0, conditions: 0, time: seed % 1000 };
    let node = maker.node(4);
    let tree = format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"T\">{}</BehaviorTree></root>", xml(&node));
    let imported =
        import(&Source::new("tree.xml", tree.as_str()), &[]).unwrap_or_else(|why| panic!("{seed}: {why}\n{tree}"));
    let again = imported.remarks.iter().filter(|one| one.text.contains("runs once here; in the tree, it starts again"));
    assert_eq!(again.count(), repeated(&node), "{seed}: {:?}\n{tree}", imported.remarks);
    let is_checked = |text: &str| {
        text.contains("is a program that you have to write")
            || text.contains("runs once here; in the tree, it starts again")
    };
    let remarks: Vec<_> = imported.remarks.iter().filter(|one| !is_checked(&one.text)).collect();
    assert!(remarks.iter().all(|one| one.text.contains("skip")), "{seed}: {remarks:?}\n{tree}");
    if !remarks.is_empty() {
        return false;
    }
    let interpreter = Interpreter { seed, has_tie: Cell::new(false) };
    let mut expected = interpreter.run(&node, 0);
    if interpreter.has_tie.get() {
        return false;
    }
    let mut found = simulate(&imported.text, seed);
    expected.starts.sort_unstable();
    found.starts.sort_unstable();
    let show = |run: &Run| format!("{} at {} with {:?}", run.is_success, run.end, run.starts);
    assert_eq!(show(&found), show(&expected), "seed {seed}\n{tree}\n{}", imported.text);
    true
}

#[test]
fn imported_trees_behave_as_an_interpreter_says() {
    let compared = (0..300).filter(|seed| check(*seed)).count();
    assert!(compared > 120, "{compared} of 300 trees were compared");
}

#[test]
#[ignore = "long: 20,000 trees"]
fn many_imported_trees_behave_as_an_interpreter_says() {
    let compared = (0..20_000).filter(|seed| check(*seed)).count();
    println!("{compared} of 20000 trees were compared");
}
