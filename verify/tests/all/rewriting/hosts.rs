//! Groups on several hosts, by brute force: each group has a supervisor, and each pair of hosts has a queue. The
//! programs run on the hosts.
//!
//! Every message of a supervisor to another host goes through the queue to that host. The message at the front may
//! arrive at any time. The messages are orders to start, orders to stop, and reports of an end, of groups and of
//! programs alike. On one host, messages arrive at once, except that an order to stop a group may take time. The
//! verifier shares none of this: it keeps no queues, and it leaves out differences that no sentence can observe.

#[path = "loss.rs"]
mod loss;

use super::explore::armed;
use super::graph::{Edge, Graph, Kind, Seat, Seen};
use super::order::keep_next;
use super::rules::{Event, Order, Reference};
use super::term::{Conf, Left, Outcome, Why};
use language::algebra::Value;
use language::automaton::Failure;
use language::plan::{DEADLINE, MemberKind, Plan};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::rc::Rc;

pub(crate) use loss::{Fate, Loss};

/// The test leaves out larger graphs.
const STATES_MAX: usize = 1_500;

/// The tags for the normal ends of each module, from the spec.
pub(crate) type Tags = BTreeMap<Seat, Vec<String>>;

/// How something ends.
#[derive(Clone, Debug, PartialEq, Eq)]
enum End {
    Done(Vec<u8>),
    Failed(Failure),
    Stopped,
}

#[derive(Clone, Debug)]
enum Message {
    Start(Seat, Value),
    Stop(Seat),
    Ended(Seat, End),
}

/// An event to which a supervisor has to react.
enum Work {
    Begin(u32, Value),
    Halt(u32),
    Happen(u32, Event),
}

/// The possible next events.
enum Move {
    Start,
    Stop,
    /// A program ends on its host.
    Ends(Seat, End),
    Elapsed(u32, u32),
    /// The order to stop a group arrives on the group's own host.
    Reached(u32),
    /// The message at the front of the queue from one host to another arrives.
    Arrives(Way),
    /// The host that may be lost becomes lost.
    Lost,
    /// The node of a host notes the loss.
    Noted(u32),
    /// The own node of a supervisor reports that a member is out of reach.
    Refused(Seat),
    /// The host of a group is lost.
    Vanishes(u32),
}

/// Which messages may overtake others on the way from one host to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Links {
    /// Nothing.
    InOrder,
    /// Messages about one member may overtake messages about another.
    EachMember,
}

/// The first and the last host of a queue, and the member if each member has its own queue.
type Way = (u32, u32, Option<Seat>);

/// The whole state of all hosts at one moment.
#[derive(Clone)]
struct World<'p> {
    plan: &'p Plan,
    supervisors: Vec<Reference>,
    /// The running programs. For each, whether it has an order to stop.
    programs: BTreeMap<Seat, bool>,
    queues: BTreeMap<Way, VecDeque<Message>>,
    links: Links,
    /// The groups to which an order to stop is in transit, on the hosts of their supervisors.
    orders: BTreeSet<u32>,
    is_stopping: bool,
    has_ended: bool,
    happened: Vec<(Seat, Kind)>,
    /// The loss that may happen, if any, and the state of the lost host.
    loss: Option<Loss>,
    rift: loss::Rift,
    /// The groups that fail if their host is lost.
    frail: BTreeSet<u32>,
}

/// Explores a plan. Any program may fail and the whole may be stopped at any time. Returns nothing if there are too
/// many states.
pub(crate) fn explore(plan: &Plan, tags: &Tags, links: Links) -> Option<Graph> {
    explore_from(World::new(plan, links), tags)
}

/// Explores the same plan if the host of each of these groups may be lost. Each group of them that is on another host than its
/// supervisor fails then, and nothing else changes.
pub(crate) fn explore_frail(plan: &Plan, tags: &Tags, frail: BTreeSet<u32>) -> Option<Graph> {
    explore_from(World { frail, ..World::new(plan, Links::InOrder) }, tags)
}

/// Explores a plan in which a host may be lost, while no program fails and no stop is requested. The graph shows the
/// processes that really run.
pub(crate) fn explore_loss(plan: &Plan, tags: &Tags, loss: Loss, links: Links) -> Option<Graph> {
    explore_from(World { loss: Some(loss), ..World::new(plan, links) }, tags)
}

