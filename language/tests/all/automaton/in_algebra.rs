//! Activities as the event actions of a group: the algebra gives the orders of the automaton.
//!
//! Each state that runs something runs one program of its own. Then the commands of both have to be the same, one by one, and
//! so have the outcomes.

use super::charts::{self, FILTERS, PORTS};
use crate::random::Random;
use language::algebra::{self, Activation, Activity, Cause, Outcome, Program, Reason, State, Value};
use language::automaton::{self, Automaton, Chart, Configuration};
use language::plan::{Expression, Filter, Group, Member, MemberKind, Notice, StateChart, StateRun, Supervision};

/// The activity as a group, with a program for each state that runs something.
fn group(chart: &Chart) -> Group {
    let states = (0_u32..).zip(&chart.states).filter(|(_, state)| state.run.is_some()).map(|(number, _)| number);
    let runs: Vec<StateRun> = (0_u32..)
        .zip(states)
        .map(|(member, state)| StateRun { state, expression: Expression::Run { member, sets: vec![] } })
        .collect();
    let member =
        |run: &StateRun| Member { name: format!("m{}", run.state), kind: MemberKind::Leaf(run.state), service: false };
    let names = |count: usize| (0..count).map(|number| format!("n{number}")).collect();
    Group {
        path: "main".into(),
        process: "main".into(),
        host: 0,
        members: runs.iter().map(member).collect(),
        sets: vec![],
        sets_always: vec![],
        expression: Expression::Chart(Box::new(StateChart {
            chart: chart.clone(),
            runs,
            inputs: names(PORTS),
            outputs: names(9),
            filters: vec![Filter::All(vec![]); FILTERS],
            notices: vec![Notice::Suspend; charts::NOTICES],
            questions: vec![],
            signals: names(9),
        })),
        supervision: Supervision::default(),
    }
}

/// One activity twice: alone, and as a group.
struct Both<'a> {
    automaton: &'a Automaton,
    configuration: Configuration,
    program: Program,
    state: State,
    /// The states that run something, by member.
    states: Vec<usize>,
    /// The transitions with a timer.
    timed: Vec<usize>,
}

impl<'a> Both<'a> {
    fn new(automaton: &'a Automaton) -> Self {
        let group = group(automaton.chart());
        let program = Program::compile(&group);
        let Expression::Chart(chart) = &group.expression else { unreachable!("it is an activity") };
        let transitions = &automaton.chart().transitions;
        Self {
            automaton,
            configuration: Configuration::new(automaton),
            state: State::new(&program),
            program,
            states: chart.runs.iter().map(|run| run.state as usize).collect(),
            timed: (0..transitions.len()).filter(|&number| transitions[number].trigger.time().is_some()).collect(),
        }
    }

    fn send(&mut self, alone: automaton::Event, grouped: algebra::Event) -> Option<Outcome> {
        let (mut expected, mut found) = (vec![], vec![]);
        self.configuration.begin_reaction();
        let outcome = automaton::step(self.automaton, &mut self.configuration, alone, &mut expected);
        let same = algebra::step(&self.program, &mut self.state, grouped, &mut found);
        let expected: Vec<algebra::Command> = expected.into_iter().map(|command| self.grouped(command)).collect();
        assert_eq!((found, &same), (expected, &outcome));
        assert_eq!(self.state.is_idle(), self.configuration.is_idle());
        outcome
    }

    fn grouped(&self, command: automaton::Command) -> algebra::Command {
        let small = |number: usize| u32::try_from(number).expect("the test made it");
        let member =
            |state: usize| small(self.states.iter().position(|other| *other == state).expect("the test made it"));
        let timer = |transition: usize| {
            small(self.timed.iter().position(|other| *other == transition).expect("the test made it"))
        };
        match command {
            automaton::Command::Run { state, activation, value } => {
                algebra::Command::Activate { member: member(state), activation, value }
            }
            automaton::Command::Stop { state, activation } => {
                algebra::Command::Stop { member: member(state), activation }
            }
            automaton::Command::Arm { transition, activation, after } => {
                algebra::Command::Arm { timer: timer(transition), activation, after }
            }
            automaton::Command::Cancel { transition, activation } => {
                algebra::Command::Cancel { timer: timer(transition), activation }
            }
            automaton::Command::Send { output, value } => algebra::Command::Send { output: small(output), value },
            automaton::Command::Log(text) => algebra::Command::Log { text: text.into() },
            automaton::Command::Lost { port } => algebra::Command::Lost { port: small(port) },
        }
    }

