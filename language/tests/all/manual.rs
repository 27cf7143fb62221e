//! The statements of the manual in `docs/` are true.
//!
//! Every block of its pages that is marked `dca` is checked, formatted and simulated; every drawing and every answer of
//! `dca check` is made again and compared; the chapter on diagnostics is written by this test. `UPDATE_EXPECT=1` writes
//! all of it into the pages:
//!
//! ```text
//! UPDATE_EXPECT=1 cargo test -p language --test all manual::
//! ```
//!
//! The first line of a block defines its kind:
//! - ` ```dca ` a whole spec; with a name (` ```dca,touch.dca `) later blocks of the page can refer to it; with `refused`
//!   it has errors;
//! - ` ```dca,actions ` event actions alone, whose processes are made up: those in [`SERVICES`] never end;
//! - ` ```sim ` what happens in a simulation of the spec before, a line each, as `dca sim` reads it;
//! - ` ```console ` a command and what it answers: the answer of `dca check` is compared.
//!
//! A picture after a `sim` block is the chart of that simulation, any other the graph of the spec before.

use crate::disk;

use language::ide::Analysis;
use language::syntax::{SyntaxKind, lex};
use language::{Code, Compiled, Options, RandomRun, Severity, Simulation, Source, Style};
use language::{compile, format, gather, graph, render};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Processes of event actions that never end; all others do.
const SERVICES: [&str; 4] = ["sensor", "camera", "drive", "logger"];
/// Words of event actions that name no process.
const WORDS: [&str; 24] = [
    "skip", "never", "fail", "wait", "else", "within", "retry", "pause", "any", "at", "least", "of", "all", "race",
    "each", "in", "match", "shield", "using", "i", "finally", "as", "repeat", "until",
];
/// Remarks on meaningless code: no spec of the manual deserves one.
const MISTAKES: [Code; 5] = [Code::W0311, Code::W0403, Code::W0405, Code::W0406, Code::W0407];
/// Runs by chance of each spec.
const SEEDS: u64 = 5;

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/src")
}

fn pages() -> Vec<PathBuf> {
    let mut pages = files(&docs(), "md");
    pages.extend(files(&docs().join("from"), "md"));
    pages
}

fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder of files");
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.retain(|path| path.extension().is_some_and(|found| found == extension));
    files.sort();
    files
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns the interfaces of the paper's controllers, as their program prints them.
fn interfaces() -> Vec<Source> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/graph/door_opening.interface");
    vec![Source::new("dca-controller", read(&path))]
}

/// One page while it is read.
#[derive(Default)]
struct Page {
    name: String,
    /// The page as it should be.
    text: String,
    specs: BTreeMap<String, Source>,
    last: Option<Source>,
    script: Option<String>,
    drawings: BTreeMap<String, String>,
}

impl Page {
    fn read(name: &str, text: &str) -> Self {
        let mut page = Self { name: name.to_owned(), ..Self::default() };
        let mut lines = text.lines();
        while let Some(line) = lines.next() {
            page.text += &format!("{line}\n");
            if let Some(info) = line.strip_prefix("```") {
                let body: String =
                    lines.by_ref().take_while(|line| *line != "```").map(|line| format!("{line}\n")).collect();
                let body = page.block(&info.split(',').collect::<Vec<_>>(), body);
                page.text += &format!("{body}```\n");
            } else if let Some((_, rest)) = line.split_once("](drawings/") {
                let (drawing, _) = rest.split_once(')').expect("a picture has a path");
                page.drawing(drawing);
            }
        }
        page
    }

    fn block(&mut self, info: &[&str], body: String) -> String {
        match info {
            ["dca", "actions"] => self.actions(&body),
            ["dca", marks @ ..] => self.spec(marks, &body),
            ["sim"] => {
                self.script = Some(body.clone());
                body
            }
            ["console"] => self.console(body),
            [_, ..] | [] => body,
        }
    }

