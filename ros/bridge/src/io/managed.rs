//! The client of the services of a node with a lifecycle.

use super::services::{Caller, Client, Service, from_answer, to_value};
use super::{Graph, RosSession, Subscriber, Waiting, depth, lock};
use crate::logic::arrivals::Arrivals;
use crate::logic::conversion::Conversion;
use crate::logic::lifecycle::{Answer, Effect, Input, State, Transition};
use crate::logic::network::Network;
use crate::logic::replies::Failure;
use crate::setup;
use comms::io::clock::Wakeup;
use comms::logic::time::Time;
use controllers::ros::lifecycle_msgs::{
    ChangeStateRequest, ChangeStateResponse, GetStateRequest, GetStateResponse, Transition as TransitionMessage,
};
use controllers::sdk::Waker;
use ros::logic::key::{GraphName, Topic};
use ros::logic::name::{Folder, TypeName};
use ros::logic::qos::Qos;
use ros::logic::route::{SERVICE, Way};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// The package of the services.
const PACKAGE: &str = "lifecycle_msgs";
/// The quality of service of the news about transitions, as in ROS 2.
const QOS: Qos = SERVICE;

/// Wakes the loop of a process. Before the loop runs, wakes the thread that makes the process.
#[derive(Debug, Default)]
pub(crate) struct Bell {
    wakeup: Wakeup,
    waker: Mutex<Option<Waker>>,
}

/// A node with a lifecycle, from outside.
#[derive(Debug)]
pub(crate) struct Managed {
    session: RosSession,
    change: Client,
    ask: Client,
    _subscriber: Subscriber,
    events: Waiting,
    heard: Arc<Mutex<VecDeque<Input>>>,
    bell: Arc<Bell>,
}

impl Bell {
    /// Wakes all waiting threads.
    pub(crate) fn ring(&self) {
        self.wakeup.wake();
        if let Some(waker) = &*lock(&self.waker) {
            waker.wake();
        }
    }

    /// Waits until the bell rings, or until a time.
    pub(crate) fn wait(&self, until: Time) {
        self.wakeup.wait(Some(until));
    }

    /// Takes the function that wakes the loop.
    pub(crate) fn take_waker(&self, waker: Waker) {
        *lock(&self.waker) = Some(waker);
    }
}

impl Managed {
    /// Opens a session for the services of a node; `own` is the name of the node of this session in ROS 2.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn open(name: &GraphName, network: &Network, own: String, bell: Arc<Bell>) -> Result<Self, String> {
        let topic = |part: &str, folder: Folder, of: &str| {
            super::topic(network, &format!("{name}/{part}"), TypeName::new(PACKAGE, folder, of))
        };
        let change = topic("change_state", Folder::Srv, "ChangeState")?;
        let ask = topic("get_state", Folder::Srv, "GetState")?;
        let event = topic("transition_event", Folder::Msg, "TransitionEvent")?;
        let graph = Graph::default();
        for (topic, way) in [(&change, Way::Call), (&ask, Way::Call), (&event, Way::FromRos)] {
            lock(&graph).expect(topic.clone(), way.partner());
        }
        let session = RosSession::open(network, own, graph)?;
        let events = Arrivals::new(Conversion::none(setup::schema(&event.of)?), depth(QOS));
        let events: Waiting = Arc::new(Mutex::new(events));
        let woken = Arc::clone(&bell);
        let waker = Waker::new(move || woken.ring());
        let subscriber = session.subscriber(1, &event, QOS, Arc::clone(&events), waker)?;
        let client = |id: u64, topic: &Topic| session.client(id, topic, &Service::new(&topic.of)?);
        let (change, ask) = (client(2, &change)?, client(3, &ask)?);
        Ok(Self { session, change, ask, _subscriber: subscriber, events, heard: Arc::default(), bell })
    }

    /// Returns the news since the last call.
    pub(crate) fn news(&mut self) -> Vec<Input> {
        self.session.look_at_router();
        let are_there = self.change.has_server() && self.ask.has_server();
        let mut news = Vec::from_iter(lock(&self.heard).drain(..));
        let mut has_events = false;
        while { lock(&self.events).next() }.is_some() {
            has_events = true;
        }
        news.extend(has_events.then_some(Input::News));
        news.push(Input::Services { are_there });
        news
    }

    /// Sends a request. Its answer comes with the changes.
    pub(crate) fn perform(&mut self, effect: Effect) {
        let (heard, bell) = (Arc::clone(&self.heard), Arc::clone(&self.bell));
        let tell = move |input: Input| {
            lock(&heard).push_back(input);
            bell.ring();
        };
        match effect {
            Effect::Start => {}
            Effect::Change { number, transition } => {
                let take = move |answer: Result<Vec<u8>, Failure>| {
                    tracing::info!(%transition, answer = %shown(&answer), "the node was asked to change its state");
                    tell(Input::Changed { number, answer: changed(answer) });
                };
                self.change.call(&change_request(transition), Caller::own(take));
            }
            Effect::Ask { number } => {
                let take = move |answer: Result<Vec<u8>, Failure>| tell(Input::Told { number, state: state(answer) });
                self.ask.call(&to_value(&GetStateRequest::default()), Caller::own(take));
            }
        }
    }

    /// Closes the session, and waits for a limited time until it is closed.
    pub(crate) fn close(self) {
        self.session.close();
    }
}

fn change_request(transition: Transition) -> Vec<u8> {
    let label = transition.to_string();
    to_value(&ChangeStateRequest { transition: TransitionMessage { id: transition.number(), label } })
}

fn changed(answer: Result<Vec<u8>, Failure>) -> Answer {
    match from_answer::<ChangeStateResponse>(answer) {
        Some(ChangeStateResponse { success: true }) => Answer::Done,
        Some(ChangeStateResponse { success: false }) => Answer::Failed,
        None => Answer::Missing,
    }
}

fn state(answer: Result<Vec<u8>, Failure>) -> Option<State> {
    from_answer::<GetStateResponse>(answer).map(|told| State::of(told.current_state.id))
}

fn shown(answer: &Result<Vec<u8>, Failure>) -> String {
    match changed(answer.clone()) {
        Answer::Done => "done".to_owned(),
        Answer::Failed => "failed".to_owned(),
        Answer::Missing => answer.as_ref().err().map_or_else(|| "not an answer".to_owned(), ToString::to_string),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::value;
    use ros::logic::cdr;

    fn answer(message: &[u8]) -> Result<Vec<u8>, Failure> {
        Ok(value::of_message(message))
    }

    #[test]
    fn requests_and_answers_have_their_types() {
        let schema = |name: &str| setup::schema(&TypeName::parse(name).unwrap()).unwrap();
        for (request, of) in [
            (change_request(Transition::Activate), "lifecycle_msgs/srv/ChangeState_Request"),
            (to_value(&GetStateRequest::default()), "lifecycle_msgs/srv/GetState_Request"),
        ] {
            cdr::check(&schema(of), value::message_in(&request).unwrap()).unwrap();
        }
        let answers = [&[0, 1, 0, 0, 1][..], &[0, 1, 0, 0, 0], &[0, 1, 0, 0], &[]].map(|one| changed(answer(one)));
        assert_eq!(answers, [Answer::Done, Answer::Failed, Answer::Missing, Answer::Missing]);
        let active = [0, 1, 0, 0, 3, 0, 0, 0, 7, 0, 0, 0, b'a', b'c', b't', b'i', b'v', b'e', 0];
        assert_eq!(state(answer(&active)), Some(State::Active));
        assert_eq!((state(answer(&active[..9])), state(Err(Failure::Busy))), (None, None));
    }
}
