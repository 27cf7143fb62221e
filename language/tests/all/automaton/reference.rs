//! A second interpreter of activities, for tests alone, written from `docs/src/inside/automaton.md`.
//!
//! It shares the chart, the events and the commands with `language::automaton`, and nothing else. A configuration is a
//! set of states, each question is asked of the whole set, entries are a recursion over the tree, and which transitions
//! conflict is decided by the definition and not by an algorithm.

mod place;

use self::place::Place;
use super::charts::{COPY, ENDLESS, SUM, THROW};
use language::algebra::{Activation, Cause, Outcome, Reason, Value};
use language::automaton::{Action, Chart, Command, Event, Fragment, StateKind, Target, Trigger, ValueSource};
use language::script::{ScriptError, ScriptErrorKind};
use std::collections::{BTreeMap, BTreeSet};

type Set = BTreeSet<usize>;
/// States or transitions with the numbers of their activations.
type Numbered = Vec<(usize, u32)>;

/// An event, as an activity hears it.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Heard {
    Always,
    Message(usize, Vec<usize>, Value),
    Signal(usize),
    Notice(usize),
    Done(usize, Value),
    Aborted(usize, Reason),
    Complete(usize),
    Timer(usize),
}

/// One activity.
#[derive(Clone, Debug)]
pub(super) struct Machine<'a> {
    chart: &'a Chart,
    pub(super) active: Set,
    fresh: Set,
    pub(super) variables: Vec<i32>,
    pub(super) slots: Vec<Value>,
    memories: BTreeMap<usize, Set>,
    running: Set,
    stopping: Set,
    armed: Set,
    numbers: BTreeMap<(char, usize), u32>,
    raised: Vec<Heard>,
    queue: Vec<(u32, Heard)>,
    wait: Option<Wait>,
    error: Option<Reason>,
    commands: Vec<Command>,
    /// How many scripts have run in this reaction.
    scripts: usize,
}

#[derive(Clone, Debug)]
struct Wait {
    /// The work that follows: transitions, or the end.
    then: Result<(Vec<usize>, Value), Outcome>,
    unconfirmed: Option<Reason>,
}

impl<'a> Machine<'a> {
    pub(super) fn new(chart: &'a Chart) -> Self {
        Self {
            chart,
            active: Set::new(),
            fresh: Set::new(),
            variables: chart.variables.iter().map(|variable| variable.initial).collect(),
            slots: vec![Value::EMPTY; chart.slots],
            memories: BTreeMap::new(),
            running: Set::new(),
            stopping: Set::new(),
            armed: Set::new(),
            numbers: BTreeMap::new(),
            raised: vec![],
            queue: vec![],
            wait: None,
            error: None,
            commands: vec![],
            scripts: 0,
        }
    }

