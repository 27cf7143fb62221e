//! The lifecycle of a node of ROS 2, seen from outside: transition by transition, its state is changed to the wanted one.
//!
//! ```text
//!         ──configure──▶            ──activate──▶
//! Unconfigured             Inactive               Active
//!                                   ◀─deactivate─
//! ```
//!
//! Only the node knows its state. So the state is requested after each doubt: a transition without an answer, a refused transition, or news
//! of another client. So a lost request is repeated only if the node has not carried it out, and a late answer does no harm. A silent node
//! only fails at the end of the time that its spec allows. Source: `lifecycle_msgs/msg/{State,Transition}`, and
//! design.ros2.org/articles/node_lifecycle.html.

use comms::logic::human::span;
use comms::logic::time::Time;
use std::fmt;
use std::time::Duration;

/// How often the state of an active node is requested. News of other clients arrive sooner.
const ASK_EVERY: Duration = Duration::from_secs(1);
/// The pause before the next request if the node is in a transition, or has not answered.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// The state of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Unconfigured,
    Inactive,
    Active,
    /// The node has been shut down for ever.
    Finalized,
    /// The node is in a transition, or in an unknown state.
    Between(u8),
}

/// A transition that can be requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Transition {
    Configure,
    Activate,
    Deactivate,
}

/// The state into which a node is brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wanted {
    /// The node can be activated at once.
    Ready,
    /// The node works.
    Active,
    /// The node does not work.
    Resting,
}

/// News of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Input {
    /// Whether its services exist; checked from time to time.
    Services { are_there: bool },
    /// Another state is wanted from now on, within this time.
    Want { wanted: Wanted, within: Duration },
    /// The answer to the request for a transition, by its number.
    Changed { number: u32, answer: Answer },
    /// The answer to a request for the state; none if it was lost, or is not an answer of a node.
    Told { number: u32, state: Option<State> },
    /// The node reports that its state has changed.
    News,
    /// The program of the node has ended.
    Ended,
}

/// The answer to the request for a transition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    Done,
    Failed,
    /// The answer is missing or cannot be read: the transition may have happened.
    Missing,
}

/// An effect on a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    /// Start the program of the node.
    Start,
    Change {
        number: u32,
        transition: Transition,
    },
    /// Ask for the state of the node.
    Ask {
        number: u32,
    },
}

/// The relation of the present state to the wanted state.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Standing {
    /// The wanted state is not reached yet.
    Underway,
    Reached,
    /// The wanted state cannot be reached, or was left. The text is the reason, for a person.
    Failed(String),
}

/// A request without an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Request {
    Change(Transition),
    Ask,
}

/// The state to be reached, and the time limit.
#[derive(Clone, Copy, Debug)]
struct Aim {
    wanted: Wanted,
    within: Duration,
    until: Time,
}

/// The requests for the state.
#[derive(Debug, Default)]
struct Questions {
    /// The last state that is certain; none after a doubt.
    state: Option<State>,
    due: Time,
    /// When the node last answered.
    heard: Time,
}

/// A node with a lifecycle.
#[derive(Debug)]
pub(crate) struct Lifecycle {
    name: String,
    /// How long the node may be silent.
    within: Duration,
    aim: Aim,
    standing: Standing,
    is_started: bool,
    are_there: bool,
    /// The number of the last request.
    number: u32,
    request: Option<Request>,
    questions: Questions,
    /// The transition that the node failed to do.
    failed: Option<Transition>,
    /// Whether a request to activate the node has no answer, so that the node may carry it out at any time.
    may_activate: bool,
}

impl Lifecycle {
    /// Returns a node that is not started. It has to be ready within this time.
    pub(crate) fn new(name: String, within: Duration, now: Time) -> Self {
        Self {
            name,
            within,
            aim: Aim { wanted: Wanted::Ready, within, until: now + within },
            standing: Standing::Underway,
            is_started: false,
            are_there: false,
            number: 0,
            request: None,
            questions: Questions::default(),
            failed: None,
            may_activate: false,
        }
    }

