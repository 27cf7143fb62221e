//! The open documents, each with its analysis. An analysis is made when it is needed, and discarded when a text changes.

use super::disk;
use super::interfaces::Interfaces;
use super::position::{Encoding, Lines};
use crate::check;
use crate::io::named_file;
use language::ide::Analysis;
use language::{Content, Options, Role, Source, gather};
use lsp_types::{Range, TextDocumentContentChangeEvent};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// The longest document that is checked while a person writes it, in bytes. `dca check` accepts longer ones.
pub(super) const DOCUMENT_MAX: usize = 2 << 20;
/// The most documents that can be open.
const DOCUMENTS_MAX: usize = 1000;

/// A document that is open in the editor.
#[derive(Debug)]
pub(super) struct Document {
    /// Its name in the editor.
    pub(super) uri: String,
    /// Its name in `use` and in diagnostics.
    pub(super) path: String,
    /// The number of its version, which the editor counts.
    pub(super) version: i32,
    pub(super) text: String,
    pub(super) lines: Lines,
    analysis: Option<Rc<Analysis>>,
}

impl Document {
    /// Whether it is short enough to be checked at each keystroke.
    pub(super) fn is_short(&self) -> bool {
        self.text.len() <= DOCUMENT_MAX
    }

    fn set(&mut self, text: String) {
        self.lines = Lines::new(&text);
        self.text = text;
    }
}

/// The open documents, and the folders of the editor.
pub(super) struct Workspace {
    documents: BTreeMap<String, Document>,
    folders: Vec<PathBuf>,
    pub(super) interfaces: Interfaces,
}

impl Workspace {
    pub(super) fn new(interfaces: Interfaces) -> Self {
        Self { documents: BTreeMap::new(), folders: Vec::new(), interfaces }
    }

    /// Sets the folders whose specs are searched for a name.
    pub(super) fn set_folders(&mut self, uris: &[String]) {
        self.folders =
            uris.iter().map(|uri| PathBuf::from(disk::path(uri))).filter(|path| path.is_absolute()).collect();
    }

    /// Opens a document.
    ///
    /// # Errors
    /// A sentence for a person: too many documents are open.
    pub(super) fn open(&mut self, uri: String, version: i32, text: String) -> Result<(), String> {
        if self.documents.len() >= DOCUMENTS_MAX && !self.documents.contains_key(&uri) {
            return Err(format!("more than {DOCUMENTS_MAX} documents are open: this one is not checked"));
        }
        let path = disk::path(&uri);
        self.forget(&path);
        let lines = Lines::new(&text);
        self.documents.insert(uri.clone(), Document { uri, path, version, text, lines, analysis: None });
        Ok(())
    }

    /// Applies changes to a document, one after the other.
    pub(super) fn change(
        &mut self,
        uri: &str,
        version: i32,
        changes: Vec<TextDocumentContentChangeEvent>,
        encoding: Encoding,
    ) {
        let Some(document) = self.documents.get_mut(uri) else { return };
        document.version = version;
        for change in changes {
            match change {
                TextDocumentContentChangeEvent::TextDocumentContentChangePartial(change) => {
                    let Range { start, end } = change.range;
                    let start = document.lines.offset(&document.text, start, encoding);
                    let end = document.lines.offset(&document.text, end, encoding).max(start);
                    let mut text = std::mem::take(&mut document.text);
                    text.replace_range(start..end, &change.text);
                    document.set(text);
                }
                TextDocumentContentChangeEvent::TextDocumentContentChangeWholeDocument(change) => {
                    document.set(change.text);
                }
            }
        }
        let path = document.path.clone();
        self.forget(&path);
    }

    /// Closes a document. From now on, the file on the disk is used.
    pub(super) fn close(&mut self, uri: &str) {
        if let Some(document) = self.documents.remove(uri) {
            self.forget(&document.path);
        }
    }

