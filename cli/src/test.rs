//! `dca test`: checks whether the mistakes that `dca verify --test` has stored as files are in their specs again.

use crate::io::{named_file, whole_file};
use crate::logic::story_test::StoryTest;
use crate::verify::{LimitArgs, Loaded, Refusal, compiled};
use crate::{Controllers, check};
use anyhow::{Context as _, anyhow};
use language::{ReplayError, Source};
use node::console::{self, Failure};
use node::logic::table::counted;
use serde_json::json;
use std::path::{Path, PathBuf};
use verify::{Finding, PlayResult, Story, Verdict, told};

/// The file name extension of tests.
const EXTENSION: &str = "story";
/// The most files in a folder that are looked at.
const FILES_MAX: usize = 10_000;

/// The arguments of `dca test`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Files that `dca verify SPEC --test FOLDER` has written, or folders with them
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    limits: LimitArgs,
    #[command(flatten)]
    controllers: Controllers,
}

/// The result of a test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Passed,
    Failed,
    Open,
}

impl Outcome {
    /// Prints the result of a test.
    fn tell(self, test: &str, text: &str) -> Self {
        if console::is_json() {
            let outcome = match self {
                Self::Passed => "passed",
                Self::Failed => "failed",
                Self::Open => "open",
            };
            console::answer(&json!({ "test": test, "outcome": outcome, "text": text }));
            return self;
        }
        console::say(&match self {
            Self::Passed if text.is_empty() => format!("passed {test}\n"),
            Self::Passed => format!("passed {test} ({text})\n"),
            Self::Failed => format!("FAILED {test}: {text}"),
            Self::Open => format!("NOT DECIDED {test}: {text}"),
        });
        self
    }
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut outcomes = Vec::new();
    for file in files(&arguments.files)? {
        outcomes.push(one(&file, arguments)?);
    }
    if outcomes.is_empty() {
        return Err(anyhow!(
            "found no file with the ending `.{EXTENSION}`; `dca verify SPEC --test FOLDER` writes such files"
        )
        .into());
    }
    let count = |outcome| outcomes.iter().filter(|other| **other == outcome).count();
    let (failed, open) = (count(Outcome::Failed), count(Outcome::Open));
    let (tests, passed) = (counted(outcomes.len(), "test"), count(Outcome::Passed));
    if console::is_json() {
        console::answer(&json!({ "end": "complete", "passed": passed, "failed": failed, "open": open }));
    } else {
        console::say(&format!("{tests}: {passed} passed, {failed} failed, {open} not decided\n"));
    }
    match (failed, open) {
        (0, 0) => Ok(()),
        (0, _) => Err(Failure::Limited),
        (_, _) => Err(Failure::Reported),
    }
}

/// Returns the given files, and the tests in the given folders, sorted by name.
fn files(given: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for path in given {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let entries = std::fs::read_dir(path).with_context(|| format!("reading the folder `{}`", path.display()))?;
        let all = entries.take(FILES_MAX).flatten().map(|entry| entry.path());
        let mut own: Vec<PathBuf> = all.filter(|file| file.extension().is_some_and(|kind| kind == EXTENSION)).collect();
        own.sort();
        files.append(&mut own);
    }
    Ok(files)
}