fn explore_from(first: World<'_>, tags: &Tags) -> Option<Graph> {
    let mut graph = Graph { seen: vec![Seen::default()], edges: vec![Vec::new()], ended: vec![false] };
    let mut known = BTreeMap::new();
    let mut open = VecDeque::from([(0, first)]);
    while let Some((state, world)) = open.pop_front() {
        if graph.seen.len() > STATES_MAX {
            return None;
        }
        for what in world.moves(state, tags) {
            let is_natural = !matches!(what, Move::Stop | Move::Ends(_, End::Failed(_)));
            let mut next = world.clone();
            next.happens(what);
            let happened = std::mem::take(&mut next.happened);
            let target = *known.entry(next.key()).or_insert_with(|| {
                graph.seen.push(next.seen());
                graph.edges.push(Vec::new());
                graph.ended.push(next.has_ended);
                if !next.has_ended || next.rift.is_lost {
                    open.push_back((graph.seen.len() - 1, next));
                }
                graph.seen.len() - 1
            });
            graph.edges[state].push(Edge { happened, target, is_natural });
        }
    }
    Some(graph)
}

impl<'p> World<'p> {
    fn new(plan: &'p Plan, links: Links) -> Self {
        let supervisors = plan.groups.iter().map(|group| Reference::new(&Rc::new(group.clone()))).collect();
        Self {
            plan,
            supervisors,
            programs: BTreeMap::new(),
            queues: BTreeMap::new(),
            links,
            orders: BTreeSet::new(),
            is_stopping: false,
            has_ended: false,
            happened: Vec::new(),
            loss: None,
            rift: loss::Rift::default(),
            frail: BTreeSet::new(),
        }
    }

    fn key(&self) -> String {
        let states: Vec<_> = self.supervisors.iter().map(|one| (&one.conf, &one.queue)).collect();
        let queues: Vec<_> = self.queues.iter().filter(|(_, queue)| !queue.is_empty()).collect();
        let (stopping, ended) = (self.is_stopping, self.has_ended);
        format!("{states:?} {:?} {queues:?} {:?} {stopping} {ended} {:?}", self.programs, self.orders, self.rift)
    }

    // ---- where things are ----

    fn kind(&self, (group, slot): Seat) -> MemberKind {
        self.plan.groups[group as usize].members[slot as usize].kind
    }

    /// Returns the hosts of a supervisor and of its member, or nothing if both are on the same host.
    fn link(&self, seat: Seat) -> Option<(u32, u32)> {
        let own = self.plan.groups[seat.0 as usize].host;
        let other = match self.kind(seat) {
            MemberKind::Leaf(leaf) => self.plan.leaves[leaf as usize].host,
            MemberKind::Group(inner) => self.plan.groups[inner as usize].host,
        };
        (own != other).then_some((own, other))
    }

    fn seat_of(&self, inner: u32) -> Option<Seat> {
        (0_u32..).zip(&self.plan.groups).find_map(|(group, source)| {
            let slot = source.members.iter().position(|member| member.kind == MemberKind::Group(inner))?;
            Some((group, u32::try_from(slot).expect("few members")))
        })
    }

    /// Returns the state of a member from the view of its supervisor. It is none if the member is not active.
    /// Otherwise, it is whether the member is being stopped.
    fn is_being_stopped(&self, (group, slot): Seat) -> Option<bool> {
        let conf = self.supervisors[group as usize].conf.as_ref()?;
        let is = |wanted: bool| {
            conf.any(&|part| match wanted {
                true => matches!(part, Conf::Stopping(member, _) if *member == slot),
                false => matches!(part, Conf::Active(member, _) if *member == slot),
            })
        };
        if is(true) { Some(true) } else { is(false).then_some(false) }
    }

    fn is_active(&self, seat: Seat) -> bool {
        self.is_being_stopped(seat).is_some()
            && match self.kind(seat) {
                MemberKind::Group(inner) => self.supervisors[inner as usize].conf.is_some(),
                MemberKind::Leaf(_) => true,
            }
    }

