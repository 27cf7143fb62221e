//! Tests of lifecycles in virtual time: single stories, and all kinds of nodes against a model.

use super::*;
use crate::logic::peer::{Fate, Peer};

const WITHIN: Duration = Duration::from_secs(10);
const THERE: Input = Input::Services { are_there: true };
const AWAY: Input = Input::Services { are_there: false };

fn at(millis: u64) -> Time {
    Time::from_nanos(millis * 1_000_000)
}

/// A lifecycle, and the number of its last request.
struct Story {
    lifecycle: Lifecycle,
    now: u64,
    number: u32,
}

impl Story {
    /// Returns a node that was started and has not answered yet.
    fn started() -> Self {
        let lifecycle = Lifecycle::new("/n".to_owned(), WITHIN, at(0));
        let mut story = Self { lifecycle, now: 0, number: 0 };
        story.expect(AWAY, &["ask"]);
        story.told(None, &["start"]);
        story.expect(AWAY, &[]);
        story.now += 200;
        story.expect(THERE, &["ask"]);
        story
    }

    /// Returns a node that is ready.
    fn ready() -> Self {
        let mut story = Self::started();
        story.told(Some(State::Unconfigured), &["configure"]);
        story.changed(Answer::Done, &[]);
        assert_eq!(story.lifecycle.standing(), &Standing::Reached);
        story
    }

    /// Returns a node that is active.
    fn active() -> Self {
        let mut story = Self::ready();
        story.expect(Input::Want { wanted: Wanted::Active, within: WITHIN }, &["ask"]);
        story.told(Some(State::Inactive), &["activate"]);
        story.changed(Answer::Done, &[]);
        assert_eq!(story.lifecycle.standing(), &Standing::Reached);
        story
    }

    #[track_caller]
    fn expect(&mut self, input: Input, expected: &[&str]) {
        let mut effects = Vec::new();
        self.lifecycle.handle(at(self.now), input, &mut effects);
        let words = effects.iter().map(|effect| match effect {
            Effect::Start => "start".to_owned(),
            Effect::Ask { number } => {
                self.number = *number;
                "ask".to_owned()
            }
            Effect::Change { number, transition } => {
                self.number = *number;
                transition.to_string()
            }
        });
        assert_eq!(words.collect::<Vec<_>>(), expected);
    }

    #[track_caller]
    fn told(&mut self, state: Option<State>, expected: &[&str]) {
        self.expect(Input::Told { number: self.number, state }, expected);
    }

    #[track_caller]
    fn changed(&mut self, answer: Answer, expected: &[&str]) {
        self.expect(Input::Changed { number: self.number, answer }, expected);
    }

    #[track_caller]
    fn failed(&self, why: &str) {
        assert_eq!(self.lifecycle.standing(), &Standing::Failed(format!("node `/n`: {why}")));
    }
}

#[test]
fn a_node_is_configured_activated_and_deactivated() {
    let mut story = Story::active();
    story.expect(Input::Want { wanted: Wanted::Resting, within: WITHIN }, &["ask"]);
    assert_eq!(story.lifecycle.standing(), &Standing::Underway);
    story.told(Some(State::Active), &["deactivate"]);
    story.changed(Answer::Done, &[]);
    assert_eq!(story.lifecycle.standing(), &Standing::Reached);
    // A node at rest does not get requests.
    story.now += 5000;
    story.expect(THERE, &[]);
    story.expect(Input::Want { wanted: Wanted::Active, within: WITHIN }, &["ask"]);
    story.told(Some(State::Inactive), &["activate"]);
}

#[test]
fn an_answer_may_come_at_the_last_moment() {
    let mut story = Story::started();
    story.told(Some(State::Unconfigured), &["configure"]);
    story.now = 9_999;
    story.expect(THERE, &[]);
    assert_eq!(story.lifecycle.standing(), &Standing::Underway);
    story.changed(Answer::Done, &[]);
    assert_eq!(story.lifecycle.standing(), &Standing::Reached);
    let mut late = Story::started();
    late.told(Some(State::Unconfigured), &["configure"]);
    late.now = 10_000;
    late.expect(THERE, &[]);
    late.failed("it has not answered the request to configure in time");
}

