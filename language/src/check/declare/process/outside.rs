//! Reads connections whose other end is outside of all processes: keys of the database, or a topic of ROS 2.

use super::endpoint;
use crate::check::index;
use crate::check::names::Names;
use crate::check::spec::{Binding, Endpoint};
use crate::diagnostic::Diagnostic;
use crate::syntax::SyntaxKind::{self, BackArrow, Text};
use crate::syntax::ast::{Node, Token};

/// A connection between a port and an end outside of all processes, as the text has it.
pub(super) struct OutsideConnection {
    pub(super) node: Node,
    /// The end outside of all processes, and its name.
    pub(super) outside: Node,
    pub(super) name: Token,
    /// Whether values go from the port to this end.
    pub(super) is_outward: bool,
    end: Node,
}

/// Returns the reason if the ends of a connection are not allowed. The arguments are the connection, its ends outside,
/// and the owner of its section.
type Misplaced = fn(&Node, &[Node], Option<&Node>) -> Option<Diagnostic>;

/// Reads the connections of a group that have ends of this kind, one after the other. Reports connections that are not
/// allowed.
pub(super) fn each(
    group: &Node,
    kind: SyntaxKind,
    misplaced: Misplaced,
    names: &mut Names<'_>,
    mut read: impl FnMut(&OutsideConnection, &mut Names<'_>),
) {
    for section in group.children_of(SyntaxKind::Connections) {
        let owner = section.child(SyntaxKind::Owner);
        for node in section.children_of(SyntaxKind::Connection) {
            let outside: Vec<Node> = node.children_of(kind).collect();
            if outside.is_empty() {
                continue;
            }
            if let Some(why) = misplaced(&node, &outside, owner.as_ref()) {
                names.diagnostics.push(why);
                continue;
            }
            let Some(outside) = outside.into_iter().next() else { continue };
            // If a part is missing, the text is damaged, which was reported.
            let (Some(name), Some(end)) = (outside.token(Text), node.child(SyntaxKind::Endpoint)) else { continue };
            let is_first = outside.span().start < end.span().start;
            let is_outward = is_first == node.token(BackArrow).is_some();
            read(&OutsideConnection { node, outside, name, is_outward, end }, names);
        }
    }
}

impl OutsideConnection {
    /// Returns the ports at the inner end of the connection. `robot[i], Claims` stands for one port of each robot.
    pub(super) fn ends(&self, names: &mut Names<'_>) -> Vec<Endpoint> {
        let mut all = Vec::new();
        let variable = index::unbound(std::slice::from_ref(&self.end), names, &[]);
        let count = variable.as_ref().map_or(1, |(_, count)| *count);
        let mut rounds = names.diagnostics.rounds();
        for round in 0..count {
            let bound: Vec<Binding> = variable.iter().map(|(name, _)| (name.clone(), round)).collect();
            let endpoint = endpoint(&self.end, names, &bound);
            names.diagnostics.end_round(&mut rounds);
            all.extend(endpoint);
        }
        all
    }
}

/// Makes the diagnostic of a connection that may not have an owner, and names the owner of its section as the reason.
pub(super) fn owned(diagnostic: Diagnostic, owner: &Node) -> Diagnostic {
    let diagnostic = diagnostic.reason(owner.span(), "these connections have an owner");
    diagnostic.help("write the connection in a section without an owner: `internal_connections{ ... }`")
}
