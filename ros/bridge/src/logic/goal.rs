//! One goal of an action of ROS 2, from its request to its end, and the end of the process that sent it.
//!
//! ```text
//! Looking ──there is a server──▶ Asked ──accepted──▶ Active ──the goal has ended──▶ Over
//!    └──nothing in time──▶ Over    ├──rejected──▶ Over
//!                                  └──no valid answer──▶ Unclear ──the server cancels it──▶ Active
//! ```
//!
//! The process ends with its goal. It has to end earlier if it is stopped or cannot follow the goal any more. In this case the goal is
//! canceled at once, even if no server has accepted it yet. The stop of the process is confirmed when a server has said that the goal has
//! ended, was rejected or is unknown. Until then the goal may continue: [`Goal::may_go_on`].
//!
//! A request without an answer is repeated: the router or the server may have been away for a time, and a server keeps results.

use super::retry::Retry;
use comms::logic::time::Time;
use std::time::Duration;

/// How long the process looks for a server before it sends the goal.
const LOOK_WITHIN: Duration = Duration::from_secs(5);
/// How long a server may be away while the goal is active.
const AWAY_WITHIN: Duration = Duration::from_secs(5);
/// The largest number of requests for the result in a row that may stay without an answer.
const NO_RESULTS_MAX: u32 = 10;

/// News for a goal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Input {
    /// Whether there is a server; checked from time to time.
    Server { is_there: bool },
    /// Whether the server accepts the goal.
    Answered { is_accepted: bool },
    /// The request to accept the goal had no valid answer.
    NotAnswered { why: String },
    /// The answer to the request for the result.
    Result { status: Status, result: Vec<u8> },
    /// The request for the result had no answer: it was lost, or the server has gone.
    NoResult,
    /// The answer to a request for the result cannot be read.
    BadResult { why: String },
    /// The answer to a request to cancel the goal, by the number of the request.
    Cancel { number: u32, answer: CancelAnswer },
    /// The mission stops the goal.
    Stop,
}

/// The status of a goal in the answer to the request for its result. Source: `action_msgs/msg/GoalStatus`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Status {
    Succeeded,
    Canceled,
    Aborted,
    /// The server does not know the goal.
    Unknown,
    /// A number that is not the end of a goal.
    Other(i64),
}

/// The answer to a request to cancel a goal. Source: `action_msgs/srv/CancelGoal`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CancelAnswer {
    /// The server cancels the goal.
    Accepted,
    /// The server refuses to cancel the goal.
    Refused,
    /// The server does not know the goal.
    Unknown,
    /// The goal has already ended.
    Ended,
    /// The answer is missing or not valid.
    Missing,
}

/// A request of a goal to its server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    /// Send the goal.
    Send,
    /// Ask for the result of the goal.
    AskResult,
    /// Ask to cancel the goal.
    Cancel { number: u32 },
}

/// The end of the process that sent a goal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// The goal has succeeded, with this result.
    Done(Vec<u8>),
    /// The goal has failed, or the process cannot follow it. The text is the reason, for a person.
    Aborted(String),
    /// The mission has stopped the process.
    Stopped,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Looking,
    Asked,
    /// The request to accept the goal had no valid answer.
    Unclear,
    Active,
    /// The goal has ended, or never began.
    Over,
}

/// The requests to cancel a goal.
#[derive(Debug, Default)]
struct Canceling {
    /// The number of the last request; 0 without a request.
    number: u32,
    answer: Option<CancelAnswer>,
    retry: Retry,
}

/// A goal.
#[derive(Debug)]
pub(crate) struct Goal {
    action: String,
    stage: Stage,
    ending: Option<Ending>,
    canceling: Canceling,
    /// The request for the result.
    result: Retry,
    /// When a server was last there. Before the first server, the time since when the process has looked for one.
    seen: Time,
    is_there: bool,
}

impl Goal {
    /// Returns a goal for a server of this action; the process looks for a server from now on.
    pub(crate) fn new(action: String, now: Time) -> Self {
        let (canceling, result) = (Canceling::default(), Retry::default());
        Self { action, stage: Stage::Looking, ending: None, canceling, result, seen: now, is_there: false }
    }

    /// Takes an input.
    pub(crate) fn handle(&mut self, now: Time, input: Input, effects: &mut Vec<Effect>) {
        match (self.stage, input) {
            // A late answer changes nothing.
            (Stage::Over, _) => {}
            (_, Input::Server { is_there }) => self.look(now, is_there, effects),
            (Stage::Looking, Input::Stop) => self.settle(Ending::Stopped),
            (Stage::Looking, _) => {}
            (_, Input::Stop) => self.end(now, Ending::Stopped, effects),
            (Stage::Asked, Input::Answered { is_accepted: true }) => {
                self.activate(now, effects);
                if self.ending.is_some() {
                    self.cancel(now, effects);
                }
            }
            (Stage::Asked, Input::Answered { is_accepted: false }) => {
                let why = format!("the server of `{}` has rejected the goal", self.action);
                self.settle(Ending::Aborted(why));
            }
            (Stage::Asked, Input::NotAnswered { why }) => {
                // The server may have accepted the goal without an answer.
                self.stage = Stage::Unclear;
                if self.ending.is_some() {
                    return self.cancel(now, effects);
                }
                self.fail(now, &format!("the goal was sent and has no answer: {why}"), effects);
            }
            (Stage::Active, Input::Result { status, result }) => self.answered(now, status, result, effects),
            (Stage::Active, Input::NoResult) => {
                if self.result.failed(now) == NO_RESULTS_MAX {
                    let why =
                        format!("its server has left {NO_RESULTS_MAX} questions for the result without an answer");
                    self.fail(now, &why, effects);
                }
            }
            (Stage::Active, Input::BadResult { why }) => {
                self.result.failed(now);
                self.fail(now, &format!("its result cannot be read: {why}"), effects);
            }
            (_, Input::Cancel { number, answer }) if number == self.canceling.number => {
                self.cancel_answered(now, answer, effects);
            }
            (Stage::Asked | Stage::Unclear | Stage::Active, _) => {}
        }
    }

