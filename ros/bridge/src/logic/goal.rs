//! One goal of an action of ROS 2, from its request to its end.
//!
//! ```text
//! Looking ──there is a server──▶ Asked ──accepted──▶ Active ──result──▶ Over
//!    └──nothing in time──▶ Over    └──rejected──▶ Over   └──stop──▶ (asks to cancel, and waits for the result)
//! ```
//!
//! A result is asked for again if no answer comes: the router or the server may have been away for a time, and a server keeps
//! results. Only a server that stays away ends the goal.

use comms::logic::time::Time;
use std::time::Duration;

/// How long a server is looked for before the goal is sent.
const LOOK_WITHIN: Duration = Duration::from_secs(5);
/// How long a server may be away while the goal is active.
const AWAY_WITHIN: Duration = Duration::from_secs(5);
/// The pause before a question is asked again.
const AGAIN_AFTER: Duration = Duration::from_millis(200);

/// News for a goal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Input {
    /// Whether a server is there; looked at from time to time.
    Server { is_there: bool },
    /// The server takes the goal, or not.
    Answered { is_accepted: bool },
    /// The request to take it had no valid answer.
    NotAnswered { why: String },
    /// The goal has ended.
    Result { status: Status, result: Vec<u8> },
    /// The question for the result had no answer: it is lost, or the server has gone.
    NoResult,
    /// The answer to a question for the result is not one.
    BadResult { why: String },
    /// The mission stops the goal.
    Stop,
}

/// How a goal has ended. Source: `action_msgs/msg/GoalStatus`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Status {
    Succeeded,
    Canceled,
    Aborted,
    Other(i64),
}

/// A request of a goal to its server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    /// Send the goal.
    Send,
    /// Ask for its result.
    AskResult,
    /// Ask to cancel it.
    Cancel,
}

/// The end of a goal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// It has succeeded, with this result.
    Done(Vec<u8>),
    /// It has failed; why, for a person.
    Aborted(String),
    /// It was stopped by the mission.
    Stopped,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Stage {
    Looking,
    Asked,
    Active,
    Over(Ending),
}

/// A goal.
#[derive(Debug)]
pub(crate) struct Goal {
    action: String,
    stage: Stage,
    is_stopping: bool,
    /// When a server was there last; before the first one, since when it is looked for.
    seen: Time,
    /// When the result is asked for again.
    again: Option<Time>,
}

impl Goal {
    /// Returns a goal for a server of this action, which is looked for from now on.
    pub(crate) fn new(action: String, now: Time) -> Self {
        Self { action, stage: Stage::Looking, is_stopping: false, seen: now, again: None }
    }

    /// Takes an input.
    pub(crate) fn handle(&mut self, now: Time, input: Input, effects: &mut Vec<Effect>) {
        match (&self.stage, input) {
            // An answer that comes late changes nothing.
            (Stage::Over(_), _) => {}
            (Stage::Looking, Input::Stop) => self.end(Ending::Stopped),
            (Stage::Looking, Input::Server { is_there: true }) => {
                (self.stage, self.seen) = (Stage::Asked, now);
                effects.push(Effect::Send);
            }
            (Stage::Looking, Input::Server { is_there: false }) if now >= self.seen + LOOK_WITHIN => {
                let within = LOOK_WITHIN.as_secs();
                self.fail(&format!("no node of ROS 2 serves it within {within} s"));
            }
            (_, Input::Server { is_there }) => self.look(now, is_there, effects),
            (Stage::Asked, Input::Answered { is_accepted: true }) => {
                self.stage = Stage::Active;
                effects.push(Effect::AskResult);
                if self.is_stopping {
                    effects.push(Effect::Cancel);
                }
            }
            (Stage::Asked, Input::Answered { is_accepted: false }) => {
                let ending = Ending::Aborted(format!("the server of `{}` has rejected the goal", self.action));
                self.end(if self.is_stopping { Ending::Stopped } else { ending });
            }
            (Stage::Asked, Input::NotAnswered { why }) => {
                // The server may have taken it without an answer.
                effects.push(Effect::Cancel);
                self.fail(&format!("the goal was sent and has no answer: {why}"));
            }
            (Stage::Active, Input::Result { status, result }) => self.ended(status, result),
            (Stage::Active, Input::NoResult) => self.again = Some(now + AGAIN_AFTER),
            (Stage::Active, Input::BadResult { why }) => self.fail(&format!("its result cannot be read: {why}")),
            (Stage::Asked | Stage::Active, Input::Stop) if self.is_stopping => {}
            (Stage::Asked, Input::Stop) => self.is_stopping = true,
            (Stage::Active, Input::Stop) => {
                self.is_stopping = true;
                effects.push(Effect::Cancel);
            }
            (Stage::Looking | Stage::Asked | Stage::Active, _) => {}
        }
    }