    fn is_running(&self, seat: Seat) -> bool {
        let outwards = std::iter::successors(Some(seat), |(group, _)| self.seat_of(*group));
        !self.is_stopping
            && outwards.into_iter().all(|at| self.is_active(at) && self.is_being_stopped(at) == Some(false))
    }

    fn seen(&self) -> Seen {
        if self.loss.is_some() {
            let active = self.programs.keys().copied().collect();
            return Seen { active, is_lost: self.rift.is_lost, ..Seen::default() };
        }
        if self.has_ended {
            return Seen::default();
        }
        let groups = (0_u32..).zip(&self.plan.groups);
        let seats =
            groups.flat_map(|(group, source)| (0_u32..).zip(&source.members).map(move |(slot, _)| (group, slot)));
        let active: BTreeSet<Seat> = seats.filter(|seat| self.is_active(*seat)).collect();
        let running = active.iter().copied().filter(|seat| self.is_running(*seat)).collect();
        let start = |message: &Message| if let Message::Start(seat, _) = message { Some(*seat) } else { None };
        let end = |message: &Message| if let Message::Ended(seat, _) = message { Some(*seat) } else { None };
        let messages = || self.queues.values().flatten();
        let starting = messages().filter_map(start).collect();
        let is_group = |seat: &Seat| matches!(self.kind(*seat), MemberKind::Group(_));
        let unheard = messages().filter_map(end).filter(is_group).collect();
        Seen { active, running, starting, unheard, stopping: self.stopping(), is_lost: false }
    }

    fn stopping(&self) -> BTreeSet<u32> {
        let holds_up = |part: &Conf| {
            matches!(part, Conf::ShieldK(..) | Conf::Stopping(..)) || matches!(part, Conf::Fin2(Outcome::Killed, _))
        };
        let is_stopping = |one: &Reference| one.conf.as_ref().is_some_and(|conf| conf.any(&holds_up));
        let groups = (0_u32..).zip(&self.supervisors).filter(|(_, one)| is_stopping(one));
        groups.map(|(group, _)| group).chain(self.orders.iter().copied()).collect()
    }

    // ---- what happens ----

    fn moves(&self, state: usize, tags: &Tags) -> Vec<Move> {
        if state == 0 {
            return vec![Move::Start];
        }
        let is_calm = self.loss.is_some();
        let mut all = if self.is_stopping || is_calm { Vec::new() } else { vec![Move::Stop] };
        self.loss_moves(&mut all);
        for (&seat, &is_told) in &self.programs {
            if is_told {
                all.push(Move::Ends(seat, End::Stopped));
                continue;
            }
            if !is_calm {
                all.push(Move::Ends(seat, End::Failed(Failure::Reported)));
                all.extend(self.reasons(seat).map(|reason| Move::Ends(seat, End::Failed(reason))));
            }
            if self.plan.groups[seat.0 as usize].members[seat.1 as usize].service {
                continue;
            }
            match tags.get(&seat) {
                None => all.push(Move::Ends(seat, End::Done(Vec::new()))),
                Some(tags) => all.extend(tags.iter().map(|tag| {
                    let value = Value::tagged(tag, &[]).expect("a short tag");
                    Move::Ends(seat, End::Done(value.bytes().to_vec()))
                })),
            }
        }
        for (group, supervisor) in (0_u32..).zip(&self.supervisors).filter(|(group, _)| !self.is_silent(*group)) {
            let mut timers = Vec::new();
            supervisor.conf.iter().for_each(|conf| armed(conf, &mut timers));
            keep_next(&self.plan.groups[group as usize].expression, &mut timers);
            all.extend(timers.into_iter().map(|timer| Move::Elapsed(group, timer)));
        }
        all.extend(self.orders.iter().map(|&group| Move::Reached(group)));
        all.extend(self.lost_groups().map(Move::Vanishes));
        let full = self.queues.iter().filter(|(_, queue)| !queue.is_empty());
        all.extend(full.map(|(&link, _)| Move::Arrives(link)));
        all
    }

