//! Compares brute force with `holds ltl`: both give the same verdicts on random small specs with random formulas.
//!
//! At each position, the reference searches all truth values that the temporal parts of a formula could have, beside
//! its own states. It shares nothing with the verifier, which builds an automaton step by step.

use super::explore::{Edge, Graph, Move, Seen, Tags, Trouble, explore};
use super::random::{Dice, TAGS, Taste, group};
use super::rules::Event;
use super::term::Outcome;
use super::text::text;
use language::algebra::Value;
use language::{Options, Source, compile_with_sites};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use verify::{Alone, Always, Limits, Verdict};

/// The test leaves out specs with more transitions.
const EDGES_MAX: usize = 250;
/// The largest number of temporal operators in a formula.
const TEMPORAL_MAX: usize = 4;

/// The result for a seed.
pub(crate) enum Compared {
    /// Both agree whether the formula holds.
    Same(bool),
    /// The check refused the spec, or the spec has too many states for brute force.
    LeftOut,
    Differs(String),
}

#[derive(Clone, Debug)]
enum Ltl {
    True,
    Atom(Atom),
    Not(Box<Self>),
    And(Box<Self>, Box<Self>),
    Or(Box<Self>, Box<Self>),
    Implies(Box<Self>, Box<Self>),
    Same(Box<Self>, Box<Self>),
    /// An operator, its number in the formula, and its operands. `G` and `F` have only the second operand.
    Temporal(char, usize, Box<Self>, Box<Self>),
}

#[derive(Clone, Debug)]
enum Atom {
    Active(u32),
    Running(u32),
    Stopping(u32),
    Started(u32),
    Done(u32),
    Tagged(u32, &'static str),
    Aborted(u32),
    Ended(u32),
    AllDone,
    AllAborted,
}

pub(crate) fn compare(seed: u64) -> Compared {
    let mut dice = Dice::new(seed ^ 0x5EED);
    let made = group(&mut dice, Taste::Text);
    let members = u32::try_from(made.members.len()).expect("few members");
    let (_, tags) = text(&made, "");
    let mut temporal = 0;
    let formula = Maker { dice: &mut dice, members, tags: &tags, temporal: &mut temporal }.formula(3);
    let (text, tags) = text(&made, &format!("        holds ltl \"{}\";\n", formula.written()));
    let source = Source::new("random.dca", text.clone());
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("random"));
    let Some((plan, sites)) = compiled.plan.zip(sites) else { return Compared::LeftOut };
    let lowered = Rc::new(plan.groups[0].clone());
    let (Some(rough), Some(calm)) = (explore(&lowered, &tags, Trouble::Any), explore(&lowered, &tags, Trouble::None))
    else {
        return Compared::LeftOut;
    };
    if rough.edges.iter().map(Vec::len).sum::<usize>() > EDGES_MAX {
        return Compared::LeftOut;
    }
    let expected = holds(&formula, temporal, (&rough, &calm));
    let limits = Limits { states: 200_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };
    let report = verify::verify(&plan, &sites, &limits);
    let found = report.findings.iter().find(|found| found.sentence.contains("holds ltl")).expect("an answer");
    match (found.verdict, expected) {
        (Verdict::Proved, true) => Compared::Same(true),
        (Verdict::Fails, false) => Compared::Same(false),
        (verdict, _) => {
            let story = found.story.iter().flat_map(verify::Story::lines).collect::<Vec<_>>().join("\n");
            Compared::Differs(format!("seed {seed}: {expected} by brute force, {verdict:?}\n{text}\n{story}"))
        }
    }
}

struct Maker<'m> {
    dice: &'m mut Dice,
    members: u32,
    tags: &'m Tags,
    temporal: &'m mut usize,
}

