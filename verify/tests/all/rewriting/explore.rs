//! Explores all possible behaviour of a small group, by brute force over the reference: every order of events, without
//! any reduction.

use super::order::keep_next;
use super::rules::{Event, Order, Reference};
use super::term::{Conf, Outcome};
use language::algebra::Value;
use language::automaton::Failure;
use language::plan::Group;
use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;

/// The test leaves out larger graphs.
const STATES_MAX: usize = 4_000;

/// The failures and stops that may happen in addition to the normal ends of the members.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Trouble {
    None,
    /// Any member may fail, and the whole may be stopped, at any time.
    Any,
    /// This member may crash, once.
    Crash(u32),
    /// This member may hang. From then on, it never ends by itself.
    Hang(u32),
}

/// The events between two states.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Move {
    Start,
    /// A request to stop the whole.
    Stop,
    Leaf(Event),
    /// The one fault of [`Trouble::Crash`] or [`Trouble::Hang`].
    Fault,
}

/// A transition: the event, the members that it started in order, and the target.
#[derive(Clone, Debug)]
pub(crate) struct Edge {
    pub(crate) what: Move,
    /// Whether the event's member was being stopped.
    pub(crate) was_stopping: bool,
    pub(crate) starts: Vec<u32>,
    pub(crate) target: usize,
}

/// The observable part of a state.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    /// The members that are active and not being stopped.
    pub(crate) active: Vec<u32>,
    pub(crate) stopping: Vec<u32>,
    /// Whether the whole has been asked to stop and has not ended.
    pub(crate) is_stopping: bool,
    /// Whether the one fault has happened.
    pub(crate) is_struck: bool,
    pub(crate) ended: Option<Outcome>,
}

/// All states. The first one is the state before the start.
#[derive(Debug, Default)]
pub(crate) struct Graph {
    pub(crate) seen: Vec<Seen>,
    pub(crate) edges: Vec<Vec<Edge>>,
}

/// The tags for the normal ends of each module, from the spec.
pub(crate) type Tags = BTreeMap<u32, Vec<String>>;

/// Explores a group. Returns nothing if there are too many states.
pub(crate) fn explore(group: &Rc<Group>, tags: &Tags, trouble: Trouble) -> Option<Graph> {
    let first = Reference::new(group);
    let mut graph = Graph { seen: vec![Seen::default()], edges: vec![Vec::new()] };
    let mut known: BTreeMap<String, usize> = BTreeMap::new();
    let mut open = VecDeque::from([(0, first)]);
    while let Some((state, reference)) = open.pop_front() {
        if graph.seen.len() > STATES_MAX {
            return None;
        }
        let (is_stopping, is_struck) = (graph.seen[state].is_stopping, graph.seen[state].is_struck);
        for what in moves(&graph.seen[state], &reference, group, tags, trouble) {
            let mut next = reference.clone();
            let ended = match &what {
                Move::Start => next.begin(Value::EMPTY),
                Move::Stop => next.halt(),
                Move::Leaf(event) => next.happen(event),
                Move::Fault => match trouble {
                    Trouble::Crash(member) => next.happen(&Event::Failed(member, Failure::Crash)),
                    Trouble::None | Trouble::Any | Trouble::Hang(_) => None,
                },
            };
            let orders = std::mem::take(&mut next.orders);
            let starts = orders.iter().filter_map(|order| match order {
                Order::Activate(member, _) => Some(*member),
                Order::Connect(_) | Order::Disconnect(_) | Order::Stop(_) | Order::Arm(..) | Order::Cancel(_) => None,
            });
            let seen = Seen {
                is_struck: is_struck || what == Move::Fault,
                ..look(&next, is_stopping || what == Move::Stop, ended)
            };
            let marks = (seen.is_stopping, seen.is_struck);
            let key = format!("{:?} {marks:?} {:?} {:?}", seen.ended, next.conf, next.queue);
            let target = *known.entry(key).or_insert_with(|| {
                graph.seen.push(seen.clone());
                graph.edges.push(Vec::new());
                if seen.ended.is_none() {
                    open.push_back((graph.seen.len() - 1, next));
                }
                graph.seen.len() - 1
            });
            let was_stopping = matches!(&what, Move::Leaf(event) if is_of_stopping(&graph.seen[state], event));
            graph.edges[state].push(Edge { what, was_stopping, starts: starts.collect(), target });
        }
    }
    Some(graph)
}

