//! The bridge as a controller: its ports are topics, its exports and calls are services.

use crate::carried::{Carried, End};
use crate::io::services::Caller;
use crate::io::{Graph, RosSession, lock};
use crate::logic::arrivals::{Arrived, Counts};
use crate::logic::network::Network;
use crate::logic::value;
use crate::setup;
use comms::logic::decode::Source;
use comms::logic::object::ObjectError;
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use controllers::sdk::{
    About, Activity, Arguments, CallOrder, Configured, Delivery, DeliveryError, Interface, Kind, Module, Outlets,
    Parameter, Progress, RawReply, Stopping, Waker,
};
use ros::logic::route::{Route, Way};
use std::borrow::Cow;
use std::sync::Arc;
use std::time::Duration;

/// The controller type, which plans name.
const TYPE: &str = "RosBridge";
/// The period of the bridge when no values arrive.
const PERIOD: Duration = Duration::from_millis(500);
/// The time limit for a procedure of the mission to answer a client of ROS 2.
const ANSWER_WITHIN: Duration = Duration::from_secs(600);
const STOP_WITHIN: Duration = Duration::from_secs(2);
const PARAMETERS: &[Parameter] =
    &[Parameter::new("routes", Kind::Text(&[])), setup::DOMAIN, setup::SETTINGS, setup::DISTRIBUTION];

/// Returns the interface of a bridge without topics.
pub(crate) fn interface() -> Interface {
    let about = About::service(
        "Connects a mission with topics and services of ROS 2. `dca` adds it to a mission with such connections.",
    );
    let about = about.every(PERIOD).stop_within(STOP_WITHIN).with(PARAMETERS).signals_every(PERIOD);
    Interface { type_name: TYPE, about, ports: Vec::new(), exports: Vec::new(), calls: Vec::new(), inner: Vec::new() }
}

/// A bridge.
#[derive(Debug)]
pub(crate) struct Bridge {
    interface: Interface,
    carried: Vec<Carried>,
    network: Network,
    node: String,
    session: Option<RosSession>,
    graph: Graph,
    waker: Option<Waker>,
}

impl Bridge {
    /// Makes a bridge that is not active.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn new(arguments: &Arguments) -> Result<Self, String> {
        let routes = Route::list(arguments.text("routes")).ok_or("its routes cannot be read")?;
        let network = setup::network(arguments)?;
        let carried =
            routes.into_iter().map(|route| Carried::new(route, &network)).collect::<Result<Vec<_>, String>>()?;
        let ports = carried.iter().filter_map(Carried::port_interface).collect();
        let exports = carried.iter().filter_map(Carried::export).collect();
        let calls = carried.iter().filter_map(Carried::call).collect();
        let interface = Interface { ports, exports, calls, ..interface() };
        let node = setup::node_name(arguments);
        let graph = Graph::default();
        Ok(Self { interface, carried, network, node, session: None, graph, waker: None })
    }

    fn connect(&mut self) -> Result<(), String> {
        for carried in &self.carried {
            lock(&self.graph).expect(carried.topic(), carried.route.way.partner());
        }
        let session = RosSession::open(&self.network, self.node.clone(), Arc::clone(&self.graph))?;
        let waker = self.waker.clone().unwrap_or_else(|| Waker::new(|| {}));
        for (id, carried) in (1..).zip(&mut self.carried) {
            carried.connect(&session, id, waker.clone())?;
        }
        self.session = Some(session);
        Ok(())
    }

    fn disconnect(&mut self) {
        self.carried.iter_mut().for_each(Carried::disconnect);
        if let Some(session) = self.session.take() {
            session.close();
        }
        lock(&self.graph).forget();
    }

    /// Takes the messages of all topics that have arrived.
    fn arrived(&self) -> impl Iterator<Item = (&'static str, Arrived)> {
        let topics = self.carried.iter().filter_map(|carried| match &carried.end {
            End::FromRos { waiting, .. } => Some((carried.port, waiting)),
            End::ToRos { .. } | End::Call { .. } | End::Serve { .. } => None,
        });
        topics.flat_map(|(port, waiting)| std::iter::from_fn(move || lock(waiting).next().map(|one| (port, one))))
    }

    fn carried(&mut self, port: &str) -> Option<&mut Carried> {
        self.carried.iter_mut().find(|carried| carried.port == port)
    }

    fn publish(&mut self, port: &str, message: Option<Cow<'_, [u8]>>) -> Result<Delivery, DeliveryError> {
        let found = self.carried(port).filter(|carried| carried.route.way == Way::ToRos);
        let missing = || DeliveryError::NoInput { type_name: TYPE, port: port.to_owned() };
        found.ok_or_else(missing)?.publish(message)
    }
}

impl Module for Bridge {
    fn interface(&self) -> &Interface {
        &self.interface
    }

    fn deliver(&mut self, port: &str, bytes: &[u8], _: Time) -> Result<Delivery, DeliveryError> {
        self.publish(port, value::message_in(bytes).map(Cow::Borrowed))
    }

    fn deliver_from(&mut self, port: &str, source: &mut dyn Source, _: Time) -> Result<Delivery, DeliveryError> {
        self.publish(port, value::message_of(source).map(Cow::Owned))
    }

    fn lose(&mut self, port: &str, count: u64) {
        if let Some(Carried { end: End::ToRos { counts, .. }, .. }) = self.carried(port) {
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
        self.session.iter_mut().for_each(RosSession::look_at_router);
        for carried in &self.carried {
            if let End::Call { client: Some(client), .. } = &carried.end {
                client.forget();
            }
        }
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
        let mut signals = vec![setup::signal("router".to_owned(), u64::from(router))];
        let graph = lock(&self.graph);
        for carried in &self.carried {
            let Counts { received, lost, refused } = carried.counts();
            let (label, other_types) =
                (carried.route.label(), graph.count(&carried.route.name, carried.route.way.partner()));
            let named = [("received", received), ("lost", lost), ("refused", refused), ("of other types", other_types)];
            signals.extend(named.map(|(word, count)| setup::signal(format!("{label} {word}"), count)));
        }
        signals
    }

    fn serve(&mut self, name: &str, argument: &[u8], _: Activity, reply: RawReply) {
        match self.carried(name).map(|carried| &mut carried.end) {
            Some(End::Call { client: Some(client), .. }) => client.call(argument, Caller::Process(reply)),
            Some(End::Call { client: None, .. }) => {
                let reason = format!("`{name}` cannot answer now: the bridge does not run");
                reply.answer(Err(ObjectError::Refused { reason }));
            }
            _ => {
                let known = self.interface.exports.iter().map(|export| export.name.to_owned()).collect();
                reply.answer(Err(ObjectError::NoSuchProcedure { name: name.to_owned(), known }));
            }
        }
    }

    fn drain_calls(&mut self, order: &mut dyn FnMut(&'static str, CallOrder)) {
        for Carried { port, end, .. } in &self.carried {
            let End::Serve { server: Some(server), .. } = end else { continue };
            while let Some((number, argument)) = server.next() {
                order(port, CallOrder::Make { number, to: None, argument, within: ANSWER_WITHIN });
            }
        }
    }

    fn answered(&mut self, call: &str, number: u64, result: Result<Vec<u8>, ObjectError>) -> Delivery {
        if let Some(End::Serve { server: Some(server), .. }) = self.carried(call).map(|carried| &carried.end) {
            server.answer(number, result);
        }
        Delivery::Stored
    }

    fn take_waker(&mut self, waker: Waker) {
        self.waker = Some(waker);
    }
}
