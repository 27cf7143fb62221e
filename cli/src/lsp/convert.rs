//! Converts results of the language to types of the protocol.

use super::disk;
use super::editor::Editor;
use super::position::{Encoding, Lines, number};
use super::workspace::Workspace;
use language::ide::{Analysis, Class, Completion, CompletionKind, FileEdit, Highlight, OutlineKind, Symbol};
use language::{Code, Diagnostic, Label, Severity, Source, Span};
use lsp_types::{
    CompletionItem, CompletionItemKind, CompletionItemTextEdit, DiagnosticRelatedInformation, DiagnosticSeverity,
    DocumentChange, DocumentSymbol, Documentation, Edit, InsertTextFormat, Location, MarkupContent, MarkupKind,
    OptionalVersionedTextDocumentIdentifier, Range, SemanticToken, SymbolKind, TextDocumentEdit,
    TextDocumentIdentifier, TextEdit, Uri, WorkspaceEdit,
};
use std::collections::{BTreeMap, HashMap};

/// The kinds of tokens. Each has a standard name, for which editors have a colour.
pub(super) const TOKEN_TYPES: [&str; 10] =
    ["keyword", "type", "variable", "parameter", "property", "enumMember", "number", "string", "operator", "comment"];
/// The modifiers of tokens.
pub(super) const TOKEN_MODIFIERS: [&str; 2] = ["declaration", "readonly"];

/// Returns the range of a span.
pub(super) fn range(source: &Source, lines: &Lines, span: Span, encoding: Encoding) -> Range {
    lines.range(&source.text, span.start as usize..span.end as usize, encoding)
}

/// Returns the location of a span, if it is in a file.
pub(super) fn location(workspace: &Workspace, source: &Source, span: Span, encoding: Encoding) -> Location {
    match workspace.open_from(&source.name) {
        // The lines of an open document have been counted already.
        Some(open) => Location { uri: Uri(open.uri.clone()), range: range(source, &open.lines, span, encoding) },
        None => {
            let range = range(source, &Lines::new(&source.text), span, encoding);
            Location { uri: Uri(disk::uri(&source.name)), range }
        }
    }
}

/// Converts a diagnostic for the file that it is about.
pub(super) fn diagnostic(
    found: &Diagnostic,
    source: &Source,
    lines: &Lines,
    reasons: Vec<DiagnosticRelatedInformation>,
    editor: &Editor,
) -> lsp_types::Diagnostic {
    let mut message = found.message.clone();
    let label = Some(&found.primary.text).filter(|text| !text.is_empty()).cloned();
    let told = |label: &Label| (!label.text.is_empty()).then(|| format!("note: {}", label.text));
    let notes: Vec<String> =
        if editor.related { Vec::new() } else { found.secondary.iter().filter_map(told).collect() };
    let help = found.help.iter().map(|help| format!("help: {help}"));
    for line in label.into_iter().chain(notes).chain(help) {
        message.push('\n');
        message.push_str(&line);
    }
    lsp_types::Diagnostic {
        range: range(source, lines, found.primary.span, editor.encoding),
        severity: Some(severity(found)),
        code: Some(found.code.as_str().to_owned().into()),
        source: Some("dca".to_owned()),
        message: message.into(),
        related_information: (!reasons.is_empty()).then_some(reasons),
        ..lsp_types::Diagnostic::default()
    }
}

/// Returns the severity. It is not a mistake that a file for other specs has nothing to run, but a person may want to know it.
fn severity(found: &Diagnostic) -> DiagnosticSeverity {
    match found.severity {
        Severity::Error if found.code == Code::E0101 => DiagnosticSeverity::Information,
        Severity::Error => DiagnosticSeverity::Error,
        Severity::Warning => DiagnosticSeverity::Warning,
    }
}

/// Returns the completions in this order. Each replaces the typed text.
pub(super) fn completion(offers: Vec<Completion>, range: Range, editor: &Editor) -> Vec<CompletionItem> {
    let item = |(place, offer): (usize, Completion)| {
        let snippet = offer.snippet.filter(|_| editor.snippets);
        let format = if snippet.is_some() { InsertTextFormat::Snippet } else { InsertTextFormat::PlainText };
        let new_text = snippet.unwrap_or_else(|| offer.label.clone());
        let edit = TextEdit { range, new_text };
        CompletionItem {
            kind: Some(completion_kind(offer.kind)),
            detail: Some(offer.detail).filter(|detail| !detail.is_empty()),
            documentation: Some(offer.documentation)
                .filter(|text| !text.is_empty())
                .map(|text| Documentation::MarkupContent(MarkupContent { kind: MarkupKind::Markdown, value: text })),
            sort_text: Some(format!("{place:04}")),
            insert_text_format: Some(format),
            text_edit: Some(CompletionItemTextEdit::TextEdit(edit)),
            label: offer.label,
            ..CompletionItem::default()
        }
    };
    offers.into_iter().enumerate().map(item).collect()
}

