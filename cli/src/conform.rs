//! `dca conform`: compares a recorded run of supervisors with a spec.

mod difference;
mod numbered;

use crate::io::recorder;
use crate::logic::record::{Entry, Run};
use crate::logic::replay;
use crate::verify::{LimitArgs, Refusal, in_json, load};
use crate::{Controllers, Values, check};
use anyhow::anyhow;
use difference::difference;
use language::Texts;
use language::algebra::Event;
use language::plan::{Group, Plan};
use node::console::{self, Failure};
use node::logic::protocol::{Change, Report};
use node::logic::table::counted;
use numbered::{numbered, with_reasons};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::PathBuf;
use verify::{Conformance, Coverage, Finding, Steps, Verdict, told};

/// The arguments of `dca conform`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The record, or the folder it is in
    record: PathBuf,
    /// The spec that was verified
    spec: PathBuf,
    #[command(flatten)]
    limits: LimitArgs,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    values: Values,
}

/// The steps of a record.
#[derive(Debug, Default)]
struct Recorded {
    /// For each group, the steps of each supervisor that it has had.
    lives: Vec<Vec<Steps>>,
    /// How many recorded steps cannot be compared, because earlier steps are missing.
    omitted: usize,
    /// The groups whose event actions were changed during the run, each with the number of its later steps, which cannot
    /// be compared.
    changed: BTreeMap<String, usize>,
    /// The groups that have begun, but whose recorded steps do not include an end.
    endless: Vec<String>,
    /// The groups in which something has begun, but whose supervisors recorded no step.
    unseen: Vec<String>,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let run = match recorder::read(&recorder::file(&arguments.record)) {
        Err(error) if error.is_of_a_record() => return Err(undecided(&error.to_string())),
        read => read.map_err(anyhow::Error::from)?,
    };
    if replay::is_replay(&run.header.plan) {
        return Err(anyhow!(
            "cannot compare the record of a replay: `dca replay` runs stand-ins in the place of processes, and ends `main` with the \
             record; give the record of a run"
        )
        .into());
    }
    let loaded = load(&arguments.spec, &arguments.controllers, &arguments.values, Refusal::Text)?;
    if let Some(difference) = difference(&run.header.plan, &loaded.plan) {
        if loaded.lacks_interfaces {
            return Err(anyhow!(
                "cannot compare the spec with the record, because the interfaces of some modules are not known here: name the programs of \
                 these modules with `--controllers PROGRAM` ({difference})"
            )
            .into());
        }
        return Err(anyhow!(
            "the record is of another version of the spec: {difference}; `dca export spec {}` writes the spec that ran",
            arguments.record.display()
        )
        .into());
    }
    let recorded = Recorded::of(&run);
    let lives = numbered(&recorded.lives, &run.header.plan, &loaded.plan);
    let plan = with_reasons(loaded.plan, &run.header.plan);
    let found = arguments.limits.with(|limits| verify::conform(&plan, &loaded.sites, &lives, limits));
    if found.steps == 0 {
        return Err(undecided(&format!("the record has no step of a supervisor: {}", recorded.without_steps(&run))));
    }
    if console::is_json() {
        let texts = Texts::new(&loaded.spec, &loaded.interfaces);
        let all = |findings: &[Finding]| findings.iter().map(|finding| in_json(finding, &texts)).collect::<Vec<_>>();
        let (deviations, sentences) = (all(&found.deviations), all(&found.sentences));
        console::answer(&json!({
            "steps": found.steps, "deviations": deviations, "sentences": sentences, "text": summary(&found, &recorded),
        }));
    } else {
        for finding in found.deviations.iter().chain(&found.sentences) {
            console::say(told(finding, &loaded.spec, &loaded.interfaces, check::style()).trim_end());
        }
        console::say(&summary(&found, &recorded));
    }
    if let Some(lacks) = run.lacks() {
        console::note(&format!("warning: the record is not complete: {lacks}"));
    }
    let is_broken = found.sentences.iter().any(|finding| finding.verdict == Verdict::Fails);
    if is_broken || !found.deviations.is_empty() {
        return Err(Failure::Reported);
    }
    let is_partial = recorded.omitted > 0
        || !recorded.changed.is_empty()
        || !recorded.endless.is_empty()
        || !recorded.unseen.is_empty();
    if is_partial || run.lacks().is_some() { Err(Failure::Limited) } else { Ok(()) }
}