#[test]
fn a_failed_transition_is_told_with_the_state_that_follows() {
    let mut story = Story::started();
    story.told(Some(State::Unconfigured), &["configure"]);
    story.changed(Answer::Failed, &["ask"]);
    story.told(Some(State::Between(15)), &[]);
    assert_eq!(story.lifecycle.standing(), &Standing::Underway);
    story.now += 200;
    story.expect(THERE, &["ask"]);
    story.told(Some(State::Unconfigured), &[]);
    story.failed("it has failed to configure, and is unconfigured; its output says why");
    // After an error in `activate` the node may be unconfigured: it is not configured again and again.
    let mut story = Story::ready();
    story.expect(Input::Want { wanted: Wanted::Active, within: WITHIN }, &["ask"]);
    story.told(Some(State::Inactive), &["activate"]);
    story.changed(Answer::Failed, &["ask"]);
    story.told(Some(State::Unconfigured), &[]);
    story.failed("it has failed to activate, and is unconfigured; its output says why");
}

#[test]
fn a_lost_request_is_repeated_only_if_the_node_has_not_done_it() {
    for (state, next) in [(State::Inactive, &["activate"][..]), (State::Active, &[])] {
        let mut story = Story::ready();
        story.expect(Input::Want { wanted: Wanted::Active, within: WITHIN }, &["ask"]);
        story.told(Some(State::Inactive), &["activate"]);
        story.changed(Answer::Missing, &[]);
        story.now += 200;
        story.expect(THERE, &["ask"]);
        story.told(Some(state), next);
        assert!(story.lifecycle.may_activate(), "the first request may be carried out after a stop");
        story.expect(Input::Ended, &[]);
        assert!(!story.lifecycle.may_activate());
    }
    // The node has refused to repeat a transition of another client.
    let mut story = Story::started();
    story.told(Some(State::Unconfigured), &["configure"]);
    story.changed(Answer::Failed, &["ask"]);
    story.told(Some(State::Inactive), &[]);
    assert_eq!(story.lifecycle.standing(), &Standing::Reached);
}

#[test]
fn a_state_that_others_change_is_noticed() {
    for (state, shown) in [(State::Inactive, "inactive"), (State::Unconfigured, "unconfigured")] {
        let mut story = Story::active();
        story.expect(Input::News, &["ask"]);
        story.told(Some(State::Active), &[]);
        story.now += 1000;
        story.expect(THERE, &["ask"]);
        story.told(Some(state), &[]);
        story.failed(&format!("it is {shown}: another client, or the node itself, has changed its state"));
        // The process then stops, and the node already rests.
        story.expect(Input::Want { wanted: Wanted::Resting, within: WITHIN }, &["ask"]);
        story.told(Some(state), &[]);
        assert_eq!(story.lifecycle.standing(), &Standing::Reached);
    }
    let mut story = Story::ready();
    story.expect(Input::Want { wanted: Wanted::Active, within: WITHIN }, &["ask"]);
    story.told(Some(State::Finalized), &[]);
    story.failed("it is finalized: it has been shut down");
}

#[test]
fn a_silent_node_fails_when_its_time_is_over() {
    let mut story = Story::active();
    story.now += 1000;
    story.expect(THERE, &["ask"]);
    story.now += 9_999;
    story.expect(THERE, &[]);
    assert_eq!(story.lifecycle.standing(), &Standing::Reached);
    story.now += 1;
    story.expect(THERE, &[]);
    story.failed("it has not reported its state for 10 s");
    for (are_there, why) in [
        (
            false,
            "its service `/n/change_state` is not there after 10 s; does the node have this name, and a lifecycle, and does it use \
             `rmw_zenoh_cpp`?",
        ),
        (true, "it has not reported its state within 10 s"),
    ] {
        let mut story = Story::started();
        story.now = 10_000;
        story.expect(Input::Services { are_there }, &[]);
        story.failed(why);
    }
}

#[test]
fn the_program_is_not_started_beside_a_node_of_its_name() {
    let lifecycle = Lifecycle::new("/n".to_owned(), WITHIN, at(0));
    let mut story = Story { lifecycle, now: 0, number: 0 };
    story.expect(AWAY, &["ask"]);
    story.told(Some(State::Active), &[]);
    story.expect(THERE, &[]);
    story.now = 9_000;
    story.expect(AWAY, &["ask"]);
    story.told(None, &["start"]);
    let lifecycle = Lifecycle::new("/n".to_owned(), WITHIN, at(0));
    let mut story = Story { lifecycle, now: 0, number: 0 };
    story.expect(THERE, &[]);
    story.now = 10_000;
    story.expect(THERE, &[]);
    story.failed("another node of this name still runs after 10 s");
}

#[test]
fn a_stop_waits_for_an_activation_that_has_no_answer_yet() {
    let mut story = Story::ready();
    story.expect(Input::Want { wanted: Wanted::Active, within: WITHIN }, &["ask"]);
    story.told(Some(State::Inactive), &["activate"]);
    story.expect(Input::Want { wanted: Wanted::Resting, within: WITHIN }, &[]);
    story.changed(Answer::Done, &["deactivate"]);
    story.changed(Answer::Failed, &["ask"]);
    story.told(Some(State::Active), &[]);
    story.failed("it has failed to deactivate, and is active; its output says why");
}