    /// Takes an input.
    pub(crate) fn handle(&mut self, now: Time, input: Input, effects: &mut Vec<Effect>) {
        match input {
            Input::Services { are_there } => {
                self.are_there = are_there;
                self.look(now, effects);
            }
            Input::Want { wanted, within } => {
                self.aim = Aim { wanted, within, until: now + within };
                (self.standing, self.failed) = (Standing::Underway, None);
                (self.questions.state, self.questions.due, self.questions.heard) = (None, now, now);
                self.look(now, effects);
            }
            Input::Changed { number, answer } => {
                if let Some(Request::Change(transition)) = self.answered(number) {
                    self.changed(now, transition, answer);
                    self.look(now, effects);
                }
            }
            Input::Told { number, state } => {
                if self.answered(number) == Some(Request::Ask) {
                    if self.is_started {
                        self.told(now, state);
                    } else {
                        self.looked_around(now, state, effects);
                    }
                    self.look(now, effects);
                }
            }
            Input::News => {
                (self.questions.state, self.questions.due) = (None, now);
                self.look(now, effects);
            }
            Input::Ended => {
                (self.is_started, self.request, self.questions.state) = (false, None, None);
                self.may_activate = false;
            }
        }
    }

    /// Returns the relation of the present state to the wanted state.
    pub(crate) fn standing(&self) -> &Standing {
        &self.standing
    }

    /// Returns whether the node may become active although this is not wanted.
    pub(crate) fn may_activate(&self) -> bool {
        self.may_activate
    }

    /// Returns the last state that the node has reported.
    pub(crate) fn state(&self) -> Option<State> {
        self.questions.state
    }

    /// Takes an answer; returns its request. An answer to an earlier request is ignored.
    fn answered(&mut self, number: u32) -> Option<Request> {
        self.request.take_if(|_| number == self.number)
    }

    fn changed(&mut self, now: Time, transition: Transition, answer: Answer) {
        let questions = &mut self.questions;
        match answer {
            Answer::Done => (questions.state, questions.heard) = (Some(transition.goal()), now),
            Answer::Failed => {
                // The node may have reached the state in another way. Then it has only refused to do the same again.
                (questions.state, questions.due, questions.heard) = (None, now, now);
                self.failed = Some(transition);
            }
            Answer::Missing => {
                questions.state = None;
                questions.due = now + LOOK_AGAIN;
                self.may_activate |= transition == Transition::Activate;
            }
        }
    }

    /// Starts the program, unless a node with its name answers: that node would get the requests as well.
    fn looked_around(&mut self, now: Time, state: Option<State>, effects: &mut Vec<Effect>) {
        self.questions = Questions { due: now + LOOK_AGAIN, heard: now, ..Questions::default() };
        if state.is_none() && !self.are_there {
            self.is_started = true;
            effects.push(Effect::Start);
        }
    }

    fn told(&mut self, now: Time, state: Option<State>) {
        let questions = &mut self.questions;
        questions.state = state;
        let Some(state) = state else {
            questions.due = now + LOOK_AGAIN;
            return;
        };
        questions.heard = now;
        // Another client has made the same transition.
        self.failed.take_if(|failed| failed.goal() == state);
        questions.due = now + if matches!(state, State::Between(_)) { LOOK_AGAIN } else { ASK_EVERY };
    }

    /// Updates the relation to the wanted state, and sends the next request.
    fn look(&mut self, now: Time, effects: &mut Vec<Effect>) {
        self.judge(now);
        if matches!(self.standing, Standing::Failed(_)) {
            return;
        }
        // Before the start, the only request is whether a node with this name already exists.
        let has_partner = self.are_there == self.is_started;
        if self.request.is_some() || !has_partner || (!self.is_started && self.aim.wanted == Wanted::Resting) {
            return;
        }
        let next = self.questions.state.and_then(|state| self.next(state));
        if let Some(transition) = next {
            self.number += 1;
            self.request = Some(Request::Change(transition));
            effects.push(Effect::Change { number: self.number, transition });
        } else if now >= self.questions.due && self.is_watched() {
            self.number += 1;
            self.request = Some(Request::Ask);
            effects.push(Effect::Ask { number: self.number });
        }
    }

    /// Returns whether the state of the node is still requested. A node that must not work is asked until its state confirms this.
    fn is_watched(&self) -> bool {
        self.aim.wanted == Wanted::Active || self.standing == Standing::Underway
    }

