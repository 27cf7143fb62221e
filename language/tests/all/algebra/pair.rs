//! Both interpreters in lock step: every event goes to both, and everything that can be seen must agree.

use super::reference::{self, Config, Event, Machine, Reason, Term};
use super::spec::{SET_ALWAYS, Spec, any};
use language::algebra::{self, Activation, Activity, Cause, Cell, Program, State};
use std::collections::hash_map::{Entry, HashMap};

/// The tags that outcomes carry.
pub(crate) const TAGS: [&str; 3] = ["a", "bc", "d"];

/// The algebra under test together with the reference.
#[derive(Clone, Debug)]
pub(crate) struct Pair<'a> {
    program: &'a Program,
    members: u32,
    traits: Traits,
    pub(crate) state: State,
    pub(crate) machine: Machine,
}

/// The traits of a spec that decide which events are tried.
#[derive(Clone, Copy, Debug)]
struct Traits {
    /// Whether tags are looked at.
    matches: bool,
    /// Whether a stop may be delayed for ever.
    shields_for_ever: bool,
}

impl<'a> Pair<'a> {
    pub(crate) fn new(spec: &Spec, program: &'a Program) -> Self {
        let machine = Machine::new(spec.term.clone(), spec.declared.clone(), vec![SET_ALWAYS]);
        assert_eq!(program.is_service(), machine.is_service(), "inferred service of {spec:?}");
        let members = u32::try_from(spec.declared.len()).expect("a test has few members");
        let traits = Traits {
            matches: any(&spec.term, &|term| matches!(term, Term::Match(_) | Term::Repeat(..))),
            shields_for_ever: any(&spec.term, &|term| matches!(term, Term::Shield(None, _) | Term::Fin(..))),
        };
        Self { program, members, traits, state: State::new(program), machine }
    }

    /// Sends an event to both and compares everything observable. Returns the outcome, or the difference.
    pub(crate) fn send(&mut self, event: &Event) -> Result<Option<reference::Outcome>, String> {
        let outcome = self.feed(event)?;
        self.compare_states().map(|()| outcome)
    }

    /// Sends an event to both and compares the results.
    fn feed(&mut self, event: &Event) -> Result<Option<reference::Outcome>, String> {
        let mut commands = Vec::new();
        let outcome = algebra::step(self.program, &mut self.state, event_of(event), &mut commands);
        let (expected, outcome_expected) = self.machine.handle(event);
        let commands: Vec<_> = commands.iter().map(command).collect();
        let outcome = outcome.map(outcome_of);
        if (&commands, &outcome) != (&expected, &outcome_expected) {
            return Err(format!("{event:?} gives {commands:?} {outcome:?}, not {expected:?} {outcome_expected:?}"));
        }
        Ok(outcome)
    }

    fn compare_states(&self) -> Result<(), String> {
        let (active, stopping) = self.machine.members();
        let with = |activity| (0..self.members).filter(move |&member| self.state.activity(member) == activity);
        let both = active.union(&stopping).copied();
        let same = with(Activity::Active).eq(active.iter().copied())
            && with(Activity::Stopping).eq(stopping.iter().copied())
            && self.state.members_active().eq(both)
            && self.state.is_idle() == self.machine.shape().is_none();
        let armed = self.machine.timers();
        let timers = (0..self.program.timers()).all(|timer| {
            self.state.timer(self.program, timer) == (Activation(self.machine.arm(timer)), armed.contains(&timer))
        });
        let numbers = (0..self.members).all(|member| self.state.activation(member).0 == self.machine.epoch(member));
        if same && timers && numbers { Ok(()) } else { Err(format!("states differ: {self:#?}")) }
    }

    /// Returns the events that a rule of the reference speaks of in this state.
    pub(crate) fn events(&self) -> Vec<Event> {
        let (active, stopping) = self.machine.members();
        let mut events = vec![Event::Start(b"s".to_vec()), Event::Stop];
        for i in active.into_iter().chain(stopping) {
            let endings = endings(i, self.machine.epoch(i));
            if let (true, Event::Done(i, n, value)) = (self.traits.matches, &endings[0]) {
                events.extend(TAGS[..2].iter().map(|tag| Event::Done(*i, *n, tagged(tag, value))));
            }
            events.extend(endings);
        }
        if self.traits.matches {
            events.push(Event::Start(tagged(TAGS[0], b"s")));
        }
        events.extend(self.machine.timers().iter().map(|&timer| Event::Elapsed(timer, self.machine.arm(timer))));
        events
    }

