//! The charts of SCION's test framework, with their scripts of events, and those of the W3C in it.
//!
//! The charts are fetched by npm and not copied. Each is imported, and the text of its spec becomes a plan. The activity of the
//! plan plays the script of the chart, unless a part of the chart has no counterpart.

use import::{Imported, RemarkKind, import};
use language::algebra::{Activation, Outcome, Value};
use language::automaton::{Action, Automaton, Command, Configuration, Event, StateKind, ValueSource, step};
use language::plan::{Expression, StateChart};
use language::{Options, Source, compile};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process;
use std::time::Duration;

const PACKAGE: &str = "@scion-scxml/test-framework@2.0.16";

/// Charts that send an event to themselves and take it in the same step here. Their scripts look before the event comes.
const EARLY: [&str; 5] = ["test185.txml", "test193.txml", "test200.txml", "test348.txml", "test495.txml"];

/// Prints the charts below the folder `package/test`, each with its script, as lines.
const LIST: &str = r#"
const fs = require("fs"), path = require("path");
const walk = (folder) => fs.readdirSync(folder, { withFileTypes: true }).sort((a, b) => (a.name < b.name ? -1 : 1))
  .flatMap((e) => (e.isDirectory() ? walk(path.join(folder, e.name)) : [path.join(folder, e.name)]));
for (const file of walk("package/test").filter((file) => file.endsWith(".scxml"))) {
  const script = file.replace(/\.scxml$/, ".json");
  if (!fs.existsSync(script)) continue;
  const { initialConfiguration, events } = JSON.parse(fs.readFileSync(script, "utf8"));
  console.log("chart\t" + file + "\t" + initialConfiguration.join(" "));
  for (const { after, event, nextConfiguration } of events)
    console.log("event\t" + event.name + "\t" + (after || 0) + "\t" + nextConfiguration.join(" "));
}
"#;

/// One chart of the framework.
struct Case {
    file: String,
    /// The states without active inner states at the start.
    initial: BTreeSet<String>,
    events: Vec<Sent>,
}

/// An event of a script.
struct Sent {
    name: String,
    after: Duration,
    next: BTreeSet<String>,
}

/// How a case ended.
enum Verdict {
    Passed,
    Missing(String),
    Failed(String),
}

fn run(folder: &Path, program: &str, arguments: &[&str]) -> Option<String> {
    let output = process::Command::new(program).args(arguments).current_dir(folder).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

fn cases(folder: &Path) -> Option<Vec<Case>> {
    let archive = run(folder, "npm", &["pack", "--silent", PACKAGE])?;
    run(folder, "tar", &["xzf", archive.trim()])?;
    let names = |text: &str| text.split_whitespace().map(str::to_owned).collect();
    let mut cases: Vec<Case> = vec![];
    for line in run(folder, "node", &["-e", LIST])?.lines() {
        match line.split('\t').collect::<Vec<&str>>()[..] {
            ["chart", file, initial] => {
                cases.push(Case { file: file.into(), initial: names(initial), events: vec![] });
            }
            ["event", name, after, next] => {
                let after = Duration::from_millis(after.parse().ok()?);
                cases.last_mut()?.events.push(Sent { name: name.into(), after, next: names(next) });
            }
            _ => return None,
        }
    }
    Some(cases)
}

/// A chart that was imported, with the names that its script needs.
struct Played {
    imported: Imported,
    chart: StateChart,
    /// The ids of the states, by their numbers.
    ids: BTreeMap<usize, String>,
    /// The final states of the whole chart, by the numbers of the outputs that they were given.
    finals: BTreeMap<usize, usize>,
}

impl Played {
    /// Imports a chart, and reads its activity back from the plan of the text.
    fn of(text: &str) -> Result<Self, Verdict> {
        let imported = import(&Source::new("chart.scxml", text), &[]).map_err(|why| Verdict::Missing(why.why))?;
        if let Some(remark) = imported.remarks.iter().find(|remark| remark.kind == RemarkKind::Missing) {
            return Err(Verdict::Missing(remark.text.clone()));
        }
        let spec = Source::new("chart.dca", imported.text.as_str());
        let plan = compile(&spec, &[], &Options::named("chart")).plan.expect("an imported text has a plan");
        let activity = plan
            .groups
            .into_iter()
            .find_map(|group| if let Expression::Chart(chart) = group.expression { Some(*chart) } else { None });
        let mut chart = activity.expect("the plan has the activity");
        let number = |name: &String| chart.chart.states.iter().position(|state| state.name == *name);
        let ids: BTreeMap<usize, String> =
            imported.states.iter().filter_map(|(id, name)| Some((number(name)?, id.clone()))).collect();
        let finals = told_finals(&mut chart, &ids);
        Ok(Self { imported, chart, ids, finals })
    }

    /// The port of an event: its own, or that of the longest name that takes it.
    fn port(&self, event: &str) -> Option<usize> {
        let mut stems: Vec<&str> = event.match_indices('.').map(|(end, _)| &event[..end]).collect();
        stems.push(event);
        let ports = stems.iter().rev().copied().chain(["*"]).find_map(|stem| self.imported.ports.get(stem));
        ports.and_then(|port| self.chart.inputs.iter().position(|input| input == port))
    }
}

/// Lets the final states of the whole chart send something, since an activity that has ended is in no state.
///
/// The parent of such a state is the activity itself, or the region of the chart beside its timers.
fn told_finals(chart: &mut StateChart, ids: &BTreeMap<usize, String>) -> BTreeMap<usize, usize> {
    let mut finals = BTreeMap::new();
    for (number, state) in chart.chart.states.iter_mut().enumerate() {
        if state.kind == StateKind::Final && state.parent.is_some_and(|parent| !ids.contains_key(&parent)) {
            let output = chart.outputs.len() + finals.len();
            state.entry.push(Action::Send { output, value: ValueSource::Constant(Value::EMPTY) });
            finals.insert(output, number);
        }
    }
    finals
}

/// A chart that runs on virtual time.
struct Player<'a> {
    played: &'a Played,
    automaton: &'a Automaton,
    configuration: Configuration,
    now: Duration,
    /// The timers that run, with their times.
    timers: Vec<(Duration, Event)>,
    end: Option<String>,
}

