//! Diagnostics for code hosts and editors: SARIF 2.1.0 (OASIS Standard, "Static Analysis Results Interchange Format").

use super::Checked;
use language::{Code, Diagnostic, Edit, Fix, Severity, Span, Texts};
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// The address of the format's schema.
const SCHEMA: &str = "https://json.schemastore.org/sarif-2.1.0.json";

/// Returns the log of one run; the rules are the codes that occur in it.
pub(super) fn sarif(checked: &Checked) -> Value {
    let codes: BTreeSet<Code> = checked.diagnostics.iter().map(|found| found.code).collect();
    let texts = checked.texts();
    let results: Vec<Value> = checked.diagnostics.iter().map(|found| result(found, &texts)).collect();
    let driver = json!({
        "name": "dca",
        "version": env!("CARGO_PKG_VERSION"),
        "rules": codes.into_iter().map(rule).collect::<Vec<_>>(),
    });
    let run = json!({"tool": {"driver": driver}, "columnKind": "unicodeCodePoints", "results": results});
    json!({"$schema": SCHEMA, "version": "2.1.0", "runs": [run]})
}

fn rule(code: Code) -> Value {
    json!({
        "id": code.as_str(),
        "shortDescription": {"text": code.title()},
        "fullDescription": {"text": code.explanation()},
        "defaultConfiguration": {"level": level(code.severity())},
    })
}

fn level(severity: Severity) -> &'static str {
    match severity {
        Severity::Error => "error",
        Severity::Warning => "warning",
    }
}

fn result(found: &Diagnostic, texts: &Texts<'_>) -> Value {
    let related = found.secondary.iter().map(|label| {
        let mut location = location(label.span, texts);
        location["message"] = json!({"text": label.text});
        location
    });
    let mut result = json!({
        "ruleId": found.code.as_str(),
        "level": level(found.severity),
        "message": {"text": message(found)},
        "locations": [location(found.primary.span, texts)],
        "relatedLocations": related.collect::<Vec<_>>(),
    });
    // The tool that reads the log asks a person before it applies a fix. So `choices` can be among the fixes.
    let fixes: Vec<Value> = found.fix.iter().chain(&found.choices).map(|fix| self::fix(fix, texts)).collect();
    if !fixes.is_empty() {
        result["fixes"] = json!(fixes);
    }
    result
}

fn fix(fix: &Fix, texts: &Texts<'_>) -> Value {
    let replacements: Vec<Value> = fix.edits.iter().map(|edit| replacement(edit, texts)).collect();
    let change = json!({"artifactLocation": {"uri": texts.spec().name}, "replacements": replacements});
    json!({"description": {"text": fix.title}, "artifactChanges": [change]})
}

/// Returns the sentence of a diagnostic with its label and help: a tool that reads the log shows no carets.
fn message(found: &Diagnostic) -> String {
    let label = Some(&found.primary.text).filter(|text| !text.is_empty());
    let parts: Vec<&str> =
        std::iter::once(&found.message).chain(label).chain(&found.help).map(String::as_str).collect();
    parts.join("; ")
}

fn location(span: Span, texts: &Texts<'_>) -> Value {
    let uri = &texts.of(span).source().name;
    json!({"physicalLocation": {"artifactLocation": {"uri": uri}, "region": region(span, texts)}})
}

fn region(span: Span, texts: &Texts<'_>) -> Value {
    let lines = texts.of(span);
    let (start, end) = (lines.position(span.start), lines.position(span.end));
    json!({"startLine": start.line, "startColumn": start.column, "endLine": end.line, "endColumn": end.column})
}

fn replacement(edit: &Edit, texts: &Texts<'_>) -> Value {
    json!({"deletedRegion": region(edit.span, texts), "insertedContent": {"text": edit.text}})
}
