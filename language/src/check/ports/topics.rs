//! Checks the ports that are connected with topics and services of ROS 2.

use super::OutsideEnd;
use crate::check::spec::{Call, CallRole, Direction, Port, TopicConnection};
use crate::diagnostic::{Code, Diagnostic};
use ros::logic::frame::has_frames;
use ros::logic::library;
use ros::logic::name::{Folder, TypeName};
use ros::logic::qos::Durability;
use ros::logic::route::{Way, is_transforms};

/// Returns the message of ROS 2 that a type in a spec means.
fn message(kind: &str) -> Option<TypeName> {
    library::by_spec(kind).filter(|name| name.folder() == Folder::Msg)
}

/// Returns the type of ROS 2 that the other end of a connected port has: a message, or a service.
pub(in crate::check) fn type_of(port: &Port) -> Option<TypeName> {
    let kind = port.kind.as_ref()?.to_string();
    match &port.call {
        None => message(&kind),
        Some(call) => library::service_of(&call.argument.as_ref()?.to_string(), &kind),
    }
}

/// Returns why a port cannot be connected with a topic or a service.
pub(super) fn check(connection: &TopicConnection, port: &Port) -> Option<Diagnostic> {
    let found =
        if connection.way.is_service() { check_service(connection, port) } else { check_topic(connection, port) };
    found.map(|found| found.reason(port.name.span, "declared here"))
}

fn check_topic(connection: &TopicConnection, port: &Port) -> Option<Diagnostic> {
    let name = &connection.endpoint.port;
    let error = |message: String| Diagnostic::new(Code::E0309, name.span, message);
    let (direction, what) = if connection.way == Way::ToRos {
        (Direction::Out, "the topic publishes the values of an output")
    } else {
        (Direction::In, "the topic sends to an input")
    };
    let outside = OutsideEnd { direction, what, not_called: "only values can be connected with a topic" };
    if let Some(diagnostic) = outside.misfit(name, port, error) {
        return Some(diagnostic);
    }
    if let Some(of) = type_of(port) {
        return check_frames(connection, &of);
    }
    let kind = port.kind.as_ref();
    let is = kind.map_or_else(|| "has no type".to_owned(), |kind| format!("is of type `{kind}`"));
    let diagnostic = error(format!("`{}` {is}, but a topic has messages of ROS 2", name.text));
    Some(diagnostic.help("declare the port with the type of a standard message, such as `ros.geometry.Twist`"))
}

/// Returns why a topic cannot have messages of this type, because of the frames in them.
fn check_frames(connection: &TopicConnection, of: &TypeName) -> Option<Diagnostic> {
    let error = |message: String| Some(Diagnostic::new(Code::E0309, connection.span, message));
    if connection.frames.is_some() && !library::schema(of).is_ok_and(|schema| has_frames(&schema)) {
        let found = error(format!("`frame_prefix` changes nothing: a `{}` names no frame", of.spec()));
        return found.map(|found| found.help("leave `frame_prefix` out"));
    }
    let is_static = is_transforms(of) && connection.name.text.ends_with("/tf_static");
    if is_static && connection.qos.durability != Durability::TransientLocal {
        let found = error(format!(
            "the quality of service of `{}` keeps no transforms for late subscribers",
            connection.name.text
        ));
        return found
            .map(|found| found.help("write `qos = transient_local(1)`, as publishers of static transforms have it"));
    }
    None
}

fn check_service(connection: &TopicConnection, port: &Port) -> Option<Diagnostic> {
    let name = &connection.endpoint.port;
    let error = |message: String| Some(Diagnostic::new(Code::E0309, name.span, message));
    let is_call = connection.way == Way::Call;
    match port.call {
        None => return error(format!("`{}` is a port for data, but a service needs a port for calls", name.text)),
        Some(Call { role: CallRole::State, .. }) => {
            return error(format!("`{}` is a state, but a service needs a procedure", name.text));
        }
        Some(Call { role: CallRole::Caller, .. }) if !is_call => {
            let why = format!("`{}` is a caller, but a procedure has to answer the service", name.text);
            return error(why).map(|found| found.help("exchange the ends of the connection"));
        }
        Some(Call { role: CallRole::Procedure, .. }) if is_call => {
            let why = format!("`{}` is called, but the service needs a caller", name.text);
            return error(why).map(|found| found.help("exchange the ends of the connection"));
        }
        Some(_) => {}
    }
    if type_of(port).is_some() {
        return None;
    }
    let found = error(format!(
        "the types of `{}` are not the request and the response of a standard service of ROS 2",
        name.text
    ));
    let example = "`ros.std_srvs.Trigger_Request` as its argument and `ros.std_srvs.Trigger_Response` as its result";
    found.map(|found| found.help(format!("for example {example}")))
}
