//! Reads connections between ports and keys of the database: `db("team/flat/claim/**") -> robot, Claims;`

use super::outside;
use crate::check::names::Names;
use crate::check::spec::KeyConnection;
use crate::check::value::is_key;
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::SyntaxKind;
use crate::syntax::ast::{Node, Token};

/// Returns the connections of a group with keys. Reports connections that are impossible.
pub(super) fn read(group: &Node, names: &mut Names<'_>) -> Vec<KeyConnection> {
    let mut all = Vec::new();
    outside::each(group, SyntaxKind::Keys, misplaced, names, |found, names| {
        let (is_write, span) = (found.is_outward, found.node.span());
        match keys_of(&found.name, is_write) {
            Ok(keys) => {
                let of = |endpoint| KeyConnection { endpoint, keys: keys.clone(), is_write, span };
                all.extend(found.ends(names).into_iter().map(of));
            }
            Err(why) => names.diagnostics.push(*why),
        }
    });
    all
}

/// Returns the reason if keys are not allowed in a connection.
fn misplaced(connection: &Node, keys: &[Node], owner: Option<&Node>) -> Option<Diagnostic> {
    let error = |node: &Node, message: &str| Diagnostic::new(Code::E0308, node.span(), message);
    if let [_, second, ..] = keys {
        let diagnostic = error(second, "both ends of the connection are keys of the database");
        return Some(diagnostic.help("one end must be a port of a process: `db(\"team/flat/**\") -> robot, Claims;`"));
    }
    if let Some(quality) = connection.child(SyntaxKind::Quality) {
        let diagnostic =
            error(&quality, "a connection with the database has no `push`, `pull`, `latch`, `queue` or `rate`");
        return Some(
            diagnostic.help("such a connection always carries every value: the present values first, then each change"),
        );
    }
    let owner = owner?;
    let diagnostic = error(
        &keys[0],
        "a connection with the database cannot be in a connection set: it is open as long as the process runs",
    );
    Some(outside::owned(diagnostic, owner))
}

/// Reads a key, or a prefix that ends in `/**`. A prefix is returned with a `/` at its end.
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
        let message =
            if words[0] == "sys" { "is reserved for the database itself" } else { "cannot be written by programs" };
        return Err(Box::new(error(format!("`{key}` {message}"))));
    }
    if !["team", "robot", "local"].contains(&words[0]) || words[0] == "robot" && words.len() < 2 {
        let diagnostic = error(format!("`{key}` does not belong to a namespace"));
        return Err(Box::new(diagnostic.help("a key is `team/NAME`, `robot/ROBOT/NAME` or `local/NAME`")));
    }
    if words[0] == "local" && !is_write {
        let diagnostic = error(format!("`{key}` cannot be watched: keys below `local/` have no history"));
        return Err(Box::new(diagnostic.help("the program can read the key itself when it needs the value")));
    }
    if end.is_empty() && words.len() < 2 {
        return Err(Box::new(
            error(format!("`{key}` alone is not a key"))
                .help(format!("to connect all keys below it, write `db(\"{key}/**\")`")),
        ));
    }
    Ok(format!("{key}{end}"))
}
