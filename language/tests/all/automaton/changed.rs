//! An activity whose states change while it runs.

use language::algebra::{Activation, Carried, Command, Event, Misfit, Program, State, Value, carry, step};
use language::{Options, Source, compile};
use std::collections::BTreeSet;
use std::time::Duration;

/// An activity with this body.
fn program(body: &str) -> Program {
    let text = format!(
        "module Go(host) {{ done; }}
activity A(h: Host){{
    host{{h}}
    in orders: Text;
    look instof Go(h);
    walk instof Go(h);
    {body}
}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ a instof A(\"c1\"); }}
    internal_event_actions{{ a }}
}}"
    );
    let compiled = compile(&Source::new("a.dca", &text), &[], &Options::named("a"));
    let plan = compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics));
    Program::compile(plan.groups.iter().find(|group| group.path == "main/a").expect("it is there"))
}

/// Starts the first activity, lets these members be done one after the other, and carries it over to the second one.
fn changed(old: &str, done: &[u32], new: &str) -> Result<Carried, Misfit> {
    let (old, new) = (program(old), program(new));
    let (mut state, mut commands) = (State::new(&old), vec![]);
    step(&old, &mut state, Event::Start(Value::EMPTY), &mut commands);
    for &member in done {
        let event = Event::Done { member, activation: Activation(1), value: Value::EMPTY };
        step(&old, &mut state, event, &mut commands);
    }
    carry((&old, &state), &new, &BTreeSet::new())
}

/// The names of the active states without inner ones.
fn states(program: &Program, state: &State) -> Vec<String> {
    let (automaton, place) = program.automaton().zip(state.chart()).expect("it is an activity");
    place.leaves(automaton).map(|leaf| automaton.chart().states[leaf].name.clone()).collect()
}

const OLD: &str = "
    var tries: 0..3 = 0;
    initial state out { run look; on done -> waiting { tries += 1; } }
    state waiting { on after 10 s -> back; on message orders -> back; }
    state back { run walk; on done -> done; }
    suspended state paused { on resume -> resume; }
    on suspend -> paused;";

