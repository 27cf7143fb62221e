//! The transition function of an activity. Comments name the rules in `docs/src/inside/automaton.md`.

use super::action::{carry_out, failed, value_of};
use super::chart::{Target, Transition, Trigger};
use super::configuration::{Configuration, Pending};
use super::enter::{effective_targets, entry_set};
use super::event::{Command, Event};
use super::leave::{remember, suspend};
use super::select::{Cue, exit_set, select};
use super::shape::Automaton;
use crate::algebra::{Activation, Activity, Cause, Outcome, Reason, Value};
use std::collections::{BTreeSet, VecDeque};
use std::hash::{DefaultHasher, Hash, Hasher};

/// The largest number of steps between configurations in one reaction.
const STEPS_MAX: usize = 256;
/// The largest number of signals and completions that may wait.
const RAISED_MAX: usize = 256;
/// The largest number of states that the reason of a livelock names.
const NAMES_MAX: usize = 8;
/// The priority of ends, timers and notices: above all messages.
const OWN: u16 = 256;

/// Takes one event and appends the resulting commands to `commands` in order. Returns the outcome if the activity ends.
///
/// `configuration` must have been made for `automaton`. After an outcome, the activity can be started again, and the
/// numbers of activations continue. An event with an old number is dropped. A running activity drops `Start`. An idle
/// activity drops all events but `Start` and `Stop`, and answers `Stop` with `Stopped` at once.
///
/// # Panics
/// If `configuration` was made for another automaton.
pub fn step(
    automaton: &Automaton,
    configuration: &mut Configuration,
    event: Event,
    commands: &mut Vec<Command>,
) -> Option<Outcome> {
    let mut reaction = Reaction { automaton, configuration, commands };
    if reaction.configuration.is_idle() {
        return match event {
            Event::Start(value) => reaction.start(&value),
            Event::Stop => Some(Outcome::Stopped),
            Event::Ended { .. } | Event::Elapsed { .. } | Event::Message { .. } | Event::Notice(_) | Event::Overrun => {
                None
            }
        };
    }
    match event {
        Event::Start(_) => None,
        Event::Stop => reaction.end(Outcome::Stopped),
        Event::Overrun => reaction.overrun(),
        Event::Ended { state, activation, outcome } => reaction.ended(state, activation, outcome),
        Event::Elapsed { transition, activation } => reaction.elapsed(transition, activation),
        Event::Message { port, filters, priority, value } => {
            reaction.message(port, priority, Cue::Message { port, filters, value })
        }
        Event::Notice(notice) => {
            // A notice that already waits says everything: a second one would only need more memory.
            let waits = |cue: &Cue| *cue == Cue::Notice(notice);
            if reaction.configuration.queue.iter().any(|queued| waits(&queued.cue)) {
                return None;
            }
            reaction.receive(OWN, Cue::Notice(notice))
        }
    }
}

/// One event being processed to completion.
struct Reaction<'a> {
    automaton: &'a Automaton,
    configuration: &'a mut Configuration,
    commands: &'a mut Vec<Command>,
}

/// The part of a configuration that decides the rest of a reaction (rule 44).
#[derive(PartialEq)]
struct Snapshot {
    /// A hash of the other fields. It differs for most different snapshots, so comparisons are quick.
    digest: u64,
    active: Vec<bool>,
    variables: Vec<i32>,
    memories: Vec<Vec<usize>>,
    raised: VecDeque<Cue>,
}