    /// Returns events that are not expected: of earlier and of future activations, of idle members and timers and of
    /// members that do not exist. A single ending of an activation stands for all four.
    pub(crate) fn events_stale(&self) -> Vec<Event> {
        let (active, stopping) = self.machine.members();
        let mut events = Vec::new();
        for i in 0..=self.members {
            let n = self.machine.epoch(i);
            let idle = !active.contains(&i) && !stopping.contains(&i);
            for n in [Some(n).filter(|_| idle), n.checked_sub(1), Some(n + 1)].into_iter().flatten() {
                events.push(endings(i, n)[((i + n) % 4) as usize].clone());
            }
        }
        let armed = self.machine.timers();
        for timer in 0..=self.program.timers() {
            let n = self.machine.arm(timer);
            let current = Some(n).filter(|_| !armed.contains(&timer));
            let numbers = [current, n.checked_sub(1), Some(n + 1)];
            events.extend(numbers.into_iter().flatten().map(|n| Event::Elapsed(timer, n)));
        }
        events
    }

    /// Returns both configurations without activation numbers.
    pub(crate) fn key(&self) -> (Shape, (Vec<Cell>, Vec<usize>)) {
        let (cells, queue) = self.state.configuration();
        (self.machine.shape(), (cells.to_vec(), queue.to_vec()))
    }
}

/// The reference's configuration.
type Shape = Option<(Config, Vec<u32>)>;

/// Returns a value with a tag.
pub(crate) fn tagged(tag: &str, value: &[u8]) -> Vec<u8> {
    [&[u8::try_from(tag.len()).expect("a tag of a test is short")], tag.as_bytes(), value].concat()
}

fn endings(i: u32, n: u32) -> [Event; 4] {
    let value = vec![b'0' + u8::try_from(i).expect("a test has few members")];
    [Event::Done(i, n, value.clone()), Event::Aborted(i, n, value), Event::Stopped(i, n), Event::Unconfirmed(i, n)]
}

/// The figures of an exploration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Figures {
    pub(crate) states: u64,
    pub(crate) events: u64,
}

/// Explores the product of both interpreters with every event in every state. That nothing ever differs makes the pairs
/// that are reached a bisimulation. Also checked: a state represents one configuration, a stale event changes nothing,
/// at an outcome nothing runs (T4), and a stop issued here converges (T5).
pub(crate) fn explore(spec: &Spec) -> Result<Figures, String> {
    let program = Program::compile(&spec.group());
    let first = Pair::new(spec, &program);
    let mut figures = Figures { states: 1, events: 0 };
    let (shape, cells) = first.key();
    let mut shapes = HashMap::from([(cells, shape)]);
    let mut todo = vec![first];
    while let Some(pair) = todo.pop() {
        let mut unchanged = pair.clone();
        for event in pair.events_stale() {
            unchanged.feed(&event)?;
            figures.events += 1;
        }
        if unchanged.state != pair.state || unchanged.machine != pair.machine {
            return Err(format!("a stale event changes {pair:#?}"));
        }
        figures.events += converge(pair.clone())?;
        for event in pair.events() {
            let mut next = pair.clone();
            let outcome = next.send(&event)?;
            figures.events += 1;
            if outcome.is_some() != next.state.is_idle() {
                return Err(format!("{event:?} gives {outcome:?} in {next:#?}"));
            }
            let (shape, cells) = next.key();
            match shapes.entry(cells) {
                Entry::Occupied(known) if *known.get() == shape => {}
                Entry::Occupied(known) => return Err(format!("one state stands for {known:?} and {shape:?}")),
                Entry::Vacant(new) => {
                    new.insert(shape);
                    figures.states += 1;
                    todo.push(next);
                }
            }
        }
    }
    Ok(figures)
}

/// The number of events to wait for when a stop may be delayed for ever.
const PATIENCE: usize = 40;

/// T5: stops the group, lets the time of shields run out, and confirms for every leaf that is stopping. Returns how
/// many events it took. Members that only a shield without a bound holds up are given a chance to end.
pub(crate) fn converge(mut pair: Pair<'_>) -> Result<u64, String> {
    let mut outcome = pair.feed(&Event::Stop)?;
    let mut sent = 1;
    while let (None, Some(&timer)) = (&outcome, pair.machine.bounds().first()) {
        outcome = pair.feed(&Event::Elapsed(timer, pair.machine.arm(timer)))?;
        sent += 1;
    }
    if pair.traits.shields_for_ever {
        for _ in 0..PATIENCE {
            let Some(event) = pair.ending().filter(|_| outcome.is_none()) else { break };
            outcome = pair.feed(&event)?;
            sent += 1;
        }
        if outcome.is_none() {
            return Ok(sent);
        }
    }
    let (active, stopping) = pair.machine.members();
    if !active.is_empty() || !pair.machine.timers().is_empty() {
        return Err(format!("after a stop something goes on: {pair:#?}"));
    }
    for member in stopping {
        if outcome.is_some() {
            return Err(format!("{outcome:?} before member {member} has stopped"));
        }
        outcome = pair.feed(&Event::Stopped(member, pair.machine.epoch(member)))?;
        sent += 1;
    }
    match outcome {
        Some(reference::Outcome::Killed | reference::Outcome::Aborted(Reason::Unconfirmed(_))) => Ok(sent),
        Some(reference::Outcome::Done(_) | reference::Outcome::Aborted(_)) | None => {
            Err(format!("a stop ends with {outcome:?}"))
        }
    }
}