/// Runs one test and prints its result.
fn one(file: &Path, arguments: &Arguments) -> Result<Outcome, Failure> {
    let name = file.display().to_string();
    let text =
        named_file::text(file, named_file::TEXT_MAX).with_context(|| format!("cannot read the test `{name}`"))?;
    let test = StoryTest::read(&text).map_err(|why| anyhow!("`{name}` is not a test: {why}"))?;
    let path = file.parent().unwrap_or_else(|| Path::new("")).join(&test.spec);
    let loaded = load(&test, &path, &arguments.controllers)?;
    let report = arguments.limits.with(|limits| verify::verify(&loaded.plan, &loaded.sites, limits));
    let played = test.script.as_ref().map(|script| script.play(&loaded.plan));
    let ends = played.as_ref().map(|played| &played.result);
    if let Some(PlayResult::Ends(error @ ReplayError::Unknown { .. })) = ends {
        let why = format!("it does not fit the spec: {error}; write it again with `dca verify --test`\n");
        return Ok(Outcome::Failed.tell(&name, &why));
    }
    match test.answer(&report.findings) {
        Some(finding) if finding.verdict == Verdict::Fails => {
            let again = match ends {
                Some(PlayResult::Same) => "it happens again in the same way",
                Some(
                    PlayResult::Other(_)
                    | PlayResult::Ends(ReplayError::Impossible { .. } | ReplayError::Unknown { .. }),
                ) => "it happens again in another way",
                // A story with a lost host cannot be played, so it is not known how the mistake comes about.
                Some(PlayResult::Ends(ReplayError::Unsupported { .. })) | None => "it happens again",
            };
            let story = told(finding, &loaded.spec, &loaded.interfaces, check::style());
            Ok(Outcome::Failed.tell(&name, &format!("{again}\n{story}")))
        }
        Some(_) => Ok(Outcome::Open.tell(&name, &format!("a limit was reached: {}\n", test.message))),
        None => {
            let how = match ends {
                Some(PlayResult::Ends(error)) => error.to_string(),
                Some(PlayResult::Other(how)) => how.clone(),
                Some(PlayResult::Same) | None => String::new(),
            };
            Ok(Outcome::Passed.tell(&name, &how))
        }
    }
}

/// Loads the spec. If it does not contain the sentence of the test any more, adds this sentence.
fn load(test: &StoryTest, path: &Path, controllers: &Controllers) -> Result<Loaded, Failure> {
    let spec = check::read(path)?;
    let loaded = compiled(spec.clone(), path, controllers, Refusal::Text)?;
    match &test.block {
        Some(block) if !test.is_stated(&loaded.plan, &loaded.sites) => {
            let text = format!("{}\n{block}\n", spec.text);
            compiled(Source::new(spec.name, text), path, controllers, Refusal::Text)
        }
        Some(_) | None => Ok(loaded),
    }
}

/// Writes a test for each finding that does not hold, and prints the names of the files.
pub(crate) fn write(folder: &Path, loaded: &Loaded, findings: &[Finding]) -> Result<(), Failure> {
    let fails: Vec<&Finding> = findings.iter().filter(|finding| finding.verdict == Verdict::Fails).collect();
    if fails.is_empty() {
        return Ok(());
    }
    std::fs::create_dir_all(folder).with_context(|| format!("making the folder `{}`", folder.display()))?;
    let spec = Path::new(&loaded.spec.name);
    let stem = spec.file_stem().map_or_else(|| "spec".to_owned(), |stem| stem.to_string_lossy().into_owned());
    let way = from(folder, spec);
    for (number, finding) in (1..).zip(fails) {
        let Some(test) = StoryTest::of(&way, finding, &loaded.plan, &loaded.sites) else { continue };
        let file = folder.join(format!("{stem}-{}-{number}.{EXTENSION}", test.code.to_lowercase()));
        let lines = finding.story.as_ref().map(Story::lines).unwrap_or_default();
        whole_file::put(&file, test.text(&lines).as_bytes()).context("writing a test")?;
        console::note(&format!("written: {}", file.display()));
    }
    Ok(())
}

/// Returns the path from a folder to a file. It is relative if both are inside the folder where the command runs.
fn from(folder: &Path, file: &Path) -> String {
    let is_plain = |path: &Path| {
        path.components().all(|part| matches!(part, std::path::Component::Normal(_) | std::path::Component::CurDir))
    };
    if !is_plain(folder) || !is_plain(file) {
        let whole = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
        return whole.display().to_string();
    }
    let up = folder.components().filter(|part| matches!(part, std::path::Component::Normal(_))).count();
    format!("{}{}", "../".repeat(up), file.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_to_the_spec_is_short() {
        for (folder, file, way) in
            [("tests", "cups.dca", "../cups.dca"), ("a/b", "specs/c.dca", "../../specs/c.dca"), (".", "c.dca", "c.dca")]
        {
            assert_eq!(from(Path::new(folder), Path::new(file)), way);
        }
        assert!(from(Path::new("/t"), Path::new("c.dca")).ends_with("/c.dca"));
    }
}
