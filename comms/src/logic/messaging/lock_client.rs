//! The client's side of a resource lock.
//!
//! The client considers the lock as held for a shorter time than the server. The client counts the lease from when it
//! *sent* the answered request; the server counts it from when it received the request. The client may still be wrong,
//! because it may be suspended between a look at [`LockClient::held`] and its command. So the command carries the
//! fencing number, and the resource checks that.

use super::wire::{Denied, LockAnswer, LockRequest};
use crate::logic::time::Time;
use std::time::Duration;

/// How long the client waits for an answer before it repeats the request.
const RETRY: Duration = Duration::from_millis(250);
/// The shortest time between two requests.
const PACE: Duration = Duration::from_millis(5);

/// An input of a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ClientInput {
    /// The program wants the lock, with this priority. If the lock is already wanted, only the priority changes.
    Want(u8),
    /// The program does not want the lock any more.
    Drop,
    /// The answer to a call.
    Answer {
        /// The number of the [`ClientEffect::Call`].
        call: u64,
        /// The answer; none if no answer came.
        answer: Option<LockAnswer>,
    },
    /// The time of [`LockClient::deadline`] has come.
    Tick,
}

/// An effect of a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ClientEffect {
    /// Call the server, then give [`ClientInput::Answer`].
    Call {
        /// The number of the call.
        call: u64,
        /// The request to send.
        request: LockRequest,
        /// How long the answer is useful.
        within: Duration,
    },
    /// The lock is held.
    Held {
        /// The fencing number to send with each command.
        fence: u64,
    },
    /// The lock is lost, or cannot be granted.
    Lost(Denied),
}

/// One client of one lock.
#[derive(Clone, Debug)]
pub struct LockClient {
    client: u64,
    name: String,
    state: State,
    /// Counts the requests of the program.
    request: u64,
    call: u64,
    /// The unanswered call, and when it was made.
    open: Option<(u64, Time)>,
    /// When the next call is due.
    due: Time,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum State {
    Idle,
    /// The server does not know yet that the request is withdrawn.
    Releasing {
        tries: u8,
    },
    Waiting {
        priority: u8,
    },
    Holding {
        fence: u64,
        until: Time,
        is_wanted: bool,
    },
}

/// How often a release is sent. After that, the grant ends with the lease.
const RELEASES_MAX: u8 = 4;

impl LockClient {
    /// Returns a client without a request. `client` is a random number, drawn at the start of the program. `name` is
    /// for people.
    pub const fn new(client: u64, name: String) -> Self {
        Self { client, name, state: State::Idle, request: 0, call: 0, open: None, due: Time::ZERO }
    }

    /// Takes an input.
    pub fn handle(&mut self, now: Time, input: ClientInput, effects: &mut Vec<ClientEffect>) {
        self.expire(now, effects);
        match input {
            ClientInput::Want(priority) => self.want(now, priority),
            ClientInput::Drop => self.release(now),
            ClientInput::Answer { call, answer } => self.answered(now, call, answer, effects),
            ClientInput::Tick => {}
        }
        self.call(now, effects);
    }

    /// Returns the time at which the client has to be called with [`ClientInput::Tick`]; none if it waits for nothing.
    pub fn deadline(&self) -> Option<Time> {
        let until = if let State::Holding { until, .. } = self.state { Some(until) } else { None };
        let call = (self.state != State::Idle).then(|| self.open.map_or(self.due, |(_, sent)| sent + RETRY));
        [until, call].into_iter().flatten().min()
    }

    /// Returns the fencing number, as long as this client may consider the lock as held.
    pub fn held(&self, now: Time) -> Option<u64> {
        match self.state {
            State::Holding { fence, until, .. } => (now < until).then_some(fence),
            State::Idle | State::Releasing { .. } | State::Waiting { .. } => None,
        }
    }

