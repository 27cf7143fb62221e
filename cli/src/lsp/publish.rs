//! Publishes the diagnostics of each file to the editor at each change.

use super::convert;
use super::position::Lines;
use super::server::{Reply, Server, notify};
use super::workspace::{DOCUMENT_MAX, Document, is_file};
use language::ide::Analysis;
use language::{Code, Diagnostic, Role, Severity, Source, Span};
use lsp_types::{
    DiagnosticRelatedInformation, DiagnosticSeverity, PublishDiagnosticsNotification, PublishDiagnosticsParams, Range,
    Uri,
};
use node::logic::table::counted;
use std::collections::BTreeMap;
use std::rc::Rc;

/// The most diagnostics of one file that are sent to an editor.
const REMARKS_MAX: usize = 500;

/// The diagnostics that were published last.
#[derive(Debug, Default)]
pub(super) struct Published {
    /// Whether something has changed since then.
    pub(super) is_stale: bool,
    /// For each file, the version of the document and its published diagnostics.
    files: BTreeMap<String, Remarks>,
}

/// The diagnostics of a document.
#[derive(Clone, Debug, Default, PartialEq)]
struct Remarks {
    /// The version of the document, if it is open.
    version: Option<i32>,
    diagnostics: Vec<lsp_types::Diagnostic>,
}

impl Server {
    /// Publishes the diagnostics of each open document and of the files that it uses, if they have changed.
    pub(super) fn publish(&mut self, replies: &mut Vec<Reply>) {
        if !std::mem::take(&mut self.published.is_stale) {
            return;
        }
        self.workspace.interfaces.refresh();
        let files = self.remarks();
        let gone: Vec<String> = self.published.files.keys().filter(|uri| !files.contains_key(*uri)).cloned().collect();
        for uri in gone {
            self.published.files.remove(&uri);
            replies.push(told(uri, Remarks::default()));
        }
        for (uri, remarks) in files {
            if self.published.files.get(&uri) != Some(&remarks) {
                replies.push(told(uri.clone(), remarks.clone()));
                self.published.files.insert(uri, remarks);
            }
        }
    }

    /// Returns the present diagnostics, by file.
    fn remarks(&mut self) -> BTreeMap<String, Remarks> {
        let mut files: BTreeMap<String, Remarks> = BTreeMap::new();
        for document in self.workspace.documents() {
            let diagnostics = if document.is_short() { Vec::new() } else { vec![too_long()] };
            files.insert(document.uri.clone(), Remarks { version: Some(document.version), diagnostics });
        }
        let mut closed: BTreeMap<String, Lines> = BTreeMap::new();
        let mut left_out: BTreeMap<String, usize> = BTreeMap::new();
        for analysis in self.roots() {
            for found in analysis.diagnostics().iter().filter(|found| self.is_known(found)) {
                let source = analysis.source(found.primary.span);
                if !is_file(source, &analysis) {
                    continue;
                }
                let open = self.workspace.open_from(&source.name);
                let uri = open.map_or_else(|| super::disk::uri(&source.name), |open| open.uri.clone());
                let remarks = &mut files.entry(uri.clone()).or_default().diagnostics;
                if remarks.len() >= REMARKS_MAX {
                    *left_out.entry(uri).or_default() += 1;
                    continue;
                }
                let lines = match open {
                    Some(Document { lines, .. }) => lines,
                    None => &*closed.entry(source.name.clone()).or_insert_with(|| Lines::new(&source.text)),
                };
                let remark = self.remark(found, source, lines, &analysis);
                if !remarks.contains(&remark) {
                    remarks.push(remark);
                }
            }
        }
        for (uri, count) in left_out {
            files.entry(uri).or_default().diagnostics.push(more(count));
        }
        files
    }

    /// Returns the documents that are checked on their own. A file that another one uses is checked as a part of it,
    /// unless the file can run alone.
    fn roots(&mut self) -> Vec<Rc<Analysis>> {
        let open: Vec<String> = self.workspace.documents().map(|document| document.uri.clone()).collect();
        let all: Vec<Rc<Analysis>> = open.iter().filter_map(|uri| self.workspace.analysis(uri)).collect();
        let uses = |user: &Analysis, used: &str| {
            user.others().iter().any(|other| other.name == used && other.role == Role::Part)
        };
        let is_part = |one: &Rc<Analysis>| {
            let name = &one.spec().name;
            all.iter().any(|other| uses(other, name) && !uses(one, &other.spec().name))
        };
        let has_root =
            |one: &Rc<Analysis>| !one.diagnostics().iter().any(|it| [Code::E0101, Code::W0101].contains(&it.code));
        all.iter().filter(|one| has_root(one) || !is_part(one)).cloned().collect()
    }

    /// Returns whether a diagnostic is certain. While a program has not answered yet, a warning may only be due to its missing interface.
    fn is_known(&self, found: &Diagnostic) -> bool {
        found.severity == Severity::Error || !self.workspace.interfaces.is_waiting()
    }

    fn remark(&self, found: &Diagnostic, source: &Source, lines: &Lines, analysis: &Analysis) -> lsp_types::Diagnostic {
        let reasons = match self.editor.related {
            true => found.secondary.iter().filter_map(|label| self.reason(label.span, &label.text, analysis)).collect(),
            false => Vec::new(),
        };
        convert::diagnostic(found, source, lines, reasons, &self.editor)
    }

    fn reason(&self, span: Span, text: &str, analysis: &Analysis) -> Option<DiagnosticRelatedInformation> {
        let source = analysis.source(span);
        let is_shown = !text.is_empty() && is_file(source, analysis);
        let location = is_shown.then(|| convert::location(&self.workspace, source, span, self.editor.encoding))?;
        Some(DiagnosticRelatedInformation { location, message: text.to_owned() })
    }
}

fn told(uri: String, remarks: Remarks) -> Reply {
    let Remarks { version, diagnostics } = remarks;
    notify::<PublishDiagnosticsNotification>(PublishDiagnosticsParams { uri: Uri(uri), version, diagnostics })
}

/// Returns a diagnostic that says that the document is too long to be checked.
fn too_long() -> lsp_types::Diagnostic {
    let limit = DOCUMENT_MAX >> 20;
    about_all(format!("the editor does not check a text of more than {limit} MiB; run `dca check`"))
}

/// Returns a diagnostic that says how many diagnostics were left out.
fn more(count: usize) -> lsp_types::Diagnostic {
    let told = counted(count, "more remark");
    about_all(format!("{told} on this file not shown here, after the first {REMARKS_MAX}; `dca check` prints all"))
}

/// Returns a diagnostic about a whole file.
fn about_all(message: String) -> lsp_types::Diagnostic {
    lsp_types::Diagnostic {
        range: Range::default(),
        severity: Some(DiagnosticSeverity::Warning),
        source: Some("dca".to_owned()),
        message: message.into(),
        ..lsp_types::Diagnostic::default()
    }
}
