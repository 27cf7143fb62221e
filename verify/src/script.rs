//! A story as a script: one event per line, then the expected result. The simulator of `language` plays it.

use crate::story::{Became, Story};
use language::plan::Plan;
use language::{ReplayError, Simulation, TraceEvent, Transition};
use std::fmt;
use std::str::FromStr;

/// The events of a story, and its result.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Script {
    /// The events in order; the first one starts the whole.
    pub events: Vec<TraceEvent>,
    /// The processes whose orders and reports take time between hosts, by their paths.
    pub travels: Vec<String>,
    /// The processes that run at the end, by their paths below `main`: programs, and groups whose inside the story
    /// does not show.
    pub running: Vec<String>,
    /// The processes that are being stopped at the end.
    pub stopping: Vec<String>,
    /// The processes that may or may not run at the end, by paths like those in `running`.
    pub untold: Vec<String>,
    /// How the whole has ended; none if it has not ended.
    pub ended: Option<Became>,
}

/// The result of playing a script.
#[derive(Clone, Debug)]
pub struct Played {
    /// The events, one line each.
    pub lines: Vec<String>,
    /// The result of playing the script.
    pub result: PlayResult,
}

/// How a script was played.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlayResult {
    /// The simulation has the same result as the story.
    Same,
    /// All events have happened, but the result differs; the text describes the difference.
    Other(String),
    /// Something could not happen.
    Ends(ReplayError),
}

/// A line of a script that is not valid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {number} is not a line of a script: {why}")]
pub struct ScriptError {
    /// The number of the line, from 1.
    pub number: usize,
    /// The expected text.
    pub why: String,
}

const ENDS: [(&str, Became); 3] = [("done", Became::Done), ("failed", Became::Failed), ("stopped", Became::Stopped)];

impl Script {
    /// Returns the script of a story; none if an event has no name. A part that repeats for ever is written once.
    pub fn of(story: &Story) -> Option<Self> {
        let is_named = story.steps.iter().all(|step| !step.events.is_empty());
        (is_named && !story.steps.is_empty()).then(|| Self {
            events: story.steps.iter().flat_map(|step| step.events.clone()).collect(),
            travels: story.travels.clone(),
            running: story.running.clone(),
            stopping: story.stopping.clone(),
            untold: story.untold.clone(),
            ended: story.ended,
        })
    }

    /// Plays the script with simulated programs.
    pub fn play(&self, plan: &Plan) -> Played {
        let mut lines = Vec::new();
        let root = match self.events.first() {
            Some(TraceEvent::Start(root)) => root.as_str(),
            _ => "main",
        };
        let mut simulation = match Simulation::replay(plan, root, &self.travels) {
            Ok(simulation) => simulation,
            Err(error) => return Played { lines, result: PlayResult::Ends(error) },
        };
        for event in &self.events {
            if let Err(error) = simulation.occur(event) {
                return Played { lines, result: PlayResult::Ends(error) };
            }
            lines.push(line(lines.len() + 1, event, &mut simulation));
        }
        let result = self.difference(plan, &simulation).map_or(PlayResult::Same, PlayResult::Other);
        Played { lines, result }
    }

