//! The language server: its states, and which part answers which request.

use super::convert::{TOKEN_MODIFIERS, TOKEN_TYPES};
use super::editor::Editor;
use super::interfaces::{InterfaceReply, Interfaces};
use super::lens::{ProofReply, Proofs};
use super::position::Encoding;
use super::publish::Published;
use super::rpc::Message;
use super::workspace::Workspace;
use lsp_types::json_rpc::{Error, Id, RequestObject, ResponseObject};
use lsp_types::{
    DidChangeTextDocumentParams, DidChangeWatchedFilesParams, DidCloseTextDocumentParams, DidOpenTextDocumentParams,
    ErrorCodes, LogMessageNotification, LogMessageParams, LspErrorCodes, MessageType, Notification, RegistrationParams,
    RegistrationRequest, ShowMessageNotification, ShowMessageParams,
};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// A message to the editor.
pub(super) type Reply = Value;

/// The state of the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    /// The editor has not sent `initialize`.
    Fresh,
    /// All requests are accepted.
    Ready,
    /// No request is accepted any more.
    ShutDown,
    /// The editor has ended the server as the protocol requires.
    Ended,
    /// The editor has ended the server without asking it to shut down first.
    Abandoned,
}

/// Why a request has no answer.
#[derive(Debug)]
pub(super) struct Refusal {
    pub(super) code: i32,
    pub(super) message: String,
}

impl Refusal {
    /// Returns the refusal of a request that is valid but cannot be fulfilled.
    pub(super) fn failed(message: impl Into<String>) -> Self {
        Self { code: LspErrorCodes::RequestFailed.into(), message: message.into() }
    }
}

/// A language server for one editor.
pub(super) struct Server {
    state: State,
    pub(super) editor: Editor,
    pub(super) workspace: Workspace,
    pub(super) published: Published,
    pub(super) proofs: Proofs,
}

impl Server {
    pub(super) fn new(interfaces: Interfaces, proofs: Proofs) -> Self {
        let workspace = Workspace::new(interfaces);
        Self { state: State::Fresh, editor: Editor::default(), workspace, published: Published::default(), proofs }
    }

    pub(super) fn state(&self) -> State {
        self.state
    }

    /// Handles a message of the editor.
    pub(super) fn handle(&mut self, message: Message, replies: &mut Vec<Reply>) {
        match message {
            Message::Request { id, method, params } => {
                let answer = self.request(&method, params);
                replies.push(match answer {
                    Ok(result) => json!({"jsonrpc": "2.0", "id": id, "result": result}),
                    Err(Refusal { code, message }) => refusal(id, code, message),
                });
            }
            Message::Notification { method, params } => {
                if let Err(why) = self.notification(&method, params, replies) {
                    replies.push(log(format!("`{method}` was not understood: {why}")));
                }
            }
            Message::Response => {}
            Message::Malformed(why) => {
                replies.push(log(why.clone()));
                replies.push(refusal(Id::Null, ErrorCodes::ParseError, why));
            }
        }
    }

    /// Takes the answer of a program.
    pub(super) fn arrived(&mut self, arrived: InterfaceReply, replies: &mut Vec<Reply>) {
        if let Err(why) = self.workspace.interfaces.take(arrived) {
            replies.push(show(why));
        }
        self.workspace.forget_all();
        self.published.is_stale = true;
        self.refresh_lenses(replies);
    }

    /// Takes the results of a proof, and makes the editor request them again.
    pub(super) fn proved(&mut self, arrived: ProofReply, replies: &mut Vec<Reply>) {
        if self.proofs.take(arrived) {
            self.refresh_lenses(replies);
        }
    }

    fn refresh_lenses(&self, replies: &mut Vec<Reply>) {
        if self.editor.refreshes_lenses {
            replies.push(json!({"jsonrpc": "2.0", "id": "lenses", "method": "workspace/codeLens/refresh"}));
        }
    }

    fn request(&mut self, method: &str, params: Value) -> Result<Value, Refusal> {
        match (self.state, method) {
            (State::Fresh, "initialize") => Ok(self.initialize(&params)),
            (State::Fresh, _) => Err(Refusal {
                code: ErrorCodes::ServerNotInitialized.into(),
                message: "`initialize` has to come first".to_owned(),
            }),
            (State::Ready, "shutdown") => {
                self.state = State::ShutDown;
                Ok(Value::Null)
            }
            (State::Ready, method) => self.answer(method, params),
            (State::ShutDown | State::Ended | State::Abandoned, _) => {
                Err(Refusal { code: ErrorCodes::InvalidRequest.into(), message: "the server is shut down".to_owned() })
            }
        }
    }

