//! `dca sim`: runs the event actions of a spec with fake leaves, from the keyboard, from a script, or at random.

use crate::io::{named_file, whole_file};
use crate::logic::story_test::StoryTest;
use crate::{Controllers, Values, check};
use anyhow::{Context as _, anyhow};
use language::plan::Plan;
use language::{RandomRun, Simulation, SimulationEvent, Transition};
use node::console::{self, Failure};
use serde_json::Value;
use std::io::{BufRead as _, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::time::Duration;
use verify::{PlayResult, Script};

/// The number of random events, unless the user sets another.
const STEPS: u64 = 1000;

/// The arguments of `dca sim`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    /// A file with one line for each thing that happens: `arm`, `arm abort why`, `arm crash`, `5 s`, `stop` [default: standard input]
    #[arg(long, value_name = "FILE", conflicts_with = "seed")]
    script: Option<PathBuf>,
    /// Play the story of a mistake: a file of `dca verify --test`, or the output of `dca verify --json`
    #[arg(long, value_name = "FILE", conflicts_with_all = ["script", "seed", "chart"])]
    replay: Option<PathBuf>,
    /// Let processes end by chance; the same number gives the same run
    #[arg(long, value_name = "NUMBER")]
    seed: Option<u64>,
    /// How many of a hundred random ends are failures
    #[arg(long, value_name = "PERCENT", default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=100), requires = "seed")]
    faults: u64,
    /// How many random events may happen
    #[arg(long, value_name = "NUMBER", default_value_t = STEPS, requires = "seed")]
    steps: u64,
    /// Draw the activity over time, as SVG
    #[arg(long, value_name = "FILE")]
    chart: Option<PathBuf>,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    values: Values,
}

/// Runs the verb. Fails unless `main` ends normally.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(chart) = &arguments.chart {
        named_file::not_over(chart, [arguments.file.as_path()].into_iter().chain(arguments.script.as_deref()))?;
    }
    let plan = check::load(&arguments.file, &arguments.controllers, &arguments.values, false)?.plan;
    if let Some(file) = &arguments.replay {
        return replay(&plan, file);
    }
    let mut simulation = Simulation::start(&plan);
    match (arguments.seed, &arguments.script) {
        (Some(seed), _) => by_chance(&plan, &mut simulation, seed, arguments),
        (None, Some(script)) => from_script(&mut simulation, script)?,
        (None, None) => from_keyboard(&mut simulation)?,
    }
    if let Some(file) = &arguments.chart {
        whole_file::put(file, simulation.chart().as_bytes()).context("writing the chart")?;
    }
    match simulation.outcome() {
        Some(Transition::Done) => Ok(()),
        Some(Transition::Aborted(_)) => Err(Failure::Reported),
        Some(
            Transition::Stopped
            | Transition::Started
            | Transition::Stopping
            | Transition::Waits(_)
            | Transition::Limited(_)
            | Transition::Says(_),
        ) => Ok(()),
        None => Err(anyhow!("`main` has not ended; {}", running(&simulation)).into()),
    }
}

/// Plays a story. Fails unless the result is the same as in the story.
fn replay(plan: &Plan, file: &Path) -> Result<(), Failure> {
    let text = named_file::text(file, named_file::TEXT_MAX);
    let text = text.with_context(|| format!("reading the story `{}`", file.display()))?;
    let script = if text.trim_start().starts_with('{') {
        first_of(&text)
    } else {
        StoryTest::read(&text).map(|test| test.script)
    };
    let script = script.map_err(|why| anyhow!("`{}` is not a story: {why}", file.display()))?;
    let script =
        script.ok_or_else(|| anyhow!("`{}` has no events to play; `dca test` checks its spec", file.display()))?;
    let played = script.play(plan);
    console::say(&played.lines.iter().map(|line| format!("{line}\n")).collect::<String>());
    match played.result {
        PlayResult::Same => {
            console::say("the run ends as in the story\n");
            Ok(())
        }
        PlayResult::Other(how) => Err(anyhow!("the run ends in another way: {how}").into()),
        PlayResult::Ends(error) => Err(anyhow!("the story ends after step {}: {error}", played.lines.len()).into()),
    }
}