/// Returns the failure that nothing could be compared.
fn undecided(why: &str) -> Failure {
    console::say(&format!("not decided: {why}"));
    Failure::Limited
}

impl Recorded {
    /// Explains why there is nothing to compare.
    fn without_steps(&self, run: &Run) -> String {
        let is_refused = |entry: &Entry| matches!(entry, Entry::Report(Report::Refused { .. }));
        if !self.changed.is_empty() {
            let groups = Vec::from_iter(self.changed.keys().map(String::as_str)).join("`, `");
            format!("the event actions of `{groups}` were changed before the first recorded step")
        } else if self.omitted > 0 {
            format!("the recorded steps come after missing steps, {}", counted(self.omitted, "step"))
        } else if run.entries.iter().any(is_refused) {
            "the deployment was refused, so nothing was started".to_owned()
        } else if let Some(lacks) = run.lacks() {
            format!("{lacks}; supervisors send their steps in batches, the last with the end of their group")
        } else {
            "the version of the nodes does not record steps".to_owned()
        }
    }

    fn of(run: &Run) -> Self {
        let groups = &run.header.plan.groups;
        let mut recorded = Self { lives: vec![Vec::new(); groups.len()], ..Self::default() };
        let mut replanned: Option<&Plan> = None;
        for entry in &run.entries {
            match entry {
                Entry::Report(Report::Replanned { plan }) => replanned = Some(plan),
                Entry::Report(Report::Stepped { path, number, steps, changes, .. }) => {
                    let group = groups.iter().position(|group| group.path == *path);
                    let Some(group) = group else { continue };
                    let lives = &mut recorded.lives[group];
                    // If a host has returned, its supervisors start again, with the event actions of the present plan.
                    let is_again = *number == 0 && !lives.is_empty();
                    let is_other = is_again && replanned.is_some_and(|plan| !has_same_actions(plan, &groups[group]));
                    if *changes > 0 || is_other || recorded.changed.contains_key(path) {
                        *recorded.changed.entry(path.clone()).or_default() += steps.len();
                        continue;
                    }
                    if *number == 0 {
                        lives.push(Vec::new());
                    }
                    match lives.last_mut().filter(|known| known.len() as u64 == *number) {
                        Some(known) => known.extend(steps.iter().cloned()),
                        None => recorded.omitted += steps.len(),
                    }
                }
                Entry::Report(_)
                | Entry::Signals { .. }
                | Entry::Output { .. }
                | Entry::Port { .. }
                | Entry::Missing { .. } => {}
            }
        }
        // A supervisor sends its steps in batches: its last steps are missing if its node has died or was cut off.
        let of_groups = groups.iter().zip(&recorded.lives);
        let is_whole = |group: &Group| !recorded.changed.contains_key(&group.path);
        let endless = of_groups.filter(|(group, lives)| is_whole(group) && lives.iter().any(is_endless));
        recorded.endless = endless.map(|(group, _)| group.path.clone()).collect();
        let has_begun = |group: &Group| run.entries.iter().any(|entry| is_begun_in(entry, &group.path));
        let silent = groups.iter().zip(&recorded.lives).filter(|(group, lives)| lives.is_empty() && has_begun(group));
        recorded.unseen = silent.map(|(group, _)| group.path.clone()).collect();
        recorded
    }
}

/// Returns whether a plan has the same event actions for a group.
fn has_same_actions(plan: &Plan, group: &Group) -> bool {
    let other = plan.groups.iter().find(|other| other.path == group.path);
    other.is_some_and(|other| other.expression == group.expression)
}

/// Returns whether an entry reports that a member of a group was started. Only the supervisor of the group starts members.
fn is_begun_in(entry: &Entry, group: &str) -> bool {
    let Entry::Report(Report::Process { path, change: Change::Activated, .. }) = entry else { return false };
    path.rsplit_once('/').is_some_and(|(around, _)| around == group)
}

/// Returns whether a supervisor has begun a run that none of its steps ends.
fn is_endless(steps: &Steps) -> bool {
    steps.iter().fold(false, |runs, step| (runs || matches!(step.event, Event::Start(_))) && step.outcome.is_none())
}