fn completion_kind(kind: CompletionKind) -> CompletionItemKind {
    match kind {
        CompletionKind::Keyword => CompletionItemKind::Keyword,
        CompletionKind::Type => CompletionItemKind::Class,
        CompletionKind::Instance | CompletionKind::Parameter => CompletionItemKind::Variable,
        CompletionKind::Port => CompletionItemKind::Property,
        CompletionKind::Label | CompletionKind::Outcome => CompletionItemKind::EnumMember,
        CompletionKind::Constant => CompletionItemKind::Constant,
        CompletionKind::Host => CompletionItemKind::Value,
        CompletionKind::Unit => CompletionItemKind::Unit,
    }
}

/// Returns edits of files. The edits of an open file contain the version of the text that they fit.
pub(super) fn workspace_edit(edits: Vec<FileEdit>, workspace: &Workspace, editor: &Editor) -> WorkspaceEdit {
    let mut files: BTreeMap<String, Vec<TextEdit>> = BTreeMap::new();
    let mut texts: BTreeMap<String, (String, Lines)> = BTreeMap::new();
    for edit in edits {
        let (text, lines) = texts.entry(edit.file.clone()).or_insert_with(|| {
            let text = workspace.read(&edit.file).unwrap_or_default();
            let lines = Lines::new(&text);
            (text, lines)
        });
        let range = lines.range(text, edit.start as usize..edit.end as usize, editor.encoding);
        files.entry(edit.file).or_default().push(TextEdit { range, new_text: edit.text });
    }
    let uri = |path: &str| workspace.open_from(path).map_or_else(|| disk::uri(path), |open| open.uri.clone());
    if !editor.versioned_edits {
        let changes: HashMap<Uri, Vec<TextEdit>> =
            files.into_iter().map(|(path, edits)| (Uri(uri(&path)), edits)).collect();
        return WorkspaceEdit { changes: Some(changes), ..WorkspaceEdit::default() };
    }
    let change = |(path, edits): (String, Vec<TextEdit>)| {
        let version = workspace.open_from(&path).map(|open| open.version);
        let text_document = OptionalVersionedTextDocumentIdentifier {
            version,
            text_document_identifier: TextDocumentIdentifier { uri: Uri(uri(&path)) },
        };
        let edits = edits.into_iter().map(Edit::TextEdit).collect();
        DocumentChange::TextDocumentEdit(TextDocumentEdit { text_document, edits })
    };
    WorkspaceEdit { document_changes: Some(files.into_iter().map(change).collect()), ..WorkspaceEdit::default() }
}

/// Returns the outline of a document.
#[expect(deprecated, reason = "the type has a field of older versions, which stays empty")]
pub(super) fn outline(
    symbols: Vec<Symbol>,
    analysis: &Analysis,
    lines: &Lines,
    editor: &Editor,
) -> Vec<DocumentSymbol> {
    let place = |span| range(analysis.spec(), lines, span, editor.encoding);
    let symbols = symbols.into_iter().map(|symbol| DocumentSymbol {
        name: symbol.name,
        detail: Some(symbol.detail).filter(|detail| !detail.is_empty()),
        kind: match symbol.kind {
            OutlineKind::Process => SymbolKind::Class,
            OutlineKind::Module => SymbolKind::Interface,
            OutlineKind::Constant => SymbolKind::Constant,
            OutlineKind::Type => SymbolKind::Struct,
            OutlineKind::Instance => SymbolKind::Object,
            OutlineKind::Port => SymbolKind::Property,
            OutlineKind::Connections => SymbolKind::Event,
            OutlineKind::Actions => SymbolKind::Function,
        },
        tags: None,
        deprecated: None,
        range: place(symbol.span),
        selection_range: place(symbol.name_span),
        children: Some(outline(symbol.children, analysis, lines, editor)),
    });
    symbols.collect()
}

/// Returns the tokens of a document. A comment with several lines becomes several tokens.
pub(super) fn tokens(found: &[Highlight], text: &str, lines: &Lines, encoding: Encoding) -> Vec<SemanticToken> {
    let mut tokens = Vec::with_capacity(found.len());
    let (mut line, mut column) = (0, 0);
    for token in found {
        let (start, end) = (token.span.start as usize, token.span.end as usize);
        let mut at = start;
        for part in text.get(start..end).unwrap_or_default().split_inclusive('\n') {
            let length = part.trim_end_matches(['\n', '\r']).len();
            let place = lines.range(text, at..at + length, encoding);
            at += part.len();
            if length == 0 || place.start.line != place.end.line {
                continue;
            }
            let is_new = place.start.line != line;
            tokens.push(SemanticToken {
                delta_line: place.start.line - line,
                delta_start: if is_new { place.start.character } else { place.start.character - column },
                length: place.end.character - place.start.character,
                token_type: token_type(token.class),
                token_modifiers_bitset: u32::from(token.is_declaration)
                    | u32::from(token.class == Class::Constant) << 1,
            });
            (line, column) = (place.start.line, place.start.character);
        }
    }
    tokens
}

fn token_type(class: Class) -> u32 {
    let name = match class {
        Class::Keyword => "keyword",
        Class::Type => "type",
        Class::Instance | Class::Constant => "variable",
        Class::Parameter | Class::Variable => "parameter",
        Class::Port => "property",
        Class::Label => "enumMember",
        Class::Number => "number",
        Class::Text => "string",
        Class::Operator => "operator",
        Class::Comment => "comment",
    };
    number(TOKEN_TYPES.iter().position(|known| *known == name).unwrap_or(0))
}
