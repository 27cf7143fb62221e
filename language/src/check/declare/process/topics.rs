//! Reads connections with topics and services of ROS 2: `avoid, Cmd -> topic("/cmd_vel", qos = reliable(10));`,
//! `task, Reset -> service("/reset");`

use super::outside;
use crate::check::names::Names;
use crate::check::ros_name::{self, NameText};
use crate::check::spec::TopicConnection;
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::SyntaxKind::{self, Number};
use crate::syntax::ast::{Name, Node, Token};
use ros::logic::frame::FramePrefix;
use ros::logic::qos::Qos;
use ros::logic::route::{SERVICE, Way, quality};

/// The depth of a connection that names no quality of service, as of ROS 2.
const DEPTH: u64 = 10;

/// Returns the connections of a group with topics and services; reports the impossible ones.
pub(super) fn read(group: &Node, names: &mut Names<'_>) -> Vec<TopicConnection> {
    let mut all = Vec::new();
    outside::each(group, SyntaxKind::Topic, misplaced, names, |found, names| {
        let way = match (found.is_outward, is_service(&found.outside)) {
            (true, false) => Way::ToRos,
            (false, false) => Way::FromRos,
            (true, true) => Way::Call,
            (false, true) => Way::Serve,
        };
        let (name, qos) = (name_of(&found.name, word(&found.outside)), quality_of(&found.outside));
        match (name, qos, frames_of(&found.outside)) {
            (Ok(name), Ok(qos), Ok(frames)) => {
                let span = found.node.span();
                let of = |endpoint| {
                    let (name, frames) = (name.clone(), frames.clone());
                    TopicConnection { endpoint, name, qos, frames, way, span }
                };
                all.extend(found.ends(names).into_iter().map(of));
            }
            (name, qos, frames) => {
                let problems = [name.err(), qos.err(), frames.err()];
                problems.into_iter().flatten().for_each(|why| names.diagnostics.push(*why));
            }
        }
    });
    all
}

fn is_service(topic: &Node) -> bool {
    word(topic) == "service"
}

/// Returns `topic` or `service`.
fn word(topic: &Node) -> &'static str {
    if topic.names().next().is_some_and(|name| name.text == "service") { "service" } else { "topic" }
}

/// Returns the reason why a topic is not allowed in a connection. None if it is allowed.
fn misplaced(connection: &Node, topics: &[Node], owner: Option<&Node>) -> Option<Diagnostic> {
    let error = |node: &Node, message: &str| Diagnostic::new(Code::E0309, node.span(), message);
    let of = word(topics.last()?);
    if topics.len() > 1 || connection.child(SyntaxKind::Keys).is_some() {
        let message = format!("a {of} can be connected only with a port of a process");
        let diagnostic = error(topics.last()?, &message);
        return Some(diagnostic.help("one end must be a port: `topic(\"/scan\", qos = sensor) -> avoid, Scan;`"));
    }
    if let Some(quality) = connection.child(SyntaxKind::Quality) {
        if of == "service" {
            return Some(error(&quality, "a connection with a service cannot have a quality"));
        }
        let diagnostic = error(&quality, "a connection with a topic can have only the quality `qos`");
        return Some(
            diagnostic.help("write `qos = reliable(10)`, `best_effort(10)`, `transient_local(1)` or `sensor`"),
        );
    }
    let owner = owner?;
    let message =
        format!("a connection with a {of} cannot be in a connection set: it is open as long as the mission runs");
    Some(outside::owned(error(&topics[0], &message), owner))
}

fn name_of(text: &Token, of: &str) -> Result<NameText, Box<Diagnostic>> {
    let name = NameText::of(text);
    if name.can_be(ros_name::is_topic) {
        return Ok(name);
    }
    let message = format!("{:?} is not the name of a {of} of ROS 2", name.text);
    let diagnostic = Diagnostic::new(Code::E0309, text.span(), message);
    Err(Box::new(diagnostic.help("a name begins with `/` and has at most 247 bytes; its words have letters, digits and `_`, and do not begin with a digit")))
}

/// Returns the quality of service. The default is `reliable(10)`.
fn quality_of(topic: &Node) -> Result<Qos, Box<Diagnostic>> {
    let Some(node) = only(topic, SyntaxKind::TopicQuality, "qos")? else {
        return Ok(if is_service(topic) { SERVICE } else { Qos { depth: DEPTH, ..Qos::default() } });
    };
    if is_service(topic) {
        let diagnostic = Diagnostic::new(Code::E0309, node.span(), "the quality of a service cannot be chosen");
        return Err(Box::new(diagnostic.help("write only the name: `service(\"/reset\")`")));
    }
    // Without a word the text is damaged, which was reported.
    let Some(Name { text: word, .. }) = node.names().next() else { return Ok(Qos::default()) };
    // A number that cannot be a depth is read as 0, which is refused.
    let depth = node.token(Number).map(|number| number.text().replace('_', "").parse().unwrap_or(0));
    quality(&word, depth).map_err(|why| Box::new(Diagnostic::new(Code::E0309, node.span(), why)))
}

/// Returns the prefix of the frames in the messages of a topic, if it has one.
fn frames_of(topic: &Node) -> Result<Option<NameText>, Box<Diagnostic>> {
    let Some(node) = only(topic, SyntaxKind::FramePrefix, "frame_prefix")? else { return Ok(None) };
    if is_service(topic) {
        let diagnostic =
            Diagnostic::new(Code::E0309, node.span(), "the frames in the messages of a service have no prefix");
        return Err(Box::new(diagnostic.help("write the name alone: `service(\"/reset\")`")));
    }
    // Without a string the text is damaged, which was reported.
    let Some(text) = node.token(SyntaxKind::Text) else { return Ok(None) };
    let prefix = NameText::of(&text);
    let is_fit = prefix.can_be(|text| FramePrefix::parse(text).is_some());
    let wrong = || {
        let message = format!("{:?} is not a prefix of frames", prefix.text);
        let help = "write for example `\"r1/\"`: words of letters, digits, `-` and `_`, with `/` between them, and `/` or `_` at the end; at most 64 bytes";
        Box::new(Diagnostic::new(Code::E0309, text.span(), message).help(help))
    };
    if is_fit { Ok(Some(prefix)) } else { Err(wrong()) }
}

/// Returns the setting of a topic of this kind, if there is one.
fn only(topic: &Node, kind: SyntaxKind, word: &str) -> Result<Option<Node>, Box<Diagnostic>> {
    let mut all = topic.children_of(kind);
    match (all.next(), all.next()) {
        (_, Some(second)) => {
            let message = format!("`{word}` is given twice");
            Err(Box::new(Diagnostic::new(Code::E0309, second.span(), message)))
        }
        (first, None) => Ok(first),
    }
}
