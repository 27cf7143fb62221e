//! Pictures of small specs, compared exactly; `UPDATE_EXPECT=1` rewrites them. Look at them after a change.

use language::plan::MemberKind;
use language::{Graph, Options, Source, activities_of_plan, compile, graph, graph_of_activity, graph_of_plan};
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/graph")
}

fn draw(path: &Path) -> Graph {
    let read =
        |path: &Path| Source::new(path.to_string_lossy(), std::fs::read_to_string(path).expect("a spec is text"));
    let interface = folder().join(path.file_name().expect("a spec has a name")).with_extension("interface");
    let interfaces = if interface.exists() { vec![read(&interface)] } else { Vec::new() };
    graph(&read(path), &interfaces, &Options::named("graph")).0.expect("the spec is good")
}

#[test]
fn what_is_wrong_is_visible() {
    let path = folder().join("remarkable.dca");
    let graph = draw(&path);
    expect_test::expect_file![path.with_extension("svg")].assert_eq(&graph.svg());
    expect_test::expect_file![path.with_extension("dot")].assert_eq(&graph.dot());
}

#[test]
fn the_door_looks_like_the_papers_figures() {
    let path = folder().join("../../../specs/door_opening.dca");
    let graph = draw(&path);
    expect_test::expect_file![folder().join("door_opening.svg")].assert_eq(&graph.svg());
    // The layout depends on nothing but the spec.
    assert_eq!(draw(&path).svg(), graph.svg());
}

/// The states of the activity of the manual: nested and parallel states, questions, ends.
#[test]
fn the_states_of_an_activity_are_a_picture() {
    let path = folder().join("states.dca");
    let text = std::fs::read_to_string(&path).expect("a spec is text");
    let spec = Source::new("states.dca", &text);
    let draw = |activity: &str| language::graph_states(&spec, &[], &Options::named("states"), activity).0;
    let graph = draw("Patrol").expect("there is such an activity");
    expect_test::expect_file![path.with_extension("svg")].assert_eq(&graph.svg());
    expect_test::expect_file![path.with_extension("dot")].assert_eq(&graph.dot());
    assert_eq!(draw("main/patrol").map(|graph| graph.svg()), Some(graph.svg()));
    assert!(draw("look").is_none() && draw("main").is_none());
}

/// The pictures of a mission that runs: each box has the key of its process or state, and no name of a stranger is markup.
#[test]
fn a_plan_is_drawn_for_a_page_that_colours_it() {
    let read = |name: &str| Source::new(name, std::fs::read_to_string(folder().join(name)).expect("a spec is text"));
    let plan = |spec: &Source| compile(spec, &[], &Options::named("live")).plan.expect("the spec is good");
    let svg = graph_of_plan(&plan(&read("remarkable.dca"))).expect("it is small").svg();
    expect_test::expect_file![folder().join("remarkable_live.svg")].assert_eq(&svg);
    let patrol = plan(&read("states.dca"));
    let activities: Vec<(usize, &str)> = activities_of_plan(&patrol).collect();
    let &[(number, "main/patrol")] = activities.as_slice() else { panic!("{activities:?}") };
    let svg = graph_of_activity(&patrol, number).expect("it is small").expect("it is an activity").svg();
    expect_test::expect_file![folder().join("states_live.svg")].assert_eq(&svg);
    assert!(graph_of_activity(&patrol, 0).is_ok_and(|graph| graph.is_none()), "`main` is no activity");
    let mut hostile = patrol.clone();
    for group in &mut hostile.groups {
        group.process = "<script>alert(1)</script>\u{1b}[2J\u{202e}\u{0}".to_owned();
    }
    hostile.hosts[0] = "\"><img src=x onerror=alert(1)>".to_owned();
    let svg = graph_of_plan(&hostile).expect("it is sound").svg();
    assert!(!svg.contains("<script") && !svg.contains("<img") && svg.contains("&lt;script&gt;"), "{svg}");
    assert!(!svg.contains(['\u{1b}', '\u{0}', '\u{202e}']), "{svg}");
}

#[test]
fn a_plan_that_is_too_large_or_not_sound_has_no_picture() {
    let spec = |count: usize| {
        let names: Vec<String> = (0..count).map(|number| format!("p{number}")).collect();
        let instances: String = names.iter().map(|name| format!("{name} instof Sleeper(c1); ")).collect();
        let text = format!(
            "module Sleeper(host) {{ exec \"sleep 1\"; plain; done; }}
             process main() {{ host {{ c1 }} instantiated_processes {{ {instances} }} internal_event_actions {{ {} }} }}",
            names.join(", ")
        );
        compile(&Source::new("many.dca", text), &[], &Options::named("many")).plan.expect("the spec is good")
    };
    assert!(graph_of_plan(&spec(199)).is_ok());
    let many = graph_of_plan(&spec(200)).expect_err("main is one more");
    assert_eq!(many.to_string(), "201 boxes are too many for a picture, which has at most 200");
    let mut circle = spec(2);
    circle.groups[0].members[0].kind = MemberKind::Group(0);
    assert!(graph_of_plan(&circle).expect_err("it is not a tree").to_string().starts_with("the plan is not sound: "));
}
