//! An action of ROS 2 as a task: the start value is the goal, a stop cancels the goal, and the result becomes the value for the next
//! process.

use crate::io::services::{Caller, Client, Service};
use crate::io::{Graph, RosSession, Subscriber, Waiting, depth, lock};
use crate::logic::arrivals::Arrivals;
use crate::logic::conversion::Conversion;
use crate::logic::goal::{CancelAnswer, Effect, Ending, Goal, Input, Status};
use crate::logic::network::Network;
use crate::logic::parts;
use crate::logic::replies::Failure;
use crate::logic::value;
use crate::setup;
use comms::io::entropy;
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use controllers::sdk::{
    About, Arguments, Configured, Delivery, DeliveryError, Direction, Interface, Kind, Module, Outlets, Parameter,
    PortInterface, Progress, Stopping, Waker,
};
use ros::logic::cdr;
use ros::logic::key::{GraphName, Topic};
use ros::logic::name::{Folder, TypeName};
use ros::logic::qos::Qos;
use ros::logic::route::{SERVICE, Way};
use ros::logic::schema::Schema;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// The controller type, which plans name.
const TYPE: &str = "RosAction";
/// The port of feedback.
const FEEDBACK: &str = "Feedback";
/// How often the action checks whether there is a server.
const PERIOD: Duration = Duration::from_millis(100);
const SIGNALS_EVERY: Duration = Duration::from_millis(500);
const PARAMETERS: &[Parameter] = &[
    Parameter::new("action", Kind::Text(&[])),
    Parameter::new("type", Kind::Text(&[])),
    Parameter::new("stop_ms", Kind::Text(&[])).or("6000"),
    setup::DOMAIN,
    setup::SETTINGS,
    setup::DISTRIBUTION,
];
/// The quality of service of feedback, as in ROS 2.
const QOS: Qos = SERVICE;

/// Returns the interface of an action without a type.
pub(crate) fn interface() -> Interface {
    let about = About::task("Sends a goal to an action of ROS 2, and ends with it.");
    let about = about.every(PERIOD).with(PARAMETERS).signals_every(SIGNALS_EVERY);
    Interface { type_name: TYPE, about, ports: Vec::new(), exports: Vec::new(), calls: Vec::new(), inner: Vec::new() }
}

/// The types of an action.
#[derive(Debug)]
struct Forms {
    of: TypeName,
    goal: Schema,
    result: Schema,
    answer: Schema,
    feedback: Schema,
}

/// News of the goal that have not been handled yet.
type Heard = Arc<Mutex<VecDeque<Input>>>;

/// A goal in progress, with the endpoints in ROS 2.
#[derive(Debug)]
struct Running {
    session: RosSession,
    send: Client,
    cancel: Client,
    result: Client,
    _subscriber: Subscriber,
    id: [u8; 16],
    message: Vec<u8>,
    goal: Goal,
    heard: Heard,
}

/// An action.
#[derive(Debug)]
pub(crate) struct Action {
    interface: Interface,
    name: GraphName,
    forms: Arc<Forms>,
    network: Network,
    node: String,
    graph: Graph,
    feedback: Waiting,
    running: Option<Running>,
    waker: Option<Waker>,
}

impl Forms {
    fn new(of: TypeName) -> Result<Self, String> {
        let part = |ending: &str| setup::schema(&of.with(ending));
        let (goal, result) = (part("_Goal")?, part("_Result")?);
        let (answer, feedback) = (part("_GetResult_Response")?, part("_FeedbackMessage")?);
        Ok(Self { of, goal, result, answer, feedback })
    }
}

