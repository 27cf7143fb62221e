//! Triggers from outside of an activity, and ends of single instances, from the text to the simulation.

use language::{Options, Simulation, Source, compile};

const MODULES: &str = "
module Work(host, speed: Number = 1) { done(found | missing); }
module Go(host) { done; }
";

/// The reports of an activity with this body to people, after these lines.
fn told(body: &str, lines: &[&str]) -> Vec<String> {
    let text = format!(
        "{MODULES}
activity A(h: Host, far: Host){{
    host{{h}}
    look instof Work(h);
    walk instof Go(far);
    one instof Go(h);
    {body}
}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ a instof A(\"c1\", \"c2\"); }}
    internal_event_actions{{ a }}
}}"
    );
    let compiled = compile(&Source::new("a.dca", &text), &[], &Options::named("a"));
    let plan = compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics));
    let mut simulation = Simulation::start(&plan);
    for line in lines {
        simulation.obey(line).unwrap_or_else(|error| panic!("{line}: {error}"));
    }
    let happenings = simulation.take_happenings();
    let shown = happenings.iter().filter(|event| event.path != "main").map(|event| {
        let name = event.path.strip_prefix("main/").unwrap_or(&event.path);
        format!("{name} {:?}", event.transition).replace("Says(\"", "").replace("\")", "").replace('`', "")
    });
    shown.skip(1).collect()
}

#[test]
fn the_end_of_one_instance_leads_on_while_the_others_run() {
    let body =
        "initial state s { run look, walk; on look.done -> t; on done -> done; } state t { run one; on done -> done; }";
    let expected = [
        "a/look Started",
        "a/walk Started",
        "a is in s",
        "a/look Done",
        "a/walk Stopped",
        "a/one Started",
        "a is in t",
        "a/one Done",
        "a Done",
    ];
    assert_eq!(told(body, &["look done found", "one"]), expected);
}

/// The end that ends the run as well is first the end of the instance.
#[test]
fn the_last_end_of_a_run_is_first_that_of_its_instance() {
    let body =
        "initial state s { run look, walk; on look.done -> t; on done -> done; } state t { run one; on done -> done; }";
    let found = told(body, &["walk", "look done found"]);
    assert_eq!(found[3..], ["a/walk Done", "a/look Done", "a/one Started", "a is in t"]);
    // Without a target the end of the run is heard as well.
    let body = "initial state s { run look, walk; on look.done { log(\"seen\"); } on done -> done; }";
    let found = told(body, &["walk", "look done found"]);
    assert_eq!(found[3..], ["a/walk Done", "a/look Done", "a says: seen", "a Done"]);
}

#[test]
fn a_failure_that_the_expression_takes_is_heard_as_well() {
    let body = "initial state s { run (look else one); on look.aborted { log(\"blind\"); } on done -> done; }";
    let found = told(body, &["look abort dark", "one"]);
    assert_eq!(found[2..5], ["a/look Aborted(\"dark", "a/one Started", "a says: blind"]);
    assert_eq!(found.last().map(String::as_str), Some("a Done"));
}

/// Regions hear the ends of each other's instances.
#[test]
fn the_end_of_an_instance_is_heard_in_every_region() {
    let body = "initial parallel state both {
        state l { initial state a { run look; on done -> b; } final state b; }
        state r { initial state c { run walk; on look.done -> d; } final state d; }
        on complete -> done;
    }";
    let found = told(body, &["look done missing"]);
    assert_eq!(found[3..], ["a/look Done", "a/walk Stopped", "a Done"]);
}

#[test]
fn people_suspend_and_resume() {
    let body = "initial state s { run look; on done -> done; } suspended state paused { on resume -> resume; } on suspend -> paused;";
    let expected = [
        "a/look Started",
        "a is in s",
        "a/look Stopped",
        "a is in paused",
        "a/look Started",
        "a is in s",
        "a/look Done",
        "a Done",
    ];
    assert_eq!(told(body, &["suspend", "resume", "look"]), expected);
}

#[test]
fn losses_and_parameters_are_told_of() {
    let body =
        "initial state s { run look; on link far lost -> t; on parameter look.speed changed { log(\"faster\"); } }
                state t { on host far lost -> done; on host \"c9\" lost -> s; on after 1 s -> s; }";
    let found =
        told(body, &["parameter look.speed changed", "link c2 lost", "host c9 lost", "link c2 lost", "host c2 lost"]);
    let expected = [
        "a/look Started",
        "a is in s",
        "a says: faster",
        "a/look Stopped",
        "a Waits(1s)",
        "a is in t",
        "a/look Started",
        "a is in s",
        "a/look Stopped",
        "a Waits(1s)",
        "a is in t",
        "a Done",
    ];
    assert_eq!(found, expected);
}

#[test]
fn a_question_waits_for_an_answer() {
    let body = "initial state s { run look; on done confirm operator \"Go on?\" options(yes -> t, no -> s) default no after 5 s; }
                state t { run one; on done -> done; }";
    let expected = [
        "a/look Started",
        "a is in s",
        "a/look Done",
        "a Waits(5s)",
        "a is in s?",
        "a asks: Go on? (yes, no; no after 5 s)",
        "a/look Started",
        "a is in s",
        "a/look Done",
        "a Waits(5s)",
        "a is in s?",
        "a asks: Go on? (yes, no; no after 5 s)",
        "a/one Started",
        "a is in t",
        "a/one Done",
        "a Done",
    ];
    assert_eq!(told(body, &["look done found", "5 s", "look done found", "answer yes", "one"]), expected);
}

/// A question is withdrawn when its state is left, and cannot be answered any more.
#[test]
fn a_question_that_is_not_open_has_no_answer() {
    let body = "initial state s { run look; on done confirm operator \"Go on?\" options(yes -> done); }
                suspended state paused { on resume -> resume; } on suspend -> paused;";
    let result = std::panic::catch_unwind(|| told(body, &["look done found", "suspend", "answer yes"]));
    let text = result.unwrap_err().downcast::<String>().unwrap();
    assert_eq!(*text, "answer yes: no running activity waits for `answer yes`");
    let found = told(body, &["look done found", "suspend", "resume", "answer yes"]);
    assert_eq!(found.last().map(String::as_str), Some("a Done"));
}