    fn happens(&mut self, what: Move) {
        let work = match what {
            Move::Start => Some(Work::Begin(0, Value::EMPTY)),
            Move::Stop => {
                self.is_stopping = true;
                Some(Work::Halt(0))
            }
            Move::Elapsed(group, timer) => Some(Work::Happen(group, Event::Elapsed(timer))),
            Move::Reached(group) => {
                self.orders.remove(&group);
                Some(Work::Halt(group))
            }
            Move::Ends(seat, end) => {
                self.programs.remove(&seat);
                self.ends(seat, end)
            }
            Move::Arrives(link) => self.arrives(link),
            Move::Lost => {
                self.is_lost();
                None
            }
            Move::Noted(host) => return self.note(host),
            Move::Refused(seat) => self.gives_up(seat),
            Move::Vanishes(group) => self.vanishes(group),
        };
        self.follow(work);
    }

    /// Returns the reasons that a program may fail for, besides its own report, if some expression asks for reasons.
    fn reasons(&self, seat: Seat) -> impl Iterator<Item = Failure> {
        let asked: Vec<&Failure> = self.plan.groups.iter().flat_map(|group| group.expression.failures()).collect();
        let has = |failures: &[Failure]| asked.iter().any(|asked| failures.contains(asked));
        let is_service = self.plan.groups[seat.0 as usize].members[seat.1 as usize].service;
        let reasons = [
            (has(&[Failure::Crash, Failure::Reported]), Failure::Crash),
            (is_service && has(&[Failure::ServiceEnded, Failure::Reported]), Failure::ServiceEnded),
            (self.link(seat).is_some() && !asked.is_empty(), Failure::HostLost),
        ];
        reasons.into_iter().filter(|(may, _)| *may).map(|(_, reason)| reason)
    }

    /// Returns the running groups that may be lost with their host.
    fn lost_groups(&self) -> impl Iterator<Item = u32> {
        let runs = |group: &u32| self.supervisors[*group as usize].conf.is_some();
        let is_away = |group: &u32| self.seat_of(*group).is_some_and(|seat| self.link(seat).is_some());
        self.frail.iter().copied().filter(move |group| runs(group) && is_away(group))
    }

    fn vanishes(&mut self, group: u32) -> Option<Work> {
        let seat = self.seat_of(group)?;
        self.supervisors[group as usize] = Reference::new(&Rc::new(self.plan.groups[group as usize].clone()));
        self.programs.retain(|(of, _), _| *of != group);
        for queue in self.queues.values_mut() {
            queue.retain(|message| match message {
                Message::Start((of, _), _) | Message::Ended((of, _), _) => *of != group,
                Message::Stop(stopped) => stopped.0 != group && *stopped != seat,
            });
        }
        self.ends(seat, End::Failed(Failure::HostLost))
    }

    /// Carries out all immediate consequences.
    fn follow(&mut self, work: Option<Work>) {
        let mut open: VecDeque<Work> = work.into_iter().collect();
        while let Some(work) = open.pop_front() {
            self.react(work, &mut open);
        }
    }

    fn arrives(&mut self, link: Way) -> Option<Work> {
        match self.queues.get_mut(&link)?.pop_front()? {
            Message::Start(seat, value) => self.begins(seat, value),
            Message::Stop(seat) => match self.kind(seat) {
                MemberKind::Group(inner) => Some(Work::Halt(inner)),
                MemberKind::Leaf(_) => {
                    // A program that has ended has already reported its end.
                    self.programs.entry(seat).and_modify(|is_told| *is_told = true);
                    None
                }
            },
            Message::Ended(seat, end) => match self.kind(seat) {
                MemberKind::Leaf(_) => Some(self.is_heard(seat, end)),
                MemberKind::Group(_) => Some(Work::Happen(seat.0, event(seat.1, end))),
            },
        }
    }

    fn begins(&mut self, seat: Seat, value: Value) -> Option<Work> {
        self.happened.push((seat, Kind::Started));
        match self.kind(seat) {
            MemberKind::Group(inner) => Some(Work::Begin(inner, value)),
            MemberKind::Leaf(_) => {
                self.programs.insert(seat, false);
                None
            }
        }
    }

    /// A member has ended on its own host.
    fn ends(&mut self, seat: Seat, end: End) -> Option<Work> {
        let Some((own, other)) = self.link(seat) else { return Some(self.is_heard(seat, end)) };
        if matches!(self.kind(seat), MemberKind::Group(_)) {
            self.happened.push((seat, kind(&end)));
        }
        self.send((other, own), seat, Message::Ended(seat, end));
        None
    }

