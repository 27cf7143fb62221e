//! Reads connections with keys of the database: `db("team/flat/claim/**") -> robot, Claims;`

use super::topics::ends;
use crate::check::names::Names;
use crate::check::spec::KeyConnection;
use crate::check::value::is_key;
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::SyntaxKind::{self, BackArrow, Text};
use crate::syntax::ast::{Node, Token};

/// Returns the connections of a group with keys; reports the impossible ones.
pub(super) fn read(group: &Node, names: &mut Names<'_>) -> Vec<KeyConnection> {
    let mut all = Vec::new();
    for section in group.children_of(SyntaxKind::Connections) {
        let owner = section.child(SyntaxKind::Owner);
        for node in section.children_of(SyntaxKind::Connection) {
            let keys: Vec<Node> = node.children_of(SyntaxKind::Keys).collect();
            let Some(first) = keys.first() else { continue };
            if let Some(why) = misplaced(&node, &keys, owner.as_ref()) {
                names.diagnostics.push(why);
                continue;
            }
            // Otherwise the text is damaged, which was reported.
            let (Some(text), Some(end)) = (first.token(Text), node.child(SyntaxKind::Endpoint)) else { continue };
            let is_first = first.span().start < end.span().start;
            let is_write = is_first == node.token(BackArrow).is_some();
            match keys_of(&text, is_write) {
                Ok(keys) => all.extend(connections(&node, &end, &keys, is_write, names)),
                Err(why) => names.diagnostics.push(*why),
            }
        }
    }
    all
}

/// Returns the reason why keys are not allowed in a connection, if so.
fn misplaced(connection: &Node, keys: &[Node], owner: Option<&Node>) -> Option<Diagnostic> {
    let error = |node: &Node, message: &str| Diagnostic::new(Code::E0308, node.span(), message);
    if let [_, second, ..] = keys {
        let diagnostic = error(second, "both ends of the connection are keys of the database");
        return Some(diagnostic.help("one of them is a port of a process: `db(\"team/flat/**\") -> robot, Claims;`"));
    }
    if let Some(quality) = connection.child(SyntaxKind::Quality) {
        let diagnostic =
            error(&quality, "a connection with the database has no `push`, `pull`, `latch`, `queue` or `rate`");
        return Some(diagnostic.help("the present values come first, then each change, and none is left out"));
    }
    let owner = owner?;
    let diagnostic =
        error(&keys[0], "the database is connected for as long as the process runs, whatever connection set is open");
    let diagnostic = diagnostic.reason(owner.span(), "these connections have an owner");
    Some(diagnostic.help("write it in a section of its own: `internal_connections{ ... }`"))
}

/// Reads a key, or a prefix that ends in `/**`, which is returned with a `/` at its end.
fn keys_of(text: &Token, is_write: bool) -> Result<String, Box<Diagnostic>> {
    let written = text.content();
    let error = |message: String| Diagnostic::new(Code::E0308, text.span(), message);
    let (key, end) = written.strip_suffix("/**").map_or((written.as_str(), ""), |prefix| (prefix, "/"));
    if !is_key(key) {
        let diagnostic = error(format!("{written:?} is neither a key nor a prefix of the database"));
        return Err(Box::new(
            diagnostic.help("a key is a path of words, a prefix ends in `/**`: `db(\"team/flat/claim/**\")`"),
        ));
    }
    let words: Vec<&str> = key.split('/').collect();
    let is_for_people = match words[..] {
        ["sys", ..] => true,
        ["robot", _, "params" | "node" | "deployments", ..] | ["team", "schema", ..] => is_write,
        _ => false,
    };
    if is_for_people {
        let message = if words[0] == "sys" { "is the database's own" } else { "is not written by programs" };
        return Err(Box::new(error(format!("`{key}` {message}"))));
    }
    if !["team", "robot", "local"].contains(&words[0]) || words[0] == "robot" && words.len() < 2 {
        let diagnostic = error(format!("`{key}` is in no namespace"));
        return Err(Box::new(diagnostic.help("a key is `team/NAME`, `robot/ROBOT/NAME` or `local/NAME`")));
    }
    if words[0] == "local" && !is_write {
        let diagnostic = error(format!("`{key}` cannot be watched: what is below `local/` has no history"));
        return Err(Box::new(diagnostic.help("the program can read it when it wants to know")));
    }
    if end.is_empty() && words.len() < 2 {
        return Err(Box::new(
            error(format!("`{key}` alone is not a key")).help(format!("all keys below it are `db(\"{key}/**\")`")),
        ));
    }
    Ok(format!("{key}{end}"))
}

fn connections(node: &Node, end: &Node, keys: &str, is_write: bool, names: &mut Names<'_>) -> Vec<KeyConnection> {
    let of = |endpoint| KeyConnection { endpoint, keys: keys.to_owned(), is_write, span: node.span() };
    ends(end, names).into_iter().map(of).collect()
}
