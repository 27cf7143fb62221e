//! Diagnostics for programs: one JSON document.
//!
//! ```json
//! {"version": 1, "spec": "door.dca", "accepted": true, "diagnostics": [{"code": "W0201", "severity": "warning",
//!   "message": "...", "place": {...}, "label": "...", "reasons": [{"place": {...}, "text": "..."}], "help": ["..."],
//!   "fix": {"title": "...", "edits": [{"place": {...}, "text": "..."}]}, "choices": []}], "omitted": 0}
//! ```
//!
//! A `fix` leaves no other reading. Of `choices`, a person has to choose one. If there are more than 10,000
//! diagnostics, `omitted` is the number of those left out; warnings are left out first.
//!
//! A place is `{"file", "start", "end"}` with lines and columns from 1 and byte offsets from 0. `version` changes when a
//! field changes its meaning; fields are added without notice.

use super::Checked;
use language::{Diagnostic, Fix, Label, Lines, Severity, Span, Texts};
use serde_json::{Value, json};

/// Returns the document.
pub(super) fn json(checked: &Checked) -> Value {
    let texts = checked.texts();
    let diagnostics: Vec<Value> = checked.diagnostics.iter().map(|found| diagnostic(found, &texts)).collect();
    json!({
        "version": 1,
        "spec": checked.spec.name,
        "accepted": checked.plan.is_some(),
        "diagnostics": diagnostics,
        "omitted": checked.omitted,
    })
}

/// One diagnostic as an object.
pub(crate) fn diagnostic(found: &Diagnostic, texts: &Texts<'_>) -> Value {
    let reason = |label: &Label| json!({"place": place(label.span, texts), "text": label.text});
    json!({
        "code": found.code.as_str(),
        "severity": match found.severity { Severity::Error => "error", Severity::Warning => "warning" },
        "message": found.message,
        "place": place(found.primary.span, texts),
        "label": found.primary.text,
        "reasons": found.secondary.iter().map(reason).collect::<Vec<_>>(),
        "help": found.help,
        "fix": found.fix.as_ref().map(|fix| self::fix(fix, texts)),
        "choices": found.choices.iter().map(|fix| self::fix(fix, texts)).collect::<Vec<_>>(),
    })
}

fn fix(fix: &Fix, texts: &Texts<'_>) -> Value {
    let edits = fix.edits.iter().map(|edit| json!({"place": place(edit.span, texts), "text": edit.text}));
    json!({"title": fix.title, "edits": edits.collect::<Vec<_>>()})
}

fn place(span: Span, texts: &Texts<'_>) -> Value {
    let lines = texts.of(span);
    json!({
        "file": lines.source().name,
        "start": position(lines, span.start),
        "end": position(lines, span.end),
    })
}

fn position(lines: &Lines<'_>, offset: u32) -> Value {
    let position = lines.position(offset);
    json!({"line": position.line, "column": position.column, "offset": offset})
}