    /// Returns the end of the goal, once it has one.
    pub(crate) fn ending(&self) -> Option<&Ending> {
        if let Stage::Over(ending) = &self.stage { Some(ending) } else { None }
    }

    fn look(&mut self, now: Time, is_there: bool, effects: &mut Vec<Effect>) {
        if is_there {
            self.seen = now;
        } else if now >= self.seen + AWAY_WITHIN {
            return self.fail(&format!("its server has been away for {} s", AWAY_WITHIN.as_secs()));
        }
        if is_there && self.again.is_some_and(|again| now >= again) {
            self.again = None;
            effects.push(Effect::AskResult);
        }
    }

    fn ended(&mut self, status: Status, result: Vec<u8>) {
        let ending = match status {
            // It was faster than the stop.
            Status::Succeeded => Ending::Done(result),
            Status::Canceled if self.is_stopping => Ending::Stopped,
            Status::Canceled => return self.fail("another client has canceled the goal"),
            Status::Aborted => return self.fail("its server has aborted the goal"),
            Status::Other(status) => return self.fail(&format!("the goal has ended with status {status}")),
        };
        self.end(ending);
    }

    fn fail(&mut self, why: &str) {
        let reason = format!("action `{}`: {why}", self.action);
        self.end(if self.is_stopping { Ending::Stopped } else { Ending::Aborted(reason) });
    }

    fn end(&mut self, ending: Ending) {
        self.stage = Stage::Over(ending);
    }
}

