//! Examples of rules that surprise people, or that other engines got wrong.

use language::algebra::{Cause, Outcome, Reason, Value};
use language::automaton::{
    Action, Automaton, Chart, ChartError, ChartState, Command, Configuration, Event, Failure, Formula, Relation,
    StateKind, Target, Transition, Trigger, ValueSource, Variable, step,
};
use std::time::Duration;

const STOP: usize = 0;
const GO: usize = 1;

/// An activity that runs.
struct Run {
    automaton: Automaton,
    configuration: Configuration,
}

impl Run {
    /// Starts an activity; returns its orders.
    fn start(chart: Chart) -> (Self, String) {
        let automaton = Automaton::new(chart).expect("the chart is an automaton");
        let mut run = Self { configuration: Configuration::new(&automaton), automaton };
        let begun = run.send(Event::Start(Value::EMPTY));
        (run, begun)
    }

    /// Sends an event; returns the orders and the outcome, as words.
    fn send(&mut self, event: Event) -> String {
        let mut commands = vec![];
        let outcome = step(&self.automaton, &mut self.configuration, event, &mut commands);
        let name = |state: &usize| self.automaton.chart().states[*state].name.clone();
        let words = commands.iter().map(|command| match command {
            Command::Run { state, .. } => format!("run {}", name(state)),
            Command::Stop { state, .. } => format!("stop {}", name(state)),
            Command::Arm { transition, .. } => format!("arm {transition}"),
            Command::Cancel { transition, .. } => format!("cancel {transition}"),
            Command::Send { output, .. } => format!("send {output}"),
            Command::Log(line) => format!("log {line}"),
            Command::Lost { port } => format!("lost {port}"),
        });
        let ending = outcome.map(|outcome| match outcome {
            Outcome::Done(_) => "done".to_owned(),
            Outcome::Stopped => "stopped".to_owned(),
            Outcome::Aborted(Reason { cause: Cause::Failed(why), .. }) => format!("aborted: {why}"),
            Outcome::Aborted(reason) => format!("aborted: {:?}", reason.cause),
        });
        words.chain(ending).collect::<Vec<String>>().join(", ")
    }

    fn message(&mut self, port: usize) -> String {
        self.send(Event::message(port))
    }

    /// The run of a state has ended.
    fn end(&mut self, state: usize, outcome: Outcome) -> String {
        let activation = self.configuration.run(state).0;
        self.send(Event::Ended { state, activation, outcome })
    }

    fn done(&mut self, state: usize) -> String {
        self.end(state, Outcome::Done(Value::EMPTY))
    }

    fn aborted(&mut self, state: usize, cause: Cause) -> String {
        self.end(state, Outcome::Aborted(Reason { member: Some(0), cause }))
    }

    fn leaves(&self) -> String {
        let name = |state: usize| self.automaton.chart().states[state].name.clone();
        self.configuration.leaves(&self.automaton).map(name).collect::<Vec<String>>().join(" ")
    }
}

fn chart(states: Vec<ChartState>, transitions: Vec<Transition>) -> Chart {
    Chart { states, transitions, ports: vec![2, 2], ..Chart::default() }
}

fn running(name: &str, parent: usize) -> ChartState {
    ChartState { run: Some(ValueSource::Constant(Value::EMPTY)), ..ChartState::atomic(name, parent) }
}

fn suspended(name: &str, parent: usize) -> ChartState {
    ChartState::atomic(name, parent).with_kind(StateKind::Suspended)
}

fn on(port: usize) -> Trigger {
    Trigger::Message { port, filter: None }
}

fn to(state: usize) -> Target {
    Target::States(vec![state])
}

fn send(output: usize) -> Action {
    Action::Send { output, value: ValueSource::Event }
}

/// Two states that run something; each reports on output 1 or 2 that it is left, and the root on output 0.
fn search_and_take() -> Chart {
    let root = ChartState { exit: vec![send(0)], ..ChartState::compound("fetch", None, 1) };
    let search = ChartState { exit: vec![send(1)], ..running("search", 0) };
    let take = ChartState { exit: vec![send(2)], ..running("take", 0) };
    chart(vec![root, search, take], vec![Transition::new(1, on(GO), to(2))])
}

#[test]
fn a_transition_waits_until_what_it_leaves_has_stopped() {
    let (mut run, begun) = Run::start(search_and_take());
    assert_eq!(begun, "run search");
    assert_eq!((run.message(GO), run.leaves()), ("stop search".to_owned(), "search".to_owned()));
    assert!(run.configuration.is_waiting());
    assert_eq!(run.end(1, Outcome::Stopped), "send 1, run take");
}

#[test]
fn a_run_that_ends_before_its_stop_has_ended_and_no_more() {
    let mut chart = search_and_take();
    chart.transitions.push(Transition::new(1, Trigger::Done(None), Target::Abort("too late".into())));
    let (mut run, _) = Run::start(chart);
    run.message(GO);
    assert_eq!(run.done(1), "send 1, run take");
    assert_eq!(run.done(1), "", "an old number is dropped");
}

