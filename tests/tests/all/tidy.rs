//! The rules of this project that the compiler does not check: permitted imports, pure folders, and the place for each thing.
//!
//! Each test reads the sources as text, and names every line that breaks its rule. `docs/src/inside/invariants.md` lists the
//! rules.

mod glossary;
mod inside;
mod named;
mod shapes;
mod sources;

use sources::{Source, Strings, files, room, root, sources, without_comments};
use std::collections::BTreeSet;
use std::fs;

/// The length of the longest file, without its tests.
const LINES_MAX: usize = 600;
/// The greatest number of lines in the database's core, without blank lines and tests. A quarter of them are documentation.
const CORE_LINES_MAX: usize = 5400;
/// The rooms that each room may import. `dca-tests` comes last, and no room may import it.
const FLOORS: [(&str, &[&str]); 17] = [
    ("ros", &[]),
    ("ros/bridge", &["comms", "controllers", "ros"]),
    ("language", &["ros"]),
    ("import", &["language", "ros"]),
    ("verify", &["language"]),
    ("comms", &[]),
    ("trust", &[]),
    ("team", &["comms", "trust"]),
    ("dbmanager", &["comms"]),
    ("controllers", &["comms", "ros", "team"]),
    // Only the tests of `node` use `verify`. They compare the records of a supervisor.
    ("node", &["comms", "dbmanager", "language", "shim", "team", "trust", "verify"]),
    ("node/shim", &["comms"]),
    ("view", &["comms", "dbmanager", "language", "node"]),
    ("cli", &["comms", "dbmanager", "import", "language", "node", "ros", "shim", "team", "trust", "verify", "view"]),
    ("python", &["comms", "controllers", "language", "ros"]),
    ("examples", &["controllers"]),
    ("tests", &["cli", "comms", "controllers", "dbmanager", "language", "node", "team", "trust", "verify"]),
];
/// Every room, by its name in imports.
const ROOMS: [&str; 15] = [
    "import",
    "language",
    "ros",
    "bridge",
    "verify",
    "comms",
    "trust",
    "team",
    "dbmanager",
    "controllers",
    "node",
    "shim",
    "view",
    "cli",
    "dca_tests",
];
/// All folders and files where the same input has to result in the same output, in addition to every `logic`.
const PURE: [&str; 10] = [
    "import/src/",
    "language/src/",
    "verify/src/",
    "controllers/src/control",
    "controllers/src/library",
    "controllers/src/message",
    "controllers/src/robot",
    "controllers/src/sdk/",
    "trust/src/",
    "view/src/",
];
/// Parts of the pure folders that talk to the outside. `nested` instead keeps a count for each thread while it reads.
const IMPURE: [&str; 2] = ["controllers/src/sdk/process", "language/src/plan/nested"];
/// Words that pure code never contains. `std::{` would hide the others.
const HIDDEN_INPUTS: [&str; 21] = [
    "Instant",
    "SystemTime",
    "std::fs",
    "std::net",
    "std::thread",
    "std::process",
    "std::env",
    "std::{",
    "tokio",
    "zenoh",
    "rustix",
    "HashMap",
    "HashSet",
    "static mut",
    "thread_local",
    "OnceLock",
    "LazyLock",
    "AtomicU64",
    "AtomicBool",
    "stdin",
    "rand::",
];
/// Strings that look like key expressions, but are names of encodings.
const NO_KEYS: [&str; 4] = ["dca/refused", "dca/here", "dca/end", "dca/broken"];

/// Returns whether `word` is in `line` as a whole word.
fn names(line: &str, word: &str) -> bool {
    let part = |character: char| character.is_alphanumeric() || character == '_';
    line.match_indices(word).any(|(at, _)| {
        let before = line[..at].chars().next_back().is_some_and(part);
        let after = line[at + word.len()..].chars().next().is_some_and(part);
        !(before && word.starts_with(part) || after && word.ends_with(part))
    })
}

/// Returns the lines of `sources` for which `breaks` returns a reason.
fn broken<'a>(
    sources: impl IntoIterator<Item = &'a Source>,
    strings: Strings,
    breaks: impl Fn(&Source, &str) -> Option<String>,
) -> Vec<String> {
    let mut broken = Vec::new();
    for source in sources {
        for (number, line) in source.code(strings) {
            broken.extend(breaks(source, &line).map(|why| format!("{}:{number}: {why}", source.path)));
        }
    }
    broken
}

