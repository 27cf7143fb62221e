//! Reads the back-off of a program that has died, which is the pause before its next start: `backoff 100 ms to 30 s`.

use crate::check::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Backoff;
use crate::syntax::SyntaxKind::Constant;
use crate::syntax::ast::{Name, Node};

/// Reads a back-off from a statement. `words` are the words of the statement after the first. A mistake is reported.
pub(super) fn backoff(statement: &Node, words: &[Name], reader: &mut Reader<'_>) -> Option<Backoff> {
    let before = reader.diagnostics.count();
    let backoff = read(statement, words, reader);
    if backoff.is_none() && reader.diagnostics.count() == before {
        let help = "write `backoff 100 ms to 30 s`: the first pause (at least 10 ms), which doubles with each further \
                    death, and the longest pause (at most 1 h)";
        let message = "this `backoff` has a wrong form";
        reader.diagnostics.push(Diagnostic::new(Code::E0009, statement.span(), message).help(help));
    }
    backoff
}

fn read(statement: &Node, words: &[Name], reader: &mut Reader<'_>) -> Option<Backoff> {
    let times: Vec<Node> = statement.children_of(Constant).collect();
    let ([first, longest], [to]) = (times.as_slice(), words) else { return None };
    let is_in_order = first.span().end <= to.span.start && to.span.end <= longest.span().start;
    if to.text != "to" || !is_in_order {
        return None;
    }
    let backoff = Backoff { first: reader.duration(first)?, longest: reader.duration(longest)? };
    backoff.is_valid().then_some(backoff)
}
