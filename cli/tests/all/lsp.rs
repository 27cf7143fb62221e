//! The real `dca lsp`, spoken to as editors do.

mod editor;

use editor::Editor;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

/// A program that prints no interface.
const NOBODY: &str = "true";
const DOOR: &str = "process main() {
    // Größe 𝄞
    instantiated_processes { arm instof Arm(c1); }
    internal_event_actions { /* 𝄞 */ Arm }
}
";

fn codes(diagnostics: &[Value]) -> Vec<&str> {
    diagnostics.iter().filter_map(|it| it["code"].as_str()).collect()
}

fn at(uri: &str, line: u32, character: u32) -> Value {
    json!({"textDocument": {"uri": uri}, "position": {"line": line, "character": character}})
}

#[test]
fn what_is_wrong_is_told_for_each_version() {
    let mut editor = Editor::ready(NOBODY, &json!({}));
    let uri = "untitled:door";
    editor.open(uri, DOOR);
    editor.ask("textDocument/hover", &at(uri, 0, 0));
    // Without a program's answer there may be warnings to come; an edit brings the last word.
    let range = json!({"start": {"line": 3, "character": 38}, "end": {"line": 3, "character": 41}});
    editor.change(uri, 2, &json!({"range": range, "text": "x"}));
    let found = editor.diagnostics(uri, 2);
    assert!(codes(&found).contains(&"E0201"), "{found:?}");
    // The column counts UTF-16 units: the sign before it is two of them.
    let wrong = found.iter().find(|it| it["code"] == "E0201").unwrap();
    assert_eq!(wrong["range"]["start"], json!({"line": 3, "character": 38}));
    editor.change(
        uri,
        3,
        &json!({"range": {"start": {"line": 3, "character": 38}, "end": {"line": 3, "character": 39}}, "text": "arm"}),
    );
    assert!(!codes(&editor.diagnostics(uri, 3)).contains(&"E0201"));
    assert!(editor.end().success());
}

#[test]
fn fixes_names_and_forms_are_offered() {
    let mut editor = Editor::ready(NOBODY, &json!({"general": {"positionEncodings": ["utf-16", "utf-8"]}}));
    let uri = "untitled:door";
    editor.open(uri, DOOR);
    let column = u32::try_from(DOOR.lines().nth(3).unwrap().find("Arm").unwrap()).unwrap();
    let range = json!({"start": {"line": 3, "character": column}, "end": {"line": 3, "character": column + 1}});
    let asked = json!({"textDocument": {"uri": uri}, "range": range, "context": {"diagnostics": []}});
    let actions = editor.ask("textDocument/codeAction", &asked);
    let fix = &actions["result"][0];
    assert_eq!((&fix["title"], &fix["kind"]), (&json!("replace with `arm`"), &json!("quickfix")));
    assert_eq!(fix["edit"]["changes"][uri][0]["newText"], "arm");
    let mut renamed = at(uri, 3, column);
    renamed["newName"] = json!("hand");
    let edits = editor.ask("textDocument/rename", &renamed);
    assert_eq!(edits["result"]["changes"][uri].as_array().map(Vec::len), Some(2), "{edits}");
    renamed["newName"] = json!("a b");
    assert_eq!(editor.ask("textDocument/rename", &renamed)["error"]["code"], -32803);
    let formatted = editor.ask(
        "textDocument/formatting",
        &json!({"textDocument": {"uri": uri}, "options": {"tabSize": 4, "insertSpaces": true}}),
    );
    assert_eq!(formatted["result"].as_array().map(Vec::len), Some(1));
    assert!(editor.end().success());
}

/// A spec with a sentence that holds and one that does not.
const PROVED: &str = "module Step { done; }
process main() {
    host{c1}
    instantiated_processes { a instof Step(c1); b instof Step(c1); }
    internal_event_actions { a , b }
    verify { can finish; never a with b; }
}
";

#[test]
fn what_holds_stands_above_its_block() {
    let mut editor = Editor::ready(NOBODY, &json!({"workspace": {"codeLens": {"refreshSupport": true}}}));
    let uri = "untitled:proved";
    editor.open(uri, PROVED);
    let known = editor.lens(uri);
    assert_eq!(known["command"]["title"], "1 of 2 does not hold: never a with b", "{known}");
    assert_eq!(known["range"]["start"], json!({"line": 5, "character": 4}));
    let range = json!({"start": {"line": 4, "character": 31}, "end": {"line": 4, "character": 32}});
    editor.change(uri, 2, &json!({"range": range, "text": ";"}));
    let known = editor.lens(uri);
    assert_eq!(known["command"]["title"], "2 sentences hold", "{known}");
    assert!(editor.end().success());
}

