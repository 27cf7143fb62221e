//! Tests of goals on virtual time.

use super::*;
use Effect::{AskResult, Send};

fn at(millis: u64) -> Time {
    Time::from_nanos(millis * 1_000_000)
}

const THERE: Input = Input::Server { is_there: true };
const AWAY: Input = Input::Server { is_there: false };
const TAKEN: Input = Input::Answered { is_accepted: true };
const REJECTED: Input = Input::Answered { is_accepted: false };
const CANCEL: Effect = Effect::Cancel { number: 1 };
const CANCEL_AGAIN: Effect = Effect::Cancel { number: 2 };
/// The reasons why a goal may go on.
const REFUSES: &str = "its server refuses to cancel the goal";
const CANCELS: &str = "its server is canceling the goal, and has not ended it";
const NOT_TAKEN: &str = "its server has not said whether it accepts the goal, and may begin the goal later";
const NO_ANSWER: &str = "the request to cancel the goal has no answer";
const NOT_REACHED: &str = "its server cannot be reached";

fn ended(status: Status) -> Input {
    Input::Result { status, result: vec![7] }
}

fn canceled(answer: CancelAnswer) -> Input {
    Input::Cancel { number: 1, answer }
}

fn lost() -> Input {
    Input::NotAnswered { why: "x".to_owned() }
}

/// Handles inputs, one every 10 ms; returns the effects and the goal.
fn play(inputs: &[Input]) -> (Vec<Effect>, Goal) {
    let (mut goal, mut effects) = (Goal::new("/go".to_owned(), at(0)), Vec::new());
    for (step, input) in (1..).zip(inputs) {
        goal.handle(at(10 * step), input.clone(), &mut effects);
    }
    (effects, goal)
}

/// Checks the effects, the ending, and whether the goal is over or may go on for a reason.
#[track_caller]
fn check(inputs: &[Input], effects: &[Effect], ending: Option<Ending>, goes_on: Result<(), &str>) {
    let (found, goal) = play(inputs);
    assert_eq!((found.as_slice(), goal.ending()), (effects, ending.as_ref()));
    let told = goes_on.err().map(|why| format!("the goal of action `/go` may go on in ROS 2: {why}"));
    assert_eq!((goal.is_over(), goal.may_go_on()), (told.is_none(), told));
}

fn aborted(why: &str) -> Option<Ending> {
    Some(Ending::Aborted(format!("action `/go`: {why}")))
}

const STOPPED: Option<Ending> = Some(Ending::Stopped);

#[test]
fn a_goal_is_sent_taken_and_done() {
    let all = [AWAY, THERE, THERE, TAKEN, THERE, ended(Status::Succeeded)];
    check(&all, &[Send, AskResult], Some(Ending::Done(vec![7])), Ok(()));
    for end in 0..all.len() {
        let (effects, goal) = play(&all[..end]);
        let expected = &[Send, AskResult][..usize::from(end > 1) + usize::from(end > 3)];
        assert_eq!((effects.as_slice(), goal.ending(), goal.is_over()), (expected, None, false));
    }
    let rejected = Some(Ending::Aborted("the server of `/go` has rejected the goal".to_owned()));
    check(&[THERE, REJECTED], &[Send], rejected, Ok(()));
    for (status, why) in [
        (Status::Aborted, "its server has aborted the goal"),
        (Status::Canceled, "another client has canceled the goal"),
    ] {
        check(&[THERE, TAKEN, ended(status)], &[Send, AskResult], aborted(why), Ok(()));
    }
}