    fn spec(&mut self, marks: &[&str], body: &str) -> String {
        let name = marks.iter().find(|mark| mark.ends_with(".dca")).copied().unwrap_or("spec.dca");
        let written = Source::new(name, body);
        let is_refused = marks.contains(&"refused");
        let formatted = match format(&written) {
            Ok(formatted) => formatted,
            Err(_) if is_refused => body.to_owned(),
            Err(found) => panic!("{}: {name} cannot be read: {found:?}", self.name),
        };
        let spec = Source::new(name, &*formatted);
        let Compiled { plan, diagnostics, .. } = compile(&spec, &interfaces(), &Options::named("manual"));
        let said = render(&diagnostics, &spec, &interfaces(), Style::Plain);
        assert_eq!(plan.is_none(), is_refused, "{}: {name}\n{formatted}\n{said}", self.name);
        let is_noise = diagnostics.iter().any(|found| MISTAKES.contains(&found.code));
        assert!(!is_noise, "{}: {name} is meant as it is:\n{formatted}\n{said}", self.name);
        simulate(&self.name, &spec);
        self.specs.insert(name.to_owned(), spec.clone());
        (self.last, self.script) = (Some(spec), None);
        formatted
    }

    /// Event actions alone: a group around them is made up.
    fn actions(&mut self, body: &str) -> String {
        let mut text = String::new();
        let members = members(body);
        for member in &members {
            let kind = if SERVICES.contains(&member.as_str()) { "service" } else { "done" };
            text += &format!("module {}(host: Host) {{ {kind}; }}\n", type_name(member));
        }
        text += "process main(){ host{c1} instantiated_processes{\n";
        for member in &members {
            text += &format!("{member} instof {}(c1);\n", type_name(member));
        }
        text += &format!("}} internal_event_actions{{\n{body}\n}} }}\n");
        let formatted = self.spec(&["actions.dca"], &text);
        let (_, inside) = formatted.split_once("internal_event_actions{\n").expect("a section of event actions");
        let (inside, _) = inside.rsplit_once("\n    }\n}").expect("its end, and that of the group");
        inside.lines().map(|line| format!("{}\n", line.strip_prefix("        ").unwrap_or(line))).collect()
    }

    /// A command and its answer; of commands other than `dca check` the answer stays.
    fn console(&self, body: String) -> String {
        let first = body.lines().next().unwrap_or_default();
        let Some(name) = first.strip_prefix("$ dca check ") else { return body };
        let spec = self.specs.get(name).unwrap_or_else(|| panic!("{}: no spec {name}", self.name));
        format!("{first}\n{}", check(spec))
    }

    fn drawing(&mut self, name: &str) {
        let spec = self.last.as_ref().unwrap_or_else(|| panic!("{}: {name} has no spec", self.name));
        let picture = match &self.script {
            Some(script) => chart(&self.name, spec, script),
            None => graph(spec, &interfaces(), &Options::named("manual")).0.expect("a good spec").svg(),
        };
        self.drawings.insert(name.to_owned(), picture);
    }
}

/// The names of processes in event actions, each once.
fn members(actions: &str) -> BTreeSet<String> {
    let tokens: Vec<(SyntaxKind, &str)> = lex(actions)
        .iter()
        .filter(|token| !token.kind.is_trivia())
        .map(|token| (token.kind, &actions[token.start as usize..token.end as usize]))
        .collect();
    let is_process = |&index: &usize| {
        let (kind, text) = tokens[index];
        let before = index.checked_sub(1).map(|before| tokens[before].0);
        let after = tokens.get(index + 1).map(|after| after.0);
        kind == SyntaxKind::Ident
            && !WORDS.contains(&text)
            && before != Some(SyntaxKind::Number)
            && before != Some(SyntaxKind::LeftBracket)
            && index.checked_sub(1).is_none_or(|before| tokens[before].1 != "as")
            && after != Some(SyntaxKind::FatArrow)
    };
    (0..tokens.len()).filter(is_process).map(|index| tokens[index].1.to_owned()).collect()
}

fn type_name(member: &str) -> String {
    member[..1].to_uppercase() + &member[1..]
}