fn summary(found: &Conformance, recorded: &Recorded) -> String {
    let mut text = String::new();
    for one in found.coverage.iter().filter(|one| one.states.0 > 1) {
        text += &line(one);
    }
    if recorded.omitted > 0 {
        let steps = counted(recorded.omitted, "step");
        text += &format!("NOT COMPARED: {steps}, since the record lacks the previous steps\n");
    }
    for (group, steps) in &recorded.changed {
        let steps = counted(*steps, "step");
        text += &format!("NOT COMPARED: {steps} of {group}, after a change of its event actions during the run\n");
    }
    if !recorded.endless.is_empty() {
        text += &format!("NOT COMPARED: the end of {}, which the record lacks\n", recorded.endless.join(", "));
    }
    if !recorded.unseen.is_empty() {
        text +=
            &format!("NOT COMPARED: {}, which ran, but the record has none of its steps\n", recorded.unseen.join(", "));
    }
    let supervisors = recorded.lives.iter().filter(|lives| !lives.is_empty()).count();
    let (steps, supervisors) = (counted(found.steps, "step"), counted(supervisors, "supervisor"));
    let deviations = match found.deviations.len() {
        0 => "all steps agree with the spec".to_owned(),
        count => counted(count, "deviation"),
    };
    format!("{text}{steps} of {supervisors}: {deviations}")
}