#[test]
fn a_stop_cancels_the_goal_and_waits_for_its_end() {
    let effects = [Send, AskResult, CANCEL];
    check(&[AWAY, Input::Stop], &[], STOPPED, Ok(()));
    for end in [Status::Canceled, Status::Succeeded, Status::Aborted] {
        let stopped = [THERE, TAKEN, Input::Stop, Input::Stop, canceled(CancelAnswer::Accepted), ended(end)];
        check(&stopped, &effects, STOPPED, Ok(()));
        check(&stopped[..5], &effects, STOPPED, Err(CANCELS));
        check(&stopped[..4], &effects, STOPPED, Err(NO_ANSWER));
    }
    check(&[THERE, TAKEN, Input::Stop, canceled(CancelAnswer::Ended)], &effects, STOPPED, Ok(()));
    check(&[THERE, TAKEN, Input::Stop, canceled(CancelAnswer::Unknown)], &effects, STOPPED, Ok(()));
    check(&[THERE, TAKEN, Input::Stop, canceled(CancelAnswer::Refused)], &effects, STOPPED, Err(REFUSES));
    check(&[THERE, TAKEN, Input::Stop, AWAY], &effects, STOPPED, Err(NOT_REACHED));
    // Such an answer does not end the goal.
    check(&[THERE, TAKEN, Input::Stop, ended(Status::Other(2))], &effects, STOPPED, Err(NO_ANSWER));
}

#[test]
fn a_stop_before_the_goal_is_taken_cancels_it_at_once_and_again() {
    check(&[THERE, Input::Stop], &[Send, CANCEL], STOPPED, Err(NOT_TAKEN));
    check(&[THERE, Input::Stop, REJECTED], &[Send, CANCEL], STOPPED, Ok(()));
    let unknown = [THERE, Input::Stop, canceled(CancelAnswer::Unknown)];
    check(&unknown, &[Send, CANCEL], STOPPED, Err(NOT_TAKEN));
    let taken = [&unknown[..], &[TAKEN]].concat();
    check(&taken, &[Send, CANCEL, AskResult, CANCEL_AGAIN], STOPPED, Err(NO_ANSWER));
    // The server may have sent the answer to the first request before it knew the goal.
    let early = [THERE, Input::Stop, TAKEN, canceled(CancelAnswer::Unknown)];
    check(&early, &[Send, CANCEL, AskResult, CANCEL_AGAIN], STOPPED, Err(NO_ANSWER));
    let over = [&early[..], &[ended(Status::Canceled)]].concat();
    check(&over, &[Send, CANCEL, AskResult, CANCEL_AGAIN], STOPPED, Ok(()));
    // By now the server has handled the request to accept the goal.
    let lost = [&unknown[..], &[lost()]].concat();
    check(&lost, &[Send, CANCEL, CANCEL_AGAIN], STOPPED, Err(NO_ANSWER));
    let answer = CancelAnswer::Unknown;
    let over = [&lost[..], &[Input::Cancel { number: 2, answer }]].concat();
    check(&over, &[Send, CANCEL, CANCEL_AGAIN], STOPPED, Ok(()));
}

#[test]
fn a_process_that_cannot_follow_its_goal_cancels_it() {
    let effects = [Send, AskResult, CANCEL];
    let bad = Input::BadResult { why: "x".to_owned() };
    for (input, why) in [
        (ended(Status::Other(2)), "its server has answered with status 2, which is not the end of a goal"),
        (ended(Status::Unknown), "its server does not know the goal any more"),
        (bad, "its result cannot be read: x"),
    ] {
        let failed = [THERE, TAKEN, input];
        check(&failed, &effects, aborted(why), Err(NO_ANSWER));
        let stopped = [&failed[..], &[Input::Stop, canceled(CancelAnswer::Accepted)]].concat();
        check(&stopped, &effects, aborted(why), Err(CANCELS));
        let (mut effects, mut goal) = play(&stopped);
        goal.handle(at(240), THERE, &mut effects);
        assert_eq!(effects, [Send, AskResult, CANCEL, AskResult], "it waits for the end");
        goal.handle(at(250), ended(Status::Canceled), &mut effects);
        assert_eq!((goal.is_over(), goal.ending().cloned()), (true, aborted(why)));
    }
    let why = "the goal was sent and has no answer: x";
    check(&[THERE, lost(), TAKEN], &[Send, CANCEL], aborted(why), Err(NO_ANSWER));
    check(&[THERE, lost(), canceled(CancelAnswer::Unknown)], &[Send, CANCEL], aborted(why), Ok(()));
    // The server has accepted the goal after all.
    let taken = [THERE, lost(), canceled(CancelAnswer::Accepted)];
    check(&taken, &[Send, CANCEL, AskResult], aborted(why), Err(CANCELS));
    let over = [&taken[..], &[ended(Status::Canceled)]].concat();
    check(&over, &[Send, CANCEL, AskResult], aborted(why), Ok(()));
}