impl Action {
    /// Makes an action that is not active.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn new(arguments: &Arguments) -> Result<Self, String> {
        let name = GraphName::parse(arguments.text("action")).ok_or("its action has no name of ROS 2")?;
        let of = TypeName::parse(arguments.text("type")).filter(|of| of.folder() == Folder::Action);
        let forms = Forms::new(of.ok_or("its type is not an action of ROS 2")?)?;
        let stop = arguments.text("stop_ms").parse().map_err(|error| format!("`stop_ms`: {error}"))?;
        let feedback = setup::for_ever(forms.of.with("_Feedback").spec());
        let ports = vec![PortInterface::optional(FEEDBACK, Direction::Out, feedback)];
        let about = interface().about.stop_within(Duration::from_millis(stop));
        let interface = Interface { ports, about, ..interface() };
        let waiting = Arc::new(Mutex::new(Arrivals::new(Conversion::none(forms.feedback.clone()), depth(QOS))));
        let (network, node) = (setup::network(arguments)?, setup::node_name(arguments));
        let (graph, forms) = (Graph::default(), Arc::new(forms));
        Ok(Self { interface, name, forms, network, node, graph, feedback: waiting, running: None, waker: None })
    }

    /// Returns a topic or a service of the action.
    fn topic(&self, part: &str, of: TypeName) -> Result<Topic, String> {
        let name = format!("{}/_action/{part}", self.name);
        let name = GraphName::parse(&name).ok_or_else(|| format!("`{name}` is longer than ROS 2 allows"))?;
        let hash = self.network.hash(&setup::schema(&of)?);
        Ok(Topic { name, of, hash })
    }

    fn connect(&mut self, message: Vec<u8>, now: Time) -> Result<(), String> {
        let id = entropy::bytes::<16>().map_err(|error| format!("no name for the goal: {error}"))?;
        let of = |ending: &str| self.forms.of.with(ending);
        let cancels = TypeName::new("action_msgs", Folder::Srv, "CancelGoal").ok_or("no name for a service")?;
        let feedback = self.topic("feedback", of("_FeedbackMessage"))?;
        let send = self.topic("send_goal", of("_SendGoal"))?;
        let cancel = self.topic("cancel_goal", cancels)?;
        let result = self.topic("get_result", of("_GetResult"))?;
        // When the session opens, it reports the existing servers.
        for (topic, way) in [(&feedback, Way::FromRos), (&send, Way::Call), (&cancel, Way::Call), (&result, Way::Call)]
        {
            lock(&self.graph).expect(topic.clone(), way.partner());
        }
        let session = RosSession::open(&self.network, self.node.clone(), Arc::clone(&self.graph))?;
        let waker = self.waker.clone().unwrap_or_else(|| Waker::new(|| {}));
        // The subscription to feedback exists before there is any feedback.
        let subscriber = session.subscriber(1, &feedback, QOS, Arc::clone(&self.feedback), waker)?;
        let client = |id: u64, topic: &Topic| session.client(id, topic, &Service::new(&topic.of)?);
        let (send, cancel, result) = (client(2, &send)?, client(3, &cancel)?, client(4, &result)?);
        let (goal, heard) = (Goal::new(self.name.to_string(), now), Heard::default());
        self.running =
            Some(Running { session, send, cancel, result, _subscriber: subscriber, id, message, goal, heard });
        Ok(())
    }

    fn disconnect(&mut self) {
        if let Some(Running { session, .. }) = self.running.take() {
            session.close();
        }
        lock(&self.graph).forget();
    }

    /// Hands over the news, and performs the resulting effects.
    fn step(&mut self, now: Time, stop: Option<Input>) {
        let waker = self.waker.clone();
        let Some(running) = &mut self.running else { return };
        running.session.look_at_router();
        let is_there = running.send.has_server();
        let mut effects = Vec::new();
        for input in [Input::Server { is_there }].into_iter().chain(stop) {
            running.goal.handle(now, input, &mut effects);
        }
        while let Some(input) = { lock(&running.heard).pop_front() } {
            running.goal.handle(now, input, &mut effects);
        }
        for effect in effects {
            running.perform(&effect, &self.forms, waker.clone());
        }
    }
}

impl Running {
    fn perform(&mut self, effect: &Effect, forms: &Arc<Forms>, waker: Option<Waker>) {
        let (heard, forms) = (Arc::clone(&self.heard), Arc::clone(forms));
        let tell = move |input: Input| {
            lock(&heard).push_back(input);
            waker.into_iter().for_each(|waker| waker.wake());
        };
        match effect {
            Effect::Send => {
                let request = value::of_message(&parts::with_id(self.id, &self.message));
                let take = move |answer: Result<Vec<u8>, Failure>| {
                    tell(match answer {
                        Ok(answer) => Input::Answered { is_accepted: parts::is_accepted(&answer) },
                        Err(failure) => Input::NotAnswered { why: failure.to_string() },
                    });
                };
                self.send.call(&request, Caller::own(take));
            }
            Effect::AskResult => {
                let request = value::of_message(&parts::result_request(self.id));
                let take = move |answer: Result<Vec<u8>, Failure>| {
                    tell(match answer {
                        Ok(answer) => result(&forms, &answer),
                        Err(Failure::Refused(why)) => Input::BadResult { why },
                        Err(Failure::Gone(_) | Failure::NoServer(_) | Failure::Busy) => Input::NoResult,
                    });
                };
                self.result.call(&request, Caller::own(take).unless(parts::is_unknown));
            }
            Effect::Cancel { number } => {
                let (request, number) = (value::of_message(&parts::cancel_request(self.id)), *number);
                let take = move |answer: Result<Vec<u8>, Failure>| {
                    let answer = answer.map_or(CancelAnswer::Missing, |answer| parts::cancel_answer(&answer));
                    tracing::info!(?answer, "the server was asked to cancel the goal");
                    tell(Input::Cancel { number, answer });
                };
                self.cancel.call(&request, Caller::own(take).unless(parts::cancels_unknown));
            }
        }
    }
}

