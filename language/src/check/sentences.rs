//! Reads the sentences of `verify` blocks, word by word, and resolves their names in a plan.

mod formula;
mod names;
mod words;

use super::declare::Tree;
use super::diagnostics::Diagnostics;
use super::spec::Spec;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Plan;
use crate::similar;
use crate::sites::{Consequence, EventKind, Fault, Moment, NTH_MAX, Occurrence, ProcessRef, Property, Sentence};
use crate::source::Span;
use crate::syntax::SyntaxKind;
use crate::syntax::ast::{Name, Node};
use names::Names;
use std::time::Duration;
use words::{Kind, Words};

pub(crate) use names::{EVENTS, STATES};
pub(crate) use words::{Word, is_ordinal_suffix, is_word, words_of};

/// The forms of sentences, which a message shows if a text has none of them.
const FORMS: [&str; 15] = [
    "never a with b",
    "always a implies b",
    "b only after a.done",
    "after a.done: b stopped within 2 s (or `never b`, `eventually b`)",
    "after the 2nd start of a: never b (or `end of a`, `abort of a`, `a.done`)",
    "once a runs: never b with c (or `always b implies c`, `never b`, `eventually b`, `b stopped`)",
    "on crash of any: b stopped (or of a process; `hang of`, `loss of host(c1)`)",
    "eventually a",
    "can finish",
    "finishes within 90 s",
    "stops within 2 s",
    "exclusive a, b",
    "a at most once",
    "assume a takes 1 s .. 15 s",
    "holds ltl \"G (a -> F b.done)\"",
];

/// A sentence, and the process that the sentence is about.
pub(super) struct Stated {
    process: Name,
    node: Node,
}

/// Returns the sentences of all blocks. Reports a block about a process that does not exist.
pub(super) fn read(trees: &[Tree], spec: &Spec, diagnostics: &mut Diagnostics) -> Vec<Stated> {
    let mut all = Vec::new();
    for item in trees.iter().filter(|tree| tree.is_part).flat_map(|tree| tree.root.children().collect::<Vec<_>>()) {
        let Some(title) = item.title() else { continue };
        let is_block = item.kind() == SyntaxKind::Verify;
        let blocks = if is_block { vec![item] } else { item.children_of(SyntaxKind::Verify).collect() };
        if blocks.is_empty() {
            continue;
        }
        if spec.processes.iter().all(|process| process.name.text != title.text) {
            let message = format!("unknown process `{}`", title.text);
            diagnostics.push(Diagnostic::new(Code::E0201, title.span, message));
            continue;
        }
        for node in blocks.iter().flat_map(|block| block.children_of(SyntaxKind::Sentence).collect::<Vec<_>>()) {
            all.push(Stated { process: title.clone(), node });
        }
    }
    all
}

/// Returns the sentences about the groups of a plan. A sentence that cannot be read is reported once.
pub(super) fn resolve(stated: &[Stated], plan: &Plan, diagnostics: &mut Diagnostics) -> Vec<Property> {
    let mut properties = Vec::new();
    for one in stated {
        let groups = (0_u32..).zip(&plan.groups).filter(|(_, group)| group.process == one.process.text);
        for (group, _) in groups {
            let mut words = Words::new(&one.node);
            let span = words.span();
            let names = Names { plan, group };
            match sentence(&mut words, &names) {
                Ok(sentence) => properties.push(Property { span, text: words.text(), group, sentence }),
                Err(found) => {
                    diagnostics.push(*found);
                    break;
                }
            }
        }
    }
    properties
}

type Read<T> = Result<T, Box<Diagnostic>>;

/// Makes the diagnostic for a sentence that has none of the forms.
fn unreadable(words: &Words) -> Box<Diagnostic> {
    let message = format!("expected {}, found {}", words.wanted(), words.here());
    let found = Diagnostic::new(Code::E0801, words.place(), message);
    // The expected words are between backquotes, as in "`only after` or `at most`".
    let wanted = words.wanted().split('`').skip(1).step_by(2).flat_map(str::split_whitespace);
    if let Some(near) = words.next_name().and_then(|name| similar::near(name, wanted)) {
        return Box::new(found.rename(words.place(), &near));
    }
    Box::new(found.help(match words.kind() {
        Kind::Sentence => format!("a sentence is one of: {}", FORMS.map(|form| format!("`{form}`")).join("; ")),
        Kind::Formula => formula::FORMS.to_owned(),
    }))
}

