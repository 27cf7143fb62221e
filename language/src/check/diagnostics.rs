//! The diagnostics of one spec, and the limits on the work for them.

use crate::diagnostic::{Code, Diagnostic, Severity};
use crate::plan::LEAVES_MAX;
use crate::similar::{self, Near};
use crate::source::Span;
use std::collections::BTreeSet;

/// The largest number of pairs of letters that are compared in search of similar names. A suggestion compares one name with all known
/// names. So the work for a spec with only unknown names would grow with the square of its length.
const EFFORT_MAX: usize = 4_000_000;

/// The largest number of instances of arrays and connections of sets that are expanded, because a short text can declare very many of them.
const REPLICATED_MAX: usize = 20 * LEAVES_MAX;

/// The diagnostics of one spec, in the order in which the passes find them.
#[derive(Debug, Default)]
pub(super) struct Diagnostics {
    found: Vec<Diagnostic>,
    /// How many pairs of letters were compared.
    compared: usize,
    /// How many instances and connections have been expanded.
    replicated: usize,
}

/// The diagnostics of a text that is read several times, for example the text of an array. Equal diagnostics are kept once.
#[derive(Debug)]
pub(super) struct Rounds {
    /// How many diagnostics there were when the round began.
    start: usize,
    known: BTreeSet<(Span, Code, String)>,
}

impl Diagnostics {
    pub(super) fn push(&mut self, diagnostic: Diagnostic) {
        self.found.push(diagnostic);
    }

    /// Returns how many diagnostics there are. With this number, a caller can later find out whether more have come.
    pub(super) fn count(&self) -> usize {
        self.found.len()
    }

    /// Returns the first diagnostic after the first `count`.
    pub(super) fn first_since(&mut self, count: usize) -> Option<&mut Diagnostic> {
        self.found.get_mut(count)
    }

    /// Begins the first of several rounds through one text.
    pub(super) fn rounds(&self) -> Rounds {
        Rounds { start: self.found.len(), known: BTreeSet::new() }
    }

    /// Begins a round after other text was read since the previous round.
    pub(super) fn begin_round(&self, rounds: &mut Rounds) {
        rounds.start = self.found.len();
    }

    /// The round ends, and the next one begins. Diagnostics that an earlier round already had are dropped.
    pub(super) fn end_round(&mut self, rounds: &mut Rounds) {
        let new = self.found.split_off(rounds.start);
        self.found.extend(new.into_iter().filter(|found| rounds.known.insert(key(found))));
        rounds.start = self.found.len();
    }

    /// Of the diagnostics after the first `count`, keeps only those that `is_kept` accepts.
    pub(super) fn retain_since(&mut self, count: usize, is_kept: impl FnMut(&Diagnostic) -> bool) {
        let mut new = self.found.split_off(count);
        new.retain(is_kept);
        self.found.append(&mut new);
    }

    /// Counts this many comparisons of names. Returns whether they are still within the limit.
    pub(super) fn may_compare(&mut self, names: usize) -> bool {
        self.compared = self.compared.saturating_add(names);
        self.compared <= EFFORT_MAX
    }

    /// Returns the candidates that look most like a name, unless the limit of comparisons is reached.
    pub(super) fn near<'a>(&mut self, name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<Near<'a>> {
        let compared = &mut self.compared;
        let is_affordable = |candidate: &&str| {
            *compared += similar::effort(name, candidate);
            *compared <= EFFORT_MAX
        };
        similar::near(name, candidates.into_iter().take_while(is_affordable))
    }

    /// Counts this many instances of an array, or connections of a set. Returns whether they may be expanded. Reports the first that exceed
    /// the limit.
    pub(super) fn may_replicate(&mut self, count: usize, span: Span) -> bool {
        let was_within = self.replicated <= REPLICATED_MAX;
        self.replicated = self.replicated.saturating_add(count);
        let is_within = self.replicated <= REPLICATED_MAX;
        if was_within && !is_within {
            let message = format!("arrays and ranges make more than {REPLICATED_MAX} instances and connections");
            self.push(
                Diagnostic::new(Code::E0701, span, message).help("use smaller arrays and ranges, or split the spec"),
            );
        }
        is_within
    }

    /// Turns the diagnostics with denied codes into errors.
    pub(super) fn deny(&mut self, is_denied: fn(Code) -> bool) {
        let denied = self.found.iter_mut().filter(|found| is_denied(found.code));
        denied.for_each(|found| found.severity = Severity::Error);
    }

    pub(super) fn has_errors(&self) -> bool {
        self.found.iter().any(|found| found.severity == Severity::Error)
    }

    pub(super) fn into_vec(self) -> Vec<Diagnostic> {
        self.found
    }
}

/// Returns the key that equal diagnostics share: the primary span, the code and the message.
pub(super) fn key(diagnostic: &Diagnostic) -> (Span, Code, String) {
    (diagnostic.primary.span, diagnostic.code, diagnostic.message.clone())
}

impl Extend<Diagnostic> for Diagnostics {
    fn extend<T: IntoIterator<Item = Diagnostic>>(&mut self, found: T) {
        self.found.extend(found);
    }
}
