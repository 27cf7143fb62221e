//! Every bad spec is caught with the reason in its expected file; no good spec is refused.

use language::{Code, Options, Source, Style, compile_with_sites, render};
use std::fs;
use std::path::{Path, PathBuf};
use verify::{Alone, Always, Faults, Limits, Report, Verdict};

const LIMITS: Limits<'static> = Limits { states: 2_000_000, memory: 1 << 30, threads: &Alone, goes_on: &Always };

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The specs of a folder, by name.
fn specs(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("the folder of specs is there");
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("it can be read").path()).collect();
    files.retain(|file| file.extension().is_some_and(|kind| kind == "dca"));
    files.sort();
    files
}

/// Verifies a spec; returns the result.
fn verified(spec: &Source, interfaces: &[Source]) -> Option<(Report, String)> {
    let (compiled, sites) = compile_with_sites(spec, interfaces, &Options::named("spec"));
    let (plan, sites) = compiled.plan.zip(sites)?;
    let report = verify::verify(&plan, &sites, &LIMITS);
    let mut text = String::new();
    for finding in &report.findings {
        match &finding.diagnostic {
            None if finding.verdict == Verdict::Proved => {}
            None => text += &format!("not decided: {}\n", finding.sentence),
            Some(diagnostic) => {
                text += &render(std::slice::from_ref(diagnostic), spec, interfaces, Style::Plain);
                for line in finding.story.iter().flat_map(verify::Story::lines) {
                    text += &format!("{line}\n");
                }
            }
        }
    }
    Some((report, text))
}

fn read(file: &Path) -> Source {
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    Source::new(name, fs::read_to_string(file).expect("the spec can be read"))
}

#[test]
fn every_bad_spec_is_caught_with_its_reason() {
    let files = specs(&root().join("verify/tests/corpus/bad"));
    assert!(files.len() >= 25, "only {} bad specs", files.len());
    for file in files {
        let (report, text) = verified(&read(&file), &[]).unwrap_or_else(|| panic!("{} has no plan", file.display()));
        let fails = report.findings.iter().any(|finding| finding.verdict == Verdict::Fails);
        assert!(fails, "{} is not caught", file.display());
        expect_test::expect_file![file.with_extension("txt")].assert_eq(&text);
    }
}

#[test]
fn no_good_spec_is_refused() {
    let files = specs(&root().join("verify/tests/corpus/good"));
    assert!(files.len() >= 25, "only {} good specs", files.len());
    for file in files {
        let (report, text) = verified(&read(&file), &[]).unwrap_or_else(|| panic!("{} has a plan", file.display()));
        assert!(text.is_empty(), "{}:\n{text}", file.display());
        assert!(!report.is_limited, "{}", file.display());
    }
}

/// Returns the interfaces that the controllers of this package print.
fn library() -> Vec<Source> {
    vec![read(&root().join("language/tests/graph/door_opening.interface"))]
}

#[test]
fn the_specs_of_this_repository_are_not_refused() {
    let folders =
        ["specs", "examples/machines", "examples/patrol", "examples/pid", "examples/python", "examples/serial"];
    let mut count = 0;
    for file in folders.iter().flat_map(|folder| specs(&root().join(folder))) {
        let Some((_, text)) = verified(&read(&file), &library()) else { continue };
        assert!(text.is_empty(), "{}:\n{text}", file.display());
        count += 1;
    }
    assert!(count >= 5, "only {count} have a plan");
}

/// The manual's table for the door is the output of `dca fmea --markdown`.
#[test]
fn the_faults_of_the_door_are_those_of_the_manual() {
    let spec = read(&root().join("specs/door_opening.dca"));
    let (compiled, sites) = compile_with_sites(&spec, &library(), &Options::named("door_opening"));
    let (plan, sites) = compiled.plan.zip(sites).expect("the door has a plan");
    let table = verify::fmea(&plan, &sites, &LIMITS, Faults::One);
    assert!(table.unfinished.is_empty(), "{:?}", table.unfinished);
    let page = format!(
        "# Every single fault of the door\n\n`dca fmea specs/door_opening.dca --markdown` prints this table. \
         [Proofs before the run](verify.md#what-each-fault-does) explains its columns.\n\n{}",
        table.markdown()
    );
    expect_test::expect_file![root().join("docs/src/verify_door.md")].assert_eq(&page);
}

#[test]
fn what_nothing_runs_is_not_said_to_be_started() {
    let spec = Source::new(
        "spec.dca",
        "module Step { done; }
        process main(){
            host{c1}
            instantiated_processes{ a instof Step(c1); spare instof Step(c1); }
            internal_event_actions{ a }
        }",
    );
    let (report, _) = verified(&spec, &[]).expect("it has a plan");
    let said = "every process is started in some order of events, but for `spare`, which nothing runs";
    assert!(report.findings.iter().any(|found| found.sentence == said), "{:?}", report.findings);
}

/// The verifier divides so many operands with limits into pieces. It still finds the contents of a member group, in
/// the piece that runs the group.
const LARGE: &str = "
module Step { done; }
process Arm(){
    host{c1}
    instantiated_processes{ grasp instof Step(c1); }
    internal_event_actions{ grasp }
}
process main(){
    host{c1}
    instantiated_processes{
        left instof Arm(); right instof Arm();
        a instof Step(c1); b instof Step(c1); c instof Step(c1); d instof Step(c1);
    }
    internal_event_actions{
        (left within 4 s), (right within 5 s), (a within 6 s), (b within 7 s), (c within 8 s), (d within 9 s)
    }
    verify{
        never left.grasp with right.grasp;
        holds ltl \"G !left.grasp\";
        right.grasp only after left.grasp.done;
        after left.grasp.done: right.grasp stopped;
        on crash of a: never left.grasp.done;
    }
}";

