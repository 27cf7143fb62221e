//! Scripts of activities in a running plan: their values, their failures, and their results in a simulation.

use language::algebra::{Activation, Cause, Command, Event, Outcome, Program, State, Value, step};
use language::automaton::{Action, Failure, Scripts};
use language::plan::{Expression, Plan};
use language::script::{ScriptError, ScriptErrorKind};
use language::{Options, Simulation, Source, Transition, compile, format};

/// Returns a spec with an activity that looks for places, computes a goal and goes there.
fn visit(actions: &str) -> String {
    format!(
        "type Place = {{ x: Length, y: Length }};
        module Look(host: Host) {{ done(seen: Place[] | nothing); }}
        module Navigate(host: Host) {{ init goal: Place; done; }}
        activity Visit(robot: Host){{
            in words: Text queue 8;
            out say: Text;
            look instof Look(robot);
            goto instof Navigate(robot);
            var goal: opaque Place = ();
            var kept: opaque Text = ();
            var tries: 0..3 = 0;
            var near: bool = false;
            var mode: slow | fast = fast;
            initial state search {{
                run look;
                on done(seen places) -> approach {{ {actions} }}
                on message words {{ kept = script {{ words + \"!\" }}; say.send(kept); }}
            }}
            state approach {{ run goto with goal; on done -> done; }}
        }}
        process main(){{
            host{{c1}}
            instantiated_processes{{ visit instof Visit(c1); home instof Home(c1); cry instof Cry(c1); }}
            internal_event_actions{{ visit else match {{ script_budget => home, script_failed => cry }} }}
        }}"
    )
}

fn plan(text: &str) -> Plan {
    let compiled = compile(&Source::new("a.dca", text), &[], &Options::named("a"));
    compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics))
}

/// An activity that runs, by the events of its members.
struct Activity {
    program: Program,
    state: State,
    commands: Vec<Command>,
}

impl Activity {
    fn new(plan: &Plan) -> Self {
        let group = plan.groups.iter().find(|group| matches!(group.expression, Expression::Chart(_)));
        let group = group.expect("the plan has an activity");
        let program = Program::compile(group);
        let mut activity = Self { state: State::new(&program), program, commands: Vec::new() };
        activity.take(Event::Start(Value::EMPTY));
        activity
    }

    fn take(&mut self, event: Event) -> Option<Outcome> {
        self.commands.clear();
        step(&self.program, &mut self.state, event, &mut self.commands)
    }

    /// The first member is done with these places.
    fn seen(&mut self, places: &[(f64, f64)]) -> Option<Outcome> {
        let bytes = postcard::to_allocvec(places).expect("places can be written");
        let value = Value::tagged("seen", &bytes).expect("the value is small");
        self.take(Event::Done { member: 0, activation: Activation(1), value })
    }

    /// Returns the place with which the second member starts.
    fn goal(&self) -> Option<(f64, f64)> {
        self.commands.iter().find_map(|command| {
            let Command::Activate { member: 1, value, .. } = command else { return None };
            postcard::from_bytes(value.bytes()).ok()
        })
    }
}

fn error(outcome: Option<Outcome>) -> ScriptError {
    let Some(Outcome::Aborted(reason)) = outcome else { panic!("{outcome:?}") };
    let Cause::Script(error) = reason.cause else { panic!("{reason:?}") };
    error
}

const NEAREST: &str = "goal = script {
    let nearest = places[0];
    for place in places { if place.x ** 2 + place.y ** 2 < nearest.x ** 2 + nearest.y ** 2 { nearest = place; } }
    nearest
};";

#[test]
fn the_nearest_place_is_the_goal() {
    let plan = plan(&visit(NEAREST));
    assert_eq!(plan.validate(), Ok(()));
    let bytes = postcard::to_allocvec(&plan).unwrap();
    assert_eq!(postcard::from_bytes::<Plan>(&bytes).unwrap(), plan, "a plan with scripts comes back from its bytes");
    let mut activity = Activity::new(&plan);
    assert_eq!(activity.seen(&[(3.0, 4.0), (1.0, -1.0), (2.0, 2.0)]), None);
    assert_eq!(activity.goal(), Some((1.0, -1.0)));
}

#[test]
fn a_script_reads_variables_and_what_it_has_given() {
    let mut activity = Activity::new(&plan(&visit(
        "tries += 2; goal = script { #{ x: tries, y: if near || mode != \"fast\" { 1 } else { 2 } } };
         goal = script { if kept == () { #{ x: goal.x + goal.y, y: places.len() } } else { goal } };",
    )));
    activity.seen(&[(0.0, 0.0); 5]);
    assert_eq!(activity.goal(), Some((4.0, 5.0)));
}

#[test]
fn a_failed_script_is_the_reason_of_the_abort() {
    let mut activity = Activity::new(&plan(&visit(NEAREST)));
    let failed = error(activity.seen(&[]));
    assert_eq!(failed.kind, ScriptErrorKind::Failed);
    assert!(failed.why.starts_with("line 2 of the script: array index 0 out of bounds"), "{}", failed.why);
    let mut activity = Activity::new(&plan(&visit("goal = script { loop {} };")));
    assert_eq!(error(activity.seen(&[])).kind, ScriptErrorKind::Budget);
    assert!(activity.state.is_idle());
}

/// An error ends only its own block, and the activity may be started again.
#[test]
fn an_activity_with_a_failed_script_may_start_again() {
    let mut activity = Activity::new(&plan(&visit("goal = script { places[0] };")));
    error(activity.seen(&[]));
    activity.take(Event::Start(Value::EMPTY));
    let value = Value::tagged("seen", &postcard::to_allocvec(&[(1.0, 2.0)]).unwrap()).unwrap();
    // A list of one place.
    let value = Value::tagged("seen", &[&[1], &value.bytes()[5..]].concat()).unwrap();
    activity.take(Event::Done { member: 0, activation: Activation(2), value });
    assert_eq!(activity.goal(), Some((1.0, 2.0)));
}

/// Rule 85.
#[test]
fn one_reaction_runs_a_few_scripts() {
    let many = |count: usize| visit(&"goal = script { places[0] };".repeat(count));
    let mut activity = Activity::new(&plan(&many(4)));
    assert_eq!(activity.seen(&[(1.0, 2.0)]), None);
    let mut activity = Activity::new(&plan(&many(5)));
    let error = error(activity.seen(&[(1.0, 2.0)]));
    assert_eq!((error.kind, &*error.why), (ScriptErrorKind::Budget, "more than 4 scripts in one reaction"));
    // Each reaction has its own budget.
    let spec = plan(&visit(NEAREST));
    let mut activity = Activity::new(&spec);
    let chart = spec.groups.iter().find_map(|group| {
        let Expression::Chart(chart) = &group.expression else { return None };
        Some(chart)
    });
    for _ in 0..20 {
        assert_eq!(activity.take(chart.unwrap().message("words", "hello", 0).unwrap()), None);
        let sent = activity.commands.iter().find_map(|command| {
            let Command::Send { value, .. } = command else { return None };
            value.text().map(str::to_owned)
        });
        assert_eq!(sent.as_deref(), Some("hello!"));
    }
}

#[test]
fn an_explorer_assumes_results_and_failures() {
    let plan = plan(&visit("goal = script { loop {} };"));
    let assumed = |failure: Option<ScriptErrorKind>| {
        let mut activity = Activity::new(&plan);
        activity.program = activity.program.with_scripts(Scripts::Assumed);
        failure.into_iter().for_each(|failure| activity.state.fail_script(failure));
        activity.seen(&[])
    };
    assert_eq!(assumed(None), None);
    for kind in ScriptErrorKind::ALL {
        assert_eq!(error(assumed(Some(kind))).kind, kind);
    }
}

#[test]
fn a_simulation_runs_the_scripts_whose_values_it_knows() {
    let plan = plan(&visit(NEAREST));
    let mut simulation = Simulation::start(&plan);
    simulation.obey("message words good morning").unwrap();
    let seen = simulation.take_happenings();
    let is_it =
        |transition: &Transition| matches!(transition, Transition::Says(said) if said.contains("good morning!"));
    assert!(seen.iter().any(|event| is_it(&event.transition)), "{seen:?}");
    for line in ["look done seen", "goto"] {
        simulation.obey(line).unwrap();
    }
    assert_eq!(simulation.outcome(), Some(&Transition::Done));
}

#[test]
fn a_group_chooses_by_the_reason() {
    for (script, name) in [("loop {}", "home"), ("throw 1", "cry")] {
        let text = visit("goal = script { SCRIPT };")
            .replace("SCRIPT", script)
            .replace("on done(seen places)", "on message words");
        let text = text.replacen("on message words {{ kept", "on signal none {{ kept", 1);
        let plan = plan(&text);
        let mut simulation = Simulation::start(&plan);
        simulation.obey("message words now").unwrap();
        simulation.obey("look stopped").unwrap_err();
        simulation.obey(name).unwrap_or_else(|error| panic!("{script}: {error}"));
        assert_eq!(simulation.outcome(), Some(&Transition::Done), "{script}");
    }
    assert_eq!(Failure::of_word("script_budget"), Some(Failure::ScriptBudget));
    for failure in [Failure::ScriptBudget, Failure::ScriptFailed] {
        assert_eq!(Failure::of_report(&failure.report()), failure);
    }
}

#[test]
fn the_text_of_a_script_is_kept() {
    let script = "{\n  let a   =  `}` ;  // kept }\n\tif a==\"{\"{1}else{2}\n}";
    let text = format!(
        "activity A(h:Host){{ var n:opaque   Number=(); state s{{ on entry{{ n=script{script};n  =  script   {{ 1 }} ;}} }} }}"
    );
    let formatted = format(&Source::new("a.dca", text.as_str())).unwrap();
    assert!(formatted.contains(&format!("n = script {script};\n")), "{formatted}");
    assert!(
        formatted.contains("n = script { 1 };\n") && formatted.contains("var n: opaque Number = ();"),
        "{formatted}"
    );
    assert_eq!(format(&Source::new("a.dca", formatted.as_str())), Ok(formatted.clone()));
}

/// A plan of a hostile peer has scripts that the checker refuses, or numbers that stand for nothing.
#[test]
fn a_hostile_plan_is_refused_or_harmless() {
    let good = plan(&visit(NEAREST));
    let change = |change: &dyn Fn(&mut language::automaton::Chart)| {
        let mut plan = good.clone();
        for group in &mut plan.groups {
            if let Expression::Chart(chart) = &mut group.expression {
                change(&mut chart.chart);
            }
        }
        plan
    };
    let is_refused = |plan: &Plan| plan.validate().is_err();
    assert!(is_refused(&change(&|chart| chart.scripts.clear())));
    assert!(is_refused(&change(&|chart| chart.scripts[0].text = " ".repeat(9_000))));
    assert!(is_refused(&change(&|chart| {
        let input = chart.scripts[0].inputs[0].clone();
        chart.scripts[0].inputs = vec![input; 40];
    })));
    assert!(is_refused(&change(&|chart| {
        for action in chart.transitions.iter_mut().flat_map(|transition| &mut transition.actions) {
            if let Action::Compute { slot, .. } = action {
                *slot = 99;
            }
        }
    })));
    for text in ["", "}", "import \"a\"; 1", "let \u{0}", "places.x"] {
        let plan = change(&|chart| chart.scripts[0].text = text.to_owned());
        assert_eq!(plan.validate(), Ok(()));
        let mut activity = Activity::new(&plan);
        let outcome = activity.seen(&[]);
        assert!(outcome.is_none() && text.is_empty() || error(outcome).kind == ScriptErrorKind::Failed, "{text}");
    }
}
