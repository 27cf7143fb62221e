//! Tests of containers in virtual time: single stories, and all kinds of containers against a model.

use super::*;
use crate::logic::peer::{Fate, Peer};

const WITHIN: Duration = Duration::from_secs(10);
const THERE: Input = Input::Services { are_there: true };
const AWAY: Input = Input::Services { are_there: false };

fn at(millis: u64) -> Time {
    Time::from_nanos(millis * 1_000_000)
}

fn wanted(count: usize) -> Vec<Wanted> {
    let one = |index: usize| Wanted { shown: format!("component `c{index}`"), node: format!("/c{index}") };
    (0..count).map(one).collect()
}

/// A container, and the number of its last request.
struct Story {
    container: Container,
    now: u64,
    number: u32,
}

impl Story {
    fn new() -> Self {
        Self { container: Container::new("/box".to_owned(), wanted(2), WITHIN, at(0)), now: 0, number: 0 }
    }

    /// Returns a container that gets its first request to load a component.
    fn started() -> Self {
        let mut story = Self::new();
        story.expect(AWAY, &["list"]);
        story.listed(None, &["start"]);
        story.expect(AWAY, &[]);
        story.expect(THERE, &["load 0"]);
        story
    }

    /// Returns a container whose components are loaded.
    fn loaded() -> Self {
        let mut story = Self::started();
        story.answered(Answer::Done { id: 1 }, &["load 1"]);
        assert_eq!((story.container.standing(), story.container.loaded()), (&Standing::Underway, 1));
        story.answered(Answer::Done { id: 2 }, &[]);
        assert_eq!((story.container.standing(), story.container.loaded()), (&Standing::Reached, 2));
        story
    }

    #[track_caller]
    fn expect(&mut self, input: Input, expected: &[&str]) {
        let mut effects = Vec::new();
        self.container.handle(at(self.now), input, &mut effects);
        let words = effects.iter().map(|effect| match effect {
            Effect::Start => "start".to_owned(),
            Effect::List { number } => {
                self.number = *number;
                "list".to_owned()
            }
            Effect::Load { number, component } => {
                self.number = *number;
                format!("load {component}")
            }
        });
        assert_eq!(words.collect::<Vec<_>>(), expected);
    }

    #[track_caller]
    fn answered(&mut self, answer: Answer, expected: &[&str]) {
        self.expect(Input::Loaded { number: self.number, answer }, expected);
    }

    #[track_caller]
    fn listed(&mut self, components: Option<&[(u64, &str)]>, expected: &[&str]) {
        let one = |(id, node): &(u64, &str)| Loaded { id: *id, node: (*node).to_owned() };
        let components = components.map(|all| all.iter().map(one).collect());
        self.expect(Input::Listed { number: self.number, components }, expected);
    }

    #[track_caller]
    fn failed(&self, why: &str) {
        assert_eq!(self.container.standing(), &Standing::Failed(format!("container `/box`: {why}")));
    }
}

#[test]
fn components_are_loaded_in_order_and_stay() {
    let mut story = Story::loaded();
    story.now += 999;
    story.expect(THERE, &[]);
    story.now += 1;
    story.expect(THERE, &["list"]);
    story.listed(Some(&[(2, "/c1"), (1, "/c0"), (7, "/other")]), &[]);
    story.now += 1000;
    story.expect(THERE, &["list"]);
    story.listed(Some(&[(1, "/c0"), (3, "/c1")]), &[]);
    story.failed("component `c1` is not loaded any more: another client, or the container itself, has unloaded it");
    story.now += 1000;
    story.expect(THERE, &[]);
}

