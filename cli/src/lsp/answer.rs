//! Answers the requests of an editor.

use super::convert::{self, range};
use super::server::{Refusal, Server};
use super::workspace::{Document, is_file};
use language::ide::{Analysis, FileEdit, rename};
use language::{Diagnostic, Edit, Fix, Origin, Source, Span, apply_fixes, format};
use lsp_types::{
    CodeAction, CodeActionKind, CodeActionParams, CodeActionRequest, CodeActionResponse, CodeLens, CodeLensParams,
    CodeLensRequest, Command, CompletionParams, CompletionRequest, CompletionResponse, Contents, Definition,
    DefinitionParams, DefinitionRequest, DefinitionResponse, DocumentFormattingParams, DocumentFormattingRequest,
    DocumentHighlight, DocumentHighlightParams, DocumentHighlightRequest, DocumentSymbolParams, DocumentSymbolRequest,
    DocumentSymbolResponse, ErrorCodes, FoldingRange, FoldingRangeParams, FoldingRangeRequest, Hover, HoverParams,
    HoverRequest, Location, MarkupContent, MarkupKind, Position, PrepareRenameParams, PrepareRenamePlaceholder,
    PrepareRenameRequest, PrepareRenameResult, ReferenceParams, ReferencesRequest, RenameParams, RenameRequest,
    Request, SemanticTokens, SemanticTokensParams, SemanticTokensRequest, TextDocumentPositionParams, TextEdit,
};
use serde_json::Value;
use std::rc::Rc;
use verify::Repair;

/// Answers one kind of requests.
fn ask<R: Request>(
    params: Value,
    answer: impl FnOnce(R::Params) -> Result<R::Result, Refusal>,
) -> Result<Value, Refusal> {
    let unread = |message| Refusal { code: ErrorCodes::InvalidParams.into(), message };
    let result = answer(super::server::read(params).map_err(unread)?)?;
    serde_json::to_value(result).map_err(|error| Refusal::failed(error.to_string()))
}

/// A position in a document, with its analysis.
struct Place<'a> {
    document: &'a Document,
    analysis: Rc<Analysis>,
    offset: usize,
}

impl Server {
    /// Answers a request.
    pub(super) fn answer(&mut self, method: &str, params: Value) -> Result<Value, Refusal> {
        match method {
            "textDocument/completion" => ask::<CompletionRequest>(params, |it| self.completion(&it)),
            "textDocument/hover" => ask::<HoverRequest>(params, |it| self.hover(&it)),
            "textDocument/definition" => ask::<DefinitionRequest>(params, |it| self.definition(&it)),
            "textDocument/references" => ask::<ReferencesRequest>(params, |it| self.references(&it)),
            "textDocument/documentHighlight" => ask::<DocumentHighlightRequest>(params, |it| self.highlight(&it)),
            "textDocument/prepareRename" => ask::<PrepareRenameRequest>(params, |it| self.prepare_rename(&it)),
            "textDocument/rename" => ask::<RenameRequest>(params, |it| self.rename(&it)),
            "textDocument/codeLens" => ask::<CodeLensRequest>(params, |it| self.lenses(&it)),
            "textDocument/codeAction" => ask::<CodeActionRequest>(params, |it| self.actions(&it)),
            "textDocument/documentSymbol" => ask::<DocumentSymbolRequest>(params, |it| self.outline(&it)),
            "textDocument/semanticTokens/full" => ask::<SemanticTokensRequest>(params, |it| self.tokens(&it)),
            "textDocument/foldingRange" => ask::<FoldingRangeRequest>(params, |it| self.folds(&it)),
            "textDocument/formatting" => ask::<DocumentFormattingRequest>(params, |it| self.formatting(&it)),
            _ => Err(Refusal {
                code: ErrorCodes::MethodNotFound.into(),
                message: format!("`{method}` is not known here"),
            }),
        }
    }

    /// Returns a document and its analysis.
    pub(super) fn document(&mut self, uri: &str) -> Result<(&Document, Rc<Analysis>), Refusal> {
        let analysis = self.workspace.analysis(uri);
        let document = self.workspace.document(uri);
        let document = document.ok_or_else(|| Refusal::failed(format!("`{uri}` is not open")))?;
        let analysis = analysis.ok_or_else(|| Refusal::failed("the text is too long to be looked at"))?;
        Ok((document, analysis))
    }

