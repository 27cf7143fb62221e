//! A scripted editor for the real `dca lsp`.

use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};

/// An editor and its server.
pub(crate) struct Editor {
    /// The server.
    pub(crate) server: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    requests: i64,
}

impl Editor {
    /// Starts a server; it asks `controllers` for interfaces.
    pub(crate) fn start(controllers: &str) -> Self {
        let mut server = Command::new(env!("CARGO_BIN_EXE_dca"))
            .args(["lsp", "--controllers", controllers])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .expect("the program was built for this test");
        let input = server.stdin.take().expect("it is piped");
        let output = BufReader::new(server.stdout.take().expect("it is piped"));
        Self { server, input, output, requests: 0 }
    }

    /// Starts a server and announces the capabilities of this editor.
    pub(crate) fn ready(controllers: &str, capabilities: &Value) -> Self {
        let mut editor = Self::start(controllers);
        editor.ask("initialize", &json!({"capabilities": capabilities}));
        editor.notify("initialized", &json!({}));
        editor
    }

    /// Sends bytes unchanged.
    pub(crate) fn send_bytes(&mut self, bytes: &[u8]) {
        self.input.write_all(bytes).and_then(|()| self.input.flush()).expect("the server reads");
    }

    /// Sends one message.
    pub(crate) fn send(&mut self, message: &Value) {
        let body = message.to_string();
        self.send_bytes(format!("Content-Length: {}\r\n\r\n{body}", body.len()).as_bytes());
    }

    /// Tells the server something.
    pub(crate) fn notify(&mut self, method: &str, params: &Value) {
        self.send(&json!({"jsonrpc": "2.0", "method": method, "params": params}));
    }

    /// Reads one message of the server.
    pub(crate) fn read(&mut self) -> Value {
        let mut length = 0;
        loop {
            let mut line = String::new();
            self.output.read_line(&mut line).expect("the server answers");
            match line.trim().split_once(": ") {
                Some((_, value)) => length = value.parse().expect("a length is a number"),
                None if line.trim().is_empty() && length > 0 => break,
                None => panic!("the server ended"),
            }
        }
        let mut body = vec![0; length];
        self.output.read_exact(&mut body).expect("the server says it all");
        serde_json::from_slice(&body).expect("a message is JSON")
    }

    /// Reads on to a message of this method.
    pub(crate) fn until(&mut self, method: &str) {
        while self.read()["method"] != method {}
    }

    /// The title above the first block of a document to prove, once it is known.
    pub(crate) fn lens(&mut self, uri: &str) -> Value {
        loop {
            let mut answer = self.ask("textDocument/codeLens", &json!({"textDocument": {"uri": uri}}));
            let lens = answer["result"][0].take();
            if lens["command"]["title"] != "being proved …" {
                return lens;
            }
            self.until("workspace/codeLens/refresh");
        }
    }

    /// Reads the next message, without those about programs, which come after each answer of a program.
    pub(crate) fn read_next(&mut self) -> Value {
        loop {
            let message = self.read();
            if message["method"] != "window/showMessage" {
                return message;
            }
        }
    }

    /// Sends the server a request; skips other messages until the answer.
    pub(crate) fn ask(&mut self, method: &str, params: &Value) -> Value {
        self.requests += 1;
        let id = self.requests;
        self.send(&json!({"jsonrpc": "2.0", "id": id, "method": method, "params": params}));
        loop {
            let message = self.read();
            if message["id"] == id && message.get("method").is_none() {
                return message;
            }
        }
    }

    /// Opens a document.
    pub(crate) fn open(&mut self, uri: &str, text: &str) {
        let document = json!({"uri": uri, "languageId": "dca", "version": 1, "text": text});
        self.notify("textDocument/didOpen", &json!({"textDocument": document}));
    }

    /// Changes a document; without a range all of it.
    pub(crate) fn change(&mut self, uri: &str, version: i64, change: &Value) {
        let document = json!({"uri": uri, "version": version});
        self.notify("textDocument/didChange", &json!({"textDocument": document, "contentChanges": [change]}));
    }

    /// Reads until the server publishes the diagnostics of a version of a document.
    pub(crate) fn diagnostics(&mut self, uri: &str, version: i64) -> Vec<Value> {
        loop {
            let message = self.read();
            let params = &message["params"];
            let is_it = message["method"] == "textDocument/publishDiagnostics" && params["uri"] == uri;
            if is_it && params["version"] == version {
                return params["diagnostics"].as_array().cloned().unwrap_or_default();
            }
        }
    }

    /// Shuts the server down like an editor.
    pub(crate) fn end(mut self) -> ExitStatus {
        self.ask("shutdown", &Value::Null);
        self.notify("exit", &Value::Null);
        self.server.wait().expect("the server ends")
    }

    /// Goes away without a word.
    pub(crate) fn vanish(self) -> ExitStatus {
        let Self { mut server, input, .. } = self;
        drop(input);
        server.wait().expect("the server ends")
    }
}
