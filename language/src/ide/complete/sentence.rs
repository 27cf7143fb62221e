//! Completes the sentences of `verify` blocks, and the formulas in them.

use super::place::Cursor;
use super::{Completion, CompletionKind, MARK, keyword, keywords};
use crate::check::spec::{Process, Target};
use crate::check::{EVENTS, STATES, Word, words_of};
use crate::ide::Analysis;
use crate::ide::words::{self, Place};
use crate::syntax::SyntaxKind;

impl Analysis {
    /// Returns the possible words at the cursor in a sentence.
    pub(super) fn sentence(&self, at: &Cursor) -> Vec<Completion> {
        let (Some(node), Some(process)) = (at.inside(SyntaxKind::Sentence), self.process_proved_at(at)) else {
            return Vec::new();
        };
        let before: Vec<Word> = words_of(node).into_iter().take_while(|word| !word.text.contains(MARK)).collect();
        if before.last().is_some_and(|last| last.text == ".") {
            return self.behind_dot(process, &before);
        }
        let is_formula = words_of(node).iter().any(|word| word.is_formula && word.text.contains(MARK));
        match is_formula {
            true => self.in_formula(process, before.last().filter(|word| word.is_formula)),
            false => self.in_sentence(process, &before),
        }
    }

    /// Returns the process that the `verify` block around the cursor is about.
    fn process_proved_at(&self, at: &Cursor) -> Option<&Process> {
        let title = at.inside(SyntaxKind::Process).or_else(|| at.inside(SyntaxKind::Verify))?.title()?;
        self.model.processes.iter().find(|process| process.name.text == title.text)
    }

    fn in_sentence(&self, process: &Process, before: &[Word]) -> Vec<Completion> {
        let text = |word: Option<&Word>| word.map_or("", |word| word.text.as_str()).to_owned();
        let (first, last) = (text(before.first()), text(before.last()));
        let has = |wanted: &str| before.iter().any(|word| word.text == wanted);
        let is_number = |word: &Word| word.text.starts_with(|first: char| first.is_ascii_digit());
        let next: &[&str] = match last.as_str() {
            "" => return [keywords(Place::Sentence), self.members_of(process)].concat(),
            "after" if before.len() == 1 => return [self.members_of(process), inside(&["the"])].concat(),
            "never" | "always" | "after" | "eventually" | "exclusive" | "assume" | "with" | "implies" | "not" => {
                return self.members_of(process);
            }
            "once" if before.len() == 1 => return self.members_of(process),
            "," if !has("runs") || has("exclusive") => return self.members_of(process),
            ":" | "," if has("runs") => {
                let words = inside(&["never", "always", "exclusive", "not", "eventually"]);
                return [self.members_of(process), words].concat();
            }
            "st" | "nd" | "rd" | "th" if before.iter().rev().nth(1).is_some_and(is_number) => {
                return [self.members_of(process), inside(&["start of", "end of", "abort of"])].concat();
            }
            "start" | "end" | "abort" if has("the") && !has("of") && !has(":") => &["of"],
            "of" if has("the") => return self.members_of(process),
            ":" => return [self.members_of(process), inside(&["never", "not", "eventually"])].concat(),
            "on" => &["crash of", "hang of", "loss of host"],
            "crash" | "hang" | "loss" => &["of"],
            "of" if has("loss") => &["host"],
            "of" => return [inside(&["any"]), self.members_of(process)].concat(),
            "(" => {
                let hosts = self.hosts();
                return hosts.into_iter().map(|host| Completion::new(CompletionKind::Host, host)).collect();
            }
            "can" => &["finish"],
            "finishes" | "stops" | "stopped" => &["within"],
            "holds" => &["ltl"],
            "only" => &["after"],
            "at" => &["most"],
            "most" => &["once"],
            _ if before.last().is_some_and(|word| !word.is_name) => &[],
            "any" | "once" | "finish" | "ltl" => &[],
            _ if has("with") => &[],
            _ if has("implies") => &[],
            _ if has(":") && has("always") => &["implies"],
            _ if has(":") && has("runs") && has("never") => &["with"],
            _ if has(":") => &["stopped"],
            _ if first == "once" && before.len() > 1 => &["runs"],
            _ => match first.as_str() {
                "never" => &["with"],
                "always" => &["implies"],
                "assume" => &["takes"],
                "after" | "on" | "eventually" | "exclusive" => &[],
                _ => &["only after", "at most"],
            },
        };
        inside(next)
    }

    fn in_formula(&self, process: &Process, before: Option<&Word>) -> Vec<Completion> {
        let operators = |names: &[&str]| {
            names.iter().filter_map(|name| words::find(name, &[Place::Formula])).map(keyword).collect()
        };
        let is_operand = before.is_some_and(|word| match word.text.as_str() {
            "G" | "F" | "U" | "W" | "R" => false,
            text => word.is_name || [")", "]"].contains(&text),
        });
        match is_operand {
            true => operators(&["U", "W", "R"]),
            false => [self.members_of(process), operators(&["G", "F"])].concat(),
        }
    }

    /// Returns the completions after a dot: the members of a group, the events of a process, or the outcomes of its
    /// normal end.
    fn behind_dot(&self, process: &Process, before: &[Word]) -> Vec<Completion> {
        let mut target = None;
        let mut inside = Some(process);
        for name in path(before) {
            let instance = inside.and_then(|process| {
                process
                    .instances
                    .iter()
                    .find(|instance| instance.name.text == name || self.text(instance.name.span) == name)
            });
            match instance {
                Some(instance) => target = Some(instance.target),
                None if name == "done" => return self.outcomes_of(target),
                None => {}
            }
            inside = match target {
                Some(Target::Process(process)) => Some(&self.model.processes[process]),
                Some(Target::Module(_) | Target::Unknown) => None,
                None => inside,
            };
        }
        let mut found = inside.map(|process| self.members_of(process)).unwrap_or_default();
        let is_formula = before.last().is_some_and(|word| word.is_formula);
        let states = if is_formula { &STATES[..] } else { &[] };
        let words = EVENTS.iter().chain(states).filter_map(|event| words::find(event, &[Place::Event]));
        found.extend(words.map(keyword));
        found
    }

    fn outcomes_of(&self, target: Option<Target>) -> Vec<Completion> {
        let outcomes = target.map(|target| self.model.outcomes_of(target)).unwrap_or_default();
        outcomes.iter().map(|outcome| Completion::new(CompletionKind::Outcome, &outcome.name.text)).collect()
    }
}

fn inside(texts: &[&str]) -> Vec<Completion> {
    texts.iter().filter_map(|text| words::find(text, &[Place::InSentence])).map(keyword).collect()
}

/// Returns the names before a dot at the end, the outermost first: `hit` and `force` for `hit.force.`.
fn path(words: &[Word]) -> Vec<&str> {
    let (mut names, mut rest) = (Vec::new(), words);
    while let [before @ .., dot] = rest
        && dot.text == "."
    {
        rest = before;
        if rest.last().is_some_and(|word| word.text == "]") {
            rest = &rest[..rest.iter().rposition(|word| word.text == "[").unwrap_or(0)];
        }
        let Some((name, before)) = rest.split_last() else { break };
        names.push(name.text.as_str());
        rest = before;
    }
    names.reverse();
    names
}