/// The first words of sentences that do not begin with the name of a process.
const BEGINNINGS: [&str; 12] = [
    "never",
    "always",
    "after",
    "once",
    "on",
    "eventually",
    "exclusive",
    "assume",
    "holds",
    "can",
    "finishes",
    "stops",
];
/// Sentences that begin with two words: the first word, and the second word in the form for a message.
const PAIRS: [(&str, &str); 3] = [("can", "`finish`"), ("finishes", "`within`"), ("stops", "`within`")];

fn sentence(words: &mut Words, names: &Names<'_>) -> Read<Sentence> {
    // A process may have the name of such a first word: `on only after a.done`.
    let is_about = words.is(1, "only") && words.is(2, "after") || words.is(1, "at") && words.is(2, "most");
    let sentence = if is_about {
        about(words, names)?
    } else if words.at("never") || words.at("always") || words.at("exclusive") {
        invariant(words, names)?
    } else if words.eat("after") {
        let moment = moment(words, names)?;
        words.need(":")?;
        Sentence::After(moment, consequence(words, names)?)
    } else if words.eat("once") {
        once(words, names)?
    } else if words.eat("on") {
        let fault = fault(words, names)?;
        words.need(":")?;
        Sentence::On(fault, consequence(words, names)?)
    } else if words.eat("eventually") {
        Sentence::Eventually(names.occurrence(words, EventKind::Started)?)
    } else if words.at("can") && words.eat_two("can", "finish") {
        Sentence::CanFinish
    } else if words.eat_two("finishes", "within") {
        Sentence::FinishesWithin(words.time()?)
    } else if words.eat_two("stops", "within") {
        Sentence::StopsWithin(words.time()?)
    } else if words.eat("assume") {
        let who = who(words, names)?;
        words.need("takes")?;
        let (least, most) = range(words)?;
        Sentence::Assume(who, least, most)
    } else if words.eat("holds") {
        words.need("ltl")?;
        Sentence::Holds(formula::read(words, names)?)
    } else {
        about(words, names)?
    };
    if words.is_over() { Ok(sentence) } else { Err(unreadable(words.want("`;`"))) }
}

/// Reads a sentence that forbids a state: `never a with b`, `always a implies b` or `exclusive a, b`.
fn invariant(words: &mut Words, names: &Names<'_>) -> Read<Sentence> {
    if words.eat("never") {
        let first = who(words, names)?;
        words.need("with")?;
        return Ok(Sentence::NeverTogether(vec![first, who(words, names)?]));
    }
    if words.eat("always") {
        let first = who(words, names)?;
        words.need("implies")?;
        return Ok(Sentence::Implies(first, who(words, names)?));
    }
    words.eat("exclusive");
    exclusive(words, names)
}

/// Reads `a.done`, or `the 2nd start of a`.
fn moment(words: &mut Words, names: &Names<'_>) -> Read<Moment> {
    let Some(nth) = words.ordinal(NTH_MAX)? else {
        return Ok(Moment { event: names.occurrence(words, EventKind::Ended)?, nth: None });
    };
    let kind = match () {
        () if words.eat_two("start", "of") => EventKind::Started,
        () if words.eat_two("end", "of") => EventKind::Ended,
        () if words.eat_two("abort", "of") => EventKind::Aborted,
        () if words.is(1, "of") => return Err(unreadable(words.want("`start of`, `end of` or `abort of`"))),
        () => return Ok(Moment { event: names.occurrence(words, EventKind::Ended)?, nth: Some(nth) }),
    };
    Ok(Moment { event: Occurrence { who: who(words, names)?, kind }, nth: Some(nth) })
}

