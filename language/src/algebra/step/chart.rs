//! The rules of an activity: its automaton decides which runs start and stop.

use super::{Cells, Phase, Reaction, Seats};
use crate::algebra::event::{Command, Outcome, Value};
use crate::automaton::{self, Event};
use std::collections::VecDeque;

/// The most runs that end at once in one reaction. A state that runs `skip` and returns to itself would turn for ever.
const INSTANT_MAX: usize = 256;

impl<C: Cells, S: Seats> Reaction<'_, C, S> {
    /// Start of an activity.
    pub(super) fn s_chart(&mut self, node: usize, value: Value) -> Option<Outcome> {
        self.enter(node, Phase::Running);
        self.react(node, Event::Start(value))
    }

    /// CHART: a run has ended.
    pub(super) fn chart(&mut self, node: usize, operand: usize, outcome: Outcome) -> Option<Outcome> {
        let ended = self.ended_run(operand, outcome)?;
        // The end of a member comes before the end of the run that it causes.
        let notice = self.notice.take().map(Event::Notice);
        self.react_to(node, notice.into_iter().chain([ended]).collect())
    }

    /// The activity gets the event of the end of a member that its run has survived.
    pub(super) fn e_notice(&mut self) -> Option<Outcome> {
        let notice = self.notice.take()?;
        self.e_chart(Event::Notice(notice))
    }

    /// A message or a notice. An activity that does not run drops it.
    pub(super) fn e_chart(&mut self, event: Event) -> Option<Outcome> {
        if self.is_idle() || self.program.chart.is_none() {
            return None;
        }
        let outcome = self.react(0, event)?;
        Some(self.finish(outcome))
    }

    /// stop(chart): the automaton stops its runs and leaves its states.
    pub(super) fn stop_chart(&mut self, node: usize) -> Option<Outcome> {
        let outcome = self.react(node, Event::Stop);
        if outcome.is_none() {
            self.enter(node, Phase::Stopping);
        }
        outcome
    }

    /// Whether the transition of a timer waits for it.
    pub(super) fn is_timed(&self, timer: u32) -> bool {
        let transition = self.program.chart.as_ref().and_then(|chart| chart.timed.get(timer as usize));
        let configuration = self.state.chart.as_deref();
        transition.zip(configuration).is_some_and(|(&transition, configuration)| configuration.timer(transition).1)
    }

    /// The timer of a transition has run out.
    pub(super) fn timed(&mut self, node: usize, timer: u32) -> Option<Outcome> {
        let transition = *self.program.chart.as_ref()?.timed.get(timer as usize)?;
        let (activation, _) = self.state.chart.as_deref()?.timer(transition);
        self.react(node, Event::Elapsed { transition, activation })
    }

    fn ended_run(&self, operand: usize, outcome: Outcome) -> Option<Event> {
        let state = self.program.chart.as_ref()?.state_of(operand)?;
        let (activation, _) = self.state.chart.as_deref()?.run(state);
        Some(Event::Ended { state, activation, outcome })
    }

    fn react(&mut self, node: usize, event: Event) -> Option<Outcome> {
        self.react_to(node, VecDeque::from([event]))
    }

    /// Lets the automaton react, and carries out its commands. Runs that start or stop may end at once, which is the next
    /// event.
    fn react_to(&mut self, node: usize, mut events: VecDeque<Event>) -> Option<Outcome> {
        let chart = self.program.chart.as_deref()?;
        let (mut commands, mut instants) = (Vec::new(), 0);
        self.state.chart.as_deref_mut()?.begin_reaction();
        while let Some(event) = events.pop_front() {
            let configuration = self.state.chart.as_deref_mut()?;
            let outcome = automaton::step(&chart.automaton, configuration, event, &mut commands);
            for command in commands.drain(..) {
                // A run whose end waits here has nothing to stop.
                let is_over = |event: &Event| {
                    matches!((event, &command),
                    (Event::Ended { state, .. }, automaton::Command::Stop { state: other, .. }) if state == other)
                };
                if events.iter().any(is_over) {
                    continue;
                }
                if let Some((operand, outcome)) = self.obey(command) {
                    instants += 1;
                    events.extend(self.ended_run(operand, outcome));
                }
            }
            if let Some(outcome) = outcome {
                self.clear(node);
                return Some(outcome);
            }
            if instants > INSTANT_MAX {
                instants = 0;
                events.push_front(Event::Overrun);
            }
        }
        None
    }

    /// Carries out a command of the automaton. Returns the node of a run that has ended by it, with its outcome.
    fn obey(&mut self, command: automaton::Command) -> Option<(usize, Outcome)> {
        let chart = self.program.chart.as_deref()?;
        match command {
            automaton::Command::Run { state, value, .. } => {
                let node = chart.node_of(state)?;
                return self.start(node, value).map(|outcome| (node, outcome));
            }
            automaton::Command::Stop { state, .. } => {
                let node = chart.node_of(state)?;
                return self.stop(node).map(|outcome| (node, outcome));
            }
            automaton::Command::Arm { transition, after, .. } => self.arm(chart.timer_of(transition)?, after),
            automaton::Command::Cancel { transition, .. } => {
                let timer = chart.timer_of(transition)?;
                let activation = self.state.timers[timer as usize];
                self.commands.push(Command::Cancel { timer, activation });
            }
            automaton::Command::Send { output, value } => {
                self.commands.push(Command::Send { output: u32::try_from(output).ok()?, value });
            }
            automaton::Command::Log(text) => self.commands.push(Command::Log { text: text.into() }),
            automaton::Command::Lost { port } => {
                self.commands.push(Command::Lost { port: u32::try_from(port).ok()? });
            }
        }
        None
    }
}