    /// Discards each analysis that a text is a part of.
    pub(super) fn forget(&mut self, path: &str) {
        for document in self.documents.values_mut() {
            // A new file may be in a folder that a document uses.
            let folder = path.rsplit_once('/').map_or(".", |(folder, _)| folder);
            let names =
                |other: &Source| other.name == path || matches!(&other.role, Role::Folder(_)) && other.name == folder;
            let is_part = |analysis: &Rc<Analysis>| analysis.others().iter().any(names);
            if document.path == path || document.analysis.as_ref().is_some_and(is_part) {
                document.analysis = None;
            }
        }
    }

    /// Discards all analyses, because a program has printed another interface.
    pub(super) fn forget_all(&mut self) {
        self.documents.values_mut().for_each(|document| document.analysis = None);
    }

    pub(super) fn document(&self, uri: &str) -> Option<&Document> {
        self.documents.get(uri)
    }

    /// Returns the open document with this path.
    pub(super) fn open_from(&self, path: &str) -> Option<&Document> {
        self.documents.values().find(|document| document.path == path)
    }

    /// Returns all documents, sorted by URI.
    pub(super) fn documents(&self) -> impl Iterator<Item = &Document> {
        self.documents.values()
    }

    /// Returns the analysis of a document; nothing if it is not open or is too long.
    pub(super) fn analysis(&mut self, uri: &str) -> Option<Rc<Analysis>> {
        let document = self.documents.get(uri).filter(|document| document.is_short())?;
        if let Some(analysis) = &document.analysis {
            return Some(Rc::clone(analysis));
        }
        let analysis = Rc::new(self.analyse(Source::new(document.path.clone(), document.text.clone())));
        if let Some(document) = self.documents.get_mut(uri) {
            document.analysis = Some(Rc::clone(&analysis));
        }
        Some(analysis)
    }

    /// Returns the analyses of all specs that may contain a name of a file. These are the open documents, and the specs
    /// that use the file: in the open folders, or in the folder of the file if no folder is open.
    pub(super) fn users(&mut self, path: &str) -> Vec<Rc<Analysis>> {
        let open: Vec<String> = self.documents.keys().cloned().collect();
        let mut found: Vec<Rc<Analysis>> = open.iter().filter_map(|uri| self.analysis(uri)).collect();
        let beside = Path::new(path).parent().map(Path::to_path_buf).filter(|folder| folder.is_absolute());
        let folders = if self.folders.is_empty() { beside.into_iter().collect() } else { self.folders.clone() };
        for other in disk::specs(&folders) {
            if self.open_from(&other).is_some() {
                continue;
            }
            let Ok(text) = self.read(&other) else { continue };
            let source = Source::new(other, text);
            // Most specs do not use the file. For them, looking at their `use` is enough.
            let parts = gather(&source, &|part| self.content(part));
            if source.name == path || parts.iter().any(|part| part.name == path) {
                found.push(Rc::new(self.analyse(source)));
            }
        }
        found
    }

    fn analyse(&self, source: Source) -> Analysis {
        let mut others = gather(&source, &|path| self.content(path));
        others.extend(self.interfaces.sources());
        let name = Path::new(&source.name).file_stem().map_or_else(|| "spec".into(), |stem| stem.to_string_lossy());
        let options = Options::named(name);
        Analysis::new(source, others, &options)
    }

    /// Returns the file or the folder that a path in a `use` names.
    fn content(&self, path: &str) -> Result<Content, String> {
        check::content(path, |path| self.read(path))
    }

    /// Returns the text of a file. The text in the editor has precedence.
    pub(super) fn read(&self, path: &str) -> Result<String, String> {
        if let Some(document) = self.open_from(path) {
            return Ok(document.text.clone());
        }
        named_file::text(Path::new(path), DOCUMENT_MAX).map_err(|error| error.to_string())
    }
}

/// Returns whether a text is the content of a file, so that an editor can show and change it.
pub(super) fn is_file(source: &Source, analysis: &Analysis) -> bool {
    source.role == Role::Part || source.name == analysis.spec().name
}