    /// Returns whether a client of greater priority waits for the lock that this client holds.
    pub const fn is_wanted(&self) -> bool {
        matches!(self.state, State::Holding { is_wanted: true, .. })
    }

    /// Returns whether the lock is wanted or held.
    pub const fn is_active(&self) -> bool {
        matches!(self.state, State::Waiting { .. } | State::Holding { .. })
    }

    /// Returns whether nothing is wanted or held, and the server knows this or did not answer several releases.
    pub const fn is_idle(&self) -> bool {
        matches!(self.state, State::Idle)
    }

    fn want(&mut self, now: Time, priority: u8) {
        match &mut self.state {
            State::Holding { .. } => {}
            State::Waiting { priority: present } => *present = priority,
            State::Idle | State::Releasing { .. } => {
                self.request += 1;
                self.state = State::Waiting { priority };
                (self.open, self.due) = (None, now);
            }
        }
    }

    fn release(&mut self, now: Time) {
        if self.is_active() {
            self.state = State::Releasing { tries: 0 };
            (self.open, self.due) = (None, now);
        }
    }

    fn expire(&mut self, now: Time, effects: &mut Vec<ClientEffect>) {
        if let State::Holding { until, is_wanted, .. } = self.state
            && until <= now
        {
            self.lose(if is_wanted { Denied::Preempted } else { Denied::Expired }, effects);
        }
    }

    fn lose(&mut self, why: Denied, effects: &mut Vec<ClientEffect>) {
        (self.state, self.open) = (State::Idle, None);
        effects.push(ClientEffect::Lost(why));
    }

    fn answered(&mut self, now: Time, call: u64, answer: Option<LockAnswer>, effects: &mut Vec<ClientEffect>) {
        let Some((_, sent)) = self.open.take_if(|(open, _)| *open == call) else { return };
        // Without an answer the request is repeated, at the pace of a waiting client.
        self.due = now + PACE.max(RETRY / 8);
        let Some(answer) = answer.filter(|answer| answer.request() == self.request) else { return };
        match (answer, &self.state) {
            (LockAnswer::Granted { fence, left, lease, is_wanted, .. }, State::Waiting { .. }) => {
                self.hold(fence, sent + left, is_wanted, now, lease);
                match self.held(now) {
                    Some(fence) => effects.push(ClientEffect::Held { fence }),
                    None => self.lose(Denied::Expired, effects),
                }
            }
            (LockAnswer::Granted { fence, left, lease, is_wanted, .. }, State::Holding { fence: held, .. })
                if fence == *held =>
            {
                self.hold(fence, sent + left, is_wanted, now, lease);
                self.expire(now, effects);
            }
            (LockAnswer::Waiting { lease, .. }, State::Waiting { .. }) => {
                self.due = now + (lease / 8).clamp(PACE, RETRY);
            }
            (LockAnswer::Denied { why, .. }, State::Waiting { .. } | State::Holding { .. }) => self.lose(why, effects),
            (LockAnswer::Released { .. }, State::Releasing { .. }) => self.state = State::Idle,
            _ => {}
        }
    }

    fn hold(&mut self, fence: u64, until: Time, is_wanted: bool, now: Time, lease: Duration) {
        self.state = State::Holding { fence, until, is_wanted };
        self.due = now + (lease / 3).max(PACE);
    }