/// Returns the script of the first story in a report of `dca verify --json`.
fn first_of(text: &str) -> Result<Option<Script>, String> {
    let report: Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
    let findings = report["findings"].as_array().ok_or("it has no `findings`")?;
    let Some(story) = findings.iter().map(|finding| &finding["story"]).find(|story| !story.is_null()) else {
        return Ok(None);
    };
    let mut script = String::new();
    for step in story["steps"].as_array().into_iter().flatten() {
        let events: Vec<&str> = step["events"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        if events.is_empty() {
            return Ok(None);
        }
        events.iter().for_each(|event| script += &format!("{event}\n"));
    }
    for (word, key) in [("travels", "travels"), ("runs", "running"), ("stops", "stopping"), ("untold", "untold")] {
        let names: Vec<&str> = story[key].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        if !names.is_empty() {
            script += &format!("{word} {}\n", names.join(", "));
        }
    }
    if let Some(word) = story["ended"].as_str() {
        script += &format!("ends {word}\n");
    }
    script.parse().map(Some).map_err(|error: verify::ScriptError| error.to_string())
}

fn by_chance(plan: &Plan, simulation: &mut Simulation<'_>, seed: u64, arguments: &Arguments) {
    let mut chance = RandomRun::new(plan, seed, arguments.faults);
    show(simulation);
    for _ in 0..arguments.steps {
        if simulation.outcome().is_some() || !chance.step(simulation) {
            break;
        }
        show(simulation);
    }
}

fn from_script(simulation: &mut Simulation<'_>, script: &Path) -> Result<(), Failure> {
    let text = named_file::text(script, named_file::TEXT_MAX);
    let text = text.with_context(|| format!("reading the script `{}`", script.display()))?;
    show(simulation);
    for (number, line) in (1..).zip(text.lines()) {
        if simulation.outcome().is_some() {
            break;
        }
        simulation.obey(line).with_context(|| format!("line {number} of `{}`", script.display()))?;
        show(simulation);
    }
    Ok(())
}

fn from_keyboard(simulation: &mut Simulation<'_>) -> Result<(), Failure> {
    let stdin = std::io::stdin();
    let is_person = stdin.is_terminal();
    if is_person {
        console::note(
            "`arm` ends a process, `arm abort why` or `arm crash` makes it fail, `5 s` lets time pass, `stop` stops it all",
        );
    }
    show(simulation);
    for line in stdin.lock().lines() {
        let line = line.context("reading standard input")?;
        match simulation.obey(&line) {
            Ok(()) => show(simulation),
            Err(error) if is_person => console::note(&error.to_string()),
            Err(error) => return Err(error.into()),
        }
        if simulation.outcome().is_some() {
            break;
        }
    }
    Ok(())
}

/// Prints the events so far, and the running processes.
fn show(simulation: &mut Simulation<'_>) {
    let happenings = simulation.take_happenings();
    if happenings.is_empty() {
        return;
    }
    let lines: String = happenings.iter().map(line).collect();
    let rest =
        if simulation.outcome().is_some() { String::new() } else { format!("{:>10}  {}\n", "", running(simulation)) };
    console::say(&(lines + &rest));
}

fn line(happening: &SimulationEvent) -> String {
    let transition = match &happening.transition {
        Transition::Started => "starts".to_owned(),
        Transition::Done => "done".to_owned(),
        Transition::Aborted(why) => format!("aborted: {why}"),
        Transition::Stopped => "stopped".to_owned(),
        Transition::Stopping => "is asked to stop".to_owned(),
        Transition::Waits(time) => format!("waits {}", seconds(*time)),
        Transition::Limited(time) => format!("begins what may take {}", seconds(*time)),
        Transition::Says(what) => what.clone(),
    };
    format!("{:>10}  {} {transition}\n", seconds(happening.at), happening.path)
}

fn seconds(time: Duration) -> String {
    format!("{:.3} s", time.as_secs_f64())
}

fn running(simulation: &Simulation<'_>) -> String {
    let running = simulation.running();
    if running.is_empty() { "nothing runs".to_owned() } else { format!("runs: {}", running.join(", ")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_happens_is_one_line_each() {
        let transition = Transition::Aborted("no grip".to_owned());
        let happening = SimulationEvent { at: Duration::from_millis(2500), path: "main/arm".to_owned(), transition };
        assert_eq!(line(&happening), "   2.500 s  main/arm aborted: no grip\n");
    }
}
