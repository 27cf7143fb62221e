//! A topic or a service that a bridge carries, with its endpoint in ROS 2.

use crate::io::services::{Client, Server, Service};
use crate::io::{Publisher, RosSession, Subscriber, Waiting, depth, lock};
use crate::logic::arrivals::{Arrivals, Counts};
use crate::logic::conversion::Conversion;
use crate::logic::network::Network;
use crate::setup;
use comms::logic::object::{Access, ExportKind, Signature, TypeForm};
use controllers::sdk::{CallInterface, Delivery, DeliveryError, Direction, ExportInterface, PortInterface, Waker};
use ros::logic::key::Topic;
use ros::logic::name::TypeName;
use ros::logic::route::{Route, Way};
use std::borrow::Cow;
use std::sync::{Arc, Mutex};

/// A topic or a service that a bridge carries.
#[derive(Debug)]
pub(crate) struct Carried {
    /// The port, the export or the call of the bridge that represents it.
    pub(crate) port: &'static str,
    type_name: &'static str,
    pub(crate) route: Route,
    hash: String,
    pub(crate) end: End,
}

/// The endpoint in ROS 2, which is there while the bridge runs.
#[derive(Debug)]
pub(crate) enum End {
    /// Wires to the topic.
    ///
    /// The last value of a latched wire may come before there is a publisher.
    ToRos { publisher: Option<Box<Publisher>>, early: Option<Vec<u8>>, conversion: Conversion, counts: Counts },
    /// The topic to wires.
    FromRos { subscriber: Option<Subscriber>, waiting: Waiting },
    /// Calls of the mission to the service.
    Call { client: Option<Client>, service: Arc<Service> },
    /// Requests of ROS 2 to a procedure.
    Serve { server: Option<Server>, service: Arc<Service> },
}

impl Carried {
    /// Returns the meaning of a route, without an endpoint.
    ///
    /// # Errors
    /// A sentence for a person.
    pub(crate) fn new(route: Route, network: &Network) -> Result<Self, String> {
        let schema = setup::schema(&route.of)?;
        let hash = network.hash(&schema);
        let end = match route.way {
            Way::ToRos => {
                let conversion = Conversion::new(&route, schema);
                End::ToRos { publisher: None, early: None, conversion, counts: Counts::default() }
            }
            Way::FromRos => {
                let arrivals = Arrivals::new(Conversion::new(&route, schema), depth(route.qos));
                let waiting = Arc::new(Mutex::new(arrivals));
                End::FromRos { subscriber: None, waiting }
            }
            Way::Call => End::Call { client: None, service: Service::new(&route.of)? },
            Way::Serve => End::Serve { server: None, service: Service::new(&route.of)? },
        };
        let (port, type_name) = (setup::for_ever(route.port()), setup::for_ever(route.of.spec()));
        Ok(Self { port, type_name, route, hash, end })
    }

    /// Returns its topic or service, with the hash of its type.
    pub(crate) fn topic(&self) -> Topic {
        let (name, of) = (self.route.name.clone(), self.route.of.clone());
        Topic { name, of, hash: self.hash.clone() }
    }

    /// Makes its endpoint; `id` is the number of that within the session.
    ///
    /// # Errors
    /// A sentence for a person.
    pub(crate) fn connect(&mut self, session: &RosSession, id: u64, waker: Waker) -> Result<(), String> {
        let (topic, qos) = (self.topic(), self.route.qos);
        match &mut self.end {
            End::ToRos { publisher, early, .. } => {
                let opened = session.publisher(id, &topic, qos)?;
                early.take().into_iter().for_each(|message| opened.publish(message));
                *publisher = Some(Box::new(opened));
            }
            End::FromRos { subscriber, waiting } => {
                *subscriber = Some(session.subscriber(id, &topic, qos, Arc::clone(waiting), waker)?);
            }
            End::Call { client, service } => *client = Some(session.client(id, &topic, service)?),
            End::Serve { server, service } => *server = Some(session.server(id, &topic, service, waker)?),
        }
        Ok(())
    }

    /// Ends its endpoint.
    pub(crate) fn disconnect(&mut self) {
        match &mut self.end {
            End::ToRos { publisher, .. } => *publisher = None,
            End::FromRos { subscriber, .. } => *subscriber = None,
            End::Call { client, .. } => *client = None,
            End::Serve { server, .. } => *server = None,
        }
    }

    /// Publishes the message of a value, or refuses it.
    pub(crate) fn publish(&mut self, message: Option<Cow<'_, [u8]>>) -> Result<Delivery, DeliveryError> {
        let malformed = || DeliveryError::malformed(self.port, self.type_name);
        let End::ToRos { publisher, early, conversion, counts } = &mut self.end else { return Err(malformed()) };
        // A process of ROS 2 may end because of a malformed message.
        let Some(Ok(message)) = message.map(|message| conversion.convert(message)) else {
            counts.refused += 1;
            return Err(malformed());
        };
        counts.received += 1;
        match publisher {
            Some(publisher) => publisher.publish(message.into_owned()),
            None => *early = Some(message.into_owned()),
        }
        Ok(Delivery::Stored)
    }

    /// Returns its port, if it is a topic.
    pub(crate) fn port_interface(&self) -> Option<PortInterface> {
        let direction = match self.route.way {
            Way::ToRos => Direction::In,
            Way::FromRos => Direction::Out,
            Way::Call | Way::Serve => return None,
        };
        Some(PortInterface::wire(self.port, direction, self.type_name))
    }

    /// Returns its export, if the mission calls a service.
    pub(crate) fn export(&self) -> Option<ExportInterface> {
        (self.route.way == Way::Call).then(|| ExportInterface {
            name: self.port,
            kind: ExportKind::Procedure,
            signature: self.signature(),
            doc: "",
            is_answered_idle: false,
            access: Access::Operate,
        })
    }

    /// Returns its call, if ROS 2 calls a procedure.
    pub(crate) fn call(&self) -> Option<CallInterface> {
        let is_call = self.route.way == Way::Serve;
        is_call.then(|| CallInterface { name: self.port, signature: self.signature(), doc: "", required: true })
    }

    fn signature(&self) -> Signature {
        let form = |of: TypeName| TypeForm::new(&of.spec(), "");
        Signature { argument: form(self.route.of.request()), result: form(self.route.of.response()) }
    }

    /// Returns what happened to its messages or calls.
    pub(crate) fn counts(&self) -> Counts {
        match &self.end {
            End::ToRos { counts, .. } => *counts,
            End::FromRos { waiting, .. } => lock(waiting).counts(),
            End::Call { service, .. } | End::Serve { service, .. } => *lock(&service.counts),
        }
    }
}