#[test]
fn a_stop_that_is_not_confirmed_ends_the_activity() {
    let (mut run, _) = Run::start(search_and_take());
    run.message(GO);
    assert_eq!(run.aborted(1, Cause::StopUnconfirmed), "send 1, send 0, aborted: StopUnconfirmed");
}

#[test]
fn every_stop_runs_the_exit_actions_from_the_inside() {
    let (mut run, _) = Run::start(search_and_take());
    assert_eq!(run.send(Event::Stop), "stop search");
    assert_eq!(run.end(1, Outcome::Stopped), "send 1, send 0, stopped");
    // A stop that comes while a transition waits: the target is forgotten.
    run.send(Event::Start(Value::EMPTY));
    run.message(GO);
    assert_eq!(run.send(Event::Stop), "");
    assert_eq!(run.end(1, Outcome::Stopped), "send 1, send 0, stopped");
    // Children stop before their parent, and later regions before earlier ones.
    let states = vec![
        ChartState { run: Some(ValueSource::Constant(Value::EMPTY)), ..ChartState::compound("base", None, 1) },
        ChartState::atomic("both", 0).with_kind(StateKind::Parallel),
        running("left", 1),
        running("right", 1),
    ];
    let (mut run, begun) = Run::start(chart(states, vec![]));
    assert_eq!(begun, "run base, run left, run right");
    assert_eq!(run.send(Event::Stop), "stop right, stop left, stop base");
}

#[test]
fn an_abort_goes_up_and_ends_the_activity_if_no_state_takes_it() {
    let mut chart = search_and_take();
    let unconfirmed = Trigger::Aborted(Some(Failure::Failed("no way".into())));
    chart.transitions.push(Transition::new(0, unconfirmed, to(2)));
    let (mut run, _) = Run::start(chart);
    assert_eq!(run.aborted(1, Cause::Failed("no way".into())), "send 1, run take");
    assert_eq!(run.aborted(2, Cause::Busy), "send 2, send 0, aborted: Busy");
}

#[test]
fn what_comes_during_a_wait_is_queued_by_priority_within_a_limit() {
    let mut chart = search_and_take();
    let after = Trigger::After(Duration::from_secs(5));
    chart.transitions.push(Transition { actions: vec![send(5)], ..Transition::new(0, after, Target::Stay) });
    for (port, output) in [(GO, 6), (STOP, 7)] {
        chart
            .transitions
            .push(Transition { actions: vec![send(output)], ..Transition::new(0, on(port), Target::Stay) });
    }
    let (mut run, begun) = Run::start(chart);
    assert_eq!(begun, "arm 1, run search");
    run.message(GO);
    let urgent = Event::Message { port: STOP, filters: vec![], priority: 9, value: Value::EMPTY };
    let waiting = [run.message(GO), run.message(GO), run.message(GO), run.send(urgent)];
    assert_eq!(waiting, ["", "", "lost 1", ""]);
    let activation = run.configuration.timer(1).0;
    assert_eq!(run.send(Event::Elapsed { transition: 1, activation }), "");
    assert_eq!(run.end(1, Outcome::Stopped), "send 1, run take, send 5, send 7, send 6, send 6");
}

#[test]
fn an_activity_that_turns_for_ever_ends_and_names_the_cycle() {
    let states =
        vec![ChartState::compound("a", None, 1), ChartState::atomic("here", 0), ChartState::atomic("there", 0)];
    let turning = vec![Transition::new(1, Trigger::Always, to(2)), Transition::new(2, Trigger::Always, to(1))];
    let (_, begun) = Run::start(chart(states.clone(), turning));
    assert_eq!(begun, "aborted: the activity loops for ever without an event: `here` → `there` → `here`");
    // A counter makes it finite.
    let below = |limit| Formula::Compare(Relation::Less, Formula::Variable(0).into(), Formula::Number(limit).into());
    let more =
        Action::Assign { variable: 0, formula: Formula::Add(Formula::Variable(0).into(), Formula::Number(1).into()) };
    let again = |limit| Transition {
        guard: Some(below(limit)),
        actions: vec![more.clone()],
        ..Transition::new(1, Trigger::Always, to(1))
    };
    let variables = vec![Variable { name: "tries".into(), min: 0, max: 3, initial: 0, names: Vec::new() }];
    let counting = |limit| Chart { variables: variables.clone(), ..chart(states.clone(), vec![again(limit)]) };
    let (run, begun) = Run::start(counting(3));
    assert_eq!((begun.as_str(), run.configuration.variable(0)), ("", Some(3)));
    let (_, begun) = Run::start(counting(4));
    assert_eq!(begun, "aborted: `tries` would be 4, which is outside 0..3");
}