#[test]
fn a_request_to_cancel_that_is_lost_is_repeated() {
    let (mut effects, mut goal) = play(&[THERE, TAKEN, Input::Stop, canceled(CancelAnswer::Missing)]);
    goal.handle(at(239), THERE, &mut effects);
    goal.handle(at(240), AWAY, &mut effects);
    assert_eq!(effects, [Send, AskResult, CANCEL]);
    goal.handle(at(250), THERE, &mut effects);
    assert_eq!(effects, [Send, AskResult, CANCEL, CANCEL_AGAIN]);
    goal.handle(at(260), Input::Cancel { number: 2, answer: CancelAnswer::Ended }, &mut effects);
    assert!(goal.is_over());
}

#[test]
fn a_server_that_is_not_there_is_told() {
    let (mut goal, mut effects) = (Goal::new("/go".to_owned(), at(0)), Vec::new());
    goal.handle(at(4999), AWAY, &mut effects);
    assert_eq!(goal.ending(), None);
    goal.handle(at(5000), AWAY, &mut effects);
    assert_eq!(goal.ending().cloned(), aborted("no node of ROS 2 serves it within 5 s"));
    assert_eq!((effects, goal.may_go_on()), (vec![], None));
}

#[test]
fn a_lost_result_is_asked_for_again_until_the_server_stays_away() {
    let (mut effects, mut goal) = play(&[THERE, TAKEN, Input::NoResult, AWAY, THERE]);
    assert_eq!(effects, [Send, AskResult]);
    goal.handle(at(231), THERE, &mut effects);
    goal.handle(at(240), THERE, &mut effects);
    assert_eq!(effects, [Send, AskResult, AskResult]);
    goal.handle(at(250), Input::NoResult, &mut effects);
    goal.handle(at(5239), AWAY, &mut effects);
    assert_eq!((goal.ending(), effects.len()), (None, 3));
    goal.handle(at(5240), AWAY, &mut effects);
    assert_eq!(goal.ending().cloned(), aborted("its server has been away for 5 s"));
    assert!(goal.may_go_on().is_some_and(|told| told.ends_with(NOT_REACHED)));
    assert_eq!(effects.last(), Some(&CANCEL));
}

#[test]
fn a_server_that_never_answers_for_the_result_is_given_up() {
    let (mut effects, mut goal) = play(&[THERE, TAKEN]);
    let (mut now, mut answered) = (20, 0);
    while goal.ending().is_none() && now < 60_000 {
        now += 10;
        goal.handle(at(now), THERE, &mut effects);
        let asked = effects.iter().filter(|effect| **effect == AskResult).count();
        if asked > answered {
            answered = asked;
            goal.handle(at(now), Input::NoResult, &mut effects);
        }
    }
    let why = "its server has left 10 questions for the result without an answer";
    assert_eq!(goal.ending().cloned(), aborted(why));
    assert!((20_000..40_000).contains(&now), "{now} ms");
}

#[test]
fn answers_that_make_no_sense_change_nothing() {
    let (effects, goal) = play(&[TAKEN, ended(Status::Succeeded), Input::NoResult, canceled(CancelAnswer::Ended)]);
    assert_eq!((effects, goal.ending(), goal.is_over()), (vec![], None, false));
    let (effects, goal) = play(&[THERE, ended(Status::Succeeded), TAKEN, TAKEN, canceled(CancelAnswer::Ended)]);
    assert_eq!((effects, goal.ending(), goal.is_over()), (vec![Send, AskResult], None, false));
}
