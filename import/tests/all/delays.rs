//! An imported chart sends its delayed events as an interpreter of SCXML's rules says, which knows nothing of the import.
//!
//! Random charts send and cancel events on entry, on exit and in transitions, which may be internal. The interpreter and the
//! imported activity get the same events from outside, and are in the same states behind each of them.

use crate::player::{Played, Player};
use crate::random::Random;
use import::import;
use language::Source;
use language::automaton::{Automaton, Event};
use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;

/// An action of a chart.
#[derive(Clone, Debug)]
enum Act {
    Send { event: usize, milliseconds: u64, id: usize },
    Cancel(usize),
}

#[derive(Clone, Debug)]
struct Transition {
    event: String,
    target: Option<usize>,
    is_internal: bool,
    acts: Vec<Act>,
}

#[derive(Clone, Debug)]
struct State {
    parent: Option<usize>,
    /// The states inside, of which the first one is the initial one.
    children: Vec<usize>,
    entry: Vec<Act>,
    exit: Vec<Act>,
    transitions: Vec<Transition>,
}

/// Makes a random chart; a state stands behind the state around it.
fn chart(random: &mut Random) -> Vec<State> {
    let mut parents = Vec::new();
    for _ in 0..2 + random.below(2) {
        parents.push(None);
        let outer = parents.len() - 1;
        let inner = if random.one_in(2) { 2 } else { 0 };
        parents.extend(std::iter::repeat_n(Some(outer), inner));
    }
    let count = parents.len();
    let of = |state| (0..count).filter(|child| parents[*child] == Some(state)).collect::<Vec<_>>();
    (0..count)
        .map(|state| {
            let children = of(state);
            let transitions = (0..1 + random.below(3)).map(|_| transition(random, count, &children));
            let transitions = transitions.collect();
            let (entry, exit) = (acts(random, 2), acts(random, 3));
            State { parent: parents[state], children, entry, exit, transitions }
        })
        .collect()
}

fn transition(random: &mut Random, count: usize, children: &[usize]) -> Transition {
    let event = if random.one_in(2) { format!("e{}", random.below(3)) } else { format!("t{}", random.below(2)) };
    let inner = (!children.is_empty() && random.one_in(2)).then(|| children[random.below(2)]);
    let target = if random.one_in(4) { None } else { inner.or(Some(random.below(count))) };
    Transition { event, target, is_internal: inner.is_some(), acts: acts(random, 3) }
}

fn acts(random: &mut Random, rare: usize) -> Vec<Act> {
    let count = if random.one_in(rare) { 1 + random.below(2) } else { 0 };
    let mut act = || {
        let event = random.below(2);
        let id = if random.one_in(4) { 2 } else { event };
        if random.one_in(2) {
            return Act::Cancel(id);
        }
        let milliseconds = if random.one_in(8) { 0 } else { 1_009 + 700 * event as u64 + 91 * random.below(2) as u64 };
        Act::Send { event, milliseconds, id }
    };
    (0..count).map(|_| act()).collect()
}

fn acts_xml(tag: &str, acts: &[Act]) -> String {
    let act = |act: &Act| match act {
        Act::Send { event, milliseconds, id } => {
            format!("<send event=\"t{event}\" delay=\"{milliseconds}ms\" id=\"i{id}\"/>")
        }
        Act::Cancel(id) => format!("<cancel sendid=\"i{id}\"/>"),
    };
    if tag.is_empty() || acts.is_empty() {
        return acts.iter().map(act).collect();
    }
    format!("<{tag}>{}</{tag}>", acts.iter().map(act).collect::<String>())
}

fn xml(chart: &[State], state: usize) -> String {
    let State { children, entry, exit, transitions, .. } = &chart[state];
    let transition = |transition: &Transition| {
        let target = transition.target.map_or_else(String::new, |target| format!(" target=\"s{target}\""));
        let kind = if transition.is_internal { " type=\"internal\"" } else { "" };
        format!(
            "<transition event=\"{}\"{target}{kind}>{}</transition>",
            transition.event,
            acts_xml("", &transition.acts)
        )
    };
    let transitions: String = transitions.iter().map(transition).collect();
    let children: String = children.iter().map(|child| xml(chart, *child)).collect();
    let (entry, exit) = (acts_xml("onentry", entry), acts_xml("onexit", exit));
    format!("<state id=\"s{state}\">{entry}{exit}{transitions}{children}</state>\n")
}

/// An event that waits for its time.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Pending {
    at: Duration,
    event: usize,
    milliseconds: u64,
    id: usize,
}

struct Interpreter<'a> {
    chart: &'a [State],
    /// The active states, each behind the state around it.
    active: Vec<usize>,
    now: Duration,
    pending: Vec<Pending>,
    queue: VecDeque<String>,
    /// Whether the import says in a remark that this chart differs, or the order of two events is open.
    differs: bool,
}

