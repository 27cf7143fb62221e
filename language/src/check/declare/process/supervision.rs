//! Reads how a group supervises its programs: `supervision { strategy one_for_all; restarts 3 within 10 s; backoff 1 s to 30 s; }`.

use super::backoff::backoff;
use crate::check::names::twice;
use crate::check::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Backoff, Intensity, RESTARTS_MAX, Strategy, Supervision};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Constant, Number};
use crate::syntax::ast::{Name, Node};
use std::collections::BTreeMap;

/// Reads the supervision of a group, if the group has one, and the back-off of its programs.
pub(super) fn supervision(group: &Node, reader: &mut Reader<'_>) -> Option<(Supervision, Option<Backoff>)> {
    let section = group.child(SyntaxKind::Supervision)?;
    let (mut supervision, mut pauses) = (Supervision::default(), None);
    let mut first: BTreeMap<String, Span> = BTreeMap::new();
    for rule in section.children_of(SyntaxKind::Policy) {
        let mut names = rule.names();
        let Some(name) = names.next() else { continue };
        if let Some(&first) = first.get(&name.text) {
            reader.diagnostics.push(twice("rule", &name.text, name.span, first));
            continue;
        }
        first.insert(name.text.clone(), name.span);
        let words: Vec<Name> = names.collect();
        if name.text == "backoff" {
            pauses = backoff(&rule, &words, reader);
            continue;
        }
        let words: Vec<&str> = words.iter().map(|word| word.text.as_str()).collect();
        read(&mut supervision, &name, &words, &rule, reader);
    }
    Some((supervision, pauses))
}

fn read(supervision: &mut Supervision, name: &Name, words: &[&str], rule: &Node, reader: &mut Reader<'_>) {
    let before = reader.diagnostics.count();
    let (is_read, help) = if name.text == "strategy" {
        let strategy = match words {
            ["one_for_one"] => Some(Strategy::OneForOne),
            ["one_for_all"] => Some(Strategy::OneForAll),
            ["rest_for_one"] => Some(Strategy::RestForOne),
            _ => None,
        };
        supervision.strategy = strategy.unwrap_or_default();
        (strategy.is_some(), "write `strategy one_for_one`, `one_for_all` or `rest_for_one`")
    } else {
        supervision.intensity = intensity(words, rule, reader);
        (
            supervision.intensity.is_some(),
            "write `restarts 3 within 10 s`: a number of restarts from 0 to 1000, and a time",
        )
    };
    if !is_read && reader.diagnostics.count() == before {
        let message = format!("this `{}` has a wrong form", name.text);
        reader.diagnostics.push(Diagnostic::new(Code::E0009, rule.span(), message).help(help));
    }
}

fn intensity(words: &[&str], rule: &Node, reader: &mut Reader<'_>) -> Option<Intensity> {
    let restarts = rule.token(Number).and_then(|number| number.text().parse().ok());
    let restarts = restarts.filter(|restarts| *restarts <= RESTARTS_MAX && words == ["within"])?;
    let within = reader.duration(&rule.child(Constant)?).filter(|within| !within.is_zero())?;
    Some(Intensity { restarts, within })
}