    fn call(&mut self, now: Time, effects: &mut Vec<ClientEffect>) {
        if self.open.is_some_and(|(_, sent)| now >= sent + RETRY) {
            self.open = None;
            self.due = now;
        }
        if self.open.is_some() || now < self.due {
            return;
        }
        let (client, request) = (self.client, self.request);
        let asked = match &mut self.state {
            State::Idle => return,
            State::Releasing { tries } if *tries >= RELEASES_MAX => {
                self.state = State::Idle;
                return;
            }
            State::Releasing { tries } => {
                *tries += 1;
                LockRequest::Release { client, request }
            }
            State::Waiting { priority } => {
                LockRequest::Acquire { client, name: self.name.clone(), request, priority: *priority }
            }
            State::Holding { .. } => LockRequest::Renew { client, request },
        };
        self.call += 1;
        self.open = Some((self.call, now));
        effects.push(ClientEffect::Call { call: self.call, request: asked, within: RETRY });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Time {
        Time::ZERO + Duration::from_millis(ms)
    }

    fn handle(client: &mut LockClient, ms: u64, input: ClientInput) -> Vec<ClientEffect> {
        let mut effects = Vec::new();
        client.handle(at(ms), input, &mut effects);
        effects
    }

    fn granted(left: u64, is_wanted: bool) -> Option<LockAnswer> {
        let (lease, left) = (Duration::from_millis(300), Duration::from_millis(left));
        Some(LockAnswer::Granted { request: 1, fence: 7, lease, left, is_wanted })
    }

    /// The lease is measured from the moment when the request was sent, not from the moment of the answer.
    #[test]
    fn a_lease_counts_from_the_question() {
        let mut client = LockClient::new(9, "task".into());
        let (request, name, within) = (1, "task".to_owned(), RETRY);
        let acquire = LockRequest::Acquire { client: 9, name, request, priority: 3 };
        let asked = handle(&mut client, 10, ClientInput::Want(3));
        assert_eq!(asked, [ClientEffect::Call { call: 1, request: acquire, within }]);
        let answer = |call, answer| ClientInput::Answer { call, answer };
        assert_eq!(handle(&mut client, 50, answer(1, granted(100, false))), [ClientEffect::Held { fence: 7 }]);
        assert_eq!((client.held(at(109)), client.held(at(110))), (Some(7), None));
        // A renewal is due after a third of a lease, which is too late here.
        assert_eq!((handle(&mut client, 105, ClientInput::Tick), client.deadline()), (vec![], Some(at(110))));
        assert_eq!(handle(&mut client, 110, ClientInput::Tick), [ClientEffect::Lost(Denied::Expired)]);
        assert_eq!((client.deadline(), client.is_active()), (None, false));
    }

    #[test]
    fn a_holder_renews_and_hears_that_it_is_to_let_go() {
        let mut client = LockClient::new(9, "task".into());
        handle(&mut client, 0, ClientInput::Want(3));
        handle(&mut client, 1, ClientInput::Answer { call: 1, answer: granted(300, false) });
        let (request, within) = (LockRequest::Renew { client: 9, request: 1 }, RETRY);
        let renewing = handle(&mut client, 101, ClientInput::Tick);
        assert_eq!(renewing, [ClientEffect::Call { call: 2, request, within }]);
        // A late answer, or an answer to another call, changes nothing.
        assert_eq!(handle(&mut client, 102, ClientInput::Answer { call: 1, answer: granted(900, false) }), []);
        assert!(!client.is_wanted());
        handle(&mut client, 103, ClientInput::Answer { call: 2, answer: granted(20, true) });
        assert_eq!((client.is_wanted(), client.held(at(120)), client.held(at(121))), (true, Some(7), None));
        let lost = handle(&mut client, 121, ClientInput::Tick);
        assert_eq!(lost, [ClientEffect::Lost(Denied::Preempted)]);
    }

    #[test]
    fn a_release_is_said_until_it_is_heard_or_often_enough() {
        let mut client = LockClient::new(9, "task".into());
        handle(&mut client, 0, ClientInput::Want(3));
        let mut calls = handle(&mut client, 1, ClientInput::Drop);
        while let Some(due) = client.deadline() {
            let mut effects = Vec::new();
            client.handle(due, ClientInput::Tick, &mut effects);
            calls.extend(effects);
        }
        let releases = calls.iter().filter(|effect| {
            matches!(effect, ClientEffect::Call { request: LockRequest::Release { client: 9, request: 1 }, .. })
        });
        assert_eq!((releases.count(), calls.len()), (4, 4));
    }
}