    fn place(&self) -> Place<'_> {
        Place { chart: self.chart, active: &self.active, variables: &self.variables, memories: &self.memories }
    }

    /// Returns the runs and timers that an event may be about now, with their numbers.
    pub(super) fn pending(&self) -> (Numbered, Numbered) {
        let numbered = |kind: char, of: usize| (of, self.numbers[&(kind, of)]);
        let runs = self.running.union(&self.stopping).map(|&state| numbered('r', state));
        (runs.collect(), self.armed.iter().map(|&transition| numbered('t', transition)).collect())
    }

    /// Takes an event.
    pub(super) fn handle(&mut self, event: Event) -> (Vec<Command>, Option<Outcome>) {
        self.scripts = 0;
        let outcome = self.react(event);
        (std::mem::take(&mut self.commands), outcome)
    }

    /// A timer has run out.
    fn ran_out(&mut self, transition: usize, activation: Activation) -> Option<Outcome> {
        let is_current = self.numbers.get(&('t', transition)) == Some(&activation.0);
        if !is_current || !self.armed.remove(&transition) {
            return None;
        }
        if matches!(self.chart.transitions[transition].trigger, Trigger::Every(_)) {
            self.arm(transition);
        }
        // One tick that waits is enough.
        let is_waiting = self.queue.iter().any(|(_, heard)| *heard == Heard::Timer(transition));
        if is_waiting { None } else { self.hear(1000, Heard::Timer(transition)) }
    }

    fn react(&mut self, event: Event) -> Option<Outcome> {
        let is_idle = self.active.is_empty();
        match event {
            Event::Start(value) if is_idle => {
                let numbers = std::mem::take(&mut self.numbers);
                *self = Machine { numbers, ..Machine::new(self.chart) };
                let mut states = self.place().begun(0, &Set::new());
                states.insert(0);
                self.enter(&states, &value);
                self.run_on()
            }
            Event::Stop if is_idle => Some(Outcome::Stopped),
            _ if is_idle => None,
            Event::Overrun => {
                let names = self
                    .place()
                    .leaves()
                    .into_iter()
                    .take(8)
                    .map(|state| format!("`{}`", self.chart.states[state].name));
                let names: Vec<String> = names.collect();
                let why = "the activity loops for ever, because its runs end at once: it is in";
                self.end(Outcome::Aborted(failed(&format!("{why} {}", names.join(", ")))))
            }
            Event::Start(_) => None,
            Event::Stop => self.end(Outcome::Stopped),
            Event::Ended { state, activation, outcome } => {
                let is_current = self.numbers.get(&('r', state)) == Some(&activation.0);
                if is_current && self.stopping.remove(&state) {
                    return self.stopped(outcome);
                }
                if !is_current || !self.running.remove(&state) {
                    return None;
                }
                self.hear(
                    1000,
                    match outcome {
                        Outcome::Done(value) => Heard::Done(state, value),
                        Outcome::Aborted(reason) => Heard::Aborted(state, reason),
                        Outcome::Stopped => Heard::Aborted(state, failed("it stopped without an order")),
                    },
                )
            }
            Event::Elapsed { transition, activation } => self.ran_out(transition, activation),
            Event::Message { port, filters, priority, value } => {
                let outcome = self.hear(u32::from(priority), Heard::Message(port, filters, value));
                let of_port = |(place, (_, heard)): (usize, &(u32, Heard))| match heard {
                    Heard::Message(other, ..) if *other == port => Some(place),
                    _ => None,
                };
                let places: Vec<usize> = self.queue.iter().enumerate().filter_map(of_port).collect();
                if places.len() > self.chart.ports[port] {
                    self.queue.remove(places[places.len() - 1]);
                    self.commands.push(Command::Lost { port });
                }
                outcome
            }
            Event::Notice(notice) => {
                let heard = Heard::Notice(notice);
                if self.queue.iter().any(|(_, other)| *other == heard) { None } else { self.hear(1000, heard) }
            }
        }
    }

    /// The queue is sorted by priority, then by arrival.
    fn hear(&mut self, priority: u32, heard: Heard) -> Option<Outcome> {
        self.queue.push((priority, heard));
        self.queue.sort_by_key(|(priority, _)| std::cmp::Reverse(*priority));
        if self.wait.is_none() { self.run_on() } else { None }
    }

    fn stopped(&mut self, outcome: Outcome) -> Option<Outcome> {
        let wait = self.wait.as_mut().expect("a run stops because something waits for it");
        if let Outcome::Aborted(reason @ Reason { cause: Cause::StopUnconfirmed, .. }) = outcome {
            wait.unconfirmed = wait.unconfirmed.take().or(Some(reason));
        }
        if !self.stopping.is_empty() {
            return None;
        }
        let Wait { then, unconfirmed } = self.wait.take().expect("it is there");
        match (then, unconfirmed) {
            (Ok((chosen, value)), None) => self.carry_out(&chosen, &value).or_else(|| self.run_on()),
            (Ok(_), Some(reason)) => self.end(Outcome::Aborted(reason)),
            (Err(outcome), None) => Some(self.over(outcome)),
            (Err(_), Some(reason)) => Some(self.over(Outcome::Aborted(reason))),
        }
    }

    /// Everything that needs no further event.
    fn run_on(&mut self) -> Option<Outcome> {
        loop {
            let mut seen = vec![];
            while self.wait.is_none() {
                if let Some(reason) = self.error.take() {
                    return self.end(Outcome::Aborted(reason));
                }
                if self.place().has_completed(0) {
                    return self.end(Outcome::Done(Value::EMPTY));
                }
                let always = self.place().taken(&Heard::Always);
                if always.is_empty() && self.raised.is_empty() {
                    break;
                }
                let now = (self.raised.clone(), self.variables.clone(), self.active.clone(), self.memories.clone());
                if seen.iter().any(|(before, _)| *before == now) {
                    let sources =
                        seen.iter().skip_while(|(before, _)| *before != now).filter_map(|(_, source)| *source);
                    let reason = failed(&self.turning(&sources.collect::<Vec<usize>>()));
                    return self.end(Outcome::Aborted(reason));
                }
                if seen.len() >= 256 || self.raised.len() > 256 {
                    let why = "the activity made 256 steps without an event, or raised too many signals";
                    return self.end(Outcome::Aborted(failed(why)));
                }
                let chosen = if always.is_empty() {
                    let oldest = self.raised.remove(0);
                    self.place().taken(&oldest)
                } else {
                    always
                };
                seen.push((now, chosen.first().map(|&number| self.chart.transitions[number].source)));
                if let Some(outcome) = self.change(chosen, Value::EMPTY) {
                    return Some(outcome);
                }
            }
            if self.wait.is_some() {
                return None;
            }
            self.begin_fresh();
            if self.queue.is_empty() {
                return None;
            }
            let (_, heard) = self.queue.remove(0);
            if let Some(outcome) = self.listen(heard) {
                return Some(outcome);
            }
        }
    }

    fn listen(&mut self, heard: Heard) -> Option<Outcome> {
        let chosen = self.place().taken(&heard);
        let tagged =
            chosen.iter().any(|&number| matches!(self.chart.transitions[number].trigger, Trigger::Done(Some(_))));
        let value = match heard {
            Heard::Aborted(_, reason) if chosen.is_empty() => return self.end(Outcome::Aborted(reason)),
            Heard::Message(_, _, value) => value,
            Heard::Done(_, value) if tagged => Value::new(&value.bytes()[value.tag().map_or(0, str::len) + 1..]),
            Heard::Done(_, value) => value,
            _ => Value::EMPTY,
        };
        self.change(chosen, value)
    }

    fn turning(&self, sources: &[usize]) -> String {
        let names: Vec<String> = sources.iter().map(|&state| format!("`{}`", self.chart.states[state].name)).collect();
        let shown = if names.len() > 8 { names[..8].to_vec() } else { names.clone() };
        let last = if names.len() > 8 || names.is_empty() { "…".to_owned() } else { names[0].clone() };
        let all: Vec<String> = shown.into_iter().chain([last]).collect();
        format!("the activity loops for ever without an event: {}", all.join(" → "))
    }

    fn change(&mut self, chosen: Vec<usize>, value: Value) -> Option<Outcome> {
        let exits = self.place().left(&chosen);
        if self.stop_runs(&exits) {
            self.wait = Some(Wait { then: Ok((chosen, value)), unconfirmed: None });
            return None;
        }
        self.carry_out(&chosen, &value)
    }

    fn stop_runs(&mut self, states: &Set) -> bool {
        for &state in states.iter().rev() {
            if self.running.remove(&state) {
                self.stopping.insert(state);
                let activation = Activation(self.numbers[&('r', state)]);
                self.commands.push(Command::Stop { state, activation });
            }
        }
        !self.stopping.is_empty()
    }

    fn end(&mut self, outcome: Outcome) -> Option<Outcome> {
        let unconfirmed = self.wait.take().and_then(|wait| wait.unconfirmed);
        if self.stop_runs(&self.active.clone()) {
            self.wait = Some(Wait { then: Err(outcome), unconfirmed });
            return None;
        }
        Some(self.over(unconfirmed.map_or(outcome, Outcome::Aborted)))
    }

    fn over(&mut self, outcome: Outcome) -> Outcome {
        self.exit(&self.active.clone());
        let (error, _, _) = (self.error.take(), std::mem::take(&mut self.queue), std::mem::take(&mut self.raised));
        if let (Outcome::Done(_), Some(reason)) = (&outcome, error) { Outcome::Aborted(reason) } else { outcome }
    }

    fn carry_out(&mut self, chosen: &[usize], value: &Value) -> Option<Outcome> {
        let exits = self.place().left(chosen);
        let leaves = self.place().leaves();
        let domains: Vec<usize> = chosen.iter().map(|&number| self.place().domain(number)).collect();
        self.memories.extend(self.place().recalled(&exits));
        let mut entries = Set::new();
        for (&number, domain) in chosen.iter().zip(domains) {
            let targets = self.place().leads_to(number);
            if !targets.is_empty() {
                entries.extend(self.place().begun(domain, &targets));
            }
        }
        let left = leaves.intersection(&exits).copied().collect();
        self.memories.extend(self.place().suspending(&left, &entries));
        self.exit(&exits);
        let mut ends = vec![];
        for &number in chosen {
            let transition = &self.chart.transitions[number];
            self.act(&transition.actions, value);
            match &transition.target {
                Target::Done(source) => ends.push(Outcome::Done(self.value(source, value))),
                Target::Abort(why) => ends.push(Outcome::Aborted(failed(why))),
                Target::Stay | Target::States(_) | Target::Resume => {}
            }
        }
        if let Some(outcome) = ends.into_iter().next() {
            return Some(self.over(outcome));
        }
        self.enter(&entries, value);
        None
    }

    fn exit(&mut self, states: &Set) {
        for &state in states.iter().rev() {
            let of_state = |number: &usize| self.chart.transitions[*number].source == state;
            for number in self.armed.clone().into_iter().filter(of_state) {
                self.armed.remove(&number);
                let activation = Activation(self.numbers[&('t', number)]);
                self.commands.push(Command::Cancel { transition: number, activation });
            }
            let chart = self.chart;
            let about = |heard: &Heard| match heard {
                Heard::Done(of, _) | Heard::Aborted(of, _) | Heard::Complete(of) => *of == state,
                Heard::Timer(number) => chart.transitions[*number].source == state,
                Heard::Always | Heard::Message(..) | Heard::Signal(_) | Heard::Notice(_) => false,
            };
            self.queue.retain(|(_, heard)| !about(heard));
            self.raised.retain(|heard| !about(heard));
            self.act(&chart.states[state].exit, &Value::EMPTY);
            self.active.remove(&state);
            self.fresh.remove(&state);
        }
    }

    fn enter(&mut self, states: &Set, value: &Value) {
        for &state in states {
            self.active.insert(state);
            self.fresh.insert(state);
            self.act(&self.chart.states[state].entry, value);
            if self.chart.states[state].kind == StateKind::Final {
                let mut around = self.chart.states[state].parent;
                let mut is_first = true;
                while let Some(parent) = around {
                    let is_parallel = self.chart.states[parent].kind == StateKind::Parallel;
                    if !(is_first || is_parallel && self.place().has_completed(parent)) {
                        break;
                    }
                    self.raised.push(Heard::Complete(parent));
                    (around, is_first) = (self.chart.states[parent].parent, false);
                }
            }
        }
    }

    fn begin_fresh(&mut self) {
        for state in std::mem::take(&mut self.fresh) {
            for (number, transition) in self.chart.transitions.iter().enumerate() {
                if transition.source == state && matches!(transition.trigger, Trigger::After(_) | Trigger::Every(_)) {
                    self.arm(number);
                }
            }
            if let Some(source) = &self.chart.states[state].run {
                let value = self.value(source, &Value::EMPTY);
                self.running.insert(state);
                let activation = self.next('r', state);
                self.commands.push(Command::Run { state, activation, value });
            }
        }
    }

    fn arm(&mut self, number: usize) {
        if let Trigger::After(after) | Trigger::Every(after) = self.chart.transitions[number].trigger {
            self.armed.insert(number);
            let activation = self.next('t', number);
            self.commands.push(Command::Arm { transition: number, activation, after });
        }
    }

    fn next(&mut self, kind: char, of: usize) -> Activation {
        let number = self.numbers.entry((kind, of)).or_default();
        *number += 1;
        Activation(*number)
    }

    fn act(&mut self, actions: &[Action], event: &Value) {
        for action in actions {
            match action {
                Action::Assign { variable, formula } => {
                    let (value, declared) = (self.place().number(formula), &self.chart.variables[*variable]);
                    if value < i64::from(declared.min) || value > i64::from(declared.max) {
                        let (name, min, max) = (&declared.name, declared.min, declared.max);
                        let why = format!("`{name}` would be {value}, which is outside {min}..{max}");
                        self.error = self.error.take().or(Some(failed(&why)));
                        return;
                    }
                    self.variables[*variable] = i32::try_from(value).expect("it is in the range");
                }
                Action::Keep { slot, value } => self.slots[*slot] = self.value(value, event),
                Action::Raise(signal) => self.raised.push(Heard::Signal(*signal)),
                Action::Send { output, value } => {
                    let value = self.value(value, event);
                    self.commands.push(Command::Send { output: *output, value });
                }
                Action::Log(fragments) => self.commands.push(Command::Log(self.line(fragments))),
                Action::Compute { slot, script } => match self.computed(&self.chart.scripts[*script].text) {
                    Ok(value) => self.slots[*slot] = value,
                    Err((kind, why)) => {
                        let cause = Cause::Script(ScriptError { kind, why: why.into() });
                        self.error = self.error.take().or(Some(Reason { member: None, cause }));
                        return;
                    }
                },
            }
        }
    }

    /// Returns the result of one of the scripts of random charts.
    fn computed(&mut self, script: &str) -> Result<Value, (ScriptErrorKind, &'static str)> {
        if self.scripts == 4 {
            return Err((ScriptErrorKind::Budget, "more than 4 scripts in one reaction"));
        }
        self.scripts += 1;
        match script {
            SUM => Ok(Value::new(&f64::from(self.variables[0] * 2 + self.variables[1]).to_le_bytes())),
            COPY if self.slots[0].bytes().len() == 8 => Ok(self.slots[0].clone()),
            COPY if self.slots[0].bytes().is_empty() => {
                Err((ScriptErrorKind::Failed, "`s` is of type `Number`, so it needs a number, not `()`"))
            }
            COPY => Err((ScriptErrorKind::Failed, "the bytes of `s0` are not a value of its type")),
            THROW => Err((ScriptErrorKind::Failed, "line 1 of the script: runtime error: no")),
            ENDLESS => Err((ScriptErrorKind::Budget, "line 2 of the script: more than 8 calls inside each other")),
            other => panic!("no random chart has the script `{other}`"),
        }
    }

    fn line(&self, fragments: &[Fragment]) -> String {
        let mut line = String::new();
        for fragment in fragments {
            line += &match fragment {
                Fragment::Text(text) => text.clone(),
                Fragment::Number(formula) => self.place().number(formula).to_string(),
                Fragment::Name(formula, names) => {
                    let number = self.place().number(formula);
                    let name = names.iter().zip(0..).find(|(_, other)| *other == number);
                    name.map_or_else(|| number.to_string(), |(name, _)| name.clone())
                }
            };
        }
        line
    }

    fn value(&self, source: &ValueSource, event: &Value) -> Value {
        match source {
            ValueSource::Constant(value) => value.clone(),
            ValueSource::Slot(slot) => self.slots[*slot].clone(),
            ValueSource::Event => event.clone(),
            ValueSource::Tagged { tag, of } => {
                let mut bytes = vec![u8::try_from(tag.len()).expect("a name is short")];
                bytes.extend(tag.as_bytes());
                bytes.extend(self.value(of, event).bytes());
                Value::new(&bytes)
            }
            ValueSource::Text(fragments) => {
                let line = self.line(fragments);
                Value::new(&[&[u8::try_from(line.len()).expect("a name is short")], line.as_bytes()].concat())
            }
            #[expect(clippy::cast_precision_loss, reason = "the numbers of the charts are small")]
            ValueSource::Number(formula) => Value::new(&(self.place().number(formula) as f64).to_le_bytes()),
        }
    }
}

fn failed(why: &str) -> Reason {
    Reason { member: None, cause: Cause::Failed(why.into()) }
}
