//! The parameters of a node of ROS 2: users call its services through the process that runs its program.
//!
//! A separate thread has the session with the router, because opening the session blocks. The thread begins with the first call. So a node
//! whose parameters are never requested needs no second session.

use super::services::{Caller, Client, Service};
use super::{Graph, RosSession};
use crate::logic::network::Network;
use comms::logic::object::{Access, ExportKind, ObjectError, Signature, TypeForm};
use controllers::sdk::{ExportInterface, RawReply};
use ros::logic::key::GraphName;
use ros::logic::name::{Folder, TypeName};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// The package of the services.
const PACKAGE: &str = "rcl_interfaces";
/// The services of each node, with their types, and the right that a user needs. To set a parameter is a change of the mission, as for the
/// parameters of other programs.
const SERVICES: [(&str, &str, Access); 4] = [
    ("list_parameters", "ListParameters", Access::Look),
    ("get_parameters", "GetParameters", Access::Look),
    ("describe_parameters", "DescribeParameters", Access::Look),
    ("set_parameters", "SetParameters", Access::Deploy),
];
/// The largest number of calls that wait for the thread.
const WAITING_MAX: usize = 64;
/// How often the thread removes calls whose callers no longer wait.
const FORGET_EVERY: Duration = Duration::from_millis(500);

/// A node of ROS 2 whose parameters users may request.
#[derive(Clone, Debug)]
pub(crate) struct Asked {
    pub(crate) node: GraphName,
    pub(crate) network: Network,
    /// The name under which the session appears as a node in ROS 2.
    pub(crate) own: String,
}

/// The services of a node.
#[derive(Debug)]
pub(crate) struct NodeParameters {
    asked: Asked,
    thread: Option<Thread>,
}

#[derive(Debug)]
struct Thread {
    calls: SyncSender<Call>,
    handle: JoinHandle<()>,
}

/// A call of a service; the service is given by its index.
#[derive(Debug)]
struct Call {
    service: usize,
    argument: Vec<u8>,
    reply: RawReply,
}

/// Returns the procedures for the services of a node. They are also answered while the process does not run.
pub(crate) fn exports() -> Vec<ExportInterface> {
    let export = |(name, of, access): (&'static str, &str, Access)| {
        let of = TypeName::new(PACKAGE, Folder::Srv, of)?;
        let form = |of: TypeName| TypeForm::new(&of.spec(), "");
        let signature = Signature { argument: form(of.request()), result: form(of.response()) };
        Some(ExportInterface { name, kind: ExportKind::Procedure, signature, doc: "", is_answered_idle: true, access })
    };
    SERVICES.into_iter().filter_map(export).collect()
}

impl NodeParameters {
    /// Returns the services of a node that no user has called yet.
    pub(crate) fn new(asked: Asked) -> Self {
        Self { asked, thread: None }
    }

    /// Calls a service. The answer arrives on another thread.
    pub(crate) fn call(&mut self, name: &str, argument: &[u8], reply: RawReply) {
        let Some(service) = SERVICES.iter().position(|(known, ..)| *known == name) else {
            let known = SERVICES.iter().map(|(name, ..)| (*name).to_owned()).collect();
            return reply.answer(Err(ObjectError::NoSuchProcedure { name: name.to_owned(), known }));
        };
        let thread = match self.thread.take().map_or_else(|| Thread::start(&self.asked), Ok) {
            Ok(thread) => self.thread.insert(thread),
            Err(reason) => return reply.answer(Err(ObjectError::Refused { reason })),
        };
        if let Err(full) = thread.calls.try_send(Call { service, argument: argument.to_vec(), reply }) {
            let waiting = u32::try_from(WAITING_MAX).unwrap_or(u32::MAX);
            let (std::sync::mpsc::TrySendError::Full(call) | std::sync::mpsc::TrySendError::Disconnected(call)) = full;
            call.reply.answer(Err(ObjectError::Busy { waiting }));
        }
    }
}