/// Returns the output of `dca check`.
fn check(spec: &Source) -> String {
    let Compiled { plan, diagnostics, .. } = compile(spec, &interfaces(), &Options::named("manual"));
    let mut said = render(&diagnostics, spec, &interfaces(), Style::Plain);
    let count = |severity| diagnostics.iter().filter(|found| found.severity == severity).count();
    let plural = |count: usize, word| format!("{count} {word}{}", if count == 1 { "" } else { "s" });
    let (errors, warnings) = (count(Severity::Error), count(Severity::Warning));
    if errors + warnings > 0 {
        said += &format!("{}: {}, {}\n", spec.name, plural(errors, "error"), plural(warnings, "warning"));
    }
    if let Some(plan) = plan {
        let (groups, programs) = (plural(plan.groups.len(), "group"), plural(plan.leaves.len(), "program"));
        said += &format!("{}: {groups}, {programs}, on {}: no errors\n", spec.name, plan.hosts.join(", "));
    }
    said
}

/// A good spec runs by chance, and in any state a stop ends it.
fn simulate(page: &str, spec: &Source) {
    let Some(plan) = compile(spec, &interfaces(), &Options::named("manual")).plan else { return };
    assert_eq!(plan.validate(), Ok(()), "{page}");
    for seed in 0..SEEDS {
        let mut simulation = Simulation::start(&plan);
        let mut chance = RandomRun::new(&plan, seed, 10 * seed);
        let mut steps = 0..200;
        while simulation.outcome().is_none() && steps.next().is_some() && chance.step(&mut simulation) {}
        if simulation.outcome().is_none() {
            simulation.stop();
            // Shielded members end by themselves, or their time is over.
            while simulation.outcome().is_none() && chance.step(&mut simulation) {}
        }
        assert!(simulation.outcome().is_some(), "{page}: {} cannot be stopped", spec.text);
        assert_eq!(simulation.running(), [""; 0], "{page}: {}", spec.text);
    }
}

fn chart(page: &str, spec: &Source, script: &str) -> String {
    let plan = compile(spec, &interfaces(), &Options::named("manual")).plan.expect("a good spec");
    let mut simulation = Simulation::start(&plan);
    for line in script.lines() {
        simulation.obey(line).unwrap_or_else(|error| panic!("{page}: {error}\n{}\n{script}", spec.text));
    }
    simulation.chart()
}

#[test]
fn every_page_is_as_it_should_be() {
    let mut drawings = BTreeSet::new();
    for path in pages() {
        let page = Page::read(&path.to_string_lossy(), &read(&path));
        expect_test::expect_file![&path].assert_eq(&page.text);
        for (name, picture) in page.drawings {
            let path = docs().join("drawings").join(&name);
            assert!(drawings.insert(path.clone()), "two pictures are called {name}");
            expect_test::expect_file![&path].assert_eq(&picture);
        }
    }
    let lost: Vec<PathBuf> =
        files(&docs().join("drawings"), "svg").into_iter().filter(|path| !drawings.contains(path)).collect();
    assert!(lost.is_empty(), "no page shows {lost:?}");
}

#[test]
fn every_page_is_listed_and_every_link_leads_somewhere() {
    let summary = read(&docs().join("SUMMARY.md"));
    for path in
        pages().into_iter().chain(["database", "inside"].iter().flat_map(|part| files(&docs().join(part), "md")))
    {
        let name = path.strip_prefix(docs()).expect("it is a page of the manual").to_string_lossy().into_owned();
        assert!(name == "SUMMARY.md" || summary.contains(&format!("({name})")), "{name} is not in the summary");
        for link in read(&path).split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(link, _)| link) {
            let (file, place) = link.split_once('#').unwrap_or((link, ""));
            let beside = path.parent().expect("a page is in a folder");
            let target = if file.is_empty() { path.clone() } else { beside.join(file) };
            let is_there =
                file.contains("://") || target.exists() && (place.is_empty() || places(&target).contains(place));
            assert!(is_there, "{name}: `{link}` leads nowhere");
        }
    }
}

/// Returns the anchors of the headings of a page.
fn places(page: &Path) -> BTreeSet<String> {
    let text = read(page);
    let headings = text.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    let letters = |heading: &str| -> String {
        let kept = heading.to_lowercase().replace(' ', "-");
        kept.chars().filter(|c| c.is_alphanumeric() || ['-', '_'].contains(c)).collect()
    };
    headings.map(letters).collect()
}