impl Status {
    /// Returns the status with this number.
    pub(crate) fn of(number: i64) -> Self {
        match number {
            4 => Self::Succeeded,
            5 => Self::Canceled,
            6 => Self::Aborted,
            other => Self::Other(other),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Time {
        Time::from_nanos(millis * 1_000_000)
    }

    const THERE: Input = Input::Server { is_there: true };
    const AWAY: Input = Input::Server { is_there: false };
    const TAKEN: Input = Input::Answered { is_accepted: true };

    fn ended(status: Status) -> Input {
        Input::Result { status, result: vec![7] }
    }

    /// Plays inputs, one every 10 ms; returns the effects and the goal.
    fn play(inputs: &[Input]) -> (Vec<Effect>, Goal) {
        let (mut goal, mut effects) = (Goal::new("/go".to_owned(), at(0)), Vec::new());
        for (step, input) in (1..).zip(inputs) {
            goal.handle(at(10 * step), input.clone(), &mut effects);
        }
        (effects, goal)
    }

    #[track_caller]
    fn check(inputs: &[Input], effects: &[Effect], ending: Option<Ending>) {
        let (found, goal) = play(inputs);
        assert_eq!((found.as_slice(), goal.ending()), (effects, ending.as_ref()));
    }

    fn aborted(why: &str) -> Option<Ending> {
        Some(Ending::Aborted(why.to_owned()))
    }

    #[test]
    fn a_goal_is_sent_taken_and_done() {
        use Effect::{AskResult, Send};
        let all = [AWAY, THERE, THERE, TAKEN, THERE, ended(Status::Succeeded)];
        check(&all, &[Send, AskResult], Some(Ending::Done(vec![7])));
        for end in 0..all.len() {
            check(&all[..end], &[Send, AskResult][..usize::from(end > 1) + usize::from(end > 3)], None);
        }
        check(
            &[THERE, Input::Answered { is_accepted: false }],
            &[Send],
            aborted("the server of `/go` has rejected the goal"),
        );
        for (status, why) in [
            (Status::Aborted, "its server has aborted the goal"),
            (Status::Canceled, "another client has canceled the goal"),
            (Status::of(2), "the goal has ended with status 2"),
        ] {
            check(&[THERE, TAKEN, ended(status)], &[Send, AskResult], aborted(&format!("action `/go`: {why}")));
        }
    }

    #[test]
    fn a_stop_cancels_the_goal_and_waits_for_its_end() {
        use Effect::{AskResult, Cancel, Send};
        check(&[AWAY, Input::Stop], &[], Some(Ending::Stopped));
        check(&[THERE, Input::Stop, Input::Stop], &[Send], None);
        check(&[THERE, Input::Stop, TAKEN], &[Send, AskResult, Cancel], None);
        check(&[THERE, Input::Stop, Input::Answered { is_accepted: false }], &[Send], Some(Ending::Stopped));
        let stopped = [THERE, TAKEN, Input::Stop, Input::Stop, ended(Status::Canceled)];
        check(&stopped, &[Send, AskResult, Cancel], Some(Ending::Stopped));
        check(&stopped[..4], &[Send, AskResult, Cancel], None);
        let done = [THERE, TAKEN, Input::Stop, ended(Status::Succeeded), ended(Status::Canceled)];
        check(&done, &[Send, AskResult, Cancel], Some(Ending::Done(vec![7])));
        check(&[THERE, TAKEN, Input::Stop, ended(Status::Aborted)], &[Send, AskResult, Cancel], Some(Ending::Stopped));
    }

    #[test]
    fn a_server_that_is_not_there_is_told() {
        let (mut goal, mut effects) = (Goal::new("/go".to_owned(), at(0)), Vec::new());
        goal.handle(at(4999), AWAY, &mut effects);
        assert_eq!(goal.ending(), None);
        goal.handle(at(5000), AWAY, &mut effects);
        assert_eq!(goal.ending().cloned(), aborted("action `/go`: no node of ROS 2 serves it within 5 s"));
        assert_eq!(effects, []);
    }

    #[test]
    fn a_lost_result_is_asked_for_again_until_the_server_stays_away() {
        use Effect::{AskResult, Send};
        let (mut effects, mut goal) = play(&[THERE, TAKEN, Input::NoResult, AWAY, THERE]);
        assert_eq!(effects, [Send, AskResult]);
        goal.handle(at(231), THERE, &mut effects);
        goal.handle(at(240), THERE, &mut effects);
        assert_eq!(effects, [Send, AskResult, AskResult]);
        goal.handle(at(250), Input::NoResult, &mut effects);
        goal.handle(at(5239), AWAY, &mut effects);
        assert_eq!((goal.ending(), effects.len()), (None, 3));
        goal.handle(at(5240), AWAY, &mut effects);
        assert_eq!(goal.ending().cloned(), aborted("action `/go`: its server has been away for 5 s"));
    }

    #[test]
    fn answers_that_make_no_sense_change_nothing() {
        use Effect::{AskResult, Cancel, Send};
        check(&[TAKEN, ended(Status::Succeeded), Input::NoResult], &[], None);
        check(&[THERE, ended(Status::Succeeded), TAKEN, TAKEN], &[Send, AskResult], None);
        let why = "x".to_owned();
        let told = "action `/go`: the goal was sent and has no answer: x";
        check(&[THERE, Input::NotAnswered { why: why.clone() }, TAKEN], &[Send, Cancel], aborted(told));
        let told = "action `/go`: its result cannot be read: x";
        check(&[THERE, TAKEN, Input::BadResult { why }], &[Send, AskResult], aborted(told));
    }
}
