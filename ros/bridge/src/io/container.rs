//! The client of the services of a container of components.

use super::managed::Bell;
use super::services::{Caller, Client, Service, from_answer, to_value};
use super::{Graph, RosSession, lock};
use crate::logic::container::{Answer, Effect, Input, Loaded};
use crate::logic::network::Network;
use crate::logic::replies::Failure;
use controllers::ros::composition_interfaces::{
    ListNodesRequest, ListNodesResponse, LoadNodeRequest, LoadNodeResponse,
};
use ros::logic::key::{GraphName, Topic};
use ros::logic::name::{Folder, TypeName};
use ros::logic::route::Way;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// The package of the services.
const PACKAGE: &str = "composition_interfaces";
/// The longest reason of a container that is passed on, in characters.
const REASON_MAX: usize = 500;

/// A component to load.
#[derive(Clone, Debug)]
pub(crate) struct Request {
    /// The component, for a person.
    pub(crate) shown: String,
    /// The full name of its node.
    pub(crate) node: String,
    pub(crate) message: LoadNodeRequest,
}

/// A container, from outside.
#[derive(Debug)]
pub(crate) struct ContainerNode {
    session: RosSession,
    load: Client,
    list: Client,
    heard: Arc<Mutex<VecDeque<Input>>>,
    bell: Arc<Bell>,
}

impl ContainerNode {
    /// Opens a session for the services of a container; `own` is the name of the node of this session in ROS 2.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn open(name: &GraphName, network: &Network, own: String, bell: Arc<Bell>) -> Result<Self, String> {
        let topic = |part: &str, of: &str| {
            super::topic(network, &format!("{name}/_container/{part}"), TypeName::new(PACKAGE, Folder::Srv, of))
        };
        let (load, list) = (topic("load_node", "LoadNode")?, topic("list_nodes", "ListNodes")?);
        let graph = Graph::default();
        for topic in [&load, &list] {
            lock(&graph).expect(topic.clone(), Way::Call.partner());
        }
        let session = RosSession::open(network, own, graph)?;
        let client = |id: u64, topic: &Topic| session.client(id, topic, &Service::new(&topic.of)?);
        let (load, list) = (client(1, &load)?, client(2, &list)?);
        Ok(Self { session, load, list, heard: Arc::default(), bell })
    }

    /// Returns the news since the last call.
    pub(crate) fn news(&mut self) -> Vec<Input> {
        self.session.look_at_router();
        let are_there = self.load.has_server() && self.list.has_server();
        let mut news = Vec::from_iter(lock(&self.heard).drain(..));
        news.push(Input::Services { are_there });
        news
    }

    /// Sends a request. Its answer comes with the news.
    pub(crate) fn perform(&mut self, effect: Effect, components: &[Request]) {
        let (heard, bell) = (Arc::clone(&self.heard), Arc::clone(&self.bell));
        let tell = move |input: Input| {
            lock(&heard).push_back(input);
            bell.ring();
        };
        match effect {
            Effect::Start => {}
            Effect::Load { number, component } => {
                let Some(Request { shown, node, message }) = components.get(component) else { return };
                let (shown, node) = (shown.clone(), node.clone());
                let take = move |answer: Result<Vec<u8>, Failure>| {
                    let answer = loaded(answer, &node);
                    tracing::info!(component = %shown, ?answer, "the container was asked to load a component");
                    tell(Input::Loaded { number, answer });
                };
                self.load.call(&to_value(message), Caller::own(take));
            }
            Effect::List { number } => {
                let take = move |answer: Result<Vec<u8>, Failure>| {
                    tell(Input::Listed { number, components: listed(answer) });
                };
                self.list.call(&to_value(&ListNodesRequest::default()), Caller::own(take));
            }
        }
    }

    /// Closes the session, and waits for a limited time until it is closed.
    pub(crate) fn close(self) {
        self.session.close();
    }
}

/// Returns the answer to the request to load the component with this node.
fn loaded(answer: Result<Vec<u8>, Failure>, node: &str) -> Answer {
    let Some(told) = from_answer::<LoadNodeResponse>(answer) else { return Answer::Missing };
    if !told.success {
        let reason = told.error_message.chars().map(|c| if c.is_control() { ' ' } else { c });
        return Answer::Failed { why: reason.take(REASON_MAX).collect::<String>().trim().to_owned() };
    }
    if told.full_node_name != node {
        tracing::warn!(node, found = told.full_node_name, "a component does not use the name that it was given");
    }
    Answer::Done { id: told.unique_id }
}

fn listed(answer: Result<Vec<u8>, Failure>) -> Option<Vec<Loaded>> {
    let ListNodesResponse { full_node_names, unique_ids } = from_answer(answer)?;
    let all = full_node_names.into_iter().zip(unique_ids);
    Some(all.map(|(node, id)| Loaded { id, node }).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::value;
    use crate::setup;
    use controllers::ros::Message;
    use ros::logic::cdr;

    fn answer<M: Message>(message: &M) -> Result<Vec<u8>, Failure> {
        Ok(to_value(message))
    }

    #[test]
    fn requests_and_answers_have_their_types() {
        let schema = |name: &str| setup::schema(&TypeName::parse(name).unwrap()).unwrap();
        for (request, of) in [
            (to_value(&LoadNodeRequest::default()), "composition_interfaces/srv/LoadNode_Request"),
            (to_value(&ListNodesRequest::default()), "composition_interfaces/srv/ListNodes_Request"),
        ] {
            cdr::check(&schema(of), value::message_in(&request).unwrap()).unwrap();
        }
        let told = |success: bool, error_message: &str, unique_id: u64| LoadNodeResponse {
            success,
            error_message: error_message.to_owned(),
            full_node_name: "/a".to_owned(),
            unique_id,
        };
        assert_eq!(loaded(answer(&told(true, "", 3)), "/a"), Answer::Done { id: 3 });
        let why = "no class\n\u{1b}[0m of this name".repeat(100);
        let Answer::Failed { why } = loaded(answer(&told(false, &why, 0)), "/a") else { panic!("it has failed") };
        assert!(why.len() <= REASON_MAX && why.starts_with("no class  [0m of"), "{why}");
        assert_eq!(loaded(Err(Failure::Busy), "/a"), Answer::Missing);
        assert_eq!(loaded(Ok(vec![4, 0, 1, 0, 0]), "/a"), Answer::Missing);
        let list = ListNodesResponse { full_node_names: vec!["/a".to_owned(), "/b".to_owned()], unique_ids: vec![7] };
        assert_eq!(listed(answer(&list)), Some(vec![Loaded { id: 7, node: "/a".to_owned() }]));
        assert_eq!(listed(Err(Failure::Busy)), None);
    }
}
