//! Checks the ports that are connected with topics of ROS 2.

use super::OutsideEnd;
use crate::check::spec::{Direction, Port, TopicConnection};
use crate::diagnostic::{Code, Diagnostic};
use ros::logic::library;
use ros::logic::name::{Folder, TypeName};
use ros::logic::route::Way;

/// Returns the message of ROS 2 that a type in a spec means.
pub(in crate::check) fn message(kind: &str) -> Option<TypeName> {
    library::by_spec(kind).filter(|name| name.folder() == Folder::Msg)
}

/// Returns why a port cannot be connected with a topic.
pub(super) fn check(connection: &TopicConnection, port: &Port) -> Option<Diagnostic> {
    let name = &connection.endpoint.port;
    let error = |message: String| {
        let diagnostic = Diagnostic::new(Code::E0309, name.span, message);
        diagnostic.reason(port.name.span, "declared here")
    };
    let (direction, what) = match connection.way {
        Way::ToRos => (Direction::Out, "the topic has the values of an output"),
        Way::FromRos => (Direction::In, "the topic sends to an input"),
    };
    let outside = OutsideEnd { direction, what, not_called: "a topic has messages" };
    if let Some(diagnostic) = outside.misfit(name, port, error) {
        return Some(diagnostic);
    }
    let kind = port.kind.as_ref().map(ToString::to_string);
    if kind.as_deref().and_then(message).is_some() {
        return None;
    }
    let is = kind.map_or_else(|| "has no type".to_owned(), |kind| format!("is of type `{kind}`"));
    let diagnostic = error(format!("`{}` {is}, but a topic has messages of ROS 2", name.text));
    Some(diagnostic.help("give it the type of a standard message, such as `ros.geometry.Twist`"))
}