impl Maker<'_> {
    fn formula(&mut self, depth: u32) -> Ltl {
        if depth == 0 || self.dice.one_in(7) {
            return Ltl::Atom(self.atom());
        }
        let is_full = *self.temporal >= TEMPORAL_MAX;
        match self.dice.below(if is_full { 5 } else { 13 }) {
            0 => Ltl::Not(self.boxed(depth)),
            1 => Ltl::And(self.boxed(depth), self.boxed(depth)),
            2 => Ltl::Or(self.boxed(depth), self.boxed(depth)),
            3 => Ltl::Implies(self.boxed(depth), self.boxed(depth)),
            4 => Ltl::Same(self.boxed(depth), self.boxed(depth)),
            _ => {
                let operator = *self.dice.pick(&['G', 'G', 'F', 'U', 'W', 'R']);
                *self.temporal += 1;
                let number = *self.temporal - 1;
                let first = if "GF".contains(operator) { Box::new(Ltl::True) } else { self.boxed(depth) };
                Ltl::Temporal(operator, number, first, self.boxed(depth))
            }
        }
    }

    fn boxed(&mut self, depth: u32) -> Box<Ltl> {
        Box::new(self.formula(depth - 1))
    }

    fn atom(&mut self) -> Atom {
        let who = self.dice.below(self.members);
        match self.dice.below(13) {
            0..=2 => Atom::Active(who),
            3 | 4 => Atom::Running(who),
            5 => Atom::Stopping(who),
            6 => Atom::Started(who),
            7 if self.tags.contains_key(&who) => Atom::Tagged(who, TAGS[self.dice.below(2) as usize]),
            7 | 8 => Atom::Done(who),
            9 => Atom::Aborted(who),
            10 => Atom::Ended(who),
            11 => Atom::AllDone,
            _ => Atom::AllAborted,
        }
    }
}

impl Ltl {
    fn written(&self) -> String {
        match self {
            Self::True => "true".to_owned(),
            Self::Atom(atom) => match atom {
                Atom::Active(who) => format!("m{who}"),
                Atom::Running(who) => format!("m{who}.running"),
                Atom::Stopping(who) => format!("m{who}.stopping"),
                Atom::Started(who) => format!("m{who}.started"),
                Atom::Done(who) => format!("m{who}.done"),
                Atom::Tagged(who, tag) => format!("m{who}.done.{tag}"),
                Atom::Aborted(who) => format!("m{who}.aborted"),
                Atom::Ended(who) => format!("m{who}.ended"),
                Atom::AllDone => "done".to_owned(),
                Atom::AllAborted => "main.aborted".to_owned(),
            },
            Self::Not(of) => format!("!{}", of.written()),
            Self::And(p, q) => format!("({} & {})", p.written(), q.written()),
            Self::Or(p, q) => format!("({} | {})", p.written(), q.written()),
            Self::Implies(p, q) => format!("({} -> {})", p.written(), q.written()),
            Self::Same(p, q) => format!("({} <-> {})", p.written(), q.written()),
            Self::Temporal(operator, _, _, q) if "GF".contains(*operator) => format!("{operator} {}", q.written()),
            Self::Temporal(operator, _, p, q) => format!("({} {operator} {})", p.written(), q.written()),
        }
    }

    /// Returns whether the formula promises something, if it has to hold (`true`) or to fail (`false`).
    fn promises(&self, to_hold: bool) -> bool {
        match self {
            Self::True | Self::Atom(_) => false,
            Self::Not(of) => of.promises(!to_hold),
            Self::And(p, q) | Self::Or(p, q) => p.promises(to_hold) || q.promises(to_hold),
            Self::Implies(p, q) => p.promises(!to_hold) || q.promises(to_hold),
            Self::Same(p, q) => [true, false].into_iter().any(|way| p.promises(way) || q.promises(way)),
            Self::Temporal(operator, _, p, q) => {
                "FU".contains(*operator) == to_hold || p.promises(to_hold) || q.promises(to_hold)
            }
        }
    }

    fn temporals(&self) -> Vec<&Self> {
        match self {
            Self::True | Self::Atom(_) => Vec::new(),
            Self::Not(of) => of.temporals(),
            Self::And(p, q) | Self::Or(p, q) | Self::Implies(p, q) | Self::Same(p, q) => {
                [p.temporals(), q.temporals()].concat()
            }
            Self::Temporal(_, _, p, q) => [vec![self], p.temporals(), q.temporals()].concat(),
        }
    }
}