#[test]
fn a_suspended_activity_resumes_where_it_was_and_from_the_start() {
    let states = vec![
        ChartState::compound("fetch", None, 1),
        running("search", 0),
        running("take", 0),
        suspended("paused", 0),
        suspended("charging", 0),
    ];
    let transitions = vec![
        Transition::new(0, on(STOP), to(3)),
        Transition::new(1, Trigger::Done(None), to(2)),
        Transition::new(3, on(GO), Target::Resume),
        Transition::new(3, on(STOP), to(4)),
        Transition::new(4, on(GO), Target::Resume),
    ];
    let (mut run, _) = Run::start(chart(states, transitions));
    assert_eq!(run.done(1), "run take");
    assert_eq!(run.message(STOP), "stop take");
    assert_eq!((run.end(2, Outcome::Stopped), run.leaves()), (String::new(), "paused".to_owned()));
    // A suspended state hands its memory on to the next one.
    run.message(STOP);
    assert_eq!(run.leaves(), "charging");
    assert_eq!((run.message(GO), run.leaves()), ("run take".to_owned(), "take".to_owned()));
}

#[test]
fn a_run_of_a_state_that_is_left_in_the_same_reaction_never_starts() {
    let states = vec![ChartState::compound("a", None, 1), running("passed", 0), running("reached", 0)];
    let (_, begun) = Run::start(chart(states, vec![Transition::new(1, Trigger::Always, to(2))]));
    assert_eq!(begun, "run reached");
}

#[test]
fn a_wildcard_takes_messages_and_signals_alone() {
    let mut chart = search_and_take();
    chart.transitions = vec![
        Transition { actions: vec![send(8)], ..Transition::new(0, Trigger::Any, Target::Stay) },
        Transition {
            guard: Some(Formula::Number(0)),
            ..Transition::new(1, Trigger::After(Duration::from_secs(1)), to(2))
        },
    ];
    let (mut run, _) = Run::start(chart);
    let activation = run.configuration.timer(1).0;
    let own = [run.send(Event::Elapsed { transition: 1, activation }), run.send(Event::Notice(0)), run.done(1)];
    assert_eq!(own, ["", "", ""]);
    assert_eq!(run.message(STOP), "send 8");
}

#[test]
fn charts_that_mean_nothing_are_refused() {
    let root = || ChartState::compound("a", None, 1);
    let both = || ChartState::atomic("both", 0).with_kind(StateKind::Parallel);
    let refused = |states: Vec<ChartState>, transitions: Vec<Transition>| {
        Automaton::new(chart(states, transitions)).expect_err("it means nothing").to_string()
    };
    assert_eq!(refused(vec![], vec![]), ChartError::Size.to_string());
    let cases = [
        (
            vec![root(), ChartState::atomic("b", 0), ChartState::atomic("c", 2)],
            vec![],
            "state 2 is not in document order",
        ),
        (vec![root(), both()], vec![], "state 1 has no inner state"),
        (vec![root(), suspended("p", 0)], vec![], "state 0 cannot begin in a suspended state"),
        (vec![root(), both(), suspended("p", 1)], vec![], "state 2 cannot be a region"),
        (
            vec![root(), ChartState::atomic("b", 0)],
            vec![Transition::new(1, Trigger::Done(None), to(1))],
            "its state has none",
        ),
        (vec![root(), ChartState::atomic("b", 0)], vec![Transition::new(1, on(7), to(1))], "port 7 does not exist"),
        (vec![root(), ChartState::atomic("b", 0)], vec![Transition::new(1, on(0), Target::Resume)], "is not suspended"),
        (
            vec![root(), ChartState::atomic("b", 0), ChartState::atomic("c", 0)],
            vec![Transition::new(1, on(0), Target::States(vec![1, 2]))],
            "cannot be active together",
        ),
    ];
    for (states, transitions, why) in cases {
        let said = refused(states, transitions);
        assert!(said.contains(why), "{said}, not {why}");
    }
}

/// Two ticks come while the stop of `search` is awaited. One waits, the other is dropped, and the next one is not later for it.
#[test]
fn ticks_during_a_wait_are_one_tick() {
    let mut chart = search_and_take();
    let every = Trigger::Every(Duration::from_secs(1));
    chart.transitions.push(Transition { actions: vec![send(7)], ..Transition::new(0, every, Target::Stay) });
    let (mut run, begun) = Run::start(chart);
    assert_eq!(begun, "arm 1, run search");
    let tick = |run: &mut Run| {
        let activation = run.configuration.timer(1).0;
        run.send(Event::Elapsed { transition: 1, activation })
    };
    assert_eq!(tick(&mut run), "arm 1, send 7");
    assert_eq!(run.message(GO), "stop search");
    assert_eq!((tick(&mut run), tick(&mut run)), ("arm 1".to_owned(), "arm 1".to_owned()));
    assert_eq!(run.end(1, Outcome::Stopped), "send 1, run take, send 7");
}
