//! Reads connections with topics of ROS 2: `avoid, Cmd -> topic("/cmd_vel", qos = reliable(10));`

use super::outside;
use crate::check::names::Names;
use crate::check::spec::TopicConnection;
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::SyntaxKind::{self, Number};
use crate::syntax::ast::{Name, Node, Token};
use ros::logic::key::GraphName;
use ros::logic::qos::Qos;
use ros::logic::route::{Way, quality};

/// The depth of a connection that names no quality of service, as of ROS 2.
const DEPTH: u64 = 10;

/// Returns the connections of a group with topics; reports the impossible ones.
pub(super) fn read(group: &Node, names: &mut Names<'_>) -> Vec<TopicConnection> {
    let mut all = Vec::new();
    outside::each(group, SyntaxKind::Topic, misplaced, names, |found, names| {
        let way = if found.is_outward { Way::ToRos } else { Way::FromRos };
        match (name_of(&found.name), quality_of(&found.outside)) {
            (Ok(name), Ok(qos)) => {
                let span = found.node.span();
                let of = |endpoint| TopicConnection { endpoint, name: name.clone(), qos, way, span };
                all.extend(found.ends(names).into_iter().map(of));
            }
            (name, qos) => {
                let problems = [name.err(), qos.err()];
                problems.into_iter().flatten().for_each(|why| names.diagnostics.push(*why));
            }
        }
    });
    all
}

/// Returns the reason why a topic is not allowed in a connection, if so.
fn misplaced(connection: &Node, topics: &[Node], owner: Option<&Node>) -> Option<Diagnostic> {
    let error = |node: &Node, message: &str| Diagnostic::new(Code::E0309, node.span(), message);
    if topics.len() > 1 || connection.child(SyntaxKind::Keys).is_some() {
        let diagnostic = error(topics.last()?, "a topic is connected with a port of a process, and with nothing else");
        return Some(diagnostic.help("one end is a port: `topic(\"/scan\", qos = sensor) -> avoid, Scan;`"));
    }
    if let Some(quality) = connection.child(SyntaxKind::Quality) {
        let diagnostic = error(&quality, "a connection with a topic has no quality but its `qos`");
        return Some(
            diagnostic.help("write `qos = reliable(10)`, `best_effort(10)`, `transient_local(1)` or `sensor`"),
        );
    }
    let owner = owner?;
    let diagnostic = error(&topics[0], "a topic is connected while the mission runs, whatever connection set is open");
    Some(outside::owned(diagnostic, owner))
}

fn name_of(text: &Token) -> Result<GraphName, Box<Diagnostic>> {
    let written = text.content();
    let name = GraphName::parse(&written).filter(|_| written.starts_with('/'));
    name.ok_or_else(|| {
        let message = format!("{written:?} is not the name of a topic of ROS 2");
        let diagnostic = Diagnostic::new(Code::E0309, text.span(), message);
        Box::new(diagnostic.help("it begins with `/`, has words of letters, digits and `_`, and at most 247 bytes"))
    })
}

/// Returns the quality of service; without one it is that of `reliable(10)`.
fn quality_of(topic: &Node) -> Result<Qos, Box<Diagnostic>> {
    let Some(node) = topic.child(SyntaxKind::TopicQuality) else {
        return Ok(Qos { depth: DEPTH, ..Qos::default() });
    };
    // Without a word the text is damaged, which was reported.
    let Some(Name { text: word, .. }) = node.names().next() else { return Ok(Qos::default()) };
    // A number that cannot be a depth is read as 0, which is refused.
    let depth = node.token(Number).map(|number| number.text().replace('_', "").parse().unwrap_or(0));
    quality(&word, depth).map_err(|why| Box::new(Diagnostic::new(Code::E0309, node.span(), why)))
}
