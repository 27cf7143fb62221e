//! The values that a spec gives to processes for their start: their bytes, and the effect of a changed value on a running group.

use language::algebra::{Activation, Command, Event, Program, State, Value, carry, step};
use language::plan::{Expression, Plan, difference};
use language::{Options, Source, compile};
use std::collections::BTreeSet;

const TYPES: &str = "
type Place = { x: Length, y: Length, yaw: Angle = 90 deg };
type Tray = { at: Place, slots: Number[2], names: Text[], warm: Truth, side: Text in \"left\" | \"right\", on: Host };
module Go(host) { init goal: Place; done; }
module Serve(host) { init tray: Tray; done; }
module Turn(host) { init by: Angle; done; }
module Say(host) { init words: Text; done; }
module Lamp(host) { init on: Truth; done; }
module Any(host) { init it; done; }
";

fn plan(actions: &str) -> Plan {
    let text = format!(
        "{TYPES} const shelf = {{ y = 50 cm, x = 2 m }};
        process main(){{
            host{{c1}}
            instantiated_processes{{ go instof Go(c1); serve instof Serve(c1); turn instof Turn(c1); say instof Say(c1);
                lamp instof Lamp(c1); any_value instof Any(c1); }}
            internal_event_actions{{ {actions} }}
        }}"
    );
    let compiled = compile(&Source::new("spec", text), &[], &Options::named("spec"));
    compiled.plan.unwrap_or_else(|| panic!("{actions}: {:#?}", compiled.diagnostics))
}

/// The start value of the first process of some event actions.
fn started(actions: &str) -> Value {
    let program = Program::compile(&plan(actions).groups[0]);
    let mut commands = Vec::new();
    step(&program, &mut State::new(&program), Event::Start(Value::new(b"of the group")), &mut commands);
    let values = commands.into_iter().filter_map(|command| match command {
        Command::Activate { value, .. } => Some(value),
        Command::Connect { .. }
        | Command::Disconnect { .. }
        | Command::Stop { .. }
        | Command::Arm { .. }
        | Command::Cancel { .. }
        | Command::Send { .. }
        | Command::Log { .. }
        | Command::Lost { .. } => None,
    });
    values.last().expect("something starts")
}

/// A tuple has the bytes of a struct in postcard, and so has an array.
#[test]
fn a_program_gets_the_bytes_of_its_message_type() {
    fn check<T: serde::Serialize>(actions: &str, value: &T) {
        assert_eq!(started(actions).bytes(), postcard::to_allocvec(value).unwrap(), "{actions}");
    }
    let right = 90_f64.to_radians();
    check("go with shelf", &(2.0, 0.5, right));
    check("go with { x = 1 km, yaw = 0 rad, y = -1 m }", &(1000.0, -1.0, 0.0));
    check("turn with 90 deg", &right);
    check("any_value with -3 m", &-3.0);
    check("say with \"hällo\"", &"hällo");
    check(&format!("say with \"{}\"", "long ".repeat(100)), &"long ".repeat(100));
    check("say with \"\"", &"");
    check("lamp with true", &true);
    check("lamp with false within 5 s as lit", &false);
    check("retry(2) shield lamp with true", &true);
    check("((lamp ; skip)?) with true", &true);
    let tray =
        "serve with { at = shelf, slots = [1, 2.5], names = [\"a\", \"be\"], warm = true, side = \"left\", on = c1 }";
    check(tray, &((2.0, 0.5, right), (1.0, 2.5), vec!["a", "be"], true, "left", "c1"));
    let many: Vec<String> = (0..300).map(|number| format!("n{number}")).collect();
    let listed: Vec<String> = many.iter().map(|name| format!("\"{name}\"")).collect();
    let tray = format!(
        "serve with {{ at = shelf, slots = [1, 2], names = [{}], warm = true, side = \"left\", on = c1 }}",
        listed.join(", ")
    );
    check(&tray, &((2.0, 0.5, right), (1.0, 2.0), many, true, "left", "c1"));
}

/// The text of a value is for people, and the same for the same value.
#[test]
fn a_changed_value_is_a_change_and_another_spelling_is_none() {
    let running = plan("go with shelf ; turn with 90 deg");
    let changes = |actions: &str| difference(&running, &plan(actions)).unwrap().changes.len();
    assert_eq!(changes("go with { x = 200 cm, y = 0.5 m, yaw = 90 deg } ; turn with 90 deg"), 0);
    assert_eq!(changes("go with { x = 201 cm, y = 0.5 m } ; turn with 90 deg"), 1);
    assert_eq!(changes("go with shelf ; turn with 91 deg"), 1);
    assert_eq!(changes("go with shelf ; turn"), 1);
    let Expression::Sequence(first, _) = &running.groups[0].expression else { panic!("a sequence") };
    let Expression::With { given, .. } = &**first else { panic!("a start value") };
    assert!(given.to_string().starts_with("{ x = 2, y = 0.5, yaw = 1.57"), "{given}");
}

/// A process that runs has started with its value: only values of later starts change.
#[test]
fn a_running_process_keeps_the_value_that_it_started_with() {
    let old = Program::compile(&plan("go with shelf ; turn with 90 deg").groups[0]);
    let mut state = State::new(&old);
    step(&old, &mut state, Event::Start(Value::EMPTY), &mut Vec::new());
    let carried = |actions: &str| {
        let next = Program::compile(&plan(actions).groups[0]);
        carry((&old, &state), &next, &BTreeSet::new()).map(|_| ()).map_err(|misfit| misfit.why)
    };
    assert_eq!(carried("go with shelf ; turn with 10 deg"), Ok(()));
    assert_eq!(carried("go with { x = 1 m, y = 1 m } ; turn with 90 deg"), Err("it was started with another value"));
    assert!(carried("go ; turn with 90 deg").is_err());
}

/// A running operand keeps the value that has a name, also under another name, and later starts may use it.
#[test]
fn a_change_keeps_a_value_that_has_a_name() {
    let old = Program::compile(&plan("lamp : p => (go with p ; turn)").groups[0]);
    let mut state = State::new(&old);
    let done = |member: u32, value: &[u8]| Event::Done { member, activation: Activation(1), value: Value::new(value) };
    step(&old, &mut state, Event::Start(Value::EMPTY), &mut Vec::new());
    step(&old, &mut state, done(4, b"there"), &mut Vec::new());
    let carried = |actions: &str| {
        let next = Program::compile(&plan(actions).groups[0]);
        carry((&old, &state), &next, &BTreeSet::new()).map(|carried| (next, carried.state)).map_err(|misfit| misfit.why)
    };
    let (next, mut state) = carried("lamp : q => (go with q ; any_value with q ; turn)").expect("it fits");
    let mut commands = Vec::new();
    step(&next, &mut state, done(0, b""), &mut commands);
    let there = Command::Activate { member: 5, activation: Activation(1), value: Value::new(b"there") };
    assert!(commands.contains(&there), "{commands:?}");
    assert_eq!(
        carried("lamp : p => (go with shelf ; any_value with p)").err(),
        Some("it was started with another value")
    );
    assert!(carried("lamp : (go ; turn)").is_err());
}