#[test]
fn a_state_that_still_exists_is_kept_with_variables_and_timers() {
    let new = "
        var speed: slow | fast = fast;
        var tries: 0..9 = 7;
        initial state out { run look; on done -> waiting { tries += 1; } }
        state charging { run look; on done -> back; }
        state waiting { on message orders -> charging; on after 10 s -> back; on every 3 s { log(\"still\"); } }
        state back { run walk; on done -> done; }
        on aborted -> charging;";
    let carried = changed(OLD, &[0], new).unwrap();
    assert_eq!(states(&program(new), &carried.state), ["waiting"]);
    let place = carried.state.chart().unwrap();
    assert_eq!((place.variable(0), place.variable(1)), (Some(1), Some(1)));
    assert_eq!(carried.timers.into_iter().collect::<Vec<_>>(), [(0, 0)]);
    assert_eq!(carried.ended, []);
    let armed = Command::Arm { timer: 1, activation: Activation(2), after: Duration::from_secs(3) };
    assert_eq!(carried.begun, [armed]);
    assert_eq!(carried.outcome, None);
}

#[test]
fn a_run_goes_on_in_its_state() {
    let new = OLD.replace("run walk; on done -> done;", "run walk; on done -> done; on aborted -> out;");
    let new = new.replace("initial state out", "state before { run walk; on done -> out; } initial state out");
    let old = program(OLD);
    let next = program(&new);
    let mut carried = changed(OLD, &[], &new).unwrap();
    assert_eq!(states(&next, &carried.state), ["out"]);
    assert_eq!(carried.state.activity(0), language::algebra::Activity::Active);
    let mut commands = vec![];
    let event = Event::Done { member: 0, activation: Activation(1), value: Value::EMPTY };
    assert_eq!(step(&next, &mut carried.state, event, &mut commands), None);
    assert_eq!(states(&next, &carried.state), ["waiting"]);
    assert!(old != next);
}

#[test]
fn a_timer_without_a_place_is_cancelled() {
    let new = OLD.replace("on after 10 s -> back;", "on after 20 s -> back;");
    let carried = changed(OLD, &[0], &new).unwrap();
    assert_eq!(carried.ended, [Command::Cancel { timer: 0, activation: Activation(1) }]);
    let armed = Command::Arm { timer: 0, activation: Activation(2), after: Duration::from_secs(20) };
    assert_eq!(carried.begun, [armed]);
}

#[test]
fn a_change_that_takes_the_state_away_says_so() {
    let why = |new: &str, done: &[u32]| changed(OLD, done, new).map(|_| ()).unwrap_err().why;
    let renamed = OLD.replace("waiting", "resting");
    assert_eq!(why(&renamed, &[0]), "a state that the activity is in does not exist any more");
    assert_eq!(changed(OLD, &[], &renamed).map(|_| ()), Ok(()));
    let nested = OLD
        .replace("state waiting {", "state around { initial state waiting {")
        .replace("back; }\n    state back", "back; } }\n    state back");
    assert_eq!(why(&nested, &[0]), "a state that the activity is in stands inside another state");
    let narrow = OLD.replace("tries: 0..3 = 0", "tries: 0..0 = 0").replace("tries += 1;", "");
    assert_eq!(why(&narrow, &[0]), "a variable of the activity has a value that is outside its new range");
    let other = OLD.replace("run look;", "run walk;");
    assert_eq!(why(&other, &[]), "the new event actions have another expression in its place");
    let idle = OLD.replace("run look; on done -> waiting", "on always -> waiting");
    assert_eq!(why(&idle, &[]), "a state that the activity is in runs nothing any more");
}

/// A suspended activity that could not return to its states would begin again without a word.
#[test]
fn a_suspended_activity_keeps_the_states_to_which_it_returns() {
    let old = "
        initial state out { run look; on done -> paused; }
        state home { run walk; on done -> done; }
        suspended state paused { on message orders -> resume; }";
    let why = |new: &str| changed(old, &[0], new).map(|_| ()).map_err(|misfit| misfit.why);
    assert_eq!(why(&old.replace("home", "house")), Ok(()));
    let gone = "a state to which the suspended activity returns does not exist any more";
    assert_eq!(why(&old.replace("state out", "state away")), Err(gone));
}

#[test]
fn values_with_names_are_kept_by_their_names() {
    let with = |variable: &str| {
        format!(
            "{variable}
            initial state out {{ run look; on done -> waiting; }}
            state waiting {{ on message orders -> out; }}"
        )
    };
    let set = |variable: &str, value: &str| {
        with(variable).replace("-> waiting;", &format!("-> waiting {{ mode = {value}; }}"))
    };
    let value = |old: &str, new: &str| {
        let carried = changed(old, &[0], new).map_err(|misfit| misfit.why)?;
        Ok(carried.state.chart().and_then(|place| place.variable(0)))
    };
    let old = set("var mode: slow | fast = slow;", "fast");
    assert_eq!(value(&old, &with("var mode: fast | slow = slow;")), Ok(Some(0)));
    assert_eq!(value(&old, &with("var mode: slow | middle | fast = slow;")), Ok(Some(2)));
    let gone = "a variable of the activity has a value that does not exist any more";
    assert_eq!(value(&old, &with("var mode: slow | quick = slow;")), Err(gone));
    let other = "a variable of the activity has numbers in place of names, or names in place of numbers";
    assert_eq!(value(&old, &with("var mode: 0..5 = 0;")), Err(other));
    let number = set("var mode: 0..5 = 0;", "1");
    assert_eq!(value(&number, &with("var mode: slow | fast | x = slow;")), Err(other));
    assert_eq!(value(&number, &with("var mode: 1..9 = 2;")), Ok(Some(1)));
    let truth = set("var mode: bool = false;", "true");
    assert_eq!(value(&truth, &with("var mode: bool = false;")), Ok(Some(1)));
    assert_eq!(value(&truth, &with("var mode: 0..1 = 0;")), Err(other));
}

/// The states and their timers stay the same, and the runs of the states change.
#[test]
fn a_run_gets_and_loses_timers() {
    let runs = [
        "look",
        "(look ; wait(1 s))",
        "(look, wait(50 s))",
        "(look # wait(50 s))",
        "look within 100 s",
        "retry(3, pause 1 s) look",
        "look else wait(1 s)",
        "(look, wait(1 s), wait(2 s))",
        "(wait(1 s) ; look)",
    ];
    let with = |first: &str, second: &str| {
        format!(
            "initial state out {{ run {first}; on done -> back; on after 10 s -> back; }}
            state back {{ run {second}; on done -> done; on after 7 s -> out; }}"
        )
    };
    let mut kept = 0;
    for (old, new) in runs.iter().flat_map(|old| runs.iter().map(move |new| (*old, *new))) {
        for done in [&[][..], &[0]] {
            // The state that the activity is in has changed, the other one, or both.
            for next in [with(new, old), with(old, new), with(new, new)] {
                let Ok(carried) = changed(&with(old, old), done, &next) else { continue };
                let program = program(&next);
                assert!(carried.timers.values().all(|timer| *timer < program.timers()), "{old}, then {new}");
                let timer = u32::from(states(&program, &carried.state) == ["back"]);
                assert_eq!(
                    carried.timers.get(&timer),
                    Some(&timer),
                    "{old}, then {new}: the timer of the state runs on"
                );
                kept += 1;
            }
        }
    }
    assert!(kept > runs.len() * runs.len(), "{kept}");
}