/// The offered repair was verified: the sentence holds once it is applied.
#[test]
fn a_repair_that_was_verified_is_offered() {
    let mut editor = Editor::ready(NOBODY, &json!({"workspace": {"codeLens": {"refreshSupport": true}}}));
    let uri = "untitled:repaired";
    let text = PROVED.replace("a , b", "retry(2) (a ; b)").replace("never a with b", "a at most once");
    editor.open(uri, &text);
    let known = editor.lens(uri);
    assert_eq!(known["command"]["title"], "1 of 2 does not hold: a at most once", "{known}");
    let range = json!({"start": {"line": 4, "character": 30}, "end": {"line": 4, "character": 30}});
    let asked = json!({"textDocument": {"uri": uri}, "range": range, "context": {"diagnostics": []}});
    // The sentences that hold are reported before the repairs of the others are known.
    let mut actions = editor.ask("textDocument/codeAction", &asked);
    while actions["result"][0].is_null() {
        editor.until("workspace/codeLens/refresh");
        actions = editor.ask("textDocument/codeAction", &asked);
    }
    let action = &actions["result"][0];
    assert_eq!(action["title"], "try `b` again, and `a` only once (verified)", "{actions}");
    let edit = &action["edit"]["changes"][uri][0];
    assert_eq!(edit["newText"], "a ; retry(2) b", "{action}");
    editor.change(uri, 2, &json!({"range": edit["range"], "text": edit["newText"]}));
    assert_eq!(editor.lens(uri)["command"]["title"], "2 sentences hold");
    assert!(editor.end().success());
}

#[test]
fn remarks_that_are_not_shown_are_counted() {
    let mut editor = Editor::ready(NOBODY, &json!({}));
    let uri = "untitled:many";
    let names = (0..600).map(|index| format!("unknown{index}")).collect::<Vec<_>>().join(", ");
    let text = format!(
        "process main() {{ host{{c1}} instantiated_processes {{ arm instof Arm(c1); }} internal_event_actions {{ arm, {names} }} }}\n"
    );
    editor.open(uri, &text);
    let told = editor.diagnostics(uri, 1);
    let last = told[told.len() - 1]["message"].as_str().unwrap();
    assert!(told.len() == 501 && last.contains("more remarks on this file not shown here"), "{}: {last}", told.len());
    assert!(editor.end().success());
}

#[test]
fn nothing_that_is_said_ends_the_server() {
    let mut editor = Editor::start(NOBODY);
    assert_eq!(editor.ask("textDocument/hover", &at("a", 0, 0))["error"]["code"], -32002);
    editor.ask("initialize", &json!("no object"));
    assert_eq!(editor.ask("textDocument/hover", &at("a", 0, 0))["error"]["code"], -32803);
    assert_eq!(editor.ask("textDocument/hover", &json!([1]))["error"]["code"], -32602);
    assert_eq!(editor.ask("no/such", &Value::Null)["error"]["code"], -32601);
    editor.send_bytes(b"Content-Length: 2\r\n\r\n{]");
    assert_eq!(editor.read_next()["method"], "window/logMessage");
    let refused = editor.read_next();
    assert_eq!((&refused["error"]["code"], &refused["id"]), (&json!(-32700), &Value::Null));
    editor.notify("textDocument/didChange", &json!({"contentChanges": 5}));
    editor.notify("$/unknown", &json!({}));
    let uri = "untitled:a";
    editor.open(uri, DOOR);
    // Backwards, beyond the line, beyond the text.
    let far = json!({"start": {"line": 9, "character": 9}, "end": {"line": 2, "character": u32::MAX}});
    editor.change(uri, 2, &json!({"range": far, "text": "é"}));
    assert!(editor.ask("textDocument/completion", &at(uri, 99, 99)).get("result").is_some());
    editor.open("untitled:long", &" ".repeat((2 << 20) + 1));
    let told = editor.diagnostics("untitled:long", 1);
    assert!(told[0]["message"].as_str().unwrap().contains("more than 2 MiB"));
    assert_eq!(editor.ask("textDocument/hover", &at("untitled:long", 0, 0))["error"]["code"], -32803);
    editor.ask("shutdown", &Value::Null);
    assert_eq!(editor.ask("textDocument/hover", &at(uri, 0, 0))["error"]["code"], -32600);
    assert_eq!(editor.vanish().code(), Some(1));
}

