//! `dca verify`: proves the properties of a spec for every order of events.

mod repair;

use crate::check::json::diagnostic;
use crate::follow::Spec;
use crate::io::{named_file, whole_file};
use crate::work::Work;
use crate::{Controllers, Values, check};
use anyhow::{Context as _, anyhow};
use comms::io::clock;
use comms::logic::human::size;
use comms::logic::time::Time;
use language::plan::{Expression, Group, Plan};
use language::sites::Sites;
use language::{Code, Severity, Source, Texts, compile_with_sites, render};
use node::console::{self, Failure};
use serde_json::{Value, json};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Duration;
use verify::{Assumption, Became, Finding, GoesOn, Limits, Report, Story, Threads, Verdict, WorkDone, told};

/// The most states in one exploration, unless the user sets another limit.
const STATES: u32 = 20_000_000;
/// The most memory of one exploration, in MiB, unless the user sets another limit.
const MEMORY: usize = 2048;
/// The longest time in seconds, unless the user sets another limit.
const SECONDS: u64 = 600;
/// More threads are of no use.
const THREADS_MAX: usize = 64;

/// The arguments of `dca verify`.
#[derive(Clone, Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    /// Print the report as one JSON document
    #[arg(long)]
    json: bool,
    /// Print the spec for other tools instead, without reductions: all states and transitions (Aldebaran, Graphviz), or a model
    /// that a tool explores itself (JANI, mCRL2)
    #[arg(long, value_name = "FORMAT", conflicts_with = "json")]
    export: Option<Export>,
    /// Draw the story of the first failure, a lane for each process; nothing is written if everything holds
    #[arg(long, value_name = "FILE", conflicts_with = "export")]
    svg: Option<PathBuf>,
    /// Show edits that repair failing properties; each was verified before it is shown
    #[arg(long, conflicts_with_all = ["json", "export", "set"])]
    fix: bool,
    /// Write these edits into the spec
    #[arg(long, requires = "fix")]
    write: bool,
    /// Write a test for each finding that does not hold: a file with its story, which `dca test` and `dca sim --replay` take
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["export", "set"])]
    test: Option<PathBuf>,
    #[command(flatten)]
    limits: LimitArgs,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    values: Values,
}

/// The formats of transition systems and of models.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Export {
    Aut,
    Dot,
    Jani,
    Mcrl2,
}

/// The limits of a verification.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct LimitArgs {
    /// The most states of one exploration
    #[arg(long, value_name = "NUMBER", default_value_t = STATES)]
    states: u32,
    /// The most memory of one exploration, in MiB
    #[arg(long, value_name = "MIB", default_value_t = MEMORY)]
    memory: usize,
    /// The longest time of the whole verification
    #[arg(long, value_name = "SECONDS", default_value_t = SECONDS)]
    seconds: u64,
    /// How many threads verify; without it, one for each core
    #[arg(long, value_name = "NUMBER")]
    threads: Option<NonZeroUsize>,
}

/// Whether a spec has to be proved before it runs.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Proof {
    /// Run the spec only if `dca verify` proves everything about it, with its usual limits
    #[arg(long)]
    require_verified: bool,
}

impl Proof {
    /// Refuses a spec if a sentence fails or is not decided within the limits. Checks the texts in memory and reads no
    /// file again. So the text that runs is the text that was proved.
    pub(crate) fn require(self, spec: &Spec) -> Result<(), Failure> {
        if !self.require_verified {
            return Ok(());
        }
        let (file, texts) = (&spec.file, spec.modules.split_first());
        let (own, interfaces) = texts.ok_or_else(|| anyhow!("`{}` has no text", file.display()))?;
        let (compiled, sites) = compile_with_sites(own, interfaces, &check::options(file, false));
        let (plan, sites) = compiled.plan.zip(sites).ok_or(Failure::Reported)?;
        let limits = LimitArgs { states: STATES, memory: MEMORY, seconds: SECONDS, threads: None };
        let report = limits.with(|limits| verify::verify(&plan, &sites, limits));
        let unproved = report.findings.iter().filter(|finding| finding.verdict != Verdict::Proved);
        unproved.for_each(|finding| console::note(&told(finding, own, interfaces, check::style())));
        if report.findings.iter().any(|finding| finding.verdict == Verdict::Fails) {
            return Err(anyhow!("nothing was started: `dca verify {}` finds what does not hold", file.display()).into());
        }
        if report.is_limited { Err(Failure::Limited) } else { Ok(()) }
    }
}

