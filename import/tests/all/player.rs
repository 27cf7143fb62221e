//! Plays the activity of an imported chart on virtual time.

use import::Imported;
use language::algebra::{Activation, Outcome, Value};
use language::automaton::{Action, Automaton, Command, Configuration, Event, StateKind, ValueSource, step};
use language::plan::{Expression, StateChart};
use language::{Options, Source, compile};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A chart that was imported, with the names that its script needs.
pub(crate) struct Played {
    pub(crate) imported: Imported,
    pub(crate) chart: StateChart,
    /// The ids of the states, by their numbers.
    ids: BTreeMap<usize, String>,
    /// The final states of the whole chart, by the numbers of the outputs that they were given.
    finals: BTreeMap<usize, usize>,
}

impl Played {
    /// Reads the activity of an imported chart back from the plan of its text.
    pub(crate) fn of(imported: Imported) -> Self {
        let spec = Source::new("chart.dca", imported.text.as_str());
        let plan = compile(&spec, &[], &Options::named("chart")).plan.expect("an imported text has a plan");
        let activity = plan
            .groups
            .into_iter()
            .find_map(|group| if let Expression::Chart(chart) = group.expression { Some(*chart) } else { None });
        let mut chart = activity.expect("the plan has the activity");
        let number = |name: &String| chart.chart.states.iter().position(|state| state.name == *name);
        let ids: BTreeMap<usize, String> =
            imported.states.iter().filter_map(|(id, name)| Some((number(name)?, id.clone()))).collect();
        let finals = told_finals(&mut chart, &ids);
        Self { imported, chart, ids, finals }
    }

    /// The port of an event: its own, or that of the longest name that takes it.
    pub(crate) fn port(&self, event: &str) -> Option<usize> {
        let mut stems: Vec<&str> = event.match_indices('.').map(|(end, _)| &event[..end]).collect();
        stems.push(event);
        let ports = stems.iter().rev().copied().chain(["*"]).find_map(|stem| self.imported.ports.get(stem));
        ports.and_then(|port| self.chart.inputs.iter().position(|input| input == port))
    }
}

/// Lets the final states of the whole chart send something, since an activity that has ended is in no state.
///
/// The parent of such a state is the activity itself, or the region of the chart beside its timers.
fn told_finals(chart: &mut StateChart, ids: &BTreeMap<usize, String>) -> BTreeMap<usize, usize> {
    let mut finals = BTreeMap::new();
    for (number, state) in chart.chart.states.iter_mut().enumerate() {
        if state.kind == StateKind::Final && state.parent.is_some_and(|parent| !ids.contains_key(&parent)) {
            let output = chart.outputs.len() + finals.len();
            state.entry.push(Action::Send { output, value: ValueSource::Constant(Value::EMPTY) });
            finals.insert(output, number);
        }
    }
    finals
}

/// A chart that runs on virtual time.
pub(crate) struct Player<'a> {
    played: &'a Played,
    automaton: &'a Automaton,
    configuration: Configuration,
    now: Duration,
    /// The timers that run, with their times.
    timers: Vec<(Duration, Event)>,
    end: Option<String>,
    /// The lines for people so far.
    pub(crate) logs: Vec<String>,
}

impl<'a> Player<'a> {
    /// Starts a chart.
    pub(crate) fn start(played: &'a Played, automaton: &'a Automaton) -> Self {
        let configuration = Configuration::new(automaton);
        let mut player =
            Self { played, automaton, configuration, now: Duration::ZERO, timers: vec![], end: None, logs: vec![] };
        player.send(Event::Start(Value::EMPTY));
        player.pass(Duration::ZERO);
        player
    }

    pub(crate) fn send(&mut self, event: Event) {
        let mut commands = vec![];
        let outcome = step(self.automaton, &mut self.configuration, event, &mut commands);
        for command in commands {
            match command {
                Command::Send { output, .. } => {
                    let state = self.played.finals.get(&output);
                    self.end = state.and_then(|state| self.played.ids.get(state)).cloned().or(self.end.take());
                }
                Command::Arm { transition, activation: Activation(number), after } => {
                    let event = Event::Elapsed { transition, activation: Activation(number) };
                    self.timers.push((self.now + after, event));
                }
                Command::Log(line) => self.logs.push(line),
                Command::Run { .. } | Command::Stop { .. } | Command::Cancel { .. } | Command::Lost { .. } => {}
            }
        }
        if let Some(Outcome::Aborted(reason)) = outcome {
            self.end = Some(format!("{:?}", reason.cause));
        }
    }

    /// Lets time pass: every timer that ends until then ends in order.
    pub(crate) fn pass(&mut self, time: Duration) {
        let until = self.now + time;
        while let Some(place) = (0..self.timers.len()).min_by_key(|&place| self.timers[place].0)
            && self.timers[place].0 <= until
        {
            let (at, event) = self.timers.remove(place);
            self.now = at;
            self.send(event);
        }
        self.now = until;
    }

    pub(crate) fn expect(&self, expected: &BTreeSet<String>) -> Result<(), String> {
        // States without an id are those of timers.
        let leaves = self.configuration.leaves(self.automaton);
        let mut active: BTreeSet<String> = leaves.filter_map(|state| self.played.ids.get(&state).cloned()).collect();
        active.extend(self.end.clone());
        if active == *expected { Ok(()) } else { Err(format!("{active:?}, not {expected:?}")) }
    }
}