#[test]
fn files_are_taken_from_the_editor_before_the_disk() {
    let folder = std::env::temp_dir().join(format!("dca-lsp-test-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let arm = folder.join("arm ä.dca");
    std::fs::write(&arm, "module Arm(host) { done; }").unwrap();
    let uri = |path: &Path| format!("file://{}", path.to_string_lossy().replace(' ', "%20").replace('ä', "%C3%A4"));
    let (door, arm) = (uri(&folder.join("door.dca")), uri(&arm));
    let mut editor = Editor::ready(NOBODY, &json!({}));
    editor.open(&door, "use \"arm ä.dca\";\nprocess main() { instantiated_processes { a instof Arm(c1); } internal_event_actions { a } }");
    let known = editor.ask("textDocument/definition", &at(&door, 1, 53));
    assert_eq!(known["result"]["uri"], json!(arm), "{known}");
    // In the editor, the module takes one more argument: that is wrong in the file that uses it.
    editor.open(&arm, "module Arm(host, speed) { done; }");
    editor.change(
        &door,
        2,
        &json!({"range": {"start": {"line": 0, "character": 0}, "end": {"line": 0, "character": 0}}, "text": " "}),
    );
    assert!(codes(&editor.diagnostics(&door, 2)).contains(&"E0210"));
    let mut renamed = at(&arm, 0, 8);
    renamed["newName"] = json!("Hand");
    let edits = editor.ask("textDocument/rename", &renamed);
    assert_eq!(edits["result"]["changes"].as_object().map(serde_json::Map::len), Some(2), "{edits}");
    editor.notify("textDocument/didClose", &json!({"textDocument": {"uri": arm}}));
    editor.change(
        &door,
        3,
        &json!({"range": {"start": {"line": 0, "character": 0}, "end": {"line": 0, "character": 1}}, "text": ""}),
    );
    assert!(!codes(&editor.diagnostics(&door, 3)).contains(&"E0210"));
    assert!(editor.end().success());
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_folder_is_known_when_a_file_comes_into_it() {
    let folder = std::env::temp_dir().join(format!("dca-lsp-folder-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("parts")).unwrap();
    std::fs::write(folder.join("parts/arm.dca"), "module Arm(host) { done; }").unwrap();
    let door = format!("file://{}", folder.join("door.dca").display());
    let mut editor = Editor::ready(NOBODY, &json!({}));
    let text = "use \"parts\";\nprocess main() { instantiated_processes { a instof Arm(c1); b instof Leg(c1); } internal_event_actions { a , b } }";
    editor.open(&door, text);
    let place = |name: &str| at(&door, 1, u32::try_from(text.lines().nth(1).unwrap().find(name).unwrap()).unwrap());
    assert!(
        editor.ask("textDocument/definition", &place("Arm"))["result"]["uri"].as_str().unwrap().ends_with("arm.dca")
    );
    assert_eq!(editor.ask("textDocument/definition", &place("Leg"))["result"], Value::Null);
    std::fs::write(folder.join("parts/leg.dca"), "module Leg(host) { done; }").unwrap();
    let leg = format!("file://{}", folder.join("parts/leg.dca").display());
    editor.notify("workspace/didChangeWatchedFiles", &json!({"changes": [{"uri": leg, "type": 1}]}));
    assert_eq!(editor.ask("textDocument/definition", &place("Leg"))["result"]["uri"], json!(leg));
    assert!(editor.end().success());
    std::fs::remove_dir_all(folder).unwrap();
}

/// A name ends in `.dca`, and belongs to a pipe without a writer, or to a device without an end.
#[test]
fn what_is_no_regular_file_holds_nobody_up() {
    let folder = std::env::temp_dir().join(format!("dca-lsp-pipe-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    assert!(Command::new("mkfifo").arg(folder.join("a pipe.dca")).status().unwrap().success());
    std::os::unix::fs::symlink("/dev/zero", folder.join("endless.dca")).unwrap();
    let door = format!("file://{}", folder.join("door.dca").display());
    let mut editor = Editor::ready(NOBODY, &json!({}));
    let text =
        "use \".\";\nprocess main() { instantiated_processes { a instof Arm(c1); } internal_event_actions { a } }";
    editor.open(&door, text);
    let found = editor.diagnostics(&door, 1);
    let unread: Vec<&str> =
        found.iter().filter(|it| it["code"] == "E0010").filter_map(|it| it["message"].as_str()).collect();
    assert_eq!(unread.len(), 2, "{found:?}");
    assert!(unread[0].contains("it is a pipe; only regular files are read"), "{unread:?}");
    let column = u32::try_from(text.lines().nth(1).unwrap().find("a instof").unwrap()).unwrap();
    let mut asked = at(&door, 1, column);
    asked["context"] = json!({"includeDeclaration": true});
    // All specs of the folder are looked through for the name.
    let uses = editor.ask("textDocument/references", &asked);
    assert_eq!(uses["result"].as_array().map(Vec::len), Some(2), "{uses}");
    assert!(editor.end().success());
    std::fs::remove_dir_all(folder).unwrap();
}

/// Makes a program that prints this interface. Another process writes it: a file that is still open here could not be
/// run.
fn tells(program: &Path, interface: &str) {
    let script =
        "printf '#!/bin/sh\\ncat <<X\\n%s\\nX\\n' \"$1\" > \"$0.new\" && chmod +x \"$0.new\" && mv \"$0.new\" \"$0\"";
    let made = Command::new("sh").args(["-c", script]).arg(program).arg(interface).status();
    assert!(made.expect("there is a shell").success());
}

/// A program is asked during typing, and again when it was rebuilt.
#[test]
fn programs_tell_their_interfaces() {
    let folder = std::env::temp_dir().join(format!("dca-lsp-programs-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let program = folder.join("arms");
    tells(&program, "module Arm(host) { done; }");
    let mut editor = Editor::ready(&program.to_string_lossy(), &json!({}));
    let uri = "untitled:door";
    editor.open(uri, DOOR);
    // Warnings are published when the program has answered.
    while !codes(&editor.diagnostics(uri, 1)).contains(&"W0201") {}
    let told = editor.ask("textDocument/hover", &at(uri, 2, 31));
    assert!(told["result"]["contents"]["value"].as_str().unwrap().contains("ends by itself"), "{told}");
    let shown = editor.ask("textDocument/definition", &at(uri, 2, 42));
    let file = shown["result"]["uri"].as_str().unwrap().trim_start_matches("file://").to_owned();
    assert!(std::fs::read_to_string(&file).unwrap().contains("module Arm"), "{file}");
    tells(&program, "module Arm(host, speed) { done; }");
    editor.change(uri, 2, &json!({"text": format!("{DOOR} ")}));
    while !codes(&editor.diagnostics(uri, 2)).contains(&"E0210") {}
    assert!(editor.end().success());
    assert!(!Path::new(&file).exists(), "{file}");
    std::fs::remove_dir_all(folder).unwrap();
}

/// Every file of the corpus is opened, edited, asked about and closed.
#[test]
fn every_file_of_the_corpus_is_edited() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../language/tests/corpus");
    let mut paths: Vec<PathBuf> = std::fs::read_dir(corpus).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "dca"));
    let mut editor = Editor::ready(NOBODY, &json!({}));
    for path in paths {
        let text = std::fs::read_to_string(&path).unwrap();
        let uri = format!("untitled:{}", path.file_stem().unwrap().to_string_lossy());
        editor.open(&uri, &text);
        let line = u32::try_from(text.lines().count() / 2).unwrap();
        let range = json!({"start": {"line": line, "character": 0}, "end": {"line": line + 1, "character": 3}});
        editor.change(&uri, 2, &json!({"range": range, "text": "process ;; é ["}));
        let document = json!({"textDocument": {"uri": uri}});
        for asked in ["documentSymbol", "semanticTokens/full", "foldingRange"] {
            let answer = editor.ask(&format!("textDocument/{asked}"), &document);
            assert!(answer.get("result").is_some(), "{uri}: {answer}");
        }
        for asked in ["hover", "completion", "definition", "documentHighlight"] {
            let answer = editor.ask(&format!("textDocument/{asked}"), &at(&uri, line, 12));
            assert!(answer.get("result").is_some(), "{uri}: {answer}");
        }
        editor.notify("textDocument/didClose", &document);
    }
    assert!(editor.end().success());
}