#[test]
fn a_component_that_is_not_loaded_is_named_with_the_reason() {
    for (answer, why) in [
        (Answer::Failed { why: "no such class".to_owned() }, "no such class"),
        (Answer::Failed { why: String::new() }, "the container gives no reason; its output may say why"),
        (Answer::Done { id: 0 }, "the container gives the number 0, which no new component can have"),
        (Answer::Done { id: 1 }, "the container gives the number 1, which no new component can have"),
    ] {
        let mut story = Story::started();
        story.answered(Answer::Done { id: 1 }, &["load 1"]);
        story.answered(answer, &[]);
        story.failed(&format!("component `c1` was not loaded: {why}"));
    }
}

#[test]
fn a_lost_request_is_repeated_only_if_the_component_is_not_there() {
    for (listed, next) in [(&[(5, "/c0")][..], "load 1"), (&[(5, "/c1")], "load 0"), (&[], "load 0")] {
        let mut story = Story::started();
        story.answered(Answer::Missing, &[]);
        story.now += 200;
        story.expect(THERE, &["list"]);
        story.listed(None, &[]);
        story.now += 200;
        story.expect(THERE, &["list"]);
        story.listed(Some(listed), &[next]);
    }
    // An answer to the first request is too late: the second request is under way.
    let mut story = Story::started();
    let first = story.number;
    story.answered(Answer::Missing, &[]);
    story.now += 200;
    story.expect(THERE, &["list"]);
    story.listed(Some(&[]), &["load 0"]);
    story.expect(Input::Loaded { number: first, answer: Answer::Done { id: 9 } }, &[]);
    assert_eq!(story.container.loaded(), 0);
}

#[test]
fn a_late_answer_is_not_a_death() {
    let mut story = Story::started();
    story.now = 9_999;
    story.expect(THERE, &[]);
    story.answered(Answer::Done { id: 1 }, &["load 1"]);
    story.answered(Answer::Done { id: 2 }, &[]);
    assert_eq!(story.container.standing(), &Standing::Reached);
    story.now += 1000;
    story.expect(THERE, &["list"]);
    story.now += 9_999;
    story.expect(AWAY, &[]);
    assert_eq!(story.container.standing(), &Standing::Reached);
    story.now += 1;
    story.expect(AWAY, &[]);
    story.failed("it has not listed its components for 10 s");
}

#[test]
fn a_container_that_never_answers_fails_when_its_time_is_over() {
    let mut story = Story::started();
    story.now = 10_000;
    story.expect(THERE, &[]);
    story.failed("component `c0` was not loaded within 10 s: the container has not answered the request");
    let mut story = Story::started();
    story.answered(Answer::Missing, &[]);
    story.now = 10_000;
    story.expect(THERE, &[]);
    story.failed("component `c0` was not loaded within 10 s: the container does not list its components");
    let mut story = Story::started();
    story.answered(Answer::Missing, &[]);
    story.now = 200;
    story.expect(THERE, &["list"]);
    story.listed(Some(&[]), &["load 0"]);
    story.answered(Answer::Missing, &[]);
    story.now = 10_000;
    story.expect(THERE, &[]);
    let why = "the container lists its components, but gives no answer to this request that can be read";
    story.failed(&format!("component `c0` was not loaded within 10 s: {why}"));
    let mut story = Story::new();
    story.expect(AWAY, &["list"]);
    story.listed(None, &["start"]);
    story.now = 10_000;
    story.expect(AWAY, &[]);
    story.failed(
        "its service `/box/_container/load_node` is not there after 10 s; is the program a container of components, does it have this \
         name, and does it use `rmw_zenoh_cpp`?",
    );
}

#[test]
fn an_answer_to_an_earlier_container_is_not_taken() {
    let mut story = Story::new();
    story.container = story.container.after(7);
    story.expect(AWAY, &["list"]);
    assert_eq!((story.number, story.container.number()), (8, 8));
    for number in 1..=7 {
        story.expect(Input::Listed { number, components: None }, &[]);
    }
    story.listed(None, &["start"]);
}