impl Player<'_> {
    fn send(&mut self, event: Event) {
        let mut commands = vec![];
        let outcome = step(self.automaton, &mut self.configuration, event, &mut commands);
        for command in commands {
            match command {
                Command::Send { output, .. } => {
                    let state = self.played.finals.get(&output);
                    self.end = state.and_then(|state| self.played.ids.get(state)).cloned().or(self.end.take());
                }
                Command::Arm { transition, activation: Activation(number), after } => {
                    let event = Event::Elapsed { transition, activation: Activation(number) };
                    self.timers.push((self.now + after, event));
                }
                Command::Run { .. }
                | Command::Stop { .. }
                | Command::Cancel { .. }
                | Command::Log(_)
                | Command::Lost { .. } => {}
            }
        }
        if let Some(Outcome::Aborted(reason)) = outcome {
            self.end = Some(format!("{:?}", reason.cause));
        }
    }

    /// Lets time pass: every timer that ends until then ends in order.
    fn pass(&mut self, time: Duration) {
        let until = self.now + time;
        while let Some(place) = (0..self.timers.len()).min_by_key(|&place| self.timers[place].0)
            && self.timers[place].0 <= until
        {
            let (at, event) = self.timers.remove(place);
            self.now = at;
            self.send(event);
        }
        self.now = until;
    }

    fn expect(&self, expected: &BTreeSet<String>) -> Result<(), String> {
        // States without an id are those of timers.
        let leaves = self.configuration.leaves(self.automaton);
        let mut active: BTreeSet<String> = leaves.filter_map(|state| self.played.ids.get(&state).cloned()).collect();
        active.extend(self.end.clone());
        if active == *expected { Ok(()) } else { Err(format!("{active:?}, not {expected:?}")) }
    }
}

fn judge(folder: &Path, case: &Case) -> Verdict {
    let text = std::fs::read_to_string(folder.join(&case.file)).expect("node has listed it");
    let played = match Played::of(&text) {
        Ok(played) => played,
        Err(verdict) => return verdict,
    };
    let automaton = match Automaton::new(played.chart.chart.clone()) {
        Ok(automaton) => automaton,
        Err(why) => return Verdict::Failed(why.to_string()),
    };
    let configuration = Configuration::new(&automaton);
    let (now, timers, end) = (Duration::ZERO, vec![], None);
    let mut player = Player { played: &played, automaton: &automaton, configuration, now, timers, end };
    player.send(Event::Start(Value::EMPTY));
    player.pass(Duration::ZERO);
    let mut verdict = player.expect(&case.initial);
    for event in &case.events {
        player.pass(event.after);
        if let Some(port) = played.port(&event.name) {
            player.send(Event::message(port));
        } else if played.imported.text.contains(&format!("signal {}", event.name)) {
            return Verdict::Missing("an event that comes from inside and from outside".into());
        }
        player.pass(Duration::ZERO);
        verdict = verdict.and_then(|()| player.expect(&event.next));
    }
    match verdict {
        Ok(()) => Verdict::Passed,
        Err(why) => Verdict::Failed(why),
    }
}

#[test]
#[ignore = "long: fetches charts with npm"]
fn the_charts_of_scion_run() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("scion");
    std::fs::create_dir_all(&folder).expect("the folder of the build can be written");
    let Some(cases) = cases(&folder) else {
        println!("skipped: npm, node or the registry cannot be reached");
        return;
    };
    let (mut passed, mut missing, mut failed, mut early) = (BTreeMap::new(), BTreeMap::new(), vec![], 0);
    for case in &cases {
        let group = if case.file.contains("/w3c-ecma/") { "W3C" } else { "SCION" };
        match judge(&folder, case) {
            Verdict::Passed => *passed.entry(group).or_insert(0) += 1,
            Verdict::Missing(why) => *missing.entry((group, why)).or_insert(0) += 1,
            Verdict::Failed(_) if EARLY.iter().any(|name| case.file.contains(name)) => early += 1,
            Verdict::Failed(why) => failed.push(format!("{}: {why}", case.file)),
        }
    }
    println!("{} charts; passed {passed:?}\nno counterpart {missing:#?}", cases.len());
    assert!(failed.is_empty(), "{failed:#?}");
    let count = |group| (passed[group], missing.iter().filter(|((of, _), _)| *of == group).map(|(_, n)| n).sum());
    assert_eq!((count("SCION"), count("W3C")), ((110, 17), (43, 141)), "passed, without a counterpart");
    assert_eq!(early, EARLY.len());
}