/// The grammar has the words that the editors know.
#[test]
fn the_grammar_has_the_words_that_editors_colour() {
    let colours = Path::new(env!("CARGO_MANIFEST_DIR")).join("../editors/vscode/syntaxes/dca.tmLanguage.json");
    let colours = read(&colours).replace("\\\\b", " ");
    let known: BTreeSet<&str> = colours.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
    let grammar = read(&docs().join("grammar.md"));
    // The words of sentences, such as `at`, have a colour only inside of `verify` blocks: the language server knows where.
    let grammar = grammar.split("## Properties").next().unwrap_or_default();
    let quoted = grammar.split("```").skip(1).step_by(2).flat_map(|block| block.split('"').skip(1).step_by(2));
    let words: BTreeSet<&str> = quoted.filter(|word| word.starts_with(|c: char| c.is_ascii_lowercase())).collect();
    let unknown: Vec<&&str> = words.iter().filter(|word| !known.contains(**word)).collect();
    assert!(words.len() > 30 && unknown.is_empty(), "{unknown:?} of {words:?}");
}

#[test]
fn every_diagnostic_has_its_chapter() {
    let examples = examples();
    let mut text = "# Diagnostics\n\n\
        These are the messages of `dca check`. `dca explain E0201` prints one of them. A code never changes its meaning; the \
        examples are files of the test suite.\n"
        .to_owned();
    for (severity, title) in [(Severity::Error, "Errors: the spec is refused"), (Severity::Warning, "Warnings")] {
        text += &format!("\n## {title}\n");
        for code in Code::ALL.iter().copied().filter(|code| code.severity() == severity) {
            text += &format!("\n### {code}: {}\n\n{}\n", code.title(), code.explanation());
            if let Some(example) = examples.get(&code) {
                text += &format!("\n```text\n{example}\n```\n");
            }
        }
    }
    expect_test::expect_file![docs().join("diagnostics.md")].assert_eq(&text);
}

/// For each code the shortest remark in the corpus.
fn examples() -> BTreeMap<Code, String> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus");
    let mut shortest: BTreeMap<Code, String> = BTreeMap::new();
    for path in files(&corpus, "dca") {
        let spec = Source::new("spec.dca", read(&path));
        let mut others = gather(&spec, &|path| disk::content(&corpus.join(path)));
        let interface = path.with_extension("interface");
        others.extend(interface.exists().then(|| Source::new("controllers", read(&interface))));
        for found in compile(&spec, &others, &Options::named("spec")).diagnostics {
            let text = render(std::slice::from_ref(&found), &spec, &others, Style::Plain).trim_end().to_owned();
            let best = shortest.entry(found.code).or_insert_with(|| text.clone());
            if text.len() < best.len() {
                *best = text;
            }
        }
    }
    shortest
}

#[test]
fn every_section_of_a_group_is_listed() {
    let page = read(&docs().join("groups.md"));
    let rows = page.lines().filter_map(|line| line.strip_prefix("| [`")?.split('`').next());
    let text = "process main(){ }";
    let analysis = Analysis::new(Source::new("a.dca", text), Vec::new(), &Options::named("a"));
    let (_, offers) = analysis.complete(text.len() - 1);
    let sections: BTreeSet<&str> = offers.iter().map(|offer| offer.label.trim()).collect();
    assert_eq!(rows.collect::<BTreeSet<_>>(), sections);
}

/// The README and the list of examples give the number of programs that open the door.
#[test]
fn the_programs_of_the_door_are_counted() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let spec = Source::new("door_opening.dca", read(&root.join("specs/door_opening.dca")));
    let plan = compile(&spec, &interfaces(), &Options::named("door_opening")).plan.expect("the spec has no errors");
    let told = format!("{} programs", plan.leaves.len());
    for page in ["README.md", "docs/src/examples.md"] {
        assert!(read(&root.join(page)).contains(&told), "{page} does not say {told:?}");
    }
}