/// Reads `a runs: never b with c`. The sentence holds from the first start of `a` on.
fn once(words: &mut Words, names: &Names<'_>) -> Read<Sentence> {
    let first = who(words, names)?;
    words.need("runs")?;
    if !words.eat(",") {
        words.need(":")?;
    }
    let mut ahead = words.peek();
    let is_never = ahead.eat("never") && names.occurrence(&mut ahead, EventKind::Started).is_ok() && !ahead.at("with");
    if !is_never && (words.at("never") || words.at("always") || words.at("exclusive")) {
        return Ok(Sentence::Once(first, Box::new(invariant(words, names)?)));
    }
    let event = Occurrence { who: first, kind: EventKind::Started };
    Ok(Sentence::After(Moment { event, nth: Some(1) }, consequence(words, names)?))
}

/// Reads `1 s .. 15 s`.
fn range(words: &mut Words) -> Read<(Duration, Duration)> {
    let place = words.place();
    let least = words.time()?;
    words.need("..")?;
    let most = words.time()?;
    if least > most {
        let message = "the shortest time comes first: `takes 1 s .. 15 s`";
        return Err(Box::new(Diagnostic::new(Code::E0009, place, message)));
    }
    Ok((least, most))
}

/// Reads `b only after a.done` or `b at most once`.
fn about(words: &mut Words, names: &Names<'_>) -> Read<Sentence> {
    if !words.is_name() {
        return Err(unreadable(words.want("a sentence")));
    }
    let subject = subject(words, names)?;
    if words.eat_two("only", "after") {
        return Ok(Sentence::OnlyAfter(subject, names.occurrence(words, EventKind::Done(None))?));
    }
    if words.eat_two("at", "most") {
        let times = if words.eat("once") { 1 } else { words.count("times")? };
        return Ok(Sentence::AtMost(subject, times));
    }
    Err(unreadable(words.want("`only after` or `at most`")))
}

/// Reads the name of the process with which a sentence begins.
fn subject(words: &mut Words, names: &Names<'_>) -> Read<ProcessRef> {
    let before = words.peek();
    who(words, names).map_err(|unknown| match PAIRS.iter().find(|(word, _)| before.at(word)) {
        Some((word, wanted)) => {
            *words = before;
            words.eat(word);
            unreadable(words.want(wanted))
        }
        None => names::or_word(unknown, &before, &BEGINNINGS),
    })
}

fn who(words: &mut Words, names: &Names<'_>) -> Read<ProcessRef> {
    names.who(words)
}

/// Reads `exclusive a, b, c`, or the device that the processes claim.
fn exclusive(words: &mut Words, names: &Names<'_>) -> Read<Sentence> {
    let mut all = names.who_or_device(words)?;
    while words.eat(",") {
        all.extend(names.who_or_device(words)?);
    }
    all.sort_unstable();
    all.dedup();
    Ok(Sentence::NeverTogether(all))
}

fn fault(words: &mut Words, names: &Names<'_>) -> Read<Fault> {
    let is_crash = words.at("crash");
    if words.eat_two("crash", "of") || words.eat_two("hang", "of") {
        let who = if words.eat("any") { None } else { Some(who(words, names)?) };
        return Ok(if is_crash { Fault::Crash(who) } else { Fault::Hang(who) });
    }
    if words.eat_two("loss", "of") {
        words.need("host")?;
        words.need("(")?;
        let host = names.host(words)?;
        words.need(")")?;
        return Ok(Fault::HostLoss(host));
    }
    Err(unreadable(words.want("`crash of`, `hang of` or `loss of host(...)`")))
}

fn consequence(words: &mut Words, names: &Names<'_>) -> Read<Consequence> {
    if words.eat("never") || words.eat("not") {
        return Ok(Consequence::Never(names.occurrence(words, EventKind::Started)?));
    }
    if words.eat("eventually") {
        return Ok(Consequence::Eventually(names.occurrence(words, EventKind::Started)?));
    }
    let before = words.peek();
    let who = who(words, names).map_err(|unknown| names::or_word(unknown, &before, &["never", "not", "eventually"]))?;
    words.need("stopped")?;
    let limit = if words.eat("within") { Some(words.time()?) } else { None };
    Ok(Consequence::Stopped(who, limit))
}

/// The place of a name.
type Place = (String, Span);