    /// Returns the difference between the end of a simulation and the end of the story.
    fn difference(&self, plan: &Plan, simulation: &Simulation<'_>) -> Option<String> {
        let ended = match simulation.outcome() {
            Some(Transition::Done) => Some(Became::Done),
            Some(Transition::Aborted(_)) => Some(Became::Failed),
            Some(Transition::Stopped) => Some(Became::Stopped),
            Some(
                Transition::Started
                | Transition::Stopping
                | Transition::Waits(_)
                | Transition::Limited(_)
                | Transition::Says(_),
            )
            | None => None,
        };
        if ended != self.ended {
            let word = |ended: Option<Became>| {
                let end = ENDS.iter().find(|(_, became)| Some(*became) == ended);
                end.map_or_else(|| "has not ended".to_owned(), |(word, _)| format!("is {word}"))
            };
            return Some(format!("the whole {}, in the story it {}", word(ended), word(self.ended)));
        }
        let path = |name: &String| if name == "main" { name.clone() } else { format!("main/{name}") };
        let (runs, stops) = (simulation.running(), simulation.stopping());
        let is_leaf = |path: &String| plan.leaves.iter().any(|leaf| leaf.path == *path);
        let named: Vec<String> = self.running.iter().chain(&self.stopping).chain(&self.untold).map(path).collect();
        let is_named = |leaf: &&&str| {
            named.iter().any(|name| {
                leaf.strip_prefix(name.as_str()).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
            })
        };
        if let Some(leaf) = runs.iter().chain(&stops).find(|leaf| !is_named(leaf)) {
            return Some(format!("`{leaf}` runs, and not in the story"));
        }
        let mut awaited = self.running.iter().map(|name| (path(name), &runs, "runs"));
        let mut asked = self.stopping.iter().map(|name| (path(name), &stops, "is being stopped"));
        let is_missing =
            |(path, leaves, _): &(String, &Vec<&str>, &str)| is_leaf(path) && !leaves.contains(&path.as_str());
        let missing = awaited.find(is_missing).or_else(|| asked.find(is_missing));
        missing.map(|(path, _, word)| format!("`{path}` {word} in the story, and not here"))
    }
}

/// Returns the line for an event: its effects in the simulation.
fn line(number: usize, event: &TraceEvent, simulation: &mut Simulation<'_>) -> String {
    let (mut starts, mut stops, mut ends) = (Vec::new(), Vec::new(), Vec::new());
    for found in simulation.take_happenings() {
        if Some(found.path.as_str()) == event.path() {
            continue;
        }
        let name = format!("`{}`", found.path.strip_prefix("main/").unwrap_or(&found.path));
        match found.transition {
            Transition::Started => starts.push(name),
            Transition::Stopping => stops.push(name),
            Transition::Done => ends.push(format!("{name} is done")),
            Transition::Aborted(_) => ends.push(format!("{name} fails")),
            Transition::Stopped => ends.push(format!("{name} has stopped")),
            Transition::Waits(_) | Transition::Limited(_) | Transition::Says(_) => {}
        }
    }
    if !stops.is_empty() {
        ends.push(format!("stops {}", stops.join(", ")));
    }
    if !starts.is_empty() {
        ends.push(format!("starts {}", starts.join(", ")));
    }
    let follows = if ends.is_empty() { String::new() } else { format!(": {}", ends.join("; ")) };
    format!("{number:>3}  {event}{follows}")
}

impl fmt::Display for Script {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.travels.is_empty() {
            writeln!(f, "travels {}", self.travels.join(", "))?;
        }
        self.events.iter().try_for_each(|event| writeln!(f, "{event}"))?;
        for (word, names) in [("runs", &self.running), ("stops", &self.stopping), ("untold", &self.untold)] {
            if !names.is_empty() {
                writeln!(f, "{word} {}", names.join(", "))?;
            }
        }
        let end = ENDS.iter().find(|(_, became)| Some(*became) == self.ended);
        end.map_or(Ok(()), |(word, _)| writeln!(f, "ends {word}"))
    }
}

impl FromStr for Script {
    type Err = ScriptError;

    /// Reads a script. Comments after `#` and empty lines are ignored.
    fn from_str(text: &str) -> Result<Self, ScriptError> {
        let mut script = Self::default();
        for (number, line) in (1..).zip(text.lines()) {
            let line = line.split('#').next().unwrap_or_default().trim();
            let names = |rest: &str| rest.split(", ").map(|name| name.trim().to_owned()).collect();
            match line.split_once(' ').unwrap_or((line, "")) {
                ("", _) => {}
                ("travels", rest) => script.travels = names(rest),
                ("runs", rest) => script.running = names(rest),
                ("stops", rest) => script.stopping = names(rest),
                ("untold", rest) => script.untold = names(rest),
                ("ends", word) => {
                    let end = ENDS.iter().find(|(end, _)| *end == word.trim()).map(|(_, became)| *became);
                    let why = || "`ends done`, `ends failed` or `ends stopped`".to_owned();
                    script.ended = Some(end.ok_or_else(|| ScriptError { number, why: why() })?);
                }
                _ => script.events.push(
                    line.parse().map_err(|why: language::TraceError| ScriptError { number, why: why.to_string() })?,
                ),
            }
        }
        Ok(script)
    }
}