#[track_caller]
fn check(rule: &str, broken: &[String]) {
    assert!(broken.is_empty(), "{rule}\n  {}\n", broken.join("\n  "));
}

/// Returns the entries in those tables of a manifest whose names end with `dependencies`.
fn dependencies(manifest: &str) -> Vec<String> {
    let mut inside = false;
    let mut names = Vec::new();
    for line in manifest.lines() {
        if line.starts_with('[') {
            inside = line.trim_end_matches(']').ends_with("dependencies");
        } else if inside && !line.starts_with('#') {
            names.extend(line.split(['.', '=', ' ']).next().filter(|name| !name.is_empty()).map(str::to_owned));
        }
    }
    names
}

#[test]
fn imports_only_go_down() {
    let mut wrong = Vec::new();
    for (folder, allowed) in FLOORS {
        let Ok(manifest) = fs::read_to_string(root().join(folder).join("Cargo.toml")) else { continue };
        let rooms = dependencies(&manifest).into_iter().map(|name| name.replace('-', "_"));
        let rooms = rooms.filter(|name| ROOMS.contains(&name.as_str()) && !allowed.contains(&name.as_str()));
        wrong.extend(rooms.map(|room| format!("{folder}/Cargo.toml: `{folder}` must not depend on `{room}`")));
    }
    let all = sources();
    wrong.extend(broken(&all, Strings::Emptied, |source, line| {
        // The programs from `dca new` belong to their users.
        let (folder, _) = room(&source.path).filter(|_| !source.path.starts_with("cli/templates/"))?;
        let (_, allowed) = FLOORS.iter().find(|(name, _)| *name == folder)?;
        let path = line.trim().trim_start_matches("pub ").strip_prefix("use ")?;
        let room = path.split([':', ';', ' ']).next()?;
        let own = folder.ends_with(room) || room == "dca_tests" && folder == "tests";
        let wrong = ROOMS.contains(&room) && !own && !allowed.contains(&room);
        wrong.then(|| format!("`{folder}` must not import `{room}`"))
    }));
    check(
        "imports go down: node → dbmanager → comms, node → language, node → shim → comms, controllers → comms",
        &wrong,
    );
}

#[test]
fn inside_a_room_logic_knows_no_io_and_io_no_command_line() {
    let wrong = broken(&sources(), Strings::Emptied, |source, line| {
        let within = |layer: &str| {
            source.path.contains(&format!("/src/{layer}/")) || source.path.ends_with(&format!("/src/{layer}.rs"))
        };
        let upward = |above: &str| line.contains(&format!("crate::{above}"));
        let io = within("logic") && (upward("io") || upward("cli"));
        (io || within("io") && upward("cli")).then(|| line.trim().to_owned())
    });
    check("cli → io → logic, never the other way", &wrong);
}

#[test]
fn logic_has_no_hidden_input() {
    let all = sources();
    let pure: Vec<&Source> = all.iter().filter(|source| source.is_pure()).collect();
    assert!(pure.len() > 30, "only {} pure files were found: do the folders have other names now?", pure.len());
    let wrong = broken(pure, Strings::Emptied, |_, line| {
        let word = HIDDEN_INPUTS.iter().find(|word| names(line, word))?;
        Some(format!("names `{word}`"))
    });
    check("pure code has no clock, socket, file, thread, global, random source or hash order", &wrong);
}

#[test]
fn files_are_short_and_stand_beside_their_folder() {
    let mut wrong = Vec::new();
    for source in sources() {
        let length = source.length();
        if length > LINES_MAX {
            wrong.push(format!("{}: {length} lines without tests, of {LINES_MAX}", source.path));
        }
        if source.path.ends_with("/mod.rs") {
            wrong.push(format!("{}: `foo.rs` + `foo/`, never `mod.rs`", source.path));
        }
    }
    check("a file is one idea", &wrong);
}

#[test]
fn the_core_of_the_database_is_small() {
    let is_core = |source: &&Source| {
        let path = source.path.strip_prefix("dbmanager/src/logic/").unwrap_or("view");
        source.is_shipped() && !path.starts_with("view") && !path.ends_with("tests.rs")
    };
    let lines = |source: &Source| source.text.lines().take(source.length()).filter(|line| !line.is_empty()).count();
    let count: usize = sources().iter().filter(is_core).map(lines).sum();
    assert!((3000..CORE_LINES_MAX).contains(&count), "{count} lines with documentation, without views");
}

