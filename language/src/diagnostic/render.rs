//! Writes diagnostics as text with carets.
//!
//! The printer gets only the lines that a label touches, and of a very long line only the part near the label. So the cost of a diagnostic
//! does not depend on the length of its text.

use super::{Diagnostic, Label, Severity};
use crate::source::{Lines, Origin, Source, Span, Texts};
use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use std::ops::Range;

/// The largest number of diagnostics that a person sees.
const SHOWN_MAX: usize = 100;
/// The largest number of bytes in one excerpt, which is the lines that one or several labels touch.
const WINDOW_MAX: usize = 16 * 1024;
/// The longest line that goes to the printer as a whole, in bytes. The printer may trim it.
const LINE_MAX: usize = 400;
/// How many bytes before and after a label are shown of a longer line.
const CLIPPED: usize = 60;

/// The style of the text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Without colours.
    Plain,
    /// With colours for a terminal.
    Colour,
}

/// Returns the diagnostics for a person: message, source lines with carets, help. If there are more than 100, errors are shown rather than
/// warnings, and the number of hidden diagnostics is at the end.
pub fn render(diagnostics: &[Diagnostic], spec: &Source, interfaces: &[Source], style: Style) -> String {
    let renderer = match style {
        Style::Plain => Renderer::plain(),
        Style::Colour => Renderer::styled(),
    };
    if diagnostics.is_empty() {
        return String::new();
    }
    let texts = Texts::new(spec, interfaces);
    let mut text = String::new();
    for diagnostic in shown(diagnostics) {
        text.push_str(&renderer.render(&[report(diagnostic, &texts)]));
        text.push_str("\n\n");
    }
    if let Some(more) = diagnostics.len().checked_sub(SHOWN_MAX).filter(|more| *more > 0) {
        text.push_str(&format!("and {more} more\n\n"));
    }
    text
}

/// Returns the diagnostics to show, in the order of the text. If there are more than a person reads, errors are shown rather than warnings.
fn shown(diagnostics: &[Diagnostic]) -> Vec<&Diagnostic> {
    let errors = diagnostics.iter().filter(|found| found.severity == Severity::Error).count().min(SHOWN_MAX);
    let mut room = [errors, SHOWN_MAX - errors];
    let has_room = |found: &&Diagnostic| {
        let room = &mut room[usize::from(found.severity == Severity::Warning)];
        let is_shown = *room > 0;
        *room -= usize::from(is_shown);
        is_shown
    };
    diagnostics.iter().filter(has_room).collect()
}

fn report<'a>(diagnostic: &'a Diagnostic, texts: &Texts<'a>) -> Group<'a> {
    let level = match diagnostic.severity {
        Severity::Error => Level::ERROR,
        Severity::Warning => Level::WARNING,
    };
    let title = level.primary_title(diagnostic.message.as_str()).id(diagnostic.code.as_str());
    let mut group = Group::with_title(title);
    for origin in origins(diagnostic) {
        let Some(lines) = texts.get(origin) else { continue };
        for view in views(diagnostic, origin, lines) {
            group = view.add_to(group, lines);
        }
    }
    for help in &diagnostic.help {
        group = group.element(Level::HELP.message(help.as_str()));
    }
    if let Some(fix) = &diagnostic.fix {
        group = group.element(Level::HELP.with_name("fix").message(fix.title.as_str()));
    }
    for choice in &diagnostic.choices {
        group = group.element(Level::HELP.with_name("perhaps").message(choice.title.as_str()));
    }
    group
}

/// Returns the texts that a diagnostic points into. The text of the primary span comes first.
fn origins(diagnostic: &Diagnostic) -> Vec<Origin> {
    let mut origins = vec![diagnostic.primary.span.origin];
    for label in &diagnostic.secondary {
        if !origins.contains(&label.span.origin) {
            origins.push(label.span.origin);
        }
    }
    origins
}

/// An excerpt of a text with the labels in it.
struct View<'a> {
    window: Range<usize>,
    marks: Vec<Mark<'a>>,
}

#[derive(Clone)]
struct Mark<'a> {
    kind: AnnotationKind,
    range: Range<usize>,
    text: &'a str,
}

/// Returns the excerpts of one text: one excerpt with all labels if they are near each other, otherwise one for each label.
fn views<'a>(diagnostic: &'a Diagnostic, origin: Origin, lines: &Lines<'a>) -> Vec<View<'a>> {
    let mark = |kind, label: &'a Label| Mark { kind, range: range(label.span, lines), text: label.text.as_str() };
    let primary = [&diagnostic.primary].into_iter().map(|label| (AnnotationKind::Primary, label));
    let others = diagnostic.secondary.iter().map(|label| (AnnotationKind::Context, label));
    let here = primary.chain(others).filter(|(_, label)| label.span.origin == origin);
    let marks: Vec<Mark<'a>> = here.map(|(kind, label)| mark(kind, label)).collect();
    let ends = marks.iter().map(|mark| mark.range.start).min().zip(marks.iter().map(|mark| mark.range.end).max());
    let window = ends.map_or(0..0, |(start, end)| lines.around(&(start..end)));
    if window.len() <= WINDOW_MAX && !marks.iter().any(|mark| is_long(mark, lines)) {
        return vec![View { window, marks }];
    }
    marks.into_iter().map(|mark| clipped(mark, lines)).collect()
}