#[test]
fn the_program_is_not_started_beside_a_container_of_its_name() {
    let mut story = Story::new();
    story.expect(THERE, &[]);
    story.now = 5_000;
    story.expect(AWAY, &["list"]);
    story.listed(Some(&[]), &[]);
    story.now = 5_200;
    story.expect(AWAY, &["list"]);
    story.listed(None, &["start"]);
    let mut story = Story::new();
    story.expect(THERE, &[]);
    story.now = 10_000;
    story.expect(THERE, &[]);
    story.failed("another container of this name still runs after 10 s");
}

/// A container of ROS 2.
struct Model {
    peer: Peer<Effect>,
    /// The components that it has loaded.
    nodes: Vec<Loaded>,
    last: u64,
}

impl Model {
    fn new(seed: u64) -> Self {
        Self { peer: Peer::new(seed, [0, 0, 10, 100], [0, 50, 1000, 30_000]), nodes: Vec::new(), last: 0 }
    }

    /// Returns the answers that are due.
    fn answers(&mut self, now: u64) -> Vec<Input> {
        let mut answers = Vec::new();
        while let Some((effect, Fate { is_lost, is_unanswered })) = self.peer.due(now) {
            answers.push(match effect {
                Effect::Start => continue,
                Effect::List { number } => {
                    let components = Some(self.nodes.clone()).filter(|_| !is_lost && !is_unanswered);
                    Input::Listed { number, components }
                }
                Effect::Load { number, component } => {
                    let answer = if is_lost { Answer::Missing } else { self.load(component) };
                    Input::Loaded { number, answer: if is_unanswered { Answer::Missing } else { answer } }
                }
            });
        }
        answers
    }

    fn load(&mut self, component: usize) -> Answer {
        if self.peer.fails() {
            return Answer::Failed { why: "it cannot".to_owned() };
        }
        self.last += 1;
        self.nodes.push(Loaded { id: self.last, node: format!("/c{component}") });
        Answer::Done { id: self.last }
    }
}

/// Answers that are late, lost, failures or missing: the outcome arrives in time, and no component is loaded twice.
#[test]
fn every_kind_of_container_has_an_outcome_in_time() {
    let (mut reached, mut failed) = (0, 0);
    for seed in 0..400 {
        let (mut model, mut now) = (Model::new(seed), 0);
        let count = 1 + usize::try_from(seed % 4).unwrap();
        let mut container = Container::new("/box".to_owned(), wanted(count), WITHIN, at(0));
        let (mut is_started, mut effects) = (false, Vec::new());
        container.handle(at(now), AWAY, &mut effects);
        while container.standing() == &Standing::Underway {
            assert!(now <= 10_100, "seed {seed}: the outcome is late");
            for effect in std::mem::take(&mut effects) {
                match effect {
                    Effect::Start => is_started = true,
                    Effect::List { number } if !is_started => {
                        container.handle(at(now), Input::Listed { number, components: None }, &mut effects);
                    }
                    Effect::List { .. } | Effect::Load { .. } => model.peer.take(now, effect),
                }
            }
            now += 10;
            let mut inputs = model.answers(now);
            if now.is_multiple_of(100) {
                inputs.push(Input::Services { are_there: is_started });
            }
            for input in inputs {
                container.handle(at(now), input, &mut effects);
            }
        }
        let mut nodes: Vec<&str> = model.nodes.iter().map(|loaded| loaded.node.as_str()).collect();
        let all = nodes.len();
        nodes.dedup();
        assert_eq!(all, nodes.len(), "seed {seed}: {nodes:?}");
        if container.standing() == &Standing::Reached {
            reached += 1;
            let expected: Vec<String> = wanted(count).into_iter().map(|wanted| wanted.node).collect();
            assert_eq!(nodes, expected, "seed {seed}");
        } else {
            failed += 1;
            assert!(!model.peer.is_well(1000), "seed {seed}: {:?}", container.standing());
        }
    }
    assert!(reached > 100 && failed > 100, "{reached} reached, {failed} failed");
}