impl Reaction<'_> {
    fn start(&mut self, value: &Value) -> Option<Outcome> {
        self.configuration.reset(self.automaton);
        let mut entered = entry_set(self.automaton, self.configuration, 0, &[]);
        entered.insert(0);
        self.enter(&entered, value);
        self.go_on()
    }

    /// Takes the end of a run, by rules 46 to 49.
    fn ended(&mut self, state: usize, activation: Activation, outcome: Outcome) -> Option<Outcome> {
        let run = self.configuration.runs.get_mut(state).filter(|run| run.activation == activation)?;
        match std::mem::replace(&mut run.activity, Activity::Idle) {
            Activity::Idle => None,
            Activity::Active => self.receive(OWN, cue_of(state, outcome)),
            Activity::Stopping => {
                if let (Some(pending), Outcome::Aborted(reason)) = (&mut self.configuration.pending, outcome)
                    && reason.cause == Cause::StopUnconfirmed
                {
                    pending.unconfirmed.get_or_insert(reason);
                }
                if self.configuration.awaits_runs() { None } else { self.resume() }
            }
        }
    }

    /// The runs of the activity end at once, again and again, so the activity is aborted. The reason names the active
    /// states.
    fn overrun(&mut self) -> Option<Outcome> {
        let leaves: Vec<usize> = self.configuration.leaves(self.automaton).take(NAMES_MAX).collect();
        let names: Vec<String> =
            leaves.iter().map(|&state| format!("`{}`", self.automaton.chart().states[state].name)).collect();
        let why = format!("the activity loops for ever, because its runs end at once: it is in {}", names.join(", "));
        self.end(Outcome::Aborted(failed(&why)))
    }

    /// Takes a message, by rule 51.
    fn message(&mut self, port: usize, priority: u8, cue: Cue) -> Option<Outcome> {
        let limit = *self.automaton.chart().ports.get(port)?;
        let outcome = self.receive(u16::from(priority), cue);
        let queue = &mut self.configuration.queue;
        if queue.iter().filter(|queued| queued.is_at(port)).count() > limit
            && let Some(last) = queue.iter().rposition(|queued| queued.is_at(port))
        {
            queue.remove(last);
            self.commands.push(Command::Lost { port });
        }
        outcome
    }

    /// Queues an event, by rule 50, and reacts to it unless a transition waits.
    fn receive(&mut self, priority: u16, cue: Cue) -> Option<Outcome> {
        self.configuration.enqueue(priority, cue);
        if self.configuration.pending.is_some() { None } else { self.go_on() }
    }

    /// Takes the end of a timer, by rules 71 and 72.
    fn elapsed(&mut self, transition: usize, activation: Activation) -> Option<Outcome> {
        let timer = self.configuration.timers.get_mut(transition)?;
        if !timer.is_armed || timer.activation != activation {
            return None;
        }
        timer.is_armed = false;
        if let Trigger::Every(_) = self.automaton.transition(transition).trigger {
            self.arm(transition);
        }
        let tick = Cue::Timer(transition);
        let waits = self.configuration.queue.iter().any(|queued| queued.cue == tick);
        if waits { None } else { self.receive(OWN, tick) }
    }

    /// Continues after every run that had to end has ended.
    fn resume(&mut self) -> Option<Outcome> {
        let pending = self.configuration.pending.take()?;
        if let Some(reason) = pending.unconfirmed {
            let is_ending = pending.ending.is_some();
            let outcome = Outcome::Aborted(reason);
            return if is_ending { Some(self.finish(outcome)) } else { self.end(outcome) };
        }
        if let Some(outcome) = pending.ending {
            return Some(self.finish(outcome));
        }
        self.perform(&pending.chosen, &pending.value).or_else(|| self.go_on())
    }

    /// Reacts to the events in the queue until the queue is empty or a transition has to wait (rule 36).
    fn go_on(&mut self) -> Option<Outcome> {
        loop {
            if let Some(outcome) = self.turn() {
                return Some(outcome);
            }
            if self.configuration.pending.is_some() {
                return None;
            }
            self.settle();
            if self.configuration.queue.is_empty() {
                return None;
            }
            let cue = self.configuration.queue.remove(0).cue;
            if let Some(outcome) = self.take(cue) {
                return Some(outcome);
            }
            if self.configuration.pending.is_some() {
                return None;
            }
        }
    }

    /// Takes `always` transitions, signals and completions until there are none (rule 37).
    fn turn(&mut self) -> Option<Outcome> {
        let mut trail: Vec<(Snapshot, Option<usize>)> = Vec::new();
        loop {
            if let Some(reason) = self.configuration.error.take() {
                return self.end(Outcome::Aborted(reason));
            }
            if self.automaton.is_complete(self.configuration, 0) {
                return self.end(Outcome::Done(Value::EMPTY));
            }
            let mut chosen = select(self.automaton, self.configuration, &Cue::Always);
            if chosen.is_empty() && self.configuration.raised.is_empty() {
                return None;
            }
            let snapshot = self.snapshot();
            let first = trail.iter().position(|(other, _)| *other == snapshot);
            let is_full = trail.len() >= STEPS_MAX || snapshot.raised.len() > RAISED_MAX;
            if first.is_some() || is_full {
                return self.end(Outcome::Aborted(self.livelock(&trail, first)));
            }
            let cue = if chosen.is_empty() { self.configuration.raised.pop_front()? } else { Cue::Always };
            if cue != Cue::Always {
                chosen = select(self.automaton, self.configuration, &cue);
            }
            let source = chosen.first().map(|&number| self.automaton.transition(number).source);
            trail.push((snapshot, source));
            if let Some(outcome) = self.change(chosen, Value::EMPTY) {
                return Some(outcome);
            }
            if self.configuration.pending.is_some() {
                return None;
            }
        }
    }

    /// Takes one event from the queue.
    fn take(&mut self, cue: Cue) -> Option<Outcome> {
        let chosen = select(self.automaton, self.configuration, &cue);
        match cue {
            // Without a transition for the abort, the activity ends (rule 27).
            Cue::Aborted { reason, .. } if chosen.is_empty() => self.end(Outcome::Aborted(reason)),
            Cue::Always
            | Cue::Message { .. }
            | Cue::Signal(_)
            | Cue::Notice(_)
            | Cue::Done { .. }
            | Cue::Aborted { .. }
            | Cue::Complete(_)
            | Cue::Timer(_) => {
                let value = cue.value(self.automaton, &chosen);
                self.change(chosen, value)
            }
        }
    }

    /// Steps from one configuration to the next (rule 38): at once, or after the runs of the left states have ended.
    fn change(&mut self, chosen: Vec<usize>, value: Value) -> Option<Outcome> {
        let exits = self.exits(&chosen);
        if self.stop(&exits) {
            self.configuration.pending = Some(Pending { chosen, value, ending: None, unconfirmed: None });
            return None;
        }
        self.perform(&chosen, &value)
    }

    fn exits(&self, chosen: &[usize]) -> BTreeSet<usize> {
        let transitions = chosen.iter().map(|&number| self.automaton.transition(number));
        transitions.flat_map(|transition| exit_set(self.automaton, self.configuration, transition)).collect()
    }

    /// Stops the runs of these states (rule 47). Returns whether any run has to end first.
    fn stop(&mut self, exits: &BTreeSet<usize>) -> bool {
        for &state in exits.iter().rev() {
            let run = &mut self.configuration.runs[state];
            if run.activity == Activity::Active {
                run.activity = Activity::Stopping;
                self.commands.push(Command::Stop { state, activation: run.activation });
            }
        }
        self.configuration.awaits_runs()
    }

    /// Carries out exits, actions and entries of the chosen transitions.
    fn perform(&mut self, chosen: &[usize], value: &Value) -> Option<Outcome> {
        let exits = self.exits(chosen);
        let leaves: Vec<usize> = self.configuration.leaves(self.automaton).collect();
        let left: Vec<usize> = leaves.into_iter().filter(|leaf| exits.contains(leaf)).collect();
        let transitions = chosen.iter().map(|&number| self.automaton.transition(number));
        let moving: Vec<&Transition> =
            transitions.filter(|transition| matches!(transition.target, Target::States(_) | Target::Resume)).collect();
        let targets = |configuration: &Configuration, transition: &Transition| {
            effective_targets(self.automaton, configuration, transition)
        };
        let domain =
            |transition: &&Transition| self.automaton.domain(transition, &targets(self.configuration, transition));
        // The choice fixes the domain, before the exit changes memories (rule 60).
        let domains: Vec<usize> = moving.iter().map(domain).collect();
        remember(self.automaton, self.configuration, &exits);
        let mut entered = BTreeSet::new();
        for (transition, domain) in moving.into_iter().zip(domains) {
            let targets = targets(self.configuration, transition);
            entered.extend(entry_set(self.automaton, self.configuration, domain, &targets));
        }
        suspend(self.automaton, self.configuration, &left, &entered);
        self.leave(&exits);
        let mut ending = None;
        for &number in chosen {
            let transition = self.automaton.transition(number);
            carry_out(self.automaton, self.configuration, &transition.actions, value, self.commands);
            ending = ending.or_else(|| self.ending(&transition.target, value));
        }
        if let Some(outcome) = ending {
            return Some(self.finish(outcome));
        }
        self.enter(&entered, value);
        None
    }

    /// Returns the outcome of a transition that ends the activity.
    fn ending(&self, target: &Target, event: &Value) -> Option<Outcome> {
        match target {
            Target::Done(source) => Some(Outcome::Done(value_of(self.configuration, source, event))),
            Target::Abort(why) => Some(Outcome::Aborted(failed(why))),
            Target::Stay | Target::States(_) | Target::Resume => None,
        }
    }

    /// Leaves these states, by rules 39 and 52.
    fn leave(&mut self, exits: &BTreeSet<usize>) {
        for &state in exits.iter().rev() {
            for &transition in self.automaton.transitions_of(state) {
                let timer = &mut self.configuration.timers[transition];
                if std::mem::take(&mut timer.is_armed) {
                    self.commands.push(Command::Cancel { transition, activation: timer.activation });
                }
            }
            let automaton = self.automaton;
            let is_of = |cue: &Cue| cue.state(automaton) == Some(state);
            self.configuration.queue.retain(|queued| !is_of(&queued.cue));
            self.configuration.raised.retain(|cue| !is_of(cue));
            let actions = &automaton.chart().states[state].exit;
            carry_out(automaton, self.configuration, actions, &Value::EMPTY, self.commands);
            self.configuration.active[state] = false;
            self.configuration.fresh[state] = false;
        }
    }

    /// Enters these states, by rules 29 and 41.
    fn enter(&mut self, entered: &BTreeSet<usize>, value: &Value) {
        for &state in entered {
            self.configuration.active[state] = true;
            self.configuration.fresh[state] = true;
            let actions = &self.automaton.chart().states[state].entry;
            carry_out(self.automaton, self.configuration, actions, value, self.commands);
            let completed = self.automaton.completed_by(self.configuration, state);
            self.configuration.raised.extend(completed.into_iter().map(Cue::Complete));
        }
    }

    /// Begins the runs and timers of the entered states (rule 43).
    fn settle(&mut self) {
        for state in 0..self.configuration.fresh.len() {
            if !std::mem::take(&mut self.configuration.fresh[state]) {
                continue;
            }
            for &transition in self.automaton.transitions_of(state) {
                if let Trigger::After(_) | Trigger::Every(_) = self.automaton.transition(transition).trigger {
                    self.arm(transition);
                }
            }
            if let Some(source) = &self.automaton.chart().states[state].run {
                let value = value_of(self.configuration, source, &Value::EMPTY);
                let run = &mut self.configuration.runs[state];
                run.activity = Activity::Active;
                run.activation.0 += 1;
                self.commands.push(Command::Run { state, activation: run.activation, value });
            }
        }
    }

    fn arm(&mut self, transition: usize) {
        let (Trigger::After(after) | Trigger::Every(after)) = self.automaton.transition(transition).trigger else {
            return;
        };
        let timer = &mut self.configuration.timers[transition];
        timer.is_armed = true;
        timer.activation.0 += 1;
        self.commands.push(Command::Arm { transition, activation: timer.activation, after });
    }

    /// Stops everything, and then ends the activity with this outcome (rule 55).
    fn end(&mut self, outcome: Outcome) -> Option<Outcome> {
        let all = (0..self.configuration.active.len()).filter(|&state| self.configuration.active[state]).collect();
        let unconfirmed = self.configuration.pending.take().and_then(|pending| pending.unconfirmed);
        if self.stop(&all) {
            let ending = Some(outcome);
            self.configuration.pending = Some(Pending { chosen: Vec::new(), value: Value::EMPTY, ending, unconfirmed });
            return None;
        }
        Some(self.finish(unconfirmed.map_or(outcome, Outcome::Aborted)))
    }

    /// Leaves all active states and clears the queues, by rules 55 and 58. Returns the outcome.
    fn finish(&mut self, outcome: Outcome) -> Outcome {
        let all = (0..self.configuration.active.len()).filter(|&state| self.configuration.active[state]).collect();
        self.leave(&all);
        let error = self.configuration.error.take();
        self.configuration.queue.clear();
        self.configuration.raised.clear();
        match (outcome, error) {
            (Outcome::Done(_), Some(reason)) => Outcome::Aborted(reason),
            (outcome, _) => outcome,
        }
    }

    fn snapshot(&self) -> Snapshot {
        let Configuration { active, variables, memories, raised, .. } = &*self.configuration;
        let mut hasher = DefaultHasher::new();
        (active, variables, memories, raised).hash(&mut hasher);
        Snapshot {
            digest: hasher.finish(),
            active: active.clone(),
            variables: variables.clone(),
            memories: memories.clone(),
            raised: raised.clone(),
        }
    }

    /// Returns the reason for an activity that would never end its reaction, with the states of the cycle.
    fn livelock(&self, trail: &[(Snapshot, Option<usize>)], first: Option<usize>) -> Reason {
        let Some(first) = first else {
            return failed(&format!(
                "the activity made {STEPS_MAX} steps without an event, or raised too many signals"
            ));
        };
        let name = |state: usize| format!("`{}`", self.automaton.chart().states[state].name);
        let sources: Vec<usize> = trail[first..].iter().filter_map(|(_, source)| *source).collect();
        let mut names: Vec<String> = sources.iter().take(NAMES_MAX).map(|&state| name(state)).collect();
        match sources.first() {
            Some(&state) if sources.len() <= NAMES_MAX => names.push(name(state)),
            _ => names.push("…".into()),
        }
        failed(&format!("the activity loops for ever without an event: {}", names.join(" → ")))
    }
}

/// Returns the event for the end of a run.
fn cue_of(state: usize, outcome: Outcome) -> Cue {
    match outcome {
        Outcome::Done(value) => Cue::Done { state, value },
        Outcome::Aborted(reason) => Cue::Aborted { state, reason },
        Outcome::Stopped => Cue::Aborted { state, reason: failed("it stopped without an order") },
    }
}
