//! The bridge as a controller: its ports are topics.

use crate::io::{Publisher, RosSession, Subscriber, Waiting, depth, lock, topic};
use crate::logic::arrivals::{Arrivals, Arrived, Counts};
use crate::logic::network::Network;
use crate::logic::value;
use comms::logic::decode::Source;
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use controllers::sdk::{
    About, Arguments, Configured, Delivery, DeliveryError, Direction, Interface, Kind, Module, Outlets, Parameter,
    PortInterface, Progress, Stopping, Waker,
};
use ros::logic::route::{Route, Way};
use ros::logic::schema::Schema;
use ros::logic::{cdr, hash, library};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// The controller type, which plans name.
const TYPE: &str = "RosBridge";
/// How often it looks after itself when nothing comes.
const PERIOD: Duration = Duration::from_millis(500);
const STOP_WITHIN: Duration = Duration::from_secs(2);
const PARAMETERS: &[Parameter] = &[
    Parameter::new("routes", Kind::Text(&[])),
    Parameter::new("domain", Kind::Text(&[])).or(""),
    Parameter::new("settings", Kind::Text(&[])).or(""),
];

/// Returns the interface of a bridge without topics.
pub(crate) fn interface() -> Interface {
    let about = About::service("Connects wires with topics of ROS 2. `dca` adds it to a mission that has such topics.");
    let about = about.every(PERIOD).stop_within(STOP_WITHIN).with(PARAMETERS).signals_every(PERIOD);
    Interface { type_name: TYPE, about, ports: Vec::new(), exports: Vec::new(), calls: Vec::new(), inner: Vec::new() }
}

/// A topic that it carries.
#[derive(Debug)]
struct Carried {
    port: &'static str,
    type_name: &'static str,
    route: Route,
    schema: Schema,
    end: End,
}

#[derive(Debug)]
enum End {
    /// Wires to the topic.
    ToRos { publisher: Option<Publisher>, counts: Counts },
    /// The topic to wires.
    FromRos { subscriber: Option<Subscriber>, waiting: Waiting },
}

/// A bridge.
#[derive(Debug)]
pub(crate) struct Bridge {
    interface: Interface,
    carried: Vec<Carried>,
    network: Network,
    node: String,
    session: Option<RosSession>,
    waker: Option<Waker>,
}

impl Bridge {
    /// Makes an idle bridge.
    ///
    /// # Errors
    /// A sentence for a person.
    pub(crate) fn new(arguments: &Arguments) -> Result<Self, String> {
        let routes = Route::list(arguments.text("routes")).ok_or("its routes cannot be read")?;
        let given = |argument: &str, variable: &str| match arguments.text(argument) {
            "" => std::env::var(variable).unwrap_or_default(),
            text => text.to_owned(),
        };
        let network = Network::read(&given("domain", "ROS_DOMAIN_ID"), &given("settings", "ZENOH_CONFIG_OVERRIDE"))?;
        let carried = routes.into_iter().map(Carried::new).collect::<Result<Vec<_>, String>>()?;
        let ports = carried.iter().map(Carried::interface).collect();
        let interface = Interface { ports, ..interface() };
        let node = node_name(arguments);
        Ok(Self { interface, carried, network, node, session: None, waker: None })
    }

    fn connect(&mut self) -> Result<(), String> {
        let session = RosSession::open(&self.network, self.node.clone())?;
        let waker = self.waker.clone().unwrap_or_else(|| Waker::new(|| {}));
        for (id, carried) in (1..).zip(&mut self.carried) {
            let topic = topic(&carried.route, hash::rihs01(&carried.schema));
            let qos = carried.route.qos;
            match &mut carried.end {
                End::ToRos { publisher, .. } => *publisher = Some(session.publisher(id, &topic, qos)?),
                End::FromRos { subscriber, waiting } => {
                    let heard = session.subscriber(id, &topic, qos, Arc::clone(waiting), waker.clone())?;
                    *subscriber = Some(heard);
                }
            }
        }
        self.session = Some(session);
        Ok(())
    }

    fn disconnect(&mut self) {
        for carried in &mut self.carried {
            match &mut carried.end {
                End::ToRos { publisher, .. } => *publisher = None,
                End::FromRos { subscriber, .. } => *subscriber = None,
            }
        }
        if let Some(session) = self.session.take() {
            session.close();
        }
    }

    /// Takes the messages of all topics that have arrived.
    fn arrived(&self) -> impl Iterator<Item = (&'static str, Arrived)> {
        let of_topic = |carried: &Carried| match &carried.end {
            End::ToRos { .. } => None,
            End::FromRos { waiting, .. } => Some((carried.port, Arc::clone(waiting))),
        };
        let topics = self.carried.iter().filter_map(of_topic);
        topics.flat_map(|(port, waiting)| std::iter::from_fn(move || lock(&waiting).next().map(|one| (port, one))))
    }