/// Returns whether a label begins or ends in a long line.
fn is_long(mark: &Mark<'_>, lines: &Lines<'_>) -> bool {
    [mark.range.start, mark.range.end].iter().any(|&end| lines.around(&(end..end)).len() > LINE_MAX)
}

/// Returns an excerpt with one label: its lines, or the text around the label if the lines are long.
fn clipped<'a>(mut mark: Mark<'a>, lines: &Lines<'a>) -> View<'a> {
    let mut window = lines.around(&mark.range);
    if window.len() > WINDOW_MAX || is_long(&mark, lines) {
        mark.range.end = mark.range.end.min(lines.boundary(mark.range.start + CLIPPED));
        let line = lines.around(&(mark.range.start..mark.range.start));
        mark.range.end = mark.range.end.min(line.end.max(mark.range.start));
        let start = lines.boundary(mark.range.start.saturating_sub(CLIPPED)).max(line.start);
        window = start..lines.boundary(mark.range.end + CLIPPED).min(line.end).max(mark.range.end);
    }
    View { window, marks: vec![mark] }
}

impl<'a> View<'a> {
    fn add_to(self, group: Group<'a>, lines: &Lines<'a>) -> Group<'a> {
        let source = lines.source();
        let offset = |at: usize| u32::try_from(at).unwrap_or(u32::MAX);
        let begins = lines.position(offset(self.window.start));
        let snippet = Snippet::source(&source.text[self.window.clone()]).line_start(begins.line);
        let snippet = self.marks.iter().fold(snippet, |snippet, mark| {
            let range = mark.range.start - self.window.start..mark.range.end - self.window.start;
            snippet.annotation(mark.kind.span(range).label(mark.text))
        });
        if begins.column == 1 {
            return group.element(snippet.path(source.name.as_str()));
        }
        // Without this, the printer would count columns from the place where the line was cut.
        let at = self.marks.first().map_or(begins, |mark| lines.position(offset(mark.range.start)));
        let place = annotate_snippets::Origin::path(source.name.as_str()).line(at.line).char_column(at.column);
        group.element(place).element(snippet)
    }
}

/// Returns the bytes of a span. They are limited to the length of the text, because a caller may
/// pass another text than the checked text.
fn range(span: Span, lines: &Lines<'_>) -> Range<usize> {
    let text = &lines.source().text;
    let mut start = lines.boundary(span.start as usize);
    if start == text.len() && text.ends_with('\n') {
        // The end of the text is shown at the end of its last line, not below it.
        start -= 1;
        return start..start;
    }
    start..lines.boundary(span.end as usize).max(start)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::Code;
    use expect_test::{Expect, expect};

    fn found(start: usize, length: usize) -> Diagnostic {
        let offset = |at| u32::try_from(at).unwrap();
        let span = Span { origin: Origin::Spec, start: offset(start), end: offset(start + length) };
        Diagnostic::new(Code::E0001, span, "no").label("here")
    }

    fn check(text: &str, found: &Diagnostic, expect: &Expect) {
        expect.assert_eq(&render(std::slice::from_ref(found), &Source::new("a.dca", text), &[], Style::Plain));
    }

    #[test]
    fn of_a_long_line_what_is_near_is_shown() {
        let text = format!("first\n{}\nlast", "0123456789ö".repeat(10_000));
        check(
            &text,
            &found(6 + 60_000, 5),
            &expect![[r#"
            error[E0001]: no
             --> a.dca:2:55001
              |
             ::: 
            2 | 0123456789ö0123456789ö0123456789ö0123456789ö0123456789ö0123456789ö0123456789ö0123456789ö0123456789ö0123456789ö01234
              |                                                        ^^^^^ here

        "#]],
        );
        check(
            &text,
            &found(6, 1),
            &expect![[r#"
            error[E0001]: no
             --> a.dca:2:1
              |
            2 | 0123456789ö0123456789ö0123456789ö0123456789ö0123456789ö0
              | ^ here

        "#]],
        );
        check(
            &text,
            &found(0, 100_000),
            &expect![[r#"
            error[E0001]: no
             --> a.dca:1:1
              |
            1 | first
              | ^^^^^ here

        "#]],
        );
        check(
            &text,
            &found(text.len(), 0),
            &expect![[r#"
            error[E0001]: no
             --> a.dca:3:5
              |
            3 | last
              |     ^ here

        "#]],
        );
    }

    #[test]
    fn labels_far_apart_are_shown_each_for_itself() {
        let text = format!("one\n{}two", "between\n".repeat(10_000));
        let both = found(0, 3).reason(found(text.len() - 3, 3).primary.span, "and here");
        check(
            &text,
            &both,
            &expect![[r#"
            error[E0001]: no
                 --> a.dca:1:1
                  |
                1 | one
                  | ^^^ here
                  |
                 ::: a.dca:10002:1
                  |
            10002 | two
                  | --- and here

        "#]],
        );
    }

    #[test]
    fn a_person_is_shown_a_hundred() {
        let mut many = vec![Diagnostic { severity: Severity::Warning, ..found(0, 1) }; 150];
        many.extend(vec![found(2, 1); 70]);
        let text = render(&many, &Source::new("a.dca", "a b"), &[], Style::Plain);
        assert_eq!((text.matches("error[").count(), text.matches("warning[").count()), (70, 30));
        assert!(text.ends_with("\n\nand 120 more\n\n"), "{text}");
    }
}
