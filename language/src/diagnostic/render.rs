//! Diagnostics as text with carets.

use super::{Diagnostic, Severity};
use crate::source::{Origin, Source, Span};
use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use std::ops::Range;

/// How the text is dressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Letters only.
    Plain,
    /// With colours for a terminal.
    Colour,
}

/// Returns the diagnostics as a person reads them: message, source lines with carets, help.
pub fn render(diagnostics: &[Diagnostic], spec: &Source, interfaces: &[Source], style: Style) -> String {
    let renderer = match style {
        Style::Plain => Renderer::plain(),
        Style::Colour => Renderer::styled(),
    };
    let mut text = String::new();
    for diagnostic in diagnostics {
        text.push_str(&renderer.render(&[report(diagnostic, spec, interfaces)]));
        text.push_str("\n\n");
    }
    text
}

fn report<'a>(diagnostic: &'a Diagnostic, spec: &'a Source, interfaces: &'a [Source]) -> Group<'a> {
    let level = match diagnostic.severity {
        Severity::Error => Level::ERROR,
        Severity::Warning => Level::WARNING,
    };
    let mut group = level.primary_title(diagnostic.message.as_str()).id(diagnostic.code.as_str()).elements(
        origins(diagnostic)
            .into_iter()
            .filter_map(|origin| Some(snippet(diagnostic, origin, source(origin, spec, interfaces)?))),
    );
    for help in &diagnostic.help {
        group = group.element(Level::HELP.message(help.as_str()));
    }
    if let Some(fix) = &diagnostic.fix {
        group = group.element(Level::HELP.with_name("fix").message(fix.title.as_str()));
    }
    group
}

/// The texts that a diagnostic points into, that of its primary span first.
fn origins(diagnostic: &Diagnostic) -> Vec<Origin> {
    let mut origins = vec![diagnostic.primary.span.origin];
    for label in &diagnostic.secondary {
        if !origins.contains(&label.span.origin) {
            origins.push(label.span.origin);
        }
    }
    origins
}

fn source<'a>(origin: Origin, spec: &'a Source, interfaces: &'a [Source]) -> Option<&'a Source> {
    match origin {
        Origin::Spec => Some(spec),
        Origin::Interface(index) => interfaces.get(index as usize),
    }
}

fn snippet<'a>(
    diagnostic: &'a Diagnostic,
    origin: Origin,
    source: &'a Source,
) -> Snippet<'a, annotate_snippets::Annotation<'a>> {
    let mut snippet = Snippet::source(source.text.as_str()).path(source.name.as_str());
    if diagnostic.primary.span.origin == origin {
        let annotation = AnnotationKind::Primary.span(range(diagnostic.primary.span, source));
        snippet = snippet.annotation(annotation.label(diagnostic.primary.text.as_str()));
    }
    for label in diagnostic.secondary.iter().filter(|label| label.span.origin == origin) {
        let annotation = AnnotationKind::Context.span(range(label.span, source));
        snippet = snippet.annotation(annotation.label(label.text.as_str()));
    }
    snippet
}

/// The bytes of a span, cut to what the text has: a caller may hand in another text than the one that was checked.
fn range(span: Span, source: &Source) -> Range<usize> {
    let boundary = |offset: u32| {
        let offset = (offset as usize).min(source.text.len());
        (0..=offset).rev().find(|&offset| source.text.is_char_boundary(offset)).unwrap_or(0)
    };
    boundary(span.start)..boundary(span.end).max(boundary(span.start))
}
