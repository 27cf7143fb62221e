//! The charts of SCION's test framework, with their scripts of events, and those of the W3C in it.
//!
//! The charts are fetched by npm and not copied. Each is imported, and the text of its spec becomes a plan. The activity of the
//! plan plays the script of the chart, unless a part of the chart has no counterpart.

use crate::player::{Played, Player};
use import::{RemarkKind, import};
use language::Source;
use language::automaton::{Automaton, Event};
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

fn judge(folder: &Path, case: &Case) -> Verdict {
    let text = std::fs::read_to_string(folder.join(&case.file)).expect("node has listed it");
    let imported = match import(&Source::new("chart.scxml", text), &[]) {
        Ok(imported) => imported,
        Err(why) => return Verdict::Missing(why.why),
    };
    if let Some(remark) = imported.remarks.iter().find(|remark| remark.kind == RemarkKind::Missing) {
        return Verdict::Missing(remark.text.clone());
    }
    let played = Played::of(imported);
    let automaton = match Automaton::new(played.chart.chart.clone()) {
        Ok(automaton) => automaton,
        Err(why) => return Verdict::Failed(why.to_string()),
    };
    let mut player = Player::start(&played, &automaton);
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