/// The time when the work has to end, and its progress, which a person sees.
#[derive(Debug)]
struct Until {
    time: Time,
    work: Work,
}

impl GoesOn for Until {
    fn goes_on(&self) -> bool {
        clock::now() < self.time
    }

    fn hear(&self, done: WorkDone) {
        match done {
            WorkDone::Jobs { what, done, of } => self.work.jobs(what, done, of),
            WorkDone::States(count) => self.work.states(count),
        }
    }
}

/// Computes with this many threads.
#[derive(Debug)]
struct Cores(usize);

impl Threads for Cores {
    fn count(&self) -> usize {
        self.0
    }

    fn run(&self, work: &(dyn Fn(usize) + Sync)) {
        std::thread::scope(|scope| {
            for thread in 1..self.0 {
                // The result does not depend on the number of threads. If no more threads can be started, the present ones continue.
                if std::thread::Builder::new().spawn_scoped(scope, move || work(thread)).is_err() {
                    break;
                }
            }
            work(0);
        });
    }
}

impl LimitArgs {
    /// Does some work within the limits.
    pub(crate) fn with<T>(self, work: impl FnOnce(&Limits<'_>) -> T) -> T {
        let until = Until { time: clock::now() + Duration::from_secs(self.seconds), work: Work::new() };
        let threads = self.threads.or_else(|| std::thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get);
        let (threads, memory) = (Cores(threads.min(THREADS_MAX)), self.memory.saturating_mul(1 << 20));
        work(&Limits { states: self.states, memory, threads: &threads, goes_on: &until })
    }
}

/// A compiled spec, with its sites for the verifier.
pub(crate) struct Loaded {
    pub(crate) spec: Source,
    pub(crate) interfaces: Vec<Source>,
    pub(crate) plan: Plan,
    pub(crate) sites: Sites,
    /// Whether the spec uses a module whose interface is not known.
    pub(crate) lacks_interfaces: bool,
}

/// The form in which the refusal of a spec is reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refusal {
    /// To a person.
    Text,
    /// As a JSON document on standard output: `{"version", "spec", "refused": [diagnostic]}`.
    Json,
}

/// Reads and compiles a spec. Of its diagnostics, only errors are printed.
pub(crate) fn load(
    file: &Path,
    controllers: &Controllers,
    values: &Values,
    refusal: Refusal,
) -> Result<Loaded, Failure> {
    compiled(check::read_with(file, values)?, file, controllers, refusal)
}

