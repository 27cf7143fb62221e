//! The capabilities of the editor at the other end.

use super::position::Encoding;
use serde_json::Value;

/// The capabilities that an editor has announced.
#[derive(Clone, Debug, Default)]
pub(super) struct Editor {
    /// The unit in which columns are counted.
    pub(super) encoding: Encoding,
    /// Whether it fills in snippets.
    pub(super) snippets: bool,
    /// Whether it accepts edits for a certain version of a document.
    pub(super) versioned_edits: bool,
    /// Whether it shows the locations of a diagnostic's reasons.
    pub(super) related: bool,
    /// Whether it can report changes of files on the disk.
    pub(super) watches: bool,
    /// Whether the server can ask it to request the lines above blocks again.
    pub(super) refreshes_lenses: bool,
    /// The folders that are open, as URIs.
    pub(super) folders: Vec<String>,
}

impl Editor {
    /// Reads the parameters of `initialize`. A capability that is missing or invalid counts as absent.
    pub(super) fn new(params: &Value) -> Self {
        let is = |path: &str| params.pointer(path).and_then(Value::as_bool).unwrap_or(false);
        let encodings = params.pointer("/capabilities/general/positionEncodings").and_then(Value::as_array);
        let counts_bytes = encodings.is_some_and(|encodings| encodings.iter().any(|encoding| encoding == "utf-8"));
        let uri = |value: &Value| value.get("uri").and_then(Value::as_str).map(str::to_owned);
        let folders: Vec<String> = match params.get("workspaceFolders").and_then(Value::as_array) {
            Some(folders) => folders.iter().filter_map(uri).collect(),
            None => params.get("rootUri").and_then(Value::as_str).map(str::to_owned).into_iter().collect(),
        };
        Self {
            encoding: if counts_bytes { Encoding::Utf8 } else { Encoding::Utf16 },
            snippets: is("/capabilities/textDocument/completion/completionItem/snippetSupport"),
            versioned_edits: is("/capabilities/workspace/workspaceEdit/documentChanges"),
            related: is("/capabilities/textDocument/publishDiagnostics/relatedInformation"),
            watches: is("/capabilities/workspace/didChangeWatchedFiles/dynamicRegistration"),
            refreshes_lenses: is("/capabilities/workspace/codeLens/refreshSupport"),
            folders,
        }
    }
}