    fn place(&mut self, at: &TextDocumentPositionParams) -> Result<Place<'_>, Refusal> {
        let encoding = self.editor.encoding;
        let (document, analysis) = self.document(&at.text_document.uri.0)?;
        let offset = document.lines.offset(&document.text, at.position, encoding);
        Ok(Place { document, analysis, offset })
    }

    fn completion(&mut self, params: &CompletionParams) -> Result<Option<CompletionResponse>, Refusal> {
        let editor = self.editor.clone();
        let Place { document, analysis, offset } = self.place(&params.text_document_position_params)?;
        let (bytes, offers) = analysis.complete(offset);
        let range = document.lines.range(&document.text, bytes, editor.encoding);
        Ok(Some(convert::completion(offers, range, &editor).into()))
    }

    fn hover(&mut self, params: &HoverParams) -> Result<Option<Hover>, Refusal> {
        let encoding = self.editor.encoding;
        let Place { document, analysis, offset } = self.place(&params.text_document_position_params)?;
        Ok(analysis.hover(offset).map(|hover| Hover {
            range: Some(range(analysis.spec(), &document.lines, hover.span, encoding)),
            contents: Contents::MarkupContent(MarkupContent { kind: MarkupKind::Markdown, value: hover.text }),
        }))
    }

    fn definition(&mut self, params: &DefinitionParams) -> Result<Option<DefinitionResponse>, Refusal> {
        let Place { analysis, offset, .. } = self.place(&params.text_document_position_params)?;
        let Some(span) = analysis.definition(offset) else { return Ok(None) };
        Ok(Some(DefinitionResponse::Definition(Definition::Location(self.location(&analysis, span)?))))
    }

    /// Returns the location of a span. If a program has printed the interface with the span, writes the interface to a
    /// file for the editor.
    fn location(&self, analysis: &Analysis, span: Span) -> Result<Location, Refusal> {
        let source = analysis.source(span);
        if is_file(source, analysis) {
            return Ok(convert::location(&self.workspace, source, span, self.editor.encoding));
        }
        let shown = self.workspace.interfaces.show(source);
        let name = shown.map_err(|error| Refusal::failed(format!("the interface cannot be shown: {error}")))?;
        let source = Source { name, ..source.clone() };
        Ok(convert::location(&self.workspace, &source, span, self.editor.encoding))
    }

    fn references(&mut self, params: &ReferenceParams) -> Result<Option<Vec<Location>>, Refusal> {
        let Place { analysis, offset, .. } = self.place(&params.text_document_position_params)?;
        let Some(declaration) = analysis.declaration(offset) else { return Ok(None) };
        let mut found: Vec<Location> = Vec::new();
        for user in self.workspace.users(&declaration.file) {
            let places = user.references(&declaration);
            for (place, span) in places.into_iter().enumerate() {
                let is_wanted = place > 0 || params.context.include_declaration;
                let location = is_wanted.then(|| self.location(&user, span)).transpose()?;
                found.extend(location.filter(|location| !found.contains(location)));
            }
        }
        Ok(Some(found))
    }

    fn highlight(&mut self, params: &DocumentHighlightParams) -> Result<Option<Vec<DocumentHighlight>>, Refusal> {
        let encoding = self.editor.encoding;
        let Place { document, analysis, offset } = self.place(&params.text_document_position_params)?;
        let Some(declaration) = analysis.declaration(offset) else { return Ok(None) };
        let places = analysis.references(&declaration).into_iter().filter(|span| span.origin == Origin::Spec);
        let highlight =
            |span| DocumentHighlight { range: range(analysis.spec(), &document.lines, span, encoding), kind: None };
        Ok(Some(places.map(highlight).collect()))
    }

    fn prepare_rename(&mut self, params: &PrepareRenameParams) -> Result<Option<PrepareRenameResult>, Refusal> {
        let encoding = self.editor.encoding;
        let Place { document, analysis, offset } = self.place(&params.text_document_position_params)?;
        let span = analysis.prepare_rename(offset).map_err(|error| Refusal::failed(error.to_string()))?;
        let placeholder = document.text.get(span.start as usize..span.end as usize).unwrap_or_default().to_owned();
        let range = range(analysis.spec(), &document.lines, span, encoding);
        Ok(Some(PrepareRenameResult::PrepareRenamePlaceholder(PrepareRenamePlaceholder { range, placeholder })))
    }

    fn rename(&mut self, params: &RenameParams) -> Result<Option<lsp_types::WorkspaceEdit>, Refusal> {
        let Place { analysis, offset, .. } = self.place(&params.text_document_position_params)?;
        let refused = |error: language::ide::RenameError| Refusal::failed(error.to_string());
        analysis.prepare_rename(offset).map_err(refused)?;
        let Some(declaration) = analysis.declaration(offset) else { return Ok(None) };
        let users = self.workspace.users(&declaration.file);
        let users: Vec<&Analysis> = users.iter().map(Rc::as_ref).collect();
        let edits = rename(&users, &declaration, &params.new_name).map_err(refused)?;
        Ok(Some(convert::workspace_edit(edits, &self.workspace, &self.editor)))
    }

    /// Returns the line above each `verify` block.
    fn lenses(&mut self, params: &CodeLensParams) -> Result<Option<Vec<CodeLens>>, Refusal> {
        let (uri, encoding) = (&params.text_document.uri.0, self.editor.encoding);
        let (_, analysis) = self.document(uri)?;
        let Some(titles) = self.proofs.titles(uri, &analysis) else { return Ok(None) };
        let (document, analysis) = self.document(uri)?;
        let lens = |(block, title): (Span, String)| {
            let first = Span { end: block.start, ..block };
            let command = Command { title, tooltip: None, command: String::new(), arguments: None };
            let range = range(analysis.spec(), &document.lines, first, encoding);
            CodeLens { range, command: Some(command), data: None }
        };
        Ok(Some(titles.into_iter().map(lens).collect()))
    }

    /// Returns the fixes for the mistakes in a range, and one fix for all mistakes.
    fn actions(&mut self, params: &CodeActionParams) -> Result<Option<Vec<CodeActionResponse>>, Refusal> {
        let encoding = self.editor.encoding;
        let (document, analysis) = self.document(&params.text_document.uri.0)?;
        let offset = |position: Position| document.lines.offset(&document.text, position, encoding);
        let (start, end) = (offset(params.range.start), offset(params.range.end));
        let touches =
            |span: Span| span.origin == Origin::Spec && span.start as usize <= end && start <= span.end as usize;
        let here = analysis.diagnostics().iter().filter(|found| touches(found.primary.span));
        let is_wanted = |kind: &CodeActionKind| {
            let wanted = params.context.only.as_ref();
            wanted.is_none_or(|wanted| wanted.iter().any(|one| kind.to_string().starts_with(&one.to_string())))
        };
        let mut found: Vec<CodeAction> = here.flat_map(|found| self.quick_fixes(found, &analysis)).collect();
        if analysis.plan().is_some() {
            let repairs = self.proofs.repairs(&params.text_document.uri.0, &analysis);
            let is_here =
                |repair: &&Repair| touches(repair.span) || repair.fix.edits.iter().any(|edit| touches(edit.span));
            let repairs: Vec<Repair> = repairs.iter().filter(is_here).cloned().collect();
            found.extend(repairs.iter().map(|repair| self.repair(repair, &analysis)));
        }
        // If the range contains no mistake, the editor gets the fix for all mistakes only on request.
        if !found.is_empty() || params.context.only.is_some() {
            found.extend(self.fix_all(&analysis));
        }
        found.retain(|action| action.kind.as_ref().is_none_or(is_wanted));
        Ok(Some(found.into_iter().map(CodeActionResponse::CodeAction).collect()))
    }

    /// Returns the fix of a diagnostic, and its choices.
    fn quick_fixes(&self, found: &Diagnostic, analysis: &Analysis) -> Vec<CodeAction> {
        let Some(document) = self.workspace.open_from(&analysis.spec().name) else { return Vec::new() };
        let shown = convert::diagnostic(found, analysis.spec(), &document.lines, Vec::new(), &self.editor);
        let action = |fix: &Fix, is_preferred: Option<bool>| CodeAction {
            title: fix.title.clone(),
            kind: Some(CodeActionKind::QuickFix),
            diagnostics: Some(vec![shown.clone()]),
            is_preferred,
            edit: Some(convert::workspace_edit(file_edits(fix, analysis), &self.workspace, &self.editor)),
            ..CodeAction::default()
        };
        let certain = found.fix.iter().map(|fix| action(fix, Some(true)));
        certain.chain(found.choices.iter().map(|fix| action(fix, None))).collect()
    }

    /// Returns an edit that was verified to repair a mistake.
    fn repair(&self, repair: &Repair, analysis: &Analysis) -> CodeAction {
        CodeAction {
            title: format!("{} (verified)", repair.fix.title),
            kind: Some(CodeActionKind::QuickFix),
            edit: Some(convert::workspace_edit(file_edits(&repair.fix, analysis), &self.workspace, &self.editor)),
            ..CodeAction::default()
        }
    }

    /// Returns all fixes as one edit, like the first round of `dca fix`.
    fn fix_all(&self, analysis: &Analysis) -> Option<CodeAction> {
        let spec = analysis.spec();
        let fixed = apply_fixes(&spec.text, analysis.diagnostics());
        let (start, end, text) = changed(&spec.text, &fixed);
        let (start, end) = (super::position::number(start), super::position::number(end));
        let edit = FileEdit { file: spec.name.clone(), start, end, text };
        (fixed != spec.text).then(|| CodeAction {
            title: "apply every fix that is the only possible correction".to_owned(),
            kind: Some(CodeActionKind::from("source.fixAll.dca".to_owned())),
            edit: Some(convert::workspace_edit(vec![edit], &self.workspace, &self.editor)),
            ..CodeAction::default()
        })
    }

    fn outline(&mut self, params: &DocumentSymbolParams) -> Result<Option<DocumentSymbolResponse>, Refusal> {
        let editor = self.editor.clone();
        let (document, analysis) = self.document(&params.text_document.uri.0)?;
        let symbols = convert::outline(analysis.outline(), &analysis, &document.lines, &editor);
        Ok(Some(DocumentSymbolResponse::DocumentSymbolList(symbols)))
    }

    fn tokens(&mut self, params: &SemanticTokensParams) -> Result<Option<SemanticTokens>, Refusal> {
        let encoding = self.editor.encoding;
        let (document, analysis) = self.document(&params.text_document.uri.0)?;
        let data = convert::tokens(&analysis.highlights(), &document.text, &document.lines, encoding);
        Ok(Some(SemanticTokens { result_id: None, data }))
    }

    fn folds(&mut self, params: &FoldingRangeParams) -> Result<Option<Vec<FoldingRange>>, Refusal> {
        let encoding = self.editor.encoding;
        let (document, analysis) = self.document(&params.text_document.uri.0)?;
        let folds = analysis.folds().into_iter().filter_map(|span| {
            let range = range(analysis.spec(), &document.lines, span, encoding);
            let (start_line, end_line) = (range.start.line, range.end.line);
            (start_line < end_line).then(|| FoldingRange { start_line, end_line, ..FoldingRange::default() })
        });
        Ok(Some(folds.collect()))
    }

    fn formatting(&mut self, params: &DocumentFormattingParams) -> Result<Option<Vec<TextEdit>>, Refusal> {
        let encoding = self.editor.encoding;
        let (document, analysis) = self.document(&params.text_document.uri.0)?;
        let damaged = |_: Vec<Diagnostic>| Refusal::failed("a text with syntax errors is not formatted");
        let formatted = format(analysis.spec()).map_err(damaged)?;
        if formatted == document.text {
            return Ok(Some(Vec::new()));
        }
        let (start, end, new_text) = changed(&document.text, &formatted);
        Ok(Some(vec![TextEdit { range: document.lines.range(&document.text, start..end, encoding), new_text }]))
    }
}