/// Compiles the text of a spec. `file` is the file that the text comes from.
pub(crate) fn compiled(
    spec: Source,
    file: &Path,
    controllers: &Controllers,
    refusal: Refusal,
) -> Result<Loaded, Failure> {
    let interfaces = check::others(&spec, controllers)?;
    let (compiled, sites) = compile_with_sites(&spec, &interfaces, &check::options(file, false));
    let lacks_interfaces = compiled.diagnostics.iter().any(|found| found.code == Code::W0205);
    let Some((plan, sites)) = compiled.plan.zip(sites) else {
        let mut diagnostics = compiled.diagnostics;
        diagnostics.retain(|found| found.severity == Severity::Error);
        if refusal == Refusal::Json {
            let texts = Texts::new(&spec, &interfaces);
            let refused: Vec<Value> = diagnostics.iter().map(|found| diagnostic(found, &texts)).collect();
            let document = json!({ "version": 1, "spec": spec.name, "refused": refused });
            console::answer(&document);
        } else {
            console::note(&render(&diagnostics, &spec, &interfaces, check::style()));
        }
        return Err(Failure::Reported);
    };
    Ok(Loaded { spec, interfaces, plan, sites, lacks_interfaces })
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(picture) = &arguments.svg {
        named_file::not_over(picture, [arguments.file.as_path()])?;
    }
    let refusal = if arguments.json { Refusal::Json } else { Refusal::Text };
    // The edits are written into the text of the spec file, so they are proved for this text.
    let is_own = arguments.fix || arguments.test.is_some();
    let values = if is_own { arguments.values.without_defaults() } else { arguments.values.clone() };
    let loaded = load(&arguments.file, &arguments.controllers, &values, refusal)?;
    if let Some(format) = arguments.export {
        return export(&loaded, arguments.limits, format);
    }
    let start = clock::now();
    let report = arguments.limits.with(|limits| verify::verify(&loaded.plan, &loaded.sites, limits));
    let took = clock::now().since(start);
    let fails = report.findings.iter().any(|finding| finding.verdict == Verdict::Fails);
    if arguments.json {
        console::answer(&json(&loaded, &report));
    } else if !(fails && arguments.fix) {
        console::say(&report.text(&loaded.spec, &loaded.interfaces, check::style()));
        console::note(&effort(&report, took));
    }
    let story = report.findings.iter().find_map(|finding| Some((finding, finding.story.as_ref()?)));
    match arguments.svg.as_ref().zip(story) {
        Some((file, (finding, story))) => {
            whole_file::put(file, story.svg(&finding.sentence).as_bytes()).context("writing the picture")?;
        }
        None if arguments.svg.is_some() => console::note("no picture is written: no finding has a story to draw"),
        None => {}
    }
    if let Some(folder) = &arguments.test {
        crate::test::write(folder, &loaded, &report.findings)?;
    }
    if fails && arguments.fix && !arguments.write {
        arguments.limits.with(|limits| repair::show(&arguments.file, &loaded, &report, limits));
    }
    let write = |limits: &Limits<'_>| repair::write(&arguments.file, &loaded, &report, limits);
    if fails && arguments.write && arguments.limits.with(write)? {
        return run(&Arguments { fix: false, write: false, svg: None, test: None, ..arguments.clone() });
    }
    if fails {
        return Err(Failure::Reported);
    }
    if report.is_limited { Err(Failure::Limited) } else { Ok(()) }
}

/// Describes the time and memory that the verification took. The number of states is in the text of the report.
fn effort(report: &Report, took: Duration) -> String {
    let seconds = took.as_secs_f64();
    #[expect(clippy::cast_precision_loss, reason = "a rate is rounded")]
    let rate = report.states as f64 / seconds.max(1e-3);
    format!("it took {seconds:.2} s: {rate:.0} states a second, {} of memory at most", size(report.memory as u64))
}

/// Returns whether an expression contains an activity or an `else match`.
fn asks_for_reasons(expression: &Expression) -> bool {
    let is_one = matches!(expression, Expression::Chart(_) | Expression::Catch { .. });
    is_one || expression.operands().into_iter().any(asks_for_reasons)
}

/// Prints the model or the transition system. An incomplete transition system is not printed.
fn export(loaded: &Loaded, limits: LimitArgs, format: Export) -> Result<(), Failure> {
    let Loaded { plan, sites, .. } = loaded;
    let is_model = matches!(format, Export::Jani | Export::Mcrl2);
    let has_more = |group: &&Group| asks_for_reasons(&group.expression);
    if let Some(group) = plan.groups.iter().find(has_more).filter(|_| is_model) {
        let why = "models for other tools have no activities and no `else match`; export the transition system with `--export aut`";
        return Err(anyhow!("cannot export `{}`: {why}", group.path).into());
    }
    let write = match format {
        Export::Jani => return say(&verify::jani(plan, sites)),
        Export::Mcrl2 => return say(&verify::mcrl2(plan, sites)),
        Export::Aut => verify::Transitions::aut,
        Export::Dot => verify::Transitions::dot,
    };
    let all = limits.with(|limits| verify::transitions(plan, sites, limits));
    if let Some(reached) = all.reached {
        console::note(&format!("nothing is exported: {}", reached.words()));
        return Err(Failure::Limited);
    }
    say(&write(&all))
}