    /// A supervisor receives the report of an end. A member that it has asked to stop counts as stopped.
    fn is_heard(&mut self, seat: Seat, end: End) -> Work {
        let is_asked = kind(&end) == Kind::Done && self.is_being_stopped(seat) == Some(true);
        self.happened.push((seat, if is_asked { Kind::Stopped } else { kind(&end) }));
        Work::Happen(seat.0, event(seat.1, end))
    }

    fn react(&mut self, work: Work, open: &mut VecDeque<Work>) {
        let (Work::Begin(of, _) | Work::Halt(of) | Work::Happen(of, _)) = &work;
        if self.is_silent(*of) {
            return;
        }
        let (group, ended) = match work {
            Work::Begin(group, value) => (group, self.supervisors[group as usize].begin(value)),
            Work::Halt(group) if self.supervisors[group as usize].conf.is_none() => return,
            Work::Halt(group) => (group, self.supervisors[group as usize].halt()),
            Work::Happen(group, event) => (group, self.supervisors[group as usize].happen(&event)),
        };
        for order in std::mem::take(&mut self.supervisors[group as usize].orders) {
            match order {
                Order::Activate(slot, value) => {
                    let value = if let Left::Value(value) = value { value } else { Value::EMPTY };
                    match self.link((group, slot)) {
                        Some(link) => self.send(link, (group, slot), Message::Start((group, slot), value)),
                        None => open.extend(self.begins((group, slot), value)),
                    }
                }
                Order::Stop(slot) => match (self.link((group, slot)), self.kind((group, slot))) {
                    (Some(link), _) => self.send(link, (group, slot), Message::Stop((group, slot))),
                    (None, MemberKind::Group(inner)) => drop(self.orders.insert(inner)),
                    (None, MemberKind::Leaf(_)) => drop(self.programs.insert((group, slot), true)),
                },
                Order::Connect(_) | Order::Disconnect(_) | Order::Arm(..) | Order::Cancel(_) => {}
            }
        }
        let Some(outcome) = ended else { return };
        self.orders.remove(&group);
        let end = match outcome {
            Outcome::Done(Left::Value(value)) => End::Done(value.bytes().to_vec()),
            Outcome::Done(Left::ReasonText) => End::Done(Vec::new()),
            Outcome::Aborted(why) => End::Failed(reason(&why)),
            Outcome::Killed => End::Stopped,
        };
        match self.seat_of(group) {
            Some(seat) => open.extend(self.ends(seat, end)),
            None => self.has_ended = true,
        }
    }

    fn send(&mut self, (from, to): (u32, u32), seat: Seat, message: Message) {
        if self.is_cut(from, to) {
            return;
        }
        let own = (self.links == Links::EachMember).then_some(seat);
        self.queues.entry((from, to, own)).or_default().push_back(message);
    }
}

fn kind(end: &End) -> Kind {
    match end {
        End::Done(_) => Kind::Done,
        End::Failed(_) => Kind::Failed,
        End::Stopped => Kind::Stopped,
    }
}

/// Returns the reason that a group hands on.
fn reason(why: &Why) -> Failure {
    match why {
        Why::Reported(..) | Why::Left(_) => Failure::Reported,
        Why::Given(_, reason) => reason.clone(),
        Why::Busy(_) => Failure::Busy,
        Why::Unconfirmed(_) => Failure::StopUnconfirmed,
        Why::ServiceEnded(_) => Failure::ServiceEnded,
        Why::Failed(why) if why.starts_with(DEADLINE) => Failure::Timeout,
        Why::Failed(why) => Failure::Failed(why.clone()),
        Why::NoMatch => Failure::NoMatch,
    }
}

fn event(slot: u32, end: End) -> Event {
    match end {
        End::Done(bytes) => Event::Done(slot, bytes),
        End::Failed(Failure::Reported) => Event::Aborted(slot),
        End::Failed(Failure::StopUnconfirmed) => Event::Unconfirmed(slot),
        End::Failed(reason) => Event::Failed(slot, reason),
        End::Stopped => Event::Stopped(slot),
    }
}