    fn initialize(&mut self, params: &Value) -> Value {
        self.editor = Editor::new(params);
        self.workspace.set_folders(&self.editor.folders);
        self.state = State::Ready;
        let encoding = if self.editor.encoding == Encoding::Utf8 { "utf-8" } else { "utf-16" };
        json!({
            "serverInfo": {"name": "dca", "version": env!("CARGO_PKG_VERSION")},
            "capabilities": {
                "positionEncoding": encoding,
                "textDocumentSync": {"openClose": true, "change": 2, "save": true},
                "completionProvider": {"triggerCharacters": [".", ",", "[", "("]},
                "hoverProvider": true,
                "definitionProvider": true,
                "referencesProvider": true,
                "documentHighlightProvider": true,
                "documentSymbolProvider": true,
                "documentFormattingProvider": true,
                "foldingRangeProvider": true,
                "renameProvider": {"prepareProvider": true},
                "codeLensProvider": {},
                "codeActionProvider": {"codeActionKinds": ["quickfix", "source.fixAll.dca"]},
                "semanticTokensProvider": {
                    "legend": {"tokenTypes": TOKEN_TYPES, "tokenModifiers": TOKEN_MODIFIERS},
                    "full": true,
                },
            },
        })
    }

    fn notification(&mut self, method: &str, params: Value, replies: &mut Vec<Reply>) -> Result<(), String> {
        if method == "exit" {
            self.state = if self.state == State::ShutDown { State::Ended } else { State::Abandoned };
            return Ok(());
        }
        if self.state != State::Ready {
            return Ok(());
        }
        self.published.is_stale = true;
        match method {
            "initialized" if self.editor.watches => replies.push(watch()),
            "textDocument/didOpen" => {
                let document = read::<DidOpenTextDocumentParams>(params)?.text_document;
                let opened = self.workspace.open(document.uri.0, document.version, document.text);
                replies.extend(opened.err().map(show));
            }
            "textDocument/didChange" => {
                let DidChangeTextDocumentParams { text_document, content_changes } = read(params)?;
                let uri = &text_document.text_document_identifier.uri.0;
                self.workspace.change(uri, text_document.version, content_changes, self.editor.encoding);
            }
            "textDocument/didClose" => {
                let closed: DidCloseTextDocumentParams = read(params)?;
                self.workspace.close(&closed.text_document.uri.0);
                self.proofs.forget(&closed.text_document.uri.0);
            }
            "textDocument/didSave" => self.workspace.forget_all(),
            "workspace/didChangeWatchedFiles" => {
                for change in read::<DidChangeWatchedFilesParams>(params)?.changes {
                    self.workspace.forget(&super::disk::path(&change.uri.0));
                }
            }
            _ => self.published.is_stale = false,
        }
        Ok(())
    }
}

/// Reads the parameters of a message.
pub(super) fn read<T: DeserializeOwned>(params: Value) -> Result<T, String> {
    serde_json::from_value(params).map_err(|error| error.to_string())
}

/// Returns the answer that a request is refused.
pub(super) fn refusal(id: Id, code: impl Into<i32>, message: impl Into<String>) -> Reply {
    let error = Error { code: ErrorCodes::from(code.into()), message: message.into(), data: None };
    value(&ResponseObject::from_error(id, error))
}

/// Returns a notification.
pub(super) fn notify<N: Notification>(params: N::Params) -> Reply {
    value(&RequestObject::from_notification::<N>(params))
}

/// Returns a line for the editor's log.
fn log(message: String) -> Reply {
    notify::<LogMessageNotification>(LogMessageParams { kind: MessageType::Warning, message })
}

/// Returns a line that the editor shows at once.
fn show(message: String) -> Reply {
    notify::<ShowMessageNotification>(ShowMessageParams { kind: MessageType::Warning, message })
}

/// Returns the request to report changes of specs on the disk.
fn watch() -> Reply {
    let options = json!({"watchers": [{"globPattern": "**/*.dca"}]});
    let registration = lsp_types::Registration {
        id: "specs".to_owned(),
        method: "workspace/didChangeWatchedFiles".to_owned(),
        register_options: serde_json::from_value(options).ok(),
    };
    let params = RegistrationParams { registrations: vec![registration] };
    value(&RequestObject::from_request::<RegistrationRequest>(Id::String("watch".to_owned()), params))
}

/// Converts a message to JSON. This cannot fail for types of the protocol.
fn value<T: serde::Serialize>(message: &T) -> Value {
    serde_json::to_value(message).unwrap_or_default()
}