fn say(text: &str) -> Result<(), Failure> {
    console::say(text);
    Ok(())
}

/// The whole report for a program: `{"version", "spec", "findings": [{"verdict", "sentence", "diagnostic", "story",
/// "assumes"}], "states", "transitions", "memory_bytes", "assumed"}`. `assumes` is the assumption of one proof,
/// `{"text", "story"}`. A verdict is `proved`, `fails` or `open`. Diagnostics have the form of `dca check --format
/// json`. A finding that is open because of a limit has neither diagnostic nor story.
fn json(loaded: &Loaded, report: &Report) -> Value {
    let texts = Texts::new(&loaded.spec, &loaded.interfaces);
    let finding = |found: &Finding| in_json(found, &texts);
    json!({
        "version": 1,
        "spec": loaded.spec.name,
        "findings": report.findings.iter().map(finding).collect::<Vec<_>>(),
        "states": report.states,
        "transitions": report.transitions,
        "memory_bytes": report.memory,
        "assumed": report.assumptions,
    })
}

/// Returns a finding as an object.
pub(crate) fn in_json(found: &Finding, texts: &Texts<'_>) -> Value {
    let verdict = match found.verdict {
        Verdict::Proved => "proved",
        Verdict::Fails => "fails",
        Verdict::Open => "open",
    };
    json!({
        "verdict": verdict,
        "sentence": found.sentence,
        "diagnostic": found.diagnostic.as_ref().map(|found| diagnostic(found, texts)),
        "story": found.story.as_ref().map(story),
        "assumes": found.assumes.as_ref().map(assumption),
    })
}

fn assumption(assumes: &Assumption) -> Value {
    json!({ "text": assumes.text, "story": assumes.story.as_ref().map(story) })
}

/// Returns a story as an object: `{"steps": [{"cause", "effects", "events"}], "travels", "running", "stopping", "untold", "ended"}`.
pub(crate) fn story(story: &Story) -> Value {
    let steps = story.steps.iter().map(|step| {
        let events: Vec<String> = step.events.iter().map(ToString::to_string).collect();
        json!({ "cause": step.cause, "effects": step.effects, "events": events })
    });
    let ended = story.ended.map(|ended| match ended {
        Became::Done => "done",
        Became::Failed => "failed",
        Became::Stopped => "stopped",
        Became::Active | Became::Stopping => "",
    });
    json!({ "steps": steps.collect::<Vec<_>>(), "travels": story.travels, "running": story.running, "stopping": story.stopping, "untold": story.untold, "ended": ended })
}

#[cfg(test)]
mod tests {
    use super::*;
    use verify::{Alone, Always, Limits};

    #[test]
    fn a_verdict_says_what_it_took() {
        let text = "module Step { done; }\nprocess main(){ host{c1} resource arm; instantiated_processes{ a instof Step(c1); b instof Step(c1); } \
                    internal_event_actions{ using(arm) a, using(arm) b } }";
        let (compiled, sites) = compile_with_sites(&Source::new("a.dca", text), &[], &language::Options::named("a"));
        let limits = Limits { states: 1000, memory: 1 << 20, threads: &Alone, goes_on: &Always };
        let report = verify::verify(&compiled.plan.unwrap(), &sites.unwrap(), &limits);
        assert!(report.states > 0 && report.memory > 0, "{report:?}");
        let report = Report { states: 1000, memory: 2 << 20, ..report };
        let told = effort(&report, Duration::from_millis(500));
        assert_eq!(told, "it took 0.50 s: 2000 states a second, 2 MiB of memory at most");
    }
}