fn holds(formula: &Ltl, temporal: usize, graphs: (&Graph, &Graph)) -> bool {
    if let Ltl::And(p, q) = formula {
        return holds(p, temporal, graphs) && holds(q, temporal, graphs);
    }
    let graph = if formula.promises(true) { graphs.1 } else { graphs.0 };
    !Tableau::new(formula, temporal, graph).has_fair_run()
}

/// A position: after the transition with this number from a state, or at a state where nothing has just happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Place {
    After(usize, usize),
    Idle(usize),
}

/// A position with the truth values of the temporal parts, as bits.
type Node = (Place, u32);

struct Tableau<'t> {
    formula: &'t Ltl,
    temporals: Vec<&'t Ltl>,
    graph: &'t Graph,
    values: u32,
}

impl<'t> Tableau<'t> {
    fn new(formula: &'t Ltl, temporal: usize, graph: &'t Graph) -> Self {
        Self { formula, temporals: formula.temporals(), graph, values: 1 << temporal }
    }

    fn look(&self, place: Place) -> (Option<&Edge>, &Seen, usize) {
        match place {
            Place::After(state, edge) => {
                let edge = &self.graph.edges[state][edge];
                (Some(edge), &self.graph.seen[edge.target], edge.target)
            }
            Place::Idle(state) => (None, &self.graph.seen[state], state),
        }
    }

    fn next(&self, place: Place) -> Vec<Place> {
        let state = self.look(place).2;
        let edges = &self.graph.edges[state];
        let idle = (!edges.iter().any(Edge::is_natural)).then_some(Place::Idle(state));
        (0..edges.len()).map(|edge| Place::After(state, edge)).chain(idle).collect()
    }

    fn value(&self, formula: &Ltl, (place, bits): Node) -> bool {
        let of = |formula: &Ltl| self.value(formula, (place, bits));
        match formula {
            Ltl::True => true,
            Ltl::Atom(atom) => self.atom(atom, place),
            Ltl::Not(p) => !of(p),
            Ltl::And(p, q) => of(p) && of(q),
            Ltl::Or(p, q) => of(p) || of(q),
            Ltl::Implies(p, q) => !of(p) || of(q),
            Ltl::Same(p, q) => of(p) == of(q),
            Ltl::Temporal(_, number, ..) => bits >> number & 1 == 1,
        }
    }

    fn atom(&self, atom: &Atom, place: Place) -> bool {
        let (edge, seen, _) = self.look(place);
        let active = |who: &u32| seen.active.contains(who) || seen.stopping.contains(who);
        let running = |who: &u32| seen.active.contains(who) && !seen.is_stopping;
        let event = |is: &dyn Fn(&Edge) -> bool| edge.is_some_and(is);
        match atom {
            Atom::Active(who) => active(who),
            Atom::Running(who) => running(who),
            Atom::Stopping(who) => active(who) && !running(who),
            Atom::Started(who) => event(&|edge| edge.starts.contains(who)),
            Atom::Done(who) => event(&|edge| edge.is_done(*who)),
            Atom::Tagged(who, tag) => event(&|edge| {
                let bytes = Value::tagged(tag, &[]).expect("a short tag").bytes().to_vec();
                !edge.was_stopping && edge.what == Move::Leaf(Event::Done(*who, bytes))
            }),
            Atom::Aborted(who) => event(&|edge| {
                edge.what == Move::Leaf(Event::Aborted(*who))
                    || matches!(&edge.what, Move::Leaf(Event::Failed(of, _)) if of == who)
            }),
            Atom::Ended(who) => event(
                &|edge| matches!(&edge.what, Move::Leaf(Event::Done(of, _) | Event::Aborted(of) | Event::Failed(of, _) | Event::Stopped(of)) if of == who),
            ),
            Atom::AllDone => edge.is_some() && matches!(seen.ended, Some(Outcome::Done(_))),
            Atom::AllAborted => edge.is_some() && matches!(seen.ended, Some(Outcome::Aborted(_))),
        }
    }

