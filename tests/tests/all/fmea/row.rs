//! A row of `dca fmea --json`.

use dca_tests::cluster::{Cluster, spec};
use language::TraceEvent;
use serde_json::Value;
use std::time::Duration;

/// The content of a row.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    /// The first three columns, for use in messages.
    pub(crate) name: String,
    /// The path of the program; none for a host or a link.
    pub(crate) program: Option<String>,
    /// The name of the host; none for a program or a link.
    pub(crate) host: Option<String>,
    /// The simultaneous steps, as paths of leaves and groups.
    pub(crate) phase: Vec<String>,
    pub(crate) at_once: String,
    pub(crate) running: Vec<String>,
    pub(crate) safe_within: Option<Duration>,
    pub(crate) mission: String,
    pub(crate) verdict: String,
    /// The events before the fault.
    pub(crate) before: Vec<TraceEvent>,
}

/// Returns the path of a process from its name in a table.
pub(crate) fn path(name: &str) -> String {
    format!("main/{name}")
}

/// Returns whether a path is a process or is below it.
pub(crate) fn is_below(path: &str, process: &str) -> bool {
    path.strip_prefix(process).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

/// All rows of the door.
pub(crate) fn rows() -> Vec<Value> {
    let cluster = Cluster::new();
    let table = cluster.here().ask(&["fmea", &spec("door_opening"), "--json"]);
    assert_eq!(table.code, Some(0), "{table}");
    let mut table: Value = serde_json::from_str(&table.out).expect("`--json` prints JSON");
    serde_json::from_value(table["rows"].take()).expect("it has rows")
}

fn text(row: &Value, column: &str) -> String {
    row[column].as_str().unwrap_or_else(|| panic!("{row} has no `{column}`")).to_owned()
}

impl Row {
    /// Finds a row by its first three columns, without `dooropensyst/`.
    pub(crate) fn find(rows: &[Value], program: &str, fault: &str, phase: &str) -> Self {
        let short = |row: &Value, column| text(row, column).replace("dooropensyst/", "");
        let is_it = |row: &&Value| {
            (short(row, "program"), text(row, "fault"), short(row, "while"))
                == (program.to_owned(), fault.to_owned(), phase.to_owned())
        };
        let found = rows.iter().find(is_it);
        Self::new(found.unwrap_or_else(|| panic!("the table has no row `{program} | {fault} | {phase}`")))
    }

    fn new(row: &Value) -> Self {
        let (program, fault, phase) = (text(row, "program"), text(row, "fault"), text(row, "while"));
        let steps = phase.split(", ").filter(|step| !["alone", "between two steps"].contains(step));
        let running = row["still_runs"].as_array().expect("names").iter();
        let events = row["story"]["steps"].as_array().expect("steps").iter().flat_map(|step| {
            step["events"].as_array().expect("events").iter().map(|event| {
                event.as_str().expect("a text").parse::<TraceEvent>().unwrap_or_else(|error| panic!("{error}"))
            })
        });
        let is_before =
            |event: &TraceEvent| !matches!(event, TraceEvent::Struck(..) | TraceEvent::Lost(_) | TraceEvent::Cut(_));
        let host = program.strip_prefix("host ").map(str::to_owned);
        let is_program = host.is_none() && !program.contains(" - ");
        Self {
            name: format!("{program} | {fault} | {phase}"),
            program: is_program.then(|| path(&program)),
            host,
            phase: steps.map(path).collect(),
            at_once: text(row, "at_once"),
            running: running.map(|name| name.as_str().expect("a name").to_owned()).collect(),
            safe_within: row["safe_within_s"].as_f64().map(Duration::from_secs_f64),
            mission: text(row, "mission"),
            verdict: text(row, "verdict"),
            before: events.take_while(is_before).collect(),
        }
    }

    /// Returns the immediate effects of the row: the paths of groups and leaves that are asked to stop, and the paths
    /// of those that fail.
    pub(crate) fn follows(&self) -> (Vec<String>, Vec<String>) {
        let (mut stops, mut fails) = (Vec::new(), Vec::new());
        for clause in self.at_once.split("; ") {
            if let Some(names) = clause.strip_prefix("stops ") {
                stops.extend(names.split(", ").map(path));
            } else if let Some(name) = clause.strip_suffix(" fails") {
                fails.push(if name == "main" { name.to_owned() } else { path(name) });
            }
        }
        (stops, fails)
    }
}
