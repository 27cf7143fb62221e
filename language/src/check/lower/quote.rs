//! Quotes the text of a spec for people who watch its run.

use crate::plan::DEADLINE;
use crate::source::{Origin, Source, Span};

/// The longest quotation, in characters.
const QUOTE_MAX: usize = 60;

/// The texts of a spec, with the ends of their lines.
pub(crate) struct Quotes<'a> {
    spec: (&'a Source, Vec<usize>),
    others: Vec<(&'a Source, Vec<usize>)>,
}

impl<'a> Quotes<'a> {
    /// Takes the texts that spans point into.
    pub(crate) fn new(spec: &'a Source, others: &'a [Source]) -> Self {
        let lines = |source: &'a Source| (source, source.text.match_indices('\n').map(|(at, _)| at).collect());
        Self { spec: lines(spec), others: others.iter().map(lines).collect() }
    }

    /// Returns the reason for the failure of an expression by its deadline. It quotes the text, and names the line, and
    /// the file if it is not the spec.
    pub(super) fn deadline(&self, span: Span) -> String {
        let (source, lines) = match span.origin {
            Origin::Spec => &self.spec,
            Origin::Interface(index) => self.others.get(index as usize).unwrap_or(&self.spec),
        };
        let line = lines.partition_point(|end| *end < span.start as usize) + 1;
        let text = source.text.get(span.start as usize..span.end as usize).unwrap_or_default();
        let file = if span.origin == Origin::Spec { String::new() } else { format!(" of `{}`", source.name) };
        format!("{DEADLINE}{}` in line {line}{file} has passed", clipped(text))
    }
}

/// Returns a text on one line. A long text loses its middle, because its end has the deadline.
fn clipped(text: &str) -> String {
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let length = text.chars().count();
    if length <= QUOTE_MAX {
        return text;
    }
    let (head, tail) = (QUOTE_MAX / 2 - 1, QUOTE_MAX / 2 - 1);
    let begin: String = text.chars().take(head).collect();
    let end: String = text.chars().skip(length - tail).collect();
    format!("{} \u{2026} {}", begin.trim_end(), end.trim_start())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deadline_is_named_by_its_text_its_line_and_its_file() {
        let spec = Source::new("spec.dca", "one\na\n  within   5 s ; b");
        let parts = [Source::new("part.dca", "\n\na within 3 s")];
        let quotes = Quotes::new(&spec, &parts);
        let span = |origin, start, end| Span { origin, start, end };
        let check = |span, expected: &str| assert_eq!(quotes.deadline(span), expected);
        check(span(Origin::Spec, 4, 20), "the deadline `a within 5 s` in line 2 has passed");
        let part = span(Origin::Interface(0), 2, 14);
        check(part, "the deadline `a within 3 s` in line 3 of `part.dca` has passed");
        check(span(Origin::Spec, 90, 95), "the deadline `` in line 3 has passed");
    }

    #[test]
    fn of_a_long_text_both_ends_stay() {
        let text = format!("({}) within 1 min", ["a"; 17].join(" ; "));
        assert_eq!(clipped(&text), "(a ; a ; a ; a ; a ; a ; a ; \u{2026} ; a ; a ; a ; a) within 1 min");
        assert_eq!(clipped(&"\u{e9}".repeat(61)).chars().count(), 61);
        assert_eq!(clipped(&"\u{e9}".repeat(60)), "\u{e9}".repeat(60));
    }
}
