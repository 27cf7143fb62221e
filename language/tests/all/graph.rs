//! Pictures of small specs, compared exactly; `UPDATE_EXPECT=1` rewrites them. Look at them after a change.

use language::{Graph, Options, Source, graph};
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
