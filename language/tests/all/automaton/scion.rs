//! The charts of SCION's test framework, with their scripts of events, and those of the W3C in it.
//!
//! The charts are fetched by npm and not copied. Each is translated and run, unless it has no counterpart.

use super::scxml::{Output, Translated, translate};
use language::algebra::{Activation, Outcome, Value};
use language::automaton::{Automaton, Command, Configuration, Event, step};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process;
use std::time::Duration;

const PACKAGE: &str = "@scion-scxml/test-framework@2.0.16";

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

/// A translated chart that runs on virtual time.
struct Player<'a> {
    translated: &'a Translated,
    automaton: &'a Automaton,
    configuration: Configuration,
    now: Duration,
    /// Events that come back, with their times.
    coming: Vec<(Duration, Event)>,
    end: Option<String>,
}

impl Player<'_> {
    fn send(&mut self, event: Event) {
        let mut commands = vec![];
        let outcome = step(self.automaton, &mut self.configuration, event, &mut commands);
        for command in commands {
            match command {
                Command::Send { output, .. } => match self.translated.outputs[output] {
                    Output::Event(event, delay) => self.coming.push((self.now + delay, Event::message(event))),
                    Output::Final(state) => self.end = Some(self.automaton.chart().states[state].name.clone()),
                },
                Command::Arm { transition, activation: Activation(number), after } => {
                    let event = Event::Elapsed { transition, activation: Activation(number) };
                    self.coming.push((self.now + after, event));
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

    /// Lets time pass: everything that comes until then comes in order.
    fn pass(&mut self, time: Duration) {
        let until = self.now + time;
        while let Some(place) = (0..self.coming.len()).min_by_key(|&place| self.coming[place].0)
            && self.coming[place].0 <= until
        {
            let (at, event) = self.coming.remove(place);
            self.now = at;
            self.send(event);
        }
        self.now = until;
    }

    fn expect(&self, expected: &BTreeSet<String>) -> Result<(), String> {
        let name = |state: usize| self.automaton.chart().states[state].name.clone();
        let mut active: BTreeSet<String> = self.configuration.leaves(self.automaton).map(name).collect();
        active.extend(self.end.clone());
        if active == *expected { Ok(()) } else { Err(format!("{active:?}, not {expected:?}")) }
    }
}

fn judge(folder: &Path, case: &Case) -> Verdict {
    let text = std::fs::read_to_string(folder.join(&case.file)).expect("node has listed it");
    let mut sent: Vec<String> = case.events.iter().map(|event| event.name.clone()).collect();
    sent.sort();
    sent.dedup();
    let translated = match translate(&text, &sent) {
        Ok(translated) => translated,
        Err(why) => return Verdict::Missing(why),
    };
    let automaton = match Automaton::new(translated.chart.clone()) {
        Ok(automaton) => automaton,
        Err(why) => return Verdict::Failed(why.to_string()),
    };
    let configuration = Configuration::new(&automaton);
    let (now, coming, end) = (Duration::ZERO, vec![], None);
    let mut player = Player { translated: &translated, automaton: &automaton, configuration, now, coming, end };
    player.send(Event::Start(Value::EMPTY));
    player.pass(Duration::ZERO);
    let mut verdict = player.expect(&case.initial);
    for event in &case.events {
        player.pass(event.after);
        let port = translated.events.iter().position(|name| *name == event.name).expect("it was given");
        player.send(Event::message(port));
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
    let (mut passed, mut missing, mut failed) = (BTreeMap::new(), BTreeMap::new(), vec![]);
    for case in &cases {
        let group = if case.file.contains("/w3c-ecma/") { "W3C" } else { "SCION" };
        match judge(&folder, case) {
            Verdict::Passed => *passed.entry(group).or_insert(0) += 1,
            Verdict::Missing(why) => *missing.entry((group, why)).or_insert(0) += 1,
            Verdict::Failed(why) => failed.push(format!("{}: {why}", case.file)),
        }
    }
    println!("{} charts; passed {passed:?}\nno counterpart {missing:#?}", cases.len());
    assert!(failed.is_empty(), "{failed:#?}");
    let count = |group| (passed[group], missing.iter().filter(|((of, _), _)| *of == group).map(|(_, n)| n).sum());
    assert_eq!((count("SCION"), count("W3C")), ((106, 21), (39, 150)), "passed, without a counterpart");
}
