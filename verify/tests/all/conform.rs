//! Compares recorded steps with the spec: the steps of a supervisor that works, and those of some that have a
//! mistake.

use language::algebra::{Activation, Command, Event, Outcome, Program, State, StepRecord, Value, step};
use language::plan::Plan;
use language::sites::Sites;
use language::{Options, Source, compile_with_sites};
use verify::{Alone, Always, Conformance, Limits, Verdict, conform};

const SPEC: &str = "
    module Step { done; }
    process main(){
        host{c1}
        instantiated_processes{ watch instof Step(c1); arm instof Step(c1); back instof Step(c1); }
        internal_event_actions{ (watch # arm) ; back }
        verify{ never arm with back; back only after watch.ended; can finish; }
    }";

/// Returns whether a supervisor loses a command.
type Loses = fn(&Command) -> bool;

fn compiled() -> (Plan, Sites) {
    let (compiled, sites) = compile_with_sites(&Source::new("test.dca", SPEC), &[], &Options::named("test"));
    compiled.plan.zip(sites).unwrap_or_else(|| panic!("{:?}", compiled.diagnostics))
}

fn done(member: u32) -> Event {
    Event::Done { member, activation: Activation(1), value: Value::EMPTY }
}

fn stopped(member: u32) -> Event {
    Event::Stopped { member, activation: Activation(1) }
}

/// The steps of a supervisor that loses the commands for which `loses` returns true.
fn steps(plan: &Plan, events: &[Event], loses: impl Fn(&Command) -> bool) -> Vec<StepRecord> {
    let program = Program::compile(&plan.groups[0]);
    let mut state = State::new(&program);
    let taken = events.iter().map(|event| {
        let mut commands = Vec::new();
        let outcome = step(&program, &mut state, event.clone(), &mut commands);
        commands.retain(|command| !loses(command));
        StepRecord::new(event.clone(), commands, outcome)
    });
    taken.collect()
}

fn compare(plan: &Plan, sites: &Sites, steps: Vec<StepRecord>) -> Conformance {
    conform(plan, sites, &[vec![steps]], &Limits { states: 1000, memory: 1 << 20, threads: &Alone, goes_on: &Always })
}

fn whole() -> [Event; 4] {
    [Event::Start(Value::EMPTY), done(0), stopped(1), done(2)]
}

#[test]
fn a_run_as_the_spec_says_conforms_and_covers_its_way() {
    let (plan, sites) = compiled();
    let found = compare(&plan, &sites, steps(&plan, &whole(), |_| false));
    assert_eq!((found.deviations, found.steps), (Vec::new(), 4));
    let verdicts: Vec<Verdict> = found.sentences.iter().map(|sentence| sentence.verdict).collect();
    assert_eq!(verdicts, [Verdict::Proved, Verdict::Proved, Verdict::Open]);
    let [coverage] = &found.coverage[..] else { panic!("one group") };
    // The states: idle, both run, `arm` is being stopped, `back` runs, and done.
    assert_eq!((coverage.states.0, coverage.transitions.0), (5, 4));
    assert!(coverage.states.1 > 5 && coverage.transitions.1 > 4 && coverage.fault_states.1 > 0, "{coverage:?}");
    assert_eq!((coverage.fault_states.0, coverage.outside, coverage.is_limited), (0, 0, false));
    assert_eq!(coverage.never_failed, ["watch", "arm", "back"]);
}

#[test]
fn a_failure_is_covered_and_a_second_round_adds_up() {
    let (plan, sites) = compiled();
    let failed = |member| Event::Aborted { member, activation: Activation(1), report: Value::EMPTY };
    let mut events = vec![Event::Start(Value::EMPTY), failed(0), stopped(1)];
    let second = Activation(2);
    events.push(Event::Start(Value::EMPTY));
    events.push(Event::Done { member: 0, activation: second, value: Value::EMPTY });
    events.push(Event::Stopped { member: 1, activation: second });
    let found = compare(&plan, &sites, steps(&plan, &events, |_| false));
    assert_eq!(found.deviations, Vec::new());
    assert_eq!(found.coverage[0].never_failed, ["arm", "back"]);
    assert!(found.coverage[0].fault_states.0 > 0);
}

#[test]
fn what_a_supervisor_leaves_out_is_told_with_what_was_expected() {
    let (plan, sites) = compiled();
    let cases: [(Loses, [&str; 2], usize); 2] = [
        (
            |command| matches!(command, Command::Stop { .. }),
            ["`watch` is done: expected: stops `arm`", "`watch` is done: seen: nothing follows"],
            2,
        ),
        (
            |command| matches!(command, Command::Activate { member: 2, .. }),
            ["`arm` has stopped: expected: starts `back`", "`arm` has stopped: seen: nothing follows"],
            3,
        ),
    ];
    for (loses, expected, told) in cases {
        let found = compare(&plan, &sites, steps(&plan, &whole(), loses));
        let [deviation] = &found.deviations[..] else { panic!("{found:?}") };
        let diagnostic = deviation.diagnostic.as_ref().expect("it has a place");
        assert_eq!(diagnostic.help, expected);
        let place = &SPEC[diagnostic.primary.span.start as usize..diagnostic.primary.span.end as usize];
        assert!(["arm", "back"].contains(&place), "{place}");
        assert_eq!(deviation.story.as_ref().map(|story| story.steps.len()), Some(told));
    }
}

#[test]
fn a_success_that_was_none_is_a_deviation() {
    let (plan, sites) = compiled();
    let mut record = steps(&plan, &[Event::Start(Value::EMPTY), Event::Stop, stopped(0), stopped(1)], |_| false);
    assert_eq!(record.last().and_then(|step| step.outcome.clone()), Some(Outcome::Stopped));
    record.last_mut().expect("there are steps").outcome = Some(Outcome::Done(Value::EMPTY));
    assert_eq!(compare(&plan, &sites, record).deviations.len(), 1);
}

/// Returns the verdict on a formula for the steps of a run.
fn on_formula(formula: &str, events: &[Event]) -> (Verdict, Option<usize>) {
    let text = SPEC.replace("can finish;", &format!("holds ltl \"{formula}\";"));
    let (compiled, sites) = compile_with_sites(&Source::new("test.dca", text), &[], &Options::named("test"));
    let (plan, sites) = compiled.plan.zip(sites).unwrap_or_else(|| panic!("{:?}", compiled.diagnostics));
    let found = compare(&plan, &sites, steps(&plan, events, |_| false));
    let last = found.sentences.last().expect("it is a sentence");
    (last.verdict, last.story.as_ref().map(|story| story.steps.len()))
}

#[test]
fn a_formula_that_can_be_broken_is_decided_by_a_run() {
    let failed = |member| Event::Aborted { member, activation: Activation(1), report: Value::EMPTY };
    let with_failure = [Event::Start(Value::EMPTY), failed(0), stopped(1)];
    let again = [&whole()[..], &[Event::Start(Value::EMPTY)]].concat();
    let cases: [(&str, &[Event], Verdict, Option<usize>); 11] = [
        ("G !(arm & back)", &whole(), Verdict::Proved, None),
        ("!back.started W watch.ended", &whole(), Verdict::Proved, None),
        ("G (watch.done -> G !arm.running)", &whole(), Verdict::Proved, None),
        // The run breaks the formula at its first, second and third position.
        ("G !arm", &whole(), Verdict::Fails, Some(1)),
        ("G !watch.done", &whole(), Verdict::Fails, Some(2)),
        ("!back W watch.aborted", &whole(), Verdict::Fails, Some(3)),
        ("!back W watch.aborted", &with_failure, Verdict::Proved, None),
        // Another start begins another run.
        ("G (done -> G !arm)", &again, Verdict::Proved, None),
        // A run cannot show that something always happens, but it can show a violation.
        ("F done", &whole(), Verdict::Open, None),
        ("G !(arm & back) & F done", &whole(), Verdict::Open, None),
        ("G !watch.done & F done", &whole(), Verdict::Fails, Some(2)),
    ];
    for (formula, events, verdict, steps) in cases {
        assert_eq!(on_formula(formula, events), (verdict, steps), "{formula}");
    }
}