    /// Publishes the message of a value.
    fn publish(&mut self, port: &str, message: Option<Vec<u8>>) -> Result<Delivery, DeliveryError> {
        let found = self.carried.iter_mut().find(|carried| carried.port == port);
        let Some(Carried { port, type_name, schema, end: End::ToRos { publisher, counts }, .. }) = found else {
            return Err(DeliveryError::NoInput { type_name: TYPE, port: port.to_owned() });
        };
        // A process of ROS 2 may end because of a malformed message.
        let Some(message) = message.filter(|message| cdr::check(schema, message).is_ok()) else {
            counts.refused += 1;
            let cause = postcard::Error::DeserializeBadEncoding;
            return Err(DeliveryError::Decode { port, expected: type_name, cause });
        };
        counts.received += 1;
        if let Some(publisher) = publisher {
            publisher.publish(message);
        }
        Ok(Delivery::Stored)
    }
}

impl Carried {
    fn new(route: Route) -> Result<Self, String> {
        let schema = library::schema(&route.of).map_err(|error| format!("`{}`: {error}", route.of))?;
        let end = match route.way {
            Way::ToRos => End::ToRos { publisher: None, counts: Counts::default() },
            Way::FromRos => {
                let waiting = Arc::new(Mutex::new(Arrivals::new(schema.clone(), depth(route.qos))));
                End::FromRos { subscriber: None, waiting }
            }
        };
        Ok(Self { port: for_ever(route.port()), type_name: for_ever(route.of.spec()), route, schema, end })
    }

    fn interface(&self) -> PortInterface {
        let direction = if self.route.way == Way::ToRos { Direction::In } else { Direction::Out };
        PortInterface::wire(self.port, direction, self.type_name)
    }

    fn counts(&self) -> Counts {
        match &self.end {
            End::ToRos { counts, .. } => *counts,
            End::FromRos { waiting, .. } => lock(waiting).counts(),
        }
    }
}

impl Module for Bridge {
    fn interface(&self) -> &Interface {
        &self.interface
    }

    fn deliver(&mut self, port: &str, bytes: &[u8], _: Time) -> Result<Delivery, DeliveryError> {
        self.publish(port, value::message_in(bytes).map(<[u8]>::to_vec))
    }

    fn deliver_from(&mut self, port: &str, source: &mut dyn Source, _: Time) -> Result<Delivery, DeliveryError> {
        self.publish(port, value::message_of(source))
    }

    fn lose(&mut self, port: &str, count: u64) {
        let found = self.carried.iter_mut().find(|carried| carried.port == port);
        if let Some(Carried { end: End::ToRos { counts, .. }, .. }) = found {
            counts.lost += count;
        }
    }

    fn init(&mut self, _: &[u8], _: Time) -> Result<(), String> {
        self.disconnect();
        self.connect().inspect_err(|_| self.disconnect())
    }

    fn configure(&mut self, _: Arguments, _: bool) -> Result<Configured, String> {
        Err("a bridge has no parameters that change".to_owned())
    }

    fn calculate(&mut self, _: Time) -> Progress {
        Progress::Continue
    }

    fn stop(&mut self, _: Time) -> Stopping {
        self.disconnect();
        Stopping::Finished
    }

    fn drain(&mut self, send: &mut dyn FnMut(&'static str, Vec<u8>)) {
        self.arrived().for_each(|(port, arrived)| send(port, arrived.value));
    }

    fn drain_to(&mut self, outlets: &mut dyn Outlets) {
        for (port, arrived) in self.arrived() {
            outlets.skip(port, u32::try_from(arrived.lost).unwrap_or(u32::MAX));
            outlets.send(port, arrived.value);
        }
    }

    fn signals(&self) -> Vec<Signal> {
        let router = self.session.as_ref().is_some_and(RosSession::is_connected);
        let mut signals = vec![signal("router".to_owned(), u64::from(router))];
        for carried in &self.carried {
            let Counts { received, lost, refused } = carried.counts();
            let named = [("received", received), ("lost", lost), ("refused", refused)];
            signals.extend(named.map(|(word, count)| signal(format!("{} {word}", carried.route.name), count)));
        }
        signals
    }

    fn take_waker(&mut self, waker: Waker) {
        self.waker = Some(waker);
    }
}

#[expect(clippy::cast_precision_loss, reason = "a count for people")]
fn signal(name: String, count: u64) -> Signal {
    Signal { name, unit: String::new(), value: count as f64, headline: false }
}

/// Returns the name of the node that ROS 2 sees: one for each process of each deployment.
fn node_name(arguments: &Arguments) -> String {
    let name = format!("dca_{}_{}", arguments.deployment(), arguments.instance());
    let word = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    name.chars().map(word).take(NODE_NAME_MAX).collect()
}

/// The longest name of a node. ROS 2 allows 255 with its namespace.
const NODE_NAME_MAX: usize = 200;

/// Interfaces have names that live as long as the process; it makes them once.
fn for_ever(text: String) -> &'static str {
    Box::leak(text.into_boxed_str())
}