/// Reads the answer to the request for a result.
fn result(forms: &Forms, answer: &[u8]) -> Input {
    match parts::result(&forms.answer, &forms.result, answer) {
        Ok((status, result)) => Input::Result { status: Status::of(status), result: value::of_message(&result) },
        Err(why) => Input::BadResult { why: why.to_string() },
    }
}

impl Module for Action {
    fn interface(&self) -> &Interface {
        &self.interface
    }

    fn deliver(&mut self, port: &str, _: &[u8], _: Time) -> Result<Delivery, DeliveryError> {
        Err(DeliveryError::NoInput { type_name: TYPE, port: port.to_owned() })
    }

    fn init(&mut self, value: &[u8], now: Time) -> Result<(), String> {
        self.disconnect();
        let message = value::message_in(value).filter(|message| cdr::check(&self.forms.goal, message).is_ok());
        let message = message.map(<[u8]>::to_vec).ok_or_else(|| {
            let goal = self.forms.goal.name().spec();
            format!("its start value is not a `{goal}`; the process before it leaves one: `before : this`")
        })?;
        self.connect(message, now).inspect_err(|_| self.disconnect())
    }

    fn configure(&mut self, _: Arguments, _: bool) -> Result<Configured, String> {
        Err("an action has no parameters that change".to_owned())
    }

    fn calculate(&mut self, now: Time) -> Progress {
        self.step(now, None);
        match self.running.as_ref().and_then(|running| running.goal.ending()) {
            None => Progress::Continue,
            Some(Ending::Done(result)) => Progress::Done(result.clone()),
            Some(Ending::Aborted(why)) => Progress::Aborted(why.clone()),
            Some(Ending::Stopped) => Progress::Aborted("the goal was stopped".to_owned()),
        }
    }

    fn stop(&mut self, now: Time) -> Stopping {
        self.step(now, Some(Input::Stop));
        if self.running.as_ref().is_some_and(|running| !running.goal.is_over()) {
            return Stopping::Again;
        }
        self.disconnect();
        Stopping::Finished
    }

    fn unconfirmed(&mut self) -> Option<String> {
        let told = self.running.as_ref().and_then(|running| running.goal.may_go_on());
        if let Some(why) = &told {
            tracing::warn!(why, "the end of the goal is not confirmed");
        }
        self.disconnect();
        told
    }

    fn drain(&mut self, send: &mut dyn FnMut(&'static str, Vec<u8>)) {
        let Some(Running { id, .. }) = &self.running else { return };
        while let Some(arrived) = { lock(&self.feedback).next() } {
            if let Some(feedback) =
                value::message_in(&arrived.value).and_then(|message| parts::without_id(*id, message))
            {
                send(FEEDBACK, value::of_message(&feedback));
            }
        }
    }

    fn drain_to(&mut self, outlets: &mut dyn Outlets) {
        self.drain(&mut |port, bytes| outlets.send(port, bytes));
    }

    fn signals(&self) -> Vec<Signal> {
        let counts = lock(&self.feedback).counts();
        let is_there = self.running.as_ref().is_some_and(|running| running.send.has_server());
        let name = |word: &str| format!("feedback {word}");
        vec![
            setup::signal("server".to_owned(), u64::from(is_there)),
            setup::signal(name("received"), counts.received),
            setup::signal(name("lost"), counts.lost),
            setup::signal(name("refused"), counts.refused),
        ]
    }

    fn take_waker(&mut self, waker: Waker) {
        self.waker = Some(waker);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A session reports the existing nodes while it opens.
    #[test]
    fn partners_are_expected_before_the_session_opens() {
        let given = ["action=/arm/fib", "type=example_interfaces/action/Fibonacci", "settings=nonsense=1"];
        let mut action = Action::new(&Arguments::parse(PARAMETERS, &given).unwrap()).unwrap();
        let goal = value::of_message(&[0, 1, 0, 0, 5, 0, 0, 0]);
        let why = action.init(&goal, Time::ZERO).unwrap_err();
        assert!(why.contains("cannot set `nonsense`"), "{why}");
        for (role, part) in [
            ("MP", "feedback/example_interfaces::action::dds_::Fibonacci_FeedbackMessage_"),
            ("SS", "send_goal/example_interfaces::action::dds_::Fibonacci_SendGoal_"),
            ("SS", "cancel_goal/action_msgs::srv::dds_::CancelGoal_"),
            ("SS", "get_result/example_interfaces::action::dds_::Fibonacci_GetResult_"),
        ] {
            let token = format!("@ros2_lv/7/ab/0/1/{role}/%/%a/arm/%arm%fib%_action%{part}/RIHS01_bb/::,:,:,:,,");
            let told = lock(&action.graph).appear(&token);
            assert!(told.is_some_and(|why| why.contains("with another definition")), "{part}");
        }
    }
}