/// Returns which bytes of `old` differ from `new`, in whole lines, and the text of `new` that replaces them.
fn changed(old: &str, new: &str) -> (usize, usize, String) {
    let line = |(one, other): &(&str, &str)| one == other;
    let same = |pairs: usize| -> usize { old.split_inclusive('\n').take(pairs).map(str::len).sum() };
    let first = std::iter::zip(old.split_inclusive('\n'), new.split_inclusive('\n')).take_while(line).count();
    let start = same(first);
    let (old_rest, new_rest) = (&old[start..], &new[start..]);
    let backwards = |text: &'_ str| text.split_inclusive('\n').rev().map(str::to_owned).collect::<Vec<_>>();
    let last = std::iter::zip(backwards(old_rest), backwards(new_rest)).take_while(|(one, other)| one == other);
    let tail: usize = last.map(|(one, _)| one.len()).sum();
    (start, old.len() - tail, new_rest[..new_rest.len() - tail].to_owned())
}

/// Returns the edits of a fix, each with its file.
fn file_edits(fix: &Fix, analysis: &Analysis) -> Vec<FileEdit> {
    let edit = |edit: &Edit| FileEdit {
        file: analysis.source(edit.span).name.clone(),
        start: edit.span.start,
        end: edit.span.end,
        text: edit.text.clone(),
    };
    fix.edits.iter().map(edit).collect()
}

#[cfg(test)]
mod tests {
    use super::changed;

    #[test]
    fn only_lines_that_differ_are_replaced() {
        let cases =
            [("a\nb\nc\n", "a\nB\nc\n"), ("a\n", "a\na\n"), ("a\na\n", "a\n"), ("", "a"), ("a", ""), ("ä\nb", "ö\nb")];
        for (old, new) in cases {
            let (start, end, text) = changed(old, new);
            assert_eq!(format!("{}{text}{}", &old[..start], &old[end..]), new);
        }
        assert_eq!(changed("a\nb\nc\n", "a\nB\nc\n"), (2, 4, "B\n".to_owned()));
    }
}
