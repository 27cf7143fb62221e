//! Diagnostics for programs: one JSON document.
//!
//! ```json
//! {"version": 1, "spec": "door.dca", "accepted": true, "diagnostics": [{"code": "W0201", "severity": "warning",
//!   "message": "...", "place": {...}, "label": "...", "reasons": [{"place": {...}, "text": "..."}], "help": ["..."],
//!   "fix": {"title": "...", "edits": [{"place": {...}, "text": "..."}]}}]}
//! ```
//!
//! A place is `{"file", "start", "end"}` with lines and columns from 1 and byte offsets from 0. `version` changes when a
//! field changes its meaning; fields are added without notice.

use super::Checked;
use language::{Diagnostic, Fix, Label, Severity, Source, Span};
use serde_json::{Value, json};

/// Returns the document.
pub(super) fn json(checked: &Checked) -> String {
    let diagnostics: Vec<Value> = checked.diagnostics.iter().map(|found| diagnostic(found, checked)).collect();
    let document = json!({
        "version": 1,
        "spec": checked.spec.name,
        "accepted": checked.plan.is_some(),
        "diagnostics": diagnostics,
    });
    format!("{document:#}")
}

fn diagnostic(found: &Diagnostic, checked: &Checked) -> Value {
    let reason = |label: &Label| json!({"place": place(label.span, checked), "text": label.text});
    json!({
        "code": found.code.as_str(),
        "severity": match found.severity { Severity::Error => "error", Severity::Warning => "warning" },
        "message": found.message,
        "place": place(found.primary.span, checked),
        "label": found.primary.text,
        "reasons": found.secondary.iter().map(reason).collect::<Vec<_>>(),
        "help": found.help,
        "fix": found.fix.as_ref().map(|fix| self::fix(fix, checked)),
    })
}

fn fix(fix: &Fix, checked: &Checked) -> Value {
    let edits = fix.edits.iter().map(|edit| json!({"place": place(edit.span, checked), "text": edit.text}));
    json!({"title": fix.title, "edits": edits.collect::<Vec<_>>()})
}

fn place(span: Span, checked: &Checked) -> Value {
    let source = checked.source(span);
    json!({
        "file": source.name,
        "start": position(source, span.start),
        "end": position(source, span.end),
    })
}

fn position(source: &Source, offset: u32) -> Value {
    let position = source.position(offset);
    json!({"line": position.line, "column": position.column, "offset": offset})
}