impl Drop for NodeParameters {
    fn drop(&mut self) {
        let Some(Thread { calls, handle }) = self.thread.take() else { return };
        drop(calls);
        // The thread ends within the time limit for opening a session.
        if handle.join().is_err() {
            tracing::error!("the thread for parameters has panicked");
        }
    }
}

impl Thread {
    fn start(asked: &Asked) -> Result<Self, String> {
        let (calls, theirs) = sync_channel(WAITING_MAX);
        let asked = asked.clone();
        let thread = std::thread::Builder::new().name("parameters".to_owned());
        let handle = thread.spawn(move || answer(&asked, &theirs));
        let handle = handle.map_err(|error| format!("no thread can be started for the parameters: {error}"))?;
        Ok(Self { calls, handle })
    }
}

/// Executes the calls until the sender is dropped.
fn answer(asked: &Asked, calls: &Receiver<Call>) {
    let mut open: Option<Open> = None;
    loop {
        match calls.recv_timeout(FORGET_EVERY) {
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {}
            Ok(Call { service, argument, reply }) => {
                let opened = open.take().map_or_else(|| Open::new(asked), Ok);
                match opened {
                    Ok(opened) => {
                        let open = open.insert(opened);
                        if let Some(client) = open.clients.get_mut(service) {
                            client.call(&argument, Caller::User(reply));
                        }
                    }
                    // If the router is away, nothing is known about the node.
                    Err(reason) => reply.answer(Err(ObjectError::Unanswered { reason })),
                }
            }
        }
        open.iter().flat_map(|open| &open.clients).for_each(Client::forget);
    }
    if let Some(Open { session, clients }) = open {
        drop(clients);
        session.close();
    }
}

/// A session with a client for each service.
struct Open {
    session: RosSession,
    clients: Vec<Client>,
}

impl Open {
    fn new(Asked { node, network, own }: &Asked) -> Result<Self, String> {
        let session = RosSession::open(network, own.clone(), Graph::default())?;
        let client = |(id, (name, of, _)): (u64, &(&str, &str, Access))| {
            let topic = super::topic(network, &format!("{node}/{name}"), TypeName::new(PACKAGE, Folder::Srv, of))?;
            session.client(id, &topic, &Service::new(&topic.of)?)
        };
        let clients = (1..).zip(&SERVICES).map(client).collect::<Result<Vec<_>, String>>()?;
        Ok(Self { session, clients })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::sync_channel;

    #[test]
    fn only_a_deployer_sets_parameters() {
        let told = exports();
        let rights: Vec<_> = told.iter().map(|export| (export.name, export.access)).collect();
        assert_eq!(rights, SERVICES.map(|(name, _, access)| (name, access)));
        assert!(told.iter().all(|export| export.is_answered_idle));
        assert_eq!(told[3].signature.argument.name, "ros.rcl.SetParameters_Request");
    }

    #[test]
    #[ignore = "long: a router has 5 s to answer"]
    fn a_router_that_is_away_is_no_refusal_of_the_node() {
        let node = GraphName::parse("/nav").unwrap();
        // No program listens at this port.
        let network = Network::read("", "connect/endpoints=[\"tcp/127.0.0.1:1\"]", "").unwrap();
        let mut parameters = NodeParameters::new(Asked { node, network, own: "own".to_owned() });
        let (tx, answers) = sync_channel(2);
        let reply = || {
            let tx = tx.clone();
            RawReply::new(move |result| tx.send(result).unwrap(), || true)
        };
        parameters.call("get_parameters", &[], reply());
        parameters.call("delete_parameters", &[], reply());
        let first = answers.recv().unwrap().unwrap_err();
        assert!(matches!(first, ObjectError::NoSuchProcedure { .. }), "{first}");
        let second = answers.recv().unwrap().unwrap_err();
        assert!(matches!(second, ObjectError::Unanswered { .. }) && second.may_have_happened(), "{second}");
    }
}