    /// Something that may happen, as both see it.
    fn choose(&self, random: &mut Random) -> (automaton::Event, algebra::Event) {
        if self.configuration.is_idle() {
            return (automaton::Event::Start(Value::EMPTY), algebra::Event::Start(Value::EMPTY));
        }
        let small = |number: usize| u32::try_from(number).expect("the test made it");
        let running: Vec<usize> = (0..self.states.len())
            .filter(|&member| self.configuration.run(self.states[member]).1 != Activity::Idle)
            .collect();
        let armed: Vec<usize> =
            (0..self.timed.len()).filter(|&timer| self.configuration.timer(self.timed[timer]).1).collect();
        match random.below(12) {
            0 if random.one_in(4) => (automaton::Event::Stop, algebra::Event::Stop),
            1..=6 if !running.is_empty() => {
                let member = running[random.below(running.len())];
                let state = self.states[member];
                let (activation, member) = (self.configuration.run(state).0, small(member));
                let ended = |outcome| automaton::Event::Ended { state, activation, outcome };
                let aborted = |cause| ended(Outcome::Aborted(Reason { member: Some(member), cause }));
                let value =
                    Value::tagged(charts::TAGS[random.below(charts::TAGS.len())], b"v").expect("the test made it");
                match random.below(4) {
                    0 => {
                        let report = Value::new(b"why");
                        let alone = aborted(Cause::Reported(report.clone()));
                        (alone, algebra::Event::Aborted { member, activation, report })
                    }
                    1 => (aborted(Cause::StopUnconfirmed), algebra::Event::StopUnconfirmed { member, activation }),
                    _ => (ended(Outcome::Done(value.clone())), algebra::Event::Done { member, activation, value }),
                }
            }
            7..=8 if !armed.is_empty() => {
                let timer = armed[random.below(armed.len())];
                let activation = self.configuration.timer(self.timed[timer]).0;
                let alone = automaton::Event::Elapsed { transition: self.timed[timer], activation };
                (alone, algebra::Event::Elapsed { timer: small(timer), activation })
            }
            9 => {
                let notice = random.below(charts::NOTICES);
                (automaton::Event::Notice(notice), algebra::Event::Notice(small(notice)))
            }
            _ => {
                let port = random.below(PORTS);
                let filters: Vec<usize> = (0..FILTERS).filter(|_| random.one_in(2)).collect();
                let numbers = filters.iter().map(|&filter| small(filter)).collect();
                let priority = u8::try_from(random.below(4)).expect("the test made it");
                let value = Value::new(b"m");
                let alone = automaton::Event::Message { port, filters, priority, value: value.clone() };
                (alone, algebra::Event::Message { port: small(port), filters: numbers, priority, value })
            }
        }
    }
}

fn seed_size(seed: u64) -> usize {
    usize::try_from(seed % 7).expect("the test made it")
}

#[test]
fn a_group_does_what_its_automaton_orders() {
    let mut ends = 0;
    for seed in 0..500 {
        let mut random = Random(seed);
        let Ok(automaton) = Automaton::new(charts::chart(&mut random, 2 + seed_size(seed))) else { continue };
        let mut both = Both::new(&automaton);
        for _ in 0..60 {
            let (alone, grouped) = both.choose(&mut random);
            ends += usize::from(both.send(alone, grouped).is_some());
        }
    }
    assert!(ends > 150, "{ends}");
}

/// A run may end at once. A state that comes back to itself then turns for ever, and ends with a reason.
#[test]
fn a_run_that_ends_at_once_goes_on_in_the_same_step() {
    use language::automaton::{ChartState, Target, Transition, Trigger, ValueSource};
    let run = |state: ChartState| ChartState { run: Some(ValueSource::Constant(Value::EMPTY)), ..state };
    let chart = |target| Chart {
        states: vec![
            ChartState::compound("lamp", None, 1),
            run(ChartState::atomic("dark", 0)),
            run(ChartState::atomic("bright", 0)),
        ],
        transitions: vec![Transition::new(1, Trigger::Done(None), Target::States(vec![target]))],
        ..Chart::default()
    };
    let start = |target| {
        let mut group = group(&chart(target));
        let Expression::Chart(own) = &mut group.expression else { unreachable!("it is an activity") };
        own.runs[0].expression = Expression::Skip;
        let program = Program::compile(&group);
        let (mut state, mut commands) = (State::new(&program), vec![]);
        let outcome = algebra::step(&program, &mut state, algebra::Event::Start(Value::EMPTY), &mut commands);
        (commands, outcome)
    };
    let activate = algebra::Command::Activate { member: 1, activation: Activation(1), value: Value::EMPTY };
    assert_eq!(start(2), (vec![activate], None));
    let (commands, outcome) = start(1);
    assert!(commands.is_empty());
    let Some(Outcome::Aborted(Reason { cause: Cause::Failed(why), .. })) = outcome else { panic!("{outcome:?}") };
    assert_eq!(&*why, "the activity loops for ever, because its runs end at once: it is in `dark`");
}