/// Checks that only code in `places` contains one of `words`.
#[track_caller]
fn only_in(rule: &str, places: &[&str], words: &[&str]) {
    let all = sources();
    for place in places {
        let there = all.iter().any(|source| source.path.starts_with(place));
        assert!(there, "`{place}` is not there any more: mend this test");
    }
    let others =
        all.iter().filter(|source| source.is_shipped() && !places.iter().any(|place| source.path.starts_with(place)));
    let wrong = broken(others, Strings::Emptied, |_, line| {
        // Asking whether an output is a terminal is not printing.
        let line = line.replace("stderr().is_terminal", "");
        words.iter().find(|word| names(&line, word)).map(|word| format!("names `{word}`"))
    });
    check(rule, &wrong);
}

#[test]
fn one_place_opens_zenoh() {
    let bridge = "ros/bridge/src/io";
    let places = ["comms/src/io/session", "comms/src/io/data", bridge];
    only_in("only the sessions of comms, and the bridge to ROS 2, name zenoh", &places, &["zenoh::"]);
    let places = ["comms/src/io/session", bridge];
    only_in("only one place opens a session of zenoh, and the bridge one with its router", &places, &["zenoh::open"]);
}

#[test]
fn one_place_reads_a_clock() {
    let words = ["Instant::now", "SystemTime", "clock_gettime", "UNIX_EPOCH"];
    only_in("only the clock of comms reads a clock", &["comms/src/io/clock.rs"], &words);
}

#[test]
fn one_place_names_the_engine_of_the_store() {
    only_in("only the store on redb names redb", &["dbmanager/src/io/store/on_redb.rs"], &["redb::"]);
    only_in("only the store on sled names sled", &["dbmanager/src/io/store/on_sled.rs"], &["sled::"]);
}

#[test]
fn every_answer_in_json_is_one_line() {
    let words = [concat!("to_string", "_pretty"), concat!("document", ":#}")];
    let sources = sources().into_iter().filter(|source| source.path.starts_with("cli/src/"));
    let pretty = sources.flat_map(|source| words.map(|word| (source.path.clone(), source.text.contains(word))));
    let pretty: Vec<String> = pretty.filter(|(_, is_there)| *is_there).map(|(path, _)| path).collect();
    check("`console::answer` alone writes an answer in JSON, on one line", &pretty);
}

#[test]
fn one_place_of_each_program_prints() {
    let places =
        ["cli/src/output.rs", "node/src/console.rs", "node/shim/src/main.rs", "controllers/src/sdk/process.rs"];
    let words = ["println!", "print!", "eprintln!", "eprint!", "dbg!", "stdout()", "stderr()"];
    only_in("only `output` prints, and the one place of the shim and of a controller", &places, &words);
}

/// `comms::logic::human::span` prints durations, and paths stand between backticks.
#[test]
fn people_read_no_debug_text() {
    let all = sources();
    let rooms = ["comms/src", "controllers/src", "node/src", "view/src", "cli/src"];
    let of_rooms =
        all.iter().filter(|source| source.is_shipped() && rooms.iter().any(|room| source.path.starts_with(room)));
    let wrong = broken(of_rooms, Strings::Kept, |_, line| {
        let is_for_programmers = ["assert", "panic!", "expect(", "unreachable!"].iter().any(|word| line.contains(word));
        (line.contains(":?}") && !is_for_programmers).then(|| line.trim().to_owned())
    });
    check("what people read is not what `Debug` prints", &wrong);
}

#[test]
fn docs_are_more_than_a_question() {
    let questions = ["Which", "What", "How", "Why", "When", "Where", "Who", "Whose", "Whom"];
    let asks = |line: &str| {
        let word = line.trim_start().strip_prefix("/// ").and_then(|doc| doc.strip_suffix('.'));
        word.is_some_and(|word| questions.contains(&word))
    };
    let mut wrong = Vec::new();
    for source in sources().into_iter().filter(Source::is_shipped) {
        let lines = source.text.lines().enumerate().filter(|(_, line)| asks(line));
        wrong.extend(lines.map(|(index, line)| format!("{}:{}: {}", source.path, index + 1, line.trim())));
    }
    check("a doc names the thing: \"The program.\", not \"Which.\"", &wrong);
}