fn moves(at: &Seen, reference: &Reference, group: &Group, tags: &Tags, trouble: Trouble) -> Vec<Move> {
    let Some(conf) = &reference.conf else { return vec![Move::Start] };
    let mut all = if trouble == Trouble::Any && !at.is_stopping { vec![Move::Stop] } else { Vec::new() };
    let seen = look(reference, false, None);
    for &member in &seen.active {
        let hangs = at.is_struck && trouble == Trouble::Hang(member);
        if !hangs && !group.members[member as usize].service {
            match tags.get(&member) {
                None => all.push(Move::Leaf(Event::Done(member, Vec::new()))),
                Some(tags) => all.extend(tags.iter().map(|tag| {
                    let value = Value::tagged(tag, &[]).expect("a short tag");
                    Move::Leaf(Event::Done(member, value.bytes().to_vec()))
                })),
            }
        }
        if trouble == Trouble::Any {
            all.push(Move::Leaf(Event::Aborted(member)));
            let asked = group.expression.failures();
            if asked.contains(&&Failure::Crash) || asked.contains(&&Failure::Reported) {
                all.push(Move::Leaf(Event::Failed(member, Failure::Crash)));
            }
            let tells = |failure| asked.contains(&&failure);
            let is_service = group.members[member as usize].service;
            if is_service && (tells(Failure::ServiceEnded) || tells(Failure::Reported)) {
                all.push(Move::Leaf(Event::Failed(member, Failure::ServiceEnded)));
            }
        }
        if !at.is_struck && [Trouble::Crash(member), Trouble::Hang(member)].contains(&trouble) {
            all.push(Move::Fault);
        }
    }
    all.extend(seen.stopping.iter().map(|&member| Move::Leaf(Event::Stopped(member))));
    let mut timers = Vec::new();
    armed(conf, &mut timers);
    keep_next(&group.expression, &mut timers);
    all.extend(timers.into_iter().map(|timer| Move::Leaf(Event::Elapsed(timer))));
    all
}

/// Adds the running timers.
pub(crate) fn armed(conf: &Conf, timers: &mut Vec<u32>) {
    if let Conf::Timer(timer) | Conf::ShieldK(Some(timer), _) = conf {
        timers.push(*timer);
    }
    conf.parts().into_iter().for_each(|part| armed(part, timers));
}

fn look(reference: &Reference, is_stopping: bool, ended: Option<Outcome>) -> Seen {
    let mut seen = Seen { is_stopping: is_stopping && ended.is_none(), ended, ..Seen::default() };
    if let Some(conf) = &reference.conf {
        gather(conf, &mut seen);
    }
    seen
}

fn gather(conf: &Conf, seen: &mut Seen) {
    if let Conf::Active(member, _) = conf {
        seen.active.push(*member);
    } else if let Conf::Stopping(member, _) = conf {
        seen.stopping.push(*member);
    }
    conf.parts().into_iter().for_each(|part| gather(part, seen));
}

fn is_of_stopping(seen: &Seen, event: &Event) -> bool {
    match event {
        Event::Done(member, _)
        | Event::Aborted(member)
        | Event::Failed(member, _)
        | Event::Stopped(member)
        | Event::Unconfirmed(member) => seen.stopping.contains(member),
        Event::Elapsed(_) => false,
    }
}

impl Edge {
    /// Returns whether the move needs neither a failure nor a stop of the whole.
    pub(crate) fn is_natural(&self) -> bool {
        !matches!(self.what, Move::Stop | Move::Fault | Move::Leaf(Event::Aborted(_) | Event::Failed(..)))
    }

    /// Returns whether the move makes a member done.
    pub(crate) fn is_done(&self, member: u32) -> bool {
        !self.was_stopping && matches!(&self.what, Move::Leaf(Event::Done(of, _)) if *of == member)
    }
}

impl Graph {
    /// Returns the states from which a goal can be reached by natural moves.
    pub(crate) fn can_reach(&self, is_goal: impl Fn(&Seen) -> bool) -> Vec<bool> {
        self.can_reach_by(is_goal, Edge::is_natural)
    }

    /// Returns the states from which a goal can be reached by moves for which `counts` is true.
    pub(crate) fn can_reach_by(&self, is_goal: impl Fn(&Seen) -> bool, counts: impl Fn(&Edge) -> bool) -> Vec<bool> {
        let mut can: Vec<bool> = self.seen.iter().map(is_goal).collect();
        loop {
            let mut grew = false;
            for state in (0..can.len()).filter(|&state| !can[state]).collect::<Vec<_>>() {
                let leads = self.edges[state].iter().any(|edge| counts(edge) && can[edge.target]);
                can[state] |= leads;
                grew |= leads;
            }
            if !grew {
                return can;
            }
        }
    }

    /// Returns whether a watcher objects to a transition. The watcher keeps a small number along each way.
    pub(crate) fn objects(&self, watch: impl Fn(u8, &Edge, &Seen) -> Result<u8, ()>) -> bool {
        let mut known = std::collections::BTreeSet::from([(0, 0)]);
        let mut open = vec![(0, 0)];
        while let Some((state, note)) = open.pop() {
            for edge in &self.edges[state] {
                let Ok(note) = watch(note, edge, &self.seen[edge.target]) else { return true };
                if known.insert((edge.target, note)) {
                    open.push((edge.target, note));
                }
            }
        }
        false
    }
}
