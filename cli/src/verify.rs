//! `dca verify`: proves what holds of a spec in every order of events.

use crate::{Controllers, check};
use comms::io::clock;
use comms::logic::time::Time;
use language::plan::Plan;
use language::sites::Sites;
use language::{Severity, Source, compile_with_sites, render};
use node::console::{self, Failure};
use node::logic::table::counted;
use std::path::{Path, PathBuf};
use std::time::Duration;
use verify::{Finding, GoesOn, Limits, Report, Verdict};

/// As many states of one exploration are looked at, unless the command line says otherwise.
const STATES: u32 = 20_000_000;
/// As much memory may one exploration take, in MiB.
const MEMORY: usize = 2048;
/// As long may it take, in seconds.
const SECONDS: u64 = 600;

/// The arguments of `dca verify`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    #[command(flatten)]
    limits: LimitArgs,
    #[command(flatten)]
    controllers: Controllers,
}

/// What may be spent.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct LimitArgs {
    /// The most states of one exploration
    #[arg(long, value_name = "NUMBER", default_value_t = STATES)]
    states: u32,
    /// The most memory of one exploration, in MiB
    #[arg(long, value_name = "MIB", default_value_t = MEMORY)]
    memory: usize,
    /// The longest time of it all
    #[arg(long, value_name = "SECONDS", default_value_t = SECONDS)]
    seconds: u64,
}

/// The time until which something goes on.
#[derive(Debug)]
struct Until(Time);

impl GoesOn for Until {
    fn goes_on(&self) -> bool {
        clock::now() < self.0
    }
}

impl LimitArgs {
    /// Does something within the limits.
    pub(crate) fn with<T>(self, work: impl FnOnce(&Limits<'_>) -> T) -> T {
        let until = Until(clock::now() + Duration::from_secs(self.seconds));
        work(&Limits { states: self.states, memory: self.memory << 20, threads: 1, goes_on: &until })
    }
}

/// A spec with what a verifier needs.
pub(crate) struct Loaded {
    pub(crate) spec: Source,
    pub(crate) interfaces: Vec<Source>,
    pub(crate) plan: Plan,
    pub(crate) sites: Sites,
}

/// Reads and compiles a spec; of what there is to say about it only errors are said.
pub(crate) fn load(file: &Path, controllers: &Controllers) -> Result<Loaded, Failure> {
    let spec = check::read(file)?;
    let interfaces = check::others(&spec, controllers)?;
    let (compiled, sites) = compile_with_sites(&spec, &interfaces, &check::options(file, false));
    let Some((plan, sites)) = compiled.plan.zip(sites) else {
        let mut diagnostics = compiled.diagnostics;
        diagnostics.retain(|found| found.severity == Severity::Error);
        console::note(&render(&diagnostics, &spec, &interfaces, check::style()));
        return Err(Failure::Reported);
    };
    Ok(Loaded { spec, interfaces, plan, sites })
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let loaded = load(&arguments.file, &arguments.controllers)?;
    let report = arguments.limits.with(|limits| verify::verify(&loaded.plan, &loaded.sites, limits));
    console::say(&text(&loaded, &report));
    if report.findings.iter().any(|finding| finding.verdict == Verdict::Fails) {
        return Err(Failure::Reported);
    }
    if report.is_limited { Err(Failure::Limited) } else { Ok(()) }
}

/// The whole report for a person.
fn text(loaded: &Loaded, report: &Report) -> String {
    let mut text: String = report.findings.iter().map(|finding| of_finding(loaded, finding)).collect();
    let count = |verdict| report.findings.iter().filter(|finding| finding.verdict == verdict).count();
    text += "\nassumed:\n";
    report.assumptions.iter().for_each(|assumption| text += &format!("  {assumption}\n"));
    let file = &loaded.spec.name;
    let (proved, fails, open) = (count(Verdict::Proved), count(Verdict::Fails), count(Verdict::Open));
    let states = counted(usize::try_from(report.states).unwrap_or(usize::MAX), "state");
    text += &format!("{file}: {proved} proved, {fails} failed, {open} not decided, over {states}\n");
    text
}

fn of_finding(loaded: &Loaded, finding: &Finding) -> String {
    let Some(diagnostic) = &finding.diagnostic else {
        let word = if finding.verdict == Verdict::Proved { "proved" } else { "NOT DECIDED" };
        return format!("{word}: {}\n", finding.sentence);
    };
    let found = std::slice::from_ref(diagnostic);
    let mut text = format!("\n{}\n", render(found, &loaded.spec, &loaded.interfaces, check::style()).trim_end());
    if let Some(story) = &finding.story {
        text += "  how it comes to that:\n";
        story.lines().iter().for_each(|line| text += &format!("  {line}\n"));
    }
    text + "\n"
}