#[test]
fn one_place_builds_keys() {
    let all = sources();
    let others = all.iter().filter(|source| source.is_shipped() && source.path != "comms/src/logic/key.rs");
    let key = ["\"dca", "/"].concat();
    let wrong = broken(others, Strings::Kept, |_, line| {
        let line = NO_KEYS.iter().fold(line.to_owned(), |line, other| line.replace(other, ""));
        line.contains(&key).then(|| line.trim().to_owned())
    });
    check("key expressions are built and parsed in comms/src/logic/key.rs alone", &wrong);
}

#[test]
fn no_two_messages_are_of_one_kind() {
    let (mut seen, mut wrong) = (BTreeSet::new(), Vec::new());
    for source in sources().iter().filter(|source| source.is_shipped()) {
        for (number, line) in source.code(Strings::Emptied) {
            let Some((_, kind)) = line.split_once("const KIND: ").filter(|(_, kind)| kind.contains('=')) else {
                continue;
            };
            let is_of_the_table = kind.starts_with("Kind = Kind::");
            if !is_of_the_table || !seen.insert(kind.to_owned()) {
                wrong.push(format!("{}:{number}: {}", source.path, line.trim()));
            }
        }
    }
    check("a kind of message is a name of the table in comms/src/logic/codec.rs, and of one type", &wrong);
    assert!(seen.len() > 10, "{seen:?}");
}

#[test]
fn no_destructor_kills() {
    let mut wrong = Vec::new();
    for source in sources().iter().filter(|source| source.is_shipped()) {
        let mut inside = false;
        for (number, line) in source.code(Strings::Emptied) {
            // The code is formatted, so a block ends with a brace below its beginning.
            inside =
                (inside || line.starts_with("impl") && names(&line, "Drop") && line.contains(" for ")) && line != "}";
            let sends = ["kill", "pidfd_send_signal", "Signal", "terminate"].iter().find(|word| line.contains(**word));
            wrong.extend(sends.filter(|_| inside).map(|word| format!("{}:{number}: names `{word}`", source.path)));
        }
    }
    check("no `Drop` sends a signal: what ends a program is a decision", &wrong);
}

#[test]
fn every_spec_is_used_by_a_test() {
    let all = sources();
    let tests: Vec<&Source> = all.iter().filter(|source| !source.path.ends_with("tidy.rs")).collect();
    let specs = files().into_iter().filter(|(path, _)| path.starts_with("specs/") && path.ends_with(".dca"));
    let used = |path: &str| tests.iter().any(|test| test.text.contains(path));
    let unused: Vec<String> = specs.map(|(path, _)| path).filter(|path| !used(path)).collect();
    check("each spec is a test: it is compiled, verified, formatted and run", &unused);
}

#[test]
fn every_dependency_has_its_reason() {
    let reasons = fs::read_to_string(root().join("docs/src/inside/dependencies.md")).expect("the page is there");
    let manifest = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let ours: BTreeSet<&str> = ROOMS.into_iter().collect();
    let missing = dependencies(&manifest).into_iter().filter(|name| !ours.contains(name.replace('-', "_").as_str()));
    let missing: Vec<String> = missing.filter(|name| !reasons.contains(&format!("`{name}`"))).collect();
    check(
        "each crate in [workspace.dependencies] has a line in docs/src/inside/dependencies.md: its purpose and the reason",
        &missing,
    );
}

#[test]
fn nothing_names_somebody_s_machine() {
    let homes = [["/ho", "me/"], ["/ro", "ot/"], ["/Us", "ers/"], ["C:\\", "Users"]].map(|parts| parts.concat());
    let mut wrong = Vec::new();
    for (path, file) in files() {
        let Ok(text) = fs::read_to_string(file) else { continue };
        for (index, line) in text.lines().enumerate() {
            let number = index + 1;
            if let Some(home) = homes.iter().find(|home| line.contains(home.as_str())) {
                wrong.push(format!("{path}:{number}: an absolute path in `{home}`"));
            }
            let source = line.trim().strip_prefix("source = ").filter(|_| path == "Cargo.lock");
            if source.is_some_and(|source| !source.starts_with("\"registry+")) {
                wrong.push(format!("{path}:{number}: a crate that comes from no registry"));
            }
            let config = path.starts_with(".cargo/") || path.ends_with("Cargo.toml");
            let foreign = ["[source", "[registr", "registry =", "replace-with", "index ="];
            if config && foreign.iter().any(|word| line.trim().starts_with(word)) {
                wrong.push(format!("{path}:{number}: a registry of one's own"));
            }
        }
    }
    check("what is committed works on every machine", &wrong);
}