#[test]
fn what_is_inside_a_member_of_a_large_group_is_found() {
    let (report, _) = verified(&Source::new("spec.dca", LARGE), &[]).expect("it has a plan");
    let sentences: Vec<_> = report.findings.iter().filter(|found| found.place.is_some()).collect();
    assert_eq!(sentences.len(), 5);
    for found in sentences {
        assert_eq!(found.verdict, Verdict::Fails, "{}", found.sentence);
    }
}

/// If a limit leaves a question open, the question is undecided for the surrounding groups as well.
#[test]
fn a_limit_refuses_no_good_spec() {
    let good = specs(&root().join("verify/tests/corpus/good")).into_iter().chain(specs(&root().join("specs")));
    for file in good {
        let spec = read(&file);
        let (compiled, sites) = compile_with_sites(&spec, &library(), &Options::named("spec"));
        let Some((plan, sites)) = compiled.plan.zip(sites) else { continue };
        for states in [1, 10, 25, 50, 100, 200, 400] {
            let report = verify::verify(&plan, &sites, &Limits { states, ..LIMITS });
            assert!(report.is_limited || states > 5, "{} with {states} states", file.display());
            let refused = report.findings.iter().find(|finding| finding.verdict == Verdict::Fails);
            assert!(refused.is_none(), "{} with {states} states: {refused:?}", file.display());
        }
    }
}

/// The specs in the manual are good ones. The exceptions are specs that show what is refused, and the pages about
/// `dca verify` itself.
#[test]
fn specs_of_the_manual_are_not_refused() {
    let mut count = 0;
    let pages = fs::read_dir(root().join("docs/src")).expect("the manual is there");
    let mut pages: Vec<PathBuf> = pages.map(|page| page.expect("it can be read").path()).collect();
    pages.retain(|page| {
        page.extension().is_some_and(|kind| kind == "md")
            && !page.ends_with("verify.md")
            && !page.ends_with("first_proof.md")
    });
    pages.sort();
    for page in pages {
        let text = fs::read_to_string(&page).expect("the page can be read");
        for rest in text.split("\n```dca").skip(1) {
            let Some((marks, body)) = rest.split_once('\n') else { continue };
            let block = body.split("\n```").next().unwrap_or_default();
            if marks.contains("refused") || marks.contains("actions") {
                continue;
            }
            let spec = Source::new("spec.dca", block);
            let (compiled, _) = compile_with_sites(&spec, &library(), &Options::named("spec"));
            // The page shows that `dca check` warns of this spec.
            if compiled.diagnostics.iter().any(|found| [Code::W0306, Code::W0310].contains(&found.code)) {
                continue;
            }
            let Some((_, text)) = verified(&spec, &library()) else { continue };
            assert!(text.is_empty(), "{}:\n{block}\n{text}", page.display());
            count += 1;
        }
    }
    assert!(count >= 5, "only {count} blocks have a plan");
}

/// A story can also be drawn, and the picture is always the same.
#[test]
fn stories_are_drawn() {
    for name in ["lock_cycle", "formula_goes_round"] {
        let file = root().join("verify/tests/corpus/bad").join(format!("{name}.dca"));
        let (report, _) = verified(&read(&file), &[]).expect("it has a plan");
        let story = report.findings.iter().find_map(|finding| Some((finding, finding.story.as_ref()?)));
        let (finding, story) = story.expect("it has a story");
        expect_test::expect_file![file.with_extension("svg")].assert_eq(&story.svg(&finding.sentence));
    }
}

/// The page for newcomers shows the exact output: each `$ dca verify FILE` is about the spec before it.
#[test]
fn the_manual_shows_what_is_printed() {
    let page = root().join("docs/src/verify.md");
    let text = fs::read_to_string(&page).expect("the page can be read");
    let (mut made, mut spec, mut shown) = (String::new(), String::new(), 0);
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        made += &format!("{line}\n");
        if !line.starts_with("```") {
            continue;
        }
        let mut block: Vec<&str> = Vec::new();
        while let Some(line) = lines.next().filter(|line| !line.starts_with("```")) {
            block.push(line);
        }
        let content = block.iter().map(|line| format!("{line}\n")).collect::<String>();
        match block.first().and_then(|first| first.strip_prefix("$ dca verify ")) {
            Some(name) => {
                let source = Source::new(name, spec.clone());
                let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("spec"));
                let (plan, sites) = compiled.plan.zip(sites).expect("the spec of the page has a plan");
                let report = verify::verify(&plan, &sites, &LIMITS);
                let printed = report.text(&source, &[], Style::Plain);
                made += &format!("$ dca verify {name}\n{}\n", printed.trim());
                shown += 1;
            }
            None if line.starts_with("```dca") => {
                made += &content;
                spec = content;
            }
            None => made += &content,
        }
        made += "```\n";
    }
    assert!(shown > 0, "nothing is shown");
    expect_test::expect_file![page].assert_eq(&made);
}