    /// Returns whether the temporal parts can have these truth values at two positions, one after the other.
    fn follows(&self, node: Node, next: Node) -> bool {
        self.temporals.iter().all(|temporal| {
            let Ltl::Temporal(operator, number, p, q) = temporal else { return true };
            let (p, q) = (self.value(p, node), self.value(q, node));
            let later = next.1 >> number & 1 == 1;
            let expected = match operator {
                'G' => q && later,
                'F' => q || later,
                'R' => q && (p || later),
                _ => q || p && later,
            };
            (node.1 >> number & 1 == 1) == expected
        })
    }

    /// Returns whether a position keeps a promise, or shows a failure.
    fn is_kept(&self, temporal: &Ltl, node: Node) -> bool {
        let Ltl::Temporal(operator, number, p, q) = temporal else { return true };
        let (is_true, p, q) = (node.1 >> number & 1 == 1, self.value(p, node), self.value(q, node));
        match operator {
            'F' | 'U' => !is_true || q,
            'G' | 'R' => is_true || !q,
            _ => is_true || !p && !q,
        }
    }

    fn has_fair_run(&self) -> bool {
        let all = |place: Place| (0..self.values).map(move |bits| (place, bits));
        let starts = (0..self.graph.edges[0].len()).map(|edge| Place::After(0, edge));
        let first: Vec<Node> = starts.flat_map(all).filter(|node| !self.value(self.formula, *node)).collect();
        let mut edges: BTreeMap<Node, Vec<Node>> = BTreeMap::new();
        let mut open = first;
        while let Some(node) = open.pop() {
            if edges.contains_key(&node) {
                continue;
            }
            let next = self.next(node.0).into_iter().flat_map(all).filter(|next| self.follows(node, *next));
            let next: Vec<Node> = next.collect();
            open.extend(&next);
            edges.insert(node, next);
        }
        let mut back: BTreeMap<Node, Vec<Node>> = BTreeMap::new();
        for (node, next) in &edges {
            next.iter().for_each(|to| back.entry(*to).or_default().push(*node));
        }
        let mut open: Vec<BTreeSet<Node>> = vec![edges.keys().copied().collect()];
        while let Some(mut nodes) = open.pop() {
            while let Some(&node) = nodes.first() {
                let (ahead, behind) = (reach(&edges, &nodes, node), reach(&back, &nodes, node));
                let part: BTreeSet<Node> = ahead.intersection(&behind).copied().collect();
                nodes.retain(|other| !part.contains(other) && *other != node);
                if part.is_empty() || !self.temporals.iter().all(|it| part.iter().any(|node| self.is_kept(it, *node))) {
                    continue;
                }
                let left: BTreeSet<Node> = part.iter().copied().filter(|node| self.is_fair(node.0, &part)).collect();
                if left.len() == part.len() {
                    return true;
                }
                open.push(left);
            }
        }
        false
    }

    /// Returns whether a part contains everything that has to happen at a place.
    fn is_fair(&self, place: Place, part: &BTreeSet<Node>) -> bool {
        let state = self.look(place).2;
        let natural = self.graph.edges[state].iter().enumerate().filter(|(_, edge)| edge.is_natural());
        natural.into_iter().all(|(edge, _)| part.iter().any(|(place, _)| *place == Place::After(state, edge)))
    }
}

/// Returns the nodes among `among` that can be reached in one step or more.
fn reach(edges: &BTreeMap<Node, Vec<Node>>, among: &BTreeSet<Node>, from: Node) -> BTreeSet<Node> {
    let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(node) = open.pop() {
        for next in edges.get(&node).into_iter().flatten() {
            if among.contains(next) && reached.insert(*next) {
                open.push(*next);
            }
        }
    }
    reached
}