#[test]
fn a_program_that_has_ended_is_started_for_the_next_activation() {
    let mut story = Story::active();
    story.expect(Input::Ended, &[]);
    story.expect(Input::Want { wanted: Wanted::Resting, within: WITHIN }, &[]);
    assert_eq!(story.lifecycle.standing(), &Standing::Reached);
    story.expect(AWAY, &[]);
    story.expect(Input::Want { wanted: Wanted::Active, within: WITHIN }, &["ask"]);
    story.told(None, &["start"]);
    story.now += 200;
    story.expect(THERE, &["ask"]);
    story.told(Some(State::Unconfigured), &["configure"]);
    story.changed(Answer::Done, &["activate"]);
    story.changed(Answer::Done, &[]);
    assert_eq!(story.lifecycle.standing(), &Standing::Reached);
}

/// A node of ROS 2.
struct Model {
    peer: Peer<Effect>,
    state: State,
}

impl Model {
    fn new(seed: u64) -> Self {
        Self { peer: Peer::new(seed, [0, 0, 20, 100], [0, 50, 2000, 30_000]), state: State::Unconfigured }
    }

    /// Returns the answers that are due.
    fn answers(&mut self, now: u64) -> Vec<Input> {
        let mut answers = Vec::new();
        while let Some((effect, Fate { is_lost, is_unanswered })) = self.peer.due(now) {
            answers.push(match effect {
                Effect::Start => continue,
                Effect::Ask { number } => {
                    Input::Told { number, state: Some(self.state).filter(|_| !is_lost && !is_unanswered) }
                }
                Effect::Change { number, transition } => {
                    let done = !is_lost && self.change(transition);
                    let answer = if done { Answer::Done } else { Answer::Failed };
                    Input::Changed { number, answer: if is_lost || is_unanswered { Answer::Missing } else { answer } }
                }
            });
        }
        answers
    }

    fn change(&mut self, transition: Transition) -> bool {
        let fits = matches!(
            (self.state, transition),
            (State::Unconfigured, Transition::Configure)
                | (State::Inactive, Transition::Activate)
                | (State::Active, Transition::Deactivate)
        );
        let done = fits && !self.peer.fails();
        if done {
            self.state = transition.goal();
        }
        done
    }
}

/// Answers that are late, lost, failures or missing, in every order: the outcome arrives in time, and never contradicts the node.
#[test]
fn every_kind_of_node_has_an_outcome_in_time() {
    let (mut reached, mut failed) = (0, 0);
    for seed in 0..400 {
        let (mut model, mut now) = (Model::new(seed), 0);
        let mut lifecycle = Lifecycle::new("/n".to_owned(), WITHIN, at(0));
        let mut is_started = false;
        for wanted in [Wanted::Ready, Wanted::Active, Wanted::Resting, Wanted::Active, Wanted::Resting] {
            let begin = now;
            let mut effects = Vec::new();
            lifecycle.handle(at(now), Input::Want { wanted, within: WITHIN }, &mut effects);
            while lifecycle.standing() == &Standing::Underway {
                assert!(now <= begin + 10_100, "seed {seed}: {wanted:?} has no outcome");
                for effect in effects.drain(..) {
                    match effect {
                        Effect::Start => is_started = true,
                        Effect::Ask { number } if !is_started => {
                            lifecycle.handle(at(now), Input::Told { number, state: None }, &mut Vec::new());
                            is_started = true;
                        }
                        Effect::Ask { .. } | Effect::Change { .. } => model.peer.take(now, effect),
                    }
                }
                now += 10;
                let mut inputs = model.answers(now);
                if now.is_multiple_of(100) {
                    inputs.push(Input::Services { are_there: is_started });
                }
                for input in inputs {
                    lifecycle.handle(at(now), input, &mut effects);
                }
            }
            let right = match wanted {
                Wanted::Ready => State::Inactive,
                Wanted::Active => State::Active,
                Wanted::Resting => State::Inactive,
            };
            match lifecycle.standing() {
                Standing::Failed(_) => {
                    failed += 1;
                    assert!(!model.peer.is_well(999), "seed {seed}: {:?}", lifecycle.standing());
                    break;
                }
                Standing::Reached | Standing::Underway => {
                    reached += 1;
                    assert_eq!(model.state, right, "seed {seed}: {wanted:?}");
                }
            }
        }
    }
    assert!(reached > 200 && failed > 50, "{reached} reached, {failed} failed");
}