/// Returns a line about the part of a group's behaviour that the record shows.
fn line(one: &Coverage) -> String {
    let at_least = if one.is_limited { "at least " } else { "" };
    let (states, transitions) = (one.states, one.transitions);
    let failed = match one.never_failed.as_slice() {
        [] => String::new(),
        names => format!("; never seen to fail: {}", names.join(", ")),
    };
    let outside = match one.outside {
        0 => String::new(),
        count => format!("; {} that no proof counts on", counted(count, "event")),
    };
    format!(
        "seen of {}: {} of {at_least}{} states, {} of {at_least}{} transitions{failed}{outside}\n",
        one.group, states.0, states.1, transitions.0, transitions.1
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::record::Header;
    use language::algebra::{Command, Outcome, Program, State, StepRecord, Value, step};
    use language::plan::Plan;
    use language::{Options, Source, compile, compile_with_sites};
    use std::time::Duration;
    use verify::{Alone, Always, Limits};

    fn plan(text: &str) -> Plan {
        let compiled = compile(&Source::new("test.dca", text), &[], &Options::named("test"));
        compiled.plan.expect("it has a plan")
    }

    const SPEC: &str = "module Step { done; }
        process main(){
            host{c1}
            instantiated_processes{ a instof Step(c1); b instof Step(c1); }
            internal_event_actions{ a ; b }
        }";

    /// A run of one text conforms to another text with the same meaning.
    #[test]
    fn what_says_the_same_is_the_same_version() {
        let text = "module Step { done; }
            process main(){
                host{c1}
                instantiated_processes{ a instof Step(c1); b instof Step(c1); }
                internal_event_actions{ b ; (a within 5 s) }
            }";
        let recorded = plan(text);
        let moved = text
            .replace("a instof Step(c1); b instof", "b instof Step(c1);\n// moved\na instof")
            .replace("5 s", "5000 ms");
        let (compiled, sites) = compile_with_sites(&Source::new("test.dca", moved), &[], &Options::named("test"));
        let (spec, sites) = compiled.plan.zip(sites).expect("it has a plan");
        assert_eq!(difference(&recorded, &spec), None);
        // `b` is done, the deadline of `a` passes, and `a` has stopped.
        let program = Program::compile(&recorded.groups[0]);
        let (mut state, mut steps, mut next) = (State::new(&program), Vec::new(), Some(Event::Start(Value::EMPTY)));
        while let Some(event) = next.take() {
            let mut commands = Vec::new();
            let outcome = step(&program, &mut state, event.clone(), &mut commands);
            for command in &commands {
                next = match *command {
                    Command::Activate { member: 1, activation, .. } => {
                        Some(Event::Done { member: 1, activation, value: Value::EMPTY })
                    }
                    Command::Arm { timer, activation, .. } => Some(Event::Elapsed { timer, activation }),
                    Command::Stop { member, activation } => Some(Event::Stopped { member, activation }),
                    Command::Activate { .. }
                    | Command::Cancel { .. }
                    | Command::Connect { .. }
                    | Command::Disconnect { .. }
                    | Command::Send { .. }
                    | Command::Log { .. }
                    | Command::Lost { .. } => next,
                };
            }
            steps.push(StepRecord::new(event, commands, outcome));
        }
        assert!(steps.last().is_some_and(|step| matches!(step.outcome, Some(Outcome::Aborted(_)))), "{steps:?}");
        let lives = numbered(&[vec![steps]], &recorded, &spec);
        let limits = Limits { states: 10_000, memory: 16 << 20, threads: &Alone, goes_on: &Always };
        let found = verify::conform(&with_reasons(spec, &recorded), &sites, &lives, &limits);
        assert_eq!(found.deviations, Vec::new());
    }

    fn recorded(numbers: &[u64]) -> Recorded {
        of_reports(numbers.iter().map(|number| stepped(*number, 0)).collect())
    }

    fn stepped(number: u64, changes: u32) -> Report {
        let steps = vec![StepRecord::new(Event::Stop, Vec::new(), None)];
        Report::Stepped { path: "main".to_owned(), number, steps, changes, at: Duration::ZERO }
    }

    fn of_reports(reports: Vec<Report>) -> Recorded {
        let entries = reports.into_iter().map(Entry::Report).collect();
        let header = Header { file: "test.dca".to_owned(), text: SPEC.to_owned(), plan: plan(SPEC), started: None };
        Recorded::of(&Run { header, go: None, entries, values: Vec::new(), damage: None })
    }

    #[test]
    fn a_supervisor_without_a_step_is_told_if_it_ran() {
        let begins =
            |path: &str| Report::Process { path: path.to_owned(), change: Change::Activated, at: Duration::ZERO };
        assert_eq!(of_reports(vec![begins("main")]).unseen, [""; 0], "its members never began");
        assert_eq!(of_reports(vec![begins("main"), begins("main/a")]).unseen, ["main"]);
        assert_eq!(recorded(&[0]).unseen, [""; 0]);
    }

    #[test]
    fn steps_after_a_gap_are_counted_and_not_compared() {
        let found = recorded(&[0, 1, 3, 4, 0, 1]);
        assert_eq!(found.lives[0].iter().map(Vec::len).collect::<Vec<_>>(), [2, 2]);
        assert_eq!((found.omitted, found.changed.len()), (2, 0));
    }

    #[test]
    fn steps_before_a_change_of_the_event_actions_are_compared() {
        let changed = || Report::Changed { revision: 1, by: "user".to_owned(), changes: Vec::new() };
        let lives = |found: &Recorded| found.lives[0].iter().map(Vec::len).collect::<Vec<_>>();
        // The steps before the change are sent with it. They may arrive after the report of the change.
        let found = of_reports(vec![changed(), stepped(0, 0), stepped(1, 1), stepped(2, 1)]);
        assert_eq!((lives(&found), &found.changed["main"], found.endless.len()), (vec![1], &2, 0));
        // A program was replaced: the event actions are the same.
        let found = of_reports(vec![stepped(0, 0), changed(), stepped(1, 0)]);
        assert_eq!((lives(&found), found.changed.len()), (vec![2], 0));
        // The supervisor of a host that has returned has the event actions of the present plan.
        let mut other = plan(SPEC);
        other.groups[0].expression = language::plan::Expression::Wait(Duration::from_secs(1));
        for (plan, lives_expected, changed) in [(other, vec![1], 1), (plan(SPEC), vec![1, 1], 0)] {
            let replanned = Report::Replanned { plan: Box::new(plan) };
            let found = of_reports(vec![stepped(0, 0), replanned, stepped(0, 0)]);
            assert_eq!((lives(&found), found.changed.len()), (lives_expected, changed));
        }
    }

    #[test]
    fn a_supervisor_whose_end_is_missing_is_told() {
        let start = || StepRecord::new(Event::Start(Value::EMPTY), Vec::new(), None);
        let end = || StepRecord::new(Event::Stop, Vec::new(), Some(Outcome::Stopped));
        let late = || StepRecord::new(Event::Stop, Vec::new(), None);
        let at_once = StepRecord::new(Event::Start(Value::EMPTY), Vec::new(), Some(Outcome::Stopped));
        for (steps, endless) in [
            (vec![], false),
            (vec![at_once], false),
            (vec![start(), end(), late()], false),
            (vec![start(), late()], true),
            (vec![start(), end(), start()], true),
        ] {
            assert_eq!(is_endless(&steps), endless, "{steps:?}");
        }
    }
}