impl Interpreter<'_> {
    fn around(&self, state: usize) -> Vec<usize> {
        std::iter::successors(self.chart[state].parent, |state| self.chart[*state].parent).collect()
    }

    fn act(&mut self, acts: &[Act]) {
        for act in acts {
            match *act {
                Act::Cancel(id) => self.pending.retain(|pending| pending.id != id),
                Act::Send { event, milliseconds: 0, .. } => self.queue.push_back(format!("t{event}")),
                Act::Send { event, milliseconds, id } => {
                    // One timer here holds one event of a sort.
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

    fn enter(&mut self, target: usize, domain: Option<usize>) {
        let path = self.around(target).into_iter().take_while(|around| Some(*around) != domain);
        let mut path: Vec<usize> = path.collect();
        path.reverse();
        path.push(target);
        path.extend(std::iter::successors(self.chart[target].children.first().copied(), |state| {
            self.chart[*state].children.first().copied()
        }));
        for state in path {
            self.active.push(state);
            self.act(&self.chart[state].entry);
        }
    }

    fn step(&mut self, event: &str) {
        let mut inner_first = self.active.iter().rev();
        let found = inner_first.find_map(|source| {
            let fits = |transition: &&Transition| transition.event == event;
            Some((*source, self.chart[*source].transitions.iter().find(fits)?))
        });
        let Some((source, transition)) = found else { return };
        let Some(target) = transition.target else { return self.act(&transition.acts) };
        let above = self.around(target);
        let domain = match transition.is_internal && above.contains(&source) {
            true => Some(source),
            false => self.around(source).into_iter().find(|around| above.contains(around)),
        };
        while let Some(state) = self.active.pop_if(|state| Some(*state) != domain) {
            self.act(&self.chart[state].exit);
        }
        self.act(&transition.acts);
        self.enter(target, domain);
    }

    /// Takes all events that wait now.
    fn settle(&mut self) {
        for _ in 0..20 {
            let Some(event) = self.queue.pop_front() else { return };
            self.step(&event);
        }
        self.differs = true;
    }

    fn pass(&mut self, until: Duration) {
        while let Some(next) = self.pending.iter().min_by_key(|pending| pending.at).cloned()
            && next.at <= until
        {
            self.differs |= self.pending.iter().filter(|pending| pending.at == next.at).count() > 1;
            self.pending.retain(|pending| *pending != next);
            self.now = next.at;
            self.queue.push_back(format!("t{}", next.event));
            self.settle();
        }
        self.now = until;
    }
}

/// Compares a chart; returns false if the import says that it differs.
fn check(seed: u64) -> bool {
    let mut random = Random(seed);
    let chart = chart(&mut random);
    let states: String =
        (0..chart.len()).filter(|state| chart[*state].parent.is_none()).map(|state| xml(&chart, state)).collect();
    let text = format!("<scxml>\n{states}</scxml>");
    let imported =
        import(&Source::new("chart.scxml", text.as_str()), &[]).unwrap_or_else(|why| panic!("{seed}: {why}\n{text}"));
    let played = Played::of(imported);
    let automaton = Automaton::new(played.chart.chart.clone()).expect("the plan has it");
    let (now, pending, queue) = (Duration::ZERO, Vec::new(), VecDeque::new());
    let mut model = Interpreter { chart: &chart, active: Vec::new(), now, pending, queue, differs: false };
    model.enter(0, None);
    model.settle();
    let mut player = Player::start(&played, &automaton);
    let mut time = Duration::ZERO;
    for number in 0..12_u64 {
        if model.differs {
            return number > 3;
        }
        let leaf = model.active.last().map(|state| format!("s{state}"));
        let leaf: BTreeSet<String> = leaf.into_iter().collect();
        player
            .expect(&leaf)
            .unwrap_or_else(|why| panic!("seed {seed} at {time:?}: {why}\n{text}\n{}", played.imported.text));
        let event = format!("e{}", random.below(3));
        let next = time + Duration::from_nanos(1_000_000 * random.below(2_000) as u64 + 1_013 * (number + 1));
        player.pass(next - time);
        model.pass(next);
        time = next;
        if model.differs {
            return number > 3;
        }
        if let Some(port) = played.port(&event) {
            player.send(Event::message(port));
            player.pass(Duration::ZERO);
        }
        model.queue.push_back(event);
        model.settle();
    }
    true
}

#[test]
fn imported_charts_send_as_an_interpreter_says() {
    let compared = (0..150).filter(|seed| check(*seed)).count();
    assert!(compared > 80, "{compared} of 150 charts were compared");
}

#[test]
#[ignore = "long: 20,000 charts"]
fn many_imported_charts_send_as_an_interpreter_says() {
    let compared = (0..20_000).filter(|seed| check(*seed)).count();
    println!("{compared} of 20000 charts were compared");
}

/// A state that restarts its own timeout: the timer of the region is cancelled on exit and begins again on entry.
#[test]
fn a_timeout_that_is_reset_comes() {
    let text = "<scxml><state id=\"a\"><onentry><send id=\"t\" event=\"tick\" delay=\"2s\"/></onentry>\
                <onexit><cancel sendid=\"t\"/></onexit><transition event=\"reset\" target=\"a\"/>\
                <transition event=\"tick\" target=\"b\"/></state><state id=\"b\"><transition event=\"tick\" target=\"a\"/>\
                <transition event=\"end\" target=\"c\"/></state><final id=\"c\"/></scxml>";
    let played = Played::of(import(&Source::new("chart.scxml", text), &[]).expect("a good chart"));
    let automaton = Automaton::new(played.chart.chart.clone()).expect("the plan has it");
    let mut player = Player::start(&played, &automaton);
    player.pass(Duration::from_secs(1));
    player.send(Event::message(played.port("reset").expect("it comes from outside")));
    player.pass(Duration::from_millis(1_990));
    assert_eq!(player.expect(&["a".to_owned()].into()), Ok(()));
    player.pass(Duration::from_millis(20));
    assert_eq!(player.expect(&["b".to_owned()].into()), Ok(()));
}