impl Pair<'_> {
    /// Returns an event that brings a group that is stopping nearer to its end.
    fn ending(&self) -> Option<Event> {
        let (active, stopping) = self.machine.members();
        let with = |member: u32| (member, self.machine.epoch(member));
        let stopped = stopping.first().map(|&member| with(member)).map(|(i, n)| Event::Stopped(i, n));
        let failed = active.first().map(|&member| with(member)).map(|(i, n)| Event::Aborted(i, n, vec![]));
        let bounds = self.machine.bounds();
        let timers = self.machine.timers();
        let timer = bounds.first().or(timers.first());
        stopped.or(failed).or(timer.map(|&timer| Event::Elapsed(timer, self.machine.arm(timer))))
    }
}

pub(crate) fn event_of(event: &Event) -> algebra::Event {
    let value = |bytes: &[u8]| algebra::Value::new(bytes);
    match *event {
        Event::Start(ref v) => algebra::Event::Start(value(v)),
        Event::Stop => algebra::Event::Stop,
        Event::Done(member, n, ref v) => algebra::Event::Done { member, activation: Activation(n), value: value(v) },
        Event::Aborted(member, n, ref v) => {
            algebra::Event::Aborted { member, activation: Activation(n), report: value(v) }
        }
        Event::Stopped(member, n) => algebra::Event::Stopped { member, activation: Activation(n) },
        Event::Unconfirmed(member, n) => algebra::Event::StopUnconfirmed { member, activation: Activation(n) },
        Event::Elapsed(timer, n) => algebra::Event::Elapsed { timer, activation: Activation(n) },
        Event::Granted(_) => unreachable!("a group grants by itself"),
    }
}

pub(crate) fn command(command: &algebra::Command) -> reference::Command {
    use reference::Command;
    match *command {
        algebra::Command::Connect { set } => Command::Connect(set),
        algebra::Command::Disconnect { set } => Command::Disconnect(set),
        algebra::Command::Activate { member, activation, ref value } => {
            Command::Activate(member, activation.0, value.bytes().to_vec())
        }
        algebra::Command::Stop { member, activation } => Command::Stop(member, activation.0),
        algebra::Command::Arm { timer, activation, after } => {
            assert_eq!(after.as_secs(), 1, "every timer of a test runs 1 s");
            Command::Arm(timer, activation.0)
        }
        algebra::Command::Cancel { timer, activation } => Command::Cancel(timer, activation.0),
        algebra::Command::Send { .. } | algebra::Command::Log { .. } | algebra::Command::Lost { .. } => {
            unreachable!("only an activity gives it")
        }
    }
}

pub(crate) fn outcome_of(outcome: algebra::Outcome) -> reference::Outcome {
    match outcome {
        algebra::Outcome::Done(value) => reference::Outcome::Done(value.bytes().to_vec()),
        algebra::Outcome::Stopped => reference::Outcome::Killed,
        algebra::Outcome::Aborted(reason) => {
            let instant = reason.cause == Cause::Failed("a round of a loop took no time".into());
            reference::Outcome::Aborted(match (reason.member, reason.cause) {
                (Some(i), Cause::Reported(value)) => Reason::Reported(i, value.bytes().to_vec()),
                (Some(i), Cause::Busy) => Reason::Busy(i),
                (Some(i), Cause::StopUnconfirmed) => Reason::Unconfirmed(i),
                (Some(i), Cause::ServiceEnded) => Reason::ServiceEnded(i),
                (None, Cause::Failed(_)) if instant => Reason::Instant,
                (None, Cause::Failed(why)) => Reason::Failed(why.to_string()),
                (None, Cause::NoMatch) => Reason::NoMatch,
                (member, cause) => panic!("a reason of {member:?} that is {cause:?}"),
            })
        }
    }
}