    /// Returns the end of the process, once the process ends: with the goal or before it.
    pub(crate) fn ending(&self) -> Option<&Ending> {
        self.ending.as_ref()
    }

    /// Returns whether the goal has ended or never began.
    pub(crate) fn is_over(&self) -> bool {
        self.stage == Stage::Over
    }

    /// Returns a sentence for a person if the goal may continue in ROS 2.
    pub(crate) fn may_go_on(&self) -> Option<String> {
        let why = match (self.stage, self.canceling.answer) {
            (Stage::Looking | Stage::Over, _) => return None,
            _ if !self.is_there => "its server cannot be reached",
            (_, Some(CancelAnswer::Refused)) => "its server refuses to cancel the goal",
            (_, Some(CancelAnswer::Accepted)) => "its server is canceling the goal, and has not ended it",
            (Stage::Asked, _) => "its server has not said whether it accepts the goal, and may begin the goal later",
            (Stage::Unclear | Stage::Active, _) => "the request to cancel the goal has no answer",
        };
        Some(format!("the goal of action `{}` may go on in ROS 2: {why}", self.action))
    }

    fn look(&mut self, now: Time, is_there: bool, effects: &mut Vec<Effect>) {
        self.is_there = is_there;
        if !is_there {
            let within = if self.stage == Stage::Looking { LOOK_WITHIN } else { AWAY_WITHIN };
            if now < self.seen + within || self.ending.is_some() {
                return;
            }
            if self.stage == Stage::Looking {
                let why = format!("no node of ROS 2 serves it within {} s", within.as_secs());
                return self.settle(Ending::Aborted(self.reason(&why)));
            }
            return self.fail(now, &format!("its server has been away for {} s", within.as_secs()), effects);
        }
        self.seen = now;
        if self.stage == Stage::Looking {
            self.stage = Stage::Asked;
            effects.push(Effect::Send);
        }
        if self.result.is_due(now) {
            self.ask(now, effects);
        }
        if self.canceling.retry.is_due(now) {
            self.cancel(now, effects);
        }
    }

    fn activate(&mut self, now: Time, effects: &mut Vec<Effect>) {
        self.stage = Stage::Active;
        self.ask(now, effects);
    }

    fn ask(&mut self, now: Time, effects: &mut Vec<Effect>) {
        self.result.asked(now);
        effects.push(Effect::AskResult);
    }

    fn cancel(&mut self, now: Time, effects: &mut Vec<Effect>) {
        self.canceling.number += 1;
        self.canceling.answer = None;
        self.canceling.retry.asked(now);
        effects.push(Effect::Cancel { number: self.canceling.number });
    }

    fn cancel_answered(&mut self, now: Time, answer: CancelAnswer, effects: &mut Vec<Effect>) {
        self.canceling.answer = Some(answer);
        match (answer, self.stage) {
            // The server has not handled the request to accept the goal yet.
            (CancelAnswer::Unknown, Stage::Asked) | (CancelAnswer::Refused, _) => {}
            (CancelAnswer::Unknown | CancelAnswer::Ended, _) => self.stage = Stage::Over,
            (CancelAnswer::Accepted, Stage::Unclear) => self.activate(now, effects),
            (CancelAnswer::Accepted, _) => {}
            (CancelAnswer::Missing, _) => drop(self.canceling.retry.failed(now)),
        }
    }

    /// Takes the answer to the request for the result.
    fn answered(&mut self, now: Time, status: Status, result: Vec<u8>, effects: &mut Vec<Effect>) {
        let why = match status {
            Status::Succeeded => return self.settle(Ending::Done(result)),
            Status::Canceled => "another client has canceled the goal",
            Status::Aborted => "its server has aborted the goal",
            Status::Unknown => {
                self.result.failed(now);
                return self.fail(now, "its server does not know the goal any more", effects);
            }
            Status::Other(status) => {
                self.result.failed(now);
                let why = format!("its server has answered with status {status}, which is not the end of a goal");
                return self.fail(now, &why, effects);
            }
        };
        self.settle(Ending::Aborted(self.reason(why)));
    }

    /// Cancels the goal and ends the process, because the process cannot follow the goal.
    fn fail(&mut self, now: Time, why: &str, effects: &mut Vec<Effect>) {
        self.end(now, Ending::Aborted(self.reason(why)), effects);
    }

    /// Lets the process end before its goal. A second reason to end changes nothing.
    fn end(&mut self, now: Time, ending: Ending, effects: &mut Vec<Effect>) {
        if self.ending.is_none() {
            self.ending = Some(ending);
            self.cancel(now, effects);
        }
    }

    /// Records that the goal has ended or never began. The process ends too, unless it has ended before.
    fn settle(&mut self, ending: Ending) {
        self.stage = Stage::Over;
        self.ending.get_or_insert(ending);
    }

    fn reason(&self, why: &str) -> String {
        format!("action `{}`: {why}", self.action)
    }
}

impl Status {
    /// Returns the status with this number.
    pub(crate) fn of(number: i64) -> Self {
        match number {
            0 => Self::Unknown,
            4 => Self::Succeeded,
            5 => Self::Canceled,
            6 => Self::Aborted,
            other => Self::Other(other),
        }
    }
}

#[cfg(test)]
mod tests;