    /// Returns the transition to the wanted state.
    fn next(&self, state: State) -> Option<Transition> {
        match (self.aim.wanted, state) {
            (Wanted::Ready | Wanted::Active, State::Unconfigured) => Some(Transition::Configure),
            (Wanted::Active, State::Inactive) => Some(Transition::Activate),
            (Wanted::Ready | Wanted::Resting, State::Active) => Some(Transition::Deactivate),
            (Wanted::Active, State::Active)
            | (Wanted::Ready, State::Inactive)
            | (Wanted::Resting, State::Inactive | State::Unconfigured | State::Finalized)
            | (Wanted::Ready | Wanted::Active, State::Finalized)
            | (_, State::Between(_)) => None,
        }
    }

    fn judge(&mut self, now: Time) {
        if self.aim.wanted == Wanted::Resting && !self.is_started {
            self.standing = Standing::Reached;
            return;
        }
        let why = match (&self.standing, self.questions.state) {
            (Standing::Failed(_), _) => return,
            (Standing::Reached, Some(state)) if self.aim.wanted == Wanted::Active && state != State::Active => {
                format!("it is {state}: another client, or the node itself, has changed its state")
            }
            (Standing::Reached, _) if self.aim.wanted == Wanted::Active && self.is_silent(now) => {
                format!("it has not reported its state for {}", span(self.within))
            }
            (Standing::Reached, _) => return,
            (Standing::Underway, Some(State::Finalized)) if self.aim.wanted != Wanted::Resting => {
                format!("it is {}: it has been shut down", State::Finalized)
            }
            (Standing::Underway, Some(state)) => match (self.failed, self.next(state), state) {
                (_, None, State::Unconfigured | State::Inactive | State::Active | State::Finalized) => {
                    self.standing = Standing::Reached;
                    return;
                }
                (Some(failed), Some(_), _) => format!("it has failed to {failed}, and is {state}; its output says why"),
                _ if now >= self.aim.until => self.late(),
                _ => return,
            },
            (Standing::Underway, None) if now >= self.aim.until => self.late(),
            (Standing::Underway, None) => return,
        };
        self.standing = Standing::Failed(format!("node `{}`: {why}", self.name));
    }

    /// Returns whether the node has not answered for too long.
    fn is_silent(&self, now: Time) -> bool {
        now >= self.questions.heard + ASK_EVERY + self.within
    }

    /// Returns the reason why the wanted state is not reached in time.
    fn late(&self) -> String {
        let within = span(self.aim.within);
        match (self.request, self.questions.state) {
            _ if !self.is_started => format!("another node of this name still runs after {within}"),
            _ if !self.are_there => format!(
                "its service `{}/change_state` is not there after {within}; does the node have this name, and a lifecycle, and \
                 does it use `rmw_zenoh_cpp`?",
                self.name
            ),
            (Some(Request::Change(transition)), _) => {
                format!("it has not answered the request to {transition} in time")
            }
            (_, Some(state)) => format!("it is still {state} after {within}"),
            (_, None) => format!("it has not reported its state within {within}"),
        }
    }
}

impl State {
    /// Returns the state with this number.
    pub(crate) fn of(number: u8) -> Self {
        match number {
            1 => Self::Unconfigured,
            2 => Self::Inactive,
            3 => Self::Active,
            4 => Self::Finalized,
            other => Self::Between(other),
        }
    }

    /// Returns its number.
    pub(crate) fn number(self) -> u8 {
        match self {
            Self::Unconfigured => 1,
            Self::Inactive => 2,
            Self::Active => 3,
            Self::Finalized => 4,
            Self::Between(number) => number,
        }
    }
}

impl Transition {
    /// Returns its number.
    pub(crate) fn number(self) -> u8 {
        match self {
            Self::Configure => 1,
            Self::Activate => 3,
            Self::Deactivate => 4,
        }
    }

    fn goal(self) -> State {
        match self {
            Self::Activate => State::Active,
            Self::Configure | Self::Deactivate => State::Inactive,
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unconfigured => "unconfigured",
            Self::Inactive => "inactive",
            Self::Active => "active",
            Self::Finalized => "finalized",
            Self::Between(10) => "configuring",
            Self::Between(11) => "cleaning up",
            Self::Between(12) => "shutting down",
            Self::Between(13) => "activating",
            Self::Between(14) => "deactivating",
            Self::Between(15) => "processing an error",
            Self::Between(_) => "in an unknown state",
        })
    }
}

impl fmt::Display for Transition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Configure => "configure",
            Self::Activate => "activate",
            Self::Deactivate => "deactivate",
        })
    }
}

#[cfg(test)]
mod tests;
